//! f without folds (mathematics 9.3): a product of maps of moving least squares. Each goes as far
//! along the way from p to q as it stays one-to-one, and carries the handles along, which are then
//! the handles at rest of the next one.

mod lattice;
mod path;
mod reach;
#[cfg(test)]
mod tests;
mod way;

use std::fmt;
use std::sync::Arc;

use self::lattice::ControlLattice;
use self::path::{HandlePlaces, Path, between, handles_like, places_of};
use self::way::Way;
use super::moving_map::MovingMap;
use super::{
    Class, CoefficientForm, CoefficientTable, DeformError, Handle, IsCancelled, Pose,
    RestDeformation, fitted,
};
use crate::geometry::{Folding, Grid, Mesh, Orientation, Point, Vec2};
use crate::parallel::prelude::*;

/// Factors of a product: ordinary poses need 3 to 7.
const MOST_FACTORS: usize = 24;
/// A factor that goes less far than this share of its way does not arrive, if the next one does not
/// either.
const LEAST_STEP: f64 = 1e-3;
/// Positions that one task maps.
const PLACES_PER_TASK: usize = 512;
/// Operations of comparing two positions of handles.
const PAIR_OPERATIONS: u64 = 2;
/// Memory of a position of the control lattice while a factor is sought, and of a column of the
/// factor, bytes.
const CONTROL_BYTES: u64 = 160;
const COLUMN_BYTES: u64 = 1024;

/// What a product may take, in the unit of the caller.
#[derive(Clone, Copy, Debug)]
pub struct ProductWork {
    /// f at a position.
    pub of_position: u64,
    /// The map of handles at rest.
    pub of_factor: u64,
    /// The most of all.
    pub most: u64,
    /// What has been taken.
    pub taken: u64,
}

impl ProductWork {
    /// Before it is done. Errors: More than the most.
    fn take(&mut self, operations: u64) -> Result<(), FoldFreeError> {
        self.taken = self.taken.saturating_add(operations);
        if self.taken > self.most {
            return Err(FoldFreeError::TooMuchWork(self.taken));
        }
        Ok(())
    }
}

/// Why a pose has no map without folds.
#[derive(Clone, Debug, PartialEq)]
pub enum FoldFreeError {
    /// No map without folds takes these handles to their targets: they would have to pass through
    /// each other, or through themselves. Indices of one or two of them, or of a chain of lines.
    Unreachable(Vec<usize>),
    /// More than [`ProductWork::most`].
    TooMuchWork(u64),
    /// What a deformation of these handles says, or of handles on their way.
    Deform(DeformError),
}

impl fmt::Display for FoldFreeError {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::Unreachable(handles) => {
                write!(
                    f,
                    "no map without folds takes the handles {handles:?} to their targets"
                )
            }
            Self::TooMuchWork(taken) => {
                write!(f, "a map without folds takes {taken} operations or more")
            }
            Self::Deform(error) => error.fmt(f),
        }
    }
}

impl std::error::Error for FoldFreeError {}

impl From<DeformError> for FoldFreeError {
    fn from(error: DeformError) -> Self {
        Self::Deform(error)
    }
}

/// f of a pose that folds, without folds wherever it can be. It keeps where the handles are between
/// the factors, not the factors, which take more memory: [`FoldFree::factors`] makes them.
#[derive(Clone, Debug)]
pub struct FoldFree {
    rest: Arc<RestDeformation>,
    /// The positions of the handles, from those at rest.
    steps: Vec<HandlePlaces>,
    /// The best motion of all handles, which comes last: two rows.
    motion: Option<[[f64; 3]; 2]>,
    is_reached: bool,
    folded: u64,
}

/// A map whose handles at rest are those that the one before has posed.
pub type ProductFactor = (RestDeformation, Pose);

