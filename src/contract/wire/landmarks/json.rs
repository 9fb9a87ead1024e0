//! What formats in JSON have in common.

use super::bad::Bad;
use super::titles;
use crate::problem::words::{list, quote};
use crate::wire::json::{Kind, Node};

/// The most fields by which a format is recognised.
const MOST_FIELDS: usize = 256;
/// The most that an error names.
const MOST_NAMED: usize = 8;

/// The fields of the outermost object; of a list, those of its first object.
pub(super) struct ObjectMembers<'t> {
    pub(super) is_list: bool,
    pairs: Vec<(&'t str, &'t str)>,
}

impl<'t> ObjectMembers<'t> {
    pub(super) fn of(root: &Node<'t, '_>) -> Self {
        let is_list = root.kind() == Kind::Array;
        let object = if is_list { root.first() } else { Some(*root) };
        let object = object.filter(|node| node.kind() == Kind::Object);
        let unquoted = |(name, value): (&'t str, &'t str)| (name.trim_matches('"'), value);
        let pairs = object.map(|object| object.pairs().take(MOST_FIELDS).map(unquoted).collect());
        Self {
            is_list,
            pairs: pairs.unwrap_or_default(),
        }
    }

    /// The kind of a field; `None` if it is absent or `null`.
    pub(super) fn kind(&self, name: &str) -> Option<Kind> {
        let (_, text) = self.pairs.iter().find(|(other, _)| *other == name)?;
        Some(Node::new(text, crate::wire::json::At::Root).kind()).filter(|kind| *kind != Kind::Null)
    }

    pub(super) fn has(&self, name: &str) -> bool {
        self.kind(name).is_some()
    }

    /// The error about a file that no format recognises.
    pub(super) fn unknown(&self, at: usize) -> Bad {
        let names: Vec<String> = self
            .pairs
            .iter()
            .take(MOST_NAMED)
            .map(|(name, _)| quote(name))
            .collect();
        let what = if self.is_list {
            "a list of objects"
        } else {
            "an object"
        };
        let found = match &names[..] {
            [] => "without fields".to_owned(),
            names => format!("with the fields {}", names.join(", ")),
        };
        let expected = list(&["p", "shapes", "landmarks"]);
        Bad::new(
            at,
            format!(
                "expected a landmark file ({}), such as an object with {expected}; found {what} \
                    {found}",
                titles()
            ),
        )
    }
}
