//! The warp object: what stays while q moves, and what is done with the result. Every field has a default.

use mlswarp::deform::{Handle, Method};
use mlswarp::warp::{Folds, GridSpec, RestSpec, Units};

use super::enum_name::{Metric, refuse, word};
use super::handles::{handles, weights};
use super::json::{Kind, Node};
use super::number::{count, number, positive};
use super::output::OutputPatch;
use super::{WarpObject, json};
use crate::problem::{Code, Problem};

/// The fields of the warp object, in the order in which [`WarpPatch::read`] takes them.
pub(crate) const FIELDS: [&str; 11] = ["p", "q", "weights", "method", "alpha", "point_mass", "units", "grid", "folds", "metric", "output"];

/// The fields of `/points`: those of the warp object, then its own.
pub(crate) const FIELDS_WITH_POINTS: [&str; 17] = [
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

/// The fields that a warp object gives: over the defaults it is a warp, over a session it is what replaces the session's.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct WarpPatch {
    /// Handles at rest.
    pub p: Option<Vec<Handle>>,
    /// Posed handles.
    pub q: Option<Vec<Handle>>,
    /// One a handle.
    pub weights: Option<Vec<f64>>,
    /// The class of maps.
    pub method: Option<Method>,
    /// Fall-off.
    pub alpha: Option<f64>,
    /// Mass of a point in a mixed set, px.
    pub point_mass: Option<f64>,
    /// Unit of p and q.
    pub units: Option<Units>,
    /// The grid.
    pub grid: Option<GridSpec>,
    /// What to do about folds.
    pub folds: Option<Folds>,
    /// How the picture is made.
    pub output: OutputPatch,
}

impl WarpPatch {
    /// Reads the object; a field that is not known is refused.
    /// Errors: A problem with the code and a JSON pointer.
    pub fn parse(json: &[u8]) -> Result<Self, Problem> {
        let root = json::root(json)?;
        Self::read(root.fields("an object", &FIELDS)?)
    }

    pub(crate) fn read(
        [p, q, weights_, method, alpha, point_mass, units, grid_, folds, metric, output]: [Option<Node<'_, '_>>; 11],
    ) -> Result<Self, Problem> {
        metric.map(|n| word::<Metric>(&n)).transpose()?;
        Ok(Self {
            p: p.map(|n| handles(&n)).transpose()?,
            q: q.map(|n| handles(&n)).transpose()?,
            weights: weights_.map(|n| weights(&n)).transpose()?,
            method: method.map(|n| word(&n)).transpose()?,
            alpha: alpha.map(|n| number(&n, "a number")).transpose()?,
            point_mass: point_mass.map(|n| number(&n, "a number of pixels")).transpose()?,
            units: units.map(|n| word(&n)).transpose()?,
            grid: grid_.map(|n| grid(&n)).transpose()?,
            folds: folds.map(|n| word(&n)).transpose()?,
            output: output.map(|n| OutputPatch::read(&n)).transpose()?.unwrap_or_default(),
        })
    }

    /// `base` with the given fields replaced. Weights belong to their handles: new `p` without weights have none. What had been left to its default
    /// (`alpha`, `point_mass`) is left to it again.
    pub fn merge_onto(self, base: WarpObject) -> WarpObject {
        let weights = if self.p.is_some() { self.weights } else { self.weights.or(base.rest.weights) };
        WarpObject {
            rest: RestSpec {
                p: self.p.unwrap_or(base.rest.p),
                weights,
                method: self.method.unwrap_or(base.rest.method),
                alpha: self.alpha.or(base.rest.alpha),
                point_mass: self.point_mass.or(base.rest.point_mass),
                units: self.units.unwrap_or(base.rest.units),
                grid: self.grid.unwrap_or(base.rest.grid),
            },
            q: self.q,
            folds: self.folds.unwrap_or(base.folds),
            output: self.output.merge_onto(&base.output),
        }
    }
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
