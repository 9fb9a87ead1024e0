//! The library's front door: pixels in and out are those of files in and out, bit for bit, and what
//! does not fit is refused by name.

use mlswarp::format::{Format, ImageLimits};
use mlswarp::pixmap::{Depth, PixelFormat, Pixels, Samples};
use mlswarp::render::{Filter, Outside};
use mlswarp::warp::{LabelValues, Limits, MapDirection, WarpError};
use mlswarp::{Cancel, Image, LabelImage, PosedWarp, Warper};

const WIDTH: u32 = 61;
const HEIGHT: u32 = 47;
const FORMATS: [PixelFormat; 4] = [
    PixelFormat::Grey,
    PixelFormat::GreyAlpha,
    PixelFormat::Rgb,
    PixelFormat::Rgba,
];

fn noise(k: usize) -> u32 {
    (k as u32).wrapping_mul(2_654_435_761) >> 12
}

fn pixels(format: PixelFormat, depth: Depth) -> Pixels {
    let count = WIDTH as usize * HEIGHT as usize * format.samples();
    match depth {
        Depth::Eight => {
            let samples: Vec<u8> = (0..count).map(|k| noise(k) as u8).collect();
            Pixels::new(WIDTH, HEIGHT, format, samples).unwrap()
        }
        Depth::Sixteen => {
            let samples: Vec<u16> = (0..count).map(|k| noise(k) as u16).collect();
            Pixels::new(WIDTH, HEIGHT, format, samples).unwrap()
        }
    }
}

fn posed(moved: bool) -> PosedWarp {
    let p = [[10.0, 10.0], [50.0, 12.0], [30.0, 40.0]];
    let q = [[13.5, 8.0], [47.0, 15.0], [31.0, 36.0]];
    let warper = Warper::new([WIDTH, HEIGHT], &p).unwrap();
    warper.pose(if moved { &q } else { &p }).unwrap()
}

fn decoded(file: &[u8]) -> Image {
    Image::decode(file, &ImageLimits::default(), &|| false).unwrap()
}

#[test]
fn front_door_pixels_are_those_of_files_in_every_layout_and_format() {
    for (format, depth) in FORMATS
        .into_iter()
        .flat_map(|format| [Depth::Eight, Depth::Sixteen].map(|depth| (format, depth)))
    {
        let image = Image::from_pixels(pixels(format, depth));
        assert_eq!(image.pixel_format(), format);
        assert_eq!(image.to_pixels(), pixels(format, depth));
        // At rest, the file of the pixels has them.
        let at_rest = posed(false);
        let file = at_rest.render(&image).unwrap().file(Format::Png).unwrap();
        let of_file = decoded(&file);
        assert_eq!(of_file.to_pixels(), pixels(format, depth), "{format:?}");
        let posed = posed(true);
        for outside in [Outside::Transparent, Outside::Edge, Outside::Reflect] {
            for filter in [Filter::Nearest, Filter::Bilinear, Filter::Bicubic] {
                let of_pixels = posed.render(&image).unwrap();
                let of_pixels = of_pixels.outside(outside).filter(filter);
                let of_files = posed.render(&of_file).unwrap();
                let of_files = of_files.outside(outside).filter(filter);
                let case = format!("{format:?} {depth:?} {outside:?} {filter:?}");
                for target in Format::ALL {
                    let file = of_pixels.file(target).unwrap();
                    assert_eq!(file, of_files.file(target).unwrap(), "{case} {target:?}");
                    if !target.info().keeps_labels {
                        continue;
                    }
                    let shown = decoded(&file).to_pixels();
                    let drawn = if shown.format() == format {
                        of_pixels.pixels().unwrap()
                    } else {
                        of_pixels.pixels_with_alpha().unwrap()
                    };
                    assert_eq!(shown, drawn, "{case} {target:?}");
                }
                let drawn = of_pixels.pixels().unwrap();
                assert_eq!((drawn.format(), drawn.extent()), (format, image.extent()));
                assert_eq!(drawn, of_files.pixels().unwrap(), "{case}");
            }
        }
    }
}

#[test]
fn front_door_without_alpha_is_black_outside_and_otherwise_the_same() {
    let image = Image::from_pixels(pixels(PixelFormat::Rgb, Depth::Eight));
    let posed = posed(true);
    let rendering = posed.render(&image).unwrap();
    let Samples::Eight(rgb) = rendering.pixels().unwrap().into_samples() else {
        panic!("8 bit");
    };
    let Samples::Eight(rgba) = rendering.pixels_with_alpha().unwrap().into_samples() else {
        panic!("8 bit");
    };
    let mut clear = 0;
    for (rgb, rgba) in rgb.chunks(3).zip(rgba.chunks(4)) {
        assert_eq!(rgb, &rgba[..3]);
        clear += u32::from(rgba == [0, 0, 0, 0]);
    }
    assert!(clear > 0);
}

#[test]
fn front_door_a_colour_outside_makes_grey_a_colour() {
    let image = Image::from_pixels(pixels(PixelFormat::Grey, Depth::Eight));
    let posed = posed(true);
    let rendering = posed.render(&image).unwrap();
    let red = rendering.clone().outside(Outside::Colour([255, 0, 0, 255]));
    assert_eq!(red.pixels().unwrap().format(), PixelFormat::Rgb);
    let value = rendering.outside(Outside::Value([256, 0, 0])).pixels();
    assert!(matches!(value, Err(WarpError::OutsideBeyondDepth { .. })));
}

