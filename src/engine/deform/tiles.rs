//! Sums over many sources of a kernel of the distance, `sum K(|p_i - v|^2) c_i`, at many positions:
//! a quadtree of tiles. What a tile is far from varies so smoothly over it that polynomials through
//! a few of its positions are as good as the sums (mathematics 7.4). So a position costs the
//! sources near its tile, and a polynomial for all others, instead of all sources.
//!
//! Tiles are made when a position first needs them. Which tile a position belongs to, and what that
//! tile knows, depends on the sources alone: neither other positions nor threads change a bit.

use std::fmt::Debug;
use std::sync::OnceLock;

use super::IsCancelled;
use super::kernel::{LaneWork, run_at};
use crate::geometry::{Point, Vec2};
use crate::level::SimdLevel;
use crate::parallel::prelude::*;

/// Positions whose sums are computed at once.
pub(super) const TILE_LANES: usize = 8;
/// Sources whose kernel is computed at once: a loop long enough that powers are vectorised.
const AT_ONCE: usize = 32;
/// Sums that are added in one pass over the sources: with more, AVX2 has no registers for them, and
/// each source waits until those of the one before are in memory.
const SUMS_AT_ONCE: usize = 4;
/// Columns of nodes that are summed in one pass, for the same reason.
const COLUMNS_AT_ONCE: usize = 4;
/// The root's side in extents of the sources: positions beyond it are computed by plain sums.
const ROOT_EXTENTS: f64 = 64.0;
const MOST_LEVELS: u32 = 16;
/// Positions of a task.
const POSITIONS_PER_TASK: usize = 512;
/// The code of a position outside of the root.
const OUTSIDE: u64 = 1 << (2 * MOST_LEVELS);
/// Bits of the index of a position behind its code.
const INDEX_BITS: u32 = 31;

/// What is summed, as a function of the squared distance.
pub(super) trait RadialKernel: Copy + Debug + Send + Sync {
    /// Replaces every squared distance, which is positive.
    fn weights_from_squares(self, squares: &mut [f64]);
}

/// A position and what the kernel there is multiplied by.
#[derive(Clone, Debug)]
pub(super) struct TileSource<const SUMS: usize> {
    pub(super) p: Point,
    pub(super) factors: [f64; SUMS],
}

/// How tiles are made.
#[derive(Clone, Copy, Debug)]
pub(super) struct TileRules<const NODES: usize> {
    /// Positions of the nodes of a tile along each axis, from -1 to 1.
    pub(super) nodes: [f64; NODES],
    /// Sources at this distance from the middle of a tile or more are far, in halves of its side.
    pub(super) far: f64,
    /// The side of the smallest tile; infinite: nothing is far.
    pub(super) smallest: f64,
    /// The side of the largest tile from which anything is far.
    pub(super) largest: f64,
    /// A tile with at most this many sources nearby is not divided.
    pub(super) most_near: usize,
}

/// The quadtree. `NODES`: of the polynomials along each axis.
#[derive(Debug)]
pub(super) struct Tiles<K, const SUMS: usize, const NODES: usize> {
    kernel: K,
    rules: TileRules<NODES>,
    sources: Vec<TileSource<SUMS>>,
    /// One over the product of the distances of each node from all others.
    node_weights: [f64; NODES],
    /// Lagrange's polynomials of a tile at the nodes of its left and right (upper and lower) half.
    of_halves: [[[f64; NODES]; NODES]; 2],
    levels: u32,
    corner: Point,
    root: Tile<SUMS>,
}

/// A square and the sums over it.
#[derive(Debug)]
pub(super) struct Tile<const SUMS: usize> {
    middle: Point,
    half: f64,
    level: u32,
    /// Indices of the sources that are not far.
    near: Vec<u32>,
    /// The same, of a tile that is not divided.
    near_sources: Vec<TileSource<SUMS>>,
    /// The sums over all others at the nodes, `[NODES][NODES]`, row by row; empty if none is far.
    far: Vec<[f64; SUMS]>,
    /// Upper left, upper right, lower left, lower right; `None`: not divided.
    quarters: Option<Box<[OnceLock<Tile<SUMS>>; 4]>>,
}

