//! What a warp draws.

#[cfg(feature = "codec")]
use super::Warning;
use super::digest::Collector;
use super::mesh_renderer::MeshRenderer;
use super::mesh_renderer::region::RegionDrawer;
use super::{Digest, Image, LabelImage, OutputSpec, PosedMesh, Region, Target, WarpError};
#[cfg(feature = "codec")]
use crate::codec::{Carried, Encoding, Writer};
use crate::deform::IsCancelled;
use crate::pixmap::{Depth, Extent};
use crate::render::{Coverage, Outside, Source};

/// What a warp draws.
#[derive(Clone, Copy, Debug)]
pub enum RasterSource<'a> {
    /// A picture.
    Image(&'a Image),
    /// Labels: every pixel has the label of the source pixel that its centre shows, and 0 where
    /// nothing is drawn. `filter` and `outside` have no effect on labels; the filter applies to the
    /// mask of a region.
    Labels(&'a LabelImage),
    /// How much of each pixel the posed picture of a source of this size covers, 0 to 255; grey and
    /// opaque.
    Coverage(Extent),
    /// Where content of a region moved away and nothing covers the place, 0 to 255; grey and
    /// opaque.
    Holes(&'a Region),
}

impl RasterSource<'_> {
    /// Upright size of the source, px.
    #[must_use]
    pub fn extent(self) -> Extent {
        match self {
            Self::Image(image) => image.extent(),
            Self::Labels(labels) => labels.extent(),
            Self::Coverage(extent) => extent,
            Self::Holes(region) => region.extent(),
        }
    }

    /// The warnings about what an output lacks of the file, and about what was mended to read it.
    #[cfg(feature = "codec")]
    #[must_use]
    pub fn warnings(self, target: &Target, output: &OutputSpec) -> Vec<Warning> {
        let (grey, repairs) = match self {
            Self::Image(image) => (
                image.grey && output.outside.is_grey() && output.encoding(self.depth()).is_grey(),
                image.repairs,
            ),
            Self::Labels(LabelImage {
                labels, repairs, ..
            }) => (labels.shape.grey && labels.palette.is_none(), *repairs),
            Self::Coverage(_) | Self::Holes(_) => return Vec::new(),
        };
        let Some(carried) = self.carried(target) else {
            return Vec::new();
        };
        let (profile, dropped) = carried.losses(output.format, grey);
        let all = [
            (profile, Warning::ProfileDropped),
            (!dropped.is_empty(), Warning::MetadataDropped(dropped)),
            (!repairs.is_empty(), Warning::FileRepaired(repairs)),
        ];
        all.into_iter()
            .filter_map(|(applies, warning)| applies.then_some(warning))
            .collect()
    }

    /// What an output has of the file's metadata.
    #[cfg(feature = "codec")]
    fn carried(self, target: &Target) -> Option<Carried> {
        let metadata = match self {
            Self::Image(image) => &image.metadata,
            Self::Labels(labels) => &labels.metadata,
            Self::Coverage(_) | Self::Holes(_) => return None,
        };
        Some(target.carried(metadata, self.extent()))
    }

    /// The writer of a picture of it.
    ///
    /// # Panics
    /// If the format would change labels; see [`RasterSource::check`].
    #[cfg(feature = "codec")]
    pub(super) fn writer(
        self,
        layout: crate::pixmap::PixelLayout,
        target: &Target,
        encoding: Encoding,
    ) -> Writer {
        let carried = self.carried(target);
        match self {
            Self::Labels(LabelImage { labels, .. }) => {
                let palette = labels.palette.as_ref();
                Writer::of_labels(layout, encoding, palette, carried.as_ref())
                    .expect("the format was checked")
            }
            Self::Image(_) | Self::Coverage(_) | Self::Holes(_) => {
                Writer::new(layout, encoding, carried.as_ref())
            }
        }
    }

    /// The depth of its samples.
    #[must_use]
    pub fn depth(self) -> Depth {
        match self {
            Self::Image(image) => image.source.pixmap().depth(),
            Self::Labels(labels) => labels.labels.shape.depth,
            Self::Coverage(_) | Self::Holes(_) => Depth::Eight,
        }
    }

    /// Checks the format of the output, and a value outside.
    ///
    /// # Errors
    /// Labels in a format that would change them, or with a value outside; a value that the
    /// picture's samples cannot have.
    pub fn check(self, output: &OutputSpec) -> Result<(), WarpError> {
        if let Self::Labels(image) = self {
            if image.labels.is_32_bit {
                return Err(WarpError::WideLabels);
            }
            if !output.format.keeps_labels() {
                return Err(WarpError::LabelFormat {
                    format: output.format,
                });
            }
        }
        self.check_outside(output)
    }

    /// Errors: A value outside of labels, or one that the picture's samples cannot have.
    pub(crate) fn check_outside(self, output: &OutputSpec) -> Result<(), WarpError> {
        let Outside::Value(value) = output.outside else {
            return Ok(());
        };
        match self {
            Self::Labels(_) => Err(WarpError::OutsideOfLabels),
            Self::Image(_) => {
                let (value, most) = (value.into_iter().max().unwrap_or(0), self.depth().largest());
                if value > most {
                    Err(WarpError::OutsideBeyondDepth { value, most })
                } else {
                    Ok(())
                }
            }
            Self::Coverage(_) | Self::Holes(_) => Ok(()),
        }
    }

    /// Memory for preparing the drawing of a posed mesh beyond that of a picture, bytes.
    #[must_use]
    pub fn prepared_bytes(self, posed: &PosedMesh) -> u64 {
        match self {
            Self::Image(_) | Self::Labels(_) | Self::Holes(_) => 0,
            // With a region, that of the picture at rest as well.
            Self::Coverage(_) => {
                Coverage::bytes(posed.mesh()) * if posed.region().is_some() { 2 } else { 1 }
            }
        }
    }

    /// Digest of the source, part of an ETag; different kinds of sources have different digests.
    #[must_use]
    pub fn digest(self) -> Digest {
        match self {
            Self::Image(image) => image.digest(),
            Self::Labels(labels) => Collector::new("mlswarp labels 1")
                .bytes(&labels.digest().0)
                .finish(),
            Self::Coverage(_) => Collector::new("mlswarp coverage 1").finish(),
            Self::Holes(region) => Collector::new("mlswarp holes 1")
                .bytes(&region.digest().0)
                .finish(),
        }
    }

    /// Whether drawing has to make copies of a source first (packed, reduced), which are kept for
    /// later drawings.
    #[must_use]
    pub fn lacks_copies(self, target: Target, posed: &PosedMesh, output: &OutputSpec) -> bool {
        self.sources(posed)
            .any(|source| target.options(output).lacks_copies(source, posed.mesh()))
    }

    /// Makes the copies, for which [`RenderJob::onto`](super::RenderJob::onto) otherwise takes the
    /// time.
    ///
    /// # Errors
    /// Cancelled.
    pub fn make_copies(
        self,
        target: Target,
        posed: &PosedMesh,
        output: &OutputSpec,
        cancelled: IsCancelled<'_>,
    ) -> Result<(), WarpError> {
        let make = |source| {
            target
                .options(output)
                .make_copies(source, posed.mesh(), cancelled)
                .ok_or(WarpError::Cancelled)
        };
        self.sources(posed).try_for_each(make)
    }

    /// The source that is drawn, and the mask of what moves.
    fn sources<'a>(&'a self, posed: &'a PosedMesh) -> impl Iterator<Item = &'a Source> {
        let (drawn, region) = match self {
            Self::Image(image) => (Some(&*image.source), posed.region()),
            Self::Labels(_) | Self::Coverage(_) => (None, posed.region()),
            Self::Holes(region) => (None, Some(*region)),
        };
        drawn.into_iter().chain(region.map(Region::mask))
    }

    pub(super) fn drawer(
        self,
        target: Target,
        posed: &PosedMesh,
        output: &OutputSpec,
    ) -> MeshRenderer {
        let options = target.options(output);
        // Where nothing moves, everything is the same without a region.
        match posed.region().filter(|_| !posed.mesh().is_identity()) {
            Some(region) if !matches!(self, Self::Holes(_)) => MeshRenderer::Region(Box::new(
                RegionDrawer::new(self, region, posed.mesh(), options, output.holes),
            )),
            _ => MeshRenderer::new(self, posed.mesh(), options),
        }
    }
}
