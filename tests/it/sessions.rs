//! Sessions: what they tell, how they end, and the newest pose.

use std::time::Duration;

use serde_json::{Value, json};

use crate::support::server::{header, png, problem};
use crate::support::{Server, photo};

#[tokio::test]
async fn a_session_tells_what_it_is() {
    let server = Server::start(&[]).await;
    let file = photo(64, 48);
    let warp =
        json!({"p": [[0.5, 0.5], [[0.1, 0.2], [0.6, 0.2]]], "weights": [2, 1], "units": "normalized", "grid": {"columns": 9, "rows": 7}});
    let response = server.upload("/sessions", &file, &warp).await;
    assert_eq!(response.status(), 201);
    let location = header(&response, "location").to_owned();
    let object: Value = response.json().await.unwrap();
    assert_eq!(location, format!("/sessions/{}", object["id"].as_str().unwrap()));
    assert_eq!(object["image"]["width"], 64);
    assert_eq!(object["image"]["height"], 48);
    assert_eq!(object["image"]["digest"], format!("sha256:{}", mlswarp::warp::Digest::of(&file)));
    assert_eq!(object["p"], json!([[0.5, 0.5], [[0.1, 0.2], [0.6, 0.2]]]));
    assert_eq!(object["weights"], json!([2.0, 1.0]));
    assert_eq!((&object["method"], &object["units"]), (&json!("rigid"), &json!("normalized")));
    assert_eq!(object["alpha"], 2.0, "the default with a line");
    assert_eq!(object["point_mass"], 32.0, "the segment's length, px");
    assert_eq!((&object["grid"]["columns"], &object["grid"]["rows"]), (&json!(9), &json!(7)));
    assert_eq!(object["folds"], "report");
    assert_eq!(object["output"]["format"], "png");
    assert_eq!(object["seq"], Value::Null);
    let (created, expires) = (object["created"].as_str().unwrap(), object["expires"].as_str().unwrap());
    assert!(created < expires && created.ends_with('Z') && created.len() == 24, "{created} {expires}");
    let read: Value = server.get(&location).send().await.unwrap().json().await.unwrap();
    for field in ["id", "image", "p", "alpha", "grid", "created"] {
        assert_eq!(read[field], object[field], "{field}");
    }
}

#[tokio::test]
async fn a_deleted_session_is_gone() {
    let server = Server::start(&[]).await;
    let id = server.session(&photo(16, 12), &json!({"p": [[2, 2]]})).await;
    let path = format!("/sessions/{id}");
    assert_eq!(server.client.delete(server.url(&path)).send().await.unwrap().status(), 204);
    problem(server.client.delete(server.url(&path)).send().await.unwrap(), 404, "no_such_session").await;
    problem(server.get(&path).send().await.unwrap(), 404, "no_such_session").await;
    problem(server.drag(&json!({"session": id, "q": [[3, 2]]})).await, 404, "no_such_session").await;
    server.is_well().await;
}

#[tokio::test]
async fn the_picture_and_the_plan_go_with_the_last_session_that_uses_them() {
    let server = Server::start(&[]).await;
    let (file, warp) = (photo(24, 18), json!({"p": [[2, 2], [20, 3], [9, 15]]}));
    let built = |expected: &'static str| {
        let (server, file, warp) = (&server, &file, &warp);
        async move {
            let mut object = warp.clone();
            object["q"] = object["p"].clone();
            let response = server.upload("/warp", file, &object).await;
            assert_eq!(header(&response, "warp-plan"), expected);
        }
    };
    let (first, second) = (server.session(&file, &warp).await, server.session(&file, &warp).await);
    built("hit").await;
    for (id, expected) in [(first, "hit"), (second, "built")] {
        assert_eq!(server.client.delete(server.url(&format!("/sessions/{id}"))).send().await.unwrap().status(), 204);
        built(expected).await;
    }
}

