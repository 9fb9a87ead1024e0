//! Positions and outlines mapped by f or by its inverse: exactly, not by the grid. Positions at
//! rest are those of the source, posed ones those of the picture that is drawn
//! ([`Transform::onto`]). Outlines get more vertices where the map bends them (`outlines.rs`).

mod outlines;
#[cfg(test)]
mod tests;

use std::sync::atomic::{AtomicUsize, Ordering};

use crate::parallel::prelude::*;

use super::unfolded::Unfolded;
use super::{CoordinateFrame, PosedMesh, ResolvedRest, Task, Units, WarpError, work};
use crate::deform::{Inverse, IsCancelled, MAX_COORDINATE, Pose, PosedMap};
use crate::geometry::Mesh;
use crate::geometry::Point;
pub use outlines::{Edges, MAX_EDGE_SAMPLES, MappedOutline, Outline, samples_of};

/// Positions at which the search of an inverse computes f at once.
const LANES: usize = 16;
/// Positions that one task maps.
const PLACES_PER_TASK: usize = 64;

/// f of a pose, or its inverse, between positions in the client's units. Where it is the inverse,
/// positions at which nothing of the picture is posed have none.
#[derive(Debug)]
pub struct Transform<'a> {
    map: PositionMap<'a>,
    /// Those of the source and of the picture.
    rest: CoordinateFrame,
    posed: CoordinateFrame,
    /// Positions at which edges were examined, in this part of the task and those before.
    samples: AtomicUsize,
    /// Operations of f at a position, and the most of all.
    per_position: u64,
    max_work: u64,
    /// Operations of the search of an inverse for other positions of the same task.
    before: u64,
}

/// What the parts of a task have taken of its limits so far: handed from part to part, so that a
/// long answer does not have each limit once for each part.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Taken {
    /// Operations of the search of an inverse.
    operations: u64,
    /// Positions at which edges were examined.
    samples: usize,
}

#[derive(Debug)]
enum PositionMap<'a> {
    Forward(PosedMap<'a>),
    Inverse(Inverse<'a>),
    /// What a mesh draws, and beside it what that follows from.
    Drawn(&'a Mesh, &'a Unfolded),
}

impl ResolvedRest {
    /// f of a pose.
    #[must_use]
    pub fn transform<'a>(&'a self, pose: &'a Pose) -> Transform<'a> {
        Transform::new(PositionMap::Forward(self.field().deformation(pose)), self)
    }

    /// The map of a pose that was drawn: f, or what the mesh draws if folds were removed.
    #[must_use]
    pub fn transform_of<'a>(&'a self, pose: &'a Pose, posed: &'a PosedMesh) -> Transform<'a> {
        if let Some(unfolded) = posed.unfolded() {
            let drawn = Transform::new(PositionMap::Drawn(posed.mesh(), unfolded), self);
            let per_position = drawn.per_position.saturating_mul(unfolded.factors());
            return Transform {
                per_position,
                ..drawn
            };
        }
        let _ = posed;
        self.transform(pose)
    }

    /// The inverse of f. `posed`: of the same pose and of [`ResolvedRest::to_invert`]; its mesh
    /// decides where several rest positions have the same posed one. If folds were removed, what is
    /// drawn.
    #[must_use]
    pub fn inverse<'a>(&'a self, pose: &'a Pose, posed: &'a PosedMesh) -> Transform<'a> {
        let mesh = posed.mesh();
        let inverse = if posed.is_unfolded() {
            Inverse::of_mesh(mesh)
        } else {
            Inverse::new(self.field(), pose, mesh)
        };
        let inverse = inverse.seeking_in(posed.tree().cloned());
        Transform::new(PositionMap::Inverse(inverse), self)
    }
}

impl<'a> Transform<'a> {
    fn new(map: PositionMap<'a>, setup: &ResolvedRest) -> Self {
        // A path inside a mask is sought for each position.
        let per_position = match &setup.cut {
            Some(_) => work::of_vertex(setup.field()),
            None => work::of_position(setup.field()),
        };
        let max_work = setup.max_work();
        let source = setup.source_frame();
        Self {
            map,
            rest: source,
            posed: source,
            samples: AtomicUsize::new(0),
            per_position,
            max_work,
            before: 0,
        }
    }

    /// Checks the work of this number of positions, for those that are mapped part by part.
    ///
    /// # Errors
    /// More positions than may be mapped.
    pub fn check_positions(&self, positions: usize) -> Result<(), WarpError> {
        self.check_work(Task::Positions, positions)
    }

    /// Errors: More positions than may be mapped.
    fn check_work(&self, task: Task, positions: usize) -> Result<(), WarpError> {
        let times = if matches!(self.map, PositionMap::Inverse(_)) {
            work::EVALUATIONS_PER_INVERSE
        } else {
            1
        };
        work::at_most(
            task,
            self.max_work,
            (positions as u64)
                .saturating_mul(self.per_position)
                .saturating_mul(times),
        )
    }

    /// The same map, where posed positions are those of a picture; without this, they are those of
    /// the plane.
    #[must_use]
    pub fn onto(self, picture: CoordinateFrame) -> Self {
        Self {
            posed: picture,
            ..self
        }
    }

