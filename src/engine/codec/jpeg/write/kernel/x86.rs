//! What AVX2 and AVX-512 have in common: every operation that stays within 128 bits, which are a
//! row or a column of a block.

/// Implements `I16Lanes` for a type of `count` lanes by the instructions that are named; `own`: the
/// methods in which the levels differ.
macro_rules! lanes {
    (
        $name:ident($register:ty), $count:expr, set: $set:ident, load: $load:ident,
        add: $add:ident, sub: $sub:ident,
        times: $times:ident, high: $high:ident, mean: $mean:ident, low: $low:ident,
            left: $left:ident, right: $right:ident,
        unpack: [$low16:ident, $high16:ident, $low32:ident, $high32:ident, $low64:ident,
            $high64:ident],
        own: { $($own:item)* }
    ) => {
        // SAFETY of every block here: `encode` alone uses this type, where the processor has the
        // level; pointers are those of references.
        impl I16Lanes for $name {
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
            fn coefficients(
                rows: &[Self; 8],
                quantiser: &Quantiser,
                blocks: &mut [QuantisedBlock],
            ) {
                strip::coefficients(*rows, quantiser, blocks);
            }

            #[inline(always)]
            fn plus(self, other: Self) -> Self {
                Self(unsafe { $add(self.0, other.0) })
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
                    let (ae, be) = ([$low16(a.0, b.0), $high16(a.0, b.0)],
                        [$low16(c.0, d.0), $high16(c.0, d.0)]);
                    let (ce, de) = ([$low16(e.0, f.0), $high16(e.0, f.0)],
                        [$low16(g.0, h.0), $high16(g.0, h.0)]);
                    let mut columns = [a; 8];
                    for half in 0..2 {
                        let (top, bottom) = ([$low32(ae[half], be[half]),
                            $high32(ae[half], be[half])], [$low32(ce[half], de[half]),
                                $high32(ce[half], de[half])]);
                        for pair in 0..2 {
                            columns[4 * half + 2 * pair] = Self($low64(top[pair], bottom[pair]));
                            columns[4 * half + 2 * pair + 1] = Self($high64(top[pair],
                                bottom[pair]));
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
