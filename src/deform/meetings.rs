//! Where handles meet at rest: coincident points, points on segments, segments that touch, cross or overlap. Found once a plan by a sweep
//! over x; each pose then only compares the two targets of every meeting (mathematics section 6: where they differ, f is discontinuous).

use super::columns::{Element, ONE_PLACE, Segment};
use super::handles::COINCIDENT_SHARE;
use super::{DeformError, Pose};
use crate::geometry::{Point, Vec2};

/// Targets further apart than this share of the extent contradict each other.
const CONTRADICTION_SHARE: f64 = 1e-6;
/// Points nearer than this are looked at for a warning, px.
const NEAR: f64 = 1.0;
/// Targets so many times as far apart as their points at rest are worth a warning.
const NEAR_FACTOR: f64 = 10.0;
/// More meetings than this in one set is a set that nobody drew by hand.
const MOST: usize = 200_000;

/// A place on an element: the element's index and the parameter along it (0 for a point).
type On = (usize, f64);

/// The meetings of one set.
#[derive(Clone, Debug, Default)]
pub(super) struct Meetings {
    /// Elements that share a place.
    touching: Vec<(On, On)>,
    /// Points nearer than 1 px that do not share one, and their distance.
    near: Vec<(usize, usize, f64)>,
    tolerance: f64,
}

impl Meetings {
    /// Sweeps the elements by x. O(n log n) for sets whose elements overlap little in x.
    pub(super) fn find(elements: &[Element], extent: f64) -> Result<Self, DeformError> {
        let coincident = if extent <= ONE_PLACE { 2.0 * ONE_PLACE } else { COINCIDENT_SHARE * extent };
        let reach = coincident.max(NEAR);
        let boxes: Vec<[f64; 4]> = elements.iter().map(bounds).collect();
        let mut order: Vec<usize> = (0..elements.len()).collect();
        order.sort_unstable_by(|&i, &j| boxes[i][0].total_cmp(&boxes[j][0]));
        let mut found = Self { tolerance: CONTRADICTION_SHARE * extent.max(1.0), ..Self::default() };
        let mut twin = vec![false; elements.len()];
        for (k, &i) in order.iter().enumerate() {
            for &j in &order[k + 1..] {
                if boxes[j][0] > boxes[i][2] + reach {
                    break;
                }
                if boxes[j][1] <= boxes[i][3] + reach && boxes[i][1] <= boxes[j][3] + reach {
                    found.meet(elements, i.min(j), i.max(j), coincident, &mut twin);
                    if found.touching.len() > MOST {
                        return Err(DeformError::TooManyMeetings { limit: MOST });
                    }
                }
            }
        }
        found.touching.sort_unstable_by_key(|(x, y)| (x.0, y.0));
        Ok(found)
    }

    fn meet(&mut self, elements: &[Element], i: usize, j: usize, coincident: f64, twin: &mut [bool]) {
        match (&elements[i], &elements[j]) {
            (Element::Point { p, .. }, Element::Point { p: other, .. }) => {
                let apart = p.distance(*other);
                if apart <= coincident {
                    // One earlier point at the same place is enough: it has been compared with the others.
                    if !std::mem::replace(&mut twin[j], true) {
                        self.touching.push(((i, 0.0), (j, 0.0)));
                    }
                } else if apart < NEAR && self.near.len() < MOST {
                    // A warning needs some of them, not all.
                    self.near.push((i, j, apart));
                }
            }
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

    /// Compares the targets wherever handles meet. `owners`: the handle of every element.
    ///
    /// # Errors
    /// The first contradiction, naming both handles.
    pub(super) fn check(&self, elements: &[Element], owners: &[usize], pose: &Pose) -> Result<(), DeformError> {
        for &(x, y) in &self.touching {
            let apart = (target(&elements[x.0], x.1, pose) - target(&elements[y.0], y.1, pose)).norm();
            if apart > self.tolerance {
                let place = place(&elements[x.0], x.1);
                let (first, second) = (owners[x.0].min(owners[y.0]), owners[x.0].max(owners[y.0]));
                return Err(DeformError::Contradictory { first, second, x: place.x, y: place.y, apart });
            }
        }
        Ok(())
    }

    /// Some points nearer than 1 px go more than ten times as far apart.
    pub(super) fn tears(&self, elements: &[Element], pose: &Pose) -> bool {
        self.near
            .iter()
            .any(|&(i, j, apart)| (target(&elements[i], 0.0, pose) - target(&elements[j], 0.0, pose)).norm() > NEAR_FACTOR * apart)
    }
}

/// `[min x, min y, max x, max y]`.
fn bounds(element: &Element) -> [f64; 4] {
    match element {
        Element::Point { p, .. } => [p.x, p.y, p.x, p.y],
        Element::Segment(s) => [s.a.x.min(s.b.x), s.a.y.min(s.b.y), s.a.x.max(s.b.x), s.a.y.max(s.b.y)],
    }
}

/// The parameter at which `p` lies on the segment.
fn on(s: &Segment, p: Point, within: f64) -> Option<f64> {
    let (t, d2) = s.nearest(p);
    (d2 <= within * within).then_some(t)
}

/// The parameters at which two segments cross in their interiors; parallel ones meet at their ends or not at all.
fn crossing(s: &Segment, other: &Segment) -> Option<(f64, f64)> {
    let sin = s.tau.cross(other.tau);
    if sin.abs() < 1e-12 {
        return None;
    }
    let between = other.a - s.a;
    let (t, u) = (between.cross(other.tau) / (sin * s.length), between.cross(s.tau) / (sin * other.length));
    ((0.0..=1.0).contains(&t) && (0.0..=1.0).contains(&u)).then_some((t, u))
}

fn place(element: &Element, t: f64) -> Point {
    match element {
        Element::Point { p, .. } => *p,
        Element::Segment(s) => s.a.lerp(s.b, t),
    }
}

fn target(element: &Element, t: f64, pose: &Pose) -> Point {
    let d = pose.displacements();
    let displacement: Vec2 = match element {
        Element::Point { column, .. } => d[*column],
        Element::Segment(s) => d[s.column] * (1.0 - t) + d[s.column + 1] * t,
    };
    place(element, t) + displacement
}
