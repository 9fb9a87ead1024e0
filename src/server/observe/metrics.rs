//! Counters and times that are collected as things happen. Seconds and bytes, as the names say. No label holds anything that a client chose.

use std::time::Duration;

use prometheus_client::encoding::EncodeLabelSet;
use prometheus_client::metrics::counter::Counter;
use prometheus_client::metrics::family::Family;
use prometheus_client::metrics::histogram::{Histogram, exponential_buckets};
use prometheus_client::registry::{Registry, Unit};

use crate::observe::stages::Cost;
use crate::observe::stages::Timing;
use crate::problem::Problem;

/// Steps of a picture, in their order.
const STAGES: [&str; 6] = ["queue", "decode", "plan", "deform", "render", "encode"];

#[derive(Clone, Debug, Hash, PartialEq, Eq, EncodeLabelSet)]
struct Answered {
    route: String,
    method: String,
    status: u16,
}

#[derive(Clone, Debug, Hash, PartialEq, Eq, EncodeLabelSet)]
struct Refused {
    code: &'static str,
    limit: &'static str,
}

#[derive(Clone, Debug, Hash, PartialEq, Eq, EncodeLabelSet)]
struct Route {
    route: String,
}

#[derive(Clone, Debug, Hash, PartialEq, Eq, EncodeLabelSet)]
struct Stage {
    stage: &'static str,
}

/// What is collected as it happens.
#[derive(Debug)]
pub struct Metrics {
    answered: Family<Answered, Counter>,
    refused: Family<Refused, Counter>,
    durations: Family<Route, Histogram, fn() -> Histogram>,
    stages: Family<Stage, Histogram, fn() -> Histogram>,
    /// Those of `stages`, without a look-up.
    stage: [Histogram; STAGES.len()],
}

/// A client may send any word as its method: those that HTTP knows.
#[must_use]
pub fn known_method(method: &str) -> Option<&'static str> {
    ["GET", "HEAD", "POST", "PUT", "DELETE", "OPTIONS", "PATCH"].into_iter().find(|known| *known == method)
}

/// 0.1 ms to 26 s.
fn times() -> Histogram {
    Histogram::new(exponential_buckets(1e-4, 2.0, 19))
}

impl Default for Metrics {
    fn default() -> Self {
        let stages = Family::new_with_constructor(times as fn() -> Histogram);
        let stage = STAGES.map(|stage| stages.get_or_create_owned(&Stage { stage }));
        let durations = Family::new_with_constructor(times as fn() -> Histogram);
        Self { answered: Family::default(), refused: Family::default(), durations, stages, stage }
    }
}

impl Metrics {
    /// Adds all of them to a registry.
    pub fn register(&self, registry: &mut Registry) {
        registry.register("requests", "Requests that were answered", self.answered.clone());
        registry.register("problems", "Requests that were refused, by the problem's code and the limit it names", self.refused.clone());
        let spent = "Time from a request's head to its answer's head";
        registry.register_with_unit("request_duration", spent, Unit::Seconds, self.durations.clone());
        let stages = "Time of the steps of a picture; render and encode: of all threads together";
        registry.register_with_unit("stage_duration", stages, Unit::Seconds, self.stages.clone());
    }

    /// A request was answered. `route` is a pattern, never a path.
    pub fn answered(&self, route: &str, method: &str, status: u16, took: Duration) {
        let method = known_method(method).unwrap_or("other");
        let answered = Answered { route: route.to_owned(), method: method.to_owned(), status };
        self.answered.get_or_create(&answered).inc();
        self.durations.get_or_create(&Route { route: route.to_owned() }).observe(took.as_secs_f64());
    }

    /// A request was refused, perhaps by a limit.
    pub fn refused(&self, problem: &Problem) {
        self.refused.get_or_create(&Refused { code: problem.code.as_str(), limit: problem.what.unwrap_or_default() }).inc();
    }

    /// What came before drawing.
    pub fn prepared(&self, timing: &Timing) {
        let times = [timing.queue, timing.decode, timing.plan, timing.deform];
        for (histogram, time) in self.stage.iter().zip(times) {
            histogram.observe(time.as_secs_f64());
        }
    }

    /// A picture was drawn.
    pub fn drawn(&self, cost: Cost) {
        let [.., render, encode] = &self.stage;
        render.observe(cost.render.as_secs_f64());
        encode.observe(cost.encode.as_secs_f64());
    }
}
