//! PNG encoding of the warped photograph (RGBA with alpha 0 or 255, and RGB, 8 bit) against the
//! crates that do it in Rust, 500 x 500 and 1920 x 1080, one thread, and the strips on two; and how
//! time grows with the pixels. Buffers are reused where an encoder allows it.
//!
//! `cargo bench --bench png [-- FILTER]`; a filter is a part of a table's title. `png --paired DIR`
//! writes the pictures there, `index.json` naming them, and then times `strips fast` for each case
//! that is asked for (see `harness/paired.rs`).

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

use harness::pictures::{FULL_HD, SMALL, bytes, encode, extent, photograph, size, tiles, warped};
use harness::{Contender, Goal, Report, contender, inside, paired, pool};
use mlswarp::codec::{Compression, PixelLayout, PngWriter};
use mlswarp::level::SimdLevel;
use mlswarp::pixmap::{Channels, Depth, Extent, Pixmap};
use rayon::prelude::*;

struct Picture {
    name: String,
    width: u32,
    height: u32,
    channels: Channels,
    samples: Vec<u8>,
}

impl Picture {
    fn new(name: String, pixmap: &Pixmap) -> Self {
        let extent = pixmap.extent();
        Self {
            name,
            width: extent.width(),
            height: extent.height(),
            channels: pixmap.channels(),
            samples: bytes(pixmap).to_vec(),
        }
    }
}

fn main() {
    match harness::option("--paired") {
        Some(folder) => answer(Path::new(&folder)),
        None => tables(),
    }
}

fn tables() {
    let mut report = Report::new("png", "pixels to the bytes of a PNG, 8 bit");
    for picture in pictures() {
        if harness::wanted(&picture.name) {
            table(&mut report, &picture);
        }
    }
    if harness::wanted("growth") {
        growth(&mut report);
    }
}

/// The photograph warped, transparent where it bent away; and as RGB, unwarped, since nothing of it
/// is missing then.
fn pictures() -> Vec<Picture> {
    let of = |sides, channels| {
        let photo = photograph(extent(sides), channels);
        match channels {
            Channels::Rgba => Picture::new(
                format!("{} RGBA, warped, alpha 0 or 255", size(photo.extent())),
                &warped(photo),
            ),
            Channels::Rgb => Picture::new(format!("{} RGB", size(photo.extent())), &photo),
        }
    };
    [SMALL, FULL_HD]
        .into_iter()
        .flat_map(|sides| [Channels::Rgba, Channels::Rgb].map(|channels| of(sides, channels)))
        .collect()
}

struct Contenders<'a>(Vec<Contender<'a>>);

impl<'a> Contenders<'a> {
    fn add(&mut self, name: &str, mut run: impl FnMut(&mut Vec<u8>) + 'a) {
        let mut out = Vec::new();
        let size = write(&mut run, &mut out);
        self.0
            .push(contender(name, move || _ = write(&mut run, &mut out)).sized(size));
    }

    fn add_inside(
        &mut self,
        pool: &'a rayon::ThreadPool,
        name: &str,
        mut run: impl FnMut(&mut Vec<u8>) + Send + 'a,
    ) {
        let mut out = Vec::new();
        let size = write(&mut run, &mut out);
        self.0
            .push(inside(pool, name, move || _ = write(&mut run, &mut out)).sized(size));
    }
}

/// Bytes written.
fn write(run: &mut impl FnMut(&mut Vec<u8>), out: &mut Vec<u8>) -> usize {
    out.clear();
    run(out);
    black_box(out).len()
}

