//! Sets of handles, and where they go.

use serde_json::Value;

use crate::deform::{Coincident, CoincidentPolicy, Handle};
use crate::geometry::{Point, Vec2};
use crate::pixmap::Extent;
use crate::warp::{Method, RestSpec};

/// A set of handles and where they go.
#[derive(Clone, Debug)]
pub(super) struct Case {
    pub(super) name: String,
    pub(super) extent: Extent,
    pub(super) rest: RestSpec,
    pub(super) q: Vec<Handle>,
}

pub(super) const METHODS: [Method; 3] = [Method::Affine, Method::Similarity, Method::Rigid];
pub(super) const ALPHAS: [f64; 5] = [0.75, 1.0, 1.5, 2.0, 3.0];

/// Points and lines of [`random`] sets.
pub(super) const FEW_HANDLES: Kind = Kind {
    points: 7,
    lines: 0,
    reach: 0.1,
};
pub(super) const MORE: Kind = Kind {
    points: 11,
    lines: 0,
    reach: 0.08,
};
pub(super) const MANY_HANDLES: Kind = Kind {
    points: 40,
    lines: 0,
    reach: 0.025,
};
pub(super) const LINES: Kind = Kind {
    points: 0,
    lines: 4,
    reach: 0.05,
};
pub(super) const MIXED: Kind = Kind {
    points: 3,
    lines: 2,
    reach: 0.05,
};

/// What a random set consists of.
#[derive(Clone, Copy, Debug)]
pub(super) struct Kind {
    pub(super) points: usize,
    /// Polylines of three positions, which do not cross.
    pub(super) lines: usize,
    /// Each position moves by up to this along both axes, as a share of the width.
    pub(super) reach: f64,
}

pub(super) fn extent(width: u32, height: u32) -> Extent {
    Extent::new(width, height).unwrap()
}

/// A generator of numbers in [-1, 1), the same on every run.
#[derive(Clone, Copy, Debug)]
pub(super) struct Noise(pub(super) u64);

impl Noise {
    pub(super) fn signed(&mut self) -> f64 {
        self.0 = self
            .0
            .wrapping_mul(6_364_136_223_846_793_005)
            .wrapping_add(1_442_695_040_888_963_407);
        (self.0 >> 11) as f64 / (1_u64 << 52) as f64 - 1.0
    }

    pub(super) fn vector(&mut self, reach: f64) -> Vec2 {
        Vec2::new(reach * self.signed(), reach * self.signed())
    }
}

pub(super) fn handle(places: &[Point]) -> Handle {
    if let [place] = places {
        Handle::Point(*place)
    } else {
        Handle::Polyline(places.to_vec())
    }
}

/// A random set. `alpha` is not used for splines.
pub(super) fn random(extent: Extent, kind: Kind, method: Method, alpha: f64, seed: u64) -> Case {
    let Kind {
        points,
        lines,
        reach,
    } = kind;
    let (width, height) = (f64::from(extent.width()), f64::from(extent.height()));
    let mut noise = Noise(seed * 977 + points as u64 * 31 + lines as u64);
    let place = |noise: &mut Noise| {
        Point::new(
            width * (0.5 + 0.47 * noise.signed()),
            height * (0.5 + 0.47 * noise.signed()),
        )
    };
    let mut p: Vec<Vec<Point>> = (0..points).map(|_| vec![place(&mut noise)]).collect();
    for line in 0..lines {
        // A band of its own, from left to right.
        let (band, height) = (line as f64 + 0.5, height / lines as f64);
        let at = |k: u32, noise: &mut Noise| {
            Point::new(
                width * ((1.0 + 2.0 * f64::from(k)) / 6.0 + 0.12 * noise.signed()),
                height * (band + 0.45 * noise.signed()),
            )
        };
        p.push((0..3).map(|k| at(k, &mut noise)).collect());
    }
    let q: Vec<Vec<Point>> = p
        .iter()
        .map(|places| {
            places
                .iter()
                .map(|p| *p + noise.vector(reach * width))
                .collect()
        })
        .collect();
    let is_spline = method == Method::ThinPlateSpline;
    let rest = RestSpec {
        p: p.iter().map(|places| handle(places)).collect(),
        method,
        alpha: (!is_spline).then_some(alpha),
        ..RestSpec::default()
    };
    let name = format!("{points} points, {lines} lines, {method:?}, alpha {alpha}, seed {seed}");
    Case {
        name,
        extent,
        rest,
        q: q.iter().map(|places| handle(places)).collect(),
    }
}

