//! TIFF: files of our writer and of another one, and files made entry by entry.

use ::tiff::encoder::{Compression as Coding, TiffEncoder, colortype};

use super::*;
use crate::pixmap::Extent;

/// A file made entry by entry, little-endian: data, values, directory.
pub(super) struct Tiff {
    pub(super) entries: Vec<(u16, u16, Vec<u32>)>,
    pub(super) parts: Vec<Vec<u8>>,
    pub(super) tiled: bool,
    /// Directories that follow, each with this `NewSubfileType`.
    pub(super) more: Vec<u32>,
    /// Tags of any type: number, type, number of values, bytes.
    pub(super) others: Vec<(u16, u16, u32, Vec<u8>)>,
}

const TYPE_SHORT: u16 = 3;
const TYPE_LONG: u16 = 4;

impl Tiff {
    /// Strips of not compressed samples.
    pub(super) fn new(
        width: u32,
        height: u32,
        bits: &[u32],
        photometric: u32,
        data: &[u8],
    ) -> Self {
        let entries = vec![
            (256, TYPE_LONG, vec![width]),
            (257, TYPE_LONG, vec![height]),
            (258, TYPE_SHORT, bits.to_vec()),
            (262, TYPE_SHORT, vec![photometric]),
            (277, TYPE_SHORT, vec![bits.len() as u32]),
        ];
        Self {
            entries,
            parts: vec![data.to_vec()],
            tiled: false,
            more: Vec::new(),
            others: Vec::new(),
        }
    }

    pub(super) fn with_tag(mut self, tag: u16, kind: u16, count: usize, data: &[u8]) -> Self {
        self.others.push((tag, kind, count as u32, data.to_vec()));
        self
    }

    pub(super) fn with(mut self, tag: u16, values: &[u32]) -> Self {
        self.entries.retain(|entry| entry.0 != tag);
        self.entries.push((tag, TYPE_SHORT, values.to_vec()));
        self
    }

    pub(super) fn bytes(&self) -> Vec<u8> {
        let mut file = b"II*\0\0\0\0\0".to_vec();
        let mut offsets = Vec::new();
        for part in &self.parts {
            offsets.push(file.len() as u32);
            file.extend(part);
        }
        let lengths = self.parts.iter().map(|part| part.len() as u32).collect();
        let mut entries = self.entries.clone();
        let (offset_tag, length_tag) = if self.tiled { (324, 325) } else { (273, 279) };
        entries.push((offset_tag, TYPE_LONG, offsets));
        entries.push((length_tag, TYPE_LONG, lengths));
        let others = self
            .others
            .iter()
            .map(|(tag, kind, count, data)| (*tag, *kind, *count, data.clone()));
        let mut others: Vec<_> = others.collect();
        let mut link = 4;
        for entries in [entries].into_iter().chain(
            self.more
                .iter()
                .map(|kind| vec![(254, TYPE_LONG, vec![*kind])]),
        ) {
            let numbers = entries.iter().map(|(tag, kind, values)| {
                let data: Vec<u8> = match *kind {
                    TYPE_SHORT => values
                        .iter()
                        .flat_map(|value| (*value as u16).to_le_bytes())
                        .collect(),
                    _ => values
                        .iter()
                        .flat_map(|value| value.to_le_bytes())
                        .collect(),
                };
                (*tag, *kind, values.len() as u32, data)
            });
            let mut tags: Vec<_> = numbers.chain(std::mem::take(&mut others)).collect();
            tags.sort_by_key(|tag| tag.0);
            let mut directory = (tags.len() as u16).to_le_bytes().to_vec();
            for (tag, kind, count, data) in tags {
                directory.extend(tag.to_le_bytes());
                directory.extend(kind.to_le_bytes());
                directory.extend(count.to_le_bytes());
                let mut field = [0; 4];
                if data.len() <= 4 {
                    field[..data.len()].copy_from_slice(&data);
                } else {
                    field = (file.len() as u32).to_le_bytes();
                    file.extend(&data);
                }
                directory.extend(field);
            }
            directory.extend([0; 4]);
            let at = (file.len() as u32).to_le_bytes();
            file[link..link + 4].copy_from_slice(&at);
            file.extend(directory);
            link = file.len() - 4;
        }
        file
    }
}

