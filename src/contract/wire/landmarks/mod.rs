//! Landmark files: points and lines that other programs have written, read as handles.
//!
//! The format is recognised by content. Each format has a file of its own, which states its
//! convention and where that is described, and converts to the coordinates of the contract (`x`
//! right, `y` down, the centre of the first pixel at 1/2, 1/2); [`FORMATS`] has a row for it. Every
//! error has a line and a column. The work is linear in the length of the file, counted, and stops
//! when it is cancelled; the number of handles is limited before memory is allocated for them.

mod bad;
mod bigwarp;
mod bigwarp_json;
mod coco;
mod collect;
mod csv;
mod cvat;
mod deeplabcut;
mod dlib;
mod elastix;
mod fields;
mod files;
mod iiif;
mod item;
mod json;
mod labelme;
mod napari;
mod normalized;
mod openface;
mod own;
mod pairs;
mod pts;
mod qgis;
mod slicer;
mod table;
mod tem;
mod tps;
mod words;
mod xml;

#[cfg(test)]
mod tests;

use bad::{Bad, BadJson};
use collect::{Collector, LandmarkFile};
pub use fields::{BesideFiles, Target};
pub use files::without_files;
pub use files::{Choice, LandmarkFiles, Landmarks, Placed, extent};
pub use item::Item;
use json::ObjectMembers;

pub use super::enum_name::Matching;
use table::{Table, TableRow};

use super::json::Node;
use super::work::Work;
use crate::problem::words::quote;

/// A format: how a file of it is recognised and read.
struct Format {
    /// Its name in responses.
    name: &'static str,
    /// What people call it.
    title: &'static str,
    /// What one file may have several of; only one is read.
    items: &'static str,
    form: FormatReader,
}

