//! Turns on the runtime's threads, which serve all connections: the tasks of one address together
//! get no more time than those of another one, however many connections and streams it has.
//!
//! Time is divided into rounds. In each round the tasks of an address are polled until they have
//! used [`TURN_TIME`]; others of them wait for the next round, in the order in which they became
//! ready. A round lasts as long as the runtime needs for everything that is ready, so an address
//! that is alone gets all of the time. Half of the time that passes is forgiven, so that a client
//! that asks for one thing after another seldom waits for a round.

use std::cell::Cell;
use std::collections::{HashMap, VecDeque};
use std::net::IpAddr;
use std::pin::Pin;
use std::sync::atomic::{AtomicU64, Ordering};
use std::sync::{Arc, Mutex, MutexGuard, PoisonError, Weak};
use std::task::{Context, Poll, Waker};
use std::time::{Duration, Instant};

use crate::client::Tenant;

/// Time of an address in a round. The poll that exceeds it is finished.
const TURN_TIME: Duration = Duration::from_micros(100);
/// Number of addresses from which those without a task are removed.
const MANY_ADDRESSES: usize = 1024;

thread_local! {
    /// The poll that this thread makes in a turn: its beginning, and whether it used its socket.
    static POLL: Cell<Option<(Instant, bool)>> = const { Cell::new(None) };
}

/// Whether the poll that is about to use its socket has taken [`TURN_TIME`]: what follows, such as
/// the writing of a response after the work on its request, waits for another poll, so that other
/// tasks come in between. The first use in a poll never waits, so that every poll makes progress.
pub(super) fn is_poll_over() -> bool {
    let Some((began, has_used)) = POLL.get() else {
        return false;
    };
    POLL.set(Some((began, true)));
    has_used && began.elapsed() >= TURN_TIME
}

/// A poll in a turn; its end, also by a panic.
struct PollInTurn(Option<(Instant, bool)>);

impl PollInTurn {
    fn begin(began: Instant) -> Self {
        Self(POLL.replace(Some((began, false))))
    }
}

impl Drop for PollInTurn {
    fn drop(&mut self) {
        POLL.set(self.0);
    }
}

/// The turns of all addresses. Clones share them.
#[derive(Clone, Debug, Default)]
pub(crate) struct Turns(Arc<Rounds>);

#[derive(Debug, Default)]
struct Rounds {
    /// The number of the round.
    round: AtomicU64,
    addresses: Mutex<HashMap<Tenant, Weak<AddressQueue>>>,
    next: Mutex<NextRound>,
}

#[derive(Debug, Default)]
struct NextRound {
    /// Addresses with tasks that wait for it.
    addresses: Vec<Arc<AddressQueue>>,
    /// Whether a task begins rounds.
    is_begun: bool,
}

/// The turns of one address. Clones share them.
#[derive(Clone, Debug, Default)]
pub(crate) struct AddressTurns(Arc<AddressQueue>);

#[derive(Debug, Default)]
struct AddressQueue {
    rounds: Arc<Rounds>,
    state: Mutex<State>,
}

#[derive(Debug, Default)]
struct State {
    /// The round in which an address last had a turn, and the time that it has used in it.
    round: u64,
    used: Duration,
    /// Until when time was forgiven.
    forgiven: Option<Instant>,
    /// Tasks that wait for a turn, and whether the next round knows of them.
    waiting: VecDeque<Arc<Place>>,
    is_listed: bool,
}

/// The place of a waiting task; its waker, until the task is called.
#[derive(Debug)]
struct Place(Mutex<Option<Waker>>);

fn lock<T>(mutex: &Mutex<T>) -> MutexGuard<'_, T> {
    // No change panics half-way.
    mutex.lock().unwrap_or_else(PoisonError::into_inner)
}

impl Turns {
    /// The turns of an address: an IPv4 address, or a /64 of IPv6.
    pub(crate) fn of(&self, address: IpAddr) -> AddressTurns {
        let mut addresses = lock(&self.0.addresses);
        if addresses.len() >= MANY_ADDRESSES && addresses.len().is_power_of_two() {
            addresses.retain(|_, known| known.strong_count() > 0);
        }
        let known = addresses.entry(Tenant::of_address(address)).or_default();
        AddressTurns(known.upgrade().unwrap_or_else(|| {
            let new = Arc::new(AddressQueue {
                rounds: Arc::clone(&self.0),
                state: Mutex::default(),
            });
            *known = Arc::downgrade(&new);
            new
        }))
    }
}

impl Rounds {
    /// Begins rounds while tasks wait for one.
    async fn run(self: Arc<Self>) {
        loop {
            // Everything that is ready is polled first.
            tokio::task::yield_now().await;
            self.round.fetch_add(1, Ordering::Relaxed);
            let mut addresses = std::mem::take(&mut lock(&self.next).addresses);
            addresses.retain(|address| address.begin_round());
            let mut next = lock(&self.next);
            next.addresses.append(&mut addresses);
            next.is_begun = !next.addresses.is_empty();
            if !next.is_begun {
                return;
            }
        }
    }
}

