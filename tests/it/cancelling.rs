//! Cancellation cannot be forgotten: the service calls nothing that cannot be cancelled, and no
//! closure of it ignores the question. Only what is listed here may, with the bound of its work.

use std::path::Path;

use crate::module_dependencies::sources;

/// Work that is bounded so that it ends by itself within about 10 ms: closures that ignore their
/// `Cancel` contain one of these.
const BOUNDED: [(&str, &str); 6] = [
    (
        "::parse",
        "JSON of a request, at most `--max-warp-json-bytes`, or a batch: deploy/capacity.md has \
            the time for the largest",
    ),
    (
        "| parse(",
        "a drag or a message of a socket, no longer than the session's handles",
    ),
    ("| read()", "the handles of one drag"),
    (
        "| posed()",
        "a few operations for each of at most `--max-columns` positions",
    ),
    ("to_invert(", "the same"),
    (
        "shapes.target(",
        "a few operations for each handle of at most 200 images",
    ),
];
/// Functions of the library that cannot be cancelled, for the offline tool: the service calls what
/// they are made of.
const WITHOUT_CANCELLATION: [&str; 2] = ["RestDeformation::new(", "RestDeformation::spline("];

/// The code of a file without comments and unit tests.
fn code(text: &str) -> String {
    let text = text
        .split("#[cfg(test)]\nmod tests {")
        .next()
        .unwrap_or_default();
    text.lines()
        .map(|line| line.split("//").next().unwrap_or_default())
        .collect::<Vec<_>>()
        .join("\n")
}

/// What is wrong with the code of a file of the service.
fn offences(code: &str) -> Vec<String> {
    let mut found: Vec<String> = WITHOUT_CANCELLATION
        .iter()
        .filter(|name| code.contains(*name))
        .map(|name| format!("calls {name}..)"))
        .collect();
    for (at, _) in code.match_indices("|| false") {
        found.push(format!(
            "never cancels: {}",
            &code[at.saturating_sub(60)..at + 8]
        ));
    }
    for closure in ["move |_| ", "|_: &_| ", "|_: &Cancel| "] {
        for (at, _) in code.match_indices(closure) {
            // As far as the work of such a closure goes.
            let end = code[at..]
                .char_indices()
                .nth(400)
                .map_or(code.len(), |(length, _)| at + length);
            let body = &code[at..end];
            if !BOUNDED.iter().any(|(name, _)| body.contains(name)) {
                found.push(format!(
                    "ignores its cancellation: {}",
                    body.lines().next().unwrap_or_default()
                ));
            }
        }
    }
    found
}

#[test]
fn cancelling_is_forgotten_nowhere_in_the_service() {
    let root = Path::new(env!("CARGO_MANIFEST_DIR")).join("../server");
    let mut files = Vec::new();
    sources(&root, &mut files);
    assert!(files.len() > 100, "{}", files.len());
    let mut all = Vec::new();
    for file in files {
        let name = file
            .strip_prefix(&root)
            .unwrap()
            .to_str()
            .unwrap()
            .to_owned();
        // The offline tool waits for what it computes.
        if name.contains("tests") || name.starts_with("cli/") {
            continue;
        }
        let text = std::fs::read_to_string(&file).unwrap();
        all.extend(
            offences(&code(&text))
                .into_iter()
                .map(|offence| format!("{name} {offence}")),
        );
    }
    assert!(all.is_empty(), "{}", all.join("\n"));
}

/// The test itself.
#[test]
fn cancelling_that_is_forgotten_is_seen() {
    for wrong in [
        "let field = RestDeformation::new(handles, method, falloff, 1.0)?;",
        "posed.into_report(canvas, &|| false)?;",
        "ticket.run(move |_| long_work(&rest)).await?",
        "let work = move |_: &_| { long_work(&rest) };",
        "let work = move |_: &_| long_work(&rest);",
        "let work = |_: &Cancel| long_work(&rest);",
    ] {
        assert_eq!(offences(wrong).len(), 1, "{wrong}");
    }
    assert!(offences("ticket.run(move |_| FitObject::parse(&json)).await?").is_empty());
    assert!(offences("ticket.run(move |cancel| work(cancel))").is_empty());
}
