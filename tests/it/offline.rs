//! `mlswarp warp`: the same walk without a server.

use std::io::Write as _;
use std::process::Stdio;

use serde_json::json;

use crate::support::program::mlswarp;
use crate::support::server::png;
use crate::support::{Server, photo};

fn directory(name: &str) -> std::path::PathBuf {
    let directory =
        std::env::temp_dir().join(format!("mlswarp-test-{}-{name}", std::process::id()));
    std::fs::create_dir_all(&directory).unwrap();
    directory
}

#[tokio::test]
async fn the_program_writes_the_bytes_that_the_server_answers() {
    let directory = directory("offline");
    let path = |name: &str| directory.join(name).to_str().unwrap().to_owned();
    let (image, warp) = (
        photo(400, 300),
        json!({"p": [[20, 20], [300, 200]], "q": [[40, 20], [300, 180]], "method": "similarity"}),
    );
    std::fs::write(path("in.png"), &image).unwrap();
    std::fs::write(path("warp.json"), warp.to_string()).unwrap();
    let server = Server::start(&[]).await;
    let answer = png(server.upload("/warp", &image, &warp).await).await;

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
    assert!(
        String::from_utf8_lossy(&output.stderr).contains("400 x 300 px, 0 folded cells, residual"),
        "{output:?}"
    );
    assert_eq!(std::fs::read(path("out.png")).unwrap(), answer);

    let mut child = mlswarp(&["warp", "-", &path("warp.json"), "-o", "-"])
        .stdin(Stdio::piped())
        .stdout(Stdio::piped())
        .stderr(Stdio::null())
        .spawn()
        .unwrap();
    child.stdin.take().unwrap().write_all(&image).unwrap();
    assert_eq!(child.wait_with_output().unwrap().stdout, answer);

    let canvas = json!({"x": -20, "y": 10, "width": 450, "height": 300});
    let boxed = json!({"p": warp["p"], "q": warp["q"], "method": "similarity",
        "output": {"canvas": canvas}});
    let answer = png(server.upload("/warp", &image, &boxed).await).await;
    let output = mlswarp(&[
        "warp",
        &path("in.png"),
        &path("warp.json"),
        "--canvas",
        "-20,10,450,300",
        "-o",
        &path("box.png"),
    ])
    .output()
    .unwrap();
    assert!(
        String::from_utf8_lossy(&output.stderr)
            .starts_with("450 x 300 px, canvas -20,10,450,300, 0 folded cells"),
        "{output:?}"
    );
    assert_eq!(
        std::fs::read(path("box.png")).unwrap(),
        answer,
        "--canvas takes precedence over the warp object"
    );
    std::fs::remove_file(path("box.png")).unwrap();
    for text in ["grow", "1,2,3", "0,0,0,5", "1000001,0,5,5", "0.5,0,5,5", ""] {
        let output = mlswarp(&[
            "warp",
            &path("in.png"),
            &path("warp.json"),
            "--canvas",
            text,
            "-o",
            &path("box.png"),
        ])
        .output()
        .unwrap();
        let said = String::from_utf8_lossy(&output.stderr).into_owned();
        assert!(
            output.status.code() == Some(1) && said.starts_with("error: --canvas: "),
            "{text}: {said}"
        );
    }

    let written = |name: &str| {
        let output = mlswarp(&[
            "warp",
            &path("in.png"),
            &path("warp.json"),
            "-o",
            &path(name),
        ])
        .output()
        .unwrap();
        assert!(output.status.success(), "{output:?}");
        let file = std::fs::read(path(name)).unwrap();
        std::fs::remove_file(path(name)).unwrap();
        file
    };
    for (name, first) in [
        ("out.JPG", b"\xFF\xD8"),
        ("out.jpeg", b"\xFF\xD8"),
        ("out.webp", b"RI"),
        ("out.tif", b"MM"),
        ("out.tiff", b"MM"),
        ("out.PNG", b"\x89P"),
        ("out", b"\x89P"),
    ] {
        assert!(
            written(name).starts_with(first),
            "{name}: the extension selects the format; without one it is PNG"
        );
    }
    // The extension is checked before the image is read.
    for (image, name) in [
        ("in.png", "out.gif"),
        ("missing.png", "out.avif"),
        ("in.png", "out.json"),
        ("in.png", "out."),
    ] {
        let output = mlswarp(&["warp", &path(image), &path("warp.json"), "-o", &path(name)])
            .output()
            .unwrap();
        let said = String::from_utf8_lossy(&output.stderr).into_owned();
        assert_eq!(output.status.code(), Some(1), "{said}");
        let extension = &name[name.find('.').unwrap()..];
        assert!(
            said.starts_with("unsupported_format: ")
                && said.contains(&format!("`{extension}` is not supported")),
            "{said}"
        );
        assert!(
            said.contains("supported: .png, .jpg, .jpeg, .webp, .tif, .tiff")
                && !directory.join(name).exists(),
            "{said}"
        );
    }
    let named = json!({"p": [[20, 20]], "q": [[40, 20]], "output": {"format": "webp"}});
    std::fs::write(path("warp.json"), named.to_string()).unwrap();
    for name in ["out.jpg", "out.part", "out"] {
        assert!(
            written(name).starts_with(b"RIFF"),
            "{name}: a format in the warp object takes precedence"
        );
    }
    let output = mlswarp(&["warp", &path("in.png"), &path("warp.json"), "-o", "-"])
        .output()
        .unwrap();
    assert!(
        output.status.success() && output.stdout.starts_with(b"RIFF"),
        "{output:?}"
    );
    std::fs::write(path("out.png"), written("out.png")).unwrap();

    std::fs::write(
        path("warp.json"),
        r#"{"p": [[1, 1]], "q": [[1, 1]], "methd": "rigid"}"#,
    )
    .unwrap();
    let output = mlswarp(&[
        "warp",
        &path("in.png"),
        &path("warp.json"),
        "-o",
        &path("never.png"),
    ])
    .output()
    .unwrap();
    assert_eq!(output.status.code(), Some(1));
    let said = String::from_utf8_lossy(&output.stderr).into_owned();
    assert!(
        said.starts_with("unknown_field: ") && said.contains("(/methd)"),
        "{said}"
    );
    assert!(!directory.join("never.png").exists());
    std::fs::write(path("warp.json"), "{}").unwrap();
    for (image, out, sentence) in [
        ("missing.png", "never.png", "error: cannot read the image "),
        ("in.png", "missing/never.png", "error: cannot write "),
        (
            "in.png",
            "never.\u{1b}[31m",
            "unsupported_format: cannot write ",
        ),
    ] {
        let output = mlswarp(&["warp", &path(image), &path("warp.json"), "-o", &path(out)])
            .output()
            .unwrap();
        let said = String::from_utf8_lossy(&output.stderr).into_owned();
        assert_eq!(output.status.code(), Some(1));
        assert!(
            said.starts_with(sentence) && !said.trim_end().contains(char::is_control),
            "{said:?}"
        );
        assert_eq!(
            said.contains("there is no directory"),
            out.starts_with("missing"),
            "{said}"
        );
    }
    assert_eq!(
        std::fs::read_dir(&directory).unwrap().count(),
        3,
        "no half picture is left behind"
    );
    std::fs::remove_dir_all(directory).unwrap();
}

