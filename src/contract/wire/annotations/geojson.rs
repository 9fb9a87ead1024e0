//! GeoJSON (RFC 7946) as the client wrote it: a FeatureCollection, a list of features, one feature,
//! or one geometry. Every member of a feature that is a geometry is mapped, such as the
//! `nucleusGeometry` of QuPath, and every such member of its `properties`. Only positions and
//! bounding boxes are replaced; everything else stays the client's text, byte for byte.

use mlswarp::geometry::Point;
use mlswarp::warp::Edges;

use super::super::json::{At, Kind, Node};
use super::super::number::number;
use super::reader::{GeoJsonObject, Geometry, Reader};
use crate::problem::words::quote;
use crate::problem::{Code, Problem};

const SHAPES: &str =
    "GeoJSON: a FeatureCollection, a list of features, one Feature, or one geometry";
const FEATURES: &str = "an array of GeoJSON features";
const OBJECT: &str = "a GeoJSON Feature or geometry: {\"type\": ...}";
const GEOMETRY: &str = "a GeoJSON geometry: {\"type\": \"Polygon\", \"coordinates\": [...]}";
const POSITION: &str = "a position: [x, y]";
/// GeometryCollections that may contain one another.
const MAX_COLLECTION_DEPTH: usize = 16;

const COLLECTION: &str = "GeometryCollection";
/// The geometries with coordinates: how deep their lists of positions are, and what connects those.
const GEOMETRIES: [(&str, usize, Edges); 6] = [
    ("Point", 0, Edges::None),
    ("MultiPoint", 0, Edges::None),
    ("LineString", 0, Edges::Open),
    ("MultiLineString", 1, Edges::Open),
    ("Polygon", 1, Edges::Open),
    ("MultiPolygon", 2, Edges::Open),
];

/// The outermost form, which the response has too.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum GeoJsonShape {
    List,
    FeatureCollection,
    Single,
}

/// The form of a text, and the text of its features.
/// Errors: Not GeoJSON.
pub(super) fn shape_of<'j>(node: &Node<'j, '_>) -> Result<(GeoJsonShape, &'j str), Problem> {
    match node.kind() {
        Kind::Array => return Ok((GeoJsonShape::List, node.text)),
        Kind::Object => {}
        _ => return Err(node.wrong_kind(SHAPES)),
    }
    let [kind, features] = node.find(&["type", "features"])?;
    let kind = kind.ok_or_else(|| node.missing("type", SHAPES))?;
    match &*kind.string(SHAPES)? {
        "FeatureCollection" => {
            let features = features.ok_or_else(|| node.missing("features", FEATURES))?;
            if features.kind() == Kind::Array {
                Ok((GeoJsonShape::FeatureCollection, features.text))
            } else {
                Err(features.wrong_kind(FEATURES))
            }
        }
        name if name == "Feature" || is_geometry_type(name) => {
            Ok((GeoJsonShape::Single, node.text))
        }
        name => Err(kind.unexpected(SHAPES, format_args!("the type {}", quote(name)))),
    }
}

/// Whether a text is GeoJSON and not an object of annotations.
pub(super) fn is_geojson(node: &Node<'_, '_>) -> bool {
    let is_type =
        |name: &str| ["FeatureCollection", "Feature"].contains(&name) || is_geometry_type(name);
    match node.kind() {
        Kind::Array => true,
        Kind::Object => type_of(node).is_some_and(|name| is_type(&name)),
        _ => false,
    }
}

/// The members of a FeatureCollection, without its features.
pub(super) fn read_collection<'j>(
    node: &Node<'j, '_>,
    reader: &mut Reader<'j>,
) -> Result<(), Problem> {
    let first = reader.line_count();
    let [bbox] = node.find(&["bbox"])?;
    object(reader, |reader| {
        members(node, &["type", "features", "bbox"], reader)?;
        Ok((first..first, bbox.map(|bbox| bbox.text)))
    })
}

