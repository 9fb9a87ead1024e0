//! The drag socket: poses in, frames out.

use std::time::Duration;

use mlswarp_server::pool::{QueueKey, WorkClass};
use reqwest::Method;
use reqwest::header::{
    CONNECTION, HOST, ORIGIN, SEC_WEBSOCKET_KEY, SEC_WEBSOCKET_VERSION, TRANSFER_ENCODING, UPGRADE,
};
use serde_json::{Value, json};

use crate::support::counters::Counted as _;
use crate::support::drag_client::Received;
use crate::support::picture::decoded;
use crate::support::program::Program;
use crate::support::server::{form, header, png, problem, this_client};
use crate::support::{DragClient, Server, eventually, photo};

fn rest() -> Value {
    json!({"p": [[20, 20], [100, 24], [[30, 70], [90, 80]]]})
}

/// Pose `n` of a circular drag.
fn posed(n: u64) -> Value {
    #[expect(clippy::cast_precision_loss, reason = "a small number")]
    let angle = n as f64 / 9.0;
    json!([
        [20.0 + 7.0 * angle.cos(), 20.0 + 5.0 * angle.sin()],
        [100, 24],
        [[30, 70], [90, 80]]
    ])
}

/// The picture that a request gets for the pose.
async fn requested(server: &Server, id: &str, q: &Value, output: &Value) -> Vec<u8> {
    png(server
        .post(&format!("/sessions/{id}/warp"))
        .json(&json!({"q": q, "output": output}))
        .send()
        .await
        .unwrap())
    .await
}

#[tokio::test]
async fn frames_are_the_pictures_of_requests() {
    let server = Server::start(&[]).await;
    let id = server.session(&photo(128, 96), &rest()).await;
    let mut drag = DragClient::open(server.address, &id, "").await;
    let session: Value = server
        .get(&format!("/sessions/{id}"))
        .send()
        .await
        .unwrap()
        .json()
        .await
        .unwrap();
    let grid = &session["grid"];
    assert_eq!(
        drag.hello,
        json!({"columns": grid["columns"], "rows": grid["rows"], "width": 128, "height": 96,
            "cell": grid["cell"]})
    );
    for seq in [1, 2, 5, 1 << 40] {
        drag.pose(seq, &posed(seq % 7)).await;
        let (of, frame) = drag.frame().await;
        assert_eq!(of, seq);
        assert!(
            frame == requested(&server, &id, &posed(seq % 7), &json!({})).await,
            "seq {seq}"
        );
        drag.ack(seq).await;
    }
    // A picture large enough to come in strips, and in fragments.
    let id = server.session(&photo(700, 500), &rest()).await;
    let mut drag = DragClient::open(server.address, &id, "?frames=png&width=auto").await;
    drag.pose(0, &posed(3)).await;
    assert!(drag.frame().await.1 == requested(&server, &id, &posed(3), &json!({})).await);
    assert_eq!(server.app.counters().sockets_open, 2);
}

/// A region that is stored, replaced and removed during a drag: each frame is the picture of a
/// request.
#[tokio::test]
async fn frames_have_the_region_of_the_session() {
    let server = Server::start(&[]).await;
    let id = server.session(&photo(128, 96), &rest()).await;
    let region = server.url(&format!("/sessions/{id}/layers/region"));
    let mask = |edge: u32| {
        let mask = image::GrayImage::from_fn(128, 96, |x, _| {
            image::Luma([if x < edge { 255 } else { 0 }])
        });
        let mut file = std::io::Cursor::new(Vec::new());
        mask.write_to(&mut file, image::ImageFormat::Png).unwrap();
        file.into_inner()
    };
    let mut drag = DragClient::open(server.address, &id, "").await;
    let mut frames = Vec::new();
    for (seq, edge) in [(1, None), (2, Some(64)), (3, Some(20)), (4, None)] {
        let changed = match edge {
            Some(edge) => server
                .client
                .put(&region)
                .body(mask(edge))
                .send()
                .await
                .unwrap()
                .status()
                .as_u16(),
            None if seq > 1 => server
                .client
                .delete(&region)
                .send()
                .await
                .unwrap()
                .status()
                .as_u16(),
            None => 0,
        };
        assert!(
            matches!((seq, changed), (1, 0) | (2, 201) | (3, 200) | (4, 204)),
            "{seq}: {changed}"
        );
        drag.pose(seq, &posed(4)).await;
        let (of, frame) = drag.frame().await;
        assert_eq!(of, seq);
        assert!(
            frame == requested(&server, &id, &posed(4), &json!({})).await,
            "seq {seq}"
        );
        drag.ack(seq).await;
        frames.push(frame);
    }
    assert!(
        frames[0] == frames[3]
            && frames[0] != frames[1]
            && frames[1] != frames[2]
            && frames[0] != frames[2]
    );
}

