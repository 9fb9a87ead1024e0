//! Every size, component and level is decoded; coefficients are held against cosines in `f64`.

use super::coder::{Blocks, CoefficientCodes, NEAR_VALUES, QuantisedBlock};
use super::kernel::Scalar;
use super::lanes::I16Lanes;
use super::strip::{MAX_GROUP_PLANES, MAX_PLANE_BLOCKS, StripPixels, transform};
use super::tables::{BLOCK, SIDE, ZIGZAG, quantisation};
use super::*;
use crate::codec::ImageLimits;
use crate::pixmap::{Channels, Depth, Extent, Samples};

const GROUND: [u8; 3] = [200, 10, 90];

fn noise(seed: u32) -> u8 {
    let mut x = seed.wrapping_mul(0x9e37_79b9) ^ 0x5bd1_e995;
    for _ in 0..2 {
        x = (x ^ (x >> 15)).wrapping_mul(0x2c1b_3c6d);
        x ^= x >> 12;
    }
    (x >> 24).try_into().unwrap()
}

#[derive(Clone, Copy, Debug)]
enum Content {
    Flat(u8),
    Noise,
    /// The two extremes at random.
    Extremes,
    Waves,
}

const CONTENTS: [Content; 5] = [
    Content::Flat(0),
    Content::Flat(255),
    Content::Noise,
    Content::Extremes,
    Content::Waves,
];

/// Samples `[height][width][channels]`.
fn picture(width: u32, height: u32, channels: usize, content: Content) -> Vec<u8> {
    let sample = |k: usize| {
        let (pixel, channel) = (k / channels, k % channels);
        let (x, y) = (pixel % width as usize, pixel / width as usize);
        let k = u32::try_from(k).unwrap();
        match content {
            Content::Flat(value) => value,
            Content::Noise => noise(k),
            Content::Extremes => {
                if noise(k) < 128 {
                    0
                } else {
                    255
                }
            }
            #[expect(
                clippy::cast_possible_truncation,
                clippy::cast_sign_loss,
                reason = "0 to 255"
            )]
            Content::Waves => {
                (127.5
                    + 120.0 * ((x as f64 * 0.11 + channel as f64).sin() * (y as f64 * 0.07).cos()))
                    as u8
            }
        }
    };
    (0..width as usize * height as usize * channels)
        .map(sample)
        .collect()
}

fn shape(width: u32, height: u32, channels: Channels, grey: bool) -> PixelLayout {
    PixelLayout {
        extent: Extent::new(width, height).unwrap(),
        channels,
        grey,
        depth: Depth::Eight,
    }
}

fn file(writer: &JpegWriter, samples: &[u8]) -> Vec<u8> {
    let row = samples.len() / writer.shape.extent.height() as usize;
    let mut file = writer.head().to_vec();
    for strip in 0..writer.strips() {
        let rows = writer.rows(strip);
        writer.strip_into(
            strip,
            &samples[rows.start as usize * row..rows.end as usize * row],
            &mut file,
            &|| true,
        );
    }
    file.extend(JpegWriter::tail());
    assert!(file.len() as u64 <= writer.max_bytes());
    assert!((file.len() + samples.len()) as u64 <= writer.work_bytes());
    file
}

fn decoded(file: &[u8]) -> image::RgbImage {
    let read = crate::codec::decode(file, &ImageLimits::default(), &|| false)
        .unwrap()
        .pixmap;
    let Samples::Eight(samples) = read.samples() else {
        panic!("8 bit")
    };
    image::RgbImage::from_raw(
        read.extent().width(),
        read.extent().height(),
        samples.to_vec(),
    )
    .unwrap()
}

#[test]
fn every_size_is_decoded_and_every_level_writes_the_same_bytes() {
    for (width, height) in (1..=40).flat_map(|width| {
        [
            (width, 41 - width),
            (width, width),
            (width, 1),
            (1, width),
            (33, width),
        ]
    }) {
        for (channels, grey) in [
            (Channels::Rgb, false),
            (Channels::Rgba, false),
            (Channels::Rgb, true),
            (Channels::Rgba, true),
        ] {
            for subsampling in [Subsampling::Half, Subsampling::Full] {
                let shape = shape(width, height, channels, grey);
                let content = CONTENTS[(width + height) as usize % 5];
                let samples = picture(width, height, shape.samples(), content);
                let writer = JpegWriter::new(
                    shape,
                    100 - u8::try_from(width).unwrap(),
                    subsampling,
                    GROUND,
                    None,
                );
                let scalar = file(&writer.clone().with_level(SimdLevel::Scalar), &samples);
                let picture = decoded(&scalar);
                assert_eq!(picture.dimensions(), (width, height));
                for level in SimdLevel::available() {
                    assert!(
                        file(&writer.clone().with_level(*level), &samples) == scalar,
                        "{level:?} {width} x {height} {shape:?} {subsampling:?}"
                    );
                }
            }
        }
    }
}

