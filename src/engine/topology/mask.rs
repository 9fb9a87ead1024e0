//! Which pixels of an image belong to its subject, and which of those are connected (mathematics
//! 11.1).

use super::pixel::{floor, nearest_of_pixel};
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
/// neighbour, breadth first. It belongs to the pixel inside at which its attachments end, its root,
/// and two neighbours of which one is rim are joined if these pixels are: so the rim never joins
/// two parts. Rim that touches no pixel inside is stray, a part of its own. If all pixels of such a
/// part lie within 16 px of pixels inside, it is dust that goes with them: the root of each is the
/// nearest one inside.
#[derive(Debug)]
pub struct Mask {
    pub(super) width: usize,
    pub(super) height: usize,
    inside: usize,
    /// The steps that a line of sight takes for each px on the average.
    steps_per_px: f64,
    /// One byte per pixel: see the constants.
    pub(super) pixels: Vec<u8>,
    /// The pixels of the rim row by row, and the first of each row.
    pub(super) rim: Vec<RimPixel>,
    first_of_row: Vec<u32>,
}

/// A pixel that is visible and not inside.
#[derive(Clone, Copy, Debug)]
pub(super) struct RimPixel {
    pub(super) x: u32,
    /// The pixel inside to which it belongs, counted row by row, or [`UNATTACHED`].
    pub(super) root: u32,
}

/// Nothing is drawn.
const OUTSIDE: u8 = 0;
/// 1 to here: inside, with this Chebyshev distance from the nearest pixel that is not. The border
/// of the image does not count, since no path leaves the image.
const LARGEST_CLEARANCE: u8 = 249;
/// Visible, and not inside.
const RIM: u8 = 250;
/// The same, and it touches nothing but its like.
pub(super) const STRAY: u8 = 251;
/// The root of rim that is not attached yet, and of stray rim that goes with nothing.
pub(super) const UNATTACHED: u32 = u32::MAX;
/// The neighbours to the right, left, below, above.
pub(super) const AROUND: [(isize, isize); 4] = [(1, 0), (-1, 0), (0, 1), (0, -1)];
/// Pixels after which cancellation is asked for.
pub(super) const PIXELS_PER_CHECK: usize = 1 << 16;

impl Mask {
    /// Bytes that the mask of an image takes, of whose pixels `rim` are rim, with what its
    /// construction needs.
    #[must_use]
    pub const fn bytes_for(width: u32, height: u32, rim: u64) -> u64 {
        // The rim twice, since vectors grow by doubling, and the fronts from which it is attached;
        // rows, and the pixels inside above a row.
        width as u64 * height as u64 + 24 * rim + 8 * height as u64 + 4 * width as u64
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
        let mut mask = Self {
            width: w,
            height: h,
            inside: 0,
            steps_per_px: 0.0,
            pixels: Vec::with_capacity(w * h),
            rim: Vec::new(),
            first_of_row: vec![0],
        };
        let mut memberships = vec![Membership::Outside; w];
        for y in 0..height {
            if cancelled() {
                return None;
            }
            row(y, &mut memberships);
            for (x, membership) in (0..).zip(&memberships) {
                mask.pixels.push(match membership {
                    Membership::Outside => OUTSIDE,
                    Membership::Rim => {
                        let root = UNATTACHED;
                        mask.rim.push(RimPixel { x, root });
                        RIM
                    }
                    Membership::Inside => {
                        mask.inside += 1;
                        LARGEST_CLEARANCE
                    }
                });
            }
            mask.first_of_row.push(number(mask.rim.len()));
        }
        mask.measure_clearance(cancelled)?;
        mask.attach_rim(cancelled)?;
        mask.attach_stray(cancelled)?;
        Some(mask)
    }

