//! Drawing: one job poses and draws, on one compute thread and on as many more as no other picture wants, which are woken at the same time. A
//! small picture is made whole; a larger one leaves strip by strip through an unbounded channel, so that compute never waits for a reader. What an
//! answer may come to is reserved before it is drawn, and given back strip by strip as they leave. Whoever drops the receiving end
//! ends the work at the next strip.

use std::ops::ControlFlow;
use std::sync::atomic::{AtomicBool, AtomicU64, Ordering};
use std::sync::{Arc, OnceLock};
use std::time::{Duration, Instant};

use bytes::Bytes;
use mlswarp::codec::Format;
use mlswarp::deform::Handle;
use mlswarp::pixmap::Extent;
use mlswarp::warp::{
    Digest, Folds, Image, Limits, OutputSpec, Plan, Posed, Report, Setup, Stage, StripScheduler, Warp, WarpError, WriteObserver,
};
use tokio::sync::mpsc::{UnboundedReceiver, UnboundedSender, unbounded_channel};
use tokio::sync::oneshot;

use super::App;
use crate::cache::CacheEntry;
use crate::limits::client_quota::Share;
use crate::limits::memory::{Purpose, Reservation};
use crate::observe::Scope;
use crate::observe::scope::stage;
use crate::observe::stages::Cost;
use crate::observe::stages::Timing;
use crate::pool::{DrawGuard, Pool, PoolError, Ticket};
use crate::problem::Problem;

/// How long a helper waits for the first strip to begin. Posing takes less, or nobody was asked to help so early.
const PATIENCE: Duration = Duration::from_millis(1);
/// Looks at the clock are this many looks at the work apart.
const LOOKS: u32 = 64;
/// Pictures of at most this many bytes are made whole: their length and cost stand in the answer's head.
const WHOLE: u64 = 256 << 10;

/// A picture, or one that is being made.
#[derive(Debug)]
pub enum Picture {
    /// All of it.
    Whole {
        /// The file.
        bytes: Bytes,
        /// What drawing cost.
        cost: Cost,
    },
    /// Strips in order, then one [`Piece::End`]; a channel that closes before is a picture that failed.
    Strips(UnboundedReceiver<Piece>),
}

/// What comes out of a picture that is being made.
#[derive(Debug)]
pub enum Piece {
    /// The next bytes of the file.
    Bytes(Bytes),
    /// The file is complete.
    End(Cost),
}

/// What the stages of drawing cost, and where they are traced, from when to when they went on: both on many threads, and at the same time.
#[derive(Debug)]
struct Clock {
    render: StageTimer,
    encode: StageTimer,
    /// What `StageTimer`s count from.
    began: Instant,
    scope: Scope,
}

/// Nanoseconds.
#[derive(Debug)]
struct StageTimer {
    spent: AtomicU64,
    first: AtomicU64,
    last: AtomicU64,
}

impl Default for StageTimer {
    fn default() -> Self {
        Self { spent: AtomicU64::new(0), first: AtomicU64::new(u64::MAX), last: AtomicU64::new(0) }
    }
}

impl Default for Clock {
    /// For the request that is worked on here.
    fn default() -> Self {
        Self { render: StageTimer::default(), encode: StageTimer::default(), began: Instant::now(), scope: Scope::current() }
    }
}

impl WriteObserver for Clock {
    fn around(&self, stage: Stage, work: &mut dyn FnMut()) {
        let began = Instant::now();
        work();
        let nanos = |time: Duration| u64::try_from(time.as_nanos()).unwrap_or(u64::MAX);
        let spent = nanos(began.elapsed());
        let lap = match stage {
            Stage::Render => &self.render,
            Stage::Encode => &self.encode,
        };
        lap.spent.fetch_add(spent, Ordering::Relaxed);
        if self.scope.is_traced() {
            let since = nanos(began.saturating_duration_since(self.began));
            lap.first.fetch_min(since, Ordering::Relaxed);
            lap.last.fetch_max(since + spent, Ordering::Relaxed);
        }
    }
}

/// A clock beside the one who waits.
struct Attended<'a> {
    clock: Clock,
    answer: &'a oneshot::Sender<Result<Drawn, Problem>>,
}

impl WriteObserver for Attended<'_> {
    fn around(&self, stage: Stage, work: &mut dyn FnMut()) {
        self.clock.around(stage, work);
    }

    fn is_wanted(&self) -> bool {
        !self.answer.is_closed()
    }
}

/// A clock beside a thread that helps, and goes when a request waits for a thread.
struct Helping<'a> {
    clock: &'a Clock,
    ticket: &'a Ticket,
}

impl WriteObserver for Helping<'_> {
    fn around(&self, stage: Stage, work: &mut dyn FnMut()) {
        self.clock.around(stage, work);
    }

    fn goes_on(&self) -> bool {
        !self.ticket.is_thread_wanted()
    }
}

impl Clock {
    fn cost(&self) -> Cost {
        let read = |lap: &StageTimer| Duration::from_nanos(lap.spent.load(Ordering::Relaxed));
        Cost { render: read(&self.render), encode: read(&self.encode) }
    }

