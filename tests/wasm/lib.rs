//! Three lines over the library without its features, which a browser can load.

mod scene;

/// The sum of everything that a method makes of the picture, minus the one that it should be.
#[unsafe(no_mangle)]
pub extern "C" fn difference(method: usize) -> u32 {
    let (method, expected) = scene::SUMS[method];
    scene::sum(method).map_or(u32::MAX, |sum| sum.wrapping_sub(expected))
}
