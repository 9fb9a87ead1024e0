//! `POST /sessions/{id}/warp` and `/mesh`: new positions of the handles, drawn or returned as a
//! posed grid. A request whose image, setup and plan are cached is of the class drag, others of the
//! class upload.

use std::future::Future;
use std::sync::Arc;
use std::time::Instant;

use bytes::Bytes;
use mlswarp::deform::Handle;
use mlswarp::pixmap::Extent;
use mlswarp::warp::{
    Align, CompactLattice, OutputSpec, PosedMesh, Report, ResolvedRest, WarpError,
};

use super::App;
use super::draw::{DrawJob, Drawn, Planned};
use super::drawable::DrawnContent;
use super::json_text::json_unless;
use super::reading::Held;
use super::sequence::SequencePosition;
use super::warp::{SESSION_ATTEMPTS, columns};
use crate::cache::CacheKey;
use crate::client::Client;
use crate::layer::LayerRef;
use crate::limits::client_quota::ClientQuota;
use crate::limits::memory::MemoryClass;
use crate::observe::scope::stage;
use crate::observe::stages::Timing;
use crate::pool::{Cancel, QueueKey, Ticket, WorkClass};
use crate::problem::{Code, Problem};
use crate::session::SessionId;
use crate::store::{Record, Session, StoreError};
use crate::wire::formats::Formats;
use crate::wire::{AsJson, DragObject, MeshObject, MeshShape, Pose, Reserved};

/// Maximum number of vertices of a mesh as JSON, which takes some 40 bytes per vertex.
const MAX_JSON_VERTICES: u64 = 1 << 20;

/// Columns up to which aligning handles is faster than waking a compute thread.
pub(crate) const MOST_POSED_HERE: u64 = 64;
/// Size of a text up to which parsing it is faster than waking a compute thread, bytes.
pub(crate) const MAX_INLINE: usize = 4 << 10;

/// What a drag is for.
#[derive(Clone, Copy, Debug)]
pub(crate) enum DragRoute {
    Picture,
    Mesh,
}

/// A request for a session, with its position among the numbered ones.
struct SequencedRequest {
    record: Arc<Record>,
    position: Option<(SequencePosition, u64)>,
}

/// A plan, and the ticket to use it.
pub(crate) struct AdmittedPlan {
    pub(crate) ticket: Ticket,
    pub(crate) planned: Planned,
}

impl AdmittedPlan {
    /// The shape of the grid on an image of this extent.
    pub(crate) fn shape(&self, extent: Extent) -> MeshShape {
        MeshShape::new(&self.planned.setup, extent)
    }
}

/// The encoding of a mesh.
#[derive(Clone, Debug, PartialEq)]
pub enum MeshForm {
    /// A JSON object.
    Json,
    /// Little-endian f32.
    F32,
    /// 16-bit displacements on a part of the lines.
    Compact(Arc<CompactLattice>),
}

impl MeshForm {
    /// Rejects a mesh that is too large for its encoding, before memory is reserved.
    fn check_size(&self, (columns, rows): (u32, u32)) -> Result<(), Problem> {
        let vertices = u64::from(columns) * u64::from(rows);
        if *self == Self::Json && vertices > MAX_JSON_VERTICES {
            let detail = format!(
                "a mesh of {vertices} vertices is too large for JSON; send `Accept: \
                    application/octet-stream`"
            );
            return Err(Problem::new(Code::TooLarge, detail).limit(
                "mesh_json_vertices",
                MAX_JSON_VERTICES,
                vertices,
            ));
        }
        Ok(())
    }

    /// The mesh, and the error of a compact one.
    fn write(
        &self,
        posed: &PosedMesh,
        shape: MeshShape,
        cancel: &Cancel,
    ) -> Result<(Vec<u8>, Option<f64>), WarpError> {
        let cancelled = || cancel.is_cancelled();
        match self {
            Self::Json => Ok((
                json_unless(
                    cancel,
                    &MeshObject {
                        shape,
                        vertices: AsJson(posed),
                    },
                    0,
                )?,
                None,
            )),
            Self::F32 => Ok((posed.to_le_bytes(&cancelled)?, None)),
            Self::Compact(lattice) => lattice
                .to_le_bytes(posed, &cancelled)
                .map(|(bytes, error)| (bytes, Some(error))),
        }
    }
}

