//! `mlswarp warp` with several images, and what every subcommand does to the files that are there
//! already.

use std::fs;
use std::io::Write as _;
use std::process::{Output, Stdio};

use serde_json::{Value, json};

use crate::support::program::mlswarp;
use crate::support::{Scratch, photo};

fn run(args: &[&str]) -> (Option<i32>, String) {
    let Output { status, stderr, .. } = mlswarp(args).output().unwrap();
    (status.code(), String::from_utf8(stderr).unwrap())
}

fn done(args: &[&str]) -> String {
    let (code, said) = run(args);
    assert_eq!(code, Some(0), "{args:?}: {said}");
    said
}

fn refused(args: &[&str], words: &[&str]) -> String {
    let (code, said) = run(args);
    assert_eq!(code, Some(1), "{args:?}: {said}");
    for word in words {
        assert!(said.contains(word), "{word}: {args:?}: {said}");
    }
    said
}

fn warp() -> Value {
    json!({"p": [[10, 10], [50, 12], [30, 35]], "q": [[14, 10], [45, 12], [30, 30]]})
}

/// A folder `in` with pictures of two sizes, and a warp object beside it.
fn folder() -> Scratch {
    let scratch = Scratch::new();
    fs::create_dir(scratch.path("in")).unwrap();
    for (name, width) in [("one.png", 60), ("two.png", 60), ("three.PNG", 80)] {
        fs::write(scratch.path(&format!("in/{name}")), photo(width, 40)).unwrap();
    }
    fs::write(scratch.path("warp.json"), warp().to_string()).unwrap();
    scratch
}

fn names(folder: &str) -> Vec<String> {
    let mut names: Vec<String> = fs::read_dir(folder)
        .unwrap()
        .map(|e| e.unwrap().file_name().to_str().unwrap().to_owned())
        .collect();
    names.sort();
    names
}

#[test]
fn folders_of_images_are_warped_as_each_image_alone() {
    let scratch = folder();
    let path = |name: &str| scratch.path(name);
    let warp = path("warp.json");
    let images = ["in/one.png", "in/two.png", "in/three.PNG"].map(path);
    let alone = |image: &str, extension: &str| {
        let out = path(&format!("alone.{extension}"));
        done(&["warp", image, &warp, "-o", &out]);
        fs::read(out).unwrap()
    };
    let (out, made, jpeg, existing) = (path("out/"), path("made"), path("jpeg/"), path("existing"));
    fs::create_dir(&existing).unwrap();
    fs::write(path("existing/one.png"), "old").unwrap();
    // The order does not matter, a folder stands for its images, and what is no image stays out.
    fs::write(path("in/notes.txt"), "no image").unwrap();
    fs::write(path("in/.hidden.png"), "no image").unwrap();
    for (args, folder) in [
        (
            vec![
                "warp", &images[0], &images[1], &images[2], &warp, "-o", &out,
            ],
            &out,
        ),
        (
            vec![
                "warp", &warp, &images[2], &images[0], &images[1], "-o", &made,
            ],
            &made,
        ),
        (vec!["warp", &path("in"), &warp, "-o", &existing], &existing),
        (
            vec!["warp", &path("in"), &warp, "--format", "jpeg", "-o", &jpeg],
            &jpeg,
        ),
    ] {
        let said = done(&args);
        let extension = if folder == &jpeg { "jpg" } else { "png" };
        assert_eq!(
            names(folder),
            ["one", "three", "two"].map(|name| format!("{name}.{extension}")),
            "{args:?}"
        );
        for image in &images {
            let stem = std::path::Path::new(image)
                .file_stem()
                .unwrap()
                .to_str()
                .unwrap();
            let file =
                fs::read(std::path::Path::new(folder).join(format!("{stem}.{extension}"))).unwrap();
            assert!(file == alone(image, extension), "{args:?}: {stem}");
        }
        let lines: Vec<&str> = said.lines().collect();
        assert!(
            lines.len() == 4 && lines[3].starts_with("3 images in "),
            "{said}"
        );
        assert!(
            said.contains("three.") && said.contains("80 x 40 px, 0 folded cells, residual "),
            "{said}"
        );
    }
    // One image to a folder that exists.
    done(&["warp", &images[0], &warp, "-o", &made]);
}

