//! Requests for a path or a method that is not served: the problem names the route that was
//! probably meant.

use std::collections::BTreeMap;
use std::sync::LazyLock;

use axum::extract::{MatchedPath, Request, State};
use axum::http::{Method, Uri};
use serde::Deserialize;
use serde::de::IgnoredAny;

use super::service::OPENAPI;
use crate::app::App;
use crate::http::response::Refusal;
use crate::problem::words::{quote, series, similarity};
use crate::problem::{Code, Problem};

/// Longest path that is compared with those of the contract, bytes.
const LONGEST_COMPARED: usize = 200;
/// How similar the first segments must be: they are few, and words that mean something else are as
/// near.
const SIMILAR_FAMILY: f64 = 0.7;
/// Prefixes that other services have before such paths.
const PREFIXES: [&str; 2] = ["api", "rest"];

/// Longest method that a problem repeats.
const LONGEST_METHOD: usize = 10;
/// The methods of the contract, as the document and as requests write them.
const METHODS: [(&str, &str); 4] = [
    ("get", "GET"),
    ("post", "POST"),
    ("put", "PUT"),
    ("delete", "DELETE"),
];

/// The paths of the contract with their methods.
#[derive(Deserialize)]
struct Contract<'a> {
    #[serde(borrow)]
    paths: BTreeMap<&'a str, BTreeMap<&'a str, IgnoredAny>>,
}

static CONTRACT: LazyLock<Contract<'static>> = LazyLock::new(|| {
    serde_json::from_str(OPENAPI).expect("the document is valid, and a test reads it")
});

/// Answers a path that no route has.
pub(crate) async fn not_found(State(app): State<App>, method: Method, uri: Uri) -> Refusal {
    let (path, public) = (uri.path(), app.config().public_path.as_str());
    let reference = if cfg!(feature = "docs") {
        "/docs"
    } else {
        "/openapi.json"
    };
    if path.contains("//") {
        let detail = "the path has an empty segment, as if a variable of a script were empty. See";
        return Problem::new(
            Code::NotFound,
            format!(
                "nothing is served at {}; {detail} {public}{reference}",
                quote(path)
            ),
        )
        .into();
    }
    let is_public = path
        .strip_prefix(public)
        .is_some_and(|rest| !public.is_empty() && (rest.is_empty() || rest.starts_with('/')));
    let hint = match meant(method.as_str(), path) {
        _ if is_public => format!(
            "; the proxy must remove {public} from the path before it forwards a request. See"
        ),
        Some((method, route)) => format!("; did you mean {method}{public}{route}? See"),
        None => below(None, path, public).map_or_else(
            || "; see".to_owned(),
            |routes| format!("; below it are {routes}. See"),
        ),
    };
    Problem::new(
        Code::NotFound,
        format!(
            "nothing is served at {}{hint} {public}{reference}",
            quote(path)
        ),
    )
    .into()
}

/// Answers a method that a path does not have. axum adds `Allow`.
pub(crate) async fn method_not_allowed(State(app): State<App>, request: Request) -> Refusal {
    not_allowed(&request, &app.config().public_path).into()
}

/// See [`method_not_allowed`]. `public` precedes the paths that it names.
pub(crate) fn not_allowed(request: &Request, public: &str) -> Problem {
    // A client may send any word as its method.
    let method = Some(request.method().as_str())
        .filter(|method| method.len() <= LONGEST_METHOD)
        .unwrap_or("this method");
    let route = request
        .extensions()
        .get::<MatchedPath>()
        .map_or("", MatchedPath::as_str);
    // The other routes are files.
    let methods = CONTRACT
        .paths
        .get(route)
        .map_or_else(|| vec!["GET"], methods);
    let below = below(Some(method), route, public);
    let below = below.map_or_else(String::new, |routes| format!(". Below it are {routes}"));
    let detail = format!(
        "{method} is not supported at {}; use {}{below}",
        quote(request.uri().path()),
        series(&methods, "or")
    );
    Problem::new(Code::MethodNotAllowed, detail)
}

