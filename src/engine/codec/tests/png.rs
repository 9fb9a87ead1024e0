//! PNG pixels: every colour type and depth against values computed here, and photographs against a
//! decoder of other authors.

use zune_png::zune_core::bytestream::ZCursor;
use zune_png::zune_core::result::DecodingResult;

use super::made::{self, Png};
use super::*;

fn independent(bytes: &[u8]) -> DecodingResult {
    zune_png::PngDecoder::new(ZCursor::new(bytes))
        .decode()
        .unwrap()
}

#[test]
fn png_photographs_equal_an_independent_decoder() {
    for (name, channels) in [
        ("chelsea.png", Channels::Rgb),
        ("horse.png", Channels::Rgba),
    ] {
        let bytes = photograph(name);
        let pixmap = decoded(&bytes);
        assert_eq!(pixmap.channels(), channels);
        let DecodingResult::U8(expected) = independent(&bytes) else {
            panic!("8 bit")
        };
        assert!(eight(&pixmap) == expected, "{name}");
    }
}

/// Odd sizes leave passes empty; grey and colour, with and without alpha, both depths.
#[test]
fn png_interlaced_equals_plain_and_the_independent_decoder() {
    for (width, height) in [(1, 1), (1, 9), (2, 3), (5, 5), (8, 8), (9, 1), (17, 13)] {
        for (colour, samples) in [(0_u8, 1_u32), (2, 3), (4, 2), (6, 4)] {
            for bits in [8_u8, 16] {
                let length = width * height * samples * u32::from(bits) / 8;
                let packed: Vec<u8> = (0..length).map(|n| (n * 37 + n / 7 + 11) as u8).collect();
                let plain = decoded(&Png::new(width, height, bits, colour, &packed).bytes());
                let interlaced = Png::interlaced(width, height, bits, colour, &packed).bytes();
                assert_eq!(
                    decoded(&interlaced),
                    plain,
                    "{width}x{height} colour {colour} bits {bits}"
                );
                if matches!(colour, 2 | 6) {
                    match independent(&interlaced) {
                        DecodingResult::U8(expected) => assert_eq!(eight(&plain), expected),
                        DecodingResult::U16(expected) => assert_eq!(sixteen(&plain), expected),
                        _ => panic!("integers"),
                    }
                }
            }
        }
    }
}

#[test]
fn png_grey_becomes_rgb() {
    let pixmap = decoded(&Png::new(3, 1, 8, 0, &[0, 77, 255]).bytes());
    assert_eq!(
        (pixmap.channels(), pixmap.depth()),
        (Channels::Rgb, Depth::Eight)
    );
    assert_eq!(eight(&pixmap), [0, 0, 0, 77, 77, 77, 255, 255, 255]);
    let pixmap = decoded(&Png::new(2, 1, 16, 0, &[0x12, 0x34, 0xFF, 0xFE]).bytes());
    assert_eq!(
        (pixmap.channels(), pixmap.depth()),
        (Channels::Rgb, Depth::Sixteen)
    );
    assert_eq!(
        sixteen(&pixmap),
        [0x1234, 0x1234, 0x1234, 0xFFFE, 0xFFFE, 0xFFFE]
    );
}

#[test]
fn png_grey_of_few_bits_is_stretched_to_the_full_range() {
    for (bits, packed, expected) in [
        (1, &[0b0101_1000_u8][..], [0_u8, 255, 0, 255, 255]),
        (2, &[0b0001_1011, 0b0100_0000], [0, 85, 170, 255, 85]),
        (4, &[0x01, 0x8F, 0x70], [0, 17, 136, 255, 119]),
    ] {
        let pixmap = decoded(&Png::new(5, 1, bits, 0, packed).bytes());
        assert_eq!(
            eight(&pixmap),
            expected.map(|grey| [grey; 3]).as_flattened(),
            "{bits} bits"
        );
    }
}

