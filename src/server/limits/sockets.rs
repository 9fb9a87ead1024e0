//! Limits the number of drag sockets, in total, per session and per client, and the number of
//! frames that one client submits at a time.

use std::sync::{Arc, Mutex, PoisonError};

use tokio::sync::{OwnedSemaphorePermit, Semaphore, watch};

use super::client_limit::ClientLimit;
use super::counts::Counts;
use crate::client::Tenant;
use crate::problem::{Code, Problem};
use crate::session::SessionId;

/// Maximum number of sockets of one session: the editor, and windows that watch it.
const MAX_PER_SESSION: usize = 32;
/// Seconds after which a refused client may retry.
const RETRY_SECONDS: u32 = 5;

/// Admits drag sockets. Clones share the counts.
#[derive(Clone, Debug)]
pub(crate) struct SocketSlots(Arc<SlotState>);

#[derive(Debug)]
struct SlotState {
    max: usize,
    max_per_client: ClientLimit,
    max_per_visitor: usize,
    max_frames: usize,
    max_frames_of_visitor: usize,
    counts: Mutex<SocketCounts>,
    open: watch::Sender<usize>,
}

#[derive(Debug, Default)]
struct SocketCounts {
    sessions: Counts<SessionId>,
    /// Clients with their visitors, and each visitor.
    clients: Counts<Tenant, Option<Arc<Semaphore>>>,
}

/// The slot of one socket, returned when dropped.
#[derive(Debug)]
pub(crate) struct SocketSlot {
    slots: Arc<SlotState>,
    id: SessionId,
    tenant: Tenant,
    pub(crate) frames: FrameTurns,
}

/// Where the frames of a client wait before they enter the pool; those of a visitor wait for its
/// own first.
#[derive(Clone, Debug)]
pub(crate) struct FrameTurns {
    of_visitor: Option<Arc<Semaphore>>,
    of_client: Arc<Semaphore>,
}

/// The turn of a frame, passed on when dropped.
#[derive(Debug)]
pub(crate) struct FrameTurn {
    _of_visitor: Option<OwnedSemaphorePermit>,
    _of_client: OwnedSemaphorePermit,
}

impl FrameTurns {
    /// Waits for a turn.
    pub(crate) async fn take(&self) -> FrameTurn {
        let of = async |semaphore: &Arc<Semaphore>| {
            Arc::clone(semaphore)
                .acquire_owned()
                .await
                .expect("the semaphore is never closed")
        };
        let of_visitor = match &self.of_visitor {
            Some(semaphore) => Some(of(semaphore).await),
            None => None,
        };
        FrameTurn {
            _of_visitor: of_visitor,
            _of_client: of(&self.of_client).await,
        }
    }
}

impl SocketSlots {
    /// At most `max_frames` frames of one client are in the pool or its queue at a time; the rest
    /// of the queue is for its requests.
    pub(crate) fn new(
        max: usize,
        max_per_client: impl Into<ClientLimit>,
        max_frames: usize,
    ) -> Self {
        Self(Arc::new(SlotState {
            max,
            max_per_client: max_per_client.into(),
            max_per_visitor: usize::MAX,
            max_frames: max_frames.clamp(1, Semaphore::MAX_PERMITS),
            max_frames_of_visitor: Semaphore::MAX_PERMITS,
            counts: Mutex::default(),
            open: watch::Sender::new(0),
        }))
    }

    /// With limits for each visitor: its sockets, and its frames in the pool.
    pub(crate) fn with_visitors(self, sockets: u64, frames: u64) -> Self {
        let slots = Arc::into_inner(self.0).expect("it is not shared yet");
        let whole = |number: u64| usize::try_from(number).unwrap_or(usize::MAX);
        Self(Arc::new(SlotState {
            max_per_visitor: whole(sockets),
            max_frames_of_visitor: whole(frames).clamp(1, Semaphore::MAX_PERMITS),
            ..slots
        }))
    }

    /// Takes a slot.
    /// Errors: [`Code::Overloaded`]; [`Code::RateLimited`] for a client with too many sockets.
    pub(crate) fn acquire(&self, tenant: Tenant, id: SessionId) -> Result<SocketSlot, Problem> {
        let slots = &self.0;
        let mut counts = slots.counts.lock().unwrap_or_else(PoisonError::into_inner);
        let max_per_client = usize::try_from(slots.max_per_client.get()).unwrap_or(usize::MAX);
        for (what, whose, code, open, max) in [
            (
                "sockets",
                "this server",
                Code::Overloaded,
                self.open(),
                slots.max,
            ),
            (
                "session_sockets",
                "this session",
                Code::Overloaded,
                counts.sessions.get(&id),
                MAX_PER_SESSION,
            ),
            (
                "client_sockets",
                "this client",
                Code::RateLimited,
                counts.clients.get(&tenant.payer()),
                max_per_client,
            ),
            (
                "visitor_sockets",
                "this visitor",
                Code::RateLimited,
                counts.clients.get(&tenant),
                if tenant == tenant.payer() {
                    usize::MAX
                } else {
                    slots.max_per_visitor
                },
            ),
        ] {
            if open >= max {
                let by = match what {
                    "client_sockets" => " (--max-client-share)",
                    "visitor_sockets" => " (--max-visitor-share)",
                    _ => "",
                };
                let detail =
                    format!("{whose} has {open} open drag sockets; the limit is {max}{by}");
                return Err(Problem::new(code, detail)
                    .limit(what, max, open + 1)
                    .retry_after(RETRY_SECONDS));
            }
        }
        counts.sessions.add(id);
        let mut turns = |tenant: Tenant, max: usize| {
            let semaphore = counts.clients.add(tenant);
            Arc::clone(semaphore.get_or_insert_with(|| Arc::new(Semaphore::new(max))))
        };
        let frames = FrameTurns {
            of_client: turns(tenant.payer(), slots.max_frames),
            of_visitor: (tenant != tenant.payer())
                .then(|| turns(tenant, slots.max_frames_of_visitor)),
        };
        slots.open.send_modify(|open| *open += 1);
        Ok(SocketSlot {
            slots: Arc::clone(slots),
            id,
            tenant,
            frames,
        })
    }

