//! How many frames may be unacknowledged. A fixed window is a number. The automatic one is 1 at
//! first and changes by trial, so that the connection is busy and no queue stands in front of it:
//!
//! | state | rule | reason |
//! |---|---|---|
//! | for a round trip, poses waited and the fastest frame had almost no queue | one more; at the start, twice as many | idle times |
//! | the fastest frame of a round trip was in a queue for more than half a sending time | one less | a frame more only waits |
//! | for more than a quarter, with `frames=auto` and more frames than [`picture_ladder::TARGET_FRAME_RATE`] needs | one less | age before rate |
//! | the step up was taken back | no step up for 2 s, then twice as long, up to 20 s | each trial makes a few frames older |
//! | a frame was in a queue for more than two sending times | what fits at the newest rate, at once | the rate has fallen |
//! | the period is that of sixty frames per second | no step up | more frames are not seen |
//! | never alone for 10 s | half of the window for a round trip | the time of a frame without a queue is measured again |
//! | frames can become smaller or larger, and there are about [`picture_ladder::TARGET_FRAME_RATE`] per second | they do, in place of a step | quality |
//!
//! Jitter looks like a queue: each rule allows for a multiple of the mean difference between
//! successive frames. Times are arguments.

use std::time::{Duration, Instant};

use super::link_estimate::Measured;
use super::picture_ladder::{self, Advice, PossibleSteps};

/// Maximum window.
pub const MAX_WINDOW: usize = 8;
/// Frames per second beyond which the window does not grow.
const MAX_FRAME_RATE: f64 = 60.0;
/// Part of a frame by which the window may fall short of that rate: a screen that shows sixty
/// frames per second acknowledges late.
const LATE_FRAME_SHARE: f64 = 0.25;
/// Lengths of a queue: in sending times of a frame, plus in mean differences by jitter, plus in
/// seconds.
type Length = (f64, f64, f64);
/// A step up is taken below this queue.
const EMPTY_QUEUE: Length = (0.15, 1.1, 0.0);
/// Above this queue, frames become smaller; if they have enough frames per second, a step down is
/// taken.
const SMALL_QUEUE: Length = (0.25, 1.5, 0.002);
/// A step down is taken above this queue.
const STANDING_QUEUE: Length = (0.5, 1.5, 0.003);
/// At this queue, the window is reduced at once.
const LONG_QUEUE: Length = (2.0, 4.0, 0.03);
/// No step up is taken if a frame takes longer than this to send, seconds: the step may make a
/// frame that much older.
const MAX_TRIAL_SECONDS: f64 = 0.3;
/// More than one step is taken if the frames take at most this time to send, seconds.
const MAX_MULTISTEP_SECONDS: f64 = 0.15;
/// Part of a frame that may wait after a reduction by more than one step: a window of one less
/// would leave the connection idle.
const EXCESS_FRAME_SHARE: f64 = 0.25;
/// Pause after a failed step up; it doubles up to the second value.
const STEP_UP_PAUSE: Duration = Duration::from_secs(2);
const MAX_PAUSE: Duration = Duration::from_secs(20);
/// A queue that stands for this time is emptied.
const DRAIN_TIME: Duration = Duration::from_secs(10);

/// The window that a client asks for.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Window {
    /// Adapted to the connection.
    Auto,
    /// This number of frames, 1 to [`MAX_WINDOW`].
    Fixed(usize),
}

/// A round trip that has ended.
struct RoundTrip {
    now: Instant,
    /// Number of the first frame after it.
    next: u64,
    /// The least queue of its frames, seconds.
    queue: f64,
    /// The newest frame.
    link: Measured,
    possible: PossibleSteps,
}

impl RoundTrip {
    /// Frames under way for `rate` per second; `margin`: the part of a frame by which they may fall
    /// short.
    fn frames_of(&self, rate: f64, margin: f64) -> f64 {
        (rate * (self.link.took - self.link.queue) - margin).ceil()
    }
}

/// Seconds of a length of a queue.
fn length(link: Measured, (frames, jitter, seconds): Length) -> f64 {
    frames * link.frame + jitter * link.jitter + seconds
}

