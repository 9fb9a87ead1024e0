//! Rim that touches no pixel inside: the dust around a cut-out goes with what is nearest
//! (mathematics 11.1).

use super::Mask;
use super::mask::{AROUND, PIXELS_PER_CHECK, STRAY, UNATTACHED, number};

/// Stray rim that is farther from all pixels inside is no dust, px: as positions are that belong to
/// no part.
const DUST_TO_SUBJECT: u32 = 16;

impl Mask {
    /// Attaches the parts of the rim that is left, where all of the part is near pixels inside.
    pub(super) fn attach_stray(&mut self, cancelled: &dyn Fn() -> bool) -> Option<()> {
        let mut is_any = false;
        for y in 0..self.height {
            if cancelled() {
                return None;
            }
            for rim in self.rim_of_row(y) {
                if self.rim[rim].root == UNATTACHED {
                    self.pixels[y * self.width + self.rim[rim].x as usize] = STRAY;
                    is_any = true;
                }
            }
        }
        // Without a pixel inside, there is nothing that it could go with.
        if is_any && self.inside() > 0 {
            self.find_nearest(false, cancelled)?;
            self.find_nearest(true, cancelled)?;
            self.release_far(cancelled)?;
        }
        Some(())
    }

    /// Attaches stray rim to the nearest pixel inside in its row or above it (`below`: or below),
    /// unless it has a nearer one; of equally near ones to the first in row order. Of a column only
    /// the pixel that is next to the row can be the nearest, so a pixel takes the same work
    /// wherever it lies.
    fn find_nearest(&mut self, below: bool, cancelled: &dyn Fn() -> bool) -> Option<()> {
        // The row of each column's pixel inside that was met last.
        let (mut met, mut met_last) = (vec![u32::MAX; self.width], None);
        for k in 0..self.height {
            if cancelled() {
                return None;
            }
            let y = if below { self.height - 1 - k } else { k };
            for (x, met) in met.iter_mut().enumerate() {
                if self.is_inside_at(y * self.width + x) {
                    *met = number(y);
                    met_last = Some(y);
                }
            }
            let is_near = |row: usize| row.abs_diff(y) <= DUST_TO_SUBJECT as usize;
            if !met_last.is_some_and(is_near) {
                continue;
            }
            for rim in self.rim_of_row(y) {
                let (x, own) = (self.rim[rim].x, self.rim[rim].root);
                if self.pixels[y * self.width + x as usize] != STRAY {
                    continue;
                }
                let last = number(self.width - 1).min(x + DUST_TO_SUBJECT);
                let columns = x.saturating_sub(DUST_TO_SUBJECT)..last + 1;
                let distance2 = |column: u32, row: u32| {
                    let (dx, dy) = (
                        x.abs_diff(column),
                        number(y).abs_diff(row).min(DUST_TO_SUBJECT + 1),
                    );
                    dx * dx + dy * dy
                };
                let rows = &met[columns.start as usize..columns.end as usize];
                let of_columns = || columns.clone().zip(rows);
                let distances = of_columns().map(|(column, row)| distance2(column, *row));
                let least = distances.min().unwrap_or(u32::MAX);
                let of_own = match own {
                    UNATTACHED => DUST_TO_SUBJECT * DUST_TO_SUBJECT + 1,
                    own => distance2(own % number(self.width), own / number(self.width)),
                };
                if least > of_own || least > DUST_TO_SUBJECT * DUST_TO_SUBJECT {
                    continue;
                }
                let nearest =
                    of_columns().filter(|(column, row)| distance2(*column, **row) == least);
                let pixel = |(column, row): (u32, &u32)| *row * number(self.width) + column;
                let nearest = nearest.map(pixel).min();
                let own = (of_own == least).then_some(own);
                self.rim[rim].root = nearest.into_iter().chain(own).min().unwrap_or(UNATTACHED);
            }
        }
        Some(())
    }

    /// A part of stray rim that is far from all pixels inside somewhere is no dust, and goes with
    /// none of them.
    fn release_far(&mut self, cancelled: &dyn Fn() -> bool) -> Option<()> {
        let is_attached = |y: usize| {
            let rim = &self.rim[self.rim_of_row(y)];
            rim.iter().any(|rim| rim.root != UNATTACHED)
        };
        let mut rows = Vec::new();
        for y in 0..self.height {
            if cancelled() {
                return None;
            }
            rows.push(is_attached(y));
        }
        let mut far = Vec::new();
        for y in 0..self.height {
            if cancelled() {
                return None;
            }
            // Elsewhere it touches nothing that is attached.
            if !rows[y.saturating_sub(1)..self.height.min(y + 2)].contains(&true) {
                continue;
            }
            for rim in self.rim_of_row(y) {
                if self.rim[rim].root == UNATTACHED {
                    far.push(number(y * self.width + self.rim[rim].x as usize));
                }
            }
        }
        let mut visited = 0_usize;
        while let Some(at) = far.pop() {
            visited += 1;
            if visited.is_multiple_of(PIXELS_PER_CHECK) && cancelled() {
                return None;
            }
            // What touches stray rim is stray.
            for (dx, dy) in AROUND {
                if let Some(neighbour) = self.beside(at as usize, dx, dy)
                    && let Some(rim) = self.rim_at(neighbour)
                    && self.rim[rim].root != UNATTACHED
                {
                    self.rim[rim].root = UNATTACHED;
                    far.push(number(neighbour));
                }
            }
        }
        Some(())
    }
}
