//! `POST /blend`: its laws through HTTP, what is refused, and what happens beside it.

use std::io::{Cursor, Read as _};

use reqwest::StatusCode;
use serde_json::{Value, json};

use crate::support::server::blend_form;
use crate::support::{Server, photo};

fn shape(dx: i32) -> Value {
    json!([
        [10 + dx, 10],
        [50 + dx, 12],
        [30, 20 + dx],
        [15, 38],
        [45 + dx, 40]
    ])
}

async fn blended(server: &Server, images: &[&[u8]], blend: &Value, accept: &str) -> Vec<u8> {
    let response = server
        .post("/blend")
        .header("accept", accept)
        .multipart(blend_form(images, blend))
        .send()
        .await
        .unwrap();
    let status = response.status();
    let bytes = response.bytes().await.unwrap().to_vec();
    assert_eq!(status, 200, "{}", String::from_utf8_lossy(&bytes));
    bytes
}

async fn refused(server: &Server, images: &[&[u8]], blend: &Value) -> (u16, String, Value) {
    let form = blend_form(images, blend);
    let response = server.post("/blend").multipart(form).send().await.unwrap();
    let status = response.status().as_u16();
    let problem: Value = response.json().await.unwrap();
    let text = |name: &str| problem[name].as_str().unwrap_or_default().to_owned();
    (status, text("code"), problem["pointer"].clone())
}

fn pixels(file: &[u8]) -> image::DynamicImage {
    image::load_from_memory(file).unwrap()
}

#[tokio::test]
async fn one_image_is_itself_and_two_equal_ones_give_it_back() {
    let server = Server::start(&[]).await;
    let file = photo(64, 48);
    let one = json!({"images": [{"image": 0, "p": shape(0)}]});
    assert_eq!(
        pixels(&blended(&server, &[&file], &one, "image/png").await),
        pixels(&file)
    );
    for s in [0.0, 0.3, 0.5, 1.0, -0.4] {
        let share = |s: f64| json!({"image": 0, "p": shape(0), "shape": s, "colour": s});
        let both = json!({"images": [share(1.0 - s), share(s)]});
        let blended = blended(&server, &[&file], &both, "image/png").await;
        assert_eq!(pixels(&blended), pixels(&file), "{s}");
    }
}

#[tokio::test]
async fn an_image_and_its_mirror_image_are_symmetric() {
    let server = Server::start(&[]).await;
    let blend = json!({"images": [
        {"image": 0, "p": shape(3)},
        {"image": 0, "p": shape(3), "mirror": true, "pairs": [1, 0, 2, 4, 3]},
    ]});
    let file = photo(64, 48);
    let blended = pixels(&blended(&server, &[&file], &blend, "image/png").await).to_rgba8();
    let flipped = image::imageops::flip_horizontal(&blended);
    let largest = blended
        .iter()
        .zip(flipped.iter())
        .map(|(a, b)| a.abs_diff(*b))
        .max();
    assert!(largest.unwrap() <= 1, "{largest:?}");
}

#[tokio::test]
async fn a_morph_leads_from_one_image_to_the_other() {
    let server = Server::start(&[]).await;
    let (first, second) = (photo(64, 48), photo(80, 40));
    let images = json!([{"image": 0, "p": shape(0)}, {"image": 1, "p": shape(4)}]);
    let blend = json!({"images": images, "steps": 3});
    let archive = blended(&server, &[&first, &second], &blend, "*/*").await;
    let mut archive = zip::ZipArchive::new(Cursor::new(archive)).unwrap();
    let mut entry = |name: &str| {
        let mut bytes = Vec::new();
        archive
            .by_name(name)
            .unwrap()
            .read_to_end(&mut bytes)
            .unwrap();
        bytes
    };
    let report: Value = serde_json::from_slice(&entry("report.json")).unwrap();
    let shares = |frame: usize| report["frames"][frame]["colour"].clone();
    assert_eq!(
        [shares(0), shares(1), shares(2)],
        [json!([1.0, 0.0]), json!([0.5, 0.5]), json!([0.0, 1.0])]
    );
    assert_eq!(report["frames"][1]["picture"], "0001.png");
    let landmarks: Value = serde_json::from_slice(&entry("0000.json")).unwrap();
    assert_eq!(landmarks["p"][0], json!([10.0, 10.0]), "the first shape");
    let start = pixels(&entry("0000.png")).to_rgb8();
    assert_eq!(start, pixels(&first).to_rgb8());
    // The frames are what single requests give.
    let middle = json!({"images": [
        {"image": 0, "p": shape(0), "shape": 0.5, "colour": 0.5},
        {"image": 1, "p": shape(4), "shape": 0.5, "colour": 0.5},
    ]});
    let single = blended(&server, &[&first, &second], &middle, "image/png").await;
    assert_eq!(
        pixels(&single).to_rgba8(),
        pixels(&entry("0001.png")).to_rgba8()
    );
    let animation = blended(&server, &[&first, &second], &blend, "image/apng").await;
    assert!(animation.windows(4).any(|chunk| chunk == b"acTL"));
}

