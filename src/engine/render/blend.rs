//! Mixes two drawn images by weights: straight samples in, straight samples out.

use crate::pixmap::{Channels, Depth};

/// The weight 1 as a fixed-point number: that of an image that is shown alone.
pub const FULL_WEIGHT: u16 = u16::MAX;

/// Mixes `over` into `under`, pixel by pixel. Weights are parts of [`FULL_WEIGHT`] and add up to at
/// most that; what they leave is transparent. Each colour counts by its alpha times its weight, and
/// the alpha of the result is the sum of these products. If the weight of one image is full, the
/// result is its pixel, bit for bit; if the weights add up to the full one and both pixels are
/// equal, it is that pixel. Shapes: `under: [pixels][channels]`, `over: [pixels][over_channels]`,
/// `weights: [pixels]` (of `over`, then of `under`); samples in PNG order (16-bit big-endian).
///
/// # Panics
/// If the shapes differ, or `over` has alpha and `under` has none.
///
/// ```
/// use mlswarp::pixmap::{Channels, Depth};
/// use mlswarp::render::{FULL_WEIGHT, blend};
/// let mut under = [10, 20, 30];
/// let (over, rgb) = ([1, 2, 3], Channels::Rgb);
/// blend(&mut under, rgb, &over, rgb, Depth::Eight, &[[FULL_WEIGHT, 0]]);
/// assert_eq!(under, [1, 2, 3]);
/// ```
pub fn blend(
    under: &mut [u8],
    channels: Channels,
    over: &[u8],
    over_channels: Channels,
    depth: Depth,
    weights: &[[u16; 2]],
) {
    assert!(
        channels == Channels::Rgba || over_channels == Channels::Rgb,
        "the result can store alpha"
    );
    let (pixel, over_pixel) = (
        channels.count() * depth.bytes(),
        over_channels.count() * depth.bytes(),
    );
    assert_eq!(
        (under.len(), over.len()),
        (pixel * weights.len(), over_pixel * weights.len()),
        "one weight for each pixel"
    );
    let opaque = match depth {
        Depth::Eight => u64::from(u8::MAX),
        Depth::Sixteen => u64::from(u16::MAX),
    };
    for ((under, over), &[w, v]) in under
        .chunks_exact_mut(pixel)
        .zip(over.chunks_exact(over_pixel))
        .zip(weights)
    {
        if (w, v) == (0, FULL_WEIGHT) {
            continue;
        }
        let (a, b) = (samples(over, depth, opaque), samples(under, depth, opaque));
        let mixed = if (w, v) == (FULL_WEIGHT, 0) {
            a
        } else {
            mix(a, b, u64::from(w), u64::from(v))
        };
        for (k, value) in mixed.into_iter().take(channels.count()).enumerate() {
            put(under, depth, k, value);
        }
    }
}

/// Red, green, blue and alpha.
fn samples(pixel: &[u8], depth: Depth, opaque: u64) -> [u64; 4] {
    let sample = |k: usize| match depth {
        Depth::Eight => pixel.get(k).map(|sample| u64::from(*sample)),
        Depth::Sixteen => pixel
            .get(2 * k..2 * k + 2)
            .map(|pair| u64::from(u16::from_be_bytes([pair[0], pair[1]]))),
    };
    [0, 1, 2, 3].map(|k| sample(k).unwrap_or(opaque))
}

#[expect(
    clippy::cast_possible_truncation,
    reason = "a mean of samples of this depth"
)]
fn put(pixel: &mut [u8], depth: Depth, k: usize, value: u64) {
    match depth {
        Depth::Eight => pixel[k] = value as u8,
        Depth::Sixteen => pixel[2 * k..2 * k + 2].copy_from_slice(&(value as u16).to_be_bytes()),
    }
}

fn mix(a: [u64; 4], b: [u64; 4], w: u64, v: u64) -> [u64; 4] {
    let whole = u64::from(FULL_WEIGHT);
    // At most 2^32: the weights sum up to at most the whole.
    let (of_a, of_b) = (w * a[3], v * b[3]);
    let sum = of_a + of_b;
    if sum == 0 {
        return if w + v == whole { b } else { [0; 4] };
    }
    let mean = |k: usize| (of_a * a[k] + of_b * b[k] + sum / 2) / sum;
    [mean(0), mean(1), mean(2), (sum + whole / 2) / whole]
}

#[cfg(test)]
mod tests {
    use super::*;

    fn mixed(under: &[u8], over: &[u8], w: u16, v: u16) -> Vec<u8> {
        let mut out = under.to_vec();
        let of = |pixel: &[u8]| {
            if pixel.len() == 4 {
                Channels::Rgba
            } else {
                Channels::Rgb
            }
        };
        blend(&mut out, of(under), over, of(over), Depth::Eight, &[[w, v]]);
        out
    }

    #[test]
    fn the_whole_of_a_picture_and_agreement_are_exact() {
        for pixel in [
            [1, 2, 3, 0],
            [9, 200, 31, 1],
            [255, 0, 77, 128],
            [4, 5, 6, 255],
        ] {
            let other = [250, 3, 99, 37];
            assert_eq!(mixed(&pixel, &other, 0, FULL_WEIGHT), pixel);
            assert_eq!(mixed(&other, &pixel, FULL_WEIGHT, 0), pixel);
            for w in [1, 77, 32_768, 65_534] {
                assert_eq!(mixed(&pixel, &pixel, w, FULL_WEIGHT - w), pixel, "{w}");
            }
        }
        assert_eq!(
            mixed(&[7, 8, 9, 255], &[1, 2, 3], FULL_WEIGHT, 0),
            [1, 2, 3, 255]
        );
        assert_eq!(mixed(&[7, 8, 9], &[1, 2, 3], 32_768, 32_767), [4, 5, 6]);
    }

    #[test]
    fn colours_count_by_alpha_and_holes_are_transparent() {
        // Half of a transparent image: the colour of the other one.
        assert_eq!(
            mixed(&[10, 20, 30, 255], &[200, 200, 200, 0], 32_768, 32_767),
            [10, 20, 30, 127]
        );
        assert_eq!(
            mixed(&[10, 20, 30, 255], &[200, 200, 200, 255], 0, 0),
            [0; 4]
        );
        assert_eq!(
            mixed(&[10, 20, 30, 255], &[200, 200, 200, 255], 0, 32_768),
            [10, 20, 30, 128]
        );
        let wide = [0xffff_u16, 0, 1000].map(u16::to_be_bytes).concat();
        let (mut out, over) = (
            wide.clone(),
            [0_u16, 0xffff, 3000].map(u16::to_be_bytes).concat(),
        );
        blend(
            &mut out,
            Channels::Rgb,
            &over,
            Channels::Rgb,
            Depth::Sixteen,
            &[[FULL_WEIGHT / 5, FULL_WEIGHT - FULL_WEIGHT / 5]],
        );
        assert_eq!(
            out,
            [52_428_u16, 13_107, 1400].map(u16::to_be_bytes).concat()
        );
    }
}
