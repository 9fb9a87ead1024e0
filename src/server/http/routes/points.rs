//! `POST /points` and `POST /sessions/{id}/points`: annotations mapped by the exact function,
//! without an image.

use axum::extract::{Path, Request};
use axum::response::Response;

use super::sessions::used;
use crate::app::points;
use crate::http::middleware::authentication::Caller;
use crate::http::response::Refusal;
use crate::http::response::mapped;
use crate::http::upload::{large_json_or_form, pose_of};
use crate::wire::Cursor;
use crate::wire::landmarks::Target;

pub(crate) async fn once(caller: Caller, request: Request) -> Result<Response, Refusal> {
    let body = large_json_or_form(&caller, request, Target::Request).await?;
    Ok(mapped(
        points::once(&caller.app, caller.client, body, Cursor::default()).await?,
    ))
}

pub(crate) async fn of_session(
    caller: Caller,
    Path(id): Path<String>,
    request: Request,
) -> Result<Response, Refusal> {
    let record = used(&caller, &id).await?.record;
    let body = large_json_or_form(&caller, request, pose_of(&record)).await?;
    Ok(mapped(
        points::of_session(&caller.app, caller.client, record, body).await?,
    ))
}
