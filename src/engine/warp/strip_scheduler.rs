//! Writes a prepared warp with any number of threads: each takes strips, renders and encodes them;
//! the strips are passed on in order. No thread waits for another: the thread that finishes the
//! next strip in order passes it on, together with finished later ones.

use std::cell::Cell;
use std::ops::{ControlFlow, Deref};
use std::sync::atomic::{AtomicBool, AtomicUsize, Ordering};
use std::sync::{Mutex, PoisonError};

use super::RenderJob;
use crate::codec::{StripChecksum, Writer};
use crate::render::band_rows;

/// Largest buffer of samples that a thread keeps for the next strip, bytes; ordinary strips take
/// half of it.
const MAX_KEPT_BYTES: usize = 2 << 20;

/// Pixels that are computed between two checks of `is_wanted`; a strip of PNG has fewer.
const PIXELS_PER_CHECK: u32 = 1 << 18;

/// A step of writing that an observer can measure.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Stage {
    /// Mesh to pixels.
    Render,
    /// Pixels to the bytes of a file.
    Encode,
}

/// Observes the steps of writing, for example to measure time. `()` only does the work.
pub trait WriteObserver: Sync {
    /// Calls `work` exactly once.
    fn around(&self, stage: Stage, work: &mut dyn FnMut());

    /// Whether this thread takes one more strip; called before each. Other threads take the strips
    /// that it leaves.
    fn goes_on(&self) -> bool {
        true
    }

    /// Whether the output is still needed; called between bands and before a strip is encoded.
    fn is_wanted(&self) -> bool {
        true
    }
}

impl WriteObserver for () {
    fn around(&self, _stage: Stage, work: &mut dyn FnMut()) {
        work();
    }
}

/// A picture that is being written. The sink gets the file in one piece per strip, in order, and
/// whether a piece is the last one; when it returns `Break`, the work ends at the next strip.
#[derive(Debug)]
pub struct StripScheduler<W, S> {
    warp: W,
    next: AtomicUsize,
    cancelled: AtomicBool,
    queue: Mutex<Queue<S>>,
}

/// Encoded strips that wait for an earlier one.
#[derive(Debug)]
struct Queue<S> {
    waiting: Vec<Option<(Vec<u8>, StripChecksum)>>,
    checksums: Vec<StripChecksum>,
    sink: S,
}

impl<W: Deref<Target = RenderJob>, S: FnMut(Vec<u8>, bool) -> ControlFlow<()>>
    StripScheduler<W, S>
{
    /// Creates a scheduler; nothing is drawn yet.
    pub fn new(warp: W, sink: S) -> Self {
        let strips = warp.writer.strips();
        let queue = Queue {
            waiting: vec![None; strips],
            checksums: Vec::with_capacity(strips),
            sink,
        };
        Self {
            warp,
            next: AtomicUsize::new(0),
            cancelled: AtomicBool::new(false),
            queue: Mutex::new(queue),
        }
    }

    /// The number of strips.
    pub fn strips(&self) -> usize {
        self.warp.writer.strips()
    }

    /// Takes strips until none is left, the output is no longer needed, or the observer stops this
    /// thread. Returns true for the one call that passed on the last piece.
    pub fn work(&self, watch: &dyn WriteObserver) -> bool {
        let RenderJob { drawer, writer, .. } = &*self.warp;
        let row = drawer.target().width() as usize * drawer.pixel_bytes();
        let mut samples = SAMPLE_BUFFER.take();
        let mut ended = false;
        while !self.cancelled.load(Ordering::Relaxed) && watch.goes_on() {
            let index = self.next.fetch_add(1, Ordering::Relaxed);
            if index >= writer.strips() {
                break;
            }
            let rows = writer.rows(index);
            samples.resize(rows.len() * row, 0);
            let step = band_rows(PIXELS_PER_CHECK, drawer.computed_width());
            let bands = (rows.start..rows.end)
                .step_by(step as usize)
                .zip(samples.chunks_mut(step as usize * row));
            for (first, band) in bands {
                if watch.is_wanted() {
                    watch.around(Stage::Render, &mut || {
                        let rows = first..rows.end.min(first + step);
                        drawer.band(rows, band, &|| !watch.is_wanted());
                    });
                }
            }
            if !watch.is_wanted() {
                self.cancelled.store(true, Ordering::Relaxed);
                break;
            }
            let mut bytes = if index == 0 {
                writer.head()
            } else {
                Vec::new()
            };
            let mut checksum = (0, 0);
            watch.around(Stage::Encode, &mut || {
                checksum = writer.strip_into(index, &mut samples, &mut bytes, &|| watch.is_wanted())
            });
            if !watch.is_wanted() {
                self.cancelled.store(true, Ordering::Relaxed);
                break;
            }
            let mut queue = self.queue.lock().unwrap_or_else(PoisonError::into_inner);
            queue.waiting[index] = Some((bytes, checksum));
            match queue.flush(writer) {
                ControlFlow::Continue(last) => ended = last,
                ControlFlow::Break(()) => self.cancelled.store(true, Ordering::Relaxed),
            }
        }
        if samples.capacity() <= MAX_KEPT_BYTES {
            SAMPLE_BUFFER.set(samples);
        }
        ended
    }
}

impl<S: FnMut(Vec<u8>, bool) -> ControlFlow<()>> Queue<S> {
    /// Passes on every strip that is next in order; returns whether the last one was among them.
    fn flush(&mut self, writer: &Writer) -> ControlFlow<(), bool> {
        while let Some((mut bytes, checksum)) = self
            .waiting
            .get_mut(self.checksums.len())
            .and_then(Option::take)
        {
            self.checksums.push(checksum);
            let last = self.checksums.len() == self.waiting.len();
            if last {
                bytes.extend_from_slice(&writer.tail(&self.checksums));
            }
            (self.sink)(bytes, last)?;
            if last {
                return ControlFlow::Continue(true);
            }
        }
        ControlFlow::Continue(false)
    }
}

thread_local! {
    /// Kept between strips, which saves the page faults of half a megabyte.
    static SAMPLE_BUFFER: Cell<Vec<u8>> = const { Cell::new(Vec::new()) };
}
