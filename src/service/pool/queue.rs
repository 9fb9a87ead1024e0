//! The queue before the workers: who gets the next turn, and who is sent away. Fair between owners, and between the lanes of each (a session, or a
//! client that has none): they take turns. Inside a session's lane the newest comes first, because the newest pose is what a hand wants to see;
//! inside a client's the oldest. A full queue makes room for a newcomer by sending away the oldest of the longest lane, of the owner of whom most wait
//! or of the newcomer's own: nobody is kept out by another's many requests, nor by another's many sessions. No clock and no threads: both are the
//! pool's.

use std::collections::{HashMap, VecDeque};
use std::net::{IpAddr, Ipv6Addr};

use crate::service::client::{Client, Owner};
use crate::service::session::SessionId;

/// Requests that wait together.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub enum Lane {
    /// Of one session: the newest first.
    Session(SessionId),
    /// Of a client, without a session: the oldest first.
    Client(Client),
}

impl Lane {
    /// A client's lane. Whoever has an IPv6 address has 2^64 of them: the network counts.
    #[must_use]
    pub fn client(client: Client) -> Self {
        let address = match client.address {
            IpAddr::V6(address) => IpAddr::V6(Ipv6Addr::from_bits(address.to_bits() >> 64 << 64)),
            address @ IpAddr::V4(_) => address,
        };
        Self::Client(Client { address, ..client })
    }

    const fn owner(self) -> Owner {
        match self {
            Self::Session(id) => id.owner(),
            Self::Client(client) => client.owner,
        }
    }

    const fn newest_first(self) -> bool {
        matches!(self, Self::Session(_))
    }
}

/// What becomes of a newcomer.
#[derive(Debug, PartialEq, Eq)]
pub(super) enum Arrival<W> {
    /// It may run.
    Runs,
    /// It waits under this number.
    Waits(u64),
    /// It waits under this number, and this one, which has waited longest in the longest lane, is sent away.
    Replaces(u64, W),
    /// It is sent away.
    Refused,
}

/// Those who run, in number, and those who wait. `W` is who is told.
#[derive(Debug)]
pub(super) struct Queue<W> {
    turns: usize,
    most: usize,
    running: usize,
    waiting: usize,
    lanes: HashMap<Lane, VecDeque<(u64, W)>>,
    owners: HashMap<Owner, Waiting>,
    /// Owners of whom someone waits, the next one first.
    order: VecDeque<Owner>,
    next: u64,
}

/// Who waits of one owner.
#[derive(Debug, Default)]
struct Waiting {
    number: usize,
    /// Lanes in which someone waits, the next one first.
    order: VecDeque<Lane>,
}

impl<W> Queue<W> {
    /// `turns` run at one time, `most` wait.
    pub(super) fn new(turns: usize, most: usize) -> Self {
        Self { turns, most, running: 0, waiting: 0, lanes: HashMap::new(), owners: HashMap::new(), order: VecDeque::new(), next: 0 }
    }

    pub(super) const fn waiting(&self) -> usize {
        self.waiting
    }

    pub(super) const fn running(&self) -> usize {
        self.running
    }

    /// Someone who has nobody here yet would be sent away.
    pub(super) fn is_full(&self) -> bool {
        self.refuses(Lane::Client(Client::default()))
    }

    /// Someone of this lane would be sent away.
    pub(super) fn refuses(&self, lane: Lane) -> bool {
        !self.has_turn() && self.waiting >= self.most && self.gives_way(lane).is_none()
    }

    /// The lane that makes room in a full queue for a newcomer of this one.
    fn gives_way(&self, lane: Lane) -> Option<Lane> {
        let number = |owner: &Owner| self.owners.get(owner).map_or(0, |waiting| waiting.number);
        let most = self.order.iter().map(number).max().unwrap_or(0);
        if most > number(&lane.owner()) + 1 {
            // Among equals, the one whose turn is farthest away.
            let owner = self.order.iter().rev().find(|owner| number(owner) == most)?;
            return self.longest(*owner).map(|(lane, _)| lane);
        }
        let own = self.lanes.get(&lane).map_or(0, VecDeque::len);
        match self.longest(lane.owner()) {
            Some((longest, length)) if length > own + 1 => Some(longest),
            _ => (lane.newest_first() && own > 0).then_some(lane),
        }
    }

    /// The longest lane of an owner and how many wait there; among equals, the one whose turn is farthest away.
    fn longest(&self, owner: Owner) -> Option<(Lane, usize)> {
        let lanes = self.owners.get(&owner)?.order.iter();
        lanes.map(|lane| (*lane, self.lanes.get(lane).map_or(0, VecDeque::len))).max_by_key(|(_, length)| *length)
    }

