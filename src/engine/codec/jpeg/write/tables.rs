//! The tables of ITU-T T.81, Annex K: quantisation scaled by quality as the Independent JPEG Group
//! does, and Huffman codes.

/// Side of a block, px.
pub(super) const SIDE: usize = 8;
/// Coefficients of a block.
pub(super) const BLOCK: usize = SIDE * SIDE;

/// The zigzag order, that of a file: the position `8 v + u` of each coefficient in rows (T.81,
/// figure A.6).
pub(super) const ZIGZAG: [u8; BLOCK] = zigzag();

/// Table K.1, in rows.
const LUMA: [u8; BLOCK] = [
    16, 11, 10, 16, 24, 40, 51, 61, 12, 12, 14, 19, 26, 58, 60, 55, 14, 13, 16, 24, 40, 57, 69, 56,
    14, 17, 22, 29, 51, 87, 80, 62, //
    18, 22, 37, 56, 68, 109, 103, 77, 24, 35, 55, 64, 81, 104, 113, 92, 49, 64, 78, 87, 103, 121,
    120, 101, 72, 92, 95, 98, 112, 100, 103, 99,
];

/// Table K.2, in rows.
const CHROMA: [u8; BLOCK] = [
    17, 18, 24, 47, 99, 99, 99, 99, 18, 21, 26, 66, 99, 99, 99, 99, 24, 26, 56, 99, 99, 99, 99, 99,
    47, 66, 99, 99, 99, 99, 99, 99, //
    99, 99, 99, 99, 99, 99, 99, 99, 99, 99, 99, 99, 99, 99, 99, 99, 99, 99, 99, 99, 99, 99, 99, 99,
    99, 99, 99, 99, 99, 99, 99, 99,
];

/// A Huffman table as a file has it: the number of codes of 1, 2, ... 16 bits, and their symbols.
#[derive(Debug)]
pub(super) struct Huffman {
    pub(super) lengths: [u8; 16],
    pub(super) symbols: &'static [u8],
}

/// The tables of luminance and of chrominance.
pub(super) static DC: [Huffman; 2] = [
    Huffman {
        lengths: [0, 1, 5, 1, 1, 1, 1, 1, 1, 0, 0, 0, 0, 0, 0, 0],
        symbols: &[0, 1, 2, 3, 4, 5, 6, 7, 8, 9, 10, 11],
    },
    Huffman {
        lengths: [0, 3, 1, 1, 1, 1, 1, 1, 1, 1, 1, 0, 0, 0, 0, 0],
        symbols: &[0, 1, 2, 3, 4, 5, 6, 7, 8, 9, 10, 11],
    },
];

