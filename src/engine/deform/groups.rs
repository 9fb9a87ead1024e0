//! Groups of coincident points: the points of a group are one handle, at their weighted mean
//! (mathematics section 6). Groups follow from the handles at rest alone, so a plan does not depend
//! on q.

use std::collections::HashMap;

use super::columns::ONE_PLACE_PX;
use super::conflicts::{Conflicts, Member};
use super::handles::COINCIDENT_SHARE;
use super::{DeformError, Handle, Handles};
use crate::geometry::{Point, Vec2};

/// The side of a cell whose points all coincide, as a share of the distance of coincidence: its
/// diagonal is shorter than that distance.
const CELL_SIDE_SHARE: f64 = 0.7;
/// Points of two cells may coincide if their columns and rows differ by at most this.
const REACH_CELLS: i64 = 2;

/// What happens to coincident handles whose displacements differ.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Hash)]
pub enum CoincidentPolicy {
    /// Their shared position moves by the weighted mean of their displacements.
    #[default]
    Mean,
    /// The pose is refused.
    Reject,
}

/// The treatment of coincident handles.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Coincident {
    /// For those whose displacements differ.
    pub policy: CoincidentPolicy,
    /// Points nearer to each other than this are one handle, px; at least a billionth of the set's
    /// extent.
    pub within: f64,
}

/// The distance up to which the positions of a set of this extent coincide, px.
pub(super) fn coincidence_distance(extent: f64) -> f64 {
    if extent <= ONE_PLACE_PX {
        2.0 * ONE_PLACE_PX
    } else {
        COINCIDENT_SHARE * extent
    }
}

/// The groups of two points or more of one set.
#[derive(Clone, Debug)]
pub(super) struct Groups {
    groups: Vec<Vec<GroupedPoint>>,
    /// The origin of each column of the grouped set.
    origins: Vec<Origin>,
}

/// A point of a group.
#[derive(Clone, Copy, Debug)]
struct GroupedPoint {
    handle: usize,
    column: usize,
    weight: f64,
}

/// Where a column of the grouped set comes from.
#[derive(Clone, Copy, Debug)]
enum Origin {
    /// A column of the client's set.
    Column(usize),
    /// The mean of a group.
    Group(usize),
}

impl Groups {
    /// Finds the groups of points within `distance` of each other, directly or by way of others.
    /// O(points), except for neighbouring cells that have many points and none within the distance:
    /// at worst a third of the squared number of points. `None` if no points coincide. The second
    /// result: the handle in `handles` of each grouped handle.
    ///
    /// # Errors
    /// Cancelled, which is checked for each point.
    pub(super) fn find(
        handles: &Handles,
        distance: f64,
        cancelled: &dyn Fn() -> bool,
    ) -> Result<Option<(Self, Handles, Vec<usize>)>, DeformError> {
        let mut points = Vec::new();
        let mut column = 0;
        for (index, (handle, &weight)) in
            handles.handles().iter().zip(handles.weights()).enumerate()
        {
            if let Handle::Point(p) = handle {
                points.push((
                    *p,
                    GroupedPoint {
                        handle: index,
                        column,
                        weight,
                    },
                ));
            }
            column += handle.columns();
        }
        let firsts = firsts(
            &points.iter().map(|(p, _)| *p).collect::<Vec<_>>(),
            distance,
            cancelled,
        )?;
        let mut members = vec![Vec::new(); handles.handles().len()];
        for ((_, point), first) in points.iter().zip(firsts) {
            members[points[first].1.handle].push(*point);
        }
        if members.iter().all(|group| group.len() <= 1) {
            return Ok(None);
        }
        Ok(Some(Self::merge(handles, &members)))
    }

