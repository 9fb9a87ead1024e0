//! Clients that are slow, silent or take nothing: each is closed or bounded at its deadline, and a
//! healthy client gets every answer meanwhile. How fast it gets them is printed (`--nocapture`),
//! not asserted.

use std::net::SocketAddr;
use std::process::Command;
use std::time::{Duration, Instant};

use serde_json::{Value, json};
use tokio::io::{AsyncReadExt as _, AsyncWriteExt as _};
use tokio::net::{TcpSocket, TcpStream};

use crate::support::healthy::{Healthy, ms};
use crate::support::http2::{DATA, Frames, GET, GOAWAY, HEADERS, POST, RST_STREAM, WINDOW_UPDATE};
use crate::support::program::Program;
use crate::support::server::form;
use crate::support::{Server, eventually, photo};

const HEADER: Duration = Duration::from_millis(600);
const BODY: Duration = Duration::from_millis(900);
const WRITE: Duration = Duration::from_millis(800);
const DEADLINES: [&str; 6] = [
    "--header-timeout",
    "600ms",
    "--body-timeout",
    "900ms",
    "--write-timeout",
    "800ms",
];

/// Reads until the server closes; how long that took, and what it had said.
async fn closed(
    mut stream: impl tokio::io::AsyncRead + Unpin,
    began: Instant,
) -> (Duration, Vec<u8>) {
    let mut said = Vec::new();
    let read = tokio::time::timeout(Duration::from_secs(60), stream.read_to_end(&mut said)).await;
    assert!(read.is_ok(), "the server does not close");
    (began.elapsed(), said)
}

fn in_time(took: Duration, deadline: Duration) {
    assert!(
        took >= deadline.mul_f64(0.9) && took < 10 * deadline,
        "{took:?}, where {deadline:?} are allowed"
    );
}

#[tokio::test(flavor = "multi_thread", worker_threads = 4)]
async fn silent_sockets_slow_heads_and_slow_bodies_end_at_their_deadlines() {
    let server = Server::start(&DEADLINES).await;
    let address = server.address;
    let well = Healthy::begin(address).await;
    let silent = (0..20).map(|_| {
        tokio::spawn(async move {
            closed(TcpStream::connect(address).await.unwrap(), Instant::now()).await
        })
    });
    // A byte now and then is no head, whether it may become HTTP/1.1 or HTTP/2.
    let trickle = |bytes: Vec<u8>| {
        tokio::spawn(async move {
            let (read, mut write) = TcpStream::connect(address).await.unwrap().into_split();
            let began = Instant::now();
            let writes = tokio::spawn(async move {
                for byte in bytes {
                    if write.write_all(&[byte]).await.is_err() {
                        break;
                    }
                    tokio::time::sleep(Duration::from_millis(50)).await;
                }
                write
            });
            let closed = closed(read, began).await;
            writes.abort();
            closed
        })
    };
    let heads = (0..20).map(|n| {
        trickle(format!("GET /healthz HTTP/1.1\r\nX-{n}: {}", "x".repeat(1000)).into_bytes())
    });
    let preface = trickle([&b"PRI * HTTP/2.0\r\n\r\n"[..], &[b'S'; 100]].concat());
    let head = "POST /points HTTP/1.1\r\nHost: localhost\r\nContent-Type: \
        application/json\r\nContent-Length: 5000\r\n\r\n";
    let bodies = (0..20).map(|_| {
        tokio::spawn(async move {
            let mut stream = TcpStream::connect(address).await.unwrap();
            stream.write_all(head.as_bytes()).await.unwrap();
            let began = Instant::now();
            let (mut said, mut piece) = (Vec::new(), [0; 4096]);
            while !said.starts_with(b"HTTP/1.1 408") {
                assert!(began.elapsed() < Duration::from_secs(30));
                let _ = stream.write_all(b" ").await;
                match tokio::time::timeout(Duration::from_millis(50), stream.read(&mut piece)).await
                {
                    Ok(Ok(read)) if read > 0 => said.extend_from_slice(&piece[..read]),
                    Ok(other) => panic!("{other:?} after {}", String::from_utf8_lossy(&said)),
                    Err(_) => {}
                }
            }
            began.elapsed()
        })
    });
    let (silent, heads, bodies): (Vec<_>, Vec<_>, Vec<_>) =
        (silent.collect(), heads.collect(), bodies.collect());
    for (client, said) in silent
        .into_iter()
        .map(|task| (task, false))
        .chain(heads.into_iter().map(|task| (task, true)))
    {
        let (took, answer) = client.await.unwrap();
        in_time(took, HEADER);
        assert!(
            answer.is_empty() || said,
            "{}",
            String::from_utf8_lossy(&answer)
        );
    }
    in_time(preface.await.unwrap().0, HEADER);
    for body in bodies {
        in_time(body.await.unwrap(), BODY);
    }
    well.end("silent sockets, slow heads, slow bodies").await;
    eventually("every connection is given back", || {
        server.app.access().connections().open() <= 2
    })
    .await;
}