impl FoldFree {
    /// The map of a pose; `None` if the plain f has no folds. `rest`: of a method that meets its
    /// handles. `plain`: the posed mesh of the plain f, of the grid on which this is drawn.
    /// O(factors x (control lattice + handles^2)).
    ///
    /// # Errors
    /// Handles that no map without folds takes to their targets; those of handles on their way; too
    /// much work; cancelled, as an error of those.
    ///
    /// ```
    /// use std::sync::Arc;
    /// use mlswarp::deform::{
    ///     Falloff, FoldFree, FoldFreeError, Handle, Handles, Method, ProductWork, RestDeformation,
    /// };
    /// use mlswarp::geometry::{Grid, Point};
    /// let point = |(x, y)| Handle::Point(Point::new(x, y));
    /// let corners = [(20.0, 20.0), (180.0, 20.0), (20.0, 180.0), (180.0, 180.0)].map(point);
    /// let p = [&corners[..], &[point((50.0, 100.0))]].concat();
    /// let mut q = p.clone();
    /// q[4] = point((150.0, 100.0));
    /// let rest = Handles::new(p, None)?;
    /// let falloff = Falloff::new(1.0, false)?;
    /// let rest = Arc::new(RestDeformation::new(rest, Method::Similarity, falloff, 1.0)?);
    /// let (pose, grid) = (rest.pose(&q)?, Grid::with_cell(200.0, 200.0, 5.0));
    /// let (plain, _) = rest.deformation(&pose).mesh(&grid, &pose, &|| false).unwrap();
    /// let work = ProductWork { of_position: 1, of_factor: 0, most: u64::MAX, taken: 0 };
    /// let f = FoldFree::of(&rest, &pose, &plain, &mut work.clone(), &|| false)?.expect("folds");
    /// let mapped = f.map_all(&[Point::new(50.0, 100.0)], &|| false).unwrap();
    /// assert!(mapped[0].distance(Point::new(150.0, 100.0)) < 1e-9);
    /// # Ok::<(), FoldFreeError>(())
    /// ```
    pub fn of(
        rest: &Arc<RestDeformation>,
        pose: &Pose,
        plain: &Mesh,
        work: &mut ProductWork,
        cancelled: IsCancelled<'_>,
    ) -> Result<Option<Self>, FoldFreeError> {
        if pose.is_identity() {
            return Ok(None);
        }
        let grid = plain.grid();
        let lattice = ControlLattice::new(grid.width(), grid.height());
        let Folding { orientation, cells } = plain.folding(cancelled).ok_or(CANCELLED)?;
        if cells == 0 {
            // The lattice tells nothing of a whole that is turned over.
            if orientation == Orientation::Mirrored {
                return Ok(None);
            }
            work.take(work.of_position.saturating_mul(lattice.len()))?;
            let plain = MovingMap::new(rest, pose);
            let mut mapped = lattice.places().to_vec();
            plain.map_all(&mut mapped, cancelled).ok_or(CANCELLED)?;
            if lattice.is_open(&mapped) {
                return Ok(None);
            }
        }
        let p = rest.handles().handles();
        let targets = targets_of(p, pose);
        work.take(pair_operations(p))?;
        let q = handles_like(p, &targets);
        if let Some(handles) = reach::unreachable(p, &q, cancelled).ok_or(CANCELLED)? {
            let columns = p.iter().scan(0, |next, handle| {
                let first = *next;
                *next += handle.columns();
                Some(first)
            });
            let columns: Vec<usize> = columns.collect();
            let owner = |handle: usize| rest.owner_of(columns[handle]);
            let handles = handles.into_iter().map(owner).collect();
            return Err(FoldFreeError::Unreachable(handles));
        }
        let composed = Self::composed(rest, &q, &lattice, work, cancelled)?;
        Ok(Some(Self {
            folded: cells,
            ..composed
        }))
    }

    /// Operations of [`FoldFree::of`] at least, if the plain f has folds.
    #[must_use]
    pub fn least_work(rest: &RestDeformation, grid: &Grid, work: &ProductWork) -> u64 {
        let lattice = ControlLattice::count(grid.width(), grid.height());
        let positions = lattice.saturating_add(grid.len() as u64);
        let of_positions = positions.saturating_mul(work.of_position);
        of_positions
            .saturating_add(pair_operations(rest.handles().handles()))
            .saturating_add(work.of_factor)
    }

    /// Memory of [`FoldFree::of`] beside the linear system of a factor, bytes.
    #[must_use]
    pub fn peak_bytes(rest: &RestDeformation, grid: &Grid) -> u64 {
        let columns = rest.handles().columns() as u64;
        let lattice = ControlLattice::count(grid.width(), grid.height());
        CONTROL_BYTES * lattice + COLUMN_BYTES * columns
    }

