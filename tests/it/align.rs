//! `align`: q is brought to the frame of p before anything else, wherever q is given. The laws of
//! the maps themselves are unit tests of the engine.

use serde_json::{Value, json};

use crate::support::drag_client::DragClient;
use crate::support::program::mlswarp;
use crate::support::server::{form, png, problem};
use crate::support::{Scratch, Server, photo};

const SIZE: (u32, u32) = (96, 72);

fn rest() -> Value {
    json!([
        [8, 9],
        [88, 12],
        [[12, 60], [47, 66], [84, 64]],
        [30, 33],
        [66, 40]
    ])
}

/// `rest` with a local change, in another frame: turned, at 3 times the size, elsewhere.
fn posed() -> Value {
    moved(&changed(), |x, y| (700.0 - 3.0 * y, 3.0 * x - 50.0))
}

fn changed() -> Value {
    json!([
        [10, 8],
        [86, 12],
        [[12, 62], [47, 60], [84, 64]],
        [32, 36],
        [62, 40]
    ])
}

fn moved(handles: &Value, map: fn(f64, f64) -> (f64, f64)) -> Value {
    match handles.as_array().unwrap().as_slice() {
        [x, y] if x.is_number() => {
            let (x, y) = map(x.as_f64().unwrap(), y.as_f64().unwrap());
            json!([x, y])
        }
        list => list.iter().map(|handle| moved(handle, map)).collect(),
    }
}

fn with(a: &Value, b: &Value) -> Value {
    a.as_object()
        .unwrap()
        .clone()
        .into_iter()
        .chain(b.as_object().unwrap().clone())
        .collect::<serde_json::Map<_, _>>()
        .into()
}

/// The aligned handles, by the map of a report.
async fn aligned(server: &Server, warp: &Value) -> Value {
    let report: Value = server
        .post("/report")
        .json(&with(warp, &json!({"extent": [96, 72]})))
        .send()
        .await
        .unwrap()
        .json()
        .await
        .unwrap();
    let number =
        |row: usize, column: usize| report["align"]["matrix"][row][column].as_f64().unwrap();
    let m: [[f64; 3]; 2] =
        std::array::from_fn(|row| std::array::from_fn(|column| number(row, column)));
    fn mapped(m: &[[f64; 3]; 2], handles: &Value) -> Value {
        match handles.as_array().unwrap().as_slice() {
            [x, y] if x.is_number() => {
                let (x, y) = (x.as_f64().unwrap(), y.as_f64().unwrap());
                json!([
                    m[0][0] * x + m[0][1] * y + m[0][2],
                    m[1][0] * x + m[1][1] * y + m[1][2]
                ])
            }
            list => list.iter().map(|handle| mapped(m, handle)).collect(),
        }
    }
    mapped(&m, &warp["q"])
}

/// The numbers of two JSON texts are the same, to rounding.
fn near(a: &Value, b: &Value) -> bool {
    match (a, b) {
        (Value::Number(a), Value::Number(b)) => {
            (a.as_f64().unwrap() - b.as_f64().unwrap()).abs() < 1e-6
        }
        (Value::Array(a), Value::Array(b)) => {
            a.len() == b.len() && a.iter().zip(b).all(|(a, b)| near(a, b))
        }
        (Value::Object(a), Value::Object(b)) => {
            a.len() == b.len()
                && a.iter()
                    .all(|(name, a)| b.get(name).is_some_and(|b| near(a, b)))
        }
        (a, b) => a == b,
    }
}

