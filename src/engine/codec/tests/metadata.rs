//! Metadata: every carrier of every format that is read, in every format that is written, is kept
//! or named; the length of a pixel; what describes the stored pixels is left out; and what hostile
//! metadata cost.

use std::sync::Arc;

use super::carriers::*;
use super::made::{exif_block, iccp, profile};
use super::*;
use crate::pixmap::Extent;

const OUTPUTS: [(Encoding, Format); 4] = [
    (Encoding::Png(Compression::Fast), Format::Png),
    (
        Encoding::Jpeg {
            quality: 90,
            subsampling: Subsampling::Full,
            ground: [255; 3],
        },
        Format::Jpeg,
    ),
    (Encoding::WebP, Format::WebP),
    (Encoding::Tiff(Compression::Fast), Format::Tiff),
];

fn token_in(file: &[u8]) -> bool {
    file.windows(TOKEN.len()).any(|window| window == TOKEN)
}

/// A decoded file, written in a format as a picture of another size would be: the file, and what is
/// lost.
fn written(
    file: &[u8],
    encoding: Encoding,
    format: Format,
    scale: (u32, u32),
) -> (Vec<u8>, (bool, Dropped), Arc<Metadata>) {
    let work = StepCounter::new(&|| false);
    let opened = open(file, &ImageLimits::default(), &work).unwrap();
    let Decoded {
        pixmap, metadata, ..
    } = opened.decode().unwrap();
    let metadata = Arc::new(metadata);
    let times = |factor: u32| Extent::new(7 * factor, 5 * factor).unwrap();
    let (target, canvas) = if scale == (1, 1) {
        (pixmap.extent(), pixmap.extent())
    } else {
        (times(scale.0), times(scale.1))
    };
    let carried = Carried::new(&metadata, target, canvas);
    let grey = opened.header().grey;
    let shape = PixelLayout {
        extent: target,
        channels: Channels::Rgb,
        grey,
        depth: Depth::Eight,
    };
    let writer = Writer::new(shape, encoding, Some(&carried));
    let mut out = writer.head();
    let samples = vec![77; 3 * target.pixels() as usize];
    let strip = |k: usize, out: &mut Vec<u8>| {
        let rows = writer.rows(k).len() * target.width() as usize * 3;
        writer.strip_into(k, &mut samples[..rows].to_vec(), out, &|| true)
    };
    let sums: Vec<_> = (0..writer.strips()).map(|k| strip(k, &mut out)).collect();
    out.extend(writer.tail(&sums));
    assert!(out.len() as u64 <= writer.max_bytes());
    (
        out,
        carried.losses(format, grey && encoding.is_grey()),
        metadata,
    )
}

fn read_metadata(file: &[u8]) -> Metadata {
    decode(file, &ImageLimits::default()).unwrap().metadata
}

#[test]
fn every_carrier_is_kept_or_named_in_every_format() {
    for (source, carriers) in [
        ("PNG", png_carriers()),
        ("JPEG", jpeg_carriers()),
        ("TIFF", tiff_carriers()),
        ("other", other_carriers()),
    ] {
        for (name, file, sign, want, dropped_as) in carriers {
            for ((encoding, format), want) in OUTPUTS.into_iter().zip(want.chars()) {
                let case = format!("{source}: {name} as {}", format.name());
                let (out, (profile, dropped), metadata) = written(&file, encoding, format, (1, 1));
                let names: Vec<&str> = dropped.names().collect();
                let is_kept = match &sign {
                    Sign::Token => token_in(&out),
                    Sign::Bytes(bytes) => out.windows(bytes.len()).any(|window| window == bytes),
                    Sign::Icc(icc) => read_metadata(&out).icc() == Some(icc.as_slice()),
                    Sign::Resolution => {
                        let [before, after] = [
                            Some(metadata.resolution()),
                            Some(read_metadata(&out).resolution()),
                        ]
                        .map(|resolution| resolution.flatten().expect(&case).per_millimetre());
                        before
                            .iter()
                            .zip(after)
                            .all(|(a, b)| (a / b - 1.0).abs() < 1e-4)
                    }
                };
                assert_eq!(is_kept, want == 'k', "{case}: {names:?}");
                assert_eq!(profile, want == 'p', "{case}");
                assert_eq!(
                    names,
                    if want == 'd' {
                        vec![dropped_as]
                    } else {
                        vec![]
                    },
                    "{case}"
                );
                // What is kept once is kept again: nothing is lost on the second way.
                if want == 'k' {
                    let (again, (profile, dropped), _) = written(&out, encoding, format, (1, 1));
                    assert!(
                        !profile && dropped.is_empty(),
                        "{case}, again: {:?}",
                        dropped.names().collect::<Vec<_>>()
                    );
                    assert!(again == out, "{case}: the second way gives other bytes");
                }
            }
        }
    }
}

