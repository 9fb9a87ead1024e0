//! Mistakes that new users make, each sent as people send it, and the sentences that tell them what
//! to do: code, pointer and words of the problem, or the warnings of the response.

use reqwest::RequestBuilder;
use reqwest::multipart::{Form, Part};
use serde_json::{Value, json};

use crate::support::drag_client::Received;
use crate::support::server::{form, header, png, problem};
use crate::support::{DragClient, Server, bombs, photo};

/// Sends a request whose problem has this status, code and pointer, and whose detail contains these
/// words.
async fn told(
    request: RequestBuilder,
    status: u16,
    code: &str,
    pointer: Option<&str>,
    words: &[&str],
) -> Value {
    let document = problem(request.send().await.unwrap(), status, code).await;
    assert_eq!(document["pointer"].as_str(), pointer, "{document}");
    let detail = document["detail"].as_str().unwrap();
    for word in words {
        assert!(detail.contains(word), "{word}: {document}");
    }
    assert!(
        detail.chars().count() < 600 && !detail.contains(char::is_control),
        "{document}"
    );
    document
}

fn part(bytes: &[u8]) -> Part {
    Part::bytes(bytes.to_vec())
}

/// The codes of `Warp-Warning`.
fn warnings(response: &reqwest::Response) -> Vec<&str> {
    assert!(response.status().is_success());
    let codes = response
        .headers()
        .get("warp-warning")
        .map_or("", |codes| codes.to_str().unwrap());
    codes.split(", ").filter(|code| !code.is_empty()).collect()
}

