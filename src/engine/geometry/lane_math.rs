//! Powers, angles and lengths without library calls, so that every instruction set, system and C
//! library gives the same bits; those without branches are vectorised in loops over lanes. What
//! calls std for them is refused by clippy (`clippy.toml`). After fdlibm (Sun Microsystems,
//! 1993: `e_pow.c`, `s_atan.c`), the source of the constants.

/// The upper 21 bits of a mantissa: products of two such numbers are exact.
const UPPER_BITS: u64 = 0xFFFF_FFFF_0000_0000;
const MANTISSA_BITS: u64 = 0x000F_FFFF_FFFF_FFFF;
const BITS_OF_ONE: u64 = 0x3FF0_0000_0000_0000;
/// 2^52 and 1.5 * 2^52: the lowest bits of `2^52 + n` are the integer n, and adding the second
/// rounds to an integer.
const TWO_52: f64 = 4_503_599_627_370_496.0;
const ROUNDING_SUMMAND: f64 = 1.5 * TWO_52;

#[inline(always)]
fn upper(x: f64) -> f64 {
    f64::from_bits(x.to_bits() & UPPER_BITS)
}

/// `x^y` to 1 ulp for 0 <= x <= 2 and 0 <= y <= 8, and for larger x while the power is below 2^64;
/// 0 if x or the power is below the normal numbers.
#[inline(always)]
pub(crate) fn pow(x: f64, y: f64) -> f64 {
    let (log, tail) = log2(x);
    // y * (log + tail) as an exact product and a remainder.
    let y_upper = upper(y);
    let rest = (y - y_upper) * log + y * tail;
    let product = y_upper * log;
    let power = exp2(product, rest);
    if x < f64::MIN_POSITIVE || product < -1021.0 {
        0.0
    } else {
        power
    }
}

/// The natural logarithm to 2^-53 relative to the larger of it and 1, for positive normal numbers;
/// finite for 0 and subnormal ones.
#[inline(always)]
pub(crate) fn ln(x: f64) -> f64 {
    let (log, tail) = log2(x);
    (log + tail) * std::f64::consts::LN_2
}

/// [`ln`] in less than half the time, to 2^-50 relative to the larger of it and 1.
#[inline(always)]
pub(crate) fn quick_ln(x: f64) -> f64 {
    const LN_1_5: f64 = 0.405_465_108_108_164_4;
    let (a, n, is_middle) = reduced(x);
    let (beside, log) = if is_middle { (1.5, LN_1_5) } else { (1.0, 0.0) };
    let s = (a - beside) / (a + beside);
    let s2 = s * s;
    ((2.0 / 3.0) * (s * (3.0 + s2 + log_series(s2))) + log) + n * std::f64::consts::LN_2
}

/// `x = 2^n a`, where a differs from 1, or from 1.5 if it is in the middle, by a factor of less
/// than sqrt(1.5).
#[inline(always)]
fn reduced(x: f64) -> (f64, f64, bool) {
    let bits = x.to_bits();
    let mantissa = f64::from_bits(bits & MANTISSA_BITS | BITS_OF_ONE);
    let exponent = f64::from_bits(bits >> 52 | TWO_52.to_bits()) - (TWO_52 + 1023.0);
    let high = mantissa >= 1.732_050_807_568_877_2;
    let middle = mantissa >= 1.224_744_871_391_589 && !high;
    let a = if high { 0.5 * mantissa } else { mantissa };
    let n = if high { exponent + 1.0 } else { exponent };
    (a, n, middle)
}

/// Of `3/2 ln((1 + s) / (1 - s)) = 3 s + s^3 + ...` what follows, divided by s.
#[inline(always)]
fn log_series(s2: f64) -> f64 {
    const L: [f64; 6] = [
        0.599_999_999_999_994_6,
        0.428_571_428_578_550_2,
        0.333_333_329_818_377_4,
        0.272_728_123_808_534,
        0.230_660_745_775_561_75,
        0.206_975_017_800_338_42,
    ];
    s2 * s2 * (L[0] + s2 * (L[1] + s2 * (L[2] + s2 * (L[3] + s2 * (L[4] + s2 * L[5])))))
}

