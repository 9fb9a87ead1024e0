//! Bounds the memory of a lossless WebP stream's prefix codes (RFC 9649, section 3), which a
//! decoder builds before the first pixel. A stream may hold 65,536 groups of five codes whatever
//! the size of its image, and eight bytes of it can describe a code whose tables take 70 KiB: a
//! file of 672 kB took 3.6 GB. This module reads the stream up to its image without building
//! anything: it skips the images of the transforms symbol by symbol (their number of bits does not
//! depend on the pixels), takes the number of groups from the largest literal of the entropy image,
//! and computes table sizes from the code lengths. Cost: at most a fixed number of steps per bit
//! read and per byte of the tables, whatever size the header claims: a transform may occur once,
//! and an image whose symbols take no bits is skipped in one step.

use crate::codec::work::StepCounter;
use crate::codec::{CodecError, Format};

/// Larger tables are refused. Encoders stay far below: libwebp makes at most 2,600 groups of about
/// 20 KiB.
const MAX_CODE_BYTES: u64 = 128 << 20;
/// Tables for an image of any size: eight groups of the largest codes.
const FREE_CODE_BYTES: u64 = 1 << 20;
/// Larger tables per pixel are refused. A code of n bits pays off only for as many pixels as the
/// n-th Fibonacci number, so a table of 1024 entries of 4 bytes stands for at least 89 pixels, and
/// five of them for at most 230 bytes per pixel.
const PIXEL_CODE_BYTES: u64 = 256;

/// The largest tables that are accepted for this number of pixels.
pub(super) fn most_code_bytes(pixels: u64) -> u64 {
    pixels
        .saturating_mul(PIXEL_CODE_BYTES)
        .saturating_add(FREE_CODE_BYTES)
        .min(MAX_CODE_BYTES)
}

fn bad(detail: impl ToString) -> CodecError {
    CodecError::bad(Format::WebP.name(), detail)
}

fn damaged() -> CodecError {
    bad("its lossless stream is damaged before the picture")
}

const LENGTH_CODES: usize = 19;
/// The order in which the lengths of the code of lengths are sent (section 3.7.2.1.2).
pub(super) const LENGTH_CODE_ORDER: [usize; LENGTH_CODES] = [
    17, 18, 0, 1, 2, 3, 4, 5, 16, 6, 7, 8, 9, 10, 11, 12, 13, 14, 15,
];
const LONGEST_CODE: usize = 15;
/// Green (and lengths), red, blue, alpha, distances.
const ALPHABETS: [usize; 5] = [256 + LENGTH_SYMBOLS, 256, 256, 256, 40];
const LENGTH_SYMBOLS: usize = 24;
/// Symbols of longer codes get two nodes each of a tree behind the decoder's table.
const TABLE_BITS: usize = 10;
const TABLE_ENTRY: u64 = 4;
const TREE_NODE: u64 = 16;
/// Five codes in a vector that doubles; the old allocation exists while it is copied.
const GROUP_BYTES: u64 = 3 * 5 * 56;
/// Overhead of the allocator for a code's two blocks.
const ALLOCATOR_BYTES: u64 = 32;

/// Bytes of the tables that a decoder builds for a stream: a whole `VP8L` chunk (`size: None`), or
/// an `ALPH` chunk without its first byte. At most `most`.
pub(super) fn code_bytes(
    stream: &[u8],
    size: Option<(u32, u32)>,
    most: u64,
    work: &StepCounter<'_>,
) -> Result<u64, CodecError> {
    let mut walk = Walk {
        bits: BitReader {
            rest: stream,
            buffer: 0,
            count: 0,
            work,
        },
        bytes: 0,
        most,
    };
    walk.stream(size)?;
    Ok(walk.bytes)
}

struct Walk<'a> {
    bits: BitReader<'a>,
    bytes: u64,
    most: u64,
}

