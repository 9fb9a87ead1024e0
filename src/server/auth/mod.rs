//! Access control: keys and session tokens, rates and the number of connections; the syntax of
//! hosts and origins; TLS.

pub mod clock;
pub mod cors;
pub mod hosts;
pub mod keys;
#[cfg(feature = "tls")]
pub mod tls;
#[cfg(not(feature = "tls"))]
#[path = "no_tls.rs"]
pub mod tls;
pub mod tokens;

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
use clock::Clock;
use keys::{Credential, Keys};
use tokens::{Secrets, TokenName, Wanted};

/// Requests per second; `None`: no limit.
#[derive(Clone, Copy, Debug, Default)]
pub struct Rates {
    /// Of one address.
    pub address: Option<u32>,
    /// Of one visitor below a key.
    pub visitor: Option<u32>,
    /// Of one name of keys, with all its visitors.
    pub key: Option<u32>,
}

/// Who was admitted.
#[derive(Debug)]
pub struct Admitted {
    /// By what.
    pub credential: Credential,
    /// What logs show of the token, if it was one.
    pub(crate) token: Option<TokenName>,
}

/// Decides which requests are admitted.
#[derive(Debug)]
pub struct AccessControl {
    /// None if no keys are configured.
    keys: Option<watch::Sender<Arc<Keys>>>,
    /// None if tokens are neither made nor accepted.
    secrets: Option<watch::Sender<Arc<Secrets>>>,
    clock: Clock,
    by_address: Option<RateLimit<Tenant>>,
    by_visitor: Option<RateLimit<Tenant>>,
    by_owner: Option<RateLimit<Tenant>>,
    sole: SoleClient,
    connections: ConnectionLimiter,
}

impl AccessControl {
    /// Access control with these limits.
    pub fn new(
        keys: Option<Keys>,
        secrets: Option<Secrets>,
        rates: Rates,
        connections: ConnectionLimiter,
    ) -> Self {
        let sole = SoleClient::default();
        sole.set(keys.as_ref().is_some_and(Keys::have_one_owner));
        Self {
            sole,
            keys: keys.map(|keys| watch::Sender::new(Arc::new(keys))),
            secrets: secrets.map(|secrets| watch::Sender::new(Arc::new(secrets))),
            clock: Clock::default(),
            by_address: rates.address.map(RateLimit::new),
            by_visitor: rates.visitor.map(RateLimit::new),
            by_owner: rates.key.map(RateLimit::new),
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

    /// Replaces the secrets of tokens.
    pub fn replace_secrets(&self, new: Secrets) {
        if let Some(secrets) = &self.secrets {
            secrets.send_replace(Arc::new(new));
        }
    }

    /// The secrets of tokens, if they are made here.
    pub(crate) fn secrets(&self) -> Option<Arc<Secrets>> {
        Some(Arc::clone(&self.secrets.as_ref()?.borrow()))
    }

    /// The time of day by which tokens begin and end.
    pub const fn clock(&self) -> &Clock {
        &self.clock
    }

    /// Waits until the credential's key, or the secret of its token, is no longer configured.
    pub async fn revoked(&self, credential: Credential) {
        let key = async {
            match &self.keys {
                // The wait cannot fail: `self` owns the sender.
                Some(keys) => drop(
                    keys.subscribe()
                        .wait_for(|keys| !keys.is_valid(credential))
                        .await,
                ),
                None => pending().await,
            }
        };
        let secret = async {
            match (credential.grant(), &self.secrets) {
                (Some(grant), Some(secrets)) => drop(
                    secrets
                        .subscribe()
                        .wait_for(|secrets| !secrets.have(&grant))
                        .await,
                ),
                _ => pending().await,
            }
        };
        tokio::select! {
            () = key => {}
            () = secret => {}
        }
    }

    /// Waits until the credential's token has expired.
    pub async fn expired(&self, credential: Credential) {
        match credential.grant() {
            Some(grant) => self.clock.reached(grant.ends(self.clock.now())).await,
            None => pending().await,
        }
    }

    /// The credential of a request from this address with this key or token. Errors:
    /// [`Code::Unauthorized`], [`Code::TokenExpired`], [`Code::Forbidden`], [`Code::RateLimited`].
    pub fn admit(
        &self,
        address: IpAddr,
        bearer: Option<&str>,
        wanted: Wanted<'_>,
    ) -> Result<Admitted, Problem> {
        let now = Instant::now();
        // Before the key, so that guesses count.
        take(self.by_address.as_ref(), Tenant::of_address(address), now)?;
        let Some(keys) = &self.keys else {
            return Ok(Admitted {
                credential: Credential::ANYBODY,
                token: None,
            });
        };
        let keys = Arc::clone(&keys.borrow());
        let bearer = bearer.ok_or_else(|| {
            Problem::new(
                Code::Unauthorized,
                "API key required: send `Authorization: Bearer <key>`",
            )
        })?;
        let admitted = match keys.look_up(bearer) {
            Some(credential) => Admitted {
                credential,
                token: None,
            },
            None if tokens::is_token(bearer) => self.admit_token(&keys, bearer, wanted)?,
            None => return Err(Problem::new(Code::Forbidden, "invalid API key")),
        };
        let owner = admitted.credential.owner();
        if let Some(grant) = admitted.credential.grant() {
            let visitor = Tenant::Visitor(owner, grant.session());
            take(self.by_visitor.as_ref(), visitor, now)?;
        }
        take(self.by_owner.as_ref(), Tenant::Key(owner), now)?;
        Ok(admitted)
    }

    fn admit_token(
        &self,
        keys: &Keys,
        token: &str,
        wanted: Wanted<'_>,
    ) -> Result<Admitted, Problem> {
        let Some(secrets) = self.secrets() else {
            return Err(Problem::new(Code::Unauthorized, NO_TOKENS));
        };
        let signed = secrets.check(token, self.clock.seconds())?;
        signed.grant.allow(wanted)?;
        let is_it = |digest: &[u8; 32]| secrets.mark(&signed.grant, digest) == Some(signed.key);
        let credential = keys
            .find(signed.owner, is_it)
            .ok_or_else(tokens::revoked)?
            .limited_to(signed.grant);
        Ok(Admitted {
            credential,
            token: Some(signed.name),
        })
    }
}

/// Why a server with keys and a shared store makes no tokens.
pub(crate) const NO_TOKENS: &str = "this server has no secret for session tokens: replicas that \
    share a store need --token-secrets-file (MLSWARP_TOKEN_SECRETS_FILE)";

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