#[tokio::test]
async fn sessions_and_files_give_the_same_image() {
    let server = Server::start(&[]).await;
    let (first, second) = (photo(64, 48), photo(80, 40));
    let mut entries = Vec::new();
    for (file, p) in [(&first, shape(0)), (&second, shape(4))] {
        let form = crate::support::server::form(file, json!({"p": p}).to_string());
        let opened: Value = server
            .post("/sessions")
            .multipart(form)
            .send()
            .await
            .unwrap()
            .json()
            .await
            .unwrap();
        entries.push(json!({"session": opened["id"]}));
    }
    let of_sessions = server
        .post("/blend")
        .json(&json!({"images": entries}))
        .send()
        .await
        .unwrap();
    assert_eq!(of_sessions.status(), StatusCode::OK);
    let of_sessions = of_sessions.bytes().await.unwrap();
    let files = json!({"images": [{"image": 0, "p": shape(0)}, {"image": 1, "p": shape(4)}]});
    assert_eq!(
        blended(&server, &[&first, &second], &files, "image/png").await,
        of_sessions
    );
}

#[tokio::test]
async fn what_does_not_fit_together_is_refused_with_its_place() {
    let server = Server::start(&[]).await;
    let file = photo(64, 48);
    let entry = |more: Value| {
        let mut entry = json!({"image": 0, "p": shape(0)});
        entry
            .as_object_mut()
            .unwrap()
            .extend(more.as_object().unwrap().clone());
        entry
    };
    let two = |more: Value| json!({"images": [entry(json!({})), entry(more)]});
    let with = |name: &str, value: Value| {
        let mut blend = two(json!({}));
        blend[name] = value;
        blend
    };
    let line = json!([[[1, 1], [2, 2]], [50, 12], [30, 20], [15, 38], [45, 40]]);
    let cases = [
        (json!({}), "bad_value", "/images"),
        (json!({"images": []}), "bad_value", "/images"),
        (two(json!({"image": 7})), "bad_value", "/images/1/image"),
        (two(json!({"p": null})), "bad_value", "/images/1"),
        (two(json!({"p": [[1, 1]]})), "shape_mismatch", "/images/1"),
        (two(json!({"p": line})), "shape_mismatch", "/images/1"),
        (two(json!({"shape": 0.5})), "bad_value", "/images/0/shape"),
        (
            two(json!({"colour": 1e300})),
            "bad_value",
            "/images/1/colour",
        ),
        (
            two(json!({"shape": -1e300})),
            "bad_value",
            "/images/1/shape",
        ),
        (two(json!({"session": "x"})), "bad_value", "/images/1"),
        (two(json!({"item": "x"})), "bad_value", "/images/1/item"),
        (
            two(json!({"names": ["a"]})),
            "shape_mismatch",
            "/images/1/names",
        ),
        (
            two(json!({"pairs": [1, 0, 2, 4, 3]})),
            "bad_value",
            "/images/1/pairs",
        ),
        (
            two(json!({"mirror": true, "pairs": [1, 0]})),
            "bad_value",
            "/images/1/pairs",
        ),
        (
            two(json!({"colour": [0.5, 0.5]})),
            "bad_value",
            "/images/0/colour",
        ),
        (with("steps", json!(1001)), "too_large", "/steps"),
        (with("method", json!("auto")), "bad_value", "/method"),
        (with("reference", json!(2)), "bad_value", "/reference"),
        (
            with("reference", json!([[1, 1]])),
            "shape_mismatch",
            "/reference",
        ),
        (
            with("output", json!({"canvas": "fit"})),
            "bad_value",
            "/output/canvas",
        ),
        (with("match", json!("name")), "bad_value", "/match"),
        (with("space", json!("lab")), "bad_value", "/space"),
    ];
    for (blend, code, pointer) in cases {
        let (status, found, at) = refused(&server, &[&file], &blend).await;
        assert_eq!(
            (found.as_str(), at.as_str()),
            (code, Some(pointer)),
            "{blend}"
        );
        assert!([413, 422].contains(&status), "{blend}: {status}");
    }
    // A file that is damaged is named.
    let blend = json!({"images": [{"image": 0, "p": shape(0)}, {"image": 1, "p": shape(0)}]});
    let (_, code, at) = refused(&server, &[&file, &file[..file.len() / 2]], &blend).await;
    assert_eq!((code.as_str(), at), ("bad_image", json!("/images/1")));
    let third = json!({"image": 0, "p": shape(2)});
    let blend = json!({"images": [blend["images"][0], blend["images"][1], third]});
    let (_, code, at) = refused(&server, &[&file, &file[..file.len() / 2]], &blend).await;
    assert_eq!((code.as_str(), at), ("bad_image", json!("/images/1")));
    // More work than a request may cause is refused before any image is decoded.
    let many: Vec<Value> = (0..200).map(|_| entry(json!({}))).collect();
    let blend = json!({"images": many, "output": {"width": 4000}});
    let (status, code, at) = refused(&server, &[&file], &blend).await;
    assert_eq!(
        (status, code.as_str(), at),
        (413, "too_large", json!("/images"))
    );
    let many: Vec<Value> = (0..201).map(|_| entry(json!({}))).collect();
    let (status, code, _) = refused(&server, &[&file], &json!({"images": many})).await;
    assert_eq!((status, code.as_str()), (413, "too_large"));
}

