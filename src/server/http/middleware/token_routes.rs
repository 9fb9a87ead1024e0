//! Which routes a session token opens: one row for each route that needs a key. A route without a
//! row is closed to tokens, and fails a test.

use axum::http::Method;

use crate::wire::TokenOp;

/// Method, route, and the operation that opens it; `None`: only the key does.
const ROWS: [(&str, &str, Option<TokenOp>); 26] = {
    use TokenOp::{Batch, Delete, Drag, Handles, Layers, Read, Upload, Warp};
    const LAYER: &str = crate::http::LAYER;
    [
        ("GET", "/sessions/{id}", Some(Read)),
        ("PUT", "/sessions/{id}", Some(Upload)),
        ("DELETE", "/sessions/{id}", Some(Delete)),
        ("PUT", "/sessions/{id}/handles", Some(Handles)),
        ("GET", LAYER, Some(Read)),
        ("PUT", LAYER, Some(Layers)),
        ("DELETE", LAYER, Some(Layers)),
        ("POST", "/sessions/{id}/warp", Some(Warp)),
        ("POST", "/sessions/{id}/mesh", Some(Warp)),
        ("GET", "/sessions/{id}/plan", Some(Warp)),
        ("POST", "/sessions/{id}/points", Some(Warp)),
        ("POST", "/sessions/{id}/map", Some(Warp)),
        ("POST", "/sessions/{id}/report", Some(Warp)),
        ("POST", "/sessions/{id}/fit", Some(Warp)),
        ("GET", "/sessions/{id}/drag", Some(Drag)),
        ("POST", "/sessions/{id}/batch", Some(Batch)),
        // A token makes no others.
        ("POST", "/sessions/{id}/tokens", None),
        // Without a session, the holder of the token could do it for any image.
        ("POST", "/warp", None),
        ("POST", "/sessions", None),
        ("POST", "/points", None),
        ("POST", "/map", None),
        ("POST", "/report", None),
        ("POST", "/fit", None),
        // It names sessions in its body, which a token of one session must not reach.
        ("POST", "/blend", None),
        ("POST", "/landmarks", None),
        // Of all clients.
        ("GET", "/metrics", None),
    ]
};

/// Every row, for a test that compares them with the document.
pub fn rows() -> &'static [(&'static str, &'static str, Option<TokenOp>)] {
    &ROWS
}

/// The operation of a request. `HEAD` is `GET`.
pub(super) fn operation(method: &Method, route: &str) -> Option<TokenOp> {
    let method = if *method == Method::HEAD {
        "GET"
    } else {
        method.as_str()
    };
    ROWS.iter()
        .find(|(known, path, _)| *known == method && *path == route)
        .and_then(|(.., op)| *op)
}
