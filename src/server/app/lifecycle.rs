//! The phases of a service: serving, leaving, stopping, hurrying. A service never returns to an
//! earlier phase.

use tokio::sync::watch;

use crate::problem::{Code, Problem};

/// Seconds after which a client may retry: by then a proxy uses another replica.
const RETRY_SECONDS: u32 = 1;

#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, PartialOrd, Ord)]
enum Phase {
    #[default]
    Serving,
    /// Not ready any more; new requests are still served, because proxies have not noticed yet.
    Leaving,
    /// New connections are refused; running requests may finish.
    Stopping,
    /// Delays and grace periods end now.
    Hurrying,
}

/// The current phase, and the tasks that wait for a later one.
#[derive(Debug, Default)]
pub struct Lifecycle(watch::Sender<Phase>);

impl Lifecycle {
    /// Announces the stop: the service is not ready any more, but still serves new requests.
    pub fn leave(&self) {
        self.advance_to(Phase::Leaving);
    }

    /// Stops: drag sockets close.
    pub fn stop(&self) {
        self.advance_to(Phase::Stopping);
    }

    /// Stops immediately, without delay and grace period.
    pub fn hurry(&self) {
        self.advance_to(Phase::Hurrying);
    }

    /// Whether the service will stop soon, so that connections should not be kept for another
    /// request.
    pub fn is_leaving(&self) -> bool {
        self.is_at_least(Phase::Leaving)
    }

    /// Waits for [`Lifecycle::stop`].
    pub async fn stopping(&self) {
        self.reached(Phase::Stopping).await;
    }

    /// Waits for [`Lifecycle::hurry`].
    pub async fn hurrying(&self) {
        self.reached(Phase::Hurrying).await;
    }

    /// Fails once the service is leaving.
    pub(crate) fn require_serving(&self) -> Result<(), Problem> {
        if self.is_leaving() {
            Err(stopping())
        } else {
            Ok(())
        }
    }

    /// Fails once the service is stopping. A leaving service still opens drag sockets: closing one
    /// soon is better than refusing it.
    pub(crate) fn require_running(&self) -> Result<(), Problem> {
        if self.is_at_least(Phase::Stopping) {
            Err(stopping())
        } else {
            Ok(())
        }
    }

    fn advance_to(&self, phase: Phase) {
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

fn stopping() -> Problem {
    Problem::new(Code::Overloaded, "the server is stopping").retry_after(RETRY_SECONDS)
}
