//! How many sessions each client keeps, and how many bytes of their files and records: what a store holds of a session cannot be taken
//! back before it ends, so each client has a limit below the store's.
//!
//! Counted are the sessions that were made through this process since it started, for the client that made them last. Nothing of this is
//! stored: an address is written nowhere. What other replicas make, and what a store kept from before a restart, is bounded by the
//! store's own limits alone. A session ends here when it is deleted or found to be gone, and otherwise when it has not been used through
//! this process for one idle period.

use std::collections::HashMap;
use std::sync::{Arc, Mutex, MutexGuard, PoisonError};
use std::time::{Duration, Instant};

use mlswarp::warp::Digest;

use crate::client::Tenant;
use crate::problem::{Code, Problem};
use crate::session::SessionId;
use crate::store::{Bounds, Record, record_bytes};

/// Seconds after which a client that keeps too much may try again.
const RETRY: u32 = 30;

/// What every client keeps. Cloning shares it.
#[derive(Clone, Debug)]
pub struct Holdings(Arc<HoldingsState>);

#[derive(Debug)]
struct HoldingsState {
    idle: Duration,
    sessions: u64,
    bytes: u64,
    held: Mutex<Held>,
}

#[derive(Debug, Default)]
struct Held {
    sessions: HashMap<SessionId, Holding>,
    clients: HashMap<Tenant, Sum>,
    claims: u64,
}

/// A session.
#[derive(Clone, Copy, Debug)]
struct Holding {
    tenant: Tenant,
    image: Digest,
    file: u64,
    record: u64,
    used: Instant,
    /// By which claim it came to be as it is.
    claim: u64,
    /// The store has not answered yet: nobody but the claim itself can end it.
    is_pending: bool,
}

/// What one client keeps.
#[derive(Debug, Default)]
struct Sum {
    sessions: u64,
    bytes: u64,
    /// Sessions by their picture's file, which a client keeps once.
    files: HashMap<Digest, usize>,
}

/// A session that is being stored, and is counted already.
#[derive(Debug)]
pub struct Claim {
    id: SessionId,
    claim: u64,
    before: Option<Holding>,
}

impl Held {
    fn add(&mut self, id: SessionId, kept: Holding) {
        let sum = self.clients.entry(kept.tenant).or_default();
        let files = sum.files.entry(kept.image).or_default();
        *files += 1;
        sum.sessions += 1;
        sum.bytes += kept.record + if *files == 1 { kept.file } else { 0 };
        self.sessions.insert(id, kept);
    }

    fn remove(&mut self, id: SessionId) -> Option<Holding> {
        let kept = self.sessions.remove(&id)?;
        if let Some(sum) = self.clients.get_mut(&kept.tenant) {
            sum.sessions -= 1;
            sum.bytes -= kept.record;
            if let Some(files) = sum.files.get_mut(&kept.image) {
                *files -= 1;
                if *files == 0 {
                    sum.files.remove(&kept.image);
                    sum.bytes -= kept.file;
                }
            }
            if sum.sessions == 0 {
                self.clients.remove(&kept.tenant);
            }
        }
        Some(kept)
    }

    fn sweep(&mut self, idle: Duration) {
        let over: Vec<SessionId> = self.sessions.iter().filter(|(_, kept)| kept.used.elapsed() >= idle).map(|(id, _)| *id).collect();
        for id in over {
            self.remove(id);
        }
    }
}

impl Holdings {
    /// Of a store of these bounds; `of_client` says how much of each one client may have.
    #[must_use]
    pub fn new(bounds: Bounds, of_client: impl Fn(u64) -> u64) -> Self {
        let (sessions, bytes) = (of_client(bounds.sessions as u64), of_client(bounds.bytes));
        Self(Arc::new(HoldingsState { idle: bounds.idle, sessions, bytes, held: Mutex::default() }))
    }

