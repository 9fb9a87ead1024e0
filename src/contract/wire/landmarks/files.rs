//! The landmarks of a request: one file, or one for each side.

use bytes::Bytes;
use mlswarp::deform::{DeformError, Handle, Handles};
use mlswarp::geometry::Point;
use mlswarp::pixmap::Extent;
use mlswarp::warp::{Units, WarpError};
use serde::ser::{Serialize, SerializeMap as _, Serializer};

use super::bad::Bad;
use super::collect::{CoordinateConvention, LandmarkFile, Unmatched};
use super::item::Item;
use super::pairs::{Pairs, pair};
use super::{Work, read};
use crate::problem::words::{list, quote};
use crate::problem::{Code, Problem};
use crate::wire::enum_name::{EnumName as _, Matching, enum_name};
use crate::wire::json::{self, Node, optional};
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
    /// The size of the image on which `p` was placed; by default that of the picture.
    pub extent_p: Option<Extent>,
    /// The size of the image on which `q` was placed; by default that of `p`.
    pub extent_q: Option<Extent>,
    /// What is read from the files.
    pub choice: Choice,
}

/// What is read from landmark files.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub struct Choice {
    /// How two files are matched; by default by name if names explain them.
    pub matching: Option<Matching>,
    /// Which item of each file is read, where it has several.
    pub item: Option<Item>,
}

impl Choice {
    /// The field that is given, if there is one.
    pub fn given_item(&self) -> Option<&'static str> {
        let given = [
            ("match", self.matching.is_some()),
            ("item", self.item.is_some()),
        ];
        given
            .into_iter()
            .find_map(|(name, is_given)| is_given.then_some(name))
    }

    /// The fields of a warp object. A text that is no object is left to its parser.
    /// Errors: A field with another value.
    pub fn of_warp(json: &[u8]) -> Result<Self, Problem> {
        let Ok(root) = json::root(json) else {
            return Ok(Self::default());
        };
        Self::of_fields(root.find(&["match", "item"])?)
    }

    /// The fields `match` and `item`.
    pub(super) fn of_fields([matching, item]: [Option<Node<'_, '_>>; 2]) -> Result<Self, Problem> {
        Ok(Self {
            matching: optional(matching, enum_name)?,
            item: optional(item, Item::read)?,
        })
    }

    /// Adds a field that is written as text.
    /// Errors: the field cannot have this value, or is given already.
    pub fn add_text(&mut self, name: &str, text: &str) -> Result<(), Problem> {
        if name == "item" {
            return self.add(Self {
                item: Some(Item::Text(text.trim().to_owned())),
                ..Self::default()
            });
        }
        let names = Matching::ALL.iter().map(|matching| matching.as_str());
        let matching = Matching::ALL
            .iter()
            .find(|matching| matching.as_str() == text.trim());
        let known = || {
            let detail = format!(
                "`{name}` must be one of {}; found {}",
                list(&names.collect::<Vec<_>>()),
                quote(text)
            );
            Problem::new(Code::BadValue, detail)
        };
        self.add(Self {
            matching: Some(*matching.ok_or_else(known)?),
            ..Self::default()
        })
    }

    /// Adds the fields of another part of the request.
    /// Errors: `bad_value` at a field that both give.
    pub fn add(&mut self, other: Self) -> Result<(), Problem> {
        let twice = |name: &str| Problem::new(Code::BadValue, format!("`{name}` is given twice"));
        if self.matching.is_some() && other.matching.is_some() {
            return Err(twice("match"));
        }
        if self.item.is_some() && other.item.is_some() {
            return Err(twice("item"));
        }
        self.matching = self.matching.or(other.matching);
        self.item = self.item.take().or(other.item);
        Ok(())
    }
}

/// The parts with one side each.
pub(super) const SIDES: [&str; 2] = ["landmarks_p", "landmarks_q"];
/// The longest side of an image that normalised coordinates belong to, px: the largest ones (4)
/// stay within the range of coordinates.
const LONGEST_SIDE: u32 = 250_000;