#[test]
fn png_alpha_is_kept_straight() {
    let pixmap = decoded(&Png::new(2, 1, 8, 4, &[50, 0, 60, 128]).bytes());
    assert_eq!(pixmap.channels(), Channels::Rgba);
    assert_eq!(eight(&pixmap), [50, 50, 50, 0, 60, 60, 60, 128]);
    let pixmap = decoded(
        &Png::new(
            1,
            2,
            16,
            6,
            &[1, 2, 3, 4, 5, 6, 0, 0, 9, 8, 7, 6, 5, 4, 0x80, 1],
        )
        .bytes(),
    );
    assert_eq!(
        sixteen(&pixmap),
        [0x0102, 0x0304, 0x0506, 0, 0x0908, 0x0706, 0x0504, 0x8001]
    );
}

#[test]
fn png_palettes_are_expanded() {
    let palette = [10, 11, 12, 20, 21, 22, 30, 31, 32, 40, 41, 42];
    for (bits, packed) in [
        (2, &[0b1101_1000_u8][..]),
        (4, &[0x31, 0x20]),
        (8, &[3, 1, 2, 0]),
    ] {
        let plain = Png::new(4, 1, bits, 3, packed).with(*b"PLTE", &palette);
        let pixmap = decoded(&plain.bytes());
        assert_eq!(pixmap.channels(), Channels::Rgb);
        assert_eq!(
            eight(&pixmap),
            [40, 41, 42, 20, 21, 22, 30, 31, 32, 10, 11, 12],
            "{bits} bits"
        );
        let pixmap = decoded(&plain.with(*b"tRNS", &[0, 100]).bytes());
        assert_eq!(
            eight(&pixmap),
            [
                40, 41, 42, 255, 20, 21, 22, 100, 30, 31, 32, 255, 10, 11, 12, 0
            ],
            "{bits} bits"
        );
    }
}

#[test]
fn png_colour_keys_become_alpha() {
    let grey = Png::new(2, 1, 8, 0, &[7, 8]).with(*b"tRNS", &[0, 8]);
    assert_eq!(eight(&decoded(&grey.bytes())), [7, 7, 7, 255, 8, 8, 8, 0]);
    let few = Png::new(3, 1, 2, 0, &[0b0110_1100]).with(*b"tRNS", &[0, 2]);
    assert_eq!(
        eight(&decoded(&few.bytes())),
        [85, 85, 85, 255, 170, 170, 170, 0, 255, 255, 255, 255]
    );
    let rgb = Png::new(2, 1, 8, 2, &[1, 2, 3, 1, 2, 4]).with(*b"tRNS", &[0, 1, 0, 2, 0, 3]);
    assert_eq!(eight(&decoded(&rgb.bytes())), [1, 2, 3, 0, 1, 2, 4, 255]);
    // Both bytes count: 0x0102 is the key, 0x0103 is not.
    let deep = Png::new(2, 1, 16, 0, &[1, 2, 1, 3]).with(*b"tRNS", &[1, 2]);
    assert_eq!(
        sixteen(&decoded(&deep.bytes())),
        [0x102, 0x102, 0x102, 0, 0x103, 0x103, 0x103, u16::MAX]
    );
}

/// A tRNS that the decoder drops as malformed does not change the header's channels.
#[test]
fn png_with_a_malformed_colour_key_is_opaque_rgba() {
    let bytes = Png::new(1, 1, 8, 2, &[1, 2, 3])
        .with(*b"tRNS", &[9])
        .bytes();
    assert!(header_is_kept(&bytes));
    assert_eq!(eight(&decoded(&bytes)), [1, 2, 3, 255]);
}

