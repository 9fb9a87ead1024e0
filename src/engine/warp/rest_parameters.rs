//! What a client states of handles at rest, turned into the engine's terms: parameters that fit the
//! method, positions in pixels, the grid, and the key by which caches know the result.

use super::digest::Collector;
use super::spec::at_most;
use super::{Digest, GridError, GridSpec, Limits, Quantity, RestMask, RestSpec, Units, WarpError};
use crate::deform::{DeformError, Handle, Handles, Identity, IsCancelled, RestDeformation};
use crate::geometry::{Grid, Point};

/// `grid: auto`: cells of a hundredth of the shorter side within this range, px (mathematics
/// section 12, step 1).
pub(super) const AUTO_CELL: (f64, f64) = (4.0, 8.0);
/// A mesh has two f32 per vertex.
const MESH_BYTES_PER_VERTEX: u64 = 8;
/// Largest number of grid lines per px along each axis (finer cells are smaller than pixels), and
/// the number that a small picture may always have.
const LINES_PER_PX: f64 = 4.0;
const LINES_ALWAYS: f64 = 4096.0;

/// Errors: A parameter of another method, too many handles.
pub(super) fn check_parameters(rest: &RestSpec) -> Result<(), WarpError> {
    let info = rest.method.info();
    let given = rest.parameters();
    if let Some((path, _)) = given
        .iter()
        .find(|(path, _)| info.parameter(path).is_none())
    {
        let parameter = path.split_once('/').map_or(path, |(object, _)| object);
        return Err(WarpError::ForeignParameter { parameter });
    }
    if rest.mask_threshold.is_some() && !rest.needs_mask() {
        return Err(WarpError::UnusedMask);
    }
    match &info.system {
        Some(system) => {
            let (_, most) = system.most_handles;
            let what = Quantity::SystemHandles(rest.method);
            at_most(what, most, rest.p.len() as u64)
        }
        None => Ok(()),
    }
}

/// The deformation of handles in px. `is_solved`: whether it will be evaluated.
pub(super) fn field(
    handles: Handles,
    rest: &RestSpec,
    is_solved: bool,
    cancelled: IsCancelled<'_>,
) -> Result<RestDeformation, DeformError> {
    // A method with a mesh of its own is solved when the mask is known.
    let make = if is_solved && rest.method.info().mesh.is_none() {
        RestDeformation::of
    } else {
        RestDeformation::without_system
    };
    make(
        handles,
        rest.coincident,
        rest.method,
        &rest.parameters(),
        cancelled,
    )
}

pub(super) fn resolve_grid(
    spec: GridSpec,
    width: f64,
    height: f64,
    limits: &Limits,
) -> Result<Grid, WarpError> {
    // Per axis too, because the working memory of a row, one per thread, grows with its columns.
    let along = |what, length: f64, count: u32| {
        #[expect(
            clippy::cast_possible_truncation,
            clippy::cast_sign_loss,
            reason = "a side is at most 2^32"
        )]
        let limit = (length * LINES_PER_PX).max(LINES_ALWAYS) as u64 + 1;
        at_most(what, limit, count.into())
    };
    let check = |columns: u32, rows: u32| {
        along(Quantity::GridColumns, width, columns)?;
        along(Quantity::GridRows, height, rows)?;
        at_most(
            Quantity::GridVertices,
            limits.plan_bytes / MESH_BYTES_PER_VERTEX,
            u64::from(columns) * u64::from(rows),
        )
    };
    let with_cell = |cell: f64| {
        check(
            1 + Grid::cells_along(width, cell),
            1 + Grid::cells_along(height, cell),
        )?;
        Ok(Grid::with_cell(width, height, cell))
    };
    match spec {
        GridSpec::Tolerance(tolerance) if !GridSpec::TOLERANCE_RANGE_PX.contains(&tolerance) => {
            Err(WarpError::BadGrid(GridError::Tolerance(tolerance)))
        }
        GridSpec::Auto | GridSpec::Tolerance(_) => with_cell(auto_cell(width, height)),
        GridSpec::Pixel => with_cell(1.0),
        GridSpec::Cell(cell) if cell.is_finite() && cell > 0.0 => with_cell(cell),
        GridSpec::Cell(cell) => Err(WarpError::BadGrid(GridError::Cell(cell))),
        GridSpec::Counts { columns, rows } if columns >= 2 && rows >= 2 => {
            check(columns, rows)?;
            Ok(Grid::with_counts(width, height, columns, rows))
        }
        GridSpec::Counts { columns, rows } => {
            Err(WarpError::BadGrid(GridError::Counts { columns, rows }))
        }
    }
}

/// The side of a cell of `grid: auto`, px.
pub(super) fn auto_cell(width: f64, height: f64) -> f64 {
    (width.min(height) / 100.0).clamp(AUTO_CELL.0, AUTO_CELL.1)
}

pub(super) fn unit(units: Units, grid: &Grid) -> (f64, f64) {
    match units {
        Units::Px => (1.0, 1.0),
        Units::Normalized => (grid.width(), grid.height()),
    }
}

pub(super) fn to_px(handles: &[Handle], (ux, uy): (f64, f64)) -> Vec<Handle> {
    let px = |p: &Point| Point::new(p.x * ux, p.y * uy);
    handles
        .iter()
        .map(|h| match h {
            Handle::Point(p) => Handle::Point(px(p)),
            Handle::Polyline(places) => Handle::Polyline(places.iter().map(px).collect()),
            Handle::Missing => Handle::Missing,
        })
        .collect()
}

/// `mixed`: whether there are points and lines.
pub(super) fn plan_key(
    field: &RestDeformation,
    grid: &Grid,
    mixed: bool,
    is_subdivided: bool,
    mask: Option<&RestMask>,
) -> Digest {
    let Identity { plan, numbers, .. } = field.identity();
    let key = Collector::new("mlswarp plan 2").integer(plan);
    let key = numbers.into_iter().fold(key, Collector::float);
    let mut key = key
        // A mass that all points share cancels without lines.
        .float(
            field
                .parameters()
                .get("point_mass")
                .filter(|_| mixed)
                .unwrap_or(1.0),
        )
        .float(grid.width())
        .float(grid.height())
        .float(grid.cell().0)
        .float(grid.cell().1)
        .integer(grid.columns().into())
        .integer(grid.rows().into())
        // Plans of subdivided grids may keep more rows.
        .integer(is_subdivided.into());
    for (handle, &weight) in field
        .handles()
        .handles()
        .iter()
        .zip(field.handles().weights())
    {
        key = key.float(weight).integer(handle.places().len() as u64);
        for p in handle.places() {
            key = key.float(p.x).float(p.y);
        }
    }
    with_mask(key, mask).finish()
}

/// A key that knows the mask, if there is one.
pub(super) fn with_mask(key: Collector, mask: Option<&RestMask>) -> Collector {
    match mask {
        Some(mask) => key.bytes(&mask.digest.0),
        None => key,
    }
}
