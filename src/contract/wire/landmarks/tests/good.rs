use serde_json::{Value, json};

use super::read;
use crate::wire::landmarks::FORMATS;

/// The centre of the first pixel, and the centre of the pixel (9, 4), as each format writes them.
/// (Normalised: of an image of 16 x 8 px.)
const CENTRES: &[(&str, &str)] = &[
    ("json", r#"{"p": [[0.5, 0.5], [9.5, 4.5]]}"#),
    (
        "json",
        r#"{"units": "px", "p": [[5e-1, 0.5], [9.5, 4.5]], "q": null}"#,
    ),
    ("csv", "x,y\n0.5,0.5\n9.5,4.5\n"),
    ("csv", "0,5;0,5\n9,5;4,5\n"),
    (
        "bigwarp",
        "\"Pt-0\",\"true\",\"0.0\",\"0.0\",\"3.0\",\"3.0\"\n\
         \"Pt-1\",\"true\",\"9.0\",\"4.0\",\"5.0\",\"5.0\"\n",
    ),
    (
        "pts",
        "version: 1\nn_points:  2\n{\n1.000000 1.000000\n10.000000 5.000000\n}\n",
    ),
    ("pts", "n_points: 2\n{\n1 1\n10 5\n}"),
    ("tem", "2\n0\t0\n9\t4\n0\n"),
    ("tem", "# WebMorph\n\n2\n0.0 0.0\n9.0 4.0\n"),
    (
        "mediapipe",
        r#"[{"x": 0.03125, "y": 0.0625, "z": -0.1}, {"x": 0.59375, "y": 0.5625, "z": 0}]"#,
    ),
    (
        "arkit",
        r#"{"jointLandmarks": [[0.03125, 0.0625], [0.59375, 0.5625]]}"#,
    ),
    (
        "labelme",
        r#"{"version": "5.5.0", "flags": {}, "shapes": [
            {"label": "a", "points": [[0.5, 0.5]], "group_id": null, "shape_type": "point",
              "flags": {}},
            {"label": "b", "points": [[9.5, 4.5]], "shape_type": "point"}],
              "imagePath": "face.jpg", "imageData": null, "imageHeight": 8}"#,
    ),
    (
        "qgis",
        "#CRS: EPSG:3857\nmapX,mapY,sourceX,sourceY,enable,dX,dY,residual\n\
         1e6,2e6,0.5,-0.5,1,0,0,0\n1e6,2e6,9.5,-4.5,1,0,0,0\n",
    ),
    (
        "tps",
        "LM=2\n0.5 7.5\n9.5 3.5\nIMAGE=a.jpg\nID=0\nSCALE=0.01\n",
    ),
    ("elastix", "index\n2\n0 0\n9 4\n"),
    ("napari", "index,axis-0,axis-1\n0.0,0.0,0.0\n1.0,4.0,9.0\n"),
    (
        "openface",
        "frame, face_id, timestamp, confidence, success, x_0, x_1, y_0, y_1\n1, 0, 0.0, 0.98, 1, \
            0, 9, 0, 4\n",
    ),
    (
        "bigwarp",
        r#"{"Transform": {"landmarks": {"type": "BigWarpLandmarks", "numDimensions": 2,
          "movingPoints": [[0, 0], [9, 4]],
        "fixedPoints": [[3, 3], [5, 5]], "active": [true, true], "names": ["a", "b"]}}}"#,
    ),
    (
        "deeplabcut",
        "scorer,me,me,me,me\nbodyparts,a,a,b,b\ncoords,x,y,x,y\nvideo/img1.png,0,0,9,4\n",
    ),
    (
        "coco",
        r#"{"images": [], "annotations": [{"keypoints": [0, 0, 2, 9, 4, 1]}]}"#,
    ),
    (
        "dlib",
        "<dataset><images><image file='a'><box><part name='0' x='0' y='0'/><part name='1' x='9' \
            y='4'/></box></image></images></dataset>",
    ),
    (
        "cvat",
        "<annotations><image name='a'><points label='a' \
            points='0.5,0.5;9.5,4.5'/></image></annotations>",
    ),
    (
        "iiif",
        r#"{"type": "Annotation", "target": "x", "body": {"features": [
            {"properties": {"resourceCoords": [0.5, 0.5]}},
              {"properties": {"resourceCoords": [9.5, 4.5]}}]}}"#,
    ),
    (
        "slicer",
        "# Markups fiducial file version = 4.13\n# CoordinateSystem = IJK\n# columns = \
            id,x,y,z\n0,0,0,0\n1,9,4,0\n",
    ),
    (
        "qgis",
        "mapX,mapY,pixelX,pixelY,enable\n13.4,52.5,0.5,-0.5,1\n13.5,52.6,9.5,-4.5,1\n",
    ),
];

