//! Servers that are slow, silent, away for a moment, or empty when they come back.

use super::*;

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
    // A revision begins with the record that is there.
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
    let d = made_again(&a, 2);
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
