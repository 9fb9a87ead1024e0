//! Handles made of any bytes: every method, points, segments and polylines, weights, alpha and
//! point mass. Coordinates lie on a lattice of 256 steps, so that handles meet, repeat, stand in a
//! row and cross far more often than numbers by chance would, and now and then a hair beside it.
//! Two laws: everything is finite, and the plan says what the exact function says.

use mlswarp::deform::{
    CoefficientForm, CoefficientTable, Falloff, Handle, Handles, Method, Pose, RestDeformation,
};
use mlswarp::geometry::{Point, Vec2};

/// Bytes as choices; zeros when there are no more.
struct Choices<'a>(&'a [u8]);

impl Choices<'_> {
    fn byte(&mut self) -> u8 {
        let Some((byte, rest)) = self.0.split_first() else {
            return 0;
        };
        self.0 = rest;
        *byte
    }

    fn pick<T: Copy>(&mut self, of: &[T]) -> T {
        of[usize::from(self.byte()) % of.len()]
    }

    fn place(&mut self, step: f64, hair: f64) -> Point {
        let (x, y) = (self.byte(), self.byte());
        // The last two steps lie a hair beside their neighbours.
        let coordinate = |n: u8| {
            if n < 254 {
                f64::from(n) * step
            } else {
                f64::from(n - 200) * step + hair
            }
        };
        Point::new(coordinate(x), coordinate(y))
    }

    fn handle(&mut self, places: usize, step: f64, hair: f64) -> Handle {
        match places {
            1 => Handle::Point(self.place(step, hair)),
            _ => Handle::Polyline((0..places).map(|_| self.place(step, hair)).collect()),
        }
    }
}

const MOST_HANDLES: usize = 12;

pub(super) fn hold(bytes: &[u8]) {
    let mut choices = Choices(bytes);
    let method = choices.pick(&[Method::Affine, Method::Similarity, Method::Rigid]);
    let alpha = choices.pick(&[
        0.5, 1.0, 1.5, 2.0, 3.0, 0.05, 0.51, 0.7, 1.3, 4.0, 8.0, 7.99,
    ]);
    let step = choices.pick(&[1.0, 2.0, 0.01, 1e-5, 100.0, 3900.0]);
    let hair = step * choices.pick(&[1e-3, 1e-6, 1e-9, 1e-12, 0.5]);
    let point_mass = choices.pick(&[1.0, 100.0, 1e-9, 1e9, 0.3]);
    let shapes: Vec<usize> = (0..usize::from(choices.byte()) % (MOST_HANDLES + 1))
        .map(|_| choices.pick(&[1, 1, 1, 2, 2, 3, 4]))
        .collect();
    let weights: Vec<f64> = shapes
        .iter()
        .map(|_| choices.pick(&[1.0, 1.0, 1.0, 2.0, 0.1, 1e-9, 1e9, 1e3]))
        .collect();
    let p: Vec<Handle> = shapes
        .iter()
        .map(|&places| choices.handle(places, step, hair))
        .collect();
    let reach = choices.pick(&[1.0, 1.0, 0.1, 1e-6, 30.0]);
    let q: Vec<Handle> = shapes
        .iter()
        .map(|&places| choices.handle(places, step * reach, hair))
        .collect();

    let Ok(rest) = Handles::new(p, Some(weights)) else {
        return;
    };
    let Ok(falloff) = Falloff::new(alpha, rest.has_lines()) else {
        return;
    };
    let Ok(field) = RestDeformation::new(rest, method, falloff, point_mass) else {
        return;
    };
    let Ok(pose) = field.pose(&q) else { return };
    let places = field
        .handles()
        .handles()
        .iter()
        .flat_map(Handle::places)
        .copied();
    // On the handles, beside them, between them, and anywhere.
    let mut vertices: Vec<Point> = places
        .flat_map(|v| {
            [
                v,
                v + Vec2::new(hair, 0.0),
                v + Vec2::new(step, -0.5 * step),
            ]
        })
        .collect();
    vertices.extend((0..6).map(|_| choices.place(step, hair)));
    vertices.extend([
        Point::new(-1e3 * step, 77.0 * step),
        Point::new(0.0, 0.0),
        Point::new(1e5, -1e5),
    ]);

    let (displacement, quality) =
        CoefficientTable::of_vertices(&field, vertices.len(), |k| vertices[k])
            .displace(&pose, &|| false)
            .expect("nothing gives it up");
    let farthest = pose
        .displacements()
        .iter()
        .map(|d| d.norm())
        .fold(0.0, f64::max);
    let probes = Probes::new(&field, &falloff, point_mass);
    for (v, d) in vertices.iter().zip(displacement) {
        let exact = field.map(&pose, *v) - *v;
        assert!(
            exact.norm().is_finite(),
            "the function is {exact:?} at {v:?}"
        );
        assert!(
            d.iter().all(|c| c.is_finite()),
            "the plan says {d:?} at {v:?}"
        );
        // Where rotations fit almost equally well, which one is found hangs on the last digit.
        // Beside handles that contradict each other, f has no bound.
        let is_bounded = quality.least_rotation > 1e-2 && pose.conflicts().total == 0;
        if let Some(gain) = probes.gain(*v).filter(|_| is_bounded) {
            let rounding = 1e-15 * ((*v - Point::default()).norm() + exact.norm());
            let off = (exact - Vec2::new(d[0].into(), d[1].into())).norm();
            let allowed =
                2e-6 * farthest * gain.max(1.0) / f64::from(quality.least_rotation) + rounding;
            assert!(
                off <= allowed,
                "{method:?} alpha {alpha}: the plan is {off:e} off at {v:?}, allowed {allowed:e}; \
                    {exact:?}"
            );
        }
    }
}

