//! Lines and rings that are mapped by f or by its inverse. A straight edge becomes a curve, so
//! vertices are added where the mapped outline would leave the tolerance.

use std::sync::atomic::Ordering;

use super::Transform;
use crate::deform::IsCancelled;
use crate::geometry::Point;
use crate::parallel::prelude::*;
use crate::warp::{Quantity, Task, WarpError};

/// Edges that one task maps.
const EDGES_PER_TASK: usize = 16;
/// An edge is first examined at positions this far apart, px, but at no more than this many.
const EDGE_SPACING_PX: f64 = 8.0;
const MOST_PARTS: usize = 1024;
/// A part of an edge is halved at most this often.
const MAX_EDGE_HALVINGS: usize = 6;
/// The most positions at which the edges of a request may be examined at first, beyond one for each
/// edge; known before anything is mapped.
pub const MAX_EDGE_SAMPLES: usize = 1 << 21;
/// The same of a task with those that halving bent edges adds, which is known only when they are
/// mapped: a long answer would break off. All parts of an answer are one task
/// ([`Transform::after`]). Each frame of a batch is one of its own, since it waits for a worker and
/// for its reader as a drawing does.
const MOST_SAMPLES: usize = 4 * MAX_EDGE_SAMPLES;

/// The vertices that are inserted into an edge: the share of the edge at each, and its mapped
/// position.
type Bend = Vec<(f64, Point)>;

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

impl Transform<'_> {
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
        // Between three samples, a smooth curve is nearly a parabola. Two straight halves are then
        // four times nearer to it than the line through the outer two is to the middle one.
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
        if samples > MOST_SAMPLES {
            return Err(WarpError::TooLarge {
                what: Quantity::OutlineSamples,
                limit: MOST_SAMPLES as u64,
                actual: MOST_SAMPLES as u64 + 1,
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
pub(super) fn to_segment(p: Point, a: Point, b: Point) -> f64 {
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
