//! Multipart uploads: the parts `image` (the file) and `warp` (the warp object), each once, in any order.

use axum::extract::multipart::Field;
use axum::extract::{DefaultBodyLimit, FromRequest as _, Multipart, Request};
use bytes::Bytes;

use super::body::{Received, media_type, read_problem, too_large};
use crate::service::App;
use crate::service::problem::{Code, Problem};

/// The two parts.
#[derive(Debug)]
pub(super) struct Upload {
    /// The file.
    pub(super) image: Bytes,
    /// The warp object.
    pub(super) warp: Bytes,
}

/// The request has a multipart body.
pub(super) fn is_multipart(request: &Request) -> bool {
    media_type(request).as_deref() == Some("multipart/form-data")
}

/// Reads both parts. The whole body is limited before this; `warp` has a limit of its own.
pub(super) async fn read(app: &App, mut request: Request) -> Result<Upload, Problem> {
    if !is_multipart(&request) {
        return Err(Problem::new(Code::UnsupportedMediaType, "this route takes multipart/form-data with the parts `image` and `warp`"));
    }
    // The guard around every body has the limit; axum's own default is below it.
    DefaultBodyLimit::disable().apply(&mut request);
    let mut parts = Multipart::from_request(request, &()).await.map_err(|e| malformed(e.body_text()))?;
    let (mut image, mut warp) = (None, None);
    while let Some(part) = parts.next_field().await.map_err(|e| read_problem(&e, "the multipart body could not be read"))? {
        let name = part.name().unwrap_or_default().to_owned();
        let (slot, limit) = match name.as_str() {
            "image" => (&mut image, u64::MAX),
            "warp" => (&mut warp, app.config().max_warp_json_bytes),
            _ => return Err(malformed(format!("a part is named `{name}`; the parts are `image` and `warp`"))),
        };
        if slot.is_some() {
            return Err(malformed(format!("the part `{name}` comes twice")));
        }
        *slot = Some(part_bytes(app, part, limit).await?);
    }
    match (image, warp) {
        (Some(image), Some(warp)) => Ok(Upload { image, warp }),
        (None, None) => Err(malformed("the parts `image` and `warp` are missing")),
        (None, _) => Err(malformed("the part `image` is missing")),
        (_, None) => Err(malformed("the part `warp` is missing")),
    }
}

fn malformed(detail: impl Into<String>) -> Problem {
    Problem::new(Code::MalformedRequest, detail)
}

async fn part_bytes(app: &App, mut part: Field<'_>, limit: u64) -> Result<Bytes, Problem> {
    let mut read = Received::new(app)?;
    while let Some(chunk) = part.chunk().await.map_err(|e| read_problem(&e, "the multipart body could not be read"))? {
        let length = read.len() + chunk.len() as u64;
        if length > limit {
            return Err(too_large("warp_json_bytes", limit, length));
        }
        read.push(&chunk)?;
    }
    Ok(read.fit())
}
