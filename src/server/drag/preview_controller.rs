//! The width of previews: as wide as about sixty frames per second allow. The controller measures
//! the drawing time of a frame and the time until its acknowledgement, divided by the number of
//! unacknowledged frames; the longer of the two is the period, because the next frame is drawn
//! while others are being sent. Times are arguments. O(1) per frame.
//!
//! A model predicts the period of another width: it is proportional to the pixels. That is wrong
//! where the latency of the connection or a slow screen dominates, so each step is a trial: a
//! narrower width that is hardly faster is taken back, a wider one that is hardly slower is kept,
//! and a failed trial is not repeated soon.

use std::time::{Duration, Instant};

/// Widths in eighths of the full one, widest first.
const WIDTH_EIGHTHS: [u32; 6] = [8, 6, 4, 3, 2, 1];
/// Minimum width, px: narrower previews show too little.
const MIN_WIDTH: u32 = 256;
/// Pixels of the first preview: a few milliseconds of drawing on a small machine, a few megabits to
/// send.
const FIRST_PIXELS: f64 = 1.2e6;
/// Maximum period, seconds: sixty frames per second.
const MAX_PERIOD: f64 = 1.0 / 60.0;
/// A step is taken if the predicted period is at most this ratio of the maximum.
const AIMED_PERIOD_RATIO: f64 = 0.75;
/// A smaller ratio of two periods does not count as a difference.
const EQUAL_PERIOD_RATIO: f64 = 1.15;
/// Weight of the newest frame in the averages, after the first few.
const NEWEST_WEIGHT: f64 = 0.2;
/// A width is judged after this number of frames, or after this time.
const JUDGED_FRAMES: u32 = 8;
const JUDGED_SLOW: Duration = Duration::from_millis(250);
/// Time after which a wider width is tried although the model predicts a longer period.
const PROBE_INTERVAL: Duration = Duration::from_secs(2);
/// The pause after a failed trial doubles up to this time.
const MAX_PAUSE: Duration = Duration::from_secs(60);

/// The width of previews, and the measured times.
#[derive(Clone, Debug)]
pub struct PreviewController {
    /// Widest first; the first is the full width.
    widths: Vec<u32>,
    at: usize,
    /// Averages at this width, seconds.
    draw: f64,
    ack: f64,
    /// Average time until an acknowledgement, per frame that was unacknowledged meanwhile, seconds.
    gap: f64,
    frames: u32,
    since: Option<Instant>,
    trial: Option<Trial>,
    narrower: Pause,
    wider: Pause,
}

/// A step that may be taken back.
#[derive(Clone, Copy, Debug)]
struct Trial {
    from: usize,
    period: f64,
}

/// The time until a trial may be repeated.
#[derive(Clone, Copy, Debug)]
struct Pause {
    until: Option<Instant>,
    next: Duration,
}

impl Pause {
    const NONE: Self = Self {
        until: None,
        next: PROBE_INTERVAL,
    };

    fn is_over(self, now: Instant) -> bool {
        self.until.is_none_or(|until| now >= until)
    }

    fn begin(&mut self, now: Instant) {
        self.until = Some(now + self.next);
        self.next = (2 * self.next).min(MAX_PAUSE);
    }
}

/// The widths of the previews that a picture has, widest first.
pub fn preview_widths(width: u32) -> Vec<u32> {
    let mut widths: Vec<u32> = WIDTH_EIGHTHS
        .iter()
        .map(|e| width.div_ceil(8).saturating_mul(*e).min(width))
        .collect();
    widths[0] = width;
    widths.retain(|w| *w >= MIN_WIDTH.min(width));
    widths.dedup();
    widths
}

impl PreviewController {
    /// A controller that adapts the width, for images of this size.
    pub fn adaptive((width, height): (u32, u32)) -> Self {
        let widths = preview_widths(width);
        let pixels = |w: u32| f64::from(w) * f64::from(w) * f64::from(height) / f64::from(width);
        let first = widths
            .iter()
            .position(|w| pixels(*w) <= FIRST_PIXELS)
            .unwrap_or(widths.len() - 1);
        Self {
            at: first,
            ..Self::of(widths)
        }
    }

    /// Always this width.
    pub fn fixed(width: u32) -> Self {
        Self::of(vec![width])
    }

    fn of(widths: Vec<u32>) -> Self {
        Self {
            widths,
            at: 0,
            draw: 0.0,
            ack: 0.0,
            gap: 0.0,
            frames: 0,
            since: None,
            trial: None,
            narrower: Pause::NONE,
            wider: Pause::NONE,
        }
    }

    /// The width of the next preview.
    pub fn width(&self) -> u32 {
        self.widths[self.at]
    }

