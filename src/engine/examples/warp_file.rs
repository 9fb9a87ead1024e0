//! Warps an image file: `cargo run --example warp_file IMAGE OUT`. The format of OUT is that of its
//! ending.

use std::path::Path;

use mlswarp::{FileError, Image, Warper};

/// The middle of the image moves to the right by a tenth of its width; the corners stay.
pub(crate) fn warp_file(source: &Path, target: &Path) -> Result<(), FileError> {
    let image = Image::open(source)?;
    let (width, height) = (
        image.extent().width().into(),
        image.extent().height().into(),
    );
    let corners = [[0.0, 0.0], [width, 0.0], [0.0, height], [width, height]];
    let with = |middle: [f64; 2]| [&corners[..], &[middle]].concat();

    let warper = Warper::new(image.extent(), &with([0.5 * width, 0.5 * height]))?;
    let posed = warper.pose(&with([0.6 * width, 0.5 * height]))?;
    posed.render(&image)?.save(target)
}

fn main() -> Result<(), Box<dyn std::error::Error>> {
    let files: Vec<String> = std::env::args().skip(1).collect();
    let [source, target] = &files[..] else {
        return Err("give the names of two image files: IMAGE OUT".into());
    };
    Ok(warp_file(Path::new(source), Path::new(target))?)
}
