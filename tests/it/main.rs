//! One integration binary: linked once, one module a topic. Name the topic first, then the law.

#![expect(clippy::unwrap_used, clippy::cast_possible_truncation, reason = "a failed unwrap is a failed test, and test numbers are small")]

mod account;
mod bad_input;
mod binary;
mod canvas;
mod clients;
mod coincident;
mod crash;
mod decoders;
mod decoding;
mod doors;
mod drag;
mod environment;
mod fairness;
mod floods;
mod formats;
mod golden;
mod hostile;
mod hosts;
mod identity;
mod keys;
mod landmarks;
mod laws;
mod layers;
mod leaving;
mod metrics;
mod mistakes;
#[path = "../fuzz/mutation.rs"]
mod mutation;
mod nulls;
mod offline;
mod openapi;
mod openapi_examples;
mod oracle;
mod overload;
mod page;
mod problems;
mod public_path;
mod request_ids;
mod revisions;
mod sessions;
mod slow;
mod slow_store;
mod soak;
mod socket;
mod socket_abuse;
mod spline;
mod stopping;
mod stores;
mod support;
mod tls;
mod traces;
mod warnings;
mod watchers;
mod work;
