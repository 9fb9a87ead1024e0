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

use mlswarp::warp::Digest;

use crate::client::Tenant;
use crate::limits::client_limit::ClientLimit;
use crate::problem::{Code, Problem};
use crate::session::SessionId;
use crate::store::{NamedFile, Record, StoreLimits, record_bytes};

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

#[derive(Debug, Default)]
struct Counted {
    sessions: HashMap<SessionId, CountedSession>,
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
        self.sessions.insert(id, session);
    }

    fn remove(&mut self, id: SessionId) -> Option<CountedSession> {
        let session = self.sessions.remove(&id)?;
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

    fn sweep(&mut self, idle: Duration) {
        let expired: Vec<SessionId> = self
            .sessions
            .iter()
            .filter(|(_, session)| session.used.elapsed() >= idle)
            .map(|(id, _)| *id)
            .collect();
        for id in expired {
            self.remove(id);
        }
    }

    /// Undoes a claim, unless another claim has followed, which then says what is stored.
    fn restore(&mut self, Claim { id, number, before }: Claim) {
        if self
            .sessions
            .get(&id)
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
        let shared = Arc::into_inner(self.0).expect("nobody else has it yet");
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
            counted.sweep(self.0.idle);
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
            .get_mut(&claim.id)
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
                .get(&claim.id)
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
        self.lock().sessions.get(&id).map(|session| session.claim)
    }

    /// The session with this claim has ended. A session that has been stored since with the same
    /// id, or is being stored, stays counted.
    pub fn ended(&self, id: SessionId, claim: Option<u64>) {
        let mut counted = self.lock();
        if counted
            .sessions
            .get(&id)
            .is_some_and(|session| Some(session.claim) == claim && !session.is_pending)
        {
            counted.remove(id);
        }
    }

    /// Removes expired sessions.
    pub fn sweep(&self) {
        self.lock().sweep(self.0.idle);
    }
}

#[cfg(test)]
mod tests {
    use std::collections::BTreeMap;
    use std::net::IpAddr;
    use std::time::SystemTime;

    use super::*;
    use crate::client::Client;
    use crate::layer::{LayerKind, LayerName};
    use crate::session::Revision;
    use crate::store::StoredLayer;
    use mlswarp::pixmap::Extent;
    use mlswarp::warp::{Folds, OutputSpec, RestSpec};

    const FILE: u64 = 1000;

    /// The picture's file of a record, with that many bytes.
    fn file(record: &Record, len: u64) -> [NamedFile; 1] {
        [NamedFile {
            digest: record.image,
            bytes: vec![0; usize::try_from(len).unwrap()].into(),
        }]
    }

    fn tenant(n: u8) -> Tenant {
        Client {
            address: IpAddr::from([192, 0, 2, n]),
            ..Client::default()
        }
        .tenant()
    }

    /// The session of that number, on a picture of its own.
    fn record(n: u8) -> Record {
        Record {
            id: SessionId::from_bytes(&[[0; 16], [n; 16]].concat().try_into().unwrap()),
            revision: Revision::random(),
            image: Digest([n; 32]),
            layers: BTreeMap::new(),
            made_with_region: None,
            extent: Extent::new(8, 8).unwrap(),
            rest: RestSpec::default(),
            pose: None,
            folds: Folds::default(),
            output: OutputSpec::default(),
            created: SystemTime::UNIX_EPOCH,
        }
    }

    fn client_sessions(idle: Duration, sessions: usize, bytes: u64) -> ClientSessions {
        ClientSessions::new(
            StoreLimits {
                idle,
                sessions,
                bytes,
            },
            |total| (total / 2).into(),
        )
    }

    fn sum(client_sessions: &ClientSessions, n: u8) -> (u64, u64) {
        client_sessions
            .lock()
            .totals
            .get(&tenant(n))
            .map_or((0, 0), |sum| (sum.sessions, sum.bytes))
    }

    /// The session was stored, and is gone.
    fn end(client_sessions: &ClientSessions, id: SessionId) {
        let stored = |kept: &mut CountedSession| {
            kept.is_pending = false;
            kept.claim
        };
        let claim = client_sessions.lock().sessions.get_mut(&id).map(stored);
        client_sessions.ended(id, claim);
    }

