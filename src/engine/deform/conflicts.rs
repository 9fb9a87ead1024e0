//! Contradictory handles of a pose: those that coincide at rest and have different targets, grouped
//! by their position.

use std::collections::HashMap;
use std::fmt;

use crate::geometry::{Point, Vec2};

/// Groups that an error lists, and handles that it lists of each.
const MOST_GROUPS: usize = 100;
const MOST_HANDLES: usize = 100;
/// Handles that a sentence lists.
const MOST_NAMED: usize = 5;

/// Handles that coincide at rest and have different targets, or one polyline that visits a position
/// more than once.
#[derive(Clone, Debug, PartialEq)]
pub struct Conflict {
    /// Indices of the handles, ascending, each once, at most 100; one if it is a polyline that
    /// meets itself.
    pub handles: Vec<usize>,
    /// The number of all handles of the group.
    pub total: usize,
    /// Their position at rest, px.
    pub position: Point,
    /// Largest difference of a displacement from the weighted mean displacement, px.
    pub spread: f64,
    /// The distance of the two targets, px, if there are two.
    pub apart: Option<f64>,
}

impl fmt::Display for Conflict {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let Self {
            handles,
            total,
            position,
            spread,
            apart,
        } = self;
        match handles.as_slice() {
            [handle] => write!(f, "handle {handle} visits ")?,
            [a, b] if *total == 2 => write!(f, "handles {a} and {b} meet at rest at ")?,
            _ => {
                let list: Vec<String> = handles
                    .iter()
                    .take(MOST_NAMED)
                    .map(ToString::to_string)
                    .collect();
                write!(f, "handles {}", list.join(", "))?;
                if *total > MOST_NAMED {
                    write!(f, " and {} more", total - MOST_NAMED)?;
                }
                f.write_str(" meet at rest at ")?;
            }
        }
        write!(f, "({}, {})", Short(position.x), Short(position.y))?;
        match (handles.len(), apart) {
            (1, Some(apart)) => write!(f, " twice, with targets {} px apart", Short(*apart)),
            (1, None) => write!(
                f,
                " several times, with targets up to {} px from their mean",
                Short(*spread)
            ),
            (_, Some(apart)) => {
                write!(f, " but their targets there are {} px apart", Short(*apart))
            }
            (_, None) => write!(
                f,
                " but their targets there are up to {} px from their mean",
                Short(*spread)
            ),
        }
    }
}

/// A number with at most two decimals; a small one with two digits.
pub(super) struct Short(pub(super) f64);

impl fmt::Display for Short {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let Self(number) = *self;
        if number != 0.0 && number.abs() < 0.01 {
            return write!(f, "{number:.1e}");
        }
        let rounded = (number * 100.0).round() / 100.0;
        write!(f, "{}", if rounded == 0.0 { 0.0 } else { rounded })
    }
}

/// The conflicts of a pose.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct ConflictingHandles {
    /// The first groups that were found, at most 100.
    pub listed: Vec<Conflict>,
    /// The number of all groups.
    pub total: usize,
    positions: PositionIndex,
    /// Positions at which f is torn, and the distance of two targets there, px. Coincident points,
    /// which move by their mean, tear nothing.
    tears: Vec<(Point, f64)>,
}

impl ConflictingHandles {
    /// Positions at which f is torn by more than `apart`, px.
    pub(super) fn torn(&self, apart: f64) -> impl Iterator<Item = Point> + '_ {
        self.tears
            .iter()
            .filter(move |(_, by)| *by > apart)
            .map(|(position, _)| *position)
    }

    /// Whether handles contradict each other at this position at rest.
    #[must_use]
    pub fn contains(&self, position: Point) -> bool {
        self.total > 0 && self.positions.find(position).is_some()
    }
}

/// Positions with an index each.
#[derive(Clone, Debug, Default, PartialEq)]
struct PositionIndex {
    /// Positions nearer than this are one, px.
    within: f64,
    /// By cell.
    cells: HashMap<[i64; 2], (usize, Point)>,
}

impl PositionIndex {
    /// Adds a position that is not there yet.
    fn add(&mut self, position: Point) -> usize {
        let index = self.cells.len();
        self.cells.insert(self.cell(position), (index, position));
        index
    }

