//! Averages, morphs, caricatures and transforms: one formula over several images (mathematics 15).
//!
//! ```text
//! t = sum a_k A_k(p_k)        the target shape: shape weights a_k, alignments A_k   (shapes.rs)
//! J = sum b_k W_k(I_k)        the target image: colour weights b_k, warps W_k: p_k -> t
//! ```
//!
//! A [`BlendedShape`] is t. A [`ImageSum`] takes the images one after another, so that only one of
//! them is in memory, and gives J as an [`Image`](super::Image) like any other.

mod mirror;
mod shapes;
mod sum;
#[cfg(test)]
mod tests;

pub use self::mirror::{MirrorPairs, NoPairs};
pub use self::shapes::{BlendedShape, ShapeError, ShapeReference};
pub use self::sum::{BlendSpace, BlendedImage, ImageSum};