    fn composed(
        rest: &Arc<RestDeformation>,
        q: &[Handle],
        lattice: &ControlLattice,
        work: &mut ProductWork,
        cancelled: IsCancelled<'_>,
    ) -> Result<Self, FoldFreeError> {
        let p = rest.handles().handles();
        let is_linear = rest.form() != CoefficientForm::Rigid;
        let class = if is_linear && !rest.handles().has_lines() {
            Class::Similarity
        } else {
            Class::Rigid
        };
        let motion = fitted(class, p, q, None)
            .map(|best| best.map.matrix())
            .and_then(|motion| Some((motion, inverse(&motion)?)));
        let (motion, back) = motion.unzip();
        let place = |v: &Point| back.as_ref().map_or(*v, |back| apply(back, *v));
        let targets: HandlePlaces = places_of(q)
            .iter()
            .map(|places| places.iter().map(place).collect())
            .collect();
        let path = Path::new(places_of(p), targets, cancelled).ok_or(CANCELLED)?;
        let mut product = Self {
            rest: Arc::clone(rest),
            steps: vec![path.rest().clone()],
            motion,
            is_reached: true,
            folded: 0,
        };
        let mut slow = 0;
        for target in path.legs() {
            loop {
                let now = product.steps.last().expect("the handles at rest");
                if product.steps.len() > MOST_FACTORS || slow == 2 {
                    product.is_reached = false;
                    return Ok(product);
                }
                work.take(work.of_factor)?;
                let field = rest.at(handles_like(p, now), cancelled)?;
                let way = Way {
                    field: &field,
                    form: p,
                    target,
                };
                let share = way.longest(lattice, work, cancelled)?;
                let next = if share < 1.0 {
                    between(now, target, share)
                } else {
                    target.clone()
                };
                product.steps.push(next);
                slow = if share < LEAST_STEP { slow + 1 } else { 0 };
                if share >= 1.0 {
                    break;
                }
            }
        }
        Ok(product)
    }

    /// The number of maps whose product this is.
    #[must_use]
    pub const fn count(&self) -> usize {
        self.steps.len() - 1
    }

    /// Whether the handles are at their targets: with 24 factors they nearly always are.
    #[must_use]
    pub const fn is_reached(&self) -> bool {
        self.is_reached
    }

    /// The cells of the plain f that fold.
    #[must_use]
    pub const fn folded(&self) -> u64 {
        self.folded
    }

    /// Memory, bytes.
    #[must_use]
    pub fn bytes(&self) -> u64 {
        const HANDLE_BYTES: usize = 24;
        const PLACE_BYTES: usize = 16;
        let of_handle = |places: &Vec<Point>| HANDLE_BYTES + PLACE_BYTES * places.len();
        self.steps.iter().flatten().map(of_handle).sum::<usize>() as u64
    }

    /// Memory of all factors beside their linear systems, bytes.
    #[must_use]
    pub fn factor_bytes(&self) -> u64 {
        COLUMN_BYTES * (self.rest.handles().columns() * self.count()) as u64
    }

    fn factor(&self, step: usize, cancelled: IsCancelled<'_>) -> Option<ProductFactor> {
        let p = self.rest.handles().handles();
        let [now, next] = [step, step + 1].map(|step| handles_like(p, &self.steps[step]));
        // That these handles can be taken to the next ones was seen when they were found.
        let field = self.rest.at(now, cancelled).ok()?;
        let pose = field.pose(&next).ok()?;
        Some((field, pose))
    }

    /// The maps whose product this is, for many calls of [`FoldFree::map_by`]. `None` when
    /// cancelled.
    #[must_use]
    pub fn factors(&self, cancelled: IsCancelled<'_>) -> Option<Vec<ProductFactor>> {
        let factor = |step| self.factor(step, cancelled);
        (0..self.count()).map(factor).collect()
    }

    /// f at many positions, by factors that are there. In parallel on the current pool; `None` when
    /// cancelled.
    #[must_use]
    pub fn map_by(
        &self,
        factors: &[ProductFactor],
        places: &[Point],
        cancelled: IsCancelled<'_>,
    ) -> Option<Vec<Point>> {
        let mut places = places.to_vec();
        for (field, pose) in factors {
            places = mapped((field, pose), &places, cancelled)?;
        }
        Some(self.moved(places))
    }

    /// f at many positions, by one factor after the other. `None` when cancelled.
    #[must_use]
    pub fn map_all(&self, places: &[Point], cancelled: IsCancelled<'_>) -> Option<Vec<Point>> {
        let mut places = places.to_vec();
        for step in 0..self.count() {
            let (field, pose) = self.factor(step, cancelled)?;
            places = mapped((&field, &pose), &places, cancelled)?;
        }
        Some(self.moved(places))
    }

