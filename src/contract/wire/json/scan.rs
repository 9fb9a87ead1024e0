//! Where the values of well-formed JSON text begin and end. Long texts are scanned piece by piece,
//! so that the work is counted, and ends when it is cancelled.

use std::ops::Range;

use crate::wire::work::{BYTES_PER_CHECK, Work};

/// Cuts the next value or field name off the inside of a well-formed array or object; `None` at its
/// end, or when the work is cancelled.
pub(super) fn next<'j>(rest: &mut &'j str, work: Option<&Work<'_>>) -> Option<&'j str> {
    let range = next_value(rest.as_bytes(), 0, work)?;
    let (value, after) = (rest.get(range.clone())?, rest.get(range.end..)?);
    *rest = after;
    Some(value)
}

/// Where the next value or field name is in the inside of a well-formed array or object, from a
/// byte between two of them on; `None` at its end, or when the work is cancelled.
pub(crate) fn next_value(
    text: &[u8],
    from: usize,
    work: Option<&Work<'_>>,
) -> Option<Range<usize>> {
    let bytes = text.get(from..)?;
    let is_between = |b: &u8| matches!(b, b' ' | b'\t' | b'\n' | b'\r' | b',' | b':');
    let start = match work {
        Some(work) => work.find(bytes, |b| !is_between(&b)),
        None => bytes.iter().take_while(|b| is_between(b)).count(),
    };
    if matches!(bytes[start..], [] | [b']' | b'}', ..]) {
        return None;
    }
    let length = length(&bytes[start..], work);
    let is_whole = length > 0 && !work.is_some_and(Work::is_stopped);
    is_whole.then_some(from + start..from + start + length)
}

/// The length of the value at the start of a well-formed text; wrong once the work is cancelled.
fn length(text: &[u8], work: Option<&Work<'_>>) -> usize {
    let mut value = Scan::default();
    let Some(work) = work else {
        return value.end(text).unwrap_or(text.len());
    };
    let mut before = 0;
    for piece in text.chunks(BYTES_PER_CHECK) {
        let end = value.end(piece);
        before += end.unwrap_or(piece.len());
        if !work.add(end.unwrap_or(piece.len())) || end.is_some() {
            break;
        }
    }
    before
}

/// Whether a byte neither begins nor ends anything, wherever it stands.
const IS_PLAIN: [bool; 256] = {
    let mut is_plain = [true; 256];
    let marks = b"\"\\[]{}, \t\n\r";
    let mut k = 0;
    while k < marks.len() {
        is_plain[marks[k] as usize] = false;
        k += 1;
    }
    is_plain
};

/// What is known of a value after some pieces of its text.
#[derive(Default)]
struct Scan {
    depth: usize,
    is_in_string: bool,
    is_escaped: bool,
}

impl Scan {
    /// The bytes of the next piece that belong to the value, if it ends there.
    fn end(&mut self, piece: &[u8]) -> Option<usize> {
        for (at, byte) in piece.iter().enumerate() {
            // Most bytes are digits and letters: one look each.
            if IS_PLAIN[usize::from(*byte)] {
                self.is_escaped = false;
                continue;
            }
            match byte {
                _ if self.is_escaped => self.is_escaped = false,
                b'"' => {
                    self.is_in_string = !self.is_in_string;
                    if !self.is_in_string && self.depth == 0 {
                        return Some(at + 1);
                    }
                }
                b'\\' => self.is_escaped = self.is_in_string,
                _ if self.is_in_string => {}
                b'[' | b'{' => self.depth += 1,
                // The end of a number, `true`, `false` or `null`.
                b',' | b']' | b'}' | b' ' | b'\t' | b'\n' | b'\r' if self.depth == 0 => {
                    return Some(at);
                }
                b']' | b'}' => {
                    self.depth -= 1;
                    if self.depth == 0 {
                        return Some(at + 1);
                    }
                }
                _ => {}
            }
        }
        None
    }
}
