//! How much of each pixel the posed image covers. A pixel that no outline crosses is covered if
//! its centre is. For the others, the area of the union of the cells in them is computed. Outlines
//! are the border of the posed image and the edges of folded cells: away from these, either all
//! or nothing of a pixel is covered. Accuracy: half a step of 8 bit; where folded cells overlap in
//! a pixel, the area is summed over slices of 1/16 px.

use std::ops::{ControlFlow, Range};
use std::sync::{Arc, Mutex, PoisonError};

use super::canvas::Canvas;
use super::inverse_map::InverseMap;
use crate::geometry::{CellTree, Mesh, Orientation, Point, SubdividedCell};
use crate::pixmap::Extent;

/// Pixels nearer than this to an outline are measured, px: the renderer snaps vertices, which may
/// move an outline past a pixel's centre.
const NEAR_OUTLINE_PX: f64 = 1.0 / 64.0;
/// Up to this number of triangles that do not overlap in a pixel, their area is exact.
const MAX_EXACT: usize = 64;
/// The slices of a pixel with more triangles, or with triangles that overlap.
const PIXEL_SLICES: u32 = 16;
/// A pixel with more triangles is covered if its centre is. This bounds the work where a large part
/// of the image shrinks into one pixel.
const MAX_TRIANGLES: usize = 4096;

/// Draws coverage in bands of rows; every division into bands gives the same bytes.
#[derive(Debug)]
pub struct Coverage {
    inverse: InverseMap,
    mesh: Mesh,
    /// Where the canvas begins, and target px per px.
    origin: Point,
    scale: [f64; 2],
    /// Made for the first rows, as that can be cancelled.
    search: Mutex<Option<Arc<CellSearch>>>,
}

/// Where the posed cells are.
#[derive(Debug)]
struct CellSearch {
    tree: CellTree,
    /// Px of the target.
    outlines: Vec<[Point; 2]>,
}

impl Coverage {
    /// Prepares the drawing of a target that shows `canvas`, or the box of the source.
    #[must_use]
    pub fn new(mesh: &Mesh, target: Extent, canvas: Option<Canvas>) -> Self {
        let [x, y, right, bottom] = canvas.map_or(
            [0.0, 0.0, mesh.grid().width(), mesh.grid().height()],
            |canvas| canvas.edges(),
        );
        let scale = [
            f64::from(target.width()) / (right - x),
            f64::from(target.height()) / (bottom - y),
        ];
        Self {
            inverse: InverseMap::new(mesh, target, canvas),
            mesh: mesh.clone(),
            origin: Point::new(x, y),
            scale,
            search: Mutex::new(None),
        }
    }

    /// `None` when cancelled, which is asked for each row of the grid.
    fn search(&self, cancelled: &dyn Fn() -> bool) -> Option<Arc<CellSearch>> {
        let mut search = self.search.lock().unwrap_or_else(PoisonError::into_inner);
        if search.is_none() {
            let (tree, outlines) = (
                CellTree::unless(&self.mesh, cancelled)?,
                self.outlines(cancelled)?,
            );
            *search = Some(Arc::new(CellSearch { tree, outlines }));
        }
        search.clone()
    }

    /// Upper bound of the memory beside that of drawing an image, bytes.
    #[must_use]
    pub fn bytes(mesh: &Mesh) -> u64 {
        /// A displacement, a box and a third of one; of folded cells also six lines of two
        /// positions.
        const VERTEX_BYTES: u64 = 32 + 6 * 32;
        mesh.vertices() * VERTEX_BYTES
    }

    /// Size of the target.
    #[must_use]
    pub const fn target(&self) -> Extent {
        self.inverse.target()
    }

    /// Upper bound of the pixels whose source positions are computed to draw a row.
    #[must_use]
    pub fn computed_width(&self) -> u32 {
        self.inverse.computed_width()
    }