    /// The same map between positions in px of the plane.
    pub(super) fn in_px(self) -> Self {
        let plane = CoordinateFrame::of_source(self.rest.image(), Units::Px);
        Self {
            rest: plane,
            posed: plane,
            ..self
        }
    }

    /// The same map, for a task of which other parts have taken this ([`Transform::taken`]).
    #[must_use]
    pub fn after(self, before: Taken) -> Self {
        Self {
            before: before.operations,
            samples: AtomicUsize::new(before.samples),
            ..self
        }
    }

    /// What the task has taken: positions at which edges were examined, and operations of the
    /// search of an inverse.
    #[must_use]
    pub fn taken(&self) -> Taken {
        Taken {
            operations: self.operations(),
            samples: self.samples.load(Ordering::Relaxed),
        }
    }

    /// Operations that the search of an inverse has taken, which beside folds may be a hundred
    /// times as many as elsewhere.
    fn operations(&self) -> u64 {
        let PositionMap::Inverse(inverse) = &self.map else {
            return self.before;
        };
        let of_steps = inverse.steps().saturating_mul(LANES as u64);
        of_steps
            .saturating_mul(self.per_position)
            .saturating_add(inverse.boxes().saturating_mul(work::BOX_OPERATIONS))
            .saturating_add(self.before)
    }

    const fn frames(&self) -> (&CoordinateFrame, &CoordinateFrame) {
        match self.map {
            PositionMap::Forward(_) => (&self.rest, &self.posed),
            PositionMap::Drawn(..) => (&self.rest, &self.posed),
            PositionMap::Inverse(_) => (&self.posed, &self.rest),
        }
    }

    /// Maps positions. CPU work, in parallel on the current rayon pool for many positions; stops
    /// when `cancelled` returns true.
    ///
    /// # Errors
    /// A coordinate that is not finite or out of range; cancelled.
    pub fn map(
        &self,
        places: &[Point],
        cancelled: IsCancelled<'_>,
    ) -> Result<Vec<Option<Point>>, WarpError> {
        self.check_work(Task::Positions, places.len())?;
        let mut mapped = self.map_px(&self.to_px(places, 0)?, cancelled)?;
        let (_, to) = self.frames();
        mapped
            .iter_mut()
            .flatten()
            .for_each(|place| *place = to.from_plane(*place));
        Ok(mapped)
    }

    fn map_block(
        &self,
        places: &[Point],
        cancelled: IsCancelled<'_>,
    ) -> Result<Vec<Option<Point>>, WarpError> {
        let mapped = match &self.map {
            PositionMap::Forward(f) => f
                .map_all(places, cancelled)
                .map(|mapped| mapped.into_iter().map(Some).collect()),
            PositionMap::Inverse(inverse) => {
                work::at_most(Task::Positions, self.max_work, self.operations())?;
                inverse.map(places, cancelled)
            }
            PositionMap::Drawn(mesh, unfolded) => map_drawn(mesh, unfolded, places, cancelled),
        };
        mapped.ok_or(WarpError::Cancelled)
    }

    fn map_px(
        &self,
        places: &[Point],
        cancelled: IsCancelled<'_>,
    ) -> Result<Vec<Option<Point>>, WarpError> {
        let task = |places: &[Point]| self.map_block(places, cancelled);
        let tasks: Result<Vec<_>, WarpError> =
            places.par_chunks(PLACES_PER_TASK).map(task).collect();
        Ok(tasks?.into_iter().flatten().collect())
    }

    /// `before`: positions before these ones.
    fn to_px(&self, places: &[Point], before: usize) -> Result<Vec<Point>, WarpError> {
        let (from, _) = self.frames();
        let to_px = |(index, place): (usize, &Point)| {
            let px = from.to_plane(*place);
            match [px.x, px.y]
                .into_iter()
                .find(|c| !c.is_finite() || c.abs() > MAX_COORDINATE)
            {
                Some(value) => Err(WarpError::BadPlace {
                    index: before + index,
                    value,
                    limit: MAX_COORDINATE,
                }),
                None => Ok(px),
            }
        };
        places.iter().enumerate().map(to_px).collect()
    }
}

/// `None` when cancelled.
fn map_drawn(
    mesh: &Mesh,
    unfolded: &Unfolded,
    places: &[Point],
    cancelled: IsCancelled<'_>,
) -> Option<Vec<Option<Point>>> {
    let mut mapped: Vec<Option<Point>> = places.iter().map(|v| mesh.map(*v)).collect();
    let of_outside = places
        .iter()
        .zip(&mapped)
        .filter(|(_, mapped)| mapped.is_none());
    let outside: Vec<Point> = of_outside.map(|(place, _)| *place).collect();
    if !outside.is_empty() {
        let beyond = unfolded.map_outside(&outside, cancelled)?;
        let missing = mapped.iter_mut().filter(|mapped| mapped.is_none());
        missing
            .zip(beyond)
            .for_each(|(mapped, beyond)| *mapped = Some(beyond));
    }
    Some(mapped)
}
