//! Limits of one image, checked on the header.

use super::CodecError;
use crate::pixmap::Extent;

/// The largest image that is accepted.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct ImageLimits {
    /// Number of pixels.
    pub max_pixels: u64,
    /// Pixels along either side.
    pub max_side: u32,
}

impl Default for ImageLimits {
    fn default() -> Self {
        Self {
            max_pixels: 50_000_000,
            max_side: 16_384,
        }
    }
}

impl ImageLimits {
    /// Checks the side first, because a client can correct it most easily.
    ///
    /// # Errors
    /// [`CodecError::TooLarge`] naming `image_side` or `image_pixels`.
    ///
    /// ```
    /// use mlswarp::format::ImageLimits;
    /// use mlswarp::pixmap::Extent;
    /// let limits = ImageLimits { max_side: 1000, ..ImageLimits::default() };
    /// assert!(limits.check(Extent::new(1001, 1).unwrap()).is_err());
    /// ```
    pub fn check(&self, extent: Extent) -> Result<(), CodecError> {
        let side = extent.width().max(extent.height());
        if side > self.max_side {
            return Err(CodecError::TooLarge {
                what: "image_side",
                limit: self.max_side.into(),
                actual: side.into(),
            });
        }
        if extent.pixels() > self.max_pixels {
            return Err(CodecError::TooLarge {
                what: "image_pixels",
                limit: self.max_pixels,
                actual: extent.pixels(),
            });
        }
        Ok(())
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn limits_hold_their_own_value_and_refuse_the_next() {
        let limits = ImageLimits {
            max_pixels: 100,
            max_side: 50,
        };
        let check = |width, height| limits.check(Extent::new(width, height).unwrap());
        assert_eq!(check(50, 2), Ok(()));
        assert_eq!(check(10, 10), Ok(()));
        assert_eq!(
            check(51, 1),
            Err(CodecError::TooLarge {
                what: "image_side",
                limit: 50,
                actual: 51
            })
        );
        assert_eq!(
            check(1, 51),
            Err(CodecError::TooLarge {
                what: "image_side",
                limit: 50,
                actual: 51
            })
        );
        assert_eq!(
            check(10, 11),
            Err(CodecError::TooLarge {
                what: "image_pixels",
                limit: 100,
                actual: 110
            })
        );
        assert!(
            ImageLimits {
                max_pixels: u64::MAX,
                max_side: u32::MAX
            }
            .check(Extent::new(u32::MAX, u32::MAX).unwrap())
            .is_ok()
        );
    }
}
