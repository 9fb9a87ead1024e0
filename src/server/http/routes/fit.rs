//! `POST /fit` and `POST /sessions/{id}/fit`: how well methods predict the handles.

use axum::extract::{Path, Request};
use axum::response::Response;

use super::sessions::used;
use crate::app::fit;
use crate::http::middleware::authentication::Caller;
use crate::http::response::Refusal;
use crate::http::response::{json_text, with_warnings};
use crate::http::upload::{pose_of, warp_json_or_form};
use crate::wire::landmarks::Target;

pub(crate) async fn once(caller: Caller, request: Request) -> Result<Response, Refusal> {
    let body = warp_json_or_form(&caller, request, Target::Request).await?;
    let (json, warnings) = fit::once(&caller.app, caller.client, body).await?;
    Ok(with_warnings(json_text(json), &warnings))
}

pub(crate) async fn of_session(
    caller: Caller,
    Path(id): Path<String>,
    request: Request,
) -> Result<Response, Refusal> {
    let record = used(&caller, &id).await?.record;
    let body = warp_json_or_form(&caller, request, pose_of(&record)).await?;
    let (json, warnings) = fit::of_session(&caller.app, caller.client, record, body).await?;
    Ok(with_warnings(json_text(json), &warnings))
}
