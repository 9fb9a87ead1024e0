//! Clients that leave, and clients that are slow.

use serde_json::json;
use tokio::io::{AsyncReadExt as _, AsyncWriteExt as _};
use tokio::net::TcpStream;

use crate::support::counters::Counted as _;
use crate::support::{Server, eventually, photo};

#[tokio::test]
async fn a_client_that_leaves_during_the_answer_ends_the_work() {
    let server = Server::start(&[]).await;
    let id = server
        .session(
            &photo(3000, 2000),
            &json!({"p": [[100, 100]], "output": {"compression": "best"}}),
        )
        .await;
    let mut response = server.drag(&id, &json!({"q": [[140, 130]]})).await;
    assert!(response.chunk().await.unwrap().is_some());
    drop(response);
    eventually("the work ends", || {
        server.app.counters().pictures_abandoned == 1 && server.app.pool().running() == 0
    })
    .await;
    assert_eq!(server.app.counters().pictures_finished, 0);
    server.is_well().await;
}

#[tokio::test]
async fn a_client_that_leaves_during_its_upload_leaves_nothing_behind() {
    let server = Server::start(&[]).await;
    for sent in [0, 1, 200, 100_000] {
        let mut stream = TcpStream::connect(server.address).await.unwrap();
        let head = "POST /warp HTTP/1.1\r\nHost: localhost\r\nContent-Type: multipart/form-data; \
            boundary=b\r\nContent-Length: 1000000\r\n\r\n";
        stream.write_all(head.as_bytes()).await.unwrap();
        let mut body = b"--b\r\nContent-Disposition: form-data; name=\"image\"\r\n\r\n".to_vec();
        body.resize(body.len() + sent, 7);
        stream
            .write_all(&body[..sent.min(body.len())])
            .await
            .unwrap();
        drop(stream);
    }
    server.is_well().await;
    eventually("nothing runs", || server.app.pool().running() == 0).await;
    assert_eq!(
        server.app.counters().pictures_begun,
        1,
        "the healthy one alone"
    );
}

#[tokio::test]
async fn a_body_that_trickles_is_cut_at_its_deadline() {
    let server = Server::start(&["--body-timeout", "300ms"]).await;
    let mut stream = TcpStream::connect(server.address).await.unwrap();
    let head = "POST /points HTTP/1.1\r\nHost: localhost\r\nContent-Type: \
        application/json\r\nContent-Length: 1000\r\n\r\n{";
    stream.write_all(head.as_bytes()).await.unwrap();
    let mut answer = String::new();
    let _ = stream.read_to_string(&mut answer).await;
    assert!(
        answer.starts_with("HTTP/1.1 408") && answer.contains("\"timeout\""),
        "{answer}"
    );
    server.is_well().await;
}

/// Writes everything before it reads anything, as simple clients do.
async fn write_first(server: &Server, head: &str, body: &[u8]) -> String {
    let mut stream = TcpStream::connect(server.address).await.unwrap();
    stream.write_all(head.as_bytes()).await.unwrap();
    stream
        .write_all(body)
        .await
        .expect("the server reads on while it refuses");
    let mut answer = vec![0; 4096];
    let mut read = 0;
    while !String::from_utf8_lossy(&answer[..read]).contains("\"code\"") {
        match stream.read(&mut answer[read..]).await.unwrap() {
            0 => break,
            n => read += n,
        }
    }
    String::from_utf8_lossy(&answer[..read]).into_owned()
}

#[tokio::test]
async fn a_client_that_writes_first_reads_its_413() {
    let server = Server::start(&[]).await;
    let limit = 32 << 20;
    let body = vec![b'x'; limit + 1];
    let head = |length: &str| {
        format!(
            "POST /warp HTTP/1.1\r\nHost: localhost\r\nContent-Type: multipart/form-data; \
                boundary=b\r\n{length}\r\n\r\n"
        )
    };
    let answer = write_first(
        &server,
        &head(&format!("Content-Length: {}", body.len())),
        &body,
    )
    .await;
    assert!(answer.starts_with("HTTP/1.1 413"), "{answer}");
    for field in [
        "\"too_large\"",
        "\"body_bytes\"",
        "\"limit\":33554432",
        "\"actual\":33554433",
    ] {
        assert!(answer.contains(field), "{field} in {answer}");
    }
    // Chunked: nobody knows the length before it is over.
    let mut chunked = format!(
        "{:x}\r\n--b\r\nContent-Disposition: form-data; name=\"image\"\r\n\r\n",
        body.len() + 54
    )
    .into_bytes();
    chunked.extend_from_slice(&body);
    chunked.extend_from_slice(b"\r\n0\r\n\r\n");
    let answer = write_first(&server, &head("Transfer-Encoding: chunked"), &chunked).await;
    assert!(
        answer.starts_with("HTTP/1.1 413") && answer.contains("\"limit\":33554432"),
        "{answer}"
    );
    server.is_well().await;
}

#[tokio::test]
async fn trailers_tell_what_drawing_cost_where_the_client_takes_them() {
    let server = Server::start(&[]).await;
    let id = server
        .session(&photo(800, 600), &json!({"p": [[100, 100]]}))
        .await;
    let body = json!({"q": [[140, 130]]}).to_string();
    for (te, told) in [
        ("Connection: close, te\r\nTE: trailers\r\n", true),
        ("Connection: close\r\n", false),
    ] {
        let mut stream = TcpStream::connect(server.address).await.unwrap();
        let head = format!(
            "POST /sessions/{id}/warp HTTP/1.1\r\nHost: localhost\r\n{te}Content-Type: \
                application/json\r\nContent-Length: {}\r\n\r\n",
            body.len()
        );
        stream.write_all((head + &body).as_bytes()).await.unwrap();
        let mut answer = Vec::new();
        stream.read_to_end(&mut answer).await.unwrap();
        let tail = String::from_utf8_lossy(&answer[answer.len() - 120..]).into_owned();
        assert_eq!(tail.contains("server-timing: render;dur="), told, "{tail}");
    }
}
