//! The linear system of a spline (mathematics 10.1): `[[K + N, P], [P^T, 0]]`, a symmetric kernel
//! K, the diagonal noise N of the smoothing, and 2 or 3 polynomials P. K is positive definite on
//! the vectors that are orthogonal to P. So a QR of P by reflections leaves a positive definite
//! block, and a Cholesky factor of it needs no pivots: half the work of a symmetric indefinite or
//! LU factorisation of the whole, a packed triangle of memory, and no failure. Linear algebra
//! crates bring many crates for what are few lines here.
//!
//! Everything is scaled by `S = (1 + N)^(-1/2)` on both sides, so that no amount of noise drowns
//! the kernel.

use crate::deform::IsCancelled;

/// Polynomials, at most: 1, x, y.
pub(super) const MAX_POLYNOMIALS: usize = 3;
/// Rows of the factor that are computed together, so that an earlier row is read once for all of
/// them.
const PANEL_ROWS: usize = 8;

/// A reflection `1 - beta v v^T`.
#[derive(Debug)]
struct Reflection {
    v: Vec<f64>,
    beta: f64,
}

/// The factorised system of n unknowns. Shapes: `[n]` and a packed triangle of n rows.
#[derive(Debug)]
pub(super) struct TpsSystem {
    /// S.
    scale: Vec<f64>,
    /// Q of `S P = Q [R; 0]`, in the order in which Q^T applies them; one per polynomial.
    reflections: Vec<Reflection>,
    r: [[f64; MAX_POLYNOMIALS]; MAX_POLYNOMIALS],
    /// `Q^T S (K + N) S Q`: below the rows of the polynomials their columns, and beyond their
    /// columns the Cholesky factor.
    factor: Triangle,
}

/// The lower triangle of a square matrix, row by row.
#[derive(Debug)]
struct Triangle(Vec<f64>);

const fn start(row: usize) -> usize {
    row * (row + 1) / 2
}

impl Triangle {
    fn row(&self, row: usize) -> &[f64] {
        &self.0[start(row)..start(row + 1)]
    }

    /// The product with a vector.
    fn times(&self, v: &[f64]) -> Vec<f64> {
        let mut product = vec![0.0; v.len()];
        for i in 0..v.len() {
            let (below, own) = self.row(i).split_at(i);
            product[i] += dot(below, v) + own[0] * v[i];
            for (product, t) in product.iter_mut().zip(below) {
                *product += t * v[i];
            }
        }
        product
    }

    /// `H T H` of a reflection H.
    fn reflect(&mut self, Reflection { v, beta }: &Reflection) {
        let mut q = self.times(v);
        q.iter_mut().for_each(|q| *q *= beta);
        // H T H as a symmetric update of rank two: half of the work of two products, and the
        // triangle stays a triangle.
        let half = 0.5 * beta * dot(&q, v);
        q.iter_mut().zip(v).for_each(|(q, v)| *q -= half * v);
        for i in 0..v.len() {
            for ((t, qj), vj) in self.0[start(i)..start(i + 1)].iter_mut().zip(&q).zip(v) {
                *t -= v[i] * qj + q[i] * vj;
            }
        }
    }

    /// Replaces the block beyond the first `head` rows and columns by its Cholesky factor. A pivot
    /// that rounding has taken is replaced by the smallest one that could be told from 0: the
    /// system then belongs to a kernel that differs by rounding.
    fn factorise(&mut self, rows: usize, head: usize, cancelled: IsCancelled<'_>) -> Option<()> {
        let largest = self
            .0
            .iter()
            .fold(f64::MIN_POSITIVE, |largest, entry| largest.max(entry.abs()));
        // Exact pivots are positive; rounding may leave 0 or less where sites nearly coincide.
        let least = (f64::EPSILON * largest).max(f64::MIN_POSITIVE);
        for first in (head..rows).step_by(PANEL_ROWS) {
            if cancelled() {
                return None;
            }
            let (done, panel) = self.0.split_at_mut(start(first));
            let last = rows.min(first + PANEL_ROWS);
            // The rows before the panel are read once for all of its rows: this is where the time
            // of a large system goes.
            for j in head..first {
                let (above, pivot) = done[start(j) + head..start(j + 1)].split_at(j - head);
                for i in first..last {
                    let row = &mut panel[start(i) - start(first)..];
                    row[j] = (row[j] - dot(&row[head..j], above)) / pivot[0];
                }
            }
            for i in first..last {
                let (done, row) = panel.split_at_mut(start(i) - start(first));
                for j in first..i {
                    let (above, pivot) =
                        done[start(j) - start(first) + head..][..=j - head].split_at(j - head);
                    row[j] = (row[j] - dot(&row[head..j], above)) / pivot[0];
                }
                row[i] = (row[i] - dot(&row[head..i], &row[head..i]))
                    .max(least)
                    .sqrt();
            }
        }
        Some(())
    }
}

