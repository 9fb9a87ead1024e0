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

impl RestDeformation {
    /// The number of each column, from one for each of the client's handles. Coincident points have
    /// the mean of theirs.
    ///
    /// # Panics
    /// If there is not one number for each handle.
    #[must_use]
    pub fn per_column(&self, of_handles: &[f64]) -> Vec<f64> {
        let given = self.client_handles().handles();
        assert_eq!(given.len(), of_handles.len(), "one number for each handle");
        let columns = given.iter().zip(of_handles);
        let columns = columns.flat_map(|(handle, value)| vec![*value; handle.columns()]);
        match &self.grouped {
            None => columns.collect(),
            Some(grouped) => {
                let columns: Vec<Vec2> = columns.map(|value| Vec2::new(value, 0.0)).collect();
                let means = grouped.1.displacements(&columns);
                means.into_iter().map(|mean| mean.x).collect()
            }
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
            let displacements = as_displacements(of_columns);
            let places: Vec<Point> = (0..vertices).map(|k| vertex(k).0).collect();
            let posed = PosedMap::of_displacements(self, &displacements);
            let (moved, _) = posed.displaced(&places, cancelled)?;
            return Some(moved.into_iter().map(|[x, _]| x).collect());
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
        let carried = solver.carry(&as_displacements(of_columns), cancelled)?;
        Some(carried.into_iter().map(|[x, _]| x).collect())
    }
}

impl CoefficientTable {
    /// The numbers of the columns, carried to the vertices of the table; `None` if it has no
    /// weights.
    pub(crate) fn carried(&self, of_columns: &[f64]) -> Option<Vec<f32>> {
        let blocks = self.weights()?;
        let carried = blocks.flat_map(|weights| {
            let lane = move |lane: usize| {
                let weights = weights.iter().skip(2).step_by(3);
                sum(
                    of_columns,
                    weights.map(|weights| f64::from(weights.0[lane])),
                )
            };
            (0..LANES).map(lane)
        });
        Some(carried.take(self.len()).collect())
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
fn as_displacements(of_columns: &[f64]) -> Vec<Vec2> {
    let displacements = of_columns.iter().map(|value| Vec2::new(*value, 0.0));
    displacements.collect()
}

#[expect(
    clippy::cast_possible_truncation,
    reason = "numbers at vertices are f32"
)]
fn sum(of_columns: &[f64], weights: impl Iterator<Item = f64>) -> f32 {
    let terms = of_columns.iter().zip(weights);
    terms.fold(0.0, |sum, (value, weight)| sum + value * weight) as f32
}
