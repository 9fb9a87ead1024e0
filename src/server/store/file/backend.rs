//! A file whose length has reached the disk before anything is written after it was set.

use std::fmt::Debug;
use std::io;

use redb::StorageBackend;

/// The database writes in its header how long the file is, and does not open a file that is
/// shorter. Without this, a power failure could keep the header and lose the growth.
#[derive(Debug)]
pub(crate) struct DurableLength<B>(pub(crate) B);

impl<B: StorageBackend + Debug> StorageBackend for DurableLength<B> {
    fn len(&self) -> io::Result<u64> {
        self.0.len()
    }

    fn read(&self, offset: u64, out: &mut [u8]) -> io::Result<()> {
        self.0.read(offset, out)
    }

    fn set_len(&self, len: u64) -> io::Result<()> {
        self.0.set_len(len)?;
        self.0.sync_data()
    }

    fn sync_data(&self) -> io::Result<()> {
        self.0.sync_data()
    }

    fn write(&self, offset: u64, data: &[u8]) -> io::Result<()> {
        self.0.write(offset, data)
    }

    fn close(&self) -> io::Result<()> {
        self.0.close()
    }
}
