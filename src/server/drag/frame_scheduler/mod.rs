//! The order of a drag's frames: which pose is drawn next, when, how wide, and when a frame is
//! sent. Times are arguments and frames are of any type.
//!
//! - Of the waiting poses, only the newest is kept.
//! - At most `window` frames are unacknowledged. At most one more is in progress or ready.
//! - An acknowledgement of a frame acknowledges all earlier ones too: a client may show, and
//!   acknowledge, only the newest of several.
//! - If the window is full, the next frame is started so that it is ready when the acknowledgement
//!   is expected: earlier, its pose would be old; later, the connection would be idle. If the
//!   client takes longer than expected and a newer pose waits, the ready frame is dropped when the
//!   acknowledgement comes, and the newer pose is drawn instead.
//! - If the window is not full, frames are sent at equal distances of the time that a frame takes:
//!   sent at once, they would form a queue.
//! - While a full-quality frame is unacknowledged, no more than one frame is: it may be large.
//! - A frame is always completed, except the full-quality frame of a resting pointer, which is
//!   cancelled when the pointer moves.

use std::collections::VecDeque;
use std::sync::Arc;
use std::time::{Duration, Instant};

use super::link_estimate::{LinkEstimate, SendMark};
use super::picture_ladder::{Encoding, PictureLadder};
use super::preview_controller::PreviewController;
use super::send_window::{SendWindow, Window};
use crate::wire::UnreadHandles;

/// Without a pose for this time, the pointer rests.
pub const POINTER_REST_TIME: Duration = Duration::from_millis(150);
/// A frame starts this many average drawing times before it is needed.
const EARLY_DRAW_TIMES: f64 = 1.25;
/// A ready frame is outdated after this many drawing times.
const OUTDATED_DRAW_TIMES: u32 = 2;
/// A rejected pose is retried after this time.
const REJECTED_POSE_RETRY: Duration = Duration::from_millis(10);

/// The positions of the handles at a time.
#[derive(Clone, Debug)]
pub struct QueuedPose {
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
    pub pose: QueuedPose,
    /// The width, px; `None`: the session's width.
    pub width: Option<u32>,
    /// The encoding, if the scheduler chooses it.
    pub encoding: Option<Encoding>,
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
    /// Chooses width and encoding, if they are chosen; then `previews` only has averages, of the
    /// full width.
    pictures: Option<PictureLadder>,
    /// The full width.
    full: u32,
    waiting: Option<QueuedPose>,
    not_before: Option<Instant>,
    drawing: Option<CurrentDrawing>,
    ready: Option<ReadyFrame<F>>,
    /// The frames that the client has not acknowledged, oldest first.
    sent: VecDeque<Sent>,
    /// Number of frames sent.
    count: u64,
    link: LinkEstimate,
    window: SendWindow,
    /// The last frame was sent then, and has this number of bytes.
    last_sent: Option<(Instant, u64)>,
    /// The pose of the last acknowledged frame, if that is a preview.
    preview: Option<QueuedPose>,
    last_pose: Option<Instant>,
    newest_sent: Option<u64>,
    superseded: u64,
}

#[derive(Debug)]
struct CurrentDrawing {
    request: FrameRequest,
    began: Instant,
}

/// A frame that waits for an acknowledgement of the previous one.
#[derive(Debug)]
struct ReadyFrame<F> {
    frame: F,
    bytes: u64,
    request: FrameRequest,
    draw_time: Duration,
    since: Instant,
}

/// A frame that the client has not acknowledged.
#[derive(Debug)]
struct Sent {
    request: FrameRequest,
    draw_time: Duration,
    mark: SendMark,
    bytes: u64,
    /// Its number in the order of sending.
    number: u64,
    /// The number of unacknowledged frames when it was sent, itself included.
    unacknowledged: u32,
}

impl<F> FrameScheduler<F> {
    /// `full`: the full width; narrower previews are followed by a full frame when the pointer
    /// rests. `pictures`: chooses the encoding; then the width of `previews` is fixed.
    pub fn new(
        previews: PreviewController,
        pictures: Option<PictureLadder>,
        full: u32,
        window: Window,
    ) -> Self {
        Self {
            previews,
            pictures,
            full,
            waiting: None,
            not_before: None,
            drawing: None,
            ready: None,
            sent: VecDeque::new(),
            count: 0,
            link: LinkEstimate::default(),
            window: SendWindow::new(window),
            last_sent: None,
            preview: None,
            last_pose: None,
            newest_sent: None,
            superseded: 0,
        }
    }