/// An encoded posed grid.
#[derive(Debug)]
pub struct SessionMesh {
    /// Warnings and measures for the head of the response.
    pub report: Report,
    /// Cost.
    pub timing: Timing,
    /// Whether the plan was built for this request.
    pub plan_built: bool,
    /// The vertices.
    pub body: Bytes,
    /// The largest distance between a compact mesh and the full one, px.
    pub error: Option<f64>,
}

impl App {
    /// Reads the body of a drag: here if it is short, otherwise on a compute thread. `record`: that
    /// of the session, whose number of handles is not exceeded. Errors: A wrong object, or too
    /// little capacity.
    pub(crate) async fn read_drag(
        &self,
        client: Client,
        record: &Record,
        json: Bytes,
        route: DragRoute,
    ) -> Result<Held<DragObject>, Problem> {
        let (at_rest, reserve) = (
            record.rest.p.len(),
            self.reserving_pose(MemoryClass::Frame, client, record),
        );
        let is_short = json.len() <= MAX_INLINE;
        let parse = move || match route {
            DragRoute::Picture => Reserved::<DragObject, _>::parse(&json, at_rest, reserve),
            DragRoute::Mesh => Reserved::<DragObject, _>::parse_posed(&json, at_rest, reserve),
        };
        if is_short {
            return parse();
        }
        let ticket = self
            .0
            .pool
            .admit(WorkClass::Drag, QueueKey::session(client, record.id))
            .await?;
        self.0.pool.run(&ticket, move |_| parse()).await?
    }

    /// Draws one step of a drag.
    /// Errors: Unknown session, superseded, wrong `q`, or too little capacity.
    pub(crate) async fn warp_session(
        &self,
        client: Client,
        id: SessionId,
        drag: Held<DragObject>,
        formats: Formats,
    ) -> Result<Drawn, Problem> {
        let request = self.sequence(id, drag.seq).await?;
        let plan = self.admit_newest(client, Arc::clone(&request.record), drag.layer.as_ref());
        let (record, content, plan) = self.unless_superseded(&request, plan).await?;
        let base = content.output_beside(record.output);
        let format = formats.choose(drag.output.format, base.format)?;
        let output = OutputSpec {
            format,
            ..drag.output.merge_onto(&base)
        };
        let AdmittedPlan { ticket, planned } = plan;
        let (folds, quota) = (record.folds, self.response_quota(client));
        let q = self.posed(&ticket, &record, drag).await?;
        self.draw(
            ticket,
            DrawJob {
                content,
                planned,
                q,
                folds,
                output,
                preview: None,
                force_alpha: false,
                quota,
            },
        )
        .await
    }

    /// Returns the posed grid of one step of a drag; no image is decoded or drawn. Errors: Unknown
    /// session, superseded, wrong `q`, too many vertices for JSON, or too little capacity.
    pub(crate) async fn mesh_session(
        &self,
        client: Client,
        id: SessionId,
        drag: Held<DragObject>,
        form: MeshForm,
    ) -> Result<SessionMesh, Problem> {
        let request = self.sequence(id, drag.seq).await?;
        let plan = self
            .unless_superseded(&request, self.admit_mesh(client, &request.record, &form))
            .await?;
        let q = self.posed(&plan.ticket, &request.record, drag).await?;
        self.pose_mesh(plan, q, &request.record, form, self.response_quota(client))
            .await
    }