/// The window of one drag.
#[derive(Debug)]
pub struct SendWindow {
    is_auto: bool,
    frames: usize,
    /// Number of the first frame of this round trip.
    round: u64,
    /// Number of the first frame after the last reduction by a long queue.
    reduced: u64,
    /// The least queue of this round trip, seconds.
    least: Option<f64>,
    /// Whether a pose waited for an acknowledgement in this round trip.
    is_limit: bool,
    is_trial: bool,
    /// Whether no queue was seen yet.
    is_start: bool,
    pause: Duration,
    not_before: Option<Instant>,
    alone: Option<Instant>,
    /// The window after the round trip with half of it.
    drained: Option<usize>,
}

impl SendWindow {
    /// The window at the start.
    pub const fn new(window: Window) -> Self {
        let (is_auto, frames) = match window {
            Window::Auto => (true, 1),
            Window::Fixed(frames) => (false, frames),
        };
        Self {
            is_auto,
            frames,
            round: 0,
            reduced: 0,
            least: None,
            is_limit: false,
            is_trial: false,
            is_start: true,
            pause: STEP_UP_PAUSE,
            not_before: None,
            alone: None,
            drained: None,
        }
    }

    /// The number of frames that may be unacknowledged.
    pub const fn frames(&self) -> usize {
        self.frames
    }

    /// A pose waits although a frame of it could be drawn: the window is full.
    pub const fn is_full(&mut self) {
        self.is_limit = true;
    }

    /// A frame was acknowledged. `number`: its number in the order of sending; `next`: that of the
    /// next frame; `is_alone`: no other frame was unacknowledged when it was sent. The result says
    /// what pictures should do. They become smaller before there are fewer than
    /// [`picture_ladder::TARGET_FRAME_RATE`] per second.
    pub fn acknowledged(
        &mut self,
        now: Instant,
        number: u64,
        next: u64,
        is_alone: bool,
        link: Measured,
        possible: PossibleSteps,
    ) -> Advice {
        // A frame that was alone has shown the time without a queue. When none has for long, a
        // standing queue would pass for the latency of the link.
        if is_alone || self.alone.is_none() {
            self.alone = Some(now);
        }
        if link.queue > length(link, LONG_QUEUE) {
            // Frames that were sent before the last reduction say nothing of it.
            if number < self.reduced {
                return Advice::Same;
            }
            // Two sending times and more: waiting for the end of the round trip would make every
            // pose of it older. All frames that are under way were sent before this change.
            self.reduced = next;
            self.is_start = false;
            self.drained = None;
            self.step(self.fitting(link), next);
            return Advice::MuchSmaller;
        }
        // Frames of the earlier round trip were sent with the earlier window.
        if number < self.round {
            return Advice::Same;
        }
        // The least queue of the round trip: a single frame may have been delayed by jitter, but a
        // queue that no frame escapes is real.
        let queue = self.least.map_or(link.queue, |least| least.min(link.queue));
        self.least = Some(queue);
        // The last frame of the round trip is the last that was sent before the first was
        // acknowledged.
        if number + 1 < self.round + self.frames as u64 && self.is_limit {
            return Advice::Same;
        }
        // The round trip with half of the window has measured the latency; the window goes back to
        // what it was.
        if let Some(frames) = self.drained.take() {
            self.step(frames, next);
            return Advice::Same;
        }
        let round = RoundTrip {
            now,
            next,
            queue,
            link,
            possible,
        };
        // Less before more, and the measurement of the latency in between: a queue that may be old
        // must not be answered by growth.
        let followed = self
            .shrink(&round)
            .or_else(|| self.drain(&round))
            .or_else(|| self.grow(&round));
        followed.unwrap_or_else(|| {
            if self.is_trial {
                // The step up has passed a round trip without a queue: the next failure begins with
                // a short pause again.
                self.pause = STEP_UP_PAUSE;
            }
            self.step(self.frames, next);
            Advice::Same
        })
    }

