//! The dependency directions inside each crate; Cargo holds those between them. A table lists every
//! module and the modules that it may name; a module may name only modules that stand below it, so
//! the table itself rules out cycles. Files of one module may not form a cycle either, a module and
//! its own children excepted. Every path (`use`, inline, `super::super`) is resolved from its
//! module before it is looked up.

use std::collections::{BTreeMap, BTreeSet};
use std::path::{Path, PathBuf};

/// Each module with the modules of its crate that it may name.
const SERVER: [(&str, &[&str]); 13] = [
    ("cli", &["http", "app", "config", "auth", "client"]),
    (
        "http",
        &[
            "app", "config", "observe", "auth", "pool", "store", "limits", "session", "client",
        ],
    ),
    (
        "app",
        &[
            "config", "drag", "pool", "cache", "store", "observe", "auth", "limits", "session",
            "client",
        ],
    ),
    ("config", &["store", "observe", "auth", "limits"]),
    ("drag", &[]),
    ("pool", &["observe", "limits", "session", "client"]),
    ("cache", &["observe", "limits", "client"]),
    ("store", &["observe", "limits", "session", "client"]),
    ("observe", &["auth", "limits"]),
    ("auth", &["limits", "client"]),
    ("limits", &["session", "client"]),
    ("session", &["client"]),
    ("client", &[]),
];
const CONTRACT: [(&str, &[&str]); 5] = [
    ("blend", &["wire", "problem"]),
    ("file", &["wire", "layer", "problem"]),
    ("wire", &["layer", "problem"]),
    ("layer", &["problem"]),
    ("problem", &[]),
];
const ENGINE: [(&str, &[&str]); 11] = [
    (
        "warper",
        &[
            "warp", "format", "render", "deform", "pixmap", "geometry", "parallel",
        ],
    ),
    (
        "warp",
        &[
            "codec", "format", "render", "deform", "pixmap", "topology", "geometry", "parallel",
            "level",
        ],
    ),
    ("codec", &["format", "pixmap", "level"]),
    ("format", &["pixmap"]),
    ("render", &["pixmap", "geometry", "level"]),
    ("deform", &["topology", "geometry", "parallel", "level"]),
    ("pixmap", &[]),
    ("topology", &["geometry"]),
    ("geometry", &[]),
    ("parallel", &[]),
    ("level", &[]),
];
/// Crates that only some modules or files may name.
const CRATES: [(&str, &[&str]); 14] = [
    ("axum", &["server/http"]),
    // Spans are posted, which is no part of the service's own HTTP.
    ("hyper", &["server/http", "server/observe/otlp_client.rs"]),
    (
        "opentelemetry",
        &["server/observe", "server/http/middleware"],
    ),
    (
        "opentelemetry_sdk",
        &["server/observe", "server/http/middleware"],
    ),
    ("tokio", &["server"]),
    ("tokio_tungstenite", &["server/http"]),
    ("tokio_util", &["server/http"]),
    ("tower_http", &["server/http"]),
    ("tokio_rustls", &["server"]),
    ("rayon", &["engine/parallel.rs", "server"]),
    ("hmac", &["server/auth/tokens/mod.rs"]),
    ("image", &["engine/codec"]),
    ("png", &["engine/codec"]),
    (
        "zip",
        &["server/app/batch/package.rs", "server/cli/frames.rs"],
    ),
];

type Module = Vec<String>;

/// The files of a crate: path below `src`, module, code without comments, strings and unit tests.
struct CrateSources {
    files: BTreeMap<Module, (String, String)>,
}

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

/// The module of a file of a crate: `deform/kernel/mod.rs` is `[deform, kernel]`.
fn module(file: &Path) -> Module {
    let mut path: Module = file
        .with_extension("")
        .iter()
        .map(|part| part.to_str().unwrap().to_owned())
        .collect();
    if path
        .last()
        .is_some_and(|last| ["mod", "lib", "main"].contains(&last.as_str()))
    {
        path.pop();
    }
    path
}

/// Code only: no comments, and nothing after the unit tests of a file begin.
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

fn is_test(file: &Path) -> bool {
    let name = |part: &std::ffi::OsStr| part.to_str().is_some_and(|part| part.starts_with("tests"));
    file.starts_with("examples") || file.iter().any(name)
}

impl CrateSources {
    fn of(krate: &str) -> Self {
        let root = Path::new(env!("CARGO_MANIFEST_DIR")).join("..").join(krate);
        let mut found = Vec::new();
        sources(&root, &mut found);
        let files = found.iter().filter_map(|file| {
            let relative = file.strip_prefix(&root).unwrap();
            let text = std::fs::read_to_string(file).unwrap();
            let place = format!("{krate}/{}", relative.display());
            // The program's own file is no module of the library.
            let is_library =
                relative != Path::new("main.rs") && relative != Path::new("malloc_trim.rs");
            (is_library && !is_test(relative)).then(|| (module(relative), (place, code(&text))))
        });
        Self {
            files: files.collect(),
        }
    }

