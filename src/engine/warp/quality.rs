//! Figures that describe a pose: how close the drawn picture takes the handles to their posed
//! positions, where it folds, how much it distorts, what it covers, and the error of the round trip
//! through the inverse. Distances are in px. Cost: O(cells), and a bounded number of positions.

use super::rest_parameters::to_px;
use super::{PosedMesh, ResolvedRest, Target, WarpError};
use crate::deform::{Conflict, Handle, IsCancelled, MAX_COORDINATE, Pose};
use crate::geometry::{Distortion, FoldRegions, Mesh, Orientation, Point, Summary};
use crate::pixmap::Extent;
use crate::render::{Canvas, InverseMap};

/// Positions along a segment at which its residual is measured.
const SEGMENT_SAMPLES: u32 = 5;
/// The most folded regions that are listed.
const MOST_REGIONS: usize = 100;
/// Each side is divided into this number of equal parts, or into pixels if it has fewer. The round
/// trip is measured at their centres.
const ROUND_TRIP_PARTS: u32 = 32;
/// f is the same at two positions if its values are nearer than this, px.
const SAME_VALUE_PX: f64 = 1e-6;
/// Positions with the same f that are farther apart than this are on two sides of a fold, px.
const FOLD_DISTANCE_PX: f64 = 1.0 / 16.0;
/// Rows that are counted together.
const STRIP_ROWS: u32 = 32;
/// The covered share is counted on at most this many pixels of a side.
const COUNTED_SIDE: u32 = 1024;

/// The figures of a pose.
#[derive(Clone, Debug, PartialEq)]
pub struct Quality {
    /// For each handle, the largest distance between its posed position and where the drawn picture
    /// has its rest position; `None` if it rests outside the picture. A line is measured at five
    /// positions of each segment.
    pub residuals: Vec<Option<f64>>,
    /// Where the grid folds.
    pub folds: FoldRegions,
    /// What was done to remove folds, if some were.
    pub removed: Option<RemovedFolds>,
    /// The orientation of most of the picture.
    pub orientation: Orientation,
    /// The distortion of the grid's cells.
    pub distortion: Distortion,
    /// What is drawn; `None` if `fit` has nothing to show.
    pub canvas: Option<Canvas>,
    /// The share of the canvas that the posed picture covers, counted at pixel centres, 0 to 1.
    pub covered: f64,
    /// The tolerance of the grid, if it has one, and the cells that exceed it.
    pub tolerance: Option<ToleranceQuality>,
    /// The first groups of handles that coincide at rest and move differently, at most 100.
    pub coincident: Vec<Conflict>,
    /// The round trip of the inverse.
    pub round_trip: RoundTrip,
}

/// What it took to remove the folds of a pose (mathematics 9.3).
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct RemovedFolds {
    /// Maps whose product is drawn.
    pub factors: u64,
    /// Cells that fold if folds are not removed.
    pub cells: u64,
    /// Cells that the product folded, or nearly, so that their vertices and those around them were
    /// moved.
    pub mended: u64,
}

/// Whether the drawn picture is within a distance of the exact map.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct ToleranceQuality {
    /// The distance.
    pub px: f64,
    /// The cells of the grid that are farther.
    pub exceeded: u64,
}

/// The distances between positions of the picture and the inverse of their images, over a lattice.
/// Positions in and beside folded cells, and those over which another part of the picture is drawn,
/// are left out.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct RoundTrip {
    /// The number of positions.
    pub positions: u64,
    /// Positions that are left out.
    pub in_folds: u64,
    /// Positions whose images have no inverse.
    pub missing: u64,
    /// The distances.
    pub distance: Option<Summary>,
}

impl Quality {
    /// Memory for measuring a pose beside that of its grid, bytes.
    #[must_use]
    pub fn bytes(posed: &PosedMesh, canvas: Option<Canvas>) -> u64 {
        canvas.map_or(0, |canvas| {
            Target::of(Some(canvas), counted(canvas)).window_bytes(posed)
        })
    }

    /// Measures a pose. `q` and `pose`: the same handles. `to_invert`: the same pose on the grid of
    /// [`ResolvedRest::to_invert`], in which the inverse of the round trip is sought. CPU work, in
    /// parallel on the current rayon pool; stops when `cancelled` returns true.
    ///
    /// # Errors
    /// Cancelled.
    pub fn of(
        setup: &ResolvedRest,
        q: &[Handle],
        pose: &Pose,
        posed: &PosedMesh,
        to_invert: &PosedMesh,
        canvas: Option<Canvas>,
        cancelled: IsCancelled<'_>,
    ) -> Result<Self, WarpError> {
        let (mesh, orientation) = (posed.mesh(), posed.report().orientation);
        Ok(Self {
            residuals: residuals(setup, q, mesh, cancelled)?,
            folds: mesh
                .fold_regions(orientation, MOST_REGIONS, cancelled)
                .ok_or(WarpError::Cancelled)?,
            removed: posed.removed_folds(),
            orientation,
            distortion: mesh
                .distortion(orientation, cancelled)
                .ok_or(WarpError::Cancelled)?,
            canvas,
            covered: canvas.map_or(Ok(0.0), |canvas| covered(mesh, canvas, cancelled))?,
            tolerance: setup.tolerance().map(|px| ToleranceQuality {
                px,
                exceeded: posed.report().exceeded,
            }),
            coincident: pose.conflicts().listed.clone(),
            round_trip: round_trip(setup, pose, to_invert, cancelled)?,
        })
    }
}

