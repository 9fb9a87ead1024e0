//! Layers of a session: stored and read to the byte, kept and dropped as the contract says,
//! bounded, and the same in every replica.

use std::time::Duration;

use image::{DynamicImage, GrayImage, RgbImage};
use mlswarp_server::limits::memory::MemoryClass;
use reqwest::{Response, StatusCode};
use serde_json::{Value, json};

use crate::support::counters::Counted as _;
use crate::support::redis::Redis;
use crate::support::server::{form, header, problem};
use crate::support::{Server, photo};

fn rest() -> Value {
    json!({"p": [[4, 4], [12, 8], [3, 9], [13, 2]]})
}

fn grey(width: u32, height: u32, value: u8) -> Vec<u8> {
    let mut file = std::io::Cursor::new(Vec::new());
    let image = DynamicImage::ImageLuma8(GrayImage::from_fn(width, height, |x, y| {
        image::Luma([value.wrapping_add((x * y) as u8)])
    }));
    image.write_to(&mut file, image::ImageFormat::Png).unwrap();
    file.into_inner()
}

async fn put(server: &Server, id: &str, name: &str, file: Vec<u8>) -> Response {
    server
        .client
        .put(server.url(&format!("/sessions/{id}/layers/{name}")))
        .body(file)
        .send()
        .await
        .unwrap()
}

async fn stored(server: &Server, id: &str, name: &str) -> Option<Vec<u8>> {
    let response = server
        .get(&format!("/sessions/{id}/layers/{name}"))
        .send()
        .await
        .unwrap();
    if response.status() == StatusCode::OK {
        return Some(response.bytes().await.unwrap().to_vec());
    }
    problem(response, 404, "no_such_layer").await;
    None
}

async fn layers(server: &Server, id: &str) -> Value {
    let session: Value = server
        .get(&format!("/sessions/{id}"))
        .send()
        .await
        .unwrap()
        .json()
        .await
        .unwrap();
    session["layers"].clone()
}

#[tokio::test]
async fn a_layer_is_stored_read_replaced_and_deleted() {
    let server = Server::start(&[]).await;
    let id = server.session(&photo(16, 12), &rest()).await;
    assert_eq!(layers(&server, &id).await, Value::Null);
    let (first, second) = (grey(16, 12, 1), grey(16, 12, 2));
    let created = put(&server, &id, "depth", first.clone()).await;
    assert_eq!(created.status(), 201);
    assert_eq!(
        created.json::<Value>().await.unwrap()["layers"],
        json!({"depth": {"kind": "image"}})
    );
    let read = server
        .get(&format!("/sessions/{id}/layers/depth"))
        .send()
        .await
        .unwrap();
    assert_eq!(
        (
            read.status().as_u16(),
            header(&read, "content-type"),
            header(&read, "cache-control")
        ),
        (200, "image/png", "no-store")
    );
    assert_eq!(read.bytes().await.unwrap(), first);
    for _ in 0..2 {
        assert_eq!(
            put(&server, &id, "depth", second.clone()).await.status(),
            200
        );
        assert_eq!(
            stored(&server, &id, "depth").await.as_deref(),
            Some(&second[..])
        );
    }
    let labels = server
        .client
        .put(server.url(&format!("/sessions/{id}/layers/parts?kind=labels")))
        .body(first.clone());
    assert_eq!(labels.send().await.unwrap().status(), 201);
    assert_eq!(
        layers(&server, &id).await,
        json!({"depth": {"kind": "image"}, "parts": {"kind": "labels"}})
    );
    let delete = async || {
        server
            .client
            .delete(server.url(&format!("/sessions/{id}/layers/depth")))
            .send()
            .await
            .unwrap()
    };
    assert_eq!(delete().await.status(), 204);
    problem(delete().await, 404, "no_such_layer").await;
    assert_eq!(stored(&server, &id, "depth").await, None);
    assert_eq!(
        stored(&server, &id, "parts").await.as_deref(),
        Some(&first[..])
    );
}

