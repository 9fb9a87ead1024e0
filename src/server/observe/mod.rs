//! Observability: log lines on standard error, metrics, and traces for an OpenTelemetry collector. None of them holds picture data, session ids,
//! keys or paths.

pub mod collector;
pub(crate) mod log_format;
pub mod metrics;
mod otlp_client;
mod sampler;
pub mod scope;
pub mod stages;
pub mod tracer;

pub use log_format::{LogFormat, start};
pub use scope::{RequestInfo, Scope};