/// A feature, or a geometry in place of one.
pub(super) fn read_object<'j>(node: &Node<'j, '_>, reader: &mut Reader<'j>) -> Result<(), Problem> {
    if node.kind() != Kind::Object {
        return Err(node.wrong_kind(OBJECT));
    }
    let [kind] = node.find(&["type"])?;
    let kind = kind.ok_or_else(|| node.missing("type", OBJECT))?;
    let first = reader.line_count();
    match &*kind.string(OBJECT)? {
        "Feature" => object(reader, |reader| {
            let [own, properties, bbox] = node.find(&["geometry", "properties", "bbox"])?;
            own.map(|own| geometry(&own, reader)).transpose()?;
            let own = first..reader.line_count();
            members(
                node,
                &["type", "id", "geometry", "properties", "bbox"],
                reader,
            )?;
            if let Some(properties) = properties.filter(|p| p.kind() == Kind::Object) {
                members(&properties, &[], reader)?;
            }
            Ok((own, bbox.map(|bbox| bbox.text)))
        }),
        name if is_geometry_type(name) => object(reader, |reader| {
            geometry(node, reader)?;
            Ok((first..reader.line_count(), None))
        }),
        name => Err(kind.unexpected(OBJECT, format_args!("the type {}", quote(name)))),
    }
}

type Own<'j> = (std::ops::Range<usize>, Option<&'j str>);

/// Reads an object with geometries by `read`.
fn object<'j>(
    reader: &mut Reader<'j>,
    read: impl FnOnce(&mut Reader<'j>) -> Result<Own<'j>, Problem>,
) -> Result<(), Problem> {
    let count = |reader: &Reader<'_>| reader.kept.as_ref().map_or(0, |kept| kept.geometries.len());
    let first = count(reader);
    let (own, bbox) = read(reader)?;
    let geometries = first..count(reader);
    if let Some(kept) = &mut reader.kept {
        kept.objects.push(GeoJsonObject {
            geometries,
            own,
            bbox,
        });
    }
    Ok(())
}

/// The members that are geometries, without the `known` ones.
fn members<'j>(
    node: &Node<'j, '_>,
    known: &[&str],
    reader: &mut Reader<'j>,
) -> Result<(), Problem> {
    for (name, text) in node.pairs().filter(|(_, text)| text.starts_with('{')) {
        let Some(name) = Node::name(name).filter(|name| !known.contains(&&**name)) else {
            continue;
        };
        let member = Node {
            text,
            at: At::Member(&node.at, &name),
            work: node.work,
        };
        if is_geometry(&member) {
            geometry(&member, reader)?;
        }
    }
    Ok(())
}

fn type_of(node: &Node<'_, '_>) -> Option<String> {
    let [kind] = node.find(&["type"]).ok()?;
    kind?.string("").ok()
}

fn is_geometry_type(name: &str) -> bool {
    name == COLLECTION || GEOMETRIES.iter().any(|(known, ..)| *known == name)
}

/// Whether a member that has any name is a geometry: it has the type and the list of one.
fn is_geometry(node: &Node<'_, '_>) -> bool {
    let Some(name) = type_of(node).filter(|name| is_geometry_type(name)) else {
        return false;
    };
    let list = if name == COLLECTION {
        "geometries"
    } else {
        "coordinates"
    };
    node.find(&[list])
        .is_ok_and(|[list]| list.is_some_and(|list| list.kind() == Kind::Array))
}

fn geometry<'j>(node: &Node<'j, '_>, reader: &mut Reader<'j>) -> Result<(), Problem> {
    let (first, mut boxes) = (reader.line_count(), Vec::new());
    nested(node, reader, &mut boxes, 0)?;
    let lines = first..reader.line_count();
    if let Some(kept) = &mut reader.kept {
        kept.geometries.push(Geometry {
            text: node.text,
            lines,
            boxes,
        });
    }
    Ok(())
}

