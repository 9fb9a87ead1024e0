//! One frame of a drag: the session is used, and its picture or mesh is made by the same walk as that of a request.

use std::sync::Arc;
use std::time::Duration;

use bytes::Bytes;
use mlswarp::codec::{Compression, Format};
use mlswarp::deform::Handle;
use mlswarp::warp::{OutputSpec, Report};
use tokio::sync::Semaphore;

use crate::app::App;
use crate::app::drag::{MeshForm, PosedMesh};
use crate::app::draw::{Drawn, Picture, Piece};
use crate::client::Client;
use crate::drag::frame_scheduler::FrameRequest;
use crate::observe::Scope;
use crate::observe::stages::Cost;
use crate::observe::stages::Timing;
use crate::pool::{PoolError, Ticket};
use crate::problem::Problem;
use crate::session::SessionId;
use crate::store::Record;
use crate::wire::{FrameReport, FrameTiming, MeshShape, UnreadHandles};

/// What frames are.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Form {
    /// Files of this format, or of the session's.
    Picture(Option<Format>),
    /// Little-endian f32.
    Mesh,
}

/// A frame and what goes with it.
#[derive(Debug)]
pub(crate) struct Frame {
    /// Of the pose.
    pub(crate) seq: u64,
    /// The session as it was.
    pub(crate) record: Arc<Record>,
    /// The grid that belongs to it.
    pub(crate) shape: MeshShape,
    /// The file, or the numbers, in order.
    pub(crate) pieces: Vec<Bytes>,
    /// JSON.
    pub(crate) report: String,
}

/// The width at which nothing of the session's pictures is missing.
pub(crate) fn full_width(record: &Record) -> u32 {
    record.output.width.unwrap_or_else(|| record.extent.width())
}

/// How a frame of this width is made. What is soon replaced is not compressed with care.
fn output(record: &Record, format: Option<Format>, width: Option<u32>) -> OutputSpec {
    let full = full_width(record);
    let output = OutputSpec { format: format.unwrap_or(record.output.format), ..record.output };
    match width {
        Some(width) if width < full => OutputSpec { width: Some(width), compression: Compression::Fast, ..output },
        Some(width) if width > full => OutputSpec { width: Some(width), ..output },
        _ => output,
    }
}

/// Makes a frame. Dropping the future ends the work at the next strip.
pub(crate) async fn make(
    app: App,
    client: Client,
    id: SessionId,
    frames: Arc<Semaphore>,
    form: Form,
    order: FrameRequest,
) -> Result<Frame, Problem> {
    let made = walk(app, client, id, frames, form, order).await;
    if let Err(problem) = &made {
        Scope::current().set_error(problem.code);
    }
    made
}

async fn walk(app: App, client: Client, id: SessionId, frames: Arc<Semaphore>, form: Form, order: FrameRequest) -> Result<Frame, Problem> {
    let turn = frames.acquire_owned().await.expect("the semaphore is never closed");
    let share = app.share(client);
    // Once a frame, not once a pose: the store says whether the session is still there and still the same.
    let record = app.touch(id, None).await?.record;
    let seq = order.pose.seq;
    let frame = match form {
        Form::Picture(format) => {
            let (record, warm) = app.warm_newest(client, record).await?;
            drop(turn);
            let q = read(&app, warm.ticket(), order.pose.q).await?;
            let shape = warm.shape(record.extent);
            let output = output(&record, format, order.width);
            let Drawn { report, extent, timing, picture, .. } = app.draw_warm(warm, q, record.folds, output, share).await?;
            let (pieces, cost) = collect(picture).await?;
            let full = order.width.is_none_or(|width| width >= full_width(&record));
            let report = told(seq, (extent.width(), extent.height()), full, &report, timing, cost);
            Frame { seq, record, shape, pieces, report }
        }
        Form::Mesh => {
            let (ticket, walked) = app.walk(client, &record, MeshForm::Numbers).await?;
            drop(turn);
            let q = read(&app, &ticket, order.pose.q).await?;
            let shape = walked.shape(record.extent);
            let PosedMesh { report, timing, body, .. } = app.pose_walked(ticket, walked, q, &record, MeshForm::Numbers, share).await?;
            let report = told(seq, (record.extent.width(), record.extent.height()), true, &report, timing, Cost::default());
            Frame { seq, record, shape, pieces: vec![body], report }
        }
    };
    Ok(frame)
}

/// Handles in so many bytes of text are read sooner than a compute thread wakes.
const READ_HERE: usize = 16 << 10;

/// Reads the handles of a pose.
async fn read(app: &App, ticket: &Ticket, q: Arc<UnreadHandles>) -> Result<Vec<Handle>, Problem> {
    if q.len() <= READ_HERE { q.read() } else { app.0.pool.run(ticket, move |_| q.read()).await? }
}

/// All of a picture.
async fn collect(picture: Picture) -> Result<(Vec<Bytes>, Cost), Problem> {
    let mut strips = match picture {
        Picture::Whole { bytes, cost } => return Ok((vec![bytes], cost)),
        Picture::Strips(strips) => strips,
    };
    let mut pieces = Vec::new();
    loop {
        match strips.recv().await {
            Some(Piece::Bytes(bytes)) => pieces.push(bytes),
            Some(Piece::End(cost)) => return Ok((pieces, cost)),
            None => return Err(PoolError::Panicked.into()),
        }
    }
}

fn told(seq: u64, (width, height): (u32, u32), full: bool, report: &Report, timing: Timing, cost: Cost) -> String {
    let ms = |time: Duration| (time.as_secs_f64() * 1e6).round() / 1e3;
    let timing = FrameTiming { queue: ms(timing.queue), deform: ms(timing.deform), render: ms(cost.render), encode: ms(cost.encode) };
    let warnings = report.warnings.iter().map(|w| w.code()).collect();
    let report = FrameReport { seq, width, height, full, folds: report.folds, residual: report.residual, warnings, timing };
    serde_json::to_string(&report).expect("an object of numbers and codes")
}
