//! Sessions: opened, replaced, given other handles, closed.

use std::sync::Arc;

use bytes::Bytes;
use mlswarp::warp::{Digest, RasterSource, RestSummary};

use super::App;
use super::draw::HeldSetup;
use super::session_object::{SessionText, ShownSession};
use super::warp::{NewSession, PreparedWarp, Resolved, SESSION_ATTEMPTS, Upload, revision_key};
use crate::cache::CacheKey;
use crate::client::{Client, Owner};
use crate::limits::memory::MemoryClass;
use crate::observe::scope::in_stage;
use crate::observe::stages::Timing;
use crate::pool::{Cancel, QueueKey, WorkClass};
use crate::problem::Problem;
use crate::session::{Revision, SessionId};
use crate::store::{Put, Record, Session, StoreError};
use crate::wire::{Reserved, WarpObject, WarpPatch, method_text};

/// A session with its object, and the method that was chosen for it if that was requested, as a
/// header shows it.
pub(crate) type Resulting = (ShownSession, Option<String>);

impl App {
    /// Opens a session with an id of its own from a file and a warp object; `q` is checked if it is
    /// sent. Errors: A wrong file or object, or too little capacity.
    pub async fn create_session(
        &self,
        client: Client,
        upload: Upload,
    ) -> Result<Resulting, Problem> {
        let (_, shown, method) = self
            .put_upload(client, SessionId::random(client.owner), upload)
            .await?;
        Ok((shown, method))
    }

    /// Opens or replaces a session with an id that the client has chosen. The first result: whether
    /// there was none. Errors: A wrong file or object, or too little capacity.
    pub async fn put_session(
        &self,
        client: Client,
        id: SessionId,
        upload: Upload,
    ) -> Result<(bool, Resulting), Problem> {
        let (is_new, shown, method) = self.put_upload(client, id, upload).await?;
        Ok((is_new, (shown, method)))
    }

    /// Opens a session from an upload that was already prepared.
    /// Errors: Too little capacity.
    pub(crate) async fn create_session_from(
        &self,
        client: Client,
        prepared: PreparedWarp,
    ) -> Result<SessionId, Problem> {
        // Undoes the demotion of an image that is warped once.
        for digest in prepared.files() {
            let _ = self.0.images.touch(CacheKey::new(client.owner, digest));
        }
        let new = prepared.into_session(SessionId::random(client.owner));
        let id = new.record.id;
        self.store_session(client, new).await?;
        Ok(id)
    }

    /// Builds image and plan, and stores the session. What shows it is made before: afterwards
    /// nothing may fail.
    async fn put_upload(
        &self,
        client: Client,
        id: SessionId,
        upload: Upload,
    ) -> Result<(bool, ShownSession, Option<String>), Problem> {
        // The ticket is not held while the store works.
        let ticket = self
            .0
            .pool
            .admit(WorkClass::Upload, QueueKey::client(client))
            .await?;
        let (prepared, _planned) = self.prepare(client, &ticket, upload, None).await?;
        let method = prepared.chosen_method();
        let app = self.clone();
        let write = move |cancel: &Cancel| {
            let new = prepared.into_session(id);
            let text = app.write_text(&new.record, Some(RestSummary::of(&new.setup)), cancel)?;
            Ok::<_, Problem>((new, app.shown(client, Arc::new(text))?))
        };
        let (new, shown) = self.0.pool.run(&ticket, write).await??;
        drop(ticket);
        let record = Arc::clone(&new.record);
        Ok(match self.store_session(client, new).await? {
            Put::Same(session) => (false, self.read_session(client, session).await?, method),
            Put::Created(session) => (true, self.show_new(client, &record, shown, session), method),
            Put::Replaced(session, _) => (
                false,
                self.show_new(client, &record, shown, session),
                method,
            ),
        })
    }

    /// The object of a session that was stored with a new revision; its text is kept.
    pub(super) fn show_new(
        &self,
        client: Client,
        record: &Record,
        shown: SessionText,
        session: Session,
    ) -> ShownSession {
        self.0
            .texts
            .put(revision_key(record), client.payer(), shown.text());
        shown.of(session)
    }

