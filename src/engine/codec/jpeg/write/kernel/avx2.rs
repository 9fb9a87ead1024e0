//! 16 lanes: two blocks side by side.

use std::arch::x86_64::*;

use super::x86::lanes;
use crate::codec::jpeg::write::coder::{
    BlockPlace, Blocks, CoefficientCodes, Predictors, QuantisedBlock, ScanWriter,
};
use crate::codec::jpeg::write::lanes::{I16Lanes, MOST_LANES, Quantiser};
use crate::codec::jpeg::write::strip::{self, Job};
use crate::codec::jpeg::write::tables::{BLOCK, SIDE, ZIGZAG};

/// Must be called where [`crate::level::SimdLevel::Avx2`] is supported.
pub(super) fn encode(job: &Job<'_>, out: &mut Vec<u8>, wanted: &dyn Fn() -> bool) {
    // SAFETY: the one caller asks `SimdLevel::is_supported` first.
    unsafe { wide(job, out, wanted) }
}

#[target_feature(enable = "avx2,bmi1,bmi2,lzcnt")]
fn wide(job: &Job<'_>, out: &mut Vec<u8>, wanted: &dyn Fn() -> bool) {
    strip::encode::<Avx2Lanes>(job, out, wanted);
}

/// A function of its own, because a longer one has too few registers.
#[inline(never)]
#[target_feature(enable = "bmi1,bmi2,lzcnt")]
fn code(
    bits: &mut ScanWriter,
    blocks: &Blocks,
    order: &[BlockPlace],
    codes: &[CoefficientCodes; 2],
    last: &mut Predictors,
    out: &mut Vec<u8>,
) {
    bits.put_group(blocks, order, codes, last, out);
}

/// Made by `wide` only.
#[derive(Clone, Copy)]
struct Avx2Lanes(__m256i);

impl Avx2Lanes {
    /// The samples of one channel, times 257; a pixel has three bytes.
    #[inline(always)]
    unsafe fn third<const CHANNEL: usize>(first: __m256i, last: __m256i) -> Self {
        // SAFETY: as for `I16Lanes`.
        unsafe {
            let [low, high] = &PLACES[CHANNEL];
            let low = _mm256_broadcastsi128_si256(_mm_loadu_si128(low.as_ptr().cast()));
            let high = _mm256_broadcastsi128_si256(_mm_loadu_si128(high.as_ptr().cast()));
            Self(_mm256_or_si256(
                _mm256_shuffle_epi8(first, low),
                _mm256_shuffle_epi8(last, high),
            ))
        }
    }

    /// Samples of pixels of four bytes: `first` has the pixels 0 to 3 and 8 to 11, `second` the
    /// others.
    #[inline(always)]
    unsafe fn channel<const SHIFT: i32>(first: __m256i, second: __m256i) -> Self {
        // SAFETY: as for `I16Lanes`.
        unsafe {
            let low = _mm256_set1_epi32(255);
            Self(_mm256_packus_epi32(
                _mm256_and_si256(_mm256_srli_epi32::<SHIFT>(first), low),
                _mm256_and_si256(_mm256_srli_epi32::<SHIFT>(second), low),
            ))
        }
    }
}

/// The bytes of a channel of eight pixels, each twice, from their first 16 bytes and their last.
const fn places(channel: u8) -> [[u8; 16]; 2] {
    let mut places = [[0x80; 16]; 2];
    let mut k = 0;
    while k < 8 {
        let at = 3 * k + channel;
        let (half, at) = if at < 16 { (0, at) } else { (1, at - 8) };
        places[half][2 * k as usize] = at;
        places[half][2 * k as usize + 1] = at;
        k += 1;
    }
    places
}

static PLACES: [[[u8; 16]; 2]; 3] = [places(0), places(1), places(2)];

/// 16 bytes at a place.
#[inline(always)]
unsafe fn sixteen(bytes: &[u8], at: usize) -> __m128i {
    let bytes: &[u8; 16] = bytes[at..].first_chunk().expect("16 bytes");
    // SAFETY: as for `I16Lanes`; the reference has 16 bytes.
    unsafe { _mm_loadu_si128(bytes.as_ptr().cast()) }
}

/// 16 bytes at each of two places.
#[inline(always)]
unsafe fn two(bytes: &[u8], first: usize, second: usize) -> __m256i {
    // SAFETY: as for `I16Lanes`.
    unsafe {
        _mm256_inserti128_si256::<1>(
            _mm256_castsi128_si256(sixteen(bytes, first)),
            sixteen(bytes, second),
        )
    }
}

/// For every eight coefficients in the order of a file, by column of the block: the bytes of the
/// column that go there.
static SHUFFLES: [[[u8; 2 * SIDE]; SIDE]; SIDE] = shuffles();

const fn shuffles() -> [[[u8; 2 * SIDE]; SIDE]; SIDE] {
    /// Gives zero.
    const NOTHING: u8 = 0x80;
    let mut shuffles = [[[NOTHING; 2 * SIDE]; SIDE]; SIDE];
    let mut k = 0;
    while k < BLOCK {
        let (x, y) = (ZIGZAG[k] as usize % SIDE, ZIGZAG[k] / 8);
        shuffles[k / SIDE][x][k % SIDE * 2] = 2 * y;
        shuffles[k / SIDE][x][k % SIDE * 2 + 1] = 2 * y + 1;
        k += 1;
    }
    shuffles
}

