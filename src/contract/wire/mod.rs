//! JSON bodies to checked values, and back: the only validation of what a client writes.
//!
//! The form is checked here: names, types, shapes of arrays, finite numbers. The engine judges what
//! a set of handles means. Text that is not a JSON object and repeated fields are 400
//! `malformed_request`; everything else, such as an unknown field, is 422 with a JSON pointer.
//! `null` as the value of a field means that the field is absent; inside an array it is a value of
//! the wrong kind.

pub mod annotations;
#[cfg(test)]
mod arbitrary;
mod batch;
pub mod blend;
mod enum_name;
pub mod fields;
mod fit;
pub mod formats;
mod handles;
mod json;
pub mod landmarks;
mod map;
mod merge;
mod mesh;
mod number;
mod output;
mod plan;
mod pose;
mod report;
mod reserved;
mod resolve;
mod rest;
mod session;
mod shape;
mod socket;
mod suggest;
mod syntax;
mod token;
mod warning;
mod work;
mod write;

#[cfg(test)]
mod tests;

use bytes::Bytes;

use crate::layer::LayerRef;
use crate::problem::words::quote;
use crate::problem::{Code, Problem};
pub use annotations::is_geojson;
pub use annotations::{Annotation, AnnotationKind, Annotations, Cursor, ReserveMore};
pub use batch::{BatchFrame, BatchIndex, FrameJitter, FramePosition, in_frame};
pub use batch::{BatchObject, BatchPoses, FrameTexts};
pub use enum_name::EnumName;
use fields::AnnotationFields;
pub use fit::FitObject;
pub use fit::{FitAnswer, method_text, predictions};
pub use handles::handles_bytes;
use json::{At, Node, OptionalNode, optional};
pub use map::MapObject;
pub use map::in_map;
pub use merge::{Merged, NamedObject, extent_in, of_fit, split_batch};
pub use mesh::{MeshObject, MeshShape};
use mlswarp::deform::Handle;
use mlswarp::pixmap::Extent;
use mlswarp::warp::{
    Alignment, Candidate, CoordinateFrame, Folds, Metric, OutputSpec, RestSpec, Units,
};
use number::{count, whole};
pub use output::{OutputPatch, canvas_from_text, canvas_text};
pub use plan::{PlanQuery, Precision, plan_file, plan_file_bytes, rest_revision};
pub use pose::{Pose, PosePatch};
pub use report::{ReportAnswer, ReportObject};
pub use reserved::Reserved;
use reserved::reading_bytes;
pub use rest::WarpPatch;
pub use session::{
    CoincidentGroup, SessionGrid, SessionImage, SessionLayer, SessionMask, SessionObject,
    session_tail,
};
pub use socket::UnreadHandles;
pub use socket::{BadMessage, DragMessage, FrameReport, FrameTiming};
pub use token::{MAX_TOKEN_TTL, TokenOp, TokenRequest};
pub use warning::WarningEntry;
use work::Work;
pub use write::serialize_own;

const HANDLES: &str = "an array of handles";

/// Serializes a value of the engine as a client would write it.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct AsJson<T>(pub T);

/// The warp object: handles, the method, and the output.
#[derive(Clone, Debug, PartialEq)]
pub struct WarpObject {
    /// Everything that stays while q moves.
    pub rest: RestSpec,
    /// Posed handles, if given.
    pub q: Option<Vec<Handle>>,
    /// How much of the way from p to q the handles are moved.
    pub strength: f64,
    /// The treatment of folds.
    pub folds: Folds,
    /// How the picture is made.
    pub output: OutputSpec,
    /// The method is still to be chosen.
    pub is_auto: bool,
}

impl Default for WarpObject {
    fn default() -> Self {
        let (rest, folds, output) = (RestSpec::default(), Folds::default(), OutputSpec::default());
        Self {
            rest,
            q: None,
            strength: 1.0,
            folds,
            output,
            is_auto: false,
        }
    }
}