    /// Stores a session, counted for its client, and keeps its setup.
    async fn store_session(&self, client: Client, new: NewSession) -> Result<Put, Problem> {
        let NewSession {
            record,
            files,
            setup,
        } = new;
        // Limits the simultaneous transfers, fairly between clients.
        let ticket = self
            .0
            .pool
            .admit(WorkClass::Transfer, QueueKey::client(client))
            .await?;
        let claim = self
            .0
            .client_sessions
            .claim(client.payer(), &record, &files)?;
        // If this future is dropped while the store works, the session may have been stored: it
        // stays counted.
        let put = in_stage("store", self.0.store.put(record, files)).await;
        drop(ticket);
        match &put {
            Ok(Put::Same(_)) => self.0.client_sessions.confirm_same(&claim),
            Ok(_) => self.0.client_sessions.confirm(&claim),
            Err(_) => self.0.client_sessions.undo(claim),
        }
        let put = put?;
        let (Put::Created(session) | Put::Same(session) | Put::Replaced(session, _)) = &put;
        self.cache_setup(client, &session.record, &setup);
        if let Put::Replaced(_, old) = &put {
            self.evict_session(old);
        }
        Ok(put)
    }

    /// Replaces those rest handles and options of a session that `json` gives. The plan is built
    /// before the response. Errors: Unknown session, wrong handles, or too little capacity.
    pub(crate) async fn replace_handles(
        &self,
        client: Client,
        id: SessionId,
        json: Bytes,
    ) -> Result<Resulting, Problem> {
        for _ in 0..SESSION_ATTEMPTS {
            let old = self.touch(id, None).await?.record;
            let ticket = self
                .0
                .pool
                .admit(WorkClass::Upload, QueueKey::session(client, id))
                .await?;
            let reserve = self.reserving_pose(MemoryClass::Upload, client, &old);
            let (app, json, before) = (self.clone(), json.clone(), Arc::clone(&old));
            let resolve = move |cancel: &Cancel| {
                let patch = Reserved::<WarpPatch, _>::parse(&json, reserve)?
                    .try_map(WarpPatch::without_files)?;
                let (q, strength) = before
                    .pose
                    .clone()
                    .map_or((None, 1.0), |pose| (Some(pose.q), pose.strength));
                let (rest, folds, output) = (before.rest.clone(), before.folds, before.output);
                let base = WarpObject {
                    rest,
                    q,
                    folds,
                    output,
                    strength,
                    is_auto: false,
                };
                app.resolve(
                    patch.map(|patch| patch.merge_onto(base)),
                    before.extent,
                    cancel,
                )
            };
            let Resolved {
                object,
                pose,
                setup,
                ..
            } = self.0.pool.run(&ticket, resolve).await??;
            // A picture that is not in memory is looked at when it is drawn.
            if let Some(image) = self.0.images.peek(CacheKey::new(id.owner(), old.image)) {
                RasterSource::Image(&image).check(&object.output)?;
            }
            self.plan(client, &ticket, &setup, Timing::default())
                .await?;
            let (app, before, summarized) = (self.clone(), Arc::clone(&old), Arc::clone(&setup));
            let write = move |cancel: &Cancel| {
                let method = object.is_auto.then(|| method_text(&object.rest));
                let (
                    WarpObject {
                        rest,
                        folds,
                        output,
                        ..
                    },
                    _held,
                ) = object.into_parts();
                let new = Arc::new(Record {
                    revision: Revision::random(),
                    rest,
                    pose,
                    folds,
                    output,
                    ..(*before).clone()
                });
                let text = app.write_text(&new, Some(RestSummary::of(&summarized)), cancel)?;
                Ok::<_, Problem>((new, app.shown(client, Arc::new(text))?, method))
            };
            let (new, shown, method) = self.0.pool.run(&ticket, write).await??;
            // The ticket is not held while the store works.
            drop(ticket);
            let claim = self.0.client_sessions.claim_revision(&new, None)?;
            let revised = in_stage(
                "store",
                self.0.store.revise(old.revision, Arc::clone(&new), None),
            )
            .await;
            match revised {
                Ok(Some(_)) => self.0.client_sessions.confirm(&claim),
                _ => self.0.client_sessions.undo(claim),
            }
            // Without a session, another request has changed fields that this one may not have
            // named: the next attempt keeps them.
            if let Some(session) = revised? {
                self.cache_setup(client, &session.record, &setup);
                self.forget_revision(&old);
                return Ok((self.show_new(client, &new, shown, session), method));
            }
        }
        Err(StoreError::Contended.into())
    }

    /// Reads the session and extends its life; see [`Store::touch`].
    ///
    /// [`Store::touch`]: crate::store::Store::touch
    pub(crate) async fn touch(
        &self,
        id: SessionId,
        seq: Option<u64>,
    ) -> Result<Session, StoreError> {
        let claim = self.0.client_sessions.claim_of(id);
        let touched = in_stage("store", self.0.store.touch(id, seq)).await;
        match &touched {
            Ok(_) => self.0.client_sessions.used(id),
            Err(StoreError::NoSuchSession | StoreError::Expired { .. }) => {
                self.0.client_sessions.ended(id, claim)
            }
            Err(_) => {}
        }
        touched
    }