    #[expect(
        clippy::cast_possible_truncation,
        reason = "a position is at most 1e6 px, and the tolerance at least a millionth"
    )]
    fn cell(&self, position: Point) -> [i64; 2] {
        [position.x, position.y].map(|c| (c / self.within).floor() as i64)
    }

    /// The index of a position: one nearer than `within`, which may be in a neighbouring cell.
    fn find(&self, position: Point) -> Option<usize> {
        let [x, y] = self.cell(position);
        let around = (x - 1..=x + 1).flat_map(|x| (y - 1..=y + 1).map(move |y| [x, y]));
        let mut known = around.filter_map(|cell| self.cells.get(&cell));
        known
            .find(|(_, other)| position.distance(*other) < self.within)
            .map(|(index, _)| *index)
    }
}

/// An element at a position that it shares with others.
#[derive(Clone, Copy, Debug)]
pub(super) struct Member {
    pub(super) element: usize,
    pub(super) handle: usize,
    /// The weight of the handle.
    pub(super) weight: f64,
    /// The displacement of the position by this element.
    pub(super) displacement: Vec2,
}

/// Groups of elements by position.
#[derive(Debug)]
pub(super) struct Conflicts {
    /// The positions of the first 100 groups and what meets there.
    groups: Vec<(Point, Vec<Member>)>,
    /// The groups by their position; an index beyond the end: counted only.
    positions: PositionIndex,
    tears: Vec<(Point, f64)>,
}

impl Conflicts {
    pub(super) fn new(within: f64) -> Self {
        Self {
            groups: Vec::new(),
            positions: PositionIndex {
                within,
                ..PositionIndex::default()
            },
            tears: Vec::new(),
        }
    }

    pub(super) fn is_empty(&self) -> bool {
        self.positions.cells.is_empty()
    }

    /// Counts a position at which two targets differ.
    pub(super) fn add_position(&mut self, position: Point) {
        if self.positions.find(position).is_none() && self.positions.add(position) < MOST_GROUPS {
            self.groups.push((position, Vec::new()));
        }
    }

    /// Counts a position at which f has two targets, this far apart.
    pub(super) fn add_tear(&mut self, position: Point, apart: f64) {
        self.add_position(position);
        self.tears.push((position, apart));
    }

    /// The index of the group at a position, if it is one that is listed.
    pub(super) fn listed(&self, position: Point) -> Option<usize> {
        self.positions
            .find(position)
            .filter(|index| *index < self.groups.len())
    }

    /// Adds elements at a position, if it is one of the groups that are listed.
    pub(super) fn add_members(
        &mut self,
        position: Point,
        members: impl IntoIterator<Item = Member>,
    ) {
        if let Some(index) = self.listed(position) {
            self.groups[index].1.extend(members);
        }
    }

    /// The groups in the order of their first position.
    pub(super) fn finish(self) -> ConflictingHandles {
        let Self {
            groups,
            positions,
            tears,
        } = self;
        let listed = groups
            .into_iter()
            .map(|(position, members)| conflict(position, members, positions.within))
            .collect();
        ConflictingHandles {
            listed,
            total: positions.cells.len(),
            positions,
            tears,
        }
    }
}

