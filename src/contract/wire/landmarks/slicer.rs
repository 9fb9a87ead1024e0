//! Markups of 3D Slicer: `.mrk.json`,
//! `{"markups": [{"coordinateSystem", "controlPoints": [{"label", "position": [x, y, z]}]}]}`, and
//! `.fcsv`, a table below comments, of which one says `# CoordinateSystem = LPS`. Both have world
//! coordinates, in mm, which only the image can turn into pixels: they are refused with the
//! conversion. Read are indices, which scripts write (`IJK`), as points of one slice.
//!
//! Source: 3D Slicer, "Markups" in its developer guide. The index of the first pixel is 0, 0, its
//! centre: 1/2 is added.

use super::bad::{Bad, BadJson};
use super::collect::{Collector, Located};
use super::item::name_in;
use super::json::ObjectMembers;
use super::table::Table;
use super::words::Lines;
use super::{Format, FormatReader, SourceText, offset};
use crate::problem::Problem;
use crate::problem::words::quote;
use crate::wire::json::{Kind, Node, optional};
use crate::wire::number::number;

pub(super) const JSON: Format = Format {
    name: "slicer",
    title: "3D Slicer",
    items: "markups",
    form: FormatReader::Json(is_markups, read_json),
};
pub(super) const FCSV: Format = Format {
    name: "slicer",
    title: ".fcsv",
    items: "markups",
    form: FormatReader::Head(is_fcsv, read_fcsv),
};
const CENTRE: f64 = 0.5;
const MARKUPS: &str = "an array of markups";
const POINTS: &str = "an array of control points";
const POSITION: &str = "a position, [x, y, z]";
const CONVERSION: &str = "send CSV with x = (position - origin) / spacing + 0.5 and y likewise, \
    with origin and spacing of the image in the \
                          same coordinates (those of RAS are those of LPS with the other signs of \
                          x and y)";

fn is_markups(fields: &ObjectMembers<'_>) -> bool {
    !fields.is_list && fields.kind("markups") == Some(Kind::Array)
}

fn is_fcsv(head: &str) -> bool {
    head.starts_with("# Markups fiducial file")
}

/// Errors: World coordinates.
fn require_indices(at: usize, system: &str) -> Result<(), Bad> {
    if system.eq_ignore_ascii_case("IJK") {
        return Ok(());
    }
    let system = match system {
        "0" => "RAS",
        "" | "1" => "LPS",
        other => other,
    };
    Err(Bad::new(
        at,
        format!(
            "expected positions in pixels; found world coordinates of 3D Slicer, {}, in mm: \
                {CONVERSION}",
            quote(system)
        ),
    ))
}

fn read_json(text: &str, root: &Node<'_, '_>, out: &mut Collector) -> Result<usize, BadJson> {
    let [markups] = root.find(&["markups"])?;
    let markups = markups.ok_or_else(|| root.missing("markups", MARKUPS))?;
    markups.items::<BadJson>(MARKUPS, |_, list| {
        let at = offset(text, &list);
        let [kind, system, points] = list.find(&["type", "coordinateSystem", "controlPoints"])?;
        let kind = optional(kind, name_in)?.unwrap_or_default();
        if !out.item(at, &[&kind])? {
            return Ok(());
        }
        let system_at = system.as_ref().map_or(at, |system| offset(text, system));
        require_indices(system_at, &optional(system, name_in)?.unwrap_or_default())?;
        let points = points.ok_or_else(|| list.missing("controlPoints", POINTS))?;
        points.items::<BadJson>(POINTS, |_, point| {
            let at = offset(text, &point);
            let [label, position, status] = point.find(&["label", "position", "positionStatus"])?;
            let label_at = label.as_ref().map_or(at, |label| offset(text, label));
            let label = optional(label, name_in)?.unwrap_or_default();
            let is_defined = status.is_none_or(|status| status.text == "\"defined\"");
            let place = position
                .filter(|_| is_defined)
                .map(|position| indices(&position))
                .transpose()?;
            Ok(out.point(
                at,
                place,
                Some(Located {
                    at: label_at,
                    text: &label,
                }),
            )?)
        })
    })?;
    Ok(offset(text, &markups))
}

fn indices(position: &Node<'_, '_>) -> Result<[f64; 2], Problem> {
    let (mut place, mut count) = ([0.0; 2], 0);
    position.items::<Problem>(POSITION, |axis, value| {
        let value = number(&value, "a number")?;
        if let Some(place) = place.get_mut(axis) {
            *place = value + CENTRE;
        }
        count += 1;
        Ok(())
    })?;
    if count == 3 {
        Ok(place)
    } else {
        Err(position.unexpected(POSITION, format_args!("{count} numbers")))
    }
}

fn read_fcsv(source: SourceText<'_>, out: &mut Collector) -> Result<usize, Bad> {
    let mut lines = Lines::new(source, false);
    let (mut system, mut columns) = (None, None);
    while let Some(line) = lines.next_line()? {
        let Some(comment) = line.text.strip_prefix('#') else {
            break;
        };
        let setting = comment
            .split_once('=')
            .map(|(name, value)| (name.trim(), value.trim()));
        match setting {
            Some(("CoordinateSystem", value)) => system = Some((line.at, value)),
            Some(("columns", value)) => columns = Some(value),
            _ => {}
        }
    }
    let (at, system) = system.unwrap_or((source.start, "0"));
    require_indices(at, system)?;
    let names: Vec<&str> = columns
        .unwrap_or("id,x,y,z,ow,ox,oy,oz,vis,sel,lock,label")
        .split(',')
        .map(str::trim)
        .collect();
    let column = |name: &str| names.iter().position(|other| *other == name);
    let (Some(x), Some(y)) = (column("x"), column("y")) else {
        return Err(Bad::new(at, "expected the columns `x` and `y`; found none"));
    };
    let Table { first, mut rows } = Table::new(source)?;
    let mut next = Some(first);
    while let Some(row) = next {
        let field = |index: usize| row.fields.get(index).map(super::table::TableField::located);
        let number = |index: usize| {
            field(index)
                .unwrap_or(Located {
                    at: row.at,
                    text: "",
                })
                .number()
        };
        let label = column("label").and_then(field);
        out.point(
            row.at,
            Some([number(x)? + CENTRE, number(y)? + CENTRE]),
            label,
        )?;
        next = rows.next_row()?;
    }
    Ok(rows.end())
}
