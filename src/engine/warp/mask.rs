//! The pixels of an image that its handles can act through, as a part of the rest specification.

use std::sync::Arc;

use super::digest::Collector;
use super::{Digest, Image, Region, RestSpec, Units, WarpError};
use crate::deform::{Handle, IsCancelled};
use crate::geometry::Point;
use crate::render::FULL_WEIGHT;
use crate::topology::{Mask, Membership};

/// A mask of the size of the image, and what it is known by in keys and digests. Two are equal if
/// their digests are.
#[derive(Clone, Debug)]
pub struct RestMask {
    /// The mask.
    pub mask: Arc<Mask>,
    /// The digest of everything that the mask was made from.
    pub digest: Digest,
}

impl RestMask {
    /// The share of full alpha above which pixels are inside, if none is given.
    pub const THRESHOLD: f64 = 0.5;

    /// Whether the first position of a handle lies on a pixel inside, or beside one.
    #[must_use]
    pub fn holds(&self, handle: &Handle, units: Units) -> bool {
        let (width, height) = self.mask.size();
        let (ux, uy) = match units {
            Units::Px => (1.0, 1.0),
            Units::Normalized => (width as f64, height as f64),
        };
        handle.places().first().is_some_and(|place| {
            let place = Point::new(place.x * ux, place.y * uy);
            self.mask.pixel_at(place, 0.0).is_some()
        })
    }

    /// Bytes that the mask of an image takes, with what its construction needs; see
    /// [`RestMask::of_image`]. `None` when cancelled.
    #[must_use]
    pub fn bytes_for(
        image: &Image,
        region: Option<&Region>,
        threshold: f64,
        cancelled: IsCancelled<'_>,
    ) -> Option<u64> {
        let extent = image.extent();
        let mut rim = 0;
        if image.has_alpha() || region.is_some() {
            let mut of_row = memberships(image, region, threshold);
            let mut row = vec![Membership::Outside; extent.width() as usize];
            for y in 0..extent.height() {
                if cancelled() {
                    return None;
                }
                of_row(y, &mut row);
                let is_rim = |membership: &&Membership| **membership == Membership::Rim;
                rim += row.iter().filter(is_rim).count() as u64;
            }
        }
        Some(Mask::bytes_for(extent.width(), extent.height(), rim))
    }

    /// The mask of an image: pixels whose share of full alpha is above the threshold are inside,
    /// the others that are visible are rim. With a region of its size, alpha counts times its
    /// weight. `None` when cancelled.
    ///
    /// # Panics
    /// If the region has another size.
    #[must_use]
    pub fn of_image(
        image: &Image,
        region: Option<&Region>,
        threshold: f64,
        cancelled: IsCancelled<'_>,
    ) -> Option<Self> {
        let extent = image.extent();
        let row = memberships(image, region, threshold);
        let mask = Mask::new(extent.width(), extent.height(), row, cancelled)?;
        let mut digest = Collector::new("mlswarp mask 1")
            .bytes(&image.digest().0)
            .float(threshold);
        if let Some(region) = region {
            digest = digest.bytes(&region.digest().0);
        }
        Some(Self {
            mask: Arc::new(mask),
            digest: digest.finish(),
        })
    }
}

impl RestSpec {
    /// Makes the mask of an image and a region of its size, if there must be one.
    ///
    /// # Errors
    /// Cancelled.
    ///
    /// # Panics
    /// If the region has another size.
    pub fn make_mask(
        &mut self,
        image: &Image,
        region: Option<&Region>,
        cancelled: IsCancelled<'_>,
    ) -> Result<(), WarpError> {
        if self.needs_mask() {
            let threshold = self.mask_threshold.unwrap_or(RestMask::THRESHOLD);
            let mask = RestMask::of_image(image, region, threshold, cancelled);
            self.mask = Some(mask.ok_or(WarpError::Cancelled)?);
        }
        Ok(())
    }
}

/// What the pixels of a row are.
fn memberships<'a>(
    image: &'a Image,
    region: Option<&'a Region>,
    threshold: f64,
) -> impl FnMut(u32, &mut [Membership]) + 'a {
    assert!(
        region.is_none_or(|region| region.extent() == image.extent()),
        "a region has the size of its image"
    );
    let full = u32::from(FULL_WEIGHT);
    let least = f64::from(full) * f64::from(full) * threshold;
    let (mut alpha, mut weights) = (Vec::new(), Vec::new());
    move |y, row| {
        image.alpha_of_row(y, &mut alpha);
        weights.clear();
        match region {
            Some(region) => region.weights_of_row(y, &mut weights),
            None => weights.resize(alpha.len(), FULL_WEIGHT),
        }
        for (membership, (alpha, weight)) in row.iter_mut().zip(alpha.iter().zip(&weights)) {
            *membership = match u32::from(*alpha) * u32::from(*weight) {
                0 => Membership::Outside,
                product if f64::from(product) > least => Membership::Inside,
                _ => Membership::Rim,
            };
        }
    }
}

impl PartialEq for RestMask {
    fn eq(&self, other: &Self) -> bool {
        self.digest == other.digest
    }
}