    fn has_turn(&self) -> bool {
        self.running < self.turns
    }

    /// A newcomer; `waiter` is made only if it has to wait.
    pub(super) fn arrive(&mut self, lane: Lane, waiter: impl FnOnce() -> W) -> Arrival<W> {
        // Whoever waits would have been given a free turn.
        if self.has_turn() {
            self.running += 1;
            return Arrival::Runs;
        }
        let mut sent_away = None;
        if self.waiting >= self.most {
            let Some(from) = self.gives_way(lane) else { return Arrival::Refused };
            sent_away = self.take(from, VecDeque::pop_front);
        }
        let id = self.next;
        self.next += 1;
        let waiters = self.lanes.entry(lane).or_default();
        let of_owner = self.owners.entry(lane.owner()).or_default();
        if of_owner.number == 0 {
            self.order.push_back(lane.owner());
        }
        if waiters.is_empty() {
            of_owner.order.push_back(lane);
        }
        waiters.push_back((id, waiter()));
        of_owner.number += 1;
        self.waiting += 1;
        match sent_away {
            Some((_, waiter)) => Arrival::Replaces(id, waiter),
            None => Arrival::Waits(id),
        }
    }

    /// Takes someone out of a lane.
    fn take(&mut self, lane: Lane, which: impl FnOnce(&mut VecDeque<(u64, W)>) -> Option<(u64, W)>) -> Option<(u64, W)> {
        let waiters = self.lanes.get_mut(&lane)?;
        let taken = which(waiters)?;
        self.waiting -= 1;
        let is_last = waiters.is_empty();
        if is_last {
            self.lanes.remove(&lane);
        }
        if let Some(of_owner) = self.owners.get_mut(&lane.owner()) {
            of_owner.number -= 1;
            if is_last {
                of_owner.order.retain(|other| *other != lane);
            }
            if of_owner.number == 0 {
                self.owners.remove(&lane.owner());
                self.order.retain(|other| *other != lane.owner());
            }
        }
        Some(taken)
    }

    /// A turn has ended; whoever comes next has it now.
    pub(super) fn pass_on(&mut self) -> Option<W> {
        let Some(lane) = self.next_lane() else {
            self.running -= 1;
            return None;
        };
        let next = self.take(lane, |waiters| if lane.newest_first() { waiters.pop_back() } else { waiters.pop_front() });
        Some(next.expect("a lane in order has someone").1)
    }

    /// The lane whose turn it is; it comes last from now on, and so does its owner.
    fn next_lane(&mut self) -> Option<Lane> {
        self.order.rotate_left(1.min(self.order.len()));
        let of_owner = self.owners.get_mut(self.order.back()?)?;
        of_owner.order.rotate_left(1.min(of_owner.order.len()));
        of_owner.order.back().copied()
    }

    /// Someone who waited has left.
    pub(super) fn leave(&mut self, lane: Lane, id: u64) {
        self.take(lane, |waiters| waiters.iter().position(|(other, _)| *other == id).and_then(|at| waiters.remove(at)));
    }
}

#[cfg(test)]
mod tests {
    use proptest::prelude::*;

    use super::*;

    fn session(n: u8) -> Lane {
        let mut bytes = [0; 32];
        bytes[31] = n;
        Lane::Session(SessionId::from_bytes(&bytes))
    }

    fn client(n: u8) -> Lane {
        Lane::Client(Client { owner: Owner::from_bytes([n; 16]), ..Client::default() })
    }

    fn busy(most: usize) -> Queue<u32> {
        let mut queue = Queue::new(1, most);
        assert_eq!(queue.arrive(session(99), || 0), Arrival::Runs);
        queue
    }

    fn served(queue: &mut Queue<u32>) -> Vec<u32> {
        std::iter::from_fn(|| queue.pass_on()).collect()
    }

    #[test]
    fn lanes_take_turns_and_the_newest_of_a_session_comes_first() {
        let mut queue = busy(10);
        for waiter in [10, 11, 12] {
            queue.arrive(session(1), || waiter);
        }
        for waiter in [20, 21] {
            queue.arrive(client(2), || waiter);
        }
        queue.arrive(session(3), || 30);
        assert_eq!((queue.waiting(), queue.running()), (6, 1));
        assert_eq!(served(&mut queue), [12, 20, 30, 21, 11, 10]);
        assert_eq!((queue.waiting(), queue.running()), (0, 0));
        assert_eq!(queue.arrive(session(1), || 1), Arrival::Runs);
    }

