//! The OpenAPI document against itself (every `$ref` resolves, every example is valid) and against
//! the parsers: what they accept and refuse, the words, the codes.

use jsonschema::{Draft, Validator};
use mlswarp::format::{Compression, Format};
use mlswarp::render::Filter;
use mlswarp::warp::{Align, Easing, Holes, MapDirection, Method, Units};
use proptest::prelude::*;
use serde_json::{Value, json};

use super::{warp_object, written};
use crate::wire::enum_name::{EnumName, RequestedMethod};
use crate::wire::*;

fn document() -> Value {
    serde_json::from_str(include_str!("../../../../api/openapi.json"))
        .expect("the document is JSON")
}

/// A validator for a schema that may refer to the document's components.
fn validator(document: &Value, schema: &Value) -> Validator {
    let mut schema = schema.clone();
    schema["components"] = document["components"].clone();
    jsonschema::options()
        .with_draft(Draft::Draft202012)
        .should_validate_formats(true)
        .build(&schema)
        .expect("the schema is a schema")
}

fn component(document: &Value, name: &str) -> Validator {
    assert!(
        document["components"]["schemas"][name].is_object(),
        "{name}"
    );
    validator(
        document,
        &json!({"$ref": format!("#/components/schemas/{name}")}),
    )
}

fn walk<'a>(
    value: &'a Value,
    path: &str,
    visit: &mut impl FnMut(&str, &'a serde_json::Map<String, Value>),
) {
    match value {
        Value::Object(object) => {
            visit(path, object);
            object
                .iter()
                .for_each(|(name, value)| walk(value, &format!("{path}/{name}"), visit));
        }
        Value::Array(items) => items
            .iter()
            .enumerate()
            .for_each(|(i, value)| walk(value, &format!("{path}/{i}"), visit)),
        _ => {}
    }
}

fn resolve<'a>(document: &'a Value, value: &'a Value) -> &'a Value {
    match value["$ref"].as_str() {
        Some(target) => document
            .pointer(target.trim_start_matches('#'))
            .expect(target),
        None => value,
    }
}

fn operations(document: &Value) -> Vec<(String, &Value)> {
    let mut operations = Vec::new();
    for (path, item) in document["paths"].as_object().expect("paths") {
        for (method, operation) in item.as_object().expect("a path item") {
            if method != "parameters" {
                operations.push((format!("{} {path}", method.to_uppercase()), operation));
            }
        }
    }
    operations
}

#[test]
fn every_reference_resolves_and_every_component_is_used() {
    let document = document();
    let mut used = std::collections::HashSet::new();
    walk(&document, "", &mut |path, object| {
        if let Some(target) = object.get("$ref").and_then(Value::as_str) {
            assert!(
                target.starts_with("#/") && document.pointer(&target[1..]).is_some(),
                "{path}: {target}"
            );
            used.insert(target.to_owned());
        }
    });
    // Security schemes are named, not referred to.
    for (kind, entries) in document["components"]
        .as_object()
        .expect("components")
        .iter()
        .filter(|(kind, _)| *kind != "securitySchemes")
    {
        for name in entries.as_object().expect("entries").keys() {
            assert!(
                used.contains(&format!("#/components/{kind}/{name}")),
                "{kind}/{name} is not used"
            );
        }
    }
}

/// Generators make a function of each, in a module of its tag.
#[test]
fn every_operation_has_a_name_and_one_tag() {
    let document = document();
    let listed: Vec<&Value> = document["tags"]
        .as_array()
        .expect("tags")
        .iter()
        .map(|tag| &tag["name"])
        .collect();
    let mut names = std::collections::HashSet::new();
    for (route, operation) in operations(&document) {
        let tags = operation["tags"].as_array().expect(&route);
        assert!(
            tags.len() == 1 && listed.contains(&&tags[0]),
            "{route}: {tags:?}"
        );
        assert!(
            names.insert(operation["operationId"].as_str().expect(&route)),
            "{route}: its name is not its own"
        );
        // Generators take the first one: JSON, beside which a form may have its handles in landmark
        // files.
        let types: Vec<&String> = operation["requestBody"]["content"]
            .as_object()
            .into_iter()
            .flat_map(serde_json::Map::keys)
            .collect();
        assert!(
            types.len() < 2 || types == ["application/json", "multipart/form-data"],
            "{route}: {types:?}"
        );
    }
}