    /// `members`: of each handle that is the first of a group, the points of the group.
    fn merge(handles: &Handles, members: &[Vec<GroupedPoint>]) -> (Self, Handles, Vec<usize>) {
        let mut merged = Self {
            groups: Vec::new(),
            origins: Vec::new(),
        };
        let (mut grouped, mut weights, mut owners) = (Vec::new(), Vec::new(), Vec::new());
        let mut column = 0;
        for (index, (handle, group)) in handles.handles().iter().zip(members).enumerate() {
            let columns = column..column + handle.columns();
            column = columns.end;
            match (handle, group.as_slice()) {
                (Handle::Point(_), []) => continue,
                (Handle::Point(p), [_, _, ..]) => {
                    let position = |k: usize| handles.handles()[group[k].handle].places()[0] - *p;
                    grouped.push(Handle::Point(*p + mean(group, position)));
                    weights.push(group.iter().map(|point| point.weight).sum());
                    merged.origins.push(Origin::Group(merged.groups.len()));
                    merged.groups.push(group.clone());
                }
                _ => {
                    grouped.push(handle.clone());
                    weights.push(handles.weights()[index]);
                    merged.origins.extend(columns.map(Origin::Column));
                }
            }
            owners.push(index);
        }
        (merged, Handles::of_valid(grouped, weights), owners)
    }

    /// The handles of each group, ascending, in the order of their first handles.
    pub(super) fn handles(&self) -> impl Iterator<Item = Vec<usize>> + '_ {
        self.groups
            .iter()
            .map(|group| group.iter().map(|point| point.handle).collect())
    }

    /// The displacements of the grouped columns, from those of the client's.
    pub(super) fn displacements(&self, given: &[Vec2]) -> Vec<Vec2> {
        let of = |origin: &Origin| match *origin {
            Origin::Column(column) => given[column],
            Origin::Group(group) => {
                let group = &self.groups[group];
                given[group[0].column]
                    + mean(group, |k| given[group[k].column] - given[group[0].column])
            }
        };
        self.origins.iter().map(of).collect()
    }

    /// The grouped column of each of the client's columns.
    pub(super) fn columns(&self) -> Vec<usize> {
        let given = |origin: &Origin| match origin {
            Origin::Column(_) => 1,
            Origin::Group(group) => self.groups[*group].len(),
        };
        let mut columns = vec![0; self.origins.iter().map(given).sum()];
        for (grouped, origin) in self.origins.iter().enumerate() {
            match *origin {
                Origin::Column(column) => columns[column] = grouped,
                Origin::Group(group) => self.groups[group]
                    .iter()
                    .for_each(|point| columns[point.column] = grouped),
            }
        }
        columns
    }

    /// The client's handles of the group that is this column; none if it is no group.
    pub(super) fn handles_of(&self, column: usize) -> impl Iterator<Item = usize> + '_ {
        let group = match self.origins[column] {
            Origin::Group(group) => &self.groups[group][..],
            Origin::Column(_) => &[],
        };
        group.iter().map(|point| point.handle)
    }

    /// Adds the position of each group whose displacements differ from their mean by more than
    /// `tolerance`.
    pub(super) fn add_conflicts(
        &self,
        found: &mut Conflicts,
        grouped: &Handles,
        given: &[Vec2],
        mean: &[Vec2],
        tolerance: f64,
    ) {
        let mut columns = self.origins.iter().zip(mean);
        for handle in grouped
            .handles()
            .iter()
            .filter(|handle| handle.columns() > 0)
        {
            let column = columns.next();
            if let (Handle::Point(p), Some((&Origin::Group(group), mean))) = (handle, column)
                && self.groups[group]
                    .iter()
                    .any(|point| (given[point.column] - *mean).norm() > tolerance)
            {
                found.add_position(*p);
                found.add_members(
                    *p,
                    self.groups[group].iter().map(|point| member(point, given)),
                );
            }
            columns.by_ref().take(handle.columns() - 1).for_each(drop);
        }
    }

    /// The points of the group that is this column, if it is one, with their displacements.
    pub(super) fn members(
        &self,
        column: usize,
        given: &[Vec2],
    ) -> Option<impl Iterator<Item = Member>> {
        match self.origins[column] {
            Origin::Group(group) => {
                Some(self.groups[group].iter().map(|point| member(point, given)))
            }
            Origin::Column(_) => None,
        }
    }
}

