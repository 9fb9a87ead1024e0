//! BigWarp's landmark table in two dimensions:
//! `name, active, moving x, moving y, fixed x, fixed y`, without a header. The moving image is the
//! one that is warped, so `p` is moving and `q` is fixed.
//!
//! Source: `LandmarkTableModel.java` of BigWarp (`save`, `loadCsv`; newer versions have an id after
//! `active`). Positions are those of BigDataViewer, where the centre of the first pixel is 0, 0:
//! 1/2 is added. (With a calibrated image they are in its physical unit; open the images
//! uncalibrated for px.) Rows that are not active are checked and left out, as BigWarp does;
//! `Infinity` is a side that is not set yet.

use super::bad::Bad;
use super::collect::Collector;
use super::table::{Table, TableField, TableRow, flag};
use super::{Format, FormatReader};

pub(super) const FORMAT: Format = Format {
    name: "bigwarp",
    title: "BigWarp CSV",
    items: "tables",
    form: FormatReader::Table(is_bigwarp, read),
};
const CENTRE: f64 = 0.5;

fn is_bigwarp(first: &TableRow) -> bool {
    let is_flag =
        |text: &str| text.eq_ignore_ascii_case("true") || text.eq_ignore_ascii_case("false");
    (6..=9).contains(&first.fields.len()) && is_flag(first.fields[1].text.trim())
}

fn read(table: Table<'_>, out: &mut Collector) -> Result<usize, Bad> {
    let Table { first, mut rows } = table;
    let width = first.fields.len();
    if width > 7 {
        return Err(Bad::new(
            first.at,
            format!(
                "expected BigWarp landmarks in 2 dimensions, 6 or 7 fields; found {width}: 3 \
                    dimensions"
            ),
        ));
    }
    let numbers = width - 4;
    let mut next = Some(first);
    while let Some(row) = next {
        row.require_width(width, "as the first row has")?;
        let is_active = flag(&row.fields[1])?;
        let number = |field: &TableField| match field.located() {
            unset if unset.text.trim_start_matches('-') == "Infinity" => Ok(None),
            set => set.number().map(|value| Some(value + CENTRE)),
        };
        let side = |start: usize| {
            let (x, y) = (number(&row.fields[start])?, number(&row.fields[start + 1])?);
            Ok::<_, Bad>(x.zip(y).map(<[f64; 2]>::from))
        };
        let (p, q, name) = (side(numbers)?, side(numbers + 2)?, row.fields[0].located());
        match (is_active, p, q) {
            (false, ..) | (true, None, None) => out.pass(row.at)?,
            (true, Some(p), Some(q)) => out.pair(row.at, [Some(p), Some(q)], Some(name))?,
            (true, p, _) => out.one_sided(row.at, p.is_some(), name)?,
        }
        next = rows.next_row()?;
    }
    Ok(rows.end())
}
