//! The limits that clients can reach. Not all of them are in this module: the last column says
//! where.
//!
//! | limit | option | excess | in |
//! |---|---|---|---|
//! | memory | `--memory-bytes` | 503 `overloaded`; 413 `too_large` if it can never fit | [`memory`] |
//! | unread responses of a client | a quarter of `--memory-bytes` | 503 `overloaded` | [`client_quota`] |
//! | requests of a client | `--max-client-share` of the memory for uploads | 429 `rate_limited`; 413 `too_large` | [`client_quota`] |
//! | requests per second | `--rate-per-key`, `--rate-per-address` | 429 `rate_limited` | [`rate_limit`] |
//! | connections | `--max-connections`, `--max-connections-per-address` | the connection is closed | [`connections`] |
//! | drag sockets | `--max-sockets` | 503 `overloaded` | [`sockets`] |
//! | drag sockets of a session | 32 | 503 `overloaded` | [`sockets`] |
//! | drag sockets of a client | `--max-client-share` of `--max-sockets` | 429 `rate_limited` | [`sockets`] |
//! | sessions, bytes of a client | `--max-client-share` of `--max-sessions`, `--store-bytes` | 429 `rate_limited` | `app::client_sessions` |
//! | sessions and stored bytes in all | `--max-sessions`, `--store-bytes` | 503 `overloaded` | `store::index` |
//! | waiting requests | `--queue`, `--drag-wait`, `--upload-wait` | 503 `overloaded` | `pool` |
//! | bytes of a body, of its JSON | `--max-body-bytes`, `--max-warp-json-bytes` | 413 `too_large` | `http::body`, `http::upload` |
//! | pixels, sides, columns, size of a plan | `--max-image-pixels`, `--max-image-side`, `--max-columns` | 413 `too_large` | the engine |
//! | operations of a task, by an estimate | `--max-work` | 413 `too_large` | the engine, `warp::work` |
//! | frames of a batch | 10,000 | 413 `too_large` | `wire::batch` |
//! | frames of a batch that are drawn ahead of the client | workers + 2, at most 8 | the batch waits | `app::batch` |
//! | messages per second on a drag socket | 1000, 2000 at once | WebSocket close code 1008 | [`bucket`] |

pub mod bucket;
pub mod client_limit;
pub mod client_quota;
pub mod connections;
mod counts;
pub mod free;
pub mod freed;
pub mod memory;
pub mod networks;
pub mod rate_limit;
pub mod sockets;
