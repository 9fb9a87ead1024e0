//! Adler-32 of joined pieces from the checksums of the pieces (RFC 1950). Modulo 65521,
//! `a = 1 + sum d_i` and `b = sum over prefixes of a`; so for x followed by y: `a = a_x + a_y - 1`
//! and `b = b_x + b_y + |y| (a_x - 1)`. Cost: a few operations, whatever the lengths.

const MODULUS: u64 = 65_521;

/// The checksum of no bytes.
pub(super) const EMPTY_CHECKSUM: u32 = 1;

/// The checksum of `x` followed by `y`, given the checksum of each and the length of `y`.
pub(super) fn combine(x: u32, y: u32, y_len: u64) -> u32 {
    let split = |sum: u32| (u64::from(sum & 0xffff), u64::from(sum >> 16));
    let ((ax, bx), (ay, by)) = (split(x), split(y));
    let before = ax + MODULUS - 1;
    let a = (before + ay) % MODULUS;
    let b = (bx + by + (y_len % MODULUS) * (before % MODULUS)) % MODULUS;
    u32::try_from(b << 16 | a).expect("both halves are below 2^16")
}

#[cfg(test)]
mod tests {
    use super::*;

    fn adler(bytes: &[u8]) -> u32 {
        let mut sum = simd_adler32::Adler32::new();
        sum.write(bytes);
        sum.finish()
    }

    #[test]
    fn combine_equals_the_sum_of_the_whole() {
        let bytes: Vec<u8> = (0..200_000u32)
            .map(|i| (i.wrapping_mul(2_654_435_761) >> 24) as u8)
            .chain([255; 70_000])
            .collect();
        assert_eq!(adler(&[]), EMPTY_CHECKSUM);
        for cut in [
            0, 1, 2, 5551, 5552, 5553, 65_520, 65_521, 65_522, 131_042, 200_000, 269_999, 270_000,
        ] {
            let (x, y) = bytes.split_at(cut);
            assert_eq!(
                combine(adler(x), adler(y), y.len() as u64),
                adler(&bytes),
                "cut at {cut}"
            );
        }
    }

    #[test]
    fn combine_is_associative_over_many_pieces() {
        let bytes = vec![0xff; 100_000];
        let sum = bytes.chunks(777).fold(EMPTY_CHECKSUM, |sum, piece| {
            combine(sum, adler(piece), piece.len() as u64)
        });
        assert_eq!(sum, adler(&bytes));
    }
}