    fn lock(&self) -> MutexGuard<'_, Held> {
        // Nothing panics half-way through a change.
        self.0.held.lock().unwrap_or_else(PoisonError::into_inner)
    }

    /// Counts a session that is about to be stored, in the place of the one of that name.
    ///
    /// # Errors
    /// [`Code::RateLimited`]: the client keeps as much as it may.
    pub fn claim(&self, tenant: Tenant, record: &Record, file: u64) -> Result<Claim, Problem> {
        let used = Instant::now();
        self.change(record.id, |_| {
            Some(Holding { tenant, image: record.image, file, record: record_bytes(record), used, claim: 0, is_pending: true })
        })
    }

    /// Counts a record that is about to take the place of another one of its session.
    ///
    /// # Errors
    /// As [`Holdings::claim`].
    pub fn claim_revision(&self, record: &Record) -> Result<Claim, Problem> {
        self.change(record.id, |before| before.map(|before| Holding { record: record_bytes(record), ..before }))
    }

    fn change(&self, id: SessionId, to: impl Fn(Option<Holding>) -> Option<Holding>) -> Result<Claim, Problem> {
        let mut held = self.lock();
        let first = self.try_change(&mut held, id, &to);
        if first.is_err() {
            held.sweep(self.0.idle);
            return self.try_change(&mut held, id, &to);
        }
        first
    }

    fn try_change(&self, held: &mut Held, id: SessionId, to: impl Fn(Option<Holding>) -> Option<Holding>) -> Result<Claim, Problem> {
        held.claims += 1;
        let claim = held.claims;
        let before = held.remove(id);
        let Some(kept) = to(before) else { return Ok(Claim { id, claim, before }) };
        held.add(id, Holding { claim, is_pending: true, ..kept });
        let sum = &held.clients[&kept.tenant];
        let limits =
            [("client_sessions", "sessions", self.0.sessions, sum.sessions), ("client_store_bytes", "bytes", self.0.bytes, sum.bytes)];
        let Some((what, unit, limit, actual)) = limits.into_iter().find(|(.., limit, actual)| actual > limit) else {
            return Ok(Claim { id, claim, before });
        };
        Self::restore(held, &Claim { id, claim, before });
        let detail =
            format!("this client would keep {actual} {unit} in the session store; at most {limit}. Delete sessions, or let them expire");
        Err(Problem::new(Code::RateLimited, detail).limit(what, limit, actual).retry_after(RETRY))
    }

    /// What was claimed is stored.
    pub fn settle(&self, claim: &Claim) {
        if let Some(kept) = self.lock().sessions.get_mut(&claim.id).filter(|kept| kept.claim == claim.claim) {
            kept.is_pending = false;
        }
    }

    /// What was claimed was not stored.
    pub fn undo(&self, claim: Claim) {
        Self::restore(&mut self.lock(), &claim);
    }

    fn restore(held: &mut Held, Claim { id, claim, before }: &Claim) {
        // Another claim may have followed: then that one says what is stored.
        if held.sessions.get(id).is_some_and(|kept| kept.claim == *claim) {
            held.remove(*id);
            if let Some(before) = *before {
                held.add(*id, before);
            }
        }
    }

    /// The session was used.
    pub fn used(&self, id: SessionId) {
        if let Some(kept) = self.lock().sessions.get_mut(&id) {
            kept.used = Instant::now();
        }
    }

    /// By which claim the session is counted, if it is: [`Holdings::ended`] takes it.
    #[must_use]
    pub fn claim_of(&self, id: SessionId) -> Option<u64> {
        self.lock().sessions.get(&id).map(|kept| kept.claim)
    }

    /// The session that was counted by `claim` when the store was asked is gone. One that has been stored since under the same name, or is being
    /// stored, stays counted.
    pub fn ended(&self, id: SessionId, claim: Option<u64>) {
        let mut held = self.lock();
        if held.sessions.get(&id).is_some_and(|kept| Some(kept.claim) == claim && !kept.is_pending) {
            held.remove(id);
        }
    }

    /// Forgets sessions that have expired.
    pub fn sweep(&self) {
        self.lock().sweep(self.0.idle);
    }
}

#[cfg(test)]
mod tests {
    use std::net::IpAddr;
    use std::time::SystemTime;

    use super::*;
    use crate::client::Client;
    use crate::session::Revision;
    use mlswarp::pixmap::Extent;
    use mlswarp::warp::{Folds, OutputSpec, RestSpec};

    const FILE: u64 = 1000;

    fn tenant(n: u8) -> Tenant {
        Client { address: IpAddr::from([192, 0, 2, n]), ..Client::default() }.tenant()
    }

    /// The session of that number, on a picture of its own.
    fn record(n: u8) -> Record {
        Record {
            id: SessionId::from_bytes(&[[0; 16], [n; 16]].concat().try_into().unwrap()),
            revision: Revision::random(),
            image: Digest([n; 32]),
            extent: Extent::new(8, 8).unwrap(),
            rest: RestSpec::default(),
            folds: Folds::default(),
            output: OutputSpec::default(),
            created: SystemTime::UNIX_EPOCH,
        }
    }

    fn holdings(idle: Duration, sessions: usize, bytes: u64) -> Holdings {
        Holdings::new(Bounds { idle, sessions, bytes }, |total| total / 2)
    }

    fn sum(holdings: &Holdings, n: u8) -> (u64, u64) {
        holdings.lock().clients.get(&tenant(n)).map_or((0, 0), |sum| (sum.sessions, sum.bytes))
    }

    /// The session was stored, and is gone.
    fn end(holdings: &Holdings, id: SessionId) {
        let stored = |kept: &mut Holding| {
            kept.is_pending = false;
            kept.claim
        };
        let claim = holdings.lock().sessions.get_mut(&id).map(stored);
        holdings.ended(id, claim);
    }

