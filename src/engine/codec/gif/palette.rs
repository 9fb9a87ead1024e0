//! The colours of one GIF frame, and which of them each pixel gets.
//!
//! A frame of few colours keeps them. Otherwise the colours are divided into boxes, always by the
//! cut that lowers the sum of squared errors most (X. Wu, "Color quantization by dynamic
//! programming and principal analysis", ACM Transactions on Graphics 11(4), 1992, greedy form), and
//! each box is replaced by its mean. A pixel between two colours of the palette gets one or the
//! other by an ordered pattern (B. E. Bayer, 1973), which depends on its place alone: so what does
//! not move does not flicker, and like frames get like palettes.
//!
//! Sums are integers and everything runs on one thread, so that every machine finds the same
//! palette.

use std::collections::HashMap;

/// The most colours of a frame.
pub(super) const MOST_COLOURS: usize = 256;
/// Cells of the table of colours along each channel: one per eight values, and an empty one before
/// them.
const SIDE: usize = 33;
/// How much a difference of each channel is seen.
const CHANNEL_VISIBILITY: [i32; 3] = [2, 4, 3];
/// Two colours farther apart than this are never mixed, in every channel: single pixels of the
/// other colour would be seen.
const MOST_MIXED: i32 = 20;
/// Pixels between two calls of `wanted`.
const PIXELS_PER_CHECK: usize = 1 << 16;
/// Memory for the palette of a frame, bytes: the sums, and the nearest colours.
pub(super) const WORK_BYTES: u64 =
    ((SIDE * SIDE * SIDE * size_of::<ColourSums>()) + 2 * NEAREST_ENTRIES) as u64;
/// Entries of the table of nearest colours: one per four values along each channel.
const NEAREST_ENTRIES: usize = 1 << 18;

pub(super) type Rgb = [u8; 3];

/// The colours of a frame.
#[derive(Debug)]
pub(super) struct GifPalette {
    /// From dark to light.
    colours: Vec<Rgb>,
    /// Whether these are all colours of the frame.
    is_exact: bool,
}

/// The pixels of colours: their number, the sums of their channels, and the weighted sum of their
/// squares.
#[derive(Clone, Copy, Default)]
struct ColourSums {
    count: i64,
    channels: [i64; 3],
}

impl ColourSums {
    fn plus(self, other: Self, sign: i64) -> Self {
        let channels = std::array::from_fn(|k| self.channels[k] + sign * other.channels[k]);
        Self {
            count: self.count + sign * other.count,
            channels,
        }
    }

    /// How much the mean of these pixels explains of their squares; what it leaves is their squared
    /// error.
    fn explained(self) -> f64 {
        let sum: f64 = (0..3)
            .map(|k| {
                f64::from(CHANNEL_VISIBILITY[k]) * self.channels[k] as f64 * self.channels[k] as f64
            })
            .sum();
        if self.count == 0 {
            0.0
        } else {
            sum / self.count as f64
        }
    }

    fn mean(self) -> Rgb {
        let count = self.count.max(1);
        self.channels
            .map(|sum| u8::try_from((sum + count / 2) / count).unwrap_or(u8::MAX))
    }
}

/// Cells after the lower corner, up to the upper one.
#[derive(Clone, Copy)]
struct Box3 {
    low: [usize; 3],
    high: [usize; 3],
}

/// The best division of a box, and what it explains more than the box.
#[derive(Clone, Copy)]
struct Cut {
    parts: [Box3; 2],
    gain: f64,
}

/// The sums of all cells below each corner.
struct CumulativeSums(Vec<ColourSums>);

const fn index([r, g, b]: [usize; 3]) -> usize {
    (r * SIDE + g) * SIDE + b
}

