//! `POST /sessions/{id}/tokens`: a token for a browser.

use axum::extract::{Path, Request};
use axum::http::header::{CACHE_CONTROL, CONTENT_TYPE};
use axum::http::{HeaderValue, StatusCode};
use axum::response::{IntoResponse as _, Response};

use super::sessions::{session_id, uploaded_id};
use crate::app::tokens;
use crate::auth::keys::Credential;
use crate::http::body;
use crate::http::middleware::authentication::Caller;
use crate::http::response::Refusal;
use crate::limits::memory::MemoryClass;
use crate::wire::{TokenOp, TokenRequest};

/// Longest body, bytes.
const MAX_BODY: u64 = 4096;

/// Makes a token.
pub(crate) async fn mint(
    caller: Caller,
    Path(id): Path<String>,
    request: Request,
) -> Result<Response, Refusal> {
    let credential = request.extensions().get::<Credential>().copied();
    let purpose = MemoryClass::Frame;
    let body = body::json(&caller, request, purpose, "json_bytes", MAX_BODY).await?;
    let asked = TokenRequest::parse(&body)?;
    // A name for a session to come must be one that `PUT` takes.
    let id = if asked.ops.contains(&TokenOp::Upload) {
        uploaded_id(caller.client, &id)?
    } else {
        session_id(caller.client, &id)?
    };
    let credential = credential.unwrap_or(Credential::ANYBODY);
    let minted = tokens::mint(&caller.app, credential, id, &asked).await?;
    let headers = [
        (CONTENT_TYPE, HeaderValue::from_static("application/json")),
        (CACHE_CONTROL, HeaderValue::from_static("no-store")),
    ];
    let minted = serde_json::to_string(&minted).expect("texts");
    Ok((StatusCode::CREATED, headers, minted).into_response())
}
