//! Poses blocks of vertices, the only loop over the table during a drag, and computes blocks of
//! rows for a plan. The one place of `deform` that chooses an instruction set; every level does the
//! same operations in the same order (no fused multiply-add), so all levels give the same bits.
//! Measurements and rejected variants: `notes.md`.

mod scalar;
#[cfg(target_arch = "x86_64")]
#[expect(
    unsafe_code,
    reason = "calls a function compiled for AVX2 after the processor was asked for it"
)]
mod x86;

use super::form::CoefficientForm;
use super::lanes::{Coefficients, LANES, Vertices};
use super::methods::mls::metric::Metric;
use super::methods::mls::row::RowInputs;
use super::workspace::CoefficientScratch;
use crate::level::SimdLevel;

/// One coefficient of the vertices of a block.
#[derive(Clone, Copy, Debug, Default)]
#[repr(align(64))]
pub(super) struct CoefficientLanes(pub(super) [f32; LANES]);

/// The displacements of a block, px.
pub(super) type BlockDisplacements = [[f32; 2]; LANES];

/// Lanes in a block of this form.
pub(super) const fn lanes_per_block(form: CoefficientForm, terms: usize) -> usize {
    match form {
        CoefficientForm::Real => terms,
        CoefficientForm::Complex => 2 * terms,
        CoefficientForm::Rigid => 3 * terms + 2,
    }
}

/// Appends the displacements `f(v_k) - v_k` of the vertices of all blocks, px. Shapes:
/// `table: [blocks][lanes per block]`, `d: [terms]`, `out: [blocks]`. Returns the least |m|
/// (rigid), else 1.
pub(super) fn displace(
    form: CoefficientForm,
    table: &[CoefficientLanes],
    d: &[[f32; 2]],
    out: &mut Vec<BlockDisplacements>,
) -> f32 {
    displace_at(SimdLevel::detect(), form, table, d, out)
}

/// Like [`displace`], at a level; scalar if the processor lacks it.
pub(super) fn displace_at(
    level: SimdLevel,
    form: CoefficientForm,
    table: &[CoefficientLanes],
    d: &[[f32; 2]],
    out: &mut Vec<BlockDisplacements>,
) -> f32 {
    match level {
        #[cfg(target_arch = "x86_64")]
        SimdLevel::Avx512 if level.is_supported() => x86::displace_avx512(form, table, d, out),
        #[cfg(target_arch = "x86_64")]
        SimdLevel::Avx2 if level.is_supported() => x86::displace_avx2(form, table, d, out),
        _ => scalar::displace(form, table, d, out),
    }
}

/// The rows of N vertices, for whole plans and single places.
pub(super) fn rows<const N: usize>(
    inputs: &RowInputs<'_, impl Metric>,
    v: &Vertices<N>,
    scratch: &mut CoefficientScratch<N>,
    rows: &mut Coefficients<N>,
) {
    rows_at(SimdLevel::detect(), inputs, v, scratch, rows);
}

/// Like [`rows`], at a level; scalar if the processor lacks it.
pub(super) fn rows_at<const N: usize>(
    level: SimdLevel,
    inputs: &RowInputs<'_, impl Metric>,
    v: &Vertices<N>,
    scratch: &mut CoefficientScratch<N>,
    rows: &mut Coefficients<N>,
) {
    match level {
        #[cfg(target_arch = "x86_64")]
        SimdLevel::Avx512 if level.is_supported() => x86::rows_avx512(inputs, v, scratch, rows),
        #[cfg(target_arch = "x86_64")]
        SimdLevel::Avx2 if level.is_supported() => x86::rows_avx2(inputs, v, scratch, rows),
        _ => inputs.rows(v, scratch, rows),
    }
}

/// Work over lanes. Its body, which must be inlined, is compiled for every level.
pub(super) trait LaneWork {
    /// The result.
    type Output;

    /// The body.
    fn run(self) -> Self::Output;
}

