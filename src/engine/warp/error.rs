//! Errors and warnings of a warp, by what the client can change.

use std::cmp::Ordering;
use std::convert::Infallible;
use std::fmt;

use super::{GridSpec, Quantity};
use crate::deform::{self, DeformError, METHODS, Method, MethodInfo, Parameter, unfoldable};
use crate::format::{CodecError, Dropped, Format, Repairs};
use crate::geometry::DisplayNumber;
use crate::pixmap::{Extent, PixelError};

/// Why an image was not warped.
#[derive(Clone, Debug, PartialEq)]
pub enum WarpError {
    /// The file.
    Codec(CodecError),
    /// Samples that are no picture of the stated size.
    Pixels(PixelError),
    /// The rest handles p, or a parameter.
    Rest(DeformError),
    /// The posed handles q.
    Posed(DeformError),
    /// A position to be mapped is invalid.
    BadPlace {
        /// Index of the position.
        index: usize,
        /// The coordinate, px.
        value: f64,
        /// The limit, px.
        limit: f64,
    },
    /// Cancelled.
    Cancelled,
    /// Over a limit.
    TooLarge {
        /// What is limited.
        what: Quantity,
        /// The limit.
        limit: u64,
        /// The requested value.
        actual: u64,
    },
    /// More work than the limit, as it is estimated before it begins.
    TooMuchWork {
        /// What would take them.
        task: Task,
        /// The limit.
        limit: u64,
        /// The estimate; at a task that has begun, what it has taken so far.
        actual: u64,
    },
    /// A parameter of another method.
    ForeignParameter {
        /// The field: `alpha`, or the object of a method.
        parameter: &'static str,
    },
    /// A line where points are compared.
    LineInFit {
        /// Index of the handle.
        handle: usize,
    },
    /// A method that says nothing about points in the plane, where methods are compared.
    NotCompared {
        /// Its name.
        method: &'static str,
    },
    /// Too few points to compare methods.
    TooFewPoints {
        /// The fewest.
        least: usize,
        /// The number of distinct points.
        actual: usize,
    },
    /// A table of coefficients is not worth its time.
    NoTable {
        /// A sentence.
        reason: &'static str,
    },
    /// A threshold of the mask, without a metric or method that has a mask.
    UnusedMask,
    /// A metric or method that follows the shape of what an image shows, without an image.
    NoImage,
    /// An image that is continued beyond its border, by a grid that is cut along a mask.
    CutBorder,
    /// A grid that is cut along a mask, where all cells of a grid are needed.
    CutGrid {
        /// What needs them.
        what: &'static str,
    },
    /// An invalid grid.
    BadGrid(GridError),
    /// Labels in a format that would change them.
    LabelFormat {
        /// The format.
        format: Format,
    },
    /// Labels of 32 bit, which no format stores.
    WideLabels,
    /// A picture of another size than the one that handles were placed on.
    OtherSize {
        /// The size that the handles have.
        expected: Extent,
        /// The size of the picture.
        actual: Extent,
    },
    /// A value outside that the samples of the picture cannot have.
    OutsideBeyondDepth {
        /// The value.
        value: u16,
        /// The largest.
        most: u16,
    },
    /// A value outside of labels.
    OutsideOfLabels,
    /// `folds: reject` and the posed grid folds.
    Folded {
        /// Folded cells.
        cells: u64,
    },
    /// `folds: remove`, for a method or a metric whose folds cannot be removed.
    NotUnfolded,
    /// `folds: remove`, and no map without folds takes the handles to their targets.
    Unreachable {
        /// Indices of handles that would have to pass through each other, or through themselves.
        handles: Vec<usize>,
    },
    /// `canvas: fit` and the posed picture has no area.
    NothingVisible,
}

