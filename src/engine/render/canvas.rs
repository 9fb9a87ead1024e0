//! The part of the posed plane that is drawn, and its division into windows. A window is a
//! rectangle of the target's pixels at a fixed place of the plane; each draws with coordinates
//! relative to its own origin, so single precision suffices everywhere, and a pixel has the same
//! value in every canvas of the same scale that contains it.

use std::ops::Range;

use crate::geometry::Grid;
use crate::pixmap::Extent;

/// A box of whole px of the posed plane, in the scale of the source.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub struct Canvas {
    /// The left edge, px.
    pub x: i32,
    /// The upper edge, px.
    pub y: i32,
    /// Width and height, px.
    pub extent: Extent,
}

impl Canvas {
    /// The box of the source itself.
    #[must_use]
    pub const fn of(source: Extent) -> Self {
        Self {
            x: 0,
            y: 0,
            extent: source,
        }
    }

    /// The smallest box that contains both. Boxes beyond the range of their coordinates are cut
    /// off.
    ///
    /// ```
    /// use mlswarp::pixmap::Extent;
    /// use mlswarp::render::Canvas;
    /// let image = Canvas::of(Extent::new(100, 50).unwrap());
    /// let both = image.union(Canvas { x: -10, y: 20, extent: image.extent });
    /// assert_eq!(both.edges(), [-10.0, 0.0, 100.0, 70.0]);
    /// ```
    #[must_use]
    pub fn union(self, other: Self) -> Self {
        let end = |at: i32, length: u32| i64::from(at) + i64::from(length);
        let side = |a: (i32, u32), b: (i32, u32)| {
            let (first, last) = (a.0.min(b.0), end(a.0, a.1).max(end(b.0, b.1)));
            (
                first,
                u32::try_from(last - i64::from(first)).unwrap_or(u32::MAX),
            )
        };
        let (one, two) = (self.extent, other.extent);
        let (x, width) = side((self.x, one.width()), (other.x, two.width()));
        let (y, height) = side((self.y, one.height()), (other.y, two.height()));
        Self {
            x,
            y,
            extent: Extent::new(width, height).unwrap_or(one),
        }
    }

    /// Left, top, right and bottom edge, px.
    #[must_use]
    pub fn edges(&self) -> [f64; 4] {
        let (left, top) = (f64::from(self.x), f64::from(self.y));
        [
            left,
            top,
            left + f64::from(self.extent.width()),
            top + f64::from(self.extent.height()),
        ]
    }
}

/// Side of a window, px of the target.
const WINDOW_SIDE_PX: i64 = 1 << 14;
/// The windows left of and above the origin are divided here, because most canvases that begin
/// there begin near it.
const NEAR_ORIGIN_PX: i64 = 1 << 10;
/// Differences from a whole number of pixels below this are rounding errors.
const WHOLE_PIXEL_ERROR: f64 = 1e-6;

/// A range of pixels of the target along one axis that lies in one window.
#[derive(Clone, Debug, PartialEq, Eq)]
struct Stretch {
    /// Where the window begins on the plane, px of the target.
    origin: i64,
    /// The pixels, relative to the window.
    pixels: Range<u32>,
}

/// Divides `length` pixels that begin at `first`.
fn stretches(first: i64, length: u32) -> Vec<Stretch> {
    let (mut at, end) = (first, first + i64::from(length));
    let mut stretches = Vec::new();
    while at < end {
        let (origin, side) = match at.div_euclid(WINDOW_SIDE_PX) * WINDOW_SIDE_PX {
            start if start == -WINDOW_SIDE_PX && at >= -NEAR_ORIGIN_PX => {
                (-NEAR_ORIGIN_PX, NEAR_ORIGIN_PX)
            }
            start if start == -WINDOW_SIDE_PX => (start, WINDOW_SIDE_PX - NEAR_ORIGIN_PX),
            start => (start, WINDOW_SIDE_PX),
        };
        let stop = end.min(origin + side);
        let within = |at: i64| u32::try_from(at - origin).expect("a window has few pixels");
        stretches.push(Stretch {
            origin,
            pixels: within(at)..within(stop),
        });
        at = stop;
    }
    stretches
}

/// A window, as far as a canvas shows it.
#[derive(Clone, Debug)]
pub(super) struct Window {
    /// The columns and rows that are drawn, relative to the window.
    pub(super) columns: Range<usize>,
    pub(super) rows: Range<u32>,
    /// The target's first column and row that it draws.
    pub(super) first: (usize, u32),
    /// The position of the window's origin at rest, px of the source.
    pub(super) origin: [f64; 2],
}

