//! `mlswarp blend`: the bytes of `POST /blend`, landmark files by name, and what is refused.

use std::fs;
use std::io::{Cursor, Read as _};

use serde_json::{Value, json};

use crate::support::program::{done, failed};
use crate::support::server::blend_form;
use crate::support::{Scratch, Server, photo};

const FIRST: &str = "name,x,y\na,10,10\nb,50,12\nc,30,20\nd,15,38\n";
const SECOND: &str = "name,x,y\na,14,10\nb,54,12\nc,30,24\nd,15,38\n";

/// Two images with a landmark file beside each.
fn folder() -> Scratch {
    let scratch = Scratch::new();
    for (name, file, landmarks) in [
        ("one", photo(64, 48), FIRST),
        ("two", photo(80, 40), SECOND),
    ] {
        fs::write(scratch.path(&format!("{name}.png")), file).unwrap();
        fs::write(scratch.path(&format!("{name}.csv")), landmarks).unwrap();
    }
    scratch
}

async fn answer(server: &Server, scratch: &Scratch, blend: &Value, accept: &str) -> Vec<u8> {
    let image = |name: &str| fs::read(scratch.path(name)).unwrap();
    let form = blend_form(&[&image("one.png"), &image("two.png")], blend)
        .text("landmarks", FIRST)
        .text("landmarks", SECOND);
    let request = server.post("/blend").header("accept", accept);
    let response = request.multipart(form).send().await.unwrap();
    assert_eq!(response.status(), 200, "{blend}");
    response.bytes().await.unwrap().to_vec()
}

#[tokio::test]
async fn blends_are_those_that_the_server_answers() {
    let (scratch, server) = (folder(), Server::start(&[]).await);
    let path = |name: &str| scratch.path(name);
    let [one, two, out] = ["one.png", "two.png", "out.png"].map(path);
    let shares = |shape: [f64; 2], colour: [f64; 2]| {
        json!({"images": [
            {"image": 0, "shape": shape[0], "colour": colour[0]},
            {"image": 1, "shape": shape[1], "colour": colour[1]},
        ]})
    };
    let with = |more: Value| {
        let mut blend = json!({"images": [{"image": 0}, {"image": 1}]});
        let fields = more.as_object().unwrap().clone();
        blend.as_object_mut().unwrap().extend(fields);
        blend
    };
    for (options, blend, media_type) in [
        (&[][..], with(json!({})), "image/png"),
        (
            &["--shape", "0.25", "--colour", "0,1"],
            shares([0.75, 0.25], [0.0, 1.0]),
            "image/png",
        ),
        (
            &["--shape", "1.5,-0.5", "--colour=1,0"],
            shares([1.5, -0.5], [1.0, 0.0]),
            "image/png",
        ),
        (
            &["--space", "linear", "--method", "affine", "--align", "none"],
            with(json!({"space": "linear", "method": "affine", "align": "none"})),
            "image/png",
        ),
        (
            &["--width", "32", "--format", "jpeg", "--quality", "70"],
            with(json!({"output": {"width": 32, "format": "jpeg", "quality": 70}})),
            "image/jpeg",
        ),
        (&["--steps", "3"], with(json!({"steps": 3})), "image/apng"),
    ] {
        let expected = answer(&server, &scratch, &blend, media_type).await;
        let args = [&["blend", &*one, &*two, "-o", &*out], options].concat();
        let (stdout, said) = done(&args, "");
        assert!(stdout.is_empty() && said.contains("2 images"), "{said}");
        assert!(fs::read(&out).unwrap() == expected, "{options:?}");
    }
    // The object beside the options; the archive of one image and of several, on standard output.
    let linear = json!({"space": "linear"}).to_string();
    let expected = answer(&server, &scratch, &with(json!({"space": "linear"})), "*/*").await;
    assert!(done(&["blend", &one, &two, "-", "-o", "-"], &linear).0 == expected);
    let steps = with(json!({"steps": 3}));
    let archive = answer(&server, &scratch, &steps, "application/zip").await;
    let (stdout, said) = done(&["blend", &one, &two, "--steps", "3", "-o", "-"], "");
    assert!(
        stdout == archive && said.starts_with("3 frames of 2 images"),
        "{said}"
    );
    let (frames, gif) = (path("frames/"), path("morph.gif"));
    done(&["blend", &one, &two, "--steps", "3", "-o", &frames], "");
    let mut archive = zip::ZipArchive::new(Cursor::new(archive)).unwrap();
    for k in 0..archive.len() {
        let (mut entry, mut bytes) = (archive.by_index(k).unwrap(), Vec::new());
        entry.read_to_end(&mut bytes).unwrap();
        assert!(fs::read(format!("{frames}{}", entry.name().unwrap())).unwrap() == bytes);
    }
    assert_eq!(fs::read_dir(&frames).unwrap().count(), archive.len());
    done(&["blend", &one, &two, "--steps", "3", "-o", &gif], "");
    assert!(fs::read(&gif).unwrap() == answer(&server, &scratch, &steps, "image/gif").await);
}

