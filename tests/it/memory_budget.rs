//! The account of memory against those who would get round it: what a form says beside its parts,
//! what sessions leave behind, and requests that are dropped at every step.

use std::future::{Future, poll_fn};
use std::task::Poll;
use std::time::Duration;

use axum::body::Body;
use axum::http::{Method, Request};
use bytes::Bytes;
use futures_util::TryStreamExt as _;
use http_body_util::BodyExt as _;
use mlswarp_server::app::{App, metrics_text};
use mlswarp_server::client::Client;
use mlswarp_server::http::router;
use mlswarp_server::limits::memory::MemoryClass;
use mlswarp_server::pool::WorkClass;
use serde_json::json;
use tokio::io::{AsyncReadExt as _, AsyncWriteExt as _};
use tokio::net::TcpStream;
use tower::ServiceExt as _;

use crate::support::server::{config, header, png};
use crate::support::{Server, eventually, photo};

/// The parser of forms keeps what it does not understand yet: it must not be given more and more of
/// it.
#[tokio::test(flavor = "multi_thread", worker_threads = 4)]
async fn a_form_without_parts_is_not_kept() {
    let server = Server::start(&["--body-timeout", "10m"]).await;
    for begins in ["--x\r\nX-Note: ", "no boundary yet "] {
        let mut stream = TcpStream::connect(server.address).await.unwrap();
        let head = "POST /warp HTTP/1.1\r\nHost: localhost\r\nContent-Type: multipart/form-data; \
            boundary=x\r\nContent-Length: 30000000\r\n\r\n";
        stream
            .write_all(format!("{head}{begins}").as_bytes())
            .await
            .unwrap();
        // Less than was announced, and then nothing.
        stream.write_all(&vec![b'a'; 4 << 20]).await.unwrap();
        let mut answer = vec![0; 4096];
        let read = tokio::time::timeout(Duration::from_secs(60), stream.read(&mut answer))
            .await
            .expect("an answer")
            .unwrap();
        let answer = String::from_utf8_lossy(&answer[..read]).into_owned();
        assert!(answer.starts_with("HTTP/1.1 400"), "{answer}");
        eventually("nothing is kept", || server.app.budget().taken() == 0).await;
    }
    server.is_well().await;
}

/// What is known of sessions gives way as pictures and tables do.
#[tokio::test(flavor = "multi_thread", worker_threads = 4)]
async fn sessions_of_many_handles_do_not_fill_a_small_account() {
    let server = Server::start(&["--memory-bytes", "16MiB", "--workers", "1"]).await;
    let p: Vec<[f64; 2]> = (0..1000)
        .map(|n| [f64::from(n % 40) * 0.4, f64::from(n / 40) * 0.4])
        .collect();
    for _ in 0..80 {
        server
            .session(
                &photo(16, 12),
                &json!({"p": p, "grid": {"columns": 2, "rows": 2}}),
            )
            .await;
    }
    server.is_well().await;
}

/// Where uploads have taken all that they may take, a drag is read, and finds what is cached.
#[tokio::test(flavor = "multi_thread", worker_threads = 4)]
async fn uploads_do_not_keep_drags_out() {
    let server = Server::start(&["--memory-bytes", "16MiB"]).await;
    let id = server
        .session(&photo(16, 12), &json!({"p": [[2, 2]]}))
        .await;
    eventually("nothing runs", || server.app.pool().running() == 0).await;
    let left = (12 << 20) - server.app.budget().taken();
    let _uploads = server
        .app
        .admission
        .reserve(MemoryClass::Upload, left)
        .unwrap();
    for _ in 0..2 {
        let drag = server
            .post(&format!("/sessions/{id}/warp"))
            .json(&json!({"q": [[3, 2]]}))
            .send()
            .await
            .unwrap();
        assert_eq!(header(&drag, "warp-plan"), "hit");
        png(drag).await;
    }
}

