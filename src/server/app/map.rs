//! `POST /map` and `/sessions/{id}/map`: coordinate maps as files, which are computed band by band
//! as the client reads them. Each band is admitted and computed as a job of its own, so that a slow
//! reader holds no worker; when the client leaves, nothing more is computed.

use std::sync::Arc;
use std::time::Instant;

use bytes::Bytes;
use mlswarp::deform::Handle;
use mlswarp::pixmap::Extent;
use mlswarp::render::Canvas;
use mlswarp::warp::{
    CoordinateMap, Digest, Folds, MapFormat, MapSpec, OutputSpec, PosedMesh, Report,
};

use super::App;
use super::parts::admission::Admission;
use super::parts::plans::Planned;
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
use crate::wire::{MapObject, Pose, Reserved, in_map, method_text};

/// A map whose first band has been computed.
#[derive(Debug)]
pub struct MapFile {
    /// Warnings and measures for the head of the response.
    pub report: Report,
    /// Cost before the first band.
    pub timing: Timing,
    /// Whether the plan was built for this request.
    pub plan_built: bool,
    /// Digest of the resolved request and the build.
    pub etag: Digest,
    /// The part of the plane, if it is not the box of the source.
    pub canvas: Option<Canvas>,
    /// File format.
    pub format: MapFormat,
    /// Bytes of the file.
    pub length: u64,
    /// The first bytes.
    pub first: Bytes,
    /// The others.
    pub rest: MapBands,
}

/// The bands of a map that are still to be computed.
#[derive(Debug)]
pub struct MapBands {
    admission: Arc<Admission>,
    map: Arc<CoordinateMap>,
    next: u32,
    key: QueueKey,
    quota: ClientQuota,
    /// The memory of the posed grid.
    _held: Reservation,
}

impl MapBands {
    /// The next bytes of the file; `None` at its end.
    pub async fn next(&mut self) -> Option<Result<Bytes, Problem>> {
        if self.next >= self.map.bands() {
            return None;
        }
        let band = self.next;
        self.next += 1;
        Some(self.band(band).await)
    }

    async fn band(&self, band: u32) -> Result<Bytes, Problem> {
        let ticket = self.admission.upload_patiently(self.key).await?;
        let (admission, map, quota) = (
            Arc::clone(&self.admission),
            Arc::clone(&self.map),
            self.quota.clone(),
        );
        ticket
            .run(move |cancel| map_band(&admission, &map, band, &quota, cancel))
            .await?
    }
}

/// Everything that a map is made from.
struct MapJob {
    planned: Planned,
    q: Arc<Held<Vec<Handle>>>,
    folds: Folds,
    spec: MapSpec,
    source: Extent,
    key: QueueKey,
    quota: ClientQuota,
}

/// The map of a warp object. The second result: the method that was chosen if that was
/// requested, as a header shows it. Errors: Wrong handles, a map over the limits, or too little
/// capacity.
pub(crate) async fn once(
    app: &App,
    client: Client,
    json: Bytes,
    format: MapFormat,
) -> Result<(MapFile, Option<String>), Problem> {
    let key = QueueKey::client(client);
    let ticket = app.admission.upload(key).await?;
    let reserve = app.admission.reserving(MemoryClass::Upload, client);
    let mut object = ticket
        .run(move |_| Reserved::<MapObject, _>::parse(&json, reserve))
        .await??;
    let warp = part(&mut object, |object| object.warp.take());
    let warp = warp
        .try_map(|warp| warp.ok_or_else(|| Problem::new(Code::Internal, "a map without a warp")))?;
    let (source, mut warp) = (warp.1, warp.map(|(warp, _)| warp));
    let spec = object.spec(&warp.output, format);
    spec.check(source, &app.plans.limits)
        .map_err(|error| in_map(error.into()))?;
    // Nothing is drawn.
    warp.output = OutputSpec::default();
    let Resolved {
        setup,
        object: warp,
        q,
        ..
    } = resolve_on(app, &ticket, warp, source).await?;
    let method = warp.is_auto.then(|| method_text(&warp.rest));
    let timing = Timing::queued(ticket.waited());
    let planned = app.plans.plan(client, &ticket, &setup, timing).await?;
    let job = MapJob {
        planned,
        q,
        folds: warp.folds,
        spec,
        source,
        key,
        quota: app.admission.response_quota(client),
    };
    Ok((map_file(app, &ticket, job).await?, method))
}

