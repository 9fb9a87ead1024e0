//! JSON bodies to checked values, and back: the only validation of what a client may write. What is checked here is form (names, types,
//! shapes of arrays, finite numbers); what a set of handles means is the mathematics' to judge. Not JSON, no object, or a field
//! given twice is 400 `malformed_request`; everything else is 422 with a JSON pointer. A field that is not known is refused, never
//! ignored. Cost: a few scans of the text and the values themselves; a drag of twelve points takes about two microseconds.

mod enum_name;
pub mod formats;
mod handles;
mod json;
mod mesh;
mod number;
mod output;
mod rest;
mod session;
mod socket;
mod write;

#[cfg(test)]
pub(crate) mod tests;

use crate::problem::{Code, Problem};
use handles::{handles, places};
use json::Node;
pub use mesh::{MeshObject, MeshShape};
use mlswarp::deform::Handle;
use mlswarp::geometry::Point;
use mlswarp::pixmap::Extent;
use mlswarp::warp::{Folds, OutputSpec, RestSpec};
use number::{count, whole};
pub use output::OutputPatch;
pub use rest::WarpPatch;
pub use session::{SessionGrid, SessionImage, SessionObject};
pub use socket::{BadMessage, DragMessage, FrameReport, FrameTiming, UnreadHandles};
pub use write::AsJson;

const HANDLES: &str = "an array of handles";

/// The warp object of api.md section 3.
#[derive(Clone, Debug, Default, PartialEq)]
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
    /// Errors: A problem with the code and a JSON pointer.
    pub fn parse(json: &[u8]) -> Result<Self, Problem> {
        WarpPatch::parse(json).map(|patch| patch.merge_onto(Self::default()))
    }

    /// The posed handles where they are needed: `q`, or none when there are none at rest.
    /// Errors: `bad_value` at `/q` when there are handles at rest and `q` was not sent.
    pub fn posed(&self) -> Result<&[Handle], Problem> {
        match &self.q {
            Some(q) => Ok(q),
            None if self.rest.p.is_empty() => Ok(&[]),
            None => Err(Node::nowhere().missing("q", HANDLES)),
        }
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

impl DragObject {
    /// Reads the object. `session`: whether the field is required (else it is unknown).
    /// Errors: A problem with the code and a JSON pointer.
    pub fn parse(json: &[u8], session: bool) -> Result<Self, Problem> {
        let root = json::root(json)?;
        if session {
            let [session, q, seq, output] = root.fields("an object", &["session", "q", "seq", "output"]).map_err(|mut problem| {
                if problem.code == Code::UnknownField {
                    problem.detail.push_str("; a picture and its handles `p` are sent as multipart/form-data");
                }
                problem
            })?;
            let session = session.ok_or_else(|| root.missing("session", "the id of a session"))?.string("the id of a session")?;
            Self::read(&root, Some(session), [q, seq, output])
        } else {
            Self::read(&root, None, root.fields("an object", &["q", "seq", "output"])?)
        }
    }

    /// Reads the object of a request for the mesh: `q` and `seq` alone.
    /// Errors: A problem with the code and a JSON pointer.
    pub fn parse_posed(json: &[u8]) -> Result<Self, Problem> {
        let root = json::root(json)?;
        let [q, seq] = root.fields("an object", &["q", "seq"])?;
        Self::read(&root, None, [q, seq, None])
    }

    fn read(root: &Node<'_, '_>, session: Option<String>, [q, seq, output]: [Option<Node<'_, '_>>; 3]) -> Result<Self, Problem> {
        Ok(Self {
            session,
            q: handles(&q.ok_or_else(|| root.missing("q", HANDLES))?)?,
            seq: seq.map(|n| whole(&n, "a whole number, at least 0")).transpose()?,
            output: output.map(|n| OutputPatch::read(&n)).transpose()?.unwrap_or_default(),
        })
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
    /// Reads the object of `/points`. `q` may be absent where there is no `p`.
    /// Errors: A problem with the code and a JSON pointer.
    pub fn parse(json: &[u8]) -> Result<Self, Problem> {
        let root = json::root(json)?;
        let [warp @ .., extent, points, polygons, boxes, inverse, refine] = root.fields("an object", &rest::FIELDS_WITH_POINTS)?;
        let warp = WarpPatch::read(warp)?;
        let warp = warp.merge_onto(WarpObject::default());
        let extent = size(&extent.ok_or_else(|| root.missing("extent", SIZE))?)?;
        let points = asked([points, polygons, boxes, inverse, refine])?;
        let q = warp.posed()?.to_vec();
        Ok(Self { warp: Some((warp.rest, extent)), q, points })
    }

    /// Reads the object of `/sessions/{id}/points`.
    /// Errors: A problem with the code and a JSON pointer.
    pub fn parse_posed(json: &[u8]) -> Result<Self, Problem> {
        let root = json::root(json)?;
        let [q, points, polygons, boxes, inverse, refine] =
            root.fields("an object", &["q", "points", "polygons", "boxes", "inverse", "refine"])?;
        let points = asked([points, polygons, boxes, inverse, refine])?;
        Ok(Self { warp: None, q: handles(&q.ok_or_else(|| root.missing("q", HANDLES))?)?, points })
    }
}

/// What is to be mapped. The contract has polygons, boxes and the inverse; this version has points.
fn asked([points, polygons, boxes, inverse, refine]: [Option<Node<'_, '_>>; 5]) -> Result<Vec<Point>, Problem> {
    const SUPPORTED: &str = "supported: `points`, mapped forwards";
    for (node, name) in [(polygons, "polygons"), (boxes, "boxes"), (refine, "refine")] {
        if let Some(node) = node {
            return Err(node.problem(Code::NotSupported, format!("not supported by this version: `{name}`; {SUPPORTED}")));
        }
    }
    if let Some(node) = inverse
        && node.bool()?
    {
        return Err(node.problem(Code::NotSupported, format!("not supported by this version: the inverse; {SUPPORTED}")));
    }
    Ok(points.map(|n| places(&n)).transpose()?.unwrap_or_default())
}

const SIZE: &str = "a size: [width, height] in pixels";
const SIDE: &str = "a whole number of pixels, at least 1";

fn size(node: &Node<'_, '_>) -> Result<Extent, Problem> {
    let mut sides = [0; 2];
    let mut found = 0_usize;
    node.items(SIZE, |index, item| {
        if let Some(side) = sides.get_mut(index) {
            *side = count(&item, 1, SIDE)?;
        }
        found += 1;
        Ok(())
    })?;
    let [width, height] = sides;
    match Extent::new(width, height) {
        Some(extent) if found == 2 => Ok(extent),
        _ => Err(node.problem(Code::BadValue, format!("expected {SIZE}; found {found} numbers"))),
    }
}
