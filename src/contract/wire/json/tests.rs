use proptest::prelude::*;
use serde_json::Value;

use super::*;

fn texts(array: &str) -> Vec<String> {
    let body = format!("{{\"a\": {array}}}");
    let root = root(body.as_bytes()).unwrap();
    let [a] = root.fields(&["a"]).unwrap();
    let mut texts = Vec::new();
    a.unwrap()
        .items::<Problem>("an array", |index, item| {
            assert_eq!(item.at.to_string(), format!("/a/{index}"));
            texts.push(item.text.to_owned());
            Ok(())
        })
        .unwrap();
    texts
}

#[test]
fn items_are_found_between_spaces_strings_and_brackets() {
    assert_eq!(texts("[]"), [""; 0]);
    assert_eq!(texts("[ \n\t\r ]"), [""; 0]);
    assert_eq!(texts("[1]"), ["1"]);
    assert_eq!(
        texts("[ -1.5e+3 ,\r\n\ttrue , null]"),
        ["-1.5e+3", "true", "null"]
    );
    assert_eq!(texts("[[],{},\"\"]"), ["[]", "{}", "\"\""]);
    assert_eq!(
        texts("[[ 1 , [2] ] , {\"b\": [3, {}]} ]"),
        ["[ 1 , [2] ]", "{\"b\": [3, {}]}"]
    );
    assert_eq!(
        texts(r#"["]", "\"", "\\", "[\\\",", [",]"], {"}": "{"}]"#),
        [
            r#""]""#,
            r#""\"""#,
            r#""\\""#,
            r#""[\\\",""#,
            r#"[",]"]"#,
            r#"{"}": "{"}"#
        ]
    );
    assert_eq!(texts("[\"\u{e9}]\", 2]"), ["\"\u{e9}]\"", "2"]);
}

fn json() -> impl Strategy<Value = Value> {
    let scalar = prop_oneof![
        Just(Value::Null),
        any::<bool>().prop_map(Value::from),
        any::<f64>().prop_map(Value::from),
        any::<i32>().prop_map(Value::from),
        "[\\[\\]{},:\"\\\\ a\u{e9}]{0,6}".prop_map(Value::from),
    ];
    scalar.prop_recursive(4, 32, 4, |inner| {
        prop_oneof![
            prop::collection::vec(inner.clone(), 0..4).prop_map(Value::from),
            prop::collection::vec(("[\\[\\]{},\"\\\\a]{0,3}", inner), 0..4)
                .prop_map(|f| Value::Object(f.into_iter().collect())),
        ]
    })
}

proptest! {
    #[test]
    fn items_are_those_that_serde_finds(items in prop::collection::vec(json(), 0..5),
        pretty: bool) {
        let array = Value::from(items);
        let text = if pretty { serde_json::to_string_pretty(&array) } else {
            serde_json::to_string(&array) }.unwrap();
        let expected: Vec<&RawValue> = serde_json::from_str(&text).unwrap();
        prop_assert_eq!(texts(&text), expected.iter().map(|raw| raw.get()).collect::<Vec<_>>());
    }
}
