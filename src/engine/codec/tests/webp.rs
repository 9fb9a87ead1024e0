//! WebP pixels: lossless ones are equal; lossy ones are flat by construction.

use super::made::{self, riff, vp8, vp8x, webp_container, webp_lossless};
use super::*;

#[test]
fn webp_lossless_comes_back_equal() {
    for (name, channels) in [
        ("chelsea.png", Channels::Rgb),
        ("horse.png", Channels::Rgba),
    ] {
        let source = decoded(&photograph(name));
        let bytes = webp_lossless(
            source.extent().width(),
            source.extent().height(),
            channels,
            eight(&source),
        );
        assert!(decoded(&bytes) == source, "{name}");
    }
    // The widest possible picture: its header stores 16383.
    let wide: Vec<u8> = (0..3 * 16_384).map(|n| (n / 64) as u8).collect();
    assert_eq!(
        eight(&decoded(&webp_lossless(16_384, 1, Channels::Rgb, &wide))),
        wide
    );
}

#[test]
fn webp_lossy_is_read_with_and_without_alpha() {
    let opaque = decoded(&made::webp_lossy(20, 17, None));
    assert_eq!(
        (
            opaque.channels(),
            opaque.extent().width(),
            opaque.extent().height()
        ),
        (Channels::Rgb, 20, 17)
    );
    assert!(
        eight(&opaque)
            .iter()
            .all(|&sample| sample.abs_diff(130) < 8),
        "{:?}",
        &eight(&opaque)[..3]
    );
    let alpha: Vec<u8> = (0..20 * 17).map(|n| n as u8).collect();
    let cut_out = decoded(&made::webp_lossy(20, 17, Some(&alpha)));
    assert_eq!(cut_out.channels(), Channels::Rgba);
    assert!(
        eight(&cut_out)
            .chunks_exact(4)
            .map(|pixel| pixel[3])
            .eq(alpha)
    );
    assert!(
        eight(&cut_out)
            .chunks_exact(4)
            .zip(eight(&opaque).chunks_exact(3))
            .all(|(rgba, rgb)| rgba[..3] == *rgb)
    );
}

/// Flags of the canvas are hints: alpha or EXIF promised but absent.
#[test]
fn webp_flags_without_their_chunks_do_no_harm() {
    let bytes = riff(&[(b"VP8X", &vp8x(0x3C, (20, 17))), (b"VP8 ", &vp8(20, 17))]);
    assert_eq!(decoded(&bytes), decoded(&made::webp_lossy(20, 17, None)));
}

#[test]
fn webp_orientation_is_applied_once() {
    let rgba: Vec<u8> = b"abcdef"
        .iter()
        .flat_map(|&letter| [letter, 1, 2, letter])
        .collect();
    for (number, width, expected) in UPRIGHT {
        for block in [
            exif(number, true),
            [b"Exif\0\0".as_slice(), &exif(number, false)].concat(),
        ] {
            let bytes = webp_container(
                &webp_lossless(3, 2, Channels::Rgba, &rgba),
                (3, 2),
                &block,
                &[],
            );
            assert!(header_is_kept(&bytes));
            let pixmap = decoded(&bytes);
            let upright: Vec<u8> = expected
                .iter()
                .flat_map(|&letter| [letter, 1, 2, letter])
                .collect();
            assert_eq!(
                (pixmap.extent().width() as usize, eight(&pixmap)),
                (width, &upright[..]),
                "{number}"
            );
        }
    }
}

#[test]
fn webp_animations_are_refused_and_single_frames_read() {
    let still = webp_lossless(3, 2, Channels::Rgb, b"abcdefghijklmnopqr");
    let picture = &still[12..];
    let frame = |x: u8| [&[x, 0, 0, 0, 0, 0, 2, 0, 0, 1, 0, 0, 9, 0, 0, 0], picture].concat();
    let canvas = vp8x(0x02, (3, 2));
    let animation = |frames: usize, x: u8| {
        let frame = frame(x);
        let mut chunks: Vec<(&[u8; 4], &[u8])> = vec![(b"VP8X", &canvas), (b"ANIM", &[0; 6])];
        chunks.extend(std::iter::repeat_n((b"ANMF", frame.as_slice()), frames));
        riff(&chunks)
    };
    assert_eq!(decoded(&animation(1, 0)), decoded(&still));
    assert_eq!(
        probe(&animation(2, 0)).unwrap_err(),
        CodecError::TooLarge {
            what: "image_frames",
            limit: 1,
            actual: 2
        }
    );
    assert_eq!(
        probe(&animation(5, 0)).unwrap_err(),
        CodecError::TooLarge {
            what: "image_frames",
            limit: 1,
            actual: 5
        }
    );
    assert!(matches!(
        probe(&animation(0, 0)),
        Err(CodecError::Bad { .. })
    ));
    assert!(
        matches!(probe(&animation(1, 1)), Err(CodecError::Bad { .. })),
        "a frame beside the canvas' corner"
    );
}

/// A small canvas must not hide a large frame.
#[test]
fn webp_frames_must_be_of_their_canvas_size() {
    for bytes in [
        riff(&[(b"VP8X", &vp8x(0, (10, 10))), (b"VP8 ", &vp8(10, 11))]),
        riff(&[
            (b"VP8X", &vp8x(0, (10, 10))),
            (b"VP8L", &[0x2F, 0xFF, 0xFF, 0xFF, 0x0F, 0, 0, 0]),
        ]),
        riff(&[(b"VP8X", &vp8x(0, (20, 17)))]),
        riff(&[(b"VP8X", &[0; 9]), (b"VP8 ", &vp8(1, 1))]),
        riff(&[(b"VP8 ", &vp8(0, 5))]),
        riff(&[(b"VP8 ", &vp8(5, 0))]),
        riff(&[]),
    ] {
        assert!(matches!(probe(&bytes), Err(CodecError::Bad { .. })));
    }
}
