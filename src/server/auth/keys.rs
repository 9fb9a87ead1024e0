//! API keys and their owners. Keys and sessions belong to a name, so that a key can be replaced.
//! Only digests are kept.

use std::fmt;

use sha2::{Digest as _, Sha256};
use subtle::{Choice, ConditionallySelectable as _, ConstantTimeEq as _};

use super::tokens::Grant;
use crate::client::Owner;

const MIN_KEY: usize = 16;
const MAX_KEY: usize = 512;
/// Maximum number of keys: every request is compared with all of them.
const MAX_KEYS: usize = 1000;
const MAX_NAME: usize = 64;

/// The key that a request was admitted by, or none where no keys are configured; and what a token
/// allows that was made with the key.
#[derive(Clone, Copy, PartialEq, Eq)]
pub struct Credential {
    key: Option<ApiKey>,
    grant: Option<Grant>,
}

impl Credential {
    pub(crate) const ANYBODY: Self = Self {
        key: None,
        grant: None,
    };

    pub(crate) fn owner(self) -> Owner {
        self.key.map_or(Owner::ANYBODY, |key| key.owner)
    }

    /// `None`: the key itself, which may do everything.
    pub(crate) const fn grant(self) -> Option<Grant> {
        self.grant
    }

    /// The digest of the key itself; none of a token, and where no keys are configured.
    pub(crate) fn key_digest(self) -> Option<[u8; 32]> {
        self.key
            .filter(|_| self.grant.is_none())
            .map(|key| key.digest)
    }

    /// The credential of a client with a token that was made with this key.
    pub(super) const fn limited_to(self, grant: Grant) -> Self {
        Self {
            grant: Some(grant),
            ..self
        }
    }
}

impl fmt::Debug for Credential {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let what = match (self.key, self.grant) {
            (_, Some(_)) => "a token",
            (Some(_), None) => "a key",
            (None, None) => "anybody",
        };
        write!(f, "Credential({what})")
    }
}

/// The configured keys.
#[derive(Clone, Default, PartialEq, Eq)]
pub struct Keys(Vec<ApiKey>);

#[derive(Clone, Copy, PartialEq, Eq)]
struct ApiKey {
    digest: [u8; 32],
    owner: Owner,
}

impl Keys {
    /// Reads `NAME KEY` pairs, separated by lines or commas. Empty lines and `#` lines are ignored.
    /// Errors never hold the key.
    pub(crate) fn parse(text: &str) -> Result<Self, String> {
        let mut keys = Self::default();
        for (line, text) in (1..)
            .zip(text.lines())
            .filter(|(_, text)| !text.trim_start().starts_with('#'))
        {
            for pair in text
                .split(',')
                .map(str::trim)
                .filter(|pair| !pair.is_empty())
            {
                let key = parse_key(pair).map_err(|cause| format!("line {line}: {cause}"))?;
                if keys.has(&key) {
                    return Err(format!("line {line}: the key is there already"));
                }
                keys.0.push(key);
            }
        }
        if keys.0.len() > MAX_KEYS {
            return Err(format!("{} keys; at most {MAX_KEYS}", keys.0.len()));
        }
        Ok(keys)
    }

    /// These keys and others; a key that is in both keeps its owner here.
    pub(crate) fn and(mut self, others: &Self) -> Self {
        let new: Vec<ApiKey> = others
            .0
            .iter()
            .filter(|key| !self.has(key))
            .copied()
            .collect();
        self.0.extend(new);
        self
    }

    fn has(&self, key: &ApiKey) -> bool {
        self.0.iter().any(|known| known.digest == key.digest)
    }

    pub(crate) const fn len(&self) -> usize {
        self.0.len()
    }

    pub(crate) const fn is_empty(&self) -> bool {
        self.0.is_empty()
    }

    /// Whether all keys belong to one name.
    pub(crate) fn have_one_owner(&self) -> bool {
        let owner = self.0.first().map(|key| key.owner);
        owner.is_some() && self.0.iter().all(|key| Some(key.owner) == owner)
    }

    /// The credential of a key, if it is configured. Takes the same time for every key: all digests
    /// are compared, each in constant time, and the owner is selected without a branch.
    pub(crate) fn look_up(&self, key: &str) -> Option<Credential> {
        let digest = Sha256::digest(key).into();
        let Search { found, owner, .. } = self.search(&digest);
        let key = ApiKey {
            digest,
            owner: Owner::from_bytes(owner),
        };
        let credential = Credential {
            key: Some(key),
            grant: None,
        };
        bool::from(found).then_some(credential)
    }

    /// The credential of the owner's key for whose digest `is_it` is true. It is not looked up in
    /// constant time: the client has shown a signature.
    pub(super) fn find(
        &self,
        owner: Owner,
        is_it: impl Fn(&[u8; 32]) -> bool,
    ) -> Option<Credential> {
        let mut own = self.0.iter().filter(|key| key.owner == owner);
        let key = own.find(|key| is_it(&key.digest)).copied()?;
        Some(Credential {
            key: Some(key),
            grant: None,
        })
    }

    /// Whether the credential's key is still configured, for the same owner.
    pub(crate) fn is_valid(&self, credential: Credential) -> bool {
        credential.key.is_none_or(|key| self.0.contains(&key))
    }

