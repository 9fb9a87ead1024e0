//! Coincidences of handles at rest: coincident points, points on segments, segments that touch,
//! cross or overlap. Found once per field; each pose then only compares the two targets of every
//! coincidence (mathematics section 6: where they differ, f is discontinuous).
//!
//! The work is bounded for every set. Points are compared with a few others of the surrounding grid
//! cells: O(points). Segments are compared with those that overlap them along one of several
//! directions, whichever leaves the fewest pairs: O(n log n + pairs). A set with more pairs than
//! [`MOST_WORK`] allows is refused; at the default limit of columns that takes a million pairs of
//! segments of which neither lies beside the other.

use std::collections::{HashMap, HashSet};

use super::DeformError;
use super::columns::{Element, ONE_PLACE, RestSegment};
use super::conflicts::{Conflicts, Member};
use super::groups::coincidence_distance;
use crate::geometry::{Point, Vec2};

/// Targets further apart than this share of the extent contradict each other.
const CONFLICT_SHARE: f64 = 1e-6;
/// Distance below which points are examined for a warning, px.
const NEAR_POINT_PX: f64 = 1.0;
/// The ratio of the targets' distance to the rest distance from which a warning is given.
const NEAR_FACTOR: f64 = 10.0;
/// The largest number of coincidences in a set.
const MAX_COINCIDENCES: usize = 200_000;
/// The number of points of a cell that other points are compared with, in the client's order. A
/// warning needs some close pairs, not all. For points within [`COINCIDENT_SHARE`] the first one
/// represents all others of its cell.
const POINTS_PER_BUCKET: usize = 8;
/// The side of a cell whose points all coincide, as a share of the distance of coincidence: its
/// diagonal is shorter.
const SAME_CELL: f64 = 0.7;
/// Limit of the work to search coincidences of segments: a pair that overlaps along the direction
/// of the sweep costs 1, and [`COMPARISON_WORK`] more if neither lies on one side of the other's
/// line and the two must be compared.
const MOST_WORK: u64 = 16 << 20;
/// See [`MOST_WORK`].
const COMPARISON_WORK: u64 = 16;
/// Number of sweep directions, evenly spaced over half a turn.
const SWEEP_DIRECTIONS: u32 = 8;
/// From one to the next: an eighth of half a turn.
const SWEEP_TURN: Vec2 = Vec2::new(0.923_879_532_511_286_7, 0.382_683_432_365_089_8);
/// A sweep along x that leaves at most this number of pairs per element is used without trying
/// others.
const FEW_PAIRS: u64 = 8;

/// A position on an element: the element's index and the parameter along it (0 for a point).
type On = (usize, f64);

/// The coincidences of one set.
#[derive(Clone, Debug, Default)]
pub(super) struct Coincidences {
    /// Elements that share a position.
    touching: Vec<(On, On)>,
    /// Points nearer than 1 px that do not coincide, and their distance.
    near: Vec<(usize, usize, f64)>,
    tolerance: f64,
}

impl Coincidences {
    /// Calls `cancelled` after each element.
    ///
    /// # Errors
    /// Too many coincidences, too many pairs to compare, cancelled.
    pub(super) fn find(
        elements: &[Element],
        extent: f64,
        cancelled: &dyn Fn() -> bool,
    ) -> Result<Self, DeformError> {
        let mut search = CoincidenceSearch::new(elements, extent, cancelled);
        search.run()?;
        Ok(search.found)
    }

