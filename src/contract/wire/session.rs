//! The session object in two parts, what stays the same within a revision and what does not: the
//! answer of `POST /sessions` and `GET /sessions/{id}`. Alpha, point mass and grid are the
//! effective values.

use std::collections::BTreeMap;

use mlswarp::deform::{Coincident, Handle, Parameters};
use mlswarp::warp::{Align, Digest, Folds, GridSpec, Method, Metric, OutputSpec, Units};
use serde::{Serialize, Serializer};

use super::AsJson;
use crate::layer::LayerKind;

/// The members that stay the same within a revision.
#[derive(Debug, Serialize)]
pub struct SessionObject<'a> {
    /// The session's name in paths.
    pub id: &'a str,
    /// The uploaded image.
    pub image: SessionImage,
    /// Handles at rest, in the session's units.
    pub p: AsJson<&'a [Handle]>,
    /// Posed handles in requests without `q`, if the client gave them.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub q: Option<AsJson<&'a [Handle]>>,
    /// How much of the way from p to q they are moved; absent if it is all of it.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub strength: Option<f64>,
    /// One per handle, if the client gave them.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub weights: Option<&'a [f64]>,
    /// One per handle, if one of them is not 0.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub depth: Option<&'a [f64]>,
    /// The method.
    pub method: AsJson<Method>,
    /// Of methods that have it, as the following ones.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub alpha: Option<f64>,
    /// Mass of a point, px; mixed sets only.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub point_mass: Option<f64>,
    /// Smoothing of a spline.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub smoothing: Option<f64>,
    /// The object of the method, if it has one.
    #[serde(flatten)]
    pub own: AsJson<Parameters>,
    /// The metric; absent if it is that of the plane.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub metric: Option<AsJson<Metric>>,
    /// What belongs to the mask; absent if nothing needs it.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub mask: Option<SessionMask>,
    /// The groups of points that are one handle.
    #[serde(skip_serializing_if = "Vec::is_empty")]
    pub coincident: Vec<CoincidentGroup>,
    /// What was requested for coincident handles; absent if nothing was.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub coincident_policy: Option<AsJson<Coincident>>,
    /// Units of positions.
    pub units: AsJson<Units>,
    /// How each `q` is aligned; absent if it is not.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub align: Option<AsJson<Align>>,
    /// The grid of the mesh.
    pub grid: SessionGrid,
    /// Hexadecimal; that of the table of coefficients.
    pub rest_revision: &'a str,
    /// The treatment of folds.
    pub folds: AsJson<Folds>,
    /// How images are made.
    pub output: AsJson<&'a OutputSpec>,
    /// By name.
    #[serde(skip_serializing_if = "BTreeMap::is_empty")]
    pub layers: BTreeMap<&'a str, SessionLayer>,
    /// RFC 3339, UTC.
    pub created: &'a str,
}

/// What follows the text of a [`SessionObject`] without its brace. `seq`: the highest sequence
/// number seen; `null` before the first.
pub fn session_tail(expires: &str, seq: Option<u64>) -> String {
    let seq = seq.map_or_else(|| "null".to_owned(), |seq| seq.to_string());
    format!(",\"expires\":\"{expires}\",\"seq\":{seq}}}")
}

/// The mask of a session's image.
#[derive(Clone, Copy, Debug, Serialize)]
pub struct SessionMask {
    /// The share of full alpha above which a pixel belongs to it.
    pub threshold: f64,
}

/// A group of coincident points.
#[derive(Clone, Debug, Serialize)]
pub struct CoincidentGroup {
    /// Indices into `p`, ascending.
    pub handles: Vec<usize>,
}

/// A stored layer.
#[derive(Clone, Copy, Debug, Serialize)]
pub struct SessionLayer {
    /// What the layer's pixels mean.
    pub kind: AsJson<LayerKind>,
}

/// Size and digest of the uploaded picture.
#[derive(Clone, Copy, Debug, Serialize)]
pub struct SessionImage {
    /// Width of the upright image, px.
    pub width: u32,
    /// Height of the upright image, px.
    pub height: u32,
    /// Of the bytes of the file.
    pub digest: AsJson<Digest>,
}

/// The grid of a session's mesh.
#[derive(Clone, Copy, Debug, Serialize)]
pub struct SessionGrid {
    /// Vertices in a row.
    pub columns: u32,
    /// Vertices in a column.
    pub rows: u32,
    /// Distance of neighbouring grid lines, px: they lie at 0, c, 2c, ... and the last at the
    /// picture's edge.
    pub cell: [f64; 2],
    /// What was requested.
    pub requested: AsJson<GridSpec>,
}

impl Serialize for AsJson<Digest> {
    fn serialize<S: Serializer>(&self, s: S) -> Result<S::Ok, S::Error> {
        s.collect_str(&format_args!("sha256:{}", self.0))
    }
}
