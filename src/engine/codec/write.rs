//! Writes an image in any format: head, strips in any order, tail. PNG and JPEG have several
//! strips, rendered and encoded in parallel and sent in order; the other formats are one strip:
//! WebP has its codes before the first pixel. Of grey pixels one sample is written, except in WebP,
//! which has none.

use std::borrow::Cow;
use std::ops::Range;
use std::sync::Arc;

use super::encoder::{FormatEncoder, OneStrip};
use super::jpeg::write::JpegWriter;
use super::png::write::{PngWriter, StripChecksum};
use super::{Carried, Encoding, Palette, gif, tiff, webp};
use crate::pixmap::{Channels, Depth, PixelLayout};

/// Writes one image. Cheap to create and to clone.
#[derive(Clone, Debug)]
pub struct Writer {
    shape: PixelLayout,
    /// The samples have three equal colours, of which the file has one.
    is_grey_in_colour: bool,
    /// The most bits of a sample of the format.
    depth: Depth,
    encoder: Arc<dyn FormatEncoder>,
}

/// The encoder of each encoding. A palette is only one of labels, whose samples are its indices.
fn encoder(
    shape: PixelLayout,
    encoding: Encoding,
    palette: Option<&Palette>,
    metadata: Option<&Carried>,
) -> Arc<dyn FormatEncoder> {
    let carried = metadata.cloned();
    match encoding {
        Encoding::Png(compression) => {
            Arc::new(PngWriter::of_labels(shape, compression, palette, metadata))
        }
        Encoding::Jpeg {
            quality,
            subsampling,
            ground,
        } => Arc::new(JpegWriter::new(
            shape,
            quality,
            subsampling,
            ground,
            metadata,
        )),
        Encoding::WebP => {
            let write = move |samples: &[u8], out: &mut Vec<u8>, wanted: &dyn Fn() -> bool| {
                let picture = (shape.extent, shape.channels);
                webp::write::write(picture, samples, carried.as_ref(), out, wanted);
            };
            Arc::new(OneStrip::new(shape, metadata, write))
        }
        Encoding::Tiff(compression) => {
            let palette = palette.cloned();
            let write = move |samples: &[u8], out: &mut Vec<u8>, wanted: &dyn Fn() -> bool| {
                let beside = (carried.as_ref(), palette.as_ref());
                tiff::write::write(shape, compression, samples, beside, out, wanted);
            };
            Arc::new(OneStrip::new(shape, metadata, write))
        }
        Encoding::Gif => {
            let write = move |samples: &[u8], out: &mut Vec<u8>, wanted: &dyn Fn() -> bool| {
                gif::write::write(shape.extent, shape.channels, samples, out, wanted);
            };
            let tables = gif::write::work_bytes(shape.extent);
            Arc::new(OneStrip::new(shape, metadata, write).with_tables(tables))
        }
    }
}

impl Writer {
    /// Creates a writer for one image. A grey one becomes a file in colour if the format has no
    /// grey, or if the ground is not grey.
    ///
    /// # Panics
    /// If a row is longer than 1 GiB.
    #[must_use]
    pub fn new(shape: PixelLayout, encoding: Encoding, metadata: Option<&Carried>) -> Self {
        let grey = shape.grey && encoding.is_grey();
        let shape = PixelLayout { grey, ..shape };
        Self {
            shape,
            is_grey_in_colour: grey,
            depth: encoding.format().info().depth,
            encoder: encoder(shape, encoding, None, metadata),
        }
    }

    /// Creates a writer for a label image, whose samples are given as the file has them; `None` if
    /// the format would change them.
    ///
    /// # Panics
    /// Like [`Self::new`].
    #[must_use]
    pub fn of_labels(
        shape: PixelLayout,
        encoding: Encoding,
        palette: Option<&Palette>,
        metadata: Option<&Carried>,
    ) -> Option<Self> {
        let format = encoding.format().info();
        format.keeps_labels.then(|| Self {
            shape,
            is_grey_in_colour: false,
            depth: format.depth,
            encoder: encoder(shape, encoding, palette, metadata),
        })
    }

