//! The drag: poses in, frames out, as long as a hand moves. Messages come in by [`Drag::on_message`], what is to be sent waits in
//! [`Drag::next_outgoing`]; in between stand the rules and the width of previews ([`crate::drag`]) and the making of one frame (`frame`). No
//! socket is known here. A drag holds the newest pose, at most one frame that is made or being made, and what its socket has not taken yet.

mod frame;

use std::collections::VecDeque;
use std::future::{Future, pending};
use std::pin::Pin;
use std::sync::Arc;
use std::time::Instant;

use bytes::Bytes;

use super::App;
use super::warp::columns;
use crate::client::Client;
use crate::drag::frame_scheduler::{FrameScheduler, Pose, Step};
use crate::drag::preview_controller::PreviewController;
use crate::limits::memory::{Purpose, Reservation};
use crate::limits::sockets::SocketSlot;
use crate::observe::Scope;
use crate::problem::{Code, Problem};
use crate::session::SessionId;
use crate::store::Record;
use crate::wire::{BadMessage, DragMessage, MeshShape};
pub use frame::Form;
use frame::{Frame, full_width};

/// How wide previews are.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum PreviewWidth {
    /// As wide as machine and connection can hold.
    Auto,
    /// So many px.
    Fixed(u32),
}

/// What a client asks for when it opens the socket.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct DragOptions {
    /// What frames are.
    pub form: Form,
    /// How wide they are while the hand moves; pictures only.
    pub width: PreviewWidth,
    /// A report goes before each frame.
    pub report: bool,
}

/// What the socket is to send.
#[derive(Debug)]
pub enum Outgoing {
    /// A text message.
    Text(String),
    /// A binary message: the number, then the pieces.
    Frame(u64, Vec<Bytes>),
}

/// What a socket takes beside its frames: buffers of both directions, and, for each column of its session, a pose that is being received (twice), one
/// that waits and one that a frame is made of.
const SOCKET_BYTES: (u64, u64) = (512 << 10, 256);

type Making = Pin<Box<dyn Future<Output = Result<Frame, Problem>> + Send>>;

/// One hand on one session.
pub struct Drag {
    app: App,
    id: SessionId,
    client: Client,
    wishes: DragOptions,
    desk: FrameScheduler<Frame>,
    making: Option<Making>,
    newest: Option<u64>,
    /// The session as the newest frame knows it, and as the client was told.
    known: Arc<Record>,
    told: Arc<Record>,
    says: VecDeque<Outgoing>,
    is_over: bool,
    seat: SocketSlot,
    _held: Reservation,
}

impl std::fmt::Debug for Drag {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        f.debug_struct("Drag").field("id", &self.id).field("wishes", &self.wishes).finish_non_exhaustive()
    }
}

impl App {
    /// Takes a seat at a session.
    ///
    /// # Errors
    /// Unknown session, or no room.
    pub async fn open_drag(&self, client: Client, id: SessionId, wishes: DragOptions) -> Result<Drag, Problem> {
        let record = self.session(id).await?.record;
        self.opens_sockets()?;
        let seat = self.0.seats.take(client.tenant(), id)?;
        let held = self.reserve(Purpose::Socket, SOCKET_BYTES.0 + SOCKET_BYTES.1 * columns(&record))?;
        let setup = self.session_setup(client, &record).await?;
        let hello = hello(&MeshShape::new(&setup, record.extent));
        Ok(Drag {
            app: self.clone(),
            id,
            client,
            desk: FrameScheduler::new(pace(wishes, &record), full(wishes, &record)),
            wishes,
            making: None,
            newest: None,
            known: Arc::clone(&record),
            told: record,
            says: VecDeque::from([hello]),
            is_over: false,
            seat,
            _held: held,
        })
    }
}

fn hello(shape: &MeshShape) -> Outgoing {
    Outgoing::Text(serde_json::to_string(shape).expect("an object of numbers"))
}

/// A mesh has no width: one pixel stands for all of it.
const MESH: u32 = 1;

fn pace(wishes: DragOptions, record: &Record) -> PreviewController {
    let width = full_width(record);
    let (w, h) = (u64::from(record.extent.width()), u64::from(record.extent.height()));
    let height = u32::try_from(h * u64::from(width) / w).unwrap_or(u32::MAX).max(1);
    match (wishes.form, wishes.width) {
        (Form::Mesh, _) => PreviewController::fixed(MESH),
        (_, PreviewWidth::Auto) => PreviewController::adaptive((width, height)),
        (_, PreviewWidth::Fixed(width)) => PreviewController::fixed(width),
    }
}

fn full(wishes: DragOptions, record: &Record) -> u32 {
    if wishes.form == Form::Mesh { MESH } else { full_width(record) }
}

