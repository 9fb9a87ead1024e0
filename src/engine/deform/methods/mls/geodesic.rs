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
use crate::deform::columns::{HandleElements, Rank, rank};
use crate::deform::form::CoefficientForm;
use crate::deform::kernel;
use crate::deform::lanes::{ON_PLANE, Vertices};
use crate::deform::point_map::{CoefficientsOf, Identity, PointMap, RestSet};
use crate::deform::workspace::Workspace;
use crate::deform::{DeformError, Handle, Handles, IsCancelled, Warning};
use crate::geometry::Point;
use crate::topology::{Distances, Mask, NoNodes, Nodes, POSITION_TO_MASK_PX, PathOrigin, Sights};

/// In the keys of plans and rest handles, beyond those of the plane.
const KEY: u64 = 32;

/// The map of handles inside a mask.
#[derive(Debug)]
pub(in crate::deform) struct GeodesicLeastSquares {
    falloff: Falloff,
    point_mass: f64,
    nodes: Arc<Nodes>,
    /// From each point of the set, then from each segment.
    distances: Vec<Distances>,
    parts: Vec<MaskPart>,
}

/// The handles of a part of the subject.
#[derive(Debug)]
struct MaskPart {
    set: RestSet,
    /// The number of each point and segment in the whole set.
    members: Vec<usize>,
    /// Columns of its coefficients.
    columns: Vec<usize>,
}

/// The distances of one position from the points of its part and then from its segments, squared.
#[derive(Clone, Copy)]
struct Geodesic<'a> {
    points: &'a [f64],
    segments: &'a [f64],
}

impl Metric for Geodesic<'_> {
    #[inline(always)]
    fn squared_of_point<const N: usize>(
        &self,
        index: usize,
        _p: Point,
        _v: &Vertices<N>,
    ) -> [f64; N] {
        [self.points[index]; N]
    }

    #[inline(always)]
    fn squared_of_segment<const N: usize>(&self, index: usize, _view: &View<N>) -> [f64; N] {
        [self.segments[index]; N]
    }

    #[inline(always)]
    fn r2min_of_segment<const N: usize>(
        &self,
        index: usize,
        view: &View<N>,
        r2min: &[f64; N],
    ) -> [f64; N] {
        let mut relative = *r2min;
        for (relative, r2) in relative.iter_mut().zip(view.r2) {
            *relative *= r2 / self.segments[index];
        }
        relative
    }
}

impl GeodesicLeastSquares {
    /// The map of the handles of a set, which weigh as in the plane, inside a mask; and the form of
    /// its coefficients. `handle_of`: the client's handle of each point, then of each segment.
    /// The limits are those of the distances, in bytes and operations.
    pub(in crate::deform) fn new(
        set: &RestSet,
        form: CoefficientForm,
        (falloff, point_mass): (Falloff, f64),
        mask: &Arc<Mask>,
        handle_of: &(dyn Fn(usize) -> usize + Sync),
        (most_bytes, most_operations): (u64, u64),
        cancelled: IsCancelled<'_>,
    ) -> Result<(Self, CoefficientForm, Vec<Warning>), DeformError> {
        if mask.inside() == 0 {
            return Err(DeformError::EmptyMask);
        }
        let origins = origins(&set.sources);
        let per_node = Distances::bytes_for(1) * origins.len() as u64 + Nodes::bytes_for(1);
        let most = usize::try_from(most_bytes / per_node).unwrap_or(usize::MAX);
        let nodes = Nodes::new(Arc::clone(mask), Nodes::stride_of(mask), most, cancelled);
        let nodes = Arc::new(nodes.map_err(|none| match none {
            NoNodes::TooMany(nodes) => DeformError::MaskTooLarge {
                limit: most_bytes,
                bytes: nodes.saturating_mul(per_node),
            },
            NoNodes::Cancelled => DeformError::Cancelled,
        })?);
        let operations = Distances::operations(&nodes).saturating_mul(origins.len() as u64);
        if operations > most_operations {
            return Err(DeformError::MaskTooWinding {
                limit: most_operations,
                operations,
            });
        }
        let from = |(index, origin): (usize, &PathOrigin)| {
            let distances = Distances::new(&nodes, *origin, cancelled);
            let handle = handle_of(index);
            let distances = distances.map_err(|_| DeformError::OutsideMask { handle })?;
            distances.ok_or(DeformError::Cancelled)
        };
        let distances: Result<Vec<_>, _> = origins.par_iter().enumerate().map(from).collect();
        let mut map = Self {
            falloff,
            point_mass,
            nodes,
            distances: distances?,
            parts: Vec::new(),
        };
        let (form, warnings) = map.find_parts(set, form, cancelled)?;
        Ok((map, form, warnings))
    }

