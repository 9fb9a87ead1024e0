//! Lines of words that white space separates.

use super::SourceText;
use super::bad::Bad;
use super::collect::Located;
use crate::problem::words::quote;

/// The longest line, bytes: many times that of a contour of as many points as there may be columns.
const LONGEST_LINE: usize = 1 << 20;

/// The next line of a text, and its bytes with its end: LF, CR or both.
/// Errors: A line that is too long; cancelled.
pub(super) fn line_at<'t>(source: SourceText<'t>, at: usize) -> Result<(&'t str, usize), Bad> {
    let rest = &source.text.as_bytes()[at..];
    let longest = &rest[..rest.len().min(LONGEST_LINE + 1)];
    let length = source
        .work
        .find(longest, |byte| matches!(byte, b'\n' | b'\r'));
    // Lines that say nothing would be read to the end of the file: an error ends every reader, and
    // `LandmarkFiles` says what it means.
    if source.work.is_stopped() {
        return Err(Bad::new(at, "nobody wants the result"));
    }
    if length > LONGEST_LINE {
        let detail = format!("expected a line of at most {LONGEST_LINE} bytes; found a longer one");
        return Err(Bad::new(at, detail));
    }
    let end = match rest[length..] {
        [b'\r', b'\n', ..] => 2,
        [] => 0,
        _ => 1,
    };
    Ok((&source.text[at..at + length], length + end))
}

/// The lines of a text that are not empty; those that begin with `#` are comments if the format has
/// them.
pub(super) struct Lines<'t> {
    source: SourceText<'t>,
    at: usize,
    has_comments: bool,
}

impl<'t> Lines<'t> {
    pub(super) fn new(source: SourceText<'t>, has_comments: bool) -> Self {
        Self {
            source,
            at: source.start,
            has_comments,
        }
    }

    /// The next line, trimmed.
    /// Errors: The end of the file, where `expected` describes the line.
    pub(super) fn line(&mut self, expected: &str) -> Result<Located<'t>, Bad> {
        self.next_line()?.ok_or_else(|| {
            Bad::new(
                self.at,
                format!("expected {expected}; found the end of the file"),
            )
        })
    }

    /// The next line, trimmed, unless the file ends.
    pub(super) fn next_line(&mut self) -> Result<Option<Located<'t>>, Bad> {
        while self.at < self.source.text.len() {
            let (line, length) = line_at(self.source, self.at)?;
            let start = self.at;
            self.at += length;
            let text = line.trim();
            if !(text.is_empty() || self.has_comments && text.starts_with('#')) {
                return Ok(Some(Located {
                    at: start + (line.len() - line.trim_start().len()),
                    text,
                }));
            }
        }
        Ok(None)
    }

    /// Errors: Something other than the end of the file.
    pub(super) fn end(&mut self) -> Result<(), Bad> {
        match self.next_line()? {
            Some(line) => Err(Bad::new(
                line.at,
                format!("expected the end of the file; found {}", quote(line.text)),
            )),
            None => Ok(()),
        }
    }

    /// Where the next line begins, bytes.
    pub(super) fn position(&self) -> usize {
        self.at
    }
}

impl<'t> Located<'t> {
    /// The words of a line.
    pub(super) fn words(self) -> impl Iterator<Item = Located<'t>> {
        let line = self;
        line.text.split_whitespace().map(move |word| Located {
            at: line.at + (word.as_ptr().addr() - line.text.as_ptr().addr()),
            text: word,
        })
    }

    /// A line of two numbers.
    pub(super) fn place(self) -> Result<[f64; 2], Bad> {
        let mut words = self.words();
        let (x, y, more) = (words.next(), words.next(), words.next());
        match (x, y, more) {
            (Some(x), Some(y), None) => Ok([x.number()?, y.number()?]),
            (.., Some(more)) => Err(Bad::new(
                more.at,
                format!(
                    "expected 2 numbers in a line; found a third, {}",
                    quote(more.text)
                ),
            )),
            _ => Err(Bad::new(
                self.at,
                format!("expected 2 numbers in a line; found {}", quote(self.text)),
            )),
        }
    }

    /// A line or word that is a whole number.
    pub(super) fn whole(self, expected: &str) -> Result<usize, Bad> {
        self.text.parse().map_err(|_| {
            Bad::new(
                self.at,
                format!(
                    "expected {expected}, a whole number; found {}",
                    quote(self.text)
                ),
            )
        })
    }
}
