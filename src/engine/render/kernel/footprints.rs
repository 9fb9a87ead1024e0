//! Footprints of eight pixels at a time, and the positions of their samples (`footprint` says what
//! they are): f32 in a fixed order, so all levels give the same bits. Most pixels of a marked cell
//! need one sample, which is seen without a root or a division. Cost: about 15 ns per pixel with
//! more samples.

#![expect(
    clippy::cast_possible_truncation,
    clippy::cast_precision_loss,
    reason = "columns and rows of a grid are exact in f32"
)]
#![expect(clippy::cast_possible_wrap, reason = "numbers up to 16")]
#![expect(
    clippy::inline_always,
    reason = "instruction sets are chosen by the caller into which these are inlined"
)]

use super::rounding::ROUND_F32;

/// The shrinking up to which a position is sampled as a point.
const POINT_SHRINKING: f32 = 1.5;
/// The shrinking from which the whole footprint is averaged.
const FULL_SHRINKING: f32 = 2.0;
/// Longest side of a footprint, px of the source for a px of the posed plane.
const LONGEST_SIDE_PX: f32 = 64.0;
/// Most samples of a pixel.
pub(in crate::render) const MAX_FOOTPRINT_SAMPLES: usize = 16;
/// Largest distance of samples, px of the image from which they are read.
const MAX_SAMPLE_DISTANCE_PX: f32 = 1.5;
/// Pixels that are looked at together.
pub(in crate::render) const GROUP_PIXELS: usize = 64;
/// Pixels with the same number of samples that a batch holds.
pub(in crate::render) const BATCH: usize = 2 * GROUP_PIXELS;
/// Different numbers of samples.
pub(in crate::render) const KINDS: usize = MAX_FOOTPRINT_SAMPLES.ilog2() as usize;
/// Pixels that compilers process together: passes are over whole groups, because the rest would be
/// processed one by one.
const LANES: usize = 8;
/// Smaller by more than rounding changes an area, up to [`MOST_STRETCHED`].
const ONE_SAMPLE_MARGIN: f32 = 0.99;
/// Squared sides of a cell's Jacobians, added up, from which it keeps its mark.
const MOST_STRETCHED: f32 = 1600.0;

/// The Jacobians of a mesh that shrinks the source somewhere.
#[derive(Debug)]
pub(in crate::render) struct FootprintGrid {
    pub(in crate::render) columns: usize,
    pub(in crate::render) rows: usize,
    /// At the corners of marked cells, `[rows][columns]`: derivatives of the posed position by the
    /// rest position, of x and y along x, of x and y along y.
    pub(in crate::render) jacobians: Vec<[f32; 4]>,
    /// 1 for the cells that may shrink the source and those beside them, else 0, `[rows][columns]`.
    pub(in crate::render) marked: Vec<u8>,
    /// The sampler's coordinate of the first column and row, and cells per unit.
    pub(in crate::render) origin: [f32; 2],
    pub(in crate::render) cells: [f32; 2],
    /// The sampler's coordinates per px of the source for a px of the target.
    pub(in crate::render) scale: [[f32; 2]; 2],
    /// [`one_sample_up_to`] this scale.
    pub(in crate::render) limit: f32,
}

/// Pixels that need several samples.
#[derive(Debug, Default)]
pub(in crate::render) struct FootprintBatch {
    /// Pixels in marked cells, which are not looked at yet.
    waiting: Box<WaitingPixels>,
    /// By the number of samples, 2, 4, 8 and 16; first those whose samples are read from the
    /// image itself, then the others.
    pub(in crate::render) alike: [Box<Alike>; 2 * KINDS],
    /// Kept, because zeroing it costs as much as a pass.
    lanes: Box<FootprintArrays>,
}

impl FootprintBatch {
    /// The number of pixels that wait for [`shapes`].
    pub(in crate::render) fn waiting(&self) -> usize {
        self.waiting.len
    }
}