    #[test]
    fn a_client_keeps_its_part_and_another_client_keeps_as_much() {
        let held = client_sessions(Duration::from_secs(60), 4, 1 << 20);
        let records: Vec<_> = (1..6).map(record).collect();
        held.claim(tenant(1), &records[0], &file(&records[0], FILE))
            .unwrap();
        held.claim(tenant(1), &records[1], &file(&records[1], FILE))
            .unwrap();
        let refused = held
            .claim(tenant(1), &records[2], &file(&records[2], FILE))
            .unwrap_err();
        assert_eq!(
            (refused.code, refused.what, refused.retry_after),
            (
                Code::RateLimited,
                Some("client_sessions"),
                Some(RETRY_SECONDS)
            )
        );
        held.claim(tenant(2), &records[3], &file(&records[3], FILE))
            .unwrap();
        // The same name again is the same session, also with another picture.
        let other = Record {
            image: records[4].image,
            ..records[0].clone()
        };
        held.claim(tenant(1), &other, &file(&other, 2 * FILE))
            .unwrap();
        let each = record_bytes(&records[0]);
        assert_eq!(
            (sum(&held, 1), sum(&held, 2)),
            ((2, 3 * FILE + 2 * each), (1, FILE + each))
        );
        end(&held, records[1].id);
        held.claim(tenant(1), &records[2], &file(&records[2], FILE))
            .unwrap();
        // Of another address now: it counts there.
        held.claim(tenant(2), &records[2], &file(&records[2], FILE))
            .unwrap();
        assert_eq!((sum(&held, 1).0, sum(&held, 2).0), (1, 2));
        records.iter().for_each(|ended| end(&held, ended.id));
        assert!(held.lock().totals.is_empty() && held.lock().sessions.is_empty());
    }

    #[test]
    fn bytes_are_counted_once_a_file_and_with_their_records() {
        let record = |n: u8| Record {
            image: Digest([9; 32]),
            ..record(n)
        };
        let each = record_bytes(&record(0));
        let held = client_sessions(Duration::from_secs(60), 1000, 2 * (FILE + 3 * each));
        for n in 0..3 {
            held.claim(tenant(1), &record(n), &file(&record(n), FILE))
                .unwrap();
        }
        let refused = held
            .claim(tenant(1), &record(3), &file(&record(3), FILE))
            .unwrap_err();
        assert_eq!(
            (refused.what, refused.limit, refused.actual),
            (
                Some("client_store_bytes"),
                Some((FILE + 3 * each).into()),
                Some((FILE + 4 * each).into())
            )
        );
        let mut larger = record(0);
        larger.rest.weights = Some(vec![1.0; 100]);
        assert_eq!(
            held.claim_revision(tenant(1), &larger, None)
                .unwrap_err()
                .what,
            Some("client_store_bytes")
        );
        assert_eq!(sum(&held, 1), (3, FILE + 3 * each));
        end(&held, record(1).id);
        end(&held, record(2).id);
        held.claim_revision(tenant(1), &larger, None).unwrap();
        assert_eq!(sum(&held, 1), (1, FILE + each + 800));
        // Made by another process: nobody here keeps it.
        held.claim_revision(tenant(1), &record(7), None).unwrap();
        assert_eq!(held.lock().sessions.len(), 1);
    }

    #[test]
    fn a_visitor_stores_a_part_of_what_its_key_may() {
        let (owner, name) = (crate::client::Owner::from_bytes([1; 16]), [7; 16]);
        let (visitor, key) = (Tenant::Visitor(owner, name), Tenant::Key(owner));
        let one = record(1);
        let limit = 2 * FILE + record_bytes(&one);
        let held = client_sessions(Duration::from_secs(60), 100, 1 << 20).with_visitors(limit);
        let refused = held
            .claim(visitor, &one, &file(&one, 2 * FILE + 1))
            .unwrap_err();
        assert_eq!(
            (refused.what, refused.limit, refused.actual),
            (
                Some("visitor_store_bytes"),
                Some(limit.into()),
                Some((limit + 1).into())
            )
        );
        // The key itself may, and what a visitor stores counts for it.
        held.claim(key, &one, &file(&one, 2 * FILE + 1)).unwrap();
        held.claim(visitor, &one, &file(&one, FILE)).unwrap();
        let total = held.lock().totals[&key].bytes;
        assert_eq!(total, FILE + record_bytes(&one));
        assert!(held.claim_revision(visitor, &one, None).is_ok());
    }

