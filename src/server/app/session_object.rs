//! The session object. All of it but its last members stays the same within a revision of a
//! session: that text grows with the handles, is written once, on a compute thread, and is kept in
//! a cache. No system of a spline is needed for it.

use std::sync::Arc;
use std::time::{Duration, SystemTime};

use bytes::Bytes;
use data_encoding::HEXLOWER;
use mlswarp::deform::Coincident;
use mlswarp::warp::{Align, Digest, Metric, RestMask, RestSummary, Warning};

use super::json_text::cancellable_json;
use crate::cache::CacheEntry;
use crate::layer::MAX_LAYERS;
use crate::limits::memory::Reservation;
use crate::pool::Cancel;
use crate::problem::Problem;
use crate::store::{Record, Session};
use crate::wire::{
    AsJson, CoincidentGroup, SessionGrid, SessionImage, SessionLayer, SessionMask, SessionObject,
    rest_revision, session_tail,
};

/// Maximum length of a number and its comma in JSON, and of what precedes the numbers of a handle.
const NUMBER_BYTES: u64 = 25;
const BRACKET_BYTES: u64 = 4;
/// Maximum length of the text without its lists: names, ids, dates, single numbers and layers.
const FIXED_PART: u64 = 2048 + 128 * MAX_LAYERS as u64;
/// Maximum length of the members that change.
const CHANGING_BYTES: u64 = 256;

/// What stays the same within a revision.
#[derive(Debug)]
pub(crate) struct RevisionText {
    /// The object without its last members.
    text: Vec<u8>,
    /// See [`RestSummary::rest_digest`].
    pub(crate) rest_digest: Digest,
    /// The warnings of the handles at rest.
    warnings: Vec<Warning>,
}

impl RevisionText {
    /// Bytes of a response.
    pub(crate) const fn response_bytes(&self) -> u64 {
        self.text.len() as u64 + CHANGING_BYTES
    }

    /// Bytes of memory.
    pub(crate) const fn bytes(&self) -> u64 {
        (size_of::<Self>() + self.text.len()) as u64
    }
}

/// A session and its object, whose memory counts for the client until it is sent.
#[derive(Debug)]
pub struct ShownSession {
    /// The session.
    pub session: Session,
    shown: SessionText,
}

/// The text of a session's object, and the memory of a response with it.
#[derive(Debug)]
pub(crate) struct SessionText {
    pub(crate) text: Arc<CacheEntry<RevisionText>>,
    pub(crate) held: Reservation,
}

/// The kept text as bytes of a response.
struct SharedText(Arc<CacheEntry<RevisionText>>);

impl AsRef<[u8]> for SharedText {
    fn as_ref(&self) -> &[u8] {
        &self.0.text
    }
}

impl ShownSession {
    /// The warnings of the handles at rest.
    pub(crate) fn warnings(&self) -> &[Warning] {
        &self.shown.text.warnings
    }

    /// The JSON of the object, in two pieces.
    pub(crate) fn into_json(self) -> [Bytes; 2] {
        let Self {
            session,
            shown: SessionText { text, mut held },
        } = self;
        let tail = session_tail(&rfc3339(session.expires), session.seq);
        held.shrink_to((text.text.len() + tail.len()) as u64);
        [held.attach(SharedText(text)), tail.into()]
    }
}

impl SessionText {
    /// The object of a session whose record the text is of.
    pub(crate) const fn of(self, session: Session) -> ShownSession {
        ShownSession {
            session,
            shown: self,
        }
    }
}

/// Maximum length of the text of a record: two coordinates of each position on either side, its
/// weight, its depth, and its index in a group of coincident points.
pub(crate) fn longest_text(record: &Record) -> u64 {
    let posed = record.pose.iter().flat_map(|pose| &pose.q);
    let places: usize = record
        .rest
        .p
        .iter()
        .chain(posed)
        .map(|handle| 1 + handle.places().len())
        .sum();
    FIXED_PART
        + (2 * NUMBER_BYTES + BRACKET_BYTES) * places as u64
        + 3 * NUMBER_BYTES * record.rest.p.len() as u64
}

