//! Warps pixels in memory: grey of 16 bit in, grey of 16 bit out, without a file.

#![expect(clippy::print_stdout, reason = "a program that shows its result")]

use mlswarp::pixmap::{PixelFormat, Pixels, Samples};
use mlswarp::render::Outside;
use mlswarp::warp::WarpError;
use mlswarp::{Image, Warper};

const WIDTH: u32 = 64;
const HEIGHT: u32 = 32;

/// A ramp from left to right whose right half is drawn towards the left.
pub(crate) fn warped_ramp() -> Result<Vec<u16>, WarpError> {
    // A row of a camera's buffer may be longer than the image is wide.
    let stride = WIDTH as usize + 16;
    let mut buffer = vec![0_u16; stride * HEIGHT as usize];
    for row in buffer.chunks_exact_mut(stride) {
        let ramp = (0..WIDTH).map(|x| u16::try_from(x * 1000).unwrap_or(u16::MAX));
        row.iter_mut()
            .zip(ramp)
            .for_each(|(sample, value)| *sample = value);
    }
    let pixels = Pixels::strided(WIDTH, HEIGHT, PixelFormat::Grey, buffer, stride)?;
    let image = Image::from_pixels(pixels);

    let warper = Warper::new(image.extent(), &[[0.0, 16.0], [64.0, 16.0], [40.0, 16.0]])?;
    let posed = warper.pose(&[[0.0, 16.0], [64.0, 16.0], [32.0, 16.0]])?;
    let pixels = posed.render(&image)?.outside(Outside::Edge).pixels()?;
    match pixels.into_samples() {
        Samples::Sixteen(samples) => Ok(samples),
        Samples::Eight(_) => unreachable!("the depth is that of the image"),
    }
}

fn main() -> Result<(), WarpError> {
    let samples = warped_ramp()?;
    println!(
        "the middle row: {:?}",
        &samples[16 * WIDTH as usize..][..WIDTH as usize]
    );
    Ok(())
}
