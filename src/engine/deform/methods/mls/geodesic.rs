//! Moving least squares inside a mask: a handle weighs by the length of the shortest path to it
//! (mathematics 11.3). Handles act on their own part of the subject alone, so each part has a set
//! of its own, with its own degeneracies.

use std::sync::Arc;

use crate::parallel::prelude::*;

use super::MovingLeastSquares;
use super::determined;
use super::falloff::Falloff;
use super::metric::Metric;
use super::row::RowInputs;
use super::segments::View;
use crate::deform::columns::{HandleElements, PointSource, Rank, RestSegment, rank};
use crate::deform::form::CoefficientForm;
use crate::deform::kernel;
use crate::deform::lanes::{ON_PLANE, Vertices};
use crate::deform::point_map::{CoefficientsOf, Identity, PointMap, RestSet};
use crate::deform::workspace::Workspace;
use crate::deform::{DeformError, Handle, Handles, IsCancelled, Warning};
use crate::geometry::Point;
use crate::topology::{Distances, Mask, NoNodes, Nodes, PathOrigin};

/// A position farther from the mask than this belongs to no part, px.
const BESIDE_MASK: f64 = 16.0;
/// In the keys of plans and rest handles, beyond those of the plane.
const KEY: u64 = 32;

/// The map of points inside a mask.
#[derive(Debug)]
pub(in crate::deform) struct GeodesicLeastSquares {
    falloff: Falloff,
    point_mass: f64,
    nodes: Arc<Nodes>,
    /// From each point of the set.
    distances: Vec<Distances>,
    parts: Vec<MaskPart>,
}

/// The points of a part of the subject.
#[derive(Debug)]
struct MaskPart {
    set: RestSet,
    /// The number of each point in the whole set.
    members: Vec<usize>,
}

/// The distances of one position from the points of its part, squared.
#[derive(Clone, Copy)]
struct Geodesic<'a>(&'a [f64]);

impl Metric for Geodesic<'_> {
    #[inline(always)]
    fn squared<const N: usize>(&self, index: usize, _p: Point, _v: &Vertices<N>) -> [f64; N] {
        [self.0[index]; N]
    }

    #[inline(always)]
    fn view<const N: usize>(&self, _index: usize, s: &RestSegment, v: &Vertices<N>) -> View<N> {
        View::new(s, v)
    }
}

impl GeodesicLeastSquares {
    /// The map of the points of a set, which weigh as in the plane, inside a mask; and the form of
    /// its coefficients. `handle_of`: the client's handle of each point. `most_bytes`: for the
    /// distances.
    pub(in crate::deform) fn new(
        set: &RestSet,
        form: CoefficientForm,
        (falloff, point_mass): (Falloff, f64),
        mask: &Arc<Mask>,
        handle_of: &(dyn Fn(usize) -> usize + Sync),
        most_bytes: u64,
        cancelled: IsCancelled<'_>,
    ) -> Result<(Self, CoefficientForm, Vec<Warning>), DeformError> {
        if mask.inside() == 0 {
            return Err(DeformError::EmptyMask);
        }
        let points = &set.sources.points;
        let per_node = Distances::bytes_for(1) * points.len() as u64 + Nodes::bytes_for(1);
        let most = usize::try_from(most_bytes / per_node).unwrap_or(usize::MAX);
        let nodes = Nodes::new(Arc::clone(mask), Nodes::stride_of(mask), most, cancelled);
        let nodes = Arc::new(nodes.map_err(|none| match none {
            NoNodes::TooMany(nodes) => DeformError::MaskTooLarge {
                limit: most_bytes,
                bytes: nodes.saturating_mul(per_node),
            },
            NoNodes::Cancelled => DeformError::Cancelled,
        })?);
        let from = |(index, point): (usize, &PointSource)| {
            let distances = Distances::new(&nodes, PathOrigin::Point(point.p), cancelled);
            let handle = handle_of(index);
            let distances = distances.map_err(|_| DeformError::OutsideMask { handle })?;
            distances.ok_or(DeformError::Cancelled)
        };
        let distances: Result<Vec<_>, _> = points.par_iter().enumerate().map(from).collect();
        let mut map = Self {
            falloff,
            point_mass,
            nodes,
            distances: distances?,
            parts: Vec::new(),
        };
        let (form, warnings) = map.find_parts(set, form)?;
        Ok((map, form, warnings))
    }

