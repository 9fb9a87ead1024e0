use std::collections::BTreeMap;

use mlswarp::pixmap::Extent;
use mlswarp::render::Canvas;
use mlswarp::warp::Units;

use super::*;
use crate::wire::AsJson;

fn free(_: u64) -> Result<(), Problem> {
    Ok(())
}

fn parse(text: &str) -> Result<BatchObject, Problem> {
    let source = CoordinateFrame::of_source(Extent::new(100, 80).unwrap(), Units::Px);
    let body = Bytes::copy_from_slice(text.as_bytes());
    Reserved::<BatchObject, _>::parse(&body, 1000, 100, source, &|| false, free)
        .map(|read| read.into_parts().0)
}

#[test]
fn the_three_forms_are_read() {
    let frames = parse(
        r#"{"frames": [{"q": [[1, 2]]}, {"strength": 0.5, "q": [[3, 4]]}],
          "points": [[1, 1]], "output": {"width": 9}}"#,
    )
    .unwrap();
    let BatchPoses::Frames(texts) = &frames.poses else {
        panic!()
    };
    let strength = |frame| texts.read(frame, free).unwrap().strength;
    assert_eq!(
        (frames.count(), strength(0), strength(1)),
        (2, None, Some(0.5))
    );
    assert_eq!(
        (frames.annotations.kinds.len(), frames.output.width),
        (1, Some(9))
    );
    let steps = parse(
        r#"{"q": [[1, 2]], "steps": 24, "easing": "ease-in-out", "strength": 2, "delay": 20}"#,
    )
    .unwrap();
    let BatchPoses::Steps {
        steps: 24,
        easing: Easing::EaseInOut,
        pose: PosePatch {
            strength: Some(2.0),
            ..
        },
    } = steps.poses
    else {
        panic!()
    };
    assert_eq!(steps.delay, Some(20));
    let jitter =
        parse(r#"{"jitter": {"seed": 18446744073709551615, "count": 100, "sigma": 2.5}}"#).unwrap();
    let BatchPoses::Jitter {
        jitter: Jitter {
            seed: u64::MAX,
            sigma: 2.5,
        },
        count: 100,
        pose: PosePatch { q: None, .. },
    } = jitter.poses
    else {
        panic!()
    };
}

