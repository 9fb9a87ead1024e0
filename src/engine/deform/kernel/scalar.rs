//! The reference: plain loops over the lanes of a block, which every compiler turns into vectors of
//! the width it is allowed. Functions, not closures: a closure may stay a function of its own,
//! which then has the reference's vectors in every level.

use super::{BlockDisplacements, CoefficientForm, CoefficientLanes, LANES, lanes_per_block};

/// Below this |m| no rotation is better than another (f32).
const UNDEFINED_ROTATION: f32 = 1e-5;

/// See [`super::displace`].
#[cfg_attr(optimized_for_size, optimize(speed), inline(never))]
pub(super) fn displace(
    form: CoefficientForm,
    table: &[CoefficientLanes],
    d: &[[f32; 2]],
    out: &mut Vec<BlockDisplacements>,
) -> f32 {
    displace_inline::<false>(form, table, d, out)
}

/// The body, inlined into one function per instruction set. `IN_PAIRS`: two blocks of real
/// coefficients are summed at once, because a sum waits for the one before it, but not for that of
/// another block.
#[inline(always)]
pub(super) fn displace_inline<const IN_PAIRS: bool>(
    form: CoefficientForm,
    table: &[CoefficientLanes],
    d: &[[f32; 2]],
    out: &mut Vec<BlockDisplacements>,
) -> f32 {
    // The unused lanes of a last block repeat its last vertex. A least per lane keeps the loops
    // free of a horizontal step.
    let mut least = [1.0f32; LANES];
    let per_block = lanes_per_block(form, d.len());
    out.reserve(table.len() / per_block);
    let mut rest = table;
    if IN_PAIRS && form == CoefficientForm::Real {
        let pairs_of_blocks = table.chunks_exact(2 * per_block);
        rest = pairs_of_blocks.remainder();
        for blocks in pairs_of_blocks {
            let (first, second) = blocks.split_at(per_block);
            let [first, second] = two_affine(first, second, d);
            out.push(pairs(&first));
            out.push(pairs(&second));
        }
    }
    for block in rest.chunks_exact(per_block) {
        // Pushed, not stored into zeros: writing the zeros took 5 % of a small table's time.
        out.push(pose(form, block, d, &mut least));
    }
    let mut all = 1.0;
    for n in least {
        all = if n < all { n } else { all };
    }
    all
}

/// The displacements of a block.
#[inline(always)]
fn pose(
    form: CoefficientForm,
    block: &[CoefficientLanes],
    d: &[[f32; 2]],
    least: &mut [f32; LANES],
) -> BlockDisplacements {
    pairs(&match form {
        CoefficientForm::Real => affine(block, d),
        CoefficientForm::Complex => similarity(block, d),
        CoefficientForm::Rigid => turn(block, &pull(block, d), least),
    })
}

#[inline(always)]
fn pairs([x, y]: &Pair) -> BlockDisplacements {
    let mut pairs = [[0.0; 2]; LANES];
    for k in 0..LANES {
        pairs[k] = [x[k], y[k]];
    }
    pairs
}

type Pair = [[f32; LANES]; 2];

#[inline(always)]
fn affine(block: &[CoefficientLanes], d: &[[f32; 2]]) -> Pair {
    let (mut x, mut y) = ([0.0; LANES], [0.0; LANES]);
    for (CoefficientLanes(c), [dx, dy]) in block.iter().zip(d) {
        for k in 0..LANES {
            x[k] += c[k] * dx;
            y[k] += c[k] * dy;
        }
    }
    [x, y]
}

/// As [`affine`], of two blocks.
#[inline(always)]
fn two_affine(
    first: &[CoefficientLanes],
    second: &[CoefficientLanes],
    d: &[[f32; 2]],
) -> [Pair; 2] {
    let (mut x0, mut y0) = ([0.0; LANES], [0.0; LANES]);
    let (mut x1, mut y1) = ([0.0; LANES], [0.0; LANES]);
    let blocks = first.iter().zip(second);
    for ((CoefficientLanes(c0), CoefficientLanes(c1)), [dx, dy]) in blocks.zip(d) {
        for k in 0..LANES {
            x0[k] += c0[k] * dx;
            y0[k] += c0[k] * dy;
        }
        for k in 0..LANES {
            x1[k] += c1[k] * dx;
            y1[k] += c1[k] * dy;
        }
    }
    [[x0, y0], [x1, y1]]
}

#[inline(always)]
fn similarity(block: &[CoefficientLanes], d: &[[f32; 2]]) -> Pair {
    let (mut x, mut y) = ([0.0; LANES], [0.0; LANES]);
    for (c, [dx, dy]) in block.chunks_exact(2).zip(d) {
        let (CoefficientLanes(re), CoefficientLanes(im)) = (&c[0], &c[1]);
        for k in 0..LANES {
            x[k] += re[k] * dx - im[k] * dy;
            y[k] += re[k] * dy + im[k] * dx;
        }
    }
    [x, y]
}

/// `u = sum H_j d_j` and `sum wn_j d_j` of rigid.
#[inline(always)]
fn pull(block: &[CoefficientLanes], d: &[[f32; 2]]) -> [[f32; LANES]; 4] {
    let (mut ux, mut uy, mut x, mut y) = ([0.0; LANES], [0.0; LANES], [0.0; LANES], [0.0; LANES]);
    for (c, [dx, dy]) in block.chunks_exact(3).zip(d) {
        let (CoefficientLanes(re), CoefficientLanes(im), CoefficientLanes(wn)) =
            (&c[0], &c[1], &c[2]);
        for k in 0..LANES {
            ux[k] += re[k] * dx - im[k] * dy;
            uy[k] += re[k] * dy + im[k] * dx;
            x[k] += wn[k] * dx;
            y[k] += wn[k] * dy;
        }
    }
    [ux, uy, x, y]
}

/// `e rho(u) + sum wn_j d_j`, and the least |1 + u|.
#[inline(always)]
fn turn(
    block: &[CoefficientLanes],
    [ux, uy, x, y]: &[[f32; LANES]; 4],
    least: &mut [f32; LANES],
) -> Pair {
    let (mut x, mut y) = (*x, *y);
    let (CoefficientLanes(ex), CoefficientLanes(ey)) =
        (&block[block.len() - 2], &block[block.len() - 1]);
    for k in 0..LANES {
        // rho(u) of mathematics 2.3 without a branch and with one division: where the turn is less
        // than a right angle, `(mx - n) / n` cancels and is `-uy^2 / (n (n + mx))` instead.
        let mx = 1.0 + ux[k];
        let n = (mx * mx + uy[k] * uy[k]).sqrt();
        let ahead = mx > 0.0;
        let more = if ahead { n + mx } else { 1.0 };
        let over = if ahead { -(uy[k] * uy[k]) } else { mx - n };
        let scale = 1.0 / (n * more);
        let (rx, ry) = (over * scale, uy[k] * (more * scale));
        let turned = [ex[k] * rx - ey[k] * ry, ex[k] * ry + ey[k] * rx];
        // Where no rotation fits, `scale` may be infinite: the lane is replaced, not multiplied.
        x[k] += if n >= UNDEFINED_ROTATION {
            turned[0]
        } else {
            0.0
        };
        y[k] += if n >= UNDEFINED_ROTATION {
            turned[1]
        } else {
            0.0
        };
        least[k] = if n < least[k] { n } else { least[k] };
    }
    [x, y]
}
