//! `POST /sessions/{id}/warp`: new positions of the handles, drawn; and what other requests about a
//! session share with it. A request whose image, setup, plan and order of drawing are there is of
//! the class drag, others of the class upload.

use std::sync::Arc;
use std::time::Instant;

use bytes::Bytes;
use mlswarp::deform::Handle;
use mlswarp::pixmap::Extent;
use mlswarp::warp::{Align, Folds, OutputSpec, ResolvedRest};

use super::draw::{DrawJob, Drawn};
use super::drawable::DrawnContent;
use super::parts::plans::{HeldSetup, Planned, columns};
use super::reading::Held;
use super::{App, SESSION_ATTEMPTS};
use crate::client::Client;
use crate::layer::LayerRef;
use crate::limits::memory::MemoryClass;
use crate::observe::scope::stage;
use crate::observe::stages::Timing;
use crate::pool::{QueueKey, Ticket, WorkClass};
use crate::problem::Problem;
use crate::session::SessionId;
use crate::store::{Record, StoreError};
use crate::wire::formats::Formats;
use crate::wire::{DragObject, MeshShape, Pose, Reserved};

/// Columns up to which aligning handles is faster than waking a compute thread.
pub(crate) const MAX_INLINE_COLUMNS: u64 = 64;
/// Size of a text up to which parsing it is faster than waking a compute thread, bytes.
pub(crate) const MAX_INLINE_BYTES: usize = 4 << 10;

/// What a step of a drag is answered with.
#[derive(Clone, Copy, Debug)]
pub(crate) enum DragRoute {
    Picture,
    Mesh,
}

/// Pixels of an image up to which its drawing counts as a drag. A larger one takes longer than a
/// person's hand waits, and would delay the drags of others: it waits with the uploads.
const MOST_DRAG_PIXELS: u64 = 8_000_000;

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

/// Reads the body of a drag: here if it is short, otherwise on a compute thread. `record`: that
/// of the session, whose number of handles is not exceeded. Errors: a wrong object, or too
/// little capacity.
pub(crate) async fn read_drag(
    app: &App,
    client: Client,
    record: &Record,
    json: Bytes,
    route: DragRoute,
) -> Result<Held<DragObject>, Problem> {
    let (at_rest, reserve) = (
        record.rest.p.len(),
        app.admission
            .reserving_pose(MemoryClass::Frame, client, record),
    );
    let is_short = json.len() <= MAX_INLINE_BYTES;
    let parse = move || match route {
        DragRoute::Picture => Reserved::<DragObject, _>::parse(&json, at_rest, reserve),
        DragRoute::Mesh => Reserved::<DragObject, _>::parse_posed(&json, at_rest, reserve),
    };
    if is_short {
        return parse();
    }
    let key = QueueKey::session(client, record.id);
    let ticket = app.admission.pool.admit(WorkClass::Drag, key).await?;
    ticket.run(move |_| parse()).await?
}

