//! A collector of traces: takes batches over HTTP and reads them by the crates that define them.

use std::collections::BTreeMap;
use std::net::SocketAddr;
use std::sync::{Arc, Mutex};

use axum::Router;
use axum::body::Bytes;
use axum::extract::State;
use axum::http::HeaderMap;
use axum::routing::post;
use axum::serve::Listener;
use mlswarp_server::auth::tls::TlsFiles;
use opentelemetry_proto::tonic::collector::trace::v1::{
    ExportTracePartialSuccess, ExportTraceServiceRequest, ExportTraceServiceResponse,
};
use opentelemetry_proto::tonic::common::v1::KeyValue;
use opentelemetry_proto::tonic::common::v1::any_value::Value;
use opentelemetry_proto::tonic::trace::v1::Span;
use prost::Message as _;
use tokio::net::{TcpListener, TcpStream};
use tokio_rustls::TlsAcceptor;
use tokio_rustls::server::TlsStream;

#[derive(Clone)]
pub(crate) struct Collector {
    address: SocketAddr,
    batches: Arc<Mutex<Vec<Bytes>>>,
    headers: Arc<Mutex<HeaderMap>>,
    /// What it says to each batch.
    answer: Arc<Mutex<Bytes>>,
}

impl Collector {
    pub(crate) async fn start() -> Self {
        let listener = TcpListener::bind("127.0.0.1:0").await.unwrap();
        let address = listener.local_addr().unwrap();
        Self::on(address, listener)
    }

    /// Behind TLS, with the certificate of the files.
    pub(crate) async fn start_tls(files: &TlsFiles, host: &str) -> Self {
        let listener = TcpListener::bind((host, 0)).await.unwrap();
        let address = listener.local_addr().unwrap();
        Self::on(
            address,
            Encrypted {
                listener,
                acceptor: files.load().unwrap().into(),
            },
        )
    }

    fn on(address: SocketAddr, listener: impl Listener<Addr = SocketAddr>) -> Self {
        let collector = Self {
            address,
            batches: Arc::default(),
            headers: Arc::default(),
            answer: Arc::default(),
        };
        let router = Router::new()
            .route("/v1/traces", post(take))
            .with_state(collector.clone());
        tokio::spawn(async move { axum::serve(listener, router).await.unwrap() });
        collector
    }

    /// From now on it rejects this number of spans of each batch.
    pub(crate) fn reject(&self, rejected_spans: i64) {
        let partial = ExportTracePartialSuccess {
            rejected_spans,
            error_message: "not these".to_owned(),
        };
        let answer = ExportTraceServiceResponse {
            partial_success: Some(partial),
        };
        *self.answer.lock().unwrap() = answer.encode_to_vec().into();
    }

    pub(crate) const fn address(&self) -> SocketAddr {
        self.address
    }

    pub(crate) fn url(&self) -> String {
        format!("http://{}", self.address)
    }

    /// Everything that was sent, as it was sent.
    pub(crate) fn bytes(&self) -> Vec<u8> {
        self.batches.lock().unwrap().concat()
    }

    /// The head of the last batch.
    pub(crate) fn headers(&self) -> HeaderMap {
        self.headers.lock().unwrap().clone()
    }

    pub(crate) fn requests(&self) -> Vec<ExportTraceServiceRequest> {
        let batches = self.batches.lock().unwrap();
        batches
            .iter()
            .map(|batch| ExportTraceServiceRequest::decode(batch.clone()).unwrap())
            .collect()
    }

    pub(crate) fn spans(&self) -> Vec<Span> {
        let scopes = self
            .requests()
            .into_iter()
            .flat_map(|request| request.resource_spans)
            .flat_map(|spans| spans.scope_spans);
        scopes.flat_map(|scope| scope.spans).collect()
    }

    /// What has sent them.
    pub(crate) fn resource(&self) -> BTreeMap<String, String> {
        attributes(
            &self.requests()[0].resource_spans[0]
                .resource
                .as_ref()
                .unwrap()
                .attributes,
        )
    }

    /// The span of that name.
    pub(crate) fn named(&self, name: &str) -> Option<Span> {
        self.spans().into_iter().find(|span| span.name == name)
    }
}

/// Connections that have completed a handshake; the others are ignored.
struct Encrypted {
    listener: TcpListener,
    acceptor: TlsAcceptor,
}

impl Listener for Encrypted {
    type Io = TlsStream<TcpStream>;
    type Addr = SocketAddr;

    async fn accept(&mut self) -> (Self::Io, SocketAddr) {
        loop {
            let (stream, peer) = self.listener.accept().await.unwrap();
            if let Ok(stream) = self.acceptor.accept(stream).await {
                return (stream, peer);
            }
        }
    }

    fn local_addr(&self) -> std::io::Result<SocketAddr> {
        self.listener.local_addr()
    }
}

async fn take(State(collector): State<Collector>, headers: HeaderMap, batch: Bytes) -> Bytes {
    assert_eq!(headers["content-type"], "application/x-protobuf");
    collector.batches.lock().unwrap().push(batch);
    *collector.headers.lock().unwrap() = headers;
    collector.answer.lock().unwrap().clone()
}

/// Attributes by name, as text.
pub(crate) fn attributes(of: &[KeyValue]) -> BTreeMap<String, String> {
    let text = |pair: &KeyValue| match pair.value.as_ref().and_then(|value| value.value.as_ref()) {
        Some(Value::StringValue(text)) => text.clone(),
        Some(Value::IntValue(number)) => number.to_string(),
        other => panic!("{other:?}"),
    };
    of.iter()
        .map(|pair| (pair.key.clone(), text(pair)))
        .collect()
}