impl WarpObject {
    /// Reads the object. Whether it has what a route needs is not checked.
    fn parse(json: &[u8]) -> Result<Self, Problem> {
        Ok(WarpPatch::parse(json)?
            .without_files()?
            .merge_onto(Self::default()))
    }

    /// Errors: `method: auto` with a parameter that it chooses, or without `q`.
    pub fn require_choice(&self) -> Result<(), Problem> {
        let given = [
            ("alpha", self.rest.alpha),
            ("smoothing", self.rest.smoothing),
        ];
        if self.rest.metric == Metric::Geodesic {
            let detail = "the method `auto` compares methods by distances in the plane; with the \
                metric `geodesic`, choose `rigid`, `similarity` or `affine`";
            return Err(Problem::new(Code::NotSupported, detail).pointer("/method"));
        }
        let own = self.rest.own.iter().next();
        let own =
            own.map(|(path, value)| (path.split_once('/').map_or(path, |(o, _)| o), Some(value)));
        if let Some((name, _)) = given
            .into_iter()
            .chain(own)
            .find(|(_, value)| value.is_some())
        {
            let detail = format!("`{name}` does not apply: the method `auto` chooses it");
            return Err(Problem::new(Code::BadValue, detail).pointer(format!("/{name}")));
        }
        match &self.q {
            Some(_) => Ok(()),
            None if self.rest.p.is_empty() => Ok(()),
            None => {
                let detail = "`q` is missing: the method `auto` compares methods by where the \
                    handles go; send `q`, or choose a method";
                Err(Problem::new(Code::BadValue, detail).pointer("/q"))
            }
        }
    }

    /// Replaces `method: auto` by the best candidate.
    pub fn choose(&mut self, candidate: Candidate) {
        self.rest = candidate.applied_to(std::mem::take(&mut self.rest));
    }

    /// Leaves out the handles that are missing on either side.
    pub fn leave_out_missing(&mut self) {
        self.rest
            .leave_out_missing(self.q.as_deref_mut().unwrap_or_default());
    }

    /// Leaves out the handles that are missing on either side, aligns the posed ones and moves them
    /// to where the strength has them, once. Errors: `bad_value` at `/strength` if there are
    /// handles at rest and no `q` that it could apply to.
    pub fn settle_pose(&mut self, extent: Extent) -> Result<Option<Alignment>, Problem> {
        #[expect(clippy::float_cmp, reason = "the default")]
        if self.q.is_none() && !self.rest.p.is_empty() && self.strength != 1.0 {
            let detail = "`strength` applies to `q`, which is missing: send both";
            return Err(Problem::new(Code::BadValue, detail).pointer("/strength"));
        }
        self.leave_out_missing();
        let RestSpec { p, depth, .. } = &mut self.rest;
        // Zeros are the default, which records leave out. A wrong number of them is refused later.
        let counts = |depth: &Vec<f64>| depth.len() != p.len() || depth.iter().any(|d| *d != 0.0);
        *depth = depth.take().filter(counts);
        let strength = std::mem::replace(&mut self.strength, 1.0);
        let Some(q) = self.q.take() else {
            return Ok(None);
        };
        let (posed, alignment) = self.rest.posed(q, strength, extent);
        self.q = Some(posed);
        Ok(alignment)
    }

    /// The posed handles; none if there are none at rest.
    /// Errors: `bad_value` at `/q` if there are handles at rest and no `q`.
    pub fn posed(&self) -> Result<&[Handle], Problem> {
        match &self.q {
            Some(q) => Ok(q),
            None if self.rest.p.is_empty() => Ok(&[]),
            None => {
                let mut problem = missing_q();
                // Pairs look like lines of two places.
                if self.rest.p.iter().all(|handle| handle.places().len() == 2) {
                    problem
                        .detail
                        .push_str(" `p` and `q` are arrays of their own, not an array of pairs");
                }
                Err(problem)
            }
        }
    }
}

