//! Damage by chance, the same for the same seed: bytes of any kind are flipped, cut, repeated and
//! mixed with others; of pictures also the chunks are exchanged, and checksums and lengths are
//! mended afterwards, so that the damage gets past what checks them.

/// Random numbers (splitmix64).
#[derive(Clone, Debug)]
pub(crate) struct Dice(u64);

impl Dice {
    pub(crate) const fn new(seed: u64) -> Self {
        Self(seed)
    }

    pub(crate) fn next(&mut self) -> u64 {
        self.0 = self.0.wrapping_add(0x9E37_79B9_7F4A_7C15);
        let mut z = self.0;
        z = (z ^ (z >> 30)).wrapping_mul(0xBF58_476D_1CE4_E5B9);
        z = (z ^ (z >> 27)).wrapping_mul(0x94D0_49BB_1331_11EB);
        z ^ (z >> 31)
    }

    /// Below `end`, which is not 0.
    pub(crate) fn below(&mut self, end: usize) -> usize {
        (self.next() % end as u64) as usize
    }

    pub(crate) fn one_in(&mut self, n: usize) -> bool {
        self.below(n) == 0
    }

    pub(crate) fn pick<'a, T>(&mut self, of: &'a [T]) -> &'a T {
        &of[self.below(of.len())]
    }

    /// A range within `0..len`, mostly short.
    fn range(&mut self, len: usize) -> std::ops::Range<usize> {
        let longest = if self.one_in(4) { len } else { len.min(16) };
        let start = self.below(len.max(1));
        start..(start + self.below(longest.max(1)) + 1).min(len).max(start)
    }
}

/// Numbers at which sizes and signs turn over.
const EDGES: [u32; 16] = [
    0,
    1,
    2,
    7,
    8,
    0x7F,
    0x80,
    0xFF,
    0x100,
    0x3FFF,
    0x4000,
    0x7FFF,
    0xFFFF,
    0x1_0000,
    0x7FFF_FFFF,
    0xFFFF_FFFF,
];

/// Largest result, bytes.
const LONGEST: usize = 1 << 20;

/// `bytes` after one to six blows; `other` is of the same kind.
pub(crate) fn damaged(dice: &mut Dice, bytes: &[u8], other: &[u8]) -> Vec<u8> {
    let mut out = bytes.to_vec();
    for _ in 0..=dice.below(6).min(dice.below(6)) {
        blow(dice, &mut out, other);
    }
    out.truncate(LONGEST);
    out
}

fn blow(dice: &mut Dice, out: &mut Vec<u8>, other: &[u8]) {
    let len = out.len();
    if len == 0 {
        out.extend_from_slice(other);
        return;
    }
    let at = dice.below(len);
    match dice.below(12) {
        0 | 1 => out[at] ^= 1 << dice.below(8),
        2 => out[at] = dice.next() as u8,
        3 => {
            let range = dice.range(len);
            out[range].fill_with(|| dice.next() as u8);
        }
        4 => {
            // A number of 16 or 32 bits, either end first.
            let edge = dice
                .pick(&EDGES)
                .wrapping_add(dice.below(3) as u32)
                .wrapping_sub(1);
            let (big, little) = (edge.to_be_bytes(), edge.to_le_bytes());
            let written = match dice.below(4) {
                0 => &big[2..],
                1 => &little[..2],
                2 => &big[..],
                _ => &little[..],
            };
            for (into, byte) in out[at..].iter_mut().zip(written) {
                *into = *byte;
            }
        }
        5 => {
            let by = dice.below(33) as u8;
            out[at] = out[at].wrapping_add(by).wrapping_sub(16);
        }
        6 => out.truncate(at),
        7 => drop(out.drain(dice.range(len))),
        8 => {
            let range = dice.range(len);
            let times = 1 + if dice.one_in(8) { dice.below(200) } else { 0 };
            let repeated = out[range].repeat(times);
            out.splice(at..at, repeated);
        }
        9 => {
            let range = dice.range(other.len());
            out.splice(at..at, other[range].iter().copied());
        }
        10 => {
            // The head of one and the tail of the other.
            out.truncate(at);
            out.extend_from_slice(&other[dice.below(other.len() + 1).min(other.len())..]);
        }
        _ => {
            let (from, to) = (dice.range(len), dice.range(len));
            let moved = out[from].to_vec();
            out.splice(to, moved);
        }
    }
}