/// A picture of 20 x 18 pixels and four colours, in tiles of 16 x 16.
pub(super) fn palette_in_tiles() -> Tiff {
    let mut tiff = Tiff::new(20, 18, &[8], 3, &[]);
    tiff.tiled = true;
    tiff.parts = (0..4).map(|tile| vec![tile; 256]).collect();
    tiff.with(322, &[16])
        .with(323, &[16])
        .with(320, &(0..768).map(|n| n % 256 * 0x1111).collect::<Vec<_>>())
}

/// Grey of a few bits.
pub(super) fn grey(width: u32, height: u32, bits: u32, packed: &[u8]) -> Vec<u8> {
    Tiff::new(width, height, &[bits], 1, packed).bytes()
}

/// RGBA of our writer.
pub(super) fn written((width, height): (u32, u32), rgba: &[u8], icc: Option<&[u8]>) -> Vec<u8> {
    let shape = PixelLayout {
        extent: Extent::new(width, height).unwrap(),
        channels: Channels::Rgba,
        grey: false,
        depth: Depth::Eight,
    };
    file(shape, rgba, Compression::Fast, icc)
}

fn file(
    shape: PixelLayout,
    samples: &[u8],
    compression: Compression,
    icc: Option<&[u8]>,
) -> Vec<u8> {
    let mut out = Vec::new();
    let profile = icc.map(Carried::of_icc);
    Writer::new(shape, Encoding::Tiff(compression), profile.as_ref()).strip_into(
        0,
        &mut samples.to_vec(),
        &mut out,
        &|| true,
    );
    out
}

/// RGB of another writer.
pub(super) fn lzw(width: u32, height: u32, rgb: &[u8]) -> Vec<u8> {
    other::<colortype::RGB8>(width, height, rgb, Coding::Lzw)
}

fn other<C: colortype::ColorType>(
    width: u32,
    height: u32,
    samples: &[C::Inner],
    coding: Coding,
) -> Vec<u8>
where
    [C::Inner]: ::tiff::encoder::TiffValue,
{
    let mut file = std::io::Cursor::new(Vec::new());
    TiffEncoder::new(&mut file)
        .unwrap()
        .with_compression(coding)
        .write_image::<C>(width, height, samples)
        .unwrap();
    file.into_inner()
}

fn refused(tiff: &Tiff) -> String {
    match decode(&tiff.bytes(), &ImageLimits::default()) {
        Err(error @ (CodecError::Unsupported { .. } | CodecError::Bad { .. })) => error.to_string(),
        other => panic!("{other:?}"),
    }
}

/// Every shape, several strips: our reader and another decoder give the samples back.
#[test]
fn every_shape_is_written_and_read() {
    let extent = Extent::new(301, 407).unwrap();
    for channels in [Channels::Rgb, Channels::Rgba] {
        for (grey, depth) in [
            (false, Depth::Eight),
            (false, Depth::Sixteen),
            (true, Depth::Eight),
            (true, Depth::Sixteen),
        ] {
            for compression in [Compression::None, Compression::Fast, Compression::Best] {
                let shape = PixelLayout {
                    extent,
                    channels,
                    grey,
                    depth,
                };
                let pixel = |n: u64, c: usize| {
                    let colour = if grey && c < 3 { 0 } else { c };
                    (n * n * 7 + n * 31 + colour as u64 * 4_099) as u16
                };
                let values: Vec<u16> = (0..extent.pixels())
                    .flat_map(|n| (0..channels.count()).map(move |c| pixel(n, c)))
                    .collect();
                let samples: Vec<u8> = match depth {
                    Depth::Eight => values.iter().map(|value| *value as u8).collect(),
                    Depth::Sixteen => values
                        .iter()
                        .flat_map(|value| value.to_be_bytes())
                        .collect(),
                };
                let file = file(shape, &samples, compression, None);
                let header = probe(&file).unwrap();
                assert_eq!(
                    (header.extent, header.channels, header.grey, header.depth),
                    (extent, channels, grey, depth)
                );
                let picture = decoded(&file);
                match depth {
                    Depth::Eight => assert!(eight(&picture) == samples),
                    Depth::Sixteen => assert!(sixteen(&picture) == values),
                }
                // The other decoder calls grey with alpha a colour type of its own.
                let mut theirs =
                    ::tiff::decoder::Decoder::new(std::io::Cursor::new(&file)).unwrap();
                let stored = |index: &usize| {
                    !grey || index.is_multiple_of(channels.count()) || index % channels.count() == 3
                };
                let wanted = || {
                    values
                        .iter()
                        .enumerate()
                        .filter(|(index, _)| stored(index))
                        .map(|(_, value)| *value)
                };
                match theirs.read_image().unwrap() {
                    ::tiff::decoder::DecodingResult::U8(got) => {
                        assert!(got.iter().copied().eq(wanted().map(|value| value as u8)))
                    }
                    ::tiff::decoder::DecodingResult::U16(got) => {
                        assert!(got.into_iter().eq(wanted()))
                    }
                    other => panic!("{other:?}"),
                }
            }
        }
    }
}

