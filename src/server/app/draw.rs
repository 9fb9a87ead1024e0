//! Drawing one image: a [`DrawJob`] is posed on one compute thread, and drawn on it and on its
//! helpers. A small image is drawn as a whole. A larger one is sent strip by strip through an
//! unbounded channel, so that a compute thread never waits for a reader; its memory is reserved
//! before and released strip by strip as it is sent. Drawing stops at the next strip when the
//! receiver is dropped.

use std::sync::Arc;
use std::sync::atomic::{AtomicBool, AtomicU64, Ordering};
use std::time::{Duration, Instant};

use bytes::Bytes;
use mlswarp::codec::Format;
use mlswarp::deform::{Handle, IsCancelled};
use mlswarp::warp::{
    Digest, Folds, Limits, OutputSpec, PosedMesh, Report, Stage, Target, WarpError, WriteObserver,
};
use tokio::sync::mpsc::UnboundedReceiver;

use super::drawable::DrawnContent;
use super::parts::plans::Planned;
use super::reading::Held;
use crate::limits::client_quota::ClientQuota;
use crate::observe::Scope;
use crate::observe::metrics::Metrics;
use crate::observe::stages::{Cost, Timing};
use crate::pool::Ticket;

/// A part of an image that is being drawn.
#[derive(Debug, Default)]
pub struct Piece {
    /// The next bytes of the file.
    pub bytes: Bytes,
    /// The cost of drawing, if the file is complete with this piece.
    pub end: Option<Cost>,
}

/// Everything that an image is drawn from.
#[derive(Debug)]
pub(crate) struct DrawJob {
    pub(crate) content: DrawnContent,
    pub(crate) planned: Planned,
    pub(crate) q: Arc<Held<Vec<Handle>>>,
    pub(crate) folds: Folds,
    pub(crate) output: OutputSpec,
    /// The largest width of a preview, px. A preview is drawn on the grid as it is, whatever its
    /// tolerance.
    pub(crate) preview: Option<u32>,
    /// See [`Target::force_alpha`].
    pub(crate) force_alpha: bool,
    /// The client's quota of memory for responses.
    pub(crate) quota: ClientQuota,
}

impl DrawJob {
    /// The posed grid, and what is drawn of it.
    pub(crate) fn pose(
        &self,
        limits: &Limits,
        is_cancelled: IsCancelled<'_>,
    ) -> Result<(PosedMesh, Target), WarpError> {
        let Self {
            content,
            planned: Planned { setup, plan, .. },
            q,
            folds,
            output,
            preview,
            ..
        } = self;
        let extent = content.raster_source().extent();
        content.raster_source().check(output)?;
        output.check(extent, limits)?;
        let pose_as = if preview.is_some() {
            PosedMesh::coarse
        } else {
            PosedMesh::new
        };
        let posed = pose_as(setup, plan, &setup.pose(q)?, *folds, is_cancelled)?;
        posed.check_outside(output.outside)?;
        let posed = match content.region() {
            Some(region) => posed.within(region.clone()),
            None => posed,
        };
        let target = output.target(extent, &posed, limits, is_cancelled)?;
        let target = match *preview {
            Some(width) if width < target.extent.width() => OutputSpec {
                width: Some(width),
                ..*output
            }
            .target(extent, &posed, limits, is_cancelled)?,
            _ => target,
        };
        let is_preview = preview.is_some();
        Ok((
            posed,
            Target {
                force_alpha: self.force_alpha,
                is_preview,
                ..target
            },
        ))
    }
}

/// An image whose first piece has been drawn.
#[derive(Debug)]
pub struct Drawn {
    /// Warnings and measures for the head of the response.
    pub report: Report,
    /// Digest of the image, the resolved request and the build.
    pub etag: Digest,
    /// The part of the posed plane that it shows, and its size.
    pub target: Target,
    /// File format.
    pub format: Format,
    /// Cost before drawing.
    pub timing: Timing,
    /// Whether the plan was built for this request.
    pub plan_built: bool,
    /// The first bytes of the file.
    pub first: Piece,
    /// The others in order, unless the image was drawn as a whole. If the channel closes before the
    /// last one, drawing failed.
    pub rest: Option<UnboundedReceiver<Piece>>,
}

