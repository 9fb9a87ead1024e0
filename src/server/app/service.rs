//! `GET /readyz`: whether a new client would be served.

use super::App;
use crate::problem::Problem;

/// What a ready service can do.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum Readiness {
    /// Everything.
    Whole,
    /// Known sessions, and images without a session: the store is unavailable.
    WithoutStore,
}

/// Whether a new client would be served, and whether the store is available; answers within about a
/// second. A service that loses its store stays ready: a store is unavailable to all replicas at
/// the same time, and a proxy that removed them all would also end the sessions that continue
/// without it. Errors: Overloaded, with the reason.
pub(crate) async fn ready(app: &App) -> Result<Readiness, Problem> {
    app.lifecycle.require_serving()?;
    app.admission.require_room()?;
    let store = &app.sessions.store;
    match store.ready().await {
        Ok(()) => Ok(Readiness::Whole),
        Err(_) if !store.figures().is_unknown => Ok(Readiness::WithoutStore),
        Err(error) => Err(error.into()),
    }
}