    /// Writes the coverage of every pixel of the target rows `rows`, 0 to 255; anything when
    /// `cancelled` returns true. Shapes: `out: [rows][width]`.
    ///
    /// # Panics
    /// If `rows` leave the target or `out` does not have the size of its shape.
    pub fn rows(&self, rows: Range<u32>, out: &mut [u8], cancelled: &dyn Fn() -> bool) {
        let Some(search) = self.search(cancelled) else {
            return;
        };
        let mut positions = vec![[0.0; 2]; out.len()];
        self.inverse.rows(rows.clone(), &mut positions, cancelled);
        for (out, [u, _]) in out.iter_mut().zip(&positions) {
            *out = if u.is_nan() { 0 } else { u8::MAX };
        }
        let width = self.target().width();
        let mut is_measured = vec![false; out.len()];
        let mut triangles = Vec::new();
        for outline in &search.outlines {
            if cancelled() {
                return;
            }
            pixels_near(outline, &rows, width, |x, y| {
                let index = (y - rows.start) as usize * width as usize + x as usize;
                if !std::mem::replace(&mut is_measured[index], true)
                    && let Some(share) = self.share(&search.tree, [x, y], &mut triangles)
                {
                    #[expect(
                        clippy::cast_possible_truncation,
                        clippy::cast_sign_loss,
                        reason = "0 to 255"
                    )]
                    let value = (share * 255.0).round() as u8;
                    out[index] = value;
                }
            });
        }
    }

    /// The covered share of a pixel; `None` if too many triangles are in it.
    fn share(
        &self,
        tree: &CellTree,
        [x, y]: [u32; 2],
        triangles: &mut Vec<[Point; 3]>,
    ) -> Option<f64> {
        triangles.clear();
        let corner = |x: f64, y: f64| {
            Point::new(
                self.origin.x + x / self.scale[0],
                self.origin.y + y / self.scale[1],
            )
        };
        let (from, to) = (
            corner(x.into(), y.into()),
            corner(f64::from(x) + 1.0, f64::from(y) + 1.0),
        );
        let mut is_covered = false;
        let _ = tree.visit([from.x, from.y, to.x, to.y], &mut |cell| {
            self.quads(cell, |quad| {
                for triangle in halves(
                    quad.map(|p| self.on_target(p) - Point::new(x.into(), y.into()))
                        .map(|p| Point::new(p.x, p.y)),
                ) {
                    if contains_pixel(&triangle) {
                        is_covered = true;
                    } else if meets_pixel(&triangle) {
                        triangles.push(triangle);
                    }
                }
            });
            if is_covered || triangles.len() > MAX_TRIANGLES {
                ControlFlow::Break(())
            } else {
                ControlFlow::Continue(())
            }
        });
        match (is_covered, triangles.len() > MAX_TRIANGLES) {
            (true, _) => Some(1.0),
            (_, true) => None,
            _ => Some(area_of_union(triangles)),
        }
    }

    fn on_target(&self, p: Point) -> Point {
        Point::new(
            (p.x - self.origin.x) * self.scale[0],
            (p.y - self.origin.y) * self.scale[1],
        )
    }

    /// Calls `quad` for the posed cell at an index, or for the smaller cells that it is divided
    /// into: corners 00, 10, 11, 01.
    fn quads(&self, cell: usize, mut quad: impl FnMut([Point; 4])) {
        let columns = self.mesh.grid().columns() as usize - 1;
        #[expect(
            clippy::cast_possible_truncation,
            reason = "columns and rows of a grid are u32"
        )]
        let (i, j) = ((cell % columns) as u32, (cell / columns) as u32);
        match self.mesh.subdivision().find(i, j) {
            None => quad(
                [(i, j), (i + 1, j), (i + 1, j + 1), (i, j + 1)]
                    .map(|(i, j)| self.mesh.posed(i, j)),
            ),
            Some(cell) => {
                let (vertices, side) = (self.vertices(cell), cell.side());
                for k in 0..(side - 1) * (side - 1) {
                    let at = k / (side - 1) * side + k % (side - 1);
                    quad([
                        vertices[at],
                        vertices[at + 1],
                        vertices[at + side + 1],
                        vertices[at + side],
                    ]);
                }
            }
        }
    }

    fn vertices(&self, cell: &SubdividedCell) -> Vec<Point> {
        self.mesh
            .subdivision()
            .posed(self.mesh.grid(), cell)
            .collect()
    }

    /// The border of the posed image, and the sides and diagonals of folded cells, px of the
    /// target; `None` when cancelled.
    fn outlines(&self, cancelled: &dyn Fn() -> bool) -> Option<Vec<[Point; 2]>> {
        let mut lines = Vec::new();
        let mut add = |a: Point, b: Point| {
            if a != b {
                lines.push([self.on_target(a), self.on_target(b)]);
            }
        };
        let orientation = self.mesh.folding(cancelled)?.orientation;
        let (columns, rows) = (self.mesh.grid().columns() - 1, self.mesh.grid().rows() - 1);
        for j in 0..rows {
            if cancelled() {
                return None;
            }
            for i in 0..columns {
                let on_border = [j == 0, i + 1 == columns, j + 1 == rows, i == 0];
                self.quads(
                    (j as usize) * columns as usize + i as usize,
                    |[a, b, c, d]| {
                        if !orientation.is_kept(Orientation::turns([b - a, c - b, c - d, d - a])) {
                            [(a, b), (b, c), (c, d), (d, a), (a, c), (b, d)]
                                .into_iter()
                                .for_each(|(a, b)| add(a, b));
                        }
                    },
                );
                if on_border.contains(&true) {
                    let (line, side) = match self.mesh.subdivision().find(i, j) {
                        Some(cell) => (self.vertices(cell), cell.side()),
                        None => (
                            [(i, j), (i + 1, j), (i, j + 1), (i + 1, j + 1)]
                                .map(|(i, j)| self.mesh.posed(i, j))
                                .to_vec(),
                            2,
                        ),
                    };
                    for k in 1..side {
                        let last = side * (side - 1);
                        let edges = [
                            (k - 1, k),
                            (k * side - 1, (k + 1) * side - 1),
                            (last + k - 1, last + k),
                            ((k - 1) * side, k * side),
                        ];
                        edges
                            .into_iter()
                            .zip(on_border)
                            .filter(|(_, on_border)| *on_border)
                            .for_each(|((a, b), _)| add(line[a], line[b]));
                    }
                }
            }
        }
        Some(lines)
    }
}