/// The rest of a body is read for a client that reads only afterwards; a body that has no end, or
/// is far too long, is not.
#[tokio::test(flavor = "multi_thread", worker_threads = 4)]
async fn a_body_without_end_ends_the_connection_soon_after_its_problem() {
    let server = Server::start(&["--max-body-bytes", "1MiB"]).await;
    let address = server.address;
    let parts = "Content-Type: multipart/form-data; boundary=x\r\n";
    let json = "Content-Type: application/json\r\n";
    let chunked = "Transfer-Encoding: chunked\r\n";
    let cases = [
        (
            "too large",
            format!("POST /points HTTP/1.1\r\n{json}{chunked}"),
            413,
        ),
        (
            "no parts",
            format!("POST /warp HTTP/1.1\r\n{parts}{chunked}"),
            400,
        ),
        (
            "a length beyond all limits",
            format!("POST /warp HTTP/1.1\r\n{parts}Content-Length: 1000000000000\r\n"),
            413,
        ),
        (
            "no multipart",
            format!("POST /warp HTTP/1.1\r\nContent-Type: text/plain\r\n{chunked}"),
            415,
        ),
        (
            "a wrong boundary",
            format!("POST /warp HTTP/1.1\r\nContent-Type: multipart/form-data\r\n{chunked}"),
            400,
        ),
        (
            "no such session",
            format!("POST /sessions/x/warp HTTP/1.1\r\n{json}{chunked}"),
            404,
        ),
        (
            "no such route",
            format!("POST /nothing HTTP/1.1\r\n{json}{chunked}"),
            404,
        ),
    ];
    let ends = cases.map(|(what, head, status)| {
        tokio::spawn(async move {
            let (mut read, mut write) = TcpStream::connect(address).await.unwrap().into_split();
            write
                .write_all(format!("{head}Host: localhost\r\n\r\n").as_bytes())
                .await
                .unwrap();
            let began = Instant::now();
            let writes = tokio::spawn(async move {
                let piece = [&b"4000\r\n"[..], &[b'x'; 0x4000], b"\r\n"].concat();
                while write.write_all(&piece).await.is_ok() {
                    assert!(
                        began.elapsed() < Duration::from_secs(25),
                        "{what}: the connection goes on"
                    );
                    tokio::time::sleep(Duration::from_millis(5)).await;
                }
            });
            let mut line = [0; 12];
            read.read_exact(&mut line).await.unwrap();
            assert_eq!(
                std::str::from_utf8(&line),
                Ok(format!("HTTP/1.1 {status}").as_str()),
                "{what}"
            );
            writes.await.unwrap();
            began.elapsed()
        })
    });
    for end in ends {
        let took = end.await.unwrap();
        assert!(
            took < Duration::from_secs(15),
            "{took:?}: the deadline of a body is 30 s"
        );
    }
    // A body of a length that is allowed is taken to its end, however slowly it comes, and the
    // answer is found.
    let (mut stream, length) = (TcpStream::connect(address).await.unwrap(), 400_000);
    let head = format!(
        "POST /nothing HTTP/1.1\r\nHost: localhost\r\n{json}Content-Length: {length}\r\n\r\n"
    );
    stream.write_all(head.as_bytes()).await.unwrap();
    for _ in 0..40 {
        stream.write_all(&[b' '; 10_000]).await.unwrap();
        tokio::time::sleep(Duration::from_millis(80)).await;
    }
    let mut line = [0; 12];
    stream.read_exact(&mut line).await.unwrap();
    assert_eq!(&line, b"HTTP/1.1 404");
}