    /// The module of a path: the longest part of it that has a file.
    fn owner(&self, path: &[String]) -> Module {
        let lengths = (0..=path.len()).rev();
        lengths
            .map(|length| path[..length].to_vec())
            .find(|module| self.files.contains_key(module))
            .unwrap_or_default()
    }

    /// The modules that each module names.
    fn edges(&self) -> BTreeMap<&Module, BTreeSet<Module>> {
        let named = |module: &Module, code: &str| {
            let targets = paths(code, module)
                .into_iter()
                .map(|path| self.owner(&path));
            targets.filter(|target| target != module).collect()
        };
        self.files
            .iter()
            .map(|(module, (_, code))| (module, named(module, code)))
            .collect()
    }
}

/// Every `crate::a::b`, `self::..`, `super::..` path in the code, resolved; groups
/// (`crate::{a, b::c}`) are opened.
fn paths(code: &str, module: &[String]) -> Vec<Module> {
    let mut found = Vec::new();
    let bytes = code.as_bytes();
    for start in ["crate::", "super::", "self::"] {
        for (at, _) in code.match_indices(start) {
            // Only the head of a path: `super::super::x` is looked at once.
            if at > 0
                && (bytes[at - 1] == b':'
                    || bytes[at - 1].is_ascii_alphanumeric()
                    || bytes[at - 1] == b'_')
            {
                continue;
            }
            let mut rest = &code[at..];
            let mut base = if start == "crate::" {
                Vec::new()
            } else {
                module.to_vec()
            };
            while let Some(tail) = rest.strip_prefix("super::") {
                base.pop();
                rest = tail;
            }
            rest = rest
                .strip_prefix("crate::")
                .or_else(|| rest.strip_prefix("self::"))
                .unwrap_or(rest);
            open(&base, rest, &mut found);
        }
    }
    found
}

/// The paths of a use tree that begins `text`; returns what follows it.
fn open<'a>(base: &[String], text: &'a str, found: &mut Vec<Module>) -> &'a str {
    let text = text.trim_start();
    let Some(mut rest) = text.strip_prefix('{') else {
        let name: String = text
            .chars()
            .take_while(|c| c.is_alphanumeric() || *c == '_')
            .collect();
        let rest = &text[name.len()..];
        if name.is_empty() || name == "self" {
            found.push(base.to_vec());
            return rest.strip_prefix('*').unwrap_or(rest);
        }
        let path = [base, &[name]].concat();
        return match rest.strip_prefix("::") {
            Some(rest)
                if rest.starts_with(|c: char| {
                    c.is_alphabetic() || c == '{' || c == '_' || c == '*'
                }) =>
            {
                open(&path, rest, found)
            }
            _ => {
                found.push(path);
                rest
            }
        };
    };
    loop {
        rest = open(base, rest, found).trim_start();
        // An alias (`a as b`) names nothing more.
        rest = rest.strip_prefix("as ").map_or(rest, |alias| {
            alias.trim_start_matches(|c: char| c.is_alphanumeric() || c == '_')
        });
        match rest.trim_start().strip_prefix(',') {
            Some(tail) if !tail.trim_start().starts_with('}') => rest = tail,
            Some(tail) => return tail.trim_start().strip_prefix('}').unwrap_or(tail),
            None => return rest.trim_start().strip_prefix('}').unwrap_or(rest),
        }
    }
}

/// What the table forbids of the edges between modules, and modules that it does not list.
fn offences(sources: &CrateSources, table: &[(&str, &[&str])]) -> Vec<String> {
    let mut offences = Vec::new();
    for (k, (name, below)) in table.iter().enumerate() {
        let is_below = |target: &str| table[k + 1..].iter().any(|(other, _)| *other == target);
        offences.extend(
            below
                .iter()
                .filter(|target| !is_below(target))
                .map(|target| format!("the table: {name} names {target}, above it")),
        );
    }
    for (module, targets) in sources.edges() {
        let Some(top) = module.first() else { continue };
        let Some((_, allowed)) = table.iter().find(|(name, _)| name == top) else {
            offences.push(format!("{top} is not in the table"));
            continue;
        };
        for target in targets
            .iter()
            .filter_map(|target| target.first())
            .filter(|target| *target != top)
        {
            if !allowed.contains(&target.as_str()) {
                offences.push(format!("{} names {target}", module.join("::")));
            }
        }
    }
    offences
}