impl<K: RadialKernel, const SUMS: usize, const NODES: usize> Tiles<K, SUMS, NODES> {
    /// No tile is made yet but the root.
    pub(super) fn new(kernel: K, sources: Vec<TileSource<SUMS>>, rules: TileRules<NODES>) -> Self {
        let (mut least, mut most) = (sources[0].p, sources[0].p);
        for TileSource { p, .. } in &sources {
            least = Point::new(least.x.min(p.x), least.y.min(p.y));
            most = Point::new(most.x.max(p.x), most.y.max(p.y));
        }
        // The side is the smallest one, doubled as often as needed: so the quarters of quarters end
        // with tiles of the smallest side.
        let wanted = ROOT_EXTENTS * (most.x - least.x).max(most.y - least.y);
        let (mut levels, mut side) = (0, rules.smallest);
        while side < wanted && levels < MOST_LEVELS {
            (levels, side) = (levels + 1, 2.0 * side);
        }
        let half = 0.5 * side.max(wanted);
        let middle = least.lerp(most, 0.5);
        let node_weights = std::array::from_fn(|i| {
            let others = (0..NODES).filter(|j| *j != i);
            1.0 / others.fold(1.0, |product, j| {
                product * (rules.nodes[i] - rules.nodes[j])
            })
        });
        // The polynomial of a tile, at the nodes of each of its halves. It is the same for all
        // tiles, since nodes are in units of the tile.
        let of_halves = [-0.5, 0.5].map(|middle| {
            rules.nodes.map(|node| {
                lagrange(&rules.nodes, &node_weights, &[middle + 0.5 * node]).map(|[at]| at)
            })
        });
        let mut tiles = Self {
            kernel,
            rules,
            node_weights,
            of_halves,
            levels,
            corner: Point::new(middle.x - half, middle.y - half),
            root: Tile {
                middle,
                half,
                level: 0,
                near: Vec::new(),
                near_sources: Vec::new(),
                far: Vec::new(),
                quarters: None,
            },
            sources,
        };
        let all = 0..u32::try_from(tiles.sources.len()).expect("fewer handles");
        tiles.root = tiles.tile((middle, half, 0), all.collect(), Vec::new());
        tiles
    }

    /// Numbers of each position, in their order, from its tile; `of` gets positions of one tile, at
    /// most a few hundred. `None` when cancelled.
    pub(super) fn map<T: Copy + Default + Send + Sync>(
        &self,
        level: SimdLevel,
        places: &[Point],
        cancelled: IsCancelled<'_>,
        of: impl Fn(&Tile<SUMS>, &[Point], &mut [T]) + Sync,
    ) -> Option<Vec<T>> {
        // Positions of one tile are computed together, whatever their order is.
        let mut order: Vec<u64> = places
            .iter()
            .zip(0..)
            .map(|(place, index)| self.code(*place) << INDEX_BITS | index)
            .collect();
        order.sort_unstable();
        let index = |key: u64| usize::try_from(key & ((1 << INDEX_BITS) - 1)).expect("31 bits");
        let parts: Option<Vec<Vec<T>>> = order
            .par_chunks(POSITIONS_PER_TASK)
            .map(|keys| {
                let places: Vec<Point> = keys.iter().map(|key| places[index(*key)]).collect();
                let mut out = vec![T::default(); keys.len()];
                let mut first = 0;
                while first < keys.len() {
                    if cancelled() {
                        return None;
                    }
                    let code = keys[first] >> INDEX_BITS;
                    let (tile, below) = self.tile_of(level, code);
                    let count = keys[first..]
                        .iter()
                        .take_while(|key| (*key >> INDEX_BITS) >> below == code >> below)
                        .count();
                    let run = first..first + count;
                    of(tile, &places[run.clone()], &mut out[run]);
                    first += count;
                }
                Some(out)
            })
            .collect();
        let mut mapped = vec![T::default(); places.len()];
        for (key, value) in order.iter().zip(parts?.iter().flatten()) {
            mapped[index(*key)] = *value;
        }
        Some(mapped)
    }

