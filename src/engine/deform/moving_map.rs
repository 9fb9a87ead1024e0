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

/// Positions that one task maps.
const TASK: usize = 32 * LANES;

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
        let mut motions = vec![MotionLanes::ZERO; places.len().div_ceil(TILE_LANES)];
        let tasks = places.par_chunks(TASK);
        let tasks = tasks.zip(motions.par_chunks_mut(TASK / TILE_LANES));
        tasks.try_for_each_init(
            || (),
            |(), (places, motions)| self.put_motions(places, motions, cancelled),
        )?;
        Some(motions)
    }

    /// Replaces positions by f of them. In parallel on the current pool; `None` when cancelled.
    pub(super) fn map_all(&self, places: &mut [Point], cancelled: IsCancelled<'_>) -> Option<()> {
        let mut left = vec![Vec::new(); places.len().div_ceil(TASK)];
        let tasks = places.par_chunks_mut(TASK).zip(left.par_chunks_mut(1));
        tasks.enumerate().try_for_each_init(
            || vec![Point::default(); TASK],
            |mapped, (task, (places, left))| {
                let between = self.between_checks();
                for (k, places) in places.chunks_mut(between).enumerate() {
                    if cancelled() {
                        return None;
                    }
                    let first = task * TASK + k * between;
                    let mapped = &mut mapped[..places.len()];
                    let at = self.map_some(places, mapped);
                    left[0].extend(at.into_iter().map(|index| (first + index, places[index])));
                    places.copy_from_slice(mapped);
                }
                Some(())
            },
        )?;
        // Those of all tasks together, so that they fill lanes.
        let mut left = left.concat();
        let tasks = left.par_chunks_mut(self.between_checks());
        tasks.try_for_each_init(
            || (),
            |(), left| {
                if cancelled() {
                    return None;
                }
                self.map_by_rows(left);
                Some(())
            },
        )?;
        for (index, place) in left {
            places[index] = place;
        }
        Some(())
    }

    /// Replaces positions, which have some index, by f of them.
    fn map_by_rows(&self, at: &mut [(usize, Point)]) {
        let form = self.field.form();
        let places: Vec<Point> = at.iter().map(|(_, place)| *place).collect();
        let all: Vec<usize> = (0..places.len()).collect();
        let mut motions = vec![MotionLanes::ZERO; places.len().div_ceil(TILE_LANES)];
        self.put_rows(&all, &places, &mut motions);
        for (k, (_, place)) in at.iter_mut().enumerate() {
            let ([x, y], _) = motions[k / TILE_LANES].at(form, 1.0);
            let lane = k % TILE_LANES;
            *place = *place + Vec2::new(x[lane], y[lane]);
        }
    }

    /// Maps positions by sums; the indices of those that need their rows.
    fn map_some(&self, places: &[Point], mapped: &mut [Point]) -> Vec<usize> {
        match &self.sums {
            Some(sums) => sums.map(self.field.form(), places, mapped),
            None => (0..places.len()).collect(),
        }
    }

    /// Positions between two checks of cancellation.
    fn between_checks(&self) -> usize {
        LANES * (COLUMNS_BETWEEN_CHECKS / self.plain.columns().max(1)).max(1)
    }

    fn put_motions(
        &self,
        places: &[Point],
        motions: &mut [MotionLanes<TILE_LANES>],
        cancelled: IsCancelled<'_>,
    ) -> Option<()> {
        let between = self.between_checks();
        let parts = places.chunks(between);
        for (places, motions) in parts.zip(motions.chunks_mut(between / TILE_LANES)) {
            if cancelled() {
                return None;
            }
            let left = match &self.sums {
                Some(sums) => sums.motions(places, motions),
                None => {
                    motions.fill(MotionLanes::ZERO);
                    (0..places.len()).collect()
                }
            };
            self.put_rows(&left, places, motions);
        }
        Some(())
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
    /// Where some of them are after a share of the way, instead of what `moved` has.
    pub(super) fn at(self, share: f64, range: Range<usize>, moved: &mut Vec<Point>) {
        moved.clear();
        let work = Moved {
            motions: self,
            share,
            range,
            moved,
        };
        run_at(SimdLevel::detect(), work);
    }
}

struct Moved<'a> {
    motions: Motions<'a>,
    share: f64,
    range: Range<usize>,
    moved: &'a mut Vec<Point>,
}

impl LaneWork for Moved<'_> {
    type Output = ();

    #[inline(always)]
    fn run(self) {
        let Motions {
            form,
            places,
            motions,
        } = self.motions;
        let mut first = self.range.start;
        while first < self.range.end {
            let (block, lane) = (first / TILE_LANES, first % TILE_LANES);
            let end = self.range.end.min((block + 1) * TILE_LANES);
            let ([x, y], _) = motions[block].at(form, self.share);
            let each = x[lane..].iter().zip(&y[lane..]);
            let each = places[first..end].iter().zip(each);
            let each = each.map(|(place, (x, y))| *place + Vec2::new(*x, *y));
            self.moved.extend(each);
            first = end;
        }
    }
}
