//! `POST /sessions/{id}/batch`: many poses of a session in one file.

use axum::extract::{Path, Request};
use axum::response::Response;
use futures_util::stream::unfold;

use super::sessions::used;
use super::warp::drag_limit;
use crate::app::batch::{self, BatchForm};
use crate::http::accept::choose;
use crate::http::middleware::authentication::Caller;
use crate::http::response::Refusal;
use crate::http::response::{batch_headers, streamed};
use crate::http::upload::{large_json_or_form, pose_of};

pub(crate) async fn batch(
    caller: Caller,
    Path(id): Path<String>,
    request: Request,
) -> Result<Response, Refusal> {
    let form =
        BatchForm::ALL[choose(request.headers(), BatchForm::ALL.map(BatchForm::media_type))?];
    let record = used(&caller, &id).await?.record;
    let body = large_json_or_form(&caller, request, pose_of(&record)).await?;
    let Caller { app, client } = caller;
    let batch = batch::of_session(&app, client, record, body, form, drag_limit).await?;
    let headers = batch_headers(&batch, form);
    let rest = unfold(batch.rest, async |mut rest| {
        Some((rest.next().await?, rest))
    });
    Ok(streamed(headers, batch.first, rest))
}
