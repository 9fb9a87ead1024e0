use mlswarp::pixmap::Extent;
use serde_json::json;

use super::{LandmarkFiles, convert, place, read_two, two};
use crate::wire::landmarks::{Choice, Matching};

#[test]
fn two_files_are_matched_by_name_and_what_one_side_lacks_is_reported() {
    let read = read_two(
        "name,x,y\na,1,2\nb,3,4\nc,5,6\n",
        "name,x,y\nd,9,9\nc,50,60\na,10,20\n",
    )
    .unwrap();
    assert_eq!(
        read,
        json!({"p": [[1.0, 2.0], [5.0, 6.0]], "q": [[10.0, 20.0], [50.0, 60.0]],
            "names": ["a", "c"], "units": "px", "format": "csv",
               "unmatched": {"p": ["b"], "q": ["d"]}})
    );
    let (line, column, detail) = place(&read_two("a,1,2\n", "\nb,1,2\n").unwrap_err());
    assert_eq!((line, column), (2, 1), "{detail}");
    assert!(
        detail.ends_with(
            "found none of its 1: to match them by order send match=order (`--match order`)"
        ),
        "{detail}"
    );
}

#[test]
fn two_files_without_names_are_matched_by_order() {
    let pts = "version: 1\nn_points: 2\n{\n1 1\n3 3\n}\n";
    let read = read_two(pts, "name,x,y\na,10,20\nb,30,40\n").unwrap();
    assert_eq!(
        read,
        json!({"p": [[0.5, 0.5], [2.5, 2.5]], "q": [[10.0, 20.0], [30.0, 40.0]],
            "names": ["a", "b"], "units": "px", "format": "pts+csv"})
    );
    let problem = read_two("1,2\n3,4\n5,6\n", "1,2\n").unwrap_err();
    let (line, column, detail) = place(&problem);
    assert_eq!((line, column), (2, 1), "{detail}");
    assert!(
        detail.starts_with(
            "landmarks_p, line 2, column 1: expected 1 landmark, as the other file has; found 3"
        ),
        "{detail}"
    );
    let problem = read_two("1,2\n", "1,2\n3,4\n").unwrap_err();
    assert!(
        problem.detail.starts_with("landmarks_q, line 2, column 1:"),
        "{}",
        problem.detail
    );
}

#[test]
fn repeated_names_are_refused_only_where_they_leave_a_choice() {
    for (p, q, names) in [
        // The same names in the same order; names of classes; a name that the other side does not
        // have.
        (
            "eye,1,2\neye,3,4\n",
            "eye,5,6\neye,7,8\n",
            json!(["eye", "eye"]),
        ),
        (
            "eye,1,2\neye,3,4\n",
            "id;x;y\n1;5;6\n2;7;8\n",
            json!(["eye", "eye"]),
        ),
        (
            "c,0,0\na,1,2\nb,3,4\nc,0,0\n",
            "b,7,8\na,5,6\n",
            json!(["a", "b"]),
        ),
    ] {
        let read = read_two(p, q).unwrap_or_else(|problem| panic!("{p:?}: {}", problem.detail));
        assert_eq!(
            (&read["p"], &read["q"]),
            (
                &json!([[1.0, 2.0], [3.0, 4.0]]),
                &json!([[5.0, 6.0], [7.0, 8.0]])
            ),
            "{p:?}"
        );
        assert_eq!(read["names"], names);
    }
    for (p, q, found) in [
        (
            "eye,1,2\neye,3,4\n",
            "eye,5,6\n",
            "landmarks_p, line 2, column 1: expected each name once",
        ),
        (
            "a,1,2\nb,3,4\n",
            "b,1,2\na,1,2\n a,5,6\n",
            "landmarks_q, line 3, column 1: expected each name once",
        ),
    ] {
        let detail = read_two(p, q).unwrap_err().detail;
        assert!(detail.starts_with(found), "{detail}");
    }
}

