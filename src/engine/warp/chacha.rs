//! The generator of a batch's jitter: ChaCha with eight rounds (Bernstein 2008), whose numbers are
//! the same on every machine.

/// "expand 32-byte k", as little-endian words.
const CONSTANTS: [u32; 4] = [0x6170_7865, 0x3320_646e, 0x7962_2d32, 0x6b20_6574];
/// A double round mixes the columns, then the diagonals.
const DOUBLE_ROUNDS: usize = 4;

/// A stream of numbers: each seed has one for each frame.
pub(super) struct ChaCha8 {
    /// Constants, key, the number of the next block, and the stream.
    input: [u32; 16],
    block: [u32; 16],
    /// Words of the block that are used.
    used: usize,
}

impl ChaCha8 {
    pub(super) fn new(seed: u64, stream: u32) -> Self {
        let mut input = [0; 16];
        input[..4].copy_from_slice(&CONSTANTS);
        input[4] = (seed & 0xFFFF_FFFF) as u32;
        input[5] = (seed >> 32) as u32;
        input[14] = stream;
        Self {
            input,
            block: [0; 16],
            used: 16,
        }
    }

    pub(super) fn next_u64(&mut self) -> u64 {
        let low = self.next_u32();
        u64::from(self.next_u32()) << 32 | u64::from(low)
    }

    fn next_u32(&mut self) -> u32 {
        if self.used == self.block.len() {
            self.block = mixed(&self.input);
            // A frame takes some hundred words: the number of a block never exceeds a word.
            self.input[12] += 1;
            self.used = 0;
        }
        self.used += 1;
        self.block[self.used - 1]
    }
}

fn mixed(input: &[u32; 16]) -> [u32; 16] {
    let mut state = *input;
    let mut quarter = |a: usize, b: usize, c: usize, d: usize| {
        for (sum, other, turned, bits) in [(a, b, d, 16), (c, d, b, 12), (a, b, d, 8), (c, d, b, 7)]
        {
            state[sum] = state[sum].wrapping_add(state[other]);
            state[turned] = (state[turned] ^ state[sum]).rotate_left(bits);
        }
    };
    for _ in 0..DOUBLE_ROUNDS {
        for k in 0..4 {
            quarter(k, 4 + k, 8 + k, 12 + k);
        }
        for k in 0..4 {
            quarter(k, 4 + (k + 1) % 4, 8 + (k + 2) % 4, 12 + (k + 3) % 4);
        }
    }
    for (word, input) in state.iter_mut().zip(input) {
        *word = word.wrapping_add(*input);
    }
    state
}

#[cfg(test)]
mod tests {
    use super::*;
    use rand_chacha::ChaCha8Rng;
    use rand_chacha::rand_core::{RngCore as _, SeedableRng as _};

    #[test]
    fn the_numbers_are_those_of_an_independent_generator() {
        for (seed, stream) in [(0, 0), (7, 3), (u64::MAX, u32::MAX), (1 << 40, 1)] {
            let mut key = [0; 32];
            key[..8].copy_from_slice(&u64::to_le_bytes(seed));
            let mut other = ChaCha8Rng::from_seed(key);
            other.set_stream(stream.into());
            let mut own = ChaCha8::new(seed, stream);
            for _ in 0..1000 {
                assert_eq!(own.next_u64(), other.next_u64());
            }
        }
    }
}