    /// The sums at some positions of a tile, `[SUMS]`.
    #[inline(always)]
    pub(super) fn sums(
        &self,
        tile: &Tile<SUMS>,
        x: &[f64; TILE_LANES],
        y: &[f64; TILE_LANES],
    ) -> [[f64; TILE_LANES]; SUMS] {
        let mut sums = [[0.0; TILE_LANES]; SUMS];
        if !tile.far.is_empty() {
            self.far_sums(tile, x, y, &mut sums);
        }
        add_sources(self.kernel, &tile.near_sources, x, y, &mut sums);
        sums
    }

    /// The polynomials of a tile.
    #[cfg_attr(not(optimized_for_size), inline(always))]
    #[cfg_attr(optimized_for_size, optimize(speed), inline(never))]
    fn far_sums(
        &self,
        tile: &Tile<SUMS>,
        x: &[f64; TILE_LANES],
        y: &[f64; TILE_LANES],
        sums: &mut [[f64; TILE_LANES]; SUMS],
    ) {
        let (mut across, mut down) = ([0.0; TILE_LANES], [0.0; TILE_LANES]);
        for k in 0..TILE_LANES {
            across[k] = (x[k] - tile.middle.x) / tile.half;
            down[k] = (y[k] - tile.middle.y) / tile.half;
        }
        let across = lagrange(&self.rules.nodes, &self.node_weights, &across);
        let down = lagrange(&self.rules.nodes, &self.node_weights, &down);
        let mut line = [[0.0; SUMS]; NODES];
        for k in 0..TILE_LANES {
            // Positions of a row of the grid share what is summed down the columns of nodes.
            if k == 0 || y[k] != y[k - 1] {
                line = down_columns(&tile.far, &down.map(|down| down[k]));
            }
            let mut at = [0.0; SUMS];
            for i in 0..NODES {
                at = plus(at, across[i][k], line[i]);
            }
            for s in 0..SUMS {
                sums[s][k] = at[s];
            }
        }
    }

    /// The order of positions along a curve that passes through each tile once.
    fn code(&self, place: Point) -> u64 {
        let smallest = 2.0 * self.root.half / f64::from(1_u32 << self.levels);
        let (x, y) = (
            ((place.x - self.corner.x) / smallest).floor(),
            ((place.y - self.corner.y) / smallest).floor(),
        );
        let inside = 0.0..f64::from(1_u32 << self.levels);
        if !(inside.contains(&x) && inside.contains(&y)) {
            return OUTSIDE;
        }
        #[expect(
            clippy::cast_possible_truncation,
            clippy::cast_sign_loss,
            reason = "at most 16 bits"
        )]
        let spread = [x as u64, y as u64].map(|bits| {
            let bits = (bits | bits << 8) & 0x00FF_00FF;
            let bits = (bits | bits << 4) & 0x0F0F_0F0F;
            let bits = (bits | bits << 2) & 0x3333_3333;
            (bits | bits << 1) & 0x5555_5555
        });
        spread[0] | spread[1] << 1
    }

    /// The tile of a code, and the number of its bits that differ inside it.
    fn tile_of(&self, level: SimdLevel, code: u64) -> (&Tile<SUMS>, u32) {
        let mut tile = &self.root;
        if code == OUTSIDE {
            return (tile, 0);
        }
        while let Some(quarters) = &tile.quarters {
            let below = 2 * (self.levels - 1 - tile.level);
            let quarter = usize::try_from(code >> below & 3).expect("two bits");
            let divided = tile;
            tile = quarters[quarter].get_or_init(|| self.quarter(level, divided, quarter));
        }
        (tile, 2 * (self.levels - tile.level))
    }

    fn tile(
        &self,
        (middle, half, level): (Point, f64, u32),
        near: Vec<u32>,
        far: Vec<[f64; SUMS]>,
    ) -> Tile<SUMS> {
        let is_divided = level < self.levels && near.len() > self.rules.most_near;
        Tile {
            middle,
            half,
            level,
            near_sources: if is_divided && level > 0 {
                Vec::new()
            } else {
                self.pick(&near)
            },
            near,
            far,
            quarters: is_divided.then(Box::default),
        }
    }

    fn pick(&self, indices: &[u32]) -> Vec<TileSource<SUMS>> {
        let each = indices.iter();
        each.map(|k| self.sources[*k as usize].clone()).collect()
    }

    fn quarter(&self, level: SimdLevel, tile: &Tile<SUMS>, quarter: usize) -> Tile<SUMS> {
        let half = 0.5 * tile.half;
        let side = |is_second: bool| if is_second { half } else { -half };
        let (right, lower) = (quarter & 1 == 1, quarter & 2 == 2);
        let middle = tile.middle + Vec2::new(side(right), side(lower));
        // What was far from the whole is far from the quarter too, so only its nearby points are
        // looked at again.
        let distance = if 2.0 * half <= self.rules.largest {
            self.rules.far * half
        } else {
            f64::INFINITY
        };
        let (far, near): (Vec<u32>, Vec<u32>) =
            tile.near.iter().copied().partition(|k| {
                (self.sources[*k as usize].p - middle).norm2() >= distance * distance
            });
        let sums = if far.is_empty() && tile.far.is_empty() {
            Vec::new()
        } else {
            run_at(
                level,
                NodeSums {
                    tiles: self,
                    middle,
                    half,
                    fresh: self.pick(&far),
                    of_whole: &tile.far,
                    halves: [
                        &self.of_halves[usize::from(right)],
                        &self.of_halves[usize::from(lower)],
                    ],
                },
            )
        };
        self.tile((middle, half, tile.level + 1), near, sums)
    }
}

