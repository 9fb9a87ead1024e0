//! The pose of a session: `q` of the request that created it, from JSON or landmark files, is what
//! requests without `q` mean.

use std::net::SocketAddr;

use reqwest::multipart::Form;
use reqwest::{Client, Method};
use serde_json::{Value, json};

use crate::support::drag_client::{DragClient, Received};
use crate::support::program::Program;
use crate::support::server::{form, problem};
use crate::support::{Scratch, Server, photo};

const SIZE: (u32, u32) = (64, 48);
const ID: &str = "0f8fad5b-d9cb-469f-a165-70867728950e";
/// Both sides in one file, and in JSON.
const CSV: &str = "px,py,qx,qy\n10,10,14,6\n40,30,44,30\n20,40,20,36\n50,8,50,12\n30,20,32,20\n";

fn rest() -> Value {
    json!([
        [10.0, 10.0],
        [40.0, 30.0],
        [20.0, 40.0],
        [50.0, 8.0],
        [30.0, 20.0]
    ])
}

fn posed() -> Value {
    json!([
        [14.0, 6.0],
        [44.0, 30.0],
        [20.0, 36.0],
        [50.0, 12.0],
        [32.0, 20.0]
    ])
}

fn with(object: &Value, more: &Value) -> Value {
    let mut object = object.as_object().unwrap().clone();
    object.extend(more.as_object().unwrap().clone());
    Value::Object(object)
}

async fn put(server: &Server, path: &str, form: Form) -> (u16, Value) {
    let response = server
        .client
        .request(Method::PUT, server.url(path))
        .multipart(form)
        .send()
        .await
        .unwrap();
    (response.status().as_u16(), response.json().await.unwrap())
}

async fn put_handles(server: &Server, id: &str, body: &Value) -> Value {
    let response = server
        .client
        .put(server.url(&format!("/sessions/{id}/handles")))
        .json(body)
        .send()
        .await
        .unwrap();
    assert_eq!(
        response.status(),
        200,
        "{body}: {:?}",
        response.text().await
    );
    response.json().await.unwrap()
}

/// What the routes that take `q` answer.
async fn answers(server: SocketAddr, id: &str, q: &Value) -> Vec<Vec<u8>> {
    let client = Client::new();
    let mut answers = Vec::new();
    for (path, more) in [
        ("warp", json!({})),
        ("mesh", json!({})),
        (
            "points",
            json!({"points": [[3, 4]], "boxes": [[1, 2, 9, 9]]}),
        ),
        ("map", json!({"width": 8})),
        ("report", json!({})),
        ("batch", json!({"steps": 3})),
        (
            "batch",
            json!({"jitter": {"seed": 1, "count": 2, "sigma": 1}}),
        ),
    ] {
        let response = client
            .post(format!("http://{server}/sessions/{id}/{path}"))
            .json(&with(q, &more))
            .send()
            .await
            .unwrap();
        assert_eq!(
            response.status(),
            200,
            "{path} with {q}: {:?}",
            response.text().await
        );
        answers.push(response.bytes().await.unwrap().to_vec());
    }
    answers
}

#[tokio::test]
async fn requests_without_q_mean_that_of_the_session() {
    let server = Server::start(&[]).await;
    let image = photo(SIZE.0, SIZE.1);
    let plain = server.session(&image, &json!({"p": rest()})).await;
    let of_json = server
        .session(&image, &json!({"p": rest(), "q": posed()}))
        .await;
    let opened = server
        .post("/sessions")
        .multipart(form(&image, "{}").text("landmarks", CSV))
        .send()
        .await
        .unwrap();
    assert_eq!(opened.status(), 201);
    let opened: Value = opened.json().await.unwrap();
    assert_eq!(
        (&opened["q"], &opened["strength"]),
        (&posed(), &Value::Null)
    );
    let drawn = server
        .post("/warp?session=true")
        .multipart(form(&image, json!({"p": rest(), "q": posed()}).to_string()));
    let drawn = drawn.send().await.unwrap().headers()["warp-session"]
        .to_str()
        .unwrap()
        .to_owned();
    for strength in [json!({}), json!({"strength": 0.5}), json!({"strength": -1})] {
        let expected = answers(
            server.address,
            &plain,
            &with(&json!({"q": posed()}), &strength),
        )
        .await;
        for id in [&of_json, opened["id"].as_str().unwrap(), &drawn] {
            assert!(
                answers(server.address, id, &strength).await == expected,
                "{strength}"
            );
            let read: Value = server
                .get(&format!("/sessions/{id}"))
                .send()
                .await
                .unwrap()
                .json()
                .await
                .unwrap();
            assert_eq!(read["q"], posed());
        }
    }
    // A frame may have its own pose, or a share of that of the session.
    let frames = |id: &str, frames: Value| {
        server
            .post(&format!("/sessions/{id}/batch"))
            .json(&json!({"frames": frames}))
            .send()
    };
    let own = frames(
        &plain,
        json!([{"q": rest()}, {"q": posed(), "strength": 0.5}]),
    )
    .await
    .unwrap()
    .bytes()
    .await
    .unwrap();
    let shared = frames(&of_json, json!([{"q": rest()}, {"strength": 0.5}]))
        .await
        .unwrap()
        .bytes()
        .await
        .unwrap();
    assert!(own == shared);
    let fit = async |id: &str, body: Value| {
        server
            .post(&format!("/sessions/{id}/fit"))
            .json(&body)
            .send()
            .await
            .unwrap()
            .text()
            .await
            .unwrap()
    };
    assert_eq!(
        fit(&of_json, json!({})).await,
        fit(&plain, json!({"q": posed()})).await
    );
}

