//! Which nodes of a mask are neighbours.

use super::Nodes;
use super::nodes::{NoNodes, number, pixels_around};

/// Pairs of neighbours between two calls of `cancelled`.
const PAIRS_PER_CHECK: usize = 1 << 16;

impl Nodes {
    pub(super) fn connect(&mut self, cancelled: &dyn Fn() -> bool) -> Result<(), NoNodes> {
        let (width, height) = self.mask.size();
        let mut pairs = Vec::new();
        for y0 in (0..height).step_by(self.stride) {
            if cancelled() {
                return Err(NoNodes::Cancelled);
            }
            for x0 in (0..width).step_by(self.stride) {
                let first = pairs.len();
                for y in y0..height.min(y0 + self.stride) {
                    for x in x0..width.min(x0 + self.stride) {
                        self.pairs_from(x, y, &mut pairs);
                    }
                }
                // Blocks touch along many pixels.
                remove_duplicates(&mut pairs, first);
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
        self.list_neighbours(&pairs, cancelled)
    }

    /// The neighbours of each node, ascending, from pairs that may be repeated.
    fn list_neighbours(
        &mut self,
        pairs: &[(u32, u32)],
        cancelled: &dyn Fn() -> bool,
    ) -> Result<(), NoNodes> {
        let mut end = vec![0_u32; self.positions.len() + 1];
        for (a, b) in pairs {
            end[*a as usize + 1] += 1;
            end[*b as usize + 1] += 1;
        }
        for k in 1..end.len() {
            end[k] += end[k - 1];
        }
        let mut all = vec![0; 2 * pairs.len()];
        for pairs in pairs.chunks(PAIRS_PER_CHECK) {
            if cancelled() {
                return Err(NoNodes::Cancelled);
            }
            for (a, b) in pairs {
                for (from, to) in [(a, b), (b, a)] {
                    let at = &mut end[*from as usize];
                    all[*at as usize] = *to;
                    *at += 1;
                }
            }
        }
        // `end[k]` began as the start of what node k has, and has moved to its end.
        self.first_neighbour = Vec::with_capacity(end.len());
        let (mut first, mut kept) = (0, 0);
        for (node, end) in end[..self.positions.len()].iter().enumerate() {
            if node.is_multiple_of(PAIRS_PER_CHECK) && cancelled() {
                return Err(NoNodes::Cancelled);
            }
            let own = first..*end as usize;
            first = own.end;
            all[own.clone()].sort_unstable();
            self.first_neighbour.push(number(kept));
            let mut last = None;
            for at in own {
                if last != Some(all[at]) {
                    last = Some(all[at]);
                    all[kept] = all[at];
                    kept += 1;
                }
            }
        }
        self.first_neighbour.push(number(kept));
        all.truncate(kept);
        all.shrink_to_fit();
        self.neighbours = all;
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
}

/// Of the pairs from the first one on, keeps one of those that are equal.
fn remove_duplicates(pairs: &mut Vec<(u32, u32)>, first: usize) {
    pairs[first..].sort_unstable();
    let mut kept = first;
    for at in first..pairs.len() {
        if kept == first || pairs[kept - 1] != pairs[at] {
            pairs[kept] = pairs[at];
            kept += 1;
        }
    }
    pairs.truncate(kept);
}