impl Walk<'_> {
    fn stream(&mut self, size: Option<(u32, u32)>) -> Result<(), CodecError> {
        let (mut width, height) = match size {
            Some(size) => size,
            None => {
                self.bits.read(8)?;
                let size = (self.bits.read(14)? + 1, self.bits.read(14)? + 1);
                self.bits.read(4)?;
                size
            }
        };
        let mut seen = [false; 4];
        while self.bits.read(1)? == 1 {
            let kind = self.bits.read(2)?;
            if std::mem::replace(&mut seen[kind as usize], true) {
                return Err(bad("a transform occurs twice"));
            }
            match kind {
                0 | 1 => {
                    let block = self.bits.read(3)? + 2;
                    self.image(blocks(width, block), blocks(height, block))?;
                }
                2 => {}
                _ => {
                    let colours = self.bits.read(8)? + 1;
                    self.image(colours, 1)?;
                    let packing = match colours {
                        ..=2 => 3,
                        3..=4 => 2,
                        5..=16 => 1,
                        _ => 0,
                    };
                    width = blocks(width, packing);
                }
            }
        }
        let cached = self.cached_colours()?;
        let mut groups = 1;
        if self.bits.read(1)? == 1 {
            let block = self.bits.read(3)? + 2;
            groups = self.image(blocks(width, block), blocks(height, block))? + 1;
        }
        for _ in 0..groups {
            self.bytes += GROUP_BYTES;
            for (k, alphabet) in ALPHABETS.into_iter().enumerate() {
                let code = Code::read(&mut self.bits, alphabet + if k == 0 { cached } else { 0 })?;
                self.bytes += code.table_bytes();
            }
            if self.bytes > self.most {
                return Err(bad(format!(
                    "its prefix codes take more than {} bytes of tables",
                    self.most
                )));
            }
        }
        Ok(())
    }

    fn cached_colours(&mut self) -> Result<usize, CodecError> {
        if self.bits.read(1)? == 0 {
            return Ok(0);
        }
        let bits = self.bits.read(4)?;
        if (1..=11).contains(&bits) {
            Ok(1 << bits)
        } else {
            Err(damaged())
        }
    }

    /// Skips an image that has one group of codes. Returns the largest number that red and green of
    /// a pixel make: copies repeat earlier pixels, and colours of a cache are zero until a literal
    /// sets them.
    fn image(&mut self, width: u32, height: u32) -> Result<u32, CodecError> {
        let cached = self.cached_colours()?;
        let mut group = Vec::with_capacity(ALPHABETS.len());
        for (k, alphabet) in ALPHABETS.into_iter().enumerate() {
            group.push(Code::read(
                &mut self.bits,
                alphabet + if k == 0 { cached } else { 0 },
            )?);
        }
        let [green, red, blue, alpha, distance] = group.as_slice() else {
            return Err(damaged());
        };
        // Symbols that take no bits: all pixels are equal.
        match (
            &*green.symbols,
            &*red.symbols,
            &*blue.symbols,
            &*alpha.symbols,
        ) {
            ([green @ 0..256], [red], [_], [_]) => return Ok(u32::from(red << 8 | green)),
            (&[cached], ..) if usize::from(cached) >= ALPHABETS[0] => return Ok(0),
            _ => {}
        }
        // From here on every iteration reads at least one bit, except for a copy as the only
        // symbol, which has nothing to copy.
        let pixels = u64::from(width) * u64::from(height);
        let (mut at, mut largest) = (0, 0);
        while at < pixels {
            let symbol = green.symbol(&mut self.bits)?;
            match usize::from(symbol) {
                0..256 => {
                    largest = largest.max(u32::from(red.symbol(&mut self.bits)? << 8 | symbol));
                    blue.symbol(&mut self.bits)?;
                    alpha.symbol(&mut self.bits)?;
                    at += 1;
                }
                code @ 256.. if code < ALPHABETS[0] => {
                    if at == 0 {
                        return Err(damaged());
                    }
                    at += u64::from(self.count(symbol - 256)?);
                    let far = distance.symbol(&mut self.bits)?;
                    self.count(far)?;
                }
                _ => at += 1,
            }
        }
        Ok(largest)
    }

    /// A length or distance from its prefix and extra bits.
    fn count(&mut self, prefix: u16) -> Result<u32, CodecError> {
        let prefix = u32::from(prefix);
        if prefix < 4 {
            return Ok(prefix + 1);
        }
        let extra = (prefix - 2) >> 1;
        Ok(((2 + (prefix & 1)) << extra) + self.bits.read(extra)? + 1)
    }
}

/// Number of blocks of `2^bits` along a side.
fn blocks(side: u32, bits: u32) -> u32 {
    side.div_ceil(1 << bits)
}

