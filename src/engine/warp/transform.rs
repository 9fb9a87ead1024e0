//! Positions and outlines mapped by f or by its inverse: exactly, not by the grid. Outlines get
//! more vertices where the map bends them. Positions at rest are those of the source, posed ones
//! those of the picture that is drawn ([`Transform::onto`]).

use std::sync::atomic::{AtomicUsize, Ordering};

use crate::parallel::prelude::*;

use super::{CoordinateFrame, ResolvedRest, Task, Units, WarpError, work};
use crate::deform::{Inverse, IsCancelled, MAX_COORDINATE, Pose, PosedMap};
use crate::geometry::{Mesh, Point};

/// Positions at which the search of an inverse computes f at once.
const LANES: usize = 16;
/// Positions and edges that one task maps.
const PLACES_PER_TASK: usize = 64;
const EDGES_PER_TASK: usize = 16;
/// An edge is first examined at positions this far apart, px, but at no more than this many.
const EDGE_SPACING_PX: f64 = 8.0;
const MOST_PARTS: usize = 1024;
/// A part of an edge is halved at most this often.
const MAX_EDGE_HALVINGS: usize = 6;
/// Positions at which the edges that a [`Transform`] maps are examined, beyond one for each edge.
pub const MAX_EDGE_SAMPLES: usize = 1 << 21;

/// The vertices that are inserted into an edge: the share of the edge at each, and its mapped
/// position.
type Bend = Vec<(f64, Point)>;

/// f of a pose, or its inverse, between positions in the client's units. Where it is the inverse,
/// positions at which nothing of the picture is posed have none.
#[derive(Debug)]
pub struct Transform<'a> {
    map: PositionMap<'a>,
    /// Those of the source and of the picture.
    rest: CoordinateFrame,
    posed: CoordinateFrame,
    samples: AtomicUsize,
    /// Operations of f at a position, and the most of all.
    per_position: u64,
    max_work: u64,
}

#[derive(Debug)]
enum PositionMap<'a> {
    Forward(PosedMap<'a>),
    Inverse(Inverse<'a>),
}

/// A line or ring of an annotation.
#[derive(Clone, Copy, Debug)]
pub struct Outline<'a> {
    /// Its vertices.
    pub places: &'a [Point],
    /// What connects them.
    pub edges: Edges,
}

/// A mapped outline with the vertices that were added.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct MappedOutline {
    /// Its vertices.
    pub places: Vec<Point>,
    /// Where each of them was: k for the vertex k, k + t for one that was added at this share of
    /// the edge after it.
    pub at: Vec<f64>,
}

impl MappedOutline {
    fn with_capacity(vertices: usize) -> Self {
        Self {
            places: Vec::with_capacity(vertices),
            at: Vec::with_capacity(vertices),
        }
    }
}

/// The edges of an outline.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Edges {
    /// None: single positions.
    None,
    /// From each vertex to the next.
    Open,
    /// The same, and from the last to the first.
    Closed,
}

impl Outline<'_> {
    const fn edge_count(&self) -> usize {
        match self.edges {
            Edges::None => 0,
            Edges::Open => self.places.len().saturating_sub(1),
            Edges::Closed => self.places.len(),
        }
    }
}

impl ResolvedRest {
    /// f of a pose.
    #[must_use]
    pub fn transform<'a>(&'a self, pose: &'a Pose) -> Transform<'a> {
        Transform::new(PositionMap::Forward(self.field().deformation(pose)), self)
    }

    /// The inverse of f. `mesh`: of the same pose and of [`ResolvedRest::to_invert`]; it decides
    /// where several rest positions have the same posed one.
    #[must_use]
    pub fn inverse<'a>(&'a self, pose: &'a Pose, mesh: &'a Mesh) -> Transform<'a> {
        Transform::new(
            PositionMap::Inverse(Inverse::new(self.field(), pose, mesh)),
            self,
        )
    }
}

impl<'a> Transform<'a> {
    fn new(map: PositionMap<'a>, setup: &ResolvedRest) -> Self {
        // A path inside a mask is sought for each position.
        let per_position = match &setup.cut {
            Some(_) => work::of_vertex(setup.field()),
            None => work::of_position(setup.field()),
        };
        let max_work = setup.max_work();
        let source = setup.source_frame();
        Self {
            map,
            rest: source,
            posed: source,
            samples: AtomicUsize::new(0),
            per_position,
            max_work,
        }
    }

