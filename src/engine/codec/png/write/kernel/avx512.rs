//! The fast strip for AVX-512 with VBMI: looks up 64 residuals at once in registers (`vpermi2b`),
//! and joins their codes in lanes that grow from 16 to 64 bits, so that usually eight codes go to
//! one store. The same bits as the portable coder.

use std::arch::x86_64::*;

use super::super::coder::{CodeBuffer, Lookup, Single, Staged, Tables, code, code_piece, length};
use super::super::fast;
use super::super::rows::StripRows;
use crate::codec::bits::BitWriter;

/// Must be called where [`crate::level::SimdLevel::Avx512`] is supported.
pub(super) fn fast(rows: StripRows<'_>, last: bool, most: usize, out: &mut Vec<u8>) -> Option<u32> {
    // SAFETY: the one caller asks `SimdLevel::is_supported` first, which covers every feature.
    unsafe { fast_avx512(rows, last, most, out) }
}

#[target_feature(enable = "avx2,bmi1,bmi2,lzcnt,avx512f,avx512bw,avx512dq,avx512vl,avx512vbmi")]
fn fast_avx512(rows: StripRows<'_>, last: bool, most: usize, out: &mut Vec<u8>) -> Option<u32> {
    fast::body::<Registers>(rows, last, most, out)
}

/// Looks codes up in registers.
struct Registers;

impl fast::FastKernel for Registers {
    #[inline(always)]
    fn code(single: &Single, coder: fast::RowCoder<'_>) -> Option<u32> {
        coder.code::<Self>(&Wide::new(single))
    }

    #[inline(always)]
    fn piece<L: Lookup>(
        piece: &[u8],
        tables: Tables<'_, L>,
        stage: &mut CodeBuffer,
        bits: &mut BitWriter,
        out: &mut Vec<u8>,
    ) {
        code_piece(piece, tables, stage, bits, out);
    }
}

/// Bits of a code in a 16-bit lane; its length is above.
const CODE_BITS: u32 = 12;
/// Most bits of eight codes that go to one store.
const MAX_STORED_BITS: i64 = 56;

/// The codes of all bytes, `length << 12 | code`, split into low and high halves. Made by
/// `fast_avx512` only.
struct Wide<'a> {
    single: &'a Single,
    low: [u8; 256],
    high: [u8; 256],
}

impl<'a> Wide<'a> {
    #[inline(always)]
    fn new(single: &'a Single) -> Self {
        let (mut low, mut high) = ([0; 256], [0; 256]);
        for (byte, (low, high)) in (0..=u8::MAX).zip(low.iter_mut().zip(&mut high)) {
            let entry = single.one(byte);
            #[expect(
                clippy::cast_possible_truncation,
                reason = "codes and lengths are at most 12"
            )]
            let lane = code(entry) as u16 | (length(entry) << CODE_BITS) as u16;
            [*low, *high] = lane.to_le_bytes();
        }
        Self { single, low, high }
    }
}

impl Lookup for Wide<'_> {
    #[inline(always)]
    fn two(&self, bytes: u16) -> u32 {
        self.single.two(bytes)
    }

    #[inline(always)]
    fn many(&self, bytes: &[u8], bits: &mut Staged<'_>) -> usize {
        // SAFETY: a `Wide` is made and used inside `fast_avx512` only.
        unsafe { sixty_fours(self, bytes, bits) }
    }
}

