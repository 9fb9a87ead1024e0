//! The counterparts of the paper's figures: they are the pictures of the guide, within what JPEG
//! and levels may change. `MLSWARP_BLESS=1` draws them again: then look at them.

#[expect(dead_code, reason = "a program has a main function")]
#[path = "../../src/engine/examples/gallery/main.rs"]
mod gallery;

use std::path::PathBuf;

use gallery::draw;
use gallery::figures::FIGURES;
use mlswarp::codec::{self, ImageLimits};
use mlswarp::pixmap::{Pixmap, Samples};

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