#[test]
fn landmarks_of_another_shape_are_refused_with_both_shapes() {
    let tem = |contour: &str| format!("4\n0 0\n9 0\n9 9\n0 9\n1\n0\n{contour}\n");
    let problem = read_two(&tem("3\n0 1 2"), &tem("4\n0 1 2 3")).unwrap_err();
    assert!(
        problem.detail.starts_with(
            "landmarks_p, line 9, column 1: expected 1 landmark, as the other file has; found 2"
        ),
        "{problem}"
    );
    let problem = read_two(&tem("4\n0 1 2 3"), &tem("5\n0 1 2 3 0")).unwrap_err();
    assert_eq!(
        (problem.code.as_str(), place(&problem).0),
        ("bad_landmarks", 9)
    );
    assert!(
        problem.detail.contains(
            "expected a line of 4 positions, as landmark 0 of `landmarks_p` is; found a line of 5"
        ),
        "{problem}"
    );
    let problem = read_two("1,2\n", &tem("5\n0 1 2 3 0")).unwrap_err();
    assert!(
        problem.detail.contains(
            "expected a point, as landmark 0 of `landmarks_p` is; found a line of 5 positions"
        ),
        "{problem}"
    );
}

#[test]
fn a_byte_after_the_contours_of_a_template_is_passed_over() {
    let both = Some(bytes::Bytes::from_static(
        b"2\n0 0\n10 0\n1\n0\n2\n0 1\n\xfd",
    ));
    assert_eq!(
        convert(&LandmarkFiles {
            both,
            ..LandmarkFiles::default()
        })
        .unwrap()["p"],
        json!([[[0.5, 0.5], [10.5, 0.5]]])
    );
    let both = Some(bytes::Bytes::from_static(b"2\n0 0\n1\xfd 0\n"));
    let (line, column, detail) = place(
        &convert(&LandmarkFiles {
            both,
            ..LandmarkFiles::default()
        })
        .unwrap_err(),
    );
    assert_eq!((line, column), (3, 1), "{detail}");
}

#[test]
fn a_file_of_both_sides_is_no_side() {
    let problem = read_two("1,2\n", "1,2,3,4\n").unwrap_err();
    assert!(
        problem.detail.contains("landmarks_q") && problem.detail.contains("as `landmarks`"),
        "{}",
        problem.detail
    );
    assert_eq!(place(&problem).0, 1);
}

#[test]
fn parts_that_do_not_go_together_are_refused() {
    let file = || Some("1,2\n".into());
    for (files, word) in [
        (LandmarkFiles::default(), "missing"),
        (
            LandmarkFiles {
                q: file(),
                ..LandmarkFiles::default()
            },
            "landmarks_p",
        ),
        (
            LandmarkFiles {
                both: file(),
                q: file(),
                ..LandmarkFiles::default()
            },
            "alone",
        ),
        (
            LandmarkFiles {
                both: file(),
                p: file(),
                q: file(),
                ..LandmarkFiles::default()
            },
            "alone",
        ),
    ] {
        let problem = convert(&files).unwrap_err();
        assert_eq!(problem.code.as_str(), "bad_landmarks");
        assert!(problem.detail.contains(word), "{}", problem.detail);
    }
    assert_eq!(
        convert(&LandmarkFiles {
            p: file(),
            ..LandmarkFiles::default()
        })
        .unwrap()["p"],
        json!([[1.0, 2.0]])
    );
}

