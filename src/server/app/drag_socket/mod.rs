//! A drag over a socket: poses in, frames out. Messages arrive in [`Drag::on_text`] and
//! [`Drag::on_binary`]; [`Drag::next_outgoing`] returns what is to be sent. The order, width and
//! encoding of frames is decided by [`crate::drag`]; `frame` draws one. A drag holds the newest
//! pose, at most one frame in progress or ready, and what the socket has not sent yet: at most the
//! frames of the window.

mod frame;

use std::collections::VecDeque;
use std::future::{Future, pending};
use std::pin::Pin;
use std::sync::Arc;
use std::time::{Duration, Instant};

use bytes::Bytes;

use super::App;
use super::mesh::{MeshForm, admit_mesh};
use super::parts::plans::columns;
use super::session_warp::{MAX_INLINE_BYTES, newest_setup};
use crate::client::Client;
use crate::drag::frame_scheduler::{FrameScheduler, QueuedPose, Step};
use crate::drag::picture_ladder::PictureLadder;
use crate::drag::preview_controller::PreviewController;
pub use crate::drag::send_window::{MAX_WINDOW, Window};
use crate::limits::memory::{MemoryClass, Reservation};
use crate::limits::sockets::{FrameTurns, SocketSlot};
use crate::observe::Scope;
use crate::pool::{QueueKey, WorkClass};
use crate::problem::{Code, Problem};
use crate::session::SessionId;
use crate::store::Record;
use crate::wire::{BadMessage, DragMessage, MeshShape, Reserved};
pub use frame::FrameContent;
use frame::{DragFrame, KnownLattice, draw_frame, full_width, mesh_shape};

/// The width of previews.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum PreviewWidth {
    /// Adapted to the speed of the machine and the connection.
    Auto,
    /// This width, px.
    Fixed(u32),
}

/// The options of a drag socket.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct DragOptions {
    /// The content of frames.
    pub form: FrameContent,
    /// The width of frames while the pose changes; images only.
    pub width: PreviewWidth,
    /// Whether a report precedes each frame.
    pub report: bool,
    /// The number of frames that may be unacknowledged.
    pub window: Window,
}

/// A message to send.
#[derive(Debug)]
pub enum Outgoing {
    /// A text message.
    Text(String),
    /// A binary message: the sequence number, then the pieces.
    Frame(u64, Vec<Bytes>),
}

/// Memory of a socket besides its frames, bytes: buffers of both directions, and per column of its
/// session a pose that is being received (twice), one that waits and one that is being drawn.
const SOCKET_BYTES: (u64, u64) = (512 << 10, 256);

/// Work in progress.
type Task<T> = Pin<Box<dyn Future<Output = T> + Send>>;
/// A message that was read.
type Read = Result<DragMessage, BadMessage>;

/// Pause before a long message is read that found no worker.
const RETRY_PAUSE: Duration = Duration::from_millis(50);

/// One drag of one session.
pub struct Drag {
    app: App,
    id: SessionId,
    client: Client,
    options: DragOptions,
    scheduler: FrameScheduler<DragFrame>,
    drawing: Option<Task<Result<DragFrame, Problem>>>,
    /// A long message that is being read.
    reading: Option<Task<Read>>,
    newest: Option<u64>,
    /// The record of the newest frame.
    record: Arc<Record>,
    lattice: KnownLattice,
    /// The record whose shape the client knows.
    announced: Arc<Record>,
    outgoing: VecDeque<Outgoing>,
    is_over: bool,
    slot: SocketSlot,
    _reservation: Reservation,
}

impl std::fmt::Debug for Drag {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        f.debug_struct("Drag")
            .field("id", &self.id)
            .field("options", &self.options)
            .finish_non_exhaustive()
    }
}

/// Opens a drag of a session.
/// Errors: Unknown session, or too little capacity.
pub async fn open(
    app: &App,
    client: Client,
    id: SessionId,
    options: DragOptions,
) -> Result<Drag, Problem> {
    let mut record = app.sessions.peek(id).await?.record;
    app.lifecycle.require_running()?;
    let slot = app.admission.sockets.acquire(client.tenant(), id)?;
    let bytes = SOCKET_BYTES.0 + SOCKET_BYTES.1 * columns(&record);
    let reservation = app
        .admission
        .reserve_aside(|budget| budget.take(MemoryClass::Socket, bytes))
        .await?;
    let lattice = KnownLattice::default();
    let shape = if let FrameContent::CompactMesh(_) = options.form {
        let _turn = slot.frames.take().await;
        let (newest, plan) = admit_mesh(app, client, record, &MeshForm::F32).await?;
        record = newest;
        mesh_shape(
            app,
            &plan,
            (options.form, &lattice),
            &record,
            &app.admission.response_quota(client),
        )
        .await?
        .0
    } else {
        let (newest, setup) = newest_setup(app, client, record).await?;
        record = newest;
        MeshShape::new(&setup, record.extent)
    };
    Ok(Drag {
        app: app.clone(),
        id,
        client,
        scheduler: FrameScheduler::new(
            previews(options, &record),
            pictures(options, &record),
            full(options, &record),
            options.window,
        ),
        options,
        drawing: None,
        reading: None,
        newest: None,
        lattice,
        record: Arc::clone(&record),
        announced: record,
        outgoing: VecDeque::from([shape_message(&shape)]),
        is_over: false,
        slot,
        _reservation: reservation,
    })
}

