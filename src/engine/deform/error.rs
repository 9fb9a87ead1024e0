//! Errors and warnings about handles and poses. Variants name a handle by its index.

use std::fmt;

use super::conflicts::Conflict;
use crate::geometry::DisplayNumber;

/// What a mesh of a mask takes.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum MeshQuantity {
    /// Positions that handles hold.
    Positions,
    /// Memory, bytes.
    Bytes,
    /// Operations.
    Operations,
}

impl fmt::Display for MeshQuantity {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(match self {
            Self::Positions => "positions",
            Self::Bytes => "bytes",
            Self::Operations => "operations",
        })
    }
}

/// Why a method does not take a handle.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum NotTaken {
    /// It is a line, and the method takes points only.
    Line,
    /// It is a point, and the method takes lines only.
    Point,
    /// It is posed without length, and the method needs its direction.
    NoDirection,
}

/// Why a set of handles, or a pose of it, has no deformation.
#[derive(Clone, Debug, PartialEq)]
pub enum DeformError {
    /// A coordinate, weight or parameter is NaN or infinite.
    NotFinite {
        /// Index of the handle.
        handle: usize,
    },
    /// A coordinate is beyond the supported range, 1e6 px.
    OutOfRange {
        /// Index of the handle.
        handle: usize,
        /// The coordinate, px.
        value: f64,
        /// The limit, px.
        limit: f64,
    },
    /// A polyline needs two places or more.
    TooFewPlaces {
        /// Index of the handle.
        handle: usize,
        /// Its number of positions.
        places: usize,
    },
    /// The posed handles differ from the rest handles in number.
    CountMismatch {
        /// Handles at rest.
        rest: usize,
        /// Handles posed.
        posed: usize,
    },
    /// A posed handle is of another kind than its rest handle.
    ShapeMismatch {
        /// Index of the handle.
        handle: usize,
        /// Kind at rest.
        rest: String,
        /// Kind posed.
        posed: String,
    },
    /// A handle that has a position at rest has none in this pose.
    MissingInPose {
        /// Index of the handle.
        handle: usize,
    },
    /// `weights` has another length than `p`.
    WeightCount {
        /// Handles at rest.
        rest: usize,
        /// Entries of `weights`.
        weights: usize,
    },
    /// A weight is not a positive finite number within range.
    BadWeight {
        /// Index of the handle.
        handle: usize,
        /// The weight.
        value: f64,
    },
    /// `depth` has another length than `p`.
    DepthCount {
        /// Handles at rest.
        rest: usize,
        /// Entries of `depth`.
        depths: usize,
    },
    /// A depth is out of range.
    BadDepth {
        /// Index of the handle.
        handle: usize,
        /// The depth.
        value: f64,
    },
    /// The distance of coincidence is negative or beyond the range of coordinates.
    BadWithin {
        /// The distance, px.
        value: f64,
    },
    /// A segment at rest without length: it has no weight and no direction.
    DegenerateLine {
        /// Index of the handle.
        handle: usize,
        /// Which segment of the polyline.
        segment: usize,
    },
    /// Handles that coincide at rest have different targets.
    Contradictory {
        /// The first groups that were found, at least 1 and at most 100.
        listed: Vec<Conflict>,
        /// The number of all groups.
        total: usize,
    },
    /// The handles coincide at too many positions.
    TooManyMeetings {
        /// The limit.
        limit: usize,
    },
    /// The handles lie too close to each other: too many pairs would have to be compared.
    TooManyNeighbours {
        /// The limit.
        limit: u64,
    },
    /// Cancelled.
    Cancelled,
    /// A mask without a pixel.
    EmptyMask,
    /// A handle that is more than 3 px from the mask.
    OutsideMask {
        /// Index of the handle.
        handle: usize,
    },
    /// Distances inside the mask would take too much memory.
    MaskTooLarge {
        /// The limit, bytes.
        limit: u64,
        /// The memory, bytes.
        bytes: u64,
    },
    /// Distances inside the mask would take too long.
    MaskTooWinding {
        /// The limit, operations.
        limit: u64,
        /// The estimate, operations.
        operations: u64,
    },
    /// A mesh of the mask would have too many vertices.
    TooManyVertices {
        /// The limit.
        limit: usize,
    },
    /// A mesh of the mask would take too much.
    MeshTooLarge {
        /// What it would take.
        what: MeshQuantity,
        /// The limit.
        limit: u64,
        /// The amount.
        actual: u64,
    },
    /// A method whose map is known only on the mesh of a mask.
    NeedsMask {
        /// Name of the method.
        method: &'static str,
    },
    /// A method that does not weigh handles by their distance.
    NoMetric {
        /// Name of the method.
        method: &'static str,
    },
    /// A handle that the method does not take.
    NotTaken {
        /// Index of the handle.
        handle: usize,
        /// Name of the method.
        method: &'static str,
        /// What is wrong with it.
        reason: NotTaken,
    },
    /// A parameter is not a number within its range.
    BadParameter {
        /// Where it stands in a warp object: see `Parameter`.
        path: &'static str,
        /// The value.
        value: f64,
        /// What it must do.
        rule: &'static str,
    },
    /// alpha outside `(0, 8]`, or below 1/2 with lines (mathematics: the line would not be
    /// interpolated).
    AlphaOutOfRange {
        /// The exponent.
        alpha: f64,
        /// Whether the set has lines.
        lines: bool,
    },
}

