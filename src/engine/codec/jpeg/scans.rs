//! Which bits of its coefficients the scans of a progressive JPEG have stated (T.81, annex G).

/// Coefficients of a block.
const BLOCK: usize = 64;
/// Nothing has been stated.
const UNSTATED_BIT: u8 = u8::MAX;

/// For each component, the lowest bit that is stated of each coefficient.
pub(super) struct Precision<'a> {
    components: &'a [u8],
    lowest: Vec<[u8; BLOCK]>,
}

impl<'a> Precision<'a> {
    /// `components`: their numbers.
    pub(super) fn new(components: &'a [u8]) -> Self {
        Self {
            components,
            lowest: vec![[UNSTATED_BIT; BLOCK]; components.len()],
        }
    }

    /// Adds the header of a scan.
    pub(super) fn add(&mut self, header: &[u8]) {
        let Some((&count, rest)) = header.split_first() else {
            return;
        };
        let Some((selected, &[first, last, bits])) = rest.split_at_checked(2 * usize::from(count))
        else {
            return;
        };
        for selected in selected.chunks_exact(2) {
            let known = self
                .components
                .iter()
                .zip(&mut self.lowest)
                .find(|(number, _)| **number == selected[0]);
            let range = usize::from(first)..=usize::from(last);
            if let Some(stated) = known.and_then(|(_, lowest)| lowest.get_mut(range)) {
                stated.fill(bits & 15);
            }
        }
    }

    /// Whether every bit of every coefficient has been stated.
    pub(super) fn is_full(&self) -> bool {
        self.lowest.as_flattened().iter().all(|lowest| *lowest == 0)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_picture_is_full_when_every_bit_has_been_stated() {
        let numbers = [1, 7];
        let mut precision = Precision::new(&numbers);
        for (header, is_full) in [
            (&[2, 1, 0, 7, 0, 0, 0, 0x01][..], false),
            (&[1, 1, 0, 1, 63, 0x02], false),
            (&[1, 7, 0, 1, 63, 0x00], false),
            (&[1, 1, 0, 1, 63, 0x21], false),
            (&[1, 1, 0, 1, 63, 0x10], false),
            (&[2, 1, 0, 7], false),
            (&[], false),
            (&[1, 9, 0, 0, 0, 0x10], false),
            (&[2, 1, 0, 7, 0, 0, 0, 0x10], true),
        ] {
            precision.add(header);
            assert_eq!(precision.is_full(), is_full, "{header:?}");
        }
    }
}