    /// Checks the work of this number of positions, for those that are mapped part by part.
    ///
    /// # Errors
    /// More positions than may be mapped.
    pub fn check_positions(&self, positions: usize) -> Result<(), WarpError> {
        self.check_work(Task::Positions, positions)
    }

    /// Errors: More positions than may be mapped.
    fn check_work(&self, task: Task, positions: usize) -> Result<(), WarpError> {
        let times = if matches!(self.map, PositionMap::Inverse(_)) {
            work::EVALUATIONS_PER_INVERSE
        } else {
            1
        };
        work::at_most(
            task,
            self.max_work,
            (positions as u64)
                .saturating_mul(self.per_position)
                .saturating_mul(times),
        )
    }

    /// The same map, where posed positions are those of a picture; without this, they are those of
    /// the plane.
    #[must_use]
    pub fn onto(self, picture: CoordinateFrame) -> Self {
        Self {
            posed: picture,
            ..self
        }
    }

    /// The same map between positions in px of the plane.
    pub(super) fn in_px(self) -> Self {
        let plane = CoordinateFrame::of_source(self.rest.image(), Units::Px);
        Self {
            rest: plane,
            posed: plane,
            ..self
        }
    }

    const fn frames(&self) -> (&CoordinateFrame, &CoordinateFrame) {
        match self.map {
            PositionMap::Forward(_) => (&self.rest, &self.posed),
            PositionMap::Inverse(_) => (&self.posed, &self.rest),
        }
    }

    /// Maps positions. CPU work, in parallel on the current rayon pool for many positions; stops
    /// when `cancelled` returns true.
    ///
    /// # Errors
    /// A coordinate that is not finite or out of range; cancelled.
    pub fn map(
        &self,
        places: &[Point],
        cancelled: IsCancelled<'_>,
    ) -> Result<Vec<Option<Point>>, WarpError> {
        self.check_work(Task::Positions, places.len())?;
        let mut mapped = self.map_px(&self.to_px(places, 0)?, cancelled)?;
        let (_, to) = self.frames();
        mapped
            .iter_mut()
            .flatten()
            .for_each(|place| *place = to.from_plane(*place));
        Ok(mapped)
    }