#[tokio::test]
async fn landmarks_are_matched_by_name_and_missing_ones_are_left_out() {
    let server = Server::start(&[]).await;
    let file = photo(64, 48);
    let send = async |second: &str| {
        let form = blend_form(
            &[&file, &file],
            &json!({"images": [{"image": 0}, {"image": 1}]}),
        )
        .text(
            "landmarks",
            "name,x,y\na,10,10\nb,50,12\nc,30,20\nd,15,38\n",
        )
        .text("landmarks", second.to_owned());
        let request = server.post("/blend").multipart(form);
        let response = request.send().await.unwrap();
        assert_eq!(response.status(), StatusCode::OK);
        pixels(&response.bytes().await.unwrap())
    };
    let same = send("name,x,y\na,10,10\nb,50,12\nc,30,20\nd,15,38\n").await;
    assert_eq!(same, pixels(&file));
    assert_eq!(
        send("name,x,y\nd,15,38\nb,50,12\na,10,10\nc,30,20\n").await,
        same
    );
    assert_eq!(
        send("name,x,y\nd,15,38\nb,50,12\na,10,10\ne,1,1\n").await,
        same
    );
    // Handles in the object have names of their own.
    let entry = |p: Value, names: Value| json!({"image": 0, "p": p, "names": names});
    let (p, turned) = (
        json!([[10, 10], [50, 12], [30, 20]]),
        json!([[30, 20], [10, 10], [50, 12]]),
    );
    let images = json!([
        entry(p, json!(["a", "b", "c"])),
        entry(turned, json!(["c", "a", "b"])),
    ]);
    let blend = json!({"images": images});
    let matched = blended(&server, &[&file], &blend, "image/png").await;
    assert_eq!(pixels(&matched), same);
}

/// Every field has an effect: two values give two answers.
#[tokio::test]
async fn every_field_has_an_effect() {
    let server = Server::start(&[]).await;
    let (first, second) = (photo(64, 48), photo(80, 40));
    let base = json!({"images": [{"image": 0, "p": shape(0)}, {"image": 1, "p": shape(4)}]});
    let plain = blended(&server, &[&first, &second], &base, "*/*").await;
    let document: Value = serde_json::from_str(include_str!("../../api/openapi.json")).unwrap();
    let schema = |name: &str| document["components"]["schemas"][name]["properties"].clone();
    let values = json!({
        "align": "none", "reference": 1, "space": "linear", "steps": 2, "method": "affine",
        "alpha": 2, "grid": {"columns": 3, "rows": 3}, "output": {"width": 20},
    });
    for name in schema("Blend").as_object().unwrap().keys() {
        // Of points beside lines, of a spline, of coincident handles and of names: no effect here.
        let elsewhere = ["images", "match", "point_mass", "smoothing", "coincident"];
        if elsewhere.contains(&name.as_str()) {
            continue;
        }
        let mut blend = base.clone();
        blend[name] = values
            .get(name)
            .unwrap_or_else(|| panic!("{name} has no value here"))
            .clone();
        assert!(
            blended(&server, &[&first, &second], &blend, "*/*").await != plain,
            "{name}"
        );
    }
    let p = json!([[14, 8], [40, 12], [30, 22], [15, 38], [45, 40]]);
    let entries = [
        ("image", json!({"image": 0})),
        ("shape", json!({"shape": 1, "colour": 0.5})),
        ("colour", json!({"shape": 0.5, "colour": 1})),
        ("mirror", json!({"mirror": true, "pairs": [1, 0, 2, 4, 3]})),
        ("pairs", json!({"mirror": true, "pairs": [0, 1, 2, 3, 4]})),
        ("p", json!({"p": p})),
    ];
    let mut answers = vec![plain];
    for name in schema("BlendImage").as_object().unwrap().keys() {
        // `sessions_and_files_give_the_same_image`, `landmarks_are_matched_by_name...`, and the
        // landmark files of `offline_blend.rs`.
        if ["session", "names", "item"].contains(&name.as_str()) {
            continue;
        }
        let (_, more) = entries.iter().find(|(entry, _)| entry == name).unwrap();
        let mut blend = base.clone();
        let entry = blend["images"][1].as_object_mut().unwrap();
        entry.extend(more.as_object().unwrap().clone());
        if let (Some(shape), Some(colour)) = (more.get("shape"), more.get("colour")) {
            let rest = |share: &Value| 1.0 - share.as_f64().unwrap();
            blend["images"][0]["shape"] = json!(rest(shape));
            blend["images"][0]["colour"] = json!(rest(colour));
        }
        let answer = blended(&server, &[&first, &second], &blend, "*/*").await;
        assert!(!answers.contains(&answer), "{name}");
        answers.push(answer);
    }
}
