//! AVX2: the scalar loops compiled again for wide registers, and the bilinear sampler by hand. A function without `unsafe` in its name may be
//! called on any machine that made the [`Kernel`] it is given, which proves that the level was detected.

use std::ops::Range;

use super::scalar::{self, CellRow, Spans};
use super::{Kernel, Level};
use crate::pixmap::Channels;
use crate::render::lattice::Lattice;
use crate::render::source::Packed;

/// Compiles a function of `scalar` for AVX2 under the same name.
macro_rules! widened {
    ($($name:ident($($argument:ident: $kind:ty),*);)*) => {
        $(pub(super) fn $name(kernel: Kernel, $($argument: $kind),*) {
            #[target_feature(enable = "avx2,fma,bmi1,bmi2")]
            fn wide($($argument: $kind),*) {
                scalar::$name($($argument),*);
            }
            debug_assert_eq!(kernel.0, Level::Avx2);
            // SAFETY: a `Kernel` of this level is only made where the machine was seen to have it.
            unsafe { wide($($argument),*) }
        })*
    };
}

widened! {
    snap(rest_x: &[f64], rest_y: f64, displacement: &[[f32; 2]], scale: [f64; 2], x: &mut [i32], y: &mut [i32]);
    sound(cells: &CellRow<'_>, above: &[f32], below: &[f32], sound: &mut [bool]);
    bends(above: &CellRow<'_>, below: &CellRow<'_>, bends: &mut [f32]);
    crossings(lattice: &Lattice, rows: Range<u32>, x: &mut [f32], v: &mut [f32]);
    spans(spans: &mut Spans<'_>, u: &mut [f32], v: &mut [f32]);
    sample(packed: &Packed, u: &[f32], v: &[f32], channels: Channels, out: &mut [u8]);
}
