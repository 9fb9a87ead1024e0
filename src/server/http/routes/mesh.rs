//! `POST /sessions/{id}/mesh`: the posed grid, for clients that draw the image themselves.

use axum::extract::{Path, Request};
use axum::response::Response;

use super::sessions::session_id;
use super::warp::read_drag;
use crate::app::mesh::{self, MeshForm};
use crate::app::session_warp::DragRoute;
use crate::http::middleware::authentication::Caller;
use crate::http::response::Refusal;
use crate::http::{accept, response};

const FORMS: [&str; 2] = ["application/json", "application/octet-stream"];

/// The posed grid as JSON, or as little-endian f32.
pub(crate) async fn mesh(
    caller: Caller,
    Path(id): Path<String>,
    request: Request,
) -> Result<Response, Refusal> {
    let chosen = accept::choose(request.headers(), FORMS)?;
    let (media_type, form) = (
        FORMS[chosen],
        if chosen == 0 {
            MeshForm::Json
        } else {
            MeshForm::F32
        },
    );
    let id = session_id(caller.client, &id)?;
    let drag = read_drag(&caller, id, request, DragRoute::Mesh).await?;
    let mesh = mesh::of_session(&caller.app, caller.client, id, drag, form).await?;
    Ok(response::mesh(mesh, media_type))
}
