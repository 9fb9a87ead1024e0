//! CSV with the columns `x,y` (one side) or `px,py,qx,qy` (both sides), in px of the contract: nothing is converted. Decimal commas are read
//! where tabs or semicolons separate the fields, if the file has no decimal points.
//!
//! With a header the columns may have any order; `name`, `label`, `id` or `landmark` is the name, and further columns are ignored. Without
//! one, the rows are 2 or 4 numbers, before or after which a name may stand.

use super::bad::Bad;
use super::collect::Collector;
use super::table::{Row, Rows};
use super::{FORMATS, File};
use crate::problem::words::quote;

const NAMES: [&str; 4] = ["name", "label", "id", "landmark"];

/// Which field is what.
struct Columns {
    p: [usize; 2],
    q: Option<[usize; 2]>,
    name: Option<usize>,
    width: usize,
    /// What the width is explained by.
    like: &'static str,
}

pub(super) fn read(first: Row, mut rows: Rows<'_>, mut out: Collector) -> Result<File, Bad> {
    let header = first.as_header();
    let columns = match &header {
        Some(names) => named(&first, names)?,
        None => unnamed(&first)?,
    };
    let mut mark = None;
    let mut row = if header.is_some() { rows.next_row()? } else { Some(first) };
    while let Some(Row { at, fields }) = &row {
        row.as_ref().map_or(Ok(()), |row| row.require_width(columns.width, columns.like))?;
        let mut number = |field: usize| {
            let field = fields[field].located();
            let value = field.parse(rows.decimal_comma)?;
            if let Some(found) = field.text.chars().find(|c| [',', '.'].contains(c)).filter(|found| found != mark.get_or_insert(*found)) {
                let expected = if found == '.' { "comma" } else { "point" };
                return Err(Bad::new(
                    field.at,
                    format!("expected a decimal {expected}, as in the numbers before; found {}", quote(field.text)),
                ));
            }
            Ok(value)
        };
        let mut side = |[x, y]: [usize; 2]| Ok::<_, Bad>([number(x)?, number(y)?]);
        out.point(*at, side(columns.p)?, columns.q.map(&mut side).transpose()?, columns.name.map(|name| fields[name].located()))?;
        row = rows.next_row()?;
    }
    out.finish("csv", rows.end())
}

/// The columns of a header.
fn named(header: &Row, names: &[String]) -> Result<Columns, Bad> {
    let find = |wanted: &str| names.iter().position(|name| name == wanted);
    for (index, name) in names.iter().enumerate() {
        if ["x", "y", "px", "py", "qx", "qy"].contains(&name.as_str()) && find(name) != Some(index) {
            return Err(Bad::new(header.fields[index].at, format!("expected each column once; {} occurs twice", quote(name))));
        }
    }
    let pair = |x: &str, y: &str| match (find(x), find(y)) {
        (Some(x), Some(y)) => Ok(Some([x, y])),
        (None, None) => Ok(None),
        (found, _) => {
            let (other, missing) = if found.is_some() { (x, y) } else { (y, x) };
            Err(Bad::new(header.at, format!("expected the column `{missing}` beside `{other}`; it is missing")))
        }
    };
    let (x, p, q) = (pair("x", "y")?, pair("px", "py")?, pair("qx", "qy")?);
    let (p, q) = match (x, p, q) {
        (Some(p), None, None) => (p, None),
        (None, Some(p), q) => (p, q),
        (Some(_), ..) => return Err(Bad::new(header.at, "expected `x`, `y` or `px`, `py`, `qx`, `qy`; found columns of both kinds")),
        (None, None, _) => {
            let found = names.iter().take(8).map(|name| quote(name)).collect::<Vec<_>>().join(", ");
            let detail = format!("expected a landmark file ({FORMATS}) or the columns `x`, `y` or `px`, `py`, `qx`, `qy`; found {found}");
            return Err(Bad::new(header.at, detail));
        }
    };
    let name = NAMES.iter().find_map(|name| find(name));
    Ok(Columns { p, q, name, width: names.len(), like: "as the header has" })
}

/// The columns of a first row without header.
fn unnamed(first: &Row) -> Result<Columns, Bad> {
    let is_number = |field: usize| first.fields[field].located().parse(true).is_ok();
    let width = first.fields.len();
    let (start, name) = match width {
        2 | 4 => (0, None),
        3 | 5 if !is_number(0) => (1, Some(0)),
        3 | 5 if !is_number(width - 1) => (0, Some(width - 1)),
        3 | 5 => {
            let detail = "expected 2 or 4 numbers, with or without a name, or a header that names the columns";
            let hint = "decimal commas need tabs or semicolons between the numbers";
            return Err(Bad::new(first.at, format!("{detail}; found {width} fields: {hint}")));
        }
        _ => {
            let detail = format!("expected x, y or px, py, qx, qy, with or without a name; found {width} fields");
            return Err(Bad::new(first.at, detail));
        }
    };
    let q = (width > 3).then_some([start + 2, start + 3]);
    Ok(Columns { p: [start, start + 1], q, name, width, like: "as the first row has" })
}
