//! Sessions: made, made anew, given other handles, ended.

use std::sync::Arc;

use bytes::Bytes;
use mlswarp::warp::Setup;

use super::App;
use super::warp::{ATTEMPTS, PreparedWarp, build_aborted, image_key, resolve, setup_key, weight};
use crate::cache::{CacheEntry, Key};
use crate::client::Client;
use crate::limits::memory::Purpose;
use crate::observe::scope::in_stage;
use crate::observe::stages::Timing;
use crate::pool::{Cancel, QueueKey, WorkClass};
use crate::problem::Problem;
use crate::session::{Revision, SessionId};
use crate::store::{Put, Record, Session, StoreError};
use crate::wire::{WarpObject, WarpPatch};

impl App {
    /// A session from a file and a warp object; `q` is checked when it is there. Picture and plan are made before the answer.
    ///
    /// # Errors
    /// Whatever is wrong with either, or no room.
    pub async fn open(&self, client: Client, file: Bytes, json: Bytes) -> Result<(Session, Arc<Setup>), Problem> {
        let ticket = self.0.pool.admit(WorkClass::Upload, QueueKey::client(client)).await?;
        let (material, ..) = self.prepare(client.owner, &ticket, file, json, None).await?;
        // Whoever waits for the store computes nothing.
        drop(ticket);
        self.keep(client, material).await
    }

    /// Makes a session of what was warped.
    ///
    /// # Errors
    /// No room.
    pub async fn keep(&self, client: Client, material: PreparedWarp) -> Result<(Session, Arc<Setup>), Problem> {
        // Its picture was bent once so far; now it will be again.
        let _ = self.0.images.touch(Key::new(client.owner, material.digest));
        let (record, file, setup) = material.recorded(SessionId::random(client.owner));
        let (Put::Created(session) | Put::Same(session) | Put::Replaced(session, _)) = self.store_counted(client, record, file).await?;
        self.cache_setup(&session.record, &setup).await;
        Ok((session, setup))
    }

    /// A session of a name that the client has chosen, from a file and a warp object, or that session made anew.
    ///
    /// # Errors
    /// Whatever is wrong with either, or no room.
    pub async fn put(&self, client: Client, id: SessionId, file: Bytes, json: Bytes) -> Result<(Put, Arc<Setup>), Problem> {
        let ticket = self.0.pool.admit(WorkClass::Upload, QueueKey::client(client)).await?;
        let (material, ..) = self.prepare(client.owner, &ticket, file, json, None).await?;
        // Whoever waits for the store computes nothing.
        drop(ticket);
        let (record, file, setup) = material.recorded(id);
        let put = self.store_counted(client, record, file).await?;
        match &put {
            Put::Created(session) | Put::Same(session) => self.cache_setup(&session.record, &setup).await,
            Put::Replaced(session, old) => {
                self.cache_setup(&session.record, &setup).await;
                self.evict_session(old).await;
            }
        }
        Ok((put, setup))
    }

    /// Other handles at rest on the same picture: the fields that `json` gives replace the session's. The plan is made before the answer.
    ///
    /// # Errors
    /// Unknown session, whatever is wrong with the handles, or no room.
    pub async fn revise(&self, client: Client, id: SessionId, json: Bytes) -> Result<(Session, Arc<Setup>), Problem> {
        for _ in 0..ATTEMPTS {
            let old = self.touch(id, None).await?.record;
            // For as long as this computes, and not while it waits for the store.
            let ticket = self.0.pool.admit(WorkClass::Upload, QueueKey::session(client, id)).await?;
            let base = WarpObject { rest: old.rest.clone(), q: None, folds: old.folds, output: old.output };
            let (json, limits, extent) = (json.clone(), self.0.config.limits(), old.extent);
            let resolve =
                move |cancel: &Cancel| Ok::<_, Problem>(resolve(WarpPatch::parse(&json)?.merge_onto(base), extent, &limits, cancel)?);
            let (object, setup) = self.0.pool.run(&ticket, resolve).await??;
            self.plan(id.owner(), &ticket, &setup, &mut Timing::default()).await?;
            drop(ticket);
            let WarpObject { rest, folds, output, .. } = object;
            let new = Record { revision: Revision::random(), rest, folds, output, ..(*old).clone() };
            let claim = self.0.holdings.claim_revision(&new)?;
            let revised = in_stage("store", self.0.store.revise(old.revision, Arc::new(new))).await;
            match revised {
                Ok(Some(_)) => self.0.holdings.settle(&claim),
                _ => self.0.holdings.undo(claim),
            }
            // Whoever was faster has changed fields that this request may not have named: they are kept.
            if let Some(session) = revised? {
                self.cache_setup(&session.record, &setup).await;
                self.0.setups.remove(setup_key(&old));
                return Ok((session, setup));
            }
        }
        Err(StoreError::Contended.into())
    }

