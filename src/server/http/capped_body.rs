//! A limit on the bytes of a body, below that of all bodies.

use std::pin::Pin;
use std::task::{Context, Poll, ready};

use axum::body::{Body, HttpBody};
use bytes::Bytes;
use http_body::Frame;

use crate::problem::{Code, Problem};

/// 413.
pub(crate) fn too_large(what: &'static str, limit: u64, actual: u64) -> Problem {
    let of = match what {
        "warp_json_bytes" => "the part `warp`",
        "drag_json_bytes" => "the JSON of a drag",
        "extent_bytes" => "a part with an extent",
        "token_max_bytes" => "the body of a request with this token",
        _ => "the body",
    };
    Problem::new(
        Code::TooLarge,
        format!("{of} has at least {actual} bytes; the limit is {limit}"),
    )
    .limit(what, limit, actual)
}

/// A body with a smaller limit than that of all bodies. The rest of one that is too large is read
/// by the `LimitedBody` in it.
#[derive(Debug)]
pub(crate) struct CappedBody {
    body: Body,
    left: u64,
    what: &'static str,
    limit: u64,
}

impl CappedBody {
    /// `what`: the name of the limit.
    pub(crate) fn wrap(body: Body, what: &'static str, limit: u64) -> Body {
        Body::new(Self {
            body,
            left: limit,
            what,
            limit,
        })
    }
}

impl HttpBody for CappedBody {
    type Data = Bytes;
    type Error = axum::Error;

    fn poll_frame(
        mut self: Pin<&mut Self>,
        cx: &mut Context<'_>,
    ) -> Poll<Option<Result<Frame<Bytes>, axum::Error>>> {
        let frame = ready!(Pin::new(&mut self.body).poll_frame(cx));
        let data = match &frame {
            Some(Ok(frame)) => frame.data_ref(),
            _ => None,
        };
        let length = data.map_or(0, |data| data.len() as u64);
        let Some(left) = self.left.checked_sub(length) else {
            self.left = 0;
            let problem = too_large(self.what, self.limit, self.limit.saturating_add(1));
            return Poll::Ready(Some(Err(axum::Error::new(problem))));
        };
        self.left = left;
        Poll::Ready(frame)
    }

    fn is_end_stream(&self) -> bool {
        self.body.is_end_stream()
    }

    fn size_hint(&self) -> http_body::SizeHint {
        self.body.size_hint()
    }
}
