//! `POST /report` and `POST /sessions/{id}/report`: quality figures of a pose, without an image.

use axum::extract::{Path, Request};
use axum::response::Response;

use super::sessions::used;
use crate::app::report;
use crate::http::middleware::authentication::Caller;
use crate::http::response::Refusal;
use crate::http::response::{self, with_method};
use crate::http::upload::{pose_of, warp_json_or_form};
use crate::wire::landmarks::Target;

const JSON: &str = "application/json";

pub(crate) async fn once(caller: Caller, request: Request) -> Result<Response, Refusal> {
    let body = warp_json_or_form(&caller, request, Target::Request).await?;
    let (report, method) = report::once(&caller.app, caller.client, body).await?;
    Ok(with_method(response::mesh(report, JSON), method))
}

pub(crate) async fn of_session(
    caller: Caller,
    Path(id): Path<String>,
    request: Request,
) -> Result<Response, Refusal> {
    let record = used(&caller, &id).await?.record;
    let body = warp_json_or_form(&caller, request, pose_of(&record)).await?;
    let report = report::of_session(&caller.app, caller.client, record, body).await?;
    Ok(response::mesh(report, JSON))
}
