//! An HTTP client for the OTLP exporter: HTTP/1.1, plain or over TLS, on one connection that is kept.

use std::fmt;
use std::future::Future;
use std::pin::Pin;
use std::sync::Arc;
use std::sync::atomic::{AtomicU64, Ordering};
use std::time::Duration;

use http_body_util::{BodyExt as _, Full, Limited};
use hyper::client::conn::http1::{SendRequest, handshake};
use hyper::header::{HOST, HeaderValue};
use hyper_util::rt::TokioIo;
use opentelemetry_http::{Bytes, HttpClient, HttpError, Request, Response};
use opentelemetry_proto::tonic::collector::trace::v1::ExportTraceServiceResponse;
use prost::Message as _;
use tokio::io::{AsyncRead, AsyncWrite};
use tokio::net::TcpStream;
use tokio::runtime::Handle;
use tokio::sync::Mutex;
use tokio::time::timeout;

use super::collector::Collector;
use crate::auth::tls::Connector;

/// Maximum size of a collector's response.
const MAX_RESPONSE_BYTES: usize = 64 << 10;
/// Maximum time for a collector to accept a batch.
const EXPORT_TIMEOUT: Duration = Duration::from_secs(10);

/// A client of one collector.
#[derive(Clone)]
pub(crate) struct OtlpClient(Arc<ClientState>);

struct ClientState {
    authority: String,
    tls: Option<Connector>,
    /// Spans that the collector rejected of batches that it accepted.
    rejected: Arc<AtomicU64>,
    connection: Mutex<Option<SendRequest<Full<Bytes>>>>,
    /// The exporter has a thread of its own, without a runtime.
    runtime: Handle,
}

impl fmt::Debug for OtlpClient {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.debug_struct("OtlpClient").field("authority", &self.0.authority).finish_non_exhaustive()
    }
}

impl OtlpClient {
    /// # Errors
    /// There is no runtime. With TLS: no root certificates are trusted, or the collector's name is invalid.
    pub(crate) fn new(collector: &Collector, rejected: Arc<AtomicU64>) -> Result<Self, String> {
        let tls = collector.is_tls.then(|| Connector::new(collector.host())).transpose()?;
        let runtime = Handle::try_current().map_err(|error| error.to_string())?;
        let authority = collector.authority.clone();
        Ok(Self(Arc::new(ClientState { authority, tls, rejected, connection: Mutex::new(None), runtime })))
    }
}

impl ClientState {
    async fn connect(&self) -> Result<SendRequest<Full<Bytes>>, HttpError> {
        let stream = TcpStream::connect(&self.authority).await?;
        match &self.tls {
            Some(connector) => start(connector.connect(stream).await?).await,
            None => start(stream).await,
        }
    }

    async fn send(&self, request: Request<Bytes>) -> Result<Response<Bytes>, HttpError> {
        let (mut head, body) = request.into_parts();
        head.headers.insert(HOST, HeaderValue::from_str(&self.authority)?);
        // HTTP/1.1 sends the path alone.
        head.uri = head.uri.path().parse()?;
        // Taken out: a cancelled request leaves no connection with a half-read response behind.
        let mut slot = self.connection.lock().await;
        let kept = slot.take().filter(|connection| !connection.is_closed());
        let mut connection = match kept {
            Some(kept) => kept,
            None => self.connect().await?,
        };
        connection.ready().await?;
        let response = connection.send_request(Request::from_parts(head, Full::new(body))).await?;
        let (head, body) = response.into_parts();
        let body = Limited::new(body, MAX_RESPONSE_BYTES).collect().await?.to_bytes();
        *slot = Some(connection);
        // A response that cannot be read rejects nothing.
        let response = ExportTraceServiceResponse::decode(body.clone()).unwrap_or_default();
        let rejected = response.partial_success.map_or(0, |partial| partial.rejected_spans);
        self.rejected.fetch_add(u64::try_from(rejected).unwrap_or(0), Ordering::Relaxed);
        Ok(Response::from_parts(head, body))
    }
}

async fn start<S>(stream: S) -> Result<SendRequest<Full<Bytes>>, HttpError>
where
    S: AsyncRead + AsyncWrite + Unpin + Send + 'static,
{
    let (sender, connection) = handshake(TokioIo::new(stream)).await?;
    // Ends with the sender, which also returns its errors.
    tokio::spawn(connection);
    Ok(sender)
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
        let sending = self.0.runtime.spawn(async move { timeout(EXPORT_TIMEOUT, client.send(request)).await? });
        Box::pin(async move {
            let sent = sending.await.unwrap_or_else(|ended| Err(ended.into()));
            // The exporter's own error does not have the reason.
            sent.inspect_err(|error| tracing::debug!(%error, "spans were not sent to {}", self.0.authority))
        })
    }
}
