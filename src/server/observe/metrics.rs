//! Counters and histograms that are updated as events happen. No label holds text that a client
//! chose.

use std::time::Duration;

use prometheus_client::metrics::counter::Counter;
use prometheus_client::metrics::family::Family;
use prometheus_client::metrics::histogram::{Histogram, exponential_buckets};
use prometheus_client::registry::{Registry, Unit};

use crate::observe::stages::{Cost, Timing};
use crate::problem::Problem;

pub(crate) const PREFIX: &str = "mlswarp";

type MetricLabels<const N: usize> = [(&'static str, String); N];

#[derive(Debug)]
pub(crate) struct Metrics {
    /// The metrics of all other fields.
    pub(crate) registry: Registry,
    responses: Family<MetricLabels<3>, Counter>,
    problems: Family<MetricLabels<2>, Counter>,
    durations: Family<MetricLabels<1>, Histogram, fn() -> Histogram>,
    /// `queue`, `decode`, `plan`, `reduce`, `deform`, `render`, `encode`.
    stages: [Histogram; 7],
    pub(crate) pictures_begun: Counter,
    pub(crate) pictures_finished: Counter,
    /// Images given up because the client had left.
    pub(crate) pictures_abandoned: Counter,
    /// Requests answered 409 because a newer pose had been seen.
    pub(crate) requests_superseded: Counter,
    /// Poses of drag sockets that a newer pose replaced before a frame was sent.
    pub(crate) poses_superseded: Counter,
    pub(crate) frames_sent: Counter,
    pub(crate) batch_frames: Counter,
}

/// The method if HTTP defines it: a client may send any word.
pub(crate) fn known_method(method: &str) -> Option<&'static str> {
    ["GET", "HEAD", "POST", "PUT", "DELETE", "OPTIONS", "PATCH"]
        .into_iter()
        .find(|known| *known == method)
}

/// A histogram of durations from 0.1 ms to 26 s.
fn histogram() -> Histogram {
    Histogram::new(exponential_buckets(1e-4, 2.0, 19))
}

impl Default for Metrics {
    fn default() -> Self {
        let mut registry = Registry::with_prefix(PREFIX);
        let responses = Family::default();
        registry.register("requests", "Requests that were answered", responses.clone());
        let problems = Family::default();
        registry.register(
            "problems",
            "Requests that were refused, by the problem's code and the limit it names",
            problems.clone(),
        );
        let durations = Family::new_with_constructor(histogram as fn() -> Histogram);
        let help = "Time from a request's head to its answer's head";
        registry.register_with_unit("request_duration", help, Unit::Seconds, durations.clone());
        let by_stage = Family::<MetricLabels<1>, Histogram, _>::new_with_constructor(
            histogram as fn() -> Histogram,
        );
        let help = "Time of the stages of a picture; render and encode: summed over all threads";
        registry.register_with_unit("stage_duration", help, Unit::Seconds, by_stage.clone());
        let stages = [
            "queue", "decode", "plan", "reduce", "deform", "render", "encode",
        ];
        let pictures = Family::<MetricLabels<1>, Counter>::default();
        registry.register("pictures", "Pictures by state", pictures.clone());
        let superseded = Family::<MetricLabels<1>, Counter>::default();
        registry.register(
            "superseded",
            "Poses that newer ones replaced",
            superseded.clone(),
        );
        let frames_sent = Counter::default();
        registry.register(
            "frames_sent",
            "Frames sent to drag sockets",
            frames_sent.clone(),
        );
        let batch_frames = Counter::default();
        registry.register(
            "batch_frames",
            "Frames of batches that were made and taken",
            batch_frames.clone(),
        );
        let picture = |state: &str| pictures.get_or_create_owned(&[("state", state.to_owned())]);
        let by = |origin: &str| superseded.get_or_create_owned(&[("by", origin.to_owned())]);
        Self {
            registry,
            responses,
            problems,
            durations,
            stages: stages
                .map(|stage| by_stage.get_or_create_owned(&[("stage", stage.to_owned())])),
            pictures_begun: picture("started"),
            pictures_finished: picture("finished"),
            pictures_abandoned: picture("abandoned"),
            requests_superseded: by("request"),
            poses_superseded: by("socket"),
            frames_sent,
            batch_frames,
        }
    }
}

impl Metrics {
    /// Counts an answered request. `route` is a pattern, never a path.
    pub(crate) fn answered(&self, route: &str, method: &str, status: u16, duration: Duration) {
        let method = known_method(method).unwrap_or("other");
        let labels = [
            ("route", route.to_owned()),
            ("method", method.to_owned()),
            ("status", status.to_string()),
        ];
        self.responses.get_or_create(&labels).inc();
        self.durations
            .get_or_create(&[("route", route.to_owned())])
            .observe(duration.as_secs_f64());
    }

    pub(crate) fn refused(&self, problem: &Problem) {
        let labels = [
            ("code", problem.code.as_str().to_owned()),
            ("limit", problem.what.unwrap_or_default().to_owned()),
        ];
        self.problems.get_or_create(&labels).inc();
    }

    /// Records the stages before drawing.
    pub(crate) fn prepared(&self, timing: &Timing) {
        let times = [
            timing.queue,
            timing.decode,
            timing.plan,
            timing.reduce,
            timing.deform,
        ];
        for (histogram, time) in self.stages.iter().zip(times) {
            histogram.observe(time.as_secs_f64());
        }
    }

    /// Records the stages of drawing.
    pub(crate) fn drawn(&self, cost: Cost) {
        let [.., render, encode] = &self.stages;
        render.observe(cost.render.as_secs_f64());
        encode.observe(cost.encode.as_secs_f64());
    }
}
