//! `POST /report` and `/sessions/{id}/report`: how good a pose is, without drawing it.

use std::sync::Arc;
use std::time::Instant;

use bytes::Bytes;
use mlswarp::deform::Handle;
use mlswarp::warp::{
    Alignment, CoordinateFrame, Folds, OutputSpec, PosedMesh, Quality, Target, Units,
};

use super::App;
use super::drawable::DrawnContent;
use super::json_text::cancellable_json;
use super::mesh::PoseResponse;
use super::parts::plans::{HeldSetup, Planned};
use super::reading::Held;
use super::resolved::{Resolved, resolve_on};
use super::session_warp::{AdmittedPlan, admit_newest, newest_setup};
use crate::client::Client;
use crate::limits::memory::MemoryClass;
use crate::observe::scope::stage;
use crate::observe::stages::Timing;
use crate::pool::{Cancel, QueueKey, Ticket};
use crate::problem::Problem;
use crate::store::Record;
use crate::wire::{
    DragObject, Pose, ReportAnswer, ReportObject, Reserved, WarningEntry, method_text,
};

/// What is measured.
struct ReportJob {
    client: Client,
    setup: HeldSetup,
    q: Arc<Held<Vec<Handle>>>,
    /// How q was aligned, if that was requested.
    alignment: Option<Alignment>,
    folds: Folds,
    output: OutputSpec,
    /// Has the region that moves, if the canvas depends on it.
    region: Option<DrawnContent>,
    /// What would be drawn, if the request is about an image.
    drawn: Option<DrawnContent>,
}

/// Measures the pose of a warp object. The second result: the method that was chosen if that
/// was requested, as a header shows it. Errors: Wrong handles, or too little capacity.
pub(crate) async fn once(
    app: &App,
    client: Client,
    json: Bytes,
) -> Result<(PoseResponse, Option<String>), Problem> {
    let ticket = app.admission.upload(QueueKey::client(client)).await?;
    let reserve = app.admission.reserving(MemoryClass::Upload, client);
    let object = ticket
        .run(move |_| Reserved::<ReportObject, _>::parse(&json, reserve))
        .await??;
    let (extent, warp) = (object.extent, object.map(|object| object.warp));
    let Resolved {
        setup,
        object,
        q,
        alignment,
        ..
    } = resolve_on(app, &ticket, warp, extent).await?;
    let method = object.is_auto.then(|| method_text(&object.rest));
    let (folds, output) = (object.folds.measured(), object.output);
    let job = ReportJob {
        client,
        setup,
        q,
        alignment,
        folds,
        output,
        region: None,
        drawn: None,
    };
    Ok((report(app, &ticket, job).await?, method))
}

/// Measures a pose of a session.
/// Errors: Wrong handles, or too little capacity.
pub(crate) async fn of_session(
    app: &App,
    client: Client,
    record: Arc<Record>,
    json: Bytes,
) -> Result<PoseResponse, Problem> {
    let id = record.id;
    // Before the plan is built.
    let (record, setup) = newest_setup(app, client, record).await?;
    setup.check_quality()?;
    drop(setup);
    // What is lost of the file depends on the file.
    let (record, content, AdmittedPlan { planned, .. }) =
        admit_newest(app, client, record, None).await?;
    let setup = planned.setup;
    let key = QueueKey::session(client, id);
    let ticket = app.admission.upload(key).await?;
    let limits = app.plans.limits;
    let of_session = Arc::clone(&record);
    let reserve = app
        .admission
        .reserving_pose(MemoryClass::Upload, client, &record);
    let parse = move |_: &_| {
        let mut drag =
            Reserved::<DragObject, _>::parse_for_report(&json, of_session.rest.p.len(), reserve)?;
        let Pose { q, strength } =
            std::mem::take(&mut drag.pose).onto(of_session.pose.as_deref())?;
        let output = drag.output.merge_onto(&of_session.output);
        output.check(of_session.extent, &limits)?;
        let (q, alignment) = of_session.rest.posed(q, strength, of_session.extent);
        Ok::<_, Problem>((Arc::new(drag.map(|_| q)), alignment, output))
    };
    let (q, alignment, output) = ticket.run(parse).await??;
    drop(ticket);
    let region = match app.images.region_of(client, &record, output.canvas).await {
        Ok(region) => region,
        Err(problem) => return Err(app.sessions.replaced(&record, problem).await),
    };
    let key = QueueKey::session(client, id);
    let ticket = app.admission.upload(key).await?;
    let folds = record.folds.measured();
    let job = ReportJob {
        client,
        setup,
        q,
        alignment,
        folds,
        output,
        region,
        drawn: Some(content),
    };
    report(app, &ticket, job).await
}

