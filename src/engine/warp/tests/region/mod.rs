//! Regions: what is outside stays bit for bit, what is inside is the warp, and the transition is as
//! wide as the feather.

mod drawn_part;

use super::drawn::shown;
use super::sets::{Case, FEW_HANDLES, Kind, LINES, MIXED, MORE, Noise, extent, random};
use crate::codec::{Format, Labels, PixelLayout};
use crate::geometry::Point;
use crate::pixmap::{Channels, Depth, Extent, Pixmap, Samples};
use crate::render::{Canvas, Filter, Outside};
use crate::warp::{
    CanvasSpec, Folds, GridSpec, Holes, Image, LabelImage, Limits, Method, OutputSpec, PosedMesh,
    RasterSource, Region, RenderJob, ResolvedRest, RestSpec, Warning,
};

const SIDE: (u32, u32) = (120, 90);
/// Rest positions nearer than this to the edge of a mask may be mixed, px: the reach of a filter,
/// and of a mean of a few pixels.
const NEAR_BORDER_PX: f64 = 5.0;

/// A picture of every sample value: noise, so that a wrong pixel is seen.
fn noise(size: Extent, channels: Channels, depth: Depth) -> Image {
    let mut noise = Noise(11);
    let count = size.pixels() as usize * channels.count();
    let mut sample = || (noise.signed() * 32_768.0 + 32_768.0) as u16;
    let samples = match depth {
        Depth::Eight => Samples::Eight((0..count).map(|_| (sample() >> 8) as u8).collect()),
        Depth::Sixteen => Samples::Sixteen((0..count).map(|_| sample()).collect()),
    };
    Image::of_pixmap("noise", Pixmap::new(size, channels, samples), false)
}

/// The mask of a disc in the middle: its radius, and the width of its feather outside of it, px.
#[derive(Clone, Copy, Debug)]
struct Disc {
    radius: f64,
    feather: f64,
}

impl Disc {
    fn value(self, p: Point) -> f64 {
        let far =
            p.distance(Point::new(f64::from(SIDE.0) / 2.0, f64::from(SIDE.1) / 2.0)) - self.radius;
        if self.feather > 0.0 {
            (1.0 - far / self.feather).clamp(0.0, 1.0)
        } else {
            f64::from(u8::from(far <= 0.0))
        }
    }

    /// As grey values, or as an alpha of black pixels.
    fn image(self, channels: Channels, depth: Depth) -> Image {
        let pixels = (0..SIDE.1).flat_map(|y| {
            (0..SIDE.0).map(move |x| Point::new(f64::from(x) + 0.5, f64::from(y) + 0.5))
        });
        let values = pixels.flat_map(|p| match channels {
            Channels::Rgb => vec![self.value(p); 3],
            Channels::Rgba => vec![0.0, 0.0, 0.0, self.value(p)],
        });
        let samples = match depth {
            Depth::Eight => {
                Samples::Eight(values.map(|value| (value * 255.0).round() as u8).collect())
            }
            Depth::Sixteen => Samples::Sixteen(
                values
                    .map(|value| (value * 65_535.0).round() as u16)
                    .collect(),
            ),
        };
        Image::of_pixmap(
            &format!("{self:?}"),
            Pixmap::new(extent(SIDE.0, SIDE.1), channels, samples),
            true,
        )
    }

    fn region(self) -> Region {
        Region::new(&self.image(Channels::Rgb, Depth::Eight))
    }
}

const HARD: Disc = Disc {
    radius: 24.0,
    feather: 0.0,
};
const SOFT: Disc = Disc {
    radius: 15.0,
    feather: 20.0,
};

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

fn at_rest(case: &Case) -> PosedMesh {
    posed(&Case {
        q: case.rest.p.clone(),
        ..case.clone()
    })
}