#[tokio::test]
async fn new_handles_and_the_same_upload_keep_layers_and_another_upload_drops_them() {
    let server = Server::start(&[]).await;
    let (id, layer) = ("5f8fad5b-d9cb-469f-a165-70867728950e", grey(16, 12, 7));
    let upload = async |picture: &[u8], status: u16| {
        let put = server
            .client
            .put(server.url(&format!("/sessions/{id}")))
            .multipart(form(picture, rest().to_string()));
        assert_eq!(put.send().await.unwrap().status(), status);
    };
    upload(&photo(16, 12), 201).await;
    assert_eq!(put(&server, id, "x", layer.clone()).await.status(), 201);
    upload(&photo(16, 12), 200).await;
    assert_eq!(stored(&server, id, "x").await.as_deref(), Some(&layer[..]));
    let handles = server
        .client
        .put(server.url(&format!("/sessions/{id}/handles")))
        .json(&json!({"alpha": 1.5}))
        .send()
        .await
        .unwrap();
    assert_eq!(
        handles.json::<Value>().await.unwrap()["layers"],
        json!({"x": {"kind": "image"}})
    );
    assert_eq!(stored(&server, id, "x").await.as_deref(), Some(&layer[..]));
    upload(&grey(16, 12, 9), 200).await;
    assert_eq!(
        (stored(&server, id, "x").await, layers(&server, id).await),
        (None, Value::Null)
    );
}

#[tokio::test]
async fn what_is_no_layer_is_refused_and_stores_nothing() {
    let server = Server::start(&[]).await;
    let id = server.session(&photo(16, 12), &rest()).await;
    let wrong = problem(
        put(&server, &id, "x", grey(12, 16, 1)).await,
        422,
        "bad_value",
    )
    .await;
    assert_eq!(
        (&wrong["limit"], &wrong["actual"]),
        (&"16x12".into(), &"12x16".into()),
        "{wrong}"
    );
    let good = grey(16, 12, 1);
    problem(
        put(&server, &id, "x", good[..good.len() / 2].to_vec()).await,
        422,
        "bad_image",
    )
    .await;
    for none in [&b""[..], b"hello, I am a layer", b"{\"p\": []}"] {
        problem(
            put(&server, &id, "x", none.to_vec()).await,
            415,
            "unsupported_format",
        )
        .await;
    }
    // A header that declares more than may be decoded.
    let mut large = RgbImage::new(4, 4);
    large.put_pixel(0, 0, image::Rgb([1, 2, 3]));
    let mut file = std::io::Cursor::new(Vec::new());
    large.write_to(&mut file, image::ImageFormat::Bmp).unwrap();
    let mut file = file.into_inner();
    file[18..22].copy_from_slice(&20_000_i32.to_le_bytes());
    problem(put(&server, &id, "x", file).await, 413, "too_large").await;
    for name in [
        "@coverage",
        "@holes",
        "a%20b",
        "%C3%A9",
        "..%2F..",
        &"x".repeat(65),
    ] {
        problem(
            put(&server, &id, name, good.clone()).await,
            422,
            "bad_value",
        )
        .await;
    }
    for (query, status, code) in [
        ("kind=video", 422, "bad_value"),
        ("kin=image", 422, "unknown_field"),
        ("kind=image&kind=image", 400, "malformed_request"),
    ] {
        let path = server.url(&format!("/sessions/{id}/layers/x?{query}"));
        problem(
            server
                .client
                .put(path)
                .body(good.clone())
                .send()
                .await
                .unwrap(),
            status,
            code,
        )
        .await;
    }
    let mask = server
        .client
        .put(server.url(&format!("/sessions/{id}/layers/region?kind=labels")))
        .body(good.clone());
    problem(mask.send().await.unwrap(), 422, "bad_value").await;
    assert_eq!(layers(&server, &id).await, Value::Null);
    problem(
        put(
            &server,
            "0f8fad5b-d9cb-469f-a165-70867728950e",
            "x",
            good.clone(),
        )
        .await,
        404,
        "no_such_session",
    )
    .await;
    let gone = server
        .get("/sessions/0f8fad5b-d9cb-469f-a165-70867728950e/layers/x")
        .send()
        .await
        .unwrap();
    problem(gone, 404, "no_such_session").await;
    server.is_well().await;
}

