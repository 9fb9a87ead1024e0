//! The longest time for which a decoder does not ask whether its picture is still wanted, on
//! constructed files at the limits on pixels, sides and bytes of a request: the table "Decoder stop
//! times" in deploy/capacity.md. `cargo bench --bench decode`.

#![allow(
    missing_docs,
    unreachable_pub,
    dead_code,
    clippy::print_stdout,
    clippy::unwrap_used,
    clippy::cast_possible_truncation,
    reason = "a program, and the files of a test"
)]

#[path = "../it/support/bombs.rs"]
mod bombs;

use std::cell::Cell;
use std::io::Write as _;
use std::time::{Duration, Instant};

use image::ImageEncoder as _;
use jpeg_encoder::{ColorType, Encoder, SamplingFactor};
use mlswarp::codec::{self, ImageLimits};

use bombs::EmptyBlock;

const WIDTH: u16 = 16_383;
const HEIGHT: u16 = 3_050;
/// How a file is made.
type Made = fn() -> Vec<u8>;
/// A request's body.
const BODY: usize = 32 << 20;

/// RGB with little in it, so that files stay below the limit.
fn waves() -> Vec<u8> {
    let row = |y: usize| {
        (0..usize::from(WIDTH))
            .flat_map(move |x| [(x / 9) as u8, (y / 7) as u8, (x / 31 * (y / 29)) as u8])
    };
    (0..usize::from(HEIGHT)).flat_map(row).collect()
}

fn png(bits: u8, colour: u8, interlaced: bool) -> Vec<u8> {
    let mut head = bombs::ihdr(WIDTH.into(), HEIGHT.into());
    (head[8], head[9], head[12]) = (bits, colour, u8::from(interlaced));
    let samples = if colour == 6 { 4 } else { 3 };
    // More rows than there are: what lies behind the last one is dropped.
    let row = 1 + usize::from(WIDTH) * samples * usize::from(bits) / 8;
    let mut data = flate2::write::ZlibEncoder::new(Vec::new(), flate2::Compression::fast());
    for _ in 0..usize::from(HEIGHT) + 64 {
        data.write_all(&vec![0; row]).expect("memory");
    }
    bombs::png(&[
        (b"IHDR", head),
        (b"IDAT", data.finish().expect("memory")),
        (b"IEND", vec![]),
    ])
}

fn png_of_blocks() -> Vec<u8> {
    let rows = vec![0; 300];
    let data = bombs::behind_blocks(EmptyBlock::Dynamic, BODY / 12, &rows);
    bombs::png(&[
        (b"IHDR", bombs::ihdr(WIDTH.into(), HEIGHT.into())),
        (b"IDAT", data),
        (b"IEND", vec![]),
    ])
}

fn jpeg(progressive: bool, sampling: SamplingFactor) -> Vec<u8> {
    let mut file = Vec::new();
    let mut encoder = Encoder::new(&mut file, 90);
    encoder.set_progressive(progressive);
    encoder.set_sampling_factor(sampling);
    encoder
        .encode(&waves(), WIDTH, HEIGHT, ColorType::Rgb)
        .expect("a picture");
    file
}

fn webp_lossless() -> Vec<u8> {
    let mut file = Vec::new();
    let encoder = image::codecs::webp::WebPEncoder::new_lossless(&mut file);
    encoder
        .write_image(
            &waves(),
            WIDTH.into(),
            HEIGHT.into(),
            image::ExtendedColorType::Rgb8,
        )
        .expect("a picture");
    file
}

/// A key frame whose partitions answer every question with no, under the strongest loop filter.
fn vp8() -> Vec<u8> {
    let first = 500_000_u32;
    let mut frame = ((first << 5) | 1 << 4).to_le_bytes()[..3].to_vec();
    frame.extend([0x9D, 0x01, 0x2A]);
    frame.extend(WIDTH.to_le_bytes());
    frame.extend(HEIGHT.to_le_bytes());
    // Bits of even chances are written as they are: colour space, clamping, segments, the normal
    // filter, level 63, sharpness 0.
    frame.extend([0x0F, 0xC0]);
    frame.resize(frame.len() + first as usize + (8 << 20), 0);
    frame
}

fn webp_lossy(alpha: bool) -> Vec<u8> {
    if !alpha {
        return bombs::riff(&[(b"VP8 ", vp8())]);
    }
    // The stream of a lossless file without its head.
    let stream = bombs::webp_of_one_cached_colour(1, 1).split_off(25);
    bombs::riff(&[
        (b"VP8X", bombs::canvas(0x10, WIDTH, HEIGHT)),
        (b"ALPH", [&[1], &stream[..]].concat()),
        (b"VP8 ", vp8()),
    ])
}

fn main() {
    if !std::env::args().any(|argument| argument == "--bench") {
        return;
    }
    let files: [(&str, Made); 12] = [
        ("PNG, RGB", || png(8, 2, false)),
        ("PNG, RGBA of 16 bits", || png(16, 6, false)),
        ("PNG, RGB, interlaced", || png(8, 2, true)),
        ("PNG of empty blocks", png_of_blocks),
        ("JPEG, baseline 4:2:0", || {
            jpeg(false, SamplingFactor::R_4_2_0)
        }),
        ("JPEG, progressive 4:4:4", || {
            jpeg(true, SamplingFactor::R_4_4_4)
        }),
        ("JPEG, progressive grey, 60 scans", || {
            bombs::jpeg_scans(7_056, 59)
        }),
        ("WebP, lossless", webp_lossless),
        ("WebP, lossless, one colour", || {
            bombs::webp_of_one_cached_colour(WIDTH.into(), HEIGHT.into())
        }),
        ("WebP, lossless, copies", || bombs::webp_of_copies(6_656)),
        ("WebP, lossy", || webp_lossy(false)),
        ("WebP, lossy with alpha", || webp_lossy(true)),
    ];
    println!("| file | bytes | decoding, ms | longest without a question, ms | |");
    println!("|---|---|---|---|---|");
    for (name, make) in files {
        let file = make();
        let (last, longest) = (Cell::new(Instant::now()), Cell::new(Duration::ZERO));
        let asked = || {
            let now = Instant::now();
            longest.set(longest.get().max(now - last.replace(now)));
            false
        };
        let began = Instant::now();
        last.set(began);
        let result = codec::decode(&file, &ImageLimits::default(), &asked);
        asked();
        let took = began.elapsed().as_secs_f64() * 1e3;
        let end = result.map_or_else(|error| error.to_string(), |_| String::new());
        println!(
            "| {name} | {} | {took:.0} | {:.0} | {end} |",
            file.len(),
            longest.get().as_secs_f64() * 1e3
        );
    }
}