/// A member of the class is undone: the picture is the picture, bit for bit.
#[tokio::test]
async fn shapes_that_differ_by_a_member_of_the_class_are_the_same_picture() {
    let server = Server::start(&[]).await;
    let image = photo(SIZE.0, SIZE.1);
    let draw = async |warp: Value| {
        let response = server
            .post("/warp")
            .multipart(form(&image, warp.to_string()))
            .send()
            .await
            .unwrap();
        let residual: f64 = response.headers()["warp-residual"]
            .to_str()
            .unwrap()
            .parse()
            .unwrap();
        (residual, png(response).await)
    };
    let still = draw(json!({"p": rest(), "q": rest()})).await;
    for (align, map) in [
        (
            "rigid",
            (|x, y| (300.0 - y, x - 40.0)) as fn(f64, f64) -> (f64, f64),
        ),
        ("similarity", |x, y| (900.0 - 0.13 * y, 0.13 * x - 7.7)),
        ("similarity", |x, y| {
            (30.0 * x + 5.0 * y, 30.0 * y - 5.0 * x)
        }),
        ("affine", |x, y| (500.0 - 1.7 * x + 0.3 * y, 0.4 * y + 11.0)),
    ] {
        for method in ["rigid", "similarity", "affine", "global_affine"] {
            let q = moved(&rest(), map);
            assert!(
                draw(json!({"p": rest(), "q": q, "align": align, "method": method})).await == still,
                "{align} {method}"
            );
            let share = |handles: &Value| moved(handles, |x, y| (x / 96.0, y / 72.0));
            let warp = json!({"p": share(&rest()), "q": share(&q), "units": "normalized",
                "align": align, "method": method});
            assert!(draw(warp).await == still, "{align} {method}, normalized");
        }
    }
    assert!(
        draw(json!({"p": rest(), "q": moved(&rest(), |x, y| (300.0 - y, x)), "align": "none"}))
            .await
            != still
    );
}

/// Every route that takes q gives with `align` what it gives with the aligned q.
#[tokio::test]
async fn every_route_aligns_q() {
    let server = Server::start(&[]).await;
    let image = photo(SIZE.0, SIZE.1);
    let extent = json!({"extent": [96, 72]});
    for align in ["rigid", "similarity", "affine"] {
        let base = json!({"p": rest(), "q": posed(), "align": align});
        let plain = json!({"p": rest(), "q": aligned(&server, &base).await});
        let one = server
            .session(&image, &json!({"p": rest(), "align": align}))
            .await;
        let other = server.session(&image, &json!({"p": rest()})).await;
        let annotations = json!({"points": [[3, 4]], "boxes": [[1, 2, 9, 9]]});
        for strength in [1.0, 0.5, -1.5] {
            let strong = json!({"strength": strength});
            for (path, more) in [
                ("/points", &annotations),
                ("/report", &json!({})),
                ("/map", &json!({})),
            ] {
                let ask = async |warp: &Value, session: Option<&str>| {
                    let body = match session {
                        None => with(&with(&with(warp, &extent), more), &strong),
                        Some(_) => with(&with(&json!({"q": warp["q"]}), more), &strong),
                    };
                    let path = session
                        .map_or_else(|| path.to_owned(), |id| format!("/sessions/{id}{path}"));
                    let response = server.post(&path).json(&body).send().await.unwrap();
                    assert_eq!(response.status(), 200, "{path}");
                    response.bytes().await.unwrap()
                };
                for session in [None, Some((&one, &other))] {
                    let a = ask(&base, session.map(|(one, _)| one.as_str())).await;
                    let b = ask(&plain, session.map(|(_, other)| other.as_str())).await;
                    if path == "/map" {
                        let numbers = |file: &[u8]| {
                            file[128..]
                                .as_chunks::<4>()
                                .0
                                .iter()
                                .map(|n| f32::from_le_bytes(*n))
                                .collect::<Vec<_>>()
                        };
                        let far = |(a, b): (f32, f32)| {
                            !(a.is_nan() && b.is_nan()) && (a - b).abs() > 1e-3
                        };
                        assert!(
                            !numbers(&a).into_iter().zip(numbers(&b)).any(far),
                            "{path} {align} {strength}"
                        );
                    } else {
                        let [mut a, mut b] =
                            [&a, &b].map(|text| serde_json::from_slice::<Value>(text).unwrap());
                        if path == "/report" {
                            assert_eq!(
                                (a["align"]["class"].take(), b["align"].take()),
                                (json!(align), Value::Null)
                            );
                            a["align"].take();
                        }
                        assert!(near(&a, &b), "{path} {align} {strength}: {a} {b}");
                    }
                }
            }
            for path in ["warp", "mesh"] {
                let ask = async |id: &str, q: &Value| {
                    let body = with(&json!({"q": q}), &strong);
                    server
                        .post(&format!("/sessions/{id}/{path}"))
                        .json(&body)
                        .send()
                        .await
                        .unwrap()
                        .bytes()
                        .await
                        .unwrap()
                };
                let (a, b) = (ask(&one, &posed()).await, ask(&other, &plain["q"]).await);
                let same = if path == "warp" {
                    let [a, b] =
                        [&a, &b].map(|file| crate::support::picture::decoded(file).samples);
                    a.iter().zip(b).filter(|(a, b)| a.abs_diff(*b) > 1).count() < 9
                } else {
                    near(
                        &serde_json::from_slice(&a).unwrap(),
                        &serde_json::from_slice(&b).unwrap(),
                    )
                };
                assert!(same, "{path} {align} {strength}");
            }
        }
    }
}

