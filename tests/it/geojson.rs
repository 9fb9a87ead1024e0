//! GeoJSON as programs write it: every shape, every geometry, every member; what is no position
//! stays as it is. Files of any length are mapped part by part.

use std::time::Instant;

use serde_json::{Value, json};

use crate::points::{places, with};
use crate::support::server::problem;
use crate::support::{Server, photo};

/// A warp that bends the whole picture, and folds nowhere.
fn warp() -> Value {
    json!({"p": [[40, 60], [120, 60], [80, 20], [70, 100]], "q": [[46, 62], [117, 55], [84, 26],
        [66, 97]], "extent": [160, 120]})
}

/// One of each geometry, away from the border.
fn geometries() -> Vec<Value> {
    let ring = |x: f64, y: f64| json!([[x, y], [x + 20.0, y], [x + 20.0, y + 15.5], [x, y]]);
    let line = json!([[30, 30], [60.5, 45], [90, 30]]);
    let mut all = vec![
        json!({"type": "Point", "coordinates": [50, 60]}),
        json!({"type": "MultiPoint", "coordinates": [[50, 60], [70, 30]]}),
        json!({"type": "LineString", "coordinates": line}),
        json!({"type": "MultiLineString", "coordinates": [line, [[20, 20], [25, 25]]]}),
        json!({"type": "Polygon", "coordinates": [ring(30.0, 40.0), ring(35.0, 42.0)]}),
        json!({"type": "MultiPolygon", "coordinates": [[ring(30.0, 40.0)], [ring(80.0, 60.0)]]}),
    ];
    all.push(json!({"type": "GeometryCollection", "geometries": all.clone()}));
    let nested = json!({"type": "GeometryCollection",
        "geometries": [all[6], {"type": "GeometryCollection", "geometries": []}]});
    all.push(nested);
    all
}

async fn mapped_text(server: &Server, body: String) -> String {
    let response = server
        .post("/points")
        .header("content-type", "application/json")
        .body(body)
        .send()
        .await
        .unwrap();
    let (status, text) = (response.status(), response.text().await.unwrap());
    assert_eq!(status, 200, "{}", &text[..text.len().min(500)]);
    text
}

async fn mapped(server: &Server, geojson: &Value, more: Value) -> Value {
    let request = with(&with(&warp(), json!({"geojson": geojson})), more);
    let text = mapped_text(server, request.to_string()).await;
    serde_json::from_str::<Value>(&text).unwrap()["geojson"].take()
}

/// Every position of a text, in order, and the text without them.
fn positions(value: &Value, found: &mut Vec<[f64; 2]>) -> Value {
    match value {
        Value::Array(list) => match list.as_slice() {
            [Value::Number(x), Value::Number(y), more @ ..] => {
                found.push([x.as_f64().unwrap(), y.as_f64().unwrap()]);
                json!({"position": more})
            }
            _ => list.iter().map(|value| positions(value, found)).collect(),
        },
        Value::Object(fields) => fields
            .iter()
            .map(|(name, value)| (name.clone(), positions(value, found)))
            .collect(),
        other => other.clone(),
    }
}

fn assert_same(before: &Value, after: &Value, within: f64) {
    let (mut old, mut new) = (Vec::new(), Vec::new());
    assert_eq!(positions(before, &mut old), positions(after, &mut new));
    for ([x, y], [u, v]) in old.iter().zip(&new) {
        assert!((x - u).hypot(y - v) <= within, "{before} {after}");
    }
    assert!(old.len() == new.len() && (old.is_empty() || within > 0.0 || old == new));
}

fn shapes(geometry: &Value) -> [Value; 4] {
    let feature = json!({"type": "Feature", "id": 7, "geometry": geometry,
        "properties": {"a": [1], "b": null}, "x": {"type": "y"}});
    let collection = json!({"type": "FeatureCollection", "features": [feature, feature],
        "crs": {"type": "name"}});
    [
        geometry.clone(),
        feature.clone(),
        json!([feature, geometry, feature]),
        collection,
    ]
}

