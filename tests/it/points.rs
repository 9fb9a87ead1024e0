//! Annotations: points, polygons, boxes and GeoJSON, mapped by f and by its inverse. A picture
//! whose colours are its own coordinates shows which position of the source is drawn at each pixel.

use mlswarp::geometry::Point;
use mlswarp_server::limits::memory::MemoryClass;
use serde_json::{Value, json};

use crate::support::picture::{decoded, png_of};
use crate::support::server::{form, png, problem};
use crate::support::{Server, eventually, photo};

const SIDE: (u32, u32) = (160, 120);

/// A 16-bit picture: red grows along x, green along y, by 256 a pixel.
pub(crate) fn coordinates() -> Vec<u8> {
    let sample = |at: u32| u16::try_from(256 * at + 128).unwrap().to_be_bytes();
    let pixel = |x, y| [sample(x), sample(y), [0, 0]].concat();
    let samples: Vec<u8> = (0..SIDE.1)
        .flat_map(|y| (0..SIDE.0).flat_map(move |x| pixel(x, y)))
        .collect();
    png_of(
        SIDE.0,
        SIDE.1,
        png::ColorType::Rgb,
        png::BitDepth::Sixteen,
        &samples,
    )
}

/// Numbers in 0..1 that depend on a seed.
pub(crate) struct Noise(pub(crate) u64);

impl Noise {
    pub(crate) fn next(&mut self) -> f64 {
        self.0 = self
            .0
            .wrapping_mul(6_364_136_223_846_793_005)
            .wrapping_add(1_442_695_040_888_963_407);
        (self.0 >> 33) as f64 / f64::from(1_u32 << 31)
    }

    fn place(&mut self) -> [f64; 2] {
        [8.0 + 144.0 * self.next(), 8.0 + 104.0 * self.next()]
    }
}

/// A warp of a few points, and of a line in every third, all of which move little enough for most
/// results to have no folds.
pub(crate) fn warp(seed: u64, tolerance: Option<f64>) -> Value {
    let mut noise = Noise(seed * 977 + 13);
    for _ in 0..4 {
        noise.next();
    }
    let (mut p, mut q) = (Vec::new(), Vec::new());
    for _ in 0..4 + seed % 5 {
        let [x, y] = noise.place();
        p.push(json!([x, y]));
        q.push(json!([
            x + 8.0 * noise.next() - 4.0,
            y + 8.0 * noise.next() - 4.0
        ]));
    }
    if seed.is_multiple_of(3) {
        let ([x, y], [u, v]) = (noise.place(), noise.place());
        let mut moved = |at: f64| at + 6.0 * noise.next() - 3.0;
        q.push(json!([[moved(x), moved(y)], [moved(u), moved(v)]]));
        p.push(json!([[x, y], [u, v]]));
    }
    let method = ["rigid", "similarity", "affine"][(seed % 3) as usize];
    let mut warp = json!({"p": p, "q": q, "method": method, "alpha": 1.0 + noise.next()});
    if let Some(tolerance) = tolerance {
        warp["grid"] = json!({"tolerance": tolerance});
    }
    warp
}

pub(crate) fn with(warp: &Value, more: Value) -> Value {
    let mut object = warp.as_object().unwrap().clone();
    object.extend(more.as_object().unwrap().clone());
    object.into()
}

async fn mapped(server: &Server, object: &Value) -> Value {
    let response = server.post("/points").json(object).send().await.unwrap();
    let (status, text) = (response.status(), response.text().await.unwrap());
    assert_eq!(status, 200, "{text}");
    serde_json::from_str(&text).unwrap()
}

fn point(value: &Value) -> Option<Point> {
    let numbers = value.as_array()?;
    Some(Point::new(
        numbers[0].as_f64().unwrap(),
        numbers[1].as_f64().unwrap(),
    ))
}

pub(crate) fn places(value: &Value) -> Vec<Option<Point>> {
    value.as_array().unwrap().iter().map(point).collect()
}

