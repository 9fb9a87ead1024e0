//! The drag: one upload, then q alone.

use serde_json::{Value, json};

use crate::support::counters::Counted as _;
use crate::support::picture::decoded;
use crate::support::server::{header, png};
use crate::support::{Server, eventually, photo};

fn rest() -> Value {
    json!({"p": [[20, 20], [100, 24], [[30, 70], [90, 80]], [[60, 30], [64, 44], [70, 60]]],
        "method": "rigid"})
}

/// Pose `n` of a circular drag.
fn posed(n: u32) -> Value {
    let (x, y) = (f64::from(n).cos() * 7.0, f64::from(n).sin() * 5.0);
    json!([
        [20.0 + x, 20.0 + y],
        [100, 24],
        [[30, 70], [90.0 - y, 80.0 + x]],
        [[60, 30], [64.0 + y, 44], [70, 60.0 + y]]
    ])
}

#[tokio::test]
async fn a_hundred_poses_build_one_plan_and_each_equals_the_one_shot_answer() {
    let server = Server::start(&[]).await;
    let photo = photo(128, 96);
    let id = server.session(&photo, &rest()).await;
    assert_eq!(server.app.counters().plans_built, 1);
    let mut distinct = std::collections::HashSet::new();
    for n in 0..100 {
        let response = server.drag(&id, &json!({"q": posed(n)})).await;
        assert_eq!(header(&response, "warp-plan"), "hit");
        let etag = header(&response, "etag").to_owned();
        let dragged = png(response).await;
        let mut whole = rest();
        whole["q"] = posed(n);
        let one_shot = server.upload("/warp", &photo, &whole).await;
        assert_eq!(header(&one_shot, "etag"), etag);
        assert_eq!(png(one_shot).await, dragged, "pose {n}");
        distinct.insert(dragged);
    }
    assert_eq!(distinct.len(), 100, "every pose is a picture of its own");
    assert_eq!(server.app.counters().plans_built, 1);
    assert_eq!(server.app.counters().images_decoded, 1);
}

#[tokio::test]
async fn an_upload_that_asks_for_a_session_gives_one_with_its_picture() {
    let server = Server::start(&[]).await;
    let photo = photo(64, 48);
    let mut whole = rest();
    whole["q"] = posed(3);
    let response = server.upload("/warp?session=true", &photo, &whole).await;
    assert_eq!(response.status(), 200);
    assert_eq!(header(&response, "warp-plan"), "built");
    let id = header(&response, "warp-session").to_owned();
    assert_eq!(header(&response, "location"), format!("/sessions/{id}"));
    let first = png(response).await;
    let again = server
        .post(&format!("/sessions/{id}/warp"))
        .json(&json!({"q": posed(3)}))
        .send()
        .await
        .unwrap();
    assert_eq!(header(&again, "warp-plan"), "hit");
    assert_eq!(png(again).await, first);
    // Refused warps make no session.
    let refused = server
        .upload(
            "/warp?session=true",
            &photo,
            &json!({"p": [[1, 1]], "q": []}),
        )
        .await;
    assert_eq!(refused.status(), 422);
    assert!(refused.headers().get("warp-session").is_none());
}

#[tokio::test]
async fn two_pictures_of_one_size_share_one_plan() {
    let server = Server::start(&[]).await;
    server.session(&photo(64, 48), &rest()).await;
    let mut other = photo(64, 48);
    // A chunk that decoders pass over: other bytes, another digest, the same size.
    other.truncate(other.len() - 12);
    other.extend_from_slice(&[0, 0, 0, 0, b't', b'E', b'S', b't']);
    other.extend_from_slice(&crc32fast::hash(b"tESt").to_be_bytes());
    other.extend_from_slice(&[0, 0, 0, 0, b'I', b'E', b'N', b'D', 0xae, 0x42, 0x60, 0x82]);
    server.session(&other, &rest()).await;
    assert_eq!(server.app.counters().images_decoded, 2);
    assert_eq!(server.app.counters().plans_built, 1);
}

#[tokio::test]
async fn what_the_caches_dropped_is_rebuilt_from_the_session() {
    let server = Server::start(&[]).await;
    let id = server.session(&photo(64, 48), &rest()).await;
    let body = json!({"q": posed(1)});
    let warm = png(server.drag(&id, &body).await).await;
    server.app.clear_caches();
    let cold = server.drag(&id, &body).await;
    assert_eq!(header(&cold, "warp-plan"), "built");
    assert_eq!(png(cold).await, warm);
    assert_eq!(server.app.counters().images_decoded, 2);
    assert_eq!(header(&server.drag(&id, &body).await, "warp-plan"), "hit");
}