/// The frames of an animation have pixels alone.
#[test]
fn what_a_gif_does_not_carry_is_named() {
    for (name, file, _, want, _) in [
        png_carriers(),
        jpeg_carriers(),
        tiff_carriers(),
        other_carriers(),
    ]
    .concat()
    {
        let (out, (profile, dropped), _) = written(&file, Encoding::Gif, Format::Gif, (1, 1));
        assert!(!token_in(&out), "{name}");
        // What only PNG needs to say, that the colours are sRGB, is no loss.
        assert_eq!(
            profile || !dropped.is_empty(),
            want[1..].contains(['k', 'p', 'd']),
            "{name}: {profile} {:?}",
            dropped.names().collect::<Vec<_>>()
        );
    }
}

#[test]
fn what_describes_the_stored_pixels_is_left_out_of_exif() {
    for (name, file) in [
        ("PNG", png(false).with(*b"eXIf", &rich_exif(true)).bytes()),
        (
            "JPEG",
            jpeg(false)
                .with_segment(0xE1, &[b"Exif\0\0".as_slice(), &rich_exif(false)].concat())
                .bytes(),
        ),
    ] {
        for (encoding, format) in OUTPUTS {
            let (out, ..) = written(&file, encoding, format, (1, 1));
            let has = |text: &[u8]| out.windows(text.len()).any(|window| window == text);
            assert!(
                token_in(&out) && has(b"2024:01:02 03:04:05") && has(b"2024:01:02\0"),
                "{name} as {}",
                format.name()
            );
            assert!(!has(b"thumbnail"), "{name} as {}", format.name());
            // Six would turn it once more; the width was 4000.
            let header = probe(&out).unwrap().extent;
            assert_eq!(
                header,
                decoded(&file).extent(),
                "{name} as {}",
                format.name()
            );
            assert!(
                !has(&[0x0F, 0xA0]) && !has(&[0xA0, 0x0F]),
                "{name} as {}: the old width",
                format.name()
            );
        }
    }
}

/// A maker's note keeps its place, because its offsets may count from the beginning of the block;
/// one with a picture is dropped.
#[test]
fn a_makers_note_stays_at_its_place() {
    let note: Vec<u8> = [b"MAKER\0".as_slice(), TOKEN].concat();
    let with = |note: &[u8], little: bool| {
        let photo = vec![
            (0x927C, UNDEFINED, note.len() as u32, note),
            (0x9003, ASCII, 20, b"2024:01:02 03:04:05\0".as_slice()),
        ];
        exif_block(
            little,
            &[(0x0131, ASCII, 24, &[b'x'; 24])],
            &[(0x8769, photo)],
            &[],
        )
    };
    for little in [true, false] {
        let block = with(&note, little);
        let place = |file: &[u8], start: &[u8]| {
            let start = file
                .windows(start.len())
                .position(|window| window == start)
                .unwrap();
            file[start..]
                .windows(note.len())
                .position(|window| window == note)
        };
        let head: &[u8] = if little { b"II*\0" } else { b"MM\0*" };
        let file = png(false).with(*b"eXIf", &block).bytes();
        for (encoding, format) in OUTPUTS {
            let (out, (_, dropped), _) = written(&file, encoding, format, (1, 1));
            if format == Format::Tiff {
                assert_eq!(dropped.names().collect::<Vec<_>>(), ["maker note"]);
                assert!(!token_in(&out));
            } else {
                assert!(dropped.is_empty());
                assert_eq!(place(&out, head), place(&block, head), "{}", format.name());
            }
        }
        let preview = [note.as_slice(), &[0xFF, 0xD8, 0xFF, 0xE0]].concat();
        let file = png(false).with(*b"eXIf", &with(&preview, little)).bytes();
        let (out, (_, dropped), _) = written(&file, OUTPUTS[0].0, Format::Png, (1, 1));
        assert_eq!(dropped.names().collect::<Vec<_>>(), ["maker note"]);
        assert!(
            !token_in(&out)
                && out
                    .windows(19)
                    .any(|window| window == b"2024:01:02 03:04:05")
        );
    }
}

