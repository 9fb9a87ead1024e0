//! JSON of responses, whose serialisation can be cancelled.

use std::io;

use mlswarp::warp::WarpError;
use serde::Serialize;

use crate::pool::Cancel;

/// Serialises a value to JSON in a buffer of this initial capacity, unless it is cancelled.
pub(crate) fn cancellable_json(
    cancel: &Cancel,
    value: &impl Serialize,
    capacity: usize,
) -> Result<Vec<u8>, WarpError> {
    struct Text<'a>(Vec<u8>, &'a Cancel);
    impl io::Write for Text<'_> {
        fn write(&mut self, bytes: &[u8]) -> io::Result<usize> {
            if self.1.is_cancelled() {
                return Err(io::ErrorKind::BrokenPipe.into());
            }
            self.0.write(bytes)
        }

        fn flush(&mut self) -> io::Result<()> {
            Ok(())
        }
    }
    let mut text = Text(Vec::with_capacity(capacity), cancel);
    serde_json::to_writer(&mut text, value).map_err(|_| WarpError::Cancelled)?;
    Ok(text.0)
}
