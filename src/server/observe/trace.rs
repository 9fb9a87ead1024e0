//! One trace: the span of a request or of a frame, and a child for each stage. It is collected while the request is worked on, handed over when
//! the last of those who work for it has ended, and made into spans by the task that exports.

use std::sync::{Mutex, MutexGuard, PoisonError};
use std::time::{Instant, SystemTime};

use opentelemetry::trace::{Link, SpanContext, SpanId, SpanKind, Status, TraceState};
use opentelemetry::{InstrumentationScope, KeyValue};
use opentelemetry_sdk::trace::{IdGenerator as _, RandomIdGenerator, SpanData, SpanEvents, SpanLinks};

use super::tracer::Tracer;
use crate::problem::Code;

/// Stages that one trace keeps; a request has some ten.
const STAGES: usize = 64;

/// What is known of a request before anything is done.
#[derive(Clone, Debug)]
pub struct Asked<'a> {
    /// The span that the client's own trace has for it; valid or not.
    pub parent: SpanContext,
    /// When it came.
    pub began: Instant,
    /// A word that HTTP knows, or none.
    pub method: Option<&'static str>,
    /// The pattern of the route, where there is one.
    pub route: Option<&'a str>,
    /// `http` or `https`.
    pub scheme: &'static str,
}

/// How a request was answered.
#[derive(Clone, Copy, Debug)]
pub struct Answer {
    /// The status.
    pub status: u16,
    /// Why it was refused.
    pub code: Option<Code>,
}

/// A trace that is being collected.
#[derive(Debug)]
pub(crate) struct Trace {
    tracer: Tracer,
    kept: Mutex<Collected>,
}

/// Everything of a trace that was collected.
#[derive(Debug)]
pub(crate) struct Collected {
    context: SpanContext,
    parent: SpanId,
    link: Option<SpanContext>,
    name: String,
    attributes: Vec<KeyValue>,
    status: Status,
    came: SystemTime,
    began: Instant,
    ended: Option<Instant>,
    stages: Vec<Stage>,
}

#[derive(Clone, Copy, Debug)]
struct Stage {
    name: &'static str,
    began: Instant,
    ended: Instant,
}

impl Trace {
    pub(crate) fn new(tracer: Tracer, context: SpanContext, id: &str, began: Instant) -> Self {
        let kept = Collected {
            context,
            parent: SpanId::INVALID,
            link: None,
            name: String::new(),
            attributes: vec![KeyValue::new("mlswarp.request_id", id.to_owned())],
            status: Status::Unset,
            came: SystemTime::now().checked_sub(began.elapsed()).unwrap_or(SystemTime::UNIX_EPOCH),
            began,
            ended: None,
            stages: Vec::with_capacity(8),
        };
        tracer.opened();
        Self { tracer, kept: Mutex::new(kept) }
    }

    /// A child of a span of the client's, if it has one. All this is told at once: who leaves is not answered.
    pub(crate) fn of_request(self, asked: &Asked<'_>) -> Self {
        let mut kept = self.kept();
        kept.parent = asked.parent.span_id();
        kept.attributes.push(KeyValue::new("http.request.method", asked.method.unwrap_or("_OTHER")));
        kept.attributes.push(KeyValue::new("url.scheme", asked.scheme));
        let named = asked.method.unwrap_or("HTTP");
        kept.name = match asked.route {
            Some(route) => {
                kept.attributes.push(KeyValue::new("http.route", route.to_owned()));
                format!("{named} {route}")
            }
            None => named.to_owned(),
        };
        drop(kept);
        self
    }

    /// Belongs to another trace.
    pub(crate) fn of_frame(self, handshake: Option<&SpanContext>) -> Self {
        let mut kept = self.kept();
        "drag frame".clone_into(&mut kept.name);
        kept.link = handshake.cloned();
        drop(kept);
        self
    }

    fn kept(&self) -> MutexGuard<'_, Collected> {
        // Nothing panics under the lock.
        self.kept.lock().unwrap_or_else(PoisonError::into_inner)
    }

    pub(crate) fn stage(&self, name: &'static str, began: Instant, ended: Instant) {
        let mut kept = self.kept();
        if kept.stages.len() < STAGES {
            kept.stages.push(Stage { name, began, ended });
        }
    }

    pub(crate) fn answered(&self, answer: Answer) {
        let mut kept = self.kept();
        kept.ended = Some(Instant::now());
        kept.attributes.push(KeyValue::new("http.response.status_code", i64::from(answer.status)));
        if let Some(code) = answer.code {
            kept.fail(code);
        }
    }

    pub(crate) fn failed(&self, code: Code) {
        self.kept().fail(code);
    }
}

impl Drop for Trace {
    fn drop(&mut self) {
        let now = Instant::now();
        let kept = self.kept.get_mut().unwrap_or_else(PoisonError::into_inner);
        // Nobody was answered who had left before.
        kept.ended.get_or_insert(now);
        let context = kept.context.clone();
        let collected = std::mem::replace(kept, Collected::nothing(context, now));
        self.tracer.hand_over(collected);
    }
}

impl Collected {
    /// What the client did wrong is no error of the service's.
    fn fail(&mut self, code: Code) {
        self.attributes.push(KeyValue::new("error.type", code.as_str()));
        if code.status() >= 500 {
            self.status = Status::error("");
        }
    }

    fn nothing(context: SpanContext, now: Instant) -> Self {
        Self {
            context,
            parent: SpanId::INVALID,
            link: None,
            name: String::new(),
            attributes: Vec::new(),
            status: Status::Unset,
            came: SystemTime::UNIX_EPOCH,
            began: now,
            ended: None,
            stages: Vec::new(),
        }
    }

    /// The spans that it comes to.
    pub(crate) fn spans(&self) -> usize {
        1 + self.stages.len()
    }

    /// Into spans, the one of the whole first. It ends with its answer's head, or with the last stage where the answer was streamed.
    pub(crate) fn write(self, scope: &InstrumentationScope, into: &mut Vec<SpanData>) {
        let Self { context, parent, link, name, attributes, status, came, began, ended, stages } = self;
        let at = |instant: Instant| came + instant.saturating_duration_since(began);
        let last = stages.iter().map(|stage| stage.ended).chain(ended).max().unwrap_or(began);
        let mut links = SpanLinks::default();
        links.links.extend(link.map(Link::with_context));
        let mut span = |name, context: SpanContext, parent, remote, kind, (from, to), attributes, links, status| {
            into.push(SpanData {
                span_context: context,
                parent_span_id: parent,
                parent_span_is_remote: remote,
                span_kind: kind,
                name,
                start_time: from,
                end_time: to,
                attributes,
                dropped_attributes_count: 0,
                events: SpanEvents::default(),
                links,
                status,
                instrumentation_scope: scope.clone(),
            });
        };
        let whole = (came, at(last));
        span(name.into(), context.clone(), parent, parent != SpanId::INVALID, SpanKind::Server, whole, attributes, links, status);
        for Stage { name, began, ended } in stages {
            let own = SpanContext::new(
                context.trace_id(),
                RandomIdGenerator::default().new_span_id(),
                context.trace_flags(),
                false,
                TraceState::NONE,
            );
            let during = (at(began), at(ended));
            span(name.into(), own, context.span_id(), false, SpanKind::Internal, during, Vec::new(), SpanLinks::default(), Status::Unset);
        }
    }
}
