//! A prepared warp: drawer and writer are ready, and only writing can still fail.

use std::ops::ControlFlow;
use std::sync::atomic::{AtomicBool, Ordering};

use super::digest::Collector;
use super::mesh_renderer::MeshRenderer;
use super::posed_mesh::PosedMesh;
use super::strip_scheduler::{StripScheduler, WriteObserver};
use super::{Digest, Holes, Limits, OutputSpec, RasterSource, Target, WarpError};
use crate::codec::Writer;
use crate::deform::IsCancelled;
use crate::format::Format;
use crate::parallel::with_helpers;
use crate::render::{Canvas, Filter, Outside};

/// A prepared warp.
#[derive(Debug)]
pub struct RenderJob {
    pub(super) drawer: MeshRenderer,
    pub(super) writer: Writer,
    format: Format,
    etag: Digest,
    target: Target,
}

impl RenderJob {
    /// Prepares the drawing of a posed mesh: tens of microseconds, and up to a nanosecond or two
    /// per pixel for the copies of the source that the first drawing of its kind makes. Stops
    /// when `cancelled` returns true.
    ///
    /// # Errors
    /// Those of [`OutputSpec::target`] and [`RasterSource::check`]; cancelled.
    pub fn new(
        source: RasterSource<'_>,
        posed: &PosedMesh,
        output: &OutputSpec,
        limits: &Limits,
        cancelled: IsCancelled<'_>,
    ) -> Result<Self, WarpError> {
        source.check(output)?;
        posed.check_outside(output.outside)?;
        let target = output.target(source.extent(), posed, limits, cancelled)?;
        source.make_copies(target, posed, output, cancelled)?;
        Ok(Self::onto(target, source, posed, output))
    }

    /// Prepares the drawing of a target of `output`.
    ///
    /// # Panics
    /// If [`RasterSource::check`] refuses the format.
    #[must_use]
    pub fn onto(
        target: Target,
        source: RasterSource<'_>,
        posed: &PosedMesh,
        output: &OutputSpec,
    ) -> Self {
        let drawer = source.drawer(target, posed, output);
        let encoding = output.encoding(source.depth());
        let writer = source.writer(drawer.layout(), &target, encoding);
        Self {
            drawer,
            writer,
            format: output.format,
            etag: etag(source, posed, output, target),
            target,
        }
    }

    /// Digest of source, resolved request and version: the ETag.
    #[must_use]
    pub const fn etag(&self) -> Digest {
        self.etag
    }

    /// What is drawn, and its size.
    #[must_use]
    pub const fn target(&self) -> Target {
        self.target
    }

    /// File format.
    #[must_use]
    pub const fn format(&self) -> Format {
        self.format
    }

    /// Whether the file has alpha and the source has none.
    #[must_use]
    pub fn adds_alpha(&self) -> bool {
        self.drawer.adds_alpha()
    }

    /// Whether it is rendered and encoded in one piece.
    #[must_use]
    pub fn is_one_piece(&self) -> bool {
        self.writer.strips() == 1
    }

    /// Upper bound of the file, bytes.
    #[must_use]
    pub fn max_bytes(&self) -> u64 {
        self.writer.max_bytes()
    }

    /// Upper bound of the memory for writing, the file included, bytes.
    #[must_use]
    pub fn work_bytes(&self) -> u64 {
        self.writer.work_bytes() + self.drawer.work_bytes()
    }

    /// Renders and encodes strip by strip and passes the bytes to `sink` in order: the head with
    /// the first strip, the tail with the last. This thread works, together with up to `helpers`
    /// tasks of the current rayon pool; their number does not change the bytes. When `sink` returns
    /// `Break`, the work ends at the next strip and `Break` is returned. If this thread must not
    /// wait for the others, use [`StripScheduler`].
    pub fn write(
        &self,
        helpers: usize,
        watch: &dyn WriteObserver,
        sink: &mut (dyn FnMut(Vec<u8>) -> ControlFlow<()> + Send),
    ) -> ControlFlow<()> {
        let writing = StripScheduler::new(self, |bytes, _| sink(bytes));
        let ended = AtomicBool::new(false);
        let work = || {
            if writing.work(watch) {
                ended.store(true, Ordering::Relaxed);
            }
        };
        with_helpers(helpers.min(writing.strips().saturating_sub(1)), &work);
        if ended.into_inner() {
            ControlFlow::Continue(())
        } else {
            ControlFlow::Break(())
        }
    }
}

fn etag(
    source: RasterSource<'_>,
    posed: &PosedMesh,
    output: &OutputSpec,
    Target {
        canvas,
        extent,
        force_alpha,
        is_preview,
    }: Target,
) -> Digest {
    let encoding = output.encoding(source.depth()).identity();
    let filter = match output.filter {
        Filter::Nearest => 0,
        Filter::Bilinear => 1,
        Filter::Bicubic => 2,
    };
    let outside = match output.outside {
        Outside::Transparent => vec![0; 5],
        Outside::Edge => vec![1, 0, 0, 0, 0],
        Outside::Colour([r, g, b, a]) => vec![2, r, g, b, a],
        Outside::Reflect => vec![3, 0, 0, 0, 0],
        Outside::Value(value) => value
            .iter()
            .flat_map(|sample| sample.to_be_bytes())
            .collect(),
    };
    let digest = Collector::new("mlswarp answer 6")
        .bytes(&source.digest().0)
        .bytes(&posed.digest().0)
        .bytes(&encoding)
        .integer(filter)
        .bytes(&outside)
        .integer(extent.width().into())
        .integer(extent.height().into());
    let digest = if force_alpha {
        digest.bytes(b"alpha")
    } else {
        digest
    };
    let digest = if is_preview {
        digest.bytes(b"preview")
    } else {
        digest
    };
    let digest = match (posed.region(), output.holes) {
        (None, _) => digest,
        (Some(region), Holes::Keep) => digest.integer(0).bytes(&region.digest().0),
        (Some(region), Holes::Transparent) => digest.integer(1).bytes(&region.digest().0),
    };
    let digest = match canvas {
        None => digest,
        Some(Canvas { x, y, extent }) => {
            let sides = digest
                .integer(extent.width().into())
                .integer(extent.height().into());
            sides.bytes(&x.to_le_bytes()).bytes(&y.to_le_bytes())
        }
    };
    digest.finish()
}