/// Both would be one file of a batch on a system that does not tell them apart.
#[tokio::test]
async fn a_layer_whose_name_differs_in_letters_case_only_is_refused() {
    let server = Server::start(&[]).await;
    let id = server.session(&photo(16, 12), &rest()).await;
    let file = || grey(16, 12, 1);
    assert_eq!(put(&server, &id, "Cells", file()).await.status(), 201);
    for name in ["cells", "CELLS", "Region"] {
        problem(put(&server, &id, name, file()).await, 422, "bad_value").await;
        assert_eq!(stored(&server, &id, name).await, None);
    }
    assert_eq!(put(&server, &id, "Cells", file()).await.status(), 200);
}

#[tokio::test]
async fn a_session_has_at_most_sixteen_layers() {
    let server = Server::start(&[]).await;
    let id = server.session(&photo(16, 12), &rest()).await;
    for n in 0..16 {
        assert_eq!(
            put(
                &server,
                &id,
                &format!("{}{n}", "long-name.".repeat(6)),
                grey(16, 12, n)
            )
            .await
            .status(),
            201
        );
    }
    let more = problem(
        put(&server, &id, "x", grey(16, 12, 77)).await,
        413,
        "too_large",
    )
    .await;
    assert_eq!(
        (&more["limit_name"], &more["limit"], &more["actual"]),
        (&"session_layers".into(), &16.into(), &17.into())
    );
    assert_eq!(
        put(
            &server,
            &id,
            &format!("{}3", "long-name.".repeat(6)),
            grey(16, 12, 99)
        )
        .await
        .status(),
        200,
        "one is replaced"
    );
    assert_eq!(
        layers(&server, &id)
            .await
            .as_object()
            .map(serde_json::Map::len),
        Some(16)
    );
}

/// Bytes of layers count for the client and for the store, until they are deleted.
#[tokio::test]
async fn layers_count_in_the_quota_of_their_client() {
    let bytes = (photo(320, 240).len() + 4096) * 5;
    let server = Server::start(&[
        "--store-bytes",
        &bytes.to_string(),
        "--max-client-share",
        "50",
    ])
    .await;
    let id = server.session(&photo(320, 240), &rest()).await;
    // The picture itself, under another name: its file is stored once.
    assert_eq!(
        put(&server, &id, "same", photo(320, 240)).await.status(),
        201
    );
    let other = |value: u8| {
        let mut file = std::io::Cursor::new(Vec::new());
        let noise = |x: u32, y: u32| {
            image::Rgb([
                x.wrapping_mul(x ^ y) as u8 ^ value,
                y.wrapping_mul(31 + x) as u8,
                (x * y + x) as u8,
            ])
        };
        RgbImage::from_fn(320, 240, noise)
            .write_to(&mut file, image::ImageFormat::Bmp)
            .unwrap();
        file.into_inner()
    };
    let mut stored = 0;
    let refused = loop {
        let response = put(&server, &id, &format!("l{stored}"), other(stored)).await;
        if response.status() != 201 {
            break problem(response, 429, "rate_limited").await;
        }
        stored += 1;
        assert!(stored < 16);
    };
    assert_eq!(refused["limit_name"], "client_store_bytes");
    assert!(layers(&server, &id).await.as_object().unwrap().len() == usize::from(stored) + 1);
}

