//! The search for the coincidences of a set, with bounded work for every set.
//!
//! Points are compared with a few others of the surrounding grid cells: O(points). Segments are
//! compared with those that overlap them along one of several directions, whichever leaves the
//! fewest pairs: O(n log n + pairs). A set with more pairs than [`MOST_WORK`] allows is refused; at
//! the default limit of columns that takes a million pairs of segments of which neither lies beside
//! the other.

use std::collections::HashMap;

use super::{CONFLICT_SHARE, Coincidences};
use crate::deform::DeformError;
use crate::deform::columns::{Element, ONE_PLACE_PX, RestSegment};
use crate::deform::groups::coincidence_distance;
use crate::geometry::{Point, Vec2};

/// Distance below which points are examined for a warning, px.
pub(super) const NEAR_POINT_PX: f64 = 1.0;
/// The largest number of coincidences in a set.
const MAX_COINCIDENCES: usize = 200_000;
/// The number of points of a cell that other points are compared with, in the client's order. A
/// warning needs some close pairs, not all. For points within [`COINCIDENT_SHARE`] the first one
/// represents all others of its cell.
pub(super) const POINTS_PER_BUCKET: usize = 8;
/// The side of a cell whose points all coincide, as a share of the distance of coincidence: its
/// diagonal is shorter.
const SAME_CELL: f64 = 0.7;
/// Limit of the work to search coincidences of segments: a pair that overlaps along the direction
/// of the sweep costs 1, and [`COMPARISON_WORK`] more if neither lies on one side of the other's
/// line and the two must be compared.
pub(super) const MOST_WORK: u64 = 16 << 20;
/// See [`MOST_WORK`].
pub(super) const COMPARISON_WORK: u64 = 16;
/// Number of sweep directions, evenly spaced over half a turn.
const SWEEP_DIRECTIONS: u32 = 8;
/// From one to the next: an eighth of half a turn.
const SWEEP_TURN: Vec2 = Vec2::new(0.923_879_532_511_286_7, 0.382_683_432_365_089_8);
/// A sweep along x that leaves at most this number of pairs per element is used without trying
/// others.
const FEW_PAIRS: u64 = 8;

impl Coincidences {
    /// Compares a segment with another element; `i < j`.
    pub(super) fn meet(&mut self, elements: &[Element], i: usize, j: usize, coincident: f64) {
        match (&elements[i], &elements[j]) {
            // Found by the grid cells.
            (Element::Point { .. }, Element::Point { .. }) => {}
            (Element::Point { p, .. }, Element::Segment(s)) => {
                if let Some(t) = on(s, *p, coincident) {
                    self.touching.push(((i, 0.0), (j, t)));
                }
            }
            (Element::Segment(s), Element::Point { p, .. }) => {
                if let Some(t) = on(s, *p, coincident) {
                    self.touching.push(((i, t), (j, 0.0)));
                }
            }
            (Element::Segment(s), Element::Segment(other)) => {
                for (end, t) in [(s.a, 0.0), (s.b, 1.0)] {
                    if let Some(u) = on(other, end, coincident) {
                        self.touching.push(((i, t), (j, u)));
                    }
                }
                for (end, u) in [(other.a, 0.0), (other.b, 1.0)] {
                    if let Some(t) = on(s, end, coincident) {
                        self.touching.push(((i, t), (j, u)));
                    }
                }
                if let Some((t, u)) = crossing(s, other) {
                    self.touching.push(((i, t), (j, u)));
                }
            }
        }
    }
}

/// The search for the coincidences of one set.
pub(super) struct CoincidenceSearch<'a> {
    elements: &'a [Element],
    /// Positions at this distance or nearer coincide, px.
    pub(super) coincident: f64,
    cancelled: &'a dyn Fn() -> bool,
    pub(super) found: Coincidences,
    /// Pairs of points that were compared.
    pub(super) compared: u64,
    /// Work of the search for coincidences of segments, see [`MOST_WORK`].
    pub(super) work: u64,
}

impl<'a> CoincidenceSearch<'a> {
    pub(super) fn new(
        elements: &'a [Element],
        extent: f64,
        cancelled: &'a dyn Fn() -> bool,
    ) -> Self {
        let coincident = coincidence_distance(extent);
        let found = Coincidences {
            tolerance: CONFLICT_SHARE * extent.max(1.0),
            ..Coincidences::default()
        };
        Self {
            elements,
            coincident,
            cancelled,
            found,
            compared: 0,
            work: 0,
        }
    }

    pub(super) fn run(&mut self) -> Result<(), DeformError> {
        self.points()?;
        self.segments()?;
        // Stable: the coincidences of one pair stay in the order in which `meet` finds them.
        self.found.touching.sort_by_key(|(x, y)| (x.0, y.0));
        Ok(())
    }

