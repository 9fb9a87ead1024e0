//! Draws the rows of a source; each kind of source has its variant. Every division into bands
//! gives the same bytes.

pub(super) mod region;

use std::ops::Range;
use std::sync::Arc;

use self::region::{HolesDrawer, RegionDrawer};
use super::{Image, LabelImage, RasterSource};
use crate::geometry::Mesh;
use crate::pixmap::{Channels, Depth, Extent, Labels, PixelLayout};
use crate::render::{Coverage, InverseMap, RenderOptions, Renderer};

/// Samples along a side of a pixel whose coverage by a cut grid is counted.
const SAMPLES: u32 = 4;

/// Draws one source.
#[derive(Debug)]
pub(super) enum MeshRenderer {
    /// A picture.
    Image {
        renderer: Renderer,
        /// Whether one sample is enough for the three colours.
        grey: bool,
    },
    /// Labels.
    Labels {
        inverse: InverseMap,
        labels: Arc<Labels>,
    },
    /// Coverage.
    Coverage(Box<Coverage>),
    /// Coverage of a cut grid: the positions that a target of [`SAMPLES`] times its sides shows.
    CutCoverage { inverse: InverseMap, target: Extent },
    /// A picture, labels or coverage, of which only the content of a region moves.
    Region(Box<RegionDrawer>),
    /// The holes that a region leaves.
    Holes(Box<HolesDrawer>),
}

impl MeshRenderer {
    /// Draws a source through a mesh, without a region.
    pub(super) fn new(source: RasterSource<'_>, mesh: &Mesh, options: RenderOptions) -> Self {
        match source {
            RasterSource::Image(image) => Self::image(image, mesh, options),
            RasterSource::Labels(labels) => Self::labels(labels, mesh, options),
            RasterSource::Coverage(_) if mesh.cut_mesh().is_some() => {
                let [width, height] = [options.target.width(), options.target.height()]
                    .map(|side| side.saturating_mul(SAMPLES));
                let samples = Extent::new(width, height).unwrap_or(options.target);
                Self::CutCoverage {
                    inverse: InverseMap::new(mesh, samples, options.canvas),
                    target: options.target,
                }
            }
            RasterSource::Coverage(_) => Self::Coverage(Box::new(Coverage::new(
                mesh,
                options.target,
                options.canvas,
            ))),
            RasterSource::Holes(region) => {
                Self::Holes(Box::new(HolesDrawer::new(region, mesh, options)))
            }
        }
    }

    fn image(image: &Image, mesh: &Mesh, options: RenderOptions) -> Self {
        let renderer = Renderer::new(Arc::clone(&image.source), mesh, options);
        Self::Image {
            renderer,
            grey: image.grey && options.outside.is_grey(),
        }
    }

    fn labels(image: &LabelImage, mesh: &Mesh, options: RenderOptions) -> Self {
        let inverse = InverseMap::new(mesh, options.target, options.canvas);
        Self::Labels {
            inverse,
            labels: Arc::clone(&image.labels),
        }
    }

    /// Size of the target.
    pub(super) fn target(&self) -> Extent {
        match self {
            Self::Image { renderer, .. } => renderer.target(),
            Self::Labels { inverse, .. } => inverse.target(),
            Self::Coverage(coverage) => coverage.target(),
            Self::CutCoverage { target, .. } => *target,
            Self::Region(drawer) => drawer.target(),
            Self::Holes(drawer) => drawer.target(),
        }
    }

    /// The layout of what is drawn, where grey takes one sample. The samples of a grey picture are
    /// drawn in colour, those of labels are not.
    pub(super) fn layout(&self) -> PixelLayout {
        match self {
            Self::Image { renderer, grey } => PixelLayout {
                extent: renderer.target(),
                channels: renderer.channels(),
                grey: *grey,
                depth: renderer.depth(),
            },
            Self::Region(drawer) => drawer.layout(),
            Self::Labels { inverse, labels } => PixelLayout {
                extent: inverse.target(),
                ..labels.shape
            },
            Self::Coverage(_) | Self::CutCoverage { .. } | Self::Holes(_) => PixelLayout {
                extent: self.target(),
                channels: Channels::Rgb,
                grey: true,
                depth: Depth::Eight,
            },
        }
    }

    /// Whether what is drawn has alpha and the source has none.
    #[cfg(feature = "codec")]
    pub(super) fn adds_alpha(&self) -> bool {
        match self {
            Self::Image { renderer, .. } => renderer.adds_alpha(),
            Self::Region(drawer) => drawer.adds_alpha(),
            Self::Labels { .. } | Self::Coverage(_) | Self::CutCoverage { .. } | Self::Holes(_) => {
                false
            }
        }
    }

