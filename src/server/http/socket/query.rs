//! The query of the drag socket: which frames a client wants.

use std::fmt::Display;
use std::ops::RangeInclusive;
use std::str::FromStr;

use mlswarp::codec::Format;

use crate::app::drag_socket::{DragOptions, FrameContent, MAX_WINDOW, PreviewWidth, Window};
use crate::http::headers::{bad_query_value, query_bool, query_fields};
use crate::problem::{Code, Problem};

/// Accepted tolerances of compact meshes, px.
const TOLERANCE_RANGE_PX: RangeInclusive<f64> = 0.1..=16.0;
/// The tolerance if the query has none, px.
const DEFAULT_TOLERANCE_PX: f64 = 0.5;

/// Reads
/// `?frames=auto|png|jpeg|webp|tiff|mesh&mesh=f32|compact&tolerance=PX&width=auto|N&window=auto|N`
/// `&report=true|false`.
/// Errors: Unknown fields, bad values, and fields that do not suit the frames.
pub(super) fn options(query: Option<&str>, max_side: u32) -> Result<DragOptions, Problem> {
    let [frames, mesh, tolerance, width, window, report] = query_fields(
        query,
        ["frames", "mesh", "tolerance", "width", "window", "report"],
    )?;
    let form = match (mesh, frames) {
        (None, None) => FrameContent::Picture(None),
        (None, Some(frames)) => frames_of(frames)?,
        (Some(mesh), frames) => mesh_of(mesh, frames.map(frames_of).transpose()?)?,
    };
    let options = DragOptions {
        form: tolerance.map_or(Ok(form), |value| with_tolerance(form, value))?,
        width: number("width", width, 1..=max_side)?
            .map_or(PreviewWidth::Auto, PreviewWidth::Fixed),
        report: report.map_or(Ok(false), |value| query_bool("report", value))?,
        window: number("window", window, 1..=MAX_WINDOW)?.map_or(Window::Auto, Window::Fixed),
    };
    if options.form.is_mesh() && options.width != PreviewWidth::Auto {
        return Err(Problem::new(
            Code::BadValue,
            "a mesh has no width: remove `width` from the query",
        ));
    }
    Ok(options)
}

fn frames_of(name: &str) -> Result<FrameContent, Problem> {
    let forms = || {
        let words: Vec<String> = ["auto"]
            .into_iter()
            .chain(mlswarp::format::words())
            .chain(["mesh"])
            .map(|word| format!("`{word}`"))
            .collect();
        words.join(", ")
    };
    match name {
        "mesh" => Ok(FrameContent::Mesh),
        "auto" => Ok(FrameContent::Auto),
        _ => {
            let format = Format::ALL
                .into_iter()
                .find(|format| format.info().word == name);
            format
                .map(|format| FrameContent::Picture(Some(format)))
                .ok_or_else(|| bad_query_value("frames", name, &format!("one of {}", forms())))
        }
    }
}

/// `mesh` implies meshes as frames.
fn mesh_of(value: &str, frames: Option<FrameContent>) -> Result<FrameContent, Problem> {
    if frames.is_some_and(|frames| frames != FrameContent::Mesh) {
        let detail =
            "`mesh` in the query needs meshes as frames: send `frames=mesh`, or remove `mesh`";
        return Err(Problem::new(Code::BadValue, detail));
    }
    match value {
        "f32" => Ok(FrameContent::Mesh),
        "compact" => Ok(FrameContent::CompactMesh(DEFAULT_TOLERANCE_PX)),
        _ => Err(bad_query_value("mesh", value, "`f32` or `compact`")),
    }
}

fn with_tolerance(form: FrameContent, value: &str) -> Result<FrameContent, Problem> {
    let FrameContent::CompactMesh(_) = form else {
        let detail = "`tolerance` in the query needs compact meshes: add `mesh=compact`, or \
            remove `tolerance`";
        return Err(Problem::new(Code::BadValue, detail));
    };
    let expected = || {
        format!(
            "a number of px, {} to {}",
            TOLERANCE_RANGE_PX.start(),
            TOLERANCE_RANGE_PX.end()
        )
    };
    let tolerance = value
        .parse()
        .ok()
        .filter(|px| TOLERANCE_RANGE_PX.contains(px));
    tolerance
        .map(FrameContent::CompactMesh)
        .ok_or_else(|| bad_query_value("tolerance", value, &expected()))
}

