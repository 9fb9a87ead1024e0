//! `POST /points` and `/sessions/{id}/points`: annotations, mapped by the exact deformation or its
//! inverse instead of the grid. They are mapped part by part as the client reads them. Each part is
//! a job of its own, so that a slow reader holds no worker; when the client leaves, nothing more is
//! mapped.

use std::sync::Arc;
use std::time::Instant;

use bytes::Bytes;
use mlswarp::deform::{self, Handle};
use mlswarp::render::Canvas;
use mlswarp::warp::{CanvasSpec, CoordinateFrame, Folds, GridSpec, PosedMesh, Target, Warning};

use super::App;
use super::drawable::DrawnContent;
use super::parts::admission::Admission;
use super::parts::plans::{HeldSetup, Planned};
use super::reading::{Held, part};
use super::resolved::{Resolved, resolve_on};
use super::session_warp::newest_setup;
use crate::client::Client;
use crate::limits::client_quota::ClientQuota;
use crate::limits::memory::{MemoryClass, Reservation};
use crate::observe::scope::stage;
use crate::observe::stages::Timing;
use crate::pool::{Cancel, QueueKey, Ticket};
use crate::problem::{Code, Problem};
use crate::store::Record;
use crate::wire::{Annotations, Cursor, PointsObject, Pose, Reserved, method_text};

/// Text of a request up to which one thread is faster than several, bytes.
const MAX_SEQUENTIAL: usize = 4096;
/// Annotations of which the first part has been mapped.
#[derive(Debug)]
pub(crate) struct MappedFile {
    /// Those of the handles, and of the annotations.
    pub(crate) warnings: Vec<Warning>,
    /// The part of the plane that the image shows, if it is not the box of the source.
    pub(crate) canvas: Option<Canvas>,
    /// The method that was chosen if that was requested, as a header shows it.
    pub(crate) method: Option<String>,
    /// The first bytes of the JSON.
    pub(crate) first: Bytes,
    /// The others, if there are any.
    pub(crate) rest: Option<MappedParts>,
}

/// The parts that are still to be mapped.
#[derive(Debug)]
pub(crate) struct MappedParts {
    admission: Arc<Admission>,
    job: Arc<MappingJob>,
    /// `None` at the end.
    cursor: Option<Cursor>,
}

impl MappedParts {
    /// The next bytes; `None` at the end.
    pub(crate) async fn next(&mut self) -> Option<Result<Bytes, Problem>> {
        let cursor = self.cursor.take()?;
        let part = self.part(cursor).await;
        Some(part.map(|(bytes, cursor)| {
            self.cursor = cursor;
            bytes
        }))
    }

    async fn part(&self, cursor: Cursor) -> Result<(Bytes, Option<Cursor>), Problem> {
        let ticket = self.admission.upload_patiently(self.job.key).await?;
        let (admission, job) = (Arc::clone(&self.admission), Arc::clone(&self.job));
        ticket
            .run(move |cancel| job.part(&admission, cursor, cancel))
            .await?
    }
}

/// Annotations and the deformation by which they are mapped.
#[derive(Debug)]
struct MappingJob {
    setup: HeldSetup,
    pose: deform::Pose,
    /// The posed grid, and its memory: where to look for the inverse, or the map itself if folds
    /// were removed.
    posed: Option<(PosedMesh, Reservation)>,
    picture: CoordinateFrame,
    /// Text of the body.
    annotations: Annotations,
    is_long: bool,
    key: QueueKey,
    quota: ClientQuota,
}

impl MappingJob {
    /// Maps a part in memory that counts for the client until it is sent.
    fn part(
        &self,
        admission: &Admission,
        mut cursor: Cursor,
        cancel: &Cancel,
    ) -> Result<(Bytes, Option<Cursor>), Problem> {
        let (began, is_cancelled) = (Instant::now(), || cancel.is_cancelled());
        let mut reservation = admission.reserve_for(MemoryClass::Frame, &self.quota, 0)?;
        let mut reserve = |bytes| admission.reserve_more(&mut reservation, bytes);
        let mut map = || {
            let transform = match &self.posed {
                Some((posed, _)) if self.annotations.is_inverse => {
                    self.setup.inverse(&self.pose, posed)
                }
                Some((posed, _)) => self.setup.transform_of(&self.pose, posed),
                None => self.setup.transform(&self.pose),
            };
            let transform = transform.onto(self.picture).after(cursor.taken);
            let mut out = Vec::new();
            let more = self.annotations.map_part(
                &mut cursor,
                &transform,
                &is_cancelled,
                &mut reserve,
                &mut out,
            )?;
            cursor.taken = transform.taken();
            Ok::<_, Problem>((out, more))
        };
        let (out, more) = if self.is_long {
            admission.pool.run_parallel(map)
        } else {
            map()
        }?;
        stage("deform", began);
        Ok((reservation.attach_exact(out), more.then_some(cursor)))
    }
}

