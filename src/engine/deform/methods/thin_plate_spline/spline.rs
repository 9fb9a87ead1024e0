//! The thin-plate spline of a set of points (Bookstein 1989; mathematics 10.1): of all maps through
//! the posed handles the one that bends least; with smoothing, a compromise. Points that coincide
//! are one site. `U(r) = r^2 ln r^2` in coordinates whose origin is the mean of the sites, and
//! whose unit is their root mean square distance from it.
//!
//! Two forms of the same map: coefficients of every position, `f = v + sum C_j d_j`, O(n^2) for a
//! position, which a plan keeps; and weights of every pose, `f = v + A(v) + sum w_j U(|v - p_j|)`,
//! O(n) for a position.

#![expect(
    clippy::needless_range_loop,
    reason = "loops over lanes are written alike, whatever they index"
)]

use crate::parallel::prelude::*;

use super::system::{MAX_POLYNOMIALS, TpsSystem};
use crate::deform::IsCancelled;
use crate::deform::columns::PointSource;
use crate::deform::kernel::{LaneWork, run_at};
use crate::deform::lanes::{Coefficients, Vertices};
use crate::geometry::lane_math::ln;
use crate::geometry::{Point, Vec2};
use crate::level::SimdLevel;

/// Within this share of the sites' unit v lies on a handle.
pub(super) const SNAP_SHARE: f64 = 1e-12;

/// A spline without its pose.
#[derive(Debug)]
pub(super) struct Spline {
    frame: SplineFrame,
    sites: Sites,
    /// Sites in the frame.
    x: Vec<f64>,
    y: Vec<f64>,
    system: TpsSystem,
    /// Sites on a line bend in x only; the polynomials are complex-linear, so that similarities are
    /// reproduced.
    is_complex: bool,
    /// Whether f takes the handles to their targets: no smoothing.
    interpolates: bool,
}

/// The distinct positions of points, px.
#[derive(Debug)]
pub(super) struct Sites {
    pub(super) positions: Vec<Point>,
    /// The sum of the weights of its points.
    weights: Vec<f64>,
    /// Of every point: its site, its share of the site's weight, its column.
    members: Vec<(usize, f64, usize)>,
}

/// `((v - origin) conj(tau)) / unit`.
#[derive(Clone, Copy, Debug)]
struct SplineFrame {
    origin: Point,
    tau: Vec2,
    unit: f64,
}

/// A spline with its pose, px.
#[derive(Debug)]
pub(super) struct PosedSpline<'a> {
    spline: &'a Spline,
    /// The mean displacement of every site.
    pub(super) displacements: Vec<[f64; 2]>,
    /// w.
    pub(super) weights: Vec<[f64; 2]>,
    /// A: of 1, x, y.
    pub(super) polynomials: [[f64; 2]; MAX_POLYNOMIALS],
}

impl Sites {
    /// Points nearer than `within` are one site, at the weighted mean of their positions: the means
    /// of groups of handles may coincide.
    pub(super) fn of(points: &[PointSource], within: f64) -> Self {
        let mut first: Vec<Point> = Vec::new();
        let (mut moved, mut weights) = (Vec::new(), Vec::new());
        let mut members = Vec::with_capacity(points.len());
        for PointSource { p, mass, column } in points {
            let site = first
                // Compared with the first position of each site, in the order of the client.
                // Quadratic, for at most as many points as a spline may have.
                .iter()
                .position(|other| (*p - *other).norm2() <= within * within)
                .unwrap_or_else(|| {
                    first.push(*p);
                    moved.push(Vec2::ZERO);
                    weights.push(0.0);
                    first.len() - 1
                });
            // The mean as a correction of the first position: for a single point it is that
            // position to the last bit, as interpolation requires.
            moved[site] += (*p - first[site]) * *mass;
            weights[site] += mass;
            members.push((site, *mass, *column));
        }
        members
            .iter_mut()
            .for_each(|(site, share, _)| *share /= weights[*site]);
        let positions = first
            .iter()
            .zip(&moved)
            .zip(&weights)
            .map(|((p, moved), weight)| *p + *moved * (1.0 / weight))
            .collect();
        Self {
            positions,
            weights,
            members,
        }
    }
}

impl SplineFrame {
    /// `line`: the sites lie on one, which becomes the x axis.
    #[expect(
        clippy::cast_precision_loss,
        reason = "a count of sites is far below 2^53"
    )]
    fn of(sites: &[Point], line: bool) -> Self {
        let (first, count) = (sites[0], sites.len() as f64);
        let origin =
            first + sites.iter().fold(Vec2::ZERO, |sum, p| sum + (*p - first)) * (1.0 / count);
        // The root mean square distance from the centre: the kernel r^2 log r is of order 1 there,
        // and so is the condition of the system (mathematics 10.1).
        let unit = (sites.iter().map(|p| (*p - origin).norm2()).sum::<f64>() / count).sqrt();
        let farthest = sites
            .iter()
            .map(|p| *p - origin)
            .fold(
                Vec2::ZERO,
                |far, d| if d.norm2() > far.norm2() { d } else { far },
            );
        // On a line only the direction matters: y is then 0 at every site, and the polynomial y
        // would be dependent.
        let tau = if line {
            farthest * (1.0 / farthest.norm())
        } else {
            Vec2::new(1.0, 0.0)
        };
        Self { origin, tau, unit }
    }

    #[inline(always)]
    fn take<const N: usize>(&self, v: &Vertices<N>) -> [[f64; N]; 2] {
        let Self { origin, tau, unit } = *self;
        let mut at = [[0.0; N]; 2];
        for k in 0..N {
            let (x, y) = (v.x[k] - origin.x, v.y[k] - origin.y);
            (at[0][k], at[1][k]) = (
                (x * tau.x + y * tau.y) / unit,
                (y * tau.x - x * tau.y) / unit,
            );
        }
        at
    }
}

