//! Every shape, compression and level is decoded by two decoders that share no code, walked chunk
//! by chunk, and inflated by a third.

use std::io::Read;

use proptest::prelude::*;

use super::*;
use crate::pixmap::{Channels, Depth, Extent};

const ALL: [Compression; 3] = [Compression::None, Compression::Fast, Compression::Best];

const KINDS: [(Channels, Depth); 4] = [
    (Channels::Rgb, Depth::Eight),
    (Channels::Rgba, Depth::Eight),
    (Channels::Rgb, Depth::Sixteen),
    (Channels::Rgba, Depth::Sixteen),
];

#[derive(Clone, Copy, Debug, PartialEq)]
enum Content {
    Flat(u8),
    Noise,
    Gradient,
    Photo,
    Drawing,
}

const CONTENTS: [Content; 6] = [
    Content::Flat(0),
    Content::Flat(0xff),
    Content::Noise,
    Content::Gradient,
    Content::Photo,
    Content::Drawing,
];

fn shape(width: u32, height: u32, (channels, depth): (Channels, Depth)) -> PixelLayout {
    PixelLayout {
        extent: Extent::new(width, height).unwrap(),
        channels,
        grey: false,
        depth,
    }
}

fn noise(seed: u32) -> u32 {
    let mut x = seed.wrapping_mul(0x9e37_79b9) ^ 0x5bd1_e995;
    for _ in 0..2 {
        x = (x ^ (x >> 15)).wrapping_mul(0x2c1b_3c6d);
        x ^= x >> 12;
    }
    x
}

/// Samples `[height][width][channels]` in PNG order.
fn picture(shape: PixelLayout, content: Content) -> Vec<u8> {
    let (width, channels) = (shape.extent.width(), shape.channels.count());
    let mut samples = Vec::new();
    for pixel in 0..u32::try_from(shape.extent.pixels()).unwrap() {
        let (x, y) = (pixel % width, pixel / width);
        for channel in 0..channels as u32 {
            let value = match content {
                Content::Flat(value) => u32::from(value) * 257,
                Content::Noise => noise(pixel * 4 + channel) >> 16,
                Content::Gradient => (x * 211 + y * 97 + channel * 5000) & 0xffff,
                Content::Photo if channel == 3 => 0xffff,
                Content::Photo => {
                    let wave = (f64::from(x) * 0.07).sin()
                        + (f64::from(y) * 0.05 + f64::from(channel)).cos();
                    (32_768.0 + 12_000.0 * wave) as u32 + (noise(pixel * 4 + channel) >> 21)
                }
                Content::Drawing => {
                    u32::from((x / 40 + y / 25).is_multiple_of(3) || x % 64 == y % 64) * 0xabcd
                }
            } as u16;
            match shape.depth {
                Depth::Eight => samples.push(value.to_be_bytes()[0]),
                Depth::Sixteen => samples.extend_from_slice(&value.to_be_bytes()),
            }
        }
    }
    samples
}

fn row_bytes(shape: PixelLayout) -> usize {
    shape.extent.width() as usize * shape.channels.count() * shape.depth.bytes()
}

fn samples_of<'a>(
    writer: &PngWriter,
    shape: PixelLayout,
    samples: &'a [u8],
    strip: usize,
) -> &'a [u8] {
    let rows = writer.rows(strip);
    &samples[rows.start as usize * row_bytes(shape)..rows.end as usize * row_bytes(shape)]
}

fn file(writer: &PngWriter, shape: PixelLayout, samples: &[u8]) -> Vec<u8> {
    let mut bytes = writer.head();
    let checksums: Vec<_> = (0..writer.strips())
        .map(|k| writer.strip_into(k, samples_of(writer, shape, samples, k), &mut bytes))
        .collect();
    bytes.extend_from_slice(&writer.tail(&checksums));
    bytes
}

fn by_png(bytes: &[u8]) -> Vec<u8> {
    let mut options = png::DecodeOptions::default();
    options.set_ignore_adler32(false);
    options.set_ignore_crc(false);
    let mut decoder = png::Decoder::new_with_options(std::io::Cursor::new(bytes), options);
    decoder.set_transformations(png::Transformations::IDENTITY);
    let mut reader = decoder.read_info().unwrap();
    let mut samples = vec![0; reader.output_buffer_size().unwrap()];
    let info = reader.next_frame(&mut samples).unwrap();
    reader.finish().unwrap();
    samples.truncate(info.buffer_size());
    samples
}

fn by_zune(bytes: &[u8], depth: Depth) -> Vec<u8> {
    use zune_png::zune_core::bytestream::ZCursor;
    use zune_png::zune_core::options::DecoderOptions;
    use zune_png::zune_core::result::DecodingResult;
    let options = DecoderOptions::default()
        .set_strict_mode(true)
        .png_set_confirm_crc(true)
        .inflate_set_confirm_adler(true)
        .set_max_width(usize::MAX)
        .set_max_height(usize::MAX);
    let mut decoder = zune_png::PngDecoder::new_with_options(ZCursor::new(bytes), options);
    match (decoder.decode().unwrap(), depth) {
        (DecodingResult::U8(samples), Depth::Eight) => samples,
        (DecodingResult::U16(samples), Depth::Sixteen) => {
            samples.into_iter().flat_map(u16::to_be_bytes).collect()
        }
        _ => panic!("another depth"),
    }
}