/// log2 as a number of 21 bits and a remainder, together accurate to 2^-65 relative to the larger
/// of the result and 1.
#[inline(always)]
fn log2(x: f64) -> (f64, f64) {
    /// 2 / (3 ln 2), and its two parts.
    const CP: f64 = 0.961_796_693_925_975_6;
    const CP_UPPER: f64 = 0.961_796_700_954_437_3;
    const CP_REST: f64 = -7.028_461_650_952_758e-9;
    /// log2(1.5) in two parts.
    const LOG_UPPER: f64 = 0.584_962_487_220_764_2;
    const LOG_REST: f64 = 1.350_039_202_129_749e-8;

    let (a, n, middle) = reduced(x);
    let beside = if middle { 1.5 } else { 1.0 };
    let log_upper = if middle { LOG_UPPER } else { 0.0 };
    let log_rest = if middle { LOG_REST } else { 0.0 };

    // s = (a - beside) / (a + beside) in two parts.
    let u = a - beside;
    let v = 1.0 / (a + beside);
    let s = u * v;
    let s_upper = upper(s);
    let sum_upper = upper(a + beside);
    let sum_rest = a - (sum_upper - beside);
    let s_rest = v * ((u - s_upper * sum_upper) - s_upper * sum_rest);

    // 3/2 ln(a / beside) = 3 s + s^3 + ...
    let s2 = s * s;
    let series = log_series(s2) + s_rest * (s_upper + s);
    let s2 = s_upper * s_upper;
    let t_upper = upper(3.0 + s2 + series);
    let t_rest = series - ((t_upper - 3.0) - s2);
    let u = s_upper * t_upper;
    let v = s_rest * t_upper + t_rest * s;
    let p_upper = upper(u + v);
    let p_rest = v - (p_upper - u);
    let z_upper = CP_UPPER * p_upper;
    let z_rest = CP_REST * p_upper + p_rest * CP + log_rest;
    let log = upper(((z_upper + z_rest) + log_upper) + n);
    (log, z_rest - (((log - n) - log_upper) - z_upper))
}

/// `2^(p + rest)` for p above the exponents of subnormal numbers, |rest| small.
#[inline(always)]
fn exp2(p: f64, rest: f64) -> f64 {
    const P: [f64; 5] = [
        0.166_666_666_666_666_02,
        -0.002_777_777_777_701_559_3,
        6.613_756_321_437_934e-5,
        -1.653_390_220_546_525_2e-6,
        4.138_136_797_057_238_5e-8,
    ];
    /// ln 2 and its two parts.
    const LN2: f64 = std::f64::consts::LN_2;
    const LN2_UPPER: f64 = 0.693_147_182_464_599_6;
    const LN2_REST: f64 = -1.904_654_299_957_768e-9;

    let shifted = (p + rest) + ROUNDING_SUMMAND;
    let p = p - (shifted - ROUNDING_SUMMAND);
    let t = upper(p + rest);
    let u = t * LN2_UPPER;
    let v = (rest - (t - p)) * LN2 + t * LN2_REST;
    let z = u + v;
    let w = v - (z - u);
    let t = z * z;
    let t = z - t * (P[0] + t * (P[1] + t * (P[2] + t * (P[3] + t * P[4]))));
    let r = (z * t) / (t - 2.0) - (w + z * w);
    let fraction = 1.0 - (r - z);
    f64::from_bits(fraction.to_bits().wrapping_add(shifted.to_bits() << 52))
}

/// The length of `(x, y)` to 1 ulp, also where its square is no normal number.
#[inline]
pub(crate) fn hypot(x: f64, y: f64) -> f64 {
    /// 2^600: squares of what is multiplied or divided by it are normal numbers.
    const SCALE: f64 = f64::from_bits((1023 + 600) << 52);
    let square = |x: f64, y: f64| x * x + y * y;
    let plain = square(x, y);
    if (1e-290..1e300).contains(&plain) {
        plain.sqrt()
    } else if plain < 1.0 {
        square(x * SCALE, y * SCALE).sqrt() / SCALE
    } else {
        square(x / SCALE, y / SCALE).sqrt() * SCALE
    }
}

/// The angle of `(x, y)` for y >= 0, in [0, pi], to 1 ulp of itself.
#[inline(always)]
pub(crate) fn angle(y: f64, x: f64) -> f64 {
    let arc = Arc::new(y, x);
    let q = arc.over / arc.under;
    let z = q * q;
    // A[0] + z (A[1] + z (A[2] + ...)); written out, the formatter takes 20 s for it.
    let [first @ .., last] = ARC;
    let series = z * first.iter().rev().fold(last, |sum, a| a + z * sum);
    arc.whole(q - q * series)
}

