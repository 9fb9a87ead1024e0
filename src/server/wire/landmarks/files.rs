//! The landmarks of a request: one file, or one for each side.

use bytes::Bytes;
use mlswarp::deform::{DeformError, Handle, Handles};
use mlswarp::geometry::Point;
use mlswarp::pixmap::Extent;
use mlswarp::warp::{Units, WarpError};
use serde::ser::{Serialize, SerializeMap as _, Serializer};

use super::bad::Bad;
use super::pairs::{Pairs, Unmatched, pair};
use super::{File, Work, read};
use crate::problem::words::quote;
use crate::problem::{Code, Problem};
use crate::wire::{AsJson, WarpObject};

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

/// The code of the warning about names that only one side has.
pub const UNMATCHED: &str = "landmarks_unmatched";
/// The parts with one side each.
const SIDES: [&str; 2] = ["landmarks_p", "landmarks_q"];
/// The longest side of an image that normalised coordinates belong to, px: the largest ones (4) stay within the range of coordinates.
const LONGEST_SIDE: u32 = 250_000;

/// Handles that were read, each side in the units of its file.
#[derive(Clone, Debug, PartialEq)]
pub struct Landmarks {
    p: Vec<Handle>,
    q: Option<Vec<Handle>>,
    names: Option<Vec<String>>,
    units: [Units; 2],
    extents: [Option<Extent>; 2],
    format: String,
    unmatched: Unmatched,
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

    /// The memory that reading takes at most, bytes: handles, their places and names, in each file.
    pub(in crate::wire) fn reading_bytes(&self, max_columns: usize) -> u64 {
        const HANDLE: usize = 400;
        const NAME: usize = 4 * 256;
        let files = [&self.both, &self.p, &self.q].into_iter().flatten();
        let bytes = files.map(|file| {
            // A handle takes two bytes of text at least.
            let handles = max_columns.min(file.len() / 2 + 1);
            HANDLE * handles + (4 * file.len()).min(NAME * handles)
        });
        bytes.sum::<usize>() as u64
    }

    /// Reads the files. `cancelled` is true when nobody wants the result any more.
    /// Errors: `bad_landmarks`, with line and column unless the files do not go together, `too_large`, or cancelled.
    pub(in crate::wire) fn read(&self, max_columns: usize, cancelled: &dyn Fn() -> bool) -> Result<Landmarks, Problem> {
        self.read_counted(max_columns, &Work::new(cancelled))
    }

    /// As [`Self::read`]; the work is counted.
    pub(super) fn read_counted(&self, max_columns: usize, work: &Work<'_>) -> Result<Landmarks, Problem> {
        let file = |name: &str, bytes: &Bytes| {
            let file = read(bytes, max_columns, work);
            if work.is_stopped() {
                return Err(WarpError::Cancelled.into());
            }
            file.map_err(|bad| bad.problem(name, bytes))
        };
        let rest = |name: &str, bytes: &Bytes| {
            let file = file(name, bytes)?;
            require_lines(&file).map_err(|bad| bad.problem(name, bytes))?;
            Ok::<_, Problem>(file)
        };
        let extents = [self.extent_p, self.extent_q];
        match (&self.both, &self.p, &self.q) {
            (Some(both), None, None) => Ok(one(rest("landmarks", both)?, extents)),
            (None, Some(p), Some(q)) => {
                let files = [rest(SIDES[0], p)?, file(SIDES[1], q)?];
                for (side, name) in files.iter().zip(SIDES) {
                    if side.q.is_some() {
                        let detail =
                            format!("{name}: expected positions of one side; found both sides: send this file alone, as `landmarks`");
                        return Err(Bad::new(0, detail).problem(name, b""));
                    }
                }
                let pairs = pair(&files).map_err(|(side, bad)| bad.problem(SIDES[side], [p, q][side]))?;
                Ok(two(files, pairs, extents))
            }
            (None, Some(p), None) => Ok(one(rest(SIDES[0], p)?, extents)),
            (None, None, Some(_)) => Err(mismatched("`landmarks_p` is missing: where do the handles start?")),
            (None, None, None) => Err(mismatched("`landmarks` is missing, or `landmarks_p` and `landmarks_q`")),
            (Some(_), ..) => Err(mismatched("send `landmarks` alone, or `landmarks_p` and `landmarks_q`")),
        }
    }
}

/// Reads a size, `640,480` or `[640, 480]`.
/// Errors: `bad_value` that names the field.
pub fn extent(name: &str, text: &str) -> Result<Extent, Problem> {
    let inner = text.trim();
    let inner = inner.strip_prefix('[').and_then(|inner| inner.strip_suffix(']')).unwrap_or(inner);
    let sides = inner.split_once(',').and_then(|(width, height)| Some((width.trim().parse::<u32>().ok()?, height.trim().parse().ok()?)));
    let extent = sides.filter(|(width, height)| width.max(height) <= &LONGEST_SIDE).and_then(|(width, height)| Extent::new(width, height));
    let bad = || {
        let detail = format!(
            "`{name}` must be the width and height of an image, such as 640,480, at most {LONGEST_SIDE} each; found {}",
            quote(text)
        );
        Problem::new(Code::BadValue, detail)
    };
    extent.ok_or_else(bad)
}

