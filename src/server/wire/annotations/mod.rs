//! Annotations: points, polygons, boxes and GeoJSON that are mapped with the picture. [`Annotations::read`] checks them, [`Annotations::map`]
//! maps them; each kind is returned under its own name, in the order of the request.

mod geojson;
mod map;

use mlswarp::geometry::Point;

use super::handles::{PLACE, place, places};
use super::json::{Node, optional};
use super::number::number;
use crate::problem::Problem;
pub use geojson::FeatureCollection;
pub use map::MappedAnnotations;

const POLYGON: &str = "a polygon: an array of at least 3 positions, [[x, y], [x, y], [x, y], ...]";
const BOX: &str = "a box: [left, top, right, bottom]";
/// Bytes of text of an ordinary position, polygon and box.
const PLACE_TEXT: usize = 12;
const POLYGON_TEXT: usize = 40;
const BOX_TEXT: usize = 18;

/// What is to be mapped.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Annotations {
    /// In the order of the request.
    pub kinds: Vec<Annotation>,
    /// From posed positions to those at rest.
    pub is_inverse: bool,
    /// Vertices are added where the map bends an edge.
    pub is_refined: bool,
}

/// Annotations of one kind, in the client's units.
#[derive(Clone, Debug, PartialEq)]
pub enum Annotation {
    /// Positions.
    Points(Vec<Point>),
    /// Rings; the last vertex is connected with the first.
    Polygons(Vec<Vec<Point>>),
    /// Left top and right bottom.
    Boxes(Vec<[Point; 2]>),
    /// Features with their properties.
    GeoJson(FeatureCollection),
}

impl Annotation {
    /// The name of the field.
    #[must_use]
    pub const fn name(&self) -> &'static str {
        match self {
            Self::Points(_) => "points",
            Self::Polygons(_) => "polygons",
            Self::Boxes(_) => "boxes",
            Self::GeoJson(_) => "geojson",
        }
    }
}

/// Upper bound of the memory in which annotations are read from a JSON text, bytes. Positions of GeoJSON take many times their text.
#[must_use]
pub fn reading_bytes(json: &[u8]) -> u64 {
    const NAME: &[u8] = b"geojson";
    // A name with an escaped letter has a backslash.
    let may_be_geojson = json.contains(&b'\\') || json.windows(NAME.len()).any(|text| text == NAME);
    // A list, while a list of it grows; a feature and its geometry; a number of a list.
    let [list, object, number] = if may_be_geojson { [144, 256, 32] } else { [48, 0, 0] };
    let bytes = |byte: &u8| match byte {
        b'[' => list,
        b'{' => object,
        b',' => number,
        _ => 0,
    };
    json.iter().map(bytes).sum()
}

impl Annotations {
    /// Reads the fields in the order of `fields::ANNOTATIONS`.
    pub(super) fn read([points, polygons, boxes, geojson, inverse, refine]: [Option<Node<'_, '_>>; 6]) -> Result<Self, Problem> {
        let mut kinds = Vec::new();
        let mut add = |node: Option<Node<'_, '_>>, read: fn(&Node<'_, '_>) -> Result<Annotation, Problem>| {
            if let Some(node) = node {
                // The position in the text is the order of the request.
                kinds.push((node.text.as_ptr(), read(&node)?));
            }
            Ok::<_, Problem>(())
        };
        add(points, |node| places(node).map(Annotation::Points))?;
        add(polygons, |node| polygon_list(node).map(Annotation::Polygons))?;
        add(boxes, |node| box_list(node).map(Annotation::Boxes))?;
        add(geojson, |node| FeatureCollection::read(node).map(Annotation::GeoJson))?;
        kinds.sort_by_key(|(at, _)| *at);
        Ok(Self {
            kinds: kinds.into_iter().map(|(_, kind)| kind).collect(),
            is_inverse: optional(inverse, Node::bool)?.unwrap_or(false),
            is_refined: optional(refine, Node::bool)?.unwrap_or(true),
        })
    }
}

fn polygon_list(node: &Node<'_, '_>) -> Result<Vec<Vec<Point>>, Problem> {
    node.list("an array of polygons", POLYGON_TEXT, |_, polygon| {
        let ring = polygon.list(POLYGON, PLACE_TEXT, |_, item| place(&item, PLACE))?;
        if ring.len() < 3 {
            return Err(polygon.unexpected(POLYGON, format_args!("{} positions", ring.len())).actual(ring.len()));
        }
        Ok(ring)
    })
}

fn box_list(node: &Node<'_, '_>) -> Result<Vec<[Point; 2]>, Problem> {
    node.list("an array of boxes", BOX_TEXT, |_, item| {
        let (mut sides, mut count) = ([0.0; 4], 0);
        item.items::<Problem>(BOX, |index, side| {
            *sides.get_mut(index).ok_or_else(|| item.unexpected(BOX, "more than 4 numbers"))? = number(&side, "a number")?;
            count += 1;
            Ok(())
        })?;
        let [left, top, right, bottom] = sides;
        match count {
            4 if left <= right && top <= bottom => Ok([Point::new(left, top), Point::new(right, bottom)]),
            4 => {
                Err(item
                    .unexpected(BOX, "a right side before the left one, or a bottom above the top; is this [left, top, width, height]?"))
            }
            _ => Err(item.unexpected(BOX, format_args!("{count} numbers"))),
        }
    })
}
