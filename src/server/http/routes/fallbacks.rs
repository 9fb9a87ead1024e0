//! Requests for a path or a method that is not served: the problem names the route that was probably meant.

use std::collections::BTreeMap;
use std::sync::LazyLock;

use axum::extract::{MatchedPath, Request, State};
use axum::http::{Method, Uri};
use serde::Deserialize;
use serde::de::IgnoredAny;

use super::service::OPENAPI;
use crate::app::App;
use crate::problem::words::{quote, series, similarity};
use crate::problem::{Code, Problem};

/// Longest path that is compared with those of the contract, bytes.
const LONGEST_COMPARED: usize = 200;
/// How similar the first segments must be: they are few, and words that mean something else are as near.
const SIMILAR_FAMILY: f64 = 0.7;
/// Prefixes that other services have before such paths.
const PREFIXES: [&str; 2] = ["api", "rest"];

/// Longest method that a problem repeats.
const LONGEST_METHOD: usize = 10;
/// The methods of the contract, as the document and as requests write them.
const METHODS: [(&str, &str); 4] = [("get", "GET"), ("post", "POST"), ("put", "PUT"), ("delete", "DELETE")];

/// The paths of the contract with their methods.
#[derive(Deserialize)]
struct Contract<'a> {
    #[serde(borrow)]
    paths: BTreeMap<&'a str, BTreeMap<&'a str, IgnoredAny>>,
}

static CONTRACT: LazyLock<Contract<'static>> =
    LazyLock::new(|| serde_json::from_str(OPENAPI).expect("the document is valid, and a test reads it"));

/// Answers a path that no route has.
pub(crate) async fn not_found(State(app): State<App>, method: Method, uri: Uri) -> Problem {
    let (path, public) = (uri.path(), app.config().public_path.as_str());
    let reference = if cfg!(feature = "docs") { "/docs" } else { "/openapi.json" };
    let is_public = path.strip_prefix(public).is_some_and(|rest| !public.is_empty() && (rest.is_empty() || rest.starts_with('/')));
    let hint = match meant(method.as_str(), path) {
        _ if is_public => format!("; the proxy must remove {public} from the path before it forwards a request. See"),
        Some((method, route)) => format!("; did you mean {method}{public}{route}? See"),
        None => "; see".to_owned(),
    };
    Problem::new(Code::NotFound, format!("nothing is served at {}{hint} {public}{reference}", quote(path)))
}

/// Answers a method that a path does not have. axum adds `Allow`.
pub(crate) async fn method_not_allowed(request: Request) -> Problem {
    not_allowed(&request)
}

/// See [`method_not_allowed`].
pub(crate) fn not_allowed(request: &Request) -> Problem {
    // A client may send any word as its method.
    let method = Some(request.method().as_str()).filter(|method| method.len() <= LONGEST_METHOD).unwrap_or("this method");
    let route = request.extensions().get::<MatchedPath>().and_then(|route| CONTRACT.paths.get(route.as_str()));
    // The other routes are files.
    let methods = route.map_or_else(|| vec!["GET"], methods);
    let detail = format!("{method} is not supported at {}; use {}", quote(request.uri().path()), series(&methods, "or"));
    Problem::new(Code::MethodNotAllowed, detail)
}

/// The methods of a path of the contract.
fn methods(operations: &BTreeMap<&str, IgnoredAny>) -> Vec<&'static str> {
    METHODS.into_iter().filter(|(key, _)| operations.contains_key(key)).map(|(_, name)| name).collect()
}

/// The route of the contract that a path probably means: its method and a space, if one is clear, and its path.
fn meant(method: &str, path: &str) -> Option<(String, &'static str)> {
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
        let scores = || segments.iter().zip(&pattern).map(alike);
        let is_near = pattern.len() == segments.len() && scores().next().is_none_or(|first| first >= SIMILAR_FAMILY);
        if is_near { scores().product() } else { 0.0 }
    };
    let scored = CONTRACT.paths.iter().map(|(pattern, operations)| (score(pattern), *pattern, operations));
    let (_, pattern, operations) =
        scored.filter(|(score, ..)| *score > 0.0).reduce(|best, next| if next.0 > best.0 { next } else { best })?;
    let named = methods(operations);
    match (named.iter().find(|name| **name == method), named.as_slice()) {
        (Some(name), _) | (None, [name]) => Some((format!("{name} "), pattern)),
        _ => Some((String::new(), pattern)),
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
            ("GET", "/version", None),
            ("GET", "/sessions/x/y/z", None),
        ] {
            let found = meant(method, path).map(|(method, route)| method + route);
            assert_eq!(found.as_deref(), expected, "{method} {path}");
        }
        assert_eq!(meant("GET", &"/warp".repeat(1000)), None);
    }
}
