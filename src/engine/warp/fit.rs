//! Which method fits a set of points: each candidate predicts every point from all others
//! (`deform`'s leave one out; mathematics 10.4).

use super::rest_parameters::{check_parameters, field, to_px};
use super::spec::at_most;
use super::{Limits, Method, Quantity, RestSpec, Task, WarpError, work};
use crate::deform::{
    DeformError, Handle, Handles, IsCancelled, METHODS, MethodInfo, Parameters, RestDeformation,
};
use crate::geometry::Vec2;
use crate::pixmap::Extent;

/// The fewest distinct points: without one of them there are still three, which determine an affine
/// map.
const MIN_DISTINCT_POINTS: usize = 4;
/// Median absolute deviation of a normal distribution to its standard deviation.
const NORMAL_DEVIATIONS: f64 = 1.4826;
/// A residual is an outlier beyond the median by this many standard deviations, and by at least
/// this length, px.
const OUTLIER_DEVIATIONS: f64 = 3.5;
const LEAST_FAR: f64 = 1e-3;
/// A method with its parameters.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Candidate {
    /// The method.
    pub method: Method,
    /// The fall-off of moving least squares; default 1.
    pub alpha: Option<f64>,
    /// The smoothing of a spline; default 0.
    pub smoothing: Option<f64>,
}

impl Candidate {
    /// The candidates of all methods.
    #[must_use]
    pub fn defaults() -> Vec<Self> {
        let mut methods = METHODS.to_vec();
        methods.sort_by_key(|info| info.candidate_order);
        let candidates = |info: &'static MethodInfo| {
            let with = |parameters: &&[(&str, f64)]| {
                let value = |name: &str| {
                    let given = parameters.iter().find(|(path, _)| *path == name);
                    given.map(|(_, value)| *value)
                };
                Self {
                    method: info.method,
                    alpha: value("alpha"),
                    smoothing: value("smoothing"),
                }
            };
            info.candidates.iter().map(with)
        };
        methods.into_iter().flat_map(candidates).collect()
    }

    /// Without parameters.
    const fn of(method: Method) -> Self {
        Self {
            method,
            alpha: None,
            smoothing: None,
        }
    }

    /// With the effective values of its parameters.
    fn resolved(self, handles: &Handles) -> Result<Self, DeformError> {
        let given = self.applied_to(RestSpec::default()).parameters();
        let effective = self.method.info().resolve(handles, &given)?;
        Ok(Self {
            method: self.method,
            alpha: effective.get("alpha"),
            smoothing: effective.get("smoothing"),
        })
    }

    /// `rest` with this method.
    ///
    /// ```
    /// use mlswarp::warp::{Candidate, Method, RestSpec};
    /// let (method, smoothing) = (Method::ThinPlateSpline, Some(0.1));
    /// let smooth = Candidate { method, alpha: None, smoothing };
    /// assert_eq!(smooth.applied_to(RestSpec::default()).smoothing, Some(0.1));
    /// ```
    #[must_use]
    pub fn applied_to(&self, rest: RestSpec) -> RestSpec {
        RestSpec {
            method: self.method,
            alpha: self.alpha,
            smoothing: self.smoothing,
            own: Parameters::default(),
            ..rest
        }
    }
}

/// A set of points with their targets.
#[derive(Debug)]
pub struct Fit {
    rest: RestSpec,
    handles: Handles,
    q: Vec<Handle>,
    /// The distinct point of each given one, unless that is missing.
    columns: Vec<Option<usize>>,
}

/// How well a candidate predicts the points.
#[derive(Clone, Debug, PartialEq)]
pub struct Prediction {
    /// With its effective parameters.
    pub candidate: Candidate,
    /// Root mean square length of the residuals of distinct points, px.
    pub rms: f64,
    /// Largest length, px.
    pub max: f64,
    /// Of every point: its target less the prediction, px, unless it is missing. Coincident points
    /// share one.
    pub residuals: Vec<Option<Vec2>>,
    /// Points whose residuals are unusually long, ascending.
    pub outliers: Vec<usize>,
}

