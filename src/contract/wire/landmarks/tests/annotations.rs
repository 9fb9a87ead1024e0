//! Files of annotation tools: COCO, dlib, CVAT, IIIF, 3D Slicer. Several persons, boxes or images
//! are items.

use serde_json::{Value, json};

use super::{MAX_COLUMNS, both, convert, place, read};
use crate::problem::Problem;
use crate::wire::landmarks::{Item, LandmarkFiles};

const COCO: &str = r#"{"info": {}, "images": [{"id": 7, "file_name": "val/a.jpg", "width": 9},
  {"id": "8", "file_name": "b.jpg"}], "annotations": [
    {"id": 1, "image_id": 7, "category_id": 1, "bbox": [1, 2, 3, 4]},
    {"id": 2, "image_id": 7, "category_id": 1, "keypoints": [0, 0, 0, 0, 0, 0], "num_keypoints": 0},
    {"id": 3, "image_id": 7, "category_id": 1, "keypoints": [10, 20, 2, 0, 0, 0],
      "num_keypoints": 1},
    {"id": 4, "image_id": 7, "category_id": 1, "keypoints": [30, 40.25, 1, 50, 60, 2]},
    {"id": 5, "image_id": "8", "category_id": 2, "keypoints": [1, 2, 2]}],
    "categories": [{"id": 1, "name": "person", "keypoints": ["nose", "left_eye"], "skeleton": [[1,
      2]]}, {"id": 2, "keypoints": ["tip"]}]}"#;
const DLIB: &str = "<?xml version='1.0' encoding='ISO-8859-1'?>\n<?xml-stylesheet type='text/xsl' \
    href='image_metadata_stylesheet.xsl'?>\n<dataset>\n\
    <name>faces &lt;1&gt;</name>\n<comment>a > b</comment>\n<!-- <image file='none'> \
    -->\n<images>\n  <image file='faces/a &amp; b.jpg' width='9' height='8'>\n\
    <box top='1' left='2' width='3' height='4'/>\n    <box top='74' left='85' width='8' \
    height='8' ignore='1'>\n      <label>one</label>\n\
    <part name='00' x='10' y='20'/>\n      <part name='01' x='30' \
    y='-4'/>\n    </box>\n  </image>\n\
    <image file='c.jpg'><box top='1' left='1' width='2' height='2'><part name=\"00\" y=\"6\" \
    x=\"5\"></part></box>\
    <box top='1' left='1' width='2' height='2'><part name='00' x='7' \
    y='8'/></box></image>\n</images>\n</dataset>";
const CVAT: &str = r#"<?xml version="1.0" encoding="utf-8"?>
<annotations>
  <version>1.1</version><meta><task><name>t</name><labels><label><name>nose</name><svg>&lt;line x1="1"/&gt;</svg></label></labels></task></meta>
  <image id="0" name="job/a.png" width="640" height="480">
    <box label="face" occluded="0" xtl="1" ytl="2" xbr="3" ybr="4"/>
    <points label="nose" source="manual" occluded="0" points="10.50,20.25" z_order="0"><attribute name="seen">yes</attribute></points>
    <points label="ear" occluded="1" points="1,2;3,4"></points>
    <polyline label="jaw" points="1,2;3,4;5,6"/>
    <polygon label="lip" points="1,2;3,4;5,6"/>
  </image>
  <image id="1" name="b.png" width="640" height="480"></image>
</annotations>"#;
const SKELETONS: &str = r#"<annotations><image id="0" name="a.png" width="9" height="9">
  <skeleton label="face" source="manual" z_order="0"><points label="nose" outside="0" occluded="0" points="10,20"/><points label="eye" outside="1" points="0,0"/></skeleton>
  <skeleton label="face"><points label="nose" outside="0" points="30,40"/><points label="eye" outside="0" points="50,60"/></skeleton>
</image></annotations>"#;
const IIIF: &str = r#"{"type": "AnnotationPage",
  "@context": ["http://iiif.io/api/extension/georef/1/context.json"], "items": [
    {"id": "one", "type": "Annotation", "motivation": "georeferencing",
      "target": {"type": "SpecificResource", "source": {"width": 9, "height": 9}},
     "body": {"type": "FeatureCollection", "transformation": {"type": "polynomial"}, "features": [
        {"type": "Feature", "properties": {"resourceCoords": [578, 3779.5]},
          "geometry": {"type": "Point", "coordinates": [97.18, 3.25]}},
        {"type": "Feature", "properties": {"pixelCoords": [349, 3855]},
          "geometry": {"type": "Point", "coordinates": [95.75, 2.83]}}]}},
    {"id": "two", "type": "Annotation", "label": "inset", "target": "x",
      "body": {"type": "FeatureCollection", "features": [
        {"type": "Feature", "properties": {"resourceCoords": [1, 2]}, "geometry": null}]}}]}"#;