/// A session whose picture is some megabytes, never compressed.
async fn large(server: &Server) -> String {
    server
        .session(
            &photo(1600, 1200),
            &json!({"p": [[20, 20]], "grid": {"cell": 100}}),
        )
        .await
}

async fn take(address: SocketAddr, id: &str) -> TcpStream {
    let socket = TcpSocket::new_v4().unwrap();
    socket.set_recv_buffer_size(16 << 10).unwrap();
    let mut stream = socket.connect(address).await.unwrap();
    let body = json!({"q": [[22, 20]], "output": {"compression": "none"}}).to_string();
    let length = body.len();
    let head = format!(
        "POST /sessions/{id}/warp HTTP/1.1\r\nHost: localhost\r\nContent-Type: \
            application/json\r\nContent-Length: {length}\r\n"
    );
    stream
        .write_all(format!("{head}Connection: close\r\n\r\n{body}").as_bytes())
        .await
        .unwrap();
    stream
}

#[tokio::test(flavor = "multi_thread", worker_threads = 4)]
async fn who_takes_nothing_is_cut_and_who_takes_little_is_not() {
    let server = Server::start(&["--write-timeout", "6s"]).await;
    let id = large(&server).await;
    let well = Healthy::begin(server.address).await;
    let nothing = take(server.address, &id).await;
    let mut slow = take(server.address, &id).await;
    let began = Instant::now();
    // 10 kB/s, for three times the deadline; then all of it. (The kernel passes on up to 64 KiB at
    // once: a deadline must be longer than those take.)
    let mut said = vec![0; 1000];
    let mut taken = 0;
    while began.elapsed() < Duration::from_secs(18) {
        let read = tokio::time::timeout(Duration::from_secs(5), slow.read(&mut said))
            .await
            .unwrap()
            .unwrap();
        assert!(
            read > 0,
            "cut after {:?} and {taken} bytes",
            began.elapsed()
        );
        taken += read;
        tokio::time::sleep(Duration::from_millis(100)).await;
    }
    let mut rest = Vec::new();
    slow.read_to_end(&mut rest).await.unwrap();
    assert!(
        rest.ends_with(b"0\r\n\r\n") && taken + rest.len() > 1600 * 1200 * 3,
        "the picture is whole: {}",
        taken + rest.len()
    );
    // The other one has been cut long ago: its place is free, and what it reads ends early.
    eventually("it is cut", || {
        server.app.access().connections().open() <= 2
    })
    .await;
    let (_, said) = closed_or_reset(nothing).await;
    assert!(said < 1600 * 1200 * 3, "{said}");
    well.end("a reader that takes nothing, one at 10 kB/s")
        .await;
}

/// Reads to the end, or to the reset.
async fn closed_or_reset(mut stream: TcpStream) -> (Duration, usize) {
    let began = Instant::now();
    let mut said = Vec::new();
    let _ = tokio::time::timeout(Duration::from_secs(30), stream.read_to_end(&mut said))
        .await
        .unwrap();
    (began.elapsed(), said.len())
}

