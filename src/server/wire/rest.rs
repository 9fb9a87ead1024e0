//! The warp object: rest handles, parameters and output. Every field has a default.

use mlswarp::deform::{Coincident, Handle, MAX_COORDINATE};
use mlswarp::geometry::Compact;
use mlswarp::warp::{Align, Folds, GridSpec, Method, RestSpec, Units};

use super::enum_name::{Metric, RequestedMethod, enum_name, unknown_name};
use super::handles::{handles, weights};
use super::json::{Kind, Node, optional};
use super::number::{count, number, number_in, positive};
use super::output::OutputPatch;
use super::{WarpObject, fields, json};
use crate::problem::{Code, Problem};

const COINCIDENT: &str = "an object, {\"policy\": \"mean\" or \"reject\", \"within\": px}";
const WITHIN: &str = "a distance in pixels, 0 to 1000000";
const GRID: &str = "`auto`, `pixel`, {\"tolerance\": px}, {\"cell\": px}, {\"columns\": n, \"rows\": m}";

/// The fields that a warp object gives. They replace the defaults, or the values of a session.
#[derive(Clone, Debug, Default, PartialEq)]
pub(crate) struct WarpPatch {
    pub(crate) p: Option<Vec<Handle>>,
    pub(crate) q: Option<Vec<Handle>>,
    pub(crate) align: Option<Align>,
    pub(crate) strength: Option<f64>,
    pub(crate) weights: Option<Vec<f64>>,
    pub(crate) method: Option<RequestedMethod>,
    pub(crate) alpha: Option<f64>,
    pub(crate) point_mass: Option<f64>,
    pub(crate) smoothing: Option<f64>,
    pub(crate) coincident: Option<Coincident>,
    pub(crate) units: Option<Units>,
    pub(crate) grid: Option<GridSpec>,
    pub(crate) folds: Option<Folds>,
    pub(crate) output: OutputPatch,
}

impl WarpPatch {
    pub(super) fn parse(json: &[u8]) -> Result<Self, Problem> {
        Self::read(json::root(json)?.fields(&fields::WARP)?)
    }

    pub(crate) fn read(
        [p, q, align, strength_, weights_, method, alpha, point_mass, smoothing, coincident_, units, grid_, folds, metric, output]: [Option<Node<'_, '_>>;
            15],
    ) -> Result<Self, Problem> {
        optional(metric, enum_name::<Metric>)?;
        Ok(Self {
            p: optional(p, handles)?,
            q: optional(q, handles)?,
            align: optional(align, enum_name)?,
            strength: optional(strength_, strength)?,
            weights: optional(weights_, weights)?,
            method: optional(method, enum_name)?,
            alpha: optional(alpha, |n| number(n, "a number"))?,
            point_mass: optional(point_mass, |n| number(n, "a number of pixels"))?,
            smoothing: optional(smoothing, |n| number(n, "a number"))?,
            coincident: optional(coincident_, coincident)?,
            units: optional(units, enum_name)?,
            grid: optional(grid_, grid)?,
            folds: optional(folds, enum_name)?,
            output: optional(output, OutputPatch::read)?.unwrap_or_default(),
        })
    }

    /// For a request whose handles are in landmark files.
    /// Errors: `bad_value` at the first field that says the same.
    pub(crate) fn require_no_handles(&self) -> Result<(), Problem> {
        let given = [("p", self.p.is_some()), ("q", self.q.is_some()), ("units", self.units.is_some())];
        match given.into_iter().find(|(_, is_given)| *is_given) {
            Some((name, _)) => {
                let detail = format!("both `{name}` and landmark files are given: the files say it already; leave `{name}` out");
                Err(Problem::new(Code::BadValue, detail).pointer(format!("/{name}")))
            }
            None => Ok(()),
        }
    }

    /// The object of a request that is not about a session.
    /// Errors: `bad_value` at `/p` if there are posed handles only.
    pub(crate) fn into_object(self) -> Result<WarpObject, Problem> {
        match (&self.p, &self.q) {
            (None, Some(q)) if !q.is_empty() => {
                Err(Problem::new(Code::BadValue, "`p` is missing: where do the handles start?").pointer("/p"))
            }
            _ => Ok(self.merge_onto(WarpObject::default())),
        }
    }

