//! Who reads the table of methods: the page has a copy of it, which this test writes with
//! `MLSWARP_BLESS=1`.

use std::path::Path;

use mlswarp::deform::{AcceptedHandles, Handles, Interpolation, METHODS, MethodInfo};
use serde_json::{Value, json};

const PAGE: &str = "../web/methods.js";

fn row(info: &MethodInfo) -> Value {
    let nothing = Handles::new(Vec::new(), None).unwrap();
    let name = |path: &str| path.rsplit('/').next().unwrap().to_owned();
    let parameters = info.parameters.iter().map(|parameter| {
        json!({
            "name": parameter.name(),
            "default": (parameter.default)(&nothing),
            "sentence": parameter.sentence,
        })
    });
    json!({
        "name": info.name,
        "title": info.title,
        "sentence": info.sentence,
        "handles": match info.handles {
            AcceptedHandles::All => "all",
            AcceptedHandles::Points => "points",
            AcceptedHandles::Lines => "lines",
        },
        "interpolates": match info.interpolation {
            Interpolation::Always => json!(true),
            Interpolation::IfZero(path) => json!(name(path)),
            Interpolation::Never => json!(false),
        },
        "object": info.has_object,
        "mesh": info.mesh.is_some(),
        "parameters": parameters.collect::<Vec<_>>(),
    })
}

#[test]
fn methods_of_the_page_are_those_of_the_table() {
    let rows: Vec<Value> = METHODS.iter().map(|info| row(info)).collect();
    let text = format!(
        "// The table of methods of src/engine/deform/methods, written by tests/it/methods.rs.\n\n\
            /** @type {{Page.MethodInfo[]}} */\n\
            // prettier-ignore\n\
            export const METHODS = {};\n",
        serde_json::to_string_pretty(&rows).unwrap()
    );
    let file = Path::new(env!("CARGO_MANIFEST_DIR")).join(PAGE);
    if std::env::var_os("MLSWARP_BLESS").is_some() {
        std::fs::write(&file, &text).unwrap();
    }
    let kept = std::fs::read_to_string(&file).unwrap_or_default();
    assert_eq!(
        kept, text,
        "MLSWARP_BLESS=1 cargo test --test it methods_of_the_page"
    );
}

/// Names, sentences and parameters are told to people.
#[test]
fn every_method_says_what_it_does() {
    for info in METHODS {
        assert!(
            info.sentence.ends_with('.') && !info.title.is_empty(),
            "{}",
            info.name
        );
        for parameter in info.parameters {
            assert!(parameter.sentence.ends_with('.'), "{}", parameter.path);
            assert_eq!(
                parameter.object(),
                info.has_object.then_some(info.name),
                "{}",
                parameter.path
            );
        }
    }
}