    /// Compares a segment with another element; `i < j`.
    fn meet(&mut self, elements: &[Element], i: usize, j: usize, coincident: f64) {
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

    /// Adds the positions at which the targets of two elements differ. `members`: the handles of an
    /// element, with the displacement that is given for a group.
    pub(super) fn add_conflicts<M: IntoIterator<Item = Member>>(
        &self,
        found: &mut Conflicts,
        elements: &[Element],
        displacements: &[Vec2],
        members: impl Fn(usize, Vec2) -> M,
    ) {
        let at = |(element, t): On| {
            (
                place(&elements[element], t),
                displacement(&elements[element], t, displacements),
            )
        };
        for &(x, y) in &self.touching {
            let ((p, dp), (r, dr)) = (at(x), at(y));
            let apart = ((p + dp) - (r + dr)).norm();
            if apart > self.tolerance {
                found.add_tear(p, apart);
            }
        }
        if found.is_empty() {
            return;
        }
        // Handles that agree with each other belong to the group too; each element once, because it
        // may be a group of many points.
        let mut added = HashSet::new();
        for on in self.touching.iter().flat_map(|(x, y)| [*x, *y]) {
            let (position, displacement) = at(on);
            if found
                .listed(position)
                .is_some_and(|group| added.insert((group, on.0)))
            {
                found.add_members(position, members(on.0, displacement));
            }
        }
    }

    /// Targets further apart than this contradict each other, px.
    pub(super) const fn tolerance(&self) -> f64 {
        self.tolerance
    }

    /// Whether some points nearer than 1 px move more than ten times as far apart.
    pub(super) fn tears(&self, elements: &[Element], displacements: &[Vec2]) -> bool {
        self.near.iter().any(|&(i, j, apart)| {
            (target(&elements[i], 0.0, displacements) - target(&elements[j], 0.0, displacements))
                .norm()
                > NEAR_FACTOR * apart
        })
    }
}

/// The search for the coincidences of one set.
struct CoincidenceSearch<'a> {
    elements: &'a [Element],
    coincident: f64,
    cancelled: &'a dyn Fn() -> bool,
    found: Coincidences,
    /// Pairs of points that were compared.
    compared: u64,
    /// Work of the search for coincidences of segments, see [`MOST_WORK`].
    work: u64,
}

