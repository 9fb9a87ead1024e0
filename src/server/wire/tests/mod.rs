//! What is refused and how (tables), what is read, and laws: no text panics, what is written reads back.

mod contract;

use mlswarp::codec::{Compression, Format, Subsampling};
use mlswarp::deform::{Coincident, CoincidentPolicy};
use mlswarp::geometry::Point;
use mlswarp::pixmap::Extent;
use mlswarp::render::{Canvas, Filter, Outside};
use mlswarp::warp::{Candidate, CanvasSpec, Digest, GridSpec, Holes, Method, Units};
use proptest::prelude::*;
use serde_json::{Value, json};

use super::*;
use crate::layer::LayerKind;

type Expected = (&'static str, Code, Option<&'static str>, Option<usize>);

fn check<T: std::fmt::Debug>(parse: impl Fn(&[u8]) -> Result<T, Problem>, table: &[Expected]) {
    for (text, code, pointer, handle) in table {
        let problem = parse(text.as_bytes()).expect_err(text);
        assert_eq!((problem.code, problem.pointer.as_deref(), problem.handle), (*code, *pointer, *handle), "{text}: {}", problem.detail);
    }
}

fn point(x: f64, y: f64) -> Handle {
    Handle::Point(Point::new(x, y))
}

fn line(places: &[(f64, f64)]) -> Handle {
    Handle::Polyline(places.iter().map(|(x, y)| Point::new(*x, *y)).collect())
}

fn detail(text: &str) -> String {
    WarpObject::parse(text.as_bytes()).expect_err(text).detail
}

#[test]
fn warp_reads_the_example_of_the_contract() {
    let text = br##"{
      "p": [[120, 80], [[40, 200], [300, 210]]],
      "q": [[130, 60], [[40, 220], [300, 190]]],
      "weights": [1, 2.5], "method": "similarity", "alpha": 1.0, "point_mass": 12, "smoothing": 0.5, "units": "normalized",
      "coincident": {"policy": "reject", "within": 0.5},
      "grid": {"columns": 100, "rows": 50}, "folds": "reject", "metric": "euclidean",
      "output": {"format": "png", "compression": "best", "width": 800, "filter": "nearest", "outside": "#0180fF40", "canvas": "same", "holes": "transparent"}
    }"##;
    let expected = WarpObject {
        rest: RestSpec {
            p: vec![point(120.0, 80.0), line(&[(40.0, 200.0), (300.0, 210.0)])],
            weights: Some(vec![1.0, 2.5]),
            method: Method::Similarity,
            alpha: Some(1.0),
            point_mass: Some(12.0),
            smoothing: Some(0.5),
            coincident: Coincident { policy: CoincidentPolicy::Reject, within: 0.5 },
            units: Units::Normalized,
            grid: GridSpec::Counts { columns: 100, rows: 50 },
        },
        q: Some(vec![point(130.0, 60.0), line(&[(40.0, 220.0), (300.0, 190.0)])]),
        folds: Folds::Reject,
        output: OutputSpec {
            format: Format::Png,
            quality: 85,
            subsampling: None,
            compression: Compression::Best,
            canvas: CanvasSpec::Same,
            width: Some(800),
            filter: Filter::Nearest,
            outside: Outside::Colour([1, 128, 255, 64]),
            holes: Holes::Transparent,
        },
        strength: 1.0,
        is_auto: false,
    };
    assert_eq!(WarpObject::parse(text), Ok(expected));
}

#[test]
fn warp_has_defaults_for_everything() {
    assert_eq!(WarpObject::parse(b" {} "), Ok(WarpObject::default()));
    let defaults = br#"{"p": [], "method": "rigid", "units": "px", "grid": "auto", "folds": "report", "metric": "euclidean",
        "output": {"format": "png", "quality": 85, "compression": "fast", "filter": "bilinear", "outside": "transparent", "canvas": "same"}}"#;
    assert_eq!(WarpObject::parse(defaults), Ok(WarpObject::default()));
    assert_eq!(WarpObject::parse(br#"{"output": {}}"#), Ok(WarpObject::default()));
}

#[test]
fn warp_reads_every_form_of_grid_and_outside() {
    let grid = |text: &str| WarpObject::parse(format!("{{\"grid\": {text}}}").as_bytes()).map(|w| w.rest.grid);
    assert_eq!(grid("\"pixel\""), Ok(GridSpec::Pixel));
    assert_eq!(grid("{\"tolerance\": 0.05}"), Ok(GridSpec::Tolerance(0.05)));
    assert_eq!(grid("{\"cell\": 5}"), Ok(GridSpec::Cell(5.0)));
    assert_eq!(grid("{\"rows\": 2, \"columns\": 3.0}"), Ok(GridSpec::Counts { columns: 3, rows: 2 }));
    let outside = |text: &str| WarpObject::parse(format!("{{\"output\": {{\"outside\": {text}}}}}").as_bytes()).map(|w| w.output.outside);
    assert_eq!(outside("\"edge\""), Ok(Outside::Edge));
    assert_eq!(outside("\"reflect\""), Ok(Outside::Reflect));
    assert_eq!(outside("\"#0a141e\""), Ok(Outside::Colour([10, 20, 30, 255])));
    assert_eq!(outside("\"\\u0065dge\""), Ok(Outside::Edge));
}

#[test]
fn numbers_are_read_to_the_nearest_double() {
    let text = "{\"p\": [[1.0000000000000002e0, 122.416294033786585]], \"alpha\": 5e-324}";
    let warp = WarpObject::parse(text.as_bytes()).unwrap();
    assert_eq!(warp.rest.p, [point(1.0 + f64::EPSILON, 122.416_294_033_786_58)]);
    assert_eq!(warp.rest.alpha, Some(f64::from_bits(1)));
}

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
        ("{\"output\": {\"width\": 1, \"width\": 2}}", M, Some("/output/width"), None),
        ("{\"grid\": {\"cell\": 1, \"cell\": 2}}", M, Some("/grid/cell"), None),
        ("{\"method\": \"\\ud800\"}", M, Some("/method"), None),
        ("{\"\\ud800\": 1}", M, None, None),
    ];
    check(WarpObject::parse, table);
    check(DragObject::parse, &table[..16]);
    check(PointsObject::parse, &table[..16]);
    check(PointsObject::parse_posed, &table[..16]);
    assert_eq!(WarpObject::parse(b"{\"p\": \xff}").unwrap_err().code, M);
}

