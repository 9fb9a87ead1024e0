//! The memory budget. Memory whose size depends on clients is reserved by its predicted size before
//! it is allocated, and released when it is dropped: uploads, the files of sessions, decoded
//! images, plans, responses, sockets. Not counted are the program (some 15 MiB), stacks, and
//! buffers of a few KiB per request.
//!
//! Frames may use all of the budget, other purposes only a part, so that drags continue when
//! uploads or the store have used theirs.

use std::sync::Arc;
use std::sync::atomic::{AtomicU64, Ordering};

use bytes::Bytes;
use thiserror::Error;

use super::client_quota::{ClientQuota, QuotaKind};
use super::free::free;
use super::freed::FREED;
use crate::problem::{Code, Problem};

/// Seconds after which a client may retry.
const RETRY_SECONDS: u32 = 2;

/// What memory is used for.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub enum MemoryClass {
    /// Files and JSON of requests, and the files that sessions in memory keep.
    Upload,
    /// Decoded images, and the files of sessions that are decoded again.
    Image,
    /// Tables of coefficients.
    Plan,
    /// Responses, from before they are drawn until they are sent.
    Frame,
    /// Drag sockets.
    Socket,
}

impl MemoryClass {
    /// Every purpose.
    pub const ALL: [Self; 5] = [
        Self::Upload,
        Self::Image,
        Self::Plan,
        Self::Frame,
        Self::Socket,
    ];

    /// The name in metrics and messages.
    pub const fn name(self) -> &'static str {
        match self {
            Self::Upload => "uploads",
            Self::Image => "images",
            Self::Plan => "plans",
            Self::Frame => "frames",
            Self::Socket => "sockets",
        }
    }

    /// The part of `total` up to which this purpose may fill the budget.
    pub const fn share(self, total: u64) -> u64 {
        match self {
            Self::Frame => total,
            Self::Image | Self::Plan => total / 8 * 7,
            Self::Upload | Self::Socket => total / 4 * 3,
        }
    }
}

/// A reservation exceeds a limit.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Error)]
#[error("{} would need {asked} bytes of memory; {taken} of {limit} are in \
    use{}", .purpose.name(), .quota.map_or("", QuotaKind::used_by))]
pub struct BudgetExceeded {
    /// The quota of the client that is exceeded; `None`: the part of the budget that the purpose
    /// may use.
    pub(crate) quota: Option<QuotaKind>,
    pub(crate) purpose: MemoryClass,
    /// Bytes of the whole reservation.
    pub(crate) asked: u64,
    pub(crate) limit: u64,
    pub(crate) taken: u64,
}

impl BudgetExceeded {
    /// The reservation would not fit even if nothing else were in use. A response that is its
    /// client's only one may exceed the quota.
    pub(crate) fn is_forever(&self) -> bool {
        self.quota != Some(QuotaKind::Responses) && self.asked > self.limit
    }
}

impl BudgetExceeded {
    /// Whether the reservation may succeed when cached values have been evicted.
    pub(crate) fn may_be_evicted_for(&self) -> bool {
        !self.is_forever() && self.quota.is_none()
    }
}

impl From<BudgetExceeded> for Problem {
    fn from(error: BudgetExceeded) -> Self {
        let BudgetExceeded {
            quota,
            purpose,
            asked,
            limit,
            taken,
        } = error;
        let (code, what, actual) = match quota {
            None => (Code::Overloaded, "memory_bytes", asked),
            Some(QuotaKind::Responses) => (
                Code::Overloaded,
                "unread_bytes",
                taken.saturating_add(asked),
            ),
            Some(QuotaKind::Requests) => (
                Code::RateLimited,
                "client_upload_bytes",
                taken.saturating_add(asked),
            ),
        };
        let problem = if error.is_forever() {
            Self::new(
                Code::TooLarge,
                format!(
                    "{} would need {asked} bytes; at most {limit}",
                    purpose.name()
                ),
            )
        } else {
            Self::new(code, error.to_string()).retry_after(RETRY_SECONDS)
        };
        problem.limit(what, limit, actual)
    }
}

/// The memory budget. Clones share it.
#[derive(Clone, Debug)]
pub struct Budget(Arc<BudgetState>);

#[derive(Debug)]
struct BudgetState {
    total: u64,
    taken: AtomicU64,
    by_purpose: [AtomicU64; MemoryClass::ALL.len()],
    refused: AtomicU64,
}

/// Reserved memory, released when dropped.
#[derive(Debug)]
pub struct Reservation {
    budget: Budget,
    purpose: MemoryClass,
    bytes: u64,
    quota: Option<ClientQuota>,
}

impl Budget {
    /// A budget of `total` bytes.
    pub fn new(total: u64) -> Self {
        let by_purpose = std::array::from_fn(|_| AtomicU64::new(0));
        Self(Arc::new(BudgetState {
            total,
            taken: AtomicU64::new(0),
            by_purpose,
            refused: AtomicU64::new(0),
        }))
    }

    /// All bytes.
    pub fn total(&self) -> u64 {
        self.0.total
    }

    /// Reserved bytes.
    pub fn taken(&self) -> u64 {
        self.0.taken.load(Ordering::Relaxed)
    }

