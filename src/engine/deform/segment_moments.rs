//! A segment in a row: its mass and moments relative to N vertices, and the shares of its two ends.

use super::lanes::{Coefficients, PointMass};
use super::segments::View;

/// A segment: its mass, and the first and second moment of it along `(x, y)`, px, from a to b.
#[derive(Clone, Copy, Debug)]
pub(super) struct SegmentMoments<const N: usize> {
    pub(super) view: View<N>,
    pub(super) place: PointMass<N>,
    pub(super) first: [f64; N],
    pub(super) second: [f64; N],
    pub(super) x: [f64; N],
    pub(super) y: [f64; N],
}

impl<const N: usize> SegmentMoments<N> {
    pub(super) const ZERO: Self = Self {
        view: View::ZERO,
        place: PointMass::ZERO,
        first: [0.0; N],
        second: [0.0; N],
        x: [0.0; N],
        y: [0.0; N],
    };

    /// Mass and first moment along the direction, the share of end a.
    #[inline(always)]
    pub(super) fn of_a(&self) -> [[f64; N]; 2] {
        let (mut mass, mut along) = ([0.0; N], [0.0; N]);
        for k in 0..N {
            mass[k] = self.view.share_a[k] * self.place.w[k] - self.first[k];
            along[k] = self.view.share_a[k] * self.first[k] - self.second[k];
        }
        [mass, along]
    }

    /// Mass and first moment along the direction, the share of end b.
    #[inline(always)]
    pub(super) fn of_b(&self) -> [[f64; N]; 2] {
        let (mut mass, mut along) = ([0.0; N], [0.0; N]);
        for k in 0..N {
            mass[k] = self.view.share_b[k] * self.place.w[k] + self.first[k];
            along[k] = self.view.share_b[k] * self.first[k] + self.second[k];
        }
        [mass, along]
    }
}

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