/// What is read of one item.
fn item(file: &str, item: &str) -> Result<Value, Problem> {
    let mut files = both(file.to_owned());
    files.choice.item = Some(Item::Text(item.to_owned()));
    convert(&files)
}

#[test]
fn files_of_annotation_tools_are_read() {
    let named = |format: &str, p: Value, names: Value| json!({"p": p, "names": names, "units": "px", "format": format});
    for (file, chosen, expected) in [
        (
            COCO,
            "a.jpg/3",
            named(
                "coco",
                json!([[10.5, 20.5], null]),
                json!(["nose", "left_eye"]),
            ),
        ),
        (
            COCO,
            "1",
            named(
                "coco",
                json!([[30.5, 40.75], [50.5, 60.5]]),
                json!(["nose", "left_eye"]),
            ),
        ),
        (
            COCO,
            "b.jpg",
            named("coco", json!([[1.5, 2.5]]), json!(["tip"])),
        ),
        (
            r#"[{"image_id": 7, "category_id": 1, "keypoints": [1, 2, 0.9], "score": 0.5}]"#,
            "7",
            json!({"p": [[1.5, 2.5]], "units": "px", "format": "coco"}),
        ),
        (
            DLIB,
            "faces/a & b.jpg",
            named(
                "dlib",
                json!([[10.5, 20.5], [30.5, -3.5]]),
                json!(["00", "01"]),
            ),
        ),
        (
            DLIB,
            "a & b.jpg",
            named(
                "dlib",
                json!([[10.5, 20.5], [30.5, -3.5]]),
                json!(["00", "01"]),
            ),
        ),
        (
            DLIB,
            "c.jpg/1",
            named("dlib", json!([[7.5, 8.5]]), json!(["00"])),
        ),
        (DLIB, "1", named("dlib", json!([[5.5, 6.5]]), json!(["00"]))),
        (
            CVAT,
            "a.png",
            named(
                "cvat",
                json!([
                    [10.5, 20.25],
                    [1.0, 2.0],
                    [3.0, 4.0],
                    [[1.0, 2.0], [3.0, 4.0], [5.0, 6.0]],
                    [[1.0, 2.0], [3.0, 4.0], [5.0, 6.0], [1.0, 2.0]]
                ]),
                json!(["nose", "ear 0", "ear 1", "jaw", "lip"]),
            ),
        ),
        (
            SKELETONS,
            "a.png/0",
            named("cvat", json!([[10.0, 20.0], null]), json!(["nose", "eye"])),
        ),
        (
            SKELETONS,
            "1",
            named(
                "cvat",
                json!([[30.0, 40.0], [50.0, 60.0]]),
                json!(["nose", "eye"]),
            ),
        ),
        (
            IIIF,
            "one",
            json!({"p": [[578.0, 3779.5], [349.0, 3855.0]], "units": "px", "format": "iiif"}),
        ),
        (
            IIIF,
            "inset",
            json!({"p": [[1.0, 2.0]], "units": "px", "format": "iiif"}),
        ),
    ] {
        assert_eq!(
            item(file, chosen).unwrap_or_else(|problem| panic!("{file}: {problem}")),
            expected,
            "{file} {chosen}"
        );
    }
    // Only one item is there.
    assert_eq!(read(CVAT).unwrap(), item(CVAT, "0").unwrap());
    let slicer = r#"{"markups": [{"type": "Fiducial", "coordinateSystem": "IJK", "controlPoints": [
        {"label": "F-1", "position": [3, 4, 0]}, {"label": "F-2", "position": [0, 0, 0],
          "positionStatus": "undefined"}]}]}"#;
    assert_eq!(
        read(slicer).unwrap(),
        named("slicer", json!([[3.5, 4.5], null]), json!(["F-1", "F-2"]))
    );
    let fcsv = "# Markups fiducial file version = 4.13\n# CoordinateSystem = IJK\n# columns = \
        id,x,y,z,ow,ox,oy,oz,vis,sel,lock,label,desc,associatedNodeID\n\
                0,3,4,0,0,0,0,1,1,1,0,F-1,,\n1,5,6,0,0,0,0,1,1,1,0,\"F,2\",,\n";
    assert_eq!(
        read(fcsv).unwrap(),
        named(
            "slicer",
            json!([[3.5, 4.5], [5.5, 6.5]]),
            json!(["F-1", "F,2"])
        )
    );
}

