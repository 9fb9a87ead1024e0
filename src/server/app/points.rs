//! Places, mapped by f exactly and not by the grid.

use std::sync::Arc;
use std::time::Instant;

use bytes::Bytes;
use mlswarp::geometry::Point;
use mlswarp::warp::{GridSpec, Setup};
use serde::Serialize;

use super::App;
use super::warp::json_unless;
use crate::client::Client;
use crate::limits::client_quota::Share;
use crate::limits::memory::Purpose;
use crate::observe::scope::stage;
use crate::pool::{QueueKey, Ticket, WorkClass};
use crate::problem::{Code, Problem};
use crate::session::SessionId;
use crate::wire::{AsJson, PointsObject};

/// Places that are mapped sooner than other threads wake.
const PLACES_ALONE: usize = 256;

/// Longest text of a mapped place, bytes: two numbers of 24 characters, brackets, commas.
const PLACE_TEXT: usize = 52;

/// Length of the answer around its places, bytes.
const AROUND: usize = r#"{"points":[]}"#.len();

/// The answer.
#[derive(Serialize)]
struct Mapped<'a> {
    points: AsJson<&'a [Point]>,
}

impl App {
    /// Maps places by f exactly, into the JSON of the answer.
    ///
    /// # Errors
    /// Whatever is wrong with the handles, or no room.
    pub async fn map_once(&self, client: Client, json: Bytes) -> Result<Bytes, Problem> {
        let ticket = self.0.pool.admit(WorkClass::Upload, QueueKey::client(client)).await?;
        let mut object = self.0.pool.run(&ticket, move |_| PointsObject::parse(&json)).await??;
        let (mut rest, extent) = object.warp.take().ok_or_else(|| Problem::new(Code::Internal, "points without a warp"))?;
        // Places are mapped by the exact function: the grid, and its limits, do not matter.
        rest.grid = GridSpec::Counts { columns: 2, rows: 2 };
        let limits = self.0.config.limits();
        let setup = self.0.pool.run(&ticket, move |cancel| Setup::new_unless(&rest, extent, &limits, &|| cancel.is_cancelled())).await??;
        self.map(&ticket, self.share(client), Arc::new(setup), object).await
    }

    /// Maps places by f of a session, into the JSON of the answer.
    ///
    /// # Errors
    /// Unknown session, whatever is wrong with the handles, or no room.
    pub async fn map_session(&self, client: Client, id: SessionId, json: Bytes) -> Result<Bytes, Problem> {
        let session = self.touch(id, None).await?;
        let setup = self.session_setup(client, &session.record).await?;
        let ticket = self.0.pool.admit(WorkClass::Upload, QueueKey::session(client, id)).await?;
        let object = self.0.pool.run(&ticket, move |_| PointsObject::parse_posed(&json)).await??;
        self.map(&ticket, self.share(client), setup, object).await
    }

    async fn map(&self, ticket: &Ticket, share: Share, setup: Arc<Setup>, object: PointsObject) -> Result<Bytes, Problem> {
        let app = self.clone();
        let mapped = self.0.pool.run(ticket, move |cancel| {
            let began = Instant::now();
            let PointsObject { q, points: places, .. } = object;
            let text = AROUND + PLACE_TEXT * places.len();
            let mut held = app.reserve_for(Purpose::Frame, &share, (text + size_of_val(places.as_slice())) as u64)?;
            let pose = setup.pose(&q)?;
            let map = || setup.map(&pose, &places, &|| cancel.is_cancelled());
            let mapped = if places.len() > PLACES_ALONE { app.0.pool.run_parallel(map) } else { map() }?;
            stage("deform", began);
            let mut body = json_unless(cancel, &Mapped { points: AsJson(&mapped) }, text)?;
            // It may wait long for its reader.
            body.shrink_to_fit();
            held.shrink_to(body.len() as u64);
            Ok::<_, Problem>(held.attach(body))
        });
        mapped.await?
    }
}