/// Chunks in file order after checking signature, lengths, checksums, and that nothing follows
/// IEND.
fn chunks(bytes: &[u8]) -> Vec<([u8; 4], &[u8])> {
    let mut rest = bytes.strip_prefix(&chunk::SIGNATURE).expect("a signature");
    let mut chunks = Vec::new();
    while !rest.is_empty() {
        let length = u32::from_be_bytes(rest[..4].try_into().unwrap()) as usize;
        let kind: [u8; 4] = rest[4..8].try_into().unwrap();
        let crc = u32::from_be_bytes(rest[8 + length..12 + length].try_into().unwrap());
        assert_eq!(crc, crc32fast::hash(&rest[4..8 + length]), "{kind:?}");
        chunks.push((kind, &rest[8..8 + length]));
        rest = &rest[12 + length..];
    }
    assert_eq!(
        chunks.iter().position(|chunk| &chunk.0 == b"IEND"),
        Some(chunks.len() - 1),
        "IEND once and last"
    );
    assert!(chunks[chunks.len() - 1].1.is_empty());
    chunks
}

/// The zlib stream of all IDAT chunks, inflated with its checksum, all of it consumed.
fn inflate(bytes: &[u8]) -> Vec<u8> {
    let stream: Vec<u8> = chunks(bytes)
        .into_iter()
        .filter(|chunk| &chunk.0 == b"IDAT")
        .flat_map(|chunk| chunk.1.to_vec())
        .collect();
    let mut decoder = flate2::read::ZlibDecoder::new(&stream[..]);
    let mut rows = Vec::new();
    decoder.read_to_end(&mut rows).unwrap();
    assert_eq!(
        decoder.total_in(),
        stream.len() as u64,
        "nothing follows the stream"
    );
    rows
}

fn check(shape: PixelLayout, samples: &[u8], compression: Compression) -> usize {
    let writer = PngWriter::new(shape, compression, None);
    let bytes = file(&writer, shape, samples);
    let what = format!("{shape:?}, {compression:?}");
    assert!(
        bytes.len() as u64 <= writer.max_bytes(),
        "{what}: {} > {}",
        bytes.len(),
        writer.max_bytes()
    );
    let kinds: Vec<_> = chunks(&bytes).into_iter().map(|chunk| chunk.0).collect();
    assert_eq!(kinds[0], *b"IHDR");
    assert_eq!(kinds.len(), 1 + writer.strips() + 2);
    assert!(kinds[1..kinds.len() - 1].iter().all(|kind| kind == b"IDAT"));
    assert_eq!(
        inflate(&bytes).len(),
        samples.len() + shape.extent.height() as usize,
        "{what}"
    );
    assert!(by_png(&bytes) == samples, "{what}: png");
    assert!(by_zune(&bytes, shape.depth) == samples, "{what}: zune-png");
    for &level in SimdLevel::available() {
        assert!(
            file(&writer.clone().with_level(level), shape, samples) == bytes,
            "{what}: {level:?}"
        );
    }
    bytes.len()
}

/// Height at which a picture of this width has two strips for the first time.
fn just_over_a_strip(width: u32, kind: (Channels, Depth), compression: Compression) -> u32 {
    (1..)
        .find(|&height| PngWriter::new(shape(width, height, kind), compression, None).strips() > 1)
        .unwrap()
}

#[test]
fn every_shape_decodes_to_its_samples() {
    for kind in KINDS {
        for (width, height) in [(1, 1), (1, 37), (37, 1), (3, 5), (2, 2), (257, 259)] {
            for content in CONTENTS {
                let shape = shape(width, height, kind);
                let samples = picture(shape, content);
                for compression in ALL {
                    check(shape, &samples, compression);
                }
            }
        }
    }
}

#[test]
fn wide_rows_and_strip_boundaries_decode_to_their_samples() {
    for kind in KINDS {
        for compression in ALL {
            let height = just_over_a_strip(331, kind, compression);
            for (width, height) in [
                (331, height - 1),
                (331, height),
                (16_384, 1),
                (16_384, 3),
                (1, 70_000),
            ] {
                for content in [Content::Photo, Content::Noise] {
                    let shape = shape(width, height, kind);
                    check(shape, &picture(shape, content), compression);
                }
            }
        }
    }
}

#[test]
fn runs_of_every_length_survive() {
    // Rows that are flat after a first pixel, of every width around the longest match and the
    // piece.
    for width in (1..40).chain(80..100).chain(1020..1040) {
        let shape = shape(width, 9, KINDS[1]);
        let mut samples = vec![7; row_bytes(shape) * 9];
        for k in (0..samples.len()).step_by(389) {
            samples[k] = 200;
        }
        check(shape, &samples, Compression::Fast);
    }
}

