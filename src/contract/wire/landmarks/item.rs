//! The item of a file that is read, where a file may have several: specimens, images, persons,
//! rows.

use super::bad::Bad;
use crate::problem::words::quote;
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

/// The items of a file, as they come.
#[derive(Debug)]
pub(super) struct Items {
    wanted: Option<Item>,
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
        Self {
            wanted,
            count: 0,
            listed: Vec::new(),
            named: Vec::new(),
            named_bytes: 0,
            second: 0,
            found: None,
        }
    }

    /// The next item has these names.
    /// Errors: A second item with the wanted name.
    pub(super) fn next(&mut self, at: usize, names: &[&str]) -> Result<ItemAction, Bad> {
        let index = self.count;
        self.count += 1;
        if index == 1 {
            self.second = at;
        }
        if self.listed.len() < MOST_LISTED {
            let names: Vec<String> = names
                .iter()
                .filter(|name| !name.is_empty())
                .map(|name| quote(name))
                .collect();
            self.listed
                .push(format!("{index} {}", names.join(" ")).trim_end().to_owned());
        }
        self.name(names);
        let (is_index, is_name) = match &self.wanted {
            None => (index == 0, false),
            Some(Item::Index(wanted)) => (index == *wanted, false),
            Some(Item::Name(wanted)) => (false, names.contains(&wanted.as_str())),
            Some(Item::Text(wanted)) => {
                (wanted.parse() == Ok(index), names.contains(&wanted.trim()))
            }
        };
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

    /// Keeps the names of an item.
    fn name(&mut self, names: &[&str]) {
        let bytes: usize = names.iter().map(|name| name.len() + 1).sum();
        let has_room = self.named.len() < MOST_NAMED
            && self.named_bytes.saturating_add(bytes) <= MOST_NAMED_BYTES;
        // The order of the names says whose they are, so none are kept after a gap.
        if has_room && self.named.len() + 1 == self.count {
            let names = names.iter().filter(|name| !name.is_empty());
            self.named
                .push(names.map(|name| (*name).to_owned()).collect());
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

/// The names of an item in a file of several images: the file of its image, with its folders and
/// without, and the latter with what tells the item from the others of the image.
#[derive(Debug)]
pub(super) struct ItemNames([String; 3]);

impl ItemNames {
    /// `part`: empty if the image has one item.
    pub(super) fn new(file: &str, part: &str) -> Self {
        let short = file.rsplit(['/', '\\']).next().unwrap_or_default();
        let whole = if part.is_empty() {
            String::new()
        } else {
            format!("{short}/{part}")
        };
        Self([
            file.to_owned(),
            if short == file {
                String::new()
            } else {
                short.to_owned()
            },
            whole,
        ])
    }

    pub(super) fn list(&self) -> [&str; 3] {
        self.0.each_ref().map(String::as_str)
    }
}
