//! XMP (ISO 16684-1): a packet is kept as it is, without the properties that describe the stored
//! pixels and would be wrong of others. They are found by the names that the specifications give
//! them, in both forms that a property has: an attribute or an element.

use std::borrow::Cow;

/// The largest packet that is kept: as much as a segment of a JPEG holds.
pub(super) const MOST_BYTES: usize = 65_000;

/// Orientation, size, resolution, thumbnails, regions, and the name of parts that are not kept.
const OF_PIXELS: [&str; 15] = [
    "tiff:Orientation",
    "tiff:ImageWidth",
    "tiff:ImageLength",
    "tiff:XResolution",
    "tiff:YResolution",
    "tiff:ResolutionUnit",
    "exif:PixelXDimension",
    "exif:PixelYDimension",
    "exif:SubjectArea",
    "exif:SubjectLocation",
    "xmp:Thumbnails",
    "xap:Thumbnails",
    "mwg-rs:Regions",
    "MP:RegionInfo",
    "xmpNote:HasExtendedXMP",
];

/// The packet without these properties; `None` if it is too large, no UTF-8, or damaged.
pub(super) fn kept(packet: &[u8]) -> Option<Vec<u8>> {
    let packet = packet.strip_prefix(b"\xEF\xBB\xBF").unwrap_or(packet);
    let packet = packet.split(|byte| *byte == 0).next().unwrap_or_default();
    if packet.is_empty() || packet.len() > MOST_BYTES {
        return None;
    }
    let mut text = Cow::Borrowed(std::str::from_utf8(packet).ok()?);
    for name in OF_PIXELS {
        if text.contains(name) {
            text = Cow::Owned(without(&text, name)?);
        }
    }
    // A thumbnail that is not in one of these properties still shows the stored pixels.
    (!text.contains("xmpGImg:image")).then(|| text.into_owned().into_bytes())
}

/// The text without a property; `None` if one does not end.
fn without(text: &str, name: &str) -> Option<String> {
    let end_tag = format!("</{name}");
    let (mut out, mut rest) = (String::with_capacity(text.len()), text);
    while let Some(at) = rest.find(name) {
        let (before, found) = rest.split_at(at);
        let behind = &found[name.len()..];
        let end = if before.ends_with('<') {
            element_end(behind, &end_tag)
        } else {
            attribute_end(before, behind)
        };
        let end = end?;
        let is_element = before.ends_with('<') && end > 0;
        out.push_str(if is_element {
            &before[..at - 1]
        } else {
            before
        });
        if end == 0 {
            out.push_str(name);
        }
        rest = &behind[end..];
    }
    out.push_str(rest);
    Some(out)
}

/// The end of an element whose name has been read: 0 if the name is longer, `None` if there is no
/// end.
fn element_end(behind: &str, end_tag: &str) -> Option<usize> {
    if !behind.is_empty()
        && !behind.starts_with(|c: char| c.is_ascii_whitespace() || c == '>' || c == '/')
    {
        return Some(0);
    }
    let open = behind.find('>')?;
    if behind[..open].ends_with('/') {
        return Some(open + 1);
    }
    let close = open + behind[open..].find(end_tag)?;
    Some(close + behind[close..].find('>')? + 1)
}

/// The end of an attribute whose name has been read: 0 if it is no attribute.
fn attribute_end(before: &str, behind: &str) -> Option<usize> {
    let value = behind.trim_start().strip_prefix('=').map(str::trim_start);
    let Some(value) = value.filter(|_| before.ends_with(|c: char| c.is_ascii_whitespace())) else {
        return Some(0);
    };
    let Some(quote) = value
        .chars()
        .next()
        .filter(|quote| matches!(quote, '"' | '\''))
    else {
        return Some(0);
    };
    let end = value[1..].find(quote)?;
    Some(behind.len() - value.len() + end + 2)
}

#[cfg(test)]
mod tests {
    use super::*;

    fn kept_text(text: &str) -> Option<String> {
        kept(text.as_bytes()).map(|kept| String::from_utf8(kept).unwrap())
    }

    #[test]
    fn properties_of_the_stored_pixels_are_left_out_in_every_form() {
        let description = |inside: &str, content: &str| {
            format!("<rdf:Description a=\"1\"{inside} b='2'>{content}<dc:x/></rdf:Description>")
        };
        let plain = description("", "");
        for inside in [
            " tiff:Orientation=\"6\"",
            "\n\ttiff:Orientation = '6'",
            " exif:PixelXDimension=\"4000\" tiff:ImageWidth='9'",
        ] {
            assert_eq!(
                kept_text(&description(inside, ""))
                    .unwrap()
                    .replace(['\n', '\t', ' '], ""),
                plain.replace(' ', ""),
                "{inside}"
            );
        }
        for content in [
            "<tiff:Orientation>6</tiff:Orientation>",
            "<tiff:Orientation/>",
            "<xmp:Thumbnails>\n<rdf:Alt><rdf:li \
                xmpGImg:image=\"/9j/4AAQ\"/></rdf:Alt></xmp:Thumbnails>",
            "<mwg-rs:Regions rdf:parseType=\"Resource\"><a/></mwg-rs:Regions >",
        ] {
            assert_eq!(
                kept_text(&description("", content)).unwrap(),
                plain,
                "{content}"
            );
        }
    }

    #[test]
    fn everything_else_stays_as_it_is() {
        for text in [
            "<x:xmpmeta><dc:title>tiff:Orientation</dc:title></x:xmpmeta>",
            "<a tiff:OrientationOfText=\"6\"/>",
            "<tiff:OrientationOfText>6</tiff:OrientationOfText>",
            "<a tiff:Make=\"Ä\"/>",
        ] {
            assert_eq!(kept_text(text).as_deref(), Some(text));
        }
        assert_eq!(
            kept(b"\xEF\xBB\xBF<a/>\0\0"),
            Some(b"<a/>".to_vec()),
            "a mark and padding are no part of it"
        );
    }

    #[test]
    fn a_damaged_packet_is_not_kept() {
        for text in [
            "<tiff:Orientation>6",
            "<tiff:Orientation",
            "<a tiff:Orientation=\"6",
            "<a xmpGImg:image=\"x\"/>",
            "",
        ] {
            assert_eq!(kept_text(text), None, "{text}");
        }
        assert_eq!(kept(b"\xFF\xFE<\0"), None, "UTF-16");
        assert_eq!(kept(&vec![b' '; MOST_BYTES + 1]), None);
        let many = "<tiff:Orientation/>".repeat(MOST_BYTES / 19);
        assert_eq!(kept_text(&many).as_deref(), Some(""));
    }
}
