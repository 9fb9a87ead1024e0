//! Drawing one image: a [`DrawJob`] is posed on one compute thread, and drawn on it and on its
//! helpers. A small image is drawn as a whole. A larger one is sent strip by strip through an
//! unbounded channel, so that a compute thread never waits for a reader; its memory is reserved
//! before and released strip by strip as it is sent. Drawing stops at the next strip when the
//! receiver is dropped.

use std::ops::ControlFlow;
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, AtomicU64, Ordering};
use std::time::{Duration, Instant};

use bytes::Bytes;
use mlswarp::codec::Format;
use mlswarp::deform::{Handle, IsCancelled};
use mlswarp::warp::{
    CompiledRest, Digest, Folds, Limits, OutputSpec, PosedMesh, RenderJob, Report, ResolvedRest,
    Stage, StripScheduler, Target, WarpError, WriteObserver,
};
use tokio::sync::mpsc::{UnboundedReceiver, UnboundedSender, unbounded_channel};
use tokio::sync::oneshot;

use super::App;
use super::drawable::DrawnContent;
use super::reading::Held;
use crate::cache::CacheEntry;
use crate::limits::client_quota::ClientQuota;
use crate::limits::memory::{MemoryClass, Reservation};
use crate::observe::Scope;
use crate::observe::scope::stage;
use crate::observe::stages::{Cost, Timing};
use crate::pool::{PoolError, Ticket};
use crate::problem::Problem;

/// Images of at most this many bytes are drawn as a whole: the head of the response then has their
/// length and cost.
const MAX_WHOLE: u64 = 256 << 10;

/// An image, or one that is being drawn.
#[derive(Debug)]
pub enum Picture {
    /// All of it.
    Whole {
        /// The file.
        bytes: Bytes,
        /// The cost of drawing.
        cost: Cost,
    },
    /// Strips in order. If the channel closes before the last one, drawing failed.
    Strips(UnboundedReceiver<Piece>),
}

/// A part of an image that is being drawn.
#[derive(Debug)]
pub struct Piece {
    /// The next bytes of the file.
    pub bytes: Bytes,
    /// The cost of drawing, if the file is complete with this piece.
    pub end: Option<Cost>,
}

/// A setup and its memory, as it is cached.
pub(crate) type HeldSetup = Arc<CacheEntry<ResolvedRest>>;

/// A plan, and its cost so far.
#[derive(Debug)]
pub(crate) struct Planned {
    pub(crate) setup: HeldSetup,
    pub(crate) plan: Arc<CacheEntry<CompiledRest>>,
    pub(crate) timing: Timing,
    /// Whether the plan was built for this request.
    pub(crate) is_built: bool,
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
    fn pose(
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
        let extent = content.subject().extent();
        content.subject().check(output)?;
        output.check(extent, limits)?;
        let pose_as = if preview.is_some() {
            PosedMesh::coarse
        } else {
            PosedMesh::new
        };
        let posed = pose_as(setup, plan, &setup.pose(q)?, *folds, is_cancelled)?;
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
    /// The file.
    pub picture: Picture,
}

/// A whole file, drawn on one thread.
#[derive(Debug)]
pub(crate) struct DrawnFile {
    pub(crate) report: Report,
    pub(crate) target: Target,
    pub(crate) bytes: Bytes,
}

/// A warp that is ready to be drawn.
pub(super) struct ReservedWarp {
    pub(super) warp: RenderJob,
    pub(super) report: Report,
    /// The memory that drawing needs.
    pub(super) reservation: Reservation,
    /// The cost so far.
    pub(super) timing: Timing,
}

/// Measures the drawing of one image and counts it when it is dropped: abandoned unless it was
/// finished.
struct Meter {
    app: App,
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
    fn new(app: App) -> Self {
        app.metrics().pictures_begun.inc();
        let (render, encode) = (StageTimer::new(), StageTimer::new());
        Self {
            app,
            render,
            encode,
            began: Instant::now(),
            scope: Scope::current(),
            is_finished: AtomicBool::new(false),
        }
    }

    fn cost(&self) -> Cost {
        let spent = |timer: &StageTimer| Duration::from_nanos(timer.spent.load(Ordering::Relaxed));
        Cost {
            render: spent(&self.render),
            encode: spent(&self.encode),
        }
    }

    /// Counts the image, and adds the stages to the trace: each from its beginning on the first
    /// thread to its end on the last.
    fn finish(&self) {
        if self.is_finished.swap(true, Ordering::Relaxed) {
            return;
        }
        self.app.metrics().drawn(self.cost());
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
        self.app.metrics().pictures_finished.inc();
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
            self.app.metrics().pictures_abandoned.inc();
        }
    }
}

/// Observes one thread that draws.
struct Observer<'a> {
    meter: &'a Meter,
    /// The thread stops when this is true: the request no longer waits.
    is_cancelled: IsCancelled<'a>,
    /// A helper returns when a request waits for its thread, or when its job has given way.
    helps: Option<&'a Ticket>,
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

