//! The use cases, and the state that they share: pool, caches, sessions, limits. No HTTP and no JSON here; every error is a [`Problem`].

pub mod causes;
pub mod drag;
pub mod draw;
mod figures;
pub mod holdings;
pub(crate) mod lifecycle;
pub mod live_drag;
pub(crate) mod points;
pub mod sequence;
pub(crate) mod session;
pub mod warp;

use std::sync::atomic::{AtomicU64, Ordering};
use std::sync::{Arc, Mutex, PoisonError};
use std::time::Duration;

use bytes::Bytes;
use mlswarp::warp::{Image, Plan, Setup};
use thiserror::Error;

use crate::app::sequence::Sequencer;
use crate::auth::AccessControl;
use crate::cache::Cache;
use crate::client::Client;
use crate::config::{Config, WorkConfig};
use crate::limits::client_quota::{Quota, Share, Shares};
use crate::limits::connections::ConnectionLimiter;
use crate::limits::memory::{Budget, BudgetExceeded, Exhausted, Purpose, Reservation};
use crate::limits::sockets::SocketSlots;
use crate::observe::metrics::Metrics;
use crate::observe::tracer::{Exporting, NotTraced, Outbox, Tracer};
use crate::pool::{Pool, PoolError, QueueKey, Shape, Work};
use crate::problem::{Code, Problem};
use crate::store::timed::Timed;
use crate::store::{NotOpened, Store, StoreError};
use causes::Causes;
use holdings::Holdings;
use lifecycle::Phases;

/// Setups of sessions are small beside plans; they take this share of the plans' memory.
const SETUP_SHARE: u64 = 8;
/// Memory that a small picture takes: where there is less, a server is not ready for newcomers.
const LEAST_LEFT: u64 = 1 << 20;
/// One client may hold this part of the memory by answers that it does not read.
const UNREAD_PART: u64 = 4;
/// Seconds after which a request that found the queue full may come again.
const RETRY_QUEUE: u32 = 1;
/// Seconds after which a request that found no memory may come again.
const RETRY_MEMORY: u32 = 2;
/// Seconds after which a request that found the store full may come again.
const RETRY_STORE: u32 = 30;
/// Seconds after which a request that the store did not answer may come again.
const RETRY_AWAY: u32 = 2;
/// Seconds after which a request for a session of another version may come again: a rolling update takes minutes.
const RETRY_OTHER_VERSION: u32 = 30;

/// Everything that requests share. Cloning shares it.
#[derive(Clone, Debug)]
pub struct App(pub(crate) Arc<AppState>);

#[derive(Debug)]
pub(crate) struct AppState {
    pub(crate) config: Config,
    pub(crate) access: AccessControl,
    pub(crate) budget: Budget,
    /// Of memory for answers.
    pub(crate) answers: Shares,
    /// Of memory for requests.
    pub(crate) requests: Shares,
    pub(crate) holdings: Holdings,
    pub(crate) pool: Pool,
    pub(crate) images: Cache<Image>,
    pub(crate) plans: Cache<Plan>,
    pub(crate) setups: Cache<Arc<Setup>>,
    /// Keeps nothing: those who wait for one session's file share one look at the store.
    pub(crate) files: Cache<Bytes>,
    pub(crate) store: Arc<dyn Store>,
    pub(crate) sequencer: Sequencer,
    pub(crate) phases: Phases,
    pub(crate) causes: Causes,
    pub(crate) pictures: Pictures,
    pub(crate) seats: SocketSlots,
    pub(crate) drags: Drags,
    pub(crate) metrics: Metrics,
    pub(crate) tracer: Option<Tracer>,
    pub(crate) outbox: Mutex<Option<Outbox>>,
}

/// Pictures begun, and how they ended.
#[derive(Debug, Default)]
pub(crate) struct Pictures {
    pub(crate) begun: AtomicU64,
    pub(crate) finished: AtomicU64,
    pub(crate) abandoned: AtomicU64,
    pub(crate) superseded: AtomicU64,
}

/// What the drag sockets did.
#[derive(Debug, Default)]
pub(crate) struct Drags {
    pub(crate) frames: AtomicU64,
    pub(crate) superseded: AtomicU64,
}

