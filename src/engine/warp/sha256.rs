//! SHA-256 (FIPS 180-4) without a dependency. With the feature `codec`, whose files are long, the
//! crate `sha2` computes the same with the processor's instructions.

/// The fractional parts of the cube roots of the first 64 primes.
const ROUND_CONSTANTS: [u32; 64] = fractions::<64>(3);
/// Those of the square roots of the first eight.
const INITIAL_STATE: [u32; 8] = fractions::<8>(2);

/// The first 32 bits of the fractional parts of roots of the first primes.
const fn fractions<const COUNT: usize>(degree: u32) -> [u32; COUNT] {
    let mut found = [0; COUNT];
    let (mut count, mut n) = (0, 2_u64);
    while count < COUNT {
        let mut divisor = 2;
        while n % divisor != 0 {
            divisor += 1;
        }
        if divisor == n {
            found[count] = fraction(n, degree);
            count += 1;
        }
        n += 1;
    }
    found
}

/// The largest x with `x^degree <= n 2^(32 degree)`, without its whole part.
const fn fraction(n: u64, degree: u32) -> u32 {
    // Bit by bit from above; x is below 2^37, so that its third power fits.
    let (mut x, mut bit) = (0_u128, 1_u128 << 36);
    while bit > 0 {
        if (x + bit).pow(degree) <= (n as u128) << (32 * degree) {
            x += bit;
        }
        bit >>= 1;
    }
    (x & 0xFFFF_FFFF) as u32
}

/// A digest of bytes that come in parts.
#[derive(Clone, Debug)]
pub(super) struct Sha256 {
    state: [u32; 8],
    /// Bytes that do not fill a block yet.
    rest: Vec<u8>,
    length: u64,
}

impl Default for Sha256 {
    fn default() -> Self {
        Self::new()
    }
}

impl Sha256 {
    pub(super) const BLOCK_BYTES: usize = 64;

    pub(super) const fn new() -> Self {
        Self {
            state: INITIAL_STATE,
            rest: Vec::new(),
            length: 0,
        }
    }

    pub(super) fn update(&mut self, bytes: impl AsRef<[u8]>) {
        let bytes = bytes.as_ref();
        self.length += bytes.len() as u64;
        self.rest.extend_from_slice(bytes);
        let (blocks, rest) = self.rest.as_chunks::<{ Self::BLOCK_BYTES }>();
        for block in blocks {
            compress(&mut self.state, block);
        }
        self.rest = rest.to_vec();
    }

    pub(super) fn finish(mut self) -> [u8; 32] {
        let bits = self.length * 8;
        // A one, zeros, and the length at the end of a block.
        let zeros = (2 * Self::BLOCK_BYTES - 9 - self.rest.len()) % Self::BLOCK_BYTES;
        let mut end = vec![0x80];
        end.resize(1 + zeros, 0);
        end.extend(bits.to_be_bytes());
        self.update(end);
        let mut digest = [0; 32];
        for (bytes, word) in digest.as_chunks_mut::<4>().0.iter_mut().zip(self.state) {
            *bytes = word.to_be_bytes();
        }
        digest
    }
}

fn compress(state: &mut [u32; 8], block: &[u8; Sha256::BLOCK_BYTES]) {
    let mut schedule = [0_u32; 64];
    for (word, bytes) in schedule.iter_mut().zip(block.as_chunks::<4>().0) {
        *word = u32::from_be_bytes(*bytes);
    }
    for k in 16..64 {
        let (near, far) = (schedule[k - 2], schedule[k - 15]);
        let near = near.rotate_right(17) ^ near.rotate_right(19) ^ near >> 10;
        let far = far.rotate_right(7) ^ far.rotate_right(18) ^ far >> 3;
        schedule[k] = schedule[k - 16]
            .wrapping_add(far)
            .wrapping_add(schedule[k - 7])
            .wrapping_add(near);
    }
    let [mut a, mut b, mut c, mut d, mut e, mut f, mut g, mut h] = *state;
    for (word, constant) in schedule.into_iter().zip(ROUND_CONSTANTS) {
        let choice = e & f ^ !e & g;
        let of_e = e.rotate_right(6) ^ e.rotate_right(11) ^ e.rotate_right(25);
        let first = h
            .wrapping_add(of_e)
            .wrapping_add(choice)
            .wrapping_add(constant)
            .wrapping_add(word);
        let majority = a & b ^ a & c ^ b & c;
        let of_a = a.rotate_right(2) ^ a.rotate_right(13) ^ a.rotate_right(22);
        (h, g, f, e) = (g, f, e, d.wrapping_add(first));
        (d, c, b, a) = (c, b, a, first.wrapping_add(of_a.wrapping_add(majority)));
    }
    for (sum, word) in state.iter_mut().zip([a, b, c, d, e, f, g, h]) {
        *sum = sum.wrapping_add(word);
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::warp::Digest;

    #[test]
    fn the_digest_is_that_of_the_crate_whatever_the_parts() {
        let bytes: Vec<u8> = (0..300_u32).map(|k| (k * 37 % 251) as u8).collect();
        for length in 0..bytes.len() {
            for part in [1, 7, 64, 300] {
                let mut own = Sha256::new();
                bytes[..length]
                    .chunks(part)
                    .for_each(|part| own.update(part));
                assert_eq!(
                    Digest(own.finish()),
                    Digest::of(&bytes[..length]),
                    "{length}"
                );
            }
        }
    }
}
