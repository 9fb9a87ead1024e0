//! Keys: a request without a key gets an error that says so, a key of another owner reveals
//! nothing, and no key is ever written to a log.

use std::time::{Duration, Instant};

use data_encoding::BASE64URL_NOPAD;
use futures_util::{SinkExt as _, StreamExt as _};
use mlswarp_server::http::{Access, paths};
use mlswarp_server::limits::memory::MemoryClass;
use reqwest::{Method, RequestBuilder, Response};
use serde_json::{Value, json};
use tokio::net::TcpStream;
use tokio_tungstenite::client_async;
use tokio_tungstenite::tungstenite::client::IntoClientRequest as _;
use tokio_tungstenite::tungstenite::{Error, Message};

use crate::support::counters::Counted as _;
use crate::support::program::{Program, mlswarp};
use crate::support::server::{blend_form, form, header, problem};
use crate::support::{Scratch, Server, eventually, photo};

const ANN: &str = "ann-s-key-0123456789";
const BOB: &str = "bob-s-key-9876543210";
const NOBODY: &str = "8f3b1c1e-6f0a-4c8e-9d53-0f1a2b3c4d5e";

async fn server() -> Server {
    Server::start(&["--keys", &format!("ann {ANN},bob {BOB}")]).await
}

fn rest() -> Value {
    json!({"p": [[4, 4], [12, 8], [3, 9], [13, 2]]})
}

/// Every method of every route, as the document lists them.
async fn operations(server: &Server) -> Vec<(Method, String, Access)> {
    let document: Value = server
        .get("/openapi.json")
        .send()
        .await
        .unwrap()
        .json()
        .await
        .unwrap();
    let methods = |path: &str| -> Vec<Method> {
        let item = document["paths"][path]
            .as_object()
            .unwrap_or_else(|| panic!("{path} is not in the document"));
        item.iter()
            .filter(|(_, i)| i["responses"].is_object())
            .map(|(method, _)| method.to_uppercase().parse().unwrap())
            .collect()
    };
    let served = paths(&server.app);
    served
        .into_iter()
        .flat_map(|(path, access)| {
            methods(path)
                .into_iter()
                .map(move |method| (method, path.to_owned(), access))
        })
        .collect()
}

/// A request of this route that would succeed for the owner of the session.
pub(crate) fn asked(server: &Server, method: &Method, path: &str, id: &str) -> RequestBuilder {
    let request = server.client.request(
        method.clone(),
        server.url(&path.replace("{id}", id).replace("{name}", "depth")),
    );
    match (method.as_str(), path) {
        ("POST", "/warp" | "/sessions") | ("PUT", "/sessions/{id}") => {
            request.multipart(form(&photo(16, 12), rest().to_string()))
        }
        ("GET" | "DELETE", "/sessions/{id}") => request,
        ("PUT", "/sessions/{id}/layers/{name}") => request.body(photo(16, 12)),
        ("GET" | "DELETE", "/sessions/{id}/layers/{name}") => request,
        ("PUT", "/sessions/{id}/handles") => request.json(&json!({"p": [[1, 1]]})),
        ("POST", "/sessions/{id}/warp" | "/sessions/{id}/mesh") => {
            request.json(&json!({"q": [[5, 4], [12, 8], [3, 9], [13, 2]]}))
        }
        ("POST", "/sessions/{id}/tokens") => request.json(&json!({})),
        ("POST", "/sessions/{id}/batch") => {
            request.json(&json!({"q": [[5, 4], [12, 8], [3, 9], [13, 2]], "steps": 2}))
        }
        ("POST", "/sessions/{id}/points") => {
            request.json(&json!({"q": [[5, 4], [12, 8], [3, 9], [13, 2]], "points": [[1, 1]]}))
        }
        ("POST", "/sessions/{id}/fit") => {
            request.json(&json!({"q": [[5, 4], [12, 8], [3, 9], [13, 2]]}))
        }
        ("POST", "/fit") => {
            request.json(&json!({"extent": [9, 9], "p": rest()["p"], "q": rest()["p"]}))
        }
        ("POST", "/blend") => request.multipart(blend_form(
            &[&photo(16, 12)],
            &json!({"images": [{"image": 0, "p": rest()["p"]}]}),
        )),
        ("POST", "/landmarks") => request.body("1,2\n"),
        ("POST", "/sessions/{id}/map") => {
            request.json(&json!({"q": [[5, 4], [12, 8], [3, 9], [13, 2]]}))
        }
        ("POST", "/sessions/{id}/report") => {
            request.json(&json!({"q": [[5, 4], [12, 8], [3, 9], [13, 2]]}))
        }
        ("POST", "/report") => {
            request.json(&json!({"extent": [9, 9], "p": [[1, 1]], "q": [[2, 1]]}))
        }
        ("POST", "/map") => request.json(&json!({"extent": [9, 9], "p": [[1, 1]], "q": [[2, 1]]})),
        ("POST", "/points") => request
            .json(&json!({"extent": [9, 9], "p": [[1, 1]], "q": [[2, 1]], "points": [[3, 3]]})),
        ("GET", "/sessions/{id}/drag") => request
            .header("Connection", "upgrade")
            .header("Upgrade", "websocket")
            .header("Sec-WebSocket-Version", "13")
            .header("Sec-WebSocket-Key", "dGhlIHNhbXBsZSBub25jZQ=="),
        ("GET", "/problems/{code}") => server.get("/problems/forbidden"),
        ("GET", _) => request,
        other => panic!("{other:?} is new: say here what asks for it"),
    }
}