/// Calls `pixel` for every pixel of the rows that is at most [`NEAR_OUTLINE_PX`] from a line
/// segment, and perhaps for some neighbours.
fn pixels_near(
    [a, b]: &[Point; 2],
    rows: &Range<u32>,
    width: u32,
    mut pixel: impl FnMut(u32, u32),
) {
    #[expect(
        clippy::cast_possible_truncation,
        clippy::cast_sign_loss,
        reason = "float to integer saturates"
    )]
    let before = |at: f64, most: u32| (at.floor().max(-1.0) + 1.0).min(f64::from(most)) as u32;
    let first = |at: f64, most: u32| before(at - 1.0, most);
    let (top, bottom) = (
        a.y.min(b.y) - NEAR_OUTLINE_PX,
        a.y.max(b.y) + NEAR_OUTLINE_PX,
    );
    for y in first(top, rows.end).max(rows.start)..before(bottom, rows.end) {
        // The part of the line in the row.
        let at = |y: f64| {
            if a.y == b.y {
                0.0
            } else {
                ((y - a.y) / (b.y - a.y)).clamp(0.0, 1.0)
            }
        };
        let (s, t) = if a.y == b.y {
            (0.0, 1.0)
        } else {
            (
                at(f64::from(y) - NEAR_OUTLINE_PX),
                at(f64::from(y) + 1.0 + NEAR_OUTLINE_PX),
            )
        };
        let (s, t) = (a.x + (b.x - a.x) * s, a.x + (b.x - a.x) * t);
        for x in first(s.min(t) - NEAR_OUTLINE_PX, width)..before(s.max(t) + NEAR_OUTLINE_PX, width)
        {
            pixel(x, y);
        }
    }
}

/// Divides a cell of any shape into the two triangles that it is drawn as; for a convex cell,
/// either diagonal gives the same area.
fn halves([a, b, c, d]: [Point; 4]) -> [[Point; 3]; 2] {
    let turn = |a: Point, b: Point, c: Point| (b - a).cross(c - a);
    if turn(a, b, c) * turn(a, c, d) < 0.0 && turn(a, b, d) * turn(b, c, d) >= 0.0 {
        [[a, b, d], [b, c, d]]
    } else {
        [[a, b, c], [a, c, d]]
    }
}

/// Whether the pixel from 0 to 1 lies in a triangle.
fn contains_pixel(&[a, b, c]: &[Point; 3]) -> bool {
    let corners = [(0.0, 0.0), (1.0, 0.0), (0.0, 1.0), (1.0, 1.0)].map(|(x, y)| Point::new(x, y));
    let inside = |sign: f64| {
        let on_side =
            |a: Point, b: Point| corners.iter().all(|&p| sign * (b - a).cross(p - a) >= 0.0);
        on_side(a, b) && on_side(b, c) && on_side(c, a)
    };
    let area = (b - a).cross(c - a);
    (area > 0.0 && inside(1.0)) || (area < 0.0 && inside(-1.0))
}

