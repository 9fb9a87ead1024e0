//! Draws the rows of a subject: one kind for each subject. Every division into bands gives the same bytes.

use std::ops::Range;
use std::sync::Arc;

use super::{Image, Posed};
use crate::codec::{PngShape, Profile};
use crate::pixmap::{Channels, Depth, Extent};
use crate::render::{RenderOptions, Renderer};

/// Draws one subject.
#[derive(Debug)]
pub(super) enum Drawer {
    /// A picture.
    Image {
        renderer: Renderer,
        /// Whether the file needs one sample for the three colours.
        grey: bool,
        icc: Option<Profile>,
    },
}

impl Drawer {
    pub(super) fn image(image: &Image, posed: &Posed, options: RenderOptions) -> Self {
        let renderer = Renderer::new(Arc::clone(&image.source), posed.mesh(), options);
        Self::Image { renderer, grey: image.grey && options.outside.is_grey(), icc: image.icc.clone() }
    }

    /// Size of the target.
    pub(super) const fn target(&self) -> Extent {
        match self {
            Self::Image { renderer, .. } => renderer.target(),
        }
    }

    pub(super) const fn channels(&self) -> Channels {
        match self {
            Self::Image { renderer, .. } => renderer.channels(),
        }
    }

    pub(super) fn depth(&self) -> Depth {
        match self {
            Self::Image { renderer, .. } => renderer.depth(),
        }
    }

    /// The file that holds what is drawn.
    pub(super) fn shape(&self) -> PngShape {
        let Self::Image { grey, .. } = self;
        PngShape { extent: self.target(), channels: self.channels(), grey: *grey, depth: self.depth() }
    }

    /// The colour profile of the file.
    pub(super) const fn icc(&self) -> Option<&Profile> {
        let Self::Image { icc, .. } = self;
        icc.as_ref()
    }

    /// Upper bound of the pixels whose source positions are computed to draw a row.
    pub(super) fn computed_width(&self) -> u32 {
        match self {
            Self::Image { renderer, .. } => renderer.computed_width(),
        }
    }

    /// Draws the target rows `rows`. Shapes: `out: [rows][width][channels]`, samples in PNG order (16-bit big-endian).
    pub(super) fn band(&self, rows: Range<u32>, out: &mut [u8]) {
        match self {
            Self::Image { renderer, .. } => renderer.band(rows, out),
        }
    }
}
