//! The walk of one request through the warp: file and handles to all that a picture is made of. CPU work runs on the pool, under one ticket a
//! request; a warm drag is handed over once, to be posed and drawn (`picture`).

use std::future::Future;
use std::sync::Arc;
use std::sync::atomic::Ordering;
use std::time::{Duration, Instant, SystemTime};

use bytes::Bytes;

use super::client::Client;
use super::formats::Formats;
use super::picture::{Drawn, Sitting};
use super::pool::{Cancel, PoolError, Ticket};
use super::problem::{Code, Problem};
use super::session::{Place, Revision, SessionId};
use super::store::{Put, Record, Session};
use super::wire::{DragObject, MeshObject, MeshShape, PointsObject, WarpObject, WarpPatch, Wire};
use super::{App, Known};
use crate::codec::{CodecError, Format};
use crate::deform::Handle;
use crate::geometry::Point;
use crate::pixmap::Extent;
use crate::warp::{Digest, Folds, GridSpec, Image, Limits, OutputSpec, Plan, Posed, Report, Setup, WarpError};

/// Places mapped between two looks at whether the client is still there.
const PLACES_PER_STEP: usize = 4096;

/// Places that are mapped sooner than other threads wake.
const PLACES_ALONE: usize = 256;

/// Vertices that are written as JSON, some 40 bytes each.
const JSON_VERTICES: u64 = 1 << 20;

/// Wall time of the steps before drawing.
#[derive(Clone, Copy, Debug, Default)]
pub struct Timing {
    /// Waiting for a worker.
    pub queue: Duration,
    /// Digest and decoding of the file, or waiting for who does.
    pub decode: Duration,
    /// The table of coefficients, or waiting for who fills it.
    pub plan: Duration,
    /// Posing the grid.
    pub deform: Duration,
}

/// What a warp is made of, and what a session keeps.
#[derive(Debug)]
pub struct Material {
    file: Bytes,
    digest: Digest,
    object: WarpObject,
    /// Of this picture; a session keeps what was asked for.
    format: Format,
    image: Arc<Image>,
    setup: Arc<Setup>,
}

impl Material {
    /// As a session keeps it: the record, the file, and what they resolve to.
    fn recorded(self, id: SessionId) -> (Arc<Record>, Bytes, Arc<Setup>) {
        let Self { file, digest, object, image, setup, .. } = self;
        let record = Record {
            id,
            revision: Revision::random(),
            image: digest,
            extent: image.extent(),
            rest: object.rest,
            folds: object.folds,
            output: object.output,
            created: SystemTime::now(),
        };
        (Arc::new(record), file, setup)
    }
}

/// A step of a drag that holds its place while it waits.
struct Turn {
    record: Arc<Record>,
    place: Option<(Place, u64)>,
}

/// What a mesh is posed with.
pub(super) struct Walked {
    setup: Arc<Setup>,
    plan: Arc<Plan>,
    timing: Timing,
    plan_built: bool,
}

/// What a picture is drawn with, and the right to draw it.
pub(super) struct Warm {
    ticket: Ticket,
    image: Arc<Image>,
    walked: Walked,
}

impl Walked {
    /// The grid over its picture.
    pub(super) fn shape(&self, extent: Extent) -> MeshShape {
        MeshShape::new(&self.setup, extent)
    }
}

