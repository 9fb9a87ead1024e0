//! The drag socket under clients that are hostile, slow, or not there any more: each is closed with
//! its reason, and nobody else notices.

use std::net::SocketAddr;
use std::time::{Duration, Instant};

use futures_util::SinkExt as _;
use serde_json::{Value, json};
use tokio::io::{AsyncReadExt as _, AsyncWriteExt as _};
use tokio::net::{TcpListener, TcpSocket, TcpStream};
use tokio_tungstenite::tungstenite::Message;
use tokio_tungstenite::tungstenite::protocol::frame::Frame;
use tokio_tungstenite::tungstenite::protocol::frame::coding::{Data, OpCode};

use crate::support::counters::Counted as _;
use crate::support::drag_client::Received;
use crate::support::program::Program;
use crate::support::server::form;
use crate::support::{DragClient, Server, eventually, photo};

fn rest() -> Value {
    json!({"p": [[20, 20], [100, 24]]})
}

fn posed(n: u64) -> Value {
    json!([[20 + n % 9, 20 + n % 7], [100, 24]])
}

/// A client that must get every frame, whatever the others do.
async fn healthy(address: SocketAddr, id: String, frames: u64) {
    let mut drag = DragClient::open(address, &id, "").await;
    for seq in 0..frames {
        drag.pose(seq, &posed(seq)).await;
        assert_eq!(drag.frame().await.0, seq);
        drag.ack(seq).await;
    }
}

#[tokio::test(flavor = "multi_thread", worker_threads = 4)]
async fn a_message_that_is_too_large_closes_its_socket_alone() {
    let server = Server::start(&[]).await;
    let id = server.session(&photo(128, 96), &rest()).await;
    let well = tokio::spawn(healthy(server.address, id.clone(), 100));
    for size in [(64 << 10) + 2 * 64 + 1, 1 << 20] {
        let mut drag = DragClient::open(server.address, &id, "").await;
        // The server may close before all of it is written.
        let _ = drag.socket.send(Message::text("x".repeat(size))).await;
        assert_eq!(drag.closed().await, 1009, "{size}");
    }
    let mut drag = DragClient::open(server.address, &id, "").await;
    drag.socket_text(&" ".repeat((64 << 10) + 2 * 64)).await;
    drag.problem("malformed_request").await;
    well.await.unwrap();
}

#[tokio::test(flavor = "multi_thread", worker_threads = 4)]
async fn a_flood_closes_its_socket_alone() {
    let server = Server::start(&[]).await;
    let id = server.session(&photo(128, 96), &rest()).await;
    let well = tokio::spawn(healthy(server.address, id.clone(), 200));
    let mut drag = DragClient::open(server.address, &id, "").await;
    for seq in 0..10_000 {
        if drag
            .socket
            .feed(Message::text(
                json!({"seq": seq, "q": posed(seq)}).to_string(),
            ))
            .await
            .is_err()
        {
            break;
        }
    }
    let _ = drag.socket.flush().await;
    assert_eq!(drag.closed().await, 1008);
    // So do problems that nobody reads.
    let mut drag = DragClient::open(server.address, &id, "").await;
    for _ in 0..10_000 {
        if drag.socket.send(Message::text("{")).await.is_err() {
            break;
        }
    }
    assert_eq!(drag.closed().await, 1008);
    well.await.unwrap();
    eventually("no seat is taken", || {
        server.app.counters().sockets_open == 0
    })
    .await;
}

/// Empty fragments count towards the limit of their message, wherever control frames stand between
/// them.
#[tokio::test(flavor = "multi_thread", worker_threads = 4)]
async fn empty_fragments_close_their_socket_alone() {
    const MAX_MESSAGES: usize = 100_000;
    let server = Server::start(&[]).await;
    let id = server.session(&photo(128, 96), &rest()).await;
    let well = tokio::spawn(healthy(server.address, id.clone(), 100));
    let fragment =
        |opcode: u8, is_last: bool| [opcode | if is_last { 0x80 } else { 0 }, 0x80, 1, 2, 3, 4];
    for ping_each in [usize::MAX, 100] {
        let (mut read, mut write) = upgraded(server.address, &id).await.into_split();
        let reading = tokio::spawn(async move {
            let mut said = Vec::new();
            let _ = tokio::time::timeout(Duration::from_secs(60), read.read_to_end(&mut said))
                .await
                .expect("the server does not close");
            said
        });
        let mut sent = 0;
        let mut next = fragment(1, false);
        while sent < MAX_MESSAGES && !reading.is_finished() && write.write_all(&next).await.is_ok()
        {
            sent += 1;
            next = if sent % ping_each == 0 {
                fragment(9, true)
            } else {
                fragment(0, false)
            };
            // Time to read them, and to close.
            if sent % 1000 == 0 {
                tokio::time::sleep(Duration::from_millis(5)).await;
            }
        }
        println!("one ping in {ping_each} frames: closed after at most {sent} frames of 6 bytes");
        assert!(sent < MAX_MESSAGES, "all of {sent} fragments were taken");
        let said = reading.await.unwrap();
        assert!(
            said.windows(4)
                .any(|bytes| bytes[0] == 0x88 && bytes[2..4] == 1009_u16.to_be_bytes()),
            "closed as too large"
        );
    }
    // A message of some hundred fragments is one, and so is the next.
    let mut drag = DragClient::open(server.address, &id, "").await;
    for seq in 0..3 {
        let text = json!({"seq": seq, "q": posed(seq)}).to_string();
        let pieces: Vec<&[u8]> = text.as_bytes().chunks(1).collect();
        for (n, piece) in pieces.iter().enumerate() {
            let opcode = if n == 0 { Data::Text } else { Data::Continue };
            let fragment =
                Frame::message(piece.to_vec(), OpCode::Data(opcode), n + 1 == pieces.len());
            drag.socket.feed(Message::Frame(fragment)).await.unwrap();
            drag.socket
                .feed(Message::Ping(vec![].into()))
                .await
                .unwrap();
        }
        drag.socket.flush().await.unwrap();
        drag.ack_of_next_frame(seq).await;
    }
    well.await.unwrap();
}