#[test]
fn every_example_is_valid() {
    let document = document();
    let mut count = 0;
    let mut check = |path: &str, schema: &Value, example: &Value| {
        let errors: Vec<String> = validator(&document, schema)
            .iter_errors(example)
            .map(|e| e.to_string())
            .collect();
        assert!(errors.is_empty(), "{path}: {errors:?}: {example}");
        count += 1;
    };
    walk(&document, "", &mut |path, object| {
        if let Some(schema) = object.get("schema") {
            for (name, example) in object
                .get("examples")
                .and_then(Value::as_object)
                .into_iter()
                .flatten()
            {
                check(
                    &format!("{path}/{name}"),
                    schema,
                    &resolve(&document, example)["value"],
                );
            }
            if let Some(example) = object.get("example") {
                check(path, schema, example);
            }
        }
    });
    for (name, schema) in document["components"]["schemas"]
        .as_object()
        .expect("schemas")
    {
        schema["examples"]
            .as_array()
            .into_iter()
            .flatten()
            .chain(schema.get("default"))
            .for_each(|e| check(name, schema, e));
    }
    assert!(count > 60, "{count}");
}

#[test]
fn every_object_of_a_schema_is_closed_and_names_only_its_own() {
    let document = document();
    walk(
        &document["components"]["schemas"],
        "",
        &mut |path, object| {
            // The part below `if` is a condition, not a schema of its own.
            if object.get("properties").is_some_and(Value::is_object)
                && !path.ends_with("/if")
                && !path.ends_with("/properties")
            {
                // GeoJSON has members of its own, and each warning its figures.
                let open = [
                    "/Geometry",
                    "/Feature",
                    "/GeoJson",
                    "/ReportAnswer/properties/warnings/items",
                ];
                let is_open = open.iter().any(|name| path.starts_with(name));
                assert_eq!(
                    object.get("additionalProperties"),
                    Some(&Value::Bool(is_open)),
                    "{path}"
                );
                for name in object
                    .get("required")
                    .and_then(Value::as_array)
                    .into_iter()
                    .flatten()
                {
                    assert!(
                        object["properties"]
                            .get(name.as_str().expect("a name"))
                            .is_some(),
                        "{path}: {name}"
                    );
                }
            }
        },
    );
}

#[test]
fn statuses_hold_problems_of_that_status_and_every_operation_may_fail() {
    let document = document();
    let mut seen = std::collections::HashSet::new();
    for (route, operation) in operations(&document) {
        let responses = operation["responses"].as_object().expect("responses");
        let is_success = |status: &str| status.starts_with('2') || ["101", "304"].contains(&status);
        assert!(
            responses.keys().any(|s| is_success(s)) && responses.contains_key("500"),
            "{route}"
        );
        for (status, response) in responses.iter().filter(|(s, _)| !is_success(s)) {
            let response = resolve(&document, response);
            let examples = &response["content"][Problem::MEDIA_TYPE]["examples"];
            for (name, example) in examples.as_object().expect("examples") {
                let code = Code::ALL.iter().find(|c| c.as_str() == name).expect(name);
                assert_eq!(&code.status().to_string(), status, "{route}: {name}");
                assert_eq!(example["value"]["code"], *name, "{route}");
                assert_eq!(example["value"]["status"], code.status(), "{route}: {name}");
                assert_eq!(example["value"]["title"], code.title(), "{route}: {name}");
                seen.insert(*code);
            }
            assert_eq!(
                response["headers"]["Retry-After"].is_object(),
                matches!(status.as_str(), "429" | "503"),
                "{route} {status}"
            );
        }
    }
    // These belong to no operation: the method or the host is not one.
    let nowhere = [Code::MethodNotAllowed, Code::Misdirected];
    for code in Code::ALL {
        assert_eq!(seen.contains(code), !nowhere.contains(code), "{code:?}");
    }
    let codes: Vec<&str> = Code::ALL.iter().map(|c| c.as_str()).collect();
    assert_eq!(
        document["components"]["schemas"]["Problem"]["properties"]["code"]["enum"],
        json!(codes)
    );
}