/// What an answer tells, but for what differs with every request.
async fn told(response: Response) -> (u16, Value) {
    let status = response.status().as_u16();
    let mut document: Value = response.json().await.unwrap_or_default();
    document["request_id"] = Value::Null;
    (status, document)
}

#[tokio::test]
async fn every_route_wants_a_key_unless_it_is_open() {
    let server = server().await;
    let operations = operations(&server).await;
    assert!(
        operations
            .iter()
            .filter(|(.., access)| *access == Access::Keyed)
            .count()
            >= 11,
        "{operations:?}"
    );
    for (method, path, access) in operations {
        let none = asked(&server, &method, &path, NOBODY).send().await.unwrap();
        if access == Access::Open {
            assert_eq!(none.status(), 200, "{method} {path}");
            continue;
        }
        assert_eq!(
            header(&none, "www-authenticate"),
            "Bearer",
            "{method} {path}"
        );
        problem(none, 401, "unauthorized").await;
        let basic =
            asked(&server, &method, &path, NOBODY).header("Authorization", format!("Basic {ANN}"));
        problem(basic.send().await.unwrap(), 401, "unauthorized").await;
        for wrong in [&ANN[1..], &format!("{ANN}0"), "x"] {
            problem(
                asked(&server, &method, &path, NOBODY)
                    .bearer_auth(wrong)
                    .send()
                    .await
                    .unwrap(),
                403,
                "forbidden",
            )
            .await;
        }
    }
    for open in ["/", "/page/main.js", "/healthz", "/readyz", "/openapi.json"] {
        assert_eq!(
            server.get(open).send().await.unwrap().status(),
            200,
            "{open}"
        );
    }
    // A key in the address is no key.
    problem(
        server
            .post(&format!("/points?key={ANN}"))
            .json(&json!({}))
            .send()
            .await
            .unwrap(),
        401,
        "unauthorized",
    )
    .await;
}

