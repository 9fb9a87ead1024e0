//! The instruction set of the kernels of `deform`, `render` and `codec`: detected once at run time,
//! so that a plain build is fast everywhere. `MLSWARP_LEVEL=scalar|avx2|avx512` lowers it for
//! tests; a level that the processor lacks is not used.

use std::sync::OnceLock;

/// An instruction set that kernels are compiled for, lowest first.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Hash)]
pub enum SimdLevel {
    /// The reference: what every processor of the target has.
    Scalar,
    /// x86-64 with AVX2, FMA, BMI1, BMI2 and LZCNT (x86-64-v3).
    Avx2,
    /// x86-64 with AVX-512 F, BW, CD, DQ, VL and VBMI besides (x86-64-v4 from Ice Lake and Zen 4
    /// on).
    Avx512,
}

impl SimdLevel {
    /// The best level of this processor, or the lower one that `MLSWARP_LEVEL` asks for.
    #[must_use]
    pub fn detect() -> Self {
        static LEVEL: OnceLock<SimdLevel> = OnceLock::new();
        *LEVEL.get_or_init(|| {
            let best = Self::best();
            match std::env::var("MLSWARP_LEVEL").as_deref() {
                Ok("scalar") => Self::Scalar,
                Ok("avx2") => best.min(Self::Avx2),
                Ok("avx512") => best.min(Self::Avx512),
                _ => best,
            }
        })
    }

    /// Every level that this processor has, lowest first.
    #[must_use]
    pub fn available() -> &'static [Self] {
        match Self::best() {
            Self::Scalar => &[Self::Scalar],
            Self::Avx2 => &[Self::Scalar, Self::Avx2],
            Self::Avx512 => &[Self::Scalar, Self::Avx2, Self::Avx512],
        }
    }

    /// `scalar`, `avx2`, `avx512`.
    #[must_use]
    pub const fn name(self) -> &'static str {
        match self {
            Self::Scalar => "scalar",
            Self::Avx2 => "avx2",
            Self::Avx512 => "avx512",
        }
    }

    /// Whether this processor has the level. The standard library keeps what it found, so asking is
    /// cheap; every kernel asks before it enters code that was compiled for the level.
    #[must_use]
    pub fn is_supported(self) -> bool {
        match self {
            Self::Scalar => true,
            #[cfg(target_arch = "x86_64")]
            Self::Avx2 => {
                is_x86_feature_detected!("avx2")
                    && is_x86_feature_detected!("fma")
                    && is_x86_feature_detected!("bmi1")
                    && is_x86_feature_detected!("bmi2")
                    && is_x86_feature_detected!("lzcnt")
            }
            #[cfg(target_arch = "x86_64")]
            Self::Avx512 => {
                Self::Avx2.is_supported()
                    && is_x86_feature_detected!("avx512f")
                    && is_x86_feature_detected!("avx512bw")
                    && is_x86_feature_detected!("avx512cd")
                    && is_x86_feature_detected!("avx512dq")
                    && is_x86_feature_detected!("avx512vl")
                    && is_x86_feature_detected!("avx512vbmi")
            }
            #[cfg(not(target_arch = "x86_64"))]
            Self::Avx2 | Self::Avx512 => false,
        }
    }

    fn best() -> Self {
        [Self::Avx512, Self::Avx2]
            .into_iter()
            .find(|level| level.is_supported())
            .unwrap_or(Self::Scalar)
    }
}
