//! One frame of a drag: the session is touched, and its image or mesh is drawn as for a request.

use std::sync::{Arc, Mutex, PoisonError};
use std::time::Duration;

use bytes::Bytes;
use mlswarp::codec::{Compression, Format};
use mlswarp::deform::Handle;
use mlswarp::warp::{
    Align, CanvasSpec, CompactLattice, CoordinateFrame as PictureFrame, OutputSpec, Report,
};
use tokio::sync::mpsc::UnboundedReceiver;

use super::same;
use crate::app::App;
use crate::app::draw::{DrawJob, Drawn, Piece};
use crate::app::mesh::{MeshForm, PoseResponse, admit_mesh, compact_lattice, pose_mesh};
use crate::app::parts::plans::columns;
use crate::app::reading::Held;
use crate::app::session_warp::{AdmittedPlan, MAX_INLINE_BYTES, MAX_INLINE_COLUMNS, admit_newest};
use crate::client::Client;
use crate::drag::frame_scheduler::FrameRequest;
use crate::drag::picture_ladder::Encoding;
use crate::limits::client_quota::ClientQuota;
use crate::limits::memory::MemoryClass;
use crate::limits::sockets::{FrameTurn, FrameTurns};
use crate::observe::Scope;
use crate::observe::stages::{Cost, Timing};
use crate::pool::{PoolError, Ticket};
use crate::problem::Problem;
use crate::session::SessionId;
use crate::store::Record;
use crate::wire::{AsJson, FrameReport, FrameTiming, MeshShape, UnreadHandles};

/// The content of frames.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum FrameContent {
    /// Files of this format, or of the session's format.
    Picture(Option<Format>),
    /// PNG or JPEG, as the connection allows.
    Auto,
    /// Little-endian f32.
    Mesh,
    /// 16-bit displacements, on a lattice that suits this tolerance, px.
    CompactMesh(f64),
}

impl FrameContent {
    /// Whether frames are meshes, not images.
    pub const fn is_mesh(self) -> bool {
        matches!(self, Self::Mesh | Self::CompactMesh(_))
    }
}

/// The newest lattice of compact meshes, and the record that it was chosen for. It is known even if
/// the frame that it was chosen for fails.
#[derive(Clone, Debug, Default)]
pub(super) struct KnownLattice(Arc<Mutex<Option<LatticeOf>>>);

type LatticeOf = (Arc<Record>, Arc<CompactLattice>);

impl KnownLattice {
    fn of(&self, record: &Arc<Record>) -> Option<Arc<CompactLattice>> {
        let known = self.0.lock().unwrap_or_else(PoisonError::into_inner);
        known
            .as_ref()
            .filter(|(known, _)| same(known, record))
            .map(|(_, lattice)| Arc::clone(lattice))
    }

    fn set(&self, record: &Arc<Record>, lattice: &Arc<CompactLattice>) {
        *self.0.lock().unwrap_or_else(PoisonError::into_inner) =
            Some((Arc::clone(record), Arc::clone(lattice)));
    }
}

/// A frame with its report.
#[derive(Debug)]
pub(crate) struct DragFrame {
    /// The number of the pose.
    pub(crate) seq: u64,
    /// The record that it was drawn from.
    pub(crate) record: Arc<Record>,
    /// The shape of its grid.
    pub(crate) shape: MeshShape,
    /// The file or the mesh, in order.
    pub(crate) pieces: Vec<Bytes>,
    /// The report as JSON.
    pub(crate) report: String,
}

/// The full width of the session's images; with the canvas `fit` it depends on the pose.
pub(crate) fn full_width(record: &Record) -> Option<u32> {
    record.output.width.or(match record.output.canvas {
        CanvasSpec::Same => Some(record.extent.width()),
        CanvasSpec::Box(canvas) => Some(canvas.extent.width()),
        CanvasSpec::Fit => None,
    })
}

