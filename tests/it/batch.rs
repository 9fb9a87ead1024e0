//! Batches: what is in the file, that its frames are the single requests', and that no more is made
//! than a reader takes. Work is counted, not timed.

use std::io::{Cursor, Read as _};

use mlswarp_server::limits::memory::MemoryClass;
use mlswarp_server::pool::{Load, WorkClass};
use reqwest::Response;
use serde_json::{Value, json};
use tokio::io::{AsyncReadExt as _, AsyncWriteExt as _};
use tokio::net::{TcpSocket, TcpStream};

use crate::support::counters::Counted as _;
use crate::support::picture::{decoded, png as png_file};
use crate::support::server::{header, png, problem};
use crate::support::{Server, eventually, photo};

/// The files of an archive.
type Files = std::collections::BTreeMap<String, Vec<u8>>;

async fn post(server: &Server, id: &str, body: &Value) -> Response {
    server
        .post(&format!("/sessions/{id}/batch"))
        .json(body)
        .send()
        .await
        .unwrap()
}

async fn animation(server: &Server, id: &str, body: &Value) -> Response {
    server
        .post(&format!("/sessions/{id}/batch"))
        .header("Accept", "image/apng")
        .json(body)
        .send()
        .await
        .unwrap()
}

/// The archive of a batch that must succeed, as an independent reader finds it; its index is
/// checked against its entries.
pub(crate) async fn zip(response: Response) -> (Files, Value) {
    assert_eq!(response.status(), 200, "{:?}", response.text().await);
    assert_eq!(header(&response, "content-type"), "application/zip");
    let frames: usize = header(&response, "warp-frames").parse().unwrap();
    let bytes = response.bytes().await.unwrap();
    let mut archive = zip::ZipArchive::new(Cursor::new(&bytes)).unwrap();
    let files: Files = (0..archive.len())
        .map(|k| {
            let mut entry = archive.by_index(k).unwrap();
            let mut bytes = Vec::new();
            entry.read_to_end(&mut bytes).unwrap();
            (entry.name().unwrap().into_owned(), bytes)
        })
        .collect();
    let index: Value = serde_json::from_slice(&files["frames.json"]).unwrap();
    let listed = index["frames"].as_array().unwrap();
    assert_eq!(listed.len(), frames);
    let layers = listed
        .iter()
        .filter_map(|frame| frame["layers"].as_object())
        .flat_map(|layers| layers.values());
    let named = listed
        .iter()
        .flat_map(|frame| [&frame["picture"], &frame["annotations"]])
        .chain(layers)
        .filter_map(Value::as_str);
    assert_eq!(
        named
            .chain(["frames.json"])
            .collect::<std::collections::BTreeSet<_>>(),
        files.keys().map(String::as_str).collect()
    );
    (files, index)
}

fn rest() -> Value {
    json!({"p": [[20, 20], [60, 40], [[10, 50], [70, 52]]], "output": {"outside": "edge"}})
}

fn q(k: i64) -> Value {
    json!([[20 + k, 22], [60, 40 - k], [[10, 50 + k], [70, 52]]])
}

#[tokio::test]
async fn frames_are_the_pictures_of_single_requests() {
    let server = Server::start(&["--workers", "2"]).await;
    let id = server.session(&photo(120, 80), &rest()).await;
    let frames: Vec<Value> = (0..9)
        .map(|k| json!({"q": q(k), "strength": 1.0 - 0.25 * (k % 3) as f64}))
        .collect();
    for output in [
        json!({}),
        json!({"format": "jpeg", "width": 60}),
        json!({"canvas": "fit", "filter": "bicubic"}),
        json!({"format": "webp"}),
    ] {
        let (files, index) =
            zip(post(&server, &id, &json!({"frames": frames, "output": output})).await).await;
        assert_eq!(files.len(), frames.len() + 1);
        for (frame, listed) in frames.iter().zip(index["frames"].as_array().unwrap()) {
            let mut single = frame.clone();
            single["output"] = output.clone();
            let single = server.drag(&id, &single).await;
            assert_eq!(single.status(), 200);
            assert_eq!(listed["folds"].to_string(), header(&single, "warp-folds"));
            let residual = listed["residual"].as_f64().unwrap();
            assert_eq!(format!("{residual:.4}"), header(&single, "warp-residual"));
            assert_eq!(listed["strength"], frame["strength"]);
            let canvas = ["x", "y", "width", "height"]
                .map(|name| listed["canvas"][name].to_string())
                .join(",");
            let told = single
                .headers()
                .get("warp-canvas")
                .map_or("0,0,120,80", |text| text.to_str().unwrap());
            assert_eq!(canvas, told);
            assert!(
                files[listed["picture"].as_str().unwrap()] == single.bytes().await.unwrap(),
                "{output} {listed}"
            );
        }
    }
}

