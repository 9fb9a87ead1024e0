//! Handles at rest as elements with columns: one column per point, two per segment (mathematics
//! sections 3.1 and 4). Degeneracy is decided once from the geometry of the set, never per vertex
//! from a determinant.

use super::handles::{COINCIDENT_SHARE, Handle, Handles};
use crate::geometry::{Point, Vec2};

/// Points that all lie within this distance of their mean count as one position, px.
pub(super) const ONE_PLACE_PX: f64 = 1e-6;

/// An element: a point or a segment at rest.
#[derive(Clone, Copy, Debug)]
pub(super) enum Element {
    /// A point: `w = mass |p - v|^(-2 alpha)`.
    Point { p: Point, mass: f64, column: usize },
    /// A segment with a density of `weight` per px: two columns, `column` for `a` and the next for
    /// `b`.
    Segment(RestSegment),
}

impl Element {
    /// The first column.
    pub(super) const fn column(&self) -> usize {
        match self {
            Self::Point { column, .. } | Self::Segment(RestSegment { column, .. }) => *column,
        }
    }
}

/// A segment at rest.
#[derive(Clone, Copy, Debug)]
pub(super) struct RestSegment {
    pub(super) a: Point,
    pub(super) b: Point,
    /// |b - a|, px, positive.
    pub(super) length: f64,
    /// (b - a) / length.
    pub(super) tau: Vec2,
    pub(super) weight: f64,
    pub(super) column: usize,
}

/// A point at rest.
#[derive(Clone, Copy, Debug)]
pub(super) struct PointSource {
    pub(super) p: Point,
    pub(super) mass: f64,
    pub(super) column: usize,
}

/// The elements by kind, each with its columns, over which a row is summed.
#[derive(Clone, Debug, Default)]
pub(super) struct HandleElements {
    pub(super) points: Vec<PointSource>,
    pub(super) segments: Vec<RestSegment>,
}

impl HandleElements {
    pub(super) fn of(elements: &[Element]) -> Self {
        let mut sources = Self::default();
        for element in elements {
            match *element {
                Element::Point { p, mass, column } => {
                    sources.points.push(PointSource { p, mass, column })
                }
                Element::Segment(segment) => sources.segments.push(segment),
            }
        }
        sources
    }
}

/// The rank of a set of handles.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Rank {
    /// No handles: the identity.
    Empty,
    /// All at one position: a translation.
    OnePlace,
    /// All on one line: affine has a one-parameter family of minimisers.
    Collinear,
    /// No degeneracy.
    Full,
}

/// The elements of `handles` in their order, and the handle of each.
pub(super) fn elements(handles: &Handles, point_mass: f64) -> (Vec<Element>, Vec<usize>) {
    let mut elements = Vec::with_capacity(handles.columns());
    let mut owners = Vec::with_capacity(handles.columns());
    let mut column = 0;
    for (index, (handle, &weight)) in handles.handles().iter().zip(handles.weights()).enumerate() {
        match handle {
            Handle::Point(p) => {
                elements.push(Element::Point {
                    p: *p,
                    mass: weight * point_mass,
                    column,
                });
                owners.push(index);
                column += 1;
            }
            Handle::Polyline(places) => {
                for ab in places.windows(2) {
                    let (a, b) = (ab[0], ab[1]);
                    let length = a.distance(b);
                    let tau = (b - a) * (1.0 / length);
                    elements.push(Element::Segment(RestSegment {
                        a,
                        b,
                        length,
                        tau,
                        weight,
                        column,
                    }));
                    owners.push(index);
                    column += 2;
                }
            }
            Handle::Missing => {}
        }
    }
    (elements, owners)
}

/// Rank of the set: `max distance from the best-fit line <= 1e-9 extent` is collinear.
pub(super) fn rank(handles: &Handles) -> Rank {
    let places = || {
        handles
            .handles()
            .iter()
            .flat_map(|h| h.places().iter().copied())
    };
    let Some(first) = places().next() else {
        return Rank::Empty;
    };
    // A segment has a direction, however short.
    if handles.extent() <= ONE_PLACE_PX && !handles.has_lines() {
        return Rank::OnePlace;
    }
    #[expect(
        clippy::cast_precision_loss,
        reason = "a count of places is far below 2^53"
    )]
    let mean =
        first + places().fold(Vec2::ZERO, |s, p| s + (p - first)) * (1.0 / places().count() as f64);
    // Total least squares: the direction that maximises sum (d . u)^2 has half the angle of
    // (sxx - syy, 2 sxy).
    let (mut sxx, mut sxy, mut syy) = (0.0, 0.0, 0.0);
    for p in places() {
        let d = p - mean;
        sxx += d.x * d.x;
        sxy += d.x * d.y;
        syy += d.y * d.y;
    }
    let direction = Vec2::new(sxx - syy, 2.0 * sxy).half_angle();
    let off = places()
        .map(|p| direction.cross(p - mean).abs())
        .fold(0.0, f64::max);
    if off <= COINCIDENT_SHARE * handles.extent() {
        Rank::Collinear
    } else {
        Rank::Full
    }
}

impl RestSegment {
    /// Parameter in [0, 1] of the point of the segment nearest to `p`, and the squared distance to
    /// it.
    pub(super) fn nearest(&self, p: Point) -> (f64, f64) {
        let along = (p - self.a).dot(self.tau);
        if along <= 0.0 {
            (0.0, (p - self.a).norm2())
        } else if along >= self.length {
            (1.0, (p - self.b).norm2())
        } else {
            let h = self.tau.cross(p - self.a);
            (along / self.length, h * h)
        }
    }
}
