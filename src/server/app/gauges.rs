//! `GET /metrics`: the text in OpenMetrics format, and the metrics that are read at the moment of a scrape.

use std::fmt;

use prometheus_client::collector::Collector;
use prometheus_client::encoding::text::encode;
use prometheus_client::encoding::{DescriptorEncoder, MetricEncoder, NoLabelSet};
use prometheus_client::metrics::MetricType;
use prometheus_client::registry::{Registry, Unit};

use crate::app::App;
use crate::cache::CacheStats;
use crate::limits::memory::Purpose;
use crate::observe::tracer::Tracer;
use crate::pool::{Load, WorkClass};

/// Labels and a value.
type Sample = (Vec<(&'static str, &'static str)>, u64);

impl App {
    /// All metrics as OpenMetrics text.
    pub fn metrics_text(&self) -> String {
        let mut registry = Registry::with_prefix("mlswarp");
        self.0.metrics.register(&mut registry);
        registry.register_collector(Box::new(self.clone()));
        let mut text = String::new();
        encode(&mut text, &registry).expect("writing to a string does not fail");
        text
    }
}

/// Writes metrics with their samples.
struct Writer<'a>(DescriptorEncoder<'a>);

impl Writer<'_> {
    fn write(&mut self, kind: MetricType, name: &str, help: &str, unit: Option<&Unit>, samples: &[Sample]) -> fmt::Result {
        let mut metric = self.0.encode_descriptor(name, help, unit, kind)?;
        let encode = |mut sample: MetricEncoder<'_>, value: &u64| match kind {
            MetricType::Counter => sample.encode_counter::<NoLabelSet, _, u64>(value, None),
            _ => sample.encode_gauge(value),
        };
        for (labels, value) in samples {
            // Without labels `encode_family` would write empty braces.
            if labels.is_empty() {
                return encode(metric, value);
            }
            encode(metric.encode_family(labels)?, value)?;
        }
        Ok(())
    }

    fn gauge(&mut self, name: &str, help: &str, samples: &[Sample]) -> fmt::Result {
        self.write(MetricType::Gauge, name, help, None, samples)
    }

    fn bytes(&mut self, name: &str, help: &str, samples: &[Sample]) -> fmt::Result {
        self.write(MetricType::Gauge, name, help, Some(&Unit::Bytes), samples)
    }

    fn counter(&mut self, name: &str, help: &str, samples: &[Sample]) -> fmt::Result {
        self.write(MetricType::Counter, name, help, None, samples)
    }
}

const fn one(value: u64) -> [Sample; 1] {
    [(Vec::new(), value)]
}

fn labelled(name: &'static str, value: &'static str, sample: u64) -> Sample {
    (vec![(name, value)], sample)
}

impl Collector for App {
    fn encode(&self, encoder: DescriptorEncoder<'_>) -> fmt::Result {
        let writer = &mut Writer(encoder);
        writer.gauge("build_info", "The program's version", &[labelled("version", env!("CARGO_PKG_VERSION"), 1)])?;
        self.write_work(writer)?;
        self.write_memory(writer)?;
        self.write_store(writer)?;
        let connections = self.0.access.connections();
        writer.gauge("connections", "Connections that are open", &one(connections.open() as u64))?;
        writer.counter("connections_refused", "Connections closed at once because of a limit", &one(connections.refused()))?;
        writer.gauge("sockets", "Drag sockets that are open", &one(self.0.sockets.open() as u64))?;
        let (exported, dropped) = self.tracer().map(Tracer::stats).map_or((0, 0), |stats| (stats.exported(), stats.dropped()));
        writer.counter("spans_exported", "Spans that the collector has accepted", &one(exported))?;
        writer.counter("spans_dropped", "Spans that were lost because the collector did not accept them", &one(dropped))
    }
}