/// Handles that were read, each side in the coordinates of its file.
#[derive(Clone, Debug, PartialEq)]
pub struct Landmarks {
    pub(super) p: Vec<Handle>,
    pub(super) q: Option<Vec<Handle>>,
    names: Option<Vec<String>>,
    frames: [CoordinateConvention; 2],
    extents: [Option<Extent>; 2],
    format: String,
    pub(super) unmatched: Unmatched,
}

impl LandmarkFiles {
    /// Bytes of all files.
    pub fn bytes(&self) -> usize {
        [&self.both, &self.p, &self.q]
            .into_iter()
            .flatten()
            .map(Bytes::len)
            .sum()
    }

    /// Whether no file is there.
    pub fn is_empty(&self) -> bool {
        self.both.is_none() && self.p.is_none() && self.q.is_none()
    }

    /// Errors: `bad_value` if there is no file that the other parts belong to.
    pub fn require_files(&self) -> Result<(), Problem> {
        let extents = [("extent_p", self.extent_p), ("extent_q", self.extent_q)];
        let given = extents
            .into_iter()
            .find_map(|(name, extent)| extent.map(|_| name))
            .or(self.choice.given_item());
        match given.filter(|_| self.is_empty()) {
            Some(name) => Err(without_files(name)),
            None => Ok(()),
        }
    }

    /// The memory that reading takes at most, bytes: handles, their places and names, in each file.
    pub fn reading_bytes(&self, max_columns: usize) -> u64 {
        const HANDLE_BYTES: usize = 400;
        const NAME_BYTES: usize = 4 * 256;
        // The longest row of a table, three times (those of a header), and a long line.
        const ROW_BYTES: usize = 14 << 20;
        let files = [&self.both, &self.p, &self.q].into_iter().flatten();
        let bytes = files.map(|file| {
            // A handle takes two bytes of text at least.
            let handles = max_columns.min(file.len() / 2 + 1);
            HANDLE_BYTES * handles
                + (4 * file.len()).min(NAME_BYTES * handles)
                + (40 * file.len()).min(ROW_BYTES)
        });
        bytes.sum::<usize>() as u64
    }

    /// Reads the files. `cancelled` is true when the result is no longer wanted. Errors:
    /// `bad_landmarks`, with line and column unless the files do not go together, `too_large`, or
    /// cancelled.
    pub fn read(
        &self,
        max_columns: usize,
        cancelled: &dyn Fn() -> bool,
    ) -> Result<Landmarks, Problem> {
        self.read_counted(max_columns, &Work::new(cancelled))
    }

    /// As [`Self::read`]; the work is counted.
    pub(super) fn read_counted(
        &self,
        max_columns: usize,
        work: &Work<'_>,
    ) -> Result<Landmarks, Problem> {
        let file = |name: &str, bytes: &Bytes| self.file(name, bytes, max_columns, work);
        let rest = |name: &str, bytes: &Bytes| {
            let file = file(name, bytes)?;
            require_lines(&file).map_err(|bad| bad.problem(name, bytes))?;
            Ok::<_, Problem>(file)
        };
        let extents = [self.extent_p, self.extent_q];
        match (&self.both, &self.p, &self.q) {
            (Some(both), None, None) => self.one(rest("landmarks", both)?),
            (None, Some(p), Some(q)) => {
                let files = [rest(SIDES[0], p)?, file(SIDES[1], q)?];
                for (side, name) in files.iter().zip(SIDES) {
                    if side.q.is_some() {
                        let detail = format!(
                            "{name}: expected positions of one side; found both sides: send this \
                                file alone, as `landmarks`"
                        );
                        return Err(Bad::new(0, detail).problem(name, b""));
                    }
                }
                let pairs = pair(&files, self.choice.matching);
                let pairs = pairs.map_err(|(side, bad)| bad.problem(SIDES[side], [p, q][side]))?;
                Ok(two(files, pairs, extents))
            }
            (None, Some(p), None) => self.one(rest(SIDES[0], p)?),
            (None, None, Some(_)) => Err(mismatched(
                "`landmarks_p` is missing: where do the handles start?",
            )),
            (None, None, None) => Err(mismatched(
                "`landmarks` is missing, or `landmarks_p` and `landmarks_q`",
            )),
            (Some(_), ..) => Err(mismatched(
                "send `landmarks` alone, or `landmarks_p` and `landmarks_q`",
            )),
        }
    }