#[tokio::test]
async fn in_betweens_go_from_rest_to_the_pose() {
    let server = Server::start(&["--workers", "2"]).await;
    let id = server.session(&photo(120, 80), &rest()).await;
    let body = |easing: &str| json!({"q": q(5), "steps": 5, "easing": easing, "strength": 2});
    let (linear, index) = zip(post(&server, &id, &body("linear")).await).await;
    let (eased, _) = zip(post(&server, &id, &body("ease-in-out")).await).await;
    for (k, t) in [0.0, 0.25, 0.5, 0.75, 1.0].into_iter().enumerate() {
        let name = format!("{k:04}.png");
        assert_eq!(
            (&index["frames"][k]["t"], &index["frames"][k]["strength"]),
            (&json!(t), &json!(2.0 * t))
        );
        let single = |strength: f64| {
            server
                .post(&format!("/sessions/{id}/warp"))
                .json(&json!({"q": q(5), "strength": 2.0 * strength}))
        };
        assert!(
            linear[&name] == png(single(t).send().await.unwrap()).await,
            "{name}"
        );
        assert!(
            eased[&name] == png(single(t * t * (3.0 - 2.0 * t)).send().await.unwrap()).await,
            "{name}"
        );
    }
    assert!(
        decoded(&linear["0000.png"]).samples == decoded(&photo(120, 80)).samples,
        "the first is the source"
    );
    for (wrong, pointer, sentence) in [
        (
            json!({"q": q(5), "steps": 1}),
            "/steps",
            "at least 2: the first at rest, the last at `q`; found 1",
        ),
        (
            json!({"q": q(5), "frames": 24}),
            "/frames",
            "found a number; did you mean `steps`: 24?",
        ),
        (json!({"steps": 2}), "/q", "`q` is missing"),
        (
            json!({"frames": [{"q": q(1)}, {}]}),
            "/frames/1/q",
            "`q` is missing",
        ),
    ] {
        let told = problem(post(&server, &id, &wrong).await, 422, "bad_value").await;
        assert!(
            told["pointer"] == pointer && told["detail"].as_str().unwrap().contains(sentence),
            "{told}"
        );
    }
}

#[tokio::test]
async fn the_way_back_has_the_frames_of_the_way_there() {
    let server = Server::start(&["--workers", "2"]).await;
    let id = server.session(&photo(120, 80), &rest()).await;
    let own = json!({"frames": [{"q": q(1)}, {"q": q(2)}, {"q": q(5)}], "points": [[3, 4]]});
    for there in [
        json!({"q": q(5), "steps": 4, "strength": 1.5, "points": [[3, 4]]}),
        own,
    ] {
        let mut both = there.clone();
        both["and_back"] = json!(true);
        let (there, there_index) = zip(post(&server, &id, &there).await).await;
        let (both, index) = zip(post(&server, &id, &both).await).await;
        let count = there_index["frames"].as_array().unwrap().len();
        assert_eq!(index["frames"].as_array().unwrap().len(), 2 * count - 2);
        for k in 0..2 * count - 2 {
            let from = if k < count { k } else { 2 * count - 2 - k };
            for extension in ["png", "json"] {
                assert!(
                    both[&format!("{k:04}.{extension}")]
                        == there[&format!("{from:04}.{extension}")],
                    "{k} is {from}"
                );
            }
            for name in ["t", "strength", "residual"] {
                assert_eq!(index["frames"][k][name], there_index["frames"][from][name]);
            }
        }
    }
    for (fields, count, plays) in [
        (json!({}), 4, 0),
        (json!({"and_back": true}), 6, 0),
        (json!({"and_back": true, "loop": 3}), 7, 3),
    ] {
        let mut body = json!({"q": q(5), "steps": 4});
        body.as_object_mut()
            .unwrap()
            .extend(fields.as_object().unwrap().clone());
        let (info, frames) = frames(animation(&server, &id, &body).await).await;
        assert_eq!(
            (frames.len(), info.animation_control.unwrap().num_plays),
            (count, plays),
            "{body}"
        );
        // What ends shows the handles at rest at its end.
        assert_eq!(frames.first() == frames.last(), plays > 0, "{body}");
    }
    let told = problem(
        post(&server, &id, &json!({"q": q(5), "steps": 4, "loop": 1})).await,
        422,
        "bad_value",
    )
    .await;
    assert_eq!(told["pointer"], "/loop");
}

