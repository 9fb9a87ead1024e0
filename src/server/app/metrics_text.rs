//! `GET /metrics`: the counters of the service, and values that are read at the moment of a scrape,
//! as OpenMetrics text.

use std::sync::atomic::AtomicU64;

use prometheus_client::encoding::text::{encode, encode_registry};
use prometheus_client::metrics::counter::{ConstCounter, Counter};
use prometheus_client::metrics::family::Family;
use prometheus_client::metrics::gauge::{ConstGauge, Gauge};
use prometheus_client::registry::{Registry, Unit};

use crate::app::App;
use crate::cache::CacheStats;
use crate::config::available_memory::kib_field;
use crate::limits::memory::MemoryClass;
use crate::observe::metrics::PREFIX;
use crate::pool::{Load, WorkClass};

type FixedLabels<const N: usize> = [(&'static str, &'static str); N];

/// All metrics as OpenMetrics text.
pub fn text(app: &App) -> String {
    let mut text = String::new();
    let counters = encode_registry(&mut text, &app.metrics().registry);
    let registry = &mut Registry::with_prefix(PREFIX);
    registry.register(
        "build_info",
        "The program's version",
        gauges([([("version", env!("CARGO_PKG_VERSION"))], 1)]),
    );
    register_work(app, registry);
    register_memory(app, registry);
    register_store(app, registry);
    let connections = app.access().connections();
    registry.register(
        "connections",
        "Connections that are open",
        ConstGauge::new(connections.open()),
    );
    let help = "Connections closed at once because of a limit";
    registry.register(
        "connections_refused",
        help,
        ConstCounter::new(connections.refused()),
    );
    registry.register(
        "sockets",
        "Drag sockets that are open",
        ConstGauge::new(app.admission.sockets.open()),
    );
    let stats = app.tracer().map(|tracer| {
        (
            tracer.stats().exported.clone(),
            tracer.stats().dropped.clone(),
        )
    });
    let (exported, dropped) = stats.unwrap_or_default();
    registry.register(
        "spans_exported",
        "Spans that the collector has accepted",
        exported,
    );
    registry.register(
        "spans_dropped",
        "Spans that were lost because the collector did not accept them",
        dropped,
    );
    counters
        .and_then(|()| encode(&mut text, registry))
        .expect("writing to a string does not fail");
    text
}

fn register_work(app: &App, registry: &mut Registry) {
    let loads = [
        (WorkClass::Drag, "drag"),
        (WorkClass::Upload, "upload"),
        (WorkClass::Transfer, "transfer"),
    ]
    .map(|(work, name)| (app.pool().load(work), name));
    let each = |value: &dyn Fn(&Load) -> usize| {
        loads
            .each_ref()
            .map(|(load, work)| ([("work", *work)], value(load) as u64))
    };
    // Transfers wait for the store and take no worker.
    let [drag, upload, _] = each(&|_| app.config().work.workers);
    registry.register(
        "workers",
        "Requests that run at one time, at most",
        gauges([drag, upload]),
    );
    let [drag, upload, (_, transfers)] = each(&|load| load.running);
    registry.register("workers_busy", "Requests that run", gauges([drag, upload]));
    let help = "Files of sessions that are being sent to the store or fetched from it";
    registry.register("transfers", help, ConstGauge::new(transfers));
    registry.register(
        "queue_places",
        "Requests that wait, at most",
        gauges(each(&|_| app.config().work.queue())),
    );
    registry.register(
        "queue_waiting",
        "Requests that wait",
        gauges(each(&|load| load.waiting)),
    );
    let by_class = loads.iter().flat_map(|(load, work)| {
        [
            ([("work", *work), ("reason", "queue_full")], load.full),
            ([("work", *work), ("reason", "late")], load.late),
        ]
    });
    let shed = by_class.chain([(
        [("work", "any"), ("reason", "memory")],
        app.budget().refused(),
    )]);
    registry.register(
        "shed",
        "Requests that were refused for lack of capacity",
        counters(shed),
    );
}

fn register_memory(app: &App, registry: &mut Registry) {
    let budget = &app.budget();
    registry.register_with_unit(
        "memory_limit",
        "Memory that requests may reserve",
        Unit::Bytes,
        ConstGauge::new(budget.total()),
    );
    let reserved =
        MemoryClass::ALL.map(|purpose| ([("purpose", purpose.name())], budget.taken_for(purpose)));
    registry.register_with_unit(
        "memory_reserved",
        "Memory that is reserved, by purpose",
        Unit::Bytes,
        gauges(reserved),
    );
    let status = std::fs::read_to_string("/proc/self/status").unwrap_or_default();
    if let Some(bytes) = kib_field(&status, "VmRSS:") {
        registry.register_with_unit(
            "memory_resident",
            "Resident memory of the process",
            Unit::Bytes,
            ConstGauge::new(bytes),
        );
    }
    let caches = app
        .admission
        .caches
        .each_ref()
        .map(|(name, cache)| (*name, cache.usage()));
    let each = |value: fn(&CacheStats) -> u64| {
        caches
            .each_ref()
            .map(|(name, usage)| ([("cache", *name)], value(usage)))
    };
    registry.register_with_unit(
        "cache_size",
        "Size of the cached values",
        Unit::Bytes,
        gauges(each(|usage| usage.bytes)),
    );
    registry.register(
        "cache_values",
        "Values that are cached",
        gauges(each(|usage| usage.values)),
    );
    registry.register(
        "cache_hits",
        "Lookups that found a value",
        counters(each(|usage| usage.hits)),
    );
    let help = "Values that were built because they were not cached";
    registry.register("cache_builds", help, counters(each(|usage| usage.built)));
    registry.register(
        "cache_evictions",
        "Values that were evicted",
        counters(each(|usage| usage.evicted)),
    );
}

fn register_store(app: &App, registry: &mut Registry) {
    let stats = app.sessions.store.figures();
    registry.register(
        "store_up",
        "1 while the store works",
        ConstGauge::new(u64::from(!stats.is_away)),
    );
    registry.register(
        "store_sessions",
        "Sessions that this process knows of",
        ConstGauge::new(stats.sessions),
    );
    let help = "Size of their records, and of their files (once for each name) unless Redis \
        keeps them";
    registry.register_with_unit(
        "store_size",
        help,
        Unit::Bytes,
        ConstGauge::new(stats.bytes),
    );
    for (name, help, value) in [
        (
            "store_damaged",
            "Sessions that were left out because their stored data was damaged",
            stats.damaged,
        ),
        (
            "store_other_version",
            "Records of another version of the program",
            stats.other_version,
        ),
        (
            "store_failures",
            "Operations of the store that failed",
            stats.failures,
        ),
    ] {
        registry.register(name, help, ConstCounter::new(value));
    }
}

fn gauges<const N: usize>(
    samples: impl IntoIterator<Item = (FixedLabels<N>, u64)>,
) -> Family<FixedLabels<N>, Gauge<u64, AtomicU64>> {
    let family = Family::<_, Gauge<_, _>>::default();
    for (labels, value) in samples {
        family.get_or_create(&labels).set(value);
    }
    family
}

fn counters<const N: usize>(
    samples: impl IntoIterator<Item = (FixedLabels<N>, u64)>,
) -> Family<FixedLabels<N>, Counter> {
    let family = Family::<_, Counter>::default();
    for (labels, value) in samples {
        family.get_or_create(&labels).inc_by(value);
    }
    family
}
