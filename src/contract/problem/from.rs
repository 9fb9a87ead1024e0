//! The errors of the engine as problems. The matches have no `_` arm, so a new error does not
//! compile until it has a code here.

use mlswarp::deform::{Conflict, DeformError, NotTaken};
use mlswarp::format::CodecError;
use mlswarp::warp::{Task, WarpError};
use serde_json::{Value, json};

use super::{Code, Problem, sentences};

/// Handles that a problem lists.
const MOST_HANDLES: usize = 100;
/// Seconds after which cancelled work may be requested again.
const RETRY_CANCELLED: u32 = 1;

impl From<WarpError> for Problem {
    fn from(error: WarpError) -> Self {
        let detail = sentences::of_warp(&error);
        match error {
            WarpError::Codec(error) => Self::from(error),
            WarpError::Rest(error) => handle_problem("p", &error),
            WarpError::Posed(error) => handle_problem("q", &error),
            WarpError::BadPlace {
                index,
                value,
                limit,
            } => Self::new(Code::BadValue, detail)
                .pointer(format!("/points/{index}"))
                .limit("coordinate", limit, number(value)),
            WarpError::Cancelled => {
                Self::new(Code::Overloaded, detail).retry_after(RETRY_CANCELLED)
            }
            WarpError::TooLarge {
                what,
                limit,
                actual,
            } => {
                let (name, pointer, _) = sentences::limit(what);
                let problem = Self::new(Code::TooLarge, detail).limit(name, limit, actual);
                match pointer {
                    Some(pointer) => problem.pointer(pointer),
                    None => problem,
                }
            }
            WarpError::TooMuchWork {
                task,
                limit,
                actual,
            } => {
                let problem = Self::new(Code::TooLarge, detail).limit("work", limit, actual);
                match task {
                    Task::System(_) => problem.pointer("/p"),
                    Task::Grid | Task::Quality => problem.pointer("/grid"),
                    Task::Comparison => problem.pointer("/candidates"),
                    Task::Folds => problem.pointer("/folds"),
                    Task::Positions | Task::Outlines | Task::Survey => problem,
                }
            }
            WarpError::ForeignParameter { parameter } => {
                Self::new(Code::BadValue, detail).pointer(format!("/{parameter}"))
            }
            WarpError::LineInFit { handle } => Self::new(Code::BadValue, detail)
                .pointer(format!("/p/{handle}"))
                .handle(handle),
            WarpError::NotCompared { .. } => {
                Self::new(Code::NotSupported, detail).pointer("/method")
            }
            WarpError::TooFewPoints { actual, .. } => Self::new(Code::BadValue, detail)
                .pointer("/p")
                .actual(actual),
            WarpError::UnusedMask => Self::new(Code::BadValue, detail).pointer("/mask"),
            WarpError::NoTable { .. } => Self::new(Code::NoTable, detail),
            WarpError::CutBorder => {
                Self::new(Code::NotSupported, detail).pointer("/output/outside")
            }
            WarpError::NoImage | WarpError::CutGrid { .. } => {
                Self::new(Code::NotSupported, detail).pointer("/metric")
            }
            WarpError::BadGrid(_) => Self::new(Code::BadValue, detail).pointer("/grid"),
            WarpError::LabelFormat { .. } => {
                Self::new(Code::BadValue, detail).pointer("/output/format")
            }
            // What has no JSON: pictures and labels in memory.
            WarpError::Pixels(_) | WarpError::OtherSize { .. } | WarpError::WideLabels => {
                Self::new(Code::BadValue, detail)
            }
            WarpError::OutsideBeyondDepth { value, most } => Self::new(Code::BadValue, detail)
                .pointer("/output/outside/value")
                .limit("outside_value", most, value),
            WarpError::OutsideOfLabels => {
                Self::new(Code::BadValue, detail).pointer("/output/outside")
            }
            WarpError::Folded { cells } => Self::new(Code::Folded, detail)
                .pointer("/folds")
                .actual(cells),
            WarpError::NotUnfolded => Self::new(Code::NotSupported, detail).pointer("/folds"),
            WarpError::Unreachable { mut handles } => {
                handles.truncate(MOST_HANDLES);
                let problem = Self::new(Code::Unreachable, detail).pointer("/q");
                match *handles {
                    [handle] => problem.pointer(format!("/q/{handle}")).handle(handle),
                    _ => problem,
                }
                .extra("handles", handles)
            }
            WarpError::NothingVisible => {
                Self::new(Code::NothingVisible, detail).pointer("/output/canvas")
            }
        }
    }
}