#[tokio::test]
async fn mistakes_in_the_warp_object_are_answered_with_what_was_meant() {
    let server = Server::start(&[]).await;
    let image = photo(64, 48);
    let both = "did you mean `p` and `q`? `p` is where the handles are, `q` is where they go";
    let cases: &[(&str, &str, &str, &[&str])] = &[
        (
            r#"{"q": [[10, 10], [20, 20]]}"#,
            "bad_value",
            "/p",
            &["`p` is missing: where do the handles start?"],
        ),
        (
            r#"{"p": [[10, 10]]}"#,
            "bad_value",
            "/q",
            &["`q` is missing: where do the handles go?"],
        ),
        (
            r#"{"p": [["10", "10"]], "q": [[10, 10]]}"#,
            "bad_value",
            "/p/0/0",
            &["expected a number; found a string; remove the quotes"],
        ),
        (
            r#"{"p": "[[10, 10]]", "q": [[10, 10]]}"#,
            "bad_value",
            "/p",
            &["found a string; remove the quotes"],
        ),
        (
            r#"{"p": [], "alpha": "1.5"}"#,
            "bad_value",
            "/alpha",
            &["expected a number; found a string; remove the quotes"],
        ),
        (
            r#"{"p": [], "output": {"width": "320"}}"#,
            "bad_value",
            "/output/width",
            &["found a string; remove the quotes"],
        ),
        (
            r#"{"src": [[10, 10]], "dst": [[12, 10]]}"#,
            "unknown_field",
            "/src",
            &["unknown field: `src`", both],
        ),
        (
            r#"{"source": [[10, 10]], "target": [[12, 10]]}"#,
            "unknown_field",
            "/source",
            &[both],
        ),
        (
            r#"{"from": [[10, 10]], "to": [[12, 10]]}"#,
            "unknown_field",
            "/from",
            &[both],
        ),
        (
            r#"{"points": [[10, 10]]}"#,
            "unknown_field",
            "/points",
            &[both],
        ),
        (
            r#"{"p": [], "metod": "rigid"}"#,
            "unknown_field",
            "/metod",
            &["unknown field: `metod`; did you mean `method`?"],
        ),
        (
            r#"{"p": [], "method": "similarty"}"#,
            "bad_value",
            "/method",
            &["found `similarty`; did you mean `similarity`?"],
        ),
        (
            r#"{"p": [], "method": "Rigid"}"#,
            "bad_value",
            "/method",
            &["found `Rigid`; did you mean `rigid`?"],
        ),
        (
            r#"{"p": [], "units": "pixels"}"#,
            "bad_value",
            "/units",
            &["did you mean `px`?"],
        ),
        (
            r#"{"p": [], "output": {"format": "jpg"}}"#,
            "bad_value",
            "/output/format",
            &["found `jpg`; did you mean `jpeg`?"],
        ),
        (
            r#"{"p": [], "output": {"outside": "red"}}"#,
            "bad_value",
            "/output/outside",
            &["found `red`; did you mean `#ff0000`?"],
        ),
        (
            r##"{"p": [], "output": {"outside": "#fff"}}"##,
            "bad_value",
            "/output/outside",
            &["found `#fff`; did you mean `#ffffff`?"],
        ),
        (
            r#"{"p": [], "output": {"outside": "white"}}"#,
            "bad_value",
            "/output/outside",
            &["did you mean `#ffffff`?"],
        ),
        (
            r#"{"p": [], "output": {"method": "rigid"}}"#,
            "unknown_field",
            "/output/method",
            &["put it beside `output`, not in it"],
        ),
        (
            r#"{"p": [], "cell": 5}"#,
            "unknown_field",
            "/cell",
            &["put it in `grid`: `grid.cell`"],
        ),
        (
            r#"{"p": [], "grid": {"cells": 5}}"#,
            "unknown_field",
            "/grid/cells",
            &["did you mean `cell`?", "`cell`, `columns`, `rows`"],
        ),
        (
            r#"{"p": [], "qualitty": 5}"#,
            "unknown_field",
            "/qualitty",
            &["unknown field: `qualitty`; known fields: `p`"],
        ),
        (
            r#"{"strength": 50}"#,
            "bad_value",
            "/strength",
            &["between -10 and 10, where 1 is 100 %; found 50"],
        ),
        (
            r#"{"p": [], "steps": 7}"#,
            "unknown_field",
            "/steps",
            &["`steps` belongs to many frames in one file: POST /sessions/{id}/batch"],
        ),
        (
            r#"{"p": [], "jitter": {}}"#,
            "unknown_field",
            "/jitter",
            &["POST /sessions/{id}/batch, or mlswarp batch"],
        ),
        (
            r#"{"p": [], "boxes": []}"#,
            "unknown_field",
            "/boxes",
            &["`boxes` belongs to annotations: POST /points"],
        ),
        (
            r#"{"p": [], "candidates": []}"#,
            "unknown_field",
            "/candidates",
            &["POST /fit"],
        ),
        (
            r#"{"height": 10}"#,
            "unknown_field",
            "/height",
            &["the height follows from `output.width`"],
        ),
        (
            r#"{"output": {"scale": 2}}"#,
            "unknown_field",
            "/output/scale",
            &["the height follows from `output.width`"],
        ),
        (
            r#"{"warp": {"p": []}}"#,
            "unknown_field",
            "/warp",
            &["send the content of `warp`, without `warp`"],
        ),
        (
            r#"{"image": "a.png"}"#,
            "unknown_field",
            "/image",
            &["the image is a part of its own, beside the part `warp`"],
        ),
        (
            r#"{"output.format": "jpeg"}"#,
            "unknown_field",
            "/output.format",
            &[r#"nest it: {"output": {"format": ...}}"#],
        ),
        (
            r#"{"output": "jpeg"}"#,
            "bad_value",
            "/output",
            &[r#"expected an object, such as {"format": "jpeg"}; found a string"#],
        ),
        (
            r#"{"p": [[[1, 1], [2, 2]], [[3, 3], [4, 4]]]}"#,
            "bad_value",
            "/q",
            &["arrays of their own, not an array of pairs"],
        ),
        (
            r#"{"p": [], "output": {"outside": "ede"}}"#,
            "bad_value",
            "/output/outside",
            &["did you mean `edge`?"],
        ),
        (
            r#"{"point_mass": -1e300, "p": [[1, 1]], "q": [[1, 1]]}"#,
            "bad_value",
            "/point_mass",
            &["`point_mass` is -1e300; it must"],
        ),
        (
            r#"{"alpha": 1e300, "p": [[1, 1]], "q": [[1, 1]]}"#,
            "alpha_out_of_range",
            "/alpha",
            &["`alpha` is 1e300; it must be above 0"],
        ),
        (
            r#"{"p": [[1, 1e300]], "q": [[1, 1]]}"#,
            "bad_value",
            "/p/0",
            &["a coordinate of 1e300 px"],
        ),
        (
            r#"{"grid": {"tolerance": 0.04}}"#,
            "bad_value",
            "/grid/tolerance",
            &["between 0.05 and 4", "found 0.04"],
        ),
        (
            r#"{"grid": {"tolerance": 1, "cell": 5}}"#,
            "bad_value",
            "/grid",
            &["expected `tolerance` or `cell` alone"],
        ),
        (
            r#"{"grid": {"cell": -1e300}}"#,
            "bad_value",
            "/grid/cell",
            &["found -1e300"],
        ),
        (
            r#"{"method": "tps", "p": [[1, 1], [[2, 2], [3, 3]]], "q": []}"#,
            "bad_value",
            "/p/1",
            &["handle 1 is a line, but the method `tps` takes points"],
        ),
        (
            r#"{"method": "tps", "alpha": 1}"#,
            "bad_value",
            "/alpha",
            &["`alpha` does not apply: it belongs to the methods `rigid`"],
        ),
        (
            r#"{"method": "tps", "point_mass": 1}"#,
            "bad_value",
            "/point_mass",
            &["`point_mass` does not apply: it belongs to the methods `rigid`, `similarity`"],
        ),
        (
            r#"{"smoothing": 0}"#,
            "bad_value",
            "/smoothing",
            &["`smoothing` does not apply: it belongs to the method `tps`"],
        ),
        (
            r#"{"method": "tps", "smothing": 1}"#,
            "unknown_field",
            "/smothing",
            &["did you mean `smoothing`?"],
        ),
        (
            r#"{"p": [[1, 1]], "method": "auto"}"#,
            "bad_value",
            "/q",
            &["`q` is missing: where do the handles go?"],
        ),
        (
            r#"{"p": [[1, 1]], "q": [[1, 2]], "method": "auto", "alpha": 1}"#,
            "bad_value",
            "/alpha",
            &["the method `auto` chooses it"],
        ),
        (
            r#"{"method": "global_affine", "alpha": 1}"#,
            "bad_value",
            "/alpha",
            &["it belongs to the methods `rigid`"],
        ),
        (
            r#"{"output": {"format": "gif"}}"#,
            "bad_value",
            "/output/format",
            &["`png`, `jpeg`, `webp`", "`tiff`"],
        ),
        (
            r#"{"output": {"canvas": {"x": 0}}}"#,
            "bad_value",
            "/output/canvas",
            &["expected `x`, `y`, `width` and `height`"],
        ),
        (
            r#"{"output": {"canvas": "fitt"}}"#,
            "bad_value",
            "/output/canvas",
            &["did you mean `fit`?"],
        ),
        (
            r#"{"output": {"subsampling": "4:2:2"}}"#,
            "bad_value",
            "/output/subsampling",
            &["`4:2:0`, `4:4:4`; found `4:2:2`"],
        ),
        (
            r#"{"region": 1}"#,
            "not_supported",
            "/region",
            &["not supported by this version: `region`"],
        ),
        (
            r#"{"p": [], "coincident": "mean"}"#,
            "bad_value",
            "/coincident",
            &["expected an object", "found a string"],
        ),
        (
            r#"{"p": [], "coincident": {"policy": "average"}}"#,
            "bad_value",
            "/coincident/policy",
            &["`mean`, `reject`; found `average`"],
        ),
        (
            r#"{"p": [], "coincident": {"within": -1}}"#,
            "bad_value",
            "/coincident/within",
            &["a distance in pixels, 0 to 1000000; found -1"],
        ),
        (
            r#"{"region": 1}"#,
            "not_supported",
            "/region",
            &["supported: `p`, `q`"],
        ),
        (
            r#"{"p": [], "frobnicate": 1}"#,
            "unknown_field",
            "/frobnicate",
            &["unknown field: `frobnicate`; known fields: `p`, `q`"],
        ),
    ];
    for (warp, code, pointer, words) in cases {
        told(
            server.post("/warp").multipart(form(&image, *warp)),
            422,
            code,
            Some(pointer),
            words,
        )
        .await;
    }
    let nulls = r#"{"coincident": null, "region": null, "grid": {"tolerance": null, "cell": 9},
      "output": {"subsampling": null}}"#;
    assert_eq!(
        server
            .post("/warp")
            .multipart(form(&image, nulls))
            .send()
            .await
            .unwrap()
            .status(),
        200
    );
    for name in [
        "format",
        "quality",
        "subsampling",
        "compression",
        "width",
        "filter",
        "outside",
    ] {
        let warp = json!({"p": [[10, 10]], "q": [[12, 10]], name: 1}).to_string();
        let hint = format!("put it in `output`: `output.{name}`");
        told(
            server.post("/warp").multipart(form(&image, warp)),
            422,
            "unknown_field",
            Some(&format!("/{name}")),
            &[&hint],
        )
        .await;
    }
    // Other kinds of objects, each known by its members and not by one of its fields.
    let geojson = r#"{"type": "FeatureCollection", "features": []}"#;
    for (warp, pointer, words) in [
        (
            geojson,
            "/type",
            "this is GeoJSON, a FeatureCollection: POST /points maps it, in the field `geojson`",
        ),
        (
            r#"{"best": {"method": "tps"}, "candidates": []}"#,
            "/best",
            "this is an answer of /fit: the fields of its `best`",
        ),
        (
            r#"{"shapes": [], "imagePath": "a.png"}"#,
            "/shapes",
            "this is a labelme file: send it as landmarks",
        ),
    ] {
        let document = told(
            server.post("/warp").multipart(form(&image, warp)),
            422,
            "unknown_field",
            Some(pointer),
            &[words],
        )
        .await;
        assert!(
            !document["detail"]
                .as_str()
                .unwrap()
                .contains("did you mean"),
            "{document}"
        );
    }
    let body = format!(r#"{{"p": [], "extent": [64, 48], {}"#, &geojson[1..]);
    let points = server
        .post("/points")
        .header("content-type", "application/json")
        .body(body);
    told(
        points,
        422,
        "unknown_field",
        Some("/type"),
        &["a FeatureCollection: put it in `geojson`"],
    )
    .await;
    let refused = server
        .post("/points")
        .json(&json!({"p": []}))
        .send()
        .await
        .unwrap()
        .text()
        .await
        .unwrap();
    let words = ["this is an error of an earlier request, `bad_value`: `\\`extent\\` is missing"];
    told(
        server.post("/warp").multipart(form(&image, refused)),
        422,
        "unknown_field",
        Some("/code"),
        &words,
    )
    .await;
    for (body, hint) in [
        (
            "[[1, 2]]",
            "found an array; handles are {\"p\": [...], \"q\": [...]}",
        ),
        (
            r#"[{"type": "Feature", "geometry": null}]"#,
            "found an array; GeoJSON goes in the field `geojson`",
        ),
    ] {
        let request = server
            .post("/points")
            .header("content-type", "application/json")
            .body(body);
        told(request, 400, "malformed_request", None, &[hint]).await;
    }
    // Why a size is needed where there is no image.
    for path in ["/points", "/report", "/map", "/fit"] {
        let request = server
            .post(path)
            .json(&json!({"p": [[1, 1]], "q": [[1, 2]]}));
        let words = [
            "`extent` is missing: expected the size of the image, [width, height] in pixels; this \
                request has no image",
        ];
        told(request, 422, "bad_value", Some("/extent"), &words).await;
    }
    // The same without an image, and in a session.
    let points = json!({"q": [[10, 10]], "extent": [64, 48], "points": [[1, 2]]});
    told(
        server.post("/points").json(&points),
        422,
        "bad_value",
        Some("/p"),
        &["where do the handles start?"],
    )
    .await;
    told(
        server
            .post("/sessions")
            .multipart(form(&image, r#"{"q": [[1, 1]]}"#)),
        422,
        "bad_value",
        Some("/p"),
        &["start?"],
    )
    .await;
    let id = server.session(&image, &json!({"p": [[10, 10]]})).await;
    for (body, pointer, words) in [
        (
            json!({"p": [[10, 10]], "q": [[12, 10]]}),
            "/p",
            "the session has `p`; send only `q`",
        ),
        (json!({"dst": [[12, 10]]}), "/dst", "did you mean `q`?"),
        (
            json!({"q": [[12, 10]], "method": "affine"}),
            "/method",
            "the session has `method`; replace it with PUT /sessions/{id}/handles",
        ),
        (
            json!({"q": [[12, 10]], "width": 32}),
            "/width",
            "put it in `output`: `output.width`",
        ),
    ] {
        told(
            server.post(&format!("/sessions/{id}/warp")).json(&body),
            422,
            "unknown_field",
            Some(pointer),
            &[words],
        )
        .await;
    }
    let batch = server
        .post(&format!("/sessions/{id}/batch"))
        .json(&json!({"q": [[12, 10]], "frames": 24}));
    told(
        batch,
        422,
        "bad_value",
        Some("/frames"),
        &["found a number; did you mean `steps`: 24?"],
    )
    .await;
    for name in ["landmarks", "pins"] {
        let points = server
            .post(&format!("/sessions/{id}/points"))
            .json(&json!({"q": [[12, 10]], name: []}));
        told(
            points,
            422,
            "unknown_field",
            Some(&format!("/{name}")),
            &["did you mean `points`?"],
        )
        .await;
    }
    let inverse = server
        .post(&format!("/sessions/{id}/points"))
        .json(&json!({"q": [[12, 10]], "inverse": "true"}));
    told(
        inverse,
        422,
        "bad_value",
        Some("/inverse"),
        &["found a string; remove the quotes"],
    )
    .await;
    // New handles of a session may come with q alone.
    let response = server
        .client
        .put(server.url(&format!("/sessions/{id}/handles")))
        .json(&json!({"q": [[12, 10]]}))
        .send()
        .await
        .unwrap();
    assert_eq!(response.status(), 200);
    server.is_well().await;
}

#[tokio::test]
async fn mistakes_in_the_shape_of_handles_give_both_counts() {
    let server = Server::start(&[]).await;
    let image = photo(16, 12);
    for (warp, code, pointer, words) in [
        (
            r#"{"p": [[1, 1], [2, 2]], "q": [[1, 1]]}"#,
            "shape_mismatch",
            "/q",
            "`q` has 1 handle, but `p` has 2",
        ),
        (
            r#"{"p": [], "q": [[1, 1]]}"#,
            "shape_mismatch",
            "/q",
            "`q` has 1 handle, but `p` has 0",
        ),
        (
            r#"{"p": [[1, 1], [2, 2]], "q": [[1, 1], [2, 2]], "weights": [1]}"#,
            "shape_mismatch",
            "/weights",
            "`weights` has 1 number, but `p` has 2 handles",
        ),
        (
            r#"{"p": [{"x": 1, "y": 1}], "q": []}"#,
            "bad_value",
            "/p/0",
            "expected a handle: [x, y] or [[x, y], [x, y], ...]; found an object",
        ),
        (
            r#"{"p": [1, 1], "q": [2, 1]}"#,
            "bad_value",
            "/p/0",
            "expected a handle: [x, y] or [[x, y], [x, y], ...]; found a number",
        ),
    ] {
        told(
            server.post("/warp").multipart(form(&image, warp)),
            422,
            code,
            Some(pointer),
            &[words],
        )
        .await;
    }
}

#[tokio::test]
async fn mistakes_that_are_legal_are_answered_with_a_warning() {
    const OUTSIDE: &str = "handles_outside_picture";
    const NORMALIZED: &str = "looks_normalized";
    const NOTHING: &str = "nothing_visible";
    let server = Server::start(&[]).await;
    let image = photo(300, 60);
    let cases: &[(&str, Value, &[&str])] = &[
        (
            "correct",
            json!({"p": [[10, 10], [290, 50]], "q": [[20, 10], [280, 50]]}),
            &[],
        ),
        (
            "correct, normalised",
            json!({"p": [[0.1, 0.2], [0.9, 0.8]], "q": [[0.2, 0.2], [0.8, 0.8]],
                "units": "normalized"}),
            &[],
        ),
        ("no handles", json!({}), &[]),
        (
            "beside the picture",
            json!({"p": [[-200, 30], [550, 30]], "q": [[-200, 30], [550, 30]]}),
            &[],
        ),
        (
            "x and y swapped",
            json!({"p": [[10, 10], [50, 290]], "q": [[10, 20], [50, 280]]}),
            &[OUTSIDE],
        ),
        (
            "a line that is swapped",
            json!({"p": [[[10, 10], [50, 290]]], "q": [[[10, 20], [50, 280]]]}),
            &[OUTSIDE],
        ),
        ("a corner", json!({"p": [[0, 0]], "q": [[30, 20]]}), &[]),
        (
            "below a strip",
            json!({"p": [[10, 10], [290, 130]], "q": [[10, 12], [290, 130]]}),
            &[],
        ),
        (
            "fractions as px in q",
            json!({"p": [[10, 10], [290, 50]], "q": [[0.1, 0.2], [0.9, 0.8]]}),
            &[NORMALIZED],
        ),
        (
            "corners as px",
            json!({"p": [[0, 0], [1, 1]], "q": [[0, 0], [1, 1]]}),
            &[NORMALIZED],
        ),
        (
            "fractions as px",
            json!({"p": [[0.1, 0.2], [0.9, 0.8]], "q": [[0.2, 0.2], [0.8, 0.8]]}),
            &[NORMALIZED],
        ),
        (
            "px as fractions",
            json!({"p": [[10, 10], [290, 50]], "q": [[20, 10], [280, 50]], "units": "normalized"}),
            &[OUTSIDE, NORMALIZED, NOTHING],
        ),
        (
            "px in q alone",
            json!({"p": [[0.1, 0.2], [0.9, 0.8]], "q": [[0.1, 0.2], [250, 0.8]],
                "units": "normalized"}),
            &[OUTSIDE, NORMALIZED],
        ),
        (
            "q far away",
            json!({"p": [[10, 10], [290, 50]], "q": [[10, 10], [3e5, 3e5]]}),
            &[OUTSIDE],
        ),
        (
            "all out of view",
            json!({"p": [[10, 10], [290, 50]], "q": [[410, 10], [690, 50]]}),
            &[NOTHING],
        ),
        (
            "all far away",
            json!({"p": [[10, 10], [290, 50]], "q": [[300_010, 10], [300_290, 50]]}),
            &[OUTSIDE, NOTHING],
        ),
    ];
    let (tiny, shares) = (photo(1, 1), json!([[0.1, 0.2], [0.9, 0.8]]));
    let response = server
        .upload(
            "/warp",
            &tiny,
            &json!({"p": shares, "q": shares, "units": "normalized"}),
        )
        .await;
    assert!(
        !warnings(&response).contains(&NORMALIZED),
        "correct, however small"
    );
    // Routes without a picture in the response.
    let points = json!({"extent": [300, 60], "p": [[0.1, 0.2], [0.9, 0.8]],
        "q": [[0.2, 0.2], [0.8, 0.8]], "points": []});
    let response = server.post("/points").json(&points).send().await.unwrap();
    assert_eq!(warnings(&response), [NORMALIZED]);
    let created = server
        .upload("/sessions", &image, &json!({"p": [[0.1, 0.2], [0.9, 0.8]]}))
        .await;
    assert_eq!(
        (created.status().as_u16(), warnings(&created)),
        (201, vec![NORMALIZED])
    );
    let id = created.json::<Value>().await.unwrap()["id"]
        .as_str()
        .unwrap()
        .to_owned();
    let posed = json!({"q": [[0.2, 0.2], [0.8, 0.8]], "points": []});
    let response = server
        .post(&format!("/sessions/{id}/points"))
        .json(&posed)
        .send()
        .await
        .unwrap();
    assert_eq!(warnings(&response), [NORMALIZED]);
    let landscape = photo(320, 214);
    let swapped =
        json!({"p": [[100, 40], [120, 300], [60, 200]], "q": [[100, 50], [120, 290], [60, 200]]});
    assert!(
        warnings(&server.upload("/warp", &landscape, &swapped).await).contains(&OUTSIDE),
        "swapped, and inside if x and y are exchanged"
    );
    for (name, warp, expected) in cases {
        let relevant = |response: &reqwest::Response| -> Vec<String> {
            let codes = warnings(response);
            let expected = [OUTSIDE, NORMALIZED, NOTHING]
                .into_iter()
                .filter(|code| codes.contains(code));
            expected.map(str::to_owned).collect()
        };
        let response = server.upload("/warp", &image, warp).await;
        assert_eq!(relevant(&response), *expected, "{name}");
        png(response).await;
        if warp["p"].is_null() {
            continue;
        }
        let id = server.session(&image, warp).await;
        for path in ["warp", "mesh"] {
            let response = server
                .post(&format!("/sessions/{id}/{path}"))
                .json(&json!({"q": warp["q"]}))
                .send()
                .await
                .unwrap();
            assert_eq!(relevant(&response), *expected, "{name} {path}");
        }
        let mut drag = DragClient::open(server.address, &id, "?report=true").await;
        drag.pose(1, &warp["q"]).await;
        let report = drag.text().await;
        let told: Vec<&str> = report["warnings"]
            .as_array()
            .unwrap()
            .iter()
            .filter_map(Value::as_str)
            .collect();
        for code in [OUTSIDE, NORMALIZED, NOTHING] {
            assert_eq!(
                told.contains(&code),
                expected.contains(&code),
                "{name}: {report}"
            );
        }
    }
}

#[tokio::test]
async fn mistakes_with_curl_are_recognised_by_the_parts() {
    let server = Server::start(&[]).await;
    let image = photo(16, 12);
    // `curl -F image=@photo.png -F warp=warp.json`, and the same for the image.
    let paths = [
        "warp.json",
        "./examples/warp.json",
        "/home/ann/my warp.json",
        "@warp.json",
    ];
    for path in paths {
        let hint = format!(
            "the part `warp` is the text `{path}`, which looks like a path; curl sends a file \
                with `-F warp=@path`"
        );
        told(
            server.post("/warp").multipart(form(&image, path)),
            400,
            "malformed_request",
            None,
            &[&hint],
        )
        .await;
    }
    for path in [
        "photo.jpg",
        "~/Pictures/photo.png",
        "section.tsv",
        "slide.tif",
        "C:\\Users\\ann\\photo.jpg",
    ] {
        let parts = Form::new().text("image", path).text("warp", "{}");
        let hint = format!(
            "the part `image` is the text `{path}`, which looks like a path; curl sends a file \
                with `-F image=@path`"
        );
        told(
            server.post("/sessions").multipart(parts),
            415,
            "unsupported_format",
            None,
            &[&hint],
        )
        .await;
    }
    for (image, warp, status, code, part) in [
        (
            photo(16, 12),
            "https://example.com/warp.json",
            400,
            "malformed_request",
            "warp",
        ),
        (
            b"http://example.com/photo.png".to_vec(),
            "{}",
            415,
            "unsupported_format",
            "image",
        ),
    ] {
        let hint = format!("the part `{part}` is the text `http");
        let words = [
            hint.as_str(),
            "the server fetches no URLs: send the file itself",
        ];
        told(
            server.post("/warp").multipart(form(&image, warp)),
            status,
            code,
            None,
            &words,
        )
        .await;
    }
    for text in ["[[1,2],3.5", "0.5,0.5", "p=1.5", "See example.com"] {
        let document = told(
            server.post("/warp").multipart(form(&image, text)),
            400,
            "malformed_request",
            None,
            &["not JSON"],
        )
        .await;
        assert!(
            !document["detail"].as_str().unwrap().contains("path"),
            "{document}"
        );
    }
    // The parts exchanged, and a content type that the client wrote itself.
    let exchanged = Form::new().text("image", "{}").part("warp", part(&image));
    let words = ["the part `warp`: not JSON: this is an image"];
    told(
        server.post("/warp").multipart(exchanged),
        400,
        "malformed_request",
        None,
        &words,
    )
    .await;
    let request = server
        .post("/warp")
        .header("content-type", "multipart/form-data")
        .body("--x--");
    told(
        request,
        400,
        "malformed_request",
        None,
        &["do not set `Content-Type` yourself; the client library adds the boundary"],
    )
    .await;
    let request = server
        .post("/warp")
        .header("content-type", "image/png")
        .body(image.clone());
    let words = [
        "POST /warp expects multipart/form-data",
        "found `image/png`",
        "to warp the picture of a session",
    ];
    told(request, 415, "unsupported_media_type", None, &words).await;
    let document = told(
        server.post("/sessions").json(&json!({})),
        415,
        "unsupported_media_type",
        None,
        &["found `application/json`"],
    )
    .await;
    assert!(
        !document["detail"]
            .as_str()
            .unwrap()
            .contains("of a session"),
        "{document}"
    );
    let region = Form::new()
        .text("image", "x")
        .text("region", "mask.png")
        .text("warp", "{}");
    told(
        server.post("/warp").multipart(region),
        415,
        "unsupported_format",
        None,
        &["-F region=@path"],
    )
    .await;
    told(
        server.post("/warp").multipart(form(&image, "not JSON")),
        400,
        "malformed_request",
        None,
        &["the part `warp`: not JSON"],
    )
    .await;
    let misnamed = Form::new().text("images", "x").text("warp", "{}");
    told(
        server.post("/warp").multipart(misnamed),
        400,
        "malformed_request",
        None,
        &["`images`; did you mean `image`?"],
    )
    .await;
}

#[tokio::test]
async fn mistakes_in_the_method_and_the_path_name_the_route() {
    let server = Server::start(&[]).await;
    let put = |path: &str| server.client.put(server.url(path));
    told(
        put("/warp"),
        405,
        "method_not_allowed",
        None,
        &["PUT is not supported at `/warp`; use POST"],
    )
    .await;
    told(
        server.get("/warp"),
        405,
        "method_not_allowed",
        None,
        &["GET is not supported at `/warp`; use POST"],
    )
    .await;
    told(
        server.post("/healthz"),
        405,
        "method_not_allowed",
        None,
        &["POST is not supported at `/healthz`; use GET"],
    )
    .await;
    let id = "/sessions/0f8fad5b-d9cb-469f-a165-70867728950e";
    let words = [
        "POST is not supported at `/sessions/",
        "; use GET, PUT or DELETE",
    ];
    let document = told(server.post(id), 405, "method_not_allowed", None, &words).await;
    for route in [
        "POST /sessions/{id}/warp",
        "POST /sessions/{id}/points",
        "POST /sessions/{id}/batch",
    ] {
        assert!(
            document["detail"].as_str().unwrap().contains(route),
            "{document}"
        );
    }
    let words =
        ["GET is not supported at `/sessions`; use POST. Below it are GET /sessions/{id}, "];
    told(
        server.get("/sessions"),
        405,
        "method_not_allowed",
        None,
        &words,
    )
    .await;
    let words = ["GET is not supported at `/sessions/", "/handles`; use PUT"];
    told(
        server.get(&format!("{id}/handles")),
        405,
        "method_not_allowed",
        None,
        &words,
    )
    .await;
    let words = ["below it are GET, PUT, DELETE /sessions/{id}/layers/{name}. See /docs"];
    told(
        server.get(&format!("{id}/layers")),
        404,
        "not_found",
        None,
        &words,
    )
    .await;
    told(
        server.get("/problems"),
        404,
        "not_found",
        None,
        &["below it are GET /problems/{code}. See /docs"],
    )
    .await;
    // A script whose variable is empty.
    let words = [
        "the id of the session is empty in the path, as if a variable of a script were empty; \
            POST /sessions opens a session",
    ];
    told(
        server.post("/sessions//warp"),
        404,
        "no_such_session",
        None,
        &words,
    )
    .await;
    told(
        server.post("/sessions//nothing"),
        404,
        "not_found",
        None,
        &["the path has an empty segment, as if a variable of a script were empty. See /docs"],
    )
    .await;
    told(
        server.post("/page/main.js"),
        405,
        "method_not_allowed",
        None,
        &["; use GET"],
    )
    .await;
    let drag = format!("{id}/drag");
    told(
        server.post(&drag),
        405,
        "method_not_allowed",
        None,
        &["POST is not supported at", "; use GET"],
    )
    .await;
    for path in ["/v1/warp", "/warp/", "/api/warp", "/api/v2/warp/", "/wrap"] {
        let words = format!("nothing is served at `{path}`; did you mean POST /warp? See /docs");
        told(server.post(path), 404, "not_found", None, &[&words]).await;
    }
    told(
        server.post("/session"),
        404,
        "not_found",
        None,
        &["did you mean POST /sessions?"],
    )
    .await;
    told(
        server.get("/health"),
        404,
        "not_found",
        None,
        &["did you mean GET /healthz?"],
    )
    .await;
    let document = told(
        server.get("/version"),
        404,
        "not_found",
        None,
        &["nothing is served at `/version`; see /docs"],
    )
    .await;
    assert!(
        !document["detail"]
            .as_str()
            .unwrap()
            .contains("did you mean"),
        "{document}"
    );
    told(
        server.get("/nothing-like-it"),
        404,
        "not_found",
        None,
        &["nothing is served at `/nothing-like-it`; see /docs"],
    )
    .await;
    told(
        server.get(&"/long".repeat(2000)),
        404,
        "not_found",
        None,
        &["...`; see /docs"],
    )
    .await;
    told(
        server.get("/problems/superseeded"),
        404,
        "not_found",
        None,
        &["`superseeded`; did you mean `superseded`?"],
    )
    .await;
}

#[tokio::test]
async fn mistakes_in_the_format_of_the_image_name_it() {
    let server = Server::start(&[]).await;
    let padded = |head: &[u8]| [head, &[0; 64]].concat();
    for (file, name) in [
        (padded(b"\0\0\0\x18ftypheic"), "HEIC"),
        (padded(b"\0\0\0\x20ftypavif"), "AVIF"),
        (padded(b"8BPS\0\x01"), "Photoshop (PSD)"),
        (
            b"<?xml version=\"1.0\"?><svg xmlns=\"http://www.w3.org/2000/svg\"/>".to_vec(),
            "SVG",
        ),
        (padded(b"%PDF-1.7\n"), "PDF"),
        (
            b"data:image/png;base64,iVBORw0KGgo=".to_vec(),
            "a data URL; send the bytes of the file",
        ),
        (
            b"iVBORw0KGgoAAAANSUhEUgAAABAAAAAMCAIAAADkharW".to_vec(),
            "base64; send the bytes of the file",
        ),
        (Vec::new(), "an empty file"),
    ] {
        let words = format!("unsupported image format: {name}");
        let document = told(
            server.post("/warp").multipart(form(&file, "{}")),
            415,
            "unsupported_format",
            None,
            &[&words],
        )
        .await;
        assert!(
            document["detail"]
                .as_str()
                .unwrap()
                .ends_with("supported: PNG, JPEG, WebP, TIFF, GIF, BMP"),
            "{document}"
        );
    }
    let animation = bombs::png(&[
        (b"IHDR", bombs::ihdr(16, 12)),
        (b"acTL", vec![0, 0, 0, 3, 0, 0, 0, 0]),
        (b"IDAT", bombs::deflated_zeros(600)),
    ]);
    let words = ["the file has 3 frames or pages; the limit is 1"];
    told(
        server.post("/warp").multipart(form(&animation, "{}")),
        413,
        "too_large",
        None,
        &words,
    )
    .await;
}

#[tokio::test]
async fn mistakes_of_writing_json_and_of_accept_are_named() {
    let server = Server::start(&[]).await;
    let image = photo(16, 12);
    for (warp, words) in [
        (&b"{'p': []}"[..], "; names and strings have double quotes"),
        (b"{\"p\": [[1, 2],]}", "; remove the comma before it"),
        (b"{\"alpha\": NaN}", "; JSON has neither NaN nor infinity"),
        (b"", "not JSON: the text is empty"),
        (b"\xef\xbb\xbf{}", "byte order mark (BOM)"),
        (b"\xff\xfe{\0}\0", "the text is UTF-16; send UTF-8"),
        (b"\x1f\x8b\x08\0", "compressed with gzip"),
    ] {
        let parts = Form::new()
            .part("image", part(&image))
            .part("warp", part(warp));
        told(
            server.post("/warp").multipart(parts),
            400,
            "malformed_request",
            None,
            &["the part `warp`: not JSON", words],
        )
        .await;
        let body = server
            .post("/points")
            .header("content-type", "application/json")
            .body(warp.to_vec());
        told(body, 400, "malformed_request", None, &[words]).await;
    }
    let upload = server
        .post("/warp")
        .multipart(form(&image, r#"{"output": {"format": "png"}}"#))
        .header("accept", "image/jpeg");
    told(
        upload,
        406,
        "not_acceptable",
        None,
        &["`output.format` is png, but `Accept` excludes image/png"],
    )
    .await;
}

#[tokio::test]
async fn mistakes_with_sessions_say_how_to_open_one() {
    let server = Server::start(&["--session-idle", "1s"]).await;
    let image = photo(16, 12);
    let (kept, deleted) = (
        server.session(&image, &json!({"p": [[2, 2]]})).await,
        server.session(&image, &json!({"p": [[2, 2]]})).await,
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
    let warp = |id: &str| {
        server
            .post(&format!("/sessions/{id}/warp"))
            .json(&json!({"q": [[3, 2]]}))
    };
    let unknown = "0f8fad5b-d9cb-469f-a165-70867728950e";
    for id in [deleted.as_str(), unknown] {
        told(
            warp(id),
            404,
            "no_such_session",
            None,
            &[
                "there is no such session",
                "deleted",
                "open a new one with POST /sessions",
            ],
        )
        .await;
    }
    tokio::time::sleep(std::time::Duration::from_millis(1200)).await;
    let words =
        ["the session has expired: it was idle for 1 s; open a new one with POST /sessions"];
    told(warp(&kept), 410, "session_expired", None, &words).await;
    for id in [
        "abc",
        "$SESSION",
        "null",
        "0f8fad5bd9cb469fa16570867728950e",
    ] {
        let words = [
            "is not a session id: a session id is a hyphenated UUID of version 4, \
             such as 0f8fad5b-",
            "POST /sessions",
        ];
        told(warp(id), 404, "no_such_session", None, &words).await;
    }
    let put = server
        .client
        .put(server.url("/sessions/my-session"))
        .multipart(form(&image, "{}"));
    told(
        put,
        422,
        "bad_value",
        None,
        &["`my-session` is not a session id: a session id is a hyphenated UUID"],
    )
    .await;
}

#[tokio::test]
async fn mistakes_in_the_query_are_named() {
    let server = Server::start(&[]).await;
    let image = photo(16, 12);
    let upload = |query: &str| {
        server
            .post(&format!("/warp?{query}"))
            .multipart(form(&image, "{}"))
    };
    let words =
        ["unknown field in the query: `sesion`; did you mean `session`? Known fields: `session`"];
    told(upload("sesion=true"), 422, "unknown_field", None, &words).await;
    told(
        upload("width=100"),
        422,
        "unknown_field",
        None,
        &["unknown field in the query: `width`; known fields: `session`"],
    )
    .await;
    let words = ["the field `session` is given twice in the query"];
    told(
        upload("session=true&session=false"),
        400,
        "malformed_request",
        None,
        &words,
    )
    .await;
    told(
        upload("session=yes"),
        422,
        "bad_value",
        None,
        &["`session` in the query must be `true` or `false`; found `yes`"],
    )
    .await;
    let id = server.session(&image, &json!({"p": [[2, 2]]})).await;
    let words = ["unknown field in the query: `width`; this route has none"];
    for path in ["warp", "mesh", "points"] {
        let request = server
            .post(&format!("/sessions/{id}/{path}?width=9"))
            .json(&json!({"q": [[2, 2]]}));
        told(request, 422, "unknown_field", None, &words).await;
    }
    told(
        server.post("/points?width=9").json(&json!({})),
        422,
        "unknown_field",
        None,
        &words,
    )
    .await;
    told(
        server
            .post("/sessions?width=9")
            .multipart(form(&image, "{}")),
        422,
        "unknown_field",
        None,
        &words,
    )
    .await;
    let put = |path: String| server.client.put(server.url(&path));
    told(
        put(format!("/sessions/{id}?width=9")).multipart(form(&image, "{}")),
        422,
        "unknown_field",
        None,
        &words,
    )
    .await;
    told(
        put(format!("/sessions/{id}/handles?width=9")).json(&json!({"p": []})),
        422,
        "unknown_field",
        None,
        &words,
    )
    .await;
    let socket = |query: &str| {
        let request = server
            .get(&format!("/sessions/{id}/drag?{query}"))
            .header("connection", "upgrade")
            .header("upgrade", "websocket");
        request
            .header("sec-websocket-version", "13")
            .header("sec-websocket-key", "AAAAAAAAAAAAAAAAAAAAAA==")
    };
    let words = ["unknown field in the query: `frame`; did you mean `frames`?"];
    told(socket("frame=png"), 422, "unknown_field", None, &words).await;
    told(
        socket("frames=jpg"),
        422,
        "bad_value",
        None,
        &[
            "`frames` in the query must be one of `auto`, `png`",
            "found `jpg`",
        ],
    )
    .await;
    told(
        socket("width=9&width=9"),
        400,
        "malformed_request",
        None,
        &["the field `width` is given twice in the query"],
    )
    .await;
    for window in ["0", "9", "-1", "1.5", "all"] {
        let words = [
            "`window` in the query must be `auto` or a whole number of 1 to 8",
            window,
        ];
        told(
            socket(&format!("window={window}")),
            422,
            "bad_value",
            None,
            &words,
        )
        .await;
    }
    told(
        socket("width=0"),
        422,
        "bad_value",
        None,
        &[
            "`width` in the query must be `auto` or a whole number",
            "found `0`",
        ],
    )
    .await;
}

#[tokio::test]
async fn mistakes_in_seq_give_the_highest_value() {
    let server = Server::start(&[]).await;
    let id = server
        .session(&photo(16, 12), &json!({"p": [[2, 2]]}))
        .await;
    let pose = |seq: u32| {
        server
            .post(&format!("/sessions/{id}/warp"))
            .json(&json!({"q": [[3, 2]], "seq": seq}))
    };
    png(pose(42).send().await.unwrap()).await;
    let words = ["seq 41 is lower than 42, the highest that this session has seen"];
    let document = told(pose(41), 409, "superseded", Some("/seq"), &words).await;
    assert_eq!(
        (&document["actual"], &document["newest"]),
        (&json!(41), &json!(42))
    );
    let mut drag = DragClient::open(server.address, &id, "").await;
    drag.pose(50, &json!([[3, 2]])).await;
    drag.ack_of_next_frame(50).await;
    drag.pose(7, &json!([[4, 2]])).await;
    let document = loop {
        // The full frame of the first pose may come before.
        if let Received::Text(document) = drag.next().await {
            break document;
        }
    };
    assert_eq!(
        (&document["code"], &document["pointer"], &document["seq"]),
        (&json!("bad_value"), &json!("/seq"), &json!(7))
    );
    assert_eq!(
        document["detail"],
        "each pose needs a higher `seq` than the one before: 7 follows 50"
    );
}

#[tokio::test]
async fn mistakes_in_authorization_name_the_scheme() {
    const KEY: &str = "0123456789abcdef";
    let server = Server::start(&["--keys", "ann 0123456789abcdef"]).await;
    let with = |value: &str| server.get("/sessions/x").header("authorization", value);
    for value in [
        KEY.to_owned(),
        format!("Basic {KEY}"),
        format!("Token {KEY}"),
    ] {
        let words =
            ["the scheme of `Authorization` must be `Bearer`: send `Authorization: Bearer <key>`"];
        let document = told(with(&value), 401, "unauthorized", None, &words).await;
        assert!(
            !document.to_string().contains(KEY),
            "a key is never repeated"
        );
    }
    for value in [format!("Bearer \"{KEY}\""), format!("Bearer <{KEY}>")] {
        let words = ["invalid API key; send the key without quotes or brackets"];
        let document = told(with(&value), 403, "forbidden", None, &words).await;
        assert!(
            !document.to_string().contains(KEY),
            "a key is never repeated"
        );
    }
    let accented = server
        .get("/sessions/x")
        .header("authorization", "Bearer cl\u{e9}0123456789".as_bytes());
    told(
        accented,
        401,
        "unauthorized",
        None,
        &["the key in `Authorization` has characters outside ASCII"],
    )
    .await;
    let twice = with(&format!("Bearer {KEY}")).header("authorization", "Bearer other");
    told(
        twice,
        401,
        "unauthorized",
        None,
        &["`Authorization` must be given once"],
    )
    .await;
    told(
        server.get("/sessions/x"),
        401,
        "unauthorized",
        None,
        &["API key required: send `Authorization: Bearer <key>`"],
    )
    .await;
    let response = with(KEY).send().await.unwrap();
    assert_eq!(header(&response, "www-authenticate"), "Bearer");
}

#[tokio::test]
async fn mistakes_in_handles_that_meet_are_all_reported() {
    let server = Server::start(&[]).await;
    let image = photo(400, 300);
    let warp = |p: Value, q: Value| {
        server.post("/warp").multipart(form(
            &image,
            json!({"p": p, "q": q, "coincident": {"policy": "reject"}}).to_string(),
        ))
    };
    // A polyline that visits a point twice.
    let (p, q) = (
        json!([[[235, 158], [300, 158], [300, 200], [235, 158], [200, 100]]]),
        json!([[[235, 158], [300, 158], [300, 200], [239, 158], [200, 100]]]),
    );
    let words = ["handle 0 visits (235, 158) twice, with targets 4 px apart"];
    let document = told(
        warp(p, q),
        422,
        "contradictory_handles",
        Some("/q/0"),
        &words,
    )
    .await;
    assert_eq!(document["detail"], words[0]);
    let [group] = document["coincident"].as_array().unwrap().as_slice() else {
        panic!("{document}")
    };
    assert_eq!(
        (&group["handles"], &group["position"]),
        (&json!([0]), &json!([235.0, 158.0]))
    );
    assert!(
        (group["spread"].as_f64().unwrap() - 2.0).abs() < 1e-6,
        "{document}"
    );
    // Points: one pair that agrees, and two groups that do not.
    let p = json!([
        [10, 10],
        [10, 10],
        [50, 60],
        [50, 60],
        [50, 60],
        [300, 200],
        [300, 200],
        [20, 250]
    ]);
    let q = json!([
        [12, 10],
        [12, 10],
        [50, 60],
        [53, 64],
        [50, 60],
        [301, 200],
        [307, 208],
        [20, 250]
    ]);
    let words = [
        "handles 2, 3, 4 meet at rest at (50, 60) but their targets there are up to 3.33 px from \
            their mean",
        "handles 5 and 6 meet at rest at (300, 200) but their targets there are 10 px apart",
    ];
    let document = told(
        warp(p, q),
        422,
        "contradictory_handles",
        Some("/q/2"),
        &words,
    )
    .await;
    assert_eq!(
        (
            &document["handle"],
            document["coincident"].as_array().unwrap().len()
        ),
        (&json!(2), 2)
    );
    assert_eq!(
        document["coincident"][1],
        json!({"handles": [5, 6], "position": [300.0, 200.0], "spread": 5.0})
    );
    assert_eq!(document["coincident"][0]["handles"], json!([2, 3, 4]));
    // Many: the report is bounded, and says how many there are.
    let p: Vec<[u32; 2]> = (0..2000)
        .map(|k| [k / 2 % 40 * 10, k / 2 / 40 * 10])
        .collect();
    let q: Vec<[u32; 2]> = p
        .iter()
        .enumerate()
        .map(|(k, [x, y])| [x + k as u32 % 2 * 3, *y])
        .collect();
    let document = told(
        warp(json!(p), json!(q)),
        422,
        "contradictory_handles",
        Some("/q/0"),
        &["; and 997 more"],
    )
    .await;
    assert_eq!(document["coincident"].as_array().unwrap().len(), 100);
    // Lines that cross.
    let (p, q) = (
        json!([[[0, 0], [100, 100]], [[0, 100], [100, 0]]]),
        json!([[[0, 0], [100, 100]], [[0, 106], [100, 6]]]),
    );
    let words = ["handles 0 and 1 meet at rest at (50, 50) but their targets there are 6 px apart"];
    told(
        warp(p, q),
        422,
        "contradictory_handles",
        Some("/q/0"),
        &words,
    )
    .await;
}

#[tokio::test]
async fn mistakes_of_any_length_and_content_have_short_answers() {
    let server = Server::start(&[]).await;
    let image = photo(16, 12);
    let long = "\u{e9}\u{202e}\n".repeat(20_000);
    for warp in [
        json!({ long.as_str(): 1 }),
        json!({ "method": long }),
        json!({"output": {"outside": long}}),
        json!({"output": { long.as_str(): 1 }}),
        json!({"\u{1b}[31mmethod\u{7}": "rigid"}),
        json!({"method": "\u{1b}]0;title\u{7}"}),
    ] {
        let response = server
            .post("/warp")
            .multipart(form(&image, warp.to_string()))
            .send()
            .await
            .unwrap();
        let document = problem(
            response,
            422,
            if warp["method"].is_null() && warp["output"]["outside"].is_null() {
                "unknown_field"
            } else {
                "bad_value"
            },
        )
        .await;
        let detail = document["detail"].as_str().unwrap();
        assert!(
            detail.chars().count() < 1500
                && !detail.contains(|c: char| c.is_control() || c == '\u{202e}'),
            "{document}"
        );
    }
    let method = reqwest::Method::from_bytes(&[b'X'; 5000]).unwrap();
    let request = server.client.request(method, server.url("/warp"));
    told(
        request,
        405,
        "method_not_allowed",
        None,
        &["this method is not supported at `/warp`; use POST"],
    )
    .await;
    server.is_well().await;
}