#[tokio::test]
async fn every_geometry_in_every_shape_goes_there_and_back() {
    let server = Server::start(&[]).await;
    let bare = json!({"refine": false});
    for geometry in geometries() {
        for shape in shapes(&geometry) {
            let there = mapped(&server, &shape, bare.clone()).await;
            let (mut old, mut new) = (Vec::new(), Vec::new());
            assert_eq!(
                positions(&shape, &mut old),
                positions(&there, &mut new),
                "the same shape comes back"
            );
            assert!(
                old.iter()
                    .zip(&new)
                    .all(|([x, y], [u, v])| (x - u).hypot(y - v) > 0.1),
                "all positions move: {there}"
            );
            let points = with(&warp(), json!({"points": old}));
            let points: Value =
                serde_json::from_str(&mapped_text(&server, points.to_string()).await).unwrap();
            assert_eq!(points["points"], json!(new), "by the same map");
            let back = mapped(&server, &there, with(&bare, json!({"inverse": true}))).await;
            assert_same(&shape, &back, 1e-6);
            let rest = warp()["p"].clone();
            assert_same(
                &shape,
                &mapped(&server, &shape, json!({"q": rest, "refine": false})).await,
                0.0,
            );
            // What has no source becomes null, one geometry at a time.
            let mut far = shape.clone();
            let lost = json!({"type": "MultiPoint", "coordinates": [[50, 60], [9000, 9000]]});
            if let Some(features) = far.get_mut("features").and_then(Value::as_array_mut) {
                features[1]["geometry"] = lost;
                let back = mapped(&server, &far, with(&bare, json!({"inverse": true}))).await;
                assert!(
                    back["features"][1]["geometry"].is_null()
                        && back["features"][0]["geometry"].is_object(),
                    "{back}"
                );
            }
        }
    }
}

#[tokio::test]
async fn every_member_that_is_a_geometry_is_mapped_and_nothing_else() {
    let server = Server::start(&[]).await;
    let point = |x: f64| json!({"type": "Point", "coordinates": [x, 60.0]});
    let moved = mapped(&server, &point(50.0), json!({})).await;
    assert_ne!(moved, point(50.0));
    let kept = json!([
        {"type": "Circle", "coordinates": [50, 60]}, {"type": "Point", "coordinates": "50 \
            60"}, {"type": "Point"}, [50, 60],
        {"coordinates": [50, 60]}, {"type": 7, "coordinates": [50, 60]},
            {"type": "GeometryCollection", "coordinates": [50, 60]},
        {"deeper": {"type": "Point", "coordinates": [50, 60]}},
    ]);
    let members = |point: &Value| {
        let mut feature = json!({
            "type": "Feature", "geometry": null, "nucleusGeometry": point, "a/b~c": point,
                "\u{e9}": point,
            "properties": {"centroid": point, "label": "x", "list": [point]}, "id": point,
        });
        // Lists and ids are no members of the feature that have a geometry.
        feature["id"] = json!({"type": "Point", "coordinates": [50.0, 60.0]});
        feature["properties"]["list"] = json!([{"type": "Point", "coordinates": [50.0, 60.0]}]);
        for (k, value) in kept.as_array().unwrap().iter().enumerate() {
            feature[format!("kept{k}")] = value.clone();
            feature["properties"][format!("kept{k}")] = value.clone();
        }
        feature
    };
    assert_eq!(
        mapped(&server, &members(&point(50.0)), json!({})).await,
        members(&moved)
    );
    // Those of a collection too.
    let collection = |point: &Value| {
        json!({"type": "FeatureCollection", "before": point,
        "features": [], "outline": point})
    };
    assert_eq!(
        mapped(&server, &collection(&point(50.0)), json!({})).await,
        collection(&moved)
    );
    // A value that looks like a geometry but is not one is named, not left out silently.
    for (path, feature) in [
        (
            "/nucleusGeometry/coordinates/0",
            json!({"type": "Feature", "nucleusGeometry": {"type": "Polygon", "coordinates": [7]}}),
        ),
        (
            "/a~1b~0c/coordinates",
            json!({"type": "Feature", "a/b~c": {"type": "Point", "coordinates": [7]}}),
        ),
        (
            "/properties/hull/coordinates/1",
            json!({"type": "Feature",
                "properties": {"hull": {"type": "Point", "coordinates": [7, "8"]}}}),
        ),
    ] {
        let request = with(&warp(), json!({"geojson": [feature]}));
        let found = problem(
            server.post("/points").json(&request).send().await.unwrap(),
            422,
            "bad_value",
        )
        .await;
        assert_eq!(found["pointer"], format!("/geojson/0{path}"), "{found}");
    }
}

