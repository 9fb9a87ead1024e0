//! From its start to its end a service serves, leaves and stops; never back.

use tokio::sync::watch;

use super::App;
use crate::problem::{Code, Problem};

/// Seconds after which a client may try again: by then a proxy knows another replica.
const RETRY: u32 = 1;

/// Where a service is on its way.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, PartialOrd, Ord)]
enum Phase {
    /// It takes work.
    #[default]
    Serving,
    /// It says that it is not ready, and serves whoever comes all the same: proxies have not noticed yet.
    Leaving,
    /// Nobody comes any more; what has begun is finished.
    Stopping,
    /// What has begun has a moment left.
    Hurrying,
}

/// The phase, and who waits for it to change.
#[derive(Debug, Default)]
pub(crate) struct Phases(watch::Sender<Phase>);

impl Phases {
    fn move_on_to(&self, phase: Phase) {
        self.0.send_modify(|now| *now = phase.max(*now));
    }

    fn is_at_least(&self, phase: Phase) -> bool {
        *self.0.borrow() >= phase
    }

    async fn reached(&self, phase: Phase) {
        // The sender lives as long as `self`, so waiting cannot fail.
        let _ = self.0.subscribe().wait_for(|now| *now >= phase).await;
    }
}

impl App {
    /// The service will stop soon: it is not ready for newcomers any more, and serves them.
    pub fn leave(&self) {
        self.0.phases.move_on_to(Phase::Leaving);
    }

    /// The service stops: drag sockets close.
    pub fn stop(&self) {
        self.0.phases.move_on_to(Phase::Stopping);
    }

    /// The service stops, and soon: no delay and no grace are waited for any more.
    pub fn hurry(&self) {
        self.0.phases.move_on_to(Phase::Hurrying);
    }

    /// Whether the service will stop soon: connections are better not kept for another request.
    #[must_use]
    pub fn is_leaving(&self) -> bool {
        self.0.phases.is_at_least(Phase::Leaving)
    }

    /// Waits until the service is stopping.
    pub async fn stopping(&self) {
        self.0.phases.reached(Phase::Stopping).await;
    }

    /// Waits until the service stops in a hurry.
    pub async fn hurrying(&self) {
        self.0.phases.reached(Phase::Hurrying).await;
    }

    /// Whether newcomers are asked for.
    pub(crate) fn stays(&self) -> Result<(), Problem> {
        if self.is_leaving() { Err(leaving()) } else { Ok(()) }
    }

    /// Whether a drag socket may be opened. While the service only leaves it may: to be refused is worse than to be closed in a moment.
    pub(crate) fn opens_sockets(&self) -> Result<(), Problem> {
        if self.0.phases.is_at_least(Phase::Stopping) { Err(leaving()) } else { Ok(()) }
    }
}

fn leaving() -> Problem {
    Problem::new(Code::Overloaded, "the service is stopping").retry_after(RETRY)
}
