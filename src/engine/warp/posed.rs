//! A posed grid and its report: everything that follows from the handles alone, before any pixel.

use super::digest::Collector;
use super::{Digest, Folds, Image, Plan, Setup, Warning, WarpError};
use crate::deform::{self, Contradiction, Field, Handle, IsCancelled, Pose};
use crate::geometry::Mesh;

/// Below this |m| the rotation that rigid fits is nearly arbitrary (mathematics section 2.4).
const LEAST_ROTATION: f32 = 0.1;
/// Positions along a segment at which the residual is measured.
const RESIDUAL_SAMPLES: u32 = 5;

/// The report of a warp, known before its first pixel.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Report {
    /// In the order of [`Warning`].
    pub warnings: Vec<Warning>,
    /// Drawn cells that fold.
    pub folds: u64,
    /// Largest distance between a posed handle and its drawn position, px of the source; handles outside the picture are not drawn, and
    /// positions at which handles contradict each other are left out. With smoothing, f does not take the handles to their targets: then
    /// the distance from where it takes them.
    pub residual: f64,
    /// The first groups of handles that coincide at rest and move differently, at most 100.
    pub coincident: Vec<Contradiction>,
}

/// A posed mesh and its report.
#[derive(Debug)]
pub struct Posed {
    mesh: Mesh,
    report: Report,
    digest: Digest,
    unit: (f64, f64),
}

impl Posed {
    /// Poses the grid. CPU work, microseconds to a millisecond; longer only if the grid is large or the plan has no table. Stops when
    /// `cancelled` returns true.
    ///
    /// # Errors
    /// `folds: reject` and the grid folds; cancelled.
    pub fn new(setup: &Setup, plan: &Plan, pose: &Pose, folds: Folds, cancelled: IsCancelled<'_>) -> Result<Self, WarpError> {
        let (mesh, quality) = setup.mesh(plan, pose, cancelled)?;
        let cells = mesh.folded_cell_count(cancelled).ok_or(WarpError::Cancelled)?;
        if folds == Folds::Reject && cells > 0 {
            return Err(WarpError::Folded { cells });
        }
        let mut warnings = setup.warnings(pose);
        if quality.least_rotation < LEAST_ROTATION {
            warnings.push(Warning::Deform(deform::Warning::RotationUndefined));
            warnings.sort_unstable();
        }
        if !mesh.intersects_picture(cancelled).ok_or(WarpError::Cancelled)? {
            warnings.push(Warning::NothingVisible);
        }
        let residual = residual(setup.field(), pose, &mesh);
        let report = Report { warnings, folds: cells, residual, coincident: pose.contradictions().listed.clone() };
        Ok(Self { mesh, report, digest: digest(setup, pose), unit: setup.unit() })
    }

    /// The mesh, px.
    #[must_use]
    pub const fn mesh(&self) -> &Mesh {
        &self.mesh
    }

    /// The report.
    #[must_use]
    pub const fn report(&self) -> &Report {
        &self.report
    }

    /// The report, without the mesh.
    #[must_use]
    pub fn into_report(self) -> Report {
        self.report
    }

    /// Digest of everything that the mesh depends on.
    #[must_use]
    pub(super) const fn digest(&self) -> Digest {
        self.digest
    }

    /// The report of an output drawn from `image`.
    #[must_use]
    pub fn into_report_on(self, image: &Image) -> Report {
        let mut report = self.report;
        report.warnings.extend(image.warning());
        report
    }

    /// The posed vertices row by row, in the client's units.
    pub fn vertices(&self) -> impl Iterator<Item = [f64; 2]> + '_ {
        (0..self.mesh.grid().rows()).flat_map(|row| self.row(row))
    }

    fn row(&self, row: u32) -> impl Iterator<Item = [f64; 2]> + '_ {
        let (ux, uy) = self.unit;
        (0..self.mesh.grid().columns()).map(move |column| {
            let posed = self.mesh.posed(column, row);
            [posed.x / ux, posed.y / uy]
        })
    }

    /// The posed vertices as little-endian f32, x then y.
    ///
    /// # Errors
    /// Cancelled.
    pub fn numbers(&self, cancelled: IsCancelled<'_>) -> Result<Vec<u8>, WarpError> {
        let mut out = Vec::with_capacity(8 * self.mesh.grid().len());
        for row in 0..self.mesh.grid().rows() {
            if cancelled() {
                return Err(WarpError::Cancelled);
            }
            for vertex in self.row(row) {
                #[expect(clippy::cast_possible_truncation, reason = "the format of the contract is f32")]
                out.extend(vertex.map(|c| c as f32).iter().flat_map(|c| c.to_le_bytes()));
            }
        }
        Ok(out)
    }
}

/// Largest distance between a handle under f and its position in the mesh.
fn residual(field: &Field, pose: &Pose, mesh: &Mesh) -> f64 {
    let approximated = field.approximated(pose);
    let mut d = approximated.as_deref().unwrap_or(pose.displacements()).iter().copied();
    let mut worst = 0.0f64;
    let mut look = |p, displacement| {
        if pose.contradictions().contains(p) {
            return;
        }
        if let Some(drawn) = mesh.map(p) {
            worst = worst.max(drawn.distance(p + displacement));
        }
    };
    for handle in field.handles().handles() {
        match handle {
            Handle::Point(p) => look(*p, d.next().expect("one column a point")),
            Handle::Polyline(places) => {
                for ab in places.windows(2) {
                    let (da, db) = (d.next().expect("two columns a segment"), d.next().expect("two columns a segment"));
                    for k in 0..RESIDUAL_SAMPLES {
                        let t = f64::from(k) / f64::from(RESIDUAL_SAMPLES - 1);
                        look(ab[0].lerp(ab[1], t), da * (1.0 - t) + db * t);
                    }
                }
            }
        }
    }
    worst
}

fn digest(setup: &Setup, pose: &Pose) -> Digest {
    let mut digest = Collector::new("mlswarp pose 1")
        .bytes(env!("CARGO_PKG_VERSION").as_bytes())
        .bytes(&setup.plan_key().0)
        // Rows without a table are summed in f64.
        .integer(setup.plan_bytes().is_some().into());
    for d in pose.displacements() {
        digest = digest.float(d.x).float(d.y);
    }
    digest.finish()
}
