//! f without folds (mathematics 9.3): a product of maps of moving least squares. Each goes as far
//! along the way from p to q as it stays one-to-one, and carries the handles along, which are then
//! the handles at rest of the next one.

mod lattice;
mod path;
mod reach;
#[cfg(test)]
mod tests;

use std::fmt;

use self::lattice::ControlLattice;
use self::path::{HandlePlaces, Path, between, handles_like, places_of};
use super::{
    Class, CoefficientForm, DeformError, Handle, IsCancelled, Pose, RestDeformation, fitted,
};
use crate::geometry::{Grid, Mesh, Point, Vec2};

/// Factors of a product: ordinary poses need 3 to 7.
const MOST_FACTORS: usize = 24;
/// A factor that goes less far than this share of its way does not arrive, if the next one does not
/// either.
const LEAST_STEP: f64 = 1e-3;
/// Bisections for the share of the way of a rotation, whose displacements are not linear in it.
const BISECTIONS: u32 = 9;

/// Makes the deformation of handles at rest: of one method with its parameters.
pub type MakeDeformation<'a> = &'a dyn Fn(Vec<Handle>) -> Result<RestDeformation, DeformError>;

/// Why a pose has no map without folds.
#[derive(Clone, Debug, PartialEq)]
pub enum FoldFreeError {
    /// No map without folds takes these handles to their targets: they would have to pass through
    /// each other, or through themselves. Indices of one or two of them, or of a chain of lines.
    Unreachable(Vec<usize>),
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

/// f of a pose, without folds wherever it can be: the plain f where that has none, bit for bit.
#[derive(Debug)]
pub struct FoldFree {
    factors: Vec<(RestDeformation, Pose)>,
    /// The best motion of all handles, which comes last: two rows.
    motion: Option<[[f64; 3]; 2]>,
    is_reached: bool,
}

impl FoldFree {
    /// The map from p to q. `make`: a method that meets its handles; the image is that of the
    /// `grid`, on which it is drawn. O(factors x (control lattice + handles^2)).
    ///
    /// # Errors
    /// Handles that no map without folds takes to their targets; those of `make`; cancelled, as an
    /// error of `make`.
    ///
    /// ```
    /// use mlswarp::deform::{Falloff, FoldFree, Handle, Handles, Method, RestDeformation};
    /// use mlswarp::geometry::{Grid, Point};
    /// let point = |(x, y)| Handle::Point(Point::new(x, y));
    /// let corners = [(20.0, 20.0), (180.0, 20.0), (20.0, 180.0), (180.0, 180.0)].map(point);
    /// let p = [&corners[..], &[point((50.0, 100.0))]].concat();
    /// let mut q = p.clone();
    /// q[4] = point((150.0, 100.0));
    /// let make = |handles| {
    ///     let rest = Handles::new(handles, None)?;
    ///     RestDeformation::new(rest, Method::Similarity, Falloff::new(1.0, false)?, 1.0)
    /// };
    /// let grid = Grid::with_cell(200.0, 200.0, 5.0);
    /// let f = FoldFree::new(&p, &q, &make, &grid, &|| false)?;
    /// assert!(f.factors() > 1);
    /// let mapped = f.map_all(&[Point::new(50.0, 100.0)], &|| false).unwrap();
    /// assert!(mapped[0].distance(Point::new(150.0, 100.0)) < 1e-9);
    /// # Ok::<(), mlswarp::deform::FoldFreeError>(())
    /// ```
    pub fn new(
        p: &[Handle],
        q: &[Handle],
        make: MakeDeformation<'_>,
        grid: &Grid,
        cancelled: IsCancelled<'_>,
    ) -> Result<Self, FoldFreeError> {
        let lattice = ControlLattice::new(grid.width(), grid.height());
        let plain = make(p.to_vec())?;
        let pose = plain.pose(q)?;
        let is_plain = {
            let f = plain.deformation(&pose);
            let mapped = f.map_all(lattice.places(), cancelled).ok_or(CANCELLED)?;
            lattice.is_open(&mapped)
                && mesh_of(&|places| f.map_all(places, cancelled), grid)
                    .and_then(|mesh| mesh.folding(cancelled))
                    .ok_or(CANCELLED)?
                    .cells
                    == 0
        };
        if is_plain {
            return Ok(Self {
                factors: vec![(plain, pose)],
                motion: None,
                is_reached: true,
            });
        }
        if let Some(handles) = reach::unreachable(p, q, cancelled).ok_or(CANCELLED)? {
            return Err(FoldFreeError::Unreachable(handles));
        }
        Self::composed(p, q, make, &lattice, cancelled)
    }