#[tokio::test]
async fn a_jitter_needs_neither_a_pose_nor_handles() {
    let server = Server::start(&[]).await;
    let (picture, jitter) = (
        photo(120, 80),
        json!({"jitter": {"seed": 5, "count": 3, "sigma": 4}, "boxes": [[9, 9, 30, 30]]}),
    );
    let with = |q: Value| {
        let mut body = jitter.clone();
        body["q"] = q;
        body
    };
    let bytes = async |id: &str, body: &Value| {
        let response = post(&server, id, body).await;
        assert_eq!(response.status(), 200, "{body}");
        response.bytes().await.unwrap()
    };
    let id = server.session(&picture, &rest()).await;
    assert!(
        bytes(&id, &jitter).await == bytes(&id, &with(rest()["p"].clone())).await,
        "around the handles at rest"
    );
    for (units, width, height) in [("px", 120.0, 80.0), ("normalized", 1.0, 1.0)] {
        let grid: Vec<[f64; 2]> = (0..25)
            .map(|k| {
                [
                    width * f64::from(k % 5) / 4.0,
                    height * f64::from(k / 5) / 4.0,
                ]
            })
            .collect();
        let grid = json!({"p": grid, "method": "similarity", "units": units});
        let none = server
            .session(
                &picture,
                &json!({"p": [], "method": "similarity", "units": units}),
            )
            .await;
        let of_grid = server.session(&picture, &grid).await;
        let body = if units == "px" {
            jitter.clone()
        } else {
            json!({"jitter": jitter["jitter"], "points": [[0.5, 0.5]]})
        };
        let found = bytes(&none, &body).await;
        assert!(
            found == bytes(&of_grid, &body).await,
            "{units}: by a grid of 5 x 5 handles"
        );
        let mut posed = body.clone();
        posed["q"] = json!([]);
        assert!(found == bytes(&none, &posed).await);
    }
    let none = server.session(&picture, &json!({})).await;
    assert_eq!(
        problem(
            post(&server, &none, &with(json!([[1, 1]]))).await,
            422,
            "shape_mismatch"
        )
        .await["pointer"],
        "/q"
    );
    // In-betweens of nothing show the picture.
    let (files, _) = zip(post(&server, &none, &json!({"steps": 2})).await).await;
    assert!(decoded(&files["0001.png"]).samples == decoded(&picture).samples);
}

#[tokio::test]
async fn a_seed_gives_the_same_bytes_and_its_poses_are_told() {
    let (one, other) = (
        Server::start(&["--workers", "1"]).await,
        Server::start(&["--workers", "4"]).await,
    );
    let body = |seed: u32, count: u32| {
        json!({"q": q(0), "jitter": {"seed": seed, "count": count, "sigma": 2},
            "points": [[30, 30]]})
    };
    let mut files = Vec::new();
    for server in [&one, &other] {
        let id = server.session(&photo(120, 80), &rest()).await;
        let bytes = async |body| post(server, &id, &body).await.bytes().await.unwrap();
        let first = bytes(body(7, 12)).await;
        assert!(first == bytes(body(7, 12)).await);
        assert!(first != bytes(body(8, 12)).await);
        files.push(first);
        let (archive, index) = zip(post(server, &id, &body(7, 12)).await).await;
        let (few, _) = zip(post(server, &id, &body(7, 3)).await).await;
        for k in 0..12 {
            assert_eq!(index["frames"][k]["jitter"], json!({"seed": 7, "frame": k}));
            let annotations: Value =
                serde_json::from_slice(&archive[&format!("{k:04}.json")]).unwrap();
            let single = json!({"q": annotations["q"]});
            assert!(
                archive[&format!("{k:04}.png")] == png(server.drag(&id, &single).await).await,
                "frame {k}"
            );
            if k < 3 {
                assert!(
                    few[&format!("{k:04}.png")] == archive[&format!("{k:04}.png")],
                    "frame {k} depends on the seed and k alone"
                );
            }
        }
    }
    assert!(files[0] == files[1], "also with other threads");
}

#[tokio::test]
async fn annotations_are_those_of_points() {
    let server = Server::start(&[]).await;
    let id = server.session(&photo(120, 80), &rest()).await;
    let feature = json!({"type": "Feature", "id": 3, "properties": {"a": [1]},
        "geometry": {"type": "LineString", "coordinates": [[1, 2], [90, 70]]}});
    let annotations = json!({
        "boxes": [[10, 10, 50, 60]], "points": [[1, 1], [60.5, 33]],
            "polygons": [[[5, 5], [60, 6], [30, 70]]],
        "geojson": {"type": "FeatureCollection", "features": [feature]}, "refine": true
    });
    let with = |mut body: Value| {
        body.as_object_mut()
            .unwrap()
            .extend(annotations.as_object().unwrap().clone());
        body
    };
    let frames: Vec<Value> = (0..4).map(|k| json!({"q": q(3 * k)})).collect();
    let (files, _) = zip(post(&server, &id, &with(json!({"frames": frames}))).await).await;
    for (k, frame) in frames.iter().enumerate() {
        let mapped = server
            .post(&format!("/sessions/{id}/points"))
            .json(&with(frame.clone()))
            .send()
            .await
            .unwrap();
        assert!(
            files[&format!("{k:04}.json")] == mapped.bytes().await.unwrap(),
            "frame {k}"
        );
    }
}

