//! The warp object: rest handles, parameters and output. Every field has a default.

use mlswarp::deform::{Coincident, Handle, MAX_COORDINATE, METHODS, Parameter, Parameters};
use mlswarp::geometry::DisplayNumber;
use mlswarp::warp::{Align, Folds, GridSpec, Method, Metric, RestSpec, Units};

use super::enum_name::{RequestedMethod, enum_name, unknown_name};
use super::fields::WarpFields;
use super::handles::{depths, handles, weights};
use super::json::{Kind, Node, OptionalNode, optional};
use super::landmarks::{Choice, Item, is_format, without_files};
use super::number::{count, number, number_in, positive};
use super::output::OutputPatch;
use super::{WarpObject, fields, json, suggest};
use crate::problem::words::advice;
use crate::problem::{Code, Problem};

const COINCIDENT: &str = "an object, {\"policy\": \"mean\" or \"reject\", \"within\": px}";
const WITHIN: &str = "a distance in pixels, 0 to 1000000";
const GRID: &str =
    "`auto`, `pixel`, {\"tolerance\": px}, {\"cell\": px}, {\"columns\": n, \"rows\": m}";

/// The fields that a warp object gives. They replace the defaults, or the values of a session.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct WarpPatch {
    /// Handles at rest.
    pub p: Option<Vec<Handle>>,
    /// Posed handles.
    pub q: Option<Vec<Handle>>,
    /// What of the motion is taken out of q first.
    pub align: Option<Align>,
    /// How much of the way from p to q the handles are moved.
    pub strength: Option<f64>,
    /// One for each handle.
    pub weights: Option<Vec<f64>>,
    /// One for each handle: which of what overlaps is in front.
    pub depth: Option<Vec<f64>>,
    /// The method.
    pub method: Option<RequestedMethod>,
    /// Exponent of the fall-off.
    pub alpha: Option<f64>,
    /// Mass of a point beside lines, px.
    pub point_mass: Option<f64>,
    /// Smoothing of a spline.
    pub smoothing: Option<f64>,
    /// Parameters in the objects of methods.
    pub own: Option<Parameters>,
    /// The metric.
    pub metric: Option<Metric>,
    /// The share of full alpha above which a pixel belongs to the mask.
    pub mask_threshold: Option<f64>,
    /// What becomes of coincident handles.
    pub coincident: Option<Coincident>,
    /// Units of positions.
    pub units: Option<Units>,
    /// The grid of the mesh.
    pub grid: Option<GridSpec>,
    /// The treatment of folds.
    pub folds: Option<Folds>,
    /// How the image is made.
    pub output: OutputPatch,
    /// Whether landmarks were left out because one side does not have them.
    pub has_unmatched: bool,
    /// What is read from landmark files.
    pub choice: Choice,
}

impl WarpPatch {
    pub(super) fn parse(json: &[u8]) -> Result<Self, Problem> {
        Self::read_all(json::root(json)?.fields(&fields::WARP)?)
    }

    /// Reads the fields of the list `WARP`.
    pub(crate) fn read_all(
        nodes: [OptionalNode<'_, '_>; fields::WARP.len()],
    ) -> Result<Self, Problem> {
        let (fields, objects) = WarpFields::split(nodes);
        Self::read(fields, &objects)
    }

    /// `objects`: those of methods, in the order of `METHOD_OBJECTS`.
    pub(crate) fn read(
        fields: WarpFields<Node<'_, '_>>,
        objects: &[OptionalNode<'_, '_>],
    ) -> Result<Self, Problem> {
        let p = optional(fields.p, handles)?;
        let has_unmatched = of_landmarks(&fields, p.as_deref())?;
        Ok(Self {
            p,
            q: optional(fields.q, handles)?,
            align: optional(fields.align, enum_name)?,
            strength: optional(fields.strength, strength)?,
            weights: optional(fields.weights, weights)?,
            depth: optional(fields.depth, depths)?,
            method: optional(fields.method, enum_name)?,
            alpha: optional(fields.alpha, |n| number(n, "a number"))?,
            point_mass: optional(fields.point_mass, |n| number(n, "a number of pixels"))?,
            smoothing: optional(fields.smoothing, |n| number(n, "a number"))?,
            own: own_parameters(objects)?,
            metric: optional(fields.metric, enum_name)?,
            mask_threshold: optional(fields.mask, mask)?.flatten(),
            coincident: optional(fields.coincident, coincident)?,
            units: optional(fields.units, enum_name)?,
            grid: optional(fields.grid, grid)?,
            folds: optional(fields.folds, enum_name)?,
            output: optional(fields.output, OutputPatch::read)?.unwrap_or_default(),
            has_unmatched,
            choice: Choice {
                matching: optional(fields.matching, enum_name)?,
                item: optional(fields.item, Item::read)?,
            },
        })
    }

