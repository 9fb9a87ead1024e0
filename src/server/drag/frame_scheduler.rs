//! The request of a drag's frames: which pose is drawn next, when, how wide, and when a frame is sent. Times are arguments and frames are
//! of any type.
//!
//! - Of the waiting poses, only the newest is kept.
//! - At most one frame is unacknowledged. At most one more is in progress or ready.
//! - The next frame is started so that it is ready when the acknowledgement is expected: earlier, its pose would be old; later, the
//!   connection would be idle. If the client takes longer than expected and a newer pose waits, an outdated frame is drawn again, once.
//! - A frame is always completed, except the full-quality frame of a resting pointer, which is cancelled when the pointer moves.

use std::sync::Arc;
use std::time::{Duration, Instant};

use super::preview_controller::PreviewController;
use crate::wire::UnreadHandles;

/// Without a pose for this time, the pointer rests.
pub const REST: Duration = Duration::from_millis(150);
/// A frame starts this many average drawing times before it is needed.
const EARLY: f64 = 1.25;
/// A ready frame is outdated after this many drawing times.
const OUTDATED: u32 = 2;
/// A rejected pose is retried after this time.
const REJECTED_POSE_RETRY: Duration = Duration::from_millis(10);

/// The positions of the handles at a time.
#[derive(Clone, Debug)]
pub struct Pose {
    /// The client's sequence number.
    pub seq: u64,
    /// Posed handles, not yet parsed.
    pub q: Arc<UnreadHandles>,
    /// Time of arrival.
    pub at: Instant,
}

/// A frame to draw.
#[derive(Clone, Debug)]
pub struct FrameRequest {
    /// The pose.
    pub pose: Pose,
    /// The width, px; `None`: the session's width.
    pub width: Option<u32>,
    /// Whether it follows a preview of the same pose, because the pointer rests.
    pub is_full_quality: bool,
}

/// The next step.
#[derive(Debug)]
pub enum Step<F> {
    /// Draw this frame.
    Draw(FrameRequest),
    /// Cancel the frame in progress.
    Cancel,
    /// Send this frame.
    Send(F),
    /// Wait for an event, or until this time.
    Wait(Option<Instant>),
}

/// An acknowledgement of a frame that was not sent.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct NotSent;

/// The state of one drag.
#[derive(Debug)]
pub struct FrameScheduler<F> {
    previews: PreviewController,
    /// The full width.
    full: u32,
    waiting: Option<Pose>,
    not_before: Option<Instant>,
    drawing: Option<Drawing>,
    ready: Option<Ready<F>>,
    sent: Option<Sent>,
    /// The pose of the last acknowledged frame, if that is a preview.
    preview: Option<Pose>,
    last_pose: Option<Instant>,
    newest_sent: Option<u64>,
    superseded: u64,
}

#[derive(Debug)]
struct Drawing {
    request: FrameRequest,
    began: Instant,
}

/// A frame that waits for an acknowledgement of the previous one.
#[derive(Debug)]
struct Ready<F> {
    frame: F,
    request: FrameRequest,
    draw_time: Duration,
    since: Instant,
}

/// A frame that the client has not acknowledged.
#[derive(Debug)]
struct Sent {
    request: FrameRequest,
    draw_time: Duration,
    since: Instant,
}

impl<F> FrameScheduler<F> {
    /// `full`: the full width; narrower previews are followed by a full frame when the pointer rests.
    pub const fn new(previews: PreviewController, full: u32) -> Self {
        Self {
            previews,
            full,
            waiting: None,
            not_before: None,
            drawing: None,
            ready: None,
            sent: None,
            preview: None,
            last_pose: None,
            newest_sent: None,
            superseded: 0,
        }
    }

    /// The session's images have another size from now on.
    pub fn resize(&mut self, previews: PreviewController, full: u32) {
        self.previews = previews;
        self.full = full;
        self.preview = None;
    }

    /// Number of poses and frames that newer ones replaced before they were sent, since the last call.
    pub fn take_superseded(&mut self) -> u64 {
        std::mem::take(&mut self.superseded)
    }

    /// When the frame was sent that the client has not acknowledged.
    pub fn owed_since(&self) -> Option<Instant> {
        self.sent.as_ref().map(|sent| sent.since)
    }

    /// A pose arrived.
    pub fn pose(&mut self, pose: Pose) {
        self.last_pose = Some(pose.at);
        if self.waiting.replace(pose).is_some() {
            self.superseded += 1;
        }
    }

    /// The client acknowledged a frame.
    /// Errors: No frame with this or a higher number was sent.
    pub fn ack(&mut self, seq: u64, now: Instant) -> Result<(), NotSent> {
        if self.newest_sent.is_none_or(|newest| seq > newest) {
            return Err(NotSent);
        }
        if let Some(sent) = self.sent.take_if(|sent| sent.request.pose.seq == seq) {
            if let Some(width) = sent.request.width {
                self.previews.acknowledged(now, width, sent.draw_time, now.saturating_duration_since(sent.since));
                if width < self.full && self.ready.is_none() {
                    self.preview = Some(sent.request.pose);
                }
            }
            if self.waiting.is_some() && self.ready.as_ref().is_some_and(|ready| self.is_outdated(ready, now)) {
                self.ready = None;
                self.superseded += 1;
            }
        }
        Ok(())
    }