/// What is drawn at a pixel lies where its own position is mapped, and the inverse of the pixel's
/// centre is what is drawn there.
#[tokio::test]
async fn what_is_drawn_is_where_points_are_mapped_forwards_and_back() {
    let server = Server::start(&[]).await;
    let image = coordinates();
    let (mut compared, mut without_folds) = (0, 0);
    for seed in 0..200_u64 {
        let (tolerance, bound) = if seed.is_multiple_of(4) {
            (Some(0.05), 0.1)
        } else {
            (None, 0.3)
        };
        let warp = warp(seed, tolerance);
        let response = server
            .post("/warp")
            .multipart(form(&image, warp.to_string()))
            .send()
            .await
            .unwrap();
        assert_eq!(response.status(), 200);
        let header = |name: &str| {
            response
                .headers()
                .get(name)
                .map(|value| value.to_str().unwrap().to_owned())
        };
        let is_exempt =
            header("warp-warning").is_some_and(|text| text.contains("tolerance_exceeded"));
        let folds = header("warp-folds").unwrap() != "0";
        let picture = decoded(&png(response).await);
        let wide = 2 * if picture.color == png::ColorType::Rgba {
            4
        } else {
            3
        };
        let mut noise = Noise(seed);
        let mut shown = Vec::new();
        for _ in 0..60 {
            let (x, y) = (
                (noise.next() * 160.0) as usize,
                (noise.next() * 120.0) as usize,
            );
            let sample = |c: usize| {
                let at = wide * (y * 160 + x) + 2 * c;
                f64::from(u16::from_be_bytes([
                    picture.samples[at],
                    picture.samples[at + 1],
                ]))
            };
            let source = [sample(0) / 256.0, sample(1) / 256.0];
            let is_opaque = wide == 6 || sample(3) == 65535.0;
            // The outer half pixel of a picture has one colour.
            let inside = |at: f64, side: f64| at > 1.0 && at < side - 1.0;
            if is_opaque && inside(source[0], 160.0) && inside(source[1], 120.0) {
                shown.push((json!(source), json!([x as f64 + 0.5, y as f64 + 0.5])));
            }
        }
        let (sources, targets): (Vec<Value>, Vec<Value>) = shown.into_iter().unzip();
        let extent = json!([160, 120]);
        let there = mapped(
            &server,
            &with(&warp, json!({"extent": extent, "points": sources})),
        )
        .await;
        let back = mapped(
            &server,
            &with(
                &warp,
                json!({"extent": extent, "points": targets, "inverse": true}),
            ),
        )
        .await;
        for ((source, target), (there, back)) in sources.iter().zip(&targets).zip(
            places(&there["points"])
                .into_iter()
                .zip(places(&back["points"])),
        ) {
            let (source, target, there) = (
                point(source).unwrap(),
                point(target).unwrap(),
                there.unwrap(),
            );
            let back = back.unwrap_or_else(|| panic!("{seed}: {target:?} shows {source:?}"));
            if !is_exempt && !folds {
                assert!(
                    there.distance(target) <= bound,
                    "{seed}: {source:?} is drawn at {target:?}, and mapped to {there:?}"
                );
                // Handles move a little, so lengths change by less than a factor of two.
                assert!(
                    back.distance(source) <= 2.0 * bound,
                    "{seed}: {target:?} shows {source:?}; its inverse is {back:?}"
                );
                compared += 1;
            }
        }
        if folds {
            continue;
        }
        without_folds += 1;
        let rest: Vec<[f64; 2]> = (0..50).map(|_| noise.place()).collect();
        let there = mapped(
            &server,
            &with(&warp, json!({"extent": extent, "points": rest})),
        )
        .await;
        let again = mapped(
            &server,
            &with(
                &warp,
                json!({"extent": extent, "points": there["points"], "inverse": true}),
            ),
        )
        .await;
        for (rest, again) in rest.iter().zip(places(&again["points"])) {
            let again = again.unwrap_or_else(|| panic!("{seed}: {rest:?}"));
            assert!(
                again.distance(Point::new(rest[0], rest[1])) <= 1e-6,
                "{seed}: {rest:?} returns as {again:?}"
            );
        }
    }
    assert!(
        compared > 5000 && without_folds > 150,
        "{compared} {without_folds}"
    );
}

