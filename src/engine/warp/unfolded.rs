//! A pose whose folds are removed (mathematics 9.3): in the image, what its mesh draws; outside of
//! it, a product of maps.

use std::sync::OnceLock;

use super::{CompiledRest, RemovedFolds, ResolvedRest, Task, WarpError, system_bytes, work};
use crate::deform::{
    DeformError, FoldFree, FoldFreeError, Handle, IsCancelled, Pose, ProductFactor, ProductWork,
};
use crate::geometry::{Grid, Mesh, Point, untangle};

/// Memory of a vertex while a mesh is mended, and of a target, bytes.
const VERTEX_BYTES: u64 = 600;
const TARGET_BYTES: u64 = 130;
/// Targets of a line in a length of one cell.
const TARGETS_PER_CELL: f64 = 2.0;

/// What follows from removing the folds of a pose, beside its mesh.
#[derive(Debug)]
pub(super) struct Unfolded {
    product: FoldFree,
    /// Its factors, once they are needed.
    factors: OnceLock<Vec<ProductFactor>>,
    /// Of the linear systems of all factors, bytes.
    system_bytes: u64,
    removed: RemovedFolds,
    border_crossings: u64,
}

impl Unfolded {
    /// Positions outside of the image, by the product. `None` when cancelled.
    pub(super) fn map_outside(
        &self,
        places: &[Point],
        cancelled: IsCancelled<'_>,
    ) -> Option<Vec<Point>> {
        match self.factors.get() {
            Some(factors) => self.product.map_by(factors, places, cancelled),
            None => self.product.map_all(places, cancelled),
        }
    }

    /// Makes the factors, for many positions. `None` when cancelled.
    pub(super) fn keep_factors(&self, cancelled: IsCancelled<'_>) -> Option<()> {
        if self.factors.get().is_none() {
            let _ = self.factors.set(self.product.factors(cancelled)?);
        }
        Some(())
    }

    /// The number of factors.
    pub(super) const fn factors(&self) -> u64 {
        self.removed.factors
    }

    /// What was done.
    pub(super) const fn removed(&self) -> RemovedFolds {
        self.removed
    }

    /// How often the border of the mesh crosses itself, so that positions are covered twice.
    pub(super) const fn border_crossings(&self) -> u64 {
        self.border_crossings
    }

    /// Memory without the factors, bytes.
    pub(super) fn bytes(&self) -> u64 {
        self.product.bytes()
    }

    /// Memory of the factors, bytes.
    pub(super) fn factor_bytes(&self) -> u64 {
        self.product.factor_bytes() + self.system_bytes
    }
}

impl ResolvedRest {
    /// Checks that folds can be removed, and the work of it as far as it is known.
    ///
    /// Errors: A method or metric without a map that has no folds; more work than the limit.
    pub(super) fn check_unfolding(&self) -> Result<(), WarpError> {
        let info = self.field().method().info();
        let is_exact = info.interpolates(self.field().parameters());
        if self.cut.is_some() || !info.can_unfold || !is_exact {
            return Err(WarpError::NotUnfolded);
        }
        let work = self.product_work();
        let least = FoldFree::least_work(self.field(), self.grid(), &work);
        work::at_most(Task::Folds, work.most, least)
    }

    /// Memory while folds are removed, bytes. Factors are made one after the other.
    pub(super) fn unfolding_bytes(&self) -> u64 {
        let handles = self.field().handles().handles();
        let system = system_bytes(self.field().method(), handles.len() as u64);
        let targets: u64 = segments(handles)
            .filter_map(|ends| self.part_of(ends))
            .map(|(.., count)| u64::from(count) + 1)
            .sum();
        let targets = targets + handles.len() as u64;
        FoldFree::peak_bytes(self.field(), self.grid())
            + system
            + VERTEX_BYTES * self.grid().len() as u64
            + TARGET_BYTES * targets
    }

    fn product_work(&self) -> ProductWork {
        let info = self.field().method().info();
        let handles = self.field().handles().handles().len() as u64;
        let system = info.system.as_ref();
        ProductWork {
            of_position: work::of_position(self.field()),
            of_factor: system.map_or(0, |system| (system.operations)(handles)),
            most: self.max_work(),
            taken: 0,
        }
    }

