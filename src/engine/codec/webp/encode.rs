//! Writes the bitstream of a lossless WebP (RFC 9649, section 3): two transforms for the whole
//! image (the green is subtracted from the other colours, and each pixel from the one below it),
//! one prefix code a channel, and runs of equal residuals. No colour cache, no search for matches,
//! one group of codes.
//!
//! The codes come before the first pixel, so every row is predicted twice: once to count, once to
//! write. That costs less than keeping four bytes a pixel. Memory: three rows.

use super::vp8l::LENGTH_CODE_ORDER;
use crate::codec::bits::BitWriter;
use crate::codec::prefix_code::{Codes, SentLengths};
use crate::pixmap::{Channels, Extent};

/// Symbols of green: its values, and the lengths of runs.
const GREEN_SYMBOLS: usize = 256 + 24;
/// Longest code, bits: the codes of one pixel fit one call of the bit writer.
const MAX_CODE_BITS: usize = 14;
/// Longest run; longer ones are cut. Also one repeated pixel is a run: its symbol is mostly shorter
/// than four codes.
const MAX_RUN: usize = 4096;
/// Pixels between two checks of `wanted`.
const PIXELS_PER_CHECK: usize = 1 << 17;

/// The predictor of the upper neighbour (section 3.5.1, number 2).
const ABOVE: u64 = 2;
/// The code of the distance to the left neighbour (section 3.6.2.2).
const LEFT: u64 = 1;

/// Red, green, blue, alpha; red and blue without the green.
type Pixel = [u8; 4];

/// Appends the stream. The sides are at most 16,384. Stops early when `wanted` returns false; the
/// output is then incomplete.
pub(super) fn encode(
    extent: Extent,
    channels: Channels,
    samples: &[u8],
    out: &mut Vec<u8>,
    wanted: &dyn Fn() -> bool,
) {
    let mut counts = SymbolCounts::default();
    if !each_residual_row(extent, channels, samples, wanted, |row| counts.add(row)) {
        return;
    }
    let mut bits = BitWriter::default();
    put_head(extent, channels, &mut bits, out);
    let codes = counts.codes();
    let coder = PixelCoder {
        green: put_code(&codes.green, &mut bits, out),
        red: put_code(&codes.red, &mut bits, out),
        blue: put_code(&codes.blue, &mut bits, out),
        alpha: put_code(&codes.alpha, &mut bits, out),
    };
    put_only_symbol(LEFT, &mut bits, out);
    if each_residual_row(extent, channels, samples, wanted, |row| {
        coder.put(row, &mut bits, out);
    }) {
        bits.pad(out);
    }
}

/// The head and the transforms (sections 3.4 and 3.5).
fn put_head(extent: Extent, channels: Channels, bits: &mut BitWriter, out: &mut Vec<u8>) {
    bits.put(out, 0x2f, 8);
    bits.put(out, u64::from(extent.width()) - 1, 14);
    bits.put(out, u64::from(extent.height()) - 1, 14);
    bits.put(out, u64::from(channels == Channels::Rgba), 1);
    bits.put(out, 0, 3);
    // A transform follows: 2 subtracts the green.
    bits.put(out, 1, 1);
    bits.put(out, 2, 2);
    // A transform follows: 0 predicts, in blocks of 512 x 512, each of which names its predictor
    // in a small image. That has no colour cache, and one symbol a channel.
    bits.put(out, 1, 1);
    bits.put(out, 0, 2);
    bits.put(out, 7, 3);
    bits.put(out, 0, 1);
    put_only_symbol(ABOVE, bits, out);
    for _ in 0..4 {
        put_only_symbol(0, bits, out);
    }
    // No other transform, no colour cache, one group of codes.
    bits.put(out, 0, 3);
}