impl Drag {
    /// A message of the client's.
    pub fn on_message(&mut self, text: &[u8], now: Instant) {
        match DragMessage::parse(text) {
            Ok(DragMessage::Ack(seq)) => {
                if self.desk.ack(seq, now).is_err() {
                    self.complain(None, &Problem::new(Code::BadValue, format!("no frame of seq {seq} was sent")).pointer("/ack"));
                }
            }
            Ok(DragMessage::Pose { seq, .. }) if self.newest.is_some_and(|newest| seq <= newest) => {
                let problem = Problem::new(Code::BadValue, "`seq` must grow from pose to pose").pointer("/seq");
                self.complain(Some(seq), &problem);
            }
            Ok(DragMessage::Pose { seq, q }) => {
                self.newest = Some(seq);
                self.desk.pose(Pose { seq, q: Arc::new(q), at: now });
            }
            Err(BadMessage { seq, problem }) => self.complain(seq, &problem),
        }
    }

    /// Tells the client what is wrong.
    pub fn complain(&mut self, seq: Option<u64>, problem: &Problem) {
        // The id of the request that has opened the socket.
        let mut document = problem.to_json(Scope::current().id());
        if let (Some(seq), Some(members)) = (seq, document.as_object_mut()) {
            members.insert("seq".to_owned(), seq.into());
        }
        self.says.push_back(Outgoing::Text(document.to_string()));
    }

    /// Begins, gives up and lays out what is due; nothing is to be done before the time that comes back, unless something happens.
    pub fn act(&mut self, now: Instant) -> Option<Instant> {
        let until = loop {
            match self.desk.next(now) {
                Step::Make(order) => {
                    let scope = Scope::current().frame(self.app.tracer());
                    let making = frame::make(self.app.clone(), self.client, self.id, self.seat.frames(), self.wishes.form, order);
                    self.making = Some(Box::pin(scope.wrap(making)));
                }
                Step::GiveUp => self.making = None,
                Step::Send(frame) => self.lay_out(frame),
                Step::Wait(until) => break until,
            }
        };
        self.app.metrics().poses_superseded.inc_by(self.desk.take_superseded());
        until
    }

    fn lay_out(&mut self, frame: Frame) {
        if !same(&self.told, &frame.record) {
            self.says.push_back(hello(&frame.shape));
            self.told = frame.record;
        }
        if self.wishes.report {
            self.says.push_back(Outgoing::Text(frame.report));
        }
        self.says.push_back(Outgoing::Frame(frame.seq, frame.pieces));
        self.app.metrics().frames_sent.inc();
    }

    /// Goes on with what is being made; never ends when that is nothing. May be dropped and called again.
    pub async fn work(&mut self) {
        let Some(making) = &mut self.making else { return pending().await };
        let made = making.await;
        self.making = None;
        let now = Instant::now();
        match made {
            Ok(frame) => {
                if !same(&self.known, &frame.record) {
                    self.known = Arc::clone(&frame.record);
                    self.desk.resize(pace(self.wishes, &self.known), full(self.wishes, &self.known));
                }
                self.desk.made(frame, now);
            }
            Err(problem) if problem.code == Code::Overloaded => self.desk.refused(now),
            Err(problem) => {
                let order = self.desk.failed();
                self.is_over = matches!(problem.code, Code::NoSuchSession | Code::SessionExpired);
                // The pose of a frame that is made again was good; what has changed since is told when the hand moves.
                if let Some(order) = order.filter(|order| self.is_over || !order.is_full_quality) {
                    self.complain(Some(order.pose.seq), &problem);
                }
            }
        }
    }

    /// Looks whether the session is still there. A store that does not answer, or not this version of the program, has not said that it is not.
    pub async fn check_session(&mut self) {
        if let Err(problem) = self.app.session(self.id).await
            && problem.code.status() != 503
        {
            self.is_over = true;
            self.complain(None, &problem);
        }
    }

    /// The next thing to send.
    pub fn next_outgoing(&mut self) -> Option<Outgoing> {
        self.says.pop_front()
    }

    /// The session has ended; nothing will come but what is to be said.
    #[must_use]
    pub const fn is_over(&self) -> bool {
        self.is_over
    }

    /// Ends what is being made.
    pub fn stop(&mut self) {
        self.making = None;
    }

    /// The session as the newest frame knows it.
    #[must_use]
    pub fn record(&self) -> &Record {
        &self.known
    }

    /// Since when the client has owed an acknowledgement.
    #[must_use]
    pub fn owed_since(&self) -> Option<Instant> {
        self.desk.owed_since()
    }
}

/// Whether frames of the one fit the other.
fn same(a: &Record, b: &Record) -> bool {
    a.revision == b.revision
}
