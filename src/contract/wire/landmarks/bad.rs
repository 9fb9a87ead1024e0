//! What is wrong with a landmark file, and where.

use serde_json::Error as SyntaxError;

use super::offset;
use crate::problem::{Code, Problem};
use crate::wire::json::Node;
use crate::wire::syntax;

/// An error at a byte of the file.
#[derive(Debug)]
pub(super) struct Bad {
    at: usize,
    detail: String,
    /// The limit of columns, if that is exceeded.
    limit: Option<usize>,
    /// The names of the first items of the file, if one is to be chosen, and how many it has.
    items: Option<(Vec<Vec<String>>, usize)>,
}

/// An error in JSON: at a byte, or at a JSON pointer.
pub(super) enum BadJson {
    Located(Bad),
    Pointed(Box<Problem>),
}

impl Bad {
    pub(super) fn new(at: usize, detail: impl Into<String>) -> Self {
        Self {
            at,
            detail: detail.into(),
            limit: None,
            items: None,
        }
    }

    /// With the names of the first items, of `count`.
    pub(super) fn items(self, names: Vec<Vec<String>>, count: usize) -> Self {
        let items = Some((names, count)).filter(|_| count > 0);
        Self { items, ..self }
    }

    /// More handles than the limit of columns.
    pub(super) fn too_many(at: usize, limit: usize) -> Self {
        Self {
            limit: Some(limit),
            ..Self::new(
                at,
                format!(
                    "the landmarks have more than {limit} columns (1 per point, 2 per segment)"
                ),
            )
        }
    }

    /// An error of JSON syntax in `text`, which begins at `start`; serde counts lines and bytes
    /// from 1.
    pub(super) fn of_syntax(text: &str, start: usize, error: &SyntaxError) -> Self {
        let lines = text[start..]
            .split_inclusive('\n')
            .take(error.line().saturating_sub(1));
        let line_start: usize = start + lines.map(str::len).sum::<usize>();
        let mut detail = error.to_string();
        // The position follows in our own words.
        detail.truncate(detail.rfind(" at line ").unwrap_or(detail.len()));
        let at = (line_start + error.column().saturating_sub(1)).min(text.len());
        Self::new(
            at,
            format!("not JSON: {detail}{}", syntax::hint(&text[start..], error)),
        )
    }

    /// The problem document. `part`: the name of the part or file; `file`: its content.
    pub(super) fn problem(self, part: &str, file: &[u8]) -> Problem {
        let before = &file[..self.at.min(file.len())];
        // A line ends with LF, CR or both.
        let ends = |(at, byte): (usize, &u8)| {
            *byte == b'\n' || *byte == b'\r' && file.get(at + 1) != Some(&b'\n')
        };
        let line_start = before
            .iter()
            .enumerate()
            .rposition(ends)
            .map_or(0, |end| end + 1);
        let line = 1 + before[..line_start]
            .iter()
            .enumerate()
            .filter(|end| ends(*end))
            .count();
        let in_line = before[line_start..]
            .strip_prefix("\u{feff}".as_bytes())
            .unwrap_or(&before[line_start..]);
        // Characters: bytes that do not continue one.
        let column = 1 + in_line.iter().filter(|byte| **byte & 0xc0 != 0x80).count();
        let detail = format!("{part}, line {line}, column {column}: {}", self.detail);
        let problem = match self.limit {
            Some(limit) => {
                Problem::new(Code::TooLarge, detail).limit("handle_columns", limit, limit + 1)
            }
            None => Problem::new(Code::BadLandmarks, detail),
        };
        let problem = problem.extra("line", line).extra("column", column);
        match self.items {
            None => problem,
            Some((names, count)) => problem.extra("items", names).extra("item_count", count),
        }
    }
}

impl BadJson {
    /// Finds a JSON pointer in the text.
    pub(super) fn locate(self, text: &str, root: &Node<'_, '_>) -> Bad {
        match self {
            Self::Located(bad) => bad,
            Self::Pointed(problem) => {
                let at = root.resolve(problem.pointer.as_deref().unwrap_or_default(), |node| {
                    offset(text, node)
                });
                Bad::new(at, problem.detail)
            }
        }
    }
}

impl From<Bad> for BadJson {
    fn from(bad: Bad) -> Self {
        Self::Located(bad)
    }
}

impl From<Problem> for BadJson {
    fn from(problem: Problem) -> Self {
        Self::Pointed(Box::new(problem))
    }
}