#[test]
fn rows_unlike_the_sampled_ones_can_be_written() {
    // One row in thirteen is noise and the others are flat: most bytes are never sampled, some rows
    // always are.
    for period in [2, 7, 13, 100] {
        let shape = shape(400, 300, KINDS[0]);
        let mut samples = picture(shape, Content::Noise);
        for (y, row) in samples.chunks_exact_mut(1200).enumerate() {
            if y % period != 1 {
                row.fill(90);
            }
        }
        check(shape, &samples, Compression::Fast);
    }
}

#[test]
fn noise_grows_by_no_more_than_the_stored_form() {
    for kind in KINDS {
        let shape = shape(500, 300, kind);
        let samples = picture(shape, Content::Noise);
        let stored = check(shape, &samples, Compression::None);
        for compression in [Compression::Fast, Compression::Best] {
            assert!(check(shape, &samples, compression) <= stored);
        }
        let writer = PngWriter::new(shape, Compression::None, None);
        assert!(
            writer.max_bytes() - stored as u64 <= 8,
            "the bound of a stored picture is tight"
        );
    }
}

#[test]
fn strips_in_any_order_give_the_same_bytes() {
    for compression in ALL {
        let shape = shape(640, 900, KINDS[1]);
        let samples = picture(shape, Content::Photo);
        let writer = PngWriter::new(shape, compression, None);
        assert!(writer.strips() >= 2);
        let mut strips: Vec<_> = (0..writer.strips())
            .rev()
            .map(|k| writer.strip(k, samples_of(&writer, shape, &samples, k)))
            .collect();
        strips.reverse();
        let mut bytes = writer.head();
        bytes.extend(strips.iter().flat_map(|strip| strip.bytes.clone()));
        let checksums: Vec<_> = strips
            .iter()
            .map(|strip| (strip.adler, strip.filtered_len))
            .collect();
        bytes.extend(writer.tail(&checksums));
        assert!(bytes == file(&writer, shape, &samples), "{compression:?}");
        let filtered: u64 = strips.iter().map(|strip| strip.filtered_len).sum();
        assert_eq!(filtered, samples.len() as u64 + 900);
    }
}

#[test]
fn profile_travels_in_the_head_and_nothing_else_does() {
    let profile: Vec<u8> = (0..3000u32).map(|k| (noise(k) >> 28) as u8).collect();
    let shape = shape(5, 4, KINDS[0]);
    let samples = picture(shape, Content::Gradient);
    let writer = PngWriter::new(shape, Compression::Fast, Some(&Carried::of_icc(&profile)));
    let bytes = file(&writer, shape, &samples);
    let kinds: Vec<_> = chunks(&bytes).into_iter().map(|chunk| chunk.0).collect();
    assert_eq!(kinds, [*b"IHDR", *b"iCCP", *b"IDAT", *b"IDAT", *b"IEND"]);
    let reader = png::Decoder::new(std::io::Cursor::new(&bytes))
        .read_info()
        .unwrap();
    assert_eq!(reader.info().icc_profile.as_deref(), Some(&profile[..]));
    assert!(by_png(&bytes) == samples && by_zune(&bytes, Depth::Eight) == samples);
    assert!(bytes.len() as u64 <= writer.max_bytes());
}

#[test]
fn best_is_smaller_than_fast_and_fast_than_none() {
    let photo = image::load_from_memory(include_bytes!("../../../test_files/images/astronaut.png"))
        .unwrap()
        .to_rgba8();
    let shape = shape(photo.width(), photo.height(), KINDS[1]);
    for (samples, factor) in [(photo.into_raw(), 1), (picture(shape, Content::Drawing), 3)] {
        let [none, fast, best] = ALL.map(|compression| check(shape, &samples, compression));
        assert!(best * factor < fast && fast < none, "{none} {fast} {best}");
    }
}

#[test]
fn flat_pictures_are_runs() {
    let shape = shape(1000, 500, KINDS[1]);
    assert!(check(shape, &picture(shape, Content::Flat(0)), Compression::Fast) < 12_000);
}

#[test]
#[should_panic(expected = "samples are the rows of strip 0")]
fn samples_of_another_height_are_refused() {
    let writer = PngWriter::new(shape(4, 4, KINDS[0]), Compression::Fast, None);
    let _ = writer.strip(0, &[0; 24]);
}

proptest! {
    #![proptest_config(ProptestConfig { cases: 96, failure_persistence: None,
        ..ProptestConfig::default() })]

    #[test]
    fn random_pictures_decode_to_their_samples(
        width in 1u32..90, height in 1u32..120, kind in 0usize..4, seed: u32, quiet in 0u32..9,
            holes in 0u32..60, compression in 0usize..3,
    ) {
        let shape = shape(width, height, KINDS[kind]);
        let mut samples: Vec<u8> = (0..row_bytes(shape) as u32 * height).map(
            |k| (noise(seed ^ k) >> (24 + quiet.min(7))) as u8).collect();
        for (k, piece) in samples.chunks_mut(1 + holes as usize * 7).enumerate() {
            if noise(seed.wrapping_add(k as u32)).is_multiple_of(3) {
                piece.fill(seed as u8);
            }
        }
        check(shape, &samples, ALL[compression]);
    }
}
