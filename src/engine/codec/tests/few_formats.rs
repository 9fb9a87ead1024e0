//! GIF and BMP, which are only read. Files are written by the `image` and `gif` crates, or byte by
//! byte.

use image::codecs::gif::GifEncoder;
use image::{DynamicImage, Frame, ImageFormat, RgbImage, RgbaImage};

use super::*;

/// A GIF of frames of these sizes on a screen of the first, of four colours; one of them may be
/// transparent.
pub(super) fn gif(frames: &[(u16, u16)], transparent: Option<u8>) -> Vec<u8> {
    let mut file = b"GIF89a".to_vec();
    let (width, height) = frames[0];
    file.extend([width.to_le_bytes(), height.to_le_bytes()].as_flattened());
    file.extend([0x81, 0, 0]);
    file.extend((0..12).map(|n| n * 20));
    for &(width, height) in frames {
        if let Some(index) = transparent {
            file.extend([0x21, 0xF9, 4, 1, 0, 0, index, 0]);
        }
        file.push(0x2C);
        file.extend([[0; 2], [0; 2], width.to_le_bytes(), height.to_le_bytes()].as_flattened());
        file.extend([0, 2]);
        let indices: Vec<u8> = (0..u32::from(width) * u32::from(height))
            .map(|n| (n % 4) as u8)
            .collect();
        let data = weezl::encode::Encoder::new(weezl::BitOrder::Lsb, 2)
            .encode(&indices)
            .unwrap();
        for block in data.chunks(255) {
            file.push(block.len() as u8);
            file.extend(block);
        }
        file.push(0);
    }
    file.push(0x3B);
    file
}

pub(super) fn bmp(width: u32, height: u32, rgb: &[u8]) -> Vec<u8> {
    let mut file = std::io::Cursor::new(Vec::new());
    let image = DynamicImage::from(RgbImage::from_raw(width, height, rgb.to_vec()).unwrap());
    image.write_to(&mut file, ImageFormat::Bmp).unwrap();
    file.into_inner()
}

#[test]
fn a_gif_has_the_colours_of_its_palette() {
    let picture = decoded(&gif(&[(3, 2)], None));
    assert_eq!(picture.channels(), Channels::Rgb);
    assert_eq!(
        eight(&picture),
        [
            0, 20, 40, 60, 80, 100, 120, 140, 160, 180, 200, 220, 0, 20, 40, 60, 80, 100
        ]
    );
    let clear = decoded(&gif(&[(3, 2)], Some(1)));
    assert_eq!(
        (clear.channels(), clear.is_opaque()),
        (Channels::Rgba, false)
    );
    assert_eq!(
        eight(&clear)
            .chunks(4)
            .map(|pixel| pixel[3])
            .collect::<Vec<_>>(),
        [255, 0, 255, 255, 255, 0]
    );
}

/// A graphic control marks a colour of the frame that follows it.
#[test]
fn a_mark_after_the_frame_makes_no_pixel_transparent() {
    let mut file = gif(&[(3, 2)], None);
    let end = file.len() - 1;
    file.splice(end..end, [0x21, 0xF9, 4, 1, 0, 0, 1, 0]);
    assert_eq!(decoded(&file).channels(), Channels::Rgb);
}

#[test]
fn a_gif_of_several_frames_is_refused_by_their_number() {
    let error = decode(&gif(&[(3, 2); 3], None), &ImageLimits::default()).unwrap_err();
    assert_eq!(
        error,
        CodecError::TooLarge {
            what: "image_frames",
            limit: 1,
            actual: 3
        }
    );
    // A frame beyond the screen.
    let mut beyond = gif(&[(3, 2)], None);
    beyond[6] = 2;
    assert!(matches!(
        decode(&beyond, &ImageLimits::default()),
        Err(CodecError::Bad { .. })
    ));
}

/// A frame that is smaller than the screen leaves the rest transparent.
#[test]
fn what_a_gif_does_not_cover_is_transparent() {
    let mut small = gif(&[(3, 2)], None);
    small[6] = 4;
    small[8] = 3;
    let picture = decoded(&small);
    assert_eq!(
        (picture.extent(), picture.channels()),
        (crate::pixmap::Extent::new(4, 3).unwrap(), Channels::Rgba)
    );
    let alpha: Vec<u8> = eight(&picture).chunks(4).map(|pixel| pixel[3]).collect();
    assert_eq!(alpha, [255, 255, 255, 0, 255, 255, 255, 0, 0, 0, 0, 0]);
}

#[test]
fn a_gif_of_another_writer_is_read() {
    let mut file = Vec::new();
    let picture = RgbaImage::from_fn(40, 30, |x, y| {
        image::Rgba([if x > y { 255 } else { 0 }, 0, 90, 255])
    });
    GifEncoder::new(&mut file)
        .encode_frame(Frame::new(picture.clone()))
        .unwrap();
    let read = decoded(&file);
    let rgb: Vec<u8> = eight(&read)
        .chunks(read.channels().count())
        .flat_map(|pixel| pixel[..3].to_vec())
        .collect();
    assert_eq!(rgb, DynamicImage::from(picture).into_rgb8().into_raw());
}

#[test]
fn a_bmp_is_read_in_every_depth() {
    let rgb: Vec<u8> = (0..7 * 5 * 3).map(|n| n as u8 * 2).collect();
    assert_eq!(eight(&decoded(&bmp(7, 5, &rgb))), rgb);
    // Two colours, one bit a pixel, rows from below, padded to four bytes.
    let mut one =
        b"BM\0\0\0\0\0\0\0\0\x3E\0\0\0\x28\0\0\0\x03\0\0\0\x02\0\0\0\x01\0\x01\0".to_vec();
    one.extend([0; 24]);
    one.extend([10, 20, 30, 0, 40, 50, 60, 0]);
    one.extend([0b0100_0000, 0, 0, 0, 0b1010_0000, 0, 0, 0]);
    let (dark, light) = ([30, 20, 10], [60, 50, 40]);
    assert_eq!(
        eight(&decoded(&one)),
        [light, dark, light, dark, light, dark].as_flattened()
    );
}

#[test]
fn a_large_claim_is_refused_by_the_header() {
    let mut gif = gif(&[(3, 2)], None);
    gif[6..10].fill(0xFF);
    let side = |file: &[u8], actual| {
        assert_eq!(
            decode(file, &ImageLimits::default()).unwrap_err(),
            CodecError::TooLarge {
                what: "image_side",
                limit: 16_384,
                actual
            }
        );
    };
    side(&gif, 65_535);
    let mut bmp = bmp(5, 4, &[0; 60]);
    bmp[18..22].copy_from_slice(&60_000_u32.to_le_bytes());
    side(&bmp, 60_000);
}