#[tokio::test]
async fn layers_end_with_their_session() {
    let server = Server::start(&["--session-idle", "1s"]).await;
    let expires = server.session(&photo(16, 12), &rest()).await;
    assert_eq!(
        put(&server, &expires, "x", grey(16, 12, 1)).await.status(),
        201
    );
    let deleted = server.session(&photo(16, 12), &rest()).await;
    assert_eq!(
        put(&server, &deleted, "x", grey(16, 12, 2)).await.status(),
        201
    );
    assert_eq!(
        server
            .client
            .delete(server.url(&format!("/sessions/{deleted}")))
            .send()
            .await
            .unwrap()
            .status(),
        204
    );
    problem(
        server
            .get(&format!("/sessions/{deleted}/layers/x"))
            .send()
            .await
            .unwrap(),
        404,
        "no_such_session",
    )
    .await;
    tokio::time::sleep(Duration::from_millis(1300)).await;
    problem(
        server
            .get(&format!("/sessions/{expires}/layers/x"))
            .send()
            .await
            .unwrap(),
        410,
        "session_expired",
    )
    .await;
    problem(
        put(&server, &expires, "y", grey(16, 12, 1)).await,
        410,
        "session_expired",
    )
    .await;
}

#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn two_replicas_have_the_same_layers() {
    let redis = Redis::start(&[]);
    let options = ["--store", &redis.address()];
    let (a, b) = (Server::start(&options).await, Server::start(&options).await);
    let id = a.session(&photo(16, 12), &rest()).await;
    let layer = grey(16, 12, 5);
    assert_eq!(put(&a, &id, "x", layer.clone()).await.status(), 201);
    assert_eq!(stored(&b, &id, "x").await.as_deref(), Some(&layer[..]));
    assert_eq!(
        drawn(&a, &id, "x", &json!({})).await,
        drawn(&b, &id, "x", &json!({})).await
    );
    assert_eq!(put(&b, &id, "x", grey(16, 12, 6)).await.status(), 200);
    assert_eq!(
        drawn(&a, &id, "x", &json!({})).await,
        drawn(&b, &id, "x", &json!({})).await
    );
    assert_eq!(stored(&a, &id, "x").await, Some(grey(16, 12, 6)));
    assert_eq!(
        b.client
            .delete(b.url(&format!("/sessions/{id}/layers/x")))
            .send()
            .await
            .unwrap()
            .status(),
        204
    );
    assert_eq!(
        (stored(&a, &id, "x").await, layers(&a, &id).await),
        (None, Value::Null)
    );
}

fn pose() -> Value {
    json!([[6, 3], [12, 9], [3, 8], [12, 2]])
}

async fn drawn(server: &Server, id: &str, layer: &str, output: &Value) -> (String, Vec<u8>) {
    let response = server
        .drag(id, &json!({"q": pose(), "layer": layer, "output": output}))
        .await;
    let status = response.status();
    let etag = response
        .headers()
        .get("etag")
        .map(|etag| etag.to_str().unwrap().to_owned());
    let bytes = response.bytes().await.unwrap().to_vec();
    assert_eq!(status, 200, "{}", String::from_utf8_lossy(&bytes));
    (etag.unwrap(), bytes)
}

/// A layer is drawn as if it were the picture of a session with the same handles.
#[tokio::test]
async fn a_layer_is_drawn_as_the_picture_would_be() {
    let server = Server::start(&[]).await;
    let (picture, other) = (photo(16, 12), grey(16, 12, 40));
    let id = server.session(&picture, &rest()).await;
    assert_eq!(
        put(&server, &id, "same", picture.clone()).await.status(),
        201
    );
    assert_eq!(
        put(&server, &id, "other", other.clone()).await.status(),
        201
    );
    let outputs = [
        json!({}),
        json!({"format": "jpeg"}),
        json!({"width": 9}),
        json!({"canvas": "fit", "outside": "edge"}),
        json!({"filter": "nearest"}),
    ];
    for output in &outputs {
        for (layer, file) in [("same", &picture), ("other", &other)] {
            let mut warp = rest();
            (warp["q"], warp["output"]) = (pose(), output.clone());
            let once = server.upload("/warp", file, &warp).await;
            let etag = header(&once, "etag").to_owned();
            assert_eq!(
                drawn(&server, &id, layer, output).await,
                (etag, once.bytes().await.unwrap().to_vec()),
                "{layer} {output}"
            );
        }
    }
    let decoded = server.app.counters().images_decoded;
    drawn(&server, &id, "other", &outputs[0]).await;
    assert_eq!(
        server.app.counters().images_decoded,
        decoded,
        "it is cached"
    );
    // Without anything cached, from the store.
    let warm = drawn(&server, &id, "other", &outputs[0]).await;
    server.app.clear_caches();
    assert_eq!(drawn(&server, &id, "other", &outputs[0]).await, warm);
    // Another file under the same name is another picture.
    assert_eq!(
        put(&server, &id, "other", grey(16, 12, 41)).await.status(),
        200
    );
    let replaced = drawn(&server, &id, "other", &outputs[0]).await;
    assert!(replaced.0 != warm.0 && replaced.1 != warm.1);
}