    /// The session's images have another size from now on.
    pub fn resize(
        &mut self,
        previews: PreviewController,
        pictures: Option<PictureLadder>,
        full: u32,
    ) {
        self.previews = previews;
        self.pictures = pictures;
        self.full = full;
        self.preview = None;
    }

    /// Number of poses and frames that newer ones replaced before they were sent, since the last
    /// call.
    pub fn take_superseded(&mut self) -> u64 {
        std::mem::take(&mut self.superseded)
    }

    /// When the oldest frame was sent that the client has not acknowledged.
    pub fn owed_since(&self) -> Option<Instant> {
        self.sent.front().map(|sent| sent.mark.at())
    }

    /// A pose arrived.
    pub fn pose(&mut self, pose: QueuedPose) {
        self.last_pose = Some(pose.at);
        // Only the newest pose is drawn: an older one would show where the pointer no longer is.
        if self.waiting.replace(pose).is_some() {
            self.superseded += 1;
        }
    }

    /// The client acknowledged a frame, and all earlier ones.
    /// Errors: No frame with this or a higher number was sent.
    pub fn ack(&mut self, seq: u64, now: Instant) -> Result<(), NotSent> {
        // An acknowledgement of what was never sent would let a client open its window at will.
        if self.newest_sent.is_none_or(|newest| seq > newest) {
            return Err(NotSent);
        }
        let (mut newest, mut bytes) = (None, 0);
        while self
            .sent
            // Acknowledgements are cumulative: a lost one costs nothing, since the next includes
            // it.
            .front()
            .is_some_and(|sent| sent.request.pose.seq <= seq)
        {
            newest = self.sent.pop_front();
            bytes += newest.as_ref().map_or(0, |sent| sent.bytes);
        }
        if let Some(sent) = newest {
            self.acknowledged(sent, bytes, now);
        }
        Ok(())
    }

    /// `sent`: the newest acknowledged frame; `bytes`: those of all acknowledged frames.
    fn acknowledged(&mut self, sent: Sent, bytes: u64, now: Instant) {
        // The order matters: the link is measured first, then the window decides, and pictures
        // follow its advice.
        let measured = self.link.acknowledged(now, sent.mark, bytes);
        let possible = self
            .pictures
            .as_ref()
            .map(|pictures| pictures.possible_steps(self.link.possible_rate()))
            .unwrap_or_default();
        let advice = self.window.acknowledged(
            now,
            sent.number,
            self.count,
            sent.unacknowledged == 1,
            measured,
            possible,
        );
        if let Some(pictures) = &mut self.pictures {
            pictures.follow(advice);
        }
        if let Some(width) = sent.request.width {
            let ack_time = now.saturating_duration_since(sent.mark.at());
            // With chosen encodings the size is the ladder's matter, and the controller only
            // averages times.
            let averaged = if self.pictures.is_some() {
                self.previews.width()
            } else {
                width
            };
            self.previews.acknowledged(
                now,
                averaged,
                sent.draw_time,
                ack_time,
                sent.unacknowledged,
            );
            let is_full =
                // A narrow or lossy frame is owed a full one when the pointer rests; which pose it
                // shows is kept for that.
                width >= self.full && !matches!(sent.request.encoding, Some(Encoding::Jpeg(_)));
            if !is_full && self.ready.is_none() {
                self.preview = Some(sent.request.pose);
            }
        }
        if self.waiting.is_some()
            && self
                .ready
                .as_ref()
                .is_some_and(|ready| self.is_outdated(ready, now))
        {
            self.ready = None;
            self.superseded += 1;
        }
    }

    fn is_outdated(&self, ready: &ReadyFrame<F>, now: Instant) -> bool {
        now.saturating_duration_since(ready.since)
            > OUTDATED_DRAW_TIMES * self.previews.draw_time().max(ready.draw_time)
    }

    /// The frame in progress is ready.
    pub fn drawn(&mut self, frame: F, bytes: u64, now: Instant) {
        if let Some(CurrentDrawing { request, began }) = self.drawing.take() {
            self.preview = None;
            let draw_time = now.saturating_duration_since(began);
            if let (Some(pictures), Some(encoding)) = (&mut self.pictures, request.encoding) {
                pictures.drawn(request.width, encoding, bytes, draw_time);
            }
            self.ready = Some(ReadyFrame {
                frame,
                bytes,
                request,
                draw_time,
                since: now,
            });
        }
    }

