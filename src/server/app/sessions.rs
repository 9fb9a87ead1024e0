//! `/sessions`: opened, replaced, given other handles, closed.

use std::sync::Arc;
use std::time::SystemTime;

use bytes::Bytes;
use mlswarp::warp::{RasterSource, RestSpec, RestSummary};

use super::draw::DrawJob;
use super::drawable::DrawnContent;
use super::parts::plans::{HeldSetup, revision_key};
use super::resolved::{Resolved, resolve_by};
use super::session_object::ShownSession;
use super::upload::{Upload, prepare};
use super::{App, SESSION_ATTEMPTS};
use crate::cache::CacheKey;
use crate::client::Client;
use crate::layer::{LayerKind, LayerName};
use crate::limits::free::SharedHandles;
use crate::limits::memory::MemoryClass;
use crate::observe::scope::in_stage;
use crate::observe::stages::Timing;
use crate::pool::{Cancel, QueueKey};
use crate::problem::Problem;
use crate::session::{Revision, SessionId};
use crate::store::{NamedFile, Put, Record, StoreError, StoredLayer};
use crate::wire::{Reserved, WarpObject, WarpPatch, method_text};

/// A session with its object, and the method that was chosen for it if that was requested, as a
/// header shows it.
pub(crate) type Resulting = (ShownSession, Option<String>);

/// Opens a session with an id of its own from a file and a warp object; `q` is checked if it is
/// sent. Errors: A wrong file or object, or too little capacity.
pub async fn create(app: &App, client: Client, upload: Upload) -> Result<Resulting, Problem> {
    let id = SessionId::random(client.owner);
    Ok(put(app, client, id, upload).await?.1)
}

/// Opens or replaces a session. The first result: whether there was none. What shows it is made
/// before it is stored: afterwards nothing may fail. Errors: A wrong file or object, or too little
/// capacity.
pub async fn put(
    app: &App,
    client: Client,
    id: SessionId,
    upload: Upload,
) -> Result<(bool, Resulting), Problem> {
    // The ticket is not held while the store works.
    let ticket = app.admission.upload(QueueKey::client(client)).await?;
    let (resolved, job) = prepare(app, client, &ticket, upload, None).await?;
    // The plan stays until the session is stored.
    let DrawJob {
        content,
        planned: _planned,
        q,
        ..
    } = job;
    drop(q);
    let (method, setup) = (resolved.chosen_method(), Arc::clone(&resolved.setup));
    let sessions = Arc::clone(&app.sessions);
    let write = move |cancel: &Cancel| {
        let (record, files) = record_of(id, resolved, content);
        let summary = RestSummary::of(&setup);
        let shown = sessions.write_new(client, &record, Some(summary), cancel)?;
        Ok::<_, Problem>((record, files, setup, shown))
    };
    let (record, files, setup, shown) = ticket.run(write).await??;
    drop(ticket);
    let (is_new, shown) = match store(app, client, record, files, &setup).await? {
        Put::Same(session) => (false, app.sessions.show(client, session).await?),
        Put::Created(session) => (true, app.sessions.show_new(client, shown, session)),
        Put::Replaced(session, _) => (false, app.sessions.show_new(client, shown, session)),
    };
    Ok((is_new, (shown, method)))
}

/// Opens a session from an upload that was already drawn.
/// Errors: Too little capacity.
pub(crate) async fn create_from(
    app: &App,
    client: Client,
    resolved: Resolved,
    content: DrawnContent,
) -> Result<SessionId, Problem> {
    // Undoes the demotion of an image that is warped once.
    for file in &resolved.files {
        let _ = app
            .images
            .images
            .touch(CacheKey::new(client.owner, file.digest));
    }
    let setup = Arc::clone(&resolved.setup);
    let (record, files) = record_of(SessionId::random(client.owner), resolved, content);
    let id = record.id;
    store(app, client, record, files, &setup).await?;
    Ok(id)
}

/// The record and files of a session that is made from an upload.
fn record_of(
    id: SessionId,
    resolved: Resolved,
    content: DrawnContent,
) -> (Arc<Record>, Vec<NamedFile>) {
    let Resolved {
        object,
        pose,
        files,
        ..
    } = resolved;
    let (object, _held) = object.into_parts();
    let made_with_region = files.get(1).map(|file| file.digest);
    let layer = |digest| {
        let kind = LayerKind::Image;
        (LayerName::region(), StoredLayer { kind, digest })
    };
    let record = Record {
        id,
        revision: Revision::random(),
        image: files[0].digest,
        layers: made_with_region.map(layer).into_iter().collect(),
        made_with_region,
        extent: content.raster_source().extent(),
        rest: object.rest.into(),
        pose: pose.map(SharedHandles::from),
        folds: object.folds,
        output: object.output,
        created: SystemTime::now(),
    };
    (Arc::new(record), files)
}

