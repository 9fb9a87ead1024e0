//! Which handles no map without folds takes to their targets.

use super::super::{Handle, IsCancelled};
use super::path::{SAME_SHARE, extent_of, places_of};
use crate::geometry::Point;

/// A point, or a segment of a line: its ends at rest and posed, and the index of its handle. A
/// point is a segment without length.
#[derive(Clone, Copy)]
struct HandlePart {
    handle: usize,
    rest: [Point; 2],
    posed: [Point; 2],
    is_segment: bool,
}

/// Handles that cannot be taken to their targets, if there are any: one, two that would meet or
/// part, or a closed chain of lines that would be turned inside out. The outer `None`: cancelled.
/// O(segments^2).
pub(super) fn unreachable(
    p: &[Handle],
    q: &[Handle],
    cancelled: IsCancelled<'_>,
) -> Option<Option<Vec<usize>>> {
    let same = SAME_SHARE * extent_of(&places_of(p));
    let parts = parts_of(p, q);
    for (k, one) in parts.iter().enumerate() {
        if cancelled() {
            return None;
        }
        let is_lost = |[a, b]: [Point; 2]| a.distance(b) < same;
        if one.is_segment && is_lost(one.posed) && !is_lost(one.rest) {
            return Some(Some(vec![one.handle]));
        }
        for other in &parts[..k] {
            if !go_together(one, other, same) {
                let mut handles = vec![other.handle, one.handle];
                handles.dedup();
                return Some(Some(handles));
            }
        }
    }
    turned_chain(&parts, same, cancelled)
}

fn parts_of(p: &[Handle], q: &[Handle]) -> Vec<HandlePart> {
    let parts = |(handle, (p, q)): (usize, (&Handle, &Handle))| -> Vec<HandlePart> {
        match (p, q) {
            (Handle::Point(p), Handle::Point(q)) => vec![HandlePart {
                handle,
                rest: [*p; 2],
                posed: [*q; 2],
                is_segment: false,
            }],
            (Handle::Polyline(p), Handle::Polyline(q)) => {
                let segments = p.windows(2).zip(q.windows(2));
                let part = |(ab, cd): (&[Point], &[Point])| HandlePart {
                    handle,
                    rest: [ab[0], ab[1]],
                    posed: [cd[0], cd[1]],
                    is_segment: true,
                };
                segments.map(part).collect()
            }
            _ => Vec::new(),
        }
    };
    p.iter().zip(q).enumerate().flat_map(parts).collect()
}

/// Whether two parts that meet stay together at that place, and two that do not stay apart.
fn go_together(one: &HandlePart, other: &HandlePart, same: f64) -> bool {
    let at = |[a, b]: [Point; 2], share: f64| a.lerp(b, share);
    match meeting(one.rest, other.rest, same) {
        Some([s, t]) => at(one.posed, s).distance(at(other.posed, t)) <= same,
        None => meeting(one.posed, other.posed, same).is_none(),
    }
}

/// Where two segments meet: the shares of their lengths.
fn meeting(one: [Point; 2], other: [Point; 2], same: f64) -> Option<[f64; 2]> {
    let foot = |v: Point, [a, b]: [Point; 2]| {
        let along = b - a;
        let share = ((v - a).dot(along) / along.norm2()).clamp(0.0, 1.0);
        // A point.
        let share = if share.is_nan() { 0.0 } else { share };
        (share, v.distance(a.lerp(b, share)))
    };
    let ends = [(0.0, 0), (1.0, 1)];
    for (share, end) in ends {
        let (t, distance) = foot(one[end], other);
        if distance <= same {
            return Some([share, t]);
        }
        let (s, distance) = foot(other[end], one);
        if distance <= same {
            return Some([s, share]);
        }
    }
    let (u, v, w) = (one[1] - one[0], other[1] - other[0], other[0] - one[0]);
    let (s, t) = (w.cross(v) / u.cross(v), w.cross(u) / u.cross(v));
    let is_inside = |share: f64| (0.0..=1.0).contains(&share);
    (is_inside(s) && is_inside(t)).then_some([s, t])
}

/// A closed chain of segments whose area changes its sign. The outer `None`: cancelled.
fn turned_chain(
    parts: &[HandlePart],
    same: f64,
    cancelled: IsCancelled<'_>,
) -> Option<Option<Vec<usize>>> {
    let mut open: Vec<&HandlePart> = parts.iter().filter(|part| part.is_segment).collect();
    while let Some(first) = open.pop() {
        let mut chain = vec![(first.rest, first.posed)];
        let (mut handles, mut end) = (vec![first.handle], first.rest[1]);
        let is_next = |end: Point| {
            move |part: &&HandlePart| part.rest.iter().any(|v| v.distance(end) <= same)
        };
        while end.distance(first.rest[0]) > same {
            if cancelled() {
                return None;
            }
            let mut next = open
                .iter()
                .enumerate()
                .filter(|(_, part)| is_next(end)(part));
            // Where chains branch, none is taken for closed.
            let (Some((index, _)), None) = (next.next(), next.next()) else {
                break;
            };
            let part = open.swap_remove(index);
            let is_reversed = part.rest[0].distance(end) > same;
            let turned = |[a, b]: [Point; 2]| if is_reversed { [b, a] } else { [a, b] };
            chain.push((turned(part.rest), turned(part.posed)));
            handles.push(part.handle);
            end = turned(part.rest)[1];
        }
        let (rest, posed): (Vec<_>, Vec<_>) = chain.into_iter().unzip();
        let is_closed = rest.len() > 2 && end.distance(first.rest[0]) <= same;
        if is_closed && area(&rest) * area(&posed) < 0.0 {
            handles.sort_unstable();
            handles.dedup();
            return Some(Some(handles));
        }
    }
    Some(None)
}

/// Twice the area inside a closed chain, with the sign of its turn.
fn area(segments: &[[Point; 2]]) -> f64 {
    let origin = segments.first().map_or(Point::default(), |[a, _]| *a);
    let cross = |[a, b]: &[Point; 2]| (*a - origin).cross(*b - origin);
    segments.iter().map(cross).sum()
}