impl AddressQueue {
    /// The state in this round.
    fn now(&self) -> MutexGuard<'_, State> {
        let (mut state, round) = (lock(&self.state), self.rounds.round.load(Ordering::Relaxed));
        if state.round != round {
            (state.round, state.used) = (round, Duration::ZERO);
        }
        state
    }

    /// Calls a waiting task in a new round. Whether more of them wait.
    fn begin_round(&self) -> bool {
        let mut state = self.now();
        let next = state.next();
        state.is_listed = !state.waiting.is_empty();
        let is_listed = state.is_listed;
        drop(state);
        next.into_iter().for_each(Waker::wake);
        is_listed
    }

    /// A place among the waiting tasks, unless the address has time left in this round.
    fn wait(self: &Arc<Self>, waker: &Waker) -> Option<Arc<Place>> {
        let mut state = self.now();
        if state.waiting.is_empty() {
            state.forgive();
            if state.used < TURN_TIME {
                return None;
            }
        }
        let place = Arc::new(Place(Mutex::new(Some(waker.clone()))));
        state.waiting.push_back(Arc::clone(&place));
        let is_listed = std::mem::replace(&mut state.is_listed, true);
        drop(state);
        if !is_listed {
            let mut next = lock(&self.rounds.next);
            next.addresses.push(Arc::clone(self));
            if !std::mem::replace(&mut next.is_begun, true) {
                tokio::spawn(Arc::clone(&self.rounds).run());
            }
        }
        Some(place)
    }

    /// A task was polled for this time. The next one is called if there is time left.
    fn used(&self, time: Duration) {
        let mut state = self.now();
        state.used += time;
        let next = if state.used < TURN_TIME {
            state.next()
        } else {
            None
        };
        drop(state);
        next.into_iter().for_each(Waker::wake);
    }
}

impl State {
    fn forgive(&mut self) {
        let now = Instant::now();
        let passed = self
            .forgiven
            .replace(now)
            .map_or(Duration::MAX, |forgiven| {
                now.saturating_duration_since(forgiven)
            });
        self.used = self.used.saturating_sub(passed / 2);
    }

    /// The next waiting task.
    fn next(&mut self) -> Option<Waker> {
        // A task that was dropped has left its place.
        let place = std::iter::from_fn(|| self.waiting.pop_front())
            .find(|place| Arc::strong_count(place) > 1)?;
        lock(&place.0).take()
    }
}

impl AddressTurns {
    /// The future, polled in the turns of the address.
    pub(crate) fn take<F: Future>(&self, future: F) -> impl Future<Output = F::Output> + use<F> {
        InTurn {
            future: Box::pin(future),
            address: Arc::clone(&self.0),
            place: None,
        }
    }
}

/// The turns of a request's client, for what its connection does not poll in them.
#[derive(Clone, Debug)]
pub(crate) struct RequestTurns {
    pub(crate) turns: Turns,
    /// The connection is a proxy's, and is polled without turns.
    pub(crate) is_of_proxy: bool,
}

/// A future that waits for a turn before it is polled.
struct InTurn<F> {
    future: Pin<Box<F>>,
    address: Arc<AddressQueue>,
    place: Option<Arc<Place>>,
}

impl<F: Future> Future for InTurn<F> {
    type Output = F::Output;

    fn poll(mut self: Pin<&mut Self>, cx: &mut Context<'_>) -> Poll<F::Output> {
        let this = &mut *self;
        match &this.place {
            Some(place) => {
                let mut waker = lock(&place.0);
                if let Some(waker) = &mut *waker {
                    // Something else has woken the task.
                    waker.clone_from(cx.waker());
                    return Poll::Pending;
                }
            }
            None => {
                this.place = this.address.wait(cx.waker());
                if this.place.is_some() {
                    return Poll::Pending;
                }
            }
        }
        this.place = None;
        let began = Instant::now();
        let poll = PollInTurn::begin(began);
        let polled = this.future.as_mut().poll(cx);
        drop(poll);
        this.address.used(began.elapsed());
        polled
    }
}

#[cfg(test)]
mod tests {
    use futures_util::FutureExt as _;

    use super::*;
    use std::sync::atomic::{AtomicBool, AtomicUsize};

    fn address(n: u8) -> IpAddr {
        [192, 0, 2, n].into()
    }

    /// Takes so much time whenever it is polled, and is always ready.
    async fn busy(time: Duration, polls: &AtomicUsize, is_over: &AtomicBool) {
        while !is_over.load(Ordering::Relaxed) {
            let began = Instant::now();
            while began.elapsed() < time {}
            polls.fetch_add(1, Ordering::Relaxed);
            tokio::task::yield_now().await;
        }
    }

