//! `POST /sessions/{id}/batch`: many poses of one session, drawn into one file that is streamed
//! while it is made. Each frame is drawn by one thread, and several frames at the same time: that
//! is faster than several threads for each frame.

mod frame;
pub(crate) mod package;
mod poses;
mod stream;

use std::sync::Arc;

use bytes::Bytes;
use mlswarp::render::Canvas;
use mlswarp::warp::{
    CanvasSpec, CoordinateFrame as PictureFrame, OutputSpec, RestSpec, Warning, jitter_grid,
};

use super::drawable::DrawnContent;
use super::parts::plans::{Planned, columns};
use super::session_warp::{AdmittedPlan, admit_newest};
use super::{App, SESSION_ATTEMPTS};
use crate::client::Client;
use crate::layer::LayerRef;
use crate::limits::memory::MemoryClass;
use crate::pool::{Cancel, QueueKey};
use crate::problem::{Code, Problem};
use crate::store::{Record, StoreError};
use crate::wire::formats::Formats;
use crate::wire::{BatchObject, BatchPoses, Reserved};
use frame::{BatchJob, Survey};
pub use package::BatchForm;
pub(crate) use package::{DEFAULT_DELAY_MS, Package};
use poses::Rest;
pub(crate) use stream::BatchStream;

/// A batch whose first frame has been drawn.
pub(crate) struct Batch {
    /// The number of frames.
    pub(crate) frames: u32,
    /// What all images of an animation show; `None` if that is the box of the source.
    pub(crate) canvas: Option<Canvas>,
    /// Whether the plan was built for this request.
    pub(crate) plan_built: bool,
    /// Those of the annotations and of the file; the index has those of each frame.
    pub(crate) warnings: Vec<Warning>,
    /// The first bytes of the file.
    pub(crate) first: Bytes,
    /// The others.
    pub(crate) rest: BatchStream,
}

/// Checks the poses of a batch, and looks at all of its frames if the file needs it: one part
/// for each time on a compute thread, so that others are served in between.
async fn survey(
    app: &App,
    client: Client,
    mut job: BatchJob,
) -> Result<(BatchJob, Survey), Problem> {
    let ticket = app.admission.upload(QueueKey::client(client)).await?;
    let mut survey;
    (job, survey) = ticket
        .run(move |cancel| job.check(cancel).map(|survey| (job, survey)))
        .await??;
    drop(ticket);
    while !job.is_surveyed(&survey) {
        let ticket = app.admission.upload(QueueKey::client(client)).await?;
        let surveyed =
            move |cancel: &Cancel| job.survey(&mut survey, cancel).map(|()| (job, survey));
        (job, survey) = ticket.run(surveyed).await??;
    }
    Ok((job, survey))
}

/// Draws the first frame of a batch, and the others as they are taken. `most_frame_bytes`: as
/// of the JSON of a drag, by the columns of the session. Errors: A wrong pose
/// in any frame, or too little capacity.
pub(crate) async fn of_session(
    app: &App,
    client: Client,
    record: Arc<Record>,
    json: Bytes,
    form: BatchForm,
    most_frame_bytes: fn(u64) -> u64,
) -> Result<Batch, Problem> {
    let ticket = app.admission.upload(QueueKey::client(client)).await?;
    let (most, most_of_frame) = (
        app.config().max_warp_json_bytes,
        most_frame_bytes(columns(&record)),
    );
    let source = PictureFrame::of_source(record.extent, record.rest.units);
    let reserve = app.admission.reserving(MemoryClass::Upload, client);
    let parse = move |cancel: &Cancel| {
        let is_cancelled = || cancel.is_cancelled();
        Reserved::<BatchObject, _>::parse(
            &json,
            most,
            most_of_frame,
            source,
            &is_cancelled,
            reserve,
        )
    };
    let mut object = ticket.run(parse).await??;
    drop(ticket);
    check_form(&object, form)?;
    let (frames, names) = (object.count(), std::mem::take(&mut object.layers));
    let (output, delay, plays) = (object.output, object.delay, object.plays);
    let (record, content, layers, planned) = admit_layers(app, client, record, &names).await?;
    let (planned, grid) = grid_unless_handles(app, client, &record, planned, &object.poses).await?;
    let format = match form.frame_format() {
        Some(format) => format,
        None => Formats::ANY.choose(output.format, record.output.format)?,
    };
    let output = OutputSpec {
        format,
        ..output.merge_onto(&record.output)
    };
    let (plan, quota) = (planned.plan, app.admission.response_quota(client));
    let rest = Rest {
        record: Arc::clone(&record),
        grid,
        setup: planned.setup,
    };
    let job = BatchJob {
        app: app.clone(),
        client,
        quota,
        record,
        content,
        layers,
        plan,
        rest,
        object,
        frames,
        output,
        form,
        force_alpha: false,
    };
    let (mut job, survey) = survey(app, client, job).await?;
    job.decide(&survey)?;
    let canvas = match job.output.canvas {
        CanvasSpec::Box(canvas) if form.is_animation() => Some(canvas),
        _ => None,
    };
    let mut warnings = Vec::new();
    job.object.annotations.add_warnings(&source, &mut warnings);
    let mut rest =
        BatchStream::new(job, delay.unwrap_or(DEFAULT_DELAY_MS), plays.unwrap_or(0)).await?;
    let first = rest
        .next()
        .await
        .unwrap_or_else(|| Err(Problem::new(Code::Internal, "a batch without frames")))?;
    warnings.extend(rest.of_file.iter().cloned());
    Ok(Batch {
        frames,
        canvas,
        plan_built: planned.is_built,
        warnings,
        first,
        rest,
    })
}