    /// Bytes reserved for a purpose.
    pub fn taken_for(&self, purpose: MemoryClass) -> u64 {
        self.0.by_purpose[purpose as usize].load(Ordering::Relaxed)
    }

    pub(crate) fn refused(&self) -> u64 {
        self.0.refused.load(Ordering::Relaxed)
    }

    pub(crate) fn count_refusal(&self) {
        self.0.refused.fetch_add(1, Ordering::Relaxed);
    }

    /// Whether a reservation would succeed now.
    pub(crate) fn has(&self, purpose: MemoryClass, bytes: u64) -> bool {
        self.taken().saturating_add(bytes) <= purpose.share(self.total())
    }

    /// Reserves memory.
    pub fn take(&self, purpose: MemoryClass, bytes: u64) -> Result<Reservation, BudgetExceeded> {
        self.reserve(purpose, None, bytes)
    }

    /// Reserves memory that counts in the quota of a client until it is released.
    pub fn take_for(
        &self,
        purpose: MemoryClass,
        quota: &ClientQuota,
        bytes: u64,
    ) -> Result<Reservation, BudgetExceeded> {
        self.reserve(purpose, Some(quota.clone()), bytes)
    }

    fn reserve(
        &self,
        purpose: MemoryClass,
        quota: Option<ClientQuota>,
        bytes: u64,
    ) -> Result<Reservation, BudgetExceeded> {
        let mut reservation = Reservation {
            budget: self.clone(),
            purpose,
            bytes: 0,
            quota,
        };
        reservation.grow(bytes)?;
        Ok(reservation)
    }
}

impl Reservation {
    /// Reserved bytes.
    pub const fn bytes(&self) -> u64 {
        self.bytes
    }

    /// Reserves `more` bytes, or none.
    pub fn grow(&mut self, more: u64) -> Result<(), BudgetExceeded> {
        let (purpose, asked) = (self.purpose, self.bytes.saturating_add(more));
        let exceeded = |quota, limit, taken| BudgetExceeded {
            quota,
            purpose,
            asked,
            limit,
            taken,
        };
        if let Some(quota) = &self.quota {
            quota
                .reserve(self.bytes, more)
                .map_err(|(limit, used)| exceeded(Some(quota.kind()), limit, used))?;
        }
        let state = &self.budget.0;
        let limit = purpose.share(state.total);
        let fits = |taken: u64| taken.checked_add(more).filter(|sum| *sum <= limit);
        // The total decides; `by_purpose` follows.
        match state
            .taken
            .fetch_update(Ordering::Relaxed, Ordering::Relaxed, fits)
        {
            Ok(before) => FREED.wake_if_too_much(before + more, state.total),
            Err(taken) => {
                if let Some(quota) = &self.quota {
                    quota.release(more);
                }
                return Err(exceeded(None, limit, taken));
            }
        }
        state.by_purpose[purpose as usize].fetch_add(more, Ordering::Relaxed);
        self.bytes = asked;
        Ok(())
    }

    /// Releases all but `bytes`; the memory of the others has been freed.
    pub fn shrink_to(&mut self, bytes: u64) {
        FREED.add(self.bytes.saturating_sub(bytes));
        self.release_to(bytes);
    }

    /// Releases memory that was not allocated after all, or that another reservation counts by now.
    /// The allocator has nothing of it to return.
    pub fn release_unused(mut self) {
        self.release_to(0);
    }

    fn release_to(&mut self, bytes: u64) {
        let less = self.bytes.saturating_sub(bytes);
        self.budget.0.taken.fetch_sub(less, Ordering::Relaxed);
        self.budget.0.by_purpose[self.purpose as usize].fetch_sub(less, Ordering::Relaxed);
        if let Some(quota) = &self.quota {
            quota.release(less);
        }
        self.bytes -= less;
    }

    /// Splits off at most `bytes`, which are released separately.
    pub fn split(&mut self, bytes: u64) -> Self {
        let bytes = bytes.min(self.bytes);
        self.bytes -= bytes;
        Self {
            budget: self.budget.clone(),
            purpose: self.purpose,
            bytes,
            quota: self.quota.clone(),
        }
    }

    /// As [`Reservation::attach`], of bytes that a client may read slowly: unused memory of both is
    /// released before.
    pub(crate) fn attach_exact(mut self, mut bytes: Vec<u8>) -> Bytes {
        bytes.shrink_to_fit();
        self.shrink_to(bytes.len() as u64);
        self.attach(bytes)
    }

    /// Bytes that hold the reservation until the last reference is dropped.
    pub fn attach<T: AsRef<[u8]> + Send + 'static>(self, bytes: T) -> Bytes {
        struct HeldBytes<T: AsRef<[u8]> + Send + 'static>(Option<(T, Reservation)>);
        impl<T: AsRef<[u8]> + Send + 'static> AsRef<[u8]> for HeldBytes<T> {
            fn as_ref(&self) -> &[u8] {
                self.0.as_ref().map_or(&[], |(bytes, _)| bytes.as_ref())
            }
        }
        impl<T: AsRef<[u8]> + Send + 'static> Drop for HeldBytes<T> {
            fn drop(&mut self) {
                let bytes = self.as_ref().len() as u64;
                free(self.0.take(), bytes);
            }
        }
        Bytes::from_owner(HeldBytes(Some((bytes, self))))
    }
}

