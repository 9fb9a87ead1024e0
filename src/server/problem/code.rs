//! The stable error codes of the contract in one table: name, status, title. `api/problems.md` has one heading for each (tested).

macro_rules! codes {
    ($($(#[$doc:meta])* $variant:ident = $status:literal, $name:literal, $title:literal;)*) => {
        /// A stable error code; its status and title stand in one table.
        #[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
        pub enum Code {
            $($(#[$doc])* $variant,)*
        }

        impl Code {
            /// Every code, in the order of their statuses.
            pub const ALL: &'static [Self] = &[$(Self::$variant,)*];

            /// The HTTP status.
            pub const fn status(self) -> u16 {
                match self { $(Self::$variant => $status,)* }
            }

            /// The code as it is written: `snake_case`.
            pub const fn as_str(self) -> &'static str {
                match self { $(Self::$variant => $name,)* }
            }

            /// A few words for people; the same for every problem of the code.
            pub const fn title(self) -> &'static str {
                match self { $(Self::$variant => $title,)* }
            }

            /// The problem type, a URI reference: `/problems/<code>`.
            pub const fn type_uri(self) -> &'static str {
                match self { $(Self::$variant => concat!("/problems/", $name),)* }
            }
        }
    };
}

codes! {
    /// The request cannot be read: not JSON, not multipart, a part missing.
    MalformedRequest = 400, "malformed_request", "Malformed request";
    /// A key is configured and the request has none.
    Unauthorized = 401, "unauthorized", "Key missing";
    /// A key is configured and the request has another; a page of another site opens a socket.
    Forbidden = 403, "forbidden", "Forbidden";
    /// No route has this path.
    NotFound = 404, "not_found", "No such route";
    /// No session has this id.
    NoSuchSession = 404, "no_such_session", "No such session";
    /// The route does not know the method.
    MethodNotAllowed = 405, "method_not_allowed", "Method not allowed";
    /// `Accept` names nothing that is written here.
    NotAcceptable = 406, "not_acceptable", "Not acceptable";
    /// The client took too long to send its request.
    Timeout = 408, "timeout", "Timeout";
    /// A newer pose of the session has been seen.
    Superseded = 409, "superseded", "Superseded";
    /// The session ended not long ago.
    SessionExpired = 410, "session_expired", "Session expired";
    /// Over a limit; decided before memory is taken.
    TooLarge = 413, "too_large", "Too large";
    /// The `Content-Type` of the request is not one that the route takes.
    UnsupportedMediaType = 415, "unsupported_media_type", "Unsupported media type";
    /// The file is not an image that is read here.
    UnsupportedFormat = 415, "unsupported_format", "Unsupported image format";
    /// The request names a host that the listener does not serve.
    Misdirected = 421, "misdirected", "Misdirected request";
    /// The file is truncated or contradicts itself.
    BadImage = 422, "bad_image", "Bad image";
    /// A value of the contract that this build does not have.
    NotSupported = 422, "not_supported", "Not supported";
    /// A field that is not known.
    UnknownField = 422, "unknown_field", "Unknown field";
    /// A value of the wrong type or out of range.
    BadValue = 422, "bad_value", "Bad value";
    /// A number beyond the range of f64.
    NotFinite = 422, "not_finite", "Not a finite number";
    /// p, q and weights do not pair up.
    ShapeMismatch = 422, "shape_mismatch", "Shapes differ";
    /// Handles that meet at rest are sent to different places.
    ContradictoryHandles = 422, "contradictory_handles", "Contradictory handles";
    /// A segment at rest without length.
    DegenerateLine = 422, "degenerate_line", "Degenerate line";
    /// alpha outside of its range.
    AlphaOutOfRange = 422, "alpha_out_of_range", "Alpha out of range";
    /// `folds: reject` and the result folds.
    Folded = 422, "folded", "The warp folds";
    /// The route is a WebSocket.
    UpgradeRequired = 426, "upgrade_required", "Upgrade required";
    /// One client asks too often.
    RateLimited = 429, "rate_limited", "Rate limited";
    /// A bug; the log has more.
    Internal = 500, "internal", "Internal error";
    /// The service has no room for the work now, or did not finish it in time.
    Overloaded = 503, "overloaded", "Overloaded";
    /// Another version of the program has stored the session, and this one cannot read it.
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
            assert!(code.as_str().bytes().all(|b| b.is_ascii_lowercase() || b == b'_'), "{code:?}");
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
            let example = section.split("```json").nth(1).and_then(|s| s.split("```").next()).expect("an example document");
            let document: serde_json::Value = serde_json::from_str(example).expect("the example is JSON");
            assert_eq!(document["code"], code.as_str());
            assert_eq!(document["status"], code.status());
            assert_eq!(document["title"], code.title());
            assert_eq!(document["type"], code.type_uri());
            assert!(document["detail"].as_str().is_some_and(|d| !d.is_empty()), "{code:?}");
            assert!(section.contains(&format!("Status {}.", code.status())), "{code:?}");
            assert!(section.contains("**What to do.**"), "{code:?}");
        }
    }
}
