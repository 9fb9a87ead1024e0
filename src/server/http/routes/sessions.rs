//! `/sessions`: creating, reading, changing and deleting sessions.

use axum::extract::{Path, Request};
use axum::http::header::LOCATION;
use axum::http::{HeaderValue, Method, StatusCode};
use axum::response::{IntoResponse as _, Response};

use crate::app::session_object::ShownSession;
use crate::app::{App, sessions, tokens};
use crate::client::Client;
use crate::http::middleware::authentication::Caller;
use crate::http::response::Refusal;
use crate::http::response::{json_head, session, with_method};
use crate::http::upload;
use crate::limits::memory::MemoryClass;
use crate::problem::words::quote;
use crate::problem::{Code, Problem};
use crate::session::SessionId;
use crate::store::Session;
use crate::wire::landmarks::Target;

const EXAMPLE_ID: &str = "0f8fad5b-d9cb-469f-a165-70867728950e";

/// Creates a session. Its image is decoded and its table filled before the first drag.
pub(crate) async fn create(caller: Caller, request: Request) -> Result<Response, Refusal> {
    let upload = upload::read(&caller, request).await?;
    let (shown, method) = sessions::create(&caller.app, caller.client, upload).await?;
    Ok(with_method(created(&caller, shown), method))
}

/// Creates or replaces the session with an id that the client chose: 201 if it is new, otherwise
/// 200.
pub(crate) async fn put(
    caller: Caller,
    Path(id): Path<String>,
    request: Request,
) -> Result<Response, Refusal> {
    let id = uploaded_id(caller.client, &id)?;
    if caller.client.visit.is_some() {
        tokens::require_not_deleted(&caller.app, id).await?;
    }
    let upload = upload::read(&caller, request).await?;
    let (is_new, (shown, method)) = sessions::put(&caller.app, caller.client, id, upload).await?;
    let response = if is_new {
        created(&caller, shown)
    } else {
        session(shown)
    };
    Ok(with_method(response, method))
}

/// Replaces the rest handles of a session.
pub(crate) async fn handles(
    caller: Caller,
    Path(id): Path<String>,
    request: Request,
) -> Result<Response, Refusal> {
    let record = used(&caller, &id).await?.record;
    let Caller { app, client } = &caller;
    let target = Target::Session(record.extent);
    let limit = ("warp_json_bytes", app.config().max_warp_json_bytes);
    let body = upload::json_or_form(&caller, request, MemoryClass::Upload, limit, target).await?;
    let (shown, method) = sessions::replace_handles(app, *client, record, body).await?;
    Ok(with_method(session(shown), method))
}

/// The session object; of `HEAD` only whether there is the session. Reading does not extend the
/// session's life.
pub(crate) async fn read(
    caller: Caller,
    Path(id): Path<String>,
    method: Method,
) -> Result<Response, Refusal> {
    let Caller { app, client } = caller;
    let found = app.sessions.peek(session_id(client, &id)?).await?;
    if method == Method::HEAD {
        return Ok(json_head());
    }
    Ok(session(app.sessions.show(client, found).await?))
}

/// Deletes a session.
pub(crate) async fn delete(caller: Caller, Path(id): Path<String>) -> Result<StatusCode, Refusal> {
    sessions::delete(&caller.app, session_id(caller.client, &id)?).await?;
    Ok(StatusCode::NO_CONTENT)
}

fn created(caller: &Caller, shown: ShownSession) -> Response {
    let location = location(&caller.app, shown.session.record.id);
    (StatusCode::CREATED, [(LOCATION, location)], session(shown)).into_response()
}

/// The path of a session as clients see it.
pub(super) fn location(app: &App, id: SessionId) -> HeaderValue {
    HeaderValue::try_from(format!("{}/sessions/{id}", app.config().public_path))
        .expect("a public path and a UUID are visible ASCII")
}

/// The session that a path names. A text that is no id names no session.
pub(crate) fn session_id(client: Client, text: &str) -> Result<SessionId, Problem> {
    let none = || {
        Problem::new(
            Code::NoSuchSession,
            format!(
                "{}; POST /sessions opens a session and returns its id",
                not_an_id(text)
            ),
        )
    };
    SessionId::parse(client.owner, text).ok_or_else(none)
}

/// The session that a path names, for a request that uses it: its life is extended.
pub(super) async fn used(caller: &Caller, id: &str) -> Result<Session, Problem> {
    let id = session_id(caller.client, id)?;
    Ok(caller.app.sessions.touch(id, None).await?)
}

/// The name that a client has chosen for a session.
pub(super) fn uploaded_id(client: Client, text: &str) -> Result<SessionId, Problem> {
    SessionId::parse(client.owner, text)
        .ok_or_else(|| Problem::new(Code::BadValue, not_an_id(text)))
}

fn not_an_id(text: &str) -> String {
    if text.is_empty() {
        return "the id of the session is empty in the path, \
                as if a variable of a script were empty"
            .to_owned();
    }
    format!(
        "{} is not a session id: a session id is a hyphenated UUID of version 4, such as \
            {EXAMPLE_ID}",
        quote(text)
    )
}
