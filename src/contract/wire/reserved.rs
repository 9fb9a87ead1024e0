//! What was read from a client's text owns the memory that it takes. Outside of this module a text
//! is read by [`Reserved`] alone, which reserves first: the parsers themselves are not visible
//! there.

use std::ops::{Deref, DerefMut};

use bytes::Bytes;
use mlswarp::deform::IsCancelled;
use mlswarp::pixmap::Extent;
use mlswarp::warp::{OutputSpec, Units};

use super::blend::BlendObject;
use super::json::{At, Kind, Node};
use super::landmarks::{LandmarkFiles, Landmarks, Target};
use super::work::Work;
use super::{DragObject, FitObject, MapObject, PointsObject, ReportObject, WarpObject};
use super::{WarpPatch, fields};
use crate::problem::Problem;

/// A value and its memory. `H` holds the memory as long as it lives.
#[derive(Clone, Debug, PartialEq)]
pub struct Reserved<T, H> {
    value: T,
    held: H,
}

impl<T, H> Deref for Reserved<T, H> {
    type Target = T;

    fn deref(&self) -> &T {
        &self.value
    }
}

impl<T, H> DerefMut for Reserved<T, H> {
    fn deref_mut(&mut self) -> &mut T {
        &mut self.value
    }
}

impl<T, H> Reserved<T, H> {
    /// `most`: the most memory of the value, bytes. `reserve` takes it before `read` makes the
    /// value.
    pub(super) fn read<E: From<Problem>>(
        most: u64,
        reserve: impl FnOnce(u64) -> Result<H, Problem>,
        read: impl FnOnce() -> Result<T, E>,
    ) -> Result<Self, E> {
        let held = reserve(most)?;
        Ok(Self {
            value: read()?,
            held,
        })
    }

    /// The memory.
    pub const fn held(&self) -> &H {
        &self.held
    }

    /// What is made of the value, in the same memory.
    pub fn map<U>(self, make: impl FnOnce(T) -> U) -> Reserved<U, H> {
        Reserved {
            value: make(self.value),
            held: self.held,
        }
    }

    /// As [`Reserved::map`].
    pub fn try_map<U, E>(self, make: impl FnOnce(T) -> Result<U, E>) -> Result<Reserved<U, H>, E> {
        Ok(Reserved {
            value: make(self.value)?,
            held: self.held,
        })
    }

    /// Takes a part out of the value, with its part of the memory.
    pub fn split<U>(&mut self, take: impl FnOnce(&mut T, &mut H) -> (U, H)) -> Reserved<U, H> {
        let (value, held) = take(&mut self.value, &mut self.held);
        Reserved { value, held }
    }

    /// The value, and its memory, which the caller keeps as long as the value.
    pub fn into_parts(self) -> (T, H) {
        (self.value, self.held)
    }
}

/// Memory for each quotation mark of names: half of a string, in a list that may grow to twice its
/// length, and of its allocation.
const QUOTE_BYTES: usize = 40;

/// Upper bound of the memory in which a value is read, bytes. Annotations and the frames of a batch
/// stay text.
pub(super) fn reading_bytes(json: &[u8], work: Option<&Work<'_>>) -> u64 {
    let text = std::str::from_utf8(json).unwrap_or_default().trim();
    let node = Node {
        work,
        ..Node::new(text, At::Root)
    };
    if node.kind() != Kind::Object {
        return value_bytes(text);
    }
    let stays =
        |name: &str| fields::ANNOTATIONS.contains(&name.trim_matches('"')) || name == "\"frames\"";
    node.pairs()
        .filter(|(name, _)| !stays(name))
        .map(|(_, value)| value_bytes(value))
        .sum()
}

/// What begins with each byte takes at most, while the list that it is in grows to twice its
/// length: a position, an object, a number, `null` in place of a handle.
fn value_bytes(text: &str) -> u64 {
    let bytes = |byte: u8| match byte {
        b'[' => 48,
        b'{' | b'n' => 72,
        b',' => 12,
        _ => 0,
    };
    text.bytes().map(bytes).sum()
}