#[test]
fn convention_the_centre_of_the_first_pixel_is_half_in_each_format() {
    for (format, file) in CENTRES {
        let image = mlswarp::pixmap::Extent::new(16, 8);
        let read = super::both(*file).read(super::MAX_COLUMNS, &|| false);
        let read = read
            .and_then(|landmarks| landmarks.scale(image))
            .unwrap_or_else(|problem| panic!("{format}: {problem}"));
        let read = json!(read);
        assert_eq!(read["format"], *format);
        assert_eq!(read["units"], "px", "{format}");
        assert_eq!(read["p"], json!([[0.5, 0.5], [9.5, 4.5]]), "{format}");
    }
    for format in FORMATS {
        assert!(
            CENTRES.iter().any(|(name, _)| *name == format.name),
            "{} has no file",
            format.name
        );
    }
}

/// The names that a response may have stand twice in the pattern: of one file, and of the second of
/// two.
#[test]
fn the_contract_has_the_name_of_each_format_and_the_readme_their_number() {
    let contract: Value =
        serde_json::from_str(include_str!("../../../../../api/openapi.json")).unwrap();
    let pattern = &contract["components"]["schemas"]["LandmarkFormat"]["pattern"];
    let names: Vec<&str> = FORMATS.iter().map(|format| format.name).collect();
    let listed: Vec<&str> = pattern
        .as_str()
        .unwrap()
        .split(|c: char| !c.is_ascii_lowercase())
        .filter(|name| !name.is_empty())
        .collect();
    for name in &names {
        let count = listed.iter().filter(|listed| *listed == name).count();
        assert_eq!(count, 2, "{name}");
    }
    for listed in listed {
        assert!(names.contains(&listed), "{listed}");
    }
    let kinds = format!("landmark files of {} kinds", FORMATS.len());
    assert!(
        include_str!("../../../../../README.md").contains(&kinds),
        "README.md: {kinds}"
    );
}

