//! What is drawn beside pictures: labels, coverage, and coordinate maps.

use std::collections::BTreeSet;
use std::ops::ControlFlow;

use rayon::prelude::*;

use super::sets::{Case, extent, randoms};
use crate::codec::{
    Compression, Encoding, Format, ImageLimits, Labels, Palette, PixelLayout, StepCounter, Writer,
    open_labels,
};
use crate::geometry::Point;
use crate::pixmap::{Channels, Depth, Extent};
use crate::render::{Canvas, InverseMap};
use crate::warp::{
    CanvasSpec, CoordinateMap, Folds, LabelImage, Limits, MapDirection, MapFormat, MapSpec,
    OutputSpec, PosedMesh, Quantity, RasterSource, RenderJob, ResolvedRest, WarpError,
};

/// Discs and stripes of 16-bit labels.
fn label(x: u32, y: u32) -> u16 {
    let disc = x.abs_diff(80).pow(2) + y.abs_diff(60).pow(2) < 30 * 30;
    if disc {
        40_000
    } else {
        u16::try_from(x / 20 * 7 + y / 30 * 1000).unwrap()
    }
}

fn encoded(shape: PixelLayout, values: &[u8], palette: Option<&Palette>) -> Vec<u8> {
    let writer = Writer::of_labels(shape, Encoding::Png(Compression::Fast), palette, None).unwrap();
    let (mut file, mut checksums) = (writer.head(), Vec::new());
    for strip in 0..writer.strips() {
        let (rows, row) = (
            writer.rows(strip),
            values.len() / shape.extent.height() as usize,
        );
        let mut samples = values[rows.start as usize * row..rows.end as usize * row].to_vec();
        checksums.push(writer.strip_into(strip, &mut samples, &mut file, &|| true));
    }
    file.extend(writer.tail(&checksums));
    file
}

fn posed(case: &Case) -> PosedMesh {
    let setup = ResolvedRest::new(&case.rest, case.extent, &Limits::default(), &|| false).unwrap();
    PosedMesh::new(
        &setup,
        &setup.plan(&|| false).unwrap(),
        &setup.pose(&case.q).unwrap(),
        Folds::Report,
        &|| false,
    )
    .unwrap()
}

fn drawn(subject: RasterSource<'_>, posed: &PosedMesh, output: &OutputSpec) -> Labels {
    let mut file = Vec::new();
    let _ = RenderJob::new(subject, posed, output, &Limits::default(), &|| false)
        .unwrap()
        .write(0, &(), &mut |bytes| {
            file.extend(bytes);
            ControlFlow::Continue(())
        });
    open_labels(&file, &ImageLimits::default(), &StepCounter::new(&|| false))
        .unwrap()
        .decode_labels()
        .unwrap()
        .labels
}

fn label_image(extent: Extent) -> LabelImage {
    let shape = PixelLayout {
        extent,
        channels: Channels::Rgb,
        grey: true,
        depth: Depth::Sixteen,
    };
    let values: Vec<u8> = (0..extent.height())
        .flat_map(|y| (0..extent.width()).flat_map(move |x| label(x, y).to_be_bytes()))
        .collect();
    LabelImage::decode(&encoded(shape, &values, None), &Limits::default(), &|| {
        false
    })
    .unwrap()
}

/// Labels are a subset of the source's and 0; each is that of the position that the mesh inverts
/// the pixel's centre to, and the mesh takes this position to the pixel. Depth and grey are kept.
#[test]
fn labels_are_those_of_the_inverse_of_the_pixel_centre() {
    let size = extent(160, 120);
    let image = label_image(size);
    let all: BTreeSet<u16> = (0..120)
        .flat_map(|y| (0..160).map(move |x| label(x, y)))
        .collect();
    randoms(size, 0..2).par_iter().for_each(|case| {
        let posed = posed(case);
        for (canvas, width) in [
            (CanvasSpec::Same, None),
            (CanvasSpec::Same, Some(53)),
            (
                CanvasSpec::Box(Canvas {
                    x: -30,
                    y: 10,
                    extent: extent(240, 90),
                }),
                None,
            ),
        ] {
            for format in [Format::Png, Format::Tiff] {
                let output = OutputSpec {
                    canvas,
                    width,
                    format,
                    ..OutputSpec::default()
                };
                let out = drawn(RasterSource::Labels(&image), &posed, &output);
                assert_eq!(
                    (out.shape.samples(), out.shape.depth, &out.palette),
                    (1, Depth::Sixteen, &None)
                );
                let target = output
                    .target(size, &posed, &Limits::default(), &|| false)
                    .unwrap();
                let mut positions = vec![[0.0; 2]; target.extent.pixels() as usize];
                InverseMap::new(posed.mesh(), target.extent, target.canvas).rows(
                    0..target.extent.height(),
                    &mut positions,
                    &|| false,
                );
                for (value, [x, y]) in out.values.as_chunks::<2>().0.iter().zip(positions) {
                    let value = u16::from_be_bytes(*value);
                    if x.is_nan() {
                        assert_eq!(value, 0, "{}", case.name);
                    } else {
                        assert_eq!(
                            value,
                            label((x as u32).min(159), (y as u32).min(119)),
                            "{}: {x} {y}",
                            case.name
                        );
                        assert!(all.contains(&value));
                    }
                }
            }
        }
    });
}

