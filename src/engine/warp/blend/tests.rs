//! Laws of blends, and the sum against its definition in double precision.

#![expect(
    clippy::cast_possible_truncation,
    reason = "samples and sizes of small images"
)]

use super::*;
use crate::deform::{Class, Handle, fitted};
use crate::geometry::Point;
use crate::pixmap::{Channels, Depth, Extent, Pixmap, Samples};
use crate::render::Canvas;
use crate::warp::{
    Align, Folds, Image, Limits, OutputSpec, PosedMesh, RasterSource, ResolvedRest, RestSpec,
    Target, WarpError,
};

/// Random numbers, the same on every run.
struct Numbers(u64);

impl Numbers {
    fn next(&mut self) -> f64 {
        self.0 = self
            .0
            .wrapping_mul(6_364_136_223_846_793_005)
            .wrapping_add(1_442_695_040_888_963_407);
        (self.0 >> 11) as f64 / (1_u64 << 53) as f64
    }
}

fn picture(seed: u64, channels: Channels, depth: Depth) -> Image {
    let extent = Extent::new(61, 47).unwrap();
    let count = extent.pixels() as usize * channels.count();
    let mut numbers = Numbers(seed);
    let samples = match depth {
        Depth::Eight => Samples::Eight(
            (0..count)
                .map(|_| (numbers.next() * 255.99) as u8)
                .collect(),
        ),
        Depth::Sixteen => Samples::Sixteen(
            (0..count)
                .map(|_| (numbers.next() * 65_535.9) as u16)
                .collect(),
        ),
    };
    let name = format!("{seed} {channels:?} {depth:?}");
    Image::of_pixmap(&name, Pixmap::new(extent, channels, samples), false)
}

fn points(places: &[(f64, f64)]) -> Vec<Handle> {
    places
        .iter()
        .map(|(x, y)| Handle::Point(Point::new(*x, *y)))
        .collect()
}

fn posed(image: &Image, p: &[Handle], q: &[Handle]) -> PosedMesh {
    let rest = RestSpec {
        p: p.to_vec(),
        ..RestSpec::default()
    };
    let resolved = ResolvedRest::new(&rest, image.extent(), &Limits::default(), &|| false).unwrap();
    let pose = resolved.pose(q).unwrap();
    PosedMesh::new(
        &resolved,
        &resolved.plan(&|| false).unwrap(),
        &pose,
        Folds::Report,
        &|| false,
    )
    .unwrap()
}

struct Part<'a> {
    image: &'a Image,
    p: Vec<Handle>,
    weight: f64,
    is_mirrored: bool,
}

fn blend(parts: &[Part<'_>], target: &[Handle], space: BlendSpace) -> BlendedImage {
    let extent = parts[0].image.extent();
    let weights: Vec<f64> = parts.iter().map(|part| part.weight).collect();
    let mut sum = ImageSum::new(Canvas::of(extent), extent, space, &weights);
    for part in parts {
        let q = if part.is_mirrored {
            MirrorPairs::of_positions(target, &|| false)
                .unwrap()
                .mirrored(target, extent.width().into())
        } else {
            target.to_vec()
        };
        let mesh = posed(part.image, &part.p, &q);
        let how = (part.weight, part.is_mirrored.then_some(extent.width()));
        sum.add(part.image, &mesh, how, &OutputSpec::default(), &|| false)
            .unwrap();
    }
    sum.finish(&|| false).unwrap().unwrap()
}

fn part<'a>(image: &'a Image, p: &[Handle], weight: f64) -> Part<'a> {
    Part {
        image,
        p: p.to_vec(),
        weight,
        is_mirrored: false,
    }
}

fn values(image: &Image) -> Vec<i32> {
    match image.source.pixmap().samples() {
        Samples::Eight(samples) => samples.iter().map(|v| i32::from(*v)).collect(),
        Samples::Sixteen(samples) => samples.iter().map(|v| i32::from(*v)).collect(),
    }
}

fn largest_difference(a: &Image, b: &Image) -> i32 {
    let (a, b) = (values(a), values(b));
    assert_eq!(a.len(), b.len());
    a.iter().zip(&b).map(|(a, b)| (a - b).abs()).max().unwrap()
}