impl Spline {
    /// Bytes of a spline of n sites, and what is needed to compute it.
    pub(super) const fn bytes(n: u64) -> u64 {
        TpsSystem::bytes(n)
    }

    /// At least two sites. `line`: they lie on one. O(n^3); `None` when cancelled.
    pub(super) fn new(
        sites: Sites,
        line: bool,
        smoothing: f64,
        cancelled: IsCancelled<'_>,
    ) -> Option<Self> {
        let frame = SplineFrame::of(&sites.positions, line);
        Self::in_frame(frame, sites, line, smoothing, cancelled)
    }

    /// A spline with some sites of another one, in the same unit.
    pub(super) fn of_part(
        &self,
        sites: Sites,
        line: bool,
        smoothing: f64,
        cancelled: IsCancelled<'_>,
    ) -> Option<Self> {
        let frame = SplineFrame {
            // The smoothing has the unit of the kernel: another unit would make it another
            // smoothing.
            unit: self.frame.unit,
            ..SplineFrame::of(&sites.positions, line)
        };
        Self::in_frame(frame, sites, line, smoothing, cancelled)
    }

    fn in_frame(
        frame: SplineFrame,
        sites: Sites,
        line: bool,
        smoothing: f64,
        cancelled: IsCancelled<'_>,
    ) -> Option<Self> {
        let (x, y): (Vec<f64>, Vec<f64>) = sites
            .positions
            .iter()
            .map(|p| {
                let [[x], [y]] = frame.take(&Vertices::<1>::all(*p));
                (x, if line { 0.0 } else { y })
            })
            .unzip();
        let mut polynomials = vec![vec![1.0; x.len()], x.clone()];
        if !line {
            polynomials.push(y.clone());
        }
        let kernel = |i: usize, j: usize| {
            bending((x[i] - x[j]) * (x[i] - x[j]) + (y[i] - y[j]) * (y[i] - y[j]))
        };
        // A handle of twice the weight may be missed by half as much.
        let noise: Vec<f64> = sites
            .weights
            .iter()
            .map(|weight| smoothing / weight)
            .collect();
        let system = TpsSystem::new(kernel, &noise, polynomials, cancelled)?;
        Some(Self {
            frame,
            sites,
            x,
            y,
            system,
            is_complex: line,
            interpolates: smoothing == 0.0,
        })
    }