    /// Two passes over all pixels: the Chebyshev distance from the nearest pixel that is not
    /// inside.
    fn measure_clearance(&mut self, cancelled: &dyn Fn() -> bool) -> Option<()> {
        for y in 0..self.height {
            if cancelled() {
                return None;
            }
            for x in 0..self.width {
                self.lower_clearance(x, y, false);
            }
        }
        let mut pixels_of = [0_u64; 1 + LARGEST_CLEARANCE as usize];
        for y in (0..self.height).rev() {
            if cancelled() {
                return None;
            }
            for x in (0..self.width).rev() {
                self.lower_clearance(x, y, true);
                pixels_of[self.clearance(x, y)] += 1;
            }
        }
        let steps = |clearance: usize| 1.0 / (clearance.max(2) - 1) as f64;
        let all: f64 = (1..)
            .zip(&pixels_of[1..])
            .map(|(clearance, pixels)| *pixels as f64 * steps(clearance))
            .sum();
        self.steps_per_px = all / self.inside.max(1) as f64;
        Some(())
    }

    /// Compares a pixel inside with the four neighbours that this pass has visited.
    fn lower_clearance(&mut self, x: usize, y: usize, back: bool) {
        let at = y * self.width + x;
        if !self.is_inside_at(at) {
            return;
        }
        let value = |index: usize| match self.pixels[index] {
            OUTSIDE | RIM.. => 0,
            clearance => clearance,
        };
        let mut least = LARGEST_CLEARANCE - 1;
        let (has_left, has_right) = (x > 0, x + 1 < self.width);
        let row = if back {
            at + self.width
        } else {
            at.wrapping_sub(self.width)
        };
        if row < self.pixels.len() {
            least = least.min(value(row));
            if has_left {
                least = least.min(value(row - 1));
            }
            if has_right {
                least = least.min(value(row + 1));
            }
        }
        if has_left && !back {
            least = least.min(value(at - 1));
        }
        if has_right && back {
            least = least.min(value(at + 1));
        }
        self.pixels[at] = self.pixels[at].min(least + 1);
    }

    /// Attaches the rim, breadth first from the pixels inside in row order.
    fn attach_rim(&mut self, cancelled: &dyn Fn() -> bool) -> Option<()> {
        let (mut front, mut next) = (Vec::new(), Vec::new());
        for y in 0..self.height {
            if cancelled() {
                return None;
            }
            for at in y * self.width..(y + 1) * self.width {
                // Pixels that are farther from what is not inside touch none of it.
                if self.pixels[at] == 1 {
                    self.attach_neighbours(at, &mut front);
                }
            }
        }
        while !front.is_empty() {
            for (k, at) in front.drain(..).enumerate() {
                if k.is_multiple_of(PIXELS_PER_CHECK) && cancelled() {
                    return None;
                }
                self.attach_neighbours(at as usize, &mut next);
            }
            std::mem::swap(&mut front, &mut next);
        }
        Some(())
    }

    /// The rim of a row.
    pub(super) fn rim_of_row(&self, y: usize) -> std::ops::Range<usize> {
        self.first_of_row[y] as usize..self.first_of_row[y + 1] as usize
    }

    fn attach_neighbours(&mut self, at: usize, found: &mut Vec<u32>) {
        let root = match self.rim_at(at) {
            Some(rim) => self.rim[rim].root,
            None => number(at),
        };
        for (dx, dy) in AROUND {
            if let Some(neighbour) = self.beside(at, dx, dy)
                && let Some(rim) = self.rim_at(neighbour)
                && self.rim[rim].root == UNATTACHED
            {
                self.rim[rim].root = root;
                found.push(number(neighbour));
            }
        }
    }

    /// The index of a pixel of the rim among all.
    pub(super) fn rim_at(&self, at: usize) -> Option<usize> {
        if self.pixels[at] < RIM {
            return None;
        }
        let (x, row) = (number(at % self.width), self.rim_of_row(at / self.width));
        let found = self.rim[row.clone()].binary_search_by_key(&x, |rim| rim.x);
        found.ok().map(|found| row.start + found)
    }