    /// Average drawing time; zero before the first frame.
    pub fn draw_time(&self) -> Duration {
        Duration::from_secs_f64(self.draw)
    }

    /// Average time from sending a frame to its acknowledgement; zero before the first.
    pub fn ack_time(&self) -> Duration {
        Duration::from_secs_f64(self.ack)
    }

    /// A preview of this width was acknowledged, with its drawing time and the time until the
    /// acknowledgement. `unacknowledged`: the number of frames that were unacknowledged when it was
    /// sent, itself included.
    pub fn acknowledged(
        &mut self,
        now: Instant,
        width: u32,
        draw: Duration,
        ack: Duration,
        unacknowledged: u32,
    ) {
        if width != self.width() {
            return;
        }
        self.frames += 1;
        let since = *self
            .since
            .get_or_insert_with(|| now.checked_sub(draw.max(ack)).unwrap_or(now));
        let share = NEWEST_WEIGHT.max(1.0 / f64::from(self.frames));
        self.draw += share * (draw.as_secs_f64() - self.draw);
        self.ack += share * (ack.as_secs_f64() - self.ack);
        self.gap += share * (ack.as_secs_f64() / f64::from(unacknowledged.max(1)) - self.gap);
        let passed = now.saturating_duration_since(since);
        if self.frames >= JUDGED_FRAMES || passed >= JUDGED_SLOW {
            self.judge(now, passed);
        }
    }

    fn judge(&mut self, now: Instant, passed: Duration) {
        // Drawing and sending overlap: the slower of both is the time between two frames.
        let period = self.draw.max(self.gap);
        match self.trial.take() {
            Some(Trial {
                from,
                period: before,
            }) if from < self.at && period * EQUAL_PERIOD_RATIO > before => {
                // Smaller frames come no faster: something other than pixels takes the time, such
                // as the distance to the client. They would only be coarser.
                self.narrower.begin(now);
                return self.step(from, None);
            }
            Some(Trial {
                from,
                period: before,
            }) if from > self.at && period > MAX_PERIOD && period > before * EQUAL_PERIOD_RATIO => {
                // Wider frames are too slow. The next attempt waits longer, or the picture would
                // flicker between two widths.
                self.wider.begin(now);
                return self.step(from, None);
            }
            Some(Trial { from, .. }) if from > self.at => self.wider = Pause::NONE,
            Some(_) => self.narrower = Pause::NONE,
            None => {}
        }
        // The model: time is proportional to pixels. A trial shows whether that holds.
        let after =
            |to: usize| period * (f64::from(self.widths[to]) / f64::from(self.width())).powi(2);
        let trial = Some(Trial {
            from: self.at,
            period,
        });
        if period > MAX_PERIOD && self.narrower.is_over(now) && self.at + 1 < self.widths.len() {
            let fits = (self.at + 1..self.widths.len())
                .find(|to| after(*to) <= AIMED_PERIOD_RATIO * MAX_PERIOD);
            self.step(fits.unwrap_or(self.widths.len() - 1), trial);
        } else if self.at > 0
            && self.wider.is_over(now)
            && (after(self.at - 1) <= AIMED_PERIOD_RATIO * MAX_PERIOD || passed >= PROBE_INTERVAL)
        {
            self.step(self.at - 1, trial);
        }
    }

