//! Batches of spans to their collector: one connection that is kept, HTTP/1.1, no TLS. Whoever calls bounds the time.

use std::fmt;
use std::future::Future;
use std::pin::Pin;

use http_body_util::{BodyExt as _, Full, Limited};
use hyper::client::conn::http1::{SendRequest, handshake};
use hyper::header::{HOST, HeaderValue};
use hyper_util::rt::TokioIo;
use opentelemetry_http::{Bytes, HttpClient, HttpError, Request, Response};
use tokio::net::TcpStream;
use tokio::sync::Mutex;

use crate::service::config::Collector;

/// Most bytes of a collector's answer: it has next to nothing to say.
const ANSWER: usize = 64 << 10;

/// A client of one collector.
pub(super) struct Post {
    authority: String,
    connection: Mutex<Option<SendRequest<Full<Bytes>>>>,
}

impl fmt::Debug for Post {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.debug_struct("Post").field("authority", &self.authority).finish_non_exhaustive()
    }
}

impl Post {
    pub(super) fn new(collector: &Collector) -> Self {
        Self { authority: collector.authority.clone(), connection: Mutex::new(None) }
    }

    async fn connect(&self) -> Result<SendRequest<Full<Bytes>>, HttpError> {
        let stream = TcpStream::connect(&self.authority).await?;
        let (sender, connection) = handshake(TokioIo::new(stream)).await?;
        // Ends with the sender, and its errors are the sender's.
        tokio::spawn(connection);
        Ok(sender)
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
        Ok(Response::from_parts(head, body))
    }
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
