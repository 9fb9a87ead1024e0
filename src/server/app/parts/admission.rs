//! Who may compute, and in which memory: the pool, the memory budget, and what each client may have
//! of both.

use std::sync::Arc;
use std::time::Duration;

use crate::app::RETRY_SECONDS;
use crate::cache::AnyCache;
use crate::client::Client;
use crate::config::Config;
use crate::limits::client_limit::ClientLimit;
use crate::limits::client_quota::{ClientQuota, ClientQuotas, QuotaKind};
use crate::limits::memory::{Budget, BudgetExceeded, MemoryClass, Reservation};
use crate::limits::sockets::SocketSlots;
use crate::pool::{NoThreads, Pool, PoolConfig, PoolError, QueueKey, Ticket, WorkClass, aside};
use crate::problem::{Code, Problem};
use crate::store::{Record, record_bytes};

/// Memory for a small image, bytes; a server with less free memory is not ready.
const MIN_FREE: u64 = 1 << 20;
/// The unread responses of one client may use the memory divided by this.
const UNREAD_DIVISOR: u64 = 4;
/// Attempts to admit a part of an answer that has begun, and the pause between them.
const PATIENT_ATTEMPTS: usize = 100;
const PATIENT_PAUSE: Duration = Duration::from_millis(50);

/// A cache and its name in metrics.
pub(crate) type NamedCache = (&'static str, Box<dyn AnyCache>);

/// Places and memory for requests.
#[derive(Debug)]
pub struct Admission {
    pub(crate) pool: Pool,
    pub(crate) budget: Budget,
    response_quotas: ClientQuotas,
    request_quotas: ClientQuotas,
    pub(crate) sockets: SocketSlots,
    /// Their idle entries make room for requests.
    pub(crate) caches: [NamedCache; 5],
}

impl Admission {
    /// Starts the compute threads. `of_client` gives one client's share of a total, and the
    /// configuration that of a visitor below a key.
    /// Errors: The operating system refused to start threads.
    pub(crate) fn new(
        config: &Config,
        of_client: impl Fn(u64) -> ClientLimit,
        caches: [NamedCache; 5],
    ) -> Result<Self, NoThreads> {
        let (work, max_sockets) = (config.work, config.clients.max_sockets);
        let (workers, queue, memory) = (work.workers, work.queue(), work.memory_bytes);
        let upload = MemoryClass::Upload.share(memory);
        let frames = workers.max(queue / 2);
        let of_visitor = |total| config.clients.visitor_share.of(total);
        Ok(Self {
            pool: Pool::new(PoolConfig {
                workers,
                queue,
                drag_wait: work.drag_wait,
                upload_wait: work.upload_wait,
            })?,
            budget: Budget::new(memory),
            response_quotas: ClientQuotas::new(QuotaKind::Responses, memory / UNREAD_DIVISOR)
                .with_visitors(of_visitor(memory / UNREAD_DIVISOR)),
            request_quotas: ClientQuotas::new(QuotaKind::Requests, of_client(upload))
                .with_visitors(of_visitor(upload)),
            // The frames of one client may use half of the queue, its requests the other half.
            sockets: SocketSlots::new(max_sockets, of_client(max_sockets as u64), frames)
                .with_visitors(of_visitor(max_sockets as u64), of_visitor(frames as u64)),
            caches,
        })
    }

    /// Waits for the right to decode an image or to build a plan.
    /// Errors: The queue is full, or no worker became free in time.
    pub(crate) async fn upload(&self, key: QueueKey) -> Result<Ticket, PoolError> {
        self.pool.admit(WorkClass::Upload, key).await
    }

    /// As [`Admission::upload`], for a part of an answer that has begun: a busy server delays it.
    pub(crate) async fn upload_patiently(&self, key: QueueKey) -> Result<Ticket, PoolError> {
        for _ in 0..PATIENT_ATTEMPTS {
            match self.upload(key).await {
                Err(PoolError::Full | PoolError::Late { .. }) => {
                    tokio::time::sleep(PATIENT_PAUSE).await;
                }
                admitted => return admitted,
            }
        }
        self.upload(key).await
    }

    /// Waits for the right to send a file to the store, or to fetch one: few at a time, fairly
    /// between clients.
    pub(crate) async fn transfer(&self, key: QueueKey) -> Result<Ticket, PoolError> {
        self.pool.admit(WorkClass::Transfer, key).await
    }

    /// Rejects an upload before its body is read, if the queue would reject it.
    /// Errors: [`Code::Overloaded`].
    pub(crate) fn require_queue_place(&self, client: Client) -> Result<(), Problem> {
        if self
            .pool
            .rejects(WorkClass::Upload, QueueKey::client(client))
        {
            Err(PoolError::Full.into())
        } else {
            Ok(())
        }
    }

    /// Fails if a new client would be rejected.
    /// Errors: [`Code::Overloaded`], with the reason.
    pub(crate) fn require_room(&self) -> Result<(), Problem> {
        if [WorkClass::Drag, WorkClass::Upload]
            .into_iter()
            .any(|class| self.pool.is_full(class))
        {
            return Err(PoolError::Full.into());
        }
        let has_idle_entry = || self.caches.iter().any(|(_, cache)| cache.is_any_idle());
        if self.budget.has(MemoryClass::Upload, MIN_FREE) || has_idle_entry() {
            return Ok(());
        }
        Err(Problem::new(
            Code::Overloaded,
            "the server has no memory for another image",
        )
        .retry_after(RETRY_SECONDS))
    }

    /// Reserves memory before it is allocated; idle cache entries are evicted for it.
    /// Errors: [`Code::TooLarge`] if it can never fit, [`Code::Overloaded`] if it does not fit now.
    pub fn reserve(&self, purpose: MemoryClass, bytes: u64) -> Result<Reservation, Problem> {
        self.evicting_idle(|| self.budget.take(purpose, bytes))
    }

    /// As [`Admission::reserve`], for memory that counts in the quota of a client. Errors: As
    /// [`Admission::reserve`]; [`Code::Overloaded`] for a client with too many unread responses,
    /// [`Code::RateLimited`] for one whose requests use too much.
    pub fn reserve_for(
        &self,
        purpose: MemoryClass,
        quota: &ClientQuota,
        bytes: u64,
    ) -> Result<Reservation, Problem> {
        self.evicting_idle(|| self.budget.take_for(purpose, quota, bytes))
    }

    /// Reserves more.
    /// Errors: As [`Admission::reserve`].
    pub(crate) fn reserve_more(
        &self,
        reservation: &mut Reservation,
        more: u64,
    ) -> Result<(), Problem> {
        self.evicting_idle(|| reservation.grow(more))
    }

    /// The client's quota of memory for responses that it has not read.
    pub fn response_quota(&self, client: Client) -> ClientQuota {
        self.response_quotas.of(client)
    }

    /// The client's quota of memory for requests that it is sending.
    pub fn request_quota(&self, client: Client) -> ClientQuota {
        self.request_quotas.of(client)
    }

    /// Takes the memory of what is read from a request, which counts for the client.
    pub(crate) fn reserving(
        self: &Arc<Self>,
        purpose: MemoryClass,
        client: Client,
    ) -> impl FnOnce(u64) -> Result<Reservation, Problem> + Send + use<> {
        let (admission, quota) = (Arc::clone(self), self.request_quota(client));
        move |bytes| admission.reserve_for(purpose, &quota, bytes)
    }

    /// As [`Admission::reserving`], for a request about a session, whose pose may be copied in
    /// place of another one.
    pub(crate) fn reserving_pose(
        self: &Arc<Self>,
        purpose: MemoryClass,
        client: Client,
        record: &Record,
    ) -> impl FnOnce(u64) -> Result<Reservation, Problem> + Send + use<> {
        let (copied, reserve) = (
            record.pose.as_ref().map_or(0, |_| 2 * record_bytes(record)),
            self.reserving(purpose, client),
        );
        move |bytes| reserve(bytes + copied)
    }

    /// As [`Admission::reserve`] and the others, for the runtime's thread: what is evicted is freed
    /// elsewhere, before memory is taken again.
    pub(crate) async fn reserve_aside<T>(
        self: &Arc<Self>,
        mut take: impl FnMut(&Budget) -> Result<T, BudgetExceeded>,
    ) -> Result<T, Problem> {
        loop {
            match take(&self.budget) {
                Ok(taken) => return Ok(taken),
                Err(error) if error.may_be_evicted_for() => {
                    let admission = Arc::clone(self);
                    if !aside(true, move || admission.evict_idle()).await {
                        return Err(self.refused(error));
                    }
                }
                Err(error) => return Err(self.refused(error)),
            }
        }
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
        self.budget.count_refusal();
        error.into()
    }

    /// Evicts an idle entry of the largest cache that has one. False if there is none.
    pub(crate) fn evict_idle(&self) -> bool {
        let mut caches = self
            .caches
            .each_ref()
            .map(|(_, cache)| (cache.usage().bytes, cache));
        caches.sort_by_key(|(bytes, _)| std::cmp::Reverse(*bytes));
        caches.iter().any(|(_, cache)| cache.evict_idle())
    }
}
