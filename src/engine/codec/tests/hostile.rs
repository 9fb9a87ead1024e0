//! Files that are truncated, damaged, or made to cost more than their size suggests.

use super::made::{Jpeg, Png, riff, vp8, vp8x, webp_lossless};
use super::*;

const NO_LIMITS: ImageLimits = ImageLimits {
    max_pixels: u64::MAX,
    max_side: u32::MAX,
};

/// A truncated file is refused, or it has every pixel and says that it was mended.
fn is_whole_or_refused(name: &str, bytes: &[u8], length: usize, whole: &Pixmap) -> bool {
    match decode(&bytes[..length], &ImageLimits::default()) {
        Ok(Decoded {
            pixmap, repairs, ..
        }) => {
            assert!(
                repairs.end,
                "{name}: {length} of {} bytes are no whole file",
                bytes.len()
            );
            assert!(
                pixmap == *whole,
                "{name}: {length} of {} bytes give another picture",
                bytes.len()
            );
            true
        }
        Err(CodecError::Bad { .. } | CodecError::Unsupported { .. }) => false,
        Err(error) => panic!("{name}: {length} bytes: {error}"),
    }
}

#[test]
fn truncated_small_files_are_whole_or_refused_at_every_length() {
    for (name, bytes) in zoo() {
        let whole = decoded(&bytes);
        let mut read = 0;
        for length in 0..bytes.len() {
            read += usize::from(is_whole_or_refused(name, &bytes, length, &whole));
            let cut = &bytes[..length];
            let unrecognised = matches!(
                decode(cut, &ImageLimits::default()),
                Err(CodecError::Unsupported { .. })
            );
            assert_eq!(
                unrecognised,
                SourceFormat::of(cut).is_err(),
                "{name}: {length} bytes"
            );
        }
        println!("{name}: {read} of {} lengths are read", bytes.len());
        assert!(
            read > 0
                || !name.starts_with("png")
                    && !name.starts_with("jpeg")
                    && !name.starts_with("gif"),
            "{name}"
        );
        assert!(read < bytes.len() / 2, "{name}");
    }
}

#[test]
fn truncated_photographs_are_whole_or_refused() {
    let chelsea = photograph("chelsea.png");
    let source = decoded(&chelsea);
    let webp = webp_lossless(
        source.extent().width(),
        source.extent().height(),
        Channels::Rgb,
        eight(&source),
    );
    for (name, bytes) in [
        ("png", chelsea),
        ("jpeg", photograph("rocket.jpg")),
        ("webp", webp),
    ] {
        let whole = decoded(&bytes);
        for length in (0..60).map(|n| bytes.len() * n / 60) {
            assert!(
                !is_whole_or_refused(name, &bytes, length, &whole),
                "{name}: {length} of {} bytes",
                bytes.len()
            );
        }
        (bytes.len() - 20..bytes.len()).for_each(|length| {
            is_whole_or_refused(name, &bytes, length, &whole);
        });
    }
}

/// Panics of a decoder are caught, and a damaged file that still decodes matches its header.
#[test]
fn random_byte_flips_never_panic() {
    let mut state = 0x2545_F491_4F6C_DD1D_u64;
    let mut random = move |below: usize| {
        state ^= state << 13;
        state ^= state >> 7;
        state ^= state << 17;
        (state >> 16) as usize % below
    };
    let mut read = 0;
    for (name, bytes) in zoo() {
        for _ in 0..500 {
            let mut damaged = bytes.clone();
            for _ in 0..=random(4) {
                let at = random(damaged.len());
                damaged[at] = random(256) as u8;
            }
            if name.starts_with("png") {
                mend_checksums(&mut damaged);
            }
            read += usize::from(header_is_kept(&damaged));
        }
    }
    assert!(
        read > 500,
        "only {read} damaged files were still read: the flips do not reach the pixels"
    );
}

/// Without corrected checksums, damage to a PNG would never get past them.
fn mend_checksums(bytes: &mut [u8]) {
    let mut at = 8;
    while let Some(head) = bytes.get(at..at + 4) {
        let end = at + 8 + u32::from_be_bytes(head.try_into().unwrap()) as usize;
        if bytes.len() < end + 4 {
            break;
        }
        let crc = crc32fast::hash(&bytes[at + 4..end]);
        bytes[end..end + 4].copy_from_slice(&crc.to_be_bytes());
        at = end + 4;
    }
}

fn png_of(width: u32, height: u32) -> Vec<u8> {
    let mut png = Png::new(3, 2, 8, 6, &[1; 24]);
    png.ihdr[..4].copy_from_slice(&width.to_be_bytes());
    png.ihdr[4..8].copy_from_slice(&height.to_be_bytes());
    png.bytes()
}

