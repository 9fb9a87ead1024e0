//! Sessions: opened, replaced, given other handles, closed.

use std::sync::Arc;

use bytes::Bytes;
use mlswarp::warp::{Digest, Setup, Subject};

use super::warp::{ATTEMPTS, PreparedWarp, Resolved, Upload, revision_key, setup_weight};
use super::{App, build_aborted};
use crate::cache::{CacheEntry, Key};
use crate::client::{Client, Owner};
use crate::limits::memory::Purpose;
use crate::observe::scope::in_stage;
use crate::observe::stages::Timing;
use crate::pool::{Cancel, QueueKey, WorkClass};
use crate::problem::Problem;
use crate::session::{Revision, SessionId};
use crate::store::{Put, Record, Session, StoreError};
use crate::wire::{WarpObject, WarpPatch, method_text};

/// A session with its setup, and the method that was chosen for it if that was requested, as a header shows it.
pub(crate) type Resulting<T> = (T, Arc<Setup>, Option<String>);

impl App {
    /// Opens a session with an id of its own from a file and a warp object; `q` is checked if it is sent.
    /// Errors: A wrong file or object, or too little capacity.
    pub async fn create_session(&self, client: Client, upload: Upload) -> Result<Resulting<Session>, Problem> {
        let prepared = self.prepare_session(client, upload).await?;
        self.create_session_from(client, prepared).await
    }

    /// Opens a session from an upload that was already prepared.
    /// Errors: Too little capacity.
    pub async fn create_session_from(&self, client: Client, prepared: PreparedWarp) -> Result<Resulting<Session>, Problem> {
        // Undoes the demotion of an image that is warped once.
        for digest in prepared.files() {
            let _ = self.0.images.touch(Key::new(client.owner, digest));
        }
        let (put, setup, method) = self.put_prepared(client, SessionId::random(client.owner), prepared).await?;
        let (Put::Created(session) | Put::Same(session) | Put::Replaced(session, _)) = put;
        Ok((session, setup, method))
    }

    /// Opens or replaces a session with an id that the client has chosen.
    /// Errors: A wrong file or object, or too little capacity.
    pub async fn put_session(&self, client: Client, id: SessionId, upload: Upload) -> Result<Resulting<Put>, Problem> {
        let prepared = self.prepare_session(client, upload).await?;
        self.put_prepared(client, id, prepared).await
    }

    /// Builds image and plan; the ticket is returned before the store is used.
    async fn prepare_session(&self, client: Client, upload: Upload) -> Result<PreparedWarp, Problem> {
        let ticket = self.0.pool.admit(WorkClass::Upload, QueueKey::client(client)).await?;
        Ok(self.prepare(client.owner, &ticket, upload, None).await?.0)
    }

    /// Stores a session, counted for its client.
    async fn put_prepared(&self, client: Client, id: SessionId, prepared: PreparedWarp) -> Result<Resulting<Put>, Problem> {
        let method = prepared.chosen_method();
        let (record, files, setup, _held) = prepared.into_session(id);
        // Limits the simultaneous transfers, fairly between clients.
        let ticket = self.0.pool.admit(WorkClass::Transfer, QueueKey::client(client)).await?;
        let claim = self.0.client_sessions.claim(client.tenant(), &record, &files)?;
        // If this future is dropped while the store works, the session may have been stored: it stays counted.
        let put = in_stage("store", self.0.store.put(record, files)).await;
        drop(ticket);
        match &put {
            Ok(Put::Same(_)) => self.0.client_sessions.confirm_same(&claim),
            Ok(_) => self.0.client_sessions.confirm(&claim),
            Err(_) => self.0.client_sessions.undo(claim),
        }
        let put = put?;
        let (Put::Created(session) | Put::Same(session) | Put::Replaced(session, _)) = &put;
        self.cache_setup(&session.record, &setup).await;
        if let Put::Replaced(_, old) = &put {
            self.evict_session(old);
        }
        Ok((put, setup, method))
    }

