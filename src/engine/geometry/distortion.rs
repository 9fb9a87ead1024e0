//! How the cells of a posed grid differ from those at rest: the change of their areas and of their
//! right angles.
//!
//! Both come from the Jacobian J of a cell: the mean of that of its bilinear patch over the cell,
//! whose columns are the means of opposite edges over the length of the edge at rest. With the
//! singular values s1 >= |s2| of J, s2 of the sign of its determinant:
//!
//! * *Area factor*: det J = s1 s2, which is the signed area of the posed cell over its area at
//!   rest. 1 keeps the area; negative is turned over.
//! * *Shear*: the largest change of a right angle, `90 - 2 atan(s2 / s1)` degrees. 0 is a rotation
//!   with a uniform scale, 90 is flattened to a line, and above 90 the cell is turned over. With
//!   |mu| = (s1 - s2) / (s1 + s2), the complex dilatation, it is 2 atan |mu|. It is relative to the
//!   orientation of the whole: in a mirrored mesh s2 has the opposite sign, so that a mirror image
//!   has no shear.

use super::lane_math::{angle, hypot};
use super::{Mesh, Orientation};

/// Minimum, median and maximum of some values.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Summary {
    /// The minimum.
    pub min: f64,
    /// The median; of an even number of values, the mean of the two middle ones.
    pub median: f64,
    /// The maximum.
    pub max: f64,
}

impl Summary {
    /// The summary of the finite values; `None` if there are none. O(values), which are reordered.
    ///
    /// ```
    /// use mlswarp::geometry::Summary;
    /// let summary = Summary::of(&mut vec![4.0, 1.0, f64::NAN, 2.0]);
    /// assert_eq!(summary, Some(Summary { min: 1.0, median: 2.0, max: 4.0 }));
    /// ```
    #[must_use]
    pub fn of(values: &mut Vec<f64>) -> Option<Self> {
        values.retain(|value| value.is_finite());
        let middle = values.len() / 2;
        if values.is_empty() {
            return None;
        }
        let is_even = values.len().is_multiple_of(2);
        let (below, upper, above) = values.select_nth_unstable_by(middle, f64::total_cmp);
        let least = |values: &[f64], start: f64| values.iter().copied().fold(start, f64::min);
        let greatest = |values: &[f64], start: f64| values.iter().copied().fold(start, f64::max);
        // Below the upper one of two middle values, the greatest is the lower one.
        let lower = if is_even {
            greatest(below, f64::NEG_INFINITY)
        } else {
            *upper
        };
        Some(Self {
            min: least(below, *upper),
            median: lower + (*upper - lower) / 2.0,
            max: greatest(above, *upper),
        })
    }
}

/// The distortion of the cells of a grid.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Distortion {
    /// Posed area over area at rest.
    pub area_factor: Option<Summary>,
    /// Largest change of a right angle, degrees.
    pub shear: Option<Summary>,
}

