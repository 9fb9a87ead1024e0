//! `POST /fit` and `/sessions/{id}/fit`: how well methods predict points that they do not know; and
//! the choice of `method: auto`.

use std::sync::Arc;

use bytes::Bytes;
use mlswarp::deform::Handle;
use mlswarp::geometry::Vec2;
use mlswarp::pixmap::Extent;
use mlswarp::warp::{
    Candidate, Prediction, RestSpec, Warning, check_comparison, choose, system_bytes,
};

use super::App;
use super::json_text::cancellable_json;
use super::reading::{Held, part};
use crate::client::Client;
use crate::limits::client_quota::ClientQuota;
use crate::limits::memory::{MemoryClass, Reservation};
use crate::pool::{Cancel, QueueKey, Ticket};
use crate::problem::{Code, Problem};
use crate::store::Record;
use crate::wire::{FitAnswer, FitObject, Pose, Reserved, WarpObject, predictions};

/// Longest text of a residual, bytes: two numbers of 24 characters, brackets, commas.
const RESIDUAL_TEXT: usize = 52;
/// Longest text of a candidate without its lists, bytes.
const CANDIDATE_TEXT: usize = 256;
/// Longest index of an outlier with its comma, bytes.
const OUTLIER_TEXT: usize = 5;

/// The JSON of the response, and the warnings of the points.
type ComparedFit = (Bytes, Vec<Warning>);

/// The points at rest, and the size of their image.
enum FitRest {
    Request(Box<Held<(RestSpec, Extent)>>),
    Session(Arc<Record>),
}

impl FitRest {
    /// With the pose of the session.
    fn parts(&self) -> (&RestSpec, Extent, Option<&Pose>) {
        match self {
            Self::Request(rest) => (&rest.0, rest.1, None),
            Self::Session(record) => (&*record.rest, record.extent, record.pose.as_deref()),
        }
    }
}

/// Compares methods on the points of the body.
/// Errors: Wrong points or candidates, or too little capacity.
pub(crate) async fn once(app: &App, client: Client, json: Bytes) -> Result<ComparedFit, Problem> {
    let ticket = app.admission.upload(QueueKey::client(client)).await?;
    let reserve = app.admission.reserving(MemoryClass::Upload, client);
    let mut object = ticket
        .run(move |_| Reserved::<FitObject, _>::parse(&json, reserve))
        .await??;
    let rest = part(&mut object, |object| object.rest.take());
    let rest = rest
        .try_map(|rest| rest.ok_or_else(|| Problem::new(Code::Internal, "a fit without points")))?;
    compare(
        app,
        &ticket,
        app.admission.response_quota(client),
        FitRest::Request(Box::new(rest)),
        object,
    )
    .await
}

/// Compares methods on the points of a session.
/// Errors: Wrong `q` or candidates, lines, or too little capacity.
pub(crate) async fn of_session(
    app: &App,
    client: Client,
    record: Arc<Record>,
    json: Bytes,
) -> Result<ComparedFit, Problem> {
    let key = QueueKey::session(client, record.id);
    let ticket = app.admission.upload(key).await?;
    let reserve = app
        .admission
        .reserving_pose(MemoryClass::Upload, client, &record);
    let object = ticket
        .run(move |_| Reserved::<FitObject, _>::parse_posed(&json, reserve))
        .await??;
    compare(
        app,
        &ticket,
        app.admission.response_quota(client),
        FitRest::Session(record),
        object,
    )
    .await
}

async fn compare(
    app: &App,
    ticket: &Ticket,
    quota: ClientQuota,
    rest: FitRest,
    object: Held<FitObject>,
) -> Result<ComparedFit, Problem> {
    let (app, warnings) = (app.clone(), rest.parts().0.left_out().collect());
    let work = move |cancel: &Cancel| {
        let (rest, extent, session) = rest.parts();
        let FitObject {
            pose, candidates, ..
        } = &*object;
        let (q, _) = rest.posed(pose.clone().onto(session)?.q, 1.0, extent);
        let text = candidates.len()
            * (CANDIDATE_TEXT
                + (RESIDUAL_TEXT + OUTLIER_TEXT) * rest.p.len().min(app.config().max_fit_handles));
        let reservation = app
            .admission
            .reserve_for(MemoryClass::Frame, &quota, text as u64)?;
        let predictions = predict(&app, rest, &q, extent, candidates, cancel)?;
        let body = cancellable_json(cancel, &FitAnswer(&predictions), text)?;
        Ok::<_, Problem>(reservation.attach_exact(body))
    };
    Ok((ticket.run(work).await??, warnings))
}

/// Runs on the pool, and uses all of its threads.
fn predict(
    app: &App,
    rest: &RestSpec,
    q: &[Handle],
    extent: Extent,
    candidates: &[Candidate],
    cancel: &Cancel,
) -> Result<Vec<Prediction>, Problem> {
    check_comparison(
        rest.p.len().min(app.config().max_fit_handles),
        candidates,
        &app.plans.limits,
    )?;
    let _held = reserve_comparison(app, rest, candidates)?;
    let is_cancelled = || cancel.is_cancelled();
    let most = app.config().max_fit_handles as u64;
    app.admission
        .pool
        .run_parallel(|| predictions(rest, q, extent, candidates, most, &is_cancelled))
}

/// The memory of a comparison: one system at a time, and all residuals.
fn reserve_comparison(
    app: &App,
    rest: &RestSpec,
    candidates: &[Candidate],
) -> Result<Reservation, Problem> {
    let count = (rest.p.len() as u64).min(app.config().max_fit_handles as u64);
    let system = candidates
        .iter()
        .map(|candidate| system_bytes(candidate.method, count))
        .max()
        .unwrap_or_default();
    app.admission.reserve(
        MemoryClass::Plan,
        system + candidates.len() as u64 * count * size_of::<Vec2>() as u64,
    )
}

/// Replaces the method `auto` by the one that fits best. Runs on the pool.
/// Errors: No `q`, lines, too many points, or too little memory.
pub(crate) fn choose_method(
    app: &App,
    object: &mut WarpObject,
    extent: Extent,
    cancel: &Cancel,
) -> Result<(), Problem> {
    if object.is_auto {
        object.require_choice()?;
        check_comparison(
            object.rest.p.len().min(app.config().max_fit_handles),
            &Candidate::defaults(),
            &app.plans.limits,
        )?;
        let _held = reserve_comparison(app, &object.rest, &Candidate::defaults())?;
        let (rest, q, most) = (
            &object.rest,
            object.posed()?,
            app.config().max_fit_handles as u64,
        );
        let chosen = app
            .admission
            .pool
            .run_parallel(|| choose(rest, q, extent, most, &|| cancel.is_cancelled()))?;
        object.choose(chosen);
    }
    Ok(())
}