    /// Keeps the setup of a record for the next drag.
    pub(super) fn cache_setup(&self, client: Client, record: &Record, setup: &HeldSetup) {
        self.0
            .setups
            .put(revision_key(record), client.payer(), setup);
    }

    /// Evicts what was cached for a revision that no session has any more; returns its setup.
    pub(super) fn forget_revision(&self, record: &Record) -> Option<HeldSetup> {
        self.0.texts.drop_value(revision_key(record));
        self.0.setups.remove(revision_key(record))
    }

    /// Evicts what was cached for a record that no session has any more.
    fn evict_session(&self, record: &Record) {
        let setup = self.forget_revision(record);
        // The image is evicted with the owner's last session that uses it, and the plan with it. A
        // session of another image with the same extent and handles builds the plan again.
        let owner = record.id.owner();
        if self.evict_file(owner, record.image)
            && let Some(setup) = setup
        {
            self.0
                .plans
                .drop_value(CacheKey::new(owner, setup.plan_key()));
        }
        for layer in record.layers.values() {
            self.evict_file(owner, layer.digest);
        }
    }

    /// Evicts what was decoded from a file, unless a session of the owner still uses it.
    pub(super) fn evict_file(&self, owner: Owner, digest: Digest) -> bool {
        let is_unused = !self.0.store.names(owner, digest);
        if is_unused {
            self.0.images.drop_value(CacheKey::new(owner, digest));
            self.0.labels.drop_value(CacheKey::new(owner, digest));
        }
        is_unused
    }

    /// Reads the session without extending its life.
    /// Errors: Unknown or expired.
    pub async fn peek_session(&self, id: SessionId) -> Result<Session, Problem> {
        Ok(in_stage("store", self.0.store.peek(id)).await?)
    }