/// Files and what is read from them.
fn files() -> Vec<(&'static str, Value)> {
    let (p, q) = (
        json!([[1.0, 2.0], [3.0, 4.0]]),
        json!([[5.0, 6.0], [7.0, 8.0]]),
    );
    let csv = |names: Value| match names {
        Value::Null => json!({"p": p, "q": q, "units": "px", "format": "csv"}),
        names => json!({"p": p, "q": q, "names": names, "units": "px", "format": "csv"}),
    };
    let one_side = json!({"p": p, "units": "px", "format": "csv"});
    let named_side = json!({"p": p, "names": ["a", "b"], "units": "px", "format": "csv"});
    let mediapipe =
        |places: Value| json!({"p": places, "units": "normalized", "format": "mediapipe"});
    vec![
        ("1,2\n3,4", one_side.clone()),
        ("1,2\r\n3,4\r\n", one_side.clone()),
        ("\u{feff}x,y\r\n1,2\r\n3,4\r\n", one_side.clone()),
        ("\n\nX , Y\n\n1 , 2\n3 , 4\n\n", one_side.clone()),
        ("y,x\n2,1\n4,3\n", one_side.clone()),
        ("x\ty\n1\t2\n3\t4\n", one_side.clone()),
        ("1 2\n3 4", one_side.clone()),
        ("  x   y\r\n  1 2.0\r\n\t3\t \t4  \r\n", one_side.clone()),
        ("1,0\t2,0\n3\t4\n", one_side.clone()),
        ("# exported\n# x,y\n1,2\n3,4\n", one_side.clone()),
        // The results table of ImageJ.
        (" ,Area,Mean,X,Y\n1,0,137.5,1,2\n2,0,92,3,4\n", one_side),
        ("name,x,y\na,1,2\nb,3,4\n", named_side.clone()),
        ("a,1,2\nb,3,4\n", named_side.clone()),
        ("1 2 a\n\"3\" 4 \"b\"\n", named_side.clone()),
        (
            "name,x,y\na,1,2\na,3,4\n",
            json!({"p": p, "names": ["a", "a"], "units": "px", "format": "csv"}),
        ),
        (
            "name,x,y\na;a,1,2\n\"b\"\"\tb\",3,4\n",
            json!({"p": p, "names": ["a;a", "b\"\tb"], "units": "px", "format": "csv"}),
        ),
        ("1,2,a\n3,4,b\n", named_side.clone()),
        ("x;y;label\n1,0;2,0;a\n3,0;4,0;b\n", named_side.clone()),
        (
            "\"name\",\"x\",\"y\"\n\"a\",\"1\",\"2\"\n\"b\",\"3\",\"4\"\n",
            named_side,
        ),
        (
            "name,x,y\n\"tip, left\",1,2\n\"he said \"\"b\"\"\",3,4\n",
            json!({
            "p": p, "names": ["tip, left", "he said \"b\""], "units": "px", "format": "csv"}),
        ),
        (
            "x,y,name\n1,2,\n3,4,\n",
            json!({"p": p, "units": "px", "format": "csv"}),
        ),
        ("1,2,5,6\n3,4,7,8\n", csv(Value::Null)),
        ("px,py,qx,qy\n1,2,5,6\n3,4,7,8\n", csv(Value::Null)),
        (
            "qx,qy,px,py,confidence\n5,6,1,2,0.9\n7,8,3,4,0.8\n",
            csv(Value::Null),
        ),
        (
            "id,px,py,qx,qy\n1,1,2,5,6\n2,3,4,7,8\n",
            csv(json!(["1", "2"])),
        ),
        ("1e0,+2,5.,6\n.3e1,4,7,8\n", csv(Value::Null)),
        (
            "left;1;2;5;6\nright;3;4;7;8\n",
            csv(json!(["left", "right"])),
        ),
        (
            "\"Pt-0\",\"true\",\"10.5\",\"20.0\",\"11.0\",\"21.0\"\n\
             \"Pt-1\",\"false\",\"1\",\"1\",\"Infinity\",\"Infinity\"\n\
             \"Pt-2\",\"true\",\"1\",\"1\",\"-Infinity\",\"Infinity\"\n",
            json!({"p": [[11.0, 20.5]], "q": [[11.5, 21.5]], "names": ["Pt-0"], "units": "px",
                "format": "bigwarp",
                   "unmatched": {"p": ["Pt-2"], "q": []}}),
        ),
        (
            "Pt-0,true,7,1.5,2.5,3.5,4.5\n",
            json!({
            "p": [[2.0, 3.0]], "q": [[4.0, 5.0]], "names": ["Pt-0"], "units": "px",
                "format": "bigwarp"}),
        ),
        (
            "version: 1\r\nn_points: 3\r\n{\r\n10 20\r\n30.5\t40\r\n  50 60.25\r\n}\r\n",
            json!({
            "p": [[9.5, 19.5], [30.0, 39.5], [49.5, 59.75]], "units": "px", "format": "pts"}),
        ),
        // A contour of the points 0, 1, 2, closed; another one of 1 and 3, open; the point 4 is on
        // none.
        (
            "5\n0 0\n10 0\n10 10\n20 5\n30 5\n2\n1\n3\n0 1 2\n0\n2\n1 3\n",
            json!({
            "p": [[30.5, 5.5], [[0.5, 0.5], [10.5, 0.5], [10.5, 10.5], [0.5, 0.5]],
                [[10.5, 0.5], [20.5, 5.5]]],
            "units": "px", "format": "tem"}),
        ),
        (
            "3\n0\t0\n10\t0\n10\t10\n1\n1\n4\n0 1 2 0\n",
            json!({
            "p": [[[0.5, 0.5], [10.5, 0.5], [10.5, 10.5], [0.5, 0.5]]], "units": "px",
                "format": "tem"}),
        ),
        // What WebMorph appends.
        (
            "2\n0 0\n10 0\n1\n0\n2\n0 1\n43\n\n{\n    \"image\": \"/a.jpg\"\n}\n",
            json!({"p": [[[0.5, 0.5], [10.5, 0.5]]], "units": "px", "format": "tem"}),
        ),
        // The pupils of WebMorph's templates are contours of one point. An index that follows
        // itself counts once.
        (
            "3\n0 0\n10 0\n10 10\n3\n0\n2\n0 0\n1\n2\n0 0\n0\n4\n1 1 2 2\n",
            json!({"p": [[0.5, 0.5], [[10.5, 0.5], [10.5, 10.5]]], "units": "px", "format": "tem"}),
        ),
        (
            r#"[{"x": 0.25, "y": 0.5, "z": -0.01, "visibility": 0.9, "presence": 1}]"#,
            mediapipe(json!([[0.25, 0.5]])),
        ),
        (
            r#"[[{"x": 0.25, "y": 0.5}]]"#,
            mediapipe(json!([[0.25, 0.5]])),
        ),
        (
            r#"{"landmark": [{"x": 0.25, "y": 0.5, "z": 0}, {"x": 1.01, "y": -0.01}]}"#,
            mediapipe(json!([[0.25, 0.5], [1.01, -0.01]])),
        ),
        (
            r#"{"faceLandmarks": [[{"x": 0.25, "y": 0.5}]],
              "faceBlendshapes": [{"categories": []}]}"#,
            mediapipe(json!([[0.25, 0.5]])),
        ),
        (
            r#"{"landmarks": [[0.25, 0.5, -0.1], [0.5, 0.75, 0]]}"#,
            mediapipe(json!([[0.25, 0.5], [0.5, 0.75]])),
        ),
        (
            r#"{"landmarks": [{"name": "nose", "x": 0.25, "y": 0.5}]}"#,
            json!({
            "p": [[0.25, 0.5]], "names": ["nose"], "units": "normalized", "format": "mediapipe"}),
        ),
        (
            r#"{"jointNames": ["root", "head"], "jointLandmarks": [[0.5, 0.5], [0.5, 0.25]]}"#,
            json!({
            "p": [[0.5, 0.5], [0.5, 0.25]], "names": ["root", "head"], "units": "normalized",
                "format": "arkit"}),
        ),
        (
            r#"{"shapes": [{"label": "eye", "points": [[1, 2]], "shape_type": "point"},
                {"label": "jaw", "points": [[1, 2], [3, 4]], "shape_type": "line"},
                {"label": "lip", "points": [[1, 2], [3, 4], [5, 6]], "shape_type": "linestrip"},
                {"label": "face", "points": [[1, 2], [3, 4], [5, 7]]}],
                  "imageData": "iVBORw0KGgo="}"#,
            json!({"p": [[1.0, 2.0], [[1.0, 2.0], [3.0, 4.0]], [[1.0, 2.0], [3.0, 4.0], [5.0, 6.0]],
                         [[1.0, 2.0], [3.0, 4.0], [5.0, 7.0], [1.0, 2.0]]],
                   "names": ["eye", "jaw", "lip", "face"], "units": "px", "format": "labelme"}),
        ),
        (
            "#CRS: PROJCRS[\"a, \
                b\",ID[\"EPSG\",3035]]\nmapX,mapY,sourceX,sourceY,enable,dX,dY,residual\n\
                4e6,3e6,3899,-1161,1,0,0,0\n4e6,3e6,1,-1,0,0,0,0\n",
            json!({"p": [[3899.0, 1161.0]], "units": "px", "format": "qgis"}),
        ),
        (
            r#"{"p": [[1, 2], [[3, 4], [5, 6]]], "q": [[2, 2], [[3, 5], [5, 7]]], "names": ["a",
              "é\n"]}"#,
            json!({
            "p": [[1.0, 2.0], [[3.0, 4.0], [5.0, 6.0]]], "q": [[2.0, 2.0],
                [[3.0, 5.0], [5.0, 7.0]]], "names": ["a", "é"],
            "units": "px", "format": "json"}),
        ),
        (
            r#"{"p": [[0.5, 0.25]], "units": "normalized"}"#,
            json!({"p": [[0.5, 0.25]], "units": "normalized", "format": "json"}),
        ),
    ]
}