/// Layers by their names.
type Layers = Vec<(LayerRef, DrawnContent)>;

/// The image of a session, its layers of these names and its plan, all by one record: the
/// newest, if files of another one are gone. Errors: An unknown layer, or too little capacity.
async fn admit_layers(
    app: &App,
    client: Client,
    mut record: Arc<Record>,
    names: &[LayerRef],
) -> Result<(Arc<Record>, DrawnContent, Layers, Planned), Problem> {
    for _ in 0..SESSION_ATTEMPTS {
        let (newest, content, plan) = admit_newest(app, client, record, None).await?;
        let AdmittedPlan { ticket, planned } = plan;
        drop(ticket);
        match decode_layers(app, client, &newest, names).await {
            Ok(layers) => return Ok((newest, content, layers, planned)),
            Err(problem) => record = app.sessions.newer_record(&newest, problem).await?,
        }
    }
    Err(StoreError::Contended.into())
}

/// The handles at rest and the plan by which a session without handles is jittered: those of a
/// grid. Errors: Too little capacity.
async fn grid_unless_handles(
    app: &App,
    client: Client,
    record: &Record,
    planned: Planned,
    poses: &BatchPoses,
) -> Result<(Planned, Option<RestSpec>), Problem> {
    let is_empty = matches!(poses, BatchPoses::Jitter { pose,
        .. } if pose.q.as_ref().is_none_or(Vec::is_empty));
    if !record.rest.p.is_empty() || !is_empty {
        return Ok((planned, None));
    }
    let mut p = jitter_grid(record.rest.units, record.extent);
    if let Some(mask) = planned.setup.mask() {
        // Handles beside what the image shows act on nothing.
        p.retain(|handle| mask.holds(handle, record.rest.units));
    }
    let spec = RestSpec {
        p,
        ..(*record.rest).clone()
    };
    let content = match app.plans.content_of(client, record).await {
        Ok(content) => content,
        Err(problem) => return Err(app.sessions.replaced(record, problem).await),
    };
    let ticket = app.admission.upload(QueueKey::client(client)).await?;
    let (plans, rest, extent) = (Arc::clone(&app.plans), spec.clone(), record.extent);
    let new = move |cancel: &Cancel| plans.new_setup(&rest, extent, content.as_ref(), cancel);
    let setup = Arc::new(ticket.run(new).await??);
    Ok((
        app.plans
            .plan(client, &ticket, &setup, planned.timing)
            .await?,
        Some(spec),
    ))
}

/// The layers of these names, decoded.
/// Errors: An unknown layer, or too little capacity.
async fn decode_layers(
    app: &App,
    client: Client,
    record: &Record,
    names: &[LayerRef],
) -> Result<Layers, Problem> {
    let mut layers = Vec::with_capacity(names.len());
    for (k, name) in names.iter().enumerate() {
        let sources =
            app.images
                .fetch(client, record, Some(name))
                .await
                .map_err(|mut problem| {
                    problem.pointer = problem.pointer.map(|_| format!("/layers/{k}"));
                    problem
                })?;
        let ticket = app.admission.upload(QueueKey::client(client)).await?;
        layers.push((
            name.clone(),
            app.images.decode(client, &ticket, sources).await?,
        ));
    }
    Ok(layers)
}

/// Errors: A field that does not apply to the kind of file.
fn check_form(object: &BatchObject, form: BatchForm) -> Result<(), Problem> {
    let refused =
        |pointer: &str, why: &str| Err(Problem::new(Code::BadValue, why).pointer(pointer));
    match form {
        BatchForm::Zip if object.plays.is_some() => refused(
            "/loop",
            "`loop` does not apply to an archive, only to an animation",
        ),
        BatchForm::Zip if object.delay.is_some() => refused(
            "/delay",
            "`delay` does not apply to an archive, only to an animation",
        ),
        BatchForm::Apng | BatchForm::Gif if !object.layers.is_empty() => refused(
            "/layers",
            "`layers` does not apply to an animation, which has pictures only, but to an archive \
                (application/zip)",
        ),
        BatchForm::Apng | BatchForm::Gif if !object.annotations.kinds.is_empty() => {
            let name = object.annotations.kinds[0].name();
            let why = format!(
                "`{name}` does not apply to an animation, which has pictures only, but to an \
                    archive (application/zip)"
            );
            refused(&format!("/{name}"), &why)
        }
        BatchForm::Apng
            if object
                .output
                .format
                .is_some_and(|format| form.frame_format() != Some(format)) =>
        {
            let why = "`output.format` must be `png`: the frames of an animated PNG are PNG";
            Err(Problem::new(Code::NotAcceptable, why).pointer("/output/format"))
        }
        BatchForm::Gif if object.output.format.is_some() => {
            let why = "`output.format` does not apply to an animated GIF: leave it out";
            Err(Problem::new(Code::NotAcceptable, why).pointer("/output/format"))
        }
        BatchForm::Zip | BatchForm::Apng | BatchForm::Gif => Ok(()),
    }
}
