//! The identity through all layers: file in, q = p, file out, equal samples; RGB and RGBA, 8 and 16
//! bit, colours under alpha 0, any size from 1 x 1.

use std::ops::ControlFlow;
use std::sync::Arc;

use mlswarp::codec::{self, Compression, ImageLimits, PixelLayout, PngWriter};
use mlswarp::deform::Handle;
use mlswarp::geometry::Point;
use mlswarp::pixmap::{Channels, Depth, Extent};
use mlswarp::warp::{
    Folds, GridSpec, Image, Method, OutputSpec, PosedMesh, RasterSource, RenderJob, ResolvedRest,
    RestSpec,
};

use crate::golden::limits;
use crate::support::picture::decoded;

/// A PNG of pseudo-random samples, written in one strip after another.
fn noise(extent: Extent, channels: Channels, depth: Depth) -> Vec<u8> {
    let writer = PngWriter::new(
        PixelLayout {
            extent,
            channels,
            grey: false,
            depth,
        },
        Compression::None,
        None,
    );
    let row = extent.width() as usize * channels.count() * depth.bytes();
    let mut state = extent.width().wrapping_mul(31) + extent.height();
    let mut png = writer.head();
    let mut checksums = Vec::new();
    for index in 0..writer.strips() {
        let samples: Vec<u8> = (0..writer.rows(index).len() * row)
            .map(|k| {
                state = state.wrapping_mul(1_664_525).wrapping_add(1_013_904_223);
                // Every third pixel or so is fully transparent and keeps a colour beneath.
                if state >> 30 == 0 && k % 4 == 3 {
                    0
                } else {
                    (state >> 16) as u8
                }
            })
            .collect();
        let strip = writer.strip(index, &samples);
        png.extend(strip.bytes);
        checksums.push((strip.adler, strip.filtered_len));
    }
    png.extend(writer.tail(&checksums));
    png
}

#[test]
fn identity_returns_the_decoded_pixels() {
    let mut compared = 0;
    for (width, height) in [(1, 1), (1, 5), (7, 1), (3, 2), (37, 53), (256, 131)] {
        let extent = Extent::new(width, height).unwrap();
        for channels in [Channels::Rgb, Channels::Rgba] {
            for depth in [Depth::Eight, Depth::Sixteen] {
                let file = noise(extent, channels, depth);
                let image =
                    Arc::new(Image::decode(&file, &ImageLimits::default(), &|| false).unwrap());
                for (method, grid) in [
                    (Method::Rigid, GridSpec::Auto),
                    (Method::Affine, GridSpec::Pixel),
                    (
                        Method::Similarity,
                        GridSpec::Counts {
                            columns: 9,
                            rows: 4,
                        },
                    ),
                    (Method::ThinPlateSpline, GridSpec::Auto),
                ] {
                    let point = |x, y| Handle::Point(Point::new(x, y));
                    let line = Handle::Polyline(vec![Point::new(0.0, 0.0), Point::new(9.0, 5.0)]);
                    let other = if method == Method::ThinPlateSpline {
                        vec![point(0.0, 0.0), point(9.0, 5.0)]
                    } else {
                        vec![line]
                    };
                    for p in [vec![], [vec![point(0.5, 0.5)], other].concat()] {
                        let rest = RestSpec {
                            p,
                            method,
                            grid,
                            ..RestSpec::default()
                        };
                        let setup = ResolvedRest::new(&rest, extent, &limits(), &|| false).unwrap();
                        let pose = setup.pose(&rest.p).unwrap();
                        let output = OutputSpec::default();
                        let posed = PosedMesh::new(
                            &setup,
                            &setup.plan(&|| false).unwrap(),
                            &pose,
                            Folds::Reject,
                            &|| false,
                        )
                        .unwrap();
                        let warp = RenderJob::new(
                            RasterSource::Image(&image),
                            &posed,
                            &output,
                            &limits(),
                            &|| false,
                        )
                        .unwrap();
                        let mut png = Vec::new();
                        let _ = warp.write(0, &(), &mut |bytes| {
                            png.extend(bytes);
                            ControlFlow::Continue(())
                        });
                        let (got, want) = (
                            codec::decode(&png, &ImageLimits::default(), &|| false),
                            codec::decode(&file, &ImageLimits::default(), &|| false),
                        );
                        assert!(decoded(&png).samples == decoded(&file).samples);
                        assert!(
                            got.unwrap().pixmap == want.unwrap().pixmap,
                            "{width} x {height} {channels:?} {depth:?} {method:?}"
                        );
                        assert_eq!((posed.report().folds, posed.report().residual), (0, 0.0));
                        compared += 1;
                    }
                }
            }
        }
    }
    assert_eq!(compared, 6 * 2 * 2 * 4 * 2);
}
