//! Points of a napari layer, CSV: `index, axis-0, axis-1` and the properties of the points. The
//! last axis is x and the one before y. Further axes are those of a stack, and their values are the
//! item: one slice, or one time. A property `name`, `label` or `id` is the name.
//!
//! Source: `napari_builtins/io/_write.py` (`napari_write_points`). Positions are pixel indices,
//! whose whole numbers are the centres of pixels (`napari/layers/shapes/shapes.py`: "Point
//! coordinates land on pixel centers"): 1/2 is added.

use super::bad::Bad;
use super::collect::Collector;
use super::csv::NAMES;
use super::table::{Table, TableRow};
use super::{Format, FormatReader};

pub(super) const FORMAT: Format = Format {
    name: "napari",
    title: "napari points",
    items: "slices",
    form: FormatReader::Table(is_napari, read),
};
const CENTRE: f64 = 0.5;

/// The columns of the axes, in their order.
fn axes(names: &[String]) -> Vec<usize> {
    let axis = |n: usize| names.iter().position(|name| *name == format!("axis-{n}"));
    (0..names.len()).map_while(axis).collect()
}

fn is_napari(first: &TableRow) -> bool {
    first
        .as_header()
        .is_some_and(|names| axes(&names).len() > 1)
}

fn read(table: Table<'_>, out: &mut Collector) -> Result<usize, Bad> {
    let Table {
        first: header,
        mut rows,
    } = table;
    let names = header.as_header().unwrap_or_default();
    if let Some(shapes) = names.iter().position(|name| name == "shape-type") {
        let detail = "expected a napari points layer; found a shapes layer: copy its vertices to \
            a points layer and save that";
        return Err(Bad::new(header.fields[shapes].at, detail));
    }
    let axes = axes(&names);
    let [stack @ .., y, x] = &axes[..] else {
        return Ok(rows.end());
    };
    let name = NAMES
        .iter()
        .find_map(|wanted| names.iter().position(|name| name == wanted));
    let (mut slice, mut is_wanted) = (None, true);
    while let Some(row) = rows.next_row()? {
        row.require_width(names.len(), "as the header has")?;
        let number = |field: usize| row.fields[field].located().number();
        let place = [number(*x)? + CENTRE, number(*y)? + CENTRE];
        let of_row: Vec<&str> = stack
            .iter()
            .map(|axis| row.fields[*axis].text.trim())
            .collect();
        let of_row = of_row.join(",");
        if !stack.is_empty() && slice.as_ref() != Some(&of_row) {
            is_wanted = out.item(row.at, &[&of_row])?;
            slice = Some(of_row);
        }
        if is_wanted {
            out.point(
                row.at,
                Some(place),
                name.map(|name| row.fields[name].located()),
            )?;
        }
    }
    Ok(rows.end())
}