/// The parsers of JSON. `at_rest`: the number of handles at rest, more than which are refused
/// before they are read.
macro_rules! parsers {
    ($($object:ident: $($parse:ident $(($parameter:ident: $kind:ty))?),+;)+) => {$(
        impl<H> Reserved<$object, H> {
            $(
                /// Reads the object of that name in memory that `reserve` takes before.
                pub fn $parse(
                    json: &[u8],
                    $($parameter: $kind,)?
                    reserve: impl FnOnce(u64) -> Result<H, Problem>,
                ) -> Result<Self, Problem> {
                    Self::read(reading_bytes(json, None), reserve,
                        || $object::$parse(json $(, $parameter)?))
                }
            )+
        }
    )+};
}

parsers! {
    WarpObject: parse;
    DragObject: parse(at_rest: usize), parse_posed(at_rest: usize),
        parse_for_report(at_rest: usize);
    MapObject: parse, parse_posed;
    ReportObject: parse;
    FitObject: parse, parse_posed;
}

impl<H> Reserved<PointsObject, H> {
    /// Reads the object of `/points`; annotations stay text. `most_bytes`: the most bytes of
    /// everything else. Errors: the object is not as the contract says; cancelled.
    pub fn parse(
        body: &Bytes,
        most_bytes: u64,
        cancelled: IsCancelled<'_>,
        reserve: impl FnOnce(u64) -> Result<H, Problem>,
    ) -> Result<Self, Problem> {
        let work = Work::new(cancelled);
        work.believe(Self::read(
            reading_bytes(body, Some(&work)),
            reserve,
            || PointsObject::parse(body, most_bytes, &work),
        ))
    }

    /// Reads the object of `/sessions/{id}/points`. `source` and `output`: those of the session.
    pub fn parse_posed(
        body: &Bytes,
        most_bytes: u64,
        source: (Extent, Units),
        output: &OutputSpec,
        cancelled: IsCancelled<'_>,
        reserve: impl FnOnce(u64) -> Result<H, Problem>,
    ) -> Result<Self, Problem> {
        let work = Work::new(cancelled);
        work.believe(Self::read(
            reading_bytes(body, Some(&work)),
            reserve,
            || PointsObject::parse_posed(body, most_bytes, source, output, &work),
        ))
    }
}

impl<H> Reserved<WarpPatch, H> {
    /// Reads a warp object. Errors: those of `reserve`; the object is not as the contract says.
    pub fn parse(
        json: &[u8],
        reserve: impl FnOnce(u64) -> Result<H, Problem>,
    ) -> Result<Self, Problem> {
        Self::read(reading_bytes(json, None), reserve, || {
            WarpPatch::parse(json)
        })
    }
}

impl<H> Reserved<BlendObject, H> {
    /// Reads the object of a blend. Errors: those of `reserve`; the object is not as the contract
    /// says.
    pub fn parse(
        json: &[u8],
        reserve: impl FnOnce(u64) -> Result<H, Problem>,
    ) -> Result<Self, Problem> {
        // Each name has two quotation marks.
        let quotes = json.iter().filter(|byte| **byte == b'"').count();
        let names = (json.len() + QUOTE_BYTES * quotes) as u64;
        Self::read(reading_bytes(json, None) + names, reserve, || {
            BlendObject::parse(json)
        })
    }
}

impl<H> Reserved<Landmarks, H> {
    /// Reads landmark files. Errors: as [`LandmarkFiles`] describes; cancelled.
    pub fn of_files(
        files: &LandmarkFiles,
        max_columns: usize,
        is_cancelled: &dyn Fn() -> bool,
        reserve: impl FnOnce(u64) -> Result<H, Problem>,
    ) -> Result<Self, Problem> {
        Self::read(files.reading_bytes(max_columns), reserve, || {
            files.read(max_columns, is_cancelled)
        })
    }

    /// As [`Self::of_files`], for what takes the place of fields of a request.
    pub fn of_files_for(
        files: &LandmarkFiles,
        target: Target,
        max_columns: usize,
        is_cancelled: &dyn Fn() -> bool,
        reserve: impl FnOnce(u64) -> Result<H, Problem>,
    ) -> Result<Self, Problem> {
        Self::read(files.reading_bytes(max_columns), reserve, || {
            files.read_for(target, max_columns, is_cancelled)
        })
    }
}
