//! The vertices that halving a cell adds, interpolated from the posed grid by tensor cubics through four vertices (mathematics section 12,
//! step 2), where fourth differences show that the grid resolves f. This takes a few taps instead of a row of coefficients.

use crate::geometry::Mesh;

/// Vertices used along each axis: four of a cubic, and one more at each end for fourth differences.
const TAPS: usize = 6;

/// A halved cell.
#[derive(Clone, Copy, Debug)]
pub(super) struct Interpolated {
    /// Displacements in the order of [`group`](super::exact_rows::group), px.
    pub(super) vertices: [[f32; 2]; 5],
    /// How far they may be from f, px.
    pub(super) off: f32,
    /// The largest distance between them and the patch of the cell, px.
    pub(super) error: f32,
}

impl Interpolated {
    /// The cell at a column and row; `None` near the border, where the stencil has no room or lines may be nearer to each other.
    pub(super) fn new(mesh: &Mesh, i: u32, j: u32) -> Option<Self> {
        let grid = mesh.grid();
        if i < 2 || j < 2 || i + 5 > grid.columns() || j + 5 > grid.rows() {
            return None;
        }
        let (columns, i, j) = (grid.columns() as usize, i as usize, j as usize);
        let d = mesh.displacement();
        let lines: [&[[f32; 2]]; TAPS] = std::array::from_fn(|k| &d[(j + k - 2) * columns + i - 2..][..TAPS]);
        let at = |a: usize, b: usize| lines[b][a];
        let across = |b: usize| middle([at(1, b), at(2, b), at(3, b), at(4, b)]);
        let down = |a: usize| middle([at(a, 1), at(a, 2), at(a, 3), at(a, 4)]);
        let (top, bottom) = (across(2), across(3));
        let centre = middle([across(1), top, bottom, across(4)]);
        let (left, right) = (down(2), down(3));
        let (mut off, mut error) = (0.0_f32, 0.0_f32);
        for (a, b) in [(2, 2), (3, 2), (2, 3), (3, 3)] {
            let x = fourth([at(a - 2, b), at(a - 1, b), at(a, b), at(a + 1, b), at(a + 2, b)]);
            let y = fourth([at(a, b - 2), at(a, b - 1), at(a, b), at(a, b + 1), at(a, b + 2)]);
            off = off.max(x + y);
        }
        let mean = |a: [f32; 2], b: [f32; 2]| [0.5 * (a[0] + b[0]), 0.5 * (a[1] + b[1])];
        let (above, below) = (mean(at(2, 2), at(3, 2)), mean(at(2, 3), at(3, 3)));
        let patch = [above, mean(at(2, 2), at(2, 3)), mean(above, below), mean(at(3, 2), at(3, 3)), below];
        let vertices = [top, left, centre, right, bottom];
        for (a, b) in vertices.iter().zip(patch) {
            let (x, y) = (a[0] - b[0], a[1] - b[1]);
            error = error.max(x * x + y * y);
        }
        Some(Self { vertices, off: off * (3.0 / 128.0), error: error.sqrt() })
    }
}

/// The value in the middle of four at equal distances, by their cubic.
fn middle([a, b, c, d]: [[f32; 2]; 4]) -> [f32; 2] {
    [0, 1].map(|k| (9.0 * (b[k] + c[k]) - (a[k] + d[k])) * (1.0 / 16.0))
}

/// The length of a fourth difference.
fn fourth([a, b, c, d, e]: [[f32; 2]; 5]) -> f32 {
    let [x, y] = [0, 1].map(|k| 6.0 * c[k] - 4.0 * (b[k] + d[k]) + (a[k] + e[k]));
    (x * x + y * y).sqrt()
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::geometry::Grid;

    #[test]
    fn cubics_are_interpolated_exactly_and_the_rest_is_bounded() {
        let grid = Grid::with_counts(100.0, 80.0, 11, 9);
        let mesh = |f: &dyn Fn(f32, f32) -> [f32; 2]| {
            let vertices = (0..9_u8).flat_map(|j| (0..11_u8).map(move |i| (i, j)));
            Mesh::new(grid, vertices.map(|(i, j)| f(f32::from(i), f32::from(j))).collect())
        };
        let places = [(4.5, 3.0), (4.0, 3.5), (4.5, 3.5), (5.0, 3.5), (4.5, 4.0)];
        let cubic = |x: f32, y: f32| [x * x * x - y * y + x * y, 2.0 * y * y * y - x * x * y];
        let found = Interpolated::new(&mesh(&cubic), 4, 3).unwrap();
        for (vertex, (x, y)) in found.vertices.iter().zip(places) {
            let want = cubic(x, y);
            assert!((vertex[0] - want[0]).hypot(vertex[1] - want[1]) < 1e-3, "{vertex:?} {want:?}");
        }
        assert!(found.off < 1e-3 && found.error > 0.1, "{found:?}");
        let wave = |x: f32, y: f32| [(0.7 * x + 0.2 * y).sin(), (0.3 * x - 0.9 * y).cos()];
        let found = Interpolated::new(&mesh(&wave), 4, 3).unwrap();
        let off = |vertex: &[f32; 2], (x, y)| (vertex[0] - wave(x, y)[0]).hypot(vertex[1] - wave(x, y)[1]);
        let worst = found.vertices.iter().zip(places).map(|(vertex, place)| off(vertex, place)).fold(0.0, f32::max);
        assert!(worst <= found.off && found.off < 4.0 * worst, "{worst} {found:?}");
        for (i, j) in [(1, 3), (4, 1), (7, 3), (4, 5)] {
            assert!(Interpolated::new(&mesh(&wave), i, j).is_none(), "{i} {j}");
        }
        assert!(Interpolated::new(&mesh(&wave), 6, 4).is_some());
    }
}
