//! The stable error codes of the contract: name, status, title. `api/problems.md` describes each
//! code in a section of its own (tested).

macro_rules! codes {
    ($($variant:ident = $status:literal, $name:literal, $title:literal;)*) => {
        /// A stable error code.
        #[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
        pub enum Code {
            $(#[doc = concat!("`", $name, "` of `api/problems.md`.")] $variant,)*
        }

        impl Code {
            /// Every code, by status.
            pub const ALL: &'static [Self] = &[$(Self::$variant,)*];

            /// The HTTP status.
            pub const fn status(self) -> u16 {
                match self { $(Self::$variant => $status,)* }
            }

            /// The name in the document: `snake_case`.
            pub const fn as_str(self) -> &'static str {
                match self { $(Self::$variant => $name,)* }
            }

            /// A few words for people; the same for every problem of the code.
            pub const fn title(self) -> &'static str {
                match self { $(Self::$variant => $title,)* }
            }

            /// The problem type, a URI reference: `/problems/<code>`, which `Problem::to_json` puts
            /// after the public path.
            pub const fn type_uri(self) -> &'static str {
                match self { $(Self::$variant => concat!("/problems/", $name),)* }
            }
        }
    };
}

codes! {
    MalformedRequest = 400, "malformed_request", "Malformed request";
    Unauthorized = 401, "unauthorized", "API key required";
    TokenExpired = 401, "token_expired", "Token expired";
    Forbidden = 403, "forbidden", "Forbidden";
    NotFound = 404, "not_found", "No such route";
    NoSuchSession = 404, "no_such_session", "No such session";
    NoSuchLayer = 404, "no_such_layer", "No such layer";
    MethodNotAllowed = 405, "method_not_allowed", "Method not allowed";
    NotAcceptable = 406, "not_acceptable", "Not acceptable";
    Timeout = 408, "timeout", "Timeout";
    Superseded = 409, "superseded", "Superseded";
    SessionExpired = 410, "session_expired", "Session expired";
    TooLarge = 413, "too_large", "Too large";
    UnsupportedMediaType = 415, "unsupported_media_type", "Unsupported media type";
    UnsupportedFormat = 415, "unsupported_format", "Unsupported image format";
    Misdirected = 421, "misdirected", "Misdirected request";
    BadImage = 422, "bad_image", "Bad image";
    BadLandmarks = 422, "bad_landmarks", "Bad landmark file";
    NothingVisible = 422, "nothing_visible", "Nothing visible";
    NotSupported = 422, "not_supported", "Not supported";
    UnknownField = 422, "unknown_field", "Unknown field";
    BadValue = 422, "bad_value", "Bad value";
    NotFinite = 422, "not_finite", "Not a finite number";
    ShapeMismatch = 422, "shape_mismatch", "Shapes differ";
    ContradictoryHandles = 422, "contradictory_handles", "Contradictory handles";
    DegenerateLine = 422, "degenerate_line", "Degenerate line";
    AlphaOutOfRange = 422, "alpha_out_of_range", "Alpha out of range";
    OutsideMask = 422, "outside_mask", "Handle outside the mask";
    EmptyMask = 422, "empty_mask", "Empty mask";
    TooManyVertices = 422, "too_many_vertices", "Too many vertices";
    NoTable = 422, "no_table", "No table of coefficients";
    Folded = 422, "folded", "The warp folds";
    Unreachable = 422, "unreachable", "No map without folds";
    UpgradeRequired = 426, "upgrade_required", "Upgrade required";
    RateLimited = 429, "rate_limited", "Rate limited";
    Internal = 500, "internal", "Internal error";
    Overloaded = 503, "overloaded", "Overloaded";
    Unavailable = 503, "unavailable", "Unavailable";
    StoredByAnotherVersion = 503, "stored_by_another_version", "Stored by another version";
}

#[cfg(test)]
mod tests {
    use std::collections::HashSet;

    use super::*;

    const PAGE: &str = include_str!("../../../api/problems.md");

    #[test]
    fn names_are_snake_case_unique_and_end_the_type() {
        let mut seen = HashSet::new();
        for code in Code::ALL {
            assert!(
                code.as_str()
                    .bytes()
                    .all(|b| b.is_ascii_lowercase() || b == b'_'),
                "{code:?}"
            );
            assert!(seen.insert(code.as_str()), "{code:?}");
            assert_eq!(code.type_uri(), format!("/problems/{}", code.as_str()));
            assert!((400..600).contains(&code.status()), "{code:?}");
        }
    }

    #[test]
    fn the_page_has_one_heading_per_code_in_order() {
        let headings: Vec<&str> = PAGE.lines().filter_map(|l| l.strip_prefix("## ")).collect();
        let codes: Vec<&str> = Code::ALL.iter().map(|c| c.as_str()).collect();
        assert_eq!(headings, codes);
    }

    #[test]
    fn every_section_of_the_page_shows_a_document_of_its_code() {
        for (code, section) in Code::ALL.iter().zip(PAGE.split("\n## ").skip(1)) {
            let example = section
                .split("```json")
                .nth(1)
                .and_then(|s| s.split("```").next())
                .expect("an example document");
            let document: serde_json::Value =
                serde_json::from_str(example).expect("the example is JSON");
            assert_eq!(document["code"], code.as_str());
            assert_eq!(document["status"], code.status());
            assert_eq!(document["title"], code.title());
            assert_eq!(document["type"], code.type_uri());
            assert!(
                document["detail"].as_str().is_some_and(|d| !d.is_empty()),
                "{code:?}"
            );
            assert!(
                section.contains(&format!("Status {}.", code.status())),
                "{code:?}"
            );
            assert!(section.contains("**What to do.**"), "{code:?}");
        }
    }
}