    /// Replaces those rest handles and options of a session that `json` gives. The plan is built before the response.
    /// Errors: Unknown session, wrong handles, or too little capacity.
    pub async fn replace_handles(&self, client: Client, id: SessionId, json: Bytes) -> Result<Resulting<Session>, Problem> {
        for _ in 0..ATTEMPTS {
            let old = self.touch(id, None).await?.record;
            let ticket = self.0.pool.admit(WorkClass::Upload, QueueKey::session(client, id)).await?;
            let (q, strength) = old.pose.clone().map_or((None, 1.0), |pose| (Some(pose.q), pose.strength));
            let base = WarpObject { rest: old.rest.clone(), q, folds: old.folds, output: old.output, strength, is_auto: false };
            let (app, json, extent) = (self.clone(), json.clone(), old.extent);
            let resolve = move |cancel: &Cancel| app.resolve(WarpPatch::parse(&json)?.without_files()?.merge_onto(base), extent, cancel);
            let Resolved { object, pose, setup, held: _held, .. } = self.0.pool.run(&ticket, resolve).await??;
            // A picture that is not in memory is looked at when it is drawn.
            if let Some(image) = self.0.images.peek(Key::new(id.owner(), old.image)) {
                Subject::Image(&image).check(&object.output)?;
            }
            self.plan(id.owner(), &ticket, &setup, Timing::default()).await?;
            // The ticket is not held while the store works.
            drop(ticket);
            let method = object.is_auto.then(|| method_text(&object.rest));
            let WarpObject { rest, folds, output, .. } = object;
            let new = Record { revision: Revision::random(), rest, pose, folds, output, ..(*old).clone() };
            let claim = self.0.client_sessions.claim_revision(&new, None)?;
            let revised = in_stage("store", self.0.store.revise(old.revision, Arc::new(new), None)).await;
            match revised {
                Ok(Some(_)) => self.0.client_sessions.confirm(&claim),
                _ => self.0.client_sessions.undo(claim),
            }
            // Without a session, another request has changed fields that this one may not have named: the next attempt keeps them.
            if let Some(session) = revised? {
                self.cache_setup(&session.record, &setup).await;
                self.0.setups.remove(revision_key(&old));
                return Ok((session, setup, method));
            }
        }
        Err(StoreError::Contended.into())
    }

    /// Reads the session and extends its life; see [`Store::touch`].
    ///
    /// [`Store::touch`]: crate::store::Store::touch
    pub(crate) async fn touch(&self, id: SessionId, seq: Option<u64>) -> Result<Session, StoreError> {
        let claim = self.0.client_sessions.claim_of(id);
        let touched = in_stage("store", self.0.store.touch(id, seq)).await;
        match &touched {
            Ok(_) => self.0.client_sessions.used(id),
            Err(StoreError::NoSuchSession | StoreError::Expired { .. }) => self.0.client_sessions.ended(id, claim),
            Err(_) => {}
        }
        touched
    }

    /// Caches the setup of a record, if there is memory for it.
    pub(super) async fn cache_setup(&self, record: &Record, setup: &Arc<Setup>) {
        if let Ok(reservation) = self.reserve(Purpose::Plan, setup_weight(record)) {
            let entry = CacheEntry::new(Arc::clone(setup), reservation);
            let _ = self.0.setups.get(revision_key(record), async { Ok(entry) }, build_aborted).await;
        }
    }

    /// Evicts what was cached for a record that no session has any more.
    fn evict_session(&self, record: &Record) {
        let setup = self.0.setups.remove(revision_key(record));
        // The image is evicted with the owner's last session that uses it, and the plan with it. A session of another image with the same
        // extent and handles builds the plan again.
        let owner = record.id.owner();
        if self.evict_file(owner, record.image)
            && let Some(setup) = setup
        {
            self.0.plans.remove(Key::new(owner, setup.plan_key()));
        }
        for layer in record.layers.values() {
            self.evict_file(owner, layer.digest);
        }
    }

    /// Evicts what was decoded from a file, unless a session of the owner still uses it.
    pub(super) fn evict_file(&self, owner: Owner, digest: Digest) -> bool {
        let is_unused = !self.0.store.names(owner, digest);
        if is_unused {
            self.0.images.remove(Key::new(owner, digest));
            self.0.labels.remove(Key::new(owner, digest));
        }
        is_unused
    }

    /// Reads the session without extending its life.
    /// Errors: Unknown or expired.
    pub async fn peek_session(&self, id: SessionId) -> Result<Session, Problem> {
        Ok(in_stage("store", self.0.store.peek(id)).await?)
    }

    /// Closes the session. If it was deleted recently, or another version of the program stored it, nothing is cached for it here.
    /// Errors: Unknown or expired.
    pub async fn delete_session(&self, id: SessionId) -> Result<(), Problem> {
        let (session, claim) = (in_stage("store", self.0.store.peek(id)).await, self.0.client_sessions.claim_of(id));
        in_stage("store", self.0.store.delete(id)).await?;
        self.0.client_sessions.ended(id, claim);
        if let Ok(session) = session {
            self.evict_session(&session.record);
        }
        Ok(())
    }
}

#[cfg(test)]
mod tests {
    use std::net::{IpAddr, Ipv4Addr};
    use std::sync::atomic::{AtomicUsize, Ordering};

    use super::*;
    use crate::config::Config;
    use crate::problem::Code;
    use crate::store::{Answer, Figures, NamedFile, Store};

    /// A store on which somebody else is always faster.
    #[derive(Debug)]
    struct Contended(Arc<dyn Store>, AtomicUsize);

