//! The pixels of an image that its handles can act through: a metric that follows the shape of what
//! the image shows stays inside of them.

use std::sync::Arc;

use super::Digest;
use crate::pixmap::Extent;

/// A mask of the size of the image. Two are equal if their digests are.
#[derive(Clone, Debug)]
pub struct Mask {
    extent: Extent,
    /// One byte a pixel, row by row; 0 is outside.
    inside: Arc<[u8]>,
    digest: Digest,
}

impl Mask {
    /// `inside`: one byte a pixel, row by row; 0 is outside. `None` of another number of pixels.
    #[must_use]
    pub fn new(extent: Extent, inside: Vec<u8>) -> Option<Self> {
        let pixels = u64::from(extent.width()) * u64::from(extent.height());
        (inside.len() as u64 == pixels).then(|| Self {
            extent,
            digest: Digest::of(&inside),
            inside: inside.into(),
        })
    }

    /// Its size.
    #[must_use]
    pub const fn extent(&self) -> Extent {
        self.extent
    }

    /// The pixels, row by row; 0 is outside.
    #[must_use]
    pub fn inside(&self) -> &[u8] {
        &self.inside
    }

    /// What it is known by in keys and digests.
    #[must_use]
    pub const fn digest(&self) -> Digest {
        self.digest
    }
}

impl PartialEq for Mask {
    fn eq(&self, other: &Self) -> bool {
        (self.extent, self.digest) == (other.extent, other.digest)
    }
}
