//! A picture that every method warps, and sums of the results: the same on every machine.

use mlswarp::warp::{LabelValues, MapDirection, Method, WarpError};
use mlswarp::{Image, LabelImage, PosedWarp, Warper};

const SIDE: u32 = 96;

/// Each method with the sum of its pixels, labels and positions.
pub(crate) const SUMS: [(Method, u32); 5] = [
    (Method::Rigid, 1_349_547_781),
    (Method::Similarity, 3_197_154_348),
    (Method::Affine, 3_159_045_295),
    (Method::ThinPlateSpline, 865_444_374),
    (Method::GlobalAffine, 3_147_449_118),
];

/// The sum of everything that a method makes of the picture.
pub(crate) fn sum(method: Method) -> Result<u32, WarpError> {
    let p = [[20.0, 30.0], [70.0, 25.0], [45.0, 75.0], [48.0, 40.0]];
    let q = [[26.0, 24.0], [66.0, 33.0], [38.5, 78.0], [52.0, 47.25]];
    let samples = |k: u32| k.wrapping_mul(2_654_435_761) >> 24 & 0xFF;
    let rgb: Vec<u8> = (0..SIDE * SIDE * 3)
        .map(|k| samples(k / 40) as u8)
        .collect();
    let labels: Vec<u32> = (0..SIDE * SIDE).map(|k| samples(k / 100) << 12).collect();
    let image = Image::from_rgb8(SIDE, SIDE, rgb)?;
    let labels = LabelImage::from_labels32(SIDE, SIDE, &labels)?;
    let posed = Warper::builder(&p)
        .method(method)
        .build([SIDE, SIDE])?
        .pose(&q)?;
    drawn(&posed, &image, &labels)
}

fn drawn(posed: &PosedWarp, image: &Image, labels: &LabelImage) -> Result<u32, WarpError> {
    let mut sum = Sum(2_166_136_261);
    if let mlswarp::pixmap::Samples::Eight(samples) = posed.render(image)?.pixels()?.samples() {
        samples
            .iter()
            .for_each(|sample| sum.add(u32::from(*sample)));
    }
    if let LabelValues::ThirtyTwo(labels) = posed.render_labels(labels)?.labels()? {
        labels.into_iter().for_each(|label| sum.add(label));
    }
    for [x, y] in posed.map(MapDirection::Inverse)? {
        // NaN has many forms.
        sum.add(if x.is_nan() {
            1
        } else {
            x.to_bits() ^ y.to_bits()
        });
    }
    Ok(sum.0)
}

/// FNV-1a over words.
struct Sum(u32);

impl Sum {
    fn add(&mut self, word: u32) {
        self.0 = (self.0 ^ word).wrapping_mul(16_777_619);
    }
}
