//! `POST /points` and `POST /sessions/{id}/points`: places mapped by f exactly, not by the grid.

use axum::Extension;
use axum::extract::{Path, Request, State};
use axum::response::Response;

use super::sessions::session_id;
use crate::app::App;
use crate::client::Client;
use crate::http::body::json;
use crate::http::response;
use crate::limits::memory::Purpose;
use crate::problem::Problem;

pub(crate) async fn once(State(app): State<App>, Extension(client): Extension<Client>, request: Request) -> Result<Response, Problem> {
    let body = json(&app, client, request, Purpose::Upload, "json_bytes", app.config().max_warp_json_bytes).await?;
    Ok(response::json_text(app.map_once(client, body).await?))
}

pub(crate) async fn of_session(
    State(app): State<App>,
    Extension(client): Extension<Client>,
    Path(id): Path<String>,
    request: Request,
) -> Result<Response, Problem> {
    let id = session_id(client, &id)?;
    app.session(id).await?;
    let body = json(&app, client, request, Purpose::Upload, "json_bytes", app.config().max_warp_json_bytes).await?;
    Ok(response::json_text(app.map_session(client, id, body).await?))
}
