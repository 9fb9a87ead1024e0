//! Landmark files: points and lines that other programs have written, read as handles.
//!
//! The format is recognised by content. Each format has a file of its own, which states its convention and where that is described, and
//! converts to the coordinates of the contract (`x` right, `y` down, the centre of the first pixel at 1/2, 1/2). Every error has a line and
//! a column. The work is linear in the length of the file, counted, and stops when it is cancelled; the number of handles is limited
//! before memory is allocated for them.

mod bad;
mod bigwarp;
mod collect;
mod csv;
mod files;
mod labelme;
mod normalized;
mod own;
mod pairs;
mod pts;
mod qgis;
mod table;
mod tem;
mod words;

#[cfg(test)]
mod tests;

use bad::Bad;
use collect::Collector;
pub use files::{LandmarkFiles, Landmarks, UNMATCHED, extent};
use mlswarp::deform::Handle;
use mlswarp::warp::Units;
use pairs::Unmatched;

use super::json::{Kind, Node};
use super::work::Work;
use crate::problem::words::quote;

const FORMATS: &str = "JSON, CSV, BigWarp CSV, ibug .pts, WebMorph .tem, MediaPipe, ARKit, labelme, QGIS .points";

/// What one file holds.
#[derive(Debug)]
struct File {
    p: Vec<Handle>,
    q: Option<Vec<Handle>>,
    /// All handles have names, or none has: where each is in the file, bytes, and its text. Names may be repeated.
    names: Option<Vec<(usize, String)>>,
    /// Where each handle is in the file, bytes.
    at: Vec<usize>,
    units: Units,
    format: &'static str,
    /// Names of landmarks that the file gives for one side only.
    unmatched: Unmatched,
}

/// The text of a file, and the work of reading it.
#[derive(Clone, Copy)]
struct Source<'t> {
    text: &'t str,
    /// Where it begins, bytes: a byte order mark counts for offsets but belongs to no column.
    start: usize,
    work: &'t Work<'t>,
}

/// Reads one file. Once the work is cancelled, the result is wrong.
fn read(bytes: &[u8], max_columns: usize, work: &Work<'_>) -> Result<File, Bad> {
    if bytes.starts_with(b"\xff\xfe") || bytes.starts_with(b"\xfe\xff") {
        return Err(Bad::new(0, "expected UTF-8; found UTF-16: save the file as UTF-8"));
    }
    let text = work.text(bytes);
    if let Some(byte) = bytes.get(text.len()).filter(|_| !tem::is_tem(first_line(text))) {
        return Err(Bad::new(text.len(), format!("expected text in UTF-8; found the byte 0x{byte:02x}")));
    }
    let zero = work.find(text.as_bytes(), |byte| byte == 0);
    if zero < text.len() {
        return Err(Bad::new(zero, "expected text; found a zero byte"));
    }
    let out = Collector::new(max_columns);
    let start = if text.starts_with('\u{feff}') { '\u{feff}'.len_utf8() } else { 0 };
    let source = Source { text, start, work };
    let before = work.find(&text.as_bytes()[start..], |byte| !byte.is_ascii_whitespace());
    let content = text[start + before..].trim_start();
    let first = first_line(content);
    match content.as_bytes().first() {
        None => Err(Bad::new(start, "expected landmarks; the file is empty")),
        Some(b'{' | b'[') => read_json(source, text.len() - content.len(), out),
        _ if pts::is_pts(first) => pts::read(source, out),
        _ if tem::is_tem(first) => tem::read(source, out),
        _ => read_table(source, out),
    }
}

/// The beginning of the first line that is neither empty nor a comment, among the first ones.
fn first_line(text: &str) -> &str {
    const LONGEST_HEAD: usize = 1 << 16;
    let head = &text[..text.floor_char_boundary(LONGEST_HEAD)];
    head.split(['\n', '\r']).find(|line| !line.trim().is_empty() && !line.starts_with('#')).unwrap_or_default().trim()
}

fn read_json(source: Source<'_>, start: usize, out: Collector) -> Result<File, Bad> {
    let text = source.text;
    let node = super::json::long_value(&text[start..], source.work).map_err(|e| Bad::of_syntax(text, start, &e))?;
    let read = match node.kind() {
        Kind::Object => match node.find(&["shapes", "p", "q"]) {
            Ok([Some(_), ..]) => labelme::read(text, &node, out),
            Ok([None, None, None]) => normalized::read(text, &node, out),
            Ok(_) => own::read(text, &node, out),
            Err(problem) => Err(problem.into()),
        },
        _ => normalized::read(text, &node, out),
    };
    read.map_err(|wrong| wrong.locate(text, &node))
}

fn read_table(source: Source<'_>, out: Collector) -> Result<File, Bad> {
    let mut rows = table::Rows::new(source)?;
    let Some(first) = rows.next_row()? else {
        return Err(Bad::new(source.start, "expected landmarks; the file has comments only"));
    };
    if bigwarp::is_bigwarp(&first) {
        return bigwarp::read(first, rows, out);
    }
    if qgis::is_qgis(&first) {
        return qgis::read(&first, rows, out);
    }
    if let [only] = &first.fields[..] {
        return Err(Bad::new(only.at, format!("expected a landmark file ({FORMATS}); found {}", quote(&only.text))));
    }
    csv::read(first, rows, out)
}

/// Where in `text` a part of it begins. Nodes of JSON are parts of the text.
fn offset(text: &str, node: &Node<'_, '_>) -> usize {
    node.text.as_ptr().addr().saturating_sub(text.as_ptr().addr()).min(text.len())
}
