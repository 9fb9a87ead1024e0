//! Sessions that change: named by the client, replaced by another `PUT`, given other handles.

use reqwest::{Method, Response};
use serde_json::{Value, json};

use crate::support::server::{form, header, png, problem};
use crate::support::{Server, photo};

const NAME: &str = "3e6cbb0e-5b4f-4f0c-9b7e-0a8f2c6a1d11";

async fn put(server: &Server, name: &str, image: &[u8], warp: &Value) -> Response {
    server
        .client
        .request(Method::PUT, server.url(&format!("/sessions/{name}")))
        .multipart(form(image, warp.to_string()))
        .send()
        .await
        .unwrap()
}

async fn handles(server: &Server, name: &str, warp: &Value) -> Response {
    server
        .client
        .request(
            Method::PUT,
            server.url(&format!("/sessions/{name}/handles")),
        )
        .json(warp)
        .send()
        .await
        .unwrap()
}

async fn drag(server: &Server, body: &Value) -> Response {
    server
        .post(&format!("/sessions/{NAME}/warp"))
        .json(body)
        .send()
        .await
        .unwrap()
}

async fn one_shot(server: &Server, image: &[u8], warp: &Value) -> Vec<u8> {
    png(server.upload("/warp", image, warp).await).await
}

#[tokio::test]
async fn a_client_names_its_session_and_the_same_body_twice_is_one_session() {
    let server = Server::start(&["--max-sessions", "1"]).await;
    let (file, warp) = (photo(60, 40), json!({"p": [[20, 10]]}));
    let first = put(&server, NAME, &file, &warp).await;
    assert_eq!(
        (first.status().as_u16(), header(&first, "location")),
        (201, format!("/sessions/{NAME}").as_str())
    );
    let first: Value = first.json().await.unwrap();
    assert_eq!(first["id"], NAME);
    assert_eq!(
        drag(&server, &json!({"q": [[22, 11]], "seq": 9}))
            .await
            .status(),
        200
    );

    let again = put(&server, NAME, &file, &warp).await;
    assert_eq!(again.status(), 200);
    let again: Value = again.json().await.unwrap();
    assert_eq!(
        (&again["created"], &again["seq"]),
        (&first["created"], &json!(9)),
        "the same session"
    );
    problem(
        server.upload("/sessions", &file, &warp).await,
        503,
        "overloaded",
    )
    .await;
}

#[tokio::test]
async fn another_body_replaces_the_session() {
    let server = Server::start(&[]).await;
    put(&server, NAME, &photo(60, 40), &json!({"p": [[20, 10]]})).await;
    assert_eq!(
        drag(&server, &json!({"q": [[22, 11]], "seq": 9}))
            .await
            .status(),
        200
    );
    let (file, warp) = (
        photo(50, 30),
        json!({"p": [[20, 10], [40, 20]], "method": "affine"}),
    );
    let replaced = put(&server, NAME, &file, &warp).await;
    assert_eq!(replaced.status(), 200);
    let replaced: Value = replaced.json().await.unwrap();
    assert_eq!(
        (
            &replaced["image"]["width"],
            &replaced["method"],
            &replaced["seq"]
        ),
        (&json!(50), &json!("affine"), &Value::Null)
    );

    // Numbers start from the beginning, and the picture is the new one.
    let q = json!([[18, 12], [41, 21]]);
    let answer = drag(&server, &json!({"q": q, "seq": 0})).await;
    assert_eq!(answer.status(), 200);
    let mut whole = warp.clone();
    whole["q"] = q;
    assert!(png(answer).await == one_shot(&server, &file, &whole).await);
}

#[tokio::test]
async fn a_name_that_is_no_uuid_of_version_4_is_refused() {
    let server = Server::start(&[]).await;
    for name in [
        "mine",
        "6ba7b810-9dad-11d1-80b4-00c04fd430c8",
        "3e6cbb0e5b4f4f0c9b7e0a8f2c6a1d11",
    ] {
        problem(
            put(&server, name, &photo(8, 8), &json!({})).await,
            422,
            "bad_value",
        )
        .await;
    }
    problem(
        put(&server, NAME, b"no picture", &json!({})).await,
        415,
        "unsupported_format",
    )
    .await;
    assert_eq!(
        server
            .get(&format!("/sessions/{NAME}"))
            .send()
            .await
            .unwrap()
            .status(),
        404,
        "nothing was made"
    );
}

