//! Batches of spans to their collector: one connection that is kept, HTTP/1.1, plain or by TLS. Whoever calls bounds the time.

use std::fmt;
use std::future::Future;
use std::pin::Pin;
use std::sync::Arc;
use std::sync::atomic::{AtomicU64, Ordering};

use http_body_util::{BodyExt as _, Full, Limited};
use hyper::client::conn::http1::{SendRequest, handshake};
use hyper::header::{HOST, HeaderValue};
use hyper_util::rt::TokioIo;
use opentelemetry_http::{Bytes, HttpClient, HttpError, Request, Response};
use opentelemetry_proto::tonic::collector::trace::v1::ExportTraceServiceResponse;
use prost::Message as _;
use tokio::io::{AsyncRead, AsyncWrite};
use tokio::net::TcpStream;
use tokio::sync::Mutex;

use super::collector::Collector;
use crate::auth::tls::Connector;

/// Most bytes of a collector's answer: it has next to nothing to say.
const ANSWER: usize = 64 << 10;

/// A client of one collector.
pub(crate) struct Post {
    authority: String,
    tls: Option<Connector>,
    /// Spans that the collector would not have, though it took their batch.
    rejected: Arc<AtomicU64>,
    connection: Mutex<Option<SendRequest<Full<Bytes>>>>,
}

impl fmt::Debug for Post {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.debug_struct("Post").field("authority", &self.authority).finish_non_exhaustive()
    }
}

impl Post {
    /// # Errors
    /// TLS is wanted, and nobody is trusted or the collector's name is none.
    pub(crate) fn new(collector: &Collector, rejected: Arc<AtomicU64>) -> Result<Self, String> {
        let tls = collector.is_tls.then(|| Connector::new(collector.host())).transpose()?;
        Ok(Self { authority: collector.authority.clone(), tls, rejected, connection: Mutex::new(None) })
    }

    async fn connect(&self) -> Result<SendRequest<Full<Bytes>>, HttpError> {
        let stream = TcpStream::connect(&self.authority).await?;
        match &self.tls {
            Some(connector) => begin(connector.connect(stream).await?).await,
            None => begin(stream).await,
        }
    }

    async fn post(&self, request: Request<Bytes>) -> Result<Response<Bytes>, HttpError> {
        let (mut head, body) = request.into_parts();
        head.headers.insert(HOST, HeaderValue::from_str(&self.authority)?);
        // On a connection of HTTP/1.1 the path alone is asked for.
        head.uri = head.uri.path().parse()?;
        // Taken out: a call that is given up leaves no half-read answer behind.
        let mut slot = self.connection.lock().await;
        let kept = slot.take().filter(|connection| !connection.is_closed());
        let mut connection = match kept {
            Some(kept) => kept,
            None => self.connect().await?,
        };
        connection.ready().await?;
        let response = connection.send_request(Request::from_parts(head, Full::new(body))).await?;
        let (head, body) = response.into_parts();
        let body = Limited::new(body, ANSWER).collect().await?.to_bytes();
        *slot = Some(connection);
        // A collector that has nothing to add says nothing; what cannot be read is nothing.
        let answer = ExportTraceServiceResponse::decode(body.clone()).unwrap_or_default();
        let rejected = answer.partial_success.map_or(0, |partial| partial.rejected_spans);
        self.rejected.fetch_add(u64::try_from(rejected).unwrap_or(0), Ordering::Relaxed);
        Ok(Response::from_parts(head, body))
    }
}

async fn begin<S>(stream: S) -> Result<SendRequest<Full<Bytes>>, HttpError>
where
    S: AsyncRead + AsyncWrite + Unpin + Send + 'static,
{
    let (sender, connection) = handshake(TokioIo::new(stream)).await?;
    // Ends with the sender, and its errors are the sender's.
    tokio::spawn(connection);
    Ok(sender)
}

impl HttpClient for Post {
    fn send_bytes<'a, 'b>(
        &'a self,
        request: Request<Bytes>,
    ) -> Pin<Box<dyn Future<Output = Result<Response<Bytes>, HttpError>> + Send + 'b>>
    where
        'a: 'b,
        Self: 'b,
    {
        Box::pin(async move {
            let posted = self.post(request).await;
            // The exporter says no more than that the network failed.
            posted.inspect_err(|error| tracing::debug!(%error, "spans were not posted to {}", self.authority))
        })
    }
}
