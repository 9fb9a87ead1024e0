//! `/fit`: the request, the response, and `method: auto`, which applies the best candidate to a
//! warp object.

use mlswarp::deform::{Handle, IsCancelled};
use mlswarp::pixmap::Extent;
use mlswarp::warp::{Candidate, Fit, Method, Prediction, RestSpec, WarpError};
use serde::ser::{Serialize, SerializeMap, SerializeSeq, Serializer};

use super::enum_name::{EnumName as _, enum_name};
use super::fields::{FitFields, WarpFields};
use super::json::{Node, optional};
use super::number::number;
use super::rest::WarpPatch;
use super::{AsJson, EXTENT, PosePatch, fields, json, size};
use crate::problem::{Code, Problem};

/// The most candidates of a request.
const MAX_CANDIDATES: usize = 64;
const CANDIDATES: &str = "an array of 1 to 64 candidates";
/// Bytes of text of an ordinary candidate.
const CANDIDATE_TEXT: usize = 30;

/// The body of `/fit` and `/sessions/{id}/fit`.
#[derive(Clone, Debug, PartialEq)]
pub struct FitObject {
    /// With `/fit` only: points at rest with their weights, and the extent `[W, H]`.
    pub rest: Option<(RestSpec, Extent)>,
    /// Posed points.
    pub pose: PosePatch,
    /// The methods that are compared.
    pub candidates: Vec<Candidate>,
}

impl FitObject {
    /// Reads the body of `/fit`.
    pub(super) fn parse(json: &[u8]) -> Result<Self, Problem> {
        let root = json::root(json)?;
        let fields = FitFields::from(root.fields(&fields::FIT)?);
        let of_warp = WarpFields {
            p: fields.p,
            q: fields.q,
            align: fields.align,
            weights: fields.weights,
            coincident: fields.coincident,
            units: fields.units,
            names: fields.names,
            format: fields.format,
            unmatched: fields.unmatched,
            ..WarpFields::default()
        };
        let mut warp = WarpPatch::read(of_warp, &[])?.into_object()?;
        warp.leave_out_missing();
        let extent = size(
            &fields
                .extent
                .ok_or_else(|| root.missing("extent", EXTENT))?,
        )?;
        let pose = PosePatch {
            q: Some(warp.posed()?.to_vec()),
            strength: None,
        };
        Ok(Self {
            rest: Some((warp.rest, extent)),
            pose,
            candidates: read_candidates(fields.candidates)?,
        })
    }

    /// Reads the body of `/sessions/{id}/fit`.
    pub(super) fn parse_posed(json: &[u8]) -> Result<Self, Problem> {
        let root = json::root(json)?;
        let [q, candidates] = root.fields(&fields::FIT_OF_SESSION)?;
        Ok(Self {
            rest: None,
            pose: PosePatch::read([q, None], usize::MAX)?,
            candidates: read_candidates(candidates)?,
        })
    }
}

fn read_candidates(node: Option<Node<'_, '_>>) -> Result<Vec<Candidate>, Problem> {
    let Some(node) = node else {
        return Ok(Candidate::defaults());
    };
    let candidates = node.list(CANDIDATES, CANDIDATE_TEXT, |index, item| {
        if index >= MAX_CANDIDATES {
            return Err(node.unexpected(CANDIDATES, format_args!("more than {MAX_CANDIDATES}")));
        }
        let [method, alpha, smoothing] = item.fields(&fields::CANDIDATE)?;
        let method: Method =
            enum_name(&method.ok_or_else(|| item.missing("method", "the name of a method"))?)?;
        let number = |node: &Node<'_, '_>| number(node, "a number");
        Ok(Candidate {
            method,
            alpha: optional(alpha, number)?,
            smoothing: optional(smoothing, number)?,
        })
    })?;
    if candidates.is_empty() {
        Err(node.unexpected(CANDIDATES, "an empty array"))
    } else {
        Ok(candidates)
    }
}

