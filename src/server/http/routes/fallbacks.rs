//! Requests for a path or a method that is not served: the problem names the route that was probably meant.

use std::collections::BTreeMap;
use std::sync::LazyLock;

use axum::http::{Method, Uri};
use serde::Deserialize;
use serde::de::IgnoredAny;

use super::service::OPENAPI;
use crate::problem::words::{quote, similarity};
use crate::problem::{Code, Problem};

/// Longest path that is compared with those of the contract, bytes.
const LONGEST_COMPARED: usize = 200;
/// Prefixes that other services have before such paths.
const PREFIXES: [&str; 2] = ["api", "rest"];

/// The paths of the contract with their methods.
#[derive(Deserialize)]
struct Contract<'a> {
    #[serde(borrow)]
    paths: BTreeMap<&'a str, BTreeMap<&'a str, IgnoredAny>>,
}

static CONTRACT: LazyLock<Contract<'static>> =
    LazyLock::new(|| serde_json::from_str(OPENAPI).expect("the document is valid, and a test reads it"));

/// Answers a path that no route has.
pub(crate) async fn not_found(method: Method, uri: Uri) -> Problem {
    let path = uri.path();
    let hint = meant(method.as_str(), path).map_or_else(|| "; see".to_owned(), |meant| format!("; did you mean {meant}? See"));
    let reference = if cfg!(feature = "docs") { "/docs" } else { "/openapi.json" };
    Problem::new(Code::NotFound, format!("nothing is served at {}{hint} {reference}", quote(path)))
}

/// Answers a method that a path does not have. axum adds `Allow`, from which [`complete`] names the methods that it has.
pub(crate) async fn method_not_allowed(method: Method, uri: Uri) -> Problem {
    not_allowed(&method, uri.path())
}

/// See [`method_not_allowed`].
pub(crate) fn not_allowed(method: &Method, path: &str) -> Problem {
    // A client may send any word as its method.
    let method = if method.as_str().len() <= 10 { method.as_str() } else { "this method" };
    Problem::new(Code::MethodNotAllowed, format!("{method} is not supported at {}", quote(path)))
}

/// The route of the contract that a path probably means.
fn meant(method: &str, path: &str) -> Option<String> {
    let path = Some(path).filter(|path| path.len() <= LONGEST_COMPARED)?;
    let mut segments: Vec<&str> = path.split('/').filter(|segment| !segment.is_empty()).collect();
    let is_version =
        |segment: &str| segment.strip_prefix(['v', 'V']).is_some_and(|rest| rest.bytes().all(|b| b.is_ascii_digit() || b == b'.'));
    while segments.len() > 1 && (is_version(segments[0]) || PREFIXES.iter().any(|prefix| segments[0].eq_ignore_ascii_case(prefix))) {
        segments.remove(0);
    }
    let score = |pattern: &str| {
        let pattern: Vec<&str> = pattern.split('/').filter(|segment| !segment.is_empty()).collect();
        let alike = |(segment, pattern): (&&str, &&str)| if pattern.starts_with('{') { 1.0 } else { similarity(segment, pattern) };
        if pattern.len() == segments.len() { segments.iter().zip(&pattern).map(alike).product() } else { 0.0 }
    };
    let scored = CONTRACT.paths.iter().map(|(pattern, methods)| (score(pattern), *pattern, methods));
    let (_, pattern, methods) = scored.filter(|(score, ..)| *score > 0.0).reduce(|best, next| if next.0 > best.0 { next } else { best })?;
    let named: Vec<String> = methods.keys().filter(|key| **key != "parameters").map(|key| key.to_ascii_uppercase()).collect();
    match (named.iter().find(|name| *name == method), named.as_slice()) {
        (Some(name), _) => Some(format!("{name} {pattern}")),
        (None, [only]) => Some(format!("{only} {pattern}")),
        _ => Some(pattern.to_owned()),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn paths_find_the_route_that_was_meant() {
        for (method, path, expected) in [
            ("POST", "/v1/warp", Some("POST /warp")),
            ("POST", "/warp/", Some("POST /warp")),
            ("GET", "/warp/", Some("POST /warp")),
            ("POST", "/api/v2.1/Warp", Some("POST /warp")),
            ("GET", "/wrap", Some("POST /warp")),
            ("POST", "//warp", Some("POST /warp")),
            ("POST", "/session", Some("POST /sessions")),
            ("DELETE", "/session/x", Some("DELETE /sessions/{id}")),
            ("POST", "/session/x", Some("/sessions/{id}")),
            ("POST", "/sessions/x/warps", Some("POST /sessions/{id}/warp")),
            ("GET", "/sessions/x/drag/", Some("GET /sessions/{id}/drag")),
            ("GET", "/health", Some("GET /healthz")),
            ("GET", "/nothing-like-it", None),
            ("GET", "/v1", None),
            ("GET", "/sessions/x/y/z", None),
        ] {
            assert_eq!(meant(method, path).as_deref(), expected, "{method} {path}");
        }
        assert_eq!(meant("GET", &"/warp".repeat(1000)), None);
    }
}