#[tokio::test]
async fn frames_are_of_the_format_that_the_socket_asks_for_or_of_the_sessions() {
    let server = Server::start(&[]).await;
    let mut warp = rest();
    warp["output"] = json!({"format": "webp"});
    let id = server.session(&photo(128, 96), &warp).await;
    for (query, format) in [
        ("?frames=png", "png"),
        ("?frames=jpeg", "jpeg"),
        ("?frames=webp", "webp"),
        ("", "webp"),
    ] {
        let mut drag = DragClient::open(server.address, &id, query).await;
        drag.pose(0, &posed(1)).await;
        let request = server
            .post(&format!("/sessions/{id}/warp"))
            .json(&json!({"q": posed(1), "output": {"format": format}}));
        let response = request.send().await.unwrap();
        assert_eq!(header(&response, "content-type"), format!("image/{format}"));
        assert!(
            drag.frame().await.1 == response.bytes().await.unwrap(),
            "{query}"
        );
    }
}

#[tokio::test]
async fn handles_that_are_replaced_during_a_drag_are_told_before_their_first_frame() {
    let server = Server::start(&[]).await;
    let id = server.session(&photo(128, 96), &rest()).await;
    let mut drag = DragClient::open(server.address, &id, "?frames=mesh").await;
    drag.pose(1, &posed(1)).await;
    drag.ack_of_next_frame(1).await;
    let body = json!({"p": [[20, 20], [100, 70]], "grid": {"columns": 7, "rows": 5}});
    let put = server
        .client
        .put(server.url(&format!("/sessions/{id}/handles")))
        .json(&body)
        .send()
        .await
        .unwrap();
    assert_eq!(put.status(), 200);
    // The client has not heard of it yet: one handle too many.
    drag.pose(2, &posed(2)).await;
    assert_eq!(drag.problem("shape_mismatch").await["seq"], 2);
    drag.pose(3, &json!([[22, 20], [100, 72]])).await;
    let hello = drag.text().await;
    assert_eq!((&hello["columns"], &hello["rows"]), (&json!(7), &json!(5)));
    let (of, frame) = drag.frame().await;
    assert_eq!((of, frame.len()), (3, 8 * 7 * 5));
    drag.ack(3).await;
    drag.pose(4, &json!([[22, 20], [100, 72]])).await;
    assert_eq!(drag.frame().await.0, 4, "once");
}

#[tokio::test]
async fn mesh_frames_are_the_meshes_of_requests() {
    let server = Server::start(&[]).await;
    let id = server.session(&photo(128, 96), &rest()).await;
    let mut drag = DragClient::open(server.address, &id, "?frames=mesh").await;
    for seq in 0..5 {
        drag.pose(seq, &posed(seq)).await;
        let (of, frame) = drag.frame().await;
        let request = server
            .post(&format!("/sessions/{id}/mesh"))
            .header("accept", "application/octet-stream");
        let response = request
            .json(&json!({"q": posed(seq)}))
            .send()
            .await
            .unwrap();
        assert_eq!((of, response.status().as_u16()), (seq, 200));
        assert!(frame == response.bytes().await.unwrap());
        assert_eq!(
            frame.len() as u64,
            8 * drag.hello["columns"].as_u64().unwrap() * drag.hello["rows"].as_u64().unwrap()
        );
        drag.ack(seq).await;
    }
    assert_eq!(
        server.app.counters().pictures_begun,
        0,
        "no picture is drawn for a mesh"
    );
}

