//! 32 lanes: four blocks side by side.

use std::arch::x86_64::*;

use super::x86::{SHUFFLES, lanes};
use super::{Lanes, MOST_LANES};
use crate::codec::jpeg::write::coder::Block;
use crate::codec::jpeg::write::strip::{self, Job};

/// Must be called where [`crate::level::Level::Avx512`] is here.
pub(super) fn encode(job: &Job<'_>, out: &mut Vec<u8>, wanted: &dyn Fn() -> bool) {
    // SAFETY: the one caller asks `Level::is_here` first.
    unsafe { wide(job, out, wanted) }
}

#[target_feature(enable = "avx2,bmi1,bmi2,lzcnt,avx512f,avx512bw,avx512dq,avx512vl,avx512vbmi")]
fn wide(job: &Job<'_>, out: &mut Vec<u8>, wanted: &dyn Fn() -> bool) {
    strip::encode::<Avx512>(job, out, wanted);
}

/// Made by `wide` only.
#[derive(Clone, Copy)]
struct Avx512(__m512i);

/// Every second byte, from the first or the second on.
const LOW: u64 = 0x5555_5555_5555_5555;
const HIGH: u64 = LOW << 1;

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
        // SAFETY: as for `Lanes`.
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
    // SAFETY: as for `Lanes`; the reference has 64 bytes.
    unsafe { _mm512_loadu_si512(bytes.as_ptr().cast()) }
}

/// 32 bytes at a place.
#[inline(always)]
unsafe fn thirty_two(bytes: &[u8], at: usize) -> __m256i {
    let bytes: &[u8; 32] = bytes[at..].first_chunk().expect("32 bytes");
    // SAFETY: as for `Lanes`; the reference has 32 bytes.
    unsafe { _mm256_loadu_si256(bytes.as_ptr().cast()) }
}

lanes! {
    Avx512(__m512i), 32, set: _mm512_set1_epi16, load: _mm512_loadu_si512, zero: _mm512_setzero_si512, add: _mm512_add_epi16, saturate: _mm512_adds_epi16,
    sub: _mm512_sub_epi16, times: _mm512_mulhrs_epi16, high: _mm512_mulhi_epu16,
    mean: _mm512_avg_epu16, low: _mm512_mullo_epi16, left: _mm512_sll_epi16, right: _mm512_srl_epi16,
    or: _mm512_or_si512, shuffle: _mm512_shuffle_epi8, row: _mm512_broadcast_i32x4,
    unpack: [_mm512_unpacklo_epi16, _mm512_unpackhi_epi16, _mm512_unpacklo_epi32, _mm512_unpackhi_epi32, _mm512_unpacklo_epi64, _mm512_unpackhi_epi64],
    own: {
        #[inline(always)]
        fn pixels_1(pixels: &[u8]) -> Self {
            unsafe { Self(_mm512_cvtepu8_epi16(thirty_two(pixels, 0))) }
        }

        #[inline(always)]
        fn pixels_2(pixels: &[u8]) -> [Self; 2] {
            unsafe {
                let pixels = sixty_four(pixels, 0);
                [Self(_mm512_and_si512(pixels, _mm512_set1_epi16(255))), Self(_mm512_srli_epi16::<8>(pixels))]
            }
        }

        #[inline(always)]
        fn pixels_3(pixels: &[u8]) -> [Self; 3] {
            unsafe {
                let (first, second) = (sixty_four(pixels, 0), _mm512_castsi256_si512(thirty_two(pixels, 64)));
                let [r, g, b] = &PLACES_3;
                [Self::channel::<HIGH>(first, second, r), Self::channel::<HIGH>(first, second, g), Self::channel::<HIGH>(first, second, b)]
            }
        }

        #[inline(always)]
        fn pixels_4(pixels: &[u8]) -> [Self; 4] {
            unsafe {
                let (first, second) = (sixty_four(pixels, 0), sixty_four(pixels, 64));
                let [r, g, b, a] = &PLACES_4;
                [
                    Self::channel::<LOW>(first, second, r),
                    Self::channel::<LOW>(first, second, g),
                    Self::channel::<LOW>(first, second, b),
                    Self::channel::<LOW>(first, second, a),
                ]
            }
        }

        #[inline(always)]
        fn sums_of_pairs(self, other: Self) -> Self {
            unsafe {
                let ones = _mm512_set1_epi16(1);
                let sums = _mm512_packs_epi32(_mm512_madd_epi16(self.0, ones), _mm512_madd_epi16(other.0, ones));
                Self(_mm512_permutexvar_epi64(_mm512_setr_epi64(0, 2, 4, 6, 1, 3, 5, 7), sums))
            }
        }

        #[inline(always)]
        fn store(columns: [Self; 8], blocks: &mut [Block]) {
            let [a, b, c, d, ..] = blocks else { unreachable!("blocks of all lanes") };
            let groups = Self::in_order(&columns);
            unsafe {
                (a.nonzero, b.nonzero, c.nonzero, d.nonzero) = (0, 0, 0, 0);
                for half in (0..8).step_by(2) {
                    let packed = _mm512_packs_epi16(groups[half], groups[half + 1]);
                    let bits = _mm512_test_epi8_mask(packed, packed);
                    a.nonzero |= (bits & 0xffff) << (8 * half);
                    b.nonzero |= (bits >> 16 & 0xffff) << (8 * half);
                    c.nonzero |= (bits >> 32 & 0xffff) << (8 * half);
                    d.nonzero |= (bits >> 48) << (8 * half);
                }
                for (k, group) in groups.into_iter().enumerate() {
                    _mm_storeu_si128(a.group(k).as_mut_ptr().cast(), _mm512_castsi512_si128(group));
                    _mm_storeu_si128(b.group(k).as_mut_ptr().cast(), _mm512_extracti32x4_epi32::<1>(group));
                    _mm_storeu_si128(c.group(k).as_mut_ptr().cast(), _mm512_extracti32x4_epi32::<2>(group));
                    _mm_storeu_si128(d.group(k).as_mut_ptr().cast(), _mm512_extracti32x4_epi32::<3>(group));
                }
            }
        }
    }
}
