//! Handles at rest and posed: points, segments, polylines, mixed. Shapes: a handle is one position
//! (a point) or two and more (a polyline of segments).

use super::{ConflictingHandles, DeformError};
use crate::geometry::{Point, Vec2};

/// Largest coordinate either way, px.
pub const MAX_COORDINATE: f64 = 1e6;
/// Weights outside of this range would overflow or underflow the ratios in f64.
const WEIGHT_RANGE: std::ops::RangeInclusive<f64> = 1e-9..=1e9;
/// The shortest segment, px.
const SHORTEST_SEGMENT: f64 = 1e-6;
/// The shortest segment as a share of the set's extent.
pub(super) const COINCIDENT_SHARE: f64 = 1e-9;

/// One handle, at rest or posed, px.
#[derive(Clone, Debug, PartialEq)]
pub enum Handle {
    /// A point.
    Point(Point),
    /// A segment (two positions) or polyline (more): its consecutive segments.
    Polyline(Vec<Point>),
    /// A handle without a position, such as a landmark that is hidden. It is left out and
    /// keeps its index.
    Missing,
}

impl Handle {
    /// The positions of the handle.
    ///
    /// ```
    /// use mlswarp::deform::Handle;
    /// use mlswarp::geometry::Point;
    /// let line = Handle::Polyline(vec![Point::new(0.0, 0.0), Point::new(9.0, 0.0)]);
    /// assert_eq!(line.places().len(), 2);
    /// assert!(Handle::Missing.places().is_empty());
    /// ```
    #[must_use]
    pub fn places(&self) -> &[Point] {
        match self {
            Self::Point(p) => std::slice::from_ref(p),
            Self::Polyline(places) => places,
            Self::Missing => &[],
        }
    }

    /// Columns of the plan that the handle needs: one per point, two per segment.
    #[must_use]
    pub fn columns(&self) -> usize {
        match self {
            Self::Point(_) => 1,
            Self::Polyline(places) => 2 * places.len().saturating_sub(1),
            Self::Missing => 0,
        }
    }

    fn kind(&self) -> String {
        match self {
            Self::Point(_) => "a point".to_owned(),
            Self::Polyline(places) => format!("a line of {} positions", places.len()),
            Self::Missing => "missing".to_owned(),
        }
    }
}

/// Validated handles at rest with their weights.
#[derive(Clone, Debug, PartialEq)]
pub struct Handles {
    handles: Vec<Handle>,
    weights: Vec<f64>,
    extent: f64,
}

impl Handles {
    /// Checks that every coordinate is finite and within 1e6 px, every polyline has two places or
    /// more and no segment without length, and every weight (default 1) lies in 1e-9..=1e9. An
    /// empty set is valid: it deforms nothing.
    ///
    /// # Errors
    /// The first handle that fails, by index.
    ///
    /// ```
    /// use mlswarp::deform::{Handle, Handles};
    /// use mlswarp::geometry::Point;
    /// let nose = Handle::Point(Point::new(262.0, 240.0));
    /// let handles = Handles::new(vec![nose], None)?;
    /// assert_eq!(handles.weights(), [1.0]);
    /// assert!(Handles::new(vec![Handle::Point(Point::new(f64::NAN, 0.0))], None).is_err());
    /// # Ok::<(), mlswarp::deform::DeformError>(())
    /// ```
    pub fn new(handles: Vec<Handle>, weights: Option<Vec<f64>>) -> Result<Self, DeformError> {
        check_places(&handles)?;
        let weights = weights.unwrap_or_else(|| vec![1.0; handles.len()]);
        if weights.len() != handles.len() {
            return Err(DeformError::WeightCount {
                rest: handles.len(),
                weights: weights.len(),
            });
        }
        if let Some((handle, &value)) = weights
            .iter()
            .enumerate()
            .find(|(_, w)| !WEIGHT_RANGE.contains(w))
        {
            return Err(DeformError::BadWeight { handle, value });
        }
        let extent = extent(&handles);
        let shortest = SHORTEST_SEGMENT.max(COINCIDENT_SHARE * extent);
        for (handle, h) in handles.iter().enumerate() {
            if let Some(segment) = h
                .places()
                .windows(2)
                .position(|ab| ab[0].distance(ab[1]) <= shortest)
            {
                return Err(DeformError::DegenerateLine { handle, segment });
            }
        }
        Ok(Self {
            handles,
            weights,
            extent,
        })
    }

    /// Handles that are known to be valid, whatever the sum of their weights.
    pub(super) fn of_valid(handles: Vec<Handle>, weights: Vec<f64>) -> Self {
        let extent = extent(&handles);
        Self {
            handles,
            weights,
            extent,
        }
    }

    /// The handles in the client's order.
    #[must_use]
    pub fn handles(&self) -> &[Handle] {
        &self.handles
    }

    /// One weight per handle.
    #[must_use]
    pub fn weights(&self) -> &[f64] {
        &self.weights
    }

    /// Largest distance of a position from the mean of all, px.
    #[must_use]
    pub const fn extent(&self) -> f64 {
        self.extent
    }

    /// Columns of the plan: one per point, two per segment.
    #[must_use]
    pub fn columns(&self) -> usize {
        self.handles.iter().map(Handle::columns).sum()
    }

    /// Whether some handle is a segment or polyline.
    #[must_use]
    pub fn has_lines(&self) -> bool {
        self.handles
            .iter()
            .any(|h| matches!(h, Handle::Polyline(_)))
    }

    /// Whether some handle is a point.
    #[must_use]
    pub fn has_points(&self) -> bool {
        self.handles.iter().any(|h| matches!(h, Handle::Point(_)))
    }