    #[test]
    fn a_full_queue_makes_room_at_the_cost_of_the_longest_lane() {
        let mut queue = busy(3);
        for waiter in [10, 11, 12] {
            queue.arrive(client(1), || waiter);
        }
        assert!(!queue.is_full(), "another client would be let in");
        assert!(queue.refuses(client(1)) && !queue.refuses(session(2)));
        assert_eq!(queue.arrive(client(1), || 13), Arrival::Refused);
        assert_eq!(queue.arrive(session(2), || 20), Arrival::Replaces(3, 10));
        // Two of the one, one of the other: a second one would only turn it round.
        assert_eq!(queue.arrive(session(2), || 21), Arrival::Replaces(4, 20), "a newer pose takes the place of an older one");
        assert_eq!(queue.arrive(client(3), || 30), Arrival::Replaces(5, 11));
        assert!(queue.is_full());
        assert_eq!(queue.arrive(client(4), || 40), Arrival::Refused);
        assert_eq!(served(&mut queue), [12, 21, 30]);
    }

    #[test]
    fn many_sessions_of_one_owner_keep_no_other_out() {
        let session = |owner: u8, n: u8| Lane::Session(SessionId::from_bytes(&std::array::from_fn(|at| if at < 16 { owner } else { n })));
        let mut queue = busy(4);
        for n in 0..4 {
            queue.arrive(session(1, n), || u32::from(n));
        }
        assert!(queue.refuses(session(1, 9)) && !queue.refuses(session(2, 0)) && !queue.is_full());
        assert_eq!(queue.arrive(session(2, 0), || 20), Arrival::Replaces(4, 3));
        assert_eq!(queue.arrive(session(2, 1), || 21), Arrival::Replaces(5, 2));
        assert_eq!(queue.arrive(session(2, 2), || 22), Arrival::Refused);
        assert_eq!(served(&mut queue), [0, 20, 1, 21], "owners take turns, however many sessions each has");
    }

    #[test]
    fn who_leaves_is_not_served() {
        let mut queue = busy(10);
        let Arrival::Waits(first) = queue.arrive(session(1), || 10) else { panic!() };
        queue.arrive(session(2), || 20);
        queue.leave(session(1), first);
        queue.leave(session(1), first);
        assert_eq!(queue.waiting(), 1);
        assert_eq!(served(&mut queue), [20]);
    }

    #[test]
    fn without_a_queue_there_are_turns_alone() {
        let mut queue = busy(0);
        assert!(queue.is_full());
        assert_eq!(queue.arrive(session(1), || 1), Arrival::Refused);
        assert_eq!(queue.pass_on(), None);
        assert!(!queue.is_full());
    }

    proptest! {
        /// Arrivals, ends and departures in any order: never more than are allowed, everybody is told exactly once, and no lane is left out
        /// for longer than the others take a turn each.
        #[test]
        fn everyone_is_accounted_for(steps in prop::collection::vec((0_u8..4, 0_u8..6), 1..400), turns in 1_usize..4, most in 0_usize..8) {
            let mut queue: Queue<u32> = Queue::new(turns, most);
            let (mut running, mut waiting, mut name) = (0_usize, Vec::<(Lane, u64, u32)>::new(), 0);
            for (what, n) in steps {
                let lane = if n < 3 { session(n) } else { client(n) };
                match what {
                    0 | 1 => {
                        name += 1;
                        match queue.arrive(lane, || name) {
                            Arrival::Runs => running += 1,
                            Arrival::Waits(id) => waiting.push((lane, id, name)),
                            Arrival::Replaces(id, gone) => {
                                let before = waiting.len();
                                waiting.retain(|(_, _, waiter)| *waiter != gone);
                                prop_assert_eq!(waiting.len(), before - 1);
                                waiting.push((lane, id, name));
                            }
                            Arrival::Refused => prop_assert!(running == turns && waiting.len() == most),
                        }
                    }
                    2 if running > 0 => match queue.pass_on() {
                        None => {
                            prop_assert!(waiting.is_empty());
                            running -= 1;
                        }
                        Some(next) => {
                            let before = waiting.len();
                            waiting.retain(|(_, _, waiter)| *waiter != next);
                            prop_assert_eq!(waiting.len(), before - 1);
                        }
                    },
                    _ => {
                        if let Some((lane, id, _)) = waiting.pop() {
                            queue.leave(lane, id);
                        }
                    }
                }
                prop_assert_eq!((queue.running(), queue.waiting()), (running, waiting.len()));
                prop_assert!(running <= turns && waiting.len() <= most);
                prop_assert!(waiting.is_empty() || running == turns);
                prop_assert_eq!(queue.owners.len(), queue.order.len());
                prop_assert_eq!(queue.lanes.len(), queue.owners.values().map(|of_owner| of_owner.order.len()).sum::<usize>());
                prop_assert_eq!(queue.waiting, queue.owners.values().map(|of_owner| of_owner.number).sum::<usize>());
            }
        }
    }
}
