//! TLS: the certificate and its key from files, and the client sides by which the program asks itself, and a collector.

use std::fmt;
use std::io::{self, Read, Write};
use std::net::{IpAddr, TcpStream};
use std::path::{Path, PathBuf};
use std::sync::Arc;

use tokio::io::{AsyncRead, AsyncWrite};
use tokio_rustls::TlsAcceptor;
use tokio_rustls::TlsConnector;
pub(crate) use tokio_rustls::rustls::ServerConfig;
use tokio_rustls::rustls::client::danger::{HandshakeSignatureValid, ServerCertVerified, ServerCertVerifier};
use tokio_rustls::rustls::crypto::{CryptoProvider, ring, verify_tls12_signature, verify_tls13_signature};
use tokio_rustls::rustls::pki_types::pem::PemObject as _;
use tokio_rustls::rustls::pki_types::{CertificateDer, PrivateKeyDer, ServerName, UnixTime};
use tokio_rustls::rustls::{
    CertificateError, ClientConfig, ClientConnection, DigitallySignedStruct, Error, RootCertStore, SignatureScheme, StreamOwned,
};
pub(crate) use tokio_rustls::server::TlsStream;

/// HTTP/2, by its name in the handshake.
const H2: &[u8] = b"h2";
const HTTP_1_1: &[u8] = b"http/1.1";
/// Largest file.
const MOST: u64 = 1 << 20;

/// Where certificate and key lie, both PEM.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct TlsFiles {
    /// The server's certificate, then those that lead to a root.
    pub cert: PathBuf,
    /// Its private key.
    pub key: PathBuf,
}

impl TlsFiles {
    /// Reads both; each time anew.
    ///
    /// # Errors
    /// The file and why.
    pub fn load(&self) -> Result<Arc<ServerConfig>, String> {
        let chain = certificates(&self.cert)?;
        let key = PrivateKeyDer::from_pem_slice(&read(&self.key)?).map_err(|e| told(&self.key, &format!("no private key in PEM: {e}")))?;
        let fits = |e: Error| format!("{} and {} do not go together: {e}", self.cert.display(), self.key.display());
        let mut config = ServerConfig::builder_with_provider(provider())
            .with_safe_default_protocol_versions()
            .and_then(|builder| builder.with_no_client_auth().with_single_cert(chain, key))
            .map_err(fits)?;
        config.alpn_protocols = vec![H2.to_vec(), HTTP_1_1.to_vec()];
        Ok(Arc::new(config))
    }

    /// The client side of one who knows this certificate and takes no other, whoever has signed it and for whatever name.
    ///
    /// # Errors
    /// The file and why.
    pub fn trusting_it_alone(&self) -> Result<Arc<ClientConfig>, String> {
        let own = certificates(&self.cert)?.swap_remove(0);
        let verifier = Arc::new(ThisOne { own, provider: provider() });
        let builder = ClientConfig::builder_with_provider(provider()).with_safe_default_protocol_versions().map_err(|e| e.to_string())?;
        Ok(Arc::new(builder.dangerous().with_custom_certificate_verifier(verifier).with_no_client_auth()))
    }

    /// The client's side of a connection to `ip` that trusts this certificate alone.
    ///
    /// # Errors
    /// The file and why.
    pub fn connect(&self, stream: TcpStream, ip: IpAddr) -> io::Result<impl Read + Write + use<>> {
        let client = self.trusting_it_alone().map_err(io::Error::other)?;
        let connection = ClientConnection::new(client, ServerName::IpAddress(ip.into())).map_err(io::Error::other)?;
        Ok(StreamOwned::new(connection, stream))
    }
}

/// The server's side of a handshake, and whether HTTP/2 was agreed on.
pub(crate) async fn accept<S>(config: Arc<ServerConfig>, stream: S) -> io::Result<(TlsStream<S>, bool)>
where
    S: AsyncRead + AsyncWrite + Unpin,
{
    let stream = TlsAcceptor::from(config).accept(stream).await?;
    let is_http2 = stream.get_ref().1.alpn_protocol() == Some(H2);
    Ok((stream, is_http2))
}