#[tokio::test]
async fn layers_are_those_of_single_requests() {
    let server = Server::start(&[]).await;
    let id = server.session(&photo(120, 80), &rest()).await;
    let labels: Vec<u8> = (0..120 * 80)
        .map(|k: u32| (k % 120 / 30) as u8 * 50)
        .collect();
    let put = async |name: &str, file: Vec<u8>| {
        let response = server
            .client
            .put(server.url(&format!("/sessions/{id}/layers/{name}")))
            .body(file)
            .send()
            .await
            .unwrap();
        assert_eq!(response.status(), 201, "{:?}", response.text().await);
    };
    put(
        "mask?kind=labels",
        png_file(120, 80, png::ColorType::Grayscale, &labels),
    )
    .await;
    put("depth", photo(120, 80)).await;
    let names = ["mask", "@coverage", "depth"];
    for format in ["png", "tiff", "jpeg"] {
        let body = json!({"frames": [{"q": q(0)}, {"q": q(9)}], "layers": names,
            "output": {"format": format}});
        let (files, index) = zip(post(&server, &id, &body).await).await;
        assert_eq!(files.len(), 2 * 4 + 1);
        for (k, place) in [0, 9].into_iter().enumerate() {
            for name in names {
                // Labels and coverage are never JPEG.
                let format = if format == "jpeg" && name != "depth" {
                    "png"
                } else {
                    format
                };
                let single = server
                    .drag(
                        &id,
                        &json!({"q": q(place), "layer": name, "output": {"format": format}}),
                    )
                    .await;
                assert_eq!(single.status(), 200, "{name} {format}");
                let file = index["frames"][k]["layers"][name].as_str().unwrap();
                assert!(file.starts_with(&format!("{k:04}.{name}.")), "{file}");
                assert!(files[file] == single.bytes().await.unwrap(), "{file}");
            }
        }
    }
    let body = json!({"q": q(1), "steps": 2, "layers": ["@coverage"]});
    assert_eq!(
        problem(animation(&server, &id, &body).await, 422, "bad_value").await["pointer"],
        "/layers"
    );
}

/// Either all pictures have alpha or none has, whether or not each of them is covered.
#[tokio::test]
async fn alpha_is_decided_once_for_all_frames() {
    let server = Server::start(&[]).await;
    let source = photo(120, 80);
    let id = server
        .session(
            &source,
            &json!({"p": [[0, 0], [120, 0], [0, 80], [120, 80]], "method": "affine"}),
        )
        .await;
    let corners = |d: i32| json!([[-d, -d], [120 + d, -d], [-d, 80 + d], [120 + d, 80 + d]]);
    let colours = async |body: Value| -> Vec<png::ColorType> {
        let (files, _) = zip(post(&server, &id, &body).await).await;
        files
            .iter()
            .filter(|(name, _)| name.ends_with(".png"))
            .map(|(_, file)| decoded(file).color)
            .collect()
    };
    assert_eq!(
        colours(json!({"q": corners(9), "steps": 3})).await,
        [png::ColorType::Rgb; 3],
        "every frame is covered"
    );
    assert_eq!(
        colours(json!({"q": corners(-9), "steps": 3})).await,
        [png::ColorType::Rgba; 3]
    );
    let mixed = json!({"frames": [{"q": corners(9)}, {"q": corners(-9)}, {"q": corners(0)}]});
    assert_eq!(colours(mixed.clone()).await, [png::ColorType::Rgba; 3]);
    let opaque = json!({"frames": mixed["frames"], "output": {"outside": "#ff0000"}});
    assert_eq!(colours(opaque).await, [png::ColorType::Rgb; 3]);
    let (files, _) = zip(post(&server, &id, &mixed).await).await;
    let (shown, rgb) = (decoded(&files["0002.png"]), decoded(&source).samples);
    assert!(
        shown
            .samples
            .chunks(4)
            .zip(rgb.chunks(3))
            .all(|(rgba, rgb)| rgba[..3] == *rgb && rgba[3] == 255)
    );
    assert!(files["0001.png"] == png(server.drag(&id, &mixed["frames"][1]).await).await);
    // A source with alpha needs no decision.
    let samples: Vec<u8> = (0..40 * 30 * 4).map(|k| (k * 7 % 251) as u8).collect();
    let id = server
        .session(
            &png_file(40, 30, png::ColorType::Rgba, &samples),
            &json!({"p": [[5, 5]]}),
        )
        .await;
    let (files, _) = zip(post(&server, &id, &json!({"q": [[6, 5]], "steps": 2})).await).await;
    assert!(decoded(&files["0000.png"]).samples == samples);
}

