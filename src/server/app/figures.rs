//! The metrics as OpenMetrics text that Prometheus reads: what was collected as it happened, and what is read at the moment of a scrape.

use std::fmt;

use prometheus_client::collector::Collector;
use prometheus_client::encoding::text::encode;
use prometheus_client::encoding::{DescriptorEncoder, MetricEncoder, NoLabelSet};
use prometheus_client::metrics::MetricType;
use prometheus_client::registry::{Registry, Unit};

use crate::app::App;
use crate::app::causes::Cause;
use crate::cache::CacheStats;
use crate::limits::memory::Purpose;
use crate::pool::Work;

impl App {
    /// All metrics, as text.
    #[must_use]
    pub fn metrics_text(&self) -> String {
        let mut registry = Registry::with_prefix("mlswarp");
        self.0.metrics.register(&mut registry);
        registry.register_collector(Box::new(self.clone()));
        let mut text = String::new();
        encode(&mut text, &registry).expect("writing to a string does not fail");
        text
    }
}

/// Writes metrics that are read at a scrape.
struct Sheet<'a>(DescriptorEncoder<'a>);

type Labels = Vec<(&'static str, String)>;

impl Sheet<'_> {
    fn put(&mut self, kind: MetricType, name: &str, help: &str, unit: Option<&Unit>, values: &[(Labels, u64)]) -> fmt::Result {
        let mut metric = self.0.encode_descriptor(name, help, unit, kind)?;
        for (labels, value) in values {
            if labels.is_empty() { sample(&mut metric, kind, *value) } else { sample(&mut metric.encode_family(labels)?, kind, *value) }?;
        }
        Ok(())
    }

    fn gauge(&mut self, name: &str, help: &str, values: &[(Labels, u64)]) -> fmt::Result {
        self.put(MetricType::Gauge, name, help, None, values)
    }

    fn bytes(&mut self, name: &str, help: &str, values: &[(Labels, u64)]) -> fmt::Result {
        self.put(MetricType::Gauge, name, help, Some(&Unit::Bytes), values)
    }

    fn counter(&mut self, name: &str, help: &str, values: &[(Labels, u64)]) -> fmt::Result {
        self.put(MetricType::Counter, name, help, None, values)
    }
}

fn sample(metric: &mut MetricEncoder<'_>, kind: MetricType, value: u64) -> fmt::Result {
    match kind {
        MetricType::Counter => metric.encode_counter::<NoLabelSet, _, u64>(&value, None),
        _ => metric.encode_gauge(&value),
    }
}

fn one(value: u64) -> [(Labels, u64); 1] {
    [(Vec::new(), value)]
}

fn label(name: &'static str, value: &str) -> Labels {
    vec![(name, value.to_owned())]
}

const WORK: [(Work, &str); 3] = [(Work::Drag, "drag"), (Work::Upload, "upload"), (Work::Transfer, "transfer")];

impl Collector for App {
    fn encode(&self, encoder: DescriptorEncoder<'_>) -> fmt::Result {
        let sheet = &mut Sheet(encoder);
        sheet.gauge("build_info", "The program's version", &[(label("version", env!("CARGO_PKG_VERSION")), 1)])?;
        self.write_work(sheet)?;
        self.write_doors(sheet)?;
        self.write_memory(sheet)?;
        self.write_caches(sheet)?;
        self.write_store(sheet)?;
        self.write_pictures(sheet)?;
        self.write_traces(sheet)
    }
}

impl App {
    fn write_work(&self, sheet: &mut Sheet<'_>) -> fmt::Result {
        let loads = WORK.map(|(work, name)| (self.0.pool.load(work), label("work", name)));
        let each = |value: &dyn Fn(&crate::pool::Load) -> usize| loads.each_ref().map(|(load, work)| (work.clone(), value(load) as u64));
        // Those that wait for a file take no worker.
        let [drag, upload, _] = each(&|_| self.0.config.work.workers);
        sheet.gauge("workers", "Requests that run at one time, at most", &[drag, upload])?;
        let [drag, upload, transfer] = each(&|load| load.running);
        sheet.gauge("workers_busy", "Requests that run", &[drag, upload])?;
        sheet.gauge("transfers", "Files of sessions that are being sent to the store or fetched from it", &one(transfer.1))?;
        sheet.gauge("queue_places", "Requests that wait, at most", &each(&|_| self.0.config.work.queue))?;
        sheet.gauge("queue_waiting", "Requests that wait", &each(&|load| load.waiting))?;
        let mut shed = Vec::new();
        for (load, work) in &loads {
            for (reason, count) in [("queue_full", load.full), ("late", load.late)] {
                shed.push(([&work[..], &label("reason", reason)].concat(), count));
            }
        }
        shed.push(([label("work", "any"), label("reason", "memory")].concat(), self.0.budget.refused()));
        sheet.counter("shed", "Requests that were sent away because there was no room for them", &shed)
    }

