//! A warp object settled on an image, for those who draw it without a server.

use mlswarp::deform::IsCancelled;
use mlswarp::pixmap::Extent;
use mlswarp::warp::{Limits, ResolvedRest, choose};

use super::WarpObject;
use super::landmarks::Landmarks;
use crate::problem::Problem;

impl WarpObject {
    /// Settles the object on an image of this size as the service does: places the handles of
    /// landmark files, applies the strength, and chooses the method on at most `most_fit_handles`
    /// handles. `posed` then has the handles of the pose.
    /// Errors: Wrong handles or parameters; more than a limit; cancelled.
    pub fn resolve(
        &mut self,
        landmarks: Option<Landmarks>,
        extent: Extent,
        limits: &Limits,
        most_fit_handles: u64,
        cancelled: IsCancelled<'_>,
    ) -> Result<ResolvedRest, Problem> {
        if let Some(landmarks) = landmarks {
            landmarks.place_in(self, extent)?;
        }
        self.settle_pose(extent)?;
        if self.is_auto {
            self.require_choice()?;
            let (rest, q) = (&self.rest, self.posed()?);
            let chosen = choose(rest, q, extent, most_fit_handles, cancelled)?;
            self.choose(chosen);
        }
        Ok(ResolvedRest::new(&self.rest, extent, limits, cancelled)?)
    }
}
