//! How well a method predicts a handle from all others (mathematics 10.4): each handle is left out
//! of the set, and the map of the rest is asked for its position. Points only. Moving least squares
//! and the global affine map need one row for each handle, O(n^2) in all; the spline one
//! factorisation, and one substitution for each handle, O(n^3). Lengths are measured as in the
//! whole set.

use std::cell::RefCell;

use crate::parallel::prelude::*;

use super::columns::{HandleElements, PointSource, Rank, rank};
use super::form::{CoefficientForm, displacement};
use super::lanes::Vertices;
use super::point_map::RestSet;
use super::rest_deformation::RestDeformation;
use super::workspace::Workspace;
use super::{Handle, Handles, IsCancelled, Pose};
use crate::geometry::{Point, Vec2};

impl RestDeformation {
    /// The column of the grouped set to which each of the client's points belongs.
    #[must_use]
    pub fn grouped_columns(&self) -> Vec<usize> {
        self.grouped.as_ref().map_or_else(
            || (0..self.handles.columns()).collect(),
            |grouped| grouped.1.columns(),
        )
    }

    /// For each point (coincident ones are one), its posed position less the one that the map of
    /// all others predicts, px. CPU work, in parallel on the current rayon pool. `None` when
    /// cancelled.
    ///
    /// # Panics
    /// If a handle is a line, or there are fewer than two points.
    #[must_use]
    pub fn leave_one_out(&self, pose: &Pose, cancelled: IsCancelled<'_>) -> Option<Vec<Vec2>> {
        let d = pose.displacements();
        assert!(
            !self.handles.has_lines() && d.len() > 1,
            "at least two points"
        );
        let closed = self.map.left_out(d, cancelled)?;
        let residual = |index: usize| {
            if cancelled() {
                return None;
            }
            let rest = self.without(index);
            match &closed {
                Some(closed) if rest.rank == self.set.rank => Some(closed[index]),
                _ => Some(d[index] - self.predicted(&rest, index, d, cancelled)?),
            }
        };
        (0..d.len()).into_par_iter().map(residual).collect()
    }

    /// The points without one.
    fn without(&self, index: usize) -> RestSet {
        let points: Vec<PointSource> = self
            .set
            .sources
            .points
            .iter()
            .copied()
            .filter(|source| source.column != index)
            .collect();
        let handles = points
            .iter()
            .map(|source| Handle::Point(source.p))
            .collect();
        let rank = rank(&Handles::of_valid(handles, vec![1.0; points.len()]));
        let form = match (rank, self.set.form) {
            (Rank::Collinear, CoefficientForm::Real) => CoefficientForm::Complex,
            (_, form) => form,
        };
        RestSet {
            sources: HandleElements {
                points,
                segments: Vec::new(),
            },
            rank,
            form,
            // Lengths are measured as in the whole set.
            extent: self.set.extent,
        }
    }

    /// The displacement of a point by the map of the rest, px. `None` when cancelled.
    fn predicted(
        &self,
        rest: &RestSet,
        index: usize,
        d: &[Vec2],
        cancelled: IsCancelled<'_>,
    ) -> Option<Vec2> {
        if let Rank::Empty | Rank::OnePlace = rest.rank {
            return Some(mean(&rest.sources.points, d));
        }
        let (v, map) = (
            Vertices::<1>::all(self.place(index)),
            self.map.of_part(rest, cancelled)?,
        );
        let direct = map.posed(rest, d, true);
        if let Some(([[x], [y]], _)) = direct.and_then(|posed| posed.displacements(&v)) {
            return Some(Vec2::new(x, y));
        }
        thread_local!(static WORKSPACE: RefCell<Workspace<1>> = RefCell::new(Workspace::new(0)));
        WORKSPACE.with_borrow_mut(|workspace| {
            let rows = &mut workspace.rows;
            rows.h.resize(d.len(), [[0.0]; 2]);
            rows.wn.resize(d.len(), [0.0]);
            (rows.h[index], rows.wn[index]) = ([[0.0]; 2], [0.0]);
            map.coefficients(rest, &v, true, workspace);
            Some(displacement(rest.form, &workspace.rows, 0, d))
        })
    }

    fn place(&self, index: usize) -> Point {
        // Of points alone, in the order of their columns: handles that are missing have none.
        self.set.sources.points[index].p
    }
}

/// The mean displacement, weighted by mass.
fn mean(points: &[PointSource], d: &[Vec2]) -> Vec2 {
    let total: f64 = points.iter().map(|source| source.mass).sum();
    points.iter().fold(Vec2::ZERO, |sum, source| {
        sum + d[source.column] * (source.mass / total)
    })
}
