//! `POST /report` and `POST /sessions/{id}/report`: quality figures of a pose, without an image.

use axum::extract::{Path, Request};
use axum::response::Response;

use super::sessions::session_id;
use crate::app::report::{self, QualityReport};
use crate::http::middleware::authentication::Caller;
use crate::http::response::Refusal;
use crate::http::response::{self, with_method};
use crate::http::upload::{pose_of, warp_json_or_form};
use crate::wire::landmarks::Target;

pub(crate) async fn once(caller: Caller, request: Request) -> Result<Response, Refusal> {
    let body = warp_json_or_form(&caller, request, Target::Request).await?;
    let (report, method) = report::once(&caller.app, caller.client, body).await?;
    Ok(with_method(answer(report), method))
}

pub(crate) async fn of_session(
    caller: Caller,
    Path(id): Path<String>,
    request: Request,
) -> Result<Response, Refusal> {
    let id = session_id(caller.client, &id)?;
    let record = caller.app.sessions.touch(id, None).await?.record;
    let body = warp_json_or_form(&caller, request, pose_of(&record)).await?;
    Ok(answer(
        report::of_session(&caller.app, caller.client, record, body).await?,
    ))
}

fn answer(
    QualityReport {
        report,
        timing,
        plan_built,
        body,
    }: QualityReport,
) -> Response {
    response::mesh(&report, timing, plan_built, "application/json", body)
}
