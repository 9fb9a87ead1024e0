//! The number of sessions of each client, and the bytes of their files and records. What a store
//! holds for a session cannot be reclaimed before the session ends, so each client has limits below
//! those of the store.
//!
//! Only sessions that were stored through this process since its start are counted, for the client
//! that stored them last; nothing of this is stored. Sessions of other replicas, and those from
//! before a restart, are limited by the store's own limits. A session ends here when it is deleted
//! or found to be gone, or when this process has not used it for one idle period.

use std::collections::HashMap;
use std::sync::{Arc, Mutex, MutexGuard, PoisonError};
use std::time::{Duration, Instant};

use lru::LruCache;
use mlswarp::warp::Digest;

use crate::client::Tenant;
use crate::limits::client_limit::ClientLimit;
use crate::problem::{Code, Problem};
use crate::session::SessionId;
use crate::store::{NamedFile, Record, SWEPT_AT_ONCE, StoreLimits, record_bytes};

/// Seconds after which a rejected client may retry.
const RETRY_SECONDS: u32 = 30;

/// The sessions of all clients. Clones share them.
#[derive(Clone, Debug)]
pub struct ClientSessions(Arc<Shared>);

#[derive(Debug)]
struct Shared {
    idle: Duration,
    max_sessions: ClientLimit,
    max_bytes: ClientLimit,
    /// Bytes of one visitor, which has one session.
    max_visitor_bytes: u64,
    counted: Mutex<Counted>,
}

#[derive(Debug)]
struct Counted {
    /// In the order in which they were used: those that expire first are at the end.
    sessions: LruCache<SessionId, CountedSession>,
    totals: HashMap<Tenant, Total>,
    claims: u64,
}

#[derive(Clone, Debug)]
struct CountedSession {
    tenant: Tenant,
    /// The files that it names, with their sizes.
    files: Vec<(Digest, u64)>,
    record: u64,
    used: Instant,
    /// The number of the claim that counted it.
    claim: u64,
    /// The store has not answered yet: only the claim itself can end the session.
    is_pending: bool,
}

/// The total of one client.
#[derive(Debug, Default)]
struct Total {
    sessions: u64,
    bytes: u64,
    /// How often sessions name each file; it is stored once per client.
    files: HashMap<Digest, usize>,
}

/// A session that is counted before it is stored.
#[derive(Debug)]
pub struct Claim {
    id: SessionId,
    number: u64,
    before: Option<CountedSession>,
}

fn sized(file: &NamedFile) -> (Digest, u64) {
    (file.digest, file.bytes.len() as u64)
}

impl Default for Counted {
    fn default() -> Self {
        Self {
            sessions: LruCache::unbounded(),
            totals: HashMap::default(),
            claims: 0,
        }
    }
}

impl Counted {
    fn add(&mut self, id: SessionId, session: CountedSession) {
        let total = self.totals.entry(session.tenant).or_default();
        total.sessions += 1;
        total.bytes += session.record;
        for (digest, len) in &session.files {
            let names = total.files.entry(*digest).or_default();
            *names += 1;
            total.bytes += if *names == 1 { *len } else { 0 };
        }
        self.sessions.put(id, session);
    }

    fn remove(&mut self, id: SessionId) -> Option<CountedSession> {
        let session = self.sessions.pop(&id)?;
        if let Some(total) = self.totals.get_mut(&session.tenant) {
            total.sessions -= 1;
            total.bytes -= session.record;
            for (digest, len) in &session.files {
                let Some(names) = total.files.get_mut(digest) else {
                    continue;
                };
                *names -= 1;
                if *names == 0 {
                    total.files.remove(digest);
                    total.bytes -= *len;
                }
            }
            if total.sessions == 0 {
                self.totals.remove(&session.tenant);
            }
        }
        Some(session)
    }