/// Draws one step of a drag.
/// Errors: an unknown session, a superseded request, a wrong `q`, or too little capacity.
pub(crate) async fn of_session(
    app: &App,
    client: Client,
    id: SessionId,
    drag: Held<DragObject>,
    formats: Formats,
) -> Result<Drawn, Problem> {
    let request = app.sessions.sequence(id, drag.seq).await?;
    let plan = admit_newest(
        app,
        client,
        Arc::clone(&request.record),
        drag.layer.as_ref(),
    );
    let (record, content, plan) = app.sessions.unless_superseded(&request, plan).await?;
    let base = content.output_beside(record.output);
    let format = formats.choose(drag.output.format, base.format)?;
    let output = OutputSpec {
        format,
        ..drag.output.merge_onto(&base)
    };
    let AdmittedPlan {
        mut ticket,
        planned,
    } = plan;
    let key = QueueKey::session(client, record.id);
    let extent = content.raster_source().extent();
    // A canvas that depends on the pose is about as large as the image.
    let target = output.target_before_pose(extent, &app.plans.limits)?;
    if target.map_or(extent, |target| target.extent).pixels() > MOST_DRAG_PIXELS {
        drop(ticket);
        let upload = async { Ok(app.admission.upload(key).await?) };
        ticket = app.sessions.unless_superseded(&request, upload).await?;
    }
    let (folds, quota) = (record.folds, app.admission.response_quota(client));
    let q = posed(&ticket, &record, drag).await?;
    app.drawing
        .draw(
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

/// The handles that a drag means (see [`RestSpec::posed`](mlswarp::warp::RestSpec::posed)).
/// Errors: `bad_value` at `/q` if neither the request nor the session has one.
pub(crate) async fn posed(
    ticket: &Ticket,
    record: &Arc<Record>,
    drag: Held<DragObject>,
) -> Result<Arc<Held<Vec<Handle>>>, Problem> {
    let strength = drag.pose.strength.unwrap_or(1.0);
    let is_as_given = drag.pose.q.is_some()
        && record.rest.align == Align::None
        && strength.to_bits() == 1.0_f64.to_bits();
    let is_inline = is_as_given || columns(record) <= MAX_INLINE_COLUMNS;
    let record = Arc::clone(record);
    let posed = move || {
        let pose = drag.try_map(|drag| drag.pose.onto(record.pose.as_deref()))?;
        Ok(Arc::new(pose.map(|Pose { q, strength }| {
            record.rest.posed(q, strength, record.extent).0
        })))
    };
    if is_inline {
        posed()
    } else {
        ticket.run(move |_| posed()).await?
    }
}

/// What is drawn of a session, and its plan. If the session was replaced while this waited, its old
/// file is gone, and the current session takes its place.
pub(crate) async fn admit_newest(
    app: &App,
    client: Client,
    mut record: Arc<Record>,
    layer: Option<&LayerRef>,
) -> Result<(Arc<Record>, DrawnContent, AdmittedPlan), Problem> {
    for _ in 0..SESSION_ATTEMPTS {
        match admit_drawing(app, client, &record, layer).await {
            Ok((content, plan)) => return Ok((record, content, plan)),
            Err(problem) => record = app.sessions.newer_record(&record, problem).await?,
        }
    }
    Err(StoreError::Contended.into())
}

/// The setup of a session, or that of the current one if the session was replaced while the files
/// of a mask were read. Errors: Unknown session, or too little capacity.
pub(crate) async fn newest_setup(
    app: &App,
    client: Client,
    mut record: Arc<Record>,
) -> Result<(Arc<Record>, HeldSetup), Problem> {
    for _ in 0..SESSION_ATTEMPTS {
        match app.plans.setup_of(client, &record).await {
            Ok(setup) => return Ok((record, setup)),
            Err(problem) => record = app.sessions.newer_record(&record, problem).await?,
        }
    }
    Err(StoreError::Contended.into())
}

async fn admit_drawing(
    app: &App,
    client: Client,
    record: &Arc<Record>,
    layer: Option<&LayerRef>,
) -> Result<(DrawnContent, AdmittedPlan), Problem> {
    let setup = app.plans.setup_of(client, record).await?;
    let sources = app.images.fetch(client, record, layer).await?;
    let ticket = admit_step(app, client, record, &setup, sources.is_decoded()).await?;
    let mut timing = Timing::queued(ticket.waited());
    let began = Instant::now();
    let content = app.images.decode(client, &ticket, sources).await?;
    timing.decode = began.elapsed();
    stage("decode", began);
    let planned = app.plans.plan(client, &ticket, &setup, timing).await?;
    Ok((content, AdmittedPlan { ticket, planned }))
}

/// Admits a step of a drag: as a drag if everything that it uses is cached, the order of drawing
/// is known, poses are quick and no folds are removed, otherwise as an upload.
pub(crate) async fn admit_step(
    app: &App,
    client: Client,
    record: &Record,
    setup: &ResolvedRest,
    has_image: bool,
) -> Result<Ticket, Problem> {
    // An order of drawing may weigh all handles at all vertices again.
    let is_cached = has_image
        && app.plans.touch(record.id.owner(), setup)
        && setup.is_quickly_posed()
        && setup.lacks_order().is_none()
        && record.folds != Folds::Remove;
    let class = if is_cached {
        WorkClass::Drag
    } else {
        WorkClass::Upload
    };
    let key = QueueKey::session(client, record.id);
    Ok(app.admission.pool.admit(class, key).await?)
}

#[cfg(test)]
mod tests {
    use std::time::SystemTime;

    use mlswarp::geometry::Point;
    use mlswarp::warp::{Digest, RestSpec};

    use super::*;
    use crate::config::Config;
    use crate::pool::Cancel;
    use crate::session::Revision;
    use crate::wire::WarpObject;

    fn record(client: Client, extent: Extent) -> Record {
        let place = |k: i32| Point::new(f64::from(k) * 90.0 + 20.0, f64::from(k * k) * 50.0 + 20.0);
        let base = WarpObject::default();
        Record {
            id: SessionId::random(client.owner),
            revision: Revision::random(),
            image: Digest::of(b"an image"),
            layers: std::collections::BTreeMap::new(),
            made_with_region: None,
            extent,
            rest: RestSpec {
                p: (0..3).map(|k| Handle::Point(place(k))).collect(),
                depth: Some(vec![0.0, 0.0, 1.0]),
                ..RestSpec::default()
            }
            .into(),
            pose: None,
            folds: base.folds,
            output: base.output,
            created: SystemTime::now(),
        }
    }

    #[tokio::test]
    async fn a_step_is_no_drag_until_the_order_of_drawing_is_known() {
        let (app, client) = (App::new(Config::default()).unwrap(), Client::default());
        let record = record(client, Extent::new(300, 300).unwrap());
        let key = QueueKey::session(client, record.id);
        let upload = app.admission.upload(key).await.unwrap();
        let [one, other] = [(); 2].map(|()| {
            let (plans, record) = (Arc::clone(&app.plans), record.clone());
            upload.run(move |cancel: &Cancel| {
                plans.new_setup(&record.rest, record.extent, None, cancel)
            })
        });
        let (one, other) = tokio::join!(one, other);
        let [one, other] = [one, other].map(|setup| Arc::new(setup.unwrap().unwrap()));
        app.plans
            .plan(client, &upload, &one, Timing::default())
            .await
            .unwrap();
        drop(upload);
        // The plan is that of both.
        assert!(app.plans.touch(client.owner, &other));
        for (setup, has_image, class) in [
            (&one, true, WorkClass::Drag),
            (&one, false, WorkClass::Upload),
            (&other, true, WorkClass::Upload),
        ] {
            // A computation gives its turn back by itself.
            while app.pool().running() > 0 {
                tokio::task::yield_now().await;
            }
            let ticket = admit_step(&app, client, &record, setup, has_image).await;
            assert_eq!(app.pool().load(class).running, 1);
            drop(ticket.unwrap());
        }
    }

    /// Of 68 points at alpha 1 there is no table: each pose sums their weights.
    #[tokio::test]
    async fn a_step_of_landmarks_without_a_table_is_a_drag_once_its_plan_is_kept() {
        let (app, client) = (App::new(Config::default()).unwrap(), Client::default());
        let mut record = record(client, Extent::new(300, 300).unwrap());
        let place = |k: i32| Point::new(f64::from(k % 9) * 30.0, f64::from(k / 9) * 30.0 + 5.0);
        record.rest = RestSpec {
            p: (0..68).map(|k| Handle::Point(place(k))).collect(),
            ..RestSpec::default()
        }
        .into();
        let upload = (app.admission.upload(QueueKey::session(client, record.id))).await;
        let (plans, of, upload) = (Arc::clone(&app.plans), record.clone(), upload.unwrap());
        let setup = upload
            .run(move |cancel: &Cancel| plans.new_setup(&of.rest, of.extent, None, cancel))
            .await;
        let setup = Arc::new(setup.unwrap().unwrap());
        assert!(setup.plan_bytes().is_none());
        let plan = app.plans.plan(client, &upload, &setup, Timing::default());
        drop(plan.await.unwrap());
        drop(upload);
        while app.pool().running() > 0 {
            tokio::task::yield_now().await;
        }
        let ticket = admit_step(&app, client, &record, &setup, true).await;
        assert_eq!(app.pool().load(WorkClass::Drag).running, 1);
        drop(ticket.unwrap());
    }
}
