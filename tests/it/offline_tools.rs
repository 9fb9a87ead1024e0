//! The subcommands that draw nothing: each writes the bytes that the route of its name answers. And
//! what every subcommand does when its output cannot be written, or the program is interrupted.

use std::io::{Read as _, Write as _};
use std::process::{Command, Stdio};
use std::time::{Duration, Instant};

use serde_json::{Value, json};

use crate::support::picture::png_of;
use crate::support::program::{done, failed, mlswarp, run};
use crate::support::{Scratch, Server, photo};

/// The fields of both objects.
fn merged(one: &Value, other: &Value) -> Value {
    let fields = [one, other]
        .into_iter()
        .flat_map(|object| object.as_object().unwrap().clone());
    Value::Object(fields.collect())
}

async fn answer(server: &Server, path: &str, body: &Value) -> Vec<u8> {
    let response = server.post(path).json(body).send().await.unwrap();
    assert_eq!(response.status(), 200, "{path} {body}");
    response.bytes().await.unwrap().to_vec()
}

#[tokio::test]
async fn points_are_those_that_the_server_answers() {
    let (scratch, server) = (Scratch::new(), Server::start(&[]).await);
    let warp = json!({"p": [[20, 20], [300, 200], [[40, 250], [350, 260]]],
        "q": [[40, 20], [300, 180], [[40, 255], [350, 240]]]});
    let points = json!([[0, 0], [123.25, 45.5], [399, 299]]);
    let forward = json!({"boxes": [[10, 20, 200, 120]], "points": points,
        "polygons": [[[5, 5], [300, 20], [40, 280]]], "geojson": {
        "type": "FeatureCollection",
        "features": [{"type": "Feature", "id": 7, "properties": {"name": "a"},
            "geometry": {"type": "Point", "coordinates": [12, 34]}}],
    }});
    let inverse = json!({"points": [[0, 0], [123.25, 45.5], [1e5, 1e5]], "inverse": true});
    let (warp_file, image) = (scratch.path("warp.json"), scratch.path("image.png"));
    std::fs::write(&warp_file, warp.to_string()).unwrap();
    std::fs::write(&image, photo(400, 300)).unwrap();
    for (name, annotations) in [
        ("forward.json", forward),
        ("inverse.json", inverse),
        ("none.json", json!({})),
    ] {
        let whole = merged(&merged(&warp, &annotations), &json!({"extent": [400, 300]}));
        let expected = answer(&server, "/points", &whole).await;
        let (file, out, whole) = (
            scratch.path(name),
            scratch.path("out.json"),
            whole.to_string(),
        );
        std::fs::write(&file, annotations.to_string()).unwrap();
        for (args, stdin) in [
            (
                &["points", &*warp_file, &*file, "--extent", "400,300"][..],
                "",
            ),
            (
                &["points", &*warp_file, "-", "--image", &*image],
                &*annotations.to_string(),
            ),
            (
                &["points", "-", &*file, "--image", &*image],
                &*warp.to_string(),
            ),
            (&["points", "-"], &*whole),
        ] {
            let far = if name == "inverse.json" {
                "annotations_outside_picture\n"
            } else {
                ""
            };
            assert!(
                done(args, stdin) == (expected.clone(), far.to_owned()),
                "{name}: {args:?}"
            );
        }
        assert!(done(&["points", "-", "-o", &out], &whole).0.is_empty());
        assert!(std::fs::read(out).unwrap() == expected, "{name}");
    }
    // The size of a file on standard input; the handles of landmark files; the method and the
    // warnings that a server sends in headers.
    let mut child = mlswarp(&["points", &warp_file, "--image", "-"])
        .stdin(Stdio::piped())
        .stdout(Stdio::piped())
        .spawn()
        .unwrap();
    child
        .stdin
        .take()
        .unwrap()
        .write_all(&photo(400, 300))
        .unwrap();
    assert_eq!(child.wait_with_output().unwrap().stdout, b"{}");
    let landmarks = scratch.path("landmarks.csv");
    std::fs::write(
        &landmarks,
        "px,py,qx,qy\n20,20,40,20\n300,200,300,180\n150,20,152,21\n50,220,50,222\n",
    )
    .unwrap();
    let handles = json!({"p": [[20, 20], [300, 200], [150, 20], [50, 220]],
        "q": [[40, 20], [300, 180], [152, 21], [50, 222]]});
    let rest = json!({"method": "auto", "extent": [400, 300], "points": points});
    let expected = answer(&server, "/points", &merged(&handles, &rest)).await;
    let (stdout, said) = done(
        &["points", "-", "--landmarks", &landmarks],
        &rest.to_string(),
    );
    assert!(stdout == expected && said.starts_with("method "), "{said}");
    let (_, said) = done(
        &["points", "-"],
        r#"{"p": [[0.1, 0.2]], "q": [[0.2, 0.2]], "extent": [40, 30]}"#,
    );
    assert_eq!(said, "translation_only, looks_normalized\n");
}

