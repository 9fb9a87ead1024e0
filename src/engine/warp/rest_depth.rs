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
    /// Shares of the range of all.
    of_columns: Vec<f64>,
    /// Once it has been needed; within, `None` if cells are drawn row by row.
    order: OnceLock<Option<Arc<DrawingOrder>>>,
    /// The same depths on the grid on which the inverse is searched, if that is another one.
    to_invert: OnceLock<Arc<Self>>,
}

/// The order in which the cells of a grid are drawn, for all setups of the same handles, depths and
/// grid.
#[derive(Clone, Debug)]
pub struct OrderOfCells(Option<Arc<DrawingOrder>>);

impl RestDepth {
    /// `None` if nothing follows from the depths, which have been checked.
    pub(super) fn new(field: &RestDeformation, depth: Option<&[f64]>) -> Option<Arc<Self>> {
        Some(Self::of_columns(field.shares_of_columns(depth?)?))
    }

    fn of_columns(of_columns: Vec<f64>) -> Arc<Self> {
        Arc::new(Self {
            of_columns,
            order: OnceLock::new(),
            to_invert: OnceLock::new(),
        })
    }

    /// The same depths on the grid on which the inverse is searched, of which there is one: its
    /// order is computed once, too.
    pub(super) fn to_invert(&self) -> Arc<Self> {
        let new = || Self::of_columns(self.of_columns.clone());
        Arc::clone(self.to_invert.get_or_init(new))
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
    /// Another number of depths than of handles, or one out of range; more work than the limit.
    pub fn with_depth(&self, rest: &RestSpec) -> Result<Self, WarpError> {
        rest.check_depth().map_err(WarpError::Rest)?;
        let mut resolved = self.clone();
        resolved.depth = RestDepth::new(self.field(), rest.depth.as_deref());
        resolved.check_grid()?;
        Ok(resolved)
    }

    /// Memory of the order of drawing, and of that on the grid on which the inverse is searched,
    /// bytes.
    #[must_use]
    pub fn order_bytes(&self) -> u64 {
        self.depth.as_ref().map_or(0, |depth| {
            let cells = self.ordered_cells() + self.cells_to_invert();
            DrawingOrder::bytes_for(cells) + 2 * size_of_val(&*depth.of_columns) as u64
        })
    }

    /// The most memory while [`ResolvedRest::order`] computes, bytes.
    #[must_use]
    pub fn order_peak_bytes(&self) -> u64 {
        let vertices = self.posed_vertices();
        DrawingOrder::peak_bytes_for(vertices, self.ordered_cells())
            .saturating_add(self.field().carrying_bytes(vertices))
    }

    fn ordered_cells(&self) -> u64 {
        let grid = || self.grid().len() as u64;
        self.cut.as_ref().map_or_else(grid, |cut| cut.quads())
    }

    /// The key of the order of drawing, if handles differ in depth and it has not been computed.
    #[must_use]
    pub fn lacks_order(&self) -> Option<Digest> {
        let depth = self.depth.as_ref()?;
        let is_lacking = depth.order.get().is_none();
        is_lacking.then(|| depth.digest(self.plan_key()))
    }

    /// The order of the cells; computed now if it has not been. CPU work, as much as a plan's
    /// if the plan has no weights of handles. Stops when `cancelled` returns true.
    ///
    /// # Errors
    /// Cancelled.
    pub fn order(
        &self,
        plan: &CompiledRest,
        cancelled: IsCancelled<'_>,
    ) -> Result<OrderOfCells, WarpError> {
        let Some(depth) = &self.depth else {
            return Ok(OrderOfCells(None));
        };
        if let Some(order) = depth.order.get() {
            return Ok(OrderOfCells(order.clone()));
        }
        let order = self.ordered(depth, plan, cancelled);
        let order = order.ok_or(WarpError::Cancelled)?.map(Arc::new);
        Ok(OrderOfCells(depth.order.get_or_init(|| order).clone()))
    }

    /// Takes an order that was computed for another setup with this key.
    pub fn keep_order(&self, order: &OrderOfCells) {
        if let Some(depth) = &self.depth {
            let _ = depth.order.set(order.0.clone());
        }
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
        Ok(mesh.in_order(self.order(plan, cancelled)?.0))
    }

    /// The outer `None`: cancelled.
    fn ordered(
        &self,
        depth: &RestDepth,
        plan: &CompiledRest,
        cancelled: IsCancelled<'_>,
    ) -> Option<Option<DrawingOrder>> {
        let (field, of_columns) = (&**self.field(), &depth.of_columns);
        let carried = match (&plan.table, &self.cut) {
            (Some(table), _) if table.has_weights() => table.carried(of_columns, cancelled),
            (_, Some(cut)) => cut.carried(field, of_columns, cancelled),
            (_, None) => of_grid(field, self.grid(), of_columns, cancelled),
        }?;
        match &self.cut {
            Some(cut) => cut.order(&carried, cancelled),
            None => DrawingOrder::of_grid(self.grid(), &carried, cancelled),
        }
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
