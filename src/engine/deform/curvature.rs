//! The cells of a posed grid whose bilinear patch may be too far from f, found from the second
//! differences of the grid alone. Cost: O(vertices), a few operations each.

use crate::geometry::Mesh;
use crate::geometry::lane_math::hypot;

/// A last row or column of cells narrower than this share of a cell takes the differences of the
/// previous one.
const NARROW_CELL_SHARE: f64 = 0.25;

/// Indices of the cells (row by row) whose error may exceed `limit`, px, in order. The error of a
/// patch is at most an eighth of the second differences of both axes together. The larger value of
/// two neighbouring vertices counts. A grid of fewer than four lines along an axis has no
/// differences there.
pub(super) fn bent_cells(mesh: &Mesh, limit: f64) -> Vec<u32> {
    let grid = mesh.grid();
    let (columns, rows) = (grid.columns() as usize, grid.rows() as usize);
    let cells = columns - 1;
    let index =
        |i: usize, j: usize| u32::try_from(j * cells + i).expect("fewer cells than vertices");
    if columns < 4 || rows < 4 {
        let is_tall = rows >= columns;
        let bent = bent_along(mesh, if is_tall { GridAxis::Y } else { GridAxis::X }, limit);
        let all = (0..rows - 1).flat_map(|j| (0..cells).map(move |i| (i, j)));
        return all
            .filter(|&(i, j)| bent[if is_tall { j } else { i }])
            .map(|(i, j)| index(i, j))
            .collect();
    }
    let line = |j: usize| mesh.displacement()[j * columns..][..columns].as_flattened();
    let share = |x: fn(&crate::geometry::Grid, u32) -> f64, last: u32| {
        (x(grid, last) - x(grid, last - 1)) / (x(grid, 1) - x(grid, 0))
    };
    let last_column = Last::new(share(crate::geometry::Grid::x, grid.columns() - 1));
    let last_row = Last::new(share(crate::geometry::Grid::y, grid.rows() - 1));
    #[expect(clippy::cast_possible_truncation, reason = "a threshold")]
    let limit = (8.0 * limit) as f32;
    let (mut squares, mut across) = (vec![0.0_f32; 2 * columns], vec![0.0_f32; 2 * columns]);
    let (mut above, mut below) = (vec![0.0_f32; columns], vec![0.0_f32; columns]);
    let mut bent = Vec::new();
    for j in 0..rows {
        // Rows at the border take the differences of their neighbours.
        let middle = j.clamp(1, rows - 2);
        let (middle, last) = if middle == rows - 2 {
            last_row.line(middle)
        } else {
            (middle, None)
        };
        let (over, here, under) = (line(middle - 1), line(middle), line(middle + 1));
        let at = line(j);
        let n = 2 * columns;
        for (((square, a), b), c) in squares.iter_mut().zip(over).zip(here).zip(under) {
            let second = last.map_or((c - b) - (b - a), |last| last.second(*a, *b, *c));
            *square = second * second;
        }
        for (((square, a), b), c) in across[2..n - 2]
            .iter_mut()
            .zip(at)
            .zip(&at[2..])
            .zip(&at[4..])
        {
            let second = (c - b) - (b - a);
            *square = second * second;
        }
        for k in n - 4..n - 2 {
            across[k] = match last_column.line(columns - 2) {
                (_, Some(last)) => last.second(at[k - 2], at[k], at[k + 2]).powi(2),
                (line, None) if line < columns - 2 => across[k - 2],
                _ => across[k],
            };
        }
        (across[0], across[1]) = (across[2], across[3]);
        (across[n - 2], across[n - 1]) = (across[n - 4], across[n - 3]);
        for ((bend, x), y) in below
            .iter_mut()
            .zip(across.chunks_exact(2))
            .zip(squares.chunks_exact(2))
        {
            *bend = (x[0] + x[1]).sqrt() + (y[0] + y[1]).sqrt();
        }
        if j > 0 {
            let pairs = above.iter().zip(&below);
            let high = |(a, b): (&f32, &f32)| a.max(*b) > limit;
            let high: Vec<bool> = pairs.map(high).collect();
            bent.extend(
                high.windows(2)
                    .enumerate()
                    .filter(|(_, ab)| ab[0] | ab[1])
                    .map(|(i, _)| index(i, j - 1)),
            );
        }
        std::mem::swap(&mut above, &mut below);
    }
    bent
}

