//! The pose of each frame of a batch. All are checked before the first is drawn.

use std::sync::Arc;

use mlswarp::deform::Handle;
use mlswarp::warp::{RestSpec, WarpError};

use crate::app::parts::plans::HeldSetup;
use crate::app::reading::Held;
use crate::limits::memory::Reservation;
use crate::problem::{Code, Problem};
use crate::store::Record;
use crate::wire::{BatchPoses, FrameJitter, FramePosition, Pose, handles_bytes, in_frame};

/// A frame's pose.
#[derive(Debug)]
pub(crate) struct FramePose {
    /// Posed handles.
    pub(crate) q: Held<Vec<Handle>>,
    pub(crate) position: FramePosition,
}

/// Takes memory for posed handles.
pub(crate) type ReserveMemory<'a> = &'a dyn Fn(u64) -> Result<Reservation, Problem>;

/// What the poses refer to.
#[derive(Debug)]
pub(crate) struct Rest {
    pub(crate) record: Arc<Record>,
    /// The handles of a jitter in a session that has none.
    pub(crate) grid: Option<RestSpec>,
    pub(crate) setup: HeldSetup,
}

impl Rest {
    /// The handles at rest.
    pub(crate) fn spec(&self) -> &RestSpec {
        self.grid.as_ref().unwrap_or(&self.record.rest)
    }

    /// The pose that a frame begins with.
    fn read_frames(
        &self,
        poses: &BatchPoses,
        frame: u32,
        reserve: ReserveMemory<'_>,
    ) -> Result<Held<Pose>, Problem> {
        let (p, session) = (&self.spec().p, self.record.pose.as_deref());
        // Where handles are not given, those of the session or those at rest take their place, and
        // a jitter makes a copy.
        let others = handles_bytes(p).max(session.map_or(0, |pose| handles_bytes(&pose.q)));
        let given = poses.requested_frames(frame, |bytes| reserve(2 * bytes.max(others)))?;
        let is_at_rest = p.is_empty() || matches!(poses, BatchPoses::Jitter { .. });
        let given = given.try_map(|mut given| {
            // In a session without handles, a `q` without handles says nothing of the jittered
            // grid.
            given.q = given.q.filter(|q| self.grid.is_none() || !q.is_empty());
            if given.q.is_none() && session.is_none() {
                given.q = is_at_rest.then(|| p.clone());
            }
            given.onto(session)
        });
        given.map_err(|problem| match poses {
            BatchPoses::Frames(_) => in_frame(frame, problem),
            BatchPoses::Steps { .. } | BatchPoses::Jitter { .. } => problem,
        })
    }

    /// The pose of a frame.
    pub(crate) fn pose_of(
        &self,
        poses: &BatchPoses,
        frame: u32,
        reserve: ReserveMemory<'_>,
    ) -> Result<FramePose, Problem> {
        let given = self.read_frames(poses, frame, reserve)?;
        let strength = given.strength;
        let posed =
            |strength| given.map(|pose| self.spec().posed(pose.q, strength, self.record.extent).0);
        let plain = FramePosition {
            strength,
            t: None,
            jitter: None,
        };
        Ok(match *poses {
            BatchPoses::Frames(_) => FramePose {
                q: posed(strength),
                position: plain,
            },
            BatchPoses::Steps { steps, easing, .. } => {
                let t = easing.at(frame, steps);
                FramePose {
                    q: posed(strength * t),
                    position: FramePosition {
                        strength: strength * t,
                        t: Some(t),
                        jitter: None,
                    },
                }
            }
            BatchPoses::Jitter { jitter, .. } => {
                let position = FramePosition {
                    jitter: Some(FrameJitter {
                        seed: jitter.seed,
                        frame,
                    }),
                    ..plain
                };
                FramePose {
                    q: posed(strength)
                        .map(|q| jitter.displace(&self.setup, &self.spec().p, &q, frame)),
                    position,
                }
            }
        })
    }

    /// Checks the poses of all frames. In-betweens and jittered poses lie between a few extreme
    /// ones: only these are checked. Errors: The first invalid pose.
    pub(crate) fn check(
        &self,
        poses: &BatchPoses,
        reserve: ReserveMemory<'_>,
        is_cancelled: &dyn Fn() -> bool,
    ) -> Result<(), Problem> {
        match poses {
            BatchPoses::Frames(_) => {
                for frame in (0..poses.count()).take_while(|_| !is_cancelled()) {
                    self.setup
                        .pose(&self.pose_of(poses, frame, reserve)?.q)
                        .map_err(|error| in_frame(frame, error.into()))?;
                }
            }
            BatchPoses::Steps { .. } | BatchPoses::Jitter { .. } => {
                let given = self.read_frames(poses, 0, reserve)?;
                let q = given.map(|Pose { q, strength }| {
                    self.spec().posed(q, strength, self.record.extent).0
                });
                self.setup.pose(&q)?;
                if let BatchPoses::Jitter { jitter, .. } = poses {
                    for q in jitter.extremes(&self.setup, &q) {
                        let too_far = |error: WarpError| {
                            Problem::new(Code::BadValue, format!("displaced by 16 sigma: {error}"))
                                .pointer("/jitter/sigma")
                        };
                        self.setup.pose(&q).map_err(too_far)?;
                    }
                }
            }
        }
        Ok(())
    }
}