/// Stores a session, and keeps its setup.
async fn store(
    app: &App,
    client: Client,
    record: Arc<Record>,
    files: Vec<NamedFile>,
    setup: &HeldSetup,
) -> Result<Put, Problem> {
    let put = app.sessions.put(client, record, files).await?;
    let (Put::Created(session) | Put::Same(session) | Put::Replaced(session, _)) = &put;
    app.plans.keep_setup(client, &session.record, setup);
    if let Put::Replaced(_, old) = &put {
        evict(app, old);
    }
    Ok(put)
}

/// Replaces those rest handles and options of a session that `json` gives. The plan is built before
/// the response. `old`: the session's record as it was read. Errors: Unknown session, wrong
/// handles, or too little capacity.
pub(crate) async fn replace_handles(
    app: &App,
    client: Client,
    mut old: Arc<Record>,
    json: Bytes,
) -> Result<Resulting, Problem> {
    for attempt in 0..SESSION_ATTEMPTS {
        if attempt > 0 {
            // Another request has changed fields that this one may not have named: they are kept.
            old = app.sessions.touch(old.id, None).await?.record;
        }
        match try_replace_handles(app, client, &old, json.clone()).await {
            Ok(Some(result)) => return Ok(result),
            Ok(None) => {}
            // The image was replaced before its mask was read.
            Err(problem) => drop(app.sessions.newer_record(&old, problem).await?),
        }
    }
    Err(StoreError::Contended.into())
}

/// `None`: the session has another revision by now.
async fn try_replace_handles(
    app: &App,
    client: Client,
    old: &Arc<Record>,
    json: Bytes,
) -> Result<Option<Resulting>, Problem> {
    let key = QueueKey::session(client, old.id);
    let ticket = app.admission.upload(key).await?;
    let reserve = app
        .admission
        .reserving_pose(MemoryClass::Upload, client, old);
    let before = Arc::clone(old);
    let settle = move |_: &_| {
        let patch =
            Reserved::<WarpPatch, _>::parse(&json, reserve)?.try_map(WarpPatch::without_files)?;
        let (q, strength) = before
            .pose
            .as_deref()
            .map_or((None, 1.0), |pose| (Some(pose.q.clone()), pose.strength));
        let (rest, folds, output) = ((*before.rest).clone(), before.folds, before.output);
        let base = WarpObject {
            rest,
            q,
            folds,
            output,
            strength,
            is_auto: false,
        };
        Ok::<_, Problem>(patch.map(|patch| patch.merge_onto(base)))
    };
    let object = ticket.run(settle).await??;
    let (ticket, content) = if object.rest.needs_mask() {
        // The ticket is not held while the store works.
        drop(ticket);
        let content = app.images.content(client, old).await?;
        (app.admission.upload(key).await?, Some(content))
    } else {
        (ticket, None)
    };
    let (plans, before) = (Arc::clone(&app.plans), Arc::clone(old));
    let of_job = app.clone();
    let settle = move |cancel: &Cancel| {
        let extent = before.extent;
        // Another depth is often all that changes when a drag begins.
        let setup_of = |rest: &RestSpec| match plans.with_depth(rest, &before)? {
            Some(setup) => Ok(setup),
            None => plans.new_setup(rest, extent, content.as_ref(), cancel),
        };
        resolve_by(&of_job, object, extent, setup_of, cancel)
    };
    let Resolved {
        object,
        pose,
        setup,
        ..
    } = ticket.run(settle).await??;
    // An image that is not in memory is looked at when it is drawn.
    let image = CacheKey::new(old.id.owner(), old.image);
    if let Some(image) = app.images.images.peek(image) {
        RasterSource::Image(&image).check(&object.output)?;
    }
    app.plans
        .plan(client, &ticket, &setup, Timing::default())
        .await?;
    let (sessions, before, summarized) = (
        Arc::clone(&app.sessions),
        Arc::clone(old),
        Arc::clone(&setup),
    );
    let write = move |cancel: &Cancel| {
        let method = object.is_auto.then(|| method_text(&object.rest));
        let (object, _held) = object.into_parts();
        let new = Arc::new(Record {
            revision: Revision::random(),
            rest: object.rest.into(),
            pose: pose.map(SharedHandles::from),
            folds: object.folds,
            output: object.output,
            ..(*before).clone()
        });
        let summary = RestSummary::of(&summarized);
        let shown = sessions.write_new(client, &new, Some(summary), cancel)?;
        Ok::<_, Problem>((new, shown, method))
    };
    let (new, shown, method) = ticket.run(write).await??;
    // The ticket is not held while the store works.
    drop(ticket);
    let Some(session) = app
        .sessions
        .revise(client, old.revision, &new, None)
        .await?
    else {
        return Ok(None);
    };
    app.plans.keep_setup(client, &session.record, &setup);
    forget_revision(app, old);
    let shown = app.sessions.show_new(client, shown, session);
    Ok(Some((shown, method)))
}

/// Evicts what was cached for a revision that no session has any more; returns its setup.
pub(super) fn forget_revision(app: &App, record: &Record) -> Option<HeldSetup> {
    app.sessions.texts.drop_value(revision_key(record));
    app.plans.forget_setup(record)
}