/// What is mapped, before it is known where the image lies.
struct PointsJob {
    client: Client,
    setup: HeldSetup,
    q: Arc<Held<Vec<Handle>>>,
    object: Held<PointsObject>,
    folds: Folds,
    /// Has the region that moves, if the canvas depends on it.
    region: Option<DrawnContent>,
    cursor: Cursor,
    is_long: bool,
    key: QueueKey,
}

impl PointsJob {
    /// Whether a posed grid decides on the canvas, on the map, or whether the request is refused.
    fn needs_grid(object: &PointsObject, folds: Folds) -> bool {
        object.output.canvas == CanvasSpec::Fit || folds != Folds::Report
    }
}

/// Maps points. `cursor`: a new one.
/// Errors: Wrong handles, or too little capacity.
pub(crate) async fn once(
    app: &App,
    client: Client,
    json: Bytes,
    cursor: Cursor,
) -> Result<MappedFile, Problem> {
    let key = QueueKey::client(client);
    let ticket = app.admission.upload(key).await?;
    let (is_long, most_bytes) = (
        json.len() > MAX_SEQUENTIAL,
        app.config().max_warp_json_bytes,
    );
    let reserve = app.admission.reserving(MemoryClass::Upload, client);
    let parse = move |cancel: &Cancel| {
        let is_cancelled = || cancel.is_cancelled();
        Reserved::<PointsObject, _>::parse(&json, most_bytes, &is_cancelled, reserve)
    };
    let mut object = ticket.run(parse).await??;
    let warp = part(&mut object, |object| object.warp.take());
    let warp = warp.try_map(|warp| {
        warp.ok_or_else(|| Problem::new(Code::Internal, "points without a warp"))
    })?;
    let (extent, mut warp) = (warp.1, warp.map(|(warp, _)| warp));
    if !object.annotations.is_inverse && !PointsJob::needs_grid(&object, warp.folds) {
        // The exact deformation needs no grid; this one is within all limits.
        warp.rest.grid = GridSpec::Counts {
            columns: 2,
            rows: 2,
        };
    }
    let Resolved {
        setup,
        object: warp,
        q,
        ..
    } = resolve_on(app, &ticket, warp, extent).await?;
    let method = warp.is_auto.then(|| method_text(&warp.rest));
    let job = PointsJob {
        client,
        setup,
        q,
        object,
        folds: warp.folds,
        region: None,
        cursor,
        is_long,
        key,
    };
    Ok(MappedFile {
        method,
        ..map_points(app, &ticket, job).await?
    })
}

/// Maps points by the deformation of a session.
/// Errors: Wrong handles, or too little capacity.
pub(crate) async fn of_session(
    app: &App,
    client: Client,
    record: Arc<Record>,
    json: Bytes,
) -> Result<MappedFile, Problem> {
    let (record, setup) = newest_setup(app, client, record).await?;
    let key = QueueKey::session(client, record.id);
    let ticket = app.admission.upload(key).await?;
    let (is_long, most_bytes) = (
        json.len() > MAX_SEQUENTIAL,
        app.config().max_warp_json_bytes,
    );
    let (of_session, reserve) = (
        Arc::clone(&record),
        app.admission
            .reserving_pose(MemoryClass::Upload, client, &record),
    );
    let parse = move |cancel: &Cancel| {
        let (rest, size) = (&of_session.rest, of_session.extent);
        let source = (size, rest.units);
        let mut object = Reserved::<PointsObject, _>::parse_posed(
            &json,
            most_bytes,
            source,
            &of_session.output,
            &|| cancel.is_cancelled(),
            reserve,
        )?;
        let Pose { q, strength } =
            std::mem::take(&mut object.pose).onto(of_session.pose.as_deref())?;
        let q = part(&mut object, |_| rest.posed(q, strength, size).0);
        Ok::<_, Problem>((object, Arc::new(q)))
    };
    let (object, q) = ticket.run(parse).await??;
    drop(ticket);
    let canvas = object.output.canvas;
    let region = match app.images.region_of(client, &record, canvas).await {
        Ok(region) => region,
        Err(problem) => return Err(app.sessions.replaced(&record, problem).await),
    };
    let ticket = app.admission.upload(key).await?;
    let folds = record.folds;
    let job = PointsJob {
        client,
        setup,
        q,
        object,
        folds,
        region,
        cursor: Cursor::default(),
        is_long,
        key,
    };
    map_points(app, &ticket, job).await
}

