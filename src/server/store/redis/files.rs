//! Connections for files. Each transfers one file at a time, so that a slow file delays neither
//! records nor other files.

use std::future::Future;
use std::sync::{Arc, Mutex, PoisonError};
use std::time::{Duration, Instant};

use redis::RedisResult;
use redis::aio::MultiplexedConnection;
use tokio::sync::Semaphore;
use tokio::time::timeout;

use super::connection::{Endpoint, RedisConnection};
use crate::store::StoreError;

/// Files that are transferred at one time, at most.
const MAX_TRANSFERS: usize = 8;
/// The client library keeps the largest buffer of a connection: after a larger file than this the
/// connection is closed.
const LARGE_FILE: usize = 1 << 20;

pub(crate) struct FileConnections {
    permits: Semaphore,
    /// The most recently used one is last, and is used next.
    idle: Mutex<Vec<RedisConnection>>,
}

/// Gives its connection back when it is dropped.
struct Transfer<'a> {
    files: &'a FileConnections,
    connection: RedisConnection,
    is_reusable: bool,
}

impl Drop for Transfer<'_> {
    fn drop(&mut self) {
        // The answer of an abandoned request would come before the next one's.
        if !self.is_reusable {
            self.connection.close();
        }
        self.files
            .idle
            .lock()
            .unwrap_or_else(PoisonError::into_inner)
            .push(self.connection.clone());
    }
}

impl FileConnections {
    pub(crate) fn new(endpoint: &Arc<Endpoint>) -> Self {
        let idle = (0..MAX_TRANSFERS)
            .map(|_| RedisConnection::new(endpoint))
            .collect();
        Self {
            permits: Semaphore::new(MAX_TRANSFERS),
            idle: Mutex::new(idle),
        }
    }

    /// As [`RedisConnection::ask`], on a connection that transfers nothing else. `len` is the size
    /// of the transferred file in bytes.
    pub(crate) async fn ask<T, F>(
        &self,
        limit: Duration,
        len: impl FnOnce(&T) -> usize,
        ask: impl Fn(MultiplexedConnection) -> F,
    ) -> Result<T, StoreError>
    where
        F: Future<Output = RedisResult<T>>,
    {
        let until = Instant::now() + limit;
        let Ok(Ok(_permit)) = timeout(limit, self.permits.acquire()).await else {
            return Err(StoreError::Away);
        };
        let idle = self
            .idle
            .lock()
            .unwrap_or_else(PoisonError::into_inner)
            .pop();
        let Some(connection) = idle else {
            return Err(StoreError::Away);
        };
        let mut transfer = Transfer {
            files: self,
            connection,
            is_reusable: false,
        };
        let answer = transfer
            .connection
            .ask(until.saturating_duration_since(Instant::now()), ask)
            .await;
        transfer.is_reusable = answer
            .as_ref()
            .is_ok_and(|answer| len(answer) <= LARGE_FILE);
        answer
    }
}
