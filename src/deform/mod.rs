//! The mathematics: moving-least-squares deformation after Schaefer, McPhail, Warren 2006, in the anchored, ratio-first form that keeps
//! its digits next to handles and on the extension of segments. No pixels, no bytes, no time.

mod error;
mod handles;

pub use error::{DeformError, Warning};
pub use handles::{Handle, Handles, Pose};

/// The class of maps that is fitted at every place.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Hash)]
pub enum Method {
    /// `xM + T`, eq. (5).
    Affine,
    /// Rotation and uniform scale, eqs. (6), (7).
    Similarity,
    /// Rotation alone, eq. (8).
    #[default]
    Rigid,
}
