//! PNG encoding of a photograph (500 x 500, RGBA and RGB, 8 bit) against the crates that do it in Rust: medians of interleaved runs, one thread,
//! and the strips on two threads. Also 1920 x 1080 made from the same photograph. Buffers are reused where an encoder allows it.
//! Run: `cargo bench --bench png`; an argument keeps the contenders with one of its parts (between commas) in their name.

#![allow(
    missing_docs,
    clippy::print_stdout,
    clippy::unwrap_used,
    clippy::cast_possible_truncation,
    reason = "a program that prints a table"
)]

use std::hint::black_box;
use std::time::{Duration, Instant};

use mlswarp::codec::{Compression, PngShape, PngWriter};
use mlswarp::level::Level;
use mlswarp::pixmap::{Channels, Depth, Extent};
use rayon::prelude::*;

struct Picture {
    name: String,
    width: u32,
    height: u32,
    channels: Channels,
    samples: Vec<u8>,
}

type Encode<'a> = Box<dyn FnMut(&mut Vec<u8>) + 'a>;

struct Contender<'a> {
    name: String,
    run: Encode<'a>,
    times: Vec<Duration>,
    bytes: usize,
}

fn main() {
    let filter = std::env::args().skip(1).find(|arg| !arg.starts_with('-')).unwrap_or_default();
    for picture in pictures() {
        bench(&picture, &filter);
    }
}

/// The photograph cropped to 500 x 500, and enlarged to 1920 x 1080.
fn pictures() -> Vec<Picture> {
    let bytes = std::fs::read(concat!(env!("CARGO_MANIFEST_DIR"), "/tests/images/astronaut.png")).unwrap();
    let photo = image::load_from_memory(&bytes).unwrap();
    let large = photo.crop_imm(0, 0, 512, 288).resize_exact(1920, 1080, image::imageops::FilterType::CatmullRom);
    let mut pictures = Vec::new();
    for photo in [photo.crop_imm(0, 0, 500, 500), large] {
        let rgba = photo.to_rgba8().into_raw();
        let (width, height) = (photo.width(), photo.height());
        // A round hole in the alpha channel, as a warp leaves one at the border.
        let mut cut = rgba.clone();
        for (i, pixel) in cut.chunks_exact_mut(4).enumerate() {
            let (x, y) = (i as u32 % width, i as u32 / width);
            let (dx, dy) = ((2 * x).abs_diff(width) as f32 / width as f32, (2 * y).abs_diff(height) as f32 / height as f32);
            if dx.powi(6) + dy.powi(6) > 0.8 {
                pixel.fill(0);
            }
        }
        let rgb = rgba.chunks_exact(4).flat_map(|p| [p[0], p[1], p[2]]).collect();
        for (channels, samples, name) in
            [(Channels::Rgba, rgba, "RGBA, alpha 255"), (Channels::Rgba, cut, "RGBA, alpha 0 or 255"), (Channels::Rgb, rgb, "RGB")]
        {
            pictures.push(Picture { name: format!("{width} x {height} {name}"), width, height, channels, samples });
        }
    }
    pictures
}

struct Contenders<'a>(Vec<Contender<'a>>);

impl<'a> Contenders<'a> {
    fn add(&mut self, name: &str, run: impl FnMut(&mut Vec<u8>) + 'a) {
        self.0.push(Contender { name: name.to_owned(), run: Box::new(run), times: Vec::new(), bytes: 0 });
    }
}

fn pool(threads: usize) -> rayon::ThreadPool {
    rayon::ThreadPoolBuilder::new().num_threads(threads).build().unwrap()
}

fn bench(picture: &Picture, filter: &str) {
    let (one, two) = (pool(1), pool(2));
    let mut contenders = Contenders(Vec::new());
    for &level in Level::available().iter().rev() {
        contenders.add(&format!("strips fast, {level:?}"), move |out| strips(picture, Compression::Fast, level, out));
    }
    contenders.add("strips fast, 2 threads", |out| two.install(|| parallel(picture, Compression::Fast, out)));
    contenders.add("strips none", move |out| strips(picture, Compression::None, Level::detect(), out));
    if picture.width < 1000 {
        contenders.add("strips best", move |out| strips(picture, Compression::Best, Level::detect(), out));
        contenders.add("png High", move |out| crate_png(picture, png::Compression::High, None, out));
    }
    contenders.add("png NoCompression", move |out| crate_png(picture, png::Compression::NoCompression, None, out));
    contenders.add("png Fastest", move |out| crate_png(picture, png::Compression::Fastest, None, out));
    contenders.add("png Fast", move |out| crate_png(picture, png::Compression::Fast, None, out));
    contenders.add("png Fastest, Paeth", move |out| crate_png(picture, png::Compression::Fastest, Some(png::Filter::Paeth), out));
    contenders.add("image default", move |out| crate_image(picture, out));
    contenders.add("mtpng fast, 1 thread", |out| crate_mtpng(picture, &one, out));
    contenders.add("zune-png (stored)", move |out| crate_zune(picture, out));
    let mut contenders = contenders.0;
    contenders.retain(|contender| filter.split(',').any(|part| contender.name.contains(part)));

    let mut out = Vec::new();
    let deadline = Instant::now() + Duration::from_secs(if picture.width < 1000 { 4 } else { 6 });
    let mut round = 0;
    while round < 7 || Instant::now() < deadline && round < 400 {
        for contender in &mut contenders {
            // The slow ones get a few runs only.
            if round >= 5 && contender.times.iter().sum::<Duration>() > Duration::from_millis(700) {
                continue;
            }
            out.clear();
            let start = Instant::now();
            (contender.run)(&mut out);
            contender.times.push(start.elapsed());
            contender.bytes = out.len();
            black_box(&out);
        }
        round += 1;
    }

    let quantile = |contender: &Contender<'_>, part: f64| {
        let mut times = contender.times.clone();
        times.sort();
        times[(times.len() as f64 * part) as usize].as_secs_f64() * 1e3
    };
    let median = |contender: &Contender<'_>| quantile(contender, 0.5);
    let rival = contenders.iter().find(|c| c.name == "png Fastest").map(|c| (median(c), quantile(c, 0.05), c.bytes));
    println!(
        "\n{} ({} bytes); F is png Fastest; p5 is the twentieth part of the runs that was fastest",
        picture.name,
        picture.samples.len()
    );
    println!("{:<24} {:>9} {:>9} {:>7} {:>9} {:>8} {:>8} {:>8}", "", "ms", "p5 ms", "MB/s", "bytes", "ms / F", "p5 / F", "size / F");
    for contender in &contenders {
        let (ms, low) = (median(contender), quantile(contender, 0.05));
        let (time, low_ratio, size) =
            rival.map_or((0.0, 0.0, 0.0), |(time, least, bytes)| (ms / time, low / least, contender.bytes as f64 / bytes as f64));
        let speed = picture.samples.len() as f64 / ms / 1e3;
        let name = &contender.name;
        println!("{name:<24} {ms:>9.3} {low:>9.3} {speed:>7.0} {:>9} {time:>8.3} {low_ratio:>8.3} {size:>8.3}", contender.bytes);
    }
}

