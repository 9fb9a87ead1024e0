//! The counterparts of the paper's figures: they are the pictures of the guide, within what JPEG
//! and levels may change, and show what stands below them. `MLSWARP_BLESS=1` draws them again:
//! then look at them.

#[expect(dead_code, reason = "a program has a main function")]
#[path = "../../src/engine/examples/gallery/main.rs"]
mod program;

use std::path::PathBuf;

use mlswarp::codec::{self, ImageLimits};
use mlswarp::geometry::{Mesh, Point};
use mlswarp::pixmap::{Pixmap, Samples};
use program::figures::{Drawn, FIGURES, Panel, PaperFigure};
use program::{Picture, draw};

/// A sample may differ by this, and this share of the samples by more.
const TOLERANCE: u8 = 8;
const DEVIATING_SHARE: f64 = 0.005;
/// Above this a picture is no longer small, bytes.
const LARGEST: u64 = 90_000;

fn root() -> PathBuf {
    PathBuf::from(env!("CARGO_MANIFEST_DIR")).join("../..")
}

fn images() -> PathBuf {
    root().join("tests/images")
}

fn samples(file: &[u8]) -> (Pixmap, Vec<u8>) {
    let decoded = codec::decode(file, &ImageLimits::default(), &|| false);
    let pixmap = decoded.unwrap().pixmap;
    let Samples::Eight(samples) = pixmap.samples().clone() else {
        panic!("the pictures have 8 bits")
    };
    (pixmap, samples)
}

#[test]
fn gallery_pictures_are_those_of_the_guide() {
    let guide = std::fs::read_to_string(root().join("src/web/docs/index.html")).unwrap();
    for figure in &FIGURES {
        let file = draw(figure, &images()).unwrap().jpeg().unwrap();
        let path = root().join(format!("src/web/docs/gallery/{}.jpg", figure.name));
        if std::env::var_os("MLSWARP_BLESS").is_some() {
            std::fs::write(&path, &file).unwrap();
        }
        let golden = std::fs::read(&path).unwrap_or_else(|e| panic!("{path:?}: {e}"));
        assert!(golden.len() as u64 <= LARGEST, "{path:?}: {}", golden.len());
        let ((drawn, a), (committed, b)) = (samples(&file), samples(&golden));
        assert_eq!(drawn.extent(), committed.extent(), "{}", figure.name);
        let off = a
            .iter()
            .zip(&b)
            .filter(|(a, b)| a.abs_diff(**b) > TOLERANCE);
        let off = off.count() as f64 / a.len() as f64;
        assert!(off <= DEVIATING_SHARE, "{}: {off}", figure.name);
        // The guide shows it, with what is to be seen.
        let words = |text: &str| text.split_whitespace().collect::<Vec<_>>().join(" ");
        let shown = format!("docs/gallery/{}.jpg", figure.name);
        assert!(guide.contains(&shown), "{}", figure.name);
        assert!(
            words(&guide).contains(&words(figure.claim)),
            "{}",
            figure.claim
        );
        for panel in figure.panels {
            assert!(words(&guide).contains(panel.caption), "{}", panel.caption);
        }
    }
}

struct Counterpart {
    figure: &'static PaperFigure,
    picture: Picture,
}

impl Counterpart {
    fn new(name: &str) -> Self {
        let figure = FIGURES.iter().find(|figure| figure.name == name).unwrap();
        let picture = Picture::open(&images().join(figure.image)).unwrap();
        Self { figure, picture }
    }

    fn panel(&self, index: usize) -> &'static Panel {
        &self.figure.panels[index]
    }

    fn mesh(&self, index: usize) -> Mesh {
        self.panel(index).mesh(self.figure, &self.picture).unwrap()
    }

    fn folds(&self, index: usize) -> u64 {
        let mesh = self.mesh(index);
        mesh.folding(&|| false).unwrap().cells
    }

    /// The singular values of the map at positions that are visible, a few px apart.
    fn stretches(&self, index: usize) -> Vec<[f64; 2]> {
        let mesh = self.mesh(index);
        let (width, height) = self.picture.mask.mask.size();
        let places = (1..height / 8).flat_map(|y| (1..width / 8).map(move |x| (8 * x, 8 * y)));
        let inside = places.filter(|(x, y)| self.picture.mask.mask.is_inside(*x, *y));
        let of = |(x, y): (usize, usize)| {
            let at = |dx, dy| mesh.map(Point::new(x as f64 + dx, y as f64 + dy)).unwrap();
            let (a, b) = (at(0.5, 0.0) - at(-0.5, 0.0), at(0.0, 0.5) - at(0.0, -0.5));
            let (sum, area) = (a.norm2() + b.norm2(), a.cross(b));
            let root = (sum * sum - 4.0 * area * area).max(0.0).sqrt();
            [
                ((sum + root) / 2.0).sqrt(),
                ((sum - root).max(0.0) / 2.0).sqrt(),
            ]
        };
        inside.map(of).collect()
    }
}