fn shape_message(shape: &MeshShape) -> Outgoing {
    Outgoing::Text(serde_json::to_string(shape).expect("an object of numbers"))
}

/// The width that stands for a mesh.
const MESH_WIDTH: u32 = 1;

/// The size of the session's images; of the source if it depends on the pose.
fn size(record: &Record) -> (u32, u32) {
    let width = full_width(record).unwrap_or(record.extent.width());
    let (w, h) = (
        u64::from(record.extent.width()),
        u64::from(record.extent.height()),
    );
    (
        width,
        u32::try_from(h * u64::from(width) / w)
            .unwrap_or(u32::MAX)
            .max(1),
    )
}

fn previews(options: DragOptions, record: &Record) -> PreviewController {
    match (options.form, options.width) {
        (FrameContent::Mesh | FrameContent::CompactMesh(_), _) => {
            PreviewController::fixed(MESH_WIDTH)
        }
        (FrameContent::Auto, _) => PreviewController::fixed(size(record).0),
        (FrameContent::Picture(_), PreviewWidth::Auto) => PreviewController::adaptive(size(record)),
        (FrameContent::Picture(_), PreviewWidth::Fixed(width)) => PreviewController::fixed(width),
    }
}

fn pictures(options: DragOptions, record: &Record) -> Option<PictureLadder> {
    let fixed = match options.width {
        PreviewWidth::Auto => None,
        PreviewWidth::Fixed(width) => Some(width),
    };
    (options.form == FrameContent::Auto).then(|| PictureLadder::new(size(record), fixed))
}

fn full(options: DragOptions, record: &Record) -> u32 {
    // Unless the full width is known, every image is a preview.
    if options.form.is_mesh() {
        MESH_WIDTH
    } else {
        full_width(record).unwrap_or(u32::MAX)
    }
}

impl Drag {
    /// A text message arrived. A long one is read on a compute thread: until [`Drag::is_reading`]
    /// is false, no other may arrive.
    pub fn on_text(&mut self, text: Bytes, now: Instant) {
        if text.len() <= MAX_INLINE_BYTES {
            return self.on_message(parse(&text), now);
        }
        let (app, key, frames) = (
            self.app.clone(),
            QueueKey::session(self.client, self.id),
            self.slot.frames.clone(),
        );
        self.reading = Some(Box::pin(read_long(app, key, frames, text)));
    }

    /// A binary message arrived.
    pub fn on_binary(&mut self, bytes: &Bytes, now: Instant) {
        // In the memory of the socket.
        let message = Reserved::<DragMessage, _>::of_bytes(bytes, |_| Ok(()));
        self.on_message(message.map(|message| message.into_parts().0), now);
    }

    /// Whether a message is being read.
    pub const fn is_reading(&self) -> bool {
        self.reading.is_some()
    }

    fn on_message(&mut self, message: Read, now: Instant) {
        match message {
            Ok(DragMessage::Ack(seq)) => {
                if self.scheduler.ack(seq, now).is_err() {
                    self.send_problem(
                        None,
                        &Problem::new(
                            Code::BadValue,
                            format!("there is no frame {seq} to acknowledge"),
                        )
                        .pointer("/ack"),
                    );
                }
            }
            Ok(DragMessage::Pose { seq, q }) => {
                if let Some(newest) = self.newest.filter(|newest| seq <= *newest) {
                    let detail = format!(
                        "each pose needs a higher `seq` than the one before: {seq} follows {newest}"
                    );
                    self.send_problem(
                        Some(seq),
                        &Problem::new(Code::BadValue, detail)
                            .pointer("/seq")
                            .actual(seq),
                    );
                    return;
                }
                self.newest = Some(seq);
                self.scheduler.pose(QueuedPose {
                    seq,
                    q: Arc::new(q),
                    at: now,
                });
            }
            Err(BadMessage { seq, problem }) => self.send_problem(seq, &problem),
        }
    }

    /// Sends a problem document.
    pub fn send_problem(&mut self, seq: Option<u64>, problem: &Problem) {
        // The id of the request that opened the socket.
        let mut document = problem.to_json(&self.app.config().public_path, Scope::current().id());
        if let (Some(seq), Some(members)) = (seq, document.as_object_mut()) {
            members.insert("seq".to_owned(), seq.into());
        }
        self.outgoing
            .push_back(Outgoing::Text(document.to_string()));
    }