#[derive(Clone, Copy)]
enum GridAxis {
    X,
    Y,
}

/// Whether the cells between two lines of a long axis may be bent, for each pair of lines. f is
/// assumed to bend as much across a narrow grid as along it; a picture of a few rows is also
/// compared with this share of the limit, because f may bend across it alone.
fn bent_along(mesh: &Mesh, axis: GridAxis, limit: f64) -> Vec<bool> {
    const NARROW_LIMIT: f64 = 0.25;
    let grid = mesh.grid();
    let (columns, rows) = (grid.columns() as usize, grid.rows() as usize);
    let (lines, across) = if matches!(axis, GridAxis::Y) {
        (rows, columns)
    } else {
        (columns, rows)
    };
    if lines < 4 {
        return vec![true; lines - 1];
    }
    let at = |line: usize, k: usize| {
        let [x, y] = mesh.displacement()[if matches!(axis, GridAxis::Y) {
            line * columns + k
        } else {
            k * columns + line
        }];
        [f64::from(x), f64::from(y)]
    };
    let (width, height) = (
        grid.cell().0.min(grid.width()),
        grid.cell().1.min(grid.height()),
    );
    let aspect = if matches!(axis, GridAxis::Y) {
        width / height
    } else {
        height / width
    };
    let bend = |line: usize| {
        // The last line may be nearer than the others.
        let middle = line.clamp(1, lines - 3);
        let second = |k: usize, c: usize| {
            at(middle - 1, k)[c] - 2.0 * at(middle, k)[c] + at(middle + 1, k)[c]
        };
        let largest = (0..across)
            .map(|k| hypot(second(k, 0), second(k, 1)))
            .fold(0.0, f64::max);
        largest * (1.0 + aspect * aspect) > 8.0 * limit * NARROW_LIMIT
    };
    let high: Vec<bool> = (0..lines).map(bend).collect();
    high.windows(2).map(|ab| ab[0] | ab[1]).collect()
}

/// The last line of a grid, which may be nearer than the others.
#[derive(Clone, Copy)]
struct Last {
    share: f64,
}

impl Last {
    const fn new(share: f64) -> Self {
        Self { share }
    }

    /// The line whose differences stand for those of `line`, the second but last, and how to
    /// compute them.
    fn line(self, line: usize) -> (usize, Option<Self>) {
        if self.share < NARROW_CELL_SHARE {
            (line - 1, None)
        } else if self.share < 1.0 {
            (line, Some(self))
        } else {
            (line, None)
        }
    }

    /// The second difference of three values, of which the last is nearer.
    #[expect(clippy::cast_possible_truncation, reason = "an estimate")]
    fn second(self, a: f32, b: f32, c: f32) -> f32 {
        let share = self.share as f32;
        ((c - b) / share - (b - a)) * 2.0 / (1.0 + share)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::geometry::Grid;

    /// A grid of cells of 16 px whose displacement grows with the square of the distance from the
    /// 100th line, but no farther than 10 lines.
    fn bent_near_a_line(width: f64, height: f64) -> Mesh {
        let grid = Grid::with_cell(width, height, 16.0);
        let line = |k: u32| f32::from(u16::try_from(k.clamp(90, 110)).unwrap()) - 100.0;
        let lines = (0..grid.rows()).flat_map(|j| (0..grid.columns()).map(move |i| i.max(j)));
        Mesh::new(grid, lines.map(|k| [0.0, line(k) * line(k)]).collect())
    }

    #[test]
    fn of_a_narrow_grid_only_what_bends_along_it_is_measured() {
        for (width, height) in [(1.0, 1e6), (1e6, 1.0), (20.0, 1e6), (1e6, 33.0)] {
            let mesh = bent_near_a_line(width, height);
            let cells = mesh.grid().columns().max(mesh.grid().rows()) - 1;
            let bent = bent_cells(&mesh, 0.1);
            assert!(
                (20..100).contains(&bent.len()),
                "{width} x {height}: {} of {cells}",
                bent.len()
            );
        }
        assert_eq!(bent_cells(&bent_near_a_line(20.0, 30.0), 0.1).len(), 4);
    }
}
