//! JPEG pixels: flat blocks whose values are known exactly, and photographs against the lenient
//! path of the same decoder.

use super::made::Jpeg;
use super::*;

fn lenient(bytes: &[u8]) -> Vec<u8> {
    image::load_from_memory_with_format(bytes, image::ImageFormat::Jpeg)
        .unwrap()
        .to_rgb8()
        .into_raw()
}

/// The check for completeness does not change a complete picture.
#[test]
fn jpeg_photograph_equals_the_lenient_decoder() {
    let bytes = photograph("rocket.jpg");
    let pixmap = decoded(&bytes);
    assert_eq!(
        (pixmap.extent().width(), pixmap.extent().height()),
        (640, 427)
    );
    assert!(eight(&pixmap) == lenient(&bytes));
}

/// Encoder, sizes around a block, qualities with full and with subsampled colour.
#[test]
fn jpeg_small_pictures_come_back_close() {
    for (width, height) in [(1, 1), (7, 3), (8, 8), (9, 17), (16, 16), (33, 31)] {
        for quality in [60, 95, 100] {
            let rgb: Vec<u8> = (0..width * height)
                .flat_map(|n| [n * 5 / height, 90, 200 - n * 3 / height])
                .map(|v| v as u8)
                .collect();
            let mut bytes = Vec::new();
            let mut encoder =
                image::codecs::jpeg::JpegEncoder::new_with_quality(&mut bytes, quality);
            encoder
                .encode(&rgb, width, height, image::ExtendedColorType::Rgb8)
                .unwrap();
            assert!(
                header_is_kept(&bytes),
                "{width}x{height} quality {quality}: {:?}",
                decode(&bytes, &ImageLimits::default()).err()
            );
            assert_eq!(eight(&decoded(&bytes)), lenient(&bytes));
        }
    }
}

#[test]
fn jpeg_flat_blocks_have_exact_values() {
    let grey = decoded(&Jpeg::letters().bytes());
    assert_eq!(
        (grey.channels(), grey.depth()),
        (Channels::Rgb, Depth::Eight)
    );
    for (index, pixel) in eight(&grey).chunks_exact(3).enumerate() {
        let (x, y) = (index % 24, index / 24);
        assert_eq!(pixel, [b"abcdef"[y / 8 * 3 + x / 8]; 3]);
    }
    // Adobe CMYK is stored inverted: 255 is no ink.
    let adobe = |transform| [b"Adobe".as_slice(), &[0, 100, 0, 0, 0, 0, transform]].concat();
    let cmyk = Jpeg::flat(16, 8, &[(1, 1); 4], &[127, 0, -128, 127]).with_segment(0xEE, &adobe(0));
    assert!(
        eight(&decoded(&cmyk.bytes()))
            .chunks_exact(3)
            .all(|pixel| pixel == [255, 128, 0])
    );
    let rgb = Jpeg::flat(16, 8, &[(1, 1); 3], &[127, 0, -128]).with_segment(0xEE, &adobe(0));
    assert!(
        eight(&decoded(&rgb.bytes()))
            .chunks_exact(3)
            .all(|pixel| pixel == [255, 128, 0])
    );
    let ycck = Jpeg::flat(16, 8, &[(1, 1); 4], &[72, 0, 0, 127]).with_segment(0xEE, &adobe(2));
    assert!(
        eight(&decoded(&ycck.bytes()))
            .chunks_exact(3)
            .all(|pixel| pixel == [55; 3])
    );
}

/// The order in which blocks are sent does not change the picture.
#[test]
fn jpeg_scan_layouts_give_one_picture() {
    for factors in [
        [(1, 1); 3],
        [(2, 1), (1, 1), (1, 1)],
        [(2, 2), (1, 1), (1, 1)],
    ] {
        let jpeg = Jpeg::flat(32, 32, &factors, &[10, -20, 30]);
        let expected = decoded(&jpeg.bytes());
        assert_eq!(
            decoded(&jpeg.clone().progressive().bytes()),
            expected,
            "{factors:?}"
        );
        if factors[0] == (1, 1) {
            assert_eq!(
                decoded(&jpeg.clone().separate().progressive().bytes()),
                expected
            );
        }
        // A segment between the scan and the end.
        let mut commented = jpeg.bytes();
        let end = commented.split_off(commented.len() - 2);
        commented.extend([&[0xFF, 0xFE, 0, 4, 1, 2], end.as_slice()].concat());
        assert_eq!(decoded(&commented), expected, "{factors:?}");
    }
}