#[test]
fn the_way_back_repeats_neither_end_unless_the_animation_ends() {
    let count = |text: &str| parse(text).unwrap().count();
    assert_eq!(count(r#"{"steps": 24, "and_back": true}"#), 46);
    assert_eq!(count(r#"{"steps": 24, "and_back": true, "loop": 0}"#), 46);
    assert_eq!(
        count(r#"{"steps": 24, "and_back": true, "loop": 2}"#),
        47,
        "it ends at rest"
    );
    assert_eq!(count(r#"{"steps": 24, "and_back": false, "loop": 2}"#), 24);
    assert_eq!(
        (
            count(r#"{"steps": 2, "and_back": true}"#),
            count(r#"{"frames": [{}], "and_back": true}"#)
        ),
        (2, 1)
    );
    assert_eq!(count(r#"{"steps": 5001, "and_back": true}"#), 10_000);
    let problem = parse(r#"{"steps": 5001, "loop": 1, "and_back": true}"#).unwrap_err();
    assert_eq!(
        (problem.pointer.as_deref(), problem.actual),
        (Some("/and_back"), Some(10_001.into()))
    );
}

#[test]
fn mistakes_name_their_place() {
    let long = format!(
        r#"{{"frames": [{{"q": []}}, {{"q": [{}]}}]}}"#,
        "[1, 2],".repeat(20) + "[1, 2]"
    );
    let many = format!(r#"{{"frames": [{}1]}}"#, "1,".repeat(10_000));
    let much = format!(r#"{{"q": [{}[1, 2]], "steps": 2}}"#, "[1, 2],".repeat(200));
    for (text, code, pointer) in [
        ("{}", Code::BadValue, Some("/steps")),
        (r#"{"q": []}"#, Code::BadValue, Some("/steps")),
        (r#"{"frames": 24}"#, Code::BadValue, Some("/frames")),
        (
            r#"{"q": [], "frames": 24, "easing": "linear"}"#,
            Code::BadValue,
            Some("/frames"),
        ),
        (r#"{"q": [], "steps": 1}"#, Code::BadValue, Some("/steps")),
        (
            r#"{"steps": 2, "loop": 65536}"#,
            Code::BadValue,
            Some("/loop"),
        ),
        (
            r#"{"steps": 2, "loop": true}"#,
            Code::BadValue,
            Some("/loop"),
        ),
        (
            r#"{"steps": 2, "and_back": 1}"#,
            Code::BadValue,
            Some("/and_back"),
        ),
        (
            r#"{"jitter": {"seed": 1, "count": 1, "sigma": 1}, "and_back": true}"#,
            Code::BadValue,
            Some("/and_back"),
        ),
        (r#"{"frames": []}"#, Code::BadValue, Some("/frames")),
        (r#"{"frames": {}}"#, Code::BadValue, Some("/frames")),
        (
            r#"{"frames": [{"q": []}], "q": []}"#,
            Code::BadValue,
            Some("/q"),
        ),
        (
            r#"{"frames": [{"q": []}], "steps": 2}"#,
            Code::BadValue,
            Some("/steps"),
        ),
        (
            r#"{"q": [], "steps": 2, "jitter": {}}"#,
            Code::BadValue,
            Some("/jitter"),
        ),
        (r#"{"q": [], "steps": 0}"#, Code::BadValue, Some("/steps")),
        (
            r#"{"q": [], "steps": 10001}"#,
            Code::TooLarge,
            Some("/steps"),
        ),
        (
            r#"{"q": [], "steps": 2, "easing": "bounce"}"#,
            Code::BadValue,
            Some("/easing"),
        ),
        (
            r#"{"q": [], "steps": 2, "delay": 0}"#,
            Code::BadValue,
            Some("/delay"),
        ),
        (
            r#"{"q": [], "steps": 2, "delay": 60001}"#,
            Code::BadValue,
            Some("/delay"),
        ),
        (
            r#"{"q": [], "jitter": {"count": 1, "sigma": 1}}"#,
            Code::BadValue,
            Some("/jitter/seed"),
        ),
        (
            r#"{"q": [], "jitter": {"seed": -1, "count": 1, "sigma": 1}}"#,
            Code::BadValue,
            Some("/jitter/seed"),
        ),
        (
            r#"{"q": [], "jitter": {"seed": 1, "sigma": 1}}"#,
            Code::BadValue,
            Some("/jitter/count"),
        ),
        (
            r#"{"q": [], "jitter": {"seed": 1, "count": 10001, "sigma": 1}}"#,
            Code::TooLarge,
            Some("/jitter/count"),
        ),
        (
            r#"{"q": [], "jitter": {"seed": 1, "count": 1}}"#,
            Code::BadValue,
            Some("/jitter/sigma"),
        ),
        (
            r#"{"q": [], "jitter": {"seed": 1, "count": 1, "sigma": -1}}"#,
            Code::BadValue,
            Some("/jitter/sigma"),
        ),
        (
            r#"{"q": [], "jitter": {"seed": 1, "count": 1, "sigma": 1, "scale": 1}}"#,
            Code::UnknownField,
            Some("/jitter/scale"),
        ),
        (
            r#"{"q": [], "jitter": {"seed": 1, "count": 1, "sigma": 1}, "easing": "linear"}"#,
            Code::BadValue,
            Some("/easing"),
        ),
        (
            r#"{"q": [], "steps": 2, "layers": ["a", "a"]}"#,
            Code::BadValue,
            Some("/layers/1"),
        ),
        (
            r#"{"q": [], "steps": 2, "layers": ["@depth"]}"#,
            Code::BadValue,
            Some("/layers/0"),
        ),
        (
            r#"{"q": [], "steps": 2, "layers": "a"}"#,
            Code::BadValue,
            Some("/layers"),
        ),
        (
            r#"{"q": [], "steps": 2, "inverse": true}"#,
            Code::UnknownField,
            Some("/inverse"),
        ),
        (&long, Code::TooLarge, Some("/frames/1")),
        (&many, Code::TooLarge, Some("/frames")),
        (&much, Code::TooLarge, None),
    ] {
        let problem = parse(text).unwrap_err();
        assert_eq!(
            (problem.code, problem.pointer.as_deref()),
            (code, pointer),
            "{}: {problem}",
            &text[..text.len().min(80)]
        );
    }
    let many = parse(&many).unwrap_err();
    assert_eq!(
        (many.what, many.limit, many.actual),
        (
            Some("batch_frames"),
            Some(10_000.into()),
            Some(10_001.into())
        )
    );
    let BatchPoses::Frames(texts) =
        parse(r#"{"frames": [{"q": []}, {"q": [[1]]}, 7, {"strength": 1}]}"#)
            .unwrap()
            .poses
    else {
        panic!()
    };
    for (frame, pointer) in [(1, "/frames/1/q/0"), (2, "/frames/2")] {
        assert_eq!(
            texts.read(frame, free).unwrap_err().pointer.as_deref(),
            Some(pointer)
        );
    }
    assert_eq!(
        *texts.read(3, free).unwrap(),
        PosePatch {
            q: None,
            strength: Some(1.0)
        }
    );
}

#[test]
fn the_index_has_one_object_for_each_frame() {
    let frame = |position, annotations: Option<&str>| BatchFrame {
        picture: "0000.png".to_owned(),
        layers: BTreeMap::new(),
        annotations: annotations.map(str::to_owned),
        position,
        width: 4,
        height: 3,
        canvas: AsJson(Canvas {
            x: -1,
            y: 0,
            extent: Extent::new(8, 6).unwrap(),
        }),
        scale: [0.5, 0.5],
        folds: 1,
        residual: 0.5,
        warnings: vec!["translation_only"],
        exceeded: None,
    };
    let between = FramePosition {
        strength: 0.5,
        t: Some(0.25),
        jitter: None,
    };
    let jittered = FramePosition {
        strength: 1.0,
        t: None,
        jitter: Some(FrameJitter { seed: 7, frame: 1 }),
    };
    let frames = [frame(between, None), frame(jittered, Some("0001.json"))];
    let canvas = serde_json::json!({"x": -1, "y": 0, "width": 8, "height": 6});
    assert_eq!(
        serde_json::to_value(BatchIndex { frames: &frames }).unwrap(),
        serde_json::json!({"frames": [
            {"picture": "0000.png", "strength": 0.5, "t": 0.25, "width": 4, "height": 3,
                "canvas": canvas, "scale": [0.5, 0.5],
             "folds": 1, "residual": 0.5, "warnings": ["translation_only"]},
            {"picture": "0000.png", "annotations": "0001.json", "strength": 1.0,
                "jitter": {"seed": 7, "frame": 1}, "width": 4,
             "height": 3, "canvas": canvas, "scale": [0.5, 0.5], "folds": 1, "residual": 0.5,
                 "warnings": ["translation_only"]}
        ]})
    );
}