#[tokio::test]
async fn every_kind_is_returned_under_its_name_in_the_order_of_the_request() {
    let server = Server::start(&[]).await;
    // One handle: a shift.
    let warp = r#""p": [[10, 10]], "q": [[15, 12]], "extent": [160, 120]"#;
    let point_at_rest = r#"{"type":"Point","coordinates":[1,2]}"#;
    let body = format!(
        r#"{{"boxes": [[1, 2, 3, 4]], {warp}, "geojson": {{ "type": "FeatureCollection", "name": "A", "bbox": [0, 0, 9, 9], "features": [
  {{"type":"Feature","id":9007199254740993,"bbox":[0,0,1,1],"geometry":{point_at_rest},"properties":{{"z":1.50,"a":null}}}},
  {{"type": "Feature", "geometry": null, "properties": {{}}}},
  {{"type": "Feature", "geometry": {{"type": "GeometryCollection", "geometries": [
    {{"type": "MultiPoint", "bbox": [1, 1, 2, 2], "coordinates": [[1, 1], [2, 2]]}},
    {{"type": "Polygon", "coordinates": [[[0, 0], [4, 0], [0, 4], [0, 0]]]}}]}}, "properties": {{}}}}
] }}, "polygons": [[[0, 0], [4, 0], [0, 4]]], "points": [[7, 8]]}}"#
    );
    let response = server
        .post("/points")
        .header("content-type", "application/json")
        .body(body)
        .send()
        .await
        .unwrap();
    let text = response.text().await.unwrap();
    let point = r#"{"type":"Point","coordinates":[6.0,4.0]}"#;
    let points = r#"{"type": "MultiPoint", "bbox": [6.0,3.0,7.0,4.0], "coordinates": [[6.0,3.0],[7.0,4.0]]}"#;
    let polygon =
        r#"{"type": "Polygon", "coordinates": [[[5.0,2.0],[9.0,2.0],[5.0,6.0],[5.0,2.0]]]}"#;
    let expected = format!(
        r#"{{"boxes":[[6.0,4.0,8.0,6.0]],"geojson":{{ "type": "FeatureCollection", "name": "A", "features": [
  {{"type":"Feature","id":9007199254740993,"bbox":[6.0,4.0,6.0,4.0],"geometry":{point},"properties":{{"z":1.50,"a":null}}}},
  {{"type": "Feature", "geometry": null, "properties": {{}}}},
  {{"type": "Feature", "geometry": {{"type": "GeometryCollection", "geometries": [
    {points},
    {polygon}]}}, "properties": {{}}}}
] ,"bbox":[5.0,2.0,9.0,6.0]}},"polygons":[[[5.0,2.0],[9.0,2.0],[5.0,6.0]]],"points":[[12.0,10.0]]}}"#
    );
    assert_eq!(text, expected);
}

/// Empty lists take many times their text: memory is reserved before they are read.
#[tokio::test]
async fn memory_for_reading_is_reserved() {
    let server = Server::start(&["--memory-bytes", "64MiB"]).await;
    let lists = format!("[{}]", vec!["[]"; 1 << 20].join(","));
    let body = format!(
        r#"{{"extent": [9, 9], "geojson": {{"type": "FeatureCollection", "features": [
            {{"type": "Feature", "geometry": {{"type": "MultiLineString", "coordinates": {lists}}}, "properties": null}}]}}}}"#
    );
    let id = server.session(&photo(16, 12), &json!({})).await;
    let before = server.app.budget().taken_for(MemoryClass::Upload);
    for path in ["/points", &format!("/sessions/{id}/points")] {
        let body = if path == "/points" {
            body.clone()
        } else {
            body.replace(r#""extent": [9, 9]"#, r#""q": []"#)
        };
        let response = server
            .post(path)
            .header("content-type", "application/json")
            .body(body)
            .send()
            .await
            .unwrap();
        let refused = problem(response, 413, "too_large").await;
        assert!(refused["actual"].as_u64() > Some(140 << 20), "{refused}");
    }
    eventually("the memory is given back", || {
        server.app.budget().taken_for(MemoryClass::Upload) == before
    })
    .await;
    server.is_well().await;
}

