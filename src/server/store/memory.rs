//! Sessions in memory: they end with the process.

use std::collections::HashMap;
use std::sync::{Arc, Mutex, MutexGuard, PoisonError};

use bytes::Bytes;
use mlswarp::warp::Digest;

use super::index::Index;
use super::{Answer, Bounds, Figures, Put, Record, Session, Store, StoreError};
use crate::client::Owner;
use crate::session::{Revision, SessionId};

/// The store that is built in.
#[derive(Debug)]
pub struct MemoryStore(Mutex<MemoryState>);

#[derive(Debug)]
struct MemoryState {
    index: Index,
    files: HashMap<Digest, Bytes>,
}

impl MemoryStore {
    /// An empty store.
    #[must_use]
    pub fn new(bounds: Bounds) -> Self {
        Self(Mutex::new(MemoryState { index: Index::new(bounds), files: HashMap::new() }))
    }

    fn lock(&self) -> MutexGuard<'_, MemoryState> {
        // No operation leaves the maps half-changed where it could panic.
        self.0.lock().unwrap_or_else(PoisonError::into_inner)
    }
}

impl MemoryState {
    fn put(&mut self, record: Arc<Record>, file: Bytes) -> Result<Put, StoreError> {
        let len = file.len() as u64;
        if self.index.weigh(&record, len).is_err() {
            self.sweep();
        }
        let will = self.index.weigh(&record, len)?;
        self.free(&[record.id], Some(record.image));
        self.files.entry(record.image).or_insert(file);
        Ok(self.index.put(record, len, will))
    }

    fn revise(&mut self, old: Revision, new: Arc<Record>) -> Result<Option<Session>, StoreError> {
        Ok(if self.index.weigh_revision(old, &new)? { self.index.revise(new) } else { None })
    }

    fn delete(&mut self, id: SessionId) -> Result<(), StoreError> {
        if self.index.weigh_delete(id)? {
            self.free(&[id], None);
            self.index.delete(id);
        }
        Ok(())
    }

    fn sweep(&mut self) -> usize {
        let ended = self.index.expired();
        self.free(&ended, None);
        self.index.expire(&ended);
        ended.len()
    }

    /// Lets go of files that no session names when these have gone.
    fn free(&mut self, gone: &[SessionId], kept: Option<Digest>) {
        for (digest, _) in self.index.freed(gone, kept) {
            self.files.remove(&digest);
        }
    }
}

/// Wraps what is already known.
fn ready<'a, T: Send + 'a>(answer: Result<T, StoreError>) -> Answer<'a, T> {
    Box::pin(std::future::ready(answer))
}

impl Store for MemoryStore {
    fn put(&self, record: Arc<Record>, image: Bytes) -> Answer<'_, Put> {
        ready(self.lock().put(record, image))
    }

    fn revise(&self, old: Revision, new: Arc<Record>) -> Answer<'_, Option<Session>> {
        ready(self.lock().revise(old, new))
    }

    fn peek(&self, id: SessionId) -> Answer<'_, Session> {
        ready(self.lock().index.peek(id))
    }

    fn touch(&self, id: SessionId, seq: Option<u64>) -> Answer<'_, Session> {
        ready(self.lock().index.touch(id, seq))
    }

    fn delete(&self, id: SessionId) -> Answer<'_, ()> {
        ready(self.lock().delete(id))
    }

    /// The file is held, and shared.
    fn image_bytes(&self, _: SessionId, _: Digest) -> Answer<'_, u64> {
        ready(Ok(0))
    }

    fn image(&self, _: SessionId, digest: Digest) -> Answer<'_, Bytes> {
        ready(self.lock().files.get(&digest).cloned().ok_or(StoreError::NoSuchSession))
    }

    fn names(&self, owner: Owner, digest: Digest) -> bool {
        self.lock().index.names(owner, digest)
    }

    fn sweep(&self) -> Answer<'_, usize> {
        ready(Ok(self.lock().sweep()))
    }

    fn ready(&self) -> Answer<'_, ()> {
        ready(Ok(()))
    }

    fn figures(&self) -> Figures {
        let held = self.lock();
        Figures { sessions: held.index.len() as u64, bytes: held.index.bytes(), ..Figures::default() }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::store::tests::suite::bounds;
    use crate::store::tests::{model, suite};

    #[tokio::test]
    async fn keeps_the_rules_of_every_store() {
        suite::bounded(async |wanted| MemoryStore::new(wanted)).await;
    }

    #[tokio::test]
    async fn does_what_the_model_does() {
        for seed in 0..3 {
            let open = async |old: Option<Vec<MemoryStore>>| old.unwrap_or_else(|| vec![MemoryStore::new(model::bounds())]);
            model::follows(open, seed, 400, true, false).await;
        }
    }

    #[tokio::test]
    async fn what_is_deleted_is_not_held() {
        let store = MemoryStore::new(bounds());
        let record = suite::record(1);
        store.put(Arc::clone(&record), suite::file(1)).await.unwrap();
        store.delete(record.id).await.unwrap();
        let held = store.lock();
        assert!(held.files.is_empty() && held.index.bytes() == 0);
    }
}