impl fmt::Display for WarpError {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::Codec(error) => error.fmt(f),
            Self::Pixels(error) => error.fmt(f),
            Self::Rest(error) | Self::Posed(error) => error.fmt(f),
            Self::BadPlace { value, limit, .. } => write!(
                f,
                "a position has a coordinate of {} px; coordinates must lie between -{limit} and \
                    {limit} px",
                DisplayNumber(*value)
            ),
            Self::Cancelled => f.write_str("cancelled: the result is no longer wanted"),
            Self::TooLarge {
                what,
                limit,
                actual,
            } => write!(f, "{what}: {actual}; the limit is {limit}"),
            Self::TooMuchWork {
                task,
                limit,
                actual,
            } => write!(
                f,
                "{} would take {actual} operations; the limit is {limit}",
                task.name()
            ),
            Self::ForeignParameter { parameter } => f.write_str(&foreign(parameter)),
            Self::LineInFit { handle } => write!(
                f,
                "handle {handle} is a line, but methods are compared on points"
            ),
            Self::NotCompared { method } => write!(
                f,
                "the method {method} is not compared with others: it takes lines, or needs an image"
            ),
            Self::TooFewPoints { least, actual } => write!(
                f,
                "methods are compared on at least {least} distinct points; found {actual}"
            ),
            Self::UnusedMask => f.write_str(
                "a threshold of the mask does not apply: metric and method have no mask",
            ),
            Self::NoImage => f.write_str("the metric needs the mask of an image"),
            Self::CutBorder => {
                f.write_str("an image cannot be continued beyond the outline that its grid follows")
            }
            Self::CutGrid { what } => write!(f, "{what} needs a grid that is not cut along a mask"),
            Self::NoTable { reason } => f.write_str(reason),
            Self::BadGrid(error) => error.fmt(f),
            Self::LabelFormat { format } => write!(
                f,
                "labels cannot be written as {}, which would change them; use PNG or TIFF",
                format.name()
            ),
            Self::WideLabels => {
                f.write_str("labels of 32 bit fit no file format; take them from memory")
            }
            Self::OtherSize { expected, actual } => write!(
                f,
                "the handles lie on an image of {} x {} px, but this one has {} x {} px",
                expected.width(),
                expected.height(),
                actual.width(),
                actual.height()
            ),
            Self::OutsideBeyondDepth { value, most } => write!(
                f,
                "the value {value} outside exceeds {most}, the largest of an image of {} bits",
                if *most > 255 { 16 } else { 8 }
            ),
            Self::OutsideOfLabels => f.write_str("outside, labels are 0, and no other value"),
            Self::Folded { cells } => write!(
                f,
                "the warp folds over itself in {cells} {} of the grid",
                if *cells == 1 { "cell" } else { "cells" }
            ),
            Self::NotUnfolded => write!(
                f,
                "folds can be removed with the methods {}, and with distances in the plane",
                unfoldable("")
            ),
            Self::Unreachable { handles } => write!(
                f,
                "no map without folds takes the handles {} to their targets: they would have to \
                    pass through each other, or through themselves",
                listed(handles)
            ),
            Self::NothingVisible => f.write_str("the posed picture has no area"),
        }
    }
}

impl std::error::Error for WarpError {}

impl WarpError {
    /// An error of the handles at rest.
    pub(super) fn of_rest(error: DeformError) -> Self {
        if matches!(error, DeformError::Cancelled) {
            Self::Cancelled
        } else {
            Self::Rest(error)
        }
    }
}

/// A size that is known to be one.
impl From<Infallible> for WarpError {
    fn from(never: Infallible) -> Self {
        match never {}
    }
}

impl From<PixelError> for WarpError {
    fn from(error: PixelError) -> Self {
        Self::Pixels(error)
    }
}

/// What is wrong with a grid.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum GridError {
    /// A tolerance out of [`GridSpec::TOLERANCE_RANGE_PX`], px.
    Tolerance(f64),
    /// The side of a cell, which is no positive number, px.
    Cell(f64),
    /// Fewer than two columns or rows of vertices.
    Counts {
        /// Columns of vertices.
        columns: u32,
        /// Rows of vertices.
        rows: u32,
    },
    /// A method that draws a mesh of its own.
    OwnMesh(Method),
    /// Cells without a whole number of pixels, or more of them, in a grid that is cut along a mask.
    CutCells {
        /// The longest side of a cell, px.
        most: u32,
    },
}

