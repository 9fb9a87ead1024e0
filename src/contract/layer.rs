//! The name and the kind of a layer: a further picture of a session, which is warped with it.

use std::fmt;

use mlswarp::pixmap::Extent;

use crate::problem::{Code, Problem};

/// Most layers of a session.
pub const MAX_LAYERS: usize = 16;
/// Longest name of a layer, bytes.
const MAX_NAME: usize = 64;

/// The name of a stored layer: 1 to 64 of the characters `A-Z`, `a-z`, `0-9`, `.`, `_` and `-`, not
/// only dots. Names that begin with `@` are built-in. Clients and proxies remove `.` and `..` from
/// paths: a request for `layers/..` would be one for the session.
#[derive(Clone, Debug, PartialEq, Eq, Hash, PartialOrd, Ord)]
pub struct LayerName(String);

impl LayerName {
    /// The layer that is the mask of what moves.
    pub const REGION: &'static str = "region";

    /// Checks a name.
    pub fn parse(text: &str) -> Option<Self> {
        let is_allowed =
            |byte: u8| byte.is_ascii_alphanumeric() || matches!(byte, b'.' | b'_' | b'-');
        let is_name = (1..=MAX_NAME).contains(&text.len())
            && text.bytes().all(is_allowed)
            && text.bytes().any(|byte| byte != b'.');
        is_name.then(|| Self(text.to_owned()))
    }

    /// The name `region`.
    pub fn region() -> Self {
        Self(Self::REGION.to_owned())
    }

    /// Its text.
    pub fn as_str(&self) -> &str {
        &self.0
    }

    /// Whether both are one name where upper and lower case are not told apart, as in the file
    /// names of many systems, and yet are two.
    pub fn is_twin(&self, other: &Self) -> bool {
        self != other && self.0.eq_ignore_ascii_case(&other.0)
    }

    /// Whether the layer is the mask of what moves.
    pub fn is_region(&self) -> bool {
        self.0 == Self::REGION
    }
}

impl fmt::Display for LayerName {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(&self.0)
    }
}

/// What a request names instead of the session's picture.
#[derive(Clone, Debug, PartialEq, Eq)]
pub enum LayerRef {
    /// `@coverage`: how much of each pixel the posed picture covers.
    Coverage,
    /// `@holes`: where content of the region moved away and nothing covers the place.
    Holes,
    /// A stored layer.
    Stored(LayerName),
}

impl LayerRef {
    /// The names of the built-in layers.
    pub const BUILT_IN: [&'static str; 2] = ["@coverage", "@holes"];

    /// The layer of a name; `None` of a text that is no name.
    pub fn parse(text: &str) -> Option<Self> {
        match text {
            "@coverage" => Some(Self::Coverage),
            "@holes" => Some(Self::Holes),
            _ => LayerName::parse(text).map(Self::Stored),
        }
    }

    /// Its name.
    pub fn as_str(&self) -> &str {
        match self {
            Self::Coverage => "@coverage",
            Self::Holes => "@holes",
            Self::Stored(name) => name.as_str(),
        }
    }
}

/// How the pixels of a layer are read.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Hash, PartialOrd, Ord)]
pub enum LayerKind {
    /// A picture: its colours are interpolated.
    #[default]
    Image,
    /// Labels: the nearest one is copied, never interpolated.
    Labels,
}

/// Checks that a layer or region has the size of its image.
pub fn check_extent(found: Extent, expected: Extent) -> Result<(), Problem> {
    if found == expected {
        return Ok(());
    }
    let [found, expected] =
        [found, expected].map(|extent| format!("{}x{}", extent.width(), extent.height()));
    let detail = format!(
        "the file has {found} px after EXIF orientation; a layer or region must have the size of \
            the picture, {expected} px"
    );
    Err(Problem::new(Code::BadValue, detail).limit("layer_size", expected, found))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn names_are_short_and_plain() {
        for good in ["a", "depth.v2", "A_b-9", "..a", &"x".repeat(64)] {
            assert_eq!(
                LayerName::parse(good).as_ref().map(LayerName::as_str),
                Some(good)
            );
        }
        for bad in [
            "",
            ".",
            "..",
            "...",
            "@coverage",
            "a b",
            "a/b",
            "é",
            "a\n",
            &"x".repeat(65),
        ] {
            assert_eq!(LayerName::parse(bad), None, "{bad:?}");
        }
        assert!(
            LayerRef::BUILT_IN
                .iter()
                .all(|name| matches!(LayerRef::parse(name),
                    Some(built_in) if built_in != LayerRef::Stored(LayerName::region())))
        );
        assert_eq!(
            (LayerRef::parse("region"), LayerRef::parse("@region")),
            (Some(LayerRef::Stored(LayerName::region())), None)
        );
        let name = |text: &str| LayerName::parse(text).unwrap();
        assert!(
            name("Depth").is_twin(&name("depth"))
                && !name("depth").is_twin(&name("depth"))
                && !name("a").is_twin(&name("b"))
        );
        assert!(
            LayerName::region().is_region() && !LayerName::parse("Region").unwrap().is_region()
        );
    }
}