    fn write_doors(&self, sheet: &mut Sheet<'_>) -> fmt::Result {
        let places = self.0.access.connections();
        sheet.gauge("connections", "Connections that are open", &one(places.open() as u64))?;
        sheet.counter("connections_refused", "Connections that were closed at once because there were too many", &one(places.refused()))
    }

    fn write_memory(&self, sheet: &mut Sheet<'_>) -> fmt::Result {
        let budget = &self.0.budget;
        sheet.bytes("memory_limit", "Memory that clients may cause to be taken", &one(budget.total()))?;
        let taken = Purpose::ALL.map(|purpose| (label("purpose", purpose.name()), budget.taken_for(purpose)));
        sheet.bytes("memory_reserved", "Memory that is taken, by purpose", &taken)?;
        match resident() {
            Some(bytes) => sheet.bytes("memory_resident", "Memory of the process as the kernel counts it", &one(bytes)),
            None => Ok(()),
        }
    }

    fn write_caches(&self, sheet: &mut Sheet<'_>) -> fmt::Result {
        let shelves = [("images", self.0.images.usage()), ("plans", self.0.plans.usage()), ("setups", self.0.setups.usage())];
        let each = |value: fn(&CacheStats) -> u64| shelves.each_ref().map(|(name, usage)| (label("cache", name), value(usage)));
        sheet.bytes("cache_size", "What is kept", &each(|usage| usage.bytes))?;
        sheet.gauge("cache_values", "Values that are kept", &each(|usage| usage.values))?;
        sheet.counter("cache_hits", "Looks that found a value", &each(|usage| usage.hits))?;
        sheet.counter("cache_builds", "Values that were made because they were not there", &each(|usage| usage.built))?;
        sheet.counter("cache_evictions", "Values that made room for others", &each(|usage| usage.evicted))?;
        let built = Cause::ALL.map(|cause| (label("cause", cause.name()), self.0.causes.count(cause)));
        sheet.counter("plan_builds", "Tables of coefficients that were filled, by why they were not there", &built)
    }

    fn write_store(&self, sheet: &mut Sheet<'_>) -> fmt::Result {
        let figures = self.0.store.figures();
        sheet.gauge("store_up", "1 while the store does what it is asked", &one(u64::from(!figures.is_away)))?;
        sheet.gauge("store_sessions", "Sessions that this process knows of", &one(figures.sessions))?;
        sheet.bytes("store_size", "Their records, and their files where those are this process's to keep", &one(figures.bytes))?;
        sheet.counter("store_damaged", "Sessions that were left out because what was stored of them was damaged", &one(figures.damaged))?;
        let other_version = "Records that were read and left alone because another version of the program has written them";
        sheet.counter("store_other_version", other_version, &one(figures.other_version))?;
        sheet.counter("store_failures", "Times that the store did not do what it was asked", &one(figures.failures))
    }

    fn write_pictures(&self, sheet: &mut Sheet<'_>) -> fmt::Result {
        let counters = self.counters();
        let pictures =
            [("begun", counters.pictures_begun), ("finished", counters.pictures_finished), ("abandoned", counters.pictures_abandoned)];
        sheet.counter("pictures", "Pictures by how far they came", &pictures.map(|(name, count)| (label("state", name), count)))?;
        let superseded = [("request", counters.superseded), ("socket", counters.poses_superseded)];
        sheet.counter(
            "superseded",
            "Poses that were overtaken by newer ones",
            &superseded.map(|(name, count)| (label("by", name), count)),
        )?;
        sheet.gauge("sockets", "Drag sockets that are open", &one(counters.sockets_open))?;
        sheet.counter("frames_sent", "Frames that were handed to drag sockets", &one(counters.frames_sent))
    }
}

impl App {
    fn write_traces(&self, sheet: &mut Sheet<'_>) -> fmt::Result {
        let (exported, dropped) = self.tracer().map_or((0, 0), |tracer| (tracer.tally().exported(), tracer.tally().dropped()));
        sheet.counter("spans_exported", "Spans of traces that the collector has taken", &one(exported))?;
        sheet.counter("spans_dropped", "Spans of traces that were lost because the collector did not take them", &one(dropped))
    }
}

/// Pages that the kernel counts, where it says (Linux).
fn resident() -> Option<u64> {
    let status = std::fs::read_to_string("/proc/self/status").ok()?;
    let line = status.lines().find_map(|line| line.strip_prefix("VmRSS:"))?;
    line.trim().strip_suffix("kB")?.trim().parse::<u64>().ok()?.checked_mul(1024)
}
