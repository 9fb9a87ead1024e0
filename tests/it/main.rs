//! One integration binary: linked once, one module a topic. Name the topic first, then the law.

#![expect(
    clippy::unwrap_used,
    clippy::cast_possible_truncation,
    reason = "a failed unwrap is a failed test, and test numbers are small"
)]

mod align;
mod bad_input;
mod batch;
mod binary;
mod cancellation;
mod cancelling;
mod canvas;
mod citations;
mod coincident;
mod compact;
mod concurrency;
mod crash;
mod decoders;
mod decoding;
mod disconnects;
mod drag;
mod effects;
mod environment;
mod estimates;
mod fairness;
mod fit;
mod floods;
mod formats;
mod frames;
mod geojson;
mod golden;
mod hostile;
mod hosts;
mod identity;
mod json_null;
mod keys;
mod labels;
mod landmark_forms;
mod landmarks;
mod laws;
mod links;
mod maps;
mod memory_budget;
mod metadata;
mod methods;
mod metrics;
mod mirrors;
mod missing;
mod mistakes;
mod module_dependencies;
#[path = "../fuzz/mutation.rs"]
mod mutation;
mod offline;
mod offline_folders;
mod offline_landmarks;
mod offline_options;
mod offline_tools;
mod openapi;
mod openapi_examples;
mod ops_listener;
mod oracle;
mod overload;
mod page;
mod plans;
mod points;
mod poses;
mod problems;
mod public_path;
mod rate_limits;
mod real_landmarks;
mod report;
mod request_ids;
mod revisions;
mod runtime_thread;
mod session_layers;
mod sessions;
mod slow;
mod slow_store;
mod snapshots;
mod soak;
mod socket;
mod socket_abuse;
mod spline;
mod stopping;
mod store_lookups;
mod stores;
mod strength;
mod support;
mod tenants;
mod tls;
mod tokens;
mod traces;
mod unread;
mod warnings;
mod words;
