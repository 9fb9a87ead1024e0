//! What clients and visitors have used, and the order that follows from it.

use std::cmp::Ordering;
use std::collections::{HashMap, VecDeque};
use std::time::Instant;

use super::QueueKey;
use crate::client::Tenant;

/// Seconds after which worker time counts half.
pub(super) const HALF_LIFE: f64 = 10.0;
/// A client without requests that has used fewer seconds is forgotten.
const NEGLIGIBLE_SECONDS: f64 = 0.01;
/// Above this many clients, those with negligible use are removed.
pub(super) const MANY_CLIENTS: usize = 1024;

/// What one client uses.
#[derive(Debug)]
pub(super) struct Usage {
    pub(super) waiting: usize,
    /// Keys with waiting requests, the next one first.
    pub(super) keys: VecDeque<QueueKey>,
    pub(super) running: usize,
    /// Recently used worker time in seconds, as of `at`. Since then `running` requests have run.
    used: f64,
    pub(super) at: Instant,
}

impl Usage {
    fn new(now: Instant) -> Self {
        Self {
            waiting: 0,
            keys: VecDeque::new(),
            running: 0,
            used: 0.0,
            at: now,
        }
    }

    /// Recently used worker time, as of now.
    pub(super) fn used(&self, now: Instant) -> f64 {
        // An exponential decay needs no list of past jobs and no clock that ticks: only the last
        // value and its time.
        let half_lives = now.saturating_duration_since(self.at).as_secs_f64() / HALF_LIFE;
        let kept = (-half_lives).exp2();
        // The integral of what the running requests have added since, each moment weighted by its
        // age.
        let added = (1.0 - kept) * HALF_LIFE / std::f64::consts::LN_2;
        self.used * kept + self.running as f64 * added
    }

    /// Brings `used` up to date, before `running` changes.
    pub(super) fn update(&mut self, now: Instant) {
        (self.used, self.at) = (self.used(now), now);
    }

    pub(super) fn is_negligible(&self, now: Instant) -> bool {
        self.waiting == 0 && self.running == 0 && self.used(now) < NEGLIGIBLE_SECONDS
    }
}

/// How much a client with its visitors, and one of these, has used and runs.
#[derive(Clone, Copy)]
pub(super) struct Rank {
    pub(super) payer: (f64, usize),
    pub(super) own: (f64, usize),
}

pub(super) fn by_rank(a: &Rank, b: &Rank) -> Ordering {
    let levels = [(a.payer, b.payer), (a.own, b.own)];
    let mut orders = levels
        .iter()
        .map(|((used, running), (other, others))| used.total_cmp(other).then(running.cmp(others)));
    orders
        .find(|order| order.is_ne())
        .unwrap_or(Ordering::Equal)
}

pub(super) fn usage_of(
    of: &mut HashMap<Tenant, Usage>,
    tenant: Tenant,
    now: Instant,
) -> &mut Usage {
    // At powers of two, so that a sweep over all costs each newcomer a constant time on average.
    if of.len() >= MANY_CLIENTS && of.len().is_power_of_two() {
        of.retain(|_, usage| !usage.is_negligible(now));
    }
    of.entry(tenant).or_insert_with(|| Usage::new(now))
}
