//! The doors: who is let in, how many, how often. No HTTP here but the name of what a request says; the layers around routes and connections ask.

pub mod cors;
pub mod hosts;
pub mod keys;
#[cfg(feature = "tls")]
pub mod tls;
#[cfg(not(feature = "tls"))]
#[path = "no_tls.rs"]
pub mod tls;

use std::io::Read as _;
use std::net::IpAddr;
use std::path::Path;
use std::sync::Arc;
use std::time::Instant;

use tokio::sync::watch;

use crate::client::{Owner, Tenant};
use crate::limits::connections::ConnectionLimiter;
use crate::limits::rate_limit::RateLimit;
use crate::problem::{Code, Problem};
use keys::{Credential, Keys};

/// What decides at the doors.
#[derive(Debug)]
pub struct AccessControl {
    /// None where no keys are configured.
    keys: Option<watch::Sender<Arc<Keys>>>,
    by_address: Option<RateLimit<Tenant>>,
    by_owner: Option<RateLimit<Tenant>>,
    places: ConnectionLimiter,
}

impl AccessControl {
    /// Doors as configured.
    #[must_use]
    pub fn new(keys: Option<Keys>, rate_per_address: Option<u32>, rate_per_key: Option<u32>, places: ConnectionLimiter) -> Self {
        Self {
            keys: keys.map(|keys| watch::Sender::new(Arc::new(keys))),
            by_address: rate_per_address.map(RateLimit::new),
            by_owner: rate_per_key.map(RateLimit::new),
            places,
        }
    }

    /// Places for connections.
    #[must_use]
    pub const fn places(&self) -> &ConnectionLimiter {
        &self.places
    }

    /// Other keys from now on.
    pub fn replace_keys(&self, new: Keys) {
        if let Some(keys) = &self.keys {
            keys.send_replace(Arc::new(new));
        }
    }

    /// Waits until the pass is good no more.
    pub async fn revoked(&self, pass: Credential) {
        let revoked = async { self.keys.as_ref()?.subscribe().wait_for(|keys| !keys.is_valid(pass)).await.is_ok().then_some(()) };
        // Without keys none can be revoked, and the sender lives as long as `self`.
        if revoked.await.is_none() {
            std::future::pending().await
        }
    }

    /// Whose sessions are meant by who comes from this address with this key.
    ///
    /// # Errors
    /// [`Code::Unauthorized`], [`Code::Forbidden`], [`Code::RateLimited`].
    pub fn admit(&self, address: IpAddr, key: Option<&str>) -> Result<(Owner, Credential), Problem> {
        let now = Instant::now();
        // The address first: guesses count too.
        count(self.by_address.as_ref(), Tenant::of_address(address), now)?;
        let Some(keys) = &self.keys else { return Ok((Owner::ANYBODY, Credential::ANYBODY)) };
        let keys = Arc::clone(&keys.borrow());
        let Some(key) = key else {
            return Err(Problem::new(Code::Unauthorized, "this server wants a key: Authorization: Bearer KEY"));
        };
        let (owner, pass) = keys.look_up(key).ok_or_else(|| Problem::new(Code::Forbidden, "the key is not one of this server's"))?;
        count(self.by_owner.as_ref(), Tenant::Key(owner), now)?;
        Ok((owner, pass))
    }
}

/// Takes one of whoever asks.
fn count(rates: Option<&RateLimit<Tenant>>, who: Tenant, now: Instant) -> Result<(), Problem> {
    let Some(Err(seconds)) = rates.map(|rates| rates.take(who, now)) else { return Ok(()) };
    Err(Problem::new(Code::RateLimited, "more requests a second than one client may send").retry_after(seconds))
}

/// A small file.
///
/// # Errors
/// It cannot be read, or is larger than `most` bytes.
pub fn read_bounded(path: &Path, most: u64) -> Result<Vec<u8>, String> {
    let mut bytes = Vec::new();
    let file = std::fs::File::open(path).map_err(|e| e.to_string())?;
    file.take(most + 1).read_to_end(&mut bytes).map_err(|e| e.to_string())?;
    if bytes.len() as u64 > most { Err(format!("larger than {most} bytes")) } else { Ok(bytes) }
}
