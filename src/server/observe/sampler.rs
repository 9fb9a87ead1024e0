//! The sampler of traces. It follows a caller's decision not to sample always, and the decision to
//! sample up to a rate. All other requests are sampled at random, never by the trace's id, which a
//! caller chooses.

use std::sync::{Arc, Mutex};
use std::time::Instant;

use opentelemetry::trace::{
    Link, SpanContext, SpanKind, TraceContextExt as _, TraceId, TraceState,
};
use opentelemetry::{Context, KeyValue};
use opentelemetry_sdk::trace::{
    IdGenerator as _, RandomIdGenerator, SamplingDecision, SamplingResult, ShouldSample,
};

use crate::limits::bucket::Bucket;

/// Traces per second, and at once, that callers may ask for.
const CALLER_LIMIT: (f64, f64) = (100.0, 200.0);

#[derive(Clone, Debug)]
pub(crate) struct Sampler {
    share: f64,
    caller_limit: Arc<Mutex<Bucket>>,
}

impl Sampler {
    pub(crate) fn new(share: f64) -> Self {
        Self {
            share,
            caller_limit: Arc::new(Mutex::new(Bucket::new(
                CALLER_LIMIT.0,
                CALLER_LIMIT.1,
                Instant::now(),
            ))),
        }
    }

    fn is_in_share(&self) -> bool {
        let random = u64::from_be_bytes(RandomIdGenerator::default().new_span_id().to_bytes()) >> 1;
        #[expect(
            clippy::cast_possible_truncation,
            clippy::cast_sign_loss,
            clippy::cast_precision_loss,
            reason = "between 0 and 2^63"
        )]
        let bound = (self.share * (1_u64 << 63) as f64) as u64;
        random < bound
    }
}

impl ShouldSample for Sampler {
    fn should_sample(
        &self,
        parent: Option<&Context>,
        _: TraceId,
        _: &str,
        _: &SpanKind,
        _: &[KeyValue],
        _: &[Link],
    ) -> SamplingResult {
        let parent = parent
            .map(|context| context.span().span_context().clone())
            .filter(SpanContext::is_valid);
        let is_sampled = match parent {
            None => self.is_in_share(),
            Some(parent) if !parent.is_remote() => parent.is_sampled(),
            Some(caller) => {
                caller.is_sampled()
                    && (self.is_in_share()
                        || self
                            .caller_limit
                            .lock()
                            .is_ok_and(|mut limit| limit.take(Instant::now())))
            }
        };
        let decision = if is_sampled {
            SamplingDecision::RecordAndSample
        } else {
            SamplingDecision::Drop
        };
        // The caller's `tracestate` is dropped.
        SamplingResult {
            decision,
            attributes: Vec::new(),
            trace_state: TraceState::NONE,
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use opentelemetry::trace::TraceFlags;

    fn caller(trace: TraceId, is_sampled: bool) -> Context {
        let flags = if is_sampled {
            TraceFlags::SAMPLED
        } else {
            TraceFlags::default()
        };
        let span = RandomIdGenerator::default().new_span_id();
        Context::new().with_remote_span_context(SpanContext::new(
            trace,
            span,
            flags,
            true,
            TraceState::NONE,
        ))
    }

    fn sampled(sampler: &Sampler, parent: &Context) -> bool {
        let result = sampler.should_sample(
            Some(parent),
            TraceId::from_bytes([1; 16]),
            "",
            &SpanKind::Server,
            &[],
            &[],
        );
        result.decision == SamplingDecision::RecordAndSample
    }

    #[test]
    fn the_share_decides_where_no_caller_does() {
        let count = |share| {
            let sampler = Sampler::new(share);
            (0..1000)
                .filter(|_| sampled(&sampler, &Context::new()))
                .count()
        };
        assert_eq!((count(0.0), count(1.0)), (0, 1000));
        assert!((350..650).contains(&count(0.5)));
    }

    #[test]
    fn a_caller_is_followed_and_bounded() {
        let new_trace = || RandomIdGenerator::default().new_trace_id();
        assert!(
            !sampled(&Sampler::new(1.0), &caller(new_trace(), false)),
            "what the caller does not sample is not traced"
        );
        let nothing = Sampler::new(0.0);
        let followed = (0..1000)
            .filter(|_| sampled(&nothing, &caller(new_trace(), true)))
            .count();
        assert!((190..600).contains(&followed), "{followed}");
    }

    #[test]
    fn a_caller_chooses_no_id_that_is_traced_more_often() {
        let sampler = Sampler::new(0.01);
        let traced = (0..2000)
            .filter(|_| {
                sampled(
                    &sampler,
                    &caller(TraceId::from_bytes(1_u128.to_be_bytes()), true),
                )
            })
            .count();
        assert!((190..800).contains(&traced), "{traced}");
    }

    #[test]
    fn a_stage_is_sampled_with_its_request() {
        let sampler = Sampler::new(0.0);
        let parent = |flags| {
            let trace = RandomIdGenerator::default().new_trace_id();
            Context::new().with_remote_span_context(SpanContext::new(
                trace,
                RandomIdGenerator::default().new_span_id(),
                flags,
                false,
                TraceState::NONE,
            ))
        };
        assert!(
            (0..1000).all(|_| sampled(&sampler, &parent(TraceFlags::SAMPLED))),
            "a stage takes nothing of what callers may ask for"
        );
        assert!(!sampled(&Sampler::new(1.0), &parent(TraceFlags::default())));
    }
}