#[test]
fn palettes_are_kept_and_lossy_formats_refused() {
    let size = extent(160, 120);
    let shape = PixelLayout {
        extent: size,
        channels: Channels::Rgb,
        grey: true,
        depth: Depth::Eight,
    };
    let palette = Palette {
        colours: vec![[9, 8, 7], [255, 0, 0], [0, 255, 0]],
        alpha: vec![0, 77],
    };
    let values: Vec<u8> = (0..160 * 120).map(|k| (k / 37 % 3) as u8).collect();
    let image = LabelImage::decode(
        &encoded(shape, &values, Some(&palette)),
        &Limits::default(),
        &|| false,
    )
    .unwrap();
    let posed = posed(&randoms(size, 0..1)[0]);
    let out = drawn(RasterSource::Labels(&image), &posed, &OutputSpec::default());
    assert_eq!(out.palette, Some(palette));
    assert!(out.values.iter().all(|value| *value < 3));
    for format in [Format::Jpeg, Format::WebP] {
        let output = OutputSpec {
            format,
            ..OutputSpec::default()
        };
        let refused = RenderJob::new(
            RasterSource::Labels(&image),
            &posed,
            &output,
            &Limits::default(),
            &|| false,
        )
        .map(drop);
        assert_eq!(refused, Err(WarpError::LabelFormat { format }));
    }
    let etag = |subject| {
        RenderJob::new(
            subject,
            &posed,
            &OutputSpec::default(),
            &Limits::default(),
            &|| false,
        )
        .unwrap()
        .etag()
    };
    assert_ne!(
        etag(RasterSource::Labels(&image)),
        etag(RasterSource::Coverage(size))
    );
}

#[test]
fn coverage_is_grey_and_is_where_positions_are() {
    let size = extent(160, 120);
    for case in &randoms(size, 0..1)[..6] {
        let posed = posed(case);
        for format in [Format::Png, Format::WebP, Format::Tiff] {
            let out = drawn(
                RasterSource::Coverage(size),
                &posed,
                &OutputSpec {
                    format,
                    ..OutputSpec::default()
                },
            );
            let samples = if format == Format::WebP { 3 } else { 1 };
            assert_eq!((out.shape.samples(), out.shape.extent), (samples, size));
            let mut positions = vec![[0.0; 2]; 160 * 120];
            InverseMap::new(posed.mesh(), size, None).rows(0..120, &mut positions, &|| false);
            let is_wrong = |(value, [x, _]): (&u8, &[f32; 2])| {
                if x.is_nan() {
                    *value == 255
                } else {
                    *value == 0
                }
            };
            let wrong = out
                .values
                .iter()
                .step_by(samples)
                .zip(&positions)
                .filter(|pixel| is_wrong(*pixel))
                .count();
            assert_eq!(wrong, 0, "{}", case.name);
        }
    }
}

fn file(map: &CoordinateMap) -> Vec<u8> {
    let file: Vec<u8> = (0..map.bands())
        .flat_map(|band| map.band(band, &|| false).unwrap())
        .collect();
    assert_eq!(file.len() as u64, map.file_bytes());
    file
}

fn map(case: &Case, spec: &MapSpec) -> (PosedMesh, CoordinateMap) {
    let posed = posed(case);
    let target = spec
        .target(&posed, case.extent, &Limits::default(), &|| false)
        .unwrap();
    let map = CoordinateMap::new(spec, &posed, target).unwrap();
    (posed, map)
}

/// The numbers of a file, with 1/2 added: px of the contract.
fn numbers(file: &[u8], pixels: usize, format: MapFormat) -> Vec<[f32; 2]> {
    let (start, read): (usize, fn([u8; 4]) -> f32) = match format {
        MapFormat::Npy => (file.len() - 8 * pixels, f32::from_le_bytes),
        MapFormat::Tiff => (8, f32::from_be_bytes),
    };
    let number = |bytes: &[u8]| read(bytes.try_into().unwrap()) + 0.5;
    file[start..start + 8 * pixels]
        .chunks_exact(8)
        .map(|p| [number(&p[..4]), number(&p[4..])])
        .collect()
}

