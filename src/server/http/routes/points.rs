//! `POST /points` and `POST /sessions/{id}/points`: annotations mapped by the exact function,
//! without an image.

use axum::extract::{Path, Request};
use axum::response::Response;

use super::sessions::session_id;
use crate::http::middleware::authentication::Caller;
use crate::http::response::Refusal;
use crate::http::response::mapped;
use crate::http::upload::{large_json_or_form, pose_of};
use crate::wire::Cursor;
use crate::wire::landmarks::Target;

pub(crate) async fn once(caller: Caller, request: Request) -> Result<Response, Refusal> {
    let body = large_json_or_form(&caller, request, Target::Request).await?;
    Ok(mapped(
        caller
            .app
            .points_once(caller.client, body, Cursor::default())
            .await?,
    ))
}

pub(crate) async fn of_session(
    caller: Caller,
    Path(id): Path<String>,
    request: Request,
) -> Result<Response, Refusal> {
    let id = session_id(caller.client, &id)?;
    let session = caller.app.peek_session(id).await?;
    let body = large_json_or_form(&caller, request, pose_of(&session.record)).await?;
    Ok(mapped(
        caller.app.points_session(caller.client, id, body).await?,
    ))
}