/// Pixels in marked cells, across runs and rows: a run has 18 on average, and passes over so few
/// mostly consist of their ends.
#[derive(Debug)]
struct WaitingPixels {
    len: usize,
    /// Their indices in the band.
    pixels: [usize; 2 * GROUP_PIXELS],
    places: [[f32; 2]; 2 * GROUP_PIXELS],
    jacobians: [[f32; 4]; 2 * GROUP_PIXELS],
}

impl Default for WaitingPixels {
    fn default() -> Self {
        Self {
            len: 0,
            pixels: [0; 2 * GROUP_PIXELS],
            places: [[0.0; 2]; 2 * GROUP_PIXELS],
            jacobians: [[0.0; 4]; 2 * GROUP_PIXELS],
        }
    }
}

/// Pixels that need the same number of samples.
#[derive(Debug)]
pub(in crate::render) struct Alike {
    pub(in crate::render) len: usize,
    /// Their indices in the band.
    pub(in crate::render) pixels: [usize; BATCH],
    /// The samples are read from a copy that is reduced by 2 to this power.
    pub(in crate::render) reductions: [u32; BATCH],
    /// u, v and the sides of the footprint.
    places: [[f32; BATCH]; 6],
    /// Binary logarithm of the number of samples along the first side.
    across: [u32; BATCH],
}

impl Default for Alike {
    fn default() -> Self {
        Self {
            len: 0,
            pixels: [0; BATCH],
            reductions: [0; BATCH],
            places: [[0.0; BATCH]; 6],
            across: [0; BATCH],
        }
    }
}

impl Alike {
    /// Keeps the pixels whose samples are read from the same copy as those of the first, and moves
    /// the others to `rest`.
    pub(in crate::render) fn split(&mut self, rest: &mut Self) {
        let all = std::mem::take(&mut self.len);
        for k in 0..all {
            let (place, shape) = (
                self.places.each_ref().map(|of| of[k]),
                [self.reductions[k], self.across[k]],
            );
            if shape[0] == self.reductions[0] {
                self.push(self.pixels[k], place, shape)
            } else {
                rest.push(self.pixels[k], place, shape)
            }
        }
    }

    /// Appends a pixel.
    #[inline(always)]
    fn push(&mut self, pixel: usize, place: [f32; 6], [reduction, across]: [u32; 2]) {
        let at = self.len;
        assert!(at < BATCH, "there is room");
        self.len += 1;
        for (of, value) in self.places.iter_mut().zip(place) {
            of[at] = value;
        }
        (self.pixels[at], self.reductions[at], self.across[at]) = (pixel, reduction, across);
    }
}

/// The shrinking up to which a footprint certainly needs one sample, where a px of the target is
/// `scale` px of the sampled image: the root of `scale x (x - POINT_SHRINKING) / (FULL_SHRINKING
/// - POINT_SHRINKING) = MAX_SAMPLE_DISTANCE_PX`, less a margin for rounding.
pub(in crate::render) fn one_sample_up_to(scale: f32) -> f32 {
    let share = MAX_SAMPLE_DISTANCE_PX * (FULL_SHRINKING - POINT_SHRINKING) / scale;
    0.999 * (0.5 * POINT_SHRINKING + (0.25 * POINT_SHRINKING * POINT_SHRINKING + share).sqrt())
}

