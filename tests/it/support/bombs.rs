//! Files that are made to cost more than they weigh. Each is small enough to be sent many times.

use std::io::Write as _;

use flate2::Compression;
use flate2::write::ZlibEncoder;

/// A PNG file of given chunks.
pub(crate) fn png(chunks: &[(&[u8; 4], Vec<u8>)]) -> Vec<u8> {
    let mut file = b"\x89PNG\r\n\x1a\n".to_vec();
    for (name, data) in chunks {
        file.extend_from_slice(&u32::try_from(data.len()).unwrap().to_be_bytes());
        let body = [&name[..], data].concat();
        file.extend_from_slice(&body);
        file.extend_from_slice(&crc32fast::hash(&body).to_be_bytes());
    }
    file
}

/// The header chunk of an RGB picture of 8 bits.
pub(crate) fn ihdr(width: u32, height: u32) -> Vec<u8> {
    [
        &width.to_be_bytes()[..],
        &height.to_be_bytes(),
        &[8, 2, 0, 0, 0],
    ]
    .concat()
}

/// `bytes` zeros, rounded down to whole MiB, in a thousandth of their size.
pub(crate) fn deflated_zeros(bytes: usize) -> Vec<u8> {
    let mut encoder = ZlibEncoder::new(Vec::new(), Compression::best());
    let zeros = vec![0; 1 << 20];
    for _ in 0..bytes >> 20 {
        encoder.write_all(&zeros).unwrap();
    }
    encoder.finish().unwrap()
}

/// Numbers written bit by bit, the lowest bit first: how deflate and lossless WebP write them.
#[derive(Clone, Debug, Default)]
pub(crate) struct Pen {
    pub(crate) bytes: Vec<u8>,
    used: u32,
}

impl Pen {
    pub(crate) fn put(&mut self, value: u32, count: u32) {
        for k in 0..count {
            if self.used.is_multiple_of(8) {
                self.bytes.push(0);
            }
            *self.bytes.last_mut().unwrap() |= u8::from(value >> k & 1 == 1) << (self.used % 8);
            self.used += 1;
        }
    }

    /// Goes on at the next whole byte.
    fn align(&mut self) {
        self.used = self.used.next_multiple_of(8);
    }

    /// A prefix code of lossless WebP with one symbol below 256: the symbol takes no bits.
    pub(crate) fn only(&mut self, symbol: u32) {
        self.put(0b101, 3);
        self.put(symbol, 8);
    }

    /// The same in four bits, with symbol 0.
    fn only_zero(&mut self) {
        self.put(0b0001, 4);
    }

    /// A code for green with one symbol from 256 on, which takes no bits either.
    fn only_far(&mut self, symbol: u32) {
        // Of code lengths, 18 (a run of zeros) is `1`, and 1 is `0`; four of them are read: three
        // runs and the symbol's own.
        self.put(0, 1);
        self.put(0, 4);
        [0, 1, 0, 1]
            .into_iter()
            .for_each(|length| self.put(length, 3));
        self.put(1, 1);
        self.put(0, 3);
        self.put(2, 2);
        for zeros in [100, 100, symbol - 200] {
            self.put(1, 1);
            self.put(zeros - 11, 7);
        }
        self.put(0, 1);
    }
}

/// The head of a lossless WebP stream without alpha.
pub(crate) fn vp8l_head(width: u32, height: u32) -> Pen {
    let mut pen = Pen::default();
    pen.put(0x2F, 8);
    pen.put(width - 1, 14);
    pen.put(height - 1, 14);
    pen.put(0, 4);
    pen
}

/// The same predictor transform again and again, each with the largest image that its picture
/// allows. The pixels of the images take no bits: all have the same colour of a cache.
fn transforms(mut pen: Pen, count: usize) -> Vec<u8> {
    for _ in 0..count {
        // A transform; the predictor, in blocks of 4 x 4; a cache of two colours.
        pen.put(0b001, 3);
        pen.put(0, 3);
        pen.put(0b00011, 5);
        pen.only_far(280);
        (0..4).for_each(|_| pen.only_zero());
    }
    pen.bytes.extend([0; 16]);
    pen.bytes
}

/// A lossless WebP with one transform, whose image is made of copies: there is nothing that they
/// could copy.
pub(crate) fn webp_transform_of_copies(width: u32, height: u32) -> Vec<u8> {
    let mut pen = vp8l_head(width, height);
    pen.put(0b001, 3);
    pen.put(0, 4);
    pen.only_far(256);
    (0..4).for_each(|_| pen.only_zero());
    pen.bytes.extend([0; 16]);
    riff(&[(b"VP8L", pen.bytes)])
}

