//! The narrow waist: everything that a vertex v knows of the handles at rest, with no q anywhere (mathematics 7.1).
//! Equations (1) to (8), (12) to (14), anchored at the heaviest handle and ratio first, so that no digit is lost next to a handle, on the
//! extension of a segment, or for large alpha. Cost: O(elements), for segments O(nodes); no allocation once the scratch has grown.

use super::Method;
use super::columns::{Element, Segment};
use super::falloff::{Falloff, Power};
use super::segments::View;
use crate::geometry::{Point, Vec2};

/// Within this share of the set's extent v is on a handle.
const SNAP_SHARE: f64 = 1e-12;
/// The closed form stands for the nodes of a segment that is further away than this share of its length: nearer, its tangential second
/// moment cancels by (L/h)^2.
const CLOSED_FROM: f64 = 1e-3;

/// What one row needs of the set.
#[derive(Clone, Copy, Debug)]
pub(super) struct Waist<'a> {
    pub(super) elements: &'a [Element],
    pub(super) extent: f64,
    pub(super) falloff: Falloff,
    pub(super) method: Method,
    /// Always the quadrature nodes, at their full number.
    pub(super) exact: bool,
}

/// The coefficients of one vertex. Shapes: `[columns]`.
#[derive(Clone, Debug, Default)]
pub(super) struct Row {
    /// Affine: C (its real part). Similarity: C. Rigid: H, 1/px.
    pub(super) h: Vec<Vec2>,
    /// Rigid: the normalised weights.
    pub(super) wn: Vec<f64>,
    /// Rigid: v - p*, px.
    pub(super) e: Vec2,
}

/// A weighted place: a point, or a quadrature node of a segment. First relative to v, then to the anchor in the frame (tau, n).
#[derive(Clone, Copy, Debug)]
struct Mass {
    at: Vec2,
    w: f64,
    column: usize,
    /// Shares of the column and the next; `share_b` is 0 for a point.
    share_a: f64,
    share_b: f64,
    /// Arc length from v's foot, px, for a node.
    u: f64,
    element: usize,
}

/// A segment as two ends with a 2x2 mass matrix.
#[derive(Clone, Copy, Debug)]
struct Block {
    a: Vec2,
    b: Vec2,
    d: [f64; 3],
    column: usize,
    element: usize,
}

/// Reused from row to row.
#[derive(Debug, Default)]
pub(super) struct Scratch {
    masses: Vec<Mass>,
    blocks: Vec<Block>,
    views: Vec<View>,
    totals: Vec<f64>,
}

impl Row {
    pub(super) fn zeroed(columns: usize) -> Self {
        Self { h: vec![Vec2::ZERO; columns], wn: vec![0.0; columns], e: Vec2::ZERO }
    }

    pub(super) fn clear(&mut self) {
        self.h.fill(Vec2::ZERO);
        self.wn.fill(0.0);
        self.e = Vec2::ZERO;
    }
}

