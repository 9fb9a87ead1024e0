//! The rasteriser: draws the posed grid as one bilinear patch per cell. Each row is drawn in two
//! phases: first the source position that each pixel centre shows (`drawing`: by column crossings
//! or cell by cell), then the samples (`kernel`, `sampler`). Exact integer rules on vertices
//! snapped to 1/256 px assign each pixel to a cell, so that cells neither overlap nor leave gaps;
//! under folds the later cell in row order wins, or in the order that the mesh has. Output:
//! straight samples of the target. Cost: O(vertices) to prepare, O(pixels) to draw.

use std::{ops::Range, sync::Arc};

use crate::geometry::Mesh;
use crate::level::SimdLevel;
use crate::pixmap::{Channels, Depth, Extent};

#[forbid(unsafe_code)]
mod bicubic;
#[forbid(unsafe_code)]
mod blend;
#[forbid(unsafe_code)]
mod border;
#[forbid(unsafe_code)]
mod canvas;
#[forbid(unsafe_code)]
mod cell;
#[forbid(unsafe_code)]
mod coverage;
#[forbid(unsafe_code)]
mod drawing;
#[forbid(unsafe_code)]
mod edge;
#[forbid(unsafe_code)]
mod fixed_point;
#[forbid(unsafe_code)]
mod footprint;
#[forbid(unsafe_code)]
mod inverse_map;
mod kernel;
#[forbid(unsafe_code)]
mod mirror;
#[forbid(unsafe_code)]
mod patch;
#[forbid(unsafe_code)]
mod row_split;
#[forbid(unsafe_code)]
mod row_strategy;
#[forbid(unsafe_code)]
mod sampler;
#[forbid(unsafe_code)]
mod snap;
mod snap_cut;
#[forbid(unsafe_code)]
mod snap_subdivided;
#[forbid(unsafe_code)]
mod snapped_cut;
#[forbid(unsafe_code)]
mod snapped_grid;
#[forbid(unsafe_code)]
mod source;
#[forbid(unsafe_code)]
mod subdivided_cells;
#[cfg(test)]
#[forbid(unsafe_code)]
mod tests;

pub use blend::{FULL_WEIGHT, blend};
pub use canvas::{Canvas, window_count};
pub use coverage::Coverage;
pub(crate) use drawing::STRIP_ROWS;
pub use inverse_map::InverseMap;
pub use source::Source;

use canvas::{Placement, Window};
use drawing::Drawing;
use footprint::Footprints;
use kernel::Kernel;
use snapped_grid::SnappedGrid;

/// How the source is sampled between its pixel centres.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Hash)]
pub enum Filter {
    /// The pixel that contains the position.
    Nearest,
    /// Linear in x and y between the four nearest pixel centres.
    #[default]
    Bilinear,
    /// Catmull-Rom in x and y, over the sixteen nearest pixel centres.
    Bicubic,
}

/// What fills target pixels that the posed image does not cover.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Hash)]
pub enum Outside {
    /// Transparent black.
    #[default]
    Transparent,
    /// The colour of the nearest position on the posed border.
    Edge,
    /// The source mirrored beyond the posed border, its outermost pixels repeated.
    Reflect,
    /// One colour, straight 8-bit RGBA.
    Colour([u8; 4]),
    /// One opaque colour in units of the source's depth, at most its largest sample.
    Value([u16; 3]),
}

impl Outside {
    /// Whether it adds no colour to a grey image.
    #[must_use]
    pub fn is_grey(self) -> bool {
        match self {
            Self::Transparent | Self::Edge | Self::Reflect => true,
            Self::Colour([r, g, b, _]) => r == g && g == b,
            Self::Value([r, g, b]) => r == g && g == b,
        }
    }
}

/// How the mesh is drawn.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub struct RenderOptions {
    /// Size of the target image; the canvas is scaled to it.
    pub target: Extent,
    /// The part of the posed plane that is drawn; default the box of the source.
    pub canvas: Option<Canvas>,
    /// How the source is sampled.
    pub filter: Filter,
    /// What fills target pixels that the posed image does not cover.
    pub outside: Outside,
    /// Whether the target has alpha even if every pixel is opaque.
    pub force_alpha: bool,
}