impl CumulativeSums {
    fn of(pixels: impl Iterator<Item = Rgb>, wanted: &dyn Fn() -> bool) -> Self {
        let mut table = vec![ColourSums::default(); SIDE * SIDE * SIDE];
        for (k, colour) in pixels.enumerate() {
            if k % PIXELS_PER_CHECK == 0 && !wanted() {
                break;
            }
            let cell = &mut table[index(colour.map(|value| usize::from(value >> 3) + 1))];
            *cell = cell.plus(
                ColourSums {
                    count: 1,
                    channels: colour.map(i64::from),
                },
                1,
            );
        }
        for stride in [1, SIDE, SIDE * SIDE] {
            for at in stride..table.len() {
                // The first cell of each row is empty.
                if at / stride % SIDE > 0 {
                    table[at] = table[at].plus(table[at - stride], 1);
                }
            }
        }
        Self(table)
    }

    fn sums(&self, Box3 { low, high }: Box3) -> ColourSums {
        (0..8).fold(ColourSums::default(), |sums, corner: usize| {
            let is_low = |k: usize| corner >> k & 1 == 1;
            let sign = if corner.count_ones().is_multiple_of(2) {
                1
            } else {
                -1
            };
            sums.plus(
                self.0[index(std::array::from_fn(|k| {
                    if is_low(k) { low[k] } else { high[k] }
                }))],
                sign,
            )
        })
    }

    fn cut(&self, whole: Box3) -> Option<Cut> {
        let all = self.sums(whole);
        let mut best: Option<Cut> = None;
        for channel in 0..3 {
            for at in whole.low[channel] + 1..whole.high[channel] {
                let (mut below, mut above) = (whole, whole);
                (below.high[channel], above.low[channel]) = (at, at);
                let part = self.sums(below);
                let gain = part.explained() + all.plus(part, -1).explained() - all.explained();
                if part.count > 0
                    && part.count < all.count
                    && gain > best.map_or(0.0, |best| best.gain)
                {
                    best = Some(Cut {
                        parts: [below, above],
                        gain,
                    });
                }
            }
        }
        best
    }
}

impl GifPalette {
    /// The colours of the opaque pixels, at most `most`.
    pub(super) fn of(
        pixels: impl Iterator<Item = Rgb> + Clone,
        most: usize,
        wanted: &dyn Fn() -> bool,
    ) -> Self {
        if let Some(colours) = all_colours(pixels.clone(), most, wanted) {
            return Self {
                colours,
                is_exact: true,
            };
        }
        let table = CumulativeSums::of(pixels, wanted);
        let whole = Box3 {
            low: [0; 3],
            high: [SIDE - 1; 3],
        };
        let mut boxes = vec![(whole, table.cut(whole))];
        while boxes.len() < most && wanted() {
            let cuts = boxes
                .iter()
                .enumerate()
                .filter_map(|(k, (_, cut))| Some((k, (*cut)?)));
            let best = cuts.reduce(|best, next| {
                if next.1.gain > best.1.gain {
                    next
                } else {
                    best
                }
            });
            let Some((
                k,
                Cut {
                    parts: [below, above],
                    ..
                },
            )) = best
            else {
                break;
            };
            boxes[k] = (below, table.cut(below));
            boxes.push((above, table.cut(above)));
        }
        let mut colours: Vec<Rgb> = boxes
            .iter()
            .map(|(part, _)| table.sums(*part).mean())
            .collect();
        sort(&mut colours);
        Self {
            colours,
            is_exact: false,
        }
    }

    pub(super) fn colours(&self) -> &[Rgb] {
        &self.colours
    }

    /// The index of each pixel of a row, in order of rows.
    pub(super) fn indexer(&self) -> Indexer<'_> {
        let exact = self
            .colours
            .iter()
            .zip(0..=u8::MAX)
            .map(|(colour, index)| (*colour, index));
        let exact = if self.is_exact {
            exact.collect()
        } else {
            HashMap::new()
        };
        Indexer {
            palette: self,
            exact,
            nearest: vec![NO_COLOUR; if self.is_exact { 0 } else { NEAREST_ENTRIES }],
        }
    }

    /// The nearest colour.
    fn nearest(&self, colour: [i32; 3]) -> u8 {
        let distance = |own: &Rgb| square(std::array::from_fn(|k| i32::from(own[k]) - colour[k]));
        // One number for both: this is the inner loop.
        let keys = self
            .colours
            .iter()
            .zip(0..)
            .map(|(own, index)| distance(own) << 8 | index);
        keys.min().map_or(0, |key| key.to_le_bytes()[0])
    }
}