impl TpsSystem {
    /// Bytes of the factor of n unknowns.
    pub(super) const fn bytes(n: u64) -> u64 {
        n * (n + 1) / 2 * size_of::<f64>() as u64
    }

    /// `noise`: N. `polynomials`: the columns of P, independent. O(n^3) / 6 multiplications; `None`
    /// when cancelled.
    pub(super) fn new(
        kernel: impl Fn(usize, usize) -> f64,
        noise: &[f64],
        mut polynomials: Vec<Vec<f64>>,
        cancelled: IsCancelled<'_>,
    ) -> Option<Self> {
        let n = noise.len();
        // With a noise of 1e9 the kernel would vanish beside the diagonal; scaled, every diagonal
        // entry is at most 1.
        let scale: Vec<f64> = noise
            .iter()
            .map(|noise| (1.0 + noise).sqrt().recip())
            .collect();
        for column in &mut polynomials {
            column.iter_mut().zip(&scale).for_each(|(p, s)| *p *= s);
        }
        let (reflections, r) = reflections(polynomials);
        let mut factor = Vec::with_capacity(start(n));
        for i in 0..n {
            if cancelled() {
                return None;
            }
            factor.extend((0..i).map(|j| scale[i] * scale[j] * kernel(i, j)));
            // The kernel is 0 at distance 0, so the diagonal is the noise alone.
            factor.push(noise[i] / (1.0 + noise[i]));
        }
        let mut factor = Triangle(factor);
        for reflection in &reflections {
            factor.reflect(reflection);
        }
        factor.factorise(n, reflections.len(), cancelled)?;
        Some(Self {
            scale,
            reflections,
            r,
            factor,
        })
    }

    /// The first n entries of the solution with the right side `(u, m)` for N right sides: `u`
    /// becomes them.
    pub(super) fn coefficients<const N: usize>(
        &self,
        u: &mut [[f64; N]],
        m: &[[f64; N]; MAX_POLYNOMIALS],
    ) {
        self.scaled(u);
        self.reflections
            .iter()
            .for_each(|reflection| reflect(reflection, u));
        let head = self.reflections.len();
        // The head solves P^T c = m, a triangle; what it says of c is subtracted from the rest
        // before the block beyond is solved.
        let mut y = [[0.0; N]; MAX_POLYNOMIALS];
        for c in 0..head {
            y[c] = m[c];
            for above in 0..c {
                let known = y[above];
                subtract(&mut y[c], self.r[above][c], &known);
            }
            y[c].iter_mut().for_each(|y| *y /= self.r[c][c]);
        }
        for (i, u) in u.iter_mut().enumerate().skip(head) {
            for (t, y) in self.factor.row(i)[..head].iter().zip(&y) {
                subtract(u, *t, y);
            }
        }
        self.solve(u);
        u[..head].copy_from_slice(&y[..head]);
        self.reflections
            .iter()
            .rev()
            .for_each(|reflection| reflect(reflection, u));
        self.scaled(u);
    }

    /// The solution with the right side `(d, 0)` for N right sides: `d` becomes its first n
    /// entries, the weights of the kernel; returns the others, the coefficients of the polynomials.
    pub(super) fn weights<const N: usize>(
        &self,
        d: &mut [[f64; N]],
    ) -> [[f64; N]; MAX_POLYNOMIALS] {
        self.scaled(d);
        self.reflections
            .iter()
            .for_each(|reflection| reflect(reflection, d));
        self.solve(d);
        let head = self.reflections.len();
        let mut a = [[0.0; N]; MAX_POLYNOMIALS];
        a[..head].copy_from_slice(&d[..head]);
        for (i, d) in d.iter().enumerate().skip(head) {
            for (t, a) in self.factor.row(i)[..head].iter().zip(&mut a) {
                subtract(a, *t, d);
            }
        }
        for c in (0..head).rev() {
            for beyond in c + 1..head {
                let known = a[beyond];
                subtract(&mut a[c], self.r[c][beyond], &known);
            }
            a[c].iter_mut().for_each(|a| *a /= self.r[c][c]);
        }
        d[..head].fill([0.0; N]);
        self.reflections
            .iter()
            .rev()
            .for_each(|reflection| reflect(reflection, d));
        self.scaled(d);
        a
    }