impl RenderOptions {
    /// Whether this drawing of a source has to make copies of it first (packed, reduced). They are
    /// kept for later drawings.
    #[must_use]
    pub fn lacks_copies(&self, source: &Source, mesh: &Mesh) -> bool {
        !self.is_copy(source, mesh)
            && source.lacks_copies(self.placement(source).source(mesh.grid()), self.is_packed())
    }

    /// Makes the copies, for which [`Renderer::new`] otherwise takes the time: up to a nanosecond
    /// or two per pixel of the source. `None` when cancelled.
    pub fn make_copies(
        &self,
        source: &Source,
        mesh: &Mesh,
        cancelled: &dyn Fn() -> bool,
    ) -> Option<()> {
        if !self.is_copy(source, mesh) {
            source.make_copies(
                self.placement(source).source(mesh.grid()),
                self.is_packed(),
                cancelled,
            )?;
        }
        Some(())
    }

    /// Whether samples are copied as they are.
    fn is_copy(&self, source: &Source, mesh: &Mesh) -> bool {
        self.target == self.canvas_on(source).extent && mesh.is_identity()
    }

    fn canvas_on(&self, source: &Source) -> Canvas {
        self.canvas.unwrap_or(Canvas::of(source.pixmap().extent()))
    }

    fn placement(&self, source: &Source) -> Placement {
        Placement::new(self.canvas_on(source), self.target)
    }

    /// Whether packed texels are read, at 8 bit.
    fn is_packed(&self) -> bool {
        self.filter != Filter::Nearest
    }
}

/// Draws a mesh of a source image, in bands of rows; every division into bands gives the same
/// bytes.
#[derive(Debug)]
pub struct Renderer {
    source: Arc<Source>,
    options: RenderOptions,
    channels: Channels,
    level: SimdLevel,
    work: Work,
}

/// What a renderer draws.
#[derive(Debug)]
enum Work {
    /// The identity: samples are copied. Where the canvas begins, px of the source.
    Copy { x: i32, y: i32 },
    /// One drawing per window.
    Draw(Vec<Drawing>),
}

impl Renderer {
    /// Prepares the drawing (lattice, coordinate scale, reduced source); draws nothing.
    #[must_use]
    pub fn new(source: Arc<Source>, mesh: &Mesh, options: RenderOptions) -> Self {
        Self::with_level(source, mesh, options, SimdLevel::detect())
    }

    /// Like [`Self::new`], for one instruction set; [`SimdLevel::Scalar`] if the machine lacks it.
    /// All levels give the same bytes.
    #[must_use]
    pub fn with_level(
        source: Arc<Source>,
        mesh: &Mesh,
        options: RenderOptions,
        level: SimdLevel,
    ) -> Self {
        let kernel = Kernel::new(level);
        let pixmap = source.pixmap();
        let (work, uncovered) = if options.is_copy(&source, mesh) {
            let canvas = options.canvas_on(&source);
            (
                Work::Copy {
                    x: canvas.x,
                    y: canvas.y,
                },
                !sampler::covers(pixmap.extent(), canvas),
            )
        } else {
            let placement = options.placement(&source);
            // Not in the first band.
            let copies =
                source.make_copies(placement.source(mesh.grid()), options.is_packed(), &|| {
                    false
                });
            let k = copies.expect("nothing gives it up");
            let shrinking = if options.filter == Filter::Nearest || mesh.cut_mesh().is_some() {
                Vec::new()
            } else {
                let (whole, sampled) = (pixmap.extent(), source.level(k).pixmap().extent());
                let sampled = [
                    (sampled.width(), whole.width()),
                    (sampled.height(), whole.height()),
                ];
                let sampled = sampled.map(|(sampled, whole)| f64::from(sampled) / f64::from(whole));
                footprint::shrinking_cells(mesh, sampled, placement.scale, kernel)
            };
            let draw = |window: Window| {
                let lattice = SnappedGrid::new(
                    mesh,
                    pixmap.extent(),
                    k,
                    options.filter,
                    (placement.scale, window.origin),
                    kernel,
                );
                let size = (window.columns.end, window.rows.end);
                let footprints = (!shrinking.is_empty()).then(|| {
                    Footprints::new(mesh, &shrinking, &lattice, placement.scale, size, kernel)
                });
                Drawing::new(
                    (lattice, footprints),
                    window,
                    placement.source(mesh.grid()),
                    options,
                    k,
                    kernel,
                )
            };
            let drawings: Vec<_> = placement.windows().into_iter().map(draw).collect();
            let uncovered = drawings.iter().any(|drawing| !drawing.covered);
            (Work::Draw(drawings), uncovered)
        };
        let clear = match options.outside {
            Outside::Transparent => uncovered,
            Outside::Colour(colour) => uncovered && colour[3] < u8::MAX,
            Outside::Edge | Outside::Reflect | Outside::Value(_) => false,
        };
        let channels = if clear || options.force_alpha {
            Channels::Rgba
        } else {
            pixmap.channels()
        };
        Self {
            source,
            options,
            channels,
            level: kernel.level(),
            work,
        }
    }

