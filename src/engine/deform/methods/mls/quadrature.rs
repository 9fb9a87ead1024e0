//! Graded Gauss-Legendre quadrature along a segment, for any alpha: no cancellation, no special
//! cases (mathematics 3.2). Unit: the length of the segment.

use super::falloff::Falloff;

/// Nodes that are evaluated together.
const NODES_PER_BATCH: usize = 8;

/// Nodes in [0, 1] and weights of a panel of length 1. A panel is no longer than its distance from
/// v, so n nodes leave an error of about 4.6^(-2n): 8 suffice for a plan, whose coefficients are
/// f32, at alpha up to 2.
static GAUSS_8: [Batch; 1] = [batch([
    (0.183_434_642_495_649_8, 0.362_683_783_378_362),
    (0.525_532_409_916_329, 0.313_706_645_877_887_3),
    (0.796_666_477_413_626_7, 0.222_381_034_453_374_48),
    (0.960_289_856_497_536_2, 0.101_228_536_290_376_26),
])];

/// The same with 16 nodes, for exact evaluation and for plans at higher alpha.
static GAUSS_16: [Batch; 2] = [
    batch([
        (0.095_012_509_837_637_44, 0.189_450_610_455_068_5),
        (0.281_603_550_779_258_9, 0.182_603_415_044_923_6),
        (0.458_016_777_657_227_4, 0.169_156_519_395_002_54),
        (0.617_876_244_402_643_7, 0.149_595_988_816_576_73),
    ]),
    batch([
        (0.755_404_408_355_003, 0.124_628_971_255_533_87),
        (0.865_631_202_387_831_7, 0.095_158_511_682_492_78),
        (0.944_575_023_073_232_6, 0.062_253_523_938_647_89),
        (0.989_400_934_991_649_9, 0.027_152_459_411_754_095),
    ]),
];

struct Batch {
    at: [f64; NODES_PER_BATCH],
    weight: [f64; NODES_PER_BATCH],
}

/// Mirrors positive nodes on [-1, 1] and moves them to [0, 1].
const fn batch(half: [(f64, f64); NODES_PER_BATCH / 2]) -> Batch {
    let mut b = Batch {
        at: [0.0; NODES_PER_BATCH],
        weight: [0.0; NODES_PER_BATCH],
    };
    let mut k = 0;
    while k < NODES_PER_BATCH / 2 {
        let (x, omega) = half[k];
        (b.at[k], b.at[NODES_PER_BATCH - 1 - k]) = (0.5 * (1.0 - x), 0.5 * (1.0 + x));
        (b.weight[k], b.weight[NODES_PER_BATCH - 1 - k]) = (0.5 * omega, 0.5 * omega);
        k += 1;
    }
    b
}

/// The parameters that the nodes on both sides of the nearest position share.
pub(in crate::deform) struct Sight {
    /// |beyond|, and the squared distance from the line, in lengths.
    pub(in crate::deform) beyond: f64,
    pub(in crate::deform) h2: f64,
    /// r2min in squared lengths.
    pub(in crate::deform) ratio: f64,
    pub(in crate::deform) falloff: Falloff,
    /// Use all 16 nodes per panel, not 8.
    pub(in crate::deform) many: bool,
}

impl Sight {
    /// `sum w z^m`, m = 0, 1, 2, over z in [0, end] from the nearest position, with density 1.
    /// Panels: [0, end / 2^n], then each as long as all before it, so none is longer than its
    /// distance from v.
    #[inline(always)]
    pub(in crate::deform) fn side(&self, end: f64) -> [f64; 3] {
        let mut sums = [[0.0; NODES_PER_BATCH]; 3];
        if end > 0.0 {
            let nearest = self.beyond * self.beyond + self.h2;
            let mut first = end;
            // The snap bounds the distance below, so 64 steps are never reached.
            for _ in 0..64 {
                if first * first <= nearest {
                    break;
                }
                first *= 0.5;
            }
            self.panel(0.0, first, &mut sums);
            while first < end {
                self.panel(first, first, &mut sums);
                first *= 2.0;
            }
        }
        sums.map(|lanes| {
            let [a, b, c, d, e, f, g, h] = lanes;
            ((a + h) + (b + g)) + ((c + f) + (d + e))
        })
    }

    #[inline(always)]
    fn panel(&self, from: f64, length: f64, sums: &mut [[f64; NODES_PER_BATCH]; 3]) {
        let [s0, s1, s2] = sums;
        let rule: &[Batch] = if self.many { &GAUSS_16 } else { &GAUSS_8 };
        for Batch { at, weight } in rule {
            let mut z = [0.0; NODES_PER_BATCH];
            let mut w = [0.0; NODES_PER_BATCH];
            for k in 0..NODES_PER_BATCH {
                z[k] = from + length * at[k];
                let u = self.beyond + z[k];
                w[k] = self.ratio / (u * u + self.h2);
            }
            self.falloff.of_lanes(&mut w);
            for k in 0..NODES_PER_BATCH {
                let w = length * weight[k] * w[k];
                s0[k] += w;
                s1[k] += w * z[k];
                s2[k] += w * z[k] * z[k];
            }
        }
    }
}
