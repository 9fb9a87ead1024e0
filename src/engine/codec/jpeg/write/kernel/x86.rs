//! What AVX2 and AVX-512 have in common: every operation that stays within 128 bits, which are a row or a column of a block.

use crate::codec::jpeg::write::tables::{BLOCK, SIDE, ZIGZAG};

/// By group of eight coefficients in the order of a file, and by column of the block: the bytes of the column that go there.
pub(super) static SHUFFLES: [[[u8; 2 * SIDE]; SIDE]; SIDE] = shuffles();

const fn shuffles() -> [[[u8; 2 * SIDE]; SIDE]; SIDE] {
    /// Gives zero.
    const NOTHING: u8 = 0x80;
    let mut shuffles = [[[NOTHING; 2 * SIDE]; SIDE]; SIDE];
    let mut k = 0;
    while k < BLOCK {
        let (x, y) = (ZIGZAG[k] as usize % SIDE, ZIGZAG[k] / 8);
        shuffles[k / SIDE][x][k % SIDE * 2] = 2 * y;
        shuffles[k / SIDE][x][k % SIDE * 2 + 1] = 2 * y + 1;
        k += 1;
    }
    shuffles
}

/// Implements `Lanes` for a type of `count` lanes by the instructions that are named; `own`: the methods in which the levels differ.
macro_rules! lanes {
    (
        $name:ident($register:ty), $count:expr, set: $set:ident, load: $load:ident, zero: $zero:ident, add: $add:ident, saturate: $saturate:ident, sub: $sub:ident,
        times: $times:ident, high: $high:ident, mean: $mean:ident, low: $low:ident, left: $left:ident, right: $right:ident, or: $or:ident, shuffle: $shuffle:ident,
        row: $row:ident, unpack: [$low16:ident, $high16:ident, $low32:ident, $high32:ident, $low64:ident, $high64:ident],
        own: { $($own:item)* }
    ) => {
        impl $name {
            /// One group of coefficients in the order of a file, from the columns that have some.
            #[inline(always)]
            fn group<const N: usize>(columns: &[Self; 8], group: usize, from: [usize; N]) -> $register {
                // SAFETY: `encode` alone uses this type, where the processor has the level.
                unsafe {
                    let mut joined = $zero();
                    for x in from {
                        let order = $row(_mm_loadu_si128(SHUFFLES[group][x].as_ptr().cast()));
                        joined = $or(joined, $shuffle(columns[x].0, order));
                    }
                    joined
                }
            }

            /// All groups.
            #[inline(always)]
            fn in_order(columns: &[Self; 8]) -> [$register; 8] {
                [
                    Self::group(columns, 0, [0, 1, 2, 3]),
                    Self::group(columns, 1, [0, 1, 2, 3, 4, 5]),
                    Self::group(columns, 2, [0, 1, 2, 3, 4]),
                    Self::group(columns, 3, [3, 4, 5, 6, 7]),
                    Self::group(columns, 4, [0, 1, 2, 3, 4]),
                    Self::group(columns, 5, [3, 4, 5, 6, 7]),
                    Self::group(columns, 6, [2, 3, 4, 5, 6, 7]),
                    Self::group(columns, 7, [4, 5, 6, 7]),
                ]
            }
        }

        // SAFETY of every block here: `encode` alone uses this type, where the processor has the level; pointers are those of references.
        impl Lanes for $name {
            const COUNT: usize = $count;

            #[inline(always)]
            fn all(value: i16) -> Self {
                Self(unsafe { $set(value) })
            }

            #[inline(always)]
            fn load(values: &[i16; MOST_LANES]) -> Self {
                Self(unsafe { $load(values.as_ptr().cast()) })
            }

            #[inline(always)]
            fn plus(self, other: Self) -> Self {
                Self(unsafe { $add(self.0, other.0) })
            }

            #[inline(always)]
            fn plus_saturating(self, other: Self) -> Self {
                Self(unsafe { $saturate(self.0, other.0) })
            }

            #[inline(always)]
            fn minus(self, other: Self) -> Self {
                Self(unsafe { $sub(self.0, other.0) })
            }

            #[inline(always)]
            fn times(self, other: Self) -> Self {
                Self(unsafe { $times(self.0, other.0) })
            }

            #[inline(always)]
            fn times_high(self, other: Self) -> Self {
                Self(unsafe { $high(self.0, other.0) })
            }

            #[inline(always)]
            fn mean(self, other: Self) -> Self {
                Self(unsafe { $mean(self.0, other.0) })
            }

            #[inline(always)]
            fn times_low(self, other: Self) -> Self {
                Self(unsafe { $low(self.0, other.0) })
            }

            #[inline(always)]
            fn shift_left<const BITS: u32>(self) -> Self {
                Self(unsafe { $left(self.0, _mm_cvtsi32_si128(BITS.cast_signed())) })
            }

            #[inline(always)]
            fn shift_right<const BITS: u32>(self) -> Self {
                Self(unsafe { $right(self.0, _mm_cvtsi32_si128(BITS.cast_signed())) })
            }

            #[inline(always)]
            fn transpose([a, b, c, d, e, f, g, h]: [Self; 8]) -> [Self; 8] {
                unsafe {
                    let (ae, be) = ([$low16(a.0, b.0), $high16(a.0, b.0)], [$low16(c.0, d.0), $high16(c.0, d.0)]);
                    let (ce, de) = ([$low16(e.0, f.0), $high16(e.0, f.0)], [$low16(g.0, h.0), $high16(g.0, h.0)]);
                    let mut columns = [a; 8];
                    for half in 0..2 {
                        let (top, bottom) = ([$low32(ae[half], be[half]), $high32(ae[half], be[half])], [$low32(ce[half], de[half]), $high32(ce[half], de[half])]);
                        for pair in 0..2 {
                            columns[4 * half + 2 * pair] = Self($low64(top[pair], bottom[pair]));
                            columns[4 * half + 2 * pair + 1] = Self($high64(top[pair], bottom[pair]));
                        }
                    }
                    columns
                }
            }

            $($own)*
        }
    };
}
pub(super) use lanes;

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn every_column_of_a_group_is_named() {
        // The lists of `in_order`.
        let named: [&[usize]; SIDE] = [
            &[0, 1, 2, 3],
            &[0, 1, 2, 3, 4, 5],
            &[0, 1, 2, 3, 4],
            &[3, 4, 5, 6, 7],
            &[0, 1, 2, 3, 4],
            &[3, 4, 5, 6, 7],
            &[2, 3, 4, 5, 6, 7],
            &[4, 5, 6, 7],
        ];
        for (shuffles, named) in SHUFFLES.iter().zip(named) {
            let used: Vec<usize> = (0..SIDE).filter(|x| shuffles[*x].iter().any(|byte| *byte < 0x80)).collect();
            assert_eq!(used, named);
        }
    }
}
