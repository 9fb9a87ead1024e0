//! A number of each handle, carried to any position as the map carries the handles: the mean by
//! their weights at that position, or what a linear method makes of it (mathematics 11.4).

use super::coefficient_table::CoefficientTable;
use super::lanes::{LANES, ON_PLANE, Vertices};
use super::point_map::{CoefficientsOf, PointMap};
use super::posed_map::PosedMap;
use super::workspace::Workspace;
use super::{IsCancelled, RestDeformation};
use crate::geometry::{Point, Vec2};
use crate::parallel::prelude::*;

/// Blocks of positions that one task computes.
const BLOCKS_PER_TASK: usize = 8;
/// Vertices whose positions are in memory at once, where they are needed.
const VERTICES_PER_PART: usize = 1 << 16;
/// Memory of each of these: its position, and three f32 twice, in blocks and in a row.
const PLACED_BYTES: u64 = 48;
/// Memory of a vertex of the mesh of a method: some displacements in f64, and the drawn one.
const SOLVED_BYTES: u64 = 72;

impl RestDeformation {
    /// The number of each column as a share of the range of all, from one for each of the client's
    /// handles; `None` if they do not differ. Coincident points have the mean of theirs. What is
    /// carried is rounded to f32: of a share, that is nothing beside the range, however far from 0
    /// that lies.
    ///
    /// # Panics
    /// If there is not one number for each handle.
    #[must_use]
    pub(crate) fn shares_of_columns(&self, of_handles: &[f64]) -> Option<Vec<f64>> {
        let given = self.client_handles().handles();
        assert_eq!(given.len(), of_handles.len(), "one number for each handle");
        let columns = given.iter().zip(of_handles);
        let columns: Vec<f64> = columns
            .flat_map(|(handle, value)| vec![*value; handle.columns()])
            .collect();
        let least = columns.iter().copied().fold(f64::INFINITY, f64::min);
        let range = columns.iter().copied().fold(least, f64::max) - least;
        let shares = columns.iter().map(|value| (value - least) / range);
        let differs = range > 0.0;
        differs.then(|| match &self.grouped {
            None => shares.collect(),
            Some(grouped) => {
                let means = grouped.1.displacements(&as_displacements(shares));
                means.into_iter().map(|mean| mean.x).collect()
            }
        })
    }

    /// The most memory while numbers are carried to this number of vertices, beyond the carried
    /// numbers and what depends on the columns alone, bytes.
    #[must_use]
    pub(crate) fn carrying_bytes(&self, vertices: u64) -> u64 {
        if self.map.mesh().is_some() {
            vertices.saturating_mul(SOLVED_BYTES)
        } else if self.map.has_weights() {
            0
        } else {
            vertices.min(VERTICES_PER_PART as u64) * PLACED_BYTES
        }
    }

    /// The numbers of the columns, carried to vertices. `vertex(k)`: where one is, and the pixel
    /// that it belongs to; without one, that of its position. In parallel on the current pool;
    /// `None` when cancelled.
    pub(crate) fn carried(
        &self,
        of_columns: &[f64],
        vertices: usize,
        vertex: &(dyn Fn(usize) -> (Point, Option<u32>) + Sync),
        cancelled: IsCancelled<'_>,
    ) -> Option<Vec<f32>> {
        if !self.map.has_weights() {
            let displacements = as_displacements(of_columns.iter().copied());
            let posed = PosedMap::of_displacements(self, &displacements);
            let mut carried = Vec::with_capacity(vertices);
            for first in (0..vertices).step_by(VERTICES_PER_PART) {
                let part = first..vertices.min(first + VERTICES_PER_PART);
                let places: Vec<Point> = part.map(|k| vertex(k).0).collect();
                let (moved, _) = posed.displaced(&places, cancelled)?;
                carried.extend(moved.into_iter().map(|[x, _]| x));
            }
            return Some(carried);
        }
        let mut carried = vec![0.0; vertices];
        carried
            .par_chunks_mut(LANES * BLOCKS_PER_TASK)
            .enumerate()
            .try_for_each_init(
                || Workspace::<LANES>::new(of_columns.len()),
                |workspace, (task, carried)| {
                    for (k, carried) in carried.chunks_mut(LANES).enumerate() {
                        if cancelled() {
                            return None;
                        }
                        let first = (task * BLOCKS_PER_TASK + k) * LANES;
                        let at = |lane: usize| vertex(first + lane.min(carried.len() - 1));
                        let v = block(&at);
                        let map: &dyn PointMap = &*self.map;
                        CoefficientsOf::<LANES>::weights(map, &self.set, &v, workspace);
                        for (lane, carried) in carried.iter_mut().enumerate() {
                            let weights = workspace.rows.wn.iter().map(|weights| weights[lane]);
                            *carried = sum(of_columns, weights);
                        }
                    }
                    Some(())
                },
            )?;
        Some(carried)
    }

