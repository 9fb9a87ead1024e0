//! Which instruction set the kernels of `deform`, `render` and `codec::png` use: asked of the processor once, at run time, so that a plain
//! build is fast everywhere. `MLSWARP_LEVEL=scalar|avx2` lowers it (tests run every level; a level that the processor lacks is not taken).

use std::sync::OnceLock;

/// An instruction set that kernels are compiled for, lowest first.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Hash)]
pub enum Level {
    /// The reference: what every processor of the target has.
    Scalar,
    /// x86-64 with AVX2, FMA, BMI1, BMI2 and LZCNT (x86-64-v3).
    Avx2,
}

impl Level {
    /// The best level of this processor, or the lower one that `MLSWARP_LEVEL` asks for.
    #[must_use]
    pub fn detect() -> Self {
        static LEVEL: OnceLock<Level> = OnceLock::new();
        *LEVEL.get_or_init(|| {
            let best = Self::best();
            match std::env::var("MLSWARP_LEVEL").as_deref() {
                Ok("scalar") => Self::Scalar,
                Ok("avx2") => best.min(Self::Avx2),
                _ => best,
            }
        })
    }

    /// Every level that this processor has, lowest first.
    #[must_use]
    pub fn available() -> &'static [Self] {
        if Self::best() == Self::Avx2 { &[Self::Scalar, Self::Avx2] } else { &[Self::Scalar] }
    }

    /// `scalar`, `avx2`.
    #[must_use]
    pub const fn name(self) -> &'static str {
        match self {
            Self::Scalar => "scalar",
            Self::Avx2 => "avx2",
        }
    }

    /// Whether this processor has the level. The standard library keeps what it found, so asking is cheap; every kernel asks before it
    /// enters code that was compiled for the level.
    #[must_use]
    pub fn is_here(self) -> bool {
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
            #[cfg(not(target_arch = "x86_64"))]
            Self::Avx2 => false,
        }
    }

    fn best() -> Self {
        if Self::Avx2.is_here() { Self::Avx2 } else { Self::Scalar }
    }
}
