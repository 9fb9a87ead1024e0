//! Keys: who may use the service, and whose sessions are meant. A key belongs to a name, and sessions belong to the name: while a name has two
//! keys, one can be replaced by the other without losing a session. Of a key only its digest is kept.

use std::fmt;

use sha2::{Digest as _, Sha256};
use subtle::{Choice, ConditionallySelectable as _, ConstantTimeEq as _};

use crate::client::Owner;

/// Fewer characters could be guessed.
const SHORTEST: usize = 16;
/// A longer key would not fit a request's head comfortably.
const LONGEST: usize = 512;
/// More keys would make every request wait for the comparison.
const MOST: usize = 1000;
/// Longest name.
const LONGEST_NAME: usize = 64;

/// What somebody came in by: a key, of which its digest and its owner are kept, or nothing where nobody needs one. It is good for as long as the key is.
#[derive(Clone, Copy, PartialEq, Eq)]
pub struct Credential(Option<Key>);

impl Credential {
    /// Where there are no keys.
    pub const ANYBODY: Self = Self(None);
}

impl fmt::Debug for Credential {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "Pass({})", if self.0.is_some() { "a key" } else { "anybody" })
    }
}

/// Keys that are taken.
#[derive(Clone, Default, PartialEq, Eq)]
pub struct Keys(Vec<Key>);

#[derive(Clone, Copy, PartialEq, Eq)]
struct Key {
    digest: [u8; 32],
    owner: Owner,
}

impl Keys {
    /// Reads `NAME KEY` lines (or such pairs between commas); empty lines and lines that begin with `#` say nothing.
    ///
    /// # Errors
    /// The line that is wrong and why; never what it holds.
    pub fn parse(text: &str) -> Result<Self, String> {
        let mut keys = Self::default();
        for (line, text) in (1..).zip(text.lines()).filter(|(_, text)| !text.trim_start().starts_with('#')) {
            for pair in text.split(',').map(str::trim).filter(|pair| !pair.is_empty()) {
                let key = key(pair).map_err(|why| format!("line {line}: {why}"))?;
                if keys.0.iter().any(|known| known.digest == key.digest) {
                    return Err(format!("line {line}: the key is there already"));
                }
                keys.0.push(key);
            }
        }
        if keys.0.len() > MOST {
            return Err(format!("{} keys; at most {MOST}", keys.0.len()));
        }
        Ok(keys)
    }

    /// These and others; a key that both have keeps its place here.
    #[must_use]
    pub fn and(mut self, others: &Self) -> Self {
        let new = others.0.iter().filter(|key| !self.0.iter().any(|known| known.digest == key.digest));
        let new: Vec<Key> = new.copied().collect();
        self.0.extend(new);
        self
    }

    /// How many there are.
    #[must_use]
    pub const fn len(&self) -> usize {
        self.0.len()
    }

    /// There is none.
    #[must_use]
    pub const fn is_empty(&self) -> bool {
        self.0.is_empty()
    }

    /// Whose key it is, and what shows that it is still one. Takes as long for a wrong key as for a right one, wherever it stands and however much of it is right: digests are compared,
    /// each in constant time, every one of them, and the owner is chosen without a branch.
    #[must_use]
    pub fn look_up(&self, key: &str) -> Option<(Owner, Credential)> {
        let digest = Sha256::digest(key).into();
        let Search { found, owner, .. } = self.search(&digest);
        let owner = Owner::from_bytes(owner);
        bool::from(found).then_some((owner, Credential(Some(Key { digest, owner }))))
    }

    /// Whose key it is.
    #[must_use]
    pub fn owner_of(&self, key: &str) -> Option<Owner> {
        self.look_up(key).map(|(owner, _)| owner)
    }

    /// Whether the pass's key is still one of the same name's.
    #[must_use]
    pub fn is_valid(&self, pass: Credential) -> bool {
        pass.0.is_none_or(|key| {
            let Search { found, owner, .. } = self.search(&key.digest);
            bool::from(found) && Owner::from_bytes(owner) == key.owner
        })
    }

    fn search(&self, digest: &[u8; 32]) -> Search {
        let nobody = Search { found: Choice::from(0), owner: [0; 16], visited: 0 };
        self.0.iter().fold(nobody, |mut search, key| {
            let same = key.digest.ct_eq(digest);
            for (byte, theirs) in search.owner.iter_mut().zip(key.owner.to_bytes()) {
                byte.conditional_assign(&theirs, same);
            }
            Search { found: search.found | same, owner: search.owner, visited: search.visited + 1 }
        })
    }
}

/// Where a search has come to.
struct Search {
    found: Choice,
    owner: [u8; 16],
    /// Keys compared: all of them, whatever was found (tested).
    visited: usize,
}

