//! The OpenTelemetry tracer: the SDK's provider and batch processor, with a bounded queue and
//! counters of exported and dropped spans.

use std::sync::Arc;
use std::sync::atomic::{AtomicBool, AtomicU64, AtomicUsize, Ordering};
use std::time::Duration;

use opentelemetry::trace::TracerProvider as _;
use opentelemetry::{Context, InstrumentationScope, KeyValue};
use opentelemetry_sdk::Resource;
use opentelemetry_sdk::error::OTelSdkResult;
use opentelemetry_sdk::resource::EnvResourceDetector;
use opentelemetry_sdk::trace::{
    BatchConfigBuilder, BatchSpanProcessor, SdkTracer, SdkTracerProvider, Span, SpanData,
    SpanExporter, SpanLimits, SpanProcessor,
};
use prometheus_client::metrics::counter::Counter;
use tokio::time::Instant;

use super::otlp_client::{self, CollectorUrl};
use super::sampler::Sampler;

const SERVICE: &str = "mlswarp";
/// Spans of about half a kilobyte each; a request has eight.
const MAX_QUEUED: usize = 16_384;
const MAX_BATCH: usize = 2048;
const EXPORT_INTERVAL: Duration = Duration::from_secs(1);
const SHUTDOWN_POLL: Duration = Duration::from_millis(5);

/// The state of the export.
#[derive(Debug, Default)]
pub struct ExportStats {
    /// Spans that the collector has accepted.
    pub exported: Counter,
    /// Spans that were lost: the queue was full, or the collector did not accept them.
    pub dropped: Counter,
    /// Spans that have not ended.
    open: AtomicUsize,
    queued: AtomicUsize,
    /// The last export failed: the next failure is not logged.
    is_failing: AtomicBool,
    /// Later spans are dropped.
    is_shut_down: AtomicBool,
}

/// Starts spans. Clones share it.
#[derive(Clone, Debug)]
pub struct Tracer {
    pub(crate) sdk: SdkTracer,
    queue: SpanQueue,
}

impl Tracer {
    /// Starts to export to `collector` a `share` of the requests whose callers have not decided.
    /// Needs a runtime.
    pub(crate) fn new(collector: &CollectorUrl, share: f64) -> Result<Self, String> {
        let failed = |why: String| format!("traces cannot be exported to {collector}: {why}");
        let stats = Arc::<ExportStats>::default();
        let (exporter, rejected) = otlp_client::exporter(collector, &resource()).map_err(failed)?;
        let exporter = CountingExporter {
            exporter,
            rejected,
            collector: collector.clone(),
            stats: Arc::clone(&stats),
        };
        let config = BatchConfigBuilder::default()
            .with_max_queue_size(MAX_QUEUED)
            .with_max_export_batch_size(MAX_BATCH)
            .with_scheduled_delay(EXPORT_INTERVAL)
            .build();
        let queue = SpanQueue {
            batches: Arc::new(BatchSpanProcessor::new(exporter, config)),
            stats,
        };
        let provider = SdkTracerProvider::builder()
            .with_sampler(Sampler::new(share))
            // Set here, or variables of the environment would set them.
            .with_span_limits(SpanLimits::default())
            .with_span_processor(queue.clone())
            .build();
        let scope = InstrumentationScope::builder(SERVICE)
            .with_version(env!("CARGO_PKG_VERSION"))
            .build();
        Ok(Self {
            sdk: provider.tracer_with_scope(scope),
            queue,
        })
    }

    /// The state of the export.
    pub fn stats(&self) -> &ExportStats {
        &self.queue.stats
    }

