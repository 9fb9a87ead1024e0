//! Traces on their way to a collector: which requests are traced, a bounded queue that never makes anybody wait, and one task that exports it in
//! batches. Where the collector does not keep up, is away or never answers, spans are dropped and counted.
//!
//! A caller's `traceparent` is followed: what it does not sample is not traced; what it samples is, as often as `OBEYED` allows, since anybody
//! may send the flag. Beyond that, and without a caller, the share decides by the id of the request's own span: the trace's id is the caller's to
//! choose.

use std::fmt;
use std::sync::atomic::{AtomicU64, Ordering};
use std::sync::{Arc, Mutex, PoisonError};
use std::time::{Duration, Instant};

use opentelemetry::trace::{SpanContext, SpanId, TraceFlags, TraceId, TraceState};
use opentelemetry::{InstrumentationScope, KeyValue};
use opentelemetry_otlp::{Protocol, RetryPolicy, SpanExporter, WithExportConfig as _, WithHttpConfig as _};
use opentelemetry_sdk::Resource;
use opentelemetry_sdk::resource::EnvResourceDetector;
use opentelemetry_sdk::trace::{IdGenerator as _, RandomIdGenerator, SpanExporter as _};
use thiserror::Error;
use tokio::sync::{mpsc, oneshot, watch};
use tokio::task::JoinHandle;

use super::collected::Collected;
use super::collector::Collector;
use super::otlp_client::Post;
use crate::limits::bucket::Bucket;

/// The name of the service in every trace.
const SERVICE: &str = "mlswarp";
/// Traces that wait to be exported, about a kilobyte each.
const QUEUE: usize = 2048;
/// Traces that are exported at once.
const BATCH: usize = 256;
/// How long the first of a batch waits for others.
const PAUSE: Duration = Duration::from_secs(1);
/// Longest time for a collector to take a batch.
const PATIENCE: Duration = Duration::from_secs(10);
/// Traces a second, and at once, that are made because a caller asked for them.
const OBEYED: (f64, f64) = (100.0, 200.0);

/// Traces of a collector cannot be made.
#[derive(Debug, Error)]
#[error("traces cannot be exported to {collector}: {why}")]
pub struct NotTraced {
    collector: Collector,
    why: String,
}

/// Begins traces. Cloning shares it.
#[derive(Clone, Debug)]
pub struct Tracer(Arc<TracerState>);

struct TracerState {
    share: f64,
    obeyed: Mutex<Bucket>,
    queue: mpsc::Sender<Collected>,
    /// Traces that have not ended.
    open: watch::Sender<usize>,
    tally: Arc<Tally>,
}

impl fmt::Debug for TracerState {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.debug_struct("Shared").field("share", &self.share).field("tally", &self.tally).finish_non_exhaustive()
    }
}

/// What has become of spans.
#[derive(Debug, Default)]
pub struct Tally {
    exported: AtomicU64,
    dropped: AtomicU64,
}

impl Tally {
    /// Spans that a collector has taken.
    #[must_use]
    pub fn exported(&self) -> u64 {
        self.exported.load(Ordering::Relaxed)
    }

    /// Spans that were lost because the queue was full or the collector did not take them.
    #[must_use]
    pub fn dropped(&self) -> u64 {
        self.dropped.load(Ordering::Relaxed)
    }
}

/// What is to be exported, before somebody does.
pub struct Outbox {
    queue: mpsc::Receiver<Collected>,
    open: watch::Receiver<usize>,
    exporter: SpanExporter,
    /// Spans that the collector would not have of batches that it took.
    rejected: Arc<AtomicU64>,
    collector: Collector,
    tally: Arc<Tally>,
}

impl fmt::Debug for Outbox {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.debug_struct("Outbox").field("collector", &self.collector).finish_non_exhaustive()
    }
}