/// A request and the reading of its answer, dropped after a number of polls; whether it came to its
/// end before.
async fn dropped_after(polls: u32, request: impl Future<Output = ()>) -> bool {
    let mut request = Box::pin(request);
    let mut polled = 0;
    poll_fn(|cx| {
        if polled == polls {
            return Poll::Ready(false);
        }
        polled += 1;
        request.as_mut().poll(cx).map(|()| true)
    })
    .await
}

/// A body that comes in pieces.
fn pieces(bytes: &[u8]) -> Body {
    let pieces: Vec<Result<Vec<u8>, std::io::Error>> = bytes
        .chunks(1 + bytes.len() / 3)
        .map(|piece| Ok(piece.to_vec()))
        .collect();
    Body::from_stream(futures_util::stream::unfold(
        pieces.into_iter(),
        |mut pieces| async move {
            tokio::task::yield_now().await;
            pieces.next().map(|piece| (piece, pieces))
        },
    ))
}

fn multipart(image: &[u8], warp: &str) -> Vec<u8> {
    let part = |name: &str, bytes: &[u8]| {
        [
            format!("--x\r\nContent-Disposition: form-data; name=\"{name}\"\r\n\r\n").as_bytes(),
            bytes,
            b"\r\n",
        ]
        .concat()
    };
    [
        part("image", image),
        part("warp", warp.as_bytes()),
        b"--x--\r\n".to_vec(),
    ]
    .concat()
}

fn send(
    app: &App,
    method: Method,
    path: &str,
    kind: &str,
    body: &[u8],
) -> impl Future<Output = ()> + use<> {
    let request = Request::builder()
        .method(method)
        .uri(path)
        .header("host", "localhost")
        .header("content-type", kind)
        .body(pieces(body))
        .unwrap();
    let router = router(app.clone());
    async move {
        let answer = router.oneshot(request).await.unwrap();
        let _ = answer.into_body().collect().await;
    }
}

/// Every kind of request is dropped after its first poll, after its second, and so on to its end:
/// no turn, no place and no byte stays taken.
#[tokio::test(flavor = "multi_thread", worker_threads = 4)]
async fn a_request_that_is_dropped_anywhere_leaves_nothing() {
    let app = App::new(config(&["--workers", "2", "--session-idle", "2s"])).unwrap();
    app.sessions.spawn_sweeper();
    let form = "multipart/form-data; boundary=x";
    let upload = multipart(
        &photo(400, 300),
        r#"{"p": [[2, 2], [50, 50]], "q": [[3, 2], [51, 50]]}"#,
    );
    let name = |n: u32| format!("/sessions/{:08x}-0000-4000-8000-000000000000", n % 5);
    let q = br#"{"q": [[3, 2], [50, 52]], "seq": 1}"#;
    for kind in 0..10 {
        let mut ended = 0;
        for polls in 0..400 {
            let path = name(polls);
            if kind > 3 {
                send(&app, Method::PUT, &path, form, &upload).await;
            }
            if polls % 2 == 0 {
                app.clear_caches();
            }
            let request: std::pin::Pin<Box<dyn Future<Output = ()> + Send>> = match kind {
                0 => Box::pin(send(&app, Method::POST, "/warp", form, &upload)),
                1 => Box::pin(send(
                    &app,
                    Method::POST,
                    "/warp?session=true",
                    form,
                    &upload,
                )),
                2 => Box::pin(send(&app, Method::POST, "/sessions", form, &upload)),
                3 => Box::pin(send(&app, Method::PUT, &path, form, &upload)),
                4 => Box::pin(send(
                    &app,
                    Method::POST,
                    &format!("{path}/warp"),
                    "application/json",
                    q,
                )),
                5 => Box::pin(send(
                    &app,
                    Method::POST,
                    &format!("{path}/mesh"),
                    "application/json",
                    br#"{"q": [[3, 2], [50, 52]]}"#,
                )),
                6 => Box::pin(send(
                    &app,
                    Method::PUT,
                    &format!("{path}/handles"),
                    "application/json",
                    br#"{"p": [[3, 2]]}"#,
                )),
                7 => Box::pin(send(
                    &app,
                    Method::POST,
                    &format!("{path}/points"),
                    "application/json",
                    br#"{"q": [[3, 2], [50, 52]], "points": [[1, 1]]}"#,
                )),
                8 => Box::pin(send(
                    &app,
                    Method::GET,
                    &format!("{path}/plan"),
                    "application/json",
                    b"",
                )),
                _ => Box::pin(send(&app, Method::GET, &path, "application/json", b"{}")),
            };
            ended += u32::from(dropped_after(polls, request).await);
            if ended == 3 {
                break;
            }
        }
        assert_eq!(ended, 3, "{kind}");
        let idle = |work| (app.pool().load(work).running, app.pool().load(work).waiting) == (0, 0);
        eventually("every turn is given back", || {
            idle(WorkClass::Drag) && idle(WorkClass::Upload) && app.pool().running() == 0
        })
        .await;
        eventually("answers leave nothing", || {
            app.budget().taken_for(MemoryClass::Frame) == 0
        })
        .await;
    }
    let kept = || {
        app.clear_caches();
        MemoryClass::ALL
            .iter()
            .map(|purpose| app.budget().taken_for(*purpose))
            .sum::<u64>()
            + app.budget().taken()
    };
    eventually("sessions expire, and nothing is left", || kept() == 0).await;
}

