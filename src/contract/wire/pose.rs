//! The pose of a session: its own, which it was created with, and what a request says of it.

use mlswarp::deform::Handle;

use super::handles::posed_handles;
use super::json::{Node, optional};
use super::missing_q;
use super::rest::strength;
use crate::problem::Problem;

/// Posed handles as a client has sent them: neither aligned nor moved by the strength.
#[derive(Clone, Debug, PartialEq)]
pub struct Pose {
    /// Posed handles, in the order and shape of those at rest.
    pub q: Vec<Handle>,
    /// How much of the way from p to q the handles are moved.
    pub strength: f64,
}

/// What a request about a session gives of a pose; the rest is that of the session.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct PosePatch {
    /// Posed handles.
    pub q: Option<Vec<Handle>>,
    /// How much of the way from p to q the handles are moved.
    pub strength: Option<f64>,
}

impl PosePatch {
    /// `most`: the number of handles, of which one more is refused before the rest is read.
    pub(crate) fn read(
        [q, strength_]: [Option<Node<'_, '_>>; 2],
        most: usize,
    ) -> Result<Self, Problem> {
        Ok(Self {
            q: optional(q, |q| posed_handles(q, most))?,
            strength: optional(strength_, strength)?,
        })
    }

    /// The pose that is meant. A strength belongs to its `q`: that of the session does not apply to
    /// another one. Errors: `bad_value` at `/q` if neither the request nor the session has one.
    pub fn onto(self, session: Option<&Pose>) -> Result<Pose, Problem> {
        match (self.q, session) {
            (Some(q), _) => Ok(Pose {
                q,
                strength: self.strength.unwrap_or(1.0),
            }),
            (None, Some(pose)) => Ok(Pose {
                q: pose.q.clone(),
                strength: self.strength.unwrap_or(pose.strength),
            }),
            (None, None) => Err(missing_q()),
        }
    }
}
