//! Estimates of work: operations, counted before anything is computed, so that the same request is
//! always refused or always accepted. An operation is about what it takes to weigh one point at one
//! position in a table of coefficients: some nanoseconds. What is a product or a power by nature is
//! compared with [`Limits::work`](super::Limits::work).

use super::Candidate;
use super::error::{Task, WarpError};
use crate::deform::{Handle, RestDeformation};

/// Operations for weighing a point at a position.
const POINT_OPERATIONS: u64 = 2;
/// Operations for a point of a set of which another one is left out: it is copied into a set of its
/// own, whose rank is found and whose map is made, and weighed at one position, not at several at
/// once.
const LEFT_OUT_OPERATIONS: u64 = 8;
/// Coefficients of a table that an operation poses.
const COEFFICIENTS_PER_OPERATION: u64 = 16;
/// Times that f is computed to find the inverse of a position, on the average.
pub(super) const EVALUATIONS_PER_INVERSE: u64 = 8;
/// Operations for a box of the tree in which an inverse is sought, or for the patch in it.
pub(super) const BOX_OPERATIONS: u64 = 4;
/// Operations for measuring a cell of a posed grid.
pub(super) const CELL_OPERATIONS: u64 = 40;

/// Errors: More operations than the limit.
pub(super) const fn at_most(task: Task, limit: u64, actual: u64) -> Result<(), WarpError> {
    if actual > limit {
        Err(WarpError::TooMuchWork {
            task,
            limit,
            actual,
        })
    } else {
        Ok(())
    }
}

/// Operations of f at a position.
pub(super) fn of_position(field: &RestDeformation) -> u64 {
    let of = |handle: &Handle| match handle {
        Handle::Point(_) => POINT_OPERATIONS,
        Handle::Polyline(places) => field.segment_operations() * (places.len() as u64 - 1),
        Handle::Missing => 0,
    };
    1 + field.handles().handles().iter().map(of).sum::<u64>()
}

/// Operations of the coefficients of a vertex, or, of a grid without a table, of posing one.
pub(super) fn of_vertex(field: &RestDeformation) -> u64 {
    of_position(field) + field.operations()
}

/// Operations of posing a vertex by a table.
pub(super) fn of_table(field: &RestDeformation) -> u64 {
    1 + field.terms() as u64 / COEFFICIENTS_PER_OPERATION
}

/// Operations of leaving out each point in turn, for each candidate.
pub(super) fn of_comparison(points: u64, candidates: &[Candidate]) -> u64 {
    let of = |candidate: &Candidate| match &candidate.method.info().system {
        Some(system) => (system.operations_of_comparison)(points),
        None => points
            .saturating_mul(points)
            .saturating_mul(LEFT_OUT_OPERATIONS),
    };
    candidates.iter().map(of).fold(0, u64::saturating_add)
}
