//! Files built chunk by chunk, because the encoders of the crates under test would add chunks of
//! their own.

use std::io::Write as _;

use image::ImageEncoder as _;

use super::*;

pub(super) fn deflate(bytes: &[u8]) -> Vec<u8> {
    let mut encoder = flate2::write::ZlibEncoder::new(Vec::new(), flate2::Compression::fast());
    encoder.write_all(bytes).unwrap();
    encoder.finish().unwrap()
}

/// A minimal RGB profile.
pub(super) fn profile(len: usize) -> Vec<u8> {
    let mut profile: Vec<u8> = (0..len).map(|n| ((n * n) >> 3) as u8).collect();
    profile[..4].copy_from_slice(&(len as u32).to_be_bytes());
    profile[16..20].copy_from_slice(b"RGB ");
    profile[36..40].copy_from_slice(b"acsp");
    profile
}

pub(super) fn iccp(profile: &[u8]) -> Vec<u8> {
    [b"name\0\0".as_slice(), &deflate(profile)].concat()
}

pub(super) fn png_chunk(kind: [u8; 4], data: &[u8]) -> Vec<u8> {
    let mut out = (data.len() as u32).to_be_bytes().to_vec();
    out.extend(kind);
    out.extend(data);
    let crc = crc32fast::hash(&out[4..]);
    out.extend(crc.to_be_bytes());
    out
}

/// The parts of a PNG.
#[derive(Clone)]
pub(super) struct Png {
    pub(super) ihdr: [u8; 13],
    pub(super) before: Vec<([u8; 4], Vec<u8>)>,
    /// The filtered rows.
    pub(super) rows: Vec<u8>,
    pub(super) after: Vec<([u8; 4], Vec<u8>)>,
}

impl Png {
    /// `packed: [height][bytes of a row]`, as PNG packs them; stored with filter 0.
    pub(super) fn new(width: u32, height: u32, bits: u8, colour: u8, packed: &[u8]) -> Self {
        let mut ihdr = [0; 13];
        ihdr[..4].copy_from_slice(&width.to_be_bytes());
        ihdr[4..8].copy_from_slice(&height.to_be_bytes());
        (ihdr[8], ihdr[9]) = (bits, colour);
        let rows = packed
            .chunks((packed.len() / height as usize).max(1))
            .flat_map(|row| [&[0], row].concat())
            .collect();
        Self {
            ihdr,
            before: vec![],
            rows,
            after: vec![],
        }
    }

    /// The same picture in seven passes; whole bytes per pixel only.
    pub(super) fn interlaced(width: u32, height: u32, bits: u8, colour: u8, packed: &[u8]) -> Self {
        let mut png = Self::new(width, height, bits, colour, packed);
        png.ihdr[12] = 1;
        png.rows.clear();
        let (width, height) = (width as usize, height as usize);
        let pixel = packed.len() / (width * height);
        // The letters of each 8 x 8 square's passes (PNG, 8.2).
        let passes = [
            "16462646", "77777777", "56565656", "77777777", "36463646", "77777777", "56565656",
            "77777777",
        ];
        for pass in b'1'..=b'7' {
            for y in 0..height {
                let columns: Vec<usize> = (0..width)
                    .filter(|x| passes[y % 8].as_bytes()[x % 8] == pass)
                    .collect();
                if !columns.is_empty() {
                    png.rows.push(0);
                    columns
                        .iter()
                        .for_each(|x| png.rows.extend(&packed[(y * width + x) * pixel..][..pixel]));
                }
            }
        }
        png
    }

    pub(super) fn with(mut self, kind: [u8; 4], data: &[u8]) -> Self {
        self.before.push((kind, data.to_vec()));
        self
    }

    pub(super) fn bytes(&self) -> Vec<u8> {
        let mut out = b"\x89PNG\r\n\x1a\n".to_vec();
        out.extend(png_chunk(*b"IHDR", &self.ihdr));
        self.before
            .iter()
            .for_each(|(kind, data)| out.extend(png_chunk(*kind, data)));
        let data = deflate(&self.rows);
        let (first, second) = data.split_at(data.len() / 2);
        out.extend(png_chunk(*b"IDAT", first));
        out.extend(png_chunk(*b"IDAT", second));
        self.after
            .iter()
            .for_each(|(kind, data)| out.extend(png_chunk(*kind, data)));
        out.extend(png_chunk(*b"IEND", &[]));
        out
    }
}

/// A JPEG whose blocks are flat: one DC coefficient each, quantised by 8, so that a sample is
/// exactly 128 + coefficient.
#[derive(Clone)]
pub(super) struct Jpeg {
    pub(super) size: (u16, u16),
    pub(super) sof: u8,
    factors: Vec<(u8, u8)>,
    segments: Vec<u8>,
    /// One level per component and MCU, in MCU order.
    mcus: Vec<Vec<i32>>,
    /// One scan per component.
    separate: bool,
}