    /// The handles that a drag means (see [`RestSpec::posed`](mlswarp::warp::RestSpec::posed)).
    /// Errors: `bad_value` at `/q` if neither the request nor the session has one.
    async fn posed(
        &self,
        ticket: &Ticket,
        record: &Arc<Record>,
        drag: Held<DragObject>,
    ) -> Result<Arc<Held<Vec<Handle>>>, Problem> {
        let strength = drag.pose.strength.unwrap_or(1.0);
        let is_as_given = drag.pose.q.is_some()
            && record.rest.align == Align::None
            && strength.to_bits() == 1.0_f64.to_bits();
        let is_here = is_as_given || columns(record) <= MOST_POSED_HERE;
        let record = Arc::clone(record);
        let posed = move || {
            let pose = drag.try_map(|drag| drag.pose.onto(record.pose.as_ref()))?;
            Ok(Arc::new(pose.map(|Pose { q, strength }| {
                record.rest.posed(q, strength, record.extent).0
            })))
        };
        if is_here {
            posed()
        } else {
            self.0.pool.run(ticket, move |_| posed()).await?
        }
    }

    /// What is drawn of a session, and its plan. If the session was replaced while this waited, its
    /// old file is gone: then those of the current session.
    pub(crate) async fn admit_newest(
        &self,
        client: Client,
        mut record: Arc<Record>,
        layer: Option<&LayerRef>,
    ) -> Result<(Arc<Record>, DrawnContent, AdmittedPlan), Problem> {
        for _ in 0..SESSION_ATTEMPTS {
            match self.admit_drawing(client, &record, layer).await {
                Ok((content, plan)) => return Ok((record, content, plan)),
                Err(problem) => record = self.newer_record(&record, problem).await?,
            }
        }
        Err(StoreError::Contended.into())
    }

    /// The record by which files are read again after `problem`: another request may have replaced
    /// those of `record` since it was read, and the session lives. Every reader of a session's
    /// files asks this, so that a 404 means that the session has ended. Errors: `problem`, if it is
    /// about something else or the session has no newer record.
    pub(crate) async fn newer_record(
        &self,
        record: &Record,
        problem: Problem,
    ) -> Result<Arc<Record>, Problem> {
        if problem.code != Code::NoSuchSession {
            return Err(problem);
        }
        let newest = self.peek_session(record.id).await?.record;
        if newest.revision == record.revision {
            Err(problem)
        } else {
            Ok(newest)
        }
    }

    async fn admit_drawing(
        &self,
        client: Client,
        record: &Arc<Record>,
        layer: Option<&LayerRef>,
    ) -> Result<(DrawnContent, AdmittedPlan), Problem> {
        let setup = self.session_setup(client, record).await?;
        let sources = self.fetch_sources(client, record, layer).await?;
        let ticket = self
            .admit_step(client, record, &setup, sources.is_decoded())
            .await?;
        let mut timing = Timing {
            queue: ticket.waited(),
            ..Timing::default()
        };
        let began = Instant::now();
        let content = self.decode_content(client, &ticket, sources).await?;
        timing.decode = began.elapsed();
        stage("decode", began);
        let planned = self.plan(client, &ticket, &setup, timing).await?;
        Ok((content, AdmittedPlan { ticket, planned }))
    }

    /// The plan of a session for a mesh.
    pub(crate) async fn admit_mesh(
        &self,
        client: Client,
        record: &Arc<Record>,
        form: &MeshForm,
    ) -> Result<AdmittedPlan, Problem> {
        let setup = self.session_setup(client, record).await?;
        form.check_size(setup.dimensions())?;
        let ticket = self.admit_step(client, record, &setup, true).await?;
        let timing = Timing {
            queue: ticket.waited(),
            ..Timing::default()
        };
        let planned = self.plan(client, &ticket, &setup, timing).await?;
        Ok(AdmittedPlan { ticket, planned })
    }

    /// Admits a step of a drag: as a drag if everything that it uses is cached and the plan has a
    /// table, otherwise as an upload.
    async fn admit_step(
        &self,
        client: Client,
        record: &Record,
        setup: &ResolvedRest,
        has_image: bool,
    ) -> Result<Ticket, Problem> {
        let is_cached = has_image
            && self
                .0
                .plans
                .touch(CacheKey::new(record.id.owner(), setup.plan_key()))
            && setup.plan_bytes().is_some();
        let class = if is_cached {
            WorkClass::Drag
        } else {
            WorkClass::Upload
        };
        Ok(self
            .0
            .pool
            .admit(class, QueueKey::session(client, record.id))
            .await?)
    }

