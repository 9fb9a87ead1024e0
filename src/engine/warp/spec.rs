//! The parameters of a request, as in the contract, before they are resolved and validated.

use std::ops::RangeInclusive;

use super::{CanvasSpec, Quantity, RestMask, Warning, WarpError};
use crate::deform::{Coincident, Handle, Method, Parameters};
use crate::format::{Compression, Encoding, EncodingChoice, Format, ImageLimits, Subsampling};
use crate::pixmap::Depth;
use crate::render::{Filter, Outside};

/// Limits of a warp; each is a flag of the service.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Limits {
    /// Of a source and a target picture.
    pub image: ImageLimits,
    /// Columns of a plan: one per point, two per segment.
    pub columns: usize,
    /// Bytes of a plan's table or a mesh; a larger plan is evaluated without a table, a larger mesh
    /// is refused.
    pub plan_bytes: u64,
    /// Operations of one task, as they are estimated before it begins: see `deploy/capacity.md`.
    pub work: u64,
}

impl Default for Limits {
    /// 50 MP and 16,384 px a side, 10,000 columns, 512 MiB, 12 thousand million operations.
    fn default() -> Self {
        Self {
            image: ImageLimits::default(),
            columns: 10_000,
            plan_bytes: 512 << 20,
            work: 12_000_000_000,
        }
    }
}

/// How the distance of a handle from a position is measured, which its weight falls off with.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Hash)]
pub enum Metric {
    /// In the plane.
    #[default]
    Euclidean,
    /// Along the shortest path inside the mask, of the methods that weigh handles.
    Geodesic,
}

/// The class of maps by which q is aligned; never mirrored except by `Affine`.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Hash)]
pub enum Align {
    /// q is meant as it is.
    #[default]
    None,
    /// Rotations.
    Rigid,
    /// Rotations with a uniform scale.
    Similarity,
    /// Affine maps.
    Affine,
}

/// The unit of p and q.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Hash)]
pub enum Units {
    /// Pixels of the source.
    #[default]
    Px,
    /// x/W and y/H.
    Normalized,
}

/// The requested grid.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub enum GridSpec {
    /// The default tolerance.
    #[default]
    Auto,
    /// Cells of `clamp(min(W, H) / 100, 4, 8)` px, drawn as smaller ones where they would be
    /// farther than this from the exact map, px.
    Tolerance(f64),
    /// Cells of this size, px.
    Cell(f64),
    /// This number of vertices.
    Counts {
        /// Vertices in a row.
        columns: u32,
        /// Vertices in a column.
        rows: u32,
    },
    /// A vertex at every pixel corner.
    Pixel,
}

impl GridSpec {
    /// The tolerance of [`GridSpec::Auto`], px.
    pub const DEFAULT_TOLERANCE_PX: f64 = 0.25;
    /// The tolerances that can be requested, px.
    pub const TOLERANCE_RANGE_PX: RangeInclusive<f64> = 0.05..=4.0;

    /// The tolerance of the drawn picture, px; `None` if cells are drawn as they are.
    #[must_use]
    pub const fn tolerance(self) -> Option<f64> {
        match self {
            Self::Auto => Some(Self::DEFAULT_TOLERANCE_PX),
            Self::Tolerance(tolerance) => Some(tolerance),
            Self::Cell(_) | Self::Counts { .. } | Self::Pixel => None,
        }
    }
}

/// The treatment of folds of the posed grid.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Hash)]
pub enum Folds {
    /// Draw them and count the cells.
    #[default]
    Report,
    /// Refuse the request.
    Reject,
    /// Where the map folds, another one without folds, if there is one.
    Remove,
}

impl Folds {
    /// What is measured of a pose: folds that would be refused are reported.
    #[must_use]
    pub fn measured(self) -> Self {
        if self == Self::Reject {
            Self::Report
        } else {
            self
        }
    }
}

/// The parameters that stay the same while q changes, not yet resolved or validated.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct RestSpec {
    /// Handles at rest.
    pub p: Vec<Handle>,
    /// One weight per handle.
    pub weights: Option<Vec<f64>>,
    /// One depth per handle, default 0: where the posed image overlaps itself, cells of more depth
    /// lie in front.
    pub depth: Option<Vec<f64>>,
    /// The method.
    pub method: Method,
    /// Fall-off; default 1 for points alone, 2 with any line. Whether a method has this parameter
    /// and the following ones: [`MethodInfo`](crate::deform::MethodInfo).
    pub alpha: Option<f64>,
    /// Mass of a point in a mixed set, px; default the mean length of the segments.
    pub point_mass: Option<f64>,
    /// 0, the default, goes through the posed handles.
    pub smoothing: Option<f64>,
    /// Parameters that stand in an object of their method.
    pub own: Parameters,
    /// The metric.
    pub metric: Metric,
    /// The share of full alpha above which a pixel belongs to the mask; default
    /// [`RestMask::THRESHOLD`].
    pub mask_threshold: Option<f64>,
    /// The pixels that handles can act through, if the metric or the method needs to know them,
    /// made from the image and the threshold.
    pub mask: Option<RestMask>,
    /// The treatment of handles that coincide at rest.
    pub coincident: Coincident,
    /// Unit of p and q.
    pub units: Units,
    /// How q is brought to the frame of p, before anything else.
    pub align: Align,
    /// The grid.
    pub grid: GridSpec,
    /// Whether landmarks were left out before because one side does not have them.
    pub has_unmatched: bool,
}

