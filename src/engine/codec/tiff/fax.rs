//! CCITT group 4 (ITU-T T.6) as rows of bits, of which black pixels are 1. The code tables are
//! those of the `fax` crate; the lines are decoded here, so that hostile data can neither make one
//! longer than it is wide nor go back in it. Work and memory are in proportion to the image.

use std::io::{self, Read};

use fax::ByteReader;
use fax::maps::{Mode, black, mode, white};

/// A line may have this number of codes beyond two for each pixel.
const FREE_CODES: usize = 16;
/// From this length on, a run is followed by another code.
const MAKE_UP: u32 = 64;

/// The lines of a strip.
pub(super) struct Group4<R: Iterator<Item = io::Result<u8>>> {
    bits: ByteReader<R>,
    width: u32,
    /// Where the colour of the last line changes, from white on; increasing, so that no change is
    /// looked at again and again.
    reference: Vec<u32>,
    row: Vec<u8>,
    /// The bytes of the row that have been read.
    read: usize,
}

fn damaged() -> io::Error {
    io::Error::other("a line of fax data is damaged")
}

impl<R: Iterator<Item = io::Result<u8>>> Group4<R> {
    pub(super) fn new(bytes: R, width: u32) -> io::Result<Self> {
        let row = vec![0; width.div_ceil(8) as usize];
        let read = row.len();
        Ok(Self {
            bits: ByteReader::new(bytes)?,
            width,
            reference: Vec::new(),
            row,
            read,
        })
    }

    /// The length of a run.
    fn run(&mut self, is_black: bool) -> io::Result<u32> {
        let mut sum = 0;
        loop {
            let code = if is_black {
                black::decode(&mut self.bits)
            } else {
                white::decode(&mut self.bits)
            };
            let code = u32::from(code.ok_or_else(damaged)?);
            sum += code;
            if code < MAKE_UP {
                return Ok(sum);
            }
            if sum > self.width {
                return Err(damaged());
            }
        }
    }

    /// The changes of the next line.
    fn line(&mut self) -> io::Result<Vec<u32>> {
        let mut changes: Vec<u32> = Vec::new();
        // `at`: the position in the line, `None` before its first pixel; `above`: the index of the
        // next change in the line above.
        let (mut at, mut is_black, mut above) = (None, false, 0_usize);
        for _ in 0..2 * self.width as usize + FREE_CODES {
            let begin = at.unwrap_or(0);
            if at.is_some() && begin >= self.width {
                return Ok(changes);
            }
            // The first change to the other colour after the position.
            while above > 0
                && self
                    .reference
                    .get(above - 1)
                    .is_none_or(|change| at.is_none_or(|at| *change > at))
            {
                above -= 1;
            }
            while self
                .reference
                .get(above)
                .is_some_and(|change| at.is_some_and(|at| *change <= at))
            {
                above += 1;
            }
            above += usize::from(is_black != (above % 2 == 1));
            let change = |index: usize| self.reference.get(index).copied().unwrap_or(self.width);
            match mode::decode(&mut self.bits).ok_or_else(damaged)? {
                Mode::Pass => at = Some(change(above + 1)),
                Mode::Vertical(offset) => {
                    let place = change(above)
                        .checked_add_signed(offset.into())
                        .ok_or_else(damaged)?;
                    if place > self.width || changes.last().is_some_and(|last| place <= *last) {
                        return Err(damaged());
                    }
                    changes.push(place);
                    is_black = !is_black;
                    at = Some(place);
                }
                Mode::Horizontal => {
                    let first = begin + self.run(is_black)?;
                    let second = first + self.run(!is_black)?;
                    let is_within = second <= self.width && (second > first || first == self.width);
                    if !is_within || changes.last().is_some_and(|last| first <= *last) {
                        return Err(damaged());
                    }
                    changes.push(first);
                    changes.extend(Some(second).filter(|second| *second > first));
                    at = Some(second);
                }
                Mode::Extension | Mode::EOF => return Err(damaged()),
            }
        }
        Err(damaged())
    }