#[test]
fn malformed_names_line_and_column() {
    assert_eq!(detail("{\"p\":\n [NaN]}"), "not JSON: expected value at line 2 column 3; JSON has neither NaN nor infinity");
    assert!(detail("[1]").contains("found an array"));
    assert_eq!(detail("{\"p\": [], \"p\": []}"), "the field `p` is given twice");
}

#[test]
fn handles_name_pointer_and_index() {
    use Code::{BadValue as B, NotFinite as N};
    let table: &[Expected] = &[
        ("{\"p\": {}}", B, Some("/p"), None),
        ("{\"p\": 1}", B, Some("/p"), None),
        ("{\"p\": [1, 2]}", B, Some("/p/0"), Some(0)),
        ("{\"p\": [[1, 2], null]}", B, Some("/p/1"), Some(1)),
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
        ("{\"p\": [[[[1, 2], [3, 4]], [5, 6]]]}", B, Some("/p/0/0/0"), Some(0)),
        ("{\"p\": [[1e999, 2]]}", N, Some("/p/0/0"), Some(0)),
        ("{\"p\": [[0, 0], [[1, 2], [3, -1e999]]]}", N, Some("/p/1/1/1"), Some(1)),
        ("{\"p\": [], \"q\": [[0, 1], [0, 2], [1, 1E+400]]}", N, Some("/q/2/1"), Some(2)),
        ("{\"weights\": 1}", B, Some("/weights"), None),
        ("{\"weights\": [1, \"2\"]}", B, Some("/weights/1"), Some(1)),
        ("{\"weights\": [1, 1e309]}", N, Some("/weights/1"), Some(1)),
    ];
    check(WarpObject::parse, table);
    check(DragObject::parse, &[("{\"q\": [[0, 1], [1e999, 0]]}", N, Some("/q/1/0"), Some(1))]);
}

#[test]
fn handles_out_of_the_mathematics_range_are_left_to_it() {
    let warp = WarpObject::parse(b"{\"p\": [[-1e7, 1e300]], \"weights\": [-1, 0], \"alpha\": -3, \"point_mass\": 0}").unwrap();
    assert_eq!(warp.rest.p, [point(-1e7, 1e300)]);
    assert_eq!((warp.rest.weights, warp.rest.alpha, warp.rest.point_mass), (Some(vec![-1.0, 0.0]), Some(-3.0), Some(0.0)));
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
        ("{\"output\": {\"depth\": 3}}", U, Some("/output/depth"), None),
        ("{\"grid\": {\"cells\": 3}}", U, Some("/grid/cells"), None),
    ];
    check(WarpObject::parse, table);
    check(DragObject::parse, &[("{\"q\": [], \"p\": []}", U, Some("/p"), None)]);
    check(PointsObject::parse_posed, &[("{\"q\": [], \"extent\": [1, 1]}", U, Some("/extent"), None)]);
    assert_eq!(detail("{\"grid\": {\"x\": 3}}"), "unknown field: `x`; known fields: `cell`, `columns`, `rows`, `tolerance`");
}

#[test]
fn unknown_field_of_any_length_gives_a_short_answer() {
    let name = "\u{e9}".repeat(100_000);
    let problem = WarpObject::parse(format!("{{\"output\": {{\"{name}\": 1}}}}").as_bytes()).unwrap_err();
    assert_eq!((problem.code, problem.pointer.as_deref()), (Code::UnknownField, Some("/output")));
    assert!(problem.detail.len() < 400);
    let problem = WarpObject::parse(format!("{{\"method\": \"{name}\"}}").as_bytes()).unwrap_err();
    assert!(problem.detail.len() < 400);
    let problem = WarpObject::parse(format!("{{\"alpha\": 1{}}}", "0".repeat(100_000)).as_bytes()).unwrap_err();
    assert_eq!(problem.code, Code::NotFinite);
    assert!(problem.detail.len() < 400);
}

