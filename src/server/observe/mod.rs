//! Observability: log lines on standard error, metrics, and traces. None of them holds image
//! data, session ids, keys or paths.

pub(crate) mod log_format;
pub(crate) mod metrics;
#[cfg(feature = "otlp")]
pub(crate) mod otlp_client;
#[cfg(not(feature = "otlp"))]
#[path = "no_otlp.rs"]
pub(crate) mod otlp_client;
mod sampler;
pub(crate) mod scope;
pub mod stages;
pub mod tracer;

pub use log_format::{LogFormat, start};
pub(crate) use scope::{RequestInfo, Scope};
