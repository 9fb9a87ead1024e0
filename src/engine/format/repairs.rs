//! What was imperfect about a file whose pixels are complete.

/// What was mended to read a file.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, PartialOrd, Ord, Hash)]
pub struct Repairs {
    /// A part that no pixel needs has a wrong checksum, and is left out.
    pub checksum: bool,
    /// The file ends behind its pixels without the mark of its end.
    pub end: bool,
    /// There are bytes between two parts.
    pub gap: bool,
}

impl Repairs {
    /// Whether the file was perfect.
    #[must_use]
    pub const fn is_empty(self) -> bool {
        !(self.checksum || self.end || self.gap)
    }

    /// Their names.
    pub fn names(self) -> impl Iterator<Item = &'static str> {
        let all = [
            (self.checksum, "wrong checksum"),
            (self.end, "no end of the file"),
            (self.gap, "bytes between segments"),
        ];
        all.into_iter()
            .filter_map(|(is_so, name)| is_so.then_some(name))
    }
}
