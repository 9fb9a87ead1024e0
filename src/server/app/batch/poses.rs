//! The pose of each frame of a batch. All are checked before the first is drawn.

use mlswarp::deform::Handle;
use mlswarp::warp::{RestSpec, Setup, WarpError};

use crate::problem::{Code, Problem};
use crate::wire::{BatchPoses, FramePosition, in_frame};

/// A frame's pose.
#[derive(Debug)]
pub(crate) struct FramePose {
    /// Posed handles.
    pub(crate) q: Vec<Handle>,
    pub(crate) position: FramePosition,
}

/// The pose of a frame.
pub(crate) fn pose_of(poses: &BatchPoses, rest: &RestSpec, setup: &Setup, frame: u32) -> Result<FramePose, Problem> {
    let (q, strength) = poses.given(frame)?;
    let posed = |strength| rest.posed_at(strength, q);
    Ok(match *poses {
        BatchPoses::Frames(_) => FramePose { q: posed(strength), position: FramePosition::Strength(strength) },
        BatchPoses::Steps { steps, easing, .. } => {
            let t = easing.at(frame, steps);
            FramePose { q: posed(strength * t), position: FramePosition::T(t) }
        }
        BatchPoses::Jitter { jitter, .. } => {
            let position = FramePosition::Jitter { seed: jitter.seed, frame };
            FramePose { q: jitter.displace(setup, &rest.p, &posed(strength), frame), position }
        }
    })
}

/// Checks the poses of all frames. In-betweens and jittered poses lie between a few extreme ones: only these are checked.
/// Errors: The first invalid pose.
pub(crate) fn check(poses: &BatchPoses, rest: &RestSpec, setup: &Setup, is_cancelled: &dyn Fn() -> bool) -> Result<(), Problem> {
    match poses {
        BatchPoses::Frames(_) => {
            for frame in (0..poses.count()).take_while(|_| !is_cancelled()) {
                setup.pose(&pose_of(poses, rest, setup, frame)?.q).map_err(|error| in_frame(frame, error.into()))?;
            }
        }
        BatchPoses::Steps { .. } | BatchPoses::Jitter { .. } => {
            let (q, strength) = poses.given(0)?;
            let q = rest.posed_at(strength, q);
            setup.pose(&q)?;
            if let BatchPoses::Jitter { jitter, .. } = poses {
                for q in jitter.extremes(setup, &q) {
                    let too_far =
                        |error: WarpError| Problem::new(Code::BadValue, format!("displaced by 16 sigma: {error}")).pointer("/jitter/sigma");
                    setup.pose(&q).map_err(too_far)?;
                }
            }
        }
    }
    Ok(())
}
