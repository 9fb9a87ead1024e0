//! Coefficients of N vertices, and the buffers in which methods compute them.

use super::lanes::{Coefficients, PointMass};
use super::methods::mls::segment_moments::SegmentMoments;

/// Buffers reused from row to row: one mass per point, one span per segment; of a spline the right
/// sides of its system.
#[derive(Debug, Default)]
pub(super) struct CoefficientScratch<const N: usize> {
    pub(super) places: Vec<PointMass<N>>,
    pub(super) spans: Vec<SegmentMoments<N>>,
    pub(super) sides: Vec<[f64; N]>,
}

/// Rows and scratch, reused while many positions are mapped, N at once.
#[derive(Debug)]
pub(super) struct Workspace<const N: usize> {
    pub(super) rows: Coefficients<N>,
    pub(super) scratch: CoefficientScratch<N>,
}

impl<const N: usize> Workspace<N> {
    pub(super) fn new(columns: usize) -> Self {
        Self {
            rows: Coefficients::zeroed(columns),
            scratch: CoefficientScratch::default(),
        }
    }
}
