//! JSON that is malformed, has unknown fields, is nested deeply or contains `null`.

use super::*;

#[test]
fn malformed_is_400_before_any_meaning() {
    use Code::MalformedRequest as M;
    let table: &[Expected] = &[
        ("", M, None, None),
        ("{", M, None, None),
        ("{}{}", M, None, None),
        ("[]", M, None, None),
        ("null", M, None, None),
        ("1e999", M, None, None),
        ("\"p\"", M, None, None),
        ("{\"p\": [[NaN, 1]]}", M, None, None),
        ("{\"p\": [[Infinity, 1]]}", M, None, None),
        ("{\"p\": [[01, 1]]}", M, None, None),
        ("{\"p\": [[.5, 1]]}", M, None, None),
        ("{\"p\": [[+1, 1]]}", M, None, None),
        ("{\"p\": [[1, 2],]}", M, None, None),
        ("{'p': []}", M, None, None),
        ("\u{feff}{}", M, None, None),
        // The unknown field and the bad value come first in the text; the broken end decides.
        ("{\"nope\": 1, \"alpha\": \"x\"", M, None, None),
        ("{\"p\": [], \"p\": []}", M, Some("/p"), None),
        ("{\"p\": [], \"\\u0070\": []}", M, Some("/p"), None),
        (
            "{\"output\": {\"width\": 1, \"width\": 2}}",
            M,
            Some("/output/width"),
            None,
        ),
        (
            "{\"grid\": {\"cell\": 1, \"cell\": 2}}",
            M,
            Some("/grid/cell"),
            None,
        ),
        ("{\"method\": \"\\ud800\"}", M, Some("/method"), None),
        ("{\"\\ud800\": 1}", M, None, None),
    ];
    check(WarpObject::parse, table);
    check(|json| DragObject::parse(json, usize::MAX), &table[..16]);
    check(points, &table[..16]);
    check(posed_points, &table[..16]);
    assert_eq!(WarpObject::parse(b"{\"p\": \xff}").unwrap_err().code, M);
}

#[test]
fn malformed_names_line_and_column() {
    assert_eq!(
        detail("{\"p\":\n [NaN]}"),
        "not JSON: expected value at line 2 column 3; JSON has neither NaN nor infinity"
    );
    assert!(detail("[1]").contains("found an array"));
    assert_eq!(
        detail("{\"p\": [], \"p\": []}"),
        "the field `p` is given twice"
    );
}

#[test]
fn unknown_fields_are_named_with_what_is_known() {
    use Code::UnknownField as U;
    let table: &[Expected] = &[
        ("{\"handles\": []}", U, Some("/handles"), None),
        ("{\"P\": []}", U, Some("/P"), None),
        ("{\"\": []}", U, Some("/"), None),
        ("{\"a/b~c\": [1e999]}", U, Some("/a~1b~0c"), None),
        ("{\"seq\": 1}", U, Some("/seq"), None),
        ("{\"extent\": [1, 1]}", U, Some("/extent"), None),
        (
            "{\"output\": {\"depth\": 3}}",
            U,
            Some("/output/depth"),
            None,
        ),
        ("{\"grid\": {\"cells\": 3}}", U, Some("/grid/cells"), None),
    ];
    check(WarpObject::parse, table);
    check(
        |json| DragObject::parse(json, usize::MAX),
        &[("{\"q\": [], \"p\": []}", U, Some("/p"), None)],
    );
    check(
        posed_points,
        &[("{\"q\": [], \"extent\": [1, 1]}", U, Some("/extent"), None)],
    );
    assert_eq!(
        detail("{\"grid\": {\"x\": 3}}"),
        "unknown field: `x`; known fields: `cell`, `columns`, `rows`, `tolerance`"
    );
}