/// A canonical prefix code.
struct Code {
    /// Number of codes of each length.
    counts: [u16; LONGEST_CODE + 1],
    /// In the order of their codes.
    symbols: Vec<u16>,
}

impl Code {
    fn read(bits: &mut BitReader<'_>, alphabet: usize) -> Result<Self, CodecError> {
        if bits.read(1)? == 1 {
            let two = bits.read(1)? == 1;
            let first_bits = if bits.read(1)? == 1 { 8 } else { 1 };
            let mut symbols = vec![bits.symbol(first_bits)?];
            if two {
                symbols.push(bits.symbol(8)?);
            }
            let mut counts = [0; LONGEST_CODE + 1];
            counts[1] = if two { 2 } else { 0 };
            let known = symbols.iter().all(|&symbol| usize::from(symbol) < alphabet);
            return if known {
                Ok(Self { counts, symbols })
            } else {
                Err(damaged())
            };
        }
        let mut lengths = [0; LENGTH_CODES];
        let given = bits.read(4)? as usize + 4;
        for &symbol in LENGTH_CODE_ORDER.get(..given).ok_or_else(damaged)? {
            lengths[symbol] = bits.symbol(3)?;
        }
        let code = Self::of_lengths(&lengths)?;
        let mut reads = if bits.read(1)? == 1 {
            let width = 2 + 2 * bits.read(3)?;
            2 + bits.read(width)? as usize
        } else {
            alphabet
        };
        let mut lengths = Vec::with_capacity(alphabet);
        let mut previous = 8;
        while lengths.len() < alphabet && reads > 0 {
            reads -= 1;
            bits.work.step(1)?;
            let (length, times) = match code.symbol(bits)? {
                16 => (previous, 3 + bits.read(2)?),
                17 => (0, 3 + bits.read(3)?),
                18 => (0, 11 + bits.read(7)?),
                0 => (0, 1),
                length => {
                    previous = length;
                    (length, 1)
                }
            };
            lengths.extend(std::iter::repeat_n(length, times as usize));
        }
        if lengths.len() > alphabet {
            Err(damaged())
        } else {
            Self::of_lengths(&lengths)
        }
    }

    /// Accepts complete codes only: every bit sequence has a meaning.
    fn of_lengths(lengths: &[u16]) -> Result<Self, CodecError> {
        let mut counts = [0; LONGEST_CODE + 1];
        let used = || (0..).zip(lengths).filter(|(_, length)| **length > 0);
        for (_, &length) in used() {
            *counts.get_mut(usize::from(length)).ok_or_else(damaged)? += 1;
        }
        let symbols = if used().count() == 1 {
            counts = [0; LONGEST_CODE + 1];
            used().map(|(symbol, _)| symbol).collect()
        } else {
            let filled: u32 = (0..)
                .zip(counts)
                .skip(1)
                .map(|(length, count)| u32::from(count) << (15 - length))
                .sum();
            if filled != 1 << LONGEST_CODE {
                return Err(damaged());
            }
            let mut places = [0; LONGEST_CODE + 1];
            for length in 1..LONGEST_CODE {
                places[length + 1] = places[length] + usize::from(counts[length]);
            }
            let mut symbols = vec![0; used().count()];
            for (symbol, &length) in used() {
                let place = &mut places[usize::from(length)];
                symbols[*place] = symbol;
                *place += 1;
            }
            symbols
        };
        Ok(Self { counts, symbols })
    }

    /// The next symbol; a single symbol takes no bits.
    fn symbol(&self, bits: &mut BitReader<'_>) -> Result<u16, CodecError> {
        if let [only] = *self.symbols {
            return Ok(only);
        }
        let (mut code, mut first, mut index) = (0, 0, 0);
        for &count in &self.counts[1..] {
            code |= bits.read(1)?;
            let count = u32::from(count);
            if code < first + count {
                return self
                    .symbols
                    .get((index + code - first) as usize)
                    .copied()
                    .ok_or_else(damaged);
            }
            index += count;
            first = (first + count) << 1;
            code <<= 1;
        }
        Err(damaged())
    }

    /// Bytes of the tables that the decoder builds.
    fn table_bytes(&self) -> u64 {
        let Some(longest) = self.counts.iter().rposition(|&count| count > 0) else {
            return 0;
        };
        let deep: u64 = self
            .counts
            .iter()
            .skip(TABLE_BITS + 1)
            .map(|&count| u64::from(count))
            .sum();
        (TABLE_ENTRY << longest.min(TABLE_BITS)) + TREE_NODE * 2 * deep + ALLOCATOR_BYTES
    }
}