    #[test]
    fn layers_count_with_their_session() {
        let held = client_sessions(Duration::from_secs(60), 100, 1 << 20);
        let plain = record(1);
        held.claim(tenant(1), &plain, &file(&plain, FILE)).unwrap();
        let layer = |n: u8| NamedFile {
            digest: Digest([n; 32]),
            bytes: vec![0; 300].into(),
        };
        let with = |names: &[(&str, u8)]| {
            let stored = |n: u8| StoredLayer {
                kind: LayerKind::Image,
                digest: layer(n).digest,
            };
            let layers = names
                .iter()
                .map(|(name, n)| (LayerName::parse(name).unwrap(), stored(*n)))
                .collect();
            Record {
                layers,
                ..plain.clone()
            }
        };
        let bytes = |record: &Record, files: u64| (1, record_bytes(record) + FILE + files);
        let (one, two) = (with(&[("a", 2)]), with(&[("a", 2), ("b", 2)]));
        held.claim_revision(tenant(1), &one, Some(&layer(2)))
            .unwrap();
        assert_eq!(sum(&held, 1), bytes(&one, 300));
        held.claim_revision(tenant(1), &two, Some(&layer(2)))
            .unwrap();
        assert_eq!(sum(&held, 1), bytes(&two, 300), "one file of two names");
        // The session's `PUT` again: the layers stay.
        let again = held.claim(tenant(1), &plain, &file(&plain, FILE)).unwrap();
        held.confirm_same(&again);
        assert_eq!(sum(&held, 1), bytes(&two, 300));
        let other = with(&[("a", 3), ("b", 2)]);
        held.undo(
            held.claim_revision(tenant(1), &other, Some(&layer(3)))
                .unwrap(),
        );
        assert_eq!(sum(&held, 1), bytes(&two, 300));
        held.claim_revision(tenant(1), &other, Some(&layer(3)))
            .unwrap();
        assert_eq!(sum(&held, 1), bytes(&other, 600));
        held.claim_revision(tenant(1), &plain, None).unwrap();
        assert_eq!(sum(&held, 1), bytes(&plain, 0));
    }

    #[test]
    fn a_session_that_is_being_stored_is_ended_by_nobody() {
        let held = client_sessions(Duration::from_secs(60), 100, 1 << 20);
        let record = record(1);
        let end = |claim| held.ended(record.id, claim);
        let first = held
            .claim(tenant(1), &record, &file(&record, FILE))
            .unwrap();
        end(held.claim_of(record.id));
        assert_eq!(sum(&held, 1).0, 1, "it is pending");
        held.confirm(&first);
        let before = held.claim_of(record.id);
        // A delete is under way, and the same name is stored again before it is counted.
        let second = held
            .claim(tenant(1), &record, &file(&record, FILE))
            .unwrap();
        held.confirm(&second);
        end(before);
        assert_eq!(sum(&held, 1).0, 1, "it was stored since");
        end(held.claim_of(record.id));
        assert_eq!(sum(&held, 1), (0, 0));
    }

    #[test]
    fn what_was_not_stored_is_not_counted() {
        let held = client_sessions(Duration::from_secs(60), 100, 1 << 20);
        let (a, b) = (record(1), record(2));
        let other = Record {
            image: b.image,
            ..a.clone()
        };
        held.undo(held.claim(tenant(1), &a, &file(&a, FILE)).unwrap());
        assert_eq!(sum(&held, 1), (0, 0));
        held.claim(tenant(1), &a, &file(&a, FILE)).unwrap();
        let before = sum(&held, 1);
        held.undo(
            held.claim(tenant(1), &other, &file(&other, 2 * FILE))
                .unwrap(),
        );
        assert_eq!(sum(&held, 1), before);
        // The first of two fails when the second is there already.
        let first = held
            .claim(tenant(1), &other, &file(&other, 2 * FILE))
            .unwrap();
        held.claim(tenant(1), &a, &file(&a, 3 * FILE)).unwrap();
        held.undo(first);
        assert_eq!(sum(&held, 1), (1, 3 * FILE + record_bytes(&a)));
    }

    #[test]
    fn an_expired_session_makes_room_and_a_used_one_does_not() {
        let idle = Duration::from_secs(60);
        let held = client_sessions(idle, 2, 1 << 20);
        let unused = |n: u8| held.lock().sessions.get_mut(&record(n).id).unwrap().used -= idle;
        held.claim(tenant(1), &record(1), &file(&record(1), FILE))
            .unwrap();
        unused(1);
        held.used(record(1).id);
        assert!(
            held.claim(tenant(1), &record(2), &file(&record(2), FILE))
                .is_err()
        );
        unused(1);
        held.claim(tenant(1), &record(3), &file(&record(3), FILE))
            .unwrap();
        assert_eq!(sum(&held, 1).0, 1);
        unused(3);
        held.sweep();
        assert!(held.lock().totals.is_empty());
    }
}