#[tokio::test]
async fn caches_too_small_for_anything_change_no_picture() {
    let server = Server::start(&["--image-cache-bytes", "0", "--plan-cache-bytes", "0"]).await;
    let roomy = Server::start(&[]).await;
    let (a, b) = (
        server.session(&photo(64, 48), &rest()).await,
        roomy.session(&photo(64, 48), &rest()).await,
    );
    for n in 0..3 {
        let small = server.drag(&a, &json!({"q": posed(n)})).await;
        assert_eq!(
            png(small).await,
            png(roomy.drag(&b, &json!({"q": posed(n)})).await).await
        );
    }
    assert!(server.app.counters().plans_built > 1 && roomy.app.counters().plans_built == 1);
}

#[tokio::test]
async fn an_output_given_with_a_pose_replaces_only_what_it_names() {
    let server = Server::start(&[]).await;
    let mut whole = rest();
    whole["output"] = json!({"outside": "#ff0000ff", "filter": "nearest"});
    let id = server.session(&photo(64, 48), &whole).await;
    let preview = png(server
        .drag(&id, &json!({"q": posed(2), "output": {"width": 32}}))
        .await)
    .await;
    let preview_read = decoded(&preview);
    assert_eq!((preview_read.width, preview_read.height), (32, 24));
    whole["output"]["width"] = json!(32);
    whole["q"] = posed(2);
    assert_eq!(
        png(server.upload("/warp", &photo(64, 48), &whole).await).await,
        preview
    );
}

#[tokio::test]
async fn the_first_bytes_of_a_large_picture_leave_before_its_last_strip_is_drawn() {
    let server = Server::start(&[]).await;
    let large = photo(3840, 2160);
    let id = server
        .session(
            &large,
            &json!({"p": [[100, 100], [3000, 2000]], "output": {"compression": "best"}}),
        )
        .await;
    let mut response = server
        .drag(&id, &json!({"q": [[140, 130], [2900, 2000]]}))
        .await;
    assert_eq!(response.status(), 200);
    assert!(response.headers().get("content-length").is_none());
    let first = response.chunk().await.unwrap().unwrap();
    assert!(first.starts_with(b"\x89PNG"));
    let counters = server.app.counters();
    assert_eq!(
        (counters.pictures_begun, counters.pictures_finished),
        (1, 0)
    );
    let mut file = first.to_vec();
    while let Some(chunk) = response.chunk().await.unwrap() {
        file.extend_from_slice(&chunk);
    }
    let read = decoded(&file);
    assert_eq!((read.width, read.height), (3840, 2160));
    eventually("the picture is counted", || {
        server.app.counters().pictures_finished == 1
    })
    .await;
}

#[tokio::test]
async fn copies_for_a_size_are_made_once_and_timed_apart() {
    let server = Server::start(&[]).await;
    let id = server
        .session(&photo(640, 480), &json!({"p": [[20, 20], [300, 200]]}))
        .await;
    let mut made = Vec::new();
    for (width, moved) in [
        (160, 0),
        (160, 1),
        (100, 2),
        (320, 3),
        (640, 0),
        (640, 4),
        (640, 5),
        (300, 6),
    ] {
        let drag = json!({"q": [[20 + moved, 20], [300, 200]], "output": {"width": width}});
        let response = server
            .post(&format!("/sessions/{id}/warp"))
            .json(&drag)
            .send()
            .await
            .unwrap();
        made.push(header(&response, "server-timing").contains("reduce;dur="));
        png(response).await;
    }
    // The identity at full size copies pixels. A quarter, half and all of the size have a copy
    // each; 100 and 300 use one of them.
    assert_eq!(made, [true, false, false, true, false, true, false, false]);
}

#[tokio::test]
async fn headers_tell_what_the_contract_says() {
    let server = Server::start(&[]).await;
    let response = server
        .upload(
            "/warp",
            &photo(64, 48),
            &json!({"p": [[20, 20]], "q": [[25, 20]]}),
        )
        .await;
    assert_eq!(header(&response, "content-type"), "image/png");
    assert_eq!(header(&response, "warp-plan"), "built");
    assert_eq!(header(&response, "warp-folds"), "0");
    assert!(header(&response, "warp-residual").parse::<f64>().unwrap() < 0.01);
    assert_eq!(header(&response, "warp-warning"), "translation_only");
    assert_eq!(header(&response, "cache-control"), "no-store");
    assert_eq!(header(&response, "etag").len(), 66);
    assert!(response.headers().get("warp-session").is_none());
    let timing = header(&response, "server-timing");
    for stage in ["queue", "decode", "plan", "deform", "render", "encode"] {
        assert!(
            timing.contains(&format!("{stage};dur=")),
            "{stage} in {timing}"
        );
    }
    assert!(
        response.content_length().is_some(),
        "a small picture is whole before its answer begins"
    );
}
