//! Which colour profiles of a file are kept.

/// A colour profile larger than this is dropped: real ones are below 100 KiB, printer profiles (never RGB) below 3 MiB.
pub(super) const MAX_ICC: usize = 1 << 20;

/// The most that a profile takes, inflated and as it will be written back.
pub const PROFILE_BYTES: u64 = 2 * MAX_ICC as u64;

/// A profile is kept when it is one (ICC.1, 7.2: its length in its first four bytes, `acsp` at byte 36), of sane size, and for RGB.
pub(super) fn keep_rgb_profile(profile: Vec<u8>) -> Option<Vec<u8>> {
    let length = profile.first_chunk().map(|length| u32::from_be_bytes(*length));
    let is_one = length.is_some_and(|length| length as usize == profile.len()) && profile.get(36..40) == Some(b"acsp");
    (is_one && profile.len() <= MAX_ICC && profile.get(16..20) == Some(b"RGB ")).then_some(profile)
}
