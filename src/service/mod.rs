//! The application: sessions, caches, admission, HTTP.

pub mod problem;
pub mod wire;
