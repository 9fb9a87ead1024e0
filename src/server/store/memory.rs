//! Sessions in memory: they end with the process.

use std::sync::{Arc, Mutex, MutexGuard, PoisonError};

use bytes::Bytes;
use mlswarp::warp::Digest;

use super::index::Index;
use super::{
    NamedFile, Put, Record, SWEPT_AT_ONCE, Session, Store, StoreError, StoreFuture, StoreLimits,
    StoreStats, in_pieces, ready,
};
use crate::client::Owner;
use crate::session::{Revision, SessionId};

/// The store in memory.
#[derive(Debug)]
pub struct MemoryStore(Mutex<Index>);

impl MemoryStore {
    /// An empty store.
    pub fn new(bounds: StoreLimits) -> Self {
        Self(Mutex::new(Index::new(bounds, true)))
    }

    fn lock(&self) -> MutexGuard<'_, Index> {
        // No operation leaves the index half-changed where it could panic.
        self.0.lock().unwrap_or_else(PoisonError::into_inner)
    }
}

fn put(index: &mut Index, record: Arc<Record>, files: &[NamedFile]) -> Result<Put, StoreError> {
    let outcome = loop {
        match index.check_put(&record, files) {
            // No more than what makes room.
            Err(StoreError::Full { .. }) if sweep(index) > 0 => {}
            checked => break checked?,
        }
    };
    Ok(index.put(record, files, outcome))
}

fn revise(
    index: &mut Index,
    old: Revision,
    new: Arc<Record>,
    layer: &[NamedFile],
) -> Result<Option<Session>, StoreError> {
    Ok(if index.check_revise(old, &new, layer)? {
        index.revise(new, layer)
    } else {
        None
    })
}

fn delete(index: &mut Index, id: SessionId) -> Result<(), StoreError> {
    if index.check_delete(id)? {
        index.delete(id);
    }
    Ok(())
}

/// Removes some of what has expired.
fn sweep(index: &mut Index) -> usize {
    let expired = index.expired(SWEPT_AT_ONCE);
    index.expire(&expired);
    expired.len()
}

impl Store for MemoryStore {
    fn put(&self, record: Arc<Record>, files: Vec<NamedFile>) -> StoreFuture<'_, Put> {
        ready(put(&mut self.lock(), record, &files))
    }

    fn revise(
        &self,
        old: Revision,
        new: Arc<Record>,
        layer: Option<NamedFile>,
    ) -> StoreFuture<'_, Option<Session>> {
        ready(revise(&mut self.lock(), old, new, layer.as_slice()))
    }

    fn peek(&self, id: SessionId) -> StoreFuture<'_, Session> {
        ready(self.lock().peek(id))
    }

    fn touch(&self, id: SessionId, seq: Option<u64>) -> StoreFuture<'_, Session> {
        ready(self.lock().touch(id, seq))
    }

    fn delete(&self, id: SessionId) -> StoreFuture<'_, ()> {
        ready(delete(&mut self.lock(), id))
    }

    fn was_deleted(&self, id: SessionId) -> StoreFuture<'_, bool> {
        ready(Ok(self.lock().was_deleted(id)))
    }

    /// None: the file is shared.
    fn file_bytes(&self, _: SessionId, _: Digest) -> StoreFuture<'_, u64> {
        ready(Ok(0))
    }

    fn file(&self, id: SessionId, digest: Digest) -> StoreFuture<'_, Bytes> {
        ready(
            self.lock()
                .file(id.owner(), digest)
                .ok_or(StoreError::NoSuchSession),
        )
    }

    fn local_record(&self, id: SessionId) -> Option<Arc<Record>> {
        self.lock().peek(id).ok().map(|session| session.record)
    }

    fn names(&self, owner: Owner, digest: Digest) -> bool {
        self.lock().names(owner, digest)
    }

    fn sweep(&self) -> StoreFuture<'_, usize> {
        Box::pin(async { Ok(in_pieces(|| sweep(&mut self.lock())).await) })
    }

    fn ready(&self) -> StoreFuture<'_, ()> {
        ready(Ok(()))
    }

    fn figures(&self) -> StoreStats {
        let index = self.lock();
        StoreStats {
            sessions: index.len() as u64,
            bytes: index.bytes(),
            ..StoreStats::default()
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::store::index::PutOutcome;
    use crate::store::tests::suite::bounds;
    use crate::store::tests::{model, suite};

    #[tokio::test]
    async fn keeps_the_rules_of_every_store() {
        suite::bounded(async |wanted| MemoryStore::new(wanted)).await;
    }

    #[tokio::test]
    async fn does_what_the_model_does() {
        model::with_each_seed(async |seed| {
            let open = async |old: Option<Vec<MemoryStore>>| {
                old.unwrap_or_else(|| vec![MemoryStore::new(model::bounds())])
            };
            model::follows(open, seed, 400, true, false).await;
        })
        .await;
    }

    #[tokio::test]
    async fn a_sweep_gives_way_between_pieces() {
        const PIECES: usize = 3;
        let bounds = StoreLimits {
            idle: std::time::Duration::ZERO,
            ..bounds()
        };
        let store = MemoryStore::new(bounds);
        for _ in 0..PIECES * SWEPT_AT_ONCE {
            let record = suite::record(1);
            let mut index = store.lock();
            index.put(record, &suite::files(1), PutOutcome::Create);
        }
        let mut sweep = store.sweep();
        for left in (0..PIECES).rev() {
            let polled = std::future::poll_fn(|context| {
                std::task::Poll::Ready(sweep.as_mut().poll(context))
            });
            assert!(polled.await.is_pending());
            assert_eq!(store.lock().len(), left * SWEPT_AT_ONCE);
        }
        assert_eq!(sweep.await, Ok(PIECES * SWEPT_AT_ONCE));
    }

    #[tokio::test]
    async fn what_is_deleted_is_not_held() {
        let store = MemoryStore::new(bounds());
        let record = suite::record(1);
        store
            .put(Arc::clone(&record), suite::files(1))
            .await
            .unwrap();
        store.delete(record.id).await.unwrap();
        let index = store.lock();
        assert!(index.file(record.id.owner(), record.image).is_none() && index.bytes() == 0);
    }
}
