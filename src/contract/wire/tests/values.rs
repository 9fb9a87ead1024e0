//! Values that are refused: handles, words, colours and numbers.

use super::*;

#[test]
fn handles_name_pointer_and_index() {
    use Code::{BadValue as B, NotFinite as N};
    let table: &[Expected] = &[
        ("{\"p\": {}}", B, Some("/p"), None),
        ("{\"p\": 1}", B, Some("/p"), None),
        ("{\"p\": [1, 2]}", B, Some("/p/0"), Some(0)),
        (
            "{\"p\": [[1, 2], [null, null]]}",
            B,
            Some("/p/1/0"),
            Some(1),
        ),
        (
            "{\"p\": [[1, 2], [[1, 2], null]]}",
            B,
            Some("/p/1/1"),
            Some(1),
        ),
        ("{\"p\": [[1, 2], \"x\"]}", B, Some("/p/1"), Some(1)),
        ("{\"p\": [[]]}", B, Some("/p/0"), Some(0)),
        ("{\"p\": [[1]]}", B, Some("/p/0"), Some(0)),
        ("{\"p\": [[1, 2, 3]]}", B, Some("/p/0"), Some(0)),
        ("{\"p\": [[1, 2], [1, \"2\"]]}", B, Some("/p/1/1"), Some(1)),
        ("{\"p\": [[true, 2]]}", B, Some("/p/0/0"), Some(0)),
        ("{\"p\": [[null, 2]]}", B, Some("/p/0/0"), Some(0)),
        ("{\"p\": [[[1, 2]]]}", B, Some("/p/0"), Some(0)),
        ("{\"p\": [[[1, 2], [3]]]}", B, Some("/p/0/1"), Some(0)),
        ("{\"p\": [[[1, 2], []]]}", B, Some("/p/0/1"), Some(0)),
        ("{\"p\": [[[1, 2], [3, 4, 5]]]}", B, Some("/p/0/1"), Some(0)),
        ("{\"p\": [[[1, 2], 3]]}", B, Some("/p/0/1"), Some(0)),
        ("{\"p\": [[1, [2, 3]]]}", B, Some("/p/0/1"), Some(0)),
        (
            "{\"p\": [[[[1, 2], [3, 4]], [5, 6]]]}",
            B,
            Some("/p/0/0/0"),
            Some(0),
        ),
        ("{\"p\": [[1e999, 2]]}", N, Some("/p/0/0"), Some(0)),
        (
            "{\"p\": [[0, 0], [[1, 2], [3, -1e999]]]}",
            N,
            Some("/p/1/1/1"),
            Some(1),
        ),
        (
            "{\"p\": [], \"q\": [[0, 1], [0, 2], [1, 1E+400]]}",
            N,
            Some("/q/2/1"),
            Some(2),
        ),
        ("{\"weights\": 1}", B, Some("/weights"), None),
        ("{\"weights\": [1, \"2\"]}", B, Some("/weights/1"), Some(1)),
        ("{\"weights\": [1, 1e309]}", N, Some("/weights/1"), Some(1)),
    ];
    check(WarpObject::parse, table);
    check(
        |json| DragObject::parse(json, usize::MAX),
        &[("{\"q\": [[0, 1], [1e999, 0]]}", N, Some("/q/1/0"), Some(1))],
    );
}

#[test]
fn handles_out_of_the_mathematics_range_are_left_to_it() {
    let warp = WarpObject::parse(
        b"{\"p\": [[-1e7, 1e300]], \"weights\": [-1, 0], \"alpha\": -3, \"point_mass\": 0}",
    )
    .unwrap();
    assert_eq!(warp.rest.p, [point(-1e7, 1e300)]);
    assert_eq!(
        (warp.rest.weights, warp.rest.alpha, warp.rest.point_mass),
        (Some(vec![-1.0, 0.0]), Some(-3.0), Some(0.0))
    );
}

