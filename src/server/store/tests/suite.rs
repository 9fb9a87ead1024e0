//! What every store promises, as tests that each of them runs.

use std::collections::BTreeMap;
use std::sync::Arc;
use std::time::{Duration, SystemTime};

use bytes::Bytes;
use mlswarp::pixmap::Extent;
use mlswarp::warp::{Digest, Folds, OutputSpec, RestSpec};

use super::layers;
use crate::client::Owner;
use crate::layer::{LayerKind, LayerName};
use crate::session::{Revision, SessionId};
use crate::store::{NamedFile, Put, Record, Store, StoreError, StoreLimits, StoredLayer};

pub(super) const IDLE: Duration = Duration::from_secs(1);

pub(crate) const fn bounds() -> StoreLimits {
    StoreLimits {
        idle: Duration::from_secs(600),
        sessions: 100,
        bytes: 1 << 20,
    }
}

/// A picture's file.
pub(crate) fn file(picture: u8) -> Bytes {
    Bytes::from(vec![picture; 1000])
}

/// These bytes as a file.
pub(crate) fn named(bytes: Bytes) -> Vec<NamedFile> {
    vec![NamedFile {
        digest: Digest::of(&bytes),
        bytes,
    }]
}

/// The files of a session of that picture.
pub(crate) fn files(picture: u8) -> Vec<NamedFile> {
    named(file(picture))
}

/// A record of that picture.
pub(crate) fn record(picture: u8) -> Arc<Record> {
    Arc::new(Record {
        id: SessionId::random(Owner::ANYBODY),
        revision: Revision::random(),
        image: Digest::of(&file(picture)),
        layers: BTreeMap::new(),
        made_with_region: None,
        extent: Extent::new(4, 3).unwrap(),
        rest: RestSpec::default().into(),
        pose: None,
        folds: Folds::default(),
        output: OutputSpec::default(),
        created: SystemTime::now(),
    })
}

/// The next record of the same session.
pub(crate) fn with_weights(record: &Record, n: usize) -> Arc<Record> {
    let rest = RestSpec {
        weights: Some(vec![1.0; n]),
        ..RestSpec::default()
    };
    Arc::new(Record {
        revision: Revision::random(),
        rest: rest.into(),
        ..record.clone()
    })
}

/// The next record of the same session, with that layer or without it.
pub(crate) fn with_layer(record: &Record, name: &str, picture: Option<u8>) -> Arc<Record> {
    let (mut layers, name) = (record.layers.clone(), LayerName::parse(name).unwrap());
    match picture {
        Some(picture) => layers.insert(
            name,
            StoredLayer {
                kind: LayerKind::Image,
                digest: Digest::of(&file(picture)),
            },
        ),
        None => layers.remove(&name),
    };
    Arc::new(Record {
        revision: Revision::random(),
        layers,
        ..record.clone()
    })
}

/// The same session, made again from another picture.
pub(crate) fn made_again(record: &Record, picture: u8) -> Arc<Record> {
    let (image, layers) = (Digest::of(&file(picture)), BTreeMap::new());
    Arc::new(Record {
        revision: Revision::random(),
        image,
        layers,
        made_with_region: None,
        created: SystemTime::now(),
        ..record.clone()
    })
}

/// What every store promises.
pub(crate) async fn all<S: Store>(open: impl AsyncFn(StoreLimits) -> S) {
    what_was_put_is_there_to_the_bit(&open(bounds()).await).await;
    a_file_goes_with_its_last_session(&open(bounds()).await).await;
    a_put_makes_a_session_once_and_replaces_another(&open(bounds()).await).await;
    handles_are_revised_once_a_revision_and_numbers_go_on(&open(bounds()).await).await;
    the_highest_seq_is_remembered(&open(bounds()).await).await;
    one_name_of_two_owners_is_two_sessions(&open(bounds()).await).await;
    a_store_that_is_there_says_so(&open(bounds()).await).await;
    layers::a_layer_is_put_replaced_and_removed(&open(bounds()).await).await;
    layers::a_layer_that_is_not_stored_leaves_nothing(&open(bounds()).await).await;
    layers::the_same_put_keeps_layers_and_another_drops_them(&open(bounds()).await).await;
    layers::layers_are_deleted_with_their_session(&open(bounds()).await).await;
    let brief = StoreLimits {
        idle: IDLE,
        ..bounds()
    };
    let (a, b) = (open(brief).await, open(brief).await);
    let (c, d) = (open(brief).await, open(brief).await);
    tokio::join!(
        a_session_expires_is_told_so_for_one_period_and_is_then_forgotten(&a),
        use_prolongs_a_life_and_looking_does_not(&b),
        a_delete_is_answered_again_for_one_period(&c),
        layers::layers_live_as_long_as_their_session(&d)
    );
}

