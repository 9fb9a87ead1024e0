use data_encoding::HEXLOWER;

use super::*;
use crate::store::StoreUrl;
use crate::store::tests::suite::{bounds, file, files, made_anew, named, with_layer, with_weights};
use crate::store::tests::{model, suite};

#[path = "../../../../tests/it/support/redis.rs"]
mod server;
use server::Redis;

fn store_of(server: &Redis, bounds: StoreLimits) -> RedisStore {
    let Ok(StoreUrl::Redis(address)) = server.address().parse() else {
        panic!("an address")
    };
    RedisStore::new(&address, bounds).unwrap()
}

/// Longer than a server is left alone.
const LATER: Duration = Duration::from_millis(1100);

/// Asks until the server is heard again.
async fn once_it_is_back<T>(
    mut ask: impl AsyncFnMut() -> Result<T, StoreError>,
) -> Result<T, StoreError> {
    for _ in 0..100 {
        match ask().await {
            Err(StoreError::Away) => tokio::time::sleep(Duration::from_millis(100)).await,
            answer => return answer,
        }
    }
    panic!("the server is never asked again");
}

#[tokio::test]
async fn keeps_the_rules_of_every_store() {
    let server = Redis::start(&[]);
    suite::all(async |wanted| store_of(&server, wanted)).await;
}

#[tokio::test]
async fn several_processes_do_what_the_model_does() {
    let server = Redis::start(&[]);
    for seed in 0..3 {
        let open = async |_| {
            vec![
                store_of(&server, model::bounds()),
                store_of(&server, model::bounds()),
            ]
        };
        model::follows(open, seed, 400, false, false).await;
    }
}

#[tokio::test(flavor = "multi_thread", worker_threads = 4)]
async fn neighbours_do_not_disturb_each_other() {
    let server = Redis::start(&[]);
    let stores = (0..2)
        .map(|_| Arc::new(store_of(&server, bounds())))
        .collect();
    model::neighbours_do_not_disturb_each_other(stores, Duration::from_secs(2)).await;
}

/// A way to the server on which every answer takes so long.
async fn slow_way(server: &Redis, delay: Duration) -> RedisStore {
    use tokio::io::{AsyncReadExt as _, AsyncWriteExt as _};
    let listener = tokio::net::TcpListener::bind("127.0.0.1:0").await.unwrap();
    let address = format!("redis://{}", listener.local_addr().unwrap());
    let there = server.address().replace("redis://", "");
    tokio::spawn(async move {
        while let Ok((near, _)) = listener.accept().await {
            let (mut near, mut far) = (
                near.into_split(),
                tokio::net::TcpStream::connect(&there)
                    .await
                    .unwrap()
                    .into_split(),
            );
            tokio::spawn(async move { tokio::io::copy(&mut near.0, &mut far.1).await });
            tokio::spawn(async move {
                let mut bytes = vec![0; 1 << 16];
                while let Ok(n @ 1..) = far.0.read(&mut bytes).await {
                    tokio::time::sleep(delay).await;
                    near.1.write_all(&bytes[..n]).await?;
                }
                std::io::Result::Ok(())
            });
        }
    });
    let Ok(StoreUrl::Redis(address)) = address.parse() else {
        panic!("an address")
    };
    RedisStore::new(&address, bounds()).unwrap()
}

#[tokio::test]
async fn a_server_that_is_slow_is_heard_all_the_same() {
    let server = Redis::start(&[]);
    let (slow, other) = (
        slow_way(&server, 2 * CACHED_TIMEOUT).await,
        store_of(&server, bounds()),
    );
    let a = suite::record(1);
    slow.put(Arc::clone(&a), files(1)).await.unwrap();
    let b = with_weights(&a, 2);
    other
        .revise(a.revision, Arc::clone(&b), None)
        .await
        .unwrap()
        .unwrap();
    // Whoever revises begins with what is there.
    let mut rounds = 0;
    let c = loop {
        let there = slow.touch(a.id, None).await.unwrap().record;
        let new = with_weights(&there, 3);
        if slow
            .revise(there.revision, Arc::clone(&new), None)
            .await
            .unwrap()
            .is_some()
        {
            break new;
        }
        rounds += 1;
        assert!(rounds < 5, "what others did is never seen");
    };
    assert_eq!(other.touch(a.id, None).await.unwrap().record, c);
    // Nor does a client that drags go on with what has been replaced.
    let d = made_anew(&a, 2);
    other.put(Arc::clone(&d), files(2)).await.unwrap();
    let began = Instant::now();
    while slow.touch(a.id, None).await.unwrap().record != d {
        assert!(
            began.elapsed() < 10 * READY_TIMEOUT,
            "what others did is never seen"
        );
        tokio::time::sleep(CACHED_TIMEOUT).await;
    }
    other.delete(a.id).await.unwrap();
    while slow.touch(a.id, None).await.is_ok() {
        assert!(
            began.elapsed() < 20 * READY_TIMEOUT,
            "what others did is never seen"
        );
        tokio::time::sleep(CACHED_TIMEOUT).await;
    }
}