/// The pixels of a warp, and its channels and depth.
#[derive(Debug, PartialEq)]
struct Pixels {
    size: Extent,
    bytes: Vec<u8>,
    channels: Channels,
    depth: Depth,
}

impl Pixels {
    /// Samples of pixel `k`; alpha is the greatest value where there is none.
    fn at(&self, k: usize) -> [u16; 4] {
        let count = self.channels.count();
        let most = if self.depth == Depth::Eight {
            255
        } else {
            u16::MAX
        };
        [0, 1, 2, 3].map(|c| match self.depth {
            _ if c >= count => most,
            Depth::Eight => u16::from(self.bytes[k * count + c]),
            Depth::Sixteen => u16::from_be_bytes([
                self.bytes[2 * (k * count + c)],
                self.bytes[2 * (k * count + c) + 1],
            ]),
        })
    }

    fn all(&self) -> impl Iterator<Item = [u16; 4]> + '_ {
        (0..self.size.pixels() as usize).map(|k| self.at(k))
    }
}

fn pixels(warp: &RenderJob, step: usize, depth: Depth) -> Pixels {
    let (size, pixel) = (warp.drawer.target(), warp.drawer.pixel_bytes());
    let row = size.width() as usize * pixel;
    let mut bytes = vec![0; row * size.height() as usize];
    for (first, out) in (0..size.height())
        .step_by(step)
        .zip(bytes.chunks_mut(step * row))
    {
        warp.drawer
            .band(first..size.height().min(first + step as u32), out, &|| {
                false
            });
    }
    let channels = if pixel == 3 * depth.bytes() {
        Channels::Rgb
    } else {
        Channels::Rgba
    };
    Pixels {
        size,
        bytes,
        channels,
        depth,
    }
}

fn draw(subject: RasterSource<'_>, posed: &PosedMesh, output: &OutputSpec) -> Pixels {
    let depth = match subject {
        RasterSource::Image(image) => image.source.pixmap().depth(),
        _ => Depth::Eight,
    };
    pixels(
        &RenderJob::new(subject, posed, output, &Limits::default(), &|| false).unwrap(),
        1000,
        depth,
    )
}

fn cases() -> Vec<Case> {
    let size = extent(SIDE.0, SIDE.1);
    let methods = [
        Method::Rigid,
        Method::Similarity,
        Method::Affine,
        Method::ThinPlateSpline,
    ];
    // Not so far that means over what is shrunk reach into the mask from afar.
    let kinds = [FEW_HANDLES, MORE, LINES, MIXED].map(|kind| Kind {
        reach: 0.03,
        ..kind
    });
    let all = methods
        .into_iter()
        .enumerate()
        .flat_map(|(k, method)| (0..3).map(move |seed| (k, method, seed)));
    all.filter(|(k, method, _)| kinds[*k].lines == 0 || *method != Method::ThinPlateSpline)
        .map(|(k, method, seed)| {
            random(
                size,
                kinds[(k + seed)
                    % if method == Method::ThinPlateSpline {
                        2
                    } else {
                        4
                    }],
                method,
                1.5,
                seed as u64,
            )
        })
        .collect()
}