    /// The numbers of the columns, carried to the vertices of the mesh of the method; `None` if it
    /// has none.
    pub(crate) fn carried_on_mesh(
        &self,
        of_columns: &[f64],
        cancelled: IsCancelled<'_>,
    ) -> Option<Vec<f32>> {
        let solver = self.map.mesh()?;
        let carried = solver.carry(&as_displacements(of_columns.iter().copied()), cancelled)?;
        Some(carried.into_iter().map(|[x, _]| x).collect())
    }
}

impl CoefficientTable {
    /// Whether the table has the weights that numbers are carried by.
    pub(crate) fn has_weights(&self) -> bool {
        self.weights().is_some()
    }

    /// The numbers of the columns, carried to the vertices of the table by its weights, if it has
    /// them. `None` when cancelled, which is checked for each block.
    pub(crate) fn carried(
        &self,
        of_columns: &[f64],
        cancelled: IsCancelled<'_>,
    ) -> Option<Vec<f32>> {
        let mut carried = Vec::with_capacity(self.len() + LANES);
        for weights in self.weights().into_iter().flatten() {
            if cancelled() {
                return None;
            }
            carried.extend((0..LANES).map(|lane| {
                let weights = weights.iter().skip(2).step_by(3);
                let of_lane = weights.map(|weights| f64::from(weights.0[lane]));
                sum(of_columns, of_lane)
            }));
        }
        carried.truncate(self.len());
        Some(carried)
    }
}

fn block(at: &dyn Fn(usize) -> (Point, Option<u32>)) -> Vertices<LANES> {
    let mut v = Vertices::all(Point::new(0.0, 0.0));
    for lane in 0..LANES {
        let (Point { x, y }, pixel) = at(lane);
        (v.x[lane], v.y[lane], v.pixel[lane]) = (x, y, pixel.unwrap_or(ON_PLANE));
    }
    v
}

/// A number is carried as a displacement along one axis.
fn as_displacements(of_columns: impl Iterator<Item = f64>) -> Vec<Vec2> {
    of_columns.map(|value| Vec2::new(value, 0.0)).collect()
}

#[expect(
    clippy::cast_possible_truncation,
    reason = "numbers at vertices are f32"
)]
fn sum(of_columns: &[f64], weights: impl Iterator<Item = f64>) -> f32 {
    let terms = of_columns.iter().zip(weights);
    terms.fold(0.0, |sum, (value, weight)| sum + value * weight) as f32
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::deform::{Falloff, Handle, Handles, Method};

    fn shares(handles: Vec<Handle>, of_handles: &[f64]) -> Option<Vec<f64>> {
        let (handles, falloff) = (Handles::new(handles, None), Falloff::new(1.0, false));
        let field = RestDeformation::new(handles.unwrap(), Method::Rigid, falloff.unwrap(), 1.0);
        field.unwrap().shares_of_columns(of_handles)
    }

    #[test]
    fn numbers_are_shares_of_their_range_however_far_from_0_that_is() {
        let point = |x: f64| Handle::Point(Point::new(x, 0.0));
        let three = || vec![point(0.0), point(10.0), point(20.0)];
        for (numbers, expected) in [
            ([0.0, 0.5, 1.0], [0.0, 0.5, 1.0]),
            ([1e9 + 2.0, 1e9 + 1.0, 1e9], [1.0, 0.5, 0.0]),
            ([-1e300, 0.0, 1e300], [0.0, 0.5, 1.0]),
            ([1e300, 1e300_f64.next_up(), 1e300], [0.0, 1.0, 0.0]),
            ([0.0, 5e-324, 1e-323], [0.0, 0.5, 1.0]),
            ([-5e-324, -0.0, 0.0], [0.0, 1.0, 1.0]),
        ] {
            assert_eq!(shares(three(), &numbers), Some(expected.to_vec()));
        }
        for equal in [[0.0, -0.0, 0.0], [1e9; 3], [-1e300; 3], [5e-324; 3]] {
            assert_eq!(shares(three(), &equal), None);
        }
        assert_eq!(shares(vec![point(3.0)], &[1e9]), None);
        // Coincident points have the mean; a missing handle has no depth; a line has two columns.
        let pair = vec![point(0.0), point(0.0), point(20.0)];
        assert_eq!(shares(pair, &[4.0, 5.0, 6.0]), Some(vec![0.25, 1.0]));
        let missing = vec![point(0.0), Handle::Missing, point(20.0)];
        assert_eq!(shares(missing, &[4.0, 1000.0, 6.0]), Some(vec![0.0, 1.0]));
        let line = Handle::Polyline(vec![Point::new(5.0, 5.0), Point::new(9.0, 5.0)]);
        assert_eq!(
            shares(vec![point(0.0), line], &[1.0, 3.0]),
            Some(vec![0.0, 1.0, 1.0])
        );
    }
}