const SPACES: [BlendSpace; 2] = [BlendSpace::Srgb, BlendSpace::Linear];
const KINDS: [(Channels, Depth); 4] = [
    (Channels::Rgb, Depth::Eight),
    (Channels::Rgba, Depth::Eight),
    (Channels::Rgb, Depth::Sixteen),
    (Channels::Rgba, Depth::Sixteen),
];

fn face() -> Vec<Handle> {
    points(&[
        (15.0, 15.0),
        (45.0, 14.0),
        (30.0, 25.0),
        (20.0, 35.0),
        (41.0, 36.0),
    ])
}

#[test]
fn one_image_is_itself_to_the_bit() {
    for (channels, depth) in KINDS {
        for space in SPACES {
            let image = picture(1, channels, depth);
            let blended = blend(&[part(&image, &face(), 1.0)], &face(), space);
            assert_eq!(
                blended.image.source.pixmap().samples(),
                image.source.pixmap().samples(),
                "{channels:?} {depth:?} {space:?}"
            );
            assert_eq!(blended.clamped, 0);
        }
    }
}

#[test]
fn two_equal_images_give_it_back_with_every_weight() {
    for (channels, depth) in KINDS {
        for space in SPACES {
            for s in [0.0, 0.1, 1.0 / 3.0, 0.5, 0.9, 1.0] {
                let image = picture(2, channels, depth);
                let parts = [part(&image, &face(), 1.0 - s), part(&image, &face(), s)];
                let blended = blend(&parts, &face(), space);
                let pairs = values(&blended.image);
                for (pixel, source) in pairs
                    .chunks(channels.count())
                    .zip(values(&image).chunks(channels.count()))
                {
                    if channels == Channels::Rgb || source[3] > 0 {
                        assert_eq!(pixel, source, "{channels:?} {depth:?} {space:?} {s}");
                    }
                }
            }
        }
    }
}

#[test]
fn order_and_grouping_of_images_do_not_matter() {
    let images = [3, 4, 5].map(|seed| picture(seed, Channels::Rgba, Depth::Eight));
    let shapes = [
        face(),
        points(&[
            (12.0, 17.0),
            (44.0, 12.0),
            (31.0, 27.0),
            (22.0, 33.0),
            (39.0, 38.0),
        ]),
        points(&[
            (17.0, 13.0),
            (47.0, 16.0),
            (28.0, 24.0),
            (19.0, 36.0),
            (43.0, 33.0),
        ]),
    ];
    let share = |k: usize, weight: f64| part(&images[k], &shapes[k], weight);
    let third = |k: usize| share(k, 1.0 / 3.0);
    let sixth = |k: usize| share(k, 1.0 / 6.0);
    let one = blend(&[third(0), third(1), third(2)], &face(), BlendSpace::Srgb);
    for parts in [
        vec![third(2), third(0), third(1)],
        vec![sixth(0), third(1), sixth(2), sixth(0), sixth(2)],
    ] {
        let other = blend(&parts, &face(), BlendSpace::Srgb);
        assert!(largest_difference(&one.image, &other.image) <= 1);
    }
}

#[test]
fn colours_are_linear_in_their_weights() {
    for depth in [Depth::Eight, Depth::Sixteen] {
        let images = [12, 13].map(|seed| picture(seed, Channels::Rgb, depth));
        let [quarter, half, most] = [0.25, 0.5, 0.75].map(|s| {
            let parts = [
                part(&images[0], &face(), 1.0 - s),
                part(&images[1], &face(), s),
            ];
            values(&blend(&parts, &face(), BlendSpace::Srgb).image)
        });
        for ((a, b), c) in quarter.iter().zip(&half).zip(&most) {
            assert!((a + c - 2 * b).abs() <= 2, "{a} {b} {c}");
        }
    }
}

