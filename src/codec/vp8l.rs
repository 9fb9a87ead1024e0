//! What a lossless WebP stream (RFC 9649, section 3) makes its decoder build before the first pixel: the tables of its prefix codes. A
//! stream may hold 65,536 groups of five codes whatever the size of its picture, and eight bytes of it can describe a code whose tables
//! take 70 KiB: a file of 672 kB took 3.6 GB. So the stream is walked up to its picture here, without building anything: the images of
//! the transforms are skipped symbol by symbol (how many bits they take does not depend on their pixels), the number of groups is the
//! largest literal of the entropy image, and each code's lengths tell what its tables will weigh. Cost: a few times the decoder's own work
//! on the same bits, which are few in real files.

/// Tables of more bytes than this are refused. Encoders stay far below it: libwebp makes at most 2,600 groups, of some 20 KiB each.
pub(super) const MAX_CODE_BYTES: u64 = 128 << 20;

const LENGTH_CODES: usize = 19;
const LENGTH_CODE_ORDER: [usize; LENGTH_CODES] = [17, 18, 0, 1, 2, 3, 4, 5, 16, 6, 7, 8, 9, 10, 11, 12, 13, 14, 15];
const LONGEST: usize = 15;
/// Green (and lengths), red, blue, alpha, distances.
const ALPHABETS: [usize; 5] = [256 + LENGTH_SYMBOLS, 256, 256, 256, 40];
const LENGTH_SYMBOLS: usize = 24;
/// Symbols of longer codes get two nodes each of a tree behind the decoder's table.
const TABLE_BITS: usize = 10;
const TABLE_ENTRY: u64 = 4;
const TREE_NODE: u64 = 16;
/// Five codes in a vector that doubles: what is old is there while it is copied.
const GROUP: u64 = 3 * 5 * 56;
/// What an allocator keeps beside a code's two blocks.
const BLOCKS: u64 = 32;

/// Bytes of the tables that a decoder builds for a stream: the whole of a `VP8L` chunk (`size: None`), or what follows the first byte of an
/// `ALPH` chunk. Of a damaged stream, up to the damage; a little more than [`MAX_CODE_BYTES`] when there are more.
pub(super) fn code_bytes(stream: &[u8], size: Option<(u32, u32)>) -> u64 {
    let mut walk = Walk { bits: Bits { rest: stream, buffer: 0, count: 0 }, bytes: 0 };
    // Where the walk stops early the decoder does too, and says why.
    let _ = walk.stream(size);
    walk.bytes
}

struct Walk<'a> {
    bits: Bits<'a>,
    bytes: u64,
}

impl Walk<'_> {
    fn stream(&mut self, size: Option<(u32, u32)>) -> Option<()> {
        let (mut width, height) = match size {
            Some(size) => size,
            None => {
                self.bits.read(8)?;
                let size = (self.bits.read(14)? + 1, self.bits.read(14)? + 1);
                self.bits.read(4)?;
                size
            }
        };
        while self.bits.read(1)? == 1 {
            match self.bits.read(2)? {
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
            self.bytes += GROUP;
            for (k, alphabet) in ALPHABETS.into_iter().enumerate() {
                let code = Code::read(&mut self.bits, alphabet + if k == 0 { cached } else { 0 })?;
                self.bytes += code.table_bytes();
            }
            if self.bytes > MAX_CODE_BYTES {
                return None;
            }
        }
        Some(())
    }

    fn cached_colours(&mut self) -> Option<usize> {
        if self.bits.read(1)? == 0 {
            return Some(0);
        }
        let bits = self.bits.read(4)?;
        (1..=11).contains(&bits).then_some(1 << bits)
    }

    /// Skips an image that has one group of codes. The largest number that red and green of a pixel make: copies repeat what stood before.
    fn image(&mut self, width: u32, height: u32) -> Option<u32> {
        let cached = self.cached_colours()?;
        let mut group = Vec::with_capacity(ALPHABETS.len());
        for (k, alphabet) in ALPHABETS.into_iter().enumerate() {
            group.push(Code::read(&mut self.bits, alphabet + if k == 0 { cached } else { 0 })?);
        }
        let [green, red, blue, alpha, distance] = group.as_slice() else { return None };
        if let ([green @ 0..256], [red], [_], [_]) = (&*green.symbols, &*red.symbols, &*blue.symbols, &*alpha.symbols) {
            return Some(u32::from(red << 8 | green));
        }
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
                    at += u64::from(self.count(symbol - 256)?);
                    let far = distance.symbol(&mut self.bits)?;
                    self.count(far)?;
                }
                _ => at += 1,
            }
        }
        Some(largest)
    }

    /// A length or a distance behind its prefix.
    fn count(&mut self, prefix: u16) -> Option<u32> {
        let prefix = u32::from(prefix);
        if prefix < 4 {
            return Some(prefix + 1);
        }
        let extra = (prefix - 2) >> 1;
        Some(((2 + (prefix & 1)) << extra) + self.bits.read(extra)? + 1)
    }
}

