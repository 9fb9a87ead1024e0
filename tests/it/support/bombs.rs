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
    [&width.to_be_bytes()[..], &height.to_be_bytes(), &[8, 2, 0, 0, 0]].concat()
}

/// So many zeros, rounded down to whole MiB, in a thousandth of their size.
pub(crate) fn deflated_zeros(bytes: usize) -> Vec<u8> {
    let mut encoder = ZlibEncoder::new(Vec::new(), Compression::best());
    let zeros = vec![0; 1 << 20];
    for _ in 0..bytes >> 20 {
        encoder.write_all(&zeros).unwrap();
    }
    encoder.finish().unwrap()
}

fn deflated(bytes: &[u8]) -> Vec<u8> {
    let mut encoder = ZlibEncoder::new(Vec::new(), Compression::fast());
    encoder.write_all(bytes).unwrap();
    encoder.finish().unwrap()
}

/// An EXIF block (without its six bytes of name) whose directories point into each other, and whose values lie nowhere.
fn exif_loop() -> Vec<u8> {
    let mut block = b"II*\0\x08\0\0\0".to_vec();
    block.extend(400_u16.to_le_bytes());
    for entry in 0..400_u16 {
        // Sub-directories, thumbnails and orientations in turn, each at the first directory or beyond the end.
        let tag = [0x8769_u16, 0x0112, 0x0201, 0xA005][usize::from(entry % 4)];
        block.extend(tag.to_le_bytes());
        block.extend([4, 0, 0xFF, 0xFF, 0xFF, 0x7F]);
        block.extend(if entry % 2 == 0 { [8, 0, 0, 0] } else { [0xFF; 4] });
    }
    block.extend([8, 0, 0, 0]);
    block
}

/// A segment of a JPEG.
fn segment(marker: u8, data: &[u8]) -> Vec<u8> {
    [&[0xFF, marker], &(u16::try_from(data.len()).unwrap() + 2).to_be_bytes()[..], data].concat()
}

fn jpeg_head(width: u16, height: u16, sof: u8) -> Vec<u8> {
    let frame = [&[8], &height.to_be_bytes()[..], &width.to_be_bytes(), &[1, 1, 0x11, 0]].concat();
    // Codes of one bit: no difference, and the end of 16384 blocks and more.
    let code = |class: u8, symbol: u8| [&[class, 1, 1], [0; 14].as_slice(), &[symbol, 0x01]].concat();
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
    // A run of 16384 + 16383 blocks is a zero and 14 ones: written as runs of 16384, a zero and 14 zeros.
    let runs = vec![0; (blocks.div_ceil(16_384) * 15).div_ceil(8)];
    for _ in 0..scans {
        file.extend(segment(0xDA, &[1, 1, 0, 1, 63, 0]));
        file.extend(&runs);
    }
    file.extend([0xFF, 0xD9]);
    file
}