    fn check_cancelled(&self) -> Result<(), DeformError> {
        if (self.cancelled)() {
            Err(DeformError::Cancelled)
        } else {
            Ok(())
        }
    }

    /// Finds coincident points, each paired with the first in the client's order, and points that
    /// are near each other.
    fn points(&mut self) -> Result<(), DeformError> {
        let points = || {
            self.elements
                .iter()
                .enumerate()
                .filter_map(|(index, element)| point(element).map(|p| (index, p)))
        };
        let origin = points().fold(Point::new(f64::INFINITY, f64::INFINITY), |o, (_, p)| {
            Point::new(o.x.min(p.x), o.y.min(p.y))
        });
        let (mut close, mut same) = (
            PointBuckets::new(origin, NEAR_POINT_PX),
            PointBuckets::new(origin, SAME_CELL * self.coincident),
        );
        let (mut touching, mut near, mut compared) = (Vec::new(), Vec::new(), 0);
        for (j, p) in points() {
            self.check_cancelled()?;
            // Coincident points are near each other too, so the finer cells are looked up only
            // where the coarse ones hold something.
            let before = compared;
            close.around(p, 1, |i, other| {
                compared += 1;
                let apart = p.distance(other);
                if apart > self.coincident && apart < NEAR_POINT_PX && near.len() < MAX_COINCIDENCES
                {
                    near.push((i, j, apart));
                }
            });
            if compared > before {
                let mut first = None;
                same.around(p, 2, |i, other| {
                    compared += 1;
                    if p.distance(other) <= self.coincident && first.is_none_or(|first| i < first) {
                        first = Some(i);
                    }
                });
                touching.extend(first.map(|i| ((i, 0.0), (j, 0.0))));
            }
            close.insert(j, p);
            same.insert(j, p);
        }
        (self.found.touching, self.found.near, self.compared) = (touching, near, compared);
        Ok(())
    }

    /// Finds coincidences of segments with segments and points.
    fn segments(&mut self) -> Result<(), DeformError> {
        if self.elements.iter().all(|element| point(element).is_some()) {
            return Ok(());
        }
        // At least the rounding error of a projection.
        let reach = self.coincident.max(ONE_PLACE_PX);
        let few = FEW_PAIRS * self.elements.len() as u64;
        let mut best: Option<Sweep> = None;
        let mut direction = Vec2::new(1.0, 0.0);
        for _ in 0..SWEEP_DIRECTIONS {
            self.check_cancelled()?;
            if best.as_ref().is_some_and(|best| best.pairs <= few) {
                break;
            }
            let sweep = Sweep::new(self.elements, direction, reach);
            direction = direction.complex_mul(SWEEP_TURN);
            if best.as_ref().is_none_or(|best| sweep.pairs < best.pairs) {
                best = Some(sweep);
            }
        }
        let Some(Sweep {
            segments, points, ..
        }) = best
        else {
            return Ok(());
        };
        let boxes: Vec<[f64; 4]> = self.elements.iter().map(bounds).collect();
        for (
            k,
            &Interval {
                low,
                high,
                index: i,
            },
        ) in segments.iter().enumerate()
        {
            self.check_cancelled()?;
            let later = segments[k + 1..]
                .iter()
                .take_while(|other| other.low <= high + reach)
                .map(|other| other.index);
            let from = points.partition_point(|p| p.low < low - reach);
            let on_it = points[from..]
                .iter()
                .take_while(|p| p.low <= high + reach)
                .map(|p| p.index);
            for j in later.chain(on_it) {
                self.work += 1;
                let (a, b) = (&boxes[i], &boxes[j]);
                let apart = |low: usize| b[low] > a[low + 2] + reach || a[low] > b[low + 2] + reach;
                let beside =
                    |i: usize, j: usize| is_beside(&self.elements[i], &self.elements[j], reach);
                if !apart(0) && !apart(1) && !beside(i, j) && !beside(j, i) {
                    self.work += COMPARISON_WORK;
                    self.found
                        .meet(self.elements, i.min(j), i.max(j), self.coincident);
                }
                if self.work > MOST_WORK {
                    return Err(DeformError::TooManyNeighbours {
                        limit: MOST_WORK / COMPARISON_WORK,
                    });
                }
                if self.found.touching.len() > MAX_COINCIDENCES {
                    return Err(DeformError::TooManyMeetings {
                        limit: MAX_COINCIDENCES,
                    });
                }
            }
        }
        Ok(())
    }
}

/// Grid cells, each with the first [`POINTS_PER_BUCKET`] of the points inserted.
struct PointBuckets {
    origin: Point,
    side: f64,
    cells: HashMap<(i64, i64), Vec<(usize, Point)>>,
}

impl PointBuckets {
    fn new(origin: Point, side: f64) -> Self {
        Self {
            origin,
            side,
            cells: HashMap::new(),
        }
    }