    /// Reads one file.
    pub(super) fn file(
        &self,
        name: &str,
        bytes: &Bytes,
        max_columns: usize,
        work: &Work<'_>,
    ) -> Result<LandmarkFile, Problem> {
        let file = read(bytes, max_columns, self.choice.item.clone(), work);
        if work.is_stopped() {
            return Err(WarpError::Cancelled.into());
        }
        file.map_err(|bad| bad.problem(name, bytes))
    }

    /// Errors: `bad_value` at what belongs to two files, or to the side that is not there.
    fn one(&self, file: LandmarkFile) -> Result<Landmarks, Problem> {
        if self.choice.matching.is_some() {
            return Err(Problem::new(
                Code::BadValue,
                "`match` belongs to two files, `landmarks_p` and `landmarks_q`; found one",
            ));
        }
        if self.extent_q.is_some() && file.q.is_none() {
            return Err(Problem::new(
                Code::BadValue,
                "`extent_q` belongs to posed positions, which the file does not have",
            ));
        }
        Ok(Landmarks::of_file(file, [self.extent_p, self.extent_q]))
    }
}

/// The problem of a field about landmark files in a request without landmark files.
pub fn without_files(name: &str) -> Problem {
    Problem::new(
        Code::BadValue,
        format!("`{name}` belongs to landmark files: send `landmarks` too"),
    )
}

/// Reads a size, `640,480` or `[640, 480]`.
/// Errors: `bad_value` that names the field.
pub fn extent(name: &str, text: &str) -> Result<Extent, Problem> {
    let inner = text.trim();
    let inner = inner
        .strip_prefix('[')
        .and_then(|inner| inner.strip_suffix(']'))
        .unwrap_or(inner);
    let sides = inner.split_once(',').and_then(|(width, height)| {
        Some((
            width.trim().parse::<u32>().ok()?,
            height.trim().parse().ok()?,
        ))
    });
    let extent = sides
        .filter(|(width, height)| width.max(height) <= &LONGEST_SIDE)
        .and_then(|(width, height)| Extent::new(width, height));
    let bad = || {
        let detail = format!(
            "`{name}` must be the width and height of an image, such as 640,480, at most \
                {LONGEST_SIDE} each; found {}",
            quote(text)
        );
        Problem::new(Code::BadValue, detail)
    };
    extent.ok_or_else(bad)
}

pub(super) fn mismatched(detail: &str) -> Problem {
    Problem::new(Code::BadLandmarks, detail)
}

fn two(
    [p, q]: [LandmarkFile; 2],
    Pairs { indices, unmatched }: Pairs,
    extents: [Option<Extent>; 2],
) -> Landmarks {
    let format = if p.format == q.format {
        p.format.to_owned()
    } else {
        format!("{}+{}", p.format, q.format)
    };
    let names = p.names.map(texts).or(q.names.map(texts));
    let names = names.map(|names| {
        indices
            .iter()
            .map(|(index, _)| names[*index].clone())
            .collect()
    });
    let (rest, posed) = indices
        .iter()
        .map(|(index_p, index_q)| (p.p[*index_p].clone(), q.p[*index_q].clone()))
        .unzip();
    Landmarks {
        p: rest,
        q: Some(posed),
        names,
        frames: [p.frame, q.frame],
        extents,
        format,
        unmatched,
    }
}

fn texts(names: Vec<(usize, String)>) -> Vec<String> {
    names.into_iter().map(|(_, name)| name).collect()
}