    /// Open sockets.
    pub(crate) fn open(&self) -> usize {
        *self.0.open.borrow()
    }

    /// Waits until no socket is open.
    pub(crate) async fn closed(&self) {
        // The wait cannot fail: `self` owns the sender.
        let _ = self.0.open.subscribe().wait_for(|open| *open == 0).await;
    }
}

impl Drop for SocketSlot {
    fn drop(&mut self) {
        let mut counts = self
            .slots
            .counts
            .lock()
            .unwrap_or_else(PoisonError::into_inner);
        counts.sessions.remove(&self.id);
        counts.clients.remove(&self.tenant.payer());
        if self.tenant != self.tenant.payer() {
            counts.clients.remove(&self.tenant);
        }
        self.slots.open.send_modify(|open| *open -= 1);
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::client::{Client, Owner};

    #[tokio::test]
    async fn seats_are_bounded_in_all_for_a_client_and_for_a_session_and_given_back() {
        let tenant = |n: u8| {
            Client {
                address: [192, 0, 2, n].into(),
                ..Client::default()
            }
            .tenant()
        };
        let session = || SessionId::random(Owner::ANYBODY);
        let seats = SocketSlots::new(MAX_PER_SESSION + 3, MAX_PER_SESSION as u64 + 1, 4);
        let one = session();
        let mut held: Vec<SocketSlot> = (0..MAX_PER_SESSION)
            .map(|_| seats.acquire(tenant(1), one).unwrap())
            .collect();
        let refused = seats.acquire(tenant(1), one).unwrap_err();
        assert_eq!(
            (refused.code, refused.what, refused.retry_after),
            (
                Code::Overloaded,
                Some("session_sockets"),
                Some(RETRY_SECONDS)
            )
        );
        held.push(seats.acquire(tenant(1), session()).unwrap());
        let refused = seats.acquire(tenant(1), session()).unwrap_err();
        assert_eq!(
            (refused.code, refused.what, refused.retry_after),
            (
                Code::RateLimited,
                Some("client_sockets"),
                Some(RETRY_SECONDS)
            )
        );
        held.extend([2, 3].map(|n| seats.acquire(tenant(n), session()).unwrap()));
        assert_eq!(
            seats.acquire(tenant(4), session()).unwrap_err().what,
            Some("sockets")
        );
        held.remove(0);
        held.push(seats.acquire(tenant(1), one).unwrap());
        assert_eq!(seats.open(), MAX_PER_SESSION + 3);
        drop(held);
        seats.closed().await;
        let counts = seats.0.counts.lock().unwrap();
        assert!(counts.sessions.by_key.is_empty() && counts.clients.by_key.is_empty());
    }

    #[tokio::test]
    async fn frames_of_one_client_wait_for_its_own_alone() {
        use futures_util::FutureExt as _;
        let tenant = |n: u8| {
            Client {
                address: [192, 0, 2, n].into(),
                ..Client::default()
            }
            .tenant()
        };
        let seats = SocketSlots::new(9, 9, 2);
        let [a, b, other] = [1, 1, 2].map(|n| {
            seats
                .acquire(tenant(n), SessionId::random(Owner::ANYBODY))
                .unwrap()
        });
        let _turns = [a.frames.take().await, b.frames.take().await];
        assert!(
            a.frames.take().now_or_never().is_none()
                && other.frames.take().now_or_never().is_some()
        );
    }

    #[tokio::test]
    async fn a_visitor_has_a_part_of_the_sockets_and_frames_of_its_key() {
        use futures_util::FutureExt as _;
        let owner = Owner::from_bytes([1; 16]);
        let seats = SocketSlots::new(9, 5, 3).with_visitors(2, 2);
        let ids = [SessionId::random(owner), SessionId::random(owner)];
        let open = |n: usize| seats.acquire(Tenant::Visitor(owner, ids[n].uuid()), ids[n]);
        let one = [open(0).unwrap(), open(0).unwrap()];
        let refused = open(0).unwrap_err();
        assert_eq!(
            (refused.code, refused.what),
            (Code::RateLimited, Some("visitor_sockets"))
        );
        let other = [open(1).unwrap(), open(1).unwrap()];
        let own = seats.acquire(Tenant::Key(owner), ids[0]).unwrap();
        // All together have what the key has.
        let refused = seats.acquire(Tenant::Key(owner), ids[1]).unwrap_err();
        assert_eq!(refused.what, Some("client_sockets"));
        let turns = [one[0].frames.take().await, one[1].frames.take().await];
        assert!(one[0].frames.take().now_or_never().is_none(), "its own two");
        let third = other[0].frames.take().await;
        assert!(
            own.frames.take().now_or_never().is_none(),
            "the key's three"
        );
        drop(turns);
        assert!(own.frames.take().now_or_never().is_some());
        drop((third, one, other, own));
        seats.closed().await;
        let counts = seats.0.counts.lock().unwrap();
        assert!(counts.sessions.by_key.is_empty() && counts.clients.by_key.is_empty());
    }
}
