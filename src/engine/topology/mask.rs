//! Which pixels of an image belong to its subject, and which of those are connected (mathematics
//! 11.1).

use crate::geometry::Point;

/// What a pixel is to the subject.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Membership {
    /// Nothing is visible there.
    Outside,
    /// Visible, but below the threshold: the antialiased rim. It never connects two parts.
    Rim,
    /// Part of the subject.
    Inside,
}

/// The mask of an image: pixels of the subject, and the rim that is attached to them.
///
/// Pixels inside are joined to their four neighbours inside. A pixel of the rim is attached to one
/// neighbour, breadth first. It belongs to the pixel inside at which its attachments end, and two
/// neighbours of which one is rim are joined if these pixels are: so the rim never joins two parts.
/// Rim that touches no pixel inside is a part of its own.
#[derive(Debug)]
pub struct Mask {
    width: usize,
    height: usize,
    inside: usize,
    /// One byte per pixel: see the constants.
    pixels: Vec<u8>,
}

/// Nothing is drawn.
const OUTSIDE: u8 = 0;
/// 1 to here: inside, with this Chebyshev distance from the nearest pixel that is not. The border
/// of the image does not count, since no path leaves the image.
const LARGEST_CLEARANCE: u8 = 249;
/// Rim that is not attached yet; afterwards there is none.
const UNATTACHED: u8 = 250;
/// Rim that is attached to its right, left, lower, upper neighbour.
const ATTACHED: [u8; 4] = [251, 252, 253, 254];
/// Rim that touches nothing, and that other rim is attached to.
const STRAY: u8 = 255;
/// The same neighbours.
const AROUND: [(isize, isize); 4] = [(1, 0), (-1, 0), (0, 1), (0, -1)];
/// A crossing this near to the corner of a pixel passes through the corner, px.
const ON_CORNER: f64 = 1e-9;
/// Positions are moved this far from the border of their pixel before a line of sight is drawn, px.
pub(super) const INTO_PIXEL: f64 = 1e-6;

impl Mask {
    /// Bytes that the mask of an image takes, with what its construction needs.
    #[must_use]
    pub const fn bytes_for(width: u32, height: u32) -> u64 {
        // One per pixel, and four for each pixel of the rim: at most all.
        5 * width as u64 * height as u64
    }

    /// The mask of an image; `row` fills the memberships of the pixels of a row. `None` when
    /// cancelled.
    pub fn new(
        width: u32,
        height: u32,
        mut row: impl FnMut(u32, &mut [Membership]),
        cancelled: &dyn Fn() -> bool,
    ) -> Option<Self> {
        let [w, h] = [width as usize, height as usize];
        let mut pixels = vec![OUTSIDE; w * h];
        let mut inside = 0;
        let mut memberships = vec![Membership::Outside; w];
        for (y, pixels) in (0..height).zip(pixels.chunks_exact_mut(w)) {
            if cancelled() {
                return None;
            }
            row(y, &mut memberships);
            for (pixel, membership) in pixels.iter_mut().zip(&memberships) {
                *pixel = match membership {
                    Membership::Outside => OUTSIDE,
                    Membership::Rim => UNATTACHED,
                    Membership::Inside => {
                        inside += 1;
                        LARGEST_CLEARANCE
                    }
                };
            }
        }
        let mut mask = Self {
            width: w,
            height: h,
            inside,
            pixels,
        };
        mask.measure_clearance();
        mask.attach_rim(cancelled)?;
        Some(mask)
    }

    /// Two passes over all pixels: the Chebyshev distance from the nearest pixel that is not
    /// inside.
    fn measure_clearance(&mut self) {
        let (w, h) = (self.width, self.height);
        let near = |pixels: &[u8], x: usize, at: usize, back: bool| {
            let value = |index: usize| match pixels[index] {
                OUTSIDE | UNATTACHED.. => 0,
                clearance => clearance,
            };
            // The four neighbours that this pass has visited.
            let mut least = LARGEST_CLEARANCE - 1;
            let row = if back { at + w } else { at.wrapping_sub(w) };
            let has_row = row < pixels.len();
            if has_row {
                least = least.min(value(row));
            }
            if x > 0 {
                if has_row {
                    least = least.min(value(row - 1));
                }
                if !back {
                    least = least.min(value(at - 1));
                }
            }
            if x + 1 < w {
                if has_row {
                    least = least.min(value(row + 1));
                }
                if back {
                    least = least.min(value(at + 1));
                }
            }
            least + 1
        };
        for at in 0..w * h {
            if self.is_inside_at(at) {
                self.pixels[at] = near(&self.pixels, at % w, at, false);
            }
        }
        for at in (0..w * h).rev() {
            if self.is_inside_at(at) {
                self.pixels[at] = self.pixels[at].min(near(&self.pixels, at % w, at, true));
            }
        }
    }