/// As many connections as the program takes, none of which says anything.
#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn two_thousand_idle_connections_are_closed_at_their_deadline() {
    use rustix::process::{Resource, getrlimit, setrlimit};
    const IDLE: usize = 2000;
    let mut limit = getrlimit(Resource::Nofile);
    if limit.current.is_some_and(|files| files < 4096) {
        limit.current = limit
            .maximum
            .map_or(Some(4096), |most| Some(most.min(4096)));
        setrlimit(Resource::Nofile, limit).unwrap();
    }
    // Started with a soft limit that is too low: it raises its own.
    let program = Program::start(&[
        "--header-timeout",
        "3s",
        "--max-connections-per-address",
        "2040",
        "--max-connections",
        "2040",
    ]);
    let limits = std::fs::read_to_string(format!("/proc/{}/limits", program.id())).unwrap();
    let files = limits
        .lines()
        .find(|line| line.starts_with("Max open files"))
        .unwrap();
    let soft: u64 = files.split_whitespace().nth(3).unwrap().parse().unwrap();
    assert!(soft > 2040, "{files}");
    let well = Healthy::begin(program.address).await;
    let began = Instant::now();
    let mut idle = Vec::new();
    for _ in 0..IDLE {
        idle.push(TcpStream::connect(program.address).await.unwrap());
    }
    let opened = began.elapsed();
    let health = Command::new(env!("CARGO_BIN_EXE_mlswarp"))
        .args(["health", "--listen", &program.address.to_string()])
        .output()
        .unwrap();
    assert!(health.status.success(), "{health:?}");
    for stream in idle {
        assert!(closed(stream, began).await.1.is_empty());
    }
    let took = began.elapsed();
    eprintln!(
        "{IDLE} idle connections: opened in {:.0} ms, all closed after {:.1} s",
        ms(opened),
        took.as_secs_f64()
    );
    assert!(took < opened + Duration::from_secs(30), "{took:?}");
    well.end("2,000 idle connections").await;
}

/// It answers pings, asks for pictures, and grants no window: every stream is reset, the connection
/// is ended, and one beside it goes on.
#[tokio::test(flavor = "multi_thread", worker_threads = 4)]
async fn http_2_without_window_falls_to_the_write_deadline() {
    let server = Server::start(&DEADLINES).await;
    let well = Healthy::begin(server.address).await;
    let began = Instant::now();
    let mut frames = Frames::open(server.address, 0).await;
    for n in 0..32 {
        frames.request(1 + 2 * n, GET, "/page/cat.jpg", true).await;
    }
    let mut reset = std::collections::BTreeSet::new();
    let mut bytes = 0;
    while reset.len() < 32 {
        let frame = frames
            .next()
            .await
            .expect("streams end before the connection");
        match frame.kind {
            RST_STREAM => {
                in_time(began.elapsed(), WRITE);
                assert!(reset.insert(frame.stream), "{frame:?}");
            }
            DATA => bytes += frame.payload.len(),
            HEADERS | GOAWAY | WINDOW_UPDATE => {}
            _ => panic!("{frame:?}"),
        }
    }
    assert_eq!(bytes, 0, "there was no window");
    while frames.next().await.is_some() {}
    assert!(
        began.elapsed() < 10 * (WRITE + HEADER + WRITE),
        "{:?}",
        began.elapsed()
    );
    well.end("HTTP/2 without window").await;
    eventually("its place is given back", || {
        server.app.access().connections().open() <= 2
    })
    .await;
}

/// One byte of window for each answer, and pings: what is left of the answers does not stay.
#[tokio::test(flavor = "multi_thread", worker_threads = 4)]
async fn http_2_with_one_byte_of_window_does_not_stay() {
    let server = Server::start(&DEADLINES).await;
    let began = Instant::now();
    let mut frames = Frames::open(server.address, 1).await;
    for n in 0..64 {
        frames.request(1 + 2 * n, GET, "/healthz", true).await;
    }
    while frames.next().await.is_some() {}
    assert!(
        began.elapsed() < 10 * (WRITE + HEADER + WRITE),
        "{:?}",
        began.elapsed()
    );
}

/// Streams that are opened and send no body; the 65th is refused at once.
#[tokio::test(flavor = "multi_thread", worker_threads = 4)]
async fn http_2_streams_without_bodies_fall_to_the_body_deadline() {
    let server = Server::start(&DEADLINES).await;
    let well = Healthy::begin(server.address).await;
    let mut frames = Frames::open(server.address, 65535).await;
    // A client that has read the server's settings knows that there are 64.
    let began = Instant::now();
    for n in 0..64 {
        frames.request(1 + 2 * n, POST, "/points", false).await;
    }
    frames.request(129, POST, "/points", false).await;
    let mut answered = std::collections::BTreeSet::new();
    let mut refused = false;
    while answered.len() < 64 {
        let frame = frames.next().await.expect("every stream is answered");
        match (frame.kind, frame.stream) {
            (RST_STREAM, 129) => refused = true,
            (HEADERS, stream) => {
                in_time(began.elapsed(), BODY);
                answered.insert(stream);
            }
            _ => {}
        }
    }
    assert!(refused, "one stream more than 64");
    while frames.next().await.is_some() {}
    well.end("HTTP/2 with 64 silent streams").await;
}

