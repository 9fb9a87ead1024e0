//! The source position that each pixel of a target shows: the inverse of the drawn mesh at the
//! pixel's centre.

use std::ops::Range;

use super::canvas::{Canvas, Placement, Window};
use super::drawing::Drawing;
use super::kernel::Kernel;
use super::snapped_grid::SnappedGrid;
use super::{Filter, Outside, RenderOptions};
use crate::geometry::{Mesh, PIXEL_CENTER};
use crate::level::SimdLevel;
use crate::pixmap::Extent;

/// The positions that a target shows, in bands of rows; every division into bands gives the same
/// numbers.
#[derive(Debug)]
pub struct InverseMap {
    target: Extent,
    source: [f64; 2],
    work: MapWork,
}

#[derive(Debug)]
enum MapWork {
    /// The identity. Where the canvas begins, px of the source.
    Identity { x: i32, y: i32 },
    /// One drawing per window.
    Draw(Vec<Drawing>),
}

impl InverseMap {
    /// Prepares the map of a target that shows `canvas`, or the box of the source.
    #[must_use]
    pub fn new(mesh: &Mesh, target: Extent, canvas: Option<Canvas>) -> Self {
        Self::with_level(mesh, target, canvas, SimdLevel::detect())
    }

    /// Like [`Self::new`], for one instruction set; [`SimdLevel::Scalar`] if the machine lacks it.
    /// All levels give the same numbers.
    ///
    /// # Panics
    /// If a side of the mesh's grid is less than a pixel.
    #[must_use]
    pub fn with_level(
        mesh: &Mesh,
        target: Extent,
        canvas: Option<Canvas>,
        level: SimdLevel,
    ) -> Self {
        let grid = mesh.grid();
        #[expect(
            clippy::cast_possible_truncation,
            clippy::cast_sign_loss,
            reason = "a grid is as large as its source"
        )]
        let extent =
            Extent::new(grid.width() as u32, grid.height() as u32).expect("a source has pixels");
        let canvas = canvas.unwrap_or(Canvas::of(extent));
        let work = if target == canvas.extent && mesh.is_identity() {
            MapWork::Identity {
                x: canvas.x,
                y: canvas.y,
            }
        } else {
            let (kernel, placement) = (Kernel::new(level), Placement::new(canvas, target));
            let options = RenderOptions {
                target,
                canvas: Some(canvas),
                filter: Filter::Nearest,
                outside: Outside::Transparent,
                force_alpha: false,
            };
            let draw = |window: Window| {
                let lattice = SnappedGrid::new(
                    mesh,
                    extent,
                    0,
                    Filter::Nearest,
                    (placement.scale, window.origin),
                    kernel,
                );
                Drawing::new(
                    (lattice, None),
                    window,
                    placement.source(grid),
                    options,
                    0,
                    kernel,
                )
            };
            MapWork::Draw(placement.windows().into_iter().map(draw).collect())
        };
        Self {
            target,
            source: [grid.width(), grid.height()],
            work,
        }
    }

    /// Size of the target.
    #[must_use]
    pub const fn target(&self) -> Extent {
        self.target
    }

    /// Upper bound of the pixels whose source positions are computed for a row: a window is
    /// computed from its left edge.
    #[must_use]
    pub fn computed_width(&self) -> u32 {
        match &self.work {
            MapWork::Identity { .. } => self.target.width(),
            MapWork::Draw(drawings) => super::computed_width(drawings),
        }
    }

    /// Writes the source position of every pixel of the target rows `rows`, px; NaN where nothing
    /// is drawn, and also elsewhere when `cancelled` returns true. Shapes: `out: [rows][width]`.
    ///
    /// # Panics
    /// If `rows` leave the target or `out` does not have the size of its shape.
    pub fn rows(&self, rows: Range<u32>, out: &mut [[f32; 2]], cancelled: &dyn Fn() -> bool) {
        assert!(rows.end <= self.target.height(), "rows lie in the target");
        assert_eq!(
            out.len(),
            self.target.width() as usize * rows.len(),
            "one position for each pixel"
        );
        match &self.work {
            MapWork::Identity { x, y } => {
                let [width, height] = self.source;
                for (row, out) in rows.zip(out.chunks_exact_mut(self.target.width() as usize)) {
                    let down = f64::from(*y) + f64::from(row) + PIXEL_CENTER;
                    for (column, out) in (0..).zip(out) {
                        let across = f64::from(*x) + f64::from(column) + PIXEL_CENTER;
                        let is_inside =
                            (0.0..width).contains(&across) && (0.0..height).contains(&down);
                        #[expect(
                            clippy::cast_possible_truncation,
                            reason = "halves of px within a source are exact"
                        )]
                        let position = [across as f32, down as f32];
                        *out = if is_inside { position } else { [f32::NAN; 2] };
                    }
                }
            }
            MapWork::Draw(drawings) => {
                #[expect(
                    clippy::cast_possible_truncation,
                    reason = "a side is a whole number of px"
                )]
                let most = self.source.map(|side| side as f32);
                out.fill([f32::NAN; 2]);
                for drawing in drawings {
                    drawing.positions(&rows, most, out, cancelled);
                }
            }
        }
    }
}
