//! Files on their way to and from the server, while other processes change the same session.

use super::*;

/// Between the look at what is there and the transfer of a file another process may have put a
/// session that this one cannot read.
#[tokio::test]
async fn a_file_that_comes_too_late_changes_nothing() {
    let server = Redis::start(&[]);
    let store = store_of(&server, bounds());
    let a = suite::record(1);
    store.put(Arc::clone(&a), files(1)).await.unwrap();
    let late = made_again(&a, 2);
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
        let (store, record) = (store_of(&server, bounds()), made_again(&base, picture));
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
        // The caller leaves at some moment.
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