    /// The diagonal entry i of the inverse of the whole system, i < n: the squared length of `L^-1`
    /// times what Q^T S leaves of the i-th unit vector beyond the polynomials. O(n^2).
    pub(super) fn inverse_diagonal(&self, i: usize) -> f64 {
        let mut x = vec![[0.0]; self.scale.len()];
        x[i] = [1.0];
        self.scaled(&mut x);
        self.reflections
            .iter()
            .for_each(|reflection| reflect(reflection, &mut x));
        let head = self.reflections.len();
        let mut solved: Vec<f64> = x.into_iter().map(|[x]| x).collect();
        for i in head..solved.len() {
            let row = self.factor.row(i);
            solved[i] = (solved[i] - dot(&row[head..i], &solved[head..i])) / row[i];
        }
        dot(&solved[head..], &solved[head..])
    }

    fn scaled<const N: usize>(&self, x: &mut [[f64; N]]) {
        for (x, scale) in x.iter_mut().zip(&self.scale) {
            x.iter_mut().for_each(|x| *x *= scale);
        }
    }

    /// Solves the positive definite block by its factor.
    fn solve<const N: usize>(&self, x: &mut [[f64; N]]) {
        let head = self.reflections.len();
        for i in head..x.len() {
            let (done, rest) = x.split_at_mut(i);
            let row = self.factor.row(i);
            for (t, done) in row[head..].iter().zip(&done[head..]) {
                subtract(&mut rest[0], *t, done);
            }
            rest[0].iter_mut().for_each(|x| *x /= row[i]);
        }
        for i in (head..x.len()).rev() {
            let (above, rest) = x.split_at_mut(i);
            let row = self.factor.row(i);
            rest[0].iter_mut().for_each(|x| *x /= row[i]);
            for (t, above) in row[head..].iter().zip(&mut above[head..]) {
                subtract(above, *t, &rest[0]);
            }
        }
    }
}

/// The QR of a few columns.
fn reflections(
    mut columns: Vec<Vec<f64>>,
) -> (Vec<Reflection>, [[f64; MAX_POLYNOMIALS]; MAX_POLYNOMIALS]) {
    let (mut reflections, mut r) = (
        Vec::with_capacity(columns.len()),
        [[0.0; MAX_POLYNOMIALS]; MAX_POLYNOMIALS],
    );
    for c in 0..columns.len() {
        let (done, rest) = columns.split_at_mut(c + 1);
        let column = &done[c];
        let whole = dot(column, column).sqrt();
        let mut v = column.clone();
        v[..c].fill(0.0);
        let norm = dot(&v, &v).sqrt();
        // Away from the entry, so that their difference does not cancel: Householder's choice of
        // the sign.
        let pivot = if v[c] > 0.0 { -norm } else { norm };
        v[c] -= pivot;
        let norm2 = dot(&v, &v);
        let reflection = Reflection {
            beta: if norm2 > 0.0 { 2.0 / norm2 } else { 0.0 },
            v,
        };
        for column in rest {
            let along = reflection.beta * dot(&reflection.v, column);
            column
                .iter_mut()
                .zip(&reflection.v)
                .for_each(|(x, v)| *x -= along * v);
        }
        for (row, value) in column[..c].iter().enumerate() {
            r[row][c] = *value;
        }
        // Columns are independent; noise that differs by many orders may leave less than rounding.
        r[c][c] = if norm > f64::EPSILON * whole {
            pivot
        } else {
            f64::EPSILON * whole.max(f64::MIN_POSITIVE)
        };
        reflections.push(reflection);
    }
    (reflections, r)
}

fn reflect<const N: usize>(Reflection { v, beta }: &Reflection, x: &mut [[f64; N]]) {
    let mut along = [0.0; N];
    for (x, v) in x.iter().zip(v) {
        subtract(&mut along, -v * beta, x);
    }
    for (x, v) in x.iter_mut().zip(v) {
        subtract(x, *v, &along);
    }
}

/// `x -= t y`.
#[inline(always)]
fn subtract<const N: usize>(x: &mut [f64; N], t: f64, y: &[f64; N]) {
    for k in 0..N {
        x[k] -= t * y[k];
    }
}

/// The inner product over the shorter length, in eight sums, which the compiler vectorises.
fn dot(a: &[f64], b: &[f64]) -> f64 {
    let length = a.len().min(b.len());
    let (a, b) = (a[..length].chunks_exact(8), b[..length].chunks_exact(8));
    let mut sums = [0.0; 8];
    let rest: f64 = a
        .remainder()
        .iter()
        .zip(b.remainder())
        .map(|(a, b)| a * b)
        .sum();
    for (a, b) in a.zip(b) {
        for k in 0..8 {
            sums[k] += a[k] * b[k];
        }
    }
    sums.iter().sum::<f64>() + rest
}