    #[test]
    fn a_client_keeps_its_part_and_another_client_keeps_as_much() {
        let held = holdings(Duration::from_secs(60), 4, 1 << 20);
        let records: Vec<_> = (1..6).map(record).collect();
        held.claim(tenant(1), &records[0], FILE).unwrap();
        held.claim(tenant(1), &records[1], FILE).unwrap();
        let refused = held.claim(tenant(1), &records[2], FILE).unwrap_err();
        assert_eq!((refused.code, refused.what, refused.retry_after), (Code::RateLimited, Some("client_sessions"), Some(RETRY)));
        held.claim(tenant(2), &records[3], FILE).unwrap();
        // The same name again is the same session, also with another picture.
        held.claim(tenant(1), &Record { image: records[4].image, ..records[0].clone() }, 2 * FILE).unwrap();
        let each = record_bytes(&records[0]);
        assert_eq!((sum(&held, 1), sum(&held, 2)), ((2, 3 * FILE + 2 * each), (1, FILE + each)));
        end(&held, records[1].id);
        held.claim(tenant(1), &records[2], FILE).unwrap();
        // Of another address now: it counts there.
        held.claim(tenant(2), &records[2], FILE).unwrap();
        assert_eq!((sum(&held, 1).0, sum(&held, 2).0), (1, 2));
        records.iter().for_each(|ended| end(&held, ended.id));
        assert!(held.lock().clients.is_empty() && held.lock().sessions.is_empty());
    }

    #[test]
    fn bytes_are_counted_once_a_file_and_with_their_records() {
        let record = |n: u8| Record { image: Digest([9; 32]), ..record(n) };
        let each = record_bytes(&record(0));
        let held = holdings(Duration::from_secs(60), 1000, 2 * (FILE + 3 * each));
        for n in 0..3 {
            held.claim(tenant(1), &record(n), FILE).unwrap();
        }
        let refused = held.claim(tenant(1), &record(3), FILE).unwrap_err();
        assert_eq!(
            (refused.what, refused.limit, refused.actual),
            (Some("client_store_bytes"), Some((FILE + 3 * each).into()), Some((FILE + 4 * each).into()))
        );
        let mut larger = record(0);
        larger.rest.weights = Some(vec![1.0; 100]);
        assert_eq!(held.claim_revision(&larger).unwrap_err().what, Some("client_store_bytes"));
        assert_eq!(sum(&held, 1), (3, FILE + 3 * each));
        end(&held, record(1).id);
        end(&held, record(2).id);
        held.claim_revision(&larger).unwrap();
        assert_eq!(sum(&held, 1), (1, FILE + each + 800));
        // Made by another process: nobody here keeps it.
        held.claim_revision(&record(7)).unwrap();
        assert_eq!(held.lock().sessions.len(), 1);
    }

    #[test]
    fn a_session_that_is_being_stored_is_ended_by_nobody() {
        let held = holdings(Duration::from_secs(60), 100, 1 << 20);
        let record = record(1);
        let end = |claim| held.ended(record.id, claim);
        let first = held.claim(tenant(1), &record, FILE).unwrap();
        end(held.claim_of(record.id));
        assert_eq!(sum(&held, 1).0, 1, "it is pending");
        held.settle(&first);
        let before = held.claim_of(record.id);
        // A delete is under way, and the same name is stored again before it is counted.
        let second = held.claim(tenant(1), &record, FILE).unwrap();
        held.settle(&second);
        end(before);
        assert_eq!(sum(&held, 1).0, 1, "it was stored since");
        end(held.claim_of(record.id));
        assert_eq!(sum(&held, 1), (0, 0));
    }

    #[test]
    fn what_was_not_stored_is_not_counted() {
        let held = holdings(Duration::from_secs(60), 100, 1 << 20);
        let (a, b) = (record(1), record(2));
        let other = Record { image: b.image, ..a.clone() };
        held.undo(held.claim(tenant(1), &a, FILE).unwrap());
        assert_eq!(sum(&held, 1), (0, 0));
        held.claim(tenant(1), &a, FILE).unwrap();
        let before = sum(&held, 1);
        held.undo(held.claim(tenant(1), &other, 2 * FILE).unwrap());
        assert_eq!(sum(&held, 1), before);
        // The first of two fails when the second is there already.
        let first = held.claim(tenant(1), &other, 2 * FILE).unwrap();
        held.claim(tenant(1), &a, 3 * FILE).unwrap();
        held.undo(first);
        assert_eq!(sum(&held, 1), (1, 3 * FILE + record_bytes(&a)));
    }

    #[test]
    fn an_expired_session_makes_room_and_a_used_one_does_not() {
        let idle = Duration::from_secs(60);
        let held = holdings(idle, 2, 1 << 20);
        let unused = |n: u8| held.lock().sessions.get_mut(&record(n).id).unwrap().used -= idle;
        held.claim(tenant(1), &record(1), FILE).unwrap();
        unused(1);
        held.used(record(1).id);
        assert!(held.claim(tenant(1), &record(2), FILE).is_err());
        unused(1);
        held.claim(tenant(1), &record(3), FILE).unwrap();
        assert_eq!(sum(&held, 1).0, 1);
        unused(3);
        held.sweep();
        assert!(held.lock().clients.is_empty());
    }
}