    /// Removes at most `most` expired sessions; returns their number.
    fn sweep(&mut self, idle: Duration, most: usize) -> usize {
        // One that a claim has put back lies before others that were used later: it waits for them.
        let is_over = |(_, session): (&SessionId, &CountedSession)| session.used.elapsed() >= idle;
        let oldest = |sessions: &LruCache<_, _>| {
            let oldest = sessions.peek_lru().filter(|oldest| is_over(*oldest));
            oldest.map(|(id, _)| *id)
        };
        let mut swept = 0;
        while swept < most
            && let Some(id) = oldest(&self.sessions)
        {
            self.remove(id);
            swept += 1;
        }
        swept
    }

    /// Undoes a claim, unless another claim has followed, which then says what is stored.
    fn restore(&mut self, Claim { id, number, before }: Claim) {
        if self
            .sessions
            .peek(&id)
            .is_some_and(|session| session.claim == number)
        {
            self.remove(id);
            if let Some(before) = before {
                self.add(id, before);
            }
        }
    }
}

impl ClientSessions {
    /// The sessions in a store with these bounds; `of_client` gives one client's share of a total.
    pub fn new(bounds: StoreLimits, of_client: impl Fn(u64) -> ClientLimit) -> Self {
        let (max_sessions, max_bytes) =
            (of_client(bounds.sessions as u64), of_client(bounds.bytes));
        Self(Arc::new(Shared {
            idle: bounds.idle,
            max_sessions,
            max_bytes,
            max_visitor_bytes: u64::MAX,
            counted: Mutex::default(),
        }))
    }

    /// The time without use after which a session expires.
    pub(crate) fn idle(&self) -> Duration {
        self.0.idle
    }

    /// With a limit on the bytes that one visitor stores.
    pub fn with_visitors(self, bytes: u64) -> Self {
        let shared = Arc::into_inner(self.0).expect("it is not shared yet");
        Self(Arc::new(Shared {
            max_visitor_bytes: bytes,
            ..shared
        }))
    }

