//! `POST /report` and `POST /sessions/{id}/report`: quality figures of a pose, without an image.

use axum::extract::{Path, Request};
use axum::response::Response;

use super::sessions::session_id;
use crate::app::report::QualityReport;
use crate::http::middleware::authentication::Caller;
use crate::http::response::Refusal;
use crate::http::response::{self, with_method};
use crate::http::upload::{pose_of, warp_json_or_form};
use crate::wire::landmarks::Target;

pub(crate) async fn once(caller: Caller, request: Request) -> Result<Response, Refusal> {
    let body = warp_json_or_form(&caller, request, Target::Request).await?;
    let (report, method) = caller.app.report_once(caller.client, body).await?;
    Ok(with_method(answer(report), method))
}

pub(crate) async fn of_session(
    caller: Caller,
    Path(id): Path<String>,
    request: Request,
) -> Result<Response, Refusal> {
    let id = session_id(caller.client, &id)?;
    let session = caller.app.peek_session(id).await?;
    let body = warp_json_or_form(&caller, request, pose_of(&session.record)).await?;
    Ok(answer(
        caller.app.report_session(caller.client, id, body).await?,
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
