//! Handles without a position: a landmark that nobody could see. They are left out, keep their
//! indices, and are named by a warning.

use reqwest::Response;
use reqwest::multipart::Form;
use serde_json::{Value, json};

use crate::support::drag_client::DragClient;
use crate::support::{Server, photo};

const IMAGE: (u32, u32) = (64, 48);

/// Handles at rest and posed, with `null` at 1 (at rest) and 4 (posed), and the same ones without
/// these.
fn sets(has_lines: bool) -> [[Value; 2]; 2] {
    let line = |x: f64| {
        if has_lines {
            json!([[x, 40.0], [x + 20.0, 44.0]])
        } else {
            json!([x, 40.0])
        }
    };
    let p = [
        json!([5, 5]),
        json!(null),
        json!([50, 8]),
        line(20.0),
        json!([30, 30]),
        json!([58, 40]),
    ];
    let q = [
        json!([8, 4]),
        json!([31, 7]),
        json!([49, 12]),
        line(23.0),
        json!(null),
        json!([57, 44]),
    ];
    let present = |set: &[Value]| json!([set[0], set[2], set[3], set[5]]);
    [[json!(p), json!(q)], [present(&p), present(&q)]]
}

fn with(mut object: Value, more: &Value) -> Value {
    object
        .as_object_mut()
        .unwrap()
        .extend(more.as_object().unwrap().clone());
    object
}

fn warning(response: &Response) -> String {
    response
        .headers()
        .get("warp-warning")
        .map(|value| value.to_str().unwrap().to_owned())
        .unwrap_or_default()
}

async fn bytes(response: Response) -> Vec<u8> {
    assert_eq!(response.status(), 200, "{:?}", response.text().await);
    response.bytes().await.unwrap().to_vec()
}

async fn post(server: &Server, path: &str, body: &Value) -> Value {
    let response = server.post(path).json(body).send().await.unwrap();
    let warning = warning(&response);
    let mut json: Value = response.json().await.unwrap();
    json["warning"] = json!(warning);
    json
}

#[tokio::test]
async fn what_is_drawn_and_mapped_is_that_of_the_others_alone() {
    let server = Server::start(&[]).await;
    for (method, has_lines) in [
        ("rigid", true),
        ("similarity", true),
        ("affine", true),
        ("rigid", false),
        ("tps", false),
        ("global_affine", false),
    ] {
        let [[p, q], [p_present, q_present]] = sets(has_lines);
        let missing = json!({"p": p, "q": q, "method": method, "weights": [2, 9, 1, 0.5, 7, 1]});
        let present =
            json!({"p": p_present, "q": q_present, "method": method, "weights": [2, 1, 0.5, 1]});
        let image = photo(IMAGE.0, IMAGE.1);
        let [one, other] = [
            server.upload("/warp", &image, &missing).await,
            server.upload("/warp", &image, &present).await,
        ];
        assert_eq!(
            (warning(&one).as_str(), warning(&other).as_str()),
            ("handles_missing", ""),
            "{method}"
        );
        assert_eq!(
            one.headers()["warp-residual"],
            other.headers()["warp-residual"]
        );
        assert!(bytes(one).await == bytes(other).await, "{method}");
        let extent = json!({"extent": [IMAGE.0, IMAGE.1], "points": [[3, 4], [33, 22]]});
        let [one, other] = [
            post(&server, "/points", &with(missing.clone(), &extent)).await,
            post(&server, "/points", &with(present.clone(), &extent)).await,
        ];
        assert_eq!(
            (&one["points"], &one["warning"]),
            (&other["points"], &json!("handles_missing")),
            "{method}: {one}"
        );
        let extent = json!({"extent": [IMAGE.0, IMAGE.1]});
        let map = async |object: &Value| {
            bytes(
                server
                    .post("/map")
                    .json(&with(object.clone(), &extent))
                    .send()
                    .await
                    .unwrap(),
            )
            .await
        };
        assert!(map(&missing).await == map(&present).await, "{method}");
    }
}