#[tokio::test]
async fn of_a_burst_the_last_pose_is_shown_and_the_overtaken_are_counted() {
    let server = Server::start(&["--workers", "1"]).await;
    let id = server.session(&photo(600, 400), &rest()).await;
    let mut drag = DragClient::open(server.address, &id, "?width=600").await;
    for seq in 0..500 {
        drag.pose(seq, &posed(seq)).await;
    }
    let frames = drag.show_until(499).await;
    assert!(frames.is_sorted_by(|a, b| a.0 < b.0), "frames go forward");
    assert!(frames.last().unwrap().1 == requested(&server, &id, &posed(499), &json!({})).await);
    let counters = server.app.counters();
    assert_eq!(counters.frames_sent, frames.len() as u64);
    assert_eq!(
        counters.poses_superseded,
        500 - frames.len() as u64,
        "every pose is shown or counted"
    );
}

#[tokio::test]
async fn the_next_frame_waits_for_the_acknowledgement() {
    let server = Server::start(&[]).await;
    let id = server.session(&photo(128, 96), &rest()).await;
    let mut drag = DragClient::open(server.address, &id, "").await;
    drag.pose(1, &posed(1)).await;
    assert_eq!(drag.frame().await.0, 1);
    for seq in 2..20 {
        drag.pose(seq, &posed(seq)).await;
    }
    assert!(
        drag.next_within(Duration::from_millis(400)).await.is_none(),
        "nothing before the acknowledgement"
    );
    let begun = server.app.counters().pictures_begun;
    assert!(begun <= 2, "one sent and one ahead, not {begun}");
    drag.ack(1).await;
    // What was made ahead has grown old meanwhile, unless making takes as long as this client was
    // silent.
    let seqs: Vec<u64> = drag
        .show_until(19)
        .await
        .into_iter()
        .map(|(seq, _)| seq)
        .collect();
    assert!(seqs.len() <= 2, "{seqs:?}");
    assert!(
        drag.next_within(Duration::from_millis(300)).await.is_none(),
        "a full frame is made once"
    );
}

#[tokio::test]
async fn a_preview_is_followed_by_the_full_frame_when_the_drag_rests() {
    let server = Server::start(&[]).await;
    let mut warp = rest();
    warp["output"] = json!({"compression": "best"});
    let id = server.session(&photo(640, 480), &warp).await;
    let mut drag = DragClient::open(server.address, &id, "?width=256&report=true").await;
    for seq in 0..4 {
        drag.pose(seq, &posed(seq)).await;
        let report = drag.text().await;
        let (of, frame) = drag.frame().await;
        assert_eq!(
            (of, &report["seq"], &report["full"]),
            (seq, &json!(seq), &json!(false))
        );
        assert_eq!(
            (&report["width"], &report["height"]),
            (&json!(256), &json!(192))
        );
        assert!(
            frame
                == requested(
                    &server,
                    &id,
                    &posed(seq),
                    &json!({"width": 256, "compression": "fast"})
                )
                .await
        );
        drag.ack(seq).await;
    }
    let report = drag.text().await;
    let (of, frame) = drag.frame().await;
    assert_eq!(
        (of, &report["full"], &report["width"]),
        (3, &json!(true), &json!(640))
    );
    assert!(frame == requested(&server, &id, &posed(3), &json!({})).await);
    for name in ["queue", "deform", "render", "encode"] {
        assert!(
            report["timing"][name]
                .as_f64()
                .is_some_and(|ms| (0.0..60_000.0).contains(&ms)),
            "{report}"
        );
    }
    assert!(
        report["folds"].is_u64() && report["residual"].is_f64() && report["warnings"].is_array(),
        "{report}"
    );
    drag.ack(3).await;
    assert!(
        drag.next_within(Duration::from_millis(400)).await.is_none(),
        "once"
    );
    // A drag that moves on before it has rested gets previews.
    drag.pose(4, &posed(4)).await;
    assert_eq!(drag.text().await["full"], false);
}

#[tokio::test]
async fn a_width_beyond_the_picture_is_kept() {
    let server = Server::start(&[]).await;
    let id = server.session(&photo(128, 96), &rest()).await;
    let mut drag = DragClient::open(server.address, &id, "?width=200").await;
    drag.pose(0, &posed(1)).await;
    let (_, frame) = drag.frame().await;
    assert_eq!(decoded(&frame).width, 200);
    drag.ack(0).await;
    assert!(drag.next_within(Duration::from_millis(400)).await.is_none());
}