fn residuals(
    setup: &ResolvedRest,
    q: &[Handle],
    mesh: &Mesh,
    cancelled: IsCancelled<'_>,
) -> Result<Vec<Option<f64>>, WarpError> {
    let residual = |p: Point, q: Point| mesh.map(p).map(|drawn| drawn.distance(q));
    let of_handle = |(p, q): (&Handle, &Handle)| match (p, q) {
        (Handle::Point(p), Handle::Point(q)) => residual(*p, *q),
        (p, q) => {
            let segments = p.places().windows(2).zip(q.places().windows(2));
            let samples = segments.flat_map(|(p, q)| {
                (0..SEGMENT_SAMPLES).map(move |k| {
                    let t = f64::from(k) / f64::from(SEGMENT_SAMPLES - 1);
                    (p[0].lerp(p[1], t), q[0].lerp(q[1], t))
                })
            });
            samples.filter_map(|(p, q)| residual(p, q)).reduce(f64::max)
        }
    };
    let q = to_px(q, setup.unit());
    let each = setup.field().client_handles().handles().iter().zip(&q);
    each.map(|handles| {
        if cancelled() {
            Err(WarpError::Cancelled)
        } else {
            Ok(of_handle(handles))
        }
    })
    .collect()
}

/// The size at which what a canvas covers is counted.
fn counted(canvas: Canvas) -> Extent {
    let side = |side: u32| side.min(COUNTED_SIDE);
    Extent::new(side(canvas.extent.width()), side(canvas.extent.height())).unwrap_or(canvas.extent)
}

/// The share of the centres of the pixels, or of those of a smaller picture, that the posed picture
/// covers.
fn covered(mesh: &Mesh, canvas: Canvas, cancelled: IsCancelled<'_>) -> Result<f64, WarpError> {
    let target = counted(canvas);
    let (width, height) = (target.width(), target.height());
    let map = InverseMap::new(mesh, target, Some(canvas));
    // Rows of one strip share what is found of the cells.
    let mut places = vec![[0.0; 2]; width as usize * STRIP_ROWS as usize];
    let mut covered = 0_u32;
    for y in (0..height).step_by(STRIP_ROWS as usize) {
        let rows = y..height.min(y + STRIP_ROWS);
        let places = &mut places[..width as usize * rows.len()];
        map.rows(rows, places, cancelled);
        if cancelled() {
            return Err(WarpError::Cancelled);
        }
        covered += places
            .iter()
            .map(|[x, _]| u32::from(!x.is_nan()))
            .sum::<u32>();
    }
    Ok(f64::from(covered) / f64::from(width * height))
}

fn round_trip(
    setup: &ResolvedRest,
    pose: &Pose,
    posed: &PosedMesh,
    cancelled: IsCancelled<'_>,
) -> Result<RoundTrip, WarpError> {
    let (mesh, grid, orientation) = (
        posed.mesh(),
        posed.mesh().grid(),
        posed.report().orientation,
    );
    let centres = |side: f64| {
        #[expect(
            clippy::cast_possible_truncation,
            clippy::cast_sign_loss,
            reason = "a number of pixels"
        )]
        let parts = ROUND_TRIP_PARTS.min(side as u32).max(1);
        (0..parts).map(move |k| (f64::from(k) + 0.5) * side / f64::from(parts))
    };
    // Where a cut grid draws nothing, nothing goes round.
    let lattice = centres(grid.height())
        .flat_map(|y| centres(grid.width()).map(move |x| Point::new(x, y)))
        .filter(|p| mesh.cut_mesh().is_none() || mesh.map(*p).is_some());
    // Beside a fold, f may fold in a cell whose corners do not show it.
    let is_folded = |p: Point| {
        grid.locate(p).is_some_and(|(i, j, ..)| {
            let around = |k: u32, lines: u32| k.saturating_sub(1)..=(k + 1).min(lines - 2);
            around(j, grid.rows())
                .any(|j| around(i, grid.columns()).any(|i| mesh.is_folded(i, j, orientation)))
        })
    };
    let in_range = |p: &Point| [p.x, p.y].iter().all(|c| c.abs() <= MAX_COORDINATE);
    let (folded, places): (Vec<Point>, Vec<Point>) =
        lattice.filter(in_range).partition(|p| is_folded(*p));
    let (f, inverse) = (
        setup.transform_of(pose, posed).in_px(),
        setup.inverse(pose, posed).in_px(),
    );
    let there = f
        .map(&places, cancelled)?
        .into_iter()
        .map(|there| there.filter(in_range));
    let (places, there): (Vec<Point>, Vec<Point>) = places
        .into_iter()
        .zip(there)
        .filter_map(|(place, there)| Some((place, there?)))
        .unzip();
    let back = inverse.map(&there, cancelled)?;
    let again = f.map(
        &back
            .iter()
            .zip(&places)
            .map(|(back, place)| back.unwrap_or(*place))
            .collect::<Vec<_>>(),
        cancelled,
    )?;
    let mut trip = RoundTrip {
        in_folds: folded.len() as u64,
        ..RoundTrip::default()
    };
    let mut distances = Vec::new();
    for (((place, there), back), again) in places.into_iter().zip(there).zip(back).zip(again) {
        match back.map(|back| back.distance(place)) {
            None => trip.missing += 1,
            // Another part of the picture is drawn there; beside handles, f may fold within a cell.
            Some(distance)
                if distance > FOLD_DISTANCE_PX
                    && again.is_some_and(|again| again.distance(there) < SAME_VALUE_PX) =>
            {
                trip.in_folds += 1
            }
            Some(distance) => distances.push(distance),
        }
    }
    trip.positions = distances.len() as u64;
    trip.distance = Summary::of(&mut distances);
    Ok(trip)
}
