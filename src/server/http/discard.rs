//! Bodies that are read only to be discarded, because their request was answered early.

use std::time::{Duration, Instant};

use axum::body::{Body, HttpBody as _};
use http_body_util::BodyExt as _;
use tokio::time::{sleep, timeout_at};

use super::connection::turns::AddressTurns;

/// The time for which the rest of a body is read and discarded that is too large, or may have no
/// end.
const LINGER_TIME: Duration = Duration::from_secs(2);

/// Reads and discards the rest of a body: until the deadline if it has a length of at most `left`,
/// and otherwise for [`LINGER_TIME`] at most, as it could be endless. `turns`: of its client.
pub(crate) async fn discard(
    mut body: Body,
    left: u64,
    deadline: tokio::time::Instant,
    turns: Option<AddressTurns>,
) {
    let ends = body.size_hint().upper().is_some_and(|rest| rest <= left);
    let until = if ends {
        deadline
    } else {
        deadline.min(tokio::time::Instant::now() + LINGER_TIME)
    };
    let reading = async {
        while let Some(Ok(frame)) = body.frame().await {
            let bytes = frame.data_ref().map_or(0, bytes::Bytes::len);
            let pause = turns
                .as_ref()
                .map(|turns| turns.discarded().add(bytes, Instant::now()));
            if let Some(pause) = pause.filter(|pause| !pause.is_zero()) {
                sleep(pause).await;
            }
        }
    };
    let _ = timeout_at(until, reading).await;
}
