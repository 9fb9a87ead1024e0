//! Writes TIFF (6.0), big-endian: strips of deflated differences, or of samples as they are. Alpha
//! is an additional sample that is not premultiplied (ExtraSamples 2). The directory follows the
//! strips.

use std::io::Write as _;

use flate2::write::ZlibEncoder;

use crate::codec::ifd::write::{DirectoryWriter, TYPE_SHORT, offset};
use crate::codec::{Carried, Compression, Palette, PixelLayout};
use crate::pixmap::{Channels, Depth};

/// Target size of a strip, bytes.
const STRIP_BYTES: usize = 256 << 10;

/// Appends the file, or its beginning if it is no longer wanted.
/// `samples: [height][width][PixelLayout::samples]`, 16-bit ones big-endian.
pub(in crate::codec) fn write(
    shape: PixelLayout,
    compression: Compression,
    samples: &[u8],
    (metadata, palette): (Option<&Carried>, Option<&Palette>),
    out: &mut Vec<u8>,
    wanted: &dyn Fn() -> bool,
) {
    let start = out.len();
    out.extend_from_slice(b"MM\0*\0\0\0\0");
    let row = shape.extent.width() as usize * shape.samples() * shape.depth.bytes();
    let rows = (STRIP_BYTES / row).clamp(1, shape.extent.height() as usize);
    let (mut offsets, mut lengths) = (Vec::new(), Vec::new());
    let level = match compression {
        Compression::None => None,
        Compression::Fast => Some(flate2::Compression::fast()),
        Compression::Best => Some(flate2::Compression::best()),
    };
    let mut differences = Vec::new();
    for strip in samples.chunks(rows * row) {
        if !wanted() {
            return;
        }
        let at = out.len();
        offsets.push(offset(at - start));
        match level {
            None => out.extend_from_slice(strip),
            Some(level) => {
                differences.clear();
                strip
                    .chunks_exact(row)
                    .for_each(|row| append_differences(row, shape, &mut differences));
                let mut zlib = ZlibEncoder::new(&mut *out, level);
                zlib.write_all(&differences)
                    .expect("a Vec takes every write");
                zlib.finish().expect("a Vec takes every write");
            }
        }
        lengths.push(offset(out.len() - at));
    }

    let pointers = metadata.map_or_else(Vec::new, |metadata| metadata.put_below_page(out, start));
    let mut directory = DirectoryWriter::of(out, start, false);
    directory.longs(256, &[shape.extent.width()]);
    directory.longs(257, &[shape.extent.height()]);
    let bits: u16 = match shape.depth {
        Depth::Eight => 8,
        Depth::Sixteen => 16,
    };
    directory.entry(
        258,
        TYPE_SHORT,
        shape.samples(),
        &bits.to_be_bytes().repeat(shape.samples()),
    );
    directory.short(259, if level.is_some() { 8 } else { 1 });
    directory.short(
        262,
        if palette.is_some() {
            3
        } else {
            u16::from(!shape.grey) + 1
        },
    );
    directory.longs(273, &offsets);
    directory.short(277, u16::try_from(shape.samples()).expect("at most four"));
    directory.longs(278, &[offset(rows)]);
    directory.longs(279, &lengths);
    if level.is_some() {
        directory.short(317, 2);
    }
    if let Some(Palette { colours, .. }) = palette {
        // A palette has all reds first, then all greens and all blues; 257 c is c as 16 bit.
        let colour = |c: usize, k: usize| {
            colours
                .get(k)
                .map_or(0, |colour| u16::from(colour[c]) * 257)
                .to_be_bytes()
        };
        let map: Vec<u8> = (0..3)
            .flat_map(|c| (0..256).flat_map(move |k| colour(c, k)))
            .collect();
        directory.entry(320, TYPE_SHORT, map.len() / 2, &map);
    }
    if shape.channels == Channels::Rgba {
        directory.short(338, 2);
    }
    Carried::put_resolution(metadata, &mut directory);
    if let Some(metadata) = metadata {
        metadata.put_tags(shape.grey && palette.is_none(), &pointers, &mut directory);
    }
    directory.close();
}

/// Appends a row as differences between neighbouring pixels, modulo the range of a sample.
fn append_differences(row: &[u8], shape: PixelLayout, out: &mut Vec<u8>) {
    let pixel = shape.samples() * shape.depth.bytes();
    out.extend_from_slice(&row[..pixel]);
    let pairs = row[pixel..].iter().zip(row);
    match shape.depth {
        Depth::Eight => out.extend(pairs.map(|(sample, left)| sample.wrapping_sub(*left))),
        Depth::Sixteen => {
            let pairs = row[pixel..]
                .as_chunks::<2>()
                .0
                .iter()
                .zip(row.as_chunks::<2>().0);
            let difference = |(sample, left): (&[u8; 2], &[u8; 2])| {
                u16::from_be_bytes(*sample).wrapping_sub(u16::from_be_bytes(*left))
            };
            out.extend(pairs.flat_map(|pair| difference(pair).to_be_bytes()));
        }
    }
}