fn quantile(mut values: Vec<f64>, share: f64) -> f64 {
    values.sort_by(f64::total_cmp);
    values[(share * (values.len() - 1) as f64) as usize]
}

#[test]
fn gallery_claims_about_classes_hold() {
    for name in ["figure-1", "figure-4"] {
        let shown = Counterpart::new(name);
        let of = |index| {
            let stretches = shown.stretches(index);
            let sheared = stretches.iter().map(|[s, t]| s / t).collect();
            let scaled = stretches.iter().map(|[s, t]| (s * t).sqrt().ln().abs());
            (quantile(sheared, 0.9), quantile(scaled.collect(), 0.9))
        };
        let [affine, similarity, rigid] = [1, 2, 3].map(of);
        assert!(
            affine.0 > similarity.0,
            "{name}: {affine:?} {similarity:?} {rigid:?}"
        );
        assert!(
            rigid.1 < similarity.1,
            "{name}: {affine:?} {similarity:?} {rigid:?}"
        );
    }
    // The rocket: how wide it is half-way up, and how far its cross-section turns.
    let shown = Counterpart::new("figure-5");
    let across = [1, 2, 3].map(|index| {
        let mesh = shown.mesh(index);
        let [left, right] = [310.0, 334.0].map(|x| mesh.map(Point::new(x, 265.0)).unwrap());
        (
            left.distance(right),
            (right.y - left.y).atan2(right.x - left.x).to_degrees(),
        )
    });
    let [affine, similarity, rigid] = across;
    assert!(
        affine.1.abs() < 12.0 && similarity.1 > 15.0 && rigid.1 > 15.0,
        "{across:?}"
    );
    assert!(rigid.0 > 22.0 && similarity.0 < 20.0, "{across:?}");
}

#[test]
fn gallery_claims_about_folds_and_grids_hold() {
    let shown = Counterpart::new("figure-6");
    let [morph, first, second] = [1, 2, 3].map(|index| shown.folds(index));
    assert!(
        morph > 3 * first && second > morph / 2,
        "{morph} {first} {second}"
    );
    let shown = Counterpart::new("figure-8");
    assert!(shown.folds(1) > 0 && shown.folds(2) == 0);
    for mesh in [1, 2].map(|index| shown.mesh(index)) {
        let (p, q) = (shown.figure.rest.handles(), shown.figure.posed.handles());
        for (p, q) in p.iter().zip(&q) {
            let off = mesh.map(p.places()[0]).unwrap().distance(q.places()[0]);
            assert!(off < 1.0, "{off}");
        }
    }
    let shown = Counterpart::new("figure-7");
    let [coarse, usual, exact] = [0, 1, 2].map(|index| shown.mesh(index));
    let places = (0..100).flat_map(|y| (0..100).map(move |x| (5 * x, 5 * y)));
    let farthest = |mesh: &Mesh| {
        let off = |(x, y): (u32, u32)| {
            let at = Point::new(x.into(), y.into());
            mesh.map(at).unwrap().distance(exact.map(at).unwrap())
        };
        places.clone().map(off).fold(0.0, f64::max)
    };
    let (coarse, usual) = (farthest(&coarse), farthest(&usual));
    assert!(coarse > 5.0 && usual < 3.0, "{coarse} {usual}");
}

#[test]
fn gallery_claims_about_outlines_and_depth_hold() {
    let shown = Counterpart::new("hoof");
    let others = [1, 2, 3].map(|index| {
        let mesh = shown.mesh(index);
        let places = (575..656).flat_map(|y| (0..530).map(move |x| (x, y)));
        let inside = places.filter(|(x, y)| shown.picture.mask.mask.is_inside(*x, *y));
        let at = inside.map(|(x, y)| Point::new(x as f64 + 0.5, y as f64 + 0.5));
        at.map(|at| mesh.map(at).unwrap().distance(at))
            .fold(0.0, f64::max)
    });
    assert!(
        others[0] > 12.0 && others[1] <= 1.0 && others[2] <= 6.5,
        "{others:?}"
    );
    // What each pair of panels differs in is the leg of the other hoof.
    let shown = Counterpart::new("depth");
    for pair in [[0, 1], [2, 3]] {
        let orders = pair.map(|index| shown.mesh(index).order().cloned().unwrap());
        assert_ne!(orders[0], orders[1]);
        let is_rigid = |index: usize| matches!(shown.panel(index).drawn, Drawn::InFront(_));
        assert_eq!(is_rigid(pair[0]), is_rigid(pair[1]));
    }
}