    impl Store for Contended {
        fn put(&self, record: Arc<Record>, files: Vec<NamedFile>) -> Answer<'_, Put> {
            self.0.put(record, files)
        }
        fn revise(&self, _: Revision, _: Arc<Record>, _: Option<NamedFile>) -> Answer<'_, Option<Session>> {
            self.1.fetch_add(1, Ordering::Relaxed);
            Box::pin(std::future::ready(Ok(None)))
        }
        fn peek(&self, id: SessionId) -> Answer<'_, Session> {
            self.0.peek(id)
        }
        fn touch(&self, id: SessionId, seq: Option<u64>) -> Answer<'_, Session> {
            self.0.touch(id, seq)
        }
        fn delete(&self, id: SessionId) -> Answer<'_, ()> {
            self.0.delete(id)
        }
        fn file_bytes(&self, id: SessionId, digest: Digest) -> Answer<'_, u64> {
            self.0.file_bytes(id, digest)
        }
        fn file(&self, id: SessionId, digest: Digest) -> Answer<'_, Bytes> {
            self.0.file(id, digest)
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

    #[tokio::test]
    async fn a_request_that_is_always_overtaken_is_refused_after_some_attempts() {
        let mut app = App::new(Config::default()).unwrap();
        let shared = Arc::get_mut(&mut app.0).unwrap();
        let contended = Arc::new(Contended(Arc::clone(&shared.store), AtomicUsize::new(0)));
        shared.store = Arc::clone(&contended) as Arc<dyn Store>;
        let client = Client { owner: Owner::ANYBODY, address: IpAddr::V4(Ipv4Addr::LOCALHOST) };
        let mut file = std::io::Cursor::new(Vec::new());
        image::DynamicImage::new_rgb8(40, 30).write_to(&mut file, image::ImageFormat::Png).unwrap();
        let (session, ..) = app.create_session(client, Upload::new(file.into_inner(), r#"{"p": [[5, 5]]}"#)).await.unwrap();
        let refused = app.replace_handles(client, session.record.id, Bytes::from_static(br#"{"p": [[6, 6]]}"#)).await.unwrap_err();
        assert_eq!((refused.code, refused.retry_after), (Code::Overloaded, Some(1)));
        assert_eq!(contended.1.load(Ordering::Relaxed), ATTEMPTS);
        // The last computation gives its turn back by itself.
        while app.pool().load(WorkClass::Upload).running > 0 {
            tokio::task::yield_now().await;
        }
    }

    #[tokio::test]
    async fn a_session_that_was_made_is_answered_also_where_there_is_no_room_to_remember_its_setup() {
        let mut config = Config::default();
        config.work.memory_bytes = 64 << 20;
        let app = App::new(config).unwrap();
        let client = Client { owner: Owner::ANYBODY, address: IpAddr::V4(Ipv4Addr::LOCALHOST) };
        let mut file = std::io::Cursor::new(Vec::new());
        image::DynamicImage::new_rgb8(40, 30).write_to(&mut file, image::ImageFormat::Png).unwrap();
        let file = Bytes::from(file.into_inner());
        let open = || app.create_session(client, Upload::new(file.clone(), r#"{"p": [[5, 5]]}"#));
        let (session, setup, _) = open().await.unwrap();
        // Somebody draws from them, and everything else is taken.
        let _used = (
            app.0.images.peek(Key::new(client.owner, session.record.image)).unwrap(),
            app.0.plans.peek(Key::new(client.owner, setup.plan_key())).unwrap(),
        );
        let budget = app.budget();
        let mut rest = vec![budget.take(Purpose::Frame, budget.total() - budget.taken()).unwrap()];
        // The first session's setup gives way.
        while let Ok(held) = app.reserve(Purpose::Plan, 1) {
            drop(held);
            rest.push(budget.take(Purpose::Frame, budget.total() - budget.taken()).unwrap());
        }
        let (other, ..) = open().await.unwrap();
        assert_eq!(app.peek_session(other.record.id).await.unwrap().record, other.record);
    }

    #[tokio::test]
    async fn a_spline_is_computed_only_if_there_is_memory_for_its_system() {
        let mut config = Config::default();
        config.work.memory_bytes = 64 << 20;
        let app = App::new(config).unwrap();
        let client = Client { owner: Owner::ANYBODY, address: IpAddr::V4(Ipv4Addr::LOCALHOST) };
        let mut file = std::io::Cursor::new(Vec::new());
        image::DynamicImage::new_rgb8(40, 30).write_to(&mut file, image::ImageFormat::Png).unwrap();
        let file = Bytes::from(file.into_inner());
        let open = |points: u32| {
            let p: Vec<[f64; 2]> = (0..points).map(|k| [f64::from(k % 25), f64::from(k / 25) * 1.2]).collect();
            app.create_session(client, Upload::new(file.clone(), format!(r#"{{"p": {p:?}, "method": "tps"}}"#)))
        };
        let (session, ..) = open(3).await.unwrap();
        // The picture stays decoded.
        let _used = app.0.images.peek(Key::new(client.owner, session.record.image)).unwrap();
        let budget = app.budget();
        let mut taken = budget.take(Purpose::Frame, budget.total() / 2).unwrap();
        // 600 points have a system of 1.4 MB, 100 one of 40 kB.
        while app.reserve(Purpose::Plan, 500_000).is_ok() {
            taken.grow(100_000).unwrap();
        }
        open(100).await.unwrap();
        assert_eq!(open(600).await.unwrap_err().code, Code::Overloaded);
        drop(taken);
        open(600).await.unwrap();
    }
}
