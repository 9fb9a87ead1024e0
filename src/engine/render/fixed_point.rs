//! The lattice of 1/256 target px: positions, ranges and rows in its steps.

/// Lattice steps in a target pixel.
pub(super) const STEPS_PER_PX: i32 = 256;
/// The lattice coordinate of the first pixel's centre.
pub(super) const HALF_PX: i32 = STEPS_PER_PX / 2;
/// The largest lattice coordinate, 2^21 px; vertices beyond it are clamped. Products of two
/// differences stay below 2^62.
pub(super) const MAX_STEPS: i32 = 1 << 29;

/// Lattice steps to px.
pub(super) const PX_PER_STEP: f32 = 1.0 / STEPS_PER_PX as f32;
/// The longest side of a cell that is drawn in lanes, lattice steps: the edge functions of all
/// lanes then fit 31 bits.
pub(super) const LONGEST_SIDE_STEPS: i32 = 112 * STEPS_PER_PX;
/// Columns that are processed together.
pub(super) const BLOCK_COLUMNS: usize = 8;

/// A range of lattice y, both ends included.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) struct YRange {
    pub(super) top: i32,
    pub(super) bottom: i32,
}

impl YRange {
    pub(super) const NOWHERE: Self = Self {
        top: i32::MAX,
        bottom: i32::MIN,
    };

    pub(super) fn join(self, other: Self) -> Self {
        Self {
            top: self.top.min(other.top),
            bottom: self.bottom.max(other.bottom),
        }
    }

    /// The rows of `rows` whose pixel centres may lie inside.
    pub(super) fn rows(self, rows: &std::ops::Range<u32>) -> std::ops::Range<u32> {
        let clip = |y: i32| {
            u32::try_from(first_row(y).max(0))
                .unwrap_or(u32::MAX)
                .clamp(rows.start, rows.end)
        };
        clip(self.top)..clip(self.bottom)
    }

    /// Whether some row of pixel centres of `rows` may lie inside.
    pub(super) fn meets(self, rows: &std::ops::Range<u32>) -> bool {
        let (first, last) = (
            row_centre(rows.start),
            row_centre(rows.end) - i64::from(STEPS_PER_PX),
        );
        i64::from(self.top) <= last && i64::from(self.bottom) > first
    }
}

/// The y at which the pixels in a row have their centres, in lattice steps.
pub(super) const fn row_centre(row: u32) -> i64 {
    row as i64 * STEPS_PER_PX as i64 + HALF_PX as i64
}

/// The x at which the pixels in a column have their centres, in lattice steps.
pub(super) const fn column_centre(pixel: usize) -> f64 {
    pixel as f64 * STEPS_PER_PX as f64 + HALF_PX as f64
}

/// The first row whose centre is at or below a lattice y.
pub(super) const fn first_row(y: i32) -> i64 {
    (y as i64 - HALF_PX as i64 + STEPS_PER_PX as i64 - 1).div_euclid(STEPS_PER_PX as i64)
}

/// A vertex: its lattice position and the sampler's coordinates there.
#[derive(Clone, Copy, Debug, Default)]
pub(super) struct Corner {
    pub(super) x: i32,
    pub(super) y: i32,
    pub(super) u: f32,
    pub(super) v: f32,
}
