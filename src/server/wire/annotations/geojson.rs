//! A GeoJSON FeatureCollection (RFC 7946) as the client wrote it. Geometries are read and written by the `geojson` crate; everything else
//! (ids, properties, foreign members, order, white space) stays the client's text, byte for byte.

use std::fmt::Write as _;
use std::ops::Range;

use geojson::{Geometry, GeometryValue, Position};
use mlswarp::geometry::Point;
use mlswarp::warp::Edges;

use super::super::json::{Kind, Node};
use crate::problem::{Code, Problem};

const COLLECTION: &str = "a GeoJSON FeatureCollection: {\"type\": \"FeatureCollection\", \"features\": [...]}";
const FEATURE: &str = "a GeoJSON Feature: {\"type\": \"Feature\", \"geometry\": {...}, \"properties\": {...}}";
/// Most objects in a geometry: those of a GeometryCollection, or foreign members. Each takes several hundred bytes of memory.
const MOST_OBJECTS: usize = 1000;

/// A FeatureCollection: its text, and what is replaced in it.
#[derive(Clone, Debug, PartialEq)]
pub struct FeatureCollection {
    text: String,
    features: Vec<Feature>,
    bbox: Option<Range<usize>>,
}

/// A feature: where its geometry and bounding box are in the text.
#[derive(Clone, Debug, PartialEq)]
struct Feature {
    geometry: Option<(Range<usize>, Geometry)>,
    bbox: Option<Range<usize>>,
}

/// Positions of a geometry that are mapped together.
pub(super) enum Part<'a> {
    /// A position.
    Position(&'a mut Position),
    /// Positions without edges.
    Positions(&'a mut Vec<Position>),
    /// A line, or a ring that ends where it begins.
    Line(&'a mut Vec<Position>),
}

/// The smallest box that contains positions.
#[derive(Clone, Copy, Debug)]
struct Bounds([f64; 4]);

impl FeatureCollection {
    pub(super) fn read(node: &Node<'_, '_>) -> Result<Self, Problem> {
        if node.kind() != Kind::Object {
            return Err(node.wrong_kind(COLLECTION));
        }
        let start = node.text.as_ptr() as usize;
        let range = |inner: &Node<'_, '_>| {
            let from = inner.text.as_ptr() as usize - start;
            from..from + inner.text.len()
        };
        let [kind, features, bbox] = node.find(&["type", "features", "bbox"])?;
        require_type(node, kind, "FeatureCollection", COLLECTION)?;
        let features = features.ok_or_else(|| node.missing("features", "an array of GeoJSON features"))?;
        let features = features.list("an array of GeoJSON features", 100, |_, feature| {
            if feature.kind() != Kind::Object {
                return Err(feature.wrong_kind(FEATURE));
            }
            let [kind, geometry, bbox] = feature.find(&["type", "geometry", "bbox"])?;
            require_type(&feature, kind, "Feature", FEATURE)?;
            let geometry = geometry.map(|node| Ok::<_, Problem>((range(&node), read_geometry(&node)?))).transpose()?;
            Ok(Feature { geometry, bbox: bbox.map(|node| range(&node)) })
        })?;
        Ok(Self { bbox: bbox.map(|node| range(&node)), text: node.text.to_owned(), features })
    }

    /// The parts of each feature's geometry, in their order.
    pub(super) fn parts(&mut self) -> Vec<Vec<Part<'_>>> {
        self.features.iter_mut().map(|feature| feature.geometry.as_mut().map_or_else(Vec::new, |(_, geometry)| parts(geometry))).collect()
    }

    /// The memory of the mapped text if nothing is refined, bytes.
    pub(super) fn most_bytes(&self) -> usize {
        /// A short position, `[0,0],`, becomes one of 52 bytes.
        const GROWTH: usize = 9;
        let geometries = self.features.iter().filter_map(|feature| feature.geometry.as_ref());
        self.text.len() + GROWTH * geometries.map(|(range, _)| range.len()).sum::<usize>()
    }

    /// The text with the geometries as they are now; `null` for features that are not `kept`.
    pub(super) fn into_text(mut self, kept: &[bool]) -> String {
        let mut all = Bounds::EMPTY;
        let mut replaced: Vec<(Range<usize>, String)> = Vec::new();
        for (feature, kept) in self.features.iter_mut().zip(kept) {
            let mut bounds = Bounds::EMPTY;
            if let Some((range, mut geometry)) = feature.geometry.take() {
                let text = if *kept {
                    bounds.add(&mut geometry);
                    drop_bounds(&mut geometry);
                    serde_json::to_string(&geometry).unwrap_or_else(|_| "null".to_owned())
                } else {
                    "null".to_owned()
                };
                replaced.push((range, text));
            }
            all.merge(bounds);
            replaced.extend(feature.bbox.take().map(|range| (range, bounds.text())));
        }
        replaced.extend(self.bbox.take().map(|range| (range, all.text())));
        replaced.sort_by_key(|(range, _)| range.start);
        let mut text = String::with_capacity(self.text.len() + replaced.iter().map(|(_, new)| new.len()).sum::<usize>());
        let mut end = 0;
        for (range, new) in replaced {
            text += &self.text[end..range.start];
            text += &new;
            end = range.end;
        }
        text + &self.text[end..]
    }
}

impl Part<'_> {
    pub(super) fn positions(&self) -> &[Position] {
        match self {
            Self::Position(position) => std::slice::from_ref(*position),
            Self::Positions(positions) | Self::Line(positions) => positions,
        }
    }

    pub(super) fn points(&self) -> Vec<Point> {
        self.positions().iter().map(|position| Point::new(position[0], position[1])).collect()
    }

    pub(super) const fn edges(&self) -> Edges {
        if matches!(self, Self::Line(_)) { Edges::Open } else { Edges::None }
    }

    pub(super) fn replace(&mut self, points: &[Point]) {
        let mut positions = points.iter().map(|point| Position::from([point.x, point.y]));
        match self {
            Self::Position(position) => **position = positions.next().unwrap_or_else(|| position.clone()),
            Self::Positions(all) | Self::Line(all) => **all = positions.collect(),
        }
    }
}