fn writer(picture: &Picture, compression: Compression) -> PngWriter {
    let extent = Extent::new(picture.width, picture.height).unwrap();
    PngWriter::new(PngShape { extent, channels: picture.channels, depth: Depth::Eight }, compression, None)
}

fn strip_samples<'a>(picture: &'a Picture, writer: &PngWriter, strip: usize) -> &'a [u8] {
    let rows = writer.rows(strip);
    let row = picture.width as usize * picture.channels.count();
    &picture.samples[rows.start as usize * row..rows.end as usize * row]
}

fn strips(picture: &Picture, compression: Compression, level: Level, out: &mut Vec<u8>) {
    let writer = writer(picture, compression).with_level(level);
    out.extend_from_slice(&writer.head());
    let checksums: Vec<_> = (0..writer.strips()).map(|k| writer.strip_into(k, strip_samples(picture, &writer, k), out)).collect();
    out.extend_from_slice(&writer.tail(&checksums));
}

/// The strips leave as the service sends them: separate buffers; joined here only to count them.
fn parallel(picture: &Picture, compression: Compression, out: &mut Vec<u8>) {
    let writer = writer(picture, compression);
    let strips: Vec<_> = (0..writer.strips()).into_par_iter().map(|k| writer.strip(k, strip_samples(picture, &writer, k))).collect();
    let checksums: Vec<_> = strips.iter().map(|strip| (strip.adler, strip.filtered_len)).collect();
    out.extend_from_slice(&writer.head());
    for strip in &strips {
        out.extend_from_slice(&strip.bytes);
    }
    out.extend_from_slice(&writer.tail(&checksums));
}

fn crate_png(picture: &Picture, compression: png::Compression, filter: Option<png::Filter>, out: &mut Vec<u8>) {
    let mut encoder = png::Encoder::new(out, picture.width, picture.height);
    encoder.set_color(if picture.channels == Channels::Rgb { png::ColorType::Rgb } else { png::ColorType::Rgba });
    encoder.set_depth(png::BitDepth::Eight);
    encoder.set_compression(compression);
    if let Some(filter) = filter {
        encoder.set_filter(filter);
    }
    let mut writer = encoder.write_header().unwrap();
    writer.write_image_data(&picture.samples).unwrap();
    writer.finish().unwrap();
}

fn crate_image(picture: &Picture, out: &mut Vec<u8>) {
    use image::ImageEncoder;
    let color = if picture.channels == Channels::Rgb { image::ExtendedColorType::Rgb8 } else { image::ExtendedColorType::Rgba8 };
    image::codecs::png::PngEncoder::new(out).write_image(&picture.samples, picture.width, picture.height, color).unwrap();
}

fn crate_mtpng(picture: &Picture, pool: &rayon::ThreadPool, out: &mut Vec<u8>) {
    let mut options = mtpng::encoder::Options::new();
    options.set_thread_pool(pool).unwrap();
    options.set_compression_level(mtpng::CompressionLevel::Fast).unwrap();
    let mut header = mtpng::Header::new();
    header.set_size(picture.width, picture.height).unwrap();
    let color = if picture.channels == Channels::Rgb { mtpng::ColorType::Truecolor } else { mtpng::ColorType::TruecolorAlpha };
    header.set_color(color, 8).unwrap();
    let mut encoder = mtpng::encoder::Encoder::new(out, &options);
    encoder.write_header(&header).unwrap();
    encoder.write_image_rows(&picture.samples).unwrap();
    encoder.finish().unwrap();
}

fn crate_zune(picture: &Picture, out: &mut Vec<u8>) {
    use zune_png::zune_core::{bit_depth::BitDepth, colorspace::ColorSpace, options::EncoderOptions};
    let color = if picture.channels == Channels::Rgb { ColorSpace::RGB } else { ColorSpace::RGBA };
    let options = EncoderOptions::new(picture.width as usize, picture.height as usize, color, BitDepth::Eight);
    zune_png::PngEncoder::new(&picture.samples, options).encode(out).unwrap();
}