/// Evicts what was cached for a record that no session has any more.
fn evict(app: &App, record: &Record) {
    let setup = forget_revision(app, record);
    // The image is evicted with the owner's last session that uses it, and the plan with it. A
    // session of another image with the same extent and handles builds the plan again.
    let owner = record.id.owner();
    if app.images.evict_unused(owner, record.image)
        && let Some(setup) = setup
    {
        app.plans.forget_plan(owner, &setup);
    }
    for layer in record.layers.values() {
        app.images.evict_unused(owner, layer.digest);
    }
}

/// Closes the session. If it was deleted recently, or another version of the program stored it,
/// nothing is cached for it here. Errors: Unknown or expired.
pub(crate) async fn delete(app: &App, id: SessionId) -> Result<(), Problem> {
    let sessions = &app.sessions;
    let (record, claim) = (sessions.find(id).await, sessions.counted.claim_of(id));
    in_stage("store", sessions.store.delete(id)).await?;
    sessions.counted.ended(id, claim);
    if let Ok(record) = record {
        evict(app, &record);
    }
    Ok(())
}

#[cfg(test)]
mod tests {
    use std::net::{IpAddr, Ipv4Addr};
    use std::sync::atomic::{AtomicUsize, Ordering};

    use mlswarp::warp::Digest;

    use super::*;
    use crate::client::Owner;
    use crate::config::Config;
    use crate::pool::WorkClass;
    use crate::problem::Code;
    use crate::store::{Session, Store, StoreFuture, StoreStats};

    /// A store on which another client is always faster.
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
        fn was_deleted(&self, id: SessionId) -> StoreFuture<'_, bool> {
            self.0.was_deleted(id)
        }
        fn file_bytes(&self, id: SessionId, digest: Digest) -> StoreFuture<'_, u64> {
            self.0.file_bytes(id, digest)
        }
        fn file(&self, id: SessionId, digest: Digest) -> StoreFuture<'_, Bytes> {
            self.0.file(id, digest)
        }
        fn local_record(&self, id: SessionId) -> Option<Arc<Record>> {
            self.0.local_record(id)
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
        let config = Config::default();
        let store = crate::store::open(&config.store.url, config.store.bounds()).unwrap();
        let contended = Arc::new(Contended(store, AtomicUsize::new(0)));
        let app = App::with_store(config, Arc::clone(&contended) as Arc<dyn Store>).unwrap();
        let client = Client {
            owner: Owner::ANYBODY,
            address: IpAddr::V4(Ipv4Addr::LOCALHOST),
            visit: None,
        };
        let mut file = std::io::Cursor::new(Vec::new());
        image::DynamicImage::new_rgb8(40, 30)
            .write_to(&mut file, image::ImageFormat::Png)
            .unwrap();
        let (shown, _) = create(
            &app,
            client,
            Upload::new(file.into_inner(), r#"{"p": [[5, 5]]}"#),
        )
        .await
        .unwrap();
        let refused = replace_handles(
            &app,
            client,
            shown.session.record,
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
        let open = || {
            create(
                &app,
                client,
                Upload::new(file.clone(), r#"{"p": [[5, 5]]}"#),
            )
        };
        let (shown, _) = open().await.unwrap();
        let record = &shown.session.record;
        // A request draws from them, and all other memory is taken.
        let setup = app.plans.setup_of(client, record).await.unwrap();
        let _used = (
            app.images
                .images
                .peek(CacheKey::new(client.owner, record.image))
                .unwrap(),
            app.plans
                .compiled
                .peek(CacheKey::new(client.owner, setup.plan_key())),
        );
        let budget = app.budget();
        let mut rest = budget
            .take(MemoryClass::Frame, budget.total() - budget.taken())
            .unwrap();
        while app.admission.evict_idle() {}
        rest.grow(budget.total() - budget.taken()).unwrap();
        let sessions = || app.sessions.store.figures().sessions;
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
            create(
                &app,
                client,
                Upload::new(file.clone(), format!(r#"{{"p": {p:?}, "method": "tps"}}"#)),
            )
        };
        let (shown, _) = open(3).await.unwrap();
        // The image stays decoded.
        let _used = app
            .images
            .images
            .peek(CacheKey::new(client.owner, shown.session.record.image))
            .unwrap();
        let budget = app.budget();
        let mut taken = budget.take(MemoryClass::Frame, budget.total() / 2).unwrap();
        // An upload has room, and a plan 8 MiB more: 1,500 points have a system of 9 MB, 100 one of
        // 40 kB.
        while app
            .admission
            .reserve(MemoryClass::Upload, 1_000_000)
            .is_ok()
        {
            taken.grow(100_000).unwrap();
        }
        open(100).await.unwrap();
        assert_eq!(open(1500).await.unwrap_err().code, Code::Overloaded);
        drop(taken);
        open(1500).await.unwrap();
    }
}
