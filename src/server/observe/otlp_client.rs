//! An HTTP client for the OTLP exporter: HTTP/1.1, plain or over TLS, on one connection that is
//! kept.

use std::fmt;
use std::future::Future;
use std::pin::Pin;
use std::sync::Arc;
use std::sync::atomic::{AtomicU64, Ordering};
use std::time::Duration;

use http_body_util::{BodyExt as _, Full, Limited};
use hyper::Uri;
use hyper::client::conn::http1::{SendRequest, handshake};
use hyper::header::{HOST, HeaderValue};
use hyper_util::rt::TokioIo;
use opentelemetry_http::{Bytes, HttpClient, HttpError, Request, Response};
use opentelemetry_otlp::{
    Protocol, RetryPolicy, SpanExporter, WithExportConfig as _, WithHttpConfig as _,
};
use opentelemetry_proto::tonic::collector::trace::v1::ExportTraceServiceResponse;
use opentelemetry_sdk::Resource;
use prost::Message as _;
use tokio::io::{AsyncRead, AsyncWrite};
use tokio::net::TcpStream;
use tokio::runtime::Handle;
use tokio::sync::Mutex;
use tokio::time::timeout;

use crate::auth::tls::Connector;

const MAX_RESPONSE_BYTES: usize = 64 << 10;
/// Of one batch.
const EXPORT_TIMEOUT: Duration = Duration::from_secs(10);

/// The address of a collector, with scheme, host, port and path.
pub(crate) type CollectorUrl = Uri;

/// Reads `http[s]://host[:port][/path]`.
pub(crate) fn parse_collector(text: &str) -> Result<CollectorUrl, String> {
    let is_no_address = || format!("`{text}` is not an address such as http://127.0.0.1:4318");
    let uri: Uri = text.parse().map_err(|_| is_no_address())?;
    let default_port = match uri.scheme_str() {
        Some("http") => 80,
        Some("https") => 443,
        _ => return Err(is_no_address()),
    };
    let (host, authority) = (
        uri.host().unwrap_or_default(),
        uri.authority().map_or("", |authority| authority.as_str()),
    );
    let port = uri.port_u16().unwrap_or(default_port);
    let has_more = text.contains(['?', '#'])
        || (authority != host
            && uri
                .port()
                .is_none_or(|port| authority != format!("{host}:{port}")));
    if host.is_empty() || has_more {
        let why = "has no host, or more than a host, a port and a path; set headers in \
            OTEL_EXPORTER_OTLP_HEADERS";
        return Err(format!("`{text}` {why}"));
    }
    let url = Uri::builder()
        .scheme(uri.scheme_str().unwrap_or_default())
        .authority(format!("{host}:{port}"));
    url.path_and_query(format!("{}/v1/traces", uri.path().trim_end_matches('/')))
        .build()
        .map_err(|_| is_no_address())
}

/// An exporter to a collector, and the number of spans that the collector rejected of batches that
/// it accepted.
pub(super) fn exporter(
    collector: &CollectorUrl,
    resource: &Resource,
) -> Result<(SpanExporter, Arc<AtomicU64>), String> {
    let rejected = Arc::<AtomicU64>::default();
    let mut exporter = SpanExporter::builder()
        .with_http()
        .with_endpoint(collector.to_string())
        .with_protocol(Protocol::HttpBinary)
        .with_http_client(OtlpClient::new(collector, Arc::clone(&rejected))?)
        // A retry would stop the queue; lost spans are counted instead.
        .with_retry_policy(RetryPolicy::disabled())
        .build()
        .map_err(|error| error.to_string())?;
    opentelemetry_sdk::trace::SpanExporter::set_resource(&mut exporter, resource);
    Ok((exporter, rejected))
}

#[derive(Clone)]
struct OtlpClient(Arc<ClientState>);

