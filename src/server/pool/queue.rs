//! The order of waiting requests: which one gets the next permit, and which one is rejected. It decides at three levels:
//!
//! 1. Between clients ([`Tenant`]): the client that has used the least worker time recently is next. Worker time is the time for which a
//!    client's requests have held permits, including those that run now; it counts half after each [`HALF_LIFE`]. A client with a few
//!    large requests therefore gets no more of the workers than one with many small ones. A client that waits alone gets all permits.
//! 2. Between the keys of a client (its sessions, and its requests without a session): round robin.
//! 3. Within a key: the newest request of a session, because its user wants to see the newest pose; otherwise the oldest.
//!
//! A permit is never revoked. There is one permit ([`SPARE`]) more than workers, for a client that holds none, so that long requests of one
//! client cannot hold all permits.
//!
//! A full queue rejects the oldest request of the longest key for a newcomer: of the client with the most waiting requests, or of the
//! newcomer's own client.
//!
//! Times are arguments; there are no clocks and no threads here.

use std::collections::{HashMap, VecDeque};
use std::time::Instant;

use crate::client::{Client, Tenant};
use crate::session::SessionId;

/// Permits beyond the number of workers.
pub(crate) const SPARE: usize = 1;
/// Seconds after which worker time counts half.
const HALF_LIFE: f64 = 10.0;
/// A client without requests that has used fewer seconds is forgotten.
const NEGLIGIBLE: f64 = 0.01;
/// Above this many clients, those with negligible use are removed.
const MANY: usize = 1024;

/// Requests with equal keys wait together.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub struct QueueKey {
    tenant: Tenant,
    part: KeyPart,
}

/// The part of a client's requests.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
enum KeyPart {
    Session(SessionId),
    /// Without a session: users who share an API key are told apart by their addresses.
    Address(Tenant),
}

impl QueueKey {
    /// The key of a client's requests for a session.
    pub fn session(client: Client, id: SessionId) -> Self {
        Self { tenant: client.tenant(), part: KeyPart::Session(id) }
    }

    /// The key of a client's requests without a session.
    pub fn client(client: Client) -> Self {
        Self { tenant: client.tenant(), part: KeyPart::Address(Tenant::of_address(client.address)) }
    }

    /// The client that is charged for the request.
    pub(crate) const fn tenant(self) -> Tenant {
        self.tenant
    }

    const fn is_newest_first(self) -> bool {
        matches!(self.part, KeyPart::Session(_))
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
    /// Clients with waiting requests; the one that got a permit last is the last.
    order: VecDeque<Tenant>,
    next_id: u64,
}

/// What one client uses.
#[derive(Debug)]
struct Usage {
    waiting: usize,
    /// Keys with waiting requests, the next one first.
    keys: VecDeque<QueueKey>,
    running: usize,
    /// Recently used worker time in seconds, as of `at`. Since then `running` requests have run.
    used: f64,
    at: Instant,
}

impl Usage {
    fn new(now: Instant) -> Self {
        Self { waiting: 0, keys: VecDeque::new(), running: 0, used: 0.0, at: now }
    }

    /// Recently used worker time, as of now.
    fn used(&self, now: Instant) -> f64 {
        let half_lives = now.saturating_duration_since(self.at).as_secs_f64() / HALF_LIFE;
        let kept = (-half_lives).exp2();
        // The integral of what the running requests have added since, each moment weighted by its age.
        let added = (1.0 - kept) * HALF_LIFE / std::f64::consts::LN_2;
        self.used * kept + self.running as f64 * added
    }

    /// Brings `used` up to date, before `running` changes.
    fn update(&mut self, now: Instant) {
        (self.used, self.at) = (self.used(now), now);
    }

    fn is_negligible(&self, now: Instant) -> bool {
        self.waiting == 0 && self.running == 0 && self.used(now) < NEGLIGIBLE
    }
}

impl<W> FairQueue<W> {
    /// `permits` requests and [`SPARE`] run at one time; `max_waiting` wait.
    pub(crate) fn new(permits: usize, max_waiting: usize) -> Self {
        let (waiters, usage, order) = (HashMap::new(), HashMap::new(), VecDeque::new());
        Self { permits, max_waiting, running: 0, waiting: 0, waiters, usage, order, next_id: 0 }
    }