#[test]
fn outside_is_the_source_and_inside_is_the_warp_bit_for_bit() {
    let size = extent(SIDE.0, SIDE.1);
    let mut counts = [0; 3];
    for (n, case) in cases().into_iter().enumerate() {
        let (channels, depth) = [
            (Channels::Rgb, Depth::Eight),
            (Channels::Rgba, Depth::Eight),
            (Channels::Rgb, Depth::Sixteen),
        ][n % 3];
        let image = noise(size, channels, depth);
        let disc = if n % 2 == 0 { HARD } else { SOFT };
        let mask = [
            disc.image(Channels::Rgb, Depth::Eight),
            disc.image(Channels::Rgba, Depth::Sixteen),
        ];
        let filter = [Filter::Bilinear, Filter::Nearest, Filter::Bicubic][n / 2 % 3];
        let output = OutputSpec {
            filter,
            ..OutputSpec::default()
        };
        let (whole, source) = (
            draw(RasterSource::Image(&image), &posed(&case), &output),
            draw(RasterSource::Image(&image), &at_rest(&case), &output),
        );
        let moved = posed(&case).within(Region::new(&mask[n % 2]));
        let part = draw(RasterSource::Image(&image), &moved, &output);
        assert_eq!(
            (part.channels, part.depth),
            (channels, depth),
            "no alpha is added"
        );
        for (k, position) in shown(&moved, size).into_iter().enumerate() {
            let distance = position.map_or(f64::INFINITY, |p| {
                p.distance(Point::new(f64::from(SIDE.0) / 2.0, f64::from(SIDE.1) / 2.0))
            });
            if distance > disc.radius + disc.feather + NEAR_BORDER_PX {
                assert_eq!(part.at(k), source.at(k), "{}: pixel {k}", case.name);
                counts[0] += 1;
            } else if distance < disc.radius - NEAR_BORDER_PX {
                assert_eq!(part.at(k), whole.at(k), "{}: pixel {k}", case.name);
                counts[1] += 1;
            } else if part.at(k) != source.at(k) {
                counts[2] += 1;
            }
        }
    }
    assert!(counts.into_iter().all(|count| count > 2000), "{counts:?}");
}

#[test]
fn a_pose_at_rest_is_the_source() {
    let size = extent(SIDE.0, SIDE.1);
    for (channels, depth) in [
        (Channels::Rgba, Depth::Eight),
        (Channels::Rgb, Depth::Sixteen),
        (Channels::Rgba, Depth::Sixteen),
    ] {
        let image = noise(size, channels, depth);
        let still = at_rest(&cases()[0]);
        for (holes, disc) in [
            (Holes::Keep, SOFT),
            (Holes::Transparent, SOFT),
            (Holes::Transparent, HARD),
        ] {
            let output = OutputSpec {
                holes,
                ..OutputSpec::default()
            };
            let want = draw(RasterSource::Image(&image), &still, &output);
            let still = at_rest(&cases()[0]).within(disc.region());
            assert!(
                draw(RasterSource::Image(&image), &still, &output) == want,
                "{channels:?} {depth:?} {holes:?}"
            );
            assert!(
                draw(RasterSource::Holes(&disc.region()), &still, &output)
                    .bytes
                    .iter()
                    .all(|hole| *hole == 0),
                "nothing has moved"
            );
        }
    }
}

#[test]
fn a_white_mask_is_the_warp_without_a_region_where_it_is_drawn() {
    let size = extent(SIDE.0, SIDE.1);
    let white = Disc {
        radius: 1e3,
        feather: 0.0,
    }
    .region();
    for (n, case) in cases().into_iter().enumerate() {
        let image = noise(size, [Channels::Rgb, Channels::Rgba][n % 2], Depth::Eight);
        let holes = [Holes::Keep, Holes::Transparent][n / 2 % 2];
        let canvas = CanvasSpec::Box(Canvas {
            x: -20,
            y: -15,
            extent: extent(160, 120),
        });
        let output = OutputSpec {
            holes,
            canvas,
            ..OutputSpec::default()
        };
        let (whole, still) = (
            draw(RasterSource::Image(&image), &posed(&case), &output),
            draw(RasterSource::Image(&image), &at_rest(&case), &output),
        );
        let part = draw(
            RasterSource::Image(&image),
            &posed(&case).within(white.clone()),
            &output,
        );
        // Where the posed picture is drawn: without alpha, all of it.
        let solid = noise(size, Channels::Rgb, Depth::Eight);
        let covered = draw(RasterSource::Image(&solid), &posed(&case), &output);
        for (k, covered) in covered.all().enumerate() {
            let want = match (covered[3], holes) {
                (255, _) => whole.at(k),
                (_, Holes::Keep) => still.at(k),
                (_, Holes::Transparent) => [0; 4],
            };
            assert_eq!(part.at(k), want, "{}: pixel {k}", case.name);
        }
    }
}

