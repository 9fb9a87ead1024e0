//! Landmark files where handles are, without a server: `mlswarp fit`, and batches.

use std::fs;

use serde_json::{Value, json};

use crate::support::program::{done, failed};
use crate::support::{Scratch, Server, photo};

const P: [[f64; 2]; 6] = [
    [5.0, 5.0],
    [50.0, 6.0],
    [8.0, 33.0],
    [52.0, 30.0],
    [30.0, 20.0],
    [40.0, 12.0],
];
const Q: [[f64; 2]; 6] = [
    [7.0, 6.0],
    [51.0, 9.0],
    [8.5, 35.0],
    [51.0, 34.0],
    [31.0, 23.0],
    [52.0, 2.0],
];

/// The landmarks of both sides with names; the last one is wrong.
fn csv() -> String {
    let rows = P
        .iter()
        .zip(Q)
        .enumerate()
        .map(|(k, (p, q))| format!("mark {k},{},{},{},{}\n", p[0], p[1], q[0], q[1]));
    format!("name,px,py,qx,qy\n{}", rows.collect::<String>())
}

#[tokio::test]
async fn fit_compares_methods_as_the_server_does() {
    let (scratch, server) = (Scratch::new(), Server::start(&[]).await);
    let (landmarks, warp, image, out) = (
        scratch.path("landmarks.csv"),
        scratch.path("warp.json"),
        scratch.path("image.png"),
        scratch.path("fit.json"),
    );
    fs::write(&landmarks, csv()).unwrap();
    // A file for `mlswarp warp` serves both.
    let object = json!({"p": P, "q": Q, "method": "affine", "strength": 0.5,
        "output": {"width": 20}, "folds": "reject"});
    fs::write(&warp, object.to_string()).unwrap();
    fs::write(&image, photo(60, 40)).unwrap();
    let two = json!([{"method": "tps", "smoothing": 0.1}, {"method": "affine"}]);
    for (args, stdin, more) in [
        (&[&*warp, "--extent", "60,40"][..], json!({}), json!({})),
        (
            &[&*warp, "--image", &*image, "--align", "similarity"],
            json!({}),
            json!({"align": "similarity"}),
        ),
        (
            &["--landmarks", &*landmarks, "--image", &*image],
            json!({}),
            json!({}),
        ),
        (
            &["-", "--landmarks", &*landmarks, "--image", &*image],
            json!({"candidates": two}),
            json!({"candidates": two}),
        ),
    ] {
        let mut body = json!({"p": P, "q": Q, "extent": [60, 40]});
        body.as_object_mut()
            .unwrap()
            .extend(more.as_object().unwrap().clone());
        let response = server.post("/fit").json(&body).send().await.unwrap();
        let expected = response.error_for_status().unwrap().bytes().await.unwrap();
        let (found, said) = done(&[&["fit"], args, &["-o", "-"]].concat(), &stdin.to_string());
        assert!(found == expected && said.is_empty(), "{args:?}: {said}");
        assert!(
            done(
                &[&["fit"], args, &["-o", &*out]].concat(),
                &stdin.to_string()
            )
            .0
            .is_empty()
        );
        assert!(fs::read(&out).unwrap() == expected, "{args:?}");
        let table =
            String::from_utf8(done(&[&["fit"], args].concat(), &stdin.to_string()).0).unwrap();
        let answer: Value = serde_json::from_slice(&expected).unwrap();
        let mut lines = table.lines();
        assert!(lines.next().unwrap().starts_with("method "), "{table}");
        let best = answer["best"]["method"].as_str().unwrap();
        assert!(
            lines.next().unwrap().split_whitespace().next() == Some(best),
            "{best}: {table}"
        );
        assert_eq!(
            lines.count() + 1,
            answer["candidates"].as_array().unwrap().len(),
            "{table}"
        );
        let is_named = args.contains(&"--landmarks");
        assert_eq!(
            table.contains("5 (mark 5)"),
            is_named && answer.to_string().contains("\"outliers\":[5]"),
            "{table}"
        );
    }
}

#[test]
fn fit_names_what_is_wrong() {
    let scratch = Scratch::new();
    let landmarks = scratch.path("landmarks.csv");
    fs::write(&landmarks, csv()).unwrap();
    let one = scratch.path("one.csv");
    fs::write(&one, "x,y\n1,2\n3,4\n").unwrap();
    for (args, stdin, sentence) in [
        (
            &["--landmarks", &*landmarks][..],
            "",
            "error: the size of the image is missing; give --extent WIDTH,HEIGHT, ",
        ),
        (
            &["--landmarks", &*one, "--extent", "60,40"],
            "",
            &*format!("bad_value: {one}: it has no posed positions: "),
        ),
        (
            &["-", "--extent", "60,40"],
            r#"{"p": [[1, 2]]}"#,
            "bad_value: ",
        ),
        (
            &["-", "--extent", "60,40"],
            r#"{"p": [[1, 2]], "q": [[1, 2]], "stepz": 1}"#,
            "unknown_field: standard input: ",
        ),
        (
            &["-", "--landmarks", &*landmarks, "--extent", "60,40"],
            r#"{"p": [[1, 2]]}"#,
            "bad_value: standard input: ",
        ),
        (
            &["-", "--extent", "60,40", "--align", "tps"],
            r#"{"p": [[1, 2]], "q": [[1, 2]]}"#,
            "bad_value: --align: ",
        ),
        (
            &[
                "--landmarks",
                &*landmarks,
                "--extent",
                "60,40",
                "-o",
                &*landmarks,
            ],
            "",
            "error: ",
        ),
    ] {
        let said = failed(&[&["fit"], args].concat(), stdin);
        assert!(said.starts_with(sentence), "{args:?}: {said}");
    }
    assert_eq!(fs::read_to_string(&landmarks).unwrap(), csv());
}

