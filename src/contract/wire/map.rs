//! The body of `/map` and `/sessions/{id}/map`.

use mlswarp::pixmap::Extent;
use mlswarp::warp::{MapDirection, MapFormat, MapSpec, OutputSpec};

use super::enum_name::enum_name;
use super::json::{Node, optional};
use super::output::{canvas, width};
use super::rest::WarpPatch;
use super::{EXTENT, PosePatch, WarpObject, fields, json, size};
use crate::problem::Problem;

/// A request for a map. The canvas and the width are those of `output` if they are absent.
#[derive(Clone, Debug, PartialEq)]
pub struct MapObject {
    /// With `/map` only: the warp object and the extent `[W, H]`.
    pub warp: Option<(WarpObject, Extent)>,
    /// With a session only.
    pub pose: PosePatch,
    direction: MapDirection,
    canvas: Option<mlswarp::warp::CanvasSpec>,
    width: Option<u32>,
}

impl MapObject {
    /// Reads the body of `/map`. `q` may be absent if there is no `p`.
    pub(super) fn parse(json: &[u8]) -> Result<Self, Problem> {
        let root = json::root(json)?;
        let [warp @ .., extent, direction, canvas, width] = root.fields(&fields::WARP_WITH_MAP)?;
        let warp = WarpPatch::read_all(warp)?.into_object()?;
        let extent = size(&extent.ok_or_else(|| root.missing("extent", EXTENT))?)?;
        warp.posed()?;
        Self::read(
            Some((warp, extent)),
            PosePatch::default(),
            [direction, canvas, width],
        )
    }

    /// Reads the body of `/sessions/{id}/map`.
    pub(super) fn parse_posed(json: &[u8]) -> Result<Self, Problem> {
        let root = json::root(json)?;
        let [q, strength, spec @ ..] = root.fields(&fields::MAP_OF_SESSION)?;
        Self::read(None, PosePatch::read([q, strength], usize::MAX)?, spec)
    }

    fn read(
        warp: Option<(WarpObject, Extent)>,
        pose: PosePatch,
        [direction, canvas_, width_]: [Option<Node<'_, '_>>; 3],
    ) -> Result<Self, Problem> {
        let direction = optional(direction, enum_name)?.unwrap_or_default();
        Ok(Self {
            warp,
            pose,
            direction,
            canvas: optional(canvas_, canvas)?,
            width: optional(width_, width)?,
        })
    }

    /// The parameters of the map; the canvas and the width of `output` where the request has none.
    #[must_use]
    pub fn spec(&self, output: &OutputSpec, format: MapFormat) -> MapSpec {
        MapSpec {
            direction: self.direction,
            canvas: self.canvas.unwrap_or(output.canvas),
            // A width belongs to its canvas.
            width: if self.canvas.is_some() {
                self.width
            } else {
                self.width.or(output.width)
            },
            format,
        }
    }
}

/// Corrects the pointer of a problem for a request of a map, whose canvas and width are not in
/// `output`.
pub fn in_map(mut problem: Problem) -> Problem {
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
