//! The spline of a pose at many positions: the bending of what is far away by polynomials of tiles
//! (mathematics 7.4).

use std::sync::OnceLock;

use super::spline::{PosedSpline, SNAP_SHARE};
use crate::deform::IsCancelled;
use crate::deform::kernel::{LaneWork, run_at};
use crate::deform::tiles::{
    RadialKernel, TILE_LANES, Tile, TileRules, TileSource, Tiles, squared_distances,
};
use crate::geometry::Point;
use crate::geometry::lane_math::quick_ln;
use crate::level::SimdLevel;

/// Nodes of a tile along each axis: those of the Chebyshev polynomial of this degree.
const TILE_NODES: usize = 12;
const NODES: [f64; TILE_NODES] = [
    -0.991_444_861_373_810_4,
    -0.923_879_532_511_286_7,
    -0.793_353_340_291_235_2,
    -0.608_761_429_008_720_7,
    -0.382_683_432_365_089_8,
    -0.130_526_192_220_051_7,
    0.130_526_192_220_051_7,
    0.382_683_432_365_089_8,
    0.608_761_429_008_720_7,
    0.793_353_340_291_235_2,
    0.923_879_532_511_286_7,
    0.991_444_861_373_810_4,
];
/// What is far, in halves of the side of a tile, and how much U of it is off at most, in squares of
/// that half.
const ERROR_BY_DISTANCE: [(f64, f64); 3] = [(3.5, 1.3e-9), (5.0, 1.5e-11), (7.0, 7e-13)];
/// The largest half in which something is far, in units of the sites.
const LARGEST_HALF: f64 = 1.0;
/// The largest difference to the plain sum, px; splines with weights that are too large for it are
/// summed plainly.
const MOST_OFF: f64 = 4e-3;
/// The side of the smallest tile, px.
const SMALLEST_TILE: f64 = 4.0;
/// A tile with at most this number of sites nearby is not divided: its nodes would take longer.
const MOST_NEAR: usize = 100;

/// `U(r) = r^2 ln r^2`.
#[derive(Clone, Copy, Debug)]
struct Bending;

impl RadialKernel for Bending {
    #[inline(always)]
    fn weights_from_squares(self, squares: &mut [f64]) {
        for r2 in squares {
            // Polynomials of tiles are off by far more than this logarithm.
            *r2 *= quick_ln(*r2);
        }
    }
}

/// The sums over the sites of U times their weights.
type SplineTiles = Tiles<Bending, 2, TILE_NODES>;

/// A spline with its pose, and its tiles, which are made when many positions are first asked for.
#[derive(Debug)]
pub(super) struct TiledSpline<'a> {
    pub(super) posed: PosedSpline<'a>,
    tiles: OnceLock<SplineTiles>,
}

impl<'a> TiledSpline<'a> {
    pub(super) const fn new(posed: PosedSpline<'a>) -> Self {
        Self {
            posed,
            tiles: OnceLock::new(),
        }
    }

    /// `f(v) - v` of every place, px, and 1. `None` when cancelled.
    pub(super) fn displaced_at(
        &self,
        level: SimdLevel,
        places: &[Point],
        cancelled: IsCancelled<'_>,
    ) -> Option<Vec<[f32; 3]>> {
        let places: Vec<Point> = places
            .iter()
            .map(|place| self.posed.in_frame(*place))
            .collect();
        let tiles = self.tiles.get_or_init(|| self.new_tiles());
        tiles.map(level, &places, cancelled, |tile, places, out| {
            run_at(
                level,
                SplineDisplacements {
                    posed: &self.posed,
                    tiles,
                    tile,
                    places,
                    out,
                },
            );
        })
    }

    fn new_tiles(&self) -> SplineTiles {
        let total: f64 = self
            .posed
            .weights
            .iter()
            .map(|[x, y]| x.abs() + y.abs())
            .sum();
        let far = ERROR_BY_DISTANCE
            .iter()
            .find(|(_, off)| off * total * LARGEST_HALF * LARGEST_HALF <= MOST_OFF);
        let weighted = self.posed.sites().zip(&self.posed.weights);
        let sources = weighted.map(|(p, weight)| TileSource {
            p,
            factors: *weight,
        });
        let rules = TileRules {
            nodes: NODES,
            far: far.map_or(f64::INFINITY, |(far, _)| *far),
            smallest: if far.is_some() {
                SMALLEST_TILE / self.posed.unit()
            } else {
                f64::INFINITY
            },
            largest: 2.0 * LARGEST_HALF,
            most_near: MOST_NEAR,
        };
        Tiles::new(Bending, sources.collect(), rules)
    }
}

/// The displacements at positions of one tile, in the frame.
struct SplineDisplacements<'a> {
    posed: &'a PosedSpline<'a>,
    tiles: &'a SplineTiles,
    tile: &'a Tile<2>,
    places: &'a [Point],
    out: &'a mut [[f32; 3]],
}

impl LaneWork for SplineDisplacements<'_> {
    type Output = ();

    #[inline(always)]
    fn run(self) {
        let [a, ax, ay] = self.posed.polynomials;
        let places = self.places;
        for (first, out) in (0..)
            .step_by(TILE_LANES)
            .zip(self.out.chunks_mut(TILE_LANES))
        {
            let (mut x, mut y) = ([0.0; TILE_LANES], [0.0; TILE_LANES]);
            for k in 0..TILE_LANES {
                let place = places[(first + k).min(places.len() - 1)];
                (x[k], y[k]) = (place.x, place.y);
            }
            let mut moved = self.tiles.sums(self.tile, &x, &y);
            for axis in 0..2 {
                for k in 0..TILE_LANES {
                    moved[axis][k] += a[axis] + ax[axis] * x[k] + ay[axis] * y[k];
                }
            }
            if self.posed.interpolates() {
                // On a site its own displacement: rounding must not move a handle.
                for (site, source) in self.tile.near() {
                    let r2 = squared_distances(source.p, &x, &y);
                    for k in 0..TILE_LANES {
                        if r2[k] <= SNAP_SHARE * SNAP_SHARE {
                            let [dx, dy] = self.posed.displacements[site];
                            (moved[0][k], moved[1][k]) = (dx, dy);
                        }
                    }
                }
            }
            for (k, out) in out.iter_mut().enumerate() {
                #[expect(clippy::cast_possible_truncation, reason = "the precision of a table")]
                let single = [moved[0][k] as f32, moved[1][k] as f32, 1.0];
                *out = single;
            }
        }
    }
}