/// An angle in [0, pi], reduced to [-pi/8, pi/8]: that of `(under, over)`.
#[derive(Clone, Copy)]
pub(crate) struct Arc {
    pub(crate) over: f64,
    pub(crate) under: f64,
    steep: bool,
    turned: bool,
    behind: bool,
}

impl Arc {
    #[inline(always)]
    pub(crate) fn new(y: f64, x: f64) -> Self {
        let across = x.abs();
        // Reduces to [0, pi/4] by the diagonal, then to [-pi/8, pi/8] by a rotation of pi/4.
        let steep = y > across;
        let (small, large) = if steep { (across, y) } else { (y, across) };
        let turned = small > 0.414_213_562_373_095_03 * large;
        let (over, under) = if turned {
            (small - large, small + large)
        } else {
            (small, large)
        };
        Self {
            over,
            under,
            steep,
            turned,
            behind: x < 0.0,
        }
    }

    /// The whole of a reduced angle.
    #[inline(always)]
    fn whole(self, reduced: f64) -> f64 {
        use std::f64::consts::{FRAC_PI_2, FRAC_PI_4, PI};
        let octant = if self.turned {
            FRAC_PI_4 + reduced
        } else {
            reduced
        };
        let quadrant = if self.steep {
            FRAC_PI_2 - octant
        } else {
            octant
        };
        if self.behind { PI - quadrant } else { quadrant }
    }

    /// The multiple of pi/4 to which the angle of `over / under` is added, with the sign of that.
    #[inline(always)]
    pub(crate) fn base(self) -> (f64, f64) {
        use std::f64::consts::{FRAC_PI_2, FRAC_PI_4, PI};
        let octant = if self.turned { FRAC_PI_4 } else { 0.0 };
        let quadrant = if self.steep {
            FRAC_PI_2 - octant
        } else {
            octant
        };
        let base = if self.behind { PI - quadrant } else { quadrant };
        (base, if self.steep == self.behind { 1.0 } else { -1.0 })
    }
}

/// `(1 - atan(q) / q) / q^2` for `z = q^2` up to tan(pi/8)^2: half as many operations as in
/// [`angle`] wait for each other.
#[inline(always)]
pub(crate) fn arc_remainder(z: f64) -> f64 {
    let (z2, z4) = (z * z, (z * z) * (z * z));
    let first = (ARC[0] + z * ARC[1]) + z2 * (ARC[2] + z * ARC[3]);
    let second = (ARC[4] + z * ARC[5]) + z2 * (ARC[6] + z * ARC[7]);
    let last = (ARC[8] + z * ARC[9]) + z2 * ARC[10];
    first + z4 * (second + z4 * last)
}

