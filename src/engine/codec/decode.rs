//! Decodes a file to an upright image. Order: header, limits, completeness of the file's
//! structure, memory, pixels. The decoders are third-party code that reads hostile bytes, so they
//! run with their own limits and inside `catch_unwind`: a panic there means a damaged file, not a
//! crash. Allocations made here are fallible. Cost: one pass of the decoder; a second image only
//! when the orientation swaps the sides.

use std::panic::{AssertUnwindSafe, catch_unwind};

use super::probe::Parsed;
use super::{CodecError, Header, ImageLimits, Metadata, Repairs, SourceFormat, StepCounter};
use crate::pixmap::{Channels, Pixmap, Samples};

/// An upright image, and what its file says about it.
#[derive(Debug)]
pub struct Decoded {
    /// The upright pixels.
    pub pixmap: Pixmap,
    /// What is written back.
    pub metadata: Metadata,
    /// What of the file was mended.
    pub repairs: Repairs,
}

/// A file whose header has passed the limits.
#[derive(Debug)]
pub struct Opened<'a> {
    pub(super) parsed: Parsed<'a>,
    pub(super) header: Header,
    pub(super) work: &'a StepCounter<'a>,
}

/// Reads the header of an image and checks it against `limits` before anything grows with the
/// sizes that it claims; then reads the rest of what determines the memory for decoding.
///
/// # Errors
/// Those of [`super::probe`]; [`CodecError::TooLarge`] by `limits`; [`CodecError::Cancelled`].
pub fn open<'a>(
    bytes: &'a [u8],
    limits: &ImageLimits,
    work: &'a StepCounter<'a>,
) -> Result<Opened<'a>, CodecError> {
    let opened = open_any(bytes, limits, work)?;
    opened.parsed.check_picture()?;
    Ok(opened)
}

/// Like [`open`], also for files that can only be read as labels.
pub(super) fn open_any<'a>(
    bytes: &'a [u8],
    limits: &ImageLimits,
    work: &'a StepCounter<'a>,
) -> Result<Opened<'a>, CodecError> {
    let mut parsed = Parsed::new(bytes, work)?;
    limits.check(parsed.header().extent)?;
    if let Parsed::WebP(file) = &mut parsed {
        file.read_codes(work)?;
    }
    let header = parsed.header();
    Ok(Opened {
        parsed,
        header,
        work,
    })
}

/// Opens and decodes a file; stops early when `cancelled` returns true.
///
/// # Errors
/// Those of [`open`] and [`Opened::decode`].
///
/// ```
/// use mlswarp::codec::{ImageLimits, decode};
/// let file = include_bytes!("../test_files/images/chelsea.png");
/// let image = decode(file, &ImageLimits::default(), &|| false)?;
/// assert_eq!(image.pixmap.extent().width(), 451);
/// # Ok::<(), mlswarp::codec::CodecError>(())
/// ```
pub fn decode(
    bytes: &[u8],
    limits: &ImageLimits,
    cancelled: &dyn Fn() -> bool,
) -> Result<Decoded, CodecError> {
    open(bytes, limits, &StepCounter::new(cancelled))?.decode()
}