/// For every eight coefficients, by column: whether it has some of them.
const HAS_COEFFICIENTS: [[bool; SIDE]; SIDE] = {
    let mut has = [[false; SIDE]; SIDE];
    let mut k = 0;
    while k < BLOCK {
        has[k / SIDE][ZIGZAG[k] as usize % SIDE] = true;
        k += 1;
    }
    has
};

impl Avx2Lanes {
    /// Coefficients `8 K` to `8 K + 7` in the order of a file.
    #[inline(always)]
    fn eight<const K: usize>(columns: &[Self; 8]) -> __m256i {
        // SAFETY: `encode` alone uses this type, where the processor has the level.
        unsafe {
            let mut joined = _mm256_setzero_si256();
            for (x, column) in columns.iter().enumerate() {
                if HAS_COEFFICIENTS[K][x] {
                    let order = _mm256_broadcastsi128_si256(_mm_loadu_si128(
                        SHUFFLES[K][x].as_ptr().cast(),
                    ));
                    joined = _mm256_or_si256(joined, _mm256_shuffle_epi8(column.0, order));
                }
            }
            joined
        }
    }

    #[inline(always)]
    fn in_order(columns: &[Self; 8]) -> [__m256i; 8] {
        [
            Self::eight::<0>(columns),
            Self::eight::<1>(columns),
            Self::eight::<2>(columns),
            Self::eight::<3>(columns),
            Self::eight::<4>(columns),
            Self::eight::<5>(columns),
            Self::eight::<6>(columns),
            Self::eight::<7>(columns),
        ]
    }
}

lanes! {
    Avx2Lanes(__m256i), 16, set: _mm256_set1_epi16, load: _mm256_loadu_si256, add: _mm256_add_epi16,
    sub: _mm256_sub_epi16, times: _mm256_mulhrs_epi16, high: _mm256_mulhi_epu16,
    mean: _mm256_avg_epu16, low: _mm256_mullo_epi16, left: _mm256_sll_epi16,
        right: _mm256_srl_epi16,
    unpack: [_mm256_unpacklo_epi16, _mm256_unpackhi_epi16, _mm256_unpacklo_epi32,
    _mm256_unpackhi_epi32, _mm256_unpacklo_epi64, _mm256_unpackhi_epi64],
    own: {
        #[inline(always)]
        fn code(bits: &mut ScanWriter, blocks: &Blocks, order: &[BlockPlace],
            codes: &[CoefficientCodes; 2],
            last: &mut Predictors, out: &mut Vec<u8>) {
            unsafe { code(bits, blocks, order, codes, last, out) }
        }

        #[inline(always)]
        fn pixels_1(pixels: &[u8]) -> Self {
            unsafe { Self(_mm256_cvtepu8_epi16(sixteen(pixels, 0))) }
        }

        #[inline(always)]
        fn pixels_2(pixels: &[u8]) -> [Self; 2] {
            unsafe {
                let pixels = two(pixels, 0, 16);
                [Self(_mm256_and_si256(pixels, _mm256_set1_epi16(255))),
                    Self(_mm256_srli_epi16::<8>(pixels))]
            }
        }

        #[inline(always)]
        fn pixels_3(pixels: &[u8]) -> [Self; 3] {
            unsafe {
                // Pixels 0 to 7 and 8 to 15: their first 16 bytes, and their last, of which the
                // first 8 are the same.
                let (first, last) = (two(pixels, 0, 24), two(pixels, 8, 32));
                [Self::third::<0>(first, last), Self::third::<1>(first, last),
                    Self::third::<2>(first, last)]
            }
        }

        #[inline(always)]
        fn pixels_4(pixels: &[u8]) -> [Self; 4] {
            unsafe {
                let (first, second) = (two(pixels, 0, 32), two(pixels, 16, 48));
                [
                    Self::channel::<0>(first, second),
                    Self::channel::<8>(first, second),
                    Self::channel::<16>(first, second),
                    Self::channel::<24>(first, second),
                ]
            }
        }

        #[inline(always)]
        fn sums_of_pairs(self, other: Self) -> Self {
            unsafe { Self(_mm256_permute4x64_epi64::<0b11_01_10_00>(
                _mm256_hadd_epi16(self.0, other.0))) }
        }

        #[inline(always)]
        fn store(columns: [Self; 8], blocks: &mut [QuantisedBlock]) {
            let [first, second, ..] = blocks else { unreachable!("blocks of all lanes") };
            let eights = Self::in_order(&columns);
            unsafe {
                (first.nonzero, second.nonzero) = (0, 0);
                // But for the first coefficients, which may have any value.
                let mut far = 0;
                for half in (0..8).step_by(2) {
                    let packed = _mm256_packs_epi16(eights[half], eights[half + 1]);
                    let bits = !_mm256_movemask_epi8(_mm256_cmpeq_epi8(packed,
                        _mm256_setzero_si256())).cast_unsigned();
                    first.nonzero |= u64::from(bits & 0xffff) << (8 * half);
                    second.nonzero |= u64::from(bits >> 16) << (8 * half);
                    far |= _mm256_movemask_epi8(_mm256_add_epi8(packed,
                        _mm256_set1_epi8(64))) & if half == 0 { !0x1_0001 } else { !0 };
                }
                let far = far.cast_unsigned();
                (first.is_near, second.is_near) = (far & 0xffff == 0, far >> 16 == 0);
                for (k, eight) in eights.into_iter().enumerate() {
                    _mm_storeu_si128(first.eight(k).as_mut_ptr().cast(),
                        _mm256_castsi256_si128(eight));
                    _mm_storeu_si128(second.eight(k).as_mut_ptr().cast(),
                        _mm256_extracti128_si256::<1>(eight));
                }
            }
        }
    }
}
