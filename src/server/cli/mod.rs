//! The subcommands that are not the server: one warp offline, and a health check.

pub mod health;
pub mod warp;