/// The problem of handles at rest without posed ones.
pub fn missing_q() -> Problem {
    Node::new("{}", At::Root).missing("q", HANDLES)
}

/// One step of a drag: `{"q"?, "strength"?, "seq"?, "layer"?, "output"?}`.
#[derive(Clone, Debug, PartialEq)]
pub struct DragObject {
    /// The pose; the session's where it gives nothing.
    pub pose: PosePatch,
    /// The number of the step; a step with a lower one is too old.
    pub seq: Option<u64>,
    /// What is drawn instead of the picture.
    pub layer: Option<LayerRef>,
    /// Replaces fields of the session's output.
    pub output: OutputPatch,
}

impl DragObject {
    /// Reads the object. `at_rest`: the number of handles at rest.
    fn parse(json: &[u8], at_rest: usize) -> Result<Self, Problem> {
        let root = json::root(json)?;
        let [q, strength, seq, layer_, output] =
            root.fields(&["q", "strength", "seq", "layer", "output"])?;
        Ok(Self {
            layer: optional(layer_, layer)?,
            output: optional(output, OutputPatch::read)?.unwrap_or_default(),
            ..Self::step([q, strength], seq, at_rest)?
        })
    }

    /// Reads the object of a request for the mesh: `q`, `strength` and `seq`.
    fn parse_posed(json: &[u8], at_rest: usize) -> Result<Self, Problem> {
        let root = json::root(json)?;
        let [q, strength, seq] = root.fields(&["q", "strength", "seq"])?;
        Self::step([q, strength], seq, at_rest)
    }

    /// Reads the body of `/sessions/{id}/report`: `q`, `strength` and `output`.
    fn parse_for_report(json: &[u8], at_rest: usize) -> Result<Self, Problem> {
        let root = json::root(json)?;
        let [q, strength, output] = root.fields(&["q", "strength", "output"])?;
        Ok(Self {
            output: optional(output, OutputPatch::read)?.unwrap_or_default(),
            ..Self::step([q, strength], None, at_rest)?
        })
    }

    /// A step of the picture in the session's output.
    fn step(
        pose: [OptionalNode<'_, '_>; 2],
        seq: OptionalNode<'_, '_>,
        at_rest: usize,
    ) -> Result<Self, Problem> {
        Ok(Self {
            pose: PosePatch::read(pose, at_rest)?,
            seq: optional(seq, |n| whole(n, "a whole number, at least 0"))?,
            layer: None,
            output: OutputPatch::default(),
        })
    }
}

/// Reads the name of a layer.
fn layer(node: &Node<'_, '_>) -> Result<LayerRef, Problem> {
    const EXPECTED: &str = "the name of a layer";
    if node.kind() != json::Kind::String {
        return Err(node.wrong_kind(EXPECTED));
    }
    let text = node.string(EXPECTED)?;
    LayerRef::parse(&text).ok_or_else(|| {
        let built_in = LayerRef::BUILT_IN
            .map(|name| format!("`{name}`"))
            .join(", ");
        node.unexpected(
            &format!("the name of a stored layer, or one of the built-in layers {built_in}"),
            format_args!("{}", quote(&text)),
        )
    })
}

/// `POST /points` (a whole warp object and `extent`) and `POST /sessions/{id}/points` (`q` alone).
#[derive(Clone, Debug, PartialEq)]
pub struct PointsObject {
    /// With `/points` only: the warp object and the extent `[W, H]`.
    pub warp: Option<(WarpObject, Extent)>,
    /// With a session only.
    pub pose: PosePatch,
    /// The picture that posed positions belong to.
    pub output: OutputSpec,
    /// What is mapped.
    pub annotations: Annotations,
}