    /// Closes the session. If it was deleted recently, or another version of the program stored it,
    /// nothing is cached for it here. Errors: Unknown or expired.
    pub async fn delete_session(&self, id: SessionId) -> Result<(), Problem> {
        let (session, claim) = (
            in_stage("store", self.0.store.peek(id)).await,
            self.0.client_sessions.claim_of(id),
        );
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
    use crate::store::{NamedFile, Store, StoreFuture, StoreStats};

    /// A store on which somebody else is always faster.
    #[derive(Debug)]
    struct Contended(Arc<dyn Store>, AtomicUsize);

    impl Store for Contended {
        fn put(&self, record: Arc<Record>, files: Vec<NamedFile>) -> StoreFuture<'_, Put> {
            self.0.put(record, files)
        }
        fn revise(
            &self,
            _: Revision,
            _: Arc<Record>,
            _: Option<NamedFile>,
        ) -> StoreFuture<'_, Option<Session>> {
            self.1.fetch_add(1, Ordering::Relaxed);
            Box::pin(std::future::ready(Ok(None)))
        }
        fn peek(&self, id: SessionId) -> StoreFuture<'_, Session> {
            self.0.peek(id)
        }
        fn touch(&self, id: SessionId, seq: Option<u64>) -> StoreFuture<'_, Session> {
            self.0.touch(id, seq)
        }
        fn delete(&self, id: SessionId) -> StoreFuture<'_, ()> {
            self.0.delete(id)
        }
        fn file_bytes(&self, id: SessionId, digest: Digest) -> StoreFuture<'_, u64> {
            self.0.file_bytes(id, digest)
        }
        fn file(&self, id: SessionId, digest: Digest) -> StoreFuture<'_, Bytes> {
            self.0.file(id, digest)
        }
        fn names(&self, owner: Owner, digest: Digest) -> bool {
            self.0.names(owner, digest)
        }
        fn sweep(&self) -> StoreFuture<'_, usize> {
            self.0.sweep()
        }
        fn ready(&self) -> StoreFuture<'_, ()> {
            self.0.ready()
        }
        fn figures(&self) -> StoreStats {
            self.0.figures()
        }
    }

    #[tokio::test]
    async fn a_request_that_is_always_overtaken_is_refused_after_some_attempts() {
        let mut app = App::new(Config::default()).unwrap();
        let shared = Arc::get_mut(&mut app.0).unwrap();
        let contended = Arc::new(Contended(Arc::clone(&shared.store), AtomicUsize::new(0)));
        shared.store = Arc::clone(&contended) as Arc<dyn Store>;
        let client = Client {
            owner: Owner::ANYBODY,
            address: IpAddr::V4(Ipv4Addr::LOCALHOST),
            visit: None,
        };
        let mut file = std::io::Cursor::new(Vec::new());
        image::DynamicImage::new_rgb8(40, 30)
            .write_to(&mut file, image::ImageFormat::Png)
            .unwrap();
        let (shown, _) = app
            .create_session(client, Upload::new(file.into_inner(), r#"{"p": [[5, 5]]}"#))
            .await
            .unwrap();
        let refused = app
            .replace_handles(
                client,
                shown.session.record.id,
                Bytes::from_static(br#"{"p": [[6, 6]]}"#),
            )
            .await
            .unwrap_err();
        assert_eq!(
            (refused.code, refused.retry_after),
            (Code::Overloaded, Some(1))
        );
        assert_eq!(contended.1.load(Ordering::Relaxed), SESSION_ATTEMPTS);
        // The last computation gives its turn back by itself.
        while app.pool().load(WorkClass::Upload).running > 0 {
            tokio::task::yield_now().await;
        }
    }

    #[tokio::test]
    async fn a_session_for_whose_answer_there_is_no_memory_is_not_made() {
        let mut config = Config::default();
        config.work.memory_bytes = 64 << 20;
        let app = App::new(config).unwrap();
        let client = Client {
            owner: Owner::ANYBODY,
            address: IpAddr::V4(Ipv4Addr::LOCALHOST),
            visit: None,
        };
        let mut file = std::io::Cursor::new(Vec::new());
        image::DynamicImage::new_rgb8(40, 30)
            .write_to(&mut file, image::ImageFormat::Png)
            .unwrap();
        let file = Bytes::from(file.into_inner());
        let open = || app.create_session(client, Upload::new(file.clone(), r#"{"p": [[5, 5]]}"#));
        let (shown, _) = open().await.unwrap();
        let record = &shown.session.record;
        // Somebody draws from them, and everything else is taken.
        let setup = app.session_setup(client, record).await.unwrap();
        let _used = (
            app.0
                .images
                .peek(CacheKey::new(client.owner, record.image))
                .unwrap(),
            app.0
                .plans
                .peek(CacheKey::new(client.owner, setup.plan_key())),
        );
        let budget = app.budget();
        let mut rest = budget
            .take(MemoryClass::Frame, budget.total() - budget.taken())
            .unwrap();
        while app.evict_idle() {}
        rest.grow(budget.total() - budget.taken()).unwrap();
        let sessions = || app.0.store.figures().sessions;
        // With more memory the work gets further, until all of it is done.
        let mut refused = 0;
        loop {
            match open().await {
                Ok(_) => break,
                Err(problem) => assert_eq!((problem.code, sessions()), (Code::Overloaded, 1)),
            }
            refused += 1;
            rest.shrink_to(rest.bytes() - 256);
        }
        assert!(refused > 3 && sessions() == 2, "{refused}");
    }

    #[tokio::test]
    async fn a_spline_is_computed_only_if_there_is_memory_for_its_system() {
        let mut config = Config::default();
        config.work.memory_bytes = 64 << 20;
        let app = App::new(config).unwrap();
        let client = Client {
            owner: Owner::ANYBODY,
            address: IpAddr::V4(Ipv4Addr::LOCALHOST),
            visit: None,
        };
        let mut file = std::io::Cursor::new(Vec::new());
        image::DynamicImage::new_rgb8(40, 30)
            .write_to(&mut file, image::ImageFormat::Png)
            .unwrap();
        let file = Bytes::from(file.into_inner());
        let open = |points: u32| {
            let p: Vec<[f64; 2]> = (0..points)
                .map(|k| [f64::from(k % 25), f64::from(k / 25) * 1.2])
                .collect();
            app.create_session(
                client,
                Upload::new(file.clone(), format!(r#"{{"p": {p:?}, "method": "tps"}}"#)),
            )
        };
        let (shown, _) = open(3).await.unwrap();
        // The picture stays decoded.
        let _used = app
            .0
            .images
            .peek(CacheKey::new(client.owner, shown.session.record.image))
            .unwrap();
        let budget = app.budget();
        let mut taken = budget.take(MemoryClass::Frame, budget.total() / 2).unwrap();
        // An upload has room, and a plan 8 MiB more: 1,500 points have a system of 9 MB, 100 one of
        // 40 kB.
        while app.reserve(MemoryClass::Upload, 1_000_000).is_ok() {
            taken.grow(100_000).unwrap();
        }
        open(100).await.unwrap();
        assert_eq!(open(1500).await.unwrap_err().code, Code::Overloaded);
        drop(taken);
        open(1500).await.unwrap();
    }
}