    fn search(&self, digest: &[u8; 32]) -> Search {
        let mut search = Search {
            found: Choice::from(0),
            owner: [0; 16],
            visited: 0,
        };
        for key in &self.0 {
            let is_equal = key.digest.ct_eq(digest);
            for (byte, other) in search.owner.iter_mut().zip(key.owner.to_bytes()) {
                byte.conditional_assign(&other, is_equal);
            }
            search.found |= is_equal;
            search.visited += 1;
        }
        search
    }
}

struct Search {
    found: Choice,
    owner: [u8; 16],
    /// The number of compared keys, for a test.
    visited: usize,
}

impl fmt::Debug for Keys {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "{} keys", self.0.len())
    }
}

fn parse_key(pair: &str) -> Result<ApiKey, String> {
    let mut words = pair.split_whitespace();
    let (Some(name), Some(key), None) = (words.next(), words.next(), words.next()) else {
        return Err("a name and a key were expected, with a space between".to_owned());
    };
    if name.len() > MAX_NAME
        || !name
            .bytes()
            .all(|b| b.is_ascii_alphanumeric() || b"._@-".contains(&b))
    {
        return Err(format!(
            "a name has at most {MAX_NAME} of A-Z a-z 0-9 . _ @ -"
        ));
    }
    if !(MIN_KEY..=MAX_KEY).contains(&key.len()) {
        return Err(format!(
            "the key has {} characters; {MIN_KEY} to {MAX_KEY} were expected",
            key.len()
        ));
    }
    // The characters of a bearer token (RFC 6750, section 2.1).
    if !key
        .bytes()
        .all(|b| b.is_ascii_alphanumeric() || b"-._~+/=".contains(&b))
    {
        return Err("a key has A-Z a-z 0-9 and -._~+/= only".to_owned());
    }
    Ok(ApiKey {
        digest: Sha256::digest(key).into(),
        owner: owner_of_name(name),
    })
}

/// The owner of a name, the same in every process.
fn owner_of_name(name: &str) -> Owner {
    let digest = Sha256::new()
        .chain_update(b"mlswarp owner\0")
        .chain_update(name)
        .finalize();
    Owner::from_bytes(digest[..16].try_into().expect("16 of 32 bytes"))
}

#[cfg(test)]
mod tests {
    use super::*;

    const ONE: &str = "0123456789abcdef";
    const TWO: &str = "fedcba9876543210";

    impl Keys {
        fn owner_of(&self, key: &str) -> Option<Owner> {
            self.look_up(key).map(Credential::owner)
        }
    }

    #[test]
    fn keys_of_one_name_are_one_owner() {
        let keys = Keys::parse(&format!(
            "# rotation, 2026\nann {ONE}\n\n  ann   {TWO}\nbob {ONE}{TWO}\n"
        ))
        .unwrap();
        assert_eq!(keys.len(), 3);
        assert_eq!(keys.owner_of(ONE), keys.owner_of(TWO));
        assert_ne!(keys.owner_of(ONE), keys.owner_of(&format!("{ONE}{TWO}")));
        assert_ne!(keys.owner_of(ONE), Some(Owner::ANYBODY));
        for wrong in ["", "0123456789abcdeg", "0123456789abcde", "ann"] {
            assert_eq!(keys.owner_of(wrong), None);
        }
        let two = Keys::parse(&format!("ann {ONE},bob {TWO}")).unwrap();
        assert_eq!(
            (
                two.len(),
                two.have_one_owner(),
                Keys::default().have_one_owner()
            ),
            (2, false, false)
        );
        assert!(
            Keys::parse(&format!("ann {ONE},ann {TWO}"))
                .unwrap()
                .have_one_owner()
        );
    }

    #[test]
    fn every_key_is_compared_wherever_the_right_one_stands() {
        let text: String = (0..50)
            .map(|n| format!("name{n} key-number-{n:09}\n"))
            .collect();
        let keys = Keys::parse(&text).unwrap();
        for key in [
            "key-number-000000000",
            "key-number-000000049",
            "key-number-000000025",
            "key-number-000000050",
            "",
        ] {
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
            (
                "ann 0123456789abcdef\nbob 0123456789abcdef",
                "line 2: the key is there already",
            ),
        ] {
            let mistake = Keys::parse(text).unwrap_err();
            assert!(mistake.starts_with(told), "{mistake}");
            assert!(!mistake.contains("0123456789"), "{mistake}");
        }
        assert_eq!(
            format!("{:?}", Keys::parse("ann 0123456789abcdef").unwrap()),
            "1 keys"
        );
    }

    #[test]
    fn a_credential_is_valid_for_as_long_as_its_key_is_one_of_its_name() {
        let keys = |text: &str| Keys::parse(text).unwrap();
        let credential = keys(&format!("ann {ONE}")).look_up(ONE).unwrap();
        assert_eq!(credential.owner(), owner_of_name("ann"));
        assert!(keys(&format!("bob {TWO}\nann {ONE}")).is_valid(credential));
        for others in ["", &format!("ann {TWO}"), &format!("bob {ONE}")] {
            assert!(!keys(others).is_valid(credential), "{others}");
            assert!(keys(others).is_valid(Credential::ANYBODY));
        }
        assert_eq!(
            format!("{credential:?} {:?}", Credential::ANYBODY),
            "Credential(a key) Credential(anybody)"
        );
    }
}
