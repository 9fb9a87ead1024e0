//! How far one factor goes: as far as every corner of the control lattice stays open.

use super::lattice::ControlLattice;
use super::path::{HandlePlaces, handles_like};
use super::{CANCELLED, FoldFreeError, ProductWork};
use crate::deform::moving_map::{Motions, MovingMap};
use crate::deform::{CoefficientForm, Handle, IsCancelled, RestDeformation};

/// Bisections for the share of the way of a rotation, whose displacements are not linear in it.
const BISECTIONS: u32 = 9;

/// The way of one factor.
pub(super) struct Way<'a> {
    pub(super) field: &'a RestDeformation,
    pub(super) form: &'a [Handle],
    pub(super) target: &'a HandlePlaces,
}

impl Way<'_> {
    /// The largest share of the way, up to 1, on which every corner of the control lattice stays
    /// open.
    pub(super) fn longest(
        &self,
        lattice: &ControlLattice,
        work: &mut ProductWork,
        cancelled: IsCancelled<'_>,
    ) -> Result<f64, FoldFreeError> {
        let (places, form) = (lattice.places(), self.field.form());
        let pose = self.field.pose(&handles_like(self.form, self.target))?;
        work.take(work.of_position.saturating_mul(lattice.len()))?;
        let way = MovingMap::new(self.field, &pose);
        if form != CoefficientForm::Rigid {
            work.take(lattice.len())?;
            let mut mapped = places.to_vec();
            way.map_all(&mut mapped, cancelled).ok_or(CANCELLED)?;
            return Ok(lattice.longest(&mapped));
        }
        let motions = &way.motions(places, cancelled).ok_or(CANCELLED)?;
        let motions = Motions {
            form,
            places,
            motions,
        };
        let (mut above, mut below) = (Vec::new(), Vec::new());
        let mut closed_rows = |share: f64, among: &[usize]| -> Result<Vec<usize>, FoldFreeError> {
            work.take(lattice.len())?;
            if cancelled() {
                return Err(CANCELLED.into());
            }
            let (mut closed, mut line) = (Vec::new(), 0..0);
            for row in among {
                let [above_line, below_line] = lattice.lines(*row);
                if line == above_line {
                    std::mem::swap(&mut above, &mut below);
                } else {
                    motions.at(share, above_line, &mut above);
                }
                motions.at(share, below_line.clone(), &mut below);
                line = below_line;
                if lattice.is_closed(*row, &above, &below) {
                    closed.push(*row);
                }
            }
            Ok(closed)
        };
        let all: Vec<usize> = (0..lattice.rows()).collect();
        let closed = closed_rows(1.0, &all)?;
        if closed.is_empty() {
            return Ok(1.0);
        }
        let mut search = |mut among: Vec<usize>, forgets: bool| -> Result<f64, FoldFreeError> {
            let (mut low, mut high) = (0.0, 1.0);
            for _ in 0..BISECTIONS {
                let middle = 0.5 * (low + high);
                let still = closed_rows(middle, &among)?;
                if still.is_empty() {
                    low = middle;
                    continue;
                }
                high = middle;
                if forgets {
                    among = still;
                }
            }
            let is_open = !forgets || closed_rows(low, &all)?.is_empty();
            Ok(if is_open { low } else { f64::NAN })
        };
        // Rows that are open at a share nearly always are at smaller ones too. So only those that
        // were closed are looked at again, and all of them where the search ends.
        let share = search(closed, true)?;
        if share.is_nan() {
            search(all.clone(), false)
        } else {
            Ok(share)
        }
    }
}
