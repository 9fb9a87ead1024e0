//! A segment in a row: its mass and moments relative to N vertices, and the shares of its two ends.

use super::segments::View;
use crate::deform::lanes::PointMass;

/// A segment: its mass, and the first and second moment of it along `(x, y)`, px, from a to b.
#[derive(Clone, Copy, Debug)]
pub(in crate::deform) struct SegmentMoments<const N: usize> {
    pub(in crate::deform) view: View<N>,
    pub(in crate::deform) place: PointMass<N>,
    pub(in crate::deform) first: [f64; N],
    pub(in crate::deform) second: [f64; N],
    pub(in crate::deform) x: [f64; N],
    pub(in crate::deform) y: [f64; N],
}

impl<const N: usize> SegmentMoments<N> {
    pub(in crate::deform) const ZERO: Self = Self {
        view: View::ZERO,
        place: PointMass::ZERO,
        first: [0.0; N],
        second: [0.0; N],
        x: [0.0; N],
        y: [0.0; N],
    };

    /// Mass and first moment along the direction, the share of end a.
    #[inline(always)]
    pub(in crate::deform) fn of_a(&self) -> [[f64; N]; 2] {
        let (mut mass, mut along) = ([0.0; N], [0.0; N]);
        for k in 0..N {
            mass[k] = self.view.share_a[k] * self.place.w[k] - self.first[k];
            along[k] = self.view.share_a[k] * self.first[k] - self.second[k];
        }
        [mass, along]
    }

    /// Mass and first moment along the direction, the share of end b.
    #[inline(always)]
    pub(in crate::deform) fn of_b(&self) -> [[f64; N]; 2] {
        let (mut mass, mut along) = ([0.0; N], [0.0; N]);
        for k in 0..N {
            mass[k] = self.view.share_b[k] * self.place.w[k] + self.first[k];
            along[k] = self.view.share_b[k] * self.first[k] + self.second[k];
        }
        [mass, along]
    }
}
