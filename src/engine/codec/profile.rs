//! Selection of the colour profiles that are kept.

/// The largest colour profile that is kept: real ones are below 100 KiB, printer profiles (never
/// RGB) below 3 MiB.
pub(super) const MAX_ICC: usize = 1 << 20;

/// Upper bound of a profile's memory: inflated, and encoded for writing.
pub const PROFILE_BYTES: u64 = 2 * MAX_ICC as u64;

/// Keeps a profile that is well-formed (ICC.1, 7.2: its length in the first four bytes, `acsp` at
/// byte 36), not too large, and for the samples of the file: grey, or RGB.
pub(super) fn keep_profile(profile: Vec<u8>, grey: bool) -> Option<Vec<u8>> {
    let length = profile
        .first_chunk()
        .map(|length| u32::from_be_bytes(*length));
    let is_one = length.is_some_and(|length| length as usize == profile.len())
        && profile.get(36..40) == Some(b"acsp");
    let is_grey = match profile.get(16..20) {
        Some(b"RGB ") => false,
        Some(b"GRAY") => true,
        _ => return None,
    };
    (is_one && profile.len() <= MAX_ICC && is_grey == grey).then_some(profile)
}
