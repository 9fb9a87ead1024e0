//! A store whose answers are stages of the requests that wait for them: laid around the real one where requests are traced, and only there.

use std::sync::Arc;
use std::time::Instant;

use bytes::Bytes;
use mlswarp::warp::Digest;

use super::{Answer, Figures, Put, Record, Revision, Session, SessionId, Store};
use crate::client::Owner;
use crate::observe::scope::stage;

/// A store that is waited for by the clock.
#[derive(Debug)]
pub struct Timed(pub Arc<dyn Store>);

fn timed<'a, T: 'a>(answer: Answer<'a, T>) -> Answer<'a, T> {
    Box::pin(async move {
        let began = Instant::now();
        let answered = answer.await;
        stage("store", began);
        answered
    })
}

impl Store for Timed {
    fn put(&self, record: Arc<Record>, image: Bytes) -> Answer<'_, Put> {
        timed(self.0.put(record, image))
    }

    fn revise(&self, old: Revision, new: Arc<Record>) -> Answer<'_, Option<Session>> {
        timed(self.0.revise(old, new))
    }

    fn peek(&self, id: SessionId) -> Answer<'_, Session> {
        timed(self.0.peek(id))
    }

    fn touch(&self, id: SessionId, seq: Option<u64>) -> Answer<'_, Session> {
        timed(self.0.touch(id, seq))
    }

    fn delete(&self, id: SessionId) -> Answer<'_, ()> {
        timed(self.0.delete(id))
    }

    fn image_bytes(&self, id: SessionId, digest: Digest) -> Answer<'_, u64> {
        timed(self.0.image_bytes(id, digest))
    }

    fn image(&self, id: SessionId, digest: Digest) -> Answer<'_, Bytes> {
        timed(self.0.image(id, digest))
    }

    fn names(&self, owner: Owner, digest: Digest) -> bool {
        self.0.names(owner, digest)
    }

    fn sweep(&self) -> Answer<'_, usize> {
        self.0.sweep()
    }

    fn ready(&self) -> Answer<'_, ()> {
        self.0.ready()
    }

    fn figures(&self) -> Figures {
        self.0.figures()
    }
}
