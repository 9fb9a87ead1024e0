//! Annotations mapped by a deformation or its inverse, and their JSON.

use mlswarp::deform::IsCancelled;
use mlswarp::geometry::Point;
use mlswarp::warp::{Edges, Outline, Transform, WarpError};
use serde::ser::{Serialize, SerializeMap, Serializer};
use serde_json::value::RawValue;

use super::super::AsJson;
use super::geojson::Part;
use super::{Annotation, Annotations, FeatureCollection};
use crate::problem::{Code, Problem};

/// Distance of mapped outlines from the exact map, px.
const OUTLINE_WITHIN: f64 = 0.1;
/// The same of the outlines whose bounding boxes are taken.
const BOX_WITHIN: f64 = 0.01;
/// Longest text of a mapped position, bytes: two numbers of 24 characters, brackets, commas.
const PLACE_TEXT: usize = 52;
/// The outline of a box, at rest and mapped, bytes.
const BOX_OUTLINES: usize = 256;
/// The text around a list, bytes.
const LIST_TEXT: usize = 16;

/// Annotations that have been mapped, in the order of the request.
#[derive(Debug)]
pub struct MappedAnnotations(Vec<Mapped>);

#[derive(Debug)]
enum Mapped {
    Points(Vec<Option<Point>>),
    Polygons(Vec<Option<Vec<Point>>>),
    Boxes(Vec<Option<[f64; 4]>>),
    GeoJson(Box<RawValue>),
}

impl Annotations {
    /// Maps everything. CPU work, in parallel on the current rayon pool.
    /// Errors: A coordinate out of range, too many positions to examine, cancelled.
    pub fn map(self, transform: &Transform<'_>, cancelled: IsCancelled<'_>) -> Result<MappedAnnotations, Problem> {
        let tolerance = self.is_refined.then_some(OUTLINE_WITHIN);
        let map = |annotation: Annotation| match annotation {
            Annotation::Points(points) => {
                let mapped = transform.map(&points, cancelled);
                mapped.map(Mapped::Points).map_err(|error| located(error, "points", |index| index.to_string()))
            }
            Annotation::Polygons(polygons) => {
                let outlines: Vec<Outline<'_>> = polygons.iter().map(|places| Outline { places, edges: Edges::Closed }).collect();
                let mapped = transform.map_outlines(&outlines, tolerance, cancelled);
                let lengths = || polygons.iter().map(Vec::len);
                mapped.map(Mapped::Polygons).map_err(|error| {
                    located(error, "polygons", |index| {
                        let (polygon, vertex) = in_lists(lengths(), index);
                        format!("{polygon}/{vertex}")
                    })
                })
            }
            Annotation::Boxes(boxes) => {
                let corners: Vec<[Point; 4]> = boxes.iter().map(|[a, b]| [*a, Point::new(b.x, a.y), *b, Point::new(a.x, b.y)]).collect();
                let outlines: Vec<Outline<'_>> = corners.iter().map(|places| Outline { places, edges: Edges::Closed }).collect();
                let mapped = transform.map_outlines(&outlines, Some(BOX_WITHIN), cancelled);
                let mapped = mapped.map_err(|error| located(error, "boxes", |index| (index / 4).to_string()))?;
                Ok(Mapped::Boxes(mapped.into_iter().map(|outline| outline.as_deref().map(bounds)).collect()))
            }
            Annotation::GeoJson(features) => geojson(features, transform, tolerance, cancelled),
        };
        self.kinds.into_iter().map(map).collect::<Result<_, _>>().map(MappedAnnotations)
    }

    /// Memory of the result and of its text if nothing is refined, bytes.
    #[must_use]
    pub fn least_mapped_bytes(&self) -> u64 {
        let list = |places: usize| places * (PLACE_TEXT + size_of::<Option<Point>>()) + LIST_TEXT;
        let kind = |kind: &Annotation| match kind {
            Annotation::Points(points) => list(points.len()),
            Annotation::Polygons(polygons) => polygons.iter().map(|ring| list(ring.len())).sum(),
            Annotation::Boxes(boxes) => boxes.len() * (list(2) + BOX_OUTLINES),
            Annotation::GeoJson(features) => features.most_bytes(),
        };
        self.kinds.iter().map(|annotation| kind(annotation) as u64 + LIST_TEXT as u64).sum()
    }
}

