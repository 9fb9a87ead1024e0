//! f of one pose at many positions, and the positions at which it is known.

use std::cell::RefCell;

use super::columns::{Element, PointSource, Rank, RestSegment};
use super::falloff::Falloff;
use super::family::{displacement, rotation};
use super::kernel::{self, LANES};
use super::lanes::{Vertices, gather};
use super::moments::MomentInputs;
use super::rest_deformation::Model;
use super::segment_moments::Workspace;
use super::spline::PosedSpline;
use super::{Handle, IsCancelled, Method, Pose, RestDeformation};
use crate::geometry::{Point, Vec2};

/// Sets of more points are posed by moments where rows are used once.
const MANY_POINTS: usize = 128;
/// The largest alpha at which affine moments are accurate: above it, the weights at most positions
/// differ by more than numbers hold.
const MOST_AFFINE: f64 = 2.0;
/// Columns that [`LANES`] positions are mapped by between two checks of cancellation: some
/// microseconds, with lines a millisecond.
const COLUMNS_BETWEEN_CHECKS: usize = 256;
/// Positions along a segment at which f is compared with the drawn map.
const SEGMENT_SAMPLES: u32 = 5;

/// f of one pose: what does not depend on the position is computed once.
#[derive(Debug)]
pub struct PosedMap<'a> {
    field: &'a RestDeformation,
    pose: &'a Pose,
    spline: Option<PosedSpline<'a>>,
    moments: Option<MomentInputs<'a>>,
}

impl RestDeformation {
    /// f of a pose, for many positions.
    #[must_use]
    pub fn deformation<'a>(&'a self, pose: &'a Pose) -> PosedMap<'a> {
        let spline = self
            .solved()
            .map(|spline| spline.posed(pose.displacements()));
        let moments = if self.prefers_moments() {
            self.moments(pose)
        } else {
            None
        };
        PosedMap {
            field: self,
            pose,
            spline,
            moments,
        }
    }

    /// The moments, if they suffice: points alone, and moving least squares.
    pub(super) fn moments<'a>(&'a self, pose: &'a Pose) -> Option<MomentInputs<'a>> {
        let falloff = self.falloff().filter(|_| self.has_moments())?;
        Some(MomentInputs::new(
            &self.sources.points,
            pose.displacements(),
            falloff,
            self.family,
        ))
    }

    fn has_moments(&self) -> bool {
        // Affine moments of points on nearly one line are accurate only if none of them is much
        // lighter than the others.
        let is_equal = |pair: &[PointSource]| pair[0].mass == pair[1].mass;
        let is_accurate = |falloff: Falloff| {
            falloff.alpha() <= MOST_AFFINE && self.sources.points.windows(2).all(is_equal)
        };
        self.falloff()
            .is_some_and(|falloff| self.family != Method::Affine || is_accurate(falloff))
            && self.sources.segments.is_empty()
            && matches!(self.rank, Rank::Collinear | Rank::Full)
    }

    /// Whether moments take less time than a row that is used once.
    pub(super) fn prefers_moments(&self) -> bool {
        self.handles.columns() > MANY_POINTS && self.has_moments()
    }

    /// f at a position; [`RestDeformation::deformation`] is for many.
    ///
    /// ```
    /// use mlswarp::deform::{Falloff, Handle, Handles, Method, RestDeformation};
    /// use mlswarp::geometry::Point;
    /// let point = |x, y| Handle::Point(Point::new(x, y));
    /// let p = vec![point(10.0, 10.0), point(90.0, 10.0), point(50.0, 80.0)];
    /// let q = [point(10.0, 10.0), point(90.0, 10.0), point(50.0, 60.0)];
    /// let rest = Handles::new(p, None)?;
    /// let f = RestDeformation::new(rest, Method::Rigid, Falloff::new(1.0, false)?, 1.0)?;
    /// // f(p) = q; a position between the handles follows smoothly.
    /// let pose = f.pose(&q)?;
    /// assert_eq!(f.map(&pose, Point::new(50.0, 80.0)), Point::new(50.0, 60.0));
    /// assert!(f.map(&pose, Point::new(50.0, 50.0)).y < 50.0);
    /// # Ok::<(), mlswarp::deform::DeformError>(())
    /// ```
    #[must_use]
    pub fn map(&self, pose: &Pose, place: Point) -> Point {
        self.deformation(pose).map(place)
    }

    /// Calls `look` with positions at which f is known, and their displacements, px: those of
    /// points, and a few of each segment. Positions at which handles contradict each other are left
    /// out. `None` when cancelled.
    pub fn for_each_constraint(
        &self,
        pose: &Pose,
        cancelled: IsCancelled<'_>,
        mut look: impl FnMut(Point, Vec2),
    ) -> Option<()> {
        let approximated = self.achieved_displacements(pose, cancelled)?;
        let mut d = approximated
            .as_deref()
            .unwrap_or(pose.displacements())
            .iter()
            .copied();
        let mut next = || d.next().expect("one column a point, two a segment");
        let mut look = |p: Point, displacement: Vec2| {
            if !pose.conflicts().contains(p) {
                look(p, displacement);
            }
        };
        for handle in self.handles.handles() {
            match handle {
                Handle::Point(p) => look(*p, next()),
                Handle::Polyline(places) => {
                    for ab in places.windows(2) {
                        let (da, db) = (next(), next());
                        for k in 0..SEGMENT_SAMPLES {
                            let t = f64::from(k) / f64::from(SEGMENT_SAMPLES - 1);
                            look(ab[0].lerp(ab[1], t), da * (1.0 - t) + db * t);
                        }
                    }
                }
                Handle::Missing => {}
            }
        }
        Some(())
    }

