//! One strip: pixels to colour, cosine transform, quantisation and coding, a group of macroblocks
//! at a time.
//!
//! All arithmetic is on 16-bit integers (`I16Lanes`), whose range is -32,768 to 32,767. In order:
//!
//! | value | unit | range |
//! |---|---|---|
//! | luminance less 128, chrominance | 1/16 | -2048 to 2040 |
//! | after the transform along y, which multiplies by the square root of 8 | 1/16 | +-16,384 |
//! | the same, rounded | 1/4 | +-4096 |
//! | after the transform along x: a coefficient of T.81, A.3.3, times 32 | 1/32 | -32,768 (a black block) to 32,640 |
//!
//! Encoders that transform the samples of 8 bits have no bits of fraction.

use super::coder::{
    BlockPlace, Blocks, CoefficientCodes, MAX_GROUP_BLOCKS, Predictors, QuantisedBlock, ScanWriter,
};
use super::lanes::{I16Lanes, MOST_LANES, Quantiser};
use super::tables::SIDE;

/// Most bytes of a pixel.
const MOST_CHANNELS: usize = 4;
/// Rows of the tallest macroblock, the pixels of the blocks that a file interleaves (T.81: an MCU).
const MOST_ROWS: usize = 2 * SIDE;

/// What the samples of a file are.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Components {
    /// One, luminance.
    Grey,
    /// Three of full resolution.
    Full,
    /// Three, with chrominance of half the resolution along both axes.
    Half,
}

impl Components {
    /// The side of a macroblock, px.
    pub(super) const fn side(self) -> usize {
        match self {
            Self::Grey | Self::Full => SIDE,
            Self::Half => 2 * SIDE,
        }
    }

    /// The quantiser of each plane. A group of pixels has one plane of luminance, or one for each
    /// component, or luminance above and below and both kinds of chrominance.
    const fn quantisers(self) -> &'static [usize] {
        match self {
            Self::Grey => &[0],
            Self::Full => &[0, 1, 1],
            Self::Half => &[0, 0, 1],
        }
    }

    /// Blocks of a macroblock.
    pub(super) const fn blocks(self) -> usize {
        match self {
            Self::Grey => 1,
            Self::Full => 3,
            Self::Half => 6,
        }
    }

    /// The blocks that a group of pixels has, in the order in which a file stores them.
    fn order(self, lanes: usize) -> Vec<BlockPlace> {
        let macroblocks = lanes / self.side();
        let coded = |(plane, block, component): (usize, usize, usize)| BlockPlace {
            block: plane * MAX_PLANE_BLOCKS + block,
            component,
        };
        let one = |k: usize| match self {
            Self::Grey => vec![(0, k, 0)],
            Self::Full => vec![(0, k, 0), (1, k, 1), (2, k, 2)],
            Self::Half => vec![
                (0, 2 * k, 0),
                (0, 2 * k + 1, 0),
                (1, 2 * k, 0),
                (1, 2 * k + 1, 0),
                (2, k, 1),
                (2, macroblocks + k, 2),
            ],
        };
        (0..macroblocks).flat_map(one).map(coded).collect()
    }
}

/// A strip and how it is coded.
#[derive(Debug)]
pub(super) struct Job<'a> {
    /// `[rows][width][channels]`.
    pub(super) samples: &'a [u8],
    /// Width of a row, px.
    pub(super) width: usize,
    pub(super) channels: usize,
    pub(super) components: Components,
    /// The background of transparent pixels.
    pub(super) background: [u8; 3],
    pub(super) quantisers: &'a [Quantiser; 2],
    pub(super) codes: &'a [CoefficientCodes; 2],
}

/// See [`super::kernel::encode`].
#[inline(always)]
pub(super) fn encode<T: I16Lanes>(job: &Job<'_>, out: &mut Vec<u8>, wanted: &dyn Fn() -> bool) {
    match job.channels {
        1 => rows::<T, 1>(job, out, wanted),
        2 => rows::<T, 2>(job, out, wanted),
        3 => rows::<T, 3>(job, out, wanted),
        _ => rows::<T, 4>(job, out, wanted),
    }
}