    /// Tells the stages to the trace, from the first thread's beginning to the last one's end.
    fn tell(&self) {
        for (name, StageTimer { first, last, .. }) in [("render", &self.render), ("encode", &self.encode)] {
            let (first, last) = (first.load(Ordering::Relaxed), last.load(Ordering::Relaxed));
            if first <= last {
                self.scope.stage(name, self.began + Duration::from_nanos(first), self.began + Duration::from_nanos(last));
            }
        }
    }
}

/// All that a picture is made of.
#[derive(Debug)]
pub(crate) struct DrawJob {
    pub(crate) image: Arc<CacheEntry<Image>>,
    pub(crate) setup: Arc<Setup>,
    pub(crate) plan: Arc<CacheEntry<Plan>>,
    pub(crate) q: Vec<Handle>,
    pub(crate) folds: Folds,
    pub(crate) output: OutputSpec,
    /// Whose answer it is.
    pub(crate) share: Share,
}

impl DrawJob {
    fn warp(&self, limits: &Limits, gone: &(dyn Fn() -> bool + Sync)) -> Result<(Warp, Report), WarpError> {
        let Self { image, setup, plan, q, folds, output, .. } = self;
        output.target(image.extent(), limits)?;
        let posed = Posed::new(setup, plan, &setup.pose(q)?, *folds, gone)?;
        Ok((Warp::new(image, &posed, output, limits)?, posed.into_report_on(image)))
    }
}

/// A picture of which the first piece is there.
#[derive(Debug)]
pub struct Drawn {
    /// What to tell before the first pixel.
    pub report: Report,
    /// Digest of image, resolved request and build.
    pub etag: Digest,
    /// Width and height, px.
    pub extent: Extent,
    /// File format.
    pub format: Format,
    /// Cost before drawing.
    pub timing: Timing,
    /// The coefficients were built for this request, not found.
    pub plan_built: bool,
    /// The file.
    pub picture: Picture,
}

/// Counts a picture when it is dropped: abandoned unless it was finished.
struct PictureGuard {
    app: App,
    finished: AtomicBool,
}

impl PictureGuard {
    fn new(app: &App) -> Self {
        app.metrics().pictures_begun.inc();
        Self { app: app.clone(), finished: AtomicBool::new(false) }
    }

    fn finish(&self, clock: &Clock) {
        if !self.finished.swap(true, Ordering::Relaxed) {
            self.app.metrics().drawn(clock.cost());
            clock.tell();
            self.app.metrics().pictures_finished.inc();
        }
    }
}

impl Drop for PictureGuard {
    fn drop(&mut self) {
        if !*self.finished.get_mut() {
            self.app.metrics().pictures_abandoned.inc();
        }
    }
}

/// A picture that several threads draw.
struct Work {
    writing: StripScheduler<Box<Warp>, Sink>,
    /// In the account of memory for as long as it is drawn from.
    _image: Arc<CacheEntry<Image>>,
    clock: Clock,
    begun: PictureGuard,
    end: UnboundedSender<Piece>,
}

type Sink = Box<dyn FnMut(Vec<u8>, bool) -> ControlFlow<()> + Send>;

impl Work {
    fn take_part(&self, watch: &dyn WriteObserver) {
        if self.writing.work(watch) {
            self.begun.finish(&self.clock);
            // A client that leaves after the last strip has missed nothing.
            let _ = self.end.send(Piece::End(self.clock.cost()));
        }
    }
}

/// Where helpers wait for the work: the empty meeting is over when nobody will fill it any more.
type HelperHandoff = Arc<OnceLock<Option<Arc<Work>>>>;

/// Waits for the work, a short while, and takes part in it.
fn help(meeting: &HelperHandoff, ticket: &Ticket) {
    let began = Instant::now();
    while began.elapsed() < PATIENCE {
        for _ in 0..LOOKS {
            if let Some(work) = meeting.get() {
                return work.as_ref().map_or((), |work| work.take_part(&Helping { clock: &work.clock, ticket }));
            }
            std::hint::spin_loop();
        }
        std::thread::yield_now();
    }
}

/// What the job of a request is given beside the sitting.
struct DrawTask {
    app: App,
    pool: Pool,
    ticket: Ticket,
    timing: Timing,
    plan_built: bool,
    drawer: DrawGuard,
    helpers: usize,
    meeting: HelperHandoff,
    answer: oneshot::Sender<Result<Drawn, Problem>>,
}

