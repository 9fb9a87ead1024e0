//! Separated values, row by row. Tabs, semicolons, commas and white space are recognised; quotes and line ends as in RFC 4180. With tabs and
//! semicolons the comma may separate decimals, as in spreadsheets of many countries.

use csv_core::{ReadFieldResult, Reader, ReaderBuilder};

use super::bad::Bad;
use super::collect::Located;
use crate::problem::words::quote;

/// The longest field, bytes.
const LONGEST_FIELD: usize = 1024;
/// The largest number of fields in a row.
const MOST_FIELDS: usize = 64;

/// A field and its place in the file, bytes.
#[derive(Debug)]
pub(super) struct Field {
    pub(super) at: usize,
    pub(super) text: String,
}

impl Field {
    pub(super) fn located(&self) -> Located<'_> {
        Located { at: self.at, text: self.text.trim() }
    }
}

/// A row.
#[derive(Debug)]
pub(super) struct Row {
    pub(super) at: usize,
    pub(super) fields: Vec<Field>,
}

impl Row {
    /// The names of a header, in lower case; `None` if a field is a number.
    pub(super) fn as_header(&self) -> Option<Vec<String>> {
        let names = self.fields.iter().map(|field| field.text.trim());
        let is_header =
            names.clone().all(|name| name.replacen(',', ".", 1).parse::<f64>().is_err()) && names.clone().any(|name| !name.is_empty());
        is_header.then(|| names.map(str::to_lowercase).collect())
    }

    /// Errors: Another number of fields.
    pub(super) fn require_width(&self, width: usize, what: &str) -> Result<(), Bad> {
        let found = self.fields.len();
        if found == width {
            return Ok(());
        }
        // A surplus field, or the end of the row.
        let at = self.fields.get(width).or(self.fields.last()).map_or(self.at, |field| field.at);
        Err(Bad::new(at, format!("expected {width} fields, {what}; found {found}")))
    }
}

/// The rows of a text. Empty lines, and comments (`#`) before the first row, are passed over.
pub(super) struct Rows<'t> {
    text: &'t str,
    at: usize,
    /// `None` for white space.
    reader: Option<Reader>,
    /// Whether the comma is not the separator and may separate decimals.
    pub(super) decimal_comma: bool,
}

impl<'t> Rows<'t> {
    pub(super) fn new(text: &'t str, start: usize) -> Self {
        let comments = text[start..].split_inclusive('\n').take_while(|line| line.trim().is_empty() || line.starts_with('#'));
        let at = start + comments.map(str::len).sum::<usize>();
        let separator = separator(&text[at..]);
        let reader = separator.map(|separator| ReaderBuilder::new().delimiter(separator).build());
        Self { text, at, reader, decimal_comma: separator.is_some_and(|separator| separator != b',') }
    }

    /// The end of the file, bytes.
    pub(super) fn end(&self) -> usize {
        self.text.len()
    }

    /// The next row.
    pub(super) fn next_row(&mut self) -> Result<Option<Row>, Bad> {
        let blank = self.text[self.at..].split_inclusive('\n').take_while(|line| line.trim().is_empty());
        self.at += blank.map(str::len).sum::<usize>();
        if self.at == self.text.len() {
            return Ok(None);
        }
        let (row_at, mut fields) = (self.at, Vec::new());
        loop {
            let (field, is_last) = self.field()?;
            if fields.len() == MOST_FIELDS {
                return Err(Bad::new(field.at, format!("expected at most {MOST_FIELDS} fields in a row; found more")));
            }
            fields.push(field);
            if is_last {
                return Ok(Some(Row { at: row_at, fields }));
            }
        }
    }

    /// The next word of the row, or text in quotes, and whether it is the last one.
    fn word(&mut self) -> Result<(Field, bool), Bad> {
        let line = self.text[self.at..].split_inclusive('\n').next().unwrap_or_default();
        let rest = line.trim_start();
        let at = self.at + line.len() - rest.len();
        let (text, after) = match rest.strip_prefix('"').and_then(|inside| inside.split_once('"')) {
            Some(quoted) => quoted,
            None => rest.split_at(rest.find(char::is_whitespace).unwrap_or(rest.len())),
        };
        if text.len() > LONGEST_FIELD {
            return Err(too_long(at));
        }
        let is_last = after.trim().is_empty();
        self.at += line.len() - if is_last { 0 } else { after.len() };
        Ok((Field { at, text: text.to_owned() }, is_last))
    }

    /// The next field of the row, and whether it is the last one.
    fn field(&mut self) -> Result<(Field, bool), Bad> {
        let Some(reader) = &mut self.reader else { return self.word() };
        let (at, mut bytes, mut length) = (self.at, [0; LONGEST_FIELD], 0);
        loop {
            // Without input the reader ends the field.
            let (result, read, written) = reader.read_field(&self.text.as_bytes()[self.at..], &mut bytes[length..]);
            self.at += read;
            length += written;
            let is_last = match result {
                ReadFieldResult::InputEmpty => continue,
                ReadFieldResult::OutputFull => return Err(too_long(at)),
                ReadFieldResult::Field { record_end } => record_end,
                ReadFieldResult::End => true,
            };
            let text = std::str::from_utf8(&bytes[..length]).map_err(|_| Bad::new(at, "expected text in UTF-8"))?;
            return Ok((Field { at, text: text.to_owned() }, is_last));
        }
    }
}

fn too_long(at: usize) -> Bad {
    Bad::new(at, format!("expected a field of at most {LONGEST_FIELD} bytes; found a longer one"))
}

/// What separates the fields: what every row has outside of quotes, a tab rather than a semicolon rather than a comma; else a comma or a
/// semicolon, if there is one. `None`: white space.
fn separator(text: &str) -> Option<u8> {
    const SEPARATORS: [u8; 3] = *b"\t;,";
    let (mut rows, mut counts) = (0_usize, [0_usize; 3]);
    let (mut has, mut is_blank, mut is_quoted, mut may_quote) = ([false; 3], true, false, true);
    for byte in text.bytes().chain([b'\n']) {
        let found = SEPARATORS.iter().position(|separator| *separator == byte).filter(|_| !is_quoted);
        match (byte, found) {
            // A doubled quote ends and begins.
            (b'"', _) if is_quoted || may_quote => is_quoted = !is_quoted,
            (b'\n', _) if !is_quoted => {
                rows += usize::from(!is_blank);
                counts.iter_mut().zip(has).for_each(|(count, has)| *count += usize::from(has && !is_blank));
                (has, is_blank, may_quote) = ([false; 3], true, true);
            }
            (_, Some(index)) => (has[index], may_quote) = (true, true),
            _ => may_quote = is_quoted,
        }
        is_blank &= byte.is_ascii_whitespace();
    }
    let [_, semicolons, commas] = counts;
    let of_all = SEPARATORS.into_iter().zip(counts).find_map(|(separator, count)| (count == rows).then_some(separator));
    of_all.or((commas > 0).then_some(b',')).or((semicolons > 0).then_some(b';'))
}

/// The value of a field that says whether its row counts.
pub(super) fn flag(field: &Field) -> Result<bool, Bad> {
    match field.text.trim().to_ascii_lowercase().as_str() {
        "true" | "1" => Ok(true),
        "false" | "0" => Ok(false),
        other => Err(Bad::new(field.at, format!("expected `true` or `false`; found {}", quote(other)))),
    }
}
