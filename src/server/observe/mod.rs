//! What the service tells while it works: log lines on standard error (`lines`), and, where there is a collector, traces (`trace`, `tracer`). Both
//! learn from the [`Scope`] whose request is worked on. Neither holds picture data, session ids, keys or paths.

mod collected;
pub mod collector;
pub(crate) mod log_format;
pub mod metrics;
pub(crate) mod otlp_client;
pub mod scope;
pub mod stages;
mod trace;
pub mod tracer;

pub use log_format::{LogFormat, start};
pub use scope::Scope;
pub use trace::{Answer, Asked};
