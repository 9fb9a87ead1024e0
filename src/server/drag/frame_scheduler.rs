//! What is to be done next for one hand: which pose is made into a frame, when, how wide, and when a frame leaves. It owns the rules of the
//! drag and nothing else: no clock (times are handed in), no picture (frames are a type of their owner's), no socket.
//!
//! - Of the poses that wait, only the newest is kept.
//! - At most one frame is under way: the next leaves when the client has shown it. At most one more is made or being made.
//! - The next frame is begun so that it is ready just when the last one should be shown: sooner, its pose would be old; later, the way would
//!   be idle. When the client took longer than expected and a newer pose is there, a frame that has grown old is made anew, once.
//! - A frame that is begun is finished, but for the full one of a hand that rests: that is given up when the hand moves on.

use std::sync::Arc;
use std::time::{Duration, Instant};

use super::preview_controller::PreviewController;
use crate::wire::UnreadHandles;

/// A hand that has sent nothing for so long rests.
pub const REST: Duration = Duration::from_millis(150);
/// A frame is begun so much earlier than its average says.
const EARLY: f64 = 1.25;
/// A frame that has waited for as long as so many makings take has grown old.
const OLD: u32 = 2;
/// A pose that found no room is tried again after this.
const AGAIN: Duration = Duration::from_millis(10);

/// Where the hand was at a moment.
#[derive(Clone, Debug)]
pub struct Pose {
    /// The client's number.
    pub seq: u64,
    /// Posed handles, as they came.
    pub q: Arc<UnreadHandles>,
    /// When it arrived.
    pub at: Instant,
}

/// A frame to be made.
#[derive(Clone, Debug)]
pub struct FrameRequest {
    /// Of this pose.
    pub pose: Pose,
    /// So wide; `None`: as the session has it.
    pub width: Option<u32>,
    /// It follows a preview of the same pose, because the hand rests.
    pub is_full_quality: bool,
}

/// What is to be done now.
#[derive(Debug)]
pub enum Step<F> {
    /// Begin this frame.
    Make(FrameRequest),
    /// Give up what is being made.
    GiveUp,
    /// Send this frame.
    Send(F),
    /// Nothing before this time, unless something happens.
    Wait(Option<Instant>),
}

/// An acknowledgement of a frame that was not sent.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct NotSent;

/// The state of one drag.
#[derive(Debug)]
pub struct FrameScheduler<F> {
    pace: PreviewController,
    /// The width at which nothing is missing.
    full: u32,
    waiting: Option<Pose>,
    not_before: Option<Instant>,
    making: Option<Making>,
    ready: Option<Ready<F>>,
    sent: Option<Sent>,
    /// The last frame that was shown, while it is a preview.
    preview: Option<Pose>,
    last_pose: Option<Instant>,
    newest_sent: Option<u64>,
    superseded: u64,
}

#[derive(Debug)]
struct Making {
    order: FrameRequest,
    began: Instant,
}

/// Made, and waits for the client.
#[derive(Debug)]
struct Ready<F> {
    frame: F,
    order: FrameRequest,
    made: Duration,
    since: Instant,
}

/// Under way to the client.
#[derive(Debug)]
struct Sent {
    order: FrameRequest,
    made: Duration,
    since: Instant,
}

impl<F> FrameScheduler<F> {
    /// `full`: the width at which nothing is missing; narrower previews are followed by a full frame when the hand rests.
    #[must_use]
    pub const fn new(pace: PreviewController, full: u32) -> Self {
        Self {
            pace,
            full,
            waiting: None,
            not_before: None,
            making: None,
            ready: None,
            sent: None,
            preview: None,
            last_pose: None,
            newest_sent: None,
            superseded: 0,
        }
    }

    /// The picture is another one from now on.
    pub fn resize(&mut self, pace: PreviewController, full: u32) {
        self.pace = pace;
        self.full = full;
        self.preview = None;
    }

    /// Poses that were overtaken before anything was made of them, and frames that were before they could be sent, since the last call.
    #[must_use]
    pub fn take_superseded(&mut self) -> u64 {
        std::mem::take(&mut self.superseded)
    }

    /// Since when the client has owed an acknowledgement.
    #[must_use]
    pub fn owed_since(&self) -> Option<Instant> {
        self.sent.as_ref().map(|sent| sent.since)
    }

    /// The hand has moved.
    pub fn pose(&mut self, pose: Pose) {
        self.last_pose = Some(pose.at);
        if self.waiting.replace(pose).is_some() {
            self.superseded += 1;
        }
    }

