//! f of one pose at many positions, and the positions at which it is known.

use std::borrow::Cow;
use std::cell::RefCell;

use super::coefficient_table::{PoseQuality, to_f32};
use super::columns::{Element, Rank, RestSegment};
use super::form::{displacement, rotation};
use super::lanes::{LANES, Vertices, gather};
use super::point_map::{
    CoefficientsOf, Displacements, DisplacementsOf, PointMap, PosedWithoutCoefficients,
};
use super::workspace::Workspace;
use super::{IsCancelled, Pose, RestDeformation};
use crate::geometry::{Grid, Mesh, Point, Vec2};
use crate::parallel::prelude::*;

/// Columns that [`LANES`] positions are mapped by between two checks of cancellation: some
/// microseconds, with lines a millisecond.
pub(super) const COLUMNS_BETWEEN_CHECKS: usize = 256;
/// Positions along a segment at which f is compared with the drawn map.
const SEGMENT_SAMPLES: u32 = 5;

/// f of one pose: what does not depend on the position is computed once.
#[derive(Debug)]
pub struct PosedMap<'a> {
    field: &'a RestDeformation,
    /// What coefficients multiply.
    terms: Cow<'a, [Vec2]>,
    without_coefficients: Option<Box<dyn PosedWithoutCoefficients + 'a>>,
}

impl RestDeformation {
    /// f of a pose, for many positions.
    #[must_use]
    pub fn deformation<'a>(&'a self, pose: &'a Pose) -> PosedMap<'a> {
        PosedMap::of_displacements(self, pose.displacements())
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
        let mut places = Vec::with_capacity(self.elements.len());
        for element in &self.elements {
            match element {
                Element::Point { p, column, .. } => {
                    places.push((*p, pose.displacements()[*column]))
                }
                Element::Segment(RestSegment { a, b, column, .. }) => {
                    let d = &pose.displacements()[*column..][..2];
                    places.extend((0..SEGMENT_SAMPLES).map(|k| {
                        let t = f64::from(k) / f64::from(SEGMENT_SAMPLES - 1);
                        (a.lerp(*b, t), d[0] * (1.0 - t) + d[1] * t)
                    }));
                }
            }
        }
        if !self.interpolates() {
            // Between the ends f need not be linear where it does not meet the handles.
            let positions: Vec<Point> = places.iter().map(|(p, _)| *p).collect();
            let mapped = self.deformation(pose).map_all(&positions, cancelled)?;
            for ((p, d), mapped) in places.iter_mut().zip(mapped) {
                *d = mapped - *p;
            }
        }
        for (p, d) in places {
            if !pose.conflicts().contains(p) {
                look(p, d);
            }
        }
        Some(())
    }

