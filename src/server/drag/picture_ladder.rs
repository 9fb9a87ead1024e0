//! The format, quality and width of pictures with `frames=auto`.
//!
//! | state | rule | reason |
//! |---|---|---|
//! | the connection has carried sixty PNG per second | PNG | no loss, and the fastest format to draw |
//! | otherwise | JPEG: the widest picture that fits in `budget` bytes at [`LEAST_QUALITY`], or the narrowest | details need pixels |
//! | | of these, the best quality that fits; [`NARROWEST_QUALITY`] if none does | |
//! | drawing takes longer than a sixtieth of a second | narrower | so do previews of a fixed format |
//! | the window reports room, and is large enough for [`TARGET_FRAME_RATE`] | `budget` grows by a sixth | better pictures at the same rate |
//! | `budget` exceeds the narrowest picture of the best quality, and what passes in [`MAX_SEND`] | the larger of these | age before size |
//! | the window reports a queue | `budget` shrinks by a seventh; by a third if it is long | fewer bytes before fewer frames |
//! | the pointer rests | PNG of the full size if it passes in a second, otherwise JPEG of [`REST_QUALITY`] | it is looked at |
//!
//! Sizes are predicted by a curve, which the last frames correct. Times are arguments. O(1) per
//! frame.

use std::time::Duration;

use super::preview_controller::preview_widths;

/// Frames per second for which pictures become smaller.
pub const TARGET_FRAME_RATE: f64 = 32.0;
/// Range of JPEG qualities of moving pictures. Only the narrowest width may go below the first,
/// down to the third.
const LEAST_QUALITY: u8 = 40;
const MOST_QUALITY: u8 = 85;
const NARROWEST_QUALITY: u8 = 20;
/// Quality of a picture of a resting pointer.
const REST_QUALITY: u8 = 95;
/// Bytes of a moving picture at first and at least. If the first is too small, that costs a round
/// trip; if it is too large, seconds.
const LEAST_BUDGET: f64 = 8e3;
/// Factor of a step of the budget, and when a queue is long.
const BUDGET_FACTOR: f64 = 7.0 / 6.0;
const LONG_QUEUE_FACTOR: f64 = 0.67;
/// A picture of a resting pointer is lossless if it passes in this time, seconds.
const REST_SECONDS: f64 = 1.0;
/// Frames per second that a connection has to carry as PNG.
const PNG_RATE: f64 = 60.0;
/// Sending time of a JPEG picture that adds little to its age, seconds.
const MAX_SEND: f64 = 1.0 / 120.0;
/// Maximum drawing time, seconds.
const MAX_DRAW: f64 = 1.0 / 60.0;
/// Bytes per pixel until frames are measured: JPEG of quality 50 at full width, and PNG.
const FIRST_JPEG: f64 = 0.09;
const FIRST_PNG: f64 = 2.0;
/// Weight of the newest frame in averages.
const NEWEST_WEIGHT: f64 = 0.3;

/// The encoding of a picture.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Encoding {
    /// PNG.
    Png,
    /// JPEG of this quality.
    Jpeg(u8),
}

/// What the window says about the size of frames.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Advice {
    /// As they are.
    Same,
    /// The connection would carry larger ones.
    Larger,
    /// A queue builds up.
    Smaller,
    /// A queue is long.
    MuchSmaller,
}

/// Whether frames can become larger, and smaller. Only those of `frames=auto` can.
#[derive(Clone, Copy, Debug, Default)]
pub struct PossibleSteps {
    /// The best picture that the connection may carry is larger.
    pub larger: bool,
    /// The smallest one is smaller.
    pub smaller: bool,
}

/// The state of the pictures of one drag.
#[derive(Clone, Debug)]
pub struct PictureLadder {
    /// The width of a full picture.
    full: u32,
    /// Widths of moving pictures, widest first.
    widths: Vec<u32>,
    /// Height per width.
    aspect: f64,
    budget: f64,
    /// Bytes per pixel: of JPEG at quality 50 and full width, and of PNG.
    jpeg: f64,
    png: f64,
    /// Seconds of drawing per pixel.
    draw: f64,
}

