//! What a session object says about handles at rest.

use super::{Digest, Limits, ResolvedRest, RestSpec, Warning, WarpError};
use crate::deform::{IsCancelled, Parameters};
use crate::pixmap::Extent;

/// The effective values of rest handles and their parameters on a picture. They cost little beside
/// a [`ResolvedRest`]: the system of a spline is not computed.
#[derive(Clone, Debug, PartialEq)]
pub struct RestSummary {
    /// See [`ResolvedRest::dimensions`].
    pub grid: (u32, u32),
    /// See [`ResolvedRest::cell`].
    pub cell: (f64, f64),
    /// See [`ResolvedRest::alpha`].
    pub alpha: Option<f64>,
    /// See [`ResolvedRest::point_mass`].
    pub point_mass: Option<f64>,
    /// See [`ResolvedRest::smoothing`].
    pub smoothing: Option<f64>,
    /// See [`ResolvedRest::own_parameters`].
    pub own: Parameters,
    /// See [`ResolvedRest::groups`].
    pub groups: Vec<Vec<usize>>,
    /// See [`ResolvedRest::rest_digest`].
    pub rest_digest: Digest,
    /// See [`ResolvedRest::rest_warnings`].
    pub warnings: Vec<Warning>,
}

impl RestSummary {
    /// Resolves and validates as [`ResolvedRest::new`]; stops when `cancelled` returns true.
    ///
    /// # Errors
    /// Those of [`ResolvedRest::new`]; cancelled.
    pub fn new(
        rest: &RestSpec,
        extent: Extent,
        limits: &Limits,
        cancelled: IsCancelled<'_>,
    ) -> Result<Self, WarpError> {
        ResolvedRest::resolve(rest, extent, limits, false, cancelled).map(|setup| Self::of(&setup))
    }

    /// The summary of a setup.
    #[must_use]
    pub fn of(setup: &ResolvedRest) -> Self {
        Self {
            grid: setup.dimensions(),
            cell: setup.cell(),
            alpha: setup.alpha(),
            point_mass: setup.point_mass(),
            smoothing: setup.smoothing(),
            own: setup.own_parameters(),
            groups: setup.groups(),
            rest_digest: setup.rest_digest(),
            warnings: setup.rest_warnings().to_vec(),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::deform::{AcceptedHandles, Handle, METHODS};
    use crate::geometry::Point;

    #[test]
    fn a_summary_without_the_system_of_a_spline_says_the_same() {
        let (extent, limits) = (Extent::new(300, 200).unwrap(), Limits::default());
        let place = |k: u32| Point::new(f64::from(k % 17) * 7.0, f64::from(k % 5) * 9.0 + 1.0);
        let points = |count: u32| {
            (0..count)
                .map(|k| Handle::Point(place(k)))
                .collect::<Vec<_>>()
        };
        // With groups of points at one place, on a line, at one place, none.
        for p in [
            points(200),
            points(3),
            points(1),
            vec![Handle::Point(place(1)); 4],
            vec![],
        ] {
            for method in METHODS.map(|info| info.method) {
                let info = method.info();
                // A mesh follows an image, and is not described without it.
                if info.handles == AcceptedHandles::Lines || info.mesh.is_some() {
                    continue;
                }
                let rest = RestSpec {
                    p: p.clone(),
                    method,
                    ..RestSpec::default()
                };
                let setup = ResolvedRest::new(&rest, extent, &limits, &|| false).unwrap();
                let summary = RestSummary::new(&rest, extent, &limits, &|| false).unwrap();
                assert_eq!(
                    summary,
                    RestSummary::of(&setup),
                    "{method:?}, {} points",
                    p.len()
                );
            }
        }
    }
}
