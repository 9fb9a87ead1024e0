//! `POST /sessions/{id}/tokens`: makes a session token for who has the API key; and the end of a
//! token with its session.

use std::time::{Duration, SystemTime};

use serde::Serialize;

use crate::app::App;
use crate::app::session_object::rfc3339;
use crate::auth::NO_TOKENS;
use crate::auth::keys::Credential;
use crate::problem::{Code, Problem};
use crate::session::SessionId;
use crate::wire::{TokenOp, TokenRequest};

/// The response.
#[derive(Debug, Serialize)]
pub(crate) struct Minted {
    token: String,
    /// RFC 3339, UTC.
    expires: String,
    ops: Vec<&'static str>,
}

/// Whether a token may upload this session: not if its owner has deleted it since.
/// Errors: [`Code::Unauthorized`].
pub(crate) async fn require_not_deleted(app: &App, id: SessionId) -> Result<(), Problem> {
    if !app.sessions.store.was_deleted(id).await? {
        return Ok(());
    }
    let detail = "the session of this token was deleted, which has ended the token";
    Err(Problem::new(Code::Unauthorized, detail))
}

/// Makes a token for a session, which must exist unless the token is to upload it.
/// Errors: [`Code::Forbidden`] without an API key, [`Code::NotSupported`] without a secret that
/// all replicas have; unknown or expired session.
pub(crate) async fn mint(
    app: &App,
    credential: Credential,
    id: SessionId,
    asked: &TokenRequest,
) -> Result<Minted, Problem> {
    let Some(digest) = credential.key_digest() else {
        let detail = "session tokens stand for an API key, and this server has no keys: \
            everybody may use it without";
        return Err(Problem::new(Code::Forbidden, detail));
    };
    let access = app.access();
    let Some(secrets) = access.secrets() else {
        return Err(Problem::new(Code::NotSupported, NO_TOKENS));
    };
    if !asked.ops.contains(&TokenOp::Upload) {
        app.sessions.peek(id).await?;
    }
    let session = id.uuid();
    let now = access.clock().seconds();
    let key = (credential.owner(), &digest);
    let (token, name, expires) = secrets.mint(key, session, asked, now);
    tracing::info!(target: "mlswarp::http", kid = name.kid, jti = name.jti, "token made");
    Ok(Minted {
        token,
        expires: rfc3339(SystemTime::UNIX_EPOCH + Duration::from_secs(expires)),
        ops: asked.ops.iter().map(|op| op.as_str()).collect(),
    })
}