/// JSON and binary poses of a socket, and the frames of a batch, are those of the route.
#[tokio::test]
async fn drags_and_batches_align_each_pose() {
    let server = Server::start(&[]).await;
    let image = photo(SIZE.0, SIZE.1);
    let id = server
        .session(&image, &json!({"p": rest(), "align": "similarity"}))
        .await;
    let want = |strength: f64| {
        let body = json!({"q": posed(), "strength": strength});
        let request = server.post(&format!("/sessions/{id}/warp")).json(&body);
        async { png(request.send().await.unwrap()).await }
    };
    let whole = want(1.0).await;
    let mut socket = DragClient::open(server.address, &id, "").await;
    socket.pose(1, &posed()).await;
    assert!(socket.frame().await.1 == whole, "JSON");
    fn flat(handles: &Value, out: &mut Vec<f32>) {
        match handles {
            Value::Array(list) => list.iter().for_each(|item| flat(item, out)),
            number => out.push(number.as_f64().unwrap() as f32),
        }
    }
    // Whole numbers, which f32 holds exactly.
    let mut numbers = Vec::new();
    flat(&posed(), &mut numbers);
    let message: Vec<u8> = 2_u64
        .to_le_bytes()
        .into_iter()
        .chain(numbers.into_iter().flat_map(f32::to_le_bytes))
        .collect();
    let mut socket = DragClient::open(server.address, &id, "").await;
    socket.socket_binary(message).await;
    assert!(socket.frame().await.1 == whole, "binary");
    for (batch, strengths) in [
        (
            json!({"frames": [{"q": posed()}, {"q": posed(), "strength": 0.25}]}),
            [1.0, 0.25],
        ),
        (json!({"q": posed(), "steps": 2}), [0.0, 1.0]),
        (
            json!({"q": posed(), "jitter": {"seed": 1, "count": 2, "sigma": 0}}),
            [1.0, 1.0],
        ),
    ] {
        let file = server
            .post(&format!("/sessions/{id}/batch"))
            .json(&batch)
            .send()
            .await
            .unwrap()
            .bytes()
            .await
            .unwrap();
        let mut archive = zip::ZipArchive::new(std::io::Cursor::new(file)).unwrap();
        for (frame, strength) in strengths.into_iter().enumerate() {
            let mut picture = Vec::new();
            std::io::Read::read_to_end(
                &mut archive.by_name(&format!("{frame:04}.png")).unwrap(),
                &mut picture,
            )
            .unwrap();
            // All frames of a batch have alpha if one of them needs it.
            let colours = |file: &[u8]| {
                let picture = crate::support::picture::decoded(file);
                let channels = picture.samples.len() / (picture.width * picture.height);
                picture
                    .samples
                    .chunks_exact(channels)
                    .flat_map(|pixel| pixel[..3].to_vec())
                    .collect::<Vec<_>>()
            };
            assert!(
                colours(&picture) == colours(&want(strength).await),
                "{batch}: frame {frame}"
            );
        }
    }
}

