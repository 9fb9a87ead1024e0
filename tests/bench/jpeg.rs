//! JPEG encoding of a photograph (RGB and RGBA, 8 bit) against the crates that do it in Rust, 500 x
//! 500 and 1920 x 1080, one thread, and the strips on two; then bytes and PSNR over qualities.
//! Buffers are reused where an encoder allows it.
//!
//! `cargo bench --bench jpeg [-- FILTER]`; a filter is a part of a table's title.
//! `jpeg --paired DIR` writes the pictures there, `index.json` naming them, and then times `strips`
//! for each case that is asked for (see `harness/paired.rs`); it also writes the files of several
//! qualities.

#![allow(
    missing_docs,
    missing_debug_implementations,
    unreachable_pub,
    clippy::print_stdout,
    clippy::unwrap_used,
    clippy::cast_possible_truncation,
    reason = "a program that prints a table"
)]

#[path = "harness/mod.rs"]
mod harness;

use std::hint::black_box;
use std::path::Path;

use harness::pictures::{FULL_HD, SMALL, bytes, extent, photograph, size, warped};
use harness::{Contender, Goal, Report, contender, inside, paired, pool};
use mlswarp::codec::{JpegWriter, PixelLayout, Subsampling};
use mlswarp::level::SimdLevel;
use mlswarp::pixmap::{Channels, Depth, Extent, Pixmap};
use rayon::prelude::*;

/// The default of the service.
const QUALITY: u8 = 85;
/// What is compared.
const QUALITIES: [u8; 8] = [30, 50, 75, 85, 90, 95, 97, 100];

struct Picture {
    name: String,
    extent: Extent,
    channels: Channels,
    samples: Vec<u8>,
}

impl Picture {
    fn new(name: String, pixmap: &Pixmap) -> Self {
        Self {
            name,
            extent: pixmap.extent(),
            channels: pixmap.channels(),
            samples: bytes(pixmap).to_vec(),
        }
    }

    fn sides(&self) -> (u16, u16) {
        (self.extent.width() as u16, self.extent.height() as u16)
    }

    fn writer(&self, quality: u8, subsampling: Subsampling) -> JpegWriter {
        let shape = PixelLayout {
            extent: self.extent,
            channels: self.channels,
            grey: false,
            depth: Depth::Eight,
        };
        JpegWriter::new(shape, quality, subsampling, [255; 3], None)
    }

    /// A piece from the middle.
    fn detail(&self, name: &str, (width, height): (u32, u32)) -> Self {
        let (left, top) = (
            self.extent.width() as usize / 2,
            self.extent.height() as usize / 2,
        );
        let channels = self.channels.count();
        let row = |y: usize| {
            &self.samples[((top + y) * self.extent.width() as usize + left) * channels..]
                [..width as usize * channels]
        };
        let samples = (0..height as usize).flat_map(row).copied().collect();
        Self {
            name: name.to_owned(),
            extent: extent((width, height)),
            channels: self.channels,
            samples,
        }
    }

    fn strip(&self, writer: &JpegWriter, strip: usize) -> &[u8] {
        let (rows, row) = (
            writer.rows(strip),
            self.extent.width() as usize * self.channels.count(),
        );
        &self.samples[rows.start as usize * row..rows.end as usize * row]
    }
}

fn main() {
    match harness::option("--paired") {
        Some(folder) => answer(Path::new(&folder)),
        None => tables(),
    }
}

fn tables() {
    let mut report = Report::new("jpeg", "pixels to the bytes of a JPEG, quality 85");
    for picture in pictures() {
        if harness::wanted(&picture.name) {
            table(&mut report, &picture);
        }
    }
    if harness::wanted("quality") {
        qualities(&mut report);
    }
}

fn pictures() -> Vec<Picture> {
    let rgb = [SMALL, FULL_HD].map(|sides| {
        let photo = photograph(extent(sides), Channels::Rgb);
        Picture::new(format!("{} RGB", size(photo.extent())), &photo)
    });
    let rgba = [SMALL, FULL_HD].map(|sides| {
        let photo = warped(photograph(extent(sides), Channels::Rgba));
        Picture::new(
            format!("{} RGBA, warped, alpha 0 or 255", size(photo.extent())),
            &photo,
        )
    });
    rgb.into_iter().chain(rgba).collect()
}