impl<const SUMS: usize> Tile<SUMS> {
    /// Index and source of what is near a tile that is not divided.
    pub(super) fn near(&self) -> impl Iterator<Item = (usize, &TileSource<SUMS>)> {
        let indices = self.near.iter().map(|index| *index as usize);
        indices.zip(&self.near_sources)
    }
}

/// The sums of a quarter at its nodes: those of the whole tile, and over what is far from the
/// quarter alone.
struct NodeSums<'a, K, const SUMS: usize, const NODES: usize> {
    tiles: &'a Tiles<K, SUMS, NODES>,
    middle: Point,
    half: f64,
    fresh: Vec<TileSource<SUMS>>,
    of_whole: &'a [[f64; SUMS]],
    /// The polynomials of the whole tile at the nodes, across and down.
    halves: [&'a [[f64; NODES]; NODES]; 2],
}

impl<K: RadialKernel, const SUMS: usize, const NODES: usize> LaneWork
    for NodeSums<'_, K, SUMS, NODES>
{
    type Output = Vec<[f64; SUMS]>;

    #[inline(always)]
    fn run(self) -> Self::Output {
        let mut sums = vec![[0.0; SUMS]; NODES * NODES];
        if !self.of_whole.is_empty() {
            // Down first, then across: 2 n^3 products instead of n^4. The degree is the same, so
            // this step adds no error (mathematics 7.4).
            for (down, out) in self.halves[1].iter().zip(sums.chunks_exact_mut(NODES)) {
                let line = down_columns(self.of_whole, down);
                for (across, out) in self.halves[0].iter().zip(out) {
                    for i in 0..NODES {
                        *out = plus(*out, across[i], line[i]);
                    }
                }
            }
        }
        for (block, out) in sums.chunks_mut(TILE_LANES).enumerate() {
            let (mut x, mut y) = ([0.0; TILE_LANES], [0.0; TILE_LANES]);
            for k in 0..TILE_LANES {
                let node = (block * TILE_LANES + k).min(NODES * NODES - 1);
                x[k] = self.middle.x + self.half * self.tiles.rules.nodes[node % NODES];
                y[k] = self.middle.y + self.half * self.tiles.rules.nodes[node / NODES];
            }
            let mut fresh = [[0.0; TILE_LANES]; SUMS];
            add_sources(self.tiles.kernel, &self.fresh, &x, &y, &mut fresh);
            for (k, out) in out.iter_mut().enumerate() {
                for s in 0..SUMS {
                    out[s] += fresh[s][k];
                }
            }
        }
        sums
    }
}

