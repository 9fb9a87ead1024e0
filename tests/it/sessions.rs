//! Sessions: what they tell, how they end, and the newest pose.

use std::time::Duration;

use serde_json::{Value, json};

use crate::support::counters::Counted as _;
use crate::support::server::{header, png, problem};
use crate::support::{Server, photo};

#[tokio::test]
async fn a_session_tells_what_it_is() {
    let server = Server::start(&[]).await;
    let file = photo(64, 48);
    let warp = json!({"p": [[0.5, 0.5], [[0.1, 0.2], [0.6, 0.2]]], "weights": [2, 1],
        "units": "normalized", "grid": {"columns": 9, "rows": 7}});
    let response = server.upload("/sessions", &file, &warp).await;
    assert_eq!(response.status(), 201);
    let location = header(&response, "location").to_owned();
    let object: Value = response.json().await.unwrap();
    assert_eq!(
        location,
        format!("/sessions/{}", object["id"].as_str().unwrap())
    );
    assert_eq!(object["image"]["width"], 64);
    assert_eq!(object["image"]["height"], 48);
    assert_eq!(
        object["image"]["digest"],
        format!("sha256:{}", mlswarp::warp::Digest::of(&file))
    );
    assert_eq!(object["p"], json!([[0.5, 0.5], [[0.1, 0.2], [0.6, 0.2]]]));
    assert_eq!(object["weights"], json!([2.0, 1.0]));
    assert_eq!(
        (&object["method"], &object["units"]),
        (&json!("rigid"), &json!("normalized"))
    );
    assert_eq!(object["alpha"], 2.0, "the default with a line");
    assert_eq!(object["point_mass"], 32.0, "the segment's length, px");
    assert_eq!(
        (&object["grid"]["columns"], &object["grid"]["rows"]),
        (&json!(9), &json!(7))
    );
    assert_eq!(object["folds"], "report");
    assert_eq!(object["output"]["format"], "png");
    assert_eq!(object["seq"], Value::Null);
    let (created, expires) = (
        object["created"].as_str().unwrap(),
        object["expires"].as_str().unwrap(),
    );
    assert!(
        created < expires && created.ends_with('Z') && created.len() == 24,
        "{created} {expires}"
    );
    let read: Value = server
        .get(&location)
        .send()
        .await
        .unwrap()
        .json()
        .await
        .unwrap();
    for field in ["id", "image", "p", "alpha", "grid", "created"] {
        assert_eq!(read[field], object[field], "{field}");
    }
}

#[tokio::test]
async fn a_deleted_session_is_gone() {
    let server = Server::start(&[]).await;
    let id = server
        .session(&photo(16, 12), &json!({"p": [[2, 2]]}))
        .await;
    let path = format!("/sessions/{id}");
    for _ in 0..2 {
        assert_eq!(
            server
                .client
                .delete(server.url(&path))
                .send()
                .await
                .unwrap()
                .status(),
            204
        );
    }
    let never = format!("/sessions/{}", uuid::Uuid::new_v4());
    problem(
        server
            .client
            .delete(server.url(&never))
            .send()
            .await
            .unwrap(),
        404,
        "no_such_session",
    )
    .await;
    problem(
        server.get(&path).send().await.unwrap(),
        404,
        "no_such_session",
    )
    .await;
    problem(
        server.drag(&id, &json!({"q": [[3, 2]]})).await,
        404,
        "no_such_session",
    )
    .await;
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
    let (first, second) = (
        server.session(&file, &warp).await,
        server.session(&file, &warp).await,
    );
    built("hit").await;
    for (id, expected) in [(first, "hit"), (second, "built")] {
        assert_eq!(
            server
                .client
                .delete(server.url(&format!("/sessions/{id}")))
                .send()
                .await
                .unwrap()
                .status(),
            204
        );
        built(expected).await;
    }
}

#[tokio::test]
async fn points_out_of_range_are_refused_and_change_nothing_for_others() {
    let server = Server::start(&[]).await;
    let far = json!({"extent": [64, 48], "p": [[1, 1], [30, 9]], "q": [[2, 1], [31, 19]],
        "points": [[5, 5], [1e300, 1e300]]});
    for _ in 0..4 {
        let response = server
            .client
            .post(server.url("/points"))
            .json(&far)
            .send()
            .await
            .unwrap();
        assert_eq!(
            problem(response, 422, "bad_value").await["pointer"],
            "/points/1"
        );
        let none = json!({"extent": [64, 48], "points": [[1, 1]]});
        let answer: Value = server
            .client
            .post(server.url("/points"))
            .json(&none)
            .send()
            .await
            .unwrap()
            .json()
            .await
            .unwrap();
        assert_eq!(answer, json!({"points": [[1.0, 1.0]]}));
    }
}