    pub(crate) const fn waiting(&self) -> usize {
        self.waiting
    }

    pub(crate) const fn running(&self) -> usize {
        self.running
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
        let waiting = |tenant: &Tenant| self.usage.get(tenant).map_or(0, |usage| usage.waiting);
        let most = self.order.iter().map(waiting).max().unwrap_or(0);
        if most > waiting(&key.tenant) + 1 {
            // Among equals, the client that got a permit last.
            let tenant = self.order.iter().rev().find(|tenant| waiting(tenant) == most)?;
            return self.longest(*tenant).map(|(key, _)| key);
        }
        let own = self.waiters.get(&key).map_or(0, VecDeque::len);
        match self.longest(key.tenant) {
            Some((longest, length)) if length > own + 1 => Some(longest),
            _ => (key.is_newest_first() && own > 0).then_some(key),
        }
    }

    /// The client's key with the most waiting requests, and their number; among equals, the one that is farthest from its turn.
    fn longest(&self, tenant: Tenant) -> Option<(QueueKey, usize)> {
        let keys = self.usage.get(&tenant)?.keys.iter();
        keys.map(|key| (*key, self.waiters.get(key).map_or(0, VecDeque::len))).max_by_key(|(_, length)| *length)
    }

    fn may_run(&self, tenant: Tenant) -> bool {
        let has_none = || self.usage.get(&tenant).is_none_or(|usage| usage.running == 0);
        self.running < self.permits || (self.running < self.permits + SPARE && has_none())
    }

    fn usage(&mut self, tenant: Tenant, now: Instant) -> &mut Usage {
        if self.usage.len() >= MANY && self.usage.len().is_power_of_two() {
            self.usage.retain(|_, usage| !usage.is_negligible(now));
        }
        self.usage.entry(tenant).or_insert_with(|| Usage::new(now))
    }

    fn run(&mut self, tenant: Tenant, now: Instant) {
        self.running += 1;
        let usage = self.usage(tenant, now);
        usage.update(now);
        usage.running += 1;
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
            let Some(victim) = self.victim(key) else { return Arrival::Rejected };
            rejected = self.take(victim, VecDeque::pop_front);
        }
        let id = self.next_id;
        self.next_id += 1;
        self.waiting += 1;
        let waiters = self.waiters.entry(key).or_default();
        waiters.push_back((id, waiter));
        let is_first = waiters.len() == 1;
        let usage = self.usage(key.tenant, now);
        usage.waiting += 1;
        if is_first {
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
    fn take(&mut self, key: QueueKey, which: impl FnOnce(&mut VecDeque<(u64, W)>) -> Option<(u64, W)>) -> Option<(u64, W)> {
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
            if usage.is_negligible(usage.at) {
                self.usage.remove(&key.tenant);
            }
        }
        Some(taken)
    }

    /// A request of this client has ended.
    pub(crate) fn end(&mut self, tenant: Tenant, now: Instant) {
        self.running -= 1;
        if let Some(usage) = self.usage.get_mut(&tenant) {
            usage.update(now);
            usage.running -= 1;
            if usage.is_negligible(now) {
                self.usage.remove(&tenant);
            }
        }
    }

    /// The next request that runs, and its client; `None` if no waiting request may run. After an end there may be permits for two.
    pub(crate) fn next(&mut self, now: Instant) -> Option<(Tenant, W)> {
        let key = self.next_key(now)?;
        let next = self.take(key, |waiters| if key.is_newest_first() { waiters.pop_back() } else { waiters.pop_front() });
        self.run(key.tenant, now);
        Some((key.tenant, next.expect("a key in order has a request").1))
    }

    /// The key that is next. It becomes the last of its client, and its client the last among equals.
    fn next_key(&mut self, now: Instant) -> Option<QueueKey> {
        let rank = |tenant: &Tenant| self.usage.get(tenant).map_or((0.0, 0), |usage| (usage.used(now), usage.running));
        let candidates = self.order.iter().enumerate().filter(|(_, tenant)| self.may_run(**tenant)).map(|(at, tenant)| (at, rank(tenant)));
        let (at, _) = candidates.min_by(|(_, a), (_, b)| a.0.total_cmp(&b.0).then(a.1.cmp(&b.1)))?;
        let tenant = self.order.remove(at)?;
        self.order.push_back(tenant);
        let usage = self.usage.get_mut(&tenant)?;
        usage.keys.rotate_left(1.min(usage.keys.len()));
        usage.keys.back().copied()
    }

