//! The reference: plain loops over the lanes of a block, which every compiler turns into vectors of the width it is allowed.

use super::{LANES, Lanes, Method};

/// Below this |m| no rotation is better than another (f32).
const UNDEFINED: f32 = 1e-5;

/// See [`super::displace`].
pub(super) fn displace(family: Method, table: &[Lanes], d: &[[f32; 2]], out: &mut [[f32; 2]]) -> f32 {
    displace_inline(family, table, d, out)
}

/// The body, inlined into one function per instruction set.
#[inline(always)]
pub(super) fn displace_inline(family: Method, table: &[Lanes], d: &[[f32; 2]], out: &mut [[f32; 2]]) -> f32 {
    // The unused lanes of a last block repeat its last vertex. A least per lane keeps the loops free of a horizontal step.
    let mut least = [1.0f32; LANES];
    match family {
        Method::Affine => blocks(table, d.len(), out, |block| affine(block, d)),
        Method::Similarity => blocks(table, 2 * d.len(), out, |block| similarity(block, d)),
        Method::Rigid => blocks(table, 3 * d.len() + 2, out, |block| rigid(block, d, &mut least)),
    }
    least.into_iter().fold(1.0, f32::min)
}

type Pair = [[f32; LANES]; 2];

#[inline(always)]
fn blocks(table: &[Lanes], per_block: usize, out: &mut [[f32; 2]], mut pose: impl FnMut(&[Lanes]) -> Pair) {
    for (block, out) in table.chunks_exact(per_block).zip(out.chunks_mut(LANES)) {
        let [x, y] = pose(block);
        let mut pairs = [[0.0; 2]; LANES];
        for k in 0..LANES {
            pairs[k] = [x[k], y[k]];
        }
        out.copy_from_slice(&pairs[..out.len()]);
    }
}

#[inline(always)]
fn affine(block: &[Lanes], d: &[[f32; 2]]) -> Pair {
    let (mut x, mut y) = ([0.0; LANES], [0.0; LANES]);
    for (Lanes(c), [dx, dy]) in block.iter().zip(d) {
        for k in 0..LANES {
            x[k] += c[k] * dx;
            y[k] += c[k] * dy;
        }
    }
    [x, y]
}

#[inline(always)]
fn similarity(block: &[Lanes], d: &[[f32; 2]]) -> Pair {
    let (mut x, mut y) = ([0.0; LANES], [0.0; LANES]);
    for (c, [dx, dy]) in block.chunks_exact(2).zip(d) {
        let (Lanes(re), Lanes(im)) = (&c[0], &c[1]);
        for k in 0..LANES {
            x[k] += re[k] * dx - im[k] * dy;
            y[k] += re[k] * dy + im[k] * dx;
        }
    }
    [x, y]
}

#[inline(always)]
fn rigid(block: &[Lanes], d: &[[f32; 2]], least: &mut [f32; LANES]) -> Pair {
    let (mut ux, mut uy, mut x, mut y) = ([0.0; LANES], [0.0; LANES], [0.0; LANES], [0.0; LANES]);
    for (c, [dx, dy]) in block.chunks_exact(3).zip(d) {
        let (Lanes(re), Lanes(im), Lanes(wn)) = (&c[0], &c[1], &c[2]);
        for k in 0..LANES {
            ux[k] += re[k] * dx - im[k] * dy;
            uy[k] += re[k] * dy + im[k] * dx;
            x[k] += wn[k] * dx;
            y[k] += wn[k] * dy;
        }
    }
    let (Lanes(ex), Lanes(ey)) = (&block[block.len() - 2], &block[block.len() - 1]);
    for k in 0..LANES {
        // rho(u) of mathematics 2.3 without a branch: both forms are computed, one is chosen.
        let mx = 1.0 + ux[k];
        let n = (mx * mx + uy[k] * uy[k]).sqrt();
        let near = -(uy[k] * (uy[k] / (mx + n)));
        let re = if mx > 0.0 { near } else { mx - n };
        let scale = if n >= UNDEFINED { 1.0 / n } else { 0.0 };
        let (rx, ry) = (re * scale, uy[k] * scale);
        let turned = [ex[k] * rx - ey[k] * ry, ex[k] * ry + ey[k] * rx];
        // Where no rotation fits, `near` may be 0/0: the lane is replaced, not multiplied.
        x[k] += if n >= UNDEFINED { turned[0] } else { 0.0 };
        y[k] += if n >= UNDEFINED { turned[1] } else { 0.0 };
        least[k] = if n < least[k] { n } else { least[k] };
    }
    [x, y]
}
