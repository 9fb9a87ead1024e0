//! Steps of a drag: q alone, to a picture or to a posed grid. Where picture, setup and table are at hand a step goes through the drags' gate;
//! where they must be made again it waits with the uploads.

use std::future::Future;
use std::sync::Arc;
use std::time::Instant;

use bytes::Bytes;
use mlswarp::deform::Handle;
use mlswarp::pixmap::Extent;
use mlswarp::warp::{Folds, Image, OutputSpec, Plan, Posed, Report, Setup, WarpError};

use super::App;
use super::draw::{DrawJob, Drawn};
use super::warp::{ATTEMPTS, Source, json_unless};
use crate::app::sequence::SequencePosition;
use crate::cache::{CacheEntry, Key};
use crate::client::Client;
use crate::limits::client_quota::Share;
use crate::limits::memory::Purpose;
use crate::observe::scope::{in_stage, stage};
use crate::observe::stages::Timing;
use crate::pool::{Cancel, QueueKey, Ticket, WorkClass};
use crate::problem::{Code, Problem};
use crate::session::SessionId;
use crate::store::{Record, Session, StoreError};
use crate::wire::formats::Formats;
use crate::wire::{AsJson, DragObject, MeshObject, MeshShape};

/// Vertices that are written as JSON, some 40 bytes each.
const JSON_VERTICES: u64 = 1 << 20;

/// A step of a drag that holds its place while it waits.
struct SequencedRequest {
    record: Arc<Record>,
    place: Option<(SequencePosition, u64)>,
}

/// What a mesh is posed with.
pub(crate) struct Walked {
    setup: Arc<Setup>,
    plan: Arc<CacheEntry<Plan>>,
    timing: Timing,
    plan_built: bool,
}

/// What a picture is drawn with, and the right to draw it.
pub(crate) struct Warm {
    ticket: Ticket,
    image: Arc<CacheEntry<Image>>,
    walked: Walked,
}

impl Walked {
    /// The grid over its picture.
    pub(crate) fn shape(&self, extent: Extent) -> MeshShape {
        MeshShape::new(&self.setup, extent)
    }
}

impl Warm {
    /// The right to compute.
    pub(crate) const fn ticket(&self) -> &Ticket {
        &self.ticket
    }

    /// The grid over its picture.
    pub(crate) fn shape(&self, extent: Extent) -> MeshShape {
        self.walked.shape(extent)
    }
}

/// How a mesh is written.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum MeshForm {
    /// A JSON object.
    Json,
    /// Little-endian f32.
    Numbers,
}

impl MeshForm {
    /// Refuses before memory is taken.
    fn bounded(self, (columns, rows): (u32, u32)) -> Result<(), Problem> {
        let vertices = u64::from(columns) * u64::from(rows);
        if self == Self::Json && vertices > JSON_VERTICES {
            let detail = format!("a mesh of {vertices} vertices is not written as JSON; ask for application/octet-stream");
            return Err(Problem::new(Code::TooLarge, detail).limit("mesh_json_vertices", JSON_VERTICES, vertices));
        }
        Ok(())
    }

    fn write(self, posed: &Posed, shape: MeshShape, cancel: &Cancel) -> Result<Vec<u8>, WarpError> {
        match self {
            Self::Json => json_unless(cancel, &MeshObject { shape, vertices: AsJson(posed) }, 0),
            Self::Numbers => posed.numbers(&|| cancel.is_cancelled()),
        }
    }
}

/// A posed grid as its client gets it.
#[derive(Debug)]
pub struct PosedMesh {
    /// What to tell.
    pub report: Report,
    /// What it cost.
    pub timing: Timing,
    /// The coefficients were built for this request, not found.
    pub plan_built: bool,
    /// The vertices.
    pub body: Bytes,
}

impl App {
    /// One step of a drag: q alone.
    ///
    /// # Errors
    /// Unknown session, superseded, whatever is wrong with q, or no room.
    pub async fn drag(&self, client: Client, id: SessionId, drag: DragObject, formats: Formats) -> Result<Drawn, Problem> {
        let turn = self.turn(id, drag.seq).await?;
        let (record, warm) = self.unless_superseded(&turn, self.warm_newest(client, Arc::clone(&turn.record))).await?;
        let format = formats.choose(drag.output.format, record.output.format)?;
        let output = OutputSpec { format, ..drag.output.merge_onto(&record.output) };
        self.draw_warm(warm, drag.q, record.folds, output, self.share(client)).await
    }

    /// The posed grid of a step of a drag; no picture is decoded or drawn.
    ///
    /// # Errors
    /// Unknown session, superseded, whatever is wrong with q, too many vertices for JSON, or no room.
    pub async fn mesh(&self, client: Client, id: SessionId, drag: DragObject, form: MeshForm) -> Result<PosedMesh, Problem> {
        let turn = self.turn(id, drag.seq).await?;
        let record = Arc::clone(&turn.record);
        let (ticket, walked) = self.unless_superseded(&turn, self.walk(client, &record, form)).await?;
        self.pose_walked(ticket, walked, drag.q, &record, form, self.share(client)).await
    }

