//! The graph on which distances inside a mask are computed: a node for each connected component of
//! the mask in every block of pixels, and one for each reflex corner of its outline, since shortest
//! paths turn nowhere else (mathematics 11.2).

use std::sync::Arc;

use super::Mask;
use super::mask::INTO_PIXEL;
use crate::geometry::{PIXEL_CENTER, Point};

/// Masks of at most this many pixels have a node at each.
const FINE_PIXELS: usize = 60_000;
/// Pixels that no component has.
const NO_COMPONENT: u16 = u16::MAX;

/// The nodes of a mask and which of them are neighbours.
#[derive(Debug)]
pub struct Nodes {
    mask: Arc<Mask>,
    stride: usize,
    /// Blocks in a row of blocks.
    blocks: usize,
    /// The first node of each block, blocks row by row.
    first_node: Vec<u32>,
    /// The component of each pixel in its block; empty if blocks are pixels.
    components: Vec<u16>,
    /// Components first, then corners row by row.
    positions: Vec<Point>,
    /// The first corner of each line between rows of pixels.
    first_corner: Vec<u32>,
    first_neighbour: Vec<u32>,
    neighbours: Vec<u32>,
}

/// Why there are no nodes.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum NoNodes {
    /// The mask has more than the limit: this many.
    TooMany(u64),
    /// The work was cancelled.
    Cancelled,
}

impl Nodes {
    /// Bytes that this many nodes take, with what their construction needs.
    #[must_use]
    pub const fn bytes_for(nodes: u64) -> u64 {
        nodes * 200
    }

    /// The side of the blocks of a mask, px.
    #[must_use]
    pub fn stride_of(mask: &Mask) -> usize {
        let mut stride = 1;
        while stride * stride * FINE_PIXELS < mask.inside() {
            stride += 1;
        }
        stride
    }

    /// The number of nodes of a mask with blocks of `stride` px. O(pixels).
    #[must_use]
    pub fn count(mask: &Arc<Mask>, stride: usize) -> u64 {
        match Self::new(Arc::clone(mask), stride, 0, &|| false) {
            Ok(nodes) => nodes.len() as u64,
            Err(NoNodes::TooMany(nodes)) => nodes,
            Err(NoNodes::Cancelled) => 0,
        }
    }

    /// The nodes of a mask with blocks of `stride` px, at most `most`.
    ///
    /// # Errors
    /// Too many nodes; cancelled.
    pub fn new(
        mask: Arc<Mask>,
        stride: usize,
        most: usize,
        cancelled: &dyn Fn() -> bool,
    ) -> Result<Self, NoNodes> {
        let (width, height) = mask.size();
        let stride = stride.clamp(1, 255);
        let mut nodes = Self {
            stride,
            blocks: width.div_ceil(stride),
            first_node: Vec::new(),
            components: vec![NO_COMPONENT; if stride > 1 { width * height } else { 0 }],
            positions: Vec::new(),
            first_corner: Vec::with_capacity(height + 2),
            first_neighbour: Vec::new(),
            neighbours: Vec::new(),
            mask,
        };
        let components = nodes.find_components(most, cancelled)?;
        let all = nodes.find_corners(components, most, cancelled)?;
        if all > most.min(u32::MAX as usize / 16) {
            return Err(NoNodes::TooMany(all as u64));
        }
        nodes.connect(cancelled)?;
        Ok(nodes)
    }

    /// Adds a node for each component of each block, as long as there are at most `most`; counts
    /// all.
    fn find_components(
        &mut self,
        most: usize,
        cancelled: &dyn Fn() -> bool,
    ) -> Result<usize, NoNodes> {
        let (width, height) = self.mask.size();
        let mut count = 0;
        let mut stack = Vec::new();
        for y0 in (0..height).step_by(self.stride) {
            if cancelled() {
                return Err(NoNodes::Cancelled);
            }
            for x0 in (0..width).step_by(self.stride) {
                self.first_node.push(number(count.min(most)));
                let end = [
                    (x0 + self.stride).min(width),
                    (y0 + self.stride).min(height),
                ];
                let mut component = 0;
                for y in y0..end[1] {
                    for x in x0..end[0] {
                        if self.mask.is_inside(x, y) && self.component(x, y) == NO_COMPONENT {
                            let at = self.flood([x0, y0], end, (x, y), component, &mut stack);
                            component += 1;
                            if count < most {
                                self.positions.push(center(at));
                            }
                            count += 1;
                        }
                    }
                }
            }
        }
        self.first_node.push(number(count.min(most)));
        Ok(count)
    }