    /// The client has shown a frame.
    ///
    /// # Errors
    /// No frame of this number, or a higher one, has been sent.
    pub fn ack(&mut self, seq: u64, now: Instant) -> Result<(), NotSent> {
        if self.newest_sent.is_none_or(|newest| seq > newest) {
            return Err(NotSent);
        }
        if let Some(sent) = self.sent.take_if(|sent| sent.order.pose.seq == seq) {
            if let Some(width) = sent.order.width {
                self.pace.shown(now, width, sent.made, now.saturating_duration_since(sent.since));
                if width < self.full && self.ready.is_none() {
                    self.preview = Some(sent.order.pose);
                }
            }
            if self.waiting.is_some() && self.ready.as_ref().is_some_and(|ready| self.has_grown_old(ready, now)) {
                self.ready = None;
                self.superseded += 1;
            }
        }
        Ok(())
    }

    fn has_grown_old(&self, ready: &Ready<F>, now: Instant) -> bool {
        now.saturating_duration_since(ready.since) > OLD * self.pace.make_time().max(ready.made)
    }

    /// What was being made is there.
    pub fn made(&mut self, frame: F, now: Instant) {
        if let Some(Making { order, began }) = self.making.take() {
            self.preview = None;
            self.ready = Some(Ready { frame, order, made: now.saturating_duration_since(began), since: now });
        }
    }

    /// What was being made cannot be.
    pub fn failed(&mut self) -> Option<FrameRequest> {
        self.making.take().map(|making| making.order)
    }

    /// There was no room for what was to be made: its pose waits again, unless there is a newer one.
    pub fn refused(&mut self, now: Instant) {
        if let Some(Making { order, .. }) = self.making.take() {
            self.not_before = Some(now + AGAIN);
            if order.is_full_quality {
                self.preview = Some(order.pose);
            } else if self.waiting.is_none() {
                self.waiting = Some(order.pose);
            } else {
                self.superseded += 1;
            }
        }
    }

    /// What to do now.
    pub fn next(&mut self, now: Instant) -> Step<F> {
        if self.waiting.is_some() {
            // The pose that waits may come to nothing: then the preview is still to be followed by a full frame.
            if let Some(making) = self.making.take_if(|making| making.order.is_full_quality) {
                self.preview = Some(making.order.pose);
                return Step::GiveUp;
            }
            if let Some(ready) = self.ready.take_if(|ready| ready.order.is_full_quality) {
                self.preview = Some(ready.order.pose);
            }
        }
        if self.sent.is_none()
            && let Some(Ready { frame, order, made, .. }) = self.ready.take()
        {
            self.newest_sent = self.newest_sent.max(Some(order.pose.seq));
            self.sent = Some(Sent { order, made, since: now });
            return Step::Send(frame);
        }
        if self.making.is_some() || self.ready.is_some() {
            return Step::Wait(None);
        }
        let (begin, is_full_quality) = match (&self.waiting, &self.preview) {
            (Some(_), _) => (self.begin(now), false),
            (None, Some(_)) if self.sent.is_none() => (self.last_pose.map_or(now, |last| last + REST), true),
            _ => return Step::Wait(None),
        };
        let begin = self.not_before.map_or(begin, |not_before| begin.max(not_before));
        if begin > now {
            return Step::Wait(Some(begin));
        }
        self.not_before = None;
        let pose = if is_full_quality { self.preview.take() } else { self.waiting.take() };
        let Some(pose) = pose else { return Step::Wait(None) };
        let width = (!is_full_quality).then(|| self.pace.width());
        let order = FrameRequest { pose, width, is_full_quality };
        self.making = Some(Making { order: order.clone(), began: now });
        Step::Make(order)
    }

