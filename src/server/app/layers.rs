//! Layers of a session: further images, stored and deleted with it, and warped through its plan.

use std::collections::BTreeMap;
use std::sync::Arc;

use bytes::Bytes;
use mlswarp::warp::RestSummary;

use super::drawable::{Drawable, find_layer};
use super::parts::plans::HeldSetup;
use super::session_object::ShownSession;
use super::sessions::forget_revision;
use super::{App, SESSION_ATTEMPTS};
use crate::client::Client;
use crate::layer::{LayerKind, LayerName, MAX_LAYERS, check_extent};
use crate::limits::memory::{Budget, MemoryClass};
use crate::pool::{Cancel, QueueKey};
use crate::problem::words::quote;
use crate::problem::{Code, Problem};
use crate::session::{Revision, SessionId};
use crate::store::{NamedFile, Record, Session, StoreError, StoredLayer};

/// A session whose layer was stored.
#[derive(Debug)]
pub(crate) struct LayerPut {
    /// The session as it is now.
    pub(crate) session: ShownSession,
    /// Whether there was no layer of that name.
    pub(crate) is_new: bool,
}

/// Stores a layer, or replaces the one of that name, after its file has been decoded. `session`: as
/// it was read. Errors: A wrong file, another size than the session's image, too many layers, or
/// too little capacity.
pub(crate) async fn put(
    app: &App,
    client: Client,
    mut session: Session,
    name: &LayerName,
    kind: LayerKind,
    file: Bytes,
) -> Result<LayerPut, Problem> {
    let id = session.record.id;
    for attempt in 0..SESSION_ATTEMPTS {
        if attempt > 0 {
            session = app.sessions.touch(id, None).await?;
        }
        let old = Arc::clone(&session.record);
        check_count(&old, name)?;
        check_twin(&old, name)?;
        let key = QueueKey::session(client, id);
        let ticket = app.admission.upload(key).await?;
        let digest = app
            .images
            .check_layer(&ticket, file.clone(), old.extent)
            .await?;
        let drawable = app
            .images
            .decode_file(client, &ticket, kind, digest, file.clone())
            .await?;
        check_extent(drawable.raster_source().extent(), old.extent)?;
        // The ticket is not held while the store works.
        drop(ticket);
        let mut layers = old.layers.clone();
        let before = layers.insert(name.clone(), StoredLayer { kind, digest });
        let is_new = before.is_none();
        if layers == old.layers {
            let session = app.sessions.show(client, session).await?;
            return Ok(LayerPut { session, is_new });
        }
        let bytes = file.clone();
        let file = Some(NamedFile { digest, bytes });
        if let Some(session) =
            revise_layers(app, client, &old, layers, file, Some(drawable)).await?
        {
            return Ok(LayerPut { session, is_new });
        }
    }
    Err(StoreError::Contended.into())
}

/// Removes a layer.
/// Errors: Unknown session or layer, or too little capacity.
pub(crate) async fn delete(
    app: &App,
    client: Client,
    id: SessionId,
    name: &str,
) -> Result<(), Problem> {
    for _ in 0..SESSION_ATTEMPTS {
        let old = app.sessions.touch(id, None).await?.record;
        let (name, _) = find_layer(&old, name)?;
        let mut layers = old.layers.clone();
        layers.remove(&name);
        let revised = revise_layers(app, client, &old, layers, None, None).await?;
        if revised.is_some() {
            return Ok(());
        }
    }
    Err(StoreError::Contended.into())
}

/// The file of a layer, whose memory counts for the client until it is sent. Reading does not
/// extend the session's life. Errors: Unknown session or layer, or too little capacity.
pub(crate) async fn read(
    app: &App,
    client: Client,
    id: SessionId,
    name: &str,
) -> Result<Bytes, Problem> {
    let mut record = app.sessions.peek(id).await?.record;
    let quota = app.admission.response_quota(client);
    let take = |budget: &Budget, bytes| budget.take_for(MemoryClass::Frame, &quota, bytes);
    for _ in 0..SESSION_ATTEMPTS {
        let (_, layer) = find_layer(&record, name)?;
        match app.images.read_file(client, id, layer.digest, take).await {
            Ok((file, held)) => return Ok(held.attach(file)),
            Err(problem) => record = app.sessions.newer_record(&record, problem).await?,
        }
    }
    Err(StoreError::Contended.into())
}

