//! Annotations of labelme: `{"shapes": [{"label", "shape_type", "points"}], ...}`. `point` becomes
//! a point; `line`, `linestrip` and `polygon` become lines, a polygon ends where it begins. The
//! label is the name.
//!
//! Source: `labelme/_label_file.py` and the canvas, whose positions are those of the pixmap: the
//! corner of the image is 0, 0, as in the contract. Nothing is added.

use mlswarp::deform::Handle;
use mlswarp::geometry::Point;

use super::bad::{Bad, BadJson};
use super::collect::{Collector, Landmark, Located};
use super::json::ObjectMembers;
use super::{Format, FormatReader, offset};
use crate::problem::Problem;
use crate::problem::words::quote;
use crate::wire::handles::{PLACE, place};
use crate::wire::json::{Node, optional};

pub(super) const FORMAT: Format = Format {
    name: "labelme",
    title: "labelme",
    items: "images",
    form: FormatReader::Json(is_labelme, read),
};
const SHAPES: &str = "an array of shapes";
const POINTS: &str = "an array of positions";
const TYPES: &str = "`point`, `line`, `linestrip` or `polygon`";

fn is_labelme(fields: &ObjectMembers<'_>) -> bool {
    !fields.is_list && fields.has("shapes")
}

fn read(text: &str, root: &Node<'_, '_>, out: &mut Collector) -> Result<usize, BadJson> {
    let [shapes] = root.find(&["shapes"])?;
    let shapes = shapes.ok_or_else(|| root.missing("shapes", SHAPES))?;
    shapes.items::<BadJson>(SHAPES, |_, shape| {
        let at = offset(text, &shape);
        let [label, kind, points] = shape.find(&["label", "shape_type", "points"])?;
        let (label_at, label) = match &label {
            Some(label) => (offset(text, label), label.string("a label")?),
            None => (at, String::new()),
        };
        // Older versions had polygons alone.
        let kind_at = kind.as_ref().map_or(at, |kind| offset(text, kind));
        let kind =
            optional(kind, |kind| kind.string(TYPES))?.unwrap_or_else(|| "polygon".to_owned());
        let fewest = match kind.as_str() {
            "point" => 1,
            "line" | "linestrip" | "polygon" => 2,
            other => {
                return Err(Bad::new(
                    kind_at,
                    format!(
                        "expected a shape of the type {TYPES}; found {}",
                        quote(other)
                    ),
                )
                .into());
            }
        };
        let points = points.ok_or_else(|| shape.missing("points", POINTS))?;
        let count = count(&points)?;
        let is_count = if fewest == 1 {
            count == 1
        } else {
            count >= fewest
        };
        if !is_count {
            let expected = if fewest == 1 {
                "1 position"
            } else {
                "at least 2 positions"
            };
            return Err(Bad::new(
                offset(text, &points),
                format!("expected {expected} in a {kind}; found {count}"),
            )
            .into());
        }
        out.count(at, count + usize::from(kind == "polygon"))?;
        let mut positions = Vec::with_capacity(count + 1);
        points.items::<Problem>(POINTS, |_, item| {
            positions.push(place(&item, PLACE)?);
            Ok(())
        })?;
        if kind == "polygon" && positions.first() != positions.last() {
            positions.extend(positions.first().copied());
        }
        let name = Some(Located {
            at: label_at,
            text: &label,
        });
        Ok(out.push(Landmark {
            at,
            p: handle(positions),
            q: None,
            name,
        })?)
    })?;
    Ok(offset(text, &shapes))
}

fn handle(positions: Vec<Point>) -> Handle {
    match positions[..] {
        [point] => Handle::Point(point),
        _ => Handle::Polyline(positions),
    }
}

fn count(list: &Node<'_, '_>) -> Result<usize, Problem> {
    let mut count = 0;
    list.items::<Problem>(POINTS, |_, _| {
        count += 1;
        Ok(())
    })?;
    Ok(count)
}