/// Predicts the rows one after another. Returns false if the image is no longer wanted.
fn each_residual_row(
    extent: Extent,
    channels: Channels,
    samples: &[u8],
    wanted: &dyn Fn() -> bool,
    mut take: impl FnMut(&[Pixel]),
) -> bool {
    let width = extent.width() as usize;
    let mut above = vec![[0, 0, 0, 0]; width];
    let (mut row, mut residuals) = (above.clone(), above.clone());
    let rows_per_check = (PIXELS_PER_CHECK / width).max(1);
    for (y, file_row) in samples.chunks_exact(width * channels.count()).enumerate() {
        if y % rows_per_check == 0 && !wanted() {
            return false;
        }
        match channels {
            Channels::Rgb => subtract_green(file_row, |&[r, g, b]| [r, g, b, 255], &mut row),
            Channels::Rgba => subtract_green(file_row, |&pixel| pixel, &mut row),
        }
        // In the first row there is nothing above: the first pixel is predicted as opaque black,
        // the others by their left neighbour (section 3.5.1).
        if y == 0 {
            residuals[0] = difference(row[0], [0, 0, 0, 255]);
            for (residual, pair) in residuals[1..].iter_mut().zip(row.windows(2)) {
                *residual = difference(pair[1], pair[0]);
            }
        } else {
            // As plain bytes, which compilers subtract many at a time.
            let pairs = row.as_flattened().iter().zip(above.as_flattened());
            for (residual, (byte, above)) in residuals.as_flattened_mut().iter_mut().zip(pairs) {
                *residual = byte.wrapping_sub(*above);
            }
        }
        take(&residuals);
        std::mem::swap(&mut above, &mut row);
    }
    true
}

#[inline(always)]
fn subtract_green<const N: usize>(
    file_row: &[u8],
    rgba: impl Fn(&[u8; N]) -> Pixel,
    row: &mut [Pixel],
) {
    let (pixels, _) = file_row.as_chunks::<N>();
    for (to, pixel) in row.iter_mut().zip(pixels) {
        let [r, g, b, a] = rgba(pixel);
        *to = [r.wrapping_sub(g), g, b.wrapping_sub(g), a];
    }
}

#[inline(always)]
fn difference(a: Pixel, b: Pixel) -> Pixel {
    std::array::from_fn(|c| a[c].wrapping_sub(b[c]))
}

/// A row as pixels and runs: `run` gets how often the pixel before it is repeated.
#[inline(always)]
fn each_token<S>(
    row: &[Pixel],
    state: &mut S,
    literal: impl Fn(&mut S, Pixel),
    run: impl Fn(&mut S, usize),
) {
    let mut at = 0;
    while at < row.len() {
        let pixel = row[at];
        literal(state, pixel);
        at += 1;
        if row.get(at) != Some(&pixel) {
            continue;
        }
        let mut left = row[at..].iter().take_while(|next| **next == pixel).count();
        at += left;
        while left > 0 {
            let part = left.min(MAX_RUN);
            run(state, part);
            left -= part;
        }
    }
}

/// The symbol of a run's length, and its extra bits and how many (section 3.6.2.2).
const fn run_symbol(length: usize) -> (usize, u64, u32) {
    let rest = length - 1;
    if rest < 4 {
        return (256 + rest, 0, 0);
    }
    let high = rest.ilog2();
    let extra_bits = high - 1;
    let second = (rest >> extra_bits) & 1;
    let extra = rest & ((1 << extra_bits) - 1);
    (256 + 2 * high as usize + second, extra as u64, extra_bits)
}

/// How often each symbol occurs.
struct SymbolCounts {
    green: [u32; GREEN_SYMBOLS],
    others: [[u32; 256]; 3],
}

impl Default for SymbolCounts {
    fn default() -> Self {
        Self {
            green: [0; GREEN_SYMBOLS],
            others: [[0; 256]; 3],
        }
    }
}

/// One code a channel.
struct ChannelCodes {
    green: Codes<GREEN_SYMBOLS>,
    red: Codes<256>,
    blue: Codes<256>,
    alpha: Codes<256>,
}

impl SymbolCounts {
    fn add(&mut self, row: &[Pixel]) {
        each_token(
            row,
            self,
            |counts, [r, g, b, a]| {
                counts.green[usize::from(g)] += 1;
                counts.others[0][usize::from(r)] += 1;
                counts.others[1][usize::from(b)] += 1;
                counts.others[2][usize::from(a)] += 1;
            },
            |counts, length| counts.green[run_symbol(length).0] += 1,
        );
    }

    fn codes(&self) -> ChannelCodes {
        let [red, blue, alpha] = &self.others;
        ChannelCodes {
            green: Codes::new(&self.green, MAX_CODE_BITS),
            red: Codes::new(red, MAX_CODE_BITS),
            blue: Codes::new(blue, MAX_CODE_BITS),
            alpha: Codes::new(alpha, MAX_CODE_BITS),
        }
    }
}

/// Writes a code of one symbol below 256, which takes no bits (section 3.7.2.1.1).
fn put_only_symbol(symbol: u64, bits: &mut BitWriter, out: &mut Vec<u8>) {
    // Simple, one symbol, of eight bits.
    bits.put(out, 0b101, 3);
    bits.put(out, symbol, 8);
}

/// A code as the coder of pixels looks it up.
struct CodeTable<const N: usize>([(u32, u32); N]);