    /// Samples points from now on, also where the source is shrunk.
    #[cfg(test)]
    pub(crate) fn sample_points(&mut self) {
        if let Work::Draw(drawings) = &mut self.work {
            drawings.iter_mut().for_each(Drawing::sample_points);
        }
    }

    /// Size of the target.
    #[must_use]
    pub const fn target(&self) -> Extent {
        self.options.target
    }

    /// Upper bound of the pixels whose source positions are computed to draw a row: a window is
    /// computed from its left edge.
    #[must_use]
    pub fn computed_width(&self) -> u32 {
        match &self.work {
            Work::Copy { .. } => self.options.target.width(),
            Work::Draw(drawings) => computed_width(drawings),
        }
    }

    /// Whether the target has alpha and the source has none.
    #[must_use]
    pub fn adds_alpha(&self) -> bool {
        self.channels != self.source.pixmap().channels()
    }

    /// RGBA if the source has alpha, some target pixel may need it or it was requested, otherwise
    /// RGB.
    #[must_use]
    pub const fn channels(&self) -> Channels {
        self.channels
    }

    /// The depth of the source.
    #[must_use]
    pub fn depth(&self) -> Depth {
        self.source.pixmap().depth()
    }

    /// The instruction set in use.
    #[must_use]
    pub const fn level(&self) -> SimdLevel {
        self.level
    }

    /// Draws the target rows `rows`, or less when `cancelled` returns true. Shapes:
    /// `out: [rows][width][channels]`, straight samples in PNG order (16-bit big-endian).
    ///
    /// # Panics
    /// If `rows` leave the target or `out` does not have the size of its shape.
    pub fn band(&self, rows: Range<u32>, out: &mut [u8], cancelled: &dyn Fn() -> bool) {
        assert!(
            rows.end <= self.options.target.height(),
            "rows lie in the target"
        );
        let size = self.options.target.width() as usize
            * self.channels.count()
            * self.depth().bytes()
            * rows.len();
        assert_eq!(out.len(), size, "one sample for each channel of each pixel");
        let pixmap = self.source.pixmap();
        match &self.work {
            Work::Copy { x: 0, y: 0 }
                if self.options.target == pixmap.extent() && !self.adds_alpha() =>
            {
                sampler::copy(pixmap, rows, out)
            }
            Work::Copy { x, y } => {
                for (row, out) in rows.clone().zip(out.chunks_exact_mut(size / rows.len())) {
                    sampler::copy_row(
                        pixmap,
                        (i64::from(*x), i64::from(*y) + i64::from(row)),
                        self.options.outside,
                        self.channels,
                        out,
                    );
                }
            }
            Work::Draw(drawings) => {
                for drawing in drawings {
                    drawing.band(&self.source, self.channels, (&rows, out), cancelled);
                }
            }
        }
    }
}

/// The rows of a band in which about `pixels` source positions are computed, `width` per row: a
/// multiple of [`STRIP_ROWS`], which is drawn at once.
pub(crate) fn band_rows(pixels: u32, width: u32) -> u32 {
    (pixels / width.max(1))
        .next_multiple_of(STRIP_ROWS)
        .max(STRIP_ROWS)
}

/// Upper bound of the pixels whose source positions are computed to draw a row.
fn computed_width(drawings: &[Drawing]) -> u32 {
    drawings
        .iter()
        .map(Drawing::width)
        .max()
        .map_or(0, |width| u32::try_from(width).unwrap_or(u32::MAX))
}