    /// The frame in progress failed.
    pub fn failed(&mut self) -> Option<FrameRequest> {
        self.drawing.take().map(|drawing| drawing.request)
    }

    /// The service rejected the frame in progress: its pose waits again, unless there is a newer
    /// one.
    pub fn rejected(&mut self, now: Instant) {
        if let Some(CurrentDrawing { request, .. }) = self.drawing.take() {
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
            if let Some(drawing) = self
                .drawing
                .take_if(|drawing| drawing.request.is_full_quality)
            {
                self.preview = Some(drawing.request.pose);
                return Step::Cancel;
            }
            if let Some(ready) = self.ready.take_if(|ready| ready.request.is_full_quality) {
                self.preview = Some(ready.request.pose);
            }
        }
        if self.sent.len() < self.frames()
            && let Some(ready) = self.ready.take()
        {
            return Step::Send(self.send(ready, now));
        }
        if self.drawing.is_some() || self.ready.is_some() {
            return Step::Wait(None);
        }
        let (begin, is_full_quality) = match (&self.waiting, &self.preview) {
            (Some(_), _) => (self.begin(now), false),
            (None, Some(_)) if self.sent.is_empty() => (
                self.last_pose.map_or(now, |last| last + POINTER_REST_TIME),
                true,
            ),
            _ => return Step::Wait(None),
        };
        let begin = self
            .not_before
            .map_or(begin, |not_before| begin.max(not_before));
        if begin > now {
            return Step::Wait(Some(begin));
        }
        self.not_before = None;
        let pose = if is_full_quality {
            self.preview.take()
        } else {
            self.waiting.take()
        };
        let Some(pose) = pose else {
            return Step::Wait(None);
        };
        let (width, encoding) = match (&self.pictures, is_full_quality) {
            (None, _) => ((!is_full_quality).then(|| self.previews.width()), None),
            (Some(pictures), true) => (None, Some(pictures.at_rest(self.link.rate()))),
            (Some(pictures), false) => {
                let (width, encoding) = pictures.next(self.link.rate(), self.link.possible_rate());
                (Some(width), Some(encoding))
            }
        };
        let request = FrameRequest {
            pose,
            width,
            encoding,
            is_full_quality,
        };
        self.drawing = Some(CurrentDrawing {
            request: request.clone(),
            began: now,
        });
        Step::Draw(request)
    }

    fn send(&mut self, ready: ReadyFrame<F>, now: Instant) -> F {
        let ReadyFrame {
            frame,
            bytes,
            request,
            draw_time,
            ..
        } = ready;
        let mark = self.link.sent(now, bytes, self.sent.is_empty());
        let unacknowledged = u32::try_from(self.sent.len())
            .unwrap_or(u32::MAX)
            .saturating_add(1);
        self.newest_sent = self.newest_sent.max(Some(request.pose.seq));
        self.last_sent = Some((now, bytes));
        self.sent.push_back(Sent {
            request,
            draw_time,
            mark,
            bytes,
            number: self.count,
            unacknowledged,
        });
        self.count += 1;
        frame
    }

    /// The number of frames that may be unacknowledged: one while that is a full frame, which may
    /// be large.
    fn frames(&self) -> usize {
        if self
            .sent
            .back()
            .is_some_and(|sent| sent.request.is_full_quality)
        {
            1
        } else {
            self.window.frames()
        }
    }

    /// When to start the frame of the waiting pose.
    fn begin(&mut self, now: Instant) -> Instant {
        let Some(oldest) = self.sent.front().map(|sent| sent.mark.at()) else {
            return now;
        };
        let window = self.frames();
        let lead = self.previews.draw_time().mul_f64(EARLY_DRAW_TIMES);
        let mut begin = now;
        if self.sent.len() >= window {
            self.window.is_full();
            begin = oldest + self.previews.ack_time().saturating_sub(lead);
        }
        if window > 1
            && let Some((at, bytes)) = self.last_sent
            && let Some(time) = self.link.frame_time(bytes)
        {
            begin =
                begin.max(at + Duration::from_secs_f64(time / window as f64).saturating_sub(lead));
        }
        begin
    }
}

#[cfg(test)]
mod tests;