#[test]
fn holes_are_what_is_left_transparent() {
    let size = extent(SIDE.0, SIDE.1);
    let (mut open, mut closed) = (0, 0);
    for (n, case) in cases().into_iter().enumerate() {
        let image = noise(size, Channels::Rgb, [Depth::Eight, Depth::Sixteen][n % 2]);
        let region = [HARD, SOFT][n / 2 % 2].region();
        let moved = posed(&case).within(region.clone());
        let output = OutputSpec {
            holes: Holes::Transparent,
            ..OutputSpec::default()
        };
        let (part, holes) = (
            draw(RasterSource::Image(&image), &moved, &output),
            draw(RasterSource::Holes(&region), &moved, &output),
        );
        let kept = draw(RasterSource::Image(&image), &moved, &OutputSpec::default());
        assert_eq!(
            (holes.channels, holes.depth, part.channels),
            (Channels::Rgb, Depth::Eight, Channels::Rgba)
        );
        for (k, (hole, pixel)) in holes.all().zip(part.all()).enumerate() {
            assert!(hole[0] == hole[1] && hole[1] == hole[2], "grey");
            let alpha = if n % 2 == 0 {
                pixel[3]
            } else {
                (f64::from(pixel[3]) / 257.0).round() as u16
            };
            assert_eq!(alpha + hole[0], 255, "{}: pixel {k}", case.name);
            if hole[0] == 0 && alpha == 255 {
                closed += 1;
                assert_eq!(pixel[..3], kept.at(k)[..3], "{}: pixel {k}", case.name);
            }
            open += usize::from(hole[0] > 200);
        }
    }
    assert!(open > 300 && closed > 10_000, "{open} {closed}");
}

/// The largest difference between neighbouring pixels of a grey ramp, whose middle is moved to the
/// right.
fn largest_step(disc: Disc, filter: Filter) -> u16 {
    let size = extent(SIDE.0, SIDE.1);
    let ramp = (0..SIDE.1)
        .flat_map(|_| (0..SIDE.0).flat_map(|x| [(x as u16) * 500; 3]))
        .collect();
    let image = Image::of_pixmap(
        "ramp",
        Pixmap::new(size, Channels::Rgb, Samples::Sixteen(ramp)),
        true,
    );
    let mut case = random(size, FEW_HANDLES, Method::Rigid, 1.0, 1);
    // A translation by 6 px, which changes the ramp by 3000.
    case.q = case
        .rest
        .p
        .iter()
        .map(|p| crate::deform::Handle::Point(Point::new(p.places()[0].x + 6.0, p.places()[0].y)))
        .collect();
    let output = OutputSpec {
        filter,
        ..OutputSpec::default()
    };
    let part = draw(
        RasterSource::Image(&image),
        &posed(&case).within(disc.region()),
        &output,
    );
    let values: Vec<u16> = part.all().map(|pixel| pixel[0]).collect();
    let width = SIDE.0 as usize;
    let across = values
        .chunks_exact(width)
        .flat_map(|row| row.windows(2).map(|pair| pair[0].abs_diff(pair[1])));
    let down = (width..values.len()).map(|k| values[k].abs_diff(values[k - width]));
    across.chain(down).max().unwrap()
}

#[test]
fn a_feather_has_no_step() {
    for filter in [Filter::Bilinear, Filter::Bicubic] {
        // The ramp has 500 a pixel, and a feather of 20 px spreads 3000: 150 a pixel.
        let soft = largest_step(SOFT, filter);
        assert!(soft <= 500 + 150 + 10, "{filter:?}: {soft}");
        assert!(
            largest_step(HARD, filter) > 2000,
            "a mask without a feather has a step"
        );
    }
}