#[test]
fn unknown_field_of_any_length_gives_a_short_answer() {
    let name = "\u{e9}".repeat(100_000);
    let problem =
        WarpObject::parse(format!("{{\"output\": {{\"{name}\": 1}}}}").as_bytes()).unwrap_err();
    assert_eq!(
        (problem.code, problem.pointer.as_deref()),
        (Code::UnknownField, Some("/output"))
    );
    assert!(problem.detail.len() < 400);
    let problem = WarpObject::parse(format!("{{\"method\": \"{name}\"}}").as_bytes()).unwrap_err();
    assert!(problem.detail.len() < 400);
    let problem = WarpObject::parse(format!("{{\"alpha\": 1{}}}", "0".repeat(100_000)).as_bytes())
        .unwrap_err();
    assert_eq!(problem.code, Code::NotFinite);
    assert!(problem.detail.len() < 400);
}

#[test]

fn nesting_of_any_depth_is_refused_without_a_stack() {
    for (open, close) in [("[", "]"), ("{\"a\":", "}")] {
        let deep = format!(
            "{{\"p\": [{}1{}]}}",
            open.repeat(200_000),
            close.repeat(200_000)
        );
        let problem = WarpObject::parse(deep.as_bytes()).unwrap_err();
        assert_eq!((problem.code, problem.handle), (Code::BadValue, Some(0)));
        assert_eq!(
            WarpObject::parse(format!("{{\"p\": {}", open.repeat(200_000)).as_bytes())
                .unwrap_err()
                .code,
            Code::MalformedRequest
        );
    }
}

#[test]
fn null_is_absence_for_fields_a_missing_handle_and_else_a_wrong_value_in_arrays() {
    use Code::{BadValue as B, MalformedRequest as M, UnknownField as U};
    assert_eq!(
        WarpObject::parse(b"{\"grid\": {\"cell\": 2, \"columns\": null, \"rows\": null}}")
            .unwrap()
            .rest
            .grid,
        GridSpec::Cell(2.0)
    );
    assert_eq!(
        WarpObject::parse(b"{\"p\": [[1, 2]], \"q\": null}")
            .unwrap()
            .posed()
            .unwrap_err()
            .pointer
            .as_deref(),
        Some("/q")
    );
    let absent = b"{\"q\": [], \"points\": null, \"polygons\": null, \
        \"boxes\": null, \"inverse\": null, \"refine\": null}";
    assert_eq!(posed_points(absent), posed_points(b"{\"q\": []}"));
    assert_eq!(
        DragObject::parse_posed(b"{\"q\": [], \"seq\": null}", usize::MAX),
        DragObject::parse_posed(b"{\"q\": []}", usize::MAX)
    );
    check(
        WarpObject::parse,
        &[
            ("{\"p\": [[null]]}", B, Some("/p/0/0"), Some(0)),
            ("{\"q\": [[[1, 2], null]]}", B, Some("/q/0/1"), Some(0)),
            ("{\"weights\": [1, null]}", B, Some("/weights/1"), Some(1)),
            ("{\"alpha\": null, \"alpha\": 1}", M, Some("/alpha"), None),
            ("{\"alphas\": null}", U, Some("/alphas"), None),
        ],
    );
    check(
        points,
        &[
            ("{\"extent\": [4, null]}", B, Some("/extent/1"), None),
            (
                "{\"extent\": [4, 4], \"points\": [null, [1, null]]}",
                B,
                Some("/points/1/1"),
                None,
            ),
        ],
    );
    for (problem, field) in [
        (
            DragObject::parse(b"{\"q\": null}", usize::MAX)
                .unwrap()
                .pose
                .onto(None)
                .unwrap_err(),
            "`q`",
        ),
        (
            DragObject::parse_posed(b"{\"q\": null}", usize::MAX)
                .unwrap()
                .pose
                .onto(None)
                .unwrap_err(),
            "`q`",
        ),
        (
            posed_points(b"{\"q\": null}")
                .unwrap()
                .pose
                .onto(None)
                .unwrap_err(),
            "`q`",
        ),
        (points(b"{\"extent\": null}").unwrap_err(), "`extent`"),
    ] {
        assert!(
            problem.code == B && problem.detail.starts_with(&format!("{field} is missing")),
            "{problem}"
        );
    }
}