    /// Divides the points among the parts; returns the form that has all of their coefficients. At
    /// worst O(points^2), if each is in a part of its own.
    fn find_parts(
        &mut self,
        set: &RestSet,
        wanted: CoefficientForm,
        cancelled: IsCancelled<'_>,
    ) -> Result<(CoefficientForm, Vec<Warning>), DeformError> {
        let mask = self.nodes.mask();
        let mut members: Vec<Vec<usize>> = Vec::new();
        for (index, origin) in origins(&set.sources).iter().enumerate() {
            if cancelled() {
                return Err(DeformError::Cancelled);
            }
            let (PathOrigin::Point(at) | PathOrigin::Segment(at, _)) = *origin;
            let pixel = mask.pixel_at(at, POSITION_TO_MASK_PX).unwrap_or_default();
            let reaches =
                |part: &&mut Vec<usize>| self.distances[part[0]].reaches(pixel.0, pixel.1);
            match members.iter_mut().find(reaches) {
                Some(part) => part.push(index),
                None => members.push(vec![index]),
            }
        }
        let (mut form, mut warnings) = (wanted, Vec::new());
        for members in members {
            if cancelled() {
                return Err(DeformError::Cancelled);
            }
            let sources = part_of(&set.sources, &members);
            let places = sources.points.iter().map(|point| Handle::Point(point.p));
            let lines = sources.segments.iter();
            let lines = lines.map(|segment| Handle::Polyline(vec![segment.a, segment.b]));
            let handles = Handles::new(places.chain(lines).collect(), None)?;
            let rank = rank(&handles);
            let (own, of_part) = determined(wanted, rank);
            if own != wanted {
                // A complex number holds a real one.
                form = own;
            }
            // That a part has one handle is usual.
            warnings.extend(of_part.into_iter().filter(|_| rank != Rank::OnePlace));
            let ends = sources.segments.iter();
            let ends = ends.flat_map(|segment| [segment.column, segment.column + 1]);
            self.parts.push(MaskPart {
                columns: sources
                    .points
                    .iter()
                    .map(|point| point.column)
                    .chain(ends)
                    .collect(),
                set: RestSet {
                    sources,
                    rank,
                    form: own,
                    extent: handles.extent(),
                },
                members,
            });
        }
        if !set.sources.segments.is_empty() && self.falloff.alpha() < 1.0 {
            warnings.push(Warning::LineAlphaBelowOne);
        }
        warnings.sort_unstable();
        warnings.dedup();
        Ok((form, warnings))
    }

    /// The pixel inside the mask to which a position belongs.
    fn pixel(&self, v: Point, given: u32) -> Option<(usize, usize)> {
        let mask = self.nodes.mask();
        match given {
            ON_PLANE => mask.pixel_at(v, POSITION_TO_MASK_PX),
            given => {
                let pixel = (
                    given as usize % mask.size().0,
                    given as usize / mask.size().0,
                );
                mask.is_inside(pixel.0, pixel.1).then_some(pixel)
            }
        }
    }

