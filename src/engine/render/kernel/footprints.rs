//! Footprints of eight pixels at a time, and the positions of their samples (`footprint` says what they are): f32 in a fixed order, so all
//! levels give the same bits. Most pixels of a marked cell need one sample, which is seen without a root or a division. Cost: about 15 ns
//! per pixel with more samples.

#![expect(clippy::cast_possible_truncation, clippy::cast_precision_loss, reason = "columns and rows of a grid are exact in f32")]
#![expect(clippy::cast_possible_wrap, clippy::cast_sign_loss, reason = "binary logarithms and numbers up to 16")]
#![expect(clippy::needless_range_loop, reason = "lanes of several arrays")]
#![expect(clippy::inline_always, reason = "instruction sets are chosen by the caller into which these are inlined")]

use super::scalar::ROUND_F32;

/// The shrinking up to which a position is sampled as a point.
const LEAST: f32 = 1.5;
/// The shrinking from which the whole footprint is averaged.
const FULL: f32 = 2.0;
/// Longest side of a footprint, px of the source for a px of the posed plane.
const LONGEST: f32 = 64.0;
/// Most samples of a pixel.
pub(in crate::render) const MOST: usize = 16;
/// Largest distance of samples, px of the picture from which they are read.
const APART: f32 = 1.5;
/// Pixels that are processed together.
const LANES: usize = 8;
/// Positions that a batch holds.
pub(in crate::render) const BATCH: usize = 2048;