/// What has happened so far.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Counters {
    /// Tables of coefficients filled.
    pub plans_built: u64,
    /// Files decoded.
    pub images_decoded: u64,
    /// Pictures whose drawing began.
    pub pictures_begun: u64,
    /// Pictures drawn to the end.
    pub pictures_finished: u64,
    /// Pictures that were given up because the client had left.
    pub pictures_abandoned: u64,
    /// Requests answered 409 because a newer pose had been seen.
    pub superseded: u64,
    /// Drag sockets that are open now.
    pub sockets_open: u64,
    /// Frames that were handed to drag sockets.
    pub frames_sent: u64,
    /// Poses of drag sockets of which no frame was sent, because a newer one was there.
    pub poses_superseded: u64,
}

/// What a service that takes work can do.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Ready {
    /// Everything.
    Whole,
    /// Sessions that it knows and pictures that need none: the store is away.
    WithoutStore,
}

/// Why the application was not started.
#[derive(Debug, Error)]
pub enum NotStarted {
    /// The operating system gives no threads.
    #[error("cannot start compute threads: {0}")]
    Threads(#[from] crate::pool::NoThreads),
    /// The store cannot be opened.
    #[error("cannot open {0}")]
    Store(#[from] NotOpened),
    /// Traces cannot be exported.
    #[error("{0}")]
    Traces(#[from] NotTraced),
}

impl App {
    /// Opens the store and starts the compute pool.
    ///
    /// # Errors
    /// See [`NotStarted`].
    pub fn new(config: Config) -> Result<Self, NotStarted> {
        let store = crate::store::open(&config.store.place, config.store.bounds)?;
        let (tracer, outbox) = Tracer::new(config.telemetry.otlp_endpoint.clone(), config.telemetry.otlp_sample)?.unzip();
        let store = if tracer.is_some() { Arc::new(Timed(store)) } else { store };
        let (work, access) = (config.work, &config.access);
        let of_client = |total| config.access.client_share.of(total);
        let WorkConfig { workers, queue, drag_wait, upload_wait, .. } = work;
        let shape = Shape { workers, queue, drag_wait, upload_wait };
        Ok(Self(Arc::new(AppState {
            access: AccessControl::new(
                access.keys.as_ref().map(|keys| keys.all.clone()),
                access.rate_per_address,
                access.rate_per_key,
                ConnectionLimiter::new(access.max_connections, access.max_connections_per_address),
            ),
            budget: Budget::new(work.memory_bytes),
            answers: Shares::new(Quota::Answers, work.memory_bytes / UNREAD_PART),
            requests: Shares::new(Quota::Requests, of_client(Purpose::Upload.share(work.memory_bytes))),
            holdings: Holdings::new(config.store.bounds, of_client),
            pool: Pool::new(shape)?,
            images: Cache::new(work.image_cache_bytes),
            plans: Cache::new(work.plan_cache_bytes),
            setups: Cache::new(work.plan_cache_bytes / SETUP_SHARE),
            files: Cache::new(0),
            store,
            sequencer: Sequencer::default(),
            phases: Phases::default(),
            causes: Causes::default(),
            pictures: Pictures::default(),
            // Half of the places for the frames of one client: the others are left to requests.
            seats: SocketSlots::new(config.max_sockets, of_client(config.max_sockets as u64), workers.max(queue / 2)),
            drags: Drags::default(),
            metrics: Metrics::default(),
            tracer,
            outbox: Mutex::new(outbox),
            config,
        })))
    }

    /// The options.
    #[must_use]
    pub fn config(&self) -> &Config {
        &self.0.config
    }

    /// Who is let in.
    #[must_use]
    pub fn access(&self) -> &AccessControl {
        &self.0.access
    }

    /// Admission and compute threads.
    #[must_use]
    pub fn pool(&self) -> &Pool {
        &self.0.pool
    }

    /// The account of memory.
    #[must_use]
    pub fn budget(&self) -> &Budget {
        &self.0.budget
    }

    /// Takes memory before it is allocated; what is cached and not in use gives way.
    ///
    /// # Errors
    /// [`Code::TooLarge`] for what never fits, [`Code::Overloaded`] for what does not fit now.
    pub fn reserve(&self, purpose: Purpose, bytes: u64) -> Result<Reservation, Problem> {
        self.evicting_idle(|| self.0.budget.take(purpose, bytes))
    }

    /// Takes memory that counts for a client, and makes room for it as [`App::reserve`].
    ///
    /// # Errors
    /// As [`App::reserve`]; [`Code::Overloaded`] for a client that does not read its answers, [`Code::RateLimited`] for one whose
    /// requests take too much.
    pub fn reserve_for(&self, purpose: Purpose, share: &Share, bytes: u64) -> Result<Reservation, Problem> {
        self.evicting_idle(|| self.0.budget.take_for(purpose, share, bytes))
    }

    /// What the client holds by answers that it has not read.
    #[must_use]
    pub fn share(&self, client: Client) -> Share {
        self.0.answers.of(client)
    }

    /// What the client holds by requests that it is sending.
    #[must_use]
    pub fn request_share(&self, client: Client) -> Share {
        self.0.requests.of(client)
    }

    /// Takes so much more.
    ///
    /// # Errors
    /// As [`App::reserve`].
    pub fn reserve_more(&self, held: &mut Reservation, more: u64) -> Result<(), Problem> {
        self.evicting_idle(|| held.grow(more))
    }

    fn evicting_idle<T>(&self, mut take: impl FnMut() -> Result<T, BudgetExceeded>) -> Result<T, Problem> {
        loop {
            let refused = match take() {
                Ok(taken) => return Ok(taken),
                Err(refused) => refused,
            };
            if refused.is_forever() || refused.short != Exhausted::Memory || !self.evict_idle() {
                self.0.budget.count_refusal();
                return Err(refused.into());
            }
        }
    }

    /// Something is cached and not in use: it would give way.
    fn is_idle_cached(&self) -> bool {
        self.0.images.is_any_idle() || self.0.plans.is_any_idle() || self.0.setups.is_any_idle()
    }

    /// Drops something that is cached and not in use. False when there is nothing.
    fn evict_idle(&self) -> bool {
        let AppState { images, plans, setups, .. } = &*self.0;
        let mut shelves: [(u64, &dyn Fn() -> bool); 3] = [
            (images.usage().bytes, &|| images.evict_idle()),
            (plans.usage().bytes, &|| plans.evict_idle()),
            (setups.usage().bytes, &|| setups.evict_idle()),
        ];
        shelves.sort_by_key(|(bytes, _)| std::cmp::Reverse(*bytes));
        shelves.iter().any(|(_, give_way)| give_way())
    }

    /// What has happened so far.
    #[must_use]
    pub fn counters(&self) -> Counters {
        let read = |counter: &AtomicU64| counter.load(Ordering::Relaxed);
        let pictures = &self.0.pictures;
        Counters {
            plans_built: self.0.plans.usage().built,
            images_decoded: self.0.images.usage().built,
            pictures_begun: read(&pictures.begun),
            pictures_finished: read(&pictures.finished),
            pictures_abandoned: read(&pictures.abandoned),
            superseded: read(&pictures.superseded),
            sockets_open: self.0.seats.taken() as u64,
            frames_sent: read(&self.0.drags.frames),
            poses_superseded: read(&self.0.drags.superseded),
        }
    }

    /// What is collected of requests as they are answered.
    #[must_use]
    pub fn metrics(&self) -> &Metrics {
        &self.0.metrics
    }

    /// Who begins traces, where there is a collector.
    #[must_use]
    pub fn tracer(&self) -> Option<&Tracer> {
        self.0.tracer.as_ref()
    }

    /// Exports traces from now on, once. Needs a runtime.
    #[must_use]
    pub fn export_traces(&self) -> Option<Exporting> {
        self.0.outbox.lock().unwrap_or_else(PoisonError::into_inner).take().map(Outbox::open)
    }

    /// Drops every cached picture, plan and setup, as if all had been evicted. Sessions stay.
    pub fn forget_caches(&self) {
        self.0.images.clear();
        self.0.plans.clear();
        self.0.setups.clear();
    }

    /// Waits until no drag socket is open.
    pub async fn drags_ended(&self) {
        self.0.seats.empty().await;
    }

    /// Waits until the session store knows of every number that was answered.
    pub async fn settled(&self) {
        if let Err(error) = self.0.store.flush().await {
            tracing::warn!(%error, "the sessions' last numbers were not told");
        }
    }

    /// Whether work that arrives now would be admitted, and with what. A store that is away after it was there leaves a service that does what it can:
    /// a file is used by this process alone and Redis is away for all replicas, and a proxy that took every one of them away would end also the sessions that go on without it. Answers within about
    /// a second.
    ///
    /// # Errors
    /// [`Code::Overloaded`], with the reason.
    pub async fn ready(&self) -> Result<Ready, Problem> {
        self.stays()?;
        // Somebody who has nothing here yet would be sent away.
        if [Work::Drag, Work::Upload].into_iter().any(|work| self.0.pool.is_full(work)) {
            return Err(PoolError::Full.into());
        }
        if self.0.budget.has(Purpose::Upload, LEAST_LEFT) || self.is_idle_cached() {
            return match self.0.store.ready().await {
                Ok(()) => Ok(Ready::Whole),
                Err(_) if !self.0.store.figures().is_unknown => Ok(Ready::WithoutStore),
                Err(away) => Err(away.into()),
            };
        }
        Err(Problem::new(Code::Overloaded, "there is no memory for another picture").retry_after(RETRY_MEMORY))
    }

    /// Whether an upload of this client would be let in now: asked before its body is read.
    ///
    /// # Errors
    /// [`Code::Overloaded`].
    pub fn admits(&self, client: Client) -> Result<(), Problem> {
        if self.0.pool.refuses(Work::Upload, QueueKey::client(client)) { Err(PoolError::Full.into()) } else { Ok(()) }
    }

    /// Drops expired sessions now and then, until the application is gone. Needs a runtime.
    pub fn spawn_sweeper(&self) {
        let (store, holdings) = (Arc::downgrade(&self.0.store), self.0.holdings.clone());
        let pause = (self.0.config.store.bounds.idle / 4).clamp(Duration::from_millis(50), Duration::from_secs(30));
        tokio::spawn(async move {
            loop {
                tokio::time::sleep(pause).await;
                let Some(store) = store.upgrade() else { return };
                holdings.sweep();
                match store.sweep().await {
                    Ok(0) => {}
                    Ok(sessions) => tracing::debug!(sessions, "sessions expired"),
                    Err(error) => tracing::warn!(%error, "the store was not swept"),
                }
            }
        });
    }
}

impl From<PoolError> for Problem {
    fn from(error: PoolError) -> Self {
        match error {
            PoolError::Full | PoolError::Late { .. } => Self::new(Code::Overloaded, error.to_string()).retry_after(RETRY_QUEUE),
            PoolError::Panicked => Self::new(Code::Internal, "internal error"),
        }
    }
}

impl From<BudgetExceeded> for Problem {
    fn from(error: BudgetExceeded) -> Self {
        let problem = if error.is_forever() {
            Self::new(Code::TooLarge, format!("{} would need {} bytes; at most {}", error.purpose.name(), error.asked, error.limit))
        } else {
            let code = if error.short == Exhausted::Share(Quota::Requests) { Code::RateLimited } else { Code::Overloaded };
            Self::new(code, error.to_string()).retry_after(RETRY_MEMORY)
        };
        match error.short {
            Exhausted::Memory => problem.limit("memory_bytes", error.limit, error.asked),
            Exhausted::Share(Quota::Answers) => problem.limit("unread_bytes", error.limit, error.taken.saturating_add(error.asked)),
            Exhausted::Share(Quota::Requests) => problem.limit("client_upload_bytes", error.limit, error.taken.saturating_add(error.asked)),
        }
    }
}

impl From<StoreError> for Problem {
    fn from(error: StoreError) -> Self {
        let detail = error.to_string();
        match error {
            StoreError::NoSuchSession => Self::new(Code::NoSuchSession, detail),
            StoreError::Expired => Self::new(Code::SessionExpired, detail),
            StoreError::Full { what, limit, actual } => {
                Self::new(Code::Overloaded, detail).limit(what, limit, actual).retry_after(RETRY_STORE)
            }
            StoreError::NoRoom => Self::new(Code::Overloaded, detail).retry_after(RETRY_STORE),
            StoreError::OtherVersion => Self::new(Code::StoredByAnotherVersion, detail).retry_after(RETRY_OTHER_VERSION),
            StoreError::Contended => Self::new(Code::Overloaded, detail).retry_after(RETRY_QUEUE),
            StoreError::Away => Self::new(Code::Overloaded, detail).retry_after(RETRY_AWAY),
        }
    }
}
