//! From landmarks to a map: moves landmarks with the image, brings them back, and makes the map by
//! which another program (OpenCV's `remap`, SciPy's `map_coordinates`) would draw the same picture.

#![expect(clippy::print_stdout, reason = "a program that shows its result")]

use mlswarp::Warper;
use mlswarp::warp::{MapDirection, Method, WarpError};

/// Eyes, nose and mouth of a face of 600 x 800 px, and of the mean face.
const FACE: [[f64; 2]; 4] = [
    [210.0, 330.0],
    [390.0, 325.0],
    [302.0, 445.0],
    [300.0, 560.0],
];
const MEAN: [[f64; 2]; 4] = [
    [200.0, 320.0],
    [400.0, 320.0],
    [300.0, 450.0],
    [300.0, 550.0],
];

/// Landmarks in the mean face, the same brought back, and the map for a picture of it.
#[derive(Debug)]
pub(crate) struct Mapped {
    pub(crate) landmarks: Vec<[f64; 2]>,
    pub(crate) back: Vec<Option<[f64; 2]>>,
    pub(crate) map: Vec<[f32; 2]>,
}

pub(crate) fn to_mean_face(landmarks: &[[f64; 2]]) -> Result<Mapped, WarpError> {
    let warper = Warper::builder(&FACE)
        .method(Method::ThinPlateSpline)
        .build([600, 800])?;
    let posed = warper.pose(&MEAN)?;
    let mapped = posed.map_points(landmarks)?;
    let back = posed.unmap_points(&mapped)?;
    // For each pixel of the new picture, the position in the old one that it shows.
    let map = posed.map(MapDirection::Inverse)?;
    Ok(Mapped {
        landmarks: mapped,
        back,
        map,
    })
}

fn main() -> Result<(), WarpError> {
    let chin = [[300.0, 690.0]];
    let mapped = to_mean_face(&chin)?;
    println!("the chin {chin:?} goes to {:?}", mapped.landmarks);
    println!("and comes back to {:?}", mapped.back);
    println!("pixel (300, 690) shows {:?}", mapped.map[690 * 600 + 300]);
    Ok(())
}