/// Writes a code. A code of one symbol takes no bits.
fn put_code<const N: usize>(
    codes: &Codes<N>,
    bits: &mut BitWriter,
    out: &mut Vec<u8>,
) -> CodeTable<N> {
    let mut used = (0..N).filter(|&symbol| codes.length[symbol] > 0);
    if let (Some(symbol), None) = (used.next(), used.next()) {
        put_only_symbol(symbol as u64, bits, out);
        return CodeTable([(0, 0); N]);
    }
    bits.put(out, 0, 1);
    let sent = SentLengths::new(&codes.length);
    sent.put_code(&LENGTH_CODE_ORDER, bits, out);
    // The lengths of all symbols follow.
    bits.put(out, 0, 1);
    sent.put_runs(bits, out);
    CodeTable(std::array::from_fn(|symbol| {
        (codes.bits[symbol].into(), codes.length[symbol].into())
    }))
}

/// Writes rows of residuals.
struct PixelCoder {
    green: CodeTable<GREEN_SYMBOLS>,
    red: CodeTable<256>,
    blue: CodeTable<256>,
    alpha: CodeTable<256>,
}

/// Bits on their way to the file, in registers; see [`BitWriter`].
struct StagedBits<'a> {
    bits: BitWriter,
    bytes: &'a mut [u8],
    at: usize,
}

impl StagedBits<'_> {
    /// Appends the low `length <= 56` bits of `code`: eight bytes are written, of which those count
    /// that are full.
    #[inline(always)]
    fn put(&mut self, code: u64, length: u32) {
        let BitWriter { waiting, filled } = &mut self.bits;
        *waiting |= code << *filled;
        *filled += length;
        if let Some(place) = self.bytes[self.at..].first_chunk_mut() {
            *place = waiting.to_le_bytes();
        }
        self.at += *filled as usize / 8;
        *waiting >>= *filled & 56;
        *filled &= 7;
    }
}

impl PixelCoder {
    fn put(&self, row: &[Pixel], bits: &mut BitWriter, out: &mut Vec<u8>) {
        // A pixel takes at most 56 bits, and the last one is stored as eight bytes.
        let start = out.len();
        out.resize(start + row.len() * 7 + 16, 0);
        let mut stage = StagedBits {
            bits: *bits,
            bytes: &mut out[start..],
            at: 0,
        };
        each_token(
            row,
            &mut stage,
            |stage, [r, g, b, a]| {
                let (green, red) = (self.green.0[usize::from(g)], self.red.0[usize::from(r)]);
                let (blue, alpha) = (self.blue.0[usize::from(b)], self.alpha.0[usize::from(a)]);
                let (first, second) = (green.1 + red.1, blue.1 + alpha.1);
                let code = u64::from(green.0) | u64::from(red.0) << green.1;
                let after = u64::from(blue.0) | u64::from(alpha.0) << blue.1;
                stage.put(code | after << first, first + second);
            },
            |stage, length| {
                let (symbol, extra, extra_bits) = run_symbol(length);
                let (code, length) = self.green.0[symbol];
                stage.put(u64::from(code) | extra << length, length + extra_bits);
            },
        );
        *bits = stage.bits;
        let end = start + stage.at;
        out.truncate(end);
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_run_has_the_symbol_and_the_bits_that_readers_add_up() {
        for length in 1..=MAX_RUN {
            let (symbol, extra, extra_bits) = run_symbol(length);
            // Section 3.6.2.2, as a reader has it.
            let prefix = symbol - 256;
            let read = if prefix < 4 {
                prefix + 1
            } else {
                assert_eq!(extra_bits as usize, (prefix - 2) >> 1);
                ((2 + (prefix & 1)) << extra_bits) + usize::try_from(extra).unwrap() + 1
            };
            assert_eq!(read, length);
            assert!(symbol < GREEN_SYMBOLS);
        }
    }

    #[test]
    fn a_row_is_its_pixels_and_runs_in_order() {
        let row: Vec<Pixel> = [(1, 1), (2, 9000), (3, 1), (2, 2), (5, 4097)]
            .into_iter()
            .flat_map(|(value, times)| std::iter::repeat_n([value; 4], times))
            .collect();
        let mut back = Vec::new();
        each_token(
            &row,
            &mut back,
            |back: &mut Vec<Pixel>, pixel| back.push(pixel),
            |back, times| {
                assert!((1..=MAX_RUN).contains(&times));
                back.extend(std::iter::repeat_n(*back.last().unwrap(), times));
            },
        );
        assert_eq!(back, row);
    }
}
