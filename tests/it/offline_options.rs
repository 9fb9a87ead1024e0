//! The options of the subcommands that JSON has too, fields that two files give, and the help
//! texts.

use std::fs;

use serde_json::{Value, json};

use crate::support::picture::decoded;
use crate::support::program::{done, run};
use crate::support::{Scratch, photo};

fn failed(args: &[&str], stdin: &str) -> String {
    let output = run(args, stdin);
    assert!(
        !output.status.success() && output.stdout.is_empty(),
        "{args:?}: {output:?}"
    );
    String::from_utf8(output.stderr).unwrap()
}

fn warp() -> Value {
    json!({"p": [[10, 10], [50, 12], [30, 35]], "q": [[14, 10], [45, 12], [30, 30]]})
}

fn with(mut object: Value, fields: &Value) -> String {
    object
        .as_object_mut()
        .unwrap()
        .extend(fields.as_object().unwrap().clone());
    object.to_string()
}

/// A picture and a warp object in a folder.
fn files() -> (Scratch, String, String) {
    let scratch = Scratch::new();
    let (image, handles) = (scratch.path("image.png"), scratch.path("warp.json"));
    fs::write(&image, photo(60, 40)).unwrap();
    fs::write(&handles, warp().to_string()).unwrap();
    (scratch, image, handles)
}

#[test]
fn an_option_is_the_field_of_its_name_and_counts_more_than_it() {
    let (_scratch, image, handles) = files();
    let frame = json!({"output": {"canvas": "fit", "width": 33}});
    let warps: &[(&[&str], Value)] = &[
        (&["--method", "tps"], json!({"method": "tps"})),
        (
            &["--method", "affine", "--alpha", "0.75"],
            json!({"method": "affine", "alpha": 0.75}),
        ),
        (&["--strength", "-0.5"], json!({"strength": -0.5})),
        (&["--strength=.5"], json!({"strength": 0.5})),
        (&["--canvas", "fit", "--width", "33"], frame.clone()),
        (
            &["--format", "jpeg", "--quality", "30"],
            json!({"output": {"format": "jpeg", "quality": 30}}),
        ),
    ];
    for (options, fields) in warps {
        let expected = done(&["warp", &image, "-", "-o", "-"], &with(warp(), fields)).0;
        let found = done(
            &[&["warp", &*image, &*handles, "-o", "-"], *options].concat(),
            "",
        )
        .0;
        assert!(found == expected, "{options:?}");
        // Other values in the JSON do not count, without a word.
        let other = json!({"method": "similarity", "strength": 3,
            "output": {"width": 7, "canvas": "same", "quality": 99}});
        let other = if fields.get("alpha").is_some() {
            json!({"alpha": 3})
        } else {
            other
        };
        let over = with(warp(), &other);
        let both: Vec<&str> = [
            &[
                "warp",
                &*image,
                "-",
                "-o",
                "-",
                "--method",
                "rigid",
                "--strength",
                "1",
            ],
            *options,
        ]
        .concat();
        if !options.contains(&"--method")
            && !options[0].starts_with("--strength")
            && !options.contains(&"--format")
        {
            assert!(done(&both, &over).0 == expected, "{options:?}");
        }
    }
    let rest = json!({"extent": [60, 40]});
    for (subcommand, options, fields) in [
        (
            "points",
            &["--method", "tps", "--strength", "0.5"][..],
            json!({"method": "tps", "strength": 0.5, "points": [[5, 6]]}),
        ),
        (
            "report",
            &["--alpha", "2", "--canvas", "fit"],
            json!({"alpha": 2, "output": {"canvas": "fit"}}),
        ),
        (
            "map",
            &["--canvas=-5,0,30,20", "--width", "15"],
            json!({"canvas": {"x": -5, "y": 0, "width": 30, "height": 20}, "width": 15}),
        ),
        (
            "map",
            &["--direction", "forward", "--strength", "2"],
            json!({"direction": "forward", "strength": 2}),
        ),
    ] {
        let out = if subcommand == "map" {
            &["-o", "-"][..]
        } else {
            &[]
        };
        let expected = done(
            &[&[subcommand, "-"], out].concat(),
            &with(serde_json::from_str(&with(warp(), &rest)).unwrap(), &fields),
        )
        .0;
        let json = if subcommand == "points" {
            json!({"points": [[5, 6]]})
        } else {
            json!({})
        };
        let found = done(
            &[&[subcommand, "-", "--extent", "60,40"], options, out].concat(),
            &with(warp(), &json),
        )
        .0;
        assert!(found == expected, "{subcommand} {options:?}");
    }
    for (options, fields) in [
        (
            &["--steps", "3", "--easing", "ease-in-out", "--and-back"][..],
            json!({"steps": 3, "easing": "ease-in-out", "and_back": true}),
        ),
        (
            &["--steps", "2", "--format", "jpeg", "--width", "20"],
            json!({"steps": 2, "output": {"format": "jpeg", "width": 20}}),
        ),
    ] {
        let expected = done(&["batch", &image, "-", "-o", "-"], &with(warp(), &fields)).0;
        assert!(
            done(
                &[&["batch", &*image, &*handles, "-o", "-"], options].concat(),
                ""
            )
            .0 == expected,
            "{options:?}"
        );
    }
}