fn table(report: &mut Report, picture: &Picture) {
    let (one, two) = (pool(1), pool(2));
    let small = picture.width < 1000;
    let mut contenders = Contenders(Vec::new());
    contenders.add("png Fastest", move |out| {
        crate_png(picture, png::Compression::Fastest, None, out)
    });
    for &level in SimdLevel::available().iter().rev() {
        contenders.add(&format!("strips fast, {}", level.name()), move |out| {
            strips(picture, Compression::Fast, level, out)
        });
    }
    contenders.add_inside(&two, "strips fast, 2 threads", move |out| {
        parallel(picture, Compression::Fast, out)
    });
    contenders.add("strips none", move |out| {
        strips(picture, Compression::None, SimdLevel::detect(), out)
    });
    if small {
        contenders.add("strips best", move |out| {
            strips(picture, Compression::Best, SimdLevel::detect(), out)
        });
        contenders.add("png High", move |out| {
            crate_png(picture, png::Compression::High, None, out)
        });
    }
    contenders.add("png NoCompression", move |out| {
        crate_png(picture, png::Compression::NoCompression, None, out)
    });
    contenders.add("png Fast", move |out| {
        crate_png(picture, png::Compression::Fast, None, out)
    });
    contenders.add("png Fastest, Paeth", move |out| {
        crate_png(
            picture,
            png::Compression::Fastest,
            Some(png::Filter::Paeth),
            out,
        )
    });
    contenders.add("image default", move |out| crate_image(picture, out));
    contenders.add("mtpng fast, 1 thread", |out| {
        crate_mtpng(picture, &one, out)
    });
    contenders.add("zune-png (stored)", move |out| crate_zune(picture, out));
    let mut contenders = contenders.0;
    let medians = report.table(&picture.name, if small { 61 } else { 21 }, &mut contenders);
    report.line(&format!(
        "{} bytes of samples; strips fast: {:.0} MB/s.\n",
        picture.samples.len(),
        picture.samples.len() as f64 / medians[1] / 1e6
    ));
    let (fastest, fast) = (
        contenders[0].bytes().unwrap(),
        contenders[1].bytes().unwrap(),
    );
    let two = report.ratio(1 + SimdLevel::available().len(), 1);
    let one = report.ratio(1, 0);
    report.goal(
        &format!("{}: 1 thread / png Fastest", picture.name),
        one,
        Goal::AtMost(0.5),
    );
    report.goal(
        &format!("{}: size / png Fastest", picture.name),
        fast as f64 / fastest as f64,
        Goal::AtMost(1.0),
    );
    report.goal(
        &format!("{}: 2 threads / 1 thread", picture.name),
        two,
        Goal::AtMost(0.6),
    );
}

/// The photograph side by side with itself: the same kind of pixels, ever more of them.
fn growth(report: &mut Report) {
    let sides = [250, 500, 1000, 2000];
    let extents = sides.map(|side| extent((side, side)));
    let pictures = extents.map(|e: Extent| Picture::new(size(e), &tiles(e)));
    let mut contenders = Contenders(Vec::new());
    for picture in &pictures {
        contenders.add(&picture.name, move |out| {
            strips(picture, Compression::Fast, SimdLevel::detect(), out)
        });
    }
    let medians = report.table("growth, RGBA, strips fast, 1 thread", 41, &mut contenders.0);
    for k in 1..sides.len() {
        let slope = harness::slope(
            [extents[k - 1], extents[k]].map(|e| e.pixels() as f64),
            [medians[k - 1], medians[k]],
        );
        report.line(&format!(
            "Slope in pixels, {} to {}: {slope:.2}",
            sides[k - 1],
            sides[k]
        ));
        if sides[k] == 1000 {
            report.goal(
                "slope in pixels, 500^2 to 1000^2",
                slope,
                Goal::Between(0.9, 1.1),
            );
        }
    }
    report.line("");
}

fn answer(folder: &Path) {
    let pictures = [("500x500", SMALL), ("1920x1080", FULL_HD)].map(|(case, sides)| {
        (
            case,
            Picture::new(
                case.to_owned(),
                &warped(photograph(extent(sides), Channels::Rgba)),
            ),
        )
    });
    let mut index = Vec::new();
    let mut contenders = Contenders(Vec::new());
    for (case, picture) in &pictures {
        let file = format!("{case}.warped.rgba");
        paired::write(folder, &file, &picture.samples);
        contenders.add(case, move |out| {
            strips(picture, Compression::Fast, SimdLevel::detect(), out)
        });
        index.push(serde_json::json!({
            "case": case, "width": picture.width, "height": picture.height, "picture": file,
            "bytes": contenders.0.last().and_then(Contender::bytes),
                "level": SimdLevel::detect().name(),
        }));
    }
    paired::write(
        folder,
        "index.json",
        serde_json::Value::from(index).to_string().as_bytes(),
    );
    paired::serve(&mut contenders.0);
}