/// The object of a new session is in its client's share before the session is there. A client that
/// reads no answers opens no session, and is never told that a session is missing that exists.
#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn objects_of_new_sessions_are_in_the_account() {
    let app = App::new(config(&[])).unwrap();
    let p: Vec<_> = (0..200)
        .map(|n| json!([f64::from(n) + 0.123_456_789_012_345_6, 5]))
        .collect();
    let upload = multipart(&photo(300, 20), &json!({"p": p}).to_string());
    let ask = async |method: Method, path: &str, upload: &[u8]| {
        let request = Request::builder()
            .method(method)
            .uri(path)
            .header("host", "localhost")
            .header("content-type", "multipart/form-data; boundary=x");
        router(app.clone())
            .oneshot(request.body(pieces(upload)).unwrap())
            .await
            .unwrap()
    };
    let held = || app.budget().taken_for(MemoryClass::Frame);
    let named = "/sessions/8f3b1c1e-6f0a-4c8e-9d53-0f1a2b3c4d5e";
    let sessions = || {
        metrics_text::text(&app)
            .lines()
            .find_map(|line| line.strip_prefix("mlswarp_store_sessions "))
            .unwrap()
            .to_owned()
    };
    for (method, path, status) in [
        (Method::POST, "/sessions", 201),
        (Method::PUT, named, 201),
        (Method::PUT, named, 200),
    ] {
        let answer = ask(method, path, &upload).await;
        assert_eq!(answer.status(), status, "{path}");
        assert!(held() > 4000, "{} bytes are held", held());
        let body: Vec<Bytes> = answer
            .into_body()
            .into_data_stream()
            .try_collect()
            .await
            .unwrap();
        let length = body.iter().map(|piece| piece.len() as u64).sum::<u64>();
        assert_eq!(held(), length);
        drop(body);
        eventually("what was read is given back", || held() == 0).await;
    }
    assert_eq!(sessions(), "2");
    let share = app.admission.response_quota(Client::default());
    let _unread = app
        .admission
        .reserve_for(MemoryClass::Frame, &share, share.limit())
        .unwrap();
    let other = multipart(&photo(300, 20), r#"{"p": [[1, 2]]}"#);
    for (method, path) in [
        (Method::POST, "/sessions"),
        (Method::PUT, named),
        (Method::PUT, &named.replace("8f", "7f")),
    ] {
        let answer = ask(method, path, &other).await;
        assert_eq!(answer.status(), 503, "{path}");
        let document = answer.into_body().collect().await.unwrap().to_bytes();
        assert_eq!(
            serde_json::from_slice::<serde_json::Value>(&document).unwrap()["limit_name"],
            "unread_bytes"
        );
    }
    // None was made, and none was replaced.
    assert_eq!(sessions(), "2");
    drop(_unread);
    assert_eq!(ask(Method::PUT, named, &upload).await.status(), 200);
}