/// Random sets of every method, alpha and kind.
pub(super) fn randoms(extent: Extent, seeds: std::ops::Range<u64>) -> Vec<Case> {
    let mut cases = Vec::new();
    for seed in seeds {
        for (method, alpha) in METHODS
            .into_iter()
            .flat_map(|method| ALPHAS.map(|alpha| (method, alpha)))
        {
            // Many handles make f so steep at alpha 3 that this would be a test of what is left
            // out.
            let points = [
                FEW_HANDLES,
                MORE,
                if alpha > 2.0 {
                    FEW_HANDLES
                } else {
                    MANY_HANDLES
                },
            ];
            cases.push(random(
                extent,
                points[cases.len() / 2 % 3],
                method,
                alpha,
                seed,
            ));
            cases.push(random(
                extent,
                [LINES, MIXED][cases.len() / 2 % 2],
                method,
                alpha,
                seed,
            ));
        }
        for (kind, smoothing) in [
            (FEW_HANDLES, None),
            (MORE, None),
            (MORE, Some(0.01)),
            (MANY_HANDLES, None),
        ] {
            let mut case = random(extent, kind, Method::ThinPlateSpline, 0.0, seed);
            case.rest.smoothing = smoothing;
            case.name += &format!(", smoothing {smoothing:?}");
            cases.push(case);
        }
    }
    cases
}

fn point(v: &Value, size: f64) -> Point {
    Point::new(size * v[0].as_f64().unwrap(), size * v[1].as_f64().unwrap())
}

/// Sets of the independent reference on 500 x 500 px, smaller.
pub(super) fn oracle() -> Vec<Case> {
    const SIZE: f64 = 0.4;
    let file: Value = serde_json::from_str(include_str!("../../test_files/oracle.json")).unwrap();
    let case = |case: &Value| {
        let names = [
            (METHODS[0], "affine"),
            (METHODS[1], "similarity"),
            (METHODS[2], "rigid"),
            (Method::ThinPlateSpline, "tps"),
        ];
        let (method, _) = *names.iter().find(|(_, name)| case["method"] == *name)?;
        let list = |kind: &str| {
            case["handles"][kind]
                .as_array()
                .cloned()
                .unwrap_or_default()
        };
        let (points, lines) = (list("points"), list("lines"));
        let side = |end: &str| -> Vec<Handle> {
            let segment = |h: &Value| {
                Handle::Polyline(
                    h[end]
                        .as_array()
                        .unwrap()
                        .iter()
                        .map(|v| point(v, SIZE))
                        .collect(),
                )
            };
            points
                .iter()
                .map(|h| Handle::Point(point(&h[end], SIZE)))
                .chain(lines.iter().map(segment))
                .collect()
        };
        let (p, q) = (side("p"), side("q"));
        let far = p
            .iter()
            .flat_map(Handle::places)
            .fold(0.0_f64, |far, p| far.max(p.x).max(p.y));
        let point_mass = case["point_mass"]
            .as_f64()
            .map(|mass| SIZE * mass)
            .filter(|_| method != Method::ThinPlateSpline);
        let rest = RestSpec {
            p,
            method,
            alpha: case["alpha"].as_f64(),
            point_mass,
            ..RestSpec::default()
        };
        (far <= 200.0).then(|| Case {
            name: case["name"].to_string(),
            extent: extent(200, 200),
            rest,
            q,
        })
    };
    file["cases"]
        .as_array()
        .unwrap()
        .iter()
        .filter_map(case)
        .collect()
}

/// The example handle files with every method, `size` times as large.
pub(super) fn examples(size: f64) -> Vec<Case> {
    let files = [
        (
            "stretched cat",
            include_str!("../../test_files/examples/stretched-cat.json"),
            [451.0, 300.0],
        ),
        (
            "leaning rocket",
            include_str!("../../test_files/examples/leaning-rocket.json"),
            [640.0, 427.0],
        ),
        (
            "giraffe",
            include_str!("../../test_files/examples/giraffe.json"),
            [800.0, 656.0],
        ),
        (
            "thinner face",
            include_str!("../../test_files/examples/thinner-face.json"),
            [512.0, 512.0],
        ),
        (
            "fold",
            include_str!("../../test_files/examples/fold.json"),
            [600.0, 400.0],
        ),
    ];
    let mut cases = Vec::new();
    for (name, json, sides) in files {
        let file: Value = serde_json::from_str(json).unwrap();
        assert!(
            file["units"].is_null() && file["weights"].is_null(),
            "{name}: not read here"
        );
        let handles = |end: &str| -> Vec<Handle> {
            let read = |h: &Value| {
                if h[0].is_number() {
                    return Handle::Point(point(h, size));
                }
                Handle::Polyline(
                    h.as_array()
                        .unwrap()
                        .iter()
                        .map(|v| point(v, size))
                        .collect(),
                )
            };
            file[end].as_array().unwrap().iter().map(read).collect()
        };
        let (p, q) = (handles("p"), handles("q"));
        let [width, height] = sides.map(|side| (side * size).round() as u32);
        let has_lines = p.iter().any(|h| h.places().len() > 1);
        for method in METHODS
            .into_iter()
            .chain((!has_lines).then_some(Method::ThinPlateSpline))
        {
            let alpha = file["alpha"]
                .as_f64()
                .filter(|_| method != Method::ThinPlateSpline);
            let rest = RestSpec {
                p: p.clone(),
                method,
                alpha,
                ..RestSpec::default()
            };
            cases.push(Case {
                name: format!("{name}, {method:?}"),
                extent: extent(width, height),
                rest,
                q: q.clone(),
            });
        }
    }
    cases
}

