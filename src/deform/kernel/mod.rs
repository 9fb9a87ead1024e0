//! Posing a block of vertices: the only loop that a drag runs over the table. One dispatch point; every level does the same operations in the
//! same order (no fused multiply-add), so all levels give the same bits.

mod scalar;
#[cfg(target_arch = "x86_64")]
#[expect(unsafe_code, reason = "calls a function compiled for AVX2 after the processor was asked for it")]
mod x86;

use super::Method;
use crate::level::Level;

/// Vertices in a block.
pub(super) const LANES: usize = 16;

/// One coefficient of the vertices of a block.
#[derive(Clone, Copy, Debug, Default)]
#[repr(align(64))]
pub(super) struct Lanes(pub(super) [f32; LANES]);

/// Displacements of the vertices of whole blocks (the last may be partly unused): `out[k] = f(v_k) - v_k`, px.
/// Shapes: `table: [blocks][lanes per block]`, `d: [columns]`, `out: [vertices]`. Returns the least |m| (rigid), else 1.
pub(super) fn displace(family: Method, table: &[Lanes], d: &[[f32; 2]], out: &mut [[f32; 2]]) -> f32 {
    displace_at(Level::detect(), family, table, d, out)
}

/// The same at a level that the processor has.
pub(super) fn displace_at(level: Level, family: Method, table: &[Lanes], d: &[[f32; 2]], out: &mut [[f32; 2]]) -> f32 {
    match level {
        #[cfg(target_arch = "x86_64")]
        Level::Avx2 => x86::displace(family, table, d, out),
        _ => scalar::displace(family, table, d, out),
    }
}