    /// Until frames of the new width are measured, the averages are scaled by the model.
    fn step(&mut self, to: usize, trial: Option<Trial>) {
        let scale = (f64::from(self.widths[to]) / f64::from(self.width())).powi(2);
        self.draw *= scale;
        self.ack *= scale;
        self.gap *= scale;
        self.at = to;
        self.frames = 0;
        self.since = None;
        self.trial = trial;
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const UHD: (u32, u32) = (3840, 2160);

    /// A machine and a way to the client: seconds that a frame of a number of pixels takes to be
    /// made and to be shown.
    struct World {
        make: fn(f64) -> f64,
        ack: fn(f64) -> f64,
    }

    /// Widths over the frames of a number of seconds.
    fn run(pace: &mut PreviewController, start: Instant, seconds: f64, world: &World) -> Vec<u32> {
        let mut widths = Vec::new();
        let mut time = 0.0;
        while time < seconds {
            let width = pace.width();
            let pixels = f64::from(width) * f64::from(width) * 9.0 / 16.0;
            let (make, ack) = ((world.make)(pixels), (world.ack)(pixels));
            time += make.max(ack).max(0.008);
            pace.acknowledged(
                start + Duration::from_secs_f64(time),
                width,
                Duration::from_secs_f64(make),
                Duration::from_secs_f64(ack),
                1,
            );
            widths.push(width);
        }
        widths
    }

    /// The share of the later half of the frames that has the width.
    fn share(widths: &[u32], width: u32) -> f64 {
        let half = &widths[widths.len() / 2..];
        half.iter().filter(|w| **w == width).count() as f64 / half.len() as f64
    }

    #[test]
    fn widths_are_a_few_steps_down_to_a_least_one() {
        assert_eq!(
            PreviewController::adaptive(UHD).widths,
            [3840, 2880, 1920, 1440, 960, 480]
        );
        assert_eq!(
            PreviewController::adaptive((512, 512)).widths,
            [512, 384, 256]
        );
        assert_eq!(
            PreviewController::adaptive((511, 90)).widths,
            [511, 384, 256]
        );
        assert_eq!(PreviewController::adaptive((100, 5000)).widths, [100]);
        assert_eq!(PreviewController::adaptive((1, 1)).widths, [1]);
        assert_eq!(
            PreviewController::adaptive((512, 512)).width(),
            512,
            "a small picture begins whole"
        );
        assert_eq!(
            PreviewController::adaptive(UHD).width(),
            1440,
            "a large one does not"
        );
    }

    #[test]
    fn a_fast_machine_gets_the_whole_picture_and_keeps_it() {
        let mut pace = PreviewController::adaptive(UHD);
        let widths = run(
            &mut pace,
            Instant::now(),
            10.0,
            &World {
                make: |px| px * 1e-9,
                ack: |px| px * 0.3e-9,
            },
        );
        assert!(share(&widths, 3840) == 1.0, "{widths:?}");
    }

    #[test]
    fn a_machine_that_cannot_hold_it_gets_the_widest_that_it_can() {
        // 2.4 ns a pixel: the whole picture takes 20 ms, three quarters of its width 11 ms.
        let mut pace = PreviewController::adaptive(UHD);
        let widths = run(
            &mut pace,
            Instant::now(),
            60.0,
            &World {
                make: |px| 0.5e-3 + px * 2.4e-9,
                ack: |_| 1e-3,
            },
        );
        assert!(share(&widths, 2880) > 0.95, "{}", share(&widths, 2880));
    }

    #[test]
    fn a_slow_connection_narrows_within_a_few_frames() {
        // 20 Mbit/s at 1.5 bytes a pixel.
        let mut pace = PreviewController::adaptive(UHD);
        let widths = run(
            &mut pace,
            Instant::now(),
            60.0,
            &World {
                make: |px| px * 1e-9,
                ack: |px| px * 0.6e-6,
            },
        );
        assert!(widths[1] == 480, "{:?}", &widths[..5]);
        assert!(share(&widths, 480) > 0.9, "{}", share(&widths, 480));
    }

    #[test]
    fn a_long_way_does_not_narrow_the_picture_for_long() {
        // 100 ms there and back, whatever the size.
        let mut pace = PreviewController::adaptive((1024, 768));
        let widths = run(
            &mut pace,
            Instant::now(),
            120.0,
            &World {
                make: |px| px * 2e-9,
                ack: |px| 0.1 + px * 1e-9,
            },
        );
        assert!(share(&widths, 1024) > 0.9, "{}", share(&widths, 1024));
        // Neither does it keep a large one narrow.
        let mut pace = PreviewController::adaptive((2048, 1536));
        let widths = run(
            &mut pace,
            Instant::now(),
            120.0,
            &World {
                make: |px| px * 2e-9,
                ack: |px| 0.1 + px * 1e-9,
            },
        );
        assert!(share(&widths, 2048) > 0.9, "{}", share(&widths, 2048));
    }

    #[test]
    fn a_screen_that_shows_sixty_frames_a_second_is_no_slow_connection() {
        let mut pace = PreviewController::adaptive((1920, 1080));
        let widths = run(
            &mut pace,
            Instant::now(),
            60.0,
            &World {
                make: |px| px * 2e-9,
                ack: |_| 0.014,
            },
        );
        assert!(share(&widths, 1920) > 0.95, "{}", share(&widths, 1920));
    }

    #[test]
    fn a_machine_that_is_free_again_widens_again() {
        let mut pace = PreviewController::adaptive(UHD);
        let start = Instant::now();
        run(
            &mut pace,
            start,
            10.0,
            &World {
                make: |px| px * 10e-9,
                ack: |_| 1e-3,
            },
        );
        assert!(pace.width() < 1920);
        run(
            &mut pace,
            start + Duration::from_secs(10),
            70.0,
            &World {
                make: |px| px * 1e-9,
                ack: |_| 1e-3,
            },
        );
        assert_eq!(pace.width(), 3840);
    }

    #[test]
    fn a_fixed_width_stays() {
        let mut pace = PreviewController::fixed(1024);
        run(
            &mut pace,
            Instant::now(),
            5.0,
            &World {
                make: |_| 1.0,
                ack: |_| 1.0,
            },
        );
        assert_eq!(pace.width(), 1024);
    }
}