/// A lossless WebP with `count` transforms of one kind.
pub(crate) fn webp_transforms(width: u32, height: u32, count: usize) -> Vec<u8> {
    riff(&[(b"VP8L", transforms(vp8l_head(width, height), count))])
}

/// The same in the alpha of a lossy WebP.
pub(crate) fn webp_alpha_transforms(width: u16, height: u16, count: usize) -> Vec<u8> {
    let stream = transforms(Pen::default(), count);
    riff(&[
        (b"VP8X", canvas(0x10, width, height)),
        (b"ALPH", [&[1], &stream[..]].concat()),
        (b"VP8 ", vp8(width, height)),
    ])
}

/// A lossless WebP whose pixels take no bits: each is the same colour of the cache.
pub(crate) fn webp_of_one_cached_colour(width: u32, height: u32) -> Vec<u8> {
    let mut pen = vp8l_head(width, height);
    // No transform; a cache of two colours; one group of codes.
    pen.put(0, 1);
    pen.put(1, 1);
    pen.put(1, 4);
    pen.put(0, 1);
    pen.only_far(280);
    (0..4).for_each(|_| pen.only_zero());
    pen.bytes.extend([0; 16]);
    riff(&[(b"VP8L", pen.bytes)])
}

/// A lossless WebP whose pixels take no bits, but for the first of a region: each is a copy of one
/// pixel. `side`: 512 or a multiple of it.
pub(crate) fn webp_of_copies(side: u32) -> Vec<u8> {
    let mut pen = vp8l_head(side, side);
    // No transform, no cache; regions of 256: the first has group 0, the others group 1.
    pen.put(0, 2);
    pen.put(1, 1);
    pen.put(8 - 2, 3);
    pen.put(0, 1);
    // Green is 0 or 1.
    pen.put(0b011, 3);
    pen.put(0, 1);
    pen.put(1, 8);
    (0..4).for_each(|_| pen.only_zero());
    (0..(side / 256).pow(2)).for_each(|region| pen.put(u32::from(region > 0), 1));
    // Group 0: black. Group 1: copies of the pixel before.
    (0..5).for_each(|_| pen.only_zero());
    pen.only_far(256);
    (0..3).for_each(|_| pen.only_zero());
    pen.only(1);
    pen.bytes.extend([0; 16]);
    riff(&[(b"VP8L", pen.bytes)])
}

/// A block of deflate that holds nothing.
#[derive(Clone, Copy, Debug)]
pub(crate) enum EmptyBlock {
    Stored,
    Fixed,
    /// With tables of its own, which an inflater builds: 12 bytes.
    Dynamic,
}

impl EmptyBlock {
    fn put(self, pen: &mut Pen) {
        match self {
            Self::Stored => {
                pen.put(0, 3);
                pen.align();
                pen.put(0, 16);
                pen.put(0xFFFF, 16);
            }
            Self::Fixed => pen.put(0b010, 10),
            Self::Dynamic => {
                pen.put(0b100, 3);
                pen.put(0, 10);
                // Lengths of the code for lengths, 18 of them: 18 and 0 have two bits (`11` and
                // `10`), 1 has one (`0`).
                pen.put(14, 4);
                (0..18).for_each(|k| {
                    pen.put([0, 0, 2, 2, 0, 0, 0, 0, 0, 0, 0, 0, 0, 0, 0, 0, 0, 1][k], 3)
                });
                // Symbols 0 and 256 have one bit, and so has the one distance.
                pen.put(0, 1);
                for zeros in [138, 117] {
                    pen.put(0b11, 2);
                    pen.put(zeros - 11, 7);
                }
                pen.put(0b00, 2);
                pen.put(1, 1);
            }
        }
    }
}

/// Bytes behind `count` empty blocks, as zlib has them.
pub(crate) fn behind_blocks(block: EmptyBlock, count: usize, bytes: &[u8]) -> Vec<u8> {
    let mut pen = Pen::default();
    pen.put(0x0178, 16);
    (0..count).for_each(|_| block.put(&mut pen));
    for (k, part) in bytes.chunks(65_535).enumerate() {
        pen.put(u32::from((k + 1) * 65_535 >= bytes.len()), 3);
        pen.align();
        let length = u32::try_from(part.len()).unwrap();
        pen.put(length, 16);
        pen.put(!length & 0xFFFF, 16);
        pen.bytes.extend(part);
    }
    let (mut a, mut b) = (1_u32, 0_u32);
    for &byte in bytes {
        a = (a + u32::from(byte)) % 65_521;
        b = (b + a) % 65_521;
    }
    pen.bytes.extend((b << 16 | a).to_be_bytes());
    pen.bytes
}