    /// For a request whose handles are in landmark files, from which the chosen ones have been
    /// read. Errors: `bad_value` at the first field that says the same.
    pub fn require_no_handles(&mut self) -> Result<(), Problem> {
        self.choice = Choice::default();
        let given = [
            ("p", self.p.is_some()),
            ("q", self.q.is_some()),
            ("units", self.units.is_some()),
        ];
        require_no_handles(|name| given.contains(&(name, true)))
    }

    /// Errors: `bad_value` at a field that belongs to landmark files, of which there are none.
    pub fn without_files(self) -> Result<Self, Problem> {
        match self.choice.given_item() {
            Some(name) => Err(without_files(name).pointer(format!("/{name}"))),
            None => Ok(self),
        }
    }

    /// The object of a request that is not about a session.
    /// Errors: `bad_value` at `/p` if there are posed handles only; as [`Self::without_files`].
    pub fn into_object(self) -> Result<WarpObject, Problem> {
        let patch = self.without_files()?;
        match (&patch.p, &patch.q) {
            (None, Some(q)) if !q.is_empty() => Err(Problem::new(
                Code::BadValue,
                "`p` is missing: where do the handles start?",
            )
            .pointer("/p")),
            _ => Ok(patch.merge_onto(WarpObject::default())),
        }
    }

    /// `base` with the given fields replaced. Weights, depths and pose belong to their handles:
    /// other `p` without them have none. Parameters belong to their method: another method that
    /// does not have them drops them.
    pub fn merge_onto(self, base: WarpObject) -> WarpObject {
        let weights = if self.p.is_some() {
            self.weights
        } else {
            self.weights.or(base.rest.weights)
        };
        let depth = if self.p.is_some() {
            self.depth
        } else {
            self.depth.or(base.rest.depth)
        };
        let has_unmatched = self.has_unmatched || self.p.is_none() && base.rest.has_unmatched;
        let is_auto = self.method == Some(RequestedMethod::Auto);
        let method = self
            .method
            .and_then(RequestedMethod::method)
            .unwrap_or(if is_auto {
                Method::default()
            } else {
                base.rest.method
            });
        // So does a threshold to its metric.
        let metric = self.metric.unwrap_or(base.rest.metric);
        let kept_threshold = base.rest.mask_threshold;
        let is_like = method.info().has_parameters_of(base.rest.method.info());
        let kept = |parameter: Option<f64>| parameter.filter(|_| !is_auto && is_like);
        let kept_own = Some(base.rest.own).filter(|_| !is_auto && is_like);
        // A pose belongs to its handles, and a strength to its pose.
        let is_posed_so = self.p.as_ref().is_none_or(|p| *p == base.rest.p);
        let kept_strength = if self.q.is_none() && is_posed_so {
            base.strength
        } else {
            1.0
        };
        WarpObject {
            rest: RestSpec {
                p: self.p.unwrap_or(base.rest.p),
                weights,
                depth,
                method,
                alpha: self.alpha.or(kept(base.rest.alpha)),
                point_mass: self.point_mass.or(kept(base.rest.point_mass)),
                smoothing: self.smoothing.or(kept(base.rest.smoothing)),
                own: self.own.or(kept_own).unwrap_or_default(),
                metric,
                mask_threshold: self
                    .mask_threshold
                    .or(kept_threshold.filter(|_| metric == base.rest.metric)),
                mask: None,
                coincident: self.coincident.unwrap_or(base.rest.coincident),
                units: self.units.unwrap_or(base.rest.units),
                grid: self.grid.unwrap_or(base.rest.grid),
                align: self.align.unwrap_or(base.rest.align),
                has_unmatched,
            },
            q: self.q.or(base.q.filter(|_| is_posed_so)),
            strength: self.strength.unwrap_or(kept_strength),
            folds: self.folds.unwrap_or(base.folds),
            output: self.output.merge_onto(&base.output),
            is_auto,
        }
    }
}

/// The parameters in the objects of methods; `None` if there is no object.
fn own_parameters(objects: &[Option<Node<'_, '_>>]) -> Result<Option<Parameters>, Problem> {
    let mut own: Option<Parameters> = None;
    for (node, name) in objects.iter().zip(fields::METHOD_OBJECTS) {
        let Some(node) = node else { continue };
        let owner = METHODS.iter().find(|info| info.name == name);
        let parameters = owner.map_or(&[][..], |info| info.parameters);
        let names: Vec<&str> = parameters.iter().map(Parameter::name).collect();
        let given = node.fields_of(&names)?;
        for (parameter, node) in parameters.iter().zip(given) {
            let value = optional(node, |node| number(node, "a number"))?;
            own = Some(own.unwrap_or_default().with_some(parameter.path, value));
        }
    }
    Ok(own)
}

