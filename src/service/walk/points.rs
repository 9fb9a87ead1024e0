//! Places, mapped by f exactly and not by the grid.

use std::sync::Arc;
use std::time::Instant;

use bytes::Bytes;

use crate::deform::Handle;
use crate::geometry::Point;
use crate::service::App;
use crate::service::client::Client;
use crate::service::pool::{Lane, Ticket, Work};
use crate::service::problem::{Code, Problem};
use crate::service::session::SessionId;
use crate::service::telemetry::scope::stage;
use crate::service::wire::PointsObject;
use crate::warp::{GridSpec, Setup, WarpError};

/// Places mapped between two looks at whether the client is still there.
const PLACES_PER_STEP: usize = 4096;

/// Places that are mapped sooner than other threads wake.
const PLACES_ALONE: usize = 256;

impl App {
    /// Maps places by f exactly.
    ///
    /// # Errors
    /// Whatever is wrong with the handles, or no room.
    pub async fn map_once(&self, client: Client, json: Bytes) -> Result<Vec<Point>, Problem> {
        let ticket = self.0.pool.admit(Work::Upload, Lane::client(client)).await?;
        let object = self.0.pool.run(&ticket, move |_| PointsObject::parse(&json)).await??;
        let (mut rest, extent) = object.warp.ok_or_else(|| Problem::new(Code::Internal, "points without a warp"))?;
        // Places are mapped by the exact function: the grid, and its limits, do not matter.
        rest.grid = GridSpec::Counts { columns: 2, rows: 2 };
        let limits = self.0.config.limits;
        let setup = self.0.pool.run(&ticket, move |_| Setup::new(&rest, extent, &limits)).await??;
        self.map(&ticket, Arc::new(setup), object.q, object.points).await
    }

    /// Maps places by f of a session.
    ///
    /// # Errors
    /// Unknown session, whatever is wrong with the handles, or no room.
    pub async fn map_session(&self, id: SessionId, json: Bytes) -> Result<Vec<Point>, Problem> {
        let session = self.0.store.touch(id, None).await?;
        let setup = self.session_setup(&session.record).await?;
        let ticket = self.0.pool.admit(Work::Upload, Lane::Session(id)).await?;
        let object = self.0.pool.run(&ticket, move |_| PointsObject::parse_posed(&json)).await??;
        self.map(&ticket, setup, object.q, object.points).await
    }

    async fn map(&self, ticket: &Ticket, setup: Arc<Setup>, q: Vec<Handle>, places: Vec<Point>) -> Result<Vec<Point>, Problem> {
        let pool = self.0.pool.clone();
        let mapped = self.0.pool.run(ticket, move |cancel| {
            let began = Instant::now();
            let pose = setup.pose(&q)?;
            let mut mapped = Vec::with_capacity(places.len());
            for (k, step) in places.chunks(PLACES_PER_STEP).enumerate() {
                if cancel.is_cancelled() {
                    return Err(WarpError::GivenUp);
                }
                let map = || setup.map(&pose, step);
                let step = if step.len() > PLACES_ALONE { pool.spread(map) } else { map() };
                mapped.extend(step.map_err(|e| e.with_place_offset(k * PLACES_PER_STEP))?);
            }
            stage("deform", began);
            Ok::<_, WarpError>(mapped)
        });
        Ok(mapped.await??)
    }
}
