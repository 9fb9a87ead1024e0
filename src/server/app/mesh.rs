//! `POST /sessions/{id}/mesh`: new positions of the handles, returned as a posed grid.

use std::sync::Arc;
use std::time::Instant;

use bytes::Bytes;
use mlswarp::deform::Handle;
use mlswarp::warp::{CompactLattice, Folds, PosedMesh, Report, WarpError};

use super::App;
use super::json_text::cancellable_json;
use super::parts::plans::Planned;
use super::reading::Held;
use super::session_warp::{AdmittedPlan, admit_step, newest_setup, posed};
use crate::client::Client;
use crate::limits::client_quota::ClientQuota;
use crate::observe::scope::stage;
use crate::observe::stages::Timing;
use crate::pool::Cancel;
use crate::problem::{Code, Problem};
use crate::session::SessionId;
use crate::store::Record;
use crate::wire::{AsJson, DragObject, MeshObject, MeshShape};

/// Maximum number of vertices of a mesh as JSON, which takes some 40 bytes per vertex.
const MAX_JSON_VERTICES: u64 = 1 << 20;

/// The encoding of a mesh.
#[derive(Clone, Debug, PartialEq)]
pub(crate) enum MeshForm {
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
                cancellable_json(
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

/// A posed grid or what was measured of it, with the head of its response.
#[derive(Debug)]
pub(crate) struct PoseResponse {
    /// Warnings and measures for the head of the response.
    pub(crate) report: Report,
    /// Cost.
    pub(crate) timing: Timing,
    /// Whether the plan was built for this request.
    pub(crate) plan_built: bool,
    /// The vertices, or the figures as JSON.
    pub(crate) body: Bytes,
    /// The largest distance between a compact mesh and the full one, px.
    pub(crate) error: Option<f64>,
}

/// Returns the posed grid of one step of a drag; no image is decoded or drawn. Errors: Unknown
/// session, superseded, wrong `q`, too many vertices for JSON, or too little capacity.
pub(crate) async fn of_session(
    app: &App,
    client: Client,
    id: SessionId,
    drag: Held<DragObject>,
    form: MeshForm,
) -> Result<PoseResponse, Problem> {
    let request = app.sessions.sequence(id, drag.seq).await?;
    let plan = admit_mesh(app, client, Arc::clone(&request.record), &form);
    let (record, plan) = app.sessions.unless_superseded(&request, plan).await?;
    let q = posed(&plan.ticket, &record, drag).await?;
    let quota = app.admission.response_quota(client);
    pose_mesh(app, plan, q, &record, form, quota).await
}

/// The plan of a session for a mesh, and the record that it is of: the newest, if the files of a
/// mask are gone.
pub(crate) async fn admit_mesh(
    app: &App,
    client: Client,
    record: Arc<Record>,
    form: &MeshForm,
) -> Result<(Arc<Record>, AdmittedPlan), Problem> {
    let (record, setup) = newest_setup(app, client, record).await?;
    form.check_size(setup.dimensions())?;
    let ticket = admit_step(app, client, &record, &setup, true).await?;
    let timing = Timing::queued(ticket.waited());
    let planned = app.plans.plan(client, &ticket, &setup, timing).await?;
    Ok((record, AdmittedPlan { ticket, planned }))
}

/// Poses the grid and encodes it.
pub(crate) async fn pose_mesh(
    app: &App,
    plan: AdmittedPlan,
    q: Arc<Held<Vec<Handle>>>,
    record: &Record,
    form: MeshForm,
    quota: ClientQuota,
) -> Result<PoseResponse, Problem> {
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
    let (drawing, folds, extent, canvas) = (
        Arc::clone(&app.drawing),
        record.folds,
        record.extent,
        record.output.canvas,
    );
    let pose = move |cancel: &Cancel| {
        let began = Instant::now();
        let is_cancelled = || cancel.is_cancelled();
        let pose = || PosedMesh::coarse(&setup, &plan, &setup.pose(&q)?, folds, &is_cancelled);
        let (posed, mut reservation) =
            drawing.reserve_and_pose(&setup, &quota, (folds, true), pose)?;
        timing.deform = began.elapsed();
        stage("deform", began);
        drawing.metrics.prepared(&timing);
        let (body, error) = form.write(&posed, MeshShape::new(&setup, extent), cancel)?;
        reservation.shrink_to(body.len() as u64);
        let body = reservation.attach(body);
        let canvas = canvas.of(extent, &posed, &is_cancelled)?;
        let report = posed.into_report(canvas, &is_cancelled)?;
        Ok::<_, Problem>(PoseResponse {
            report,
            timing,
            plan_built: is_built,
            body,
            error,
        })
    };
    ticket.run(pose).await?
}

/// Chooses the lattice of compact meshes.
pub(crate) async fn compact_lattice(
    app: &App,
    plan: &AdmittedPlan,
    tolerance: f64,
    quota: ClientQuota,
) -> Result<CompactLattice, Problem> {
    let (setup, table) = (
        Arc::clone(&plan.planned.setup),
        Arc::clone(&plan.planned.plan),
    );
    let drawing = Arc::clone(&app.drawing);
    let choose = move |cancel: &Cancel| {
        let choose = || CompactLattice::new(&setup, &table, tolerance, &|| cancel.is_cancelled());
        let (lattice, _reservation) =
            drawing.reserve_and_pose(&setup, &quota, (Folds::Report, true), choose)?;
        Ok::<_, Problem>(lattice)
    };
    plan.ticket.run(choose).await?
}
