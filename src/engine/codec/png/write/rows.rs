//! The rows of one strip and the PNG filters over them (PNG 3rd edition, section 9). Shapes:
//! samples `[rows][row_bytes]`, bytes in PNG order; `bpp` bytes per pixel. A filter writes
//! `x - prediction` modulo 256 for a part of a row, so that callers can work in pieces that stay in
//! the first-level cache. The encoder knows every neighbour, so the loops have no carried
//! dependencies and are vectorised. Strips are independent, so the first row of a strip has no row
//! above it here, although the decoder has one: it may only be filtered by `None` or `Sub`.

/// Samples of one strip.
#[derive(Clone, Copy, Debug)]
pub(super) struct StripRows<'a> {
    samples: &'a [u8],
    row_bytes: usize,
    bpp: usize,
}

impl<'a> StripRows<'a> {
    /// `samples` are whole rows, at least one; rows are whole pixels, at least one.
    pub(super) fn new(samples: &'a [u8], row_bytes: usize, bpp: usize) -> Self {
        assert!(
            !samples.is_empty()
                && samples.len().is_multiple_of(row_bytes)
                && row_bytes.is_multiple_of(bpp),
            "whole rows of whole pixels"
        );
        Self {
            samples,
            row_bytes,
            bpp,
        }
    }

    #[inline(always)]
    pub(super) const fn count(self) -> usize {
        self.samples.len() / self.row_bytes
    }

    #[inline(always)]
    pub(super) const fn row_bytes(self) -> usize {
        self.row_bytes
    }

    #[inline(always)]
    pub(super) const fn bpp(self) -> usize {
        self.bpp
    }

    /// Bytes with the filter byte of every row.
    #[inline(always)]
    pub(super) const fn filtered_len(self) -> usize {
        self.samples.len() + self.count()
    }

    pub(super) fn iter(self) -> impl Iterator<Item = &'a [u8]> {
        self.samples.chunks_exact(self.row_bytes)
    }

    #[inline(always)]
    pub(super) fn row(self, index: usize) -> &'a [u8] {
        &self.samples[index * self.row_bytes..][..self.row_bytes]
    }
}

/// The filter byte of `sub`.
pub(super) const SUB: u8 = 1;

/// The filter byte of `paeth`.
pub(super) const PAETH: u8 = 4;

/// `out[i] = row[from + i] - left`.
#[inline(always)]
pub(super) fn sub(row: &[u8], bpp: usize, from: usize, out: &mut [u8]) {
    let edge = bpp.saturating_sub(from).min(out.len());
    let (first, rest) = out.split_at_mut(edge);
    first.copy_from_slice(&row[from..from + edge]);
    let from = from + edge;
    if rest.is_empty() {
        return;
    }
    let x = &row[from..][..rest.len()];
    let a = &row[from - bpp..][..rest.len()];
    for (out, (x, a)) in rest.iter_mut().zip(x.iter().zip(a)) {
        *out = x.wrapping_sub(*a);
    }
}

/// `out[i] = row[from + i] - up`.
#[inline(always)]
pub(super) fn up(row: &[u8], above: &[u8], from: usize, out: &mut [u8]) {
    let x = &row[from..][..out.len()];
    let b = &above[from..][..out.len()];
    for (out, (x, b)) in out.iter_mut().zip(x.iter().zip(b)) {
        *out = x.wrapping_sub(*b);
    }
}

/// `out[i] = row[from + i] - paeth(left, up, up left)`.
#[inline(always)]
pub(super) fn paeth(row: &[u8], above: &[u8], bpp: usize, from: usize, out: &mut [u8]) {
    // Left of the first pixel everything is zero, and the predictor picks the byte above.
    let edge = bpp.saturating_sub(from).min(out.len());
    let (first, rest) = out.split_at_mut(edge);
    up(row, above, from, first);
    let from = from + edge;
    if rest.is_empty() {
        return;
    }
    let n = rest.len();
    let (x, b) = (&row[from..][..n], &above[from..][..n]);
    let (a, c) = (&row[from - bpp..][..n], &above[from - bpp..][..n]);
    for i in 0..n {
        rest[i] = x[i].wrapping_sub(predict_paeth(a[i], b[i], c[i]));
    }
}

