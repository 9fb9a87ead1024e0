//! Content negotiation: whether the client takes what is written here (RFC 9110, section 12.5.1).

use axum::http::HeaderMap;
use axum::http::header::ACCEPT;

use crate::service::problem::{Code, Problem};

/// Refuses a client that takes no PNG. No `Accept` takes everything.
pub(super) fn png(headers: &HeaderMap) -> Result<(), Problem> {
    let mut ranges = headers.get_all(ACCEPT).iter().filter_map(|v| v.to_str().ok()).flat_map(|v| v.split(',')).peekable();
    if ranges.peek().is_none() {
        return Ok(());
    }
    // The most specific range decides: `image/png;q=0, */*` takes no PNG.
    let best = ranges.filter_map(quality).max_by_key(|(specific, _)| *specific);
    match best {
        Some((_, quality)) if quality > 0.0 => Ok(()),
        _ => Err(Problem::new(Code::NotAcceptable, "the picture is written as image/png; Accept takes none of image/png, image/*, */*")),
    }
}

/// How closely a range names PNG, and how much it is wanted; `None` when it names something else.
fn quality(range: &str) -> Option<(u8, f32)> {
    let mut pieces = range.split(';').map(str::trim);
    let specific = match pieces.next()?.to_ascii_lowercase().as_str() {
        "image/png" => 2,
        "image/*" => 1,
        "*/*" | "*" => 0,
        _ => return None,
    };
    let q = pieces.find_map(|p| p.strip_prefix("q=").or_else(|| p.strip_prefix("Q="))).map_or(Some(1.0), |q| q.trim().parse().ok());
    Some((specific, q.unwrap_or(1.0)))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn png_is_taken_where_the_most_specific_range_says_so() {
        let takes = |accept: &str| {
            let mut headers = HeaderMap::new();
            headers.insert(ACCEPT, accept.parse().unwrap());
            png(&headers).is_ok()
        };
        assert!(png(&HeaderMap::new()).is_ok());
        for accept in ["image/png", "image/*", "*/*", "text/html, image/avif, image/*;q=0.8", "text/html,*/*;q=0.1", "IMAGE/PNG; q=1"] {
            assert!(takes(accept), "{accept}");
        }
        for accept in ["image/jpeg", "text/html", "image/png;q=0", "image/png;q=0, */*", "application/json, image/webp"] {
            assert!(!takes(accept), "{accept}");
        }
    }
}