/// Every command with handles takes landmark files, of one side each or of both, and writes what it
/// writes with the handles in JSON.
#[test]
fn every_command_takes_landmark_files() {
    let scratch = Scratch::new();
    let [image, both, p, q, out] =
        ["image.png", "both.csv", "p.pts", "q.xml", "out"].map(|name| scratch.path(name));
    fs::write(&image, photo(60, 40)).unwrap();
    fs::write(&both, csv()).unwrap();
    // In the conventions of ibug, from 1, and of dlib, from 0.
    let rows: String = P
        .iter()
        .map(|[x, y]| format!("{} {}\n", x + 0.5, y + 0.5))
        .collect();
    fs::write(&p, format!("version: 1\nn_points: 6\n{{\n{rows}}}\n")).unwrap();
    let parts = Q
        .iter()
        .enumerate()
        .map(|(k, [x, y])| format!("<part name='{k}' x='{}' y='{}'/>", x - 0.5, y - 0.5));
    fs::write(
        &q,
        format!(
            "<dataset><images><image file='a'><box>{}</box></image></images></dataset>",
            parts.collect::<String>()
        ),
    )
    .unwrap();
    let extent = ["--extent", "60,40"];
    for (args, name, fields) in [
        (
            &["points", "-", extent[0], extent[1]][..],
            "a.json",
            json!({"points": [[3, 4]]}),
        ),
        (
            &["map", "-", extent[0], extent[1]],
            "a.npy",
            json!({"direction": "forward"}),
        ),
        (
            &["report", "-", extent[0], extent[1]],
            "a.json",
            json!({"method": "tps"}),
        ),
        (&["fit", "-", extent[0], extent[1]], "b.json", json!({})),
        (
            &["warp", &*image, "-"],
            "a.png",
            json!({"strength": 0.5, "align": "rigid"}),
        ),
        (
            &["batch", &*image, "-"],
            "a.zip",
            json!({"steps": 3, "strength": 0.5}),
        ),
        (
            &["batch", &*image, "-"],
            "b.zip",
            json!({"jitter": {"seed": 7, "count": 2, "sigma": 1}}),
        ),
        (
            &["batch", &*image, "-"],
            "c.zip",
            json!({"frames": [{}, {"strength": 0}]}),
        ),
    ] {
        let out = format!("{out}-{name}");
        let written = |handles: &[&str], fields: &Value| {
            done(
                &[args, handles, &["-o", &*out]].concat(),
                &fields.to_string(),
            );
            fs::read(&out).unwrap()
        };
        let mut with_handles = json!({"p": P, "q": Q});
        with_handles
            .as_object_mut()
            .unwrap()
            .extend(fields.as_object().unwrap().clone());
        let expected = written(&[], &with_handles);
        for handles in [
            &["--landmarks", &*both][..],
            &["--landmarks", &*p, "--landmarks-q", &*q],
        ] {
            assert!(
                written(handles, &fields) == expected,
                "{args:?} {handles:?}"
            );
        }
    }
    // The pose of a batch may be in its JSON, if the files have none.
    let batch = ["batch", &*image, "-", "-o", "-", "--landmarks"];
    let expected = done(
        &batch[..5],
        &json!({"p": P, "q": Q, "steps": 3, "strength": 0.5}).to_string(),
    )
    .0;
    let posed = json!({"q": Q, "steps": 3, "strength": 0.5}).to_string();
    assert!(done(&[&batch[..], &[&*p]].concat(), &posed).0 == expected);
    let said = failed(&[&batch[..], &[&*both]].concat(), &posed);
    assert!(
        said.starts_with("bad_value: standard input: both `q` and landmark files are given"),
        "{said}"
    );
    let said = failed(&[&batch[..], &[&*p]].concat(), r#"{"steps": 3}"#);
    assert!(
        said.starts_with(&format!(
            "bad_value: {p}: it has no posed positions: give a file with \
            both sides, or --landmarks-q"
        )),
        "{said}"
    );
}

/// With landmarks, the only file is that of the annotations if it is GeoJSON, or standard input.
#[test]
fn points_maps_the_only_file_beside_landmarks() {
    let scratch = Scratch::new();
    let (landmarks, cells) = (scratch.path("landmarks.csv"), scratch.path("cells.geojson"));
    let feature = json!({"type": "Feature", "properties": {},
        "geometry": {"type": "Point", "coordinates": [30.0, 20.0]}});
    fs::write(&landmarks, csv()).unwrap();
    for (text, pointer) in [
        (json!([feature]), "/0/geometry/coordinates"),
        (feature.clone(), "/geometry/coordinates"),
    ] {
        fs::write(&cells, text.to_string()).unwrap();
        let common = ["points", "--landmarks", &*landmarks, "--extent", "60,40"];
        let (by_name, _) = done(&[&common, &[&*cells][..]].concat(), "");
        let (piped, _) = done(&[&common, &["-"][..]].concat(), &text.to_string());
        assert!(by_name == piped);
        let place = serde_json::from_slice::<Value>(&by_name)
            .unwrap()
            .pointer(pointer)
            .unwrap()
            .clone();
        let [x, y] = [0, 1].map(|axis| place[axis].as_f64().unwrap());
        assert!(
            (x - 31.0).abs() < 1e-9 && (y - 23.0).abs() < 1e-9,
            "{place}"
        );
    }
    let fields = json!({"points": [[30, 20]], "method": "affine"}).to_string();
    let (mapped, _) = done(
        &[
            "points",
            "--landmarks",
            &landmarks,
            "--extent",
            "60,40",
            "-",
        ],
        &fields,
    );
    assert!(String::from_utf8(mapped).unwrap().contains("\"points\""));
}
