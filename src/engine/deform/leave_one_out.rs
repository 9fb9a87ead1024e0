//! How well a method predicts a handle from all others (mathematics 10.4): each handle is left out
//! of the set, and the map of the rest is asked for its position. Points only. Moving least squares
//! and the global affine map need one row for each handle, O(n^2) in all; the spline one
//! factorisation, and one substitution for each handle, O(n^3). Lengths are measured as in the
//! whole set.

use std::cell::RefCell;

use rayon::prelude::*;

use super::columns::{HandleElements, PointSource, Rank, rank};
use super::family::displacement;
use super::global_affine::GlobalAffine;
use super::groups::coincidence_distance;
use super::kernel;
use super::lanes::Vertices;
use super::rest_deformation::{Model, RestDeformation};
use super::row::RowInputs;
use super::segment_moments::Workspace;
use super::spline::Sites;
use super::{Handle, Handles, IsCancelled, Method, Pose};
use crate::geometry::{Point, Vec2};

/// The points of a set without one.
struct Rest {
    sources: HandleElements,
    rank: Rank,
}

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
        let closed = match &self.model {
            Model::ThinPlateSpline {
                spline: Some(spline),
                ..
            } => {
                let of_sites = spline.left_out(d, cancelled)?;
                let mut closed = vec![Vec2::ZERO; d.len()];
                spline
                    .members()
                    .for_each(|(column, site)| closed[column] = of_sites[site]);
                Some(closed)
            }
            _ => None,
        };
        let residual = |index: usize| {
            if cancelled() {
                return None;
            }
            let rest = self.without(index);
            match &closed {
                Some(closed) if rest.rank == self.rank => Some(closed[index]),
                _ => Some(d[index] - self.predicted(&rest, index, d, cancelled)?),
            }
        };
        (0..d.len()).into_par_iter().map(residual).collect()
    }

    fn without(&self, index: usize) -> Rest {
        let points: Vec<PointSource> = self
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
        Rest {
            sources: HandleElements {
                points,
                segments: Vec::new(),
            },
            rank,
        }
    }

    /// The displacement of a point by the map of the rest, px. `None` when cancelled.
    fn predicted(
        &self,
        Rest { sources, rank }: &Rest,
        index: usize,
        d: &[Vec2],
        cancelled: IsCancelled<'_>,
    ) -> Option<Vec2> {
        let place = self.place(index);
        let line = match rank {
            Rank::Empty | Rank::OnePlace => return Some(mean(&sources.points, d)),
            Rank::Collinear => true,
            Rank::Full => false,
        };
        let family = if line && self.family == Method::Affine {
            Method::Similarity
        } else {
            self.family
        };
        if let Model::ThinPlateSpline {
            smoothing,
            spline: Some(spline),
        } = &self.model
        {
            let sites = Sites::of(&sources.points, coincidence_distance(self.handles.extent()));
            let [[x], [y]] = spline
                .of_part(sites, line, *smoothing, cancelled)?
                .posed(d)
                .displacements(&Vertices::all(place));
            return Some(Vec2::new(x, y));
        }
        thread_local!(static WORKSPACE: RefCell<Workspace<1>> = RefCell::new(Workspace::new(0)));
        WORKSPACE.with_borrow_mut(|Workspace { rows, scratch }| {
            rows.h.resize(d.len(), [[0.0]; 2]);
            rows.wn.resize(d.len(), [0.0]);
            (rows.h[index], rows.wn[index]) = ([[0.0]; 2], [0.0]);
            match &self.model {
                Model::MovingLeastSquares {
                    falloff,
                    point_mass,
                    ..
                } => {
                    let (extent, falloff, point_mass) =
                        (self.handles.extent(), *falloff, *point_mass);
                    let inputs = RowInputs {
                        sources,
                        extent,
                        falloff,
                        beta: None,
                        point_mass,
                        method: family,
                        exact: true,
                    };
                    kernel::rows(&inputs, &Vertices::all(place), scratch, rows);
                }
                _ => GlobalAffine::new(sources, line).rows(&Vertices::all(place), rows),
            }
            Some(displacement(family, rows, 0, d))
        })
    }

    fn place(&self, index: usize) -> Point {
        // Of points alone, in the order of their columns: handles that are missing have none.
        self.sources.points[index].p
    }
}

/// The mean displacement, weighted by mass.
fn mean(points: &[PointSource], d: &[Vec2]) -> Vec2 {
    let total: f64 = points.iter().map(|source| source.mass).sum();
    points.iter().fold(Vec2::ZERO, |sum, source| {
        sum + d[source.column] * (source.mass / total)
    })
}
