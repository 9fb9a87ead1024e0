use std::collections::BTreeMap;
use std::net::Ipv4Addr;
use std::time::Duration;

use proptest::prelude::*;

use super::usage::{HALF_LIFE, MANY_CLIENTS};
use super::*;
use crate::client::Owner;

/// The client at an address, without a key.
fn at(n: u8) -> Client {
    Client {
        address: Ipv4Addr::new(192, 0, 2, n).into(),
        ..Client::default()
    }
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
    assert_eq!(
        (
            busy.queue.waiting(),
            busy.queue.running(),
            busy.queue.usage.len() + busy.queue.payers.len()
        ),
        (0, 0, 0)
    );
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
    assert_eq!(
        busy.arrive(session(2), 21),
        Arrival::Replaces(4, 20),
        "a newer pose takes the place of an older one"
    );
    assert_eq!(busy.arrive(client(3), 30), Arrival::Replaces(5, 11));
    assert!(busy.queue.is_full());
    assert_eq!(busy.arrive(client(4), 40), Arrival::Rejected);
    assert_eq!(busy.served(), [12, 21, 30]);
}

#[test]
fn many_sessions_of_one_client_keep_no_other_out() {
    let keyed = |owner: u8| Client {
        owner: Owner::from_bytes([owner; 16]),
        ..Client::default()
    };
    // With keys the name counts, without keys the address.
    for [one, other] in [[keyed(1), keyed(2)], [at(1), at(2)]] {
        let mut busy = busy(4);
        for n in 0..4 {
            busy.arrive(QueueKey::session(one, id(n)), u32::from(n));
        }
        assert!(
            busy.queue.rejects(QueueKey::session(one, id(9)))
                && !busy.queue.rejects(QueueKey::session(other, id(10)))
        );
        assert_eq!(
            busy.arrive(QueueKey::session(other, id(10)), 20),
            Arrival::Replaces(4, 3)
        );
        assert_eq!(
            busy.arrive(QueueKey::session(other, id(11)), 21),
            Arrival::Replaces(5, 2)
        );
        assert_eq!(
            busy.arrive(QueueKey::session(other, id(12)), 22),
            Arrival::Rejected
        );
        assert_eq!(
            busy.served(),
            [0, 20, 1, 21],
            "clients take permits, however many sessions each has"
        );
    }
}

#[test]
fn who_leaves_is_not_served() {
    let mut busy = busy(10);
    let Arrival::Waits(first) = busy.arrive(session(1), 10) else {
        panic!()
    };
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
    let runs = |queue: &mut FairQueue<u32>, n: u8| {
        queue.arrive(client(n), now, u32::from(n)) == Arrival::Runs
    };
    assert!(
        runs(&mut queue, 1) && runs(&mut queue, 1) && !runs(&mut queue, 1),
        "as many permits as workers, and no more"
    );
    assert!(
        runs(&mut queue, 2),
        "another client does not wait for the end of those"
    );
    assert!(!runs(&mut queue, 3) && queue.running() == 2 + SPARE_PERMITS);
    // The spare turn is free: of those who wait only client 3 has none.
    queue.end(at(2).tenant(), now);
    assert_eq!(queue.next(now), Some((at(3).tenant(), 3)));
    assert_eq!(queue.next(now), None);
}

const MS: Duration = Duration::from_millis(1);

/// Clients that always have requests waiting, each of a given number of ms, at `permits` permits;
/// the worker time that each gets in a minute.
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
            while queue
                .usage
                .get(&at(*n).tenant())
                .is_none_or(|usage| usage.waiting < 3)
            {
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
        for costs in [
            &[(1, 2000), (2, 5)][..],
            &[(1, 500), (2, 20), (3, 20)],
            &[(1, 7), (2, 9)],
        ] {
            let got = minute(permits, costs);
            let (least, most) = (got.values().min().unwrap(), got.values().max().unwrap());
            eprintln!(
                "{permits} permits, (client, ms a request) {costs:?}: worker time in a minute \
                    {got:?} ms"
            );
            assert!(
                got.len() == costs.len() && *most <= *least * 3 / 2,
                "{permits} permits, {costs:?}: {got:?}"
            );
        }
    }
}

