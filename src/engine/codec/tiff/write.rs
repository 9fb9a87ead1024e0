//! Writes TIFF (6.0), big-endian: strips of deflated differences, or of samples as they are. The directory follows the strips.

use std::io::Write as _;

use flate2::write::ZlibEncoder;

use crate::codec::Palette;
use crate::codec::png::write::{Compression, PngShape};
use crate::pixmap::{Channels, Depth};

/// Target size of a strip, bytes.
const STRIP: usize = 256 << 10;

pub(super) const SHORT: u16 = 3;
const LONG: u16 = 4;
const UNDEFINED: u16 = 7;

/// The values of a directory's entry that do not fit into it are appended before the directory.
pub(super) struct Directory<'a> {
    out: &'a mut Vec<u8>,
    /// Where the file begins in `out`, or the bytes of it that come before.
    start: usize,
    before: usize,
    entries: Vec<[u8; 12]>,
}

fn offset(bytes: usize) -> u32 {
    u32::try_from(bytes).expect("the target was held against the format's largest size")
}

impl<'a> Directory<'a> {
    /// A directory behind this number of bytes of the file; `out` is what follows them.
    pub(super) const fn after(out: &'a mut Vec<u8>, before: usize) -> Self {
        Self { out, start: 0, before, entries: Vec::new() }
    }

    /// Bytes of the file so far.
    const fn length(&self) -> usize {
        self.before + self.out.len() - self.start
    }

    pub(super) fn entry(&mut self, tag: u16, kind: u16, count: usize, data: &[u8]) {
        let mut value = [0; 4];
        if data.len() <= 4 {
            value[..data.len()].copy_from_slice(data);
        } else {
            self.align();
            value = offset(self.length()).to_be_bytes();
            self.out.extend_from_slice(data);
        }
        let mut entry = [0; 12];
        entry[..2].copy_from_slice(&tag.to_be_bytes());
        entry[2..4].copy_from_slice(&kind.to_be_bytes());
        entry[4..8].copy_from_slice(&offset(count).to_be_bytes());
        entry[8..].copy_from_slice(&value);
        self.entries.push(entry);
    }

    pub(super) fn short(&mut self, tag: u16, value: u16) {
        self.entry(tag, SHORT, 1, &value.to_be_bytes());
    }

    pub(super) fn longs(&mut self, tag: u16, values: &[u32]) {
        let data: Vec<u8> = values.iter().flat_map(|value| value.to_be_bytes()).collect();
        self.entry(tag, LONG, values.len(), &data);
    }

    /// Values and directories begin at even offsets.
    fn align(&mut self) {
        if !self.length().is_multiple_of(2) {
            self.out.push(0);
        }
    }

    /// Appends the directory, and enters its place at the beginning of the file.
    fn close(self) {
        let field = self.start + 4..self.start + 8;
        let (at, out) = self.append();
        out[field].copy_from_slice(&offset(at).to_be_bytes());
    }

    /// Appends the directory; returns where it begins in the bytes that follow those before.
    pub(super) fn finish(self) -> usize {
        let before = self.before;
        self.append().0 - before
    }

    fn append(mut self) -> (usize, &'a mut Vec<u8>) {
        self.align();
        let at = self.length();
        let count = u16::try_from(self.entries.len()).expect("a few entries");
        self.out.extend_from_slice(&count.to_be_bytes());
        self.out.extend_from_slice(self.entries.as_flattened());
        self.out.extend_from_slice(&[0; 4]);
        (at, self.out)
    }
}

/// Appends the file, or its beginning if it is no longer wanted. `samples: [height][width][PngShape::samples]`, 16-bit ones big-endian.
pub(in crate::codec) fn write(
    shape: PngShape,
    compression: Compression,
    samples: &[u8],
    (icc, palette): (Option<&[u8]>, Option<&Palette>),
    out: &mut Vec<u8>,
    wanted: &dyn Fn() -> bool,
) {
    let start = out.len();
    out.extend_from_slice(b"MM\0*\0\0\0\0");
    let row = shape.extent.width() as usize * shape.samples() * shape.depth.bytes();
    let rows = (STRIP / row).clamp(1, shape.extent.height() as usize);
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
                strip.chunks_exact(row).for_each(|row| append_differences(row, shape, &mut differences));
                let mut zlib = ZlibEncoder::new(&mut *out, level);
                zlib.write_all(&differences).expect("a Vec takes every write");
                zlib.finish().expect("a Vec takes every write");
            }
        }
        lengths.push(offset(out.len() - at));
    }

    let mut directory = Directory { out, start, before: 0, entries: Vec::new() };
    directory.longs(256, &[shape.extent.width()]);
    directory.longs(257, &[shape.extent.height()]);
    let bits: u16 = match shape.depth {
        Depth::Eight => 8,
        Depth::Sixteen => 16,
    };
    directory.entry(258, SHORT, shape.samples(), &bits.to_be_bytes().repeat(shape.samples()));
    directory.short(259, if level.is_some() { 8 } else { 1 });
    directory.short(262, if palette.is_some() { 3 } else { u16::from(!shape.grey) + 1 });
    directory.longs(273, &offsets);
    directory.short(277, u16::try_from(shape.samples()).expect("at most four"));
    directory.longs(278, &[offset(rows)]);
    directory.longs(279, &lengths);
    if level.is_some() {
        directory.short(317, 2);
    }
    if let Some(Palette { colours, .. }) = palette {
        // All reds first; 257 c is c as 16 bit.
        let colour = |c: usize, k: usize| colours.get(k).map_or(0, |colour| u16::from(colour[c]) * 257).to_be_bytes();
        let map: Vec<u8> = (0..3).flat_map(|c| (0..256).flat_map(move |k| colour(c, k))).collect();
        directory.entry(320, SHORT, map.len() / 2, &map);
    }
    if shape.channels == Channels::Rgba {
        // Straight alpha.
        directory.short(338, 2);
    }
    if let Some(icc) = icc {
        directory.entry(34_675, UNDEFINED, icc.len(), icc);
    }
    directory.close();
}

/// Appends a row as differences between neighbouring pixels, modulo the range of a sample.
fn append_differences(row: &[u8], shape: PngShape, out: &mut Vec<u8>) {
    let pixel = shape.samples() * shape.depth.bytes();
    out.extend_from_slice(&row[..pixel]);
    let pairs = row[pixel..].iter().zip(row);
    match shape.depth {
        Depth::Eight => out.extend(pairs.map(|(sample, left)| sample.wrapping_sub(*left))),
        Depth::Sixteen => {
            let pairs = row[pixel..].as_chunks::<2>().0.iter().zip(row.as_chunks::<2>().0);
            let difference = |(sample, left): (&[u8; 2], &[u8; 2])| u16::from_be_bytes(*sample).wrapping_sub(u16::from_be_bytes(*left));
            out.extend(pairs.flat_map(|pair| difference(pair).to_be_bytes()));
        }
    }
}