/// Blocks of `2^bits` along a side.
fn blocks(side: u32, bits: u32) -> u32 {
    side.div_ceil(1 << bits)
}

/// A canonical prefix code.
struct Code {
    /// Codes of each length.
    counts: [u16; LONGEST + 1],
    /// In the order of their codes.
    symbols: Vec<u16>,
}

impl Code {
    fn read(bits: &mut Bits<'_>, alphabet: usize) -> Option<Self> {
        if bits.read(1)? == 1 {
            let two = bits.read(1)? == 1;
            let first_bits = if bits.read(1)? == 1 { 8 } else { 1 };
            let mut symbols = vec![bits.symbol(first_bits)?];
            if two {
                symbols.push(bits.symbol(8)?);
            }
            let mut counts = [0; LONGEST + 1];
            counts[1] = if two { 2 } else { 0 };
            return symbols.iter().all(|&symbol| usize::from(symbol) < alphabet).then_some(Self { counts, symbols });
        }
        let mut lengths = [0; LENGTH_CODES];
        let given = bits.read(4)? as usize + 4;
        for &symbol in LENGTH_CODE_ORDER.get(..given)? {
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
        if lengths.len() > alphabet { None } else { Self::of_lengths(&lengths) }
    }

    /// Whole codes only: every run of bits means something.
    fn of_lengths(lengths: &[u16]) -> Option<Self> {
        let mut counts = [0; LONGEST + 1];
        let used = || (0..).zip(lengths).filter(|(_, length)| **length > 0);
        for (_, &length) in used() {
            *counts.get_mut(usize::from(length))? += 1;
        }
        let symbols = if used().count() == 1 {
            counts = [0; LONGEST + 1];
            used().map(|(symbol, _)| symbol).collect()
        } else {
            let filled: u32 = (0..).zip(counts).skip(1).map(|(length, count)| u32::from(count) << (15 - length)).sum();
            if filled != 1 << LONGEST {
                return None;
            }
            let mut places = [0; LONGEST + 1];
            for length in 1..LONGEST {
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
        Some(Self { counts, symbols })
    }

    /// The next symbol; the only one takes no bits.
    fn symbol(&self, bits: &mut Bits<'_>) -> Option<u16> {
        if let [only] = *self.symbols {
            return Some(only);
        }
        let (mut code, mut first, mut index) = (0, 0, 0);
        for &count in &self.counts[1..] {
            code |= bits.read(1)?;
            let count = u32::from(count);
            if code < first + count {
                return self.symbols.get((index + code - first) as usize).copied();
            }
            index += count;
            first = (first + count) << 1;
            code <<= 1;
        }
        None
    }

    /// What the decoder builds of it.
    fn table_bytes(&self) -> u64 {
        let Some(longest) = self.counts.iter().rposition(|&count| count > 0) else { return 0 };
        let deep: u64 = self.counts.iter().skip(TABLE_BITS + 1).map(|&count| u64::from(count)).sum();
        (TABLE_ENTRY << longest.min(TABLE_BITS)) + TREE_NODE * 2 * deep + BLOCKS
    }
}

/// Bits from the least significant one of each byte.
struct Bits<'a> {
    rest: &'a [u8],
    buffer: u64,
    count: u32,
}

impl Bits<'_> {
    /// At most 32.
    fn read(&mut self, count: u32) -> Option<u32> {
        while self.count < count {
            let (&byte, rest) = self.rest.split_first()?;
            self.buffer |= u64::from(byte) << self.count;
            self.count += 8;
            self.rest = rest;
        }
        let value = self.buffer & ((1 << count) - 1);
        self.buffer >>= count;
        self.count -= count;
        u32::try_from(value).ok()
    }

    /// At most 16.
    fn symbol(&mut self, count: u32) -> Option<u16> {
        self.read(count).and_then(|value| u16::try_from(value).ok())
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Numbers written as the format reads them.
    #[derive(Default)]
    struct Pen {
        bytes: Vec<u8>,
        used: u32,
    }

    impl Pen {
        fn put(&mut self, value: u32, count: u32) {
            for k in 0..count {
                if self.used.is_multiple_of(8) {
                    self.bytes.push(0);
                }
                *self.bytes.last_mut().unwrap() |= u8::from(value >> k & 1 == 1) << (self.used % 8);
                self.used += 1;
            }
        }

        /// A code of one symbol below 256.
        fn only(&mut self, symbol: u32) {
            self.put(0b101, 3);
            self.put(symbol, 8);
        }

        /// A code of `count` symbols, all of one length, told in as few bits as there are: only that length is a symbol.
        fn equal(&mut self, length: usize, count: u32) {
            let place = LENGTH_CODE_ORDER.iter().position(|&symbol| symbol == length).unwrap();
            self.put(0, 1);
            self.put(u32::try_from(place).unwrap() + 1 - 4, 4);
            (0..=place).for_each(|k| self.put(u32::from(k == place), 3));
            self.put(1, 1);
            self.put(5, 3);
            self.put(count - 2, 12);
        }
    }

    /// A stream whose entropy image has one literal, and as many groups of the heaviest codes as that asks for.
    fn bomb(groups: u32) -> Vec<u8> {
        let mut pen = Pen::default();
        pen.put(0x2F, 8);
        pen.put(3, 14);
        pen.put(3, 14);
        pen.put(0, 4);
        // No transform; a cache of 2048 colours; an entropy image of one block, without a cache.
        pen.put(0, 1);
        pen.put(1, 1);
        pen.put(11, 4);
        pen.put(1, 1);
        pen.put(0, 3);
        pen.put(0, 1);
        let last = groups - 1;
        [last & 255, last >> 8, 0, 0, 0].into_iter().for_each(|symbol| pen.only(symbol));
        for _ in 0..groups {
            pen.equal(11, 2048);
            (0..4).for_each(|_| pen.put(0b0001, 4));
        }
        pen.bytes.extend([0; 64]);
        pen.bytes
    }

    #[test]
    fn bombs_of_code_tables_are_weighed() {
        let weight = |groups: u32| code_bytes(&bomb(groups), None);
        let each = weight(2) - weight(1);
        assert!((69_000..72_000).contains(&each), "{each}");
        assert!(bomb(65_536).len() < 800_000);
        assert!(weight(65_536) > MAX_CODE_BYTES && weight(65_536) < MAX_CODE_BYTES + 2 * each, "the walk ends early");
    }

    /// Every symbol of real files is understood, with every kind of code, copy and cache that encoders write.
    #[test]
    fn streams_of_real_files_are_walked_to_their_picture() {
        let mut weights = Vec::new();
        for name in ["lossless", "lossless-alpha", "lossless-palette", "lossless-regions"] {
            let file = std::fs::read(format!("{}/tests/fuzz/seeds/image/webp-{name}", env!("CARGO_MANIFEST_DIR"))).unwrap();
            assert_eq!(&file[12..16], b"VP8L");
            let mut walk = Walk { bits: Bits { rest: &file[20..], buffer: 0, count: 0 }, bytes: 0 };
            assert_eq!(walk.stream(None), Some(()), "{name}");
            assert!(!walk.bits.rest.is_empty(), "{name}: the picture is left");
            weights.push(walk.bytes);
        }
        assert!(weights.iter().all(|weight| (GROUP..100_000).contains(weight)), "{weights:?}");
        assert!(weights[3] > 2 * GROUP, "regions have groups of their own: {weights:?}");
    }

    #[test]
    fn cut_streams_end_the_walk() {
        let whole = bomb(3);
        let weights: Vec<u64> = (0..whole.len()).map(|length| code_bytes(&whole[..length], None)).collect();
        assert!(weights.is_sorted(), "{weights:?}");
    }
}