/// A job that runs or has given way.
struct Job {
    client: u8,
    /// Work that is left, and the end of its turn, ms.
    left: u32,
    turn: u32,
}

const TURN: u32 = 100;

/// `attackers` clients whose requests take `cost` ms, and of which always two wait, at two permits;
/// one client that sends a request of 20 ms each second. Jobs give way at the end of their turns.
/// Returns how long each request of that client took, ms.
fn beside(attackers: u8, cost: u32) -> Vec<u32> {
    const CALM: u8 = 255;
    const PERMITS: usize = 2;
    let (mut queue, start) = (FairQueue::new(PERMITS, 1000), Instant::now());
    let (mut running, mut paused, mut took): (Vec<Job>, BTreeMap<u32, Job>, _) =
        (Vec::new(), BTreeMap::new(), Vec::new());
    let (mut asked, mut next_paused) = (None, 1000);
    for ms in 0..30_000 {
        let now = start + ms * MS;
        running.iter_mut().for_each(|job| job.left -= 1);
        let ended: Vec<Job> = running.extract_if(.., |job| job.left == 0).collect();
        for Job { client, .. } in ended {
            queue.end(at(client).tenant(), now);
            if client == CALM {
                took.push(ms - asked.take().unwrap());
            }
        }
        let is_over = |job: &Job| job.turn <= ms && queue.gives_way(at(job.client).tenant(), now);
        if let Some(over) = running.iter().position(is_over) {
            let job = running.swap_remove(over);
            queue.pause(at(job.client).tenant(), now, next_paused);
            paused.insert(next_paused, job);
            next_paused += 1;
        }
        let job = |client: u8| Job {
            client,
            left: if client == CALM { 20 } else { cost },
            turn: ms + TURN,
        };
        for client in 0..attackers {
            while queue
                .usage
                .get(&at(client).tenant())
                .is_none_or(|usage| usage.waiting < 2)
            {
                if queue.arrive(QueueKey::client(at(client)), now, client.into()) == Arrival::Runs {
                    running.push(job(client));
                }
            }
        }
        if ms % 1000 == 500 && asked.is_none() {
            asked = Some(ms);
            if queue.arrive(client(CALM), now, CALM.into()) == Arrival::Runs {
                running.push(job(CALM));
            }
        }
        while let Some((_, waiter)) = queue.next(now) {
            let resumed = paused.remove(&waiter).map(|job| Job {
                turn: ms + TURN,
                ..job
            });
            running.push(resumed.unwrap_or_else(|| job(u8::try_from(waiter).unwrap())));
        }
        assert!(running.len() <= PERMITS + SPARE_PERMITS && queue.paused() == paused.len());
    }
    took
}

#[test]
fn many_clients_with_long_requests_delay_a_short_one_no_more_than_one_does() {
    for cost in [9_000, 60_000] {
        for attackers in [1, 3, 30] {
            let took = beside(attackers, cost);
            let worst = *took.iter().max().unwrap();
            eprintln!(
                "{attackers} clients with requests of {cost} ms: {} answers of 20 ms, the last \
                    after {worst} ms",
                took.len()
            );
            assert!(
                took.len() >= 29 && worst <= 20 + TURN,
                "{attackers} clients, {cost} ms: {took:?}"
            );
        }
    }
}