#[test]
fn jpeg_orientation_is_applied_once() {
    for (number, width, expected) in UPRIGHT {
        let block = [b"Exif\0\0".as_slice(), &exif(number, false)].concat();
        let bytes = Jpeg::letters().with_segment(0xE1, &block).bytes();
        assert!(header_is_kept(&bytes));
        let pixmap = decoded(&bytes);
        assert_eq!(pixmap.extent().width() as usize, 8 * width, "{number}");
        for (index, pixel) in eight(&pixmap).chunks_exact(3).enumerate() {
            let (x, y) = (index % (8 * width), index / (8 * width));
            assert_eq!(
                pixel,
                [expected[y / 8 * width + x / 8]; 3],
                "{number} at {x},{y}"
            );
        }
    }
    let malformed = Jpeg::letters().with_segment(0xE1, b"Exif\0\0II*\0");
    assert_eq!(
        decoded(&malformed.bytes()),
        decoded(&Jpeg::letters().bytes())
    );
}

/// A single component is never interleaved: its sampling factors have no effect.
#[test]
fn jpeg_grey_ignores_its_sampling_factors() {
    let plain = Jpeg::letters().bytes();
    let factors = plain
        .windows(4)
        .position(|window| window == [1, 1, 0x11, 0])
        .unwrap()
        + 2;
    let mut odd = plain.clone();
    odd[factors] = 0x22;
    assert_eq!(decoded(&odd), decoded(&plain));
}

#[test]
fn jpeg_of_other_processes_is_unsupported() {
    let separate = Jpeg::flat(32, 32, &[(1, 1); 3], &[1, 2, 3]).separate();
    assert!(matches!(
        probe(&separate.bytes()),
        Err(CodecError::Unsupported { .. })
    ));
    for sof in [0xC3, 0xC5, 0xC9, 0xCA, 0xCF] {
        let mut jpeg = Jpeg::letters();
        jpeg.sof = sof;
        assert!(
            matches!(probe(&jpeg.bytes()), Err(CodecError::Unsupported { .. })),
            "{sof:x}"
        );
    }
}

#[test]
fn jpeg_without_area_is_bad() {
    for size in [(0, 8), (8, 0), (0, 0)] {
        let mut jpeg = Jpeg::letters();
        jpeg.size = size;
        assert!(
            matches!(probe(&jpeg.bytes()), Err(CodecError::Bad { .. })),
            "{size:?}"
        );
    }
}

/// A truncated scan in a complete file: the decoder alone would fill the rest with grey.
#[test]
fn jpeg_scans_that_end_early_are_bad() {
    let photo = photograph("rocket.jpg");
    for part in 1..16 {
        let mut bytes = photo[..photo.len() * part / 16].to_vec();
        while bytes.last() == Some(&0xFF) {
            bytes.pop();
        }
        bytes.extend([0xFF, 0xD9]);
        assert!(
            matches!(
                decode(&bytes, &ImageLimits::default()),
                Err(CodecError::Bad { .. })
            ),
            "{part}/16"
        );
    }
    let whole = Jpeg::flat(64, 64, &[(1, 1); 3], &[10, -20, 30]);
    let bytes = whole.bytes();
    let scan = bytes
        .windows(2)
        .rposition(|pair| pair == [0xFF, 0xDA])
        .unwrap()
        + 14;
    for end in scan..bytes.len() - 3 {
        let cut = [&bytes[..end], &[0xFF, 0xD9]].concat();
        assert!(
            matches!(
                decode(&cut, &ImageLimits::default()),
                Err(CodecError::Bad { .. })
            ),
            "{end} of {}",
            bytes.len()
        );
    }
}