/// The rows of a group of pixels: of the strip, or copies if it ends within the group.
pub(super) struct StripPixels<'a> {
    samples: &'a [u8],
    /// Bytes of a row.
    pitch: usize,
    /// Rows, at least 1.
    height: usize,
    /// Where the group begins in a row, bytes.
    at: usize,
    /// Bytes of the group in a row.
    length: usize,
    is_edge: bool,
    edge: [[u8; MOST_LANES * MOST_CHANNELS]; MOST_ROWS],
}

impl<'a> StripPixels<'a> {
    /// The first group.
    #[inline(always)]
    pub(super) fn of_group<T: I16Lanes>(samples: &'a [u8], pitch: usize, channels: usize) -> Self {
        let edge = [[0; MOST_LANES * MOST_CHANNELS]; MOST_ROWS];
        Self {
            samples,
            pitch,
            height: samples.len() / pitch,
            at: 0,
            length: T::COUNT * channels,
            is_edge: false,
            edge,
        }
    }

    /// A row of the group, counted from `top`; below the last row, that one again.
    #[inline(always)]
    fn row(&self, top: usize, y: usize) -> &[u8] {
        if self.is_edge {
            return &self.edge[y][..self.length];
        }
        &self.samples[(top + y).min(self.height - 1) * self.pitch + self.at..][..self.length]
    }

    /// Copies the rows of the last group and repeats the last pixel.
    #[inline(never)]
    fn copy_edge<const CHANNELS: usize>(&mut self, top: usize) {
        for (y, copy) in self.edge.iter_mut().enumerate() {
            let row = &self.samples[(top + y).min(self.height - 1) * self.pitch..][..self.pitch];
            let (kept, repeated) = copy[..self.length].split_at_mut(self.pitch - self.at);
            kept.copy_from_slice(&row[self.at..]);
            if let Some(last) = row.last_chunk::<CHANNELS>() {
                repeated.as_chunks_mut().0.fill(*last);
            }
        }
    }
}

#[inline(always)]
fn rows<T: I16Lanes, const CHANNELS: usize>(
    job: &Job<'_>,
    out: &mut Vec<u8>,
    wanted: &dyn Fn() -> bool,
) {
    let (side, pitch) = (job.components.side(), job.width * CHANNELS);
    let height = job.samples.len() / pitch;
    let mut pixels = StripPixels::of_group::<T>(job.samples, pitch, CHANNELS);
    let (mut bits, mut last) = (ScanWriter::new(), Predictors::default());
    let mut blocks = Blocks::default();
    let mut planes = [[T::all(0); SIDE]; MAX_GROUP_PLANES];
    let order = job.components.order(T::COUNT);
    let across = job.width.div_ceil(side);
    for top in (0..height).step_by(side) {
        for left in (0..job.width).step_by(T::COUNT) {
            pixels.at = left * CHANNELS;
            pixels.is_edge = pixels.at + pixels.length > pitch;
            if pixels.is_edge {
                pixels.copy_edge::<CHANNELS>(top);
            }
            transform::<T, CHANNELS>(job, &pixels, top, &mut planes, &mut blocks);
            let count = (across - left / side) * job.components.blocks();
            T::code(
                &mut bits,
                &blocks,
                &order[..count.min(order.len())],
                job.codes,
                &mut last,
                out,
            );
        }
        if !wanted() {
            return;
        }
    }
    bits.finish(out);
}

/// Rows of lanes.
type Plane<T> = [T; SIDE];
/// Most planes of a group, see [`Components::quantisers`].
pub(super) const MAX_GROUP_PLANES: usize = 3;
/// Most blocks of a plane.
pub(super) const MAX_PLANE_BLOCKS: usize = MOST_LANES / SIDE;
const _: () = assert!(MAX_PLANE_BLOCKS * MAX_GROUP_PLANES == MAX_GROUP_BLOCKS);