    /// The motion comes last.
    fn moved(&self, mut places: Vec<Point>) -> Vec<Point> {
        if let Some(motion) = &self.motion {
            places.iter_mut().for_each(|v| *v = apply(motion, *v));
        }
        places
    }

    /// f at the vertices of a grid. Cells may fold although f does not, where f bends within them;
    /// [`untangle`](crate::geometry::untangle) mends that. `table`: of these vertices and the
    /// handles at rest, for the first factor. `None` when cancelled.
    #[must_use]
    pub fn mesh(
        &self,
        grid: &Grid,
        table: Option<&CoefficientTable>,
        cancelled: IsCancelled<'_>,
    ) -> Option<Mesh> {
        let rows = 0..grid.rows();
        let places: Vec<Point> = rows
            .flat_map(|j| (0..grid.columns()).map(move |i| grid.vertex(i, j)))
            .collect();
        let mut mapped = places.clone();
        for step in 0..self.count() {
            let (field, pose) = self.factor(step, cancelled)?;
            let Some(table) = table.filter(|_| step == 0) else {
                MovingMap::new(&field, &pose).map_all(&mut mapped, cancelled)?;
                continue;
            };
            let (displacements, _) = table.displace(&pose, cancelled)?;
            for (v, [x, y]) in mapped.iter_mut().zip(displacements) {
                *v = *v + Vec2::new(x.into(), y.into());
            }
        }
        let mapped = self.moved(mapped);
        #[expect(
            clippy::cast_possible_truncation,
            reason = "displacements are in single precision"
        )]
        let displacement = |(v, mapped): (&Point, &Point)| {
            let d = *mapped - *v;
            [d.x as f32, d.y as f32]
        };
        let displacements = places.iter().zip(&mapped).map(displacement).collect();
        Some(Mesh::new(*grid, displacements))
    }
}

/// That of everything that stops.
const CANCELLED: DeformError = DeformError::Cancelled;

/// f at many positions, in parallel on the current pool. `None` when cancelled.
fn mapped(
    (field, pose): (&RestDeformation, &Pose),
    places: &[Point],
    cancelled: IsCancelled<'_>,
) -> Option<Vec<Point>> {
    let f = field.deformation(pose);
    let map = |places: &[Point]| f.map_all(places, cancelled);
    let parts: Option<Vec<Vec<Point>>> = places.par_chunks(PLACES_PER_TASK).map(map).collect();
    Some(parts?.concat())
}

/// Where a pose takes handles.
fn targets_of(p: &[Handle], pose: &Pose) -> HandlePlaces {
    let (mut first, d) = (0, pose.displacements());
    let mut targets = |handle: &Handle| {
        let place = |(k, v): (usize, &Point)| {
            // Within a polyline, a position has a column in each of two segments.
            let column = if k == 0 { first } else { first + 2 * k - 1 };
            *v + d[column]
        };
        let targets = handle.places().iter().enumerate().map(place).collect();
        first += handle.columns();
        targets
    };
    p.iter().map(&mut targets).collect()
}

/// Operations of comparing all handles with each other.
fn pair_operations(p: &[Handle]) -> u64 {
    let of = |handle: &Handle| path::samples(handle.places()).len() as u64;
    let positions: u64 = p.iter().map(of).sum();
    PAIR_OPERATIONS.saturating_mul(positions.saturating_mul(positions))
}

fn apply([x, y]: &[[f64; 3]; 2], v: Point) -> Point {
    Point::new(
        x[0] * v.x + x[1] * v.y + x[2],
        y[0] * v.x + y[1] * v.y + y[2],
    )
}

/// `None` for a map that is not one-to-one.
fn inverse([x, y]: &[[f64; 3]; 2]) -> Option<[[f64; 3]; 2]> {
    let det = x[0] * y[1] - x[1] * y[0];
    let [a, b, c, d] = [y[1] / det, -x[1] / det, -y[0] / det, x[0] / det];
    let inverse = [
        [a, b, -(a * x[2] + b * y[2])],
        [c, d, -(c * x[2] + d * y[2])],
    ];
    let is_finite = inverse.iter().flatten().all(|value| value.is_finite());
    is_finite.then_some(inverse)
}