/// The stream below TLS.
pub(crate) fn inner<S>(stream: &mut TlsStream<S>) -> &mut S {
    stream.get_mut().0
}

/// A client's TLS for HTTP/1.1 to one host. It trusts the system's roots, or those of `SSL_CERT_FILE` and `SSL_CERT_DIR`.
pub(crate) struct Connector {
    connector: TlsConnector,
    host: ServerName<'static>,
}

impl Connector {
    /// Fails if there are no roots, or the host is neither a name nor an address.
    pub(crate) fn new(host: &str) -> Result<Self, String> {
        let host = ServerName::try_from(host.to_owned()).map_err(|error| error.to_string())?;
        let found = rustls_native_certs::load_native_certs();
        let mut roots = RootCertStore::empty();
        if roots.add_parsable_certificates(found.certs).0 == 0 {
            let why = found.errors.first().map_or_else(String::new, |error| format!(" ({error})"));
            return Err(format!("this system has no root certificates; SSL_CERT_FILE may name a file of them{why}"));
        }
        let builder = ClientConfig::builder_with_provider(provider()).with_safe_default_protocol_versions().map_err(|e| e.to_string())?;
        let mut config = builder.with_root_certificates(roots).with_no_client_auth();
        config.alpn_protocols = vec![HTTP_1_1.to_vec()];
        Ok(Self { connector: TlsConnector::from(Arc::new(config)), host })
    }

    pub(crate) async fn connect<S: AsyncRead + AsyncWrite + Unpin>(
        &self,
        stream: S,
    ) -> io::Result<impl AsyncRead + AsyncWrite + Unpin + use<S>> {
        self.connector.connect(self.host.clone(), stream).await
    }
}

fn provider() -> Arc<CryptoProvider> {
    Arc::new(ring::default_provider())
}

fn told(path: &Path, why: &impl fmt::Display) -> String {
    format!("{}: {why}", path.display())
}

fn read(path: &Path) -> Result<Vec<u8>, String> {
    crate::auth::read_bounded(path, MOST).map_err(|why| told(path, &why))
}

/// At least one.
fn certificates(path: &Path) -> Result<Vec<CertificateDer<'static>>, String> {
    let chain: Result<Vec<_>, _> = CertificateDer::pem_slice_iter(&read(path)?).collect();
    let chain = chain.map_err(|e| told(path, &format!("no certificate in PEM: {e}")))?;
    if chain.is_empty() { Err(told(path, &"no certificate in PEM")) } else { Ok(chain) }
}

/// Takes one certificate, byte for byte; that its key signs the handshake is checked as ever.
#[derive(Debug)]
struct ThisOne {
    own: CertificateDer<'static>,
    provider: Arc<CryptoProvider>,
}

impl ServerCertVerifier for ThisOne {
    fn verify_server_cert(
        &self,
        end_entity: &CertificateDer<'_>,
        _: &[CertificateDer<'_>],
        _: &ServerName<'_>,
        _: &[u8],
        _: UnixTime,
    ) -> Result<ServerCertVerified, Error> {
        if *end_entity == self.own {
            return Ok(ServerCertVerified::assertion());
        }
        Err(Error::InvalidCertificate(CertificateError::ApplicationVerificationFailure))
    }

    fn verify_tls12_signature(
        &self,
        message: &[u8],
        cert: &CertificateDer<'_>,
        signed: &DigitallySignedStruct,
    ) -> Result<HandshakeSignatureValid, Error> {
        verify_tls12_signature(message, cert, signed, &self.provider.signature_verification_algorithms)
    }

    fn verify_tls13_signature(
        &self,
        message: &[u8],
        cert: &CertificateDer<'_>,
        signed: &DigitallySignedStruct,
    ) -> Result<HandshakeSignatureValid, Error> {
        verify_tls13_signature(message, cert, signed, &self.provider.signature_verification_algorithms)
    }

    fn supported_verify_schemes(&self) -> Vec<SignatureScheme> {
        self.provider.signature_verification_algorithms.supported_schemes()
    }
}
