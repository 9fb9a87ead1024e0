//! The queue before the workers: which request gets the next turn, and which one is refused. It decides at three levels:
//!
//! 1. Between clients ([`Tenant`]): the one that has used the least worker time lately goes first. Worker time is the time for which a
//!    client's requests have held turns, including those that run now; what was used counts half after each [`HALF_LIFE`]. A client with
//!    a few large requests therefore gets no more of the workers than one with many small ones. While no other client waits, a client has
//!    all turns.
//! 2. Between the lanes of a client (its sessions, and its requests without a session): they take turns.
//! 3. Inside a lane: in a session's the newest request first, because the newest pose is the one that its user wants to see; otherwise
//!    the oldest.
//!
//! A turn is never taken back before its request has ended. So that long requests of one client cannot hold all turns against the others,
//! there is one turn ([`SPARE`]) more than workers. Only a client that has no turn gets it.
//!
//! A full queue makes room for a newcomer by refusing the oldest request of the longest lane: of the client that has most requests
//! waiting, or of the newcomer's own.
//!
//! There is no clock and there are no threads here: times are handed in.

use std::collections::{HashMap, VecDeque};
use std::time::Instant;

use crate::client::{Client, Tenant};
use crate::session::SessionId;

/// Turns beyond the number of workers.
pub(crate) const SPARE: usize = 1;
/// Seconds after which worker time counts half.
const HALF_LIFE: f64 = 10.0;
/// A client without requests that has used fewer seconds than this is not remembered.
const NEGLIGIBLE: f64 = 0.01;
/// Clients that are remembered before those with negligible use are looked for.
const MANY: usize = 1024;

/// Requests that wait together.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub struct QueueKey {
    tenant: Tenant,
    within: Within,
}

/// Which of a client's lanes.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
enum Within {
    Session(SessionId),
    /// Without a session: people who share a key are told apart by their addresses.
    Address(Tenant),
}

impl QueueKey {
    /// Of what a client asks of a session.
    #[must_use]
    pub fn session(client: Client, id: SessionId) -> Self {
        Self { tenant: client.tenant(), within: Within::Session(id) }
    }

    /// Of what a client asks without a session.
    #[must_use]
    pub fn client(client: Client) -> Self {
        Self { tenant: client.tenant(), within: Within::Address(Tenant::of_address(client.address)) }
    }

    /// The client that is charged for its requests.
    pub(crate) const fn tenant(self) -> Tenant {
        self.tenant
    }

    const fn newest_first(self) -> bool {
        matches!(self.within, Within::Session(_))
    }
}

/// What becomes of a newcomer.
#[derive(Debug, PartialEq, Eq)]
pub(crate) enum Arrival<W> {
    /// It may run.
    Runs,
    /// It waits under this number.
    Waits(u64),
    /// It waits under this number, and this one, which has waited longest in the longest lane, is refused.
    Replaces(u64, W),
    /// It is refused.
    Refused,
}

/// Those who run, in number, and those who wait. `W` is how a request that waits is called.
#[derive(Debug)]
pub(crate) struct Queue<W> {
    turns: usize,
    most: usize,
    running: usize,
    waiting: usize,
    lanes: HashMap<QueueKey, VecDeque<(u64, W)>>,
    accounts: HashMap<Tenant, Account>,
    /// Clients of whom a request waits; the one that got a turn last is the last.
    order: VecDeque<Tenant>,
    next: u64,
}

/// What a client has here.
#[derive(Debug)]
struct Account {
    waiting: usize,
    /// Lanes in which a request waits, the next one first.
    lanes: VecDeque<QueueKey>,
    running: usize,
    /// Worker time used lately, in seconds, as it counted at `at`. Since then `running` requests have run.
    used: f64,
    at: Instant,
}

impl Account {
    fn new(now: Instant) -> Self {
        Self { waiting: 0, lanes: VecDeque::new(), running: 0, used: 0.0, at: now }
    }

    /// Worker time used lately, as it counts now.
    fn used(&self, now: Instant) -> f64 {
        let half_lives = now.saturating_duration_since(self.at).as_secs_f64() / HALF_LIFE;
        let kept = (-half_lives).exp2();
        // The integral of what the requests that run have added since, each moment reduced by its age.
        let added = (1.0 - kept) * HALF_LIFE / std::f64::consts::LN_2;
        self.used * kept + self.running as f64 * added
    }

