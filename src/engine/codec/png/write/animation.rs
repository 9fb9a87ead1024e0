//! Animated PNG (PNG 3rd edition, section 11.3.4): PNG files of one shape, as this writer encodes
//! them, become the frames of one file. The chunks IDAT of all frames but the first become fdAT,
//! which begin with a sequence number.

use super::chunk::{self, CHUNK_OVERHEAD_BYTES, SIGNATURE};
use crate::codec::CodecError;

/// Milliseconds of a second.
const MS_PER_SECOND: u16 = 1000;

/// An animation that is being written.
#[derive(Debug)]
pub struct Animation {
    frames: u32,
    delay: u16,
    plays: u16,
    sequence: u32,
    /// IHDR of all frames.
    header: Vec<u8>,
}

impl Animation {
    /// An animation of this number of frames, each shown for `delay` ms. `plays`: how often viewers
    /// play it; 0 is without end.
    #[must_use]
    pub const fn new(frames: u32, delay: u16, plays: u16) -> Self {
        Self {
            frames,
            delay,
            plays,
            sequence: 0,
            header: Vec::new(),
        }
    }

    /// Appends the next frame, which is a PNG file.
    ///
    /// # Errors
    /// It is no PNG file, or its size or samples differ from those of the first frame.
    pub fn push(&mut self, file: &[u8], out: &mut Vec<u8>) -> Result<(), CodecError> {
        let bad = |detail: &str| CodecError::Bad {
            format: "PNG",
            detail: detail.to_owned(),
        };
        let mut rest = file
            .strip_prefix(&SIGNATURE)
            .ok_or_else(|| bad("a frame is not a PNG file"))?;
        let is_first = self.header.is_empty();
        out.reserve(file.len() + 4 * CHUNK_OVERHEAD_BYTES);
        while let Some((kind, payload, chunk)) = next_chunk(&mut rest) {
            match &kind {
                b"IHDR" if is_first => {
                    self.header = payload.to_vec();
                    out.extend_from_slice(&SIGNATURE);
                    out.extend_from_slice(chunk);
                    chunk::write(
                        out,
                        *b"acTL",
                        &[self.frames, self.plays.into()]
                            .map(u32::to_be_bytes)
                            .concat(),
                    );
                    // Before IDAT, in any order.
                    self.control(out);
                }
                b"IHDR" if payload == self.header => self.control(out),
                b"IHDR" => return Err(bad("the frames differ in size, depth or colour type")),
                b"IDAT" if !is_first => {
                    let open = chunk::open(out, *b"fdAT");
                    out.extend_from_slice(&self.next_number());
                    out.extend_from_slice(payload);
                    open.close(out);
                }
                b"IEND" => return Ok(()),
                // The colour profile is that of the first frame.
                _ if is_first => out.extend_from_slice(chunk),
                _ => {}
            }
        }
        Err(bad("a frame is incomplete"))
    }

    /// The bytes after the last frame.
    #[must_use]
    pub fn tail() -> Vec<u8> {
        let mut out = Vec::new();
        chunk::write(&mut out, *b"IEND", &[]);
        out
    }

    /// Appends fcTL: the frame covers the whole image and replaces it.
    fn control(&mut self, out: &mut Vec<u8>) {
        let open = chunk::open(out, *b"fcTL");
        out.extend_from_slice(&self.next_number());
        // Width and height.
        out.extend_from_slice(&self.header[..8]);
        out.extend_from_slice(&[0; 8]);
        out.extend_from_slice(&self.delay.to_be_bytes());
        out.extend_from_slice(&MS_PER_SECOND.to_be_bytes());
        // Nothing is disposed of, and nothing is blended.
        out.extend_from_slice(&[0, 0]);
        open.close(out);
    }

    fn next_number(&mut self) -> [u8; 4] {
        let number = self.sequence;
        self.sequence += 1;
        number.to_be_bytes()
    }
}

