//! What is computed once for handles at rest, before any pose.

use crate::deform::{CoefficientTable, SubdivisionCache};

/// The A_j of every grid vertex, or none if their table would not fit, and those inside cells that
/// poses have needed.
#[derive(Debug)]
pub struct CompiledRest {
    pub(super) table: Option<CoefficientTable>,
    pub(super) exact: SubdivisionCache,
    pub(super) exact_bytes: u64,
}

impl CompiledRest {
    /// Memory held at most, bytes: its weight in a cache.
    #[must_use]
    pub fn bytes(&self) -> u64 {
        self.table.as_ref().map_or(0, CoefficientTable::bytes) + self.exact_bytes
    }
}