#[test]
fn a_job_gives_way_to_one_that_has_used_less_and_goes_on_afterwards() {
    let (mut queue, start) = (FairQueue::new(1, 9), Instant::now());
    let second = start + 1000 * MS;
    for n in [1, 2] {
        assert_eq!(queue.arrive(client(n), start, n.into()), Arrival::Runs);
    }
    assert!(!queue.gives_way(at(1).tenant(), second), "nobody waits");
    assert_eq!(queue.arrive(client(1), second, 1), Arrival::Waits(0));
    assert!(
        !queue.gives_way(at(1).tenant(), second),
        "a client does not give way to itself"
    );
    assert_eq!(queue.arrive(client(3), second, 3), Arrival::Waits(1));
    assert!(queue.gives_way(at(1).tenant(), second) && queue.gives_way(at(2).tenant(), second));
    queue.pause(at(1).tenant(), second, 11);
    assert_eq!(queue.next(second), Some((at(3).tenant(), 3)));
    assert!(
        !queue.gives_way(at(3).tenant(), second),
        "it has used nothing"
    );
    assert_eq!((queue.next(second), queue.paused()), (None, 1));
    queue.end(at(3).tenant(), second + MS);
    assert_eq!(
        queue.next(second + MS),
        Some((at(1).tenant(), 11)),
        "before the other request of its client"
    );
    queue.end(at(1).tenant(), second + 2 * MS);
    assert_eq!(queue.next(second + 2 * MS), Some((at(1).tenant(), 1)));
    // A job that has waited too long goes on beyond the permits, and the next to end is not
    // replaced.
    let id = queue.pause(at(1).tenant(), second, 11);
    for n in [4, 5] {
        assert_eq!(
            queue.arrive(client(n), second, n.into()) == Arrival::Runs,
            n == 4
        );
    }
    queue.resume(id, second);
    queue.resume(id, second);
    assert_eq!(
        (queue.running(), queue.paused(), queue.next(second)),
        (3, 0, None)
    );
    queue.end(at(4).tenant(), second);
    assert_eq!(queue.next(second), None);
    queue.end(at(2).tenant(), second);
    assert_eq!(queue.next(second), Some((at(5).tenant(), 5)));
}

#[test]
fn what_was_used_is_forgotten_and_so_are_clients() {
    let (mut queue, start) = (FairQueue::<u32>::new(1, 9), Instant::now());
    let used = |queue: &FairQueue<u32>, n: u8, now: Instant| {
        queue
            .usage
            .get(&at(n).tenant())
            .map(|usage| usage.used(now))
    };
    queue.arrive(client(1), start, 1);
    let now = start + 1000 * MS;
    queue.end(at(1).tenant(), now);
    let one = used(&queue, 1, now).unwrap();
    assert!(
        (0.9..1.0).contains(&one),
        "a little of it is old already: {one}"
    );
    let later = now + Duration::from_secs_f64(HALF_LIFE);
    assert!((used(&queue, 1, later).unwrap() - one / 2.0).abs() < 1e-9);
    queue.arrive(client(2), now, 2);
    queue.end(at(2).tenant(), now + MS);
    assert_eq!(
        used(&queue, 2, now + MS),
        None,
        "a millisecond is not remembered"
    );
    // Thousands of clients, each of whom is remembered for a while.
    let step = 20 * MS;
    for n in 0..10_000_u32 {
        let address = Client {
            address: Ipv4Addr::from_bits(n).into(),
            ..Client::default()
        };
        let now = later + step * n;
        queue.arrive(QueueKey::client(address), now, 0);
        queue.end(address.tenant(), now + step);
        assert!(queue.usage.len() <= 2 * MANY_CLIENTS);
    }
}