    /// After a round trip with a queue: smaller pictures, or a smaller window.
    fn shrink(&mut self, round: &RoundTrip) -> Option<Advice> {
        let enough = round.frames_of(picture_ladder::TARGET_FRAME_RATE, 0.0);
        // Quality goes first: with just enough frames for fluent motion, each must be smaller. With
        // more than enough, one frame fewer costs nothing that is seen.
        if round.possible.smaller
            && self.frames as f64 <= enough
            && round.queue > length(round.link, SMALL_QUEUE)
        {
            self.is_start = false;
            self.step(self.frames, round.next);
            return Some(Advice::Smaller);
        }
        let adapts = round.possible.larger || round.possible.smaller;
        // While pictures can adapt, rate beyond the target is given up at a shorter queue: it buys
        // age.
        let most = if adapts && self.frames as f64 > enough {
            SMALL_QUEUE
        } else {
            STANDING_QUEUE
        };
        if self.frames == 1 || round.queue <= length(round.link, most) {
            return None;
        }
        if self.is_trial {
            // The step was one too many. Each failure doubles the pause, because each trial makes a
            // few frames older.
            self.not_before = Some(round.now + self.pause);
            self.pause = (2 * self.pause).min(MAX_PAUSE);
        }
        // At the start the window doubles, so it may be far too large; later it is off by one.
        let frames = if self.is_start {
            self.fitting(round.link)
        } else {
            self.frames - 1
        };
        self.is_start = false;
        self.step(frames, round.next);
        Some(Advice::Same)
    }

    /// If a queue may have been standing for long: half of the window for a round trip.
    fn drain(&mut self, round: &RoundTrip) -> Option<Advice> {
        if self.frames == 1
            || self
                .alone
                .is_none_or(|alone| round.now.saturating_duration_since(alone) <= DRAIN_TIME)
        {
            return None;
        }
        self.alone = Some(round.now);
        self.drained = Some(self.frames);
        // With half of the window the queue drains, and the link is not idle for all of the round
        // trip.
        self.step(self.frames / 2, round.next);
        Some(Advice::Same)
    }

    /// After a round trip in which poses waited without a queue: larger pictures, or a larger
    /// window.
    fn grow(&mut self, round: &RoundTrip) -> Option<Advice> {
        if !self.is_limit || round.queue >= length(round.link, EMPTY_QUEUE) {
            // If no pose waited, the window was not what limits the rate, and an empty queue says
            // nothing of a larger one.
            return None;
        }
        if round.possible.larger
            && self.frames as f64 >= round.frames_of(picture_ladder::TARGET_FRAME_RATE, 0.0)
        {
            self.step(self.frames, round.next);
            return Some(Advice::Larger);
        }
        let most = round
            // Rate times latency is what can be under way; more than a screen shows only makes
            // frames wait.
            .frames_of(MAX_FRAME_RATE, LATE_FRAME_SHARE)
            .clamp(1.0, MAX_WINDOW as f64);
        let frame = round.link.frame;
        if self.frames as f64 >= most
            || frame >= MAX_TRIAL_SECONDS
            || self.not_before.is_some_and(|time| round.now < time)
        {
            return None;
        }
        // Doubling, as TCP's slow start, until a queue is seen for the first time.
        let steps = if self.is_start { self.frames } else { 1 };
        let is_short = |steps: &usize| {
            *steps as f64 * frame <= MAX_MULTISTEP_SECONDS && (self.frames + steps) as f64 <= most
        };
        let frames = self.frames + (1..=steps).rev().find(is_short).unwrap_or(1);
        // A queue has built up a round trip later.
        self.step(frames, round.next + frames as u64);
        self.is_trial = true;
        Some(Advice::Same)
    }

    /// A smaller window, at the rate of the newest frame almost without a queue.
    fn fitting(&self, link: Measured) -> usize {
        (1..self.frames)
            // At least one less, at least one in all.
            .rev()
            .find(|frames| *frames as f64 <= link.fits + EXCESS_FRAME_SHARE)
            .unwrap_or(1)
    }

    fn step(&mut self, frames: usize, next: u64) {
        // A fixed window measures as well, for the advice to pictures, but keeps its size.
        let frames = if self.is_auto { frames } else { self.frames };
        *self = Self {
            frames,
            round: next,
            least: None,
            is_limit: false,
            is_trial: false,
            ..*self
        };
    }
}
