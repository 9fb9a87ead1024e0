//! The texts of clients: what is read from one owns the memory that it takes.

use super::App;
use crate::client::Client;
use crate::limits::memory::{MemoryClass, Reservation};
use crate::problem::Problem;
use crate::store::{Record, record_bytes};
use crate::wire::Reserved;

/// What was read from a client's text.
pub(crate) type Held<T> = Reserved<T, Reservation>;

impl App {
    /// Takes the memory of what is read from a request, which counts for the client.
    pub(crate) fn reserving(
        &self,
        purpose: MemoryClass,
        client: Client,
    ) -> impl FnOnce(u64) -> Result<Reservation, Problem> + Send + use<> {
        let (app, quota) = (self.clone(), self.request_quota(client));
        move |bytes| app.reserve_for(purpose, &quota, bytes)
    }

    /// As [`App::reserving`], for a request about a session, whose pose may be copied in place of
    /// another one.
    pub(crate) fn reserving_pose(
        &self,
        purpose: MemoryClass,
        client: Client,
        record: &Record,
    ) -> impl FnOnce(u64) -> Result<Reservation, Problem> + Send + use<> {
        let (copied, reserve) = (
            record.pose.as_ref().map_or(0, |_| 2 * record_bytes(record)),
            self.reserving(purpose, client),
        );
        move |bytes| reserve(bytes + copied)
    }
}

/// Takes a part out of what was read, with half of its memory: the other half is released with the
/// rest.
pub(crate) fn part<T, U>(of: &mut Held<T>, take: impl FnOnce(&mut T) -> U) -> Held<U> {
    of.split(|value, held| (take(value), held.split(held.bytes() / 2)))
}