    fn lock(&self) -> MutexGuard<'_, Counted> {
        // No change panics half-way.
        self.0
            .counted
            .lock()
            .unwrap_or_else(PoisonError::into_inner)
    }

    /// Counts a session that is about to be stored, instead of the one with the same id; for the
    /// client that answers for the tenant. Errors: [`Code::RateLimited`]: the client has reached a
    /// limit.
    pub fn claim(
        &self,
        tenant: Tenant,
        record: &Record,
        files: &[NamedFile],
    ) -> Result<Claim, Problem> {
        let (files, used) = (files.iter().map(sized).collect::<Vec<_>>(), Instant::now());
        self.change(tenant, record.id, |_| {
            Some(CountedSession {
                tenant: tenant.payer(),
                files: files.clone(),
                record: record_bytes(record),
                used,
                claim: 0,
                is_pending: true,
            })
        })
    }

    /// Counts a record that is about to replace another one of its session. `layer`: the file that
    /// only this one names. Errors: As [`ClientSessions::claim`].
    pub fn claim_revision(
        &self,
        tenant: Tenant,
        record: &Record,
        layer: Option<&NamedFile>,
    ) -> Result<Claim, Problem> {
        self.change(tenant, record.id, |before| {
            let before = before?;
            let known: HashMap<Digest, u64> = before
                .files
                .iter()
                .copied()
                .chain(layer.map(sized))
                .collect();
            let files = record
                .files()
                .filter_map(|digest| Some((digest, *known.get(&digest)?)))
                .collect();
            Some(CountedSession {
                files,
                record: record_bytes(record),
                ..before.clone()
            })
        })
    }

    fn change(
        &self,
        by: Tenant,
        id: SessionId,
        to: impl Fn(Option<&CountedSession>) -> Option<CountedSession>,
    ) -> Result<Claim, Problem> {
        let mut counted = self.lock();
        self.try_change(&mut counted, by, id, &to).or_else(|_| {
            counted.sweep(self.0.idle, usize::MAX);
            self.try_change(&mut counted, by, id, &to)
        })
    }

    fn try_change(
        &self,
        counted: &mut Counted,
        by: Tenant,
        id: SessionId,
        to: impl Fn(Option<&CountedSession>) -> Option<CountedSession>,
    ) -> Result<Claim, Problem> {
        counted.claims += 1;
        let before = counted.remove(id);
        let claim = Claim {
            id,
            number: counted.claims,
            before,
        };
        let Some(session) = to(claim.before.as_ref()) else {
            return Ok(claim);
        };
        let tenant = session.tenant;
        let files: HashMap<Digest, u64> = session.files.iter().copied().collect();
        let own = session.record + files.values().sum::<u64>();
        counted.add(
            id,
            CountedSession {
                claim: claim.number,
                is_pending: true,
                ..session
            },
        );
        let total = &counted.totals[&tenant];
        let limits = [
            (
                "client_sessions",
                "sessions",
                self.0.max_sessions.get(),
                total.sessions,
            ),
            (
                "client_store_bytes",
                "bytes",
                self.0.max_bytes.get(),
                total.bytes,
            ),
            (
                "visitor_store_bytes",
                "bytes",
                if by == by.payer() {
                    u64::MAX
                } else {
                    self.0.max_visitor_bytes
                },
                own,
            ),
        ];
        let Some((what, unit, limit, actual)) = limits
            .into_iter()
            .find(|(.., limit, actual)| actual > limit)
        else {
            return Ok(claim);
        };
        counted.restore(claim);
        let detail = if what == "visitor_store_bytes" {
            format!(
                "this session would have {actual} bytes; the limit of a session token is {limit} \
                    (--max-visitor-share)"
            )
        } else {
            format!(
                "this client would store {actual} {unit}; the limit of one client is {limit} \
                    (--max-client-share). \
                 Delete sessions, or let them expire"
            )
        };
        Err(Problem::new(Code::RateLimited, detail)
            .limit(what, limit, actual)
            .retry_after(RETRY_SECONDS))
    }

    /// The claimed session is stored.
    pub fn confirm(&self, claim: &Claim) {
        if let Some(session) = self
            .lock()
            .sessions
            .peek_mut(&claim.id)
            .filter(|session| session.claim == claim.number)
        {
            session.is_pending = false;
        }
    }

    /// The claimed session had been stored before and stays as it is, with the layers that it has.
    pub fn confirm_same(&self, claim: &Claim) {
        let mut counted = self.lock();
        if let Some(before) = &claim.before
            && counted
                .sessions
                .peek(&claim.id)
                .is_some_and(|session| session.claim == claim.number)
            && let Some(session) = counted.remove(claim.id)
        {
            counted.add(
                claim.id,
                CountedSession {
                    files: before.files.clone(),
                    record: before.record,
                    ..session
                },
            );
        }
        drop(counted);
        self.confirm(claim);
    }

    /// The claimed session was not stored.
    pub fn undo(&self, claim: Claim) {
        self.lock().restore(claim);
    }

    /// The session was used.
    pub fn used(&self, id: SessionId) {
        if let Some(session) = self.lock().sessions.get_mut(&id) {
            session.used = Instant::now();
        }
    }

    /// The number of the claim that counted the session, for [`ClientSessions::ended`].
    pub fn claim_of(&self, id: SessionId) -> Option<u64> {
        self.lock().sessions.peek(&id).map(|session| session.claim)
    }

    /// The session with this claim has ended. A session that has been stored since with the same
    /// id, or is being stored, stays counted.
    pub fn ended(&self, id: SessionId, claim: Option<u64>) {
        let mut counted = self.lock();
        if counted
            .sessions
            .peek(&id)
            .is_some_and(|session| Some(session.claim) == claim && !session.is_pending)
        {
            counted.remove(id);
        }
    }

    /// Removes some expired sessions; returns how many.
    pub(crate) fn sweep(&self) -> usize {
        self.lock().sweep(self.0.idle, SWEPT_AT_ONCE)
    }
}

#[cfg(test)]
mod tests;