/// Writes what stays the same within a revision; its text has at most `length` bytes.
/// Errors: Cancelled.
pub(crate) fn revision_text(
    record: &Record,
    summary: RestSummary,
    length: u64,
    cancel: &Cancel,
) -> Result<RevisionText, Problem> {
    let ((columns, rows), rest) = (summary.grid, &record.rest);
    let groups = summary.groups.iter().map(|handles| CoincidentGroup {
        handles: handles.clone(),
    });
    let layers = record.layers.iter().map(|(name, layer)| {
        (
            name.as_str(),
            SessionLayer {
                kind: AsJson(layer.kind),
            },
        )
    });
    let (width, height) = (record.extent.width(), record.extent.height());
    let object = SessionObject {
        id: &record.id.to_string(),
        image: SessionImage {
            width,
            height,
            digest: AsJson(record.image),
        },
        p: AsJson(&rest.p),
        q: record.pose.as_ref().map(|pose| AsJson(pose.q.as_slice())),
        strength: record
            .pose
            .as_ref()
            .map(|pose| pose.strength)
            .filter(|strength| strength.to_bits() != 1.0_f64.to_bits()),
        weights: rest.weights.as_deref(),
        depth: rest.depth.as_deref(),
        method: AsJson(rest.method),
        alpha: summary.alpha,
        point_mass: summary.point_mass,
        smoothing: summary.smoothing,
        own: AsJson(summary.own),
        metric: (rest.metric != Metric::default()).then_some(AsJson(rest.metric)),
        mask: rest.needs_mask().then(|| SessionMask {
            threshold: rest.mask_threshold.unwrap_or(RestMask::THRESHOLD),
        }),
        coincident_policy: (rest.coincident != Coincident::default())
            .then_some(AsJson(rest.coincident)),
        coincident: groups.collect(),
        units: AsJson(rest.units),
        align: (rest.align != Align::None).then_some(AsJson(rest.align)),
        grid: SessionGrid {
            columns,
            rows,
            cell: summary.cell.into(),
            requested: AsJson(rest.grid),
        },
        rest_revision: &HEXLOWER.encode(&rest_revision(summary.rest_digest)),
        folds: AsJson(record.folds),
        output: AsJson(&record.output),
        layers: layers.collect(),
        created: &rfc3339(record.created),
    };
    let mut text = cancellable_json(cancel, &object, usize::try_from(length).unwrap_or_default())?;
    // The members that change follow.
    text.pop();
    text.shrink_to_fit();
    Ok(RevisionText {
        text,
        rest_digest: summary.rest_digest,
        warnings: summary.warnings,
    })
}

/// `2026-11-21T09:30:00.125Z`. A time outside the years 1970 to 9999, which humantime cannot write,
/// becomes the nearest one inside.
pub(crate) fn rfc3339(time: SystemTime) -> String {
    let last = SystemTime::UNIX_EPOCH + Duration::from_secs(253_402_300_799);
    humantime::format_rfc3339_millis(time.clamp(SystemTime::UNIX_EPOCH, last)).to_string()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn dates_are_those_of_the_calendar() {
        for (seconds, date) in [
            (0, "1970-01-01T00:00:00.000Z"),
            (951_782_400, "2000-02-29T00:00:00.000Z"),
            (951_868_799, "2000-02-29T23:59:59.000Z"),
            (1_709_164_800, "2024-02-29T00:00:00.000Z"),
            (4_107_542_399, "2100-02-28T23:59:59.000Z"),
            (4_107_542_400, "2100-03-01T00:00:00.000Z"),
            (1_798_761_599, "2026-12-31T23:59:59.000Z"),
        ] {
            assert_eq!(
                rfc3339(SystemTime::UNIX_EPOCH + Duration::from_secs(seconds)),
                date
            );
        }
        assert_eq!(
            rfc3339(SystemTime::UNIX_EPOCH + Duration::from_millis(86_400_125)),
            "1970-01-02T00:00:00.125Z"
        );
    }
}
