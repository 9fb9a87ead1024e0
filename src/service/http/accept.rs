//! Content negotiation: which of the forms that are written here the client would rather have (RFC 9110, section 12.5.1).

use axum::http::HeaderMap;
use axum::http::header::ACCEPT;

use crate::service::problem::{Code, Problem};

/// The index of the media type among `offers` that the client wants most; the first of them where it wants several equally, or says nothing.
///
/// # Errors
/// 406 when it takes none.
pub(super) fn choose(headers: &HeaderMap, offers: &[&str]) -> Result<usize, Problem> {
    let ranges: Vec<&str> = headers.get_all(ACCEPT).iter().filter_map(|v| v.to_str().ok()).flat_map(|v| v.split(',')).collect();
    if ranges.is_empty() {
        return Ok(0);
    }
    let mut best: Option<(usize, f32)> = None;
    for (index, offer) in offers.iter().enumerate() {
        // The most specific range decides: `image/png;q=0, */*` takes no PNG.
        let wanted = ranges.iter().filter_map(|range| quality(range, offer)).max_by_key(|(specific, _)| *specific).map_or(0.0, |(_, q)| q);
        if wanted > best.map_or(0.0, |(_, most)| most) {
            best = Some((index, wanted));
        }
    }
    let none = || Problem::new(Code::NotAcceptable, format!("this answer is written as {}; Accept takes none of these", offers.join(", ")));
    best.map(|(index, _)| index).ok_or_else(none)
}

/// How closely a range names the media type, and how much it is wanted; `None` when it names something else.
fn quality(range: &str, offer: &str) -> Option<(u8, f32)> {
    let mut pieces = range.split(';').map(str::trim);
    let name = pieces.next()?.to_ascii_lowercase();
    let specific = match name.as_str() {
        "*/*" | "*" => 0,
        name if name == offer => 2,
        name if name.strip_suffix("/*").is_some_and(|kind| offer.split('/').next() == Some(kind)) => 1,
        _ => return None,
    };
    let q = pieces.find_map(|p| p.strip_prefix("q=").or_else(|| p.strip_prefix("Q="))).map_or(Some(1.0), |q| q.trim().parse().ok());
    Some((specific, q.unwrap_or(1.0)))
}

#[cfg(test)]
mod tests {
    use super::*;

    fn chosen(accept: &str, offers: &[&str]) -> Option<usize> {
        let mut headers = HeaderMap::new();
        headers.insert(ACCEPT, accept.parse().unwrap());
        choose(&headers, offers).ok()
    }

    #[test]
    fn png_is_taken_where_the_most_specific_range_says_so() {
        assert_eq!(choose(&HeaderMap::new(), &["image/png"]).unwrap(), 0);
        for accept in ["image/png", "image/*", "*/*", "text/html, image/avif, image/*;q=0.8", "text/html,*/*;q=0.1", "IMAGE/PNG; q=1"] {
            assert_eq!(chosen(accept, &["image/png"]), Some(0), "{accept}");
        }
        for accept in ["image/jpeg", "text/html", "image/png;q=0", "image/png;q=0, */*", "application/json, image/webp"] {
            assert_eq!(chosen(accept, &["image/png"]), None, "{accept}");
        }
    }

    #[test]
    fn the_form_that_is_wanted_most_is_chosen_and_the_first_of_equals() {
        let offers = ["image/png", "image/jpeg", "image/webp"];
        for (accept, index) in [
            ("image/*", Some(0)),
            ("image/webp", Some(2)),
            ("image/jpeg, image/png", Some(0)),
            ("image/jpeg, image/*;q=0.5", Some(1)),
            ("image/png;q=0, image/*", Some(1)),
            ("image/webp;q=0.9, image/jpeg;q=0.8, */*;q=0.1", Some(2)),
            ("text/html", None),
        ] {
            assert_eq!(chosen(accept, &offers), index, "{accept}");
        }
    }
}