    /// Calls `look` with the client's points that are one handle with others, where they agree with
    /// them: their own positions, at which f is only approximately known, and their displacements,
    /// px. `None` when cancelled.
    pub fn look_at_grouped_points(
        &self,
        pose: &Pose,
        cancelled: IsCancelled<'_>,
        mut look: impl FnMut(Point, Vec2),
    ) -> Option<()> {
        let Some((given, groups)) = self.grouped.as_deref() else {
            return Some(());
        };
        let approximated = self.achieved_displacements(pose, cancelled)?;
        let d = approximated.as_deref().unwrap_or(pose.displacements());
        for element in &self.elements {
            if let Element::Point { p, column, .. } = element
                && !pose.conflicts().contains(*p)
            {
                groups
                    .handles_of(*column)
                    .for_each(|handle| look(given.handles()[handle].places()[0], d[*column]));
            }
        }
        Some(())
    }

    /// Where f takes the handles, if not to their targets: the displacements of the columns, px.
    /// The outer `None`: cancelled.
    #[must_use]
    pub fn achieved_displacements(
        &self,
        pose: &Pose,
        cancelled: IsCancelled<'_>,
    ) -> Option<Option<Vec<Vec2>>> {
        let interpolates = match &self.model {
            Model::MovingLeastSquares { .. } => true,
            Model::ThinPlateSpline { spline, .. } => {
                spline.as_ref().is_none_or(|spline| spline.interpolates())
            }
            Model::GlobalAffine { map, .. } => map.is_none(),
        };
        if interpolates {
            return Some(None);
        }
        let places = self.elements.iter().flat_map(|element| match element {
            Element::Point { p, .. } => [Some(*p), None],
            Element::Segment(RestSegment { a, b, .. }) => [Some(*a), Some(*b)],
        });
        let places: Vec<Point> = places.flatten().collect();
        let mapped = self.deformation(pose).map_all(&places, cancelled)?;
        Some(Some(
            mapped
                .into_iter()
                .zip(places)
                .map(|(mapped, place)| mapped - place)
                .collect(),
        ))
    }
}

impl PosedMap<'_> {
    pub(super) fn columns(&self) -> usize {
        self.field.handles.columns()
    }

    /// f at a position, in f64 by the quadrature nodes: the definition, not the grid.
    #[must_use]
    pub fn map(&self, place: Point) -> Point {
        thread_local!(static WORKSPACE: RefCell<Workspace<1>> = RefCell::new(Workspace::new(0)));
        WORKSPACE.with_borrow_mut(|workspace| {
            let columns = self.field.handles.columns();
            workspace.rows.h.resize(columns, [[0.0]; 2]);
            workspace.rows.wn.resize(columns, [0.0]);
            let [[x], [y]] = self.displacements(&Vertices::all(place), true, workspace).0;
            place + Vec2::new(x, y)
        })
    }

    /// f at many positions: the same bits as [`PosedMap::map`], several times as fast. `None`
    /// when cancelled.
    #[must_use]
    pub fn map_all(&self, places: &[Point], cancelled: IsCancelled<'_>) -> Option<Vec<Point>> {
        let mut workspace = Workspace::new(self.columns());
        let mut mapped = Vec::with_capacity(places.len());
        for places in places.chunks(LANES * (COLUMNS_BETWEEN_CHECKS / self.columns().max(1)).max(1))
        {
            if cancelled() {
                return None;
            }
            places
                .chunks(LANES)
                .for_each(|places| mapped.extend(self.map_block(places, &mut workspace)));
        }
        Some(mapped)
    }

    /// f at up to [`LANES`] positions.
    pub(super) fn map_block(
        &self,
        places: &[Point],
        workspace: &mut Workspace<LANES>,
    ) -> Vec<Point> {
        let v = gather(|lane| places[lane.min(places.len() - 1)]);
        let ([x, y], _) = self.displacements(&v, true, workspace);
        places
            .iter()
            .enumerate()
            .map(|(k, place)| *place + Vec2::new(x[k], y[k]))
            .collect()
    }

    /// `f(v) - v` of N vertices, px, and the least |m| (rigid), else 1. `exact`: quadrature nodes
    /// throughout.
    pub(super) fn displacements<const N: usize>(
        &self,
        v: &Vertices<N>,
        exact: bool,
        workspace: &mut Workspace<N>,
    ) -> ([[f64; N]; 2], f32) {
        if let Some(spline) = &self.spline {
            return (spline.displacements(v), 1.0);
        }
        if let (false, Some(moments)) = (exact, &self.moments) {
            let (moved, rotation) = kernel::moments(moments, v);
            #[expect(
                clippy::cast_possible_truncation,
                reason = "a quality number, compared with 0.1"
            )]
            let least = rotation.into_iter().fold(f64::INFINITY, f64::min) as f32;
            return (moved, least);
        }
        self.field.rows(v, exact, workspace);
        let (family, d, rows) = (
            self.field.family,
            self.pose.displacements(),
            &workspace.rows,
        );
        let ([mut x, mut y], mut least) = ([[0.0; N]; 2], f32::INFINITY);
        for (k, (x, y)) in x.iter_mut().zip(&mut y).enumerate() {
            let moved = displacement(family, rows, k, d);
            (*x, *y) = (moved.x, moved.y);
            least = least.min(rotation(family, rows, k, d));
        }
        ([x, y], least)
    }
}