/// Codes groups of eight bytes, 64 bytes at a time, up to the first that is all zero or the end;
/// returns the number of bytes.
#[target_feature(enable = "avx2,bmi1,bmi2,lzcnt,avx512f,avx512bw,avx512dq,avx512vl,avx512vbmi")]
fn sixty_fours(tables: &Wide<'_>, bytes: &[u8], bits: &mut Staged<'_>) -> usize {
    let load = |bytes: &[u8; 64]| {
        // SAFETY: 64 bytes are loaded from 64 bytes.
        unsafe { _mm512_loadu_si512(bytes.as_ptr().cast()) }
    };
    let quarters = |table: &[u8; 256]| {
        let (quarters, _) = table.as_chunks::<64>();
        [
            load(&quarters[0]),
            load(&quarters[1]),
            load(&quarters[2]),
            load(&quarters[3]),
        ]
    };
    let (low, high) = (quarters(&tables.low), quarters(&tables.high));
    // In registers: through the reference each code would wait for the previous one's store.
    let (mut own, mut done) = (bits.lend(), 0);
    let (blocks, rest) = bytes.as_chunks::<64>();
    // The rest is one more block, padded with zeros.
    let whole = (1 << (rest.len() & !7)) - 1;
    // SAFETY: only bytes that are there are loaded.
    let last = unsafe { _mm512_maskz_loadu_epi8(whole, rest.as_ptr().cast()) };
    for block in blocks.iter().map(load).chain(std::iter::once(last)) {
        let zeros = u32::from(_mm512_cmpeq_epi64_mask(block, _mm512_setzero_si512()));
        let upper = _mm512_movepi8_mask(block);
        let look_up = |[a, b, c, d]: [__m512i; 4]| {
            _mm512_mask_blend_epi8(
                upper,
                _mm512_permutex2var_epi8(a, block, b),
                _mm512_permutex2var_epi8(c, block, d),
            )
        };
        let (low, high) = (look_up(low), look_up(high));
        // The first and the last eight of every 16 bytes, four codes per lane.
        let ((first, first_length), (second, second_length)) = (
            fours(_mm512_unpacklo_epi8(low, high)),
            fours(_mm512_unpackhi_epi8(low, high)),
        );
        // First fours, then second fours of each eight, in order.
        let (fore, rear) = (
            _mm512_unpacklo_epi64(first, second),
            _mm512_unpackhi_epi64(first, second),
        );
        let fore_length = _mm512_unpacklo_epi64(first_length, second_length);
        let rear_length = _mm512_unpackhi_epi64(first_length, second_length);
        let lengths = _mm512_add_epi64(fore_length, rear_length);
        if zeros == 0 && _mm512_cmpgt_epi64_mask(lengths, _mm512_set1_epi64(MAX_STORED_BITS)) == 0 {
            done += 64;
            let codes = lanes(_mm512_or_si512(fore, _mm512_sllv_epi64(rear, fore_length)));
            for (code, length) in codes.into_iter().zip(lanes(lengths)) {
                put(&mut own, code, length);
            }
        } else {
            // Eights before the first that is all zero, or not there.
            let eights = (zeros | 1 << 8).trailing_zeros() as usize;
            done += 8 * eights;
            let (fore, rear) = (
                lanes(fore).into_iter().zip(lanes(fore_length)),
                lanes(rear).into_iter().zip(lanes(rear_length)),
            );
            for ((fore, fore_length), (rear, rear_length)) in fore.zip(rear).take(eights) {
                put(&mut own, fore, fore_length);
                put(&mut own, rear, rear_length);
            }
        }
        if zeros != 0 {
            break;
        }
    }
    let ended = own.ended();
    bits.go_on(ended);
    done
}

#[inline(always)]
fn put(bits: &mut Staged<'_>, code: u64, length: u64) {
    #[expect(clippy::cast_possible_truncation, reason = "at most 56")]
    bits.put(code, length as u32);
}

/// Four codes of 16-bit lanes in each 64-bit lane, the first lowest, and their length.
#[inline]
#[target_feature(enable = "avx512f")]
fn fours(lanes: __m512i) -> (__m512i, __m512i) {
    let code = _mm512_set1_epi32((1 << CODE_BITS) - 1);
    let (first, second) = (
        _mm512_and_si512(lanes, code),
        _mm512_and_si512(_mm512_srli_epi32::<16>(lanes), code),
    );
    let first_length =
        _mm512_and_si512(_mm512_srli_epi32::<CODE_BITS>(lanes), _mm512_set1_epi32(15));
    let lengths = _mm512_add_epi32(first_length, _mm512_srli_epi32::<{ 16 + CODE_BITS }>(lanes));
    let pairs = _mm512_or_si512(first, _mm512_sllv_epi32(second, first_length));
    let low = _mm512_set1_epi64(0xffff_ffff);
    let low_length = _mm512_and_si512(lengths, low);
    let fours = _mm512_or_si512(
        _mm512_and_si512(pairs, low),
        _mm512_sllv_epi64(_mm512_srli_epi64::<32>(pairs), low_length),
    );
    (
        fours,
        _mm512_add_epi64(low_length, _mm512_srli_epi64::<32>(lengths)),
    )
}

#[inline]
#[target_feature(enable = "avx512f")]
fn lanes(of: __m512i) -> [u64; 8] {
    let mut lanes = [0; 8];
    // SAFETY: 64 bytes are stored into 64 bytes.
    unsafe { _mm512_storeu_si512(lanes.as_mut_ptr().cast(), of) };
    lanes
}