/// The definition, from the warped images in double precision.
#[test]
fn the_sum_is_that_of_the_warped_images() {
    for (channels, depth) in KINDS {
        for (weights, name) in [([0.25, 0.75], "morph"), ([1.5, -0.5], "caricature")] {
            let images = [6, 7].map(|seed| picture(seed, channels, depth));
            let shapes = [
                face(),
                points(&[
                    (12.0, 17.0),
                    (44.0, 12.0),
                    (31.0, 27.0),
                    (22.0, 33.0),
                    (39.0, 38.0),
                ]),
            ];
            let target = points(&[
                (20.0, 12.0),
                (50.0, 12.0),
                (33.0, 24.0),
                (22.0, 38.0),
                (45.0, 36.0),
            ]);
            let parts = [0, 1].map(|k| part(&images[k], &shapes[k], weights[k]));
            let blended = blend(&parts, &target, BlendSpace::Srgb);
            // Each image alone gives its warp, rounded once.
            let alone = [0, 1].map(|k| {
                blend(
                    &[part(&images[k], &shapes[k], 1.0)],
                    &target,
                    BlendSpace::Srgb,
                )
                .image
            });
            let largest = f64::from(depth.largest());
            let rgba = |image: &Image| {
                let count = image.source.pixmap().channels().count();
                let pixel = move |pixel: &[i32]| {
                    let value = |k: usize| pixel.get(k).map_or(1.0, |v| f64::from(*v) / largest);
                    [0, 1, 2, 3].map(value)
                };
                values(image).chunks(count).map(pixel).collect::<Vec<_>>()
            };
            let (first, second, sum) = (rgba(&alone[0]), rgba(&alone[1]), rgba(&blended.image));
            for ((a, b), sum) in first.iter().zip(&second).zip(sum) {
                let (alpha, colour): (f64, [f64; 3]) = if weights[1] < 0.0 {
                    (
                        a[3].min(b[3]),
                        [0, 1, 2].map(|k| weights[0] * a[k] + weights[1] * b[k]),
                    )
                } else {
                    let shares = [weights[0] * a[3], weights[1] * b[3]];
                    let alpha = shares[0] + shares[1];
                    let mean = |k: usize| (shares[0] * a[k] + shares[1] * b[k]) / alpha.max(1e-12);
                    (alpha, [0, 1, 2].map(mean))
                };
                assert!(
                    (sum[3] - alpha).abs() * largest <= 1.0,
                    "{name} {alpha} {sum:?}"
                );
                if alpha > 1.5 / largest {
                    for (k, colour) in colour.into_iter().enumerate() {
                        let difference = (sum[k] - colour.clamp(0.0, 1.0)).abs() * largest;
                        assert!(difference <= 1.0, "{name} {k} {colour} {sum:?}");
                    }
                }
            }
        }
    }
}

#[test]
fn an_image_and_its_mirror_image_are_symmetric() {
    let image = picture(8, Channels::Rgb, Depth::Eight);
    let pairs = MirrorPairs::of_positions(&face(), &|| false).unwrap();
    let width = f64::from(image.extent().width());
    // The face is tilted: its mean with its mirror image is upright all the same.
    let mut shape = BlendedShape::new(
        vec![face(), face()],
        Align::Similarity,
        &ShapeReference::Image(0),
    )
    .unwrap();
    shape.mirror(1, &pairs, width);
    let middle = shape.target(&[0.5, 0.5]);
    assert_eq!(shape.kept().len(), 5);
    let mut parts = [part(&image, &face(), 0.5), part(&image, &face(), 0.5)];
    parts[1].is_mirrored = true;
    let blended = blend(&parts, &middle, BlendSpace::Srgb);
    let columns = image.extent().width() as usize;
    let channels = blended.image.source.pixmap().channels().count();
    for row in values(&blended.image).chunks(columns * channels) {
        for x in 0..columns {
            let other = columns - 1 - x;
            for k in 0..channels {
                let difference = row[x * channels + k] - row[other * channels + k];
                assert!(difference.abs() <= 1, "{x}");
            }
        }
    }
}

#[test]
fn colours_add_up_where_all_images_cover() {
    // An image that no other covers is not darkened by them.
    let image = picture(9, Channels::Rgb, Depth::Eight);
    let away = points(&[
        (515.0, 15.0),
        (545.0, 14.0),
        (530.0, 25.0),
        (520.0, 35.0),
        (541.0, 36.0),
    ]);
    let target = points(&[
        (10.0, 10.0),
        (50.0, 10.0),
        (30.0, 22.0),
        (20.0, 30.0),
        (41.0, 30.0),
    ]);
    let parts = [part(&image, &face(), 0.5), part(&image, &away, 0.5)];
    let both = blend(&parts, &target, BlendSpace::Srgb);
    let alone = blend(
        &parts[..1]
            .iter()
            .map(|p| part(p.image, &p.p, 1.0))
            .collect::<Vec<_>>(),
        &target,
        BlendSpace::Srgb,
    );
    let (both, alone) = (values(&both.image), values(&alone.image));
    let count = alone.len() / (61 * 47);
    let mut seen = 0;
    for (a, b) in both.chunks(4).zip(alone.chunks(count)) {
        // Half covered: the colour is that of the only image.
        if a[3] == 128 {
            seen += 1;
            assert!((0..3).all(|k| (a[k] - b[k]).abs() <= 1), "{a:?} {b:?}");
        }
    }
    assert!(seen > 500, "{seen}");
}

