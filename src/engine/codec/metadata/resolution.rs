//! The resolution of an image: pixels per unit of length along both axes, as exact ratios, so that
//! a number that a file does not change is the same in the next file.

use crate::pixmap::Extent;

/// The relative error up to which a whole number stands for a resolution.
const RATIONAL_TOLERANCE: f64 = 1e-4;

/// A positive fraction.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Ratio {
    /// Above the line.
    pub numerator: u32,
    /// Below the line.
    pub denominator: u32,
}

impl Ratio {
    /// `None` if one of them is zero.
    #[must_use]
    pub const fn new(numerator: u32, denominator: u32) -> Option<Self> {
        if numerator == 0 || denominator == 0 {
            None
        } else {
            Some(Self {
                numerator,
                denominator,
            })
        }
    }

    /// The ratio, or the last convergent of its continued fraction that 32 bits hold; `None` beyond
    /// their range.
    fn nearest(mut numerator: u128, mut denominator: u128) -> Option<Self> {
        let (mut last, mut next) = ([1, 0], [0, 1]);
        while denominator != 0 {
            let whole = numerator / denominator;
            (numerator, denominator) = (denominator, numerator % denominator);
            let convergent = [0, 1].map(|k| last[k] * whole + next[k]);
            if convergent.iter().any(|number| *number > u32::MAX.into()) {
                break;
            }
            (last, next) = (convergent, last);
        }
        Self::new(u32::try_from(last[0]).ok()?, u32::try_from(last[1]).ok()?)
    }

    fn times(self, numerator: u32, denominator: u32) -> Option<Self> {
        if numerator == denominator {
            return Some(self);
        }
        let product = |a: u32, b: u32| u128::from(a) * u128::from(b);
        Self::nearest(
            product(self.numerator, numerator),
            product(self.denominator, denominator),
        )
    }

    fn value(self) -> f64 {
        f64::from(self.numerator) / f64::from(self.denominator)
    }

    /// The nearest whole number from 1 to `most`, and whether it is near.
    fn whole(self, most: u32) -> Option<(u32, bool)> {
        let rounded = self.value().round();
        let fits = (1.0..=f64::from(most)).contains(&rounded);
        #[expect(
            clippy::cast_possible_truncation,
            clippy::cast_sign_loss,
            reason = "within the range"
        )]
        fits.then_some((
            rounded as u32,
            (rounded - self.value()).abs() <= RATIONAL_TOLERANCE * self.value(),
        ))
    }
}

/// The unit of length of a resolution.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum ResolutionUnit {
    /// Unknown: the resolution tells the shape of a pixel, or its unit is in a description.
    Unknown,
    /// 25.4 mm.
    Inch,
    /// 10 mm.
    Centimetre,
    /// 1000 mm.
    Metre,
}

impl ResolutionUnit {
    /// Length, in tenths of a millimetre.
    const fn length(self) -> u32 {
        match self {
            Self::Unknown => 1,
            Self::Inch => 254,
            Self::Centimetre => 100,
            Self::Metre => 10_000,
        }
    }
}

/// Pixels per unit of length.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Resolution {
    /// Along a row.
    pub x: Ratio,
    /// Along a column.
    pub y: Ratio,
    /// The unit.
    pub unit: ResolutionUnit,
}

impl Resolution {
    /// Square pixels of no known size.
    pub const SQUARE: Self = {
        let one = Ratio {
            numerator: 1,
            denominator: 1,
        };
        Self {
            x: one,
            y: one,
            unit: ResolutionUnit::Unknown,
        }
    };

    /// One of whole numbers; `None` if one of them is zero, or if it says nothing.
    #[must_use]
    pub fn whole(x: u32, y: u32, unit: ResolutionUnit) -> Option<Self> {
        let this = Self {
            x: Ratio::new(x, 1)?,
            y: Ratio::new(y, 1)?,
            unit,
        };
        (unit != ResolutionUnit::Unknown || (x, y) != (1, 1)).then_some(this)
    }

    /// That of the image with its sides swapped.
    #[must_use]
    pub const fn swapped(self) -> Self {
        Self {
            x: self.y,
            y: self.x,
            unit: self.unit,
        }
    }

    /// That of an image of `target` pixels which shows `canvas` pixels of this one; `None` beyond
    /// the range.
    #[must_use]
    pub fn scaled(self, target: Extent, canvas: Extent) -> Option<Self> {
        let (x, y) = (
            self.x.times(target.width(), canvas.width())?,
            self.y.times(target.height(), canvas.height())?,
        );
        Some(Self {
            x,
            y,
            unit: self.unit,
        })
    }

    /// The same resolution in another unit; one of unknown unit stays as it is.
    #[must_use]
    pub fn in_unit(self, unit: ResolutionUnit) -> Option<Self> {
        if self.unit == ResolutionUnit::Unknown {
            return Some(self);
        }
        let (x, y) = (
            self.x.times(unit.length(), self.unit.length())?,
            self.y.times(unit.length(), self.unit.length())?,
        );
        Some(Self { x, y, unit })
    }