/// The output of a frame, and the largest width of a preview. Previews are compressed fast.
fn output(
    record: &Record,
    format: Option<Format>,
    request: &FrameRequest,
) -> (OutputSpec, Option<u32>) {
    let base = OutputSpec {
        format: format.unwrap_or(record.output.format),
        ..record.output
    };
    let output = match request.encoding {
        None => base,
        Some(Encoding::Png) => OutputSpec {
            format: Format::Png,
            ..base
        },
        Some(Encoding::Jpeg(quality)) => OutputSpec {
            format: Format::Jpeg,
            quality,
            ..base
        },
    };
    let is_lossy = matches!(request.encoding, Some(Encoding::Jpeg(_)));
    match (request.width, full_width(record)) {
        (None, _) => (output, None),
        (Some(width), Some(full)) if width == full && !is_lossy => (output, None),
        (Some(width), Some(full)) if width > full => (
            OutputSpec {
                width: Some(width),
                ..output
            },
            None,
        ),
        (Some(width), _) => (
            OutputSpec {
                compression: Compression::Fast,
                ..output
            },
            Some(width),
        ),
    }
}

/// Draws a frame. Dropping the future stops the work at the next strip.
pub(crate) async fn draw_frame(
    app: App,
    client: Client,
    id: SessionId,
    frames: FrameTurns,
    (form, known): (FrameContent, KnownLattice),
    request: FrameRequest,
) -> Result<DragFrame, Problem> {
    let draw = async {
        // The right to be the next one to be admitted.
        let turn = frames.take().await;
        // Once per frame, not once per pose: the store knows whether the session still exists and
        // has changed. Without a number: poses of a socket are not stored, so after a restart the
        // session has the pose of its record.
        let record = app.sessions.touch(id, None).await?.record;
        let session = (client, record, turn);
        match form {
            FrameContent::Picture(format) => picture_frame(&app, session, format, request).await,
            FrameContent::Auto => picture_frame(&app, session, None, request).await,
            FrameContent::Mesh | FrameContent::CompactMesh(_) => {
                mesh_frame(&app, session, (form, known), request).await
            }
        }
    };
    let frame = draw.await;
    if let Err(problem) = &frame {
        Scope::current().set_error(problem.code);
    }
    frame
}

async fn picture_frame(
    app: &App,
    (client, record, turn): (Client, Arc<Record>, FrameTurn),
    format: Option<Format>,
    request: FrameRequest,
) -> Result<DragFrame, Problem> {
    let quota = app.admission.response_quota(client);
    let seq = request.pose.seq;
    let (record, content, plan) = admit_newest(app, client, record, None).await?;
    drop(turn);
    let strength = request.pose.q.strength(record.pose.as_deref());
    let q = read_handles(
        app,
        client,
        &plan.ticket,
        Arc::clone(&request.pose.q),
        &record,
    )
    .await?;
    let shape = plan.shape(record.extent);
    let (output, preview) = output(&record, format, &request);
    let AdmittedPlan { ticket, planned } = plan;
    let job = DrawJob {
        content,
        planned,
        q,
        folds: record.folds,
        output,
        preview,
        force_alpha: false,
        quota,
    };
    let drawn = app.drawing.draw(ticket, job).await?;
    let Drawn {
        report,
        target,
        timing,
        first,
        rest,
        format,
        ..
    } = drawn;
    let quality = format.info().has_quality.then_some(output.quality);
    let (pieces, cost) = collect(first, rest).await?;
    let file = (format.media_type().trim_start_matches("image/"), quality);
    let picture = PictureFrame::of_target(target, record.extent, record.rest.units);
    let head = ReportHead {
        seq,
        strength,
        picture,
        full: preview.is_none(),
    };
    let report = report_json(head, file, (&report, None), timing, cost);
    Ok(DragFrame {
        seq,
        record,
        shape,
        pieces,
        report,
    })
}

async fn mesh_frame(
    app: &App,
    (client, record, turn): (Client, Arc<Record>, FrameTurn),
    (form, known): (FrameContent, KnownLattice),
    request: FrameRequest,
) -> Result<DragFrame, Problem> {
    let quota = app.admission.response_quota(client);
    let seq = request.pose.seq;
    // The lattice is chosen after admission; only JSON has a limit of its own.
    let (record, plan) = admit_mesh(app, client, record, &MeshForm::F32).await?;
    drop(turn);
    let strength = request.pose.q.strength(record.pose.as_deref());
    let q = read_handles(app, client, &plan.ticket, request.pose.q, &record).await?;
    let (shape, lattice) = mesh_shape(app, &plan, (form, &known), &record, &quota).await?;
    let encoding = lattice.map_or(MeshForm::F32, MeshForm::Compact);
    let PoseResponse {
        report,
        timing,
        body,
        error,
        ..
    } = pose_mesh(app, plan, q, &record, encoding, quota).await?;
    let picture = PictureFrame::of_source(record.extent, record.rest.units);
    let head = ReportHead {
        seq,
        strength,
        picture,
        full: true,
    };
    let report = report_json(
        head,
        ("mesh", None),
        (&report, error),
        timing,
        Cost::default(),
    );
    Ok(DragFrame {
        seq,
        record,
        shape,
        pieces: vec![body],
        report,
    })
}

