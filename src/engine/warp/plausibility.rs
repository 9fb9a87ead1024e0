//! Warnings about handles and annotations that are valid and probably not meant: other units than
//! the client thinks, or positions far from the picture.

use super::{CoordinateFrame, Units, Warning};
use crate::deform::{Handle, Handles, Pose};
use crate::geometry::{Grid, Point};
use crate::render::Canvas;

/// Rest handles in px within 0 to this look like shares of the picture's size.
const LARGEST_SHARE: f64 = 1.5;
/// A normalised coordinate beyond this looks like px.
const LARGEST_NORMALIZED: f64 = 4.0;
/// The least size of a picture for distances from it, in its larger sides: a place just beside a
/// strip is not far from it.
const LEAST_SIZE: f64 = 0.25;
/// Distance from the picture, in sizes of the picture, beyond which a rest handle and a posed
/// handle are probably not meant.
const FAR_AT_REST: f64 = 1.0;
/// Handles that are just outside the picture may hold its border; in larger sides of the picture.
const BORDER_MARGIN_SIDES: f64 = 0.02;
const FAR_POSED: f64 = 10.0;
/// The same from the canvas, in sizes of the canvas.
const FAR_FROM_CANVAS: f64 = 1.0;

/// The warnings of rest handles, which are in px.
pub(super) fn of_rest(handles: &Handles, grid: &Grid, units: Units) -> Vec<Warning> {
    let places = || handles.handles().iter().flat_map(Handle::places);
    let looks_normalized = match units {
        // Whole numbers may be the corner of the picture: the pose decides.
        Units::Px => {
            places().all(|p| is_share(*p))
                && places().any(|p| !is_whole(*p))
                && has_room(grid.width(), grid.height())
        }
        Units::Normalized => places().any(|p| is_beyond_normalized(*p, grid)),
    };
    let is_outside =
        places().any(|p| is_far(*p, grid, FAR_AT_REST)) || looks_swapped(handles, grid);
    list(is_outside, looks_normalized)
}

/// Whether handles lie outside the picture, and all would lie inside if x and y were exchanged.
fn looks_swapped(handles: &Handles, grid: &Grid) -> bool {
    let places = || handles.handles().iter().flat_map(Handle::places);
    let margin = BORDER_MARGIN_SIDES * grid.width().max(grid.height());
    let is_inside = |x: f64, y: f64| {
        (-margin..=grid.width() + margin).contains(&x)
            && (-margin..=grid.height() + margin).contains(&y)
    };
    places().any(|p| !is_inside(p.x, p.y)) && places().all(|p| is_inside(p.y, p.x))
}

/// Posed handles that are probably not meant, unless the canvas contains them.
#[derive(Clone, Copy, Debug)]
pub(super) struct PosedHandles {
    /// The box around those that are far from the picture, px.
    far: Option<[f64; 4]>,
    /// The same of those that look like px if the units are normalised.
    beyond: Option<[f64; 4]>,
    looks_like_shares: bool,
}

impl PosedHandles {
    pub(super) fn new(handles: &Handles, pose: &Pose, grid: &Grid) -> Self {
        let (mut far, mut beyond) = (None, None);
        let (mut count, mut all_shares, mut all_whole) = (0, true, true);
        let mut displacements = pose.displacements().iter();
        let mut look = |p: &Point| {
            let posed = *p + *displacements.next().expect("a column for every position");
            if is_far(posed, grid, FAR_POSED) {
                far = Some(around(far, posed));
            }
            if is_beyond_normalized(posed, grid) {
                beyond = Some(around(beyond, posed));
            }
            count += 1;
            all_shares &= is_share(posed);
            all_whole &= is_whole(posed);
        };
        for handle in handles.handles() {
            match handle {
                Handle::Point(p) => look(p),
                Handle::Polyline(places) => places.windows(2).flatten().for_each(&mut look),
                Handle::Missing => {}
            }
        }
        let looks_like_shares = count > 0
            && all_shares
            && (count > 1 || !all_whole)
            && has_room(grid.width(), grid.height());
        Self {
            far,
            beyond,
            looks_like_shares,
        }
    }

