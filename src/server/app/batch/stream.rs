//! The frames of a batch in order. A few are made ahead of the reader, each in its own task, so that no frame holds a worker while it waits
//! for the reader. When the stream is dropped, the tasks are cancelled.

use std::collections::VecDeque;
use std::sync::Arc;
use std::time::{Duration, Instant};

use bytes::Bytes;
use mlswarp::warp::Warning;
use tokio::task::JoinHandle;

use super::frame::{BatchJob, Frame};
use super::package::Package;
use crate::limits::memory::{Purpose, Reservation};
use crate::observe::Scope;
use crate::observe::stages::Timing;
use crate::pool::{PoolError, QueueKey, WorkClass};
use crate::problem::{Code, Problem};
use crate::wire::{BatchFrame, BatchIndex};

/// Frames that are made ahead beyond the number of workers, so that none waits while the reader takes one.
/// With two workers, 0, 1, 2, 4 and 6 gave 1.08, 1.21, 1.27, 1.23 and 1.25 times the frames of single requests
/// (`cargo bench --bench batch`).
const SPARE: usize = 2;
/// The most frames that are made ahead.
const MOST_AHEAD: usize = 8;
/// The pause before a frame that found no worker or no memory is made again.
const RETRY: Duration = Duration::from_millis(50);

/// The bytes of a batch's file, frame by frame.
pub(crate) struct BatchStream {
    job: Arc<BatchJob>,
    /// The next frames, in order.
    ahead: VecDeque<FrameTask>,
    /// How many of them may be made at one time.
    width: usize,
    /// The number of frames that have been begun.
    begun: u32,
    entries: Vec<BatchFrame>,
    /// See [`Frame::of_file`].
    pub(crate) of_file: Vec<Warning>,
    /// `None` after the end.
    package: Option<Package>,
    /// The memory of the package's directory and of the index.
    held: Option<Reservation>,
}

/// A frame that is being made; it is cancelled when this is dropped.
struct FrameTask(JoinHandle<Result<Frame, Problem>>);

impl Drop for FrameTask {
    fn drop(&mut self) {
        self.0.abort();
    }
}

impl BatchStream {
    /// Errors: Too little memory for the directory.
    pub(crate) fn new(job: BatchJob, delay: u16, plays: u16) -> Result<Self, Problem> {
        let directory = job.form.directory_bytes(job.frames, job.files_per_frame());
        let held = Some(job.app.reserve_for(Purpose::Frame, &job.quota, directory)?);
        let package = Some(Package::new(job.form, job.frames, delay, plays));
        let width = most_ahead(&job);
        Ok(Self { job: Arc::new(job), ahead: VecDeque::new(), width, begun: 0, entries: Vec::new(), of_file: Vec::new(), package, held })
    }

    /// The next bytes; `None` at the end, also after an error.
    pub(crate) async fn next(&mut self) -> Option<Result<Bytes, Problem>> {
        if self.entries.len() < self.job.frames as usize {
            self.package.as_ref()?;
            let next = self.next_frame().await;
            if next.is_err() {
                self.package = None;
                self.ahead.clear();
            }
            return Some(next);
        }
        let index = serde_json::to_vec(&BatchIndex { frames: &self.entries }).unwrap_or_default();
        let last = self.package.take()?.finish(&index);
        Some(last.map(|last| match self.held.take() {
            Some(held) => held.attach(last),
            None => last.into(),
        }))
    }

    async fn next_frame(&mut self) -> Result<Bytes, Problem> {
        let Frame { packed, entry, of_file, mut held } = self.made().await?;
        let package = self.package.as_mut().ok_or_else(|| Problem::new(Code::Internal, "the batch has ended"))?;
        let bytes = package.push(packed)?;
        held.shrink_to(bytes.len() as u64);
        self.entries.push(entry);
        self.of_file = of_file;
        self.job.app.metrics().batch_frames.inc();
        Ok(held.attach(bytes))
    }

    /// The next frame. A busy server delays a batch that has begun; it ends it only if one frame takes longer than a request may.
    async fn made(&mut self) -> Result<Frame, Problem> {
        let (began, limit) = (Instant::now(), self.job.app.config().timeouts.request);
        let most = most_ahead(&self.job);
        loop {
            self.begin();
            let task = self.ahead.front_mut().ok_or_else(|| Problem::new(Code::Internal, "no frame was begun"))?;
            let made = tokio::time::timeout(limit.saturating_sub(began.elapsed()), &mut task.0).await;
            let made = match made {
                Ok(made) => made.unwrap_or_else(|_| Err(PoolError::Panicked.into())),
                Err(_) => {
                    let detail = format!("a frame was not finished within {} s, the time limit of a request", limit.as_secs_f64());
                    return Err(Problem::new(Code::Overloaded, detail));
                }
            };
            match made {
                Err(problem) if problem.code == Code::Overloaded && !self.entries.is_empty() && began.elapsed() < limit => {
                    // Later frames may hold what this one needs: they are made again.
                    self.ahead.clear();
                    self.begun = u32::try_from(self.entries.len()).unwrap_or(u32::MAX);
                    self.width = 1;
                    tokio::time::sleep(RETRY).await;
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
            self.ahead.push_back(FrameTask(tokio::spawn(Scope::current().answered().wrap(make(Arc::clone(&self.job), self.begun)))));
            self.begun += 1;
        }
    }
}

fn most_ahead(job: &BatchJob) -> usize {
    (job.app.pool().workers() + SPARE).min(MOST_AHEAD)
}

/// Makes a frame on a worker. The batches of a client wait in the queue like one request of the client.
async fn make(job: Arc<BatchJob>, frame: u32) -> Result<Frame, Problem> {
    let pool = job.app.pool().clone();
    let ticket = pool.admit(WorkClass::Upload, QueueKey::client(job.client)).await?;
    let timing = Timing { queue: ticket.waited(), ..Timing::default() };
    pool.run(&ticket, move |cancel| job.draw(frame, timing, cancel)).await?
}