/// A face of 478 landmarks in whole pixels, some of which coincide and go to different pixels, on a
/// picture of this side.
pub(super) fn face(side: u32, method: Method) -> Case {
    let size = f64::from(side);
    let at = |x: f64, y: f64| Point::new((size * x).round(), (size * y).round());
    // Sunflower seeds fill the face; the last ones are dense rings around eyes and mouth.
    let seed = |k: u32| {
        let (angle, radius) = (2.399_963 * f64::from(k), (f64::from(k) / 350.0).sqrt());
        (
            0.5 + 0.32 * radius * angle.cos(),
            0.5 + 0.42 * radius * angle.sin(),
        )
    };
    let ring = |k: u32| {
        let (x, y, wide) = [
            (0.37, 0.4, 0.06),
            (0.63, 0.4, 0.06),
            (0.5, 0.7, 0.1),
            (0.5, 0.7, 0.06),
        ][(k % 4) as usize];
        let angle = f64::from(k / 4) * std::f64::consts::TAU / 32.0;
        (x + wide * angle.cos(), y + 0.4 * wide * angle.sin())
    };
    let places: Vec<(f64, f64)> = (0..350).map(seed).chain((0..128).map(ring)).collect();
    let moved = |(x, y): (f64, f64)| {
        (
            x + 0.02 * (6.0 * y).sin() * x,
            y - 0.03 * (5.0 * x + y).cos() * (1.0 - y),
        )
    };
    let p = places
        .iter()
        .map(|&(x, y)| Handle::Point(at(x, y)))
        .collect();
    let q = places
        .iter()
        .map(|&place| moved(place))
        .map(|(x, y)| Handle::Point(at(x, y)))
        .collect();
    let coincident = Coincident {
        policy: CoincidentPolicy::Mean,
        within: 0.0,
    };
    let rest = RestSpec {
        p,
        method,
        coincident,
        ..RestSpec::default()
    };
    Case {
        name: format!("a face, {side} px, {method:?}"),
        extent: extent(side, side),
        rest,
        q,
    }
}

/// 44 contours in whole pixels, which cross each other.
pub(super) fn contours(side: u32, method: Method, alpha: f64) -> Case {
    let size = f64::from(side);
    let at = |x: f64, y: f64| Point::new((size * x).round(), (size * y).round());
    let moved = |(x, y): (f64, f64)| {
        (
            x + 0.02 * (6.0 * y).sin() * x,
            y - 0.03 * (5.0 * x + y).cos() * (1.0 - y),
        )
    };
    let contour = |k: u32| -> Vec<(f64, f64)> {
        let share = f64::from(k % 22) / 22.0;
        let along = (0..6).map(|n| f64::from(n) / 5.0);
        // Lines from top to bottom, and waves from left to right.
        if k < 22 {
            along
                .map(|t| {
                    (
                        0.06 + 0.88 * share + 0.03 * (9.0 * t + share).sin(),
                        0.1 + 0.8 * t,
                    )
                })
                .collect()
        } else {
            along
                .map(|t| {
                    (
                        0.1 + 0.8 * t,
                        0.06 + 0.88 * share + 0.04 * (7.0 * t + 5.0 * share).cos(),
                    )
                })
                .collect()
        }
    };
    let contours: Vec<Vec<(f64, f64)>> = (0..44).map(contour).collect();
    let handles = |to: &dyn Fn((f64, f64)) -> (f64, f64)| -> Vec<Handle> {
        let line = |places: &Vec<(f64, f64)>| {
            Handle::Polyline(
                places
                    .iter()
                    .map(|&place| to(place))
                    .map(|(x, y)| at(x, y))
                    .collect(),
            )
        };
        contours.iter().map(line).collect()
    };
    let rest = RestSpec {
        p: handles(&|place| place),
        method,
        alpha: Some(alpha),
        ..RestSpec::default()
    };
    let name = format!("contours, {side} px, {method:?}, alpha {alpha}");
    Case {
        name,
        extent: extent(side, side),
        rest,
        q: handles(&moved),
    }
}
