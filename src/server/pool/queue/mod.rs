//! The order of waiting requests: which one gets the next permit, and which one is rejected. It
//! decides at four levels:
//!
//! 1. Between clients ([`Tenant`]): the client that has used the least worker time recently is
//!    next. Worker time is the time for which a client's requests have held permits, including
//!    those that run now; it counts half after each [`usage::HALF_LIFE`]. A client with a few large
//!    requests therefore gets no more of the workers than one with many small ones. A client that
//!    waits alone gets all permits.
//! 2. Below a client, in the same way between its own requests and each of its visitors, who have
//!    tokens for one session.
//! 3. Between the keys of a client or visitor (its sessions, its requests without a session, the
//!    addresses that share a visitor's session): round robin.
//! 4. Within a key: the newest request of a session, because its user wants to see the newest pose;
//!    otherwise the oldest.
//!
//! There is one permit ([`SPARE_PERMITS`]) more than workers, for a client that holds none. A
//! visitor that holds a permit never takes the last one of the workers: that is for a visitor or
//! client that holds none. A long job gives way between parts of its work
//! ([`FairQueue::gives_way`]): it returns its permit when another client that has used less waits
//! for one, and is next when that is no longer so. So what a client holds shrinks while others
//! wait, and long requests of any number of clients delay a short one of another by a part of their
//! work only.
//!
//! A full queue rejects the oldest request of the longest key for a newcomer: of the client with
//! the most waiting requests, or of the newcomer's own client; and there of the visitor with the
//! most, or of the newcomer's own.
//!
//! Times are arguments; there are no clocks and no threads here.

mod usage;

use std::collections::{HashMap, VecDeque};
use std::time::Instant;

use crate::client::{Client, Tenant};
use crate::session::SessionId;
use usage::{Rank, Usage, by_rank, usage_of};

/// Permits beyond the number of workers.
pub(crate) const SPARE_PERMITS: usize = 1;
/// Most jobs that have given way. Each keeps its memory and a sleeping thread.
pub(super) const MOST_PAUSED: usize = 64;

/// Requests with equal keys wait together.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub struct QueueKey {
    tenant: Tenant,
    part: KeyPart,
}

/// The part of a client's requests.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
enum KeyPart {
    /// The address of a visitor: several may share its session.
    Session(SessionId, Option<Tenant>),
    /// Without a session: users who share an API key are told apart by their addresses.
    Address(Tenant),
}

impl QueueKey {
    /// The key of a client's requests for a session.
    pub fn session(client: Client, id: SessionId) -> Self {
        Self {
            tenant: client.tenant(),
            part: KeyPart::Session(id, client.visit.map(|_| Tenant::of_address(client.address))),
        }
    }

    /// The key of a client's requests without a session.
    pub fn client(client: Client) -> Self {
        Self {
            tenant: client.tenant(),
            part: KeyPart::Address(Tenant::of_address(client.address)),
        }
    }

    /// The client that is charged for the request.
    pub(crate) const fn tenant(self) -> Tenant {
        self.tenant
    }

    const fn is_newest_first(self) -> bool {
        matches!(self.part, KeyPart::Session(..))
    }
}

/// The result of an arrival.
#[derive(Debug, PartialEq, Eq)]
pub(crate) enum Arrival<W> {
    /// The request runs.
    Runs,
    /// It waits under this number.
    Waits(u64),
    /// It waits under this number, and this other request is rejected.
    Replaces(u64, W),
    /// It is rejected.
    Rejected,
}

/// Running and waiting requests. `W` wakes a waiting request.
#[derive(Debug)]
pub(crate) struct FairQueue<W> {
    permits: usize,
    max_waiting: usize,
    running: usize,
    waiting: usize,
    waiters: HashMap<QueueKey, VecDeque<(u64, W)>>,
    usage: HashMap<Tenant, Usage>,
    /// The same for clients with all their visitors; their keys are in `usage`.
    payers: HashMap<Tenant, Usage>,
    /// Clients and visitors with waiting requests; the one that got a permit last is the last.
    order: VecDeque<Tenant>,
    /// Jobs that have given way, oldest first: number, client, and what wakes the job.
    paused: Vec<(u64, Tenant, W)>,
    next_id: u64,
}

