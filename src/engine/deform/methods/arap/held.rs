//! What handles hold of a mesh: points, and lines at every cell.

use super::mesh::LatticeMesh;
use crate::deform::groups::coincidence_distance;
use crate::deform::point_map::MeshInput;
use crate::deform::{DeformError, MeshQuantity};
use crate::geometry::Point;
use crate::topology::HANDLE_TO_MASK_PX;

/// Positions that are held: their system takes the cube of them.
pub(super) const MAX_HELD: u64 = 2000;

/// A position that handles hold.
#[derive(Clone, Debug)]
pub(super) struct Held {
    pub(super) at: Point,
    pub(super) quad: usize,
    /// Columns, their shares, and what they weigh where handles meet.
    pub(super) columns: Vec<(usize, f64)>,
    weight: f64,
}

/// What handles hold: points, and samples of segments at most a cell apart. Those at one position
/// are one, by the mean of their displacements. Ordered by part and position.
pub(super) fn held_positions(
    input: &MeshInput<'_>,
    mesh: &LatticeMesh,
    side: f64,
) -> Result<Vec<Held>, DeformError> {
    let sources = &input.set.sources;
    let samples = |length: f64| (length / side).ceil().max(1.0);
    let of_segments: f64 = sources
        .segments
        .iter()
        .map(|s| samples(s.length) + 1.0)
        .sum();
    let count = sources.points.len() as f64 + of_segments;
    if count > MAX_HELD as f64 {
        return Err(DeformError::MeshTooLarge {
            what: MeshQuantity::Positions,
            limit: MAX_HELD,
            #[expect(
                clippy::cast_possible_truncation,
                clippy::cast_sign_loss,
                reason = "float to integer saturates"
            )]
            actual: count as u64,
        });
    }
    let mut all = Vec::new();
    let mut hold = |at: Point, columns: Vec<(usize, f64)>, weight: f64| {
        let handle = (input.handle_of)(columns[0].0);
        let quad = mesh.quad_of(at, HANDLE_TO_MASK_PX);
        let quad = quad.ok_or(DeformError::OutsideMask { handle })?;
        all.push(Held {
            at,
            quad,
            columns,
            weight,
        });
        Ok(())
    };
    for point in &sources.points {
        hold(point.p, vec![(point.column, 1.0)], point.mass)?;
    }
    for segment in &sources.segments {
        let count = samples(segment.length);
        let mut k = 0.0;
        while k <= count {
            let t = k / count;
            let columns = vec![(segment.column, 1.0 - t), (segment.column + 1, t)];
            hold(segment.a.lerp(segment.b, t), columns, segment.weight)?;
            k += 1.0;
        }
    }
    let part = |held: &Held| mesh.lattice().quads()[held.quad].part;
    all.sort_by(|a, b| {
        let order = part(a).cmp(&part(b)).then(a.at.x.total_cmp(&b.at.x));
        order.then(a.at.y.total_cmp(&b.at.y))
    });
    // Where polylines meet, both hold the corner. Held twice, its forces could not be told apart,
    // and the system of the anchors would be singular.
    let within = coincidence_distance(input.set.extent);
    let mut merged: Vec<Held> = Vec::with_capacity(all.len());
    for held in all {
        let near =
            |other: &&mut Held| held.at.x - other.at.x <= within && part(other) == part(&held);
        let mut before = merged.iter_mut().rev().take_while(near);
        match before.find(|other| other.at.distance(held.at) <= within) {
            Some(other) => other.join(held),
            None => merged.push(held),
        }
    }
    Ok(merged)
}

impl Held {
    /// Both, by the mean of their displacements.
    fn join(&mut self, other: Self) {
        let total = self.weight + other.weight;
        let (own, of_other) = (self.weight / total, other.weight / total);
        self.columns.iter_mut().for_each(|(_, share)| *share *= own);
        let others = other.columns.into_iter();
        self.columns
            .extend(others.map(|(column, share)| (column, share * of_other)));
        self.weight = total;
    }
}
