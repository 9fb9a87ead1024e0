//! Coordinate maps: what they hold, their files, their limits, and clients that leave or do not
//! read.

use mlswarp_server::limits::memory::MemoryClass;
use reqwest::Response;
use serde_json::{Value, json};

use crate::support::counters::Counted as _;
use crate::support::picture::{decoded, png_of};
use crate::support::server::{form, header, png, problem};
use crate::support::{Server, eventually, photo};

const HANDLES: &str =
    r#""p": [[40, 30], [120, 90], [30, 95]], "q": [[47, 26], [112, 95], [33, 88]]"#;

fn object(more: &str) -> Value {
    serde_json::from_str(&format!("{{{HANDLES}, {more}}}")).unwrap()
}

/// Height, width and positions of a `.npy` file, 1/2 added: px of the contract.
fn array(file: &[u8]) -> (usize, usize, Vec<[f32; 2]>) {
    assert!(file.starts_with(b"\x93NUMPY\x01\0"));
    let head = 10 + usize::from(u16::from_le_bytes([file[8], file[9]]));
    let text = std::str::from_utf8(&file[10..head]).unwrap();
    assert!(
        text.contains("'descr': '<f4', 'fortran_order': False"),
        "{text}"
    );
    let shape: Vec<usize> = text
        .split_once("'shape': (")
        .unwrap()
        .1
        .split([',', ')'])
        .map_while(|n| n.trim().parse().ok())
        .collect();
    let [height, width, 2] = shape[..] else {
        panic!("{text}")
    };
    let number = |bytes: &[u8; 4]| f32::from_le_bytes(*bytes) + 0.5;
    let positions: Vec<[f32; 2]> = file[head..]
        .as_chunks::<4>()
        .0
        .as_chunks::<2>()
        .0
        .iter()
        .map(|[x, y]| [number(x), number(y)])
        .collect();
    assert_eq!(positions.len(), width * height);
    (height, width, positions)
}

async fn map(server: &Server, object: &Value) -> Response {
    let response = server.post("/map").json(object).send().await.unwrap();
    assert_eq!(response.status(), 200, "{:?}", response.text().await);
    response
}

/// A 16-bit picture whose colours are its coordinates shows the positions of the map, and nothing
/// where these are NaN.
#[tokio::test]
async fn a_map_has_what_a_picture_shows() {
    let server = Server::start(&[]).await;
    let sample = |at: u32| u16::try_from(256 * at + 128).unwrap().to_be_bytes();
    let samples: Vec<u8> = (0..120)
        .flat_map(|y| (0..160).flat_map(move |x| [sample(x), sample(y), [0, 0]].concat()))
        .collect();
    let image = png_of(
        160,
        120,
        png::ColorType::Rgb,
        png::BitDepth::Sixteen,
        &samples,
    );
    for output in [
        r#"{"canvas": "same"}"#,
        r#"{"canvas": {"x": -20, "y": 5, "width": 100, "height": 130}}"#,
        r#"{"width": 320}"#,
    ] {
        let warp = object(&format!("\"output\": {output}"));
        let drawn = server
            .post("/warp")
            .multipart(form(&image, warp.to_string()))
            .send()
            .await
            .unwrap();
        let canvas = drawn.headers().get("warp-canvas").cloned();
        let picture = decoded(&png(drawn).await);
        let mut body = warp.clone();
        body["extent"] = json!([160, 120]);
        let response = map(&server, &body).await;
        assert_eq!(response.headers().get("warp-canvas").cloned(), canvas);
        let (_, width, positions) = array(&response.bytes().await.unwrap());
        assert_eq!(
            (width, positions.len()),
            (picture.width, picture.width * picture.height)
        );
        let mut shown = 0;
        for (pixel, [x, y]) in picture.samples.as_chunks::<8>().0.iter().zip(&positions) {
            let sample = |c: usize| f32::from(u16::from_be_bytes([pixel[2 * c], pixel[2 * c + 1]]));
            assert_eq!(x.is_nan(), sample(3) == 0.0);
            let is_inside = |at: f32, side: f32| at > 1.0 && at < side - 1.0;
            if is_inside(*x, 160.0) && is_inside(*y, 120.0) {
                let (u, v) = (sample(0) / 256.0, sample(1) / 256.0);
                assert!(
                    (u - x).abs() < 0.05 && (v - y).abs() < 0.05,
                    "{x} {y} {u} {v}"
                );
                shown += 1;
            }
        }
        assert!(
            shown * 2 > positions.len(),
            "{shown} of {}",
            positions.len()
        );
    }
}