#[test]
fn maps_have_the_positions_that_are_drawn() {
    let size = extent(160, 120);
    for case in &randoms(size, 0..1)[..6] {
        for format in MapFormat::ALL {
            for (canvas, width) in [
                (CanvasSpec::Same, None),
                (CanvasSpec::Fit, None),
                (CanvasSpec::Same, Some(320)),
            ] {
                let spec = MapSpec {
                    canvas,
                    width,
                    format,
                    ..MapSpec::default()
                };
                let (posed, inverse) = map(case, &spec);
                let (target, pixels) =
                    (inverse.target(), inverse.target().extent.pixels() as usize);
                let mut want = vec![[0.0; 2]; pixels];
                InverseMap::new(posed.mesh(), target.extent, target.canvas).rows(
                    0..target.extent.height(),
                    &mut want,
                    &|| false,
                );
                let got = numbers(&file(&inverse), pixels, format);
                let is_same = |(a, b): (&[f32; 2], &[f32; 2])| {
                    a[0].is_nan() && b[0].is_nan()
                        || (a[0] - b[0]).abs() + (a[1] - b[1]).abs() < 1e-4
                };
                assert!(
                    got.iter().zip(&want).all(is_same),
                    "{}, {spec:?}",
                    case.name
                );

                let (posed, forward) = map(
                    case,
                    &MapSpec {
                        direction: MapDirection::Forward,
                        ..spec
                    },
                );
                assert_ne!(forward.etag(), inverse.etag());
                let [left, top, ..] = target.canvas.unwrap_or(Canvas::of(size)).edges();
                let scale = width.map_or(1.0, |width| 160.0 / f64::from(width));
                for (k, [x, y]) in numbers(&file(&forward), pixels, format).iter().enumerate() {
                    let (i, j) = (
                        k % target.extent.width() as usize,
                        k / target.extent.width() as usize,
                    );
                    let rest = Point::new(
                        left + (i as f64 + 0.5) * scale,
                        top + (j as f64 + 0.5) * scale,
                    );
                    match posed.mesh().map(rest) {
                        None => assert!(x.is_nan() && y.is_nan()),
                        Some(p) => assert!(
                            p.distance(Point::new((*x).into(), (*y).into())) < 1e-3,
                            "{p:?} {x} {y}"
                        ),
                    }
                }
            }
        }
    }
}

#[test]
fn map_files_are_those_of_their_formats() {
    let case = &randoms(extent(160, 120), 0..1)[0];
    let spec = MapSpec {
        width: Some(777),
        ..MapSpec::default()
    };
    let (_, npy) = map(case, &spec);
    let bytes = file(&npy);
    let head = &bytes[..bytes.len() - 777 * 583 * 8];
    assert!(
        npy.bands() > 3
            && head.len().is_multiple_of(64)
            && head.starts_with(b"\x93NUMPY\x01\0")
            && head.ends_with(b"\n")
    );
    assert!(
        String::from_utf8_lossy(head)
            .contains("{'descr': '<f4', 'fortran_order': False, 'shape': (583, 777, 2), }")
    );
    assert_eq!(
        usize::from(u16::from_le_bytes([head[8], head[9]])),
        head.len() - 10
    );

    // The tags that another decoder needs.
    let (_, tiff) = map(
        case,
        &MapSpec {
            format: MapFormat::Tiff,
            ..spec
        },
    );
    let bytes = file(&tiff);
    let mut decoder = ::tiff::decoder::Decoder::new(std::io::Cursor::new(&bytes)).unwrap();
    assert_eq!(decoder.dimensions().unwrap(), (777, 583));
    let ::tiff::decoder::DecodingResult::F32(values) = decoder.read_image().unwrap() else {
        panic!("f32")
    };
    let want = numbers(&bytes, 777 * 583, MapFormat::Tiff);
    assert_eq!(values.len(), 2 * want.len());
    assert!(
        values
            .iter()
            .zip(want.as_flattened())
            .all(|(a, b)| a.is_nan() && b.is_nan() || (a + 0.5).to_bits() == b.to_bits())
    );
}

#[test]
fn maps_over_the_limits_are_refused_before_anything_is_posed() {
    let refused = |spec: MapSpec, size: Extent| match spec.check(size, &Limits::default()) {
        Err(WarpError::TooLarge { what, actual, .. }) => (what, actual),
        other => panic!("{other:?}"),
    };
    let large = extent(16_384, 16_384);
    assert_eq!(
        refused(MapSpec::default(), large),
        (Quantity::MapPixels, 1 << 28)
    );
    assert_eq!(
        refused(MapSpec::default(), extent(16_385, 1)),
        (Quantity::MapSide, 16_385)
    );
    assert_eq!(
        refused(
            MapSpec {
                width: Some(16_384),
                ..MapSpec::default()
            },
            extent(100, 100)
        )
        .0,
        Quantity::OutputPixels
    );
    let canvas = CanvasSpec::Box(Canvas {
        x: 0,
        y: 0,
        extent: large,
    });
    assert_eq!(
        refused(
            MapSpec {
                canvas,
                ..MapSpec::default()
            },
            extent(100, 100)
        )
        .0,
        Quantity::CanvasPixels
    );
    assert_eq!(
        MapSpec::default().check(extent(7000, 7000), &Limits::default()),
        Ok(())
    );
}
