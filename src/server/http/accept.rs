//! Content negotiation by `Accept` (RFC 9110, section 12.5.1).

use axum::http::HeaderMap;
use axum::http::header::ACCEPT;
use mlswarp::codec::Format;

use super::headers::elements;
use crate::problem::{Code, Problem};
use crate::wire::formats::Formats;

/// The index of the media type among `offers` that the client prefers; of equal ones the first.
/// Errors: 406 if it accepts none.
pub(crate) fn choose<const N: usize>(
    headers: &HeaderMap,
    offers: [&str; N],
) -> Result<usize, Problem> {
    let weights = weights(headers, offers);
    let best = (0..N).fold(0, |best, index| {
        if weights[index] > weights[best] {
            index
        } else {
            best
        }
    });
    let none = || {
        Problem::new(
            Code::NotAcceptable,
            format!(
                "`Accept` allows none of the media types of this response: {}",
                offers.join(", ")
            ),
        )
    };
    if weights[best] > 0.0 {
        Ok(best)
    } else {
        Err(none())
    }
}

/// The picture formats that the client accepts.
/// Errors: 406 if it accepts none.
pub(crate) fn formats(headers: &HeaderMap) -> Result<Formats, Problem> {
    Formats::new(weights(headers, Format::ALL.map(Format::media_type)))
}

/// The weight of each media type. Without any range, all are accepted.
fn weights<const N: usize>(headers: &HeaderMap, offers: [&str; N]) -> [f32; N] {
    let ranges: Vec<&str> = elements(headers, ACCEPT).collect();
    if ranges.is_empty() {
        return [1.0; N];
    }
    // The most specific range decides: `image/png;q=0, */*` excludes PNG.
    let weight = |offer| {
        ranges
            .iter()
            .filter_map(|range| weight(range, offer))
            .max_by_key(|(precision, _)| *precision)
    };
    offers.map(|offer| weight(offer).map_or(0.0, |(_, weight)| weight))
}

/// How precisely a range names the media type, and its weight; `None` if it names another one.
fn weight(range: &str, offer: &str) -> Option<(u8, f32)> {
    let mut pieces = range.split(';').map(str::trim);
    let name = pieces.next()?.to_ascii_lowercase();
    let precision = match name.as_str() {
        "*/*" | "*" => 0,
        name if name == offer => 2,
        name if name
            .strip_suffix("/*")
            .is_some_and(|kind| offer.split('/').next() == Some(kind)) =>
        {
            1
        }
        _ => return None,
    };
    let q = pieces
        .find_map(|p| p.strip_prefix("q=").or_else(|| p.strip_prefix("Q=")))
        .map_or(Some(1.0), |q| q.trim().parse().ok());
    Some((
        precision,
        q.filter(|q: &f32| !q.is_nan())
            .map_or(1.0, |q| q.clamp(0.0, 1.0)),
    ))
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
        for accept in [
            "image/png",
            "image/*",
            "*/*",
            "text/html, image/avif, image/*;q=0.8",
            "text/html,*/*;q=0.1",
            "IMAGE/PNG; q=1",
        ] {
            assert_eq!(chosen(accept, ["image/png"]), Some(0), "{accept}");
        }
        for accept in [
            "image/jpeg",
            "text/html",
            "image/png;q=0",
            "image/png;q=0, */*",
            "application/json, image/webp",
        ] {
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
