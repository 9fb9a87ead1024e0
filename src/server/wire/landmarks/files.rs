//! The landmarks of a request: one file, or one for each side.

use std::collections::HashMap;

use bytes::Bytes;
use mlswarp::deform::Handle;
use mlswarp::geometry::Point;
use mlswarp::pixmap::Extent;
use mlswarp::warp::Units;
use serde::ser::{Serialize, SerializeMap as _, Serializer};

use super::bad::Bad;
use super::{File, read};
use crate::problem::{Code, Problem};
use crate::wire::AsJson;

/// The files as they came.
#[derive(Clone, Debug, Default)]
pub struct LandmarkFiles {
    /// Both sides, or `p` alone.
    pub both: Option<Bytes>,
    /// The rest positions.
    pub p: Option<Bytes>,
    /// The posed positions.
    pub q: Option<Bytes>,
    /// The image that normalised coordinates of `p` belong to.
    pub extent_p: Option<Extent>,
    /// The image that normalised coordinates of `q` belong to; by default that of `p`.
    pub extent_q: Option<Extent>,
}

/// Names that only one side has; their landmarks are left out.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub struct Unmatched {
    pub(crate) p: Vec<String>,
    pub(crate) q: Vec<String>,
}

impl Unmatched {
    /// Whether every landmark has two sides.
    pub fn is_empty(&self) -> bool {
        self.p.is_empty() && self.q.is_empty()
    }
}

/// Handles that were read.
#[derive(Clone, Debug, PartialEq)]
pub struct Landmarks {
    pub(crate) p: Vec<Handle>,
    pub(crate) q: Option<Vec<Handle>>,
    pub(crate) names: Option<Vec<String>>,
    pub(crate) units: Units,
    pub(crate) format: String,
    pub(crate) unmatched: Unmatched,
}

impl LandmarkFiles {
    /// Bytes of all files.
    pub fn bytes(&self) -> usize {
        [&self.both, &self.p, &self.q].into_iter().flatten().map(Bytes::len).sum()
    }

    /// Whether no file is there.
    pub fn is_empty(&self) -> bool {
        self.both.is_none() && self.p.is_none() && self.q.is_none()
    }

    /// Reads the files. `image`: the extent that normalised coordinates belong to where the request gives none.
    /// Errors: `bad_landmarks` with line and column, `too_large`, or `malformed_request` for files that do not go together.
    pub fn read(&self, max_columns: usize, image: Option<Extent>) -> Result<Landmarks, Problem> {
        let file = |name: &str, bytes: &Bytes| read(bytes, max_columns).map_err(|bad| bad.problem(name, bytes));
        let extent_p = self.extent_p.or(image);
        let extents = [extent_p, self.extent_q.or(extent_p)];
        match (&self.both, &self.p, &self.q) {
            (Some(both), None, None) => one(file("landmarks", both)?, extents),
            (None, Some(p), Some(q)) => {
                let files = [file("landmarks_p", p)?, file("landmarks_q", q)?];
                for (side, name) in files.iter().zip(["landmarks_p", "landmarks_q"]) {
                    if side.q.is_some() {
                        let detail = format!("{name}: expected positions of one side; found both sides: send this file alone, as `landmarks`");
                        return Err(Bad::new(0, detail).problem(name, b""));
                    }
                }
                two(files, extents, p, q)
            }
            (None, Some(p), None) => one(file("landmarks_p", p)?, extents),
            (None, None, Some(_)) => Err(malformed("`landmarks_p` is missing: where do the handles start?")),
            (None, None, None) => Err(malformed("`landmarks` is missing, or `landmarks_p` and `landmarks_q`")),
            (Some(_), ..) => Err(malformed("send `landmarks` alone, or `landmarks_p` and `landmarks_q`")),
        }
    }
}

fn malformed(detail: &str) -> Problem {
    Problem::new(Code::MalformedRequest, detail)
}

fn one(file: File, extents: [Option<Extent>; 2]) -> Result<Landmarks, Problem> {
    let File { p, q, names, units, format, unmatched, .. } = file;
    in_units(Landmarks { p, q, names, units, format: format.to_owned(), unmatched }, [units; 2], extents)
}

