//! The frames of a batch in order. A few are made ahead of the reader, each in its own task, so
//! that no frame holds a worker while it waits for the reader. When the stream is dropped, the
//! tasks are cancelled.

use std::collections::VecDeque;
use std::sync::Arc;
use std::time::{Duration, Instant};

use bytes::Bytes;
use mlswarp::warp::Warning;
use tokio::task::JoinHandle;

use super::frame::{BatchJob, FinishedFrame};
use super::package::{INDEX_NAME, Package, PackedFrame};
use crate::limits::memory::{Budget, MemoryClass, Reservation};
use crate::observe::Scope;
use crate::observe::stages::Timing;
use crate::pool::{PoolError, QueueKey, aside};
use crate::problem::{Code, Problem};
use crate::wire::{BatchFrame, BatchIndex};

/// Frames that are made ahead beyond the number of workers, so that none waits while the reader
/// takes one. With two workers, 0, 1, 2, 4 and 6 gave 1.08, 1.21, 1.27, 1.23 and 1.25 times the
/// frames of single requests (`cargo bench --bench batch`).
const SPARE_FRAMES: usize = 2;
/// The most frames that are made ahead.
const MOST_AHEAD: usize = 8;
/// A frame of more bytes is appended on a blocking thread, and so is the index of more frames.
const MAX_COPIED_HERE: usize = 64 << 10;
const MAX_INDEX_HERE: u32 = 64;
/// The pause before a frame that found no worker or no memory is made again.
const RETRY_PAUSE: Duration = Duration::from_millis(50);

/// The bytes of a batch's file, frame by frame.
pub(crate) struct BatchStream {
    job: Arc<BatchJob>,
    /// The next frames, in order.
    ahead: VecDeque<FrameTask>,
    /// How many of them may be made at one time.
    width: usize,
    /// The number of frames that have been begun.
    begun: u32,
    /// The number of frames that have been appended.
    done: u32,
    /// See [`FinishedFrame::of_file`].
    pub(crate) of_file: Vec<Warning>,
    /// `None` after the end.
    file: Option<BatchFile>,
    /// The memory of the package's directory and of the index.
    held: Option<Reservation>,
}

/// The file, and what its index says of each frame.
struct BatchFile {
    package: Package,
    entries: Vec<BatchFrame>,
}

impl BatchFile {
    fn push(&mut self, packed: PackedFrame, entry: BatchFrame) -> Result<Vec<u8>, Problem> {
        let bytes = self.package.push(packed)?;
        self.entries.push(entry);
        Ok(bytes)
    }

    fn finish(self) -> Result<Vec<u8>, Problem> {
        let index = serde_json::to_vec(&BatchIndex {
            frames: &self.entries,
        })
        .unwrap_or_default();
        self.package.finish(INDEX_NAME, &index)
    }
}

/// A frame that is being made; it is cancelled when this is dropped.
struct FrameTask(JoinHandle<Result<FinishedFrame, Problem>>);

impl Drop for FrameTask {
    fn drop(&mut self) {
        self.0.abort();
    }
}

impl BatchStream {
    /// Errors: Too little memory for the directory.
    pub(crate) async fn new(job: BatchJob, delay: u16, plays: u16) -> Result<Self, Problem> {
        let directory = job.form.directory_bytes(job.frames, job.files_per_frame());
        let take = |budget: &Budget| budget.take_for(MemoryClass::Frame, &job.quota, directory);
        let held = Some(job.app.admission.reserve_aside(take).await?);
        let package = Package::new(job.form, job.frames, delay, plays);
        let file = Some(BatchFile {
            package,
            entries: Vec::new(),
        });
        let width = most_ahead(&job);
        Ok(Self {
            job: Arc::new(job),
            ahead: VecDeque::new(),
            width,
            begun: 0,
            done: 0,
            of_file: Vec::new(),
            file,
            held,
        })
    }

    /// The next bytes; `None` at the end, also after an error.
    pub(crate) async fn next(&mut self) -> Option<Result<Bytes, Problem>> {
        if self.done < self.job.frames {
            // Kept only if the frame is appended.
            let file = self.file.take()?;
            let next = self.next_frame(file).await;
            if next.is_err() {
                self.ahead.clear();
            }
            return Some(next);
        }
        let file = self.file.take()?;
        let last = aside(self.done > MAX_INDEX_HERE, move || file.finish()).await;
        Some(last.map(|last| match self.held.take() {
            Some(held) => held.attach(last),
            None => last.into(),
        }))
    }

    async fn next_frame(&mut self, mut file: BatchFile) -> Result<Bytes, Problem> {
        let FinishedFrame {
            packed,
            entry,
            of_file,
            mut held,
        } = self.made().await?;
        let is_long = packed.bytes() > MAX_COPIED_HERE;
        let append = move || file.push(packed, entry).map(|bytes| (file, bytes));
        let (file, bytes) = aside(is_long, append).await?;
        self.file = Some(file);
        held.shrink_to(bytes.len() as u64);
        self.done += 1;
        self.of_file = of_file;
        self.job.app.metrics().batch_frames.inc();
        Ok(held.attach(bytes))
    }

    /// The next frame. A busy server delays a batch that has begun; it ends it only if one frame
    /// takes longer than a request may.
    async fn made(&mut self) -> Result<FinishedFrame, Problem> {
        let (began, limit) = (Instant::now(), self.job.app.config().timeouts.request);
        let most = most_ahead(&self.job);
        loop {
            self.begin();
            let task = self
                .ahead
                .front_mut()
                .ok_or_else(|| Problem::new(Code::Internal, "no frame was begun"))?;
            let made =
                tokio::time::timeout(limit.saturating_sub(began.elapsed()), &mut task.0).await;
            let made = match made {
                Ok(made) => made.unwrap_or_else(|_| Err(PoolError::Panicked.into())),
                Err(_) => {
                    let detail = format!(
                        "a frame was not finished within {} s, the time limit of a request",
                        limit.as_secs_f64()
                    );
                    return Err(Problem::new(Code::Overloaded, detail));
                }
            };
            match made {
                Err(problem)
                    if problem.code == Code::Overloaded
                        && self.done > 0
                        && began.elapsed() < limit =>
                {
                    // Later frames may hold what this one needs: they are made again.
                    self.ahead.clear();
                    self.begun = self.done;
                    self.width = 1;
                    tokio::time::sleep(RETRY_PAUSE).await;
                }
                made => {
                    self.ahead.pop_front();
                    self.width = most;
                    // The next one is made while the reader takes this one.
                    self.begin();
                    return made;
                }
            }
        }
    }

    /// Begins as many frames as may be made ahead.
    fn begin(&mut self) {
        while self.ahead.len() < self.width && self.begun < self.job.frames {
            self.ahead.push_back(FrameTask(tokio::spawn(
                Scope::current()
                    .answered()
                    .wrap(make(Arc::clone(&self.job), self.begun)),
            )));
            self.begun += 1;
        }
    }
}

fn most_ahead(job: &BatchJob) -> usize {
    (job.app.pool().workers() + SPARE_FRAMES).min(MOST_AHEAD)
}

/// Makes a frame on a worker. The batches of a client wait in the queue like one request of the
/// client.
async fn make(job: Arc<BatchJob>, frame: u32) -> Result<FinishedFrame, Problem> {
    let key = QueueKey::client(job.client);
    let ticket = job.app.admission.upload(key).await?;
    let timing = Timing::queued(ticket.waited());
    ticket
        .run(move |cancel| job.draw(frame, timing, cancel))
        .await?
}