#[tokio::test]
async fn outlines_are_refined_and_what_has_no_source_is_null() {
    let server = Server::start(&[]).await;
    let warp = json!({"p": [[40, 60], [120, 60], [80, 20]], "q": [[40, 60], [120, 60], [80, 35]],
        "extent": [160, 120]});
    let ring = json!([[20, 20], [140, 20], [140, 100], [20, 100]]);
    let line = json!({"type": "LineString", "coordinates": [[20, 20], [140, 20]]});
    let collection = json!({"type": "FeatureCollection",
        "features": [{"type": "Feature", "geometry": line, "properties": {}}]});
    let send = |more: Value| {
        let request = with(
            &warp,
            json!({"polygons": [ring], "boxes": [[20, 20, 140, 100]], "geojson": collection}),
        );
        let (server, request) = (&server, with(&request, more));
        async move { mapped(server, &request).await }
    };
    let (refined, bare) = (send(json!({})).await, send(json!({"refine": false})).await);
    let (outline, corners) = (
        places(&refined["polygons"][0]),
        places(&bare["polygons"][0]),
    );
    assert!(
        outline.len() > 12
            && corners.len() == 4
            && corners.iter().all(|corner| outline.contains(corner)),
        "{}",
        outline.len()
    );
    let line = places(&refined["geojson"]["features"][0]["geometry"]["coordinates"]);
    assert!(
        line.len() > 5 && line[..] == outline[..line.len()],
        "{line:?}"
    );
    // The bounding box is that of the outline, which is bent beyond its corners.
    let sides: Vec<f64> = refined["boxes"][0]
        .as_array()
        .unwrap()
        .iter()
        .map(|side| side.as_f64().unwrap())
        .collect();
    let all: Vec<Point> = outline.into_iter().flatten().collect();
    let least = |of: fn(&Point) -> f64| all.iter().map(of).fold(f64::INFINITY, f64::min);
    let found = [
        least(|p| p.x),
        least(|p| p.y),
        -least(|p| -p.x),
        -least(|p| -p.y),
    ];
    assert!(
        sides
            .iter()
            .zip(found)
            .all(|(side, found)| (side - found).abs() < 0.1),
        "{sides:?} {found:?}"
    );
    assert_eq!(bare["boxes"], refined["boxes"]);
    // Nothing of the picture is posed far outside.
    let far = json!({"inverse": true, "points": [[80, 60], [900, 900]],
        "polygons": [[[50, 50], [900, 50], [50, 60]], ring],
        "boxes": [[60, 50, 900, 70], [60, 50, 90, 70]]});
    let far = mapped(&server, &with(&warp, far)).await;
    assert!(
        far["points"][0].is_array() && far["polygons"][1].is_array() && far["boxes"][1].is_array(),
        "{far}"
    );
    assert!(
        far["points"][1].is_null() && far["polygons"][0].is_null() && far["boxes"][0].is_null(),
        "{far}"
    );
}

/// The inverse is that of f, whatever grid the picture is drawn with.
#[tokio::test]
async fn the_grid_does_not_limit_what_has_an_inverse() {
    let server = Server::start(&[]).await;
    let warp = json!({"p": [[40, 60], [120, 60], [80, 20]], "q": [[46, 56], [117, 69], [90, 35]],
        "extent": [160, 120]});
    let rest = json!([[80, 30], [2, 1], [158, 60], [60, 119], [90, 5]]);
    let there = mapped(&server, &with(&warp, json!({"points": rest}))).await;
    for grid in [
        json!({"columns": 2, "rows": 2}),
        json!({"cell": 100}),
        json!("pixel"),
        json!("auto"),
    ] {
        let back = mapped(
            &server,
            &with(
                &warp,
                json!({"points": there["points"], "inverse": true, "grid": grid}),
            ),
        )
        .await;
        for (back, rest) in places(&back["points"]).into_iter().zip(places(&rest)) {
            assert!(
                back.is_some_and(|back| back.distance(rest.unwrap()) < 1e-6),
                "{grid}: {back:?} {rest:?}"
            );
        }
    }
}

#[tokio::test]
async fn a_session_maps_as_the_request_without_one_and_units_are_its_own() {
    let server = Server::start(&[]).await;
    let rest = json!({"p": [[0.2, 0.2], [0.8, 0.3], [0.5, 0.9]], "units": "normalized"});
    let q = json!([[0.25, 0.2], [0.8, 0.35], [0.45, 0.85]]);
    let session = server
        .post("/sessions")
        .multipart(form(&coordinates(), rest.to_string()))
        .send()
        .await
        .unwrap();
    let id = session.json::<Value>().await.unwrap()["id"]
        .as_str()
        .unwrap()
        .to_owned();
    for inverse in [false, true] {
        let what = json!({"q": q, "polygons": [[[0.1, 0.1], [0.9, 0.1], [0.5, 0.8]]],
            "points": [[0.5, 0.5]], "inverse": inverse});
        let of_session = server
            .post(&format!("/sessions/{id}/points"))
            .json(&what)
            .send()
            .await
            .unwrap()
            .text()
            .await
            .unwrap();
        let once = with(&with(&rest, what), json!({"extent": [160, 120]}));
        assert_eq!(
            of_session,
            server
                .post("/points")
                .json(&once)
                .send()
                .await
                .unwrap()
                .text()
                .await
                .unwrap()
        );
    }
}