/// The routes below a path, or below the pattern of one, that have the method, or any: what a path
/// means that lacks its last part.
fn below(method: Option<&str>, path: &str, public: &str) -> Option<String> {
    let segments: Vec<&str> = path.split('/').skip(1).collect();
    let is_below = |pattern: &&str| {
        let pattern: Vec<&str> = pattern.split('/').skip(1).collect();
        let is_alike = |(segment, pattern): (&&str, &&str)| {
            segment == pattern || (pattern.starts_with('{') && !segment.is_empty())
        };
        pattern.len() > segments.len() && segments.iter().zip(&pattern).all(is_alike)
    };
    let named = |(pattern, operations): (&&str, &BTreeMap<&str, IgnoredAny>)| {
        let methods = methods(operations);
        match method {
            Some(method) => methods
                .contains(&method)
                .then(|| format!("{method} {public}{pattern}")),
            None => Some(format!("{} {public}{pattern}", methods.join(", "))),
        }
    };
    let routes: Vec<String> = CONTRACT
        .paths
        .iter()
        .filter(|(pattern, _)| is_below(pattern))
        .filter_map(named)
        .collect();
    (!routes.is_empty()).then(|| {
        series(
            &routes.iter().map(String::as_str).collect::<Vec<_>>(),
            "and",
        )
    })
}

/// The methods of a path of the contract.
fn methods(operations: &BTreeMap<&str, IgnoredAny>) -> Vec<&'static str> {
    METHODS
        .into_iter()
        .filter(|(key, _)| operations.contains_key(key))
        .map(|(_, name)| name)
        .collect()
}

/// The route of the contract that a path probably means: its method and a space, if one is clear,
/// and its path.
fn meant(method: &str, path: &str) -> Option<(String, &'static str)> {
    let path = Some(path).filter(|path| path.len() <= LONGEST_COMPARED)?;
    let mut segments: Vec<&str> = path
        .split('/')
        .filter(|segment| !segment.is_empty())
        .collect();
    let is_version = |segment: &str| {
        segment
            .strip_prefix(['v', 'V'])
            .is_some_and(|rest| rest.bytes().all(|b| b.is_ascii_digit() || b == b'.'))
    };
    while segments.len() > 1
        && (is_version(segments[0])
            || PREFIXES
                .iter()
                .any(|prefix| segments[0].eq_ignore_ascii_case(prefix)))
    {
        segments.remove(0);
    }
    let score = |pattern: &str| {
        let pattern: Vec<&str> = pattern
            .split('/')
            .filter(|segment| !segment.is_empty())
            .collect();
        let alike = |(segment, pattern): (&&str, &&str)| {
            if pattern.starts_with('{') {
                1.0
            } else {
                similarity(segment, pattern)
            }
        };
        let scores = || segments.iter().zip(&pattern).map(alike);
        let is_near = pattern.len() == segments.len()
            && scores().next().is_none_or(|first| first >= SIMILAR_FAMILY);
        if is_near { scores().product() } else { 0.0 }
    };
    let scored = CONTRACT
        .paths
        .iter()
        .map(|(pattern, operations)| (score(pattern), *pattern, operations));
    let (_, pattern, operations) = scored
        .filter(|(score, ..)| *score > 0.0)
        .reduce(|best, next| if next.0 > best.0 { next } else { best })?;
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
            (
                "POST",
                "/sessions/x/warps",
                Some("POST /sessions/{id}/warp"),
            ),
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

    #[test]
    fn routes_below_a_path_are_those_that_have_the_method() {
        let posts = below(Some("POST"), "/sessions/{id}", "").unwrap();
        assert!(
            posts.starts_with("POST /sessions/{id}/batch, ")
                && posts.ends_with(" and POST /sessions/{id}/warp"),
            "{posts}"
        );
        assert!(
            !posts.contains("layers") && !posts.contains("GET"),
            "{posts}"
        );
        for (method, path, expected) in [
            (Some("POST"), "/sessions/{id}/warp", None),
            (Some("DELETE"), "/sessions/{id}/handles", None),
            (
                None,
                "/sessions/x/layers",
                Some("GET, PUT, DELETE /a/sessions/{id}/layers/{name}"),
            ),
            (None, "/problems", Some("GET /a/problems/{code}")),
            (None, "/sessions//layers", None),
            (None, "/nothing", None),
        ] {
            assert_eq!(below(method, path, "/a").as_deref(), expected, "{path}");
        }
    }
}