impl From<CodecError> for Problem {
    fn from(error: CodecError) -> Self {
        let detail = error.to_string();
        match error {
            CodecError::Unsupported { .. } => Self::new(Code::UnsupportedFormat, detail),
            CodecError::TooLarge {
                what,
                limit,
                actual,
            } => Self::new(Code::TooLarge, detail).limit(what, limit, actual),
            CodecError::Bad { .. } => Self::new(Code::BadImage, detail),
            CodecError::Cancelled => WarpError::Cancelled.into(),
        }
    }
}

/// `field`: `p` or `q`.
fn handle_problem(field: &str, error: &DeformError) -> Problem {
    let new = |code| Problem::new(code, sentences::of_handles(error));
    let at_handle = |code, handle: usize| {
        new(code)
            .pointer(format!("/{field}/{handle}"))
            .handle(handle)
    };
    let too_large = || new(Code::TooLarge).pointer(format!("/{field}"));
    match *error {
        DeformError::NotFinite { handle } => at_handle(Code::NotFinite, handle),
        DeformError::OutOfRange {
            handle,
            value,
            limit,
        } => at_handle(Code::BadValue, handle).limit("coordinate", limit, number(value)),
        DeformError::TooFewPlaces { handle, places } => {
            at_handle(Code::BadValue, handle).actual(places)
        }
        DeformError::CountMismatch { .. } => new(Code::ShapeMismatch).pointer(format!("/{field}")),
        DeformError::ShapeMismatch { handle, .. } => at_handle(Code::ShapeMismatch, handle),
        DeformError::MissingInPose { handle } => {
            let mut problem = at_handle(Code::BadValue, handle);
            problem.detail.push_str(
                "; in a session, send `p` with `null` there to PUT /sessions/{id}/handles",
            );
            problem
        }
        DeformError::WeightCount { .. } => new(Code::ShapeMismatch).pointer("/weights"),
        DeformError::BadWeight { handle, value } => new(Code::BadValue)
            .pointer(format!("/weights/{handle}"))
            .handle(handle)
            .actual(number(value)),
        DeformError::DepthCount { .. } => new(Code::ShapeMismatch).pointer("/depth"),
        DeformError::BadDepth { handle, value } => new(Code::BadValue)
            .pointer(format!("/depth/{handle}"))
            .handle(handle)
            .actual(number(value)),
        DeformError::BadParameter { path, value, .. } => new(Code::BadValue)
            .pointer(format!("/{path}"))
            .actual(number(value)),
        DeformError::BadWithin { value } => new(Code::BadValue)
            .pointer("/coincident/within")
            .actual(number(value)),
        DeformError::DegenerateLine { handle, .. } => at_handle(Code::DegenerateLine, handle),
        DeformError::NotTaken { handle, reason, .. } => match reason {
            NotTaken::Line => at_handle(Code::BadValue, handle),
            NotTaken::Point => at_handle(Code::NotSupported, handle),
            NotTaken::NoDirection => at_handle(Code::DegenerateLine, handle),
        },
        DeformError::Contradictory { ref listed, .. } => {
            let first = listed.first().and_then(|group| group.handles.first());
            let problem = first.map_or_else(
                || new(Code::ContradictoryHandles),
                |handle| at_handle(Code::ContradictoryHandles, *handle),
            );
            problem.extra(
                "coincident",
                listed.iter().map(coincident).collect::<Vec<_>>(),
            )
        }
        DeformError::TooManyMeetings { limit } => {
            too_large().limit("handle_meetings", limit, limit + 1)
        }
        DeformError::TooManyNeighbours { limit } => {
            too_large().limit("handle_comparisons", limit, limit + 1)
        }
        DeformError::Cancelled => new(Code::Timeout),
        DeformError::EmptyMask => new(Code::EmptyMask).pointer("/mask"),
        DeformError::OutsideMask { handle } => at_handle(Code::OutsideMask, handle),
        DeformError::MaskTooLarge { limit, bytes } => too_large().limit("plan_bytes", limit, bytes),
        DeformError::MaskTooWinding { limit, operations } => {
            too_large().limit("work", limit, operations)
        }
        DeformError::TooManyVertices { limit } => new(Code::TooManyVertices)
            .pointer("/arap/cell")
            .limit("arap_vertices", limit, limit + 1),
        DeformError::MeshTooLarge {
            what,
            limit,
            actual,
        } => too_large().limit(sentences::mesh_limit(what), limit, actual),
        DeformError::NeedsMask { .. } => new(Code::NotSupported).pointer("/method"),
        DeformError::NoMetric { .. } => new(Code::NotSupported).pointer("/metric"),
        DeformError::AlphaOutOfRange { alpha, .. } => new(Code::AlphaOutOfRange)
            .pointer("/alpha")
            .actual(number(alpha)),
    }
}