impl<W> FairQueue<W> {
    /// `permits` requests and [`SPARE_PERMITS`] run at one time; `max_waiting` wait.
    pub(crate) fn new(permits: usize, max_waiting: usize) -> Self {
        let (waiters, usage, payers) = (HashMap::new(), HashMap::new(), HashMap::new());
        Self {
            permits,
            max_waiting,
            running: 0,
            waiting: 0,
            waiters,
            usage,
            payers,
            order: VecDeque::new(),
            paused: Vec::new(),
            next_id: 0,
        }
    }

    pub(crate) const fn waiting(&self) -> usize {
        self.waiting
    }

    pub(crate) const fn running(&self) -> usize {
        self.running
    }

    /// The number of jobs that have given way.
    pub(crate) const fn paused(&self) -> usize {
        self.paused.len()
    }

    /// Whether a client without requests here would be rejected.
    pub(crate) fn is_full(&self) -> bool {
        self.rejects(QueueKey::client(Client::default()))
    }

    /// Whether a request with this key would be rejected.
    pub(crate) fn rejects(&self, key: QueueKey) -> bool {
        !self.may_run(key.tenant) && self.waiting >= self.max_waiting && self.victim(key).is_none()
    }

    /// The key that loses a request when the queue is full and a request with `key` arrives.
    fn victim(&self, key: QueueKey) -> Option<QueueKey> {
        let waiting = |of: &HashMap<Tenant, Usage>, tenant: Tenant| {
            of.get(&tenant).map_or(0, |usage| usage.waiting)
        };
        let of_payer = |tenant: &Tenant| waiting(&self.payers, tenant.payer());
        let own = |tenant: &Tenant| waiting(&self.usage, *tenant);
        // The client with the most requests in the queue gives up a place to one that has few. If
        // it has only one more than the newcomer, the exchange would gain nothing.
        let most = self.order.iter().map(of_payer).max().unwrap_or(0);
        if most > of_payer(&key.tenant) + 1 {
            // Among equals, the client that got a permit last.
            let mut last = self.order.iter().rev();
            let payer = last.find(|tenant| of_payer(tenant) == most)?.payer();
            return self.longest(self.fullest(payer)?).map(|(key, _)| key);
        }
        // Within the newcomer's own client the same rule holds between its visitors, ...
        if let Some(fullest) = self
            .fullest(key.tenant.payer())
            .filter(|fullest| own(fullest) > own(&key.tenant) + 1 && *fullest != key.tenant)
        {
            return self.longest(fullest).map(|(key, _)| key);
        }
        // ... and between the keys, so that one session does not push out the others.
        let own = self.waiters.get(&key).map_or(0, VecDeque::len);
        match self.longest(key.tenant) {
            Some((longest, length)) if length > own + 1 => Some(longest),
            // The newest pose of a session makes its older one useless.
            _ => (key.is_newest_first() && own > 0).then_some(key),
        }
    }

    /// Who has the most waiting requests of a client and its visitors; among equals, the one that
    /// got a permit last.
    fn fullest(&self, payer: Tenant) -> Option<Tenant> {
        let below = self.order.iter().filter(|tenant| tenant.payer() == payer);
        below
            .max_by_key(|tenant| self.usage.get(tenant).map_or(0, |usage| usage.waiting))
            .copied()
    }

    /// The client's key with the most waiting requests, and their number; among equals, the one
    /// that is farthest from its turn.
    fn longest(&self, tenant: Tenant) -> Option<(QueueKey, usize)> {
        let keys = self.usage.get(&tenant)?.keys.iter();
        keys.map(|key| (*key, self.waiters.get(key).map_or(0, VecDeque::len)))
            .max_by_key(|(_, length)| *length)
    }

    fn may_run(&self, tenant: Tenant) -> bool {
        self.may_run_beside(self.running, tenant)
    }

    fn may_run_beside(&self, running: usize, tenant: Tenant) -> bool {
        let has_none = || {
            self.payers
                .get(&tenant.payer())
                .is_none_or(|usage| usage.running == 0)
        };
        // A visitor leaves the last permit to visitors of any key that hold none: what runs for
        // one, a long drag, delays the others by no more than they delay each other.
        let is_visitor = tenant != tenant.payer();
        let holds_one = || {
            self.usage
                .get(&tenant)
                .is_some_and(|usage| usage.running > 0)
        };
        let kept = usize::from(is_visitor && holds_one());
        // The spare permit goes to clients that hold none: with all workers in long jobs of one
        // client, another one still begins at once.
        running + kept < self.permits || (running < self.permits + SPARE_PERMITS && has_none())
    }

