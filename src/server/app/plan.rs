//! `GET /sessions/{id}/plan`: the coefficients of a session on a lattice, for clients that pose by themselves.

use std::time::Instant;

use bytes::Bytes;
use mlswarp::warp::{Digest, Table, WarpError};

use super::App;
use crate::client::Client;
use crate::limits::memory::Purpose;
use crate::observe::scope::stage;
use crate::observe::stages::Timing;
use crate::pool::{Cancel, QueueKey, WorkClass};
use crate::problem::{Code, Problem};
use crate::session::SessionId;
use crate::wire::{PlanQuery, Precision, plan_file, plan_file_bytes};

/// Maximum size of the file, bytes: 50 x 50 vertices and all columns that a session may have take more in f32, and 2,000 handles less.
const MAX_FILE_BYTES: u64 = 64 << 20;

/// A table of coefficients as a file.
#[derive(Debug)]
pub(crate) struct PlanFile {
    /// Digest of the request and the build.
    pub(crate) etag: String,
    /// Cost and bytes; `None` if the client has the file.
    pub(crate) file: Option<(Timing, Bytes)>,
}

impl App {
    /// The coefficients of a session. Does not extend its life. `is_known`: whether the client has the file of an entity tag.
    /// Errors: Unknown session, a table over the limits, a method without a table, or too little capacity.
    pub(crate) async fn plan_of_session(
        &self,
        client: Client,
        id: SessionId,
        query: PlanQuery,
        is_known: impl Fn(&str) -> bool,
    ) -> Result<PlanFile, Problem> {
        let record = self.peek_session(id).await?.record;
        let setup = self.session_setup(client, &record).await?;
        let PlanQuery { columns, rows, precision } = query;
        let table = Table::new(&setup, columns, rows, &self.0.config.limits()).map_err(in_query)?;
        let bytes = plan_file_bytes(&table, precision);
        if bytes > MAX_FILE_BYTES {
            let detail = format!("the coefficients would take {bytes} bytes; the limit is {MAX_FILE_BYTES}; request fewer vertices");
            return Err(Problem::new(Code::TooLarge, detail).limit("plan_file_bytes", MAX_FILE_BYTES, bytes));
        }
        let shape = format!("{} {} {columns} {rows} {precision:?}", env!("CARGO_PKG_VERSION"), table.rest_digest());
        let etag = format!("\"{}\"", Digest::of(shape.as_bytes()));
        if is_known(&etag) {
            return Ok(PlanFile { etag, file: None });
        }
        let ticket = self.0.pool.admit(WorkClass::Upload, QueueKey::session(client, id)).await?;
        let mut timing = Timing { queue: ticket.waited(), ..Timing::default() };
        let (app, quota, extent) = (self.clone(), self.response_quota(client), record.extent);
        let fill = move |cancel: &Cancel| {
            let (began, is_cancelled) = (Instant::now(), || cancel.is_cancelled());
            let mut reservation = app.reserve_for(Purpose::Frame, &quota, bytes + table.bytes())?;
            let plan = app.0.pool.run_parallel(|| table.fill_unless(&is_cancelled))?;
            let file = plan_file(&table, &plan, precision, extent, &is_cancelled)?.ok_or_else(|| too_imprecise(precision))?;
            drop(plan);
            timing.plan = began.elapsed();
            stage("plan", began);
            reservation.shrink_to(file.len() as u64);
            Ok::<_, Problem>((timing, reservation.attach(file)))
        };
        let file = self.0.pool.run(&ticket, fill).await??;
        Ok(PlanFile { etag, file: Some(file) })
    }
}

/// The lattice is in the query, to which no JSON pointer points.
fn in_query(error: WarpError) -> Problem {
    let problem = Problem::from(error);
    Problem { pointer: None, ..problem }
}

fn too_imprecise(precision: Precision) -> Problem {
    let detail = format!("`precision` in the query must be `f32` for these handles: a coefficient is too large for {precision:?}");
    Problem::new(Code::BadValue, detail.to_lowercase())
}