#[test]
fn words_of_the_contract_that_are_missing_here_are_not_supported() {
    use Code::NotSupported as S;
    let table: &[Expected] = &[
        ("{\"method\": \"beier_neely\"}", S, Some("/method"), None),
        ("{\"method\": \"arap\"}", S, Some("/method"), None),
        ("{\"folds\": \"remove\"}", S, Some("/folds"), None),
        ("{\"metric\": \"geodesic\"}", S, Some("/metric"), None),
    ];
    check(WarpObject::parse, table);
    assert_eq!(
        detail("{\"method\": \"arap\"}"),
        "not supported by this version: `arap`; supported: `rigid`, `similarity`, `affine`, `tps`, `global_affine`, `auto`"
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
        ("{\"output\": {\"format\": \"gif\"}}", B, Some("/output/format"), None),
        ("{\"output\": {\"compression\": \"fastest\"}}", B, Some("/output/compression"), None),
        ("{\"output\": {\"filter\": 2}}", B, Some("/output/filter"), None),
        ("{\"output\": {\"canvas\": \"grow\"}}", B, Some("/output/canvas"), None),
        ("{\"output\": {\"canvas\": {\"x\": 0, \"y\": 0, \"width\": 5}}}", B, Some("/output/canvas"), None),
        ("{\"output\": {\"canvas\": {\"x\": 0.5, \"y\": 0, \"width\": 5, \"height\": 5}}}", B, Some("/output/canvas/x"), None),
        ("{\"output\": {\"canvas\": {\"x\": 0, \"y\": -1000001, \"width\": 5, \"height\": 5}}}", B, Some("/output/canvas/y"), None),
        ("{\"output\": {\"canvas\": {\"x\": 0, \"y\": 0, \"width\": 0, \"height\": 5}}}", B, Some("/output/canvas/width"), None),
        ("{\"output\": {\"canvas\": [0, 0, 5, 5]}}", B, Some("/output/canvas"), None),
        ("{\"output\": {\"outside\": \"black\"}}", B, Some("/output/outside"), None),
        ("{\"output\": {\"outside\": [0, 0, 0, 0]}}", B, Some("/output/outside"), None),
        ("{\"output\": {\"outside\": \"#\"}}", B, Some("/output/outside"), None),
        ("{\"output\": {\"outside\": \"#fff\"}}", B, Some("/output/outside"), None),
        ("{\"output\": {\"outside\": \"#fffff\"}}", B, Some("/output/outside"), None),
        ("{\"output\": {\"outside\": \"#ff00g0\"}}", B, Some("/output/outside"), None),
        ("{\"output\": {\"outside\": \"#+f00000\"}}", B, Some("/output/outside"), None),
        ("{\"output\": {\"outside\": \"#\u{e9}\u{e9}\u{e9}\"}}", B, Some("/output/outside"), None),
    ];
    check(WarpObject::parse, table);
    assert_eq!(detail("{\"units\": \"cm\"}"), "expected one of `px`, `normalized`; found `cm`");
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
        ("{\"grid\": {\"cell\": 5, \"columns\": 5, \"rows\": 5}}", B, Some("/grid"), None),
        ("{\"grid\": {\"cell\": 0}}", B, Some("/grid/cell"), None),
        ("{\"grid\": {\"cell\": -5}}", B, Some("/grid/cell"), None),
        ("{\"grid\": {\"cell\": 1e-999}}", B, Some("/grid/cell"), None),
        ("{\"grid\": {\"cell\": 1e999}}", N, Some("/grid/cell"), None),
        ("{\"grid\": {\"columns\": 1, \"rows\": 5}}", B, Some("/grid/columns"), None),
        ("{\"grid\": {\"columns\": 5, \"rows\": 2.5}}", B, Some("/grid/rows"), None),
        ("{\"grid\": {\"columns\": -5, \"rows\": 5}}", B, Some("/grid/columns"), None),
        ("{\"grid\": {\"columns\": 5, \"rows\": 4294967296}}", B, Some("/grid/rows"), None),
        ("{\"grid\": {\"columns\": 5, \"rows\": \"5\"}}", B, Some("/grid/rows"), None),
        ("{\"output\": {\"width\": 0}}", B, Some("/output/width"), None),
        ("{\"output\": {\"width\": -1}}", B, Some("/output/width"), None),
        ("{\"output\": {\"width\": 800.5}}", B, Some("/output/width"), None),
        ("{\"output\": {\"width\": \"800\"}}", B, Some("/output/width"), None),
        ("{\"output\": {\"width\": 1e10}}", B, Some("/output/width"), None),
        ("{\"output\": {\"width\": 1e300}}", B, Some("/output/width"), None),
        ("{\"output\": {\"width\": 1e999}}", N, Some("/output/width"), None),
    ];
    check(WarpObject::parse, table);
    let problem = WarpObject::parse(b"{\"output\": {\"width\": 5000000000}}").unwrap_err();
    assert_eq!((problem.limit, problem.actual), (Some(u32::MAX.into()), Some(5_000_000_000_u64.into())));
}

#[test]
fn drag_reads_its_fields() {
    let drag = DragObject::parse(b"{\"q\": [[1, 2]], \"seq\": 9007199254740993, \"output\": {\"width\": 9}}").unwrap();
    let output = OutputPatch { width: Some(9), ..OutputPatch::default() };
    assert_eq!(drag, DragObject { q: vec![point(1.0, 2.0)], strength: 1.0, seq: Some((1 << 53) + 1), layer: None, output });
    let drag = DragObject::parse(b"{\"q\": []}").unwrap();
    assert_eq!(drag, DragObject { q: vec![], strength: 1.0, seq: None, layer: None, output: OutputPatch::default() });
    for (text, seq) in [("0", 0), ("-0", 0), ("7.0", 7), ("1e3", 1000), ("18446744073709551615", u64::MAX)] {
        assert_eq!(DragObject::parse(format!("{{\"q\": [], \"seq\": {text}}}").as_bytes()).unwrap().seq, Some(seq));
    }
}

