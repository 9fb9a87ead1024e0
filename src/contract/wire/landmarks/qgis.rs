//! Control points of the QGIS Georeferencer (`.points`): a header with
//! `mapX, mapY, sourceX, sourceY, enable` (`pixelX, pixelY` before QGIS 3.26), before which a line
//! `#CRS: ...` may stand. Only the position in the raster is read, as one side.
//!
//! Source: `qgsgcplist.cpp` of QGIS (`saveGcps`) and `saveGCPs` of the older
//! `qgsgeorefmainwindow.cpp`. A raster without georeference covers x from 0 to W and y from 0 down
//! to -H: corners are whole numbers, y points up, so y changes its sign and nothing is added. Rows
//! that are not enabled are checked and left out.

use super::bad::Bad;
use super::collect::Collector;
use super::table::{Table, TableRow, flag};
use super::{Format, FormatReader};

pub(super) const FORMAT: Format = Format {
    name: "qgis",
    title: "QGIS .points",
    items: "rasters",
    form: FormatReader::Table(is_qgis, read),
};

const X: [&str; 2] = ["sourcex", "pixelx"];
const Y: [&str; 2] = ["sourcey", "pixely"];

fn find(names: &[String], wanted: &[&str]) -> Option<usize> {
    names
        .iter()
        .position(|name| wanted.contains(&name.as_str()))
}

fn is_qgis(first: &TableRow) -> bool {
    first
        .as_header()
        .is_some_and(|names| find(&names, &["mapx"]).is_some())
}

fn read(table: Table<'_>, out: &mut Collector) -> Result<usize, Bad> {
    let Table {
        first: header,
        mut rows,
    } = table;
    let names = header.as_header().unwrap_or_default();
    let (Some(x), Some(y)) = (find(&names, &X), find(&names, &Y)) else {
        return Err(Bad::new(
            header.at,
            "expected the columns `sourceX`, `sourceY` (or `pixelX`, `pixelY`) of a QGIS .points \
                file",
        ));
    };
    let enable = find(&names, &["enable"]);
    while let Some(row) = rows.next_row()? {
        row.require_width(names.len(), "as the header has")?;
        let is_enabled = enable.map_or(Ok(true), |enable| flag(&row.fields[enable]))?;
        let place = [
            row.fields[x].located().number()?,
            0.0 - row.fields[y].located().number()?,
        ];
        if is_enabled {
            out.point(row.at, Some(place), None)?;
        } else {
            out.pass(row.at)?;
        }
    }
    Ok(rows.end())
}