#[tokio::test]
async fn a_bad_message_is_a_problem_and_the_socket_stays_open() {
    let server = Server::start(&[]).await;
    let mut warp = rest();
    warp["folds"] = json!("reject");
    let id = server.session(&photo(128, 96), &warp).await;
    let mut drag = DragClient::open(server.address, &id, "").await;
    drag.socket_text("{").await;
    assert!(drag.problem("malformed_request").await.get("seq").is_none());
    drag.say(&json!({"seq": 3, "q": posed(1), "output": {}}))
        .await;
    drag.problem("unknown_field").await;
    drag.pose(4, &json!([[1, 2]])).await;
    assert_eq!(drag.problem("shape_mismatch").await["seq"], 4);
    drag.pose(5, &json!([[100, 24], [20, 20], [[90, 80], [30, 70]]]))
        .await;
    assert_eq!(drag.problem("folded").await["seq"], 5);
    drag.pose(5, &posed(1)).await;
    let grows = drag.problem("bad_value").await;
    assert_eq!(
        (&grows["seq"], &grows["pointer"]),
        (&json!(5), &json!("/seq"))
    );
    drag.ack(99).await;
    assert_eq!(drag.problem("bad_value").await["pointer"], "/ack");
    drag.socket_binary(vec![1, 2, 3]).await;
    drag.problem("malformed_request").await;
    drag.socket_binary(binary_pose(6, &[1.0; 7])).await;
    assert_eq!(drag.problem("shape_mismatch").await["seq"], 6);
    drag.socket_binary(binary_pose(
        7,
        &[1.0, 1.0, 1.0, f32::NAN, 1.0, 1.0, 1.0, 1.0],
    ))
    .await;
    let bad = drag.problem("not_finite").await;
    assert_eq!(
        (&bad["seq"], &bad["pointer"], &bad["handle"]),
        (&json!(7), &json!("/q/1"), &json!(1))
    );
    drag.pose(8, &posed(1)).await;
    assert_eq!(drag.frame().await.0, 8);
}

/// The message of a binary pose.
fn binary_pose(seq: u64, numbers: &[f32]) -> Vec<u8> {
    let numbers = numbers.iter().flat_map(|number| number.to_le_bytes());
    seq.to_le_bytes().into_iter().chain(numbers).collect()
}

#[tokio::test]
async fn a_binary_pose_gives_the_frame_of_the_same_numbers_as_text() {
    let server = Server::start(&[]).await;
    let id = server.session(&photo(128, 96), &rest()).await;
    let mut drag = DragClient::open(server.address, &id, "").await;
    drag.socket_binary(binary_pose(
        1,
        &[22.5, 20.0, 100.0, 24.25, 30.0, 72.0, 94.0, 80.0],
    ))
    .await;
    let (seq, frame) = drag.frame().await;
    let q = json!([[22.5, 20], [100, 24.25], [[30, 72], [94, 80]]]);
    assert_eq!(seq, 1);
    assert!(frame == requested(&server, &id, &q, &json!({})).await);
}

#[tokio::test]
async fn automatic_frames_are_pictures_and_the_last_one_is_full() {
    let server = Server::start(&[]).await;
    let id = server.session(&photo(128, 96), &rest()).await;
    for (query, width) in [
        ("?frames=auto&report=true", 128),
        ("?frames=auto&width=64&report=true", 64),
    ] {
        let mut drag = DragClient::open(server.address, &id, query).await;
        drag.pose(1, &posed(3)).await;
        // The connection is not known yet.
        let report = drag.text().await;
        assert_eq!(
            (&report["format"], &report["width"], &report["full"]),
            (&json!("jpeg"), &json!(width), &json!(false)),
            "{query}"
        );
        let output = json!({"format": "jpeg", "quality": report["quality"], "width": width});
        let request = server
            .post(&format!("/sessions/{id}/warp"))
            .json(&json!({"q": posed(3), "output": output}));
        assert!(
            drag.frame().await.1 == request.send().await.unwrap().bytes().await.unwrap(),
            "{query}"
        );
        drag.ack(1).await;
        // The pointer rests. How fast the connection seems depends on when this thread has
        // acknowledged; which format follows from that is a law of the simulation.
        let report = drag.text().await;
        assert_eq!(
            (&report["width"], &report["full"]),
            (&json!(128), &json!(true)),
            "{query}"
        );
        assert_eq!(report.get("quality").is_none(), report["format"] == "png");
        let output = json!({"format": report["format"], "quality": report["quality"]});
        let (seq, frame) = drag.frame().await;
        assert!(
            seq == 1 && frame == requested(&server, &id, &posed(3), &output).await,
            "{query}"
        );
        drag.ack(1).await;
        assert!(
            drag.next_within(Duration::from_millis(400)).await.is_none(),
            "{query}"
        );
    }
}