/// A file of features is read as what it is, and written as such.
#[tokio::test]
async fn geojson_files_are_mapped_into_geojson_files() {
    let (scratch, server) = (Scratch::new(), Server::start(&[]).await);
    let warp = json!({"p": [[20, 20], [300, 200]], "q": [[40, 20], [300, 180]]});
    let feature = json!({"type": "Feature", "properties": {"a": 1},
        "geometry": {"type": "Point", "coordinates": [10, 10, 3]}});
    let cells: Vec<Value> = (0..20_000).map(|k| with_id(&feature, k)).collect();
    let (warp_file, file, out) = (
        scratch.path("warp.json"),
        scratch.path("cells.geojson"),
        scratch.path("out.geojson"),
    );
    std::fs::write(&warp_file, warp.to_string()).unwrap();
    for geojson in [
        json!({"type": "FeatureCollection", "features": [feature]}),
        json!([feature]),
        feature.clone(),
        feature["geometry"].clone(),
        json!({"features": cells, "type": "FeatureCollection"}),
    ] {
        std::fs::write(&file, format!(" {geojson}\n")).unwrap();
        for inverse in [false, true] {
            let whole = json!({"extent": [400, 300], "geojson": geojson, "inverse": inverse});
            let expected = answer(&server, "/points", &merged(&warp, &whole)).await;
            let expected = std::str::from_utf8(&expected)
                .unwrap()
                .strip_prefix("{\"geojson\":")
                .unwrap()
                .strip_suffix('}')
                .unwrap();
            let flags = if inverse { &["--inverse"][..] } else { &[] };
            let args = [
                &[
                    "points",
                    &*warp_file,
                    &*file,
                    "--extent",
                    "400,300",
                    "-o",
                    &*out,
                ],
                flags,
            ]
            .concat();
            assert_eq!(done(&args, ""), (Vec::new(), String::new()));
            assert!(
                std::fs::read_to_string(&out).unwrap() == expected,
                "{args:?}"
            );
        }
    }
    let stdout = done(
        &["points", &warp_file, "-", "--extent", "400,300"],
        &feature.to_string(),
    )
    .0;
    assert!(
        stdout.starts_with(b"{\"") && stdout.ends_with(b"}"),
        "{stdout:?}"
    );
    // Beside other annotations it is one of the fields.
    std::fs::write(
        &warp_file,
        merged(&warp, &json!({"points": [[1, 2]]})).to_string(),
    )
    .unwrap();
    let stdout = done(
        &["points", &warp_file, "-", "--extent", "400,300"],
        &feature.to_string(),
    )
    .0;
    let both: Value = serde_json::from_slice(&stdout).unwrap();
    assert!(
        both["points"].is_array() && both["geojson"]["type"] == "Feature",
        "{both}"
    );
}

fn with_id(feature: &Value, id: usize) -> Value {
    merged(feature, &json!({"id": id}))
}