/// A geometry, or one of a GeometryCollection.
fn nested<'j>(
    node: &Node<'j, '_>,
    reader: &mut Reader<'j>,
    boxes: &mut Vec<(&'j str, std::ops::Range<usize>)>,
    depth: usize,
) -> Result<(), Problem> {
    if node.kind() != Kind::Object {
        return Err(node.wrong_kind(GEOMETRY));
    }
    let [kind, coordinates, geometries, bbox] =
        node.find(&["type", "coordinates", "geometries", "bbox"])?;
    let kind = kind.ok_or_else(|| node.missing("type", GEOMETRY))?;
    let (name, first) = (kind.string(GEOMETRY)?, reader.line_count());
    if name == COLLECTION {
        if depth == MAX_COLLECTION_DEPTH {
            let detail =
                format!("more than {MAX_COLLECTION_DEPTH} GeometryCollections contain one another");
            return Err(node.problem(Code::BadValue, detail));
        }
        let missing = || node.missing("geometries", "an array of GeoJSON geometries");
        geometries
            .ok_or_else(missing)?
            .items("an array of GeoJSON geometries", |_, inner| {
                nested(&inner, reader, boxes, depth + 1)
            })?;
    } else {
        let Some((_, depth, edges)) = GEOMETRIES.iter().find(|(known, ..)| *known == name) else {
            return Err(kind.unexpected(GEOMETRY, format_args!("the type {}", quote(&name))));
        };
        let positions = coordinates.ok_or_else(|| node.missing("coordinates", "an array"))?;
        if name == "Point" {
            single(&positions, reader)?
        } else {
            lists(&positions, *depth, *edges, reader)?
        }
    }
    // Only what is kept is replaced.
    if let (Some(bbox), true) = (bbox, reader.kept.is_some()) {
        boxes.push((bbox.text, first..reader.line_count()));
    }
    Ok(())
}

/// The coordinates of a Point; an empty array is a point without a position.
fn single<'j>(node: &Node<'j, '_>, reader: &mut Reader<'j>) -> Result<(), Problem> {
    let mut is_empty = true;
    node.items::<Problem>(POSITION, |_, _| {
        is_empty = false;
        Ok(())
    })?;
    if is_empty {
        return Ok(());
    }
    reader.line(node.text, Edges::None, true, |reader| {
        position(node, reader)
    })
}

/// Lists of positions in lists of this depth.
fn lists<'j>(
    node: &Node<'j, '_>,
    depth: usize,
    edges: Edges,
    reader: &mut Reader<'j>,
) -> Result<(), Problem> {
    if depth > 0 {
        return node.items("an array of arrays of positions", |_, inner| {
            lists(&inner, depth - 1, edges, reader)
        });
    }
    reader.line(node.text, edges, false, |reader| {
        node.items("an array of positions", |_, item| position(&item, reader))
    })
}

/// A position of two numbers, or more: those after them, such as a height, stay as they are.
fn position<'j>(node: &Node<'j, '_>, reader: &mut Reader<'j>) -> Result<(), Problem> {
    let (mut place, mut count, mut end) = ([0.0; 2], 0, 0);
    node.items::<Problem>(POSITION, |index, item| {
        if let Some(place) = place.get_mut(index) {
            *place = number(&item, "a number")?;
            end = item.text.as_ptr() as usize + item.text.len() - node.text.as_ptr() as usize;
        }
        count = index + 1;
        Ok(())
    })?;
    match count {
        0 => Err(node.unexpected(POSITION, "an empty array")),
        1 => Err(node.unexpected(POSITION, "1 number")),
        // Without the bracket.
        _ => {
            let more = node
                .text
                .get(end..node.text.len() - 1)
                .unwrap_or_default()
                .trim_end();
            reader.place(node, Point::new(place[0], place[1]), more)
        }
    }
}
