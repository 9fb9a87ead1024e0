//! What is refused and how (tables), what is read, and laws: no text panics, what is written reads
//! back.

mod contract;
mod drag;
mod laws;
mod methods;
mod missing;
mod points;
mod reads;
mod session;
mod syntax;
mod values;

use mlswarp::deform::{Coincident, CoincidentPolicy, Parameters};
use mlswarp::format::{Compression, Format, Subsampling};
use mlswarp::geometry::Point;
use mlswarp::pixmap::Extent;
use mlswarp::render::{Filter, Outside};
use mlswarp::warp::{Align, Candidate, CanvasSpec, Digest, GridSpec, Holes, Method, Metric, Units};
use proptest::prelude::*;
use serde_json::{Value, json};

use super::*;
use crate::layer::LayerKind;

use super::arbitrary::warp_object;
use laws::written;

type Expected = (&'static str, Code, Option<&'static str>, Option<usize>);

fn check<T: std::fmt::Debug>(parse: impl Fn(&[u8]) -> Result<T, Problem>, table: &[Expected]) {
    for (text, code, pointer, handle) in table {
        let problem = parse(text.as_bytes()).expect_err(text);
        assert_eq!(
            (problem.code, problem.pointer.as_deref(), problem.handle),
            (*code, *pointer, *handle),
            "{text}: {}",
            problem.detail
        );
    }
}

fn bytes(json: &[u8]) -> Bytes {
    Bytes::copy_from_slice(json)
}

/// The object of `/points`.
fn points(json: &[u8]) -> Result<PointsObject, Problem> {
    PointsObject::parse(&bytes(json), 1 << 20, &Work::new(&|| false))
}

/// The object of `/sessions/{id}/points`.
fn posed_points(json: &[u8]) -> Result<PointsObject, Problem> {
    let extent = Extent::new(400, 300).unwrap();
    PointsObject::parse_posed(
        &bytes(json),
        1 << 20,
        (extent, Units::Px),
        &OutputSpec::default(),
        &Work::new(&|| false),
    )
}

fn point(x: f64, y: f64) -> Handle {
    Handle::Point(Point::new(x, y))
}

fn line(places: &[(f64, f64)]) -> Handle {
    Handle::Polyline(places.iter().map(|(x, y)| Point::new(*x, *y)).collect())
}

fn detail(text: &str) -> String {
    WarpObject::parse(text.as_bytes()).expect_err(text).detail
}
