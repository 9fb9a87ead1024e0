//! Catmull-Rom samples. In each axis the four weights are integers at 128 positions between two
//! centres; they add up to one exactly and reproduce ramps exactly (the outer two are rounded, the
//! inner two follow from these conditions). Colours are weighted by alpha, so those under alpha 0
//! never show; results beyond the range of the samples are clamped. Texels beyond the border repeat
//! it. Integers only, so that every level gives the same bytes.

#![expect(
    clippy::cast_possible_truncation,
    clippy::cast_sign_loss,
    reason = "values are clamped to the range of the samples"
)]

use super::kernel::fixed;
use super::source::{Packed, STORED_ZERO};

/// Positions between two pixel centres.
const POSITIONS_PER_PIXEL: usize = 128;

/// The weights of four neighbours in units of `2^-BITS`, by position.
const fn table<const BITS: u32>() -> [[i32; 4]; POSITIONS_PER_PIXEL] {
    let mut table = [[0; 4]; POSITIONS_PER_PIXEL];
    let mut k = 0;
    while k < POSITIONS_PER_PIXEL {
        #[expect(clippy::cast_possible_wrap, reason = "less than 128")]
        let t = k as i64;
        // w0 = (-t + 2 t^2 - t^3) / 2 and w3 = (t^3 - t^2) / 2, in units of 2^-22.
        let (square, cube) = (t * t * 128, t * t * t);
        let shift = 22 - BITS;
        let half = 1_i64 << (shift - 1);
        let first = (-t * 128 * 128 + 2 * square - cube + half) >> shift;
        let last = (cube - square + half) >> shift;
        let second_last = (t << (BITS - 7)) + first - 2 * last;
        let second = (1 << BITS) - first - second_last - last;
        table[k] = [first as i32, second as i32, second_last as i32, last as i32];
        k += 1;
    }
    table
}

/// The sums of 16 weighted 8-bit samples fit 31 bits.
const NARROW_FRACTION_BITS: u32 = 11;
/// The sums of 16 weighted products of two 16-bit samples fit 63 bits.
const WIDE_FRACTION_BITS: u32 = 14;
static WEIGHTS: [[i32; 4]; POSITIONS_PER_PIXEL] = table::<NARROW_FRACTION_BITS>();
static FINE_WEIGHTS: [[i32; 4]; POSITIONS_PER_PIXEL] = table::<WIDE_FRACTION_BITS>();

/// The four neighbours along an axis, clamped to the image, and the position between the middle
/// two.
fn neighbours(coordinate: f32, side: usize) -> ([usize; 4], usize) {
    let at = fixed(coordinate, ((side - 1) * POSITIONS_PER_PIXEL) as f32);
    let (middle, share) = (at / POSITIONS_PER_PIXEL, at % POSITIONS_PER_PIXEL);
    let last = side - 1;
    (
        [
            middle.saturating_sub(1),
            middle,
            (middle + 1).min(last),
            (middle + 2).min(last),
        ],
        share,
    )
}

/// The 8-bit sample at a position, straight RGBA.
pub(super) fn narrow(packed: &Packed, u: f32, v: f32) -> [u8; 4] {
    let ((xs, fx), (ys, fy)) = (neighbours(u, packed.width), neighbours(v, packed.height));
    let texel =
        |x: usize, y: usize| (packed.texels[y * packed.stride() + x] ^ STORED_ZERO).to_le_bytes();
    if fx == 0 && fy == 0 {
        return texel(xs[1], ys[1]);
    }
    let (across, down) = (&WEIGHTS[fx], &WEIGHTS[fy]);
    let rows = ys.map(|y| xs.map(|x| texel(x, y)));
    if packed.opaque || rows.iter().flatten().all(|texel| texel[3] == u8::MAX) {
        let mut sums = [0_i32; 3];
        for (row, weight) in rows.iter().zip(down) {
            for (channel, sum) in sums.iter_mut().enumerate() {
                let line: i32 = row
                    .iter()
                    .zip(across)
                    .map(|(texel, weight)| weight * i32::from(texel[channel]))
                    .sum();
                *sum += line * weight;
            }
        }
        let [r, g, b] = sums.map(|sum| {
            ((sum + (1 << (2 * NARROW_FRACTION_BITS - 1))) >> (2 * NARROW_FRACTION_BITS))
                .clamp(0, 255) as u8
        });
        return [r, g, b, u8::MAX];
    }
    let wide = rows.map(|row| row.map(|texel| texel.map(u16::from)));
    weighted(&wide, across, down, NARROW_FRACTION_BITS, u8::MAX.into()).map(|sample| sample as u8)
}

