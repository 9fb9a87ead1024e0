//! Points to map, and maps.

use super::*;

#[test]
fn points_and_maps_begin_with_the_fields_of_the_warp() {
    assert_eq!(fields::WARP_WITH_POINTS[..fields::WARP.len()], fields::WARP);
    assert_eq!(
        (
            fields::WARP_WITH_EXTENT[..fields::WARP.len()].to_vec(),
            fields::WARP_WITH_EXTENT.last()
        ),
        (fields::WARP.to_vec(), Some(&"extent"))
    );
    assert_eq!(fields::WARP_WITH_MAP[..fields::WARP.len()], fields::WARP);
}

#[test]
fn maps_have_the_canvas_of_the_output_unless_they_have_their_own() {
    use mlswarp::warp::{MapDirection, MapFormat};
    let fit = OutputSpec {
        canvas: CanvasSpec::Fit,
        width: Some(70),
        ..OutputSpec::default()
    };
    let spec = |text: &[u8]| {
        MapObject::parse_posed(text)
            .unwrap()
            .spec(&fit, MapFormat::Tiff)
    };
    let of_output = spec(b"{\"q\": [], \"canvas\": null, \"width\": null, \"direction\": null}");
    assert_eq!(
        (of_output.canvas, of_output.width),
        (CanvasSpec::Fit, Some(70))
    );
    assert_eq!(
        (of_output.direction, of_output.format),
        (MapDirection::Inverse, MapFormat::Tiff)
    );
    let own = spec(b"{\"q\": [], \"canvas\": \"same\", \"direction\": \"forward\"}");
    assert_eq!(
        (own.canvas, own.width, own.direction),
        (CanvasSpec::Same, None, MapDirection::Forward)
    );
    assert_eq!(spec(b"{\"q\": [], \"width\": 9}").width, Some(9));
    use Code::{BadValue as B, UnknownField as U};
    check(
        MapObject::parse,
        &[
            (
                "{\"extent\": [4, 4], \"direction\": \"back\"}",
                B,
                Some("/direction"),
                None,
            ),
            (
                "{\"extent\": [4, 4], \"canvas\": {\"x\": 1}}",
                B,
                Some("/canvas"),
                None,
            ),
            (
                "{\"extent\": [4, 4], \"width\": 0}",
                B,
                Some("/width"),
                None,
            ),
            (
                "{\"extent\": [4, 4], \"points\": []}",
                U,
                Some("/points"),
                None,
            ),
            ("{\"q\": []}", B, Some("/extent"), None),
        ],
    );
    assert_eq!(
        MapObject::parse_posed(b"{\"direction\": \"forward\"}")
            .unwrap()
            .pose,
        PosePatch::default()
    );
}

#[test]
fn points_read_their_fields() {
    let text = b"{\"p\": [[1, 2]], \"q\": [[3, 4]], \"units\": \"normalized\", \
        \"extent\": [640, 480], \"points\": [[0.5, 0.5], [1, 0]],
                  \"inverse\": false}";
    let read = points(text).unwrap();
    let rest = RestSpec {
        p: vec![point(1.0, 2.0)],
        units: Units::Normalized,
        ..RestSpec::default()
    };
    let warp = WarpObject {
        rest,
        q: Some(vec![point(3.0, 4.0)]),
        ..WarpObject::default()
    };
    assert_eq!(read.warp, Some((warp, Extent::new(640, 480).unwrap())));
    let names = |annotations: &Annotations| {
        annotations
            .kinds
            .iter()
            .map(Annotation::name)
            .collect::<Vec<_>>()
    };
    assert_eq!(
        (read.pose.q, names(&read.annotations)),
        (None, vec!["points"])
    );
    assert!(!read.annotations.is_inverse && read.annotations.is_refined);
    let text = b"{\"q\": [[3, 4]], \"geojson\": [], \"points\": [], \"output\": {\"width\": 9}}";
    let posed = posed_points(text).unwrap();
    assert_eq!(
        (posed.warp, posed.pose.q, posed.output.width),
        (None, Some(vec![point(3.0, 4.0)]), Some(9))
    );
    assert_eq!(names(&posed.annotations), ["geojson", "points"]);
    assert_eq!(
        points(b"{\"extent\": [1, 1]}").unwrap().pose,
        PosePatch::default()
    );
}

#[test]
fn annotations_have_no_part_in_the_limit_of_the_warp_object() {
    let places = "[1, 2],".repeat(1000) + "[1, 2]";
    let text = |name: &str| format!("{{\"extent\": [9, 9], \"{name}\": [{places}]}}");
    let parse =
        |text: &str| PointsObject::parse(&bytes(text.as_bytes()), 1000, &Work::new(&|| false));
    assert_eq!(parse(&text("points")).unwrap().annotations.kinds.len(), 1);
    let refused = parse(&text("p")).unwrap_err();
    assert_eq!(
        (refused.code, refused.what),
        (Code::TooLarge, Some("json_bytes"))
    );
    let of_points = reading_bytes(text("points").as_bytes(), None);
    assert!(
        of_points < 1000 && reading_bytes(text("p").as_bytes(), None) >= 48 * 1000,
        "{of_points}"
    );
}