/// A damaged picture. Half of them have sound checksums and lengths.
pub(crate) fn damaged_picture(dice: &mut Dice, bytes: &[u8], other: &[u8]) -> Vec<u8> {
    let mut out = bytes.to_vec();
    if dice.one_in(4) {
        let parts = chunks(bytes);
        let mut kept: Vec<&[u8]> = parts.clone();
        let strange = chunks(other);
        for _ in 0..=dice.below(3) {
            let (at, to) = (dice.below(kept.len()), dice.below(kept.len()));
            match dice.below(4) {
                0 => kept.swap(at, to),
                1 => kept.insert(at, parts[to.min(parts.len() - 1)]),
                2 => kept.insert(at, strange[dice.below(strange.len())]),
                _ if kept.len() > 1 => drop(kept.remove(at)),
                _ => {}
            }
        }
        out = kept.concat();
    }
    if !dice.one_in(8) {
        out = damaged(dice, &out, other);
    }
    if dice.one_in(2) {
        mend(&mut out);
    }
    out
}

const PNG: &[u8] = b"\x89PNG\r\n\x1a\n";

/// The parts of a picture's file: its head, and its chunks or segments as far as they can be told
/// apart.
fn chunks(bytes: &[u8]) -> Vec<&[u8]> {
    let head = match bytes {
        [0x89, ..] => PNG.len(),
        [0xFF, ..] => 2,
        _ => 12,
    };
    let (head, mut rest) = bytes.split_at(head.min(bytes.len()));
    let mut parts = vec![head];
    while !rest.is_empty() {
        let length = match (bytes, rest) {
            ([0x89, ..], [a, b, c, d, ..]) => u32::from_be_bytes([*a, *b, *c, *d]) as usize + 12,
            ([0x52, ..], [_, _, _, _, a, b, c, d, ..]) => {
                (u32::from_le_bytes([*a, *b, *c, *d]) as usize).next_multiple_of(2) + 8
            }
            ([0xFF, ..], [0xFF, marker, a, b, ..]) if *marker != 0xDA => {
                usize::from(u16::from_be_bytes([*a, *b])) + 2
            }
            _ => rest.len(),
        };
        let (part, behind) = rest.split_at(length.clamp(1, rest.len()));
        parts.push(part);
        rest = behind;
    }
    parts
}

/// Mends the checksums of PNG chunks and the length of a RIFF file.
pub(crate) fn mend(bytes: &mut [u8]) {
    if bytes.starts_with(PNG) {
        let mut at = PNG.len();
        while let Some(length) = bytes.get(at..at + 4).and_then(|head| head.first_chunk()) {
            let end = (at + 8).saturating_add(u32::from_be_bytes(*length) as usize);
            let Some(sum) = bytes.get(at + 4..end).map(crc32fast::hash) else {
                return;
            };
            let Some(place) = bytes.get_mut(end..end + 4) else {
                return;
            };
            place.copy_from_slice(&sum.to_be_bytes());
            at = end + 4;
        }
    } else if bytes.starts_with(b"RIFF") && bytes.len() >= 8 {
        let size = bytes.len() as u32 - 8;
        bytes[4..8].copy_from_slice(&size.to_le_bytes());
    }
}

/// The files of a folder beside this one, in the order of their names.
pub(crate) fn files(folder: &str) -> Vec<(String, Vec<u8>)> {
    let folder = format!("{}/../../tests/fuzz/{folder}", env!("CARGO_MANIFEST_DIR"));
    let entries = std::fs::read_dir(folder).expect("a folder of this repository");
    let read = |entry: std::io::Result<std::fs::DirEntry>| {
        let path = entry.expect("a folder of this repository").path();
        (
            path.file_name()
                .unwrap_or_default()
                .to_string_lossy()
                .into_owned(),
            std::fs::read(&path).expect("a file of this repository"),
        )
    };
    let mut files: Vec<_> = entries.map(read).collect();
    files.sort();
    files
}
