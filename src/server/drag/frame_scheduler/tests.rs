//! Laws of the scheduler, with a client whose acknowledgements take a constant time.

use super::*;

const MS: Duration = Duration::from_millis(1);

/// A simulated pointer, server and client, millisecond by millisecond.
struct World {
    scheduler: FrameScheduler<u64>,
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
        let scheduler = FrameScheduler::new(pace, None, full, Window::Fixed(1));
        let start = Instant::now();
        Self {
            scheduler,
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
        self.scheduler.pose(QueuedPose {
            seq,
            q: Arc::default(),
            at: self.start + self.now * MS,
        });
    }

    fn tick(&mut self) {
        let now = self.start + self.now * MS;
        if let Some((seq, _)) = self.being_made.take_if(|(_, at)| *at <= self.now) {
            self.scheduler.drawn(seq, 1000, now);
            self.made += 1;
        }
        if !self.deaf
            && let Some((seq, _)) = self.under_way.take_if(|(_, at)| *at <= self.now)
        {
            self.scheduler.ack(seq, now).unwrap();
            self.shown.push((seq, self.now, self.is_full_quality));
        }
        loop {
            match self.scheduler.next(now) {
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
        let mut ages: Vec<u64> = self
            .shown
            .iter()
            .skip(8)
            .map(|(seq, at, _)| u64::from(*at) - 8 * seq)
            .collect();
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
        world
            .shown
            .iter()
            .all(|(seq, at, is_full_quality)| u64::from(*at) == 8 * seq + 3 && !is_full_quality),
        "{:?}",
        world.shown
    );
    assert_eq!(world.scheduler.take_superseded(), 0);
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
        assert_eq!(
            world.scheduler.take_superseded() + seqs.len() as u64,
            300,
            "make {make}, ack {ack}"
        );
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
    assert!(
        world.made as usize <= world.shown.len() + 8,
        "{} frames made for {} shown",
        world.made,
        world.shown.len()
    );
}

#[test]
fn a_client_that_is_later_than_expected_gets_a_young_frame() {
    let mut world = World::new(PreviewController::fixed(512), 512, 2, 10);
    world.drag(50);
    world.deaf = true;
    world.rest(500);
    world.pose(1000);
    world.rest(100);
    assert_eq!(
        world.made as usize,
        world.shown.len() + 2,
        "one under way and one ready, however long the client is silent"
    );
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
    let is_full_quality: Vec<_> = world
        .shown
        .iter()
        .filter(|(.., is_full_quality)| *is_full_quality)
        .collect();
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
        world
            .shown
            .iter()
            .map(|(seq, _, is_full_quality)| (*seq, *is_full_quality))
            .collect::<Vec<_>>(),
        [(0, false), (1, false), (1, true)]
    );
}

#[test]
fn a_pose_that_comes_to_nothing_leaves_the_last_frame_to_be_made_full() {
    for acknowledged_while_making in [false, true] {
        let mut scheduler: FrameScheduler<()> =
            FrameScheduler::new(PreviewController::fixed(256), None, 512, Window::Fixed(1));
        let start = Instant::now();
        let pose = |seq| QueuedPose {
            seq,
            q: Arc::default(),
            at: start,
        };
        scheduler.pose(pose(1));
        assert!(matches!(scheduler.next(start), Step::Draw(_)));
        scheduler.drawn((), 1000, start);
        assert!(matches!(scheduler.next(start), Step::Send(())));
        if !acknowledged_while_making {
            scheduler.ack(1, start).unwrap();
        }
        scheduler.pose(pose(2));
        assert!(matches!(
            scheduler.next(start + MS),
            Step::Draw(FrameRequest {
                is_full_quality: false,
                ..
            })
        ));
        if acknowledged_while_making {
            scheduler.ack(1, start + MS).unwrap();
        }
        assert!(scheduler.failed().is_some());
        assert!(matches!(
            scheduler.next(start + MS),
            Step::Wait(Some(until)) if until == start + POINTER_REST_TIME
        ));
        assert!(matches!(
            scheduler.next(start + POINTER_REST_TIME),
            Step::Draw(FrameRequest {
                pose: QueuedPose { seq: 1, .. },
                is_full_quality: true,
                ..
            })
        ));
    }
}

#[test]
fn acknowledgements_are_of_frames_that_were_sent() {
    let mut world = World::new(PreviewController::fixed(512), 512, 2, 3);
    assert_eq!(world.scheduler.ack(0, world.start), Err(NotSent));
    world.pose(5);
    world.rest(10);
    assert_eq!(world.shown.len(), 1);
    let now = world.start + world.now * MS;
    assert_eq!(
        (
            world.scheduler.ack(6, now),
            world.scheduler.ack(5, now),
            world.scheduler.ack(4, now)
        ),
        (Err(NotSent), Ok(()), Ok(()))
    );
}

#[test]
fn a_pose_that_found_no_room_waits_unless_there_is_a_newer_one() {
    let mut scheduler: FrameScheduler<()> =
        FrameScheduler::new(PreviewController::fixed(512), None, 512, Window::Fixed(1));
    let now = Instant::now();
    let pose = |seq| QueuedPose {
        seq,
        q: Arc::default(),
        at: now,
    };
    scheduler.pose(pose(1));
    assert!(matches!(
        scheduler.next(now),
        Step::Draw(FrameRequest {
            pose: QueuedPose { seq: 1, .. },
            ..
        })
    ));
    scheduler.rejected(now);
    assert!(
        matches!(scheduler.next(now), Step::Wait(Some(until)) if until == now + REJECTED_POSE_RETRY)
    );
    assert!(matches!(
        scheduler.next(now + REJECTED_POSE_RETRY),
        Step::Draw(FrameRequest {
            pose: QueuedPose { seq: 1, .. },
            ..
        })
    ));
    scheduler.pose(pose(2));
    scheduler.rejected(now);
    assert!(matches!(
        scheduler.next(now + REJECTED_POSE_RETRY),
        Step::Draw(FrameRequest {
            pose: QueuedPose { seq: 2, .. },
            ..
        })
    ));
    assert_eq!(scheduler.take_superseded(), 1);
}
