//! Coincidences of handles at rest: coincident points, points on segments, segments that touch,
//! cross or overlap. They are found once for a set of handles (`search.rs`). Each pose then only
//! compares the two targets of every coincidence: where they differ, f is discontinuous
//! (mathematics section 6).

mod search;
#[cfg(test)]
mod tests;

use std::collections::HashSet;

use super::DeformError;
use super::columns::Element;
use super::conflicts::{Conflicts, Member};
use crate::geometry::{Point, Vec2};
use search::CoincidenceSearch;

/// Targets further apart than this share of the extent contradict each other.
const CONFLICT_SHARE: f64 = 1e-6;
/// The ratio of the targets' distance to the rest distance from which a warning is given.
const NEAR_FACTOR: f64 = 10.0;

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