#[test]
fn words_and_colours_that_do_not_exist_are_bad_values() {
    use Code::BadValue as B;
    let table: &[Expected] = &[
        ("{\"method\": \"Rigid\"}", B, Some("/method"), None),
        ("{\"method\": 1}", B, Some("/method"), None),
        ("{\"units\": \"cm\"}", B, Some("/units"), None),
        ("{\"folds\": true}", B, Some("/folds"), None),
        ("{\"metric\": \"\"}", B, Some("/metric"), None),
        ("{\"output\": []}", B, Some("/output"), None),
        (
            "{\"output\": {\"format\": \"gif\"}}",
            B,
            Some("/output/format"),
            None,
        ),
        (
            "{\"output\": {\"compression\": \"fastest\"}}",
            B,
            Some("/output/compression"),
            None,
        ),
        (
            "{\"output\": {\"filter\": 2}}",
            B,
            Some("/output/filter"),
            None,
        ),
        (
            "{\"output\": {\"canvas\": \"grow\"}}",
            B,
            Some("/output/canvas"),
            None,
        ),
        (
            "{\"output\": {\"canvas\": {\"x\": 0, \"y\": 0, \"width\": 5}}}",
            B,
            Some("/output/canvas"),
            None,
        ),
        (
            "{\"output\": {\"canvas\": {\"x\": 0.5, \"y\": 0, \"width\": 5, \"height\": 5}}}",
            B,
            Some("/output/canvas/x"),
            None,
        ),
        (
            "{\"output\": {\"canvas\": {\"x\": 0, \"y\": -1000001, \"width\": 5, \"height\": 5}}}",
            B,
            Some("/output/canvas/y"),
            None,
        ),
        (
            "{\"output\": {\"canvas\": {\"x\": 0, \"y\": 0, \"width\": 0, \"height\": 5}}}",
            B,
            Some("/output/canvas/width"),
            None,
        ),
        (
            "{\"output\": {\"canvas\": [0, 0, 5, 5]}}",
            B,
            Some("/output/canvas"),
            None,
        ),
        (
            "{\"output\": {\"outside\": \"black\"}}",
            B,
            Some("/output/outside"),
            None,
        ),
        (
            "{\"output\": {\"outside\": [0, 0, 0, 0]}}",
            B,
            Some("/output/outside"),
            None,
        ),
        (
            "{\"output\": {\"outside\": \"#\"}}",
            B,
            Some("/output/outside"),
            None,
        ),
        (
            "{\"output\": {\"outside\": {}}}",
            B,
            Some("/output/outside/value"),
            None,
        ),
        (
            "{\"output\": {\"outside\": {\"value\": -1}}}",
            B,
            Some("/output/outside/value"),
            None,
        ),
        (
            "{\"output\": {\"outside\": {\"value\": 65536}}}",
            B,
            Some("/output/outside/value"),
            None,
        ),
        (
            "{\"output\": {\"outside\": {\"value\": 0.5}}}",
            B,
            Some("/output/outside/value"),
            None,
        ),
        (
            "{\"output\": {\"outside\": {\"value\": \"black\"}}}",
            B,
            Some("/output/outside/value"),
            None,
        ),
        (
            "{\"output\": {\"outside\": {\"value\": [1, 2]}}}",
            B,
            Some("/output/outside/value"),
            None,
        ),
        (
            "{\"output\": {\"outside\": {\"value\": [1, 2, 3, 4]}}}",
            B,
            Some("/output/outside/value"),
            None,
        ),
        (
            "{\"output\": {\"outside\": {\"value\": [1, 2, 70000]}}}",
            B,
            Some("/output/outside/value/2"),
            None,
        ),
        (
            "{\"output\": {\"outside\": \"#fff\"}}",
            B,
            Some("/output/outside"),
            None,
        ),
        (
            "{\"output\": {\"outside\": \"#fffff\"}}",
            B,
            Some("/output/outside"),
            None,
        ),
        (
            "{\"output\": {\"outside\": \"#ff00g0\"}}",
            B,
            Some("/output/outside"),
            None,
        ),
        (
            "{\"output\": {\"outside\": \"#+f00000\"}}",
            B,
            Some("/output/outside"),
            None,
        ),
        (
            "{\"output\": {\"outside\": \"#\u{e9}\u{e9}\u{e9}\"}}",
            B,
            Some("/output/outside"),
            None,
        ),
    ];
    check(WarpObject::parse, table);
    assert_eq!(
        detail("{\"units\": \"cm\"}"),
        "expected one of `px`, `normalized`; found `cm`"
    );
}