#[test]
fn problems_are_valid_documents() {
    let document = document();
    let schema = component(&document, "Problem");
    for code in Code::ALL {
        let full = Problem::new(*code, "x")
            .pointer("/p/0")
            .handle(0)
            .limit("bytes", 1, 2.5)
            .retry_after(1);
        assert!(schema.is_valid(&full.to_json("", Some("id"))), "{code:?}");
        assert!(
            schema.is_valid(&Problem::new(*code, "x").to_json("/tools/warp", None)),
            "{code:?}"
        );
    }
    assert!(!schema.is_valid(&json!({"code": "internal"})));
}

fn names<T: EnumName>(document: &Value, place: &str) -> Vec<&'static str> {
    let node = document["components"]["schemas"]
        .pointer(place)
        .expect(place);
    let here: Vec<&str> = T::ALL.iter().map(|v| v.as_str()).collect();
    assert_eq!(node["enum"], json!(here), "{place}");
    here
}

fn words<T: EnumName>(place: &str) {
    let document = document();
    let here = names::<T>(&document, place);
    assert_eq!(
        document["components"]["schemas"]
            .pointer(place)
            .expect(place)["default"],
        here[0],
        "{place}"
    );
}

#[test]
fn enums_list_what_this_version_has() {
    names::<Method>(&document(), "/EffectiveMethod");
    words::<RequestedMethod>("/Method");
    words::<Units>("/Units");
    words::<Align>("/Align");
    words::<Folds>("/Folds");
    words::<Compression>("/Compression");
    words::<Filter>("/Filter");
    words::<MapDirection>("/Direction");
    words::<Holes>("/Holes");
    words::<Format>("/Output/properties/format");
    words::<Easing>("/Easing");
}

/// `null` as the value of a known field is absence, which the document says in words: a schema with
/// `null` everywhere makes clumsy clients. `known`: the properties of the schema; in the object of
/// a field, the table has `null` for known ones only.
fn without_nulls(value: Value, known: Option<&Value>) -> Value {
    match value {
        Value::Object(fields) => {
            let is_absent = |name: &str, value: &Value| {
                value.is_null() && known.is_none_or(|known| known.get(name).is_some())
            };
            let given = fields
                .into_iter()
                .filter(|(name, value)| !is_absent(name, value));
            given
                .map(|(name, value)| (name, without_nulls(value, None)))
                .collect()
        }
        other => other,
    }
}