fn table(report: &mut Report, picture: &Picture) {
    let two = pool(2);
    let mut contenders: Vec<Contender<'_>> = Vec::new();
    let mut add = |name: &str, run: &'static dyn Fn(&Picture, &mut Vec<u8>)| {
        let mut out = Vec::new();
        run(picture, &mut out);
        let size = out.len();
        contenders.push(
            contender(name, move || {
                out.clear();
                run(picture, &mut out);
                black_box(&out);
            })
            .sized(size),
        );
    };
    if picture.channels == Channels::Rgb {
        add("jpeg-encoder 4:2:0", &|picture, out| {
            crate_jpeg_encoder(picture, QUALITY, Subsampling::Half, out)
        });
        add("rusty_jpeg 4:2:0", &crate_rusty_jpeg);
    }
    let first = contenders.len();
    for level in SimdLevel::available().iter().rev() {
        for (name, subsampling) in [("4:2:0", Subsampling::Half), ("4:4:4", Subsampling::Full)] {
            let writer = picture.writer(QUALITY, subsampling).with_level(*level);
            let mut out = Vec::new();
            strips(picture, &writer, &mut out);
            let size = out.len();
            contenders.push(
                contender(format!("strips {name}, {}", level.name()), move || {
                    out.clear();
                    strips(picture, &writer, &mut out);
                    black_box(&out);
                })
                .sized(size),
            );
        }
    }
    let writer = picture.writer(QUALITY, Subsampling::Half);
    contenders.push(inside(&two, "strips 4:2:0, 2 threads", move || {
        _ = black_box(parallel(picture, &writer))
    }));
    let small = picture.extent.width() < 1000;
    report.table(&picture.name, if small { 61 } else { 21 }, &mut contenders);
    let levels = SimdLevel::available().len();
    if picture.channels == Channels::Rgb {
        let scalar = report.ratio(first + 2 * (levels - 1), 0);
        report.goal(
            &format!("{}: scalar / jpeg-encoder", picture.name),
            scalar,
            Goal::AtMost(1.0),
        );
    }
    let two = report.ratio(first + 2 * levels, first);
    report.goal(
        &format!("{}: 2 threads / 1 thread", picture.name),
        two,
        Goal::AtMost(0.6),
    );
}

/// Bytes and PSNR of ours and of jpeg-encoder, as one decoder reads them.
fn qualities(report: &mut Report) {
    report.line("## quality, 4:2:0 and 4:4:4: bytes and PSNR, dB, of ours and of jpeg-encoder\n");
    report.line(
        "| picture | quality | ours 4:2:0 | jpeg-encoder 4:2:0 | ours 4:4:4 | jpeg-encoder 4:4:4 |",
    );
    report.line("|---|---:|---:|---:|---:|---:|");
    for (name, picture) in [("photograph", pictures().remove(0)), ("noise", noise())] {
        for quality in QUALITIES {
            let mut cells = Vec::new();
            for subsampling in [Subsampling::Half, Subsampling::Full] {
                let (mut ours, mut theirs) = (Vec::new(), Vec::new());
                strips(&picture, &picture.writer(quality, subsampling), &mut ours);
                crate_jpeg_encoder(&picture, quality, subsampling, &mut theirs);
                for file in [ours, theirs] {
                    cells.push(format!(
                        "{} / {:.2}",
                        file.len(),
                        psnr(&picture.samples, &file)
                    ));
                }
            }
            report.line(&format!("| {name} | {quality} | {} |", cells.join(" | ")));
        }
    }
    report.line("");
}

fn noise() -> Picture {
    let extent = extent((256, 256));
    let samples = (0..256_u32 * 256 * 3)
        .map(|k| (k.wrapping_mul(2_654_435_761) >> 13 ^ k.wrapping_mul(0x9e37_79b9) >> 24) as u8)
        .collect();
    Picture {
        name: "noise".to_owned(),
        extent,
        channels: Channels::Rgb,
        samples,
    }
}

