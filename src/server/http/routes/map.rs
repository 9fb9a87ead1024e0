//! `POST /map` and `POST /sessions/{id}/map`: coordinate maps, without an image.

use axum::extract::{Path, Request};
use axum::response::Response;
use mlswarp::warp::MapFormat;

use super::sessions::used;
use crate::app::map;
use crate::http::accept;
use crate::http::middleware::authentication::Caller;
use crate::http::response::Refusal;
use crate::http::response::{self, with_method};
use crate::http::upload::{pose_of, warp_json_or_form};
use crate::problem::Problem;
use crate::wire::landmarks::Target;

pub(crate) async fn once(caller: Caller, request: Request) -> Result<Response, Refusal> {
    let format = format(&request)?;
    let body = warp_json_or_form(&caller, request, Target::Request).await?;
    let (file, method) = map::once(&caller.app, caller.client, body, format).await?;
    Ok(with_method(response::map(file), method))
}

pub(crate) async fn of_session(
    caller: Caller,
    Path(id): Path<String>,
    request: Request,
) -> Result<Response, Refusal> {
    let format = format(&request)?;
    let record = used(&caller, &id).await?.record;
    let body = warp_json_or_form(&caller, request, pose_of(&record)).await?;
    Ok(response::map(
        map::of_session(&caller.app, caller.client, record, body, format).await?,
    ))
}

fn format(request: &Request) -> Result<MapFormat, Problem> {
    Ok(MapFormat::ALL
        [accept::choose(request.headers(), MapFormat::ALL.map(MapFormat::media_type))?])
}