#[test]
fn front_door_labels_of_every_width_follow_the_same_pixels() {
    let labels: Vec<u8> = (0..(WIDTH * HEIGHT) as usize)
        .map(|k| noise(k) as u8)
        .collect();
    let eight = LabelImage::from_labels8(WIDTH, HEIGHT, &labels).unwrap();
    let wide: Vec<u16> = labels.iter().map(|label| u16::from(*label) * 257).collect();
    let sixteen = LabelImage::from_labels16(WIDTH, HEIGHT, &wide).unwrap();
    let wider: Vec<u32> = labels.iter().map(|label| u32::from(*label) << 20).collect();
    let thirty_two = LabelImage::from_labels32(WIDTH, HEIGHT, &wider).unwrap();
    let posed = posed(true);
    let values = |labels| posed.render_labels(labels).unwrap().labels().unwrap();
    let LabelValues::Eight(drawn) = values(&eight) else {
        panic!("8 bit");
    };
    let expected = drawn.iter().map(|label| u16::from(*label) * 257).collect();
    assert_eq!(values(&sixteen), LabelValues::Sixteen(expected));
    let expected = drawn.iter().map(|label| u32::from(*label) << 20).collect();
    assert_eq!(values(&thirty_two), LabelValues::ThirtyTwo(expected));
    for format in Format::ALL {
        let file = posed.render_labels(&sixteen).unwrap().file(format);
        match file {
            Ok(file) => {
                let again = LabelImage::decode(&file, &Limits::default(), &|| false).unwrap();
                let at_rest = self::posed(false);
                let read = at_rest.render_labels(&again).unwrap().labels().unwrap();
                assert_eq!(read, values(&sixteen), "{format:?}");
                assert!(format.keeps_labels());
            }
            Err(error) => assert_eq!(error, WarpError::LabelFormat { format }),
        }
        let file = posed.render_labels(&thirty_two).unwrap().file(format);
        assert_eq!(file, Err(WarpError::WideLabels));
    }
}

#[test]
fn front_door_points_and_maps_agree_with_the_drawing() {
    let posed = posed(true);
    let points = [[20.0, 20.0], [35.5, 30.25]];
    let mapped = posed.map_points(&points).unwrap();
    let back = posed.unmap_points(&mapped).unwrap();
    for (point, back) in points.iter().zip(back) {
        let [x, y] = back.unwrap();
        assert!((x - point[0]).hypot(y - point[1]) < 1e-6);
    }
    let forward = posed.map(MapDirection::Forward).unwrap();
    let [x, y] = forward[(20 * WIDTH + 20) as usize].map(f64::from);
    let [[there, down]] = posed.map_points(&[[20.5, 20.5]]).unwrap()[..] else {
        panic!("one position");
    };
    assert!((x - there).hypot(y - down) < 0.25);
}

#[test]
fn front_door_what_does_not_fit_is_named() {
    let error = Image::from_rgb8(4, 3, vec![0; 35]).unwrap_err();
    assert_eq!(
        error.to_string(),
        "4 x 3 px of 3 samples each do not fit a buffer of 35 samples"
    );
    for (stride, length, fits) in [
        (12, 36, true),
        (16, 44, true),
        (16, 48, true),
        (16, 43, false),
        (16, 49, false),
        (11, 33, false),
        (usize::MAX, 36, false),
    ] {
        let pixels = Pixels::strided(4, 3, PixelFormat::Rgb, vec![0_u8; length], stride);
        assert_eq!(pixels.is_ok(), fits, "{stride} {length}");
    }
    assert!(Image::from_grey16(0, 3, vec![]).is_err());
    assert!(Image::from_rgba16(u32::MAX, u32::MAX, vec![]).is_err());
    assert!(LabelImage::from_labels32(2, 2, &[1, 2, 3]).is_err());
    let posed = posed(true);
    let other = Image::from_grey8(2, 1, vec![0, 0]).unwrap();
    assert_eq!(
        posed.render(&other).unwrap_err().to_string(),
        "the handles lie on an image of 61 x 47 px, but this one has 2 x 1 px"
    );
    assert!(posed.within(&other).is_err());
    assert!(Warper::new([1 << 21, 1], &[[0.0, 0.0]]).is_err());
    assert!(Warper::new([0, 1], &[[0.0, 0.0]]).is_err());
    assert!(Warper::new([9, 9], &[[f64::NAN, 0.0]]).is_err());
}

#[test]
fn front_door_cancelled_work_says_so() {
    let image = Image::from_pixels(pixels(PixelFormat::Rgb, Depth::Eight));
    let cancel = Cancel::new();
    let warper = Warper::new(image.extent(), &[[10.0, 10.0]]).unwrap();
    let posed = warper.cancelled_by(&cancel).pose(&[[12.0, 10.0]]).unwrap();
    let rendering = posed.render(&image).unwrap();
    assert!(rendering.pixels().is_ok());
    cancel.cancel();
    assert_eq!(rendering.pixels(), Err(WarpError::Cancelled));
    assert_eq!(rendering.file(Format::Png), Err(WarpError::Cancelled));
    assert_eq!(posed.map(MapDirection::Inverse), Err(WarpError::Cancelled));
    assert_eq!(posed.unmap_points(&[[1.0, 1.0]]), Err(WarpError::Cancelled));
}
