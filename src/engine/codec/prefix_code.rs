//! Length-limited prefix codes, and how files send their lengths (RFC 1951, 3.2.2 and 3.2.7; RFC
//! 9649, 3.7.2.1, is the same but for the order). Lengths come from Huffman's algorithm with two
//! queues over sorted weights, then the Kraft sum is corrected at the limit; codes are canonical
//! and stored bit-reversed, as both formats send them. Cost: one sort of at most 286 weights, about
//! 10 us.

use super::bits::BitWriter;

/// Longest code of the code of lengths.
const LENGTH_LIMIT: usize = 7;

/// A code for every symbol of weight above zero. `N <= 288`, `limit <= 15`.
#[derive(Clone, Debug)]
pub(super) struct Codes<const N: usize> {
    /// Bits of a symbol, 0 when it has no code.
    pub(super) length: [u8; N],
    /// The code, first bit lowest.
    pub(super) bits: [u16; N],
}

impl<const N: usize> Codes<N> {
    /// The code of least expected length under `limit`, except for the cost of correcting the Kraft
    /// sum.
    pub(super) fn new(weights: &[u32; N], limit: usize) -> Self {
        let length = lengths(weights, limit);
        Self {
            length,
            bits: canonical(&length),
        }
    }
}

fn lengths<const N: usize>(weights: &[u32; N], limit: usize) -> [u8; N] {
    let mut lengths = [0; N];
    let mut leaves: Vec<(u32, usize)> = weights
        .iter()
        .copied()
        .zip(0..N)
        .filter(|leaf| leaf.0 > 0)
        .collect();
    if leaves.len() < 2 {
        for (_, symbol) in leaves {
            lengths[symbol] = 1;
        }
        return lengths;
    }
    leaves.sort_unstable();
    let mut counts = depths(&leaves);
    limit_depths(&mut counts, limit);
    let mut lightest_first = leaves.into_iter();
    for depth in (1..=limit).rev() {
        for (_, symbol) in lightest_first.by_ref().take(counts[depth]) {
            lengths[symbol] = u8::try_from(depth).expect("a limit is at most 15");
        }
    }
    lengths
}

/// Number of leaves at every depth of the Huffman tree. `leaves` are in ascending order, at least
/// two.
fn depths(leaves: &[(u32, usize)]) -> Vec<usize> {
    let n = leaves.len();
    // Nodes 0..n are the leaves and n..2n-1 the merged nodes, which are created in ascending order
    // of weight, so they are the second queue.
    let mut weight: Vec<u64> = leaves.iter().map(|leaf| u64::from(leaf.0)).collect();
    let mut parent = vec![0; 2 * n - 1];
    let (mut leaf, mut merged) = (0, n);
    for node in n..2 * n - 1 {
        let mut sum = 0;
        for _ in 0..2 {
            let lightest = if leaf < n && (merged == node || weight[leaf] <= weight[merged]) {
                &mut leaf
            } else {
                &mut merged
            };
            sum += weight[*lightest];
            parent[*lightest] = node;
            *lightest += 1;
        }
        weight.push(sum);
    }
    let mut depth = vec![0; 2 * n - 1];
    let mut counts = vec![0; n.max(16)];
    for node in (0..2 * n - 2).rev() {
        depth[node] = depth[parent[node]] + 1;
        if node < n {
            counts[depth[node]] += 1;
        }
    }
    counts
}

/// Moves leaves deeper than `limit` up to it and lengthens the deepest others until the Kraft sum
/// is one again.
fn limit_depths(counts: &mut Vec<usize>, limit: usize) {
    let deeper: usize = counts.drain(limit + 1..).sum();
    counts[limit] += deeper;
    let mut sum: usize = counts
        .iter()
        .enumerate()
        .map(|(depth, count)| count << (limit - depth))
        .sum();
    while sum > 1 << limit {
        counts[limit] -= 1;
        let depth = (1..limit)
            .rev()
            .find(|&depth| counts[depth] > 0)
            .expect("fewer symbols than codes of the limit");
        counts[depth] -= 1;
        counts[depth + 1] += 2;
        sum -= 1;
    }
}

fn canonical<const N: usize>(lengths: &[u8; N]) -> [u16; N] {
    // First the number of codes that are one bit shorter, then the first code of every length.
    let mut next = [0u32; 17];
    for &length in lengths.iter().filter(|&&length| length > 0) {
        next[usize::from(length) + 1] += 1;
    }
    for depth in 1..17 {
        next[depth] = (next[depth - 1] + next[depth]) << 1;
    }
    lengths.map(|length| {
        if length == 0 {
            return 0;
        }
        let code = next[usize::from(length)];
        next[usize::from(length)] += 1;
        u16::try_from(code.reverse_bits() >> (32 - u32::from(length))).expect("at most 15 bits")
    })
}

/// The lengths of one or several codes as a file has them: runs, in a prefix code of their own.
pub(super) struct SentLengths {
    runs: Vec<LengthRun>,
    of_lengths: Codes<19>,
}

impl SentLengths {
    /// `lengths`: of every symbol of every code, in order.
    pub(super) fn new(lengths: &[u8]) -> Self {
        let runs = run_lengths(lengths);
        let mut weights = [0; 19];
        for run in &runs {
            weights[usize::from(run.symbol)] += 1;
        }
        Self {
            runs,
            of_lengths: Codes::new(&weights, LENGTH_LIMIT),
        }
    }