    fn component(&self, x: usize, y: usize) -> u16 {
        if self.stride == 1 {
            NO_COMPONENT
        } else {
            self.components[y * self.mask.size().0 + x]
        }
    }

    /// Labels a component; returns its pixel that is nearest to the centre of the block.
    fn flood(
        &mut self,
        [x0, y0]: [usize; 2],
        [x1, y1]: [usize; 2],
        from: (usize, usize),
        component: u16,
        stack: &mut Vec<(usize, usize)>,
    ) -> (usize, usize) {
        if self.stride == 1 {
            return from;
        }
        let width = self.mask.size().0;
        let mut best = (usize::MAX, from);
        stack.push(from);
        self.components[from.1 * width + from.0] = component;
        while let Some((x, y)) = stack.pop() {
            // Twice the distance from the centre, squared; row order decides between equals.
            let (dx, dy) = (
                (2 * (x - x0) + 1).abs_diff(self.stride),
                (2 * (y - y0) + 1).abs_diff(self.stride),
            );
            let distance = dx * dx + dy * dy;
            if (distance, y, x) < (best.0, best.1.1, best.1.0) {
                best = (distance, (x, y));
            }
            let beside = [
                (x > x0).then(|| (x - 1, y)),
                (x + 1 < x1).then_some((x + 1, y)),
                (y > y0).then(|| (x, y - 1)),
                (y + 1 < y1).then_some((x, y + 1)),
            ];
            for (x, y) in beside.into_iter().flatten() {
                let at = y * width + x;
                if self.mask.is_inside(x, y) && self.components[at] == NO_COMPONENT {
                    self.components[at] = component;
                    stack.push((x, y));
                }
            }
        }
        best.1
    }

    /// Adds the reflex corners: three of the four pixels around them are inside.
    fn find_corners(
        &mut self,
        mut count: usize,
        most: usize,
        cancelled: &dyn Fn() -> bool,
    ) -> Result<usize, NoNodes> {
        let (width, height) = self.mask.size();
        for y in 0..=height {
            self.first_corner.push(number(self.positions.len()));
            if cancelled() {
                return Err(NoNodes::Cancelled);
            }
            if y == 0 || y == height {
                continue;
            }
            for x in 1..width {
                let around = pixels_around(x, y).map(|(x, y)| self.mask.is_inside(x, y));
                if around.iter().filter(|inside| **inside).count() == 3 {
                    let missing = around.iter().position(|inside| !inside).unwrap_or(0);
                    // Away from the pixel that is missing.
                    let into = |is_low: bool| if is_low { INTO_PIXEL } else { -INTO_PIXEL };
                    if count < most {
                        self.positions.push(Point::new(
                            x as f64 + into(missing.is_multiple_of(2)),
                            y as f64 + into(missing < 2),
                        ));
                    }
                    count += 1;
                }
            }
        }
        self.first_corner.push(number(self.positions.len()));
        Ok(count)
    }

    fn connect(&mut self, cancelled: &dyn Fn() -> bool) -> Result<(), NoNodes> {
        let (width, height) = self.mask.size();
        let mut pairs = Vec::new();
        for y in 0..height {
            if cancelled() {
                return Err(NoNodes::Cancelled);
            }
            for x in 0..width {
                self.pairs_from(x, y, &mut pairs);
            }
        }
        for y in 0..=height {
            for corner in self.first_corner[y]..self.first_corner[y + 1] {
                let [x, y] = self.corner_at(corner);
                for (x, y) in pixels_around(x, y) {
                    if let Some(node) = self.node_at(x, y) {
                        pairs.push((corner, node));
                    }
                }
            }
        }
        let reversed: Vec<_> = pairs.iter().map(|(a, b)| (*b, *a)).collect();
        pairs.extend(reversed);
        pairs.sort_unstable();
        pairs.dedup();
        self.first_neighbour = vec![0; self.positions.len() + 1];
        for (a, _) in &pairs {
            self.first_neighbour[*a as usize + 1] += 1;
        }
        for k in 1..self.first_neighbour.len() {
            self.first_neighbour[k] += self.first_neighbour[k - 1];
        }
        self.neighbours = pairs.into_iter().map(|(_, b)| b).collect();
        Ok(())
    }