/// Long annotations are read in pieces, none of which is read after nobody wants the result.
#[test]
fn reading_long_annotations_stops_soon_after_nobody_wants_them() {
    let nested = |depth: usize, inside: &str| {
        let opening = r#"{"type": "GeometryCollection", "geometries": ["#.repeat(depth);
        format!("{opening}{inside}{}", "]}".repeat(depth))
    };
    let places = "[1, 2], ".repeat(60_000) + "[1, 2]";
    let line = format!(r#"{{"type": "LineString", "coordinates": [{places}]}}"#);
    let foreign = format!(r#"{{"type": "Point", "coordinates": [1, 2], "x": [{places}]}}"#);
    for annotations in [
        format!(r#""points": [{places}]"#),
        format!(r#""polygons": [[{places}]]"#),
        format!(r#""geojson": {}"#, nested(16, &line)),
        format!(r#""geojson": {}"#, nested(16, &foreign)),
    ] {
        let body = bytes(format!(r#"{{"extent": [9, 9], {annotations}}}"#).as_bytes());
        let questions = std::cell::Cell::new(0);
        let count = || questions.replace(questions.get() + 1) == usize::MAX;
        let whole = Work::new(&count);
        PointsObject::parse(&body, 1000, &whole).unwrap();
        assert!(whole.bytes() >= body.len(), "{}", whole.bytes());
        for part in 0..8 {
            let (last, asked) = (questions.get() * part / 8, std::cell::Cell::new(0));
            let is_cancelled = || asked.replace(asked.get() + 1) >= last;
            let work = Work::new(&is_cancelled);
            let _ = PointsObject::parse(&body, 1000, &work);
            let until = whole.bytes() * (part + 1) / 8 + (64 << 10);
            assert!(work.bytes() <= until, "{} bytes of {until}", work.bytes());
            let cancelled = || true;
            let read = Reserved::<PointsObject, _>::parse(&body, 1000, &cancelled, |_| Ok(()));
            assert_eq!(read.unwrap_err().code, Code::Overloaded);
        }
    }
}

#[test]
fn points_refuse() {
    use Code::{BadValue as B, NotFinite as N};
    let posed: &[Expected] = &[
        (
            "{\"q\": [], \"polygons\": [[1, 2], [3, 4], [5, 6]]}",
            B,
            Some("/polygons/0/0"),
            None,
        ),
        (
            "{\"q\": [], \"polygons\": [[[1, 2], [3, 4]]]}",
            B,
            Some("/polygons/0"),
            None,
        ),
        ("{\"q\": [], \"boxes\": 1}", B, Some("/boxes"), None),
        (
            "{\"q\": [], \"boxes\": [[1, 2, 3]]}",
            B,
            Some("/boxes/0"),
            None,
        ),
        (
            "{\"q\": [], \"boxes\": [[1, 2, 3, 4], [10, 10, 5, 20]]}",
            B,
            Some("/boxes/1"),
            None,
        ),
        (
            "{\"q\": [], \"boxes\": [[1, 2, 3, 4, 5]]}",
            B,
            Some("/boxes/0"),
            None,
        ),
        (
            "{\"q\": [], \"polygons\": [null, [[1, 2], null, [5, 6]]]}",
            B,
            Some("/polygons/1/1"),
            None,
        ),
        (
            "{\"q\": [], \"boxes\": [[1, 2, null, 4]]}",
            B,
            Some("/boxes/0/2"),
            None,
        ),
        (
            "{\"q\": [], \"points\": [null, [1, null]]}",
            B,
            Some("/points/1/1"),
            None,
        ),
        (
            "{\"q\": [], \"points\": [[5e6, 1]]}",
            B,
            Some("/points/0"),
            None,
        ),
        ("{\"q\": [], \"geojson\": 7}", B, Some("/geojson"), None),
        (
            "{\"q\": [], \"geojson\": {}}",
            B,
            Some("/geojson/type"),
            None,
        ),
        (
            "{\"q\": [], \"geojson\": {\"type\": \"Topology\"}}",
            B,
            Some("/geojson/type"),
            None,
        ),
        (
            "{\"q\": [], \"geojson\": [null]}",
            B,
            Some("/geojson/0"),
            None,
        ),
        (
            "{\"q\": [], \"geojson\": {\"type\": \"Feature\", \"geometry\": []}}",
            B,
            Some("/geojson/geometry"),
            None,
        ),
        (
            "{\"q\": [], \"geojson\": {\"type\": \"FeatureCollection\"}}",
            B,
            Some("/geojson/features"),
            None,
        ),
        ("{\"q\": [], \"refine\": 0}", B, Some("/refine"), None),
        ("{\"q\": [], \"inverse\": 1}", B, Some("/inverse"), None),
        ("{\"q\": [], \"points\": {}}", B, Some("/points"), None),
        ("{\"q\": [], \"points\": [1]}", B, Some("/points/0"), None),
        (
            "{\"q\": [], \"points\": [[1, 2], [1]]}",
            B,
            Some("/points/1"),
            None,
        ),
        (
            "{\"q\": [], \"points\": [[[1, 2], [3, 4]]]}",
            B,
            Some("/points/0/0"),
            None,
        ),
        (
            "{\"q\": [], \"points\": [[1, 2, 3]]}",
            B,
            Some("/points/0"),
            None,
        ),
        (
            "{\"q\": [], \"points\": [[1, 1e999]]}",
            N,
            Some("/points/0/1"),
            None,
        ),
    ];
    check(posed_points, posed);
    let extent = |rest: &str| format!("{{\"extent\": [4, 4], {}", &rest[1..]);
    for (text, code, pointer, handle) in &posed[..posed.len() - 1] {
        let problem = points(extent(text).as_bytes()).expect_err(text);
        assert_eq!(
            (problem.code, problem.pointer.as_deref(), problem.handle),
            (*code, *pointer, *handle),
            "{text}"
        );
    }
    check(
        points,
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