/// The frames of an animation.
async fn frames(response: Response) -> (png::Info<'static>, Vec<Vec<u8>>) {
    assert_eq!(response.status(), 200, "{:?}", response.text().await);
    assert_eq!(header(&response, "content-type"), "image/apng");
    let count: usize = header(&response, "warp-frames").parse().unwrap();
    let mut reader = png::Decoder::new(Cursor::new(response.bytes().await.unwrap()))
        .read_info()
        .unwrap();
    let frames: Vec<Vec<u8>> = (0..count)
        .map(|_| {
            let mut read = vec![0; reader.output_buffer_size().unwrap()];
            reader.next_frame(&mut read).unwrap();
            read
        })
        .collect();
    assert_eq!(
        reader.info().animation_control.unwrap().num_frames as usize,
        count
    );
    (reader.info().clone(), frames)
}

#[tokio::test]
async fn an_animation_shows_the_pictures_of_the_archive() {
    let server = Server::start(&[]).await;
    let mut rest = rest();
    rest["output"] = json!({"format": "jpeg"});
    let id = server.session(&photo(300, 200), &rest).await;
    let body = json!({"q": q(9), "steps": 7, "output": {"format": "png"}});
    let (archive, _) = zip(post(&server, &id, &body).await).await;
    for (body, delay) in [
        (json!({"q": q(9), "steps": 7}), 40),
        (json!({"q": q(9), "steps": 7, "delay": 125}), 125),
    ] {
        let (info, frames) = frames(animation(&server, &id, &body).await).await;
        let control = info.frame_control.unwrap();
        assert_eq!(
            (
                control.delay_num,
                control.delay_den,
                info.animation_control.unwrap().num_plays
            ),
            (delay, 1000, 0)
        );
        for (k, frame) in frames.iter().enumerate() {
            assert!(
                decoded(&archive[&format!("{k:04}.png")]).samples == *frame,
                "frame {k}"
            );
        }
    }
    // Frames of different boxes show all of them.
    let moved = |d: i32| json!({"q": [[20 + d, 20], [60 + d, 40], [[10 + d, 50], [70 + d, 52]]]});
    let body = json!({"frames": [moved(0), moved(40), moved(-15)],
        "output": {"canvas": "fit", "compression": "best"}});
    let response = animation(&server, &id, &body).await;
    assert_eq!(header(&response, "warp-canvas"), "-15,0,355,200");
    let (info, frames) = frames(response).await;
    assert_eq!(
        (info.width, info.height, info.color_type),
        (355, 200, png::ColorType::Rgba)
    );
    let source = decoded(&photo(300, 200)).samples;
    for (frame, left) in frames.iter().zip([15, 55, 0]) {
        let row = |y: usize| &frame[(y * 355 + left) * 4..(y * 355 + left + 300) * 4];
        assert!((0..200).all(|y| {
            row(y)
                .chunks(4)
                .zip(source[y * 900..].chunks(3))
                .all(|(rgba, rgb)| rgba[..3] == *rgb && rgba[3] == 255)
        }));
        assert_eq!(
            frame.chunks(4).filter(|rgba| rgba[3] == 0).count(),
            55 * 200
        );
    }
}