/// The Jacobians of a mesh that shrinks the source somewhere.
#[derive(Debug)]
pub(in crate::render) struct FootprintGrid {
    pub(in crate::render) columns: usize,
    pub(in crate::render) rows: usize,
    /// At the corners of marked cells, `[rows][columns]`: derivatives of the posed position by the rest position, of x and y along x, of x
    /// and y along y.
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

/// Positions of samples, in the order of the pixels that they belong to.
#[derive(Debug)]
pub(in crate::render) struct FootprintBatch {
    pub(in crate::render) u: Vec<f32>,
    pub(in crate::render) v: Vec<f32>,
    pub(in crate::render) len: usize,
    pub(in crate::render) pixels: Vec<Averaged>,
}

/// A pixel that is the mean of several samples.
#[derive(Clone, Copy, Debug)]
pub(in crate::render) struct Averaged {
    /// Its index in the run.
    pub(in crate::render) pixel: usize,
    /// A power of two.
    pub(in crate::render) count: usize,
    /// The samples are read from a copy that is reduced by 2 to this power.
    pub(in crate::render) reduction: u32,
}

impl Default for FootprintBatch {
    fn default() -> Self {
        Self { u: vec![0.0; BATCH], v: vec![0.0; BATCH], len: 0, pixels: Vec::new() }
    }
}

/// The shrinking up to which a footprint certainly needs one sample, where a px of the target is `scale` px of the sampled picture: the
/// root of `scale x (x - LEAST) / (FULL - LEAST) = APART`, less a margin for rounding.
pub(in crate::render) fn one_sample_up_to(scale: f32) -> f32 {
    let share = APART * (FULL - LEAST) / scale;
    0.999 * (0.5 * LEAST + (0.25 * LEAST * LEAST + share).sqrt())
}

/// Appends the positions of the samples of every pixel that needs more than one. `first`: index of the first pixel. There must be room for
/// [`MOST`] positions of each.
#[inline(always)]
pub(super) fn footprints(grid: &FootprintGrid, u: &[f32], v: &[f32], first: usize, batch: &mut FootprintBatch) {
    let ((us, u_rest), (vs, v_rest)) = (u.as_chunks::<LANES>(), v.as_chunks::<LANES>());
    for (k, (u, v)) in us.iter().zip(vs).enumerate() {
        group(grid, u, v, (first + k * LANES, LANES), batch);
    }
    if !u_rest.is_empty() {
        let (mut u, mut v) = ([0.0; LANES], [0.0; LANES]);
        u[..u_rest.len()].copy_from_slice(u_rest);
        v[..v_rest.len()].copy_from_slice(v_rest);
        group(grid, &u, &v, (first + us.len() * LANES, u_rest.len()), batch);
    }
}

/// Cells along one axis, and the positions in them.
#[inline(always)]
fn locate(coordinates: &[f32; LANES], origin: f32, cells: f32, lines: usize) -> ([u32; LANES], [f32; LANES]) {
    let (mut cell, mut share) = ([0; LANES], [0.0; LANES]);
    let (last, most) = ((lines - 2) as f32, (lines - 1) as f32);
    for k in 0..LANES {
        let at = (coordinates[k] - origin) * cells;
        // NaN becomes 0.
        let at = if at > 0.0 { at } else { 0.0 };
        let at = if at < most { at } else { most };
        // Conversions of floats are not vectorised, because they saturate.
        let nearest = (at + ROUND_F32) - ROUND_F32;
        let below = if nearest > at { nearest - 1.0 } else { nearest };
        let below = if below < last { below } else { last };
        cell[k] = (below + ROUND_F32).to_bits() & 0x007f_ffff;
        let inside = at - below;
        share[k] = if inside < 1.0 { inside } else { 1.0 };
    }
    (cell, share)
}

#[inline(always)]
fn group(grid: &FootprintGrid, u: &[f32; LANES], v: &[f32; LANES], (first, lanes): (usize, usize), batch: &mut FootprintBatch) {
    let ((i, s), (j, t)) = (locate(u, grid.origin[0], grid.cells[0], grid.columns), locate(v, grid.origin[1], grid.cells[1], grid.rows));
    let mut cell = [0_u32; LANES];
    for k in 0..LANES {
        cell[k] = j[k] * grid.columns as u32 + i[k];
    }
    let mut marked = 0;
    for k in 0..LANES {
        marked |= grid.marked[cell[k] as usize] << k;
    }
    marked &= u8::MAX >> (LANES - lanes);
    if marked == 0 {
        return;
    }
    let [xx, yx, xy, yy] = jacobians(grid, &cell, &s, &t);
    let (mut det, mut square, mut needed) = ([0.0_f32; LANES], [[0.0_f32; LANES]; 2], [0_u8; LANES]);
    for k in 0..LANES {
        let area = (xx[k] * yy[k] - xy[k] * yx[k]).abs();
        // Where cells have no area, the longest footprint.
        det[k] = if area > f32::MIN_POSITIVE { area } else { f32::MIN_POSITIVE };
        square[0][k] = yy[k] * yy[k] + yx[k] * yx[k];
        square[1][k] = xx[k] * xx[k] + xy[k] * xy[k];
        let limit = grid.limit * grid.limit * det[k] * det[k];
        needed[k] = u8::from((square[0][k] > limit) | (square[1][k] > limit));
    }
    let needed = (0..LANES).fold(0, |lanes, k| lanes | needed[k] << k) & marked;
    if needed == 0 {
        return;
    }
    let mut sides = [[yy, yx], [xy, xx]];
    let mut lengths = [[0.0_f32; LANES]; 2];
    for (n, signs) in [[1.0, -1.0], [-1.0, 1.0]].into_iter().enumerate() {
        let ([x, y], scale) = (&mut sides[n], grid.scale[n]);
        for k in 0..LANES {
            let raw = square[n][k].sqrt();
            let own = raw / det[k];
            let own = if own < LONGEST { own } else { LONGEST };
            let share = (own - LEAST) * (1.0 / (FULL - LEAST));
            let share = if share > 0.0 { share } else { 0.0 };
            let grown = own * if share < 1.0 { share } else { 1.0 };
            let factor = if raw > 0.0 { grown / raw } else { 0.0 };
            x[k] = signs[0] * x[k] * factor * scale[0];
            y[k] = signs[1] * y[k] * factor * scale[1];
            lengths[n][k] = (x[k] * x[k] + y[k] * y[k]).sqrt() * (1.0 / 128.0);
        }
    }
    let shapes = Shapes::new(&lengths);
    let mut left = needed;
    while left != 0 {
        let k = left.trailing_zeros() as usize;
        left &= left - 1;
        let (across, down) = (shapes.across[k] as u32, shapes.down[k] as u32);
        if across + down == 0 {
            continue;
        }
        let reduction = (0..16_u32).find(|r| shapes.distance[k] <= APART * (1_u32 << r) as f32).unwrap_or(16);
        let sides = [[sides[0][0][k], sides[0][1][k]], [sides[1][0][k], sides[1][1][k]]];
        spread((u[k], v[k]), &sides, (across, down), reduction, batch);
        batch.pixels.push(Averaged { pixel: first + k, count: 1 << (across + down), reduction });
    }
}

/// The Jacobians in cells.
#[inline(always)]
fn jacobians(grid: &FootprintGrid, cell: &[u32; LANES], s: &[f32; LANES], t: &[f32; LANES]) -> [[f32; LANES]; 4] {
    let mut of_pixels = [[0.0_f32; 4]; LANES];
    for k in 0..LANES {
        let at = cell[k] as usize;
        let top: &[[f32; 4]; 2] = grid.jacobians[at..].first_chunk().expect("a cell has a right side");
        let bottom: &[[f32; 4]; 2] = grid.jacobians[at + grid.columns..].first_chunk().expect("a cell has a lower side");
        let (above, below) = (mix(&top[0], &top[1], s[k]), mix(&bottom[0], &bottom[1], s[k]));
        of_pixels[k] = mix(&above, &below, t[k]);
    }
    let mut jacobians = [[0.0; LANES]; 4];
    for (n, values) in jacobians.iter_mut().enumerate() {
        for k in 0..LANES {
            values[k] = of_pixels[k][n];
        }
    }
    jacobians
}

#[inline(always)]
fn mix(a: &[f32; 4], b: &[f32; 4], share: f32) -> [f32; 4] {
    let mut mixed = [0.0; 4];
    for n in 0..4 {
        mixed[n] = a[n] + share * (b[n] - a[n]);
    }
    mixed
}

/// How the samples of pixels are arranged: binary logarithms of their numbers along both sides, and their distance, px.
struct Shapes {
    across: [i32; LANES],
    down: [i32; LANES],
    distance: [f32; LANES],
}

impl Shapes {
    #[inline(always)]
    fn new([a, b]: &[[f32; LANES]; 2]) -> Self {
        let mut shapes = Self { across: [0; LANES], down: [0; LANES], distance: [0.0; LANES] };
        let steps = |length: f32, powers: [f32; 4]| powers.iter().fold(0, |steps, power| steps + i32::from(length > APART * power));
        for k in 0..LANES {
            let is_wide = a[k] >= b[k];
            let (long, short) = if is_wide { (a[k], b[k]) } else { (b[k], a[k]) };
            // At most four along the shorter side.
            let few = steps(short, [1.0, 2.0, f32::INFINITY, f32::INFINITY]);
            let many = steps(long, [1.0, 2.0, 4.0, 8.0]).min(MOST.ilog2() as i32 - few);
            let (apart, beside) = (long * inverse(many), short * inverse(few));
            shapes.distance[k] = if apart > beside { apart } else { beside };
            (shapes.across[k], shapes.down[k]) = if is_wide { (many, few) } else { (few, many) };
        }
        shapes
    }
}

/// 2 to the power of `-log`.
#[inline(always)]
fn inverse(log: i32) -> f32 {
    f32::from_bits((127 - log as u32) << 23)
}

/// Appends the positions of a pixel's samples.
#[inline(always)]
fn spread((u, v): (f32, f32), [a, b]: &[[f32; 2]; 2], (across, down): (u32, u32), reduction: u32, batch: &mut FootprintBatch) {
    let share = inverse(reduction as i32);
    // 128 times the position, px, is 63.5 larger than the coordinate.
    let reduced = |coordinate: f32| (coordinate + 63.5) * share - 63.5;
    let (step_x, step_y) = (inverse(across as i32), inverse(down as i32));
    let count = 1 << (across + down);
    for from in (0..count).step_by(LANES) {
        let (mut us, mut vs) = ([0.0; LANES], [0.0; LANES]);
        for k in 0..LANES {
            let sample = (from + k) as u32;
            let x = ((sample & ((1 << across) - 1)) as i32 as f32 + 0.5) * step_x - 0.5;
            let y = ((sample >> across) as i32 as f32 + 0.5) * step_y - 0.5;
            us[k] = reduced(u + x * a[0] + y * b[0]);
            vs[k] = reduced(v + x * a[1] + y * b[1]);
        }
        let at = batch.len + from;
        *batch.u[at..].first_chunk_mut().expect("there is room for every sample") = us;
        *batch.v[at..].first_chunk_mut().expect("there is room for every sample") = vs;
    }
    batch.len += count;
}
