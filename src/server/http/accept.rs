//! Content negotiation: which of the forms that are written here the client would rather have (RFC 9110, section 12.5.1).

use axum::http::HeaderMap;
use axum::http::header::ACCEPT;
use mlswarp::codec::Format;

use crate::problem::{Code, Problem};
use crate::wire::formats::Formats;

/// The index of the media type among `offers` that the client wants most; the first of them where it wants several equally, or says nothing.
///
/// # Errors
/// 406 when it takes none.
pub(crate) fn choose<const N: usize>(headers: &HeaderMap, offers: [&str; N]) -> Result<usize, Problem> {
    let wanted = wanted(headers, offers);
    let best = (0..N).fold(0, |best, index| if wanted[index] > wanted[best] { index } else { best });
    let none = || Problem::new(Code::NotAcceptable, format!("this answer is written as {}; Accept takes none of these", offers.join(", ")));
    if wanted[best] > 0.0 { Ok(best) } else { Err(none()) }
}

/// Which picture formats the client takes.
///
/// # Errors
/// 406 when it takes none.
pub(crate) fn formats(headers: &HeaderMap) -> Result<Formats, Problem> {
    Formats::new(wanted(headers, Format::ALL.map(Format::media_type)))
}

/// How much each of the media types is wanted.
fn wanted<const N: usize>(headers: &HeaderMap, offers: [&str; N]) -> [f32; N] {
    let ranges = headers.get_all(ACCEPT).iter().filter_map(|v| v.to_str().ok()).flat_map(|v| v.split(',')).map(str::trim);
    // A list may hold empty elements (RFC 9110, section 5.6.1); a header without any other is one that is absent.
    let ranges: Vec<&str> = ranges.filter(|range| !range.is_empty()).collect();
    if ranges.is_empty() {
        return [1.0; N];
    }
    // The most specific range decides: `image/png;q=0, */*` takes no PNG.
    offers
        .map(|offer| ranges.iter().filter_map(|range| quality(range, offer)).max_by_key(|(specific, _)| *specific).map_or(0.0, |(_, q)| q))
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
    Some((specific, q.filter(|q: &f32| !q.is_nan()).map_or(1.0, |q| q.clamp(0.0, 1.0))))
}

#[cfg(test)]
mod tests {
    use super::*;

    fn chosen<const N: usize>(accept: &str, offers: [&str; N]) -> Option<usize> {
        let mut headers = HeaderMap::new();
        headers.insert(ACCEPT, accept.parse().unwrap());
        choose(&headers, offers).ok()
    }

    #[test]
    fn png_is_taken_where_the_most_specific_range_says_so() {
        assert_eq!(choose(&HeaderMap::new(), ["image/png"]).unwrap(), 0);
        for accept in ["image/png", "image/*", "*/*", "text/html, image/avif, image/*;q=0.8", "text/html,*/*;q=0.1", "IMAGE/PNG; q=1"] {
            assert_eq!(chosen(accept, ["image/png"]), Some(0), "{accept}");
        }
        for accept in ["image/jpeg", "text/html", "image/png;q=0", "image/png;q=0, */*", "application/json, image/webp"] {
            assert_eq!(chosen(accept, ["image/png"]), None, "{accept}");
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
            ("", Some(0)),
            (" , ", Some(0)),
            (",image/jpeg,", Some(1)),
            ("image/png;q=1, image/jpeg;q=7", Some(0)),
            ("image/png;q=0.5, image/jpeg;q=inf, image/webp;q=2", Some(1)),
            ("image/png;q=-3", None),
            ("image/png;q=nan, image/jpeg;q=0.5", Some(0)),
        ] {
            assert_eq!(chosen(accept, offers), index, "{accept}");
        }
    }
}