#[tokio::test]
async fn landmark_files_are_found_by_name_in_folders_and_in_one_file() {
    let (scratch, server) = (folder(), Server::start(&[]).await);
    let path = |name: &str| scratch.path(name);
    let blend = json!({"images": [{"image": 0}, {"image": 1}]});
    let expected = answer(&server, &scratch, &blend, "image/png").await;
    let blended = |args: &[&str]| {
        let out = path("out.png");
        done(&[&["blend"], args, &["-o", &out]].concat(), "");
        fs::read(out).unwrap()
    };
    let [one, two, first, second] = ["one.png", "two.png", "one.csv", "two.csv"].map(path);
    let directory = path("landmarks");
    fs::create_dir(&directory).unwrap();
    for (name, text) in [("one", FIRST), ("two", SECOND)] {
        fs::write(format!("{directory}/{name}.txt"), text).unwrap();
    }
    let others = ["1.csv", "2.csv"].map(path);
    fs::write(&others[0], FIRST).unwrap();
    fs::write(&others[1], SECOND).unwrap();
    for landmarks in [
        &[&*first, &*second][..],
        &[&*second, &*first],
        &[&*directory],
        &[&*others[0], &*others[1]],
    ] {
        let args = [&[&*one, &*two, "--landmarks"], landmarks].concat();
        assert!(blended(&args) == expected, "{landmarks:?}");
    }
    // One file with an item for each image, by the name of the image or as the object says.
    let tps = |names: [&str; 2]| {
        let specimen = |name: &str, csv: &str, height: f64| {
            // tpsDig counts from the lower left corner.
            let lines = csv.lines().skip(1).map(|line| {
                let numbers = line.split(',').skip(1).map(|n| n.parse::<f64>().unwrap());
                let [x, y] = numbers.collect::<Vec<_>>().try_into().unwrap();
                format!("{x} {}\n", height - y)
            });
            let points: String = lines.collect();
            format!("LM=4\n{points}IMAGE={name}\nID={name}\n")
        };
        specimen(names[0], FIRST, 48.0) + &specimen(names[1], SECOND, 40.0)
    };
    let both = path("both.tps");
    let picture = |file: &[u8]| image::load_from_memory(file).unwrap().to_rgba8();
    let near = |a: &[u8], b: &[u8]| {
        let (a, b) = (picture(a), picture(b));
        a.dimensions() == b.dimensions() && a.iter().zip(b.iter()).all(|(a, b)| a.abs_diff(*b) < 2)
    };
    fs::write(&both, tps(["one.png", "two.png"])).unwrap();
    let named = blended(&[&one, &two, "--landmarks", &both]);
    assert!(near(&named, &expected));
    fs::write(&both, tps(["left", "right"])).unwrap();
    let said = failed(&["blend", &one, &two, "--landmarks", &both, "-o", "-"], "");
    assert!(
        said.starts_with("bad_landmarks: ") && said.contains("both.tps: ") && said.contains("left"),
        "{said}"
    );
    let object = path("blend.json");
    let items = json!({"images": [{"image": 0, "item": "left"}, {"image": 1, "item": 1}]});
    fs::write(&object, items.to_string()).unwrap();
    let chosen = blended(&[&one, &two, &object, "--landmarks", &both]);
    assert!(near(&chosen, &expected));
}