fn mismatched(detail: &str) -> Problem {
    Problem::new(Code::BadLandmarks, detail)
}

fn one(file: File, extents: [Option<Extent>; 2]) -> Landmarks {
    let File { p, q, names, units, format, unmatched, .. } = file;
    Landmarks { p, q, names: names.map(texts), units: [units; 2], extents, format: format.to_owned(), unmatched }
}

fn two([p, q]: [File; 2], Pairs { indices, unmatched }: Pairs, extents: [Option<Extent>; 2]) -> Landmarks {
    let format = if p.format == q.format { p.format.to_owned() } else { format!("{}+{}", p.format, q.format) };
    let names = p.names.map(texts).or(q.names.map(texts));
    let names = names.map(|names| indices.iter().map(|(index, _)| names[*index].clone()).collect());
    let (rest, posed) = indices.iter().map(|(index_p, index_q)| (p.p[*index_p].clone(), q.p[*index_q].clone())).unzip();
    Landmarks { p: rest, q: Some(posed), names, units: [p.units, q.units], extents, format, unmatched }
}

fn texts(names: Vec<(usize, String)>) -> Vec<String> {
    names.into_iter().map(|(_, name)| name).collect()
}

/// Errors: A line with a segment that has no length, which no image can be warped by.
fn require_lines(file: &File) -> Result<(), Bad> {
    // Lengths of normalised lines are known with the image.
    if file.units == Units::Normalized || !file.p.iter().any(|handle| matches!(handle, Handle::Polyline(_))) {
        return Ok(());
    }
    match Handles::new(file.p.clone(), None) {
        Err(DeformError::DegenerateLine { handle, segment }) => {
            let detail = format!("expected a line of positions that differ; its positions {segment} and {} are the same", segment + 1);
            Err(Bad::new(file.at[handle], detail))
        }
        _ => Ok(()),
    }
}

impl Landmarks {
    /// Whether a landmark was left out because the other side does not have its name.
    pub fn has_unmatched(&self) -> bool {
        !self.unmatched.is_empty()
    }

    /// An upper limit of the numbers of one side.
    pub fn numbers(&self) -> usize {
        self.p.iter().map(|handle| 2 * handle.places().len()).sum()
    }

    /// The longest text of the names, bytes: an escape has six bytes for one.
    pub fn names_length(&self) -> usize {
        let unmatched = self.unmatched.p.iter().chain(&self.unmatched.q);
        self.names.iter().flatten().chain(unmatched).map(|name| 6 * name.len() + 4).sum()
    }

    /// Errors: `bad_value` without posed positions.
    pub fn require_q(&self) -> Result<(), Problem> {
        let detail = "the landmarks have no posed positions: send a file with both sides, or `landmarks_p` and `landmarks_q`";
        if self.q.is_some() { Ok(()) } else { Err(Problem::new(Code::BadValue, detail)) }
    }

    /// Multiplies normalised coordinates by the extent of their side, by default that of the other side or `image`. Without any extent they
    /// stay normalised.
    /// Errors: `bad_value` if one side stays normalised and the other does not.
    pub fn scale(mut self, image: Option<Extent>) -> Result<Self, Problem> {
        let [own_p, own_q] = self.extents;
        let extent_p = own_p.or(image);
        let (p, q) = (scaled(&mut self.p, self.units[0], extent_p), &mut self.q);
        let q = q.as_mut().map_or(p, |q| scaled(q, self.units[1], own_q.or(extent_p)));
        if p != q {
            let missing = if p == Units::Normalized { "extent_p" } else { "extent_q" };
            let detail = format!("one side is normalised and the other is in px: give `{missing}`, the size of its image, such as 640,480");
            return Err(Problem::new(Code::BadValue, detail));
        }
        self.units = [p, q];
        Ok(self)
    }

    /// Puts the handles into a warp object, in px of an image of this extent.
    pub fn place_in(self, object: &mut WarpObject, image: Extent) -> Result<(), Problem> {
        let Self { p, q, .. } = self.scale(Some(image))?;
        object.rest.p = p;
        object.q = q;
        Ok(())
    }
}

/// Multiplies normalised coordinates by an extent, and returns the units of the result.
fn scaled(handles: &mut [Handle], units: Units, extent: Option<Extent>) -> Units {
    let (Units::Normalized, Some(extent)) = (units, extent) else { return units };
    multiply(handles, extent);
    Units::Px
}

fn multiply(handles: &mut [Handle], extent: Extent) {
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
        object.serialize_entry("units", &AsJson(self.units[0]))?;
        object.serialize_entry("format", &self.format)?;
        if !self.unmatched.is_empty() {
            let Unmatched { p, q } = &self.unmatched;
            object.serialize_entry("unmatched", &std::collections::BTreeMap::from([("p", p), ("q", q)]))?;
        }
        object.end()
    }
}