    /// A waiting request leaves; nothing happens if it no longer waits.
    pub(crate) fn leave(&mut self, key: QueueKey, id: u64) {
        self.take(key, |waiters| waiters.iter().position(|(other, _)| *other == id).and_then(|at| waiters.remove(at)));
    }
}

#[cfg(test)]
mod tests {
    use std::collections::BTreeMap;
    use std::net::Ipv4Addr;
    use std::time::Duration;

    use proptest::prelude::*;

    use super::*;
    use crate::client::Owner;

    /// The client at an address, without a key.
    fn at(n: u8) -> Client {
        Client { address: Ipv4Addr::new(192, 0, 2, n).into(), ..Client::default() }
    }

    fn id(n: u8) -> SessionId {
        SessionId::from_bytes(&std::array::from_fn(|at| if at < 16 { 0 } else { n }))
    }

    fn session(n: u8) -> QueueKey {
        QueueKey::session(at(n), id(n))
    }

    fn client(n: u8) -> QueueKey {
        QueueKey::client(at(n))
    }

    /// A queue whose permits are all taken, by clients 98 and 99, at a time that stands still.
    struct Busy {
        queue: FairQueue<u32>,
        now: Instant,
    }

    fn busy(most: usize) -> Busy {
        let (mut queue, now) = (FairQueue::new(1, most), Instant::now());
        for n in [98, 99] {
            assert_eq!(queue.arrive(session(n), now, 0), Arrival::Runs);
        }
        Busy { queue, now }
    }

    impl Busy {
        fn arrive(&mut self, key: QueueKey, waiter: u32) -> Arrival<u32> {
            self.queue.arrive(key, self.now, waiter)
        }

        /// Ends one turn after the other, and says who got them.
        fn served(&mut self) -> Vec<u32> {
            self.queue.end(at(98).tenant(), self.now);
            let mut last = at(99).tenant();
            let served = std::iter::from_fn(|| {
                self.queue.end(last, self.now);
                let (tenant, waiter) = self.queue.next(self.now)?;
                last = tenant;
                Some(waiter)
            });
            served.collect()
        }
    }

    #[test]
    fn lanes_take_turns_and_the_newest_of_a_session_comes_first() {
        let mut busy = busy(10);
        for waiter in [10, 11, 12] {
            busy.arrive(session(1), waiter);
        }
        for waiter in [20, 21] {
            busy.arrive(client(2), waiter);
        }
        busy.arrive(session(3), 30);
        assert_eq!((busy.queue.waiting(), busy.queue.running()), (6, 2));
        assert_eq!(busy.served(), [12, 20, 30, 11, 21, 10]);
        assert_eq!((busy.queue.waiting(), busy.queue.running(), busy.queue.usage.len()), (0, 0, 0));
        assert_eq!(busy.arrive(session(1), 1), Arrival::Runs);
    }

    #[test]
    fn a_full_queue_makes_room_at_the_cost_of_the_longest_lane() {
        let mut busy = busy(3);
        for waiter in [10, 11, 12] {
            busy.arrive(client(1), waiter);
        }
        assert!(!busy.queue.is_full(), "another client would be let in");
        assert!(busy.queue.rejects(client(1)) && !busy.queue.rejects(session(2)));
        assert_eq!(busy.arrive(client(1), 13), Arrival::Rejected);
        assert_eq!(busy.arrive(session(2), 20), Arrival::Replaces(3, 10));
        // Two of the one, one of the other: a second one would only turn it round.
        assert_eq!(busy.arrive(session(2), 21), Arrival::Replaces(4, 20), "a newer pose takes the place of an older one");
        assert_eq!(busy.arrive(client(3), 30), Arrival::Replaces(5, 11));
        assert!(busy.queue.is_full());
        assert_eq!(busy.arrive(client(4), 40), Arrival::Rejected);
        assert_eq!(busy.served(), [12, 21, 30]);
    }

