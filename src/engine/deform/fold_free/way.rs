//! How far one factor goes: as far as every corner of the control lattice stays open.

use super::lattice::ControlLattice;
use super::path::{HandlePlaces, between, handles_like};
use super::{CANCELLED, FoldFreeError, ProductWork, mapped};
use crate::deform::lanes::ON_PLANE;
use crate::deform::{CoefficientForm, CoefficientTable, Handle, IsCancelled, RestDeformation};
use crate::geometry::{Point, Vec2};

/// Bisections for the share of the way of a rotation, whose displacements are not linear in it.
const BISECTIONS: u32 = 9;
/// Coefficients of a table that an operation poses.
const COEFFICIENTS_PER_OPERATION: u64 = 16;
/// A larger table is not made.
const MOST_TABLE_BYTES: u64 = 32 << 20;

/// Bytes of the table that a rotation poses for each share of its way, for this many positions; 0
/// where no table is made.
pub(super) fn table_bytes(field: &RestDeformation, positions: u64) -> u64 {
    let positions = usize::try_from(positions).unwrap_or(usize::MAX);
    let bytes = CoefficientTable::bytes_for(field, positions);
    let is_useful = field.form() == CoefficientForm::Rigid
        && CoefficientTable::is_worthwhile(field)
        && bytes <= MOST_TABLE_BYTES;
    if is_useful { bytes } else { 0 }
}

/// The way of one factor.
pub(super) struct Way<'a> {
    pub(super) field: &'a RestDeformation,
    pub(super) form: &'a [Handle],
    pub(super) now: &'a HandlePlaces,
    pub(super) target: &'a HandlePlaces,
}

impl Way<'_> {
    /// The largest share of the way, up to 1, on which every corner of the control lattice stays
    /// open.
    pub(super) fn longest(
        &self,
        is_linear: bool,
        lattice: &ControlLattice,
        work: &mut ProductWork,
        cancelled: IsCancelled<'_>,
    ) -> Result<f64, FoldFreeError> {
        let pose_of = |share: f64| {
            let posed = handles_like(self.form, &between(self.now, self.target, share));
            self.field.pose(&posed)
        };
        let (places, of_all) = (
            lattice.places(),
            work.of_position.saturating_mul(lattice.len()),
        );
        let table = if is_linear || table_bytes(self.field, lattice.len()) == 0 {
            None
        } else {
            work.take(of_all)?;
            let vertices: Vec<_> = places.iter().map(|v| (*v, ON_PLANE)).collect();
            Some(CoefficientTable::of_cut(self.field, &vertices, cancelled).ok_or(CANCELLED)?)
        };
        let of_table = 1 + self.field.terms() as u64 / COEFFICIENTS_PER_OPERATION;
        let mut mapped = |share: f64| -> Result<Vec<Point>, FoldFreeError> {
            let pose = pose_of(share)?;
            let Some(table) = &table else {
                work.take(of_all)?;
                let mapped = mapped((self.field, &pose), places, false, cancelled);
                return Ok(mapped.ok_or(CANCELLED)?);
            };
            work.take(lattice.len().saturating_mul(of_table))?;
            let (moved, _) = table.displace(&pose, cancelled).ok_or(CANCELLED)?;
            let moved = places.iter().zip(moved);
            Ok(moved
                .map(|(v, [x, y])| *v + Vec2::new(x.into(), y.into()))
                .collect())
        };
        let whole = mapped(1.0)?;
        if lattice.is_open(&whole) {
            return Ok(1.0);
        }
        if is_linear {
            let pairs = whole.iter().zip(lattice.places());
            let displacements: Vec<Vec2> = pairs.map(|(mapped, v)| *mapped - *v).collect();
            return Ok(lattice.longest(&displacements));
        }
        let (mut low, mut high) = (0.0, 1.0);
        for _ in 0..BISECTIONS {
            let middle = 0.5 * (low + high);
            if lattice.is_open(&mapped(middle)?) {
                low = middle;
            } else {
                high = middle;
            }
        }
        Ok(low)
    }
}
