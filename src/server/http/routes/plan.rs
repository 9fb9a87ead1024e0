//! `GET /sessions/{id}/plan`: the coefficients on a lattice, for clients that pose by themselves.

use axum::extract::{Path, Request};
use axum::http::Method;
use axum::http::request::Parts;
use axum::response::Response;

use super::sessions::session_id;
use crate::app::plan;
use crate::http::headers::{bad_query_value, query_fields, sends_tag};
use crate::http::middleware::authentication::Caller;
use crate::http::response;
use crate::http::response::Refusal;
use crate::problem::Problem;
use crate::wire::{PlanQuery, Precision};

/// Vertices in a row and in a column unless the client requests others.
const VERTICES: u32 = 50;

/// The table as a file, or 304 if the client has it.
pub(crate) async fn plan(
    caller: Caller,
    Path(id): Path<String>,
    request: Request,
) -> Result<Response, Refusal> {
    let id = session_id(caller.client, &id)?;
    let (
        Parts {
            uri,
            headers,
            method,
            ..
        },
        _,
    ) = request.into_parts();
    let [columns, rows, precision] = query_fields(uri.query(), ["columns", "rows", "precision"])?;
    let lines =
        |name, text: Option<&str>| text.map_or(Ok(VERTICES), |text| parse_lines(name, text));
    let query = PlanQuery {
        columns: lines("columns", columns)?,
        rows: lines("rows", rows)?,
        precision: precision.map_or(Ok(Precision::default()), parse_precision)?,
    };
    let is_known = |tag: &str| sends_tag(&headers, tag);
    let with_content = method != Method::HEAD;
    Ok(response::plan(
        plan::of_session(
            &caller.app,
            caller.client,
            id,
            query,
            is_known,
            with_content,
        )
        .await?,
    ))
}

fn parse_lines(name: &str, text: &str) -> Result<u32, Problem> {
    let lines = text
        .parse()
        .ok()
        .filter(|lines| *lines >= 2 && text.bytes().all(|byte| byte.is_ascii_digit()));
    lines.ok_or_else(|| bad_query_value(name, text, "an integer of at least 2"))
}

fn parse_precision(text: &str) -> Result<Precision, Problem> {
    let found = Precision::ALL.iter().find(|(name, _)| *name == text);
    found
        .map(|(_, precision)| *precision)
        .ok_or_else(|| bad_query_value("precision", text, "`f32` or `f16`"))
}