fn two([p, q]: [File; 2], extents: [Option<Extent>; 2], text_p: &[u8], text_q: &[u8]) -> Result<Landmarks, Problem> {
    let units = [p.units, q.units];
    let format = if p.format == q.format { p.format.to_owned() } else { format!("{}+{}", p.format, q.format) };
    let (rest, posed, names, unmatched) = match (p.names, q.names) {
        (Some(names_p), Some(names_q)) => {
            let mut others: HashMap<String, Handle> = names_q.iter().cloned().zip(q.p).collect();
            let (mut rest, mut posed, mut names, mut unmatched) = (Vec::new(), Vec::new(), Vec::new(), Unmatched::default());
            for (name, handle) in names_p.into_iter().zip(p.p) {
                match others.remove(&name) {
                    Some(other) => {
                        rest.push(handle);
                        posed.push(other);
                        names.push(name);
                    }
                    None => unmatched.p.push(name),
                }
            }
            // In the order of the file.
            unmatched.q = names_q.into_iter().filter(|name| others.contains_key(name)).collect();
            if rest.is_empty() {
                let detail = format!("expected a name that `landmarks_p` has too; found none of its {}", unmatched.p.len());
                return Err(Bad::new(q.at[0], detail).problem("landmarks_q", text_q));
            }
            (rest, posed, Some(names), unmatched)
        }
        (names_p, names_q) => {
            let shorter = p.p.len().min(q.p.len());
            let surplus = [(&p.at, "landmarks_p", text_p), (&q.at, "landmarks_q", text_q)];
            if let Some((at, part, text)) = surplus.into_iter().find_map(|(at, part, text)| Some((*at.get(shorter)?, part, text))) {
                let detail = format!(
                    "expected {shorter} landmarks, as the other file has; found {}: without names in both files they are matched by order",
                    p.p.len().max(q.p.len())
                );
                return Err(Bad::new(at, detail).problem(part, text));
            }
            (p.p, q.p, names_p.or(names_q), Unmatched::default())
        }
    };
    in_units(Landmarks { p: rest, q: Some(posed), names, units: units[0], format, unmatched }, units, extents)
}

/// Multiplies normalised coordinates by the extents. Without an extent they stay normalised, if both sides are.
fn in_units(mut landmarks: Landmarks, [units_p, units_q]: [Units; 2], [extent_p, extent_q]: [Option<Extent>; 2]) -> Result<Landmarks, Problem> {
    let is_posed = landmarks.q.is_some();
    let scaled = |units: Units, extent: Option<Extent>| units == Units::Normalized && extent.is_some();
    let stays = |units: Units, extent: Option<Extent>| units == Units::Normalized && extent.is_none();
    if is_posed && stays(units_p, extent_p) != stays(units_q, extent_q) {
        let missing = if stays(units_p, extent_p) { "extent_p" } else { "extent_q" };
        let detail = format!("one side is normalised and the other is in px: give `{missing}`, the width and height of its image, such as 640,480");
        return Err(Problem::new(Code::BadValue, detail));
    }
    if scaled(units_p, extent_p) {
        multiply(&mut landmarks.p, extent_p);
    }
    if scaled(units_q, extent_q) {
        multiply(landmarks.q.as_deref_mut().unwrap_or_default(), extent_q);
    }
    landmarks.units = if stays(units_p, extent_p) { Units::Normalized } else { Units::Px };
    Ok(landmarks)
}

fn multiply(handles: &mut [Handle], extent: Option<Extent>) {
    let Some(extent) = extent else { return };
    let (width, height) = (f64::from(extent.width()), f64::from(extent.height()));
    let scale = |place: &mut Point| *place = Point::new(place.x * width, place.y * height);
    for handle in handles {
        match handle {
            Handle::Point(place) => scale(place),
            Handle::Polyline(places) => places.iter_mut().for_each(scale),
        }
    }
}

impl Serialize for Landmarks {
    fn serialize<S: Serializer>(&self, s: S) -> Result<S::Ok, S::Error> {
        let mut object = s.serialize_map(None)?;
        object.serialize_entry("p", &AsJson(self.p.as_slice()))?;
        if let Some(q) = &self.q {
            object.serialize_entry("q", &AsJson(q.as_slice()))?;
        }
        if let Some(names) = &self.names {
            object.serialize_entry("names", names)?;
        }
        object.serialize_entry("units", &AsJson(self.units))?;
        object.serialize_entry("format", &self.format)?;
        if !self.unmatched.is_empty() {
            let Unmatched { p, q } = &self.unmatched;
            object.serialize_entry("unmatched", &std::collections::BTreeMap::from([("p", p), ("q", q)]))?;
        }
        object.end()
    }
}
