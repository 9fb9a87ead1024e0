//! Reads directories (TIFF 6.0, section 2; BigTIFF; EXIF 2.32, 4.6): tags and their values, in
//! place.

use crate::codec::metadata::resolution::{Ratio, Resolution, ResolutionUnit};
use crate::codec::{CodecError, Format, StepCounter};

pub(in crate::codec) fn bad(detail: impl ToString) -> CodecError {
    CodecError::bad(Format::Tiff.name(), detail)
}

pub(in crate::codec) fn cut_off() -> CodecError {
    bad("it is cut off before its end")
}

/// A file, its byte order, and whether it is a BigTIFF, whose offsets have 64 bits.
#[derive(Clone, Copy, Debug)]
pub(in crate::codec) struct File<'a> {
    pub(in crate::codec) bytes: &'a [u8],
    pub(in crate::codec) little: bool,
    big: bool,
}

/// A tag: its type, the number of its values, and their bytes.
#[derive(Clone, Copy, Debug)]
pub(in crate::codec) struct Entry<'a> {
    pub(in crate::codec) tag: u16,
    pub(in crate::codec) kind: u16,
    pub(in crate::codec) count: usize,
    /// Where the values are in the file.
    pub(in crate::codec) at: usize,
    pub(in crate::codec) data: &'a [u8],
}

/// The values of a tag: whole numbers of 1, 2, 4 or 8 bytes.
#[derive(Clone, Copy, Debug)]
pub(in crate::codec) struct Values<'a> {
    file: File<'a>,
    pub(in crate::codec) data: &'a [u8],
    size: usize,
}

/// One directory.
#[derive(Clone, Copy, Debug)]
pub(in crate::codec) struct Directory<'a> {
    pub(in crate::codec) file: File<'a>,
    entries: &'a [u8],
    pub(in crate::codec) next: usize,
}

/// Bytes of a value of a type.
const fn size_of_kind(kind: u16) -> Option<usize> {
    Some(match kind {
        // Bytes, text, and UTF-8 text.
        1 | 2 | 6 | 7 | 129 => 1,
        3 | 8 => 2,
        // Offsets of directories are longs.
        4 | 9 | 11 | 13 => 4,
        5 | 10 | 12 | 16..=18 => 8,
        _ => return None,
    })
}

impl<'a> File<'a> {
    /// `None` if it does not begin as one.
    pub(in crate::codec) fn new(bytes: &'a [u8]) -> Option<Self> {
        let (little, big) = match bytes {
            [b'I', b'I', 42, 0, ..] => (true, false),
            [b'M', b'M', 0, 42, ..] => (false, false),
            [b'I', b'I', 43, 0, 8, 0, 0, 0, ..] => (true, true),
            [b'M', b'M', 0, 43, 0, 8, 0, 0, ..] => (false, true),
            _ => return None,
        };
        Some(Self { bytes, little, big })
    }

    pub(in crate::codec) fn short(self, bytes: [u8; 2]) -> u16 {
        if self.little {
            u16::from_le_bytes(bytes)
        } else {
            u16::from_be_bytes(bytes)
        }
    }

    /// A whole number of at most eight bytes.
    pub(in crate::codec) fn number(self, bytes: &[u8]) -> u64 {
        let add = |number: u64, byte: &u8| number << 8 | u64::from(*byte);
        if self.little {
            bytes.iter().rev().fold(0, add)
        } else {
            bytes.iter().fold(0, add)
        }
    }

    /// Bytes of an offset.
    const fn offset_bytes(self) -> usize {
        if self.big { 8 } else { 4 }
    }

    fn offset_at(self, at: usize) -> Result<usize, CodecError> {
        let end = at.checked_add(self.offset_bytes()).ok_or_else(cut_off)?;
        let bytes = self.bytes.get(at..end).ok_or_else(cut_off)?;
        usize::try_from(self.number(bytes)).map_err(|_| cut_off())
    }

    pub(in crate::codec) fn first(self) -> Result<Directory<'a>, CodecError> {
        self.directory(self.offset_at(if self.big { 8 } else { 4 })?)
    }

    pub(in crate::codec) fn directory(self, at: usize) -> Result<Directory<'a>, CodecError> {
        let head = if self.big { 8 } else { 2 };
        let rest = self.bytes.get(at..).ok_or_else(cut_off)?;
        let (count, rest) = rest.split_at_checked(head).ok_or_else(cut_off)?;
        let count = usize::try_from(self.number(count)).map_err(|_| cut_off())?;
        let length = count.checked_mul(self.entry_bytes()).ok_or_else(cut_off)?;
        let entries = rest.get(..length).ok_or_else(cut_off)?;
        Ok(Directory {
            file: self,
            entries,
            next: self.offset_at(at + head + length)?,
        })
    }

    const fn entry_bytes(self) -> usize {
        if self.big { 20 } else { 12 }
    }
}

