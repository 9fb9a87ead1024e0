//! `POST /warp` and `POST /sessions/{id}/warp`: pictures.

use axum::Extension;
use axum::extract::{Path, Request, State};
use axum::http::header::LOCATION;
use axum::http::{HeaderName, HeaderValue};
use axum::response::Response;

use super::sessions::session_id;
use crate::app::App;
use crate::app::warp::columns;
use crate::client::Client;
use crate::http::body::{json, media_type, too_large};
use crate::http::response::{picture, takes_trailers};
use crate::http::{accept, upload};
use crate::limits::memory::{Purpose, Reservation};
use crate::problem::{Code, Problem};
use crate::session::SessionId;
use crate::wire::DragObject;

const WARP_SESSION: HeaderName = HeaderName::from_static("warp-session");
/// JSON of a drag: so much, and so much more a column.
const DRAG_BYTES: (u64, u64) = (64 << 10, 64);
/// Handles take at most so many times their text.
const PARSED: u64 = 10;

/// A file and a warp object, or a session's id and q.
pub(crate) async fn warp(State(app): State<App>, Extension(client): Extension<Client>, request: Request) -> Result<Response, Problem> {
    let keeps = keeps_session(request.uri().query())?;
    let formats = accept::formats(request.headers())?;
    let trailers = takes_trailers(request.headers());
    if upload::is_multipart(&request) {
        app.require_queue_place(client)?;
        let upload = upload::read(&app, client, request).await?;
        let (drawn, material) = app.warp_once(client, upload.image, upload.warp, formats).await?;
        let session = if keeps { Some(app.open_prepared(client, material).await?.0.record.id) } else { None };
        let mut response = picture(drawn, trailers);
        if let Some(id) = session {
            name_session(&mut response, id);
        }
        return Ok(response);
    }
    if media_type(&request).as_deref() != Some("application/json") {
        let detail = "this route takes multipart/form-data with the parts `image` and `warp`, or application/json with a session and q";
        return Err(Problem::new(Code::UnsupportedMediaType, detail));
    }
    if keeps {
        return Err(Problem::new(Code::BadValue, "session=true makes a session of an upload; this body names one"));
    }
    let body = json(&app, client, request, Purpose::Upload, "drag_json_bytes", drag_limit(app.config().limits().columns as u64)).await?;
    let _parsed = parsed(&app, client, &body)?;
    let drag = DragObject::parse(&body, true)?;
    let id = session_id(client, drag.session.as_deref().unwrap_or_default())?;
    let limit = drag_limit(columns(&app.session(id).await?.record));
    if body.len() as u64 > limit {
        return Err(too_large("drag_json_bytes", limit, body.len() as u64));
    }
    Ok(picture(app.drag(client, id, drag, formats).await?, trailers))
}

/// q alone.
pub(crate) async fn drag(
    State(app): State<App>,
    Extension(client): Extension<Client>,
    Path(id): Path<String>,
    request: Request,
) -> Result<Response, Problem> {
    let formats = accept::formats(request.headers())?;
    let trailers = takes_trailers(request.headers());
    let id = session_id(client, &id)?;
    let limit = drag_limit(columns(&app.session(id).await?.record));
    let body = json(&app, client, request, Purpose::Frame, "drag_json_bytes", limit).await?;
    let _parsed = parsed(&app, client, &body)?;
    let drag = DragObject::parse(&body, false)?;
    Ok(picture(app.drag(client, id, drag, formats).await?, trailers))
}

/// Adds `Warp-Session` and `Location`.
fn name_session(response: &mut Response, id: SessionId) {
    let text = |text: String| HeaderValue::from_str(&text).expect("a UUID is visible ASCII");
    response.headers_mut().insert(WARP_SESSION, text(id.to_string()));
    response.headers_mut().insert(LOCATION, text(format!("/sessions/{id}")));
}

/// Most bytes of JSON that a drag of so many columns may have.
pub(crate) const fn drag_limit(columns: u64) -> u64 {
    DRAG_BYTES.0 + DRAG_BYTES.1 * columns
}

/// The memory of a drag's handles, which wait in the queue with it.
pub(crate) fn parsed(app: &App, client: Client, json: &[u8]) -> Result<Reservation, Problem> {
    app.reserve_for(Purpose::Frame, &app.request_quota(client), PARSED * json.len() as u64)
}

/// `?session=true`. What is not known is refused, as in the body.
fn keeps_session(query: Option<&str>) -> Result<bool, Problem> {
    let mut keeps = false;
    for pair in query.unwrap_or_default().split('&').filter(|pair| !pair.is_empty()) {
        keeps = match pair {
            "session=true" => true,
            "session=false" => false,
            _ if pair.split('=').next() == Some("session") => {
                return Err(Problem::new(Code::BadValue, "the query's `session` is neither true nor false"));
            }
            _ => return Err(Problem::new(Code::UnknownField, "the query has a field that is not known; supported: session")),
        };
    }
    Ok(keeps)
}
