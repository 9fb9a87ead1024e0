//! Who sits at the drag: how many sockets there are, of each session and in all, and whose frame may go to the pool next.

use std::collections::HashMap;
use std::sync::{Arc, Mutex, PoisonError};

use tokio::sync::{Semaphore, SemaphorePermit, watch};

use crate::service::problem::{Code, Problem};
use crate::service::session::SessionId;

/// Sockets of one session: a hand, and those who watch it from other windows.
pub const OF_A_SESSION: usize = 32;
/// Seconds after which a client that found no seat may come again.
const RETRY: u32 = 5;

/// All seats. Cloning shares them.
#[derive(Clone, Debug)]
pub struct Seats(Arc<Hall>);

#[derive(Debug)]
struct Hall {
    most: usize,
    taken: Mutex<HashMap<SessionId, usize>>,
    open: watch::Sender<usize>,
    turns: Semaphore,
}

/// A socket's seat, free again when it is dropped.
#[derive(Debug)]
pub struct Seat {
    hall: Arc<Hall>,
    id: SessionId,
}

impl Seats {
    /// `most` sockets in all; so many of their frames stand before the pool at one time, the others wait their turn here and leave the
    /// pool's other places to everyone else.
    #[must_use]
    pub fn new(most: usize, frames: usize) -> Self {
        Self(Arc::new(Hall {
            most,
            taken: Mutex::default(),
            open: watch::Sender::new(0),
            turns: Semaphore::new(frames.clamp(1, Semaphore::MAX_PERMITS)),
        }))
    }

    /// Takes a seat, at once or not at all.
    ///
    /// # Errors
    /// [`Code::Overloaded`].
    pub fn take(&self, id: SessionId) -> Result<Seat, Problem> {
        let mut taken = self.0.taken.lock().unwrap_or_else(PoisonError::into_inner);
        let (all, of_session) = (*self.0.open.borrow(), taken.get(&id).copied().unwrap_or_default());
        for (what, open, most) in [("sockets", all, self.0.most), ("session_sockets", of_session, OF_A_SESSION)] {
            if open >= most {
                let detail = format!("all drag sockets are taken: {what} would be {}; at most {most}", open + 1);
                return Err(Problem::new(Code::Overloaded, detail).limit(what, most, open + 1).retry_after(RETRY));
            }
        }
        taken.insert(id, of_session + 1);
        self.0.open.send_modify(|open| *open += 1);
        Ok(Seat { hall: Arc::clone(&self.0), id })
    }

    /// Seats that are taken now.
    #[must_use]
    pub fn taken(&self) -> usize {
        *self.0.open.borrow()
    }

    /// Waits until every seat is free.
    pub async fn empty(&self) {
        // The sender lives as long as `self`, so waiting cannot fail.
        let _ = self.0.open.subscribe().wait_for(|open| *open == 0).await;
    }

    /// Waits for a frame's turn, in order of arrival.
    pub async fn turn(&self) -> SemaphorePermit<'_> {
        self.0.turns.acquire().await.expect("the semaphore is never closed")
    }
}

impl Drop for Seat {
    fn drop(&mut self) {
        let mut taken = self.hall.taken.lock().unwrap_or_else(PoisonError::into_inner);
        if let Some(of_session) = taken.get_mut(&self.id) {
            *of_session -= 1;
            if *of_session == 0 {
                taken.remove(&self.id);
            }
        }
        self.hall.open.send_modify(|open| *open -= 1);
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::service::client::Owner;

    #[tokio::test]
    async fn seats_are_bounded_in_all_and_for_a_session_and_given_back() {
        let seats = Seats::new(OF_A_SESSION + 1, 4);
        let (one, other) = (SessionId::random(Owner::ANYBODY), SessionId::random(Owner::ANYBODY));
        let mut held: Vec<Seat> = (0..OF_A_SESSION).map(|_| seats.take(one).unwrap()).collect();
        let refused = seats.take(one).unwrap_err();
        assert_eq!((refused.code, refused.what, refused.retry_after), (Code::Overloaded, Some("session_sockets"), Some(RETRY)));
        held.push(seats.take(other).unwrap());
        assert_eq!(seats.take(SessionId::random(Owner::ANYBODY)).unwrap_err().what, Some("sockets"));
        held.remove(0);
        held.push(seats.take(one).unwrap());
        assert_eq!(seats.taken(), OF_A_SESSION + 1);
        drop(held);
        seats.empty().await;
        assert!(seats.0.taken.lock().unwrap().is_empty());
    }
}