/// Errors: A line with a segment that has no length, which no image can be warped by.
fn require_lines(file: &LandmarkFile) -> Result<(), Bad> {
    // Lengths of normalised lines are known with the image.
    if file.frame == CoordinateConvention::Normalized
        || !file
            .p
            .iter()
            .any(|handle| matches!(handle, Handle::Polyline(_)))
    {
        return Ok(());
    }
    match Handles::new(file.p.clone(), None) {
        Err(DeformError::DegenerateLine { handle, segment }) => {
            let detail = format!(
                "expected a line of positions that differ; its positions {segment} and {} are the \
                    same",
                segment + 1
            );
            Err(Bad::new(file.at[handle], detail))
        }
        _ => Ok(()),
    }
}

impl Landmarks {
    pub(super) fn of_file(file: LandmarkFile, extents: [Option<Extent>; 2]) -> Self {
        let LandmarkFile {
            p,
            q,
            names,
            frame,
            format,
            unmatched,
            ..
        } = file;
        Self {
            p,
            q,
            names: names.map(texts),
            frames: [frame; 2],
            extents,
            format: format.to_owned(),
            unmatched,
        }
    }

    /// An upper limit of the numbers of one side.
    pub fn numbers(&self) -> usize {
        self.p
            .iter()
            .map(|handle| 2 * handle.places().len().max(1))
            .sum()
    }

    /// The longest text of the names, bytes: an escape has six bytes for one.
    pub fn names_length(&self) -> usize {
        let unmatched = self.unmatched.p.iter().chain(&self.unmatched.q);
        self.names
            .iter()
            .flatten()
            .chain(unmatched)
            .map(|name| 6 * name.len() + 4)
            .sum()
    }

    /// Errors: `bad_value` without posed positions.
    pub fn require_q(&self) -> Result<(), Problem> {
        let detail = "the landmarks have no posed positions: send a file with both sides, or \
            `landmarks_p` and `landmarks_q`";
        if self.q.is_some() {
            Ok(())
        } else {
            Err(Problem::new(Code::BadValue, detail))
        }
    }

    /// Brings both sides to the coordinates of the contract. Normalised coordinates are multiplied
    /// by the extent of their side, by default that of the other side or `image`. Pixels are
    /// multiplied by the size of `image` over the extent of their side, if that is given: they were
    /// placed on a reduced copy. Without an `image` they become shares of that extent. Errors:
    /// `bad_value` if one side stays normalised and the other does not, or the height of an image
    /// is not known.
    pub fn scale(mut self, image: Option<Extent>) -> Result<Placed, Problem> {
        let [own_p, own_q] = self.extents;
        let [frame_p, frame_q] = self.frames;
        let is_alike = (frame_p == CoordinateConvention::Normalized)
            == (frame_q == CoordinateConvention::Normalized);
        let own_q = own_q.or(own_p.filter(|_| is_alike));
        let mut done = Vec::new();
        let p = place(
            &mut self.p,
            frame_p,
            [own_p, image],
            ["p", "extent_p"],
            &mut done,
        )?;
        let q = match &mut self.q {
            Some(q) => place(q, frame_q, [own_q, image], ["q", "extent_q"], &mut done)?,
            None => p,
        };
        if p != q {
            let missing = if p == Units::Normalized {
                ["extent_p", "extent_q"]
            } else {
                ["extent_q", "extent_p"]
            };
            let missing = if [own_p, own_q][usize::from(p != Units::Normalized)].is_none() {
                missing[0]
            } else {
                missing[1]
            };
            let detail = format!(
                "one side is normalised and the other is in px: give `{missing}`, the size of its \
                    image, such as 640,480"
            );
            return Err(Problem::new(Code::BadValue, detail));
        }
        if !done.is_empty() {
            self.format = format!("{} ({})", self.format, done.join("; "));
        }
        Ok(Placed {
            landmarks: self,
            units: p,
        })
    }

    /// The handles at rest, in px of an image of this extent, and their names.
    /// Errors: as [`Self::scale`]; posed positions, which a blend has no use for.
    pub fn into_shape(self, image: Extent) -> Result<(Vec<Handle>, Option<Vec<String>>), Problem> {
        if self.q.is_some() {
            let detail = "expected the landmarks of one image; found both sides of a warp: each \
                image of a blend has a file of its own";
            return Err(Problem::new(Code::BadValue, detail));
        }
        let Self { p, names, .. } = self.scale(Some(image))?.landmarks;
        Ok((p, names))
    }