    fn next_row(&mut self) -> io::Result<()> {
        let changes = self.line()?;
        self.row.fill(0);
        for run in changes.chunks(2) {
            let (from, to) = (
                run[0] as usize,
                run.get(1).map_or(self.width, |to| *to) as usize,
            );
            for pixel in from..to {
                self.row[pixel / 8] |= 0x80 >> (pixel % 8);
            }
        }
        self.reference = changes;
        self.read = 0;
        Ok(())
    }
}

impl<R: Iterator<Item = io::Result<u8>>> Read for Group4<R> {
    fn read(&mut self, into: &mut [u8]) -> io::Result<usize> {
        if self.read == self.row.len() {
            self.next_row()?;
        }
        let read = (&self.row[self.read..]).read(into)?;
        self.read += read;
        Ok(read)
    }
}

#[cfg(test)]
mod tests {
    use fax::encoder::Encoder;
    use fax::{Color, VecWriter};

    use super::*;

    /// Lines of black pixels, and their code.
    fn coded(width: u16, lines: &[Vec<bool>]) -> Vec<u8> {
        let mut encoder = Encoder::new(VecWriter::new());
        for line in lines {
            let pixels = line
                .iter()
                .map(|black| if *black { Color::Black } else { Color::White });
            encoder.encode_line(pixels, width).unwrap();
        }
        encoder.finish().unwrap().finish()
    }

    fn read(width: u32, lines: usize, data: Vec<u8>) -> io::Result<Vec<u8>> {
        let mut rows = vec![0; width.div_ceil(8) as usize * lines];
        Group4::new(data.into_iter().map(Ok), width)?.read_exact(&mut rows)?;
        Ok(rows)
    }

    #[test]
    fn lines_of_another_encoder_are_read() {
        let mut state = 7_u32;
        let mut random = move || {
            state = state.wrapping_mul(1_664_525).wrapping_add(1_013_904_223);
            state >> 16
        };
        for width in [1, 7, 8, 9, 63, 64, 65, 1_728, 5_000] {
            for density in [0, 2, 9, 40] {
                let lines: Vec<Vec<bool>> = (0..12)
                    .map(|_| {
                        let mut black = random() % 2 == 0;
                        (0..width)
                            .map(|_| {
                                black ^= density > 0 && random() % density == 0;
                                black
                            })
                            .collect()
                    })
                    .collect();
                let data = coded(width, &lines);
                let rows = read(width.into(), lines.len(), data.clone()).unwrap();
                let row = usize::from(width).div_ceil(8);
                for (line, row) in lines.iter().zip(rows.chunks(row)) {
                    let got: Vec<bool> = (0..usize::from(width))
                        .map(|x| row[x / 8] >> (7 - x % 8) & 1 == 1)
                        .collect();
                    assert_eq!(&got, line, "{width}, {density}");
                }
                // Behind the last line is the mark of the end, and no further line.
                assert!(read(width.into(), lines.len() + 1, data).is_err());
            }
        }
    }

    #[test]
    fn hostile_data_end_in_an_error() {
        // Runs of no length, for ever: white 00110101, black 0000110111, in horizontal mode 001.
        let no_runs: Vec<u8> = {
            let bits: String = "001001101010000110111".repeat(8_000);
            bits.as_bytes()
                .chunks_exact(8)
                .map(|byte| byte.iter().fold(0, |sum, bit| sum << 1 | (bit - b'0')))
                .collect()
        };
        for data in [
            no_runs,
            vec![0; 4_000],
            vec![0b0100_1001; 4_000],
            vec![0xAA; 4_000],
            (0..=255).cycle().take(4_000).collect(),
        ] {
            assert!(read(1_000, 3_000, data).is_err());
        }
        assert!(
            read(70_000, 2, vec![0xFF; 1]).is_ok(),
            "two white lines take a bit each"
        );
    }
}
