//! `POST /warp` and `POST /sessions/{id}/warp`: images.

use axum::extract::{Path, Request};
use axum::http::header::LOCATION;
use axum::http::{HeaderName, HeaderValue};
use axum::response::Response;

use super::sessions::{location, session_id};
use crate::app::parts::plans::columns;
use crate::app::reading::Held;
use crate::app::session_warp::{self, DragRoute};
use crate::app::{sessions, warp};
use crate::http::headers::{query_bool, query_fields};
use crate::http::middleware::authentication::Caller;
use crate::http::response::Refusal;
use crate::http::response::{picture, takes_trailers, with_method};
use crate::http::upload::{json_or_form, pose_of};
use crate::http::{accept, upload};
use crate::limits::memory::MemoryClass;
use crate::problem::Problem;
use crate::session::SessionId;
use crate::wire::DragObject;

const WARP_SESSION: HeaderName = HeaderName::from_static("warp-session");
/// Maximum size of a drag's JSON: a constant, and bytes per column.
const DRAG_BYTES: (u64, u64) = (64 << 10, 64);

/// Draws an upload.
pub(crate) async fn warp(caller: Caller, request: Request) -> Result<Response, Refusal> {
    let keeps_session = keeps_session(request.uri().query())?;
    let formats = accept::formats(request.headers())?;
    let trailers = takes_trailers(request.headers());
    let upload = upload::read(&caller, request).await?;
    let Caller { app, client } = caller;
    let (drawn, resolved, content) = warp::once(&app, client, upload, formats).await?;
    let method = resolved.chosen_method();
    let session = if keeps_session {
        Some(sessions::create_from(&app, client, resolved, content).await?)
    } else {
        None
    };
    let mut response = with_method(picture(drawn, trailers), method);
    if let Some(id) = session {
        let text = HeaderValue::try_from(id.to_string()).expect("a UUID is visible ASCII");
        response
            .headers_mut()
            .extend([(WARP_SESSION, text), (LOCATION, location(&app, id))]);
    }
    Ok(response)
}

/// Draws a session's image, by `q` alone.
pub(crate) async fn session_warp(
    caller: Caller,
    Path(id): Path<String>,
    request: Request,
) -> Result<Response, Refusal> {
    let formats = accept::formats(request.headers())?;
    let trailers = takes_trailers(request.headers());
    let id = session_id(caller.client, &id)?;
    let drag = read_drag(&caller, id, request, DragRoute::Picture).await?;
    let Caller { app, client } = caller;
    let drawn = session_warp::of_session(&app, client, id, drag, formats).await?;
    Ok(picture(drawn, trailers))
}

/// Reads the body of a drag.
pub(super) async fn read_drag(
    caller: &Caller,
    id: SessionId,
    request: Request,
    route: DragRoute,
) -> Result<Held<DragObject>, Problem> {
    let record = caller.app.sessions.find(id).await?;
    let limit = ("drag_json_bytes", drag_limit(columns(&record)));
    let body = json_or_form(caller, request, MemoryClass::Frame, limit, pose_of(&record)).await?;
    session_warp::read_drag(&caller.app, caller.client, &record, body, route).await
}

/// Maximum size of the JSON of a drag with this many columns.
pub(crate) const fn drag_limit(columns: u64) -> u64 {
    DRAG_BYTES.0 + DRAG_BYTES.1 * columns
}

/// Reads `?session=true`. Unknown fields are rejected.
fn keeps_session(query: Option<&str>) -> Result<bool, Problem> {
    let [session] = query_fields(query, ["session"])?;
    session.map_or(Ok(false), |value| query_bool("session", value))
}