type StripSink = Box<dyn FnMut(Vec<u8>, bool) -> ControlFlow<()> + Send>;

/// An image that several threads draw.
struct SharedDrawing {
    strips: StripScheduler<Box<RenderJob>, StripSink>,
    /// Closed when nobody reads the image.
    pieces: UnboundedSender<Piece>,
    /// Its memory stays reserved while strips are drawn from it.
    _content: DrawnContent,
    meter: Arc<Meter>,
}

impl SharedDrawing {
    /// Draws strips.
    fn draw(&self, ticket: &Ticket) {
        let is_closed = || ticket.is_over(&|| self.pieces.is_closed());
        self.strips.work(&Observer {
            meter: &self.meter,
            is_cancelled: &is_closed,
            helps: None,
        });
    }

    /// Draws strips beside the job's own thread.
    fn help(&self, ticket: &Ticket) {
        self.strips.work(&Observer {
            meter: &self.meter,
            is_cancelled: &|| self.pieces.is_closed(),
            helps: Some(ticket),
        });
    }
}

/// A draw job on its compute thread.
struct DrawTask {
    app: App,
    ticket: Ticket,
    timing: Timing,
    plan_built: bool,
    answer: oneshot::Sender<Result<Drawn, Problem>>,
}

impl App {
    /// Poses and draws; returns when the first piece of the image has been drawn.
    /// Errors: Wrong `q`, rejected folds, too little memory, or a computation that failed.
    pub(crate) async fn draw(&self, ticket: Ticket, job: DrawJob) -> Result<Drawn, Problem> {
        let (answer, result) = oneshot::channel();
        let (timing, plan_built) = (job.planned.timing, job.planned.is_built);
        let task = DrawTask {
            app: self.clone(),
            ticket: ticket.clone(),
            timing,
            plan_built,
            answer,
        };
        self.0.pool.start(&ticket, move || task.draw(&job));
        // The task always answers, unless it panics.
        result.await.map_err(|_| PoolError::Panicked)?
    }

    /// Poses and draws a whole file on this compute thread alone.
    /// Errors: As of [`App::draw`]; cancelled.
    pub(crate) fn draw_file(
        &self,
        job: &DrawJob,
        is_cancelled: IsCancelled<'_>,
    ) -> Result<DrawnFile, Problem> {
        let ReservedWarp {
            warp,
            report,
            reservation,
            timing,
        } = self.prepare_drawing(job, is_cancelled)?;
        self.metrics().prepared(&timing);
        let (bytes, _) = self.write_whole(&warp, reservation, is_cancelled)?;
        Ok(DrawnFile {
            report,
            target: warp.target(),
            bytes,
        })
    }

    /// Poses in reserved memory; returns the reservation of the posed grid. `most_halved`: the most
    /// bytes of halved cells, reserved until the pose is known, and not in the client's quota: a
    /// client that reads slowly cannot hold them.
    pub(super) fn reserve_and_pose<T: Send>(
        &self,
        setup: &ResolvedRest,
        quota: &ClientQuota,
        most_halved: u64,
        pose: impl FnOnce() -> Result<T, WarpError> + Send,
    ) -> Result<(T, Reservation), Problem> {
        let reservation = self.reserve_for(MemoryClass::Frame, quota, setup.posed_bytes())?;
        let _halved = (most_halved > 0)
            .then(|| self.reserve(MemoryClass::Frame, most_halved))
            .transpose()?;
        let posed = if setup.uses_thread_pool() {
            self.0.pool.run_parallel(pose)
        } else {
            pose()
        }?;
        Ok((posed, reservation))
    }

    /// Poses, and reserves the memory of the picture.
    pub(super) fn prepare_drawing(
        &self,
        job: &DrawJob,
        is_cancelled: IsCancelled<'_>,
    ) -> Result<ReservedWarp, Problem> {
        let (began, mut timing) = (Instant::now(), job.planned.timing);
        let (setup, limits) = (&job.planned.setup, self.config().limits());
        let most_halved = if job.preview.is_some() {
            0
        } else {
            setup.most_halved_bytes()
        };
        let pose = || job.pose(&limits, is_cancelled);
        let ((posed, target), mut reservation) =
            self.reserve_and_pose(setup, &job.quota, most_halved, pose)?;
        let subject = job.content.subject();
        let bytes =
            posed.halved_bytes() + target.window_bytes(&posed) + subject.prepared_bytes(&posed);
        self.reserve_more(&mut reservation, bytes)?;
        if subject.lacks_copies(target, &posed, &job.output) {
            let began = Instant::now();
            subject.make_copies(target, &posed, &job.output, is_cancelled)?;
            timing.reduce = began.elapsed();
            stage("reduce", began);
        }
        let warp = RenderJob::onto(target, subject, &posed, &job.output);
        let report = posed.into_report_on(subject, (&target, &job.output), is_cancelled)?;
        self.reserve_more(&mut reservation, warp.work_bytes())?;
        timing.deform = began.elapsed().saturating_sub(timing.reduce);
        stage("deform", began);
        Ok(ReservedWarp {
            warp,
            report,
            reservation,
            timing,
        })
    }

