//! A drag: a hundred poses of one set of handles. What does not depend on the pose is computed
//! once, and a pose that is no longer wanted can be ended.

#![expect(clippy::print_stdout, reason = "a program that shows its result")]

use mlswarp::warp::{Method, WarpError};
use mlswarp::{Cancel, Image, Warper};

const POSES: u32 = 100;

/// The number of poses that fold, and the largest distance of a handle from where it was drawn, px.
pub(crate) fn drag(cancel: &Cancel) -> Result<(u32, f64), WarpError> {
    let chequered = |k: u32| {
        if (k % 320 / 16 + k / 320 / 16).is_multiple_of(2) {
            230
        } else {
            40
        }
    };
    let image = Image::from_grey8(320, 240, (0..320 * 240).map(chequered).collect::<Vec<u8>>())?;
    let warper = Warper::builder(&[[80.0, 120.0], [240.0, 120.0], [160.0, 60.0]])
        .method(Method::Similarity)
        .cancelled_by(cancel)
        .build(image.extent())?;

    let (mut folded, mut farthest) = (0, 0.0_f64);
    for frame in 0..POSES {
        let y = 60.0 + 0.5 * f64::from(frame);
        let posed = warper.pose(&[[80.0, 120.0], [240.0, 120.0], [160.0, y]])?;
        // Where a window would show them.
        let _pixels = posed.render(&image)?.pixels()?;
        folded += u32::from(posed.report().folds > 0);
        farthest = farthest.max(posed.report().residual);
    }
    Ok((folded, farthest))
}

fn main() -> Result<(), WarpError> {
    let (folded, farthest) = drag(&Cancel::new())?;
    println!("{folded} of {POSES} poses fold; handles are drawn within {farthest:.3} px");
    Ok(())
}
