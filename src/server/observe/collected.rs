//! What was collected of one trace, and the spans that it becomes.

use std::time::{Instant, SystemTime};

use opentelemetry::trace::{Link, SpanContext, SpanId, SpanKind, Status, TraceState};
use opentelemetry::{InstrumentationScope, KeyValue};
use opentelemetry_sdk::trace::{IdGenerator as _, RandomIdGenerator, SpanData, SpanEvents, SpanLinks};

use crate::problem::Code;

/// Everything of a trace that was collected.
#[derive(Debug)]
pub(crate) struct Collected {
    pub(crate) context: SpanContext,
    pub(crate) parent: SpanId,
    pub(crate) link: Option<SpanContext>,
    pub(crate) name: String,
    pub(crate) attributes: Vec<KeyValue>,
    pub(crate) status: Status,
    pub(crate) came: SystemTime,
    pub(crate) began: Instant,
    pub(crate) ended: Option<Instant>,
    pub(crate) stages: Vec<Stage>,
}

#[derive(Clone, Copy, Debug)]
pub(crate) struct Stage {
    pub(crate) name: &'static str,
    pub(crate) began: Instant,
    pub(crate) ended: Instant,
}

impl Collected {
    /// What the client did wrong is no error of the service's.
    pub(crate) fn fail(&mut self, code: Code) {
        self.attributes.push(KeyValue::new("error.type", code.as_str()));
        if code.status() >= 500 {
            self.status = Status::error("");
        }
    }

    pub(crate) fn nothing(context: SpanContext, now: Instant) -> Self {
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