#[test]
fn shapes_that_differ_in_form_are_refused() {
    let line = vec![Handle::Polyline(vec![
        Point::new(0.0, 0.0),
        Point::new(1.0, 1.0),
    ])];
    let point = points(&[(1.0, 1.0)]);
    let both = |second: &[Handle]| {
        BlendedShape::new(
            vec![point.clone(), second.to_vec()],
            Align::None,
            &ShapeReference::Mean,
        )
    };
    assert_eq!(
        both(&line).unwrap_err(),
        ShapeError::Form {
            shape: 1,
            handle: 0
        }
    );
    let two = ShapeError::Count {
        shape: 1,
        found: 2,
        expected: 1,
    };
    assert_eq!(both(&points(&[(1.0, 1.0), (2.0, 2.0)])).unwrap_err(), two);
    assert_eq!(both(&[Handle::Missing]).unwrap_err(), ShapeError::Empty);
    assert_eq!(
        BlendedShape::new(vec![], Align::None, &ShapeReference::Mean).unwrap_err(),
        ShapeError::Empty
    );
}

/// The mean by similarities is the dominant eigenvector of `sum z z* / (z* z)`: here by Jacobi
/// rotations of the real form of that matrix, which share nothing with the rounds of the library.
#[test]
fn the_procrustes_mean_is_the_dominant_eigenvector() {
    let mut numbers = Numbers(11);
    let n = 6;
    let base: Vec<(f64, f64)> = (0..n)
        .map(|_| (300.0 * numbers.next(), 300.0 * numbers.next()))
        .collect();
    let shapes: Vec<Vec<Handle>> = (0..5)
        .map(|_| {
            let (angle, size) = (6.0 * numbers.next(), 0.5 + numbers.next());
            let (x0, y0) = (500.0 * numbers.next(), 500.0 * numbers.next());
            let place = |(x, y): &(f64, f64)| {
                let (x, y) = (x + 40.0 * numbers.next(), y + 40.0 * numbers.next());
                let (sin, cos) = f64::sin_cos(angle);
                (
                    x0 + size * (cos * x - sin * y),
                    y0 + size * (sin * x + cos * y),
                )
            };
            points(&base.iter().map(place).collect::<Vec<_>>())
        })
        .collect();
    let blend =
        BlendedShape::new(shapes.clone(), Align::Similarity, &ShapeReference::Mean).unwrap();
    let mean = blend.target(&[0.2; 5]);

    let centred = |shape: &[Handle]| {
        let all: Vec<Point> = shape.iter().map(|h| h.places()[0]).collect();
        let (x, y) = all.iter().fold((0.0, 0.0), |(x, y), v| {
            (x + v.x / n as f64, y + v.y / n as f64)
        });
        all.iter().map(|v| (v.x - x, v.y - y)).collect::<Vec<_>>()
    };
    let mut matrix = vec![vec![0.0; 2 * n]; 2 * n];
    for shape in &shapes {
        let z = centred(shape);
        let norm: f64 = z.iter().map(|(x, y)| x * x + y * y).sum();
        for i in 0..n {
            for j in 0..n {
                let (re, im) = (
                    (z[i].0 * z[j].0 + z[i].1 * z[j].1) / norm,
                    (z[i].1 * z[j].0 - z[i].0 * z[j].1) / norm,
                );
                matrix[i][j] += re;
                matrix[n + i][n + j] += re;
                matrix[i][n + j] -= im;
                matrix[n + i][j] += im;
            }
        }
    }
    let vector = dominant(matrix);
    let found: Vec<Handle> = (0..n)
        .map(|i| Handle::Point(Point::new(vector[i], vector[n + i])))
        .collect();
    let place = |shape: &[Handle]| {
        let best = fitted(Class::Similarity, shape, &shapes[0], None).unwrap();
        shape
            .iter()
            .map(|h| best.map.map(h.places()[0]))
            .collect::<Vec<_>>()
    };
    for (a, b) in place(&found).iter().zip(place(&mean)) {
        assert!(a.distance(b) < 1e-9 * 300.0, "{a:?} {b:?}");
    }
}