#[tokio::test]
async fn mistakes_in_any_frame_are_found_before_the_first_byte() {
    let server = Server::start(&[]).await;
    let id = server.session(&photo(120, 80), &rest()).await;
    let wrong = |place: usize, frame: Value| {
        let mut frames = vec![json!({"q": q(1)}); 100];
        frames[place] = frame;
        json!({"frames": frames})
    };
    let told = async |body: &Value, status: u16, code: &str, pointer: &str| {
        let document = problem(post(&server, &id, body).await, status, code).await;
        assert_eq!(document["pointer"], pointer, "{document}");
        document
    };
    told(
        &wrong(57, json!({"q": [[1, 1]]})),
        422,
        "shape_mismatch",
        "/frames/57/q",
    )
    .await;
    told(
        &wrong(57, json!({"q": [[1, 1], [2, 2], [3, 3]]})),
        422,
        "shape_mismatch",
        "/frames/57/q/2",
    )
    .await;
    told(
        &wrong(99, json!({"q": [[1e7, 1], [2, 2], [[3, 3], [4, 4]]]})),
        422,
        "bad_value",
        "/frames/99/q/0",
    )
    .await;
    told(
        &wrong(3, json!({"q": q(1), "strength": 11})),
        422,
        "bad_value",
        "/frames/3/strength",
    )
    .await;
    told(
        &wrong(3, json!({"q": q(1), "speed": 11})),
        422,
        "unknown_field",
        "/frames/3/speed",
    )
    .await;
    told(&wrong(3, json!([[1, 1]])), 422, "bad_value", "/frames/3").await;
    told(
        &json!({"q": q(1), "steps": 3, "layers": ["@coverage", "mask"]}),
        404,
        "no_such_layer",
        "/layers/1",
    )
    .await;
    told(
        &json!({"q": q(1), "steps": 3, "layers": ["mask", "mask"]}),
        422,
        "bad_value",
        "/layers/1",
    )
    .await;
    told(
        &json!({"q": q(1), "steps": 3, "delay": 30}),
        422,
        "bad_value",
        "/delay",
    )
    .await;
    let wide = told(
        &json!({"q": q(1), "steps": 3, "output": {"width": 99_999}}),
        413,
        "too_large",
        "/output/width",
    )
    .await;
    assert!(
        !wide["detail"].as_str().unwrap().contains("frame"),
        "{wide}"
    );
    let far = json!([[900_000, 22], [60, 40], [[10, 50], [70, 52]]]);
    told(
        &json!({"q": far, "jitter": {"seed": 1, "count": 2, "sigma": 10000}}),
        422,
        "bad_value",
        "/jitter/sigma",
    )
    .await;
}

#[tokio::test]
async fn too_many_frames_are_refused_by_their_number() {
    let server = Server::start(&[]).await;
    let id = server.session(&photo(16, 12), &json!({"p": []})).await;
    for count in [10_001_usize, 1_000_000] {
        let body = format!(
            r#"{{"frames": [{}{{"q": []}}]}}"#,
            r#"{"q": []},"#.repeat(count - 1)
        );
        let request = server
            .post(&format!("/sessions/{id}/batch"))
            .header("content-type", "application/json")
            .body(body);
        let document = problem(request.send().await.unwrap(), 413, "too_large").await;
        assert_eq!(
            (
                &document["limit"],
                &document["actual"],
                &document["pointer"]
            ),
            (&json!(10_000), &json!(count), &json!("/frames"))
        );
        assert_eq!(document["limit_name"], "batch_frames");
    }
    for body in [
        json!({"q": [], "steps": 10_001}),
        json!({"q": [], "jitter": {"seed": 1, "count": 4_000_000_000_u32, "sigma": 1}}),
    ] {
        assert_eq!(
            problem(post(&server, &id, &body).await, 413, "too_large").await["limit"],
            10_000
        );
    }
    let (files, _) = zip(post(
        &server,
        &id,
        &json!({"q": [], "steps": 10_000, "output": {"compression": "none"}}),
    )
    .await)
    .await;
    assert_eq!(files.len(), 10_001);
    assert!(files["0000.png"] == files["9999.png"]);
    eventually("nothing is kept", || {
        server.app.budget().taken_for(MemoryClass::Frame) == 0
    })
    .await;
}

#[tokio::test]
async fn refusals_of_a_pose_name_the_frame_and_kinds_of_files_have_their_fields() {
    let server = Server::start(&[]).await;
    let p = json!([[20, 20], [60, 40], [70, 44], [30, 70]]);
    let id = server
        .session(
            &photo(120, 80),
            &json!({"p": p, "method": "tps", "folds": "reject"}),
        )
        .await;
    // Two neighbours change sides.
    let folded = json!({"q": [[20, 20], [90, 54], [40, 30], [30, 70]]});
    problem(server.drag(&id, &folded).await, 422, "folded").await;
    let mut frames = vec![json!({"q": p}); 9];
    frames[5] = folded;
    let refused = problem(
        post(&server, &id, &json!({"frames": frames})).await,
        422,
        "folded",
    )
    .await;
    assert!(
        refused["detail"].as_str().unwrap().starts_with("frame 5: "),
        "{refused}"
    );
    let animated = async |body: Value, status: u16, code: &str| {
        problem(animation(&server, &id, &body).await, status, code).await
    };
    let q = p;
    assert_eq!(
        animated(
            json!({"q": q, "steps": 2, "points": [[1, 1]]}),
            422,
            "bad_value"
        )
        .await["pointer"],
        "/points"
    );
    animated(
        json!({"q": q, "steps": 2, "output": {"format": "jpeg"}}),
        406,
        "not_acceptable",
    )
    .await;
    let request = server
        .post(&format!("/sessions/{id}/batch"))
        .header("Accept", "image/png")
        .json(&json!({"q": q, "steps": 2}));
    problem(request.send().await.unwrap(), 406, "not_acceptable").await;
    problem(
        post(
            &server,
            "00000000-0000-4000-8000-000000000000",
            &json!({"q": q, "steps": 2}),
        )
        .await,
        404,
        "no_such_session",
    )
    .await;
}

