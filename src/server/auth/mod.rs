//! Access control: keys, rates and the number of connections; the syntax of hosts and origins; TLS.

pub mod cors;
pub mod hosts;
pub mod keys;
#[cfg(feature = "tls")]
pub mod tls;
#[cfg(not(feature = "tls"))]
#[path = "no_tls.rs"]
pub mod tls;

use std::future::pending;
use std::io::Read as _;
use std::net::IpAddr;
use std::path::Path;
use std::sync::Arc;
use std::time::Instant;

use tokio::sync::watch;

use crate::client::Tenant;
use crate::limits::client_limit::SoleClient;
use crate::limits::connections::ConnectionLimiter;
use crate::limits::rate_limit::RateLimit;
use crate::problem::{Code, Problem};
use keys::{Credential, Keys};

/// Decides which requests are admitted.
#[derive(Debug)]
pub struct AccessControl {
    /// None if no keys are configured.
    keys: Option<watch::Sender<Arc<Keys>>>,
    by_address: Option<RateLimit<Tenant>>,
    by_owner: Option<RateLimit<Tenant>>,
    sole: SoleClient,
    connections: ConnectionLimiter,
}

impl AccessControl {
    /// Access control with these limits.
    pub fn new(
        keys: Option<Keys>,
        rate_per_address: Option<u32>,
        rate_per_key: Option<u32>,
        connections: ConnectionLimiter,
    ) -> Self {
        let sole = SoleClient::default();
        sole.set(keys.as_ref().is_some_and(Keys::have_one_owner));
        Self {
            sole,
            keys: keys.map(|keys| watch::Sender::new(Arc::new(keys))),
            by_address: rate_per_address.map(RateLimit::new),
            by_owner: rate_per_key.map(RateLimit::new),
            connections,
        }
    }

    /// The limiter of connections.
    pub const fn connections(&self) -> &ConnectionLimiter {
        &self.connections
    }

    /// Whether all keys belong to one name, now and after they are replaced.
    pub const fn sole_client(&self) -> &SoleClient {
        &self.sole
    }

    /// Replaces the keys.
    pub fn replace_keys(&self, new: Keys) {
        if let Some(keys) = &self.keys {
            self.sole.set(new.have_one_owner());
            keys.send_replace(Arc::new(new));
        }
    }

    /// Waits until the credential is no longer valid.
    pub async fn revoked(&self, credential: Credential) {
        match &self.keys {
            // The wait cannot fail: `self` owns the sender.
            Some(keys) => drop(
                keys.subscribe()
                    .wait_for(|keys| !keys.is_valid(credential))
                    .await,
            ),
            None => pending().await,
        }
    }

    /// The credential of a request from this address with this key.
    /// Errors: [`Code::Unauthorized`], [`Code::Forbidden`], [`Code::RateLimited`].
    pub fn admit(&self, address: IpAddr, key: Option<&str>) -> Result<Credential, Problem> {
        let now = Instant::now();
        // Before the key, so that guesses count.
        take(self.by_address.as_ref(), Tenant::of_address(address), now)?;
        let Some(keys) = &self.keys else {
            return Ok(Credential::ANYBODY);
        };
        let keys = Arc::clone(&keys.borrow());
        let key = key.ok_or_else(|| {
            Problem::new(
                Code::Unauthorized,
                "API key required: send `Authorization: Bearer <key>`",
            )
        })?;
        let credential = keys
            .look_up(key)
            .ok_or_else(|| Problem::new(Code::Forbidden, "invalid API key"))?;
        take(self.by_owner.as_ref(), Tenant::Key(credential.owner()), now)?;
        Ok(credential)
    }
}

fn take(rate: Option<&RateLimit<Tenant>>, tenant: Tenant, now: Instant) -> Result<(), Problem> {
    let too_fast = |seconds| {
        Problem::new(Code::RateLimited, "request rate limit exceeded").retry_after(seconds)
    };
    rate.map_or(Ok(()), |rate| rate.take(tenant, now))
        .map_err(too_fast)
}

/// Reads a small file.
/// Errors: it cannot be read, or has more than `limit` bytes.
pub fn read_bounded(path: &Path, limit: u64) -> Result<Vec<u8>, String> {
    let mut bytes = Vec::new();
    let file = std::fs::File::open(path).map_err(|e| e.to_string())?;
    file.take(limit + 1)
        .read_to_end(&mut bytes)
        .map_err(|e| e.to_string())?;
    if bytes.len() as u64 > limit {
        Err(format!("larger than {limit} bytes"))
    } else {
        Ok(bytes)
    }
}