fn require_type(node: &Node<'_, '_>, kind: Option<Node<'_, '_>>, name: &str, expected: &str) -> Result<(), Problem> {
    let kind = kind.ok_or_else(|| node.missing("type", expected))?;
    let found = kind.string(expected)?;
    if found == name { Ok(()) } else { Err(kind.unexpected(expected, format_args!("the type {}", crate::problem::words::quote(&found)))) }
}

fn read_geometry(node: &Node<'_, '_>) -> Result<Geometry, Problem> {
    if node.text.bytes().filter(|byte| *byte == b'{').count() > MOST_OBJECTS {
        return Err(node.problem(Code::BadValue, format!("a geometry of more than {MOST_OBJECTS} objects; use several features")));
    }
    let bad = |what: &dyn std::fmt::Display| node.problem(Code::BadValue, format!("not a GeoJSON geometry: {what}"));
    let mut geometry: Geometry = serde_json::from_str(node.text).map_err(|error| {
        // The parser has no other sign of it.
        if error.to_string().starts_with("number out of range") {
            return node.problem(Code::NotFinite, "a number of the geometry exceeds the range of a 64-bit float");
        }
        bad(&error)
    })?;
    match parts(&mut geometry).iter().flat_map(|part| part.positions()).find(|position| position.len() != 2) {
        Some(position) => Err(bad(&format_args!("expected positions [x, y]; found one of {} numbers", position.len()))),
        None => Ok(geometry),
    }
}

fn parts(geometry: &mut Geometry) -> Vec<Part<'_>> {
    let mut parts = Vec::new();
    add_parts(&mut geometry.value, &mut parts);
    parts
}

fn add_parts<'a>(value: &'a mut GeometryValue, parts: &mut Vec<Part<'a>>) {
    match value {
        GeometryValue::Point { coordinates } => parts.push(Part::Position(coordinates)),
        GeometryValue::MultiPoint { coordinates } => parts.push(Part::Positions(coordinates)),
        GeometryValue::LineString { coordinates } => parts.push(Part::Line(coordinates)),
        GeometryValue::MultiLineString { coordinates } | GeometryValue::Polygon { coordinates } => {
            parts.extend(coordinates.iter_mut().map(Part::Line));
        }
        GeometryValue::MultiPolygon { coordinates } => parts.extend(coordinates.iter_mut().flatten().map(Part::Line)),
        GeometryValue::GeometryCollection { geometries } => {
            geometries.iter_mut().for_each(|geometry| add_parts(&mut geometry.value, parts));
        }
    }
}

/// Removes the bounding boxes of a geometry and of those in it, which are those of the positions before.
fn drop_bounds(geometry: &mut Geometry) {
    geometry.bbox = None;
    if let GeometryValue::GeometryCollection { geometries } = &mut geometry.value {
        geometries.iter_mut().for_each(drop_bounds);
    }
}

impl Bounds {
    const EMPTY: Self = Self([f64::INFINITY, f64::INFINITY, f64::NEG_INFINITY, f64::NEG_INFINITY]);

    fn add(&mut self, geometry: &mut Geometry) {
        for position in parts(geometry).iter().flat_map(|part| part.positions()) {
            let (x, y) = (position[0], position[1]);
            self.merge(Self([x, y, x, y]));
        }
    }

    const fn merge(&mut self, Self([left, top, right, bottom]): Self) {
        let Self(own) = self;
        *own = [own[0].min(left), own[1].min(top), own[2].max(right), own[3].max(bottom)];
    }

    /// `null` if it is empty.
    fn text(&self) -> String {
        let Self([left, top, right, bottom]) = self;
        let mut text = String::from("null");
        if left <= right {
            text.clear();
            let _ = write!(text, "[{left},{top},{right},{bottom}]");
        }
        text
    }
}
