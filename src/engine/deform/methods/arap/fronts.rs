//! L D L^H of symmetric matrices on the vertices of a lattice (mathematics 10.6): each set of a
//! dissection is a dense front. One thread, no fused operations: the same bits everywhere.

use std::fmt::Debug;
use std::ops::{Add, AddAssign, Mul, Sub};

use super::dissection::{Dissection, Front};
use crate::deform::kernel::{LaneWork, run_at};
use crate::geometry::Vec2;
use crate::level::SimdLevel;

/// Columns of a front between two checks of cancellation: a millisecond or two of the largest.
const COLUMNS_PER_LOOK: usize = 256;
/// Multiplications of an elimination between two checks.
const MULTIPLICATIONS_PER_LOOK: usize = 1 << 20;

/// What a vertex has in a linear system: a number, or a displacement.
pub(super) trait Unknown:
    Copy
    + Default
    + PartialEq
    + Debug
    + Send
    + Sync
    + Add<Output = Self>
    + Sub<Output = Self>
    + AddAssign
    + Mul<f64, Output = Self>
{
}

impl Unknown for f64 {}
impl Unknown for Vec2 {}

/// A factor of unknowns.
pub(super) trait Acts<X> {
    fn act(self, x: X) -> X;
}

impl Acts<Self> for f64 {
    fn act(self, x: Self) -> Self {
        self * x
    }
}

impl Acts<Vec2> for f64 {
    fn act(self, x: Vec2) -> Vec2 {
        x * self
    }
}

impl Acts<Self> for Vec2 {
    fn act(self, x: Self) -> Self {
        self.complex_mul(x)
    }
}

/// An entry of a matrix: real, or complex.
pub(super) trait MatrixEntry: Unknown + Acts<Self> + Acts<Vec2> {
    const ONE: Self;
    fn conj(self) -> Self;
    fn re(self) -> f64;
}

impl MatrixEntry for f64 {
    const ONE: Self = 1.0;
    fn conj(self) -> Self {
        self
    }
    fn re(self) -> f64 {
        self
    }
}

impl MatrixEntry for Vec2 {
    const ONE: Self = Self::new(1.0, 0.0);
    fn conj(self) -> Self {
        Self::new(self.x, -self.y)
    }
    fn re(self) -> f64 {
        self.x
    }
}

/// The factor of a matrix: unit columns below the diagonal, and the diagonal.
#[derive(Debug)]
pub(super) struct Factor<E> {
    /// Of each front, column by column, its own vertices and then those that it reaches.
    values: Vec<E>,
    diagonal: Vec<f64>,
}

/// `target -= sum of columns times factors`, all from an index on. Four columns at once are read
/// with one pass over the target.
#[inline(always)]
fn subtract<E: MatrixEntry>(target: &mut [E], columns: &[E], stride: usize, factors: &[E]) {
    let n = target.len();
    let mut k = 0;
    while k + 4 <= factors.len() {
        let at = |c: usize| &columns[(k + c) * stride..][..n];
        let (a, b, c, d) = (at(0), at(1), at(2), at(3));
        let [fa, fb, fc, fd] = [factors[k], factors[k + 1], factors[k + 2], factors[k + 3]];
        for i in 0..n {
            let one = fa.act(a[i]) + fb.act(b[i]);
            let two = fc.act(c[i]) + fd.act(d[i]);
            target[i] = target[i] - (one + two);
        }
        k += 4;
    }
    for (k, factor) in factors.iter().enumerate().skip(k) {
        let column = &columns[k * stride..][..n];
        for i in 0..n {
            target[i] = target[i] - factor.act(column[i]);
        }
    }
}