/// What a store promises that has bounds of its own.
pub(crate) async fn bounded<S: Store>(open: impl AsyncFn(StoreLimits) -> S) {
    all(&open).await;
    a_file_is_held_once(&open(bounds()).await).await;
    a_file_counts_once_for_each_owner(
        &open(StoreLimits {
            bytes: 5000,
            ..bounds()
        })
        .await,
    )
    .await;
    layers::a_layer_is_weighed(
        &open(StoreLimits {
            bytes: 3200,
            ..bounds()
        })
        .await,
    )
    .await;
    a_full_store_refuses_newcomers_and_keeps_the_living(
        &open(StoreLimits {
            sessions: 2,
            bytes: 3500,
            ..bounds()
        })
        .await,
    )
    .await;
    a_replaced_session_weighs_what_the_new_one_does(
        &open(StoreLimits {
            sessions: 1,
            ..bounds()
        })
        .await,
    )
    .await;
    a_revision_is_weighed(
        &open(StoreLimits {
            bytes: 2000,
            ..bounds()
        })
        .await,
    )
    .await;
    expired_sessions_make_room_for_newcomers(
        &open(StoreLimits {
            idle: IDLE,
            sessions: 1,
            ..bounds()
        })
        .await,
    )
    .await;
}

async fn what_was_put_is_there_to_the_bit(store: &impl Store) {
    let a = with_weights(&record(1), 3);
    store.put(Arc::clone(&a), files(1)).await.unwrap();
    assert_eq!(store.peek(a.id).await.unwrap().record, a);
    assert_eq!(store.touch(a.id, None).await.unwrap().record, a);
    assert_eq!(store.file(a.id, a.image).await.unwrap(), file(1));
    assert!(
        store.names(a.id.owner(), a.image) && !store.names(a.id.owner(), Digest::of(&file(99)))
    );
}

async fn a_file_goes_with_its_last_session(store: &impl Store) {
    let (a, b) = (record(2), record(2));
    store.put(Arc::clone(&a), files(2)).await.unwrap();
    store.put(Arc::clone(&b), files(2)).await.unwrap();
    store.delete(a.id).await.unwrap();
    assert_eq!(store.file(b.id, b.image).await.unwrap(), file(2));
    store.delete(b.id).await.unwrap();
    assert!(!store.names(b.id.owner(), b.image));
    assert_eq!(
        store.file(b.id, b.image).await,
        Err(StoreError::NoSuchSession)
    );
    assert_eq!(store.delete(b.id).await, Ok(()), "deleted again");
    assert_eq!(
        store.peek(b.id).await.unwrap_err(),
        StoreError::NoSuchSession
    );
    assert_eq!(
        store.touch(b.id, Some(1)).await.unwrap_err(),
        StoreError::NoSuchSession
    );
}

async fn a_put_makes_a_session_once_and_replaces_another(store: &impl Store) {
    let a = record(3);
    assert!(matches!(
        store.put(Arc::clone(&a), files(3)).await,
        Ok(Put::Created(_))
    ));
    store.touch(a.id, Some(7)).await.unwrap();
    let again = Record {
        revision: Revision::random(),
        created: SystemTime::now(),
        ..(*a).clone()
    };
    let Ok(Put::Same(same)) = store.put(Arc::new(again), files(3)).await else {
        panic!("the same file and handles")
    };
    assert_eq!((same.record.revision, same.seq), (a.revision, Some(7)));

    let other = made_again(&a, 4);
    let Ok(Put::Replaced(session, old)) = store.put(Arc::clone(&other), files(4)).await else {
        panic!("another file")
    };
    assert_eq!((&session.record, session.seq, &old), (&other, None, &a));
    assert_eq!(
        store.file(a.id, a.image).await,
        Err(StoreError::NoSuchSession),
        "the old file has gone"
    );
    assert_eq!(store.file(a.id, other.image).await.unwrap(), file(4));
    assert_eq!(
        store.touch(a.id, Some(0)).await.unwrap().seq,
        Some(0),
        "numbers start from the beginning"
    );
}