#[test]
fn png_orientation_is_applied_once() {
    for (number, width, expected) in UPRIGHT {
        let rgb: Vec<u8> = b"abcdef"
            .iter()
            .flat_map(|&letter| [letter, letter + 1, letter + 2])
            .collect();
        let upright: Vec<u8> = expected
            .iter()
            .flat_map(|&letter| [letter, letter + 1, letter + 2])
            .collect();
        let eight_bit = Png::new(3, 2, 8, 2, &rgb).with(*b"eXIf", &exif(number, true));
        let mut late = Png::new(3, 2, 8, 2, &rgb);
        late.after.push((*b"eXIf", exif(number, false)));
        for bytes in [eight_bit.bytes(), late.bytes()] {
            assert!(header_is_kept(&bytes));
            let pixmap = decoded(&bytes);
            assert_eq!(
                (pixmap.extent().width() as usize, eight(&pixmap)),
                (width, &upright[..]),
                "{number}"
            );
        }
        let deep: Vec<u8> = b"abcdef"
            .iter()
            .flat_map(|&letter| [1, letter, 0, 5])
            .collect();
        let pixmap = decoded(
            &Png::new(3, 2, 16, 4, &deep)
                .with(*b"eXIf", &exif(number, true))
                .bytes(),
        );
        let upright: Vec<u16> = expected
            .iter()
            .flat_map(|&letter| [[256 + u16::from(letter); 3].as_slice(), &[5]].concat())
            .collect();
        assert_eq!(sixteen(&pixmap), upright, "{number}");
    }
    let malformed = Png::new(3, 1, 8, 0, b"abc").with(*b"eXIf", b"MM\0*\xFF\xFF\xFF\xFF");
    assert_eq!(decoded(&malformed.bytes()).extent().width(), 3);
}

#[test]
fn png_animations_are_refused_and_single_frames_read() {
    let control = |frames: u32| [frames.to_be_bytes(), 0_u32.to_be_bytes()].concat();
    let still = Png::new(3, 2, 8, 0, b"abcdef");
    let animated = still.clone().with(*b"acTL", &control(7)).bytes();
    assert_eq!(
        probe(&animated).unwrap_err(),
        CodecError::TooLarge {
            what: "image_frames",
            limit: 1,
            actual: 7
        }
    );
    // The frame has another size than the picture.
    let mut frame = [0; 26];
    (frame[7], frame[11]) = (1, 1);
    let single = still
        .clone()
        .with(*b"acTL", &control(1))
        .with(*b"fcTL", &frame)
        .bytes();
    assert_eq!(decoded(&single), decoded(&still.bytes()));
}

#[test]
fn png_damage_is_an_error_or_in_no_pixel() {
    let png = Png::new(3, 2, 8, 0, b"abcdef")
        .with(*b"tEXt", b"Title\0here")
        .with(*b"pHYs", &[0; 9]);
    let good = png.with(*b"tRNS", &[0, b'c']).bytes();
    let whole = decoded(&good);
    let (mut mended, mut refused) = (0, 0);
    for at in 8..good.len() {
        for bit in 0..8 {
            let mut damaged = good.clone();
            damaged[at] ^= 1 << bit;
            match decode(&damaged, &ImageLimits::default()) {
                Ok(Decoded {
                    pixmap, repairs, ..
                }) => {
                    assert!(
                        pixmap == whole && (repairs.checksum || repairs.end),
                        "byte {at}"
                    );
                    mended += 1;
                }
                Err(error) => {
                    let said = error.to_string();
                    assert!(
                        !said.contains("ChunkType") && !said.contains("Some("),
                        "{said}"
                    );
                    refused += 1;
                }
            }
        }
    }
    // The text and the resolution take 44 bytes with their frames, the end 12.
    assert!(mended > 8 * 40 && refused > 8 * 40, "{mended} {refused}");
    let mut short = Png::new(3, 2, 8, 0, b"abcdef");
    short.rows.truncate(7);
    assert!(matches!(
        decode(&short.bytes(), &ImageLimits::default()),
        Err(CodecError::Bad { .. })
    ));
    for (width, height) in [(0, 5), (5, 0), (0, 0)] {
        let mut empty = Png::new(3, 2, 8, 0, b"abcdef");
        empty.ihdr[3] = width;
        empty.ihdr[7] = height;
        assert!(matches!(probe(&empty.bytes()), Err(CodecError::Bad { .. })));
    }
    let no_palette = Png::new(4, 1, 8, 3, &[0; 4]).bytes();
    assert!(matches!(
        decode(&no_palette, &ImageLimits::default()),
        Err(CodecError::Bad { .. })
    ));
}