/// For another's session every route answers byte for byte as for one that never was.
#[tokio::test]
async fn two_keys_do_not_see_each_others_sessions() {
    let server = server().await;
    let opened = server
        .post("/sessions")
        .bearer_auth(ANN)
        .multipart(form(&photo(16, 12), rest().to_string()))
        .send()
        .await
        .unwrap();
    let id = opened.json::<Value>().await.unwrap()["id"]
        .as_str()
        .unwrap()
        .to_owned();
    let picture = async || {
        let body = json!({"q": [[5, 4], [12, 8], [3, 9], [13, 2]]});
        let answer = server
            .post(&format!("/sessions/{id}/warp"))
            .bearer_auth(ANN)
            .json(&body)
            .send()
            .await
            .unwrap();
        assert_eq!(answer.status(), 200);
        answer.bytes().await.unwrap()
    };
    let session = async || {
        told(
            server
                .get(&format!("/sessions/{id}"))
                .bearer_auth(ANN)
                .send()
                .await
                .unwrap(),
        )
        .await
        .1
    };
    let (before, was) = (picture().await, session().await);
    let mut tried = 0;
    for (method, path, access) in operations(&server).await {
        // Bob may give a session of his own the same name; see below.
        if access == Access::Open
            || !path.contains("{id}")
            || (method == Method::PUT && path == "/sessions/{id}")
        {
            continue;
        }
        let theirs = told(
            asked(&server, &method, &path, &id)
                .bearer_auth(BOB)
                .send()
                .await
                .unwrap(),
        )
        .await;
        let unknown = told(
            asked(&server, &method, &path, NOBODY)
                .bearer_auth(BOB)
                .send()
                .await
                .unwrap(),
        )
        .await;
        assert_eq!(theirs.0, 404, "{method} {path}");
        assert_eq!(theirs, unknown, "{method} {path}");
        tried += 1;
    }
    assert!(tried >= 7, "{tried}");
    // The same name is another session of another owner: neither replaces the other.
    let own = asked(&server, &Method::PUT, "/sessions/{id}", &id)
        .bearer_auth(BOB)
        .send()
        .await
        .unwrap();
    assert_eq!(own.status(), 201);
    let handles = asked(&server, &Method::PUT, "/sessions/{id}/handles", &id)
        .bearer_auth(BOB)
        .send()
        .await
        .unwrap();
    assert_eq!(handles.status(), 200);
    assert_eq!(picture().await, before);
    assert_eq!(session().await["p"], was["p"]);
    let ended = asked(&server, &Method::DELETE, "/sessions/{id}", &id)
        .bearer_auth(BOB)
        .send()
        .await
        .unwrap();
    assert_eq!(ended.status(), 204);
    assert_eq!(picture().await, before);
}

/// Opens a drag socket with subprotocols; the one that is answered.
async fn open(server: &Server, path: &str, protocols: &str) -> Result<Option<String>, u16> {
    let mut request = format!("ws://{}{path}", server.address)
        .into_client_request()
        .unwrap();
    request
        .headers_mut()
        .insert("Sec-WebSocket-Protocol", protocols.parse().unwrap());
    match client_async(request, TcpStream::connect(server.address).await.unwrap()).await {
        Ok((mut socket, answer)) => {
            assert!(
                matches!(socket.next().await, Some(Ok(Message::Text(_)))),
                "hello"
            );
            socket
                .send(Message::text(
                    json!({"seq": 1, "q": [[5, 4], [12, 8], [3, 9], [13, 2]]}).to_string(),
                ))
                .await
                .unwrap();
            assert!(
                matches!(socket.next().await, Some(Ok(Message::Binary(_)))),
                "a frame"
            );
            Ok(answer
                .headers()
                .get("Sec-WebSocket-Protocol")
                .map(|p| p.to_str().unwrap().to_owned()))
        }
        Err(Error::Http(refused)) => Err(refused.status().as_u16()),
        Err(error) => panic!("{error}"),
    }
}

#[tokio::test]
async fn a_browsers_socket_brings_its_key_as_a_subprotocol() {
    let server = server().await;
    let opened = server
        .post("/sessions")
        .bearer_auth(ANN)
        .multipart(form(&photo(16, 12), rest().to_string()))
        .send()
        .await
        .unwrap();
    let id = opened.json::<Value>().await.unwrap()["id"]
        .as_str()
        .unwrap()
        .to_owned();
    let path = format!("/sessions/{id}/drag");
    let offers = |key: &str| {
        format!(
            "mlswarp, mlswarp.bearer.{}",
            BASE64URL_NOPAD.encode(key.as_bytes())
        )
    };
    // The key's subprotocol is never the one that is chosen: it would come back in the answer.
    assert_eq!(
        open(&server, &path, &offers(ANN)).await,
        Ok(Some("mlswarp".to_owned()))
    );
    assert_eq!(open(&server, &path, &offers(BOB)).await, Err(404));
    assert_eq!(
        open(&server, &path, &offers("another-key-0123456789")).await,
        Err(403)
    );
    assert_eq!(open(&server, &path, "mlswarp").await, Err(401));
    assert_eq!(
        open(&server, &format!("{path}?key={ANN}"), &offers(ANN)).await,
        Err(422),
        "the query has no key"
    );
}