proptest! {
    /// Arrivals, ends and departures in any order: never more than are allowed, every request is
    /// called or refused exactly once, and no request waits while there is a turn for it.
    #[test]
    fn everyone_is_accounted_for(steps in prop::collection::vec((0_u8..5, 0_u8..6), 1..400),
        permits in 1_usize..4, most in 0_usize..8) {
        let mut queue: FairQueue<u32> = FairQueue::new(permits, most);
        let (mut running, mut waiting, mut name) = (Vec::new(), Vec::<(QueueKey, u64, u32)>::new(),
            0);
        let mut paused = Vec::new();
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
                        Arrival::Rejected => prop_assert!(running.len() >= permits
                            && waiting.len() == most),
                    }
                }
                2 | 3 if !running.is_empty() => {
                    let tenant = running.swap_remove(usize::from(n) % running.len());
                    if what == 2 {
                        queue.end(tenant, now);
                    } else {
                        name += 1;
                        paused.push((queue.pause(tenant, now, name), name));
                    }
                    while let Some((tenant, next)) = queue.next(now) {
                        let before = waiting.len() + paused.len();
                        waiting.retain(|(key, _, waiter)| *waiter != next || key.tenant != tenant);
                        paused.retain(|(_, waiter)| *waiter != next);
                        prop_assert_eq!(waiting.len() + paused.len(), before - 1);
                        running.push(tenant);
                    }
                }
                _ => {
                    if let Some((key, id, _)) = waiting.pop() {
                        queue.leave(key, id);
                    }
                }
            }
            prop_assert_eq!((queue.running(), queue.waiting(), queue.paused()),
                (running.len(), waiting.len(), paused.len()));
            prop_assert!(running.len() <= permits + SPARE_PERMITS && waiting.len() <= most);
            let running_of = |tenant: Tenant| running.iter().filter(
                |other| **other == tenant).count();
            for (key, ..) in &waiting {
                prop_assert!(running.len() >= permits && (running.len() == permits + SPARE_PERMITS
                    || running_of(key.tenant) > 0));
            }
            let sum = |of: fn(&Usage) -> usize| queue.usage.values().map(of).sum::<usize>();
            prop_assert_eq!(queue.usage.values().filter(|usage| usage.waiting > 0).count(),
                queue.order.len());
            prop_assert_eq!(queue.waiters.len(), sum(|usage| usage.keys.len()));
            prop_assert_eq!((queue.waiting, queue.running), (sum(|usage| usage.waiting),
                sum(|usage| usage.running)));
        }
    }
}

/// The session of a visitor of a key, from one of its addresses.
fn visitor(owner: u8, n: u8, address: u8) -> Client {
    Client {
        owner: Owner::from_bytes([owner; 16]),
        visit: Some([n; 16]),
        ..at(address)
    }
}

fn visit(owner: u8, n: u8) -> QueueKey {
    QueueKey::session(visitor(owner, n, n), id(n))
}

/// One who floods, ten who drag, one key: by order, without a clock. Between two requests of the
/// one who floods, each of the others who waits is served.
#[test]
fn a_visitor_that_floods_waits_for_every_other_of_its_key() {
    let mut busy = busy(200);
    for waiter in 0..100 {
        busy.arrive(QueueKey::client(visitor(1, 1, 1)), waiter);
    }
    for n in 2..12 {
        busy.arrive(visit(1, n), 1000 + u32::from(n));
        busy.arrive(visit(1, n), 2000 + u32::from(n));
    }
    let served = busy.served();
    assert_eq!(served.len(), 120);
    let last = served.iter().rposition(|waiter| *waiter >= 1000).unwrap();
    assert_eq!(
        last, 21,
        "two of the flood, and twenty of the others: {served:?}"
    );
    assert_eq!(busy.queue.usage.len() + busy.queue.payers.len(), 0);
}

/// What a visitor has used counts: it is not its turn until the others have used as much.
#[test]
fn worker_time_is_shared_between_visitors_and_before_that_between_keys() {
    let (mut queue, start) = (FairQueue::new(1, 9), Instant::now());
    // Visitor 1 of key 1 works for a second, visitor 2 of it for none.
    assert_eq!(queue.arrive(visit(1, 1), start, 0), Arrival::Runs);
    assert_eq!(
        queue.arrive(visit(1, 2), start, 1),
        Arrival::Waits(0),
        "no spare one of its key"
    );
    let second = start + 1000 * MS;
    assert!(queue.gives_way(visitor(1, 1, 1).tenant(), second));
    assert!(!queue.gives_way(visitor(1, 2, 2).tenant(), second));
    assert_eq!(queue.arrive(visit(1, 1), second, 2), Arrival::Waits(1));
    assert_eq!(
        queue.arrive(visit(2, 3), second, 3),
        Arrival::Runs,
        "the spare one, of another key"
    );
    assert_eq!(queue.arrive(visit(2, 4), second, 4), Arrival::Waits(2));
    queue.end(visitor(1, 1, 1).tenant(), second);
    queue.end(visitor(2, 3, 3).tenant(), second + MS);
    let next = |queue: &mut FairQueue<u32>| {
        let (tenant, waiter) = queue.next(second + MS).unwrap();
        queue.end(tenant, second + MS);
        waiter
    };
    // Key 2 has used least; of key 1, visitor 2.
    let served = [next(&mut queue), next(&mut queue), next(&mut queue)];
    assert_eq!(served, [4, 1, 2]);
}