/// Files of a known resolution: its form, and px per mm (or px without a unit).
fn resolutions() -> Vec<(&'static str, Vec<u8>, [f64; 2])> {
    let ratio = |n: u32, d: u32| [n.to_le_bytes(), d.to_le_bytes()].concat();
    let tiff_of = |x: (u32, u32), y: (u32, u32), unit: u32| {
        let file = tiff(false)
            .with_tag(282, RATIONAL, 1, &ratio(x.0, x.1))
            .with_tag(283, RATIONAL, 1, &ratio(y.0, y.1));
        file.with(296, &[unit]).bytes()
    };
    let png_of = |x: u32, y: u32, unit: u8| {
        png(false)
            .with(
                *b"pHYs",
                &[&x.to_be_bytes()[..], &y.to_be_bytes(), &[unit]].concat(),
            )
            .bytes()
    };
    let jpeg_of = |unit: u8, x: u16, y: u16| {
        jpeg(false)
            .with_segment(
                0xE0,
                &[
                    b"JFIF\0\x01\x02",
                    &[unit][..],
                    &x.to_be_bytes(),
                    &y.to_be_bytes(),
                    &[0; 2],
                ]
                .concat(),
            )
            .bytes()
    };
    let by_exif = {
        let (x, y) = (ratio(350, 1), ratio(2_001, 10));
        let block = exif_block(
            true,
            &[
                (282, RATIONAL, 1, &x),
                (283, RATIONAL, 1, &y),
                (296, 3, 1, &[2, 0]),
            ],
            &[],
            &[],
        );
        jpeg(false)
            .with_segment(0xE1, &[b"Exif\0\0".as_slice(), &block].concat())
            .bytes()
    };
    vec![
        ("300 dpi in PNG", png_of(11_811, 11_811, 1), [11.811; 2]),
        (
            "a microscope in PNG",
            png_of(4_000_000, 2_000_000, 1),
            [4_000.0, 2_000.0],
        ),
        (
            "300 x 150 dpi in JPEG",
            jpeg_of(1, 300, 150),
            [300.0 / 25.4, 150.0 / 25.4],
        ),
        ("120 per cm in JPEG", jpeg_of(2, 120, 120), [12.0; 2]),
        ("EXIF", by_exif, [350.0 / 25.4, 200.1 / 25.4]),
        (
            "2.5 per cm in TIFF",
            tiff_of((5, 2), (7, 2), 3),
            [0.25, 0.35],
        ),
        (
            "a microscope in TIFF",
            tiff_of((40_000, 1), (40_000, 1), 3),
            [4_000.0; 2],
        ),
        (
            "an aerial photograph in TIFF",
            tiff_of((1, 50), (1, 50), 3),
            [0.002; 2],
        ),
        (
            "per micrometre, as ImageJ says it",
            tiff_of((25, 10), (25, 10), 1),
            [2.5; 2],
        ),
    ]
}

/// px per mm, divided by the scale, are those of the source, in every format.
#[test]
fn a_pixel_keeps_its_length() {
    for (name, file, known) in resolutions() {
        for (encoding, format) in OUTPUTS {
            for scale in [(1, 1), (1, 2), (3, 1), (2, 7)] {
                let (out, (_, dropped), _) = written(&file, encoding, format, scale);
                let got = read_metadata(&out)
                    .resolution()
                    .unwrap_or_else(|| panic!("{name} as {}", format.name()))
                    .per_millimetre();
                for (got, known) in got.into_iter().zip(known) {
                    let want = known * f64::from(scale.0) / f64::from(scale.1);
                    assert!(
                        (got / want - 1.0).abs() < 2e-4,
                        "{name} as {} at {scale:?}: {got} for {want}",
                        format.name()
                    );
                }
                assert!(dropped.is_empty());
            }
        }
    }
}