    /// The nearest whole numbers of at most `most` pixels per unit, and whether they are near.
    #[must_use]
    pub fn rounded(self, most: u32) -> Option<([u32; 2], bool)> {
        let ((x, x_is_near), (y, y_is_near)) = (self.x.whole(most)?, self.y.whole(most)?);
        Some(([x, y], x_is_near && y_is_near))
    }

    /// Whether these whole numbers are those of an exact resolution.
    #[must_use]
    pub fn is_rounded(self, exact: Self) -> bool {
        let rounded = exact
            .in_unit(self.unit)
            .and_then(|exact| exact.rounded(u32::MAX));
        rounded.is_some_and(|([x, y], _)| Self::whole(x, y, self.unit) == Some(self))
    }

    /// Pixels per millimetre along both axes; those per unit if that is unknown.
    #[must_use]
    pub fn per_millimetre(self) -> [f64; 2] {
        let unit = match self.unit {
            ResolutionUnit::Unknown => 1.0,
            unit @ (ResolutionUnit::Inch | ResolutionUnit::Centimetre | ResolutionUnit::Metre) => {
                f64::from(unit.length()) / 10.0
            }
        };
        [self.x.value() / unit, self.y.value() / unit]
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn extent(width: u32, height: u32) -> Extent {
        Extent::new(width, height).unwrap()
    }

    #[test]
    fn a_resolution_that_nothing_changes_is_the_same_fraction() {
        let odd = Resolution {
            x: Ratio::new(720_000, 10_000).unwrap(),
            y: Ratio::new(5, 2).unwrap(),
            unit: ResolutionUnit::Inch,
        };
        assert_eq!(odd.scaled(extent(70, 50), extent(70, 50)), Some(odd));
        assert_eq!(odd.in_unit(ResolutionUnit::Inch), Some(odd));
        assert_eq!(odd.swapped().swapped(), odd);
    }

    /// px per mm times the scale, whatever the numbers.
    #[test]
    fn scaling_and_other_units_keep_the_length_of_a_pixel() {
        let numbers = [1, 2, 3, 72, 300, 11_811, 65_537, 40_000_019, u32::MAX];
        for (k, numerator) in numbers.into_iter().enumerate() {
            for denominator in numbers {
                let x = Ratio::new(numerator, denominator).unwrap();
                let y = Ratio::new(numbers[numbers.len() - 1 - k], denominator).unwrap();
                for unit in [
                    ResolutionUnit::Inch,
                    ResolutionUnit::Centimetre,
                    ResolutionUnit::Metre,
                ] {
                    let source = Resolution { x, y, unit };
                    for (target, canvas) in [
                        ((300, 200), (900, 601)),
                        ((16_384, 3), (7, 16_384)),
                        ((1, 1), (16_384, 16_384)),
                    ] {
                        let (target, canvas) =
                            (extent(target.0, target.1), extent(canvas.0, canvas.1));
                        let Some(scaled) = source.scaled(target, canvas) else {
                            continue;
                        };
                        for unit in [
                            ResolutionUnit::Inch,
                            ResolutionUnit::Centimetre,
                            ResolutionUnit::Metre,
                        ] {
                            let Some(other) = scaled.in_unit(unit) else {
                                continue;
                            };
                            let scale = [
                                f64::from(target.width()) / f64::from(canvas.width()),
                                f64::from(target.height()) / f64::from(canvas.height()),
                            ];
                            let axes = source
                                .per_millimetre()
                                .into_iter()
                                .zip(scale)
                                .zip(other.per_millimetre());
                            for ((was, scale), is) in axes {
                                let want = was * scale;
                                let far = (is / want - 1.0).abs();
                                assert!(
                                    far < 1e-5 || !(1e-4..=1e8).contains(&want),
                                    "{source:?} {target:?} {canvas:?}: {other:?}"
                                );
                            }
                        }
                    }
                }
            }
        }
    }

    #[test]
    fn whole_numbers_say_whether_they_are_near() {
        let dpi = |numerator, denominator| {
            let ratio = Ratio::new(numerator, denominator).unwrap();
            Resolution {
                x: ratio,
                y: ratio,
                unit: ResolutionUnit::Metre,
            }
            .in_unit(ResolutionUnit::Inch)
            .and_then(|dpi| dpi.rounded(65_535))
        };
        assert_eq!(dpi(11_811, 1), Some(([300, 300], true)));
        assert_eq!(dpi(2_854, 1), Some(([72, 72], false)), "72.49 per inch");
        assert_eq!(dpi(1, 1), None, "less than one pixel per inch");
        assert_eq!(dpi(u32::MAX, 1), None, "more than 65535");
        assert_eq!(Resolution::whole(1, 1, ResolutionUnit::Unknown), None);
        assert!(Resolution::whole(1, 2, ResolutionUnit::Unknown).is_some());
        assert_eq!(Resolution::whole(0, 300, ResolutionUnit::Inch), None);
    }
}