/// A parameter that breaks its rule.
fn outside(f: &mut fmt::Formatter<'_>, name: &str, value: f64, rule: &str) -> fmt::Result {
    write!(f, "`{name}` is {}; it must {rule}", DisplayNumber(value))
}

const fn alpha_rule(has_lines: bool) -> &'static str {
    if has_lines {
        "be between 0.5 and 8 if a handle is a line"
    } else {
        "be above 0 and at most 8"
    }
}

impl NotTaken {
    fn write(self, f: &mut fmt::Formatter<'_>, handle: usize, method: &str) -> fmt::Result {
        let (is, does) = match self {
            Self::Line => (
                "is a line",
                "takes points only; send points along the line, or another method",
            ),
            Self::Point => (
                "is a point",
                "takes lines only: a point has no direction; send a line, or another method",
            ),
            Self::NoDirection => (
                "has a segment without length in `q`",
                "needs its direction; move its ends apart",
            ),
        };
        write!(f, "handle {handle} {is}, but the method `{method}` {does}")
    }
}

/// The first conflicts, and how many more there are.
fn write_conflicts(f: &mut fmt::Formatter<'_>, listed: &[Conflict], total: usize) -> fmt::Result {
    for (index, conflict) in listed.iter().take(MOST_DESCRIBED).enumerate() {
        write!(f, "{}{conflict}", if index > 0 { "; " } else { "" })?;
    }
    match total.saturating_sub(MOST_DESCRIBED) {
        0 => Ok(()),
        more => write!(f, "; and {more} more"),
    }
}

/// Another number of numbers than of handles.
fn another_count(
    f: &mut fmt::Formatter<'_>,
    field: &str,
    numbers: usize,
    rest: usize,
) -> fmt::Result {
    let (numbers, handles) = (counted(numbers, "number"), counted(rest, "handle"));
    write!(f, "`{field}` has {numbers}, but `p` has {handles}")
}

/// A number of a handle that is out of range.
fn bad_number(
    f: &mut fmt::Formatter<'_>,
    (handle, value): (usize, f64),
    what: &str,
    rule: &str,
) -> fmt::Result {
    let value = DisplayNumber(value);
    write!(
        f,
        "the {what} of handle {handle} is {value}; {what}s must {rule}"
    )
}

