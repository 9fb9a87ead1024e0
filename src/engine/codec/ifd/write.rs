//! Writes directories: values that do not fit into an entry are appended before the directory.

pub(in crate::codec) const BYTE: u16 = 1;
pub(in crate::codec) const TYPE_SHORT: u16 = 3;
pub(in crate::codec) const TYPE_LONG: u16 = 4;
pub(in crate::codec) const RATIONAL: u16 = 5;
pub(in crate::codec) const UNDEFINED: u16 = 7;

/// A directory that is being written.
#[derive(Debug)]
pub(in crate::codec) struct DirectoryWriter<'a> {
    out: &'a mut Vec<u8>,
    /// Where the file begins in `out`, or the bytes of it that come before.
    start: usize,
    before: usize,
    little: bool,
    entries: Vec<(u16, [u8; 12])>,
}

pub(in crate::codec) fn offset(bytes: usize) -> u32 {
    u32::try_from(bytes).expect("the target was held against the format's largest size")
}

impl<'a> DirectoryWriter<'a> {
    /// A directory of the file that begins at `start` in `out`.
    pub(in crate::codec) const fn of(out: &'a mut Vec<u8>, start: usize, little: bool) -> Self {
        Self {
            out,
            start,
            before: 0,
            little,
            entries: Vec::new(),
        }
    }

    /// A big-endian directory behind this number of bytes of the file; `out` is what follows them.
    pub(in crate::codec) const fn after(out: &'a mut Vec<u8>, before: usize) -> Self {
        Self {
            out,
            start: 0,
            before,
            little: false,
            entries: Vec::new(),
        }
    }

    /// Bytes of the file so far.
    const fn length(&self) -> usize {
        self.before + self.out.len() - self.start
    }

    fn two(&self, number: u16) -> [u8; 2] {
        if self.little {
            number.to_le_bytes()
        } else {
            number.to_be_bytes()
        }
    }

    fn four(&self, number: u32) -> [u8; 4] {
        if self.little {
            number.to_le_bytes()
        } else {
            number.to_be_bytes()
        }
    }

    /// Adds values in the byte order of the file.
    pub(in crate::codec) fn entry(&mut self, tag: u16, kind: u16, count: usize, data: &[u8]) {
        let mut value = [0; 4];
        if data.len() <= 4 {
            value[..data.len()].copy_from_slice(data);
        } else {
            self.align();
            value = self.four(offset(self.length()));
            self.out.extend_from_slice(data);
        }
        self.placed(tag, kind, count, value);
    }

    /// Adds an entry whose values are elsewhere in the file.
    pub(in crate::codec) fn placed(&mut self, tag: u16, kind: u16, count: usize, value: [u8; 4]) {
        let mut entry = [0; 12];
        entry[..2].copy_from_slice(&self.two(tag));
        entry[2..4].copy_from_slice(&self.two(kind));
        entry[4..8].copy_from_slice(&self.four(offset(count)));
        entry[8..].copy_from_slice(&value);
        self.entries.push((tag, entry));
    }

    pub(in crate::codec) fn short(&mut self, tag: u16, value: u16) {
        self.entry(tag, TYPE_SHORT, 1, &self.two(value));
    }

    pub(in crate::codec) fn long(&mut self, tag: u16, value: u32) {
        self.entry(tag, TYPE_LONG, 1, &self.four(value));
    }

    pub(in crate::codec) fn longs(&mut self, tag: u16, values: &[u32]) {
        let data: Vec<u8> = values.iter().flat_map(|value| self.four(*value)).collect();
        self.entry(tag, TYPE_LONG, values.len(), &data);
    }

    pub(in crate::codec) fn ratio(&mut self, tag: u16, numerator: u32, denominator: u32) {
        let data = [self.four(numerator), self.four(denominator)].concat();
        self.entry(tag, RATIONAL, 1, &data);
    }

    /// Values and directories begin at even offsets.
    fn align(&mut self) {
        if !self.length().is_multiple_of(2) {
            self.out.push(0);
        }
    }

    /// Appends the directory, and enters its place at the beginning of the file.
    pub(in crate::codec) fn close(self) {
        let (field, little) = (self.start + 4..self.start + 8, self.little);
        let (at, out) = self.append();
        let at = offset(at);
        out[field].copy_from_slice(&if little {
            at.to_le_bytes()
        } else {
            at.to_be_bytes()
        });
    }

    /// Appends the directory; returns where it begins in the file.
    pub(in crate::codec) fn finish(self) -> usize {
        self.append().0
    }

    fn append(mut self) -> (usize, &'a mut Vec<u8>) {
        self.align();
        let at = self.length();
        // Readers search them in this order.
        self.entries.sort_by_key(|(tag, _)| *tag);
        let count = self.two(u16::try_from(self.entries.len()).expect("a few entries"));
        self.out.extend_from_slice(&count);
        self.entries
            .iter()
            .for_each(|(_, entry)| self.out.extend_from_slice(entry));
        self.out.extend_from_slice(&[0; 4]);
        (at, self.out)
    }
}
