//! An image is warped: the only file that sees all four layers (codec, pixmap, deform, render). It knows no time, no sockets, no users.
//!
//! The walk: [`Image::decode`] (cached by content) -> [`Setup::new`] (rest handles resolved against the image's size) -> [`Setup::plan`]
//! (cached by [`Setup::plan_key`]) -> [`Setup::pose`] (q alone) -> [`Warp::new`] (its existence proves that nothing of the
//! client's can fail any more) -> [`Warp::write`] (strips of PNG, rendered and encoded in parallel, handed over in order).

use std::ops::ControlFlow;
use std::sync::Arc;

use thiserror::Error;

use crate::codec::{CodecError, Compression};
use crate::deform::{DeformError, Handle, Method, Pose, Warning};
use crate::geometry::Point;
use crate::pixmap::Extent;
use crate::render::{Filter, Outside};

pub use crate::codec::Limits as ImageLimits;

/// A SHA-256 digest.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Hash, PartialOrd, Ord)]
pub struct Digest(pub [u8; 32]);

/// What warping may ask for; each is a flag of the service.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Limits {
    /// Of a source and a target picture.
    pub image: ImageLimits,
    /// Columns of a plan: 1 a point, 2 a segment.
    pub columns: usize,
    /// Bytes of a plan's table or a mesh; a plan over it is evaluated without a table, a mesh over it is refused.
    pub plan_bytes: u64,
}

/// The unit of p and q.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Hash)]
pub enum Units {
    /// Pixels of the source.
    #[default]
    Px,
    /// x/W and y/H.
    Normalized,
}

/// The grid that a client asks for.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub enum GridSpec {
    /// Cells of `clamp(min(W, H) / 100, 4, 8)` px.
    #[default]
    Auto,
    /// Cells of so many px.
    Cell(f64),
    /// So many vertices.
    Counts {
        /// Vertices in a row.
        columns: u32,
        /// Vertices in a column.
        rows: u32,
    },
    /// A vertex at every pixel corner.
    Pixel,
}

/// What to do when the posed grid folds.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Hash)]
pub enum Folds {
    /// Draw it and count the cells.
    #[default]
    Report,
    /// Refuse.
    Reject,
}

/// Everything that stays while q moves, as a client says it: nothing is resolved or checked yet.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct RestSpec {
    /// Handles at rest.
    pub p: Vec<Handle>,
    /// One a handle.
    pub weights: Option<Vec<f64>>,
    /// The class of maps.
    pub method: Method,
    /// Fall-off; default 1 for points alone, 2 with any line.
    pub alpha: Option<f64>,
    /// Mass of a point in a mixed set, px; default the mean length of the segments.
    pub point_mass: Option<f64>,
    /// Unit of p and q.
    pub units: Units,
    /// The grid.
    pub grid: GridSpec,
}

/// How the picture is made.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Hash)]
pub struct OutputSpec {
    /// PNG compression.
    pub compression: Compression,
    /// Width of the target, px; default the source's. Height = max(1, round(H w / W)).
    pub width: Option<u32>,
    /// How the source is read.
    pub filter: Filter,
    /// What is painted where the posed picture does not reach.
    pub outside: Outside,
}

/// Why a picture was not warped.
#[derive(Clone, Debug, PartialEq, Error)]
pub enum WarpError {
    /// The file.
    #[error(transparent)]
    Codec(#[from] CodecError),
    /// The rest handles p, or a parameter.
    #[error("{0}")]
    Rest(DeformError),
    /// The posed handles q.
    #[error("{0}")]
    Posed(DeformError),
    /// Over a limit.
    #[error("{what}: {actual}; at most {limit}")]
    TooLarge {
        /// Which limit: `handle_columns`, `grid_vertices`, `output_side`, `output_pixels`.
        what: &'static str,
        /// The limit.
        limit: u64,
        /// What was asked for.
        actual: u64,
    },
    /// A grid that is not one.
    #[error("{0}")]
    BadGrid(String),
    /// `folds: reject` and the posed grid folds.
    #[error("the warp folds in {cells} cells of the grid")]
    Folded {
        /// Folded cells.
        cells: u64,
    },
}

/// A decoded picture, shared by everyone who uploads the same bytes.
#[derive(Debug)]
pub struct Image {
    digest: Digest,
}

impl Image {
    /// Digest of the file's bytes: the key under which the picture is cached.
    #[must_use]
    pub fn digest_of(_file: &[u8]) -> Digest {
        todo!()
    }