    /// All that a picture of the session is made of, under a ticket. Where the session was made anew while this waited, its old file is gone: then of
    /// the session as it is now.
    pub(crate) async fn warm_newest(&self, client: Client, mut record: Arc<Record>) -> Result<(Arc<Record>, Warm), Problem> {
        for _ in 0..ATTEMPTS {
            match self.warm(client, &record).await {
                Ok(warm) => return Ok((record, warm)),
                Err(problem) if problem.code == Code::NoSuchSession => {
                    let newest = in_stage("store", self.0.store.peek(record.id)).await?.record;
                    if newest.revision == record.revision {
                        return Err(problem);
                    }
                    record = newest;
                }
                Err(problem) => return Err(problem),
            }
        }
        Err(StoreError::Contended.into())
    }

    async fn warm(&self, client: Client, record: &Arc<Record>) -> Result<Warm, Problem> {
        let setup = self.session_setup(client, record).await?;
        let source = self.session_source(client, record).await?;
        let is_warm = matches!(source, Source::Image(_))
            && self.0.plans.touch(Key::new(record.id.owner(), setup.plan_key()))
            && setup.plan_bytes().is_some();
        let ticket =
            self.0.pool.admit(if is_warm { WorkClass::Drag } else { WorkClass::Upload }, QueueKey::session(client, record.id)).await?;
        let mut timing = Timing { queue: ticket.waited(), ..Timing::default() };
        let began = Instant::now();
        let image = self.session_image(&ticket, record, source).await?;
        timing.decode = began.elapsed();
        stage("decode", began);
        let (plan, plan_built) = self.plan(record.id.owner(), &ticket, &setup, &mut timing).await?;
        Ok(Warm { ticket, image, walked: Walked { setup, plan, timing, plan_built } })
    }

    /// Poses and draws.
    pub(crate) async fn draw_warm(
        &self,
        warm: Warm,
        q: Vec<Handle>,
        folds: Folds,
        output: OutputSpec,
        share: Share,
    ) -> Result<Drawn, Problem> {
        let Warm { ticket, image, walked: Walked { setup, plan, timing, plan_built } } = warm;
        self.draw(ticket, DrawJob { image, setup, plan, q, folds, output, share }, timing, plan_built).await
    }

    /// All that a mesh of the session is made of, under a ticket.
    pub(crate) async fn walk(&self, client: Client, record: &Arc<Record>, form: MeshForm) -> Result<(Ticket, Walked), Problem> {
        let setup = self.session_setup(client, record).await?;
        form.bounded(setup.grid())?;
        let is_warm = self.0.plans.touch(Key::new(record.id.owner(), setup.plan_key())) && setup.plan_bytes().is_some();
        let ticket =
            self.0.pool.admit(if is_warm { WorkClass::Drag } else { WorkClass::Upload }, QueueKey::session(client, record.id)).await?;
        let mut timing = Timing { queue: ticket.waited(), ..Timing::default() };
        let (plan, plan_built) = self.plan(record.id.owner(), &ticket, &setup, &mut timing).await?;
        Ok((ticket, Walked { setup, plan, timing, plan_built }))
    }

    /// Poses the grid and writes it.
    pub(crate) async fn pose_walked(
        &self,
        ticket: Ticket,
        walked: Walked,
        q: Vec<Handle>,
        record: &Record,
        form: MeshForm,
        share: Share,
    ) -> Result<PosedMesh, Problem> {
        let app = self.clone();
        let (folds, extent) = (record.folds, record.extent);
        let pose = move |cancel: &Cancel| {
            let Walked { setup, plan, mut timing, plan_built } = walked;
            let began = Instant::now();
            let gone = || cancel.is_cancelled();
            let mut held = app.reserve_for(Purpose::Frame, &share, setup.posed_bytes())?;
            let pose = || Posed::new(&setup, &plan, &setup.pose(&q)?, folds, &gone);
            let posed = if setup.is_wide() { app.0.pool.run_parallel(pose) } else { pose() }?;
            timing.deform = began.elapsed();
            stage("deform", began);
            app.metrics().prepared(&timing);
            let body = form.write(&posed, MeshShape::new(&setup, extent), cancel)?;
            held.shrink_to(body.len() as u64);
            let body = held.attach(body);
            Ok::<_, Problem>(PosedMesh { report: posed.into_report(), timing, plan_built, body })
        };
        self.0.pool.run(&ticket, pose).await?
    }

    /// Uses the session, and takes the request's place among those that are numbered.
    async fn turn(&self, id: SessionId, seq: Option<u64>) -> Result<SequencedRequest, Problem> {
        let Session { record, seq: newest, .. } = self.touch(id, seq).await?;
        match seq {
            Some(seq) if newest > Some(seq) => Err(self.superseded(seq)),
            Some(seq) => {
                let place = self.0.sequencer.enter((id, record.created), seq);
                Ok(SequencedRequest { record, place: Some((place, seq)) })
            }
            None => Ok(SequencedRequest { record, place: None }),
        }
    }

    /// Gives up `work` when a newer request of the same session arrives.
    async fn unless_superseded<T>(&self, turn: &SequencedRequest, work: impl Future<Output = Result<T, Problem>>) -> Result<T, Problem> {
        match &turn.place {
            None => work.await,
            Some((place, seq)) => tokio::select! {
                biased;
                () = place.superseded() => Err(self.superseded(*seq)),
                // The newer request needs what was being built for this one.
                worked = place.builds().during(work) => worked,
            },
        }
    }

    fn superseded(&self, seq: u64) -> Problem {
        self.0.metrics.requests_superseded.inc();
        Problem::new(Code::Superseded, format!("a newer pose than seq {seq} has been seen")).pointer("/seq").actual(seq)
    }
}