    fn composed(
        p: &[Handle],
        q: &[Handle],
        make: MakeDeformation<'_>,
        lattice: &ControlLattice,
        cancelled: IsCancelled<'_>,
    ) -> Result<Self, FoldFreeError> {
        let is_linear = make(p.to_vec())?.form() != CoefficientForm::Rigid;
        let has_lines = p.iter().any(|handle| handle.places().len() > 1);
        let class = if is_linear && !has_lines {
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
        let (mut factors, mut slow) = (Vec::new(), 0);
        let mut now = path.rest().clone();
        for target in path.legs() {
            loop {
                if factors.len() == MOST_FACTORS || slow == 2 {
                    let is_reached = false;
                    return Ok(Self {
                        factors,
                        motion,
                        is_reached,
                    });
                }
                let field = make(handles_like(p, &now))?;
                let way = Way {
                    field: &field,
                    form: p,
                    now: &now,
                    target,
                };
                let share = way.longest(is_linear, lattice, cancelled)?;
                now = if share < 1.0 {
                    between(&now, target, share)
                } else {
                    target.clone()
                };
                let pose = field.pose(&handles_like(p, &now))?;
                factors.push((field, pose));
                slow = if share < LEAST_STEP { slow + 1 } else { 0 };
                if share >= 1.0 {
                    break;
                }
            }
        }
        Ok(Self {
            factors,
            motion,
            is_reached: true,
        })
    }

    /// The number of maps whose product this is; 1 for the plain f.
    #[must_use]
    pub const fn factors(&self) -> usize {
        self.factors.len()
    }

    /// Whether the handles are at their targets: with 24 factors they nearly always are.
    #[must_use]
    pub const fn is_reached(&self) -> bool {
        self.is_reached
    }

    /// f at many positions. `None` when cancelled.
    #[must_use]
    pub fn map_all(&self, places: &[Point], cancelled: IsCancelled<'_>) -> Option<Vec<Point>> {
        let mut places = places.to_vec();
        for (rest, pose) in &self.factors {
            places = rest.deformation(pose).map_all(&places, cancelled)?;
        }
        if let Some(motion) = &self.motion {
            places.iter_mut().for_each(|v| *v = apply(motion, *v));
        }
        Some(places)
    }

    /// f at the vertices of a grid. Cells may fold although f does not, where f bends within them;
    /// [`untangle`](crate::geometry::untangle) mends that. `None` when cancelled.
    #[must_use]
    pub fn mesh(&self, grid: &Grid, cancelled: IsCancelled<'_>) -> Option<Mesh> {
        mesh_of(&|places| self.map_all(places, cancelled), grid)
    }
}

/// That of everything that stops.
const CANCELLED: DeformError = DeformError::Cancelled;

fn mesh_of(map: &dyn Fn(&[Point]) -> Option<Vec<Point>>, grid: &Grid) -> Option<Mesh> {
    let rows = 0..grid.rows();
    let places: Vec<Point> = rows
        .flat_map(|j| (0..grid.columns()).map(move |i| (i, j)))
        .map(|(i, j)| Point::new(grid.x(i), grid.y(j)))
        .collect();
    let mapped = map(&places)?;
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

/// The way of one factor.
struct Way<'a> {
    field: &'a RestDeformation,
    form: &'a [Handle],
    now: &'a HandlePlaces,
    target: &'a HandlePlaces,
}

impl Way<'_> {
    /// The largest share of the way, up to 1, on which every corner of the control lattice stays
    /// open.
    fn longest(
        &self,
        is_linear: bool,
        lattice: &ControlLattice,
        cancelled: IsCancelled<'_>,
    ) -> Result<f64, FoldFreeError> {
        let mapped = |share: f64| -> Result<Vec<Point>, FoldFreeError> {
            let posed = handles_like(self.form, &between(self.now, self.target, share));
            let pose = self.field.pose(&posed)?;
            let f = self.field.deformation(&pose);
            Ok(f.map_all(lattice.places(), cancelled).ok_or(CANCELLED)?)
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
