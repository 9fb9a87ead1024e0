//! The stored record and the digest of what a session was made from, of each method: programs of
//! several versions share a store.

use std::sync::Arc;

use super::super::record::{made, read, write};
use super::suite;
use crate::wire::{Reserved, WarpObject, WarpPatch};

/// Warp objects, the first digits of the digest of what they make, and their part of the record.
const PINNED: [(&str, &str, &str); 6] = [
    (
        r#"{"p": [[1, 2], [3, 4]]}"#,
        "dc3330adcf22c692",
        r#":{"p":[[1.0,2.0],[3.0,4.0]],"output":{"quality":85}}}"#,
    ),
    (
        r#"{"p": [[1, 2], [3, 4]], "method": "similarity", "alpha": 1.5}"#,
        "cbfd2178e285770d",
        r#":{"p":[[1.0,2.0],[3.0,4.0]],"method":"similarity","alpha":1.5,"output":{"quality":85}}}"#,
    ),
    (
        r#"{"p": [[1, 2], [3, 4]], "method": "affine", "point_mass": 2}"#,
        "9431eb227246d7d0",
        r#":{"p":[[1.0,2.0],[3.0,4.0]],"method":"affine","point_mass":2.0,"output":{"quality":85}}}"#,
    ),
    (
        r#"{"p": [[1, 2], [3, 4]], "method": "tps"}"#,
        "3fc7fdbccef005a6",
        r#":{"p":[[1.0,2.0],[3.0,4.0]],"method":"tps","output":{"quality":85}}}"#,
    ),
    (
        r#"{"p": [[1, 2], [3, 4]], "method": "tps", "smoothing": 0.1}"#,
        "7f3be8d470e32c02",
        r#":{"p":[[1.0,2.0],[3.0,4.0]],"method":"tps","smoothing":0.1,"output":{"quality":85}}}"#,
    ),
    (
        r#"{"p": [[1, 2], [3, 4]], "method": "global_affine", "point_mass": 2}"#,
        "ec99b9fc0fe57a28",
        r#":{"p":[[1.0,2.0],[3.0,4.0]],"method":"global_affine","point_mass":2.0,"output":{"quality":85}}}"#,
    ),
];

#[test]
fn records_of_methods_are_those_of_former_versions() {
    for (text, digest, stored) in PINNED {
        let patch = Reserved::<WarpPatch, _>::parse(text.as_bytes(), |_| Ok(()));
        let (patch, ()) = patch
            .map_err(|problem| problem.detail)
            .unwrap()
            .into_parts();
        let mut record = (*suite::record(7)).clone();
        record.rest = patch.merge_onto(WarpObject::default()).rest.into();
        assert_eq!(made(&record).to_string()[..16], *digest, "{text}");
        let written = write(&record);
        let json = String::from_utf8(written.clone()).unwrap();
        assert_eq!(json.split("\"warp\"").nth(1).unwrap(), stored, "{text}");
        assert_eq!(read(&written).unwrap(), Arc::new(record), "{text}");
    }
}
