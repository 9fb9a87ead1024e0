use mlswarp::pixmap::Extent;
use serde_json::json;

use super::{LandmarkFiles, convert, place, read_two, two};

#[test]
fn two_files_are_matched_by_name_and_what_one_side_lacks_is_reported() {
    let read = read_two("name,x,y\na,1,2\nb,3,4\nc,5,6\n", "name,x,y\nd,9,9\nc,50,60\na,10,20\n").unwrap();
    assert_eq!(
        read,
        json!({"p": [[1.0, 2.0], [5.0, 6.0]], "q": [[10.0, 20.0], [50.0, 60.0]], "names": ["a", "c"], "units": "px", "format": "csv",
               "unmatched": {"p": ["b"], "q": ["d"]}})
    );
    let (line, column, detail) = place(&read_two("a,1,2\n", "\nb,1,2\n").unwrap_err());
    assert_eq!((line, column), (2, 1), "{detail}");
}

#[test]
fn two_files_without_names_are_matched_by_order() {
    let pts = "version: 1\nn_points: 2\n{\n1 1\n3 3\n}\n";
    let read = read_two(pts, "name,x,y\na,10,20\nb,30,40\n").unwrap();
    assert_eq!(
        read,
        json!({"p": [[0.5, 0.5], [2.5, 2.5]], "q": [[10.0, 20.0], [30.0, 40.0]], "names": ["a", "b"], "units": "px", "format": "pts+csv"})
    );
    let problem = read_two("1,2\n3,4\n5,6\n", "1,2\n").unwrap_err();
    let (line, column, detail) = place(&problem);
    assert_eq!((line, column), (2, 1), "{detail}");
    assert!(detail.starts_with("landmarks_p, line 2, column 1: expected 1 landmark, as the other file has; found 3"), "{detail}");
    let problem = read_two("1,2\n", "1,2\n3,4\n").unwrap_err();
    assert!(problem.detail.starts_with("landmarks_q, line 2, column 1:"), "{}", problem.detail);
}

#[test]
fn repeated_names_are_refused_only_where_they_leave_a_choice() {
    for (p, q, names) in [
        // The same names in the same order; names of classes; a name that the other side does not have.
        ("eye,1,2\neye,3,4\n", "eye,5,6\neye,7,8\n", json!(["eye", "eye"])),
        ("eye,1,2\neye,3,4\n", "id;x;y\n1;5;6\n2;7;8\n", json!(["eye", "eye"])),
        ("c,0,0\na,1,2\nb,3,4\nc,0,0\n", "b,7,8\na,5,6\n", json!(["a", "b"])),
    ] {
        let read = read_two(p, q).unwrap_or_else(|problem| panic!("{p:?}: {}", problem.detail));
        assert_eq!((&read["p"], &read["q"]), (&json!([[1.0, 2.0], [3.0, 4.0]]), &json!([[5.0, 6.0], [7.0, 8.0]])), "{p:?}");
        assert_eq!(read["names"], names);
    }
    for (p, q, found) in [
        ("eye,1,2\neye,3,4\n", "eye,5,6\n", "landmarks_p, line 2, column 1: expected each name once"),
        ("a,1,2\nb,3,4\n", "b,1,2\na,1,2\n a,5,6\n", "landmarks_q, line 3, column 1: expected each name once"),
    ] {
        let detail = read_two(p, q).unwrap_err().detail;
        assert!(detail.starts_with(found), "{detail}");
    }
}

#[test]
fn landmarks_of_another_shape_are_refused_with_both_shapes() {
    let tem = |contour: &str| format!("4\n0 0\n9 0\n9 9\n0 9\n1\n0\n{contour}\n");
    let problem = read_two(&tem("3\n0 1 2"), &tem("4\n0 1 2 3")).unwrap_err();
    assert!(problem.detail.starts_with("landmarks_p, line 9, column 1: expected 1 landmark, as the other file has; found 2"), "{problem}");
    let problem = read_two(&tem("4\n0 1 2 3"), &tem("5\n0 1 2 3 0")).unwrap_err();
    assert_eq!((problem.code.as_str(), place(&problem).0), ("bad_landmarks", 9));
    assert!(problem.detail.contains("expected a line of 4 positions, as landmark 0 of `landmarks_p` is; found a line of 5"), "{problem}");
    let problem = read_two("1,2\n", &tem("5\n0 1 2 3 0")).unwrap_err();
    assert!(problem.detail.contains("expected a point, as landmark 0 of `landmarks_p` is; found a line of 5 positions"), "{problem}");
}

