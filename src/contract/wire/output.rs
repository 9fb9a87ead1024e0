//! The `output` object: how the picture is made. A drag gives some of its fields, which replace
//! those of the session.

use data_encoding::HEXLOWER_PERMISSIVE;
use mlswarp::format::{Compression, Format, Subsampling};
use mlswarp::pixmap::Extent;
use mlswarp::render::{Canvas, Filter, Outside};
use mlswarp::warp::{CanvasSpec, FARTHEST_EDGE_PX, Holes, OutputSpec};

use super::enum_name::{enum_name, unknown_name};
use super::fields;
use super::fields::OutputFields;
use super::json::{Kind, Node, optional};
use super::number::{count, integer, whole};
use super::suggest;
use crate::problem::words::{did_you_mean, quote};
use crate::problem::{Code, Problem};

const CANVAS: &str = "`same`, `fit`, {\"x\": px, \"y\": px, \"width\": px, \"height\": px}";
/// The longest side of a canvas: from one farthest edge to the other.
const LONGEST_CANVAS_PX: u32 = 2 * FARTHEST_EDGE_PX.unsigned_abs();
const OUTSIDE: &str =
    "`transparent`, `edge`, `reflect`, `#rrggbb`, `#rrggbbaa`, {\"value\": number or [r, g, b]}";
const VALUE: &str =
    "a whole number of 0 to 65535, in units of the image's depth, or three of them: [r, g, b]";

/// The fields that a request gives.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct OutputPatch {
    /// File format.
    pub format: Option<Format>,
    /// Quality of a lossy format, 1 to 100.
    pub quality: Option<u8>,
    /// Resolution of a JPEG's colours.
    pub subsampling: Option<Subsampling>,
    /// How much time is spent on a smaller file.
    pub compression: Option<Compression>,
    /// The part of the posed plane that is drawn.
    pub canvas: Option<CanvasSpec>,
    /// Width of the output, px.
    pub width: Option<u32>,
    /// How the image is sampled.
    pub filter: Option<Filter>,
    /// What is drawn beyond the image's edge.
    pub outside: Option<Outside>,
    /// What is drawn where no cell lies.
    pub holes: Option<Holes>,
}

impl OutputPatch {
    /// `base` with the given fields replaced.
    pub fn merge_onto(&self, base: &OutputSpec) -> OutputSpec {
        OutputSpec {
            format: self.format.unwrap_or(base.format),
            quality: self.quality.unwrap_or(base.quality),
            subsampling: self.subsampling.or(base.subsampling),
            compression: self.compression.unwrap_or(base.compression),
            canvas: self.canvas.unwrap_or(base.canvas),
            width: self.width.or(base.width),
            filter: self.filter.unwrap_or(base.filter),
            outside: self.outside.unwrap_or(base.outside),
            holes: self.holes.unwrap_or(base.holes),
        }
    }

    pub(crate) fn read(node: &Node<'_, '_>) -> Result<Self, Problem> {
        if node.kind() == Kind::String {
            return Err(node.wrong_kind("an object, such as {\"format\": \"jpeg\"}"));
        }
        let fields = OutputFields::from(node.fields(&fields::OUTPUT)?);
        Ok(Self {
            format: optional(fields.format, enum_name)?,
            quality: optional(fields.quality, quality)?,
            subsampling: optional(fields.subsampling, enum_name)?,
            compression: optional(fields.compression, enum_name)?,
            canvas: optional(fields.canvas, canvas)?,
            width: optional(fields.width, width)?,
            filter: optional(fields.filter, enum_name)?,
            outside: optional(fields.outside, outside)?,
            holes: optional(fields.holes, enum_name)?,
        })
    }
}

pub(super) fn width(node: &Node<'_, '_>) -> Result<u32, Problem> {
    count(node, 1, "a width: a whole number of pixels, at least 1")
}