#[tokio::test]
async fn labels_are_not_mixed_and_coverage_is_of_the_pose() {
    let server = Server::start(&[]).await;
    let id = server.session(&photo(16, 12), &rest()).await;
    let mut labels = GrayImage::new(16, 12);
    labels
        .enumerate_pixels_mut()
        .for_each(|(x, y, label)| label.0 = [[3, 90, 200, 255][((x / 3 + y / 4) % 4) as usize]]);
    let mut file = std::io::Cursor::new(Vec::new());
    labels.write_to(&mut file, image::ImageFormat::Png).unwrap();
    let path = server.url(&format!("/sessions/{id}/layers/parts?kind=labels"));
    let label_file = file.into_inner();
    assert_eq!(
        server
            .client
            .put(path)
            .body(label_file.clone())
            .send()
            .await
            .unwrap()
            .status(),
        201
    );
    for output in [
        json!({}),
        json!({"width": 40, "filter": "bicubic"}),
        json!({"format": "tiff", "canvas": "fit"}),
    ] {
        let (_, bytes) = drawn(&server, &id, "parts", &output).await;
        let image = image::load_from_memory(&bytes).unwrap();
        assert_eq!(image.color(), image::ColorType::L8);
        let found: std::collections::BTreeSet<u8> =
            image.to_luma8().pixels().map(|label| label.0[0]).collect();
        assert!(
            found.is_subset(&[0, 3, 90, 200, 255].into()) && found.len() >= 4,
            "{output}: {found:?}"
        );
    }
    server.app.clear_caches();
    let jpeg = json!({"q": pose(), "layer": "parts", "output": {"format": "jpeg"}});
    assert_eq!(
        problem(server.drag(&id, &jpeg).await, 422, "bad_value").await["pointer"],
        "/output/format"
    );
    let accepted = server
        .post(&format!("/sessions/{id}/warp"))
        .header("accept", "image/webp")
        .json(&json!({"q": pose(), "layer": "parts"}));
    problem(accepted.send().await.unwrap(), 422, "bad_value").await;
    // The format of the session's pictures does not matter where it cannot hold labels.
    let (_, png) = drawn(&server, &id, "parts", &json!({"width": 20})).await;
    for (format, exact) in [
        ("jpeg", "image/png"),
        ("webp", "image/png"),
        ("tiff", "image/tiff"),
    ] {
        let warp = json!({"p": rest()["p"], "output": {"format": format, "width": 20}});
        let id = server.session(&photo(16, 12), &warp).await;
        let put = server
            .client
            .put(server.url(&format!("/sessions/{id}/layers/parts?kind=labels")))
            .body(label_file.clone());
        assert_eq!(put.send().await.unwrap().status(), 201);
        for layer in ["parts", "@coverage"] {
            let response = server
                .drag(&id, &json!({"q": pose(), "layer": layer}))
                .await;
            assert_eq!(
                (
                    response.status().as_u16(),
                    header(&response, "content-type")
                ),
                (200, exact),
                "{format}, {layer}"
            );
            let bytes = response.bytes().await.unwrap();
            assert!(layer != "parts" || exact != "image/png" || bytes == png);
        }
        let requested = json!({"q": pose(), "layer": "parts", "output": {"format": "jpeg"}});
        assert_eq!(
            problem(server.drag(&id, &requested).await, 422, "bad_value").await["pointer"],
            "/output/format"
        );
    }
    // At rest everything is covered.
    let still = server
        .drag(&id, &json!({"q": rest()["p"], "layer": "@coverage"}))
        .await;
    let still = image::load_from_memory(&still.bytes().await.unwrap()).unwrap();
    assert_eq!(still.color(), image::ColorType::L8);
    assert!(still.to_luma8().pixels().all(|pixel| pixel.0 == [255]));
    let away = server
        .drag(
            &id,
            &json!({"q": [[14, 4], [22, 8], [13, 9], [23, 2]], "layer": "@coverage"}),
        )
        .await;
    let away = image::load_from_memory(&away.bytes().await.unwrap())
        .unwrap()
        .to_luma8();
    assert!(
        away.pixels().any(|pixel| pixel.0 == [0]) && away.pixels().any(|pixel| pixel.0 == [255])
    );
}

