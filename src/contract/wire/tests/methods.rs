//! Parameters of methods, and the comparison of methods.

use std::collections::BTreeSet;

use mlswarp::deform::METHODS;

use super::*;

#[test]
fn parameters_stay_with_their_method() {
    let session = |warp: &str| WarpObject::parse(warp.as_bytes()).unwrap();
    let local = session(r#"{"alpha": 1.5, "point_mass": 3}"#);
    let spline = session(r#"{"method": "tps", "smoothing": 0.1}"#);
    let merged = |patch: &str, base: &WarpObject| {
        let RestSpec {
            method,
            alpha,
            point_mass,
            smoothing,
            ..
        } = WarpPatch::parse(patch.as_bytes())
            .unwrap()
            .merge_onto(base.clone())
            .rest;
        (method, alpha, point_mass, smoothing)
    };
    assert_eq!(
        merged("{}", &local),
        (Method::Rigid, Some(1.5), Some(3.0), None)
    );
    assert_eq!(
        merged(r#"{"method": "affine"}"#, &local),
        (Method::Affine, Some(1.5), Some(3.0), None)
    );
    assert_eq!(
        merged(r#"{"method": "tps"}"#, &local),
        (Method::ThinPlateSpline, None, None, None)
    );
    assert_eq!(
        merged(r#"{"method": "tps", "alpha": 2}"#, &local),
        (Method::ThinPlateSpline, Some(2.0), None, None)
    );
    assert_eq!(
        merged(r#"{"p": []}"#, &spline),
        (Method::ThinPlateSpline, None, None, Some(0.1))
    );
    assert_eq!(
        merged(r#"{"method": "tps"}"#, &spline),
        (Method::ThinPlateSpline, None, None, Some(0.1))
    );
    assert_eq!(
        merged(r#"{"method": "rigid"}"#, &spline),
        (Method::Rigid, None, None, None)
    );
}

/// They do not belong together, which the engine says; reading them has room for all.
#[test]
fn a_request_can_have_the_parameters_of_all_methods() {
    let parameters = METHODS.iter().flat_map(|info| info.parameters);
    let paths: BTreeSet<&str> = parameters.map(|parameter| parameter.path).collect();
    let mut request = json!({});
    for path in &paths {
        match path.split_once('/') {
            Some((object, name)) => request[object][name] = json!(1),
            None => request[*path] = json!(1),
        }
    }
    let given = WarpObject::parse(request.to_string().as_bytes()).unwrap();
    let given = given.rest.parameters();
    assert!(given.iter().map(|(path, _)| path).eq(paths));
}

#[test]
fn auto_is_a_method_to_be_chosen_and_drops_parameters() {
    let local = WarpObject::parse(br#"{"p": [[1, 2]], "method": "affine", "alpha": 1.5}"#).unwrap();
    let auto = WarpPatch::parse(br#"{"method": "auto"}"#)
        .unwrap()
        .merge_onto(local.clone());
    assert!(auto.is_auto && auto.rest.alpha.is_none());
    assert!(
        !WarpPatch::parse(br#"{"p": [[3, 4]]}"#)
            .unwrap()
            .merge_onto(auto)
            .is_auto,
        "a choice is made once"
    );
    let text = |json: &[u8]| method_text(&WarpObject::parse(json).unwrap().rest);
    assert_eq!(
        text(br#"{"method": "affine", "alpha": 1.5}"#),
        "affine;alpha=1.5"
    );
    assert_eq!(
        text(br#"{"method": "tps", "smoothing": 0}"#),
        "tps;smoothing=0"
    );
    assert_eq!(text(br#"{"method": "global_affine"}"#), "global_affine");
}

#[test]
fn fit_reads_its_fields() {
    let fit = FitObject::parse(
        br#"{"p": [[1, 2]], "q": [[3, 4]], "extent": [9, 8], "candidates": [{"method": "tps",
          "smoothing": 0.5}]}"#,
    );
    let fit = fit.unwrap();
    assert_eq!(
        fit.candidates,
        [Candidate {
            method: Method::ThinPlateSpline,
            alpha: None,
            smoothing: Some(0.5)
        }]
    );
    assert_eq!(
        (fit.pose.q.unwrap(), fit.rest.unwrap().1),
        (vec![point(3.0, 4.0)], Extent::new(9, 8).unwrap())
    );
    assert_eq!(
        FitObject::parse_posed(br#"{"q": []}"#)
            .unwrap()
            .candidates
            .len(),
        17
    );
    use Code::BadValue as B;
    let many = format!(
        "{{\"q\": [], \"candidates\": [{}]}}",
        [r#"{"method": "tps"}"#; 65].join(", ")
    );
    let table: &[Expected] = &[
        (
            "{\"q\": [], \"candidates\": []}",
            B,
            Some("/candidates"),
            None,
        ),
        (
            "{\"q\": [], \"candidates\": [{\"alpha\": 1}]}",
            B,
            Some("/candidates/0/method"),
            None,
        ),
        (
            "{\"q\": [], \"candidates\": [{\"method\": \"auto\"}]}",
            B,
            Some("/candidates/0/method"),
            None,
        ),
        (
            "{\"q\": [], \"candidates\": [{\"method\": \"tps\", \"smoothing\": \"1\"}]}",
            B,
            Some("/candidates/0/smoothing"),
            None,
        ),
        (
            "{\"q\": [], \"candidates\": [{\"method\": \"tps\", \"grid\": 1}]}",
            Code::UnknownField,
            Some("/candidates/0/grid"),
            None,
        ),
        (
            "{\"p\": [], \"q\": []}",
            Code::UnknownField,
            Some("/p"),
            None,
        ),
    ];
    check(FitObject::parse_posed, table);
    assert_eq!(
        FitObject::parse_posed(many.as_bytes())
            .unwrap_err()
            .pointer
            .as_deref(),
        Some("/candidates")
    );
    check(
        FitObject::parse,
        &[("{\"p\": [], \"q\": []}", B, Some("/extent"), None)],
    );
}
