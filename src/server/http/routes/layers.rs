//! `/sessions/{id}/layers/{name}`: the layers of a session.

use axum::extract::{Path, Request};
use axum::http::header::{CACHE_CONTROL, CONTENT_TYPE};
use axum::http::{HeaderValue, StatusCode};
use axum::response::{IntoResponse as _, Response};
use mlswarp::codec::SourceFormat;

use super::sessions::{session_id, used};
use crate::app::layers::{self, bad_name};
use crate::http::body;
use crate::http::headers::{bad_query_value, query_fields};
use crate::http::middleware::authentication::Caller;
use crate::http::response;
use crate::http::response::Refusal;
use crate::layer::{LayerKind, LayerName};
use crate::problem::{Code, Problem};
use crate::wire::EnumName as _;

/// Stores or replaces a layer; the body is its file, of any media type.
pub(crate) async fn put(
    caller: Caller,
    Path((id, name)): Path<(String, String)>,
    request: Request,
) -> Result<Response, Refusal> {
    let session = used(&caller, &id).await?;
    let name = LayerName::parse(&name).ok_or_else(|| bad_name(&name))?;
    let [kind] = query_fields(request.uri().query(), ["kind"])?;
    let kind = kind.map_or(Ok(LayerKind::default()), parse_kind)?;
    if name.is_region() && kind != LayerKind::Image {
        return Err(bad_query_value(
            "kind",
            kind.as_str(),
            "`image` for the layer `region`, which is a mask",
        )
        .into());
    }
    let file = body::file(&caller, request).await?;
    let Caller { app, client } = caller;
    let put = layers::put(&app, client, session, &name, kind, file).await?;
    let status = if put.is_new {
        StatusCode::CREATED
    } else {
        StatusCode::OK
    };
    Ok((status, response::session(put.session)).into_response())
}

/// The stored file of a layer.
pub(crate) async fn read(
    caller: Caller,
    Path((id, name)): Path<(String, String)>,
) -> Result<Response, Refusal> {
    let Caller { app, client } = caller;
    let file = layers::read(&app, client, session_id(client, &id)?, &name).await?;
    let media_type = SourceFormat::of(&file)
        .map_err(|_| Problem::new(Code::Internal, "internal error"))?
        .media_type();
    let headers = [
        (CONTENT_TYPE, HeaderValue::from_static(media_type)),
        (CACHE_CONTROL, HeaderValue::from_static("no-store")),
    ];
    Ok((headers, file).into_response())
}

/// Deletes a layer.
pub(crate) async fn delete(
    caller: Caller,
    Path((id, name)): Path<(String, String)>,
) -> Result<StatusCode, Refusal> {
    let Caller { app, client } = caller;
    layers::delete(&app, client, session_id(client, &id)?, &name).await?;
    Ok(StatusCode::NO_CONTENT)
}

fn parse_kind(text: &str) -> Result<LayerKind, Problem> {
    let found = LayerKind::ALL.iter().find(|kind| kind.as_str() == text);
    found
        .copied()
        .ok_or_else(|| bad_query_value("kind", text, "`image` or `labels`"))
}