#[tokio::test]
async fn other_handles_on_the_same_picture() {
    let server = Server::start(&[]).await;
    let file = photo(60, 40);
    let made = json!({"p": [[20, 10], [50, 30]], "weights": [1, 2], "method": "similarity",
        "grid": {"cell": 3}, "output": {"compression": "none"}});
    put(&server, NAME, &file, &made).await;
    assert_eq!(
        drag(&server, &json!({"q": [[22, 11], [50, 30]], "seq": 4}))
            .await
            .status(),
        200
    );

    // A line changes the default of alpha; weights went with their handles; the rest stays.
    let answer = handles(
        &server,
        NAME,
        &json!({"p": [[20, 10], [[5, 30], [40, 35]]]}),
    )
    .await;
    assert_eq!(answer.status(), 200);
    let session: Value = answer.json().await.unwrap();
    assert_eq!(
        (&session["alpha"], &session["weights"], &session["seq"]),
        (&json!(2.0), &Value::Null, &json!(4))
    );
    assert_eq!(
        (&session["method"], &session["grid"]["requested"]),
        (&json!("similarity"), &json!({"cell": 3.0}))
    );
    let q = json!([[22, 12], [[5, 31], [41, 33]]]);
    let answer = drag(&server, &json!({"q": q, "seq": 5})).await;
    assert_eq!(
        header(&answer, "warp-plan"),
        "hit",
        "the plan was made before the answer"
    );
    let mut whole = made.clone();
    (whole["p"], whole["q"]) = (json!([[20, 10], [[5, 30], [40, 35]]]), q.clone());
    whole.as_object_mut().unwrap().remove("weights");
    assert!(png(answer).await == one_shot(&server, &file, &whole).await);
    problem(
        drag(&server, &json!({"q": [[22, 11], [50, 30]], "seq": 6})).await,
        422,
        "shape_mismatch",
    )
    .await;
    problem(
        drag(&server, &json!({"q": q, "seq": 3})).await,
        409,
        "superseded",
    )
    .await;

    // A field alone.
    let answer = handles(&server, NAME, &json!({"method": "affine"})).await;
    let session: Value = answer.json().await.unwrap();
    assert_eq!(
        (&session["method"], &session["p"]),
        (
            &json!("affine"),
            &json!([[20.0, 10.0], [[5.0, 30.0], [40.0, 35.0]]])
        )
    );
}

#[tokio::test]
async fn handles_that_are_refused_leave_the_session_as_it_was() {
    let server = Server::start(&[]).await;
    put(&server, NAME, &photo(60, 40), &json!({"p": [[20, 10]]})).await;
    let before: Value = server
        .get(&format!("/sessions/{NAME}"))
        .send()
        .await
        .unwrap()
        .json()
        .await
        .unwrap();
    for (body, code) in [
        (json!({"p": [[[3, 3], [3, 3]]]}), "degenerate_line"),
        (json!({"alpha": 9}), "alpha_out_of_range"),
        (
            json!({"p": [[1, 1], [1, 1]], "q": [[2, 2], [3, 3]],
                "coincident": {"policy": "reject"}}),
            "contradictory_handles",
        ),
        (
            json!({"p": [[1, 1]], "q": [[2, 2], [3, 3]]}),
            "shape_mismatch",
        ),
        (json!({"seq": 1}), "unknown_field"),
        (json!({"weights": [1, 2]}), "shape_mismatch"),
    ] {
        let refused = handles(&server, NAME, &body).await;
        let status = refused.status();
        let document: Value = refused.json().await.unwrap();
        assert_eq!(
            (status.as_u16(), &document["code"]),
            (422, &json!(code)),
            "{body}: {document}"
        );
    }
    let mut after: Value = server
        .get(&format!("/sessions/{NAME}"))
        .send()
        .await
        .unwrap()
        .json()
        .await
        .unwrap();
    after["expires"] = before["expires"].clone();
    assert_eq!(after, before);
    problem(
        handles(&server, "00000000-0000-4000-8000-000000000000", &json!({})).await,
        404,
        "no_such_session",
    )
    .await;
}

#[tokio::test]
async fn hands_that_change_different_fields_at_once_lose_nothing() {
    let server = Server::start(&[]).await;
    put(&server, NAME, &photo(60, 40), &json!({"p": [[20, 10]]})).await;
    let patches = [
        json!({"method": "affine"}),
        json!({"alpha": 1.5}),
        json!({"grid": {"cell": 6}}),
        json!({"folds": "reject"}),
    ];
    let all = patches.map(|patch| {
        let ask = server
            .client
            .request(
                Method::PUT,
                server.url(&format!("/sessions/{NAME}/handles")),
            )
            .json(&patch)
            .send();
        tokio::spawn(async move { ask.await.unwrap().status().as_u16() })
    });
    for one in all {
        assert_eq!(one.await.unwrap(), 200);
    }
    let session: Value = server
        .get(&format!("/sessions/{NAME}"))
        .send()
        .await
        .unwrap()
        .json()
        .await
        .unwrap();
    let found = (
        &session["method"],
        &session["alpha"],
        &session["grid"]["requested"],
        &session["folds"],
    );
    assert_eq!(
        found,
        (
            &json!("affine"),
            &json!(1.5),
            &json!({"cell": 6.0}),
            &json!("reject")
        )
    );
}

#[tokio::test]
async fn a_session_that_is_made_again_while_drags_wait_is_never_missing() {
    let server = Server::start(&["--workers", "1"]).await;
    let (files, warp) = (
        [photo(600, 400), photo(500, 300)],
        json!({"p": [[20, 10], [90, 40]]}),
    );
    put(&server, NAME, &files[0], &warp).await;
    let clients: Vec<_> = (0..6)
        .map(|n| {
            let (client, url) = (
                server.client.clone(),
                server.url(&format!("/sessions/{NAME}/warp")),
            );
            tokio::spawn(async move {
                let mut answers = Vec::new();
                for k in 0..20 {
                    let body = json!({"q": [[21 + n, 10 + k], [90, 40]]});
                    answers.push(
                        client
                            .post(&url)
                            .json(&body)
                            .send()
                            .await
                            .unwrap()
                            .status()
                            .as_u16(),
                    );
                }
                answers
            })
        })
        .collect();
    for k in 1..13 {
        assert_eq!(put(&server, NAME, &files[k % 2], &warp).await.status(), 200);
    }
    for client in clients {
        assert_eq!(client.await.unwrap(), [200; 20]);
    }
}
