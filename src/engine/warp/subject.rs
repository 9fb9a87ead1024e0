//! What a warp draws.

use super::drawer::Drawer;
use super::{Digest, Image, OutputSpec, Posed, Target, Warning};
use crate::pixmap::Extent;
use crate::render::RenderOptions;

/// What a warp draws.
#[derive(Clone, Copy, Debug)]
pub enum Subject<'a> {
    /// A picture.
    Image(&'a Image),
}

impl Subject<'_> {
    /// Upright size of the source, px.
    #[must_use]
    pub fn extent(self) -> Extent {
        match self {
            Self::Image(image) => image.extent(),
        }
    }

    /// The warning for every output of this subject.
    #[must_use]
    pub fn warning(self) -> Option<Warning> {
        match self {
            Self::Image(image) => image.warning(),
        }
    }

    /// Digest of the subject, part of an ETag; different kinds of subjects have different digests.
    pub(super) const fn digest(self) -> Digest {
        match self {
            Self::Image(image) => image.digest(),
        }
    }

    pub(super) fn drawer(self, target: Target, posed: &Posed, output: &OutputSpec) -> Drawer {
        let options = RenderOptions { target: target.extent, canvas: target.canvas, filter: output.filter, outside: output.outside };
        match self {
            Self::Image(image) => Drawer::image(image, posed, options),
        }
    }
}
