//! Box reduction by powers of two, for sampling at a much smaller size. Shapes:
//! `[height][width][channels]` to `[ceil(height / n)][ceil(width / n)][channels]`, `n = 2^k`. Every
//! pixel is the average of its `n x n` block, colours weighted by alpha (premultiplied), rounded
//! once, to nearest; blocks at the right and lower border average their existing pixels (so their
//! mean lies up to half a block beside the centre that samplers assume). Cost: O(source pixels):
//! about a nanosecond each if they are opaque and of 8 bit.

use super::{Channels, Depth, Extent, Pixmap, Samples};

impl Extent {
    /// The size after a box reduction by `2^k`, rounded up.
    #[must_use]
    pub const fn reduced(self, k: u32) -> Self {
        let (width, height) = (ceil_shift(self.width(), k), ceil_shift(self.height(), k));
        match Self::new(width, height) {
            Some(extent) => extent,
            None => self,
        }
    }
}

/// Sums of `2^k` 8-bit samples fit into 16 bits for `k` up to this.
const MOST_IN_U16: u32 = 8;

const fn ceil_shift(length: u32, k: u32) -> u32 {
    if k >= u32::BITS {
        1
    } else {
        ((length - 1) >> k) + 1
    }
}

impl Pixmap {
    /// The image box-reduced by `2^k` along both axes; `k` = 0 is the image itself. `None` when
    /// cancelled, which is checked for each row.
    #[must_use]
    pub fn reduced(&self, k: u32, cancelled: &dyn Fn() -> bool) -> Option<Self> {
        if k == 0 {
            return Some(self.clone());
        }
        let extent = self.extent().reduced(k);
        let samples = match self.samples() {
            Samples::Eight(s) if self.is_opaque() && k <= MOST_IN_U16 => Samples::Eight(
                reduce_opaque(s, self.extent(), self.channels(), k, cancelled)?,
            ),
            Samples::Eight(s) => {
                Samples::Eight(reduce(s, self.extent(), self.channels(), k, cancelled)?)
            }
            Samples::Sixteen(s) => {
                Samples::Sixteen(reduce(s, self.extent(), self.channels(), k, cancelled)?)
            }
        };
        // A mean of opaque pixels is opaque.
        Some(if self.is_opaque() {
            Self::of_opacity(extent, self.channels(), samples, true)
        } else {
            Self::new(extent, self.channels(), samples)
        })
    }
}

/// Memory that the samples of an image take, bytes.
#[must_use]
pub fn sample_bytes(extent: Extent, channels: Channels, depth: Depth) -> u64 {
    extent
        .pixels()
        .saturating_mul((channels.count() * depth.bytes()) as u64)
}

/// Of opaque 8-bit samples: columns are summed first, which the compiler vectorises. The weights of
/// all colours are equal.
fn reduce_opaque(
    samples: &[u8],
    from: Extent,
    channels: Channels,
    k: u32,
    cancelled: &dyn Fn() -> bool,
) -> Option<Vec<u8>> {
    let (width, count, side) = (from.width() as usize, channels.count(), 1_usize << k);
    let to = from.reduced(k);
    let row = width * count;
    let mut reduced = Vec::with_capacity(to.width() as usize * to.height() as usize * count);
    // One more than a row: four are read at the last pixel.
    let mut columns = vec![0_u16; row + 1];
    for block in samples.chunks(row * side) {
        columns.fill(0);
        for row in block.chunks_exact(row) {
            if cancelled() {
                return None;
            }
            for (sum, &sample) in columns.iter_mut().zip(row) {
                *sum += u16::from(sample);
            }
        }
        for first in (0..width).step_by(side) {
            let last = width.min(first + side);
            let mut sums = [0_u32; 4];
            for column in first..last {
                let four: [u16; 4] = std::array::from_fn(|c| columns[column * count..][..4][c]);
                for (sum, column) in sums.iter_mut().zip(four) {
                    *sum += u32::from(column);
                }
            }
            let is_full = block.len() == row * side && last - first == side;
            let area = u32::try_from(block.len() / row * (last - first)).unwrap_or(u32::MAX);
            reduced.extend(sums[..count].iter().map(|sum| {
                let sum = sum + area / 2;
                u8::try_from(if is_full { sum >> (2 * k) } else { sum / area }).unwrap_or(u8::MAX)
            }));
        }
    }
    Some(reduced)
}

