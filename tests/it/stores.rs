//! The stores as an operator meets them: addresses, files without records, full disks, servers that
//! are away.

use std::os::unix::process::CommandExt as _;
use std::process::{Command, Stdio};
use std::time::Duration;

use reqwest::{Client, Response};
use serde_json::{Value, json};

use crate::support::program::{Program, mlswarp};
use crate::support::redis::Redis;
use crate::support::server::{form, header, png, problem};
use crate::support::{Scratch, Server, photo};

const NAME: &str = "3e6cbb0e-5b4f-4f0c-9b7e-0a8f2c6a1d11";

async fn refused(response: Response) {
    assert!(header(&response, "retry-after").parse::<u32>().unwrap() >= 1);
    problem(response, 503, "overloaded").await;
}

async fn put(server: &Server, picture: &[u8]) -> u16 {
    let request = server
        .client
        .put(server.url(&format!("/sessions/{NAME}")))
        .multipart(form(picture, json!({"p": [[5, 5]]}).to_string()));
    request.send().await.unwrap().status().as_u16()
}

#[test]
fn a_store_that_is_none_is_told_and_no_password_is() {
    for (value, says) in [
        ("redis://me:s3cret@here:port", "redis://["),
        ("rediss://me:s3cret@here", "TLS"),
        ("s3cret", "a store is `memory`"),
        ("file:", "needs a path"),
    ] {
        for output in [
            mlswarp(&["--store", value]).output(),
            mlswarp(&[]).env("MLSWARP_STORE", value).output(),
        ] {
            let output = output.unwrap();
            let said = String::from_utf8_lossy(&output.stderr);
            assert_eq!(output.status.code(), Some(2), "{said}");
            assert!(
                said.contains("--store (MLSWARP_STORE)")
                    && said.contains(says)
                    && !said.contains("s3cret"),
                "{said}"
            );
        }
    }
    let help = mlswarp(&["serve", "--help"])
        .env("MLSWARP_STORE", "redis://me:s3cret@here")
        .output()
        .unwrap();
    let help = String::from_utf8_lossy(&help.stdout).into_owned();
    assert!(
        help.contains("MLSWARP_STORE") && !help.contains("s3cret") && !help.contains("me:"),
        "{help}"
    );
}

#[tokio::test]
async fn a_password_is_in_no_log_and_no_answer() {
    let redis = Redis::start(&["--requirepass", "s3cret"]);
    let address = redis.address().replace("//", "//default:wr0ng@");
    let program = Program::start(&["--store", &address, "--log", "debug"]);
    let http = Client::new();
    let url = |path: &str| format!("http://{}{path}", program.address);
    for request in [
        http.get(url("/readyz")),
        http.get(url(&format!("/sessions/{NAME}"))),
        http.get(url("/metrics")),
    ] {
        assert!(
            !request
                .send()
                .await
                .unwrap()
                .text()
                .await
                .unwrap()
                .contains("wr0ng")
        );
    }
    program.terminate();
    let (_, log) = program.wait();
    assert!(
        log.contains("the session store is away") && !log.contains("wr0ng"),
        "{log}"
    );
}

#[test]
fn a_file_that_is_no_store_ends_the_program_and_is_left_alone() {
    let scratch = Scratch::new();
    let path = scratch.path("diary");
    std::fs::write(&path, "Dear diary").unwrap();
    let output = mlswarp(&[
        "--listen",
        "127.0.0.1:0",
        "--store",
        &format!("file:{path}"),
    ])
    .output()
    .unwrap();
    let said = String::from_utf8_lossy(&output.stderr);
    assert_eq!(output.status.code(), Some(1), "{said}");
    assert!(
        said.contains(&path) && said.contains("it is no session file"),
        "{said}"
    );
    assert_eq!(std::fs::read(&path).unwrap(), b"Dear diary");
}

#[test]
fn two_programs_do_not_share_a_file() {
    let scratch = Scratch::new();
    let store = format!("file:{}", scratch.path("sessions.db"));
    let _first = Program::start(&["--store", &store]);
    let second = mlswarp(&["--listen", "127.0.0.1:0", "--store", &store])
        .output()
        .unwrap();
    let said = String::from_utf8_lossy(&second.stderr);
    assert!(
        second.status.code() == Some(1) && said.contains("another process has it open"),
        "{said}"
    );
}

