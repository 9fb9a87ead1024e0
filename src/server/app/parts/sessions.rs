//! Sessions: the store, what each client has in it, the order of numbered requests, and the texts
//! of session objects.

use std::sync::Arc;
use std::time::Duration;

use mlswarp::warp::{Limits, RestSummary};

use super::admission::Admission;
use super::plans::{Plans, columns, revision_key};
use crate::app::client_sessions::ClientSessions;
use crate::app::sequence::{SequencePosition, Sequencer};
use crate::app::session_object::{
    RevisionText, SessionText, ShownSession, longest_text, revision_text,
};
use crate::cache::{Cache, CacheEntry};
use crate::client::Client;
use crate::limits::memory::MemoryClass;
use crate::observe::metrics::Metrics;
use crate::observe::scope::in_stage;
use crate::pool::{Cancel, QueueKey};
use crate::problem::{Code, Problem};
use crate::session::{Revision, SessionId};
use crate::store::{NamedFile, Put, Record, Session, Store, StoreError, in_pieces};

/// Sessions and what belongs to them.
#[derive(Debug)]
pub struct Sessions {
    pub(crate) admission: Arc<Admission>,
    pub(crate) metrics: Arc<Metrics>,
    pub(crate) limits: Limits,
    pub(crate) store: Arc<dyn Store>,
    pub(crate) counted: ClientSessions,
    pub(crate) sequencer: Sequencer,
    pub(crate) texts: Cache<RevisionText>,
    /// For what sessions say of handles inside a mask.
    pub(crate) plans: Arc<Plans>,
}

/// A request for a session, with its position among the numbered ones.
pub(crate) struct SequencedRequest {
    pub(crate) record: Arc<Record>,
    position: Option<(SequencePosition, u64)>,
}

impl Sessions {
    /// Reads the session without extending its life.
    /// Errors: Unknown or expired.
    pub(crate) async fn peek(&self, id: SessionId) -> Result<Session, Problem> {
        Ok(in_stage("store", self.store.peek(id)).await?)
    }

    /// The session's record, for what happens before the session is used: as this process has it,
    /// without asking the store, or else read without extending the session's life.
    /// Errors: Unknown or expired.
    pub(crate) async fn find(&self, id: SessionId) -> Result<Arc<Record>, Problem> {
        match self.store.local_record(id) {
            Some(record) => Ok(record),
            None => Ok(self.peek(id).await?.record),
        }
    }

    /// Reads the session and extends its life; see [`Store::touch`].
    pub(crate) async fn touch(
        &self,
        id: SessionId,
        seq: Option<u64>,
    ) -> Result<Session, StoreError> {
        let claim = self.counted.claim_of(id);
        let touched = in_stage("store", self.store.touch(id, seq)).await;
        match &touched {
            Ok(_) => self.counted.used(id),
            Err(StoreError::NoSuchSession | StoreError::Expired { .. }) => {
                self.counted.ended(id, claim)
            }
            Err(_) => {}
        }
        touched
    }

    /// The record by which files are read again after `problem`: another request may have replaced
    /// those of `record` since it was read, and the session lives. Every reader of a session's
    /// files asks this, so that a 404 means that the session has ended. Errors: `problem`, if it is
    /// about something else or the session has no newer record.
    pub(crate) async fn newer_record(
        &self,
        record: &Record,
        problem: Problem,
    ) -> Result<Arc<Record>, Problem> {
        if problem.code != Code::NoSuchSession {
            return Err(problem);
        }
        let newest = self.peek(record.id).await?.record;
        if newest.revision == record.revision {
            Err(problem)
        } else {
            Ok(newest)
        }
    }

    /// The problem of a request that reads a session's files by one record alone: 503 in place of
    /// `problem` if another request has replaced those files meanwhile.
    pub(crate) async fn replaced(&self, record: &Record, problem: Problem) -> Problem {
        match self.newer_record(record, problem).await {
            Ok(_) => StoreError::Contended.into(),
            Err(problem) => problem,
        }
    }

    /// Stores a session, counted for its client.
    pub(crate) async fn put(
        &self,
        client: Client,
        record: Arc<Record>,
        files: Vec<NamedFile>,
    ) -> Result<Put, Problem> {
        // Limits the simultaneous transfers, fairly between clients.
        let ticket = self.admission.transfer(QueueKey::client(client)).await?;
        let claim = self.counted.claim(client.tenant(), &record, &files)?;
        // If this future is dropped while the store works, the session may have been stored: it
        // stays counted.
        let put = in_stage("store", self.store.put(record, files)).await;
        drop(ticket);
        match &put {
            Ok(Put::Same(_)) => self.counted.confirm_same(&claim),
            Ok(_) => self.counted.confirm(&claim),
            Err(_) => self.counted.undo(claim),
        }
        Ok(put?)
    }

    /// Replaces the record of revision `old`, counted for who made the session. `layer`: the file
    /// that only the new record names. `None`: the session has another revision by now.
    pub(crate) async fn revise(
        &self,
        client: Client,
        old: Revision,
        new: &Arc<Record>,
        layer: Option<NamedFile>,
    ) -> Result<Option<Session>, Problem> {
        let claim = self
            .counted
            .claim_revision(client.tenant(), new, layer.as_ref())?;
        // If this future is dropped while the store works, the layer may have been stored: it stays
        // counted.
        let revised = in_stage("store", self.store.revise(old, Arc::clone(new), layer)).await;
        match &revised {
            Ok(Some(_)) => self.counted.confirm(&claim),
            _ => self.counted.undo(claim),
        }
        Ok(revised?)
    }