#[test]
fn numbers_of_the_wrong_kind_are_bad_values() {
    use Code::{BadValue as B, NotFinite as N};
    let table: &[Expected] = &[
        ("{\"alpha\": \"1\"}", B, Some("/alpha"), None),
        ("{\"alpha\": [1]}", B, Some("/alpha"), None),
        ("{\"alpha\": 1e999}", N, Some("/alpha"), None),
        ("{\"point_mass\": {}}", B, Some("/point_mass"), None),
        ("{\"smoothing\": \"1\"}", B, Some("/smoothing"), None),
        ("{\"point_mass\": -1e999}", N, Some("/point_mass"), None),
        ("{\"grid\": 5}", B, Some("/grid"), None),
        ("{\"grid\": \"fine\"}", B, Some("/grid"), None),
        ("{\"grid\": {}}", B, Some("/grid"), None),
        ("{\"grid\": {\"columns\": 5}}", B, Some("/grid"), None),
        (
            "{\"grid\": {\"cell\": 5, \"columns\": 5, \"rows\": 5}}",
            B,
            Some("/grid"),
            None,
        ),
        ("{\"grid\": {\"cell\": 0}}", B, Some("/grid/cell"), None),
        ("{\"grid\": {\"cell\": -5}}", B, Some("/grid/cell"), None),
        (
            "{\"grid\": {\"cell\": 1e-999}}",
            B,
            Some("/grid/cell"),
            None,
        ),
        ("{\"grid\": {\"cell\": 1e999}}", N, Some("/grid/cell"), None),
        (
            "{\"grid\": {\"columns\": 1, \"rows\": 5}}",
            B,
            Some("/grid/columns"),
            None,
        ),
        (
            "{\"grid\": {\"columns\": 5, \"rows\": 2.5}}",
            B,
            Some("/grid/rows"),
            None,
        ),
        (
            "{\"grid\": {\"columns\": -5, \"rows\": 5}}",
            B,
            Some("/grid/columns"),
            None,
        ),
        (
            "{\"grid\": {\"columns\": 5, \"rows\": 4294967296}}",
            B,
            Some("/grid/rows"),
            None,
        ),
        (
            "{\"grid\": {\"columns\": 5, \"rows\": \"5\"}}",
            B,
            Some("/grid/rows"),
            None,
        ),
        (
            "{\"output\": {\"width\": 0}}",
            B,
            Some("/output/width"),
            None,
        ),
        (
            "{\"output\": {\"width\": -1}}",
            B,
            Some("/output/width"),
            None,
        ),
        (
            "{\"output\": {\"width\": 800.5}}",
            B,
            Some("/output/width"),
            None,
        ),
        (
            "{\"output\": {\"width\": \"800\"}}",
            B,
            Some("/output/width"),
            None,
        ),
        (
            "{\"output\": {\"width\": 1e10}}",
            B,
            Some("/output/width"),
            None,
        ),
        (
            "{\"output\": {\"width\": 1e300}}",
            B,
            Some("/output/width"),
            None,
        ),
        (
            "{\"output\": {\"width\": 1e999}}",
            N,
            Some("/output/width"),
            None,
        ),
    ];
    check(WarpObject::parse, table);
    let problem = WarpObject::parse(b"{\"output\": {\"width\": 5000000000}}").unwrap_err();
    assert_eq!(
        (problem.limit, problem.actual),
        (Some(u32::MAX.into()), Some(5_000_000_000_u64.into()))
    );
}