fn psnr(samples: &[u8], file: &[u8]) -> f64 {
    let decoded = image::load_from_memory(file)
        .unwrap()
        .into_rgb8()
        .into_raw();
    let sum: f64 = samples
        .iter()
        .zip(&decoded)
        .map(|(a, b)| f64::from(a.abs_diff(*b)).powi(2))
        .sum();
    10.0 * (255.0_f64.powi(2) * samples.len() as f64 / sum).log10()
}

fn answer(folder: &Path) {
    let photo = |case: &str, sides| {
        Picture::new(case.to_owned(), &photograph(extent(sides), Channels::Rgb))
    };
    let timed = [photo("500x500", SMALL), photo("1920x1080", FULL_HD)];
    let [small, _] = &timed;
    let others = [
        noise(),
        small.detail("17x9", (17, 9)),
        small.detail("5x5", (5, 5)),
    ];
    let two = pool(2);
    let (mut index, mut contenders) = (Vec::new(), Vec::new());
    for picture in timed.iter().chain(&others) {
        let (case, (width, height)) = (&picture.name, picture.sides());
        let file = format!("{case}.rgb");
        paired::write(folder, &file, &picture.samples);
        let levels: Vec<_> = SimdLevel::available()
            .iter()
            .map(|level| level.name())
            .collect();
        index.push(serde_json::json!({
            "case": case, "width": width, "height": height, "picture": file, "levels": levels,
                "qualities": QUALITIES,
        }));
        for quality in QUALITIES {
            for (name, subsampling) in [("420", Subsampling::Half), ("444", Subsampling::Full)] {
                let mut out = Vec::new();
                strips(picture, &picture.writer(quality, subsampling), &mut out);
                paired::write(folder, &format!("{case}.{quality}.{name}.jpg"), &out);
            }
        }
        for level in SimdLevel::available() {
            let (mut out, writer) = (
                Vec::new(),
                picture
                    .writer(QUALITY, Subsampling::Half)
                    .with_level(*level),
            );
            contenders.push(contender(format!("{case} {}", level.name()), move || {
                out.clear();
                strips(picture, &writer, &mut out);
                black_box(&out);
            }));
        }
        let writer = picture.writer(QUALITY, Subsampling::Half);
        contenders.push(inside(&two, format!("{case} 2 threads"), move || {
            _ = black_box(parallel(picture, &writer))
        }));
    }
    paired::write(
        folder,
        "index.json",
        serde_json::Value::from(index).to_string().as_bytes(),
    );
    paired::serve(&mut contenders);
}

fn strips(picture: &Picture, writer: &JpegWriter, out: &mut Vec<u8>) {
    out.extend_from_slice(writer.head());
    for strip in 0..writer.strips() {
        writer.strip_into(strip, picture.strip(writer, strip), out, &|| true);
    }
    out.extend_from_slice(JpegWriter::tail());
}

/// The strips leave as the service sends them: separate buffers.
fn parallel(picture: &Picture, writer: &JpegWriter) -> Vec<Vec<u8>> {
    let strip = |strip| {
        let mut out = Vec::new();
        writer.strip_into(strip, picture.strip(writer, strip), &mut out, &|| true);
        out
    };
    (0..writer.strips()).into_par_iter().map(strip).collect()
}

fn crate_jpeg_encoder(picture: &Picture, quality: u8, subsampling: Subsampling, out: &mut Vec<u8>) {
    let mut encoder = jpeg_encoder::Encoder::new(out, quality);
    encoder.set_sampling_factor(match subsampling {
        Subsampling::Half => jpeg_encoder::SamplingFactor::F_2_2,
        Subsampling::Full => jpeg_encoder::SamplingFactor::F_1_1,
    });
    let (width, height) = picture.sides();
    encoder
        .encode(
            &picture.samples,
            width,
            height,
            jpeg_encoder::ColorType::Rgb,
        )
        .unwrap();
}

fn crate_rusty_jpeg(picture: &Picture, out: &mut Vec<u8>) {
    let mut encoder = rusty_jpeg::Encoder::new(out, QUALITY);
    encoder.set_sampling_factor(rusty_jpeg::SamplingFactor::F_2_2);
    let (width, height) = picture.sides();
    encoder
        .encode(&picture.samples, width, height, rusty_jpeg::ColorType::Rgb)
        .unwrap();
}