#[tokio::test]
async fn numbers_are_written_when_the_program_stops() {
    let scratch = Scratch::new();
    let store = format!("file:{}", scratch.path("sessions.db"));
    let http = Client::new();
    let program = Program::start(&["--store", &store]);
    let url = |program: &Program| format!("http://{}/sessions/{NAME}", program.address);
    let upload = form(&photo(40, 30), json!({"p": [[5, 5]]}).to_string());
    assert_eq!(
        http.put(url(&program))
            .multipart(upload)
            .send()
            .await
            .unwrap()
            .status(),
        201
    );
    let drag = |program: &Program, seq: u64| {
        http.post(url(program) + "/warp")
            .json(&json!({"q": [[6, 5]], "seq": seq}))
            .send()
    };
    assert_eq!(drag(&program, 9).await.unwrap().status(), 200);
    program.terminate();
    assert_eq!(program.wait().0.code(), Some(0));
    let program = Program::start(&["--store", &store]);
    problem(drag(&program, 8).await.unwrap(), 409, "superseded").await;
    assert_eq!(drag(&program, 9).await.unwrap().status(), 200);
}

/// A limit on the file's length is a disk that is full for this process alone.
#[tokio::test]
async fn a_full_disk_refuses_uploads_and_goes_on() {
    let scratch = Scratch::new();
    let store = format!("file:{}", scratch.path("sessions.db"));
    let serve = mlswarp(&["serve", "--listen", "127.0.0.1:0", "--store", &store]);
    let mut limited = Command::new("sh");
    limited.args([
        "-c",
        "trap '' XFSZ; exec prlimit --fsize=3000000:unlimited \"$@\"",
        "sh",
    ]);
    limited
        .arg(serve.get_program())
        .args(serve.get_args())
        .arg0("sh");
    for (name, value) in serve.get_envs() {
        match value {
            Some(value) => limited.env(name, value),
            None => limited.env_remove(name),
        };
    }
    let program = Program::spawn(limited);
    let http = Client::new();
    let url = |path: &str| format!("http://{}{path}", program.address);
    let upload = |k: u32| {
        http.post(url("/sessions"))
            .multipart(form(
                &photo(500 + k, 400),
                json!({"p": [[5, 5]]}).to_string(),
            ))
            .send()
    };
    let mut made = Vec::new();
    let full = loop {
        assert!(made.len() < 30, "3 MB hold no 30 photographs");
        let answer = upload(made.len() as u32).await.unwrap();
        if answer.status() != 201 {
            break answer;
        }
        made.push(
            answer.json::<Value>().await.unwrap()["id"]
                .as_str()
                .unwrap()
                .to_owned(),
        );
    };
    assert!(!made.is_empty());
    refused(full).await;
    refused(upload(99).await.unwrap()).await;
    let drag = |id: &str| {
        http.post(url(&format!("/sessions/{id}/warp")))
            .json(&json!({"q": [[6, 5]]}))
            .send()
    };
    for id in &made {
        png(drag(id).await.unwrap()).await;
    }
    let unlimited = [
        "--pid",
        &program.id().to_string(),
        "--fsize=unlimited:unlimited",
    ];
    assert!(
        Command::new("prlimit")
            .args(unlimited)
            .stdout(Stdio::null())
            .status()
            .unwrap()
            .success()
    );
    let mut last = upload(100).await.unwrap();
    for _ in 0..100 {
        if last.status() == 201 {
            break;
        }
        refused(last).await;
        tokio::time::sleep(Duration::from_millis(100)).await;
        last = upload(100).await.unwrap();
    }
    assert_eq!(last.status(), 201, "there is room again");
    assert_eq!(http.get(url("/readyz")).send().await.unwrap().status(), 200);
    made.push(
        last.json::<Value>().await.unwrap()["id"]
            .as_str()
            .unwrap()
            .to_owned(),
    );

    drop(program);
    let program = Program::start(&["--store", &store]);
    for id in made {
        let session = http
            .get(format!("http://{}/sessions/{id}", program.address))
            .send()
            .await
            .unwrap();
        assert_eq!(session.status(), 200);
    }
}