#[tokio::test]
async fn as_many_frames_are_unacknowledged_as_the_window_says() {
    let server = Server::start(&[]).await;
    let id = server.session(&photo(128, 96), &rest()).await;
    for (query, window) in [
        ("?window=1", 1),
        ("?window=auto", 1),
        ("", 1),
        ("?window=3", 3),
        ("?window=8&frames=mesh", 8),
    ] {
        let mut drag = DragClient::open(server.address, &id, query).await;
        for seq in 0..window {
            drag.pose(seq, &posed(seq)).await;
            assert_eq!(drag.frame().await.0, seq, "{query}");
        }
        drag.pose(100, &posed(1)).await;
        assert!(
            drag.next_within(Duration::from_millis(200)).await.is_none(),
            "{query}"
        );
        // The newest frame acknowledges all.
        drag.ack(window - 1).await;
        assert_eq!(drag.frame().await.0, 100);
        drag.ack(101).await;
        drag.problem("bad_value").await;
        for seq in [0, 50, 100, 100, 0] {
            drag.ack(seq).await;
        }
        drag.pose(200, &posed(2)).await;
        assert_eq!(drag.frame().await.0, 200, "{query}");
    }
}

#[tokio::test]
async fn what_is_wrong_with_the_request_is_told_before_the_upgrade() {
    let server = Server::start(&["--max-sockets", "1"]).await;
    let id = server
        .session(&photo(16, 12), &json!({"p": [[2, 2]]}))
        .await;
    let path = format!("/sessions/{id}/drag");
    let plain = server.get(&path).send().await.unwrap();
    assert_eq!(header(&plain, "upgrade"), "websocket");
    problem(plain, 426, "upgrade_required").await;
    let ask = |path: &str, origin: Option<&str>| {
        let mut request = server
            .get(path)
            .header(CONNECTION, "keep-alive, Upgrade")
            .header(UPGRADE, "websocket");
        request = request
            .header(SEC_WEBSOCKET_VERSION, "13")
            .header(SEC_WEBSOCKET_KEY, "dGhlIHNhbXBsZSBub25jZQ==");
        if let Some(origin) = origin {
            request = request.header(ORIGIN, origin);
        }
        request.send()
    };
    let old = server
        .get(&path)
        .header(CONNECTION, "upgrade")
        .header(UPGRADE, "websocket")
        .header(SEC_WEBSOCKET_VERSION, "8");
    problem(old.send().await.unwrap(), 426, "upgrade_required").await;
    let keyless = server
        .get(&path)
        .header(CONNECTION, "upgrade")
        .header(UPGRADE, "websocket")
        .header(SEC_WEBSOCKET_VERSION, "13");
    problem(keyless.send().await.unwrap(), 400, "malformed_request").await;
    let upgrade = |method: Method, key: &str| {
        let request = server
            .client
            .request(method, server.url(&path))
            .header(CONNECTION, "upgrade")
            .header(UPGRADE, "websocket");
        request
            .header(SEC_WEBSOCKET_VERSION, "13")
            .header(SEC_WEBSOCKET_KEY, key)
    };
    for method in [Method::HEAD, Method::POST, Method::PUT] {
        let other = upgrade(method.clone(), "dGhlIHNhbXBsZSBub25jZQ==")
            .send()
            .await
            .unwrap();
        assert_eq!(
            (other.status().as_u16(), header(&other, "allow")),
            (405, "GET"),
            "{method}"
        );
    }
    // Not base64; base64 of 18 and of 17 bytes; without its end; with bits beyond the 16 bytes.
    for key in [
        "!!!!!!!!!!!!!!!!!!!!!!!!",
        "AAAAAAAAAAAAAAAAAAAAAAAA",
        "AAAAAAAAAAAAAAAAAAAAAAA=",
        "dGhlIHNhbXBsZSBub25jZQ",
        "dGhlIHNhbXBsZSBub25jZR==",
        "",
    ] {
        problem(
            upgrade(Method::GET, key).send().await.unwrap(),
            400,
            "malformed_request",
        )
        .await;
    }
    let usual = || upgrade(Method::GET, "dGhlIHNhbXBsZSBub25jZQ==");
    problem(
        usual()
            .header(SEC_WEBSOCKET_KEY, "dGhlIHNhbXBsZSBub25jZQ==")
            .send()
            .await
            .unwrap(),
        400,
        "malformed_request",
    )
    .await;
    problem(
        usual().body("body").send().await.unwrap(),
        400,
        "malformed_request",
    )
    .await;
    let chunks = futures_util::stream::iter([Ok::<_, std::io::Error>("body")]);
    let chunked = usual()
        .header(TRANSFER_ENCODING, "chunked")
        .body(reqwest::Body::wrap_stream(chunks));
    problem(chunked.send().await.unwrap(), 400, "malformed_request").await;
    problem(
        ask(&format!("{path}?frames=gif"), None).await.unwrap(),
        422,
        "bad_value",
    )
    .await;
    problem(
        ask(&format!("{path}?frame=png"), None).await.unwrap(),
        422,
        "unknown_field",
    )
    .await;
    problem(
        ask(&path, Some("https://elsewhere.example")).await.unwrap(),
        403,
        "forbidden",
    )
    .await;
    problem(
        ask("/sessions/00000000-0000-4000-8000-000000000000/drag", None)
            .await
            .unwrap(),
        404,
        "no_such_session",
    )
    .await;
    let same = ask(&path, Some(&format!("http://{}", server.address)))
        .await
        .unwrap();
    assert_eq!(same.status(), 101);
    assert_eq!(
        header(&same, "sec-websocket-accept"),
        "s3pPLMBiTxaQ9kYGzzhZRbK+xOo="
    );
    let full = ask(&path, None).await.unwrap();
    assert!(header(&full, "retry-after").parse::<u32>().unwrap() >= 1);
    problem(full, 503, "overloaded").await;
    drop(same);
    eventually("the seat is free again", || {
        server.app.counters().sockets_open == 0
    })
    .await;
    let host = server
        .get(&path)
        .header(HOST, "localhost")
        .send()
        .await
        .unwrap();
    problem(host, 426, "upgrade_required").await;
}