    /// Bytes of a pixel that is drawn.
    pub(super) fn pixel_bytes(&self) -> usize {
        match self {
            Self::Image { renderer, .. } => renderer.channels().count() * renderer.depth().bytes(),
            Self::Labels { labels, .. } => labels.shape.pixel_bytes(),
            Self::Coverage(_) | Self::CutCoverage { .. } | Self::Holes(_) => Channels::Rgb.count(),
            Self::Region(drawer) => drawer.pixel_bytes(),
        }
    }

    /// Upper bound of the pixels whose source positions are computed to draw a row.
    pub(super) fn computed_width(&self) -> u32 {
        match self {
            Self::Image { renderer, .. } => renderer.computed_width(),
            Self::Labels { inverse, .. } => inverse.computed_width(),
            Self::Coverage(coverage) => coverage.computed_width(),
            Self::CutCoverage { inverse, .. } => inverse.computed_width().saturating_mul(SAMPLES),
            Self::Region(drawer) => drawer.computed_width(),
            Self::Holes(drawer) => drawer.computed_width(),
        }
    }

    /// Memory for drawing beside the samples that are drawn, bytes.
    #[cfg(feature = "codec")]
    pub(super) fn work_bytes(&self) -> u64 {
        match self {
            Self::Image { .. }
            | Self::Labels { .. }
            | Self::Coverage(_)
            | Self::CutCoverage { .. } => 0,
            Self::Region(_) | Self::Holes(_) => region::work_bytes(self.target()),
        }
    }

    /// Draws the target rows `rows`, or anything when cancelled. Shapes:
    /// `out: [rows][width][pixel_bytes]`, samples in PNG order (16-bit big-endian).
    pub(super) fn band(&self, rows: Range<u32>, out: &mut [u8], cancelled: &dyn Fn() -> bool) {
        match self {
            Self::Image { renderer, .. } => renderer.band(rows, out, cancelled),
            Self::Labels { inverse, labels } => draw_labels(inverse, labels, rows, out, cancelled),
            Self::Coverage(coverage) => {
                let mut shares = vec![0; out.len() / 3];
                coverage.rows(rows, &mut shares, cancelled);
                for (pixel, share) in out.as_chunks_mut::<3>().0.iter_mut().zip(shares) {
                    *pixel = [share; 3];
                }
            }
            Self::CutCoverage { inverse, target } => {
                draw_cut_coverage(inverse, *target, rows, out, cancelled);
            }
            Self::Region(drawer) => drawer.band(rows, out, cancelled),
            Self::Holes(drawer) => drawer.band(rows, out, cancelled),
        }
    }
}

/// The share of the samples of each pixel that show something.
fn draw_cut_coverage(
    inverse: &InverseMap,
    target: Extent,
    rows: Range<u32>,
    out: &mut [u8],
    cancelled: &dyn Fn() -> bool,
) {
    let (side, width) = (SAMPLES as usize, target.width() as usize);
    let mut positions = vec![[0.0; 2]; side * side * width];
    for (row, out) in rows.zip(out.chunks_exact_mut(3 * width)) {
        let samples = row * SAMPLES..(row + 1) * SAMPLES;
        inverse.rows(samples, &mut positions, cancelled);
        for (x, pixel) in out.as_chunks_mut::<3>().0.iter_mut().enumerate() {
            let samples = positions
                .chunks_exact(side * width)
                .flat_map(|row| &row[side * x..side * (x + 1)]);
            let shown = samples.filter(|[x, _]| !x.is_nan()).count();
            let all = side * side;
            #[expect(clippy::cast_possible_truncation, reason = "at most 255")]
            let share = ((shown * usize::from(u8::MAX) + all / 2) / all) as u8;
            *pixel = [share; 3];
        }
    }
}

/// Each pixel takes the label of the source pixel that contains its position, or 0.
fn draw_labels(
    inverse: &InverseMap,
    labels: &Labels,
    rows: Range<u32>,
    out: &mut [u8],
    cancelled: &dyn Fn() -> bool,
) {
    let shape = labels.shape;
    let pixel = shape.pixel_bytes();
    let mut positions = vec![[0.0; 2]; out.len() / pixel];
    inverse.rows(rows, &mut positions, cancelled);
    let (width, height) = (
        shape.extent.width() as usize,
        shape.extent.height() as usize,
    );
    for (out, [x, y]) in out.chunks_exact_mut(pixel).zip(positions) {
        if x.is_nan() {
            out.fill(0);
        } else {
            #[expect(
                clippy::cast_possible_truncation,
                clippy::cast_sign_loss,
                reason = "positions in the source"
            )]
            let (x, y) = ((x as usize).min(width - 1), (y as usize).min(height - 1));
            out.copy_from_slice(&labels.values[(y * width + x) * pixel..][..pixel]);
        }
    }
}
