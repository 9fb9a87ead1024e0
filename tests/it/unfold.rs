//! `folds: remove`, over every route.

use mlswarp_server::limits::memory::MemoryClass;
use serde_json::{Value, json};

use crate::batch::zip;
use crate::support::drag_client::DragClient;
use crate::support::redis::Redis;
use crate::support::server::{header, png, problem};
use crate::support::{Server, eventually, photo};

const SIZE: (u32, u32) = (200, 160);
/// Corners, and a handle that is pulled across the picture: it folds.
const P: [[f64; 2]; 5] = [
    [20.0, 20.0],
    [180.0, 20.0],
    [20.0, 140.0],
    [180.0, 140.0],
    [50.0, 80.0],
];
const PULLED_FAR: [f64; 2] = [150.0, 84.0];
const PULLED_NEAR: [f64; 2] = [54.0, 82.0];

fn pulled(to: [f64; 2]) -> Value {
    json!([P[0], P[1], P[2], P[3], to])
}

fn warp(to: [f64; 2], more: Value) -> Value {
    with(json!({"p": P, "q": pulled(to), "folds": "remove"}), more)
}

fn with(mut object: Value, more: Value) -> Value {
    for (name, value) in more.as_object().unwrap() {
        object[name] = value.clone();
    }
    object
}

async fn json_of(server: &Server, path: &str, body: Value) -> Value {
    let response = server.post(path).json(&body).send().await.unwrap();
    assert_eq!(response.status(), 200, "{path} {body}");
    response.json().await.unwrap()
}

/// The largest distance of positions.
fn off(found: &Value, wanted: &Value) -> f64 {
    let pairs = found
        .as_array()
        .unwrap()
        .iter()
        .zip(wanted.as_array().unwrap());
    let off = pairs.map(|(a, b)| {
        let way = |k: usize| a[k].as_f64().unwrap() - b[k].as_f64().unwrap();
        way(0).hypot(way(1))
    });
    off.fold(0.0, f64::max)
}

#[tokio::test]
async fn where_nothing_folds_removing_folds_changes_no_byte() {
    let server = Server::start(&[]).await;
    for (method, to, is_same) in [
        ("rigid", PULLED_NEAR, true),
        ("tps", PULLED_NEAR, true),
        ("rigid", PULLED_FAR, false),
    ] {
        let draw = async |folds: &str| {
            let warp = warp(to, json!({"method": method, "folds": folds}));
            let response = server.upload("/warp", &photo(SIZE.0, SIZE.1), &warp).await;
            let head = (
                header(&response, "etag").to_owned(),
                header(&response, "warp-folds") == "0",
            );
            (head, png(response).await)
        };
        let (report, remove) = (draw("report").await, draw("remove").await);
        assert_eq!(report == remove, is_same, "{method}");
        assert!(remove.0.1 && report.0.1 == is_same, "{method}");
    }
}

#[tokio::test]
async fn a_folding_pose_has_no_fold_and_positions_follow_what_is_drawn() {
    let server = Server::start(&[]).await;
    let extent = json!({"extent": SIZE});
    for method in ["rigid", "similarity", "affine", "tps"] {
        let warp = with(warp(PULLED_FAR, json!({"method": method})), extent.clone());
        let report = json_of(&server, "/report", warp.clone()).await;
        assert_eq!(report["folds"]["cells"], 0, "{method} {report}");
        assert_eq!(report["round_trip"]["missing"], 0, "{method} {report}");
        let removed = &report["folds"]["removed"];
        // The spline only nearly folds, which no cell that is drawn shows.
        let figure = |name: &str| removed[name].as_u64().unwrap();
        assert!(figure("factors") > 1, "{method} {report}");
        assert_eq!(figure("cells") > 0, method != "tps", "{method} {report}");
        assert!(figure("mended") <= figure("cells"), "{method} {report}");
        let residuals = report["residuals"].as_array().unwrap();
        let met = |residual: &Value| residual.as_f64().unwrap() < 0.05;
        assert!(residuals.iter().all(met), "{method} {report}");
        // The handles, the border, and what lies outside of the picture.
        let points = json!([P[4], P[0], [0, 0], [199.5, 80.25], [77.7, 31.1], [120, 90]]);
        let there = json_of(
            &server,
            "/points",
            with(warp.clone(), json!({"points": points})),
        )
        .await;
        let there = &there["points"];
        assert!(
            off(&json!([there[0], there[1]]), &json!([PULLED_FAR, P[0]])) < 0.05,
            "{method} {there}"
        );
        let inverse = json!({"points": there, "inverse": true});
        let back = json_of(&server, "/points", with(warp.clone(), inverse)).await;
        assert!(off(&back["points"], &points) < 1e-6, "{method} {back}");
        let outside = json!({"points": [[-30, 80], [-1e-9, 80], [0, 80]]});
        let outside = json_of(&server, "/points", with(warp.clone(), outside)).await;
        let outside = outside["points"].as_array().unwrap();
        assert!(
            off(&json!([outside[1]]), &json!([outside[2]])) < 1.0,
            "{method} {outside:?}"
        );
        // A map has the positions of `/points`; its indices begin at the centre of a pixel.
        let forward = with(warp.clone(), json!({"direction": "forward"}));
        let map = server.post("/map").json(&forward).send().await.unwrap();
        let map = map.bytes().await.unwrap();
        let values = &map[map.len() - (SIZE.0 * SIZE.1 * 8) as usize..];
        let at = |column: usize, row: usize| {
            let first = (row * SIZE.0 as usize + column) * 8;
            let value = |at: usize| f32::from_le_bytes(values[at..at + 4].try_into().unwrap());
            json!([value(first) + 0.5, value(first + 4) + 0.5])
        };
        let centre = with(warp, json!({"points": [[60.5, 70.5]]}));
        let centre = json_of(&server, "/points", centre).await;
        assert!(
            off(&centre["points"], &json!([at(60, 70)])) < 1e-3,
            "{method}"
        );
    }
}