#[tokio::test]
async fn a_layer_that_is_not_there_is_not_drawn() {
    let server = Server::start(&[]).await;
    let id = server.session(&photo(16, 12), &rest()).await;
    for (layer, status, code) in [
        (json!("depth"), 404, "no_such_layer"),
        (json!("@depth"), 422, "bad_value"),
        (json!("a b"), 422, "bad_value"),
        (json!(3), 422, "bad_value"),
    ] {
        let refused = problem(
            server
                .drag(&id, &json!({"q": pose(), "layer": layer}))
                .await,
            status,
            code,
        )
        .await;
        assert_eq!(refused["pointer"], "/layer", "{refused}");
    }
    let picture = server
        .drag(&id, &json!({"q": pose()}))
        .await
        .bytes()
        .await
        .unwrap();
    assert_eq!(
        server
            .drag(&id, &json!({"q": pose(), "layer": null}))
            .await
            .bytes()
            .await
            .unwrap(),
        picture
    );
}

/// What was decoded for a layer is freed with the last session that has it.
#[tokio::test]
async fn memory_of_layers_is_counted_and_given_back() {
    let server = Server::start(&[]).await;
    let taken = || server.app.budget().taken_for(MemoryClass::Image);
    let id = server.session(&photo(160, 120), &rest()).await;
    let before = taken();
    assert_eq!(
        put(&server, &id, "x", grey(160, 120, 1)).await.status(),
        201
    );
    let with_layer = taken();
    assert!(with_layer > before);
    assert_eq!(
        put(&server, &id, "x", grey(160, 120, 2)).await.status(),
        200
    );
    assert_eq!(taken(), with_layer, "the replaced one is not kept");
    assert_eq!(
        server
            .client
            .delete(server.url(&format!("/sessions/{id}/layers/x")))
            .send()
            .await
            .unwrap()
            .status(),
        204
    );
    assert_eq!(taken(), before);
    assert_eq!(
        put(&server, &id, "x", grey(160, 120, 1)).await.status(),
        201
    );
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
    assert_eq!(taken(), 0);
}

/// Clients that leave at some moment: the layer is whole or not there, and nothing stays reserved.
#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn a_client_that_leaves_leaves_no_half_of_a_layer() {
    let server = Server::start(&[]).await;
    let id = server.session(&photo(900, 700), &rest()).await;
    let layer = grey(900, 700, 3);
    for delay in [1, 3, 6, 10, 15, 25, 40, 70] {
        let _ = tokio::time::timeout(
            Duration::from_millis(delay),
            put(&server, &id, "x", layer.clone()),
        )
        .await;
        if layers(&server, &id).await["x"].is_object() {
            assert_eq!(stored(&server, &id, "x").await.as_deref(), Some(&layer[..]));
        }
    }
    assert!(matches!(
        put(&server, &id, "x", layer.clone())
            .await
            .status()
            .as_u16(),
        200 | 201
    ));
    assert_eq!(stored(&server, &id, "x").await, Some(layer));
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
    let began = std::time::Instant::now();
    while server.app.budget().taken_for(MemoryClass::Upload) > 0 {
        assert!(
            began.elapsed() < Duration::from_secs(60),
            "its memory is given back"
        );
        tokio::time::sleep(Duration::from_millis(20)).await;
    }
}