/// A session keeps the class; other handles keep it too; the tag of a picture depends on the pose
/// alone.
#[tokio::test]
async fn a_session_keeps_its_class_until_it_gets_another() {
    let server = Server::start(&[]).await;
    let image = photo(SIZE.0, SIZE.1);
    let id = server
        .session(&image, &json!({"p": rest(), "align": "similarity"}))
        .await;
    let session = async || {
        server
            .get(&format!("/sessions/{id}"))
            .send()
            .await
            .unwrap()
            .json::<Value>()
            .await
            .unwrap()
    };
    let put = async |body: Value| {
        let response = server
            .client
            .put(server.url(&format!("/sessions/{id}/handles")))
            .json(&body)
            .send()
            .await
            .unwrap();
        assert_eq!(response.status(), 200);
        response.json::<Value>().await.unwrap()
    };
    assert_eq!(session().await["align"], "similarity");
    assert_eq!(
        put(json!({"p": [[1, 2], [50, 60], [70, 9]]})).await["align"],
        "similarity"
    );
    assert_eq!(put(json!({"align": "affine"})).await["align"], "affine");
    assert!(put(json!({"align": "none"})).await.get("align").is_none());
    assert!(session().await.get("align").is_none());
    let tag = async |body: Value| {
        let response = server
            .post(&format!("/sessions/{id}/warp"))
            .json(&body)
            .send()
            .await
            .unwrap();
        response.headers()["etag"].to_str().unwrap().to_owned()
    };
    let (p, far) = (
        json!([[1, 2], [50, 60], [70, 9]]),
        json!([[201, 2], [250, 60], [270, 9]]),
    );
    let (still, moved) = (tag(json!({"q": p})).await, tag(json!({"q": far})).await);
    put(json!({"align": "rigid"})).await;
    assert!(
        tag(json!({"q": far})).await == still && moved != still,
        "a picture of the same pose"
    );
    for (body, code, pointer) in [
        (json!({"align": "mirror"}), "bad_value", "/align"),
        (json!({"align": 1}), "bad_value", "/align"),
    ] {
        let refused = server
            .client
            .put(server.url(&format!("/sessions/{id}/handles")))
            .json(&body)
            .send()
            .await
            .unwrap();
        assert_eq!(problem(refused, 422, code).await["pointer"], pointer);
    }
}

/// `auto` and `/fit` compare methods on the aligned q.
#[tokio::test]
async fn methods_are_compared_on_the_aligned_q() {
    let server = Server::start(&[]).await;
    let p = json!([
        [8, 9],
        [88, 12],
        [12, 60],
        [47, 66],
        [84, 64],
        [30, 33],
        [66, 40]
    ]);
    let q = json!([
        [10, 8],
        [86, 12],
        [12, 62],
        [47, 60],
        [84, 64],
        [32, 36],
        [62, 40]
    ]);
    let far = moved(&q, |x, y| (700.0 - 3.0 * y, 3.0 * x - 50.0));
    let base = json!({"p": p, "q": far, "align": "similarity"});
    let near_q = aligned(&server, &base).await;
    let fit = async |body: &Value| {
        let body = with(body, &json!({"extent": [96, 72]}));
        server
            .post("/fit")
            .json(&body)
            .send()
            .await
            .unwrap()
            .json::<Value>()
            .await
            .unwrap()
    };
    let once = fit(&base).await;
    assert!(near(&once, &fit(&json!({"p": p, "q": near_q})).await));
    let image = photo(SIZE.0, SIZE.1);
    let id = server
        .session(&image, &json!({"p": p, "align": "similarity"}))
        .await;
    let of_session: Value = server
        .post(&format!("/sessions/{id}/fit"))
        .json(&json!({"q": far}))
        .send()
        .await
        .unwrap()
        .json()
        .await
        .unwrap();
    assert!(near(&once, &of_session));
    let chosen = server
        .upload("/warp", &image, &with(&base, &json!({"method": "auto"})))
        .await;
    let plain = server
        .upload(
            "/warp",
            &image,
            &json!({"p": p, "q": near_q, "method": "auto"}),
        )
        .await;
    assert_eq!(
        chosen.headers()["warp-method"],
        plain.headers()["warp-method"]
    );
}

