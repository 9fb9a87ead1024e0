//! `/sessions`: made of a file and rest handles, looked at, ended.

use std::time::SystemTime;

use axum::Extension;
use axum::extract::{Path, Request, State};
use axum::http::header::LOCATION;
use axum::http::{HeaderValue, StatusCode};
use axum::response::{IntoResponse as _, Response};
use mlswarp::warp::Setup;

use crate::app::App;
use crate::client::Client;
use crate::http::response::json_text;
use crate::http::{body, upload};
use crate::limits::memory::{Purpose, Reservation};
use crate::problem::{Code, Problem};
use crate::session::SessionId;
use crate::store::{Put, Session};
use crate::wire::{AsJson, SessionGrid, SessionImage, SessionObject};

/// Longest text of a number and its comma, bytes.
const NUMBER: usize = 25;
/// Longest text of a session object beside what its client wrote, bytes: names, ids, dates and single numbers.
const AROUND: usize = 2048;

/// A new session, its picture decoded and its table filled: the first drag finds both.
pub(crate) async fn create(State(app): State<App>, Extension(client): Extension<Client>, request: Request) -> Result<Response, Problem> {
    let upload = upload::read(&app, client, request).await?;
    let held = hold_object(&app, client, &upload.warp)?;
    let (session, setup) = app.open(client, upload.image, upload.warp).await?;
    Ok((StatusCode::CREATED, [(LOCATION, location(session.record.id))], object(held, &session, &setup)).into_response())
}

/// The session of a name that the client chose: 201 when it is new, 200 when it was there, made from the same or made anew.
pub(crate) async fn put(
    State(app): State<App>,
    Extension(client): Extension<Client>,
    Path(id): Path<String>,
    request: Request,
) -> Result<Response, Problem> {
    let id = SessionId::parse(client.owner, &id)
        .map_err(|_| Problem::new(Code::BadValue, "a client names its session by a UUID of version 4, hyphenated"))?;
    let upload = upload::read(&app, client, request).await?;
    let held = hold_object(&app, client, &upload.warp)?;
    let (put, setup) = app.put(client, id, upload.image, upload.warp).await?;
    Ok(match put {
        Put::Created(session) => (StatusCode::CREATED, [(LOCATION, location(id))], object(held, &session, &setup)).into_response(),
        Put::Same(session) | Put::Replaced(session, _) => object(held, &session, &setup),
    })
}

/// Other handles at rest on the session's picture.
pub(crate) async fn handles(
    State(app): State<App>,
    Extension(client): Extension<Client>,
    Path(id): Path<String>,
    request: Request,
) -> Result<Response, Problem> {
    let id = session_id(client, &id)?;
    app.session(id).await?;
    let body = body::json(&app, client, request, Purpose::Upload, "warp_json_bytes", app.config().max_warp_json_bytes).await?;
    let (session, setup) = app.revise(client, id, body).await?;
    held_object(&app, client, &session, &setup)
}

/// The session object. Looking does not prolong its life.
pub(crate) async fn read(
    State(app): State<App>,
    Extension(client): Extension<Client>,
    Path(id): Path<String>,
) -> Result<Response, Problem> {
    let session = app.session(session_id(client, &id)?).await?;
    let setup = app.session_setup(client, &session.record).await?;
    held_object(&app, client, &session, &setup)
}

/// Ends the session.
pub(crate) async fn delete(
    State(app): State<App>,
    Extension(client): Extension<Client>,
    Path(id): Path<String>,
) -> Result<StatusCode, Problem> {
    app.close(session_id(client, &id)?).await?;
    Ok(StatusCode::NO_CONTENT)
}

fn location(id: SessionId) -> HeaderValue {
    HeaderValue::from_str(&format!("/sessions/{id}")).expect("a UUID is visible ASCII")
}

/// What is no id names no session.
pub(crate) fn session_id(client: Client, text: &str) -> Result<SessionId, Problem> {
    SessionId::parse(client.owner, text).map_err(|_| Problem::new(Code::NoSuchSession, "there is no such session"))
}

