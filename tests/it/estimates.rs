//! Work that would never end is refused before it begins, by an estimate that counts operations:
//! the same on every machine and under every load.

use std::time::{Duration, Instant};

use mlswarp::warp::{Candidate, Limits, check_comparison};
use serde_json::{Value, json};

use crate::support::server::problem;
use crate::support::{Server, photo};

/// A refusal is much faster than this; the work would take minutes.
const SOON: Duration = Duration::from_secs(10);

fn places(count: u32) -> Vec<[f64; 2]> {
    let share = |k: u32| f64::from(k.wrapping_mul(2_654_435_761)) / f64::from(u32::MAX);
    (0..count)
        .map(|k| [600.0 * share(2 * k), 400.0 * share(2 * k + 1)])
        .collect()
}

async fn refused(server: &Server, path: &str, body: &Value) -> Value {
    let began = Instant::now();
    let answer = server.post(path).json(body).send().await.unwrap();
    let told = problem(answer, 413, "too_large").await;
    assert_eq!(told["limit_name"], "work", "{told}");
    assert!(
        told["actual"].as_u64() > told["limit"].as_u64() && told.get("retry_after").is_none(),
        "{told}"
    );
    assert!(
        told["detail"].as_str().unwrap().contains("send "),
        "what to send instead: {told}"
    );
    assert!(began.elapsed() < SOON, "{path}: {:?}", began.elapsed());
    told
}

#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn estimates_refuse_at_once_what_would_never_end() {
    let server = Server::start(&["--workers", "2"]).await;
    let (extent, many) = (json!([7000, 7000]), places(10_000));
    // Methods, compared.
    let p = places(2_000);
    let candidates = vec![json!({"method": "tps"}); 64];
    let fit = json!({"p": p, "q": p, "extent": [640, 400], "candidates": candidates});
    assert_eq!(
        refused(&server, "/fit", &fit).await["pointer"],
        "/candidates"
    );
    // Vertices of a grid.
    let pixel = json!({"p": many, "q": many, "extent": extent, "grid": "pixel"});
    assert_eq!(
        refused(&server, "/report", &pixel).await["pointer"],
        "/grid"
    );
    refused(&server, "/map", &pixel).await;
    // Edges of outlines.
    let ring: Vec<[f64; 2]> = (0..20_000)
        .map(|k| [f64::from(k % 2) * 600.0, f64::from(k) * 0.3])
        .collect();
    refused(
        &server,
        "/points",
        &json!({"p": many, "q": many, "extent": extent, "polygons": [ring]}),
    )
    .await;
    // Frames that are posed before the first is sent: nothing moves, so none needs alpha.
    let id = server.session(&photo(640, 400), &json!({"p": many})).await;
    let still = json!({"q": many, "jitter": {"seed": 1, "count": 10_000, "sigma": 0}});
    refused(&server, &format!("/sessions/{id}/batch"), &still).await;
}

#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn estimates_follow_the_flag_and_accept_what_is_usual() {
    let server = Server::start(&["--max-work", "1M"]).await;
    let p = places(100);
    let points =
        |count: u32| json!({"p": p, "q": p, "extent": [640, 400], "points": places(count)});
    assert_eq!(
        server
            .post("/points")
            .json(&points(4_000))
            .send()
            .await
            .unwrap()
            .status(),
        200
    );
    assert_eq!(
        refused(&server, "/points", &points(6_000)).await["limit"],
        1_000_000
    );
    let mut inverse = points(700);
    inverse["inverse"] = json!(true);
    refused(&server, "/points", &inverse).await;
    // The largest comparison of the default candidates.
    assert!(check_comparison(2_000, &Candidate::defaults(), &Limits::default()).is_ok());
}

/// Where a pose folds, the search for an inverse takes far more operations than the estimate. They
/// are counted while it runs, those of all parts of an answer together.
#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn the_parts_of_an_inverse_are_one_task() {
    let server = Server::start(&["--max-work", "20M"]).await;
    let (p, q) = (places(7), vec![[300, 200]; 7]);
    let inverse = json!({
        "p": p, "q": q, "method": "affine", "extent": [640, 400], "inverse": true, "points": []
    });
    // All of the image is drawn beside these. Their text is so long that a part has 2,500 of them.
    let position = |k| format!("[300.{k:05}{},200]", "0".repeat(90));
    let is_answered = async |count: usize| {
        let points = format!(
            "\"points\":[{}]",
            (0..count).map(position).collect::<Vec<_>>().join(",")
        );
        let body = inverse.to_string().replace("\"points\":[]", &points);
        let request = server.post("/points").body(body);
        let answer = request.header("content-type", "application/json").send();
        let answer = answer.await.unwrap();
        assert_eq!(answer.status(), 200);
        // What is too much is known when the first parts have been sent: the answer breaks off.
        answer.bytes().await.is_ok()
    };
    assert!(is_answered(2_000).await);
    assert!(!is_answered(8_000).await);
}

/// The edges of all parts of an answer count together too.
#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn the_parts_of_outlines_are_one_task() {
    let server = Server::start(&["--max-work", "1M"]).await;
    let p = places(7);
    let outlines = json!({"p": p, "q": p, "extent": [640, 400], "polygons": []});
    // An edge of 400 px is examined at 50 positions. A vertex has 400 characters, and a part has
    // about 650 of them.
    let zeros = "0".repeat(400);
    let position = |k| format!("[{}.{zeros},0]", 100 + k % 2 * 400);
    let ring = (0..50).map(position).collect::<Vec<_>>().join(",");
    let is_answered = async |count: usize| {
        let rings = vec![format!("[{ring}]"); count].join(",");
        let body = outlines.to_string().replace("[]", &format!("[{rings}]"));
        let request = server.post("/points").body(body);
        let answer = request.header("content-type", "application/json").send();
        let answer = answer.await.unwrap();
        assert_eq!(answer.status(), 200);
        answer.bytes().await.is_ok()
    };
    assert!(is_answered(20).await);
    assert!(!is_answered(60).await);
}