    /// Exports what is left, for at most `timeout`. A thread may still hold the span of an answered
    /// request: it has a quarter of that time.
    pub(crate) async fn shutdown(&self, timeout: Duration) {
        let deadline = Instant::now() + timeout;
        while self.stats().open.load(Ordering::Relaxed) > 0
            && Instant::now() < deadline - timeout * 3 / 4
        {
            tokio::time::sleep(SHUTDOWN_POLL).await;
        }
        self.stats().is_shut_down.store(true, Ordering::Relaxed);
        let batches = Arc::clone(&self.queue.batches);
        let flush = move || {
            batches.shutdown_with_timeout(deadline.saturating_duration_since(Instant::now()))
        };
        if !matches!(tokio::task::spawn_blocking(flush).await, Ok(Ok(()))) {
            self.stats().is_failing.store(true, Ordering::Relaxed);
            tracing::warn!("traces that were not exported within {timeout:?} are lost");
        }
    }
}

/// The SDK's batch processor behind a bound that counts what it drops.
#[derive(Clone, Debug)]
struct SpanQueue {
    batches: Arc<BatchSpanProcessor>,
    stats: Arc<ExportStats>,
}

impl SpanProcessor for SpanQueue {
    fn on_start(&self, _: &mut Span, _: &Context) {
        self.stats.open.fetch_add(1, Ordering::Relaxed);
    }

    fn on_end(&self, span: SpanData) {
        let Self { batches, stats } = self;
        // The SDK's queue has the same bound, but does not say what it drops.
        let queued = stats.queued.fetch_add(1, Ordering::Relaxed);
        if queued < MAX_QUEUED && !stats.is_shut_down.load(Ordering::Relaxed) {
            batches.on_end(span);
        } else {
            stats.queued.fetch_sub(1, Ordering::Relaxed);
            stats.dropped.inc();
        }
        stats.open.fetch_sub(1, Ordering::Relaxed);
    }

    fn force_flush(&self) -> OTelSdkResult {
        self.batches.force_flush()
    }

    /// Does nothing: the provider calls this when it is dropped, which must not block.
    /// [`Tracer::shutdown`] exports what is left.
    fn shutdown_with_timeout(&self, _: Duration) -> OTelSdkResult {
        Ok(())
    }
}

/// Counts what becomes of each batch, and logs when exports begin to fail and when they succeed
/// again.
#[derive(Debug)]
struct CountingExporter<E> {
    exporter: E,
    /// Spans that the collector rejected of the batch that it accepted.
    rejected: Arc<AtomicU64>,
    collector: CollectorUrl,
    stats: Arc<ExportStats>,
}

impl<E: SpanExporter> SpanExporter for CountingExporter<E> {
    async fn export(&self, batch: Vec<SpanData>) -> OTelSdkResult {
        let Self {
            exporter,
            rejected,
            collector,
            stats,
        } = self;
        stats.queued.fetch_sub(batch.len(), Ordering::Relaxed);
        let count = batch.len() as u64;
        let result = exporter.export(batch).await;
        let rejected = rejected.swap(0, Ordering::Relaxed).min(count);
        let was_failing = stats.is_failing.swap(result.is_err(), Ordering::Relaxed);
        match &result {
            Ok(()) if was_failing => tracing::info!("traces are exported again ({collector})"),
            Err(error) if !was_failing => tracing::warn!(
                "traces are not exported ({collector}), and dropped until they can be: {error}"
            ),
            _ => {}
        }
        if result.is_ok() && rejected > 0 {
            tracing::debug!(rejected, "the collector rejected spans ({collector})");
        }
        let dropped = if result.is_ok() { rejected } else { count };
        stats.exported.inc_by(count - dropped);
        stats.dropped.inc_by(dropped);
        result
    }
}

