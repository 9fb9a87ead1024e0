//! Connections for files, a few, each of which transfers one file at a time: a file that comes slowly keeps no record and no other file waiting.

use std::future::Future;
use std::sync::{Arc, Mutex, PoisonError};
use std::time::{Duration, Instant};

use redis::RedisResult;
use redis::aio::MultiplexedConnection;
use tokio::sync::Semaphore;
use tokio::time::timeout;

use super::connection::{Peer, RedisConnection};
use crate::store::StoreError;

/// Files that are transferred at one time, at most. Others wait for a connection, as long as they may take in all.
const TRANSFERS: usize = 8;
/// The client library keeps the buffer of the largest answer of a connection: after a larger file than this the connection is closed.
const LARGE: usize = 1 << 20;

/// The connections.
pub(crate) struct Files {
    places: Semaphore,
    /// Those that transfer nothing now; the one that was used last is used next.
    free: Mutex<Vec<RedisConnection>>,
}

/// A connection that transfers a file.
struct Transfer<'a> {
    files: &'a Files,
    line: RedisConnection,
    /// It can transfer another one.
    is_sound: bool,
}

impl Drop for Transfer<'_> {
    fn drop(&mut self) {
        // An answer that nobody waits for any more would come before the next one.
        if !self.is_sound {
            self.line.close();
        }
        self.files.free.lock().unwrap_or_else(PoisonError::into_inner).push(self.line.clone());
    }
}

impl Files {
    pub(crate) fn new(peer: &Arc<Peer>) -> Self {
        let free = (0..TRANSFERS).map(|_| RedisConnection::new(peer)).collect();
        Self { places: Semaphore::new(TRANSFERS), free: Mutex::new(free) }
    }

    /// What the server says to `ask` within `patience`, by a connection that transfers nothing else. `len`: bytes of the file.
    pub(crate) async fn ask<T, F>(
        &self,
        patience: Duration,
        len: impl FnOnce(&T) -> usize,
        ask: impl Fn(MultiplexedConnection) -> F,
    ) -> Result<T, StoreError>
    where
        F: Future<Output = RedisResult<T>>,
    {
        let until = Instant::now() + patience;
        let Ok(Ok(_place)) = timeout(patience, self.places.acquire()).await else { return Err(StoreError::Away) };
        let free = self.free.lock().unwrap_or_else(PoisonError::into_inner).pop();
        let Some(line) = free else { return Err(StoreError::Away) };
        let mut transfer = Transfer { files: self, line, is_sound: false };
        let answer = transfer.line.ask(until.saturating_duration_since(Instant::now()), ask).await;
        transfer.is_sound = answer.as_ref().is_ok_and(|answer| len(answer) <= LARGE);
        answer
    }
}