    /// Counts what was used up to now; before `running` changes.
    fn settle(&mut self, now: Instant) {
        (self.used, self.at) = (self.used(now), now);
    }

    fn is_negligible(&self, now: Instant) -> bool {
        self.waiting == 0 && self.running == 0 && self.used(now) < NEGLIGIBLE
    }
}

impl<W> Queue<W> {
    /// `turns` run at one time, and [`SPARE`]; `most` wait.
    pub(crate) fn new(turns: usize, most: usize) -> Self {
        Self { turns, most, running: 0, waiting: 0, lanes: HashMap::new(), accounts: HashMap::new(), order: VecDeque::new(), next: 0 }
    }

    pub(crate) const fn waiting(&self) -> usize {
        self.waiting
    }

    pub(crate) const fn running(&self) -> usize {
        self.running
    }

    /// A client that has no request here yet would be refused.
    pub(crate) fn is_full(&self) -> bool {
        self.refuses(QueueKey::client(Client::default()))
    }

    /// A request of this lane would be refused.
    pub(crate) fn refuses(&self, lane: QueueKey) -> bool {
        !self.may_run(lane.tenant) && self.waiting >= self.most && self.gives_way(lane).is_none()
    }

    /// The lane that makes room in a full queue for a newcomer of this one.
    fn gives_way(&self, lane: QueueKey) -> Option<QueueKey> {
        let number = |tenant: &Tenant| self.accounts.get(tenant).map_or(0, |account| account.waiting);
        let most = self.order.iter().map(number).max().unwrap_or(0);
        if most > number(&lane.tenant) + 1 {
            // Among equals, the one that got a turn last.
            let tenant = self.order.iter().rev().find(|tenant| number(tenant) == most)?;
            return self.longest(*tenant).map(|(lane, _)| lane);
        }
        let own = self.lanes.get(&lane).map_or(0, VecDeque::len);
        match self.longest(lane.tenant) {
            Some((longest, length)) if length > own + 1 => Some(longest),
            _ => (lane.newest_first() && own > 0).then_some(lane),
        }
    }

    /// The longest lane of a client and how many wait there; among equals, the one whose turn is farthest away.
    fn longest(&self, tenant: Tenant) -> Option<(QueueKey, usize)> {
        let lanes = self.accounts.get(&tenant)?.lanes.iter();
        lanes.map(|lane| (*lane, self.lanes.get(lane).map_or(0, VecDeque::len))).max_by_key(|(_, length)| *length)
    }

    /// There is a turn for this client.
    fn may_run(&self, tenant: Tenant) -> bool {
        let has_none = || self.accounts.get(&tenant).is_none_or(|account| account.running == 0);
        self.running < self.turns || (self.running < self.turns + SPARE && has_none())
    }

    fn account(&mut self, tenant: Tenant, now: Instant) -> &mut Account {
        if self.accounts.len() >= MANY && self.accounts.len().is_power_of_two() {
            self.accounts.retain(|_, account| !account.is_negligible(now));
        }
        self.accounts.entry(tenant).or_insert_with(|| Account::new(now))
    }

    fn run(&mut self, tenant: Tenant, now: Instant) {
        self.running += 1;
        let account = self.account(tenant, now);
        account.settle(now);
        account.running += 1;
    }

    /// A newcomer; `waiter` is made only if it has to wait.
    pub(crate) fn arrive(&mut self, lane: QueueKey, now: Instant, waiter: impl FnOnce() -> W) -> Arrival<W> {
        // A request that waits would have been given a free turn.
        if self.may_run(lane.tenant) {
            self.run(lane.tenant, now);
            return Arrival::Runs;
        }
        let mut refused = None;
        if self.waiting >= self.most {
            let Some(from) = self.gives_way(lane) else { return Arrival::Refused };
            refused = self.take(from, VecDeque::pop_front);
        }
        let id = self.next;
        self.next += 1;
        self.waiting += 1;
        let account = self.account(lane.tenant, now);
        account.waiting += 1;
        let is_first = account.waiting == 1;
        if is_first {
            self.order.push_back(lane.tenant);
        }
        let waiters = self.lanes.entry(lane).or_default();
        waiters.push_back((id, waiter()));
        if waiters.len() == 1
            && let Some(account) = self.accounts.get_mut(&lane.tenant)
        {
            account.lanes.push_back(lane);
        }
        match refused {
            Some((_, waiter)) => Arrival::Replaces(id, waiter),
            None => Arrival::Waits(id),
        }
    }