/// The resource of all spans: `OTEL_SERVICE_NAME` and `OTEL_RESOURCE_ATTRIBUTES` come before our
/// own attributes.
fn resource() -> Resource {
    let version = KeyValue::new("service.version", env!("CARGO_PKG_VERSION"));
    let instance = KeyValue::new("service.instance.id", uuid::Uuid::new_v4().to_string());
    let own = Resource::builder_empty()
        .with_service_name(SERVICE)
        .with_attributes([version, instance]);
    let resource = own.with_detector(Box::new(EnvResourceDetector::new()));
    match std::env::var("OTEL_SERVICE_NAME")
        .ok()
        .filter(|name| !name.is_empty())
    {
        Some(name) => resource.with_service_name(name).build(),
        None => resource.build(),
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::observe::otlp_client::parse_collector;
    use crate::observe::{RequestInfo, Scope};
    use opentelemetry::trace::{SpanContext, TraceContextExt as _, TraceFlags, TraceState};
    use opentelemetry_sdk::trace::{IdGenerator as _, RandomIdGenerator};
    use tokio::io::{AsyncReadExt as _, AsyncWriteExt as _};
    use tokio::net::TcpListener;

    fn request(tracer: &Tracer, parent: Context) -> Scope {
        let info = RequestInfo {
            parent,
            began: std::time::Instant::now(),
            method: Some("GET"),
            route: Some("/"),
            scheme: "http",
        };
        Scope::request("r", tracer, &info)
    }

    async fn listen() -> (TcpListener, CollectorUrl) {
        let listener = TcpListener::bind("127.0.0.1:0").await.unwrap();
        let collector =
            parse_collector(&format!("http://{}", listener.local_addr().unwrap())).unwrap();
        (listener, collector)
    }

    #[tokio::test]
    async fn a_trace_that_ends_a_little_after_its_request_is_exported_too() {
        let (listener, collector) = listen().await;
        let tracer = Tracer::new(&collector, 1.0).unwrap();
        let takes = async {
            let (mut socket, _) = listener.accept().await.unwrap();
            assert!(socket.read(&mut [0; 1024]).await.unwrap() > 0);
            socket
                .write_all(b"HTTP/1.1 200 OK\r\ncontent-length: 0\r\n\r\n")
                .await
                .unwrap();
            tokio::io::copy(&mut socket, &mut tokio::io::sink())
                .await
                .unwrap();
        };
        let scope = request(&tracer, Context::new());
        let late = async {
            tokio::time::sleep(Duration::from_millis(100)).await;
            drop(scope);
        };
        let ends = async { tokio::join!(takes, tracer.shutdown(Duration::from_secs(60)), late) };
        let _ = tokio::time::timeout(Duration::from_secs(30), ends).await;
        assert_eq!(
            (tracer.stats().exported.get(), tracer.stats().dropped.get()),
            (1, 0)
        );
        drop(request(&tracer, Context::new()));
        assert_eq!(tracer.stats().dropped.get(), 1, "after the end");
    }

    #[tokio::test(flavor = "multi_thread", worker_threads = 1)]
    async fn a_request_belongs_to_its_callers_trace() {
        let tracer = Tracer::new(&parse_collector("http://127.0.0.1:1").unwrap(), 0.0).unwrap();
        let ids = RandomIdGenerator::default();
        let caller = SpanContext::new(
            ids.new_trace_id(),
            ids.new_span_id(),
            TraceFlags::SAMPLED,
            true,
            TraceState::NONE,
        );
        let scope = request(
            &tracer,
            Context::new().with_remote_span_context(caller.clone()),
        );
        assert!(scope.is_traced() && scope.trace_id() == Some(caller.trace_id()));
        let other = request(&tracer, Context::new());
        assert!(!other.is_traced() && other.trace_id().is_some_and(|id| id != caller.trace_id()));
    }

    #[tokio::test(flavor = "multi_thread", worker_threads = 1)]
    async fn a_full_queue_drops_and_counts() {
        // It never answers: the first batch is under way for the rest of the test.
        let (_silent, collector) = listen().await;
        let tracer = Tracer::new(&collector, 1.0).unwrap();
        drop(request(&tracer, Context::new()));
        while tracer.stats().queued.load(Ordering::Relaxed) > 0 {
            tokio::time::sleep(SHUTDOWN_POLL).await;
        }
        for _ in 0..MAX_QUEUED + 10 {
            drop(request(&tracer, Context::new()));
        }
        assert_eq!(
            (
                tracer.stats().dropped.get(),
                tracer.stats().queued.load(Ordering::Relaxed)
            ),
            (10, MAX_QUEUED)
        );
    }
}