#[test]
fn files_with_several_objects_list_them() {
    for (file, listed) in [
        (
            COCO,
            "3 annotations: 0 `val/a.jpg` `a.jpg` `a.jpg/3`, 1 `val/a.jpg` `a.jpg` `a.jpg/4`, 2 \
                `b.jpg` `b.jpg/5`",
        ),
        (
            DLIB,
            "3 boxes: 0 `faces/a & b.jpg` `a & b.jpg` `a & b.jpg/1`, 1 `c.jpg` `c.jpg/0`, 2 \
                `c.jpg` `c.jpg/1`",
        ),
        (
            SKELETONS,
            "2 objects: 0 `a.png` `a.png/0`, 1 `a.png` `a.png/1`",
        ),
        (IIIF, "2 annotations: 0 `one`, 1 `two` `inset`"),
    ] {
        let problem = read(file).unwrap_err();
        let (_, _, detail) = place(&problem);
        assert!(
            detail.contains("expected `item`, the index or name of one")
                && detail.ends_with(listed),
            "{detail}"
        );
        // A program need not read that sentence.
        let told = problem.to_json("", None);
        let items = told["items"].clone();
        assert_eq!(told["item_count"], items.as_array().unwrap().len());
        for (index, names) in items.as_array().unwrap().iter().enumerate() {
            for name in names.as_array().unwrap() {
                assert!(listed.contains(&format!("`{}`", name.as_str().unwrap())));
            }
            assert!(item(file, &index.to_string()).is_ok(), "{file} {index}");
        }
    }
    // Of many, the first ones, up to a limit of bytes.
    let long = format!("{}.jpg", "a".repeat(3000));
    let rows: Vec<String> = (0..40)
        .map(|k| format!("LM=1\n{k} 1\nIMAGE={k}{long}\n"))
        .collect();
    let problem = read(rows.concat()).unwrap_err();
    let told = problem.to_json("", None);
    let count = told["items"].as_array().unwrap().len();
    assert!((15..25).contains(&count), "{count}");
    assert_eq!(told["item_count"], 40);
    let (_, _, detail) = place(&item(COCO, "a.jpg").unwrap_err());
    assert!(
        detail.contains(
            "expected one item named `a.jpg`; found a second: send `item` as an index, such as 1"
        ),
        "{detail}"
    );
}

/// Two files of one tool are matched by the names that it gives.
#[test]
fn both_sides_of_a_tool_are_matched_by_name() {
    let part = |name: &str, x: u32| format!("<part name='{name}' x='{x}' y='{x}'/>");
    let file = |parts: [String; 2]| {
        format!(
            "<dataset><images><image file='a'><box>{}</box></image></images></dataset>",
            parts.concat()
        )
    };
    let files = LandmarkFiles {
        p: Some(file([part("a", 1), part("b", 2)]).into()),
        q: Some(file([part("b", 20), part("a", 10)]).into()),
        ..LandmarkFiles::default()
    };
    let read = convert(&files).unwrap();
    assert_eq!(
        (&read["p"], &read["q"]),
        (
            &json!([[1.5, 1.5], [2.5, 2.5]]),
            &json!([[10.5, 10.5], [20.5, 20.5]])
        )
    );
}