#[test]
fn files_of_another_writer_are_read() {
    let rgb: Vec<u8> = (0..200 * 150 * 3_u32)
        .map(|n| (n / 3 % 200 + n % 3 * 40) as u8)
        .collect();
    for coding in [
        Coding::Uncompressed,
        Coding::Lzw,
        Coding::Deflate(Default::default()),
        Coding::Packbits,
    ] {
        assert!(eight(&decoded(&other::<colortype::RGB8>(200, 150, &rgb, coding))) == rgb);
        let deep: Vec<u16> = (0..200 * 150).map(|n| n as u16 * 2).collect();
        let grey = other::<colortype::Gray16>(200, 150, &deep, coding);
        assert!(probe(&grey).unwrap().grey);
        assert!(
            sixteen(&decoded(&grey))
                .chunks(3)
                .map(|pixel| pixel[1])
                .eq(deep)
        );
    }
}

#[test]
fn every_kind_of_pixel_is_expanded() {
    let samples = |tiff: Tiff| eight(&decoded(&tiff.bytes())).to_vec();
    let grey = |values: [u8; 6]| {
        values
            .iter()
            .flat_map(|value| [*value; 3])
            .collect::<Vec<_>>()
    };
    assert_eq!(
        samples(Tiff::new(3, 2, &[1], 1, &[0b1010_0000, 0b0100_0000])),
        grey([255, 0, 255, 0, 255, 0])
    );
    assert_eq!(
        samples(Tiff::new(3, 2, &[1], 0, &[0b1010_0000, 0b0100_0000])),
        grey([0, 255, 0, 255, 0, 255])
    );
    assert_eq!(
        samples(Tiff::new(3, 2, &[2], 1, &[0b0001_1000, 0b1100_0000])),
        grey([0, 85, 170, 255, 0, 0])
    );
    assert_eq!(
        samples(Tiff::new(3, 2, &[4], 1, &[0x12, 0x30, 0xF0, 0x80])),
        grey([17, 34, 51, 255, 0, 136])
    );
    let tiles = samples(palette_in_tiles());
    assert_eq!(
        [&tiles[..3], &tiles[16 * 3..17 * 3], &tiles[16 * 60..][..3]],
        [[0; 3], [0x11; 3], [0x22; 3]]
    );
    // Premultiplied and straight alpha.
    let rgba = |kind| Tiff::new(2, 1, &[8; 4], 2, &[50, 25, 0, 100, 9, 9, 9, 0]).with(338, &[kind]);
    assert_eq!(samples(rgba(1)), [128, 64, 0, 100, 0, 0, 0, 0]);
    assert_eq!(samples(rgba(2)), [50, 25, 0, 100, 9, 9, 9, 0]);
    assert_eq!(
        samples(Tiff::new(2, 1, &[8; 2], 1, &[50, 100, 9, 0]).with(338, &[2])),
        [50, 50, 50, 100, 9, 9, 9, 0]
    );
}

/// Infrared beside RGB, masses of spectra: samples that are neither colour nor alpha are never
/// dropped.
#[test]
fn samples_that_are_no_colours_are_refused_by_their_number() {
    let grey = |samples: usize| Tiff::new(2, 1, &vec![8; samples], 1, &vec![9; 2 * samples]);
    let rgb = |samples: usize| Tiff::new(2, 1, &vec![8; samples], 2, &vec![9; 2 * samples]);
    for (tiff, samples) in [
        (grey(2), 2),
        (grey(2).with(338, &[0]), 2),
        (grey(5).with(338, &[0; 4]), 5),
        (grey(3).with(338, &[2, 0]), 3),
        (rgb(4).with(338, &[0]), 4),
        (rgb(5).with(338, &[0, 2]), 5),
        (rgb(5).with(338, &[1, 0]), 5),
        (rgb(20), 20),
        (
            Tiff::new(2, 1, &[8; 2], 3, &[0; 4])
                .with(320, &[0; 768])
                .with(338, &[2]),
            2,
        ),
    ] {
        let said = refused(&tiff);
        assert!(
            said.contains(&format!("{samples} samples per pixel")) && said.contains("layers"),
            "{said}"
        );
        let labels = open_labels(
            &tiff.bytes(),
            &ImageLimits::default(),
            &StepCounter::new(&|| false),
        )
        .map(|_| ());
        assert!(
            matches!(labels, Err(CodecError::Unsupported { .. })),
            "also as labels"
        );
    }
}