/// Pictures of half a megabyte, so that few fit into the buffers between server and client.
const LARGE: (u32, u32) = (480, 360);

fn large_batch() -> Value {
    json!({"q": [[22, 20]], "jitter": {"seed": 1, "count": 5000, "sigma": 1},
        "output": {"compression": "none"}})
}

/// A connection that has asked for a large batch and takes little at a time.
async fn ask(server: &Server, id: &str) -> TcpStream {
    let socket = TcpSocket::new_v4().unwrap();
    socket.set_recv_buffer_size(16 << 10).unwrap();
    let mut stream = socket.connect(server.address).await.unwrap();
    let body = large_batch().to_string();
    let head = format!(
        "POST /sessions/{id}/batch HTTP/1.1\r\nHost: localhost\r\nContent-Type: \
            application/json\r\nContent-Length: {}\r\n\r\n",
        body.len()
    );
    stream
        .write_all(format!("{head}{body}").as_bytes())
        .await
        .unwrap();
    stream
}

fn idle(server: &Server) -> bool {
    matches!(
        server.app.pool().load(WorkClass::Upload),
        Load {
            running: 0,
            waiting: 0,
            ..
        }
    )
}

/// The number of frames that have been begun, when no more are.
async fn begun(server: &Server) -> u64 {
    let mut last = u64::MAX;
    loop {
        let begun = server.app.counters().pictures_begun;
        if begun == last && idle(server) {
            return begun;
        }
        last = begun;
        tokio::time::sleep(std::time::Duration::from_millis(200)).await;
    }
}

#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn a_reader_that_stalls_holds_a_few_frames_and_no_worker_and_is_ended() {
    let server = Server::start(&["--workers", "2", "--write-timeout", "3s"]).await;
    let id = server
        .session(&photo(LARGE.0, LARGE.1), &json!({"p": [[20, 20]]}))
        .await;
    let mut stream = ask(&server, &id).await;
    let mut head = [0; 100];
    stream.read_exact(&mut head).await.unwrap();
    assert!(head.starts_with(b"HTTP/1.1 200"));
    // One is being sent, one waits in hyper, four are made ahead.
    let made = begun(&server).await;
    assert!((2..=7).contains(&made), "{made}");
    assert!(server.app.budget().taken_for(MemoryClass::Frame) < 16 << 20);
    png(server.drag(&id, &json!({"q": [[23, 20]]})).await).await;
    eventually("it is ended by the deadline for writing", || {
        server.app.budget().taken_for(MemoryClass::Frame) == 0
    })
    .await;
    assert_eq!(server.app.counters().pictures_begun, made + 1);
}

#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn the_work_stops_when_the_client_leaves_and_memory_is_flat_until_then() {
    let server = Server::start(&["--workers", "2"]).await;
    let id = server
        .session(&photo(LARGE.0, LARGE.1), &json!({"p": [[20, 20]]}))
        .await;
    let mut stream = ask(&server, &id).await;
    let (mut piece, mut taken, mut most) = (vec![0; 256 << 10], 0, 0);
    // A hundred frames.
    while taken < 100 * LARGE.0 as usize * LARGE.1 as usize * 4 {
        taken += stream.read(&mut piece).await.unwrap();
        most = most.max(server.app.budget().taken_for(MemoryClass::Frame));
    }
    drop(stream);
    let made = begun(&server).await;
    assert!((100..=110).contains(&made), "{made}");
    // A frame that is being posed reserves what halving all of its cells would take.
    assert!(most < 32 << 20, "{most} bytes for frames");
    eventually("all memory is given back", || {
        server.app.budget().taken_for(MemoryClass::Frame) == 0
    })
    .await;
    let counters = server.app.counters();
    assert_eq!(
        counters.pictures_begun,
        counters.pictures_finished + counters.pictures_abandoned
    );
}

