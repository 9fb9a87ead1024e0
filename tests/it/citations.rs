//! What comments and notes cite exists: sections of `src/engine/MATHEMATICS.md`, files of the
//! repository, and functions and variants of types.

use std::collections::{BTreeSet, HashMap, HashSet};
use std::path::{Path, PathBuf};

use crate::module_dependencies::sources;
use crate::words::{code, is_part_of_name};

const ROOT: &str = concat!(env!("CARGO_MANIFEST_DIR"), "/../..");

/// Files with one of these endings below `src`, `tests`, `api` and `deploy`, and those at the top.
fn texts(endings: &[&str]) -> Vec<(PathBuf, String)> {
    fn add(folder: &Path, endings: &[&str], found: &mut Vec<(PathBuf, String)>) {
        for entry in std::fs::read_dir(folder).unwrap() {
            let path = entry.unwrap().path();
            let name = path.file_name().unwrap().to_str().unwrap();
            if path.is_dir() && !["artefacts", "target", "node_modules"].contains(&name) {
                add(&path, endings, found);
            } else if endings.iter().any(|ending| name.ends_with(ending)) {
                found.push((path.clone(), std::fs::read_to_string(&path).unwrap()));
            }
        }
    }
    let mut found = Vec::new();
    for folder in ["src", "tests", "api", "deploy"] {
        add(&Path::new(ROOT).join(folder), endings, &mut found);
    }
    for name in [
        "README.md",
        "CHANGELOG.md",
        "ARCHITECTURE.md",
        "CONTRIBUTING.md",
        "RELEASING.md",
        "SECURITY.md",
    ] {
        let path = Path::new(ROOT).join(name);
        found.push((path.clone(), std::fs::read_to_string(path).unwrap()));
    }
    found
}

/// The numbers at the beginning of the headings: `## 2. Points`, `### 2.1 The problem`.
fn sections(book: &str) -> BTreeSet<String> {
    let headings = book.lines().filter_map(|line| {
        line.strip_prefix("## ")
            .or_else(|| line.strip_prefix("### "))
    });
    headings.filter_map(number).collect()
}

/// A section number in front of a text: `7.1`.
fn number(text: &str) -> Option<String> {
    let end = text
        .find(|c: char| !c.is_ascii_digit() && c != '.')
        .unwrap_or(text.len());
    let number = text[..end].trim_end_matches('.');
    (!number.is_empty()).then(|| number.to_owned())
}

/// The sections that a text cites: "mathematics 7.1", "mathematics section 12", "mathematics
/// sections 2.4, 3.4 and 6".
fn cited(text: &str) -> Vec<String> {
    let mut cited = Vec::new();
    // A citation may be divided by the end of a line of a comment.
    let text = text
        .lines()
        .map(|line| line.trim_start().trim_start_matches(['/', '!', '#']))
        .collect::<Vec<_>>()
        .join(" ");
    let text = text.split_whitespace().collect::<Vec<_>>().join(" ");
    for (at, word) in text.to_lowercase().match_indices("mathematics ") {
        let mut rest = &text[at + word.len()..];
        for word in ["sections ", "section "] {
            rest = rest.strip_prefix(word).unwrap_or(rest);
        }
        while let Some(section) = number(rest) {
            rest = &rest[section.len()..];
            cited.push(section);
            rest = [", ", " and "]
                .iter()
                .find_map(|word| rest.strip_prefix(word))
                .unwrap_or("");
        }
    }
    cited
}

#[test]
fn citations_of_the_mathematics_name_sections_that_exist() {
    let book = std::fs::read_to_string(Path::new(ROOT).join("src/engine/MATHEMATICS.md")).unwrap();
    let known = sections(&book);
    assert!(
        ["2.3", "3.2", "7.1", "12"]
            .iter()
            .all(|section| known.contains(*section)),
        "{known:?}"
    );
    let mut count = 0;
    for (path, text) in texts(&[".rs", ".md"]) {
        for section in cited(&text) {
            count += 1;
            assert!(
                known.contains(&section),
                "{}: mathematics {section} does not exist",
                path.display()
            );
        }
    }
    assert!(count > 20, "{count} citations");
    // The book itself: "section 3.2", "sections 2.4 and 3.4".
    let inner = book
        .replace("section ", "mathematics section ")
        .replace("sections ", "mathematics sections ");
    for section in cited(&inner) {
        assert!(
            known.contains(&section),
            "MATHEMATICS.md: section {section} does not exist"
        );
    }
}

#[test]
fn citations_are_found_in_all_their_forms() {
    let text = "/// a (mathematics\n    /// 7.1), mathematics section 12, step 2; mathematics \
        sections 2.4, 3.4 and 6. The mathematics of 5";
    assert_eq!(cited(text), ["7.1", "12", "2.4", "3.4", "6"]);
    assert_eq!(
        sections("# T\n## 2. Points\n### 2.1 The problem\ntext\n## Appendix"),
        ["2", "2.1"].map(str::to_owned).into()
    );
}

/// Links of documents, `[text](path)`.
#[test]
fn links_between_documents_lead_to_files() {
    let mut count = 0;
    for (path, text) in texts(&[".md"]) {
        for (at, _) in text.match_indices("](") {
            let target = text[at + 2..].split([')', '#']).next().unwrap();
            if target.is_empty() || target.contains("://") || target.contains(char::is_whitespace) {
                continue;
            }
            count += 1;
            assert!(
                path.parent().unwrap().join(target).exists(),
                "{}: {target} does not exist",
                path.display()
            );
        }
    }
    assert!(count > 50, "{count} links");
}