#[tokio::test]
async fn what_no_map_without_folds_reaches_is_refused_with_its_handles() {
    let server = Server::start(&[]).await;
    let crossing = json!({"extent": SIZE, "folds": "remove",
        "p": [[[20, 20], [180, 20]], [[20, 140], [180, 140]]],
        "q": [[[20, 20], [180, 140]], [[20, 140], [180, 20]]]});
    let points = with(crossing.clone(), json!({"points": [[1, 1]]}));
    for (path, body) in [
        ("/report", &crossing),
        ("/points", &points),
        ("/map", &crossing),
    ] {
        let refused = server.post(path).json(body).send().await.unwrap();
        let refused = problem(refused, 422, "unreachable").await;
        assert_eq!(refused["handles"], json!([0, 1]), "{path}");
    }
    // A handle is named by its index among those that were sent.
    let twins = json!({"p": [[90, 20], null, [20, 20], [20, 20], [100, 100], [60, 60]],
        "q": [[90, 20], null, [20, 20], [20, 20], [60, 60], [60, 60]],
        "extent": SIZE, "folds": "remove", "method": "similarity"});
    let refused = server.post("/report").json(&twins).send().await.unwrap();
    let refused = problem(refused, 422, "unreachable").await;
    assert_eq!(refused["handles"], json!([4, 5]), "{refused}");
}

#[tokio::test]
async fn methods_and_metrics_without_such_a_map_are_refused() {
    let server = Server::start(&[]).await;
    let lines = json!({"p": [[[20, 20], [180, 20]]], "q": [[[20, 20], [180, 40]]],
        "method": "beier_neely"});
    for more in [
        lines,
        json!({"method": "arap"}),
        json!({"metric": "geodesic"}),
        json!({"method": "global_affine"}),
        json!({"method": "tps", "smoothing": 0.1}),
    ] {
        let image = photo(SIZE.0, SIZE.1);
        for path in ["/warp", "/sessions"] {
            let refused = server
                .upload(path, &image, &warp(PULLED_NEAR, more.clone()))
                .await;
            let refused = problem(refused, 422, "not_supported").await;
            assert_eq!(refused["pointer"], "/folds", "{path} {more}");
        }
    }
    // Work is refused before it is done.
    let small = Server::start(&["--max-work", "100000"]).await;
    let body = with(
        warp(PULLED_FAR, json!({})),
        json!({"extent": SIZE, "grid": {"columns": 2, "rows": 2}}),
    );
    let refused = small.post("/report").json(&body).send().await.unwrap();
    let refused = problem(refused, 413, "too_large").await;
    assert_eq!(
        (&refused["pointer"], &refused["limit_name"]),
        (&json!("/folds"), &json!("work"))
    );
}

