//! The files that sessions name. A file counts once for each owner whose sessions name it, also
//! where the store keeps it once for all of them: otherwise the bytes that the store takes would
//! tell one owner what another one has stored.

use std::collections::HashMap;

use bytes::Bytes;
use mlswarp::warp::Digest;

use super::Index;
use crate::client::Owner;
use crate::session::SessionId;
use crate::store::NamedFile;

#[derive(Debug)]
pub(super) struct IndexedFile {
    bytes: u64,
    /// Empty unless contents are kept here.
    content: Bytes,
    /// How often sessions of the owner name it.
    names: usize,
}

impl Index {
    /// The size of a file that a session of the owner names.
    pub(crate) fn file_bytes(&self, owner: Owner, digest: Digest) -> Option<u64> {
        self.files.get(&(owner, digest)).map(|file| file.bytes)
    }

    /// The content of a file that a session of the owner names.
    pub(crate) fn file(&self, owner: Owner, digest: Digest) -> Option<Bytes> {
        self.files
            .get(&(owner, digest))
            .map(|file| file.content.clone())
    }

    /// Whether a session of that owner names the file.
    pub(crate) fn names(&self, owner: Owner, digest: Digest) -> bool {
        self.files.contains_key(&(owner, digest))
    }

    /// The bytes that these files of a session add. The files that they replace count until they
    /// are replaced.
    pub(super) fn added_bytes(&self, id: SessionId, files: &[NamedFile]) -> u64 {
        let is_first = |(k, file): &(usize, &NamedFile)| {
            !files[..*k]
                .iter()
                .any(|before| before.digest == file.digest)
        };
        let is_new = |(_, file): &(usize, &NamedFile)| !self.names(id.owner(), file.digest);
        files
            .iter()
            .enumerate()
            .filter(is_first)
            .filter(is_new)
            .map(|(_, file)| file.len())
            .sum()
    }

    /// Counts one more name of a file, and keeps it if it is new.
    pub(super) fn name_file(&mut self, owner: Owner, digest: Digest, bytes: u64, content: &Bytes) {
        let file = self.files.entry((owner, digest)).or_insert_with(|| {
            self.bytes += bytes;
            *self.owners.entry(digest).or_default() += 1;
            let content = if self.keeps_contents {
                content.clone()
            } else {
                Bytes::new()
            };
            IndexedFile {
                bytes,
                content,
                names: 0,
            }
        });
        file.names += 1;
    }

    /// Takes one name of a file away, and with the last one the file.
    pub(super) fn unname_file(&mut self, owner: Owner, digest: Digest) {
        let Some(file) = self.files.get_mut(&(owner, digest)) else {
            return;
        };
        file.names -= 1;
        if file.names > 0 {
            return;
        }
        self.bytes -= file.bytes;
        self.files.remove(&(owner, digest));
        if let Some(owners) = self.owners.get_mut(&digest) {
            *owners -= 1;
            if *owners == 0 {
                self.owners.remove(&digest);
            }
        }
    }

    /// Removes a file that cannot be read from the unread sessions that name it.
    pub(crate) fn lose_file(&mut self, digest: Digest) {
        let unread = self
            .sessions
            .iter_mut()
            .filter(|(_, entry)| entry.record.is_none());
        let named = unread.filter_map(|(id, entry)| {
            let place = entry.files.iter().position(|file| *file == digest)?;
            entry.files.swap_remove(place);
            Some(id.owner())
        });
        for owner in named.collect::<Vec<_>>() {
            self.unname_file(owner, digest);
        }
    }

    /// The files that no session of any owner names once these are gone and another one names
    /// `kept`.
    pub(crate) fn freed(&self, gone: &[SessionId], kept: &[Digest]) -> Vec<Digest> {
        let mut fewer: HashMap<(Owner, Digest), usize> = HashMap::new();
        let entry = |id| self.sessions.peek(id).map(|entry| (id, entry));
        for (id, entry) in gone.iter().filter_map(entry) {
            for digest in &entry.files {
                *fewer.entry((id.owner(), *digest)).or_default() += 1;
            }
        }
        let mut owners: HashMap<Digest, usize> = HashMap::new();
        for (file, fewer) in fewer
            .into_iter()
            .filter(|((_, digest), _)| !kept.contains(digest))
        {
            if self
                .files
                .get(&file)
                .is_some_and(|file| file.names == fewer)
            {
                *owners.entry(file.1).or_default() += 1;
            }
        }
        owners.retain(|digest, fewer| self.owners.get(digest) == Some(fewer));
        owners.into_keys().collect()
    }
}