    fn is_outdated(&self, ready: &Ready<F>, now: Instant) -> bool {
        now.saturating_duration_since(ready.since) > OUTDATED * self.previews.draw_time().max(ready.draw_time)
    }

    /// The frame in progress is ready.
    pub fn drawn(&mut self, frame: F, now: Instant) {
        if let Some(Drawing { request, began }) = self.drawing.take() {
            self.preview = None;
            self.ready = Some(Ready { frame, request, draw_time: now.saturating_duration_since(began), since: now });
        }
    }

    /// The frame in progress failed.
    pub fn failed(&mut self) -> Option<FrameRequest> {
        self.drawing.take().map(|drawing| drawing.request)
    }

    /// The service rejected the frame in progress: its pose waits again, unless there is a newer one.
    pub fn rejected(&mut self, now: Instant) {
        if let Some(Drawing { request, .. }) = self.drawing.take() {
            self.not_before = Some(now + REJECTED_POSE_RETRY);
            if request.is_full_quality {
                self.preview = Some(request.pose);
            } else if self.waiting.is_none() {
                self.waiting = Some(request.pose);
            } else {
                self.superseded += 1;
            }
        }
    }

    /// The next step.
    pub fn next(&mut self, now: Instant) -> Step<F> {
        if self.waiting.is_some() {
            // The waiting pose may fail; then a full frame still has to follow the preview.
            if let Some(drawing) = self.drawing.take_if(|drawing| drawing.request.is_full_quality) {
                self.preview = Some(drawing.request.pose);
                return Step::Cancel;
            }
            if let Some(ready) = self.ready.take_if(|ready| ready.request.is_full_quality) {
                self.preview = Some(ready.request.pose);
            }
        }
        if self.sent.is_none()
            && let Some(Ready { frame, request, draw_time, .. }) = self.ready.take()
        {
            self.newest_sent = self.newest_sent.max(Some(request.pose.seq));
            self.sent = Some(Sent { request, draw_time, since: now });
            return Step::Send(frame);
        }
        if self.drawing.is_some() || self.ready.is_some() {
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
        let width = (!is_full_quality).then(|| self.previews.width());
        let request = FrameRequest { pose, width, is_full_quality };
        self.drawing = Some(Drawing { request: request.clone(), began: now });
        Step::Draw(request)
    }

    /// When to start the frame of the waiting pose.
    fn begin(&self, now: Instant) -> Instant {
        self.sent.as_ref().map_or(now, |sent| {
            let lead = self.previews.draw_time().mul_f64(EARLY);
            sent.since + self.previews.ack_time().saturating_sub(lead)
        })
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const MS: Duration = Duration::from_millis(1);

    /// A simulated pointer, server and client, millisecond by millisecond.
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
                self.desk.drawn(seq, now);
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
                    Step::Draw(order) => {
                        assert!(self.being_made.is_none(), "one frame is made at a time");
                        self.is_full_quality = order.is_full_quality;
                        self.being_made = Some((order.pose.seq, self.now + self.make));
                    }
                    Step::Cancel => {
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

        /// Poses at 125 Hz, with the times at which they are sent.
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
            assert!(matches!(desk.next(start), Step::Draw(_)));
            desk.drawn((), start);
            assert!(matches!(desk.next(start), Step::Send(())));
            if !acknowledged_while_making {
                desk.ack(1, start).unwrap();
            }
            desk.pose(pose(2));
            assert!(matches!(desk.next(start + MS), Step::Draw(FrameRequest { is_full_quality: false, .. })));
            if acknowledged_while_making {
                desk.ack(1, start + MS).unwrap();
            }
            assert!(desk.failed().is_some());
            assert!(matches!(desk.next(start + MS), Step::Wait(Some(until)) if until == start + REST));
            assert!(matches!(desk.next(start + REST), Step::Draw(FrameRequest { pose: Pose { seq: 1, .. }, is_full_quality: true, .. })));
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
        assert!(matches!(desk.next(now), Step::Draw(FrameRequest { pose: Pose { seq: 1, .. }, .. })));
        desk.rejected(now);
        assert!(matches!(desk.next(now), Step::Wait(Some(until)) if until == now + REJECTED_POSE_RETRY));
        assert!(matches!(desk.next(now + REJECTED_POSE_RETRY), Step::Draw(FrameRequest { pose: Pose { seq: 1, .. }, .. })));
        desk.pose(pose(2));
        desk.rejected(now);
        assert!(matches!(desk.next(now + REJECTED_POSE_RETRY), Step::Draw(FrameRequest { pose: Pose { seq: 2, .. }, .. })));
        assert_eq!(desk.take_superseded(), 1);
    }
}