/// Whether the box of a triangle meets the pixel from 0 to 1 in more than a border.
fn meets_pixel(triangle: &[Point; 3]) -> bool {
    let meets = |at: fn(&Point) -> f64| {
        triangle.iter().any(|p| at(p) > 0.0) && triangle.iter().any(|p| at(p) < 1.0)
    };
    meets(|p| p.x) && meets(|p| p.y)
}

/// The area of the union of triangles in the pixel from 0 to 1. Between two consecutive heights of
/// corners and of crossings with the pixel's sides, the covered length is a linear function of the
/// height, unless triangles overlap.
fn area_of_union(triangles: &[[Point; 3]]) -> f64 {
    let sides = |[a, b, c]: &[Point; 3]| [(*a, *b), (*b, *c), (*c, *a)];
    let mut heights = vec![0.0, 1.0];
    if triangles.len() <= MAX_EXACT {
        for (a, b) in triangles.iter().flat_map(sides) {
            heights.push(a.y);
            for x in [0.0, 1.0] {
                if (a.x < x) != (b.x < x) {
                    heights.push(a.y + (b.y - a.y) * (x - a.x) / (b.x - a.x));
                }
            }
        }
        heights.retain(|y| (0.0..=1.0).contains(y));
        heights.sort_unstable_by(f64::total_cmp);
    }
    let mut spans: Vec<(f64, f64)> = Vec::new();
    let mut length = |y: f64| {
        spans.clear();
        for triangle in triangles {
            let crossings = sides(triangle)
                .into_iter()
                .filter(|(a, b)| (a.y <= y) != (b.y <= y));
            let (low, high) =
                crossings.fold((f64::INFINITY, f64::NEG_INFINITY), |(low, high), (a, b)| {
                    let x = a.x + (b.x - a.x) * ((y - a.y) / (b.y - a.y));
                    (low.min(x), high.max(x))
                });
            if low < 1.0 && high > 0.0 {
                spans.push((low.max(0.0), high.min(1.0)));
            }
        }
        spans.sort_unstable_by(|a, b| a.0.total_cmp(&b.0));
        let mut end = 0.0;
        spans.iter().fold(0.0, |sum, &(low, high)| {
            let more = (high - low.max(end)).max(0.0);
            end = high.max(end);
            sum + more
        })
    };
    let slab = |from: f64, to: f64, length: &mut dyn FnMut(f64) -> f64| {
        #[expect(
            clippy::cast_possible_truncation,
            clippy::cast_sign_loss,
            reason = "at most the slices of a pixel"
        )]
        let slices = ((to - from) * f64::from(PIXEL_SLICES)).ceil() as u32;
        let height = (to - from) / f64::from(slices.max(1));
        (0..slices)
            .map(|k| length(from + (f64::from(k) + 0.5) * height) * height)
            .sum::<f64>()
    };
    heights
        .windows(2)
        .map(|pair| slab(pair[0], pair[1], &mut length))
        .sum::<f64>()
        .clamp(0.0, 1.0)
}

#[cfg(test)]
mod tests {
    use std::cell::Cell;

    use super::*;
    use crate::geometry::Grid;

    #[test]
    fn a_search_that_nobody_wants_is_not_made() {
        let grid = Grid::with_counts(100.0, 80.0, 40, 30);
        let displacement = vec![[0.5, 0.0]; grid.len()];
        let (mesh, target) = (Mesh::new(grid, displacement), Extent::new(100, 80).unwrap());
        let questions = Cell::new(0_u32);
        let mut row = vec![0; 100];
        let coverage = Coverage::new(&mesh, target, None);
        let count = || questions.replace(questions.get() + 1) == u32::MAX;
        assert!(coverage.search(&count).is_some() && questions.get() > 2 * 29);
        for most in 0..questions.get() {
            let coverage = Coverage::new(&mesh, target, None);
            let left = Cell::new(most);
            let cancelled = || left.replace(left.get().saturating_sub(1)) == 0;
            coverage.rows(0..1, &mut row, &cancelled);
            assert!(coverage.search.lock().unwrap().is_none(), "{most}");
        }
    }
}
