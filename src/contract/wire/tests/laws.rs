//! Laws: no text panics, and what is written reads back.

use super::*;

/// JSON that is near enough to the contract to reach every branch.
fn near_miss() -> impl Strategy<Value = Value> {
    let scalar = prop_oneof![
        Just(Value::Null),
        any::<bool>().prop_map(Value::from),
        any::<f64>().prop_map(Value::from),
        (-3_i64..9).prop_map(Value::from),
        prop::sample::select(vec![
            "rigid",
            "tps",
            "auto",
            "png",
            "edge",
            "#00000000",
            "fast",
            "",
            "report",
            "same",
            "euclidean"
        ])
        .prop_map(Value::from),
        ".{0,4}".prop_map(Value::from),
    ];
    scalar.prop_recursive(5, 48, 4, |inner| {
        let name = prop::sample::select(
            fields::WARP_WITH_POINTS
                .iter()
                .chain(&["seq", "cell", "columns", "rows", "width", "format", "x"])
                .copied()
                .collect::<Vec<_>>(),
        );
        prop_oneof![
            prop::collection::vec(inner.clone(), 0..4).prop_map(Value::from),
            prop::collection::vec((name, inner), 0..5).prop_map(|f| Value::Object(
                f.into_iter().map(|(k, v)| (k.to_owned(), v)).collect()
            )),
        ]
    })
}

fn every_parser_answers(text: &[u8]) -> Result<(), TestCaseError> {
    let problems = [
        WarpObject::parse(text).err(),
        DragObject::parse(text, usize::MAX).err(),
        points(text).err(),
        ReportObject::parse(text).err(),
        DragObject::parse_for_report(text, usize::MAX).err(),
        posed_points(text).err(),
        MapObject::parse(text).err(),
        MapObject::parse_posed(text).err(),
    ];
    let json = serde_json::from_slice::<&serde_json::value::RawValue>(text).is_ok();
    for problem in problems.into_iter().flatten() {
        prop_assert!(
            problem.status() == 400 || (json && problem.status() == 422),
            "{problem}"
        );
        prop_assert!(!problem.detail.is_empty());
        prop_assert!(
            problem
                .pointer
                .as_deref()
                .is_none_or(|p| p.starts_with('/')),
            "{problem}"
        );
    }
    Ok(())
}

/// The object in the form of its values.
pub(super) fn written(warp: &WarpObject) -> Value {
    let WarpObject {
        rest,
        q,
        folds,
        output,
        ..
    } = warp;
    let RestSpec {
        p,
        weights,
        depth,
        method,
        alpha,
        point_mass,
        smoothing,
        own,
        metric,
        mask_threshold,
        coincident,
        units,
        grid,
        align,
        ..
    } = rest;
    let mut object = json!({
        "p": AsJson(p.as_slice()), "q": q.as_deref().map(AsJson), "weights": weights,
            "depth": depth,
            "method": AsJson(*method), "alpha": alpha,
        "point_mass": point_mass, "smoothing": smoothing, "coincident": AsJson(*coincident),
        "units": AsJson(*units), "align": AsJson(*align), "grid": AsJson(*grid),
            "folds": AsJson(*folds), "output": AsJson(output)
    });
    let fields = object.as_object_mut().unwrap();
    let own = serde_json::to_value(AsJson(*own)).unwrap();
    fields.extend(own.as_object().unwrap().clone());
    // The default need not be sent, so it is not described.
    if *metric != Metric::default() {
        fields.insert("metric".to_owned(), json!(AsJson(*metric)));
    }
    if let Some(threshold) = mask_threshold {
        fields.insert("mask".to_owned(), json!({"threshold": threshold}));
    }
    fields.retain(|_, value| !value.is_null());
    object
}

/// Every object with all fields that it does not have, as `null`.
fn with_nulls(mut object: Value, names: &[&str]) -> Value {
    for name in names {
        object
            .as_object_mut()
            .unwrap()
            .entry(*name)
            .or_insert(Value::Null);
    }
    object
}

proptest! {
    #[test]
    fn any_bytes_give_a_value_or_a_400(bytes in prop::collection::vec(any::<u8>(), 0..64)) {
        every_parser_answers(&bytes)?;
    }

    #[test]
    fn any_braced_text_gives_a_value_or_a_problem(
        text in "\\{\"[pq]\": [\\[\\]{}\",:0-9eE+.\\-a-z\\\\ ]{0,40}\\}") {
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