impl Tracer {
    /// For the collector of the options, if there is one.
    ///
    /// # Errors
    /// The exporter cannot be made of the address and the variables of OpenTelemetry.
    pub fn new(endpoint: Option<Collector>, share: f64) -> Result<Option<(Self, Outbox)>, NotTraced> {
        let Some(collector) = endpoint else { return Ok(None) };
        let rejected = Arc::<AtomicU64>::default();
        let built = Post::new(&collector, Arc::clone(&rejected)).and_then(|post| {
            SpanExporter::builder()
                .with_http()
                .with_endpoint(collector.to_string())
                .with_protocol(Protocol::HttpBinary)
                .with_http_client(post)
                // Trying again would stop the queue; what is lost is counted.
                .with_retry_policy(RetryPolicy::disabled())
                .build()
                .map_err(|error| error.to_string())
        });
        let mut exporter = match built {
            Ok(exporter) => exporter,
            Err(why) => return Err(NotTraced { collector, why }),
        };
        exporter.set_resource(&resource());
        let (sender, queue) = mpsc::channel(QUEUE);
        let (open, opened) = watch::channel(0);
        let tally = Arc::<Tally>::default();
        let obeyed = Mutex::new(Bucket::new(OBEYED.0, OBEYED.1, Instant::now()));
        let shared = TracerState { share, obeyed, queue: sender, open, tally: Arc::clone(&tally) };
        Ok(Some((Self(Arc::new(shared)), Outbox { queue, open: opened, exporter, rejected, collector, tally })))
    }

    /// What has become of spans so far.
    #[must_use]
    pub fn tally(&self) -> &Tally {
        &self.0.tally
    }

    pub(crate) fn context(&self, trace: TraceId, caller: Option<bool>, now: Instant) -> SpanContext {
        let span = RandomIdGenerator::default().new_span_id();
        let flags = if self.samples(span, caller, now) { TraceFlags::SAMPLED } else { TraceFlags::default() };
        SpanContext::new(trace, span, flags, false, TraceState::NONE)
    }

    fn samples(&self, span: SpanId, caller: Option<bool>, now: Instant) -> bool {
        let obeyed = || self.0.obeyed.lock().unwrap_or_else(PoisonError::into_inner).take(now);
        match caller {
            Some(false) => false,
            Some(true) => by_share(span, self.0.share) || obeyed(),
            None => by_share(span, self.0.share),
        }
    }

    /// A trace begins; [`Tracer::hand_over`] is its end.
    pub(crate) fn opened(&self) {
        self.0.open.send_modify(|open| *open += 1);
    }

    pub(crate) fn hand_over(&self, collected: Collected) {
        let spans = collected.spans() as u64;
        if self.0.queue.try_send(collected).is_err() {
            self.0.tally.dropped.fetch_add(spans, Ordering::Relaxed);
        }
        self.0.open.send_modify(|open| *open -= 1);
    }
}

/// By 63 bits of a random id.
fn by_share(span: SpanId, share: f64) -> bool {
    let low = u64::from_be_bytes(span.to_bytes()) >> 1;
    #[expect(clippy::cast_possible_truncation, clippy::cast_sign_loss, clippy::cast_precision_loss, reason = "between 0 and 2^63")]
    let bound = (share * (1_u64 << 63) as f64) as u64;
    low < bound
}

/// What sends the spans: the operator's words (`OTEL_SERVICE_NAME`, `OTEL_RESOURCE_ATTRIBUTES`) come before our own.
fn resource() -> Resource {
    let own = [
        KeyValue::new("service.version", env!("CARGO_PKG_VERSION")),
        KeyValue::new("service.instance.id", uuid::Uuid::new_v4().to_string()),
    ];
    let resource =
        Resource::builder_empty().with_service_name(SERVICE).with_attributes(own).with_detector(Box::new(EnvResourceDetector::new()));
    match std::env::var("OTEL_SERVICE_NAME").ok().filter(|name| !name.is_empty()) {
        Some(name) => resource.with_service_name(name).build(),
        None => resource.build(),
    }
}

