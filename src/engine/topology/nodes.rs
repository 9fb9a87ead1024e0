//! The graph on which distances inside a mask are computed: a node for each connected component of
//! the mask in every block of pixels, and one for each reflex corner of its outline, since shortest
//! paths turn nowhere else (mathematics 11.2).

use std::sync::Arc;

use super::Mask;
use super::cell_components::NO_COMPONENT;
use super::pixel::INTO_PIXEL;
use crate::geometry::{PIXEL_CENTER, Point};

/// Masks of at most this many pixels have a node at each.
const FINE_PIXELS: usize = 60_000;

/// The nodes of a mask and which of them are neighbours.
#[derive(Debug)]
pub struct Nodes {
    pub(super) mask: Arc<Mask>,
    pub(super) stride: usize,
    /// Blocks in a row of blocks.
    blocks: usize,
    /// The first node of each block, blocks row by row.
    first_node: Vec<u32>,
    /// Of each block with several components: its number, and the component of each pixel, row by
    /// row; ascending.
    split: Vec<(u32, Box<[u16]>)>,
    /// Components first, then corners row by row.
    pub(super) positions: Vec<Point>,
    /// The first corner of each line between rows of pixels.
    pub(super) first_corner: Vec<u32>,
    pub(super) first_neighbour: Vec<u32>,
    pub(super) neighbours: Vec<u32>,
}

/// What the memory of the nodes of a mask depends on.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct NodesSize {
    /// Nodes.
    pub nodes: u64,
    /// Blocks of the image.
    pub blocks: u64,
    /// Blocks with several components: each has the components of its pixels.
    pub split: u64,
}

impl NodesSize {
    /// Memory for the blocks of `stride` px beside the nodes, bytes.
    #[must_use]
    pub const fn block_bytes(&self, stride: usize) -> u64 {
        // Vectors grow by doubling.
        4 * self.blocks + (2 * (stride as u64 * stride as u64) + 64) * self.split
    }
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
    /// Bytes that this many nodes take, with what their construction needs, beside those of blocks.
    #[must_use]
    pub const fn bytes_for(nodes: u64) -> u64 {
        nodes * 200
    }

