//! The `output` object: how the picture is made. A drag gives some of its fields, which replace those of the session.

use data_encoding::HEXLOWER_PERMISSIVE;
use mlswarp::codec::{Compression, Format};
use mlswarp::render::{Filter, Outside};
use mlswarp::warp::OutputSpec;

use super::enum_name::{Canvas, enum_name, unknown_name};
use super::fields;
use super::json::{Kind, Node, optional};
use super::number::count;
use super::suggest;
use crate::problem::words::{did_you_mean, quote};
use crate::problem::{Code, Problem};

const OUTSIDE: &str = "`transparent`, `edge`, `#rrggbb`, `#rrggbbaa`";

/// The fields that a request gives. `canvas` has one value in this version and is not kept.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub(crate) struct OutputPatch {
    pub(crate) format: Option<Format>,
    pub(crate) quality: Option<u8>,
    pub(crate) compression: Option<Compression>,
    pub(crate) width: Option<u32>,
    pub(crate) filter: Option<Filter>,
    pub(crate) outside: Option<Outside>,
}

impl OutputPatch {
    /// `base` with the given fields replaced.
    pub(crate) fn merge_onto(&self, base: &OutputSpec) -> OutputSpec {
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
        if node.kind() == Kind::String {
            return Err(node.wrong_kind("an object, such as {\"format\": \"jpeg\"}"));
        }
        let [format, quality_, compression, width, filter, outside_, canvas_] = node.fields(&fields::OUTPUT)?;
        optional(canvas_, canvas)?;
        Ok(Self {
            format: optional(format, enum_name)?,
            quality: optional(quality_, quality)?,
            compression: optional(compression, enum_name)?,
            width: optional(width, |n| count(n, 1, "a width: a whole number of pixels, at least 1"))?,
            filter: optional(filter, enum_name)?,
            outside: optional(outside_, outside)?,
        })
    }
}

/// The contract also has boxes.
fn canvas(node: &Node<'_, '_>) -> Result<Canvas, Problem> {
    match node.kind() {
        Kind::Object => Err(node.problem(Code::NotSupported, "not supported by this version: a box as `canvas`; supported: `same`")),
        _ => enum_name(node),
    }
}

fn quality(node: &Node<'_, '_>) -> Result<u8, Problem> {
    const QUALITY: &str = "a quality: a whole number of 1 to 100";
    let value = count(node, 1, QUALITY)?;
    match u8::try_from(value) {
        Ok(quality) if quality <= 100 => Ok(quality),
        _ => Err(node.unexpected(QUALITY, value).actual(value)),
    }
}

fn outside(node: &Node<'_, '_>) -> Result<Outside, Problem> {
    let text = node.string(&format!("one of {OUTSIDE}"))?;
    match text.as_str() {
        "transparent" => Ok(Outside::Transparent),
        "edge" => Ok(Outside::Edge),
        "reflect" => Err(unknown_name(node, &text, &["reflect"], &[], OUTSIDE)),
        _ => match text.strip_prefix('#').and_then(colour) {
            Some(colour) => Ok(Outside::Colour(colour)),
            None => {
                let colour = suggest::colour(&text);
                let meant = suggest::value(&text, &["transparent", "edge"]).or(colour.as_deref());
                Err(node.unexpected(&format!("one of {OUTSIDE}"), format_args!("{}{}", quote(&text), did_you_mean(meant))))
            }
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