impl PointsObject {
    /// Reads the object of `/points`. `q` may be absent if there is no `p`. `most_bytes`: the most
    /// bytes of everything but annotations.
    fn parse(body: &Bytes, most_bytes: u64, work: &Work<'_>) -> Result<Self, Problem> {
        let root = json::long_root(body, work)?;
        let [
            warp @ ..,
            extent,
            points,
            polygons,
            boxes,
            geojson,
            inverse,
            refine,
        ] = root.fields(&fields::WARP_WITH_POINTS)?;
        let mapped = AnnotationFields::from([points, polygons, boxes, geojson, inverse, refine]);
        require_length(
            body.len() - text_bytes(mapped.annotations()),
            most_bytes,
            "its annotations",
        )?;
        let warp = WarpPatch::read_all(warp)?.into_object()?;
        let extent = size(&extent.ok_or_else(|| root.missing("extent", EXTENT))?)?;
        let (output, units) = (warp.output, warp.rest.units);
        let annotations = Annotations::read(body, mapped, image_of(&output, extent, units))?;
        warp.posed()?;
        Ok(Self {
            warp: Some((warp, extent)),
            pose: PosePatch::default(),
            output,
            annotations,
        })
    }

    /// Reads the object of `/sessions/{id}/points`; `extent`, `units` and `output`: those of the
    /// session.
    fn parse_posed(
        body: &Bytes,
        most_bytes: u64,
        (extent, units): (Extent, Units),
        output: &OutputSpec,
        work: &Work<'_>,
    ) -> Result<Self, Problem> {
        let root = json::long_root(body, work)?;
        let [q, strength, output_, mapped @ ..] = root.fields(&fields::POINTS_OF_SESSION)?;
        let mapped = AnnotationFields::from(mapped);
        require_length(
            body.len() - text_bytes(mapped.annotations()),
            most_bytes,
            "its annotations",
        )?;
        let output = optional(output_, OutputPatch::read)?
            .unwrap_or_default()
            .merge_onto(output);
        let annotations = Annotations::read(body, mapped, image_of(&output, extent, units))?;
        Ok(Self {
            warp: None,
            pose: PosePatch::read([q, strength], usize::MAX)?,
            output,
            annotations,
        })
    }
}

/// The image of annotations: the picture if they are mapped by the inverse, otherwise the source.
fn image_of(
    output: &OutputSpec,
    source: Extent,
    units: Units,
) -> impl FnOnce(bool) -> CoordinateFrame {
    move |is_inverse| {
        if is_inverse {
            CoordinateFrame::requested(output, source, units)
        } else {
            CoordinateFrame::of_source(source, units)
        }
    }
}

/// Bytes of the values of fields.
fn text_bytes<const N: usize>(nodes: [Option<Node<'_, '_>>; N]) -> usize {
    nodes
        .into_iter()
        .flatten()
        .map(|node| node.text.len())
        .sum()
}

/// Errors: JSON without its `large` fields is longer than a limit.
fn require_length(length: usize, most_bytes: u64, large: &str) -> Result<(), Problem> {
    if length as u64 <= most_bytes {
        return Ok(());
    }
    let detail = format!("the JSON has {length} bytes without {large}; the limit is {most_bytes}");
    Err(Problem::new(Code::TooLarge, detail).limit("json_bytes", most_bytes, length))
}

const SIZE: &str = "a size: [width, height] in pixels";
/// The size that a request without an image gives.
const EXTENT: &str = "the size of the image, [width, height] in pixels; this request has no \
    image, and the grid and the units depend on it";
/// Bytes of text of an ordinary side.
const SIDE_TEXT: usize = 5;

fn size(node: &Node<'_, '_>) -> Result<Extent, Problem> {
    let sides = node.list(SIZE, SIDE_TEXT, |_, item| {
        count(&item, 1, "a whole number of pixels, at least 1")
    })?;
    let extent = if let [width, height] = sides[..] {
        Extent::new(width, height)
    } else {
        None
    };
    extent.ok_or_else(|| node.unexpected(SIZE, format_args!("{} numbers", sides.len())))
}
