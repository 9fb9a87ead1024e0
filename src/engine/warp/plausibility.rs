//! Warnings about handles that are valid and probably not meant: other units than the client thinks, or positions far from the picture.

use super::Warning;
use crate::deform::{Handle, Handles, Pose};
use crate::geometry::{Grid, Point};

/// Rest handles in px within 0 to this look like shares of the picture's size.
const LARGEST_SHARE: f64 = 1.5;
/// A normalised coordinate beyond this looks like px.
const LARGEST_NORMALIZED: f64 = 4.0;
/// Distance from the picture, in sizes of the picture, beyond which a rest handle and a posed handle are probably not meant.
const FAR_AT_REST: f64 = 1.0;
const FAR_POSED: f64 = 10.0;

/// The warnings of rest handles. `unit`: px in one unit of the client's coordinates.
pub(super) fn of_rest(handles: &Handles, grid: &Grid, unit: (f64, f64)) -> Vec<Warning> {
    let places = || handles.handles().iter().flat_map(Handle::places);
    let is_share = |c: f64| (0.0..=LARGEST_SHARE).contains(&c);
    let looks_normalized = match unit {
        (1.0, 1.0) => places().next().is_some() && places().all(|p| is_share(p.x) && is_share(p.y)),
        _ => places().any(|p| is_beyond_normalized(*p, unit)),
    };
    let is_outside = places().any(|p| is_far(*p, grid, FAR_AT_REST));
    list(is_outside, looks_normalized)
}

/// The warnings of posed handles.
pub(super) fn of_pose(handles: &Handles, pose: &Pose, grid: &Grid, unit: (f64, f64)) -> Vec<Warning> {
    let (mut is_outside, mut looks_normalized) = (false, false);
    let mut displacements = pose.displacements().iter();
    let mut look = |p: &Point| {
        let posed = *p + *displacements.next().expect("a column for every position");
        is_outside |= is_far(posed, grid, FAR_POSED);
        looks_normalized |= unit != (1.0, 1.0) && is_beyond_normalized(posed, unit);
    };
    for handle in handles.handles() {
        match handle {
            Handle::Point(p) => look(p),
            Handle::Polyline(places) => places.windows(2).flatten().for_each(&mut look),
        }
    }
    list(is_outside, looks_normalized)
}

fn list(is_outside: bool, looks_normalized: bool) -> Vec<Warning> {
    let all = [(is_outside, Warning::HandlesOutsidePicture), (looks_normalized, Warning::LooksNormalized)];
    all.into_iter().filter_map(|(applies, warning)| applies.then_some(warning)).collect()
}

fn is_beyond_normalized(p: Point, (ux, uy): (f64, f64)) -> bool {
    (p.x / ux).abs() > LARGEST_NORMALIZED || (p.y / uy).abs() > LARGEST_NORMALIZED
}

/// Whether a position is farther from the picture than `sizes` times its width or height.
fn is_far(p: Point, grid: &Grid, sizes: f64) -> bool {
    let beyond = |c: f64, side: f64| c < -sizes * side || c > (1.0 + sizes) * side;
    beyond(p.x, grid.width()) || beyond(p.y, grid.height())
}
