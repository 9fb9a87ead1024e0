//! The address of a server.

use std::fmt;

use redis::{ConnectionAddr, ConnectionInfo};

/// The address and the credentials of a Redis or Valkey server. Its text has neither user nor
/// password.
#[derive(Clone)]
pub struct RedisAddress(ConnectionInfo);

impl RedisAddress {
    /// Reads `redis://[user:password@]host[:port][/database]`. No error contains the text.
    pub(crate) fn parse(text: &str) -> Result<Self, String> {
        let info: Option<ConnectionInfo> = text.parse().ok();
        info.filter(|info| matches!(info.addr(), ConnectionAddr::Tcp(..))).map(Self).ok_or_else(|| {
            "that is not `redis://[user:password@]host[:port][/database]`; in user and password, \
                other signs than letters and digits are \
             written as % and two hexadecimal digits"
                .to_owned()
        })
    }

    pub(crate) const fn info(&self) -> &ConnectionInfo {
        &self.0
    }

    fn parts(&self) -> (String, i64, Option<&str>, Option<&str>) {
        let settings = self.0.redis_settings();
        (
            self.0.addr().to_string(),
            settings.db(),
            settings.username(),
            settings.password(),
        )
    }
}

impl PartialEq for RedisAddress {
    fn eq(&self, other: &Self) -> bool {
        self.parts() == other.parts()
    }
}

impl fmt::Display for RedisAddress {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let (address, database, ..) = self.parts();
        write!(f, "redis://{address}/{database}")
    }
}

impl fmt::Debug for RedisAddress {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        fmt::Display::fmt(self, f)
    }
}