/// The colours, if there are no more than `most`.
fn all_colours(
    pixels: impl Iterator<Item = Rgb>,
    most: usize,
    wanted: &dyn Fn() -> bool,
) -> Option<Vec<Rgb>> {
    let mut seen = HashMap::new();
    let mut last = None;
    for (k, colour) in pixels.enumerate() {
        if k % PIXELS_PER_CHECK == 0 && !wanted() {
            break;
        }
        if last != Some(colour) {
            last = Some(colour);
            seen.insert(colour, ());
            if seen.len() > most {
                return None;
            }
        }
    }
    let mut colours: Vec<Rgb> = seen.into_keys().collect();
    sort(&mut colours);
    Some(colours)
}

fn sort(colours: &mut Vec<Rgb>) {
    colours.sort_unstable_by_key(|colour| (product(colour.map(i32::from), [1; 3]), *colour));
    colours.dedup();
}

/// The weighted product of two differences.
fn product(a: [i32; 3], b: [i32; 3]) -> i32 {
    (0..3).map(|k| CHANNEL_VISIBILITY[k] * a[k] * b[k]).sum()
}

fn square(a: [i32; 3]) -> i32 {
    product(a, a)
}

fn difference(a: Rgb, b: Rgb) -> [i32; 3] {
    std::array::from_fn(|k| i32::from(a[k]) - i32::from(b[k]))
}

/// No colour of a palette with room for a transparent one.
const NO_COLOUR: u16 = u16::MAX;

/// Finds the colours of pixels.
pub(super) struct Indexer<'a> {
    palette: &'a GifPalette,
    exact: HashMap<Rgb, u8>,
    /// By the high six bits of each channel; filled as they are needed.
    nearest: Vec<u16>,
}

impl Indexer<'_> {
    /// The index of the colour of a pixel.
    pub(super) fn index(&mut self, colour: Rgb, x: usize, y: usize) -> u8 {
        if self.palette.is_exact {
            return self.exact.get(&colour).copied().unwrap_or_default();
        }
        let own = colour.map(i32::from);
        let near = self.nearest(own);
        let off = difference(colour, self.palette.colours[usize::from(near)]);
        // The colour on the other side of the pixel's.
        let mut beyond = |step: i32| self.nearest(std::array::from_fn(|k| own[k] + step * off[k]));
        let Some(far) = [1, 2, 4]
            .into_iter()
            .map(&mut beyond)
            .find(|far| *far != near)
        else {
            return near;
        };
        let [dark, light] = [near.min(far), near.max(far)];
        let base = self.palette.colours[usize::from(dark)];
        let way = difference(self.palette.colours[usize::from(light)], base);
        if square(way) > square([MOST_MIXED; 3]) {
            return near;
        }
        // The share of the way from the dark colour to the light one, against a threshold.
        let is_light =
            product(way, difference(colour, base)) * 128 > square(way) * (2 * threshold(x, y) + 1);
        if is_light { light } else { dark }
    }

    fn nearest(&mut self, colour: [i32; 3]) -> u8 {
        let colour = colour.map(|value| value.clamp(0, 255));
        let [r, g, b] = colour.map(|value| usize::try_from(value >> 2).unwrap_or_default());
        let entry = &mut self.nearest[r << 12 | g << 6 | b];
        if *entry == NO_COLOUR {
            // The middle of the values of this entry.
            *entry = self
                .palette
                .nearest(colour.map(|value| (value & !3) + 2))
                .into();
        }
        u8::try_from(*entry).unwrap_or_default()
    }
}

/// The threshold of a place, 0 to 63: each once in 8 x 8 pixels, neighbouring ones far apart.
fn threshold(x: usize, y: usize) -> i32 {
    let bits =
        (0..3).map(|bit| ((x ^ y) >> bit & 1) << (5 - 2 * bit) | (y >> bit & 1) << (4 - 2 * bit));
    i32::try_from(bits.sum::<usize>()).unwrap_or_default()
}

