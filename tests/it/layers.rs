//! The arrows of the house: which room may name which. `use`, inline paths and `super::super` are all seen: every path is resolved from its
//! module before it is looked up.

use std::path::{Path, PathBuf};

/// A room and the rooms that it may name beside itself. `service/http` is a room of its own inside `service`.
const ARROWS: [(&str, &[&str]); 9] = [
    ("level", &[]),
    ("geometry", &[]),
    ("pixmap", &[]),
    ("deform", &["geometry", "level"]),
    ("render", &["geometry", "pixmap", "level"]),
    ("codec", &["pixmap", "level"]),
    ("warp", &["geometry", "pixmap", "deform", "render", "codec", "level"]),
    ("service", &["geometry", "pixmap", "deform", "render", "codec", "warp"]),
    ("http", &["service", "geometry", "pixmap", "deform", "render", "codec", "warp"]),
];
/// Crates that only some rooms, folders or files may name.
const CRATES: [(&str, &[&str]); 10] = [
    ("axum", &["http"]),
    // Spans are posted, which is no part of the service's own HTTP.
    ("hyper", &["http", "service/telemetry/post.rs"]),
    ("opentelemetry", &["service/telemetry/", "service/http/fence.rs"]),
    ("opentelemetry_sdk", &["service/telemetry/", "service/http/fence.rs"]),
    ("tokio", &["service", "http"]),
    ("tokio_tungstenite", &["http"]),
    ("tokio_rustls", &["service", "http"]),
    ("rayon", &["deform", "render", "warp", "service"]),
    ("image", &["codec"]),
    ("png", &["codec"]),
];

pub(crate) fn sources(folder: &Path, found: &mut Vec<PathBuf>) {
    for entry in std::fs::read_dir(folder).unwrap() {
        let path = entry.unwrap().path();
        if path.is_dir() {
            sources(&path, found);
        } else if path.extension().is_some_and(|e| e == "rs") {
            found.push(path);
        }
    }
}

/// The module path of a file under `src`: `deform/kernel/mod.rs` is `[deform, kernel]`.
fn module(file: &Path) -> Vec<String> {
    let mut path: Vec<String> = file.with_extension("").iter().map(|part| part.to_str().unwrap().to_owned()).collect();
    if path.last().is_some_and(|last| last == "mod") {
        path.pop();
    }
    path
}

fn room(module: &[String]) -> &str {
    match module {
        [service, http, ..] if service == "service" && http == "http" => "http",
        [first, ..] => first,
        [] => "",
    }
}

/// Code only: no comments, no strings, and nothing after the unit tests of a file begin.
fn code(text: &str) -> String {
    let text = text.split("#[cfg(test)]\nmod tests {").next().unwrap_or_default();
    text.lines().map(|line| line.split("//").next().unwrap_or_default()).collect::<Vec<_>>().join("\n")
}

/// Every `crate::a::b`, `super::..` path in the code, resolved; groups (`crate::{a, b::c}`) are opened one level.
fn paths(code: &str, module: &[String]) -> Vec<Vec<String>> {
    let mut found = Vec::new();
    let bytes = code.as_bytes();
    for start in ["crate::", "super::"] {
        for (at, _) in code.match_indices(start) {
            // Only the head of a path: `super::super::x` is looked at once.
            if at > 0 && (bytes[at - 1] == b':' || bytes[at - 1].is_ascii_alphanumeric() || bytes[at - 1] == b'_') {
                continue;
            }
            let mut rest = &code[at..];
            let mut base = if start == "crate::" { Vec::new() } else { module.to_vec() };
            while let Some(tail) = rest.strip_prefix("super::") {
                base.pop();
                rest = tail;
            }
            rest = rest.strip_prefix("crate::").unwrap_or(rest);
            let name = |text: &str| text.trim().chars().take_while(|c| c.is_alphanumeric() || *c == '_').collect::<String>();
            let mut heads = Vec::new();
            if let Some(group) = rest.strip_prefix('{') {
                let mut depth = 0;
                let mut item = String::new();
                for c in group.chars() {
                    match c {
                        '{' => depth += 1,
                        '}' if depth == 0 => break,
                        '}' => depth -= 1,
                        ',' if depth == 0 => heads.push(name(&std::mem::take(&mut item))),
                        _ => {}
                    }
                    if c != ',' || depth > 0 {
                        item.push(c);
                    }
                }
                heads.push(name(&item));
            } else {
                heads.push(name(rest));
                let second = rest.split("::").nth(1).map(name);
                if base.is_empty() && heads[0] == "service" && second.as_deref() == Some("http") {
                    heads = vec!["http".to_owned()];
                }
            }
            found.extend(heads.into_iter().filter(|head| !head.is_empty()).map(|head| [base.clone(), vec![head]].concat()));
        }
    }
    found
}