    /// Calls `look` with each point, and the ends of each segment, at rest and posed.
    pub fn for_each_handle(&self, pose: &Pose, mut look: impl FnMut(&[Point], &[Point])) {
        let d = pose.displacements();
        for element in &self.elements {
            match element {
                Element::Point { p, column, .. } => look(&[*p], &[*p + d[*column]]),
                Element::Segment(RestSegment { a, b, column, .. }) => {
                    look(&[*a, *b], &[*a + d[*column], *b + d[*column + 1]]);
                }
            }
        }
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
        if self.interpolates() {
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

impl RestDeformation {
    /// Whether f takes the handles to their targets.
    fn interpolates(&self) -> bool {
        match self.set.rank {
            Rank::Empty | Rank::OnePlace => true,
            Rank::Collinear | Rank::Full => self.method().info().interpolates(self.parameters()),
        }
    }
}

/// The posed mesh without a table: computes every vertex for each pose, for grids whose table would
/// not fit or pay. `None` when cancelled, which is checked for each block of vertices.
#[must_use]
pub fn pose_without_table(
    field: &RestDeformation,
    grid: &Grid,
    pose: &Pose,
    cancelled: IsCancelled<'_>,
) -> Option<(Mesh, PoseQuality)> {
    field.deformation(pose).mesh(grid, pose, cancelled)
}

impl<'a> PosedMap<'a> {
    /// f of displaced columns.
    pub(super) fn of_displacements(field: &'a RestDeformation, displacements: &'a [Vec2]) -> Self {
        Self {
            field,
            terms: field.terms_of(displacements),
            without_coefficients: match field.set.rank {
                Rank::Empty | Rank::OnePlace => None,
                Rank::Collinear | Rank::Full => field.map.posed(&field.set, displacements, false),
            },
        }
    }

    pub(super) fn columns(&self) -> usize {
        self.field.handles.columns()
    }

    /// What coefficients multiply.
    pub(super) fn multiplied(&self) -> &[Vec2] {
        &self.terms
    }

    /// The number of coefficients of a position.
    pub(super) fn terms(&self) -> usize {
        self.terms.len()
    }

    /// f at a position, in f64 by the quadrature nodes: the definition, not the grid.
    #[must_use]
    pub fn map(&self, place: Point) -> Point {
        thread_local!(static WORKSPACE: RefCell<Workspace<1>> = RefCell::new(Workspace::new(0)));
        WORKSPACE.with_borrow_mut(|workspace| {
            let terms = self.field.terms();
            workspace.rows.h.resize(terms, [[0.0]; 2]);
            workspace.rows.wn.resize(terms, [0.0]);
            let [[x], [y]] = self.displacements(&Vertices::all(place), true, workspace).0;
            place + Vec2::new(x, y)
        })
    }

    /// f at many positions: the same bits as [`PosedMap::map`], several times as fast. `None`
    /// when cancelled.
    #[must_use]
    pub fn map_all(&self, places: &[Point], cancelled: IsCancelled<'_>) -> Option<Vec<Point>> {
        let mut workspace = Workspace::new(self.terms());
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

    /// The posed mesh of a grid. O(vertices x elements) with weights, less where a method has
    /// better. `None` when cancelled.
    #[must_use]
    pub fn mesh(
        &self,
        grid: &Grid,
        pose: &Pose,
        cancelled: IsCancelled<'_>,
    ) -> Option<(Mesh, PoseQuality)> {
        let (displacement, least_rotation) = if pose.is_identity() {
            (vec![[0.0; 2]; grid.len()], 1.0)
        } else {
            // Row by row: without a division for each vertex.
            let across: Vec<f64> = (0..grid.columns()).map(|i| grid.x(i)).collect();
            let mut places = Vec::with_capacity(grid.len());
            for y in (0..grid.rows()).map(|j| grid.y(j)) {
                places.extend(across.iter().map(|x| Point::new(*x, y)));
            }
            self.displaced(&places, cancelled)?
        };
        let quality = PoseQuality { least_rotation };
        Some((Mesh::new(*grid, displacement), quality))
    }

    /// `f(v) - v`, px, of every position, in the precision of a table, and the least |m| (rigid),
    /// else 1. In parallel on the current pool; `None` when cancelled.
    pub(super) fn displaced(
        &self,
        places: &[Point],
        cancelled: IsCancelled<'_>,
    ) -> Option<(Vec<[f32; 2]>, f32)> {
        let direct = match &self.without_coefficients {
            Some(posed) => posed.displaced(places, cancelled)?,
            None => None,
        };
        let single = if let Some(single) = direct {
            single
        } else {
            let blocks: Option<Vec<Vec<[f32; 3]>>> = places
                .par_chunks(LANES)
                .map_init(
                    || Workspace::<LANES>::new(self.terms()),
                    |workspace, places| {
                        if cancelled() {
                            return None;
                        }
                        let v = gather(|lane| places[lane.min(places.len() - 1)]);
                        let ([x, y], least) = self.displacements(&v, false, workspace);
                        let moved = |k: usize| {
                            let [x, y] = to_f32(Vec2::new(x[k], y[k]));
                            [x, y, least]
                        };
                        Some((0..places.len()).map(moved).collect())
                    },
                )
                .collect();
            blocks?.concat()
        };
        // The bits of numbers that are not negative have their order, and a least integer is found
        // by vectors, which for numbers NaN prevents.
        let least = single.iter().map(|[_, _, m]| m.to_bits()).min();
        let least = least.map_or(1.0, f32::from_bits).min(1.0);
        Some((single.into_iter().map(|[x, y, _]| [x, y]).collect(), least))
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
    ) -> Displacements<N>
    where
        dyn PointMap: CoefficientsOf<N>,
        dyn PosedWithoutCoefficients + 'a: DisplacementsOf<N>,
    {
        let direct = self.without_coefficients.as_deref();
        if let Some(displacements) =
            direct.and_then(|posed| DisplacementsOf::<N>::displacements(posed, v))
        {
            return displacements;
        }
        self.field.rows(v, exact, workspace);
        let (form, d, rows) = (self.field.set.form, &*self.terms, &workspace.rows);
        let ([mut x, mut y], mut least) = ([[0.0; N]; 2], f32::INFINITY);
        for (k, (x, y)) in x.iter_mut().zip(&mut y).enumerate() {
            let moved = displacement(form, rows, k, d);
            (*x, *y) = (moved.x, moved.y);
            least = least.min(rotation(form, rows, k, d));
        }
        ([x, y], least)
    }
}