impl Waist<'_> {
    /// The row of vertex `v`.
    pub(super) fn row(&self, v: Point, scratch: &mut Scratch, row: &mut Row) {
        row.clear();
        let Some(r2min) = self.look(v, scratch, row) else { return };
        self.weigh(v, r2min, scratch);
        let (tau, at_v) = self.anchor(v, scratch);
        fit(self.method, tau, at_v, scratch, row);
    }

    /// Squared distance of the nearest element; `None` when v is on a handle, whose unit row is then the answer.
    fn look(&self, v: Point, scratch: &mut Scratch, row: &mut Row) -> Option<f64> {
        let snap2 = (SNAP_SHARE * self.extent).powi(2);
        let mut r2min = f64::INFINITY;
        scratch.views.clear();
        for element in self.elements {
            match element {
                Element::Point { p, column, .. } => {
                    let r2 = (*p - v).norm2();
                    if r2 <= snap2 {
                        self.unit(row, *column, 1.0, 0.0);
                        return None;
                    }
                    r2min = r2min.min(r2);
                }
                Element::Segment(s) => {
                    let view = View::new(s, v);
                    if view.r2 <= snap2 {
                        let t = view.nearest();
                        self.unit(row, s.column, 1.0 - t, t);
                        return None;
                    }
                    r2min = r2min.min(view.r2);
                    scratch.views.push(view);
                }
            }
        }
        Some(r2min)
    }

    fn unit(&self, row: &mut Row, column: usize, share_a: f64, share_b: f64) {
        for (column, share) in [(column, share_a), (column + 1, share_b)] {
            if share > 0.0 {
                match self.method {
                    Method::Affine | Method::Similarity => row.h[column].x = share,
                    Method::Rigid => row.wn[column] = share,
                }
            }
        }
    }

    /// Weights relative to the nearest element's, ratio first and power after; `totals`: one an element.
    fn weigh(&self, v: Point, r2min: f64, scratch: &mut Scratch) {
        let Scratch { masses, blocks, views, totals } = scratch;
        masses.clear();
        blocks.clear();
        totals.clear();
        let mut views = views.iter();
        for (element, of) in self.elements.iter().enumerate() {
            match of {
                Element::Point { p, mass, column } => {
                    let at = *p - v;
                    let w = mass * self.falloff.of(r2min / at.norm2());
                    masses.push(Mass { at, w, column: *column, share_a: 1.0, share_b: 0.0, u: 0.0, element });
                    totals.push(w);
                }
                Element::Segment(s) => {
                    let view = views.next().expect("one view a segment");
                    totals.push(self.weigh_segment(s, view, v, r2min, element, masses, blocks));
                }
            }
        }
    }

    #[expect(clippy::too_many_arguments, reason = "the two outputs are separate so that points need no branch")]
    fn weigh_segment(
        &self,
        s: &Segment,
        view: &View,
        v: Point,
        r2min: f64,
        element: usize,
        masses: &mut Vec<Mass>,
        blocks: &mut Vec<Block>,
    ) -> f64 {
        let (a, b) = (s.a - v, s.b - v);
        if !self.exact && self.falloff.power() == Power::Two && view.r2 > (CLOSED_FROM * s.length).powi(2) {
            let d = view.masses_alpha_two(s, v, r2min);
            blocks.push(Block { a, b, d, column: s.column, element });
            return d[0] + 2.0 * d[1] + d[2];
        }
        let mut total = 0.0;
        view.nodes(s, self.falloff, r2min, self.exact, |n| {
            total += n.weight;
            let at = a * n.share_a + b * n.share_b;
            masses.push(Mass { at, w: n.weight, column: s.column, share_a: n.share_a, share_b: n.share_b, u: n.u * s.length, element });
        });
        total
    }

    /// Moves all places from "relative to v" to the anchor's frame; returns the frame's direction and v's place in it.
    fn anchor(&self, v: Point, scratch: &mut Scratch) -> (Vec2, Vec2) {
        let Scratch { masses, blocks, views, totals } = scratch;
        let heaviest = (0..totals.len()).fold(0, |best, i| if totals[i] > totals[best] { i } else { best });
        match &self.elements[heaviest] {
            Element::Segment(s) => {
                let index = self.elements[..heaviest].iter().filter(|e| matches!(e, Element::Segment(_))).count();
                let view = &views[index];
                // Tangential offset of v from the clamped foot, and where the ends lie from it, all exact.
                let (along, a, b) = if view.u1 >= 0.0 {
                    (-view.u1 * s.length, 0.0, s.length)
                } else if view.u2 <= 0.0 {
                    (-view.u2 * s.length, -s.length, 0.0)
                } else {
                    (0.0, view.u1 * s.length, view.u2 * s.length)
                };
                let at_v = Vec2::new(along, view.off);
                let turn = s.tau.conj();
                for m in masses.iter_mut() {
                    m.at = if m.element == heaviest {
                        let x = if view.u1 >= 0.0 {
                            m.share_b * s.length
                        } else if view.u2 <= 0.0 {
                            -m.share_a * s.length
                        } else {
                            m.u
                        };
                        Vec2::new(x, 0.0)
                    } else {
                        m.at.complex_mul(turn) + at_v
                    };
                }
                for block in blocks.iter_mut() {
                    (block.a, block.b) = if block.element == heaviest {
                        (Vec2::new(a, 0.0), Vec2::new(b, 0.0))
                    } else {
                        (block.a.complex_mul(turn) + at_v, block.b.complex_mul(turn) + at_v)
                    };
                }
                (s.tau, at_v)
            }
            Element::Point { p: o, .. } => {
                self.relative_to(*o, masses, blocks);
                let (tau, defining) = frame(masses, blocks, totals);
                let turn = tau.conj();
                for (i, m) in masses.iter_mut().enumerate() {
                    m.at = if Some(i) == defining { Vec2::new(m.at.norm(), 0.0) } else { m.at.complex_mul(turn) };
                }
                for block in blocks.iter_mut() {
                    (block.a, block.b) = (block.a.complex_mul(turn), block.b.complex_mul(turn));
                }
                (tau, (v - *o).complex_mul(turn))
            }
        }
    }

    /// Places relative to the anchor point `o`, formed from the handles themselves: exact where they are whole numbers.
    fn relative_to(&self, o: Point, masses: &mut [Mass], blocks: &mut [Block]) {
        for m in masses {
            m.at = match &self.elements[m.element] {
                Element::Point { p, .. } => *p - o,
                Element::Segment(s) => (s.a - o) * m.share_a + (s.b - o) * m.share_b,
            };
        }
        for block in blocks {
            if let Element::Segment(s) = &self.elements[block.element] {
                (block.a, block.b) = (s.a - o, s.b - o);
            }
        }
    }
}