#[tokio::test]
async fn an_idle_session_expires_is_told_so_and_then_forgotten() {
    let server = Server::start(&["--session-idle", "400ms"]).await;
    let id = server
        .session(&photo(16, 12), &json!({"p": [[2, 2]]}))
        .await;
    let body = json!({"q": [[3, 2]]});
    for _ in 0..4 {
        tokio::time::sleep(Duration::from_millis(150)).await;
        png(server.drag(&id, &body).await).await;
    }
    tokio::time::sleep(Duration::from_millis(500)).await;
    problem(server.drag(&id, &body).await, 410, "session_expired").await;
    problem(
        server.get(&format!("/sessions/{id}")).send().await.unwrap(),
        410,
        "session_expired",
    )
    .await;
    tokio::time::sleep(Duration::from_millis(500)).await;
    problem(server.drag(&id, &body).await, 404, "no_such_session").await;
    server.is_well().await;
}

#[tokio::test]
async fn a_lower_seq_is_superseded_and_an_equal_one_is_a_retry() {
    let server = Server::start(&[]).await;
    let id = server
        .session(&photo(16, 12), &json!({"p": [[2, 2]]}))
        .await;
    let pose = |seq: u64| json!({"q": [[3, 2]], "seq": seq});
    let send = |seq: u64| {
        server
            .post(&format!("/sessions/{id}/warp"))
            .json(&pose(seq))
            .send()
    };
    png(send(7).await.unwrap()).await;
    png(send(7).await.unwrap()).await;
    let begun = server.app.counters().pictures_begun;
    problem(send(6).await.unwrap(), 409, "superseded").await;
    assert_eq!(
        server.app.counters().pictures_begun,
        begun,
        "nothing was drawn"
    );
    png(send(8).await.unwrap()).await;
    let unnumbered = server.drag(&id, &json!({"q": [[3, 2]]})).await;
    png(unnumbered).await;
    let read: Value = server
        .get(&format!("/sessions/{id}"))
        .send()
        .await
        .unwrap()
        .json()
        .await
        .unwrap();
    assert_eq!(read["seq"], 8);
}

#[tokio::test]
async fn a_full_store_refuses_newcomers_and_serves_the_living() {
    let server = Server::start(&["--max-sessions", "1"]).await;
    let id = server
        .session(&photo(16, 12), &json!({"p": [[2, 2]]}))
        .await;
    let refused = server
        .upload("/sessions", &photo(16, 12), &json!({"p": [[2, 2]]}))
        .await;
    assert!(refused.headers().get("retry-after").is_some());
    let document = problem(refused, 503, "overloaded").await;
    assert_eq!(
        (&document["limit_name"], &document["limit"]),
        (&json!("sessions"), &json!(1))
    );
    png(server.drag(&id, &json!({"q": [[3, 2]]})).await).await;
}

#[tokio::test]
async fn points_are_mapped_by_a_session_and_without_one() {
    let server = Server::start(&[]).await;
    let id = server
        .session(&photo(64, 48), &json!({"p": [[10, 10], [50, 40]]}))
        .await;
    let body = json!({"q": [[12, 10], [50, 40]], "points": [[10, 10], [50, 40], [30, 20]]});
    let by_session: Value = server
        .post(&format!("/sessions/{id}/points"))
        .json(&body)
        .send()
        .await
        .unwrap()
        .json()
        .await
        .unwrap();
    let mut whole = body.clone();
    whole["p"] = json!([[10, 10], [50, 40]]);
    whole["extent"] = json!([64, 48]);
    let alone: Value = server
        .post("/points")
        .json(&whole)
        .send()
        .await
        .unwrap()
        .json()
        .await
        .unwrap();
    assert_eq!(by_session, alone);
    let near = |place: &Value, x: f64, y: f64| {
        let d = (place[0].as_f64().unwrap() - x).hypot(place[1].as_f64().unwrap() - y);
        assert!(d < 1e-9, "{place}");
    };
    near(&alone["points"][0], 12.0, 10.0);
    near(&alone["points"][1], 50.0, 40.0);
    assert_eq!(alone["points"].as_array().unwrap().len(), 3);
}

