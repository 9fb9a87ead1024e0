//! One trace: the span of a request or of a frame, and a child for each stage. It is collected while the request is worked on, handed over when
//! the last of those who work for it has ended, and made into spans by the task that exports.

use std::sync::{Mutex, MutexGuard, PoisonError};
use std::time::{Instant, SystemTime};

use opentelemetry::KeyValue;
use opentelemetry::trace::{SpanContext, SpanId, Status};
use opentelemetry_sdk::trace::{IdGenerator as _, RandomIdGenerator};

use super::collected::{Collected, Stage};
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

impl Tracer {
    /// The span of a request, and its trace where it is sampled.
    pub(crate) fn request(&self, id: &str, asked: &Asked<'_>) -> (SpanContext, Option<Trace>) {
        let Asked { parent, began, .. } = asked;
        let (trace, caller) = if parent.is_valid() {
            (parent.trace_id(), Some(parent.is_sampled()))
        } else {
            (RandomIdGenerator::default().new_trace_id(), None)
        };
        let context = self.context(trace, caller, *began);
        let made = context.is_sampled().then(|| Trace::new(self.clone(), context.clone(), id, *began).of_request(asked));
        (context, made)
    }

    /// The span of a frame. It is no child of its handshake, whose trace would have no end; it links to it.
    pub(crate) fn frame(&self, id: &str, handshake: Option<&SpanContext>) -> (SpanContext, Option<Trace>) {
        let now = Instant::now();
        let context = self.context(RandomIdGenerator::default().new_trace_id(), None, now);
        let made = context.is_sampled().then(|| Trace::new(self.clone(), context.clone(), id, now).of_frame(handshake));
        (context, made)
    }
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