#[tokio::test]
async fn annotations_that_cannot_be_mapped_are_named() {
    let server = Server::start(&[]).await;
    let warp =
        json!({"p": [[40, 60], [120, 60]], "q": [[40, 65], [120, 60]], "extent": [160, 120]});
    let told = async |more: Value, status: u16, code: &str, pointer: &str, words: &str| {
        let found = problem(
            server
                .post("/points")
                .json(&with(&warp, more))
                .send()
                .await
                .unwrap(),
            status,
            code,
        )
        .await;
        assert_eq!(found["pointer"], pointer, "{found}");
        assert!(found["detail"].as_str().unwrap().contains(words), "{found}");
    };
    let feature = |geometry: Value| {
        json!({"geojson": {"type": "FeatureCollection", "features": [
        {"type": "Feature", "geometry": null}, {"type": "Feature", "geometry": geometry}]}})
    };
    told(
        json!({"polygons": [[[0, 0], [1, 1], [2, 0]], [[0, 0], [5e6, 1], [2, 0]]]}),
        422,
        "bad_value",
        "/polygons/1/1",
        "1000000",
    )
    .await;
    told(
        json!({"boxes": [[0, 0, 1, 1], [0, 0, 2e6, 1]]}),
        422,
        "bad_value",
        "/boxes/1",
        "1000000",
    )
    .await;
    told(
        json!({"boxes": [[50, 50, 20, 20]]}),
        422,
        "bad_value",
        "/boxes/0",
        "[left, top, right, bottom]",
    )
    .await;
    let coordinates = "/geojson/features/1/geometry/coordinates";
    told(
        feature(json!({"type": "Point", "coordinates": [3e6, 0]})),
        422,
        "bad_value",
        coordinates,
        "1000000",
    )
    .await;
    let far = json!({"type": "Polygon", "coordinates": [[[0, 0], [1, 0]], [[0, 0], [0, -3e6]]]});
    told(
        feature(far),
        422,
        "bad_value",
        &format!("{coordinates}/1/1"),
        "1000000",
    )
    .await;
    let out_of_range = r#"{"p": [], "extent": [9, 9], "geojson": {"type": "FeatureCollection", "features": [
        {"type": "Feature", "geometry": {"type": "Point", "coordinates": [1, 1e999]}}]}}"#;
    let response = server
        .post("/points")
        .header("content-type", "application/json")
        .body(out_of_range)
        .send()
        .await
        .unwrap();
    assert_eq!(
        problem(response, 422, "not_finite").await["pointer"],
        "/geojson/features/0/geometry/coordinates/1"
    );
    told(
        feature(json!({"type": "Point", "coordinates": [1]})),
        422,
        "bad_value",
        coordinates,
        "1 number",
    )
    .await;
    told(
        feature(json!({"type": "Circle", "coordinates": [1, 2]})),
        422,
        "bad_value",
        "/geojson/features/1/geometry/type",
        "Circle",
    )
    .await;
    told(
        json!({"geojson": {"type": "Feature", "geometry": 1}}),
        422,
        "bad_value",
        "/geojson/geometry",
        "GeoJSON geometry",
    )
    .await;
    told(
        json!({"geojson": {"type": "Topology", "objects": {}}}),
        422,
        "bad_value",
        "/geojson/type",
        "FeatureCollection",
    )
    .await;
    told(
        json!({"geojson": [{"type": "FeatureCollection", "features": []}]}),
        422,
        "bad_value",
        "/geojson/0/type",
        "Feature",
    )
    .await;
    told(
        json!({"polygons": [[[0, 0], null, [2, 0]]]}),
        422,
        "bad_value",
        "/polygons/0/1",
        "null in place of the polygon",
    )
    .await;
    let long: Vec<[f64; 2]> = (0..3000)
        .map(|k| [if k % 2 == 0 { -9e5 } else { 9e5 }, f64::from(k)])
        .collect();
    told(
        json!({"polygons": [long]}),
        413,
        "too_large",
        "/polygons",
        "2097152",
    )
    .await;
    let nested = format!("{}1{}", "[".repeat(100), "]".repeat(100));
    let nested: Value = serde_json::from_str(&nested).unwrap();
    told(
        feature(json!({"type": "Point", "coordinates": nested})),
        422,
        "bad_value",
        &format!("{coordinates}/0"),
        "number",
    )
    .await;
    let mut collection = json!({"type": "Point", "coordinates": [1, 2]});
    for _ in 0..17 {
        collection = json!({"type": "GeometryCollection", "geometries": [collection]});
    }
    let inner = format!("/geojson/features/1/geometry{}", "/geometries/0".repeat(16));
    told(
        feature(collection),
        422,
        "bad_value",
        &inner,
        "16 GeometryCollections",
    )
    .await;
}
