//! Annotations: points, polygons, boxes and GeoJSON that are mapped with the picture.
//! [`Annotations::read`] checks them and keeps their text; [`Annotations::map_part`] maps them part
//! by part, so that few of their positions are in memory at the same time. Each kind is returned
//! under its own name, in the order of the request.

mod geojson;
mod part;
mod reader;
mod write;

use std::ops::Range;

use bytes::Bytes;
use mlswarp::geometry::Point;
use mlswarp::warp::{CoordinateFrame, Edges, Seen, Warning};

use super::fields::AnnotationFields;
use super::handles::{PLACE, place};
use super::json::{At, Kind, Node, optional};
use super::number::number;
use crate::problem::{Code, Problem};
use geojson::{GeoJsonShape, read_collection, read_object, shape_of};
pub use part::{Cursor, ReserveMore};
use reader::Reader;

const POLYGON: &str = "a polygon: an array of at least 3 positions, [[x, y], [x, y], [x, y], ...]";
const BOX: &str = "a box: [left, top, right, bottom]";

/// What is to be mapped.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Annotations {
    /// In the order of the request.
    pub kinds: Vec<Annotation>,
    /// From posed positions to those at rest.
    pub is_inverse: bool,
    /// Vertices are added where the map bends an edge.
    pub is_refined: bool,
    /// The number of positions.
    positions: usize,
}

/// Annotations of one kind, as the client has written them. `null` in place of an annotation stays.
#[derive(Clone, Debug, PartialEq)]
pub struct Annotation {
    kind: AnnotationKind,
    shape: GeoJsonShape,
    text: Bytes,
    /// Where the annotations are in the text: the inside of the list, or all of it.
    items: Range<usize>,
    seen: Seen,
}

/// Kinds of annotations.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum AnnotationKind {
    /// Positions.
    Points,
    /// Rings; the last vertex is connected with the first.
    Polygons,
    /// Left, top, right and bottom sides.
    Boxes,
    /// Features with their properties.
    GeoJson,
}

impl AnnotationKind {
    /// The name of the field.
    #[must_use]
    pub const fn name(self) -> &'static str {
        match self {
            Self::Points => "points",
            Self::Polygons => "polygons",
            Self::Boxes => "boxes",
            Self::GeoJson => "geojson",
        }
    }
}

/// Whether a file is GeoJSON, not a JSON object with annotations in its fields.
pub fn is_geojson(file: &[u8]) -> bool {
    let text = std::str::from_utf8(file)
        .ok()
        .map(str::trim)
        .unwrap_or_default();
    geojson::is_geojson(&Node::new(text, At::Root))
}

impl Annotations {
    /// Reads the fields. `image`: that of the positions, of the inverse or not.
    pub(super) fn read(
        body: &Bytes,
        fields: AnnotationFields<Node<'_, '_>>,
        image: impl FnOnce(bool) -> CoordinateFrame,
    ) -> Result<Self, Problem> {
        let is_inverse = optional(fields.inverse, Node::bool)?.unwrap_or(false);
        let is_refined = optional(fields.refine, Node::bool)?.unwrap_or(true);
        let fields = [
            (AnnotationKind::Points, fields.points),
            (AnnotationKind::Polygons, fields.polygons),
            (AnnotationKind::Boxes, fields.boxes),
            (AnnotationKind::GeoJson, fields.geojson),
        ];
        let mut given: Vec<_> = fields
            .into_iter()
            .filter_map(|(kind, node)| Some((kind, node?)))
            .collect();
        // The position in the text is the order of the request.
        given.sort_by_key(|(_, node)| node.text.as_ptr());
        let (mut kinds, mut positions, mut samples, image) = (Vec::new(), 0, 0, image(is_inverse));
        for (kind, node) in given {
            let mut reader =
                Reader::checking(image, is_refined || kind == AnnotationKind::Boxes, samples);
            let (shape, items) = kind.read_all(&node, &mut reader)?;
            let start = items.as_ptr() as usize - node.text.as_ptr() as usize;
            let items = match shape {
                GeoJsonShape::Single => 0..node.text.len(),
                // Without the brackets.
                GeoJsonShape::List | GeoJsonShape::FeatureCollection => {
                    start + 1..start + items.len() - 1
                }
            };
            let text = body.slice_ref(node.text.as_bytes());
            positions += reader.positions;
            let seen;
            (seen, samples) = reader.finish(&node)?;
            kinds.push(Annotation {
                kind,
                shape,
                text,
                items,
                seen,
            });
        }
        Ok(Self {
            kinds,
            is_inverse,
            is_refined,
            positions,
        })
    }

