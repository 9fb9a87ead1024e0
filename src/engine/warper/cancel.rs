//! Ends long work from another thread.

use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};

/// Ends the work that was given it or a clone of it: that returns
/// [`WarpError::Cancelled`](crate::warp::WarpError::Cancelled) within milliseconds. Cheap to clone.
///
/// ```
/// use mlswarp::{Cancel, Warper};
/// let cancel = Cancel::new();
/// let warper = Warper::new([640, 480], &[[100.0, 100.0]])?.cancelled_by(&cancel);
/// // From another thread, as a rule.
/// cancel.cancel();
/// assert!(warper.pose(&[[120.0, 100.0]]).is_err());
/// # Ok::<(), mlswarp::warp::WarpError>(())
/// ```
#[derive(Clone, Debug, Default)]
pub struct Cancel(Arc<AtomicBool>);

impl Cancel {
    /// Nothing is cancelled yet.
    #[must_use]
    pub fn new() -> Self {
        Self::default()
    }

    /// Ends the work, and all that begins later.
    pub fn cancel(&self) {
        self.0.store(true, Ordering::Relaxed);
    }

    /// Whether [`Cancel::cancel`] has been called.
    #[must_use]
    pub fn is_cancelled(&self) -> bool {
        self.0.load(Ordering::Relaxed)
    }
}