    /// `base` with the given fields replaced. Weights belong to their handles: new `p` without weights have none. Parameters belong to their
    /// method: another method that does not have them drops them.
    pub(crate) fn merge_onto(self, base: WarpObject) -> WarpObject {
        let weights = if self.p.is_some() { self.weights } else { self.weights.or(base.rest.weights) };
        let is_auto = self.method == Some(RequestedMethod::Auto);
        let method = self.method.and_then(RequestedMethod::method).unwrap_or(if is_auto { Method::default() } else { base.rest.method });
        let kept = |parameter: Option<f64>| parameter.filter(|_| !is_auto && method.is_like(base.rest.method));
        WarpObject {
            rest: RestSpec {
                p: self.p.unwrap_or(base.rest.p),
                weights,
                method,
                alpha: self.alpha.or(kept(base.rest.alpha)),
                point_mass: self.point_mass.or(kept(base.rest.point_mass)),
                smoothing: self.smoothing.or(kept(base.rest.smoothing)),
                coincident: self.coincident.unwrap_or(base.rest.coincident),
                units: self.units.unwrap_or(base.rest.units),
                grid: self.grid.unwrap_or(base.rest.grid),
                align: self.align.unwrap_or(base.rest.align),
            },
            q: self.q,
            strength: self.strength.unwrap_or(1.0),
            folds: self.folds.unwrap_or(base.folds),
            output: self.output.merge_onto(&base.output),
            is_auto,
        }
    }
}

/// How much of the way from p to q the handles are moved.
pub(crate) fn strength(node: &Node<'_, '_>) -> Result<f64, Problem> {
    number_in(node, RestSpec::STRENGTHS, "a number between -10 and 10, where 1 is 100 %")
}

fn coincident(node: &Node<'_, '_>) -> Result<Coincident, Problem> {
    if node.kind() != Kind::Object {
        return Err(node.unexpected(COINCIDENT, node.kind().name()));
    }
    let [policy, within] = node.fields(&fields::COINCIDENT)?;
    let distance = |node: &Node<'_, '_>| match number(node, WITHIN)? {
        value if (0.0..=MAX_COORDINATE).contains(&value) => Ok(value),
        value => Err(node.unexpected(WITHIN, Compact(value)).actual(value)),
    };
    Ok(Coincident { policy: optional(policy, enum_name)?.unwrap_or_default(), within: optional(within, distance)?.unwrap_or_default() })
}

fn grid(node: &Node<'_, '_>) -> Result<GridSpec, Problem> {
    match node.kind() {
        Kind::String => match node.string(GRID)?.as_str() {
            "auto" => Ok(GridSpec::Auto),
            "pixel" => Ok(GridSpec::Pixel),
            other => Err(unknown_name(node, other, &[], &["auto", "pixel"], GRID)),
        },
        Kind::Object => {
            let vertices = "a whole number of vertices, at least 2";
            match node.fields(&fields::GRID)? {
                [None, None, None, Some(tolerance)] => {
                    let (least, most) = GridSpec::TOLERANCES.into_inner();
                    let expected = format!("a number of pixels between {least} and {most}");
                    Ok(GridSpec::Tolerance(number_in(&tolerance, GridSpec::TOLERANCES, &expected)?))
                }
                [Some(cell), None, None, None] => Ok(GridSpec::Cell(positive(&cell, "a positive number of pixels")?)),
                [None, Some(columns), Some(rows), None] => {
                    Ok(GridSpec::Counts { columns: count(&columns, 2, vertices)?, rows: count(&rows, 2, vertices)? })
                }
                _ => Err(node.problem(
                    Code::BadValue,
                    format!("expected `tolerance` or `cell` alone, or `columns` and `rows`; a grid is one of {GRID}"),
                )),
            }
        }
        _ => Err(node.wrong_kind(&format!("one of {GRID}"))),
    }
}