#[test]
fn animations_have_their_options() {
    let (scratch, image, handles) = files();
    for extension in ["gif", "png", "apng"] {
        let (one, other) = (
            scratch.path(&format!("one.{extension}")),
            scratch.path(&format!("other.{extension}")),
        );
        let fields = json!({"steps": 3, "delay": 100, "loop": 2, "and_back": true});
        done(&["batch", &image, "-", "-o", &one], &with(warp(), &fields));
        let options = [
            "--steps",
            "3",
            "--delay",
            "100",
            "--loop",
            "2",
            "--and-back",
        ];
        let said = done(
            &[&["batch", &*image, &*handles, "-o", &*other], &options[..]].concat(),
            "",
        )
        .1;
        assert!(
            said == "5 frames\n" && fs::read(one).unwrap() == fs::read(other).unwrap(),
            "{extension}: {said}"
        );
    }
}

#[test]
fn a_wrong_option_is_named_and_so_is_the_file_of_a_wrong_field() {
    let (scratch, image, handles) = files();
    let (batch, list) = (scratch.path("batch.json"), scratch.path("list.json"));
    fs::write(&list, "[1]").unwrap();
    let out = scratch.path("out.png");
    let cases: &[(&[&str], &str, &str)] = &[
        (
            &["warp", &image, &handles, "-o", &out, "--strength", "50"],
            "",
            "bad_value: --strength: expected a number between -10 and 10",
        ),
        (
            &["warp", &image, &handles, "-o", &out, "--method", "rigit"],
            "",
            "bad_value: --method: expected one of ",
        ),
        (
            &["warp", &image, &handles, "-o", &out, "--alpha", "much"],
            "",
            "bad_value: --alpha: expected a number; found a string",
        ),
        (
            &["warp", &image, &handles, "-o", &out, "--width", "0"],
            "",
            "bad_value: --width: expected a width",
        ),
        (
            &["warp", &image, &handles, "-o", &out, "--quality", "80"],
            "",
            "bad_value: --quality: it applies to JPEG; the output is PNG",
        ),
        (
            &["warp", &image, &handles, "-o", &out, "--alpha", "99"],
            "",
            "alpha_out_of_range: --alpha: ",
        ),
        (
            &[
                "batch",
                &image,
                &handles,
                "-o",
                &out,
                "--steps",
                "2",
                "--quality",
                "80",
            ],
            "",
            "bad_value: --quality: it applies to JPEG; ",
        ),
        (
            &[
                "batch",
                &image,
                &handles,
                "-o",
                "-",
                "--steps",
                "2",
                "--quality",
                "80",
            ],
            "",
            "bad_value: --quality: it applies to JPEG; ",
        ),
        (
            &["batch", &image, &handles, "-o", &out, "--steps", "1"],
            "",
            "bad_value: --steps: expected a whole number of frames, at least 2",
        ),
        (
            &[
                "batch", &image, &handles, "-o", &out, "--steps", "2", "--loop", "-1",
            ],
            "",
            "bad_value: --loop: expected how often",
        ),
        (
            &["batch", &image, &handles, "-o", &out],
            "",
            "bad_value: the poses are missing: give --steps N, ",
        ),
        (
            &["batch", &image, &handles, &list, "-o", &out],
            "",
            "malformed_request: ",
        ),
        (
            &["points", &handles, "--extent", "60,40", "--strength", "x"],
            "",
            "bad_value: --strength: expected a number",
        ),
    ];
    for (args, stdin, sentence) in cases {
        let said = failed(args, stdin);
        assert!(
            said.starts_with(sentence) && !said.contains("(/"),
            "{args:?}: {said}"
        );
    }
    let folder = std::path::Path::new(&image)
        .parent()
        .unwrap()
        .to_str()
        .unwrap();
    for (args, sentence) in [
        (
            &["batch", &*image, &*image, "--steps", "2", "-o", &*out][..],
            format!("error: {image} is an image; the warp object is JSON"),
        ),
        (
            &["fit", &image, "--extent", "60,40"],
            format!("error: {image} is an image; the warp object is JSON"),
        ),
        (
            &["batch", folder, &handles, "--steps", "2", "-o", &out],
            format!("error: {folder:?} is a folder; the image is one file"),
        ),
        (
            &["map", &handles, "--image", folder, "-o", "-"],
            format!("error: {folder:?} is a folder; the image is one file"),
        ),
    ] {
        let said = failed(args, "");
        assert!(said.starts_with(&sentence), "{args:?}: {said}");
    }
    let landmarks = format!("{folder}/landmarks.csv");
    fs::write(&landmarks, "name,x,y\na,1,2\n").unwrap();
    for command in ["fit", "report", "map"] {
        let out = ["-o", "-"];
        let said = failed(
            &[&[command, &landmarks, "--extent", "60,40"], &out[..]].concat(),
            "",
        );
        let cure = "is not JSON; the warp object is. A landmark file is given as --landmarks ";
        assert!(said.contains(cure), "{command}: {said}");
    }
    // A field of a file has its pointer too.
    for (text, sentence) in [
        (
            r#"{"steps": "many"}"#,
            "bad_value: FILE: expected a whole number of frames",
        ),
        (
            r#"{"steps": 2, "output": {"width": -4}}"#,
            "bad_value: FILE: expected a width",
        ),
        (
            r#"{"steps": 2, "q": [[1, 2], [3]]}"#,
            "bad_value: FILE: expected a handle",
        ),
        (r#"{"steps": 2, "q": [[1, 2]]}"#, "shape_mismatch: FILE: "),
        (
            r#"{"steps": 2, "stps": 2}"#,
            "unknown_field: FILE: unknown field: `stps`",
        ),
        (
            r#"{"steps": 2, "steps": 3}"#,
            "malformed_request: FILE: the field `steps` is given twice",
        ),
        (r#"{"steps": 2,"#, "malformed_request: FILE: not JSON: "),
        (
            r#"{"jitter": {"seed": 1, "count": 0, "sigma": 1}}"#,
            "bad_value: FILE: expected a whole number of frames, at least 1",
        ),
    ] {
        fs::write(&batch, text).unwrap();
        let said = failed(&["batch", &image, &handles, &batch, "-o", &out], "");
        assert!(
            said.lines()
                .last()
                .unwrap()
                .starts_with(&sentence.replace("FILE", &batch)),
            "{text}: {said}"
        );
    }
    fs::write(&handles, r#"{"p": [[1, 1]], "q": [[2, 2], [3, 3]]}"#).unwrap();
    let said = failed(&["warp", &image, &handles, "-o", &out], "");
    assert!(
        said.starts_with(&format!("shape_mismatch: {handles}: ")),
        "{said}"
    );
    fs::write(&image, "no image").unwrap();
    for args in [
        &["warp", &*image, "-", "-o", &*out][..],
        &["batch", &image, "-", "-o", &out],
        &["report", "-", "--image", &image],
    ] {
        let said = failed(
            args,
            &with(warp(), &json!({})).replace(
                '}',
                if args[0] == "batch" {
                    ", \"steps\": 2}"
                } else {
                    "}"
                },
            ),
        );
        assert!(
            said.starts_with(&format!("unsupported_format: {image}: ")),
            "{args:?}: {said}"
        );
    }
    let landmarks = scratch.path("landmarks.csv");
    fs::write(&landmarks, "px,py,qx,qy\n1,2,3\n").unwrap();
    fs::write(&image, photo(60, 40)).unwrap();
    for args in [
        &["warp", &*image, "--landmarks", &*landmarks, "-o", &*out][..],
        &[
            "batch",
            &image,
            "--landmarks",
            &landmarks,
            "--steps",
            "2",
            "-o",
            &out,
        ],
        &["points", "--landmarks", &landmarks, "--extent", "60,40"],
    ] {
        let said = failed(args, "");
        assert!(
            said.starts_with(&format!("bad_landmarks: {landmarks}: line 2, column ")),
            "{args:?}: {said}"
        );
    }
}

#[test]
fn of_a_field_in_two_files_the_later_one_counts_and_both_are_named() {
    let (scratch, image, _) = files();
    let (one, two, both) = (
        scratch.path("one.json"),
        scratch.path("two.json"),
        scratch.path("both.json"),
    );
    let q = json!([[12, 10], [48, 12], [30, 33]]);
    fs::write(
        &one,
        with(
            warp(),
            &json!({"strength": 2, "output": {"format": "jpeg", "width": 30}, "steps": 4}),
        ),
    )
    .unwrap();
    fs::write(
        &two,
        json!({"q": q, "steps": 2, "strength": null, "output": {"width": 20}}).to_string(),
    )
    .unwrap();
    fs::write(
        &both,
        with(
            warp(),
            &json!({"q": q, "strength": 2, "steps": 2, "output": {"format": "jpeg", "width": 20}}),
        ),
    )
    .unwrap();
    let (found, said) = done(&["batch", &image, &one, &two, "-o", "-"], "");
    assert!(found == done(&["batch", &image, &both, "-o", "-"], "").0);
    let mut lines: Vec<&str> = said.lines().collect();
    assert_eq!(lines.pop(), Some("2 frames"));
    lines.sort_unstable();
    let replaced =
        ["output.width", "q", "steps"].map(|field| format!("{two} replaces `{field}` of {one}"));
    assert_eq!(lines, replaced);
    let said = failed(
        &["points", "-", &two, "--extent", "60,40"],
        &json!({"p": warp()["p"], "points": [[1, 1]]}).to_string(),
    );
    assert!(
        said.starts_with(&format!("unknown_field: {two}: unknown field: `steps`")),
        "no field is in both: {said}"
    );
}

#[test]
fn layers_of_the_json_are_chosen_among_those_of_the_options() {
    let (scratch, image, handles) = files();
    let (mask, depth) = (format!("mask={image}:labels"), format!("depth={image}"));
    let entries = |out: &[u8]| {
        let archive = zip::ZipArchive::new(std::io::Cursor::new(out)).unwrap();
        archive
            .file_names()
            .map(|name| name.unwrap().into_owned())
            .collect::<Vec<String>>()
    };
    let layers = ["--layer", &*mask, "--layer", &*depth];
    let batch = |json: &Value, more: &[&str]| {
        let args: Vec<&str> = [&["batch", &*image, &*handles, "-", "-o", "-"], more].concat();
        done(&args, &with(json!({"steps": 2}), json))
    };
    let all = entries(&batch(&json!({}), &layers).0);
    assert!(
        all.contains(&"0000.mask.png".to_owned()) && all.contains(&"0000.depth.png".to_owned()),
        "{all:?}"
    );
    let (some, said) = batch(&json!({"layers": ["mask", "@coverage"]}), &layers);
    let some = entries(&some);
    assert!(
        some.contains(&"0001.mask.png".to_owned())
            && some.contains(&"0001.@coverage.png".to_owned()),
        "{some:?}"
    );
    assert!(
        !some.contains(&"0001.depth.png".to_owned())
            && said.contains("the layer depth is not drawn"),
        "{said}"
    );
    let said = failed(
        &[&["batch", &*image, &*handles, "-", "-o", "-"], &layers[..]].concat(),
        r#"{"steps": 2, "layers": ["dept"]}"#,
    );
    assert!(
        said.starts_with(
            "no_such_layer: standard input: `dept` has no file: give it as \
        --layer dept=FILE (/layers)"
        ),
        "{said}"
    );
    let upper = format!("MASK={image}");
    let folder = scratch.path("folder/");
    let said = failed(
        &[
            "batch", &image, &handles, "--steps", "2", "--layer", &mask, "--layer", &upper, "-o",
            &folder,
        ],
        "",
    );
    assert!(
        said.contains("upper and lower case are not told apart") || said.contains("case"),
        "{said}"
    );
    assert!(fs::metadata(&folder).is_err());
}

/// Lines of 100 columns, as in a pipe.
fn help(args: &[&str]) -> String {
    let (stdout, _) = done(args, "");
    String::from_utf8(stdout).unwrap()
}

#[test]
fn help_begins_with_examples_and_is_short() {
    for subcommand in ["warp", "points", "map", "report", "fit", "batch"] {
        let text = help(&[subcommand, "--help"]);
        let lines = text.lines().count();
        assert!(
            lines <= 60 && (subcommand != "warp" || lines <= 52),
            "{subcommand}: {lines} lines\n{text}"
        );
        let [examples, usage] = ["Examples:\n", "Usage: "].map(|head| text.find(head).unwrap());
        assert!(
            examples < usage
                && text.contains(&format!("mlswarp {subcommand} "))
                && text.contains("--help-limits"),
            "{text}"
        );
        assert!(
            !text.contains("--max-body-bytes") && !text.contains("MLSWARP_"),
            "{text}"
        );
        let limits = help(&[subcommand, "--help-limits"]);
        assert!(
            limits.contains("--max-body-bytes")
                && limits.contains("MLSWARP_WORKERS")
                && !limits.contains("--landmarks"),
            "{limits}"
        );
        assert_eq!(
            limits,
            help(&["--workers", "2", subcommand, "a.png", "--help-limits"]),
            "whatever else is given"
        );
    }
    let text = help(&["--help"]);
    assert!(
        text.lines().count() < 40
            && text.contains("mlswarp serve --help")
            && !text.contains("--max-body-bytes"),
        "{text}"
    );
    for name in [
        "serve", "warp", "points", "map", "batch", "report", "fit", "health",
    ] {
        assert!(
            text.lines().any(|line| line.trim_start().starts_with(name)),
            "{name}"
        );
    }
}

#[test]
fn a_mistyped_option_suggests_one_of_its_own_subcommand() {
    for (args, own) in [
        (
            &["warp", "a.png", "b.json", "-o", "c.png", "--strengh", "1"][..],
            Some("'--strength'"),
        ),
        (
            &["warp", "a.png", "b.json", "-o", "c.png", "--stor", "1"],
            None,
        ),
        (
            &["warp", "a.png", "b.json", "-o", "c.png", "--listn", "1"],
            None,
        ),
        (
            &[
                "warp",
                "a.png",
                "b.json",
                "-o",
                "c.png",
                "--max-body-byte",
                "1",
            ],
            Some("'--max-body-bytes'"),
        ),
        (
            &["points", "b.json", "--strenth", "1"],
            Some("'--strength'"),
        ),
        (
            &["map", "b.json", "-o", "c.npy", "--canvs", "fit"],
            Some("'--canvas'"),
        ),
        (
            &["report", "b.json", "--landmark", "1"],
            Some("'--landmarks'"),
        ),
        (
            &["batch", "a.png", "b.json", "-o", "c.gif", "--step", "24"],
            Some("'--steps'"),
        ),
        (&["serve", "--stor", "memory"], Some("'--store'")),
        (&["health", "--listn", "1"], Some("'--listen'")),
    ] {
        let output = run(args, "");
        let said = String::from_utf8(output.stderr).unwrap();
        assert_eq!(output.status.code(), Some(2), "{said}");
        let tip = said.lines().find(|line| line.contains("similar"));
        assert!(
            own.map_or(tip.is_none(), |own| tip
                .is_some_and(|tip| tip.contains(own))),
            "{args:?}: {said}"
        );
    }
}

#[test]
fn a_gif_shows_the_frames_of_the_archive() {
    let (scratch, image, handles) = files();
    let (gif, folder) = (scratch.path("cat.gif"), scratch.path("frames/"));
    let options = ["--steps", "4", "--and-back", "--delay", "70"];
    for out in [&gif, &folder] {
        let options = if out == &gif {
            &options[..]
        } else {
            &options[..3]
        };
        done(
            &[&["batch", &*image, &*handles, "-o", &**out], options].concat(),
            "",
        );
    }
    use image::AnimationDecoder as _;
    let frames = image::codecs::gif::GifDecoder::new(std::io::Cursor::new(fs::read(gif).unwrap()))
        .unwrap()
        .into_frames();
    let frames = frames.collect_frames().unwrap();
    assert_eq!(frames.len(), 6);
    for (k, frame) in frames.iter().enumerate() {
        assert_eq!(frame.delay().numer_denom_ms().0, 70);
        let picture = decoded(&fs::read(format!("{folder}/{k:04}.png")).unwrap());
        let channels = picture.samples.len() / (60 * 40);
        let (mut total, mut worst, mut opaque) = (0_u64, 0, 0);
        for (found, expected) in frame
            .buffer()
            .pixels()
            .zip(picture.samples.chunks(channels))
        {
            let is_opaque = channels == 3 || expected[3] >= 128;
            assert_eq!(found.0[3] == 255, is_opaque);
            if is_opaque {
                let off = (0..3)
                    .map(|c| found.0[c].abs_diff(expected[c]))
                    .max()
                    .unwrap();
                (total, worst, opaque) = (total + u64::from(off), worst.max(off), opaque + 1);
            }
        }
        // A photograph in 256 colours.
        assert!(
            worst <= 64 && total <= 8 * opaque,
            "frame {k}: {worst}, {total} of {opaque}"
        );
    }
}
