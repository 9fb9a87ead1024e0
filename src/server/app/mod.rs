//! The use cases, one file each, and the state that they share. HTTP is not known here, and `wire`
//! defines the JSON. Every error is a [`Problem`].

pub mod batch;
pub mod client_sessions;
pub mod drag_socket;
pub mod draw;
pub(crate) mod drawable;
mod fit;
mod json_text;
pub mod landmarks;
pub(crate) mod layers;
pub(crate) mod lifecycle;
pub mod map;
mod metrics_text;
pub(crate) mod plan;
pub(crate) mod points;
pub(crate) mod reading;
pub(crate) mod report;
pub mod sequence;
pub(crate) mod session;
pub(crate) mod session_object;
pub mod session_warp;
mod tokens;
pub mod warp;

use std::sync::Arc;
use std::time::Duration;

use bytes::Bytes;
use mlswarp::warp::{CompiledRest, Image, LabelImage, ResolvedRest};
use thiserror::Error;

use crate::app::sequence::Sequencer;
use crate::auth::{AccessControl, Rates};
use crate::cache::Cache;
use crate::client::Client;
use crate::config::{Config, WorkConfig};
use crate::limits::client_limit::ClientLimit;
use crate::limits::client_quota::{ClientQuota, ClientQuotas, QuotaKind};
use crate::limits::connections::ConnectionLimiter;
use crate::limits::memory::{Budget, BudgetExceeded, MemoryClass, Reservation};
use crate::limits::sockets::SocketSlots;
use crate::observe::metrics::Metrics;
use crate::observe::tracer::Tracer;
use crate::pool::{Pool, PoolConfig, PoolError, QueueKey, WorkClass, aside};
use crate::problem::{Code, Problem};
use crate::store::{NotOpened, Store};
use client_sessions::ClientSessions;
use lifecycle::Lifecycle;
use session_object::RevisionText;

/// The cache of label images has the memory of the cache of images divided by this.
const LABEL_DIVISOR: u64 = 8;
/// The cache of setups has the memory of the cache of plans divided by this.
const SETUP_DIVISOR: u64 = 8;
/// The cache of the texts of session objects has the memory of the cache of plans divided by this.
const TEXT_DIVISOR: u64 = 16;
/// Memory for a small image, bytes; a server with less free memory is not ready.
const MIN_FREE: u64 = 1 << 20;
/// The unread responses of one client may use the memory divided by this.
const UNREAD_DIVISOR: u64 = 4;
/// The smallest weight of a cached value, bytes.
const MIN_WEIGHT: u64 = 1024;
/// Seconds after which a rejected request may be repeated.
const RETRY_SECONDS: u32 = 1;

/// The application. Clones share its state.
#[derive(Clone, Debug)]
pub struct App(pub(crate) Arc<AppState>);

#[derive(Debug)]
pub(crate) struct AppState {
    pub(crate) config: Config,
    pub(crate) access: AccessControl,
    pub(crate) budget: Budget,
    pub(crate) response_quotas: ClientQuotas,
    pub(crate) request_quotas: ClientQuotas,
    pub(crate) client_sessions: ClientSessions,
    pub(crate) pool: Pool,
    pub(crate) images: Cache<Image>,
    pub(crate) labels: Cache<LabelImage>,
    pub(crate) plans: Cache<CompiledRest>,
    pub(crate) setups: Cache<ResolvedRest>,
    pub(crate) texts: Cache<RevisionText>,
    /// Caches nothing; simultaneous requests for one session's file share one read of the store.
    pub(crate) files: Cache<Bytes>,
    pub(crate) store: Arc<dyn Store>,
    pub(crate) sequencer: Sequencer,
    pub(crate) lifecycle: Lifecycle,
    pub(crate) sockets: SocketSlots,
    pub(crate) metrics: Metrics,
    pub(crate) tracer: Option<Tracer>,
}

/// What a ready service can do.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Readiness {
    /// Everything.
    Whole,
    /// Known sessions, and images without a session: the store is unavailable.
    WithoutStore,
}