/// Files that name each other in a circle; a module and its own children may.
fn cycles(sources: &CrateSources) -> Vec<String> {
    let edges = sources.edges();
    let kin = |a: &Module, b: &Module| a.starts_with(b) || b.starts_with(a);
    let reached = |from: &Module| {
        let (mut seen, mut todo) = (BTreeSet::new(), vec![from.clone()]);
        while let Some(at) = todo.pop() {
            for next in edges
                .get(&at)
                .into_iter()
                .flatten()
                .filter(|next| !kin(&at, next))
            {
                if seen.insert(next.clone()) {
                    todo.push(next.clone());
                }
            }
        }
        seen
    };
    edges
        .keys()
        .filter(|module| reached(module).contains(**module))
        .map(|module| module.join("::"))
        .collect()
}

fn forbidden_crates(sources: &CrateSources) -> Vec<String> {
    let mut offences = Vec::new();
    for (module, (file, code)) in &sources.files {
        for (krate, places) in CRATES {
            let named = code.match_indices(&format!("{krate}::")).any(|(at, _)| {
                let before = code[..at].chars().next_back();
                !before.is_some_and(|c| c.is_alphanumeric() || c == '_' || c == ':')
            });
            // `codec::png` and `warp::image` are modules of this project; there the crate of that
            // name is written `::png`.
            let own_name =
                module.iter().any(|part| part == krate) || code.contains(&format!("mod {krate};"));
            if named
                && !own_name
                && !places
                    .iter()
                    .any(|place| file == place || file.starts_with(&format!("{place}/")))
            {
                offences.push(format!("{file} names the crate {krate}"));
            }
        }
    }
    offences
}

#[test]
fn layers_dependencies_point_one_way() {
    let mut all = Vec::new();
    for (krate, table) in [
        ("engine", &ENGINE[..]),
        ("contract", &CONTRACT[..]),
        ("server", &SERVER[..]),
    ] {
        let sources = CrateSources::of(krate);
        assert!(
            sources.files.len() > 40,
            "{} files of {krate}",
            sources.files.len()
        );
        all.extend([offences(&sources, table), forbidden_crates(&sources)].concat());
        all.extend(
            cycles(&sources)
                .into_iter()
                .map(|module| format!("{krate}: {module} is part of a cycle of files")),
        );
    }
    assert!(all.is_empty(), "{}", all.join("\n"));
}

/// The test itself: a wrong dependency is seen however it is written.
#[test]
fn layers_wrong_dependencies_are_seen() {
    let files = |files: &[(&str, &str)]| CrateSources {
        files: files
            .iter()
            .map(|(file, text)| {
                (
                    module(Path::new(file)),
                    (format!("engine/{file}"), code(text)),
                )
            })
            .collect(),
    };
    let one = |file: &str, text: &str| {
        let mut all: Vec<(&str, &str)> = ENGINE
            .iter()
            .map(|(name, _)| (*name, ""))
            .chain([(file, text)])
            .collect();
        let folders: Vec<String> = all
            .iter()
            .map(|(name, _)| format!("{}.rs", name.trim_end_matches(".rs")))
            .collect();
        all.iter_mut()
            .zip(&folders)
            .for_each(|((name, _), file)| *name = file);
        let sources = files(&all);
        !offences(&sources, &ENGINE).is_empty() || !forbidden_crates(&sources).is_empty()
    };
    assert!(one(
        "deform/coefficient_table.rs",
        "use crate::render::Filter;"
    ));
    assert!(one(
        "deform/kernel/scalar.rs",
        "use super::super::super::codec::Limits;"
    ));
    assert!(one(
        "codec/decode.rs",
        "use crate::{pixmap::Extent, deform::Handle};"
    ));
    assert!(one(
        "geometry/grid.rs",
        "fn f() { crate::warp::Digest::of(b\"\"); }"
    ));
    assert!(
        one("new/part.rs", ""),
        "a module that the table does not list"
    );
    assert!(one("warp/resolved_rest.rs", "use tokio::sync::Notify;"));
    assert!(!one(
        "deform/coefficient_table.rs",
        "use super::rest_deformation::RestDeformation; use crate::geometry::Grid; // crate::render"
    ));
    let circle = files(&[
        ("a/x.rs", "use super::y::Y;"),
        ("a/y.rs", "use crate::a::z::{self, Z};"),
        ("a/z.rs", "fn f() { super::x::f() }"),
        ("a.rs", ""),
    ]);
    assert_eq!(cycles(&circle), ["a::x", "a::y", "a::z"]);
    assert!(
        cycles(&files(&[
            ("a.rs", "use self::x::X;"),
            ("a/x.rs", "use super::Y;")
        ]))
        .is_empty(),
        "a module and its child"
    );
}
