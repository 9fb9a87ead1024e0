//! `POST /sessions/{id}/mesh`: the posed grid, for clients that draw by themselves.

use axum::Extension;
use axum::extract::{Path, Request, State};
use axum::response::Response;

use super::sessions::session_id;
use super::warp::{drag_limit, parsed};
use crate::app::App;
use crate::app::drag::MeshForm;
use crate::app::warp::columns;
use crate::client::Client;
use crate::http::body::json;
use crate::http::{accept, response};
use crate::limits::memory::Purpose;
use crate::problem::Problem;
use crate::wire::DragObject;

const FORMS: [(&str, MeshForm); 2] = [("application/json", MeshForm::Json), ("application/octet-stream", MeshForm::Numbers)];

/// The posed grid as JSON, or as little-endian f32.
pub(crate) async fn mesh(
    State(app): State<App>,
    Extension(client): Extension<Client>,
    Path(id): Path<String>,
    request: Request,
) -> Result<Response, Problem> {
    let (media_type, form) = FORMS[accept::choose(request.headers(), FORMS.map(|(name, _)| name))?];
    let id = session_id(client, &id)?;
    let limit = drag_limit(columns(&app.session(id).await?.record));
    let body = json(&app, client, request, Purpose::Frame, "drag_json_bytes", limit).await?;
    let _parsed = parsed(&app, client, &body)?;
    let drag = DragObject::parse_posed(&body)?;
    let mesh = app.mesh(client, id, drag, form).await?;
    Ok(response::mesh(&mesh.report, mesh.timing, mesh.plan_built, media_type, mesh.body))
}