    /// The warnings. Handles on the canvas, or near to it, are where the client wants to see them.
    pub(super) fn warnings(self, units: Units, canvas: Option<Canvas>) -> Vec<Warning> {
        let is_meant = |[left, top, right, bottom]: [f64; 4]| {
            canvas.is_some_and(|canvas| {
                let [x, y, ..] = canvas.edges();
                let size = [
                    f64::from(canvas.extent.width()),
                    f64::from(canvas.extent.height()),
                ];
                !is_beyond(
                    [left - x, top - y, right - x, bottom - y],
                    size,
                    FAR_FROM_CANVAS,
                )
            })
        };
        let is_outside = |places: Option<[f64; 4]>| places.is_some_and(|places| !is_meant(places));
        let looks_normalized = match units {
            Units::Px => self.looks_like_shares,
            Units::Normalized => is_outside(self.beyond),
        };
        list(is_outside(self.far), looks_normalized)
    }
}

/// What positions of annotations of one kind have in common, in the client's units.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Seen {
    bounds: Option<[f64; 4]>,
    /// Corners and centres of pixels.
    all_halves: bool,
}

impl Default for Seen {
    fn default() -> Self {
        Self {
            bounds: None,
            all_halves: true,
        }
    }
}

impl Seen {
    /// Sees a position.
    pub fn add(&mut self, position: Point) {
        self.bounds = Some(around(self.bounds, position));
        self.all_halves &= is_whole(Point::new(2.0 * position.x, 2.0 * position.y));
    }

    /// Adds what annotations of their `image` cause to the sorted warnings of the handles.
    pub fn add_warnings(&self, image: &CoordinateFrame, warnings: &mut Vec<Warning>) {
        let Some(bounds) = self.bounds else { return };
        let size = image.size();
        let is_outside = is_beyond(bounds, size, FAR_AT_REST);
        let is_other_unit = match image.units() {
            // If the handles look so too, both have one unit.
            Units::Px if warnings.contains(&Warning::LooksNormalized) => false,
            Units::Px => {
                let are_shares = bounds.iter().all(|c| (0.0..=LARGEST_SHARE).contains(c));
                are_shares && !self.all_halves && has_room(size[0], size[1])
            }
            Units::Normalized => bounds.iter().any(|c| c.abs() > LARGEST_NORMALIZED),
        };
        warnings
            .extend((is_outside || is_other_unit).then_some(Warning::AnnotationsOutsidePicture));
        warnings.extend(is_other_unit.then_some(Warning::LooksNormalized));
        *warnings = Warning::in_order(std::mem::take(warnings));
    }
}

/// The box around a position and the box before.
fn around(bounds: Option<[f64; 4]>, p: Point) -> [f64; 4] {
    let [left, top, right, bottom] = bounds.unwrap_or([p.x, p.y, p.x, p.y]);
    [left.min(p.x), top.min(p.y), right.max(p.x), bottom.max(p.y)]
}

/// Whether positions between 0 and [`LARGEST_SHARE`] are a small part of a picture of this size.
fn has_room(width: f64, height: f64) -> bool {
    width.max(height) > 2.0 * LARGEST_SHARE
}

fn list(is_outside: bool, looks_normalized: bool) -> Vec<Warning> {
    let all = [
        (is_outside, Warning::HandlesOutsidePicture),
        (looks_normalized, Warning::LooksNormalized),
    ];
    all.into_iter()
        .filter_map(|(applies, warning)| applies.then_some(warning))
        .collect()
}

fn is_share(p: Point) -> bool {
    [p.x, p.y].iter().all(|c| (0.0..=LARGEST_SHARE).contains(c))
}

fn is_whole(p: Point) -> bool {
    p.x.fract() == 0.0 && p.y.fract() == 0.0
}

fn is_beyond_normalized(p: Point, grid: &Grid) -> bool {
    p.x.abs() > LARGEST_NORMALIZED * grid.width() || p.y.abs() > LARGEST_NORMALIZED * grid.height()
}

/// Whether a position is farther from the picture than `sizes` times its width or height.
fn is_far(p: Point, grid: &Grid, sizes: f64) -> bool {
    is_beyond([p.x, p.y, p.x, p.y], [grid.width(), grid.height()], sizes)
}

/// Whether a box extends farther from a picture than `sizes` times its width or height.
fn is_beyond([left, top, right, bottom]: [f64; 4], [width, height]: [f64; 2], sizes: f64) -> bool {
    let least = LEAST_SIZE * width.max(height);
    let beyond = |low: f64, high: f64, side: f64| {
        low < -sizes * side.max(least) || high > side + sizes * side.max(least)
    };
    beyond(left, right, width) || beyond(top, bottom, height)
}
