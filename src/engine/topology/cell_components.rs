//! The connected components of a cell of the cut lattice.

use super::Mask;

/// A pixel that no component has.
pub(super) const NO_COMPONENT: u16 = u16::MAX;

/// The connected components of one cell.
pub(super) struct CellComponents {
    side: usize,
    pub(super) labels: Vec<u16>,
    stack: Vec<(usize, usize)>,
}

impl CellComponents {
    pub(super) fn new(side: usize) -> Self {
        Self {
            side,
            labels: vec![NO_COMPONENT; side * side],
            stack: Vec::new(),
        }
    }

    /// Labels the pixels of a cell; returns the number of components.
    pub(super) fn find(&mut self, mask: &Mask, column: usize, row: usize) -> u16 {
        let (side, (width, height)) = (self.side, mask.size());
        let (x0, y0) = (column * side, row * side);
        let (wide, high) = (side.min(width - x0), side.min(height - y0));
        if mask.is_whole(x0, y0, side) {
            return 1;
        }
        self.labels.fill(NO_COMPONENT);
        let mut count = 0;
        for y in 0..high {
            for x in 0..wide {
                if self.labels[y * side + x] == NO_COMPONENT && mask.is_visible(x0 + x, y0 + y) {
                    self.labels[y * side + x] = count;
                    self.stack.push((x, y));
                    self.flood(mask, [x0, y0], [wide, high], count);
                    count += 1;
                }
            }
        }
        count
    }

    fn flood(&mut self, mask: &Mask, [x0, y0]: [usize; 2], [wide, high]: [usize; 2], label: u16) {
        while let Some((x, y)) = self.stack.pop() {
            let mut reach = |joined: bool, x: usize, y: usize| {
                let at = y * self.side + x;
                if joined && self.labels[at] == NO_COMPONENT {
                    self.labels[at] = label;
                    self.stack.push((x, y));
                }
            };
            let joined = |x: usize, y: usize, down| mask.are_joined(x0 + x, y0 + y, down);
            if x + 1 < wide {
                reach(joined(x, y, false), x + 1, y);
            }
            if x > 0 {
                reach(joined(x - 1, y, false), x - 1, y);
            }
            if y + 1 < high {
                reach(joined(x, y, true), x, y + 1);
            }
            if y > 0 {
                reach(joined(x, y - 1, true), x, y - 1);
            }
        }
    }
}
