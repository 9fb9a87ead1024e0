//! What the service tells of itself.

use std::collections::HashMap;

use serde_json::json;

use crate::support::server::{header, png, problem};
use crate::support::{Server, eventually, photo};

/// Every sample by its name and labels.
async fn scrape(server: &Server) -> HashMap<String, f64> {
    let response = server.get("/metrics").send().await.unwrap();
    assert_eq!(
        header(&response, "content-type"),
        "application/openmetrics-text; version=1.0.0; charset=utf-8"
    );
    let text = response.text().await.unwrap();
    assert!(text.ends_with("# EOF\n"));
    let samples = text
        .lines()
        .filter(|line| !line.starts_with('#'))
        .map(|line| {
            let (name, value) = line.rsplit_once(' ').unwrap();
            (name.to_owned(), value.parse().unwrap())
        });
    samples.collect()
}

#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn what_happens_is_counted_and_nothing_of_a_client_is_told() {
    let server = Server::start(&[
        "--workers",
        "2",
        "--queue",
        "7",
        "--memory-bytes",
        "100MiB",
        "--max-image-side",
        "400",
    ])
    .await;
    let id = server
        .session(&photo(300, 200), &json!({"p": [[20, 20], [200, 100]]}))
        .await;
    for x in 0..3 {
        png(server
            .drag(&id, &json!({"q": [[20 + x, 20], [200, 100]]}))
            .await)
        .await;
    }
    problem(
        server
            .upload("/warp", &photo(401, 2), &json!({"p": []}))
            .await,
        413,
        "too_large",
    )
    .await;
    problem(
        server
            .get(&format!("/sessions/{id}-secret"))
            .send()
            .await
            .unwrap(),
        404,
        "no_such_session",
    )
    .await;
    server
        .client
        .request("SECRET".parse().unwrap(), server.url("/secret"))
        .send()
        .await
        .unwrap();
    eventually("answers have left", || {
        server
            .app
            .budget()
            .taken_for(mlswarp_server::limits::memory::MemoryClass::Frame)
            == 0
    })
    .await;
    let samples = scrape(&server).await;
    for (name, value) in [
        (
            r#"mlswarp_requests_total{route="/sessions",method="POST",status="201"}"#,
            1.0,
        ),
        (
            r#"mlswarp_requests_total{route="/sessions/{id}/warp",method="POST",status="200"}"#,
            3.0,
        ),
        (
            r#"mlswarp_requests_total{route="-",method="other",status="404"}"#,
            1.0,
        ),
        (
            r#"mlswarp_problems_total{code="too_large",limit="image_side"}"#,
            1.0,
        ),
        (
            r#"mlswarp_request_duration_seconds_count{route="/warp"}"#,
            1.0,
        ),
        (
            r#"mlswarp_stage_duration_seconds_count{stage="deform"}"#,
            3.0,
        ),
        (
            r#"mlswarp_stage_duration_seconds_count{stage="encode"}"#,
            3.0,
        ),
        (r#"mlswarp_workers{work="drag"}"#, 2.0),
        (r#"mlswarp_workers_busy{work="drag"}"#, 0.0),
        (r#"mlswarp_queue_places{work="upload"}"#, 7.0),
        (r#"mlswarp_queue_waiting{work="upload"}"#, 0.0),
        (r#"mlswarp_shed_total{work="drag",reason="late"}"#, 0.0),
        ("mlswarp_memory_limit_bytes", 104_857_600.0),
        (r#"mlswarp_memory_reserved_bytes{purpose="frames"}"#, 0.0),
        (r#"mlswarp_cache_builds_total{cache="plans"}"#, 1.0),
        (r#"mlswarp_cache_values{cache="images"}"#, 1.0),
        (r#"mlswarp_pictures_total{state="finished"}"#, 3.0),
        ("mlswarp_sockets", 0.0),
    ] {
        assert_eq!(samples.get(name), Some(&value), "{name}");
    }
    assert!(samples["mlswarp_memory_resident_bytes"] > 1e6);
    assert!(samples[r#"mlswarp_memory_reserved_bytes{purpose="images"}"#] >= 300.0 * 200.0 * 3.0);
    assert_eq!(
        samples[r#"mlswarp_memory_reserved_bytes{purpose="images"}"#],
        samples[r#"mlswarp_cache_size_bytes{cache="images"}"#]
    );
    assert!(samples[r#"mlswarp_cache_hits_total{cache="images"}"#] >= 3.0);
    let table = include_str!("../../deploy/README.md");
    for name in samples
        .keys()
        .map(|sample| sample.split('{').next().unwrap())
    {
        let family = ["_bucket", "_sum", "_count"]
            .iter()
            .find_map(|end| name.strip_suffix(end))
            .unwrap_or(name);
        assert!(
            table.contains(&format!("`{family}`")),
            "{family} is in the table"
        );
    }
    let told: String = samples.into_keys().collect();
    assert!(!told.contains(&id) && !told.contains("secret") && !told.contains("SECRET"));
}
