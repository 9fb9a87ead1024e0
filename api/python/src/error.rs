//! Problems of the contract as exceptions of `mlswarp.errors`.

use mlswarp_contract::problem::{Code, Problem};
use pyo3::prelude::*;

/// The exception of a problem, which Python chooses by its code.
pub(crate) fn exception(py: Python<'_>, problem: &Problem) -> PyErr {
    let document = problem.to_json("", None).to_string();
    let made = py
        .import("mlswarp.errors")
        .and_then(|errors| errors.call_method1("of_problem", (document,)));
    made.map_or_else(|error| error, PyErr::from_value)
}

/// The problem of a fault in this library.
pub(crate) fn internal(detail: &str) -> Problem {
    Problem::new(Code::Internal, detail)
}