fn offences(file: &Path, text: &str) -> Vec<String> {
    let module = module(file);
    let own = room(&module).to_owned();
    let code = code(text);
    let mut offences = Vec::new();
    let Some((_, allowed)) = ARROWS.iter().find(|(name, _)| *name == own) else { return offences };
    for path in paths(&code, &module) {
        let target = room(&path);
        let is_room = ARROWS.iter().any(|(name, _)| *name == target);
        if is_room && target != own && !allowed.contains(&target) {
            offences.push(format!("{} names {}", file.display(), path.join("::")));
        }
    }
    for (krate, rooms) in CRATES {
        let named = code.match_indices(&format!("{krate}::")).any(|(at, _)| {
            let before = code[..at].chars().next_back();
            !before.is_some_and(|c| c.is_alphanumeric() || c == '_' || c == ':')
        });
        let file_name = file.to_str().unwrap();
        // `codec::png` and `warp::image` are rooms of this crate; there the crate of that name is written `::png`.
        let own_name = module.iter().any(|part| part == krate) || code.contains(&format!("mod {krate};"));
        if named && !own_name && !rooms.iter().any(|r| *r == own || file_name.starts_with(r) && r.contains('/')) {
            offences.push(format!("{file_name} names the crate {krate}"));
        }
    }
    offences
}

#[test]
fn layers_arrows_run_one_way() {
    let root = Path::new(env!("CARGO_MANIFEST_DIR")).join("../../src");
    let mut files = Vec::new();
    sources(&root, &mut files);
    assert!(files.len() > 50, "{} files were looked at", files.len());
    let mut all = Vec::new();
    for file in files {
        let relative = file.strip_prefix(&root).unwrap();
        let is_test = relative.iter().any(|part| part.to_str().unwrap().starts_with("tests") || part == "contract_tests.rs");
        if !is_test {
            all.extend(offences(relative, &std::fs::read_to_string(&file).unwrap()));
        }
    }
    assert!(all.is_empty(), "{}", all.join("\n"));
}

/// The test itself: a wrong arrow is seen however it is written.
#[test]
fn layers_wrong_arrows_are_seen() {
    let seen = |file: &str, text: &str| !offences(Path::new(file), text).is_empty();
    assert!(seen("deform/plan.rs", "use crate::render::Filter;"));
    assert!(seen("deform/kernel/scalar.rs", "use super::super::super::codec::Limits;"));
    assert!(seen("codec/decode.rs", "use crate::{pixmap::Extent, deform::Handle};"));
    assert!(seen("geometry/grid.rs", "fn f() { crate::warp::Digest::of(b\"\"); }"));
    assert!(seen("warp/setup.rs", "use crate::service::App;"));
    assert!(seen("service/pool.rs", "use super::http::router; use crate::service::http::router;"));
    assert!(seen("warp/setup.rs", "use tokio::sync::Notify;"));
    assert!(!seen("deform/plan.rs", "use super::field::Field; use crate::geometry::Grid; // crate::render"));
    assert!(!seen("service/http/warp.rs", "use axum::Router; use crate::service::App; use super::body::json;"));
}