/// How a canvas is scaled to the target.
#[derive(Clone, Copy, Debug)]
pub(super) struct Placement {
    canvas: Canvas,
    target: Extent,
    /// Px of the target per px of the source.
    pub(super) scale: [f64; 2],
}

impl Placement {
    pub(super) fn new(canvas: Canvas, target: Extent) -> Self {
        let ratio = |target: u32, canvas: u32| f64::from(target) / f64::from(canvas);
        let scale = [
            ratio(target.width(), canvas.extent.width()),
            ratio(target.height(), canvas.extent.height()),
        ];
        Self {
            canvas,
            target,
            scale,
        }
    }

    /// The size of the whole source at this scale, px of the target.
    pub(super) fn source(&self, grid: &Grid) -> Extent {
        #[expect(
            clippy::cast_possible_truncation,
            clippy::cast_sign_loss,
            reason = "float to integer saturates"
        )]
        let side = |side: f64, scale: f64| ((side * scale).round() as u32).max(1);
        Extent::new(
            side(grid.width(), self.scale[0]),
            side(grid.height(), self.scale[1]),
        )
        .expect("at least one px")
    }

    /// The windows that the canvas shows.
    pub(super) fn windows(&self) -> Vec<Window> {
        let [across, down] = [
            (self.canvas.x, self.target.width(), self.scale[0]),
            (self.canvas.y, self.target.height(), self.scale[1]),
        ]
        .map(|(place, length, scale)| {
            let exact = f64::from(place) * scale;
            // The scale is a ratio of whole numbers, so a product this near to a whole number is
            // one, but for rounding.
            let exact = if (exact - exact.round()).abs() < WHOLE_PIXEL_ERROR {
                exact.round()
            } else {
                exact
            };
            #[expect(clippy::cast_possible_truncation, reason = "a place times a side")]
            let first = exact.floor() as i64;
            // A window begins a whole number of pixels from the canvas, so both lie off the whole
            // pixels of the plane by the same part of one.
            #[expect(clippy::cast_precision_loss, reason = "far below 2^52")]
            let origin =
                move |window: &Stretch| (window.origin as f64 + (exact - exact.floor())) / scale;
            let mut passed = 0;
            let stretches = stretches(first, length).into_iter().map(move |window| {
                let at = passed;
                passed += window.pixels.end - window.pixels.start;
                (at, origin(&window), window.pixels)
            });
            stretches.collect::<Vec<_>>()
        });
        let window = |(y, top, rows): &(u32, f64, Range<u32>),
                      (x, left, columns): &(u32, f64, Range<u32>)| Window {
            columns: columns.start as usize..columns.end as usize,
            rows: rows.clone(),
            first: (*x as usize, *y),
            origin: [*left, *top],
        };
        down.iter()
            .flat_map(|down| across.iter().map(move |across| window(down, across)))
            .collect()
    }
}

/// The number of windows in which a canvas is drawn onto a target of this size; each holds a posed
/// grid.
#[must_use]
pub fn window_count(canvas: Canvas, target: Extent) -> u64 {
    Placement::new(canvas, target).windows().len() as u64
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn stretches_cover_a_range_once_and_have_fixed_borders() {
        let borders = [
            -2 * WINDOW_SIDE_PX,
            -WINDOW_SIDE_PX,
            -NEAR_ORIGIN_PX,
            0,
            WINDOW_SIDE_PX,
            2 * WINDOW_SIDE_PX,
        ];
        for (first, length) in [
            (0, 500),
            (-20, 540),
            (-2000, 3000),
            (5, 1),
            (-1024, 1024),
            (16_000, 1000),
            (-40_000, 16_384),
            (-1, 1),
        ] {
            let mut at = first;
            for stretch in stretches(first, length) {
                assert_eq!(
                    stretch.origin + i64::from(stretch.pixels.start),
                    at,
                    "{first} {length}"
                );
                assert!(!stretch.pixels.is_empty());
                assert!(
                    borders.contains(&stretch.origin) || stretch.origin % WINDOW_SIDE_PX == 0,
                    "{stretch:?}"
                );
                at = stretch.origin + i64::from(stretch.pixels.end);
            }
            assert_eq!(at, first + i64::from(length));
        }
        assert_eq!(
            stretches(0, 16_384),
            [Stretch {
                origin: 0,
                pixels: 0..16_384
            }],
            "a picture within the usual limits has one window"
        );
        assert_eq!(
            stretches(-7, 20),
            [
                Stretch {
                    origin: -1024,
                    pixels: 1017..1024
                },
                Stretch {
                    origin: 0,
                    pixels: 0..13
                }
            ]
        );
    }
}