/// How much the coefficients of a place add up to, seen from outside: the fit is posed with unit
/// steps whose directions are drawn by chance, the same for handles that rest at one place. The
/// promise of the plan is 2e-6 of the longest step times a tenth of that sum.
struct Probes {
    field: RestDeformation,
    poses: Vec<Pose>,
    columns: f64,
}

impl Probes {
    fn new(field: &RestDeformation, falloff: &Falloff, point_mass: f64) -> Self {
        // A rotation is the direction of the similarity that fits.
        let family = match field.form() {
            CoefficientForm::Real => Method::Affine,
            CoefficientForm::Complex | CoefficientForm::Rigid => Method::Similarity,
        };
        let rest = field.handles().clone();
        let stepped = |seed: u64| -> Vec<Handle> {
            let step = |p: &Point| {
                let mixed = (p.x.to_bits() ^ p.y.to_bits().rotate_left(31) ^ seed)
                    .wrapping_mul(0x9E37_79B9_7F4A_7C15);
                let angle = (mixed >> 40) as f64;
                *p + Vec2::new(angle.cos(), angle.sin())
            };
            let moved = |handle: &Handle| match handle {
                Handle::Point(p) => Handle::Point(step(p)),
                Handle::Polyline(places) => Handle::Polyline(places.iter().map(step).collect()),
                Handle::Missing => Handle::Missing,
            };
            rest.handles().iter().map(moved).collect()
        };
        let poses: Vec<_> = (1..=PROBES)
            .map(|seed| stepped(seed * 0x1234_5678_9ABC_DEF1_u64))
            .collect();
        let columns = rest.columns() as f64;
        let field = RestDeformation::new(rest, family, *falloff, point_mass)
            .expect("the handles of a field");
        let poses = poses
            .iter()
            .filter_map(|q| field.pose(q).ok())
            .filter(|pose| pose.conflicts().total == 0)
            .collect();
        Self {
            field,
            poses,
            columns,
        }
    }

    /// At least a tenth of the sum; none where the handles meet in ways that leave no step free.
    fn gain(&self, v: Point) -> Option<f64> {
        let steps = self
            .poses
            .iter()
            .map(|pose| (self.field.map(pose, v) - v).norm());
        // Of n terms with directions by chance, the length of the sum is a few roots of n below the
        // sum of the lengths.
        steps
            .reduce(f64::max)
            .map(|longest| 3.0 * longest * self.columns.sqrt())
    }
}

/// Poses that are tried.
const PROBES: u64 = 6;
