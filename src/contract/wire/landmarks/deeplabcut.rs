//! Keypoints of DeepLabCut, CSV: the header rows `scorer`, `individuals` (of several animals),
//! `bodyparts` and `coords`, then a row for each image. A row is an item, and with several animals
//! each of them; its names are the path of the image, the name of its file, and the animal after
//! either. The body part is the name of a landmark; an empty cell or `NaN` is a missing one.
//!
//! Source: DeepLabCut's `CollectedData_*.csv` and the `.csv` of its analysis, which has
//! `likelihood` too (not used). Positions are those of napari and matplotlib, pixel indices whose
//! whole numbers are the centres of pixels: 1/2 is added.

use super::bad::Bad;
use super::collect::Collector;
use super::item::ItemName;
use super::table::{Table, TableField, TableRow, TableRows};
use super::{Format, FormatReader};

pub(super) const FORMAT: Format = Format {
    name: "deeplabcut",
    title: "DeepLabCut CSV",
    items: "rows",
    form: FormatReader::Table(is_deeplabcut, read),
};
const CENTRE: f64 = 0.5;

fn is_deeplabcut(first: &TableRow) -> bool {
    first.fields[0].text.trim().eq_ignore_ascii_case("scorer")
}

fn text(row: &TableRow, field: usize) -> &str {
    row.fields.get(field).map_or("", |field| field.text.trim())
}

/// Consecutive landmarks of one animal.
struct Animal {
    /// Empty if the file has no names of animals.
    name: String,
    /// The column of x of each landmark, which that of y follows, and its name.
    landmarks: Vec<(usize, TableField)>,
}

/// What the header says.
struct Header {
    /// The number of columns before the first of a landmark: the path of the image.
    start: usize,
    animals: Vec<Animal>,
}

/// Only names of landmarks and animals stay in memory: a row may be long.
fn header(first: TableRow, rows: &mut TableRows<'_>) -> Result<Header, Bad> {
    let width = first.fields.len();
    drop(first);
    let (mut individuals, mut parts) = (None, None);
    let coords = loop {
        let row = rows.next_row()?.ok_or_else(|| {
            Bad::new(
                rows.end(),
                "expected the header row `coords`; found the end of the file",
            )
        })?;
        row.require_width(width, "as the first row has")?;
        match text(&row, 0).to_ascii_lowercase().as_str() {
            "individuals" => individuals = Some(row),
            "bodyparts" => parts = Some(row),
            "coords" => break row,
            _ => {
                return Err(Bad::new(
                    row.at,
                    "expected the header rows `bodyparts` and `coords`; found another row",
                ));
            }
        }
    };
    let mut parts = parts.ok_or_else(|| {
        Bad::new(
            coords.at,
            "expected the header row `bodyparts` before `coords`; it is missing",
        )
    })?;
    let columns: Vec<usize> = (1..width.saturating_sub(1))
        .filter(|k| text(&coords, *k) == "x" && text(&coords, k + 1) == "y")
        .collect();
    let Some(&start) = columns.first() else {
        return Err(Bad::new(coords.at, "expected columns `x`, `y`; found none"));
    };
    let animal = |column: usize| individuals.as_ref().map_or("", |row| text(row, column));
    let mut landmark = |column: &usize| {
        let name = std::mem::take(&mut parts.fields[*column]);
        (*column, name)
    };
    let animals = columns
        .chunk_by(|a, b| animal(*a) == animal(*b))
        .map(|group| Animal {
            name: animal(group[0]).to_owned(),
            landmarks: group.iter().map(&mut landmark).collect(),
        })
        .collect();
    Ok(Header { start, animals })
}

fn read(table: Table<'_>, out: &mut Collector) -> Result<usize, Bad> {
    let Table { first, mut rows } = table;
    let width = first.fields.len();
    let Header { start, animals } = header(first, &mut rows)?;
    while let Some(row) = rows.next_row()? {
        row.require_width(width, "as the header has")?;
        let path: Vec<&str> = (0..start).map(|k| text(&row, k)).collect();
        let file = text(&row, start - 1).rsplit(['/', '\\']).next();
        let file = [file.unwrap_or_default()];
        let rests = [out.items().rest(&path), out.items().rest(&file)];
        for Animal { name, landmarks } in &animals {
            let names = [(&path[..], rests[0]), (&file, rests[1])];
            let names = names.map(|(pieces, rest)| ItemName {
                pieces,
                part: name,
                rest,
            });
            if !out.named_item(row.at, &names)? {
                continue;
            }
            for (column, name) in landmarks {
                let [x, y] = [*column, column + 1].map(|field| row.fields[field].located());
                let is_missing = x.is_missing() || y.is_missing();
                let place = if is_missing {
                    None
                } else {
                    Some([x.number()? + CENTRE, y.number()? + CENTRE])
                };
                out.point(x.at, place, Some(name.located()))?;
            }
        }
    }
    Ok(rows.end())
}
