//! Tests of reading files: properties of all formats here, and one file per format. Files are built
//! in `made`, so that every chunk is known; photographs and seeds come from `test_files`, links
//! that `cargo package` follows.

#![expect(
    clippy::cast_possible_truncation,
    reason = "patterns are cut to their low byte, and sizes are written here"
)]

pub(super) mod bombs;
mod carriers;
mod few_formats;
mod hostile;
mod jpeg;
mod labels;
mod made;
mod metadata;
mod png;
mod tiff;
mod tiff_kinds;
mod webp;
mod work;

use super::orientation::tests::{UPRIGHT, exif};
use super::*;
use crate::pixmap::{Channels, Depth, Pixmap, Samples};

fn decode(bytes: &[u8], limits: &ImageLimits) -> Result<Decoded, CodecError> {
    super::decode(bytes, limits, &|| false)
}

fn probe(bytes: &[u8]) -> Result<Header, CodecError> {
    super::probe(bytes, &StepCounter::new(&|| false))
}

fn photograph(name: &str) -> Vec<u8> {
    std::fs::read(format!(
        "{}/test_files/images/{name}",
        env!("CARGO_MANIFEST_DIR")
    ))
    .unwrap()
}

fn decoded(bytes: &[u8]) -> Pixmap {
    decode(bytes, &ImageLimits::default()).unwrap().pixmap
}

fn eight(pixmap: &Pixmap) -> &[u8] {
    match pixmap.samples() {
        Samples::Eight(samples) => samples,
        Samples::Sixteen(_) => panic!("8 bit expected"),
    }
}

fn sixteen(pixmap: &Pixmap) -> &[u16] {
    match pixmap.samples() {
        Samples::Sixteen(samples) => samples,
        Samples::Eight(_) => panic!("16 bit expected"),
    }
}

/// The decoded picture matches its header. Returns whether the file was read.
fn header_is_kept(bytes: &[u8]) -> bool {
    let Ok(Decoded { pixmap, .. }) = decode(
        bytes,
        &ImageLimits {
            max_pixels: 1 << 20,
            max_side: 1 << 12,
        },
    ) else {
        return false;
    };
    let header = probe(bytes).unwrap();
    assert_eq!(
        (header.extent, header.channels, header.depth),
        (pixmap.extent(), pixmap.channels(), pixmap.depth())
    );
    assert!(header.decode_bytes > pixmap.bytes() as u64);
    true
}

/// One file of every kind, with every chunk that is read.
fn zoo() -> Vec<(&'static str, Vec<u8>)> {
    let letters = made::Jpeg::letters();
    let exif_block = exif(6, false);
    let rgba: Vec<u8> = (0..5 * 4 * 4).map(|n| n as u8 * 3).collect();
    let mut rich = made::Png::new(5, 4, 8, 6, &rgba);
    rich.before
        .push((*b"iCCP", made::iccp(&made::profile(500))));
    rich.before.push((*b"eXIf", exif_block.clone()));
    let mut palette = made::Png::new(5, 4, 2, 3, &[0b0001_1011; 8]);
    palette.before.push((*b"PLTE", (0..12).collect()));
    palette.before.push((*b"tRNS", vec![0, 100]));
    vec![
        ("png rgba", rich.bytes()),
        ("png palette", palette.bytes()),
        (
            "png 16 interlaced",
            made::Png::interlaced(5, 4, 16, 2, &[7; 5 * 4 * 6]).bytes(),
        ),
        ("jpeg grey", letters.clone().bytes()),
        (
            "jpeg exif icc",
            letters
                .clone()
                .with_segment(0xE1, &[b"Exif\0\0".as_slice(), &exif_block].concat())
                .bytes(),
        ),
        (
            "jpeg colour",
            made::Jpeg::flat(24, 16, &[(2, 2), (1, 1), (1, 1)], &[10, -20, 30]).bytes(),
        ),
        (
            "jpeg progressive",
            made::Jpeg::flat(24, 16, &[(1, 1), (1, 1), (1, 1)], &[10, -20, 30])
                .progressive()
                .bytes(),
        ),
        (
            "jpeg cmyk",
            made::Jpeg::flat(16, 8, &[(1, 1); 4], &[10, -20, 30, 40]).bytes(),
        ),
        (
            "webp lossless",
            made::webp_lossless(5, 4, Channels::Rgb, &rgba[..60]),
        ),
        (
            "webp rich",
            made::webp_container(
                &made::webp_lossless(5, 4, Channels::Rgba, &rgba),
                (5, 4),
                &exif_block,
                &made::profile(500),
            ),
        ),
        ("webp lossy", made::webp_lossy(20, 17, None)),
        (
            "webp lossy alpha",
            made::webp_lossy(20, 17, Some(&[9; 20 * 17])),
        ),
        (
            "tiff deflate icc",
            tiff::written((5, 4), &rgba, Some(&made::profile(500))),
        ),
        ("tiff lzw", tiff::lzw(5, 4, &rgba[..60])),
        ("tiff palette tiles", tiff::palette_in_tiles().bytes()),
        ("gif", few_formats::gif(&[(5, 4)], None)),
        ("gif transparent", few_formats::gif(&[(5, 4)], Some(2))),
        ("bmp", few_formats::bmp(5, 4, &rgba[..60])),
    ]
}