/// A mask of vertical halves: nothing moves on the left.
fn mask(left: u8, right: u8) -> Vec<u8> {
    let mut file = std::io::Cursor::new(Vec::new());
    let half = GrayImage::from_fn(40, 30, |x, _| {
        image::Luma([if x < 20 { left } else { right }])
    });
    half.write_to(&mut file, image::ImageFormat::Png).unwrap();
    file.into_inner()
}

/// The three parts.
fn masked(picture: &[u8], warp: &Value, mask: Vec<u8>) -> reqwest::multipart::Form {
    form(picture, warp.to_string()).part(
        "region",
        reqwest::multipart::Part::bytes(mask).file_name("mask"),
    )
}

#[tokio::test]
async fn only_the_content_of_a_region_moves() {
    let server = Server::start(&[]).await;
    let picture = photo(40, 30);
    let (p, q) = (
        json!([[8, 8], [30, 10], [10, 25], [32, 22]]),
        json!([[9, 9], [28, 13], [12, 24], [29, 24]]),
    );
    let once = async |mask: Option<Vec<u8>>| {
        let warp = json!({"p": p, "q": q});
        let upload = match mask {
            Some(mask) => masked(&picture, &warp, mask),
            None => form(&picture, warp.to_string()),
        };
        let answer = server.post("/warp").multipart(upload).send().await.unwrap();
        assert_eq!(answer.status(), 200);
        (
            header(&answer, "etag").to_owned(),
            answer.bytes().await.unwrap().to_vec(),
        )
    };
    let pixels = |file: &[u8]| image::load_from_memory(file).unwrap().to_rgb8();
    let (whole, none, half) = (
        once(None).await,
        once(Some(mask(0, 0))).await,
        once(Some(mask(0, 255))).await,
    );
    let still = pixels(&picture);
    assert_eq!(pixels(&none.1), still);
    assert!(whole.0 != half.0 && none.0 != half.0);
    let (half_pixels, whole_pixels) = (pixels(&half.1), pixels(&whole.1));
    assert!((0..30).all(|y| (0..10).all(|x| half_pixels.get_pixel(x, y) == still.get_pixel(x, y))));
    assert!(
        (0..30).any(|y| (25..36).any(|x| half_pixels.get_pixel(x, y) != still.get_pixel(x, y)))
    );
    assert!(
        (5..25).any(|y| (5..15).any(|x| whole_pixels.get_pixel(x, y) != still.get_pixel(x, y)))
    );
    // A session with that layer draws the same, however it was stored.
    let (id, other) = (
        "6f8fad5b-d9cb-469f-a165-70867728950e",
        server.session(&picture, &json!({"p": p})).await,
    );
    let upload = async |mask: Vec<u8>, status: u16| {
        let request = server
            .client
            .put(server.url(&format!("/sessions/{id}")))
            .multipart(masked(&picture, &json!({"p": p}), mask));
        let answer = request.send().await.unwrap();
        assert_eq!(answer.status(), status);
        assert_eq!(
            answer.json::<Value>().await.unwrap()["layers"]["region"],
            json!({"kind": "image"})
        );
    };
    upload(mask(0, 255), 201).await;
    assert_eq!(
        put(&server, &other, "region", mask(0, 255)).await.status(),
        201
    );
    let drag = async |id: &str, layer: Value| {
        let answer = server.drag(id, &json!({"q": q, "layer": layer})).await;
        assert_eq!(answer.status(), 200, "{:?}", answer.text().await);
        (
            header(&answer, "etag").to_owned(),
            answer.bytes().await.unwrap().to_vec(),
        )
    };
    for id in [id, &other] {
        assert_eq!(drag(id, Value::Null).await, half);
        server.app.clear_caches();
        assert_eq!(drag(id, Value::Null).await, half);
    }
    // A layer follows the same region.
    assert_eq!(
        put(&server, id, "copy", picture.clone()).await.status(),
        201
    );
    assert_eq!(drag(id, json!("copy")).await, half);
    let holes = image::load_from_memory(&drag(id, json!("@holes")).await.1).unwrap();
    assert_eq!(holes.color(), image::ColorType::L8);
    // The same upload keeps its layers; another mask is another upload.
    upload(mask(0, 255), 200).await;
    assert_eq!(layers(&server, id).await.as_object().unwrap().len(), 2);
    upload(mask(255, 0), 200).await;
    assert_eq!(layers(&server, id).await.as_object().unwrap().len(), 1);
    assert!(drag(id, Value::Null).await != half);
    // Without the layer everything moves.
    assert_eq!(
        server
            .client
            .delete(server.url(&format!("/sessions/{other}/layers/region")))
            .send()
            .await
            .unwrap()
            .status(),
        204
    );
    assert_eq!(drag(&other, Value::Null).await, whole);
    let refused = problem(
        server
            .drag(&other, &json!({"q": q, "layer": "@holes"}))
            .await,
        422,
        "bad_value",
    )
    .await;
    assert_eq!(refused["pointer"], "/layer");
    for wrong in ["/warp", "/sessions"] {
        let small = masked(&picture, &json!({"p": p, "q": q}), grey(16, 12, 1));
        let refused = problem(
            server.post(wrong).multipart(small).send().await.unwrap(),
            422,
            "bad_value",
        )
        .await;
        assert!(
            refused["detail"]
                .as_str()
                .unwrap()
                .starts_with("the part `region`: the file has 16x12 px"),
            "{refused}"
        );
    }
}

