//! Lengths of the shortest paths inside a mask from a handle (mathematics 11.2): Dijkstra's search,
//! whose paths are pulled tight at every step, so that they turn at corners of the outline alone.

use std::cmp::Reverse;
use std::collections::BinaryHeap;
use std::sync::Arc;

use super::pixel::{INTO_PIXEL, nearest_of_pixel};
use super::sight::Sights;
use super::{HANDLE_TO_MASK_PX, Mask, Nodes};
use crate::geometry::Point;

/// Nodes that are settled between two looks at whether the work is still needed: each takes as many
/// steps as its lines of sight.
const NODES_PER_CHECK: usize = 64;
/// Operations for a node beside its lines of sight.
const NODE_OPERATIONS: u64 = 100;
/// The turning point of a path that comes straight from the handle.
const HANDLE: u32 = u32::MAX;
/// The turning point of a node that no path reaches.
const NONE: u32 = u32::MAX - 1;
/// Positions of a segment from which the search starts are at most this far apart, px.
const SEGMENT_STEP: f64 = 0.5;

/// What distances are measured from.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum PathOrigin {
    /// A position.
    Point(Point),
    /// All positions between two.
    Segment(Point, Point),
}

/// Distances from a handle inside a mask.
#[derive(Debug)]
pub struct Distances {
    nodes: Arc<Nodes>,
    source: PathOrigin,
    /// The position inside the mask from which a handle that is one position sees.
    place: Option<Point>,
    /// The length of the shortest path to each node, px.
    length: Vec<f64>,
    /// The node at which that path turns last, or that it starts at: [`HANDLE`].
    turn: Vec<u32>,
}

impl PathOrigin {
    /// The position of the handle that is nearest to `v`.
    fn nearest(&self, v: Point) -> Point {
        match *self {
            Self::Point(p) => p,
            Self::Segment(a, b) => {
                let along = b - a;
                let t = (v - a).dot(along) / along.norm2();
                a.lerp(b, t.clamp(0.0, 1.0))
            }
        }
    }
}

impl Distances {
    /// Bytes that the distances from one handle take.
    #[must_use]
    pub const fn bytes_for(nodes: u64) -> u64 {
        12 * nodes
    }

    /// Bytes that the search for the distances from one handle needs beside them: nodes wait for
    /// their turn, some of them several times.
    #[must_use]
    pub const fn search_bytes(nodes: u64) -> u64 {
        16 * nodes + Sights::BYTES
    }

    /// Operations of the distances from one handle: for each node a few lines of sight.
    #[must_use]
    pub fn operations(nodes: &Nodes) -> u64 {
        let of_node = NODE_OPERATIONS + 4 * nodes.mask().sight_steps();
        of_node.saturating_mul(nodes.len() as u64)
    }

    /// The distances from a handle; `Err` if it is not inside the mask, `Ok(None)` when cancelled.
    ///
    /// # Errors
    /// The handle lies more than 3 px from the mask; a segment leaves it.
    pub fn new(
        nodes: &Arc<Nodes>,
        source: PathOrigin,
        cancelled: &dyn Fn() -> bool,
    ) -> Result<Option<Self>, OutsideMask> {
        let mut distances = Self {
            nodes: Arc::clone(nodes),
            source,
            place: match source {
                PathOrigin::Point(p) => place_of(nodes.mask(), p),
                PathOrigin::Segment(..) => None,
            },
            length: vec![f64::INFINITY; nodes.len()],
            turn: vec![NONE; nodes.len()],
        };
        let starts = distances.starts()?;
        Ok(distances.search(starts, cancelled).then_some(distances))
    }

