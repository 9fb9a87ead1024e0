//! What comments and notes cite exists: sections of `src/engine/MATHEMATICS.md`, and files of the
//! repository.

use std::collections::BTreeSet;
use std::path::{Path, PathBuf};

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