#[test]
fn the_same_format_and_size_keep_the_same_numbers() {
    let kept = |file: &[u8], encoding, format| {
        read_metadata(&written(file, encoding, format, (1, 1)).0).resolution()
    };
    for (name, file, _) in resolutions() {
        let format = match SourceFormat::of(&file).unwrap() {
            SourceFormat::Written(format) => format,
            other => panic!("{other:?}"),
        };
        let (encoding, _) = OUTPUTS
            .into_iter()
            .find(|(_, output)| *output == format)
            .unwrap();
        let before = read_metadata(&file).resolution();
        assert_eq!(kept(&file, encoding, format), before, "{name}");
    }
    // Nothing known: a TIFF must say something, which means nothing.
    let plain = written(&png(false).bytes(), OUTPUTS[3].0, Format::Tiff, (1, 1)).0;
    assert_eq!(read_metadata(&plain).resolution(), None);
    let mut theirs = ::tiff::decoder::Decoder::new(std::io::Cursor::new(&plain)).unwrap();
    let tag = |theirs: &mut ::tiff::decoder::Decoder<_>, tag| theirs.get_tag(tag).unwrap();
    assert_eq!(
        tag(&mut theirs, ::tiff::tags::Tag::XResolution),
        ::tiff::decoder::ifd::Value::Rational(1, 1)
    );
    assert_eq!(
        tag(&mut theirs, ::tiff::tags::Tag::ResolutionUnit)
            .into_u16()
            .unwrap(),
        1
    );
}

#[test]
fn a_turned_picture_has_its_resolutions_swapped() {
    for (number, swaps) in [
        (1, false),
        (3, false),
        (5, true),
        (6, true),
        (7, true),
        (8, true),
    ] {
        let file = png(false)
            .with(*b"pHYs", b"\0\0\0\x64\0\0\0\xC8\x01")
            .with(*b"eXIf", &exif(number, true))
            .bytes();
        let resolution = read_metadata(&file).resolution().unwrap();
        let [x, y] = if swaps { [200, 100] } else { [100, 200] };
        assert_eq!(
            resolution,
            Resolution::whole(x, y, ResolutionUnit::Metre).unwrap(),
            "{number}"
        );
    }
}

/// Other readers find what is written.
#[test]
fn other_readers_find_the_metadata() {
    use image::ImageDecoder as _;
    let ratio = |n: u32| [n.to_le_bytes(), 1_u32.to_le_bytes()].concat();
    let source = tiff(false)
        .with_tag(282, RATIONAL, 1, &ratio(300))
        .with_tag(283, RATIONAL, 1, &ratio(300))
        .with(296, &[2]);
    let source = source
        .with_tag(315, ASCII, TOKEN.len(), TOKEN)
        .with_tag(34_675, UNDEFINED, 400, &profile(400))
        .bytes();
    let out =
        |k: usize| std::io::Cursor::new(written(&source, OUTPUTS[k].0, OUTPUTS[k].1, (1, 1)).0);
    let check = |exif: Option<Vec<u8>>, icc: Option<Vec<u8>>| {
        assert!(exif.is_some_and(|exif| token_in(&exif)));
        assert_eq!(icc.as_deref(), Some(profile(400).as_slice()));
    };
    let mut png = image::codecs::png::PngDecoder::new(out(0)).unwrap();
    check(png.exif_metadata().unwrap(), png.icc_profile().unwrap());
    let mut jpeg = image::codecs::jpeg::JpegDecoder::new(out(1)).unwrap();
    check(jpeg.exif_metadata().unwrap(), jpeg.icc_profile().unwrap());
    let mut webp = image::codecs::webp::WebPDecoder::new(out(2)).unwrap();
    check(webp.exif_metadata().unwrap(), webp.icc_profile().unwrap());
    let mut theirs = ::tiff::decoder::Decoder::new(out(3)).unwrap();
    use ::tiff::tags::Tag;
    assert_eq!(
        theirs.get_tag_ascii_string(Tag::Artist).unwrap().as_bytes(),
        TOKEN
    );
    assert_eq!(
        theirs.get_tag(Tag::XResolution).unwrap(),
        ::tiff::decoder::ifd::Value::Rational(300, 1)
    );
    assert_eq!(
        theirs.get_tag_u8_vec(Tag::IccProfile).unwrap(),
        profile(400)
    );
}