/// Compares candidates on at most `most` handles. CPU work, in parallel on the current rayon pool.
/// Errors: Wrong points or candidates, cancelled.
pub fn predictions(
    rest: &RestSpec,
    q: &[Handle],
    extent: Extent,
    candidates: &[Candidate],
    most: u64,
    cancelled: IsCancelled<'_>,
) -> Result<Vec<Prediction>, Problem> {
    let fit = Fit::new(rest, q, extent, most, cancelled)?;
    let predict = |(index, candidate): (usize, &Candidate)| {
        fit.predict(*candidate, cancelled)
            .map_err(|error: WarpError| in_candidate(index, error.into()))
    };
    candidates.iter().enumerate().map(predict).collect()
}

/// Locates an error in a candidate.
fn in_candidate(index: usize, mut problem: Problem) -> Problem {
    if let Some(pointer) = &mut problem.pointer
        && ["/method", "/alpha", "/smoothing"].contains(&pointer.as_str())
        && problem.code != Code::Overloaded
    {
        pointer.insert_str(0, &format!("/candidates/{index}"));
    }
    problem
}

/// A method with its parameters as a header shows it: `affine;alpha=1.5`, `tps;smoothing=0`,
/// `global_affine`.
pub fn method_text(rest: &RestSpec) -> String {
    let mut text = rest.method.as_str().to_owned();
    for (name, value) in [("alpha", rest.alpha), ("smoothing", rest.smoothing)] {
        if let Some(value) = value {
            text += &format!(";{name}={value}");
        }
    }
    text
}

/// The response of `/fit`.
#[derive(Debug)]
pub struct FitAnswer<'a>(pub &'a [Prediction]);

impl Serialize for FitAnswer<'_> {
    fn serialize<S: Serializer>(&self, s: S) -> Result<S::Ok, S::Error> {
        let mut object = s.serialize_map(Some(2))?;
        object.serialize_entry(
            "best",
            &mlswarp::warp::best(self.0).map(|best| AsJson(best.candidate)),
        )?;
        object.serialize_entry("candidates", &AsJson(self.0))?;
        object.end()
    }
}

fn parameters<M: SerializeMap>(object: &mut M, candidate: Candidate) -> Result<(), M::Error> {
    object.serialize_entry("method", &AsJson(candidate.method))?;
    object.serialize_entry("alpha", &candidate.alpha)?;
    object.serialize_entry("smoothing", &candidate.smoothing)
}

impl Serialize for AsJson<Candidate> {
    fn serialize<S: Serializer>(&self, s: S) -> Result<S::Ok, S::Error> {
        let mut object = s.serialize_map(Some(3))?;
        parameters(&mut object, self.0)?;
        object.end()
    }
}

impl Serialize for AsJson<&[Prediction]> {
    fn serialize<S: Serializer>(&self, s: S) -> Result<S::Ok, S::Error> {
        s.collect_seq(self.0.iter().map(AsJson))
    }
}

impl Serialize for AsJson<&Prediction> {
    fn serialize<S: Serializer>(&self, s: S) -> Result<S::Ok, S::Error> {
        struct Residuals<'a>(&'a Prediction);
        impl Serialize for Residuals<'_> {
            fn serialize<S: Serializer>(&self, s: S) -> Result<S::Ok, S::Error> {
                let mut list = s.serialize_seq(Some(self.0.residuals.len()))?;
                self.0.residuals.iter().try_for_each(|residual| {
                    list.serialize_element(&residual.map(|d| [d.x, d.y]))
                })?;
                list.end()
            }
        }
        let mut object = s.serialize_map(Some(7))?;
        parameters(&mut object, self.0.candidate)?;
        object.serialize_entry("rms", &self.0.rms)?;
        object.serialize_entry("max", &self.0.max)?;
        object.serialize_entry("residuals", &Residuals(self.0))?;
        object.serialize_entry("outliers", &self.0.outliers)?;
        object.end()
    }
}
