//! Pictures made on the spot.

/// An RGB picture in which no two neighbourhoods look alike.
pub(crate) fn photo(width: u32, height: u32) -> Vec<u8> {
    // Tables and plain loops: the tests are not optimised, and many begin with a photograph.
    let columns: Vec<[f64; 3]> = (0..width)
        .map(|x| [0, 1, 2].map(|c| 90.0 * (f64::from(x * (c + 1)) / 17.0).sin()))
        .collect();
    let mut samples = Vec::with_capacity(3 * (width * height) as usize);
    for y in 0..height {
        let row = [0, 1, 2].map(|c| (f64::from(y) / (11.0 + f64::from(c))).cos());
        for x in 0..width {
            for c in 0..3 {
                let wave = columns[x as usize][c as usize] * row[c as usize];
                let noise = (x.wrapping_mul(2_654_435_761) ^ y.wrapping_mul(40_503) ^ c) % 23;
                #[expect(
                    clippy::cast_possible_truncation,
                    clippy::cast_sign_loss,
                    reason = "clamped to a byte"
                )]
                samples.push((128.0 + wave + f64::from(noise)).clamp(0.0, 255.0) as u8);
            }
        }
    }
    png(width, height, png::ColorType::Rgb, &samples)
}

/// A BMP of noise: every file of one size has one length. `width` is a multiple of 4.
pub(crate) fn bmp(width: u32, height: u32, seed: u32) -> Vec<u8> {
    let pixels = (3 * width * height) as usize;
    let mut file = b"BM".to_vec();
    for number in [
        54 + pixels as u32,
        0,
        54,
        40,
        width,
        height,
        1 | 24 << 16,
        0,
        pixels as u32,
        2835,
        2835,
        0,
        0,
    ] {
        file.extend(number.to_le_bytes());
    }
    let mut state = seed.wrapping_mul(0x9e37_79b9) | 1;
    file.extend((0..pixels).map(|_| {
        // A generator of Marsaglia's.
        state ^= state << 13;
        state ^= state >> 17;
        state ^= state << 5;
        state.to_le_bytes()[1]
    }));
    file
}

/// A PNG file, 8 bits a sample.
pub(crate) fn png(width: u32, height: u32, color: png::ColorType, samples: &[u8]) -> Vec<u8> {
    png_of(width, height, color, png::BitDepth::Eight, samples)
}

/// A PNG file; samples of 16 bits are big-endian.
pub(crate) fn png_of(
    width: u32,
    height: u32,
    color: png::ColorType,
    depth: png::BitDepth,
    samples: &[u8],
) -> Vec<u8> {
    let mut file = Vec::new();
    let mut encoder = png::Encoder::new(&mut file, width, height);
    encoder.set_color(color);
    encoder.set_depth(depth);
    encoder.set_compression(png::Compression::Fast);
    let mut writer = encoder.write_header().unwrap();
    writer.write_image_data(samples).unwrap();
    writer.finish().unwrap();
    file
}

/// What a PNG file of ours holds. Samples of 16 bits are big-endian.
#[derive(Clone, Debug, PartialEq)]
pub(crate) struct Decoded {
    pub(crate) width: usize,
    pub(crate) height: usize,
    pub(crate) color: png::ColorType,
    pub(crate) depth: png::BitDepth,
    pub(crate) samples: Vec<u8>,
}

/// Reads a file that we wrote by two decoders that share no code, both with every checksum: each
/// must take it, and they must agree.
pub(crate) fn decoded(file: &[u8]) -> Decoded {
    let first = by_png(file);
    let second = by_zune(file);
    assert_eq!(
        (first.width, first.height, first.color, first.depth),
        (second.width, second.height, second.color, second.depth)
    );
    assert!(
        first.samples == second.samples,
        "two decoders see two pictures of {} x {}",
        first.width,
        first.height
    );
    first
}

fn by_png(file: &[u8]) -> Decoded {
    let mut options = png::DecodeOptions::default();
    options.set_ignore_adler32(false);
    options.set_ignore_crc(false);
    let mut decoder = png::Decoder::new_with_options(std::io::Cursor::new(file), options);
    decoder.set_transformations(png::Transformations::IDENTITY);
    let mut reader = decoder.read_info().unwrap();
    let mut samples = vec![0; reader.output_buffer_size().unwrap()];
    let info = reader.next_frame(&mut samples).unwrap();
    reader.finish().unwrap();
    samples.truncate(info.buffer_size());
    Decoded {
        width: info.width as usize,
        height: info.height as usize,
        color: info.color_type,
        depth: info.bit_depth,
        samples,
    }
}

fn by_zune(file: &[u8]) -> Decoded {
    use zune_png::zune_core::bytestream::ZCursor;
    use zune_png::zune_core::colorspace::ColorSpace;
    use zune_png::zune_core::options::DecoderOptions;
    use zune_png::zune_core::result::DecodingResult;
    let options = DecoderOptions::default()
        .set_strict_mode(true)
        .png_set_confirm_crc(true)
        .inflate_set_confirm_adler(true);
    let mut decoder = zune_png::PngDecoder::new_with_options(ZCursor::new(file), options);
    let (depth, samples) = match decoder.decode().unwrap() {
        DecodingResult::U8(samples) => (png::BitDepth::Eight, samples),
        DecodingResult::U16(samples) => (
            png::BitDepth::Sixteen,
            samples.into_iter().flat_map(u16::to_be_bytes).collect(),
        ),
        _ => panic!("a depth that we do not write"),
    };
    let color = match decoder.colorspace().unwrap() {
        ColorSpace::RGB => png::ColorType::Rgb,
        ColorSpace::RGBA => png::ColorType::Rgba,
        other => panic!("colours that we do not write: {other:?}"),
    };
    let (width, height) = decoder.dimensions().unwrap();
    Decoded {
        width,
        height,
        color,
        depth,
        samples,
    }
}