    /// Takes a request out of a lane.
    fn take(&mut self, lane: QueueKey, which: impl FnOnce(&mut VecDeque<(u64, W)>) -> Option<(u64, W)>) -> Option<(u64, W)> {
        let waiters = self.lanes.get_mut(&lane)?;
        let taken = which(waiters)?;
        self.waiting -= 1;
        let is_last = waiters.is_empty();
        if is_last {
            self.lanes.remove(&lane);
        }
        if let Some(account) = self.accounts.get_mut(&lane.tenant) {
            account.waiting -= 1;
            if is_last {
                account.lanes.retain(|other| *other != lane);
            }
            if account.waiting == 0 {
                self.order.retain(|other| *other != lane.tenant);
            }
            if account.is_negligible(account.at) {
                self.accounts.remove(&lane.tenant);
            }
        }
        Some(taken)
    }

    /// A turn of this client has ended.
    pub(crate) fn end(&mut self, tenant: Tenant, now: Instant) {
        self.running -= 1;
        if let Some(account) = self.accounts.get_mut(&tenant) {
            account.settle(now);
            account.running -= 1;
            if account.is_negligible(now) {
                self.accounts.remove(&tenant);
            }
        }
    }

    /// The next request that runs, if there is a turn for any, and its client. After an end there may be turns for two.
    pub(crate) fn call(&mut self, now: Instant) -> Option<(Tenant, W)> {
        let lane = self.next_lane(now)?;
        let called = self.take(lane, |waiters| if lane.newest_first() { waiters.pop_back() } else { waiters.pop_front() });
        self.run(lane.tenant, now);
        Some((lane.tenant, called.expect("a lane in order has a request").1))
    }

    /// The lane whose turn it is. It comes last from now on among its client's, and its client last among equals.
    fn next_lane(&mut self, now: Instant) -> Option<QueueKey> {
        let rank = |tenant: &Tenant| self.accounts.get(tenant).map_or((0.0, 0), |account| (account.used(now), account.running));
        let candidates = self.order.iter().enumerate().filter(|(_, tenant)| self.may_run(**tenant)).map(|(at, tenant)| (at, rank(tenant)));
        let (at, _) = candidates.min_by(|(_, a), (_, b)| a.0.total_cmp(&b.0).then(a.1.cmp(&b.1)))?;
        let tenant = self.order.remove(at)?;
        self.order.push_back(tenant);
        let account = self.accounts.get_mut(&tenant)?;
        account.lanes.rotate_left(1.min(account.lanes.len()));
        account.lanes.back().copied()
    }