/// A whole number; `None` if it is absent or `auto`.
fn number<T: FromStr + PartialOrd + Display>(
    name: &str,
    value: Option<&str>,
    range: RangeInclusive<T>,
) -> Result<Option<T>, Problem> {
    let Some(value) = value.filter(|value| *value != "auto") else {
        return Ok(None);
    };
    let expected = || {
        format!(
            "`auto` or a whole number of {} to {}",
            range.start(),
            range.end()
        )
    };
    let read = value.parse().ok().filter(|number| range.contains(number));
    read.map(Some)
        .ok_or_else(|| bad_query_value(name, value, &expected()))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_query_says_what_frames_are() {
        let read = |query: &str| options(Some(query), 16384);
        let usual = DragOptions {
            form: FrameContent::Picture(None),
            width: PreviewWidth::Auto,
            report: false,
            window: Window::Auto,
        };
        assert_eq!(options(None, 16384), Ok(usual));
        assert_eq!(read("width=auto&report=false&window=auto"), Ok(usual));
        assert_eq!(
            read("window=8"),
            Ok(DragOptions {
                window: Window::Fixed(8),
                ..usual
            })
        );
        assert_eq!(
            read("width=1024&report=true"),
            Ok(DragOptions {
                width: PreviewWidth::Fixed(1024),
                report: true,
                ..usual
            })
        );
        assert_eq!(
            read("frames=auto"),
            Ok(DragOptions {
                form: FrameContent::Auto,
                ..usual
            })
        );
        for (query, form) in [
            ("frames=mesh", FrameContent::Mesh),
            ("mesh=f32", FrameContent::Mesh),
            ("frames=mesh&mesh=f32", FrameContent::Mesh),
            ("mesh=compact", FrameContent::CompactMesh(0.5)),
            (
                "frames=mesh&mesh=compact&tolerance=2",
                FrameContent::CompactMesh(2.0),
            ),
            (
                "tolerance=0.1&frames=mesh&mesh=compact",
                FrameContent::CompactMesh(0.1),
            ),
            (
                "mesh=compact&tolerance=1.6e1",
                FrameContent::CompactMesh(16.0),
            ),
        ] {
            assert_eq!(read(query), Ok(DragOptions { form, ..usual }), "{query}");
        }
        for (name, format) in [
            ("png", Format::Png),
            ("jpeg", Format::Jpeg),
            ("webp", Format::WebP),
            ("tiff", Format::Tiff),
        ] {
            assert_eq!(
                read(&format!("frames={name}")),
                Ok(DragOptions {
                    form: FrameContent::Picture(Some(format)),
                    ..usual
                })
            );
        }
        for (query, code) in [
            ("frames=gif", Code::BadValue),
            ("frames", Code::BadValue),
            ("width=0", Code::BadValue),
            ("width=16385", Code::BadValue),
            ("width=-1", Code::BadValue),
            ("frames=mesh&width=100", Code::BadValue),
            ("mesh=compact&width=100", Code::BadValue),
            ("frames=png&mesh=compact", Code::BadValue),
            ("frames=auto&mesh=f32", Code::BadValue),
            ("mesh=f16", Code::BadValue),
            ("frames=mesh&mesh", Code::BadValue),
            ("tolerance=1", Code::BadValue),
            ("frames=mesh&tolerance=1", Code::BadValue),
            ("mesh=f32&tolerance=1", Code::BadValue),
            ("mesh=compact&tolerance=0.09", Code::BadValue),
            ("mesh=compact&tolerance=16.1", Code::BadValue),
            ("mesh=compact&tolerance=NaN", Code::BadValue),
            ("mesh=compact&tolerance=inf", Code::BadValue),
            ("mesh=compact&tolerance=-1", Code::BadValue),
            ("mesh=compact&tolerance=", Code::BadValue),
            ("report=yes", Code::BadValue),
            ("window=0", Code::BadValue),
            ("window=9", Code::BadValue),
            ("window=-1", Code::BadValue),
            ("window=1.5", Code::BadValue),
            ("window", Code::BadValue),
            ("window=1&window=1", Code::MalformedRequest),
            ("report=true&report=false", Code::MalformedRequest),
            ("q=1", Code::UnknownField),
            ("Frames=png", Code::UnknownField),
        ] {
            assert_eq!(read(query).unwrap_err().code, code, "{query}");
        }
    }
}