/// The 16-bit sample at a position, straight RGBA.
pub(super) fn wide(
    side: (usize, usize),
    u: f32,
    v: f32,
    texel: impl Fn(usize, usize) -> [u16; 4],
) -> [u16; 4] {
    let ((xs, fx), (ys, fy)) = (neighbours(u, side.0), neighbours(v, side.1));
    if fx == 0 && fy == 0 {
        return texel(xs[1], ys[1]);
    }
    weighted(
        &ys.map(|y| xs.map(|x| texel(x, y))),
        &FINE_WEIGHTS[fx],
        &FINE_WEIGHTS[fy],
        WIDE_FRACTION_BITS,
        u16::MAX,
    )
}

/// The mean of 16 texels, colours weighted by alpha; `most` is the largest sample.
fn weighted(
    rows: &[[[u16; 4]; 4]; 4],
    across: &[i32; 4],
    down: &[i32; 4],
    bits: u32,
    most: u16,
) -> [u16; 4] {
    let mut sums = [0_i64; 4];
    for (row, down) in rows.iter().zip(down) {
        for (texel, across) in row.iter().zip(across) {
            let alpha = i64::from(down * across) * i64::from(texel[3]);
            for (sum, colour) in sums.iter_mut().zip(&texel[..3]) {
                *sum += alpha * i64::from(*colour);
            }
            sums[3] += alpha;
        }
    }
    let alpha = sums[3];
    if alpha <= 0 {
        return [0; 4];
    }
    let [r, g, b] = [sums[0], sums[1], sums[2]]
        .map(|sum| ((sum.max(0) + alpha / 2) / alpha).min(most.into()) as u16);
    let rounded = (alpha + (1 << (2 * bits - 1))) >> (2 * bits);
    [r, g, b, rounded.clamp(0, most.into()) as u16]
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn weights_add_up_to_one_reproduce_ramps_and_are_those_of_catmull_and_rom() {
        for (table, bits) in [
            (&WEIGHTS, NARROW_FRACTION_BITS),
            (&FINE_WEIGHTS, WIDE_FRACTION_BITS),
        ] {
            let one = f64::from(1 << bits);
            for (k, w) in table.iter().enumerate() {
                assert_eq!(w.iter().sum::<i32>(), 1 << bits, "{k}");
                assert_eq!(
                    w[2] - w[0] + 2 * w[3],
                    i32::try_from(k).unwrap() << (bits - 7),
                    "{k}"
                );
                let t = k as f64 / 128.0;
                let exact = [
                    (-t + 2.0 * t * t - t * t * t) / 2.0,
                    (2.0 - 5.0 * t * t + 3.0 * t * t * t) / 2.0,
                    (t + 4.0 * t * t - 3.0 * t * t * t) / 2.0,
                    (t * t * t - t * t) / 2.0,
                ];
                for (w, exact) in w.iter().zip(exact) {
                    assert!(
                        (f64::from(*w) - exact * one).abs() <= 2.0,
                        "{k}: {w} {}",
                        exact * one
                    );
                }
            }
            assert_eq!(table[0], [0, 1 << bits, 0, 0]);
        }
    }
}