/// The fall-off inside a mask, if none is given.
const GEODESIC_ALPHA: f64 = 2.0;

impl RestSpec {
    /// Leaves out the handles that are missing at rest or in `q`, on both sides. They keep their
    /// indices. A `q` of another number of handles is left as it is, to be refused.
    pub fn leave_out_missing(&mut self, q: &mut [Handle]) {
        if self.p.len() != q.len() {
            return;
        }
        for (p, q) in self.p.iter_mut().zip(q) {
            if [&*p, &*q].contains(&&Handle::Missing) {
                (*p, *q) = (Handle::Missing, Handle::Missing);
            }
        }
    }

    /// What was left out of the handles.
    pub fn left_out(&self) -> impl Iterator<Item = Warning> {
        let missing = self
            .p
            .iter()
            .enumerate()
            .filter(|(_, handle)| **handle == Handle::Missing);
        let handles: Vec<usize> = missing.map(|(index, _)| index).collect();
        let missing = (!handles.is_empty()).then_some(Warning::HandlesMissing { handles });
        missing
            .into_iter()
            .chain(self.has_unmatched.then_some(Warning::LandmarksUnmatched))
    }

    /// All parameters that are given.
    #[must_use]
    pub fn parameters(&self) -> Parameters {
        // Inside a mask the neighbours of a handle are far: a steeper fall-off keeps them still.
        let is_inside =
            self.metric == Metric::Geodesic && self.method.info().parameter("alpha").is_some();
        let alpha = self.alpha.or(is_inside.then_some(GEODESIC_ALPHA));
        self.own
            .with_some("alpha", alpha)
            .with_some("point_mass", self.point_mass)
            .with_some("smoothing", self.smoothing)
    }

    /// Checks the treatment of folds, before anything is computed.
    ///
    /// # Errors
    /// A method or metric whose folds cannot be removed.
    pub fn check_folds(&self, folds: Folds) -> Result<(), WarpError> {
        let info = self.method.info();
        let is_exact = info.interpolates(&self.parameters());
        let can_unfold = info.can_unfold && is_exact && self.metric == Metric::Euclidean;
        if folds == Folds::Remove && !can_unfold {
            return Err(WarpError::NotUnfolded);
        }
        Ok(())
    }

    /// Whether there must be a mask.
    #[must_use]
    pub fn needs_mask(&self) -> bool {
        self.metric == Metric::Geodesic || self.method.info().mesh.is_some()
    }
}

/// Memory of the linear system of a method for this number of handles, bytes.
#[must_use]
pub fn system_bytes(method: Method, handles: u64) -> u64 {
    method.info().system.as_ref().map_or(0, |system| {
        let (_, most) = system.most_handles;
        (system.bytes)(handles.min(most))
    })
}

/// What a region shows where its content moved away and nothing covers it.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Hash)]
pub enum Holes {
    /// The source.
    #[default]
    Keep,
    /// Nothing.
    Transparent,
}

/// The parameters of the output.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub struct OutputSpec {
    /// File format.
    pub format: Format,
    /// JPEG quality, 1 to 100.
    pub quality: u8,
    /// Resolution of a JPEG's colours; default half below quality 90.
    pub subsampling: Option<Subsampling>,
    /// PNG and TIFF compression.
    pub compression: Compression,
    /// The part of the posed plane that is drawn.
    pub canvas: CanvasSpec,
    /// Width of the target, px; default the canvas's. Height = max(1, round(H w / W)).
    pub width: Option<u32>,
    /// The sampling filter.
    pub filter: Filter,
    /// What fills pixels that the posed picture does not cover.
    pub outside: Outside,
    /// What a region shows where its content moved away.
    pub holes: Holes,
}

/// JPEG quality if none is requested.
const DEFAULT_JPEG_QUALITY: u8 = 85;

impl Default for OutputSpec {
    /// A PNG of the source's size, fast compression, bilinear, transparent outside.
    fn default() -> Self {
        Self {
            format: Format::default(),
            quality: DEFAULT_JPEG_QUALITY,
            subsampling: None,
            compression: Compression::default(),
            canvas: CanvasSpec::default(),
            width: None,
            filter: Filter::default(),
            outside: Outside::default(),
            holes: Holes::default(),
        }
    }
}

impl OutputSpec {
    /// The encoding of a picture from a source of this depth. The background of a JPEG is the
    /// colour outside, or white.
    #[must_use]
    pub fn encoding(&self, depth: Depth) -> Encoding {
        let ground = match self.outside {
            Outside::Colour([r, g, b, _]) => [r, g, b],
            Outside::Value(value) => value.map(|sample| in_eight(sample, depth)),
            Outside::Transparent | Outside::Edge | Outside::Reflect => [255; 3],
        };
        let choice = EncodingChoice {
            compression: self.compression,
            quality: self.quality,
            subsampling: self.subsampling,
            ground,
        };
        Encoding::of(self.format, choice)
    }
}

/// A sample in 8 bit: of 16, the nearest.
fn in_eight(sample: u16, depth: Depth) -> u8 {
    let largest = u32::from(depth.largest());
    u8::try_from((u32::from(sample) * 255 + largest / 2) / largest).unwrap_or(u8::MAX)
}

/// Returns an error if a number exceeds a limit.
pub(super) fn at_most(what: Quantity, limit: u64, actual: u64) -> Result<(), WarpError> {
    if actual > limit {
        Err(WarpError::TooLarge {
            what,
            limit,
            actual,
        })
    } else {
        Ok(())
    }
}
