//! Separated values, row by row. Commas, semicolons (spreadsheets where the comma separates decimals) and tabs are recognised; quotes and
//! line ends as in RFC 4180.

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
        let is_header = names.clone().all(|name| name.parse::<f64>().is_err()) && names.clone().any(|name| !name.is_empty());
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
    reader: Reader,
    is_first: bool,
    /// Whether the comma is not the separator and may separate decimals.
    pub(super) decimal_comma: bool,
}

impl<'t> Rows<'t> {
    pub(super) fn new(text: &'t str, start: usize) -> Self {
        let is_row = |line: &&str| !line.trim().is_empty() && !line.starts_with('#');
        let first = text[start..].lines().find(is_row).unwrap_or_default();
        // Outside of quotes.
        let has = |separator: char| first.split('"').step_by(2).any(|part| part.contains(separator));
        let separator = if has('\t') {
            b'\t'
        } else if has(';') {
            b';'
        } else {
            b','
        };
        let reader = ReaderBuilder::new().delimiter(separator).build();
        Self { text, at: start, reader, is_first: true, decimal_comma: separator != b',' }
    }

    /// The end of the file, bytes.
    pub(super) fn end(&self) -> usize {
        self.text.len()
    }

    /// The next row.
    pub(super) fn next_row(&mut self) -> Result<Option<Row>, Bad> {
        loop {
            let rest = &self.text[self.at..];
            let line = rest.split_inclusive('\n').next().unwrap_or_default();
            if line.is_empty() {
                return Ok(None);
            }
            if !(line.trim().is_empty() || self.is_first && line.starts_with('#')) {
                break;
            }
            self.at += line.len();
        }
        self.is_first = false;
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

    /// The next field of the row, and whether it is the last one.
    fn field(&mut self) -> Result<(Field, bool), Bad> {
        let (at, mut bytes, mut length) = (self.at, [0; LONGEST_FIELD], 0);
        loop {
            // Without input the reader ends the field.
            let (result, read, written) = self.reader.read_field(&self.text.as_bytes()[self.at..], &mut bytes[length..]);
            self.at += read;
            length += written;
            let is_last = match result {
                ReadFieldResult::InputEmpty => continue,
                ReadFieldResult::OutputFull => {
                    return Err(Bad::new(at, format!("expected a field of at most {LONGEST_FIELD} bytes; found a longer one")));
                }
                ReadFieldResult::Field { record_end } => record_end,
                ReadFieldResult::End => true,
            };
            let text = std::str::from_utf8(&bytes[..length]).map_err(|_| Bad::new(at, "expected text in UTF-8"))?;
            return Ok((Field { at, text: text.to_owned() }, is_last));
        }
    }
}

/// The value of a field that says whether its row counts.
pub(super) fn flag(field: &Field) -> Result<bool, Bad> {
    match field.text.trim().to_ascii_lowercase().as_str() {
        "true" | "1" => Ok(true),
        "false" | "0" => Ok(false),
        other => Err(Bad::new(field.at, format!("expected `true` or `false`; found {}", quote(other)))),
    }
}
