//! Any bytes as the body of an upload, through the router in this process. The first byte chooses
//! the route and its media type.

use std::sync::LazyLock;

use axum::Router;
use axum::body::Body;
use axum::http::Request;
use http_body_util::BodyExt as _;
use mlswarp_server::app::App;
use mlswarp_server::config::Config;
use mlswarp_server::http::router;
use tokio::runtime::{Builder, Runtime};
use tower::ServiceExt as _;

use super::assert_is_problem;

/// Small, so that any input is answered soon.
const OPTIONS: &str = "mlswarp --workers 1 --max-image-pixels 64k --max-columns 64 \
    --max-plan-bytes 1MiB --image-cache-bytes 1MiB \
                       --plan-cache-bytes 1MiB --max-warp-json-bytes 4KiB --log off";

/// An application of one worker, and the runtime that it lives in.
pub(super) fn app() -> (App, Runtime) {
    let runtime = Builder::new_current_thread()
        .enable_all()
        .build()
        .expect("a runtime");
    let config = Config::read(OPTIONS.split_whitespace()).expect("sane values");
    (App::new(config).expect("threads"), runtime)
}

static SERVICE: LazyLock<(Router, Runtime)> = LazyLock::new(|| {
    let (app, runtime) = app();
    (router(app), runtime)
});

pub(super) fn post(bytes: &[u8]) {
    let Some((route, body)) = bytes.split_first() else {
        return;
    };
    let (method, path) = [
        ("POST", "/warp"),
        (
            "POST",
            "/sessions/11111111-2222-4333-8444-555555555555/warp",
        ),
        ("PUT", "/sessions/11111111-2222-4333-8444-555555555555"),
        (
            "PUT",
            "/sessions/11111111-2222-4333-8444-555555555555/handles",
        ),
    ][usize::from(route % 4)];
    let kind = ["multipart/form-data; boundary=b", "application/json"][usize::from(*route > 127)];
    let request = Request::builder()
        .method(method)
        .uri(path)
        .header("host", "localhost")
        .header("content-type", kind);
    let request = request
        .body(Body::from(body.to_vec()))
        .expect("a request of plain words");
    let (router, runtime) = &*SERVICE;
    let (status, body) = runtime.block_on(async {
        let response = router
            .clone()
            .oneshot(request)
            .await
            .unwrap_or_else(|never| match never {});
        let status = response.status().as_u16();
        (
            status,
            response
                .into_body()
                .collect()
                .await
                .expect("a whole body")
                .to_bytes(),
        )
    });
    match status {
        200 | 201 => assert!(!body.is_empty()),
        400..500 => assert_is_problem(&serde_json::from_slice(&body).expect("a document")),
        _ => panic!("{status} {}", String::from_utf8_lossy(&body)),
    }
}
