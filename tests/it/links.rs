//! The drag socket over slow and distant links: every frame is that of its own pose, frames go
//! forward, and the last pose is shown, whatever the link does meanwhile. How fast that is,
//! `cargo bench --bench drag -- links` tells.

use std::time::{Duration, Instant};

use futures_util::future::join_all;
use serde_json::{Value, json};

#[path = "../link/relay.rs"]
mod relay;

use crate::support::drag_client::Received;
use crate::support::{DragClient, Server, photo};
use relay::{Link, Relay};

/// The picture is narrower than any preview: all of its frames are of full size.
const SIZE: (u32, u32) = (128, 96);
const PERIOD: Duration = Duration::from_millis(8);
/// Without a frame for this time, nothing more comes: it is longer than the wait for rest, a round
/// trip and the largest frame together.
const SILENCE: Duration = Duration::from_millis(900);

/// What sockets send.
const FRAMES: [&str; 5] = [
    "frames=png",
    "frames=jpeg&window=1",
    "frames=jpeg&window=8",
    "frames=mesh",
    "frames=auto",
];

/// A frame with its report.
struct Frame {
    seq: u64,
    bytes: Vec<u8>,
    report: Value,
}

fn posed(seq: u64) -> Value {
    #[expect(clippy::cast_precision_loss, reason = "a small number")]
    let angle = seq as f64 / 9.0;
    json!([
        [20.0 + 7.0 * angle.cos(), 20.0 + 5.0 * angle.sin()],
        [100, 24],
        [[30, 70], [90, 80]]
    ])
}

/// Drags `poses` poses over the link for each kind of frames at once, changes the link before one
/// of them, and checks what comes. Returns the poses that each saw.
async fn drag(link: Link, poses: u64, changed: u64, change: impl Fn(&Relay)) -> Vec<Vec<u64>> {
    let server = Server::start(&[]).await;
    let id = &server
        .session(
            &photo(SIZE.0, SIZE.1),
            &json!({"p": [[20, 20], [100, 24], [[30, 70], [90, 80]]]}),
        )
        .await;
    let (server, change) = (&server, &change);
    join_all(FRAMES.map(|query| async move {
        let relay = Relay::start(server.address, link, link).unwrap();
        let mut client =
            DragClient::open(relay.address, id, &format!("?{query}&report=true")).await;
        let (mut frames, mut report, start) = (Vec::new(), Value::Null, Instant::now());
        for seq in 0..poses {
            if seq == changed {
                change(&relay);
            }
            client.pose(seq, &posed(seq)).await;
            let due = start + PERIOD * (seq as u32 + 1);
            while let Some(received) = client
                .next_within(due.saturating_duration_since(Instant::now()))
                .await
            {
                keep(&mut client, received, &mut report, &mut frames).await;
            }
        }
        while frames
            .last()
            .is_none_or(|frame: &Frame| frame.seq != poses - 1)
        {
            let received = client.next().await;
            keep(&mut client, received, &mut report, &mut frames).await;
        }
        while let Some(received) = client.next_within(SILENCE).await {
            keep(&mut client, received, &mut report, &mut frames).await;
        }
        let last = frames.last().unwrap();
        assert!(
            last.seq == poses - 1 && last.report["full"] == true,
            "{query}: {}",
            last.report
        );
        assert!(
            frames.is_sorted_by(|a, b| a.seq < b.seq || a.seq == b.seq && b.report["full"] == true),
            "{query}: frames go forward"
        );
        for frame in &frames {
            assert!(
                frame.bytes == requested(server, id, frame).await,
                "{query}: another pose than {}",
                frame.report
            );
        }
        frames.iter().map(|frame| frame.seq).collect()
    }))
    .await
}

/// The bytes of the request that a frame stands for.
async fn requested(server: &Server, id: &str, frame: &Frame) -> Vec<u8> {
    let (q, report) = (posed(frame.seq), &frame.report);
    let request = if report["format"] == "mesh" {
        server
            .post(&format!("/sessions/{id}/mesh"))
            .json(&json!({"q": q}))
            .header("accept", "application/octet-stream")
    } else {
        let output = json!({"format": report["format"], "quality": report["quality"],
            "width": report["width"]});
        server
            .post(&format!("/sessions/{id}/warp"))
            .json(&json!({"q": q, "output": output}))
    };
    request
        .send()
        .await
        .unwrap()
        .bytes()
        .await
        .unwrap()
        .to_vec()
}

/// Keeps a frame, which follows its report, and acknowledges it.
async fn keep(
    client: &mut DragClient,
    received: Received,
    report: &mut Value,
    frames: &mut Vec<Frame>,
) {
    match received {
        Received::Text(text) => *report = text,
        Received::Frame(seq, bytes) => {
            assert_eq!(report["seq"], seq, "the report comes before its frame");
            frames.push(Frame {
                seq,
                bytes,
                report: report.take(),
            });
            client.ack(seq).await;
        }
        Received::Closed(code) => panic!("closed: {code}"),
    }
}

#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn links_that_are_slow_and_distant_show_the_newest_pose() {
    for frames in drag(Link::new(5, 25), 60, u64::MAX, |_| {}).await {
        assert!(frames.len() > 1, "{frames:?}");
    }
}

#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn links_that_pass_nothing_for_a_second_lose_no_last_pose() {
    // The server draws at most what is unacknowledged, and a few of the poses that arrive together
    // after the pause.
    for frames in drag(Link::new(5, 25), 100, 20, |relay| {
        relay.pause(Duration::from_secs(1))
    })
    .await
    {
        assert!(
            frames.len() < 50,
            "poses that have waited are not drawn one by one: {frames:?}"
        );
    }
}

#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn links_whose_rate_halves_during_a_drag_show_the_last_pose() {
    let halve = |relay: &Relay| {
        let half = Link::new(2, 25).rate / 2;
        relay.up.set_rate(half);
        relay.down.set_rate(half);
    };
    for frames in drag(Link::new(2, 25), 100, 50, halve).await {
        assert!(frames.len() > 1, "{frames:?}");
    }
}
