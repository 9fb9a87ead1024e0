//! f of one pose at positions that are used once, for any share of the way of the handles.

use std::ops::Range;

use super::form::{MotionLanes, rigid_motion};
use super::kernel::{LaneWork, run_at};
use super::lanes::{LANES, gather};
use super::point_map::PosedOnce;
use super::posed_map::{COLUMNS_BETWEEN_CHECKS, PosedMap};
use super::tiles::TILE_LANES;
use super::workspace::Workspace;
use super::{CoefficientForm, IsCancelled, Pose, RestDeformation};
use crate::geometry::{Point, Vec2};
use crate::level::SimdLevel;
use crate::parallel::prelude::*;

/// Blocks of positions that one task maps.
const BLOCKS_PER_TASK: usize = 32;

/// f of one pose, as precise as what is drawn.
#[derive(Debug)]
pub(super) struct MovingMap<'a> {
    field: &'a RestDeformation,
    plain: PosedMap<'a>,
    sums: Option<Box<dyn PosedOnce + 'a>>,
}

impl<'a> MovingMap<'a> {
    pub(super) fn new(field: &'a RestDeformation, pose: &'a Pose) -> Self {
        Self {
            field,
            plain: field.deformation(pose),
            sums: field.posed_once(pose.displacements()),
        }
    }

    /// How positions move, a block after the other. In parallel on the current pool; `None` when
    /// cancelled.
    pub(super) fn motions(
        &self,
        places: &[Point],
        cancelled: IsCancelled<'_>,
    ) -> Option<Vec<MotionLanes<TILE_LANES>>> {
        let tasks = places.par_chunks(LANES * BLOCKS_PER_TASK);
        let motions = |places: &[Point]| self.motions_of_task(places, cancelled);
        let parts: Option<Vec<_>> = tasks.map(motions).collect();
        Some(parts?.concat())
    }

    /// f at many positions. In parallel on the current pool; `None` when cancelled.
    pub(super) fn map_all(
        &self,
        places: &[Point],
        cancelled: IsCancelled<'_>,
    ) -> Option<Vec<Point>> {
        let form = self.field.form();
        let tasks = places.par_chunks(LANES * BLOCKS_PER_TASK);
        let map = |places: &[Point]| {
            let motions = self.motions_of_task(places, cancelled)?;
            let way = Motions {
                form,
                places,
                motions: &motions,
            };
            Some(way.at(1.0, 0..places.len()))
        };
        let parts: Option<Vec<_>> = tasks.map(map).collect();
        Some(parts?.concat())
    }

    fn motions_of_task(
        &self,
        places: &[Point],
        cancelled: IsCancelled<'_>,
    ) -> Option<Vec<MotionLanes<TILE_LANES>>> {
        let mut motions = Vec::with_capacity(places.len().div_ceil(TILE_LANES));
        let between = LANES * (COLUMNS_BETWEEN_CHECKS / self.plain.columns().max(1)).max(1);
        for places in places.chunks(between) {
            if cancelled() {
                return None;
            }
            let first = motions.len();
            let left = match &self.sums {
                Some(sums) => sums.motions(places, &mut motions),
                None => {
                    let blocks = places.len().div_ceil(TILE_LANES);
                    motions.resize(first + blocks, MotionLanes::ZERO);
                    (0..places.len()).collect()
                }
            };
            self.put_rows(&left, places, &mut motions[first..]);
        }
        Some(motions)
    }

    /// The same by rows, at some of the positions.
    fn put_rows(&self, at: &[usize], places: &[Point], motions: &mut [MotionLanes<TILE_LANES>]) {
        let is_rigid = self.field.form() == CoefficientForm::Rigid;
        let mut workspace = Workspace::<LANES>::new(self.plain.terms());
        for at in at.chunks(LANES) {
            let v = gather(|lane| places[at[lane.min(at.len() - 1)]]);
            let ([x, y], _) = self.plain.displacements(&v, false, &mut workspace);
            for (k, index) in at.iter().enumerate() {
                let motion = if is_rigid {
                    rigid_motion(&workspace.rows, k, self.plain.multiplied())
                } else {
                    [Vec2::new(x[k], y[k]), Vec2::ZERO, Vec2::ZERO]
                };
                motions[index / TILE_LANES].put(index % TILE_LANES, motion);
            }
        }
    }
}

/// Positions, and how they move.
#[derive(Clone, Copy, Debug)]
pub(super) struct Motions<'a> {
    pub(super) form: CoefficientForm,
    pub(super) places: &'a [Point],
    pub(super) motions: &'a [MotionLanes<TILE_LANES>],
}

impl Motions<'_> {
    /// Where some of them are after a share of the way.
    pub(super) fn at(self, share: f64, range: Range<usize>) -> Vec<Point> {
        let work = Moved {
            motions: self,
            share,
            range,
        };
        run_at(SimdLevel::detect(), work)
    }
}

struct Moved<'a> {
    motions: Motions<'a>,
    share: f64,
    range: Range<usize>,
}

impl LaneWork for Moved<'_> {
    type Output = Vec<Point>;

    #[inline(always)]
    fn run(self) -> Vec<Point> {
        let Motions {
            form,
            places,
            motions,
        } = self.motions;
        let mut moved = Vec::with_capacity(self.range.len());
        let mut first = self.range.start;
        while first < self.range.end {
            let (block, lane) = (first / TILE_LANES, first % TILE_LANES);
            let end = self.range.end.min((block + 1) * TILE_LANES);
            let ([x, y], _) = motions[block].at(form, self.share);
            let each = x[lane..].iter().zip(&y[lane..]);
            let each = places[first..end].iter().zip(each);
            moved.extend(each.map(|(place, (x, y))| *place + Vec2::new(*x, *y)));
            first = end;
        }
        moved
    }
}
