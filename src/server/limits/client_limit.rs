//! A limit of each client, and whether there is more than one client.

use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};

/// Whether all keys belong to one name: then there is no other client that a share would protect.
/// Keys may change while the server runs.
#[derive(Clone, Debug, Default)]
pub struct SoleClient(Arc<AtomicBool>);

impl SoleClient {
    /// Says what the keys are now.
    pub fn set(&self, is_sole: bool) {
        self.0.store(is_sole, Ordering::Relaxed);
    }
}

/// What one client may use of a total: all of it while it is the only one.
#[derive(Clone, Debug)]
pub struct ClientLimit {
    limit: u64,
    sole: SoleClient,
}

impl ClientLimit {
    /// A limit that does not apply to the only client.
    pub fn new(limit: u64, sole: &SoleClient) -> Self {
        Self {
            limit,
            sole: sole.clone(),
        }
    }

    /// The limit as it is now.
    pub fn get(&self) -> u64 {
        if self.sole.0.load(Ordering::Relaxed) {
            u64::MAX
        } else {
            self.limit
        }
    }
}

impl From<u64> for ClientLimit {
    /// A limit that always applies.
    fn from(limit: u64) -> Self {
        Self {
            limit,
            sole: SoleClient::default(),
        }
    }
}
