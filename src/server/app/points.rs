//! `POST /points` and `/sessions/{id}/points`: points, mapped by the exact deformation instead of the grid.

use std::sync::Arc;
use std::time::Instant;

use bytes::Bytes;
use mlswarp::geometry::Point;
use mlswarp::warp::{GridSpec, OutputSpec, Setup, Warning};
use serde::Serialize;

use super::App;
use super::json_text::json_unless;
use super::warp::Resolved;
use crate::client::Client;
use crate::limits::client_quota::ClientQuota;
use crate::limits::memory::Purpose;
use crate::observe::scope::stage;
use crate::pool::{Cancel, QueueKey, Ticket, WorkClass};
use crate::problem::{Code, Problem};
use crate::session::SessionId;
use crate::wire::{AsJson, PointsObject, method_text};

/// Number of points up to which one thread is faster than several.
const MAX_SEQUENTIAL: usize = 256;

/// Longest text of a mapped point, bytes: two numbers of 24 characters, brackets, commas.
const POINT_TEXT: usize = 52;

/// Length of the response without its points, bytes.
const EMPTY_TEXT: usize = r#"{"points":[]}"#.len();

/// The response.
#[derive(Serialize)]
struct Mapped<'a> {
    points: AsJson<&'a [Point]>,
}

/// The JSON of the response, and the warnings of the handles.
type MappedPoints = (Bytes, Vec<Warning>);

impl App {
    /// Maps points. The second result: the method that was chosen if that was requested, as a header shows it.
    /// Errors: Wrong handles, or too little capacity.
    pub async fn map_once(&self, client: Client, json: Bytes) -> Result<(MappedPoints, Option<String>), Problem> {
        let ticket = self.0.pool.admit(WorkClass::Upload, QueueKey::client(client)).await?;
        let mut object = self.0.pool.run(&ticket, move |_| PointsObject::parse(&json)).await??;
        let (mut warp, extent) = object.warp.take().ok_or_else(|| Problem::new(Code::Internal, "points without a warp"))?;
        // The exact deformation needs no grid; this one is within all limits.
        warp.rest.grid = GridSpec::Counts { columns: 2, rows: 2 };
        // Nothing is drawn.
        warp.output = OutputSpec::default();
        let app = self.clone();
        let resolve = move |cancel: &Cancel| app.resolve(warp, extent, cancel);
        let Resolved { setup, held: _held, object: warp } = self.0.pool.run(&ticket, resolve).await??;
        let method = warp.is_auto.then(|| method_text(&warp.rest));
        Ok((self.map(&ticket, self.response_quota(client), setup, object).await?, method))
    }

    /// Maps points by the deformation of a session.
    /// Errors: Unknown session, wrong handles, or too little capacity.
    pub async fn map_session(&self, client: Client, id: SessionId, json: Bytes) -> Result<MappedPoints, Problem> {
        let session = self.touch(id, None).await?;
        let setup = self.session_setup(client, &session.record).await?;
        let ticket = self.0.pool.admit(WorkClass::Upload, QueueKey::session(client, id)).await?;
        let object = self.0.pool.run(&ticket, move |_| PointsObject::parse_posed(&json)).await??;
        self.map(&ticket, self.response_quota(client), setup, object).await
    }

    async fn map(&self, ticket: &Ticket, quota: ClientQuota, setup: Arc<Setup>, object: PointsObject) -> Result<MappedPoints, Problem> {
        let app = self.clone();
        let mapped = self.0.pool.run(ticket, move |cancel| {
            let began = Instant::now();
            let PointsObject { q, points, .. } = object;
            let text = EMPTY_TEXT + POINT_TEXT * points.len();
            let mut reservation = app.reserve_for(Purpose::Frame, &quota, (text + size_of_val(points.as_slice())) as u64)?;
            let pose = setup.pose(&q)?;
            let map = || setup.map(&pose, &points, &|| cancel.is_cancelled());
            let mapped = if points.len() > MAX_SEQUENTIAL { app.0.pool.run_parallel(map) } else { map() }?;
            stage("deform", began);
            let mut body = json_unless(cancel, &Mapped { points: AsJson(&mapped) }, text)?;
            // The client may read it slowly.
            body.shrink_to_fit();
            reservation.shrink_to(body.len() as u64);
            Ok::<_, Problem>((reservation.attach(body), setup.warnings(&pose)))
        });
        mapped.await?
    }
}