#[test]
fn a_fourth_sample_without_a_tag_is_alpha_beside_three_colours() {
    let picture = decoded(&Tiff::new(2, 1, &[8; 4], 2, &[10, 20, 30, 255, 40, 50, 60, 0]).bytes());
    assert_eq!(
        (picture.channels(), eight(&picture)),
        (Channels::Rgba, &[10, 20, 30, 255, 40, 50, 60, 0][..])
    );
}

#[test]
fn the_orientation_is_applied() {
    for (number, width, letters) in UPRIGHT {
        let picture = decoded(
            &Tiff::new(3, 2, &[8], 1, b"abcdef")
                .with(274, &[number.into()])
                .bytes(),
        );
        let got: Vec<u8> = eight(&picture).chunks(3).map(|pixel| pixel[0]).collect();
        assert_eq!(
            (picture.extent().width() as usize, got.as_slice()),
            (width, letters.as_slice()),
            "{number}"
        );
    }
}

#[test]
fn one_page_is_read_and_several_are_refused() {
    let pages = |more: &[u32]| {
        Tiff {
            more: more.to_vec(),
            ..Tiff::new(3, 2, &[8], 1, b"abcdef")
        }
        .bytes()
    };
    let several = CodecError::TooLarge {
        what: "image_frames",
        limit: 1,
        actual: 3,
    };
    assert_eq!(
        decode(&pages(&[0, 2]), &ImageLimits::default()).unwrap_err(),
        several
    );
    assert!(
        decode(&pages(&[1, 1]), &ImageLimits::default()).is_ok(),
        "a preview is no page"
    );
    // The preview comes first.
    let preview = Tiff::new(3, 2, &[8], 1, b"ghijkl").with(254, &[1]);
    assert!(
        decode(&preview.bytes(), &ImageLimits::default()).is_ok(),
        "there is nothing else"
    );
    let error = decode(
        &Tiff {
            more: vec![0],
            ..preview
        }
        .bytes(),
        &ImageLimits::default(),
    )
    .unwrap_err();
    assert!(
        error.to_string().contains("0 x 0"),
        "the second directory has no size: {error}"
    );
    // Directories that are the same bytes, and the last one leads back to itself.
    let mut circle = pages(&[1]);
    let last = circle.len() - 4;
    let at = (last as u32 - 14).to_le_bytes();
    circle[last..].copy_from_slice(&at);
    assert!(matches!(
        decode(&circle, &ImageLimits::default()),
        Err(CodecError::Bad { .. })
    ));
}

#[test]
fn other_kinds_are_named() {
    let rgb = || Tiff::new(2, 1, &[8; 3], 2, &[0; 6]);
    let mut without_meaning = rgb();
    without_meaning.entries.retain(|entry| entry.0 != 262);
    for (tiff, word) in [
        (Tiff::new(2, 1, &[8; 4], 5, &[0; 8]), "CMYK"),
        (Tiff::new(2, 1, &[8; 3], 6, &[0; 6]), "YCbCr"),
        (Tiff::new(2, 1, &[8; 3], 8, &[0; 6]), "Lab"),
        (
            Tiff::new(2, 1, &[8], 32_803, &[0; 2]),
            "photometric interpretation 32803",
        ),
        (
            Tiff::new(2, 1, &[32; 3], 2, &[0; 24]),
            "bits per sample are 32",
        ),
        (
            Tiff::new(2, 1, &[32], 1, &[0; 8]).with(339, &[3]),
            "floating-point",
        ),
        (
            Tiff::new(2, 1, &[8, 8, 16], 2, &[0; 8]),
            "differ in their depth",
        ),
        (
            Tiff::new(2, 1, &[16], 1, &[0; 4]).with(339, &[3]),
            "floating-point",
        ),
        (rgb().with(284, &[2]), "too few strips"),
        (rgb().with(259, &[6]), "JPEG compression of the old kind"),
        (rgb().with(259, &[7]), "JPEG data"),
        (rgb().with(259, &[7]).with(284, &[2]), "separate planes"),
        (rgb().with(259, &[3]), "CCITT group 3"),
        (rgb().with(259, &[4]), "bits per sample are 8"),
        (rgb().with(259, &[50_000]), "Zstandard"),
        (rgb().with(259, &[34_887]), "compression 34887"),
        (Tiff::new(2, 1, &[32], 1, &[0; 8]), "kind=labels"),
        (
            Tiff::new(2, 1, &[16], 1, &[0; 4]).with(339, &[2]),
            "with a sign",
        ),
        (
            Tiff::new(2, 1, &[32], 1, &[0; 8]).with(339, &[3]),
            "POST /map",
        ),
        (rgb().with(317, &[3]), "predictor 3"),
        (rgb().with(266, &[2]), "reverse order"),
        (
            Tiff::new(2, 1, &[8; 2], 2, &[0; 4]),
            "samples per pixel is 2",
        ),
        (Tiff::new(2, 1, &[8], 3, &[0; 2]), "too few colours"),
        (Tiff::new(0, 1, &[8], 1, &[0; 2]), "0 x 1 pixels"),
        (without_meaning, "no photometric interpretation"),
        (rgb().with(254, &[1]).with(330, &[8]), "preview"),
        (rgb().with(278, &[0]), "strips or tiles of 2 x 0"),
    ] {
        let said = refused(&tiff);
        assert!(said.contains(word), "{said}: {word}");
    }
}

