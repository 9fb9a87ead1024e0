//! The warnings of handles at rest and of a pose, before a grid is posed.

use super::plausibility::PosedHandles;
use super::{ResolvedRest, Warning};
use crate::deform::{Demand, Pose};
use crate::render::Canvas;

impl ResolvedRest {
    /// The warnings of the rest handles, whatever the pose.
    #[must_use]
    pub fn rest_warnings(&self) -> &[Warning] {
        &self.warnings
    }

    /// The warnings of the rest handles and of a pose, each once, in their order; without those
    /// that only a posed grid shows. `canvas`: the part of the plane that is drawn, where that is
    /// meant to contain the handles.
    #[must_use]
    pub fn warnings(&self, pose: &Pose, canvas: Option<Canvas>) -> Vec<Warning> {
        let mut warnings = self.warnings_anywhere(pose);
        warnings.extend(self.posed_handles(pose).warnings(self.units(), canvas));
        Warning::in_order(warnings)
    }

    /// Those that do not depend on the canvas.
    pub(super) fn warnings_anywhere(&self, pose: &Pose) -> Vec<Warning> {
        let mut warnings: Vec<_> = self
            .field()
            .warnings(pose)
            .into_iter()
            .map(Warning::Deform)
            .collect();
        warnings.extend_from_slice(&self.warnings);
        warnings.extend(self.unmet(pose));
        Warning::in_order(warnings)
    }

    pub(super) fn posed_handles(&self, pose: &Pose) -> PosedHandles {
        PosedHandles::new(self.field().handles(), pose, self.grid())
    }

    /// What the pose asks for and the method cannot do.
    fn unmet(&self, pose: &Pose) -> Option<Warning> {
        let info = self.field().method().info();
        if info.can_mirror && info.can_scale {
            return None;
        }
        match self.field().demand(pose)? {
            Demand::Mirrored { determinant } => {
                (!info.can_mirror).then_some(Warning::MirroredUseAffine { determinant })
            }
            Demand::Scaled { scale } => {
                (!info.can_scale).then_some(Warning::ScaledUseSimilarity { scale })
            }
        }
    }
}