/// Pings and empty messages are messages too: more of them a second than a drag sends close the
/// socket.
#[tokio::test(flavor = "multi_thread", worker_threads = 4)]
async fn floods_of_pings_and_of_empty_messages_close_their_socket() {
    let server = Server::start(&[]).await;
    let id = server.session(&photo(128, 96), &rest()).await;
    for message in [
        Message::Ping(vec![7; 125].into()),
        Message::Pong(vec![].into()),
        Message::text(""),
    ] {
        let mut drag = DragClient::open(server.address, &id, "").await;
        for _ in 0..10_000 {
            if drag.socket.feed(message.clone()).await.is_err() {
                break;
            }
        }
        let _ = drag.socket.flush().await;
        assert_eq!(drag.closed().await, 1008, "{message:?}");
    }
}

#[tokio::test]
async fn a_drag_at_five_hundred_hertz_is_no_flood() {
    let server = Server::start(&[]).await;
    let id = server.session(&photo(64, 48), &rest()).await;
    let mut drag = DragClient::open(server.address, &id, "?frames=mesh").await;
    let began = Instant::now();
    let mut shown = 0;
    for seq in 0..1500 {
        tokio::time::sleep_until((began + Duration::from_millis(2 * seq)).into()).await;
        drag.pose(seq, &posed(seq)).await;
        while let Some(Received::Frame(of, _)) = drag.next_within(Duration::ZERO).await {
            drag.ack(of).await;
            shown = of;
        }
    }
    while shown < 1499 {
        shown = drag.frame().await.0;
        drag.ack(shown).await;
    }
}

/// A connection on which the handshake was sent.
async fn upgraded(address: SocketAddr, id: &str) -> TcpStream {
    let mut stream = TcpStream::connect(address).await.unwrap();
    let head = format!(
        "GET /sessions/{id}/drag HTTP/1.1\r\nHost: localhost\r\nConnection: Upgrade\r\nUpgrade: \
            websocket\r\nSec-WebSocket-Version: 13\r\n\
         Sec-WebSocket-Key: dGhlIHNhbXBsZSBub25jZQ==\r\n\r\n"
    );
    stream.write_all(head.as_bytes()).await.unwrap();
    stream
}

#[tokio::test]
async fn a_peer_that_answers_no_ping_is_closed_and_one_that_does_is_kept() {
    let server = Server::start(&["--socket-idle", "400ms"]).await;
    let id = server.session(&photo(64, 48), &rest()).await;
    let mut alive = DragClient::open(server.address, &id, "").await;
    // The handshake, and then nothing, not even an answer to a ping.
    let mut half_open = upgraded(server.address, &id).await;
    eventually("both sit", || server.app.counters().sockets_open == 2).await;
    let listening = tokio::spawn(async move {
        // Reading answers pings.
        assert!(alive.next_within(Duration::from_secs(3)).await.is_none());
        alive
    });
    eventually("the silent one is closed", || {
        server.app.counters().sockets_open == 1
    })
    .await;
    let mut rest = Vec::new();
    let _ = half_open.read_to_end(&mut rest).await;
    // A close frame with 1008 was the last that it was sent.
    assert!(
        rest.windows(4)
            .any(|bytes| bytes[0] == 0x88 && bytes[2..4] == 1008_u16.to_be_bytes()),
        "{rest:?}"
    );
    let mut alive = listening.await.unwrap();
    alive.pose(1, &posed(1)).await;
    assert_eq!(alive.frame().await.0, 1);
}

#[tokio::test]
async fn a_frame_that_is_never_acknowledged_closes_the_socket() {
    let server = Server::start(&["--socket-timeout", "500ms"]).await;
    let id = server.session(&photo(64, 48), &rest()).await;
    let mut drag = DragClient::open(server.address, &id, "").await;
    drag.pose(1, &posed(1)).await;
    assert_eq!(drag.frame().await.0, 1);
    assert_eq!(drag.closed().await, 1008);
}

