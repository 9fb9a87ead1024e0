//! Who sits at the drag: how many sockets there are, of each session, of each client and in all, and whose frame may go to the pool next.

use std::collections::HashMap;
use std::sync::{Arc, Mutex, PoisonError};

use tokio::sync::{Semaphore, watch};

use crate::client::Tenant;
use crate::problem::{Code, Problem};
use crate::session::SessionId;

/// Sockets of one session: a hand, and those who watch it from other windows.
pub const OF_A_SESSION: usize = 32;
/// Seconds after which a client that found no seat may come again.
const RETRY: u32 = 5;

/// All seats. Cloning shares them.
#[derive(Clone, Debug)]
pub struct SocketSlots(Arc<SlotState>);

#[derive(Debug)]
struct SlotState {
    most: usize,
    of_client: usize,
    frames: usize,
    taken: Mutex<Taken>,
    open: watch::Sender<usize>,
}

#[derive(Debug, Default)]
struct Taken {
    sessions: HashMap<SessionId, usize>,
    clients: HashMap<Tenant, (usize, Arc<Semaphore>)>,
}

/// A socket's seat, free again when it is dropped.
#[derive(Debug)]
pub struct SocketSlot {
    slots: Arc<SlotState>,
    id: SessionId,
    tenant: Tenant,
    frames: Arc<Semaphore>,
}

impl SocketSlots {
    /// `most` sockets in all, `of_client` of one client. At most `frames` frames of one client stand before the pool at one time: its others
    /// wait here, in order of arrival, and leave the pool's other places to its requests. Between clients the pool decides.
    pub fn new(most: usize, of_client: u64, frames: usize) -> Self {
        Self(Arc::new(SlotState {
            most,
            of_client: usize::try_from(of_client).unwrap_or(usize::MAX),
            frames: frames.clamp(1, Semaphore::MAX_PERMITS),
            taken: Mutex::default(),
            open: watch::Sender::new(0),
        }))
    }

    /// Takes a seat, at once or not at all.
    /// Errors: [`Code::Overloaded`]; [`Code::RateLimited`] for a client that has as many as it may.
    pub fn take(&self, tenant: Tenant, id: SessionId) -> Result<SocketSlot, Problem> {
        let slots = &self.0;
        let mut taken = slots.taken.lock().unwrap_or_else(PoisonError::into_inner);
        let (all, of_session) = (*slots.open.borrow(), taken.sessions.get(&id).copied().unwrap_or_default());
        let of_client = taken.clients.get(&tenant).map_or(0, |(sockets, _)| *sockets);
        for (what, whose, code, open, most) in [
            ("sockets", "this server", Code::Overloaded, all, slots.most),
            ("session_sockets", "this session", Code::Overloaded, of_session, OF_A_SESSION),
            ("client_sockets", "this client", Code::RateLimited, of_client, slots.of_client),
        ] {
            if open >= most {
                let detail = format!("{whose} has {open} open drag sockets; at most {most}");
                return Err(Problem::new(code, detail).limit(what, most, open + 1).retry_after(RETRY));
            }
        }
        *taken.sessions.entry(id).or_default() += 1;
        let (sockets, frames) = taken.clients.entry(tenant).or_insert_with(|| (0, Arc::new(Semaphore::new(slots.frames))));
        *sockets += 1;
        let frames = Arc::clone(frames);
        slots.open.send_modify(|open| *open += 1);
        Ok(SocketSlot { slots: Arc::clone(slots), id, tenant, frames })
    }

    /// Seats that are taken now.
    pub fn taken(&self) -> usize {
        *self.0.open.borrow()
    }

    /// Waits until every seat is free.
    pub async fn empty(&self) {
        // The sender lives as long as `self`, so waiting cannot fail.
        let _ = self.0.open.subscribe().wait_for(|open| *open == 0).await;
    }
}

impl SocketSlot {
    /// Where the client's frames wait for their turn.
    pub fn frames(&self) -> Arc<Semaphore> {
        Arc::clone(&self.frames)
    }
}

impl Drop for SocketSlot {
    fn drop(&mut self) {
        let mut taken = self.slots.taken.lock().unwrap_or_else(PoisonError::into_inner);
        if let Some(of_session) = taken.sessions.get_mut(&self.id) {
            *of_session -= 1;
            if *of_session == 0 {
                taken.sessions.remove(&self.id);
            }
        }
        if let Some((of_client, _)) = taken.clients.get_mut(&self.tenant) {
            *of_client -= 1;
            if *of_client == 0 {
                taken.clients.remove(&self.tenant);
            }
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
        let tenant = |n: u8| Client { address: [192, 0, 2, n].into(), ..Client::default() }.tenant();
        let session = || SessionId::random(Owner::ANYBODY);
        let seats = SocketSlots::new(OF_A_SESSION + 3, OF_A_SESSION as u64 + 1, 4);
        let one = session();
        let mut held: Vec<SocketSlot> = (0..OF_A_SESSION).map(|_| seats.take(tenant(1), one).unwrap()).collect();
        let refused = seats.take(tenant(1), one).unwrap_err();
        assert_eq!((refused.code, refused.what, refused.retry_after), (Code::Overloaded, Some("session_sockets"), Some(RETRY)));
        held.push(seats.take(tenant(1), session()).unwrap());
        let refused = seats.take(tenant(1), session()).unwrap_err();
        assert_eq!((refused.code, refused.what, refused.retry_after), (Code::RateLimited, Some("client_sockets"), Some(RETRY)));
        held.extend([2, 3].map(|n| seats.take(tenant(n), session()).unwrap()));
        assert_eq!(seats.take(tenant(4), session()).unwrap_err().what, Some("sockets"));
        held.remove(0);
        held.push(seats.take(tenant(1), one).unwrap());
        assert_eq!(seats.taken(), OF_A_SESSION + 3);
        drop(held);
        seats.empty().await;
        let taken = seats.0.taken.lock().unwrap();
        assert!(taken.sessions.is_empty() && taken.clients.is_empty());
    }

    #[test]
    fn frames_of_one_client_wait_for_its_own_alone() {
        let tenant = |n: u8| Client { address: [192, 0, 2, n].into(), ..Client::default() }.tenant();
        let seats = SocketSlots::new(9, 9, 2);
        let [a, b, other] = [1, 1, 2].map(|n| seats.take(tenant(n), SessionId::random(Owner::ANYBODY)).unwrap());
        let _turns = [a.frames().try_acquire_owned().unwrap(), b.frames().try_acquire_owned().unwrap()];
        assert!(a.frames().try_acquire_owned().is_err() && other.frames().try_acquire_owned().is_ok());
    }
}