#[tokio::test]
async fn numbers_do_not_fall_when_the_server_was_away_for_a_moment() {
    let server = Redis::start(&[]);
    let (store, other) = (
        slow_way(&server, CACHED_TIMEOUT / 2).await,
        store_of(&server, bounds()),
    );
    let a = suite::record(1);
    store.put(Arc::clone(&a), files(1)).await.unwrap();
    // The script is on the server: sending it takes longer than the wait for an answer.
    other.touch(a.id, None).await.unwrap();
    let cached = store.0.sessions.get(a.id).unwrap();
    // Given here alone, while an answer with a lower one was on its way.
    let asking = store.clone();
    let id = a.id;
    let asked = tokio::spawn(async move { asking.touch(id, Some(5)).await });
    tokio::time::sleep(CACHED_TIMEOUT / 4).await;
    cached.progress().seq = Some(9);
    asked.await.unwrap().unwrap();
    assert_eq!(store.touch(a.id, Some(6)).await.unwrap().seq, Some(9));
    assert_eq!(other.touch(a.id, None).await.unwrap().seq, Some(9));
    cached.progress().seq = Some(12);
    let again = Arc::new(Record {
        revision: Revision::random(),
        ..(*a).clone()
    });
    assert!(matches!(store.put(again, files(1)).await, Ok(Put::Same(_))));
    assert_eq!(store.touch(a.id, None).await.unwrap().seq, Some(12));
}