#[tokio::test(flavor = "multi_thread", worker_threads = 4)]
async fn warm_sessions_go_on_while_redis_is_away() {
    let mut redis = Redis::start(&[]);
    let server = Server::start(&["--store", &redis.address()]).await;
    let (warm, cold) = (
        server
            .session(&photo(40, 30), &json!({"p": [[5, 5]]}))
            .await,
        NAME,
    );
    png(server.drag(&warm, &json!({"q": [[6, 6]]})).await).await;
    redis.kill();
    for seq in 1..5 {
        png(server
            .drag(&warm, &json!({"q": [[6, 7]], "seq": seq}))
            .await)
        .await;
    }
    problem(
        server.drag(&warm, &json!({"q": [[6, 7]], "seq": 2})).await,
        409,
        "superseded",
    )
    .await;
    for (path, body) in [
        ("mesh", json!({"q": [[6, 6]]})),
        ("points", json!({"q": [[6, 6]], "points": [[1, 1]]})),
    ] {
        assert_eq!(
            server
                .post(&format!("/sessions/{warm}/{path}"))
                .json(&body)
                .send()
                .await
                .unwrap()
                .status(),
            200
        );
    }
    assert_eq!(
        server
            .get(&format!("/sessions/{warm}"))
            .send()
            .await
            .unwrap()
            .status(),
        200
    );
    refused(server.drag(cold, &json!({"q": [[6, 6]]})).await).await;
    refused(
        server
            .upload("/sessions", &photo(20, 20), &json!({"p": []}))
            .await,
    )
    .await;
    refused(
        server
            .client
            .delete(server.url(&format!("/sessions/{warm}")))
            .send()
            .await
            .unwrap(),
    )
    .await;
    // All replicas have lost it: none is better than another, and this one still serves who is
    // here.
    let ready = server.get("/readyz").send().await.unwrap();
    assert_eq!(
        (
            ready.status(),
            ready.json::<Value>().await.unwrap()["store"].clone()
        ),
        (reqwest::StatusCode::OK, json!("unavailable"))
    );
    assert!(
        server
            .get("/metrics")
            .send()
            .await
            .unwrap()
            .text()
            .await
            .unwrap()
            .contains("mlswarp_store_up 0\n")
    );
    let newcomer = Server::start(&["--store", &redis.address()]).await;
    refused(newcomer.get("/readyz").send().await.unwrap()).await;
    assert_eq!(server.get("/healthz").send().await.unwrap().status(), 200);
    // A picture alone needs no store.
    png(server
        .upload(
            "/warp",
            &photo(20, 20),
            &json!({"p": [[3, 3]], "q": [[4, 4]]}),
        )
        .await)
    .await;

    redis.start_again();
    for _ in 0..100 {
        let whole = server
            .get("/readyz")
            .send()
            .await
            .unwrap()
            .json::<Value>()
            .await
            .unwrap()["store"]
            == "available";
        if whole && newcomer.get("/readyz").send().await.unwrap().status() == 200 {
            break;
        }
        tokio::time::sleep(Duration::from_millis(100)).await;
    }
    assert!(
        server
            .get("/metrics")
            .send()
            .await
            .unwrap()
            .text()
            .await
            .unwrap()
            .contains("mlswarp_store_up 1\n")
    );
    problem(
        server.drag(&warm, &json!({"q": [[6, 6]]})).await,
        404,
        "no_such_session",
    )
    .await;
    server
        .session(&photo(40, 30), &json!({"p": [[5, 5]]}))
        .await;
}

#[tokio::test(flavor = "multi_thread", worker_threads = 4)]
async fn two_replicas_on_one_redis_are_one_service() {
    let redis = Redis::start(&[]);
    let (a, b) = (
        Server::start(&["--store", &redis.address()]).await,
        Server::start(&["--store", &redis.address()]).await,
    );
    assert_eq!(put(&a, &photo(40, 30)).await, 201);
    let drag = json!({"q": [[8, 6]], "seq": 4});
    let (first, second) = (
        png(a.drag(NAME, &drag).await).await,
        png(b.drag(NAME, &drag).await).await,
    );
    // Each has built the table once: one when the session was made, the other when it was used
    // there.
    for server in [&a, &b] {
        let text = server
            .get("/metrics")
            .send()
            .await
            .unwrap()
            .text()
            .await
            .unwrap();
        assert!(
            text.contains("mlswarp_cache_builds_total{cache=\"plans\"} 1\n"),
            "{text}"
        );
    }
    assert!(first == second, "the same picture from either");
    problem(
        a.drag(NAME, &json!({"q": [[8, 6]], "seq": 3})).await,
        409,
        "superseded",
    )
    .await;
    problem(
        b.drag(NAME, &json!({"q": [[8, 6]], "seq": 3})).await,
        409,
        "superseded",
    )
    .await;

    let handles = b
        .client
        .put(b.url(&format!("/sessions/{NAME}/handles")))
        .json(&json!({"p": [[5, 5], [9, 9]]}))
        .send();
    assert_eq!(handles.await.unwrap().status(), 200);
    problem(
        a.drag(NAME, &json!({"q": [[8, 6]]})).await,
        422,
        "shape_mismatch",
    )
    .await;
    png(a.drag(NAME, &json!({"q": [[8, 6], [9, 9]]})).await).await;

    assert_eq!(put(&b, &photo(50, 20)).await, 200);
    let fresh = png(a.drag(NAME, &json!({"q": [[8, 6]], "seq": 0})).await).await;
    assert_eq!(crate::support::picture::decoded(&fresh).width, 50);
    assert_eq!(
        a.client
            .delete(a.url(&format!("/sessions/{NAME}")))
            .send()
            .await
            .unwrap()
            .status(),
        204
    );
    problem(
        b.drag(NAME, &json!({"q": [[8, 6]]})).await,
        404,
        "no_such_session",
    )
    .await;
}