#[tokio::test]
async fn reports_are_those_that_the_server_answers() {
    let server = Server::start(&[]).await;
    // Handles that cross fold the picture, and turn it in a place by no certain angle.
    let crossing = json!({"p": [[20, 20], [300, 200], [200, 20]],
        "q": [[220, 20], [300, 180], [52, 21]], "extent": [400, 300]});
    let few = json!({"p": [[20, 20]], "q": [[25, 20]], "extent": [400, 300],
        "output": {"canvas": "fit"}});
    for (body, warnings) in [
        (crossing, "rotation_undefined, tolerance_exceeded\n"),
        (few, "translation_only\n"),
    ] {
        let expected = answer(&server, "/report", &body).await;
        let (stdout, said) = done(&["report", "-"], &body.to_string());
        assert!(stdout == expected && said == warnings, "{said}");
    }
    let said = failed(&["report", "-"], r#"{"p": [[1, 1]], "extent": [4, 3]}"#);
    assert!(said.starts_with("bad_value: `q` is missing"), "{said}");
}

#[tokio::test]
async fn maps_are_the_files_that_the_server_answers() {
    let (scratch, server) = (Scratch::new(), Server::start(&[]).await);
    let warp =
        json!({"p": [[20, 20], [300, 200], [150, 20]], "q": [[40, 20], [300, 180], [152, 21]]});
    let (warp_file, image) = (scratch.path("warp.json"), scratch.path("image.png"));
    std::fs::write(&warp_file, warp.to_string()).unwrap();
    std::fs::write(&image, photo(400, 300)).unwrap();
    for (direction, extension, media_type) in [
        ("inverse", "npy", "application/x-npy"),
        ("forward", "npy", "application/x-npy"),
        ("inverse", "tif", "image/tiff"),
    ] {
        let body = merged(
            &warp,
            &json!({"extent": [400, 300], "direction": direction}),
        );
        let response = server
            .post("/map")
            .header("Accept", media_type)
            .json(&body)
            .send()
            .await
            .unwrap();
        assert_eq!(response.status(), 200);
        let expected = response.bytes().await.unwrap();
        let out = scratch.path(&format!("out.{extension}"));
        let (stdout, said) = done(
            &[
                "map",
                &warp_file,
                "--image",
                &image,
                "--direction",
                direction,
                "-o",
                &out,
            ],
            "",
        );
        assert!(
            stdout.is_empty() && said.is_empty() && std::fs::read(&out).unwrap() == expected,
            "{direction} {extension}"
        );
        if extension == "npy" {
            assert!(
                done(&["map", "-", "-o", "-"], &body.to_string()).0 == expected,
                "{direction}"
            );
        }
    }
    let size = ["--extent", "40,30", "-o"];
    let (outside, directory) = (scratch.path("out.png"), scratch.path("missing/out.npy"));
    for (args, stdin, sentence) in [
        (
            &["map", "-", size[0], size[1], size[2], &outside][..],
            "{}",
            "unsupported_format: cannot write ",
        ),
        (
            &["map", "-", size[0], size[1], size[2], &directory],
            "{}",
            "error: cannot write ",
        ),
        (
            &[
                "map",
                "-",
                size[0],
                size[1],
                size[2],
                "-",
                "--direction",
                "back",
            ],
            "{}",
            "bad_value: ",
        ),
        (
            &["map", "-", size[2], "-"],
            "{}",
            "error: the size of the image is missing",
        ),
        (
            &["map", "-", "--extent", "20000,30", size[2], "-"],
            "{}",
            "too_large: ",
        ),
    ] {
        let said = failed(args, stdin);
        assert!(said.starts_with(sentence), "{args:?}: {said}");
    }
}

#[tokio::test]
async fn batches_are_the_files_that_the_server_answers() {
    let (scratch, server) = (Scratch::new(), Server::start(&[]).await);
    let warp =
        json!({"p": [[10, 10], [70, 50]], "q": [[14, 10], [66, 41]], "method": "similarity"});
    let batch = json!({"steps": 5, "easing": "ease-in-out", "output": {"format": "jpeg"}});
    let jitter = json!({"jitter": {"seed": 7, "count": 3, "sigma": 2}, "points": [[1, 2]]});
    let picture = photo(80, 60);
    let id = server
        .session(&picture, &json!({"p": warp["p"], "method": "similarity"}))
        .await;
    let expected = async |batch: &Value, media_type: &str| {
        let body = merged(&json!({"q": warp["q"]}), batch);
        let response = server
            .post(&format!("/sessions/{id}/batch"))
            .header("Accept", media_type)
            .json(&body)
            .send()
            .await
            .unwrap();
        assert_eq!(response.status(), 200);
        response.bytes().await.unwrap().to_vec()
    };
    let path = |name: &str| scratch.path(name);
    let (image, handles, file) = (path("image.png"), path("warp.json"), path("batch.json"));
    std::fs::write(&image, &picture).unwrap();
    std::fs::write(&handles, warp.to_string()).unwrap();
    for batch in [&batch, &jitter] {
        let archive = expected(batch, "application/zip").await;
        let frames = if *batch == jitter { 3 } else { 5 };
        std::fs::write(&file, batch.to_string()).unwrap();
        let (stdout, said) = done(
            &["batch", &image, &handles, &file, "-o", &path("out.zip")],
            "",
        );
        assert!(stdout.is_empty() && std::fs::read(path("out.zip")).unwrap() == archive);
        assert_eq!(said, format!("{frames} frames\n"));
        assert!(
            done(
                &["batch", &image, &handles, "-", "-o", "-"],
                &batch.to_string()
            )
            .0 == archive
        );
        assert!(
            done(
                &["batch", &image, "-", "-o", "-"],
                &merged(&warp, batch).to_string()
            )
            .0 == archive,
            "one object with all fields"
        );
        let directory = path(&format!("directory-{frames}"));
        done(&["batch", &image, &handles, &file, "-o", &directory], "");
        let mut entries = zip::ZipArchive::new(std::io::Cursor::new(archive)).unwrap();
        assert_eq!(
            std::fs::read_dir(&directory).unwrap().count(),
            entries.len()
        );
        for k in 0..entries.len() {
            let (mut entry, mut bytes) = (entries.by_index(k).unwrap(), Vec::new());
            let name = entry.name().unwrap().into_owned();
            entry.read_to_end(&mut bytes).unwrap();
            assert!(
                std::fs::read(std::path::Path::new(&directory).join(&*name)).unwrap() == bytes,
                "{name}"
            );
        }
    }
    let put = server
        .client
        .put(server.url(&format!("/sessions/{id}/layers/mask?kind=labels")))
        .body(png_of_labels())
        .send()
        .await
        .unwrap();
    assert_eq!(put.status(), 201);
    let archive = expected(
        &json!({"steps": 2, "layers": ["mask", "@coverage"]}),
        "application/zip",
    )
    .await;
    std::fs::write(path("mask.png"), png_of_labels()).unwrap();
    let mask = format!("mask={}:labels", path("mask.png"));
    let layers = [
        "batch",
        &image,
        &handles,
        "-",
        "-o",
        "-",
        "--layer",
        &mask,
        "--layer",
        "@coverage",
    ];
    assert!(done(&layers, r#"{"steps": 2}"#).0 == archive, "layers");
    let (directory, stdout) = (path("directory.v2/"), std::path::Path::new("/dev/stdout"));
    done(
        &[&layers[..4], &["-o", &directory]].concat(),
        r#"{"steps": 2}"#,
    );
    assert_eq!(
        std::fs::read_dir(&directory).unwrap().count(),
        3,
        "a name that ends with a slash is that of a directory"
    );
    if stdout.exists() {
        let archive = expected(&json!({"steps": 2}), "application/zip").await;
        assert!(
            done(
                &["batch", &image, &handles, "-", "-o", "/dev/stdout"],
                r#"{"steps": 2}"#
            )
            .0 == archive,
            "a pipe takes the archive"
        );
    }
    let animation = json!({"steps": 4, "delay": 100});
    std::fs::write(&file, animation.to_string()).unwrap();
    for (name, media_type) in [
        ("out.png", "image/apng"),
        ("out.APNG", "image/apng"),
        ("out.gif", "image/gif"),
    ] {
        done(
            &["batch", &image, &handles, &file, "-Q", "-o", &path(name)],
            "",
        );
        assert!(
            std::fs::read(path(name)).unwrap() == expected(&animation, media_type).await,
            "{name}"
        );
    }
    let wide = path("wide.png");
    std::fs::write(&wide, photo(81, 60)).unwrap();
    for (layer, sentence) in [
        ("mask", "error: --layer \"mask\": expected NAME=FILE"),
        ("a/b=mask.png", "error: cannot read the layer "),
        (
            "@coverage=-",
            "error: standard input can be one of the input files only",
        ),
        ("@holes", "error: the layer @holes needs a --region"),
        (
            &*format!("mask={wide}"),
            "bad_value: --layer mask: the file has 81x60 px",
        ),
    ] {
        let said = failed(
            &["batch", &image, &handles, "-", "-o", "-", "--layer", layer],
            r#"{"steps": 2}"#,
        );
        assert!(said.starts_with(sentence), "{layer}: {said}");
    }
    for (stdin, out, sentence) in [
        (r#"{"steps": 0}"#, "out.zip", "bad_value: "),
        (
            r#"{"steps": 4, "stps": 2}"#,
            "out.zip",
            "unknown_field: standard input: ",
        ),
        (
            r#"{"steps": 4, "q": [[1, 1]]}"#,
            "out.zip",
            "standard input replaces `q` of ",
        ),
        (
            r#"{"steps": 4}"#,
            "out.tif",
            "unsupported_format: cannot write ",
        ),
        (r#"{"steps": 4}"#, "missing/out.zip", "error: cannot write "),
        ("{}", "out.zip", "bad_value: the poses are missing"),
    ] {
        let said = failed(&["batch", &image, &handles, "-", "-o", &path(out)], stdin);
        assert!(said.starts_with(sentence), "{stdin} {out}: {said}");
    }
}

#[tokio::test]
async fn labels_and_coverage_are_those_of_layers() {
    let (scratch, server) = (Scratch::new(), Server::start(&[]).await);
    let warp = json!({"p": [[10, 10], [70, 50], [10, 50]], "q": [[14, 10], [66, 41], [9, 52]],
        "output": {"canvas": "fit"}});
    let (picture, labels) = (photo(80, 60), png_of_labels());
    let id = server.session(&picture, &json!({"p": warp["p"]})).await;
    let put = server
        .client
        .put(server.url(&format!("/sessions/{id}/layers/mask?kind=labels")))
        .body(labels.clone())
        .send()
        .await
        .unwrap();
    assert_eq!(put.status(), 201);
    let (warp_file, image, mask, out) = (
        scratch.path("warp.json"),
        scratch.path("image.png"),
        scratch.path("mask.png"),
        scratch.path("out.png"),
    );
    std::fs::write(&warp_file, warp.to_string()).unwrap();
    std::fs::write(&image, picture).unwrap();
    std::fs::write(&mask, labels).unwrap();
    let subjects = [
        ("mask", &mask, "labels"),
        ("@coverage", &image, "coverage"),
        ("@holes", &image, "holes"),
    ];
    for (layer, file, kind) in &subjects[..2] {
        let body = json!({"q": warp["q"], "output": warp["output"], "layer": layer});
        let expected = answer(&server, &format!("/sessions/{id}/warp"), &body).await;
        let (_, said) = done(&["warp", file, &warp_file, "--kind", kind, "-o", &out], "");
        assert!(
            said.contains("canvas") && std::fs::read(&out).unwrap() == expected,
            "{layer}: {said}"
        );
    }
    let region_file = scratch.path("region.png");
    std::fs::write(&region_file, png_of_region()).unwrap();
    let path = format!("/sessions/{id}/layers/region");
    assert_eq!(
        server
            .client
            .put(server.url(&path))
            .body(png_of_region())
            .send()
            .await
            .unwrap()
            .status(),
        201
    );
    let expected = answer(
        &server,
        &format!("/sessions/{id}/warp"),
        &json!({"q": warp["q"], "output": warp["output"]}),
    )
    .await;
    done(
        &[
            "warp",
            &image,
            &warp_file,
            "--region",
            &region_file,
            "-o",
            &out,
        ],
        "",
    );
    assert!(std::fs::read(&out).unwrap() == expected, "a region");
    for (layer, file, kind) in &subjects {
        let body = json!({"q": warp["q"], "output": warp["output"], "layer": layer});
        let expected = answer(&server, &format!("/sessions/{id}/warp"), &body).await;
        done(
            &[
                "warp",
                file,
                &warp_file,
                "--region",
                &region_file,
                "--kind",
                kind,
                "-o",
                &out,
            ],
            "",
        );
        assert!(
            std::fs::read(&out).unwrap() == expected,
            "{layer} of a region"
        );
    }
    let said = failed(
        &["warp", &image, &warp_file, "--kind", "holes", "-o", &out],
        "",
    );
    assert!(
        said.starts_with("error: --kind holes needs a --region"),
        "{said}"
    );
    std::fs::write(&region_file, photo(81, 60)).unwrap();
    let said = failed(
        &[
            "warp",
            &image,
            &warp_file,
            "--region",
            &region_file,
            "-o",
            &out,
        ],
        "",
    );
    assert!(
        said.starts_with("bad_value: ") && said.contains("81x60"),
        "{said}"
    );
    let said = failed(
        &[
            "warp",
            &mask,
            &warp_file,
            "--kind",
            "labels",
            "-o",
            &scratch.path("out.jpg"),
        ],
        "",
    );
    assert!(
        said.starts_with("bad_value: "),
        "a format that would change labels: {said}"
    );
}

/// A mask whose left half moves, with a transition.
fn png_of_region() -> Vec<u8> {
    let samples: Vec<u8> = (0..60 * 80)
        .map(|i| u8::try_from((60 - i % 80).clamp(0, 25) * 10).unwrap())
        .collect();
    png_of(
        80,
        60,
        png::ColorType::Grayscale,
        png::BitDepth::Eight,
        &samples,
    )
}

/// A palette image of three labels.
fn png_of_labels() -> Vec<u8> {
    let labels: Vec<u8> = (0..60 * 80)
        .map(|i| u8::try_from((i % 80 / 20 + i / 80 / 20) % 3).unwrap())
        .collect();
    let mut file = Vec::new();
    let mut encoder = png::Encoder::new(&mut file, 80, 60);
    encoder.set_color(png::ColorType::Indexed);
    encoder.set_palette(vec![0, 0, 0, 200, 10, 10, 10, 10, 200]);
    encoder
        .write_header()
        .unwrap()
        .write_image_data(&labels)
        .unwrap();
    file
}

#[test]
fn points_name_what_is_wrong() {
    let scratch = Scratch::new();
    let (annotations, landmarks) = (
        scratch.path("annotations.json"),
        scratch.path("landmarks.csv"),
    );
    std::fs::write(&annotations, r#"{"points": [[1, 2]]}"#).unwrap();
    std::fs::write(&landmarks, "px,py,qx,qy\n1,2,3,4\n").unwrap();
    let extent = ["--extent", "40,30"];
    for (args, stdin, sentence) in [
        (
            &["-"][..],
            "{}",
            "error: the size of the image is missing; give --extent",
        ),
        (
            &["-", extent[0], extent[1]],
            r#"{"p": [[1, 1]], "q": [[2, 2]], "point": []}"#,
            "unknown_field: standard input: unknown field: `point`",
        ),
        (
            &["-", extent[0], extent[1]],
            r#"{"points": [], "points": []}"#,
            "malformed_request: standard input: the field `points` is given twice",
        ),
        (
            &["-", extent[0], extent[1]],
            r#"{"points": [[1, 2], [3]]}"#,
            "bad_value: ",
        ),
        (
            &["-", extent[0], extent[1]],
            r#"{"p": [[1, 1]]}"#,
            "bad_value: `q` is missing",
        ),
        (
            &["-", "--landmarks", &landmarks, extent[0], extent[1]],
            r#"{"p": [[1, 1]]}"#,
            "bad_value: standard input: both `p` and landmark files",
        ),
        (
            &["-", "--extent", "40"],
            "{}",
            "bad_value: `--extent` must be the width and height",
        ),
        (
            &["-", "--image", &annotations],
            "{}",
            "unsupported_format: ",
        ),
        (
            &["-", "-", extent[0], extent[1]],
            "{}",
            "error: standard input can be one of the input files only",
        ),
        (
            &["-", "--image", "-"],
            "{}",
            "error: standard input can be one of the input files only",
        ),
        (
            &["missing.json", extent[0], extent[1]],
            "",
            "error: cannot read the warp object ",
        ),
        (
            &["-", "missing.json", extent[0], extent[1]],
            "{}",
            "error: cannot read the annotations ",
        ),
        (
            &["-", extent[0], extent[1], "-o", "missing/out.json"],
            "{}",
            "error: cannot write ",
        ),
        (
            &["-", extent[0], extent[1], "--max-warp-json-bytes", "1"],
            "{}",
            "too_large: standard input: the warp object is larger than 1 bytes; \
                --max-warp-json-bytes raises the limit",
        ),
        (
            &[
                "-",
                &annotations,
                extent[0],
                extent[1],
                "--max-body-bytes",
                "1",
            ],
            "{}",
            &*format!(
                "too_large: {annotations}: the annotations are larger than 1 bytes; \
                    --max-body-bytes raises the limit"
            ),
        ),
    ] {
        let said = failed(&[&["points"], args].concat(), stdin);
        assert!(said.starts_with(sentence), "{args:?}: {said}");
    }
    let both = run(
        &["points", "-", "--extent", "40,30", "--image", "a.png"],
        "{}",
    );
    assert_eq!(both.status.code(), Some(2), "one size only: {both:?}");
}

#[test]
fn a_reader_that_leaves_is_a_failure_and_no_panic() {
    let scratch = Scratch::new();
    let (warp, image) = (scratch.path("warp.json"), scratch.path("image.png"));
    let places: Vec<[u32; 2]> = (0..50_000).map(|i| [i % 400, i % 300]).collect();
    std::fs::write(
        &warp,
        json!({"p": [[9, 9]], "q": [[19, 9]], "extent": [400, 300], "points": places}).to_string(),
    )
    .unwrap();
    std::fs::write(&image, photo(1200, 900)).unwrap();
    let handles = scratch.path("handles.json");
    std::fs::write(&handles, r#"{"p": [[9, 9]], "q": [[19, 9]]}"#).unwrap();
    for args in [
        &["points", &*warp][..],
        &["warp", &*image, &*handles, "-o", "-"],
    ] {
        let mut child = mlswarp(args)
            .stdout(Stdio::piped())
            .stderr(Stdio::piped())
            .spawn()
            .unwrap();
        let mut first = [0; 4];
        let mut stdout = child.stdout.take().unwrap();
        stdout.read_exact(&mut first).unwrap();
        drop(stdout);
        let output = child.wait_with_output().unwrap();
        let said = String::from_utf8(output.stderr).unwrap();
        assert!(
            output.status.code() == Some(1)
                && said.starts_with("error: cannot write standard output: ")
                && said.lines().count() == 1,
            "{said}"
        );
    }
}

#[cfg(unix)]
#[test]
fn an_interrupted_program_leaves_no_incomplete_file() {
    let scratch = Scratch::new();
    let (image, warp, out) = (
        scratch.path("image.png"),
        scratch.path("warp.json"),
        scratch.path("out/out.png"),
    );
    let directory = std::path::Path::new(&out).parent().unwrap();
    std::fs::create_dir(directory).unwrap();
    std::fs::write(&image, photo(3000, 3000)).unwrap();
    std::fs::write(
        &warp,
        r#"{"p": [[9, 9]], "q": [[19, 9]], "output": {"compression": "best", "width": 7000}}"#,
    )
    .unwrap();
    let files = || std::fs::read_dir(directory).unwrap().count();
    for signal in ["-INT", "-TERM"] {
        let mut child = mlswarp(&["warp", &image, &warp, "-o", &out])
            .stderr(Stdio::null())
            .spawn()
            .unwrap();
        let began = Instant::now();
        while files() == 0 {
            assert!(
                began.elapsed() < Duration::from_secs(60) && child.try_wait().unwrap().is_none(),
                "no file is begun"
            );
            std::thread::sleep(Duration::from_millis(2));
        }
        assert!(
            Command::new("kill")
                .args([signal, &child.id().to_string()])
                .status()
                .unwrap()
                .success()
        );
        assert_eq!(child.wait().unwrap().code(), Some(130), "{signal}");
        assert_eq!(files(), 0, "{signal}");
    }
}
