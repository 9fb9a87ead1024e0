//! `POST /points` and `/sessions/{id}/points`: annotations, mapped by the exact deformation or its inverse instead of the grid.

use std::sync::Arc;
use std::time::Instant;

use bytes::Bytes;
use mlswarp::warp::{Folds, GridSpec, OutputSpec, Posed, Setup, Warning};

use super::App;
use super::json_text::json_unless;
use super::warp::Resolved;
use crate::client::{Client, Owner};
use crate::limits::client_quota::ClientQuota;
use crate::limits::memory::{Purpose, Reservation};
use crate::observe::scope::stage;
use crate::observe::stages::Timing;
use crate::pool::{Cancel, QueueKey, Ticket, WorkClass};
use crate::problem::{Code, Problem};
use crate::session::SessionId;
use crate::wire::{PointsObject, method_text, reading_bytes};

/// Text of a request up to which one thread is faster than several, bytes.
const MAX_SEQUENTIAL: usize = 4096;

/// The JSON of the response, and the warnings of the handles.
type MappedPoints = (Bytes, Vec<Warning>);

impl App {
    /// Maps points. The second result: the method that was chosen if that was requested, as a header shows it.
    /// Errors: Wrong handles, or too little capacity.
    pub async fn points_once(&self, client: Client, json: Bytes) -> Result<(MappedPoints, Option<String>), Problem> {
        let ticket = self.0.pool.admit(WorkClass::Upload, QueueKey::client(client)).await?;
        let length = json.len();
        let (mut object, reading) = self.read_points(client, &ticket, json, PointsObject::parse).await?;
        let (mut warp, extent) = object.warp.take().ok_or_else(|| Problem::new(Code::Internal, "points without a warp"))?;
        if !object.annotations.is_inverse {
            // The exact deformation needs no grid; this one is within all limits.
            warp.rest.grid = GridSpec::Counts { columns: 2, rows: 2 };
        }
        // Nothing is drawn.
        warp.output = OutputSpec::default();
        let app = self.clone();
        let resolve = move |cancel: &Cancel| app.resolve(warp, extent, cancel);
        let Resolved { setup, held: _held, object: warp, .. } = self.0.pool.run(&ticket, resolve).await??;
        object.q = warp.posed()?.to_vec();
        let method = warp.is_auto.then(|| method_text(&warp.rest));
        let job = PointsJob { owner: client.owner, setup, object, is_long: length > MAX_SEQUENTIAL, reading };
        Ok((self.map(&ticket, self.response_quota(client), job).await?, method))
    }

    /// Maps points by the deformation of a session.
    /// Errors: Unknown session, wrong handles, or too little capacity.
    pub async fn points_session(&self, client: Client, id: SessionId, json: Bytes) -> Result<MappedPoints, Problem> {
        let session = self.touch(id, None).await?;
        let setup = self.session_setup(client, &session.record).await?;
        let ticket = self.0.pool.admit(WorkClass::Upload, QueueKey::session(client, id)).await?;
        let is_long = json.len() > MAX_SEQUENTIAL;
        let record = session.record;
        let parse = move |json: &[u8]| {
            let mut object = PointsObject::parse_posed(json)?;
            object.q = record.rest.posed(object.q, object.strength, record.extent).0;
            Ok(object)
        };
        let (object, reading) = self.read_points(client, &ticket, json, parse).await?;
        self.map(&ticket, self.response_quota(client), PointsJob { owner: id.owner(), setup, object, is_long, reading }).await
    }

    /// Reads a request into memory that is reserved before.
    async fn read_points(
        &self,
        client: Client,
        ticket: &Ticket,
        json: Bytes,
        parse: impl FnOnce(&[u8]) -> Result<PointsObject, Problem> + Send + 'static,
    ) -> Result<(PointsObject, Reservation), Problem> {
        let (app, quota) = (self.clone(), self.request_quota(client));
        let read = move |_: &_| {
            let reading = app.reserve_for(Purpose::Upload, &quota, reading_bytes(&json))?;
            Ok((parse(&json)?, reading))
        };
        self.0.pool.run(ticket, read).await?
    }

    async fn map(&self, ticket: &Ticket, quota: ClientQuota, job: PointsJob) -> Result<MappedPoints, Problem> {
        let PointsJob { owner, mut setup, object: PointsObject { q, annotations, .. }, is_long, reading } = job;
        if annotations.is_inverse {
            setup = Arc::new(setup.to_invert(&self.0.config.limits())?);
        }
        // The posed grid shows where to look for the inverse.
        let planned = if annotations.is_inverse { Some(self.plan(owner, ticket, &setup, Timing::default()).await?) } else { None };
        let app = self.clone();
        let mapped = self.0.pool.run(ticket, move |cancel| {
            let _reading = reading;
            let (began, is_cancelled) = (Instant::now(), || cancel.is_cancelled());
            let posed_bytes = planned.as_ref().map_or(0, |_| setup.posed_bytes());
            let mut reservation = app.reserve_for(Purpose::Frame, &quota, annotations.least_mapped_bytes() + posed_bytes)?;
            let pose = setup.pose(&q)?;
            let map = || {
                let posed = planned.as_ref().map(|planned| Posed::coarse(&setup, &planned.plan, &pose, Folds::Report, &is_cancelled));
                let posed = posed.transpose()?;
                let transform = match &posed {
                    Some(posed) => setup.inverse(&pose, posed.mesh()),
                    None => setup.transform(&pose),
                };
                annotations.map(&transform, &is_cancelled)
            };
            let mapped = if is_long || planned.is_some() { app.0.pool.run_parallel(map) } else { map() }?;
            stage("deform", began);
            let text = mapped.text_bytes();
            // Outlines may have more vertices now.
            app.reserve_more(&mut reservation, text as u64)?;
            let mut body = json_unless(cancel, &mapped, text)?;
            // The client may read it slowly.
            body.shrink_to_fit();
            reservation.shrink_to(body.len() as u64);
            Ok::<_, Problem>((reservation.attach(body), setup.warnings(&pose)))
        });
        mapped.await?
    }
}

/// Annotations and the deformation by which they are mapped.
struct PointsJob {
    owner: Owner,
    setup: Arc<Setup>,
    object: PointsObject,
    is_long: bool,
    /// The memory of the annotations.
    reading: Reservation,
}