#[test]
fn an_image_that_fails_stops_no_other_and_the_exit_code_says_so() {
    let scratch = folder();
    let path = |name: &str| scratch.path(name);
    fs::write(path("in/broken.png"), &photo(60, 40)[..300]).unwrap();
    fs::write(path("in/text.png"), "no image").unwrap();
    let said = refused(
        &["warp", &path("in"), &path("warp.json"), "-o", &path("out/")],
        &["2 of 5 images failed; 3 are in "],
    );
    let failure = |name: &str| {
        said.lines()
            .find(|line| line.contains(name))
            .unwrap()
            .to_owned()
    };
    assert!(
        failure("broken.png").starts_with("bad_image: ")
            && failure("text.png").starts_with("unsupported_format: "),
        "{said}"
    );
    assert_eq!(names(&path("out")), ["one.png", "three.png", "two.png"]);
    // Handles that fit one size only: a warning for the others.
    fs::write(
        path("far.json"),
        json!({"p": [[70, 10], [75, 30]], "q": [[70, 10], [72, 30]]}).to_string(),
    )
    .unwrap();
    let said = done(&[
        "warp",
        &path("in/one.png"),
        &path("in/three.PNG"),
        &path("far.json"),
        "-o",
        &path("far/"),
    ]);
    assert!(said.lines().count() == 3, "{said}");
}

#[test]
fn outputs_that_would_collide_are_refused_before_anything_is_written() {
    let scratch = folder();
    let path = |name: &str| scratch.path(name);
    for name in ["in/one.jpg", "in/ONE.png", "in/ärger.png"] {
        fs::write(path(name), photo(60, 40)).unwrap();
    }
    fs::create_dir(path("other")).unwrap();
    fs::write(path("other/one.png"), photo(60, 40)).unwrap();
    let (warp, out) = (path("warp.json"), path("out/"));
    for other in ["in/one.jpg", "in/ONE.png", "other/one.png", "in/one.png"] {
        refused(
            &["warp", &path("in/one.png"), &path(other), &warp, "-o", &out],
            &["would both be written to ", "one.png"],
        );
        assert!(fs::metadata(&out).is_err(), "{other}");
    }
    // Of several images, one file or standard output is not enough.
    for out in ["out.png", "-"] {
        let out = if out == "-" {
            out.to_owned()
        } else {
            path(out)
        };
        refused(
            &[
                "warp",
                &path("in/one.png"),
                &path("in/two.png"),
                &warp,
                "-o",
                &out,
            ],
            &["2 images cannot be written to ", "give a folder"],
        );
        assert!(fs::metadata(&out).is_err());
    }
}

