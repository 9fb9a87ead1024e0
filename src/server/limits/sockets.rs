//! Limits the number of drag sockets, in total, per session and per client, and the number of
//! frames that one client submits at a time.

use std::sync::{Arc, Mutex, PoisonError};

use tokio::sync::{Semaphore, watch};

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
    max_frames: usize,
    counts: Mutex<SocketCounts>,
    open: watch::Sender<usize>,
}

#[derive(Debug, Default)]
struct SocketCounts {
    sessions: Counts<SessionId>,
    clients: Counts<Tenant, Option<Arc<Semaphore>>>,
}

/// The slot of one socket, returned when dropped.
#[derive(Debug)]
pub(crate) struct SocketSlot {
    slots: Arc<SlotState>,
    id: SessionId,
    tenant: Tenant,
    /// The frames of the client wait here before they enter the pool.
    pub(crate) frames: Arc<Semaphore>,
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
            max_frames: max_frames.clamp(1, Semaphore::MAX_PERMITS),
            counts: Mutex::default(),
            open: watch::Sender::new(0),
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
                counts.clients.get(&tenant),
                max_per_client,
            ),
        ] {
            if open >= max {
                let by = if what == "client_sockets" {
                    " (--max-client-share)"
                } else {
                    ""
                };
                let detail =
                    format!("{whose} has {open} open drag sockets; the limit is {max}{by}");
                return Err(Problem::new(code, detail)
                    .limit(what, max, open + 1)
                    .retry_after(RETRY_SECONDS));
            }
        }
        counts.sessions.add(id);
        let frames = Arc::clone(
            counts
                .clients
                .add(tenant)
                .get_or_insert_with(|| Arc::new(Semaphore::new(slots.max_frames))),
        );
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
        counts.clients.remove(&self.tenant);
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

    #[test]
    fn frames_of_one_client_wait_for_its_own_alone() {
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
        let _turns = [
            a.frames.clone().try_acquire_owned().unwrap(),
            b.frames.clone().try_acquire_owned().unwrap(),
        ];
        assert!(
            a.frames.clone().try_acquire_owned().is_err()
                && other.frames.clone().try_acquire_owned().is_ok()
        );
    }
}