    /// Starts, cancels and sends the frames that are due; returns the time of the next step, if
    /// nothing happens before.
    pub fn act(&mut self, now: Instant) -> Option<Instant> {
        let until = loop {
            match self.scheduler.next(now) {
                Step::Draw(request) => {
                    let scope = Scope::current().frame(self.app.tracer());
                    let (frames, form) = (
                        self.slot.frames.clone(),
                        (self.options.form, self.lattice.clone()),
                    );
                    let drawing = draw_frame(
                        self.app.clone(),
                        self.client,
                        self.id,
                        frames,
                        form,
                        request,
                    );
                    self.drawing = Some(Box::pin(scope.wrap(drawing)));
                }
                Step::Cancel => self.drawing = None,
                Step::Send(frame) => self.send(frame),
                Step::Wait(until) => break until,
            }
        };
        self.app
            .metrics()
            .poses_superseded
            .inc_by(self.scheduler.take_superseded());
        until
    }

    fn send(&mut self, frame: DragFrame) {
        if !same(&self.announced, &frame.record) {
            self.outgoing.push_back(shape_message(&frame.shape));
            self.announced = frame.record;
        }
        if self.options.report {
            self.outgoing.push_back(Outgoing::Text(frame.report));
        }
        self.outgoing
            .push_back(Outgoing::Frame(frame.seq, frame.pieces));
        self.app.metrics().frames_sent.inc();
    }

    /// Waits for the frame in progress or a message that is being read, or forever if there is
    /// none. May be dropped and called again.
    pub async fn work(&mut self) {
        tokio::select! {
            drawn = done(&mut self.drawing) => self.on_drawn(drawn, Instant::now()),
            read = done(&mut self.reading) => self.on_message(read, Instant::now()),
        }
    }

    fn on_drawn(&mut self, drawn: Result<DragFrame, Problem>, now: Instant) {
        match drawn {
            Ok(frame) => {
                if !same(&self.record, &frame.record) {
                    self.record = Arc::clone(&frame.record);
                    let (options, record) = (self.options, &*self.record);
                    self.scheduler.resize(
                        previews(options, record),
                        pictures(options, record),
                        full(options, record),
                    );
                }
                let bytes = 8 + frame.pieces.iter().map(Bytes::len).sum::<usize>() as u64;
                self.scheduler.drawn(frame, bytes, now);
            }
            Err(problem) if problem.code == Code::Overloaded => self.scheduler.rejected(now),
            Err(problem) => {
                let request = self.scheduler.failed();
                self.is_over = matches!(problem.code, Code::NoSuchSession | Code::SessionExpired);
                // The preview of a full frame was sent already; a problem that arose since is sent
                // with the next pose.
                if let Some(request) =
                    request.filter(|request| self.is_over || !request.is_full_quality)
                {
                    self.send_problem(Some(request.pose.seq), &problem);
                }
            }
        }
    }

    /// Ends the drag if the session has ended. A 503 does not mean that: the store is
    /// unavailable, or another version stored the session.
    pub async fn check_session(&mut self) {
        if let Err(problem) = self.app.sessions.peek(self.id).await
            && problem.code.status() != 503
        {
            self.is_over = true;
            self.send_problem(None, &problem);
        }
    }

    /// The next message to send.
    pub fn next_outgoing(&mut self) -> Option<Outgoing> {
        self.outgoing.pop_front()
    }

    /// Whether the session has ended; only the remaining messages are sent.
    pub const fn is_over(&self) -> bool {
        self.is_over
    }

    /// Cancels the frame in progress.
    pub fn stop(&mut self) {
        (self.drawing, self.reading) = (None, None);
    }

    /// The record of the newest frame.
    pub fn record(&self) -> &Record {
        &self.record
    }

    /// When the oldest frame was sent that the client has not acknowledged.
    pub fn owed_since(&self) -> Option<Instant> {
        self.scheduler.owed_since()
    }
}

/// Waits for a task, or forever if there is none.
async fn done<T>(task: &mut Option<Task<T>>) -> T {
    let Some(running) = task else {
        return pending().await;
    };
    let result = running.await;
    *task = None;
    result
}

/// Reads a text message, in the memory of the socket.
fn parse(text: &[u8]) -> Read {
    Reserved::<DragMessage, _>::parse(text, |_| Ok(())).map(|message| message.into_parts().0)
}

/// Reads a long text message on a compute thread, when there is one.
async fn read_long(app: App, key: QueueKey, frames: FrameTurns, text: Bytes) -> Read {
    let _turn = frames.take().await;
    let ticket = loop {
        match app.admission.pool.admit(WorkClass::Drag, key).await {
            Ok(ticket) => break ticket,
            Err(_) => tokio::time::sleep(RETRY_PAUSE).await,
        }
    };
    ticket
        .run(move |_| parse(&text))
        .await
        .unwrap_or_else(|error| Err(Problem::from(error).into()))
}

/// Whether frames of both records have the same shape: layers do not change it.
fn same(a: &Record, b: &Record) -> bool {
    let shape = |record: &Record| (record.created, record.image, record.output);
    a.revision == b.revision || (shape(a) == shape(b) && a.rest == b.rest)
}
