//! EXIF orientation: reads tag 0x0112 of IFD 0 (EXIF 2.32, 4.6.5), one of the eight symmetries of a
//! rectangle, and applies it. Shapes: samples `[height][width][N]`. Malformed EXIF is the identity,
//! never an error. Cost: 1 to 4 work in place; 5 to 8 need a second image and are copied in tiles
//! that fit the first-level cache.

use super::alloc::zeros;
use super::{CodecError, StepCounter};

const ORIENTATION_TAG: u16 = 0x0112;
const TYPE_SHORT: u16 = 3;

/// Side of the squares in which an image is transposed: 64 rows of 64 RGBA16 pixels are 32 KiB.
const TILE_SIDE: usize = 64;
/// Pixels that are mirrored at once.
const MIRRORED_PIXELS: usize = 1 << 10;

/// The transformation that makes the stored rows upright, numbered as in EXIF.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub(super) enum ExifOrientation {
    #[default]
    Upright = 1,
    MirrorHorizontal = 2,
    Rotate180 = 3,
    MirrorVertical = 4,
    Transpose = 5,
    Rotate90 = 6,
    Transverse = 7,
    Rotate270 = 8,
}

impl ExifOrientation {
    /// Reads an EXIF block: a TIFF header, with or without the prefix `Exif\0\0` of JPEG.
    pub(super) fn from_exif(exif: &[u8]) -> Self {
        Self::parse(exif.strip_prefix(b"Exif\0\0").unwrap_or(exif)).unwrap_or_default()
    }

    fn parse(tiff: &[u8]) -> Option<Self> {
        let little = match tiff.get(..4)? {
            [b'I', b'I', 42, 0] => true,
            [b'M', b'M', 0, 42] => false,
            _ => return None,
        };
        let short = |at: usize| {
            let bytes = tiff.get(at..at.checked_add(2)?)?.try_into().ok()?;
            Some(if little {
                u16::from_le_bytes(bytes)
            } else {
                u16::from_be_bytes(bytes)
            })
        };
        let long = |at: usize| {
            let bytes = tiff.get(at..at.checked_add(4)?)?.try_into().ok()?;
            Some(if little {
                u32::from_le_bytes(bytes)
            } else {
                u32::from_be_bytes(bytes)
            })
        };
        let directory = usize::try_from(long(4)?).ok()?;
        let entries = usize::from(short(directory)?);
        for index in 0..entries {
            let entry = directory.checked_add(2 + 12 * index)?;
            if short(entry)? == ORIENTATION_TAG {
                let is_one_short = short(entry + 2)? == TYPE_SHORT && long(entry + 4)? == 1;
                return if is_one_short {
                    Self::from_number(short(entry + 8)?)
                } else {
                    None
                };
            }
        }
        None
    }

    pub(super) fn from_number(number: u16) -> Option<Self> {
        Some(match number {
            1 => Self::Upright,
            2 => Self::MirrorHorizontal,
            3 => Self::Rotate180,
            4 => Self::MirrorVertical,
            5 => Self::Transpose,
            6 => Self::Rotate90,
            7 => Self::Transverse,
            8 => Self::Rotate270,
            _ => return None,
        })
    }

    /// Whether width and height are swapped.
    pub(super) const fn swaps_sides(self) -> bool {
        matches!(
            self,
            Self::Transpose | Self::Rotate90 | Self::Transverse | Self::Rotate270
        )
    }

    /// Transforms `stored: [rows][width][N]` to the upright image unless cancelled.
    pub(super) fn apply<T: Copy + Default, const N: usize>(
        self,
        mut stored: Vec<T>,
        width: usize,
        work: &StepCounter<'_>,
    ) -> Result<Vec<T>, CodecError> {
        match self {
            Self::Upright => {}
            Self::MirrorHorizontal => {
                for row in stored.chunks_exact_mut(N * width) {
                    work.check()?;
                    row.as_chunks_mut::<N>().0.reverse();
                }
            }
            Self::Rotate180 => rotate(stored.as_chunks_mut::<N>().0, work)?,
            Self::MirrorVertical => mirror_rows(&mut stored, N * width, work)?,
            Self::Transpose | Self::Rotate90 | Self::Transverse | Self::Rotate270 => {
                return self.turn::<T, N>(&stored, width, work);
            }
        }
        Ok(stored)
    }

    fn turn<T: Copy + Default, const N: usize>(
        self,
        stored: &[T],
        width: usize,
        work: &StepCounter<'_>,
    ) -> Result<Vec<T>, CodecError> {
        let mut upright = zeros(stored.len() as u64, work)?;
        let from = stored.as_chunks::<N>().0;
        let into = upright.as_chunks_mut::<N>().0;
        let height = from.len() / width;
        let from_right = matches!(self, Self::Transverse | Self::Rotate270);
        let from_below = matches!(self, Self::Transverse | Self::Rotate90);
        for top in (0..width).step_by(TILE_SIDE) {
            for left in (0..height).step_by(TILE_SIDE) {
                work.check()?;
                for y in top..(top + TILE_SIDE).min(width) {
                    let column = if from_right { width - 1 - y } else { y };
                    for x in left..(left + TILE_SIDE).min(height) {
                        let row = if from_below { height - 1 - x } else { x };
                        into[y * height + x] = from[row * width + column];
                    }
                }
            }
        }
        Ok(upright)
    }
}