    /// Adds what the annotations of this image cause to the warnings of the handles.
    pub fn add_warnings(&self, image: &CoordinateFrame, warnings: &mut Vec<Warning>) {
        let of_handles = warnings.clone();
        for kind in &self.kinds {
            let mut all = of_handles.clone();
            kind.seen.add_warnings(image, &mut all);
            warnings.extend(all);
        }
        *warnings = Warning::in_order(std::mem::take(warnings));
    }
}

impl Annotation {
    /// The name of the field.
    #[must_use]
    pub const fn name(&self) -> &'static str {
        self.kind.name()
    }
}

impl AnnotationKind {
    /// Reads a field, whose form and annotations it returns.
    fn read_all<'j>(
        self,
        node: &Node<'j, '_>,
        reader: &mut Reader<'j>,
    ) -> Result<(GeoJsonShape, &'j str), Problem> {
        let expected = match self {
            Self::Points => "an array of positions",
            Self::Polygons => "an array of polygons",
            Self::Boxes => "an array of boxes",
            Self::GeoJson => "an array of GeoJSON features",
        };
        let (shape, text) = if self == Self::GeoJson {
            shape_of(node)?
        } else {
            (GeoJsonShape::List, node.text)
        };
        let features = At::Field(&node.at, "features");
        let list = match shape {
            GeoJsonShape::List => *node,
            GeoJsonShape::FeatureCollection => {
                read_collection(node, reader)?;
                Node {
                    text,
                    at: features,
                    work: node.work,
                }
            }
            GeoJsonShape::Single => return self.read_item(node, reader).map(|()| (shape, text)),
        };
        list.items(expected, |_, item| self.read_item(&item, reader))?;
        Ok((shape, text))
    }

    /// Reads one annotation.
    fn read_item<'j>(self, node: &Node<'j, '_>, reader: &mut Reader<'j>) -> Result<(), Problem> {
        match self {
            Self::GeoJson => read_object(node, reader),
            _ if node.kind() == Kind::Null => Ok(()),
            Self::Points => reader.place(node, place(node, PLACE)?, ""),
            Self::Polygons => read_polygon(node, reader),
            Self::Boxes => read_box(node, reader),
        }
    }
}

fn read_polygon<'j>(node: &Node<'j, '_>, reader: &mut Reader<'j>) -> Result<(), Problem> {
    let mut count = 0_usize;
    reader.line(node.text, Edges::Closed, false, |reader| {
        node.items(POLYGON, |index, vertex| {
            if vertex.kind() == Kind::Null {
                let detail = "a vertex of a polygon is null; leave it out, or send null in place \
                    of the polygon";
                return Err(vertex.problem(Code::BadValue, detail));
            }
            count = index + 1;
            reader.place(&vertex, place(&vertex, PLACE)?, "")
        })
    })?;
    if count < 3 {
        Err(node
            .unexpected(POLYGON, format_args!("{count} positions"))
            .actual(count))
    } else {
        Ok(())
    }
}

fn read_box<'j>(node: &Node<'j, '_>, reader: &mut Reader<'j>) -> Result<(), Problem> {
    let (mut sides, mut count) = ([0.0; 4], 0);
    node.items::<Problem>(BOX, |index, side| {
        *sides
            .get_mut(index)
            .ok_or_else(|| node.unexpected(BOX, "more than 4 numbers"))? =
            number(&side, "a number")?;
        count += 1;
        Ok(())
    })?;
    let [left, top, right, bottom] = sides;
    if count != 4 {
        return Err(node.unexpected(BOX, format_args!("{count} numbers")));
    }
    if right < left || bottom < top {
        let found = "a right side before the left one, or a bottom above the top; is this [left, \
            top, width, height]?";
        return Err(node.unexpected(BOX, found));
    }
    let corners = [(left, top), (right, top), (right, bottom), (left, bottom)];
    reader.line(node.text, Edges::Closed, false, |reader| {
        corners
            .into_iter()
            .try_for_each(|(x, y)| reader.place(node, Point::new(x, y), ""))
    })
}