/// Those of `1 - atan(q) / q` in `z = q^2`, from z on.
const ARC: [f64; 11] = [
    0.333_333_333_333_329_3,
    -0.199_999_999_998_764_83,
    0.142_857_142_725_034_66,
    -0.111_111_104_054_623_56,
    0.090_908_871_334_365_07,
    -0.076_918_762_050_448_3,
    0.066_610_731_373_875_31,
    -0.058_335_701_337_905_73,
    0.049_768_779_946_159_32,
    -0.036_531_572_744_216_916,
    0.016_285_820_115_365_782,
];

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn lengths_and_half_angles_are_those_of_the_library() {
        use crate::geometry::Vec2;
        for k in 0..4000 {
            let phi = 0.001_57 * f64::from(k - 2000);
            for scale in [1e-300, 1e-160, 1e-9, 1.0, 3.3e7, 1e160, 1e300] {
                let (x, y) = (phi.cos() * scale, phi.sin() * scale);
                let allowed = if scale < 1e-290 { 2 } else { 1 };
                assert!(ulps(hypot(x, y), x.hypot(y)) <= allowed, "{x:e} {y:e}");
                let half = Vec2::new(x, y).half_angle();
                let off = half - Vec2::new((0.5 * phi).cos(), (0.5 * phi).sin());
                assert!(off.norm() < 1e-15, "{phi} {scale:e}");
            }
        }
        assert_eq!((hypot(0.0, 0.0), hypot(-3.0, 4.0)), (0.0, 5.0));
        assert_eq!(hypot(f64::INFINITY, 1.0), f64::INFINITY);
        assert_eq!(Vec2::ZERO.half_angle(), Vec2::new(1.0, 0.0));
        assert_eq!(Vec2::new(-2.0, 0.0).half_angle(), Vec2::new(0.0, 1.0));
    }

    #[test]
    fn powers_of_long_lengths_are_within_an_ulp_of_the_library() {
        for k in 1..4000 {
            let x = 1.01_f64.powi(k % 1500) * (1.0 + 1e-3 * f64::from(k % 7));
            for y in [0.0, 0.3, 1.0 / 2.4, 0.999, 1.0, 2.4] {
                assert!(ulps(pow(x, y), x.powf(y)) <= 1, "{x}^{y}");
            }
        }
    }

    fn ulps(a: f64, b: f64) -> u64 {
        a.to_bits().abs_diff(b.to_bits())
    }

    #[test]
    fn pow_is_within_an_ulp_of_the_library() {
        let mut state = 7u64;
        for _ in 0..200_000 {
            state = state
                .wrapping_mul(6_364_136_223_846_793_005)
                .wrapping_add(1_442_695_040_888_963_407);
            let x = f64::from_bits((state >> 12) | BITS_OF_ONE) - 1.0;
            let x = if state & 1 == 0 {
                x
            } else {
                x.powi((state >> 1 & 31) as i32 + 1)
            };
            let y = 0.05 + 7.95 * (state >> 40) as f64 / f64::from(1 << 24);
            assert!(
                ulps(pow(x, y), x.powf(y)) <= 1 || x.powf(y) < 1e-300,
                "{x:e}^{y}: {:e}, {:e}",
                pow(x, y),
                x.powf(y)
            );
        }
        for y in [0.1, 0.5, 1.0, 1.3, 3.0, 8.0] {
            assert_eq!(pow(1.0, y), 1.0);
            assert_eq!(pow(0.0, y), 0.0);
            assert!(ulps(pow(1.0 - f64::EPSILON, y), (1.0 - f64::EPSILON).powf(y)) <= 1);
            assert!(ulps(pow(1.0 + f64::EPSILON, y), (1.0 + f64::EPSILON).powf(y)) <= 1);
        }
        assert_eq!(pow(1e-200, 8.0), 0.0);
        assert_eq!(pow(0.25, 0.5), 0.5);
    }

    #[test]
    fn ln_is_that_of_the_library() {
        for k in -3000..3000 {
            let x = 1.1f64.powi(k) * (1.0 + 1e-3 * f64::from(k % 7));
            for (log, off) in [(ln(x), 3e-16), (quick_ln(x), 9e-16)] {
                assert!(
                    (log - x.ln()).abs() <= off * x.ln().abs().max(1.0),
                    "{x:e}: {log:e}, {:e}",
                    x.ln()
                );
            }
        }
        assert_eq!((ln(1.0), quick_ln(1.0)), (0.0, 0.0));
        for log in [ln, quick_ln] {
            assert!(log(0.0).is_finite() && log(5e-324).is_finite());
        }
    }

    #[test]
    fn angle_is_that_of_the_library() {
        assert_eq!(angle(0.0, 1.0), 0.0);
        assert_eq!(angle(0.0, -1.0), std::f64::consts::PI);
        for k in 0..100_000 {
            let phi = std::f64::consts::PI * f64::from(k) / 1e5;
            let scale = 10f64.powi(k % 17 - 8);
            let (y, x) = (phi.sin() * scale, phi.cos() * scale);
            assert!(
                ulps(angle(y, x), y.atan2(x)) <= 2,
                "{y:e}, {x:e}: {:e}, {:e}",
                angle(y, x),
                y.atan2(x)
            );
            {
                let arc = Arc::new(y, x);
                let ((base, sign), q) = (arc.base(), arc.over / arc.under);
                let quick = base + sign * (q - q * (q * q * arc_remainder(q * q)));
                assert!(ulps(quick, y.atan2(x)) <= 2, "{y:e}, {x:e}: {quick:e}");
            }
        }
        for y in [1e-300, 1e-20, 1e-3] {
            assert!(ulps(angle(y, 1.0), y.atan2(1.0)) <= 1);
        }
    }
}