/// Reads bits, starting with the least significant one of each byte.
struct BitReader<'a> {
    rest: &'a [u8],
    buffer: u64,
    count: u32,
    work: &'a StepCounter<'a>,
}

impl BitReader<'_> {
    /// At most 32.
    fn read(&mut self, count: u32) -> Result<u32, CodecError> {
        self.work.step(1)?;
        while self.count < count {
            let (&byte, rest) = self.rest.split_first().ok_or_else(damaged)?;
            self.buffer |= u64::from(byte) << self.count;
            self.count += 8;
            self.rest = rest;
        }
        let value = self.buffer & ((1 << count) - 1);
        self.buffer >>= count;
        self.count -= count;
        u32::try_from(value).map_err(|_| damaged())
    }

    /// At most 16.
    fn symbol(&mut self, count: u32) -> Result<u16, CodecError> {
        self.read(count)
            .and_then(|value| u16::try_from(value).map_err(|_| damaged()))
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::codec::tests::bombs::{Pen, vp8l_head, webp_alpha_transforms, webp_transforms};

    fn weight(stream: &[u8], most: u64) -> Result<u64, CodecError> {
        code_bytes(stream, None, most, &StepCounter::new(&|| false))
    }

    /// A code of `count` symbols, all of one length, in as few bits as there are: only that length
    /// is a symbol of the code for lengths.
    fn equal(pen: &mut Pen, length: usize, count: u32) {
        let place = LENGTH_CODE_ORDER
            .iter()
            .position(|&symbol| symbol == length)
            .unwrap();
        pen.put(0, 1);
        pen.put(u32::try_from(place).unwrap() + 1 - 4, 4);
        (0..=place).for_each(|k| pen.put(u32::from(k == place), 3));
        pen.put(1, 1);
        pen.put(5, 3);
        pen.put(count - 2, 12);
    }

    /// A stream whose entropy image has one literal, and as many groups of the heaviest codes as
    /// that asks for.
    fn bomb(groups: u32) -> Vec<u8> {
        let mut pen = vp8l_head(4, 4);
        // No transform; a cache of 2048 colours; an entropy image of one block, without a cache.
        pen.put(0, 1);
        pen.put(1, 1);
        pen.put(11, 4);
        pen.put(1, 1);
        pen.put(0, 3);
        pen.put(0, 1);
        let last = groups - 1;
        [last & 255, last >> 8, 0, 0, 0]
            .into_iter()
            .for_each(|symbol| pen.only(symbol));
        for _ in 0..groups {
            equal(&mut pen, 11, 2048);
            (0..4).for_each(|_| pen.put(0b0001, 4));
        }
        pen.bytes.extend([0; 64]);
        pen.bytes
    }

    #[test]
    fn bombs_of_code_tables_are_weighed() {
        let of = |groups: u32| weight(&bomb(groups), MAX_CODE_BYTES);
        let each = of(2).unwrap() - of(1).unwrap();
        assert!((69_000..72_000).contains(&each), "{each}");
        assert!(bomb(65_536).len() < 800_000);
        assert!(matches!(of(65_536), Err(CodecError::Bad { .. })));
        // An image of 16 pixels needs fewer.
        assert!(weight(&bomb(10), most_code_bytes(16)).is_ok());
        assert!(matches!(
            weight(&bomb(20), most_code_bytes(16)),
            Err(CodecError::Bad { .. })
        ));
        assert_eq!(most_code_bytes(u64::MAX), MAX_CODE_BYTES);
    }

    /// Every symbol of real files is understood, with every kind of code, copy and cache that
    /// encoders write.
    #[test]
    fn streams_of_real_files_are_walked_to_their_picture() {
        let mut weights = Vec::new();
        let work = StepCounter::new(&|| false);
        for name in [
            "lossless",
            "lossless-alpha",
            "lossless-palette",
            "lossless-regions",
        ] {
            let file = std::fs::read(format!(
                "{}/test_files/seeds/webp-{name}",
                env!("CARGO_MANIFEST_DIR")
            ))
            .unwrap();
            assert_eq!(&file[12..16], b"VP8L");
            let bits = BitReader {
                rest: &file[20..],
                buffer: 0,
                count: 0,
                work: &work,
            };
            let mut walk = Walk {
                bits,
                bytes: 0,
                most: MAX_CODE_BYTES,
            };
            assert!(walk.stream(None).is_ok(), "{name}");
            assert!(!walk.bits.rest.is_empty(), "{name}: the picture is left");
            weights.push(walk.bytes);
        }
        assert!(
            weights
                .iter()
                .all(|weight| (GROUP_BYTES..100_000).contains(weight)),
            "{weights:?}"
        );
        assert!(
            weights[3] > 2 * GROUP_BYTES,
            "regions have groups of their own: {weights:?}"
        );
    }

    #[test]
    fn cut_streams_are_refused() {
        let mut whole = bomb(3);
        whole.truncate(whole.len() - 64);
        assert!(weight(&whole, MAX_CODE_BYTES).is_ok());
        for length in 0..whole.len() - 1 {
            assert!(
                matches!(
                    weight(&whole[..length], MAX_CODE_BYTES),
                    Err(CodecError::Bad { .. })
                ),
                "{length}"
            );
        }
    }

    /// RFC 9649, section 4: "each transform is allowed to be used only once".
    #[test]
    fn a_second_transform_of_a_kind_is_refused() {
        let transform = |pen: &mut Pen, kind: u32| {
            pen.put(1, 1);
            pen.put(kind, 2);
            match kind {
                0 | 1 => pen.put(0, 3),
                3 => pen.put(0, 8),
                _ => return,
            }
            pen.put(0, 1);
            (0..5).for_each(|_| pen.put(0b0001, 4));
        };
        for (kinds, refused) in [
            (&[0, 1, 2, 3][..], false),
            (&[3, 2, 1, 0], false),
            (&[2, 2], true),
            (&[0, 1, 0], true),
            (&[3, 2, 3], true),
        ] {
            let mut pen = vp8l_head(64, 64);
            kinds.iter().for_each(|&kind| transform(&mut pen, kind));
            // No more; no cache, no regions, one group of codes.
            pen.put(0, 3);
            (0..5).for_each(|_| pen.put(0b0001, 4));
            let told = weight(&pen.bytes, MAX_CODE_BYTES);
            assert_eq!(told.is_err(), refused, "{kinds:?}: {told:?}");
            if let Err(error) = told {
                assert!(error.to_string().contains("twice"), "{error}");
            }
        }
    }

    /// What a stream's bits cost does not depend on the size that it claims.
    #[test]
    fn images_whose_symbols_take_no_bits_are_skipped_in_one_step() {
        let steps = |file: &[u8], at: usize, size: Option<(u32, u32)>| {
            let work = StepCounter::new(&|| false);
            let _ = code_bytes(&file[at..], size, MAX_CODE_BYTES, &work);
            work.steps()
        };
        for count in [1, 2, 30, 1_000] {
            let small = steps(&webp_transforms(4, 4, count), 20, None);
            assert_eq!(
                steps(&webp_transforms(16_384, 16_384, count), 20, None),
                small
            );
            assert!(small < 1_000, "{small}");
        }
        let alpha = webp_alpha_transforms(16_383, 16_383, 30);
        let at = alpha.windows(4).position(|kind| kind == b"ALPH").unwrap() + 9;
        assert!(steps(&alpha, at, Some((16_383, 16_383))) < 1_000);
    }

    #[test]
    fn a_walk_ends_when_the_picture_is_no_longer_wanted() {
        let mut pen = vp8l_head(16_384, 16_384);
        // A predictor whose image has two symbols: each pixel takes a bit.
        pen.put(0b001, 3);
        pen.put(0, 3);
        pen.put(0, 1);
        pen.put(0b011, 3);
        pen.put(0, 1);
        pen.put(1, 8);
        (0..4).for_each(|_| pen.put(0b0001, 4));
        pen.bytes.extend(vec![0; 3 << 20]);
        let told = |cancelled: &dyn Fn() -> bool| {
            code_bytes(
                &pen.bytes,
                None,
                MAX_CODE_BYTES,
                &StepCounter::new(cancelled),
            )
            .unwrap_err()
        };
        assert_eq!(told(&|| true), CodecError::Cancelled);
        assert_eq!(told(&|| false), damaged(), "behind it there is no picture");
    }
}
