//! Records as bytes: a checksum and a JSON object that a person can read. Numbers come back to the bit.

use std::sync::Arc;
use std::time::{Duration, SystemTime};

use serde::{Deserialize, Serialize};
use serde_json::value::RawValue;

use super::Record;
use crate::pixmap::Extent;
use crate::service::session::{Revision, SessionId};
use crate::service::wire::{WarpObject, Wire};
use crate::warp::Digest;

/// Of the form of records: a program that does not know it leaves the record alone.
const VERSION: u32 = 1;
/// Hexadecimal digits of the checksum, and a line break.
const CHECKSUM: usize = 9;

/// Why bytes are no record.
#[derive(Clone, Debug, PartialEq, Eq, thiserror::Error)]
#[error("{0}")]
pub struct Corrupt(String);

#[derive(Serialize)]
struct Written<'a> {
    version: u32,
    id: String,
    revision: String,
    image: String,
    width: u32,
    height: u32,
    /// Nanoseconds since 1970.
    created: u64,
    warp: Wire<&'a WarpObject>,
}

#[derive(Deserialize)]
struct Form {
    version: u32,
}

#[derive(Deserialize)]
struct Read<'a> {
    id: String,
    revision: String,
    image: String,
    width: u32,
    height: u32,
    created: u64,
    #[serde(borrow)]
    warp: &'a RawValue,
}

/// The record as bytes.
#[must_use]
pub fn write(record: &Record) -> Vec<u8> {
    let warp = object(record);
    let created = record.created.duration_since(SystemTime::UNIX_EPOCH).unwrap_or_default();
    let written = Written {
        version: VERSION,
        id: hex(&record.id.to_bytes()),
        revision: hex(record.revision.as_bytes()),
        image: hex(&record.image.0),
        width: record.extent.width(),
        height: record.extent.height(),
        created: u64::try_from(created.as_nanos()).unwrap_or(u64::MAX),
        warp: Wire(&warp),
    };
    let json = serde_json::to_vec(&written).expect("an object of numbers and words");
    let mut bytes = format!("{:08x}\n", crc32fast::hash(&json)).into_bytes();
    bytes.extend_from_slice(&json);
    bytes
}

/// The record that the bytes are.
///
/// # Errors
/// They are none, or not as they were written, or of another version.
pub fn read(bytes: &[u8]) -> Result<Arc<Record>, Corrupt> {
    let corrupt = |why: &str| Corrupt(why.to_owned());
    let (sum, json) = bytes.split_at_checked(CHECKSUM).ok_or_else(|| corrupt("too short"))?;
    if sum != format!("{:08x}\n", crc32fast::hash(json)).as_bytes() {
        return Err(corrupt("its checksum is another"));
    }
    // The version first: another one may have other fields.
    let Form { version } = serde_json::from_slice(json).map_err(|e| Corrupt(e.to_string()))?;
    if version != VERSION {
        return Err(Corrupt(format!("its form is version {version}; this program knows {VERSION}")));
    }
    let read: Read<'_> = serde_json::from_slice(json).map_err(|e| Corrupt(e.to_string()))?;
    let warp = WarpObject::parse(read.warp.get().as_bytes()).map_err(|problem| Corrupt(problem.detail))?;
    Ok(Arc::new(Record {
        id: SessionId::from_bytes(&unhex(&read.id).ok_or_else(|| corrupt("its name is none"))?),
        revision: Revision::from_bytes(unhex(&read.revision).ok_or_else(|| corrupt("its revision is none"))?),
        image: Digest(unhex(&read.image).ok_or_else(|| corrupt("its picture's digest is none"))?),
        extent: Extent::new(read.width, read.height).ok_or_else(|| corrupt("its picture has no size"))?,
        rest: warp.rest,
        folds: warp.folds,
        output: warp.output,
        created: SystemTime::UNIX_EPOCH + Duration::from_nanos(read.created),
    }))
}

/// Digest of what two records that are made alike share.
pub(super) fn made(record: &Record) -> Digest {
    let made = (hex(&record.image.0), Wire(&object(record)));
    Digest::of(&serde_json::to_vec(&made).expect("an object of numbers and words"))
}

/// Lower-case hexadecimal digits.
pub(super) fn hex(bytes: &[u8]) -> String {
    use std::fmt::Write as _;
    bytes.iter().fold(String::with_capacity(2 * bytes.len()), |mut text, byte| {
        let _ = write!(text, "{byte:02x}");
        text
    })
}

fn unhex<const N: usize>(text: &str) -> Option<[u8; N]> {
    if text.len() != 2 * N || !text.bytes().all(|b| b.is_ascii_hexdigit()) {
        return None;
    }
    let mut bytes = [0; N];
    for (byte, at) in bytes.iter_mut().zip((0..2 * N).step_by(2)) {
        *byte = u8::from_str_radix(text.get(at..at + 2)?, 16).ok()?;
    }
    Some(bytes)
}

fn object(record: &Record) -> WarpObject {
    WarpObject { rest: record.rest.clone(), q: None, folds: record.folds, output: record.output }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::deform::Handle;
    use crate::geometry::Point;
    use crate::service::store::suite;
    use crate::warp::RestSpec;

    fn rich() -> Record {
        let p = vec![Handle::Point(Point::new(0.1, -0.0)), Handle::Polyline(vec![Point::new(1e-300, 2.5), Point::new(1.0 / 3.0, 1e5)])];
        let rest = RestSpec { p, weights: Some(vec![1.0, 0.1 + 0.2]), alpha: Some(1.3), ..RestSpec::default() };
        Record { rest, created: SystemTime::UNIX_EPOCH + Duration::from_nanos(1_795_000_000_123_456_789), ..(*suite::record(7)).clone() }
    }

    #[test]
    fn what_is_written_reads_back_to_the_bit() {
        let record = rich();
        let back = read(&write(&record)).unwrap();
        assert_eq!(*back, record);
        assert_eq!(write(&back), write(&record));
        assert_eq!(made(&back), made(&record));
    }

    #[test]
    fn a_changed_byte_anywhere_is_seen() {
        let bytes = write(&rich());
        for k in 0..bytes.len() {
            let mut bad = bytes.clone();
            bad[k] ^= 1;
            assert!(read(&bad).is_err(), "byte {k}");
            assert!(read(&bytes[..k]).is_err(), "{k} bytes");
        }
    }

    #[test]
    fn a_record_of_another_version_is_left_alone() {
        let text = String::from_utf8(write(&rich())).unwrap();
        let json = text[CHECKSUM..].replace("\"version\":1", "\"version\":2");
        let bytes = format!("{:08x}\n{json}", crc32fast::hash(json.as_bytes()));
        assert!(read(bytes.as_bytes()).unwrap_err().to_string().contains("version 2"));
    }
}