    /// The nodes of the pixels that the handle lies on.
    fn starts(&self) -> Result<Vec<u32>, OutsideMask> {
        let mask = self.nodes.mask();
        let node = |v: Point| {
            let (x, y) = mask.pixel_at(v, HANDLE_TO_MASK_PX)?;
            self.nodes.node_at(x, y)
        };
        let starts: Option<Vec<u32>> = match self.source {
            PathOrigin::Point(p) => node(p).map(|node| vec![node]),
            PathOrigin::Segment(a, b) => {
                let steps = (a.distance(b) / SEGMENT_STEP).ceil().max(1.0);
                let inside = self.place(a).zip(self.place(b));
                let is_inside = inside.is_some_and(|(a, b)| mask.sees(a, b));
                #[expect(
                    clippy::cast_possible_truncation,
                    clippy::cast_sign_loss,
                    reason = "a segment inside an image"
                )]
                let steps = if is_inside { steps as u32 } else { 0 };
                let along = |k: u32| node(a.lerp(b, f64::from(k) / f64::from(steps.max(1))));
                is_inside.then(|| (0..=steps).filter_map(along).collect())
            }
        };
        let mut starts = starts
            .filter(|starts| !starts.is_empty())
            .ok_or(OutsideMask)?;
        starts.dedup();
        Ok(starts)
    }

    /// The position inside the mask from which the handle is seen near `v`.
    fn place(&self, v: Point) -> Option<Point> {
        match self.source {
            PathOrigin::Point(_) => self.place,
            PathOrigin::Segment(..) => place_of(self.nodes.mask(), self.source.nearest(v)),
        }
    }

    fn search(&mut self, starts: Vec<u32>, cancelled: &dyn Fn() -> bool) -> bool {
        let mut waiting = Waiting {
            queue: BinaryHeap::new(),
            corners: Vec::new(),
            sights: Sights::default(),
        };
        for node in starts {
            let at = self.nodes.position(node);
            let length = self.source.nearest(at).distance(at);
            self.reach(node, length, HANDLE, &mut waiting.queue);
        }
        let nodes = Arc::clone(&self.nodes);
        let mut settled = 0_usize;
        while let Some(Reverse((length, node))) = waiting.queue.pop() {
            if f64::from_bits(length) > self.length[node as usize] {
                continue;
            }
            settled += 1;
            if settled.is_multiple_of(NODES_PER_CHECK) && cancelled() {
                return false;
            }
            for next in nodes.neighbours(node) {
                self.relax(&nodes, [node, *next], &mut waiting);
            }
        }
        true
    }

    fn reach(&mut self, node: u32, length: f64, turn: u32, queue: &mut NodeQueue) {
        let at = node as usize;
        if length < self.length[at] {
            (self.length[at], self.turn[at]) = (length, turn);
            // Lengths are not negative, so that their bits have the same order.
            queue.push(Reverse((length.to_bits(), node)));
        }
    }

    /// Where the last straight piece of a path to near `v` begins: for its length, and for what is
    /// seen from there; and the length of the path to it.
    fn piece(&self, turn: u32, v: Point) -> Option<(Point, Point, f64)> {
        if turn == HANDLE {
            Some((self.source.nearest(v), self.place(v)?, 0.0))
        } else {
            let at = self.nodes.position(turn);
            Some((at, at, self.length[turn as usize]))
        }
    }

    /// A path to a node goes on to its neighbour.
    fn relax(&mut self, nodes: &Nodes, [node, next]: [u32; 2], waiting: &mut Waiting) {
        let Waiting {
            queue,
            corners,
            sights,
        } = waiting;
        let (here, to) = (nodes.position(node), nodes.position(next));
        let turn = self.turn[node as usize];
        let Some((from, seen_from, length)) = self.piece(turn, to) else {
            return;
        };
        let straight = length + from.distance(to);
        if straight >= self.length[next as usize] {
            return;
        }
        if sights.sees(nodes.mask(), seen_from, to) {
            return self.reach(next, straight, turn, queue);
        }
        let Some((from, seen_from, length)) = self.piece(turn, here) else {
            return;
        };
        let is_bent = !sights.sees(nodes.mask(), seen_from, to)
            && nodes.pull_tight([seen_from, here, to], sights, corners);
        if !is_bent {
            let length = self.length[node as usize] + here.distance(to);
            return self.reach(next, length, node, queue);
        }
        let (mut before, mut at, mut length) = (turn, from, length);
        for corner in corners.drain(..) {
            let position = nodes.position(corner);
            length += at.distance(position);
            self.reach(corner, length, before, queue);
            (before, at) = (corner, position);
            length = length.min(self.length[corner as usize]);
        }
        self.reach(next, length + at.distance(to), before, queue);
    }

    /// Whether a path reaches the node of a pixel.
    #[must_use]
    pub fn reaches(&self, x: usize, y: usize) -> bool {
        self.nodes
            .node_at(x, y)
            .is_some_and(|node| self.length[node as usize].is_finite())
    }

    /// The length of the shortest path to `v`, which is seen from its nearest position in a pixel
    /// inside the mask, px; infinite if no path reaches that pixel.
    #[must_use]
    pub fn at(&self, pixel: (usize, usize), v: Point, sights: &mut Sights) -> f64 {
        let Some(own) = self.nodes.node_at(pixel.0, pixel.1) else {
            return f64::INFINITY;
        };
        if self.length[own as usize].is_infinite() {
            return f64::INFINITY;
        }
        let mask = self.nodes.mask();
        let place = nearest_of_pixel(pixel, v, INTO_PIXEL);
        if let Some((p, seen_from, _)) = self.piece(HANDLE, v)
            && mask.sees(seen_from, place)
        {
            return p.distance(v);
        }
        let mut best = f64::INFINITY;
        let mut corners = Vec::new();
        for &node in std::iter::once(&own).chain(self.nodes.neighbours(own)) {
            let turn = self.turn[node as usize];
            if turn == NONE {
                continue;
            }
            let here = self.nodes.position(node);
            let Some((from, seen_from, length)) = self.piece(turn, here) else {
                continue;
            };
            if sights.sees(mask, seen_from, place) {
                if turn != HANDLE {
                    best = best.min(length + from.distance(v));
                }
            } else if self
                .nodes
                .pull_tight([seen_from, here, place], sights, &mut corners)
                && let Some(&last) = corners.last()
            {
                let at = self.nodes.position(last);
                best = best.min(self.length[last as usize] + at.distance(v));
            }
            let length = self.length[node as usize] + here.distance(v);
            if length < best && mask.sees(here, place) {
                best = length;
            }
        }
        if best.is_infinite() {
            let here = self.nodes.position(own);
            best = self.length[own as usize] + here.distance(v);
        }
        best
    }
}

/// The position inside the mask that is nearest to one of a handle, if there is one near.
fn place_of(mask: &Mask, p: Point) -> Option<Point> {
    let pixel = mask.pixel_at(p, HANDLE_TO_MASK_PX)?;
    Some(nearest_of_pixel(pixel, p, INTO_PIXEL))
}

type NodeQueue = BinaryHeap<Reverse<(u64, u32)>>;

/// What a search needs beside the distances.
struct Waiting {
    queue: NodeQueue,
    corners: Vec<u32>,
    sights: Sights,
}

/// A handle is not inside the mask.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct OutsideMask;