#[test]
fn schemas_and_parsers_agree_on_a_table() {
    let document = document();
    type Parse = fn(&[u8]) -> bool;
    let batch = |b: &[u8]| {
        let source = CoordinateFrame::of_source(Extent::new(400, 300).unwrap(), Units::Px);
        let (body, free) = (super::bytes(b), |_| Ok(()));
        Reserved::<BatchObject, _>::parse(&body, 1 << 20, 1 << 16, source, &|| false, free).is_ok()
    };
    let parsers: [(&str, Parse, &str); 11] = [
        ("Batch", batch, "\"q\": [], \"steps\": 2"),
        ("Fit", |b| FitObject::parse(b).is_ok(), "\"extent\": [4, 3]"),
        ("PosedFit", |b| FitObject::parse_posed(b).is_ok(), ""),
        ("WarpObject", |b| WarpObject::parse(b).is_ok(), ""),
        ("Drag", |b| DragObject::parse(b, usize::MAX).is_ok(), ""),
        ("Points", |b| super::points(b).is_ok(), "\"extent\": [4, 3]"),
        ("PosedPoints", |b| super::posed_points(b).is_ok(), ""),
        ("Map", |b| MapObject::parse(b).is_ok(), "\"extent\": [4, 3]"),
        ("PosedMap", |b| MapObject::parse_posed(b).is_ok(), ""),
        (
            "Report",
            |b| ReportObject::parse(b).is_ok(),
            "\"extent\": [4, 3]",
        ),
        (
            "PosedReport",
            |b| DragObject::parse_for_report(b, usize::MAX).is_ok(),
            "",
        ),
    ];
    let fields = [
        "p: []",
        "p: [[1, 2]]",
        "p: [[[1, 2], [3, 4]]]",
        "p: [[[1, 2]]]",
        "p: [[1, 2, 3]]",
        "p: [[1]]",
        "p: [[]]",
        "p: [1]",
        "p: [[1, [2, 3]]]",
        "q: [[1, 2]]",
        "weights: [1, 2]",
        "weights: [null]",
        "method: \"affine\"",
        "method: \"tps\"",
        "method: \"arap\"",
        "alpha: 2",
        "alpha: \"2\"",
        "point_mass: 3",
        "smoothing: 0",
        "smoothing: [0]",
        "units: \"normalized\"",
        "units: \"cm\"",
        "align: \"none\"",
        "align: \"similarity\"",
        "align: \"mirror\"",
        "align: true",
        "grid: \"auto\"",
        "grid: \"pixel\"",
        "grid: \"coarse\"",
        "grid: {\"cell\": 2}",
        "grid: {\"cell\": 0}",
        "grid: {\"cell\": 2, \"rows\": 3}",
        "grid: {\"rows\": 3}",
        "grid: {\"columns\": 2, \"rows\": 3}",
        "grid: {\"columns\": 1, \"rows\": 3}",
        "grid: {\"columns\": 2.5, \"rows\": 3}",
        "grid: {\"columns\": 4294967295, \"rows\": 4294967296}",
        "folds: \"reject\"",
        "folds: \"remove\"",
        "metric: \"geodesic\"",
        "mask: {\"threshold\": 0.25}",
        "mask: {\"threshold\": 1.5}",
        "mask: 0.5",
        "layer: \"@coverage\"",
        "layer: \"depth.v1\"",
        "layer: \"@depth\"",
        "layer: \"a b\"",
        "layer: 3",
        "output: {}",
        "output: null",
        "points: [null]",
        "grid: {\"cell\": 2, \"columns\": null, \"rows\": null}",
        "output: {\"format\": \"png\"}",
        "output: {\"format\": \"jpeg\", \"quality\": 100}",
        "output: {\"format\": \"webp\"}",
        "output: {\"format\": \"avif\"}",
        "output: {\"subsampling\": \"4:2:0\"}",
        "output: {\"subsampling\": \"4:2:2\"}",
        "output: {\"quality\": 0}",
        "output: {\"quality\": 101}",
        "output: {\"quality\": 50.5}",
        "output: {\"compression\": \"none\"}",
        "output: {\"compression\": \"max\"}",
        "output: {\"width\": 1}",
        "output: {\"width\": 0}",
        "output: {\"width\": 8.0}",
        "output: {\"width\": 8.5}",
        "output: {\"width\": null}",
        "output: {\"width\": 4294967296}",
        "output: {\"filter\": \"nearest\"}",
        "output: {\"filter\": \"bicubic\"}",
        "output: {\"outside\": \"edge\"}",
        "output: {\"outside\": \"reflect\"}",
        "output: {\"outside\": \"#AbCdEf\"}",
        "output: {\"outside\": \"#00000000\"}",
        "output: {\"outside\": \"#0000000\"}",
        "output: {\"outside\": {\"value\": 300}}",
        "output: {\"outside\": {\"value\": [0, 300, 65535]}}",
        "output: {\"outside\": {\"value\": 65536}}",
        "output: {\"outside\": {\"value\": [1, 2]}}",
        "output: {\"outside\": {\"value\": 1, \"alpha\": 1}}",
        "output: {\"outside\": {}}",
        "output: {\"canvas\": \"fit\"}",
        "output: {\"canvas\": \"same\"}",
        "output: {\"canvas\": \"grow\"}",
        "output: {\"canvas\": {\"x\": -20, \"y\": 0, \"width\": 1123, \"height\": 724}}",
        "output: {\"canvas\": {\"x\": 0.5, \"y\": 0, \"width\": 1, \"height\": 1}}",
        "output: {\"canvas\": {\"x\": 0, \"y\": 1000001, \"width\": 1, \"height\": 1}}",
        "output: {\"canvas\": {\"x\": 0, \"y\": 0, \"width\": 0, \"height\": 1}}",
        "output: {\"holes\": \"keep\"}",
        "output: {\"holes\": \"transparent\"}",
        "output: {\"holes\": \"fill\"}",
        "output: {\"holes\": true}",
        "output: {\"x\": 1}",
        "steps: 0",
        "steps: 10000",
        "steps: 10001",
        "steps: 2.5",
        "easing: \"ease-in-out\"",
        "easing: \"ease\"",
        "delay: 1",
        "delay: 60001",
        "delay: 0.5",
        "seq: 0",
        "seq: -1",
        "seq: 1.5",
        "seq: 1e3",
        "seq: 18446744073709551615",
        "extent: [4, 3]",
        "extent: [0, 3]",
        "extent: [4]",
        "extent: [4, 3, 2]",
        "points: []",
        "points: [[1, 2]]",
        "points: [[1]]",
        "points: [[[1, 2], [3, 4]]]",
        "polygons: []",
        "polygons: [[[1, 2], [3, 4], [5, 7]]]",
        "polygons: [[[1, 2], [3, 4]]]",
        "boxes: []",
        "boxes: [[1, 2, 3, 4]]",
        "boxes: [[1, 2, 3]]",
        "geojson: {}",
        "geojson: {\"type\": \"FeatureCollection\", \"features\": []}",
        "geojson: {\"type\": \"FeatureCollection\", \
         \"features\": [{\"type\": \"Feature\", \"geometry\": null}]}",
        "geojson: {\"type\": \"FeatureCollection\", \
         \"features\": [{\"type\": \"Feature\", \"geometry\": {\"type\": \"Sphere\"}}]}",
        "inverse: true",
        "inverse: 0",
        "refine: false",
        "direction: \"forward\"",
        "direction: \"backward\"",
        "canvas: \"fit\"",
        "canvas: {\"x\": 0, \"y\": 1, \"width\": 2, \"height\": 3}",
        "canvas: {\"x\": 0}",
        "width: 9",
        "width: 0",
        "unheard_of: 1",
        "unheard_of: null",
        "coincident: {\"policy\": \"mean\"}",
        "coincident: {\"policy\": \"median\"}",
        "coincident: {\"policy\": \"reject\", \"within\": 0.5}",
        "coincident: {\"within\": -1}",
        "coincident: {\"within\": 1000001}",
        "coincident: {\"distance\": 1}",
        "coincident: \"mean\"",
        "strength: 0.5",
        "strength: -10",
        "strength: 10.5",
        "strength: \"1\"",
        "grid: {\"tolerance\": 0.25}",
        "grid: {\"tolerance\": 4.5}",
        "grid: {\"tolerance\": 1, \"cell\": 5}",
        "method: \"auto\"",
        "method: \"global_affine\"",
        "candidates: []",
        "candidates: [{}]",
        "candidates: [{\"method\": \"tps\"}]",
        "candidates: [{\"method\": \"auto\"}]",
        "candidates: [{\"method\": \"rigid\", \"alpha\": null, \"beta\": 1}]",
        "output: {\"format\": \"gif\"}",
        "output: {\"canvas\": {\"x\": 0}}",
        "output: \"jpeg\"",
    ];
    let mut accepted = 0;
    for (object, parse, base) in parsers {
        let schema = component(&document, object);
        let properties = &document["components"]["schemas"][object]["properties"];
        for field in fields {
            let (name, value) = field.split_once(": ").expect("name and value");
            // A base field that is given again is replaced: a duplicate is another matter.
            let kept = base.split(", \"").filter(|b| {
                !b.is_empty() && !b.trim_start_matches('"').starts_with(&format!("{name}\""))
            });
            let kept: Vec<String> = kept
                .map(|b| {
                    if b.starts_with('"') {
                        b.to_owned()
                    } else {
                        format!("\"{b}")
                    }
                })
                .collect();
            let text = format!(
                "{{{}}}",
                kept.into_iter()
                    .chain([format!("\"{name}\": {value}")])
                    .collect::<Vec<_>>()
                    .join(", ")
            );
            let json = without_nulls(serde_json::from_str(&text).expect(&text), Some(properties));
            assert_eq!(schema.is_valid(&json), parse(text.as_bytes()), "{text}");
            accepted += usize::from(schema.is_valid(&json));
        }
    }
    assert!(accepted > 70, "{accepted}");
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(64))]

    #[test]
    fn what_is_written_is_valid(warp in warp_object()) {
        thread_local!(static SCHEMA: Validator = component(&document(), "WarpObject"));
        let json = written(&warp);
        prop_assert!(SCHEMA.with(|schema| schema.is_valid(&json)), "{json}");
    }
}