/// Makes the tree in which an inverse seeks, once for all parts.
fn keep_tree(
    admission: &Admission,
    (posed, held): &mut (PosedMesh, Reservation),
    cancel: &Cancel,
) -> Result<(), Problem> {
    admission.reserve_more(held, posed.tree_bytes())?;
    Ok(posed.keep_tree(&|| cancel.is_cancelled())?)
}

/// Finds the image, and maps the first part.
async fn map_points(app: &App, ticket: &Ticket, job: PointsJob) -> Result<MappedFile, Problem> {
    let PointsJob {
        client,
        setup,
        q,
        object,
        folds,
        region,
        cursor,
        is_long,
        key,
    } = job;
    let plan =
        async |setup: &HeldSetup| (app.plans.plan(client, ticket, setup, Timing::default())).await;
    let drawn = match PointsJob::needs_grid(&object, folds) {
        true => Some(plan(&setup).await?),
        false => None,
    };
    let to_invert = match object.annotations.is_inverse {
        true => Some(plan(&app.plans.to_invert(ticket, &setup).await?).await?),
        false => None,
    };
    let drawing = Arc::clone(&app.drawing);
    let quota = app.admission.response_quota(client);
    let prepare = move |cancel: &Cancel| {
        let (
            PointsObject {
                output,
                annotations,
                ..
            },
            _held,
        ) = object.into_parts();
        let (pose, is_cancelled) = (setup.pose(&q)?, || cancel.is_cancelled());
        let mut unfolded = None;
        let target = match drawn {
            Some(drawn) => {
                let (of, kind) = ((&**setup, &**drawn.plan), (folds, false));
                let posed = drawing.pose_to_map(of, &quota, kind, &pose, &is_cancelled);
                let (posed, held) = posed?;
                let region = region.as_ref().and_then(DrawnContent::region).cloned();
                let posed = region.into_iter().fold(posed, PosedMesh::within);
                let (source, limits) = (setup.source(), &drawing.limits);
                let target = output.target(source, &posed, limits, &is_cancelled)?;
                unfolded = posed.is_unfolded().then_some((posed, held));
                target
            }
            None => match output.target_before_pose(setup.source(), &drawing.limits)? {
                Some(target) => target,
                None => return Err(Problem::new(Code::Internal, "a canvas without a grid")),
            },
        };
        let (picture, source) = (setup.frame_of(target), setup.source_frame());
        let mut warnings = setup.warnings(&pose, Some(picture.canvas()));
        annotations.add_warnings(
            if annotations.is_inverse {
                &picture
            } else {
                &source
            },
            &mut warnings,
        );
        let to_invert = to_invert.filter(|_| unfolded.is_none());
        let posed = to_invert.map(|Planned { setup, plan, .. }| {
            let coarse = || PosedMesh::coarse(&setup, &plan, &pose, Folds::Report, &is_cancelled);
            drawing.reserve_and_pose(&setup, &quota, (Folds::Report, true), coarse)
        });
        let mut posed = unfolded.map_or_else(|| posed.transpose(), |posed| Ok(Some(posed)))?;
        if let Some(posed) = posed.as_mut().filter(|_| annotations.is_inverse) {
            keep_tree(&drawing.admission, posed, cancel)?;
        }
        let is_long = is_long || posed.is_some();
        let job = Arc::new(MappingJob {
            setup,
            pose,
            posed,
            picture,
            annotations,
            is_long,
            key,
            quota,
        });
        let (first, cursor) = job.part(&drawing.admission, cursor, cancel)?;
        let rest = cursor.map(|cursor| MappedParts {
            admission: Arc::clone(&drawing.admission),
            job,
            cursor: Some(cursor),
        });
        let Target { canvas, .. } = target;
        Ok(MappedFile {
            warnings,
            canvas,
            method: None,
            first,
            rest,
        })
    };
    ticket.run(prepare).await?
}
