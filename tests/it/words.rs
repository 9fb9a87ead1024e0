//! One word for one thing: what ARCHITECTURE.md's glossary has replaced does not come back in code.
//! Comments and texts are not looked at: `contradictory_handles` is a word of the contract.

use std::collections::BTreeSet;
use std::path::Path;

use crate::module_dependencies::sources;

/// Names that nothing may be defined by: they say nothing to a reader who has not seen the rest, or
/// the glossary has a better one.
const REPLACED: [&str; 51] = [
    // Types.
    "Answer",
    "Compact",
    "Contradiction",
    "Contradictory",
    "Deformation",
    "Drawer",
    "ExactRows",
    "Field",
    "Figures",
    "FineCells",
    "Form",
    "Kept",
    "Lattice",
    "Posed",
    "Purpose",
    "Refined",
    "Refinement",
    "Refiner",
    "Rows",
    "Saddle",
    "Setup",
    "Shown",
    "Sources",
    "Span",
    "Subject",
    // Functions.
    "approximated",
    "given",
    "is_here",
    "is_wide",
    "known",
    "look_at_handles",
    "of_squares",
    "pays",
    // Constants without a noun or a unit.
    "APART",
    "BESIDE",
    "DEEPEST",
    "FAR",
    "FARTHEST",
    "FEW",
    "LEAST",
    "LONG",
    "LONGEST",
    "MANY",
    "MARGIN",
    "MOST",
    "NEAR",
    "PAUSE",
    "RETRY",
    "SHORT",
    "STEPS",
    "SUSPECT",
];
/// Words that have no other meaning and stand in no name, with what to write instead.
const NO_WORDS: [(&str, &str); 7] = [
    ("contradiction", "conflict"),
    ("contradictions", "conflicts"),
    ("desk", "the name of what it is"),
    ("refined", "subdivided"),
    ("refinement", "subdivision"),
    ("saddle", "system"),
    ("waist", "the name of what it is"),
];
/// Outlines of annotations are refined, as the contract calls it.
const OUTLINES: [&str; 6] = [
    "engine/warp/transform",
    "server/app/points.rs",
    "contract/wire/annotations",
    "contract/wire/batch",
    "contract/wire/tests/points.rs",
    "tests",
];

/// Code without comments and texts.
pub(crate) fn code(text: &str) -> String {
    let mut found = String::with_capacity(text.len());
    for line in text.lines() {
        let line = line.split("//").next().unwrap_or_default();
        // Every second part is a text; one that has quotes or several lines is looked at in part.
        for part in line.split('"').step_by(2) {
            found.push_str(part);
            found.push(' ');
        }
        found.push('\n');
    }
    found
}

pub(crate) fn is_part_of_name(c: char) -> bool {
    c.is_alphanumeric() || c == '_'
}

/// The replaced names that a file defines.
fn replaced(code: &str) -> BTreeSet<String> {
    let words: Vec<&str> = code
        .split(|c| !is_part_of_name(c))
        .filter(|word| !word.is_empty())
        .collect();
    let defines = ["struct", "enum", "trait", "type", "fn", "const", "static"];
    words
        .windows(2)
        .filter(|pair| defines.contains(&pair[0]) && REPLACED.contains(&pair[1]))
        .map(|pair| pair[1].to_owned())
        .collect()
}

/// The parts of a name, in lower case: `RefinedCell` has `refined` and `cell`.
fn parts(name: &str) -> Vec<String> {
    let mut parts = vec![String::new()];
    let mut was_lower = false;
    for c in name.chars() {
        if c == '_' || (c.is_uppercase() && was_lower) {
            parts.push(String::new());
        }
        was_lower = c.is_lowercase();
        if c != '_' {
            parts.last_mut().unwrap().extend(c.to_lowercase());
        }
    }
    parts
}

/// The names with a word that has no other meaning.
fn forbidden(code: &str) -> BTreeSet<String> {
    code.split(|c| !is_part_of_name(c))
        .filter_map(|name| {
            let parts = parts(name);
            let (word, better) = NO_WORDS
                .iter()
                .find(|(word, _)| parts.iter().any(|part| part == word))?;
            Some(format!("{name}: {better} instead of {word}"))
        })
        .collect()
}

#[test]
fn words_that_were_replaced_do_not_come_back() {
    let root = Path::new(env!("CARGO_MANIFEST_DIR")).join("../..");
    let mut files = Vec::new();
    for folder in [
        "src/engine",
        "src/contract",
        "src/server",
        "tests/it",
        "tests/bench",
    ] {
        sources(&root.join(folder), &mut files);
    }
    assert!(files.len() > 400, "{} files", files.len());
    let mut found = Vec::new();
    for file in files {
        let name = file.strip_prefix(&root).unwrap().display().to_string();
        let code = code(&std::fs::read_to_string(&file).unwrap());
        found.extend(
            replaced(&code)
                .into_iter()
                .map(|word| format!("{name} defines {word}")),
        );
        let place = name.strip_prefix("src/").unwrap_or(&name);
        if !OUTLINES.iter().any(|outline| place.starts_with(outline)) {
            found.extend(
                forbidden(&code)
                    .into_iter()
                    .map(|word| format!("{name} has {word}")),
            );
        }
    }
    assert!(found.is_empty(), "{}", found.join("\n"));
}

/// The test itself.
#[test]
fn words_are_seen_where_they_are_defined_and_in_all_forms() {
    assert_eq!(replaced("pub(super) struct Field<'a> {}").len(), 1);
    assert_eq!(
        replaced("const NEAR: f64 = 1.0;\nfn pays(&self) {}").len(),
        2
    );
    assert!(replaced("At::Field(parent, name)").is_empty());
    assert!(replaced(&code("/// The struct Field.\nlet text = \"fn pays\";")).is_empty());
    for name in ["RefinedCell", "is_refined", "REFINED_BYTES", "refined"] {
        assert_eq!(forbidden(name).len(), 1, "{name}");
    }
    assert!(forbidden("refinery, contradictory").is_empty());
}

/// The glossary has the words that stand in the code.
#[test]
fn words_of_the_glossary_are_those_of_the_code() {
    let root = Path::new(env!("CARGO_MANIFEST_DIR")).join("../..");
    let page = std::fs::read_to_string(root.join("ARCHITECTURE.md")).unwrap();
    let (_, glossary) = page.split_once("\n## Glossary\n").expect("a glossary");
    let mut files = Vec::new();
    sources(&root.join("src"), &mut files);
    let all: String = files
        .iter()
        .map(|file| code(&std::fs::read_to_string(file).unwrap()))
        .collect();
    let names: BTreeSet<&str> = all.split(|c| !is_part_of_name(c)).collect();
    let types: Vec<&str> = glossary
        .split('`')
        .skip(1)
        .step_by(2)
        .filter(|name| name.starts_with(char::is_uppercase) && name.chars().all(is_part_of_name))
        .collect();
    assert!(types.len() > 20, "{types:?}");
    let missing: Vec<_> = types.iter().filter(|name| !names.contains(*name)).collect();
    assert!(
        missing.is_empty(),
        "the glossary has {missing:?}, the code has not"
    );
}
