//! The id and the span of the current request. A scope goes with the request's futures, and by its
//! ticket to compute threads.

use std::future::Future;
use std::sync::Arc;
use std::sync::atomic::{AtomicU64, Ordering};
use std::time::{Duration, Instant, SystemTime};

use opentelemetry::trace::{
    Span as _, SpanBuilder, SpanContext, SpanKind, Status, TraceContextExt as _, TraceId,
    Tracer as _,
};
use opentelemetry::{Context, KeyValue};
use opentelemetry_sdk::trace::Span;

use super::tracer::Tracer;
use crate::problem::Code;

tokio::task_local! {
    static CURRENT: Scope;
}

/// One request, or one frame of a drag. Clones share it.
#[derive(Clone, Debug, Default)]
pub(crate) struct Scope(Option<Arc<Request>>);

#[derive(Debug)]
struct Request {
    id: Arc<str>,
    /// Of the request's span, recorded or not.
    span_context: Option<SpanContext>,
    recorded: Option<RecordedSpan>,
}

/// A sampled span. It is exported when the last scope of its request is dropped.
#[derive(Debug)]
struct RecordedSpan {
    tracer: Tracer,
    context: Context,
    began: Instant,
    start_time: SystemTime,
    /// The end of the response's head or of the last stage, in nanoseconds after the beginning; 0
    /// before there is one.
    ended: AtomicU64,
}

impl RecordedSpan {
    fn nanos(&self, at: Instant) -> u64 {
        u64::try_from(at.saturating_duration_since(self.began).as_nanos()).unwrap_or(u64::MAX)
    }
}

impl Drop for RecordedSpan {
    fn drop(&mut self) {
        // 0: the client left before an answer.
        let ended = Some(*self.ended.get_mut())
            .filter(|ended| *ended > 0)
            .unwrap_or_else(|| self.nanos(Instant::now()));
        self.context
            .span()
            .end_with_timestamp(self.start_time + Duration::from_nanos(ended));
    }
}

/// What is known of a request at its beginning.
pub(crate) struct RequestInfo<'a> {
    /// The caller's span.
    pub(crate) parent: Context,
    pub(crate) began: Instant,
    pub(crate) method: Option<&'static str>,
    /// The pattern of the route.
    pub(crate) route: Option<&'a str>,
    /// `http` or `https`.
    pub(crate) scheme: &'static str,
}

impl Scope {
    /// A request without a trace. `id` is made of letters, digits, `-`, `_` and `.`.
    pub(crate) fn untraced(id: &str) -> Self {
        Self(Some(Arc::new(Request {
            id: id.into(),
            span_context: None,
            recorded: None,
        })))
    }

    pub(crate) fn request(id: &str, tracer: &Tracer, info: &RequestInfo<'_>) -> Self {
        let RequestInfo {
            parent,
            began,
            method,
            route,
            scheme,
        } = info;
        Self::start(id.into(), tracer, parent, *began, |span| {
            span.set_attribute(KeyValue::new(
                "http.request.method",
                method.unwrap_or("_OTHER"),
            ));
            span.set_attribute(KeyValue::new("url.scheme", *scheme));
            span.update_name(
                [method.unwrap_or("HTTP"), route.unwrap_or_default()]
                    .join(" ")
                    .trim_end()
                    .to_owned(),
            );
            if let Some(route) = route {
                span.set_attribute(KeyValue::new("http.route", (*route).to_owned()));
            }
        })
    }

    /// A frame of the drag that this request opened. Its own trace links to the handshake's, which
    /// would have no end.
    pub(crate) fn frame(&self, tracer: Option<&Tracer>) -> Self {
        let (Some(handshake), Some(tracer)) = (&self.0, tracer) else {
            return self.clone();
        };
        Self::start(
            Arc::clone(&handshake.id),
            tracer,
            &Context::new(),
            Instant::now(),
            |span| {
                span.update_name("drag frame");
                if let Some(context) = &handshake.span_context {
                    span.add_link(context.clone(), Vec::new());
                }
            },
        )
    }