#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn keys_change_without_a_restart_and_a_broken_file_changes_nothing() {
    let file = std::env::temp_dir().join(format!("mlswarp-test-keys-{}", std::process::id()));
    let write = |text: &str| {
        let new = file.with_extension("new");
        std::fs::write(&new, text).unwrap();
        std::fs::rename(&new, &file).unwrap();
    };
    write(&format!("# before\nann {ANN}\n"));
    let server = Server::start(&["--keys-file", file.to_str().unwrap()]).await;
    let opened = server
        .post("/sessions")
        .bearer_auth(ANN)
        .multipart(form(&photo(16, 12), rest().to_string()))
        .send()
        .await
        .unwrap();
    let id = opened.json::<Value>().await.unwrap()["id"]
        .as_str()
        .unwrap()
        .to_owned();
    let status = async |key: &str| {
        server
            .get(&format!("/sessions/{id}"))
            .bearer_auth(key)
            .send()
            .await
            .unwrap()
            .status()
            .as_u16()
    };
    let until = async |key: &str, wanted: u16| {
        let began = Instant::now();
        while status(key).await != wanted {
            assert!(began.elapsed() < Duration::from_secs(30), "{key} {wanted}");
            tokio::time::sleep(Duration::from_millis(50)).await;
        }
    };
    assert_eq!((status(ANN).await, status(BOB).await), (200, 403));
    // Both keys of one name, then the new one alone: the session stays.
    write(&format!("ann {ANN}\nann {BOB}\n"));
    until(BOB, 200).await;
    write(&format!("ann {BOB}\n"));
    until(ANN, 403).await;
    assert_eq!(status(BOB).await, 200);
    for broken in ["ann short", "", "no key here at all"] {
        write(broken);
        tokio::time::sleep(Duration::from_millis(1500)).await;
        assert_eq!(
            (status(ANN).await, status(BOB).await),
            (403, 200),
            "{broken}"
        );
    }
    std::fs::remove_file(&file).unwrap();
}

/// A whole conversation, everything logged that can be: no key, no session's name, no picture.
#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn nothing_secret_is_logged() {
    let program = Program::start(&["--log", "trace", "--keys", &format!("ann {ANN}")]);
    let client = reqwest::Client::new();
    let url = |path: &str| format!("http://{}{path}", program.address);
    let upload = client
        .post(url("/sessions?secret=in-the-query-77"))
        .bearer_auth(ANN)
        .multipart(form(&photo(32, 24), rest().to_string()));
    let refused = upload.send().await.unwrap();
    let _ = refused.bytes().await;
    let opened = client
        .post(url("/sessions"))
        .bearer_auth(ANN)
        .multipart(form(&photo(32, 24), rest().to_string()))
        .send()
        .await
        .unwrap();
    let id = opened.json::<Value>().await.unwrap()["id"]
        .as_str()
        .unwrap()
        .to_owned();
    let body = json!({"q": [[5, 4], [12, 8], [3, 9], [13, 2]]});
    let warped = client
        .post(url(&format!("/sessions/{id}/warp")))
        .bearer_auth(ANN)
        .json(&body)
        .send()
        .await
        .unwrap();
    assert_eq!(warped.status(), 200);
    let _ = warped.bytes().await.unwrap();
    let wrong = client
        .get(url(&format!("/sessions/{id}")))
        .bearer_auth("a-wrong-key-that-is-long")
        .send()
        .await
        .unwrap();
    assert_eq!(wrong.status(), 403);
    let key = BASE64URL_NOPAD.encode(ANN.as_bytes());
    let mut request = format!("ws://{}/sessions/{id}/drag", program.address)
        .into_client_request()
        .unwrap();
    request.headers_mut().insert(
        "Sec-WebSocket-Protocol",
        format!("mlswarp, mlswarp.bearer.{key}").parse().unwrap(),
    );
    let (mut socket, _) = client_async(request, TcpStream::connect(program.address).await.unwrap())
        .await
        .unwrap();
    socket
        .send(Message::text(
            json!({"seq": 1, "q": [[5, 4], [12, 8], [3, 9], [13, 2]]}).to_string(),
        ))
        .await
        .unwrap();
    while !matches!(socket.next().await, Some(Ok(Message::Binary(_)))) {}
    socket.close(None).await.unwrap();
    // HTTP/2 has a library of its own that logs.
    let curl = std::process::Command::new("curl")
        .args([
            "-sS",
            "--http2-prior-knowledge",
            "-H",
            &format!("Authorization: Bearer {ANN}"),
            &url(&format!("/sessions/{id}")),
        ])
        .output();
    assert!(
        curl.is_ok_and(|output| output.status.success()),
        "curl with HTTP/2"
    );
    let end = client
        .delete(url(&format!("/sessions/{id}")))
        .bearer_auth(ANN)
        .send()
        .await
        .unwrap();
    assert_eq!(end.status(), 204);
    program.terminate();
    let (status, log) = tokio::task::spawn_blocking(move || program.wait())
        .await
        .unwrap();
    assert!(status.success());
    assert!(
        log.contains("TRACE") && log.matches("answered").count() >= 6,
        "the log is a whole one"
    );
    for secret in [ANN, &key, &id, "in-the-query-77", "a-wrong-key", "IHDR"] {
        let line = log.lines().find(|line| line.contains(secret));
        assert_eq!(line, None, "{secret} is in the log");
    }
}