    /// Poses the grid and encodes it.
    pub(crate) async fn pose_mesh(
        &self,
        plan: AdmittedPlan,
        q: Arc<Held<Vec<Handle>>>,
        record: &Record,
        form: MeshForm,
        quota: ClientQuota,
    ) -> Result<SessionMesh, Problem> {
        let AdmittedPlan {
            ticket,
            planned:
                Planned {
                    setup,
                    plan,
                    mut timing,
                    is_built,
                },
        } = plan;
        let (app, folds, extent, canvas) = (
            self.clone(),
            record.folds,
            record.extent,
            record.output.canvas,
        );
        let pose = move |cancel: &Cancel| {
            let began = Instant::now();
            let is_cancelled = || cancel.is_cancelled();
            let pose = || PosedMesh::coarse(&setup, &plan, &setup.pose(&q)?, folds, &is_cancelled);
            let (posed, mut reservation) = app.reserve_and_pose(&setup, &quota, 0, pose)?;
            timing.deform = began.elapsed();
            stage("deform", began);
            app.metrics().prepared(&timing);
            let (body, error) = form.write(&posed, MeshShape::new(&setup, extent), cancel)?;
            reservation.shrink_to(body.len() as u64);
            let body = reservation.attach(body);
            let canvas = canvas.of(extent, &posed, &is_cancelled)?;
            let report = posed.into_report(canvas, &is_cancelled)?;
            Ok::<_, Problem>(SessionMesh {
                report,
                timing,
                plan_built: is_built,
                body,
                error,
            })
        };
        self.0.pool.run(&ticket, pose).await?
    }

    /// Chooses the lattice of compact meshes.
    pub(crate) async fn compact_lattice(
        &self,
        plan: &AdmittedPlan,
        tolerance: f64,
        quota: ClientQuota,
    ) -> Result<CompactLattice, Problem> {
        let (setup, table) = (
            Arc::clone(&plan.planned.setup),
            Arc::clone(&plan.planned.plan),
        );
        let app = self.clone();
        let choose = move |cancel: &Cancel| {
            let choose =
                || CompactLattice::new(&setup, &table, tolerance, &|| cancel.is_cancelled());
            let (lattice, _reservation) = app.reserve_and_pose(&setup, &quota, 0, choose)?;
            Ok::<_, Problem>(lattice)
        };
        self.0.pool.run(&plan.ticket, choose).await?
    }

    /// Touches the session, and enters a numbered request into its sequence.
    async fn sequence(&self, id: SessionId, seq: Option<u64>) -> Result<SequencedRequest, Problem> {
        let Session {
            record,
            seq: newest,
            ..
        } = self.touch(id, seq).await?;
        match seq {
            Some(seq) if newest > Some(seq) => Err(self.superseded(seq, newest.unwrap_or(seq))),
            Some(seq) => {
                let position = self.0.sequencer.enter((id, record.created), seq);
                Ok(SequencedRequest {
                    record,
                    position: Some((position, seq)),
                })
            }
            None => Ok(SequencedRequest {
                record,
                position: None,
            }),
        }
    }

    /// Stops `work` when a newer request of the same session arrives.
    async fn unless_superseded<T>(
        &self,
        request: &SequencedRequest,
        work: impl Future<Output = Result<T, Problem>>,
    ) -> Result<T, Problem> {
        match &request.position {
            None => work.await,
            Some((position, seq)) => tokio::select! {
                biased;
                () = position.superseded() => Err(self.superseded(*seq, position.newest())),
                // Builds continue: the newer request needs them.
                result = position.builds().during(work) => result,
            },
        }
    }

    fn superseded(&self, seq: u64, newest: u64) -> Problem {
        self.0.metrics.requests_superseded.inc();
        let detail =
            format!("seq {seq} is lower than {newest}, the highest that this session has seen");
        Problem::new(Code::Superseded, detail)
            .pointer("/seq")
            .actual(seq)
            .extra("newest", newest)
    }
}
