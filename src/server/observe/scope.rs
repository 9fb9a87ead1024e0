//! Whose request is worked on: what log lines and stages ask, wherever they are told. It goes with the request's future, and by its ticket to
//! compute threads; outside of requests it is empty.

use std::future::Future;
use std::sync::Arc;
use std::time::Instant;

use opentelemetry::TraceId;
use opentelemetry::trace::SpanContext;

use super::trace::{Answer, Asked, Trace};
use super::tracer::Tracer;
use crate::problem::Code;

tokio::task_local! {
    static CURRENT: Scope;
}

/// One request, or one frame of a drag. Cloning shares it.
#[derive(Clone, Debug, Default)]
pub struct Scope(Option<Arc<Inner>>);

#[derive(Debug)]
struct Inner {
    id: Arc<str>,
    /// Of this request's own span, recorded or not; of the handshake's, at a socket.
    context: Option<SpanContext>,
    /// Ends with the last of those who work for the request.
    trace: Option<Trace>,
}

impl Scope {
    /// A request of that id, which is a plain word. `traced`: by whom, and what is known of it.
    #[must_use]
    pub fn request(id: &str, traced: Option<(&Tracer, &Asked<'_>)>) -> Self {
        let (context, trace) = traced.map(|(tracer, asked)| tracer.request(id, asked)).unzip();
        Self(Some(Arc::new(Inner { id: id.into(), context, trace: trace.flatten() })))
    }

    /// The request that is worked on here.
    #[must_use]
    pub fn current() -> Self {
        CURRENT.try_with(Self::clone).unwrap_or_default()
    }

    /// The same request after its answer: its id is still told, and its trace does not wait for what comes now.
    #[must_use]
    pub fn answered(&self) -> Self {
        let Some(inner) = &self.0 else { return Self::default() };
        Self(Some(Arc::new(Inner { id: Arc::clone(&inner.id), context: inner.context.clone(), trace: None })))
    }

    /// A frame of the drag that this request has opened, with a trace of its own that links to the handshake's.
    #[must_use]
    pub fn frame(&self, tracer: Option<&Tracer>) -> Self {
        let (Some(inner), Some(tracer)) = (&self.0, tracer) else { return self.clone() };
        let (context, trace) = tracer.frame(&inner.id, inner.context.as_ref());
        Self(Some(Arc::new(Inner { id: Arc::clone(&inner.id), context: Some(context), trace })))
    }

    /// The request's id.
    #[must_use]
    pub fn id(&self) -> Option<&str> {
        self.0.as_ref().map(|inner| &*inner.id)
    }

    /// The id of its trace, where there is a collector.
    #[must_use]
    pub fn trace_id(&self) -> Option<TraceId> {
        self.0.as_ref()?.context.as_ref().map(SpanContext::trace_id)
    }

    /// Works for the request on this thread.
    pub fn enter<T>(&self, work: impl FnOnce() -> T) -> T {
        match &self.0 {
            Some(_) => CURRENT.sync_scope(self.clone(), work),
            None => work(),
        }
    }

    /// Works for the request wherever the future goes.
    pub fn wrap<F: Future>(self, future: F) -> impl Future<Output = F::Output> {
        CURRENT.scope(self, future)
    }

    /// How the request was answered.
    pub fn tell(&self, answer: Answer) {
        if let Some(trace) = self.trace() {
            trace.answered(answer);
        }
    }

    /// Why a frame has come to nothing.
    pub fn fail(&self, code: Code) {
        if let Some(trace) = self.trace() {
            trace.failed(code);
        }
    }

    /// What is made here is traced.
    #[must_use]
    pub fn is_traced(&self) -> bool {
        self.trace().is_some()
    }

    fn trace(&self) -> Option<&Trace> {
        self.0.as_ref()?.trace.as_ref()
    }

    /// A stage of what is traced.
    pub fn stage(&self, name: &'static str, began: Instant, ended: Instant) {
        if let Some(trace) = self.trace() {
            trace.stage(name, began, ended);
        }
    }
}

/// A stage of the request that is worked on here has ended now.
pub fn stage(name: &'static str, began: Instant) {
    // Without a clone: the way of a drag goes through here, traced or not.
    let _ = CURRENT.try_with(|scope| {
        if scope.is_traced() {
            scope.stage(name, began, Instant::now());
        }
    });
}