    /// Where a client or visitor stands: next is the one that has used the least worker time
    /// recently, and of equals the one with the fewest running requests. Clients are compared
    /// first, and then the visitors of one.
    fn rank(&self, tenant: Tenant, now: Instant) -> Rank {
        let figures = |of: &HashMap<Tenant, Usage>, tenant: Tenant| {
            of.get(&tenant)
                // The number of running requests decides between equals: at the start nobody has
                // used anything yet.
                .map_or((0.0, 0), |usage| (usage.used(now), usage.running))
        };
        Rank {
            payer: figures(&self.payers, tenant.payer()),
            own: figures(&self.usage, tenant),
        }
    }

    /// What a client or visitor uses, and what its client uses in all.
    fn usages(&mut self, tenant: Tenant, now: Instant) -> [&mut Usage; 2] {
        [
            usage_of(&mut self.usage, tenant, now),
            usage_of(&mut self.payers, tenant.payer(), now),
        ]
    }

    fn run(&mut self, tenant: Tenant, now: Instant) {
        self.running += 1;
        for usage in self.usages(tenant, now) {
            usage.update(now);
            // What has run until now is charged at the old number, what follows at the new one.
            usage.running += 1;
        }
    }

    /// A request arrives; `waiter` wakes it if it has to wait.
    pub(crate) fn arrive(&mut self, key: QueueKey, now: Instant, waiter: W) -> Arrival<W> {
        // A free permit is given to a waiting request at once, so none waits for this one.
        if self.may_run(key.tenant) {
            self.run(key.tenant, now);
            return Arrival::Runs;
        }
        let mut rejected = None;
        if self.waiting >= self.max_waiting {
            // Rejecting now is better than a wait that ends in a rejection: the client learns at
            // once when to retry.
            let Some(victim) = self.victim(key) else {
                return Arrival::Rejected;
            };
            rejected = self.take(victim, VecDeque::pop_front);
        }
        let id = self.next_id;
        self.next_id += 1;
        self.waiting += 1;
        let waiters = self.waiters.entry(key).or_default();
        waiters.push_back((id, waiter));
        let is_first = waiters.len() == 1;
        let [usage, of_payer] = self.usages(key.tenant, now);
        usage.waiting += 1;
        of_payer.waiting += 1;
        if is_first {
            // Keys of a client take turns; a key that was empty goes to the end, so that none gains
            // by coming and going.
            usage.keys.push_back(key);
        }
        if usage.waiting == 1 {
            self.order.push_back(key.tenant);
        }
        match rejected {
            Some((_, waiter)) => Arrival::Replaces(id, waiter),
            None => Arrival::Waits(id),
        }
    }

    /// Removes a waiting request of a key.
    fn take(
        &mut self,
        key: QueueKey,
        which: impl FnOnce(&mut VecDeque<(u64, W)>) -> Option<(u64, W)>,
    ) -> Option<(u64, W)> {
        let waiters = self.waiters.get_mut(&key)?;
        let taken = which(waiters)?;
        self.waiting -= 1;
        let is_last = waiters.is_empty();
        if is_last {
            self.waiters.remove(&key);
        }
        if let Some(usage) = self.usage.get_mut(&key.tenant) {
            usage.waiting -= 1;
            if is_last {
                usage.keys.retain(|other| *other != key);
            }
            if usage.waiting == 0 {
                self.order.retain(|other| *other != key.tenant);
            }
            // As of the last change: the map must not keep an entry for each address that has ever
            // waited and left.
            if usage.is_negligible(usage.at) {
                self.usage.remove(&key.tenant);
            }
        }
        let payer = key.tenant.payer();
        if let Some(usage) = self.payers.get_mut(&payer) {
            usage.waiting -= 1;
            if usage.is_negligible(usage.at) {
                self.payers.remove(&payer);
            }
        }
        Some(taken)
    }

