//! Floods of HTTP/2 frames against the program: the connection is closed or slowed down, memory
//! stays bounded, and an innocent client gets every answer. How fast it gets them is printed beside
//! how fast it gets them without the flood (`--nocapture`), not asserted.

use std::time::{Duration, Instant};

use tokio::io::AsyncWriteExt as _;
use tokio::net::TcpSocket;

use crate::support::healthy::{Healthy, ms};
use crate::support::http2::{
    ACK, CONTINUATION, DATA, END_HEADERS, Frames, GET, GOAWAY, HEADERS, PING, POST, RST_STREAM,
    SETTINGS, WINDOW_UPDATE, block, frame,
};
use crate::support::program::Program;

/// Frames in a batch, which is written at once.
const BATCH: u32 = 200;
/// Batches of a flood that is read to its end, and of one that is not.
const BATCHES: u32 = 200;
const TOO_MANY: u32 = 20;
/// Connections on which a flood is repeated.
const CONNECTIONS: usize = 20;
/// What the program may grow by, MiB.
const GROWTH: u64 = 64;
/// The ping that ends a flood: when it is answered, everything before it was read.
const LAST: &[u8; 8] = b"the last";
/// The error of a connection that is ended for its excess (RFC 9113, section 7).
const ENHANCE_YOUR_CALM: u32 = 0xb;

/// How a flood ended.
#[derive(Debug, PartialEq, Eq)]
enum End {
    /// The server ended the connection, with this error where it said one.
    Closed { error: Option<u32> },
    /// Everything was read; the number of pings and settings that were acknowledged.
    Read { acknowledged: u32 },
}

/// Sends `opening` and then `batches` batches, and reads what comes.
async fn flood(
    program: &Program,
    opening: &[u8],
    batches: u32,
    batch: &impl Fn(u32) -> Vec<u8>,
) -> End {
    let Frames {
        mut reader,
        mut write,
    } = Frames::open(program.address, 65535).await;
    let reading = tokio::spawn(async move {
        let (mut error, mut acknowledged) = (None, 0);
        while let Some(frame) = reader.next().await {
            match (frame.kind, frame.flags & ACK) {
                (GOAWAY, _) => {
                    error = Some(u32::from_be_bytes(frame.payload[4..8].try_into().unwrap()))
                }
                (PING, ACK) if frame.payload == LAST => return End::Read { acknowledged },
                (PING | SETTINGS, ACK) => acknowledged += 1,
                _ => {}
            }
        }
        End::Closed { error }
    });
    let _ = write.write_all(opening).await;
    let mut sent = 0;
    while sent < batches && !reading.is_finished() && write.write_all(&batch(sent)).await.is_ok() {
        sent += 1;
        tokio::time::sleep(Duration::from_millis(1)).await;
    }
    let _ = write.write_all(&frame(PING, 0, 0, LAST)).await;
    reading.await.unwrap()
}

/// Sends floods one after another, each of which must end its connection for its excess before it
/// is read to its end.
async fn ended(name: &str, opening: &[u8], batch: impl Fn(u32) -> Vec<u8>) {
    let calmed = endured(name, &[], async |program| {
        let mut calmed = 0;
        for _ in 0..CONNECTIONS {
            match flood(program, opening, TOO_MANY, &batch).await {
                End::Closed { error: Some(error) } if error == ENHANCE_YOUR_CALM => calmed += 1,
                // What is written to a connection that has ended may reset it, and take the reason
                // with it.
                End::Closed { error: None } => {}
                end => panic!("{name}: {end:?}"),
            }
        }
        calmed
    })
    .await;
    eprintln!(
        "{name}: {CONNECTIONS} connections were ended within {} frames each, {calmed} of them \
            with the reason",
        TOO_MANY * BATCH
    );
    assert!(calmed > 0, "{name}");
}

/// Runs a flood beside an innocent client, which must get every answer.
async fn endured<T>(name: &str, options: &[&str], attack: impl AsyncFnOnce(&Program) -> T) -> T {
    // Its own pings would be answered by nobody here.
    let program = Program::start(&[&["--header-timeout", "1m"], options].concat());
    let quiet = Healthy::begin(program.address).await;
    tokio::time::sleep(Duration::from_millis(300)).await;
    let bar = quiet.end("without a flood").await;
    let (memory, busy) = (program.resident(), program.busy());
    let innocent = Healthy::begin(program.address).await;
    let began = Instant::now();
    let ended = attack(&program).await;
    let took = began.elapsed();
    let p99 = innocent.end(name).await;
    let (grown, busy) = (
        program.resident().saturating_sub(memory),
        program.busy() - busy,
    );
    eprintln!(
        "{name}: the innocent client's p99 {:.1} ms (bar: {:.1} ms without the flood); \
         the program was busy for {:.2} s in {:.2} s and grew by {grown} MiB",
        ms(p99),
        ms(bar),
        busy.as_secs_f64(),
        took.as_secs_f64()
    );
    assert!(grown <= GROWTH, "{name}: it grew by {grown} MiB");
    ended
}