#[test]
fn no_output_replaces_an_input() {
    let scratch = folder();
    let path = |name: &str| scratch.path(name);
    let (one, warp) = (path("in/one.png"), path("warp.json"));
    fs::write(path("landmarks.csv"), "10,10\n50,12\n30,35\n").unwrap();
    fs::create_dir(path("links")).unwrap();
    #[cfg(unix)]
    std::os::unix::fs::symlink(&one, path("links/link.png")).unwrap();
    let before = [&one, &path("in/two.png"), &warp, &path("landmarks.csv")]
        .map(|file| fs::read(file).unwrap());
    let handles = [
        "--landmarks",
        &*path("landmarks.csv"),
        "--landmarks-q",
        &path("landmarks.csv"),
    ];
    let batch = ["--steps", "2", "--extent-p", "60,40"];
    for args in [
        vec!["warp", &one, &warp, "-o", &one],
        vec!["warp", &path("in"), &warp, "-o", &path("in")],
        vec!["warp", &one, &warp, "-o", &path("in/../in/one.png")],
        vec!["warp", &one, &warp, "-o", &path("links/link.png")],
        vec!["warp", &one, &warp, "--format", "png", "-o", &warp],
        vec![
            "warp", &one, handles[0], handles[1], handles[2], handles[3], "--format", "png", "-o",
            handles[1],
        ],
        vec![
            "warp",
            &path("in/two.png"),
            &warp,
            "--region",
            &one,
            "-o",
            &one,
        ],
        vec!["points", &warp, "--image", &one, "-o", &warp],
        vec!["report", &warp, "--image", &one, "-o", &warp],
        vec!["map", &warp, "--image", &one, "-o", &path("in/one.png")],
        vec!["batch", &one, &warp, batch[0], batch[1], "-o", &one],
    ] {
        let said = run(&args);
        assert!(said.0 == Some(1), "{args:?}: {}", said.1);
        assert!(
            said.1.contains("is an input and would be replaced")
                || said.1.contains("is not supported"),
            "{args:?}: {}",
            said.1
        );
    }
    let after = [&one, &path("in/two.png"), &warp, &path("landmarks.csv")]
        .map(|file| fs::read(file).unwrap());
    assert!(before == after);
    // Frames of a folder: the second would replace the picture.
    fs::create_dir(path("frames")).unwrap();
    fs::write(path("frames/0001.png"), photo(60, 40)).unwrap();
    refused(
        &[
            "batch",
            &path("frames/0001.png"),
            &warp,
            "--steps",
            "3",
            "-o",
            &path("frames"),
        ],
        &["is an input and would be replaced"],
    );
    assert!(fs::read(path("frames/0001.png")).unwrap() == photo(60, 40));
}

#[cfg(unix)]
#[test]
fn a_link_in_a_folder_is_replaced_and_a_link_that_is_named_is_followed() {
    let scratch = folder();
    let path = |name: &str| scratch.path(name);
    let (one, warp, victim) = (path("in/one.png"), path("warp.json"), path("victim"));
    fs::write(&victim, "precious").unwrap();
    for folder in ["warped", "frames"] {
        fs::create_dir(path(folder)).unwrap();
    }
    for link in ["warped/one.png", "frames/0000.png", "frames/frames.json"] {
        std::os::unix::fs::symlink(&victim, path(link)).unwrap();
    }
    done(&["warp", &one, &warp, "-o", &path("warped")]);
    done(&["batch", &one, &warp, "--steps", "2", "-o", &path("frames")]);
    assert_eq!(fs::read(&victim).unwrap(), b"precious");
    for file in ["warped/one.png", "frames/0000.png", "frames/frames.json"] {
        assert!(
            fs::symlink_metadata(path(file)).unwrap().is_file(),
            "{file}"
        );
    }
    std::os::unix::fs::symlink(&victim, path("named.png")).unwrap();
    done(&["warp", &one, &warp, "-o", &path("named.png")]);
    assert!(
        fs::read(&victim).unwrap().starts_with(b"\x89PNG")
            && fs::symlink_metadata(path("named.png"))
                .unwrap()
                .is_symlink()
    );
}