#[test]
fn two_decoders_read_the_same_picture() {
    for (width, height) in [(1, 1), (7, 1), (8, 8), (17, 16), (40, 39), (500, 333)] {
        for (grey, subsampling) in [
            (true, Subsampling::Full),
            (false, Subsampling::Full),
            (false, Subsampling::Half),
        ] {
            for (quality, content) in [
                (1, Content::Noise),
                (85, Content::Waves),
                (100, Content::Noise),
                (100, Content::Extremes),
            ] {
                // They enlarge chrominance of half the resolution in different ways.
                let content = if subsampling == Subsampling::Half {
                    Content::Waves
                } else {
                    content
                };
                let shape = shape(width, height, Channels::Rgb, grey);
                let writer = JpegWriter::new(shape, quality, subsampling, GROUND, None);
                let file = file(&writer, &picture(width, height, shape.samples(), content));
                let mut decoder = jpeg_decoder::Decoder::new(file.as_slice());
                let theirs = decoder.decode().unwrap();
                let channels = if grey { 1 } else { 3 };
                assert_eq!(decoder.info().unwrap().pixel_format.pixel_bytes(), channels);
                let (ours, theirs) = (decoded(&file), theirs.chunks(channels));
                assert_eq!(ours.pixels().len(), theirs.len());
                for (ours, theirs) in ours.pixels().zip(theirs) {
                    let worst = (0..3)
                        .map(|c| ours.0[c].abs_diff(theirs[c % channels]))
                        .max()
                        .unwrap();
                    assert!(
                        worst
                            <= if subsampling == Subsampling::Half {
                                24
                            } else {
                                3
                            },
                        "{worst} {width} x {height} {quality} {content:?}"
                    );
                }
            }
        }
    }
}

#[test]
fn strips_are_whole_rows_of_macroblocks() {
    for (width, height, grey) in [
        (500, 500, false),
        (1920, 1080, false),
        (65_500, 40, false),
        (65_500, 130, true),
        (20, 65_500, false),
        (1, 1, true),
    ] {
        for subsampling in [Subsampling::Half, Subsampling::Full] {
            let writer = JpegWriter::new(
                shape(width, height, Channels::Rgb, grey),
                85,
                subsampling,
                GROUND,
                None,
            );
            let side = writer.components.side();
            let mut next = 0;
            for strip in 0..writer.strips() {
                let rows = writer.rows(strip);
                assert!(
                    rows.start == next
                        && !rows.is_empty()
                        && (rows.end == height || (rows.len()).is_multiple_of(side))
                );
                next = rows.end;
            }
            assert_eq!(next, height);
        }
    }
    assert_eq!(
        JpegWriter::new(
            shape(500, 500, Channels::Rgb, false),
            85,
            Subsampling::Half,
            GROUND,
            None
        )
        .strips(),
        2
    );
}

#[test]
fn several_strips_are_decoded_like_their_rows() {
    let (width, height) = (500, 500);
    let samples = picture(width, height, 3, Content::Waves);
    for subsampling in [Subsampling::Half, Subsampling::Full] {
        let writer = JpegWriter::new(
            shape(width, height, Channels::Rgb, false),
            95,
            subsampling,
            GROUND,
            None,
        );
        let picture = decoded(&file(&writer, &samples));
        let squares: f64 = picture
            .as_raw()
            .iter()
            .zip(&samples)
            .map(|(a, b)| f64::from(a.abs_diff(*b)).powi(2))
            .sum();
        let rms = (squares / samples.len() as f64).sqrt();
        assert!(rms < 1.5, "{rms}");
    }
}

/// Colours in `f64`, less 128, of a pixel.
fn exact(pixel: &[u8]) -> [f64; 3] {
    let colour = |c: usize| {
        let (grey, alpha) = match *pixel {
            [_] => (pixel[0], 255),
            [_, alpha] => (pixel[0], alpha),
            [.., alpha] if pixel.len() == 4 => (pixel[c], alpha),
            _ => (pixel[c], 255),
        };
        ((f64::from(grey) * f64::from(alpha) + f64::from(GROUND[c]) * f64::from(255 - alpha))
            / 255.0)
            .round()
    };
    let [r, g, b] = [0, 1, 2].map(colour);
    if pixel.len() < 3 {
        return [r - 128.0, 0.0, 0.0];
    }
    let luma = 0.299 * r + 0.587 * g + 0.114 * b;
    [luma - 128.0, (b - luma) / 1.772, (r - luma) / 1.402]
}

/// Coefficient (v, u) of a block.
fn cosine(block: &[f64; BLOCK], v: usize, u: usize) -> f64 {
    let wave = |x: usize, u: usize| {
        let norm = if u == 0 { 0.125_f64.sqrt() } else { 0.5 };
        norm * ((2 * x + 1) as f64 * u as f64 * std::f64::consts::PI / 16.0).cos()
    };
    (0..BLOCK)
        .map(|k| block[k] * wave(k / SIDE, v) * wave(k % SIDE, u))
        .sum()
}

