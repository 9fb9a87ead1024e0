//! Every limit that a client can reach: memory, unread answers, request rates, connections and sockets.

pub mod bucket;
pub mod client_quota;
pub mod connections;
pub mod memory;
pub mod networks;
pub mod rate_limit;
pub mod sockets;