#[test]
fn the_warp_object_is_told_from_images_by_its_name_or_its_content() {
    let scratch = folder();
    let path = |name: &str| scratch.path(name);
    let (one, two, out) = (path("in/one.png"), path("in/two.png"), path("out.png"));
    fs::write(path("handles"), format!(" \n{}", warp())).unwrap();
    fs::write(path("list.json"), "[[1, 2]]").unwrap();
    fs::write(path("picture"), photo(60, 40)).unwrap();
    done(&["warp", &path("picture"), &path("handles"), "-o", &out]);
    done(&["warp", &path("handles"), &one, "-o", &out]);
    for (args, words) in [
        (
            vec![
                "warp",
                &one,
                &path("warp.json"),
                &path("handles"),
                "-o",
                &out,
            ],
            &["both ", "warp.json and ", "handles are JSON"][..],
        ),
        (
            vec!["warp", &path("warp.json"), "-o", &out],
            &["no image is given"],
        ),
        (
            vec!["warp", &one, &two, "-o", &path("out/")],
            &["the handles are missing", "--landmarks"],
        ),
        (
            vec!["warp", &one, &path("list.json"), "-o", &out],
            &[
                "malformed_request: ",
                "list.json: the request must be a JSON object",
            ],
        ),
        (
            vec!["warp", &one, &path("missing.json"), "-o", &out],
            &["error: cannot read the warp object "],
        ),
        (
            vec!["warp", &path("missing.png"), &path("warp.json"), "-o", &out],
            &["error: cannot read the image "],
        ),
        (
            vec!["warp", &one, "-", "-", "-o", &out],
            &["standard input can be one of the input files only"],
        ),
    ] {
        refused(&args, words);
    }
    // Standard input is told by its content too; it has no name for a file of a folder.
    let piped = |args: &[&str], input: &[u8]| {
        let mut child = mlswarp(args)
            .stdin(Stdio::piped())
            .stdout(Stdio::piped())
            .stderr(Stdio::piped())
            .spawn()
            .unwrap();
        let _ = child.stdin.take().unwrap().write_all(input);
        child.wait_with_output().unwrap()
    };
    let object = warp().to_string();
    let of_json = piped(&["warp", &one, "-", "-o", "-"], object.as_bytes());
    let of_image = piped(
        &["warp", "-", &path("warp.json"), "-o", "-"],
        &photo(60, 40),
    );
    assert!(
        of_json.status.success() && of_json.stdout == of_image.stdout,
        "{of_json:?}"
    );
    let several = piped(
        &["warp", &one, &two, "-", "-o", &path("piped/")],
        object.as_bytes(),
    );
    assert!(several.status.success(), "{several:?}");
    let nameless = piped(
        &[
            "warp",
            "-",
            &one,
            &path("warp.json"),
            "-o",
            &path("nameless/"),
        ],
        &photo(60, 40),
    );
    assert!(
        String::from_utf8_lossy(&nameless.stderr).contains("standard input has no name"),
        "{nameless:?}"
    );
}

#[test]
fn each_image_may_have_its_own_landmarks_and_mask_in_a_folder() {
    let scratch = folder();
    let path = |name: &str| scratch.path(name);
    fs::create_dir(path("masks")).unwrap();
    for (name, x) in [("one", 10), ("two", 20), ("three", 30)] {
        fs::write(
            path(&format!("in/{name}.csv")),
            format!("{x},10\n50,12\n30,35\n"),
        )
        .unwrap();
        let width = if name == "three" { 80 } else { 60 };
        fs::write(path(&format!("masks/{name}.png")), photo(width, 40)).unwrap();
    }
    fs::write(path("average.csv"), "14,10\n45,12\n30,30\n").unwrap();
    let (images, average) = (path("in"), path("average.csv"));
    let q = ["--landmarks-q", &*average];
    done(&[
        "warp",
        &images,
        "--landmarks",
        &images,
        q[0],
        q[1],
        "--region",
        &path("masks"),
        "-o",
        &path("out/"),
    ]);
    for (name, file) in [
        ("one", "one.png"),
        ("two", "two.png"),
        ("three", "three.PNG"),
    ] {
        let (image, own, mask) = (
            path(&format!("in/{file}")),
            path(&format!("in/{name}.csv")),
            path(&format!("masks/{name}.png")),
        );
        done(&[
            "warp",
            &image,
            "--landmarks",
            &own,
            q[0],
            q[1],
            "--region",
            &mask,
            "-o",
            &path("alone.png"),
        ]);
        assert!(
            fs::read(path("alone.png")).unwrap()
                == fs::read(path(&format!("out/{name}.png"))).unwrap(),
            "{name}"
        );
    }
    fs::remove_file(path("in/two.csv")).unwrap();
    fs::write(path("in/three.pts"), "version: 1").unwrap();
    let said = refused(
        &[
            "warp",
            &images,
            "--landmarks",
            &images,
            q[0],
            q[1],
            "-o",
            &path("out/"),
        ],
        &["2 of 3 images failed"],
    );
    assert!(
        said.contains("has no landmark file for ") && said.contains("two landmark files for "),
        "{said}"
    );
}