    /// Draws a whole file on this thread.
    fn write_whole(
        &self,
        warp: &RenderJob,
        mut reservation: Reservation,
        is_cancelled: IsCancelled<'_>,
    ) -> Result<(Bytes, Cost), Problem> {
        let (meter, mut pieces) = (Meter::new(self.clone()), Vec::new());
        let observer = Observer {
            meter: &meter,
            is_cancelled,
            helps: None,
        };
        let flow = warp.write(0, &observer, &mut |bytes| {
            pieces.push(bytes);
            if is_cancelled() {
                ControlFlow::Break(())
            } else {
                ControlFlow::Continue(())
            }
        });
        if flow.is_break() {
            return Err(WarpError::Cancelled.into());
        }
        meter.finish();
        let length = pieces.iter().map(Vec::len).sum::<usize>() as u64;
        let file = if pieces.len() == 1 {
            pieces.swap_remove(0)
        } else {
            self.reserve_more(&mut reservation, length)?;
            pieces.concat()
        };
        reservation.shrink_to(length);
        Ok((reservation.attach(file), meter.cost()))
    }
}

impl DrawTask {
    fn draw(mut self, job: &DrawJob) {
        let ReservedWarp {
            warp,
            report,
            reservation,
            timing,
        } = match self
            .app
            .prepare_drawing(job, &|| self.ticket.is_over(&|| self.answer.is_closed()))
        {
            Ok(prepared) => prepared,
            Err(problem) => {
                let _ = self.answer.send(Err(problem));
                return;
            }
        };
        self.timing = timing;
        self.app.metrics().prepared(&timing);
        if warp.is_one_piece() || warp.max_bytes() <= MAX_WHOLE {
            self.draw_whole(&warp, report, reservation);
        } else {
            self.draw_strips(warp, report, reservation, job.content.clone());
        }
    }

    fn draw_whole(self, warp: &RenderJob, report: Report, reservation: Reservation) {
        let Self {
            app,
            ticket,
            timing,
            plan_built,
            answer,
        } = self;
        let (etag, target, format) = (warp.etag(), warp.target(), warp.format());
        let written = app.write_whole(warp, reservation, &|| {
            ticket.is_over(&|| answer.is_closed())
        });
        let drawn = |(bytes, cost)| Drawn {
            report,
            etag,
            target,
            format,
            timing,
            plan_built,
            picture: Picture::Whole { bytes, cost },
        };
        let _ = answer.send(written.map(drawn));
    }

    fn draw_strips(
        self,
        warp: RenderJob,
        report: Report,
        mut reservation: Reservation,
        content: DrawnContent,
    ) {
        let Self {
            app,
            ticket,
            timing,
            plan_built,
            answer,
        } = self;
        let (pieces, strips) = unbounded_channel();
        let (etag, target, format) = (warp.etag(), warp.target(), warp.format());
        let drawn = Drawn {
            report,
            etag,
            target,
            format,
            timing,
            plan_built,
            picture: Picture::Strips(strips),
        };
        let (meter, mut first) = (Arc::new(Meter::new(app.clone())), Some((answer, drawn)));
        let sink: StripSink = Box::new({
            let (meter, pieces) = (Arc::clone(&meter), pieces.clone());
            move |bytes, is_last| {
                if is_last && !pieces.is_closed() {
                    meter.finish();
                }
                // With the last strip, so that its end is sent with it; all strips are drawn by
                // then.
                let end = is_last.then(|| meter.cost());
                let is_sent = pieces
                    .send(Piece {
                        bytes: reservation.split(bytes.len() as u64).attach(bytes),
                        end,
                    })
                    .is_ok();
                // The head of the response is sent with the first strip: one wake-up instead of
                // two.
                let is_sent = is_sent
                    && first
                        .take()
                        .is_none_or(|(answer, drawn)| answer.send(Ok(drawn)).is_ok());
                if is_sent {
                    ControlFlow::Continue(())
                } else {
                    ControlFlow::Break(())
                }
            }
        });
        let strips = StripScheduler::new(Box::new(warp), sink);
        let helpers = app.0.pool.helpers().min(strips.strips() - 1);
        let drawing = Arc::new(SharedDrawing {
            strips,
            pieces,
            _content: content,
            meter,
        });
        let (shared, helpers_ticket) = (Arc::clone(&drawing), ticket.clone());
        app.0
            .pool
            .offer(&ticket, helpers, move || shared.help(&helpers_ticket));
        drawing.draw(&ticket);
    }
}
