//! Pictures made on the spot.

/// An RGB picture in which no two neighbourhoods look alike.
pub(crate) fn photo(width: u32, height: u32) -> Vec<u8> {
    let sample = |x: u32, y: u32, c: u32| {
        let wave = 90.0 * (f64::from(x * (c + 1)) / 17.0).sin() * (f64::from(y) / (11.0 + f64::from(c))).cos();
        let noise = f64::from((x.wrapping_mul(2_654_435_761) ^ y.wrapping_mul(40_503) ^ c) % 23);
        #[expect(clippy::cast_possible_truncation, clippy::cast_sign_loss, reason = "clamped to a byte")]
        let byte = (128.0 + wave + noise).clamp(0.0, 255.0) as u8;
        byte
    };
    let samples: Vec<u8> = (0..height).flat_map(|y| (0..width).flat_map(move |x| (0..3).map(move |c| sample(x, y, c)))).collect();
    png(width, height, png::ColorType::Rgb, &samples)
}

/// A PNG file.
pub(crate) fn png(width: u32, height: u32, color: png::ColorType, samples: &[u8]) -> Vec<u8> {
    let mut file = Vec::new();
    let mut encoder = png::Encoder::new(&mut file, width, height);
    encoder.set_color(color);
    encoder.set_depth(png::BitDepth::Eight);
    encoder.set_compression(png::Compression::Fast);
    let mut writer = encoder.write_header().unwrap();
    writer.write_image_data(samples).unwrap();
    writer.finish().unwrap();
    file
}

/// Width, height and samples of a PNG file, read by a decoder that shares no code with ours.
pub(crate) fn decoded(file: &[u8]) -> (usize, usize, Vec<u8>) {
    let mut decoder = zune_png::PngDecoder::new(zune_png::zune_core::bytestream::ZCursor::new(file));
    let samples = decoder.decode_raw().unwrap();
    let (width, height) = decoder.dimensions().unwrap();
    (width, height, samples)
}
