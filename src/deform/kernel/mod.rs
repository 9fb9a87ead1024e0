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

/// The same at a level; one that the processor lacks is scalar.
pub(super) fn displace_at(level: Level, family: Method, table: &[Lanes], d: &[[f32; 2]], out: &mut [[f32; 2]]) -> f32 {
    match level {
        #[cfg(target_arch = "x86_64")]
        Level::Avx2 | Level::Avx512 if level.is_here() => x86::displace(family, table, d, out),
        _ => scalar::displace(family, table, d, out),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Every level gives the bits of the reference, for every family and for vertex counts that do not fill their last block.
    #[test]
    fn levels_give_the_same_bits() {
        let mut state = 1u32;
        let mut next = || {
            state = state.wrapping_mul(1_664_525).wrapping_add(1_013_904_223);
            (state >> 8) as f32 / 8_388_608.0 - 1.0
        };
        for (family, per_column, extra) in [(Method::Affine, 1, 0), (Method::Similarity, 2, 0), (Method::Rigid, 3, 2)] {
            for (columns, vertices) in [(1, 1), (7, 100), (3, 16), (11, 33)] {
                let blocks = usize::div_ceil(vertices, LANES);
                let table: Vec<Lanes> =
                    (0..blocks * (per_column * columns + extra)).map(|_| Lanes([0.0; LANES].map(|_: f32| next()))).collect();
                let d: Vec<[f32; 2]> = (0..columns).map(|_| [next(), next()]).collect();
                let mut reference = vec![[0.0; 2]; vertices];
                let least = displace_at(Level::Scalar, family, &table, &d, &mut reference);
                for &level in Level::available() {
                    let mut out = vec![[f32::NAN; 2]; vertices];
                    assert_eq!(displace_at(level, family, &table, &d, &mut out).to_bits(), least.to_bits());
                    assert_eq!(out, reference, "{family:?} {level:?}");
                }
            }
        }
    }

    #[test]
    fn rotation_that_is_undefined_leaves_the_translation() {
        // H d = -1: m = 0. e must not matter, wn d must stay.
        let mut block = vec![Lanes([0.0; LANES]); 5];
        block[0] = Lanes([-1.0; LANES]);
        block[2] = Lanes([1.0; LANES]);
        block[3] = Lanes([50.0; LANES]);
        let mut out = vec![[0.0; 2]; LANES];
        for &level in Level::available() {
            assert_eq!(displace_at(level, Method::Rigid, &block, &[[1.0, 0.0]], &mut out), 0.0);
            assert_eq!(out, vec![[1.0, 0.0]; LANES], "{level:?}");
        }
    }
}