async fn handles_are_revised_once_a_revision_and_numbers_go_on(store: &impl Store) {
    let a = record(5);
    store.put(Arc::clone(&a), files(5)).await.unwrap();
    store.touch(a.id, Some(7)).await.unwrap();
    let b = with_weights(&a, 4);
    let session = store
        .revise(a.revision, Arc::clone(&b), None)
        .await
        .unwrap()
        .expect("the revision is there");
    assert_eq!(
        (session.seq, store.peek(a.id).await.unwrap().record),
        (Some(7), Arc::clone(&b))
    );
    assert!(
        store
            .revise(a.revision, Arc::clone(&a), None)
            .await
            .unwrap()
            .is_none(),
        "someone was faster"
    );
    assert_eq!(store.touch(a.id, Some(6)).await.unwrap().seq, Some(7));
    let gone = record(6);
    assert_eq!(
        store.revise(gone.revision, gone, None).await.unwrap_err(),
        StoreError::NoSuchSession
    );
    // What it was made from has changed with it: the first body makes it again.
    let first = Arc::new(Record {
        revision: Revision::random(),
        ..(*a).clone()
    });
    assert!(matches!(
        store.put(first, files(5)).await,
        Ok(Put::Replaced(..))
    ));
}

async fn the_highest_seq_is_remembered(store: &impl Store) {
    let a = record(7);
    store.put(Arc::clone(&a), files(7)).await.unwrap();
    let order = [
        (None, None),
        (Some(5), Some(5)),
        (Some(3), Some(5)),
        (None, Some(5)),
        (Some(u64::MAX), Some(u64::MAX)),
    ];
    for (seq, highest) in order {
        assert_eq!(store.touch(a.id, seq).await.unwrap().seq, highest);
    }
    assert_eq!(store.peek(a.id).await.unwrap().seq, Some(u64::MAX));
}

async fn one_name_of_two_owners_is_two_sessions(store: &impl Store) {
    let a = record(8);
    let theirs = SessionId::parse(Owner::from_bytes([7; 16]), &a.id.to_string()).unwrap();
    let b = Arc::new(Record {
        id: theirs,
        ..(*made_again(&a, 9)).clone()
    });
    store.put(Arc::clone(&a), files(8)).await.unwrap();
    for absent in [store.peek(theirs).await, store.touch(theirs, None).await] {
        assert_eq!(absent.unwrap_err(), StoreError::NoSuchSession);
    }
    assert_eq!(store.delete(theirs).await, Err(StoreError::NoSuchSession));
    assert!(matches!(
        store.put(Arc::clone(&b), files(9)).await,
        Ok(Put::Created(_))
    ));
    store.touch(theirs, Some(9)).await.unwrap();
    assert_eq!(
        (
            store.peek(a.id).await.unwrap().record,
            store.peek(a.id).await.unwrap().seq
        ),
        (Arc::clone(&a), None)
    );
    store.delete(a.id).await.unwrap();
    assert_eq!(store.peek(theirs).await.unwrap().record, b);
    assert_eq!(store.file(theirs, b.image).await.unwrap(), file(9));
}

async fn a_store_that_is_there_says_so(store: &impl Store) {
    assert_eq!(store.ready().await, Ok(()));
    assert_eq!((store.figures().damaged, store.figures().failures), (0, 0));
}