    fn start(
        id: Arc<str>,
        tracer: &Tracer,
        parent: &Context,
        began: Instant,
        describe: impl FnOnce(&mut Span),
    ) -> Self {
        let start_time = SystemTime::now()
            .checked_sub(began.elapsed())
            .unwrap_or(SystemTime::UNIX_EPOCH);
        let builder = SpanBuilder::from_name("")
            .with_kind(SpanKind::Server)
            .with_start_time(start_time);
        let mut span = tracer.sdk.build_with_context(builder, parent);
        let span_context = Some(span.span_context().clone());
        let recorded = span.is_recording().then(|| {
            span.set_attribute(KeyValue::new("mlswarp.request_id", id.to_string()));
            describe(&mut span);
            RecordedSpan {
                tracer: tracer.clone(),
                context: Context::new().with_span(span),
                began,
                start_time,
                ended: AtomicU64::new(0),
            }
        });
        Self(Some(Arc::new(Request {
            id,
            span_context,
            recorded,
        })))
    }

    /// The scope of the current code.
    pub(crate) fn current() -> Self {
        CURRENT.try_with(Self::clone).unwrap_or_default()
    }

    /// The same request without its span, for work that goes on after the response: log lines still
    /// have its id.
    pub(crate) fn answered(&self) -> Self {
        let Some(request) = &self.0 else {
            return Self::default();
        };
        Self(Some(Arc::new(Request {
            id: Arc::clone(&request.id),
            span_context: request.span_context.clone(),
            recorded: None,
        })))
    }

    pub(crate) fn id(&self) -> Option<&str> {
        self.0.as_ref().map(|request| &*request.id)
    }

    /// The id of its trace, if traces are exported.
    pub(crate) fn trace_id(&self) -> Option<TraceId> {
        self.0
            .as_ref()?
            .span_context
            .as_ref()
            .map(SpanContext::trace_id)
    }

    pub(crate) fn enter<T>(&self, work: impl FnOnce() -> T) -> T {
        if self.0.is_some() {
            CURRENT.sync_scope(self.clone(), work)
        } else {
            work()
        }
    }

    pub(crate) fn wrap<F: Future>(self, future: F) -> impl Future<Output = F::Output> {
        CURRENT.scope(self, future)
    }

    pub(crate) fn is_traced(&self) -> bool {
        self.recorded().is_some()
    }

    fn recorded(&self) -> Option<&RecordedSpan> {
        self.0.as_ref()?.recorded.as_ref()
    }

    /// Records the response's status; the span ends here unless a stage goes on.
    pub(crate) fn set_response(&self, status: u16, code: Option<Code>) {
        if let Some(recorded) = self.recorded() {
            recorded
                .ended
                .fetch_max(recorded.nanos(Instant::now()), Ordering::Relaxed);
            recorded.context.span().set_attribute(KeyValue::new(
                "http.response.status_code",
                i64::from(status),
            ));
        }
        if let Some(code) = code {
            self.set_error(code);
        }
    }

    /// Records a problem. A client's mistake is no error of the service.
    pub(crate) fn set_error(&self, code: Code) {
        if let Some(recorded) = self.recorded() {
            let span = recorded.context.span();
            span.set_attribute(KeyValue::new("error.type", code.as_str()));
            if code.status() >= 500 {
                span.set_status(Status::error(""));
            }
        }
    }

    /// Records a stage as a child span.
    pub(crate) fn stage(&self, name: &'static str, began: Instant, ended: Instant) {
        if let Some(recorded) = self.recorded() {
            let (began, ended) = (recorded.nanos(began), recorded.nanos(ended));
            let at = |nanos| recorded.start_time + Duration::from_nanos(nanos);
            let builder = SpanBuilder::from_name(name).with_start_time(at(began));
            recorded
                .tracer
                .sdk
                .build_with_context(builder, &recorded.context)
                .end_with_timestamp(at(ended));
            recorded.ended.fetch_max(ended, Ordering::Relaxed);
        }
    }
}

/// Records a stage of the current request that ends now.
pub(crate) fn stage(name: &'static str, began: Instant) {
    // Without cloning the scope: every frame of a drag calls this.
    let _ = CURRENT.try_with(|scope| scope.stage(name, began, Instant::now()));
}

/// Awaits `future` as a stage of the current request.
pub(crate) async fn in_stage<T>(name: &'static str, future: impl Future<Output = T>) -> T {
    let began = Instant::now();
    let output = future.await;
    stage(name, began);
    output
}