/// Files, where they are wrong, and a word of the sentence.
const BAD: &[(&str, u64, u64, &str)] = &[
    (
        r#"{"images": [], "annotations": []}"#,
        1,
        31,
        "at least one landmark; found none",
    ),
    (
        r#"{"annotations": [{"keypoints": [1, 2]}], "images": []}"#,
        1,
        32,
        "x, y and v of each keypoint; found 2 numbers",
    ),
    (
        r#"{"annotations": [{"keypoints": [1, "2", 2]}], "images": []}"#,
        1,
        36,
        "remove the quotes",
    ),
    (
        r#"{"annotations": [{"keypoints": [[1, 2, 2]]}], "images": []}"#,
        1,
        32,
        "found 1 numbers",
    ),
    (
        r#"{"annotations": 5, "images": []}"#,
        1,
        17,
        "an array of annotations",
    ),
    (
        concat!(
            r#"{"annotations": [{"keypoints": [1, 2, 2], "category_id": 1}], "#,
            r#""categories": [{"id": 1, "keypoints": ["a", "b"]}]}"#
        ),
        1,
        107,
        "1 names",
    ),
    ("<svg></svg>", 1, 1, "found XML with the element `svg`"),
    ("<?xml version='1.0'?>\n<html>", 1, 1, "dlib XML, CVAT XML"),
    (
        "<dataset>",
        1,
        10,
        "expected </dataset>; found the end of the file",
    ),
    (
        "<dataset></images>",
        1,
        10,
        "expected </dataset>; found the end of `images`",
    ),
    ("<dataset/>", 1, 11, "at least one"),
    (
        "<dataset>\n<part name='a' x='1' y='2'/></dataset>",
        2,
        1,
        "<part> in a <box>",
    ),
    (
        "<dataset><image/></dataset>",
        1,
        10,
        "the attribute `file` of <image>",
    ),
    (
        "<dataset><image file='a'><box><part name='a' x='1'/></box></image></dataset>",
        1,
        31,
        "the attribute `y`",
    ),
    (
        "<dataset><image file='a'><box><part name='a' x='1' y='b'/></box></image></dataset>",
        1,
        55,
        "expected a number; found `b`",
    ),
    (
        "<dataset><image file='a'><box><part name='a' x='1' x='2' y='1'/></box></image></dataset>",
        1,
        52,
        "a second `x`",
    ),
    ("<dataset><image file='&nbsp;'/></dataset>", 1, 23, "entity"),
    (
        "<dataset><image file=a/></dataset>",
        1,
        17,
        "name=\"value\"",
    ),
    ("<dataset><image file='a></dataset>", 1, 10, "quotes"),
    ("<dataset><image <box>", 1, 17, "found `<`"),
    ("<dataset><!DOCTYPE a></dataset>", 1, 10, "a declaration"),
    (
        "<!DOCTYPE dataset [<!ENTITY a 'aaaa'>]><dataset/>",
        1,
        1,
        "landmark file",
    ),
    ("<!DOCTYPE dataset><dataset/>", 1, 1, "a declaration"),
    ("<dataset><!-- </dataset>", 1, 10, "expected `-->`"),
    (
        "<annotations><track id='0'></track></annotations>",
        1,
        14,
        "export the task as `CVAT for images 1.1`",
    ),
    (
        "<annotations><image name='a'><points label='b' points='1;2'/></image></annotations>",
        1,
        56,
        "expected a position, x,y; found `1`",
    ),
    (
        "<annotations><image name='a'><points label='b' points='1,c'/></image></annotations>",
        1,
        58,
        "found `c`",
    ),
    (
        "<annotations><image name='a'><polyline label='b' points='1,2'/></image></annotations>",
        1,
        58,
        "at least 2 positions in a polyline",
    ),
    (
        "<annotations><image name='a'><points points='1,2'/></image></annotations>",
        1,
        30,
        "the attribute `label`",
    ),
    (
        "<annotations><image name='a'><box label='b'/></image></annotations>",
        1,
        68,
        "at least one",
    ),
    (
        r#"{"type": "Annotation", "body": {"features": [{"properties": {"resource": [1, 2]}}]}}"#,
        1,
        46,
        "`resourceCoords`",
    ),
    (
        concat!(
            r#"{"type": "Annotation", "body": {"features": "#,
            r#"[{"properties": {"resourceCoords": [1, 2, 3]}}]}}"#
        ),
        1,
        80,
        "more than 2",
    ),
    (
        r#"{"type": "Annotation", "body": {}}"#,
        1,
        32,
        "`features` is missing",
    ),
    (
        r#"{"markups": [{"coordinateSystem": "LPS", "controlPoints": []}]}"#,
        1,
        35,
        "world coordinates of 3D Slicer, `LPS`, in mm: send CSV",
    ),
    (
        r#"{"markups": [{"controlPoints": []}]}"#,
        1,
        14,
        "(position - origin) / spacing + 0.5",
    ),
    (
        r#"{"markups": [{"coordinateSystem": "IJK", "controlPoints": [{"position": [1, 2]}]}]}"#,
        1,
        73,
        "2 numbers",
    ),
    (
        "# Markups fiducial file version = 4.13\n# CoordinateSystem = 0\n0,1,2,3\n",
        2,
        1,
        "3D Slicer, `RAS`",
    ),
    (
        "# Markups fiducial file version = 4.13\n# CoordinateSystem = IJK\n# columns = \
            id,x,z\n0,1,2\n",
        2,
        1,
        "`x` and `y`",
    ),
    (
        "# Markups fiducial file version = 4.13\n# CoordinateSystem = IJK\n0,1\n",
        3,
        1,
        "found nothing",
    ),
];

