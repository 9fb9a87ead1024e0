//! The reference's loops compiled for AVX2.

use super::{Lanes, Method, scalar};

/// See [`super::displace`]. Must be called on a processor with AVX2.
pub(super) fn displace(family: Method, table: &[Lanes], d: &[[f32; 2]], out: &mut [[f32; 2]]) -> f32 {
    // SAFETY: the one caller asks `Level::is_here` first.
    unsafe { displace_avx2(family, table, d, out) }
}

#[target_feature(enable = "avx2")]
fn displace_avx2(family: Method, table: &[Lanes], d: &[[f32; 2]], out: &mut [[f32; 2]]) -> f32 {
    scalar::displace_inline(family, table, d, out)
}