#[tokio::test]
async fn further_numbers_of_a_position_pass_through() {
    let server = Server::start(&[]).await;
    let line = |text: &str| format!(r#"{{"type":"LineString","coordinates":{text}}}"#);
    let request = |geometry: &str, refine: bool| {
        let mut body = warp().to_string();
        body.pop();
        format!(r#"{body},"refine":{refine},"geojson":{geometry}}}"#)
    };
    let text = mapped_text(
        &server,
        request(&line("[[30,60, 1.50],[50,20,2e0 , 7],[70,60]]"), false),
    )
    .await;
    assert!(
        text.contains(", 1.50],[")
            && text.contains(",2e0 , 7],[")
            && text.matches(',').count() >= 7,
        "{text}"
    );
    let heights = |text: &str| -> Vec<f64> {
        let value: Value = serde_json::from_str(text).unwrap();
        let coordinates = value["geojson"]["coordinates"].as_array().unwrap();
        coordinates
            .iter()
            .map(|position| position[2].as_f64().unwrap())
            .collect()
    };
    // Between two heights, those of added vertices grow with them.
    let text = mapped_text(
        &server,
        request(&line("[[20,20,100],[140,20,220],[140,100,220]]"), true),
    )
    .await;
    let heights = heights(&text);
    assert!(
        heights.len() > 6
            && heights.is_sorted()
            && heights[0] == 100.0
            && heights.last() == Some(&220.0),
        "{heights:?}"
    );
    assert!(
        heights
            .iter()
            .filter(|height| **height > 100.0 && **height < 220.0)
            .count()
            > 2,
        "{heights:?}"
    );
    let value: Value = serde_json::from_str(&text).unwrap();
    for position in value["geojson"]["coordinates"]
        .as_array()
        .unwrap()
        .iter()
        .filter(|position| position[2].as_f64() < Some(220.0))
    {
        let back = json!({"points": [[position[0], position[1]]], "inverse": true});
        let back: Value =
            serde_json::from_str(&mapped_text(&server, with(&warp(), back).to_string()).await)
                .unwrap();
        let expected = 100.0 + back["points"][0][0].as_f64().unwrap() - 20.0;
        assert!(
            (position[2].as_f64().unwrap() - expected).abs() < 1e-5,
            "{position} {back}"
        );
    }
    // Boxes of three dimensions keep the third.
    let boxed = r#"{"type":"Feature","bbox":[0,0,-5,9,9,1.50],"geometry":{"type":"Point","bbox":[1,2,3],"coordinates":[50,60,7]}}"#;
    let value: Value =
        serde_json::from_str(&mapped_text(&server, request(boxed, true)).await).unwrap();
    let (feature, place) = (
        &value["geojson"],
        &value["geojson"]["geometry"]["coordinates"],
    );
    assert_eq!(
        feature["bbox"],
        json!([place[0], place[1], -5, place[0], place[1], 1.5])
    );
    assert_eq!(
        feature["geometry"]["bbox"],
        json!([place[0], place[1], place[0], place[1]])
    );
    // A point may have no position.
    let empty = r#"[{"type":"Point","coordinates":[]},{"type":"Polygon","coordinates":[]}]"#;
    assert_eq!(
        mapped_text(&server, request(empty, true)).await,
        format!("{{\"geojson\":{empty}}}")
    );
}

/// The order of the members does not matter, and stays.
#[tokio::test]
async fn members_may_have_any_order() {
    let server = Server::start(&[]).await;
    let geometry = [
        r#""type":"Point""#,
        r#""coordinates":[50,60]"#,
        r#""plane":{"z":0}"#,
    ];
    let (mut feature, mut collection) = (Vec::new(), Vec::new());
    let orders = [
        [0, 1, 2],
        [0, 2, 1],
        [1, 0, 2],
        [1, 2, 0],
        [2, 0, 1],
        [2, 1, 0],
    ];
    let joined = |members: [&str; 3], order: [usize; 3]| {
        format!("{{{}}}", order.map(|k| members[k]).join(","))
    };
    for order in orders {
        let geometry = format!(r#""geometry":{}"#, joined(geometry, order));
        feature.push(joined(
            [r#""type":"Feature""#, &geometry, r#""properties":{}"#],
            order,
        ));
    }
    for (order, feature) in orders.into_iter().zip(&feature) {
        let features = format!(r#""features":[ {feature} ]"#);
        collection.push(joined(
            [
                r#""type":"FeatureCollection""#,
                &features,
                r#""bbox": [1,2,3,4]"#,
            ],
            order,
        ));
    }
    let rest = warp().to_string();
    let rest = &rest[1..rest.len() - 1];
    let mut coordinates = Vec::new();
    for (order, collection) in orders.into_iter().zip(&collection) {
        let geojson = format!(r#""geojson":{collection}"#);
        let text = mapped_text(
            &server,
            joined([&geojson, rest, r#""refine":false"#], order),
        )
        .await;
        let value: Value = serde_json::from_str(&text).unwrap();
        let place = value["geojson"]["features"][0]["geometry"]["coordinates"].clone();
        assert_eq!(
            value["geojson"]["bbox"],
            json!([place[0], place[1], place[0], place[1]]),
            "{text}"
        );
        // A box before the features follows them.
        let names = |text: &str| {
            let mut names = ["FeatureCollection", "features", "bbox", "plane"]
                .map(|name| (text.find(name).unwrap(), name));
            names.sort_unstable();
            names
                .map(|(_, name)| name)
                .into_iter()
                .filter(|name| *name != "bbox")
                .collect::<Vec<_>>()
        };
        assert_eq!(names(&text), names(collection), "{text}");
        coordinates.push(place);
    }
    assert!(
        coordinates.windows(2).all(|pair| pair[0] == pair[1]),
        "{coordinates:?}"
    );
}

/// `null` stays in its place, and what the server answers can be sent to it again.
#[tokio::test]
async fn what_is_missing_stays_missing() {
    let server = Server::start(&[]).await;
    let id = server
        .session(&photo(160, 120), &json!({"p": warp()["p"]}))
        .await;
    let missing = json!({
        "points": [null, [50, 60], null], "boxes": [[10, 10, 20, 20], null],
            "polygons": [null, [[20, 20], [40, 20], [40, 40]], null],
        "geojson": [{"type": "Feature", "geometry": null, "nucleusGeometry": null,
            "properties": null}],
    });
    let nulls = |value: &Value| {
        ["points", "boxes", "polygons"].map(|name| {
            value[name]
                .as_array()
                .unwrap()
                .iter()
                .map(Value::is_null)
                .collect::<Vec<_>>()
        })
    };
    for inverse in [false, true] {
        let body = with(&with(&warp(), missing.clone()), json!({"inverse": inverse}));
        let once: Value =
            serde_json::from_str(&mapped_text(&server, body.to_string()).await).unwrap();
        assert_eq!(
            (nulls(&once), &once["geojson"]),
            (nulls(&missing), &missing["geojson"])
        );
        let again = mapped_text(&server, with(&warp(), once.clone()).to_string()).await;
        assert_eq!(
            nulls(&serde_json::from_str(&again).unwrap()),
            nulls(&missing)
        );
    }
    // Nothing of the picture is posed far outside: nulls of the answer are read.
    let far = json!({"points": [[50, 60], [900, 900]], "boxes": [[900, 900, 910, 910]],
        "polygons": [[[900, 0], [910, 0], [905, 5]]],
        "geojson": {"type": "Feature", "geometry": {"type": "Point", "coordinates": [900, 900]}},
            "inverse": true});
    let back: Value =
        serde_json::from_str(&mapped_text(&server, with(&warp(), far).to_string()).await).unwrap();
    assert!(
        back["points"][1].is_null()
            && back["boxes"][0].is_null()
            && back["polygons"][0].is_null()
            && back["geojson"]["geometry"].is_null()
    );
    mapped_text(&server, with(&warp(), back.clone()).to_string()).await;
    let frames = with(&json!({"frames": [{"q": warp()["q"]}]}), back);
    let batch = server
        .post(&format!("/sessions/{id}/batch"))
        .json(&frames)
        .send()
        .await
        .unwrap();
    assert_eq!(batch.status(), 200, "{:?}", batch.text().await);
}

/// A cell of a segmentation.
fn cell(k: usize, vertices: usize) -> String {
    let (x, y) = (
        20.0 + (k as f64 * 7.31) % 120.0,
        20.0 + (k as f64 * 3.77) % 80.0,
    );
    let vertex = |t: usize| {
        let angle = std::f64::consts::TAU * t as f64 / (vertices - 1) as f64;
        format!(
            "[{:.2}, {:.2}]",
            x + 4.0 * angle.cos(),
            y + 4.0 * angle.sin()
        )
    };
    let ring: Vec<String> = (0..vertices).map(vertex).collect();
    let geometry = format!(
        r#"{{"type": "Polygon", "coordinates": [[{}]]}}"#,
        ring.join(", ")
    );
    format!(
        r#"{{"type": "Feature", "id": "{k}", "geometry": {geometry}, "properties": {{"objectType": "detection"}}}}"#
    )
}

/// Many parts give what one part gives, in every shape, with everything between them.
#[tokio::test]
async fn a_long_file_is_the_sum_of_its_features() {
    let server = Server::start(&[]).await;
    let cells: Vec<String> = (0..2500).map(|k| cell(k, 24)).collect();
    let mut single = warp().to_string();
    single.pop();
    let one = mapped_text(&server, format!(r#"{single},"geojson":[{}]}}"#, cells[777])).await;
    let one = one
        .strip_prefix(r#"{"geojson":["#)
        .unwrap()
        .strip_suffix("]}")
        .unwrap();
    let joined = cells.join(" ,\n ");
    assert!(joined.len() > 1 << 20);
    for (before, after) in [
        ("[", "]"),
        (
            r#"{"type": "FeatureCollection", "features": [ "#,
            r#"], "name": "cells"}"#,
        ),
        (r#"{"features": ["#, r#"], "type":"FeatureCollection"}"#),
    ] {
        let body = format!(
            r#"{single},"boxes":[[40,40,60,60]],"geojson":{before}{joined}{after},"points":[[50,60],null]}}"#
        );
        let text = mapped_text(&server, body).await;
        let value: Value = serde_json::from_str(&text).unwrap();
        let features = value["geojson"]
            .as_array()
            .or_else(|| value["geojson"]["features"].as_array())
            .unwrap();
        assert_eq!(features.len(), 2500);
        assert!(
            text.contains(&format!(",\n {one} ,\n ")),
            "with the text between them"
        );
        assert!(
            places(&value["points"])[0].is_some() && text.contains(before) && text.contains(after)
        );
        assert!(
            features
                .iter()
                .enumerate()
                .all(|(k, feature)| feature["id"].as_str() == Some(k.to_string().as_str()))
        );
        assert_eq!(
            value["geojson"].get("name").is_some(),
            after.contains("name")
        );
    }
    // So are lists of points.
    let points: Vec<Value> = (0..40_000)
        .map(|k| {
            if k % 7 == 0 {
                Value::Null
            } else {
                json!([k % 160, k % 113])
            }
        })
        .collect();
    let all: Value = serde_json::from_str(
        &mapped_text(
            &server,
            with(&warp(), json!({"points": points})).to_string(),
        )
        .await,
    )
    .unwrap();
    let part: Value = serde_json::from_str(
        &mapped_text(
            &server,
            with(&warp(), json!({"points": points[..100]})).to_string(),
        )
        .await,
    )
    .unwrap();
    let all = all["points"].as_array().unwrap();
    assert!(all.len() == points.len() && all[..100] == part["points"].as_array().unwrap()[..]);
    assert!(
        all.iter()
            .zip(&points)
            .all(|(mapped, given)| mapped.is_null() == given.is_null())
    );
}

/// A file of the size that is exported in practice is within the limits, also in a session and in a
/// batch.
#[tokio::test]
async fn twenty_thousand_cells_are_mapped() {
    let server = Server::start(&[]).await;
    let id = server
        .session(&photo(160, 120), &json!({"p": warp()["p"]}))
        .await;
    let cells: Vec<String> = (0..20_000).map(|k| cell(k, 31)).collect();
    let mut single = warp().to_string();
    single.pop();
    let geojson = format!(
        r#""geojson": {{"type": "FeatureCollection", "features": [{}]}}"#,
        cells.join(", ")
    );
    let began = Instant::now();
    for body in [
        format!("{single}, {geojson}}}"),
        format!(r#"{{{geojson}, {}"#, &warp().to_string()[1..]),
    ] {
        assert!(body.len() > 12 << 20);
        let text = mapped_text(&server, body).await;
        assert!(
            text.len() > 20 << 20 && text.ends_with("]}}"),
            "{}",
            text.len()
        );
    }
    eprintln!("2 x 20,000 cells: {:?}", began.elapsed());
    let frames = format!(
        r#"{{"frames": [{{"q": {}}}], "refine": false, {geojson}}}"#,
        warp()["q"]
    );
    let batch = server
        .post(&format!("/sessions/{id}/batch"))
        .header("content-type", "application/json")
        .body(frames)
        .send()
        .await
        .unwrap();
    assert_eq!(batch.status(), 200);
    assert!(batch.bytes().await.unwrap().len() > 20 << 20);
    // The other fields have the limit of a warp object.
    let weights = vec!["1"; 3 << 20].join(",");
    let response = server
        .post("/points")
        .header("content-type", "application/json")
        .body(format!("{single},\"weights\":[{weights}]}}"));
    assert_eq!(
        problem(response.send().await.unwrap(), 413, "too_large").await["limit_name"],
        "json_bytes"
    );
}
