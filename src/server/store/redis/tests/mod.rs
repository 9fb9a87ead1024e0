use data_encoding::HEXLOWER;

use super::*;
use crate::store::StoreUrl;
use crate::store::tests::suite::{
    bounds, file, files, made_again, named, with_layer, with_weights,
};
use crate::store::tests::{model, suite};

mod outages;
#[path = "../../../../../tests/it/support/redis.rs"]
mod server;
mod transfers;

use server::Redis;

fn store_of(server: &Redis, bounds: StoreLimits) -> RedisStore {
    let Ok(StoreUrl::Redis(address)) = server.address().parse() else {
        panic!("an address")
    };
    RedisStore::new(&address, bounds).unwrap()
}

#[tokio::test]
async fn keeps_the_rules_of_every_store() {
    let server = Redis::start(&[]);
    suite::all(async |wanted| store_of(&server, wanted)).await;
}

#[tokio::test]
async fn several_processes_do_what_the_model_does() {
    model::with_each_seed(async |seed| {
        let server = Redis::start(&[]);
        let open = async |_| {
            vec![
                store_of(&server, model::bounds()),
                store_of(&server, model::bounds()),
            ]
        };
        model::follows(open, seed, 400, false, false).await;
    })
    .await;
}

#[tokio::test(flavor = "multi_thread", worker_threads = 4)]
async fn neighbours_do_not_disturb_each_other() {
    let server = Redis::start(&[]);
    let stores = (0..2)
        .map(|_| Arc::new(store_of(&server, bounds())))
        .collect();
    model::neighbours_do_not_disturb_each_other(stores, Duration::from_secs(2)).await;
}

#[tokio::test]
async fn a_key_of_somebody_else_is_no_outage() {
    let server = Redis::start(&[]);
    let store = store_of(&server, bounds());
    let (a, b) = (suite::record(1), suite::record(2));
    store_of(&server, bounds())
        .put(Arc::clone(&b), files(2))
        .await
        .unwrap();
    let key = script::key(a.id, "session");
    assert_eq!(server.say(&format!("SET {key} nothing")), "+OK\r\n");
    assert!(store.touch(a.id, None).await.is_err());
    assert!(store.peek(b.id).await.is_ok(), "the others are there");
    assert_eq!(server.say(&format!("DEL {key}")), ":1\r\n");
    assert_eq!(server.say(&format!("HSET {key} revision x")), ":1\r\n");
    assert!(store.touch(a.id, None).await.is_err());
    assert!(store.peek(b.id).await.is_ok(), "the others are there");
}

#[tokio::test]
async fn another_process_sees_the_session_its_numbers_and_its_handles_at_once() {
    let server = Redis::start(&[]);
    let (one, other) = (store_of(&server, bounds()), store_of(&server, bounds()));
    let a = suite::record(1);
    one.put(Arc::clone(&a), files(1)).await.unwrap();
    one.touch(a.id, Some(41)).await.unwrap();
    let there = other.touch(a.id, Some(3)).await.unwrap();
    assert_eq!((&there.record, there.seq), (&a, Some(41)));
    assert_eq!(other.file(a.id, a.image).await.unwrap(), file(1));

    let b = with_weights(&a, 2);
    other
        .revise(a.revision, Arc::clone(&b), None)
        .await
        .unwrap()
        .unwrap();
    assert!(
        one.revise(a.revision, with_weights(&a, 3), None)
            .await
            .unwrap()
            .is_none()
    );
    assert_eq!(one.touch(a.id, None).await.unwrap().record, b);

    let c = made_again(&a, 2);
    assert!(matches!(
        other.put(Arc::clone(&c), files(2)).await,
        Ok(Put::Replaced(..))
    ));
    let there = one.touch(a.id, Some(0)).await.unwrap();
    assert_eq!(
        (&there.record, there.seq),
        (&c, Some(0)),
        "numbers of the old life do not count"
    );
    assert_eq!(
        one.file(a.id, a.image).await,
        Err(StoreError::NoSuchSession)
    );

    other.delete(a.id).await.unwrap();
    assert_eq!(
        one.touch(a.id, None).await.unwrap_err(),
        StoreError::NoSuchSession
    );
    assert_eq!(
        one.delete(a.id).await,
        Ok(()),
        "deleted again, by another process"
    );
    assert_eq!(
        server.say("DBSIZE"),
        ":1\r\n",
        "nothing is left but that it was deleted"
    );
}