#[test]
fn probe_and_decode_agree_on_every_kind() {
    for (name, bytes) in zoo() {
        assert!(
            header_is_kept(&bytes),
            "{name}: {:?}",
            decode(&bytes, &ImageLimits::default()).err()
        );
    }
}

#[test]
fn trailing_bytes_are_ignored() {
    for (name, bytes) in zoo() {
        let expected = decode(&bytes, &ImageLimits::default()).unwrap();
        for tail in [b"\0".as_slice(), b"trailing garbage", &bytes] {
            let longer = [&bytes, tail].concat();
            let got = decode(&longer, &ImageLimits::default()).unwrap();
            assert_eq!(
                (&got.pixmap, got.metadata.icc()),
                (&expected.pixmap, expected.metadata.icc()),
                "{name}"
            );
        }
    }
}

#[test]
fn limits_are_applied_to_the_upright_numbers_before_anything_else() {
    for (name, bytes) in zoo() {
        let extent = probe(&bytes).unwrap().extent;
        let exact = ImageLimits {
            max_pixels: extent.pixels(),
            max_side: extent.width().max(extent.height()),
        };
        assert!(decode(&bytes, &exact).is_ok(), "{name}");
        let side = ImageLimits {
            max_side: exact.max_side - 1,
            ..exact
        };
        assert!(
            matches!(
                decode(&bytes, &side),
                Err(CodecError::TooLarge {
                    what: "image_side",
                    ..
                })
            ),
            "{name}"
        );
        let pixels = ImageLimits {
            max_pixels: exact.max_pixels - 1,
            ..exact
        };
        assert!(
            matches!(
                decode(&bytes, &pixels),
                Err(CodecError::TooLarge {
                    what: "image_pixels",
                    ..
                })
            ),
            "{name}"
        );
    }
}

#[test]
fn unsupported_formats_are_named() {
    let found = |bytes: &[u8]| match (probe(bytes), decode(bytes, &ImageLimits::default())) {
        (Err(CodecError::Unsupported { found }), Err(CodecError::Unsupported { found: again }))
            if found == again =>
        {
            found
        }
        other => panic!("{other:?}"),
    };
    assert_eq!(
        found(b"GIF88a\x01\0\x01\0\0\0\0;"),
        "an unknown format that begins with 47 49 46 38"
    );
    assert_eq!(found(b"\0\0\0\x20ftypavif........"), "AVIF");
    for (head, name) in [
        (&b"\0\0\0\x18ftypheic........"[..], "HEIC"),
        (b"\0\0\0\x18ftypmif1........", "HEIC"),
        (b"\0\0\0\x18ftypmp42........", "a video"),
        (b"8BPS\0\x01........", "Photoshop (PSD)"),
        (b"%PDF-1.7........", "PDF"),
        (b"\xFF\x0A..............", "JPEG XL"),
        (b"PK\x03\x04............", "a ZIP archive"),
        (b"{\"p\": [[1, 2]]}", "JSON"),
        (
            b"data:image/png;base64,iVBORw0KGgo=",
            "a data URL; send the bytes of the file",
        ),
        (
            b"iVBORw0KGgoAAAANSUhEUgAA",
            "base64; send the bytes of the file",
        ),
    ] {
        assert_eq!(found(head), name);
    }
    assert_eq!(found(b""), "an empty file (0 bytes)");
    assert_eq!(found(b"\x89PNG\r\n"), "6 bytes, too short for an image");
    assert_eq!(found(b"x"), "1 byte, too short for an image");
    assert_eq!(
        found(b"<?xml version=\"1.0\"?>\n<svg xmlns=\"http://www.w3.org/2000/svg\"/>"),
        "SVG"
    );
    assert_eq!(found(b"<!doctype html><p>"), "XML or HTML");
    assert_eq!(
        found(b"RIFF\0\0\0\0WAVEfmt "),
        "an unknown format that begins with 52 49 46 46"
    );
}

/// Invalid profiles.
fn not_profiles() -> Vec<(&'static str, Vec<u8>)> {
    let changed = |at: usize, bytes: &[u8]| {
        let mut profile = made::profile(500);
        profile[at..at + bytes.len()].copy_from_slice(bytes);
        profile
    };
    vec![
        ("a longer size field", changed(0, &501_u32.to_be_bytes())),
        ("a shorter size field", changed(0, &499_u32.to_be_bytes())),
        ("a size field of four billion", changed(0, &[0xFF; 4])),
        ("no signature", changed(36, b"ACSP")),
        ("a grey profile", changed(16, b"GRAY")),
        ("a CMYK profile", changed(16, b"CMYK")),
        ("no whole head", made::profile(500)[..39].to_vec()),
        ("three bytes", vec![0, 0, 3]),
    ]
}