/// Sums are exact up to 2^31 pixels.
fn reduce<S: Copy + Into<u64> + TryFrom<u64> + Default>(
    samples: &[S],
    from: Extent,
    channels: Channels,
    k: u32,
    cancelled: &dyn Fn() -> bool,
) -> Option<Vec<S>> {
    let (width, height, count) = (
        from.width() as usize,
        from.height() as usize,
        channels.count(),
    );
    let to = from.reduced(k);
    let side = 1_usize.checked_shl(k).unwrap_or(usize::MAX);
    let mut reduced = Vec::with_capacity(to.width() as usize * to.height() as usize * count);
    // Per target pixel: sums of alpha * colour (colour alone where there is no alpha), and of
    // alpha.
    let mut sums = vec![[0_u64; 4]; to.width() as usize];
    for block in samples.chunks(width * count * side.min(height)) {
        sums.fill([0; 4]);
        let rows = (block.len() / (width * count)) as u64;
        for row in block.chunks_exact(width * count) {
            if cancelled() {
                return None;
            }
            for (sum, pixels) in sums.iter_mut().zip(row.chunks(side.min(width) * count)) {
                for pixel in pixels.chunks_exact(count) {
                    let alpha = if count == 4 { pixel[3].into() } else { 1 };
                    for (total, &colour) in sum.iter_mut().zip(&pixel[..3]) {
                        *total += alpha * colour.into();
                    }
                    sum[3] += alpha;
                }
            }
        }
        for (x, sum) in sums.iter().enumerate() {
            let columns = (width - x * side).min(side) as u64;
            for total in &sum[..3] {
                reduced.push(rounded(*total, sum[3]));
            }
            if count == 4 {
                reduced.push(rounded(sum[3], rows * columns));
            }
        }
    }
    Some(reduced)
}

/// `total / weight` to the nearest integer; zero where nothing weighs.
fn rounded<S: TryFrom<u64> + Default>(total: u64, weight: u64) -> S {
    let mean = (total + weight / 2).checked_div(weight).unwrap_or(0);
    S::try_from(mean).unwrap_or_default()
}

#[cfg(test)]
mod tests {
    use super::*;

    fn pixmap(width: u32, height: u32, channels: Channels, samples: Vec<u8>) -> Pixmap {
        Pixmap::new(
            Extent::new(width, height).unwrap(),
            channels,
            Samples::Eight(samples),
        )
    }

    #[test]
    fn reduction_averages_blocks_and_what_exists_of_them() {
        let picture = pixmap(
            3,
            3,
            Channels::Rgb,
            (0..9_u8).flat_map(|i| [i * 10, 100, 255 - i]).collect(),
        );
        let half = picture.reduced(1, &|| false).unwrap();
        assert_eq!(half.extent(), Extent::new(2, 2).unwrap());
        let Samples::Eight(samples) = half.samples() else {
            panic!("depth is kept")
        };
        // (0 + 10 + 30 + 40) / 4, (20 + 50) / 2, (60 + 70) / 2, 80
        assert_eq!(
            samples.chunks(3).map(|p| p[0]).collect::<Vec<_>>(),
            [20, 35, 65, 80]
        );
        assert!(samples.chunks(3).all(|p| p[1] == 100));
        assert_eq!(
            picture.reduced(2, &|| false).unwrap().extent(),
            Extent::new(1, 1).unwrap()
        );
        assert_eq!(
            picture.reduced(40, &|| false).unwrap().extent(),
            Extent::new(1, 1).unwrap()
        );
    }

    #[test]
    fn reduction_weighs_colours_by_alpha() {
        let picture = pixmap(2, 1, Channels::Rgba, vec![200, 0, 0, 255, 0, 255, 0, 0]);
        assert_eq!(
            picture.reduced(1, &|| false).unwrap().samples(),
            &Samples::Eight(vec![200, 0, 0, 128])
        );
        let nothing = pixmap(2, 1, Channels::Rgba, vec![200, 0, 0, 0, 0, 255, 0, 0]);
        assert_eq!(
            nothing.reduced(1, &|| false).unwrap().samples(),
            &Samples::Eight(vec![0, 0, 0, 0])
        );
    }

    #[test]
    fn reduction_keeps_sixteen_bits() {
        let extent = Extent::new(2, 2).unwrap();
        let picture = Pixmap::new(
            extent,
            Channels::Rgba,
            Samples::Sixteen([1000, 65535, 7, 65535].repeat(4)),
        );
        assert_eq!(
            picture.reduced(1, &|| false).unwrap().samples(),
            &Samples::Sixteen(vec![1000, 65535, 7, 65535])
        );
    }

    #[test]
    fn opaque_pictures_are_reduced_as_others() {
        for (width, height, k) in [
            (1, 1, 1),
            (7, 5, 1),
            (64, 33, 2),
            (37, 41, 3),
            (300, 270, 8),
            (5, 600, 8),
            (20, 20, 8),
        ] {
            for channels in [Channels::Rgb, Channels::Rgba] {
                let pixels = width as usize * height as usize;
                let sample = |i: usize| ((i * i * 31 + i * 7 + 250) % 256).to_le_bytes()[0];
                let pixel = |i| [sample(3 * i), sample(3 * i + 1), sample(3 * i + 2), u8::MAX];
                for white in [false, true] {
                    let pixel = |i| if white { [u8::MAX; 4] } else { pixel(i) };
                    let samples: Vec<u8> = (0..pixels)
                        .flat_map(|i| pixel(i).into_iter().take(channels.count()))
                        .collect();
                    let picture = pixmap(width, height, channels, samples.clone());
                    let expected =
                        reduce(&samples, picture.extent(), channels, k, &|| false).unwrap();
                    assert_eq!(
                        picture.reduced(k, &|| false).unwrap().samples(),
                        &Samples::Eight(expected),
                        "{width} x {height}, {k}, {channels:?}"
                    );
                }
            }
        }
    }
}
