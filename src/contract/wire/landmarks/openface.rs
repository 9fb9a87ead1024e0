//! Facial landmarks of OpenFace, CSV: `frame, face_id, timestamp, confidence, success`, then `x_0`
//! to `x_67` and `y_0` to `y_67`, among many other columns. A row is an item, named by its frame
//! (and its face, where a frame has several).
//!
//! Source: the page "Output Format" of OpenFace's wiki ("x_0, x_1, ... y_67: location of 2D
//! landmarks in pixels"). They are the coordinates of OpenCV, whose whole numbers are the centres
//! of pixels: 1/2 is added.

use super::bad::Bad;
use super::collect::Collector;
use super::table::{Table, TableRow};
use super::{Format, FormatReader};

pub(super) const FORMAT: Format = Format {
    name: "openface",
    title: "OpenFace CSV",
    items: "rows",
    form: FormatReader::Table(is_openface, read),
};
const CENTRE: f64 = 0.5;

/// The columns of x and y of each landmark.
fn landmarks(names: &[String]) -> Vec<[usize; 2]> {
    let columns: std::collections::HashMap<&str, usize> = names
        .iter()
        .enumerate()
        .map(|(k, name)| (name.as_str(), k))
        .collect();
    let place = |k: usize| {
        Some([
            *columns.get(format!("x_{k}").as_str())?,
            *columns.get(format!("y_{k}").as_str())?,
        ])
    };
    (0..names.len()).map_while(place).collect()
}

fn is_openface(first: &TableRow) -> bool {
    first
        .as_header()
        .is_some_and(|names| !landmarks(&names).is_empty())
}

fn read(table: Table<'_>, out: &mut Collector) -> Result<usize, Bad> {
    let Table {
        first: header,
        mut rows,
    } = table;
    let names = header.as_header().unwrap_or_default();
    let landmarks = landmarks(&names);
    let find = |wanted: &str| names.iter().position(|name| name == wanted);
    let (frame, face, success) = (
        find("frame"),
        find("face_id").or(find("face")),
        find("success"),
    );
    while let Some(row) = rows.next_row()? {
        row.require_width(names.len(), "as the header has")?;
        let text = |field: Option<usize>| field.map_or("", |field| row.fields[field].text.trim());
        let both = format!("{},{}", text(frame), text(face));
        if !out.item(row.at, &[text(frame), &both])? {
            continue;
        }
        if let Some(success) = success.filter(|field| {
            row.fields[*field]
                .located()
                .number()
                .is_ok_and(|success| success < 0.5)
        }) {
            let detail = "expected a row in which a face was found; found `success` 0: choose \
                another `item`";
            return Err(Bad::new(row.fields[success].at, detail));
        }
        for [x, y] in &landmarks {
            let (x, y) = (row.fields[*x].located(), row.fields[*y].located());
            out.point(
                x.at,
                Some([x.number()? + CENTRE, y.number()? + CENTRE]),
                None,
            )?;
        }
    }
    Ok(rows.end())
}