impl fmt::Display for GridError {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::Tolerance(tolerance) => {
                let (least, most) = GridSpec::TOLERANCE_RANGE_PX.into_inner();
                write!(
                    f,
                    "the tolerance of a grid must be {least} to {most} px; found {}",
                    DisplayNumber(*tolerance)
                )
            }
            Self::Cell(cell) => write!(
                f,
                "the cell of a grid must be a positive number of pixels; found {}",
                DisplayNumber(*cell)
            ),
            Self::Counts { columns, rows } => write!(
                f,
                "a grid needs at least 2 columns and 2 rows of vertices; found {columns} x {rows}"
            ),
            Self::OwnMesh(method) => write!(
                f,
                "the method {} draws a mesh of its own",
                method.info().name
            ),
            Self::CutCells { most } => write!(
                f,
                "a grid that is cut along a mask has cells of 1 to {most} whole px"
            ),
        }
    }
}

/// Work that is a product or a power by nature.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Task {
    /// The linear system of a method.
    System(Method),
    /// The coefficients of a grid, or posing one without a table.
    Grid,
    /// Positions, mapped by f or its inverse.
    Positions,
    /// Outlines that are subdivided.
    Outlines,
    /// Methods, compared.
    Comparison,
    /// The measures of a report.
    Quality,
    /// The frames of a batch that are posed before the first is drawn.
    Survey,
    /// A map without folds.
    Folds,
}

impl Task {
    /// The subject of a sentence.
    #[must_use]
    pub fn name(self) -> &'static str {
        match self {
            Self::System(method) => {
                let system = method.info().system.as_ref();
                system.map_or("the system of the method", |system| system.name)
            }
            Self::Grid => "the grid with these handles",
            Self::Positions => "mapping the positions with these handles",
            Self::Outlines => "refining the outlines with these handles",
            Self::Comparison => "comparing the candidates on these points",
            Self::Quality => "measuring the posed grid",
            Self::Survey => "posing all frames before the first is sent",
            Self::Folds => "removing folds with these handles",
        }
    }
}

/// An unusual property of a warp that does not prevent a result, with the figures that describe it.
#[derive(Clone, Debug, PartialEq, PartialOrd)]
pub enum Warning {
    /// A property of the handles or the pose.
    Deform(deform::Warning),
    /// Some cells of the grid are farther from the exact map than the tolerance.
    ToleranceExceeded,
    /// A rest handle is farther from the picture than the picture's size, or a posed handle is ten
    /// times as far and not on the canvas.
    HandlesOutsidePicture,
    /// The units are px and all of p or of q is within 0 to 1.5, and not a single corner of the
    /// picture; or the units are normalised and a value is beyond 4.
    LooksNormalized,
    /// Handles that have no position at rest, or had none when they were posed, are left out.
    HandlesMissing {
        /// Their indices, ascending.
        handles: Vec<usize>,
    },
    /// Landmarks that only one of two files has are left out.
    LandmarksUnmatched,
    /// The metric follows the mask of the image, and every pixel is inside: it is that of the
    /// plane.
    MaskIsEverything,
    /// Folds were to be removed, and cells remain folded, or cover others at the border.
    FoldsRemain {
        /// Their number.
        cells: u64,
    },
    /// No posed cell intersects the canvas.
    NothingVisible,
    /// Most of the picture is turned over, as in a mirror.
    Mirrored,
    /// The handles mirror the picture, and the method cannot.
    MirroredUseAffine {
        /// Of the best affine map of the handles.
        determinant: f64,
    },
    /// The handles give the picture another size, and the method keeps it.
    ScaledUseSimilarity {
        /// Of the best affine map of the handles.
        scale: f64,
    },
    /// Annotations are farther from their image than its size, or look as if they had another unit
    /// than the handles; then [`Warning::LooksNormalized`] says so too.
    AnnotationsOutsidePicture,
    /// The output says less about the meaning of its colours than the file.
    ProfileDropped,
    /// The output lacks these metadata of the file.
    MetadataDropped(Dropped),
    /// The file was mended to be read; its pixels are complete.
    FileRepaired(Repairs),
}

/// A figure of a warning.
#[derive(Clone, Debug, PartialEq)]
pub enum Figure {
    /// A number of things, or the index of one.
    Count(u64),
    /// A measure.
    Number(f64),
    /// Indices of handles or frames.
    Indices(Vec<usize>),
    /// Names, as of things in a file.
    Names(Vec<String>),
}

impl Figure {
    fn names(names: impl Iterator<Item = &'static str>) -> Self {
        Self::Names(names.map(str::to_owned).collect())
    }
}

