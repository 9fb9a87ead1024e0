//! Numbers whose addition rounds.

/// Adding 1.5 * 2^52 leaves the nearest integer in the low bits of an f64.
pub(super) const ROUNDING_SUMMAND: f64 = 6_755_399_441_055_744.0;
/// Adding 2^23 leaves the nearest integer in the low bits of an f32 from 0 to 2^22.
pub(super) const ROUND_F32: f32 = 8_388_608.0;