/// The grid on which the inverse is sought, if it is another one: `/points` seeks it there too,
/// because cells of the report's grid may be too large or too small.
async fn plan_to_invert(
    app: &App,
    client: Client,
    ticket: &Ticket,
    setup: &HeldSetup,
) -> Result<Option<Planned>, Problem> {
    let to_invert = app.plans.to_invert(ticket, setup).await?;
    if to_invert.plan_key() == setup.plan_key() {
        return Ok(None);
    }
    let planned = app
        .plans
        .plan(client, ticket, &to_invert, Timing::default());
    planned.await.map(Some)
}

async fn report(app: &App, ticket: &Ticket, job: ReportJob) -> Result<PoseResponse, Problem> {
    let ReportJob {
        client,
        setup,
        q,
        alignment,
        folds,
        output,
        region,
        drawn,
    } = job;
    let timing = Timing::queued(ticket.waited());
    setup.check_quality()?;
    let Planned {
        plan,
        mut timing,
        is_built,
        ..
    } = app.plans.plan(client, ticket, &setup, timing).await?;
    let to_invert = plan_to_invert(app, client, ticket, &setup).await?;
    let (drawing, quota) = (
        Arc::clone(&app.drawing),
        app.admission.response_quota(client),
    );
    let measure = move |cancel: &Cancel| {
        let (began, is_cancelled) = (Instant::now(), || cancel.is_cancelled());
        let pose = setup.pose(&q)?;
        let posed = || PosedMesh::new(&setup, &plan, &pose, folds, &is_cancelled);
        let (posed, mut reservation) =
            drawing.reserve_and_pose(&setup, &quota, (folds, false), posed)?;
        // What is drawn is then inverted itself.
        let to_invert = to_invert.filter(|_| !posed.is_unfolded());
        let region = region.as_ref().and_then(DrawnContent::region).cloned();
        let posed = region.into_iter().fold(posed, PosedMesh::within);
        let canvas = output.canvas.of(setup.source(), &posed, &is_cancelled)?;
        let inverse_bytes = to_invert
            .as_ref()
            .map_or(0, |planned| planned.setup.posed_bytes());
        drawing.admission.reserve_more(
            &mut reservation,
            posed.extra_bytes() + Quality::bytes(&posed, canvas) + inverse_bytes,
        )?;
        let quality = drawing.admission.pool.run_parallel(|| {
            let coarse = |planned: &Planned| {
                PosedMesh::coarse(
                    &planned.setup,
                    &planned.plan,
                    &pose,
                    Folds::Report,
                    &is_cancelled,
                )
            };
            let inverse = to_invert.as_ref().map(coarse).transpose()?;
            Quality::of(
                &setup,
                &q,
                &pose,
                &posed,
                inverse.as_ref().unwrap_or(&posed),
                canvas,
                &is_cancelled,
            )
        })?;
        let mut report = posed.into_report(canvas, &is_cancelled)?;
        if let Some(content) = drawn {
            let shown = canvas.map_or(setup.source(), |canvas| canvas.extent);
            report.warnings.extend(
                content
                    .raster_source()
                    .warnings(&Target::of(canvas, shown), &output),
            );
        }
        timing.deform = began.elapsed();
        stage("deform", began);
        drawing.metrics.prepared(&timing);
        let warnings: Vec<WarningEntry> = report.warnings.iter().map(WarningEntry::from).collect();
        let picture = canvas.map(|canvas| CoordinateFrame::on_canvas(canvas, &output, Units::Px));
        let answer = ReportAnswer {
            quality: &quality,
            alignment,
            warnings: &warnings,
            picture,
        };
        let text = answer.text_bytes();
        drawing
            .admission
            .reserve_more(&mut reservation, text as u64)?;
        let body = cancellable_json(cancel, &answer, text)?;
        let body = reservation.attach_exact(body);
        Ok::<_, Problem>(PoseResponse {
            report,
            timing,
            plan_built: is_built,
            body,
            error: None,
        })
    };
    ticket.run(measure).await?
}
