//! What can be wrong with handles, and what is unusual about them. Every variant names the handle by its index.

use thiserror::Error;

/// Why a set of handles, or a pose of it, has no deformation.
#[derive(Clone, Debug, PartialEq, Error)]
pub enum DeformError {
    /// A coordinate, weight or parameter is NaN or infinite.
    #[error("handle {handle} has a coordinate that is not a finite number")]
    NotFinite {
        /// Index of the handle.
        handle: usize,
    },
    /// A coordinate is beyond what the arithmetic promises, 1e6 px.
    #[error("handle {handle} has a coordinate of {value} px; at most {limit} px either way")]
    OutOfRange {
        /// Index of the handle.
        handle: usize,
        /// The coordinate, px.
        value: f64,
        /// The limit, px.
        limit: f64,
    },
    /// A polyline needs two places or more.
    #[error("handle {handle} is a line of {places} places; at least 2")]
    TooFewPlaces {
        /// Index of the handle.
        handle: usize,
        /// How many it has.
        places: usize,
    },
    /// The posed handles differ from the rest handles in number.
    #[error("q has {}, p has {rest}", counted(*posed, "handle"))]
    CountMismatch {
        /// Handles at rest.
        rest: usize,
        /// Handles posed.
        posed: usize,
    },
    /// A posed handle is of another kind than its rest handle.
    #[error("handle {handle}: q has {posed}, p has {rest}")]
    ShapeMismatch {
        /// Index of the handle.
        handle: usize,
        /// Kind at rest.
        rest: String,
        /// Kind posed.
        posed: String,
    },
    /// `weights` has another length than `p`.
    #[error("weights has {}, p has {}", counted(*weights, "number"), counted(*rest, "handle"))]
    WeightCount {
        /// Handles at rest.
        rest: usize,
        /// Entries of `weights`.
        weights: usize,
    },
    /// A weight is not a positive finite number within range.
    #[error("the weight of handle {handle} is {value}; it must be a positive number between 1e-9 and 1e9")]
    BadWeight {
        /// Index of the handle.
        handle: usize,
        /// The weight.
        value: f64,
    },
    /// The mass of a point is not a positive finite number within range.
    #[error("point_mass is {value}; it must be a positive length between 1e-9 and 1e9 px")]
    BadPointMass {
        /// The mass, px.
        value: f64,
    },
    /// A segment at rest without length: it has no weight and no direction.
    #[error("handle {handle}: segment {segment} has zero length at rest; send a point instead")]
    DegenerateLine {
        /// Index of the handle.
        handle: usize,
        /// Which segment of the polyline.
        segment: usize,
    },
    /// Two handles that meet at rest are asked to go to different places.
    #[error("handles {first} and {second} meet at rest at ({x}, {y}) but their targets there are {apart} px apart")]
    Contradictory {
        /// Index of the first handle.
        first: usize,
        /// Index of the second handle (may be the same polyline).
        second: usize,
        /// Where they meet, px.
        x: f64,
        /// Where they meet, px.
        y: f64,
        /// Distance of their targets there, px.
        apart: f64,
    },
    /// The handles meet at more places than are looked at.
    #[error("the handles meet at more than {limit} places")]
    TooManyMeetings {
        /// The limit.
        limit: usize,
    },
    /// The handles lie so close to each other that more pairs would have to be compared than are.
    #[error(
        "the lines lie so close to each other that more than {limit} pairs of handles would have to be compared; send fewer or shorter lines"
    )]
    TooManyNeighbours {
        /// The limit.
        limit: u64,
    },
    /// Nobody waits for the result any more.
    #[error("cancelled: the result is no longer wanted")]
    Cancelled,
    /// alpha outside `(0, 8]`, or below 1/2 with lines (mathematics: the line would not be interpolated).
    #[error("alpha is {alpha}; it must be {}", if *.lines { "between 0.5 and 8 for a set with lines" } else { "above 0 and at most 8" })]
    AlphaOutOfRange {
        /// The exponent.
        alpha: f64,
        /// The set has lines.
        lines: bool,
    },
}

/// A number of things: `1 handle`, `2 handles`.
fn counted(n: usize, thing: &str) -> String {
    if n == 1 { format!("1 {thing}") } else { format!("{n} {thing}s") }
}

/// Something a client should know though a result exists.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Hash)]
pub enum Warning {
    /// Affine with all handles on one line: the similarity rows are used.
    AffineDegenerateUsedSimilarity,
    /// One handle, or all at one place: the result is a translation.
    TranslationOnly,
    /// Rigid: at some vertices every rotation fits equally well; none was applied there.
    RotationUndefined,
    /// Points nearer than 1 px whose targets are more than ten times as far apart.
    NearDuplicateHandles,
    /// Lines with alpha below 1: infinite slope across the line.
    LineAlphaBelowOne,
    /// No posed cell intersects the canvas.
    NothingVisible,
    /// The picture's file has a colour profile that is not carried over: it is damaged, too large, or not for RGB.
    ProfileDropped,
}

impl Warning {
    /// The stable code of the `Warp-Warning` header.
    #[must_use]
    pub const fn code(self) -> &'static str {
        match self {
            Self::AffineDegenerateUsedSimilarity => "affine_degenerate_used_similarity",
            Self::TranslationOnly => "translation_only",
            Self::RotationUndefined => "rotation_undefined",
            Self::NearDuplicateHandles => "near_duplicate_handles",
            Self::LineAlphaBelowOne => "line_alpha_below_one",
            Self::NothingVisible => "nothing_visible",
            Self::ProfileDropped => "profile_dropped",
        }
    }
}
