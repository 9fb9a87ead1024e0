//! The service of mlswarp: image deformation over HTTP. The use cases are in [`app`], the routes in
//! [`http`].

#![allow(
    rustdoc::private_intra_doc_links,
    rustdoc::bare_urls,
    reason = "the crate is read in its source; documentation of options is the help text too"
)]
#![forbid(unsafe_code)]

pub mod app;
pub mod auth;
pub mod cache;
pub mod cli;
pub mod client;
pub mod config;
pub mod drag;
pub mod http;
pub mod limits;
pub mod observe;
pub mod pool;
pub mod session;
pub mod store;

pub use mlswarp_contract::{layer, problem, wire};