#[tokio::test]
async fn a_full_server_refuses_newcomers_and_goes_on_with_the_living() {
    let server = Redis::start(&["--maxmemory-policy", "noeviction"]);
    let (store, other) = (store_of(&server, bounds()), store_of(&server, bounds()));
    let a = suite::record(1);
    store.put(Arc::clone(&a), files(1)).await.unwrap();
    // An empty server takes more than that.
    assert_eq!(server.say("CONFIG SET maxmemory 100kb"), "+OK\r\n");
    let large = Bytes::from(vec![5; 1 << 20]);
    let record = Arc::new(Record {
        image: Digest::of(&large),
        ..(*suite::record(2)).clone()
    });
    assert_eq!(
        store.put(record, named(large)).await.unwrap_err(),
        StoreError::NoRoom
    );
    assert_eq!(
        store.put(suite::record(3), files(3)).await.unwrap_err(),
        StoreError::NoRoom
    );
    assert_eq!(
        server.say("DBSIZE"),
        ":3\r\n",
        "what was refused has left nothing"
    );
    assert_eq!(
        store
            .revise(a.revision, with_weights(&a, 1), None)
            .await
            .unwrap_err(),
        StoreError::NoRoom
    );
    for (store, seq) in [(&store, 4), (&other, 5)] {
        assert_eq!(store.touch(a.id, Some(seq)).await.unwrap().seq, Some(seq));
    }
    assert_eq!(
        store.touch(a.id, None).await.unwrap().seq,
        Some(5),
        "numbers are told also then"
    );
    assert_eq!(other.file(a.id, a.image).await.unwrap(), file(1));
    assert_eq!((store.ready().await, store.figures().failures), (Ok(()), 3));
    store.delete(a.id).await.unwrap();
    assert_eq!(server.say("CONFIG SET maxmemory 0"), "+OK\r\n");
    store.put(suite::record(3), files(3)).await.unwrap();
}

#[tokio::test]
async fn damaged_records_are_left_out_and_may_be_made_again() {
    let server = Redis::start(&[]);
    let (store, other) = (store_of(&server, bounds()), store_of(&server, bounds()));
    let (a, whole) = (suite::record(1), suite::record(2));
    for (record, picture) in [(&a, 1), (&whole, 2)] {
        store.put(Arc::clone(record), files(picture)).await.unwrap();
    }
    let key = script::key(a.id, "session");
    assert_eq!(server.say(&format!("HSET {key} record nothing")), ":0\r\n");
    for error in [
        other.peek(a.id).await.unwrap_err(),
        other.touch(a.id, None).await.unwrap_err(),
    ] {
        assert_eq!(error, StoreError::NoSuchSession);
    }
    assert_eq!(other.figures().damaged, 2);
    assert!(other.peek(whole.id).await.is_ok());
    assert!(matches!(
        other.put(Arc::clone(&a), files(1)).await,
        Ok(Put::Created(_))
    ));
    assert_eq!(other.touch(a.id, None).await.unwrap().record, a);
}

#[tokio::test]
async fn what_another_version_has_stored_is_kept() {
    let server = Redis::start(&[]);
    let mut there = redis::Client::open(server.address())
        .unwrap()
        .get_connection()
        .unwrap();
    let planted = Mutex::new(&mut there);
    suite::what_another_version_has_stored_is_kept(
        store_of(&server, bounds()),
        async |store, records: &[(SessionId, Vec<u8>)]| {
            for (id, bytes) in records {
                let revision = match record::read(bytes) {
                    Ok(record) => record.revision,
                    Err(_) => Revision::random(),
                };
                let mut command = redis::cmd("HSET");
                command
                    .arg(script::key(*id, "session"))
                    .arg("record")
                    .arg(bytes)
                    .arg("revision")
                    .arg(HEXLOWER.encode(revision.as_bytes()));
                command.exec(&mut **planted.lock().unwrap()).unwrap();
            }
            store
        },
    )
    .await;
}

#[tokio::test]
async fn a_password_is_asked_for_and_not_told() {
    let server = Redis::start(&["--requirepass", "s3cret"]);
    let with = |user: &str| server.address().replace("//", &format!("//{user}@"));
    let open = |address: &str| {
        let Ok(StoreUrl::Redis(address)) = address.parse() else {
            panic!("an address")
        };
        RedisStore::new(&address, bounds()).unwrap()
    };
    assert_eq!(open(&with(":s3cret")).ready().await, Ok(()));
    for wrong in [with(":other"), server.address()] {
        let store = open(&wrong);
        assert_eq!(store.ready().await, Err(StoreError::Away));
        assert!(!format!("{store:?}").contains("other"));
    }
}