    /// The coefficients of one position in `workspace`, of the form of its part or a `given` one;
    /// `None` if it is at rest in every pose.
    fn one(
        &self,
        (v, pixel): (Point, u32),
        given: Option<CoefficientForm>,
        exact: bool,
        (workspace, sights): (&mut Workspace<1>, &mut Sights),
    ) -> Option<&MaskPart> {
        let pixel = self.pixel(v, pixel)?;
        let reaches = |part: &&MaskPart| self.distances[part.members[0]].reaches(pixel.0, pixel.1);
        let part = self.parts.iter().find(reaches)?;
        if matches!(part.set.rank, Rank::Empty | Rank::OnePlace) {
            return Some(part);
        }
        let members = part.members.iter().map(|k| &self.distances[*k]);
        let distances = members.map(|from| from.at(pixel, v, sights));
        let squared: Vec<f64> = distances.map(|distance| distance * distance).collect();
        let Workspace { rows, scratch } = workspace;
        let (points, segments) = squared.split_at(part.set.sources.points.len());
        let inputs = RowInputs {
            metric: Geodesic { points, segments },
            sources: &part.set.sources,
            extent: part.set.extent,
            falloff: self.falloff,
            beta: None,
            point_mass: self.point_mass,
            form: given.unwrap_or(part.set.form),
            exact,
        };
        kernel::rows(&inputs, &Vertices::all(v), scratch, rows);
        Some(part)
    }
}

/// What distances are measured from: the points of a set, then its segments.
fn origins(sources: &HandleElements) -> Vec<PathOrigin> {
    let points = sources
        .points
        .iter()
        .map(|point| PathOrigin::Point(point.p));
    let segments = sources.segments.iter();
    let segments = segments.map(|segment| PathOrigin::Segment(segment.a, segment.b));
    points.chain(segments).collect()
}

/// The points and segments of these numbers, which ascend.
fn part_of(sources: &HandleElements, members: &[usize]) -> HandleElements {
    let points = sources.points.len();
    let mut part = HandleElements::default();
    for &member in members {
        match member.checked_sub(points) {
            None => part.points.push(sources.points[member]),
            Some(segment) => part.segments.push(sources.segments[segment]),
        }
    }
    part
}

impl GeodesicLeastSquares {
    /// The coefficients of N positions, of the form of their parts or of a `given` one.
    fn rows<const N: usize>(
        &self,
        given: Option<CoefficientForm>,
        v: &Vertices<N>,
        exact: bool,
        workspace: &mut Workspace<N>,
    ) {
        let rows = &mut workspace.rows;
        rows.clear();
        let (mut single, mut sights) = (Workspace::<1>::new(rows.h.len()), Sights::default());
        for lane in 0..N {
            let at = Point::new(v.x[lane], v.y[lane]);
            let at = (at, v.pixel[lane]);
            let Some(part) = self.one(at, given, exact, (&mut single, &mut sights)) else {
                continue;
            };
            let points = &part.set.sources.points;
            let form = given.unwrap_or(part.set.form);
            let is_rigid = form == CoefficientForm::Rigid;
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
            for &column in &part.columns {
                rows.h[column][0][lane] = single.rows.h[column][0][0];
                if form != CoefficientForm::Real {
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

impl<const N: usize> CoefficientsOf<N> for GeodesicLeastSquares {
    fn coefficients(
        &self,
        _set: &RestSet,
        v: &Vertices<N>,
        exact: bool,
        workspace: &mut Workspace<N>,
    ) {
        self.rows(None, v, exact, workspace);
    }

    fn weights(&self, _set: &RestSet, v: &Vertices<N>, workspace: &mut Workspace<N>) {
        self.rows(Some(CoefficientForm::Rigid), v, false, workspace);
    }
}

impl PointMap for GeodesicLeastSquares {
    fn has_weights(&self) -> bool {
        true
    }

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
        // A distance takes about a hundred times as long as one in the plane, and the steps of some
        // lines of sight.
        columns.saturating_mul(100 + self.nodes.mask().sight_steps())
    }
}
