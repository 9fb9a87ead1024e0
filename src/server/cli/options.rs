//! The options of a subcommand as JSON: each is an object with one field, so that the same parser
//! reads both and a message names the option.

use mlswarp::codec::Format;
use serde_json::{Value, json};

use super::failure::Failure;
use crate::config::{BlendArgs, FileOptions, FrameOptions, FramesOptions, PoseOptions};
use crate::problem::{Code, Problem};
use crate::wire::{AsJson, NamedObject, canvas_from_text};

/// The object of an option that was given.
pub(super) fn source(flag: &str, field: &str, value: Option<Value>) -> Option<NamedObject> {
    let json = json!({field: value?}).to_string().into_bytes();
    Some(NamedObject {
        name: flag.to_owned(),
        json,
        is_option: true,
    })
}

/// The same for a field of `output`.
fn of_output(flag: &str, field: &str, value: Option<Value>) -> Option<NamedObject> {
    source(flag, "output", value.map(|value| json!({field: value})))
}

/// A number as it is, and other text as a string, which the parser refuses with what it expects.
fn number(text: Option<&String>) -> Option<Value> {
    let text = text?;
    let whole = text.parse::<i64>().map(Value::from).ok();
    Some(
        whole
            .or_else(|| {
                text.parse::<f64>()
                    .ok()
                    .filter(|number| number.is_finite())
                    .map(Value::from)
            })
            .unwrap_or_else(|| json!(text)),
    )
}

fn name(text: Option<&String>) -> Option<Value> {
    text.map(|text| json!(text))
}

/// `--canvas`, as the value of a field.
pub(super) fn canvas(text: Option<&String>) -> Result<Option<Value>, Failure> {
    let canvas = text.map(|text| canvas_from_text(text).map(|canvas| json!(AsJson(canvas))));
    canvas
        .transpose()
        .map_err(|expected| Failure::Local(format!("--canvas: {expected}")))
}

pub(super) fn align(text: Option<&String>) -> Option<NamedObject> {
    source("--align", "align", name(text))
}

impl PoseOptions {
    pub(super) fn sources(&self) -> Vec<NamedObject> {
        let Self {
            method,
            alpha,
            strength,
            align,
        } = self;
        let sources = [
            source("--method", "method", name(method.as_ref())),
            source("--alpha", "alpha", number(alpha.as_ref())),
            source("--strength", "strength", number(strength.as_ref())),
            self::align(align.as_ref()),
        ];
        sources.into_iter().flatten().collect()
    }
}

impl BlendArgs {
    /// The options that are fields of the blend object.
    pub(super) fn sources(&self) -> Vec<NamedObject> {
        let sources = [
            source("--steps", "steps", number(self.steps.as_ref())),
            source("--space", "space", name(self.space.as_ref())),
            source("--method", "method", name(self.method.as_ref())),
            source("--alpha", "alpha", number(self.alpha.as_ref())),
            align(self.align.as_ref()),
        ];
        sources.into_iter().flatten().collect()
    }
}

impl FrameOptions {
    /// As fields of `output`.
    /// Errors: A canvas in another form.
    pub(super) fn sources(&self) -> Result<Vec<NamedObject>, Failure> {
        let canvas = of_output("--canvas", "canvas", canvas(self.canvas.as_ref())?);
        Ok([
            canvas,
            of_output("--width", "width", number(self.width.as_ref())),
        ]
        .into_iter()
        .flatten()
        .collect())
    }

    /// As fields of a map.
    /// Errors: A canvas in another form.
    pub(super) fn of_map(&self) -> Result<Vec<NamedObject>, Failure> {
        let canvas = source("--canvas", "canvas", canvas(self.canvas.as_ref())?);
        Ok([
            canvas,
            source("--width", "width", number(self.width.as_ref())),
        ]
        .into_iter()
        .flatten()
        .collect())
    }
}

impl FileOptions {
    pub(super) fn sources(&self) -> Vec<NamedObject> {
        let format = of_output("--format", "format", name(self.format.as_ref()));
        [
            format,
            of_output("--quality", "quality", number(self.quality.as_ref())),
        ]
        .into_iter()
        .flatten()
        .collect()
    }
}

impl FramesOptions {
    pub(super) fn sources(&self) -> Vec<NamedObject> {
        let Self {
            steps,
            easing,
            and_back,
            plays,
            delay,
        } = self;
        let sources = [
            source("--steps", "steps", number(steps.as_ref())),
            source("--easing", "easing", name(easing.as_ref())),
            source("--and-back", "and_back", and_back.then_some(json!(true))),
            source("--loop", "loop", number(plays.as_ref())),
            source("--delay", "delay", number(delay.as_ref())),
        ];
        sources.into_iter().flatten().collect()
    }
}

/// Errors: `--quality` without effect. `cure`: what gives it one.
pub(super) fn require_quality_of_jpeg(
    options: &FileOptions,
    format: Format,
    cure: &str,
) -> Result<(), Failure> {
    if options.quality.is_none() || format.info().has_quality {
        return Ok(());
    }
    let detail = format!(
        "it applies to JPEG; the output is {}: {cure}",
        format.name()
    );
    Err(Failure::from(Problem::new(Code::BadValue, detail)).about("--quality"))
}

/// `--canvas` of a report.
/// Errors: A canvas in another form.
pub(super) fn of_report(text: Option<&String>) -> Result<Vec<NamedObject>, Failure> {
    Ok(of_output("--canvas", "canvas", canvas(text)?)
        .into_iter()
        .collect())
}
