//! Separated values, row by row. Tabs, semicolons, commas and white space are recognised; quotes
//! and line ends as in RFC 4180. With tabs and semicolons the comma may separate decimals, as in
//! spreadsheets of many countries.

use csv_core::{ReadFieldResult, Reader, ReaderBuilder};

use super::bad::Bad;
use super::collect::Located;
use super::words::line_at;
use super::{SourceText, Work};
use crate::problem::words::quote;

/// The longest field, bytes.
pub(super) const LONGEST_FIELD: usize = 1024;
/// The largest number of fields in a row.
pub(super) const MOST_FIELDS: usize = 4096;

/// A field and its place in the file, bytes.
#[derive(Debug, Default)]
pub(super) struct TableField {
    pub(super) at: usize,
    pub(super) text: String,
}

impl TableField {
    pub(super) fn located(&self) -> Located<'_> {
        Located {
            at: self.at,
            text: self.text.trim(),
        }
    }
}

/// A row.
#[derive(Debug)]
pub(super) struct TableRow {
    pub(super) at: usize,
    pub(super) fields: Vec<TableField>,
}

impl TableRow {
    /// The names of a header, in lower case; `None` if a field is a number.
    pub(super) fn as_header(&self) -> Option<Vec<String>> {
        let names = self.fields.iter().map(|field| field.text.trim());
        let is_header = names
            .clone()
            .all(|name| name.replacen(',', ".", 1).parse::<f64>().is_err())
            && names.clone().any(|name| !name.is_empty());
        is_header.then(|| names.map(str::to_lowercase).collect())
    }

    /// Errors: Another number of fields.
    pub(super) fn require_width(&self, width: usize, what: &str) -> Result<(), Bad> {
        let found = self.fields.len();
        if found == width {
            return Ok(());
        }
        // A surplus field, or the end of the row.
        let at = self
            .fields
            .get(width)
            .or(self.fields.last())
            .map_or(self.at, |field| field.at);
        Err(Bad::new(
            at,
            format!("expected {width} fields, {what}; found {found}"),
        ))
    }
}

/// The rows of a file, the first of which has been read.
pub(super) struct Table<'t> {
    pub(super) first: TableRow,
    pub(super) rows: TableRows<'t>,
}

impl<'t> Table<'t> {
    /// Errors: A row that is too long, or none.
    pub(super) fn new(source: SourceText<'t>) -> Result<Self, Bad> {
        let mut rows = TableRows::new(source)?;
        let first = rows.next_row()?;
        let missing = || {
            Bad::new(
                source.start,
                "expected landmarks; the file has comments only",
            )
        };
        Ok(Self {
            first: first.ok_or_else(missing)?,
            rows,
        })
    }
}

/// The rows of a text. Empty lines, and comments (`#`) before the first row, are passed over.
pub(super) struct TableRows<'t> {
    source: SourceText<'t>,
    at: usize,
    /// `None` for white space.
    reader: Option<Reader>,
    /// Whether the comma is not the separator and may separate decimals.
    pub(super) decimal_comma: bool,
    /// The field that is being read.
    field: Box<[u8; LONGEST_FIELD]>,
}

impl<'t> TableRows<'t> {
    /// Errors: A comment that is too long.
    pub(super) fn new(source: SourceText<'t>) -> Result<Self, Bad> {
        let mut at = source.start;
        while at < source.text.len() {
            let (line, length) = line_at(source, at)?;
            if !(line.trim().is_empty() || line.starts_with('#')) {
                break;
            }
            at += length;
        }
        let separator = separator(&source.text.as_bytes()[at..], source.work);
        let reader = separator.map(|separator| ReaderBuilder::new().delimiter(separator).build());
        let decimal_comma = separator.is_some_and(|separator| separator != b',');
        Ok(Self {
            source,
            at,
            reader,
            decimal_comma,
            field: Box::new([0; LONGEST_FIELD]),
        })
    }

    /// The end of the file, bytes.
    pub(super) fn end(&self) -> usize {
        self.source.text.len()
    }

    /// The next row.
    pub(super) fn next_row(&mut self) -> Result<Option<TableRow>, Bad> {
        let rest = &self.source.text.as_bytes()[self.at..];
        // Only as far as the first byte of the next row: what follows it is looked at as it is
        // read.
        let blank = self
            .source
            .work
            .find(rest, |byte| !byte.is_ascii_whitespace());
        if blank == rest.len() || self.source.work.is_stopped() {
            self.at = self.source.text.len();
            return Ok(None);
        }
        let is_end = |byte: &u8| matches!(byte, b'\n' | b'\r');
        // Tabs before the first word are fields.
        self.at += rest[..blank]
            .iter()
            .rposition(is_end)
            .map_or(0, |end| end + 1);
        let fields = if self.reader.is_some() {
            self.fields()?
        } else {
            self.words()?
        };
        Ok(Some(fields))
    }