#[tokio::test]
async fn reports_keep_the_indices() {
    let server = Server::start(&[]).await;
    let [[p, q], [p_present, q_present]] = sets(false);
    let extent = json!({"extent": [IMAGE.0, IMAGE.1]});
    let [missing, present] = [
        json!({"p": p, "q": q}),
        json!({"p": p_present, "q": q_present}),
    ]
    .map(|object| with(object, &extent));
    let [one, other] = [
        post(&server, "/report", &missing).await,
        post(&server, "/report", &present).await,
    ];
    let residual = |k: usize| other["residuals"][k].clone();
    assert_eq!(
        one["residuals"],
        json!([
            residual(0),
            null,
            residual(1),
            residual(2),
            null,
            residual(3)
        ])
    );
    assert_eq!(
        one["warnings"],
        json!([{"code": "handles_missing", "handles": [1, 4]}])
    );
    assert_eq!(
        (&one["folds"], &one["shear"]),
        (&other["folds"], &other["shear"])
    );
    let [one, other] = [
        post(&server, "/fit", &missing).await,
        post(&server, "/fit", &present).await,
    ];
    assert_eq!(one["warning"], "handles_missing");
    for (one, other) in one["candidates"]
        .as_array()
        .unwrap()
        .iter()
        .zip(other["candidates"].as_array().unwrap())
    {
        let residual = |k: usize| other["residuals"][k].clone();
        assert_eq!((&one["rms"], &one["max"]), (&other["rms"], &other["max"]));
        assert_eq!(
            one["residuals"],
            json!([
                residual(0),
                null,
                residual(1),
                residual(2),
                null,
                residual(3)
            ])
        );
    }
    // Handles that contradict each other, behind one that is missing.
    let twice = json!({"p": [null, [5, 5], [50, 8], [5, 5], [20, 40]],
        "q": [[1, 1], [8, 4], [49, 12], [2, 9], [23, 40]]});
    let report = post(&server, "/report", &with(twice.clone(), &extent)).await;
    assert_eq!(
        report["coincident"][0]["handles"],
        json!([1, 3]),
        "{report}"
    );
    // One wrong landmark of nine, behind a missing one.
    let lattice: Vec<_> = (0..9)
        .map(|k| json!([10 + 20 * (k % 3), 8 + 15 * (k / 3)]))
        .collect();
    let mut p = vec![json!(null)];
    p.extend(lattice);
    let mut q = p.clone();
    q[5] = json!([36, 30]);
    let fit = post(&server, "/fit", &with(json!({"p": p, "q": q}), &extent)).await;
    assert_eq!(
        fit["candidates"].as_array().unwrap().last().unwrap()["outliers"],
        json!([5]),
        "{fit}"
    );
}

