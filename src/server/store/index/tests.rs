use super::*;
use crate::store::tests::suite;

#[test]
fn a_name_that_is_used_again_has_one_tombstone() {
    let idle = Duration::from_secs(60);
    let mut index = Index::new(
        StoreLimits {
            idle,
            sessions: 1,
            bytes: 1 << 20,
        },
        true,
    );
    let record = suite::record(1);
    for _ in 0..3 {
        index.put(Arc::clone(&record), &suite::files(1), PutOutcome::Create);
        // A wait could miss the tombstone: it lasts for one idle period.
        let used = &mut index.sessions.get_mut(&record.id).unwrap().used;
        *used = used.checked_sub(idle).unwrap();
        index.expire(&index.expired());
        assert_eq!(index.tombstones.len(), 1);
    }
}

#[test]
fn no_more_deleted_sessions_are_remembered_than_there_may_be_sessions() {
    let mut index = Index::new(
        StoreLimits {
            sessions: 3,
            ..suite::bounds()
        },
        true,
    );
    let ids: Vec<SessionId> = (0..5)
        .map(|_| {
            let record = suite::record(1);
            index.put(Arc::clone(&record), &suite::files(1), PutOutcome::Create);
            index.delete(record.id);
            record.id
        })
        .collect();
    assert_eq!((index.tombstones.len(), index.bytes()), (3, 0));
    let again: Vec<_> = ids.iter().map(|id| index.check_delete(*id)).collect();
    assert_eq!(
        again,
        [
            Err(StoreError::NoSuchSession),
            Err(StoreError::NoSuchSession),
            Ok(false),
            Ok(false),
            Ok(false)
        ]
    );
}