impl Drop for Reservation {
    fn drop(&mut self) {
        self.shrink_to(0);
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn what_is_taken_is_given_back() {
        let budget = Budget::new(800);
        let mut image = budget.take(MemoryClass::Image, 300).unwrap();
        let mut frame = budget.take(MemoryClass::Frame, 400).unwrap();
        assert_eq!(
            (
                budget.taken(),
                budget.taken_for(MemoryClass::Image),
                budget.taken_for(MemoryClass::Plan)
            ),
            (700, 300, 0)
        );
        image.shrink_to(100);
        image.shrink_to(200);
        assert_eq!((image.bytes(), budget.taken()), (100, 500));
        let part = frame.split(150);
        drop(frame);
        assert_eq!(budget.taken_for(MemoryClass::Frame), 150);
        let unused = budget.take(MemoryClass::Plan, 50).unwrap();
        unused.release_unused();
        drop((part, image));
        assert_eq!(budget.taken(), 0);
        assert!(
            MemoryClass::ALL
                .iter()
                .all(|purpose| budget.taken_for(*purpose) == 0)
        );
    }

    #[test]
    fn newcomers_leave_room_for_drags() {
        let budget = Budget::new(800);
        let upload = budget.take(MemoryClass::Upload, 600).unwrap();
        let refused = budget.take(MemoryClass::Upload, 1).unwrap_err();
        assert_eq!(
            refused,
            BudgetExceeded {
                quota: None,
                purpose: MemoryClass::Upload,
                asked: 1,
                limit: 600,
                taken: 600
            }
        );
        assert!(!refused.is_forever() && !budget.has(MemoryClass::Socket, 1));
        let image = budget.take(MemoryClass::Image, 100).unwrap();
        assert!(budget.take(MemoryClass::Plan, 1).is_err());
        let frame = budget.take(MemoryClass::Frame, 100).unwrap();
        assert!(budget.take(MemoryClass::Frame, 1).is_err());
        drop((upload, image, frame));
        assert!(
            budget
                .take(MemoryClass::Upload, 601)
                .unwrap_err()
                .is_forever()
        );
        assert!(
            budget
                .take(MemoryClass::Frame, u64::MAX)
                .unwrap_err()
                .is_forever()
        );
    }

    #[test]
    fn growing_takes_all_or_nothing() {
        let budget = Budget::new(800);
        let mut upload = budget.take(MemoryClass::Upload, 500).unwrap();
        let refused = upload.grow(200).unwrap_err();
        assert_eq!(
            (refused.asked, upload.bytes(), budget.taken()),
            (700, 500, 500)
        );
        assert!(refused.is_forever());
        upload.grow(100).unwrap();
        assert_eq!(budget.taken(), 600);
    }

    #[test]
    fn a_client_holds_its_share_until_its_answers_have_left() {
        use crate::client::Client;
        use crate::limits::client_quota::ClientQuotas;
        let (budget, shares) = (
            Budget::new(800),
            ClientQuotas::new(QuotaKind::Responses, 200),
        );
        let (share, other) = (
            shares.of(Client::default()),
            shares.of(Client {
                address: [10, 0, 0, 1].into(),
                ..Client::default()
            }),
        );
        let mut answer = budget.take_for(MemoryClass::Frame, &share, 100).unwrap();
        answer.grow(50).unwrap();
        let refused = budget.take_for(MemoryClass::Frame, &share, 60).unwrap_err();
        assert_eq!(
            refused,
            BudgetExceeded {
                quota: Some(QuotaKind::Responses),
                purpose: MemoryClass::Frame,
                asked: 60,
                limit: 200,
                taken: 150
            }
        );
        assert!(
            !budget
                .take_for(MemoryClass::Frame, &share, 700)
                .unwrap_err()
                .is_forever()
        );
        let strip = answer.split(120).attach(vec![0; 120]);
        drop(answer);
        assert_eq!((share.held(), budget.taken()), (120, 120));
        // What the account refuses belongs to no client.
        assert_eq!(
            budget
                .take_for(MemoryClass::Frame, &other, 750)
                .unwrap_err()
                .quota,
            None
        );
        assert_eq!((other.held(), budget.taken()), (0, 120));
        let whole = budget.take_for(MemoryClass::Frame, &other, 600).unwrap();
        drop((strip, whole));
        assert_eq!((share.held(), other.held(), budget.taken()), (0, 0, 0));
    }

    #[test]
    fn bytes_hold_their_memory_as_long_as_anyone_holds_them() {
        let budget = Budget::new(800);
        let bytes = budget
            .take(MemoryClass::Frame, 10)
            .unwrap()
            .attach(vec![7; 10]);
        let part = bytes.slice(3..5);
        drop(bytes);
        assert_eq!((budget.taken(), &part[..]), (10, &[7, 7][..]));
        drop(part);
        assert_eq!(budget.taken(), 0);
    }
}