/// Appends the pixels of marked cells to those that wait: of the first `len`, at most
/// [`GROUP_PIXELS`], while fewer than that wait. `u` and `v` hold them and whole groups of
/// [`LANES`], of any values. `first`: index of the first pixel.
#[inline(always)]
pub(super) fn footprints(
    grid: &FootprintGrid,
    (u, v): (&[f32], &[f32]),
    len: usize,
    first: usize,
    batch: &mut FootprintBatch,
) {
    let FootprintBatch { waiting, lanes, .. } = batch;
    let FootprintArrays {
        pixels,
        cells,
        shares: [s, t],
        ..
    } = &mut **lanes;
    let groups = len.next_multiple_of(LANES).min(GROUP_PIXELS);
    let (across, down) = (
        (grid.origin[0], grid.cells[0], grid.columns),
        (grid.origin[1], grid.cells[1], grid.rows),
    );
    let (u, v) = (&u[..groups], &v[..groups]);
    let (cells, s, t) = (&mut cells[..groups], &mut s[..groups], &mut t[..groups]);
    for k in 0..groups {
        let (i, j);
        (i, s[k]) = locate(u[k], across);
        (j, t[k]) = locate(v[k], down);
        cells[k] = i + j * grid.columns as u32;
    }
    // Most pixels lie in cells that shrink nothing, so they are sorted out first. A pixel is always
    // written, and counted if it is marked: without a branch, which would be guessed wrongly along
    // every border of such cells.
    let mut count = 0;
    for (k, cell) in cells[..len].iter().enumerate() {
        pixels[count] = k;
        count += usize::from(grid.marked[*cell as usize]);
    }
    // Jacobians are known at vertices and mixed in between: constant ones in each cell would show
    // its edges in an image that is made smaller.
    let new = waiting.len..waiting.len + count;
    waiting.len += count;
    let appended = waiting.pixels[new.clone()]
        .iter_mut()
        .zip(&mut waiting.places[new.clone()])
        .zip(&mut waiting.jacobians[new]);
    for (((pixel, place), jacobian), k) in appended.zip(&pixels[..count]) {
        let at = cells[*k] as usize;
        let top: &[[f32; 4]; 2] = grid.jacobians[at..]
            .first_chunk()
            .expect("a cell has a right side");
        let bottom: &[[f32; 4]; 2] = grid.jacobians[at + grid.columns..]
            .first_chunk()
            .expect("a cell has a lower side");
        *jacobian = mix(
            &mix(&top[0], &top[1], s[*k]),
            &mix(&bottom[0], &bottom[1], s[*k]),
            t[*k],
        );
        (*pixel, *place) = (first + k, [u[*k], v[*k]]);
    }
}

/// Takes at most [`GROUP_PIXELS`] of the pixels that wait, and appends those that need several
/// samples to their kinds; there must be room for as many of each. Passes over arrays, which
/// compilers vectorise; each keeps fewer pixels.
#[inline(always)]
pub(super) fn shapes(grid: &FootprintGrid, batch: &mut FootprintBatch) {
    let FootprintBatch {
        waiting,
        alike,
        lanes,
    } = batch;
    let FootprintArrays {
        pixels,
        jacobians,
        several,
        shapes,
        ..
    } = &mut **lanes;
    let [xx, yx, xy, yy] = &mut *jacobians;
    let marked = waiting.len.min(GROUP_PIXELS);
    let groups = marked.next_multiple_of(LANES).min(GROUP_PIXELS);
    for k in 0..groups {
        [xx[k], yx[k], xy[k], yy[k]] = waiting.jacobians[k];
    }
    for k in 0..groups {
        let (det, [a, b]) = squares(&[xx[k], yx[k], xy[k], yy[k]]);
        let limit = grid.limit * grid.limit * det * det;
        several[k] = u32::from((a > limit) | (b > limit));
    }
    // Those that need one sample after all are dropped in place: `count` never passes k.
    let mut count = 0;
    for k in 0..marked {
        (xx[count], yx[count], xy[count], yy[count], pixels[count]) =
            (xx[k], yx[k], xy[k], yy[k], k);
        count += several[k] as usize;
    }
    shapes.fill(jacobians, count, &grid.scale);
    for (n, k) in pixels[..count].iter().enumerate() {
        let (across, down) = (shapes.across[n], shapes.down[n]);
        if across + down == 0 {
            continue;
        }
        // Where even the most samples would lie too far apart, they are taken from a smaller copy
        // of the source.
        let reduction = (0..16_u32)
            .find(|r| shapes.distance[n] <= MAX_SAMPLE_DISTANCE_PX * (1_u32 << r) as f32)
            .unwrap_or(16);
        let ([ax, ay, bx, by], [u, v]) = (&shapes.sides, waiting.places[*k]);
        let place = [u, v, ax[n], ay[n], bx[n], by[n]];
        let kind = (across + down) as usize - 1 + KINDS * usize::from(reduction > 0);
        alike[kind].push(waiting.pixels[*k], place, [reduction, across]);
    }
    // The others move to the front: they are fewer than a group.
    let left = marked..waiting.len;
    waiting.len = left.len();
    waiting.pixels.copy_within(left.clone(), 0);
    waiting.places.copy_within(left.clone(), 0);
    waiting.jacobians.copy_within(left, 0);
}

