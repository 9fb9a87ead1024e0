//! A prepared warp: the mesh is posed and reported on, the renderer and the PNG writer are ready, and only writing can still fail.

use std::ops::ControlFlow;
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};

use super::digest::Collector;
use super::setup::at_most;
use super::writing::{Watch, Writing};
use super::{Digest, Folds, Image, Limits, OutputSpec, Plan, Setup, WarpError};
use crate::codec::{Compression, PngShape, PngWriter};
use crate::deform::{Handle, Handles, Pose, Warning};
use crate::geometry::Mesh;
use crate::pixmap::Extent;
use crate::render::{Filter, Outside, RenderOptions, Renderer};

/// Below this |m| the rotation that rigid fits is close to arbitrary (mathematics section 2.4).
const LEAST_ROTATION: f32 = 0.1;
/// Places along a segment at which the residual is looked at.
const RESIDUAL_SAMPLES: u32 = 5;

/// What a client is told about a warp before its first pixel.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Report {
    /// In the order of [`Warning`].
    pub warnings: Vec<Warning>,
    /// Drawn cells that fold.
    pub folds: u64,
    /// Largest distance between a posed handle and where the drawn picture puts it, px of the source; handles outside the picture are not drawn.
    pub residual: f64,
    /// Digest of image, resolved request and build: the ETag.
    pub etag: Digest,
    /// Width and height of the target, px.
    pub target: (u32, u32),
}

/// A prepared warp.
#[derive(Debug)]
pub struct Warp {
    pub(super) renderer: Renderer,
    pub(super) writer: PngWriter,
    report: Report,
}

impl Warp {
    /// Poses the mesh and prepares the renderer. CPU work, microseconds to a millisecond; long only where the plan has no table, and then
    /// given up when `gone` says that nobody waits any more.
    ///
    /// # Errors
    /// `folds: reject` and it folds; a target over the limits; given up.
    #[expect(clippy::too_many_arguments, reason = "everything that a picture depends on, each already a type of its own")]
    pub fn new(
        image: &Arc<Image>,
        setup: &Setup,
        plan: &Plan,
        pose: &Pose,
        folds: Folds,
        output: &OutputSpec,
        limits: &Limits,
        gone: &(dyn Fn() -> bool + Sync),
    ) -> Result<Self, WarpError> {
        let target = target(image.extent(), output.width, limits)?;
        let (mesh, quality) = setup.mesh(plan, pose, gone)?;
        let cells = mesh.folded_cell_count();
        if folds == Folds::Reject && cells > 0 {
            return Err(WarpError::Folded { cells });
        }
        let mut warnings = setup.field().warnings(pose);
        if quality.least_rotation < LEAST_ROTATION {
            warnings.push(Warning::RotationUndefined);
            warnings.sort_unstable();
        }
        let options = RenderOptions { target, filter: output.filter, outside: output.outside };
        let renderer = Renderer::new(Arc::clone(&image.source), &mesh, options);
        let shape = PngShape { extent: target, channels: renderer.channels(), depth: renderer.depth() };
        let writer = PngWriter::new(shape, output.compression, image.icc.as_ref());
        let report = Report {
            warnings,
            folds: cells,
            residual: residual(setup.field().handles(), pose, &mesh),
            etag: etag(image, setup, pose, output, target),
            target: (target.width(), target.height()),
        };
        Ok(Self { renderer, writer, report })
    }

    /// What to tell before the first pixel.
    #[must_use]
    pub const fn report(&self) -> &Report {
        &self.report
    }

    /// No more than this many bytes will be written: what to reserve for the answer.
    #[must_use]
    pub fn max_bytes(&self) -> u64 {
        self.writer.max_bytes()
    }

    /// Renders and encodes strip by strip and hands the bytes to `sink` in order: the head with the first strip, the tail with the last. This
    /// thread works, and up to `helpers` tasks of the current rayon pool beside it; the bytes are the same whatever their number. `sink` says
    /// `Break` when nobody listens any more: the work ends at the next strip, and `Break` comes back. Where this thread must not wait for
    /// the others: [`Writing`].
    pub fn write(&self, helpers: usize, watch: &dyn Watch, sink: &mut (dyn FnMut(Vec<u8>) -> ControlFlow<()> + Send)) -> ControlFlow<()> {
        let writing = Writing::new(self, |bytes, _| sink(bytes));
        let ended = AtomicBool::new(false);
        let work = || {
            if writing.work(watch) {
                ended.store(true, Ordering::Relaxed);
            }
        };
        rayon::in_place_scope(|scope| {
            for _ in 0..helpers.min(writing.strips().saturating_sub(1)) {
                scope.spawn(|_| work());
            }
            work();
        });
        if ended.into_inner() { ControlFlow::Continue(()) } else { ControlFlow::Break(()) }
    }
}

/// `output.width` with the height that keeps the proportions: max(1, round(H w / W)).
fn target(source: Extent, width: Option<u32>, limits: &Limits) -> Result<Extent, WarpError> {
    let Some(width) = width else { return Ok(source) };
    let (w, h) = (u64::from(source.width()), u64::from(source.height()));
    let height = ((2 * h * u64::from(width) + w) / (2 * w)).max(1);
    at_most("output_side", limits.image.max_side.into(), height.max(width.into()))?;
    at_most("output_pixels", limits.image.max_pixels, height * u64::from(width))?;
    let height = u32::try_from(height).expect("at most max_side");
    Extent::new(width, height).ok_or(WarpError::TooLarge { what: "output_side", limit: limits.image.max_side.into(), actual: 0 })
}

/// Largest distance between where a posed handle is and where the mesh draws it.
fn residual(handles: &Handles, pose: &Pose, mesh: &Mesh) -> f64 {
    let mut d = pose.displacements().iter().copied();
    let mut worst = 0.0f64;
    let mut look = |p, displacement| {
        if let Some(drawn) = mesh.map(p) {
            worst = worst.max(drawn.distance(p + displacement));
        }
    };
    for handle in handles.handles() {
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

fn etag(image: &Image, setup: &Setup, pose: &Pose, output: &OutputSpec, target: Extent) -> Digest {
    let compression = match output.compression {
        Compression::None => 0,
        Compression::Fast => 1,
        Compression::Best => 2,
    };
    let filter = match output.filter {
        Filter::Nearest => 0,
        Filter::Bilinear => 1,
    };
    let outside = match output.outside {
        Outside::Transparent => [0; 5],
        Outside::Edge => [1, 0, 0, 0, 0],
        Outside::Colour([r, g, b, a]) => [2, r, g, b, a],
    };
    let mut digest = Collector::new("mlswarp answer 1")
        .bytes(env!("CARGO_PKG_VERSION").as_bytes())
        .bytes(&image.digest().0)
        .bytes(&setup.plan_key().0)
        // Rows that are weighed anew are summed in f64.
        .integer(setup.plan_bytes().is_some().into())
        .integer(compression)
        .integer(filter)
        .bytes(&outside)
        .integer(target.width().into())
        .integer(target.height().into());
    for d in pose.displacements() {
        digest = digest.float(d.x).float(d.y);
    }
    digest.finish()
}
