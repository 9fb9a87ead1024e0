//! Reads the positions of annotations from their text. All are checked when a request arrives, and
//! nothing is kept; when a part of them is mapped, that part is read again and kept.

use std::ops::Range;

use mlswarp::deform::MAX_COORDINATE;
use mlswarp::geometry::Point;
use mlswarp::warp::{
    CoordinateFrame, Edges, MAX_EDGE_SAMPLES, Quantity, Seen, WarpError, samples_of,
};

use super::super::json::Node;
use crate::problem::Problem;

/// Checks positions, and keeps them if they are to be mapped.
pub(super) struct Reader<'j> {
    /// The image of positions that are checked.
    image: Option<CoordinateFrame>,
    seen: Seen,
    pub(super) positions: usize,
    /// Positions at which edges will be examined, beyond one for each edge.
    samples: usize,
    is_refined: bool,
    edges: Edges,
    /// The first and the last position of the line, px of the plane.
    ends: Option<(Point, Point)>,
    pub(super) kept: Option<PartContents<'j>>,
}

/// The positions of a part, and where they are in the text.
#[derive(Default)]
pub(super) struct PartContents<'j> {
    pub(super) places: Vec<Point>,
    /// What the text has after the second number of each position; empty if no position has more.
    pub(super) more: Vec<&'j str>,
    pub(super) lines: Vec<Line<'j>>,
    pub(super) geometries: Vec<Geometry<'j>>,
    pub(super) objects: Vec<GeoJsonObject<'j>>,
}

/// Positions that are mapped together.
pub(super) struct Line<'j> {
    pub(super) text: &'j str,
    pub(super) edges: Edges,
    /// The text is a position, not a list of them.
    pub(super) is_single: bool,
    pub(super) places: Range<usize>,
}

/// A GeoJSON geometry.
pub(super) struct Geometry<'j> {
    pub(super) text: &'j str,
    pub(super) lines: Range<usize>,
    /// Bounding boxes in it, each with the lines that it bounds.
    pub(super) boxes: Vec<(&'j str, Range<usize>)>,
}

/// A GeoJSON object that has geometries: a feature, or a geometry of its own.
pub(super) struct GeoJsonObject<'j> {
    pub(super) geometries: Range<usize>,
    /// The lines of the geometry itself, without those of other members.
    pub(super) own: Range<usize>,
    pub(super) bbox: Option<&'j str>,
}

impl<'j> Reader<'j> {
    /// `image`: that of the positions; `samples`: those of other annotations.
    pub(super) fn checking(image: CoordinateFrame, is_refined: bool, samples: usize) -> Self {
        Self {
            image: Some(image),
            is_refined,
            samples,
            kept: None,
            ..Self::keeping()
        }
    }

    /// For positions that have been checked.
    pub(super) fn keeping() -> Self {
        Self {
            image: None,
            seen: Seen::default(),
            positions: 0,
            samples: 0,
            is_refined: false,
            edges: Edges::None,
            ends: None,
            kept: Some(PartContents::default()),
        }
    }

    /// What was seen, and the samples that it needs.
    pub(super) fn finish(self, node: &Node<'_, '_>) -> Result<(Seen, usize), Problem> {
        let (limit, actual) = (MAX_EDGE_SAMPLES as u64, self.samples as u64);
        if self.samples > MAX_EDGE_SAMPLES {
            let error = WarpError::TooLarge {
                what: Quantity::OutlineSamples,
                limit,
                actual,
            };
            return Err(Problem::from(error).pointer(node.at.to_string()));
        }
        Ok((self.seen, self.samples))
    }

    /// The number of lines that are kept.
    pub(super) fn line_count(&self) -> usize {
        self.kept.as_ref().map_or(0, |kept| kept.lines.len())
    }

    /// A position. `more`: what its text has after the second number.
    /// Errors: the position is out of range.
    pub(super) fn place(
        &mut self,
        node: &Node<'j, '_>,
        place: Point,
        more: &'j str,
    ) -> Result<(), Problem> {
        if let Some(image) = self.image {
            let px = image.to_plane(place);
            let is_in_range = |c: &f64| c.abs() <= MAX_COORDINATE;
            if let Some(value) = [px.x, px.y].into_iter().find(|c| !is_in_range(c)) {
                let error = WarpError::BadPlace {
                    index: 0,
                    value,
                    limit: MAX_COORDINATE,
                };
                return Err(Problem::from(error).pointer(node.at.to_string()));
            }
            self.seen.add(place);
            self.positions += 1;
            let (first, last) = self.ends.unwrap_or((px, px));
            self.edge(last, px);
            self.ends = Some((first, px));
        }
        if let Some(kept) = &mut self.kept {
            if !(more.is_empty() && kept.more.is_empty()) {
                kept.more.resize(kept.places.len(), "");
                kept.more.push(more);
            }
            kept.places.push(place);
        }
        Ok(())
    }

    /// A line whose positions are handed over by `read`.
    pub(super) fn line(
        &mut self,
        text: &'j str,
        edges: Edges,
        is_single: bool,
        read: impl FnOnce(&mut Self) -> Result<(), Problem>,
    ) -> Result<(), Problem> {
        (self.edges, self.ends) = (edges, None);
        let start = self.kept.as_ref().map_or(0, |kept| kept.places.len());
        read(self)?;
        if let (Edges::Closed, Some((first, last))) = (edges, self.ends) {
            self.edge(last, first);
        }
        if let Some(kept) = &mut self.kept {
            kept.lines.push(Line {
                text,
                edges,
                is_single,
                places: start..kept.places.len(),
            });
        }
        Ok(())
    }

    fn edge(&mut self, from: Point, to: Point) {
        if self.is_refined && self.edges != Edges::None {
            self.samples = self.samples.saturating_add(samples_of(from, to) - 1);
        }
    }
}

impl<'j> PartContents<'j> {
    /// What the text has after the second number of a position.
    pub(super) fn more(&self, place: usize) -> &'j str {
        self.more.get(place).copied().unwrap_or_default()
    }
}
