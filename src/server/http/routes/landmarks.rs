//! `POST /landmarks`: landmark files as handles.

use axum::extract::Request;
use axum::response::Response;

use crate::http::headers::{query_fields, unknown_query_field};
use crate::http::middleware::authentication::Caller;
use crate::http::response::json_text;
use crate::http::{body, upload};
use crate::limits::memory::Purpose;
use crate::problem::words::quote;
use crate::problem::{Code, Problem};
use crate::wire::landmarks::{LandmarkFiles, extent};

/// The body is one file of any media type, or a form.
pub(crate) async fn convert(caller: Caller, request: Request) -> Result<Response, Problem> {
    let query = request.uri().query().map(str::to_owned);
    let mut files = if upload::is_multipart(&request) {
        upload::read_landmark_parts(&caller, request).await?
    } else {
        let file = body::raw(&caller, request, Purpose::Upload, "body_bytes", caller.app.config().max_body_bytes).await?;
        LandmarkFiles { both: Some(file), ..LandmarkFiles::default() }
    };
    for (name, value) in query_fields(query.as_deref()) {
        let slot = match name {
            "extent_p" => &mut files.extent_p,
            "extent_q" => &mut files.extent_q,
            _ => return Err(unknown_query_field(name, &["extent_p", "extent_q"])),
        };
        if slot.is_some() {
            return Err(Problem::new(Code::MalformedRequest, format!("{} is given twice", quote(name))));
        }
        *slot = Some(extent(name, &decoded(value))?);
    }
    Ok(json_text(caller.app.convert_landmarks(caller.client, files).await?))
}

/// The characters of an extent that clients escape in a query.
fn decoded(value: &str) -> String {
    let mut text = value.replace('+', " ");
    for (escape, character) in [("%2C", ","), ("%2c", ","), ("%20", " "), ("%5B", "["), ("%5b", "["), ("%5D", "]"), ("%5d", "]")] {
        text = text.replace(escape, character);
    }
    text
}
