//! The id and the revision of a session.

use std::fmt;

use uuid::{Uuid, Variant};

use crate::client::Owner;

/// The id of a session: its owner and a UUID of version 4 (122 random bits, so that it cannot be
/// guessed). Its text is the UUID.
#[derive(Clone, Copy, PartialEq, Eq, Hash, PartialOrd, Ord)]
pub struct SessionId {
    owner: Owner,
    uuid: Uuid,
}

impl SessionId {
    /// A new id.
    pub fn random(owner: Owner) -> Self {
        Self {
            owner,
            uuid: Uuid::new_v4(),
        }
    }

    /// Parses the hyphenated form of a UUID of version 4.
    pub fn parse(owner: Owner, text: &str) -> Option<Self> {
        let uuid = Uuid::try_parse(text).ok().filter(|_| text.len() == 36)?;
        (uuid.get_version_num() == 4 && uuid.get_variant() == Variant::RFC4122)
            .then_some(Self { owner, uuid })
    }

    /// The owner.
    pub const fn owner(&self) -> Owner {
        self.owner
    }

    /// The UUID.
    pub(crate) const fn uuid(&self) -> [u8; 16] {
        self.uuid.into_bytes()
    }

    /// Owner and UUID.
    pub fn to_bytes(&self) -> [u8; 32] {
        let mut bytes = [0; 32];
        bytes[..16].copy_from_slice(&self.owner.to_bytes());
        bytes[16..].copy_from_slice(self.uuid.as_bytes());
        bytes
    }

    /// The inverse of [`SessionId::to_bytes`].
    pub fn from_bytes(bytes: &[u8; 32]) -> Self {
        let (owner, uuid) = bytes.split_at(16);
        let half = |half: &[u8]| half.try_into().expect("half of 32 bytes");
        Self {
            owner: Owner::from_bytes(half(owner)),
            uuid: Uuid::from_bytes(half(uuid)),
        }
    }
}

/// Identifies one state of a session: it changes with the handles and the picture, and is never
/// used again.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub struct Revision(Uuid);

impl Revision {
    /// A new revision.
    pub fn random() -> Self {
        Self(Uuid::new_v4())
    }

    /// The inverse of [`Revision::as_bytes`].
    pub const fn from_bytes(bytes: [u8; 16]) -> Self {
        Self(Uuid::from_bytes(bytes))
    }

    /// Its bytes.
    pub const fn as_bytes(&self) -> &[u8; 16] {
        self.0.as_bytes()
    }
}

impl fmt::Display for SessionId {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        self.uuid.fmt(f)
    }
}

/// Shortened, so that readers of a log cannot use the session.
impl fmt::Debug for SessionId {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "{:.8}..", self.uuid.to_string())
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn names_are_hyphenated_uuids_of_version_4() {
        let parse = |text: &str| SessionId::parse(Owner::ANYBODY, text);
        let id = SessionId::random(Owner::ANYBODY);
        assert_eq!(parse(&id.to_string()), Some(id));
        for text in [
            "",
            "x",
            "00000000-0000-0000-0000-000000000000",
            "6ba7b810-9dad-11d1-80b4-00c04fd430c8",
        ] {
            assert_eq!(parse(text), None, "{text}");
        }
        assert!(parse(&id.to_string().replace('-', "")).is_none());
    }

    #[test]
    fn one_name_of_two_owners_is_two_sessions() {
        let other = Owner::from_bytes([7; 16]);
        let id = SessionId::random(other);
        assert_ne!(SessionId::parse(Owner::ANYBODY, &id.to_string()), Some(id));
        assert_eq!(SessionId::parse(other, &id.to_string()), Some(id));
        assert_eq!(SessionId::from_bytes(&id.to_bytes()), id);
    }

    #[test]
    fn a_log_does_not_give_a_session_away() {
        let id = SessionId::random(Owner::ANYBODY);
        assert!(format!("{id:?}").len() < 12);
    }
}
