//! The reference's loops compiled for AVX2 and AVX-512. The safe functions must be called on a
//! processor that has the level.

use super::{
    BlockDisplacements, CoefficientForm, CoefficientLanes, CoefficientScratch, Coefficients,
    LaneWork, Metric, RowInputs, Vertices, scalar,
};

/// See [`super::displace`].
pub(super) fn displace_avx2(
    form: CoefficientForm,
    table: &[CoefficientLanes],
    d: &[[f32; 2]],
    out: &mut Vec<BlockDisplacements>,
) -> f32 {
    #[target_feature(enable = "avx2")]
    fn body(
        form: CoefficientForm,
        table: &[CoefficientLanes],
        d: &[[f32; 2]],
        out: &mut Vec<BlockDisplacements>,
    ) -> f32 {
        scalar::displace_inline::<false>(form, table, d, out)
    }
    // SAFETY: the one caller asks `SimdLevel::is_supported` first.
    unsafe { body(form, table, d, out) }
}

/// See [`super::displace`].
pub(super) fn displace_avx512(
    form: CoefficientForm,
    table: &[CoefficientLanes],
    d: &[[f32; 2]],
    out: &mut Vec<BlockDisplacements>,
) -> f32 {
    #[target_feature(enable = "avx512f,avx512bw,avx512cd,avx512dq,avx512vl,avx512vbmi")]
    fn body(
        form: CoefficientForm,
        table: &[CoefficientLanes],
        d: &[[f32; 2]],
        out: &mut Vec<BlockDisplacements>,
    ) -> f32 {
        // With fewer lanes in a vector a block has sums enough to keep the processor busy.
        scalar::displace_inline::<true>(form, table, d, out)
    }
    // SAFETY: the one caller asks `SimdLevel::is_supported` first.
    unsafe { body(form, table, d, out) }
}

/// See [`super::rows`].
pub(super) fn rows_avx2<const N: usize>(
    inputs: &RowInputs<'_, impl Metric>,
    v: &Vertices<N>,
    scratch: &mut CoefficientScratch<N>,
    rows: &mut Coefficients<N>,
) {
    #[target_feature(enable = "avx2")]
    fn body<const N: usize>(
        inputs: &RowInputs<'_, impl Metric>,
        v: &Vertices<N>,
        scratch: &mut CoefficientScratch<N>,
        rows: &mut Coefficients<N>,
    ) {
        inputs.rows(v, scratch, rows);
    }
    // SAFETY: the one caller asks `SimdLevel::is_supported` first.
    unsafe { body(inputs, v, scratch, rows) }
}

/// See [`super::rows`].
pub(super) fn rows_avx512<const N: usize>(
    inputs: &RowInputs<'_, impl Metric>,
    v: &Vertices<N>,
    scratch: &mut CoefficientScratch<N>,
    rows: &mut Coefficients<N>,
) {
    #[target_feature(enable = "avx512f,avx512bw,avx512cd,avx512dq,avx512vl,avx512vbmi")]
    fn body<const N: usize>(
        inputs: &RowInputs<'_, impl Metric>,
        v: &Vertices<N>,
        scratch: &mut CoefficientScratch<N>,
        rows: &mut Coefficients<N>,
    ) {
        inputs.rows(v, scratch, rows);
    }
    // SAFETY: the one caller asks `SimdLevel::is_supported` first.
    unsafe { body(inputs, v, scratch, rows) }
}

/// See [`super::run_at`].
pub(super) fn run_avx2<W: LaneWork>(work: W) -> W::Output {
    #[target_feature(enable = "avx2")]
    fn body<W: LaneWork>(work: W) -> W::Output {
        work.run()
    }
    // SAFETY: the one caller asks `SimdLevel::is_supported` first.
    unsafe { body(work) }
}

/// See [`super::run_at`].
pub(super) fn run_avx512<W: LaneWork>(work: W) -> W::Output {
    #[target_feature(enable = "avx512f,avx512bw,avx512cd,avx512dq,avx512vl,avx512vbmi")]
    fn body<W: LaneWork>(work: W) -> W::Output {
        work.run()
    }
    // SAFETY: the one caller asks `SimdLevel::is_supported` first.
    unsafe { body(work) }
}