    /// Points lie within a few extents of the origin, and a side is at least a billionth of the
    /// extent.
    #[expect(clippy::cast_possible_truncation, reason = "some 2^32 cells at most")]
    fn cell(&self, p: Point) -> (i64, i64) {
        let from = p - self.origin;
        (
            (from.x / self.side).floor() as i64,
            (from.y / self.side).floor() as i64,
        )
    }

    fn insert(&mut self, index: usize, p: Point) {
        let crowd = self.cells.entry(self.cell(p)).or_default();
        if crowd.len() < POINTS_PER_BUCKET {
            crowd.push((index, p));
        }
    }

    /// The points of the cell of `p` and of `rings` rings of cells around it.
    fn around(&self, p: Point, rings: i64, mut look: impl FnMut(usize, Point)) {
        let (x, y) = self.cell(p);
        for x in x - rings..=x + rings {
            for y in y - rings..=y + rings {
                for &(index, p) in self.cells.get(&(x, y)).into_iter().flatten() {
                    look(index, p);
                }
            }
        }
    }
}

/// The interval that an element covers along a direction.
#[derive(Clone, Copy)]
struct Interval {
    low: f64,
    high: f64,
    index: usize,
}

/// The elements in their order along a direction, and the number of overlapping pairs, pairs of
/// points excluded.
struct Sweep {
    segments: Vec<Interval>,
    points: Vec<Interval>,
    pairs: u64,
}

impl Sweep {
    fn new(elements: &[Element], direction: Vec2, reach: f64) -> Self {
        let along = |p: Point| p.x * direction.x + p.y * direction.y;
        let (mut segments, mut points) = (Vec::new(), Vec::new());
        for (index, element) in elements.iter().enumerate() {
            match element {
                Element::Point { p, .. } => points.push(Interval {
                    low: along(*p),
                    high: along(*p),
                    index,
                }),
                Element::Segment(s) => {
                    let (a, b) = (along(s.a), along(s.b));
                    segments.push(Interval {
                        low: a.min(b),
                        high: a.max(b),
                        index,
                    });
                }
            }
        }
        for list in [&mut segments, &mut points] {
            list.sort_unstable_by(|a, b| a.low.total_cmp(&b.low).then(a.index.cmp(&b.index)));
        }
        // Pairs are counted by two searches for each segment, without looking at them: the count
        // decides which direction is taken.
        let until =
            |list: &[Interval], end: f64| list.partition_point(|other| other.low <= end) as u64;
        let overlaps = |(k, s): (usize, &Interval)| {
            let points = until(&points, s.high + reach)
                - points.partition_point(|p| p.low < s.low - reach) as u64;
            until(&segments[k + 1..], s.high + reach) + points
        };
        let pairs = segments.iter().enumerate().map(overlaps).sum();
        Self {
            segments,
            points,
            pairs,
        }
    }
}

/// Whether the other element lies on one side of a segment's line, farther than `reach` from it.
fn is_beside(element: &Element, other: &Element, reach: f64) -> bool {
    let Element::Segment(s) = element else {
        return false;
    };
    let side = |p: Point| s.tau.cross(p - s.a);
    let (a, b) = match other {
        Element::Point { p, .. } => (side(*p), side(*p)),
        Element::Segment(other) => (side(other.a), side(other.b)),
    };
    a.min(b) > reach || a.max(b) < -reach
}

/// The position of a point element.
pub(super) fn point(element: &Element) -> Option<Point> {
    match element {
        Element::Point { p, .. } => Some(*p),
        Element::Segment(_) => None,
    }
}

/// `[min x, min y, max x, max y]`.
fn bounds(element: &Element) -> [f64; 4] {
    match element {
        Element::Point { p, .. } => [p.x, p.y, p.x, p.y],
        Element::Segment(s) => [
            s.a.x.min(s.b.x),
            s.a.y.min(s.b.y),
            s.a.x.max(s.b.x),
            s.a.y.max(s.b.y),
        ],
    }
}

/// The parameter at which `p` lies on the segment.
fn on(s: &RestSegment, p: Point, within: f64) -> Option<f64> {
    let (t, d2) = s.nearest(p);
    (d2 <= within * within).then_some(t)
}

/// The parameters at which two segments cross in their interiors; parallel segments coincide at
/// their ends or not at all.
fn crossing(s: &RestSegment, other: &RestSegment) -> Option<(f64, f64)> {
    let sin = s.tau.cross(other.tau);
    if sin.abs() < 1e-12 {
        return None;
    }
    let between = other.a - s.a;
    let (t, u) = (
        between.cross(other.tau) / (sin * s.length),
        between.cross(s.tau) / (sin * other.length),
    );
    ((0.0..=1.0).contains(&t) && (0.0..=1.0).contains(&u)).then_some((t, u))
}