    /// Mean length of the segments, px; `None` without lines. The default mass of a point in a
    /// mixed set.
    #[must_use]
    pub fn mean_segment_length(&self) -> Option<f64> {
        let lengths: Vec<f64> = self
            .handles
            .iter()
            .flat_map(|h| h.places().windows(2))
            .map(|ab| ab[0].distance(ab[1]))
            .collect();
        #[expect(
            clippy::cast_precision_loss,
            reason = "a count of segments is far below 2^53"
        )]
        let count = lengths.len() as f64;
        (!lengths.is_empty()).then(|| lengths.iter().sum::<f64>() / count)
    }
}

/// The displacement of every column, `d = Q - P`, px: the only form in which q is used.
#[derive(Clone, Debug, PartialEq)]
pub struct Pose {
    displacements: Vec<Vec2>,
    conflicts: ConflictingHandles,
}

impl Pose {
    /// Pairs posed handles with the rest handles of the same order and shape. The field decides
    /// whether targets contradict each other. Where a rest handle is missing, the posed one is left
    /// out too.
    ///
    /// # Errors
    /// A coordinate that is not finite or out of range, a handle that is missing in this pose only,
    /// or a shape that differs, by handle.
    ///
    /// ```
    /// use mlswarp::deform::{Handle, Handles, Pose};
    /// use mlswarp::geometry::{Point, Vec2};
    /// let point = |x, y| Handle::Point(Point::new(x, y));
    /// let rest = Handles::new(vec![point(1.0, 2.0)], None)?;
    /// let pose = Pose::new(&rest, &[point(4.0, 2.0)])?;
    /// assert_eq!(pose.displacements(), [Vec2::new(3.0, 0.0)]);
    /// # Ok::<(), mlswarp::deform::DeformError>(())
    /// ```
    pub fn new(rest: &Handles, posed: &[Handle]) -> Result<Self, DeformError> {
        if posed.len() != rest.handles.len() {
            return Err(DeformError::CountMismatch {
                rest: rest.handles.len(),
                posed: posed.len(),
            });
        }
        check_places(posed)?;
        let mut displacements = Vec::with_capacity(rest.columns());
        for (handle, (p, q)) in rest.handles.iter().zip(posed).enumerate() {
            match (p, q) {
                (Handle::Point(p), Handle::Point(q)) => displacements.push(*q - *p),
                (Handle::Polyline(p), Handle::Polyline(q)) if p.len() == q.len() => {
                    for (p, q) in p.windows(2).zip(q.windows(2)) {
                        displacements.extend([q[0] - p[0], q[1] - p[1]]);
                    }
                }
                (Handle::Missing, _) => {}
                // Its columns are in the plan: leaving it out needs another set of rest handles.
                (_, Handle::Missing) => return Err(DeformError::MissingInPose { handle }),
                _ => {
                    return Err(DeformError::ShapeMismatch {
                        handle,
                        rest: p.kind(),
                        posed: q.kind(),
                    });
                }
            }
        }
        Ok(Self {
            displacements,
            conflicts: ConflictingHandles::default(),
        })
    }

    /// The pose that leaves every handle at rest.
    #[must_use]
    pub fn identity(rest: &Handles) -> Self {
        Self {
            displacements: vec![Vec2::ZERO; rest.columns()],
            conflicts: ConflictingHandles::default(),
        }
    }

    /// The pose with these displacements and conflicts.
    pub(super) const fn of_columns(
        displacements: Vec<Vec2>,
        conflicts: ConflictingHandles,
    ) -> Self {
        Self {
            displacements,
            conflicts,
        }
    }

    /// The groups of handles that coincide at rest and move differently.
    #[must_use]
    pub const fn conflicts(&self) -> &ConflictingHandles {
        &self.conflicts
    }

    /// One displacement per column, px.
    pub(super) fn into_displacements(self) -> Vec<Vec2> {
        self.displacements
    }

    /// One displacement per column, px.
    #[must_use]
    pub fn displacements(&self) -> &[Vec2] {
        &self.displacements
    }

    /// Whether nothing moves.
    #[must_use]
    pub fn is_identity(&self) -> bool {
        self.displacements.iter().all(|d| *d == Vec2::ZERO)
    }
}

fn check_places(handles: &[Handle]) -> Result<(), DeformError> {
    for (handle, h) in handles.iter().enumerate() {
        if let Handle::Polyline(places) = h
            && places.len() < 2
        {
            return Err(DeformError::TooFewPlaces {
                handle,
                places: places.len(),
            });
        }
        for p in h.places() {
            if !p.is_finite() {
                return Err(DeformError::NotFinite { handle });
            }
            if let Some(value) = [p.x, p.y].into_iter().find(|c| c.abs() > MAX_COORDINATE) {
                return Err(DeformError::OutOfRange {
                    handle,
                    value,
                    limit: MAX_COORDINATE,
                });
            }
        }
    }
    Ok(())
}

/// `max |P - mean(P)|` over all positions of all columns.
fn extent(handles: &[Handle]) -> f64 {
    let places = || handles.iter().flat_map(|h| h.places().iter().copied());
    let count = places().count();
    if count == 0 {
        return 0.0;
    }
    let sum = places().fold(Vec2::ZERO, |s, p| s + (p - Point::default()));
    #[expect(
        clippy::cast_precision_loss,
        reason = "a count of places is far below 2^53"
    )]
    let mean = Point::default() + sum * (1.0 / count as f64);
    places().map(|p| p.distance(mean)).fold(0.0, f64::max)
}