#[tokio::test]
async fn the_socket_knows_the_pose_of_the_session() {
    let server = Server::start(&[]).await;
    let id = server
        .session(
            &photo(SIZE.0, SIZE.1),
            &json!({"p": rest(), "q": posed(), "strength": 2}),
        )
        .await;
    let mut socket =
        DragClient::open(server.address, &id, "?frames=mesh&report=true&window=4").await;
    let mut drawn = Vec::new();
    for (seq, message) in [
        json!({"seq": 0}),
        json!({"seq": 1, "q": posed(), "strength": 2}),
        json!({"seq": 2, "strength": 1}),
        json!({"seq": 3, "q": posed()}),
    ]
    .iter()
    .enumerate()
    {
        socket.say(message).await;
        let Received::Text(report) = socket.next().await else {
            panic!()
        };
        let Received::Frame(_, bytes) = socket.next().await else {
            panic!()
        };
        assert_eq!(report["seq"], seq);
        drawn.push((report["strength"].as_f64().unwrap(), bytes[8..].to_vec()));
        socket.say(&json!({"ack": seq})).await;
    }
    assert!(drawn[0] == drawn[1] && drawn[2] == drawn[3] && drawn[0] != drawn[2]);
    assert_eq!((drawn[0].0, drawn[2].0), (2.0, 1.0));
    // Without a pose, the problem names what is missing.
    let id = server
        .session(&photo(SIZE.0, SIZE.1), &json!({"p": rest()}))
        .await;
    let mut socket = DragClient::open(server.address, &id, "").await;
    socket.say(&json!({"seq": 4})).await;
    let Received::Text(refused) = socket.next().await else {
        panic!()
    };
    assert_eq!(
        (&refused["pointer"], &refused["seq"]),
        (&json!("/q"), &json!(4))
    );
}

#[tokio::test]
async fn other_handles_have_another_pose_or_none() {
    let server = Server::start(&[]).await;
    let id = server
        .session(
            &photo(SIZE.0, SIZE.1),
            &json!({"p": rest(), "q": posed(), "strength": 0.5}),
        )
        .await;
    let other = json!([[1.0, 1.0], [9.0, 9.0]]);
    for (body, q, strength) in [
        (json!({"method": "affine"}), posed(), json!(0.5)),
        (
            json!({"p": rest(), "weights": [1, 2, 3, 4, 5]}),
            posed(),
            json!(0.5),
        ),
        (json!({"strength": 3}), posed(), json!(3.0)),
        (json!({"q": rest()}), rest(), Value::Null),
        (json!({"method": "auto"}), rest(), Value::Null),
        (json!({"p": other}), Value::Null, Value::Null),
        (
            json!({"p": rest(), "q": posed(), "strength": -1}),
            posed(),
            json!(-1.0),
        ),
        (json!({"p": other, "q": other}), other.clone(), Value::Null),
    ] {
        let session = put_handles(&server, &id, &body).await;
        assert_eq!(
            (&session["q"], &session["strength"]),
            (&q, &strength),
            "{body}"
        );
    }
    let session = put_handles(&server, &id, &json!({"p": rest()})).await;
    assert_eq!(session["q"], Value::Null);
    for path in ["warp", "mesh", "points", "map", "report", "fit"] {
        let response = server
            .post(&format!("/sessions/{id}/{path}"))
            .json(&json!({}))
            .send()
            .await
            .unwrap();
        assert_eq!(
            problem(response, 422, "bad_value").await["pointer"],
            "/q",
            "{path}"
        );
    }
    let response = server
        .post(&format!("/sessions/{id}/batch"))
        .json(&json!({"frames": [{"q": rest()}, {}]}))
        .send()
        .await
        .unwrap();
    assert_eq!(
        problem(response, 422, "bad_value").await["pointer"],
        "/frames/1/q"
    );
}

#[tokio::test]
async fn a_pose_is_a_part_of_what_a_session_is_made_from() {
    let server = Server::start(&[]).await;
    let image = photo(SIZE.0, SIZE.1);
    let path = format!("/sessions/{ID}");
    let warp = json!({"p": rest(), "q": posed()}).to_string();
    assert_eq!(put(&server, &path, form(&image, &*warp)).await.0, 201);
    server.drag(ID, &json!({"seq": 7})).await;
    let seq = async |form| put(&server, &path, form).await.1["seq"].clone();
    assert_eq!(seq(form(&image, &*warp)).await, 7, "the same session");
    assert_eq!(
        seq(form(&image, "{}").text("landmarks", CSV)).await,
        7,
        "the same session"
    );
    assert_eq!(
        seq(form(&image, json!({"p": rest()}).to_string())).await,
        Value::Null,
        "another one"
    );
}

#[tokio::test]
async fn a_pose_outlives_the_process() {
    let scratch = Scratch::new();
    let store = format!("file:{}", scratch.path("sessions"));
    let image = photo(SIZE.0, SIZE.1);
    let program = Program::start(&["--store", &store]);
    let warp =
        json!({"p": rest(), "q": posed(), "strength": 0.25, "align": "similarity"}).to_string();
    let put = Client::new()
        .put(format!("http://{}/sessions/{ID}", program.address))
        .multipart(form(&image, warp));
    assert_eq!(put.send().await.unwrap().status(), 201);
    let expected = answers(program.address, ID, &json!({})).await;
    program.terminate();
    assert_eq!(program.wait().0.code(), Some(0));
    let program = Program::start(&["--store", &store]);
    assert!(answers(program.address, ID, &json!({})).await == expected);
}
