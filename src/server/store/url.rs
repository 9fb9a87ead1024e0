//! The option `--store`: `memory`, `file:PATH`, `redis://[user:password@]host[:port][/database]`.

use std::fmt;
use std::path::PathBuf;
use std::str::FromStr;

use redis::{ConnectionAddr, ConnectionInfo};

/// Where sessions live.
#[derive(Clone, Debug, Default, PartialEq)]
pub enum StoreUrl {
    /// In this process.
    #[default]
    Memory,
    /// In a file of this machine.
    File(PathBuf),
    /// On a Redis or Valkey server.
    Redis(Address),
}

/// The address and the credentials of a Redis or Valkey server. Its text has neither user nor password.
#[derive(Clone)]
pub struct Address(ConnectionInfo);

impl Address {
    /// For the client library.
    pub(crate) const fn info(&self) -> &ConnectionInfo {
        &self.0
    }

    fn parts(&self) -> (String, i64, Option<&str>, Option<&str>) {
        let settings = self.0.redis_settings();
        (self.0.addr().to_string(), settings.db(), settings.username(), settings.password())
    }
}

impl PartialEq for Address {
    fn eq(&self, other: &Self) -> bool {
        self.parts() == other.parts()
    }
}

impl fmt::Display for Address {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let (address, database, ..) = self.parts();
        write!(f, "redis://{address}/{database}")
    }
}

impl fmt::Debug for Address {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        fmt::Display::fmt(self, f)
    }
}

impl FromStr for StoreUrl {
    type Err = String;

    /// No error contains the text: it may contain a password.
    fn from_str(text: &str) -> Result<Self, String> {
        if text == "memory" {
            return Ok(Self::Memory);
        }
        if let Some(path) = text.strip_prefix("file:") {
            // A host in `file://HOST/PATH` must not be taken for a directory.
            let path = path.strip_prefix("//").map_or(Ok(path), |path| {
                if path.starts_with('/') { Ok(path) } else { Err("a file is `file:PATH`, or `file://` and an absolute path".to_owned()) }
            })?;
            return if path.is_empty() { Err("`file:` needs a path".to_owned()) } else { Ok(Self::File(path.into())) };
        }
        match text.split_once("://").map(|(scheme, _)| scheme) {
            Some("redis" | "valkey") => {}
            Some("rediss" | "valkeys") => {
                return Err("TLS to the store is not supported: use redis:// on a network that is trusted, or through a tunnel".to_owned());
            }
            _ => return Err("a store is `memory`, `file:PATH` or `redis://[user:password@]host[:port][/database]`".to_owned()),
        }
        let wrong = "that is not `redis://[user:password@]host[:port][/database]`; in user and password, other signs than letters and digits are \
                     written as % and two hexadecimal digits";
        let info: ConnectionInfo = text.parse().map_err(|_| wrong.to_owned())?;
        if matches!(info.addr(), ConnectionAddr::Tcp(..)) { Ok(Self::Redis(Address(info))) } else { Err(wrong.to_owned()) }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn read(text: &str) -> Result<StoreUrl, String> {
        text.parse()
    }

    #[test]
    fn places_are_read_as_people_write_them() {
        assert_eq!(read("memory"), Ok(StoreUrl::Memory));
        assert_eq!(read("file:sessions.db"), Ok(StoreUrl::File("sessions.db".into())));
        assert_eq!(read("file:/var/lib/s"), read("file:///var/lib/s"));
        for text in ["", "disk", "file:", "file://host/x", "redis://", "http://here", "redis+unix:///x", "redis://h:99999", "redis://h/x"] {
            assert!(read(text).is_err(), "{text}");
        }
        assert!(read("rediss://here").unwrap_err().contains("TLS"));
        let Ok(StoreUrl::Redis(address)) = read("redis://here/3") else { panic!("a place") };
        assert_eq!(address.to_string(), "redis://here:6379/3");
        assert_eq!(read("valkey://here/3"), read("redis://here:6379/3"));
        assert_ne!(read("redis://:a@here"), read("redis://:b@here"));
    }

    #[test]
    fn a_password_is_never_shown() {
        let place = read("redis://somebody:s3cret@here:1").unwrap();
        let StoreUrl::Redis(address) = &place else { panic!("a place") };
        for shown in [format!("{place:?}"), format!("{address}"), format!("{address:#?}")] {
            assert!(!shown.contains("s3cret") && !shown.contains("somebody"), "{shown}");
        }
        for wrong in ["redis://somebody:s3cret@here:port", "http://somebody:s3cret@here", "rediss://somebody:s3cret@here", "s3cret"] {
            assert!(!read(wrong).unwrap_err().contains("s3cret"));
        }
    }
}
