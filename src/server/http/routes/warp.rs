//! `POST /warp` and `POST /sessions/{id}/warp`: pictures.

use axum::extract::{Path, Request};
use axum::http::header::LOCATION;
use axum::http::{HeaderName, HeaderValue};
use axum::response::Response;
use bytes::Bytes;

use super::sessions::{location, session_id};
use crate::app::warp::columns;
use crate::http::body::{json, too_large};
use crate::http::headers::media_type;
use crate::http::middleware::authentication::Caller;
use crate::http::response::{picture, takes_trailers};
use crate::http::{accept, upload};
use crate::limits::memory::{Purpose, Reservation};
use crate::problem::{Code, Problem};
use crate::session::SessionId;
use crate::wire::DragObject;

const WARP_SESSION: HeaderName = HeaderName::from_static("warp-session");
/// Maximum size of a drag's JSON: a constant, and bytes per column.
const DRAG_BYTES: (u64, u64) = (64 << 10, 64);
/// Memory of parsed handles per byte of their JSON.
const PARSED: u64 = 10;

/// A picture of an upload, or of a session that the body names.
pub(crate) async fn warp(caller: Caller, request: Request) -> Result<Response, Problem> {
    let keeps_session = keeps_session(request.uri().query())?;
    let formats = accept::formats(request.headers())?;
    let trailers = takes_trailers(request.headers());
    let Caller { app, client } = &caller;
    if upload::is_multipart(&request) {
        app.require_queue_place(*client)?;
        let upload = upload::read(&caller, request).await?;
        let (drawn, material) = app.warp_once(*client, upload.image, upload.warp, formats).await?;
        let session = if keeps_session { Some(app.create_session_from(*client, material).await?.0.record.id) } else { None };
        let mut response = picture(drawn, trailers);
        if let Some(id) = session {
            let text = HeaderValue::try_from(id.to_string()).expect("a UUID is visible ASCII");
            response.headers_mut().extend([(WARP_SESSION, text), (LOCATION, location(app, id))]);
        }
        return Ok(response);
    }
    if media_type(request.headers()).as_deref() != Some("application/json") {
        let detail = "this route takes multipart/form-data with the parts `image` and `warp`, or application/json with a session and q";
        return Err(Problem::new(Code::UnsupportedMediaType, detail));
    }
    if keeps_session {
        return Err(Problem::new(Code::BadValue, "session=true opens a session from an upload; this body refers to an existing session"));
    }
    let body = json(&caller, request, Purpose::Upload, "drag_json_bytes", drag_limit(app.config().limits().columns as u64)).await?;
    let _parsed = reserve_parsed(&caller, &body)?;
    let drag = DragObject::parse(&body, true)?;
    let id = session_id(*client, drag.session.as_deref().unwrap_or_default())?;
    let limit = drag_limit(columns(&app.peek_session(id).await?.record));
    if body.len() as u64 > limit {
        return Err(too_large("drag_json_bytes", limit, body.len() as u64));
    }
    Ok(picture(app.warp_session(*client, id, drag, formats).await?, trailers))
}

/// A picture of a session, by `q` alone.
pub(crate) async fn drag(caller: Caller, Path(id): Path<String>, request: Request) -> Result<Response, Problem> {
    let formats = accept::formats(request.headers())?;
    let trailers = takes_trailers(request.headers());
    let id = session_id(caller.client, &id)?;
    let (drag, _parsed) = read_drag(&caller, id, request, |body| DragObject::parse(body, false)).await?;
    Ok(picture(caller.app.warp_session(caller.client, id, drag, formats).await?, trailers))
}

/// Reads the body of a drag, and reserves the memory of its handles, which wait in the queue.
pub(super) async fn read_drag(
    caller: &Caller,
    id: SessionId,
    request: Request,
    parse: impl Fn(&[u8]) -> Result<DragObject, Problem>,
) -> Result<(DragObject, Reservation), Problem> {
    let limit = drag_limit(columns(&caller.app.peek_session(id).await?.record));
    let body = json(caller, request, Purpose::Frame, "drag_json_bytes", limit).await?;
    let parsed = reserve_parsed(caller, &body)?;
    Ok((parse(&body)?, parsed))
}

/// Maximum size of the JSON of a drag with this many columns.
pub(crate) const fn drag_limit(columns: u64) -> u64 {
    DRAG_BYTES.0 + DRAG_BYTES.1 * columns
}

fn reserve_parsed(caller: &Caller, json: &Bytes) -> Result<Reservation, Problem> {
    caller.app.reserve_for(Purpose::Frame, &caller.app.request_quota(caller.client), PARSED * json.len() as u64)
}

/// Reads `?session=true`. Unknown fields are rejected.
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
