//! The option `--store`: `memory`, `file:PATH`, `redis://[user:password@]host[:port][/database]`.

use std::str::FromStr;

/// Where sessions live.
#[derive(Clone, Debug, Default, PartialEq)]
pub enum StoreUrl {
    /// In this process.
    #[default]
    Memory,
    /// In a file of this machine.
    #[cfg(feature = "file-store")]
    File(std::path::PathBuf),
    /// On a Redis or Valkey server.
    #[cfg(feature = "redis")]
    Redis(super::RedisAddress),
}

impl StoreUrl {
    /// Whether several processes may use it at the same time.
    pub(crate) const fn is_shared(&self) -> bool {
        match self {
            Self::Memory => false,
            #[cfg(feature = "file-store")]
            Self::File(_) => false,
            #[cfg(feature = "redis")]
            Self::Redis(_) => true,
        }
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
                if path.starts_with('/') {
                    Ok(path)
                } else {
                    Err("a file is `file:PATH`, or `file://` and an absolute path".to_owned())
                }
            })?;
            return if path.is_empty() {
                Err("`file:` needs a path".to_owned())
            } else {
                file(path)
            };
        }
        match text.split_once("://").map(|(scheme, _)| scheme) {
            Some("redis" | "valkey") => redis(text),
            Some("rediss" | "valkeys") => Err(
                "TLS to the store is not supported: use redis:// on a network that is \
                    trusted, or through a tunnel"
                    .to_owned(),
            ),
            _ => Err("a store is `memory`, `file:PATH` or \
                `redis://[user:password@]host[:port][/database]`"
                .to_owned()),
        }
    }
}

#[cfg(feature = "file-store")]
fn file(path: &str) -> Result<StoreUrl, String> {
    Ok(StoreUrl::File(path.into()))
}

#[cfg(not(feature = "file-store"))]
fn file(_: &str) -> Result<StoreUrl, String> {
    Err("this build has no file store (feature `file-store`)".to_owned())
}

#[cfg(feature = "redis")]
fn redis(text: &str) -> Result<StoreUrl, String> {
    super::RedisAddress::parse(text).map(StoreUrl::Redis)
}

#[cfg(not(feature = "redis"))]
fn redis(_: &str) -> Result<StoreUrl, String> {
    Err("this build has no Redis support (feature `redis`)".to_owned())
}

#[cfg(all(test, feature = "file-store", feature = "redis"))]
mod tests {
    use super::*;

    fn read(text: &str) -> Result<StoreUrl, String> {
        text.parse()
    }

    #[test]
    fn places_are_read_as_people_write_them() {
        assert_eq!(read("memory"), Ok(StoreUrl::Memory));
        assert_eq!(
            read("file:sessions.db"),
            Ok(StoreUrl::File("sessions.db".into()))
        );
        assert_eq!(read("file:/var/lib/s"), read("file:///var/lib/s"));
        for text in [
            "",
            "disk",
            "file:",
            "file://host/x",
            "redis://",
            "http://here",
            "redis+unix:///x",
            "redis://h:99999",
            "redis://h/x",
        ] {
            assert!(read(text).is_err(), "{text}");
        }
        assert!(read("rediss://here").unwrap_err().contains("TLS"));
        let Ok(StoreUrl::Redis(address)) = read("redis://here/3") else {
            panic!("a place")
        };
        assert_eq!(address.to_string(), "redis://here:6379/3");
        assert_eq!(read("valkey://here/3"), read("redis://here:6379/3"));
        assert_ne!(read("redis://:a@here"), read("redis://:b@here"));
    }

    #[test]
    fn a_password_is_never_shown() {
        let place = read("redis://somebody:s3cret@here:1").unwrap();
        let StoreUrl::Redis(address) = &place else {
            panic!("a place")
        };
        for shown in [
            format!("{place:?}"),
            format!("{address}"),
            format!("{address:#?}"),
        ] {
            assert!(
                !shown.contains("s3cret") && !shown.contains("somebody"),
                "{shown}"
            );
        }
        for wrong in [
            "redis://somebody:s3cret@here:port",
            "http://somebody:s3cret@here",
            "rediss://somebody:s3cret@here",
            "s3cret",
        ] {
            assert!(!read(wrong).unwrap_err().contains("s3cret"));
        }
    }
}