#[test]
fn lies_are_refused_before_memory_is_taken() {
    let claim = |width: u32, height: u32| {
        let mut tiff = Tiff::new(1, 1, &[8], 1, &[0; 16]);
        tiff.entries[0].2 = vec![width];
        tiff.entries[1].2 = vec![height];
        tiff
    };
    let large = CodecError::TooLarge {
        what: "image_side",
        limit: 16_384,
        actual: 60_000,
    };
    assert_eq!(
        decode(&claim(60_000, 60_000).bytes(), &ImageLimits::default()).unwrap_err(),
        large
    );
    assert!(refused(&claim(16_384, 3_000)).contains("cannot hold the picture"));
    assert!(refused(&claim(16_384, 3_000).with(278, &[1])).contains("too few strips"));
    // Strips that are the same bytes, and tiles that are far wider than the picture.
    let mut same = Tiff::new(64, 64, &[8], 1, &[]).with(278, &[1]);
    same.parts = vec![vec![0; 64]; 64];
    let mut file = same.bytes();
    let at = file
        .windows(8)
        .position(|window| window == [17, 1, 4, 0, 64, 0, 0, 0])
        .unwrap();
    let offsets = u32::from_le_bytes(file[at + 8..at + 12].try_into().unwrap()) as usize;
    let lengths = offsets + 256;
    assert!(decode(&file, &ImageLimits::default()).is_ok());
    for strip in 0..64 {
        file[offsets + 4 * strip..][..4].copy_from_slice(&8_u32.to_le_bytes());
        file[lengths + 4 * strip..][..4].copy_from_slice(&4_000_u32.to_le_bytes());
    }
    let Err(CodecError::Bad { detail, .. }) = decode(&file, &ImageLimits::default()) else {
        panic!("read")
    };
    assert!(detail.contains("overlap"), "{detail}");
    let wide = palette_in_tiles().with(322, &[60_000]);
    assert!(refused(&wide).contains("tiles of 60000"));
}

/// No change of a byte makes the reader panic or disagree with its header.
#[test]
fn every_byte_may_change() {
    let files = [
        palette_in_tiles().bytes(),
        written((5, 4), &[7; 80], None),
        lzw(5, 4, &[7; 60]),
    ];
    for file in files {
        let mut read = 0;
        for at in 0..file.len() {
            for value in [0, 1, 0x7F, 0xFF, file[at] ^ 0x10] {
                let mut changed = file.clone();
                changed[at] = value;
                read += usize::from(header_is_kept(&changed));
            }
        }
        assert!(read > 0);
    }
}

#[test]
fn a_file_that_nobody_waits_for_is_not_written_to_its_end() {
    let shape = PixelLayout {
        extent: Extent::new(1_000, 1_000).unwrap(),
        channels: Channels::Rgb,
        grey: false,
        depth: Depth::Eight,
    };
    let looks = std::cell::Cell::new(0);
    let mut out = Vec::new();
    let writer = Writer::new(shape, Encoding::Tiff(Compression::None), None);
    writer.strip_into(0, &mut vec![0; 3_000_000], &mut out, &|| {
        looks.replace(looks.get() + 1) < 2
    });
    assert!(out.len() < 1_000_000, "{}", out.len());
}
