//! The interface of `tls.rs` in a build without the feature `tls`: every attempt to use TLS is an
//! error.

use std::io;
use std::net::{IpAddr, TcpStream};
use std::path::PathBuf;
use std::sync::Arc;

const NO_TLS: &str = "this build has no TLS support (feature `tls`)";

/// Where certificate and key lie, both PEM.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct TlsFiles {
    /// The server's certificate.
    pub cert: PathBuf,
    /// Its private key.
    pub key: PathBuf,
}

impl TlsFiles {
    pub(crate) fn load(&self) -> Result<Arc<ServerConfig>, String> {
        Err(NO_TLS.to_owned())
    }

    pub(crate) fn connect(&self, _: TcpStream, _: IpAddr) -> io::Result<TcpStream> {
        Err(io::Error::other(NO_TLS))
    }
}

/// Never constructed.
#[derive(Debug)]
pub(crate) enum ServerConfig {}

/// Never constructed from a [`ServerConfig`].
pub(crate) type TlsStream<S> = S;

pub(crate) async fn accept<S>(config: Arc<ServerConfig>, _: S) -> io::Result<(TlsStream<S>, bool)> {
    match *config {}
}

pub(crate) const fn inner<S>(stream: &mut TlsStream<S>) -> &mut S {
    stream
}

#[cfg(feature = "otlp")]
/// Never constructed.
#[derive(Debug)]
pub(crate) enum Connector {}

#[cfg(feature = "otlp")]
impl Connector {
    pub(crate) fn new(_: &str) -> Result<Self, String> {
        Err(NO_TLS.to_owned())
    }

    pub(crate) async fn connect<S>(&self, _: S) -> io::Result<S> {
        match *self {}
    }
}