impl Fit {
    /// The points and weights of `rest`, on a picture of this extent; its method is not used.
    /// `most`: the largest number of points.
    ///
    /// # Errors
    /// Lines, too many points, too few distinct ones, invalid handles, cancelled.
    pub fn new(
        rest: &RestSpec,
        q: &[Handle],
        extent: Extent,
        most: u64,
        cancelled: IsCancelled<'_>,
    ) -> Result<Self, WarpError> {
        if let Some(handle) = rest
            .p
            .iter()
            .position(|handle| matches!(handle, Handle::Polyline(_)))
        {
            return Err(WarpError::LineInFit { handle });
        }
        at_most(Quantity::FitHandles, most, rest.p.len() as u64)?;
        let unit = rest.unit(extent);
        let handles =
            Handles::new(to_px(&rest.p, unit), rest.weights.clone()).map_err(WarpError::Rest)?;
        let rest = Candidate::of(Method::default()).applied_to(RestSpec {
            p: Vec::new(),
            ..rest.clone()
        });
        let mut fit = Self {
            rest,
            handles,
            q: to_px(q, unit),
            columns: Vec::new(),
        };
        let field = fit.field(&fit.rest, cancelled)?;
        field.pose(&fit.q).map_err(WarpError::Posed)?;
        let distinct = field.handles().columns();
        if distinct < MIN_DISTINCT_POINTS {
            return Err(WarpError::TooFewPoints {
                least: MIN_DISTINCT_POINTS,
                actual: distinct,
            });
        }
        let mut columns = field.grouped_columns().into_iter();
        let column = |handle: &Handle| {
            if handle.columns() > 0 {
                columns.next()
            } else {
                None
            }
        };
        fit.columns = fit.handles.handles().iter().map(column).collect();
        Ok(fit)
    }

    fn field(
        &self,
        rest: &RestSpec,
        cancelled: IsCancelled<'_>,
    ) -> Result<RestDeformation, WarpError> {
        field(self.handles.clone(), rest, true, cancelled).map_err(WarpError::of_rest)
    }

    /// Leaves out each point in turn. CPU work, in parallel on the current rayon pool: O(points^2),
    /// for a spline O(points^3).
    ///
    /// # Errors
    /// A method that is not compared, a parameter of another method or out of range, cancelled.
    pub fn predict(
        &self,
        candidate: Candidate,
        cancelled: IsCancelled<'_>,
    ) -> Result<Prediction, WarpError> {
        let info = candidate.method.info();
        if info.candidates.is_empty() {
            return Err(WarpError::NotCompared { method: info.name });
        }
        let rest = candidate.applied_to(self.rest.clone());
        check_parameters(&rest)?;
        let candidate = candidate.resolved(&self.handles).map_err(WarpError::Rest)?;
        let field = self.field(&candidate.applied_to(rest), cancelled)?;
        let pose = field.pose(&self.q).map_err(WarpError::Posed)?;
        let distinct = field
            .leave_one_out(&pose, cancelled)
            .ok_or(WarpError::Cancelled)?;
        let lengths: Vec<f64> = distinct.iter().map(|residual| residual.norm()).collect();
        #[expect(
            clippy::cast_precision_loss,
            reason = "a count of points is far below 2^53"
        )]
        let mean = lengths.iter().map(|length| length * length).sum::<f64>() / lengths.len() as f64;
        let limit = outlier_length(&lengths);
        Ok(Prediction {
            candidate,
            rms: mean.sqrt(),
            max: lengths.iter().copied().fold(0.0, f64::max),
            residuals: self
                .columns
                .iter()
                .map(|column| Some(distinct[(*column)?]))
                .collect(),
            outliers: (0..self.columns.len())
                .filter(|&k| self.columns[k].is_some_and(|k| lengths[k] > limit))
                .collect(),
        })
    }
}

/// Residuals longer than this are outliers.
fn outlier_length(lengths: &[f64]) -> f64 {
    let middle = median(lengths.to_vec());
    let deviation = median(
        lengths
            .iter()
            .map(|length| (length - middle).abs())
            .collect(),
    );
    middle + (OUTLIER_DEVIATIONS * NORMAL_DEVIATIONS * deviation).max(LEAST_FAR)
}

fn median(mut values: Vec<f64>) -> f64 {
    values.sort_unstable_by(f64::total_cmp);
    let half = values.len() / 2;
    if values.len().is_multiple_of(2) {
        0.5 * (values[half - 1] + values[half])
    } else {
        values[half]
    }
}

/// Checks the work of comparing candidates on this number of points.
///
/// # Errors
/// More than the limit.
pub fn check_comparison(
    points: usize,
    candidates: &[Candidate],
    limits: &Limits,
) -> Result<(), WarpError> {
    work::at_most(
        Task::Comparison,
        limits.work,
        work::of_comparison(points as u64, candidates),
    )
}

/// The default candidate that predicts the points best; rigid moving least squares if they are too
/// few to compare methods.
///
/// # Errors
/// Those of [`Fit::new`] and [`Fit::predict`].
pub fn choose(
    rest: &RestSpec,
    q: &[Handle],
    extent: Extent,
    most: u64,
    cancelled: IsCancelled<'_>,
) -> Result<Candidate, WarpError> {
    let fallback = || {
        let handles = Handles::new(Vec::new(), None).map_err(WarpError::Rest)?;
        let rigid = Candidate::of(Method::default());
        rigid.resolved(&handles).map_err(WarpError::Rest)
    };
    let fit = match Fit::new(rest, q, extent, most, cancelled) {
        Err(WarpError::TooFewPoints { .. }) => return fallback(),
        fit => fit?,
    };
    let predictions: Result<Vec<_>, _> = Candidate::defaults()
        .into_iter()
        .map(|candidate| fit.predict(candidate, cancelled))
        .collect();
    best(&predictions?).map_or_else(fallback, |best| Ok(best.candidate))
}