#[cfg(test)]
mod tests {
    use super::*;

    fn indexed(pixels: &[Rgb], width: usize, most: usize) -> (Vec<Rgb>, Vec<Rgb>) {
        let palette = GifPalette::of(pixels.iter().copied(), most, &|| true);
        let mut indexer = palette.indexer();
        let shown = |(k, colour): (usize, &Rgb)| {
            palette.colours()[usize::from(indexer.index(*colour, k % width, k / width))]
        };
        (
            palette.colours().to_vec(),
            pixels.iter().enumerate().map(shown).collect(),
        )
    }

    fn ramp() -> Vec<Rgb> {
        let value = |x: usize, tenths: usize| u8::try_from(60 + x * tenths / 10).unwrap();
        (0..128 * 128)
            .map(|k| {
                [
                    value(k % 128, 11),
                    value(k / 128, 7),
                    value((k % 128 + k / 128) / 2, 5),
                ]
            })
            .collect()
    }

    #[test]
    fn few_colours_are_kept_and_those_of_neighbours_too() {
        let pixels: Vec<Rgb> = (0..255_u8).map(|k| [k / 16 * 3, 255 - k, k % 16]).collect();
        let (colours, shown) = indexed(&pixels, 15, 255);
        assert_eq!((colours.len(), shown), (255, pixels));
    }

    #[test]
    fn many_colours_become_near_ones_that_are_right_on_average() {
        let pixels = ramp();
        let (colours, shown) = indexed(&pixels, 128, 256);
        assert!(
            colours.len() > 200 && colours.len() <= 256,
            "{}",
            colours.len()
        );
        let off = |a: &Rgb, b: &Rgb| (0..3).map(|k| a[k].abs_diff(b[k])).max().unwrap();
        let worst = shown
            .iter()
            .zip(&pixels)
            .map(|(a, b)| off(a, b))
            .max()
            .unwrap();
        assert!(worst <= 20, "{worst}");
        // Of 8 x 8 pixels together: the pattern is invisible from afar.
        for block in 0..16 * 16 {
            let places = (0..64).map(|k| (block / 16 * 8 + k / 8) * 128 + block % 16 * 8 + k % 8);
            for channel in 0..3 {
                let mean = |of: &[Rgb]| {
                    places
                        .clone()
                        .map(|k| f64::from(of[k][channel]))
                        .sum::<f64>()
                        / 64.0
                };
                assert!(
                    (mean(&shown) - mean(&pixels)).abs() < 4.0,
                    "block {block}: {} {}",
                    mean(&shown),
                    mean(&pixels)
                );
            }
        }
    }

    #[test]
    fn a_flat_area_beside_many_colours_stays_flat_and_what_does_not_change_stays() {
        let mut pixels = ramp();
        pixels.extend([[250, 251, 249]; 128 * 64]);
        let (_, shown) = indexed(&pixels, 128, 255);
        assert!(
            shown[128 * 128..]
                .iter()
                .all(|colour| *colour == [250, 251, 249])
        );
        let (_, again) = indexed(&pixels, 128, 255);
        assert!(shown == again);
    }

    #[test]
    fn thresholds_are_each_once_in_a_square() {
        let mut all: Vec<i32> = (0..64).map(|k| threshold(k % 8, k / 8)).collect();
        all.sort_unstable();
        assert_eq!(all, (0..64).collect::<Vec<_>>());
        assert_eq!(
            (
                threshold(0, 0),
                threshold(8, 16),
                threshold(1, 0),
                threshold(4, 4)
            ),
            (0, 0, 32, 1)
        );
    }

    #[test]
    fn a_frame_that_nobody_waits_for_is_given_up() {
        let asked = std::cell::Cell::new(0);
        GifPalette::of(ramp().into_iter().cycle().take(1 << 24), 255, &|| {
            asked.set(asked.get() + 1);
            asked.get() < 5
        });
        assert!(asked.get() < 10, "{}", asked.get());
    }
}
