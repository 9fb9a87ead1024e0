//! Layers of a session: further pictures, stored and deleted with it, and warped through its plan.

use std::collections::BTreeMap;
use std::sync::Arc;

use bytes::Bytes;
use mlswarp::warp::Digest;

use super::drawable::{check_extent, find_layer};
use super::session_object::ShownSession;
use super::warp::SESSION_ATTEMPTS;
use super::{App, MIN_WEIGHT};
use crate::client::Client;
use crate::layer::{LayerKind, LayerName, MAX_LAYERS};
use crate::limits::memory::MemoryClass;
use crate::observe::scope::in_stage;
use crate::pool::{Cancel, QueueKey, WorkClass};
use crate::problem::words::quote;
use crate::problem::{Code, Problem};
use crate::session::{Revision, SessionId};
use crate::store::{NamedFile, Record, StoreError, StoredLayer};

/// A session whose layer was stored.
#[derive(Debug)]
pub struct LayerPut {
    /// The session as it is now.
    pub session: ShownSession,
    /// Whether there was no layer of that name.
    pub is_new: bool,
}

impl App {
    /// Stores a layer, or replaces the one of that name, after its file has been decoded. Errors:
    /// Unknown session, a wrong file, another size than the session's picture, too many layers, or
    /// too little capacity.
    pub async fn put_layer(
        &self,
        client: Client,
        id: SessionId,
        name: &LayerName,
        kind: LayerKind,
        file: Bytes,
    ) -> Result<LayerPut, Problem> {
        for _ in 0..SESSION_ATTEMPTS {
            let session = self.touch(id, None).await?;
            let old = Arc::clone(&session.record);
            check_count(&old, name)?;
            check_twin(&old, name)?;
            let ticket = self
                .0
                .pool
                .admit(WorkClass::Upload, QueueKey::session(client, id))
                .await?;
            let digest = self.check_layer(&ticket, file.clone(), old.extent).await?;
            let drawable = self
                .decode_file(client, &ticket, kind, digest, file.clone())
                .await?;
            check_extent(drawable.subject().extent(), old.extent)?;
            // The ticket is not held while the store works.
            drop(ticket);
            let mut layers = old.layers.clone();
            let before = layers.insert(name.clone(), StoredLayer { kind, digest });
            let is_new = before.is_none();
            if layers == old.layers {
                return Ok(LayerPut {
                    session: self.read_session(client, session).await?,
                    is_new,
                });
            }
            let file = NamedFile {
                digest,
                bytes: file.clone(),
            };
            if let Some(session) = self.revise_layers(client, &old, layers, Some(file)).await? {
                return Ok(LayerPut { session, is_new });
            }
        }
        Err(StoreError::Contended.into())
    }

    /// Removes a layer.
    /// Errors: Unknown session or layer, or too little capacity.
    pub async fn delete_layer(
        &self,
        client: Client,
        id: SessionId,
        name: &str,
    ) -> Result<(), Problem> {
        for _ in 0..SESSION_ATTEMPTS {
            let old = self.touch(id, None).await?.record;
            let (name, _) = find_layer(&old, name)?;
            let mut layers = old.layers.clone();
            layers.remove(&name);
            if self
                .revise_layers(client, &old, layers, None)
                .await?
                .is_some()
            {
                return Ok(());
            }
        }
        Err(StoreError::Contended.into())
    }

    /// The file of a layer, whose memory counts for the client until it is sent. Reading does not
    /// extend the session's life. Errors: Unknown session or layer, or too little capacity.
    pub async fn layer_file(
        &self,
        client: Client,
        id: SessionId,
        name: &str,
    ) -> Result<Bytes, Problem> {
        let mut record = self.peek_session(id).await?.record;
        for _ in 0..SESSION_ATTEMPTS {
            let (_, layer) = find_layer(&record, name)?;
            match self.read_layer(client, id, layer.digest).await {
                Ok(file) => return Ok(file),
                Err(problem) => record = self.newer_record(&record, problem).await?,
            }
        }
        Err(StoreError::Contended.into())
    }

    async fn read_layer(
        &self,
        client: Client,
        id: SessionId,
        digest: Digest,
    ) -> Result<Bytes, Problem> {
        let _ticket = self
            .0
            .pool
            .admit(WorkClass::Transfer, QueueKey::session(client, id))
            .await?;
        let bytes = in_stage("store", self.0.store.file_bytes(id, digest)).await?;
        let (quota, bytes) = (self.response_quota(client), bytes.max(MIN_WEIGHT));
        let mut reservation = self
            .reserve_aside(|budget| budget.take_for(MemoryClass::Frame, &quota, bytes))
            .await?;
        let file = in_stage("store", self.0.store.file(id, digest)).await?;
        reservation.shrink_to((file.len() as u64).max(MIN_WEIGHT));
        Ok(reservation.attach(file))
    }

    /// Replaces the layers of a record; they count for its client. `None`: the session has another
    /// revision by now.
    async fn revise_layers(
        &self,
        client: Client,
        old: &Arc<Record>,
        layers: BTreeMap<LayerName, StoredLayer>,
        file: Option<NamedFile>,
    ) -> Result<Option<ShownSession>, Problem> {
        // Before the change, after which nothing may fail.
        let ticket = self
            .0
            .pool
            .admit(WorkClass::Upload, QueueKey::session(client, old.id))
            .await?;
        let (app, before) = (self.clone(), Arc::clone(old));
        let write = move |cancel: &Cancel| {
            let new = Arc::new(Record {
                revision: Revision::random(),
                layers,
                ..(*before).clone()
            });
            let text = app.write_text(&new, None, cancel)?;
            Ok::<_, Problem>((new, app.shown(client, Arc::new(text))?))
        };
        let (new, shown) = self.0.pool.run(&ticket, write).await??;
        drop(ticket);
        // Limits the simultaneous transfers, fairly between clients.
        let ticket = self
            .0
            .pool
            .admit(WorkClass::Transfer, QueueKey::session(client, old.id))
            .await?;
        let claim = self.0.client_sessions.claim_revision(&new, file.as_ref())?;
        // If this future is dropped while the store works, the layer may have been stored: it stays
        // counted.
        let revised = in_stage(
            "store",
            self.0.store.revise(old.revision, Arc::clone(&new), file),
        )
        .await;
        drop(ticket);
        match &revised {
            Ok(Some(_)) => self.0.client_sessions.confirm(&claim),
            _ => self.0.client_sessions.undo(claim),
        }
        let Some(session) = revised? else {
            return Ok(None);
        };
        // Layers do not change what is posed.
        if let Some(setup) = self.forget_revision(old) {
            self.cache_setup(client, &new, &setup);
        }
        for layer in old
            .layers
            .values()
            .filter(|layer| !session.record.layers.values().any(|kept| kept == *layer))
        {
            self.evict_file(old.id.owner(), layer.digest);
        }
        Ok(Some(self.show_new(client, &new, shown, session)))
    }
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
