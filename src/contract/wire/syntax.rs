//! What a text that is not JSON probably is, or which mistake of writing JSON it has.

/// The formats that are taken for JSON, by their first bytes.
const BEGINNINGS: [(&[u8], &str); 11] = [
    (
        b"\xef\xbb\xbf",
        "the text begins with a byte order mark (BOM); save it as UTF-8 without BOM",
    ),
    (b"\xff\xfe", "the text is UTF-16; send UTF-8"),
    (b"\xfe\xff", "the text is UTF-16; send UTF-8"),
    (b"{\0", "the text is UTF-16; send UTF-8"),
    (b"\0{", "the text is UTF-16; send UTF-8"),
    (
        b"\x1f\x8b",
        "the text is compressed with gzip, and `Content-Encoding` is not supported; send it \
            uncompressed",
    ),
    (b"\x89PNG", IMAGE),
    (b"\xff\xd8\xff", IMAGE),
    (b"GIF8", IMAGE),
    (b"II*\0", IMAGE),
    (b"MM\0*", IMAGE),
];
const IMAGE: &str = "this is an image; the part `image` is the image, and the part `warp` the JSON";

/// What a body is that is empty or not even text.
pub(crate) fn not_text(body: &[u8]) -> Option<&'static str> {
    if body.trim_ascii().is_empty() {
        return Some("the text is empty; expected an object, {...}");
    }
    let is_webp = body.starts_with(b"RIFF") && body.get(8..12) == Some(b"WEBP");
    let known = BEGINNINGS
        .iter()
        .find(|(beginning, _)| body.starts_with(beginning))
        .map(|(_, what)| *what);
    known.or_else(|| is_webp.then_some(IMAGE))
}

/// A hint to follow an error in the syntax of `text`; empty if there is none.
pub(crate) fn hint(text: &str, error: &serde_json::Error) -> &'static str {
    let lines: usize = text
        .split_inclusive('\n')
        .take(error.line().saturating_sub(1))
        .map(str::len)
        .sum();
    // The column of the byte that was not expected, from 1; it may be within a word.
    let (before, rest) = text
        .as_bytes()
        .split_at((lines + error.column().saturating_sub(1)).min(text.len()));
    let start = before
        .iter()
        .rposition(|b| !b.is_ascii_alphabetic())
        .map_or(0, |end| end + 1);
    let word = text.as_bytes()[start..]
        .split(|b| !b.is_ascii_alphabetic())
        .next()
        .unwrap_or_default();
    match (rest.first(), word) {
        (_, b"NaN" | b"nan" | b"Infinity" | b"inf" | b"Inf") => {
            "; JSON has neither NaN nor infinity"
        }
        (_, b"True" | b"False" | b"None") => "; JSON has `true`, `false` and `null`",
        (Some(b'\''), _) => "; names and strings have double quotes",
        (Some(b'/' | b'#'), _) => "; JSON has no comments",
        (Some(b']' | b'}'), _) if before.trim_ascii_end().ends_with(b",") => {
            "; remove the comma before it"
        }
        _ => "",
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn mistakes_of_writing_json_are_recognised() {
        for (text, expected) in [
            ("{'p': []}", "; names and strings have double quotes"),
            (
                "{\"units\":\n 'px'}",
                "; names and strings have double quotes",
            ),
            ("{\"p\": [[1, 2],]}", "; remove the comma before it"),
            ("{\"p\": [],\n}", "; remove the comma before it"),
            ("{\"alpha\": NaN}", "; JSON has neither NaN nor infinity"),
            ("{\"alpha\": nan}", "; JSON has neither NaN nor infinity"),
            (
                "{\"p\": [\n[1, -Infinity]]}",
                "; JSON has neither NaN nor infinity",
            ),
            (
                "{\"inverse\": True}",
                "; JSON has `true`, `false` and `null`",
            ),
            ("{\"p\": None}", "; JSON has `true`, `false` and `null`"),
            ("// handles\n{}", "; JSON has no comments"),
            ("{\"p\": [] # rest\n}", "; JSON has no comments"),
            ("{\"p\": ]}", ""),
            ("{\"p\"", ""),
            ("not JSON", ""),
            ("\u{e9}", ""),
        ] {
            let error = serde_json::from_str::<&serde_json::value::RawValue>(text).expect_err(text);
            assert_eq!(hint(text, &error), expected, "{text}: {error}");
        }
    }

    #[test]
    fn what_is_not_text_is_recognised() {
        for (body, expected) in [
            (&b""[..], "the text is empty"),
            (b" \r\n", "the text is empty"),
            (b"\xef\xbb\xbf{}", "byte order mark"),
            (b"\xff\xfe{\0}\0", "UTF-16"),
            (b"\0{\0}", "UTF-16"),
            (b"\x1f\x8b\x08\0", "gzip"),
            (b"\x89PNG\r\n", "an image"),
            (b"\xff\xd8\xff\xe0", "an image"),
            (b"RIFF\0\0\0\0WEBPVP8L", "an image"),
        ] {
            assert!(
                not_text(body).is_some_and(|what| what.contains(expected)),
                "{expected}"
            );
        }
        assert_eq!(
            (not_text(b"{}"), not_text(b"RIFF"), not_text(b"\xff")),
            (None, None, None)
        );
    }
}
