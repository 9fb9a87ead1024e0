//! The WebAssembly file.

pub use mlswarp_wasm::*;
