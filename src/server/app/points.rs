//! `POST /points` and `/sessions/{id}/points`: annotations, mapped by the exact deformation or its inverse instead of the grid.

use std::sync::Arc;
use std::time::Instant;

use bytes::Bytes;
use mlswarp::deform::Handle;
use mlswarp::warp::{Folds, GridSpec, OutputSpec, Posed, Warning};

use super::App;
use super::json_text::json_unless;
use super::reading::{Held, part};
use super::warp::{HeldSetup, Resolved};
use crate::cache::CacheEntry;
use crate::client::Client;
use crate::limits::client_quota::ClientQuota;
use crate::limits::memory::Purpose;
use crate::observe::scope::stage;
use crate::observe::stages::Timing;
use crate::pool::{Cancel, QueueKey, Ticket, WorkClass};
use crate::problem::{Code, Problem};
use crate::session::SessionId;
use crate::wire::{PointsObject, Reserved, method_text};

/// Text of a request up to which one thread is faster than several, bytes.
const MAX_SEQUENTIAL: usize = 4096;

/// The JSON of the response, and the warnings of the handles.
type MappedPoints = (Bytes, Vec<Warning>);

impl App {
    /// Maps points. The second result: the method that was chosen if that was requested, as a header shows it.
    /// Errors: Wrong handles, or too little capacity.
    pub async fn points_once(&self, client: Client, json: Bytes) -> Result<(MappedPoints, Option<String>), Problem> {
        let ticket = self.0.pool.admit(WorkClass::Upload, QueueKey::client(client)).await?;
        let (length, reserve) = (json.len(), self.reserving(Purpose::Upload, client));
        let read = move |_: &_| Reserved::<PointsObject, _>::parse(&json, reserve);
        let mut object = self.0.pool.run(&ticket, read).await??;
        let is_inverse = object.annotations.is_inverse;
        let warp = part(&mut object, |object| object.warp.take());
        let warp = warp.try_map(|warp| warp.ok_or_else(|| Problem::new(Code::Internal, "points without a warp")))?;
        let (extent, mut warp) = (warp.1, warp.map(|(warp, _)| warp));
        if !is_inverse {
            // The exact deformation needs no grid; this one is within all limits.
            warp.rest.grid = GridSpec::Counts { columns: 2, rows: 2 };
        }
        // Nothing is drawn.
        warp.output = OutputSpec::default();
        let app = self.clone();
        let resolve = move |cancel: &Cancel| app.resolve(warp, extent, cancel);
        let Resolved { setup, object: warp, q, .. } = self.0.pool.run(&ticket, resolve).await??;
        let method = warp.is_auto.then(|| method_text(&warp.rest));
        let job = PointsJob { client, setup, q, object, is_long: length > MAX_SEQUENTIAL };
        Ok((self.map(&ticket, self.response_quota(client), job).await?, method))
    }

    /// Maps points by the deformation of a session.
    /// Errors: Unknown session, wrong handles, or too little capacity.
    pub async fn points_session(&self, client: Client, id: SessionId, json: Bytes) -> Result<MappedPoints, Problem> {
        let session = self.touch(id, None).await?;
        let setup = self.session_setup(client, &session.record).await?;
        let ticket = self.0.pool.admit(WorkClass::Upload, QueueKey::session(client, id)).await?;
        let is_long = json.len() > MAX_SEQUENTIAL;
        let (record, reserve) = (session.record, self.reserving(Purpose::Upload, client));
        let read = move |_: &_| {
            let mut object = Reserved::<PointsObject, _>::parse_posed(&json, reserve)?;
            let (strength, extent) = (object.strength, record.extent);
            let q = part(&mut object, |object| record.rest.posed(std::mem::take(&mut object.q), strength, extent).0);
            Ok::<_, Problem>((object, q))
        };
        let (object, q) = self.0.pool.run(&ticket, read).await??;
        self.map(&ticket, self.response_quota(client), PointsJob { client, setup, q, object, is_long }).await
    }

    async fn map(&self, ticket: &Ticket, quota: ClientQuota, job: PointsJob) -> Result<MappedPoints, Problem> {
        let PointsJob { client, mut setup, q, object, is_long } = job;
        let is_inverse = object.annotations.is_inverse;
        if is_inverse {
            setup = self.to_invert(ticket, &setup).await?;
        }
        // The posed grid shows where to look for the inverse.
        let planned = if is_inverse { Some(self.plan(client, ticket, &setup, Timing::default()).await?) } else { None };
        let app = self.clone();
        let mapped = self.0.pool.run(ticket, move |cancel| {
            // The memory of the annotations.
            let (PointsObject { annotations, .. }, _held) = object.into_parts();
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

    /// The setup whose grid shows where to look for the inverse.
    pub(super) async fn to_invert(&self, ticket: &Ticket, setup: &HeldSetup) -> Result<HeldSetup, Problem> {
        let (app, setup) = (self.clone(), Arc::clone(setup));
        let resolve = move |_: &_| {
            // It shares most of its memory with the other one, and may outlive it.
            let held = app.reserve(Purpose::Plan, setup.bytes())?;
            Ok(Arc::new(CacheEntry::new(setup.to_invert(&app.0.config.limits())?, held)))
        };
        self.0.pool.run(ticket, resolve).await?
    }
}

/// Annotations and the deformation by which they are mapped.
struct PointsJob {
    client: Client,
    setup: HeldSetup,
    q: Held<Vec<Handle>>,
    object: Held<PointsObject>,
    is_long: bool,
}
