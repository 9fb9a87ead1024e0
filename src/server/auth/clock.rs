//! The time of day by which tokens begin and end. Tests move it instead of waiting.

use std::time::{Duration, SystemTime};

use tokio::sync::watch;
use tokio::time::{sleep, timeout};

/// The longest sleep: the time of day may be set meanwhile.
const LONGEST_SLEEP: Duration = Duration::from_secs(60);

/// The time of day, and how far tests have moved it.
#[derive(Debug)]
pub struct Clock(watch::Sender<Moved>);

#[derive(Clone, Copy, Debug)]
enum Moved {
    By(Duration),
    /// It stands still, so long after 1970.
    To(Duration),
}

impl Default for Clock {
    fn default() -> Self {
        Self(watch::Sender::new(Moved::By(Duration::ZERO)))
    }
}

impl Clock {
    /// The time now.
    pub fn now(&self) -> SystemTime {
        match *self.0.borrow() {
            Moved::By(ahead) => SystemTime::now() + ahead,
            Moved::To(since) => SystemTime::UNIX_EPOCH + since,
        }
    }

    /// Seconds since 1970.
    pub fn seconds(&self) -> u64 {
        self.now()
            .duration_since(SystemTime::UNIX_EPOCH)
            .map_or(0, |since| since.as_secs())
    }

    /// Moves the clock, for tests.
    pub fn advance(&self, by: Duration) {
        self.0.send_modify(|moved| {
            *moved = match *moved {
                Moved::By(ahead) => Moved::By(ahead + by),
                Moved::To(since) => Moved::To(since + by),
            }
        });
    }

    /// Stops the clock at a time since 1970, for tests.
    pub fn set(&self, since: Duration) {
        self.0.send_replace(Moved::To(since));
    }

    /// Waits until a time of day.
    pub(super) async fn reached(&self, at: SystemTime) {
        let mut moved = self.0.subscribe();
        while let Ok(left) = at.duration_since(self.now()) {
            // Without the smallest step, the last look would come a moment before the time.
            let left = left.min(LONGEST_SLEEP) + Duration::from_millis(1);
            // A sleep that ends and a clock that moves both lead to another look.
            if timeout(left, moved.changed())
                .await
                .is_ok_and(|moved| moved.is_err())
            {
                sleep(left).await;
            }
        }
    }
}