/// The tables of luminance and of chrominance. A symbol is `run of zeros << 4 | bits of the value`.
pub(super) static AC: [Huffman; 2] = [
    Huffman {
        lengths: [0, 2, 1, 3, 3, 2, 4, 3, 5, 5, 4, 4, 0, 0, 1, 0x7d],
        symbols: &[
            0x01, 0x02, 0x03, 0x00, 0x04, 0x11, 0x05, 0x12, 0x21, 0x31, 0x41, 0x06, 0x13, 0x51,
            0x61, 0x07, 0x22, 0x71, 0x14, 0x32, 0x81, 0x91, 0xa1, 0x08, 0x23, 0x42, 0xb1, 0xc1,
            0x15, 0x52, 0xd1, 0xf0, 0x24, 0x33, 0x62, 0x72, 0x82, 0x09, 0x0a, 0x16, 0x17, 0x18,
            0x19, 0x1a, 0x25, 0x26, 0x27, 0x28, 0x29, 0x2a, 0x34, 0x35, 0x36, 0x37, 0x38, 0x39,
            0x3a, 0x43, 0x44, 0x45, 0x46, 0x47, 0x48, 0x49, 0x4a, 0x53, 0x54, 0x55, 0x56, 0x57,
            0x58, 0x59, 0x5a, 0x63, 0x64, 0x65, 0x66, 0x67, 0x68, 0x69, 0x6a, 0x73, 0x74, 0x75,
            0x76, 0x77, 0x78, 0x79, 0x7a, 0x83, 0x84, 0x85, 0x86, 0x87, 0x88, 0x89, 0x8a, 0x92,
            0x93, 0x94, 0x95, 0x96, 0x97, 0x98, 0x99, 0x9a, 0xa2, 0xa3, 0xa4, 0xa5, 0xa6, 0xa7,
            0xa8, 0xa9, 0xaa, 0xb2, 0xb3, 0xb4, 0xb5, 0xb6, 0xb7, 0xb8, 0xb9, 0xba, 0xc2, 0xc3,
            0xc4, 0xc5, 0xc6, 0xc7, 0xc8, 0xc9, 0xca, 0xd2, 0xd3, 0xd4, 0xd5, 0xd6, 0xd7, 0xd8,
            0xd9, 0xda, 0xe1, 0xe2, 0xe3, 0xe4, 0xe5, 0xe6, 0xe7, 0xe8, 0xe9, 0xea, 0xf1, 0xf2,
            0xf3, 0xf4, 0xf5, 0xf6, 0xf7, 0xf8, 0xf9, 0xfa,
        ],
    },
    Huffman {
        lengths: [0, 2, 1, 2, 4, 4, 3, 4, 7, 5, 4, 4, 0, 1, 2, 0x77],
        symbols: &[
            0x00, 0x01, 0x02, 0x03, 0x11, 0x04, 0x05, 0x21, 0x31, 0x06, 0x12, 0x41, 0x51, 0x07,
            0x61, 0x71, 0x13, 0x22, 0x32, 0x81, 0x08, 0x14, 0x42, 0x91, 0xa1, 0xb1, 0xc1, 0x09,
            0x23, 0x33, 0x52, 0xf0, 0x15, 0x62, 0x72, 0xd1, 0x0a, 0x16, 0x24, 0x34, 0xe1, 0x25,
            0xf1, 0x17, 0x18, 0x19, 0x1a, 0x26, 0x27, 0x28, 0x29, 0x2a, 0x35, 0x36, 0x37, 0x38,
            0x39, 0x3a, 0x43, 0x44, 0x45, 0x46, 0x47, 0x48, 0x49, 0x4a, 0x53, 0x54, 0x55, 0x56,
            0x57, 0x58, 0x59, 0x5a, 0x63, 0x64, 0x65, 0x66, 0x67, 0x68, 0x69, 0x6a, 0x73, 0x74,
            0x75, 0x76, 0x77, 0x78, 0x79, 0x7a, 0x82, 0x83, 0x84, 0x85, 0x86, 0x87, 0x88, 0x89,
            0x8a, 0x92, 0x93, 0x94, 0x95, 0x96, 0x97, 0x98, 0x99, 0x9a, 0xa2, 0xa3, 0xa4, 0xa5,
            0xa6, 0xa7, 0xa8, 0xa9, 0xaa, 0xb2, 0xb3, 0xb4, 0xb5, 0xb6, 0xb7, 0xb8, 0xb9, 0xba,
            0xc2, 0xc3, 0xc4, 0xc5, 0xc6, 0xc7, 0xc8, 0xc9, 0xca, 0xd2, 0xd3, 0xd4, 0xd5, 0xd6,
            0xd7, 0xd8, 0xd9, 0xda, 0xe2, 0xe3, 0xe4, 0xe5, 0xe6, 0xe7, 0xe8, 0xe9, 0xea, 0xf2,
            0xf3, 0xf4, 0xf5, 0xf6, 0xf7, 0xf8, 0xf9, 0xfa,
        ],
    },
];

impl Huffman {
    /// `(code, length)` of every symbol (T.81, Annex C); a symbol that the table lacks has length
    /// 0.
    pub(super) fn codes(&self) -> [(u16, u8); 256] {
        let mut codes = [(0, 0); 256];
        let (mut code, mut symbols) = (0, self.symbols.iter());
        for (length, count) in (1..).zip(self.lengths) {
            for symbol in symbols.by_ref().take(usize::from(count)) {
                codes[usize::from(*symbol)] = (code, length);
                code += 1;
            }
            code <<= 1;
        }
        codes
    }
}

