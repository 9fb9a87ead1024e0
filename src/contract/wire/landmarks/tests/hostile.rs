use super::{MAX_COLUMNS, place, read};

/// Files, where they are wrong, and a word of the sentence.
const BAD: &[(&str, u64, u64, &str)] = &[
    ("", 1, 1, "empty"),
    ("\u{feff} \r\n", 1, 1, "empty"),
    ("hello", 1, 1, "landmark file"),
    (
        "hello world\nagain",
        1,
        1,
        "BigWarp CSV, QGIS .points, napari points, DeepLabCut CSV, OpenFace CSV, CSV",
    ),
    ("1 2\n3 4 5\n", 2, 5, "2 fields"),
    ("1 2\n3 \"four\n", 2, 3, "`\"four`"),
    ("1,5\t2,5\n3.5\t4\n", 2, 1, "expected a decimal comma"),
    ("x;y\n1.5;2\n3;4,5\n", 3, 3, "expected a decimal point"),
    ("1,5 2,5\n", 1, 1, "decimal commas need tabs or semicolons"),
    (
        "1,5\t2,5\n3,4\n",
        1,
        1,
        "decimal commas need tabs or semicolons",
    ),
    ("# nothing\n", 1, 1, "comments only"),
    ("a,b\n1,2\n", 1, 1, "columns `x`, `y`"),
    ("x,y\n", 2, 1, "at least one"),
    ("x,z\n1,2\n", 1, 1, "`y`"),
    ("px,py,qx\n1,2,3\n", 1, 1, "`qy`"),
    ("x,y,qx,qy\n1,2,3,4\n", 1, 1, "both kinds"),
    ("x,y,x\n1,2,3\n", 1, 5, "twice"),
    ("qx,qy\n1,2\n", 1, 1, "landmark file"),
    (
        "1,2,3\n",
        1,
        1,
        "found 3 fields: is the first a number of the row? give the file a header: id,x,y",
    ),
    ("1 100.5 200.5\n", 1, 1, "give the file a header: id,x,y"),
    (
        "1;2;3;4;5\n",
        1,
        1,
        "give the file a header: id,px,py,qx,qy",
    ),
    (
        "1,2,3,4,5,6\n",
        1,
        1,
        "found 6 fields: write one landmark in a line",
    ),
    (
        "a,b,c,d,e,f\n",
        1,
        1,
        "`x`, `y` or `px`, `py`, `qx`, `qy`, beside which there may be others; found `a`, `b`",
    ),
    ("c0,c1,c2,c3,c4,c5,c6,c7,c8,c9\n", 1, 1, "`c7` and 2 more"),
    ("left,1,2,3,4,5\n", 1, 1, "found 6 fields"),
    ("1,2\n3\n", 2, 1, "2 fields"),
    ("1,2\n3,4,5\n", 2, 5, "2 fields"),
    ("1,2\n3,four\n", 2, 3, "`four`"),
    ("é,1,2\nü,3,ß\n", 2, 5, "`ß`"),
    ("x,y\n1,\n", 2, 3, "nothing"),
    ("name,x,y\n,1,\n", 2, 4, "nothing"),
    (
        "name,x,y\na,,\nb,NaN,2\n",
        4,
        1,
        "landmarks without positions only",
    ),
    ("name,x,y\na,inf,2\n", 2, 3, "finite"),
    ("x,y\n1,NaN\n", 2, 3, "finite"),
    ("x,y\n1,2\n1e999,3\n", 3, 1, "finite"),
    ("x,y\n1,-inf\n", 2, 3, "finite"),
    ("x,y\n1,2000000\n", 2, 3, "1000000"),
    ("1.5,2.5\n\"1,5\",2\n", 2, 1, "number"),
    ("x;y\n1,2,3;4\n", 2, 1, "number"),
    ("name,x,y\na,1,2\n,3,4\n", 3, 1, "a name"),
    ("name,x,y\n\"a,1,2\nb,3,4\n", 2, 1, "3 fields"),
    ("Pt-0,true,1,2,3,4,5,6\n", 1, 1, "3 dimensions"),
    ("Pt-0,true,1,2,3,4\nPt-1,maybe,1,2,3,4\n", 2, 6, "`maybe`"),
    ("Pt-0,true,1,2,3,4\nPt-1,true,1,2,3\n", 2, 15, "6 fields"),
    ("Pt-0,false,1,2,3,4\n", 2, 1, "at least one"),
    ("Pt-0,true,1,2,3,NaN\n", 1, 17, "finite"),
    (
        "Pt-0,true,1,2,3,4\nPt-1,false,1,2,Infinity,x\n",
        2,
        25,
        "`x`",
    ),
    ("Pt-0,true,1,2,3,4\nPt-1,false,NaN,2,3,4\n", 2, 12, "finite"),
    ("version: 1\n", 2, 1, "`{`"),
    ("version: 1\nn_points: 68\n{\n1 2\n", 5, 1, "`}`"),
    ("version: 1\nn_points: 2\n{\n1 2\n}\n", 5, 1, "2 points"),
    ("version: 1\nn_points: two\n{\n}\n", 2, 10, "whole number"),
    ("version: 1\nn_points: 1\n{\n1 2 3\n}\n", 4, 5, "third"),
    ("version: 1\nn_points: 1\n{\n1\n}\n", 4, 1, "2 numbers"),
    ("version: 1\nn_points: 1\n{\n1 x\n}\n", 4, 3, "`x`"),
    ("version: 1\nn_points: 0\n{\n}\n", 4, 1, "at least one"),
    (
        "version: 1\nn_points: 1\n{\n1 2\n}\nmore\n",
        6,
        1,
        "end of the file",
    ),
    ("version: 1\npoints\n{\n1 2\n}\n", 2, 1, "`points`"),
    ("3\n0 0\n1 1\n", 4, 1, "3 points"),
    ("1\n0 0 0\n", 2, 5, "third"),
    ("1\n0 0\n1\n2\n2\n0 0\n", 4, 1, "closed"),
    ("2\n0 0\n1 1\n1\n0\n3\n0 1\n", 7, 1, "3 indices"),
    ("2\n0 0\n1 1\n1\n0\n2\n0 2\n", 7, 3, "0 to 1"),
    ("2\n0 0\n1 1\n1\n0\n1\n0\n", 7, 1, "2 indices"),
    ("0\n", 2, 1, "at least one"),
    (
        "2\n0 0\n0 0\n2\n0\n2\n0 0\n0\n2\n0 1\n",
        10,
        1,
        "positions 0 and 1 are the same",
    ),
    ("99999999999999999999999\n0 0\n", 1, 1, "whole number"),
    ("mapX,mapY,pixelX\n1,2,3\n", 1, 1, "`sourceX`"),
    (
        "mapX,mapY,sourceX,sourceY,enable\n1,2,3,-4,x\n",
        2,
        10,
        "`x`",
    ),
    ("mapX,mapY,sourceX,sourceY\n1,2,3\n", 2, 5, "4 fields"),
    (
        "mapX,mapY,sourceX,sourceY,enable\n1,2,3,-4,1\n1,2,x,-4,0\n",
        3,
        5,
        "`x`",
    ),
    ("LM3=1\n1 2 3\n", 1, 1, "in 2 dimensions, `LM=`; found 3"),
    ("LM=2\n1 2\n", 3, 1, "a position"),
    ("LM=1\n1 2\n3 4\n", 3, 1, "`LM=` or another setting"),
    ("LM=two\n1 2\n", 1, 4, "the number of landmarks"),
    (
        "LM=1\n1 2\nID=0\nLM=1\n3 4\nID=1\n",
        4,
        1,
        "because the file has 2 specimens: 0 `0`, 1 `1`",
    ),
    (
        "point\n1\n3.5 4\n",
        1,
        1,
        "world coordinates: subtract the origin",
    ),
    ("index\n3\n0 0\n", 4, 1, "3 points"),
    ("index\n1\n0 0 0\n", 3, 5, "third"),
    (
        "index,shape-type,vertex-index,axis-0,axis-1\n0,line,0,1,2\n",
        1,
        7,
        "a shapes layer",
    ),
    (
        "index,axis-0,axis-1,axis-2\n0,3,4,9\n1,3,0,0\n2,5,1,1\n",
        4,
        1,
        "2 slices: 0 `3`, 1 `5`",
    ),
    ("frame,success,x_0,y_0\n1,0,2,3\n", 2, 3, "`success` 0"),
    (
        "scorer,me,me\nbodyparts,a,a\n",
        3,
        1,
        "the header row `coords`",
    ),
    (
        "{\"movingPoints\": [[1, 2, 3]], \"fixedPoints\": []}",
        1,
        19,
        "2 dimensions; found 3",
    ),
    ("{\"Transform\": {}}", 1, 15, "a transform without them"),
    ("{", 1, 1, "not JSON"),
    ("{\"p\": [[1, 2]\n", 2, 1, "not JSON"),
    ("{\"p\": [[1, 2],\n [3, NaN]]}", 2, 6, "not JSON"),
    ("{\"p\": [[1, 2],\n [3, 1e999]]}", 2, 6, "range"),
    ("{\"p\": [[1, 2],\n [3]]}", 2, 2, "1 number"),
    ("{\"p\": [[1, 2],\n [3, \"4\"]]}", 2, 6, "remove the quotes"),
    ("{\"p\": [[1, 2]], \"q\": []}", 1, 22, "1 handles"),
    (
        "{\"p\": [[1, 2]], \"q\": [[1, 2], [3, 4]]}",
        1,
        31,
        "found more",
    ),
    (
        "{\"p\": [[[1, 2], [3, 4]]], \"q\": [[1, 2]]}",
        1,
        33,
        "2 positions",
    ),
    (
        "{\"p\": [[1, 2]], \"names\": [\"a\", \"b\"]}",
        1,
        32,
        "1 names",
    ),
    (
        "{\"p\": [[1, 2]], \"method\": \"rigid\"}",
        1,
        27,
        "unknown field",
    ),
    ("{\"p\": []}", 1, 7, "at least one"),
    ("{\"p\": [[3e6, 0]]}", 1, 8, "1000000"),
    ("{\"landmarks\": 5}", 1, 15, "list of landmarks"),
    (
        "[{\"x\": 0.5, \"y\": 0.5}, {\"x\": 0.5}]",
        1,
        24,
        "`y` is missing",
    ),
    ("[{\"x\": 312, \"y\": 88}]", 1, 2, "from -4 to 4"),
    ("[[1, 2], [3, 4]]", 1, 2, "may be px"),
    (
        "{\"faceLandmarks\": [[{\"x\": 0, \"y\": 0}],\n [{\"x\": 0, \"y\": 0}]]}",
        2,
        2,
        "expected `item`, the index or name of one, because the file has 2 lists: 0, 1",
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
        assert_eq!(
            (problem.code.as_str(), problem.status()),
            ("bad_landmarks", 422),
            "{file}"
        );
        let (found_line, found_column, detail) = place(&problem);
        let is_placed = detail.starts_with(&format!("landmarks, line {line}, column {column}: "));
        if (found_line, found_column) != (line, column) || !detail.contains(word) || !is_placed {
            wrong.push(format!(
                "{file:?}: expected {line}:{column} {word}; {found_line}:{found_column} {detail}"
            ));
        }
    }
    assert!(wrong.is_empty(), "{}", wrong.join("\n"));
}