/// The sums down each column of nodes, times the weight of each line.
#[cfg_attr(not(optimized_for_size), inline(always))]
#[cfg_attr(optimized_for_size, optimize(speed), inline(never))]
fn down_columns<const SUMS: usize, const NODES: usize>(
    nodes: &[[f64; SUMS]],
    weights: &[f64; NODES],
) -> [[f64; SUMS]; NODES] {
    const { assert!(NODES.is_multiple_of(COLUMNS_AT_ONCE)) };
    let mut sums = [[0.0; SUMS]; NODES];
    let fours = sums.as_chunks_mut::<COLUMNS_AT_ONCE>().0;
    for (sums, first) in fours.iter_mut().zip((0..).step_by(COLUMNS_AT_ONCE)) {
        let mut at = *sums;
        for (line, weight) in nodes.chunks_exact(NODES).zip(weights) {
            for (at, node) in at.iter_mut().zip(&line[first..][..COLUMNS_AT_ONCE]) {
                *at = plus(*at, *weight, *node);
            }
        }
        *sums = at;
    }
    sums
}

/// By value: sums in memory that may overlap are not vectorised.
#[inline(always)]
pub(super) fn plus<const N: usize>(mut sum: [f64; N], factor: f64, term: [f64; N]) -> [f64; N] {
    for k in 0..N {
        sum[k] += factor * term[k];
    }
    sum
}

/// Adds the kernel times the factors of each source.
#[cfg_attr(not(optimized_for_size), inline(always))]
#[cfg_attr(optimized_for_size, optimize(speed), inline(never))]
pub(super) fn add_sources<K: RadialKernel, const SUMS: usize>(
    kernel: K,
    sources: &[TileSource<SUMS>],
    x: &[f64; TILE_LANES],
    y: &[f64; TILE_LANES],
    sums: &mut [[f64; TILE_LANES]; SUMS],
) {
    let mut weights = [[1.0; TILE_LANES]; AT_ONCE];
    for sources in sources.chunks(AT_ONCE) {
        for (w, source) in weights.iter_mut().zip(sources) {
            *w = squared_distances(source.p, x, y);
        }
        kernel.weights_from_squares(weights[..sources.len()].as_flattened_mut());
        let (fours, others) = sums.as_chunks_mut::<SUMS_AT_ONCE>();
        for (sums, first) in fours.iter_mut().zip((0..).step_by(SUMS_AT_ONCE)) {
            let mut at = *sums;
            for (w, source) in weights.iter().zip(sources) {
                let factors = &source.factors[first..][..SUMS_AT_ONCE];
                for s in 0..SUMS_AT_ONCE {
                    at[s] = plus(at[s], factors[s], *w);
                }
            }
            *sums = at;
        }
        for (w, source) in weights.iter().zip(sources) {
            for (s, sum) in (SUMS - others.len()..).zip(&mut *others) {
                *sum = plus(*sum, source.factors[s], *w);
            }
        }
    }
}

/// Squared distances, at least the least positive number: so that no kernel gives NaN.
#[inline(always)]
pub(super) fn squared_distances<const LANES: usize>(
    p: Point,
    x: &[f64; LANES],
    y: &[f64; LANES],
) -> [f64; LANES] {
    let mut r2 = [0.0; LANES];
    for k in 0..LANES {
        let (to_x, to_y) = (p.x - x[k], p.y - y[k]);
        let square = to_x * to_x + to_y * to_y;
        // Not `max`, which is not vectorised.
        r2[k] = if square > f64::MIN_POSITIVE {
            square
        } else {
            f64::MIN_POSITIVE
        };
    }
    r2
}