/// Reverses the pixels, from both ends to the middle.
fn rotate<P>(pixels: &mut [P], work: &StepCounter<'_>) -> Result<(), CodecError> {
    let half = pixels.len() / 2;
    let (front, back) = pixels.split_at_mut(half);
    let odd = back.len() - half;
    for (first, last) in front
        .chunks_mut(MIRRORED_PIXELS)
        .zip(back[odd..].rchunks_mut(MIRRORED_PIXELS))
    {
        work.check()?;
        first.swap_with_slice(last);
        first.reverse();
        last.reverse();
    }
    Ok(())
}

fn mirror_rows<T>(samples: &mut [T], row: usize, work: &StepCounter<'_>) -> Result<(), CodecError> {
    let height = samples.len() / row;
    let (above, below) = samples.split_at_mut(height / 2 * row);
    for (upper, lower) in above
        .chunks_exact_mut(row)
        .zip(below.rchunks_exact_mut(row))
    {
        work.check()?;
        upper.swap_with_slice(lower);
    }
    Ok(())
}

#[cfg(test)]
pub(super) mod tests {
    use super::*;

    /// The stored letters `abc / def`, one sample a pixel, after each orientation.
    pub(crate) const UPRIGHT: [(u16, usize, &[u8; 6]); 8] = [
        (1, 3, b"abcdef"),
        (2, 3, b"cbafed"),
        (3, 3, b"fedcba"),
        (4, 3, b"defabc"),
        (5, 2, b"adbecf"),
        (6, 2, b"daebfc"),
        (7, 2, b"fcebda"),
        (8, 2, b"cfbead"),
    ];

    /// A TIFF block with one entry besides the orientation.
    pub(crate) fn exif(orientation: u16, little: bool) -> Vec<u8> {
        let short = |v: u16| {
            if little {
                v.to_le_bytes()
            } else {
                v.to_be_bytes()
            }
        };
        let long = |v: u32| {
            if little {
                v.to_le_bytes()
            } else {
                v.to_be_bytes()
            }
        };
        let mut out = if little {
            b"II*\0".to_vec()
        } else {
            b"MM\0*".to_vec()
        };
        out.extend(long(8));
        out.extend(short(2));
        for (tag, value) in [(0x0106_u16, 2_u16), (ORIENTATION_TAG, orientation)] {
            out.extend(short(tag));
            out.extend(short(TYPE_SHORT));
            out.extend(long(1));
            out.extend(short(value));
            out.extend([0, 0]);
        }
        out.extend(long(0));
        out
    }

    #[test]
    fn orientation_is_read_in_both_byte_orders() {
        for number in 1..=8 {
            for little in [true, false] {
                assert_eq!(
                    ExifOrientation::from_exif(&exif(number, little)) as u16,
                    number
                );
                let prefixed = [b"Exif\0\0".as_slice(), &exif(number, little)].concat();
                assert_eq!(ExifOrientation::from_exif(&prefixed) as u16, number);
            }
        }
    }

    #[test]
    fn orientation_of_malformed_exif_is_upright() {
        for number in [0, 9, 255, u16::MAX] {
            assert_eq!(
                ExifOrientation::from_exif(&exif(number, true)),
                ExifOrientation::Upright
            );
        }
        let whole = exif(6, true);
        let needed = 8 + 2 + 12 + 10;
        for length in 0..whole.len() {
            let expected = if length < needed {
                ExifOrientation::Upright
            } else {
                ExifOrientation::Rotate90
            };
            assert_eq!(
                ExifOrientation::from_exif(&whole[..length]),
                expected,
                "{length} bytes"
            );
        }
        let mut far = whole.clone();
        far[4..8].copy_from_slice(&u32::MAX.to_le_bytes());
        assert_eq!(ExifOrientation::from_exif(&far), ExifOrientation::Upright);
        let mut many = exif(9, true);
        many[8..10].copy_from_slice(&u16::MAX.to_le_bytes());
        assert_eq!(ExifOrientation::from_exif(&many), ExifOrientation::Upright);
        let mut long_type = whole;
        long_type[8 + 2 + 12 + 2] = 4;
        assert_eq!(
            ExifOrientation::from_exif(&long_type),
            ExifOrientation::Upright
        );
    }

    #[test]
    fn orientation_turns_letters() {
        let work = StepCounter::new(&|| false);
        for (number, _, expected) in UPRIGHT {
            let orientation = ExifOrientation::from_number(number).unwrap();
            assert_eq!(
                orientation
                    .apply::<_, 1>(b"abcdef".to_vec(), 3, &work)
                    .unwrap(),
                expected,
                "{number}"
            );
            assert_eq!(orientation.swaps_sides(), number >= 5);
        }
    }

    /// Sides around the tile, several samples a pixel: turning there and back is the identity.
    #[test]
    fn orientation_and_its_inverse_cancel() {
        let work = StepCounter::new(&|| false);
        for (width, height) in [(1, 1), (1, 70), (70, 1), (64, 65), (130, 63)] {
            let stored: Vec<u16> = (0..).take(3 * width * height).collect();
            for (there, back) in [(2, 2), (3, 3), (4, 4), (5, 5), (6, 8), (7, 7), (8, 6)] {
                let (there, back) = (
                    ExifOrientation::from_number(there).unwrap(),
                    ExifOrientation::from_number(back).unwrap(),
                );
                let turned = there.apply::<_, 3>(stored.clone(), width, &work).unwrap();
                let turned_width = if there.swaps_sides() { height } else { width };
                assert_eq!(
                    back.apply::<_, 3>(turned, turned_width, &work).unwrap(),
                    stored,
                    "{there:?} {width}x{height}"
                );
            }
        }
    }
}