/// A way to the server that lets `bytes_a_second` of the answers through, with small buffers.
async fn narrow_way(to: SocketAddr, bytes_a_second: usize) -> SocketAddr {
    let listener = TcpListener::bind("127.0.0.1:0").await.unwrap();
    let address = listener.local_addr().unwrap();
    tokio::spawn(async move {
        let (client, _) = listener.accept().await.unwrap();
        let socket = TcpSocket::new_v4().unwrap();
        socket.set_recv_buffer_size(8 << 10).unwrap();
        let server = socket.connect(to).await.unwrap();
        let (mut from_client, mut to_client) = client.into_split();
        let (mut from_server, mut to_server) = server.into_split();
        tokio::spawn(async move { tokio::io::copy(&mut from_client, &mut to_server).await });
        let mut bytes = vec![0; bytes_a_second / 50];
        while let Ok(read @ 1..) = from_server.read(&mut bytes).await {
            if to_client.write_all(&bytes[..read]).await.is_err() {
                break;
            }
            tokio::time::sleep(Duration::from_millis(20)).await;
        }
    });
    address
}

#[tokio::test(flavor = "multi_thread", worker_threads = 4)]
async fn a_slow_reader_holds_two_frames_and_sees_the_newest() {
    let server = Server::start(&[]).await;
    let id = server.session(&photo(700, 500), &rest()).await;
    let well = tokio::spawn(healthy(
        server.address,
        server.session(&photo(128, 96), &rest()).await,
        200,
    ));
    // 1 Mbit/s.
    let way = narrow_way(server.address, 125_000).await;
    let mut drag = DragClient::open(way, &id, "").await;
    let began = Instant::now();
    let mut shown = Vec::new();
    for seq in 0..1000 {
        tokio::time::sleep_until((began + Duration::from_millis(8 * seq)).into()).await;
        drag.pose(seq, &posed(seq)).await;
        while let Some(said) = drag.next_within(Duration::ZERO).await {
            let Received::Frame(of, frame) = said else {
                panic!("{said:?}")
            };
            drag.ack(of).await;
            shown.push((of, frame.len()));
        }
        let counters = server.app.counters();
        // What the healthy one gets is counted too, but never more than is shown.
        assert!(counters.pictures_finished <= counters.frames_sent + counters.poses_superseded + 2);
    }
    while shown.last().is_none_or(|(of, _)| *of < 999) {
        let (of, frame) = drag.frame().await;
        drag.ack(of).await;
        shown.push((of, frame.len()));
    }
    let first = shown[0].1;
    println!(
        "1 Mbit/s, 8 s at 125 Hz, 700 x 500: {} frames of {first} bytes at first, {} at last",
        shown.len(),
        shown.last().unwrap().1
    );
    assert!(shown.is_sorted_by(|a, b| a.0 <= b.0));
    assert!(
        shown.iter().any(|(_, bytes)| 2 * bytes < first),
        "the preview became narrower"
    );
    well.await.unwrap();
}

#[tokio::test(flavor = "multi_thread", worker_threads = 4)]
async fn two_hundred_sockets_that_take_nothing_are_bounded_in_memory() {
    // Nobody is closed for taking nothing and saying nothing while the others come.
    let program = Program::start(&[
        "--socket-timeout",
        "10m",
        "--socket-idle",
        "10m",
        "--max-client-share",
        "100",
    ]);
    let http = reqwest::Client::new();
    let session = async |picture: Vec<u8>| {
        let url = format!("http://{}/sessions", program.address);
        let session: Value = http
            .post(url)
            .multipart(form(&picture, rest().to_string()))
            .send()
            .await
            .unwrap()
            .json()
            .await
            .unwrap();
        session["id"].as_str().unwrap().to_owned()
    };
    let mut ids = Vec::new();
    for _ in 0..10 {
        ids.push(session(photo(512, 512)).await);
    }
    let small = session(photo(128, 96)).await;
    healthy(program.address, small.clone(), 20).await;
    let before = program.resident();
    let mut clients = Vec::new();
    for n in 0..200 {
        let mut drag = DragClient::open(program.address, &ids[n % ids.len()], "?width=512").await;
        for seq in 0..20 {
            drag.pose(seq, &posed(seq)).await;
        }
        clients.push(drag);
    }
    // One frame is under way to each and one is ahead; none is acknowledged.
    let mut largest = 0;
    for drag in &mut clients {
        largest = largest.max(drag.frame().await.1.len());
    }
    healthy(program.address, small, 100).await;
    let during = program.resident();
    println!(
        "200 sockets, each with a frame ahead of {} KiB: {before} MiB before, {during} MiB during",
        largest >> 10
    );
    let frames = (2 * 200 * largest as u64) >> 20;
    assert!(
        during <= before + frames + 200 / 4 + 64,
        "{before} MiB before, {during} MiB during; frames are {frames} MiB"
    );
    drop(clients);
}