impl fmt::Display for DeformError {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::NotFinite { handle } => write!(
                f,
                "handle {handle} has a coordinate that is not a finite number"
            ),
            Self::OutOfRange {
                handle,
                value,
                limit,
            } => {
                write!(
                    f,
                    "handle {handle} has a coordinate of {} px; coordinates must lie between \
                        -{limit} and {limit} px",
                    DisplayNumber(*value)
                )
            }
            Self::TooFewPlaces { handle, places } => {
                write!(
                    f,
                    "handle {handle} is a line of {}; a line needs at least 2",
                    counted(*places, "position")
                )
            }
            Self::CountMismatch { rest, posed } => write!(
                f,
                "`q` has {}, but `p` has {rest}",
                counted(*posed, "handle")
            ),
            Self::ShapeMismatch {
                handle,
                rest,
                posed,
            } => write!(f, "handle {handle} is {posed} in `q`, but {rest} in `p`"),
            Self::MissingInPose { handle } => write!(
                f,
                "handle {handle} has a position in `p` and none in `q`: to leave it out, the set \
                    of rest handles must have none either"
            ),
            Self::WeightCount { rest, weights } => another_count(f, "weights", *weights, *rest),
            Self::BadWeight { handle, value } => {
                bad_number(f, (*handle, *value), "weight", "lie between 1e-9 and 1e9")
            }
            Self::DepthCount { rest, depths } => another_count(f, "depth", *depths, *rest),
            Self::BadDepth { handle, value } => {
                bad_number(f, (*handle, *value), "depth", "lie between -1000 and 1000")
            }
            Self::BadParameter { path, value, rule } => {
                outside(f, &path.replace('/', "."), *value, rule)
            }
            Self::BadWithin { value } => {
                outside(f, "within", *value, "lie between 0 and 1000000 px")
            }
            Self::DegenerateLine { handle, segment } => {
                write!(
                    f,
                    "handle {handle} is a line whose segment {segment} has no length at rest; \
                        send a point instead"
                )
            }
            Self::Contradictory { listed, total } => write_conflicts(f, listed, *total),
            Self::TooManyMeetings { limit } => write!(
                f,
                "the handles meet at more than {limit} positions; send fewer handles"
            ),
            Self::TooManyNeighbours { limit } => write!(
                f,
                "the lines lie so close to each other that more than {limit} pairs of handles \
                    would have to be compared; \
                 send fewer or shorter lines"
            ),
            Self::Cancelled => f.write_str("cancelled: the result is no longer wanted"),
            Self::EmptyMask
            | Self::OutsideMask { .. }
            | Self::MaskTooLarge { .. }
            | Self::MaskTooWinding { .. }
            | Self::NoMetric { .. }
            | Self::TooManyVertices { .. }
            | Self::MeshTooLarge { .. }
            | Self::NeedsMask { .. } => self.write_about_mask(f),
            Self::NotTaken {
                handle,
                method,
                reason,
            } => reason.write(f, *handle, method),
            Self::AlphaOutOfRange { alpha, lines } => {
                outside(f, "alpha", *alpha, alpha_rule(*lines))
            }
        }
    }
}

impl DeformError {
    /// The sentences about a mask, its metric and its mesh.
    fn write_about_mask(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::EmptyMask => f.write_str("no pixel of the image is inside the mask"),
            Self::OutsideMask { handle } => {
                write!(f, "handle {handle} is more than 3 px outside the mask")
            }
            Self::MaskTooLarge { limit, bytes } => write!(
                f,
                "distances inside the mask would take {bytes} bytes; the limit is {limit}"
            ),
            Self::MaskTooWinding { limit, operations } => write!(
                f,
                "distances inside the mask would take {operations} operations; the limit is {limit}"
            ),
            Self::NoMetric { method } => write!(f, "the method {method} has no metric"),
            Self::TooManyVertices { limit } => write!(
                f,
                "the mesh of what the image shows would have more than {limit} vertices"
            ),
            Self::MeshTooLarge {
                what,
                limit,
                actual,
            } => write!(
                f,
                "the mesh of what the image shows would take {actual} {what}; the limit is {limit}"
            ),
            Self::NeedsMask { method } => {
                write!(f, "the method {method} needs the mask of an image")
            }
            _ => Ok(()),
        }
    }
}

impl std::error::Error for DeformError {}

/// A number of things: `1 handle`, `2 handles`.
fn counted(n: usize, thing: &str) -> String {
    if n == 1 {
        format!("1 {thing}")
    } else {
        format!("{n} {thing}s")
    }
}

/// Conflicts that the text of an error describes.
const MOST_DESCRIBED: usize = 3;

/// An unusual property of handles or a pose that does not prevent a result.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Hash)]
pub enum Warning {
    /// Affine with all handles on one line: the similarity rows are used.
    AffineDegenerateUsedSimilarity,
    /// A thin-plate spline with all handles on one line: across the line, the result follows
    /// similarities.
    TpsDegenerateUsedSimilarity,
    /// One handle, or all at one place: the result is a translation.
    TranslationOnly,
    /// Rigid: at some vertices every rotation fits equally well; none was applied there.
    RotationUndefined,
    /// Points nearer than 1 px whose targets are more than ten times as far apart.
    NearDuplicateHandles,
    /// Lines with alpha below 1: infinite slope across the line.
    LineAlphaBelowOne,
    /// Handles that coincide at rest have different targets; their position moves by the mean.
    CoincidentHandles,
}

impl Warning {
    /// The stable code in responses.
    #[must_use]
    pub const fn code(self) -> &'static str {
        match self {
            Self::AffineDegenerateUsedSimilarity => "affine_degenerate_used_similarity",
            Self::TpsDegenerateUsedSimilarity => "tps_degenerate_used_similarity",
            Self::TranslationOnly => "translation_only",
            Self::RotationUndefined => "rotation_undefined",
            Self::NearDuplicateHandles => "near_duplicate_handles",
            Self::LineAlphaBelowOne => "line_alpha_below_one",
            Self::CoincidentHandles => "coincident_handles",
        }
    }
}