    #[test]
    fn many_sessions_of_one_client_keep_no_other_out() {
        let keyed = |owner: u8| Client { owner: Owner::from_bytes([owner; 16]), ..Client::default() };
        // With keys the name counts, without keys the address.
        for [one, other] in [[keyed(1), keyed(2)], [at(1), at(2)]] {
            let mut busy = busy(4);
            for n in 0..4 {
                busy.arrive(QueueKey::session(one, id(n)), u32::from(n));
            }
            assert!(busy.queue.rejects(QueueKey::session(one, id(9))) && !busy.queue.rejects(QueueKey::session(other, id(10))));
            assert_eq!(busy.arrive(QueueKey::session(other, id(10)), 20), Arrival::Replaces(4, 3));
            assert_eq!(busy.arrive(QueueKey::session(other, id(11)), 21), Arrival::Replaces(5, 2));
            assert_eq!(busy.arrive(QueueKey::session(other, id(12)), 22), Arrival::Rejected);
            assert_eq!(busy.served(), [0, 20, 1, 21], "clients take permits, however many sessions each has");
        }
    }

    #[test]
    fn who_leaves_is_not_served() {
        let mut busy = busy(10);
        let Arrival::Waits(first) = busy.arrive(session(1), 10) else { panic!() };
        busy.arrive(session(2), 20);
        busy.queue.leave(session(1), first);
        busy.queue.leave(session(1), first);
        assert_eq!(busy.queue.waiting(), 1);
        assert_eq!(busy.served(), [20]);
    }

    #[test]
    fn without_a_queue_there_are_turns_alone() {
        let mut busy = busy(0);
        assert!(busy.queue.is_full());
        assert_eq!(busy.arrive(session(1), 1), Arrival::Rejected);
        busy.queue.end(at(98).tenant(), busy.now);
        assert!(!busy.queue.is_full());
    }

    #[test]
    fn one_client_has_every_turn_and_another_gets_the_spare_one() {
        let (mut queue, now) = (FairQueue::new(2, 9), Instant::now());
        let runs = |queue: &mut FairQueue<u32>, n: u8| queue.arrive(client(n), now, u32::from(n)) == Arrival::Runs;
        assert!(runs(&mut queue, 1) && runs(&mut queue, 1) && !runs(&mut queue, 1), "as many permits as workers, and no more");
        assert!(runs(&mut queue, 2), "another client does not wait for the end of those");
        assert!(!runs(&mut queue, 3) && queue.running() == 2 + SPARE);
        // The spare turn is free: of those who wait only client 3 has none.
        queue.end(at(2).tenant(), now);
        assert_eq!(queue.next(now), Some((at(3).tenant(), 3)));
        assert_eq!(queue.next(now), None);
    }

    const MS: Duration = Duration::from_millis(1);

    /// Clients that always have requests waiting, each of a given number of ms, at `permits` permits; the worker time that each gets in a
    /// minute.
    fn minute(permits: usize, costs: &[(u8, u32)]) -> BTreeMap<u8, u32> {
        let (mut queue, start) = (FairQueue::new(permits, 1000), Instant::now());
        let mut running: Vec<(u32, u8, u32)> = Vec::new();
        let mut got = BTreeMap::new();
        for ms in 0..60_000 {
            let now = start + ms * MS;
            for (_, n, cost) in running.extract_if(.., |(until, ..)| *until == ms) {
                queue.end(at(n).tenant(), now);
                *got.entry(n).or_default() += cost;
            }
            let mut begin = |n: u8, cost: u32| running.push((ms + cost, n, cost));
            while let Some((_, waiter)) = queue.next(now) {
                let (n, cost): (u8, u32) = costs[waiter as usize];
                begin(n, cost);
            }
            for (waiter, (n, cost)) in (0..).zip(costs) {
                while queue.usage.get(&at(*n).tenant()).is_none_or(|usage| usage.waiting < 3) {
                    if queue.arrive(client(*n), now, waiter) == Arrival::Runs {
                        begin(*n, *cost);
                    }
                }
            }
        }
        got
    }

    #[test]
    fn clients_get_equal_worker_time_whatever_one_request_costs() {
        for permits in [1, 2, 4] {
            for costs in [&[(1, 2000), (2, 5)][..], &[(1, 500), (2, 20), (3, 20)], &[(1, 7), (2, 9)]] {
                let got = minute(permits, costs);
                let (least, most) = (got.values().min().unwrap(), got.values().max().unwrap());
                eprintln!("{permits} permits, (client, ms a request) {costs:?}: worker time in a minute {got:?} ms");
                assert!(got.len() == costs.len() && *most <= *least * 3 / 2, "{permits} permits, {costs:?}: {got:?}");
            }
        }
    }