/// The bounds on data allow the worst output of encoders, and little more.
#[test]
fn png_data_is_bounded_by_the_picture() {
    let rows: Vec<u8> = (0..100 * 301_usize)
        .map(|n| {
            if n.is_multiple_of(301) {
                0
            } else {
                ((n * n) >> 3) as u8
            }
        })
        .collect();
    let of = |chunks: Vec<Vec<u8>>| {
        let chunks: Vec<_> = chunks.into_iter().map(|data| (b"IDAT", data)).collect();
        let file = [
            &[(b"IHDR", bombs::ihdr(100, 100))],
            &chunks[..],
            &[(b"IEND", vec![])],
        ]
        .concat();
        decode(&bombs::png(&file), &ImageLimits::default())
    };
    let plain = made::deflate(&rows);
    let pixels = of(vec![plain.clone()]).unwrap().pixmap;
    // Flushed after every row, stored in chunks of 16 bytes, and a chunk for each byte.
    let mut flushed = flate2::write::ZlibEncoder::new(Vec::new(), flate2::Compression::none());
    for row in rows.chunks(301) {
        std::io::Write::write_all(&mut flushed, row).unwrap();
        std::io::Write::flush(&mut flushed).unwrap();
    }
    let flushed = flushed.finish().unwrap();
    let of_sixteen: Vec<Vec<u8>> = flushed.chunks(16).map(<[u8]>::to_vec).collect();
    let small = &bombs::behind_blocks(bombs::EmptyBlock::Stored, 0, &[0; 32 * 97]);
    let singles = small.iter().map(|&byte| (b"IDAT", vec![byte]));
    let single = [
        vec![(b"IHDR", bombs::ihdr(32, 32))],
        singles.collect(),
        vec![(b"IEND", vec![])],
    ]
    .concat();
    assert!(decode(&bombs::png(&single), &ImageLimits::default()).is_ok());
    assert_eq!(of(vec![flushed]).unwrap().pixmap, pixels);
    assert_eq!(of(of_sixteen).unwrap().pixmap, pixels);
    // Twice the rows, 16 bytes for each and 64 KiB: 127,336.
    let behind = |blocks: usize| {
        of(vec![bombs::behind_blocks(
            bombs::EmptyBlock::Stored,
            blocks,
            &rows,
        )])
    };
    assert_eq!(behind(19_000).unwrap().pixmap, pixels);
    let refused = |result: Result<Decoded, CodecError>| {
        assert!(
            matches!(result, Err(CodecError::Bad { .. })),
            "{:?}",
            result.err()
        )
    };
    refused(behind(20_000));
    refused(of([vec![vec![]; 5_000], vec![plain.clone()]].concat()));
    refused(of(vec![[&plain[..], &[0; 130_000]].concat()]));
}

/// Deflated data beyond the last row is discarded without being stored.
#[test]
fn png_data_beyond_the_picture_takes_no_memory() {
    let mut bomb = Png::new(3, 2, 8, 0, b"abcdef");
    bomb.rows.resize(256 << 20, 0);
    let bytes = bomb.bytes();
    if let Ok(Decoded { pixmap, .. }) = decode(&bytes, &ImageLimits::default()) {
        assert_eq!(pixmap, decoded(&Png::new(3, 2, 8, 0, b"abcdef").bytes()));
    }
    assert!(probe(&bytes).unwrap().decode_bytes < 1 << 20);
    let text = Png::new(3, 2, 8, 0, b"abcdef").with(
        *b"zTXt",
        &[b"Title\0\0".as_slice(), &made::deflate(&vec![0; 64 << 20])].concat(),
    );
    assert_eq!(
        decoded(&text.bytes()),
        decoded(&Png::new(3, 2, 8, 0, b"abcdef").bytes())
    );
}