#[test]
fn bad_files_are_refused_with_line_and_column() {
    let mut wrong = Vec::new();
    for &(file, line, column, word) in BAD {
        let Err(problem) = read(file) else {
            wrong.push(format!("{file:?} is read"));
            continue;
        };
        let (found_line, found_column, detail) = place(&problem);
        if (problem.code.as_str(), found_line, found_column) != ("bad_landmarks", line, column)
            || !detail.contains(word)
        {
            wrong.push(format!(
                "{file:?}: expected {line}:{column} {word}; {found_line}:{found_column} {detail}"
            ));
        }
    }
    assert!(wrong.is_empty(), "{}", wrong.join("\n"));
}

#[test]
fn too_many_handles_are_refused_in_each_format() {
    let many = |what: &'static str| vec![what; MAX_COLUMNS + 1];
    let xml =
        |inside: String| format!("<annotations><image name='a'>{inside}</image></annotations>");
    for file in [
        format!(
            r#"{{"images": [], "annotations": [{{"keypoints": [{}]}}]}}"#,
            many("1, 2, 2").join(",")
        ),
        format!(
            "<dataset><image file='a'><box>{}</box></image></dataset>",
            many("<part name='a' x='1' y='2'/>").concat()
        ),
        xml(format!(
            "<points label='a' points='{}'/>",
            many("1,2").join(";")
        )),
        xml(many("<points label='a' points='1,2'/>").concat()),
        xml(format!(
            "<polyline label='a' points='{}'/>",
            many("1,2").join(";")
        )),
        format!(
            r#"{{"type": "a", "body": {{"features": [{}]}}}}"#,
            many(r#"{"properties": {"resourceCoords": [1, 2]}}"#).join(",")
        ),
        format!(
            r#"{{"markups": [{{"coordinateSystem": "IJK", "controlPoints": [{}]}}]}}"#,
            many(r#"{"position": [1, 2, 3]}"#).join(",")
        ),
        format!(
            "# Markups fiducial file\n# CoordinateSystem = IJK\n{}",
            many("0,1,2,3\n").concat()
        ),
    ] {
        let start: String = file.chars().take(60).collect();
        let document = read(&file).expect_err(&start).to_json("", None);
        assert_eq!(
            (&document["code"], &document["limit_name"]),
            (&"too_large".into(), &"handle_columns".into()),
            "{start}: {document}"
        );
    }
}

/// Names are copied several times: their length is limited before.
#[test]
fn names_that_are_too_long_are_refused_in_each_format() {
    let long = "a".repeat(5000);
    for file in [
        format!("<dataset><image file='{long}'/></dataset>"),
        format!("<annotations><image name='{long}'/></annotations>"),
        format!(
            r#"{{"images": [], "annotations": [{{"image_id": "{long}", "keypoints": [1, 2, 2]}}]}}"#
        ),
        format!(
            r#"{{"images": [{{"id": 1, "file_name": "{long}"}}], "annotations": [{{"image_id": 1,
              "keypoints": [1, 2, 2]}}]}}"#
        ),
        format!(r#"{{"type": "a", "id": "{long}", "body": {{"features": []}}}}"#),
        format!(
            r#"{{"markups": [{{"type": "{long}", "coordinateSystem": "IJK",
              "controlPoints": []}}]}}"#
        ),
    ] {
        let (_, _, detail) = place(&read(&file).unwrap_err());
        assert!(detail.contains("a name of at most 4096 bytes"), "{detail}");
    }
}

#[test]
fn elements_that_are_nested_too_deeply_are_refused() {
    let (line, column, detail) =
        place(&read(format!("<dataset>{}", "<a>".repeat(1 << 20))).unwrap_err());
    assert_eq!((line, column), (1, 10 + 3 * 63), "{detail}");
    assert!(
        detail.contains("at most 64 elements inside one another"),
        "{detail}"
    );
}

/// Each good file, cut off anywhere, is read or refused with a place.
#[test]
fn truncated_files_are_read_or_refused_with_a_place() {
    for file in [COCO, DLIB, CVAT, SKELETONS, IIIF] {
        for length in (0..file.len()).filter(|length| file.is_char_boundary(*length)) {
            if let Err(problem) = item(&file[..length], "0") {
                let (line, column, detail) = place(&problem);
                assert!(
                    line > 0 && column > 0 && problem.code.as_str() == "bad_landmarks",
                    "{file}, {length} bytes: {detail}"
                );
            }
        }
        assert!(item(&file[..file.len() - 1], "0").is_err(), "{file}");
    }
}