/// The shape of a mesh, and its lattice if it is compact: the known one unless the rest handles,
/// the image or the output have changed.
pub(super) async fn mesh_shape(
    app: &App,
    plan: &AdmittedPlan,
    (form, known): (FrameContent, &KnownLattice),
    record: &Arc<Record>,
    quota: &ClientQuota,
) -> Result<(MeshShape, Option<Arc<CompactLattice>>), Problem> {
    let FrameContent::CompactMesh(tolerance) = form else {
        return Ok((plan.shape(record.extent), None));
    };
    let lattice = match known.of(record) {
        Some(lattice) => lattice,
        None => Arc::new(compact_lattice(app, plan, tolerance, quota.clone()).await?),
    };
    known.set(record, &lattice);
    Ok((MeshShape::compact(&lattice, record.extent), Some(lattice)))
}

/// Parses the handles of a pose: here if they are few, otherwise on a compute thread.
async fn read_handles(
    app: &App,
    client: Client,
    ticket: &Ticket,
    q: Arc<UnreadHandles>,
    record: &Arc<Record>,
) -> Result<Arc<Held<Vec<Handle>>>, Problem> {
    let is_short = q.byte_count() <= MAX_INLINE_BYTES
        && (q.is_given() && record.rest.align == Align::None
            || columns(record) <= MAX_INLINE_COLUMNS);
    let (record, reserve) = (
        Arc::clone(record),
        app.admission.reserving(MemoryClass::Frame, client),
    );
    let read = move || {
        Held::of_pose(
            &q,
            &record.rest,
            record.pose.as_deref(),
            record.extent,
            reserve,
        )
        .map(Arc::new)
    };
    if is_short {
        read()
    } else {
        ticket.run(move |_| read()).await?
    }
}

/// All pieces of an image.
async fn collect(
    mut piece: Piece,
    mut rest: Option<UnboundedReceiver<Piece>>,
) -> Result<(Vec<Bytes>, Cost), Problem> {
    let mut pieces = Vec::new();
    loop {
        pieces.push(piece.bytes);
        if let Some(cost) = piece.end {
            return Ok((pieces, cost));
        }
        let next = match &mut rest {
            Some(rest) => rest.recv().await,
            None => None,
        };
        piece = next.ok_or(PoolError::Panicked)?;
    }
}

/// What a report says first.
struct ReportHead {
    seq: u64,
    strength: f64,
    picture: PictureFrame,
    /// Not a preview.
    full: bool,
}

/// `file`: its format, and the quality of a JPEG; `error`: of a compact mesh.
fn report_json(
    ReportHead {
        seq,
        strength,
        picture,
        full,
    }: ReportHead,
    (format, quality): (&'static str, Option<u8>),
    (report, error): (&Report, Option<f64>),
    timing: Timing,
    cost: Cost,
) -> String {
    let ms = |time: Duration| (time.as_secs_f64() * 1e6).round() / 1e3;
    let timing = FrameTiming {
        queue: ms(timing.queue),
        deform: ms(timing.deform),
        render: ms(cost.render),
        encode: ms(cost.encode),
    };
    let warnings = report.warnings.iter().map(|w| w.code()).collect();
    let Report {
        folds,
        residual,
        exceeded,
        ref coincident,
        ..
    } = *report;
    let report = FrameReport {
        seq,
        width: picture.image().width(),
        height: picture.image().height(),
        canvas: AsJson(picture.canvas()),
        scale: picture.scale(),
        strength,
        full,
        format,
        quality,
        folds,
        residual,
        error,
        warnings,
        exceeded: (exceeded > 0).then_some(exceeded),
        coincident: (!coincident.is_empty()).then_some(AsJson(coincident.as_slice())),
        timing,
    };
    serde_json::to_string(&report).expect("an object of numbers and codes")
}
