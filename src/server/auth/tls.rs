//! TLS: the server's certificate and key, and the clients for the health check and for exporting
//! traces.

use std::fmt;
use std::io::{self, Read, Write};
use std::net::{IpAddr, TcpStream};
use std::path::{Path, PathBuf};
use std::sync::Arc;

use tokio::io::{AsyncRead, AsyncWrite};
use tokio_rustls::TlsAcceptor;
pub(crate) use tokio_rustls::rustls::ServerConfig;
use tokio_rustls::rustls::client::danger::{
    HandshakeSignatureValid, ServerCertVerified, ServerCertVerifier,
};
use tokio_rustls::rustls::crypto::{
    CryptoProvider, ring, verify_tls12_signature, verify_tls13_signature,
};
use tokio_rustls::rustls::pki_types::pem::PemObject as _;
use tokio_rustls::rustls::pki_types::{CertificateDer, PrivateKeyDer, ServerName, UnixTime};
use tokio_rustls::rustls::{
    CertificateError, ClientConfig, ClientConnection, DigitallySignedStruct, Error,
    SignatureScheme, StreamOwned,
};
pub(crate) use tokio_rustls::server::TlsStream;
#[cfg(feature = "otlp")]
use tokio_rustls::{TlsConnector, rustls::RootCertStore};

/// The ALPN name of HTTP/2.
const H2: &[u8] = b"h2";
const HTTP_1_1: &[u8] = b"http/1.1";
/// Maximum size of a file.
const MAX_FILE: u64 = 1 << 20;

/// The files of the certificate and its key, both PEM.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct TlsFiles {
    /// The server's certificate, then its chain.
    pub cert: PathBuf,
    /// Its private key.
    pub key: PathBuf,
}

impl TlsFiles {
    /// Reads both files.
    /// Errors: the file and the cause.
    pub fn load(&self) -> Result<Arc<ServerConfig>, String> {
        let chain = certificates(&self.cert)?;
        let key = read(&self.key)?;
        let key = PrivateKeyDer::from_pem_slice(&key)
            .map_err(|e| mistake(&self.key, &format!("no private key in PEM: {e}")))?;
        let mismatch = |e: Error| {
            format!(
                "{} and {} do not go together: {e}",
                self.cert.display(),
                self.key.display()
            )
        };
        let mut config = ServerConfig::builder_with_provider(provider())
            .with_safe_default_protocol_versions()
            .and_then(|builder| builder.with_no_client_auth().with_single_cert(chain, key))
            .map_err(mismatch)?;
        config.alpn_protocols = vec![H2.to_vec(), HTTP_1_1.to_vec()];
        Ok(Arc::new(config))
    }

    /// A client that trusts this certificate alone, whatever its issuer and its names.
    /// Errors: the file and the cause.
    pub fn trusting_it_alone(&self) -> Result<Arc<ClientConfig>, String> {
        let certificate = certificates(&self.cert)?.swap_remove(0);
        let verifier = Arc::new(PinnedCertificate {
            certificate,
            provider: provider(),
        });
        let builder = ClientConfig::builder_with_provider(provider())
            .with_safe_default_protocol_versions()
            .map_err(|e| e.to_string())?;
        Ok(Arc::new(
            builder
                .dangerous()
                .with_custom_certificate_verifier(verifier)
                .with_no_client_auth(),
        ))
    }

    /// The client's side of a connection to `ip` that trusts this certificate alone.
    /// Errors: the file and why.
    pub fn connect(&self, stream: TcpStream, ip: IpAddr) -> io::Result<impl Read + Write + use<>> {
        let client = self.trusting_it_alone().map_err(io::Error::other)?;
        let connection = ClientConnection::new(client, ServerName::IpAddress(ip.into()))
            .map_err(io::Error::other)?;
        Ok(StreamOwned::new(connection, stream))
    }
}