/// Lagrange's polynomials of all nodes at some positions.
#[inline(always)]
fn lagrange<const NODES: usize, const LANES: usize>(
    nodes: &[f64; NODES],
    weights: &[f64; NODES],
    at: &[f64; LANES],
) -> [[f64; LANES]; NODES] {
    let mut polynomials = [[0.0; LANES]; NODES];
    let (mut before, mut after) = ([1.0; LANES], [1.0; LANES]);
    for i in 0..NODES {
        for k in 0..LANES {
            polynomials[i][k] = before[k] * weights[i];
            before[k] *= at[k] - nodes[i];
        }
    }
    for i in (0..NODES).rev() {
        for k in 0..LANES {
            polynomials[i][k] *= after[k];
            after[k] *= at[k] - nodes[i];
        }
    }
    polynomials
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::deform::Falloff;

    /// Chebyshev's nodes.
    const NODES: [f64; 8] = [
        -0.980_785_280_403_230_4,
        -0.831_469_612_302_545_2,
        -0.555_570_233_019_602_2,
        -0.195_090_322_016_128_27,
        0.195_090_322_016_128_27,
        0.555_570_233_019_602_2,
        0.831_469_612_302_545_2,
        0.980_785_280_403_230_4,
    ];

    #[test]
    fn sums_of_weights_are_within_a_hundred_thousandth() {
        // Dense, sparse and all but coincident.
        let spread = |k: u32, scale: f64| {
            let turn = 2.399_963 * f64::from(k);
            let reach = scale * f64::from(k).sqrt();
            Point::new(250.0 + reach * turn.cos(), 200.0 + reach * turn.sin())
        };
        let rings = (0..300).map(|k| spread(k, 1e-7 * (0.06 * f64::from(k)).exp()));
        for sources in [
            (0..900).map(|k| spread(k, 3.0)).collect::<Vec<_>>(),
            (0..300).map(|k| spread(k, 60.0)).collect(),
            rings.collect(),
        ] {
            for (alpha, far) in [(0.3, 3.5), (1.0, 3.5), (1.5, 4.25), (2.0, 5.0)] {
                let falloff = Falloff::new(alpha, false).unwrap();
                let rules = TileRules {
                    nodes: NODES,
                    far,
                    smallest: 4.0,
                    largest: f64::INFINITY,
                    most_near: 40,
                };
                let each = sources.iter().map(|p| TileSource {
                    p: *p,
                    factors: [1.0],
                });
                let tiles = Tiles::new(falloff, each.collect(), rules);
                let places: Vec<Point> = (0..2500_u32)
                    .map(|k| {
                        let (i, j) = (f64::from(k % 50), f64::from(k / 50));
                        Point::new(-700.0 + 37.0 * i, -600.0 + 31.0 * j)
                    })
                    .collect();
                let first = |tile: &Tile<1>, places: &[Point], out: &mut [f64]| {
                    for (place, out) in places.iter().zip(out) {
                        let (x, y) = ([place.x; TILE_LANES], [place.y; TILE_LANES]);
                        *out = tiles.sums(tile, &x, &y)[0][0];
                    }
                };
                let sums = tiles
                    .map(SimdLevel::detect(), &places, &|| false, first)
                    .unwrap();
                for (place, sum) in places.iter().zip(sums) {
                    let mut weights: Vec<f64> =
                        sources.iter().map(|p| (*p - *place).norm2()).collect();
                    falloff.apply_to_squared(&mut weights);
                    let want: f64 = weights.iter().sum();
                    assert!(
                        (sum / want - 1.0).abs() < 1e-5,
                        "{place:?} {alpha}: {sum:e} {want:e}"
                    );
                }
            }
        }
    }

    #[test]
    fn nothing_is_computed_that_nobody_waits_for() {
        let each = (0..100).map(|k| TileSource {
            p: Point::new(f64::from(k), 0.0),
            factors: [1.0],
        });
        let rules = TileRules {
            nodes: NODES,
            far: 3.5,
            smallest: 4.0,
            largest: f64::INFINITY,
            most_near: 40,
        };
        let tiles = Tiles::new(Falloff::new(1.0, false).unwrap(), each.collect(), rules);
        let never = |_: &Tile<1>, _: &[Point], _: &mut [f64]| unreachable!();
        let places = [Point::new(1.0, 2.0)];
        assert!(
            tiles
                .map(SimdLevel::detect(), &places, &|| true, never)
                .is_none()
        );
    }
}