/// Does the work at a level; scalar if the processor lacks it.
pub(super) fn run_at<W: LaneWork>(level: SimdLevel, work: W) -> W::Output {
    match level {
        #[cfg(target_arch = "x86_64")]
        SimdLevel::Avx512 if level.is_supported() => x86::run_avx512(work),
        #[cfg(target_arch = "x86_64")]
        SimdLevel::Avx2 if level.is_supported() => x86::run_avx2(work),
        _ => work.run(),
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::deform::Falloff;
    use crate::deform::columns::{HandleElements, PointSource, RestSegment};
    use crate::deform::methods::mls::incomplete_beta::IncompleteBeta;
    use crate::deform::methods::mls::metric::Euclidean;
    use crate::geometry::Point;

    /// Every level gives the bits of the reference, for every class.
    #[test]
    fn levels_give_the_same_bits() {
        let mut state = 1u32;
        let mut next = || {
            state = state.wrapping_mul(1_664_525).wrapping_add(1_013_904_223);
            (state >> 8) as f32 / 8_388_608.0 - 1.0
        };
        for (form, per_column, extra) in [
            (CoefficientForm::Real, 1, 0),
            (CoefficientForm::Complex, 2, 0),
            (CoefficientForm::Rigid, 3, 2),
        ] {
            for (columns, blocks) in [(1, 1), (7, 7), (3, 2), (11, 3)] {
                let table: Vec<CoefficientLanes> = (0..blocks * (per_column * columns + extra))
                    .map(|_| CoefficientLanes([0.0; LANES].map(|_: f32| next())))
                    .collect();
                let d: Vec<[f32; 2]> = (0..columns).map(|_| [next(), next()]).collect();
                let mut reference = Vec::new();
                let least = displace_at(SimdLevel::Scalar, form, &table, &d, &mut reference);
                for &level in SimdLevel::available() {
                    let mut out = Vec::new();
                    assert_eq!(
                        displace_at(level, form, &table, &d, &mut out).to_bits(),
                        least.to_bits()
                    );
                    assert_eq!(out.len(), blocks);
                    assert_eq!(out, reference, "{form:?} {level:?}");
                }
            }
        }
    }

    /// The same for rows: points and segments, every kind of power, vertices on handles, next to
    /// them and far away, sixteen at once and one by one.
    #[test]
    fn levels_weigh_to_the_same_bits() {
        let segment = |a: Point, b: Point, column| {
            let length = a.distance(b);
            RestSegment {
                a,
                b,
                length,
                tau: (b - a) * (1.0 / length),
                weight: 0.7,
                column,
            }
        };
        let points: Vec<PointSource> = [(100.0, 100.0), (400.25, 120.0), (260.0, 391.5)]
            .into_iter()
            .zip(0..)
            .map(|((x, y), column)| PointSource {
                p: Point::new(x, y),
                mass: 30.0,
                column,
            })
            .collect();
        let segments = vec![
            segment(Point::new(40.0, 200.0), Point::new(300.0, 210.0), 3),
            segment(Point::new(300.0, 210.0), Point::new(320.0, 480.0), 5),
        ];
        let mut v = Vertices::<LANES>::all(Point::new(0.0, 0.0));
        for k in 0..LANES {
            (v.x[k], v.y[k]) = (31.0 * k as f64 - 17.0, 77.0 * (k * k % 7) as f64 + 0.125);
        }
        (v.x[0], v.y[0]) = (100.0, 100.0);
        (v.x[1], v.y[1]) = (400.25, 120.0 + 1e-6);
        (v.x[2], v.y[2]) = (300.0, 210.0);
        (v.x[3], v.y[3]) = (170.0, 205.0 + 1e-4);
        (v.x[4], v.y[4]) = (1e5, -3e4);
        for (points, segments, columns) in [(points.clone(), vec![], 3), (points, segments, 7)] {
            let sources = HandleElements { points, segments };
            for alpha in [0.5, 1.0, 1.3, 1.5, 2.0, 3.0, 7.9] {
                for (form, exact) in [
                    (CoefficientForm::Real, false),
                    (CoefficientForm::Complex, false),
                    (CoefficientForm::Rigid, false),
                    (CoefficientForm::Real, true),
                    (CoefficientForm::Rigid, true),
                ] {
                    let (falloff, beta) = (
                        Falloff::new(alpha, true).unwrap(),
                        IncompleteBeta::new(alpha),
                    );
                    let inputs = RowInputs {
                        metric: Euclidean,
                        sources: &sources,
                        extent: 400.0,
                        falloff,
                        beta: beta.as_ref(),
                        point_mass: 1.0,
                        form,
                        exact,
                    };
                    let bits = |rows: &Coefficients<LANES>, k: usize| -> Vec<u64> {
                        let all = rows.h.iter().flatten().chain(&rows.wn).chain(&rows.e);
                        all.map(|lanes| lanes[k].to_bits()).collect()
                    };
                    let run = |level| {
                        let mut rows = Coefficients::zeroed(columns);
                        rows_at(
                            level,
                            &inputs,
                            &v,
                            &mut CoefficientScratch::default(),
                            &mut rows,
                        );
                        rows
                    };
                    let reference = run(SimdLevel::Scalar);
                    for &level in SimdLevel::available() {
                        let rows = run(level);
                        for k in 0..LANES {
                            assert_eq!(
                                bits(&rows, k),
                                bits(&reference, k),
                                "{level:?} {form:?} {alpha} {k}"
                            );
                            let mut one = Coefficients::<1>::zeroed(columns);
                            let at = Vertices::all(Point::new(v.x[k], v.y[k]));
                            rows_at(
                                level,
                                &inputs,
                                &at,
                                &mut CoefficientScratch::default(),
                                &mut one,
                            );
                            let single: Vec<u64> = one
                                .h
                                .iter()
                                .flatten()
                                .chain(&one.wn)
                                .chain(&one.e)
                                .map(|x| x[0].to_bits())
                                .collect();
                            assert_eq!(
                                single,
                                bits(&reference, k),
                                "{level:?} {form:?} {alpha} {k}, alone"
                            );
                            assert!(single.iter().all(|x| f64::from_bits(*x).is_finite()));
                        }
                    }
                }
            }
        }
    }

    #[test]
    fn rotation_that_is_undefined_leaves_the_translation() {
        // H d = -1: m = 0. e must not matter, wn d must stay.
        let mut block = vec![CoefficientLanes([0.0; LANES]); 5];
        block[0] = CoefficientLanes([-1.0; LANES]);
        block[2] = CoefficientLanes([1.0; LANES]);
        block[3] = CoefficientLanes([50.0; LANES]);
        for &level in SimdLevel::available() {
            let mut out = Vec::new();
            assert_eq!(
                displace_at(
                    level,
                    CoefficientForm::Rigid,
                    &block,
                    &[[1.0, 0.0]],
                    &mut out
                ),
                0.0
            );
            assert_eq!(out, [[[1.0, 0.0]; LANES]], "{level:?}");
        }
    }
}
