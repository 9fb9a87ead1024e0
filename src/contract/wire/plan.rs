//! The answer of `GET /sessions/{id}/plan`: a header, the handle behind each column, and the
//! coefficients, all little-endian. `/docs` has the layout and the code that poses it.

use half::f16;
use mlswarp::deform::CoefficientTable;
use mlswarp::pixmap::Extent;
use mlswarp::warp::{CoefficientCount, CoefficientRequest, WarpError};

/// The first bytes of the file: its form and version.
const MAGIC: &[u8; 8] = b"MLSPLAN1";
/// Bytes of the header and of a member.
const HEADER_BYTES: u64 = 64;
const MEMBER_BYTES: u64 = 16;
/// Bytes of the rest revision.
pub(crate) const REVISION_BYTES: usize = 16;

/// The numbers of the coefficients.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum Precision {
    /// 32 bit.
    #[default]
    F32,
    /// 16 bit.
    F16,
}

impl Precision {
    /// Each with its name.
    pub const ALL: [(&'static str, Self); 2] = [("f32", Self::F32), ("f16", Self::F16)];

    const fn bytes(self) -> u32 {
        match self {
            Self::F32 => 4,
            Self::F16 => 2,
        }
    }

    /// Appends a number; false if it is too large.
    fn put(self, out: &mut Vec<u8>, number: f32) -> bool {
        match self {
            Self::F32 => out.extend(number.to_le_bytes()),
            Self::F16 => {
                let rounded = f16::from_f32(number);
                out.extend(rounded.to_le_bytes());
                return rounded.is_finite();
            }
        }
        true
    }
}

/// What a client may request.
#[derive(Clone, Copy, Debug)]
pub struct PlanQuery {
    /// Vertices in a row.
    pub columns: u32,
    /// Vertices in a column.
    pub rows: u32,
    /// Of the coefficients.
    pub precision: Precision,
}

/// The rest revision of a session, as its object has it.
pub fn rest_revision(digest: mlswarp::warp::Digest) -> [u8; REVISION_BYTES] {
    *digest.0.first_chunk().expect("a digest has 32 bytes")
}

/// Length of the file.
pub fn plan_file_bytes(count: CoefficientCount, precision: Precision) -> u64 {
    HEADER_BYTES
        + MEMBER_BYTES * count.members
        + u64::from(precision.bytes()) * count.vertices * count.planes
}

/// The file; `None` if a coefficient is too large for the precision.
///
/// Errors: Cancelled.
#[expect(
    clippy::cast_possible_truncation,
    reason = "counts of columns and handles are far below 2^32; a share is a f32"
)]
pub fn plan_file(
    table: &CoefficientRequest,
    plan: &CoefficientTable,
    precision: Precision,
    extent: Extent,
    cancelled: &dyn Fn() -> bool,
) -> Result<Option<Vec<u8>>, WarpError> {
    let (grid, members) = (table.grid(), table.members());
    let counts = [
        table.columns() as u32,
        members.len() as u32,
        extent.width(),
        extent.height(),
    ];
    let mut out = Vec::with_capacity(plan_file_bytes(table.count(), precision) as usize);
    out.extend(MAGIC);
    for number in [
        table.layout(),
        precision.bytes(),
        grid.columns(),
        grid.rows(),
    ]
    .iter()
    .chain(&counts)
    {
        out.extend(number.to_le_bytes());
    }
    out.extend(rest_revision(table.rest_digest()));
    out.resize(HEADER_BYTES as usize, 0);
    for member in members {
        for index in [member.column, member.handle, member.place] {
            out.extend((index as u32).to_le_bytes());
        }
        out.extend((member.share as f32).to_le_bytes());
    }
    for plane in plan.planes() {
        if cancelled() {
            return Err(WarpError::Cancelled);
        }
        for number in plane {
            if !precision.put(&mut out, number) {
                return Ok(None);
            }
        }
    }
    Ok(Some(out))
}
