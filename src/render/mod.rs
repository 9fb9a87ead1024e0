//! STUB: the rasteriser.

use std::{ops::Range, sync::Arc};

use crate::geometry::Mesh;
use crate::pixmap::{Channels, Depth, Extent, Pixmap};

/// How the source is read between its pixel centres.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Hash)]
pub enum Filter {
    /// The pixel that holds the place.
    Nearest,
    /// Linear in x and y between the four nearest centres.
    #[default]
    Bilinear,
}

/// What is painted where the posed picture does not reach.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Hash)]
pub enum Outside {
    /// Transparent black.
    #[default]
    Transparent,
    /// The colour of the nearest place of the posed border.
    Edge,
    /// One colour, straight 8-bit RGBA.
    Colour([u8; 4]),
}

/// A source picture with the copies that the samplers read (premultiplied, reduced), each made once when first asked for.
#[derive(Debug)]
pub struct Source {
    pixmap: Pixmap,
}

impl Source {
    /// Wraps a decoded picture.
    #[must_use]
    pub fn new(pixmap: Pixmap) -> Self {
        Self { pixmap }
    }

    /// The picture as decoded.
    #[must_use]
    pub const fn pixmap(&self) -> &Pixmap {
        &self.pixmap
    }

    /// The most memory that a source of this shape may come to hold, all copies included, bytes.
    #[must_use]
    pub fn bytes(extent: Extent, channels: Channels, depth: Depth) -> u64 {
        extent.pixels() * channels.count() as u64 * depth.bytes() as u64
    }
}

/// How the mesh is drawn.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub struct RenderOptions {
    /// Size of the target picture; the mesh is scaled to it.
    pub target: Extent,
    /// How the source is read.
    pub filter: Filter,
    /// What is painted where the posed picture does not reach.
    pub outside: Outside,
}

/// Draws a mesh of a source picture, in bands of rows; any banding gives the same bytes.
#[derive(Debug)]
pub struct Renderer {
    source: Arc<Source>,
    options: RenderOptions,
}

impl Renderer {
    /// Prepares (bins, coordinate scale, which source level) but draws nothing.
    #[must_use]
    pub fn new(source: Arc<Source>, _mesh: &Mesh, options: RenderOptions) -> Self {
        Self { source, options }
    }

    /// Size of the target.
    #[must_use]
    pub fn target(&self) -> Extent {
        self.options.target
    }

    /// RGBA when the source has alpha or the target needs one somewhere, otherwise RGB.
    #[must_use]
    pub fn channels(&self) -> Channels {
        self.source.pixmap().channels()
    }

    /// The depth of the source.
    #[must_use]
    pub fn depth(&self) -> Depth {
        self.source.pixmap().depth()
    }

    /// Draws the target rows `rows`. Shapes: `out: [rows][width][channels]`, straight samples in PNG order (16-bit big-endian).
    pub fn band(&self, _rows: Range<u32>, _out: &mut [u8]) {
        todo!()
    }
}