    /// Maps outlines; `None` if any position of an outline has none. With a `tolerance`, px of the
    /// image that has the results, vertices are added where the mapped outline would differ from
    /// straight lines by more. CPU work like [`Transform::map`].
    ///
    /// # Errors
    /// Those of [`Transform::map`], with the index of the position in all outlines; more than
    /// [`MAX_EDGE_SAMPLES`] positions have to be examined.
    pub fn map_outlines(
        &self,
        outlines: &[Outline<'_>],
        tolerance: Option<f64>,
        cancelled: IsCancelled<'_>,
    ) -> Result<Vec<Option<MappedOutline>>, WarpError> {
        let (_, to) = self.frames();
        let tolerance = tolerance.map(|px| to.in_plane(px));
        let mut places = Vec::new();
        for outline in outlines {
            places.extend(self.to_px(outline.places, places.len())?);
        }
        self.check_work(Task::Positions, places.len())?;
        let mut edges = Vec::new();
        let mut start = 0;
        for outline in outlines {
            let count = outline.places.len();
            edges.extend((0..outline.edge_count()).map(|k| (start + k, start + (k + 1) % count)));
            start += count;
        }
        if tolerance.is_some() {
            let parts: usize = edges
                .iter()
                .map(|&(a, b)| 2 * pairs(places[a], places[b]))
                .sum();
            self.check_work(Task::Outlines, places.len() + parts)?;
        }
        let mapped = self.map_px(&places, cancelled)?;
        let bent = match tolerance {
            Some(tolerance) => self.bends(&edges, &places, &mapped, tolerance, cancelled)?,
            None => vec![Some(Vec::new()); edges.len()],
        };
        let mut bent = bent.into_iter();
        let mut mapped = mapped.into_iter();
        let outlines = outlines.iter().map(|outline| {
            let mut refined = Some(MappedOutline::with_capacity(outline.places.len()));
            for k in 0..outline.places.len() {
                let vertex = mapped.next().expect("each vertex");
                let has_edge = k < outline.edge_count();
                let inserted = if has_edge {
                    bent.next().expect("each edge")
                } else {
                    Some(Vec::new())
                };
                refined = match (refined, vertex, inserted) {
                    (Some(mut refined), Some(vertex), Some(inserted)) => {
                        for (t, place) in [(0.0, vertex)].into_iter().chain(inserted) {
                            refined.places.push(to.from_plane(place));
                            refined.at.push(k as f64 + t);
                        }
                        Some(refined)
                    }
                    _ => None,
                };
            }
            refined
        });
        Ok(outlines.collect())
    }

    /// The vertices to be inserted into each edge.
    fn bends(
        &self,
        edges: &[(usize, usize)],
        places: &[Point],
        mapped: &[Option<Point>],
        tolerance: f64,
        cancelled: IsCancelled<'_>,
    ) -> Result<Vec<Option<Bend>>, WarpError> {
        let task = |edges: &[(usize, usize)]| {
            let bend = |&(a, b): &(usize, usize)| match (mapped[a], mapped[b]) {
                (Some(fa), Some(fb)) => {
                    self.bend([(places[a], fa), (places[b], fb)], tolerance, cancelled)
                }
                _ => Ok(None),
            };
            edges
                .iter()
                .map(bend)
                .collect::<Result<Vec<_>, WarpError>>()
        };
        let tasks: Result<Vec<_>, WarpError> = edges.par_chunks(EDGES_PER_TASK).map(task).collect();
        Ok(tasks?.into_iter().flatten().collect())
    }

    /// The vertices to be inserted between the images of two positions; `None` if the edge has a
    /// position without an image.
    fn bend(
        &self,
        [(a, fa), (b, fb)]: [(Point, Point); 2],
        tolerance: f64,
        cancelled: IsCancelled<'_>,
    ) -> Result<Option<Vec<(f64, Point)>>, WarpError> {
        let pairs = pairs(a, b);
        let at = |k: usize| k as f64 / (2 * pairs) as f64;
        let inner: Vec<f64> = (1..2 * pairs).map(at).collect();
        let beyond_one = inner.len() - 1;
        let Some(inner) = self.samples(a, b, inner, beyond_one, cancelled)? else {
            return Ok(None);
        };
        let mut samples = vec![(0.0, fa)];
        samples.extend(inner);
        samples.push((1.0, fb));
        // A quarter of the distance of the middle of three remains if both halves are straight.
        let is_bent =
            |[a, m, b]: [(f64, Point); 3]| to_segment(m.1, a.1, b.1) > 4.0 * (tolerance / 2.0);
        let mut triples: Vec<[(f64, Point); 3]> = (0..pairs)
            .map(|k| [samples[2 * k], samples[2 * k + 1], samples[2 * k + 2]])
            .collect();
        for _ in 0..MAX_EDGE_HALVINGS {
            triples.retain(|triple| is_bent(*triple));
            if triples.is_empty() {
                break;
            }
            let halves: Vec<f64> = triples
                .iter()
                .flat_map(|[a, m, b]| [0.5 * (a.0 + m.0), 0.5 * (m.0 + b.0)])
                .collect();
            let count = halves.len();
            let Some(halves) = self.samples(a, b, halves, count, cancelled)? else {
                return Ok(None);
            };
            let smaller = triples
                .iter()
                .zip(halves.as_chunks::<2>().0)
                .flat_map(|([a, m, b], [am, mb])| [[*a, *am, *m], [*m, *mb, *b]]);
            triples = smaller.collect();
            samples.extend(halves);
        }
        samples.sort_by(|a, b| a.0.total_cmp(&b.0));
        simplified(&samples, tolerance / 2.0, cancelled)
            .map(Some)
            .ok_or(WarpError::Cancelled)
    }

    /// The images of positions on an edge, of which `count` count.
    fn samples(
        &self,
        a: Point,
        b: Point,
        at: Vec<f64>,
        count: usize,
        cancelled: IsCancelled<'_>,
    ) -> Result<Option<Vec<(f64, Point)>>, WarpError> {
        if cancelled() {
            return Err(WarpError::Cancelled);
        }
        let samples = self.samples.fetch_add(count, Ordering::Relaxed) + count;
        if samples > MAX_EDGE_SAMPLES {
            return Err(WarpError::TooLarge {
                what: "outline_samples",
                limit: MAX_EDGE_SAMPLES as u64,
                actual: MAX_EDGE_SAMPLES as u64 + 1,
            });
        }
        self.check_work(Task::Outlines, samples)?;
        let places: Vec<Point> = at.iter().map(|t| a.lerp(b, *t)).collect();
        let mapped = self.map_block(&places, cancelled)?;
        Ok(at
            .into_iter()
            .zip(mapped)
            .map(|(t, place)| Some((t, place?)))
            .collect())
    }

    fn map_block(
        &self,
        places: &[Point],
        cancelled: IsCancelled<'_>,
    ) -> Result<Vec<Option<Point>>, WarpError> {
        let mapped = match &self.map {
            PositionMap::Forward(f) => f
                .map_all(places, cancelled)
                .map(|mapped| mapped.into_iter().map(Some).collect()),
            PositionMap::Inverse(inverse) => {
                // Beside folds, a search may take a hundred times as long as elsewhere.
                let taken = inverse
                    .steps()
                    .saturating_mul(LANES as u64)
                    .saturating_mul(self.per_position);
                work::at_most(Task::Positions, self.max_work, taken)?;
                inverse.map(places, cancelled)
            }
        };
        mapped.ok_or(WarpError::Cancelled)
    }

    fn map_px(
        &self,
        places: &[Point],
        cancelled: IsCancelled<'_>,
    ) -> Result<Vec<Option<Point>>, WarpError> {
        let task = |places: &[Point]| self.map_block(places, cancelled);
        let tasks: Result<Vec<_>, WarpError> =
            places.par_chunks(PLACES_PER_TASK).map(task).collect();
        Ok(tasks?.into_iter().flatten().collect())
    }

    /// `before`: positions before these ones.
    fn to_px(&self, places: &[Point], before: usize) -> Result<Vec<Point>, WarpError> {
        let (from, _) = self.frames();
        let to_px = |(index, place): (usize, &Point)| {
            let px = from.to_plane(*place);
            match [px.x, px.y]
                .into_iter()
                .find(|c| !c.is_finite() || c.abs() > MAX_COORDINATE)
            {
                Some(value) => Err(WarpError::BadPlace {
                    index: before + index,
                    value,
                    limit: MAX_COORDINATE,
                }),
                None => Ok(px),
            }
        };
        places.iter().enumerate().map(to_px).collect()
    }
}

/// The number of positions at which an edge is first examined, px.
#[must_use]
pub fn samples_of(a: Point, b: Point) -> usize {
    2 * pairs(a, b) - 1
}

/// Pairs of parts at whose ends an edge is first examined.
#[expect(
    clippy::cast_possible_truncation,
    clippy::cast_sign_loss,
    reason = "a bounded number, at least 1"
)]
fn pairs(a: Point, b: Point) -> usize {
    (a.distance(b) / (2.0 * EDGE_SPACING_PX))
        .ceil()
        .clamp(1.0, MOST_PARTS as f64 / 2.0) as usize
}