    /// Bytes that this many nodes hold, beside those of blocks.
    #[must_use]
    pub const fn kept_bytes(nodes: u64) -> u64 {
        nodes * 72
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

    /// What the nodes of a mask with blocks of `stride` px take; `None` when cancelled. O(pixels),
    /// in little memory.
    #[must_use]
    pub fn size(
        mask: &Arc<Mask>,
        stride: usize,
        cancelled: &dyn Fn() -> bool,
    ) -> Option<NodesSize> {
        let mut nodes = Self::none(Arc::clone(mask), stride);
        let mut size = NodesSize::default();
        let count = |found: &[(usize, usize)], _: &[u16]| {
            size.blocks += 1;
            size.nodes += found.len() as u64;
            size.split += u64::from(found.len() > 1);
        };
        nodes.each_block(cancelled, count).ok()?;
        size.nodes += nodes.find_corners(0, 0, cancelled).ok()? as u64;
        Some(size)
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
        let mut nodes = Self::none(mask, stride);
        let components = nodes.find_components(most, cancelled)?;
        let all = nodes.find_corners(components, most, cancelled)?;
        if all > most.min(u32::MAX as usize / 16) {
            return Err(NoNodes::TooMany(all as u64));
        }
        nodes.connect(cancelled)?;
        Ok(nodes)
    }

    fn none(mask: Arc<Mask>, stride: usize) -> Self {
        let (width, height) = mask.size();
        let stride = stride.clamp(1, 255);
        Self {
            stride,
            blocks: width.div_ceil(stride),
            first_node: Vec::new(),
            split: Vec::new(),
            positions: Vec::new(),
            first_corner: Vec::with_capacity(height + 2),
            first_neighbour: Vec::new(),
            neighbours: Vec::new(),
            mask,
        }
    }

    /// Finds the components of each block: a pixel of each, and the component of each pixel.
    fn each_block(
        &self,
        cancelled: &dyn Fn() -> bool,
        mut visit: impl FnMut(&[(usize, usize)], &[u16]),
    ) -> Result<(), NoNodes> {
        let (width, height) = self.mask.size();
        let mut labels = vec![NO_COMPONENT; self.stride * self.stride];
        let mut found = Vec::new();
        for y0 in (0..height).step_by(self.stride) {
            if cancelled() {
                return Err(NoNodes::Cancelled);
            }
            for x0 in (0..width).step_by(self.stride) {
                found.clear();
                self.components_of([x0, y0], &mut labels, &mut found);
                visit(&found, &labels);
            }
        }
        Ok(())
    }

    /// Adds a node for each component of each block, as long as there are at most `most`; counts
    /// all.
    fn find_components(
        &mut self,
        most: usize,
        cancelled: &dyn Fn() -> bool,
    ) -> Result<usize, NoNodes> {
        let (mut count, mut split, mut positions) = (0, Vec::new(), Vec::new());
        let all = self.blocks * self.mask.size().1.div_ceil(self.stride);
        let mut first_node = Vec::with_capacity(all + 1);
        self.each_block(cancelled, |found, labels| {
            let block = number(first_node.len());
            first_node.push(number(count.min(most)));
            count += found.len();
            if count <= most {
                positions.extend(found.iter().copied().map(center));
                if found.len() > 1 {
                    split.push((block, labels.into()));
                }
            }
        })?;
        first_node.push(number(count.min(most)));
        (self.first_node, self.split, self.positions) = (first_node, split, positions);
        Ok(count)
    }

    /// The components of a block: of each its pixel that is nearest to the centre of the block.
    fn components_of(
        &self,
        [x0, y0]: [usize; 2],
        labels: &mut [u16],
        found: &mut Vec<(usize, usize)>,
    ) {
        let (width, height) = self.mask.size();
        let stride = self.stride;
        let last = [(x0 + stride).min(width) - 1, (y0 + stride).min(height) - 1];
        if self.mask.is_whole(x0, y0, stride) {
            let middle = (stride - 1) / 2;
            found.push(((x0 + middle).min(last[0]), (y0 + middle).min(last[1])));
            return;
        }
        labels.fill(NO_COMPONENT);
        let mut stack = Vec::new();
        for y in y0..=last[1] {
            for x in x0..=last[0] {
                let label = labels[(y - y0) * stride + x - x0];
                if label == NO_COMPONENT && self.mask.is_inside(x, y) {
                    stack.push((x, y));
                    let own = (labels_of(found.len()), [x0, y0], last);
                    found.push(self.flood(own, labels, &mut stack));
                }
            }
        }
    }

    /// The component of a pixel in its block.
    fn component(&self, x: usize, y: usize, block: usize) -> u32 {
        if self.first_node[block + 1] == self.first_node[block] + 1 {
            return 0;
        }
        let at = self
            .split
            .binary_search_by_key(&block, |(block, _)| *block as usize);
        at.map_or(0, |at| {
            let pixel = (y % self.stride) * self.stride + x % self.stride;
            self.split[at].1[pixel].into()
        })
    }

    /// Labels the component of the pixels in `stack`, in the block between two pixels; returns its
    /// pixel that is nearest to the centre of the block.
    fn flood(
        &self,
        (component, [x0, y0], [x1, y1]): (u16, [usize; 2], [usize; 2]),
        labels: &mut [u16],
        stack: &mut Vec<(usize, usize)>,
    ) -> (usize, usize) {
        let mut best = (usize::MAX, (0, 0));
        while let Some((x, y)) = stack.pop() {
            let label = &mut labels[(y - y0) * self.stride + x - x0];
            if *label != NO_COMPONENT {
                continue;
            }
            *label = component;
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
                (x < x1).then_some((x + 1, y)),
                (y > y0).then(|| (x, y - 1)),
                (y < y1).then_some((x, y + 1)),
            ];
            stack.extend(
                beside
                    .into_iter()
                    .flatten()
                    .filter(|(x, y)| self.mask.is_inside(*x, *y)),
            );
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

    /// The node of a pixel; `None` if it is not inside.
    #[must_use]
    pub fn node_at(&self, x: usize, y: usize) -> Option<u32> {
        if !self.mask.is_inside(x, y) {
            return None;
        }
        let block = (y / self.stride) * self.blocks + x / self.stride;
        Some(self.first_node[block] + self.component(x, y, block))
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
    pub(super) fn corner_at(&self, corner: u32) -> [usize; 2] {
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
        let split = self.split.len() * self.stride * self.stride * size_of::<u16>();
        (size_of_val(&*self.first_node)
            + split
            + size_of_val(&*self.positions)
            + size_of_val(&*self.first_corner)
            + size_of_val(&*self.first_neighbour)
            + size_of_val(&*self.neighbours)) as u64
    }
}

/// The pixels around a corner: above it left and right, then below it.
pub(super) const fn pixels_around(x: usize, y: usize) -> [(usize, usize); 4] {
    [(x - 1, y - 1), (x, y - 1), (x - 1, y), (x, y)]
}

pub(super) fn center((x, y): (usize, usize)) -> Point {
    Point::new(x as f64 + PIXEL_CENTER, y as f64 + PIXEL_CENTER)
}

/// The label of a component of a block, which has at most 255 x 255 pixels.
#[expect(clippy::cast_possible_truncation, reason = "limited by the block")]
const fn labels_of(component: usize) -> u16 {
    component as u16
}

/// A number of nodes, which `Nodes::new` limits.
#[expect(clippy::cast_possible_truncation, reason = "limited by Nodes::new")]
pub(super) const fn number(k: usize) -> u32 {
    k as u32
}
