//! Counts the steps of reading one file, and cancels it. Third-party decoders are stopped through
//! their input: the readers here fail once the work is cancelled. Cost: one counter; `cancelled` is
//! called once in [`STEPS_PER_CHECK`] steps.

use std::cell::Cell;
use std::fmt;
use std::io::{self, BufRead, Read, Seek, SeekFrom};

use zune_jpeg::zune_core::bytestream::{ZByteIoError, ZByteReaderTrait, ZCursor, ZSeekFrom};

use super::CodecError;

/// Steps between two calls of `cancelled`; a step takes some nanoseconds.
const STEPS_PER_CHECK: u64 = 1 << 16;
/// Bytes that a decoder gets at once. Deflate expands them to at most 33 MB, which takes 10 to 30
/// ms.
const INPUT_PIECE_BYTES: usize = 1 << 15;
/// Requests for input between two calls of `cancelled`: where symbols take no bits, a decoder
/// requests input at every symbol and uses none.
const REQUESTS_PER_CHECK: u32 = 1 << 10;

/// The steps of reading one file, on one thread.
pub struct StepCounter<'a> {
    cancelled: &'a dyn Fn() -> bool,
    steps: Cell<u64>,
    /// Steps at the last call of `cancelled`.
    checked_at: Cell<u64>,
}

impl fmt::Debug for StepCounter<'_> {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.debug_struct("StepCounter")
            .field("steps", &self.steps)
            .finish_non_exhaustive()
    }
}

impl<'a> StepCounter<'a> {
    /// `cancelled` returns true when the result is no longer needed.
    #[must_use]
    pub fn new(cancelled: &'a dyn Fn() -> bool) -> Self {
        Self {
            cancelled,
            steps: Cell::new(0),
            checked_at: Cell::new(0),
        }
    }

    /// Steps so far: chunks, segments, bytes searched, reads from a bit stream, and a decoder's
    /// requests for input.
    #[must_use]
    pub fn steps(&self) -> u64 {
        self.steps.get()
    }

    /// Adds steps, and checks cancellation when enough have passed.
    pub(super) fn step(&self, count: u64) -> Result<(), CodecError> {
        let steps = self.steps.get() + count;
        self.steps.set(steps);
        if steps < self.checked_at.get() + STEPS_PER_CHECK {
            return Ok(());
        }
        self.checked_at.set(steps);
        self.check()
    }

    /// Adds a decoder's requests, and returns whether the work is cancelled.
    fn requests(&self, count: u32) -> bool {
        self.steps.set(self.steps.get() + u64::from(count));
        self.is_cancelled()
    }

    /// Checks cancellation.
    pub(super) fn check(&self) -> Result<(), CodecError> {
        if self.is_cancelled() {
            Err(CodecError::Cancelled)
        } else {
            Ok(())
        }
    }

    pub(super) fn is_cancelled(&self) -> bool {
        (self.cancelled)()
    }
}

/// Bytes in memory as input of a decoder, in pieces.
pub(super) struct Pieces<'a, B> {
    bytes: B,
    at: usize,
    end: usize,
    requests: u32,
    work: &'a StepCounter<'a>,
}

impl<'a, B: AsRef<[u8]>> Pieces<'a, B> {
    pub(super) const fn new(bytes: B, work: &'a StepCounter<'a>) -> Self {
        Self {
            bytes,
            at: 0,
            end: 0,
            requests: 0,
            work,
        }
    }
}

impl<B: AsRef<[u8]>> BufRead for Pieces<'_, B> {
    fn fill_buf(&mut self) -> io::Result<&[u8]> {
        self.requests += 1;
        let bytes = self.bytes.as_ref();
        if self.at >= self.end || self.requests >= REQUESTS_PER_CHECK {
            if self.work.requests(std::mem::take(&mut self.requests)) {
                return Err(io::Error::other("the picture is no longer wanted"));
            }
            self.end = self.at.saturating_add(INPUT_PIECE_BYTES).min(bytes.len());
        }
        Ok(bytes.get(self.at..self.end).unwrap_or_default())
    }

    fn consume(&mut self, amount: usize) {
        self.at += amount;
    }
}

impl<B: AsRef<[u8]>> Read for Pieces<'_, B> {
    fn read(&mut self, into: &mut [u8]) -> io::Result<usize> {
        let read = self.fill_buf()?.read(into)?;
        self.consume(read);
        Ok(read)
    }
}

impl<B: AsRef<[u8]>> Seek for Pieces<'_, B> {
    fn seek(&mut self, to: SeekFrom) -> io::Result<u64> {
        let mut cursor = io::Cursor::new(self.bytes.as_ref());
        cursor.set_position(self.at as u64);
        let position = cursor.seek(to)?;
        self.at = usize::try_from(position).map_err(io::Error::other)?;
        self.end = self.at;
        Ok(position)
    }
}

/// Like [`Pieces`], for the JPEG decoder, which reads byte by byte and calls `is_eof` each time.
pub(super) struct Bytes<'a> {
    cursor: ZCursor<&'a [u8]>,
    requests: u32,
    /// Cancelled: no more input.
    stopped: bool,
    work: &'a StepCounter<'a>,
}

impl<'a> Bytes<'a> {
    pub(super) fn new(bytes: &'a [u8], work: &'a StepCounter<'a>) -> Self {
        Self {
            cursor: ZCursor::new(bytes),
            requests: 0,
            stopped: false,
            work,
        }
    }

    fn ask(&mut self) -> Result<(), ZByteIoError> {
        self.stopped = self.stopped || self.work.requests(std::mem::take(&mut self.requests));
        if self.stopped {
            Err(ZByteIoError::Generic("the picture is no longer wanted"))
        } else {
            Ok(())
        }
    }
}

impl ZByteReaderTrait for Bytes<'_> {
    #[inline(always)]
    fn read_byte_no_error(&mut self) -> u8 {
        self.cursor.read_byte_no_error()
    }

    fn read_exact_bytes(&mut self, into: &mut [u8]) -> Result<(), ZByteIoError> {
        // Called for the heads of segments: a scan may pass over the whole image in a few bytes.
        self.ask()?;
        self.cursor.read_exact_bytes(into)
    }

    fn read_bytes(&mut self, into: &mut [u8]) -> Result<usize, ZByteIoError> {
        self.cursor.read_bytes(into)
    }

    fn peek_bytes(&mut self, into: &mut [u8]) -> Result<usize, ZByteIoError> {
        self.cursor.peek_bytes(into)
    }

    fn peek_exact_bytes(&mut self, into: &mut [u8]) -> Result<(), ZByteIoError> {
        self.cursor.peek_exact_bytes(into)
    }

    fn z_seek(&mut self, to: ZSeekFrom) -> Result<u64, ZByteIoError> {
        self.cursor.z_seek(to)
    }

    #[inline(always)]
    fn is_eof(&mut self) -> Result<bool, ZByteIoError> {
        self.requests += 1;
        if self.requests >= REQUESTS_PER_CHECK || self.stopped {
            self.ask()?;
        }
        self.cursor.is_eof()
    }

    fn z_position(&mut self) -> Result<u64, ZByteIoError> {
        self.cursor.z_position()
    }

    fn read_remaining(&mut self, into: &mut Vec<u8>) -> Result<usize, ZByteIoError> {
        self.cursor.read_remaining(into)
    }
}
