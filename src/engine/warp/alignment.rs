//! Alignment: q is brought from its own frame to that of p by the best map of a class, before
//! anything else (mathematics 8.1). So two shapes of different size and place can be compared,
//! averaged and exaggerated.

use super::rest_parameters::to_px;
use super::{Align, RestSpec, Units};
use crate::deform::{Class, Fitted, Handle, MAX_COORDINATE, PlaneMap, fitted};
use crate::geometry::Point;
use crate::pixmap::Extent;

/// An aligned position this near to its rest position, as a share of the extent of p, is at rest:
/// what is left is rounding.
const AT_REST: f64 = 1e-9;

impl Align {
    pub(super) const fn class(self) -> Option<Class> {
        match self {
            Self::None => None,
            Self::Rigid => Some(Class::Rigid),
            Self::Similarity => Some(Class::Similarity),
            Self::Affine => Some(Class::Affine),
        }
    }
}

/// The map by which q was aligned.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Alignment {
    /// Its class: a smaller one than requested if the handles do not determine that.
    pub class: Class,
    /// From the frame of q to that of p, px.
    pub map: PlaneMap,
}

impl RestSpec {
    /// The strengths that can be requested.
    pub const STRENGTHS: std::ops::RangeInclusive<f64> = -10.0..=10.0;

    /// The handles that a request with `q` means: q in the frame of p, and then
    /// `p + strength (q - p)`, which at 1 is exactly q. Handles of another shape than those of `p`,
    /// or out of range, stay as they are: posing them is refused.
    #[must_use]
    pub fn posed(
        &self,
        q: Vec<Handle>,
        strength: f64,
        extent: Extent,
    ) -> (Vec<Handle>, Option<Alignment>) {
        let fitted = self.fit_of(&q, extent);
        let q = match &fitted {
            Some(fitted) => self.aligned(&q, fitted, extent),
            None => q,
        };
        (
            self.at_strength(strength, q),
            fitted.map(|Fitted { class, map, .. }| Alignment { class, map }),
        )
    }

    fn fit_of(&self, q: &[Handle], extent: Extent) -> Option<Fitted> {
        let class = self.align.class()?;
        let is_alike = |(p, q): (&Handle, &Handle)| match (p, q) {
            (Handle::Point(_), Handle::Point(_)) => true,
            (Handle::Polyline(p), Handle::Polyline(q)) => p.len() == q.len(),
            // It is left out, whatever q has for it.
            (Handle::Missing, _) => true,
            _ => false,
        };
        let unit = self.unit(extent);
        let in_range = |p: &Point| {
            (p.x * unit.0).abs() <= MAX_COORDINATE && (p.y * unit.1).abs() <= MAX_COORDINATE
        };
        let is_valid = q.len() == self.p.len()
            && self.p.iter().zip(q).all(is_alike)
            && self
                .p
                .iter()
                .chain(q)
                .flat_map(Handle::places)
                .all(in_range);
        if !is_valid {
            return None;
        }
        fitted(
            class,
            &to_px(q, unit),
            &to_px(&self.p, unit),
            self.weights.as_deref(),
        )
    }

    fn aligned(
        &self,
        q: &[Handle],
        Fitted {
            map, extent: size, ..
        }: &Fitted,
        extent: Extent,
    ) -> Vec<Handle> {
        let unit = self.unit(extent);
        let moved = |p: &Point, q: &Point| {
            let moved = map.map(Point::new(q.x * unit.0, q.y * unit.1));
            let is_at_rest =
                moved.distance(Point::new(p.x * unit.0, p.y * unit.1)) <= AT_REST * size;
            if is_at_rest {
                *p
            } else {
                Point::new(moved.x / unit.0, moved.y / unit.1)
            }
        };
        let handle = |(p, q): (&Handle, &Handle)| match (p, q) {
            (Handle::Missing, _) => Handle::Missing,
            (Handle::Point(p), Handle::Point(q)) => Handle::Point(moved(p, q)),
            (p, q) => Handle::Polyline(
                p.places()
                    .iter()
                    .zip(q.places())
                    .map(|(p, q)| moved(p, q))
                    .collect(),
            ),
        };
        self.p.iter().zip(q).map(handle).collect()
    }

    /// The handles at rest, px of an image of this size.
    #[must_use]
    pub fn p_in_px(&self, extent: Extent) -> Vec<Handle> {
        to_px(&self.p, self.unit(extent))
    }

    /// px in one unit of p and q, per axis.
    pub(super) fn unit(&self, extent: Extent) -> (f64, f64) {
        match self.units {
            Units::Px => (1.0, 1.0),
            Units::Normalized => (f64::from(extent.width()), f64::from(extent.height())),
        }
    }

    fn at_strength(&self, strength: f64, q: Vec<Handle>) -> Vec<Handle> {
        // Handles that are where they rest stay there exactly.
        let at = |p: &Point, q: Point| *p + (q - *p) * strength;
        let handle = |(k, q): (usize, Handle)| match (self.p.get(k), q) {
            (Some(Handle::Point(p)), Handle::Point(q)) => Handle::Point(at(p, q)),
            (Some(Handle::Polyline(p)), Handle::Polyline(q)) if p.len() == q.len() => {
                Handle::Polyline(p.iter().zip(q).map(|(p, q)| at(p, q)).collect())
            }
            (_, q) => q,
        };
        // The sum of a position and a difference is rounded.
        if strength.to_bits() == 1.0_f64.to_bits() {
            q
        } else {
            q.into_iter().enumerate().map(handle).collect()
        }
    }
}