async fn a_session_expires_is_told_so_for_one_period_and_is_then_forgotten(store: &impl Store) {
    let a = record(10);
    store.put(Arc::clone(&a), files(10)).await.unwrap();
    tokio::time::sleep(IDLE + IDLE / 5).await;
    assert!(matches!(
        store.peek(a.id).await.unwrap_err(),
        StoreError::Expired { .. }
    ));
    assert!(matches!(
        store.touch(a.id, None).await.unwrap_err(),
        StoreError::Expired { .. }
    ));
    store.sweep().await.unwrap();
    assert!(matches!(
        store.peek(a.id).await.unwrap_err(),
        StoreError::Expired { .. }
    ));
    assert!(matches!(
        store.delete(a.id).await.unwrap_err(),
        StoreError::Expired { .. }
    ));
    tokio::time::sleep(IDLE).await;
    assert_eq!(
        store.touch(a.id, None).await.unwrap_err(),
        StoreError::NoSuchSession
    );
    // A name may be used again.
    assert!(matches!(
        store.put(made_again(&a, 11), files(11)).await,
        Ok(Put::Created(_))
    ));
}

async fn a_delete_is_answered_again_for_one_period(store: &impl Store) {
    let (a, other) = (record(20), record(20));
    store.put(Arc::clone(&a), files(20)).await.unwrap();
    store.put(Arc::clone(&other), files(20)).await.unwrap();
    for _ in 0..2 {
        assert_eq!(store.delete(a.id).await, Ok(()));
        assert_eq!(store.was_deleted(a.id).await, Ok(true));
        store.sweep().await.unwrap();
        assert_eq!(
            store.touch(a.id, None).await.unwrap_err(),
            StoreError::NoSuchSession
        );
    }
    assert_eq!(
        store.delete(record(20).id).await,
        Err(StoreError::NoSuchSession),
        "it was never there"
    );
    assert_eq!(store.was_deleted(record(20).id).await, Ok(false));
    // A name that is used again is another session, which can be deleted like the first.
    let new = made_again(&a, 21);
    assert!(matches!(
        store.put(Arc::clone(&new), files(21)).await,
        Ok(Put::Created(_))
    ));
    assert_eq!(store.peek(a.id).await.unwrap().record, new);
    assert_eq!(store.was_deleted(a.id).await, Ok(false));
    store.delete(a.id).await.unwrap();
    assert_eq!(
        store.peek(a.id).await.unwrap_err(),
        StoreError::NoSuchSession
    );
    tokio::time::sleep(IDLE / 2).await;
    assert_eq!(store.delete(a.id).await, Ok(()));
    tokio::time::sleep(IDLE / 5 * 4).await;
    assert_eq!(
        store.delete(a.id).await,
        Err(StoreError::NoSuchSession),
        "deleting again does not prolong it"
    );
}

/// The record's JSON with a change, sealed with a checksum of its own.
fn resealed(record: &Record, change: impl Fn(&str) -> String) -> Vec<u8> {
    let bytes = crate::store::record::write(record);
    let (_, json) = std::str::from_utf8(&bytes)
        .unwrap()
        .split_once('\n')
        .unwrap();
    crate::store::record::sealed(change(json).as_bytes())
}