    /// Touches the session, and enters a numbered request into its sequence.
    pub(crate) async fn sequence(
        &self,
        id: SessionId,
        seq: Option<u64>,
    ) -> Result<SequencedRequest, Problem> {
        let Session {
            record,
            seq: newest,
            ..
        } = self.touch(id, seq).await?;
        let position = match seq {
            Some(seq) if newest > Some(seq) => {
                return Err(self.superseded(seq, newest.unwrap_or(seq)));
            }
            Some(seq) => Some((self.sequencer.enter((id, record.created), seq), seq)),
            None => None,
        };
        Ok(SequencedRequest { record, position })
    }

    /// Stops `work` when a newer request of the same session arrives.
    pub(crate) async fn unless_superseded<T>(
        &self,
        request: &SequencedRequest,
        work: impl Future<Output = Result<T, Problem>>,
    ) -> Result<T, Problem> {
        match &request.position {
            None => work.await,
            Some((position, seq)) => tokio::select! {
                biased;
                () = position.superseded() => Err(self.superseded(*seq, position.newest())),
                // Builds continue: the newer request needs them.
                result = position.builds().during(work) => result,
            },
        }
    }

    fn superseded(&self, seq: u64, newest: u64) -> Problem {
        self.metrics.requests_superseded.inc();
        let detail =
            format!("seq {seq} is lower than {newest}, the highest that this session has seen");
        Problem::new(Code::Superseded, detail)
            .pointer("/seq")
            .actual(seq)
            .extra("newest", newest)
    }

    /// A session with its object. Reading does not extend the session's life.
    /// Errors: Unknown or expired, or too little capacity.
    pub(crate) async fn show(
        self: &Arc<Self>,
        client: Client,
        session: Session,
    ) -> Result<ShownSession, Problem> {
        let text = self.text_of(client, &session.record).await?;
        let quota = self.admission.response_quota(client);
        let bytes = text.response_bytes();
        let held = self
            .admission
            .reserve_aside(|budget| budget.take_for(MemoryClass::Frame, &quota, bytes))
            .await?;
        Ok(SessionText { text, held }.of(session))
    }

    /// The object of a session that was stored with a new revision; its text is kept.
    pub(crate) fn show_new(
        &self,
        client: Client,
        shown: SessionText,
        session: Session,
    ) -> ShownSession {
        let key = revision_key(&session.record);
        self.texts.put(key, client.payer(), &shown.text);
        shown.of(session)
    }

    /// What a session's object says of its revision, from the cache or written now.
    /// Errors: Too little capacity.
    pub(crate) async fn text_of(
        self: &Arc<Self>,
        client: Client,
        record: &Arc<Record>,
    ) -> Result<Arc<CacheEntry<RevisionText>>, Problem> {
        let (sessions, written) = (Arc::clone(self), Arc::clone(record));
        let write = async move {
            let summary = sessions.summary_of(client, &written).await?;
            let key = QueueKey::session(client, written.id);
            let ticket = sessions.admission.upload(key).await?;
            let write = move |cancel: &Cancel| sessions.write_text(&written, summary, cancel);
            ticket.run(write).await?
        };
        let key = revision_key(record);
        let text = self.texts.get(key, client.payer(), write);
        Ok(text.await?.value)
    }

    /// The summary of a session's handles, if it takes the mask of an image to make it.
    /// Errors: Too little capacity; the files of the mask are gone.
    pub(crate) async fn summary_of(
        &self,
        client: Client,
        record: &Arc<Record>,
    ) -> Result<Option<RestSummary>, Problem> {
        if !record.rest.needs_mask() {
            return Ok(None);
        }
        let setup = self.plans.setup_of(client, record).await?;
        Ok(Some(RestSummary::of(&setup)))
    }

    /// Writes the text of a new revision, and takes the memory of a response with it. `summary`:
    /// that of its setup, if there is one. Runs on the pool. Errors: Too little memory, cancelled.
    pub(crate) fn write_new(
        &self,
        client: Client,
        record: &Record,
        summary: Option<RestSummary>,
        cancel: &Cancel,
    ) -> Result<SessionText, Problem> {
        let text = Arc::new(self.write_text(record, summary, cancel)?);
        let held = self.admission.reserve_for(
            MemoryClass::Frame,
            &self.admission.response_quota(client),
            text.response_bytes(),
        )?;
        Ok(SessionText { text, held })
    }

    /// Writes the text of a revision into memory that is reserved before.
    fn write_text(
        &self,
        record: &Record,
        summary: Option<RestSummary>,
        cancel: &Cancel,
    ) -> Result<CacheEntry<RevisionText>, Problem> {
        let length = longest_text(record);
        // The handles in px, and a few copies of their positions.
        let mut held = self
            .admission
            .reserve(MemoryClass::Plan, length + 256 * columns(record))?;
        let new = || {
            RestSummary::new(&record.rest, record.extent, &self.limits, &|| {
                cancel.is_cancelled()
            })
        };
        let summary = summary.map_or_else(new, Ok)?;
        let text = revision_text(record, summary, length, cancel)?;
        held.shrink_to(text.bytes());
        Ok(CacheEntry::new(text, held))
    }

    /// Deletes expired sessions periodically until the application is dropped. Needs a runtime.
    pub fn spawn_sweeper(&self) {
        let (store, counted) = (Arc::downgrade(&self.store), self.counted.clone());
        let pause = (counted.idle() / 4).clamp(Duration::from_millis(50), Duration::from_secs(30));
        tokio::spawn(async move {
            loop {
                tokio::time::sleep(pause).await;
                let Some(store) = store.upgrade() else { return };
                in_pieces(|| counted.sweep()).await;
                match store.sweep().await {
                    Ok(0) => {}
                    Ok(sessions) => tracing::debug!(sessions, "sessions expired"),
                    Err(error) => tracing::warn!(%error, "the store was not swept"),
                }
            }
        });
    }
}
