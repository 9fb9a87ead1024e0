//! The `output` object: how the picture is made. A drag gives some of its fields, which replace those of the session.

use data_encoding::HEXLOWER_PERMISSIVE;
use mlswarp::codec::{Compression, Format};
use mlswarp::render::{Filter, Outside};
use mlswarp::warp::OutputSpec;

use super::enum_name::{Canvas, refuse, word};
use super::json::{Kind, Node, quote};
use super::number::count;
use crate::problem::{Code, Problem};

const OUTSIDE: &str = "`transparent`, `edge`, `#rrggbb`, `#rrggbbaa`";

/// The output fields that a request gave. Canvas has one value in this version: given or not is the same.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct OutputPatch {
    /// File format.
    pub format: Option<Format>,
    /// JPEG quality, 1 to 100.
    pub quality: Option<u8>,
    /// PNG compression.
    pub compression: Option<Compression>,
    /// Width of the target, px.
    pub width: Option<u32>,
    /// How the source is read.
    pub filter: Option<Filter>,
    /// What is painted where the posed picture does not reach.
    pub outside: Option<Outside>,
}

impl OutputPatch {
    /// The session's output with the given fields replaced.
    pub fn merge_onto(&self, base: &OutputSpec) -> OutputSpec {
        OutputSpec {
            format: self.format.unwrap_or(base.format),
            quality: self.quality.unwrap_or(base.quality),
            compression: self.compression.unwrap_or(base.compression),
            width: self.width.or(base.width),
            filter: self.filter.unwrap_or(base.filter),
            outside: self.outside.unwrap_or(base.outside),
        }
    }

    pub(crate) fn read(node: &Node<'_, '_>) -> Result<Self, Problem> {
        let [format, quality_, compression, width, filter, outside_, canvas] =
            node.fields("an object", &["format", "quality", "compression", "width", "filter", "outside", "canvas"])?;
        canvas.map(|n| word::<Canvas>(&n)).transpose()?;
        Ok(Self {
            format: format.map(|n| word(&n)).transpose()?,
            quality: quality_.map(|n| quality(&n)).transpose()?,
            compression: compression.map(|n| word(&n)).transpose()?,
            width: width.map(|n| count(&n, 1, "a width: a whole number of pixels, at least 1")).transpose()?,
            filter: filter.map(|n| word(&n)).transpose()?,
            outside: outside_.map(|n| outside(&n)).transpose()?,
        })
    }
}

fn quality(node: &Node<'_, '_>) -> Result<u8, Problem> {
    const QUALITY: &str = "a quality: a whole number of 1 to 100";
    let value = count(node, 1, QUALITY)?;
    match u8::try_from(value) {
        Ok(quality) if quality <= 100 => Ok(quality),
        _ => Err(node.problem(Code::BadValue, format!("expected {QUALITY}; found {value}")).actual(value)),
    }
}

fn outside(node: &Node<'_, '_>) -> Result<Outside, Problem> {
    if node.kind() != Kind::String {
        return Err(node.wrong_kind(&format!("one of {OUTSIDE}")));
    }
    let text = node.string(OUTSIDE)?;
    match text.as_str() {
        "transparent" => Ok(Outside::Transparent),
        "edge" => Ok(Outside::Edge),
        _ => match text.strip_prefix('#') {
            Some(digits) => colour(digits).map(Outside::Colour).ok_or_else(|| {
                node.problem(Code::BadValue, format!("expected a colour, `#rrggbb` or `#rrggbbaa`; found {}", quote(&text)))
            }),
            None => Err(refuse(node, &text, &["reflect"], OUTSIDE)),
        },
    }
}

/// Straight RGBA of 6 or 8 hexadecimal digits; opaque with 6.
fn colour(digits: &str) -> Option<[u8; 4]> {
    let mut rgba = HEXLOWER_PERMISSIVE.decode(digits.as_bytes()).ok()?;
    if rgba.len() == 3 {
        rgba.push(255);
    }
    rgba.try_into().ok()
}