/// `out[i] = row[from + i] - floor((left + up) / 2)`.
pub(super) fn average(row: &[u8], above: &[u8], bpp: usize, out: &mut [u8]) {
    let (first, rest) = out.split_at_mut(bpp);
    for (out, (x, b)) in first.iter_mut().zip(row.iter().zip(above)) {
        *out = x.wrapping_sub(b >> 1);
    }
    for (out, ((x, b), a)) in rest
        .iter_mut()
        .zip(row[bpp..].iter().zip(&above[bpp..]).zip(row))
    {
        *out = x.wrapping_sub((a & b) + ((a ^ b) >> 1));
    }
}

/// The Paeth predictor in eight bits. With `p = a + b - c`, the distances to a, b and c are
/// `|b - c|`, `|a - c|` and `|(a - c) + (b - c)|`: when c lies strictly between a and b the two
/// terms of the last have opposite signs and it is the difference of the first two; otherwise it is
/// their sum, which never wins.
#[inline(always)]
fn predict_paeth(a: u8, b: u8, c: u8) -> u8 {
    let (to_a, to_b) = (distance(b, c), distance(a, c));
    let outside = (c <= a.min(b)) | (c >= a.max(b));
    let to_c = if outside {
        u8::MAX
    } else {
        distance(to_a, to_b)
    };
    let nearer = if to_a <= to_b { a } else { b };
    if to_a.min(to_b) <= to_c { nearer } else { c }
}

/// `u8::abs_diff` goes through `i32`, and so would the vectors.
#[inline(always)]
fn distance(a: u8, b: u8) -> u8 {
    a.max(b) - a.min(b)
}

#[expect(
    clippy::cast_possible_truncation,
    reason = "made-up samples are cut to their width on purpose"
)]
#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn paeth_predictor_is_that_of_the_standard_for_all_bytes() {
        for a in 0..=255u8 {
            for b in 0..=255u8 {
                for c in 0..=255u8 {
                    let p = i32::from(a) + i32::from(b) - i32::from(c);
                    let [pa, pb, pc] = [a, b, c].map(|v| (p - i32::from(v)).abs());
                    let expected = if pa <= pb && pa <= pc {
                        a
                    } else if pb <= pc {
                        b
                    } else {
                        c
                    };
                    assert_eq!(predict_paeth(a, b, c), expected, "{a} {b} {c}");
                }
            }
        }
    }

    #[test]
    fn filters_in_pieces_equal_filters_of_whole_rows() {
        let row: Vec<u8> = (0..120u32).map(|i| ((i * i * 7) >> 3) as u8).collect();
        let above: Vec<u8> = (0..120u32).map(|i| (i * 31) as u8).collect();
        for bpp in [3, 4, 6, 8] {
            let (mut whole_sub, mut whole_paeth) = (vec![0; 120], vec![0; 120]);
            sub(&row, bpp, 0, &mut whole_sub);
            paeth(&row, &above, bpp, 0, &mut whole_paeth);
            for piece in [1, 2, 5, 7, 64] {
                let mut from = 0;
                while from < 120 {
                    let n = piece.min(120 - from);
                    let mut out = vec![0; n];
                    sub(&row, bpp, from, &mut out);
                    assert_eq!(out, whole_sub[from..from + n]);
                    paeth(&row, &above, bpp, from, &mut out);
                    assert_eq!(out, whole_paeth[from..from + n]);
                    from += n;
                }
            }
        }
    }

    #[test]
    fn average_rounds_down_without_overflow() {
        let (row, above) = ([255, 255, 255, 254, 1, 0], [255, 254, 0, 255, 255, 1]);
        let mut out = [0; 6];
        average(&row, &above, 3, &mut out);
        let expected: Vec<u8> = (0..6)
            .map(|i| {
                let left = if i < 3 { 0 } else { u16::from(row[i - 3]) };
                row[i].wrapping_sub(((left + u16::from(above[i])) / 2) as u8)
            })
            .collect();
        assert_eq!(out, expected[..]);
    }
}