    /// Number of strips.
    #[must_use]
    pub fn strips(&self) -> usize {
        self.encoder.strips()
    }

    /// Rows of a strip.
    ///
    /// # Panics
    /// If there is no such strip.
    #[must_use]
    pub fn rows(&self, strip: usize) -> Range<u32> {
        self.encoder.rows(strip)
    }

    /// Upper bound of the whole file, bytes, whatever the samples.
    #[must_use]
    pub fn max_bytes(&self) -> u64 {
        self.encoder.max_bytes()
    }

    /// Upper bound of the memory for writing, the file included, bytes.
    #[must_use]
    pub fn work_bytes(&self) -> u64 {
        self.encoder.work_bytes()
    }

    /// The bytes before the first strip.
    #[must_use]
    pub fn head(&self) -> Vec<u8> {
        self.encoder.head()
    }

    /// Encodes one strip and appends it. `samples: [rows][width][channels]`, 16-bit ones
    /// big-endian; those of a grey image are overwritten. During long strips `wanted` is called
    /// from time to time, and encoding stops when it returns false; the output is then incomplete.
    ///
    /// # Panics
    /// If there is no such strip or the samples are not its rows.
    pub fn strip_into(
        &self,
        index: usize,
        samples: &mut [u8],
        out: &mut Vec<u8>,
        wanted: &dyn Fn() -> bool,
    ) -> StripChecksum {
        let samples = if self.is_grey_in_colour {
            first_colour(samples, self.shape)
        } else {
            samples
        };
        let samples = match self.depth {
            Depth::Eight => in_eight(samples, self.shape.depth),
            Depth::Sixteen => Cow::Borrowed(samples),
        };
        self.encoder.strip_into(index, &samples, out, wanted)
    }

    /// The bytes after the last strip.
    #[must_use]
    pub fn tail(&self, checksums: &[StripChecksum]) -> Vec<u8> {
        self.encoder.tail(checksums)
    }
}

/// Moves the first colour of every pixel, and its alpha, to the front.
fn first_colour(samples: &mut [u8], shape: PixelLayout) -> &[u8] {
    fn compact<const FROM: usize, const COLOUR: usize, const TO: usize>(
        samples: &mut [u8],
    ) -> usize {
        let pixels = samples.len() / FROM;
        for pixel in 0..pixels {
            let from: [u8; FROM] = samples[pixel * FROM..][..FROM].try_into().expect("a pixel");
            let mut to = [0; TO];
            to[..COLOUR].copy_from_slice(&from[..COLOUR]);
            to[COLOUR..].copy_from_slice(&from[3 * COLOUR..]);
            samples[pixel * TO..][..TO].copy_from_slice(&to);
        }
        pixels * TO
    }
    let length = match (shape.channels, shape.depth) {
        (Channels::Rgb, Depth::Eight) => compact::<3, 1, 1>(samples),
        (Channels::Rgba, Depth::Eight) => compact::<4, 1, 2>(samples),
        (Channels::Rgb, Depth::Sixteen) => compact::<6, 2, 2>(samples),
        (Channels::Rgba, Depth::Sixteen) => compact::<8, 2, 4>(samples),
    };
    &samples[..length]
}