/// The blocks of a group, those of a plane side by side.
#[inline(always)]
pub(super) fn transform<T: I16Lanes, const CHANNELS: usize>(
    job: &Job<'_>,
    pixels: &StripPixels<'_>,
    top: usize,
    planes: &mut [Plane<T>; MAX_GROUP_PLANES],
    blocks: &mut Blocks,
) {
    match job.components {
        Components::Grey => grey::<T, CHANNELS>(job, pixels, top, planes),
        Components::Full => full::<T, CHANNELS>(job, pixels, top, planes),
        Components::Half => half::<T, CHANNELS>(job, pixels, top, planes),
    }
    let (blocks, _) = blocks.as_chunks_mut::<MAX_PLANE_BLOCKS>();
    for ((rows, quantiser), blocks) in planes.iter().zip(job.components.quantisers()).zip(blocks) {
        T::coefficients(rows, &job.quantisers[*quantiser], blocks);
    }
}

/// Luminance in the first plane.
#[inline(always)]
fn grey<T: I16Lanes, const CHANNELS: usize>(
    job: &Job<'_>,
    pixels: &StripPixels<'_>,
    top: usize,
    planes: &mut [Plane<T>; MAX_GROUP_PLANES],
) {
    for (y, luma) in planes[0].iter_mut().enumerate() {
        let [grey, ..] = colours::<T, CHANNELS>(pixels.row(top, y), job.background);
        *luma = fraction(grey);
    }
}

/// The three components.
#[inline(always)]
fn full<T: I16Lanes, const CHANNELS: usize>(
    job: &Job<'_>,
    pixels: &StripPixels<'_>,
    top: usize,
    planes: &mut [Plane<T>; MAX_GROUP_PLANES],
) {
    let [first, second, third] = planes;
    for (y, ((first, second), third)) in first.iter_mut().zip(second).zip(third).enumerate() {
        let colours = colours::<T, CHANNELS>(pixels.row(top, y), job.background);
        let [blue, red] = chroma(colours);
        *first = luma(colours);
        *second = blue.shift_rounded::<3>();
        *third = red.shift_rounded::<3>();
    }
}

/// Luminance of the upper and of the lower eight rows; then Cb in the lower half of the lanes and
/// Cr in the upper half, means of 2 x 2 px.
#[inline(always)]
fn half<T: I16Lanes, const CHANNELS: usize>(
    job: &Job<'_>,
    pixels: &StripPixels<'_>,
    top: usize,
    planes: &mut [Plane<T>; MAX_GROUP_PLANES],
) {
    for pair in 0..SIDE {
        let above @ [r, g, b] = colours::<T, CHANNELS>(pixels.row(top, 2 * pair), job.background);
        let below @ [r2, g2, b2] =
            colours::<T, CHANNELS>(pixels.row(top, 2 * pair + 1), job.background);
        let rows = &mut planes[pair / (SIDE / 2)];
        rows[2 * pair % SIDE] = luma(above);
        rows[2 * pair % SIDE + 1] = luma(below);
        let [blue, red] = chroma([r.mean(r2), g.mean(g2), b.mean(b2)]);
        planes[2][pair] = blue.sums_of_pairs(red).shift_rounded::<4>();
    }
}

/// Red, green and blue, 257 times their samples; or grey three times, 256 times its sample.
#[cfg_attr(not(optimized_for_size), inline(always))]
#[cfg_attr(optimized_for_size, inline(never))]
fn colours<T: I16Lanes, const CHANNELS: usize>(
    pixels: &[u8],
    [red, green, blue]: [u8; 3],
) -> [T; 3] {
    match CHANNELS {
        1 => [T::pixels_1(pixels).shift_left::<8>(); 3],
        2 => {
            let [grey, alpha] = T::pixels_2(pixels);
            [blended(grey, alpha, red).shift_left::<8>(); 3]
        }
        3 => T::pixels_3(pixels),
        _ => {
            let [r, g, b, alpha] = T::pixels_4(pixels);
            [
                blended(r, alpha, red),
                blended(g, alpha, green),
                blended(b, alpha, blue),
            ]
            .map(|colour| colour.times_low(T::all(257)))
        }
    }
}

/// `(c a + g (255 - a)) / 255`, rounded.
#[inline(always)]
fn blended<T: I16Lanes>(colour: T, alpha: T, background: u8) -> T {
    let behind = T::all(255)
        .minus(alpha)
        .times_low(T::all(i16::from(background)));
    let sum = colour.times_low(alpha).plus(behind).plus(T::all(127));
    // A division by 255, exact for what two bytes can be.
    sum.plus(T::all(1))
        .plus(sum.shift_right::<8>())
        .shift_right::<8>()
}

