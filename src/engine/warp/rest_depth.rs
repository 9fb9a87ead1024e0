//! Depths of handles at rest, and the order of drawing that follows from them (mathematics 11.4).

use std::ops::RangeInclusive;
use std::sync::{Arc, OnceLock};

use super::digest::Collector;
use super::{CompiledRest, Digest, ResolvedRest, RestSpec, WarpError};
use crate::deform::{DeformError, IsCancelled, RestDeformation};
use crate::geometry::{DrawingOrder, Grid, Mesh};

impl RestSpec {
    /// The depths that a handle may have.
    pub const DEPTHS: RangeInclusive<f64> = -1000.0..=1000.0;

    /// Errors: Another number of depths than of handles, or one out of range.
    pub(super) fn check_depth(&self) -> Result<(), DeformError> {
        let Some(depth) = &self.depth else {
            return Ok(());
        };
        if depth.len() != self.p.len() {
            return Err(DeformError::DepthCount {
                rest: self.p.len(),
                depths: depth.len(),
            });
        }
        let is_wrong = |(_, depth): &(usize, &f64)| !Self::DEPTHS.contains(*depth);
        match depth.iter().enumerate().find(is_wrong) {
            Some((handle, value)) => Err(DeformError::BadDepth {
                handle,
                value: *value,
            }),
            None => Ok(()),
        }
    }
}

/// The depths of handles that do not all have the same, on one grid.
#[derive(Debug)]
pub(super) struct RestDepth {
    of_columns: Vec<f64>,
    /// Once a pose has needed it; within, `None` if cells are drawn row by row.
    order: OnceLock<Option<Arc<DrawingOrder>>>,
}

impl RestDepth {
    /// `None` if nothing follows from the depths, which have been checked.
    pub(super) fn new(field: &RestDeformation, depth: Option<&[f64]>) -> Option<Arc<Self>> {
        let of_columns = field.per_column(depth?);
        let differs = |pair: &[f64]| pair[0].to_bits() != pair[1].to_bits();
        of_columns.windows(2).any(differs).then(|| {
            Arc::new(Self {
                of_columns,
                order: OnceLock::new(),
            })
        })
    }

    /// The same depths for another grid, whose order is not computed yet.
    pub(super) fn unordered(&self) -> Arc<Self> {
        Arc::new(Self {
            of_columns: self.of_columns.clone(),
            order: OnceLock::new(),
        })
    }

    fn range(&self) -> [f64; 2] {
        let all = self.of_columns.iter();
        all.fold([f64::INFINITY, f64::NEG_INFINITY], |[least, most], d| {
            [least.min(*d), most.max(*d)]
        })
    }

    /// A digest that knows the depths, too.
    pub(super) fn digest(&self, digest: Digest) -> Digest {
        let digest = Collector::new("mlswarp ordered pose 1").bytes(&digest.0);
        let numbers = self.of_columns.iter().copied();
        numbers.fold(digest, Collector::float).finish()
    }
}

impl ResolvedRest {
    /// The same rest handles with other depths, for which nothing is computed again.
    ///
    /// # Errors
    /// Another number of depths than of handles, or one out of range.
    pub fn with_depth(&self, rest: &RestSpec) -> Result<Self, WarpError> {
        rest.check_depth().map_err(WarpError::Rest)?;
        let mut resolved = self.clone();
        resolved.depth = RestDepth::new(self.field(), rest.depth.as_deref());
        Ok(resolved)
    }

    /// Memory of the order of drawing, bytes.
    #[must_use]
    pub fn order_bytes(&self) -> u64 {
        let grid = || (self.grid().len() as u64).max(1);
        let cells = self.cut.as_ref().map_or_else(grid, |cut| cut.quads());
        self.depth.as_ref().map_or(0, |depth| {
            DrawingOrder::bytes_for(cells) + size_of_val(&*depth.of_columns) as u64
        })
    }

    /// A posed mesh whose cells are drawn by the depths of the handles.
    ///
    /// Errors: Cancelled.
    pub(super) fn in_order(
        &self,
        mesh: Mesh,
        plan: &CompiledRest,
        cancelled: IsCancelled<'_>,
    ) -> Result<Mesh, WarpError> {
        let Some(depth) = &self.depth else {
            return Ok(mesh);
        };
        let order = match depth.order.get() {
            Some(order) => order.clone(),
            None => {
                let order = self.order(depth, plan, cancelled)?;
                depth.order.get_or_init(|| order.map(Arc::new)).clone()
            }
        };
        Ok(mesh.in_order(order))
    }

    fn order(
        &self,
        depth: &RestDepth,
        plan: &CompiledRest,
        cancelled: IsCancelled<'_>,
    ) -> Result<Option<DrawingOrder>, WarpError> {
        let (field, of_columns) = (&**self.field(), &depth.of_columns);
        let of_table = plan.table.as_ref();
        let of_table = of_table.and_then(|table| table.carried(of_columns));
        let carried = of_table.map_or_else(
            || match &self.cut {
                Some(cut) => cut.carried(field, of_columns, cancelled),
                None => of_grid(field, self.grid(), of_columns, cancelled),
            },
            Some,
        );
        let carried = carried.ok_or(WarpError::Cancelled)?;
        Ok(match &self.cut {
            Some(cut) => cut.order(&carried, depth.range()),
            None => DrawingOrder::of_grid(self.grid(), &carried, depth.range()),
        })
    }
}

fn of_grid(
    field: &RestDeformation,
    grid: &Grid,
    of_columns: &[f64],
    cancelled: IsCancelled<'_>,
) -> Option<Vec<f32>> {
    let columns = grid.columns() as usize;
    #[expect(clippy::cast_possible_truncation, reason = "columns and rows are u32")]
    let vertex = |k: usize| {
        (
            grid.vertex((k % columns) as u32, (k / columns) as u32),
            None,
        )
    };
    field.carried(of_columns, grid.len(), &vertex, cancelled)
}
