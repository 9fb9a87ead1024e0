//! The use cases, one file for each route, and the [`parts`] that they share. HTTP is not known
//! here, and `wire` defines the JSON. Every error is a [`Problem`].

pub mod batch;
pub(crate) mod blend;
pub mod client_sessions;
pub mod drag_socket;
pub mod draw;
pub(crate) mod drawable;
pub(crate) mod fit;
mod json_text;
pub mod landmarks;
pub(crate) mod layers;
pub(crate) mod lifecycle;
pub mod map;
pub(crate) mod mesh;
pub mod metrics_text;
pub mod parts;
pub(crate) mod plan;
pub(crate) mod points;
pub(crate) mod reading;
pub(crate) mod report;
mod resolved;
pub mod sequence;
pub(crate) mod service;
pub(crate) mod session_object;
pub mod session_warp;
pub mod sessions;
pub(crate) mod tokens;
pub mod upload;
pub(crate) mod warp;

use std::ops::Deref;
use std::sync::Arc;

use mlswarp::warp::{CompiledRest, Image, LabelImage, ResolvedRest};
use thiserror::Error;

use crate::app::sequence::Sequencer;
use crate::auth::{AccessControl, Rates};
use crate::cache::Cache;
use crate::config::Config;
use crate::limits::client_limit::ClientLimit;
use crate::limits::connections::ConnectionLimiter;
use crate::limits::memory::Budget;
use crate::observe::metrics::Metrics;
use crate::observe::tracer::Tracer;
use crate::pool::{Pool, PoolError};
use crate::problem::{Code, Problem};
use crate::store::{NotOpened, Store};
use client_sessions::ClientSessions;
use lifecycle::Lifecycle;
use parts::admission::Admission;
use parts::drawing::Drawing;
use parts::images::Images;
use parts::plans::Plans;
use parts::sessions::Sessions;
use session_object::RevisionText;

/// The cache of label images has the memory of the cache of images divided by this.
const LABEL_DIVISOR: u64 = 8;
/// The cache of setups has the memory of the cache of plans divided by this.
const SETUP_DIVISOR: u64 = 4;
/// The cache of the texts of session objects has the memory of the cache of plans divided by this.
const TEXT_DIVISOR: u64 = 16;
/// The smallest weight of a cached value, bytes.
const MIN_WEIGHT: u64 = 1024;
/// Seconds after which a rejected request may be repeated.
const RETRY_SECONDS: u32 = 1;
/// Attempts of a request at a session that other requests change at the same time.
pub(crate) const SESSION_ATTEMPTS: usize = 8;

/// The application. Clones share its parts.
#[derive(Clone, Debug)]
pub struct App(Arc<Parts>);

/// The parts of an application: each use case takes those that it needs.
#[derive(Debug)]
pub struct Parts {
    config: Config,
    access: AccessControl,
    /// Places and memory for requests.
    pub admission: Arc<Admission>,
    pub(crate) images: Arc<Images>,
    pub(crate) plans: Arc<Plans>,
    pub(crate) drawing: Arc<Drawing>,
    /// Sessions and what belongs to them.
    pub sessions: Arc<Sessions>,
    /// Serving, or on the way to the end.
    pub lifecycle: Lifecycle,
    metrics: Arc<Metrics>,
    tracer: Option<Tracer>,
}

impl Deref for App {
    type Target = Parts;

    fn deref(&self) -> &Parts {
        &self.0
    }
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
    /// Opens the store, and makes the parts.
    /// Errors: See [`NotStarted`].
    pub fn new(config: Config) -> Result<Self, NotStarted> {
        let store = crate::store::open(&config.store.url, config.store.bounds())?;
        Self::with_store(config, store)
    }

    /// Starts the compute pool and, with a collector, the export of traces, which needs a runtime.
    /// Errors: See [`NotStarted`].
    pub fn with_store(config: Config, store: Arc<dyn Store>) -> Result<Self, NotStarted> {
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
        let (limits, metrics) = (config.limits(), Arc::new(Metrics::default()));
        let images: Cache<Image> = Cache::new(work.image_cache_bytes());
        let labels: Cache<LabelImage> = Cache::new(work.image_cache_bytes() / LABEL_DIVISOR);
        let compiled: Cache<CompiledRest> = Cache::new(work.plan_cache_bytes);
        let setups: Cache<ResolvedRest> = Cache::new(work.plan_cache_bytes / SETUP_DIVISOR);
        let texts: Cache<RevisionText> = Cache::new(work.plan_cache_bytes / TEXT_DIVISOR);
        let admission = Arc::new(Admission::new(
            &config,
            of_client,
            [
                ("labels", Box::new(labels.clone())),
                ("images", Box::new(images.clone())),
                ("plans", Box::new(compiled.clone())),
                ("setups", Box::new(setups.clone())),
                ("texts", Box::new(texts.clone())),
            ],
        )?);
        let images = Arc::new(Images {
            admission: Arc::clone(&admission),
            store: Arc::clone(&store),
            limits: limits.image,
            images,
            labels,
            files: Cache::new(0),
        });
        let plans = Arc::new(Plans {
            admission: Arc::clone(&admission),
            images: Arc::clone(&images),
            limits,
            compiled,
            orders: Cache::new(0),
            setups,
        });
        Ok(Self(Arc::new(Parts {
            images,
            plans: Arc::clone(&plans),
            drawing: Arc::new(Drawing {
                admission: Arc::clone(&admission),
                limits,
                metrics: Arc::clone(&metrics),
            }),
            sessions: Arc::new(Sessions {
                admission: Arc::clone(&admission),
                metrics: Arc::clone(&metrics),
                limits,
                counted: ClientSessions::new(config.store.bounds(), of_client)
                    .with_visitors(clients.visitor_share.of(config.store.bounds().bytes)),
                store,
                sequencer: Sequencer::default(),
                texts,
                plans,
            }),
            lifecycle: Lifecycle::default(),
            admission,
            metrics,
            access,
            tracer,
            config,
        })))
    }

    /// The options.
    pub fn config(&self) -> &Config {
        &self.config
    }

    /// Keys, rates and connections.
    pub fn access(&self) -> &AccessControl {
        &self.access
    }

    /// Admission and compute threads.
    pub fn pool(&self) -> &Pool {
        &self.admission.pool
    }

    /// The memory budget.
    pub fn budget(&self) -> &Budget {
        &self.admission.budget
    }

    /// Counters and histograms.
    pub(crate) fn metrics(&self) -> &Metrics {
        &self.metrics
    }

    /// Starts spans, if there is a collector.
    pub fn tracer(&self) -> Option<&Tracer> {
        self.tracer.as_ref()
    }

    /// Evicts all images, label images, plans, setups and texts. Sessions stay.
    pub fn clear_caches(&self) {
        self.admission
            .caches
            .iter()
            .for_each(|(_, cache)| cache.clear());
    }
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