impl Opened<'_> {
    /// The header. `decode_bytes` is exact here where [`super::probe`] only knows an upper bound.
    #[must_use]
    pub const fn header(&self) -> Header {
        self.header
    }

    /// Decodes the image.
    ///
    /// # Errors
    /// [`CodecError::Bad`] for a file that lacks pixels, whose pixels are damaged, or that makes a
    /// decoder panic. Bytes after the file's end are ignored. [`CodecError::Cancelled`].
    pub fn decode(&self) -> Result<Decoded, CodecError> {
        let Self {
            parsed,
            header,
            work,
        } = self;
        // A decoder whose input is withheld reports damage.
        let wanted = |error| {
            if work.is_cancelled() {
                CodecError::Cancelled
            } else {
                error
            }
        };
        let (samples, repairs) = contained(header.format, || match parsed {
            Parsed::Png(file) => Ok((file.samples(header.decode_bytes, work)?, file.repairs)),
            Parsed::Jpeg(file) => file.samples(work),
            Parsed::WebP(file) => Ok((file.samples(work)?, file.repairs)),
            Parsed::Tiff(file) => file.samples(work),
            Parsed::Gif(file) => Ok((file.samples(work)?, file.repairs())),
            Parsed::Bmp(file) => Ok((file.samples(work)?, Repairs::default())),
        })
        .map_err(wanted)?;

        let (stored, orientation) = parsed.stored();
        let width = stored.width() as usize;
        let upright = match (samples, header.channels) {
            (Samples::Eight(s), Channels::Rgb) => orientation
                .apply::<_, 3>(s, width, work)
                .map(Samples::Eight),
            (Samples::Eight(s), Channels::Rgba) => orientation
                .apply::<_, 4>(s, width, work)
                .map(Samples::Eight),
            (Samples::Sixteen(s), Channels::Rgb) => orientation
                .apply::<_, 3>(s, width, work)
                .map(Samples::Sixteen),
            (Samples::Sixteen(s), Channels::Rgba) => orientation
                .apply::<_, 4>(s, width, work)
                .map(Samples::Sixteen),
        }?;

        let (has_profile, icc) = match parsed {
            Parsed::Png(file) => (file.has_profile(), file.icc(work)),
            Parsed::Jpeg(file) => (file.has_profile(), file.icc()),
            Parsed::WebP(file) => (file.has_profile(), file.icc()),
            Parsed::Tiff(file) => (file.has_profile(), file.icc()),
            Parsed::Gif(file) => (file.has_profile(), file.icc(work)),
            Parsed::Bmp(file) => (file.has_profile(), file.icc()),
        };
        work.check()?;
        let metadata = Metadata::new(
            &parsed.found(work),
            (has_profile, icc.as_deref()),
            orientation.swaps_sides(),
            work,
        )?;
        let is_opaque = self.is_opaque(&upright)?;
        Ok(Decoded {
            pixmap: Pixmap::of_opacity(header.extent, header.channels, upright, is_opaque),
            metadata,
            repairs,
        })
    }

    /// Whether no pixel is transparent.
    fn is_opaque(&self, samples: &Samples) -> Result<bool, CodecError> {
        let Header {
            extent, channels, ..
        } = self.header;
        let row = extent.width() as usize * channels.count();
        for y in 0..extent.height() as usize {
            self.work.step(extent.width().into())?;
            let is_opaque = match samples {
                _ if channels == Channels::Rgb => true,
                Samples::Eight(samples) => {
                    crate::pixmap::is_opaque(&samples[y * row..][..row], u8::MAX)
                }
                Samples::Sixteen(samples) => {
                    crate::pixmap::is_opaque(&samples[y * row..][..row], u16::MAX)
                }
            };
            if !is_opaque {
                return Ok(false);
            }
        }
        Ok(true)
    }
}

/// Treats a panic of the decoder as a damaged file.
fn contained<T>(
    format: SourceFormat,
    decoder: impl FnOnce() -> Result<T, CodecError>,
) -> Result<T, CodecError> {
    catch_unwind(AssertUnwindSafe(decoder))
        .unwrap_or_else(|_| Err(CodecError::bad(format.name(), "the decoder gave up")))
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::codec::Format;

    #[test]
    fn a_decoder_that_panics_has_met_a_damaged_file() {
        let given_up =
            contained::<()>(SourceFormat::Written(Format::WebP), || panic!("on purpose"))
                .unwrap_err();
        assert_eq!(
            given_up,
            CodecError::Bad {
                format: "WebP",
                detail: "the decoder gave up".to_owned()
            }
        );
        assert_eq!(
            contained(SourceFormat::Written(Format::Gif), || Ok(7)),
            Ok(7)
        );
    }

    /// png 0.18.1 panics on a palette whose length is no multiple of three; found by fuzzing.
    #[test]
    fn a_palette_of_no_whole_colours_is_a_damaged_file() {
        let file = include_bytes!("../test_files/found/png-palette-not-of-threes");
        assert!(matches!(
            decode(file, &ImageLimits::default(), &|| false),
            Err(CodecError::Bad { format: "PNG", .. })
        ));
    }
}