impl PictureLadder {
    /// Full pictures have this size; moving ones the width `fixed`, if that is given.
    pub fn new((width, height): (u32, u32), fixed: Option<u32>) -> Self {
        let widths = fixed.map_or_else(|| preview_widths(width), |fixed| vec![fixed]);
        let aspect = f64::from(height) / f64::from(width);
        Self {
            full: width,
            widths,
            aspect,
            budget: LEAST_BUDGET,
            jpeg: FIRST_JPEG,
            png: FIRST_PNG,
            draw: 0.0,
        }
    }

    fn pixels(&self, width: u32) -> f64 {
        f64::from(width).powi(2) * self.aspect
    }

    /// Predicted bytes.
    fn bytes(&self, width: u32, encoding: Encoding) -> f64 {
        match encoding {
            Encoding::Png => self.png * self.pixels(width),
            Encoding::Jpeg(quality) => {
                self.jpeg * self.pixels(width) * curve(quality) * self.sharpness(width)
            }
        }
    }

    /// A narrower picture has more detail per pixel.
    fn sharpness(&self, width: u32) -> f64 {
        (f64::from(self.full) / f64::from(width)).sqrt()
    }

    /// Maximum bytes of a moving JPEG picture. `possible`: bytes per second that the connection
    /// would carry.
    fn most(&self, possible: Option<f64>) -> f64 {
        let narrowest = self.widths[self.widths.len() - 1];
        self.bytes(narrowest, Encoding::Jpeg(MOST_QUALITY))
            .max(possible.unwrap_or(0.0) * MAX_SEND)
    }

    /// Width and encoding of the next moving picture. `rate`: bytes per second that the connection
    /// has carried; `possible`: those that it would carry.
    pub fn next(&self, rate: Option<f64>, possible: Option<f64>) -> (u32, Encoding) {
        let rate = rate.unwrap_or(0.0);
        let drawn = |width: &&u32| self.draw * self.pixels(**width) <= MAX_DRAW;
        let least = self.widths[self.widths.len() - 1];
        let widest = *self.widths.iter().find(drawn).unwrap_or(&least);
        if self.bytes(widest, Encoding::Png) <= rate / PNG_RATE {
            return (widest, Encoding::Png);
        }
        let budget = self.budget.max(rate * MAX_SEND).min(self.most(possible));
        let fits = |width: u32, quality: u8| self.bytes(width, Encoding::Jpeg(quality)) <= budget;
        let narrower = self.widths.iter().copied().filter(|width| *width <= widest);
        let width = narrower
            .clone()
            .find(|width| fits(*width, LEAST_QUALITY))
            .unwrap_or(least);
        let quality = (NARROWEST_QUALITY..=MOST_QUALITY)
            .rev()
            .find(|quality| fits(width, *quality))
            .unwrap_or(NARROWEST_QUALITY);
        (width, Encoding::Jpeg(quality))
    }

    /// The encoding of the picture of full width that is sent while the pointer rests.
    pub fn at_rest(&self, rate: Option<f64>) -> Encoding {
        let bytes = self.bytes(self.full, Encoding::Png);
        if rate.is_some_and(|rate| bytes <= rate * REST_SECONDS) {
            Encoding::Png
        } else {
            Encoding::Jpeg(REST_QUALITY)
        }
    }

    /// A picture of this width was drawn; `None`: a full one.
    pub fn drawn(&mut self, width: Option<u32>, encoding: Encoding, bytes: u64, time: Duration) {
        let width = width.unwrap_or(self.full);
        let pixels = self.pixels(width);
        let share = if self.draw == 0.0 { 1.0 } else { NEWEST_WEIGHT };
        self.draw += share * (time.as_secs_f64() / pixels - self.draw);
        let correction = bytes as f64 / self.bytes(width, encoding);
        match encoding {
            Encoding::Png => self.png *= correction.powf(share),
            // Another quality is predicted by the curve, which is not exact.
            Encoding::Jpeg(REST_QUALITY) => {}
            Encoding::Jpeg(_) => self.jpeg *= correction.powf(share),
        }
    }

    /// Whether pictures can become larger, and smaller. `possible`: bytes per second that the
    /// connection would carry.
    pub fn possible_steps(&self, possible: Option<f64>) -> PossibleSteps {
        let widest = self.bytes(self.widths[0], Encoding::Jpeg(MOST_QUALITY));
        PossibleSteps {
            larger: self.budget < widest.min(self.most(possible)),
            smaller: self.budget > LEAST_BUDGET,
        }
    }