#[tokio::test]
async fn points_out_of_range_are_refused_and_change_nothing_for_others() {
    let server = Server::start(&[]).await;
    let far = json!({"extent": [64, 48], "p": [[1, 1], [30, 9]], "q": [[2, 1], [31, 19]], "points": [[5, 5], [1e300, 1e300]]});
    for _ in 0..4 {
        let response = server.client.post(server.url("/points")).json(&far).send().await.unwrap();
        assert_eq!(problem(response, 422, "bad_value").await["pointer"], "/points/1");
        let none = json!({"extent": [64, 48], "points": [[1, 1]]});
        let answer: Value = server.client.post(server.url("/points")).json(&none).send().await.unwrap().json().await.unwrap();
        assert_eq!(answer, json!({"points": [[1.0, 1.0]]}));
    }
}

#[tokio::test]
async fn an_idle_session_expires_is_told_so_and_then_forgotten() {
    let server = Server::start(&["--session-idle", "400ms"]).await;
    let id = server.session(&photo(16, 12), &json!({"p": [[2, 2]]})).await;
    let body = json!({"session": id, "q": [[3, 2]]});
    for _ in 0..4 {
        tokio::time::sleep(Duration::from_millis(150)).await;
        png(server.drag(&body).await).await;
    }
    tokio::time::sleep(Duration::from_millis(500)).await;
    problem(server.drag(&body).await, 410, "session_expired").await;
    problem(server.get(&format!("/sessions/{id}")).send().await.unwrap(), 410, "session_expired").await;
    tokio::time::sleep(Duration::from_millis(500)).await;
    problem(server.drag(&body).await, 404, "no_such_session").await;
    server.is_well().await;
}

#[tokio::test]
async fn a_lower_seq_is_superseded_and_an_equal_one_is_a_retry() {
    let server = Server::start(&[]).await;
    let id = server.session(&photo(16, 12), &json!({"p": [[2, 2]]})).await;
    let pose = |seq: u64| json!({"q": [[3, 2]], "seq": seq});
    let send = |seq: u64| server.post(&format!("/sessions/{id}/warp")).json(&pose(seq)).send();
    png(send(7).await.unwrap()).await;
    png(send(7).await.unwrap()).await;
    let begun = server.app.counters().pictures_begun;
    problem(send(6).await.unwrap(), 409, "superseded").await;
    assert_eq!(server.app.counters().pictures_begun, begun, "nothing was drawn");
    png(send(8).await.unwrap()).await;
    let unnumbered = server.drag(&json!({"session": id, "q": [[3, 2]]})).await;
    png(unnumbered).await;
    let read: Value = server.get(&format!("/sessions/{id}")).send().await.unwrap().json().await.unwrap();
    assert_eq!(read["seq"], 8);
}

#[tokio::test]
async fn a_full_store_refuses_newcomers_and_serves_the_living() {
    let server = Server::start(&["--max-sessions", "1"]).await;
    let id = server.session(&photo(16, 12), &json!({"p": [[2, 2]]})).await;
    let refused = server.upload("/sessions", &photo(16, 12), &json!({"p": [[2, 2]]})).await;
    assert!(refused.headers().get("retry-after").is_some());
    let document = problem(refused, 503, "overloaded").await;
    assert_eq!((&document["limit_name"], &document["limit"]), (&json!("sessions"), &json!(1)));
    png(server.drag(&json!({"session": id, "q": [[3, 2]]})).await).await;
}

#[tokio::test]
async fn points_are_mapped_by_a_session_and_without_one() {
    let server = Server::start(&[]).await;
    let id = server.session(&photo(64, 48), &json!({"p": [[10, 10], [50, 40]]})).await;
    let body = json!({"q": [[12, 10], [50, 40]], "points": [[10, 10], [50, 40], [30, 20]]});
    let by_session: Value = server.post(&format!("/sessions/{id}/points")).json(&body).send().await.unwrap().json().await.unwrap();
    let mut whole = body.clone();
    whole["p"] = json!([[10, 10], [50, 40]]);
    whole["extent"] = json!([64, 48]);
    let alone: Value = server.post("/points").json(&whole).send().await.unwrap().json().await.unwrap();
    assert_eq!(by_session, alone);
    let near = |place: &Value, x: f64, y: f64| {
        let d = (place[0].as_f64().unwrap() - x).hypot(place[1].as_f64().unwrap() - y);
        assert!(d < 1e-9, "{place}");
    };
    near(&alone["points"][0], 12.0, 10.0);
    near(&alone["points"][1], 50.0, 40.0);
    assert_eq!(alone["points"].as_array().unwrap().len(), 3);
}