    /// Puts the handles into a warp object, in px of an image of this extent.
    pub fn place_in(self, object: &mut WarpObject, image: Extent) -> Result<(), Problem> {
        let Self {
            p, q, unmatched, ..
        } = self.scale(Some(image))?.landmarks;
        (object.rest.p, object.q, object.rest.has_unmatched) = (p, q, !unmatched.is_empty());
        Ok(())
    }
}

/// Brings handles to the coordinates of the contract, and returns their units. `own`, `image`: see
/// [`Landmarks::scale`]. What is done to pixels is added to `done`.
fn place(
    handles: &mut [Handle],
    frame: CoordinateConvention,
    [own, image]: [Option<Extent>; 2],
    [side, field]: [&str; 2],
    done: &mut Vec<String>,
) -> Result<Units, Problem> {
    let sides = |extent: Extent| [f64::from(extent.width()), f64::from(extent.height())];
    let text = |extent: Extent| format!("{} x {}", extent.width(), extent.height());
    if frame == CoordinateConvention::PxUp {
        let missing = || {
            let detail = format!(
                "the file counts y from the lower edge of its image: give `{field}`, the size of \
                    the image, such as 640,480"
            );
            Problem::new(Code::BadValue, detail)
        };
        let [_, height] = sides(own.or(image).ok_or_else(missing)?);
        each(handles, |place| Point::new(place.x, height - place.y));
    }
    match (frame, own, image) {
        (CoordinateConvention::Normalized, Some(extent), _)
        | (CoordinateConvention::Normalized, None, Some(extent)) => {
            let [width, height] = sides(extent);
            each(handles, |place| {
                Point::new(place.x * width, place.y * height)
            });
            Ok(Units::Px)
        }
        (CoordinateConvention::Normalized, None, None) => Ok(Units::Normalized),
        (_, None, _) => Ok(Units::Px),
        (_, Some(own), Some(image)) if own == image => Ok(Units::Px),
        (_, Some(own), Some(image)) => {
            let ([width, height], [own_width, own_height]) = (sides(image), sides(own));
            each(handles, |place| {
                Point::new(place.x * width / own_width, place.y * height / own_height)
            });
            done.push(format!("{side} from {} to {} px", text(own), text(image)));
            Ok(Units::Px)
        }
        (_, Some(own), None) => {
            let [width, height] = sides(own);
            each(handles, |place| {
                Point::new(place.x / width, place.y / height)
            });
            done.push(format!(
                "{side} from {} px to shares of the image",
                text(own)
            ));
            Ok(Units::Normalized)
        }
    }
}

pub(super) fn each(handles: &mut [Handle], moved: impl Fn(Point) -> Point) {
    for handle in handles {
        match handle {
            Handle::Point(place) => *place = moved(*place),
            Handle::Polyline(places) => places.iter_mut().for_each(|place| *place = moved(*place)),
            Handle::Missing => {}
        }
    }
}

/// Landmarks in the coordinates of the contract.
#[derive(Clone, Debug, PartialEq)]
pub struct Placed {
    pub(super) landmarks: Landmarks,
    pub(super) units: Units,
}

impl Serialize for Placed {
    fn serialize<S: Serializer>(&self, s: S) -> Result<S::Ok, S::Error> {
        let Landmarks {
            p,
            q,
            names,
            format,
            unmatched,
            ..
        } = &self.landmarks;
        let mut object = s.serialize_map(None)?;
        object.serialize_entry("p", &AsJson(p.as_slice()))?;
        if let Some(q) = q {
            object.serialize_entry("q", &AsJson(q.as_slice()))?;
        }
        if let Some(names) = names {
            object.serialize_entry("names", names)?;
        }
        object.serialize_entry("units", &AsJson(self.units))?;
        object.serialize_entry("format", format)?;
        if !unmatched.is_empty() {
            let Unmatched { p, q } = unmatched;
            object.serialize_entry(
                "unmatched",
                &std::collections::BTreeMap::from([("p", p), ("q", q)]),
            )?;
        }
        object.end()
    }
}