/// What a format is written in. The first function: whether a file is of this format, by its
/// beginning. The second one reads it.
enum FormatReader {
    /// A text, by its beginning.
    Head(
        fn(&str) -> bool,
        fn(SourceText<'_>, &mut Collector) -> Result<usize, Bad>,
    ),
    /// Lines, by the first that is neither empty nor a comment.
    Lines(
        fn(&str) -> bool,
        fn(SourceText<'_>, &mut Collector) -> Result<usize, Bad>,
    ),
    /// Rows of fields, by the first.
    Table(
        fn(&TableRow) -> bool,
        fn(Table<'_>, &mut Collector) -> Result<usize, Bad>,
    ),
    /// JSON, by the fields of its outermost object.
    Json(
        fn(&ObjectMembers<'_>) -> bool,
        fn(&str, &Node<'_, '_>, &mut Collector) -> Result<usize, BadJson>,
    ),
}

/// The formats, in the order in which they are asked; CSV is what no other table is.
const FORMATS: &[Format] = &[
    labelme::FORMAT,
    own::FORMAT,
    coco::FORMAT,
    slicer::JSON,
    iiif::FORMAT,
    bigwarp_json::FORMAT,
    normalized::ARKIT,
    normalized::MEDIAPIPE,
    dlib::FORMAT,
    cvat::FORMAT,
    slicer::FCSV,
    pts::FORMAT,
    tem::FORMAT,
    tps::FORMAT,
    elastix::FORMAT,
    bigwarp::FORMAT,
    qgis::FORMAT,
    napari::FORMAT,
    deeplabcut::FORMAT,
    openface::FORMAT,
    csv::FORMAT,
];

/// What people call the formats, with commas.
fn titles() -> String {
    let titles: Vec<&str> = FORMATS.iter().map(|format| format.title).collect();
    titles.join(", ")
}

/// Whether a response has this text as its `format`.
pub fn is_format(text: &str) -> bool {
    let names = text.split(" (").next().unwrap_or_default();
    names
        .split('+')
        .all(|name| FORMATS.iter().any(|format| format.name == name))
}

/// The text of a file, and the work of reading it.
#[derive(Clone, Copy)]
struct SourceText<'t> {
    text: &'t str,
    /// Where it begins, bytes: a byte order mark counts for offsets but belongs to no column.
    start: usize,
    work: &'t Work<'t>,
}

/// Reads one file. Once the work is cancelled, the result is wrong.
fn read(
    bytes: &[u8],
    max_columns: usize,
    item: Option<Item>,
    work: &Work<'_>,
) -> Result<LandmarkFile, Bad> {
    if bytes.starts_with(b"\xff\xfe") || bytes.starts_with(b"\xfe\xff") {
        return Err(Bad::new(
            0,
            "expected UTF-8; found UTF-16: save the file as UTF-8",
        ));
    }
    let text = work.text(bytes);
    if let Some(byte) = bytes
        .get(text.len())
        .filter(|_| !tem::is_tem(first_line(text)))
    {
        return Err(Bad::new(
            text.len(),
            format!("expected text in UTF-8; found the byte 0x{byte:02x}"),
        ));
    }
    let zero = work.find(text.as_bytes(), |byte| byte == 0);
    if zero < text.len() {
        return Err(Bad::new(zero, "expected text; found a zero byte"));
    }
    let start = if text.starts_with('\u{feff}') {
        '\u{feff}'.len_utf8()
    } else {
        0
    };
    let source = SourceText { text, start, work };
    let before = work.find(&text.as_bytes()[start..], |byte| {
        !byte.is_ascii_whitespace()
    });
    let content = text[start + before..].trim_start();
    let mut out = Collector::new(max_columns, item);
    let (format, end) = match content.as_bytes().first() {
        None => return Err(Bad::new(start, "expected landmarks; the file is empty")),
        Some(b'{' | b'[') => read_json(source, text.len() - content.len(), &mut out)?,
        Some(_) => read_text(source, content, &mut out)?,
    };
    out.finish(format, end)
}

/// The beginning of the first line that is neither empty nor a comment, among the first ones.
fn first_line(text: &str) -> &str {
    let mut lines = head(text).split(['\n', '\r']);
    lines
        .find(|line| !line.trim().is_empty() && !line.starts_with('#'))
        .unwrap_or_default()
        .trim()
}

/// The beginning of a text.
fn head(text: &str) -> &str {
    const LONGEST_LINE: usize = 1 << 16;
    let end = (0..=LONGEST_LINE.min(text.len()))
        .rev()
        .find(|end| text.is_char_boundary(*end))
        .unwrap_or_default();
    &text[..end]
}

/// What a reader returns: its format, and where a missing landmark would be.
type Reading = (&'static Format, usize);

fn read_json(source: SourceText<'_>, start: usize, out: &mut Collector) -> Result<Reading, Bad> {
    let text = source.text;
    let node = super::json::long_value(&text[start..], source.work)
        .map_err(|e| Bad::of_syntax(text, start, &e))?;
    let fields = ObjectMembers::of(&node);
    for format in FORMATS {
        if let FormatReader::Json(is, read) = format.form
            && is(&fields)
        {
            return read(text, &node, out)
                .map(|end| (format, end))
                .map_err(|wrong| wrong.locate(text, &node));
        }
    }
    Err(fields.unknown(start))
}

fn read_text(source: SourceText<'_>, content: &str, out: &mut Collector) -> Result<Reading, Bad> {
    let (head, first) = (head(content), first_line(content));
    for format in FORMATS {
        match format.form {
            FormatReader::Head(is, read) if is(head) => return Ok((format, read(source, out)?)),
            FormatReader::Lines(is, read) if is(first) => return Ok((format, read(source, out)?)),
            _ => {}
        }
    }
    if let Some(root) = xml::root(head) {
        let detail = format!(
            "expected a landmark file ({}); found XML with the element {}",
            titles(),
            quote(root)
        );
        return Err(Bad::new(source.text.len() - content.len(), detail));
    }
    let table = Table::new(source)?;
    if let [only] = &table.first.fields[..] {
        return Err(Bad::new(
            only.at,
            format!(
                "expected a landmark file ({}); found {}",
                titles(),
                quote(&only.text)
            ),
        ));
    }
    for format in FORMATS {
        if let FormatReader::Table(is, read) = format.form
            && is(&table.first)
        {
            return Ok((format, read(table, out)?));
        }
    }
    Err(Bad::new(
        table.first.at,
        format!("expected a landmark file ({})", titles()),
    ))
}

/// Where in `text` a part of it begins. Nodes of JSON are parts of the text.
fn offset(text: &str, node: &Node<'_, '_>) -> usize {
    node.text
        .as_ptr()
        .addr()
        .saturating_sub(text.as_ptr().addr())
        .min(text.len())
}