#[tokio::test]
async fn a_session_leaves_out_what_its_handles_at_rest_leave_out() {
    let server = Server::start(&[]).await;
    let image = photo(IMAGE.0, IMAGE.1);
    let [[p, q], [p_present, q_present]] = sets(true);
    let id = server.session(&image, &json!({"p": p, "q": q})).await;
    let other = server.session(&image, &json!({"p": p_present})).await;
    let session: Value = server
        .get(&format!("/sessions/{id}"))
        .send()
        .await
        .unwrap()
        .json()
        .await
        .unwrap();
    assert_eq!(
        (&session["p"][1], &session["p"][4], &session["p"][0]),
        (&json!(null), &json!(null), &json!([5.0, 5.0]))
    );
    let expected = bytes(server.drag(&other, &json!({"q": q_present})).await).await;
    // A position of a handle that is missing is left out too.
    let mut full = q.clone();
    full[4] = json!([1, 2]);
    for q in [&q, &full] {
        let drawn = server.drag(&id, &json!({"q": q})).await;
        assert_eq!(warning(&drawn), "handles_missing");
        assert!(bytes(drawn).await == expected);
    }
    // A handle that has a position at rest needs one.
    let mut fewer = q.clone();
    fewer[2] = json!(null);
    for path in ["warp", "points", "report", "mesh", "map"] {
        let refused = server
            .post(&format!("/sessions/{id}/{path}"))
            .json(&json!({"q": fewer}))
            .send()
            .await
            .unwrap();
        assert_eq!(refused.status(), 422, "{path}");
        let problem: Value = refused.json().await.unwrap();
        assert_eq!(
            (&problem["code"], &problem["pointer"], &problem["handle"]),
            (&json!("bad_value"), &json!("/q/2"), &json!(2)),
            "{path}"
        );
        assert!(
            problem["detail"]
                .as_str()
                .unwrap()
                .contains("PUT /sessions/{id}/handles"),
            "{problem}"
        );
    }
    // So on the socket: in JSON, and as numbers, which a missing handle has none of.
    let mut client = DragClient::open(server.address, &id, "?frames=png").await;
    client.pose(1, &q).await;
    assert!(client.show_until(1).await.pop().unwrap().1 == expected);
    let flat = |value: &Value| {
        value
            .to_string()
            .split(['[', ',', ']'])
            .filter_map(|text| text.parse::<f32>().ok())
            .collect::<Vec<_>>()
    };
    let numbers = flat(&q_present).into_iter().flat_map(f32::to_le_bytes);
    client
        .socket_binary(2_u64.to_le_bytes().into_iter().chain(numbers).collect())
        .await;
    assert!(client.show_until(2).await.pop().unwrap().1 == expected);
    client.pose(3, &fewer).await;
    client.problem("bad_value").await;
    // Other handles at rest: all of them.
    let put = server
        .client
        .put(server.url(&format!("/sessions/{id}/handles")))
        .json(&json!({"p": q}))
        .send()
        .await
        .unwrap();
    assert_eq!(
        (put.status().as_u16(), warning(&put).as_str()),
        (200, "handles_missing")
    );
    let put = server
        .client
        .put(server.url(&format!("/sessions/{id}/handles")))
        .json(&json!({"p": full}))
        .send()
        .await
        .unwrap();
    assert_eq!((put.status().as_u16(), warning(&put).as_str()), (200, ""));
}

#[tokio::test]
async fn what_landmark_files_are_read_as_is_a_warp_object() {
    let server = Server::start(&[]).await;
    let (p, q) = (
        "name,x,y\na,5,5\nb,50,8\nc,,\nd,20,40\n",
        "name,x,y\nb,49,12\na,8,4\nd,23,40\ne,1,1\nc,30,30\n",
    );
    let form = || Form::new().text("landmarks_p", p).text("landmarks_q", q);
    let answer: Value = server
        .post("/landmarks")
        .multipart(form())
        .send()
        .await
        .unwrap()
        .json()
        .await
        .unwrap();
    assert_eq!(
        (&answer["p"][2], &answer["unmatched"]["q"]),
        (&json!(null), &json!(["e"]))
    );
    let image = || reqwest::multipart::Part::bytes(photo(IMAGE.0, IMAGE.1)).file_name("a.png");
    let by_files = server
        .post("/warp")
        .multipart(form().part("image", image()))
        .send()
        .await
        .unwrap();
    let by_object = server
        .upload("/warp", &photo(IMAGE.0, IMAGE.1), &answer)
        .await;
    for response in [&by_files, &by_object] {
        assert_eq!(warning(response), "handles_missing, landmarks_unmatched");
    }
    assert!(bytes(by_files).await == bytes(by_object).await);
    let extent = json!({"extent": [IMAGE.0, IMAGE.1]});
    for path in ["/points", "/report"] {
        let read = post(&server, path, &with(answer.clone(), &extent)).await;
        assert_eq!(
            read["warning"], "handles_missing, landmarks_unmatched",
            "{path}"
        );
    }
    let id = server.session(&photo(IMAGE.0, IMAGE.1), &answer).await;
    let drawn = server.drag(&id, &json!({"q": answer["q"]})).await;
    assert_eq!(warning(&drawn), "handles_missing, landmarks_unmatched");
    let put = server
        .client
        .put(server.url(&format!("/sessions/{id}/handles")))
        .json(&answer)
        .send()
        .await
        .unwrap();
    assert_eq!(put.status(), 200);
    let put = server
        .client
        .put(server.url(&format!("/sessions/{id}/handles")))
        .json(&json!({"match": "order"}))
        .send()
        .await
        .unwrap();
    assert_eq!(put.status(), 422);
}