#[test]
fn bad_labelme_files_are_refused_with_line_and_column() {
    for (shape, column, word) in [
        (
            r#"{"label": "a", "points": [[1, 2]], "shape_type": "circle"}"#,
            50,
            "`circle`",
        ),
        (
            r#"{"label": "a", "points": [[1, 2], [3, 4]], "shape_type": "point"}"#,
            26,
            "1 position",
        ),
        (
            r#"{"label": "a", "points": [[1, 2]], "shape_type": "line"}"#,
            26,
            "at least 2",
        ),
        (
            r#"{"label": "a", "shape_type": "point"}"#,
            1,
            "`points` is missing",
        ),
        (
            r#"{"label": 5, "points": [[1, 2]], "shape_type": "point"}"#,
            11,
            "a label",
        ),
        (
            r#"{"label": "a", "points": [[1, 2, 3]], "shape_type": "point"}"#,
            27,
            "more than 2",
        ),
    ] {
        let problem = read(format!("{{\"shapes\": [\n{shape}]}}")).expect_err(shape);
        let (line, found, detail) = place(&problem);
        assert_eq!(
            (problem.code.as_str(), line, found),
            ("bad_landmarks", 2, column),
            "{detail}"
        );
        assert!(detail.contains(word), "{detail}");
    }
}

