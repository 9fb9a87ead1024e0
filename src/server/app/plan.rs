//! `GET /sessions/{id}/plan`: the coefficients of a session on a lattice, for clients that pose by
//! themselves.

use std::sync::Arc;
use std::time::Instant;

use bytes::Bytes;
use mlswarp::warp::{CoefficientCount, CoefficientRequest, Digest, WarpError};

use super::App;
use super::session_warp::newest_setup;
use crate::client::Client;
use crate::limits::memory::MemoryClass;
use crate::observe::scope::stage;
use crate::observe::stages::Timing;
use crate::pool::{Cancel, QueueKey};
use crate::problem::{Code, Problem};
use crate::session::SessionId;
use crate::store::Record;
use crate::wire::{PlanQuery, Precision, plan_file, plan_file_bytes};

/// Maximum size of the file, bytes: 50 x 50 vertices and all columns that a session may have take
/// more in f32, and 2,000 handles less.
const MAX_FILE_BYTES: u64 = 64 << 20;

/// A table of coefficients.
#[derive(Debug)]
pub(crate) struct PlanFile {
    /// Digest of the request and the build.
    pub(crate) etag: String,
    pub(crate) content: PlanContent,
}

/// What is answered of a table.
#[derive(Debug)]
pub(crate) enum PlanContent {
    /// The client has the file.
    Known,
    /// The length of the file, which was not asked for.
    Length(u64),
    /// Cost and bytes.
    File(Timing, Bytes),
}

/// The coefficients of a session. Does not extend its life. `is_known`: whether the client has
/// the file of an entity tag; `with_content`: whether the file is wanted, and not its length
/// alone. Errors: Unknown session, a table over the limits, a method without a table, or too
/// little capacity.
pub(crate) async fn of_session(
    app: &App,
    client: Client,
    id: SessionId,
    query: PlanQuery,
    is_known: impl Fn(&str) -> bool,
    with_content: bool,
) -> Result<PlanFile, Problem> {
    let record = app.sessions.peek(id).await?.record;
    let etag = etag(app, client, &record, query).await?;
    // No client has the tag of a table that is refused.
    if is_known(&etag) {
        return Ok(PlanFile {
            etag,
            content: PlanContent::Known,
        });
    }
    // Its length does not depend on the system of a spline, and a mask is read with the setup.
    if !with_content && !record.rest.needs_mask() {
        let content = length(app, client, record, query).await?;
        return Ok(PlanFile { etag, content });
    }
    let (newest, setup) = newest_setup(app, client, Arc::clone(&record)).await?;
    let etag = if newest.revision == record.revision {
        etag
    } else {
        self::etag(app, client, &newest, query).await?
    };
    let (
        record,
        PlanQuery {
            columns,
            rows,
            precision,
        },
    ) = (newest, query);
    let key = QueueKey::session(client, id);
    let ticket = app.admission.upload(key).await?;
    let mut timing = Timing::queued(ticket.waited());
    let (app, quota, extent) = (
        app.clone(),
        app.admission.response_quota(client),
        record.extent,
    );
    let fill = move |cancel: &Cancel| {
        let (began, is_cancelled) = (Instant::now(), || cancel.is_cancelled());
        let table =
            CoefficientRequest::new(&setup, columns, rows, &app.plans.limits).map_err(in_query)?;
        let bytes = file_bytes(table.count(), precision)?;
        if !with_content {
            return Ok(PlanContent::Length(bytes));
        }
        let mut reservation =
            app.admission
                .reserve_for(MemoryClass::Frame, &quota, bytes + table.bytes())?;
        let plan = app
            .admission
            .pool
            .run_parallel(|| table.fill(&is_cancelled))?;
        let file = plan_file(&table, &plan, precision, extent, &is_cancelled)?
            .ok_or_else(|| too_imprecise(precision))?;
        drop(plan);
        timing.plan = began.elapsed();
        stage("plan", began);
        reservation.shrink_to(file.len() as u64);
        Ok::<_, Problem>(PlanContent::File(timing, reservation.attach(file)))
    };
    let content = ticket.run(fill).await??;
    Ok(PlanFile { etag, content })
}

/// The length of the file of a session whose handles need no mask.
async fn length(
    app: &App,
    client: Client,
    record: Arc<Record>,
    query: PlanQuery,
) -> Result<PlanContent, Problem> {
    let key = QueueKey::session(client, record.id);
    let (ticket, app) = (app.admission.upload(key).await?, app.clone());
    let count = move |cancel: &Cancel| {
        let (of, limits) = ((&*record.rest, record.extent), &app.plans.limits);
        let _held = app.plans.reserve_unsolved(&record.rest)?;
        let is_cancelled = || cancel.is_cancelled();
        let count = CoefficientCount::new(of, query.columns, query.rows, limits, &is_cancelled);
        file_bytes(count.map_err(in_query)?, query.precision)
    };
    ticket.run(count).await?.map(PlanContent::Length)
}

/// Errors: A longer file than one may be.
fn file_bytes(count: CoefficientCount, precision: Precision) -> Result<u64, Problem> {
    match plan_file_bytes(count, precision) {
        bytes if bytes > MAX_FILE_BYTES => Err(too_large(bytes)),
        bytes => Ok(bytes),
    }
}

/// The digest of the request and the build.
async fn etag(
    app: &App,
    client: Client,
    record: &Arc<Record>,
    query: PlanQuery,
) -> Result<String, Problem> {
    let PlanQuery {
        columns,
        rows,
        precision,
    } = query;
    let rest = app.sessions.text_of(client, record).await?.rest_digest;
    let shape = format!(
        "{} {rest} {columns} {rows} {precision:?}",
        env!("CARGO_PKG_VERSION")
    );
    Ok(format!("\"{}\"", Digest::of(shape.as_bytes())))
}

fn too_large(bytes: u64) -> Problem {
    let detail = format!(
        "the coefficients would take {bytes} bytes; the limit is {MAX_FILE_BYTES}; request fewer \
            vertices"
    );
    Problem::new(Code::TooLarge, detail).limit("plan_file_bytes", MAX_FILE_BYTES, bytes)
}

/// The lattice is in the query, to which no JSON pointer points.
fn in_query(error: WarpError) -> Problem {
    let problem = Problem::from(error);
    Problem {
        pointer: None,
        ..problem
    }
}

fn too_imprecise(precision: Precision) -> Problem {
    let detail = format!(
        "`precision` in the query must be `f32` for these handles: a coefficient is too large for \
            {precision:?}"
    );
    Problem::new(Code::BadValue, detail.to_lowercase())
}
