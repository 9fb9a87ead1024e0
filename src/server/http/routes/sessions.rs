//! `/sessions`: creating, reading, changing and deleting sessions.

use std::time::{Duration, SystemTime};

use axum::extract::{Path, Request};
use axum::http::header::LOCATION;
use axum::http::{HeaderValue, StatusCode};
use axum::response::{IntoResponse as _, Response};
use data_encoding::HEXLOWER;
use mlswarp::deform::Coincident;
use mlswarp::warp::{Align, Setup};

use crate::app::App;
use crate::app::warp::Upload;
use crate::client::Client;
use crate::http::middleware::authentication::Caller;
use crate::http::response::{json_text, with_method, with_warnings};
use crate::http::upload;
use crate::layer::MAX_LAYERS;
use crate::limits::memory::{Purpose, Reservation};
use crate::problem::words::quote;
use crate::problem::{Code, Problem};
use crate::session::SessionId;
use crate::store::{Put, Session};
use crate::wire::landmarks::Target;
use crate::wire::{AsJson, CoincidentGroup, SessionGrid, SessionImage, SessionLayer, SessionObject, rest_revision};

const EXAMPLE_ID: &str = "0f8fad5b-d9cb-469f-a165-70867728950e";
/// Maximum length of a number and its comma in JSON.
const NUMBER: usize = 25;
/// Maximum length of a session object without the client's lists: names, ids, dates, single numbers and layers.
const FIXED_PART: usize = 2048 + 128 * MAX_LAYERS;

/// Creates a session. Its picture is decoded and its table filled before the first drag.
pub(crate) async fn create(caller: Caller, request: Request) -> Result<Response, Problem> {
    let upload = upload::read(&caller, request).await?;
    let held = reserve_object(&caller, &upload)?;
    let (session, setup, method) = caller.app.create_session(caller.client, upload).await?;
    Ok(with_method(created(&caller, &session, object(held, &session, &setup)), method))
}

/// Creates or replaces the session with an id that the client chose: 201 if it is new, otherwise 200.
pub(crate) async fn put(caller: Caller, Path(id): Path<String>, request: Request) -> Result<Response, Problem> {
    let id = SessionId::parse(caller.client.owner, &id).ok_or_else(|| Problem::new(Code::BadValue, not_an_id(&id)))?;
    let upload = upload::read(&caller, request).await?;
    let held = reserve_object(&caller, &upload)?;
    let (put, setup, method) = caller.app.put_session(caller.client, id, upload).await?;
    let response = match put {
        Put::Created(session) => created(&caller, &session, object(held, &session, &setup)),
        Put::Same(session) | Put::Replaced(session, _) => object(held, &session, &setup),
    };
    Ok(with_method(response, method))
}

/// Replaces the rest handles of a session.
pub(crate) async fn handles(caller: Caller, Path(id): Path<String>, request: Request) -> Result<Response, Problem> {
    let Caller { app, client } = &caller;
    let id = session_id(*client, &id)?;
    let target = Target::Session(app.peek_session(id).await?.record.extent);
    let limit = ("warp_json_bytes", app.config().max_warp_json_bytes);
    let body = upload::json_or_form(&caller, request, Purpose::Upload, limit, target).await?;
    let (session, setup, method) = app.replace_handles(*client, id, body).await?;
    Ok(with_method(reserved_object(&caller, &session, &setup)?, method))
}

/// The session object. Reading does not extend the session's life.
pub(crate) async fn read(caller: Caller, Path(id): Path<String>) -> Result<Response, Problem> {
    let session = caller.app.peek_session(session_id(caller.client, &id)?).await?;
    let setup = caller.app.session_setup(caller.client, &session.record).await?;
    reserved_object(&caller, &session, &setup)
}

/// Deletes a session.
pub(crate) async fn delete(caller: Caller, Path(id): Path<String>) -> Result<StatusCode, Problem> {
    caller.app.delete_session(session_id(caller.client, &id)?).await?;
    Ok(StatusCode::NO_CONTENT)
}

fn created(caller: &Caller, session: &Session, object: Response) -> Response {
    (StatusCode::CREATED, [(LOCATION, location(&caller.app, session.record.id))], object).into_response()
}

/// The path of a session as clients see it.
pub(super) fn location(app: &App, id: SessionId) -> HeaderValue {
    HeaderValue::try_from(format!("{}/sessions/{id}", app.config().public_path)).expect("a public path and a UUID are visible ASCII")
}

/// The session that a path names. A text that is no id names no session.
pub(crate) fn session_id(client: Client, text: &str) -> Result<SessionId, Problem> {
    let none = || Problem::new(Code::NoSuchSession, format!("{}; POST /sessions opens a session and returns its id", not_an_id(text)));
    SessionId::parse(client.owner, text).ok_or_else(none)
}

fn not_an_id(text: &str) -> String {
    if text.is_empty() {
        return "the id of the session is empty in the path, as if a variable of a script were empty".to_owned();
    }
    format!("{} is not a session id: a session id is a hyphenated UUID of version 4, such as {EXAMPLE_ID}", quote(text))
}

/// The session object, whose memory counts for the client until it is sent.
pub(super) fn reserved_object(caller: &Caller, session: &Session, setup: &Setup) -> Result<Response, Problem> {
    let text = text(session, setup);
    let held = caller.app.reserve_for(Purpose::Frame, &caller.app.response_quota(caller.client), text.len() as u64)?;
    Ok(with_warnings(json_text(held.attach(text)), setup.rest_warnings()))
}