/// The task that exports.
#[derive(Debug)]
pub struct Exporting {
    task: JoinHandle<()>,
    open: watch::Receiver<usize>,
    stop: oneshot::Sender<()>,
}

impl Exporting {
    /// Exports what is left, for as long as `within`. A thread may still hold the trace of a request that has been answered: it has a part of that.
    pub async fn finish(mut self, within: Duration) {
        let end = tokio::time::Instant::now() + within;
        let _ = tokio::time::timeout(within / 4, self.open.wait_for(|open| *open == 0)).await;
        let _ = self.stop.send(());
        if tokio::time::timeout_at(end, &mut self.task).await.is_err() {
            self.task.abort();
            tracing::warn!("traces that were not exported within {within:?} are lost");
        }
    }
}

impl Outbox {
    /// Begins to export. Needs a runtime.
    #[must_use]
    pub fn open(self) -> Exporting {
        let (stop, stopped) = oneshot::channel();
        let open = self.open.clone();
        Exporting { task: tokio::spawn(self.run(stopped)), open, stop }
    }

    async fn run(mut self, mut stopped: oneshot::Receiver<()>) {
        let scope = InstrumentationScope::builder(SERVICE).with_version(env!("CARGO_PKG_VERSION")).build();
        let mut is_away = false;
        loop {
            let mut batch = Vec::new();
            let is_over = self.gather(&mut batch, &mut stopped).await;
            let mut spans = Vec::new();
            for collected in batch {
                collected.write(&scope, &mut spans);
            }
            if !spans.is_empty() {
                self.export(spans, &mut is_away).await;
            }
            if is_over {
                return;
            }
        }
    }

    /// A batch; true when it is the last.
    async fn gather(&mut self, batch: &mut Vec<Collected>, stopped: &mut oneshot::Receiver<()>) -> bool {
        let mut until = None;
        while batch.len() < BATCH {
            let pause = async {
                match until {
                    Some(until) => tokio::time::sleep_until(until).await,
                    None => std::future::pending().await,
                }
            };
            let room = BATCH - batch.len();
            tokio::select! {
                biased;
                _ = &mut *stopped, if !self.queue.is_closed() => self.queue.close(),
                received = self.queue.recv_many(batch, room) => {
                    if received == 0 {
                        return true;
                    }
                    until.get_or_insert_with(|| tokio::time::Instant::now() + PAUSE);
                }
                () = pause => return false,
            }
        }
        false
    }

    async fn export(&self, spans: Vec<opentelemetry_sdk::trace::SpanData>, is_away: &mut bool) {
        let count = spans.len() as u64;
        self.rejected.store(0, Ordering::Relaxed);
        let why = match tokio::time::timeout(PATIENCE, self.exporter.export(spans)).await {
            Ok(Ok(())) => {
                let rejected = self.rejected.swap(0, Ordering::Relaxed).min(count);
                self.tally.exported.fetch_add(count - rejected, Ordering::Relaxed);
                self.tally.dropped.fetch_add(rejected, Ordering::Relaxed);
                if rejected > 0 {
                    tracing::debug!(rejected, "spans that the collector would not have are lost ({})", self.collector);
                }
                if std::mem::take(is_away) {
                    tracing::info!("traces are exported again ({})", self.collector);
                }
                return;
            }
            Ok(Err(error)) => error.to_string(),
            Err(_) => format!("no answer within {PATIENCE:?}"),
        };
        self.tally.dropped.fetch_add(count, Ordering::Relaxed);
        // Told once, until it takes them again.
        if !std::mem::replace(is_away, true) {
            tracing::warn!("traces are not exported ({}), and dropped until they can be: {why}", self.collector);
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::observe::trace::Asked;
    use tokio::io::{AsyncReadExt as _, AsyncWriteExt as _};

    fn tracer(share: f64) -> (Tracer, Outbox) {
        Tracer::new(Some(Collector::parse("http://127.0.0.1:1").unwrap()), share).unwrap().unwrap()
    }

    fn parent(sampled: bool) -> Asked<'static> {
        asked(RandomIdGenerator::default().new_trace_id(), sampled)
    }

    fn asked(trace: TraceId, sampled: bool) -> Asked<'static> {
        let flags = if sampled { TraceFlags::SAMPLED } else { TraceFlags::default() };
        let span = RandomIdGenerator::default().new_span_id();
        Asked { parent: SpanContext::new(trace, span, flags, true, TraceState::NONE), ..stranger() }
    }