#[test]
fn files_of_each_program_are_read() {
    for (file, expected) in files() {
        let read = read(file).unwrap_or_else(|problem| panic!("{file}: {problem}"));
        assert_eq!(read, expected, "{file}");
    }
}

#[test]
fn json_that_was_written_is_read_again() {
    for (file, expected) in files() {
        let mut again = read(serde_json::to_vec_pretty(&expected).unwrap())
            .unwrap_or_else(|problem| panic!("{file}: {problem}"));
        for varying in ["format", "unmatched"] {
            again[varying] = expected[varying].clone();
        }
        assert_eq!(
            again,
            expected
                .as_object()
                .map(|fields| {
                    let mut fields = fields.clone();
                    fields.entry("unmatched").or_insert(Value::Null);
                    Value::Object(fields)
                })
                .unwrap(),
            "{file}"
        );
    }
}

#[test]
fn csv_that_was_written_is_read_again() {
    let numbers = [0.1, -3.5e-7, 1e6, 123_456.789_012_345, 1e-9];
    let names = ["a", "b, c", "\"d\"", "e;f", "g\th"];
    for (separator, decimal) in [(",", "."), (";", "."), (";", ","), ("\t", ".")] {
        let number = |value: f64| value.to_string().replace('.', decimal);
        let rows = numbers.iter().zip(names).map(|(value, name)| {
            let fields = [
                format!("\"{}\"", name.replace('"', "\"\"")),
                number(*value),
                number(-value),
                number(value / 3.0),
                number(1.0),
            ];
            fields.join(separator)
        });
        let text = [["name", "px", "py", "qx", "qy"].join(separator)]
            .into_iter()
            .chain(rows)
            .collect::<Vec<_>>()
            .join("\r\n");
        let read = read(&text).unwrap();
        assert_eq!(read["names"], json!(names), "{text}");
        assert_eq!(
            read["p"],
            json!(numbers.map(|value| [value, -value])),
            "{text}"
        );
        assert_eq!(
            read["q"],
            json!(numbers.map(|value| [value / 3.0, 1.0])),
            "{text}"
        );
    }
}
