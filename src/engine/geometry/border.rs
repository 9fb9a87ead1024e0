//! Whether the border of a posed grid crosses itself. Without a folded cell a mesh is locally
//! one-to-one, and it is so as a whole if its border is a simple polygon (mathematics 9.3).

use super::{Mesh, Point};

/// Edges of the border, one after the other, that are compared with others together.
const EDGES_OF_PART: usize = 8;

/// Some edges of the border, and left, top, right and bottom of them.
struct BorderPart<'a> {
    first: usize,
    places: &'a [Point],
    bounds: [f64; 4],
}

impl<'a> BorderPart<'a> {
    fn new(first: usize, places: &'a [Point]) -> Self {
        let bounds = places.iter().fold(
            [
                f64::INFINITY,
                f64::INFINITY,
                f64::NEG_INFINITY,
                f64::NEG_INFINITY,
            ],
            |[left, top, right, bottom], v| {
                [left.min(v.x), top.min(v.y), right.max(v.x), bottom.max(v.y)]
            },
        );
        Self {
            first,
            places,
            bounds,
        }
    }

    fn is_near(&self, other: &Self) -> bool {
        let [a, b] = [self.bounds, other.bounds];
        a[0] <= b[2] && b[0] <= a[2] && a[1] <= b[3] && b[1] <= a[3]
    }

    fn edges(&self) -> impl Iterator<Item = (usize, [Point; 2])> {
        let ends = self.places.windows(2).map(|ends| [ends[0], ends[1]]);
        (self.first..).zip(ends)
    }
}

impl Mesh {
    /// The number of pairs of edges of the border, not neighbours, that have a position in common.
    /// `None` when cancelled. O(edges^2), of 8 of them at once.
    ///
    /// ```
    /// use mlswarp::geometry::{Grid, Mesh};
    /// // The upper right corner is drawn through the left edge and out of it.
    /// let grid = Grid::with_counts(20.0, 10.0, 3, 2);
    /// let row = [[0.0; 2]; 3];
    /// let mesh = Mesh::new(grid, [[[0.0; 2], [0.0; 2], [-30.0, 5.0]], row].concat());
    /// assert_eq!(mesh.border_crossings(&|| false), Some(2));
    /// ```
    #[must_use]
    pub fn border_crossings(&self, cancelled: &dyn Fn() -> bool) -> Option<u64> {
        let (right, last) = (self.grid().columns() - 1, self.grid().rows() - 1);
        let places = (0..right).map(|i| self.posed(i, 0));
        let places = places.chain((0..last).map(|j| self.posed(right, j)));
        let places = places.chain((1..=right).rev().map(|i| self.posed(i, last)));
        let places = places.chain((0..=last).rev().map(|j| self.posed(0, j)));
        let places: Vec<Point> = places.collect();
        let edges = places.len() - 1;
        let part = |first: usize| {
            BorderPart::new(first, &places[first..=edges.min(first + EDGES_OF_PART)])
        };
        let parts: Vec<BorderPart<'_>> = (0..edges).step_by(EDGES_OF_PART).map(part).collect();
        let is_neighbour = |k: usize, n: usize| [1, edges - 1].contains(&(n - k));
        let mut crossings = 0;
        for (index, one) in parts.iter().enumerate() {
            if cancelled() {
                return None;
            }
            for other in parts[index..].iter().filter(|other| one.is_near(other)) {
                for (k, edge) in one.edges() {
                    let others = other
                        .edges()
                        .filter(|(n, _)| *n > k && !is_neighbour(k, *n));
                    let met = others.filter(|(_, other)| !is_apart(edge, *other));
                    crossings += met.count() as u64;
                }
            }
        }
        Some(crossings)
    }
}

/// Whether two edges have no position in common.
fn is_apart(one: [Point; 2], other: [Point; 2]) -> bool {
    let is_beside =
        |[a, b]: [Point; 2], [c, d]: [Point; 2]| (b - a).cross(c - a) * (b - a).cross(d - a) > 0.0;
    let is_beyond = |of: fn(&Point) -> f64| {
        let [a, b] = [one, other].map(|ends| ends.map(|end| of(&end)));
        a[0].max(a[1]) < b[0].min(b[1]) || b[0].max(b[1]) < a[0].min(a[1])
    };
    is_beyond(|v| v.x) || is_beyond(|v| v.y) || is_beside(one, other) || is_beside(other, one)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::geometry::Grid;
    use crate::geometry::folding::tests::shaken;

    #[test]
    fn crossings_are_those_of_all_pairs_of_edges() {
        let mut with = 0;
        for (columns, rows, reach) in [(2, 2, 60.0), (9, 14, 4.0), (23, 12, 5.0), (23, 12, 9.0)] {
            let mesh = shaken(columns, rows, reach);
            let (c, r) = (columns - 1, rows - 1);
            let top = (0..c).map(|i| (i, 0)).chain((0..r).map(|j| (c, j)));
            let bottom = (0..c).map(|i| (c - i, r)).chain((0..r).map(|j| (0, r - j)));
            let around: Vec<Point> = top.chain(bottom).map(|(i, j)| mesh.posed(i, j)).collect();
            let edge = |k: usize| [around[k], around[(k + 1) % around.len()]];
            let pairs = (0..around.len()).flat_map(|k| (k + 2..around.len()).map(move |n| (k, n)));
            let pairs = pairs.filter(|(k, n)| n - k < around.len() - 1);
            let expected = pairs.filter(|(k, n)| !is_apart(edge(*k), edge(*n))).count() as u64;
            assert_eq!(
                mesh.border_crossings(&|| false),
                Some(expected),
                "{columns} x {rows}"
            );
            with += u32::from(expected > 0);
        }
        assert!(with >= 2);
        let mesh = Mesh::identity(Grid::with_counts(9.0, 9.0, 4, 4));
        assert_eq!(mesh.border_crossings(&|| false), Some(0));
        assert_eq!(mesh.border_crossings(&|| true), None);
    }
}