    /// Attaches the rim, breadth first from the pixels inside in row order, and then from the first
    /// pixel of each part that has none.
    fn attach_rim(&mut self, cancelled: &dyn Fn() -> bool) -> Option<()> {
        let (mut front, mut next) = (Vec::new(), Vec::new());
        for at in 0..self.pixels.len() {
            if self.is_inside_at(at) {
                self.attach_neighbours(at, &mut front);
            }
        }
        let mut at = 0;
        loop {
            while !front.is_empty() {
                if cancelled() {
                    return None;
                }
                for at in front.drain(..) {
                    self.attach_neighbours(at, &mut next);
                }
                std::mem::swap(&mut front, &mut next);
            }
            while at < self.pixels.len() && self.pixels[at] != UNATTACHED {
                at += 1;
            }
            if at == self.pixels.len() {
                return Some(());
            }
            self.pixels[at] = STRAY;
            self.attach_neighbours(at, &mut front);
            at += 1;
        }
    }

    fn attach_neighbours(&mut self, at: usize, found: &mut Vec<usize>) {
        for (side, (dx, dy)) in AROUND.into_iter().enumerate() {
            if let Some(neighbour) = self.beside(at, dx, dy)
                && self.pixels[neighbour] == UNATTACHED
            {
                // Its right neighbour is the one whose left neighbour it is.
                self.pixels[neighbour] = ATTACHED[side ^ 1];
                found.push(neighbour);
            }
        }
    }

    /// The pixel beside another one, if the image has it.
    fn beside(&self, at: usize, dx: isize, dy: isize) -> Option<usize> {
        let x = (at % self.width).checked_add_signed(dx)?;
        let y = (at / self.width).checked_add_signed(dy)?;
        (x < self.width && y < self.height).then(|| y * self.width + x)
    }

    /// Width and height of the image, px.
    #[must_use]
    pub const fn size(&self) -> (usize, usize) {
        (self.width, self.height)
    }

    /// Pixels inside.
    #[must_use]
    pub const fn inside(&self) -> usize {
        self.inside
    }

    /// Whether every pixel is inside.
    #[must_use]
    pub const fn is_everything(&self) -> bool {
        self.inside == self.pixels.len()
    }

    /// Memory of the mask, bytes.
    #[must_use]
    pub const fn bytes(&self) -> u64 {
        self.pixels.len() as u64
    }

    fn is_inside_at(&self, at: usize) -> bool {
        (1..=LARGEST_CLEARANCE).contains(&self.pixels[at])
    }

    /// Whether a pixel is inside; false beyond the image.
    #[must_use]
    pub fn is_inside(&self, x: usize, y: usize) -> bool {
        x < self.width && y < self.height && self.is_inside_at(y * self.width + x)
    }

    /// Whether a pixel is inside or part of the rim.
    #[must_use]
    pub fn is_visible(&self, x: usize, y: usize) -> bool {
        x < self.width && y < self.height && self.pixels[y * self.width + x] != OUTSIDE
    }

    /// Whether a pixel and its right (`down`: lower) neighbour are joined: both are inside, or what
    /// their rim is attached to is.
    #[must_use]
    pub fn are_joined(&self, x: usize, y: usize, down: bool) -> bool {
        let (nx, ny) = (x + usize::from(!down), y + usize::from(down));
        if nx >= self.width || ny >= self.height {
            return false;
        }
        let (a, b) = (y * self.width + x, ny * self.width + nx);
        if self.pixels[a] == OUTSIDE || self.pixels[b] == OUTSIDE {
            return false;
        }
        if self.is_inside_at(a) && self.is_inside_at(b) {
            return true;
        }
        match (self.root(x, y), self.root(nx, ny)) {
            // Rim that touches nothing is its own part.
            (None, None) => true,
            (Some(a), Some(b)) => self.are_near(a, b),
            _ => false,
        }
    }

    /// Whether two pixels inside are the same, or touch, if diagonally then beside a third one
    /// inside.
    fn are_near(&self, (ax, ay): (usize, usize), (bx, by): (usize, usize)) -> bool {
        match (ax.abs_diff(bx), ay.abs_diff(by)) {
            (0 | 1, 0) | (0, 1) => true,
            (1, 1) => self.is_inside(ax, by) || self.is_inside(bx, ay),
            _ => false,
        }
    }

    /// The pixel inside to which a visible pixel belongs: itself, or the end of its attachments.
    /// `None` of rim that touches no pixel inside.
    #[must_use]
    pub fn root(&self, x: usize, y: usize) -> Option<(usize, usize)> {
        let mut at = y * self.width + x;
        loop {
            if self.is_inside_at(at) {
                return Some((at % self.width, at / self.width));
            }
            let side = ATTACHED.iter().position(|to| *to == self.pixels[at])?;
            let (dx, dy) = AROUND[side];
            at = self.beside(at, dx, dy)?;
        }
    }

