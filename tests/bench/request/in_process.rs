//! q to PNG in process, by `mlswarp::warp` as the service and the offline program call it, beside
//! crates that do a part of it or all.

use std::hint::black_box;
use std::path::Path;
use std::time::Instant;

use mlswarp::codec::Format;
use mlswarp::deform::Handle;
use mlswarp::geometry::Point;
use mlswarp::level::SimdLevel;
use mlswarp::pixmap::{Channels, Extent};

use mlswarp::warp::{GridSpec, Method, OutputSpec, RestSpec};

use crate::drag::{self, Drag, GRID, deformation, samples};
use crate::harness::pictures::{
    FULL_HD, SMALL, UHD, VERTICES, bytes, encode, extent, handles, photograph, size, tiles,
};
use crate::harness::{self, Contender, Goal, Report, contender, inside, paired, pool, remote};
use crate::landmarks;

const HANDLES: usize = 7;
const FASTEST: (png::Compression, Option<png::Filter>) = (png::Compression::Fastest, None);
/// This program answers for its own level.
pub const ANSWER: &str = "--answer";
const ONE: &str = "1 thread";
const TWO: &str = "2 threads";

pub fn tables(report: &mut Report) {
    for sides in [SMALL, FULL_HD, UHD] {
        let title = format!("in process, {}, {HANDLES} handles", size(extent(sides)));
        if harness::wanted(&title) {
            table(report, &title, extent(sides), sides == SMALL);
        }
    }
    let title = "in process, 500 x 500, 100 handles";
    if harness::wanted(title) {
        many(report, title);
    }
    let title = "in process, time and memory, 500 x 500, 1 thread";
    if harness::wanted(title) {
        numbers(report, title);
    }
    let title = "in process, landmarks, 500 x 500, grid auto, 2 threads";
    if harness::wanted(title) {
        landmarks::table(report, title);
    }
    let title = "in process, levels, 500 x 500";
    if harness::wanted(title) {
        levels(report, title);
    }
    let title = "in process, growth, 1 thread";
    if harness::wanted(title) {
        growth(report, title);
    }
}

fn table(report: &mut Report, title: &str, extent: Extent, small: bool) {
    let photo = photograph(extent, Channels::Rgba);
    let (one, two) = (pool(1), pool(2));
    let (channels, drawn) = samples(&Drag::new(&photo, HANDLES, GRID).file_of(0));
    let mut out = Vec::new();
    let mut contenders = vec![contender("png Fastest, the encoding alone", move || {
        out.clear();
        encode(extent, channels, black_box(&drawn), FASTEST, &mut out);
    })];
    for (grid, name) in [(GRID, "100 x 100"), (GridSpec::Auto, "auto")] {
        for (threads, pool, helpers) in [(ONE, &one, 0), (TWO, &two, 1)] {
            let mut drag = Drag::new(&photo, HANDLES, grid);
            contenders.push(inside(
                pool,
                format!("mlswarp, grid {name}, {threads}"),
                move || drag.picture(helpers),
            ));
        }
    }
    for (threads, pool, helpers) in [(ONE, &one, 0), (TWO, &two, 1)] {
        let mut drag = Drag::new(&photo, HANDLES, GRID);
        drag.output = OutputSpec {
            format: Format::Jpeg,
            ..OutputSpec::default()
        };
        contenders.push(inside(
            pool,
            format!("mlswarp, grid 100 x 100, JPEG, {threads}"),
            move || drag.picture(helpers),
        ));
    }
    if small {
        contenders.push(chain(extent));
    }
    report.table(title, if small { 201 } else { 31 }, &mut contenders);
    // Numbered as they stand above.
    let ([rival, one, two, auto_one, auto_two], [jpeg_one, jpeg_two], chain) =
        ([0, 1, 2, 3, 4], [5, 6], 7);
    if small {
        report.goal(
            "500 x 500, 1 thread / png Fastest alone",
            report.ratio(one, rival),
            Goal::AtMost(0.75),
        );
        report.goal(
            "500 x 500, 2 threads / png Fastest alone",
            report.ratio(two, rival),
            Goal::AtMost(0.42),
        );
        report.goal(
            "500 x 500, the chain of crates / 1 thread",
            report.ratio(chain, one),
            Goal::AtLeast(7.0),
        );
    }
    for (threads, jpeg, png) in [(ONE, jpeg_one, one), (TWO, jpeg_two, two)] {
        report.goal(
            &format!("{}, JPEG / PNG, {threads}", size(extent)),
            report.ratio(jpeg, png),
            Goal::AtMost(0.7),
        );
    }
    for (threads, auto, fixed) in [(ONE, auto_one, one), (TWO, auto_two, two)] {
        report.goal(
            &format!("{}, grid auto / 100 x 100, {threads}", size(extent)),
            report.ratio(auto, fixed),
            Goal::AtMost(1.25),
        );
    }
}