#[test]
fn drag_refuses() {
    use Code::{BadValue as B, NotFinite as N};
    check(
        DragObject::parse,
        &[
            ("{}", B, Some("/q"), None),
            ("{\"q\": null}", B, Some("/q"), None),
            ("{\"q\": [], \"seq\": -1}", B, Some("/seq"), None),
            ("{\"q\": [], \"seq\": 1.5}", B, Some("/seq"), None),
            ("{\"q\": [], \"seq\": \"1\"}", B, Some("/seq"), None),
            ("{\"q\": [], \"seq\": 18446744073709551616}", B, Some("/seq"), None),
            ("{\"q\": [], \"seq\": 1e999}", N, Some("/seq"), None),
        ],
    );
}

#[test]
fn output_patch_replaces_only_what_it_gives() {
    let base = OutputSpec {
        format: Format::Jpeg,
        quality: 40,
        subsampling: Some(Subsampling::Half),
        compression: Compression::None,
        canvas: CanvasSpec::Fit,
        width: Some(7),
        filter: Filter::Nearest,
        outside: Outside::Edge,
        holes: Holes::Transparent,
    };
    assert_eq!(OutputPatch::default().merge_onto(&base), base);
    let (format, quality, subsampling, compression, width) = (Format::WebP, 70, Some(Subsampling::Full), Compression::Best, 8);
    let (filter, outside, canvas, holes) = (Filter::Bilinear, Outside::Colour([1, 2, 3, 4]), CanvasSpec::Same, Holes::Keep);
    let all = OutputPatch {
        format: Some(format),
        quality: Some(quality),
        subsampling,
        compression: Some(compression),
        canvas: Some(canvas),
        width: Some(width),
        filter: Some(filter),
        outside: Some(outside),
        holes: Some(holes),
    };
    assert_eq!(
        all.merge_onto(&base),
        OutputSpec { format, quality, subsampling, compression, canvas, width: Some(width), filter, outside, holes }
    );
    assert_eq!(OutputPatch { width: Some(8), ..OutputPatch::default() }.merge_onto(&base), OutputSpec { width: Some(8), ..base });
}