impl<E: MatrixEntry> Factor<E> {
    /// Factorises the sum of the elements: `element(k)` is the block of element k, between its
    /// vertices, of which the lower triangle of the ordered matrix is used. Positive definite.
    /// `None` when cancelled.
    pub(super) fn new(
        order: &Dissection,
        elements: &[[u32; 4]],
        element: impl Fn(usize) -> [[E; 4]; 4],
        cancelled: &dyn Fn() -> bool,
    ) -> Option<Self> {
        let mut factor = Self {
            values: vec![E::default(); order.values],
            diagonal: vec![0.0; order.place.len()],
        };
        let mut local = vec![usize::MAX; order.place.len()];
        let mut updates: Vec<Vec<E>> = Vec::new();
        updates.resize_with(order.fronts.len(), Vec::new);
        for (k, front) in order.fronts.iter().enumerate() {
            if cancelled() {
                return None;
            }
            let (own, n) = (front.own.len(), front.len());
            let reached = &order.reached[front.reached.clone()];
            let places = front.own.clone().chain(reached.iter().copied());
            places
                .enumerate()
                .for_each(|(row, place)| local[place] = row);
            let mut dense = vec![E::default(); n * n];
            for k in &order.elements[front.elements.clone()] {
                let rows = elements[*k].map(|v| local[order.place[v as usize]]);
                let block = element(*k);
                for (i, row) in rows.iter().enumerate() {
                    for (j, column) in rows.iter().enumerate() {
                        if row >= column {
                            let at = &mut dense[column * n + row];
                            *at += block[i][j];
                        }
                    }
                }
            }
            // What the halves have left over for the vertices that both reach is added here: so
            // each front is dense and small, and no sparse matrix is ever stored.
            for child in front.children.into_iter().flatten() {
                let update = std::mem::take(&mut updates[child]);
                let rows = &order.reached[order.fronts[child].reached.clone()];
                for (j, column) in rows.iter().enumerate() {
                    look(j, cancelled)?;
                    let to = &mut dense[local[*column] * n..][..n];
                    for (i, row) in rows.iter().enumerate().skip(j) {
                        let at = &mut to[local[*row]];
                        *at += update[j * rows.len() + i];
                    }
                }
            }
            let values = &mut factor.values[front.values..][..own * n];
            let diagonal = &mut factor.diagonal[front.own.clone()];
            eliminate(&mut dense, n, own, diagonal, cancelled)?;
            values.copy_from_slice(&dense[..own * n]);
            let left = n - own;
            let mut update = Vec::with_capacity(left * left);
            for column in own..n {
                look(column - own, cancelled)?;
                update.extend(&dense[column * n + own..(column + 1) * n]);
            }
            updates[k] = update;
        }
        Some(factor)
    }

    /// Solves in place; `x` by vertex. `None` when cancelled, which is checked for each front.
    pub(super) fn solve<X: Unknown>(
        &self,
        order: &Dissection,
        x: &mut [X],
        work: &mut SolveSpace<X>,
        cancelled: &dyn Fn() -> bool,
    ) -> Option<()>
    where
        E: Acts<X>,
    {
        let solution = Solution {
            factor: self,
            order,
            x,
            work,
            cancelled,
        };
        run_at(SimdLevel::detect(), solution)
    }
}

/// The arguments of [`Factor::solve`].
struct Solution<'a, E, X> {
    factor: &'a Factor<E>,
    order: &'a Dissection,
    x: &'a mut [X],
    work: &'a mut SolveSpace<X>,
    cancelled: &'a dyn Fn() -> bool,
}

impl<E: MatrixEntry + Acts<X>, X: Unknown> LaneWork for Solution<'_, E, X> {
    type Output = Option<()>;

    #[inline(always)]
    fn run(self) -> Option<()> {
        let Self {
            factor,
            order,
            x,
            work,
            cancelled,
        } = self;
        let ordered = &mut work.ordered;
        ordered.clear();
        ordered.resize(x.len(), X::default());
        for (value, place) in x.iter().zip(&order.place) {
            ordered[*place] = *value;
        }
        for front in &order.fronts {
            if cancelled() {
                return None;
            }
            // A force on one anchor reaches few fronts on its way to the last one.
            if ordered[front.own.clone()]
                .iter()
                .all(|x| *x == X::default())
            {
                continue;
            }
            let local = gather(order, front, ordered, &mut work.local, false);
            let (own, n) = (front.own.len(), front.len());
            let columns = &factor.values[front.values..][..own * n];
            forwards(columns, local, cancelled)?;
            ordered[front.own.clone()].copy_from_slice(&local[..own]);
            for (place, value) in order.reached[front.reached.clone()]
                .iter()
                .zip(&local[own..])
            {
                ordered[*place] += *value;
            }
        }
        for (value, pivot) in ordered.iter_mut().zip(&factor.diagonal) {
            *value = *value * (1.0 / pivot);
        }
        for front in order.fronts.iter().rev() {
            if cancelled() {
                return None;
            }
            let local = gather(order, front, ordered, &mut work.local, true);
            let (own, n) = (front.own.len(), front.len());
            for j in (0..own).rev() {
                look(j, cancelled)?;
                let column = &factor.values[front.values + j * n + j + 1..][..n - j - 1];
                local[j] = local[j] - dot(column, &local[j + 1..]);
            }
            ordered[front.own.clone()].copy_from_slice(&local[..own]);
        }
        for (value, place) in x.iter_mut().zip(&order.place) {
            *value = ordered[*place];
        }
        Some(())
    }
}

/// The values of a front; those that it reaches are 0 unless they are known.
#[inline(always)]
fn gather<'a, X: Unknown>(
    order: &Dissection,
    front: &Front,
    ordered: &[X],
    local: &'a mut Vec<X>,
    is_known: bool,
) -> &'a mut [X] {
    local.clear();
    local.extend_from_slice(&ordered[front.own.clone()]);
    let reached = &order.reached[front.reached.clone()];
    if is_known {
        local.extend(reached.iter().map(|place| ordered[*place]));
    } else {
        local.resize(front.len(), X::default());
    }
    local
}