/// An RGB PNG of zeros behind `count` empty blocks.
pub(crate) fn png_behind_blocks(side: u32, block: EmptyBlock, count: usize) -> Vec<u8> {
    let rows = vec![0; (side * (1 + 3 * side)) as usize];
    png(&[
        (b"IHDR", ihdr(side, side)),
        (b"IDAT", behind_blocks(block, count, &rows)),
        (b"IEND", vec![]),
    ])
}

fn deflated(bytes: &[u8]) -> Vec<u8> {
    let mut encoder = ZlibEncoder::new(Vec::new(), Compression::fast());
    encoder.write_all(bytes).unwrap();
    encoder.finish().unwrap()
}

/// An EXIF block (without its six bytes of name) whose directories point into each other, and whose
/// values lie nowhere.
fn exif_loop() -> Vec<u8> {
    let mut block = b"II*\0\x08\0\0\0".to_vec();
    block.extend(400_u16.to_le_bytes());
    for entry in 0..400_u16 {
        // Sub-directories, thumbnails and orientations in turn, each at the first directory or
        // beyond the end.
        let tag = [0x8769_u16, 0x0112, 0x0201, 0xA005][usize::from(entry % 4)];
        block.extend(tag.to_le_bytes());
        block.extend([4, 0, 0xFF, 0xFF, 0xFF, 0x7F]);
        block.extend(if entry % 2 == 0 {
            [8, 0, 0, 0]
        } else {
            [0xFF; 4]
        });
    }
    block.extend([8, 0, 0, 0]);
    block
}

/// A segment of a JPEG.
fn segment(marker: u8, data: &[u8]) -> Vec<u8> {
    [
        &[0xFF, marker],
        &(u16::try_from(data.len()).unwrap() + 2).to_be_bytes()[..],
        data,
    ]
    .concat()
}

fn jpeg_head(width: u16, height: u16, sof: u8) -> Vec<u8> {
    let frame = [
        &[8],
        &height.to_be_bytes()[..],
        &width.to_be_bytes(),
        &[1, 1, 0x11, 0],
    ]
    .concat();
    // Codes of one bit: no difference, and the end of 16384 blocks and more.
    let code =
        |class: u8, symbol: u8| [&[class, 1, 1], [0; 14].as_slice(), &[symbol, 0x01]].concat();
    [
        vec![0xFF, 0xD8],
        segment(0xDB, &[&[0], [8; 64].as_slice()].concat()),
        segment(sof, &frame),
        segment(0xC4, &code(0, 0)),
        segment(0xC4, &code(0x10, 0xE0)),
    ]
    .concat()
}

/// A progressive grey JPEG whose scans each pass over every block in a few bytes.
pub(crate) fn jpeg_scans(side: u16, scans: usize) -> Vec<u8> {
    let blocks = usize::from(side.div_ceil(8)).pow(2);
    let mut file = jpeg_head(side, side, 0xC2);
    file.extend(segment(0xDA, &[1, 1, 0, 0, 0, 0]));
    file.resize(file.len() + blocks.div_ceil(8), 0);
    // A run of 16384 + 16383 blocks is a zero and 14 ones: written as runs of 16384, a zero and 14
    // zeros.
    let runs = vec![0; (blocks.div_ceil(16_384) * 15).div_ceil(8)];
    for _ in 0..scans {
        file.extend(segment(0xDA, &[1, 1, 0, 1, 63, 0]));
        file.extend(&runs);
    }
    file.extend([0xFF, 0xD9]);
    file
}

pub(crate) fn riff(chunks: &[(&[u8; 4], Vec<u8>)]) -> Vec<u8> {
    let mut file = b"RIFF\0\0\0\0WEBP".to_vec();
    for (name, data) in chunks {
        file.extend_from_slice(&name[..]);
        file.extend(u32::try_from(data.len()).unwrap().to_le_bytes());
        file.extend(data);
        file.resize(file.len().next_multiple_of(2), 0);
    }
    let size = u32::try_from(file.len()).unwrap() - 8;
    file[4..8].copy_from_slice(&size.to_le_bytes());
    file
}

pub(crate) fn canvas(flags: u8, width: u16, height: u16) -> Vec<u8> {
    let [width, height] = [width, height].map(|side| (u32::from(side) - 1).to_le_bytes());
    [&[flags, 0, 0, 0], &width[..3], &height[..3]].concat()
}

/// The head of a lossy frame, and too little data.
fn vp8(width: u16, height: u16) -> Vec<u8> {
    [
        &[0x10, 2, 0, 0x9D, 0x01, 0x2A],
        &width.to_le_bytes()[..],
        &height.to_le_bytes(),
        &[0; 64],
    ]
    .concat()
}