/// Clears the marks of the cells between two lines of vertices in which every pixel certainly
/// needs one sample. `lines`: their Jacobians; `limit`: [`FootprintGrid::limit`].
///
/// Jacobians in between are means of the corners', so their sides are no longer than the longest of
/// the corners', and their area is a mean of the corners' areas and of the mixed areas of each two,
/// at least the least of these.
#[inline(always)]
pub(super) fn unmark(lines: (&[[f32; 4]], &[[f32; 4]]), limit: f32, marked: &mut [u8]) {
    let cells = marked.len();
    let (above, below) = (&lines.0[..=cells], &lines.1[..=cells]);
    let limit = 0.5 * ONE_SAMPLE_MARGIN * limit;
    let most = |a: f32, b: f32| if a > b { a } else { b };
    let least = |a: f32, b: f32| if a < b { a } else { b };
    // Twice the mixed area.
    let both = |a: [f32; 4], b: [f32; 4]| (a[0] * b[3] + b[0] * a[3]) - (a[2] * b[1] + b[2] * a[1]);
    let sides = |[xx, yx, xy, yy]: [f32; 4]| (xx * xx + xy * xy, yy * yy + yx * yx);
    for (i, marked) in marked.iter_mut().enumerate() {
        let [a, b, c, d] = [above[i], above[i + 1], below[i], below[i + 1]];
        let ((ax, ay), (bx, by), (cx, cy), (dx, dy)) = (sides(a), sides(b), sides(c), sides(d));
        let longest = most(
            most(most(ax, ay), most(bx, by)),
            most(most(cx, cy), most(dx, dy)),
        );
        // Unlike the largest, a sum keeps what is not a number.
        let all = ((ax + ay) + (bx + by)) + ((cx + cy) + (dx + dy));
        let areas = [
            both(a, a),
            both(b, b),
            both(c, c),
            both(d, d),
            both(a, b),
            both(a, c),
            both(a, d),
            both(b, c),
            both(b, d),
            both(c, d),
        ];
        let (mut smallest, mut largest) = (areas[0], areas[0]);
        for area in areas {
            (smallest, largest) = (least(smallest, area), most(largest, area));
        }
        // Where the areas have both signs, this is not positive, and the mark stays.
        let area = limit * most(most(smallest, -largest), 0.0);
        let is_one = (longest < area * area) & (all < MOST_STRETCHED);
        *marked &= u8::from(!is_one);
    }
}

/// The positions of `2^log` samples of each pixel: the first samples of all, then the second ones.
#[inline(always)]
pub(super) fn positions(alike: &Alike, log: u32, us: &mut [f32], vs: &mut [f32]) {
    let n = alike.len;
    let [u, v, ax, ay, bx, by] = alike.places.each_ref().map(|of| &of[..n]);
    let (across, reductions) = (&alike.across[..n], &alike.reductions[..n]);
    for sample in 0..1_u32 << log {
        let (us, vs) = (
            &mut us[sample as usize * n..][..n],
            &mut vs[sample as usize * n..][..n],
        );
        for k in 0..n {
            let share = inverse(reductions[k]);
            // 128 times the position, px, is 63.5 larger than the coordinate.
            let reduced = |coordinate: f32| (coordinate + 63.5) * share - 63.5;
            let x = ((sample & !(u32::MAX << across[k])) as i32 as f32 + 0.5) * inverse(across[k])
                - 0.5;
            let y = ((sample >> across[k]) as i32 as f32 + 0.5) * inverse(log - across[k]) - 0.5;
            us[k] = reduced(u[k] + x * ax[k] + y * bx[k]);
            vs[k] = reduced(v[k] + x * ay[k] + y * by[k]);
        }
    }
}

