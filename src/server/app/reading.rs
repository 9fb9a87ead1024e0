//! The texts of clients: what is read from one owns the memory that it takes.

use crate::limits::memory::Reservation;
use crate::wire::Reserved;

/// What was read from a client's text.
pub(crate) type Held<T> = Reserved<T, Reservation>;

/// Takes a part out of what was read, with half of its memory: the other half is released with the
/// rest.
pub(crate) fn part<T, U>(of: &mut Held<T>, take: impl FnOnce(&mut T) -> U) -> Held<U> {
    of.split(|value, held| (take(value), held.split(held.bytes() / 2)))
}