impl Jpeg {
    pub(super) fn flat(width: u16, height: u16, factors: &[(u8, u8)], levels: &[i32]) -> Self {
        let h = factors.iter().map(|f| u16::from(f.0)).max().unwrap();
        let v = factors.iter().map(|f| u16::from(f.1)).max().unwrap();
        let mcus = usize::from(width.div_ceil(8 * h)) * usize::from(height.div_ceil(8 * v));
        let mcus = vec![levels.to_vec(); mcus];
        Self {
            size: (width, height),
            sof: 0xC0,
            factors: factors.to_vec(),
            segments: vec![],
            mcus,
            separate: false,
        }
    }

    /// Grey, 24 x 16: six squares `abc / def` whose sample is the letter.
    pub(super) fn letters() -> Self {
        let mut jpeg = Self::flat(24, 16, &[(1, 1)], &[0]);
        jpeg.mcus = b"abcdef"
            .iter()
            .map(|&letter| vec![i32::from(letter) - 128])
            .collect();
        jpeg
    }

    pub(super) fn with_segment(mut self, marker: u8, data: &[u8]) -> Self {
        self.segments.extend([0xFF, marker]);
        self.segments.extend((data.len() as u16 + 2).to_be_bytes());
        self.segments.extend(data);
        self
    }

    /// DC in one scan, the (empty) AC of each component in one more.
    pub(super) fn progressive(mut self) -> Self {
        self.sof = 0xC2;
        self
    }

    pub(super) fn separate(mut self) -> Self {
        self.separate = true;
        self
    }

    pub(super) fn bytes(&self) -> Vec<u8> {
        let count = self.factors.len() as u8;
        let mut file = Self {
            segments: vec![],
            ..self.clone()
        };
        file = file.with_segment(0xDB, &[&[0], [8; 64].as_slice()].concat());
        let mut frame = vec![8];
        frame.extend(self.size.1.to_be_bytes());
        frame.extend(self.size.0.to_be_bytes());
        frame.push(count);
        (1..)
            .zip(&self.factors)
            .for_each(|(id, (h, v))| frame.extend([id, h << 4 | v, 0]));
        file = file.with_segment(self.sof, &frame);
        // DC: twelve sizes in codes of four bits. AC: end of block in one bit.
        let dc = [
            &[0, 0, 0, 0, 12],
            [0; 12].as_slice(),
            &(0..12).collect::<Vec<u8>>(),
        ]
        .concat();
        let ac = [&[0x10, 1], [0; 15].as_slice(), &[0]].concat();
        file = file.with_segment(0xC4, &dc).with_segment(0xC4, &ac);
        let mut out = [&[0xFF, 0xD8], self.segments.as_slice(), &file.segments].concat();
        let all: Vec<usize> = (0..usize::from(count)).collect();
        let progressive = self.sof == 0xC2;
        let groups: Vec<Vec<usize>> = if self.separate {
            all.iter().map(|&c| vec![c]).collect()
        } else {
            vec![all.clone()]
        };
        for group in groups {
            out.extend(self.scan(&group, if progressive { (0, 0) } else { (0, 63) }));
        }
        if progressive {
            all.iter()
                .for_each(|&c| out.extend(self.scan(&[c], (1, 63))));
        }
        out.extend([0xFF, 0xD9]);
        out
    }

    fn scan(&self, components: &[usize], band: (u8, u8)) -> Vec<u8> {
        let mut head = vec![components.len() as u8];
        components
            .iter()
            .for_each(|&c| head.extend([c as u8 + 1, 0]));
        head.extend([band.0, band.1, 0]);
        let segments = vec![];
        let mut out = Self {
            segments,
            ..self.clone()
        }
        .with_segment(0xDA, &head)
        .segments;
        let mut bits = String::new();
        let mut last = vec![0; self.factors.len()];
        for mcu in &self.mcus {
            for &c in components {
                for _ in 0..self.factors[c].0 * self.factors[c].1 {
                    if band.0 == 0 {
                        let difference = mcu[c] - last[c];
                        last[c] = mcu[c];
                        let size = 32 - difference.unsigned_abs().leading_zeros();
                        let magnitude = if difference < 0 {
                            difference + (1 << size) - 1
                        } else {
                            difference
                        };
                        bits += &format!("{size:04b}");
                        if size > 0 {
                            bits += &format!("{magnitude:0width$b}", width = size as usize);
                        }
                    }
                    if band.1 > 0 {
                        bits += "0";
                    }
                }
            }
        }
        bits += &"1".repeat(bits.len().next_multiple_of(8) - bits.len());
        for byte in bits.as_bytes().chunks(8) {
            let byte = u8::from_str_radix(std::str::from_utf8(byte).unwrap(), 2).unwrap();
            out.push(byte);
            if byte == 0xFF {
                out.push(0);
            }
        }
        out
    }
}

/// A tag: its number, type, number of values, and their bytes in the order of the file.
pub(super) type Tag<'a> = (u16, u16, u32, &'a [u8]);

