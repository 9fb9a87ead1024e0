//! The pixels of an image that its handles can act through, as a part of the rest specification.

use std::sync::Arc;

use super::Digest;
use crate::topology::Mask;

/// A mask of the size of the image, and what it is known by in keys and digests. Two are equal if
/// their digests are.
#[derive(Clone, Debug)]
pub struct RestMask {
    /// The mask.
    pub mask: Arc<Mask>,
    /// Of everything that it was made from.
    pub digest: Digest,
}

impl PartialEq for RestMask {
    fn eq(&self, other: &Self) -> bool {
        self.digest == other.digest
    }
}
