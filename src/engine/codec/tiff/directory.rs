//! The directories of a TIFF: tags and their values, read in place.

use crate::codec::orientation::Orientation;
use crate::codec::{CodecError, Format, StepCounter};

/// Directories of a file; more are a loop, or nothing that a picture needs.
const MOST_DIRECTORIES: u32 = 4096;

/// What a directory is: bit 0 marks a copy in less detail, bit 2 a mask.
const NEW_SUBFILE_TYPE: u16 = 254;
const SUB_DIRECTORIES: u16 = 330;

/// A well-formed file of a kind that is not read.
pub(super) fn unsupported(what: impl std::fmt::Display) -> CodecError {
    CodecError::unsupported(format!(
        "a TIFF {what}. Of TIFF, the following is read: one page of grey, palette, or RGB; unsigned samples of 1, 2, 4, 8 or 16 bits, \
         interleaved; not compressed, or LZW, deflate, PackBits"
    ))
}

pub(super) fn bad(detail: impl ToString) -> CodecError {
    CodecError::bad(Format::Tiff.name(), detail)
}

pub(super) fn cut_off() -> CodecError {
    bad("it is cut off before its end")
}

/// A file and its byte order.
#[derive(Clone, Copy, Debug)]
pub(super) struct File<'a> {
    pub(super) bytes: &'a [u8],
    pub(super) little: bool,
}

/// The values of a tag: bytes, shorts or longs.
#[derive(Clone, Copy, Debug)]
pub(super) struct Values<'a> {
    file: File<'a>,
    pub(super) data: &'a [u8],
    size: usize,
}

/// One directory: its entries of twelve bytes.
#[derive(Clone, Copy, Debug)]
pub(super) struct Directory<'a> {
    file: File<'a>,
    entries: &'a [u8],
    next: usize,
}

impl<'a> File<'a> {
    pub(super) fn new(bytes: &'a [u8]) -> Self {
        Self { bytes, little: bytes.first() == Some(&b'I') }
    }

    pub(super) fn short(self, bytes: [u8; 2]) -> u16 {
        if self.little { u16::from_le_bytes(bytes) } else { u16::from_be_bytes(bytes) }
    }

    fn long(self, bytes: [u8; 4]) -> u32 {
        if self.little { u32::from_le_bytes(bytes) } else { u32::from_be_bytes(bytes) }
    }

    fn long_at(self, at: usize) -> Result<usize, CodecError> {
        let bytes = self.bytes.get(at..).and_then(|rest| rest.first_chunk()).ok_or_else(cut_off)?;
        usize::try_from(self.long(*bytes)).map_err(bad)
    }

    /// The directory of the only page. Copies of a page in less detail and masks are no pages, unless the file has nothing else.
    pub(super) fn only_page(self, work: &StepCounter<'_>) -> Result<Directory<'a>, CodecError> {
        let first = self.directory(self.long_at(4)?)?;
        let (mut page, mut pages, mut directory, mut bytes) = (None, 0, first, first.entries.len());
        for _ in 0..MOST_DIRECTORIES {
            if directory.number(NEW_SUBFILE_TYPE, 0, work)? & 0b101 == 0 {
                page = Some(directory);
                pages += 1;
            }
            if directory.next == 0 {
                return match (page, pages) {
                    (Some(page), 1) => Ok(page),
                    (Some(_), _) => Err(CodecError::TooLarge { what: "image_frames", limit: 1, actual: pages }),
                    // Raw files of cameras: the first directory is a preview, the picture is below it.
                    (None, _) if first.values(SUB_DIRECTORIES, work)?.is_some() => {
                        Err(unsupported("that holds a preview, with the picture in a subdirectory, like the raw files of cameras"))
                    }
                    (None, _) => Ok(first),
                };
            }
            directory = self.directory(directory.next)?;
            bytes += directory.entries.len();
            if bytes > self.bytes.len() {
                return Err(bad("directories that overlap"));
            }
        }
        Err(bad(format!("more than {MOST_DIRECTORIES} directories")))
    }

    fn directory(self, at: usize) -> Result<Directory<'a>, CodecError> {
        let rest = self.bytes.get(at..).ok_or_else(cut_off)?;
        let (count, rest) = rest.split_first_chunk().ok_or_else(cut_off)?;
        let length = 12 * usize::from(self.short(*count));
        let entries = rest.get(..length).ok_or_else(cut_off)?;
        Ok(Directory { file: self, entries, next: self.long_at(at + 2 + length)? })
    }
}

impl<'a> Directory<'a> {
    /// The values of a tag; `None` if it is absent or of another type.
    pub(super) fn values(&self, tag: u16, work: &StepCounter<'_>) -> Result<Option<Values<'a>>, CodecError> {
        work.step(1 + self.entries.len() as u64 / 12)?;
        let Some(entry) = self.entries.as_chunks::<12>().0.iter().find(|entry| self.file.short([entry[0], entry[1]]) == tag) else {
            return Ok(None);
        };
        let size = match self.file.short([entry[2], entry[3]]) {
            1 | 7 => 1,
            3 => 2,
            // Offsets of directories are longs.
            4 | 13 => 4,
            _ => return Ok(None),
        };
        let [.., c0, c1, c2, c3, o0, o1, o2, o3] = *entry;
        let length = usize::try_from(self.file.long([c0, c1, c2, c3])).ok().and_then(|count| count.checked_mul(size));
        let length = length.ok_or_else(cut_off)?;
        let data = if length <= 4 {
            &entry[8..8 + length]
        } else {
            let at = usize::try_from(self.file.long([o0, o1, o2, o3])).map_err(bad)?;
            at.checked_add(length).and_then(|end| self.file.bytes.get(at..end)).ok_or_else(cut_off)?
        };
        Ok(Some(Values { file: self.file, data, size }))
    }

    /// The first value of a tag.
    pub(super) fn number(&self, tag: u16, default: u32, work: &StepCounter<'_>) -> Result<u32, CodecError> {
        Ok(self.values(tag, work)?.and_then(|values| values.get(0)).unwrap_or(default))
    }

    /// Like [`Self::number`]; an error if other values differ from the first. One value serves for all samples of a pixel.
    pub(super) fn uniform(&self, tag: u16, default: u32, what: &str, work: &StepCounter<'_>) -> Result<u32, CodecError> {
        let Some(values) = self.values(tag, work)? else { return Ok(default) };
        let first = values.get(0).unwrap_or(default);
        work.step(values.len() as u64)?;
        if (1..values.len()).any(|index| values.get(index) != Some(first)) {
            return Err(unsupported(format_args!("whose samples differ in their {what}")));
        }
        Ok(first)
    }

    pub(super) fn orientation(&self, work: &StepCounter<'_>) -> Result<Orientation, CodecError> {
        let number = self.number(274, 1, work)?;
        Ok(u16::try_from(number).ok().and_then(Orientation::from_number).unwrap_or_default())
    }
}

impl Values<'_> {
    pub(super) const fn len(&self) -> usize {
        self.data.len() / self.size
    }

    pub(super) fn get(&self, index: usize) -> Option<u32> {
        let bytes = self.data.get(index.checked_mul(self.size)?..)?;
        match self.size {
            1 => bytes.first().map(|byte| u32::from(*byte)),
            2 => bytes.first_chunk().map(|short| u32::from(self.file.short(*short))),
            _ => bytes.first_chunk().map(|long| self.file.long(*long)),
        }
    }
}