    /// When the frame that waits should be begun.
    fn begin(&self, now: Instant) -> Instant {
        self.sent.as_ref().map_or(now, |sent| {
            let lead = self.pace.make_time().mul_f64(EARLY);
            sent.since + self.pace.ack_time().saturating_sub(lead)
        })
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const MS: Duration = Duration::from_millis(1);

    /// A hand, a machine and a client, millisecond by millisecond.
    struct World {
        desk: FrameScheduler<u64>,
        start: Instant,
        now: u32,
        make: u32,
        ack: u32,
        being_made: Option<(u64, u32)>,
        under_way: Option<(u64, u32)>,
        /// What was shown: seq, when, and whether it was made again.
        shown: Vec<(u64, u32, bool)>,
        made: u32,
        given_up: u32,
        is_full_quality: bool,
        deaf: bool,
    }

    impl World {
        fn new(pace: PreviewController, full: u32, make: u32, ack: u32) -> Self {
            let desk = FrameScheduler::new(pace, full);
            let start = Instant::now();
            Self {
                desk,
                start,
                now: 0,
                make,
                ack,
                being_made: None,
                under_way: None,
                shown: Vec::new(),
                made: 0,
                given_up: 0,
                is_full_quality: false,
                deaf: false,
            }
        }

        fn pose(&mut self, seq: u64) {
            self.desk.pose(Pose { seq, q: Arc::default(), at: self.start + self.now * MS });
        }

        fn tick(&mut self) {
            let now = self.start + self.now * MS;
            if let Some((seq, _)) = self.being_made.take_if(|(_, at)| *at <= self.now) {
                self.desk.made(seq, now);
                self.made += 1;
            }
            if !self.deaf
                && let Some((seq, _)) = self.under_way.take_if(|(_, at)| *at <= self.now)
            {
                self.desk.ack(seq, now).unwrap();
                self.shown.push((seq, self.now, self.is_full_quality));
            }
            loop {
                match self.desk.next(now) {
                    Step::Make(order) => {
                        assert!(self.being_made.is_none(), "one frame is made at a time");
                        self.is_full_quality = order.is_full_quality;
                        self.being_made = Some((order.pose.seq, self.now + self.make));
                    }
                    Step::GiveUp => {
                        assert!(self.being_made.take().is_some());
                        self.given_up += 1;
                    }
                    Step::Send(seq) => {
                        assert!(self.under_way.is_none(), "one frame is under way at a time");
                        self.under_way = Some((seq, self.now + self.ack));
                    }
                    Step::Wait(Some(until)) => {
                        assert!(until > now);
                        break;
                    }
                    Step::Wait(None) => break,
                }
            }
            self.now += 1;
        }

        /// A hand at 125 Hz; what it sent when.
        fn drag(&mut self, poses: u64) {
            for seq in 0..poses {
                self.pose(seq);
                for _ in 0..8 {
                    self.tick();
                }
            }
        }

        fn rest(&mut self, ms: u32) {
            for _ in 0..ms {
                self.tick();
            }
        }

        /// Ages of what was shown but the first few frames: when shown less when sent.
        fn ages(&self) -> Vec<u64> {
            let mut ages: Vec<u64> = self.shown.iter().skip(8).map(|(seq, at, _)| u64::from(*at) - 8 * seq).collect();
            ages.sort_unstable();
            ages
        }
    }

    #[test]
    fn what_keeps_up_shows_every_pose_at_once() {
        let mut world = World::new(PreviewController::fixed(512), 512, 2, 1);
        world.drag(100);
        world.rest(300);
        assert_eq!(world.shown.len(), 100);
        assert!(
            world.shown.iter().all(|(seq, at, is_full_quality)| u64::from(*at) == 8 * seq + 3 && !is_full_quality),
            "{:?}",
            world.shown
        );
        assert_eq!(world.desk.take_superseded(), 0);
    }

    #[test]
    fn what_is_slow_shows_the_newest_and_the_last() {
        for (make, ack) in [(2, 50), (30, 3), (30, 30), (1, 1000), (200, 1)] {
            let mut world = World::new(PreviewController::fixed(512), 512, make, ack);
            world.drag(300);
            world.rest(3 * (make + ack) + 20);
            let seqs: Vec<u64> = world.shown.iter().map(|(seq, ..)| *seq).collect();
            assert!(seqs.is_sorted_by(|a, b| a < b), "{seqs:?}");
            assert_eq!(seqs.last(), Some(&299), "make {make}, ack {ack}");
            assert_eq!(world.desk.take_superseded() + seqs.len() as u64, 300, "make {make}, ack {ack}");
        }
    }

    #[test]
    fn a_long_way_is_never_idle_and_its_frames_are_young() {
        let mut world = World::new(PreviewController::fixed(512), 512, 2, 50);
        world.drag(500);
        let ages = world.ages();
        // Two milliseconds of making, fifty of way, and up to eight since the last pose.
        assert!(*ages.last().unwrap() <= 2 + 50 + 8 + 2, "{ages:?}");
        assert!(world.shown.len() >= 4000 / 53, "{}", world.shown.len());
        assert!(world.made as usize <= world.shown.len() + 8, "{} frames made for {} shown", world.made, world.shown.len());
    }

    #[test]
    fn a_client_that_is_later_than_expected_gets_a_young_frame() {
        let mut world = World::new(PreviewController::fixed(512), 512, 2, 10);
        world.drag(50);
        world.deaf = true;
        world.rest(500);
        world.pose(1000);
        world.rest(100);
        assert_eq!(world.made as usize, world.shown.len() + 2, "one under way and one ready, however long the client is silent");
        world.deaf = false;
        let shown = world.shown.len();
        world.rest(60);
        let seqs: Vec<u64> = world.shown[shown..].iter().map(|(seq, ..)| *seq).collect();
        assert_eq!(seqs.last(), Some(&1000));
        assert!(seqs.len() <= 2, "what had grown old was not sent: {seqs:?}");
    }

    #[test]
    fn a_hand_that_rests_gets_the_full_frame_once() {
        let mut world = World::new(PreviewController::fixed(256), 512, 2, 3);
        world.drag(20);
        let last = 8 * 19;
        world.rest(1000);
        let is_full_quality: Vec<_> = world.shown.iter().filter(|(.., is_full_quality)| *is_full_quality).collect();
        assert_eq!(is_full_quality, [&(19, last + 150 + 5, true)]);
        // Nothing is missing in a preview of the full width.
        let mut world = World::new(PreviewController::fixed(512), 512, 2, 3);
        world.drag(20);
        world.rest(1000);
        assert_eq!(world.shown.len(), 20);
    }

    #[test]
    fn a_hand_that_moves_on_gives_up_the_full_frame() {
        let mut world = World::new(PreviewController::fixed(256), 512, 40, 3);
        world.pose(0);
        world.rest(170);
        assert!(world.being_made.is_some());
        world.pose(1);
        world.rest(1);
        assert_eq!(world.given_up, 1);
        world.rest(1000);
        assert_eq!(
            world.shown.iter().map(|(seq, _, is_full_quality)| (*seq, *is_full_quality)).collect::<Vec<_>>(),
            [(0, false), (1, false), (1, true)]
        );
    }

    #[test]
    fn a_pose_that_comes_to_nothing_leaves_the_last_frame_to_be_made_full() {
        for acknowledged_while_making in [false, true] {
            let mut desk: FrameScheduler<()> = FrameScheduler::new(PreviewController::fixed(256), 512);
            let start = Instant::now();
            let pose = |seq| Pose { seq, q: Arc::default(), at: start };
            desk.pose(pose(1));
            assert!(matches!(desk.next(start), Step::Make(_)));
            desk.made((), start);
            assert!(matches!(desk.next(start), Step::Send(())));
            if !acknowledged_while_making {
                desk.ack(1, start).unwrap();
            }
            desk.pose(pose(2));
            assert!(matches!(desk.next(start + MS), Step::Make(FrameRequest { is_full_quality: false, .. })));
            if acknowledged_while_making {
                desk.ack(1, start + MS).unwrap();
            }
            assert!(desk.failed().is_some());
            assert!(matches!(desk.next(start + MS), Step::Wait(Some(until)) if until == start + REST));
            assert!(matches!(desk.next(start + REST), Step::Make(FrameRequest { pose: Pose { seq: 1, .. }, is_full_quality: true, .. })));
        }
    }

    #[test]
    fn acknowledgements_are_of_frames_that_were_sent() {
        let mut world = World::new(PreviewController::fixed(512), 512, 2, 3);
        assert_eq!(world.desk.ack(0, world.start), Err(NotSent));
        world.pose(5);
        world.rest(10);
        assert_eq!(world.shown.len(), 1);
        let now = world.start + world.now * MS;
        assert_eq!((world.desk.ack(6, now), world.desk.ack(5, now), world.desk.ack(4, now)), (Err(NotSent), Ok(()), Ok(())));
    }

    #[test]
    fn a_pose_that_found_no_room_waits_unless_there_is_a_newer_one() {
        let mut desk: FrameScheduler<()> = FrameScheduler::new(PreviewController::fixed(512), 512);
        let now = Instant::now();
        let pose = |seq| Pose { seq, q: Arc::default(), at: now };
        desk.pose(pose(1));
        assert!(matches!(desk.next(now), Step::Make(FrameRequest { pose: Pose { seq: 1, .. }, .. })));
        desk.refused(now);
        assert!(matches!(desk.next(now), Step::Wait(Some(until)) if until == now + AGAIN));
        assert!(matches!(desk.next(now + AGAIN), Step::Make(FrameRequest { pose: Pose { seq: 1, .. }, .. })));
        desk.pose(pose(2));
        desk.refused(now);
        assert!(matches!(desk.next(now + AGAIN), Step::Make(FrameRequest { pose: Pose { seq: 2, .. }, .. })));
        assert_eq!(desk.take_superseded(), 1);
    }
}
