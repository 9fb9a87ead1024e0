//! Contradictory handles of a pose: those that coincide at rest and have different targets, grouped by their position.

use std::collections::HashMap;
use std::fmt;

use crate::geometry::{Point, Vec2};

/// Groups that an error lists, and handles that it lists of each.
const MOST_GROUPS: usize = 100;
const MOST_HANDLES: usize = 100;

/// Handles that coincide at rest and have different targets, or one polyline that visits a position twice.
#[derive(Clone, Debug, PartialEq)]
pub struct Contradiction {
    /// Indices of the handles, ascending, each once, at most 100; one if it is a polyline that meets itself.
    pub handles: Vec<usize>,
    /// Their position at rest, px.
    pub position: Point,
    /// Largest distance of two of their targets that were compared, px.
    pub apart: f64,
    /// Largest difference of a displacement from the mean displacement, px.
    pub spread: f64,
}

impl fmt::Display for Contradiction {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let Self { handles, position, apart, .. } = self;
        let (place, apart) = (format!("({}, {})", Short(position.x), Short(position.y)), Short(*apart));
        match handles.as_slice() {
            [handle] => write!(f, "handle {handle} visits {place} twice, with targets {apart} px apart"),
            [a, b] => write!(f, "handles {a} and {b} meet at rest at {place} but their targets there are {apart} px apart"),
            _ => {
                let list: Vec<String> = handles.iter().take(5).map(ToString::to_string).collect();
                let more = if handles.len() > 5 { ", ..." } else { "" };
                write!(f, "handles {}{more} meet at rest at {place} but their targets there are up to {apart} px apart", list.join(", "))
            }
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

/// One handle at a position: its index and the displacement of the position by it.
type Member = (usize, Vec2);

#[derive(Debug)]
struct Group {
    position: Point,
    members: Vec<Member>,
    apart: f64,
}

/// Collects contradictory pairs. Allocates nothing before the first.
#[derive(Debug)]
pub(super) struct Contradictions {
    /// Positions nearer than this are one, px.
    within: f64,
    groups: Vec<Group>,
    /// The index in `groups` of each cell of positions; one beyond the end: counted only.
    cells: HashMap<[i64; 2], usize>,
}

impl Contradictions {
    pub(super) fn new(within: f64) -> Self {
        Self { within, groups: Vec::new(), cells: HashMap::new() }
    }

    /// Adds two handles that meet at `position`.
    pub(super) fn add(&mut self, position: Point, a: Member, b: Member) {
        #[expect(clippy::cast_possible_truncation, reason = "a position is at most 1e6 px, and the tolerance at least a millionth")]
        let cell = [position.x, position.y].map(|c| (c / self.within).round() as i64);
        let index = *self.cells.entry(cell).or_insert(self.groups.len());
        if index == self.groups.len() && index < MOST_GROUPS {
            self.groups.push(Group { position, members: Vec::new(), apart: 0.0 });
        }
        let Some(group) = self.groups.get_mut(index) else { return };
        group.apart = group.apart.max((a.1 - b.1).norm());
        for member in [a, b] {
            let is_new = group.members.iter().all(|(handle, d)| *handle != member.0 || (*d - member.1).norm() > self.within);
            if is_new && group.members.len() < MOST_HANDLES {
                group.members.push(member);
            }
        }
    }

    /// The groups in the order in which they were found, at most 100, and the number of all.
    pub(super) fn finish(self) -> (Vec<Contradiction>, usize) {
        let contradiction = |Group { position, members, apart }: Group| {
            #[expect(clippy::cast_precision_loss, reason = "at most 100 members")]
            let mean = members.iter().fold(Vec2::ZERO, |sum, (_, d)| sum + *d) * (1.0 / members.len() as f64);
            let spread = members.iter().map(|(_, d)| (*d - mean).norm()).fold(0.0, f64::max);
            let mut handles: Vec<usize> = members.iter().map(|(handle, _)| *handle).collect();
            handles.sort_unstable();
            handles.dedup();
            Contradiction { handles, position, apart, spread }
        };
        (self.groups.into_iter().map(contradiction).collect(), self.cells.len())
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn member(handle: usize, x: f64) -> Member {
        (handle, Vec2::new(x, 0.0))
    }

    #[test]
    fn pairs_of_one_position_are_one_group() {
        let mut found = Contradictions::new(1e-3);
        let at = Point::new(120.0, 80.0);
        found.add(at, member(2, 0.0), member(5, 6.0));
        found.add(Point::new(120.000_1, 80.0), member(2, 0.0), member(7, 12.0));
        found.add(Point::new(10.0, 20.5), member(3, 0.0), member(3, 4.0));
        let (groups, total) = found.finish();
        assert_eq!(total, 2);
        assert_eq!((groups[0].handles.as_slice(), groups[0].apart, groups[0].spread), (&[2, 5, 7][..], 12.0, 6.0));
        assert_eq!(groups[0].to_string(), "handles 2, 5, 7 meet at rest at (120, 80) but their targets there are up to 12 px apart");
        assert_eq!(groups[1].to_string(), "handle 3 visits (10, 20.5) twice, with targets 4 px apart");
    }

    #[test]
    fn all_groups_are_counted_and_some_are_listed() {
        let mut found = Contradictions::new(1e-3);
        for k in 0..5000_u16 {
            found.add(Point::new(f64::from(k), 0.0), member(0, 0.0), member(1, 1.0));
            found.add(Point::new(0.0, 0.0), member(0, 0.0), member(usize::from(k) + 1, 1.0));
        }
        let (groups, total) = found.finish();
        assert_eq!((groups.len(), total, groups[0].handles.len()), (MOST_GROUPS, 5000, MOST_HANDLES));
    }

    #[test]
    fn numbers_are_short() {
        for (number, text) in [(14.142_135_6, "14.14"), (4.0, "4"), (-0.001, "-1.0e-3"), (0.0, "0"), (1e6, "1000000"), (-0.0, "0")] {
            assert_eq!(Short(number).to_string(), text);
        }
    }
}