/// The prediction with the least RMS; of equal ones the first.
#[must_use]
pub fn best(predictions: &[Prediction]) -> Option<&Prediction> {
    predictions.iter().min_by(|a, b| a.rms.total_cmp(&b.rms))
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::geometry::Point;

    #[test]
    fn outliers_exceed_the_median_by_the_deviation_and_by_a_length() {
        assert!(
            (outlier_length(&[1.0, 2.0, 3.0, 4.0, 100.0])
                - (3.0 + OUTLIER_DEVIATIONS * NORMAL_DEVIATIONS))
                .abs()
                < 1e-12
        );
        assert!(
            (outlier_length(&[2.0; 6]) - 2.001).abs() < 1e-12,
            "equal lengths: rounding is no outlier"
        );
    }

    fn points(places: &[(f64, f64)]) -> Vec<Handle> {
        places
            .iter()
            .map(|&(x, y)| Handle::Point(Point::new(x, y)))
            .collect()
    }

    #[test]
    fn a_wrong_landmark_is_found_and_the_right_method_chosen() {
        // An affine map of scattered points, one of which is wrong by 40 px.
        let p: Vec<(f64, f64)> = (0..15)
            .map(|k| (f64::from(k * 37 % 200), f64::from(k * 59 % 190)))
            .collect();
        let mut q: Vec<(f64, f64)> = p
            .iter()
            .map(|(x, y)| (1.1 * x + 0.2 * y + 3.0, 0.9 * y - 0.1 * x + 20.0))
            .collect();
        let extent = Extent::new(200, 200).unwrap();
        let rest = RestSpec {
            p: points(&p),
            ..RestSpec::default()
        };
        let all = |q: &[(f64, f64)]| {
            let fit = Fit::new(&rest, &points(q), extent, 2000, &|| false).unwrap();
            Candidate::defaults()
                .into_iter()
                .map(|candidate| fit.predict(candidate, &|| false).unwrap())
                .collect::<Vec<_>>()
        };
        let exact = all(&q);
        assert!(best(&exact).unwrap().rms < 1e-9);
        assert_eq!(
            exact
                .iter()
                .filter(|prediction| prediction.rms < 1e-9)
                .count(),
            4 + 4 + 1,
            "affine, splines, one map"
        );
        q[4].0 += 40.0;
        let wrong = all(&q);
        let one_map = wrong
            .iter()
            .find(|prediction| prediction.candidate.method == Method::GlobalAffine)
            .unwrap();
        assert_eq!(one_map.outliers, [4]);
        assert_eq!(
            best(&wrong).unwrap().candidate.method,
            Method::GlobalAffine,
            "it is affected least by one wrong point"
        );
    }

    #[test]
    fn coincident_points_are_one_and_few_points_are_refused() {
        let extent = Extent::new(100, 100).unwrap();
        let fit = |p: &[(f64, f64)], q: &[(f64, f64)]| {
            let rest = RestSpec {
                p: points(p),
                ..RestSpec::default()
            };
            let fit = Fit::new(&rest, &points(q), extent, 6, &|| false)?;
            fit.predict(
                Candidate {
                    method: Method::Rigid,
                    alpha: None,
                    smoothing: None,
                },
                &|| false,
            )
        };
        let p = [
            (1.0, 2.0),
            (80.0, 3.0),
            (50.0, 70.0),
            (1.0, 2.0),
            (20.0, 60.0),
        ];
        let q = [
            (1.0, 2.0),
            (85.0, 3.0),
            (50.0, 74.0),
            (3.0, 2.0),
            (20.0, 60.0),
        ];
        let prediction = fit(&p, &q).unwrap();
        assert_eq!(prediction.residuals.len(), 5);
        assert_eq!(prediction.residuals[0], prediction.residuals[3]);
        assert_eq!(
            prediction.candidate,
            Candidate {
                method: Method::Rigid,
                alpha: Some(1.0),
                smoothing: None
            }
        );
        assert_eq!(
            fit(&p[..4], &q[..4]).unwrap_err(),
            WarpError::TooFewPoints {
                least: 4,
                actual: 3
            }
        );
        let seven = [
            (1.0, 2.0),
            (80.0, 3.0),
            (50.0, 70.0),
            (1.0, 2.0),
            (20.0, 60.0),
            (9.0, 9.0),
            (8.0, 1.0),
        ];
        assert_eq!(
            fit(&seven, &seven).unwrap_err(),
            WarpError::TooLarge {
                what: Quantity::FitHandles,
                limit: 6,
                actual: 7
            }
        );
    }
}
