//! The session object: what a session is, as its client is told. Effective values (alpha, point mass, counted grid), not requested ones.

use std::fmt;

use mlswarp::deform::{Handle, Method};
use mlswarp::warp::{Digest, Folds, GridSpec, OutputSpec, Units};
use serde::Serialize;

use super::AsJson;

/// The answer of `POST /sessions` and `GET /sessions/{id}`.
#[derive(Debug, Serialize)]
pub struct SessionObject<'a> {
    /// The id, a UUID.
    pub id: &'a str,
    /// The uploaded picture.
    pub image: SessionImage,
    /// Handles at rest, in the session's units.
    pub p: AsJson<&'a [Handle]>,
    /// One a handle, when the client gave them.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub weights: Option<&'a [f64]>,
    /// The class of maps.
    pub method: AsJson<Method>,
    /// Effective exponent.
    pub alpha: f64,
    /// Effective mass of a point, px; mixed sets only.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub point_mass: Option<f64>,
    /// Unit of p and q.
    pub units: AsJson<Units>,
    /// The grid.
    pub grid: SessionGrid,
    /// What is done about folds.
    pub folds: AsJson<Folds>,
    /// How pictures are made unless a drag says otherwise.
    pub output: AsJson<&'a OutputSpec>,
    /// RFC 3339, UTC.
    pub created: &'a str,
    /// RFC 3339, UTC.
    pub expires: &'a str,
    /// The highest sequence number seen; `null` before the first.
    pub seq: Option<u64>,
}

/// The picture of a session.
#[derive(Clone, Copy, Debug, Serialize)]
pub struct SessionImage {
    /// Upright width, px.
    pub width: u32,
    /// Upright height, px.
    pub height: u32,
    /// Of the file's bytes: `sha256:<hex>`.
    pub digest: AsJson<Digest>,
}

/// The grid of a session.
#[derive(Clone, Copy, Debug, Serialize)]
pub struct SessionGrid {
    /// Vertices in a row.
    pub columns: u32,
    /// Vertices in a column.
    pub rows: u32,
    /// Distance of neighbouring grid lines, px: they lie at 0, c, 2c, ... and the last at the picture's edge.
    pub cell: [f64; 2],
    /// As the client asked for it.
    pub requested: AsJson<GridSpec>,
}

impl Serialize for AsJson<Digest> {
    fn serialize<S: serde::Serializer>(&self, s: S) -> Result<S::Ok, S::Error> {
        s.collect_str(self)
    }
}

impl fmt::Display for AsJson<Digest> {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "sha256:{}", self.0)
    }
}