    fn stranger() -> Asked<'static> {
        Asked { parent: SpanContext::empty_context(), began: Instant::now(), method: Some("GET"), route: Some("/"), scheme: "http" }
    }

    #[tokio::test]
    async fn a_trace_that_ends_a_little_after_its_request_is_exported_too() {
        let listener = tokio::net::TcpListener::bind("127.0.0.1:0").await.unwrap();
        let endpoint = Collector::parse(&format!("http://{}", listener.local_addr().unwrap())).unwrap();
        let (tracer, outbox) = Tracer::new(Some(endpoint), 1.0).unwrap().unwrap();
        let takes = async {
            let (mut socket, _) = listener.accept().await.unwrap();
            assert!(socket.read(&mut [0; 1024]).await.unwrap() > 0);
            socket.write_all(b"HTTP/1.1 200 OK\r\ncontent-length: 0\r\n\r\n").await.unwrap();
            tokio::io::copy(&mut socket, &mut tokio::io::sink()).await.unwrap();
        };
        let (_, trace) = tracer.request("late", &stranger());
        let late = async {
            tokio::time::sleep(Duration::from_millis(100)).await;
            drop(trace.unwrap());
        };
        let ends = async { tokio::join!(takes, outbox.open().finish(Duration::from_secs(60)), late) };
        let _ = tokio::time::timeout(Duration::from_secs(30), ends).await;
        assert_eq!((tracer.tally().exported(), tracer.tally().dropped()), (1, 0));
    }

    #[test]
    fn the_share_decides_where_no_caller_does() {
        let count = |share: f64| {
            let (tracer, _outbox) = tracer(share);
            (0..1000).filter(|_| tracer.request("r", &stranger()).1.is_some()).count()
        };
        assert_eq!((count(0.0), count(1.0)), (0, 1000));
        assert!((350..650).contains(&count(0.5)));
    }

    #[test]
    fn a_caller_is_followed_and_bounded() {
        let (everything, _outbox) = tracer(1.0);
        assert!(everything.request("r", &parent(false)).1.is_none(), "what the caller does not sample is not traced");
        let (nothing, _outbox) = tracer(0.0);
        let asked = parent(true);
        let (context, trace) = nothing.request("r", &asked);
        assert!(trace.is_some() && context.trace_id() == asked.parent.trace_id() && context.span_id() != asked.parent.span_id());
        let obeyed = (0..1000).filter(|_| nothing.request("r", &parent(true)).1.is_some()).count();
        assert!((190..600).contains(&obeyed), "{obeyed}");
    }

    #[test]
    fn a_caller_chooses_no_id_that_is_traced_more_often() {
        let (tracer, _outbox) = tracer(0.01);
        let traced = (0..2000).filter(|_| tracer.request("r", &asked(TraceId::from_bytes(1_u128.to_be_bytes()), true)).1.is_some()).count();
        assert!((190..800).contains(&traced), "{traced}");
    }

    #[test]
    fn a_full_queue_drops_and_counts() {
        let (tracer, mut outbox) = tracer(1.0);
        for _ in 0..QUEUE + 10 {
            drop(tracer.request("r", &stranger()));
        }
        assert_eq!((tracer.tally().dropped(), outbox.queue.len()), (10, QUEUE));
        outbox.queue.close();
        drop(tracer.request("r", &stranger()));
        assert_eq!(tracer.tally().dropped(), 11, "and after the end");
    }
}