#[test]
fn normalised_sides_are_multiplied_by_the_extent_of_their_own_side() {
    let (normalized, px) = (r#"[{"x": 0.5, "y": 0.25}]"#, "10,20\n");
    let extent = |width, height| Extent::new(width, height);
    let with = |p: &str, q: &str, extent_p, extent_q| {
        convert(&LandmarkFiles {
            extent_p,
            extent_q,
            ..two(p, q)
        })
    };
    let read = with(normalized, normalized, extent(100, 200), extent(10, 40)).unwrap();
    assert_eq!(
        (&read["p"], &read["q"], &read["units"]),
        (&json!([[50.0, 50.0]]), &json!([[5.0, 10.0]]), &json!("px"))
    );
    // One extent is that of both sides.
    let read = with(normalized, normalized, extent(100, 200), None).unwrap();
    assert_eq!(
        (&read["p"], &read["q"]),
        (&json!([[50.0, 50.0]]), &json!([[50.0, 50.0]]))
    );
    let read = with(normalized, px, extent(100, 200), None).unwrap();
    assert_eq!(
        (&read["p"], &read["q"]),
        (&json!([[50.0, 50.0]]), &json!([[10.0, 20.0]]))
    );
    let read = with(normalized, normalized, None, None).unwrap();
    assert_eq!(
        (&read["p"], &read["units"]),
        (&json!([[0.5, 0.25]]), &json!("normalized"))
    );
    for (p, q, extent_q, missing) in [
        (normalized, px, None, "extent_p"),
        (px, normalized, None, "extent_q"),
        (normalized, normalized, extent(10, 40), "extent_p"),
    ] {
        let problem = with(p, q, None, extent_q).unwrap_err();
        assert_eq!(problem.code.as_str(), "bad_value");
        assert!(problem.detail.contains(missing), "{}", problem.detail);
    }
    let read = with(px, normalized, None, extent(10, 40)).unwrap();
    assert_eq!(
        (&read["p"], &read["q"]),
        (&json!([[10.0, 20.0]]), &json!([[5.0, 10.0]]))
    );
}

#[test]
fn extents_are_two_whole_numbers() {
    for text in ["640,480", " 640 , 480 ", "[640, 480]"] {
        assert_eq!(
            super::super::extent("extent_p", text).unwrap(),
            Extent::new(640, 480).unwrap(),
            "{text}"
        );
    }
    for text in [
        "",
        "640",
        "640x480",
        "0,480",
        "-1,2",
        "1.5,2",
        "1,2,3",
        "[1,2",
        "99999999999,1",
        "1,250001",
    ] {
        assert!(
            super::super::extent("extent_p", text)
                .unwrap_err()
                .detail
                .contains("`extent_p`"),
            "{text}"
        );
    }
}

fn matched(
    p: &str,
    q: &str,
    matching: Matching,
) -> Result<serde_json::Value, crate::problem::Problem> {
    let choice = Choice {
        matching: Some(matching),
        item: None,
    };
    convert(&LandmarkFiles {
        choice,
        ..two(p, q)
    })
}

#[test]
fn names_of_another_case_are_one_name_unless_case_tells_them_apart() {
    let read = read_two(
        "Nasion,1,2\nLpa,3,4\nRPA,5,6\n",
        "rpa,50,60\nnasion,10,20\nLPA,30,40\n",
    )
    .unwrap();
    assert_eq!(read["q"], json!([[10.0, 20.0], [30.0, 40.0], [50.0, 60.0]]));
    assert_eq!(
        (&read["names"], &read["unmatched"]),
        (&json!(["Nasion", "Lpa", "RPA"]), &json!(null))
    );
    // `a` and `A` are two landmarks of the first file.
    let read = read_two("a,1,2\nA,3,4\nb,5,6\n", "A,30,40\na,10,20\nB,50,60\n").unwrap();
    assert_eq!(
        (&read["q"], &read["unmatched"]),
        (
            &json!([[10.0, 20.0], [30.0, 40.0]]),
            &json!({"p": ["b"], "q": ["B"]})
        )
    );
}

#[test]
fn names_that_are_positions_are_no_names() {
    let table = |places: &[(u32, u32)], label: &dyn Fn(u32, u32) -> String| {
        let rows = places
            .iter()
            .enumerate()
            .map(|(k, &(x, y))| format!("{k},{},{x},{y}\n", label(x, y)));
        format!(" ,Label,X,Y\n{}", rows.collect::<String>())
    };
    let (p, q) = (
        [(30, 45), (200, 50), (60, 12_345)],
        [(30, 45), (209, 55), (61, 12_345)],
    );
    let plain = |x: u32, y: u32| format!("{y:04}-{x:04}");
    for (of_p, of_q) in [
        (
            &plain as &dyn Fn(u32, u32) -> String,
            &plain as &dyn Fn(u32, u32) -> String,
        ),
        (&|x, y| format!("HE.tif:{y:04}-{x:04}"), &|x, y| {
            format!("IHC 2.tif:{y:04}-{x:04}")
        }),
        (&|x, y| format!("stack:0007-{y:04}-{x:04}:7"), &|x, y| {
            format!("0001-{y:04}-{x:04}")
        }),
        (&plain, &|x, y| format!("point {x} {y}")),
    ] {
        let read = read_two(&table(&p, of_p), &table(&q, of_q)).unwrap();
        assert_eq!(
            (&read["q"], &read["unmatched"]),
            (
                &json!([[30.0, 45.0], [209.0, 55.0], [61.0, 12_345.0]]),
                &json!(null)
            )
        );
    }
    // Numbers of years and specimens are names: they are not where the landmarks are.
    let year = |x: u32, _: u32| format!("2020-{x:04}");
    let reversed: Vec<_> = p.iter().rev().copied().collect();
    let read = read_two(&table(&p, &year), &table(&reversed, &year)).unwrap();
    assert_eq!(read["p"], read["q"]);
}

#[test]
fn a_minority_of_equal_names_is_no_match_unless_it_is_wanted() {
    let (p, q) = (
        "a,1,1\nb,2,2\nc,3,3\nd,4,4\n",
        "a,10,10\nw,20,20\nx,30,30\ny,40,40\n",
    );
    let (line, _, detail) = place(&read_two(p, q).unwrap_err());
    assert_eq!(line, 2);
    assert!(
        detail.contains("1 of 4 names match: to match them by order send match=order"),
        "{detail}"
    );
    assert!(
        detail.ends_with("or match=name to leave out all others"),
        "{detail}"
    );
    let by_order = matched(p, q, Matching::Order).unwrap();
    assert_eq!(
        (&by_order["q"], &by_order["unmatched"]),
        (
            &json!([[10.0, 10.0], [20.0, 20.0], [30.0, 30.0], [40.0, 40.0]]),
            &json!(null)
        )
    );
    let by_name = matched(p, q, Matching::Name).unwrap();
    assert_eq!(
        (&by_name["p"], &by_name["unmatched"]["q"]),
        (&json!([[1.0, 1.0]]), &json!(["w", "x", "y"]))
    );
    // All names of the smaller file match: they explain it.
    assert_eq!(
        read_two(p, "d,4,4\na,1,1\n").unwrap()["names"],
        json!(["a", "d"])
    );
    // Half of them.
    assert_eq!(
        read_two("a,1,1\nb,2,2\n", "b,2,2\nc,3,3\n").unwrap()["names"],
        json!(["b"])
    );
    for (p, q, matching, word) in [
        (
            "1,2\n",
            "a,1,2\n",
            Matching::Name,
            "landmarks_p, line 1, column 1: expected names",
        ),
        (
            "a,1,2\n",
            "1,2\n",
            Matching::Name,
            "landmarks_q, line 1, column 1: expected names",
        ),
        (
            "a,1,2\na,3,4\n",
            "a,1,2\na,3,4\n",
            Matching::Name,
            "expected each name once",
        ),
        ("a,1,2\n", "b,1,2\n", Matching::Name, "found none"),
        (
            "a,1,2\nb,1,2\n",
            "a,1,2\n",
            Matching::Order,
            "expected 1 landmark",
        ),
    ] {
        let detail = matched(p, q, matching).unwrap_err().detail;
        assert!(detail.contains(word), "{detail}");
    }
    let choice = Choice {
        matching: Some(Matching::Order),
        item: None,
    };
    let alone = LandmarkFiles {
        choice,
        ..super::both("1,2,3,4\n")
    };
    assert!(
        convert(&alone)
            .unwrap_err()
            .detail
            .contains("`match` belongs to two files")
    );
}

#[test]
fn pixels_of_a_copy_of_another_size_are_scaled_to_the_image() {
    let extent = |width, height| Extent::new(width, height);
    let place_in = |files: LandmarkFiles| {
        let mut object = crate::wire::WarpObject::default();
        files
            .read(100, &|| false)
            .unwrap()
            .place_in(&mut object, Extent::new(800, 300).unwrap())
            .unwrap();
        json!([
            crate::wire::AsJson(object.rest.p.as_slice()),
            crate::wire::AsJson(object.q.unwrap().as_slice())
        ])
    };
    // The copy is a quarter as wide and half as high.
    let both = LandmarkFiles {
        extent_p: extent(200, 150),
        ..super::both("10,20,11,21\n")
    };
    assert_eq!(
        place_in(both.clone()),
        json!([[[40.0, 40.0]], [[44.0, 42.0]]])
    );
    // Each side has its own extent, by default that of `p`.
    let other = LandmarkFiles {
        extent_q: extent(400, 300),
        ..both.clone()
    };
    assert_eq!(place_in(other), json!([[[40.0, 40.0]], [[22.0, 21.0]]]));
    let pts = "version: 1\n{\n10.5 20.5\n}\n";
    let apart = LandmarkFiles {
        extent_q: extent(200, 150),
        ..two("10,20\n", pts)
    };
    assert_eq!(
        place_in(apart.clone()),
        json!([[[10.0, 20.0]], [[40.0, 40.0]]])
    );
    // The size of the image itself changes no bit.
    let same = LandmarkFiles {
        extent_p: extent(800, 300),
        ..super::both("0.1,0.7,1e-9,299.9999\n")
    };
    assert_eq!(place_in(same), json!([[[0.1, 0.7]], [[1e-9, 299.9999]]]));
    // Without an image they become shares, which say the same of an image of any size; the response
    // says what was done.
    let read = convert(&both).unwrap();
    assert_eq!(
        (&read["p"], &read["units"]),
        (&json!([[0.05, 20.0 / 150.0]]), &json!("normalized"))
    );
    assert_eq!(
        read["format"],
        "csv (p from 200 x 150 px to shares of the image; q from 200 x 150 px to shares of the \
            image)"
    );
    assert!(crate::wire::landmarks::is_format(
        read["format"].as_str().unwrap()
    ));
    // Where one side cannot be brought to the units of the other, the missing size is named.
    let problem = convert(&apart).unwrap_err();
    assert!(problem.detail.contains("`extent_p`"), "{}", problem.detail);
    let normalized = r#"[{"x": 0.5, "y": 0.25}]"#;
    let read = convert(&LandmarkFiles {
        extent_p: extent(20, 40),
        ..two("10,20\n", normalized)
    })
    .unwrap();
    assert_eq!(
        (&read["p"], &read["q"], &read["units"]),
        (
            &json!([[0.5, 0.5]]),
            &json!([[0.5, 0.25]]),
            &json!("normalized")
        )
    );
    let alone = LandmarkFiles {
        extent_q: extent(20, 40),
        ..super::both("10,20\n")
    };
    assert!(
        convert(&alone)
            .unwrap_err()
            .detail
            .contains("`extent_q` belongs to posed positions")
    );
}

#[test]
fn a_landmark_without_a_position_stays_in_its_place() {
    let read =
        super::read("name,px,py,qx,qy\na,1,2,3,4\nb,,,5,6\nc,7,8,NaN,9\nd,1,,2,3\n").unwrap();
    let (p, q) = (
        json!([[1.0, 2.0], null, [7.0, 8.0], null]),
        json!([[3.0, 4.0], [5.0, 6.0], null, [2.0, 3.0]]),
    );
    assert_eq!(
        (&read["p"], &read["q"], &read["names"]),
        (&p, &q, &json!(["a", "b", "c", "d"]))
    );
    // What is written is read again.
    let again = super::read(read.to_string()).unwrap();
    assert_eq!((&again["p"], &again["q"]), (&p, &q));
    let read = read_two("a,1,2\nb,NA,3\n", "b,30,40\na,,\n").unwrap();
    assert_eq!(
        (&read["p"], &read["q"]),
        (&json!([[1.0, 2.0], null]), &json!([null, [30.0, 40.0]]))
    );
    // None of those that match has a position: what would be written could not be read.
    let problem = read_two("a,1,2\nb,,\n", "b,3,4\n").unwrap_err();
    assert!(
        problem
            .detail
            .starts_with("landmarks_p, line 2, column 1: expected a position"),
        "{}",
        problem.detail
    );
    let list = r#"{"faceLandmarks": [[{"x": 0.5, "y": 0.5}, null]]}"#;
    assert_eq!(super::read(list).unwrap()["p"], json!([[0.5, 0.5], null]));
}