fn batch_of(frame: &[u8]) -> Vec<u8> {
    frame.repeat(BATCH as usize)
}

fn stream(number: u32) -> u32 {
    1 + 2 * number
}

fn head(stream: u32, method: u8, path: &str, flags: u8) -> Vec<u8> {
    frame(
        HEADERS,
        flags,
        stream,
        &block(
            method,
            path,
            "localhost",
            &[("content-type", "application/json")],
        ),
    )
}

/// Streams that are opened and reset at once (CVE-2023-44487).
#[tokio::test(flavor = "multi_thread", worker_threads = 4)]
async fn rapid_reset_ends_the_connection() {
    let cancel = 8_u32.to_be_bytes();
    let one = |number| {
        [
            head(stream(number), POST, "/points", END_HEADERS),
            frame(RST_STREAM, 0, stream(number), &cancel),
        ]
        .concat()
    };
    ended("rapid reset", &[], |n| {
        (n * BATCH..(n + 1) * BATCH).flat_map(one).collect()
    })
    .await;
}

/// A head that never ends (CVE-2024-27316): of empty frames, and of fields.
#[tokio::test(flavor = "multi_thread", worker_threads = 4)]
async fn continuation_floods_end_the_connection() {
    let field = [&[0x00, 1, b'x', 100][..], &[b'y'; 100]].concat();
    for (name, fragment) in [("empty CONTINUATION", vec![]), ("CONTINUATION", field)] {
        ended(name, &head(1, GET, "/", 0), |_| {
            batch_of(&frame(CONTINUATION, 0, 1, &fragment))
        })
        .await;
    }
}

/// Empty frames of bodies, on a stream whose body is read and on one whose body nobody wants.
#[tokio::test(flavor = "multi_thread", worker_threads = 4)]
async fn empty_data_frames_end_the_connection() {
    for (name, method, path) in [
        ("empty DATA", POST, "/points"),
        ("empty DATA, unwanted", GET, "/page/cat.jpg"),
    ] {
        ended(name, &head(1, method, path, END_HEADERS), |_| {
            batch_of(&frame(DATA, 0, 1, &[]))
        })
        .await;
    }
}

/// Pings, settings and windows are answered one by one to a client that reads the answers.
#[tokio::test(flavor = "multi_thread", worker_threads = 4)]
async fn pings_settings_and_windows_are_answered_one_by_one() {
    let settings = [&[0, 4][..], &65535_u32.to_be_bytes()].concat();
    for (name, one, acknowledged) in [
        ("PING", frame(PING, 0, 0, &[7; 8]), BATCH * BATCHES),
        (
            "SETTINGS",
            frame(SETTINGS, 0, 0, &settings),
            BATCH * BATCHES,
        ),
        (
            "WINDOW_UPDATE",
            frame(WINDOW_UPDATE, 0, 0, &1_u32.to_be_bytes()),
            0,
        ),
    ] {
        let end = endured(name, &[], async |program| {
            flood(program, &[], BATCHES, &|_| batch_of(&one)).await
        })
        .await;
        match end {
            // The settings of the opening are acknowledged too.
            End::Read { acknowledged: read } => assert_eq!(read, acknowledged + 1, "{name}"),
            End::Closed { error } => assert_eq!(error, Some(ENHANCE_YOUR_CALM), "{name}"),
        }
    }
}

/// A client that reads none of the answers is read no further, and its connection ends at the write
/// deadline.
#[tokio::test(flavor = "multi_thread", worker_threads = 4)]
async fn who_floods_and_reads_nothing_is_cut() {
    const MAX_REQUESTS: u32 = 10_000;
    for (name, one) in [
        ("PING, unread", frame(PING, 0, 0, &[7; 8])),
        ("SETTINGS, unread", frame(SETTINGS, 0, 0, &[])),
    ] {
        let sent = endured(name, &["--write-timeout", "1s"], async |program| {
            let socket = TcpSocket::new_v4().unwrap();
            socket.set_recv_buffer_size(4096).unwrap();
            let mut frames =
                Frames::over(socket.connect(program.address).await.unwrap(), 65535).await;
            let batch = batch_of(&one);
            let mut sent = 0;
            // The last write waits until the server closes, as the server reads nothing more.
            let writing = async {
                while sent < MAX_REQUESTS && frames.write.write_all(&batch).await.is_ok() {
                    sent += 1;
                }
            };
            tokio::time::timeout(Duration::from_secs(60), writing)
                .await
                .expect("the server neither reads nor closes");
            sent
        })
        .await;
        eprintln!("{name}: cut after at most {} frames", sent * BATCH);
        assert!(
            sent < MAX_REQUESTS,
            "{name}: all of {MAX_REQUESTS} batches were read"
        );
    }
}