    /// Where a pixel touches pixels to its right or below that are of another node.
    fn pairs_from(&self, x: usize, y: usize, pairs: &mut Vec<(u32, u32)>) {
        let (right, below) = (
            (x + 1).is_multiple_of(self.stride),
            (y + 1).is_multiple_of(self.stride),
        );
        if !(right || below || x.is_multiple_of(self.stride)) {
            return;
        }
        let Some(node) = self.node_at(x, y) else {
            return;
        };
        let inside = |x: usize, y: usize| self.mask.is_inside(x, y);
        let left = x.wrapping_sub(1);
        let touching = [
            (x + 1, y, true),
            (x, y + 1, true),
            (x + 1, y + 1, inside(x + 1, y) || inside(x, y + 1)),
            (left, y + 1, inside(left, y) || inside(x, y + 1)),
        ];
        for (x, y, touches) in touching {
            if touches
                && let Some(other) = self.node_at(x, y)
                && other != node
            {
                pairs.push((node, other));
            }
        }
    }

    /// The node of a pixel; `None` if it is not inside.
    #[must_use]
    pub fn node_at(&self, x: usize, y: usize) -> Option<u32> {
        if !self.mask.is_inside(x, y) {
            return None;
        }
        let block = (y / self.stride) * self.blocks + x / self.stride;
        let component = if self.stride == 1 {
            0
        } else {
            self.component(x, y)
        };
        Some(self.first_node[block] + u32::from(component))
    }

    pub(super) fn neighbours(&self, node: u32) -> &[u32] {
        let node = node as usize;
        &self.neighbours
            [self.first_neighbour[node] as usize..self.first_neighbour[node + 1] as usize]
    }

    pub(super) fn position(&self, node: u32) -> Point {
        self.positions[node as usize]
    }

    /// Nodes of corners on the line above a row of pixels, from left to right.
    pub(super) fn corners_on(&self, line: usize) -> std::ops::Range<u32> {
        match self.first_corner.get(line..line + 2) {
            Some(&[first, end]) => first..end,
            _ => 0..0,
        }
    }

    /// The lines of the pixel lattice that meet at a corner.
    fn corner_at(&self, corner: u32) -> [usize; 2] {
        let Point { x, y } = self.position(corner);
        #[expect(
            clippy::cast_possible_truncation,
            clippy::cast_sign_loss,
            reason = "a position of the image"
        )]
        [x.round() as usize, y.round() as usize]
    }

    /// Number of nodes.
    #[must_use]
    pub fn len(&self) -> usize {
        self.positions.len()
    }

    /// Whether the mask has no pixel.
    #[must_use]
    pub fn is_empty(&self) -> bool {
        self.positions.is_empty()
    }

    /// Number of reflex corners.
    #[must_use]
    pub fn corners(&self) -> usize {
        self.first_corner
            .last()
            .map_or(0, |end| *end - self.first_corner[0]) as usize
    }

    /// The mask.
    #[must_use]
    pub const fn mask(&self) -> &Arc<Mask> {
        &self.mask
    }

    /// Memory of the nodes, bytes.
    #[must_use]
    pub fn bytes(&self) -> u64 {
        (size_of_val(&*self.first_node)
            + size_of_val(&*self.components)
            + size_of_val(&*self.positions)
            + size_of_val(&*self.first_corner)
            + size_of_val(&*self.first_neighbour)
            + size_of_val(&*self.neighbours)) as u64
    }
}

/// The pixels around a corner: above it left and right, then below it.
const fn pixels_around(x: usize, y: usize) -> [(usize, usize); 4] {
    [(x - 1, y - 1), (x, y - 1), (x - 1, y), (x, y)]
}

pub(super) fn center((x, y): (usize, usize)) -> Point {
    Point::new(x as f64 + PIXEL_CENTER, y as f64 + PIXEL_CENTER)
}

/// A number of nodes, which `Nodes::new` limits.
#[expect(clippy::cast_possible_truncation, reason = "limited by Nodes::new")]
const fn number(k: usize) -> u32 {
    k as u32
}