#[tokio::test]
async fn a_session_keeps_it_for_every_route_and_gives_its_memory_back() {
    let server = Server::start(&[]).await;
    let image = photo(SIZE.0, SIZE.1);
    let id = server
        .session(&image, &json!({"p": P, "folds": "remove"}))
        .await;
    let of = |path: &str| format!("/sessions/{id}/{path}");
    let shown: Value = server
        .get(&format!("/sessions/{id}"))
        .send()
        .await
        .unwrap()
        .json()
        .await
        .unwrap();
    assert_eq!(shown["folds"], "remove");
    let q = json!({"q": pulled(PULLED_FAR)});
    let drawn = server.drag(&id, &q).await;
    assert_eq!(header(&drawn, "warp-folds"), "0");
    let drawn = png(drawn).await;
    let once = server
        .upload("/warp", &image, &warp(PULLED_FAR, json!({})))
        .await;
    assert!(png(once).await == drawn);
    let points = with(q.clone(), json!({"points": [P[4], [-20, 30]]}));
    let points = json_of(&server, &of("points"), points).await;
    assert!(
        off(&json!([points["points"][0]]), &json!([PULLED_FAR])) < 0.05,
        "{points}"
    );
    let mesh = server.post(&of("mesh")).json(&q).send().await.unwrap();
    assert_eq!(header(&mesh, "warp-folds"), "0");
    drop(mesh);
    let folding = json!({"frames": [{"q": P}, q.clone()], "points": [P[4]]});
    let batch = server
        .post(&of("batch"))
        .json(&folding)
        .send()
        .await
        .unwrap();
    let (files, _) = zip(batch).await;
    let annotations: Value = serde_json::from_slice(&files["0001.json"]).unwrap();
    assert_eq!(annotations["points"][0], points["points"][0]);
    assert!(files["0001.png"] == drawn);
    eventually("all memory of frames is back", || {
        server.app.budget().taken_for(MemoryClass::Frame) == 0
    })
    .await;
    // Handles that cannot reach their targets name the frame.
    let lost = json!({"frames": [{"q": P}, {"q": [P[0], P[1], P[2], P[3], P[0]]}]});
    let refused = server.post(&of("batch")).json(&lost).send().await.unwrap();
    let refused = problem(refused, 422, "unreachable").await;
    assert!(
        refused["detail"].as_str().unwrap().starts_with("frame 1: "),
        "{refused}"
    );
}

/// The displacements of a mesh frame.
fn displacements(frame: &[u8]) -> Vec<[f32; 2]> {
    let number = |at: &[u8]| f32::from_le_bytes(at.try_into().unwrap());
    let vertices = frame.chunks_exact(8);
    vertices
        .map(|at| [number(&at[..4]), number(&at[4..])])
        .collect()
}

#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn a_drag_does_not_jump_where_folds_begin_and_is_the_same_in_every_replica() {
    let redis = Redis::start(&[]);
    let options = ["--store", &redis.address()];
    let (a, b) = (Server::start(&options).await, Server::start(&options).await);
    let image = photo(SIZE.0, SIZE.1);
    let rest = |folds| json!({"p": P, "folds": folds, "grid": {"columns": 41, "rows": 33}});
    let id = a.session(&image, &rest("remove")).await;
    let plain = a.session(&image, &rest("report")).await;
    let mut drag = DragClient::open(a.address, &id, "?frames=mesh").await;
    let mesh_of = async |server: &Server, id: &str, q: &Value| {
        let request = server
            .post(&format!("/sessions/{id}/mesh"))
            .header("accept", "application/octet-stream");
        let response = request.json(&json!({"q": q})).send().await.unwrap();
        assert_eq!(response.status(), 200);
        response.bytes().await.unwrap()
    };
    const STEP: f64 = 2.0;
    let (mut before, mut with_folds) = (Vec::<[f32; 2]>::new(), 0);
    for seq in 0..50_u32 {
        let q = pulled([P[4][0] + STEP * f64::from(seq), P[4][1]]);
        drag.pose(seq.into(), &q).await;
        let (of, frame) = drag.frame().await;
        drag.ack(of).await;
        with_folds += u32::from(frame != mesh_of(&a, &plain, &q).await);
        if with_folds.is_multiple_of(3) {
            assert!(frame == mesh_of(&b, &id, &q).await, "{seq}");
        }
        let now = displacements(&frame);
        for (before, now) in before.iter().zip(&now) {
            let [dx, dy]: [f32; 2] = [now[0] - before[0], now[1] - before[1]];
            let jump = f64::from(dx.hypot(dy));
            assert!(jump <= 3.0 * STEP, "{seq}: {jump}");
        }
        before = now;
        if with_folds == 6 {
            break;
        }
    }
    assert_eq!(with_folds, 6, "folds are removed");
}