/// Reserves the memory of the session object before the session is created, which must not fail afterwards.
fn reserve_object(caller: &Caller, upload: &Upload) -> Result<Reservation, Problem> {
    let Caller { app, client } = caller;
    let landmarks = upload.landmarks.as_ref().map_or(0, |landmarks| landmarks.text_length() as u64);
    // Two coordinates on either side, and an index in a group of coincident points.
    let length = 2 * landmarks + landmarks / 2 + max_object_length(&upload.warp, app.config().limits().columns);
    app.reserve_for(Purpose::Frame, &app.response_quota(*client), length)
}

fn object(mut held: Reservation, session: &Session, setup: &Setup) -> Response {
    let text = text(session, setup);
    held.shrink_to(text.len() as u64);
    with_warnings(json_text(held.attach(text)), setup.rest_warnings())
}

/// Maximum length of the session object for a warp object. Strings are returned unchanged or not at all, and a bracket or a comma precedes
/// every number of a list. A column has at most 6 numbers: 2 coordinates on
/// either side, a weight, and an index in a group of coincident points.
fn max_object_length(warp: &[u8], columns: usize) -> u64 {
    let numbers = warp.iter().filter(|byte| matches!(byte, b'[' | b',')).count();
    (FIXED_PART + warp.len() + NUMBER * numbers.min(columns.saturating_mul(6))) as u64
}

fn text(session: &Session, setup: &Setup) -> Vec<u8> {
    let record = &session.record;
    let (columns, rows) = setup.grid();
    let object = SessionObject {
        id: &record.id.to_string(),
        image: SessionImage { width: record.extent.width(), height: record.extent.height(), digest: AsJson(record.image) },
        p: AsJson(&record.rest.p),
        q: record.pose.as_ref().map(|pose| AsJson(pose.q.as_slice())),
        strength: record.pose.as_ref().map(|pose| pose.strength).filter(|strength| strength.to_bits() != 1.0_f64.to_bits()),
        weights: record.rest.weights.as_deref(),
        method: AsJson(record.rest.method),
        alpha: setup.alpha(),
        point_mass: setup.point_mass(),
        smoothing: setup.smoothing(),
        coincident_policy: (record.rest.coincident != Coincident::default()).then_some(AsJson(record.rest.coincident)),
        coincident: setup.groups().into_iter().map(|handles| CoincidentGroup { handles }).collect(),
        units: AsJson(record.rest.units),
        align: (record.rest.align != Align::None).then_some(AsJson(record.rest.align)),
        grid: SessionGrid { columns, rows, cell: setup.cell().into(), requested: AsJson(record.rest.grid) },
        rest_revision: &HEXLOWER.encode(&rest_revision(setup.rest_digest())),
        folds: AsJson(record.folds),
        output: AsJson(&record.output),
        layers: record.layers.iter().map(|(name, layer)| (name.as_str(), SessionLayer { kind: AsJson(layer.kind) })).collect(),
        created: &rfc3339(record.created),
        expires: &rfc3339(session.expires),
        seq: session.seq,
    };
    serde_json::to_vec(&object).expect("an object of the contract has string keys")
}

/// `2026-11-21T09:30:00.125Z`. A time outside the years 1970 to 9999, which humantime cannot write, becomes the nearest one inside.
fn rfc3339(time: SystemTime) -> String {
    let last = SystemTime::UNIX_EPOCH + Duration::from_secs(253_402_300_799);
    humantime::format_rfc3339_millis(time.clamp(SystemTime::UNIX_EPOCH, last)).to_string()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn dates_are_those_of_the_calendar() {
        for (seconds, date) in [
            (0, "1970-01-01T00:00:00.000Z"),
            (951_782_400, "2000-02-29T00:00:00.000Z"),
            (951_868_799, "2000-02-29T23:59:59.000Z"),
            (1_709_164_800, "2024-02-29T00:00:00.000Z"),
            (4_107_542_399, "2100-02-28T23:59:59.000Z"),
            (4_107_542_400, "2100-03-01T00:00:00.000Z"),
            (1_798_761_599, "2026-12-31T23:59:59.000Z"),
        ] {
            assert_eq!(rfc3339(SystemTime::UNIX_EPOCH + Duration::from_secs(seconds)), date);
        }
        assert_eq!(rfc3339(SystemTime::UNIX_EPOCH + Duration::from_millis(86_400_125)), "1970-01-02T00:00:00.125Z");
    }

    #[test]
    fn room_for_an_object_is_enough_for_the_longest() {
        // Numbers that are short as they come, and long as they are written; and one of everything that there is.
        let many = |what: &str| vec![what; 500].join(",");
        let longest = f64::MIN_POSITIVE * -1.000_000_000_000_000_2;
        let (points, lines) = (many("[1,2]"), many("[[1,2],[3,4],[5,6]]"));
        for (warp, numbers) in [(format!(r#"{{"p":[{points}]}}"#), 1000), (format!(r#"{{"p":[{lines}],"weights":[{}]}}"#, many("1")), 3500)]
        {
            let written = warp.len() - numbers + numbers * serde_json::to_string(&longest).unwrap().len();
            assert!(max_object_length(warp.as_bytes(), 2000) >= (written + 1024) as u64, "{written}");
        }
        // Four megabytes that name no handle at all.
        assert!(max_object_length(&vec![b'['; 4 << 20], 10_000) < 6 << 20);
    }
}