    /// Puts a session into the store and counts it for its client.
    async fn store_counted(&self, client: Client, record: Arc<Record>, file: Bytes) -> Result<Put, Problem> {
        // One client's many files do not hold up another's.
        let _turn = self.0.pool.admit(WorkClass::Transfer, QueueKey::client(client)).await?;
        let claim = self.0.holdings.claim(client.tenant(), &record, file.len() as u64)?;
        // If this request ends while the store works, the session may come to be: it stays counted.
        let put = in_stage("store", self.0.store.put(record, file)).await;
        match put {
            Ok(_) => self.0.holdings.settle(&claim),
            Err(_) => self.0.holdings.undo(claim),
        }
        Ok(put?)
    }

    /// Uses the session; see [`Store::touch`].
    ///
    /// [`Store::touch`]: crate::store::Store::touch
    pub(crate) async fn touch(&self, id: SessionId, seq: Option<u64>) -> Result<Session, StoreError> {
        let claim = self.0.holdings.claim_of(id);
        let touched = in_stage("store", self.0.store.touch(id, seq)).await;
        match &touched {
            Ok(_) => self.0.holdings.used(id),
            Err(StoreError::NoSuchSession | StoreError::Expired) => self.0.holdings.ended(id, claim),
            Err(_) => {}
        }
        touched
    }

    /// The setup of a record is at hand, where there is room for it: the session has been made whether there is or not.
    async fn cache_setup(&self, record: &Record, setup: &Arc<Setup>) {
        if let Ok(held) = self.reserve(Purpose::Plan, weight(record)) {
            let known = CacheEntry::new(Arc::clone(setup), held);
            let _ = self.0.setups.get(setup_key(record), async { Ok(known) }, build_aborted).await;
        }
    }

    /// Drops what was made for a record that is no session's any more.
    async fn evict_session(&self, record: &Record) {
        let setup = self.0.setups.remove(setup_key(record));
        // The picture goes with its owner's last session that names it, and the coefficients with it; another picture's session of the
        // same size and handles, if there is one, builds them again.
        let owner = record.id.owner();
        if !self.0.store.names(owner, record.image) {
            self.0.images.remove(image_key(record));
            if let Some(setup) = setup {
                self.0.plans.remove(Key::new(owner, setup.plan_key()));
            }
        }
    }

    /// The session, without using it.
    ///
    /// # Errors
    /// Unknown or expired.
    pub async fn session(&self, id: SessionId) -> Result<Session, Problem> {
        Ok(in_stage("store", self.0.store.peek(id)).await?)
    }

    /// Ends the session. One that was deleted a short time ago, or that another version of the program has stored, has nothing here to forget.
    ///
    /// # Errors
    /// Unknown or expired.
    pub async fn close(&self, id: SessionId) -> Result<(), Problem> {
        let (known, claim) = (in_stage("store", self.0.store.peek(id)).await, self.0.holdings.claim_of(id));
        in_stage("store", self.0.store.delete(id)).await?;
        self.0.holdings.ended(id, claim);
        if let Ok(session) = known {
            self.evict_session(&session.record).await;
        }
        Ok(())
    }
}

#[cfg(test)]
mod tests {
    use std::net::{IpAddr, Ipv4Addr};
    use std::sync::atomic::{AtomicUsize, Ordering};

    use super::*;
    use crate::client::Owner;
    use crate::config::Config;
    use crate::problem::Code;
    use crate::store::{Answer, Figures, Store};
    use mlswarp::warp::Digest;

    /// A store on which somebody else is always faster.
    #[derive(Debug)]
    struct Contended(Arc<dyn Store>, AtomicUsize);

    impl Store for Contended {
        fn put(&self, record: Arc<Record>, image: Bytes) -> Answer<'_, Put> {
            self.0.put(record, image)
        }
        fn revise(&self, _: Revision, _: Arc<Record>) -> Answer<'_, Option<Session>> {
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
        fn image_bytes(&self, id: SessionId, digest: Digest) -> Answer<'_, u64> {
            self.0.image_bytes(id, digest)
        }
        fn image(&self, id: SessionId, digest: Digest) -> Answer<'_, Bytes> {
            self.0.image(id, digest)
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
        let (session, _) = app.open(client, file.into_inner().into(), Bytes::from_static(br#"{"p": [[5, 5]]}"#)).await.unwrap();
        let refused = app.revise(client, session.record.id, Bytes::from_static(br#"{"p": [[6, 6]]}"#)).await.unwrap_err();
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
        let open = || app.open(client, file.clone(), Bytes::from_static(br#"{"p": [[5, 5]]}"#));
        let (session, setup) = open().await.unwrap();
        // Somebody draws from them, and everything else is taken.
        let _used =
            (app.0.images.peek(image_key(&session.record)).unwrap(), app.0.plans.peek(Key::new(client.owner, setup.plan_key())).unwrap());
        let budget = app.budget();
        let mut rest = vec![budget.take(Purpose::Frame, budget.total() - budget.taken()).unwrap()];
        // The first session's setup gives way.
        while let Ok(held) = app.reserve(Purpose::Plan, 1) {
            drop(held);
            rest.push(budget.take(Purpose::Frame, budget.total() - budget.taken()).unwrap());
        }
        let (other, _) = open().await.unwrap();
        assert_eq!(app.session(other.record.id).await.unwrap().record, other.record);
    }
}