#[tokio::test]
async fn a_session_that_is_deleted_ends_its_sockets_with_a_reason() {
    let server = Server::start(&["--socket-idle", "300ms"]).await;
    let id = server.session(&photo(128, 96), &rest()).await;
    let mut moving = DragClient::open(server.address, &id, "").await;
    let mut resting = DragClient::open(server.address, &id, "").await;
    moving.pose(1, &posed(1)).await;
    moving.frame().await;
    moving.ack(1).await;
    assert_eq!(
        server
            .client
            .delete(server.url(&format!("/sessions/{id}")))
            .send()
            .await
            .unwrap()
            .status(),
        204
    );
    moving.pose(2, &posed(2)).await;
    assert_eq!(moving.problem("no_such_session").await["seq"], 2);
    assert_eq!(moving.closed().await, 1000);
    resting.problem("no_such_session").await;
    assert_eq!(resting.closed().await, 1000);
    eventually("no seat is taken", || {
        server.app.counters().sockets_open == 0
    })
    .await;
}

#[tokio::test]
async fn a_client_that_leaves_during_a_frame_ends_the_work() {
    let server = Server::start(&["--workers", "1"]).await;
    let mut warp = rest();
    warp["output"] = json!({"compression": "best"});
    let id = server.session(&photo(3000, 2000), &warp).await;
    let mut drag = DragClient::open(server.address, &id, "?width=3000").await;
    drag.pose(1, &posed(1)).await;
    eventually("the frame is being drawn", || {
        server.app.counters().pictures_begun == 1
    })
    .await;
    drop(drag);
    eventually("the work ends", || {
        server.app.counters().pictures_abandoned == 1 && server.app.pool().running() == 0
    })
    .await;
    assert_eq!(server.app.counters().frames_sent, 0);
    eventually("the seat is free", || {
        server.app.counters().sockets_open == 0
    })
    .await;
    server.is_well().await;
}