fn riff(chunks: &[(&[u8; 4], Vec<u8>)]) -> Vec<u8> {
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

/// Every bomb with its name and the statuses that may answer it; `code_tables` is the file of that name.
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
    let control = [&[0; 4][..], &60_000_u32.to_be_bytes(), &60_000_u32.to_be_bytes(), &[0; 14]].concat();
    let canvas = |flags: u8| [&[flags, 0, 0, 0], [0xFF; 6].as_slice()].concat();
    let vp8 =
        |width: u16, height: u16| [&[0x10, 2, 0, 0x9D, 0x01, 0x2A], &width.to_le_bytes()[..], &height.to_le_bytes(), &[0; 64]].concat();
    let frame = |vp8l: &[u8]| {
        [&[0; 6][..], &[3, 0, 0, 3, 0, 0], &[0; 4], b"VP8L", &u32::try_from(vp8l.len()).unwrap().to_le_bytes(), vp8l].concat()
    };
    let tables = &code_tables[20..];
    vec![
        ("png of 60000 x 60000", png(&[(b"IHDR", ihdr(60_000, 60_000)), (b"IDAT", row()), (b"IEND", vec![])]), &[413]),
        ("png of 49 MP without data", png(&[(b"IHDR", ihdr(7_000, 7_000)), (b"IDAT", row()), (b"IEND", vec![])]), &[422]),
        ("png, interlaced, without data", png(&[(b"IHDR", interlaced), (b"IDAT", row()), (b"IEND", vec![])]), &[422]),
        ("png with 200 MiB behind its pixel", png(&[(b"IHDR", ihdr(1, 1)), (b"IDAT", zeros.clone()), (b"IEND", vec![])]), &[200, 422]),
        ("png with a profile of 200 MiB", one(&[(b"iCCP", named(b"name\0\0"))]), &[200]),
        ("png with a text of 200 MiB", one(&[(b"zTXt", named(b"name\0\0"))]), &[200]),
        ("png with an international text of 200 MiB", one(&[(b"iTXt", named(b"name\0\x01\0\0\0"))]), &[200]),
        ("png of many chunks", one(&vec![(b"teXt", vec![]); 100_000]), &[200]),
        ("png of many palettes", one(&vec![(b"PLTE", vec![1; 768]); 1_000]), &[200, 422]),
        ("png with EXIF in a loop", one(&[(b"eXIf", exif_loop())]), &[200]),
        ("png with a frame of 60000 x 60000", one(&[(b"acTL", vec![0, 0, 0, 1, 0, 0, 0, 0]), (b"fcTL", control)]), &[200]),
        ("png of four billion frames", one(&[(b"acTL", [0xFF; 8].to_vec())]), &[413]),
        (
            "jpeg of 65535 x 65535",
            [jpeg_head(65_535, 65_535, 0xC0), segment(0xDA, &[1, 1, 0, 0, 63, 0]), vec![0; 64], vec![0xFF, 0xD9]].concat(),
            &[413],
        ),
        (
            "jpeg of 49 MP without data",
            [jpeg_head(7_000, 7_000, 0xC2), segment(0xDA, &[1, 1, 0, 0, 0, 0]), vec![0xFF, 0xD9]].concat(),
            &[422],
        ),
        ("jpeg of 5000 scans", jpeg_scans(64, 5_000), &[422]),
        ("jpeg of fill bytes", [vec![0xFF, 0xD8], vec![0xFF; 4 << 20]].concat(), &[422]),
        ("jpeg of comments", [vec![0xFF, 0xD8], segment(0xFE, &[]).repeat(500_000)].concat(), &[422]),
        ("jpeg of tables", [jpeg_head(64, 64, 0xC2), jpeg_head(8, 8, 0xC2)[73..].repeat(20_000), vec![0xFF, 0xD9]].concat(), &[422]),
        ("jpeg with EXIF in a loop", with_exif(&jpeg_scans(64, 1), &exif_loop()), &[200]),
        ("webp with a canvas of 2^48", riff(&[(b"VP8X", canvas(0)), (b"VP8 ", vp8(16, 16))]), &[422]),
        ("webp of 16383 x 16383", riff(&[(b"VP8 ", vp8(16_383, 16_383))]), &[413]),
        ("webp, lossless, of 16384 x 16384", riff(&[(b"VP8L", [&[0x2F, 0xFF, 0xFF, 0xFF, 0x0F], [0; 64].as_slice()].concat())]), &[413]),
        ("webp of many code tables", code_tables.to_vec(), &[422]),
        (
            "webp of many code tables in a frame",
            riff(&[(b"VP8X", vec![2, 0, 0, 0, 3, 0, 0, 3, 0, 0]), (b"ANIM", vec![0; 6]), (b"ANMF", frame(tables))]),
            &[422],
        ),
        (
            "webp of many code tables in its alpha",
            riff(&[(b"VP8X", vec![0x10, 0, 0, 0, 3, 0, 0, 3, 0, 0]), (b"ALPH", [&[1], &tables[5..]].concat()), (b"VP8 ", vp8(4, 4))]),
            &[422],
        ),
        (
            "webp of many frames",
            riff(&[&[(b"VP8X", vec![2, 0, 0, 0, 3, 0, 0, 3, 0, 0])][..], &vec![(b"ANMF", frame(&[])); 10_000]].concat()),
            &[413],
        ),
        ("webp of many chunks", riff(&vec![(b"zzzz", vec![]); 200_000]), &[422]),
    ]
}

/// A JPEG with an EXIF block.
fn with_exif(jpeg: &[u8], exif: &[u8]) -> Vec<u8> {
    let block = segment(0xE1, &[b"Exif\0\0", exif].concat());
    [&jpeg[..2], &block, &jpeg[2..]].concat()
}