/// The report of a group.
fn conflict(position: Point, mut members: Vec<Member>, within: f64) -> Conflict {
    members.sort_by_key(|member| member.element);
    members.dedup_by_key(|member| member.element);
    // Neighbouring segments of a polyline share a position and its target.
    members.sort_by_key(|member| member.handle);
    members.dedup_by(|b, a| {
        b.handle == a.handle && (b.displacement - a.displacement).norm() <= within
    });
    let weight: f64 = members.iter().map(|member| member.weight).sum();
    let mean = members.iter().fold(Vec2::ZERO, |sum, member| {
        sum + member.displacement * (member.weight / weight)
    });
    let spread = members
        .iter()
        .map(|member| (member.displacement - mean).norm())
        .fold(0.0, f64::max);
    let apart = match members.as_slice() {
        [a, b] => Some((a.displacement - b.displacement).norm()),
        _ => None,
    };
    let mut handles: Vec<usize> = members.iter().map(|member| member.handle).collect();
    handles.dedup();
    let total = handles.len();
    handles.truncate(MOST_HANDLES);
    Conflict {
        handles,
        total,
        position,
        spread,
        apart,
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn member(handle: usize, x: f64) -> Member {
        Member {
            element: handle,
            handle,
            weight: 1.0,
            displacement: Vec2::new(x, 0.0),
        }
    }

    fn groups(members: &[(Point, Member)], wrong: &[Point]) -> (Vec<Conflict>, usize) {
        let mut found = Conflicts::new(1e-3);
        wrong
            .iter()
            .for_each(|position| found.add_position(*position));
        members
            .iter()
            .for_each(|(position, member)| found.add_members(*position, [*member]));
        let ConflictingHandles { listed, total, .. } = found.finish();
        (listed, total)
    }

    #[test]
    fn all_members_of_a_position_count_and_each_once() {
        let at = Point::new(120.0, 80.0);
        let [a, b, c] = [member(5, 6.0), member(2, 0.0), member(7, 12.0)];
        let (found, total) = groups(
            &[
                (at, a),
                (at, b),
                (at, b),
                (at, c),
                (Point::new(1.0, 2.0), a),
            ],
            &[at],
        );
        assert_eq!(
            (
                total,
                found[0].handles.as_slice(),
                found[0].total,
                found[0].spread,
                found[0].apart
            ),
            (1, &[2, 5, 7][..], 3, 6.0, None)
        );
        assert_eq!(
            found[0].to_string(),
            "handles 2, 5, 7 meet at rest at (120, 80) but their targets there are up to 6 px \
                from their mean"
        );
        let heavy = Member { weight: 5.0, ..b };
        let (found, _) = groups(&[(at, heavy), (at, a)], &[at]);
        assert_eq!((found[0].spread, found[0].apart), (5.0, Some(6.0)));
        assert_eq!(
            found[0].to_string(),
            "handles 2 and 5 meet at rest at (120, 80) but their targets there are 6 px apart"
        );
    }

    #[test]
    fn a_polyline_meets_itself() {
        let at = Point::new(10.0, 20.5);
        let on = |element, x| Member {
            element,
            ..member(3, x)
        };
        let (found, _) = groups(
            &[(at, on(0, 0.0)), (at, on(1, 0.0)), (at, on(4, 4.0))],
            &[at],
        );
        assert_eq!(
            found[0].to_string(),
            "handle 3 visits (10, 20.5) twice, with targets 4 px apart"
        );
        let (found, _) = groups(
            &[(at, on(0, 0.0)), (at, on(2, 2.0)), (at, on(4, 4.0))],
            &[at],
        );
        assert_eq!(
            found[0].to_string(),
            "handle 3 visits (10, 20.5) several times, with targets up to 2 px from their mean"
        );
    }

    #[test]
    fn a_position_at_the_border_of_cells_is_one_group() {
        for at in [
            Point::new(0.0, 0.0),
            Point::new(0.001, -0.001),
            Point::new(120.0, 80.0),
        ] {
            for (dx, dy) in [(1e-9, 0.0), (-1e-9, 1e-9), (0.0, -1e-9), (5e-4, 5e-4)] {
                let near = Point::new(at.x + dx, at.y + dy);
                let (found, total) =
                    groups(&[(at, member(0, 0.0)), (near, member(1, 3.0))], &[at, near]);
                assert_eq!(
                    (total, found[0].handles.as_slice()),
                    (1, &[0, 1][..]),
                    "{at:?} {dx} {dy}"
                );
            }
        }
    }

    #[test]
    fn all_groups_are_counted_and_some_are_listed() {
        let positions: Vec<Point> = (0..5000_u16)
            .map(|k| Point::new(f64::from(k), 0.0))
            .collect();
        let members: Vec<_> = (0..150)
            .map(|k| (positions[0], member(k, if k == 149 { 100.0 } else { 0.0 })))
            .collect();
        let (found, total) = groups(&members, &positions);
        assert_eq!(
            (found.len(), total, found[0].handles.len(), found[0].total),
            (MOST_GROUPS, 5000, MOST_HANDLES, 150)
        );
        // The one that differs counts though it is not listed.
        assert!(found[0].spread > 99.0);
        assert!(
            found[0]
                .to_string()
                .starts_with("handles 0, 1, 2, 3, 4 and 145 more meet at rest at (0, 0)"),
            "{}",
            found[0]
        );
    }

    #[test]
    fn numbers_are_short() {
        for (number, text) in [
            (14.142_135_6, "14.14"),
            (4.0, "4"),
            (-0.001, "-1.0e-3"),
            (0.0, "0"),
            (1e6, "1000000"),
            (-0.0, "0"),
        ] {
            assert_eq!(Short(number).to_string(), text);
        }
    }
}
