//! The item of a file that is read, where a file may have several: specimens, images, persons,
//! rows.

use super::bad::Bad;
use crate::problem::words::{LONGEST_QUOTE, quote};
use crate::problem::{Code, Problem};
use crate::wire::json::{Kind, Node};
use crate::wire::number::whole;

/// The longest name of an item as it is written, bytes.
pub(super) const LONGEST_NAME: usize = 4096;
/// The most items that the sentence of an error lists.
const MOST_LISTED: usize = 12;
/// The most items that an error has the names of, and the bytes of these.
const MOST_NAMED: usize = 1000;
const MOST_NAMED_BYTES: usize = 64 << 10;

/// Which item is read.
#[derive(Clone, Debug, PartialEq, Eq)]
pub enum Item {
    /// By its place in the file, from 0.
    Index(usize),
    /// By its name.
    Name(String),
    /// By its name, or else by its place: where numbers and names are written alike.
    Text(String),
}

impl Item {
    pub(crate) fn read(node: &Node<'_, '_>) -> Result<Self, Problem> {
        const EXPECTED: &str = "the index or the name of an item";
        match node.kind() {
            Kind::String => node.string(EXPECTED).map(Self::Name),
            Kind::Number => {
                let index = whole(node, EXPECTED)?;
                usize::try_from(index)
                    .map(Self::Index)
                    .map_err(|_| node.problem(Code::BadValue, EXPECTED))
            }
            _ => Err(node.wrong_kind(EXPECTED)),
        }
    }

    fn text(&self) -> String {
        match self {
            Self::Index(index) => index.to_string(),
            Self::Name(name) | Self::Text(name) => quote(name),
        }
    }
}

/// What is left of the wanted name behind pieces that names of several items begin with: where its
/// rest begins, bytes. `None`: the wanted name begins otherwise.
#[derive(Clone, Copy, Debug, Default)]
pub(super) struct WantedRest(Option<u32>);

/// A name of an item: pieces, and what tells the item from others with these pieces, with slashes
/// between them. The pieces may be long and of many items, so they are compared once for all of
/// them, and neither copied nor put together for each.
#[derive(Clone, Copy, Debug)]
pub(super) struct ItemName<'a> {
    pub(super) pieces: &'a [&'a str],
    /// Empty: the pieces are the name.
    pub(super) part: &'a str,
    /// That of the pieces.
    pub(super) rest: WantedRest,
}

impl ItemName<'_> {
    fn texts(&self) -> impl Iterator<Item = &str> {
        let part = Some(self.part).filter(|part| !part.is_empty());
        let pieces = self.pieces.iter().copied().chain(part).enumerate();
        pieces.flat_map(|(k, piece)| [&"/"[..k.min(1)], piece])
    }

    fn len(&self) -> usize {
        self.texts().map(str::len).sum()
    }

    /// As an error quotes it, which takes its beginning only.
    fn quoted(&self) -> String {
        let start = self.texts().flat_map(str::chars).take(LONGEST_QUOTE + 1);
        quote(&start.collect::<String>())
    }
}

/// The items of a file, as they come.
#[derive(Debug)]
pub(super) struct Items {
    wanted: Option<Item>,
    /// The place that the wanted item has, if it is a number.
    wanted_index: Option<usize>,
    count: usize,
    /// The first ones, as an error names them.
    listed: Vec<String>,
    /// All names of the first ones, in their order, and the bytes of that.
    named: Vec<Vec<String>>,
    named_bytes: usize,
    /// Where the second one is, bytes.
    second: usize,
    /// Whether the wanted one was found, and by its name.
    found: Option<bool>,
}

/// What is to be done with an item.
#[derive(Clone, Copy, PartialEq, Eq)]
pub(super) enum ItemAction {
    Skip,
    Read,
    /// Its name is wanted, and an earlier item was read because its index is written like that
    /// name: read this one, and forget the earlier one.
    ReadInstead,
}