/// A TLS handshake that begins and does not end.
#[tokio::test(flavor = "multi_thread", worker_threads = 4)]
async fn a_tls_handshake_without_end_is_cut() {
    let folder = crate::tls::Folder::new("slow");
    let server = folder.server(&DEADLINES).await;
    // The head of a record that holds a ClientHello of 512 bytes, most of which never comes.
    for begin in [&b""[..], b"\x16\x03\x01\x02\x00\x01\x00\x01\xfc\x03\x03"] {
        let mut stream = TcpStream::connect(server.address).await.unwrap();
        stream.write_all(begin).await.unwrap();
        in_time(closed(stream, Instant::now()).await.0, HEADER);
    }
    // And one that ends, after which nothing is asked.
    let stream = folder
        .connect(server.address, &[b"http/1.1"])
        .await
        .unwrap();
    let began = Instant::now();
    let mut said = Vec::new();
    let mut stream = stream;
    let _ = stream.read_to_end(&mut said).await;
    in_time(began.elapsed(), HEADER);
    let mut stream = folder.connect(server.address, &[b"h2"]).await.unwrap();
    let began = Instant::now();
    let _ = stream.read_to_end(&mut said).await;
    assert!(began.elapsed() < 10 * (HEADER + WRITE));
}

/// Many connections of one client take a little of their answers now and then: each makes progress,
/// and none is ever late.
#[tokio::test(flavor = "multi_thread", worker_threads = 4)]
async fn who_sips_holds_his_share_and_no_more() {
    let keys = "ann ann-s-key-0123456789,bob bob-s-key-9876543210";
    let server = Server::start(&[
        "--keys",
        keys,
        "--memory-bytes",
        "128MiB",
        "--write-timeout",
        "20s",
    ])
    .await;
    let (ann, bob) = ("ann-s-key-0123456789", "bob-s-key-9876543210");
    let session = async |key: &str, file: Vec<u8>| {
        let upload = server
            .post("/sessions")
            .bearer_auth(key)
            .multipart(form(&file, r#"{"p": [[20, 20]]}"#))
            .send()
            .await
            .unwrap();
        upload.json::<Value>().await.unwrap()["id"]
            .as_str()
            .unwrap()
            .to_owned()
    };
    // Each answer is larger than what the kernel holds for a connection.
    let (large, small) = (
        session(ann, photo(2000, 1500)).await,
        session(bob, photo(128, 96)).await,
    );
    let body = json!({"q": [[21, 20]], "output": {"compression": "none"}}).to_string();
    let head = format!(
        "POST /sessions/{large}/warp HTTP/1.1\r\nHost: localhost\r\nConnection: \
            close\r\nAuthorization: Bearer {ann}\r\nContent-Type: \
            application/json\r\nContent-Length: {}\r\n\r\n",
        body.len()
    );
    let address = server.address;
    let sip = move |asked: String| async move {
        let socket = TcpSocket::new_v4().unwrap();
        socket.set_recv_buffer_size(4096).unwrap();
        let mut stream = socket.connect(address).await.unwrap();
        stream.write_all(asked.as_bytes()).await.unwrap();
        let mut status = [0; 12];
        stream.read_exact(&mut status).await.unwrap();
        if status.ends_with(b"503") {
            let mut told = String::new();
            let _ = stream.read_to_string(&mut told).await;
            assert!(
                told.contains("\"unread_bytes\"") && told.contains("retry-after: 2"),
                "{told}"
            );
            return None;
        }
        assert!(
            status.ends_with(b"200"),
            "{}",
            String::from_utf8_lossy(&status)
        );
        // Sips, until this is dropped.
        Some(tokio::spawn(async move {
            let mut sip = [0; 64];
            while stream.read_exact(&mut sip).await.is_ok() {
                tokio::time::sleep(Duration::from_millis(50)).await;
            }
        }))
    };
    let (share, mut sipping, mut refused) = (server.app.budget().total() / 4, Vec::new(), 0);
    for _ in 0..30 {
        match sip(format!("{head}{body}")).await {
            Some(sips) => sipping.push(sips),
            None => refused += 1,
        }
        let held = server
            .app
            .budget()
            .taken_for(mlswarp_server::limits::memory::MemoryClass::Frame);
        assert!(held <= share + (1 << 20), "{held} of {share}");
    }
    assert!(
        sipping.len() > 1 && refused > 1,
        "{} sip, {refused} were refused",
        sipping.len()
    );
    // Nobody else notices.
    for n in 0..20 {
        let drag = server
            .post(&format!("/sessions/{small}/warp"))
            .bearer_auth(bob)
            .json(&json!({"q": [[20 + n, 20]]}))
            .send()
            .await
            .unwrap();
        assert_eq!(drag.status(), 200);
        assert!(drag.bytes().await.unwrap().starts_with(b"\x89PNG"));
    }
    eprintln!(
        "{} answers are sipped, {refused} were refused",
        sipping.len()
    );
    sipping.into_iter().for_each(|sips| sips.abort());
    eventually("what was not taken is given back", || {
        server
            .app
            .budget()
            .taken_for(mlswarp_server::limits::memory::MemoryClass::Frame)
            == 0
    })
    .await;
}

#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn mapped_places_that_nobody_reads_are_in_the_account() {
    let server = Server::start(&["--memory-bytes", "128MiB"]).await;
    let places = vec!["[1,2]"; 300_000].join(",");
    let body = format!(
        r#"{{"extent": [99, 99], "p": [[10, 10], [80, 20], [30, 70]], "q": [[12, 10], [80, 25],
          [33, 70]], "points": [{places}]}}"#
    );
    let head = format!(
        "POST /points HTTP/1.1\r\nHost: localhost\r\nContent-Type: \
            application/json\r\nContent-Length: {}\r\n\r\n",
        body.len()
    );
    let held = || {
        server
            .app
            .budget()
            .taken_for(mlswarp_server::limits::memory::MemoryClass::Frame)
    };
    let (share, mut answers, mut refused) = (server.app.budget().total() / 4, Vec::new(), 0);
    // An answer is mapped and sent in parts, so that each holds a small share of the memory.
    for _ in 0..40 {
        let socket = TcpSocket::new_v4().unwrap();
        socket.set_recv_buffer_size(4096).unwrap();
        let mut stream = socket.connect(server.address).await.unwrap();
        stream.write_all(head.as_bytes()).await.unwrap();
        stream.write_all(body.as_bytes()).await.unwrap();
        let mut status = [0; 12];
        stream.read_exact(&mut status).await.unwrap();
        refused += usize::from(status.ends_with(b"503"));
        answers.push(stream);
        assert!(held() <= share, "{} of {share}", held());
    }
    assert!(
        refused > 0 && refused < answers.len() && held() > 0,
        "{refused} were refused, {} bytes are held",
        held()
    );
    drop(answers);
    eventually("what was not taken is given back", || held() == 0).await;
}

#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn session_objects_that_nobody_reads_are_in_the_account() {
    let server = Server::start(&[]).await;
    let id = server
        .session(&photo(64, 48), &json!({"p": [[20, 20], [40, 30]]}))
        .await;
    let path = format!("/sessions/{id}");
    let length = server
        .get(&path)
        .send()
        .await
        .unwrap()
        .bytes()
        .await
        .unwrap()
        .len() as u64;
    let held = || {
        server
            .app
            .budget()
            .taken_for(mlswarp_server::limits::memory::MemoryClass::Frame)
    };
    eventually("what was read is given back", || held() == 0).await;
    let mut frames = Frames::open(server.address, 0).await;
    for n in 0..40 {
        frames.request(1 + 2 * n, GET, &path, true).await;
    }
    eventually("all are held", || held() == 40 * length).await;
    drop(frames);
    eventually("what was not read is given back", || held() == 0).await;
}