/// A group of handles that contradict each other.
fn coincident(group: &Conflict) -> Value {
    json!({"handles": group.handles, "position": [group.position.x, group.position.y],
        "spread": group.spread})
}

/// JSON has no infinities and no NaN; they become strings.
fn number(value: f64) -> Value {
    if value.is_finite() {
        value.into()
    } else {
        value.to_string().into()
    }
}

#[cfg(test)]
mod tests {
    use mlswarp::geometry::Point;
    use mlswarp::warp::{GridError, Method, Quantity};

    use super::*;

    fn expect(
        error: WarpError,
        code: Code,
        pointer: Option<&str>,
        handle: Option<usize>,
    ) -> Problem {
        let text = sentences::of_warp(&error);
        let problem = Problem::from(error);
        assert_eq!(
            (problem.code, problem.pointer.as_deref(), problem.handle),
            (code, pointer, handle),
            "{text}"
        );
        assert_eq!(problem.detail, text);
        problem
    }

    #[test]
    fn rest_and_posed_handles_point_to_p_and_q() {
        use DeformError as D;
        let (p, q) = (WarpError::Rest, WarpError::Posed);
        expect(
            p(D::NotFinite { handle: 4 }),
            Code::NotFinite,
            Some("/p/4"),
            Some(4),
        );
        expect(
            q(D::NotFinite { handle: 4 }),
            Code::NotFinite,
            Some("/q/4"),
            Some(4),
        );
        expect(
            p(D::TooFewPlaces {
                handle: 1,
                places: 1,
            }),
            Code::BadValue,
            Some("/p/1"),
            Some(1),
        );
        expect(
            q(D::CountMismatch { rest: 3, posed: 2 }),
            Code::ShapeMismatch,
            Some("/q"),
            None,
        );
        let shape = D::ShapeMismatch {
            handle: 2,
            rest: "a point".to_owned(),
            posed: "a line of 2 places".to_owned(),
        };
        expect(q(shape), Code::ShapeMismatch, Some("/q/2"), Some(2));
        expect(
            p(D::NotTaken {
                handle: 3,
                method: "tps",
                reason: NotTaken::Line,
            }),
            Code::BadValue,
            Some("/p/3"),
            Some(3),
        );
        expect(
            p(D::DepthCount { rest: 2, depths: 3 }),
            Code::ShapeMismatch,
            Some("/depth"),
            None,
        );
        expect(
            p(D::BadDepth {
                handle: 5,
                value: -1e300,
            }),
            Code::BadValue,
            Some("/depth/5"),
            Some(5),
        );
        expect(
            p(D::BadParameter {
                path: "smoothing",
                value: -1.0,
                rule: "lie between 0 and 1e9",
            }),
            Code::BadValue,
            Some("/smoothing"),
            None,
        );
        expect(
            p(D::DegenerateLine {
                handle: 7,
                segment: 1,
            }),
            Code::DegenerateLine,
            Some("/p/7"),
            Some(7),
        );
        let out = expect(
            q(D::OutOfRange {
                handle: 0,
                value: -2e6,
                limit: 1e6,
            }),
            Code::BadValue,
            Some("/q/0"),
            Some(0),
        );
        assert_eq!(
            (out.limit, out.actual),
            (Some(1e6.into()), Some((-2e6).into()))
        );
    }