impl App {
    fn write_work(&self, writer: &mut Writer<'_>) -> fmt::Result {
        let loads = [(WorkClass::Drag, "drag"), (WorkClass::Upload, "upload"), (WorkClass::Transfer, "transfer")]
            .map(|(work, name)| (self.0.pool.load(work), name));
        let each = |value: &dyn Fn(&Load) -> usize| loads.each_ref().map(|(load, work)| labelled("work", work, value(load) as u64));
        // Transfers wait for the store and take no worker.
        let [drag, upload, _] = each(&|_| self.0.config.work.workers);
        writer.gauge("workers", "Requests that run at one time, at most", &[drag, upload])?;
        let [drag, upload, (_, transfers)] = each(&|load| load.running);
        writer.gauge("workers_busy", "Requests that run", &[drag, upload])?;
        writer.gauge("transfers", "Files of sessions that are being sent to the store or fetched from it", &one(transfers))?;
        writer.gauge("queue_places", "Requests that wait, at most", &each(&|_| self.0.config.work.queue()))?;
        writer.gauge("queue_waiting", "Requests that wait", &each(&|load| load.waiting))?;
        let mut shed = vec![(vec![("work", "any"), ("reason", "memory")], self.0.budget.refused())];
        for (load, work) in &loads {
            shed.push((vec![("work", *work), ("reason", "queue_full")], load.full));
            shed.push((vec![("work", *work), ("reason", "late")], load.late));
        }
        writer.counter("shed", "Requests that were refused for lack of capacity", &shed)
    }

    fn write_memory(&self, writer: &mut Writer<'_>) -> fmt::Result {
        let budget = &self.0.budget;
        writer.bytes("memory_limit", "Memory that requests may reserve", &one(budget.total()))?;
        let reserved = Purpose::ALL.map(|purpose| labelled("purpose", purpose.name(), budget.taken_for(purpose)));
        writer.bytes("memory_reserved", "Memory that is reserved, by purpose", &reserved)?;
        if let Some(bytes) = resident() {
            writer.bytes("memory_resident", "Resident memory of the process", &one(bytes))?;
        }
        let caches = [("images", self.0.images.usage()), ("plans", self.0.plans.usage()), ("setups", self.0.setups.usage())];
        let each = |value: fn(&CacheStats) -> u64| caches.each_ref().map(|(name, usage)| labelled("cache", name, value(usage)));
        writer.bytes("cache_size", "Size of the cached values", &each(|usage| usage.bytes))?;
        writer.gauge("cache_values", "Values that are cached", &each(|usage| usage.values))?;
        writer.counter("cache_hits", "Lookups that found a value", &each(|usage| usage.hits))?;
        writer.counter("cache_builds", "Values that were built because they were not cached", &each(|usage| usage.built))?;
        writer.counter("cache_evictions", "Values that were evicted", &each(|usage| usage.evicted))
    }

    fn write_store(&self, writer: &mut Writer<'_>) -> fmt::Result {
        let figures = self.0.store.figures();
        writer.gauge("store_up", "1 while the store works", &one(u64::from(!figures.is_away)))?;
        writer.gauge("store_sessions", "Sessions that this process knows of", &one(figures.sessions))?;
        writer.bytes("store_size", "Size of their records, and of their files unless Redis keeps them", &one(figures.bytes))?;
        writer.counter("store_damaged", "Sessions that were left out because their stored data was damaged", &one(figures.damaged))?;
        writer.counter("store_other_version", "Records of another version of the program", &one(figures.other_version))?;
        writer.counter("store_failures", "Operations of the store that failed", &one(figures.failures))
    }
}

/// Resident memory as Linux reports it.
fn resident() -> Option<u64> {
    let status = std::fs::read_to_string("/proc/self/status").ok()?;
    let line = status.lines().find_map(|line| line.strip_prefix("VmRSS:"))?;
    line.trim().strip_suffix("kB")?.trim().parse::<u64>().ok()?.checked_mul(1024)
}
