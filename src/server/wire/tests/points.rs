//! Points to map, and maps.

use super::*;

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
    let warp = WarpObject { rest, q: Some(vec![point(3.0, 4.0)]), ..WarpObject::default() };
    assert_eq!(points.warp, Some((warp, Extent::new(640, 480).unwrap())));
    let kinds = vec![Annotation::Points(vec![Point::new(0.5, 0.5), Point::new(1.0, 0.0)])];
    let annotations = Annotations { kinds, is_inverse: false, is_refined: true };
    assert_eq!((points.q, points.annotations), (vec![], annotations));
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