    #[test]
    fn parameters_point_to_their_own_field() {
        use DeformError as D;
        let p = WarpError::Rest;
        expect(
            p(D::WeightCount {
                rest: 2,
                weights: 3,
            }),
            Code::ShapeMismatch,
            Some("/weights"),
            None,
        );
        expect(
            p(D::BadWeight {
                handle: 5,
                value: -1.0,
            }),
            Code::BadValue,
            Some("/weights/5"),
            Some(5),
        );
        expect(
            p(D::BadParameter {
                path: "x/a",
                value: 0.0,
                rule: "be above 0",
            }),
            Code::BadValue,
            Some("/x/a"),
            None,
        );
        expect(
            p(D::AlphaOutOfRange {
                alpha: 9.0,
                lines: false,
            }),
            Code::AlphaOutOfRange,
            Some("/alpha"),
            None,
        );
        let infinite = expect(
            p(D::BadParameter {
                path: "point_mass",
                value: f64::INFINITY,
                rule: "be finite",
            }),
            Code::BadValue,
            Some("/point_mass"),
            None,
        );
        assert_eq!(infinite.actual, Some("inf".into()));
    }

    #[test]
    fn conflict_names_both_handles() {
        let conflict = Conflict {
            handles: vec![2, 9],
            total: 2,
            position: Point::new(1.0, 2.0),
            spread: 1.5,
            apart: Some(3.0),
        };
        let error = DeformError::Contradictory {
            listed: vec![conflict],
            total: 1,
        };
        let problem = expect(
            WarpError::Posed(error),
            Code::ContradictoryHandles,
            Some("/q/2"),
            Some(2),
        );
        assert!(
            problem.detail.contains("handles 2 and 9"),
            "{}",
            problem.detail
        );
        assert_eq!(
            problem.to_json("", None)["coincident"],
            json!([{"handles": [2, 9], "position": [1.0, 2.0], "spread": 1.5}])
        );
    }

    #[test]
    fn files_limits_grid_and_folds() {
        expect(
            WarpError::Codec(CodecError::Unsupported {
                found: "GIF".to_owned(),
            }),
            Code::UnsupportedFormat,
            None,
            None,
        );
        expect(
            WarpError::Codec(CodecError::Bad {
                format: "PNG",
                detail: "cut".to_owned(),
            }),
            Code::BadImage,
            None,
            None,
        );
        let side = WarpError::Codec(CodecError::TooLarge {
            what: "image_side",
            limit: 10,
            actual: 11,
        });
        assert_eq!(
            expect(side, Code::TooLarge, None, None).what,
            Some("image_side")
        );
        for (what, pointer) in [
            (Quantity::HandleColumns, Some("/p")),
            (Quantity::SystemHandles(Method::ThinPlateSpline), Some("/p")),
            (Quantity::GridVertices, Some("/grid")),
            (Quantity::OutputSide, Some("/output/width")),
            (Quantity::OutputPixels, Some("/output/width")),
            (Quantity::ScaledSourceSide, Some("/output/width")),
            (Quantity::Memory, None),
        ] {
            let problem = expect(
                WarpError::TooLarge {
                    what,
                    limit: 1,
                    actual: 2,
                },
                Code::TooLarge,
                pointer,
                None,
            );
            assert_eq!(
                (problem.limit, problem.actual),
                (Some(1.into()), Some(2.into()))
            );
        }
        expect(
            WarpError::ForeignParameter { parameter: "alpha" },
            Code::BadValue,
            Some("/alpha"),
            None,
        );
        expect(
            WarpError::BadGrid(GridError::Cell(0.0)),
            Code::BadValue,
            Some("/grid"),
            None,
        );
        let format = mlswarp::format::Format::Jpeg;
        expect(
            WarpError::LabelFormat { format },
            Code::BadValue,
            Some("/output/format"),
            None,
        );
        let folded = expect(
            WarpError::Folded { cells: 3 },
            Code::Folded,
            Some("/folds"),
            None,
        );
        assert_eq!(folded.actual, Some(3.into()));
    }
}
