//! The example programs of the library run, and do what they say.

#[expect(dead_code, reason = "a program has a main function")]
#[path = "../../src/engine/examples/drag.rs"]
mod drag;
#[expect(dead_code, reason = "a program has a main function")]
#[path = "../../src/engine/examples/map_points.rs"]
mod map_points;
#[expect(dead_code, reason = "a program has a main function")]
#[path = "../../src/engine/examples/warp_file.rs"]
mod warp_file;
#[expect(dead_code, reason = "a program has a main function")]
#[path = "../../src/engine/examples/warp_pixels.rs"]
mod warp_pixels;

use std::path::Path;

use mlswarp::warp::WarpError;
use mlswarp::{Cancel, FileError, Image};

const CHELSEA: &str = concat!(
    env!("CARGO_MANIFEST_DIR"),
    "/../../tests/images/chelsea.png"
);

#[test]
fn library_examples_warp_a_file_to_every_format_that_a_name_can_end_in() {
    let folder = std::env::temp_dir().join(format!("mlswarp-example-{}", std::process::id()));
    std::fs::create_dir_all(&folder).unwrap();
    let source = Path::new(CHELSEA);
    let extent = Image::open(source).unwrap().extent();
    for name in ["a.png", "b.JPEG", "c.webp", "d.tif"] {
        let target = folder.join(name);
        warp_file::warp_file(source, &target).unwrap();
        assert_eq!(Image::open(&target).unwrap().extent(), extent, "{name}");
    }
    let error = warp_file::warp_file(source, &folder.join("e.xcf")).unwrap_err();
    assert!(matches!(error, FileError::Extension(_)), "{error}");
    let error = warp_file::warp_file(&folder.join("none.png"), &folder.join("f.png")).unwrap_err();
    assert!(matches!(error, FileError::Io(_)), "{error}");
    std::fs::remove_dir_all(folder).unwrap();
}

#[test]
fn library_examples_draw_a_ramp_to_the_left() {
    let samples = warp_pixels::warped_ramp().unwrap();
    assert_eq!(samples.len(), 64 * 32);
    let middle = &samples[16 * 64..][..64];
    assert!(
        middle.windows(2).all(|pair| pair[0] <= pair[1]),
        "{middle:?}"
    );
    // What was at 40 px is at 32 px now.
    assert!(middle[32].abs_diff(40_000) < 1000, "{middle:?}");
}

#[test]
fn library_examples_drag_until_they_are_cancelled() {
    let (folded, farthest) = drag::drag(&Cancel::new()).unwrap();
    assert!(folded < 100 && farthest < 0.5, "{folded} {farthest}");
    let cancel = Cancel::new();
    cancel.cancel();
    assert_eq!(drag::drag(&cancel), Err(WarpError::Cancelled));
}

#[test]
fn library_examples_bring_landmarks_back() {
    let chin = [300.0, 690.0];
    let mapped = map_points::to_mean_face(&[chin]).unwrap();
    let back = mapped.back[0].unwrap();
    assert!((back[0] - chin[0]).hypot(back[1] - chin[1]) < 1e-6);
    assert_eq!(mapped.map.len(), 600 * 800);
    // The map shows the chin where the landmark went.
    let [x, y] = mapped.landmarks[0];
    #[expect(clippy::cast_sign_loss, reason = "positions in the picture")]
    let [there, down] = mapped.map[y as usize * 600 + x as usize].map(f64::from);
    assert!(
        (there - chin[0]).hypot(down - chin[1]) < 2.0,
        "{there} {down}"
    );
}