/// Every coefficient is the exact one, divided by its step and rounded; the error before rounding
/// is less than 0.3 times a step of 1.
#[test]
fn coefficients_are_the_exact_ones_rounded() {
    let mut worst: f64 = 0.0;
    for (content, quality) in CONTENTS
        .into_iter()
        .flat_map(|content| [1, 30, 85, 97, 100].map(|quality| (content, quality)))
    {
        for channels in 1..=4 {
            let (width, height) = (16, 16);
            let samples = picture(width, height, channels, content);
            let steps = quantisation(quality);
            let quantisers = steps.each_ref().map(Quantiser::new);
            let codes = CoefficientCodes::of_both();
            let job = |components| Job {
                samples: &samples,
                width: 16,
                channels,
                components,
                background: GROUND,
                quantisers: &quantisers,
                codes: &codes,
            };
            let planes: [Vec<f64>; 3] = [0, 1, 2].map(|c| {
                samples
                    .chunks(channels)
                    .map(|pixel| exact(pixel)[c])
                    .collect()
            });
            let block = |plane: usize, x: usize, y: usize, step: usize| -> [f64; BLOCK] {
                std::array::from_fn(|k| {
                    let at = |dx: usize, dy: usize| {
                        planes[plane]
                            [(y + step * (k / SIDE) + dy) * 16 + x + step * (k % SIDE) + dx]
                    };
                    if step == 1 {
                        at(0, 0)
                    } else {
                        (at(0, 0) + at(1, 0) + at(0, 1) + at(1, 1)) / 4.0
                    }
                })
            };
            let mut check = |got: &QuantisedBlock, exact: [f64; BLOCK], table: usize| {
                for (k, place) in ZIGZAG.into_iter().enumerate() {
                    let (v, u) = (usize::from(place) / SIDE, usize::from(place) % SIDE);
                    let step = f64::from(steps[table][usize::from(place)]);
                    let off = (f64::from(got.coefficients[k]) - cosine(&exact, v, u) / step).abs();
                    worst = worst.max((off - 0.5) * step);
                    assert_eq!(got.coefficients[k] != 0, got.nonzero >> k & 1 == 1);
                }
                let is_near =
                    |value: &i16| (-NEAR_VALUES..NEAR_VALUES).contains(&i32::from(*value));
                assert_eq!(got.is_near, got.coefficients[1..].iter().all(is_near));
            };
            let (mut planes, mut blocks) = (
                [[Scalar::all(0); SIDE]; MAX_GROUP_PLANES],
                Blocks::default(),
            );
            macro_rules! with {
                ($components:expr, $top:expr) => {{
                    let (job, pixels) = (
                        job($components),
                        StripPixels::of_group::<Scalar>(&samples, 16 * channels, channels),
                    );
                    match channels {
                        1 => transform::<Scalar, 1>(&job, &pixels, $top, &mut planes, &mut blocks),
                        2 => transform::<Scalar, 2>(&job, &pixels, $top, &mut planes, &mut blocks),
                        3 => transform::<Scalar, 3>(&job, &pixels, $top, &mut planes, &mut blocks),
                        _ => transform::<Scalar, 4>(&job, &pixels, $top, &mut planes, &mut blocks),
                    }
                }};
            }
            if channels < 3 {
                with!(Components::Grey, 8);
                (0..2).for_each(|k| check(&blocks[k], block(0, 8 * k, 8, 1), 0));
                continue;
            }
            with!(Components::Full, 8);
            (0..6).for_each(|k| {
                check(
                    &blocks[k % 3 * MAX_PLANE_BLOCKS + k / 3],
                    block(k % 3, k / 3 * 8, 8, 1),
                    (k % 3).min(1),
                )
            });
            with!(Components::Half, 0);
            (0..4).for_each(|k| {
                check(
                    &blocks[k / 2 * MAX_PLANE_BLOCKS + k % 2],
                    block(0, k % 2 * 8, k / 2 * 8, 1),
                    0,
                )
            });
            (0..2).for_each(|k| check(&blocks[2 * MAX_PLANE_BLOCKS + k], block(1 + k, 0, 0, 2), 1));
        }
    }
    println!("coefficients are at most {worst:.3} beyond half a step");
    assert!(worst < 0.3, "{worst}");
}

#[test]
fn work_ends_when_nobody_wants_the_picture() {
    let writer = JpegWriter::new(
        shape(640, 200, Channels::Rgb, false),
        95,
        Subsampling::Full,
        GROUND,
        None,
    );
    let samples = picture(640, 200, 3, Content::Noise);
    let rows = writer.rows(0).len() * 640 * 3;
    let length = |looks: u32| {
        let (asked, mut out) = (std::cell::Cell::new(0), Vec::new());
        writer.strip_into(0, &samples[..rows], &mut out, &|| {
            asked.replace(asked.get() + 1) < looks
        });
        out.len()
    };
    assert!(length(1) < length(u32::MAX) / 4);
}