pub(super) fn canvas(node: &Node<'_, '_>) -> Result<CanvasSpec, Problem> {
    match node.kind() {
        Kind::String => match node.string(CANVAS)?.as_str() {
            "same" => Ok(CanvasSpec::Same),
            "fit" => Ok(CanvasSpec::Fit),
            other => Err(unknown_name(node, other, &[], &["same", "fit"], CANVAS)),
        },
        Kind::Object => {
            let [Some(x), Some(y), Some(width), Some(height)] = node.fields(&fields::CANVAS)?
            else {
                return Err(node.problem(
                    Code::BadValue,
                    format!("expected `x`, `y`, `width` and `height`; a canvas is one of {CANVAS}"),
                ));
            };
            let place =
                |node: &Node<'_, '_>| integer(node, FARTHEST_EDGE_PX, "a whole number of pixels");
            let side = |node: &Node<'_, '_>| {
                let expected = format!("a whole number of pixels, 1 to {LONGEST_CANVAS_PX}");
                let side = count(node, 1, &expected)?;
                if side <= LONGEST_CANVAS_PX {
                    Ok(side)
                } else {
                    Err(node.unexpected(&expected, side).actual(side))
                }
            };
            let extent = Extent::new(side(&width)?, side(&height)?).expect("at least 1");
            Ok(CanvasSpec::Box(Canvas {
                x: place(&x)?,
                y: place(&y)?,
                extent,
            }))
        }
        _ => Err(node.wrong_kind(&format!("one of {CANVAS}"))),
    }
}

/// Reads a canvas of the command line: `same`, `fit`, or `x,y,width,height`.
/// Errors: What was expected.
pub fn canvas_from_text(text: &str) -> Result<CanvasSpec, String> {
    let numbers: Option<Vec<i64>> = text
        .split(',')
        .map(|number| number.trim().parse().ok())
        .collect();
    let place = |place: i64| {
        i32::try_from(place)
            .ok()
            .filter(|place| place.abs() <= FARTHEST_EDGE_PX)
    };
    let side = |side: i64| {
        u32::try_from(side)
            .ok()
            .filter(|side| *side <= LONGEST_CANVAS_PX)
    };
    match (text, numbers.as_deref()) {
        ("same", _) => Ok(CanvasSpec::Same),
        ("fit", _) => Ok(CanvasSpec::Fit),
        (_, Some(&[x, y, width, height])) => {
            let extent = side(width)
                .zip(side(height))
                .and_then(|(width, height)| Extent::new(width, height));
            let canvas = place(x)
                .zip(place(y))
                .zip(extent)
                .map(|((x, y), extent)| CanvasSpec::Box(Canvas { x, y, extent }));
            canvas.ok_or_else(|| {
                format!(
                    "x and y must lie between -{FARTHEST_EDGE_PX} and {FARTHEST_EDGE_PX}, \
                width and height between 1 and {LONGEST_CANVAS_PX}"
                )
            })
        }
        _ => Err("expected `same`, `fit`, or four whole numbers: x,y,width,height".to_owned()),
    }
}

/// A canvas as `x,y,width,height`.
pub fn canvas_text(Canvas { x, y, extent }: Canvas) -> String {
    format!("{x},{y},{},{}", extent.width(), extent.height())
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
    if node.kind() == Kind::Object {
        let [given] = node.fields(&fields::OUTSIDE)?;
        return value(&given.ok_or_else(|| node.missing("value", VALUE))?).map(Outside::Value);
    }
    let text = node.string(&format!("one of {OUTSIDE}"))?;
    match text.as_str() {
        "transparent" => Ok(Outside::Transparent),
        "edge" => Ok(Outside::Edge),
        "reflect" => Ok(Outside::Reflect),
        _ => match text.strip_prefix('#').and_then(colour) {
            Some(colour) => Ok(Outside::Colour(colour)),
            None => {
                let colour = suggest::colour(&text);
                let meant = suggest::value(&text, &["transparent", "edge", "reflect"])
                    .or(colour.as_deref());
                Err(node.unexpected(
                    &format!("one of {OUTSIDE}"),
                    format_args!("{}{}", quote(&text), did_you_mean(meant)),
                ))
            }
        },
    }
}

/// One sample for all colours, or one for each.
fn value(node: &Node<'_, '_>) -> Result<[u16; 3], Problem> {
    let sample = |node: &Node<'_, '_>| {
        let value = whole(node, VALUE)?;
        u16::try_from(value).map_err(|_| node.unexpected(VALUE, value).actual(value))
    };
    if node.kind() != Kind::Array {
        return sample(node).map(|value| [value; 3]);
    }
    let (mut value, mut count) = ([0; 3], 0);
    node.items::<Problem>(VALUE, |index, item| {
        *value
            .get_mut(index)
            .ok_or_else(|| node.unexpected(VALUE, "more than 3 numbers"))? = sample(&item)?;
        count += 1;
        Ok(())
    })?;
    if count == value.len() {
        Ok(value)
    } else {
        Err(node.unexpected(VALUE, format_args!("{count} of 3 numbers")))
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