impl Items {
    pub(super) fn new(wanted: Option<Item>) -> Self {
        let wanted_index = match &wanted {
            None => Some(0),
            Some(Item::Index(index)) => Some(*index),
            Some(Item::Name(_)) => None,
            Some(Item::Text(text)) => text.parse().ok(),
        };
        Self {
            wanted,
            wanted_index,
            count: 0,
            listed: Vec::new(),
            named: Vec::new(),
            named_bytes: 0,
            second: 0,
            found: None,
        }
    }

    fn wanted_name(&self) -> Option<&str> {
        match &self.wanted {
            None | Some(Item::Index(_)) => None,
            Some(Item::Name(name)) => Some(name),
            Some(Item::Text(name)) => Some(name.trim()),
        }
    }

    /// What is left of the wanted name behind these pieces.
    pub(super) fn rest(&self, pieces: &[&str]) -> WantedRest {
        let of_name = |name: &str| {
            let mut rest = name;
            for (k, piece) in pieces.iter().enumerate() {
                rest = rest.strip_prefix(&"/"[..k.min(1)])?.strip_prefix(piece)?;
            }
            u32::try_from(name.len() - rest.len()).ok()
        };
        WantedRest(self.wanted_name().and_then(of_name))
    }

    fn is_wanted(&self, ItemName { part, rest, .. }: &ItemName<'_>) -> bool {
        let Some(rest) = self.wanted_name().zip(rest.0) else {
            return false;
        };
        match &rest.0[rest.1 as usize..] {
            rest if part.is_empty() => rest.is_empty(),
            rest => rest.strip_prefix('/') == Some(part),
        }
    }

    /// Whether errors may name the next item. Of others only the rest of the wanted name matters,
    /// and the pieces need not be there.
    pub(super) fn may_name_next(&self) -> bool {
        self.count < MOST_LISTED || self.count < MOST_NAMED && self.named.len() == self.count
    }