/// The quantisation tables of luminance and chrominance for a quality from 1 to 100, in rows.
pub(super) fn quantisation(quality: u8) -> [[u8; BLOCK]; 2] {
    let quality = u32::from(quality.clamp(1, 100));
    let percent = if quality < 50 {
        5000 / quality
    } else {
        200 - 2 * quality
    };
    let scaled = |step: u8| ((u32::from(step) * percent + 50) / 100).clamp(1, 255) as u8;
    [LUMA.map(scaled), CHROMA.map(scaled)]
}

const fn zigzag() -> [u8; BLOCK] {
    let mut order = [0; BLOCK];
    let (mut x, mut y, mut k) = (0_u8, 0_u8, 0);
    while k < BLOCK {
        order[k] = y * 8 + x;
        let rises = (x + y).is_multiple_of(2);
        if rises && x == 7 || !rises && y == 7 {
            if rises { y += 1 } else { x += 1 }
        } else if rises {
            x += 1;
            y = y.saturating_sub(1);
        } else {
            y += 1;
            x = x.saturating_sub(1);
        }
        k += 1;
    }
    order
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_order_is_that_of_the_standard() {
        assert_eq!(
            ZIGZAG[..16],
            [0, 1, 8, 16, 9, 2, 3, 10, 17, 24, 32, 25, 18, 11, 4, 5]
        );
        assert_eq!(
            ZIGZAG[48..],
            [
                58, 59, 52, 45, 38, 31, 39, 46, 53, 60, 61, 54, 47, 55, 62, 63
            ]
        );
        let mut sorted = ZIGZAG;
        sorted.sort_unstable();
        assert!(sorted.iter().zip(0..).all(|(a, b)| *a == b));
    }

    #[test]
    fn codes_are_those_of_the_standard() {
        for table in DC.iter().chain(&AC) {
            assert_eq!(
                table
                    .lengths
                    .iter()
                    .map(|count| usize::from(*count))
                    .sum::<usize>(),
                table.symbols.len()
            );
            // A code of ones only is not allowed; the others fill the tree.
            let taken: u32 = (1..)
                .zip(table.lengths)
                .map(|(length, count)| u32::from(count) << (16 - length))
                .sum();
            assert!(taken < 1 << 16, "{taken}");
        }
        // Tables K.3 to K.6.
        let [dc, ac] = [&DC, &AC].map(|tables| tables.each_ref().map(Huffman::codes));
        assert_eq!(
            (dc[0][0], dc[0][11], dc[1][0], dc[1][11]),
            ((0, 2), (0x1fe, 9), (0, 2), (0x7fe, 11))
        );
        assert_eq!(
            (ac[0][0x00], ac[0][0xf0], ac[0][0x01], ac[0][0xfa]),
            ((0b1010, 4), (0x7f9, 11), (0, 2), (0xfffe, 16))
        );
        assert_eq!(
            (ac[1][0x00], ac[1][0xf0], ac[1][0x01], ac[1][0xfa]),
            ((0, 2), (0x3fa, 10), (1, 2), (0xfffe, 16))
        );
        for codes in &ac {
            let known = (0..=255).filter(|symbol| codes[*symbol].1 > 0);
            assert!(known.eq(
                (0..=255).filter(
                    |symbol| [0, 0xf0].contains(symbol) || (1..=10).contains(&(symbol & 15))
                )
            ));
        }
    }

    #[test]
    fn quality_scales_the_steps() {
        assert_eq!(quantisation(50), [LUMA, CHROMA]);
        assert_eq!(quantisation(100), [[1; BLOCK]; 2]);
        assert_eq!(quantisation(1), [[255; BLOCK]; 2]);
        assert_eq!(
            (
                quantisation(85)[0][0],
                quantisation(85)[1][63],
                quantisation(25)[0][1]
            ),
            (5, 30, 22)
        );
    }
}