/// Addresses that share a session take turns, and have the share of one visitor together.
#[test]
fn addresses_of_one_visitor_take_turns() {
    let mut busy = busy(20);
    for address in 1..4 {
        let key = QueueKey::session(visitor(1, 1, address), id(1));
        busy.arrive(key, 10 * u32::from(address));
        busy.arrive(key, 10 * u32::from(address) + 1);
    }
    busy.arrive(visit(1, 2), 2);
    assert_eq!(busy.served(), [11, 2, 21, 31, 10, 20, 30]);
}

#[test]
fn a_full_queue_makes_room_among_keys_then_among_visitors() {
    let mut busy = busy(6);
    for n in [1, 1, 1, 2, 3, 4] {
        busy.arrive(QueueKey::client(visitor(1, n, n)), n.into());
    }
    // Another key: the fullest visitor of the fullest key loses its oldest.
    assert_eq!(busy.arrive(visit(2, 9), 9), Arrival::Replaces(6, 1));
    // A visitor of the same key: the fullest of them, as long as there is something to level.
    assert_eq!(busy.arrive(visit(1, 5), 5), Arrival::Replaces(7, 1));
    assert_eq!(
        busy.arrive(QueueKey::client(visitor(1, 6, 6)), 6),
        Arrival::Rejected
    );
    assert!(busy.queue.rejects(QueueKey::client(visitor(1, 6, 6))));
}

/// Jobs that do not give way, such as long drags: the next visitor begins at once.
#[test]
fn one_visitor_never_holds_every_permit() {
    let (mut queue, now) = (FairQueue::new(3, 9), Instant::now());
    for (waiter, arrival) in [
        (0, Arrival::Runs),
        (1, Arrival::Runs),
        (2, Arrival::Waits(0)),
    ] {
        assert_eq!(queue.arrive(visit(1, 1), now, waiter), arrival);
    }
    assert_eq!(
        queue.next(now),
        None,
        "the last permit is for those who hold none"
    );
    assert_eq!(queue.arrive(visit(1, 2), now, 3), Arrival::Runs);
    assert_eq!(queue.arrive(visit(1, 3), now, 4), Arrival::Waits(1));
    assert_eq!(
        queue.arrive(visit(2, 4), now, 5),
        Arrival::Runs,
        "the spare one of another key"
    );
    // When the other visitor ends, the third is before the one that floods.
    queue.end(visitor(1, 2, 2).tenant(), now);
    queue.end(visitor(2, 4, 4).tenant(), now);
    assert_eq!(queue.next(now), Some((visitor(1, 3, 3).tenant(), 4)));
    assert_eq!(queue.next(now), None);
    queue.end(visitor(1, 1, 1).tenant(), now);
    assert_eq!(queue.next(now), None);
    queue.end(visitor(1, 3, 3).tenant(), now);
    assert_eq!(queue.next(now), Some((visitor(1, 1, 1).tenant(), 2)));
    // Keys and addresses take all, as ever.
    let mut queue = FairQueue::new(2, 9);
    for waiter in 0..2 {
        assert_eq!(queue.arrive(session(1), now, waiter), Arrival::Runs);
    }
}