#[tokio::test]
async fn a_mesh_is_the_grid_where_the_picture_is_drawn() {
    let server = Server::start(&[]).await;
    let (p, q) = (
        json!([[20.0, 15.0], [[40.0, 50.0], [60.0, 30.0]]]),
        json!([[24.0, 17.5], [[38.0, 52.0], [61.0, 33.0]]]),
    );
    for (units, scale) in [("px", [1.0, 1.0]), ("normalized", [1.0 / 80.0, 1.0 / 60.0])] {
        let scaled = |handles: &Value| -> Value {
            let place = |v: &Value| {
                json!([
                    v[0].as_f64().unwrap() * scale[0],
                    v[1].as_f64().unwrap() * scale[1]
                ])
            };
            let handle = |h: &Value| {
                if h[0].is_array() {
                    h.as_array().unwrap().iter().map(place).collect()
                } else {
                    place(h)
                }
            };
            handles.as_array().unwrap().iter().map(handle).collect()
        };
        let warp = json!({"p": scaled(&p), "units": units, "grid": {"cell": 7}});
        let id = server.session(&photo(80, 60), &warp).await;
        let path = format!("/sessions/{id}/mesh");
        let ask = |accept: &str| {
            server
                .post(&path)
                .header("accept", accept)
                .json(&json!({"q": scaled(&q)}))
                .send()
        };

        let response = ask("application/json").await.unwrap();
        assert_eq!(
            (response.status().as_u16(), header(&response, "warp-folds")),
            (200, "0")
        );
        assert!(header(&response, "server-timing").contains("deform"));
        let mesh: Value = response.json().await.unwrap();
        let shape =
            json!({"columns": 13, "rows": 10, "width": 80, "height": 60, "cell": [7.0, 7.0]});
        for (name, value) in shape.as_object().unwrap() {
            assert_eq!(mesh[name], *value, "{name}");
        }
        let session: Value = server
            .get(&format!("/sessions/{id}"))
            .send()
            .await
            .unwrap()
            .json()
            .await
            .unwrap();
        assert_eq!(session["grid"]["cell"], json!([7.0, 7.0]));

        // The grid's vertices are the images of its rest places under f: what `/points` says of
        // them.
        let rest: Vec<Value> = (0..10)
            .flat_map(|j| {
                (0..13).map(move |i| {
                    json!([
                        f64::min(f64::from(i) * 7.0, 80.0),
                        f64::min(f64::from(j) * 7.0, 60.0)
                    ])
                })
            })
            .map(|v| {
                json!([
                    v[0].as_f64().unwrap() * scale[0],
                    v[1].as_f64().unwrap() * scale[1]
                ])
            })
            .collect();
        let asked = json!({"q": scaled(&q), "points": rest});
        let mapped: Value = server
            .post(&format!("/sessions/{id}/points"))
            .json(&asked)
            .send()
            .await
            .unwrap()
            .json()
            .await
            .unwrap();
        let numbers = ask("application/octet-stream").await.unwrap();
        assert_eq!(header(&numbers, "content-type"), "application/octet-stream");
        let numbers = numbers.bytes().await.unwrap();
        assert_eq!(numbers.len(), 13 * 10 * 8);
        for (k, vertex) in mesh["vertices"].as_array().unwrap().iter().enumerate() {
            for axis in 0..2 {
                let (got, exact) = (
                    vertex[axis].as_f64().unwrap(),
                    mapped["points"][k][axis].as_f64().unwrap(),
                );
                assert!(
                    (got - exact).abs() < 1e-4 * scale[axis],
                    "vertex {k}: {got} {exact}"
                );
                let bytes: [u8; 4] = numbers[8 * k + 4 * axis..][..4].try_into().unwrap();
                #[expect(clippy::cast_possible_truncation, reason = "the numbers are f32")]
                let rounded = got as f32;
                assert_eq!(f32::from_le_bytes(bytes).to_bits(), rounded.to_bits());
            }
        }
    }
}

#[tokio::test]
async fn a_mesh_is_refused_as_a_drag_is() {
    let server = Server::start(&[]).await;
    let id = server
        .session(&photo(40, 30), &json!({"p": [[10, 10]], "folds": "reject"}))
        .await;
    let ask = |body: Value| {
        server
            .post(&format!("/sessions/{id}/mesh"))
            .json(&body)
            .send()
    };
    problem(
        ask(json!({"q": [[1, 2], [3, 4]]})).await.unwrap(),
        422,
        "shape_mismatch",
    )
    .await;
    problem(
        ask(json!({"q": [[1, 2]], "output": {}})).await.unwrap(),
        422,
        "unknown_field",
    )
    .await;
    assert_eq!(
        ask(json!({"q": [[12, 9]], "seq": 5}))
            .await
            .unwrap()
            .status(),
        200
    );
    problem(
        ask(json!({"q": [[12, 9]], "seq": 4})).await.unwrap(),
        409,
        "superseded",
    )
    .await;
    let png = server
        .post(&format!("/sessions/{id}/mesh"))
        .header("accept", "image/png")
        .json(&json!({"q": [[12, 9]]}))
        .send();
    problem(png.await.unwrap(), 406, "not_acceptable").await;
    let unknown = "/sessions/00000000-0000-4000-8000-000000000000/mesh";
    problem(
        server
            .post(unknown)
            .json(&json!({"q": []}))
            .send()
            .await
            .unwrap(),
        404,
        "no_such_session",
    )
    .await;

    // 1025 x 1025 vertices are more than JSON is written for.
    let id = server
        .session(
            &photo(300, 300),
            &json!({"p": [], "grid": {"columns": 1025, "rows": 1025}}),
        )
        .await;
    let many = |accept: &'static str| {
        server
            .post(&format!("/sessions/{id}/mesh"))
            .header("accept", accept)
            .json(&json!({"q": []}))
            .send()
    };
    let refused = problem(many("*/*").await.unwrap(), 413, "too_large").await;
    assert_eq!(
        (&refused["limit"], &refused["actual"]),
        (&json!(1 << 20), &json!(1025 * 1025))
    );
    assert_eq!(
        many("application/octet-stream")
            .await
            .unwrap()
            .bytes()
            .await
            .unwrap()
            .len(),
        1025 * 1025 * 8
    );
}