#[test]
fn parameters_stay_with_their_method() {
    let session = |warp: &str| WarpObject::parse(warp.as_bytes()).unwrap();
    let local = session(r#"{"alpha": 1.5, "point_mass": 3}"#);
    let spline = session(r#"{"method": "tps", "smoothing": 0.1}"#);
    let merged = |patch: &str, base: &WarpObject| {
        let RestSpec { method, alpha, point_mass, smoothing, .. } =
            WarpPatch::parse(patch.as_bytes()).unwrap().merge_onto(base.clone()).rest;
        (method, alpha, point_mass, smoothing)
    };
    assert_eq!(merged("{}", &local), (Method::Rigid, Some(1.5), Some(3.0), None));
    assert_eq!(merged(r#"{"method": "affine"}"#, &local), (Method::Affine, Some(1.5), Some(3.0), None));
    assert_eq!(merged(r#"{"method": "tps"}"#, &local), (Method::ThinPlateSpline, None, None, None));
    assert_eq!(merged(r#"{"method": "tps", "alpha": 2}"#, &local), (Method::ThinPlateSpline, Some(2.0), None, None));
    assert_eq!(merged(r#"{"p": []}"#, &spline), (Method::ThinPlateSpline, None, None, Some(0.1)));
    assert_eq!(merged(r#"{"method": "tps"}"#, &spline), (Method::ThinPlateSpline, None, None, Some(0.1)));
    assert_eq!(merged(r#"{"method": "rigid"}"#, &spline), (Method::Rigid, None, None, None));
}

#[test]
fn auto_is_a_method_to_be_chosen_and_drops_parameters() {
    let local = WarpObject::parse(br#"{"p": [[1, 2]], "method": "affine", "alpha": 1.5}"#).unwrap();
    let auto = WarpPatch::parse(br#"{"method": "auto"}"#).unwrap().merge_onto(local.clone());
    assert!(auto.is_auto && auto.rest.alpha.is_none());
    assert!(!WarpPatch::parse(br#"{"p": [[3, 4]]}"#).unwrap().merge_onto(auto).is_auto, "a choice is made once");
    let text = |json: &[u8]| method_text(&WarpObject::parse(json).unwrap().rest);
    assert_eq!(text(br#"{"method": "affine", "alpha": 1.5}"#), "affine;alpha=1.5");
    assert_eq!(text(br#"{"method": "tps", "smoothing": 0}"#), "tps;smoothing=0");
    assert_eq!(text(br#"{"method": "global_affine"}"#), "global_affine");
}

#[test]
fn fit_reads_its_fields() {
    let fit = FitObject::parse(br#"{"p": [[1, 2]], "q": [[3, 4]], "extent": [9, 8], "candidates": [{"method": "tps", "smoothing": 0.5}]}"#);
    let fit = fit.unwrap();
    assert_eq!(fit.candidates, [Candidate { method: Method::ThinPlateSpline, alpha: None, smoothing: Some(0.5) }]);
    assert_eq!((fit.q, fit.rest.unwrap().1), (vec![point(3.0, 4.0)], Extent::new(9, 8).unwrap()));
    assert_eq!(FitObject::parse_posed(br#"{"q": []}"#).unwrap().candidates.len(), 17);
    use Code::BadValue as B;
    let many = format!("{{\"q\": [], \"candidates\": [{}]}}", [r#"{"method": "tps"}"#; 65].join(", "));
    let table: &[Expected] = &[
        ("{\"q\": [], \"candidates\": []}", B, Some("/candidates"), None),
        ("{\"q\": [], \"candidates\": [{\"alpha\": 1}]}", B, Some("/candidates/0/method"), None),
        ("{\"q\": [], \"candidates\": [{\"method\": \"auto\"}]}", B, Some("/candidates/0/method"), None),
        ("{\"q\": [], \"candidates\": [{\"method\": \"tps\", \"smoothing\": \"1\"}]}", B, Some("/candidates/0/smoothing"), None),
        ("{\"q\": [], \"candidates\": [{\"method\": \"tps\", \"grid\": 1}]}", Code::UnknownField, Some("/candidates/0/grid"), None),
        ("{\"p\": [], \"q\": []}", Code::UnknownField, Some("/p"), None),
        ("{}", B, Some("/q"), None),
    ];
    check(FitObject::parse_posed, table);
    assert_eq!(FitObject::parse_posed(many.as_bytes()).unwrap_err().pointer.as_deref(), Some("/candidates"));
    check(FitObject::parse, &[("{\"p\": [], \"q\": []}", B, Some("/extent"), None)]);
}

#[test]
fn points_and_maps_begin_with_the_fields_of_the_warp() {
    assert_eq!(fields::WARP_WITH_POINTS[..fields::WARP.len()], fields::WARP);
    assert_eq!(
        (fields::WARP_WITH_EXTENT[..fields::WARP.len()].to_vec(), fields::WARP_WITH_EXTENT.last()),
        (fields::WARP.to_vec(), Some(&"extent"))
    );
    assert_eq!(fields::WARP_WITH_MAP[..fields::WARP.len()], fields::WARP);
}

#[test]
fn maps_have_the_canvas_of_the_output_unless_they_have_their_own() {
    use mlswarp::warp::{MapDirection, MapFormat};
    let fit = OutputSpec { canvas: CanvasSpec::Fit, width: Some(70), ..OutputSpec::default() };
    let spec = |text: &[u8]| MapObject::parse_posed(text).unwrap().spec(&fit, MapFormat::Tiff);
    let of_output = spec(b"{\"q\": [], \"canvas\": null, \"width\": null, \"direction\": null}");
    assert_eq!((of_output.canvas, of_output.width), (CanvasSpec::Fit, Some(70)));
    assert_eq!((of_output.direction, of_output.format), (MapDirection::Inverse, MapFormat::Tiff));
    let own = spec(b"{\"q\": [], \"canvas\": \"same\", \"direction\": \"forward\"}");
    assert_eq!((own.canvas, own.width, own.direction), (CanvasSpec::Same, None, MapDirection::Forward));
    assert_eq!(spec(b"{\"q\": [], \"width\": 9}").width, Some(9));
    use Code::{BadValue as B, UnknownField as U};
    check(
        MapObject::parse,
        &[
            ("{\"extent\": [4, 4], \"direction\": \"back\"}", B, Some("/direction"), None),
            ("{\"extent\": [4, 4], \"canvas\": {\"x\": 1}}", B, Some("/canvas"), None),
            ("{\"extent\": [4, 4], \"width\": 0}", B, Some("/width"), None),
            ("{\"extent\": [4, 4], \"points\": []}", U, Some("/points"), None),
            ("{\"q\": []}", B, Some("/extent"), None),
        ],
    );
    check(MapObject::parse_posed, &[("{\"direction\": \"forward\"}", B, Some("/q"), None)]);
}

#[test]
fn points_read_their_fields() {
    let text = b"{\"p\": [[1, 2]], \"q\": [[3, 4]], \"units\": \"normalized\", \"extent\": [640, 480], \"points\": [[0.5, 0.5], [1, 0]],
                  \"inverse\": false}";
    let points = PointsObject::parse(text).unwrap();
    let rest = RestSpec { p: vec![point(1.0, 2.0)], units: Units::Normalized, ..RestSpec::default() };
    let warp = WarpObject { rest, q: Some(points.q.clone()), ..WarpObject::default() };
    assert_eq!(points.warp, Some((warp, Extent::new(640, 480).unwrap())));
    let kinds = vec![Annotation::Points(vec![Point::new(0.5, 0.5), Point::new(1.0, 0.0)])];
    let annotations = Annotations { kinds, is_inverse: false, is_refined: true };
    assert_eq!((points.q, points.annotations), (vec![point(3.0, 4.0)], annotations));
    let posed = PointsObject::parse_posed(b"{\"q\": [[3, 4]], \"points\": []}").unwrap();
    assert_eq!((posed.warp, posed.q, posed.annotations.kinds), (None, vec![point(3.0, 4.0)], vec![Annotation::Points(vec![])]));
    assert_eq!(PointsObject::parse(b"{\"extent\": [1, 1]}").unwrap().q, []);
}

#[test]
fn points_refuse() {
    use Code::{BadValue as B, NotFinite as N};
    let posed: &[Expected] = &[
        ("{\"q\": [], \"polygons\": [[1, 2], [3, 4], [5, 6]]}", B, Some("/polygons/0/0"), None),
        ("{\"q\": [], \"polygons\": [[[1, 2], [3, 4]]]}", B, Some("/polygons/0"), None),
        ("{\"q\": [], \"boxes\": 1}", B, Some("/boxes"), None),
        ("{\"q\": [], \"boxes\": [[1, 2, 3]]}", B, Some("/boxes/0"), None),
        ("{\"q\": [], \"boxes\": [[1, 2, 3, 4], [10, 10, 5, 20]]}", B, Some("/boxes/1"), None),
        ("{\"q\": [], \"boxes\": [[1, 2, 3, 4, 5]]}", B, Some("/boxes/0"), None),
        ("{\"q\": [], \"geojson\": []}", B, Some("/geojson"), None),
        ("{\"q\": [], \"geojson\": {\"type\": \"Feature\"}}", B, Some("/geojson/type"), None),
        ("{\"q\": [], \"geojson\": {\"type\": \"FeatureCollection\"}}", B, Some("/geojson/features"), None),
        ("{\"q\": [], \"refine\": 0}", B, Some("/refine"), None),
        ("{\"q\": [], \"inverse\": 1}", B, Some("/inverse"), None),
        ("{\"q\": [], \"points\": {}}", B, Some("/points"), None),
        ("{\"q\": [], \"points\": [1]}", B, Some("/points/0"), None),
        ("{\"q\": [], \"points\": [[1, 2], [1]]}", B, Some("/points/1"), None),
        ("{\"q\": [], \"points\": [[[1, 2], [3, 4]]]}", B, Some("/points/0/0"), None),
        ("{\"q\": [], \"points\": [[1, 2, 3]]}", B, Some("/points/0"), None),
        ("{\"q\": [], \"points\": [[1, 1e999]]}", N, Some("/points/0/1"), None),
        ("{\"points\": []}", B, Some("/q"), None),
    ];
    check(PointsObject::parse_posed, posed);
    let extent = |rest: &str| format!("{{\"extent\": [4, 4], {}", &rest[1..]);
    for (text, code, pointer, handle) in &posed[..posed.len() - 1] {
        let problem = PointsObject::parse(extent(text).as_bytes()).expect_err(text);
        assert_eq!((problem.code, problem.pointer.as_deref(), problem.handle), (*code, *pointer, *handle), "{text}");
    }
    check(
        PointsObject::parse,
        &[
            ("{\"q\": []}", B, Some("/extent"), None),
            ("{\"extent\": [4, 4], \"p\": [[1, 2]]}", B, Some("/q"), None),
            ("{\"extent\": 4}", B, Some("/extent"), None),
            ("{\"extent\": []}", B, Some("/extent"), None),
            ("{\"extent\": [4]}", B, Some("/extent"), None),
            ("{\"extent\": [4, 4, 4]}", B, Some("/extent"), None),
            ("{\"extent\": [0, 4]}", B, Some("/extent/0"), None),
            ("{\"extent\": [4, 0.5]}", B, Some("/extent/1"), None),
            ("{\"extent\": [4, -4]}", B, Some("/extent/1"), None),
            ("{\"extent\": [4, \"4\"]}", B, Some("/extent/1"), None),
        ],
    );
}

#[test]
fn nesting_of_any_depth_is_refused_without_a_stack() {
    for (open, close) in [("[", "]"), ("{\"a\":", "}")] {
        let deep = format!("{{\"p\": [{}1{}]}}", open.repeat(200_000), close.repeat(200_000));
        let problem = WarpObject::parse(deep.as_bytes()).unwrap_err();
        assert_eq!((problem.code, problem.handle), (Code::BadValue, Some(0)));
        assert_eq!(WarpObject::parse(format!("{{\"p\": {}", open.repeat(200_000)).as_bytes()).unwrap_err().code, Code::MalformedRequest);
    }
}

#[test]
fn session_object_is_written_in_wire_form() {
    let p = [point(1.0, 2.0), line(&[(0.5, 1.0), (2.0, 3.0)])];
    let output = OutputSpec { width: Some(9), outside: Outside::Colour([1, 2, 3, 255]), ..OutputSpec::default() };
    let session = SessionObject {
        id: "0f8fad5b-d9cb-469f-a165-70867728950e",
        image: SessionImage { width: 640, height: 480, digest: AsJson(Digest([0xab; 32])) },
        p: AsJson(&p),
        weights: None,
        method: AsJson(Method::Rigid),
        alpha: Some(2.0),
        point_mass: Some(2.5),
        smoothing: None,
        coincident: vec![CoincidentGroup { handles: vec![0, 4] }],
        coincident_policy: None,
        units: AsJson(Units::Px),
        grid: SessionGrid { columns: 129, rows: 97, cell: [5.0, 5.0], requested: AsJson(GridSpec::Auto) },
        rest_revision: "0123456789abcdef0123456789abcdef",
        folds: AsJson(Folds::Report),
        output: AsJson(&output),
        layers: [("depth", SessionLayer { kind: AsJson(LayerKind::Labels) })].into(),
        created: "2026-11-20T12:00:00Z",
        expires: "2026-11-20T12:15:00Z",
        seq: None,
    };
    assert_eq!(
        serde_json::to_value(&session).unwrap(),
        json!({
            "id": "0f8fad5b-d9cb-469f-a165-70867728950e",
            "image": {"width": 640, "height": 480, "digest": format!("sha256:{}", "ab".repeat(32))},
            "p": [[1.0, 2.0], [[0.5, 1.0], [2.0, 3.0]]],
            "method": "rigid", "alpha": 2.0, "point_mass": 2.5, "coincident": [{"handles": [0, 4]}], "units": "px",
            "grid": {"columns": 129, "rows": 97, "cell": [5.0, 5.0], "requested": "auto"},
            "rest_revision": "0123456789abcdef0123456789abcdef",
            "folds": "report",
            "output": {"format": "png", "quality": 85, "compression": "fast", "width": 9, "filter": "bilinear", "outside": "#010203ff", "canvas": "same", "holes": "keep"},
            "layers": {"depth": {"kind": "labels"}},
            "created": "2026-11-20T12:00:00Z", "expires": "2026-11-20T12:15:00Z", "seq": null
        })
    );
}

/// JSON that is near enough to the contract to reach every branch.
fn near_miss() -> impl Strategy<Value = Value> {
    let scalar = prop_oneof![
        Just(Value::Null),
        any::<bool>().prop_map(Value::from),
        any::<f64>().prop_map(Value::from),
        (-3_i64..9).prop_map(Value::from),
        prop::sample::select(vec!["rigid", "tps", "auto", "png", "edge", "#00000000", "fast", "", "report", "same", "euclidean"])
            .prop_map(Value::from),
        ".{0,4}".prop_map(Value::from),
    ];
    scalar.prop_recursive(5, 48, 4, |inner| {
        let name = prop::sample::select(
            fields::WARP_WITH_POINTS.iter().chain(&["seq", "cell", "columns", "rows", "width", "format", "x"]).copied().collect::<Vec<_>>(),
        );
        prop_oneof![
            prop::collection::vec(inner.clone(), 0..4).prop_map(Value::from),
            prop::collection::vec((name, inner), 0..5).prop_map(|f| Value::Object(f.into_iter().map(|(k, v)| (k.to_owned(), v)).collect())),
        ]
    })
}

fn every_parser_answers(text: &[u8]) -> Result<(), TestCaseError> {
    let problems = [
        WarpObject::parse(text).err(),
        DragObject::parse(text).err(),
        PointsObject::parse(text).err(),
        ReportObject::parse(text).err(),
        DragObject::parse_for_report(text).err(),
        PointsObject::parse_posed(text).err(),
        MapObject::parse(text).err(),
        MapObject::parse_posed(text).err(),
    ];
    let json = serde_json::from_slice::<&serde_json::value::RawValue>(text).is_ok();
    for problem in problems.into_iter().flatten() {
        prop_assert!(problem.status() == 400 || (json && problem.status() == 422), "{problem}");
        prop_assert!(!problem.detail.is_empty());
        prop_assert!(problem.pointer.as_deref().is_none_or(|p| p.starts_with('/')), "{problem}");
    }
    Ok(())
}

fn coordinate() -> impl Strategy<Value = f64> {
    prop_oneof![(-2e6..2e6), prop::num::f64::NORMAL | prop::num::f64::ZERO | prop::num::f64::SUBNORMAL]
}

fn place() -> impl Strategy<Value = Point> {
    (coordinate(), coordinate()).prop_map(|(x, y)| Point::new(x, y))
}

fn handle() -> impl Strategy<Value = Handle> {
    prop_oneof![place().prop_map(Handle::Point), prop::collection::vec(place(), 2..5).prop_map(Handle::Polyline)]
}

fn all<T: EnumName + std::fmt::Debug>() -> impl Strategy<Value = T> {
    prop::sample::select(T::ALL)
}

pub(crate) fn warp_object() -> impl Strategy<Value = WarpObject> {
    let grid = prop_oneof![
        Just(GridSpec::Auto),
        Just(GridSpec::Pixel),
        (1e-9..1e9).prop_map(GridSpec::Cell),
        (0.05..=4.0).prop_map(GridSpec::Tolerance),
        (2_u32.., 2_u32..).prop_map(|(columns, rows)| GridSpec::Counts { columns, rows }),
    ];
    let outside =
        prop_oneof![Just(Outside::Transparent), Just(Outside::Edge), Just(Outside::Reflect), any::<[u8; 4]>().prop_map(Outside::Colour)];
    let weights = prop::option::of(prop::collection::vec(1e-9..1e9, 0..5));
    let numbers = (prop::option::of(0.5..8.0), prop::option::of(1e-3..1e9), prop::option::of(0.0..1e9));
    let coincident = (all(), 0.0..1e6).prop_map(|(policy, within)| Coincident { policy, within });
    let rest = (prop::collection::vec(handle(), 0..6), weights, all(), numbers, coincident, (all(), grid)).prop_map(
        |(p, weights, method, (alpha, point_mass, smoothing), coincident, (units, grid))| RestSpec {
            p,
            weights,
            method,
            alpha,
            point_mass,
            smoothing,
            coincident,
            units,
            grid,
        },
    );
    let place = || -1_000_000..=1_000_000;
    let boxes = (place(), place(), 1_u32..=2_000_000, 1_u32..=2_000_000).prop_map(|(x, y, w, h)| Canvas {
        x,
        y,
        extent: Extent::new(w, h).unwrap(),
    });
    let canvas = prop_oneof![Just(CanvasSpec::Same), Just(CanvasSpec::Fit), boxes.prop_map(CanvasSpec::Box)];
    let output = (all(), 1_u8..=100, prop::option::of(all()), all(), prop::option::of(1_u32..), all(), outside, canvas, all());
    let output = output.prop_map(|(format, quality, subsampling, compression, width, filter, outside, canvas, holes)| OutputSpec {
        format,
        quality,
        subsampling,
        compression,
        canvas,
        width,
        filter,
        outside,
        holes,
    });
    let q = prop::option::of(prop::collection::vec(handle(), 0..6));
    (rest, q, all(), output).prop_map(|(rest, q, folds, output)| WarpObject { rest, q, folds, output, strength: 1.0, is_auto: false })
}

/// The object in the form of its values.
pub(crate) fn written(warp: &WarpObject) -> Value {
    let WarpObject { rest, q, folds, output, .. } = warp;
    let RestSpec { p, weights, method, alpha, point_mass, smoothing, coincident, units, grid } = rest;
    let mut object = json!({
        "p": AsJson(p.as_slice()), "q": q.as_deref().map(AsJson), "weights": weights, "method": AsJson(*method), "alpha": alpha, "point_mass": point_mass,
        "smoothing": smoothing, "coincident": AsJson(*coincident),
        "units": AsJson(*units), "grid": AsJson(*grid), "folds": AsJson(*folds), "output": AsJson(output)
    });
    object.as_object_mut().unwrap().retain(|_, value| !value.is_null());
    object
}

/// Every object with all fields that it does not have, as `null`.
fn with_nulls(mut object: Value, names: &[&str]) -> Value {
    for name in names {
        object.as_object_mut().unwrap().entry(*name).or_insert(Value::Null);
    }
    object
}

#[test]
fn null_is_absence_for_fields_and_a_wrong_value_in_arrays() {
    use Code::{BadValue as B, MalformedRequest as M, UnknownField as U};
    assert_eq!(WarpObject::parse(b"{\"grid\": {\"cell\": 2, \"columns\": null, \"rows\": null}}").unwrap().rest.grid, GridSpec::Cell(2.0));
    assert_eq!(WarpObject::parse(b"{\"p\": [[1, 2]], \"q\": null}").unwrap().posed().unwrap_err().pointer.as_deref(), Some("/q"));
    let absent = b"{\"q\": [], \"points\": null, \"polygons\": null, \"boxes\": null, \"inverse\": null, \"refine\": null}";
    assert_eq!(PointsObject::parse_posed(absent), PointsObject::parse_posed(b"{\"q\": []}"));
    assert_eq!(DragObject::parse_posed(b"{\"q\": [], \"seq\": null}"), DragObject::parse_posed(b"{\"q\": []}"));
    check(
        WarpObject::parse,
        &[
            ("{\"p\": [null]}", B, Some("/p/0"), Some(0)),
            ("{\"q\": [[[1, 2], null]]}", B, Some("/q/0/1"), Some(0)),
            ("{\"weights\": [1, null]}", B, Some("/weights/1"), Some(1)),
            ("{\"alpha\": null, \"alpha\": 1}", M, Some("/alpha"), None),
            ("{\"alphas\": null}", U, Some("/alphas"), None),
        ],
    );
    check(
        PointsObject::parse,
        &[
            ("{\"extent\": [4, null]}", B, Some("/extent/1"), None),
            ("{\"extent\": [4, 4], \"points\": [null]}", B, Some("/points/0"), None),
        ],
    );
    for (problem, field) in [
        (DragObject::parse(b"{\"q\": null}").unwrap_err(), "`q`"),
        (DragObject::parse_posed(b"{\"q\": null}").unwrap_err(), "`q`"),
        (PointsObject::parse_posed(b"{\"q\": null}").unwrap_err(), "`q`"),
        (PointsObject::parse(b"{\"extent\": null}").unwrap_err(), "`extent`"),
    ] {
        assert!(problem.code == B && problem.detail.starts_with(&format!("{field} is missing")), "{problem}");
    }
}

proptest! {
    #[test]
    fn any_bytes_give_a_value_or_a_400(bytes in prop::collection::vec(any::<u8>(), 0..64)) {
        every_parser_answers(&bytes)?;
    }

    #[test]
    fn any_braced_text_gives_a_value_or_a_problem(text in "\\{\"[pq]\": [\\[\\]{}\",:0-9eE+.\\-a-z\\\\ ]{0,40}\\}") {
        every_parser_answers(text.as_bytes())?;
    }

    #[test]
    fn any_json_gives_a_value_or_a_problem(value in near_miss()) {
        every_parser_answers(value.to_string().as_bytes())?;
    }

    #[test]
    fn what_is_written_reads_back(warp in warp_object()) {
        let text = serde_json::to_vec(&written(&warp)).unwrap();
        prop_assert_eq!(WarpObject::parse(&text).unwrap(), warp);
    }

    #[test]
    fn null_fields_change_nothing(warp in warp_object()) {
        let mut object = with_nulls(written(&warp), &fields::WARP);
        object["output"] = with_nulls(object["output"].take(), &["quality", "width", "canvas"]);
        if object["grid"].is_object() {
            object["grid"] = with_nulls(object["grid"].take(), &["cell", "columns", "rows"]);
        }
        prop_assert_eq!(WarpObject::parse(object.to_string().as_bytes()).unwrap(), warp);
    }
}
