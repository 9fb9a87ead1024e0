//! The module `mlswarp._engine`: the library for Python. The classes and functions that people use
//! are Python (`python/mlswarp`), which checks arrays and makes JSON of handles and options. What
//! comes here is JSON in the service's contract, and buffers; what goes is JSON, and arrays.
//! Nothing here is for use from outside.
//!
//! Long work runs on a pool of this process without Python's lock ([`pool`]). Every error is a
//! problem of the contract ([`error`]).

mod blend;
mod error;
mod files;
mod plan;
mod pool;
mod pose;
mod values;

/// It serves what Rust allocates in this module; Python and NumPy keep their own.
#[global_allocator]
static ALLOCATOR: mimalloc::MiMalloc = mimalloc::MiMalloc;

/// The module itself.
#[pyo3::pymodule(name = "_engine")]
mod engine {
    #[pymodule_export]
    use super::blend::Blend;
    #[pymodule_export]
    use super::files::{compare_methods, read_landmarks, warp_file};
    #[pymodule_export]
    use super::plan::Plan;
    #[pymodule_export]
    use super::pool::{num_threads, set_num_threads};
    #[pymodule_export]
    use super::pose::Pose;
}