/// The map of a session.
/// Errors: Wrong handles, a map over the limits, or too little capacity.
pub(crate) async fn of_session(
    app: &App,
    client: Client,
    record: Arc<Record>,
    json: Bytes,
    format: MapFormat,
) -> Result<MapFile, Problem> {
    let (record, setup) = newest_setup(app, client, record).await?;
    let key = QueueKey::session(client, record.id);
    let ticket = app.admission.upload(key).await?;
    let (reserve, of_session) = (
        app.admission
            .reserving_pose(MemoryClass::Upload, client, &record),
        Arc::clone(&record),
    );
    let parse = move |_: &_| {
        let mut object = Reserved::<MapObject, _>::parse_posed(&json, reserve)?;
        let Pose { q, strength } =
            std::mem::take(&mut object.pose).onto(of_session.pose.as_deref())?;
        let q = part(&mut object, |_| {
            of_session.rest.posed(q, strength, of_session.extent).0
        });
        Ok::<_, Problem>((object, q))
    };
    let (object, q) = ticket.run(parse).await??;
    let spec = object.spec(&record.output, format);
    spec.check(record.extent, &app.plans.limits)
        .map_err(|error| in_map(error.into()))?;
    let timing = Timing::queued(ticket.waited());
    let planned = app.plans.plan(client, &ticket, &setup, timing).await?;
    let q = Arc::new(q);
    let (folds, source, quota) = (
        record.folds,
        record.extent,
        app.admission.response_quota(client),
    );
    map_file(
        app,
        &ticket,
        MapJob {
            planned,
            q,
            folds,
            spec,
            source,
            key,
            quota,
        },
    )
    .await
}

/// Poses the grid and computes the first band.
async fn map_file(app: &App, ticket: &Ticket, job: MapJob) -> Result<MapFile, Problem> {
    let MapJob {
        planned:
            Planned {
                setup,
                plan,
                mut timing,
                is_built,
            },
        q,
        folds,
        spec,
        source,
        key,
        quota,
    } = job;
    let drawing = Arc::clone(&app.drawing);
    let prepare = move |cancel: &Cancel| {
        let (began, is_cancelled, limits) =
            (Instant::now(), || cancel.is_cancelled(), drawing.limits);
        let pose = || PosedMesh::new(&setup, &plan, &setup.pose(&q)?, folds, &is_cancelled);
        let (posed, mut held) = drawing.reserve_and_pose(&setup, &quota, (folds, false), pose)?;
        let target = spec
            .target(&posed, source, &limits, &is_cancelled)
            .map_err(|error| in_map(error.into()))?;
        drawing
            .admission
            .reserve_more(&mut held, posed.extra_bytes() + target.window_bytes(&posed))?;
        let map = CoordinateMap::new(&spec, &posed, target)?;
        let report = posed.into_report(
            Some(target.canvas.unwrap_or(Canvas::of(source))),
            &is_cancelled,
        )?;
        timing.deform = began.elapsed();
        stage("deform", began);
        drawing.metrics.prepared(&timing);
        let first = map_band(&drawing.admission, &map, 0, &quota, cancel)?;
        let (etag, canvas, format, length) =
            (map.etag(), target.canvas, map.format(), map.file_bytes());
        let rest = MapBands {
            admission: Arc::clone(&drawing.admission),
            map: Arc::new(map),
            next: 1,
            key,
            quota,
            _held: held,
        };
        Ok::<_, Problem>(MapFile {
            report,
            timing,
            plan_built: is_built,
            etag,
            canvas,
            format,
            length,
            first,
            rest,
        })
    };
    ticket.run(prepare).await?
}

/// Computes a band in memory that counts for the client until it is sent.
fn map_band(
    admission: &Admission,
    map: &CoordinateMap,
    band: u32,
    quota: &ClientQuota,
    cancel: &Cancel,
) -> Result<Bytes, Problem> {
    let mut reservation = admission.reserve_for(MemoryClass::Frame, quota, map.band_bytes())?;
    let bytes = map.band(band, &|| cancel.is_cancelled())?;
    reservation.shrink_to(bytes.len() as u64);
    Ok(reservation.attach(bytes))
}