impl<'a> Directory<'a> {
    /// Bytes of its entries.
    pub(in crate::codec) const fn bytes(&self) -> usize {
        self.entries.len()
    }

    /// The entries whose type is known and whose values are in the file.
    pub(in crate::codec) fn entries(&self) -> impl Iterator<Item = Entry<'a>> + use<'a> {
        let file = self.file;
        self.entries
            .chunks_exact(file.entry_bytes())
            .filter_map(move |entry| Entry::parse(file, entry).ok().flatten())
    }

    /// The entry of a tag; `None` if it is absent or of an unknown type.
    pub(in crate::codec) fn entry(
        &self,
        tag: u16,
        work: &StepCounter<'_>,
    ) -> Result<Option<Entry<'a>>, CodecError> {
        let size = self.file.entry_bytes();
        work.step(1 + (self.entries.len() / size) as u64)?;
        let is_it = |entry: &&[u8]| self.file.number(&entry[..2]) == u64::from(tag);
        self.entries
            .chunks_exact(size)
            .find(is_it)
            .map_or(Ok(None), |entry| Entry::parse(self.file, entry))
    }

    /// The values of a tag; `None` if it is absent or has no whole numbers.
    pub(in crate::codec) fn values(
        &self,
        tag: u16,
        work: &StepCounter<'_>,
    ) -> Result<Option<Values<'a>>, CodecError> {
        let values = |entry: Entry<'a>| {
            let size = size_of_kind(entry.kind)
                .filter(|_| matches!(entry.kind, 1 | 3 | 4 | 7 | 13 | 16 | 18))?;
            Some(Values {
                file: self.file,
                data: entry.data,
                size,
            })
        };
        Ok(self.entry(tag, work)?.and_then(values))
    }

    /// The first value of a tag.
    pub(in crate::codec) fn number(
        &self,
        tag: u16,
        default: u32,
        work: &StepCounter<'_>,
    ) -> Result<u32, CodecError> {
        let value = self
            .values(tag, work)?
            .and_then(|values| values.get(0))
            .unwrap_or(default.into());
        u32::try_from(value)
            .map_err(|_| bad(format!("the tag {tag} has a value of more than 32 bits")))
    }

    /// The resolution, unless it says nothing.
    pub(in crate::codec) fn resolution(
        &self,
        work: &StepCounter<'_>,
    ) -> Result<Option<Resolution>, CodecError> {
        work.step(1 + (self.entries.len() / self.file.entry_bytes()) as u64)?;
        let (mut x, mut y, mut unit) = (None, None, ResolutionUnit::Inch);
        let long = |bytes: &[u8]| u32::try_from(self.file.number(bytes)).unwrap_or(0);
        for Entry {
            tag,
            kind,
            count,
            data,
            ..
        } in self.entries()
        {
            match (tag, kind, count) {
                (282, 5, 1) => x = Ratio::new(long(&data[..4]), long(&data[4..])),
                (283, 5, 1) => y = Ratio::new(long(&data[..4]), long(&data[4..])),
                (296, 3, 1) if self.file.number(data) == 1 => unit = ResolutionUnit::Unknown,
                (296, 3, 1) if self.file.number(data) == 3 => unit = ResolutionUnit::Centimetre,
                _ => {}
            }
        }
        let resolution = x.or(y).zip(y.or(x)).map(|(x, y)| Resolution { x, y, unit });
        Ok(resolution.filter(|resolution| *resolution != Resolution::SQUARE))
    }
}

impl<'a> Entry<'a> {
    /// `None` if its type is unknown.
    fn parse(file: File<'a>, entry: &'a [u8]) -> Result<Option<Self>, CodecError> {
        let (tag, kind) = (
            file.short([entry[0], entry[1]]),
            file.short([entry[2], entry[3]]),
        );
        let Some(size) = size_of_kind(kind) else {
            return Ok(None);
        };
        let (count, value) = entry[4..].split_at(file.offset_bytes());
        let count = usize::try_from(file.number(count)).map_err(|_| cut_off())?;
        let length = count.checked_mul(size).ok_or_else(cut_off)?;
        if length <= value.len() {
            let at = value.as_ptr() as usize - file.bytes.as_ptr() as usize;
            return Ok(Some(Self {
                tag,
                kind,
                count,
                at,
                data: &value[..length],
            }));
        }
        let at = usize::try_from(file.number(value)).map_err(|_| cut_off())?;
        let data = at
            .checked_add(length)
            .and_then(|end| file.bytes.get(at..end))
            .ok_or_else(cut_off)?;
        Ok(Some(Self {
            tag,
            kind,
            count,
            at,
            data,
        }))
    }
}

impl Values<'_> {
    pub(in crate::codec) const fn len(&self) -> usize {
        self.data.len() / self.size
    }

    pub(in crate::codec) fn get(&self, index: usize) -> Option<u64> {
        let at = index.checked_mul(self.size)?;
        self.data
            .get(at..at.checked_add(self.size)?)
            .map(|bytes| self.file.number(bytes))
    }
}