/// Memory that solving needs for a while.
#[derive(Debug, Default)]
pub(super) struct SolveSpace<X> {
    ordered: Vec<X>,
    local: Vec<X>,
}

/// Subtracts what the unknowns of a front's columns make of the later ones, `local`. Four columns
/// at once are read with one pass over these. `None` when cancelled.
#[inline(always)]
fn forwards<E: MatrixEntry + Acts<X>, X: Unknown>(
    columns: &[E],
    local: &mut [X],
    cancelled: &dyn Fn() -> bool,
) -> Option<()> {
    let n = local.len();
    let mut four = columns.chunks_exact(4 * n);
    let mut j = 0;
    for columns in &mut four {
        look(j + 3, cancelled)?;
        let (head, tail) = local[j..].split_at_mut(4);
        let column = |k: usize| &columns[k * n + j..(k + 1) * n];
        for k in 0..3 {
            for row in k + 1..4 {
                head[row] = head[row] - column(k)[row].act(head[k]);
            }
        }
        let of = |k: usize| &column(k)[4..][..tail.len()];
        let (a, b, c, d) = (of(0), of(1), of(2), of(3));
        for i in 0..tail.len() {
            let to = tail[i] - a[i].act(head[0]) - b[i].act(head[1]);
            tail[i] = to - c[i].act(head[2]) - d[i].act(head[3]);
        }
        j += 4;
    }
    for column in four.remainder().chunks_exact(n) {
        let (head, tail) = local.split_at_mut(j + 1);
        for (to, entry) in tail.iter_mut().zip(&column[j + 1..]) {
            *to = *to - entry.act(head[j]);
        }
        j += 1;
    }
    Some(())
}

/// `sum conj(column) x`, in four sums.
#[inline(always)]
fn dot<E: MatrixEntry + Acts<X>, X: Unknown>(column: &[E], x: &[X]) -> X {
    let mut sums = [X::default(); 4];
    let (columns, values) = (column.as_chunks::<4>(), x.as_chunks::<4>());
    for (column, x) in columns.0.iter().zip(values.0) {
        for k in 0..4 {
            sums[k] += column[k].conj().act(x[k]);
        }
    }
    for (column, x) in columns.1.iter().zip(values.1) {
        sums[0] += column.conj().act(*x);
    }
    (sums[0] + sums[1]) + (sums[2] + sums[3])
}

/// `None` when cancelled, which is checked for some columns of a front.
fn look(column: usize, cancelled: &dyn Fn() -> bool) -> Option<()> {
    let is_due = column % COLUMNS_PER_LOOK == COLUMNS_PER_LOOK - 1;
    (!(is_due && cancelled())).then_some(())
}

/// Eliminates the first `own` of `n` columns of a dense matrix, of which the lower triangle is
/// given, column by column. Shapes: `dense: [n][n]`. `None` when cancelled.
pub(super) fn eliminate<E: MatrixEntry>(
    dense: &mut [E],
    n: usize,
    own: usize,
    diagonal: &mut [f64],
    cancelled: &dyn Fn() -> bool,
) -> Option<()> {
    let elimination = Elimination {
        dense,
        n,
        own,
        diagonal,
        cancelled,
    };
    run_at(SimdLevel::detect(), elimination)
}

/// The arguments of [`eliminate`].
struct Elimination<'a, E> {
    dense: &'a mut [E],
    n: usize,
    own: usize,
    diagonal: &'a mut [f64],
    cancelled: &'a dyn Fn() -> bool,
}

impl<E: MatrixEntry> LaneWork for Elimination<'_, E> {
    type Output = Option<()>;

    #[inline(always)]
    fn run(self) -> Option<()> {
        let Self {
            dense,
            n,
            own,
            diagonal,
            cancelled,
        } = self;
        let mut factors = Vec::with_capacity(own);
        let mut since = 0;
        for column in 0..n {
            if column.is_multiple_of(4) || since >= MULTIPLICATIONS_PER_LOOK {
                since = 0;
                if cancelled() {
                    return None;
                }
            }
            let (before, rest) = dense.split_at_mut(column * n);
            factors.clear();
            let eliminated = own.min(column);
            since += eliminated * (n - column);
            let of = |k: usize| before[k * n + column].conj() * diagonal[k];
            factors.extend((0..eliminated).map(of));
            let target = &mut rest[column..n];
            if eliminated > 0 {
                subtract(target, &before[column..], n, &factors);
            }
            if column < own {
                let pivot = target[0].re();
                diagonal[column] = pivot;
                let per = 1.0 / pivot;
                target[1..]
                    .iter_mut()
                    .for_each(|value| *value = *value * per);
            }
        }
        Some(())
    }
}
