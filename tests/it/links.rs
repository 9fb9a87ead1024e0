//! The drag socket over slow and distant links: every frame is that of its own pose, frames go forward, and the last pose is shown,
//! whatever the link does meanwhile. How fast that is, `cargo bench --bench drag -- links` tells.

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
/// Without a frame for this time, nothing more comes: longer than the wait for rest and a round trip.
const SILENCE: Duration = Duration::from_millis(400);

/// What a socket sends, and the request with the same bytes.
const FRAMES: [(&str, &str, Option<&str>); 3] =
    [("?frames=png", "warp", Some("png")), ("?frames=jpeg", "warp", Some("jpeg")), ("?frames=mesh", "mesh", None)];

fn posed(seq: u64) -> Value {
    #[expect(clippy::cast_precision_loss, reason = "a small number")]
    let angle = seq as f64 / 9.0;
    json!([[20.0 + 7.0 * angle.cos(), 20.0 + 5.0 * angle.sin()], [100, 24], [[30, 70], [90, 80]]])
}

/// Drags `poses` poses over the link for each kind of frames at once, changes the link before one of them, and checks what comes. Returns
/// the poses that each saw.
async fn drag(link: Link, poses: u64, changed: u64, change: impl Fn(&Relay)) -> Vec<Vec<u64>> {
    let server = Server::start(&[]).await;
    let id = &server.session(&photo(SIZE.0, SIZE.1), &json!({"p": [[20, 20], [100, 24], [[30, 70], [90, 80]]]})).await;
    let (server, change) = (&server, &change);
    join_all(FRAMES.map(|(query, route, format)| async move {
        let relay = Relay::start(server.address, link, link).unwrap();
        let mut client = DragClient::open(relay.address, id, query).await;
        let (mut frames, start) = (Vec::new(), Instant::now());
        for seq in 0..poses {
            if seq == changed {
                change(&relay);
            }
            client.pose(seq, &posed(seq)).await;
            let due = start + PERIOD * (seq as u32 + 1);
            while let Some(received) = client.next_within(due.saturating_duration_since(Instant::now())).await {
                keep(&mut client, received, &mut frames).await;
            }
        }
        while frames.last().is_none_or(|(seq, _)| *seq != poses - 1) {
            let received = client.next().await;
            keep(&mut client, received, &mut frames).await;
        }
        assert!(client.next_within(SILENCE).await.is_none(), "{query}: the last frame is sent once");
        assert!(frames.is_sorted_by(|a, b| a.0 < b.0), "{query}: frames go forward");
        for (seq, frame) in &frames {
            let request = server.post(&format!("/sessions/{id}/{route}"));
            let request = match format {
                Some(format) => request.json(&json!({"q": posed(*seq), "output": {"format": format}})),
                None => request.json(&json!({"q": posed(*seq)})).header("accept", "application/octet-stream"),
            };
            assert!(*frame == request.send().await.unwrap().bytes().await.unwrap(), "{query}: frame {seq} is of another pose");
        }
        frames.into_iter().map(|(seq, _)| seq).collect()
    }))
    .await
}

async fn keep(client: &mut DragClient, received: Received, frames: &mut Vec<(u64, Vec<u8>)>) {
    let Received::Frame(seq, bytes) = received else { panic!("a frame was expected: {received:?}") };
    frames.push((seq, bytes));
    client.ack(seq).await;
}

#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn links_that_are_slow_and_distant_show_the_newest_pose() {
    for frames in drag(Link::new(5, 25), 60, u64::MAX, |_| {}).await {
        assert!(frames.len() > 1, "{frames:?}");
    }
}

#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn links_that_pass_nothing_for_a_second_lose_no_last_pose() {
    // The server draws at most what is unacknowledged, and a few of the poses that arrive together after the pause.
    for frames in drag(Link::new(5, 25), 100, 20, |relay| relay.pause(Duration::from_secs(1))).await {
        assert!(frames.len() < 50, "poses that have waited are not drawn one by one: {frames:?}");
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
