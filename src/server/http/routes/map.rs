//! `POST /map` and `POST /sessions/{id}/map`: coordinate maps, without an image.

use axum::extract::{Path, Request};
use axum::response::Response;
use mlswarp::warp::MapFormat;

use super::sessions::session_id;
use crate::http::accept;
use crate::http::middleware::authentication::Caller;
use crate::http::response::Refusal;
use crate::http::response::{map, with_method};
use crate::http::upload::{pose_of, warp_json_or_form};
use crate::problem::Problem;
use crate::wire::landmarks::Target;

pub(crate) async fn once(caller: Caller, request: Request) -> Result<Response, Refusal> {
    let format = format(&request)?;
    let body = warp_json_or_form(&caller, request, Target::Request).await?;
    let (file, method) = caller.app.map_once(caller.client, body, format).await?;
    Ok(with_method(map(file), method))
}

pub(crate) async fn of_session(
    caller: Caller,
    Path(id): Path<String>,
    request: Request,
) -> Result<Response, Refusal> {
    let format = format(&request)?;
    let id = session_id(caller.client, &id)?;
    let session = caller.app.peek_session(id).await?;
    let body = warp_json_or_form(&caller, request, pose_of(&session.record)).await?;
    Ok(map(caller
        .app
        .map_session(caller.client, id, body, format)
        .await?))
}

fn format(request: &Request) -> Result<MapFormat, Problem> {
    Ok(MapFormat::ALL
        [accept::choose(request.headers(), MapFormat::ALL.map(MapFormat::media_type))?])
}
