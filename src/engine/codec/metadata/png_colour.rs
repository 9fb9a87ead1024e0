//! The chunks of PNG that say what the numbers mean (third edition, 11.3.2). They are kept in PNG;
//! the other formats have no place for them. There, nothing is lost if they say sRGB, which is what
//! every format means by default.

use super::PngChunk;

/// The chunks and their lengths.
const CHUNKS: [([u8; 4], usize); 6] = [
    (*b"cICP", 4),
    (*b"sRGB", 1),
    (*b"gAMA", 4),
    (*b"cHRM", 32),
    (*b"mDCV", 24),
    (*b"cLLI", 8),
];
/// The gamma of sRGB, times 100,000, and how far others are the same.
const GAMMA: u32 = 45_455;
const SAME_GAMMA: u32 = 500;
/// White, red, green and blue of sRGB, x and y, times 100,000, and how far others are the same.
const PRIMARIES: [u32; 8] = [
    31_270, 32_900, 64_000, 33_000, 30_000, 60_000, 15_000, 6_000,
];
const SAME_PRIMARY: u32 = 200;

/// The length of a chunk of colour; `None` for other chunks.
pub(in crate::codec) fn length_of(kind: [u8; 4]) -> Option<usize> {
    CHUNKS
        .iter()
        .find(|(name, _)| *name == kind)
        .map(|(_, length)| *length)
}

/// Whether the chunks say sRGB, or nothing that a profile beside them does not say.
pub(super) fn is_srgb(chunks: &[PngChunk<&[u8]>], has_profile: bool) -> bool {
    let chunk = |kind: &[u8; 4]| {
        chunks
            .iter()
            .find(|(name, _)| name == kind)
            .map(|(_, data)| *data)
    };
    let numbers = |data: &[u8]| {
        data.as_chunks()
            .0
            .iter()
            .map(|number| u32::from_be_bytes(*number))
            .collect::<Vec<_>>()
    };
    if let Some(code_points) = chunk(b"cICP") {
        // Primaries of BT.709, the transfer function of sRGB.
        return matches!(code_points, [1, 13, ..]);
    }
    if has_profile || chunk(b"sRGB").is_some() {
        return true;
    }
    let gamma = chunk(b"gAMA").is_none_or(|gamma| numbers(gamma)[0].abs_diff(GAMMA) <= SAME_GAMMA);
    let is_same = |numbers: Vec<u32>| {
        numbers
            .iter()
            .zip(PRIMARIES)
            .all(|(a, b)| a.abs_diff(b) <= SAME_PRIMARY)
    };
    gamma && chunk(b"cHRM").is_none_or(|chrm| is_same(numbers(chrm)))
}