#[tokio::test]
async fn numbers_that_were_given_without_the_server_are_known_to_it_with_the_next_pose() {
    let server = Redis::start(&[]);
    let (store, other) = (store_of(&server, bounds()), store_of(&server, bounds()));
    let a = suite::record(1);
    store.put(Arc::clone(&a), files(1)).await.unwrap();
    store.touch(a.id, Some(1)).await.unwrap();
    server.signal("-STOP");
    // The first one is asked all the same, and heard later; those that come then are not asked.
    for seq in [2, 3, 4] {
        assert_eq!(store.touch(a.id, Some(seq)).await.unwrap().seq, Some(seq));
    }
    server.signal("-CONT");
    assert_eq!(
        store.peek(a.id).await.unwrap().seq,
        Some(4),
        "this process answers what it knows"
    );
    let told = async {
        while other.peek(a.id).await.unwrap().seq != Some(4) {
            assert_eq!(store.touch(a.id, Some(3)).await.unwrap().seq, Some(4));
            tokio::time::sleep(CACHED_TIMEOUT / 4).await
        }
    };
    tokio::time::timeout(20 * READY_TIMEOUT, told)
        .await
        .expect("the next pose tells the numbers before it");
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

    let c = made_anew(&a, 2);
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
async fn a_warm_session_goes_on_while_the_server_is_away_and_its_numbers_are_told_later() {
    let mut server = Redis::start(&["--appendonly", "yes", "--appendfsync", "always"]);
    let (store, cold) = (store_of(&server, bounds()), store_of(&server, bounds()));
    let a = suite::record(1);
    store.put(Arc::clone(&a), files(1)).await.unwrap();
    assert_eq!(cold.ready().await, Ok(()));
    server.kill();
    for seq in [5, 3, 8] {
        store.touch(a.id, Some(seq)).await.unwrap();
    }
    assert_eq!(store.touch(a.id, None).await.unwrap().seq, Some(8));
    assert_eq!(store.peek(a.id).await.unwrap().seq, Some(8));
    assert_eq!(cold.touch(a.id, None).await.unwrap_err(), StoreError::Away);
    assert_eq!(
        store.put(suite::record(2), files(2)).await.unwrap_err(),
        StoreError::Away
    );
    assert_eq!(
        store
            .revise(a.revision, with_weights(&a, 1), None)
            .await
            .unwrap_err(),
        StoreError::Away
    );
    assert_eq!(store.delete(a.id).await.unwrap_err(), StoreError::Away);
    assert_eq!(
        store.file(a.id, a.image).await.unwrap_err(),
        StoreError::Away
    );
    assert_eq!(store.ready().await, Err(StoreError::Away));
    assert!(store.figures().failures > 0);

    server.start_again();
    once_it_is_back(async || cold.peek(a.id).await)
        .await
        .unwrap();
    once_it_is_back(async || store.ready().await).await.unwrap();
    assert_eq!(store.touch(a.id, Some(6)).await.unwrap().seq, Some(8));
    assert_eq!(
        cold.touch(a.id, None).await.unwrap().seq,
        Some(8),
        "the others know it too"
    );
}

#[tokio::test]
async fn a_warm_session_does_not_outlive_its_idle_time_without_the_server() {
    let mut server = Redis::start(&[]);
    let store = store_of(
        &server,
        StoreLimits {
            idle: Duration::from_secs(1),
            ..bounds()
        },
    );
    let a = suite::record(1);
    store.put(Arc::clone(&a), files(1)).await.unwrap();
    server.kill();
    store.touch(a.id, None).await.unwrap();
    tokio::time::sleep(LATER).await;
    assert_eq!(store.touch(a.id, None).await.unwrap_err(), StoreError::Away);
}

#[tokio::test]
async fn a_server_that_comes_back_empty_has_lost_the_sessions_and_takes_new_ones() {
    let mut server = Redis::start(&[]);
    let store = store_of(&server, bounds());
    let a = suite::record(1);
    store.put(Arc::clone(&a), files(1)).await.unwrap();
    server.kill();
    store.touch(a.id, None).await.unwrap();
    server.start_again();
    once_it_is_back(async || store.ready().await).await.unwrap();
    assert_eq!(
        store.touch(a.id, None).await.unwrap_err(),
        StoreError::NoSuchSession
    );
    assert!(matches!(
        once_it_is_back(async || store.put(Arc::clone(&a), files(1)).await).await,
        Ok(Put::Created(_))
    ));
}

#[tokio::test]
async fn a_server_that_says_nothing_is_waited_for_once_and_not_long() {
    let server = Redis::start(&[]);
    let (store, cold) = (store_of(&server, bounds()), store_of(&server, bounds()));
    let a = suite::record(1);
    store.put(Arc::clone(&a), files(1)).await.unwrap();
    assert_eq!(cold.ready().await, Ok(()));
    server.signal("-STOP");
    let began = Instant::now();
    for _ in 0..20 {
        store.touch(a.id, None).await.unwrap();
    }
    assert!(
        began.elapsed() < 10 * CACHED_TIMEOUT,
        "{:?}",
        began.elapsed()
    );
    let began = Instant::now();
    assert_eq!(cold.touch(a.id, None).await.unwrap_err(), StoreError::Away);
    assert_eq!(store.ready().await, Err(StoreError::Away));
    assert!(
        began.elapsed() < 10 * ANSWER_TIMEOUT,
        "{:?}",
        began.elapsed()
    );
    server.signal("-CONT");
    once_it_is_back(async || cold.touch(a.id, None).await)
        .await
        .unwrap();
    once_it_is_back(async || store.ready().await).await.unwrap();
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
async fn damaged_records_are_left_out_and_may_be_made_anew() {
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

/// Between the look at what is there and the transfer of a file another process may have put a
/// session that this one cannot read.
#[tokio::test]
async fn a_file_that_comes_too_late_changes_nothing() {
    let server = Redis::start(&[]);
    let store = store_of(&server, bounds());
    let a = suite::record(1);
    store.put(Arc::clone(&a), files(1)).await.unwrap();
    let late = made_anew(&a, 2);
    let mut there = redis::Client::open(server.address())
        .unwrap()
        .get_connection()
        .unwrap();
    for revision in ["", "0123456789abcdef0123456789abcdef"] {
        let replaces = Replaces {
            revision: revision.to_owned(),
            is_readable: true,
        };
        let ((status, _),): ((i64, String),) =
            script::put(&late, &files(2), &replaces, store.0.idle)
                .query(&mut there)
                .unwrap();
        assert_eq!(status, status::OTHER);
        assert_eq!(store.peek(a.id).await.unwrap().record, a);
        assert_eq!(store.file(a.id, a.image).await.unwrap(), file(1));
    }
    assert_eq!(server.say("DBSIZE"), ":3\r\n", "nothing of it is left");
}

/// A layer whose session has ended, or has another revision, leaves no key and no field.
#[tokio::test]
async fn a_layer_that_comes_too_late_leaves_nothing() {
    let server = Redis::start(&[]);
    let (store, other) = (store_of(&server, bounds()), store_of(&server, bounds()));
    let (a, layer) = (suite::record(1), || named(file(2)).pop());
    let late = with_layer(&a, "x", Some(2));
    assert_eq!(
        store
            .revise(a.revision, Arc::clone(&late), layer())
            .await
            .unwrap_err(),
        StoreError::NoSuchSession
    );
    assert_eq!(server.say("DBSIZE"), ":0\r\n");
    store.put(Arc::clone(&a), files(1)).await.unwrap();
    let fields = server.say(&format!("HLEN {}", script::key(a.id, "session")));
    assert!(
        store
            .revise(Revision::random(), Arc::clone(&late), layer())
            .await
            .unwrap()
            .is_none()
    );
    assert_eq!(
        server.say(&format!("HLEN {}", script::key(a.id, "session"))),
        fields
    );
    // Another process sees the layer, and its expiry is the session's.
    store
        .revise(a.revision, Arc::clone(&late), layer())
        .await
        .unwrap()
        .unwrap();
    assert_eq!(other.touch(a.id, None).await.unwrap().record, late);
    assert_eq!(
        other.file(a.id, Digest::of(&file(2))).await.unwrap(),
        file(2)
    );
    assert_eq!(server.say("DBSIZE"), ":3\r\n");
    // A full server stores no layer, and removes one.
    assert_eq!(server.say("CONFIG SET maxmemory 100kb"), "+OK\r\n");
    let more = store
        .revise(
            late.revision,
            with_layer(&late, "y", Some(3)),
            named(file(3)).pop(),
        )
        .await;
    assert_eq!(more.unwrap_err(), StoreError::NoRoom);
    store
        .revise(late.revision, with_layer(&late, "x", None), None)
        .await
        .unwrap()
        .unwrap();
    assert_eq!(
        server.say(&format!("HLEN {}", script::key(a.id, "session"))),
        fields
    );
}

/// The picture, and the mask of the upload, keep no file of a layer that is the same file.
#[tokio::test]
async fn a_layers_file_goes_with_its_layer_also_if_it_is_the_pictures_or_the_first_mask() {
    let server = Redis::start(&[]);
    let store = store_of(&server, bounds());
    let [picture, mask] = [1, 2].map(|n| Digest::of(&file(n)));
    let made = with_layer(&suite::record(1), "region", Some(2));
    let a = Arc::new(Record {
        made_with_region: Some(mask),
        ..(*made).clone()
    });
    store
        .put(Arc::clone(&a), [files(1), files(2)].concat())
        .await
        .unwrap();
    let has = |digest: Digest| {
        server.say(&format!(
            "HEXISTS {} layer:{digest}",
            script::key(a.id, "session")
        ))
    };
    let b = with_layer(&a, "image", Some(1));
    store
        .revise(a.revision, Arc::clone(&b), named(file(1)).pop())
        .await
        .unwrap()
        .unwrap();
    assert_eq!([picture, mask].map(has), [":1\r\n", ":1\r\n"]);
    let c = with_layer(&with_layer(&b, "image", None), "region", Some(3));
    store
        .revise(b.revision, Arc::clone(&c), named(file(3)).pop())
        .await
        .unwrap()
        .unwrap();
    assert_eq!([picture, mask].map(has), [":0\r\n", ":0\r\n"]);
    assert_eq!(store.file(a.id, picture).await.unwrap(), file(1));
    assert_eq!(
        store.file(a.id, Digest::of(&file(3))).await.unwrap(),
        file(3)
    );
    assert_eq!(store.file(a.id, mask).await, Err(StoreError::NoSuchSession));
}

/// Several processes put different pictures under one name: each is told that it did, and one of
/// them is there.
#[tokio::test(flavor = "multi_thread", worker_threads = 4)]
async fn one_of_those_who_put_at_the_same_time_is_there() {
    let server = Redis::start(&[]);
    let base = suite::record(0);
    let puts = (0..6).map(|picture| {
        let (store, record) = (store_of(&server, bounds()), made_anew(&base, picture));
        tokio::spawn(async move {
            store
                .put(Arc::clone(&record), files(picture))
                .await
                .map(|_| record)
        })
    });
    let mut put = Vec::new();
    for done in futures_util::future::join_all(puts).await {
        put.push(done.unwrap().unwrap());
    }
    let store = store_of(&server, bounds());
    let there = store.peek(base.id).await.unwrap().record;
    assert!(put.contains(&there));
    assert_eq!(
        Digest::of(&store.file(there.id, there.image).await.unwrap()),
        there.image
    );
}

/// A way to the server that closes this number of connections in the middle of a file.
async fn way_that_breaks(server: &Redis, breaks: Arc<AtomicU64>) -> RedisStore {
    use tokio::io::{AsyncReadExt as _, AsyncWriteExt as _};
    let listener = tokio::net::TcpListener::bind("127.0.0.1:0").await.unwrap();
    let address = format!("redis://{}", listener.local_addr().unwrap());
    let there = server.address().replace("redis://", "");
    tokio::spawn(async move {
        while let Ok((near, _)) = listener.accept().await {
            let (far, breaks) = (
                tokio::net::TcpStream::connect(&there).await.unwrap(),
                Arc::clone(&breaks),
            );
            tokio::spawn(async move {
                let (mut near, mut far) = (near.into_split(), far.into_split());
                let asking =
                    tokio::spawn(async move { tokio::io::copy(&mut near.0, &mut far.1).await });
                let (mut bytes, mut all) = (vec![0; 1 << 16], 0);
                while let Ok(n @ 1..) = far.0.read(&mut bytes).await {
                    all += n;
                    let is_last = |left: u64| left.checked_sub(1);
                    if all > 1 << 20
                        && breaks
                            .fetch_update(Ordering::Relaxed, Ordering::Relaxed, is_last)
                            .is_ok()
                    {
                        break;
                    }
                    if near.1.write_all(&bytes[..n]).await.is_err() {
                        break;
                    }
                }
                asking.abort();
            });
        }
    });
    let Ok(StoreUrl::Redis(address)) = address.parse() else {
        panic!("an address")
    };
    RedisStore::new(&address, bounds()).unwrap()
}

/// A transfer that is given up, and a connection that is closed in the middle of a file.
#[tokio::test]
async fn a_transfer_that_breaks_is_not_in_the_way_of_the_next() {
    let server = Redis::start(&[]);
    let breaks = Arc::<AtomicU64>::default();
    let store = way_that_breaks(&server, Arc::clone(&breaks)).await;
    let large = Bytes::from(vec![9; 4 << 20]);
    let a = Arc::new(Record {
        image: Digest::of(&large),
        ..(*suite::record(0)).clone()
    });
    store
        .put(Arc::clone(&a), named(large.clone()))
        .await
        .unwrap();
    for _ in 0..20 {
        // Whoever waits for it leaves at some moment.
        let _ = tokio::time::timeout(Duration::from_millis(3), store.file(a.id, a.image)).await;
    }
    assert_eq!(store.file(a.id, a.image).await.unwrap(), large);
    for _ in 0..3 {
        breaks.store(1, Ordering::Relaxed);
        let (one, other) = tokio::join!(store.file(a.id, a.image), store.file(a.id, a.image));
        assert_eq!(
            (one.unwrap(), other.unwrap()),
            (large.clone(), large.clone())
        );
        assert_eq!(breaks.load(Ordering::Relaxed), 0, "a connection was closed");
    }
    assert_eq!(
        (store.figures().failures, store.figures().is_away),
        (0, false)
    );
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
