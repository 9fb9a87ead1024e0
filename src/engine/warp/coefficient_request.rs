//! The coefficients on a lattice of the client's choice, for clients that pose by themselves.

use std::sync::Arc;

use super::cut_rest::check_uncut;
use super::digest::Collector;
use super::rest_parameters::{resolve_grid, with_mask};
use super::spec::at_most;
use super::{Digest, GridSpec, Limits, Quantity, ResolvedRest, RestSpec, Units, WarpError};
use crate::deform::{CoefficientTable, ColumnMember, IsCancelled, RestDeformation};
use crate::geometry::Grid;
use crate::pixmap::Extent;

/// A lattice of vertices at equal distances over the picture, and the deformation of a
/// [`ResolvedRest`].
#[derive(Clone, Debug)]
pub struct CoefficientRequest {
    field: Arc<RestDeformation>,
    grid: Grid,
    rest: Digest,
}

/// How many numbers a table of coefficients has.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct CoefficientCount {
    /// Vertices of the lattice.
    pub vertices: u64,
    /// See [`CoefficientRequest::planes`].
    pub planes: u64,
    /// See [`CoefficientRequest::members_len`].
    pub members: u64,
}

impl CoefficientCount {
    /// That of [`CoefficientRequest::new`], of which the system of a spline is not computed.
    ///
    /// # Errors
    /// Those of [`ResolvedRest::new`] and [`CoefficientRequest::new`]; cancelled.
    pub fn new(
        (rest, extent): (&RestSpec, Extent),
        columns: u32,
        rows: u32,
        limits: &Limits,
        cancelled: IsCancelled<'_>,
    ) -> Result<Self, WarpError> {
        let setup = ResolvedRest::resolve(rest, extent, limits, false, cancelled)?;
        CoefficientRequest::new(&setup, columns, rows, limits).map(|table| table.count())
    }
}

impl ResolvedRest {
    /// Digest of everything but the grid that the coefficients depend on: picture size, rest
    /// handles, method and parameters.
    #[must_use]
    pub fn rest_digest(&self) -> Digest {
        let (field, (width, height, units)) = (self.field(), self.on());
        let mut key = Collector::new("mlswarp rest 1")
            .float(width)
            .float(height)
            .integer((units == Units::Normalized).into())
            .integer(field.identity().rest);
        for parameter in [self.alpha(), self.point_mass(), self.smoothing()] {
            key = key
                .integer(parameter.is_some().into())
                .float(parameter.unwrap_or_default());
        }
        for (_, value) in self.own_parameters().iter() {
            key = key.float(value);
        }
        for (handle, &weight) in field
            .client_handles()
            .handles()
            .iter()
            .zip(field.client_handles().weights())
        {
            key = key.float(weight).integer(handle.places().len() as u64);
            for p in handle.places() {
                key = key.float(p.x).float(p.y);
            }
        }
        // Handles are grouped by a distance that the client may choose.
        let key = field
            .column_members()
            .iter()
            .fold(key, |key, member| key.integer(member.column as u64));
        with_mask(key, self.mask()).finish()
    }
}

impl CoefficientRequest {
    /// The lattice of `columns` x `rows` vertices.
    ///
    /// # Errors
    /// The lattice or its coefficients exceed a limit, or the method has no table.
    pub fn new(
        setup: &ResolvedRest,
        columns: u32,
        rows: u32,
        limits: &Limits,
    ) -> Result<Self, WarpError> {
        if let Some(reason) = CoefficientTable::reason_against(setup.field()) {
            return Err(WarpError::NoTable { reason });
        }
        check_uncut(setup.cut.as_ref(), "a table of coefficients for clients")?;
        let (width, height, _) = setup.on();
        let grid = resolve_grid(GridSpec::Counts { columns, rows }, width, height, limits)?;
        let table = Self {
            field: Arc::clone(setup.field()),
            grid,
            rest: setup.rest_digest(),
        };
        at_most(Quantity::PlanBytes, limits.plan_bytes, table.bytes())?;
        Ok(table)
    }

    /// Memory of the coefficients, bytes; known before anything is allocated.
    #[must_use]
    pub fn bytes(&self) -> u64 {
        CoefficientTable::bytes_for(&self.field, self.grid.len())
    }

    /// Computes the coefficients in parallel on the current rayon pool. CPU work. Stops when
    /// `cancelled` returns true.
    ///
    /// # Errors
    /// Cancelled.
    pub fn fill(&self, cancelled: IsCancelled<'_>) -> Result<CoefficientTable, WarpError> {
        CoefficientTable::of_grid(&self.field, &self.grid, cancelled).ok_or(WarpError::Cancelled)
    }

    /// How many numbers the table has.
    #[must_use]
    pub fn count(&self) -> CoefficientCount {
        CoefficientCount {
            vertices: self.grid.len() as u64,
            planes: self.planes() as u64,
            members: self.members_len() as u64,
        }
    }

    /// The lattice.
    #[must_use]
    pub const fn grid(&self) -> &Grid {
        &self.grid
    }

    /// How the coefficients are laid out: 0, 1 and 2 are the numbers of
    /// [`CoefficientForm`](crate::deform::CoefficientForm), others those of their method.
    #[must_use]
    pub fn layout(&self) -> u32 {
        self.field.layout()
    }

    /// Columns of the table.
    #[must_use]
    pub fn columns(&self) -> usize {
        self.field.handles().columns()
    }

    /// Numbers per vertex.
    #[must_use]
    pub fn planes(&self) -> usize {
        CoefficientTable::planes_for(&self.field)
    }

    /// The handles behind the columns.
    #[must_use]
    pub fn members(&self) -> Vec<ColumnMember> {
        self.field.column_members()
    }

    /// Number of [`CoefficientRequest::members`].
    #[must_use]
    pub fn members_len(&self) -> usize {
        self.field.client_handles().columns()
    }

    /// [`ResolvedRest::rest_digest`] of the setup.
    #[must_use]
    pub const fn rest_digest(&self) -> Digest {
        self.rest
    }
}
