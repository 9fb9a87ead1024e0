//! The pose of each frame of a batch. All are checked before the first is drawn.

use std::sync::Arc;

use mlswarp::deform::Handle;
use mlswarp::warp::{RestSpec, Setup, WarpError};

use crate::problem::{Code, Problem};
use crate::store::Record;
use crate::wire::{BatchPoses, FrameJitter, FramePosition, Pose, in_frame};

/// A frame's pose.
#[derive(Debug)]
pub(crate) struct FramePose {
    /// Posed handles.
    pub(crate) q: Vec<Handle>,
    pub(crate) position: FramePosition,
}

/// What the poses refer to.
#[derive(Debug)]
pub(crate) struct Rest {
    pub(crate) record: Arc<Record>,
    /// The handles of a jitter in a session that has none.
    pub(crate) grid: Option<RestSpec>,
    pub(crate) setup: Arc<Setup>,
}

impl Rest {
    /// The handles at rest.
    pub(crate) fn spec(&self) -> &RestSpec {
        self.grid.as_ref().unwrap_or(&self.record.rest)
    }

    /// The pose that a frame begins with.
    fn given(&self, poses: &BatchPoses, frame: u32) -> Result<Pose, Problem> {
        let mut given = poses.given(frame)?;
        let p = &self.spec().p;
        let is_at_rest = p.is_empty() || matches!(poses, BatchPoses::Jitter { .. });
        // The empty `q` of a session without handles.
        given.q = given.q.filter(|q| self.grid.is_none() || !q.is_empty());
        if given.q.is_none() && self.record.pose.is_none() {
            given.q = is_at_rest.then(|| p.clone());
        }
        given.onto(self.record.pose.as_ref()).map_err(|problem| match poses {
            BatchPoses::Frames(_) => in_frame(frame, problem),
            BatchPoses::Steps { .. } | BatchPoses::Jitter { .. } => problem,
        })
    }

    /// The pose of a frame.
    pub(crate) fn pose_of(&self, poses: &BatchPoses, frame: u32) -> Result<FramePose, Problem> {
        let Pose { q, strength } = self.given(poses, frame)?;
        let posed = |strength| self.spec().posed(q, strength, self.record.extent).0;
        let plain = FramePosition { strength, t: None, jitter: None };
        Ok(match *poses {
            BatchPoses::Frames(_) => FramePose { q: posed(strength), position: plain },
            BatchPoses::Steps { steps, easing, .. } => {
                let t = easing.at(frame, steps);
                FramePose { q: posed(strength * t), position: FramePosition { strength: strength * t, t: Some(t), jitter: None } }
            }
            BatchPoses::Jitter { jitter, .. } => {
                let position = FramePosition { jitter: Some(FrameJitter { seed: jitter.seed, frame }), ..plain };
                FramePose { q: jitter.displace(&self.setup, &self.spec().p, &posed(strength), frame), position }
            }
        })
    }

    /// Checks the poses of all frames. In-betweens and jittered poses lie between a few extreme ones: only these are checked.
    /// Errors: The first invalid pose.
    pub(crate) fn check(&self, poses: &BatchPoses, is_cancelled: &dyn Fn() -> bool) -> Result<(), Problem> {
        match poses {
            BatchPoses::Frames(_) => {
                for frame in (0..poses.count()).take_while(|_| !is_cancelled()) {
                    self.setup.pose(&self.pose_of(poses, frame)?.q).map_err(|error| in_frame(frame, error.into()))?;
                }
            }
            BatchPoses::Steps { .. } | BatchPoses::Jitter { .. } => {
                let Pose { q, strength } = self.given(poses, 0)?;
                let (q, _) = self.spec().posed(q, strength, self.record.extent);
                self.setup.pose(&q)?;
                if let BatchPoses::Jitter { jitter, .. } = poses {
                    for q in jitter.extremes(&self.setup, &q) {
                        let too_far = |error: WarpError| {
                            Problem::new(Code::BadValue, format!("displaced by 16 sigma: {error}")).pointer("/jitter/sigma")
                        };
                        self.setup.pose(&q).map_err(too_far)?;
                    }
                }
            }
        }
        Ok(())
    }
}