/// The arrays of [`footprints`] and [`shapes`].
#[derive(Debug)]
struct FootprintArrays {
    pixels: [usize; GROUP_PIXELS],
    cells: [u32; GROUP_PIXELS],
    shares: [[f32; GROUP_PIXELS]; 2],
    jacobians: [[f32; GROUP_PIXELS]; 4],
    several: [u32; GROUP_PIXELS],
    shapes: Shapes,
}

impl Default for FootprintArrays {
    fn default() -> Self {
        let shapes = Shapes {
            sides: [[0.0; GROUP_PIXELS]; 4],
            across: [0; GROUP_PIXELS],
            down: [0; GROUP_PIXELS],
            distance: [0.0; GROUP_PIXELS],
        };
        let (pixels, cells, several) = ([0; GROUP_PIXELS], [0; GROUP_PIXELS], [0; GROUP_PIXELS]);
        Self {
            pixels,
            cells,
            shares: [[0.0; GROUP_PIXELS]; 2],
            jacobians: [[0.0; GROUP_PIXELS]; 4],
            several,
            shapes,
        }
    }
}

/// The cell of a position along one axis, and the share of the cell before it.
#[inline(always)]
fn locate(at: f32, (origin, per, lines): (f32, f32, usize)) -> (u32, f32) {
    let (last, most) = ((lines - 2) as f32, (lines - 1) as f32);
    let at = (at - origin) * per;
    // NaN becomes 0.
    let at = if at > 0.0 { at } else { 0.0 };
    let at = if at < most { at } else { most };
    // Conversions of floats to integers are not vectorised, because they saturate.
    let nearest = (at + ROUND_F32) - ROUND_F32;
    let below = if nearest > at { nearest - 1.0 } else { nearest };
    let below = if below < last { below } else { last };
    let inside = at - below;
    (
        (below + ROUND_F32).to_bits() & 0x007f_ffff,
        if inside < 1.0 { inside } else { 1.0 },
    )
}

#[inline(always)]
fn mix(a: &[f32; 4], b: &[f32; 4], share: f32) -> [f32; 4] {
    let mut mixed = [0.0; 4];
    for n in 0..4 {
        mixed[n] = a[n] + share * (b[n] - a[n]);
    }
    mixed
}

/// The area of a Jacobian, and the squared lengths of the sides of its inverse times the area.
#[inline(always)]
fn squares([xx, yx, xy, yy]: &[f32; 4]) -> (f32, [f32; 2]) {
    let det = (xx * yy - xy * yx).abs();
    // Where cells have no area, the longest footprint.
    let det = if det > f32::MIN_POSITIVE {
        det
    } else {
        f32::MIN_POSITIVE
    };
    (det, [yy * yy + yx * yx, xx * xx + xy * xy])
}

/// Footprints: their sides, coordinates of the sampler, and how their samples are arranged: binary
/// logarithms of the numbers along both sides, and their distance, px.
#[derive(Debug)]
struct Shapes {
    sides: [[f32; GROUP_PIXELS]; 4],
    across: [u32; GROUP_PIXELS],
    down: [u32; GROUP_PIXELS],
    distance: [f32; GROUP_PIXELS],
}