    /// The pixel inside that has a position, or whose border has it; otherwise the nearest one
    /// within a distance, px. Of equally near ones the first in row order.
    #[must_use]
    pub fn pixel_at(&self, v: Point, within: f64) -> Option<(usize, usize)> {
        let (x, y) = (floor(v.x), floor(v.y));
        let reach = 1 + floor(within);
        let mut best = None;
        for py in y.saturating_sub(reach)..=y.saturating_add(reach) {
            for px in x.saturating_sub(reach)..=x.saturating_add(reach) {
                if let (Ok(ux), Ok(uy)) = (usize::try_from(px), usize::try_from(py))
                    && self.is_inside(ux, uy)
                {
                    // The pixel of the position itself wins over those that only touch it.
                    let own = (px, py) == (x, y);
                    let distance = if own {
                        -1.0
                    } else {
                        nearest_of_pixel((ux, uy), v, 0.0).distance(v)
                    };
                    if distance <= within && best.is_none_or(|(least, _)| distance < least) {
                        best = Some((distance, (ux, uy)));
                    }
                }
            }
        }
        best.map(|(_, pixel)| pixel)
    }

    fn clearance(&self, x: usize, y: usize) -> usize {
        match self.pixels[y * self.width + x] {
            OUTSIDE | UNATTACHED.. => 0,
            clearance => clearance as usize,
        }
    }

    /// Whether the segment between two positions inside stays inside: it crosses no pixel that is
    /// not, and passes the corner of two such pixels only beside a third one. O(1) far from the
    /// border of the mask, at most O(length).
    #[must_use]
    pub fn sees(&self, a: Point, b: Point) -> bool {
        let (dx, dy) = (b.x - a.x, b.y - a.y);
        let steep = dy.abs() > dx.abs();
        // Along the axis in which the segment is longer, from left to right: columns of pixels in
        // which it touches two at most.
        let turn = |v: Point| if steep { (v.y, v.x) } else { (v.x, v.y) };
        let (mut from, mut to) = (turn(a), turn(b));
        if from.0 > to.0 {
            std::mem::swap(&mut from, &mut to);
        }
        let length = to.0 - from.0;
        let slope = if length > 0.0 {
            (to.1 - from.1) / length
        } else {
            0.0
        };
        let at = |u: f64| from.1 + slope * (u - from.0);
        let clearance = |u: i64, v: i64| {
            let (x, y) = if steep { (v, u) } else { (u, v) };
            match (usize::try_from(x), usize::try_from(y)) {
                (Ok(x), Ok(y)) if x < self.width && y < self.height => self.clearance(x, y),
                _ => 0,
            }
        };
        let (mut u, last) = (floor(from.0), floor(to.0));
        let mut row = floor(from.1);
        loop {
            let here = clearance(u, row);
            if here == 0 {
                return false;
            }
            if here > 2 {
                // Everything within `here - 1` pixels is inside, and the segment rises by one pixel
                // a column at most.
                let skipped = i64::try_from(here - 1).unwrap_or(1);
                if u + skipped > last {
                    return true;
                }
                u += skipped;
                row = floor(at(u as f64));
                continue;
            }
            let end = if u == last { to.1 } else { at((u + 1) as f64) };
            let corner = end.round();
            let through_corner = u < last && (end - corner).abs() < ON_CORNER;
            let (side, next) = if through_corner {
                // Rising segments leave the column below the corner, falling ones above it.
                #[expect(clippy::cast_possible_truncation, reason = "positions of an image")]
                let corner = corner as i64;
                if slope > 0.0 {
                    (corner - 1, corner)
                } else {
                    (corner, corner - i64::from(slope < 0.0))
                }
            } else {
                (floor(end), floor(end))
            };
            if side != row && clearance(u, side) == 0 {
                return false;
            }
            if u == last {
                return true;
            }
            if next != side && clearance(u, next) == 0 && clearance(u + 1, side) == 0 {
                return false;
            }
            (u, row) = (u + 1, next);
        }
    }
}

/// The position of a pixel that is nearest to `v`, `margin` from its border.
pub(super) fn nearest_of_pixel((x, y): (usize, usize), v: Point, margin: f64) -> Point {
    let (x, y) = (x as f64, y as f64);
    Point::new(
        v.x.clamp(x + margin, x + 1.0 - margin),
        v.y.clamp(y + margin, y + 1.0 - margin),
    )
}

/// The largest whole number that is not greater; saturates.
pub(super) fn floor(v: f64) -> i64 {
    #[expect(clippy::cast_possible_truncation, reason = "saturates")]
    let floor = v.floor() as i64;
    floor
}