/// Cuts off the next chunk: its type, its payload, and all of it.
fn next_chunk<'a>(rest: &mut &'a [u8]) -> Option<([u8; 4], &'a [u8], &'a [u8])> {
    let length = u32::from_be_bytes(*rest.first_chunk()?);
    let (chunk, after) =
        rest.split_at_checked(CHUNK_OVERHEAD_BYTES.checked_add(usize::try_from(length).ok()?)?)?;
    *rest = after;
    Some((
        *chunk[4..].first_chunk()?,
        &chunk[8..chunk.len() - 4],
        chunk,
    ))
}

#[cfg(test)]
mod tests {
    use super::super::{Compression, PixelLayout, PngWriter};
    use super::*;
    use crate::codec::Carried;
    use crate::pixmap::{Channels, Depth, Extent};

    fn file(width: u32, height: u32, value: u8, icc: Option<&Carried>) -> (Vec<u8>, Vec<u8>) {
        let extent = Extent::new(width, height).unwrap();
        let shape = PixelLayout {
            extent,
            channels: Channels::Rgba,
            grey: false,
            depth: Depth::Eight,
        };
        let writer = PngWriter::new(shape, Compression::Fast, icc);
        let row = width as usize * 4;
        let samples: Vec<u8> = (0..=u8::MAX)
            .cycle()
            .take(row * height as usize)
            .map(|k| k.wrapping_mul(value))
            .collect();
        let (mut out, mut sums) = (writer.head(), Vec::new());
        for strip in 0..writer.strips() {
            let rows = writer.rows(strip);
            sums.push(writer.strip_into(
                strip,
                &samples[rows.start as usize * row..rows.end as usize * row],
                &mut out,
            ));
        }
        out.extend_from_slice(&writer.tail(&sums));
        (out, samples)
    }

    #[test]
    fn the_frames_are_those_files() {
        let profile = Carried::of_icc(&[7; 500]);
        for (icc, sides) in [(None, (9, 5)), (Some(&profile), (300, 200))] {
            let frames: Vec<_> = [3, 5, 11]
                .map(|value| file(sides.0, sides.1, value, icc))
                .into();
            let (mut animation, mut out) = (Animation::new(3, 40, 7), Vec::new());
            frames
                .iter()
                .for_each(|(file, _)| animation.push(file, &mut out).unwrap());
            out.extend_from_slice(&Animation::tail());
            let mut reader = ::png::Decoder::new(std::io::Cursor::new(out))
                .read_info()
                .unwrap();
            let control = reader.info().animation_control.unwrap();
            assert_eq!((control.num_frames, control.num_plays), (3, 7));
            assert_eq!(reader.info().icc_profile.is_some(), icc.is_some());
            for (_, samples) in &frames {
                let mut read = vec![0; reader.output_buffer_size().unwrap()];
                reader.next_frame(&mut read).unwrap();
                assert!(read == *samples);
                let shown = reader.info().frame_control.unwrap();
                assert_eq!(
                    (shown.delay_num, shown.delay_den, shown.width, shown.height),
                    (40, 1000, sides.0, sides.1)
                );
            }
            assert!(
                reader
                    .next_frame(&mut vec![0; reader.output_buffer_size().unwrap()])
                    .is_err(),
                "that was the last frame"
            );
        }
    }

    #[test]
    fn frames_of_another_shape_and_other_bytes_are_refused() {
        let (one, _) = file(9, 5, 3, None);
        let mut animation = Animation::new(2, 40, 0);
        animation.push(&one, &mut Vec::new()).unwrap();
        for bad in [
            file(9, 6, 3, None).0,
            one[..one.len() - 12].to_vec(),
            one[1..].to_vec(),
            Vec::new(),
            SIGNATURE.to_vec(),
        ] {
            assert!(animation.push(&bad, &mut Vec::new()).is_err());
        }
        animation.push(&one, &mut Vec::new()).unwrap();
    }
}
