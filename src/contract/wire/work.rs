//! The work of reading a text: the bytes that were looked at, and whether anybody still wants what
//! they say.

use std::cell::Cell;
use std::io::{self, BufReader, Read};

use mlswarp::warp::WarpError;
use serde::de::IgnoredAny;

use crate::problem::Problem;

/// Bytes between two questions whether the result is wanted: a few microseconds.
pub(crate) const BYTES_PER_CHECK: usize = 4096;

/// The work of one request on one thread. A reader adds the bytes that it looks at. Once the work
/// is cancelled, every scan ends early, and the caller must not believe the result.
pub(crate) struct Work<'c> {
    is_cancelled: &'c dyn Fn() -> bool,
    bytes: Cell<usize>,
    asked: Cell<usize>,
    is_stopped: Cell<bool>,
}

impl std::fmt::Debug for Work<'_> {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        f.debug_struct("Work")
            .field("bytes", &self.bytes)
            .finish_non_exhaustive()
    }
}

impl<'c> Work<'c> {
    /// `is_cancelled` is true when the result is no longer wanted.
    pub(crate) fn new(is_cancelled: &'c dyn Fn() -> bool) -> Self {
        let (bytes, asked, is_stopped) = (Cell::new(0), Cell::new(0), Cell::new(false));
        Self {
            is_cancelled,
            bytes,
            asked,
            is_stopped,
        }
    }

    /// Bytes that were looked at; those that several passes have looked at count in each.
    #[cfg(test)]
    pub(crate) fn bytes(&self) -> usize {
        self.bytes.get()
    }

    /// Whether scans have ended early.
    pub(crate) fn is_stopped(&self) -> bool {
        self.is_stopped.get()
    }

    /// What was read, unless scans have ended early: then it means nothing.
    pub(crate) fn believe<T>(&self, read: Result<T, Problem>) -> Result<T, Problem> {
        if self.is_stopped() {
            return Err(WarpError::Cancelled.into());
        }
        read
    }

    /// Adds bytes, and asks whether the result is wanted if enough have passed. False: stop here.
    pub(crate) fn add(&self, bytes: usize) -> bool {
        let total = self.bytes.get() + bytes;
        self.bytes.set(total);
        if total >= self.asked.get() + BYTES_PER_CHECK {
            self.asked.set(total);
            self.is_stopped
                .set(self.is_stopped.get() || (self.is_cancelled)());
        }
        !self.is_stopped.get()
    }

    /// The text at the beginning of a file.
    pub(crate) fn text<'t>(&self, bytes: &'t [u8]) -> &'t str {
        let mut end = 0;
        while end < bytes.len() && self.add(BYTES_PER_CHECK.min(bytes.len() - end)) {
            let piece = &bytes[end..bytes.len().min(end + BYTES_PER_CHECK)];
            match std::str::from_utf8(piece) {
                Ok(_) => end += piece.len(),
                // A character that goes on in the next piece.
                Err(error) if error.error_len().is_none() && error.valid_up_to() > 0 => {
                    end += error.valid_up_to()
                }
                Err(error) => {
                    end += error.valid_up_to();
                    break;
                }
            }
        }
        std::str::from_utf8(&bytes[..end]).unwrap_or_default()
    }

    /// A text in pieces, each of which is counted when it is taken; the last one is where the work
    /// is cancelled.
    pub(crate) fn pieces<'t>(&self, text: &'t [u8]) -> impl Iterator<Item = &'t [u8]> {
        text.chunks(BYTES_PER_CHECK)
            .take_while(|piece| self.add(piece.len()))
    }

    /// The number of bytes before the first that `ends` a scan; all of them if none does.
    pub(crate) fn find(&self, text: &[u8], ends: impl Fn(u8) -> bool) -> usize {
        let mut before = 0;
        for piece in text.chunks(BYTES_PER_CHECK) {
            let found = piece.iter().position(|byte| ends(*byte));
            before += found.unwrap_or(piece.len());
            if !self.add(found.map_or(piece.len(), |found| found + 1)) || found.is_some() {
                break;
            }
        }
        before
    }

    /// Checks that a text is one JSON value and nothing else. Cancelled work is an error as well.
    pub(crate) fn check_json(&self, text: &str) -> Result<(), serde_json::Error> {
        struct Pieces<'a, 'c>(&'a [u8], &'a Work<'c>);
        impl Read for Pieces<'_, '_> {
            fn read(&mut self, into: &mut [u8]) -> io::Result<usize> {
                let read = self.0.read(into)?;
                if self.1.add(read) {
                    Ok(read)
                } else {
                    Err(io::ErrorKind::BrokenPipe.into())
                }
            }
        }
        let pieces = BufReader::with_capacity(BYTES_PER_CHECK, Pieces(text.as_bytes(), self));
        serde_json::from_reader::<_, IgnoredAny>(pieces).map(drop)
    }
}