#[test]
fn a_byte_after_the_contours_of_a_template_is_passed_over() {
    let both = Some(bytes::Bytes::from_static(b"2\n0 0\n10 0\n1\n0\n2\n0 1\n\xfd"));
    assert_eq!(convert(&LandmarkFiles { both, ..LandmarkFiles::default() }).unwrap()["p"], json!([[[0.5, 0.5], [10.5, 0.5]]]));
    let both = Some(bytes::Bytes::from_static(b"2\n0 0\n1\xfd 0\n"));
    let (line, column, detail) = place(&convert(&LandmarkFiles { both, ..LandmarkFiles::default() }).unwrap_err());
    assert_eq!((line, column), (3, 1), "{detail}");
}

#[test]
fn a_file_of_both_sides_is_no_side() {
    let problem = read_two("1,2\n", "1,2,3,4\n").unwrap_err();
    assert!(problem.detail.contains("landmarks_q") && problem.detail.contains("as `landmarks`"), "{}", problem.detail);
    assert_eq!(place(&problem).0, 1);
}

#[test]
fn parts_that_do_not_go_together_are_refused() {
    let file = || Some("1,2\n".into());
    for (files, word) in [
        (LandmarkFiles::default(), "missing"),
        (LandmarkFiles { q: file(), ..LandmarkFiles::default() }, "landmarks_p"),
        (LandmarkFiles { both: file(), q: file(), ..LandmarkFiles::default() }, "alone"),
        (LandmarkFiles { both: file(), p: file(), q: file(), ..LandmarkFiles::default() }, "alone"),
    ] {
        let problem = convert(&files).unwrap_err();
        assert_eq!(problem.code.as_str(), "bad_landmarks");
        assert!(problem.detail.contains(word), "{}", problem.detail);
    }
    assert_eq!(convert(&LandmarkFiles { p: file(), ..LandmarkFiles::default() }).unwrap()["p"], json!([[1.0, 2.0]]));
}

#[test]
fn normalised_sides_are_multiplied_by_the_extent_of_their_own_side() {
    let (normalized, px) = (r#"[{"x": 0.5, "y": 0.25}]"#, "10,20\n");
    let extent = |width, height| Extent::new(width, height);
    let with = |p: &str, q: &str, extent_p, extent_q| convert(&LandmarkFiles { extent_p, extent_q, ..two(p, q) });
    let read = with(normalized, normalized, extent(100, 200), extent(10, 40)).unwrap();
    assert_eq!((&read["p"], &read["q"], &read["units"]), (&json!([[50.0, 50.0]]), &json!([[5.0, 10.0]]), &json!("px")));
    // One extent is that of both sides.
    let read = with(normalized, normalized, extent(100, 200), None).unwrap();
    assert_eq!((&read["p"], &read["q"]), (&json!([[50.0, 50.0]]), &json!([[50.0, 50.0]])));
    let read = with(normalized, px, extent(100, 200), None).unwrap();
    assert_eq!((&read["p"], &read["q"]), (&json!([[50.0, 50.0]]), &json!([[10.0, 20.0]])));
    let read = with(normalized, normalized, None, None).unwrap();
    assert_eq!((&read["p"], &read["units"]), (&json!([[0.5, 0.25]]), &json!("normalized")));
    for (p, q, extent_q, missing) in
        [(normalized, px, None, "extent_p"), (px, normalized, None, "extent_q"), (normalized, normalized, extent(10, 40), "extent_p")]
    {
        let problem = with(p, q, None, extent_q).unwrap_err();
        assert_eq!(problem.code.as_str(), "bad_value");
        assert!(problem.detail.contains(missing), "{}", problem.detail);
    }
    let read = with(px, normalized, None, extent(10, 40)).unwrap();
    assert_eq!((&read["p"], &read["q"]), (&json!([[10.0, 20.0]]), &json!([[5.0, 10.0]])));
}

#[test]
fn extents_are_two_whole_numbers() {
    for text in ["640,480", " 640 , 480 ", "[640, 480]"] {
        assert_eq!(super::super::extent("extent_p", text).unwrap(), Extent::new(640, 480).unwrap(), "{text}");
    }
    for text in ["", "640", "640x480", "0,480", "-1,2", "1.5,2", "1,2,3", "[1,2", "99999999999,1", "1,250001"] {
        assert!(super::super::extent("extent_p", text).unwrap_err().detail.contains("`extent_p`"), "{text}");
    }
}
