//! Handles without a position, and the fields that the response of `POST /landmarks` has.

use mlswarp::warp::Warning;

use super::*;

/// What is left of both sides, once the handles are settled.
fn settled(json: &str) -> (Vec<Handle>, Option<Vec<Handle>>, Vec<Warning>) {
    let mut warp =
        WarpObject::parse(json.as_bytes()).unwrap_or_else(|problem| panic!("{json}: {problem}"));
    warp.settle_pose(Extent::new(9, 9).unwrap()).unwrap();
    let warnings = warp.rest.left_out().collect();
    (warp.rest.p, warp.q, warnings)
}

#[test]
fn a_handle_that_is_null_on_either_side_is_left_out_on_both() {
    let p = vec![
        point(1.0, 2.0),
        Handle::Missing,
        Handle::Missing,
        line(&[(3.0, 4.0), (5.0, 6.0)]),
    ];
    let q = vec![
        point(2.0, 2.0),
        Handle::Missing,
        Handle::Missing,
        line(&[(3.0, 5.0), (5.0, 8.0)]),
    ];
    let lines = ("[[3, 4], [5, 6]]", "[[3, 5], [5, 8]]");
    let json = format!(
        "{{\"p\": [[1, 2], null, [7, 7], {}], \"q\": [[2, 2], [8, 8], null, {}]}}",
        lines.0, lines.1
    );
    assert_eq!(
        settled(&json),
        (
            p,
            Some(q),
            vec![Warning::HandlesMissing {
                handles: vec![1, 2]
            }]
        )
    );
    // A strength moves what is there.
    let (_, q, _) = settled(r#"{"p": [[0, 0], null], "q": [[2, 4], [1, 1]], "strength": 0.5}"#);
    assert_eq!(q, Some(vec![point(1.0, 2.0), Handle::Missing]));
    assert_eq!(settled(r#"{"p": [[0, 0]], "q": [[2, 4]]}"#).2, []);
    // Another number of handles is left to be refused.
    assert_eq!(
        settled(r#"{"p": [[0, 0], null], "q": [[2, 4]]}"#).1,
        Some(vec![point(2.0, 4.0)])
    );
}

#[test]
fn what_post_landmarks_answers_is_a_warp_object() {
    let answer = r#"{"p": [[1, 2], null], "q": [[1, 3], [4, 5]], "names": ["a", "b"],
      "units": "px", "format": "pts+csv"}"#;
    let plain = r#"{"p": [[1, 2], null], "q": [[1, 3], [4, 5]]}"#;
    assert_eq!(
        WarpObject::parse(answer.as_bytes()),
        WarpObject::parse(plain.as_bytes())
    );
    // The names that only one side has are a warning.
    let unmatched = |lists: &str| {
        settled(&format!(
            "{{\"p\": [[1, 2]], \"q\": [[1, 3]], \"unmatched\": {lists}}}"
        ))
        .2
    };
    assert_eq!(
        unmatched(r#"{"p": ["c"], "q": []}"#),
        [Warning::LandmarksUnmatched]
    );
    assert_eq!(unmatched(r#"{"p": [], "q": []}"#), []);
    // Other handles of a session are other landmarks.
    let patch = |json: &str, base: &WarpObject| {
        WarpPatch::parse(json.as_bytes())
            .unwrap()
            .merge_onto(base.clone())
            .rest
            .has_unmatched
    };
    let base = WarpObject::parse(br#"{"p": [[1, 2]], "unmatched": {"p": ["c"]}}"#).unwrap();
    assert!(patch(r#"{"alpha": 2}"#, &base) && !patch(r#"{"p": [[3, 4]]}"#, &base));
    for parse in [
        points(with_extent(answer).as_bytes()).map(drop),
        MapObject::parse(with_extent(answer).as_bytes()).map(drop),
    ] {
        parse.unwrap();
    }
    ReportObject::parse(with_extent(answer).as_bytes()).unwrap();
    FitObject::parse(with_extent(answer).as_bytes()).unwrap();
}

fn with_extent(answer: &str) -> String {
    answer.replacen('{', "{\"extent\": [9, 9], ", 1)
}

#[test]
fn fields_of_landmark_files_are_checked() {
    use Code::{BadValue as B, ShapeMismatch as S, UnknownField as U};
    check(
        WarpObject::parse,
        &[
            (
                "{\"p\": [[1, 2]], \"names\": [\"a\", \"b\"]}",
                S,
                Some("/names"),
                None,
            ),
            ("{\"names\": [5]}", B, Some("/names/0"), None),
            ("{\"unmatched\": [\"a\"]}", B, Some("/unmatched"), None),
            (
                "{\"unmatched\": {\"r\": []}}",
                U,
                Some("/unmatched/r"),
                None,
            ),
            ("{\"format\": 5}", U, Some("/format"), None),
            ("{\"format\": \"jpeg\"}", U, Some("/format"), None),
            ("{\"match\": \"order\"}", B, Some("/match"), None),
            ("{\"match\": \"both\"}", B, Some("/match"), None),
            ("{\"item\": 3}", B, Some("/item"), None),
            ("{\"item\": [3]}", B, Some("/item"), None),
        ],
    );
    assert!(
        detail("{\"format\": \"jpeg\"}").contains("put it in `output`: `output.format`"),
        "{}",
        detail("{\"format\": \"jpeg\"}")
    );
    assert!(detail("{\"item\": 3}").contains("belongs to landmark files"));
}