fn jpeg_of(width: u16, height: u16, progressive: bool) -> Vec<u8> {
    let mut jpeg = Jpeg::letters();
    jpeg.size = (width, height);
    if progressive {
        jpeg.progressive().bytes()
    } else {
        jpeg.bytes()
    }
}

fn canvas_of(width: u32, height: u32) -> Vec<u8> {
    riff(&[
        (b"VP8X", &vp8x(0, (width, height))),
        (b"VP8 ", &vp8(16, 16)),
    ])
}

/// Small files that claim to be large.
pub(super) fn claims() -> Vec<(&'static str, Vec<u8>)> {
    vec![
        ("png of 60000", png_of(60_000, 60_000)),
        ("png of the limits", png_of(16_384, 3_000)),
        ("png of four billion", png_of(u32::MAX, u32::MAX)),
        ("jpeg of 60000", jpeg_of(60_000, 60_000, false)),
        ("jpeg of the limits", jpeg_of(16_384, 3_000, false)),
        ("jpeg of 60000, progressive", jpeg_of(60_000, 60_000, true)),
        (
            "jpeg of the limits, progressive",
            jpeg_of(16_384, 3_000, true),
        ),
        ("webp of 60000", canvas_of(60_000, 60_000)),
        (
            "webp, solid",
            riff(&[(b"VP8L", &[0x2F, 0xFF, 0xFF, 0xFF, 0x0F, 0, 0, 0])]),
        ),
    ]
}

#[test]
fn bombs_are_refused_by_their_header() {
    let (png, jpeg, webp) = (png_of, jpeg_of, canvas_of);

    let side = CodecError::TooLarge {
        what: "image_side",
        limit: 16_384,
        actual: 60_000,
    };
    for bytes in [
        png(60_000, 60_000),
        jpeg(60_000, 60_000, false),
        jpeg(60_000, 60_000, true),
    ] {
        assert_eq!(decode(&bytes, &ImageLimits::default()).unwrap_err(), side);
        // Even without limits the data is checked before memory is allocated.
        assert!(matches!(
            decode(&bytes, &NO_LIMITS),
            Err(CodecError::Bad { .. })
        ));
    }
    // A WebP frame is at most 16384 wide, so a larger canvas is invalid.
    assert!(matches!(
        decode(&webp(60_000, 60_000), &ImageLimits::default()),
        Err(CodecError::Bad { .. })
    ));
    let solid = riff(&[(b"VP8L", &[0x2F, 0xFF, 0xFF, 0xFF, 0x0F, 0, 0, 0])]);
    assert_eq!(
        decode(&solid, &ImageLimits::default()).unwrap_err(),
        CodecError::TooLarge {
            what: "image_pixels",
            limit: 50_000_000,
            actual: 1 << 28
        }
    );

    // Within the limits, and empty.
    for bytes in [
        png(16_384, 3_000),
        jpeg(16_384, 3_000, false),
        jpeg(16_384, 3_000, true),
    ] {
        assert!(probe(&bytes).is_ok());
        assert!(matches!(
            decode(&bytes, &ImageLimits::default()),
            Err(CodecError::Bad { .. })
        ));
    }
    let huge = png(u32::MAX, u32::MAX);
    assert_eq!(
        probe(&huge).unwrap().decode_bytes,
        u64::MAX,
        "sizes are computed without overflow"
    );
    assert!(matches!(
        decode(&huge, &NO_LIMITS),
        Err(CodecError::Bad { .. })
    ));
}

/// Callers reserve the predicted memory: it covers the picture, the turned copy, and a progressive
/// picture's coefficients.
#[test]
fn decode_bytes_follow_the_picture() {
    let bytes = |file: Vec<u8>| probe(&file).unwrap().decode_bytes;
    let pixels = 1_024_u64 * 1_024;
    let rgb = vec![0; 3 * 1_024 * 1_024];
    let plain = bytes(Png::new(1_024, 1_024, 8, 2, &rgb).bytes());
    assert!((3 * pixels..4 * pixels).contains(&plain), "{plain}");
    let turned = bytes(
        Png::new(1_024, 1_024, 8, 2, &rgb)
            .with(*b"eXIf", &exif(6, true))
            .bytes(),
    );
    assert!((6 * pixels..8 * pixels).contains(&turned), "{turned}");
    let jpeg = Jpeg::flat(1_024, 1_024, &[(2, 2), (1, 1), (1, 1)], &[1, 2, 3]);
    let baseline = bytes(jpeg.bytes());
    assert!((3 * pixels..4 * pixels).contains(&baseline), "{baseline}");
    let progressive = bytes(jpeg.progressive().bytes());
    assert!(
        (6 * pixels..7 * pixels).contains(&progressive),
        "{progressive}"
    );
}