impl Warm {
    /// The grid over its picture.
    pub(super) fn shape(&self, extent: Extent) -> MeshShape {
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

    fn write(self, posed: &Posed, shape: MeshShape) -> Vec<u8> {
        match self {
            Self::Json => serde_json::to_vec(&MeshObject { shape, vertices: Wire(posed) }).expect("an object of numbers"),
            Self::Numbers => posed.numbers(),
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
    pub body: Vec<u8>,
}

impl App {
    /// A picture from a file and a warp object with `q`.
    ///
    /// # Errors
    /// Whatever is wrong with either, or no room.
    pub async fn warp_once(&self, file: Bytes, json: Bytes, formats: Formats) -> Result<(Drawn, Material), Problem> {
        let ticket = self.0.pool.admit().await?;
        let (material, plan, timing, plan_built) = self.prepare(&ticket, file, json, Some(formats)).await?;
        let q = material.object.q.clone().unwrap_or_default();
        let (folds, output) = (material.object.folds, OutputSpec { format: material.format, ..material.object.output });
        let (image, setup) = (Arc::clone(&material.image), Arc::clone(&material.setup));
        let drawn = self.draw(ticket, Sitting { image, setup, plan, q, folds, output }, timing, plan_built).await?;
        Ok((drawn, material))
    }

    /// A session from a file and a warp object; `q` is checked when it is there. Picture and plan are made before the answer.
    ///
    /// # Errors
    /// Whatever is wrong with either, or no room.
    pub async fn open(&self, client: Client, file: Bytes, json: Bytes) -> Result<(Session, Arc<Setup>), Problem> {
        let ticket = self.0.pool.admit().await?;
        let (material, ..) = self.prepare(&ticket, file, json, None).await?;
        self.keep(client, material).await
    }

    /// Makes a session of what was warped.
    ///
    /// # Errors
    /// No room.
    pub async fn keep(&self, client: Client, material: Material) -> Result<(Session, Arc<Setup>), Problem> {
        let (record, file, setup) = material.recorded(SessionId::random(client.owner));
        let (Put::Created(session) | Put::Same(session) | Put::Replaced(session, _)) = self.0.store.put(record, file).await?;
        self.know(&session.record, &setup).await?;
        Ok((session, setup))
    }

    /// A session of a name that the client has chosen, from a file and a warp object, or that session made anew.
    ///
    /// # Errors
    /// Whatever is wrong with either, or no room.
    pub async fn put(&self, id: SessionId, file: Bytes, json: Bytes) -> Result<(Put, Arc<Setup>), Problem> {
        let ticket = self.0.pool.admit().await?;
        let (material, ..) = self.prepare(&ticket, file, json, None).await?;
        let (record, file, setup) = material.recorded(id);
        let put = self.0.store.put(record, file).await?;
        match &put {
            Put::Created(session) | Put::Same(session) => self.know(&session.record, &setup).await?,
            Put::Replaced(session, old) => {
                self.know(&session.record, &setup).await?;
                self.forget(old).await;
            }
        }
        Ok((put, setup))
    }

    /// Other handles at rest on the same picture: the fields that `json` gives replace the session's. The plan is made before the answer.
    ///
    /// # Errors
    /// Unknown session, whatever is wrong with the handles, or no room.
    pub async fn revise(&self, id: SessionId, json: Bytes) -> Result<(Session, Arc<Setup>), Problem> {
        let ticket = self.0.pool.admit().await?;
        let patch = self.0.pool.run(&ticket, move |_| WarpPatch::parse(&json)).await??;
        loop {
            let old = self.0.store.touch(id, None).await?.record;
            let base = WarpObject { rest: old.rest.clone(), q: None, folds: old.folds, output: old.output };
            let (patch, limits, extent) = (patch.clone(), self.0.config.limits, old.extent);
            let resolve = move |_: &_| resolve(patch.over(base), extent, &limits);
            let (object, setup) = self.0.pool.run(&ticket, resolve).await??;
            self.plan(&ticket, &setup, &mut Timing::default()).await?;
            let WarpObject { rest, folds, output, .. } = object;
            let new = Record { revision: Revision::random(), rest, folds, output, ..(*old).clone() };
            // Whoever was faster has changed fields that this request may not have named: they are kept.
            if let Some(session) = self.0.store.revise(old.revision, Arc::new(new)).await? {
                self.know(&session.record, &setup).await?;
                self.0.setups.remove(shelf_key(&old)).await;
                return Ok((session, setup));
            }
        }
    }

    /// The setup of a record is at hand.
    async fn know(&self, record: &Record, setup: &Arc<Setup>) -> Result<(), Problem> {
        let known = Known { setup: Arc::clone(setup), bytes: weight(record) };
        self.0.setups.get(shelf_key(record), async { Ok::<_, Problem>(known) }, lost).await?;
        Ok(())
    }

    /// Drops what was made for a record that is no session's any more.
    async fn forget(&self, record: &Record) {
        let setup = self.0.setups.remove(shelf_key(record)).await;
        // The picture goes with the last session that names it, and the coefficients with it; another picture's session of the same size
        // and handles, if there is one, builds them again.
        if !self.0.store.names(record.image) {
            self.0.images.remove(record.image).await;
            if let Some(known) = setup {
                self.0.plans.remove(known.setup.plan_key()).await;
            }
        }
    }

    /// The session, without using it.
    ///
    /// # Errors
    /// Unknown or expired.
    pub async fn session(&self, id: SessionId) -> Result<Session, Problem> {
        Ok(self.0.store.peek(id).await?)
    }

    /// The session's resolved setup.
    ///
    /// # Errors
    /// No room.
    pub async fn session_setup(&self, record: &Arc<Record>) -> Result<Arc<Setup>, Problem> {
        let (app, theirs) = (self.clone(), Arc::clone(record));
        let build = async move {
            let ticket = app.0.pool.admit().await?;
            let bytes = weight(&theirs);
            let limits = app.0.config.limits;
            let setup = app.0.pool.run(&ticket, move |_| Setup::new(&theirs.rest, theirs.extent, &limits)).await??;
            Ok(Known { setup: Arc::new(setup), bytes })
        };
        let known = self.0.setups.get(shelf_key(record), build, lost).await?;
        Ok(Arc::clone(&known.value.setup))
    }

    /// Ends the session.
    ///
    /// # Errors
    /// Unknown or expired.
    pub async fn close(&self, id: SessionId) -> Result<(), Problem> {
        let record = self.0.store.peek(id).await?.record;
        self.0.store.delete(id).await?;
        self.forget(&record).await;
        Ok(())
    }

    /// One step of a drag: q alone.
    ///
    /// # Errors
    /// Unknown session, superseded, whatever is wrong with q, or no room.
    pub async fn drag(&self, id: SessionId, drag: DragObject, formats: Formats) -> Result<Drawn, Problem> {
        let turn = self.turn(id, drag.seq).await?;
        let (record, warm) = self.unless_superseded(&turn, self.warm_newest(Arc::clone(&turn.record))).await?;
        let format = formats.choose(drag.output.format, record.output.format)?;
        let output = OutputSpec { format, ..drag.output.over(&record.output) };
        self.draw_warm(warm, drag.q, record.folds, output).await
    }

    /// The posed grid of a step of a drag; no picture is decoded or drawn.
    ///
    /// # Errors
    /// Unknown session, superseded, whatever is wrong with q, too many vertices for JSON, or no room.
    pub async fn mesh(&self, id: SessionId, drag: DragObject, form: MeshForm) -> Result<PosedMesh, Problem> {
        let turn = self.turn(id, drag.seq).await?;
        let record = Arc::clone(&turn.record);
        let (ticket, walked) = self.unless_superseded(&turn, self.walk(&record, form)).await?;
        self.pose_walked(ticket, walked, drag.q, &record, form).await
    }

    /// All that a picture of the session is made of, under a ticket. Where the session was made anew while this waited, its old file is gone: then of
    /// the session as it is now.
    pub(super) async fn warm_newest(&self, mut record: Arc<Record>) -> Result<(Arc<Record>, Warm), Problem> {
        loop {
            match self.warm(&record).await {
                Ok(warm) => return Ok((record, warm)),
                Err(problem) if problem.code == Code::NoSuchSession => {
                    let newest = self.0.store.peek(record.id).await?.record;
                    if newest.revision == record.revision {
                        return Err(problem);
                    }
                    record = newest;
                }
                Err(problem) => return Err(problem),
            }
        }
    }

    async fn warm(&self, record: &Arc<Record>) -> Result<Warm, Problem> {
        let setup = self.session_setup(record).await?;
        let ticket = self.0.pool.admit().await?;
        let mut timing = Timing { queue: ticket.waited(), ..Timing::default() };
        let began = Instant::now();
        let image = self.session_image(&ticket, record).await?;
        timing.decode = began.elapsed();
        let (plan, plan_built) = self.plan(&ticket, &setup, &mut timing).await?;
        Ok(Warm { ticket, image, walked: Walked { setup, plan, timing, plan_built } })
    }

    /// Poses and draws.
    pub(super) async fn draw_warm(&self, warm: Warm, q: Vec<Handle>, folds: Folds, output: OutputSpec) -> Result<Drawn, Problem> {
        let Warm { ticket, image, walked: Walked { setup, plan, timing, plan_built } } = warm;
        self.draw(ticket, Sitting { image, setup, plan, q, folds, output }, timing, plan_built).await
    }

    /// All that a mesh of the session is made of, under a ticket.
    pub(super) async fn walk(&self, record: &Arc<Record>, form: MeshForm) -> Result<(Ticket, Walked), Problem> {
        let setup = self.session_setup(record).await?;
        form.bounded(setup.grid())?;
        let ticket = self.0.pool.admit().await?;
        let mut timing = Timing { queue: ticket.waited(), ..Timing::default() };
        let (plan, plan_built) = self.plan(&ticket, &setup, &mut timing).await?;
        Ok((ticket, Walked { setup, plan, timing, plan_built }))
    }

    /// Poses the grid and writes it.
    pub(super) async fn pose_walked(
        &self,
        ticket: Ticket,
        walked: Walked,
        q: Vec<Handle>,
        record: &Record,
        form: MeshForm,
    ) -> Result<PosedMesh, Problem> {
        let pool = self.0.pool.clone();
        let (folds, extent) = (record.folds, record.extent);
        let pose = move |cancel: &Cancel| {
            let Walked { setup, plan, mut timing, plan_built } = walked;
            let began = Instant::now();
            let gone = || cancel.is_cancelled();
            let pose = || Posed::new(&setup, &plan, &setup.pose(&q)?, folds, &gone);
            let posed = if setup.is_wide() { pool.spread(pose) } else { pose() }?;
            timing.deform = began.elapsed();
            let body = form.write(&posed, MeshShape::new(&setup, extent));
            Ok::<_, WarpError>(PosedMesh { report: posed.into_report(), timing, plan_built, body })
        };
        Ok(self.0.pool.run(&ticket, pose).await??)
    }

    /// Uses the session, and takes the request's place among those that are numbered.
    async fn turn(&self, id: SessionId, seq: Option<u64>) -> Result<Turn, Problem> {
        let Session { record, seq: newest, .. } = self.0.store.touch(id, seq).await?;
        match seq {
            Some(seq) if newest > Some(seq) => Err(self.superseded(seq)),
            Some(seq) => {
                let place = self.0.lanes.enter((id, record.created), seq);
                Ok(Turn { record, place: Some((place, seq)) })
            }
            None => Ok(Turn { record, place: None }),
        }
    }

    /// Gives up `work` when a newer request of the same session arrives.
    async fn unless_superseded<T>(&self, turn: &Turn, work: impl Future<Output = Result<T, Problem>>) -> Result<T, Problem> {
        match &turn.place {
            None => work.await,
            Some((place, seq)) => tokio::select! {
                biased;
                () = place.superseded() => Err(self.superseded(*seq)),
                worked = work => worked,
            },
        }
    }

    fn superseded(&self, seq: u64) -> Problem {
        self.0.pictures.superseded.fetch_add(1, Ordering::Relaxed);
        Problem::new(Code::Superseded, format!("a newer pose than seq {seq} has been seen")).pointer("/seq")
    }

    /// Maps places by f exactly.
    ///
    /// # Errors
    /// Whatever is wrong with the handles, or no room.
    pub async fn map_once(&self, json: Bytes) -> Result<Vec<Point>, Problem> {
        let ticket = self.0.pool.admit().await?;
        let object = self.0.pool.run(&ticket, move |_| PointsObject::parse(&json)).await??;
        let (mut rest, extent) = object.warp.ok_or_else(|| Problem::new(Code::Internal, "points without a warp"))?;
        // Places are mapped by the exact function: the grid, and its limits, do not matter.
        rest.grid = GridSpec::Counts { columns: 2, rows: 2 };
        let limits = self.0.config.limits;
        let setup = self.0.pool.run(&ticket, move |_| Setup::new(&rest, extent, &limits)).await??;
        self.map(&ticket, Arc::new(setup), object.q, object.points).await
    }

    /// Maps places by f of a session.
    ///
    /// # Errors
    /// Unknown session, whatever is wrong with the handles, or no room.
    pub async fn map_session(&self, id: SessionId, json: Bytes) -> Result<Vec<Point>, Problem> {
        let session = self.0.store.touch(id, None).await?;
        let setup = self.session_setup(&session.record).await?;
        let ticket = self.0.pool.admit().await?;
        let object = self.0.pool.run(&ticket, move |_| PointsObject::parse_posed(&json)).await??;
        self.map(&ticket, setup, object.q, object.points).await
    }

    async fn map(&self, ticket: &Ticket, setup: Arc<Setup>, q: Vec<Handle>, places: Vec<Point>) -> Result<Vec<Point>, Problem> {
        let pool = self.0.pool.clone();
        let mapped = self.0.pool.run(ticket, move |cancel| {
            let pose = setup.pose(&q)?;
            let mut mapped = Vec::with_capacity(places.len());
            for (k, step) in places.chunks(PLACES_PER_STEP).enumerate() {
                if cancel.is_cancelled() {
                    return Err(WarpError::GivenUp);
                }
                let map = || setup.map(&pose, step);
                let step = if step.len() > PLACES_ALONE { pool.spread(map) } else { map() };
                mapped.extend(step.map_err(|e| e.with_place_offset(k * PLACES_PER_STEP))?);
            }
            Ok::<_, WarpError>(mapped)
        });
        Ok(mapped.await??)
    }

    /// Reads the object, decodes the file, resolves the handles, checks q, fills the table. `draws`: what a picture may be written as, and that q is
    /// needed for it.
    async fn prepare(
        &self,
        ticket: &Ticket,
        file: Bytes,
        json: Bytes,
        draws: Option<Formats>,
    ) -> Result<(Material, Arc<Plan>, Timing, bool), Problem> {
        let mut timing = Timing { queue: ticket.waited(), ..Timing::default() };
        let began = Instant::now();
        let read = {
            let file = file.clone();
            move |_: &_| {
                let patch = WarpPatch::parse(&json)?;
                let asked = patch.output.format;
                let object = patch.over(WarpObject::default());
                let format = draws.unwrap_or(Formats::ANY).choose(asked, object.output.format)?;
                Ok::<_, Problem>((object, format, Image::digest_of(&file)))
            }
        };
        let (object, format, digest) = self.0.pool.run(ticket, read).await??;
        if draws.is_some() && object.q.is_none() && !object.rest.p.is_empty() {
            return Err(q_is_missing());
        }
        let image = self.image(ticket, digest, file.clone()).await?;
        timing.decode = began.elapsed();
        let (limits, extent) = (self.0.config.limits, image.extent());
        let (object, setup) = self.0.pool.run(ticket, move |_| resolve(object, extent, &limits)).await??;
        let (plan, plan_built) = self.plan(ticket, &setup, &mut timing).await?;
        Ok((Material { file, digest, object, format, image, setup }, plan, timing, plan_built))
    }

    async fn image(&self, ticket: &Ticket, digest: Digest, file: Bytes) -> Result<Arc<Image>, Problem> {
        let (pool, ticket, limits) = (self.0.pool.clone(), ticket.clone(), self.0.config.limits.image);
        let decode = async move {
            match pool.run(&ticket, move |_| Image::decode_as(digest, &file, &limits)).await {
                // Decoders are known to panic on hostile files: the file is at fault, not the request's other parts.
                Err(PoolError::Panicked) => {
                    Err(WarpError::Codec(CodecError::Bad { format: "image", detail: "its decoder gave up".to_owned() }).into())
                }
                Err(error) => Err(error.into()),
                Ok(decoded) => decoded.map_err(Problem::from),
            }
        };
        Ok(self.0.images.get(digest, decode, lost).await?.value)
    }

    /// The session's picture; decoded again from the stored file when the cache has dropped it.
    async fn session_image(&self, ticket: &Ticket, record: &Record) -> Result<Arc<Image>, Problem> {
        match self.0.images.peek(record.image).await {
            Some(image) => Ok(image),
            None => {
                let file = self.0.store.image(record.id, record.image).await?;
                self.image(ticket, record.image, file).await
            }
        }
    }

    async fn plan(&self, ticket: &Ticket, setup: &Arc<Setup>, timing: &mut Timing) -> Result<(Arc<Plan>, bool), Problem> {
        let began = Instant::now();
        let (pool, ticket, theirs) = (self.0.pool.clone(), ticket.clone(), Arc::clone(setup));
        let threads = pool.clone();
        let build = async move { pool.run(&ticket, move |_| threads.spread(|| theirs.plan())).await.map_err(Problem::from) };
        let fetched = self.0.plans.get(setup.plan_key(), build, lost).await?;
        timing.plan = began.elapsed();
        Ok((fetched.value, fetched.built))
    }
}

/// A warp of handles needs to know where they go.
pub(super) fn q_is_missing() -> Problem {
    Problem::new(Code::BadValue, "q is missing: where do the handles go?").pointer("/q")
}

/// The task that built a cached value was torn down: the runtime is stopping.
fn lost() -> Problem {
    PoolError::Panicked.into()
}

/// The setup of the handles on a picture of that size; q is checked when it is there.
fn resolve(object: WarpObject, extent: Extent, limits: &Limits) -> Result<(WarpObject, Arc<Setup>), WarpError> {
    let setup = Setup::new(&object.rest, extent, limits)?;
    object.q.as_deref().map(|q| setup.pose(q)).transpose()?;
    Ok((object, Arc::new(setup)))
}

/// Records never change, so name and revision stand for the setup.
fn shelf_key(record: &Record) -> Digest {
    Digest::of(&[&record.id.to_bytes()[..], record.revision.as_bytes()].concat())
}

/// Columns of a session's plan: what its drags may send follows from it.
#[must_use]
pub fn columns(record: &Record) -> u64 {
    record.rest.p.iter().map(|h| h.columns() as u64).sum()
}

/// About what a setup holds: a few copies of each column's place and weight.
fn weight(record: &Record) -> u64 {
    1024 + 256 * columns(record)
}