/// Measures the drawing of one image and counts it when it is dropped: abandoned unless it was
/// finished.
pub(crate) struct Meter {
    metrics: Arc<Metrics>,
    render: StageTimer,
    encode: StageTimer,
    /// The origin of the stages' times.
    began: Instant,
    scope: Scope,
    is_finished: AtomicBool,
}

/// The cost of a stage on all threads together; for a traced request also when it began and ended.
/// Nanoseconds.
struct StageTimer {
    spent: AtomicU64,
    first: AtomicU64,
    last: AtomicU64,
}

impl StageTimer {
    const fn new() -> Self {
        Self {
            spent: AtomicU64::new(0),
            first: AtomicU64::new(u64::MAX),
            last: AtomicU64::new(0),
        }
    }
}

impl Meter {
    pub(crate) fn new(metrics: &Arc<Metrics>) -> Self {
        metrics.pictures_begun.inc();
        let (render, encode) = (StageTimer::new(), StageTimer::new());
        Self {
            metrics: Arc::clone(metrics),
            render,
            encode,
            began: Instant::now(),
            scope: Scope::current(),
            is_finished: AtomicBool::new(false),
        }
    }

    pub(crate) fn cost(&self) -> Cost {
        let spent = |timer: &StageTimer| Duration::from_nanos(timer.spent.load(Ordering::Relaxed));
        Cost {
            render: spent(&self.render),
            encode: spent(&self.encode),
        }
    }

    /// Counts the image, and adds the stages to the trace: each from its beginning on the first
    /// thread to its end on the last.
    pub(crate) fn finish(&self) {
        if self.is_finished.swap(true, Ordering::Relaxed) {
            return;
        }
        self.metrics.drawn(self.cost());
        for (name, StageTimer { first, last, .. }) in
            [("render", &self.render), ("encode", &self.encode)]
        {
            let (first, last) = (first.load(Ordering::Relaxed), last.load(Ordering::Relaxed));
            if first <= last {
                self.scope.stage(
                    name,
                    self.began + Duration::from_nanos(first),
                    self.began + Duration::from_nanos(last),
                );
            }
        }
        self.metrics.pictures_finished.inc();
    }

    fn around(&self, stage: Stage, work: &mut dyn FnMut()) {
        let began = Instant::now();
        work();
        let nanos = |time: Duration| u64::try_from(time.as_nanos()).unwrap_or(u64::MAX);
        let spent = nanos(began.elapsed());
        let timer = match stage {
            Stage::Render => &self.render,
            Stage::Encode => &self.encode,
        };
        timer.spent.fetch_add(spent, Ordering::Relaxed);
        if self.scope.is_traced() {
            let since = nanos(began.saturating_duration_since(self.began));
            timer.first.fetch_min(since, Ordering::Relaxed);
            timer.last.fetch_max(since + spent, Ordering::Relaxed);
        }
    }
}

impl Drop for Meter {
    fn drop(&mut self) {
        if !*self.is_finished.get_mut() {
            self.metrics.pictures_abandoned.inc();
        }
    }
}

/// Observes one thread that draws.
pub(crate) struct Observer<'a> {
    pub(crate) meter: &'a Meter,
    /// The thread stops when this is true: the request no longer waits.
    pub(crate) is_cancelled: IsCancelled<'a>,
    /// A helper returns when a request waits for its thread, or when its job has given way.
    pub(crate) helps: Option<&'a Ticket>,
}

impl WriteObserver for Observer<'_> {
    fn around(&self, stage: Stage, work: &mut dyn FnMut()) {
        self.meter.around(stage, work);
    }

    fn is_wanted(&self) -> bool {
        !(self.is_cancelled)()
    }

    fn goes_on(&self) -> bool {
        self.helps
            .is_none_or(|ticket| !ticket.is_thread_wanted() && !ticket.is_paused())
    }
}
