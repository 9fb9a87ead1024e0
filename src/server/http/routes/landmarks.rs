//! `POST /landmarks`: landmark files as handles.

use std::borrow::Cow;

use axum::extract::Request;
use axum::response::Response;

use crate::app::landmarks;
use crate::http::headers::query_fields;
use crate::http::middleware::authentication::Caller;
use crate::http::response::Refusal;
use crate::http::response::json_text;
use crate::http::{body, upload};
use crate::limits::memory::MemoryClass;
use crate::problem::{Code, Problem};
use crate::wire::landmarks::{Choice, LandmarkFiles, extent};

const FIELDS: [&str; 4] = ["extent_p", "extent_q", "match", "item"];

/// The body is one file of any media type, or a form.
pub(crate) async fn convert(caller: Caller, request: Request) -> Result<Response, Refusal> {
    let given = query_fields(request.uri().query(), FIELDS)?;
    let [extent_p, extent_q, matching, item] = given.map(|text| text.map(decoded));
    let read = |name: &str, text: Option<String>| text.map(|text| extent(name, &text)).transpose();
    let (extent_p, extent_q) = (read("extent_p", extent_p)?, read("extent_q", extent_q)?);
    let mut choice = Choice::default();
    for (name, text) in [("match", matching), ("item", item)] {
        text.map_or(Ok(()), |text| choice.add_text(name, &text))?;
    }
    let mut files = if upload::is_multipart(&request) {
        upload::read_landmark_parts(&caller, request).await?
    } else {
        let file = body::raw(
            &caller,
            request,
            MemoryClass::Upload,
            "body_bytes",
            caller.app.config().max_body_bytes,
        )
        .await?;
        LandmarkFiles {
            both: Some(file),
            ..LandmarkFiles::default()
        }
    };
    for (name, of_query, of_part) in [
        ("extent_p", extent_p, &mut files.extent_p),
        ("extent_q", extent_q, &mut files.extent_q),
    ] {
        if of_query.is_some() && of_part.is_some() {
            return Err(Problem::new(
                Code::BadValue,
                format!("`{name}` is given twice: in the query and as a part"),
            )
            .into());
        }
        *of_part = of_part.or(of_query);
    }
    files.choice.add(choice)?;
    Ok(json_text(
        landmarks::convert(&caller.app, caller.client, files).await?,
    ))
}

/// The text of a field of a query: clients escape bytes, and write a space as `+`.
fn decoded(value: &str) -> String {
    let bytes = value.as_bytes();
    let digit = |at: usize| {
        bytes
            .get(at)
            .and_then(|digit| char::from(*digit).to_digit(16))
    };
    let (mut text, mut at) = (Vec::with_capacity(bytes.len()), 0);
    while let Some(byte) = bytes.get(at) {
        let escaped = digit(at + 1)
            .zip(digit(at + 2))
            .and_then(|(high, low)| u8::try_from(16 * high + low).ok());
        let (byte, length) = match (byte, escaped) {
            (b'%', Some(byte)) => (byte, 3),
            (b'+', _) => (b' ', 1),
            (byte, _) => (*byte, 1),
        };
        text.push(byte);
        at += length;
    }
    Cow::into_owned(String::from_utf8_lossy(&text))
}