fn writer(picture: &Picture, compression: Compression) -> PngWriter {
    let extent = Extent::new(picture.width, picture.height).unwrap();
    PngWriter::new(
        PixelLayout {
            extent,
            channels: picture.channels,
            grey: false,
            depth: Depth::Eight,
        },
        compression,
        None,
    )
}

fn strip_samples<'a>(picture: &'a Picture, writer: &PngWriter, strip: usize) -> &'a [u8] {
    let rows = writer.rows(strip);
    let row = picture.width as usize * picture.channels.count();
    &picture.samples[rows.start as usize * row..rows.end as usize * row]
}

fn strips(picture: &Picture, compression: Compression, level: SimdLevel, out: &mut Vec<u8>) {
    let writer = writer(picture, compression).with_level(level);
    out.extend_from_slice(&writer.head());
    let checksums: Vec<_> = (0..writer.strips())
        .map(|k| writer.strip_into(k, strip_samples(picture, &writer, k), out))
        .collect();
    out.extend_from_slice(&writer.tail(&checksums));
}

/// The strips leave as the service sends them: separate buffers; joined here only to count them.
fn parallel(picture: &Picture, compression: Compression, out: &mut Vec<u8>) {
    let writer = writer(picture, compression);
    let strips: Vec<_> = (0..writer.strips())
        .into_par_iter()
        .map(|k| writer.strip(k, strip_samples(picture, &writer, k)))
        .collect();
    let checksums: Vec<_> = strips
        .iter()
        .map(|strip| (strip.adler, strip.filtered_len))
        .collect();
    out.extend_from_slice(&writer.head());
    for strip in &strips {
        out.extend_from_slice(&strip.bytes);
    }
    out.extend_from_slice(&writer.tail(&checksums));
}

fn crate_png(
    picture: &Picture,
    compression: png::Compression,
    filter: Option<png::Filter>,
    out: &mut Vec<u8>,
) {
    let extent = extent((picture.width, picture.height));
    encode(
        extent,
        picture.channels,
        &picture.samples,
        (compression, filter),
        out,
    );
}

fn crate_image(picture: &Picture, out: &mut Vec<u8>) {
    use image::ImageEncoder;
    let color = if picture.channels == Channels::Rgb {
        image::ExtendedColorType::Rgb8
    } else {
        image::ExtendedColorType::Rgba8
    };
    image::codecs::png::PngEncoder::new(out)
        .write_image(&picture.samples, picture.width, picture.height, color)
        .unwrap();
}

fn crate_mtpng(picture: &Picture, pool: &rayon::ThreadPool, out: &mut Vec<u8>) {
    let mut options = mtpng::encoder::Options::new();
    options.set_thread_pool(pool).unwrap();
    options
        .set_compression_level(mtpng::CompressionLevel::Fast)
        .unwrap();
    let mut header = mtpng::Header::new();
    header.set_size(picture.width, picture.height).unwrap();
    let color = if picture.channels == Channels::Rgb {
        mtpng::ColorType::Truecolor
    } else {
        mtpng::ColorType::TruecolorAlpha
    };
    header.set_color(color, 8).unwrap();
    let mut encoder = mtpng::encoder::Encoder::new(out, &options);
    encoder.write_header(&header).unwrap();
    encoder.write_image_rows(&picture.samples).unwrap();
    encoder.finish().unwrap();
}

fn crate_zune(picture: &Picture, out: &mut Vec<u8>) {
    use zune_png::zune_core::{
        bit_depth::BitDepth, colorspace::ColorSpace, options::EncoderOptions,
    };
    let color = if picture.channels == Channels::Rgb {
        ColorSpace::RGB
    } else {
        ColorSpace::RGBA
    };
    let options = EncoderOptions::new(
        picture.width as usize,
        picture.height as usize,
        color,
        BitDepth::Eight,
    );
    zune_png::PngEncoder::new(&picture.samples, options)
        .encode(out)
        .unwrap();
}
