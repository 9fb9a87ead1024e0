//! What every store promises about layers.

use std::sync::Arc;
use std::time::SystemTime;

use mlswarp::warp::Digest;

use super::suite::{IDLE, file, files, made_again, named, record, with_layer, with_weights};
use crate::session::Revision;
use crate::store::{Put, Record, Store, StoreError};

async fn is_there(store: &impl Store, record: &Record, n: u8) -> bool {
    match store.file(record.id, Digest::of(&file(n))).await {
        Ok(bytes) => {
            assert_eq!(bytes, file(n));
            true
        }
        Err(error) => {
            assert_eq!(error, StoreError::NoSuchSession);
            false
        }
    }
}

pub(super) async fn a_layer_is_put_replaced_and_removed(store: &impl Store) {
    let a = record(1);
    store.put(Arc::clone(&a), files(1)).await.unwrap();
    store.touch(a.id, Some(7)).await.unwrap();
    let b = with_layer(&a, "mask", Some(2));
    let session = store
        .revise(a.revision, Arc::clone(&b), named(file(2)).pop())
        .await
        .unwrap()
        .expect("the revision is there");
    assert_eq!((&session.record, session.seq), (&b, Some(7)));
    assert_eq!(store.peek(a.id).await.unwrap().record, b);
    assert!(is_there(store, &a, 2).await && store.names(a.id.owner(), Digest::of(&file(2))));
    // New handles keep it.
    let c = with_weights(&b, 3);
    store
        .revise(b.revision, Arc::clone(&c), None)
        .await
        .unwrap()
        .expect("the revision is there");
    assert!(c.layers == b.layers && is_there(store, &a, 2).await);
    let d = with_layer(&c, "mask", Some(3));
    store
        .revise(c.revision, Arc::clone(&d), named(file(3)).pop())
        .await
        .unwrap()
        .expect("the revision is there");
    assert!(is_there(store, &a, 3).await && !is_there(store, &a, 2).await);
    // A second name for the file, and a layer that is the picture.
    let e = with_layer(&with_layer(&d, "again", Some(3)), "picture", Some(1));
    store
        .revise(d.revision, Arc::clone(&e), named(file(1)).pop())
        .await
        .unwrap()
        .expect("the revision is there");
    let f = with_layer(&with_layer(&e, "mask", None), "picture", None);
    store
        .revise(e.revision, Arc::clone(&f), None)
        .await
        .unwrap()
        .expect("the revision is there");
    assert!(is_there(store, &a, 1).await && is_there(store, &a, 3).await);
    let g = with_layer(&f, "again", None);
    store
        .revise(f.revision, Arc::clone(&g), None)
        .await
        .unwrap()
        .expect("the revision is there");
    assert!(is_there(store, &a, 1).await && !is_there(store, &a, 3).await);
    assert_eq!(store.peek(a.id).await.unwrap().record, g);
}

pub(super) async fn a_layer_that_is_not_stored_leaves_nothing(store: &impl Store) {
    let a = record(1);
    let layer = || named(file(5)).pop();
    let refused = store
        .revise(a.revision, with_layer(&a, "x", Some(5)), layer())
        .await
        .unwrap_err();
    assert_eq!(refused, StoreError::NoSuchSession);
    store.put(Arc::clone(&a), files(1)).await.unwrap();
    assert!(
        store
            .revise(Revision::random(), with_layer(&a, "x", Some(5)), layer())
            .await
            .unwrap()
            .is_none()
    );
    assert!(!is_there(store, &a, 5).await && store.peek(a.id).await.unwrap().record == a);
    // What is there stays when another request for the same file comes too late.
    let b = with_layer(&a, "x", Some(5));
    store
        .revise(a.revision, Arc::clone(&b), layer())
        .await
        .unwrap()
        .expect("the revision is there");
    assert!(
        store
            .revise(a.revision, with_layer(&a, "y", Some(5)), layer())
            .await
            .unwrap()
            .is_none()
    );
    assert!(is_there(store, &a, 5).await && store.peek(a.id).await.unwrap().record == b);
}