#[tokio::test]
async fn a_full_queue_delays_frames_and_loses_none() {
    let server = Server::start(&["--workers", "1", "--queue", "0"]).await;
    let id = server.session(&photo(128, 96), &rest()).await;
    let mut drag = DragClient::open(server.address, &id, "").await;
    eventually("nothing runs", || {
        server.app.pool().running() == 0 && !server.app.pool().is_full(WorkClass::Drag)
    })
    .await;
    let ticket = server
        .app
        .pool()
        .admit(WorkClass::Drag, QueueKey::client(this_client()))
        .await
        .unwrap();
    drag.pose(1, &posed(1)).await;
    assert!(drag.next_within(Duration::from_millis(100)).await.is_none());
    drag.pose(2, &posed(2)).await;
    assert!(
        drag.next_within(Duration::from_millis(100)).await.is_none(),
        "no complaint: the drag cannot help it"
    );
    drop(ticket);
    assert_eq!(drag.frame().await.0, 2);
}

#[tokio::test]
async fn a_stopping_server_closes_its_sockets_and_is_not_held_up() {
    let program = Program::start(&["--log-format", "json"]);
    let url = format!("http://{}/sessions", program.address);
    let upload = reqwest::Client::new()
        .post(url)
        .multipart(form(&photo(128, 96), rest().to_string()));
    let session: Value = upload.send().await.unwrap().json().await.unwrap();
    let id = session["id"].as_str().unwrap();
    let mut dragging = DragClient::open(program.address, id, "").await;
    // This one will not even read the close.
    let mut deaf = DragClient::open(program.address, id, "").await;
    deaf.pose(1, &posed(1)).await;
    dragging.pose(1, &posed(1)).await;
    assert_eq!(dragging.frame().await.0, 1);
    program.terminate();
    assert_eq!(dragging.closed().await, 1012);
    let began = std::time::Instant::now();
    let (status, log) = tokio::task::spawn_blocking(move || program.wait())
        .await
        .unwrap();
    assert_eq!(status.code(), Some(0), "{log}");
    assert!(
        began.elapsed() < Duration::from_secs(15),
        "sockets hold up a stop for a second, not for the grace period"
    );
    assert!(log.contains("drag ended") && log.contains("1012"), "{log}");
    drop(deaf);
}

#[tokio::test]
async fn eight_clients_of_one_session_see_their_own_poses() {
    let server = Server::start(&[]).await;
    let id = server.session(&photo(128, 96), &rest()).await;
    let clients = (0..8_u64).map(|n| {
        let (server, id) = (&server, &id);
        async move {
            let mut drag = DragClient::open(server.address, id, "").await;
            for seq in 0..20 {
                drag.pose(seq, &posed(20 * n + seq)).await;
                let (of, frame) = drag.frame().await;
                assert_eq!(of, seq);
                assert!(
                    frame == requested(server, id, &posed(20 * n + seq), &json!({})).await,
                    "drag {n}"
                );
                drag.ack(seq).await;
            }
        }
    });
    futures_util::future::join_all(clients).await;
    // Poses of sockets are numbered by themselves: the session has seen none.
    let session: Value = server
        .get(&format!("/sessions/{id}"))
        .send()
        .await
        .unwrap()
        .json()
        .await
        .unwrap();
    assert_eq!(session["seq"], Value::Null);
}

#[tokio::test]
async fn a_drag_keeps_its_session_alive() {
    let server = Server::start(&["--session-idle", "4s"]).await;
    let id = server.session(&photo(128, 96), &rest()).await;
    let mut drag = DragClient::open(server.address, &id, "").await;
    for seq in 0..12 {
        tokio::time::sleep(Duration::from_millis(400)).await;
        drag.pose(seq, &posed(seq)).await;
        assert!(matches!(drag.next().await, Received::Frame(..)));
        drag.ack(seq).await;
    }
    assert_eq!(
        server
            .get(&format!("/sessions/{id}"))
            .send()
            .await
            .unwrap()
            .status(),
        200
    );
}