    /// Decodes a file behind limits. CPU work; call it off the async threads.
    ///
    /// # Errors
    /// See [`CodecError`].
    pub fn decode(_file: &[u8], _limits: &ImageLimits) -> Result<Self, WarpError> {
        todo!()
    }

    /// The digest of the file.
    #[must_use]
    pub const fn digest(&self) -> Digest {
        self.digest
    }

    /// Upright size.
    #[must_use]
    pub fn extent(&self) -> Extent {
        todo!()
    }

    /// The most memory that the picture may come to hold, all sampling copies included: the weight in a cache.
    #[must_use]
    pub fn bytes(&self) -> u64 {
        todo!()
    }
}

/// Rest handles resolved against a picture's size: pixels, effective alpha and point mass, a counted grid.
#[derive(Debug, Clone)]
pub struct Setup {}

impl Setup {
    /// Resolves and checks. Cheap beside a plan: O(handles log handles).
    ///
    /// # Errors
    /// Handles, parameters, grid or their size.
    pub fn new(_rest: &RestSpec, _extent: Extent, _limits: &Limits) -> Result<Self, WarpError> {
        todo!()
    }

    /// Digest of everything that the coefficients depend on: rest handles and weights in px, effective alpha and point mass, method,
    /// resolved grid. Two pictures of one size share one plan.
    #[must_use]
    pub fn plan_key(&self) -> Digest {
        todo!()
    }

    /// Bytes of the table, to be reserved before [`Setup::plan`] fills it; `None` when it goes without a table.
    #[must_use]
    pub fn plan_bytes(&self) -> Option<u64> {
        todo!()
    }

    /// Fills the table of A_j in parallel on the current rayon pool. CPU work.
    #[must_use]
    pub fn plan(&self) -> Plan {
        todo!()
    }

    /// Checks posed handles against the rest handles; only q enters.
    ///
    /// # Errors
    /// Shapes, numbers, contradictory targets.
    pub fn pose(&self, _q: &[Handle]) -> Result<Pose, WarpError> {
        todo!()
    }

    /// Effective alpha.
    #[must_use]
    pub fn alpha(&self) -> f64 {
        todo!()
    }

    /// Effective point mass, px; `None` unless points and lines are mixed.
    #[must_use]
    pub fn point_mass(&self) -> Option<f64> {
        todo!()
    }

    /// Vertices of the resolved grid in a row and in a column.
    #[must_use]
    pub fn grid(&self) -> (u32, u32) {
        todo!()
    }

    /// Maps places by f exactly (not by the grid). Places and answers are in the spec's units.
    pub fn map(&self, _pose: &Pose, _places: &[Point]) -> Vec<Point> {
        todo!()
    }
}

/// The A_j of every grid vertex (or the wish to go without a table).
#[derive(Debug)]
pub struct Plan {}

impl Plan {
    /// Memory held, bytes: the weight in a cache.
    #[must_use]
    pub fn bytes(&self) -> u64 {
        todo!()
    }
}

/// What a client is told about a warp before its first pixel.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Report {
    /// In the order of [`Warning`].
    pub warnings: Vec<Warning>,
    /// Drawn cells that fold.
    pub folds: u64,
    /// Largest distance between a posed handle and where the drawn picture puts it, px of the source.
    pub residual: f64,
    /// Digest of image, resolved request and build: the ETag.
    pub etag: Digest,
    /// Size of the target.
    pub target: (u32, u32),
}

/// A prepared warp: from here on only writing can fail.
#[derive(Debug)]
pub struct Warp {}

impl Warp {
    /// Poses the mesh and prepares the renderer. CPU work (microseconds to a millisecond).
    ///
    /// # Errors
    /// `folds: reject` and it folds; a target over the limits.
    pub fn new(
        _image: &Arc<Image>,
        _setup: &Setup,
        _plan: &Plan,
        _pose: &Pose,
        _folds: Folds,
        _output: &OutputSpec,
        _limits: &Limits,
    ) -> Result<Self, WarpError> {
        todo!()
    }

    /// What to tell before the first pixel.
    #[must_use]
    pub fn report(&self) -> &Report {
        todo!()
    }

    /// No more than this many bytes will be written: what to reserve for the answer.
    #[must_use]
    pub fn max_bytes(&self) -> u64 {
        todo!()
    }

    /// Renders and encodes strip by strip, in parallel on the current rayon pool, and hands the bytes to `sink` in order.
    /// `sink` says `Break` when nobody listens any more: the work ends at the next strip. `Break` comes back.
    pub fn write(&self, _sink: &mut dyn FnMut(Vec<u8>) -> ControlFlow<()>) -> ControlFlow<()> {
        todo!()
    }
}