/// Luminance less 128 (JFIF, that of ITU-R BT.601), with 4 bits of fraction. The weights, 0.299,
/// 0.587 and 0.114 in units of 2^-16, are multiplied by 256 / 257, because colours are 257 times
/// their samples.
#[inline(always)]
fn luma<T: I16Lanes>([r, g, b]: [T; 3]) -> T {
    // 38,320 as a signed integer.
    fraction(
        r.times_high(T::all(19_519))
            .plus(g.times_high(T::all(-27_216)))
            .plus(b.times_high(T::all(7442))),
    )
}

/// Of unsigned integers with 8 bits of fraction: less 128, with 4 bits.
#[inline(always)]
fn fraction<T: I16Lanes>(value: T) -> T {
    value.minus(T::all(i16::MIN)).shift_rounded::<4>()
}

/// Cb and Cr without the offset of 128, with 7 bits of fraction. The weights, 0.5, 0.1687, 0.3313,
/// 0.4187 and 0.0813 in units of 2^-15, are multiplied by 256 / 257.
#[cfg_attr(not(optimized_for_size), inline(always))]
#[cfg_attr(optimized_for_size, inline(never))]
fn chroma<T: I16Lanes>([r, g, b]: [T; 3]) -> [T; 2] {
    let half = T::all(16_320);
    let blue = b
        .times_high(half)
        .minus(r.times_high(T::all(5507)))
        .minus(g.times_high(T::all(10_813)));
    let red = r
        .times_high(half)
        .minus(g.times_high(T::all(13_667)))
        .minus(b.times_high(T::all(2653)));
    [blue, red]
}

/// Blocks of samples to quantised coefficients.
#[inline(always)]
pub(super) fn coefficients<T: I16Lanes>(
    rows: Plane<T>,
    quantiser: &Quantiser,
    blocks: &mut [QuantisedBlock],
) {
    let mut rows = cosines(rows);
    for row in &mut rows {
        *row = row.shift_rounded::<2>();
    }
    let mut columns = cosines(T::transpose(rows));
    quantiser.divide(&mut columns);
    T::store(columns, blocks);
}

/// The cosine transform of eight values, times the square root of 8 (Loeffler, Ligtenberg,
/// Moschytz, ICASSP 1989).
#[inline(always)]
fn cosines<T: I16Lanes>([x0, x1, x2, x3, x4, x5, x6, x7]: [T; SIDE]) -> [T; SIDE] {
    let (s0, s1, s2, s3) = (x0.plus(x7), x1.plus(x6), x2.plus(x5), x3.plus(x4));
    let (d0, d1, d2, d3) = (x0.minus(x7), x1.minus(x6), x2.minus(x5), x3.minus(x4));
    let (even, odd) = ([s0.plus(s3), s1.plus(s2)], [s0.minus(s3), s1.minus(s2)]);
    // sqrt(2) cos(pi / 8) is 1 + 0.3066, sqrt(2) sin(pi / 8) is 0.5412.
    let (more, less) = (T::all(10_045), T::all(17_734));
    let two = odd[0].plus(odd[0].times(more)).plus(odd[1].times(less));
    let six = odd[0].times(less).minus(odd[1].plus(odd[1].times(more)));
    // Rotations by 3 pi / 16 and pi / 16.
    let (cos3, sin3, cos1, sin1) = (T::all(27_246), T::all(18_205), T::all(32_138), T::all(6393));
    let (a, b) = (
        d3.times(cos3).plus(d0.times(sin3)),
        d0.times(cos3).minus(d3.times(sin3)),
    );
    let (c, d) = (
        d2.times(cos1).plus(d1.times(sin1)),
        d1.times(cos1).minus(d2.times(sin1)),
    );
    let (one, seven) = (b.plus(c).plus(a.plus(d)), b.plus(c).minus(a.plus(d)));
    let (three, five) = (b.minus(c), a.minus(d));
    // The square root of 2 is 1 + 0.4142.
    let root = T::all(13_573);
    [
        even[0].plus(even[1]),
        one,
        two,
        three.plus(three.times(root)),
        even[0].minus(even[1]),
        five.plus(five.times(root)),
        six,
        seven,
    ]
}