#[test]
fn a_file_without_a_profile_has_none_to_drop() {
    for (name, bytes) in zoo() {
        let decoded = decode(&bytes, &ImageLimits::default()).unwrap();
        assert!(
            !decoded.metadata.profile_dropped() || name.contains("icc") || name.contains("rich"),
            "{name}"
        );
    }
}

/// A colour-managed picture keeps its profile only if the profile describes the decoded samples.
#[test]
fn icc_profile_is_kept_for_rgb_only() {
    let icc = |bytes: &[u8]| {
        let decoded = decode(bytes, &ImageLimits::default()).unwrap();
        let icc = decoded.metadata.icc().map(<[u8]>::to_vec);
        assert_eq!(
            decoded.metadata.profile_dropped(),
            icc.is_none(),
            "a profile is carried over or reported"
        );
        icc
    };
    let profile = made::profile(70_000);
    let mut lab = profile.clone();
    lab[16..20].copy_from_slice(b"Lab ");

    let png = |colour: u8, samples: usize, chunk: Vec<u8>| {
        let mut png = made::Png::new(1, 1, 8, colour, &[1, 2, 3, 4][..samples]);
        png.before.push((*b"iCCP", chunk));
        icc(&png.bytes())
    };
    assert_eq!(png(2, 3, made::iccp(&profile)).as_ref(), Some(&profile));
    assert_eq!(png(6, 4, made::iccp(&profile)).as_ref(), Some(&profile));
    assert_eq!(png(0, 1, made::iccp(&profile)), None);
    assert_eq!(png(4, 2, made::iccp(&profile)), None);
    assert_eq!(png(2, 3, made::iccp(&lab)), None);
    assert_eq!(png(2, 3, made::iccp(&profile[..19])), None);
    assert_eq!(
        png(2, 3, made::iccp(&made::profile(1 << 20))).map(|icc| icc.len()),
        Some(1 << 20)
    );
    assert_eq!(png(2, 3, made::iccp(&made::profile((1 << 20) + 1))), None);
    assert_eq!(
        png(2, 3, made::iccp(&vec![0; 200 << 20])),
        None,
        "an inflating profile is cut, not followed"
    );
    for (what, profile) in not_profiles() {
        assert_eq!(png(2, 3, made::iccp(&profile)), None, "{what}");
    }
    let behind = |blocks: usize| {
        [
            b"name\0\0",
            &bombs::behind_blocks(bombs::EmptyBlock::Stored, blocks, &profile)[..],
        ]
        .concat()
    };
    assert_eq!(png(2, 3, behind(1_000)).as_ref(), Some(&profile));
    assert_eq!(
        png(2, 3, behind(250_000)),
        None,
        "what is inflated is bounded as what comes of it"
    );
    assert_eq!(png(2, 3, b"name\0\0not deflated".to_vec()), None);
    assert_eq!(png(2, 3, b"no end of the name".to_vec()), None);

    let jpeg = |components: usize, parts: &[(u8, u8, &[u8])]| {
        let mut jpeg = made::Jpeg::flat(8, 8, &[(1, 1); 4][..components], &[0; 4][..components]);
        for &(number, count, part) in parts {
            jpeg = jpeg.with_segment(
                0xE2,
                &[b"ICC_PROFILE\0".as_slice(), &[number, count], part].concat(),
            );
        }
        icc(&jpeg.bytes())
    };
    let (first, second) = profile.split_at(60_000);
    assert_eq!(
        jpeg(3, &[(1, 2, first), (2, 2, second)]).as_ref(),
        Some(&profile)
    );
    assert_eq!(
        jpeg(3, &[(2, 2, second), (1, 2, first)]).as_ref(),
        Some(&profile)
    );
    assert_eq!(jpeg(3, &[(1, 2, first)]), None);
    assert_eq!(jpeg(3, &[(1, 2, first), (1, 2, second)]), None);
    assert_eq!(jpeg(1, &[(1, 2, first), (2, 2, second)]), None);
    assert_eq!(jpeg(4, &[(1, 2, first), (2, 2, second)]), None);
    let small = made::profile(500);
    assert_eq!(jpeg(3, &[(1, 1, &small)]).as_ref(), Some(&small));
    for (what, profile) in not_profiles() {
        assert_eq!(jpeg(3, &[(1, 1, &profile)]), None, "{what}");
    }

    let webp = |icc_profile: &[u8]| {
        icc(&made::webp_container(
            &made::webp_lossless(1, 1, Channels::Rgb, &[1, 2, 3]),
            (1, 1),
            &[],
            icc_profile,
        ))
    };
    assert_eq!(webp(&profile).as_ref(), Some(&profile));
    assert_eq!(webp(&lab), None);
    for (what, profile) in not_profiles() {
        assert_eq!(webp(&profile), None, "{what}");
    }
    assert_eq!(webp(&made::profile((1 << 20) + 2)), None);
}