/// Why the application did not start.
#[derive(Debug, Error)]
pub enum NotStarted {
    /// The operating system refused to start threads.
    #[error("cannot start compute threads: {0}")]
    Threads(#[from] crate::pool::NoThreads),
    /// The store cannot be opened.
    #[error("cannot open {0}")]
    Store(#[from] NotOpened),
    /// Traces cannot be exported.
    #[error("{0}")]
    Traces(String),
}

impl App {
    /// Opens the store, starts the compute pool and, with a collector, the export of traces, which
    /// needs a runtime. Errors: See [`NotStarted`].
    pub fn new(config: Config) -> Result<Self, NotStarted> {
        let store = crate::store::open(&config.store.url, config.store.bounds())?;
        let tracer = config
            .telemetry
            .otlp_endpoint
            .as_ref()
            .map(|collector| Tracer::new(collector, config.telemetry.otlp_sample));
        let tracer = tracer.transpose().map_err(NotStarted::Traces)?;
        let (work, auth, clients) = (config.work, &config.auth, &config.clients);
        let access = AccessControl::new(
            auth.keys.as_ref().map(|keys| keys.all.clone()),
            auth.token_secrets(&config.store.url),
            Rates {
                address: clients.rate_per_address,
                visitor: clients.rate_per_visitor,
                key: clients.rate_per_key,
            },
            ConnectionLimiter::new(clients.max_connections, clients.max_connections_per_address),
        );
        let of_client =
            |total| ClientLimit::new(clients.client_share.of(total), access.sole_client());
        let WorkConfig {
            workers,
            drag_wait,
            upload_wait,
            ..
        } = work;
        let queue = work.queue();
        let shape = PoolConfig {
            workers,
            queue,
            drag_wait,
            upload_wait,
        };
        Ok(Self(Arc::new(AppState {
            budget: Budget::new(work.memory_bytes),
            response_quotas: ClientQuotas::new(
                QuotaKind::Responses,
                work.memory_bytes / UNREAD_DIVISOR,
            ),
            request_quotas: ClientQuotas::new(
                QuotaKind::Requests,
                of_client(MemoryClass::Upload.share(work.memory_bytes)),
            ),
            client_sessions: ClientSessions::new(config.store.bounds(), of_client),
            pool: Pool::new(shape)?,
            images: Cache::new(work.image_cache_bytes),
            labels: Cache::new(work.image_cache_bytes / LABEL_DIVISOR),
            plans: Cache::new(work.plan_cache_bytes),
            setups: Cache::new(work.plan_cache_bytes / SETUP_DIVISOR),
            texts: Cache::new(work.plan_cache_bytes / TEXT_DIVISOR),
            files: Cache::new(0),
            store,
            sequencer: Sequencer::default(),
            lifecycle: Lifecycle::default(),
            // The frames of one client may use half of the queue, its requests the other half.
            sockets: SocketSlots::new(
                clients.max_sockets,
                of_client(clients.max_sockets as u64),
                workers.max(queue / 2),
            ),
            metrics: Metrics::default(),
            access,
            tracer,
            config,
        })))
    }

    /// The options.
    pub fn config(&self) -> &Config {
        &self.0.config
    }

    /// Keys, rates and connections.
    pub fn access(&self) -> &AccessControl {
        &self.0.access
    }

    /// Admission and compute threads.
    pub fn pool(&self) -> &Pool {
        &self.0.pool
    }

    /// The memory budget.
    pub fn budget(&self) -> &Budget {
        &self.0.budget
    }

    /// Reserves memory before it is allocated; idle cache entries are evicted for it.
    /// Errors: [`Code::TooLarge`] if it can never fit, [`Code::Overloaded`] if it does not fit now.
    pub fn reserve(&self, purpose: MemoryClass, bytes: u64) -> Result<Reservation, Problem> {
        self.evicting_idle(|| self.0.budget.take(purpose, bytes))
    }

    /// As [`App::reserve`], for memory that counts in the quota of a client. Errors: As
    /// [`App::reserve`]; [`Code::Overloaded`] for a client with too many unread responses,
    /// [`Code::RateLimited`] for one whose requests use too much.
    pub fn reserve_for(
        &self,
        purpose: MemoryClass,
        quota: &ClientQuota,
        bytes: u64,
    ) -> Result<Reservation, Problem> {
        self.evicting_idle(|| self.0.budget.take_for(purpose, quota, bytes))
    }

    /// The client's quota of memory for responses that it has not read.
    pub fn response_quota(&self, client: Client) -> ClientQuota {
        self.0.response_quotas.of(client)
    }

    /// The client's quota of memory for requests that it is sending.
    pub fn request_quota(&self, client: Client) -> ClientQuota {
        self.0.request_quotas.of(client)
    }

    /// Reserves more.
    /// Errors: As [`App::reserve`].
    pub fn reserve_more(&self, reservation: &mut Reservation, more: u64) -> Result<(), Problem> {
        self.evicting_idle(|| reservation.grow(more))
    }

    fn evicting_idle<T>(
        &self,
        mut take: impl FnMut() -> Result<T, BudgetExceeded>,
    ) -> Result<T, Problem> {
        loop {
            match take() {
                Ok(taken) => return Ok(taken),
                Err(error) if error.may_be_evicted_for() && self.evict_idle() => {}
                Err(error) => return Err(self.refused(error)),
            }
        }
    }

    fn refused(&self, error: BudgetExceeded) -> Problem {
        self.0.budget.count_refusal();
        error.into()
    }

    /// As [`App::reserve`] and the others, for the runtime's thread: what is evicted is freed
    /// elsewhere, before memory is taken again.
    pub(crate) async fn reserve_aside<T>(
        &self,
        mut take: impl FnMut(&Budget) -> Result<T, BudgetExceeded>,
    ) -> Result<T, Problem> {
        loop {
            match take(&self.0.budget) {
                Ok(taken) => return Ok(taken),
                Err(error) if error.may_be_evicted_for() => {
                    let app = self.clone();
                    if !aside(true, move || app.evict_idle()).await {
                        return Err(self.refused(error));
                    }
                }
                Err(error) => return Err(self.refused(error)),
            }
        }
    }

    /// Whether there is an idle cache entry.
    fn has_idle_entry(&self) -> bool {
        self.0.images.is_any_idle()
            || self.0.labels.is_any_idle()
            || self.0.plans.is_any_idle()
            || self.0.setups.is_any_idle()
            || self.0.texts.is_any_idle()
    }

    /// Evicts an idle entry of the largest cache that has one. False if there is none.
    fn evict_idle(&self) -> bool {
        let AppState {
            images,
            labels,
            plans,
            setups,
            texts,
            ..
        } = &*self.0;
        let mut caches: [(u64, &dyn Fn() -> bool); 5] = [
            (labels.usage().bytes, &|| labels.evict_idle()),
            (images.usage().bytes, &|| images.evict_idle()),
            (plans.usage().bytes, &|| plans.evict_idle()),
            (setups.usage().bytes, &|| setups.evict_idle()),
            (texts.usage().bytes, &|| texts.evict_idle()),
        ];
        caches.sort_by_key(|(bytes, _)| std::cmp::Reverse(*bytes));
        caches.iter().any(|(_, evict)| evict())
    }

    /// Counters and histograms.
    pub(crate) fn metrics(&self) -> &Metrics {
        &self.0.metrics
    }

    /// Starts spans, if there is a collector.
    pub fn tracer(&self) -> Option<&Tracer> {
        self.0.tracer.as_ref()
    }

    /// Evicts all images, label images, plans, setups and texts. Sessions stay.
    pub fn clear_caches(&self) {
        self.0.images.clear();
        self.0.labels.clear();
        self.0.plans.clear();
        self.0.setups.clear();
        self.0.texts.clear();
    }

    /// Whether a new client would be served, and whether the store is available; answers within
    /// about a second. A service that loses its store stays ready: a store is unavailable to all
    /// replicas at the same time, and a proxy that removed them all would also end the sessions
    /// that continue without it. Errors: [`Code::Overloaded`], with the reason.
    pub async fn ready(&self) -> Result<Readiness, Problem> {
        self.require_serving()?;
        if [WorkClass::Drag, WorkClass::Upload]
            .into_iter()
            .any(|class| self.0.pool.is_full(class))
        {
            return Err(PoolError::Full.into());
        }
        if self.0.budget.has(MemoryClass::Upload, MIN_FREE) || self.has_idle_entry() {
            return match self.0.store.ready().await {
                Ok(()) => Ok(Readiness::Whole),
                Err(_) if !self.0.store.figures().is_unknown => Ok(Readiness::WithoutStore),
                Err(error) => Err(error.into()),
            };
        }
        Err(Problem::new(
            Code::Overloaded,
            "the server has no memory for another image",
        )
        .retry_after(RETRY_SECONDS))
    }

    /// Rejects an upload before its body is read, if the queue would reject it.
    /// Errors: [`Code::Overloaded`].
    pub fn require_queue_place(&self, client: Client) -> Result<(), Problem> {
        if self
            .0
            .pool
            .rejects(WorkClass::Upload, QueueKey::client(client))
        {
            Err(PoolError::Full.into())
        } else {
            Ok(())
        }
    }

    /// Deletes expired sessions periodically until the application is dropped. Needs a runtime.
    pub fn spawn_sweeper(&self) {
        let (store, client_sessions) = (
            Arc::downgrade(&self.0.store),
            self.0.client_sessions.clone(),
        );
        let pause = (self.0.config.store.bounds().idle / 4)
            .clamp(Duration::from_millis(50), Duration::from_secs(30));
        tokio::spawn(async move {
            loop {
                tokio::time::sleep(pause).await;
                let Some(store) = store.upgrade() else { return };
                client_sessions.sweep();
                match store.sweep().await {
                    Ok(0) => {}
                    Ok(sessions) => tracing::debug!(sessions, "sessions expired"),
                    Err(error) => tracing::warn!(%error, "the store was not swept"),
                }
            }
        });
    }
}

/// The task that built a cached value was aborted: the runtime is stopping.
fn build_aborted() -> Problem {
    PoolError::Panicked.into()
}

impl From<PoolError> for Problem {
    fn from(error: PoolError) -> Self {
        match error {
            PoolError::Full | PoolError::Late { .. } => {
                Self::new(Code::Overloaded, error.to_string()).retry_after(RETRY_SECONDS)
            }
            PoolError::Panicked => Self::new(Code::Internal, "internal error"),
        }
    }
}