#[tokio::test]
async fn forward_maps_take_inverse_ones_back() {
    let server = Server::start(&[]).await;
    let (height, width, forward) = array(
        &map(
            &server,
            &object(r#""extent": [160, 120], "direction": "forward""#),
        )
        .await
        .bytes()
        .await
        .unwrap(),
    );
    assert_eq!((height, width), (120, 160));
    // At the nearest pixel of where it goes, the inverse map is near again.
    let (_, _, inverse) = array(
        &map(&server, &object(r#""extent": [160, 120]"#))
            .await
            .bytes()
            .await
            .unwrap(),
    );
    let mut compared = 0;
    for (k, [x, y]) in forward.iter().enumerate() {
        assert!(
            x.is_finite() && y.is_finite(),
            "the source is all that is asked for"
        );
        let (i, j) = (x.floor() as i64, y.floor() as i64);
        if (0..160).contains(&i) && (0..120).contains(&j) {
            let [u, v] = inverse[j as usize * 160 + i as usize];
            if !u.is_nan() {
                let (dx, dy) = (u - (k % 160) as f32 - 0.5, v - (k / 160) as f32 - 0.5);
                assert!(dx.hypot(dy) < 1.2, "{k}: {dx} {dy}");
                compared += 1;
            }
        }
    }
    assert!(compared > 15_000, "{compared}");
    let outside = r#""extent": [160, 120], "direction": "forward", "canvas": {"x": -2, "y": -1,
      "width": 4, "height": 2}"#;
    let (_, _, beside) = array(&map(&server, &object(outside)).await.bytes().await.unwrap());
    let is_known: Vec<bool> = beside.iter().map(|[x, _]| !x.is_nan()).collect();
    assert_eq!(
        is_known,
        [false, false, false, false, false, false, true, true]
    );
}

#[tokio::test]
async fn sessions_and_single_requests_have_the_same_maps_in_both_formats() {
    let server = Server::start(&[]).await;
    let warp = object(r#""output": {"canvas": "fit"}"#);
    let id = server.session(&photo(160, 120), &warp).await;
    let q = json!({"q": warp["q"], "strength": 0.5});
    let mut once = warp.clone();
    (once["extent"], once["strength"]) = (json!([160, 120]), json!(0.5));
    for (accept, media_type) in [("*/*", "application/x-npy"), ("image/tiff", "image/tiff")] {
        let one = server
            .post("/map")
            .header("accept", accept)
            .json(&once)
            .send()
            .await
            .unwrap();
        let other = server
            .post(&format!("/sessions/{id}/map"))
            .header("accept", accept)
            .json(&q)
            .send()
            .await
            .unwrap();
        assert_eq!(
            (header(&one, "content-type"), header(&other, "content-type")),
            (media_type, media_type)
        );
        for name in [
            "etag",
            "content-length",
            "warp-canvas",
            "warp-folds",
            "warp-residual",
            "vary",
        ] {
            assert_eq!(header(&one, name), header(&other, name), "{name}");
        }
        let length: usize = header(&one, "content-length").parse().unwrap();
        let (one, other) = (one.bytes().await.unwrap(), other.bytes().await.unwrap());
        assert!(one == other && one.len() == length);
    }
    let refused = server
        .post("/map")
        .header("accept", "image/png")
        .json(&once)
        .send()
        .await
        .unwrap();
    problem(refused, 406, "not_acceptable").await;
    let chosen = r#"{"p": [[9, 9], [90, 9], [9, 70], [80, 80], [50, 40]], "q": [[9, 9], [90, 19],
      [9, 70], [80, 90], [50, 50]],
                     "extent": [120, 100], "method": "auto"}"#;
    let chosen = map(&server, &serde_json::from_str(chosen).unwrap()).await;
    assert!(!header(&chosen, "warp-method").is_empty());
}

#[tokio::test]
async fn maps_over_the_limits_are_refused_before_anything_is_allocated() {
    let server = Server::start(&[]).await;
    for (more, what, pointer) in [
        (r#""extent": [16384, 16384]"#, "map_pixels", "/extent"),
        (r#""extent": [4294967295, 1]"#, "map_side", "/extent"),
        (
            r#""extent": [160, 120], "width": 16384"#,
            "output_pixels",
            "/width",
        ),
        (
            r#""extent": [160, 120], "width": 4294967295"#,
            "output_side",
            "/width",
        ),
        (
            r#""extent": [160, 120], "canvas": {"x": 0, "y": 0, "width": 16384, "height": 16384}"#,
            "canvas_pixels",
            "/canvas",
        ),
        (
            r#""extent": [160, 120], "canvas": {"x": 0, "y": 0, "width": 2000000, "height": 1}"#,
            "canvas_side",
            "/canvas",
        ),
    ] {
        let found = problem(
            server
                .post("/map")
                .json(&object(more))
                .send()
                .await
                .unwrap(),
            413,
            "too_large",
        )
        .await;
        assert_eq!(
            (&found["limit_name"], &found["pointer"]),
            (&json!(what), &json!(pointer)),
            "{more}"
        );
        assert!(
            found["limit"].is_number() && found["actual"].is_number(),
            "{found}"
        );
    }
    let far =
        r#"{"p": [[1, 1]], "q": [[900000, 1]], "extent": [9, 9], "canvas": "fit", "width": 3}"#;
    let far = map(&server, &serde_json::from_str(far).unwrap()).await;
    assert_eq!(header(&far, "warp-canvas"), "899999,0,9,9");
    let nothing = r#"{"p": [[1, 1], [5, 5]], "q": [[3, 3], [3, 3]], "method": "affine",
      "extent": [9, 9], "canvas": "fit", "folds": "reject"}"#;
    let answer = server
        .post("/map")
        .body(nothing)
        .header("content-type", "application/json")
        .send()
        .await
        .unwrap();
    assert_eq!(answer.status(), 422);
    assert_eq!(server.app.counters().pictures_begun, 0);
    eventually("nothing is held", || {
        server.app.budget().taken_for(MemoryClass::Frame) == 0
    })
    .await;
}

/// 49 million positions, 392 MB. Some of it is read, and never more than a little is in memory.
#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn a_map_is_computed_as_it_is_read_and_no_longer_than_that() {
    let server = Server::start(&[]).await;
    let mut response = map(
        &server,
        &object(r#""extent": [7000, 7000], "grid": {"cell": 70}"#),
    )
    .await;
    let held = || server.app.budget().taken_for(MemoryClass::Frame);
    let mut read = 0;
    while read < 40 << 20 {
        read += response.chunk().await.unwrap().expect("more").len();
        assert!(held() < 32 << 20, "{} bytes", held());
    }
    // Nobody reads: what is on its way fills up, and nothing more is computed.
    tokio::time::sleep(std::time::Duration::from_millis(300)).await;
    eventually("no band is computed", || server.app.pool().running() == 0).await;
    assert!(held() < 32 << 20, "{} bytes", held());
    drop(response);
    eventually("everything is given back", || {
        held() == 0 && server.app.pool().running() == 0
    })
    .await;
    server.is_well().await;
}