impl App {
    /// Poses and draws; returns when the first piece of the picture is there.
    ///
    /// # Errors
    /// Whatever is wrong with q, folds that are refused, or a computation that failed.
    pub(crate) async fn draw(&self, ticket: Ticket, sitting: DrawJob, timing: Timing, plan_built: bool) -> Result<Drawn, Problem> {
        let (answer, result) = oneshot::channel();
        let (drawer, helpers) = self.0.pool.begin_drawing();
        let meeting = HelperHandoff::default();
        let pool = self.0.pool.clone();
        let easel = DrawTask {
            app: self.clone(),
            pool,
            ticket: ticket.clone(),
            timing,
            plan_built,
            drawer,
            helpers,
            meeting: Arc::clone(&meeting),
            answer,
        };
        // Threads that pose together come to help by themselves; only PNG is drawn by several.
        let early = if sitting.setup.is_wide() || sitting.output.format != Format::Png { 0 } else { helpers };
        let theirs = ticket.clone();
        self.0.pool.start_with(&ticket, move || easel.draw(&sitting), early, move || help(&meeting, &theirs));
        // Every way out of the job answers, but a panic.
        result.await.map_err(|_| PoolError::Panicked)?
    }
}

impl DrawTask {
    fn draw(self, sitting: &DrawJob) {
        let meeting = Arc::clone(&self.meeting);
        self.draw_at(sitting);
        // Where nobody was needed, or nothing came about.
        let _ = meeting.set(None);
    }

    fn draw_at(mut self, sitting: &DrawJob) {
        let began = Instant::now();
        let limits = self.app.config().limits();
        let gone = || self.answer.is_closed();
        let prepare = || {
            let mut held = self.app.reserve_for(Purpose::Frame, &sitting.share, sitting.setup.posed_bytes())?;
            let pose = || sitting.warp(&limits, &gone);
            let (warp, report) = if sitting.setup.is_wide() { self.pool.run_parallel(pose) } else { pose() }?;
            self.app.reserve_more(&mut held, warp.work_bytes())?;
            Ok((warp, report, held))
        };
        let (warp, report, held) = match prepare() {
            Ok(prepared) => prepared,
            Err(problem) => {
                let _ = self.answer.send(Err(problem));
                return;
            }
        };
        self.timing.deform = began.elapsed();
        stage("deform", began);
        self.app.metrics().prepared(&self.timing);
        if warp.is_one_piece() || warp.max_bytes() <= WHOLE {
            self.whole(&warp, report, held);
        } else {
            self.strips(warp, report, held, Arc::clone(&sitting.image), began);
        }
    }

    fn whole(self, warp: &Warp, report: Report, mut held: Reservation) {
        let (begun, mut file) = (PictureGuard::new(&self.app), Vec::new());
        let watch = Attended { clock: Clock::default(), answer: &self.answer };
        let flow = warp.write(0, &watch, &mut |bytes| {
            if file.is_empty() {
                file = bytes
            } else {
                file.extend_from_slice(&bytes)
            }
            if self.answer.is_closed() { ControlFlow::Break(()) } else { ControlFlow::Continue(()) }
        });
        if flow.is_continue() {
            begun.finish(&watch.clock);
        }
        held.shrink_to(file.len() as u64);
        let picture = Picture::Whole { bytes: held.attach(file), cost: watch.clock.cost() };
        drop(self.drawer);
        let Self { timing, plan_built, answer, .. } = self;
        let (etag, extent, format) = (warp.etag(), warp.target(), warp.format());
        let _ = answer.send(Ok(Drawn { report, etag, extent, format, timing, plan_built, picture }));
    }

    fn strips(self, warp: Warp, report: Report, mut held: Reservation, image: Arc<CacheEntry<Image>>, began: Instant) {
        let Self { app, pool, ticket, timing, plan_built, drawer, helpers, meeting, answer } = self;
        let (pieces, strips) = unbounded_channel();
        let (etag, extent, format) = (warp.etag(), warp.target(), warp.format());
        let drawn = Drawn { report, etag, extent, format, timing, plan_built, picture: Picture::Strips(strips) };
        let (end, mut first, mut drawer) = (pieces.clone(), Some((answer, drawn)), Some(drawer));
        let sink: Sink = Box::new(move |bytes, last| {
            if last {
                // The client may come again before this thread has gone on.
                drop(drawer.take());
            }
            let heard = pieces.send(Piece::Bytes(held.split(bytes.len() as u64).attach(bytes))).is_ok();
            // The head of the answer leaves with the first strip: one thing to wake for, not two.
            let heard = heard && first.take().is_none_or(|(answer, drawn)| answer.send(Ok(drawn)).is_ok());
            if heard { ControlFlow::Continue(()) } else { ControlFlow::Break(()) }
        });
        let (clock, begun) = (Clock::default(), PictureGuard::new(&app));
        let work = Work { writing: StripScheduler::new(Box::new(warp), sink), _image: image, clock, begun, end };
        let helpers = helpers.min(work.writing.strips() - 1);
        let work = Arc::new(work);
        let _ = meeting.set(Some(Arc::clone(&work)));
        if helpers > 0 && began.elapsed() >= PATIENCE {
            // Those who came early may have gone.
            for _ in 0..helpers {
                let (meeting, theirs) = (Arc::clone(&meeting), ticket.clone());
                pool.start(&ticket, move || help(&meeting, &theirs));
            }
        }
        work.take_part(&work.clock);
    }
}