/// The eigenvector of the largest eigenvalue of a symmetric matrix.
fn dominant(mut a: Vec<Vec<f64>>) -> Vec<f64> {
    let n = a.len();
    let mut v: Vec<Vec<f64>> = (0..n)
        .map(|i| (0..n).map(|j| f64::from(u8::from(i == j))).collect())
        .collect();
    for _ in 0..60 {
        for p in 0..n {
            for q in p + 1..n {
                if a[p][q].abs() < 1e-300 {
                    continue;
                }
                let theta = (a[q][q] - a[p][p]) / (2.0 * a[p][q]);
                let t = theta.signum() / (theta.abs() + (theta * theta + 1.0).sqrt());
                let c = 1.0 / (t * t + 1.0).sqrt();
                let s = t * c;
                let (upper, lower) = a.split_at_mut(q);
                for (x, y) in upper[p].iter_mut().zip(&mut lower[0]) {
                    (*x, *y) = (c * *x - s * *y, s * *x + c * *y);
                }
                for row in a.iter_mut().chain(&mut v) {
                    (row[p], row[q]) = (c * row[p] - s * row[q], s * row[p] + c * row[q]);
                }
            }
        }
    }
    let best = (0..n)
        .max_by(|i, j| a[*i][*i].total_cmp(&a[*j][*j]))
        .unwrap();
    v.iter().map(|row| row[best]).collect()
}

#[test]
fn pairs_are_found_by_name_by_position_or_given() {
    let names = ["eye_left", "eye_right", "nose", "mouth_L", "mouth_R"].map(str::to_owned);
    let expected = [1, 0, 2, 4, 3];
    let given = MirrorPairs::of_permutation(&expected, &face()).unwrap();
    assert_eq!(MirrorPairs::of_names(&names, &face()), Some(given.clone()));
    assert_eq!(
        MirrorPairs::of_positions(&face(), &|| false).unwrap(),
        given
    );
    assert_eq!(
        MirrorPairs::of_permutation(&[1, 2, 0, 3, 4], &face()),
        Err(NoPairs::NoPair { handle: 0 })
    );
    assert_eq!(
        MirrorPairs::of_permutation(&[0], &face()),
        Err(NoPairs::Count {
            found: 1,
            expected: 5
        })
    );
    assert_eq!(
        MirrorPairs::of_permutation(&[9, 0, 2, 3, 4], &face()),
        Err(NoPairs::NoPair { handle: 0 })
    );
    // A mouth that is drawn to one side, whose middle is nearer to a neighbour's mirror image.
    let point = |x, y| Handle::Point(Point::new(x, y));
    let smile = [
        point(0.0, 0.0),
        point(100.0, 0.0),
        point(40.0, 60.0),
        point(46.0, 61.0),
        point(53.0, 62.0),
        point(59.0, 61.0),
        point(65.0, 60.0),
    ];
    let expected = MirrorPairs::of_permutation(&[1, 0, 6, 5, 4, 3, 2], &smile).unwrap();
    assert_eq!(MirrorPairs::of_positions(&smile, &|| false), Ok(expected));
    let unsided = ["a", "b", "c", "d", "e"].map(str::to_owned);
    assert_eq!(MirrorPairs::of_names(&unsided, &face()), None);
    // Mirroring twice changes nothing but rounding, lines of both directions included.
    let mut shape = face();
    shape.push(Handle::Polyline(vec![
        Point::new(20.0, 40.0),
        Point::new(30.0, 42.0),
        Point::new(40.5, 40.0),
    ]));
    let pairs = MirrorPairs::of_permutation(&[1, 0, 2, 4, 3, 5], &shape).unwrap();
    let twice = pairs.mirrored(&pairs.mirrored(&shape, 61.0), 61.0);
    for (a, b) in shape.iter().zip(&twice) {
        assert!(
            a.places()
                .iter()
                .zip(b.places())
                .all(|(a, b)| a.distance(*b) < 1e-12)
        );
    }
    let Handle::Polyline(line) = &pairs.mirrored(&shape, 61.0)[5] else {
        panic!("a line")
    };
    assert!(
        line[0].x < line[2].x,
        "the mouth still runs from left to right"
    );
}

