//! The interface of `tls.rs` in a build without the feature `tls`: no certificate can be loaded, so there is never a TLS stream.

use std::convert::Infallible;
use std::io;
use std::net::{IpAddr, TcpStream};
use std::path::PathBuf;
use std::pin::Pin;
use std::sync::Arc;
use std::task::{Context, Poll};

use tokio::io::{AsyncRead, AsyncWrite, ReadBuf};

/// HTTP/2, by its name in the handshake.
pub const H2: &[u8] = b"h2";
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
    /// Fails.
    ///
    /// # Errors
    /// Always.
    pub fn load(&self) -> Result<Arc<ServerConfig>, String> {
        Err(NO_TLS.to_owned())
    }

    /// Fails.
    ///
    /// # Errors
    /// Always.
    pub fn connect(&self, _: TcpStream, _: IpAddr) -> io::Result<TcpStream> {
        Err(io::Error::other(NO_TLS))
    }
}

/// A client's TLS. There is none.
#[derive(Debug)]
pub enum Connector {}

impl Connector {
    /// Fails.
    ///
    /// # Errors
    /// Always.
    pub fn new(_: &str) -> Result<Self, String> {
        Err(NO_TLS.to_owned())
    }

    /// Cannot be called.
    ///
    /// # Errors
    /// None.
    #[expect(clippy::unused_async, reason = "as in tls.rs")]
    pub async fn connect<S>(&self, _: S) -> io::Result<TlsStream<S>> {
        match *self {}
    }
}

/// There is none.
#[derive(Debug)]
pub enum ServerConfig {}

/// There is none.
#[derive(Debug)]
pub struct TlsAcceptor(Infallible);

impl From<Arc<ServerConfig>> for TlsAcceptor {
    fn from(config: Arc<ServerConfig>) -> Self {
        match *config {}
    }
}

impl TlsAcceptor {
    /// Cannot be called.
    ///
    /// # Errors
    /// None.
    #[expect(clippy::unused_async, reason = "as in tls.rs")]
    pub async fn accept<S>(&self, _: S) -> io::Result<TlsStream<S>> {
        match self.0 {}
    }
}

/// There is none.
#[derive(Debug)]
pub struct TlsStream<S>(Infallible, S);

/// There is none.
#[derive(Debug)]
pub struct Handshake(Infallible);

impl Handshake {
    /// Cannot be called.
    #[must_use]
    pub const fn alpn_protocol(&self) -> Option<&[u8]> {
        match self.0 {}
    }
}

impl<S> TlsStream<S> {
    /// Cannot be called.
    #[must_use]
    pub const fn get_ref(&self) -> (&S, &Handshake) {
        match self.0 {}
    }

    /// Cannot be called.
    pub const fn get_mut(&mut self) -> (&mut S, &mut Handshake) {
        match self.0 {}
    }
}

impl<S: Unpin> AsyncRead for TlsStream<S> {
    fn poll_read(self: Pin<&mut Self>, _: &mut Context<'_>, _: &mut ReadBuf<'_>) -> Poll<io::Result<()>> {
        match self.0 {}
    }
}

impl<S: Unpin> AsyncWrite for TlsStream<S> {
    fn poll_write(self: Pin<&mut Self>, _: &mut Context<'_>, _: &[u8]) -> Poll<io::Result<usize>> {
        match self.0 {}
    }

    fn poll_flush(self: Pin<&mut Self>, _: &mut Context<'_>) -> Poll<io::Result<()>> {
        match self.0 {}
    }

    fn poll_shutdown(self: Pin<&mut Self>, _: &mut Context<'_>) -> Poll<io::Result<()>> {
        match self.0 {}
    }
}
