//! What an upload says beside its pixels, on every route that draws it; backgrounds in units of its
//! depth; and files with more samples than a picture has.

use std::io::{Cursor, Read as _};

use image::{DynamicImage, GenericImageView as _, ImageBuffer, ImageFormat, Luma};
use reqwest::Response;
use serde_json::{Value, json};

use crate::support::program::mlswarp;
use crate::support::server::{form, header, problem};
use crate::support::{Server, bombs, photo};

/// A PNG with further chunks before its data.
fn with_chunks(png: &[u8], chunks: &[(&'static [u8; 4], Vec<u8>)]) -> Vec<u8> {
    let data = png.windows(4).position(|kind| kind == b"IDAT").unwrap() - 4;
    let mut file = png.to_vec();
    file.splice(data..data, bombs::png(chunks).split_off(8));
    file
}

/// The pixels per metre of a PNG.
fn per_metre(png: &[u8]) -> Option<[u32; 2]> {
    let at = png.windows(4).position(|kind| kind == b"pHYs")? + 4;
    Some([0, 4].map(|k| u32::from_be_bytes(png[at + k..][..4].try_into().unwrap())))
}

async fn bytes(response: Response) -> Vec<u8> {
    assert_eq!(response.status(), 200, "{:?}", response.text().await);
    response.bytes().await.unwrap().to_vec()
}

fn warning(response: &Response) -> Option<&str> {
    response
        .headers()
        .get("warp-warning")
        .map(|value| value.to_str().unwrap())
}

/// The picture, a layer, the frames of a batch and the offline tool: px per mm times the scale of
/// the picture is that of the upload.
#[tokio::test]
async fn a_pixel_keeps_its_length_wherever_it_is_drawn() {
    let server = Server::start(&[]).await;
    let resolution = (b"pHYs", b"\0\0\x2E\x23\0\0\x17\x11\x01".to_vec());
    let file = with_chunks(&photo(80, 60), &[resolution]);
    let scaled = json!({"p": [[20, 20]], "q": [[22, 20]], "output": {"width": 40}});
    let half = [5_906, 2_953];
    assert_eq!(
        per_metre(&bytes(server.upload("/warp", &file, &scaled).await).await),
        Some(half)
    );
    let cropped = json!({"p": [[20, 20]], "q": [[22, 20]],
        "output": {"canvas": {"x": 5, "y": 5, "width": 20, "height": 30}}});
    assert_eq!(
        per_metre(&bytes(server.upload("/warp", &file, &cropped).await).await),
        Some([11_811, 5_905])
    );

    let id = server.session(&file, &json!({"p": [[20, 20]]})).await;
    let put = server
        .client
        .put(server.url(&format!("/sessions/{id}/layers/a")))
        .body(file.clone())
        .send()
        .await
        .unwrap();
    assert_eq!(put.status(), 201);
    let put = server
        .client
        .put(server.url(&format!("/sessions/{id}/layers/b?kind=labels")))
        .body(file.clone())
        .send()
        .await
        .unwrap();
    assert_eq!(put.status(), 201);
    for layer in [Value::Null, json!("a"), json!("b")] {
        let drag = server
            .drag(
                &id,
                &json!({"q": [[22, 20]], "layer": layer, "output": {"width": 40}}),
            )
            .await;
        assert_eq!(per_metre(&bytes(drag).await), Some(half), "{layer}");
    }
    let batch = json!({"q": [[24, 20]], "steps": 2, "output": {"width": 40}, "layers": ["a", "b"]});
    let zip = bytes(
        server
            .post(&format!("/sessions/{id}/batch"))
            .json(&batch)
            .send()
            .await
            .unwrap(),
    )
    .await;
    let mut archive = zip::ZipArchive::new(Cursor::new(zip)).unwrap();
    let mut pictures = 0;
    for k in 0..archive.len() {
        let mut entry = archive.by_index(k).unwrap();
        if entry.name().unwrap().ends_with(".png") {
            let mut png = Vec::new();
            entry.read_to_end(&mut png).unwrap();
            assert_eq!(per_metre(&png), Some(half), "{:?}", entry.name());
            pictures += 1;
        }
    }
    assert_eq!(pictures, 6);

    let folder = tempfile_folder("length");
    let path = |name: &str| folder.join(name).to_str().unwrap().to_owned();
    std::fs::write(path("in.png"), &file).unwrap();
    std::fs::write(path("warp.json"), scaled.to_string()).unwrap();
    let output = mlswarp(&[
        "warp",
        &path("in.png"),
        &path("warp.json"),
        "-o",
        &path("out.png"),
    ])
    .output()
    .unwrap();
    assert!(output.status.success(), "{output:?}");
    assert_eq!(
        per_metre(&std::fs::read(path("out.png")).unwrap()),
        Some(half)
    );
    std::fs::remove_dir_all(folder).unwrap();
}

fn tempfile_folder(name: &str) -> std::path::PathBuf {
    let folder = std::env::temp_dir().join(format!(
        "mlswarp-test-{}-metadata-{name}",
        std::process::id()
    ));
    std::fs::create_dir_all(&folder).unwrap();
    folder
}

/// The header has the codes; the report of the session has the names.
#[tokio::test]
async fn what_is_dropped_or_mended_is_named() {
    let server = Server::start(&[]).await;
    let linear = (b"gAMA", 100_000_u32.to_be_bytes().to_vec());
    let chunks = [
        linear,
        (b"tEXt", b"Author\0me".to_vec()),
        (b"prVt", vec![1]),
        (b"sBIT", vec![5, 5, 5]),
    ];
    let mut file = with_chunks(&photo(24, 16), &chunks);
    let end = file.len() - 12;
    file.truncate(end);
    let warp = json!({"p": [[2, 2]], "q": [[3, 2]]});
    let png = server.upload("/warp", &file, &warp).await;
    assert_eq!(
        warning(&png),
        Some("translation_only, metadata_dropped, file_repaired")
    );
    let id = server.session(&file, &json!({"p": [[2, 2]]})).await;
    let of = |warnings: &Value, code: &str| {
        warnings
            .as_array()
            .unwrap()
            .iter()
            .find(|entry| entry["code"] == code)
            .cloned()
    };
    for (format, dropped) in [
        ("png", json!(["significant bits", "application data"])),
        (
            "jpeg",
            json!(["text", "significant bits", "application data"]),
        ),
    ] {
        let body = json!({"q": [[3, 2]], "output": {"format": format}});
        let report: Value = server
            .post(&format!("/sessions/{id}/report"))
            .json(&body)
            .send()
            .await
            .unwrap()
            .json()
            .await
            .unwrap();
        let warnings = &report["warnings"];
        assert_eq!(
            of(warnings, "metadata_dropped").unwrap()["dropped"],
            dropped,
            "{format}: {report}"
        );
        assert_eq!(
            of(warnings, "file_repaired").unwrap()["repaired"],
            json!(["no end of the file"])
        );
        assert_eq!(of(warnings, "profile_dropped").is_some(), format == "jpeg");
    }
    for (kind, codes) in [
        ("application/zip", "metadata_dropped, file_repaired"),
        ("image/apng", "metadata_dropped, file_repaired"),
        (
            "image/gif",
            "profile_dropped, metadata_dropped, file_repaired",
        ),
    ] {
        let batch = server
            .post(&format!("/sessions/{id}/batch"))
            .header("accept", kind)
            .json(&json!({"q": [[3, 2]], "steps": 2}));
        let batch = batch.send().await.unwrap();
        assert_eq!(warning(&batch), Some(codes), "{kind}");
    }
    let plain = server.upload("/warp", &photo(24, 16), &warp).await;
    assert_eq!(warning(&plain), Some("translation_only"));
}

fn deep(value: u16) -> Vec<u8> {
    let mut file = Cursor::new(Vec::new());
    let picture = ImageBuffer::from_fn(40, 30, |x, y| Luma([value + (x * y) as u16]));
    DynamicImage::ImageLuma16(picture)
        .write_to(&mut file, ImageFormat::Png)
        .unwrap();
    file.into_inner()
}

/// A value outside has the depth of the picture; it is grey with one number, and white enough for a
/// JPEG.
#[tokio::test]
async fn the_outside_has_a_value_of_the_depth() {
    let server = Server::start(&[]).await;
    let file = deep(20_000);
    let warp = |output: Value| json!({"p": [[5, 5]], "q": [[25, 20]], "output": output});
    let drawn = |output: Value| {
        let (server, warp, file) = (&server, warp(output), &file);
        async move {
            let response = server.upload("/warp", file, &warp).await;
            let tag = header(&response, "etag").to_owned();
            (
                image::load_from_memory(&bytes(response).await).unwrap(),
                tag,
            )
        }
    };
    let mut tags = Vec::new();
    for format in ["png", "tiff"] {
        let (grey, tag) = drawn(json!({"outside": {"value": 300}, "format": format})).await;
        let DynamicImage::ImageLuma16(grey) = grey else {
            panic!("{format}: {:?}", grey.color())
        };
        assert_eq!(grey.get_pixel(0, 0)[0], 300, "{format}");
        let (colour, other) =
            drawn(json!({"outside": {"value": [300, 301, 65_535]}, "format": format})).await;
        let DynamicImage::ImageRgb16(colour) = colour else {
            panic!("{format}: {:?}", colour.color())
        };
        assert_eq!(colour.get_pixel(0, 0).0, [300, 301, 65_535], "{format}");
        tags.extend([tag, other]);
    }
    let (_, black) = drawn(json!({"outside": "#000000ff"})).await;
    tags.push(black);
    let (jpeg, tag) =
        drawn(json!({"outside": {"value": 32_768}, "format": "jpeg", "quality": 100})).await;
    assert!(jpeg.get_pixel(0, 0)[0].abs_diff(128) <= 2);
    tags.push(tag);
    tags.sort_unstable();
    tags.dedup();
    assert_eq!(tags.len(), 6, "every answer has a tag of its own");

    // The session keeps it, and gives it back as it was sent.
    let id = server
        .session(
            &file,
            &json!({"p": [[5, 5]], "output": {"outside": {"value": [9, 9, 9]}}}),
        )
        .await;
    let session: Value = server
        .get(&format!("/sessions/{id}"))
        .send()
        .await
        .unwrap()
        .json()
        .await
        .unwrap();
    assert_eq!(session["output"]["outside"], json!({"value": 9}));
    let picture =
        image::load_from_memory(&bytes(server.drag(&id, &json!({"q": [[25, 20]]})).await).await)
            .unwrap();
    assert_eq!(picture.into_luma16().get_pixel(0, 0)[0], 9);

    // Labels have none of their own: refused if it is asked for, without effect if the session has
    // it.
    let labels = server
        .client
        .put(server.url(&format!("/sessions/{id}/layers/l?kind=labels")))
        .body(file.clone())
        .send()
        .await
        .unwrap();
    assert_eq!(labels.status(), 201);
    let drawn = bytes(
        server
            .drag(&id, &json!({"q": [[25, 20]], "layer": "l"}))
            .await,
    )
    .await;
    assert_eq!(
        image::load_from_memory(&drawn)
            .unwrap()
            .into_luma16()
            .get_pixel(0, 0)[0],
        0
    );
    let asked = json!({"q": [[25, 20]], "layer": "l", "output": {"outside": {"value": 1}}});
    let refused = problem(server.drag(&id, &asked).await, 422, "bad_value").await;
    assert_eq!(refused["pointer"], "/output/outside");
    let batch = json!({"q": [[25, 20]], "steps": 2, "layers": ["l"]});
    bytes(
        server
            .post(&format!("/sessions/{id}/batch"))
            .json(&batch)
            .send()
            .await
            .unwrap(),
    )
    .await;

    // Beyond the depth, wherever it is given.
    let beyond =
        json!({"p": [[5, 5]], "q": [[6, 5]], "output": {"outside": {"value": [0, 256, 0]}}});
    for path in ["/warp", "/sessions"] {
        let sent = server
            .post(path)
            .multipart(form(&photo(24, 16), beyond.to_string()))
            .send()
            .await
            .unwrap();
        let refused = problem(sent, 422, "bad_value").await;
        assert_eq!(
            (&refused["pointer"], &refused["limit"], &refused["actual"]),
            (&json!("/output/outside/value"), &json!(255), &json!(256))
        );
    }
    let id = server
        .session(&photo(24, 16), &json!({"p": [[5, 5]]}))
        .await;
    let handles = server
        .client
        .put(server.url(&format!("/sessions/{id}/handles")));
    let put = handles
        .json(&json!({"output": {"outside": {"value": 300}}}))
        .send()
        .await
        .unwrap();
    problem(put, 422, "bad_value").await;
}

/// Two samples per pixel without a meaning: never one of them, and never alpha.
#[tokio::test]
async fn samples_that_a_picture_does_not_have_are_refused() {
    let server = Server::start(&[]).await;
    // Little-endian, one row of two pixels.
    let mut file = b"II*\0\x0C\0\0\0\x01\x02\x03\x04".to_vec();
    let tags: [(u16, u16, u32, u32); 8] = [
        (256, 3, 1, 2),
        (257, 3, 1, 1),
        (258, 3, 1, 8),
        (262, 3, 1, 1),
        (273, 4, 1, 8),
        (277, 3, 1, 2),
        (278, 3, 1, 1),
        (279, 4, 1, 4),
    ];
    file.extend((tags.len() as u16).to_le_bytes());
    for (tag, kind, count, value) in tags {
        file.extend(
            [
                &tag.to_le_bytes()[..],
                &kind.to_le_bytes(),
                &count.to_le_bytes(),
                &value.to_le_bytes(),
            ]
            .concat(),
        );
    }
    file.extend([0; 4]);
    let sent = server
        .upload("/warp", &file, &json!({"p": [[1, 1]], "q": [[1, 1]]}))
        .await;
    let refused = problem(sent, 415, "unsupported_format").await;
    let detail = refused["detail"].as_str().unwrap();
    assert!(
        detail.contains("2 samples per pixel") && detail.contains("layers of a session"),
        "{detail}"
    );
}