/// A picture that is warped once and its mask are evicted before the pictures of sessions.
#[tokio::test]
async fn a_mask_that_is_sent_once_does_not_evict_a_session() {
    let sizes = [160, 161, 162, 163].map(|width| (width, 120));
    let one = {
        let server = Server::start(&[]).await;
        server.session(&photo(163, 120), &rest()).await;
        server.app.budget().taken_for(MemoryClass::Image)
    };
    let server = Server::start(&["--image-cache-bytes", &(3 * one + one / 2).to_string()]).await;
    let id = server.session(&photo(160, 120), &rest()).await;
    let warp = json!({"p": rest()["p"], "q": rest()["p"]});
    let once = masked(&photo(161, 120), &warp, grey(161, 120, 9));
    assert_eq!(
        server
            .post("/warp")
            .multipart(once)
            .send()
            .await
            .unwrap()
            .status(),
        200
    );
    for (width, height) in &sizes[2..] {
        server.session(&photo(*width, *height), &rest()).await;
    }
    let decoded = server.app.counters().images_decoded;
    assert_eq!(server.drag(&id, &json!({"q": pose()})).await.status(), 200);
    assert_eq!(
        server.app.counters().images_decoded,
        decoded,
        "the picture of the session was evicted"
    );
}

/// Requests for different layers at the same time: each is stored.
#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn simultaneous_changes_lose_no_layer() {
    let server = Server::start(&[]).await;
    let id = server.session(&photo(16, 12), &rest()).await;
    let puts = (0..6).map(|n| {
        put(
            &server,
            &id,
            ["a", "b", "c", "d", "e", "f"][usize::from(n)],
            grey(16, 12, n),
        )
    });
    for response in futures_util::future::join_all(puts).await {
        assert!(
            matches!(response.status().as_u16(), 201 | 503),
            "{:?}",
            response.text().await
        );
    }
    for (n, name) in ["a", "b", "c", "d", "e", "f"].iter().enumerate() {
        if layers(&server, &id).await[name].is_object() {
            assert_eq!(
                stored(&server, &id, name).await,
                Some(grey(16, 12, n as u8))
            );
        }
    }
}