    /// The pixel beside another one, if the image has it.
    pub(super) fn beside(&self, at: usize, dx: isize, dy: isize) -> Option<usize> {
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
    pub fn bytes(&self) -> u64 {
        (self.pixels.len()
            + size_of::<RimPixel>() * self.rim.capacity()
            + size_of_val(&*self.first_of_row)) as u64
    }

    /// Steps of a line of sight between two positions of the mask: about as many as it has at most.
    #[must_use]
    pub fn sight_steps(&self) -> u64 {
        let side = self.width.max(self.height) as f64;
        #[expect(
            clippy::cast_possible_truncation,
            clippy::cast_sign_loss,
            reason = "at most the side of an image"
        )]
        let steps = (side * self.steps_per_px).ceil() as u64;
        steps
    }

    /// Whether all pixels of a square with this first pixel are inside, as far as its middle shows;
    /// those beyond the image do not count.
    pub(super) fn is_whole(&self, x: usize, y: usize, side: usize) -> bool {
        let half = side / 2;
        let [x, y] = [
            (x + half).min(self.width - 1),
            (y + half).min(self.height - 1),
        ];
        self.clearance(x, y) > half
    }

    pub(super) fn is_inside_at(&self, at: usize) -> bool {
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
        // Stray rim touches nothing but its like, and they are one part.
        if self.is_inside_at(a) && self.is_inside_at(b) || self.pixels[a] == STRAY {
            return true;
        }
        let roots = self.root(x, y).zip(self.root(nx, ny));
        roots.is_some_and(|(a, b)| self.are_near(a, b))
    }

    /// Whether a pixel is rim that touches no pixel inside, and no rim that touches one.
    #[must_use]
    pub fn is_stray(&self, x: usize, y: usize) -> bool {
        x < self.width && y < self.height && self.pixels[y * self.width + x] == STRAY
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

    /// The pixel inside to which a visible pixel belongs: itself, or the end of its attachments, or
    /// of stray rim the nearest one. `None` of stray rim that is far from all.
    #[must_use]
    pub fn root(&self, x: usize, y: usize) -> Option<(usize, usize)> {
        let at = y * self.width + x;
        let root = match self.rim_at(at) {
            None => self.is_inside_at(at).then_some(at)?,
            Some(rim) => match self.rim[rim].root {
                UNATTACHED => return None,
                root => root as usize,
            },
        };
        Some((root % self.width, root / self.width))
    }

    /// The pixel inside that has a position, or whose border has it; otherwise the nearest one
    /// within a distance, px. Of equally near ones the first in row order.
    #[must_use]
    pub fn pixel_at(&self, v: Point, within: f64) -> Option<(usize, usize)> {
        let (x, y) = (floor(v.x), floor(v.y));
        // The pixel of the position itself wins over those that only touch it.
        if let (Ok(x), Ok(y)) = (usize::try_from(x), usize::try_from(y))
            && self.is_inside(x, y)
        {
            return Some((x, y));
        }
        let reach = 1 + floor(within);
        let mut best = None;
        for py in y.saturating_sub(reach)..=y.saturating_add(reach) {
            for px in x.saturating_sub(reach)..=x.saturating_add(reach) {
                if let (Ok(ux), Ok(uy)) = (usize::try_from(px), usize::try_from(py))
                    && self.is_inside(ux, uy)
                {
                    let distance = nearest_of_pixel((ux, uy), v, 0.0).distance(v);
                    if distance <= within && best.is_none_or(|(least, _)| distance < least) {
                        best = Some((distance, (ux, uy)));
                    }
                }
            }
        }
        best.map(|(_, pixel)| pixel)
    }

    pub(super) fn clearance(&self, x: usize, y: usize) -> usize {
        self.clearance_at(y * self.width + x)
    }

    /// The same of a pixel that is counted row by row.
    pub(super) fn clearance_at(&self, at: usize) -> usize {
        match self.pixels[at] {
            OUTSIDE | RIM.. => 0,
            clearance => clearance as usize,
        }
    }
}

/// The number of a pixel: images have fewer than 2^32.
#[expect(clippy::cast_possible_truncation, reason = "limited by the image")]
pub(super) const fn number(pixel: usize) -> u32 {
    pixel as u32
}
