//! BigWarp's landmarks in JSON:
//! `{"type": "BigWarpLandmarks", "numDimensions": 2, "movingPoints", "fixedPoints",
//! "active", "names"}`,
//! by itself, as `landmarks`, or as `Transform.landmarks` in a project. Moving is `p`, fixed is
//! `q`.
//!
//! Source: `LandmarkTableModel.java` of BigWarp (`toJson`) and `TransformWriterJson.java`. As in
//! its CSV the centre of the first pixel is 0, 0 (of an image that is not calibrated): 1/2 is
//! added. Landmarks that are not active are checked and left out.

use super::bad::{Bad, BadJson};
use super::collect::{Collector, Located};
use super::json::ObjectMembers;
use super::{Format, FormatReader, offset};
use crate::problem::Problem;
use crate::wire::json::{Kind, Node};
use crate::wire::number::number;

pub(super) const FORMAT: Format = Format {
    name: "bigwarp",
    title: "BigWarp JSON",
    items: "tables",
    form: FormatReader::Json(is_bigwarp, read),
};
const CENTRE: f64 = 0.5;
const POINTS: &str = "an array of positions, [x, y] each";

fn is_bigwarp(fields: &ObjectMembers<'_>) -> bool {
    let is_object = |name: &str| fields.kind(name) == Some(Kind::Object);
    !fields.is_list
        && (fields.has("movingPoints") || is_object("landmarks") || is_object("Transform"))
}

fn read(text: &str, root: &Node<'_, '_>, out: &mut Collector) -> Result<usize, BadJson> {
    let [landmarks, transform] = root.find(&["landmarks", "Transform"])?;
    match (landmarks, transform) {
        (Some(table), _) => read_table(text, &table, out),
        (None, Some(transform)) => {
            let [landmarks] = transform.find(&["landmarks"])?;
            let missing = || {
                Bad::new(
                    offset(text, &transform),
                    "expected `landmarks` in `Transform`; found a transform without them",
                )
            };
            read_table(text, &landmarks.ok_or_else(missing)?, out)
        }
        (None, None) => read_table(text, root, out),
    }
}

fn read_table(text: &str, table: &Node<'_, '_>, out: &mut Collector) -> Result<usize, BadJson> {
    let [moving, fixed, active, names] =
        table.find(&["movingPoints", "fixedPoints", "active", "names"])?;
    let moving = moving.ok_or_else(|| table.missing("movingPoints", POINTS))?;
    let fixed = fixed.ok_or_else(|| table.missing("fixedPoints", POINTS))?;
    let p = points(text, &moving, out)?;
    let q = points(text, &fixed, out)?;
    let mut is_active = Vec::new();
    active.map_or(Ok(()), |list| {
        list.items::<BadJson>("an array of booleans", |k, item| {
            out.require_below(offset(text, &item), k + 1)?;
            is_active.push(item.bool()?);
            Ok(())
        })
    })?;
    let names = names
        .map(|names| super::own::read_names(text, &names, p.len()))
        .transpose()?;
    if q.len() != p.len() || !(is_active.is_empty() || is_active.len() == p.len()) {
        let detail = format!(
            "expected {} fixed points and flags, as moving points; found {} and {}",
            p.len(),
            q.len(),
            is_active.len()
        );
        return Err(Bad::new(offset(text, &fixed), detail).into());
    }
    for (k, ((at, p), (_, q))) in p.into_iter().zip(q).enumerate() {
        if is_active.get(k) == Some(&false) {
            out.pass(at)?;
            continue;
        }
        let name = names.as_ref().map(|names| Located {
            at: names[k].0,
            text: &names[k].1,
        });
        out.pair(at, [Some(p), Some(q)], name)?;
    }
    Ok(offset(text, table))
}

fn points(
    text: &str,
    list: &Node<'_, '_>,
    out: &Collector,
) -> Result<Vec<(usize, [f64; 2])>, BadJson> {
    let mut points = Vec::new();
    list.items::<BadJson>(POINTS, |index, item| {
        let at = offset(text, &item);
        out.require_below(at, index + 1)?;
        let (mut place, mut count) = ([0.0; 2], 0);
        item.items::<Problem>(POINTS, |axis, value| {
            if let Some(coordinate) = place.get_mut(axis) {
                *coordinate = number(&value, "a number")? + CENTRE;
            }
            count += 1;
            Ok(())
        })?;
        if count != 2 {
            return Err(Bad::new(
                at,
                format!("expected landmarks in 2 dimensions; found {count}"),
            )
            .into());
        }
        points.push((at, place));
        Ok(())
    })?;
    Ok(points)
}