/// The distance of a position from a segment.
fn to_segment(p: Point, a: Point, b: Point) -> f64 {
    let (along, to) = (b - a, p - a);
    let squared = along.dot(along);
    let t = if squared > 0.0 {
        (to.dot(along) / squared).clamp(0.0, 1.0)
    } else {
        0.0
    };
    p.distance(a.lerp(b, t))
}

/// The fewest samples between the first and the last by the method of Douglas and Peucker: the
/// others are within the tolerance of the lines between them. Takes the squared number of samples
/// if each part is split near its end. `None` when cancelled.
fn simplified(
    samples: &[(f64, Point)],
    tolerance: f64,
    cancelled: IsCancelled<'_>,
) -> Option<Vec<(f64, Point)>> {
    let mut kept = vec![false; samples.len()];
    let mut parts = vec![(0, samples.len() - 1)];
    while let Some((first, last)) = parts.pop() {
        if cancelled() {
            return None;
        }
        let distance = |k: usize| to_segment(samples[k].1, samples[first].1, samples[last].1);
        let farthest = (first + 1..last)
            .map(|k| (distance(k), k))
            .max_by(|a, b| a.0.total_cmp(&b.0));
        if let Some((distance, k)) = farthest
            && distance > tolerance
        {
            kept[k] = true;
            parts.extend([(first, k), (k, last)]);
        }
    }
    Some(
        samples
            .iter()
            .zip(kept)
            .filter(|(_, kept)| *kept)
            .map(|(sample, _)| *sample)
            .collect(),
    )
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::deform::Handle;
    use crate::pixmap::Extent;
    use crate::warp::{Folds, GridSpec, Limits, PosedMesh, RestSpec};

    const NEVER: IsCancelled<'static> = &|| false;

    const P: [(f64, f64); 7] = [
        (40.0, 30.0),
        (250.0, 40.0),
        (150.0, 100.0),
        (60.0, 160.0),
        (230.0, 170.0),
        (120.0, 60.0),
        (180.0, 140.0),
    ];
    const D: [(f64, f64); 7] = [
        (8.0, -6.0),
        (-5.0, 9.0),
        (12.0, 4.0),
        (-7.0, -8.0),
        (4.0, -12.0),
        (-9.0, 3.0),
        (6.0, 11.0),
    ];

    /// Seven handles, each moved by its displacement times `strength`.
    fn set(strength: f64) -> (ResolvedRest, Vec<Handle>) {
        let rest = RestSpec {
            p: P.map(|(x, y)| Handle::Point(Point::new(x, y))).to_vec(),
            ..RestSpec::default()
        };
        let q = P.iter().zip(D).map(|((x, y), (dx, dy))| {
            Handle::Point(Point::new(x + strength * dx, y + strength * dy))
        });
        (
            ResolvedRest::new(&rest, Extent::new(300, 200).unwrap(), &Limits::default()).unwrap(),
            q.collect(),
        )
    }

    fn square(from: f64, to: f64) -> Vec<Point> {
        [(from, from), (to, from), (to, to), (from, to)]
            .map(|(x, y)| Point::new(x, y))
            .to_vec()
    }

    #[test]
    fn refined_outlines_follow_the_map_and_straight_ones_stay() {
        let (setup, q) = set(1.0);
        let pose = setup.pose(&q).unwrap();
        let f = setup.transform(&pose);
        let places = square(20.0, 180.0);
        let outline = Outline {
            places: &places,
            edges: Edges::Closed,
        };
        let bare = f
            .map_outlines(&[outline], None, NEVER)
            .unwrap()
            .remove(0)
            .unwrap()
            .places;
        assert_eq!(
            bare.iter().copied().map(Some).collect::<Vec<_>>(),
            f.map(&places, NEVER).unwrap()
        );
        for tolerance in [1.0, 0.1, 0.01] {
            let MappedOutline {
                places: refined,
                at,
            } = f
                .map_outlines(&[outline], Some(tolerance), NEVER)
                .unwrap()
                .remove(0)
                .unwrap();
            #[expect(clippy::cast_possible_truncation, reason = "the index of a corner")]
            let of_edge =
                |at: f64| places[at as usize].lerp(places[(at as usize + 1) % 4], at.fract());
            let there = f
                .map(&at.into_iter().map(of_edge).collect::<Vec<_>>(), NEVER)
                .unwrap();
            assert!(
                there
                    .into_iter()
                    .zip(&refined)
                    .all(|(there, vertex)| there.unwrap().distance(*vertex) < 1e-9)
            );
            assert!(refined.len() > 8, "{}", refined.len());
            assert!(bare.iter().all(|vertex| refined.contains(vertex)));
            let segments: Vec<(Point, Point)> = (0..refined.len())
                .map(|k| (refined[k], refined[(k + 1) % refined.len()]))
                .collect();
            for k in 0..4 {
                for step in 0..=1000 {
                    let y = f
                        .map(
                            &[places[k].lerp(places[(k + 1) % 4], f64::from(step) / 1000.0)],
                            NEVER,
                        )
                        .unwrap()[0]
                        .unwrap();
                    let nearest = segments
                        .iter()
                        .map(|(a, b)| to_segment(y, *a, *b))
                        .fold(f64::INFINITY, f64::min);
                    assert!(
                        nearest <= tolerance,
                        "{tolerance}: {y:?} is {nearest} px away"
                    );
                }
            }
        }
        let still = setup.pose(&set(0.0).1).unwrap();
        let straight = setup
            .transform(&still)
            .map_outlines(&[outline], Some(0.1), NEVER)
            .unwrap();
        let at = vec![0.0, 1.0, 2.0, 3.0];
        assert_eq!(
            straight,
            [Some(MappedOutline {
                places: places.clone(),
                at
            })]
        );
    }

    #[test]
    fn the_inverse_of_a_mapped_outline_is_the_outline() {
        let (setup, q) = set(1.0);
        let pose = setup.pose(&q).unwrap();
        let posed = PosedMesh::coarse(&setup, &setup.plan(), &pose, Folds::Report, NEVER).unwrap();
        let (f, back) = (setup.transform(&pose), setup.inverse(&pose, posed.mesh()));
        let places = square(30.0, 170.0);
        let there = f
            .map_outlines(
                &[Outline {
                    places: &places,
                    edges: Edges::Closed,
                }],
                Some(0.1),
                NEVER,
            )
            .unwrap()
            .remove(0)
            .unwrap()
            .places;
        let again = back
            .map_outlines(
                &[Outline {
                    places: &there,
                    edges: Edges::Closed,
                }],
                None,
                NEVER,
            )
            .unwrap()
            .remove(0)
            .unwrap()
            .places;
        for place in again {
            let nearest = (0..4)
                .map(|k| to_segment(place, places[k], places[(k + 1) % 4]))
                .fold(f64::INFINITY, f64::min);
            assert!(nearest < 1e-6, "{place:?}");
        }
        let outside = [Point::new(100.0, 100.0), Point::new(-5000.0, 0.0)];
        assert_eq!(
            back.map_outlines(
                &[Outline {
                    places: &outside,
                    edges: Edges::Open
                }],
                Some(0.1),
                NEVER
            )
            .unwrap(),
            [None]
        );
    }

    #[test]
    fn the_inverse_is_found_whatever_size_the_cells_have() {
        let rest = |grid| RestSpec {
            p: P.map(|(x, y)| Handle::Point(Point::new(x, y))).to_vec(),
            grid,
            ..RestSpec::default()
        };
        let (extent, limits) = (Extent::new(300, 200).unwrap(), Limits::default());
        let places: Vec<Point> = (0..200)
            .map(|k| {
                Point::new(
                    f64::from(k * 37 % 101) * 2.97,
                    f64::from(k * 53 % 103) * 1.94,
                )
            })
            .collect();
        for grid in [
            GridSpec::Counts {
                columns: 2,
                rows: 2,
            },
            GridSpec::Cell(50.0),
            GridSpec::Pixel,
            GridSpec::Cell(6.0),
        ] {
            let client = ResolvedRest::new(&rest(grid), extent, &limits).unwrap();
            let setup = client.to_invert(&limits).unwrap();
            assert_eq!(
                setup.plan_key() == client.plan_key(),
                grid == GridSpec::Cell(6.0)
            );
            let pose = setup.pose(&set(1.0).1).unwrap();
            let posed =
                PosedMesh::coarse(&setup, &setup.plan(), &pose, Folds::Report, NEVER).unwrap();
            let there: Vec<Point> = client
                .transform(&pose)
                .map(&places, NEVER)
                .unwrap()
                .into_iter()
                .flatten()
                .collect();
            let back = setup
                .inverse(&pose, posed.mesh())
                .map(&there, NEVER)
                .unwrap();
            for (place, back) in places.iter().zip(back) {
                assert!(
                    back.is_some_and(|back| back.distance(*place) < 1e-6),
                    "{grid:?}: {place:?} {back:?}"
                );
            }
        }
    }

    #[test]
    fn work_is_bounded_and_positions_are_checked() {
        let (setup, q) = set(1.0);
        let pose = setup.pose(&q).unwrap();
        let f = setup.transform(&pose);
        let far: Vec<Point> = (0..3000)
            .map(|k| Point::new(if k % 2 == 0 { -9e5 } else { 9e5 }, f64::from(k)))
            .collect();
        let error = f
            .map_outlines(
                &[Outline {
                    places: &far,
                    edges: Edges::Closed,
                }],
                Some(0.1),
                NEVER,
            )
            .unwrap_err();
        assert!(
            matches!(
                error,
                WarpError::TooLarge {
                    what: "outline_samples",
                    ..
                }
            ),
            "{error}"
        );
        let (near, bad) = (
            square(1.0, 9.0),
            [Point::new(0.0, 0.0), Point::new(0.0, 2e6)],
        );
        let outlines = [
            Outline {
                places: &near,
                edges: Edges::Closed,
            },
            Outline {
                places: &bad,
                edges: Edges::Open,
            },
        ];
        let error = setup
            .transform(&pose)
            .map_outlines(&outlines, None, NEVER)
            .unwrap_err();
        assert!(
            matches!(error, WarpError::BadPlace { index: 5, .. }),
            "{error}"
        );
        assert_eq!(
            setup.transform(&pose).map(&near, &|| true),
            Err(WarpError::Cancelled)
        );
    }
}