/// The 68 landmarks of a face, in the order of ibug.
fn landmarks(file: &str) -> Vec<Point> {
    let (_, body) = file.split_once('{').unwrap();
    let numbers = body.trim_end().trim_end_matches('}').split_whitespace();
    let numbers: Vec<f64> = numbers.map(|n| n.parse().unwrap()).collect();
    let pairs = numbers.as_chunks::<2>().0;
    pairs.iter().map(|[x, y]| Point::new(*x, *y)).collect()
}

/// Inner lips of a closed mouth are one line but for errors: which is which follows from the whole.
#[test]
fn pairs_of_tilted_faces_with_closed_mouths_are_found_by_position() {
    let mut expected: Vec<usize> = (0..68).collect();
    for (left, right) in [(0..=7, 16), (17..=21, 26), (31..=32, 35), (36..=39, 45)]
        .into_iter()
        .chain([
            (40..=41, 47),
            (48..=50, 54),
            (55..=56, 59),
            (60..=61, 64),
            (65..=65, 67),
        ])
    {
        for (a, b) in left.zip((0..=right).rev()) {
            (expected[a], expected[b]) = (b, a);
        }
    }
    let mut numbers = Numbers(68);
    for file in [
        include_str!("../../test_files/images/astronaut.pts"),
        include_str!("../../test_files/images/hopper.pts"),
    ] {
        let as_placed = landmarks(file);
        let width = as_placed[16].distance(as_placed[0]);
        for (gap, error, (cos, sin)) in [
            (None, 0.0, (1.0, 0.0)),
            (None, 0.0, (0.96, -0.28)),
            (Some(0.0), 0.0, (0.96, 0.28)),
            (Some(0.0), 0.003, (1.0, 0.0)),
            (Some(0.01), 0.003, (0.96, 0.28)),
            (Some(0.03), 0.003, (0.96, -0.28)),
        ] {
            let mut face = as_placed.clone();
            if let Some(gap) = gap {
                for (upper, lower) in [(61, 67), (62, 66), (63, 65)] {
                    let middle = face[upper] + (face[lower] - face[upper]) * 0.5;
                    face[upper] = Point::new(middle.x, middle.y - 0.5 * gap * width);
                    face[lower] = Point::new(middle.x, middle.y + 0.5 * gap * width);
                }
            }
            let mut wrong = || error * width * (2.0 * numbers.next() - 1.0);
            let place = |v: &Point| {
                let (x, y) = (v.x + wrong(), v.y + wrong());
                (cos * x - sin * y, sin * x + cos * y)
            };
            let face = points(&face.iter().map(place).collect::<Vec<_>>());
            let expected = MirrorPairs::of_permutation(&expected, &face).unwrap();
            let found = MirrorPairs::of_positions(&face, &|| false);
            assert_eq!(found, Ok(expected), "{gap:?} {error} {sin}");
        }
    }
}

#[test]
fn copies_are_made_before_an_image_is_added() {
    // Half as wide and high: the image is reduced.
    let (whole, half) = (Extent::new(61, 47).unwrap(), Extent::new(30, 23).unwrap());
    for mirrored_in in [None, Some(whole.width())] {
        let image = picture(3, Channels::Rgb, Depth::Eight);
        let (mesh, output) = (posed(&image, &face(), &face()), OutputSpec::default());
        let mut sum = ImageSum::new(Canvas::of(whole), half, BlendSpace::Srgb, &[0.0, 1.0]);
        let target = Target::of(Some(Canvas::of(whole)), half);
        let lacks = || RasterSource::Image(&image).lacks_copies(target, &mesh, &output);
        let make = |sum: &ImageSum, weight: f64, is_gone: bool| {
            sum.make_copies(&image, &mesh, (weight, mirrored_in), &output, &|| is_gone)
        };
        assert_eq!(make(&sum, 1.0, true), Err(WarpError::Cancelled));
        make(&sum, 0.0, false).unwrap();
        assert!(lacks());
        make(&sum, 1.0, false).unwrap();
        let asked = std::sync::atomic::AtomicBool::new(false);
        let is_cancelled = || {
            asked.store(true, std::sync::atomic::Ordering::Relaxed);
            assert!(!lacks(), "nobody waits for what gives way");
            false
        };
        let how = (1.0, mirrored_in);
        sum.add(&image, &mesh, how, &output, &is_cancelled).unwrap();
        assert!(asked.into_inner());
    }
}
