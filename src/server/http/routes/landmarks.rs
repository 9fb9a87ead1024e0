//! `POST /landmarks`: landmark files as handles.

use axum::extract::Request;
use axum::response::Response;

use crate::http::headers::query_fields;
use crate::http::middleware::authentication::Caller;
use crate::http::response::json_text;
use crate::http::{body, upload};
use crate::limits::memory::Purpose;
use crate::problem::{Code, Problem};
use crate::wire::landmarks::{LandmarkFiles, extent};

const EXTENTS: [&str; 2] = ["extent_p", "extent_q"];

/// The body is one file of any media type, or a form.
pub(crate) async fn convert(caller: Caller, request: Request) -> Result<Response, Problem> {
    let given = query_fields(request.uri().query(), EXTENTS)?;
    let [extent_p, extent_q] = [0, 1].map(|side| given[side].map(|text| extent(EXTENTS[side], &decoded(text))).transpose());
    let (extent_p, extent_q) = (extent_p?, extent_q?);
    let mut files = if upload::is_multipart(&request) {
        upload::read_landmark_parts(&caller, request).await?
    } else {
        let file = body::raw(&caller, request, Purpose::Upload, "body_bytes", caller.app.config().max_body_bytes).await?;
        LandmarkFiles { both: Some(file), ..LandmarkFiles::default() }
    };
    for (name, of_query, of_part) in [("extent_p", extent_p, &mut files.extent_p), ("extent_q", extent_q, &mut files.extent_q)] {
        if of_query.is_some() && of_part.is_some() {
            return Err(Problem::new(Code::BadValue, format!("`{name}` is given twice: in the query and as a part")));
        }
        *of_part = of_part.or(of_query);
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