#[test]
fn the_program_counts_the_cells_over_the_tolerance() {
    let directory = directory("offline-tolerance");
    let path = |name: &str| directory.join(name).to_str().unwrap().to_owned();
    // Mirrored: the rotation is undefined between the handles.
    let p = [[50, 50], [150, 50], [50, 150], [150, 150]];
    let q = [p[1], p[0], p[2], p[3]];
    std::fs::write(path("in.png"), photo(200, 200)).unwrap();
    let said = |grid: serde_json::Value| {
        std::fs::write(
            path("warp.json"),
            json!({"p": p, "q": q, "grid": grid}).to_string(),
        )
        .unwrap();
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
        String::from_utf8(output.stderr).unwrap()
    };
    let over = said(json!({"tolerance": 0.1}));
    let (before, after) = over.split_once(" cells over the tolerance").unwrap();
    assert!(
        before.rsplit(' ').next().unwrap().parse::<u64>().unwrap() > 0
            && after.contains("tolerance_exceeded"),
        "{over}"
    );
    let fixed = said(json!({"cell": 4}));
    assert!(
        !fixed.contains("tolerance") && fixed.contains("folded cells"),
        "{fixed}"
    );
}

#[test]
fn normalised_landmarks_are_multiplied_by_the_sizes_given() {
    let directory = directory("offline-extents");
    let file = |name: &str, content: &[u8]| {
        let path = directory.join(name).to_str().unwrap().to_owned();
        std::fs::write(&path, content).unwrap();
        path
    };
    let (image, out) = (file("in.png", &photo(40, 30)), file("out.png", b""));
    let list = |places: &[[f64; 2]]| {
        json!(
            places
                .iter()
                .map(|[x, y]| json!({"x": x, "y": y}))
                .collect::<Vec<_>>()
        )
        .to_string()
    };
    let p = file("p.json", list(&[[0.1, 0.1], [0.2, 0.5]]).as_bytes());
    let q = file("q.json", list(&[[0.5, 0.1], [0.9, 0.5]]).as_bytes());
    let drawn = |arguments: &[&str]| {
        let output = mlswarp(&[&["warp", &*image, "-o", &*out], arguments].concat())
            .output()
            .unwrap();
        assert!(output.status.success(), "{output:?}");
        std::fs::read(&out).unwrap()
    };
    for (extents, places) in [
        (
            &["--extent-p", "100,20"][..],
            json!({"p": [[10, 2], [20, 10]], "q": [[50, 2], [90, 10]]}),
        ),
        (
            &["--extent-p", "100,20", "--extent-q", "30,40"],
            json!({"p": [[10, 2], [20, 10]], "q": [[15, 4], [27, 20]]}),
        ),
        (
            &["--extent-q", "30,40"],
            json!({"p": [[4, 3], [8, 15]], "q": [[15, 4], [27, 20]]}),
        ),
    ] {
        let expected = drawn(&[&file("warp.json", places.to_string().as_bytes())]);
        let found = drawn(&[&["--landmarks", &*p, "--landmarks-q", &*q], extents].concat());
        assert!(found == expected, "{extents:?}");
    }
    for (extents, sentence) in [
        (
            ["--extent-p", "100"],
            "bad_value: `--extent-p` must be the width and height",
        ),
        (
            ["--extent-q", "0,1"],
            "bad_value: `--extent-q` must be the width and height",
        ),
    ] {
        let output = mlswarp(
            &[
                &["warp", &*image, "-o", &*out, "--landmarks", &*p],
                &extents[..],
            ]
            .concat(),
        )
        .output()
        .unwrap();
        let said = String::from_utf8_lossy(&output.stderr).into_owned();
        assert!(
            !output.status.success() && said.starts_with(sentence),
            "{said}"
        );
    }
    std::fs::remove_dir_all(directory).unwrap();
}
