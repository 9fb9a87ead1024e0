//! `POST /report` and `/sessions/{id}/report`: how good a pose is, without drawing it.

use std::sync::Arc;
use std::time::Instant;

use bytes::Bytes;
use mlswarp::deform::Handle;
use mlswarp::warp::{
    Alignment, CoordinateFrame, Folds, OutputSpec, PosedMesh, Quality, Report, Target, Units,
};

use super::App;
use super::drawable::DrawnContent;
use super::json_text::json_unless;
use super::parts::plans::{HeldSetup, Planned};
use super::reading::Held;
use super::resolved::{Resolved, resolve};
use super::session_warp::{AdmittedPlan, admit_newest};
use crate::client::Client;
use crate::limits::client_quota::ClientQuota;
use crate::limits::memory::MemoryClass;
use crate::observe::scope::stage;
use crate::observe::stages::Timing;
use crate::pool::{Cancel, QueueKey, Ticket};
use crate::problem::Problem;
use crate::store::Record;
use crate::wire::{
    DragObject, Pose, ReportAnswer, ReportObject, Reserved, WarningEntry, method_text,
};

/// The quality of a pose.
#[derive(Debug)]
pub(crate) struct QualityReport {
    /// Warnings and measures for the head of the response.
    pub(crate) report: Report,
    pub(crate) timing: Timing,
    /// Whether the plan was built for this request.
    pub(crate) plan_built: bool,
    /// The figures as JSON.
    pub(crate) body: Bytes,
}

/// What is measured.
struct ReportJob {
    client: Client,
    setup: HeldSetup,
    q: Arc<Held<Vec<Handle>>>,
    /// How q was aligned, if that was requested.
    alignment: Option<Alignment>,
    output: OutputSpec,
    /// Has the region that moves, if the canvas depends on it.
    region: Option<DrawnContent>,
    /// What would be drawn, if the request is about a picture.
    drawn: Option<DrawnContent>,
    quota: ClientQuota,
}

/// Measures the pose of a warp object. The second result: the method that was chosen if that
/// was requested, as a header shows it. Errors: Wrong handles, or too little capacity.
pub(crate) async fn once(
    app: &App,
    client: Client,
    json: Bytes,
) -> Result<(QualityReport, Option<String>), Problem> {
    let ticket = app.admission.upload(QueueKey::client(client)).await?;
    let reserve = app.admission.reserving(MemoryClass::Upload, client);
    let object = ticket
        .run(move |_| Reserved::<ReportObject, _>::parse(&json, reserve))
        .await??;
    let (extent, warp) = (object.extent, object.map(|object| object.warp));
    let of_job = app.clone();
    let settle = move |cancel: &Cancel| resolve(&of_job, warp, extent, cancel);
    let Resolved {
        setup,
        object,
        q,
        alignment,
        ..
    } = ticket.run(settle).await??;
    let method = object.is_auto.then(|| method_text(&object.rest));
    let (output, quota) = (object.output, app.admission.response_quota(client));
    let job = ReportJob {
        client,
        setup,
        q,
        alignment,
        output,
        region: None,
        drawn: None,
        quota,
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
) -> Result<QualityReport, Problem> {
    let id = record.id;
    // Before the plan is built.
    app.plans.setup_of(client, &record).await?.check_quality()?;
    // What is lost of the file depends on the file.
    let (record, content, AdmittedPlan { planned, .. }) =
        admit_newest(app, client, record, None).await?;
    let setup = planned.setup;
    let key = QueueKey::session(client, id);
    let ticket = app.admission.upload(key).await?;
    let limits = app.plans.limits;
    let (of_session, quota) = (Arc::clone(&record), app.admission.response_quota(client));
    let reserve = app
        .admission
        .reserving_pose(MemoryClass::Upload, client, &record);
    let parse = move |_: &_| {
        let mut drag =
            Reserved::<DragObject, _>::parse_for_report(&json, of_session.rest.p.len(), reserve)?;
        let Pose { q, strength } = std::mem::take(&mut drag.pose).onto(of_session.pose.as_ref())?;
        let output = drag.output.merge_onto(&of_session.output);
        output.check(of_session.extent, &limits)?;
        let (q, alignment) = of_session.rest.posed(q, strength, of_session.extent);
        Ok::<_, Problem>((Arc::new(drag.map(|_| q)), alignment, output))
    };
    let (q, alignment, output) = ticket.run(parse).await??;
    drop(ticket);
    let region = app.images.region_of(client, &record, output.canvas).await?;
    let key = QueueKey::session(client, id);
    let ticket = app.admission.upload(key).await?;
    let job = ReportJob {
        client,
        setup,
        q,
        alignment,
        output,
        region,
        drawn: Some(content),
        quota,
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

async fn report(app: &App, ticket: &Ticket, job: ReportJob) -> Result<QualityReport, Problem> {
    let ReportJob {
        client,
        setup,
        q,
        alignment,
        output,
        region,
        drawn,
        quota,
    } = job;
    let timing = Timing {
        queue: ticket.waited(),
        ..Timing::default()
    };
    setup.check_quality()?;
    let Planned {
        plan,
        mut timing,
        is_built,
        ..
    } = app.plans.plan(client, ticket, &setup, timing).await?;
    let to_invert = plan_to_invert(app, client, ticket, &setup).await?;
    let drawing = Arc::clone(&app.drawing);
    let measure = move |cancel: &Cancel| {
        let (began, is_cancelled) = (Instant::now(), || cancel.is_cancelled());
        let pose = setup.pose(&q)?;
        let posed = || PosedMesh::new(&setup, &plan, &pose, Folds::Report, &is_cancelled);
        let (posed, mut reservation) =
            drawing.reserve_and_pose(&setup, &quota, setup.most_halved_bytes(), posed)?;
        let region = region.as_ref().and_then(DrawnContent::region).cloned();
        let posed = region.into_iter().fold(posed, PosedMesh::within);
        let canvas = output.canvas.of(setup.source(), &posed, &is_cancelled)?;
        let inverse_bytes = to_invert
            .as_ref()
            .map_or(0, |planned| planned.setup.posed_bytes());
        drawing.admission.reserve_more(
            &mut reservation,
            posed.halved_bytes() + Quality::bytes(&posed, canvas) + inverse_bytes,
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
                    .subject()
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
        let mut body = json_unless(cancel, &answer, text)?;
        // The client may read it slowly.
        body.shrink_to_fit();
        reservation.shrink_to(body.len() as u64);
        let body = reservation.attach(body);
        Ok::<_, Problem>(QualityReport {
            report,
            timing,
            plan_built: is_built,
            body,
        })
    };
    ticket.run(measure).await?
}
