//! Any bytes as what a store has kept. An odd first byte has the checksum made for what follows, so
//! that the form behind it is met. What is read is written and read again to the same, and its
//! handles are what a request could have asked for.

use mlswarp::warp::{Limits, ResolvedRest};
use mlswarp_server::store::record::{read, write};

pub(super) fn keep(bytes: &[u8]) {
    let Some((first, rest)) = bytes.split_first() else {
        return;
    };
    let kept = if first % 2 == 1 {
        [format!("{:08x}\n", crc32fast::hash(rest)).as_bytes(), rest].concat()
    } else {
        rest.to_vec()
    };
    match read(&kept) {
        Ok(record) => {
            assert_eq!(
                read(&write(&record)).as_ref(),
                Ok(&record),
                "what is written is read again"
            );
            if let Ok(setup) = ResolvedRest::new(
                &record.rest,
                record.extent,
                &Limits {
                    columns: 64,
                    plan_bytes: 1 << 20,
                    ..Limits::default()
                },
                &|| false,
            ) {
                assert!(setup.alpha().is_none_or(f64::is_finite));
            }
        }
        Err(why) => assert!(!why.to_string().is_empty()),
    }
}