#[test]
fn beyond_the_loopback_a_key_is_wanted() {
    let ended = mlswarp(&["--listen", "0.0.0.0:0"]).output().unwrap();
    let told = String::from_utf8(ended.stderr).unwrap();
    assert_eq!(ended.status.code(), Some(2), "{told}");
    for word in [
        "--listen (MLSWARP_LISTEN)",
        "MLSWARP_KEYS_FILE",
        "MLSWARP_ALLOW_ANONYMOUS=true",
    ] {
        assert!(told.contains(word), "{told}");
    }
}

/// A socket is open for as long as the key that has opened it is one: not for as long as its name
/// has another.
#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn a_socket_ends_with_its_key() {
    let folder = Scratch::new();
    let file = folder.path("keys");
    let write = |text: &str| {
        std::fs::write(folder.path("new"), text).unwrap();
        std::fs::rename(folder.path("new"), &file).unwrap();
    };
    write(&format!("ann {ANN}\nann {BOB}\n"));
    let server = Server::start(&["--keys-file", &file]).await;
    let opened = server
        .post("/sessions")
        .bearer_auth(ANN)
        .multipart(form(&photo(16, 12), rest().to_string()))
        .send()
        .await
        .unwrap();
    let id = opened.json::<Value>().await.unwrap()["id"]
        .as_str()
        .unwrap()
        .to_owned();
    let open = async |key: &str| {
        let mut request = format!("ws://{}/sessions/{id}/drag", server.address)
            .into_client_request()
            .unwrap();
        request
            .headers_mut()
            .insert("Authorization", format!("Bearer {key}").parse().unwrap());
        let (mut socket, _) =
            client_async(request, TcpStream::connect(server.address).await.unwrap())
                .await
                .unwrap();
        assert!(
            matches!(socket.next().await, Some(Ok(Message::Text(_)))),
            "hello"
        );
        socket
    };
    let (mut ends, mut stays) = (open(ANN).await, open(BOB).await);
    // Another key beside changes nothing.
    write(&format!("ann {ANN}\nann {BOB}\nbob {NOBODY}\n"));
    tokio::time::sleep(Duration::from_millis(1500)).await;
    assert!(
        tokio::time::timeout(Duration::from_millis(300), ends.next())
            .await
            .is_err()
    );
    write(&format!("ann {BOB}\n"));
    let began = Instant::now();
    let Some(Ok(Message::Text(told))) = ends.next().await else {
        panic!("why it ends")
    };
    let told: Value = serde_json::from_str(&told).unwrap();
    assert_eq!(
        (&told["code"], &told["status"]),
        (&"forbidden".into(), &403.into()),
        "{told}"
    );
    let Some(Ok(Message::Close(Some(close)))) = ends.next().await else {
        panic!("its end")
    };
    assert_eq!(u16::from(close.code), 1008);
    assert!(began.elapsed() < Duration::from_secs(30));
    stays
        .send(Message::text(
            json!({"seq": 1, "q": [[5, 4], [12, 8], [3, 9], [13, 2]]}).to_string(),
        ))
        .await
        .unwrap();
    assert!(
        matches!(stays.next().await, Some(Ok(Message::Binary(_)))),
        "a frame"
    );
}