impl MappedAnnotations {
    /// Upper bound of its JSON, bytes.
    #[must_use]
    pub fn text_bytes(&self) -> usize {
        let kind = |kind: &Mapped| match kind {
            Mapped::Points(points) => points.len() * PLACE_TEXT,
            Mapped::Polygons(polygons) => polygons.iter().map(|ring| ring.as_ref().map_or(0, Vec::len) * PLACE_TEXT + LIST_TEXT).sum(),
            Mapped::Boxes(boxes) => boxes.len() * 2 * PLACE_TEXT,
            Mapped::GeoJson(text) => text.get().len(),
        };
        LIST_TEXT + self.0.iter().map(|mapped| kind(mapped) + LIST_TEXT).sum::<usize>()
    }
}

fn geojson(
    mut collection: FeatureCollection,
    transform: &Transform<'_>,
    tolerance: Option<f64>,
    cancelled: IsCancelled<'_>,
) -> Result<Mapped, Problem> {
    let mut features = collection.parts();
    let places: Vec<Vec<Vec<Point>>> = features.iter().map(|parts| parts.iter().map(Part::points).collect()).collect();
    let parts = features.iter().flatten().zip(places.iter().flatten());
    let outlines: Vec<Outline<'_>> = parts.map(|(part, places)| Outline { places, edges: part.edges() }).collect();
    let lengths = || places.iter().map(|parts| parts.iter().map(Vec::len).sum());
    let feature = |index| format!("features/{}/geometry", in_lists(lengths(), index).0);
    let mapped = transform.map_outlines(&outlines, tolerance, cancelled).map_err(|error| located(error, "geojson", feature))?;
    let mut mapped = mapped.into_iter();
    let kept: Vec<bool> = features
        .iter_mut()
        .map(|parts| {
            let mapped: Vec<_> = mapped.by_ref().take(parts.len()).collect();
            let is_whole = mapped.iter().all(Option::is_some);
            parts.iter_mut().zip(mapped).for_each(|(part, places)| part.replace(&places.unwrap_or_default()));
            is_whole
        })
        .collect();
    drop(features);
    let text = RawValue::from_string(collection.into_text(&kept));
    Ok(Mapped::GeoJson(text.map_err(|error| Problem::new(Code::Internal, format!("the mapped GeoJSON is not JSON: {error}")))?))
}

/// The problem of an error in the field `name`; `place`: the rest of the pointer to the position of an index.
fn located(error: WarpError, name: &str, place: impl Fn(usize) -> String) -> Problem {
    match error {
        WarpError::BadPlace { index, .. } => Problem::from(error).pointer(format!("/{name}/{}", place(index))),
        WarpError::TooLarge { .. } => Problem::from(error).pointer(format!("/{name}")),
        error => error.into(),
    }
}

/// The list, and the index in it, of an index into the items of lists of these lengths.
fn in_lists(lengths: impl Iterator<Item = usize>, mut index: usize) -> (usize, usize) {
    let mut list = 0;
    for length in lengths {
        if index < length {
            break;
        }
        index -= length;
        list += 1;
    }
    (list, index)
}

fn bounds(outline: &[Point]) -> [f64; 4] {
    outline.iter().fold([f64::INFINITY, f64::INFINITY, f64::NEG_INFINITY, f64::NEG_INFINITY], |[left, top, right, bottom], p| {
        [left.min(p.x), top.min(p.y), right.max(p.x), bottom.max(p.y)]
    })
}

impl Serialize for MappedAnnotations {
    fn serialize<S: Serializer>(&self, s: S) -> Result<S::Ok, S::Error> {
        let mut object = s.serialize_map(Some(self.0.len()))?;
        for mapped in &self.0 {
            match mapped {
                Mapped::Points(points) => {
                    object.serialize_entry("points", &AsJson(points.as_slice()))?;
                }
                Mapped::Polygons(polygons) => {
                    object.serialize_entry("polygons", &AsJson(polygons.as_slice()))?;
                }
                Mapped::Boxes(boxes) => object.serialize_entry("boxes", boxes)?,
                Mapped::GeoJson(features) => object.serialize_entry("geojson", features)?,
            }
        }
        object.end()
    }
}

impl Serialize for AsJson<&[Option<Point>]> {
    fn serialize<S: Serializer>(&self, s: S) -> Result<S::Ok, S::Error> {
        s.collect_seq(self.0.iter().map(|place| place.map(|place| [place.x, place.y])))
    }
}

impl Serialize for AsJson<&[Option<Vec<Point>>]> {
    fn serialize<S: Serializer>(&self, s: S) -> Result<S::Ok, S::Error> {
        s.collect_seq(self.0.iter().map(|places| places.as_deref().map(AsJson)))
    }
}