    #[test]
    fn what_was_used_is_forgotten_and_so_are_clients() {
        let (mut queue, start) = (FairQueue::<u32>::new(1, 9), Instant::now());
        let used = |queue: &FairQueue<u32>, n: u8, now: Instant| queue.usage.get(&at(n).tenant()).map(|usage| usage.used(now));
        queue.arrive(client(1), start, 1);
        let now = start + 1000 * MS;
        queue.end(at(1).tenant(), now);
        let one = used(&queue, 1, now).unwrap();
        assert!((0.9..1.0).contains(&one), "a little of it is old already: {one}");
        let later = now + Duration::from_secs_f64(HALF_LIFE);
        assert!((used(&queue, 1, later).unwrap() - one / 2.0).abs() < 1e-9);
        queue.arrive(client(2), now, 2);
        queue.end(at(2).tenant(), now + MS);
        assert_eq!(used(&queue, 2, now + MS), None, "a millisecond is not remembered");
        // Thousands of clients, each of whom is remembered for a while.
        let step = 20 * MS;
        for n in 0..10_000_u32 {
            let address = Client { address: Ipv4Addr::from_bits(n).into(), ..Client::default() };
            let now = later + step * n;
            queue.arrive(QueueKey::client(address), now, 0);
            queue.end(address.tenant(), now + step);
            assert!(queue.usage.len() <= 2 * MANY);
        }
    }

    proptest! {
        /// Arrivals, ends and departures in any order: never more than are allowed, every request is called or refused exactly once, and
        /// no request waits while there is a turn for it.
        #[test]
        fn everyone_is_accounted_for(steps in prop::collection::vec((0_u8..4, 0_u8..6), 1..400), permits in 1_usize..4, most in 0_usize..8) {
            let mut queue: FairQueue<u32> = FairQueue::new(permits, most);
            let (mut running, mut waiting, mut name) = (Vec::new(), Vec::<(QueueKey, u64, u32)>::new(), 0);
            let mut now = Instant::now();
            for (what, n) in steps {
                now += MS * u32::from(n);
                let key = if n < 3 { session(n) } else { client(n - 1) };
                match what {
                    0 | 1 => {
                        name += 1;
                        match queue.arrive(key, now, name) {
                            Arrival::Runs => running.push(key.tenant),
                            Arrival::Waits(id) => waiting.push((key, id, name)),
                            Arrival::Replaces(id, gone) => {
                                let before = waiting.len();
                                waiting.retain(|(_, _, waiter)| *waiter != gone);
                                prop_assert_eq!(waiting.len(), before - 1);
                                waiting.push((key, id, name));
                            }
                            Arrival::Rejected => prop_assert!(running.len() >= permits && waiting.len() == most),
                        }
                    }
                    2 if !running.is_empty() => {
                        queue.end(running.swap_remove(usize::from(n) % running.len()), now);
                        while let Some((tenant, next)) = queue.next(now) {
                            let before = waiting.len();
                            waiting.retain(|(key, _, waiter)| *waiter != next || key.tenant != tenant);
                            prop_assert_eq!(waiting.len(), before - 1);
                            running.push(tenant);
                        }
                    }
                    _ => {
                        if let Some((key, id, _)) = waiting.pop() {
                            queue.leave(key, id);
                        }
                    }
                }
                prop_assert_eq!((queue.running(), queue.waiting()), (running.len(), waiting.len()));
                prop_assert!(running.len() <= permits + SPARE && waiting.len() <= most);
                let running_of = |tenant: Tenant| running.iter().filter(|other| **other == tenant).count();
                for (key, ..) in &waiting {
                    prop_assert!(running.len() >= permits && (running.len() == permits + SPARE || running_of(key.tenant) > 0));
                }
                let sum = |of: fn(&Usage) -> usize| queue.usage.values().map(of).sum::<usize>();
                prop_assert_eq!(queue.usage.values().filter(|usage| usage.waiting > 0).count(), queue.order.len());
                prop_assert_eq!(queue.waiters.len(), sum(|usage| usage.keys.len()));
                prop_assert_eq!((queue.waiting, queue.running), (sum(|usage| usage.waiting), sum(|usage| usage.running)));
            }
        }
    }
}