/// A block of EXIF: the tags of the main directory, of the EXIF directory (from 0x8769 on), and of
/// GPS (from 0x8825 on), then a thumbnail.
pub(super) fn exif_block(
    little: bool,
    main: &[Tag<'_>],
    below: &[(u16, Vec<Tag<'_>>)],
    thumbnail: &[u8],
) -> Vec<u8> {
    let two = |n: u16| {
        if little {
            n.to_le_bytes()
        } else {
            n.to_be_bytes()
        }
    };
    let four = |n: u32| {
        if little {
            n.to_le_bytes()
        } else {
            n.to_be_bytes()
        }
    };
    let mut out = if little {
        b"II*\0".to_vec()
    } else {
        b"MM\0*".to_vec()
    };
    out.extend([0; 4]);
    let put = |tags: &[Tag<'_>], next: u32, out: &mut Vec<u8>| {
        let mut tags = tags.to_vec();
        tags.sort_by_key(|tag| tag.0);
        let mut directory = two(tags.len() as u16).to_vec();
        for (tag, kind, count, data) in tags {
            let mut value = [0; 4];
            if data.len() <= 4 {
                value[..data.len()].copy_from_slice(data);
            } else {
                value = four(out.len() as u32);
                out.extend(data);
            }
            directory.extend([&two(tag)[..], &two(kind), &four(count), &value].concat());
        }
        directory.extend(four(next));
        let at = out.len() as u32;
        out.extend(directory);
        at
    };
    let mut pointers = Vec::new();
    for (pointer, tags) in below {
        pointers.push((*pointer, four(put(tags, 0, &mut out))));
    }
    let mut main = main.to_vec();
    main.extend(
        pointers
            .iter()
            .map(|(pointer, at)| (*pointer, 4, 1, at.as_slice())),
    );
    let next = if thumbnail.is_empty() {
        0
    } else {
        let at = four(out.len() as u32);
        out.extend(thumbnail);
        put(
            &[
                (0x0201, 4, 1, &at),
                (0x0202, 4, 1, &four(thumbnail.len() as u32)),
            ],
            0,
            &mut out,
        )
    };
    let at = put(&main, next, &mut out);
    out[4..8].copy_from_slice(&four(at));
    out
}

/// The encoder writes the simplest container: a VP8L chunk.
pub(super) fn webp_lossless(
    width: u32,
    height: u32,
    channels: Channels,
    samples: &[u8],
) -> Vec<u8> {
    let colour = if channels == Channels::Rgba {
        image::ExtendedColorType::Rgba8
    } else {
        image::ExtendedColorType::Rgb8
    };
    let mut out = Vec::new();
    image::codecs::webp::WebPEncoder::new_lossless(&mut out)
        .write_image(samples, width, height, colour)
        .unwrap();
    out
}

pub(super) fn riff(chunks: &[(&[u8; 4], &[u8])]) -> Vec<u8> {
    let mut out = b"RIFF\0\0\0\0WEBP".to_vec();
    for (kind, data) in chunks {
        out.extend(*kind);
        out.extend((data.len() as u32).to_le_bytes());
        out.extend(*data);
        out.resize(out.len().next_multiple_of(2), 0);
    }
    let size = out.len() as u32 - 8;
    out[4..8].copy_from_slice(&size.to_le_bytes());
    out
}

pub(super) fn vp8x(flags: u8, (width, height): (u32, u32)) -> [u8; 10] {
    let mut data = [flags, 0, 0, 0, 0, 0, 0, 0, 0, 0];
    data[4..7].copy_from_slice(&(width - 1).to_le_bytes()[..3]);
    data[7..].copy_from_slice(&(height - 1).to_le_bytes()[..3]);
    data
}

/// A simple file converted to the extended container.
pub(super) fn webp_container(simple: &[u8], size: (u32, u32), exif: &[u8], icc: &[u8]) -> Vec<u8> {
    let length = u32::from_le_bytes(simple[16..20].try_into().unwrap()) as usize;
    riff(&[
        (b"VP8X", &vp8x(0x28, size)),
        (b"ICCP", icc),
        (simple[12..16].try_into().unwrap(), &simple[20..20 + length]),
        (b"EXIF", exif),
    ])
}

/// A VP8 key frame. Partitions of zeros decode to DC prediction without residual, hence mid grey.
pub(super) fn vp8(width: u16, height: u16) -> Vec<u8> {
    let first = 64 + u32::from(width) * u32::from(height) / 4;
    let mut frame = ((first << 5) | 1 << 4).to_le_bytes()[..3].to_vec();
    frame.extend([0x9D, 0x01, 0x2A]);
    frame.extend(width.to_le_bytes());
    frame.extend(height.to_le_bytes());
    frame.resize(frame.len() + 2 * first as usize, 0);
    frame
}

/// A lossy file, with uncompressed alpha if there is any.
pub(super) fn webp_lossy(width: u16, height: u16, alpha: Option<&[u8]>) -> Vec<u8> {
    match alpha {
        None => riff(&[(b"VP8 ", &vp8(width, height))]),
        Some(alpha) => riff(&[
            (b"VP8X", &vp8x(0x10, (width.into(), height.into()))),
            (b"ALPH", &[&[0], alpha].concat()),
            (b"VP8 ", &vp8(width, height)),
        ]),
    }
}
