//! STUB: JSON bodies to checked values; the only validation of syntax. JSON pointers name what was wrong.

use super::problem::Problem;
use crate::deform::Handle;
use crate::geometry::Point;
use crate::pixmap::Extent;
use crate::warp::{Folds, OutputSpec, RestSpec};

/// The warp object of api.md section 3.
#[derive(Clone, Debug, PartialEq)]
pub struct WarpObject {
    /// Everything that stays while q moves.
    pub rest: RestSpec,
    /// Posed handles, when sent.
    pub q: Option<Vec<Handle>>,
    /// What to do about folds.
    pub folds: Folds,
    /// How the picture is made.
    pub output: OutputSpec,
}

impl WarpObject {
    /// Reads the object; a field that is not known is refused.
    ///
    /// # Errors
    /// A problem with the code and a JSON pointer.
    pub fn parse(_json: &[u8]) -> Result<Self, Problem> {
        todo!()
    }
}

/// One step of a drag: `{"session"?, "q", "seq"?, "output"?}`.
#[derive(Clone, Debug, PartialEq)]
pub struct DragObject {
    /// The session (`POST /warp` with JSON; absent on `/sessions/{id}/warp`).
    pub session: Option<String>,
    /// Posed handles.
    pub q: Vec<Handle>,
    /// Sequence number.
    pub seq: Option<u64>,
    /// Fields given here replace those of the session's output.
    pub output: OutputPatch,
}

/// The output fields that a drag gave.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct OutputPatch {
    // fields are Option<...> of OutputSpec's
}

impl OutputPatch {
    /// The session's output with the given fields replaced.
    #[must_use]
    pub fn over(&self, _base: &OutputSpec) -> OutputSpec {
        todo!()
    }
}

impl DragObject {
    /// Reads the object. `session`: whether the field is required (else it is unknown).
    ///
    /// # Errors
    /// A problem with the code and a JSON pointer.
    pub fn parse(_json: &[u8], _session: bool) -> Result<Self, Problem> {
        todo!()
    }
}

/// `POST /points` (a whole warp object and `extent`) and `POST /sessions/{id}/points` (`q` alone).
#[derive(Clone, Debug, PartialEq)]
pub struct PointsObject {
    /// With `/points` only: rest handles and the extent `[W, H]`.
    pub warp: Option<(RestSpec, Extent)>,
    /// Posed handles.
    pub q: Vec<Handle>,
    /// Places to map, in the spec's units.
    pub points: Vec<Point>,
}

impl PointsObject {
    /// Reads the object of `/points`.
    ///
    /// # Errors
    /// A problem with the code and a JSON pointer.
    pub fn parse(_json: &[u8]) -> Result<Self, Problem> {
        todo!()
    }

    /// Reads the object of `/sessions/{id}/points`.
    ///
    /// # Errors
    /// A problem with the code and a JSON pointer.
    pub fn parse_posed(_json: &[u8]) -> Result<Self, Problem> {
        todo!()
    }
}