#[test]
fn what_is_wrong_is_said_with_the_file_or_the_option() {
    let scratch = folder();
    let path = |name: &str| scratch.path(name);
    let [one, two, out, first] = ["one.png", "two.png", "out.png", "one.csv"].map(path);
    let third = path("three.png");
    fs::write(&third, photo(20, 20)).unwrap();
    let damaged = path("damaged.png");
    fs::write(&damaged, &photo(64, 48)[..300]).unwrap();
    fs::write(path("damaged.csv"), FIRST).unwrap();
    let few = path("few.csv");
    fs::write(&few, "name,x,y\na,10,10\nb,50,12\n").unwrap();
    let bad = path("bad.csv");
    fs::write(&bad, "name,x,y\na,10,ten\n").unwrap();
    let marks = path("marks");
    fs::write(&marks, FIRST).unwrap();
    let steps = ["--steps", "3", "-o"];
    for (args, stdin, words) in [
        (
            &[&*one, &*third, "-o", &*out][..],
            "",
            &["error: ", "three.png"][..],
        ),
        (
            &[&one, &two, "--landmarks", &first, &first, &few, "-o", &out],
            "",
            &["error: 3 landmark files for 2 images"],
        ),
        (
            &[&one, &damaged, "-o", &out],
            "",
            &["bad_image: ", "damaged.png: "],
        ),
        (
            &[&one, &two, "--landmarks", &first, &bad, "-o", &out],
            "",
            &["bad_landmarks: ", "bad.csv: line 2"],
        ),
        (
            &[&one, &two, "--shape", "1,2,3", "-o", &out],
            "",
            &["bad_value: --shape: expected 2 numbers"],
        ),
        (
            &[&one, &two, "--colour", "NaN,1", "-o", &out],
            "",
            &["bad_value: --colour: expected 2 numbers"],
        ),
        (
            &[&one, &two, "--shape", "1,1", "-o", &out],
            "",
            &["bad_value: --shape: ", "add up to 2"],
        ),
        (
            &[&one, &two, "--space", "lab", "-o", &out],
            "",
            &["bad_value: --space: "],
        ),
        (
            &[&one, &two, "--steps", "3", "-o", &path("out.jpg")],
            "",
            &["error: 3 frames cannot be written to"],
        ),
        (
            &[&one, &two, "--quality", "3", "-o", &out],
            "",
            &["bad_value: --quality: it applies to JPEG"],
        ),
        (
            &[&one, &two, "-o", &path("out.bmp")],
            "",
            &["unsupported_format: "],
        ),
        (
            &[&one, &two, "-o", &one],
            "",
            &["is an input and would be replaced"],
        ),
        (
            &[&one, &two, "--landmarks", &marks, &few, "-o", &marks],
            "",
            &["is an input and would be replaced"],
        ),
        (
            &[&one, &two, "-", steps[0], steps[1], steps[2], &out],
            r#"{"images": 3}"#,
            &["bad_value: standard input: ", "/images"],
        ),
        (
            &[&one, &two, "-", "-o", &out],
            r#"{"images": [{"image": 2}]}"#,
            &["bad_value: ", "`image` is 2"],
        ),
        (
            &[&one, &two, "-", "-o", &out],
            r#"{"imagse": []}"#,
            &["unknown_field: ", "`images`"],
        ),
        (
            &[&few, "--landmarks", &first, "-o", &out],
            "",
            &["unsupported_format: ", "few.csv: "],
        ),
    ] {
        let said = failed(&[&["blend"], args].concat(), stdin);
        for word in words {
            assert!(said.contains(word), "{word}: {args:?}: {said}");
        }
    }
    assert!(!fs::exists(&out).unwrap());
}

/// What face researchers make of two portraits with 68 landmarks: hardly a cell folds (where a
/// closed mouth opens), and an end of a morph is its picture, bit for bit.
#[test]
fn two_portraits_become_others() {
    let scratch = Scratch::new();
    let image = |name: &str| {
        let path = concat!(env!("CARGO_MANIFEST_DIR"), "/../../tests/images/");
        format!("{path}{name}")
    };
    let [first, second] = ["hopper.jpg", "astronaut.png"].map(image);
    let report = |name: &str, options: &[&str]| -> Value {
        let out = scratch.path(name);
        let usual = [
            "--method", "affine", "--alpha", "2", "--format", "png", "-o", &out,
        ];
        done(&[&["blend", &first, &second], options, &usual].concat(), "");
        let archive = fs::File::open(&out).unwrap();
        let mut archive = zip::ZipArchive::new(archive).unwrap();
        serde_json::from_reader(archive.by_name("report.json").unwrap()).unwrap()
    };
    for (name, options) in [
        ("average.zip", &[][..]),
        ("caricature.zip", &["--shape=1.5,-0.5", "--colour=1.5,-0.5"]),
        ("shape.zip", &["--shape=0.5,0.5", "--colour=1,0"]),
        ("colour.zip", &["--shape=1,0", "--colour=0.5,0.5"]),
        ("morph.zip", &["--steps", "7"]),
    ] {
        let report = report(name, options);
        let frames = report["frames"].as_array().unwrap();
        assert_eq!(frames.len(), if name == "morph.zip" { 7 } else { 1 });
        for frame in frames {
            let folds = frame["folds"].as_array().unwrap();
            let most = folds.iter().filter_map(Value::as_u64).max();
            assert!(most.is_some_and(|most| most <= 20), "{name}: {frame}");
        }
    }
    // The halves of a closed mouth are found by position; one file has the landmarks of both.
    let (symmetric, mirror) = (
        scratch.path("symmetric.png"),
        r#"{"images": [{"image": 0}, {"image": 1, "mirror": true}]}"#,
    );
    done(&["blend", &first, &first, "-", "-o", &symmetric], mirror);
    let mut archive = zip::ZipArchive::new(fs::File::open(scratch.path("morph.zip")).unwrap());
    let mut start = Vec::new();
    let archive = archive.as_mut().unwrap();
    archive
        .by_name("0000.png")
        .unwrap()
        .read_to_end(&mut start)
        .unwrap();
    let whole = scratch.path("whole.png");
    done(&["warp", &first, "-", "-o", &whole], "{\"p\": []}");
    let pixels = |file: &[u8]| image::load_from_memory(file).unwrap().into_rgb8();
    assert_eq!(pixels(&start), pixels(&fs::read(&whole).unwrap()));
}
