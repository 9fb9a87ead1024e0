//! The warp object: what stays while q moves, and what is done with the result. Every field has a default.

use super::WarpObject;
use super::handles::{handles, weights};
use super::json::{Kind, Node};
use super::number::{count, number, positive};
use super::output::OutputPatch;
use super::word::{Metric, refuse, word};
use crate::service::problem::{Code, Problem};
use crate::warp::{GridSpec, OutputSpec, RestSpec};

/// The fields of the warp object, in the order in which [`warp`] takes them.
pub(super) const FIELDS: [&str; 11] = ["p", "q", "weights", "method", "alpha", "point_mass", "units", "grid", "folds", "metric", "output"];

/// The fields of `/points`: those of the warp object, then its own.
pub(super) const FIELDS_WITH_POINTS: [&str; 17] = [
    "p",
    "q",
    "weights",
    "method",
    "alpha",
    "point_mass",
    "units",
    "grid",
    "folds",
    "metric",
    "output",
    "extent",
    "points",
    "polygons",
    "boxes",
    "inverse",
    "refine",
];

const GRID: &str = "`auto`, `pixel`, {\"cell\": px}, {\"columns\": n, \"rows\": m}";

pub(super) fn warp(
    [p, q, weights_, method, alpha, point_mass, units, grid_, folds, metric, output]: [Option<Node<'_, '_>>; 11],
) -> Result<WarpObject, Problem> {
    let rest = RestSpec {
        p: p.map(|n| handles(&n)).transpose()?.unwrap_or_default(),
        weights: weights_.map(|n| weights(&n)).transpose()?,
        method: method.map(|n| word(&n)).transpose()?.unwrap_or_default(),
        alpha: alpha.map(|n| number(&n, "a number")).transpose()?,
        point_mass: point_mass.map(|n| number(&n, "a number of pixels")).transpose()?,
        units: units.map(|n| word(&n)).transpose()?.unwrap_or_default(),
        grid: grid_.map(|n| grid(&n)).transpose()?.unwrap_or_default(),
    };
    metric.map(|n| word::<Metric>(&n)).transpose()?;
    Ok(WarpObject {
        rest,
        q: q.map(|n| handles(&n)).transpose()?,
        folds: folds.map(|n| word(&n)).transpose()?.unwrap_or_default(),
        output: output.map(|n| OutputPatch::read(&n)).transpose()?.unwrap_or_default().over(&OutputSpec::default()),
    })
}

fn grid(node: &Node<'_, '_>) -> Result<GridSpec, Problem> {
    match node.kind() {
        Kind::String => match node.string(GRID)?.as_str() {
            "auto" => Ok(GridSpec::Auto),
            "pixel" => Ok(GridSpec::Pixel),
            other => Err(refuse(node, other, &[], GRID)),
        },
        Kind::Object => {
            let vertices = "a whole number of vertices, at least 2";
            match node.fields(GRID, &["cell", "columns", "rows"])? {
                [Some(cell), None, None] => Ok(GridSpec::Cell(positive(&cell, "a positive number of pixels")?)),
                [None, Some(columns), Some(rows)] => {
                    Ok(GridSpec::Counts { columns: count(&columns, 2, vertices)?, rows: count(&rows, 2, vertices)? })
                }
                _ => Err(node.problem(Code::BadValue, format!("expected `cell` alone, or `columns` and `rows`; a grid is one of {GRID}"))),
            }
        }
        _ => Err(node.wrong_kind(&format!("one of {GRID}"))),
    }
}