impl fmt::Debug for Keys {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "{} keys", self.0.len())
    }
}

fn key(pair: &str) -> Result<Key, String> {
    let mut words = pair.split_whitespace();
    let (Some(name), Some(key), None) = (words.next(), words.next(), words.next()) else {
        return Err("a name and a key were expected, with a space between".to_owned());
    };
    if name.len() > LONGEST_NAME || !name.bytes().all(|b| b.is_ascii_alphanumeric() || b"._@-".contains(&b)) {
        return Err(format!("a name has at most {LONGEST_NAME} of A-Z a-z 0-9 . _ @ -"));
    }
    if !(SHORTEST..=LONGEST).contains(&key.len()) {
        return Err(format!("the key has {} characters; {SHORTEST} to {LONGEST} were expected", key.len()));
    }
    // What a bearer token may hold (RFC 6750, section 2.1).
    if !key.bytes().all(|b| b.is_ascii_alphanumeric() || b"-._~+/=".contains(&b)) {
        return Err("a key has A-Z a-z 0-9 and -._~+/= only".to_owned());
    }
    Ok(Key { digest: Sha256::digest(key).into(), owner: owner_of_name(name) })
}

/// The owner that a name stands for, the same in every process.
fn owner_of_name(name: &str) -> Owner {
    let digest = Sha256::new().chain_update(b"mlswarp owner\0").chain_update(name).finalize();
    Owner::from_bytes(digest[..16].try_into().expect("16 of 32 bytes"))
}

#[cfg(test)]
mod tests {
    use super::*;

    const ONE: &str = "0123456789abcdef";
    const TWO: &str = "fedcba9876543210";

    #[test]
    fn keys_of_one_name_are_one_owner() {
        let keys = Keys::parse(&format!("# rotation, 2026\nann {ONE}\n\n  ann   {TWO}\nbob {ONE}{TWO}\n")).unwrap();
        assert_eq!(keys.len(), 3);
        assert_eq!(keys.owner_of(ONE), keys.owner_of(TWO));
        assert_ne!(keys.owner_of(ONE), keys.owner_of(&format!("{ONE}{TWO}")));
        assert_ne!(keys.owner_of(ONE), Some(Owner::ANYBODY));
        for wrong in ["", "0123456789abcdeg", "0123456789abcde", "ann"] {
            assert_eq!(keys.owner_of(wrong), None);
        }
        assert_eq!(Keys::parse(&format!("ann {ONE},bob {TWO}")).unwrap().len(), 2);
    }

    #[test]
    fn every_key_is_compared_wherever_the_right_one_stands() {
        let text: String = (0..50).map(|n| format!("name{n} key-number-{n:09}\n")).collect();
        let keys = Keys::parse(&text).unwrap();
        for key in ["key-number-000000000", "key-number-000000049", "key-number-000000025", "key-number-000000050", ""] {
            let search = keys.search(&Sha256::digest(key).into());
            assert_eq!(search.visited, 50);
            assert_eq!(bool::from(search.found), keys.owner_of(key).is_some());
        }
    }

    #[test]
    fn a_mistake_names_its_line_and_never_the_key() {
        for (text, told) in [
            ("ann", "line 1: a name and a key"),
            ("\nann 0123456789abcde", "line 2: the key has 15 characters"),
            ("ann 0123456789abcdef extra", "line 1: a name and a key"),
            ("a/b 0123456789abcdef", "line 1: a name has"),
            ("ann 0123456789abcde$", "line 1: a key has"),
            ("ann 0123456789abcdef\nbob 0123456789abcdef", "line 2: the key is there already"),
        ] {
            let mistake = Keys::parse(text).unwrap_err();
            assert!(mistake.starts_with(told), "{mistake}");
            assert!(!mistake.contains("0123456789"), "{mistake}");
        }
        assert_eq!(format!("{:?}", Keys::parse("ann 0123456789abcdef").unwrap()), "1 keys");
    }

    #[test]
    fn a_pass_is_good_for_as_long_as_its_key_is_one_of_its_name() {
        let keys = |text: &str| Keys::parse(text).unwrap();
        let (owner, pass) = keys(&format!("ann {ONE}")).look_up(ONE).unwrap();
        assert_eq!(owner, owner_of_name("ann"));
        assert!(keys(&format!("bob {TWO}\nann {ONE}")).is_valid(pass));
        for others in ["", &format!("ann {TWO}"), &format!("bob {ONE}")] {
            assert!(!keys(others).is_valid(pass), "{others}");
            assert!(keys(others).is_valid(Credential::ANYBODY));
        }
        assert_eq!(format!("{pass:?} {:?}", Credential::ANYBODY), "Pass(a key) Pass(anybody)");
    }
}
