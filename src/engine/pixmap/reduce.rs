//! Box reduction by powers of two, for sampling at a much smaller size. Shapes: `[height][width][channels]` to `[ceil(height /
//! n)][ceil(width / n)][channels]`, `n = 2^k`. Every pixel is the average of its `n x n` block, colours weighted by alpha (premultiplied),
//! rounded once, to nearest; blocks at the right and lower border average their existing pixels (so their mean lies up to half a block
//! beside the centre that samplers assume). Cost: O(source pixels).

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

const fn ceil_shift(length: u32, k: u32) -> u32 {
    if k >= u32::BITS { 1 } else { ((length - 1) >> k) + 1 }
}

impl Pixmap {
    /// The picture box-reduced by `2^k` along both axes; `k` = 0 is the picture itself.
    #[must_use]
    pub fn reduced(&self, k: u32) -> Self {
        if k == 0 {
            return self.clone();
        }
        let extent = self.extent().reduced(k);
        let samples = match self.samples() {
            Samples::Eight(s) => Samples::Eight(reduce(s, self.extent(), self.channels(), k)),
            Samples::Sixteen(s) => Samples::Sixteen(reduce(s, self.extent(), self.channels(), k)),
        };
        Self::new(extent, self.channels(), samples)
    }
}

/// Memory of the samples of a picture of this shape, bytes.
#[must_use]
pub fn sample_bytes(extent: Extent, channels: Channels, depth: Depth) -> u64 {
    extent.pixels().saturating_mul((channels.count() * depth.bytes()) as u64)
}

fn reduce<S: Copy + Into<u64> + TryFrom<u64> + Default>(samples: &[S], from: Extent, channels: Channels, k: u32) -> Vec<S> {
    let (width, height, count) = (from.width() as usize, from.height() as usize, channels.count());
    let to = from.reduced(k);
    let side = 1_usize.checked_shl(k).unwrap_or(usize::MAX);
    let mut reduced = Vec::with_capacity(to.width() as usize * to.height() as usize * count);
    // Per target pixel: sums of alpha * colour (colour alone where there is no alpha), and of alpha.
    let mut sums = vec![[0_u128; 4]; to.width() as usize];
    for block in samples.chunks(width * count * side.min(height)) {
        sums.fill([0; 4]);
        let rows = (block.len() / (width * count)) as u64;
        for row in block.chunks_exact(width * count) {
            for (sum, pixels) in sums.iter_mut().zip(row.chunks(side.min(width) * count)) {
                for pixel in pixels.chunks_exact(count) {
                    let alpha = if count == 4 { pixel[3].into() } else { 1 };
                    for (total, &colour) in sum.iter_mut().zip(&pixel[..3]) {
                        *total += u128::from(alpha * colour.into());
                    }
                    sum[3] += u128::from(alpha);
                }
            }
        }
        for (x, sum) in sums.iter().enumerate() {
            let columns = (width - x * side).min(side) as u64;
            for total in &sum[..3] {
                reduced.push(rounded(*total, sum[3]));
            }
            if count == 4 {
                reduced.push(rounded(sum[3], u128::from(rows * columns)));
            }
        }
    }
    reduced
}

/// `total / weight` to the nearest integer; zero where nothing weighs.
fn rounded<S: TryFrom<u64> + Default>(total: u128, weight: u128) -> S {
    let mean = (total + weight / 2).checked_div(weight).unwrap_or(0);
    u64::try_from(mean).ok().and_then(|mean| S::try_from(mean).ok()).unwrap_or_default()
}

#[cfg(test)]
mod tests {
    use super::*;

    fn pixmap(width: u32, height: u32, channels: Channels, samples: Vec<u8>) -> Pixmap {
        Pixmap::new(Extent::new(width, height).unwrap(), channels, Samples::Eight(samples))
    }

    #[test]
    fn reduction_averages_blocks_and_what_exists_of_them() {
        let picture = pixmap(3, 3, Channels::Rgb, (0..9_u8).flat_map(|i| [i * 10, 100, 255 - i]).collect());
        let half = picture.reduced(1);
        assert_eq!(half.extent(), Extent::new(2, 2).unwrap());
        let Samples::Eight(samples) = half.samples() else { panic!("depth is kept") };
        // (0 + 10 + 30 + 40) / 4, (20 + 50) / 2, (60 + 70) / 2, 80
        assert_eq!(samples.chunks(3).map(|p| p[0]).collect::<Vec<_>>(), [20, 35, 65, 80]);
        assert!(samples.chunks(3).all(|p| p[1] == 100));
        assert_eq!(picture.reduced(2).extent(), Extent::new(1, 1).unwrap());
        assert_eq!(picture.reduced(40).extent(), Extent::new(1, 1).unwrap());
    }

    #[test]
    fn reduction_weighs_colours_by_alpha() {
        let picture = pixmap(2, 1, Channels::Rgba, vec![200, 0, 0, 255, 0, 255, 0, 0]);
        assert_eq!(picture.reduced(1).samples(), &Samples::Eight(vec![200, 0, 0, 128]));
        let nothing = pixmap(2, 1, Channels::Rgba, vec![200, 0, 0, 0, 0, 255, 0, 0]);
        assert_eq!(nothing.reduced(1).samples(), &Samples::Eight(vec![0, 0, 0, 0]));
    }

    #[test]
    fn reduction_keeps_sixteen_bits() {
        let extent = Extent::new(2, 2).unwrap();
        let picture = Pixmap::new(extent, Channels::Rgba, Samples::Sixteen([1000, 65535, 7, 65535].repeat(4)));
        assert_eq!(picture.reduced(1).samples(), &Samples::Sixteen(vec![1000, 65535, 7, 65535]));
    }
}