/// The server's side of a handshake, and whether HTTP/2 was agreed on.
pub(crate) async fn accept<S>(
    config: Arc<ServerConfig>,
    stream: S,
) -> io::Result<(TlsStream<S>, bool)>
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

#[cfg(feature = "otlp")]
/// A client's TLS for HTTP/1.1 to one host. It trusts the system's roots, or those of
/// `SSL_CERT_FILE` and `SSL_CERT_DIR`.
pub(crate) struct Connector {
    connector: TlsConnector,
    host: ServerName<'static>,
}

#[cfg(feature = "otlp")]
impl Connector {
    /// Fails if there are no roots, or the host is neither a name nor an address.
    pub(crate) fn new(host: &str) -> Result<Self, String> {
        let host = ServerName::try_from(host.to_owned()).map_err(|error| error.to_string())?;
        let found = rustls_native_certs::load_native_certs();
        let mut roots = RootCertStore::empty();
        if roots.add_parsable_certificates(found.certs).0 == 0 {
            let why = found
                .errors
                .first()
                .map_or_else(String::new, |error| format!(" ({error})"));
            return Err(format!(
                "this system has no root certificates; SSL_CERT_FILE may name a file of them{why}"
            ));
        }
        let builder = ClientConfig::builder_with_provider(provider())
            .with_safe_default_protocol_versions()
            .map_err(|e| e.to_string())?;
        let mut config = builder.with_root_certificates(roots).with_no_client_auth();
        config.alpn_protocols = vec![HTTP_1_1.to_vec()];
        Ok(Self {
            connector: TlsConnector::from(Arc::new(config)),
            host,
        })
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

fn mistake(path: &Path, cause: &impl fmt::Display) -> String {
    format!("{}: {cause}", path.display())
}

fn read(path: &Path) -> Result<Vec<u8>, String> {
    super::read_bounded(path, MAX_FILE).map_err(|cause| mistake(path, &cause))
}

/// The certificates of a file, at least one.
fn certificates(path: &Path) -> Result<Vec<CertificateDer<'static>>, String> {
    let chain: Result<Vec<_>, _> = CertificateDer::pem_slice_iter(&read(path)?).collect();
    let chain = chain.map_err(|e| mistake(path, &format!("no certificate in PEM: {e}")))?;
    if chain.is_empty() {
        Err(mistake(path, &"no certificate in PEM"))
    } else {
        Ok(chain)
    }
}

/// Accepts one certificate, byte for byte. The signature of the handshake is verified as usual.
#[derive(Debug)]
struct PinnedCertificate {
    certificate: CertificateDer<'static>,
    provider: Arc<CryptoProvider>,
}

impl ServerCertVerifier for PinnedCertificate {
    fn verify_server_cert(
        &self,
        end_entity: &CertificateDer<'_>,
        _: &[CertificateDer<'_>],
        _: &ServerName<'_>,
        _: &[u8],
        _: UnixTime,
    ) -> Result<ServerCertVerified, Error> {
        if *end_entity == self.certificate {
            return Ok(ServerCertVerified::assertion());
        }
        Err(Error::InvalidCertificate(
            CertificateError::ApplicationVerificationFailure,
        ))
    }

    fn verify_tls12_signature(
        &self,
        message: &[u8],
        cert: &CertificateDer<'_>,
        signed: &DigitallySignedStruct,
    ) -> Result<HandshakeSignatureValid, Error> {
        verify_tls12_signature(
            message,
            cert,
            signed,
            &self.provider.signature_verification_algorithms,
        )
    }

    fn verify_tls13_signature(
        &self,
        message: &[u8],
        cert: &CertificateDer<'_>,
        signed: &DigitallySignedStruct,
    ) -> Result<HandshakeSignatureValid, Error> {
        verify_tls13_signature(
            message,
            cert,
            signed,
            &self.provider.signature_verification_algorithms,
        )
    }

    fn supported_verify_schemes(&self) -> Vec<SignatureScheme> {
        self.provider
            .signature_verification_algorithms
            .supported_schemes()
    }
}