/// The offline tool writes the same bytes, also from landmark files, and its option takes
/// precedence.
#[tokio::test(flavor = "multi_thread")]
async fn the_offline_tool_aligns_like_the_server() {
    let server = Server::start(&[]).await;
    let (image, scratch) = (photo(SIZE.0, SIZE.1), Scratch::new());
    let warp = json!({"p": rest(), "q": posed(), "align": "similarity"});
    let want = png(server.upload("/warp", &image, &warp).await).await;
    let path = |name: &str| scratch.path(name);
    std::fs::write(path("a.png"), &image).unwrap();
    std::fs::write(
        path("warp.json"),
        json!({"p": rest(), "q": posed(), "align": "none"}).to_string(),
    )
    .unwrap();
    std::fs::write(
        path("points.csv"),
        "px,py,qx,qy\n8,9,673,-26\n88,12,664,214\n30,33,601,40\n66,40,580,148\n",
    )
    .unwrap();
    let run = |args: &[&str]| {
        let output = mlswarp(args).output().unwrap();
        assert!(
            output.status.success(),
            "{}",
            String::from_utf8_lossy(&output.stderr)
        );
    };
    run(&[
        "warp",
        &path("a.png"),
        &path("warp.json"),
        "--align",
        "similarity",
        "-o",
        &path("out.png"),
    ]);
    assert!(std::fs::read(path("out.png")).unwrap() == want);
    run(&[
        "report",
        &path("warp.json"),
        "--image",
        &path("a.png"),
        "--align",
        "similarity",
        "-o",
        &path("report.json"),
    ]);
    let report: Value =
        serde_json::from_slice(&std::fs::read(path("report.json")).unwrap()).unwrap();
    assert_eq!(report["align"]["class"], "similarity");
    // Landmarks that differ by a turn and a scale alone.
    run(&[
        "warp",
        &path("a.png"),
        "--landmarks",
        &path("points.csv"),
        "--align",
        "similarity",
        "-o",
        &path("same.png"),
    ]);
    let still = png(server
        .upload("/warp", &image, &json!({"p": rest(), "q": rest()}))
        .await)
    .await;
    assert!(std::fs::read(path("same.png")).unwrap() == still);
    let refused = mlswarp(&[
        "warp",
        &path("a.png"),
        &path("warp.json"),
        "--align",
        "mirror",
        "-o",
        &path("no.png"),
    ])
    .output()
    .unwrap();
    let said = String::from_utf8(refused.stderr).unwrap();
    assert!(
        !refused.status.success()
            && said.contains("--align: expected")
            && said.contains("similarity"),
        "{said}"
    );
}

/// Positions that cannot be posed are refused as they were sent.
#[tokio::test]
async fn wrong_positions_are_refused_as_they_were_sent() {
    let server = Server::start(&[]).await;
    let ask = async |q: Value| {
        let warp = json!({"p": [[1, 2], [50, 60], [70, 9]], "q": q, "align": "similarity",
            "extent": [96, 72]});
        server.post("/report").json(&warp).send().await.unwrap()
    };
    for (q, code) in [
        (json!([[1, 2]]), "shape_mismatch"),
        (
            json!([[1, 2], [50, 60], [[70, 9], [1, 1]]]),
            "shape_mismatch",
        ),
        (json!([[1, 2], [50, 60], [7e6, 9]]), "bad_value"),
    ] {
        problem(ask(q).await, 422, code).await;
    }
    // One position, or all at one: a move.
    for q in [json!([[5, 5], [5, 5], [5, 5]])] {
        let report: Value = ask(q).await.json().await.unwrap();
        assert_eq!(report["align"]["class"], "translation", "{report}");
    }
    let none: Value = server
        .post("/report")
        .json(&json!({"align": "affine", "extent": [9, 9]}))
        .send()
        .await
        .unwrap()
        .json()
        .await
        .unwrap();
    assert_eq!(none["align"], Value::Null);
}