    /// The mesh of a pose without folds; `None` if `plain`, the mesh of the plain f, has none.
    pub(super) fn unfold(
        &self,
        plan: &CompiledRest,
        pose: &Pose,
        plain: &Mesh,
        cancelled: IsCancelled<'_>,
    ) -> Result<Option<(Mesh, Unfolded)>, WarpError> {
        let mut work = self.product_work();
        let product = FoldFree::of(self.field(), pose, plain, &mut work, cancelled);
        let Some(product) = product.map_err(|error| self.unfold_error(error))? else {
            return Ok(None);
        };
        let mesh = product.mesh(self.grid(), plan.table.as_ref(), cancelled);
        let mesh = mesh.ok_or(WarpError::Cancelled)?;
        let left = work.most.saturating_sub(work.taken);
        let of_evaluation = (self.grid().len() as u64).saturating_mul(work::CELL_OPERATIONS);
        let evaluations = u32::try_from(left / of_evaluation.max(1)).unwrap_or(u32::MAX);
        let mended = untangle(&mesh, &self.targets(pose), evaluations, cancelled);
        let mended = mended.ok_or(WarpError::Cancelled)?;
        let crossings = mended.mesh.border_crossings(cancelled);
        let border_crossings = crossings.ok_or(WarpError::Cancelled)?;
        let handles = self.field().handles().handles().len() as u64;
        let of_factor = system_bytes(self.field().method(), handles);
        let removed = RemovedFolds {
            factors: product.count() as u64,
            cells: product.folded(),
            mended: mended.mended,
        };
        let unfolded = Unfolded {
            system_bytes: of_factor * removed.factors,
            product,
            factors: OnceLock::new(),
            removed,
            border_crossings,
        };
        Ok(Some((mended.mesh, unfolded)))
    }

    fn unfold_error(&self, error: FoldFreeError) -> WarpError {
        match error {
            FoldFreeError::Unreachable(handles) => WarpError::Unreachable { handles },
            FoldFreeError::TooMuchWork(actual) => WarpError::TooMuchWork {
                task: Task::Folds,
                limit: self.max_work(),
                actual,
            },
            FoldFreeError::Deform(DeformError::Cancelled) => WarpError::Cancelled,
            FoldFreeError::Deform(error) => WarpError::Posed(error),
        }
    }

    /// Where the mesh shall take the handles: points, and lines along their length. Where handles
    /// contradict each other, there is nothing to meet.
    fn targets(&self, pose: &Pose) -> Vec<(Point, Point)> {
        let mut targets = Vec::new();
        self.field().for_each_handle(pose, |rest, posed| {
            let ([a, b], [c, d]) = match (rest, posed) {
                ([a], [c]) => return targets.push((*a, *c)),
                ([a, b], [c, d]) => ([*a, *b], [*c, *d]),
                _ => return,
            };
            if let Some((from, to, count)) = self.part_of([a, b]) {
                let share = |k: u32| from + (to - from) * f64::from(k) / f64::from(count);
                let at = |share: f64| (a.lerp(b, share), c.lerp(d, share));
                targets.extend((0..=count).map(|k| at(share(k))));
            }
        });
        targets.retain(|(rest, _)| !pose.conflicts().contains(*rest));
        targets
    }

    /// The part of a segment that lies in the image: the shares of its length where it begins and
    /// ends, and how many parts of half a cell it has.
    fn part_of(&self, [a, b]: [Point; 2]) -> Option<(f64, f64, u32)> {
        let grid: &Grid = self.grid();
        let (mut from, mut to) = (0.0_f64, 1.0_f64);
        let sides = [
            (a.x, b.x - a.x, grid.width()),
            (a.y, b.y - a.y, grid.height()),
        ];
        for (start, way, side) in sides {
            let ends = [-start / way, (side - start) / way];
            if way == 0.0 {
                if !(0.0..=side).contains(&start) {
                    return None;
                }
            } else {
                from = from.max(ends[0].min(ends[1]));
                to = to.min(ends[0].max(ends[1]));
            }
        }
        let cell = grid.cell().0.min(grid.cell().1);
        let parts = (to - from) * a.distance(b) / cell * TARGETS_PER_CELL;
        #[expect(
            clippy::cast_possible_truncation,
            clippy::cast_sign_loss,
            reason = "float to integer saturates"
        )]
        let count = parts.ceil().max(1.0) as u32;
        (from <= to).then_some((from, to, count))
    }
}

fn segments(handles: &[Handle]) -> impl Iterator<Item = [Point; 2]> + '_ {
    let segments = |handle: &'_ Handle| -> Vec<[Point; 2]> {
        let ends = handle.places().windows(2);
        ends.map(|ends| [ends[0], ends[1]]).collect()
    };
    handles.iter().flat_map(segments)
}