/// The object in its client's share until it is read: it may be asked for on every stream.
fn held_object(app: &App, client: Client, session: &Session, setup: &Setup) -> Result<Response, Problem> {
    let text = text(session, setup);
    let held = app.reserve_for(Purpose::Frame, &app.response_quota(client), text.len() as u64)?;
    Ok(json_text(held.attach(text)))
}

/// Room for the object of a session that is to be made of this warp object: once the session is there, nobody may be told that it is not.
fn hold_object(app: &App, client: Client, warp: &[u8]) -> Result<Reservation, Problem> {
    app.reserve_for(Purpose::Frame, &app.response_quota(client), longest_text(warp, app.config().limits().columns))
}

fn object(mut held: Reservation, session: &Session, setup: &Setup) -> Response {
    let text = text(session, setup);
    held.shrink_to(text.len() as u64);
    json_text(held.attach(text))
}

/// Most bytes of the object of a session that is made of this warp object. Words come back as they were or are not in the object at all, and
/// before every number of a list stands a bracket or a comma. Nobody gets a session who names more handles than there may be: 2 coordinates and
/// a weight for a point, which is a column; less than that for each of a segment's two.
fn longest_text(warp: &[u8], columns: usize) -> u64 {
    let marks = warp.iter().filter(|byte| matches!(byte, b'[' | b',')).count();
    (AROUND + warp.len() + NUMBER * marks.min(columns.saturating_mul(3))) as u64
}

fn text(session: &Session, setup: &Setup) -> Vec<u8> {
    let record = &session.record;
    let (columns, rows) = setup.grid();
    let object = SessionObject {
        id: &record.id.to_string(),
        image: SessionImage { width: record.extent.width(), height: record.extent.height(), digest: AsJson(record.image) },
        p: AsJson(&record.rest.p),
        weights: record.rest.weights.as_deref(),
        method: AsJson(record.rest.method),
        alpha: setup.alpha(),
        point_mass: setup.point_mass(),
        units: AsJson(record.rest.units),
        grid: SessionGrid { columns, rows, cell: setup.cell().into(), requested: AsJson(record.rest.grid) },
        folds: AsJson(record.folds),
        output: AsJson(&record.output),
        created: &rfc3339(record.created),
        expires: &rfc3339(session.expires),
        seq: session.seq,
    };
    serde_json::to_vec(&object).expect("an object of the contract has string keys")
}

/// `2026-11-21T09:30:00.125Z`: RFC 3339, UTC, milliseconds. Days to a date by the civil calendar of 400-year eras.
fn rfc3339(time: SystemTime) -> String {
    let since = time.duration_since(SystemTime::UNIX_EPOCH).unwrap_or_default();
    let (days, seconds) = (since.as_secs() / 86400, since.as_secs() % 86400);
    // Days since 0000-03-01: a year that begins in March ends with the day that comes and goes.
    let days = days + 719_468;
    let (era, day_of_era) = (days / 146_097, days % 146_097);
    let year_of_era = (day_of_era - day_of_era / 1460 + day_of_era / 36_524 - day_of_era / 146_096) / 365;
    let day_of_year = day_of_era - (365 * year_of_era + year_of_era / 4 - year_of_era / 100);
    let march_month = (5 * day_of_year + 2) / 153;
    let day = day_of_year - (153 * march_month + 2) / 5 + 1;
    let month = if march_month < 10 { march_month + 3 } else { march_month - 9 };
    let year = era * 400 + year_of_era + u64::from(month <= 2);
    let (hour, minute, second) = (seconds / 3600, seconds / 60 % 60, seconds % 60);
    format!("{year:04}-{month:02}-{day:02}T{hour:02}:{minute:02}:{second:02}.{:03}Z", since.subsec_millis())
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::time::Duration;

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
            assert!(longest_text(warp.as_bytes(), 2000) >= (written + 1024) as u64, "{written}");
        }
        // Four megabytes that name no handle at all.
        assert!(longest_text(&vec![b'['; 4 << 20], 10_000) < 6 << 20);
    }
}