fn member(point: &GroupedPoint, given: &[Vec2]) -> Member {
    Member {
        element: point.column,
        handle: point.handle,
        weight: point.weight,
        displacement: given[point.column],
    }
}

/// The weighted mean; zero if every value is.
fn mean(group: &[GroupedPoint], value: impl Fn(usize) -> Vec2) -> Vec2 {
    let weight: f64 = group.iter().map(|point| point.weight).sum();
    group
        .iter()
        .enumerate()
        .fold(Vec2::ZERO, |sum, (k, point)| {
            sum + value(k) * (point.weight / weight)
        })
}

/// The first point of the group of each point.
fn firsts(
    points: &[Point],
    distance: f64,
    cancelled: &dyn Fn() -> bool,
) -> Result<Vec<usize>, DeformError> {
    let mut sets: Vec<usize> = (0..points.len()).collect();
    let mut cells: HashMap<[i64; 2], Vec<usize>> = HashMap::new();
    let origin = points
        .iter()
        .fold(Point::new(f64::INFINITY, f64::INFINITY), |o, p| {
            Point::new(o.x.min(p.x), o.y.min(p.y))
        });
    for (index, p) in points.iter().enumerate() {
        let cell = cells
            .entry(cell(*p - origin, CELL_SIDE_SHARE * distance))
            .or_default();
        if let Some(first) = cell.first() {
            join(&mut sets, *first, index);
        }
        cell.push(index);
    }
    for (at, own) in &cells {
        // Each pair of cells once.
        let later = (0..=REACH_CELLS)
            .flat_map(|dx| (-REACH_CELLS..=REACH_CELLS).map(move |dy| [dx, dy]))
            .filter(|step| *step > [0, 0]);
        for other in later.filter_map(|[dx, dy]| cells.get(&[at[0] + dx, at[1] + dy])) {
            join_cells(&mut sets, points, own, other, distance, cancelled)?;
        }
    }
    Ok((0..points.len())
        .map(|index| root(&mut sets, index))
        .collect())
}

/// Joins two cells, each of which is in one set, if a point of one is within `distance` of a point
/// of the other.
fn join_cells(
    sets: &mut [usize],
    points: &[Point],
    own: &[usize],
    other: &[usize],
    distance: f64,
    cancelled: &dyn Fn() -> bool,
) -> Result<(), DeformError> {
    if root(sets, own[0]) == root(sets, other[0]) {
        return Ok(());
    }
    for &i in own {
        if cancelled() {
            return Err(DeformError::Cancelled);
        }
        if other
            .iter()
            .any(|&j| points[i].distance(points[j]) <= distance)
        {
            join(sets, own[0], other[0]);
            return Ok(());
        }
    }
    Ok(())
}

/// The least index of a set is its root.
fn join(sets: &mut [usize], a: usize, b: usize) {
    let (a, b) = (root(sets, a), root(sets, b));
    sets[a.max(b)] = a.min(b);
}

fn root(sets: &mut [usize], mut index: usize) -> usize {
    while sets[index] != index {
        sets[index] = sets[sets[index]];
        index = sets[index];
    }
    index
}

/// The cell of a position relative to the least one of the set: the distance is at least 1e-9 of
/// the set's extent, so there are few cells.
#[expect(clippy::cast_possible_truncation, reason = "at most 1e10")]
fn cell(p: Vec2, side: f64) -> [i64; 2] {
    [(p.x / side).floor() as i64, (p.y / side).floor() as i64]
}

#[cfg(test)]
mod tests {
    use proptest::prelude::*;

    use super::*;
    use crate::deform::ConflictingHandles;

    const NEVER: &dyn Fn() -> bool = &|| false;