    /// The next item has these names.
    /// Errors: A second item with the wanted name.
    pub(super) fn next(&mut self, at: usize, names: &[ItemName<'_>]) -> Result<ItemAction, Bad> {
        let index = self.count;
        if index == 1 {
            self.second = at;
        }
        if self.may_name_next() {
            self.name_next(names);
        }
        self.count += 1;
        let is_index = self.wanted_index == Some(index);
        let is_name = names.iter().any(|name| self.is_wanted(name));
        match (is_name, is_index, self.found) {
            (true, _, Some(true)) => {
                let name = self.wanted.as_ref().map(Item::text).unwrap_or_default();
                Err(Bad::new(
                    at,
                    format!(
                        "expected one item named {name}; found a second: send `item` as an index, \
                            such as {index}"
                    ),
                ))
            }
            (true, _, before) => {
                self.found = Some(true);
                Ok(if before.is_some() {
                    ItemAction::ReadInstead
                } else {
                    ItemAction::Read
                })
            }
            (false, true, None) => {
                self.found = Some(false);
                Ok(ItemAction::Read)
            }
            _ => Ok(ItemAction::Skip),
        }
    }

    /// Keeps the names of the next item, as far as errors have them.
    fn name_next(&mut self, names: &[ItemName<'_>]) {
        let lengths = names.iter().map(ItemName::len);
        let named = || {
            names
                .iter()
                .zip(lengths.clone())
                .filter(|(_, length)| *length > 0)
        };
        if self.listed.len() < MOST_LISTED {
            let quoted: Vec<String> = named().map(|(name, _)| name.quoted()).collect();
            let listed = format!("{} {}", self.count, quoted.join(" "));
            self.listed.push(listed.trim_end().to_owned());
        }
        let bytes: usize = lengths.clone().map(|length| length + 1).sum();
        let has_room = self.named.len() < MOST_NAMED
            && self.named_bytes.saturating_add(bytes) <= MOST_NAMED_BYTES;
        // The order of the names says whose they are, so none are kept after a gap.
        if has_room && self.named.len() == self.count {
            let texts = named().map(|(name, _)| name.texts().collect());
            self.named.push(texts.collect());
            self.named_bytes += bytes;
        }
    }

    /// The names of the first items.
    fn list(&self, what: &str) -> String {
        let more = self.count - self.listed.len();
        let more = if more > 0 {
            format!(", and {more} more")
        } else {
            String::new()
        };
        format!("{} {what}: {}{more}", self.count, self.listed.join(", "))
    }

    /// `what`: what the items are; `end`: where the file ends.
    /// Errors: Several items and none was chosen, or the chosen one is not there.
    pub(super) fn check(&self, what: &str, end: usize) -> Result<(), Bad> {
        // A file of a format without items counts as one item.
        let is_only = self.count == 0 && matches!(&self.wanted, Some(Item::Index(0)));
        let is_only = is_only || self.count == 0 && self.wanted == Some(Item::Text("0".to_owned()));
        match &self.wanted {
            None if self.count > 1 => {
                let detail = format!(
                    "expected `item`, the index or name of one, because the file has {}",
                    self.list(what)
                );
                Err(Bad::new(self.second, detail).items(self.named.clone(), self.count))
            }
            Some(item) if self.found.is_none() && !is_only => {
                let found = if self.count == 0 {
                    "one item, without a name".to_owned()
                } else {
                    self.list(what)
                };
                let detail = format!("expected the item {}; the file has {found}", item.text());
                Err(Bad::new(end, detail).items(self.named.clone(), self.count))
            }
            _ => Ok(()),
        }
    }
}

/// A name in JSON, a text or a number. Its length is limited before it is copied.
pub(super) fn name_in(node: &Node<'_, '_>) -> Result<String, Problem> {
    const EXPECTED: &str = "a name or a number";
    match node.kind() {
        _ if node.text.len() > LONGEST_NAME => Err(node.unexpected(
            &format!("a name of at most {LONGEST_NAME} bytes"),
            quote(node.text),
        )),
        Kind::String => node.string(EXPECTED),
        Kind::Number => Ok(node.text.to_owned()),
        _ => Err(node.wrong_kind(EXPECTED)),
    }
}

/// The names of the items of one image: the file of the image, with its folders and without, and
/// the latter with what tells the item from the others of the image.
#[derive(Clone, Copy, Debug, Default)]
pub(super) struct ImageNames {
    /// Where the name without folders begins, bytes.
    short: u32,
    rests: [WantedRest; 2],
}

impl ImageNames {
    pub(super) fn new(file: &str, items: &Items) -> Self {
        let short = file.rfind(['/', '\\']).map_or(0, |folders| folders + 1);
        Self {
            short: u32::try_from(short).unwrap_or_default(),
            rests: [items.rest(&[file]), items.rest(&[&file[short..]])],
        }
    }

    /// Calls `use_names` with the names of an item. `file`: as before, or empty if errors do not
    /// name the item. `part`: empty if the image has one item.
    pub(super) fn with<T>(
        &self,
        file: &str,
        part: &str,
        use_names: impl FnOnce(&[ItemName<'_>]) -> T,
    ) -> T {
        let short = [file.get(self.short as usize..).unwrap_or_default()];
        let (file, [rest, short_rest]) = ([file], self.rests);
        let name = |pieces, part, rest| ItemName { pieces, part, rest };
        let (whole, only) = (name(&file, "", rest), name(&short, "", short_rest));
        let of_part = name(&short, part, short_rest);
        match (self.short > 0, part.is_empty()) {
            (false, true) => use_names(&[whole]),
            (true, true) => use_names(&[whole, only]),
            (false, false) => use_names(&[whole, of_part]),
            (true, false) => use_names(&[whole, only, of_part]),
        }
    }
}