pub(super) async fn the_same_put_keeps_layers_and_another_drops_them(store: &impl Store) {
    let a = record(1);
    store.put(Arc::clone(&a), files(1)).await.unwrap();
    let b = with_layer(&a, "x", Some(2));
    store
        .revise(a.revision, Arc::clone(&b), named(file(2)).pop())
        .await
        .unwrap()
        .expect("the revision is there");
    let again = Record {
        revision: Revision::random(),
        created: SystemTime::now(),
        ..(*a).clone()
    };
    let Ok(Put::Same(same)) = store.put(Arc::new(again), files(1)).await else {
        panic!("the same picture and handles")
    };
    assert!(same.record == b && is_there(store, &a, 2).await);
    let Ok(Put::Replaced(session, old)) = store.put(made_again(&a, 3), files(3)).await else {
        panic!("another picture")
    };
    assert!(
        session.record.layers.is_empty()
            && old == b
            && !is_there(store, &a, 2).await
            && is_there(store, &a, 3).await
    );
    // A mask of the upload itself.
    let masked = |n: u8| {
        let region = Digest::of(&file(n));
        Arc::new(Record {
            made_with_region: Some(region),
            ..(*with_layer(&made_again(&a, 3), "region", Some(n))).clone()
        })
    };
    let with_mask = |n: u8| [files(3), files(n)].concat();
    assert!(matches!(
        store.put(masked(4), with_mask(4)).await,
        Ok(Put::Replaced(..))
    ));
    assert!(is_there(store, &a, 3).await && is_there(store, &a, 4).await);
    assert!(matches!(
        store.put(masked(4), with_mask(4)).await,
        Ok(Put::Same(_))
    ));
    assert!(matches!(
        store.put(masked(3), with_mask(3)).await,
        Ok(Put::Replaced(..))
    ));
    assert!(is_there(store, &a, 3).await && !is_there(store, &a, 4).await);
    assert!(matches!(
        store.put(made_again(&a, 3), files(3)).await,
        Ok(Put::Replaced(..))
    ));
    assert!(is_there(store, &a, 3).await);
}

pub(super) async fn layers_are_deleted_with_their_session(store: &impl Store) {
    let a = record(1);
    store.put(Arc::clone(&a), files(1)).await.unwrap();
    store
        .revise(
            a.revision,
            with_layer(&a, "x", Some(2)),
            named(file(2)).pop(),
        )
        .await
        .unwrap()
        .expect("the revision is there");
    store.delete(a.id).await.unwrap();
    assert!(!is_there(store, &a, 2).await && !store.names(a.id.owner(), Digest::of(&file(2))));
    assert!(matches!(
        store.put(Arc::clone(&a), files(1)).await,
        Ok(Put::Created(_))
    ));
    assert!(!is_there(store, &a, 2).await);
}

pub(super) async fn layers_live_as_long_as_their_session(store: &impl Store) {
    let a = record(1);
    store.put(Arc::clone(&a), files(1)).await.unwrap();
    store
        .revise(
            a.revision,
            with_layer(&a, "x", Some(2)),
            named(file(2)).pop(),
        )
        .await
        .unwrap()
        .expect("the revision is there");
    for _ in 0..5 {
        tokio::time::sleep(IDLE / 4).await;
        store.touch(a.id, None).await.unwrap();
    }
    assert!(is_there(store, &a, 2).await);
    tokio::time::sleep(IDLE + IDLE / 5).await;
    store.sweep().await.unwrap();
    assert!(!is_there(store, &a, 2).await);
}

pub(super) async fn a_layer_is_weighed(store: &impl Store) {
    let a = record(1);
    store.put(Arc::clone(&a), files(1)).await.unwrap();
    let alone = store.figures().bytes;
    let b = with_layer(&a, "x", Some(2));
    store
        .revise(a.revision, Arc::clone(&b), named(file(2)).pop())
        .await
        .unwrap()
        .expect("the revision is there");
    let with_one = store.figures().bytes;
    assert!(with_one > alone + 1000);
    let refused = store
        .revise(
            b.revision,
            with_layer(&b, "y", Some(3)),
            named(file(3)).pop(),
        )
        .await
        .unwrap_err();
    assert!(
        matches!(
            refused,
            StoreError::Full {
                what: "store_bytes",
                ..
            }
        ),
        "{refused:?}"
    );
    assert!(!is_there(store, &a, 3).await && store.figures().bytes == with_one);
    // The same file again takes no more than its name.
    let c = with_layer(&b, "y", Some(1));
    store
        .revise(b.revision, Arc::clone(&c), named(file(1)).pop())
        .await
        .unwrap()
        .expect("the revision is there");
    assert_eq!(store.figures().bytes - with_one, with_one - alone - 1000);
    let d = with_layer(&with_layer(&c, "x", None), "y", None);
    store
        .revise(c.revision, d, None)
        .await
        .unwrap()
        .expect("the revision is there");
    assert_eq!(store.figures().bytes, alone);
    store.delete(a.id).await.unwrap();
    assert_eq!(store.figures().bytes, 0);
}