    fn by_brute_force(points: &[Point], distance: f64) -> Vec<usize> {
        let mut sets: Vec<usize> = (0..points.len()).collect();
        for (i, p) in points.iter().enumerate() {
            for (j, q) in points[..i].iter().enumerate() {
                if p.distance(*q) <= distance {
                    join(&mut sets, i, j);
                }
            }
        }
        (0..points.len())
            .map(|index| root(&mut sets, index))
            .collect()
    }

    proptest! {
        #[test]
        fn groups_are_those_of_every_pair(
            places in proptest::collection::vec((0..40_i32, 0..40_i32), 0..60),
            side in 0.01..3.0_f64,
            distance in 0.005..6.0_f64,
        ) {
            let points: Vec<Point> = places.iter().map(|&(x, y)| Point::new(
                f64::from(x) * side - 20.0, f64::from(y) * side)).collect();
            prop_assert_eq!(firsts(&points, distance, NEVER).unwrap(),
                by_brute_force(&points, distance));
        }
    }

    #[test]
    fn a_group_is_one_handle_at_the_weighted_mean() {
        let dot = |x: f64| Handle::Point(Point::new(x, 7.0));
        let line = Handle::Polyline(vec![Point::new(0.0, 0.0), Point::new(9.0, 0.0)]);
        let given = Handles::new(
            vec![dot(1.0), line, dot(50.0), dot(3.0)],
            Some(vec![1.0, 2.0, 4.0, 3.0]),
        )
        .unwrap();
        assert!(Groups::find(&given, 1.9, NEVER).unwrap().is_none());
        let (groups, grouped, owners) = Groups::find(&given, 2.0, NEVER).unwrap().unwrap();
        assert_eq!(
            (grouped.handles()[0].places(), grouped.weights()),
            (&[Point::new(2.5, 7.0)][..], &[4.0, 2.0, 4.0][..])
        );
        assert_eq!(
            (groups.handles().collect::<Vec<_>>(), owners),
            (vec![vec![0, 3]], vec![0, 1, 2])
        );
        let d: Vec<Vec2> = (0..5).map(|k| Vec2::new(f64::from(k), 1.0)).collect();
        let mean = groups.displacements(&d);
        assert_eq!(
            mean.iter().map(|d| (d.x, d.y)).collect::<Vec<_>>(),
            [(3.0, 1.0), (1.0, 1.0), (2.0, 1.0), (3.0, 1.0)]
        );
        let mut found = Conflicts::new(1e-6);
        groups.add_conflicts(&mut found, &grouped, &d, &mean, 1e-6);
        let ConflictingHandles { listed, total, .. } = found.finish();
        assert_eq!(
            (total, listed[0].handles.as_slice(), listed[0].spread),
            (1, &[0, 3][..], 3.0)
        );
    }

    #[test]
    fn sets_as_small_as_a_point_are_grouped_far_from_the_origin() {
        for (apart, extent) in [(2e-6, 3e-6), (1e-9, 2e-6), (1.0, 1e6)] {
            let points = [
                Point::new(999_999.0, -999_000.0),
                Point::new(999_999.0 + apart, -999_000.0),
            ];
            for distance in [1e-9 * extent, 0.4 * apart, 2.0 * apart] {
                let joined = points[0].distance(points[1]) <= distance;
                assert_eq!(
                    firsts(&points, distance, NEVER).unwrap(),
                    if joined { [0, 0] } else { [0, 1] },
                    "{apart} {distance}"
                );
            }
        }
    }

    #[test]
    fn no_pair_is_compared_within_one_cell() {
        let points = vec![Point::new(5.0, 5.0); 100_000];
        let asked = std::cell::Cell::new(0);
        let found = firsts(&points, 1000.0, &|| {
            asked.set(asked.get() + 1);
            false
        });
        assert!(found.unwrap().iter().all(|first| *first == 0));
        assert_eq!(asked.get(), 0);
    }
}