/// Records as a later version of the program may write them. `plant` puts these bytes in the places
/// of those sessions' records, as another process does.
pub(crate) async fn what_another_version_has_stored_is_kept<S: Store>(
    store: S,
    plant: impl AsyncFn(S, &[(SessionId, Vec<u8>)]) -> S,
) {
    let (a, b, c, neighbour) = (record(30), record(31), record(32), record(30));
    for (record, picture) in [(&a, 30), (&b, 31), (&c, 32), (&neighbour, 30)] {
        store.put(Arc::clone(record), files(picture)).await.unwrap();
    }
    store.touch(a.id, Some(7)).await.unwrap();
    let newer = [
        (
            a.id,
            resealed(&a, |json| {
                json.replace("\"version\":1", "\"version\":2,\"strength\":1.5")
            }),
        ),
        (
            b.id,
            resealed(&b, |json| {
                json.replace("\"warp\":{", "\"warp\":{\"stiffness\":1.5,")
            }),
        ),
        (
            c.id,
            resealed(&c, |json| {
                json.replace("\"output\":{", "\"output\":{\"filter\":\"lanczos\",")
            }),
        ),
    ];
    let store = plant(store, &newer).await;
    for (record, picture) in [(&a, 30), (&b, 31), (&c, 32)] {
        assert_eq!(
            store.peek(record.id).await.unwrap_err(),
            StoreError::OtherVersion
        );
        assert_eq!(
            store.touch(record.id, None).await.unwrap_err(),
            StoreError::OtherVersion
        );
        let again = made_again(record, picture);
        assert_eq!(
            store.put(again, files(picture)).await.unwrap_err(),
            StoreError::OtherVersion,
            "the same"
        );
        assert_eq!(
            store
                .put(made_again(record, 33), files(33))
                .await
                .unwrap_err(),
            StoreError::OtherVersion,
            "something else"
        );
        let revised = store
            .revise(record.revision, with_weights(record, 2), None)
            .await;
        assert!(
            matches!(revised, Err(StoreError::OtherVersion) | Ok(None)),
            "{revised:?}"
        );
    }
    assert!(store.figures().other_version >= 3);
    assert_eq!(store.figures().damaged, 0);
    // The others are as they were, and what they leave behind is not what the unread sessions need.
    assert_eq!(
        store.file(neighbour.id, neighbour.image).await.unwrap(),
        file(30)
    );
    store.delete(neighbour.id).await.unwrap();
    store.sweep().await.unwrap();
    let store = plant(store, &[]).await;
    // The version that has written them finds them to the bit, with their pictures and numbers.
    let first = [
        (a.id, crate::store::record::write(&a)),
        (b.id, crate::store::record::write(&b)),
    ];
    let store = plant(store, &first).await;
    for (record, picture, seq) in [(&a, 30, Some(7)), (&b, 31, None)] {
        let session = store.peek(record.id).await.unwrap();
        assert_eq!((&session.record, session.seq), (record, seq));
        assert_eq!(
            store.file(record.id, record.image).await.unwrap(),
            file(picture)
        );
    }
    // Its owner may delete what is not read here.
    for _ in 0..2 {
        assert_eq!(store.delete(c.id).await, Ok(()));
        assert_eq!(
            store.peek(c.id).await.unwrap_err(),
            StoreError::NoSuchSession
        );
    }
    assert!(matches!(
        store.put(Arc::clone(&c), files(32)).await,
        Ok(Put::Created(_))
    ));
}

async fn use_prolongs_a_life_and_looking_does_not(store: &impl Store) {
    let (used, seen) = (record(12), record(13));
    store.put(Arc::clone(&used), files(12)).await.unwrap();
    store.put(Arc::clone(&seen), files(13)).await.unwrap();
    for _ in 0..5 {
        tokio::time::sleep(IDLE / 4).await;
        store.touch(used.id, None).await.unwrap();
        let _ = store.peek(seen.id).await;
    }
    assert!(store.peek(used.id).await.is_ok());
    assert_eq!(
        store.file(used.id, used.image).await.unwrap(),
        file(12),
        "the file lives as long"
    );
    assert!(matches!(
        store.peek(seen.id).await.unwrap_err(),
        StoreError::Expired { .. }
    ));
}

async fn a_file_is_held_once(store: &impl Store) {
    let (a, b) = (record(1), record(1));
    store.put(Arc::clone(&a), files(1)).await.unwrap();
    let one = store.figures().bytes;
    store.put(Arc::clone(&b), files(1)).await.unwrap();
    assert_eq!(
        (store.figures().bytes, store.figures().sessions),
        (one + (one - 1000), 2)
    );
    store.delete(a.id).await.unwrap();
    store.delete(b.id).await.unwrap();
    assert_eq!((store.figures().bytes, store.figures().sessions), (0, 0));
}