    /// A request of this client has ended.
    pub(crate) fn end(&mut self, tenant: Tenant, now: Instant) {
        self.running -= 1;
        for (usages, tenant) in [
            (&mut self.usage, tenant),
            (&mut self.payers, tenant.payer()),
        ] {
            if let Some(usage) = usages.get_mut(&tenant) {
                usage.update(now);
                usage.running -= 1;
                if usage.is_negligible(now) {
                    usages.remove(&tenant);
                }
            }
        }
    }

    /// Whether a job of this client should give way now: another client has used less and would get
    /// the permit.
    pub(crate) fn gives_way(&self, tenant: Tenant, now: Instant) -> bool {
        let rank = self.rank(tenant, now);
        let uses_less = |other: Tenant| {
            let other_rank = self.rank(other, now);
            if other.payer() == tenant.payer() {
                other_rank.own.0 < rank.own.0
            } else {
                other_rank.payer.0 < rank.payer.0
            }
        };
        // More run than permits allow if jobs have waited too long; then it helps to run less.
        let is_excess = self.running > self.permits + SPARE_PERMITS;
        let would_run =
            |other| is_excess || self.may_run_beside(self.running.saturating_sub(1), other);
        let mut others = self
            .order
            .iter()
            .chain(self.paused.iter().map(|(_, tenant, _)| tenant));
        self.paused.len() < MOST_PAUSED
            && others.any(|other| *other != tenant && uses_less(*other) && would_run(*other))
    }

    /// A job of this client gives way; `waiter` wakes it. Returns its number.
    pub(crate) fn pause(&mut self, tenant: Tenant, now: Instant, waiter: W) -> u64 {
        self.end(tenant, now);
        let id = self.next_id;
        self.next_id += 1;
        self.paused.push((id, tenant, waiter));
        id
    }

    /// A job that has given way goes on without a permit; nothing happens if it has got one.
    pub(crate) fn resume(&mut self, id: u64, now: Instant) {
        if let Some(at) = self.paused.iter().position(|(other, ..)| *other == id) {
            let (_, tenant, _) = self.paused.remove(at);
            self.run(tenant, now);
        }
    }

    /// The next request or paused job that runs, and its client; `None` if none may run. After an
    /// end there may be permits for two.
    pub(crate) fn next(&mut self, now: Instant) -> Option<(Tenant, W)> {
        let waiting = self.first(self.order.iter().copied(), now);
        let paused = self.first(self.paused.iter().map(|(_, tenant, _)| *tenant), now);
        match (waiting, paused) {
            // A client's paused jobs come before its waiting requests.
            (Some((at, rank)), paused)
                if paused.is_none_or(|(_, other)| by_rank(&rank, &other).is_lt()) =>
            {
                let key = self.take_turn(at)?;
                let next = self.take(key, |waiters| {
                    if key.is_newest_first() {
                        waiters.pop_back()
                    } else {
                        waiters.pop_front()
                    }
                });
                self.run(key.tenant, now);
                Some((key.tenant, next.expect("a key in order has a request").1))
            }
            (_, Some((at, _))) => {
                let (_, tenant, waiter) = self.paused.remove(at);
                self.run(tenant, now);
                Some((tenant, waiter))
            }
            (_, None) => None,
        }
    }

    /// The place of the client that is next, and its rank.
    fn first(&self, tenants: impl Iterator<Item = Tenant>, now: Instant) -> Option<(usize, Rank)> {
        let candidates = tenants
            .enumerate()
            .filter(|(_, tenant)| self.may_run(*tenant));
        candidates
            .map(|(at, tenant)| (at, self.rank(tenant, now)))
            .min_by(|(_, a), (_, b)| by_rank(a, b))
    }

    /// The next key of the client at this place in `order`. It becomes the last of its client, and
    /// its client the last among equals.
    fn take_turn(&mut self, at: usize) -> Option<QueueKey> {
        let tenant = self.order.remove(at)?;
        self.order.push_back(tenant);
        let usage = self.usage.get_mut(&tenant)?;
        usage.keys.rotate_left(1.min(usage.keys.len()));
        usage.keys.back().copied()
    }

    /// A waiting request leaves; nothing happens if it no longer waits.
    pub(crate) fn leave(&mut self, key: QueueKey, id: u64) {
        self.take(key, |waiters| {
            waiters
                .iter()
                .position(|(other, _)| *other == id)
                .and_then(|at| waiters.remove(at))
        });
    }
}

#[cfg(test)]
mod tests;