    /// Writes the code of the lengths: how many of its lengths follow in this order, and they.
    pub(super) fn put_code(&self, order: &[usize; 19], bits: &mut BitWriter, out: &mut Vec<u8>) {
        let sent = order
            .iter()
            .rposition(|&symbol| self.of_lengths.length[symbol] > 0)
            .map_or(4, |at| (at + 1).max(4));
        bits.put(out, sent as u64 - 4, 4);
        for &symbol in &order[..sent] {
            bits.put(out, self.of_lengths.length[symbol].into(), 3);
        }
    }

    /// Writes the lengths.
    pub(super) fn put_runs(&self, bits: &mut BitWriter, out: &mut Vec<u8>) {
        for run in &self.runs {
            let symbol = usize::from(run.symbol);
            bits.put(
                out,
                self.of_lengths.bits[symbol].into(),
                self.of_lengths.length[symbol].into(),
            );
            bits.put(out, run.extra.into(), run.extra_bits.into());
        }
    }
}

struct LengthRun {
    symbol: u8,
    extra: u8,
    extra_bits: u8,
}

/// Lengths with repetitions: 16 repeats the last 3 to 6 times, 17 and 18 stand for 3 to 10 and 11
/// to 138 zeros.
fn run_lengths(lengths: &[u8]) -> Vec<LengthRun> {
    let mut runs = Vec::with_capacity(lengths.len());
    for same in lengths.chunk_by(|a, b| a == b) {
        let value = same[0];
        let mut left = same.len();
        while left > 0 {
            let first = left == same.len();
            let (symbol, taken, least, extra_bits) = match left {
                11.. if value == 0 => (18, left.min(138), 11, 7),
                3.. if value == 0 => (17, left, 3, 3),
                3.. if !first => (16, left.min(6), 3, 2),
                _ => (value, 1, 1, 0),
            };
            runs.push(LengthRun {
                symbol,
                extra: u8::try_from(taken - least).expect("at most 127"),
                extra_bits,
            });
            left -= taken;
        }
    }
    runs
}

#[expect(
    clippy::cast_possible_truncation,
    reason = "made-up samples are cut to their width on purpose"
)]
#[cfg(test)]
mod tests {
    use super::*;

    fn kraft(lengths: &[u8], limit: u32) -> u64 {
        lengths
            .iter()
            .filter(|&&length| length > 0)
            .map(|&length| 1u64 << (limit - u32::from(length)))
            .sum()
    }

    fn cost(weights: &[u32], lengths: &[u8]) -> u64 {
        weights
            .iter()
            .zip(lengths)
            .map(|(&weight, &length)| u64::from(weight) * u64::from(length))
            .sum()
    }

    #[test]
    fn codes_are_complete_and_within_the_limit() {
        let mut seed = 1u32;
        for round in 0..200 {
            let weights: [u32; 286] = std::array::from_fn(|symbol| {
                seed = seed.wrapping_mul(1_664_525).wrapping_add(1_013_904_223);
                match round % 4 {
                    0 => seed >> 24,
                    1 => 1 << (symbol % 30),
                    2 => 1 + (seed >> (8 + symbol % 24)),
                    _ => u32::from(symbol % (2 + round) == 0),
                }
            });
            for limit in [9, 12, 15] {
                let lengths = lengths(&weights, limit);
                assert_eq!(kraft(&lengths, 15), 1 << 15, "round {round}, limit {limit}");
                assert!(lengths.iter().all(|&length| usize::from(length) <= limit));
                assert!(
                    lengths
                        .iter()
                        .zip(&weights)
                        .all(|(&length, &weight)| (length > 0) == (weight > 0))
                );
            }
        }
    }

    #[test]
    fn codes_without_a_limit_are_those_of_huffman() {
        // Fibonacci weights: the deepest tree there is.
        assert_eq!(
            lengths(&[1, 1, 2, 3, 5, 8, 13, 21], 15),
            [7, 7, 6, 5, 4, 3, 2, 1]
        );
        assert_eq!(lengths(&[5, 5, 5, 5], 15), [2; 4]);
        assert_eq!(lengths(&[0, 9, 0], 15), [0, 1, 0]);
    }

    #[test]
    fn limited_codes_cost_little_more() {
        let weights: [u32; 40] = std::array::from_fn(|symbol| 1 + (100_000 >> (symbol / 2)));
        let (free, limited) = (
            cost(&weights, &lengths(&weights, 15)),
            cost(&weights, &lengths(&weights, 9)),
        );
        assert!(
            free < limited && limited < free + free / 20,
            "{free} {limited}"
        );
    }

    #[test]
    fn canonical_codes_are_prefix_free() {
        let weights: [u32; 40] = std::array::from_fn(|symbol| 1 + (symbol * symbol) as u32);
        let codes = Codes::new(&weights, 9);
        for a in 0..40 {
            for b in 0..40 {
                let short = codes.length[a].min(codes.length[b]);
                let mask = (1u16 << short) - 1;
                assert!(
                    a == b || codes.bits[a] & mask != codes.bits[b] & mask,
                    "{a} {b}"
                );
            }
        }
    }

    #[test]
    fn run_lengths_unfold_to_the_lengths() {
        let mut lengths = vec![8; 100];
        lengths.extend_from_slice(&[0; 300]);
        lengths.extend_from_slice(&[5, 5, 5, 5, 0, 0, 7, 7, 7, 0, 0, 0, 1]);
        let mut unfolded: Vec<u8> = Vec::new();
        for run in run_lengths(&lengths) {
            assert!(run.extra >> run.extra_bits == 0);
            let (value, times) = match run.symbol {
                16 => (*unfolded.last().unwrap(), 3 + run.extra),
                17 => (0, 3 + run.extra),
                18 => (0, 11 + run.extra),
                value => (value, 1),
            };
            unfolded.extend(std::iter::repeat_n(value, times.into()));
        }
        assert_eq!(unfolded, lengths);
    }
}
