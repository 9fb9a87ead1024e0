//! CSV with the columns `x,y` (one side) or `px,py,qx,qy` (both sides), in px of the contract:
//! nothing is converted. Decimal commas are read where tabs or semicolons separate the fields, if
//! the file has no decimal points.
//!
//! With a header the columns may have any order; `name`, `label`, `id` or `landmark` is the name,
//! and further columns are ignored. Without one, the rows are 2 or 4 numbers, before or after which
//! a name may stand. A named landmark whose cells are empty or `NaN` is missing.

use super::bad::Bad;
use super::collect::{Collector, Located};
use super::table::{Table, TableRow};
use super::{Format, FormatReader, titles};
use crate::problem::words::quote;

pub(super) const FORMAT: Format = Format {
    name: "csv",
    title: "CSV",
    items: "tables",
    form: FormatReader::Table(|_| true, read),
};
pub(super) const NAMES: [&str; 4] = ["name", "label", "id", "landmark"];
/// The most columns of a header that an error names.
const MOST_NAMED: usize = 8;

/// What the fields of a row are.
struct Columns {
    p: [usize; 2],
    q: Option<[usize; 2]>,
    name: Option<usize>,
    width: usize,
    /// Where the width comes from, in the words of an error.
    like: &'static str,
}

fn read(table: Table<'_>, out: &mut Collector) -> Result<usize, Bad> {
    let Table { first, mut rows } = table;
    let header = first.as_header();
    let columns = match &header {
        Some(names) => named(&first, names)?,
        None => unnamed(&first)?,
    };
    let mut mark = None;
    let mut next = if header.is_some() {
        rows.next_row()?
    } else {
        Some(first)
    };
    while let Some(row) = next {
        row.require_width(columns.width, columns.like)?;
        let name = columns.name.map(|name| row.fields[name].located());
        let is_named = name.is_some_and(|name| !name.text.is_empty());
        let mut number = |field: usize| {
            let field = row.fields[field].located();
            if is_named && field.is_missing() {
                return Ok(None);
            }
            let value = field.parse(rows.decimal_comma)?;
            same_mark(field, &mut mark)?;
            Ok(Some(value))
        };
        let mut side = |[x, y]: [usize; 2]| {
            let (x, y) = (number(x)?, number(y)?);
            Ok::<_, Bad>(x.zip(y).map(<[f64; 2]>::from))
        };
        let p = side(columns.p)?;
        match columns.q {
            Some(q) => out.pair(row.at, [p, side(q)?], name)?,
            None => out.point(row.at, p, name)?,
        }
        next = rows.next_row()?;
    }
    Ok(rows.end())
}

/// Errors: the number has another decimal mark than those before it.
fn same_mark(field: Located<'_>, mark: &mut Option<char>) -> Result<(), Bad> {
    let Some(found) = field.text.chars().find(|c| [',', '.'].contains(c)) else {
        return Ok(());
    };
    if *mark.get_or_insert(found) == found {
        return Ok(());
    }
    let expected = if found == '.' { "comma" } else { "point" };
    let detail = format!(
        "expected a decimal {expected}, as in the numbers before; found {}",
        quote(field.text)
    );
    Err(Bad::new(field.at, detail))
}

/// The columns of a header.
fn named(header: &TableRow, names: &[String]) -> Result<Columns, Bad> {
    let find = |wanted: &str| names.iter().position(|name| name == wanted);
    for (index, name) in names.iter().enumerate() {
        if ["x", "y", "px", "py", "qx", "qy"].contains(&name.as_str()) && find(name) != Some(index)
        {
            return Err(Bad::new(
                header.fields[index].at,
                format!("expected each column once; {} occurs twice", quote(name)),
            ));
        }
    }
    let pair = |x: &str, y: &str| match (find(x), find(y)) {
        (Some(x), Some(y)) => Ok(Some([x, y])),
        (None, None) => Ok(None),
        (found, _) => {
            let (other, missing) = if found.is_some() { (x, y) } else { (y, x) };
            Err(Bad::new(
                header.at,
                format!("expected the column `{missing}` beside `{other}`; it is missing"),
            ))
        }
    };
    let (x, p, q) = (pair("x", "y")?, pair("px", "py")?, pair("qx", "qy")?);
    let (p, q) = match (x, p, q) {
        (Some(p), None, None) => (p, None),
        (None, Some(p), q) => (p, q),
        (Some(_), ..) => {
            return Err(Bad::new(
                header.at,
                "expected `x`, `y` or `px`, `py`, `qx`, `qy`; found columns of both kinds",
            ));
        }
        (None, None, _) => {
            let found: Vec<String> = names
                .iter()
                .take(MOST_NAMED)
                .map(|name| quote(name))
                .collect();
            let more = names.len() - found.len();
            let more = if more > 0 {
                format!(" and {more} more")
            } else {
                String::new()
            };
            let expected =
                "the columns `x`, `y` or `px`, `py`, `qx`, `qy`, beside which there may be others";
            let detail = format!(
                "expected a landmark file ({}) or {expected}; found {}{more}",
                titles(),
                found.join(", ")
            );
            return Err(Bad::new(header.at, detail));
        }
    };
    let name = NAMES.iter().find_map(|name| find(name));
    Ok(Columns {
        p,
        q,
        name,
        width: names.len(),
        like: "as the header has",
    })
}

/// The columns of a first row without header.
fn unnamed(first: &TableRow) -> Result<Columns, Bad> {
    let is_number = |field: usize| first.fields[field].located().parse(true).is_ok();
    let width = first.fields.len();
    let (start, name) = match width {
        2 | 4 => (0, None),
        3 | 5 if !is_number(0) => (1, Some(0)),
        3 | 5 if !is_number(width - 1) => (0, Some(width - 1)),
        _ => {
            let detail = "expected x, y or px, py, qx, qy, with or without a name, or a header \
                that names the columns";
            return Err(Bad::new(
                first.at,
                format!("{detail}; found {width} fields{}", hint(first)),
            ));
        }
    };
    let q = (width > 3).then_some([start + 2, start + 3]);
    Ok(Columns {
        p: [start, start + 1],
        q,
        name,
        width,
        like: "as the first row has",
    })
}

/// What is probably wrong with a row of this number of fields.
fn hint(first: &TableRow) -> &'static str {
    let is_number = |text: &str| text.trim().parse::<f64>().is_ok();
    // `1,5 2,5`: a field between two commas that is two numbers.
    let is_two = |text: &str| {
        let mut numbers = text.split([' ', '\t', ';']).filter(|part| !part.is_empty());
        text.trim().contains([' ', '\t', ';']) && numbers.all(|part| part.parse::<f64>().is_ok())
    };
    match &first.fields[..] {
        fields if fields.iter().any(|field| is_two(&field.text)) => {
            ": decimal commas need tabs or semicolons between the numbers"
        }
        fields if !fields.iter().all(|field| is_number(&field.text)) => "",
        [_, _, _] => ": is the first a number of the row? give the file a header: id,x,y",
        [_, _, _, _, _] => {
            ": is the first a number of the row? give the file a header: id,px,py,qx,qy"
        }
        _ => ": write one landmark in a line, x,y or px,py,qx,qy",
    }
}