    /// Divides the points among the parts; returns the form that has all of their coefficients.
    fn find_parts(
        &mut self,
        set: &RestSet,
        wanted: CoefficientForm,
    ) -> Result<(CoefficientForm, Vec<Warning>), DeformError> {
        let mask = self.nodes.mask();
        let mut members: Vec<Vec<usize>> = Vec::new();
        for (index, point) in set.sources.points.iter().enumerate() {
            let pixel = mask.pixel_at(point.p, BESIDE_MASK).unwrap_or_default();
            let reaches =
                |part: &&mut Vec<usize>| self.distances[part[0]].reaches(pixel.0, pixel.1);
            match members.iter_mut().find(reaches) {
                Some(part) => part.push(index),
                None => members.push(vec![index]),
            }
        }
        let (mut form, mut warnings) = (wanted, Vec::new());
        for members in members {
            let points: Vec<_> = members.iter().map(|k| set.sources.points[*k]).collect();
            let places = points.iter().map(|point| Handle::Point(point.p)).collect();
            let handles = Handles::new(places, None)?;
            let rank = rank(&handles);
            let (own, of_part) = determined(wanted, rank);
            if own != wanted {
                // A complex number holds a real one.
                form = own;
            }
            // That a part has one handle is usual.
            warnings.extend(of_part.into_iter().filter(|_| rank != Rank::OnePlace));
            self.parts.push(MaskPart {
                set: RestSet {
                    sources: HandleElements {
                        points,
                        segments: Vec::new(),
                    },
                    rank,
                    form: own,
                    extent: handles.extent(),
                },
                members,
            });
        }
        warnings.dedup();
        Ok((form, warnings))
    }

    /// The pixel inside the mask to which a position belongs.
    fn pixel(&self, v: Point, given: u32) -> Option<(usize, usize)> {
        let mask = self.nodes.mask();
        match given {
            ON_PLANE => mask.pixel_at(v, BESIDE_MASK),
            given => {
                let pixel = (
                    given as usize % mask.size().0,
                    given as usize / mask.size().0,
                );
                mask.is_inside(pixel.0, pixel.1).then_some(pixel)
            }
        }
    }

    /// The coefficients of one position in `workspace`; `None` if it is at rest in every pose.
    fn one(
        &self,
        v: Point,
        pixel: u32,
        exact: bool,
        workspace: &mut Workspace<1>,
    ) -> Option<&MaskPart> {
        let pixel = self.pixel(v, pixel)?;
        let reaches = |part: &&MaskPart| self.distances[part.members[0]].reaches(pixel.0, pixel.1);
        let part = self.parts.iter().find(reaches)?;
        if matches!(part.set.rank, Rank::Empty | Rank::OnePlace) {
            return Some(part);
        }
        let distances = part.members.iter().map(|k| self.distances[*k].at(pixel, v));
        let squared: Vec<f64> = distances.map(|distance| distance * distance).collect();
        let Workspace { rows, scratch } = workspace;
        let inputs = RowInputs {
            metric: Geodesic(&squared),
            sources: &part.set.sources,
            extent: part.set.extent,
            falloff: self.falloff,
            beta: None,
            point_mass: self.point_mass,
            form: part.set.form,
            exact,
        };
        kernel::rows(&inputs, &Vertices::all(v), scratch, rows);
        Some(part)
    }
}

impl<const N: usize> CoefficientsOf<N> for GeodesicLeastSquares {
    fn coefficients(
        &self,
        _set: &RestSet,
        v: &Vertices<N>,
        exact: bool,
        workspace: &mut Workspace<N>,
    ) {
        let rows = &mut workspace.rows;
        rows.clear();
        let mut single = Workspace::<1>::new(rows.h.len());
        for lane in 0..N {
            let at = Point::new(v.x[lane], v.y[lane]);
            let Some(part) = self.one(at, v.pixel[lane], exact, &mut single) else {
                continue;
            };
            let points = &part.set.sources.points;
            let is_rigid = part.set.form == CoefficientForm::Rigid;
            if part.set.rank == Rank::OnePlace {
                // A translation, by the mean of the handles.
                let total: f64 = points.iter().map(|point| point.mass).sum();
                for point in points {
                    let share = point.mass / total;
                    if is_rigid {
                        rows.wn[point.column][lane] = share;
                    } else {
                        rows.h[point.column][0][lane] = share;
                    }
                }
                continue;
            }
            for point in points {
                let column = point.column;
                rows.h[column][0][lane] = single.rows.h[column][0][0];
                if part.set.form != CoefficientForm::Real {
                    rows.h[column][1][lane] = single.rows.h[column][1][0];
                }
                if is_rigid {
                    rows.wn[column][lane] = single.rows.wn[column][0];
                }
            }
            if is_rigid {
                (rows.e[0][lane], rows.e[1][lane]) = (single.rows.e[0][0], single.rows.e[1][0]);
            }
        }
    }
}

impl PointMap for GeodesicLeastSquares {
    fn identity(&self, form: CoefficientForm) -> Identity {
        Identity {
            plan: KEY + form as u64,
            rest: KEY + form as u64,
            numbers: vec![self.falloff.alpha()],
        }
    }

    fn is_smooth(&self, _set: &RestSet) -> bool {
        false
    }

    fn of_part(&self, _part: &RestSet, _cancelled: IsCancelled<'_>) -> Option<Arc<dyn PointMap>> {
        // Methods are compared in the plane, where every handle acts on every other one.
        Some(Arc::new(MovingLeastSquares {
            falloff: self.falloff,
            point_mass: self.point_mass,
            beta: None,
        }))
    }

    fn operations(&self, columns: u64) -> u64 {
        // A distance takes about a hundred times as long as one in the plane.
        100 * columns
    }
}