    /// Runs this number of busy tasks of an address beside one of another, until that was polled a
    /// hundred times; how often the others were.
    async fn beside(tasks: usize, time: Duration) -> usize {
        let (turns, polls, own) = (
            Turns::default(),
            Arc::<AtomicUsize>::default(),
            Arc::<AtomicUsize>::default(),
        );
        let is_over = Arc::<AtomicBool>::default();
        let spawn = |n: u8, time: Duration, polls: &Arc<AtomicUsize>| {
            let (polls, is_over) = (Arc::clone(polls), Arc::clone(&is_over));
            tokio::spawn(
                turns
                    .of(address(n))
                    .take(async move { busy(time, &polls, &is_over).await }),
            )
        };
        let mut spawned: Vec<_> = (0..tasks).map(|_| spawn(1, time, &polls)).collect();
        tokio::task::yield_now().await;
        let before = polls.load(Ordering::Relaxed);
        spawned.push(spawn(2, Duration::ZERO, &own));
        while own.load(Ordering::Relaxed) < 100 {
            tokio::task::yield_now().await;
        }
        let others = polls.load(Ordering::Relaxed) - before;
        is_over.store(true, Ordering::Relaxed);
        for task in spawned {
            task.await.unwrap();
        }
        others
    }

    #[tokio::test]
    async fn many_tasks_of_an_address_get_no_more_than_one_of_another() {
        let (few, many) = (beside(1, TURN_TIME).await, beside(300, TURN_TIME).await);
        eprintln!("polls beside 100 of another address: {few} of one task, {many} of 300");
        assert!(many <= 3 * few.max(100), "{many} polls beside 100");
    }

    #[tokio::test]
    async fn a_poll_that_takes_long_uses_its_socket_once() {
        assert!(!is_poll_over(), "outside of a turn");
        let uses = async {
            let first = is_poll_over();
            let began = Instant::now();
            while began.elapsed() < TURN_TIME {}
            let second = is_poll_over();
            tokio::task::yield_now().await;
            [first, second, is_poll_over()]
        };
        let uses = tokio::spawn(Turns::default().of(address(1)).take(uses));
        assert_eq!(uses.await.unwrap(), [false, true, false]);
        let panics = Turns::default()
            .of(address(1))
            .take(async { panic!("in a poll") });
        assert!(
            std::panic::AssertUnwindSafe(panics)
                .catch_unwind()
                .await
                .is_err()
        );
        assert!(POLL.get().is_none());
    }

    #[tokio::test]
    async fn an_address_alone_gets_all_of_the_time_and_its_tasks_take_turns() {
        let (turns, is_over) = (Turns::default(), Arc::<AtomicBool>::default());
        let polls: Vec<Arc<AtomicUsize>> = (0..20).map(|_| Arc::default()).collect();
        let tasks: Vec<_> = polls
            .iter()
            .map(|polls| {
                let (polls, is_over) = (Arc::clone(polls), Arc::clone(&is_over));
                tokio::spawn(
                    turns
                        .of(address(1))
                        .take(async move { busy(TURN_TIME / 5, &polls, &is_over).await }),
                )
            })
            .collect();
        let (mut looks, began) = (0, Instant::now());
        while polls[0].load(Ordering::Relaxed) < 50 && began.elapsed() < Duration::from_secs(60) {
            tokio::task::yield_now().await;
            looks += 1;
        }
        is_over.store(true, Ordering::Relaxed);
        for task in tasks {
            task.await.unwrap();
        }
        let counts: Vec<usize> = polls
            .iter()
            .map(|polls| polls.load(Ordering::Relaxed))
            .collect();
        assert!(
            counts.iter().all(|count| (45..=55).contains(count)),
            "{counts:?} in {looks} looks"
        );
    }

    #[tokio::test]
    async fn a_task_that_is_dropped_while_it_waits_is_passed_over() {
        let of = Turns::default().of(address(1));
        // The turn is over, and will not be forgiven soon.
        of.0.now().forgive();
        of.0.used(Duration::from_secs(60));
        let mut waits: Vec<_> = (0..3)
            .map(|n| Box::pin(of.take(async move { n })))
            .collect();
        for task in &mut waits {
            assert!(task.now_or_never().is_none());
        }
        assert_eq!(lock(&of.0.state).waiting.len(), 3);
        drop(waits.remove(0));
        for (n, task) in waits.into_iter().enumerate() {
            assert_eq!(task.await, n + 1);
        }
        assert!(lock(&of.0.state).waiting.is_empty());
    }

    #[tokio::test]
    async fn addresses_without_tasks_are_forgotten() {
        let turns = Turns::default();
        let kept = turns.of(address(1));
        for n in 0..5000_u32 {
            let _ = turns.of(IpAddr::V4(n.into()));
        }
        assert!(lock(&turns.0.addresses).len() <= 2 * MANY_ADDRESSES);
        assert!(Arc::ptr_eq(&kept.0, &turns.of(address(1)).0));
    }
}
