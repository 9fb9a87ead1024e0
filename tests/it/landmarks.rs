//! Landmark files: `POST /landmarks`, and uploads whose handles are in files.

use mlswarp_server::limits::memory::MemoryClass;
use reqwest::Response;
use reqwest::multipart::{Form, Part};
use serde_json::{Value, json};

use crate::support::program::mlswarp;
use crate::support::{Server, eventually, photo};

const PTS: &str = "version: 1\nn_points: 2\n{\n4.5 3.5\n12.5 8.5\n}\n";
const CSV: &str = "x,y\n5,3\n12,9\n";
/// The handles of both.
const P: [[f64; 2]; 2] = [[4.0, 3.0], [12.0, 8.0]];
const Q: [[f64; 2]; 2] = [[5.0, 3.0], [12.0, 9.0]];

fn form(parts: &[(&'static str, &str)]) -> Form {
    let image = Form::new().part("image", Part::bytes(photo(16, 12)).file_name("photo.png"));
    parts.iter().fold(image, |form, (name, text)| {
        form.text(*name, (*text).to_owned())
    })
}

async fn problem(response: Response) -> (u16, Value) {
    (response.status().as_u16(), response.json().await.unwrap())
}

/// The picture of an upload.
async fn picture(server: &Server, parts: &[(&'static str, &str)]) -> (Option<String>, Vec<u8>) {
    let response = server
        .post("/warp")
        .multipart(form(parts))
        .send()
        .await
        .unwrap();
    assert_eq!(
        response.status(),
        200,
        "{parts:?}: {:?}",
        response.text().await
    );
    let warning = response
        .headers()
        .get("warp-warning")
        .map(|value| value.to_str().unwrap().to_owned());
    (warning, response.bytes().await.unwrap().to_vec())
}

#[tokio::test]
async fn a_picture_with_landmark_files_is_that_with_their_handles() {
    let server = Server::start(&[]).await;
    let by_json = json!({"p": P, "q": Q, "method": "affine"}).to_string();
    let (_, expected) = picture(&server, &[("warp", &by_json)]).await;
    let both = "px,py,qx,qy\n4,3,5,3\n12,8,12,9\n";
    let normalized = json!([{"x": P[0][0] / 16.0, "y": P[0][1] / 12.0},
        {"x": P[1][0] / 16.0, "y": P[1][1] / 12.0}])
    .to_string();
    let larger =
        json!({"landmarks": [{"x": 0.05, "y": 0.015}, {"x": 0.12, "y": 0.045}]}).to_string();
    let options = r#"{"method": "affine"}"#;
    for parts in [
        vec![
            ("warp", options),
            ("landmarks_p", PTS),
            ("landmarks_q", CSV),
        ],
        vec![
            ("landmarks_q", CSV),
            ("warp", options),
            ("landmarks_p", PTS),
        ],
        vec![("warp", options), ("landmarks", both)],
        vec![
            ("warp", options),
            ("landmarks_p", &normalized),
            ("landmarks_q", CSV),
        ],
        vec![
            ("warp", options),
            ("landmarks_p", PTS),
            ("landmarks_q", &larger),
            ("extent_q", "100,200"),
        ],
    ] {
        let (warning, drawn) = picture(&server, &parts).await;
        assert!(
            warning.is_none_or(|warning| !warning.contains("landmarks")),
            "{parts:?}"
        );
        assert!(drawn == expected, "{parts:?}");
    }
    // Every other field of a warp object has a default.
    let by_json = json!({"p": P, "q": Q}).to_string();
    let (_, expected) = picture(&server, &[("warp", &by_json)]).await;
    let (_, drawn) = picture(&server, &[("landmarks_p", PTS), ("landmarks_q", CSV)]).await;
    assert!(drawn == expected);
    eventually("nothing is kept", || {
        server.app.budget().taken_for(MemoryClass::Upload) == 0
    })
    .await;
}

#[tokio::test]
async fn sessions_take_landmark_files() {
    let server = Server::start(&[]).await;
    let response = server
        .post("/sessions")
        .multipart(form(&[
            ("landmarks", PTS),
            ("warp", r#"{"method": "similarity"}"#),
        ]))
        .send()
        .await
        .unwrap();
    assert_eq!(response.status(), 201);
    let session: Value = response.json().await.unwrap();
    assert_eq!(
        (&session["p"], &session["units"], &session["method"]),
        (&json!(P), &json!("px"), &json!("similarity"))
    );
    let put = async |parts: &[(&'static str, &str)]| {
        let url = server.url("/sessions/0f8fad5b-d9cb-469f-a165-70867728950e");
        let response = server
            .client
            .put(url)
            .multipart(form(parts))
            .send()
            .await
            .unwrap();
        let warning = response
            .headers()
            .get("warp-warning")
            .map(|value| value.to_str().unwrap().to_owned());
        (
            response.status().as_u16(),
            warning,
            response.json::<Value>().await.unwrap()["p"].clone(),
        )
    };
    assert_eq!(
        put(&[("landmarks_p", PTS), ("landmarks_q", CSV)]).await,
        (201, None, json!(P))
    );
    assert_eq!(
        put(&[("landmarks", PTS)]).await,
        (200, None, json!(P)),
        "the same session"
    );
    assert_eq!(
        put(&[("warp", &json!({"p": P}).to_string())]).await,
        (200, None, json!(P))
    );
    let named = [
        ("landmarks_p", "a,4,3\nb,1,1\n"),
        ("landmarks_q", "c,1,1\na,5,5\n"),
    ];
    assert_eq!(
        put(&named).await,
        (200, Some("landmarks_unmatched".to_owned()), json!([P[0]]))
    );
    let (warning, _) = picture(&server, &named).await;
    assert_eq!(warning.unwrap(), "translation_only, landmarks_unmatched");
}

#[tokio::test]
async fn uploads_that_say_too_much_or_too_little_are_refused() {
    let server = Server::start(&["--max-columns", "3"]).await;
    for (parts, status, code, words) in [
        (
            vec![("warp", r#"{"p": [[1, 1]]}"#), ("landmarks", CSV)],
            422,
            "bad_value",
            &["`p`", "landmark files"][..],
        ),
        (
            vec![("warp", r#"{"q": []}"#), ("landmarks", CSV)],
            422,
            "bad_value",
            &["`q`"],
        ),
        (
            vec![("warp", r#"{"units": "normalized"}"#), ("landmarks", CSV)],
            422,
            "bad_value",
            &["`units`"],
        ),
        (
            vec![("warp", "{}"), ("landmarks", CSV)],
            422,
            "bad_value",
            &["posed", "landmarks_q"],
        ),
        (
            vec![("landmarks_q", CSV)],
            422,
            "bad_landmarks",
            &["`landmarks_p` is missing"],
        ),
        (
            vec![("landmarks", CSV), ("landmarks_q", CSV)],
            422,
            "bad_landmarks",
            &["alone"],
        ),
        (
            vec![("landmarks", CSV), ("landmarks", CSV)],
            400,
            "malformed_request",
            &["twice"],
        ),
        (
            vec![("warp", "{}"), ("extent_p", "3,4")],
            422,
            "bad_value",
            &["`extent_p` belongs to landmark files"],
        ),
        (
            vec![("warp", "{}"), ("match", "order")],
            422,
            "bad_value",
            &["`match` belongs to landmark files"],
        ),
        (
            vec![("warp", r#"{"item": 0}"#)],
            422,
            "bad_value",
            &["`item` belongs to landmark files"],
        ),
        (
            vec![
                ("warp", r#"{"match": "any"}"#),
                ("landmarks_p", CSV),
                ("landmarks_q", CSV),
            ],
            422,
            "bad_value",
            &["one of `name`, `order`"],
        ),
        (
            vec![
                ("warp", r#"{"match": "order"}"#),
                ("match", "order"),
                ("landmarks_p", CSV),
                ("landmarks_q", CSV),
            ],
            422,
            "bad_value",
            &["twice"],
        ),
        (
            vec![("landmarks", "4,3,5,3\n"), ("item", "b")],
            422,
            "bad_landmarks",
            &["expected the item `b`"],
        ),
        (
            vec![("landmarks", PTS), ("extent_p", "3x4")],
            422,
            "bad_value",
            &["`extent_p`", "640,480"],
        ),
        (
            vec![("landmarks", PTS), ("extent_p", &"1".repeat(100))],
            413,
            "too_large",
            &["extent"],
        ),
        (
            vec![("landmark", PTS)],
            400,
            "malformed_request",
            &["did you mean `landmarks`?"],
        ),
        (
            vec![("landmarks", "face.pts")],
            422,
            "bad_landmarks",
            &["-F landmarks=@path"],
        ),
        (
            vec![("landmarks_p", PTS), ("landmarks_q", "1,2\n3,x\n")],
            422,
            "bad_landmarks",
            &["landmarks_q, line 2, column 3"],
        ),
        (
            vec![
                ("landmarks_p", r#"{"p": [[[1, 2], [3, 4]]]}"#),
                ("landmarks_q", "1,2\n"),
            ],
            422,
            "bad_landmarks",
            &[
                "landmarks_q, line 1, column 1: expected a line of 2 positions",
                "found a point",
            ],
        ),
        (
            vec![("landmarks", "1,2\n3,4\n5,6\n7,8\n")],
            413,
            "too_large",
            &["line 4, column 1", "3 columns"],
        ),
    ] {
        let (found, document) = problem(
            server
                .post("/warp")
                .multipart(form(&parts))
                .send()
                .await
                .unwrap(),
        )
        .await;
        assert_eq!(
            (found, document["code"].as_str().unwrap()),
            (status, code),
            "{parts:?}: {document}"
        );
        for word in words {
            assert!(
                document["detail"].as_str().unwrap().contains(word),
                "{parts:?}: {document}"
            );
        }
    }
    let (status, document) = problem(
        server
            .post("/warp")
            .multipart(Form::new().text("landmarks", PTS))
            .send()
            .await
            .unwrap(),
    )
    .await;
    assert_eq!(
        (status, &document["detail"]),
        (400, &json!("the part `image` is missing"))
    );
    server.is_well().await;
    eventually("nothing is kept", || {
        server.app.budget().taken_for(MemoryClass::Upload) == 0
    })
    .await;
}

#[tokio::test]
async fn files_are_converted_without_an_image() {
    let server = Server::start(&["--max-body-bytes", "64KiB"]).await;
    let convert = async |path: &str, media_type: &str, file: &str| {
        let request = server
            .post(path)
            .header("content-type", media_type)
            .body(file.to_owned());
        problem(request.send().await.unwrap()).await
    };
    let list = r#"[{"x": 0.25, "y": 0.5}]"#;
    // As curl sends `--data-binary`, too.
    for media_type in [
        "text/csv",
        "application/json",
        "application/octet-stream",
        "application/x-www-form-urlencoded",
        "text/plain",
    ] {
        let (status, read) = convert("/landmarks", media_type, list).await;
        assert_eq!(
            (status, read),
            (
                200,
                json!({"p": [[0.25, 0.5]], "units": "normalized", "format": "mediapipe"})
            ),
            "{media_type}"
        );
    }
    for query in [
        "extent_p=640,480",
        "extent_p=640%2C480&item=0",
        "extent_p=%5B640%2c%20480%5D",
    ] {
        let (_, read) = convert(&format!("/landmarks?{query}"), "application/json", list).await;
        assert_eq!(
            (&read["p"], &read["units"]),
            (&json!([[160.0, 240.0]]), &json!("px")),
            "{query}: {read}"
        );
    }
    for (query, code, word) in [
        ("extent=1,2", "unknown_field", "did you mean `extent_p`?"),
        ("extent_p=250001,2", "bad_value", "`extent_p`"),
        (
            "extent_p=1,2&extent_q=1,4000000000",
            "bad_value",
            "`extent_q`",
        ),
        (
            "extent_p=1,2&extent_q=1,4",
            "bad_value",
            "`extent_q` belongs to posed positions",
        ),
        ("match=both", "bad_value", "`name`, `order`"),
        ("match=order", "bad_value", "two files"),
        ("item=%C3%A9", "bad_landmarks", "the item `é`"),
        ("extent_p=1", "bad_value", "`extent_p`"),
        ("extent_p=1,2&extent_p=1,2", "malformed_request", "twice"),
    ] {
        let (_, document) = convert(&format!("/landmarks?{query}"), "application/json", list).await;
        assert_eq!(document["code"], code, "{query}");
        assert!(
            document["detail"].as_str().unwrap().contains(word),
            "{document}"
        );
    }
    let (status, document) = convert("/landmarks", "text/plain", &"1,2\n".repeat(20_000)).await;
    assert_eq!(
        (status, &document["limit_name"]),
        (413, &json!("body_bytes"))
    );
    let (status, document) = convert("/landmarks", "text/plain", "").await;
    assert_eq!(
        (status, &document["line"], &document["column"]),
        (422, &json!(1), &json!(1))
    );
    let parts = Form::new()
        .text("landmarks_p", PTS)
        .text("landmarks_q", list)
        .text("extent_q", "20,18");
    let (status, document) = problem(
        server
            .post("/landmarks")
            .multipart(parts)
            .send()
            .await
            .unwrap(),
    )
    .await;
    assert_eq!(
        (status, &document["code"]),
        (422, &json!("bad_landmarks")),
        "{document}"
    );
    assert!(
        document["detail"]
            .as_str()
            .unwrap()
            .starts_with("landmarks_p, line 5, column 1: expected 1 landmark"),
        "{document}"
    );
    let parts = Form::new()
        .text("landmarks", list)
        .text("extent_p", "20,18");
    let (_, document) = problem(
        server
            .post("/landmarks?extent_p=1,2")
            .multipart(parts)
            .send()
            .await
            .unwrap(),
    )
    .await;
    assert_eq!(
        document["detail"],
        "`extent_p` is given twice: in the query and as a part"
    );
    eventually("nothing is kept", || {
        server.app.budget().taken_for(MemoryClass::Upload) == 0
    })
    .await;
}

#[test]
fn the_offline_tool_reads_the_same_files() {
    let folder = std::env::temp_dir().join(format!("mlswarp-landmarks-{}", std::process::id()));
    std::fs::create_dir_all(&folder).unwrap();
    let file = |name: &str, content: &[u8]| {
        let path = folder.join(name);
        std::fs::write(&path, content).unwrap();
        path.into_os_string().into_string().unwrap()
    };
    let (image, p, q) = (
        file("photo.png", &photo(16, 12)),
        file("p.pts", PTS.as_bytes()),
        file("q.csv", CSV.as_bytes()),
    );
    let by_json = file(
        "handles.json",
        json!({"p": P, "q": Q, "method": "affine"})
            .to_string()
            .as_bytes(),
    );
    let options = file("options.json", br#"{"method": "affine"}"#);
    let both = file("both.csv", b"4,3,5,3\n12,8,12,9\n");
    let (one, two) = (file("one.png", b""), file("two.png", b""));
    let warp = |arguments: &[&str]| {
        let output = mlswarp(&[&["warp"], arguments].concat()).output().unwrap();
        (
            output.status.success(),
            String::from_utf8(output.stderr).unwrap(),
        )
    };
    let (done, text) = warp(&[&image, &by_json, "-o", &one]);
    assert!(done, "{text}");
    for arguments in [
        vec![
            &*image,
            &*options,
            "--landmarks",
            &*p,
            "--landmarks-q",
            &*q,
            "-o",
            &*two,
        ],
        vec![&*image, &*options, "--landmarks", &*both, "-o", &*two],
    ] {
        let (done, text) = warp(&arguments);
        assert!(done, "{text}");
        assert!(
            std::fs::read(&one).unwrap() == std::fs::read(&two).unwrap(),
            "{arguments:?}"
        );
    }
    assert!(
        warp(&[&image, "--landmarks", &both, "-o", &two]).0,
        "without a warp object"
    );
    for (arguments, word) in [
        (
            vec![&*image, &*by_json, "--landmarks", &*both, "-o", &*two],
            "leave `p` out",
        ),
        (
            vec![&*image, "--landmarks", &*p, "-o", &*two],
            "no posed positions",
        ),
        (
            vec![
                &*image,
                "--landmarks",
                &*p,
                "--landmarks-q",
                &*image,
                "-o",
                &*two,
            ],
            "photo.png: line 1, column 1",
        ),
        (
            vec![&*image, &*by_json, "--landmarks-q", &*q, "-o", &*two],
            "--landmarks <FILE>",
        ),
        (vec![&*image, "-o", &*two], "the handles are missing"),
        (vec!["-", "--landmarks", "-", "-o", &*two], "standard input"),
    ] {
        let (done, text) = warp(&arguments);
        assert!(!done && text.contains(word), "{arguments:?}: {text}");
    }
    std::fs::remove_dir_all(&folder).unwrap();
}
