//! 32 lanes: four blocks side by side.

use std::arch::x86_64::*;

use super::x86::lanes;
use crate::codec::jpeg::write::coder::{
    BlockPlace, Blocks, CoefficientCodes, Predictors, QuantisedBlock, ScanWriter,
};
use crate::codec::jpeg::write::lanes::{I16Lanes, MOST_LANES, Quantiser};
use crate::codec::jpeg::write::strip::{self, Job};
use crate::codec::jpeg::write::tables::{BLOCK, ZIGZAG};

/// Must be called where [`crate::level::SimdLevel::Avx512`] is supported.
pub(super) fn encode(job: &Job<'_>, out: &mut Vec<u8>, wanted: &dyn Fn() -> bool) {
    // SAFETY: the one caller asks `SimdLevel::is_supported` first.
    unsafe { wide(job, out, wanted) }
}

#[target_feature(enable = "avx2,bmi1,bmi2,lzcnt,avx512f,avx512bw,avx512dq,avx512vl,avx512vbmi")]
fn wide(job: &Job<'_>, out: &mut Vec<u8>, wanted: &dyn Fn() -> bool) {
    strip::encode::<Avx512>(job, out, wanted);
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
struct Avx512(__m512i);

/// Every second byte.
const EVEN_BYTES: u64 = 0x5555_5555_5555_5555;

/// The bytes of a channel of 32 pixels, each twice.
const fn places(channels: u8, channel: u8) -> [u8; 64] {
    let mut places = [0; 64];
    let mut k = 0;
    while k < 32 {
        places[2 * k as usize] = channels * k + channel;
        places[2 * k as usize + 1] = channels * k + channel;
        k += 1;
    }
    places
}

static PLACES_3: [[u8; 64]; 3] = [places(3, 0), places(3, 1), places(3, 2)];
static PLACES_4: [[u8; 64]; 4] = [places(4, 0), places(4, 1), places(4, 2), places(4, 3)];

impl Avx512 {
    /// `MASK`: the bytes that are taken.
    #[inline(always)]
    unsafe fn channel<const MASK: u64>(first: __m512i, second: __m512i, places: &[u8; 64]) -> Self {
        // SAFETY: as for `I16Lanes`.
        unsafe {
            let places = _mm512_loadu_si512(places.as_ptr().cast());
            Self(_mm512_maskz_permutex2var_epi8(MASK, first, places, second))
        }
    }
}

/// 64 bytes at a place.
#[inline(always)]
unsafe fn sixty_four(bytes: &[u8], at: usize) -> __m512i {
    let bytes: &[u8; 64] = bytes[at..].first_chunk().expect("64 bytes");
    // SAFETY: as for `I16Lanes`; the reference has 64 bytes.
    unsafe { _mm512_loadu_si512(bytes.as_ptr().cast()) }
}

/// 32 bytes at a place.
#[inline(always)]
unsafe fn thirty_two(bytes: &[u8], at: usize) -> __m256i {
    let bytes: &[u8; 32] = bytes[at..].first_chunk().expect("32 bytes");
    // SAFETY: as for `I16Lanes`; the reference has 32 bytes.
    unsafe { _mm256_loadu_si256(bytes.as_ptr().cast()) }
}

/// The order of a file, in columns.
static FILE_ORDER: [[u16; 32]; 2] = order();

const fn order() -> [[u16; 32]; 2] {
    let mut order = [[0; 32]; 2];
    let mut k = 0;
    while k < BLOCK {
        order[k / 32][k % 32] = (ZIGZAG[k] % 8 * 8 + ZIGZAG[k] / 8) as u16;
        k += 1;
    }
    order
}

/// Four columns of each block from four columns of all blocks.
#[inline(always)]
fn by_block([a, b, c, d]: [Avx512; 4]) -> [__m512i; 4] {
    // SAFETY: as for `I16Lanes`.
    unsafe {
        let (ab, cd) = (
            _mm512_shuffle_i32x4::<0x44>(a.0, b.0),
            _mm512_shuffle_i32x4::<0x44>(c.0, d.0),
        );
        let (ab2, cd2) = (
            _mm512_shuffle_i32x4::<0xee>(a.0, b.0),
            _mm512_shuffle_i32x4::<0xee>(c.0, d.0),
        );
        [
            _mm512_shuffle_i32x4::<0x88>(ab, cd),
            _mm512_shuffle_i32x4::<0xdd>(ab, cd),
            _mm512_shuffle_i32x4::<0x88>(ab2, cd2),
            _mm512_shuffle_i32x4::<0xdd>(ab2, cd2),
        ]
    }
}

lanes! {
    Avx512(__m512i), 32, set: _mm512_set1_epi16, load: _mm512_loadu_si512, add: _mm512_add_epi16,
    sub: _mm512_sub_epi16, times: _mm512_mulhrs_epi16, high: _mm512_mulhi_epu16,
    mean: _mm512_avg_epu16, low: _mm512_mullo_epi16, left: _mm512_sll_epi16,
        right: _mm512_srl_epi16,
    unpack: [_mm512_unpacklo_epi16, _mm512_unpackhi_epi16, _mm512_unpacklo_epi32,
    _mm512_unpackhi_epi32, _mm512_unpacklo_epi64, _mm512_unpackhi_epi64],
    own: {
        #[inline(always)]
        fn code(bits: &mut ScanWriter, blocks: &Blocks, order: &[BlockPlace],
            codes: &[CoefficientCodes; 2],
            last: &mut Predictors, out: &mut Vec<u8>) {
            unsafe { code(bits, blocks, order, codes, last, out) }
        }

        #[inline(always)]
        fn pixels_1(pixels: &[u8]) -> Self {
            unsafe { Self(_mm512_cvtepu8_epi16(thirty_two(pixels, 0))) }
        }

        #[inline(always)]
        fn pixels_2(pixels: &[u8]) -> [Self; 2] {
            unsafe {
                let pixels = sixty_four(pixels, 0);
                [Self(_mm512_and_si512(pixels, _mm512_set1_epi16(255))),
                    Self(_mm512_srli_epi16::<8>(pixels))]
            }
        }

        #[inline(always)]
        fn pixels_3(pixels: &[u8]) -> [Self; 3] {
            unsafe {
                let (first, second) = (sixty_four(pixels, 0),
                    _mm512_castsi256_si512(thirty_two(pixels, 64)));
                let [r, g, b] = &PLACES_3;
                [Self::channel::<{ !0 }>(first, second, r), Self::channel::<{ !0 }>(first, second,
                    g), Self::channel::<{ !0 }>(first, second, b)]
            }
        }

        #[inline(always)]
        fn pixels_4(pixels: &[u8]) -> [Self; 4] {
            unsafe {
                let (first, second) = (sixty_four(pixels, 0), sixty_four(pixels, 64));
                let [r, g, b, a] = &PLACES_4;
                [
                    Self::channel::<EVEN_BYTES>(first, second, r),
                    Self::channel::<EVEN_BYTES>(first, second, g),
                    Self::channel::<EVEN_BYTES>(first, second, b),
                    Self::channel::<EVEN_BYTES>(first, second, a),
                ]
            }
        }

        #[inline(always)]
        fn sums_of_pairs(self, other: Self) -> Self {
            unsafe {
                let ones = _mm512_set1_epi16(1);
                let sums = _mm512_packs_epi32(_mm512_madd_epi16(self.0, ones),
                    _mm512_madd_epi16(other.0, ones));
                Self(_mm512_permutexvar_epi64(_mm512_setr_epi64(0, 2, 4, 6, 1, 3, 5, 7), sums))
            }
        }

        #[inline(always)]
        fn store(columns: [Self; 8], blocks: &mut [QuantisedBlock]) {
            let [c0, c1, c2, c3, c4, c5, c6, c7] = columns;
            let (left, right) = (by_block([c0, c1, c2, c3]), by_block([c4, c5, c6, c7]));
            for ((left, right), block) in left.into_iter().zip(right).zip(blocks) {
                unsafe {
                    let [first, second] = FILE_ORDER.each_ref().map(|places| {
                        _mm512_permutex2var_epi16(left, _mm512_loadu_si512(places.as_ptr().cast()),
                            right)
                    });
                    let (low, high) = (_mm512_test_epi16_mask(first, first),
                        _mm512_test_epi16_mask(second, second));
                    block.nonzero = u64::from(high) << 32 | u64::from(low);
                    // The first coefficient may have any value.
                    let packed = _mm512_packs_epi16(first, second);
                    block.is_near = _mm512_movepi8_mask(_mm512_add_epi8(packed,
                        _mm512_set1_epi8(64))) & !1 == 0;
                    let (halves, _) = block.coefficients.as_chunks_mut::<32>();
                    _mm512_storeu_si512(halves[0].as_mut_ptr().cast(), first);
                    _mm512_storeu_si512(halves[1].as_mut_ptr().cast(), second);
                }
            }
        }
    }
}