impl Warning {
    /// Whether it is about the file of the picture, whatever the pose.
    #[must_use]
    pub const fn is_of_file(&self) -> bool {
        matches!(
            self,
            Self::ProfileDropped | Self::MetadataDropped(_) | Self::FileRepaired(_)
        )
    }

    /// The stable code in responses.
    #[must_use]
    pub const fn code(&self) -> &'static str {
        match self {
            Self::Deform(warning) => warning.code(),
            Self::ToleranceExceeded => "tolerance_exceeded",
            Self::HandlesOutsidePicture => "handles_outside_picture",
            Self::LooksNormalized => "looks_normalized",
            Self::HandlesMissing { .. } => "handles_missing",
            Self::MaskIsEverything => "mask_is_everything",
            Self::LandmarksUnmatched => "landmarks_unmatched",
            Self::FoldsRemain { .. } => "folds_remain",
            Self::NothingVisible => "nothing_visible",
            Self::Mirrored => "mirrored",
            Self::MirroredUseAffine { .. } => "mirrored_use_affine",
            Self::ScaledUseSimilarity { .. } => "scaled_use_similarity",
            Self::AnnotationsOutsidePicture => "annotations_outside_picture",
            Self::ProfileDropped => "profile_dropped",
            Self::MetadataDropped(_) => "metadata_dropped",
            Self::FileRepaired(_) => "file_repaired",
        }
    }

    /// What a report says beside the code, each figure with its name.
    #[must_use]
    pub fn figures(&self) -> Vec<(&'static str, Figure)> {
        match self {
            Self::MirroredUseAffine { determinant } => {
                vec![("determinant", Figure::Number(*determinant))]
            }
            Self::ScaledUseSimilarity { scale } => vec![("scale", Figure::Number(*scale))],
            Self::HandlesMissing { handles } => vec![("handles", Figure::Indices(handles.clone()))],
            Self::FoldsRemain { cells } => vec![("cells", Figure::Count(*cells))],
            Self::Deform(_)
            | Self::ToleranceExceeded
            | Self::HandlesOutsidePicture
            | Self::LooksNormalized
            | Self::LandmarksUnmatched
            | Self::MaskIsEverything
            | Self::NothingVisible
            | Self::Mirrored
            | Self::AnnotationsOutsidePicture
            | Self::ProfileDropped => vec![],
            Self::MetadataDropped(dropped) => vec![("dropped", Figure::names(dropped.names()))],
            Self::FileRepaired(repairs) => vec![("repaired", Figure::names(repairs.names()))],
        }
    }

    /// Each warning once, in the order of the variants.
    #[must_use]
    pub fn in_order(mut warnings: Vec<Self>) -> Vec<Self> {
        warnings.sort_by(|a, b| a.partial_cmp(b).unwrap_or(Ordering::Equal));
        warnings.dedup_by_key(|warning| warning.code());
        warnings
    }
}

impl From<CodecError> for WarpError {
    fn from(error: CodecError) -> Self {
        if error == CodecError::Cancelled {
            Self::Cancelled
        } else {
            Self::Codec(error)
        }
    }
}

/// The first handles.
fn listed(handles: &[usize]) -> String {
    const MOST_LISTED: usize = 8;
    let first: Vec<String> = handles
        .iter()
        .take(MOST_LISTED)
        .map(usize::to_string)
        .collect();
    let more = if handles.len() > MOST_LISTED {
        ", ..."
    } else {
        ""
    };
    first.join(", ") + more
}

/// Says which methods a parameter belongs to.
fn foreign(parameter: &str) -> String {
    let has_it = |info: &&&MethodInfo| {
        let named = |own: &Parameter| own.path == parameter || own.object() == Some(parameter);
        info.parameters.iter().any(named)
    };
    let owners = METHODS.iter().filter(has_it).map(|info| info.name);
    let owners: Vec<String> = owners.map(|name| format!("`{name}`")).collect();
    let reason = match owners.as_slice() {
        [] => "no method has it".to_owned(),
        [one] => format!("it belongs to the method {one}"),
        [all @ .., last] => format!("it belongs to the methods {} and {last}", all.join(", ")),
    };
    format!("`{parameter}` does not apply: {reason}")
}
