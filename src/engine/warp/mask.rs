//! The pixels of an image that its handles can act through, as a part of the rest specification.

use std::sync::Arc;

use super::digest::Collector;
use super::{Digest, Image, Region};
use crate::deform::IsCancelled;
use crate::render::FULL_WEIGHT;
use crate::topology::{Mask, Membership};

/// A mask of the size of the image, and what it is known by in keys and digests. Two are equal if
/// their digests are.
#[derive(Clone, Debug)]
pub struct RestMask {
    /// The mask.
    pub mask: Arc<Mask>,
    /// Of everything that it was made from.
    pub digest: Digest,
}

impl RestMask {
    /// The mask of an image: pixels of more than half of full alpha are inside, the others that are
    /// visible are rim. With a region of its size, alpha counts times its weight. `None` when
    /// cancelled.
    ///
    /// # Panics
    /// If the region has another size.
    #[must_use]
    pub fn of_image(
        image: &Image,
        region: Option<&Region>,
        cancelled: IsCancelled<'_>,
    ) -> Option<Self> {
        let extent = image.extent();
        assert!(
            region.is_none_or(|region| region.extent() == extent),
            "a region has the size of its image"
        );
        let full = u32::from(FULL_WEIGHT);
        let (mut alpha, mut weights) = (Vec::new(), Vec::new());
        let row = |y: u32, row: &mut [Membership]| {
            image.alpha_of_row(y, &mut alpha);
            weights.clear();
            match region {
                Some(region) => region.weights_of_row(y, &mut weights),
                None => weights.resize(alpha.len(), FULL_WEIGHT),
            }
            for (membership, (alpha, weight)) in row.iter_mut().zip(alpha.iter().zip(&weights)) {
                *membership = match u32::from(*alpha) * u32::from(*weight) {
                    0 => Membership::Outside,
                    product if product / full > full / 2 => Membership::Inside,
                    _ => Membership::Rim,
                };
            }
        };
        let mask = Mask::new(extent.width(), extent.height(), row, cancelled)?;
        let mut digest = Collector::new("mlswarp mask 1").bytes(&image.digest().0);
        if let Some(region) = region {
            digest = digest.bytes(&region.digest().0);
        }
        Some(Self {
            mask: Arc::new(mask),
            digest: digest.finish(),
        })
    }
}

impl PartialEq for RestMask {
    fn eq(&self, other: &Self) -> bool {
        self.digest == other.digest
    }
}