/// Samples of 8 bit: of 16, the nearest `(s * 255 + 32767) / 65535`.
fn in_eight(samples: &[u8], depth: Depth) -> Cow<'_, [u8]> {
    #[expect(clippy::cast_possible_truncation, reason = "at most 255")]
    let nearest =
        |s: &[u8]| ((u32::from(u16::from_be_bytes([s[0], s[1]])) * 255 + 32_767) / 65_535) as u8;
    match depth {
        Depth::Eight => Cow::Borrowed(samples),
        Depth::Sixteen => samples.chunks_exact(2).map(nearest).collect(),
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::codec::{Compression, Decoded, ImageLimits, SourceFormat, Subsampling, decode};
    use crate::pixmap::Extent;
    use crate::pixmap::Samples;

    const TIFF: Encoding = Encoding::Tiff(Compression::Fast);

    fn written(
        extent: Extent,
        channels: Channels,
        depth: Depth,
        samples: &[u8],
        encoding: Encoding,
        icc: Option<&[u8]>,
    ) -> Decoded {
        let profile = icc.map(Carried::of_icc);
        let writer = Writer::new(
            PixelLayout {
                extent,
                channels,
                grey: false,
                depth,
            },
            encoding,
            profile.as_ref(),
        );
        let mut file = writer.head();
        let checksum = writer.strip_into(0, &mut samples.to_vec(), &mut file, &|| true);
        file.extend(writer.tail(&[checksum]));
        assert_eq!(
            SourceFormat::of(&file).unwrap(),
            SourceFormat::Written(encoding.format())
        );
        assert!(file.len() as u64 <= writer.max_bytes());
        decode(&file, &ImageLimits::default(), &|| false).unwrap()
    }

    #[test]
    fn a_picture_that_nobody_waits_for_is_not_written_to_its_end() {
        let jpeg = Encoding::Jpeg {
            quality: 95,
            subsampling: Subsampling::Full,
            ground: [0; 3],
        };
        [jpeg, Encoding::WebP, TIFF, Encoding::Gif]
            .into_iter()
            .for_each(|encoding| is_not_written_to_its_end(encoding, 1000));
        is_not_written_to_its_end(Encoding::Png(Compression::Best), 20);
    }

    fn is_not_written_to_its_end(encoding: Encoding, height: u32) {
        use std::cell::Cell;
        let extent = Extent::new(1500, height).unwrap();
        let shape = PixelLayout {
            extent,
            channels: Channels::Rgb,
            grey: false,
            depth: Depth::Eight,
        };
        let writer = Writer::new(shape, encoding, None);
        let rows = writer.rows(0).end;
        let noise: Vec<u8> = (0..rows * 1500 * 3)
            .map(|k| (k.wrapping_mul(2_654_435_761) >> 24) as u8)
            .collect();
        let write = |looks: u32| {
            let (asked, mut file) = (Cell::new(0), Vec::new());
            writer.strip_into(0, &mut noise.clone(), &mut file, &|| {
                asked.replace(asked.get() + 1) < looks
            });
            file.len()
        };
        let whole = write(u32::MAX);
        assert!(
            write(1) < whole / 4,
            "{encoding:?}: {} of {whole}",
            write(1)
        );
    }

    fn eight(decoded: &Decoded) -> &[u8] {
        match decoded.pixmap.samples() {
            Samples::Eight(samples) => samples,
            Samples::Sixteen(_) => panic!("8 bit expected"),
        }
    }

    /// A smooth image: what a lossy format keeps.
    fn waves(extent: Extent, channels: Channels) -> Vec<u8> {
        let (w, h) = (extent.width() as usize, extent.height() as usize);
        let wave = |k: usize| {
            let (x, y, c) = (
                k / channels.count() % w,
                k / channels.count() / w,
                k % channels.count(),
            );
            #[expect(
                clippy::cast_possible_truncation,
                clippy::cast_sign_loss,
                reason = "0 to 255"
            )]
            let sample = (127.5
                + 120.0 * ((x as f64 * 0.11 + c as f64).sin() * (y as f64 * 0.07).cos()))
                as u8;
            sample
        };
        (0..w * h * channels.count()).map(wave).collect()
    }

    #[test]
    fn webp_gives_every_sample_back() {
        for (w, h) in [(1, 1), (5, 3), (64, 33)] {
            let extent = Extent::new(w, h).unwrap();
            for channels in [Channels::Rgb, Channels::Rgba] {
                let samples = waves(extent, channels);
                let back = written(
                    extent,
                    channels,
                    Depth::Eight,
                    &samples,
                    Encoding::WebP,
                    None,
                );
                assert_eq!(
                    (back.pixmap.extent(), back.pixmap.channels(), eight(&back)),
                    (extent, channels, samples.as_slice())
                );
            }
        }
    }

    #[test]
    fn jpeg_is_near_and_nearer_at_a_higher_quality() {
        let extent = Extent::new(61, 47).unwrap();
        let samples = waves(extent, Channels::Rgb);
        let worst = |quality| {
            let back = written(
                extent,
                Channels::Rgb,
                Depth::Eight,
                &samples,
                Encoding::Jpeg {
                    quality,
                    subsampling: Subsampling::Full,
                    ground: [255; 3],
                },
                None,
            );
            assert_eq!(back.pixmap.extent(), extent);
            eight(&back)
                .iter()
                .zip(&samples)
                .map(|(a, b)| a.abs_diff(*b))
                .max()
                .unwrap()
        };
        let (low, high, full) = (worst(30), worst(90), worst(100));
        assert!(
            full <= 6 && full < high && high < low,
            "{low} {high} {full}"
        );
    }

    #[test]
    fn jpeg_puts_what_is_transparent_on_the_ground() {
        let extent = Extent::new(24, 16).unwrap();
        for (alpha, want) in [(0, [10, 200, 30]), (255, [250, 0, 90]), (51, [58, 160, 42])] {
            let samples = [250, 0, 90, alpha].repeat(24 * 16);
            let encoding = Encoding::Jpeg {
                quality: 100,
                subsampling: Subsampling::Full,
                ground: [10, 200, 30],
            };
            let back = written(
                extent,
                Channels::Rgba,
                Depth::Eight,
                &samples,
                encoding,
                None,
            );
            assert_eq!(back.pixmap.channels(), Channels::Rgb);
            for pixel in eight(&back).chunks_exact(3) {
                assert!(
                    pixel
                        .iter()
                        .zip(want)
                        .all(|(got, want)| got.abs_diff(want) <= 3),
                    "{pixel:?} {want:?}"
                );
            }
        }
    }

    #[test]
    fn sixteen_bits_become_the_nearest_eight() {
        let extent = Extent::new(4, 1).unwrap();
        let deep = [
            0_u16, 128, 129, 257, 32_639, 32_768, 65_406, 65_407, 65_535, 300, 400, 500,
        ];
        let samples: Vec<u8> = deep.iter().flat_map(|s| s.to_be_bytes()).collect();
        let back = written(
            extent,
            Channels::Rgb,
            Depth::Sixteen,
            &samples,
            Encoding::WebP,
            None,
        );
        let nearest: Vec<u8> = deep
            .iter()
            .map(|s| u8::try_from((2 * u32::from(*s) + 257) / 514).unwrap())
            .collect();
        assert_eq!(eight(&back), nearest);
    }

    #[test]
    fn a_profile_travels_in_every_format() {
        let extent = Extent::new(9, 7).unwrap();
        let samples = waves(extent, Channels::Rgb);
        let mut profile = vec![0; 70_000];
        profile[..4].copy_from_slice(&70_000_u32.to_be_bytes());
        profile[16..20].copy_from_slice(b"RGB ");
        profile[36..40].copy_from_slice(b"acsp");
        profile
            .iter_mut()
            .enumerate()
            .skip(200)
            .for_each(|(k, byte)| *byte = u8::try_from(k % 251).unwrap());
        for encoding in [
            Encoding::Png(Compression::Fast),
            Encoding::Jpeg {
                quality: 90,
                subsampling: Subsampling::Full,
                ground: [255; 3],
            },
            Encoding::WebP,
            TIFF,
        ] {
            let back = written(
                extent,
                Channels::Rgb,
                Depth::Eight,
                &samples,
                encoding,
                Some(&profile),
            );
            assert!(
                back.metadata.icc() == Some(profile.as_slice()),
                "{encoding:?}"
            );
        }
    }
}