impl Shapes {
    #[inline(always)]
    fn fill(&mut self, jacobians: &[[f32; GROUP_PIXELS]; 4], count: usize, scale: &[[f32; 2]; 2]) {
        let [ax, ay, bx, by] = &mut self.sides;
        for k in 0..count.next_multiple_of(LANES).min(GROUP_PIXELS) {
            let [xx, yx, xy, yy] = [
                jacobians[0][k],
                jacobians[1][k],
                jacobians[2][k],
                jacobians[3][k],
            ];
            let (det, [square_a, square_b]) = squares(&[xx, yx, xy, yy]);
            let (a_x, a_y, a) = side((yy, -yx), square_a, det, &scale[0]);
            let (b_x, b_y, b) = side((-xy, xx), square_b, det, &scale[1]);
            let step = |length: f32, power: f32| u32::from(length > MAX_SAMPLE_DISTANCE_PX * power);
            let is_wide = a >= b;
            let (long, short) = (if is_wide { a } else { b }, if is_wide { b } else { a });
            // At most four along the shorter side.
            let few = step(short, 1.0) + step(short, 2.0);
            let many = step(long, 1.0) + step(long, 2.0) + step(long, 4.0) + step(long, 8.0);
            let many = if many < MAX_FOOTPRINT_SAMPLES.ilog2() - few {
                many
            } else {
                MAX_FOOTPRINT_SAMPLES.ilog2() - few
            };
            let (apart, beside) = (long * inverse(many), short * inverse(few));
            self.distance[k] = if apart > beside { apart } else { beside };
            self.across[k] = if is_wide { many } else { few };
            self.down[k] = if is_wide { few } else { many };
            (ax[k], ay[k], bx[k], by[k]) = (a_x, a_y, b_x, b_y);
        }
    }
}

/// A side of a footprint and its length, px.
#[inline(always)]
fn side((x, y): (f32, f32), square: f32, det: f32, scale: &[f32; 2]) -> (f32, f32, f32) {
    let raw = square.sqrt();
    let own = raw / det;
    let own = if own < LONGEST_SIDE_PX {
        own
    } else {
        LONGEST_SIDE_PX
    };
    let share = (own - POINT_SHRINKING) * (1.0 / (FULL_SHRINKING - POINT_SHRINKING));
    let share = if share > 0.0 { share } else { 0.0 };
    let grown = own * if share < 1.0 { share } else { 1.0 };
    let factor = if raw > 0.0 { grown / raw } else { 0.0 };
    let (x, y) = (x * factor * scale[0], y * factor * scale[1]);
    (x, y, (x * x + y * y).sqrt() * (1.0 / 128.0))
}

/// 2 to the power of `-log`.
#[inline(always)]
fn inverse(log: u32) -> f32 {
    f32::from_bits((127 - log) << 23)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn cells_without_marks_have_one_sample_everywhere() {
        let mut random = 1_u32;
        let mut share = || {
            random = random.wrapping_mul(1_664_525).wrapping_add(1_013_904_223);
            (random >> 8) as f32 / (1 << 24) as f32
        };
        let (limit, mut unmarked) = (one_sample_up_to(1.0), 0);
        for round in 0..2000 {
            // From nearly equal corners, turned or mirrored, to any.
            let (spread, turn, size) = (2.0 * share() * share(), 6.3 * share(), 2.0 * share());
            let flip = if round % 2 == 0 { 1.0 } else { -1.0 };
            let mean = [
                turn.cos(),
                turn.sin(),
                -flip * turn.sin(),
                flip * turn.cos(),
            ];
            let corners: [[f32; 4]; 4] =
                std::array::from_fn(|_| mean.map(|value| size * value + spread * (share() - 0.5)));
            let mut marked = [1];
            unmark((&corners[..2], &corners[2..]), limit, &mut marked);
            unmarked += u32::from(marked == [0]);
            for at in 0..121_u8 {
                let (s, t) = (f32::from(at % 11) / 10.0, f32::from(at / 11) / 10.0);
                let (top, bottom) = (
                    mix(&corners[0], &corners[1], s),
                    mix(&corners[2], &corners[3], s),
                );
                let (det, [a, b]) = squares(&mix(&top, &bottom, t));
                let needs_several = a.max(b) > limit * limit * det * det;
                assert!(marked == [1] || !needs_several, "{corners:?} at {s}, {t}");
            }
        }
        assert!((200..1800).contains(&unmarked), "{unmarked} of 2000");
        let mut marked = [1];
        unmark(
            (&[[f32::NAN; 4]; 2], &[[1.0, 0.0, 0.0, 1.0]; 2]),
            limit,
            &mut marked,
        );
        assert_eq!(marked, [1], "what is not a number keeps its mark");
    }
}