/// Files whose metadata are made to cost more than their size.
pub(super) fn hostile() -> Vec<(&'static str, Vec<u8>)> {
    let keyword = b"XML:com.adobe.xmp\0\x01\0\0\0";
    let bomb = made::deflate(&vec![b' '; 64 << 20]);
    let many = |kind: [u8; 4], data: &[u8], count: usize| {
        let mut png = png(false);
        png.before = vec![(kind, data.to_vec()); count];
        png.bytes()
    };
    // Each directory leads to itself, and each value is the whole block.
    let looped = {
        let mut block = b"II*\0\x08\0\0\0".to_vec();
        let count = 5_000_u16;
        block.extend(count.to_le_bytes());
        for tag in 0..count {
            let (tag, kind, count, at) = match tag {
                0 => (0x8769_u16, 4_u16, 1_u32, 8_u32),
                1 => (0x8825, 4, 1, 8),
                2 => (0xA005, 4, 1, 8),
                _ => (0x9000 + tag, UNDEFINED, 60_000, 8),
            };
            block.extend(
                [
                    &tag.to_le_bytes()[..],
                    &kind.to_le_bytes(),
                    &count.to_le_bytes(),
                    &at.to_le_bytes(),
                ]
                .concat(),
            );
        }
        block.extend(8_u32.to_le_bytes());
        block.resize(64_000, 0);
        block
    };
    let properties = "<tiff:Orientation/>".repeat(3_000);
    vec![
        (
            "a profile that inflates",
            png(false).with(*b"iCCP", &iccp(&vec![0; 64 << 20])).bytes(),
        ),
        (
            "XMP that inflates",
            png(false)
                .with(*b"iTXt", &[&keyword[..], &bomb].concat())
                .bytes(),
        ),
        (
            "texts that inflate",
            many(
                *b"zTXt",
                &[b"a\0\0".as_slice(), &bomb[..30_000]].concat(),
                40,
            ),
        ),
        ("thousands of texts", many(*b"tEXt", b"a\0b", 20_000)),
        ("thousands of empty texts", many(*b"iTXt", b"", 20_000)),
        ("thousands of chunks", many(*b"prVt", b"", 50_000)),
        (
            "thousands of profiles",
            many(*b"iCCP", &iccp(&profile(400)), 3_000),
        ),
        (
            "directories that lead to themselves",
            png(false).with(*b"eXIf", &looped).bytes(),
        ),
        (
            "the same in a JPEG",
            jpeg(false)
                .with_segment(0xE1, &[b"Exif\0\0".as_slice(), &looped].concat())
                .bytes(),
        ),
        (
            "thousands of properties",
            jpeg(false)
                .with_segment(
                    0xE1,
                    &[b"http://ns.adobe.com/xap/1.0/\0", properties.as_bytes()].concat(),
                )
                .bytes(),
        ),
        (
            "thousands of comments",
            (0..5_000)
                .fold(jpeg(false), |jpeg, _| jpeg.with_segment(0xFE, b"a"))
                .bytes(),
        ),
        ("many zeros between segments", {
            let mut file = jpeg(false).with_segment(0xFE, b"a").bytes();
            file.splice(7..7, vec![0; 1 << 20]);
            file
        }),
        (
            "thousands of tags",
            (0..20_000)
                .fold(tiff(false), |tiff, k| {
                    tiff.with_tag(40_000 + k, ASCII, 3, b"ab\0")
                })
                .bytes(),
        ),
        ("thousands of extensions", {
            let mut file = few_formats::gif(&[(3, 2)], None);
            file.splice(25..25, b"\x21\xFE\x01a\0".repeat(50_000));
            file
        }),
    ]
}

#[test]
fn hostile_metadata_cost_little_memory() {
    for (name, file) in hostile() {
        let metadata = read_metadata(&file);
        let held = metadata.bytes() as u64;
        assert!(held <= METADATA_BYTES + PROFILE_BYTES, "{name}: {held}");
        let carried = Carried::new(
            &Arc::new(metadata),
            Extent::new(1, 1).unwrap(),
            Extent::new(1, 1).unwrap(),
        );
        for (encoding, format) in OUTPUTS {
            let shape = PixelLayout {
                extent: Extent::new(8, 8).unwrap(),
                channels: Channels::Rgb,
                grey: false,
                depth: Depth::Eight,
            };
            let writer = Writer::new(shape, encoding, Some(&carried));
            let mut out = writer.head();
            let sum = writer.strip_into(0, &mut [0; 192], &mut out, &|| true);
            out.extend(writer.tail(&[sum]));
            assert!(
                out.len() as u64 <= writer.max_bytes().min(METADATA_BYTES + PROFILE_BYTES),
                "{name} as {}",
                format.name()
            );
            assert!(
                decode(&out, &ImageLimits::default()).is_ok(),
                "{name} as {}",
                format.name()
            );
        }
    }
}