struct ClientState {
    authority: String,
    tls: Option<Connector>,
    /// Spans that the collector rejected of batches that it accepted.
    rejected: Arc<AtomicU64>,
    connection: Mutex<Option<SendRequest<Full<Bytes>>>>,
    /// The exporter has a thread of its own, without a runtime.
    runtime: Handle,
}

trait Stream: AsyncRead + AsyncWrite + Unpin + Send {}
impl<S: AsyncRead + AsyncWrite + Unpin + Send> Stream for S {}

impl fmt::Debug for OtlpClient {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.debug_struct("OtlpClient")
            .field("authority", &self.0.authority)
            .finish_non_exhaustive()
    }
}

impl OtlpClient {
    pub(crate) fn new(collector: &CollectorUrl, rejected: Arc<AtomicU64>) -> Result<Self, String> {
        let host = collector
            .host()
            .unwrap_or_default()
            .trim_matches(['[', ']']);
        let tls = (collector.scheme_str() == Some("https"))
            .then(|| Connector::new(host))
            .transpose()?;
        let runtime = Handle::try_current().map_err(|error| error.to_string())?;
        let authority = collector
            .authority()
            .map(ToString::to_string)
            .unwrap_or_default();
        Ok(Self(Arc::new(ClientState {
            authority,
            tls,
            rejected,
            connection: Mutex::new(None),
            runtime,
        })))
    }
}

impl ClientState {
    async fn connect(&self) -> Result<SendRequest<Full<Bytes>>, HttpError> {
        let stream = TcpStream::connect(&self.authority).await?;
        let stream: Box<dyn Stream> = match &self.tls {
            Some(connector) => Box::new(connector.connect(stream).await?),
            None => Box::new(stream),
        };
        let (sender, connection) = handshake(TokioIo::new(stream)).await?;
        // Ends with the sender, which also returns its errors.
        tokio::spawn(connection);
        Ok(sender)
    }

    async fn send(&self, request: Request<Bytes>) -> Result<Response<Bytes>, HttpError> {
        let (mut head, body) = request.into_parts();
        head.headers
            .insert(HOST, HeaderValue::from_str(&self.authority)?);
        // HTTP/1.1 sends the path alone.
        head.uri = head.uri.path().parse()?;
        // Taken out: a cancelled request leaves no connection with a half-read response behind.
        let mut slot = self.connection.lock().await;
        let mut connection = match slot.take().filter(|connection| !connection.is_closed()) {
            Some(connection) => connection,
            None => self.connect().await?,
        };
        connection.ready().await?;
        let response = connection
            .send_request(Request::from_parts(head, Full::new(body)))
            .await?;
        let (head, body) = response.into_parts();
        let body = Limited::new(body, MAX_RESPONSE_BYTES)
            .collect()
            .await?
            .to_bytes();
        *slot = Some(connection);
        // A response that cannot be read rejects nothing.
        let response = ExportTraceServiceResponse::decode(body.clone()).unwrap_or_default();
        let rejected = response
            .partial_success
            .map_or(0, |partial| partial.rejected_spans);
        self.rejected
            .fetch_add(u64::try_from(rejected).unwrap_or(0), Ordering::Relaxed);
        Ok(Response::from_parts(head, body))
    }
}

impl HttpClient for OtlpClient {
    fn send_bytes<'a, 'b>(
        &'a self,
        request: Request<Bytes>,
    ) -> Pin<Box<dyn Future<Output = Result<Response<Bytes>, HttpError>> + Send + 'b>>
    where
        'a: 'b,
        Self: 'b,
    {
        let client = Arc::clone(&self.0);
        let sending = self
            .0
            .runtime
            .spawn(async move { timeout(EXPORT_TIMEOUT, client.send(request)).await? });
        Box::pin(async move {
            let sent = sending.await.unwrap_or_else(|ended| Err(ended.into()));
            // The exporter's own error does not have the reason.
            sent.inspect_err(
                |error| tracing::debug!(%error, "spans were not sent to {}", self.0.authority),
            )
        })
    }
}