/// Many handles, between which most cells of `grid: auto` are subdivided.
fn many(report: &mut Report, title: &str) {
    let photo = photograph(extent(SMALL), Channels::Rgba);
    let one = pool(1);
    let mut drags = [GRID, GridSpec::Auto].map(|grid| Drag::new(&photo, 100, grid));
    let names = ["mlswarp, grid 100 x 100", "mlswarp, grid auto"];
    let mut contenders: Vec<_> = drags
        .iter_mut()
        .zip(names)
        .map(|(drag, name)| inside(&one, name, move || drag.picture(0)))
        .collect();
    report.table(title, 101, &mut contenders);
    report.goal(
        "100 handles, grid auto / 100 x 100",
        report.ratio(1, 0),
        Goal::AtMost(1.8),
    );
}

/// How time and memory grow with the number of points: the setup and the table of coefficients,
/// which are made once, the first picture, which also computes the exact rows of cells that are
/// halved, and later ones.
fn numbers(report: &mut Report, title: &str) {
    const MIB: f64 = (1 << 20) as f64;
    report.line(&format!(
        "## {title}\n\n| points | method | grid | setup and plan, ms | first picture, ms | later, \
            ms (median) | plan at most, MiB |"
    ));
    report.line("|---|---|---|---|---|---|---|");
    let file = drag::file(&photograph(extent(SMALL), Channels::Rgba));
    let ms = |began: Instant| 1e3 * began.elapsed().as_secs_f64();
    for (count, method, of) in [100, 1000, 5000].into_iter().flat_map(|n| {
        [
            (n, Method::Rigid, "rigid"),
            (n, Method::ThinPlateSpline, "tps"),
        ]
    }) {
        for (grid, name) in [(GRID, "100 x 100"), (GridSpec::Auto, "auto")] {
            let (p, q) = scattered(count, extent(SMALL));
            if method == Method::ThinPlateSpline && count > 2000 {
                continue;
            }
            pool(1).install(|| {
                let began = Instant::now();
                let mut drag = Drag::of_handles(
                    &file,
                    RestSpec {
                        p,
                        method,
                        grid,
                        ..RestSpec::default()
                    },
                    q,
                );
                let made = ms(began);
                let mut pictures: Vec<f64> = (0..8)
                    .map(|_| {
                        let began = Instant::now();
                        drag.picture(0);
                        ms(began)
                    })
                    .collect();
                let first = pictures.remove(0);
                pictures.sort_by(f64::total_cmp);
                let memory = drag.plan_bytes() as f64 / MIB;
                report.line(&format!(
                    "| {count} | {of} | {name} | {made:.1} | {first:.1} | {:.1} | {memory:.0} |",
                    pictures[3]
                ));
            });
        }
    }
    report.line("");
}

/// `count` points, at least their half distance apart, and where they go: up to a quarter of it.
fn scattered(count: u32, extent: Extent) -> (Vec<Handle>, Vec<Vec<Handle>>) {
    let side = f64::from(count).sqrt().ceil();
    let noise = |k: u32, n: u32| {
        f64::from((k * 4 + n).wrapping_mul(2_654_435_761) >> 8) / f64::from(1_u32 << 23) - 1.0
    };
    let (width, height) = (
        f64::from(extent.width()) / side,
        f64::from(extent.height()) / side,
    );
    let place = |k: u32, moved: f64| {
        let (i, j) = (f64::from(k) % side, (f64::from(k) / side).floor());
        let (x, y) = (
            i + 0.5 + 0.25 * (noise(k, 0) + moved * noise(k, 2)),
            j + 0.5 + 0.25 * (noise(k, 1) + moved * noise(k, 3)),
        );
        Handle::Point(Point::new(x * width, y * height))
    };
    let posed = |moved: f64| (0..count).map(|k| place(k, moved)).collect();
    (
        posed(0.0),
        (0..8).map(|k| posed(1.0 - 0.02 * f64::from(k))).collect(),
    )
}

