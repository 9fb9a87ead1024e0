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
        index.expire(&index.expired(usize::MAX));
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

/// What is used stays in the order of its use, so that a sweep ends at the first that lives.
#[test]
fn the_oldest_sessions_expire_first_and_a_sweep_may_end_early() {
    let idle = Duration::from_secs(60);
    let bounds = StoreLimits {
        idle,
        ..suite::bounds()
    };
    let mut index = Index::new(bounds, true);
    let records: Vec<_> = (0..4).map(|_| suite::record(1)).collect();
    for record in &records {
        index.put(Arc::clone(record), &suite::files(1), PutOutcome::Create);
    }
    let ids: Vec<SessionId> = records.iter().map(|record| record.id).collect();
    index.touch(ids[0], None).unwrap();
    let revised = Record {
        revision: Revision::random(),
        ..(*records[1]).clone()
    };
    index.revise(Arc::new(revised), &[]).unwrap();
    let oldest_first = [ids[2], ids[3], ids[0], ids[1]];
    let mut end = |id: SessionId| {
        let used = &mut index.sessions.peek_mut(&id).unwrap().used;
        *used = used.checked_sub(idle).unwrap();
    };
    end(ids[2]);
    end(ids[0]);
    assert_eq!(
        index.expired(usize::MAX),
        oldest_first[..1],
        "the next one lives"
    );
    let mut again = Index::new(bounds, true);
    for record in &records {
        again.put(Arc::clone(record), &suite::files(1), PutOutcome::Create);
    }
    again.carry_over(index);
    assert_eq!(
        again.expired(usize::MAX),
        [ids[2], ids[0]],
        "in the order of their use"
    );
    assert_eq!(again.expired(1), [ids[2]]);
}