#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn drags_are_served_between_the_frames_of_batches() {
    let server = Server::start(&["--workers", "1"]).await;
    let id = server
        .session(&photo(LARGE.0, LARGE.1), &json!({"p": [[20, 20]]}))
        .await;
    let body = json!({"q": [[22, 20]], "jitter": {"seed": 1, "count": 60, "sigma": 1}});
    let mut batches = [
        post(&server, &id, &body).await,
        post(&server, &id, &body).await,
    ];
    let mut drags = 0;
    let mut lengths = [0, 0];
    let mut open = 2;
    while open > 0 {
        open = 0;
        for (batch, length) in batches.iter_mut().zip(&mut lengths) {
            if let Some(chunk) = batch.chunk().await.unwrap() {
                *length += chunk.len();
                open += 1;
            }
        }
        if open == 2 && drags < 5 {
            png(server.drag(&id, &json!({"q": [[23 + drags, 20]]})).await).await;
            drags += 1;
        }
    }
    assert_eq!((drags, lengths[0]), (5, lengths[1]));
}

/// Frames that leave nothing uncovered are all posed before the first byte, because none may have
/// alpha: other requests have their turn.
#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn requests_are_served_while_the_frames_of_a_batch_are_surveyed() {
    let server = Server::start(&["--workers", "1"]).await;
    let rest = json!({"p": [[20, 20], [9, 5]], "grid": {"cell": 1}});
    let id = server.session(&photo(LARGE.0, LARGE.1), &rest).await;
    let still = server
        .post(&format!("/sessions/{id}/batch"))
        .json(&json!({"q": rest["p"], "steps": 10_000}))
        .send();
    let still = tokio::spawn(still);
    eventually("the batch has begun", || !idle(&server)).await;
    for _ in 0..10 {
        server.session(&photo(16, 12), &json!({"p": []})).await;
    }
    assert!(!still.is_finished());
    still.abort();
}

/// A server without memory delays a batch; one that has none for as long as a request may take ends
/// it, and the file has no directory.
#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn a_frame_that_fails_ends_the_file_without_its_directory() {
    let server = Server::start(&["--workers", "2", "--request-timeout", "5s"]).await;
    let id = server
        .session(&photo(LARGE.0, LARGE.1), &json!({"p": [[20, 20]]}))
        .await;
    let budget = server.app.budget();
    for is_given_back in [true, false] {
        let body = json!({"q": [[22, 20]], "jitter": {"seed": 1, "count": 40, "sigma": 1},
            "output": {"compression": "none"}});
        let mut response = post(&server, &id, &body).await;
        assert_eq!(response.status(), 200);
        let mut bytes = response.chunk().await.unwrap().unwrap().to_vec();
        let all = budget
            .take(MemoryClass::Frame, budget.total() - budget.taken())
            .unwrap();
        let mut held = Vec::new();
        if is_given_back {
            tokio::spawn(async move {
                tokio::time::sleep(std::time::Duration::from_millis(500)).await;
                drop(all);
            });
        } else {
            held.push(all);
        }
        let ended = loop {
            match response.chunk().await {
                Ok(Some(chunk)) => bytes.extend_from_slice(&chunk),
                Ok(None) => break true,
                Err(_) => break false,
            }
            // What frames that have left gave back.
            if !is_given_back
                && let Ok(more) = budget.take(MemoryClass::Frame, budget.total() - budget.taken())
            {
                held.push(more);
            }
        };
        assert_eq!(ended, is_given_back);
        assert_eq!(
            zip::ZipArchive::new(Cursor::new(&bytes)).is_ok(),
            is_given_back
        );
        drop(held);
    }
    eventually("all memory is given back", || {
        budget.taken_for(MemoryClass::Frame) == 0
    })
    .await;
    server.is_well().await;
}

/// Python's own reader tests the archive, with every checksum.
#[tokio::test]
async fn python_reads_the_archive() {
    let server = Server::start(&[]).await;
    let id = server.session(&photo(120, 80), &rest()).await;
    let response = post(
        &server,
        &id,
        &json!({"q": q(4), "steps": 6, "points": [[1, 1]]}),
    )
    .await;
    let scratch = crate::support::Scratch::new();
    let path = scratch.path("batch.zip");
    std::fs::write(&path, response.bytes().await.unwrap()).unwrap();
    let script = "import sys, zipfile, json\nz = zipfile.ZipFile(sys.argv[1])\nassert z.testzip() \
        is None\n\
                  print(len(z.namelist()), len(json.loads(z.read('frames.json'))['frames']), \
                  {i.compress_type for i in z.infolist()})";
    let output = std::process::Command::new("python3")
        .args(["-c", script, &path])
        .output()
        .unwrap();
    assert_eq!(
        String::from_utf8_lossy(&output.stdout).trim(),
        "13 6 {0}",
        "{output:?}"
    );
}