/// Every bomb with its name and the statuses that may answer it; `code_tables` is the file of that
/// name.
pub(crate) fn all(code_tables: &[u8]) -> Vec<(&'static str, Vec<u8>, &'static [u16])> {
    let row = || deflated(&[0; 1 + 3]);
    let one = |chunks: &[(&[u8; 4], Vec<u8>)]| {
        let mut all = vec![(b"IHDR", ihdr(1, 1))];
        all.extend_from_slice(chunks);
        all.extend([(b"IDAT", row()), (b"IEND", vec![])]);
        png(&all)
    };
    let zeros = deflated_zeros(200 << 20);
    let named = |head: &[u8]| [head, &zeros].concat();
    let mut interlaced = ihdr(16_384, 3_000);
    interlaced[12] = 1;
    let control = [
        &[0; 4][..],
        &60_000_u32.to_be_bytes(),
        &60_000_u32.to_be_bytes(),
        &[0; 14],
    ]
    .concat();
    let frame = |vp8l: &[u8]| {
        [
            &[0; 6][..],
            &[3, 0, 0, 3, 0, 0],
            &[0; 4],
            b"VP8L",
            &u32::try_from(vp8l.len()).unwrap().to_le_bytes(),
            vp8l,
        ]
        .concat()
    };
    let tables = &code_tables[20..];
    vec![
        (
            "png of 60000 x 60000",
            png(&[
                (b"IHDR", ihdr(60_000, 60_000)),
                (b"IDAT", row()),
                (b"IEND", vec![]),
            ]),
            &[413],
        ),
        (
            "png of 49 MP without data",
            png(&[
                (b"IHDR", ihdr(7_000, 7_000)),
                (b"IDAT", row()),
                (b"IEND", vec![]),
            ]),
            &[422],
        ),
        (
            "png, interlaced, without data",
            png(&[(b"IHDR", interlaced), (b"IDAT", row()), (b"IEND", vec![])]),
            &[422],
        ),
        (
            "png with 200 MiB behind its pixel",
            png(&[
                (b"IHDR", ihdr(1, 1)),
                (b"IDAT", zeros.clone()),
                (b"IEND", vec![]),
            ]),
            &[422],
        ),
        (
            "png with a profile of 200 MiB",
            one(&[(b"iCCP", named(b"name\0\0"))]),
            &[200],
        ),
        (
            "png with a text of 200 MiB",
            one(&[(b"zTXt", named(b"name\0\0"))]),
            &[200],
        ),
        (
            "png with an international text of 200 MiB",
            one(&[(b"iTXt", named(b"name\0\x01\0\0\0"))]),
            &[200],
        ),
        (
            "png of many chunks",
            one(&vec![(b"teXt", vec![]); 100_000]),
            &[200],
        ),
        (
            "png of many palettes",
            one(&vec![(b"PLTE", vec![1; 768]); 1_000]),
            &[200, 422],
        ),
        (
            "png with EXIF in a loop",
            one(&[(b"eXIf", exif_loop())]),
            &[200],
        ),
        (
            "png with a frame of 60000 x 60000",
            one(&[(b"acTL", vec![0, 0, 0, 1, 0, 0, 0, 0]), (b"fcTL", control)]),
            &[200],
        ),
        (
            "png of four billion frames",
            one(&[(b"acTL", [0xFF; 8].to_vec())]),
            &[413],
        ),
        (
            "jpeg of 65535 x 65535",
            [
                jpeg_head(65_535, 65_535, 0xC0),
                segment(0xDA, &[1, 1, 0, 0, 63, 0]),
                vec![0; 64],
                vec![0xFF, 0xD9],
            ]
            .concat(),
            &[413],
        ),
        (
            "jpeg of 49 MP without data",
            [
                jpeg_head(7_000, 7_000, 0xC2),
                segment(0xDA, &[1, 1, 0, 0, 0, 0]),
                vec![0xFF, 0xD9],
            ]
            .concat(),
            &[422],
        ),
        ("jpeg of 5000 scans", jpeg_scans(64, 5_000), &[422]),
        (
            "jpeg of fill bytes",
            [vec![0xFF, 0xD8], vec![0xFF; 4 << 20]].concat(),
            &[422],
        ),
        (
            "jpeg of comments",
            [vec![0xFF, 0xD8], segment(0xFE, &[]).repeat(500_000)].concat(),
            &[422],
        ),
        (
            "jpeg of tables",
            [
                jpeg_head(64, 64, 0xC2),
                jpeg_head(8, 8, 0xC2)[73..].repeat(20_000),
                vec![0xFF, 0xD9],
            ]
            .concat(),
            &[422],
        ),
        (
            "jpeg with EXIF in a loop",
            with_exif(&jpeg_scans(64, 1), &exif_loop()),
            &[200],
        ),
        (
            "webp with a canvas of 2^48",
            riff(&[
                (
                    b"VP8X",
                    [0, 0, 0, 0, 0xFF, 0xFF, 0xFF, 0xFF, 0xFF, 0xFF].to_vec(),
                ),
                (b"VP8 ", vp8(16, 16)),
            ]),
            &[422],
        ),
        (
            "webp of 16383 x 16383",
            riff(&[(b"VP8 ", vp8(16_383, 16_383))]),
            &[413],
        ),
        (
            "webp, lossless, of 16384 x 16384",
            riff(&[(
                b"VP8L",
                [&[0x2F, 0xFF, 0xFF, 0xFF, 0x0F], [0; 64].as_slice()].concat(),
            )]),
            &[413],
        ),
        ("webp of many code tables", code_tables.to_vec(), &[422]),
        (
            "webp of many code tables in a frame",
            riff(&[
                (b"VP8X", vec![2, 0, 0, 0, 3, 0, 0, 3, 0, 0]),
                (b"ANIM", vec![0; 6]),
                (b"ANMF", frame(tables)),
            ]),
            &[422],
        ),
        (
            "webp of many code tables in its alpha",
            riff(&[
                (b"VP8X", vec![0x10, 0, 0, 0, 3, 0, 0, 3, 0, 0]),
                (b"ALPH", [&[1], &tables[5..]].concat()),
                (b"VP8 ", vp8(4, 4)),
            ]),
            &[422],
        ),
        (
            "webp of many frames",
            riff(
                &[
                    &[(b"VP8X", vec![2, 0, 0, 0, 3, 0, 0, 3, 0, 0])][..],
                    &vec![(b"ANMF", frame(&[])); 10_000],
                ]
                .concat(),
            ),
            &[413],
        ),
        (
            "png of empty stored blocks",
            png_behind_blocks(1, EmptyBlock::Stored, 200_000),
            &[422],
        ),
        (
            "png of empty fixed blocks",
            png_behind_blocks(1, EmptyBlock::Fixed, 800_000),
            &[422],
        ),
        (
            "png of empty dynamic blocks",
            png_behind_blocks(1, EmptyBlock::Dynamic, 80_000),
            &[422],
        ),
        (
            "png of some empty stored blocks",
            png_behind_blocks(300, EmptyBlock::Stored, 40_000),
            &[200],
        ),
        (
            "png of some empty fixed blocks",
            png_behind_blocks(300, EmptyBlock::Fixed, 160_000),
            &[200],
        ),
        (
            "png of some empty dynamic blocks",
            png_behind_blocks(300, EmptyBlock::Dynamic, 16_000),
            &[200],
        ),
        (
            "png of empty data chunks",
            one(&vec![(b"IDAT", vec![]); 100_000]),
            &[422],
        ),
        (
            "png with a profile behind empty blocks",
            one(&[(
                b"iCCP",
                [
                    b"name\0\0",
                    &behind_blocks(EmptyBlock::Dynamic, 100_000, b"nothing")[..],
                ]
                .concat(),
            )]),
            &[200],
        ),
        (
            "webp of 30 transforms",
            webp_transforms(16_384, 3_000, 30),
            &[422],
        ),
        (
            "webp of 1000 transforms",
            webp_transforms(16_384, 3_000, 1_000),
            &[422],
        ),
        (
            "webp of 1000 transforms, too large",
            webp_transforms(16_384, 16_384, 1_000),
            &[413],
        ),
        (
            "webp with an alpha of 30 transforms",
            webp_alpha_transforms(16_383, 3_000, 30),
            &[422],
        ),
        (
            "webp whose transform is made of copies",
            webp_transform_of_copies(16_384, 3_000),
            &[422],
        ),
        (
            "webp of one cached colour",
            webp_of_one_cached_colour(1_000, 1_000),
            &[200],
        ),
        ("webp of copies", webp_of_copies(512), &[200]),
        (
            "webp of many chunks",
            riff(&vec![(b"zzzz", vec![]); 200_000]),
            &[422],
        ),
    ]
}

/// A JPEG with an EXIF block.
fn with_exif(jpeg: &[u8], exif: &[u8]) -> Vec<u8> {
    let block = segment(0xE1, &[b"Exif\0\0", exif].concat());
    [&jpeg[..2], &block, &jpeg[2..]].concat()
}