    /// Position and column of every point, with its site.
    pub(super) fn members(&self) -> impl Iterator<Item = (usize, usize)> + '_ {
        self.sites
            .members
            .iter()
            .map(|(site, _, column)| (*column, *site))
    }

    /// The displacement of each site less the one that the spline of all other sites predicts
    /// there, px (mathematics 10.4): `w_i / (Lm^-1)_ii`, not finite where the others determine
    /// fewer polynomials. Parallel; O(n^3); `None` when cancelled.
    pub(super) fn left_out(&self, d: &[Vec2], cancelled: IsCancelled<'_>) -> Option<Vec<Vec2>> {
        let weights = self.posed(d).weights;
        let residual = |(site, w): (usize, &[f64; 2])| {
            if cancelled() {
                return None;
            }
            // The residual of leaving one out is w_i / (Lm^-1)_ii (mathematics 10.4): no system is
            // solved again.
            let diagonal = self.system.inverse_diagonal(site);
            Some(Vec2::new(w[0] / diagonal, w[1] / diagonal))
        };
        weights.par_iter().enumerate().map(residual).collect()
    }

    /// The number of distinct positions.
    pub(super) fn len(&self) -> usize {
        self.x.len()
    }

    /// The squared distances of N vertices from a site.
    #[inline(always)]
    fn r2<const N: usize>(&self, site: usize, at: &[[f64; N]; 2]) -> [f64; N] {
        let mut r2 = [0.0; N];
        for k in 0..N {
            let (x, y) = (at[0][k] - self.x[site], at[1][k] - self.y[site]);
            r2[k] = x * x + y * y;
        }
        r2
    }

    /// The site on which each vertex lies. Only a spline without smoothing has values of its own
    /// there: rounding must not move a handle.
    #[inline(always)]
    fn hits<const N: usize>(&self, at: &[[f64; N]; 2]) -> [Option<usize>; N] {
        let mut hits = [None; N];
        for site in 0..if self.interpolates { self.len() } else { 0 } {
            let r2 = self.r2(site, at);
            for k in 0..N {
                if r2[k] <= SNAP_SHARE * SNAP_SHARE {
                    hits[k] = Some(site);
                }
            }
        }
        hits
    }

    /// The coefficients of N vertices. `scratch` is for two right sides.
    pub(super) fn rows<const N: usize>(
        &self,
        v: &Vertices<N>,
        scratch: &mut Vec<[f64; N]>,
        rows: &mut Coefficients<N>,
    ) {
        let (n, at) = (self.len(), self.frame.take(v));
        scratch.clear();
        scratch.resize(2 * n, [0.0; N]);
        let (re, im) = scratch.split_at_mut(n);
        for (site, u) in re.iter_mut().enumerate() {
            // The right side of the row: the kernel towards each site, and the polynomials at v.
            // The solution is the row of coefficients.
            *u = self.r2(site, &at).map(bending);
        }
        self.system.coefficients(re, &[[1.0; N], at[0], at[1]]);
        if self.is_complex {
            // All on one line: the similarity across it is a complex number times the position,
            // whose imaginary part has a right side of its own.
            self.system.coefficients(im, &[[0.0; N], at[1], [0.0; N]]);
        }
        // On a site its own row, without the rounding of a solved system: f(p) = q to the last bit.
        for (k, site) in self.hits(&at).into_iter().enumerate() {
            if let Some(site) = site {
                re.iter_mut()
                    .zip(im.iter_mut())
                    .for_each(|(re, im)| (re[k], im[k]) = (0.0, 0.0));
                re[site][k] = 1.0;
            }
        }
        for (site, share, column) in &self.sites.members {
            rows.h[*column] = [re[*site].map(|c| c * share), im[*site].map(|c| c * share)];
        }
    }

    /// The spline of a pose: one solution for all positions. `d`: displacements of the columns, px.
    pub(super) fn posed(&self, d: &[Vec2]) -> PosedSpline<'_> {
        let mut displacements = vec![[0.0; 2]; self.len()];
        for (site, share, column) in &self.sites.members {
            let (Vec2 { x, y }, sum) = (d[*column], &mut displacements[*site]);
            (sum[0], sum[1]) = (sum[0] + share * x, sum[1] + share * y);
        }
        let mut weights = displacements.clone();
        let mut polynomials = self.system.weights(&mut weights);
        if self.is_complex {
            let [re, im] = polynomials[1];
            // The coefficient of y follows from that of x: a similarity, because the line says
            // nothing of the direction across.
            polynomials[2] = [-im, re];
        }
        PosedSpline {
            spline: self,
            displacements,
            weights,
            polynomials,
        }
    }
}

impl PosedSpline<'_> {
    /// A position in the frame of the sites.
    pub(super) fn in_frame(&self, place: Point) -> Point {
        let [[x], [y]] = self.spline.frame.take(&Vertices::<1>::all(place));
        Point::new(x, y)
    }

    /// The sites in their frame.
    pub(super) fn sites(&self) -> impl Iterator<Item = Point> {
        let each = self.spline.x.iter().zip(&self.spline.y);
        each.map(|(x, y)| Point::new(*x, *y))
    }

    /// px in a unit of the frame.
    pub(super) fn unit(&self) -> f64 {
        self.spline.frame.unit
    }

    /// Whether f takes the handles to their targets.
    pub(super) fn interpolates(&self) -> bool {
        self.spline.interpolates
    }

    /// `f(v) - v` of N vertices, px.
    pub(super) fn displaced_lanes<const N: usize>(&self, v: &Vertices<N>) -> [[f64; N]; 2] {
        run_at(SimdLevel::detect(), SplineLanes { posed: self, v })
    }

    #[inline(always)]
    fn displaced_inline<const N: usize>(&self, v: &Vertices<N>) -> [[f64; N]; 2] {
        let at = self.spline.frame.take(v);
        let [a, ax, ay] = self.polynomials;
        let mut moved = [[0.0; N]; 2];
        for k in 0..N {
            for axis in 0..2 {
                moved[axis][k] = a[axis] + ax[axis] * at[0][k] + ay[axis] * at[1][k];
            }
        }
        for (site, w) in self.weights.iter().enumerate() {
            let mut u = self.spline.r2(site, &at);
            for k in 0..N {
                u[k] = bending(u[k]);
            }
            for k in 0..N {
                moved[0][k] += w[0] * u[k];
                moved[1][k] += w[1] * u[k];
            }
        }
        for (k, site) in self.spline.hits(&at).into_iter().enumerate() {
            if let Some(site) = site {
                [moved[0][k], moved[1][k]] = self.displacements[site];
            }
        }
        moved
    }
}

/// The displacements of N vertices.
struct SplineLanes<'a, const N: usize> {
    posed: &'a PosedSpline<'a>,
    v: &'a Vertices<N>,
}

impl<const N: usize> LaneWork for SplineLanes<'_, N> {
    type Output = [[f64; N]; 2];

    #[inline(always)]
    fn run(self) -> Self::Output {
        self.posed.displaced_inline(self.v)
    }
}

/// U of a squared distance.
#[inline(always)]
fn bending(r2: f64) -> f64 {
    r2 * ln(r2)
}