    /// The words of the next row, and texts in quotes.
    fn words(&mut self) -> Result<TableRow, Bad> {
        let (line, length) = line_at(self.source, self.at)?;
        let (row_at, mut rest) = (self.at, line.trim_start());
        self.at += length;
        let mut fields = Vec::new();
        while !rest.is_empty() {
            let at = row_at + (rest.as_ptr().addr() - line.as_ptr().addr());
            let quoted = rest
                .strip_prefix('"')
                .and_then(|inside| inside.split_once('"'));
            let whole = || rest.split_at(rest.find(char::is_whitespace).unwrap_or(rest.len()));
            let (text, after) = quoted.unwrap_or_else(whole);
            if text.len() > LONGEST_FIELD {
                return Err(too_long(at));
            }
            push(
                &mut fields,
                TableField {
                    at,
                    text: text.to_owned(),
                },
            )?;
            rest = after.trim_start();
        }
        Ok(TableRow { at: row_at, fields })
    }

    /// The fields of the next row between separators.
    fn fields(&mut self) -> Result<TableRow, Bad> {
        let (row_at, mut fields) = (self.at, Vec::new());
        loop {
            let (field, is_last) = self.field()?;
            push(&mut fields, field)?;
            if is_last {
                return Ok(TableRow { at: row_at, fields });
            }
        }
    }

    /// The next field of the row, and whether it is the last one.
    fn field(&mut self) -> Result<(TableField, bool), Bad> {
        let Some(reader) = &mut self.reader else {
            return Err(Bad::new(self.at, "expected a row"));
        };
        let (at, mut length) = (self.at, 0);
        loop {
            // Without input the reader ends the field.
            let (result, read, written) = reader.read_field(
                &self.source.text.as_bytes()[self.at..],
                &mut self.field[length..],
            );
            self.at += read;
            length += written;
            self.source.work.add(read);
            let is_last = match result {
                ReadFieldResult::InputEmpty => continue,
                ReadFieldResult::OutputFull => return Err(too_long(at)),
                ReadFieldResult::Field { record_end } => record_end,
                ReadFieldResult::End => true,
            };
            let text = std::str::from_utf8(&self.field[..length])
                .map_err(|_| Bad::new(at, "expected text in UTF-8"))?;
            return Ok((
                TableField {
                    at,
                    text: text.to_owned(),
                },
                is_last,
            ));
        }
    }
}

/// Errors: Too many fields.
fn push(fields: &mut Vec<TableField>, field: TableField) -> Result<(), Bad> {
    if fields.len() == MOST_FIELDS {
        return Err(Bad::new(
            field.at,
            format!("expected at most {MOST_FIELDS} fields in a row; found more"),
        ));
    }
    fields.push(field);
    Ok(())
}

fn too_long(at: usize) -> Bad {
    Bad::new(
        at,
        format!("expected a field of at most {LONGEST_FIELD} bytes; found a longer one"),
    )
}

/// What separates the fields: what every row has outside of quotes, a tab rather than a semicolon
/// rather than a comma; else a comma or a semicolon, if there is one. `None`: white space.
fn separator(text: &[u8], work: &Work<'_>) -> Option<u8> {
    const SEPARATORS: [u8; 3] = *b"\t;,";
    let (mut rows, mut counts) = (0_usize, [0_usize; 3]);
    let (mut has, mut is_blank, mut is_quoted, mut may_quote) = ([false; 3], true, false, true);
    for byte in work.pieces(text).flatten().chain(b"\n") {
        let found = SEPARATORS
            .iter()
            .position(|separator| separator == byte)
            .filter(|_| !is_quoted);
        match (byte, found) {
            // A doubled quote ends and begins.
            (b'"', _) if is_quoted || may_quote => is_quoted = !is_quoted,
            (b'\n' | b'\r', _) if !is_quoted => {
                rows += usize::from(!is_blank);
                counts
                    .iter_mut()
                    .zip(has)
                    .for_each(|(count, has)| *count += usize::from(has && !is_blank));
                (has, is_blank, may_quote) = ([false; 3], true, true);
            }
            (_, Some(index)) => (has[index], may_quote) = (true, true),
            _ => may_quote = is_quoted,
        }
        is_blank &= byte.is_ascii_whitespace();
    }
    let [_, semicolons, commas] = counts;
    let of_all = SEPARATORS
        .into_iter()
        .zip(counts)
        .find_map(|(separator, count)| (count == rows).then_some(separator));
    of_all
        .or((commas > 0).then_some(b','))
        .or((semicolons > 0).then_some(b';'))
}

/// The value of a field that says whether its row counts.
pub(super) fn flag(field: &TableField) -> Result<bool, Bad> {
    match field.text.trim().to_ascii_lowercase().as_str() {
        "true" | "1" => Ok(true),
        "false" | "0" => Ok(false),
        other => Err(Bad::new(
            field.at,
            format!("expected `true` or `false`; found {}", quote(other)),
        )),
    }
}
