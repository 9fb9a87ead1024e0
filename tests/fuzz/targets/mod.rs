//! What is fuzzed: each target takes any bytes and panics when a law is broken. The same functions
//! run under a coverage-guided fuzzer (`long/`) and, over seeds, found inputs and damage by chance,
//! in `main.rs`.

mod image;
mod landmarks;
mod law;
mod multipart;
mod record;
mod socket;
mod token;
mod warp;

/// A target: its name, which is its folder of seeds and found inputs too, and what it does with
/// bytes.
pub(crate) type Target = (&'static str, fn(&[u8]));

/// All of them.
pub(crate) const TARGETS: [Target; 8] = [
    ("image", image::decode),
    ("warp", warp::parse),
    ("multipart", multipart::post),
    ("socket", socket::talk),
    ("record", record::keep),
    ("law", law::hold),
    ("landmarks", landmarks::read),
    ("token", token::check),
];

/// What holds for every problem document, from every part of the program.
fn assert_is_problem(document: &serde_json::Value) {
    let text = |field: &str| {
        document[field]
            .as_str()
            .is_some_and(|text| !text.is_empty())
    };
    assert!(
        text("title") && text("detail") && text("code"),
        "{document}"
    );
    assert_eq!(
        document["type"],
        format!(
            "/problems/{}",
            document["code"].as_str().unwrap_or_default()
        )
    );
    assert!(
        document["status"]
            .as_u64()
            .is_some_and(|status| (400..500).contains(&status)),
        "{document}"
    );
    let pointer = document
        .get("pointer")
        .and_then(serde_json::Value::as_str)
        .unwrap_or_default();
    assert!(pointer.is_empty() || pointer.starts_with('/'), "{document}");
}
