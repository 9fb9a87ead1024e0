//! What was read from a client's text owns the memory that it takes. Outside of this module a text is read by [`Reserved`] alone, which
//! reserves first: the parsers themselves are not visible there.

use std::ops::{Deref, DerefMut};

use super::landmarks::{LandmarkFiles, Landmarks};
use super::{DragObject, FitObject, MapObject, PointsObject, ReportObject, WarpObject};
use super::{WarpPatch, reading_bytes};
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
    /// `most`: the most memory of the value, bytes. `reserve` takes it before `read` makes the value.
    pub(super) fn read<E: From<Problem>>(
        most: u64,
        reserve: impl FnOnce(u64) -> Result<H, Problem>,
        read: impl FnOnce() -> Result<T, E>,
    ) -> Result<Self, E> {
        let held = reserve(most)?;
        Ok(Self { value: read()?, held })
    }

    /// The memory.
    pub const fn held(&self) -> &H {
        &self.held
    }

    /// What is made of the value, in the same memory.
    pub fn map<U>(self, make: impl FnOnce(T) -> U) -> Reserved<U, H> {
        Reserved { value: make(self.value), held: self.held }
    }

    /// As [`Reserved::map`].
    pub fn try_map<U, E>(self, make: impl FnOnce(T) -> Result<U, E>) -> Result<Reserved<U, H>, E> {
        Ok(Reserved { value: make(self.value)?, held: self.held })
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

/// The parsers of JSON. `at_rest`: the number of handles at rest, more than which are refused before they are read.
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
                    Self::read(reading_bytes(json), reserve, || $object::$parse(json $(, $parameter)?))
                }
            )+
        }
    )+};
}

parsers! {
    WarpObject: parse;
    DragObject: parse(at_rest: usize), parse_posed(at_rest: usize), parse_for_report(at_rest: usize);
    PointsObject: parse, parse_posed;
    MapObject: parse, parse_posed;
    ReportObject: parse;
    FitObject: parse, parse_posed;
}

impl<H> Reserved<WarpPatch, H> {
    pub(crate) fn parse(json: &[u8], reserve: impl FnOnce(u64) -> Result<H, Problem>) -> Result<Self, Problem> {
        Self::read(reading_bytes(json), reserve, || WarpPatch::parse(json))
    }
}

impl<H> Reserved<Landmarks, H> {
    /// Reads landmark files. Errors: As [`LandmarkFiles`] describes; cancelled.
    pub fn of_files(
        files: &LandmarkFiles,
        max_columns: usize,
        is_cancelled: &dyn Fn() -> bool,
        reserve: impl FnOnce(u64) -> Result<H, Problem>,
    ) -> Result<Self, Problem> {
        Self::read(files.reading_bytes(max_columns), reserve, || files.read(max_columns, is_cancelled))
    }
}
