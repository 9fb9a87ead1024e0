//! The page of a TIFF that is read, and its tags.

use crate::codec::ifd::read::{Directory, File, bad};
use crate::codec::orientation::ExifOrientation;
use crate::codec::{CodecError, StepCounter};

/// Directories of a file; more are a loop, or nothing that an image needs.
const MOST_DIRECTORIES: u32 = 4096;

/// What a directory is: bit 0 marks a copy in less detail, bit 2 a mask.
const NEW_SUBFILE_TYPE: u16 = 254;
const REDUCED_COPY_BIT: u32 = 0b001;
const MASK_BIT: u32 = 0b100;
const SUB_DIRECTORIES: u16 = 330;

/// A well-formed file of a kind that is not read.
pub(super) fn unsupported(what: impl std::fmt::Display) -> CodecError {
    CodecError::unsupported(format!(
        "a TIFF {what}. Of TIFF, the following is read: one page of grey, palette, or RGB, with \
            at most one sample of alpha; \
         unsigned samples of 1, 2, 4, 8 or 16 bits (labels also of 32 and 64 bits); not \
         compressed, or LZW, deflate, PackBits, \
         CCITT group 4, JPEG"
    ))
}

/// The only page, and whether the file has a mask beside it. Copies of a page in less detail and
/// masks are no pages, unless the file has nothing else.
pub(super) fn only_page<'a>(
    file: File<'a>,
    work: &StepCounter<'_>,
) -> Result<(Directory<'a>, bool), CodecError> {
    let first = file.first()?;
    let (mut page, mut pages, mut has_mask) = (None, 0, false);
    let (mut directory, mut bytes) = (first, first.bytes());
    for _ in 0..MOST_DIRECTORIES {
        let kind = directory.number(NEW_SUBFILE_TYPE, 0, work)?;
        has_mask |= kind & MASK_BIT != 0;
        if kind & (REDUCED_COPY_BIT | MASK_BIT) == 0 {
            page = Some(directory);
            pages += 1;
        }
        if directory.next == 0 {
            return match (page, pages) {
                (Some(page), 1) => Ok((page, has_mask)),
                (Some(_), _) => Err(CodecError::TooLarge {
                    what: "image_frames",
                    limit: 1,
                    actual: pages,
                }),
                // Raw files of cameras: the first directory is a preview, the image is below it.
                (None, _) if first.values(SUB_DIRECTORIES, work)?.is_some() => Err(unsupported(
                    "that holds a preview, with the picture in a subdirectory, like the raw files \
                        of cameras",
                )),
                (None, _) => Ok((first, false)),
            };
        }
        directory = file.directory(directory.next)?;
        bytes += directory.bytes();
        if bytes > file.bytes.len() {
            return Err(bad("directories that overlap"));
        }
    }
    Err(bad(format!("more than {MOST_DIRECTORIES} directories")))
}

/// The first value of a tag; an error if others differ from it. One value serves for all samples of
/// a pixel.
pub(super) fn uniform(
    page: &Directory<'_>,
    tag: u16,
    default: u32,
    what: &str,
    work: &StepCounter<'_>,
) -> Result<u32, CodecError> {
    let Some(values) = page.values(tag, work)? else {
        return Ok(default);
    };
    let first = values.get(0).unwrap_or(default.into());
    work.step(values.len() as u64)?;
    if (1..values.len()).any(|index| values.get(index) != Some(first)) {
        return Err(unsupported(format_args!(
            "whose samples differ in their {what}"
        )));
    }
    u32::try_from(first).map_err(|_| bad(format!("the {what} of its samples is {first}")))
}

pub(super) fn orientation(
    page: &Directory<'_>,
    work: &StepCounter<'_>,
) -> Result<ExifOrientation, CodecError> {
    let number = page.number(274, 1, work)?;
    Ok(u16::try_from(number)
        .ok()
        .and_then(ExifOrientation::from_number)
        .unwrap_or_default())
}