/// The best chain of crates that leads from q to a PNG: every fifth pixel of every fifth row is
/// deformed, the rest interpolated.
fn chain(extent: Extent) -> Contender<'static> {
    let photo = photograph(extent, Channels::Rgb);
    let photo =
        image_023::RgbImage::from_raw(extent.width(), extent.height(), bytes(&photo).to_vec())
            .expect("RGB");
    let (p, q) = handles(HANDLES, extent, 1.0);
    let (p, q) = (places(&p), places(&q));
    let mut out = Vec::new();
    contender(
        "moving-least-squares-image 0.1 (sparse, 5 px, RGB) + png Fastest",
        move || {
            let warped = moving_least_squares_image::reverse_sparse(
                &photo,
                &p,
                &q,
                5,
                moving_least_squares::deform_rigid,
            );
            out.clear();
            encode(extent, Channels::Rgb, warped.as_raw(), FASTEST, &mut out);
            black_box(&out);
        },
    )
}

fn places(handles: &[Handle]) -> Vec<(f32, f32)> {
    handles
        .iter()
        .flat_map(Handle::places)
        .map(|p| (p.x as f32, p.y as f32))
        .collect()
}

/// Each level in a process of its own: the level is found once a process.
fn levels(report: &mut Report, title: &str) {
    let mut others: Vec<_> = SimdLevel::available()
        .iter()
        .rev()
        .map(|level| {
            (
                level,
                paired::Other::start(&[ANSWER], &[("MLSWARP_LEVEL", level.name())]),
            )
        })
        .map(|(level, other)| (level, std::cell::RefCell::new(other)))
        .collect();
    let others = &mut others;
    let mut contenders = Vec::new();
    for threads in [ONE, TWO] {
        for (level, other) in others.iter() {
            contenders.push(remote(format!("{}, {threads}", level.name()), move || {
                other.borrow_mut().seconds(threads)
            }));
        }
    }
    report.table(title, 101, &mut contenders);
    for (k, level) in SimdLevel::available().iter().rev().enumerate().skip(1) {
        let limit = if *level == SimdLevel::Scalar {
            5.0
        } else {
            1.5
        };
        report.goal(
            &format!("500 x 500, level {} / the best, 1 thread", level.name()),
            report.ratio(k, 0),
            Goal::AtMost(limit),
        );
    }
}

/// The other side of `levels`, and of a rival in another language: `folder` takes what that needs
/// to do the same.
pub fn answer(folder: Option<&Path>) {
    let photo = photograph(extent(SMALL), Channels::Rgba);
    if let Some(folder) = folder {
        let [p, q] = <[_; 2]>::from(handles(HANDLES, extent(SMALL), 1.0)).map(|list| places(&list));
        let (width, height) = SMALL;
        let index = serde_json::json!({
            "width": width, "height": height, "source": "source.rgba", "vertices": VERTICES, "p": p,
                "q": q, "level": SimdLevel::detect().name(),
        });
        paired::write(folder, "source.rgba", bytes(&photo));
        paired::write(folder, "index.json", index.to_string().as_bytes());
    }
    let (one, two) = (pool(1), pool(2));
    let mut drags = [
        Drag::new(&photo, HANDLES, GRID),
        Drag::new(&photo, HANDLES, GRID),
    ];
    let [a, b] = &mut drags;
    let (plan, pose) = deformation(extent(SMALL), HANDLES);
    paired::serve(&mut [
        inside(&one, ONE, || a.picture(0)),
        inside(&two, TWO, || b.picture(1)),
        inside(&one, "deform", || {
            _ = black_box(plan.displace(black_box(&pose), &|| false))
        }),
    ]);
}

/// The photograph side by side with itself: the same kind of pixels, ever more of them. The
/// deformation stays the same, so the slope is below 1.
fn growth(report: &mut Report, title: &str) {
    let sides = [500, 1000, 2000];
    let one = pool(1);
    let mut drags = sides.map(|side| Drag::new(&tiles(extent((side, side))), HANDLES, GRID));
    let mut contenders: Vec<_> = drags
        .iter_mut()
        .map(|drag| inside(&one, size(drag.extent()), move || drag.picture(0)))
        .collect();
    let medians = report.table(title, 41, &mut contenders);
    for k in 1..sides.len() {
        let slope = harness::slope(
            [sides[k - 1], sides[k]].map(|side| f64::from(side * side)),
            [medians[k - 1], medians[k]],
        );
        report.line(&format!(
            "Slope in pixels, {} to {}: {slope:.2}",
            sides[k - 1],
            sides[k]
        ));
    }
    report.line("");
}
