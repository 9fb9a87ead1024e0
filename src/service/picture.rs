//! Drawing a prepared warp into an answer. A small picture is made whole; a larger one leaves strip by strip through an unbounded channel,
//! so that compute never waits for a reader. One answer holds at most what its warp says it will write; the sum over all answers is not
//! bounded here. Whoever drops the receiving end ends the work at the next strip.

use std::ops::ControlFlow;
use std::sync::atomic::{AtomicU64, Ordering};
use std::time::{Duration, Instant};

use bytes::Bytes;
use tokio::sync::mpsc::{UnboundedReceiver, unbounded_channel};

use super::App;
use super::problem::Problem;
use super::walk::Ready;
use crate::warp::{Stage, Watch};

/// Pictures of at most this many bytes are made whole: their length and cost stand in the answer's head.
const WHOLE: u64 = 256 << 10;

/// A picture, or one that is being made.
#[derive(Debug)]
pub enum Picture {
    /// All of it.
    Whole {
        /// The file.
        bytes: Bytes,
        /// What drawing cost.
        cost: Cost,
    },
    /// Strips in order, then one [`Piece::End`]; a channel that closes before is a picture that failed.
    Strips(UnboundedReceiver<Piece>),
}

/// What comes out of a picture that is being made.
#[derive(Debug)]
pub enum Piece {
    /// The next bytes of the file.
    Bytes(Bytes),
    /// The file is complete.
    End(Cost),
}

/// Processor time of drawing, all threads together.
#[derive(Clone, Copy, Debug, Default)]
pub struct Cost {
    /// Mesh to pixels.
    pub render: Duration,
    /// Pixels to PNG.
    pub encode: Duration,
}

#[derive(Debug, Default)]
struct Clock {
    render: AtomicU64,
    encode: AtomicU64,
}

impl Watch for Clock {
    fn around(&self, stage: Stage, work: &mut dyn FnMut()) {
        let began = Instant::now();
        work();
        let spent = u64::try_from(began.elapsed().as_nanos()).unwrap_or(u64::MAX);
        match stage {
            Stage::Render => self.render.fetch_add(spent, Ordering::Relaxed),
            Stage::Encode => self.encode.fetch_add(spent, Ordering::Relaxed),
        };
    }
}

impl Clock {
    fn cost(&self) -> Cost {
        let read = |n: &AtomicU64| Duration::from_nanos(n.load(Ordering::Relaxed));
        Cost { render: read(&self.render), encode: read(&self.encode) }
    }
}

/// Counts a picture when it is dropped: abandoned unless it was finished.
struct Begun {
    app: App,
    finished: bool,
}

impl Begun {
    fn new(app: &App) -> Self {
        app.0.pictures.begun.fetch_add(1, Ordering::Relaxed);
        Self { app: app.clone(), finished: false }
    }

    fn finish(mut self) {
        self.finished = true;
    }
}

impl Drop for Begun {
    fn drop(&mut self) {
        let pictures = &self.app.0.pictures;
        if self.finished { &pictures.finished } else { &pictures.abandoned }.fetch_add(1, Ordering::Relaxed);
    }
}

impl App {
    /// Draws.
    ///
    /// # Errors
    /// A computation that failed, where the picture is made whole.
    pub async fn draw(&self, ready: Ready) -> Result<Picture, Problem> {
        let Ready { warp, ticket, .. } = ready;
        let begun = Begun::new(self);
        if warp.max_bytes() <= WHOLE {
            let work = move |cancel: &super::pool::Cancel| {
                let clock = Clock::default();
                let mut file = Vec::new();
                let flow = warp.write(0, &clock, &mut |bytes| {
                    file.extend_from_slice(&bytes);
                    if cancel.is_cancelled() { ControlFlow::Break(()) } else { ControlFlow::Continue(()) }
                });
                if flow.is_continue() {
                    begun.finish();
                }
                Picture::Whole { bytes: file.into(), cost: clock.cost() }
            };
            return Ok(self.0.pool.run(&ticket, work).await?);
        }
        let helpers = self.0.config.workers.saturating_sub(1);
        let (pieces, strips) = unbounded_channel();
        self.0.pool.start(&ticket, move || {
            let clock = Clock::default();
            let flow = warp.write(helpers, &clock, &mut |bytes| {
                if pieces.send(Piece::Bytes(bytes.into())).is_ok() { ControlFlow::Continue(()) } else { ControlFlow::Break(()) }
            });
            if flow.is_continue() {
                begun.finish();
                // A client that leaves after the last strip has missed nothing.
                let _ = pieces.send(Piece::End(clock.cost()));
            }
        });
        Ok(Picture::Strips(strips))
    }
}
