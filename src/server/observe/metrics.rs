//! Counters and histograms that are updated as things happen. Units are seconds; no label holds anything that a client chose.

use std::time::Duration;

use prometheus_client::metrics::counter::Counter;
use prometheus_client::metrics::family::Family;
use prometheus_client::metrics::histogram::{Histogram, exponential_buckets};
use prometheus_client::registry::{Registry, Unit};

use crate::observe::stages::{Cost, Timing};
use crate::problem::Problem;

/// The stages of a picture, in order.
const STAGES: [&str; 6] = ["queue", "decode", "plan", "deform", "render", "encode"];

/// `N` labels: names and values.
type Labels<const N: usize> = [(&'static str, String); N];

type Histograms = Family<Labels<1>, Histogram, fn() -> Histogram>;

/// Counters and histograms of one service.
#[derive(Debug)]
pub struct Metrics {
    responses: Family<Labels<3>, Counter>,
    problems: Family<Labels<2>, Counter>,
    durations: Histograms,
    stages: Histograms,
    /// The members of `stages`, without a lookup.
    stage: [Histogram; STAGES.len()],
    pictures: Family<Labels<1>, Counter>,
    superseded: Family<Labels<1>, Counter>,
    /// Pictures whose drawing began.
    pub pictures_begun: Counter,
    /// Pictures drawn to the end.
    pub pictures_finished: Counter,
    /// Pictures given up because the client had left.
    pub pictures_abandoned: Counter,
    /// Requests answered 409 because a newer pose had been seen.
    pub requests_superseded: Counter,
    /// Poses of drag sockets that a newer pose replaced before a frame was sent.
    pub poses_superseded: Counter,
    /// Frames sent to drag sockets.
    pub frames_sent: Counter,
}

/// The method if HTTP defines it: a client may send any word.
pub fn known_method(method: &str) -> Option<&'static str> {
    ["GET", "HEAD", "POST", "PUT", "DELETE", "OPTIONS", "PATCH"].into_iter().find(|known| *known == method)
}

/// A histogram of durations from 0.1 ms to 26 s.
fn durations() -> Histogram {
    Histogram::new(exponential_buckets(1e-4, 2.0, 19))
}

impl Default for Metrics {
    fn default() -> Self {
        let stages = Histograms::new_with_constructor(durations);
        let (pictures, superseded) = (Family::<Labels<1>, Counter>::default(), Family::<Labels<1>, Counter>::default());
        let picture = |state: &str| pictures.get_or_create_owned(&[("state", state.to_owned())]);
        let by = |origin: &str| superseded.get_or_create_owned(&[("by", origin.to_owned())]);
        Self {
            responses: Family::default(),
            problems: Family::default(),
            durations: Histograms::new_with_constructor(durations),
            stage: STAGES.map(|stage| stages.get_or_create_owned(&[("stage", stage.to_owned())])),
            stages,
            pictures_begun: picture("begun"),
            pictures_finished: picture("finished"),
            pictures_abandoned: picture("abandoned"),
            pictures,
            requests_superseded: by("request"),
            poses_superseded: by("socket"),
            superseded,
            frames_sent: Counter::default(),
        }
    }
}

impl Metrics {
    /// Registers all of them.
    pub fn register(&self, registry: &mut Registry) {
        registry.register("requests", "Requests that were answered", self.responses.clone());
        registry.register("problems", "Requests that were refused, by the problem's code and the limit it names", self.problems.clone());
        let help = "Time from a request's head to its answer's head";
        registry.register_with_unit("request_duration", help, Unit::Seconds, self.durations.clone());
        let help = "Time of the stages of a picture; render and encode: summed over all threads";
        registry.register_with_unit("stage_duration", help, Unit::Seconds, self.stages.clone());
        registry.register("pictures", "Pictures by state", self.pictures.clone());
        registry.register("superseded", "Poses that newer ones replaced", self.superseded.clone());
        registry.register("frames_sent", "Frames sent to drag sockets", self.frames_sent.clone());
    }

    /// Counts an answered request. `route` is a pattern, never a path.
    pub fn answered(&self, route: &str, method: &str, status: u16, duration: Duration) {
        let method = known_method(method).unwrap_or("other");
        let labels = [("route", route.to_owned()), ("method", method.to_owned()), ("status", status.to_string())];
        self.responses.get_or_create(&labels).inc();
        self.durations.get_or_create(&[("route", route.to_owned())]).observe(duration.as_secs_f64());
    }

    /// Counts a refused request.
    pub fn refused(&self, problem: &Problem) {
        let labels = [("code", problem.code.as_str().to_owned()), ("limit", problem.what.unwrap_or_default().to_owned())];
        self.problems.get_or_create(&labels).inc();
    }

    /// Records the stages before drawing.
    pub fn prepared(&self, timing: &Timing) {
        let times = [timing.queue, timing.decode, timing.plan, timing.deform];
        for (histogram, time) in self.stage.iter().zip(times) {
            histogram.observe(time.as_secs_f64());
        }
    }

    /// Records the stages of drawing.
    pub fn drawn(&self, cost: Cost) {
        let [.., render, encode] = &self.stage;
        render.observe(cost.render.as_secs_f64());
        encode.observe(cost.encode.as_secs_f64());
    }
}