impl<'a> CoincidenceSearch<'a> {
    fn new(elements: &'a [Element], extent: f64, cancelled: &'a dyn Fn() -> bool) -> Self {
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

    fn run(&mut self) -> Result<(), DeformError> {
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
        let reach = self.coincident.max(ONE_PLACE);
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
fn point(element: &Element) -> Option<Point> {
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

fn place(element: &Element, t: f64) -> Point {
    match element {
        Element::Point { p, .. } => *p,
        Element::Segment(s) => s.a.lerp(s.b, t),
    }
}

fn displacement(element: &Element, t: f64, d: &[Vec2]) -> Vec2 {
    match element {
        Element::Point { column, .. } => d[*column],
        Element::Segment(s) => d[s.column] * (1.0 - t) + d[s.column + 1] * t,
    }
}

fn target(element: &Element, t: f64, d: &[Vec2]) -> Point {
    place(element, t) + displacement(element, t, d)
}

#[cfg(test)]
mod tests {
    use std::cell::Cell;

    use super::*;
    use crate::deform::columns::elements;
    use crate::deform::{Handle, Handles};
    use proptest::prelude::*;

    const NEVER: &dyn Fn() -> bool = &|| false;

    fn elements_of(handles: Vec<Handle>) -> (Vec<Element>, f64) {
        let handles = Handles::new(handles, None).unwrap();
        (elements(&handles, 1.0).0, handles.extent())
    }

    fn line(a: (f64, f64), b: (f64, f64)) -> Handle {
        Handle::Polyline(vec![Point::new(a.0, a.1), Point::new(b.0, b.1)])
    }

    fn dot(x: f64, y: f64) -> Handle {
        Handle::Point(Point::new(x, y))
    }

    /// Every pair, compared.
    fn by_brute_force(elements: &[Element], extent: f64) -> Coincidences {
        let mut search = CoincidenceSearch::new(elements, extent, NEVER);
        for j in 0..elements.len() {
            let mut first = None;
            for i in 0..j {
                if let (Some(p), Some(other)) = (point(&elements[i]), point(&elements[j])) {
                    let apart = p.distance(other);
                    if apart <= search.coincident {
                        first = first.or(Some(i));
                    } else if apart < NEAR_POINT_PX {
                        search.found.near.push((i, j, apart));
                    }
                }
                search.found.meet(elements, i, j, search.coincident);
            }
            search
                .found
                .touching
                .extend(first.map(|i| ((i, 0.0), (j, 0.0))));
        }
        search.found.touching.sort_by_key(|(x, y)| (x.0, y.0));
        search.found
    }

    fn agrees(handles: Vec<Handle>) -> Result<(), TestCaseError> {
        let (elements, extent) = elements_of(handles);
        let (mut found, mut want) = (
            Coincidences::find(&elements, extent, NEVER).unwrap(),
            by_brute_force(&elements, extent),
        );
        prop_assert_eq!(&found.touching, &want.touching);
        found.near.sort_by_key(|near| (near.0, near.1));
        want.near.sort_by_key(|near| (near.0, near.1));
        prop_assert_eq!(found.near, want.near);
        Ok(())
    }

    /// Places that often coincide, are often near each other, and often lie on one line.
    fn place() -> impl Strategy<Value = (f64, f64)> {
        let lattice =
            (0..6_u8, 0..6_u8).prop_map(|(x, y)| (f64::from(x) * 7.0, f64::from(y) * 7.0));
        let beside = (0..6_u8, 0..3_u8, -3..4_i8)
            .prop_map(|(x, y, d)| (f64::from(x) * 7.0 + f64::from(d) * 0.3, f64::from(y) * 7.0));
        let rounded = (0..6_u8, -9..10_i8).prop_map(|(x, d)| {
            (
                f64::from(x) * 7.0 + f64::from(d) * 5e-9,
                7.0 - f64::from(d) * 3e-9,
            )
        });
        prop_oneof![lattice, beside, rounded, (0.0..40.0, 0.0..40.0)]
    }

    fn handle() -> impl Strategy<Value = Handle> {
        let point = place().prop_map(|(x, y)| dot(x, y));
        let line = (place(), place())
            .prop_filter("a length", |(a, b)| (a.0 - b.0).hypot(a.1 - b.1) > 1e-3)
            .prop_map(|(a, b)| line(a, b));
        prop_oneof![point, line]
    }

    proptest! {
        #![proptest_config(ProptestConfig::with_cases(2000))]

        #[test]
        fn meetings_are_those_of_a_search_of_all_pairs(handles in prop::collection::vec(handle(),
            0..14)) {
            agrees(handles)?;
        }

        #[test]
        fn meetings_far_from_the_origin_are_too(handles in prop::collection::vec(handle(), 0..9),
            x in -9e5..9e5_f64, y in -9e5..9e5_f64) {
            let moved = |p: &Point| Point::new(p.x + x, p.y + y);
            agrees(handles.iter().map(|h| match h {
                Handle::Point(p) => Handle::Point(moved(p)),
                Handle::Polyline(places) => Handle::Polyline(places.iter().map(moved).collect()),
                Handle::Missing => Handle::Missing,
            }).collect())?;
        }
    }

    #[test]
    fn meetings_of_many_lines_in_one_direction_are_found_along_another() {
        // Their boxes all overlap in x and y, at every angle of the bundle.
        for degrees in [0.0_f64, 11.0, 45.0, 90.0, 130.0] {
            let (sin, cos) = degrees.to_radians().sin_cos();
            let turned = |x: f64, y: f64| (400.0 + x * cos - y * sin, 400.0 + x * sin + y * cos);
            let mut handles: Vec<Handle> = (0..60)
                .map(|k| f64::from(k) - 30.0)
                .map(|y| line(turned(-150.0, y), turned(150.0, y)))
                .collect();
            handles.push(line(turned(0.0, -12.5), turned(1.0, 14.5)));
            let at = turned(10.0, 20.0);
            handles.push(dot(at.0, at.1));
            agrees(handles).unwrap();
        }
    }

    /// Sets of 10,000 columns, each the worst of its kind: all of them take a bounded amount of
    /// work, and end.
    #[test]
    fn the_work_of_the_worst_sets_is_bounded() {
        const N: u32 = 10_000;
        let share = |k: u32| f64::from(k.wrapping_mul(2_654_435_761)) / f64::from(u32::MAX);
        let (half, all) = (
            || 0..N / 2,
            || (0..N).map(|k| (k, share(k), share(k ^ 0x5bd1))),
        );
        let bundle = |angle: f64, spread: f64| {
            let (sin, cos) = angle.sin_cos();
            let turned = move |x: f64, y: f64| (x * cos - y * sin, x * sin + y * cos);
            half()
                .map(|k| spread * f64::from(k))
                .map(|y| line(turned(0.0, y), turned(400.0, y)))
                .collect::<Vec<_>>()
        };
        let sets: Vec<(&str, Vec<Handle>)> = vec![
            (
                "points within 1 px",
                all()
                    .map(|(_, x, y)| dot(100.0 + 0.7 * x, 100.0 + 0.7 * y))
                    .collect(),
            ),
            (
                "points at one place",
                all()
                    .map(|_| dot(3.0, 4.0))
                    .chain([dot(900.0, 0.0)])
                    .collect(),
            ),
            (
                "points within a millionth of a px",
                all()
                    .map(|(_, x, y)| dot(1e-6 * x, 1e-6 * y))
                    .chain([dot(900.0, 0.0)])
                    .collect(),
            ),
            (
                "points of one x",
                all().map(|(_, x, _)| dot(7.0, 4000.0 * x)).collect(),
            ),
            (
                "points of one x, 1/100 px apart",
                all().map(|(k, ..)| dot(7.0, 0.01 * f64::from(k))).collect(),
            ),
            (
                "points on one slanted line",
                all().map(|(_, x, _)| dot(2000.0 * x, 2000.0 * x)).collect(),
            ),
            ("parallel lines along x", bundle(0.0, 0.01)),
            (
                "parallel lines between two directions",
                bundle(std::f64::consts::PI / 16.0, 0.01),
            ),
            (
                "parallel lines far apart",
                bundle(std::f64::consts::PI / 16.0, 0.5),
            ),
            (
                "a star",
                half()
                    .map(|k| f64::from(k).sin_cos())
                    .map(|(s, c)| {
                        line(
                            (500.0 + 9.0 * c, 500.0 + 9.0 * s),
                            (500.0 + 400.0 * c, 500.0 + 400.0 * s),
                        )
                    })
                    .collect(),
            ),
            (
                "all cross",
                half()
                    .map(|k| f64::from(k) / 5000.0)
                    .map(|t| line((0.0, 400.0 * t), (400.0, 400.0 * (1.0 - t))))
                    .collect(),
            ),
            (
                "points beside lines",
                (0..N / 3)
                    .flat_map(|k| {
                        [
                            dot(200.0 + share(k), 3.0),
                            line(
                                (0.0, 0.01 * f64::from(k)),
                                (400.0, 5.0 + 0.01 * f64::from(k)),
                            ),
                        ]
                    })
                    .collect(),
            ),
        ];
        for (name, handles) in sets {
            let (elements, extent) = elements_of(handles);
            let began = std::time::Instant::now();
            let mut search = CoincidenceSearch::new(&elements, extent, NEVER);
            let outcome = search.run().map_err(|e| e.to_string());
            let (n, found) = (elements.len() as u64, &search.found);
            eprintln!(
                "{name}: {} elements, {} comparisons of points, {} work, {} meetings, {} near, \
                    {:.1} ms, {:?}",
                n,
                search.compared,
                search.work,
                found.touching.len(),
                found.near.len(),
                began.elapsed().as_secs_f64() * 1e3,
                outcome
            );
            assert!(
                search.compared <= n * (9 + 25) * POINTS_PER_BUCKET as u64,
                "{name}: {}",
                search.compared
            );
            assert!(
                search.work <= MOST_WORK + 2 * COMPARISON_WORK,
                "{name}: {}",
                search.work
            );
        }
    }

    /// A point may be a group of thousands.
    #[test]
    fn the_members_of_an_element_are_listed_once_for_a_position() {
        let lines = (0..300).map(|k| f64::from(k).sin_cos()).map(|(s, c)| {
            line(
                (50.0 - 40.0 * s, 50.0 - 40.0 * c),
                (50.0 + 40.0 * s, 50.0 + 40.0 * c),
            )
        });
        let (elements, extent) = elements_of([dot(50.0, 50.0)].into_iter().chain(lines).collect());
        let coincidences = Coincidences::find(&elements, extent, NEVER).unwrap();
        assert!(
            coincidences.touching.len() > 40_000,
            "{}",
            coincidences.touching.len()
        );
        let displacements: Vec<Vec2> = (0..601).map(|k| Vec2::new(f64::from(k % 7), 0.0)).collect();
        let (mut found, listed) = (Conflicts::new(coincidences.tolerance()), Cell::new(0));
        coincidences.add_conflicts(
            &mut found,
            &elements,
            &displacements,
            |element, displacement| {
                listed.set(listed.get() + 1);
                [Member {
                    element,
                    handle: element,
                    weight: 1.0,
                    displacement,
                }]
            },
        );
        assert_eq!((listed.get(), found.finish().listed[0].total), (301, 301));
    }

    #[test]
    fn a_search_that_nobody_waits_for_ends_at_the_next_element() {
        let points = (0..500).map(|k| dot(f64::from(k), 0.0));
        let lines = (0..500).map(|k| line((f64::from(k), 1.0), (f64::from(k), 500.0)));
        let (elements, extent) = elements_of(points.chain(lines).collect());
        for looks in [0, 1, 499, 501, 520, 900] {
            let asked = Cell::new(0);
            let cancelled = || asked.replace(asked.get() + 1) >= looks;
            assert_eq!(
                Coincidences::find(&elements, extent, &cancelled).unwrap_err(),
                DeformError::Cancelled
            );
            assert_eq!(asked.get(), looks + 1);
        }
    }
}