#[test]
fn bytes_that_are_no_text_are_refused_where_they_are() {
    for (file, line, column, word) in [
        (&b"\x89PNG\r\n\x1a\n"[..], 1, 1, "0x89"),
        (b"x,y\n1,2\nM\xfcller,3\n", 3, 2, "0xfc"),
        (b"\xff\xfex\0,\0y\0", 1, 1, "UTF-16"),
        (b"1,2\n3,\0", 2, 3, "zero byte"),
    ] {
        let problem = read(file).expect_err(word);
        let (found_line, found_column, detail) = place(&problem);
        assert_eq!(
            (problem.code.as_str(), found_line, found_column),
            ("bad_landmarks", line, column),
            "{detail}"
        );
        assert!(detail.contains(word), "{detail}");
    }
}

/// The number of handles is limited before memory is allocated.
#[test]
fn too_many_handles_are_refused_in_each_format() {
    let many = |n: usize, what: &str| vec![what; n].join(",");
    let rows = |row: &str| row.repeat(MAX_COLUMNS + 1);
    let quoted = (0..=MAX_COLUMNS)
        .map(|n| format!("\"Pt-{n}\",true,1,2,3,Infinity\n"))
        .collect::<String>();
    for file in [
        rows("1,2\n"),
        rows("1,2,3,4\n"),
        rows("a,true,1,2,3,4\n"),
        quoted,
        format!("version: 1\n{{\n{}}}\n", rows("1 2\n")),
        format!("{}\n{}", MAX_COLUMNS + 1, rows("1 2\n")),
        format!(
            "2\n0 0\n1 1\n1\n0\n{}\n{}\n",
            MAX_COLUMNS + 3,
            "0 1 ".repeat(MAX_COLUMNS / 2 + 1) + "0"
        ),
        format!("mapX,mapY,pixelX,pixelY\n{}", rows("1,2,3,-4\n")),
        format!("LM={}\n{}", MAX_COLUMNS + 1, rows("1 2\n")),
        format!("index\n{}\n{}", MAX_COLUMNS + 1, rows("1 2\n")),
        format!("index,axis-0,axis-1\n{}", rows("0,1,2\n")),
        format!(
            "{{\"fixedPoints\": [], \"movingPoints\": [{}]}}",
            many(MAX_COLUMNS + 1, "[1, 2]")
        ),
        format!("{{\"p\": [{}]}}", many(MAX_COLUMNS + 1, "[1, 2]")),
        format!("{{\"p\": [[{}]]}}", many(MAX_COLUMNS / 2 + 2, "[1, 2]")),
        format!("[{}]", many(MAX_COLUMNS + 1, r#"{"x": 0, "y": 0}"#)),
        format!(
            "{{\"shapes\": [{}]}}",
            many(
                MAX_COLUMNS + 1,
                r#"{"label": "", "points": [[1, 2]], "shape_type": "point"}"#
            )
        ),
        format!(
            "{{\"shapes\": [{{\"label\": \"\", \"points\": [{}]}}]}}",
            many(MAX_COLUMNS / 2 + 2, "[1, 2]")
        ),
    ] {
        let start: String = file.chars().take(40).collect();
        let problem = read(&file).expect_err(&start);
        if start.starts_with("2\n") && problem.code.as_str() == "bad_landmarks" {
            panic!("{}", problem.detail);
        }
        let document = problem.to_json("", None);
        assert_eq!(
            (&document["code"], &document["limit_name"]),
            (&"too_large".into(), &"handle_columns".into()),
            "{start}: {document}"
        );
        assert_eq!(
            (&document["limit"], &document["actual"]),
            (&MAX_COLUMNS.into(), &(MAX_COLUMNS + 1).into())
        );
        assert!(
            document["line"].is_u64() && document["column"].is_u64(),
            "{document}"
        );
    }
}

/// Ten megabytes of one thing. The work is linear: each takes a fraction of a second, and none
/// overflows the stack.
#[test]
fn enormous_files_are_refused_with_a_place() {
    const SIZE: usize = 10 << 20;
    let whole = |part: &str| part.repeat(SIZE / part.len());
    for file in [
        whole("1"),
        whole("1,"),
        whole(","),
        whole("\""),
        whole("1 "),
        whole("["),
        whole("[{\"x\":"),
        format!("{{\"p\": {}", whole("[")),
        format!(
            "{{\"p\": {}{}}}",
            "[".repeat(SIZE / 2),
            "]".repeat(SIZE / 2)
        ),
        format!("{}{}", "[".repeat(SIZE / 2), "]".repeat(SIZE / 2)),
        format!(
            "{{\"landmarks\": {}{}}}",
            "[".repeat(SIZE / 2),
            "]".repeat(SIZE / 2)
        ),
        format!("{{\"p\": [[0.{}, 1]], \"q\": 5}}", whole("1")),
        format!("{{\"{}\": 1}}", whole("p")),
        format!("{{{}}}", whole("\"a\": 1, ") + "\"b\": 2"),
        format!("version: 1\n{{\n{}", whole("1 ")),
        format!("version: 1\n{{\n{}", whole("\n")),
        format!("1\n{}", whole("#\n")),
        format!("x,y\n{}", whole("\n")),
        format!("name,x,y\n{},1,2\n", whole("n")),
        format!("name,x,y\n\"{}\n", whole("n\n")),
    ] {
        let start: String = file.chars().take(20).collect();
        let began = std::time::Instant::now();
        let (line, column, detail) = match read(&file) {
            Ok(read) => panic!("{start}: {:.200}", read.to_string()),
            Err(problem) => place(&problem),
        };
        assert!(line > 0 && column > 0, "{start}: {detail}");
        assert!(
            detail.len() < 520,
            "{start}: {} bytes of detail",
            detail.len()
        );
        println!(
            "{start:?}: {:.3} s, {detail:.120}",
            began.elapsed().as_secs_f64()
        );
    }
}

/// Each good file, cut off anywhere, is read or refused with a place.
#[test]
fn truncated_files_are_read_or_refused_with_a_place() {
    let files = [
        "name,px,py,qx,qy\na,1,2,3,4\nb,5,6,7,8\n",
        "\"Pt-0\",\"true\",\"1\",\"2\",\"3\",\"4\"\n\"Pt-1\",\"true\",\"1\",\"2\",\"3\",\"4\"\n",
        "version: 1\nn_points: 2\n{\n1 2\n3 4\n}\n",
        "2\n0 0\n1 1\n1\n1\n2\n0 1\n",
        "index\n2\n0 0\n9 4\n",
        "scorer,me,me\nbodyparts,a,a\ncoords,x,y\nimg1.png,0,0\n",
        "#CRS: x\nmapX,mapY,sourceX,sourceY,enable\n1,2,3,-4,1\n",
        r#"{"p": [[1, 2], [[3, 4], [5, 6]]], "names": ["é", "b"], "units": "px"}"#,
        r#"{"faceLandmarks": [[{"x": 0.5, "y": 0.25, "name": "n"}]]}"#,
        r#"{"shapes": [{"label": "a", "points": [[1, 2], [3, 5]], "shape_type": "line"}],
          "imageData": "AAAA"}"#,
    ];
    for file in files {
        assert!(read(file).is_ok(), "{file}");
        let mut refused = 0;
        for length in 0..file.len() {
            if let Err(problem) = read(&file.as_bytes()[..length]) {
                let (line, column, detail) = place(&problem);
                assert!(
                    line > 0 && column > 0 && problem.code.as_str() == "bad_landmarks",
                    "{file}, {length} bytes: {detail}"
                );
                refused += 1;
            }
        }
        assert!(refused > file.len() / 3, "{file}: {refused}");
    }
}
