//! Warnings about handles that are valid and probably not meant: other units than the client thinks, or positions far from the picture.

use super::{Units, Warning};
use crate::deform::{Handle, Handles, Pose};
use crate::geometry::{Grid, Point};

/// Rest handles in px within 0 to this look like shares of the picture's size.
const LARGEST_SHARE: f64 = 1.5;
/// A normalised coordinate beyond this looks like px.
const LARGEST_NORMALIZED: f64 = 4.0;
/// The least size of a picture for distances from it, in its larger sides: a place just beside a strip is not far from it.
const LEAST_SIZE: f64 = 0.25;
/// Distance from the picture, in sizes of the picture, beyond which a rest handle and a posed handle are probably not meant.
const FAR_AT_REST: f64 = 1.0;
/// Handles that are just outside the picture may hold its border; in larger sides of the picture.
const MARGIN: f64 = 0.02;
const FAR_POSED: f64 = 10.0;

/// The warnings of rest handles, which are in px.
pub(super) fn of_rest(handles: &Handles, grid: &Grid, units: Units) -> Vec<Warning> {
    let places = || handles.handles().iter().flat_map(Handle::places);
    let looks_normalized = match units {
        // Whole numbers may be the corner of the picture: the pose decides.
        Units::Px => places().all(|p| is_share(*p)) && places().any(|p| !is_whole(*p)),
        Units::Normalized => places().any(|p| is_beyond_normalized(*p, grid)),
    };
    let is_outside = places().any(|p| is_far(*p, grid, FAR_AT_REST)) || looks_swapped(handles, grid);
    list(is_outside, looks_normalized)
}

/// Whether handles lie outside the picture, and all would lie inside if x and y were exchanged.
fn looks_swapped(handles: &Handles, grid: &Grid) -> bool {
    let places = || handles.handles().iter().flat_map(Handle::places);
    let margin = MARGIN * grid.width().max(grid.height());
    let is_inside = |x: f64, y: f64| (-margin..=grid.width() + margin).contains(&x) && (-margin..=grid.height() + margin).contains(&y);
    places().any(|p| !is_inside(p.x, p.y)) && places().all(|p| is_inside(p.y, p.x))
}

/// The warnings of posed handles.
pub(super) fn of_pose(handles: &Handles, pose: &Pose, grid: &Grid, units: Units) -> Vec<Warning> {
    let (mut is_outside, mut is_beyond) = (false, false);
    let (mut count, mut all_shares, mut all_whole) = (0, true, true);
    let mut displacements = pose.displacements().iter();
    let mut look = |p: &Point| {
        let posed = *p + *displacements.next().expect("a column for every position");
        is_outside |= is_far(posed, grid, FAR_POSED);
        is_beyond |= is_beyond_normalized(posed, grid);
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
    let looks_normalized = match units {
        Units::Px => count > 0 && all_shares && (count > 1 || !all_whole),
        Units::Normalized => is_beyond,
    };
    list(is_outside, looks_normalized)
}

fn list(is_outside: bool, looks_normalized: bool) -> Vec<Warning> {
    let all = [(is_outside, Warning::HandlesOutsidePicture), (looks_normalized, Warning::LooksNormalized)];
    all.into_iter().filter_map(|(applies, warning)| applies.then_some(warning)).collect()
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
    let least = LEAST_SIZE * grid.width().max(grid.height());
    let beyond = |c: f64, side: f64| c < -sizes * side.max(least) || c > side + sizes * side.max(least);
    beyond(p.x, grid.width()) || beyond(p.y, grid.height())
}