/// Whatever another owner has stored: the figures, and what a full store says, are those of a file
/// that nobody has.
async fn a_file_counts_once_for_each_owner(store: &impl Store) {
    let theirs = |picture: u8| {
        let id = SessionId::random(Owner::from_bytes([7; 16]));
        Arc::new(Record {
            id,
            ..(*record(picture)).clone()
        })
    };
    let ours = [record(1), with_layer(&record(1), "x", Some(2))];
    store.put(Arc::clone(&ours[0]), files(1)).await.unwrap();
    store
        .put(Arc::clone(&ours[1]), [files(1), files(2)].concat())
        .await
        .unwrap();
    let before = store.figures().bytes;
    let mut told = Vec::new();
    // Our picture, our layer, and a file that belongs to no session.
    for picture in [1, 2, 3] {
        let one = theirs(picture);
        store.put(Arc::clone(&one), files(picture)).await.unwrap();
        let refused = store
            .put(theirs(4), [files(4), named(vec![0; 2000].into())].concat())
            .await;
        told.push((store.figures(), refused.unwrap_err()));
        store.delete(one.id).await.unwrap();
        assert_eq!(store.figures().bytes, before);
    }
    assert!(
        matches!(
            told[0].1,
            StoreError::Full {
                what: "store_bytes",
                ..
            }
        ),
        "{:?}",
        told[0]
    );
    assert_eq!((&told[0], &told[1]), (&told[2], &told[2]));
    // Each has the file for as long as its own sessions name it.
    let one = theirs(2);
    store.put(Arc::clone(&one), files(2)).await.unwrap();
    for session in ours {
        store.delete(session.id).await.unwrap();
    }
    assert!(!store.names(Owner::ANYBODY, one.image) && store.names(one.id.owner(), one.image));
    assert_eq!(store.file(one.id, one.image).await.unwrap(), file(2));
    store.delete(one.id).await.unwrap();
    assert_eq!((store.figures().bytes, store.figures().sessions), (0, 0));
}

async fn a_replaced_session_weighs_what_the_new_one_does(store: &impl Store) {
    let a = record(1);
    store.put(Arc::clone(&a), files(1)).await.unwrap();
    let one = store.figures().bytes;
    let short = Bytes::from_static(b"300");
    let other = Arc::new(Record {
        image: Digest::of(&short),
        ..(*made_again(&a, 2)).clone()
    });
    store.put(other, named(short)).await.unwrap();
    assert_eq!(store.figures().bytes, one - 997);
    assert!(matches!(
        store.put(record(3), files(3)).await,
        Err(StoreError::Full {
            what: "sessions",
            ..
        })
    ));
}

async fn a_revision_is_weighed(store: &impl Store) {
    let a = record(1);
    store.put(Arc::clone(&a), files(1)).await.unwrap();
    let before = store.figures().bytes;
    let b = with_weights(&a, 4);
    store
        .revise(a.revision, Arc::clone(&b), None)
        .await
        .unwrap()
        .unwrap();
    assert_eq!(store.figures().bytes, before + 32);
    assert!(matches!(
        store.revise(b.revision, with_weights(&a, 100), None).await,
        Err(StoreError::Full {
            what: "store_bytes",
            ..
        })
    ));
    assert_eq!(store.peek(a.id).await.unwrap().record, b);
    store.delete(a.id).await.unwrap();
    assert_eq!(store.figures().bytes, 0);
}

async fn a_full_store_refuses_newcomers_and_keeps_the_living(store: &impl Store) {
    let a = record(1);
    store.put(Arc::clone(&a), files(1)).await.unwrap();
    let large = Bytes::from(vec![0; 4000]);
    let refused = store
        .put(
            Arc::new(Record {
                image: Digest::of(&large),
                ..(*record(2)).clone()
            }),
            named(large),
        )
        .await
        .unwrap_err();
    assert!(
        matches!(
            refused,
            StoreError::Full {
                what: "store_bytes",
                limit: 3500,
                ..
            }
        ),
        "{refused:?}"
    );
    store.put(record(3), files(3)).await.unwrap();
    let refused = store.put(record(4), files(4)).await.unwrap_err();
    assert_eq!(
        refused,
        StoreError::Full {
            what: "sessions",
            limit: 2,
            actual: 3
        }
    );
    assert!(store.peek(a.id).await.is_ok());
}

async fn expired_sessions_make_room_for_newcomers(store: &impl Store) {
    store.put(record(1), files(1)).await.unwrap();
    tokio::time::sleep(IDLE + IDLE / 5).await;
    store.put(record(2), files(2)).await.unwrap();
    tokio::time::sleep(IDLE + IDLE / 5).await;
    assert_eq!(store.sweep().await, Ok(1));
    assert_eq!(store.figures().bytes, 0);
}