    /// Follows the advice of the window.
    pub fn follow(&mut self, advice: Advice) {
        self.budget = match advice {
            Advice::Same => self.budget,
            Advice::Larger => self.budget * BUDGET_FACTOR,
            Advice::Smaller => (self.budget / BUDGET_FACTOR).max(LEAST_BUDGET),
            Advice::MuchSmaller => (self.budget * LONG_QUEUE_FACTOR).max(LEAST_BUDGET),
        };
    }
}

/// Bytes of a JPEG file relative to quality 50: a fit for photographs.
fn curve(quality: u8) -> f64 {
    const POINTS: [(f64, f64); 8] = [
        (20.0, 0.55),
        (40.0, 0.85),
        (50.0, 1.0),
        (60.0, 1.15),
        (70.0, 1.4),
        (80.0, 1.8),
        (85.0, 2.2),
        (95.0, 5.0),
    ];
    let quality = f64::from(quality);
    let next = POINTS
        .iter()
        .position(|point| point.0 >= quality)
        .unwrap_or(POINTS.len() - 1)
        .max(1);
    let ((a, low), (b, high)) = (POINTS[next - 1], POINTS[next]);
    low + (high - low) * (quality - a) / (b - a)
}

#[cfg(test)]
mod tests {
    use super::*;

    const MS: Duration = Duration::from_millis(1);

    #[test]
    fn a_small_budget_costs_quality_before_width() {
        let mut ladder = PictureLadder::new((512, 512), None);
        let mut last = (512, MOST_QUALITY);
        let mut seen = Vec::new();
        for budget in (8..60).rev() {
            ladder.budget = f64::from(budget) * 1e3;
            let (width, Encoding::Jpeg(quality)) = ladder.next(None, Some(1e9)) else {
                panic!("a fast connection is not known")
            };
            assert!(
                width < last.0 || (width == last.0 && quality <= last.1),
                "{budget} kB: {width}, {quality} after {last:?}"
            );
            last = (width, quality);
            seen.push(width);
        }
        seen.dedup();
        assert_eq!(seen, [512, 384, 256]);
    }

    #[test]
    fn a_fast_connection_has_png_and_a_slow_machine_has_narrow_pictures() {
        let mut ladder = PictureLadder::new((3840, 2160), None);
        assert_eq!(ladder.next(Some(2e9), Some(2e9)), (3840, Encoding::Png));
        ladder.drawn(Some(3840), Encoding::Png, 12_000_000, 40 * MS);
        assert_eq!(ladder.next(Some(2e9), Some(2e9)), (1920, Encoding::Png));
        assert_eq!(ladder.next(Some(1e6), Some(1e6)).0, 480);
        assert_eq!(
            PictureLadder::new((512, 512), Some(300)).next(Some(2e9), Some(2e9)),
            (300, Encoding::Png)
        );
        assert_eq!(
            PictureLadder::new((1, 1), None).next(None, None),
            (1, Encoding::Jpeg(MOST_QUALITY))
        );
    }

    #[test]
    #[expect(clippy::cast_possible_truncation, reason = "a small number")]
    fn sizes_are_learned() {
        let mut ladder = PictureLadder::new((512, 512), None);
        for _ in 0..20 {
            let (width, encoding) = ladder.next(None, None);
            // Four times as large as expected.
            let Encoding::Jpeg(quality) = encoding else {
                panic!()
            };
            let bytes =
                4.0 * FIRST_JPEG * ladder.pixels(width) * curve(quality) * ladder.sharpness(width);
            ladder.drawn(Some(width), encoding, bytes as u64, MS);
        }
        let (width, encoding) = ladder.next(None, None);
        assert!(
            width < 512 && (ladder.jpeg / FIRST_JPEG - 4.0).abs() < 0.1,
            "{width}, {encoding:?}, {}",
            ladder.jpeg
        );
        assert_eq!(
            (ladder.at_rest(Some(1e6)), ladder.at_rest(Some(1e5))),
            (Encoding::Png, Encoding::Jpeg(REST_QUALITY))
        );
        ladder.drawn(None, Encoding::Png, 80_000, MS);
        ladder.drawn(None, Encoding::Png, 80_000, MS);
        ladder.drawn(None, Encoding::Png, 80_000, MS);
        ladder.drawn(None, Encoding::Png, 80_000, MS);
        assert_eq!(ladder.at_rest(Some(2e5)), Encoding::Png);
    }
}
