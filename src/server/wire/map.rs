//! The body of `/map` and `/sessions/{id}/map`.

use mlswarp::deform::Handle;
use mlswarp::pixmap::Extent;
use mlswarp::warp::{MapDirection, MapFormat, MapSpec, OutputSpec};

use super::enum_name::enum_name;
use super::handles::handles;
use super::json::{Node, optional};
use super::output::{canvas, width};
use super::rest::{WarpPatch, strength};
use super::{EXTENT, HANDLES, WarpObject, fields, json, size};
use crate::problem::Problem;

/// A request for a map. The canvas and the width are those of `output` if they are absent.
#[derive(Clone, Debug, PartialEq)]
pub struct MapObject {
    /// With `/map` only: the warp object and the extent `[W, H]`.
    pub warp: Option<(WarpObject, Extent)>,
    /// Posed handles of a session.
    pub q: Vec<Handle>,
    /// How much of the way from p to q the handles are moved.
    pub strength: f64,
    direction: MapDirection,
    canvas: Option<mlswarp::warp::CanvasSpec>,
    width: Option<u32>,
}

impl MapObject {
    /// Reads the body of `/map`. `q` may be absent if there is no `p`.
    pub(super) fn parse(json: &[u8]) -> Result<Self, Problem> {
        let root = json::root(json)?;
        let [warp @ .., extent, direction, canvas, width] = root.fields(&fields::WARP_WITH_MAP)?;
        let warp = WarpPatch::read(warp)?.into_object()?;
        let extent = size(&extent.ok_or_else(|| root.missing("extent", EXTENT))?)?;
        warp.posed()?;
        Self::read(Some((warp, extent)), Vec::new(), 1.0, [direction, canvas, width])
    }

    /// Reads the body of `/sessions/{id}/map`.
    pub(super) fn parse_posed(json: &[u8]) -> Result<Self, Problem> {
        let root = json::root(json)?;
        let [q, strength_, spec @ ..] = root.fields(&fields::MAP_OF_SESSION)?;
        let q = handles(&q.ok_or_else(|| root.missing("q", HANDLES))?)?;
        Self::read(None, q, optional(strength_, strength)?.unwrap_or(1.0), spec)
    }

    fn read(
        warp: Option<(WarpObject, Extent)>,
        q: Vec<Handle>,
        strength: f64,
        [direction, canvas_, width_]: [Option<Node<'_, '_>>; 3],
    ) -> Result<Self, Problem> {
        let direction = optional(direction, enum_name)?.unwrap_or_default();
        Ok(Self { warp, q, strength, direction, canvas: optional(canvas_, canvas)?, width: optional(width_, width)? })
    }

    /// The parameters of the map; the canvas and the width of `output` where the request has none.
    #[must_use]
    pub fn spec(&self, output: &OutputSpec, format: MapFormat) -> MapSpec {
        MapSpec {
            direction: self.direction,
            canvas: self.canvas.unwrap_or(output.canvas),
            // A width belongs to its canvas.
            width: if self.canvas.is_some() { self.width } else { self.width.or(output.width) },
            format,
        }
    }
}

/// Corrects the pointer of a problem for a request of a map, whose canvas and width are not in `output`.
pub(crate) fn in_map(mut problem: Problem) -> Problem {
    if matches!(problem.what, Some("map_side" | "map_pixels")) {
        return problem.pointer("/extent");
    }
    if let Some(pointer) = &mut problem.pointer
        && matches!(pointer.as_str(), "/output/canvas" | "/output/width")
    {
        pointer.replace_range(.."/output".len(), "");
    }
    problem
}