/// Replaces the layers of a record; they count for its client. `region`: the mask among them, if
/// it is new. `None`: the session has another revision by now.
async fn revise_layers(
    app: &App,
    client: Client,
    old: &Arc<Record>,
    layers: BTreeMap<LayerName, StoredLayer>,
    file: Option<NamedFile>,
    region: Option<Drawable>,
) -> Result<Option<ShownSession>, Problem> {
    // Before the change, after which nothing may fail.
    let new = Arc::new(Record {
        revision: Revision::random(),
        layers,
        ..(**old).clone()
    });
    // A mask that the region is a part of changes what is posed.
    let remasked = old.rest.needs_mask() && region_of(old) != region_of(&new);
    let setup = match remasked {
        true => remasked_setup(app, client, &new, region).await.map(Some),
        false if old.rest.needs_mask() => app.plans.setup_of(client, old).await.map(Some),
        false => Ok(None),
    };
    let setup = match setup {
        Ok(setup) => setup,
        // The image was replaced before its mask was read.
        Err(problem) => {
            app.sessions.newer_record(old, problem).await?;
            return Ok(None);
        }
    };
    let summary = setup.as_deref().map(|setup| RestSummary::of(setup));
    let key = QueueKey::session(client, old.id);
    let ticket = app.admission.upload(key).await?;
    let (sessions, written) = (Arc::clone(&app.sessions), Arc::clone(&new));
    let write = move |cancel: &Cancel| sessions.write_new(client, &written, summary, cancel);
    let shown = ticket.run(write).await??;
    drop(ticket);
    // Limits the simultaneous transfers, fairly between clients.
    let ticket = app.admission.transfer(key).await?;
    let revised = app.sessions.revise(client, old.revision, &new, file).await;
    drop(ticket);
    let Some(session) = revised? else {
        return Ok(None);
    };
    // Other layers do not change what is posed.
    let kept = forget_revision(app, old);
    if let Some(setup) = setup.or(kept) {
        app.plans.keep_setup(client, &new, &setup);
    }
    for layer in old
        .layers
        .values()
        .filter(|layer| !session.record.layers.values().any(|kept| kept == *layer))
    {
        app.images.evict_unused(old.id.owner(), layer.digest);
    }
    Ok(Some(app.sessions.show_new(client, shown, session)))
}

fn region_of(record: &Record) -> Option<&StoredLayer> {
    record.layers.get(&LayerName::region())
}

/// The setup of a record whose region is not stored yet.
async fn remasked_setup(
    app: &App,
    client: Client,
    new: &Arc<Record>,
    region: Option<Drawable>,
) -> Result<HeldSetup, Problem> {
    let without = Record {
        layers: BTreeMap::new(),
        ..(**new).clone()
    };
    let content = app.images.content(client, &without).await?;
    let content = match region {
        Some(Drawable::Image(region)) if region_of(new).is_some() => content.within(region),
        _ => content,
    };
    let ticket = app
        .admission
        .upload(QueueKey::session(client, new.id))
        .await?;
    let (plans, record) = (Arc::clone(&app.plans), Arc::clone(new));
    let new =
        move |cancel: &Cancel| plans.new_setup(&record.rest, record.extent, Some(&content), cancel);
    Ok(Arc::new(ticket.run(new).await??))
}

fn check_count(record: &Record, name: &LayerName) -> Result<(), Problem> {
    let count = record.layers.len() + usize::from(!record.layers.contains_key(name));
    if count > MAX_LAYERS {
        let detail = format!(
            "the session would have {count} layers; the limit is {MAX_LAYERS}. Delete or replace \
                one of them"
        );
        return Err(Problem::new(Code::TooLarge, detail).limit(
            "session_layers",
            MAX_LAYERS,
            count,
        ));
    }
    Ok(())
}

/// Errors: Another layer has the name in other letters: both would be one file of a batch.
fn check_twin(record: &Record, name: &LayerName) -> Result<(), Problem> {
    let region = LayerName::region();
    let twin = record
        .layers
        .keys()
        .chain([&region])
        .find(|other| name.is_twin(other));
    // Sessions of earlier versions may have both.
    let Some(twin) = twin.filter(|_| !record.layers.contains_key(name)) else {
        return Ok(());
    };
    let other = if record.layers.contains_key(twin) {
        "a layer"
    } else {
        "the name"
    };
    let detail = format!(
        "{} differs only in upper and lower case from {other} `{twin}`; choose another name",
        quote(name.as_str())
    );
    Err(Problem::new(Code::BadValue, detail))
}

/// The problem of a name that no stored layer can have.
pub(crate) fn bad_name(name: &str) -> Problem {
    let detail = if name.starts_with('@') {
        format!(
            "a layer cannot be stored as {}: names that begin with `@` are built-in",
            quote(name)
        )
    } else {
        let rule =
            "it has 1 to 64 of the characters A-Z, a-z, 0-9, `.`, `_` and `-`, not only dots";
        format!("{} is not the name of a layer: {rule}", quote(name))
    };
    Problem::new(Code::BadValue, detail)
}