/// Lines move; and documents that are not in the repository cannot be read.
#[test]
fn nothing_cites_a_line_of_a_file_or_an_unknown_document() {
    let own = Path::new(file!()).file_name().unwrap();
    for (path, text) in texts(&[".rs", ".md", ".py", ".js", ".toml"]) {
        if path.file_name() == Some(own) {
            continue;
        }
        for (number, line) in (1..).zip(text.lines()) {
            let cites_line = [".md:", ".rs:"].iter().any(|ending| {
                line.match_indices(ending).any(|(at, _)| {
                    line[at + ending.len()..].starts_with(|c: char| c.is_ascii_digit())
                })
            });
            assert!(
                !cites_line && !line.contains("api.md"),
                "{}:{number}: {line}",
                path.display()
            );
        }
    }
}

/// The names in a text.
fn names(text: &str) -> impl Iterator<Item = &str> {
    text.split(|c| !is_part_of_name(c))
        .filter(|name| !name.is_empty())
}

/// What a line of code defines or implements: `impl Tree for Oak` is said of both.
fn defined(line: &str) -> Vec<&str> {
    let words: Vec<&str> = names(line).collect();
    if words.iter().take(2).any(|word| *word == "impl") {
        return words;
    }
    let defines = ["struct", "enum", "trait", "type", "union", "mod"];
    words
        .windows(2)
        .filter(|pair| defines.contains(&pair[0]))
        .map(|pair| pair[1])
        .collect()
}

/// The last two names of each path in backticks in a comment: of `Oak::leaf`, `Oak` and `leaf`.
fn cited_members(line: &str) -> Vec<(&str, &str)> {
    let Some((_, comment)) = line.split_once("//") else {
        return Vec::new();
    };
    let paths = comment.split('`').skip(1).step_by(2);
    let pairs = paths.filter_map(|path| {
        let path = path.split('(').next()?;
        let (owner, member) = path.rsplit_once("::")?;
        let owner = owner.rsplit("::").next()?;
        let is_path = [owner, member]
            .iter()
            .all(|name| !name.is_empty() && name.chars().all(is_part_of_name));
        (is_path && owner.starts_with(char::is_uppercase)).then_some((owner, member))
    });
    pairs.collect()
}

/// `Type::function` and `Enum::Variant` of comments stand in a file that defines or implements the
/// type, or, if the type is another crate's, in one that names it.
#[test]
fn citations_of_functions_and_variants_name_what_exists() {
    let mut files = Vec::new();
    for folder in ["src", "tests/it", "tests/fuzz", "api/python/src"] {
        sources(&Path::new(ROOT).join(folder), &mut files);
    }
    let texts: Vec<(PathBuf, String, String)> = files
        .into_iter()
        .map(|path| {
            let text = std::fs::read_to_string(&path).unwrap();
            let code = code(&text);
            (path, text, code)
        })
        .collect();
    let known: Vec<HashSet<&str>> = texts
        .iter()
        .map(|(_, _, code)| names(code).collect())
        .collect();
    let mut homes: HashMap<&str, Vec<usize>> = HashMap::new();
    for (at, (_, _, code)) in texts.iter().enumerate() {
        for name in code.lines().flat_map(defined) {
            homes.entry(name).or_default().push(at);
        }
    }
    let (mut count, mut missing) = (0, Vec::new());
    for (at, (path, text, _)) in texts.iter().enumerate() {
        // This file makes some up.
        if path.ends_with("tests/it/citations.rs") {
            continue;
        }
        for (number, line) in (1..).zip(text.lines()) {
            for (owner, member) in cited_members(line) {
                count += 1;
                let exists = match homes.get(owner) {
                    _ if owner == "Self" => known[at].contains(member),
                    Some(homes) => homes.iter().any(|home| known[*home].contains(member)),
                    None => known
                        .iter()
                        .any(|names| names.contains(owner) && names.contains(member)),
                };
                if !exists {
                    missing.push(format!("{}:{number}: {owner}::{member}", path.display()));
                }
            }
        }
    }
    assert!(count > 200, "{count} citations");
    assert!(
        missing.is_empty(),
        "comments name what does not exist:\n{}",
        missing.join("\n")
    );
}

#[test]
fn citations_of_functions_are_found_in_all_their_forms() {
    let line = "x(); // See [`tree::Oak::leaf`], `Oak::of(a, b)`, `vec::new`, `Oak` and `Ash::`.";
    assert_eq!(cited_members(line), [("Oak", "leaf"), ("Oak", "of")]);
    assert!(cited_members("let path = tree::Oak::leaf;").is_empty());
    assert_eq!(defined("pub(crate) struct Oak<T>(T);"), ["Oak"]);
    assert!(defined("impl<T> Tree for Oak<T> {").contains(&"Oak"));
    assert!(defined("let oak = Oak::new();").is_empty());
}

/// What a release is made from: `deploy/release` refuses a version without a dated heading.
#[test]
fn changelog_has_the_version_of_the_crates() {
    let log = std::fs::read_to_string(Path::new(ROOT).join("CHANGELOG.md")).unwrap();
    let heading = format!("## [{}] - 2", env!("CARGO_PKG_VERSION"));
    assert!(
        log.lines().any(|line| line.starts_with(&heading)),
        "CHANGELOG.md: {heading}..."
    );
    for (version, text) in log
        .split("\n## ")
        .skip(1)
        .filter_map(|section| section.split_once('\n'))
    {
        assert!(
            text.lines().count() <= 60,
            "{version} has more than 60 lines: what a user gets, no history of its making"
        );
    }
}