    /// A request that waited has left.
    pub(crate) fn leave(&mut self, lane: QueueKey, id: u64) {
        self.take(lane, |waiters| waiters.iter().position(|(other, _)| *other == id).and_then(|at| waiters.remove(at)));
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

    /// A queue whose turns are all taken, by clients 98 and 99, at a time that stands still.
    struct Busy {
        queue: Queue<u32>,
        now: Instant,
    }

    fn busy(most: usize) -> Busy {
        let (mut queue, now) = (Queue::new(1, most), Instant::now());
        for n in [98, 99] {
            assert_eq!(queue.arrive(session(n), now, || 0), Arrival::Runs);
        }
        Busy { queue, now }
    }

    impl Busy {
        fn arrive(&mut self, lane: QueueKey, waiter: u32) -> Arrival<u32> {
            self.queue.arrive(lane, self.now, || waiter)
        }

        /// Ends one turn after the other, and says who got them.
        fn served(&mut self) -> Vec<u32> {
            self.queue.end(at(98).tenant(), self.now);
            let mut last = at(99).tenant();
            let served = std::iter::from_fn(|| {
                self.queue.end(last, self.now);
                let (tenant, waiter) = self.queue.call(self.now)?;
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
        assert_eq!((busy.queue.waiting(), busy.queue.running(), busy.queue.accounts.len()), (0, 0, 0));
        assert_eq!(busy.arrive(session(1), 1), Arrival::Runs);
    }

    #[test]
    fn a_full_queue_makes_room_at_the_cost_of_the_longest_lane() {
        let mut busy = busy(3);
        for waiter in [10, 11, 12] {
            busy.arrive(client(1), waiter);
        }
        assert!(!busy.queue.is_full(), "another client would be let in");
        assert!(busy.queue.refuses(client(1)) && !busy.queue.refuses(session(2)));
        assert_eq!(busy.arrive(client(1), 13), Arrival::Refused);
        assert_eq!(busy.arrive(session(2), 20), Arrival::Replaces(3, 10));
        // Two of the one, one of the other: a second one would only turn it round.
        assert_eq!(busy.arrive(session(2), 21), Arrival::Replaces(4, 20), "a newer pose takes the place of an older one");
        assert_eq!(busy.arrive(client(3), 30), Arrival::Replaces(5, 11));
        assert!(busy.queue.is_full());
        assert_eq!(busy.arrive(client(4), 40), Arrival::Refused);
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
            assert!(busy.queue.refuses(QueueKey::session(one, id(9))) && !busy.queue.refuses(QueueKey::session(other, id(10))));
            assert_eq!(busy.arrive(QueueKey::session(other, id(10)), 20), Arrival::Replaces(4, 3));
            assert_eq!(busy.arrive(QueueKey::session(other, id(11)), 21), Arrival::Replaces(5, 2));
            assert_eq!(busy.arrive(QueueKey::session(other, id(12)), 22), Arrival::Refused);
            assert_eq!(busy.served(), [0, 20, 1, 21], "clients take turns, however many sessions each has");
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
        assert_eq!(busy.arrive(session(1), 1), Arrival::Refused);
        busy.queue.end(at(98).tenant(), busy.now);
        assert!(!busy.queue.is_full());
    }

    #[test]
    fn one_client_has_every_turn_and_another_gets_the_spare_one() {
        let (mut queue, now) = (Queue::new(2, 9), Instant::now());
        let runs = |queue: &mut Queue<u32>, n: u8| queue.arrive(client(n), now, || u32::from(n)) == Arrival::Runs;
        assert!(runs(&mut queue, 1) && runs(&mut queue, 1) && !runs(&mut queue, 1), "as many turns as workers, and no more");
        assert!(runs(&mut queue, 2), "another client does not wait for the end of those");
        assert!(!runs(&mut queue, 3) && queue.running() == 2 + SPARE);
        // The spare turn is free: of those who wait only client 3 has none.
        queue.end(at(2).tenant(), now);
        assert_eq!(queue.call(now), Some((at(3).tenant(), 3)));
        assert_eq!(queue.call(now), None);
    }

    const MS: Duration = Duration::from_millis(1);

    /// Clients that always have requests waiting, each of a given number of ms, at `turns` turns; the worker time that each gets in a minute.
    fn minute(turns: usize, costs: &[(u8, u32)]) -> BTreeMap<u8, u32> {
        let (mut queue, start) = (Queue::new(turns, 1000), Instant::now());
        let mut running: Vec<(u32, u8, u32)> = Vec::new();
        let mut got = BTreeMap::new();
        for ms in 0..60_000 {
            let now = start + ms * MS;
            for (_, n, cost) in running.extract_if(.., |(until, ..)| *until == ms) {
                queue.end(at(n).tenant(), now);
                *got.entry(n).or_default() += cost;
            }
            let mut begin = |n: u8, cost: u32| running.push((ms + cost, n, cost));
            while let Some((_, waiter)) = queue.call(now) {
                let (n, cost): (u8, u32) = costs[waiter as usize];
                begin(n, cost);
            }
            for (waiter, (n, cost)) in (0..).zip(costs) {
                while queue.accounts.get(&at(*n).tenant()).is_none_or(|account| account.waiting < 3) {
                    if queue.arrive(client(*n), now, || waiter) == Arrival::Runs {
                        begin(*n, *cost);
                    }
                }
            }
        }
        got
    }

    #[test]
    fn clients_get_equal_worker_time_whatever_one_request_costs() {
        for turns in [1, 2, 4] {
            for costs in [&[(1, 2000), (2, 5)][..], &[(1, 500), (2, 20), (3, 20)], &[(1, 7), (2, 9)]] {
                let got = minute(turns, costs);
                let (least, most) = (got.values().min().unwrap(), got.values().max().unwrap());
                eprintln!("{turns} turns, (client, ms a request) {costs:?}: worker time in a minute {got:?} ms");
                assert!(got.len() == costs.len() && *most <= *least * 3 / 2, "{turns} turns, {costs:?}: {got:?}");
            }
        }
    }

    #[test]
    fn what_was_used_is_forgotten_and_so_are_clients() {
        let (mut queue, start) = (Queue::<u32>::new(1, 9), Instant::now());
        let used = |queue: &Queue<u32>, n: u8, now: Instant| queue.accounts.get(&at(n).tenant()).map(|account| account.used(now));
        queue.arrive(client(1), start, || 1);
        let now = start + 1000 * MS;
        queue.end(at(1).tenant(), now);
        let one = used(&queue, 1, now).unwrap();
        assert!((0.9..1.0).contains(&one), "a little of it is old already: {one}");
        let later = now + Duration::from_secs_f64(HALF_LIFE);
        assert!((used(&queue, 1, later).unwrap() - one / 2.0).abs() < 1e-9);
        queue.arrive(client(2), now, || 2);
        queue.end(at(2).tenant(), now + MS);
        assert_eq!(used(&queue, 2, now + MS), None, "a millisecond is not remembered");
        // Thousands of clients, each of whom is remembered for a while.
        let step = 20 * MS;
        for n in 0..10_000_u32 {
            let address = Client { address: Ipv4Addr::from_bits(n).into(), ..Client::default() };
            let now = later + step * n;
            queue.arrive(QueueKey::client(address), now, || 0);
            queue.end(address.tenant(), now + step);
            assert!(queue.accounts.len() <= 2 * MANY);
        }
    }

    proptest! {
        /// Arrivals, ends and departures in any order: never more than are allowed, every request is called or refused exactly once, and
        /// no request waits while there is a turn for it.
        #[test]
        fn everyone_is_accounted_for(steps in prop::collection::vec((0_u8..4, 0_u8..6), 1..400), turns in 1_usize..4, most in 0_usize..8) {
            let mut queue: Queue<u32> = Queue::new(turns, most);
            let (mut running, mut waiting, mut name) = (Vec::new(), Vec::<(QueueKey, u64, u32)>::new(), 0);
            let mut now = Instant::now();
            for (what, n) in steps {
                now += MS * u32::from(n);
                let lane = if n < 3 { session(n) } else { client(n - 1) };
                match what {
                    0 | 1 => {
                        name += 1;
                        match queue.arrive(lane, now, || name) {
                            Arrival::Runs => running.push(lane.tenant),
                            Arrival::Waits(id) => waiting.push((lane, id, name)),
                            Arrival::Replaces(id, gone) => {
                                let before = waiting.len();
                                waiting.retain(|(_, _, waiter)| *waiter != gone);
                                prop_assert_eq!(waiting.len(), before - 1);
                                waiting.push((lane, id, name));
                            }
                            Arrival::Refused => prop_assert!(running.len() >= turns && waiting.len() == most),
                        }
                    }
                    2 if !running.is_empty() => {
                        queue.end(running.swap_remove(usize::from(n) % running.len()), now);
                        while let Some((tenant, next)) = queue.call(now) {
                            let before = waiting.len();
                            waiting.retain(|(lane, _, waiter)| *waiter != next || lane.tenant != tenant);
                            prop_assert_eq!(waiting.len(), before - 1);
                            running.push(tenant);
                        }
                    }
                    _ => {
                        if let Some((lane, id, _)) = waiting.pop() {
                            queue.leave(lane, id);
                        }
                    }
                }
                prop_assert_eq!((queue.running(), queue.waiting()), (running.len(), waiting.len()));
                prop_assert!(running.len() <= turns + SPARE && waiting.len() <= most);
                let running_of = |tenant: Tenant| running.iter().filter(|other| **other == tenant).count();
                for (lane, ..) in &waiting {
                    prop_assert!(running.len() >= turns && (running.len() == turns + SPARE || running_of(lane.tenant) > 0));
                }
                let sum = |of: fn(&Account) -> usize| queue.accounts.values().map(of).sum::<usize>();
                prop_assert_eq!(queue.accounts.values().filter(|account| account.waiting > 0).count(), queue.order.len());
                prop_assert_eq!(queue.lanes.len(), sum(|account| account.lanes.len()));
                prop_assert_eq!((queue.waiting, queue.running), (sum(|account| account.waiting), sum(|account| account.running)));
            }
        }
    }
}