/// For a request whose handles are in landmark files.
/// Errors: `bad_value` at the first given field that says the same.
pub(crate) fn require_no_handles(is_given: impl Fn(&str) -> bool) -> Result<(), Problem> {
    match ["p", "q", "units"].into_iter().find(|name| is_given(name)) {
        Some(name) => {
            let detail = format!(
                "both `{name}` and landmark files are given: the files say it already; leave \
                    `{name}` out"
            );
            Err(Problem::new(Code::BadValue, detail).pointer(format!("/{name}")))
        }
        None => Ok(()),
    }
}

/// Checks the fields that only the response of `POST /landmarks` has. `names` and `format` say
/// nothing more; the result: whether landmarks are `unmatched`.
fn of_landmarks(fields: &WarpFields<Node<'_, '_>>, p: Option<&[Handle]>) -> Result<bool, Problem> {
    const NAMES: &str = "an array of names, one for each handle";
    // None of them is kept.
    let count = |node: &Node<'_, '_>| {
        let mut count = 0;
        node.items(NAMES, |_, item| item.string("a name").map(|_| count += 1))
            .map(|()| count)
    };
    if let Some(node) = fields.names {
        let (found, handles) = (count(&node)?, p.map(<[_]>::len));
        if handles.is_some_and(|handles| handles != found) {
            return Err(node.problem(
                Code::ShapeMismatch,
                format!(
                    "`names` has {found}, but `p` has {}",
                    handles.unwrap_or_default()
                ),
            ));
        }
    }
    if let Some(node) = fields.format
        && !(node.kind() == Kind::String && is_format(&node.string("a format")?))
    {
        // The format of a picture stands elsewhere.
        let hint = suggest::field("format", &fields::useful(&fields::WARP));
        let detail = format!(
            "unknown field: `format`{}",
            advice(hint, "the format of a landmark file is its only value")
        );
        return Err(Problem::new(Code::UnknownField, detail).pointer("/format"));
    }
    optional(fields.unmatched, |node| {
        let [p, q] = node.fields(&["p", "q"])?;
        Ok(optional(p, count)?.unwrap_or_default() + optional(q, count)?.unwrap_or_default() > 0)
    })
    .map(Option::unwrap_or_default)
}

/// How much of the way from p to q the handles are moved.
pub(crate) fn strength(node: &Node<'_, '_>) -> Result<f64, Problem> {
    number_in(
        node,
        RestSpec::STRENGTHS,
        "a number between -10 and 10, where 1 is 100 %",
    )
}

/// The threshold of the mask; `None` if it is the default.
fn mask(node: &Node<'_, '_>) -> Result<Option<f64>, Problem> {
    let expected = "an object, {\"threshold\": share of full alpha}";
    if node.kind() != Kind::Object {
        return Err(node.unexpected(expected, node.kind().name()));
    }
    let [threshold] = node.fields(&fields::MASK)?;
    let share = |node: &Node<'_, '_>| {
        number_in(
            node,
            0.0..=1.0,
            "a number between 0 and 1, where 1 is opaque",
        )
    };
    optional(threshold, share)
}

fn coincident(node: &Node<'_, '_>) -> Result<Coincident, Problem> {
    if node.kind() != Kind::Object {
        return Err(node.unexpected(COINCIDENT, node.kind().name()));
    }
    let [policy, within] = node.fields(&fields::COINCIDENT)?;
    let distance = |node: &Node<'_, '_>| match number(node, WITHIN)? {
        value if (0.0..=MAX_COORDINATE).contains(&value) => Ok(value),
        value => Err(node.unexpected(WITHIN, DisplayNumber(value)).actual(value)),
    };
    Ok(Coincident {
        policy: optional(policy, enum_name)?.unwrap_or_default(),
        within: optional(within, distance)?.unwrap_or_default(),
    })
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
                    let (least, most) = GridSpec::TOLERANCE_RANGE_PX.into_inner();
                    let expected = format!("a number of pixels between {least} and {most}");
                    Ok(GridSpec::Tolerance(number_in(
                        &tolerance,
                        GridSpec::TOLERANCE_RANGE_PX,
                        &expected,
                    )?))
                }
                [Some(cell), None, None, None] => Ok(GridSpec::Cell(positive(
                    &cell,
                    "a positive \
                    number of pixels",
                )?)),
                [None, Some(columns), Some(rows), None] => Ok(GridSpec::Counts {
                    columns: count(&columns, 2, vertices)?,
                    rows: count(&rows, 2, vertices)?,
                }),
                _ => Err(node.problem(
                    Code::BadValue,
                    format!(
                        "expected `tolerance` or `cell` alone, or `columns` and `rows`; a \
                        grid is one of {GRID}"
                    ),
                )),
            }
        }
        _ => Err(node.wrong_kind(&format!("one of {GRID}"))),
    }
}