impl Mesh {
    /// The distortion of the grid's cells in a mesh of this orientation. Memory: 16 bytes per cell.
    /// `None` when cancelled, which is checked for each row.
    #[must_use]
    pub fn distortion(
        &self,
        orientation: Orientation,
        cancelled: &dyn Fn() -> bool,
    ) -> Option<Distortion> {
        let grid = self.grid();
        let cells = (grid.columns() as usize - 1) * (grid.rows() as usize - 1);
        let (mut area_factors, mut shears) = (Vec::with_capacity(cells), Vec::with_capacity(cells));
        for j in 0..grid.rows() - 1 {
            if cancelled() {
                return None;
            }
            let drawn = (0..grid.columns() - 1)
                .flat_map(|i| self.corners(i, j).map(move |corners| (i, corners)));
            for (i, [a, b, d, c]) in drawn {
                let size = grid.vertex(i + 1, j + 1) - grid.vertex(i, j);
                let (along, down) = (
                    ((b - a) + (d - c)) * (0.5 / size.x),
                    ((c - a) + (d - b)) * (0.5 / size.y),
                );
                area_factors.push(along.cross(down));
                // s1 + s2 and s1 - s2.
                let sum = hypot(along.x + down.y, along.y - down.x);
                let difference = hypot(along.x - down.y, along.y + down.x);
                let (sum, difference) = if orientation == Orientation::Mirrored {
                    (difference, sum)
                } else {
                    (sum, difference)
                };
                let shear = if difference > 0.0 {
                    2.0 * angle(difference, sum).to_degrees()
                } else {
                    0.0
                };
                shears.push(shear);
            }
        }
        Some(Distortion {
            area_factor: Summary::of(&mut area_factors),
            shear: Summary::of(&mut shears),
        })
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::geometry::{Grid, Point};

    fn mesh(map: impl Fn(Point) -> Point) -> Mesh {
        let grid = Grid::with_counts(100.0, 80.0, 6, 5);
        let vertices = (0..5).flat_map(|j| (0..6).map(move |i| grid.vertex(i, j)));
        #[expect(clippy::cast_possible_truncation, reason = "small numbers")]
        let displacement = vertices
            .map(|p| map(p) - p)
            .map(|d| [d.x as f32, d.y as f32])
            .collect();
        Mesh::new(grid, displacement)
    }

    fn constant(map: impl Fn(Point) -> Point) -> (f64, f64) {
        let mesh = mesh(map);
        let orientation = mesh.folding(&|| false).unwrap().orientation;
        let Distortion {
            area_factor: Some(area),
            shear: Some(shear),
        } = mesh.distortion(orientation, &|| false).unwrap()
        else {
            panic!("none")
        };
        assert!(
            area.max - area.min < 1e-4 && shear.max - shear.min < 1e-3,
            "{area:?} {shear:?}"
        );
        (area.median, shear.median)
    }

    #[test]
    fn affine_maps_have_the_distortion_of_their_matrix() {
        let near = |(area, shear): (f64, f64), want: (f64, f64)| {
            (area - want.0).abs() < 1e-4 && (shear - want.1).abs() < 2e-3
        };
        assert_eq!(constant(|p| p), (1.0, 0.0));
        assert!(
            near(constant(|p| Point::new(3.0 - p.y, 2.0 + p.x)), (1.0, 0.0)),
            "a rotation"
        );
        assert!(
            near(constant(|p| Point::new(0.5 * p.x, 0.5 * p.y)), (0.25, 0.0)),
            "a scale"
        );
        // The diagonals of a square become those of a rectangle of 2 x 1.
        assert!(
            near(
                constant(|p| Point::new(2.0 * p.x, p.y)),
                (2.0, 90.0 - 2.0 * 0.5f64.atan().to_degrees())
            ),
            "a stretch"
        );
        // Singular values of a shear by k: their product is 1, their difference k.
        assert!(
            near(
                constant(|p| Point::new(p.x + 0.5 * p.y, p.y)),
                (1.0, 2.0 * (0.5f64 / 4.25f64.sqrt()).atan().to_degrees())
            ),
            "a shear"
        );
        assert!(
            near(constant(|p| Point::new(p.x, 7.0)), (0.0, 90.0)),
            "a line"
        );
        assert!(
            near(constant(|p| Point::new(-p.x, p.y)), (-1.0, 0.0)),
            "a mirror"
        );
        assert!(
            near(constant(|p| Point::new(p.y, p.x)), (-1.0, 0.0)),
            "a mirror that is turned"
        );
        assert!(
            near(
                constant(|p| Point::new(-2.0 * p.x, p.y)),
                (-2.0, 90.0 - 2.0 * 0.5f64.atan().to_degrees())
            ),
            "a stretched mirror"
        );
        let upright = mesh(|p| Point::new(-p.x, p.y))
            .distortion(Orientation::Upright, &|| false)
            .unwrap();
        assert!(
            (upright.shear.unwrap().median - 180.0).abs() < 2e-3,
            "a cell turned over in a mesh that is not"
        );
    }

    #[test]
    fn the_median_is_the_middle_of_a_sorted_list() {
        for (values, want) in [
            (vec![3.0, 1.0, 2.0], Some((1.0, 2.0, 3.0))),
            (vec![4.0, 1.0, 2.0, 10.0], Some((1.0, 3.0, 10.0))),
            (vec![f64::NAN, 5.0, f64::INFINITY], Some((5.0, 5.0, 5.0))),
            (vec![f64::NAN], None),
            (vec![], None),
        ] {
            let summary = Summary::of(&mut values.clone());
            assert_eq!(
                summary.map(|summary| (summary.min, summary.median, summary.max)),
                want,
                "{values:?}"
            );
        }
    }
}
