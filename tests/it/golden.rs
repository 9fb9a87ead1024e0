//! The example handle files on their photographs, drawn with all methods at 256 px, against
//! committed pictures. A sample may differ by 2/255 (levels and rounding), and no more than 0.5 %
//! of the samples may differ by more. `MLSWARP_BLESS=1` redraws them: then look at them.

use std::ops::ControlFlow;
use std::path::{Path, PathBuf};
use std::sync::Arc;

use mlswarp::codec::{self, ImageLimits};
use mlswarp::pixmap::{Pixmap, Samples};
use mlswarp::warp::{
    Image, Limits, Method, OutputSpec, PosedMesh, RasterSource, RenderJob, ResolvedRest,
};
use mlswarp_server::wire::{Reserved, WarpObject};

use crate::support::picture::decoded;

/// Handle file, photograph.
const EXAMPLES: [(&str, &str); 5] = [
    ("stretched-cat", "chelsea.png"),
    ("leaning-rocket", "rocket.jpg"),
    ("giraffe", "horse-cutout.png"),
    ("thinner-face", "astronaut.png"),
    ("fold", "coffee.png"),
];
const METHODS: [(Method, &str); 4] = [
    (Method::Affine, "affine"),
    (Method::Similarity, "similarity"),
    (Method::Rigid, "rigid"),
    (Method::ThinPlateSpline, "tps"),
];
const WIDTH: u32 = 256;
const TOLERANCE: u8 = 2;
const DEVIATING_SHARE: f64 = 0.005;
/// Above this a golden is no longer small, bytes.
const LARGEST: u64 = 200_000;

fn root() -> PathBuf {
    PathBuf::from(env!("CARGO_MANIFEST_DIR")).join("../..")
}

pub(crate) fn limits() -> Limits {
    Limits::default()
}

/// The PNG of an object on a photograph.
pub(crate) fn draw(photograph: &Path, object: &WarpObject) -> Vec<u8> {
    let image = Arc::new(
        Image::decode(
            &std::fs::read(photograph).unwrap(),
            &ImageLimits::default(),
            &|| false,
        )
        .unwrap(),
    );
    let setup = ResolvedRest::new(&object.rest, image.extent(), &limits(), &|| false).unwrap();
    let pose = setup.pose(object.q.as_deref().unwrap()).unwrap();
    let posed = PosedMesh::new(
        &setup,
        &setup.plan(&|| false).unwrap(),
        &pose,
        object.folds,
        &|| false,
    )
    .unwrap();
    let warp = RenderJob::new(
        RasterSource::Image(&image),
        &posed,
        &object.output,
        &limits(),
        &|| false,
    )
    .unwrap();
    let mut bytes = Vec::new();
    let written = warp.write(1, &(), &mut |strip| {
        bytes.extend(strip);
        ControlFlow::Continue(())
    });
    assert!(written.is_continue());
    assert!(bytes.len() as u64 <= warp.max_bytes());
    bytes
}

pub(crate) fn decode(png: &[u8]) -> Pixmap {
    decoded(png);
    codec::decode(png, &ImageLimits::default(), &|| false)
        .unwrap()
        .pixmap
}

fn eight(pixmap: &Pixmap) -> &[u8] {
    match pixmap.samples() {
        Samples::Eight(samples) => samples,
        Samples::Sixteen(_) => panic!("goldens have 8 bits"),
    }
}

#[test]
fn golden_examples_of_all_methods() {
    let bless = std::env::var_os("MLSWARP_BLESS").is_some();
    let mut wanted = Vec::new();
    for (example, photograph) in EXAMPLES {
        let json = std::fs::read(root().join(format!("api/examples/{example}.json"))).unwrap();
        for (method, name) in METHODS {
            let mut object = Reserved::<WarpObject, _>::parse(&json, |_| Ok(())).unwrap();
            object.rest.method = method;
            if method == Method::ThinPlateSpline {
                object.rest.alpha = None;
                if object.rest.p.iter().any(|handle| handle.places().len() > 1) {
                    continue;
                }
            }
            object.output = OutputSpec {
                width: Some(WIDTH),
                compression: codec::Compression::Best,
                ..object.output
            };
            let png = draw(&root().join("tests/images").join(photograph), &object);
            let file = format!("{example}-{name}.png");
            let path = root().join("tests/golden").join(&file);
            if bless {
                std::fs::write(&path, &png).unwrap();
            }
            let golden = std::fs::read(&path).unwrap_or_else(|e| panic!("{file}: {e}"));
            assert!(
                golden.len() as u64 <= LARGEST,
                "{file} has {} bytes",
                golden.len()
            );
            let (drawn, golden) = (decode(&png), decode(&golden));
            assert_eq!(
                (drawn.extent(), drawn.channels()),
                (golden.extent(), golden.channels()),
                "{file}"
            );
            let (drawn, golden) = (eight(&drawn), eight(&golden));
            let off = drawn
                .iter()
                .zip(golden)
                .filter(|(a, b)| a.abs_diff(**b) > TOLERANCE)
                .count();
            assert!(
                off as f64 <= DEVIATING_SHARE * drawn.len() as f64,
                "{file}: {off} of {} samples differ",
                drawn.len()
            );
            wanted.push(file);
        }
    }
    for entry in std::fs::read_dir(root().join("tests/golden")).unwrap() {
        let name = entry.unwrap().file_name().into_string().unwrap();
        assert!(wanted.contains(&name), "no test draws the golden {name}");
    }
}