/// The direction of the place with the largest mass * distance^2, and which mass it is (`None`: the end of a block).
fn frame(masses: &[Mass], blocks: &[Block], totals: &[f64]) -> (Vec2, Option<usize>) {
    let mut best = (0.0, Vec2::new(1.0, 0.0), None);
    for (i, m) in masses.iter().enumerate() {
        let moment = m.w * m.at.norm2();
        if moment > best.0 {
            best = (moment, m.at, Some(i));
        }
    }
    for block in blocks {
        for end in [block.a, block.b] {
            let moment = totals[block.element] * end.norm2();
            if moment > best.0 {
                best = (moment, end, None);
            }
        }
    }
    (best.1 * (1.0 / best.1.norm()), best.2)
}

/// Steps 4 to 6: centroid, second moments, and the rows of the family, rotated back from the frame.
fn fit(method: Method, tau: Vec2, at_v: Vec2, scratch: &mut Scratch, row: &mut Row) {
    let Scratch { masses, blocks, .. } = scratch;
    let mut total = 0.0;
    let mut p_star = Vec2::ZERO;
    for m in masses.iter() {
        total += m.w;
        p_star += m.at * m.w;
    }
    for Block { a, b, d, .. } in blocks.iter() {
        let (ma, mb) = (d[0] + d[1], d[1] + d[2]);
        total += ma + mb;
        p_star += *a * ma + *b * mb;
    }
    p_star = p_star * (1.0 / total);
    let e = at_v - p_star;
    let mut mu = 0.0;
    for m in masses.iter_mut() {
        m.w /= total;
        m.at = m.at - p_star;
        mu += m.w * m.at.norm2();
    }
    for Block { a, b, d, .. } in blocks.iter_mut() {
        (*a, *b) = (*a - p_star, *b - p_star);
        for d in d.iter_mut() {
            *d /= total;
        }
        mu += d[0] * a.norm2() + 2.0 * d[1] * a.dot(*b) + d[2] * b.norm2();
    }
    match method {
        Method::Affine => affine(e, mu, masses, blocks, row),
        Method::Similarity | Method::Rigid => {
            let back = tau.conj();
            let mut put = |column: usize, g_hat: Vec2, wn: f64| {
                // H = g conj(p^) in the frame; C = wn + e H needs no rotation, H and e rotate back by conj(tau) and tau.
                let h = g_hat.conj();
                if method == Method::Similarity {
                    row.h[column] += Vec2::new(wn, 0.0) + e.complex_mul(h);
                } else {
                    row.h[column] += h.complex_mul(back);
                    row.wn[column] += wn;
                }
            };
            for m in masses.iter() {
                let g_hat = m.at * (m.w / mu);
                put(m.column, g_hat * m.share_a, m.w * m.share_a);
                if m.share_b != 0.0 {
                    put(m.column + 1, g_hat * m.share_b, m.w * m.share_b);
                }
            }
            for Block { a, b, d, column, .. } in blocks.iter() {
                put(*column, (*a * d[0] + *b * d[1]) * (1.0 / mu), d[0] + d[1]);
                put(column + 1, (*a * d[1] + *b * d[2]) * (1.0 / mu), d[1] + d[2]);
            }
            row.e = e.complex_mul(tau);
        }
    }
}

/// `C = wn + e S^-1 (w p^)^T` by LDL^T with the frame's tangent first: next to a line S has a condition of h^(3 - 2 alpha).
fn affine(e: Vec2, mu: f64, masses: &[Mass], blocks: &[Block], row: &mut Row) {
    let (mut a, mut b) = (0.0, 0.0);
    for m in masses {
        let g = m.w / mu;
        a += g * m.at.x * m.at.x;
        b += g * m.at.x * m.at.y;
    }
    for Block { a: p, b: q, d, .. } in blocks {
        a += (d[0] * p.x * p.x + 2.0 * d[1] * p.x * q.x + d[2] * q.x * q.x) / mu;
        b += (d[0] * p.x * p.y + d[1] * (p.x * q.y + q.x * p.y) + d[2] * q.x * q.y) / mu;
    }
    let r = b / a;
    let mut c = 0.0;
    for m in masses {
        let y = m.at.y - r * m.at.x;
        c += m.w / mu * y * y;
    }
    for Block { a: p, b: q, d, .. } in blocks {
        let (yp, yq) = (p.y - r * p.x, q.y - r * q.x);
        c += (d[0] * yp * yp + 2.0 * d[1] * yp * yq + d[2] * yq * yq) / mu;
    }
    let (ex, ey) = (e.x / a, (e.y - r * e.x) / c);
    for m in masses {
        let coefficient = m.w + m.w / mu * (ex * m.at.x + ey * (m.at.y - r * m.at.x));
        row.h[m.column].x += coefficient * m.share_a;
        if m.share_b != 0.0 {
            row.h[m.column + 1].x += coefficient * m.share_b;
        }
    }
    for Block { a: p, b: q, d, column, .. } in blocks {
        for (column, da, db) in [(*column, d[0], d[1]), (column + 1, d[1], d[2])] {
            let (x, y) = (da * p.x + db * q.x, da * (p.y - r * p.x) + db * (q.y - r * q.x));
            row.h[column].x += da + db + (ex * x + ey * y) / mu;
        }
    }
}
