//! Fallible allocation of sample buffers.

use super::{CodecError, StepCounter};
use crate::pixmap::Channels;

/// The allocator refused. The available memory is unknown, so the limit is 0.
pub(super) const fn no_room(asked: u64) -> CodecError {
    CodecError::TooLarge {
        what: "image_bytes",
        limit: 0,
        actual: asked,
    }
}

/// An empty vector with capacity for `len` samples.
pub(super) fn room<T>(len: u64) -> Result<Vec<T>, CodecError> {
    let refused = no_room(len.saturating_mul(size_of::<T>() as u64));
    let mut samples = Vec::new();
    let len = usize::try_from(len).map_err(|_| refused.clone())?;
    samples.try_reserve_exact(len).map_err(|_| refused)?;
    Ok(samples)
}

/// `len` zero samples. Touching the memory takes as long as some decoders, so cancellation is
/// checked meanwhile.
pub(super) fn zeros<T: Copy + Default>(
    len: u64,
    work: &StepCounter<'_>,
) -> Result<Vec<T>, CodecError> {
    const PART: usize = 1 << 22;
    let mut samples = room(len)?;
    let len = samples
        .capacity()
        .min(usize::try_from(len).unwrap_or(usize::MAX));
    while samples.len() < len {
        work.check()?;
        samples.resize(len.min(samples.len() + PART), T::default());
    }
    Ok(samples)
}

/// Number of samples of an image.
pub(super) const fn sample_count(pixels: u64, channels: Channels) -> u64 {
    pixels.saturating_mul(channels.count() as u64)
}