/// What one owner has sent leaves no trace that another could find: each has a decode and a plan of
/// its own, and their memory is counted.
#[tokio::test]
async fn caches_tell_one_owner_nothing_of_another() {
    let server = server().await;
    let (file, mut warp) = (photo(320, 240), rest());
    warp["q"] = json!([[5, 4], [12, 8], [3, 9], [13, 2]]);
    let ask = async |key: &str| {
        let answer = server
            .post("/warp")
            .bearer_auth(key)
            .multipart(form(&file, warp.to_string()))
            .send()
            .await
            .unwrap();
        assert_eq!(answer.status(), 200);
        let told = (
            header(&answer, "warp-plan").to_owned(),
            header(&answer, "etag").to_owned(),
        );
        answer.bytes().await.unwrap();
        told
    };
    let seen = || {
        (
            server.app.counters().images_decoded,
            server.app.counters().plans_built,
        )
    };
    let budget = server.app.budget();
    let memory = || {
        (
            budget.taken_for(MemoryClass::Image),
            budget.taken_for(MemoryClass::Plan),
        )
    };
    let (built, etag) = ask(ANN).await;
    assert_eq!((built.as_str(), seen()), ("built", (1, 1)));
    // The setup of a request goes with it.
    let ended = || eventually("the request has ended", || server.app.pool().running() == 0);
    ended().await;
    let (images, plans) = memory();
    assert_eq!(
        (ask(ANN).await, seen()),
        (("hit".to_owned(), etag.clone()), (1, 1))
    );
    // An `ETag` says what was asked and not who asked.
    assert_eq!(
        (ask(BOB).await, seen()),
        (("built".to_owned(), etag.clone()), (2, 2))
    );
    assert_eq!(
        (ask(BOB).await.0.as_str(), ask(ANN).await.0.as_str(), seen()),
        ("hit", "hit", (2, 2))
    );
    ended().await;
    assert_eq!(
        memory(),
        (2 * images, 2 * plans),
        "what two have is counted twice"
    );

    // The same by sessions; and the end of one owner's leaves the other's warm.
    let open = async |key: &str| {
        let answer = server
            .post("/sessions")
            .bearer_auth(key)
            .multipart(form(&file, rest().to_string()))
            .send()
            .await
            .unwrap();
        answer.json::<Value>().await.unwrap()["id"]
            .as_str()
            .unwrap()
            .to_owned()
    };
    let drag = async |key: &str, id: &str| {
        let answer = server
            .post(&format!("/sessions/{id}/warp"))
            .bearer_auth(key)
            .json(&json!({"q": [[5, 4], [12, 8], [3, 9], [13, 2]]}))
            .send()
            .await
            .unwrap();
        header(&answer, "warp-plan").to_owned()
    };
    server.app.clear_caches();
    let (anns, bobs) = (open(ANN).await, open(BOB).await);
    assert_eq!(seen(), (4, 4));
    let deleted = server
        .client
        .delete(server.url(&format!("/sessions/{bobs}")))
        .bearer_auth(BOB)
        .send()
        .await
        .unwrap();
    assert_eq!(deleted.status(), 204);
    assert_eq!((drag(ANN, &anns).await.as_str(), seen()), ("hit", (4, 4)));
    // Of Bob's nothing is left, although Ann's session has the same file: he finds what he would
    // find without her.
    assert_eq!((ask(BOB).await.0.as_str(), seen()), ("built", (5, 5)));
    // Without keys there is one cache for everybody.
    let open = Server::start(&[]).await;
    for (built, decoded) in [("built", 1), ("hit", 1)] {
        let answer = open.upload("/warp", &file, &warp).await;
        assert_eq!(
            (
                header(&answer, "warp-plan"),
                open.app.counters().images_decoded
            ),
            (built, decoded)
        );
    }
}

/// A store that is almost full answers the same whether or not another owner keeps the same file.
#[tokio::test]
async fn a_store_that_is_almost_full_tells_nothing_of_the_files_of_others() {
    let files = [photo(320, 240), photo(321, 240)];
    let bytes = (files[0].len() + 4096) * 3 / 2;
    for (keeps, tries) in [(0, 0), (0, 1)] {
        let keys = format!("ann {ANN},bob {BOB}");
        let server = Server::start(&[
            "--keys",
            &keys,
            "--store-bytes",
            &bytes.to_string(),
            "--max-client-share",
            "100",
        ])
        .await;
        let open = async |key: &str, file: &[u8]| {
            server
                .post("/sessions")
                .bearer_auth(key)
                .multipart(form(file, rest().to_string()))
                .send()
                .await
                .unwrap()
        };
        assert_eq!(open(ANN, &files[keeps]).await.status(), 201);
        problem(open(BOB, &files[tries]).await, 503, "overloaded").await;
        assert_eq!(
            open(ANN, &files[keeps]).await.status(),
            201,
            "she keeps it once"
        );
    }
}
