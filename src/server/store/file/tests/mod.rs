use std::path::PathBuf;

use super::*;
use crate::store::tests::suite::{
    bounds, file, files, made_again, named, with_layer, with_weights,
};
use crate::store::tests::{model, suite};

mod power;

/// A place for a file that goes with the test.
struct Place(PathBuf);

impl Place {
    fn new() -> Self {
        Self(std::env::temp_dir().join(format!("mlswarp-{}.db", uuid::Uuid::new_v4())))
    }

    fn open(&self) -> FileStore {
        FileStore::open(&self.0, bounds()).unwrap()
    }

    /// Bytes of the file.
    fn size(&self) -> u64 {
        std::fs::metadata(&self.0).unwrap().len()
    }
}

impl Drop for Place {
    fn drop(&mut self) {
        let _ = std::fs::remove_file(&self.0);
    }
}

#[tokio::test]
async fn keeps_the_rules_of_every_store() {
    let places = Mutex::new(Vec::new());
    suite::bounded(async |wanted| {
        let place = Place::new();
        let store = FileStore::open(&place.0, wanted).unwrap();
        places.lock().unwrap().push(place);
        store
    })
    .await;
}

#[tokio::test]
async fn does_what_the_model_does_also_when_it_is_opened_again() {
    model::with_each_seed(async |seed| {
        let place = Place::new();
        let open = async |old| {
            drop::<Option<Vec<FileStore>>>(old);
            vec![FileStore::open(&place.0, model::bounds()).unwrap()]
        };
        model::follows(open, seed, 400, true, true).await;
    })
    .await;
}

#[tokio::test(flavor = "multi_thread", worker_threads = 4)]
async fn neighbours_do_not_disturb_each_other() {
    let place = Place::new();
    model::neighbours_do_not_disturb_each_other(
        vec![Arc::new(place.open())],
        Duration::from_secs(2),
    )
    .await;
}

#[tokio::test]
async fn sessions_are_there_after_the_store_was_opened_again() {
    let place = Place::new();
    let (a, b, c) = (suite::record(1), suite::record(1), suite::record(2));
    let store = place.open();
    for (record, picture) in [(&a, 1), (&b, 1), (&c, 2)] {
        store.put(Arc::clone(record), files(picture)).await.unwrap();
    }
    store.touch(a.id, Some(41)).await.unwrap();
    store.sweep().await.unwrap();
    // Not swept: told when the store is closed.
    store.touch(a.id, Some(43)).await.unwrap();
    let revised = with_weights(&b, 3);
    store
        .revise(b.revision, Arc::clone(&revised), None)
        .await
        .unwrap()
        .unwrap();
    store.delete(c.id).await.unwrap();
    let layered = with_layer(&revised, "x", Some(4));
    store
        .revise(revised.revision, Arc::clone(&layered), named(file(4)).pop())
        .await
        .unwrap()
        .unwrap();
    let figures = store.figures();
    drop(store);

    let store = place.open();
    assert_eq!(store.figures(), figures);
    assert_eq!(
        store.file(b.id, Digest::of(&file(4))).await.unwrap(),
        file(4)
    );
    let back = store.peek(a.id).await.unwrap();
    assert_eq!((back.record, back.seq), (a.clone(), Some(43)));
    assert_eq!(store.peek(b.id).await.unwrap().record, layered);
    store
        .revise(layered.revision, with_layer(&layered, "x", None), None)
        .await
        .unwrap()
        .unwrap();
    assert_eq!(
        store.peek(c.id).await.unwrap_err(),
        StoreError::NoSuchSession
    );
    assert_eq!(store.file(a.id, a.image).await.unwrap(), file(1));
    assert!(
        store.0.disk.change(|change| change.files()).unwrap() == [a.image],
        "the deleted picture's file has gone"
    );
    // A session that is made again has numbers from the beginning, also on the disk.
    store.put(made_again(&a, 3), files(3)).await.unwrap();
    drop(store);
    assert_eq!(place.open().peek(a.id).await.unwrap().seq, None);
}

#[tokio::test]
async fn a_file_of_many_pieces_comes_back_whole() {
    let place = Place::new();
    let store = place.open();
    for len in [
        1,
        disk::PIECE_BYTES - 1,
        disk::PIECE_BYTES,
        disk::PIECE_BYTES + 1,
        3 * disk::PIECE_BYTES + 7,
    ] {
        let bytes: Bytes = (0..len)
            .map(|k| u8::try_from(k * k % 251).unwrap())
            .collect();
        let record = Arc::new(Record {
            image: Digest::of(&bytes),
            ..(*suite::record(0)).clone()
        });
        store
            .put(Arc::clone(&record), named(bytes.clone()))
            .await
            .unwrap();
        assert!(
            store.file(record.id, record.image).await.unwrap() == bytes,
            "{len} bytes"
        );
    }
}

#[tokio::test]
async fn a_second_process_is_told_that_the_file_is_taken() {
    let place = Place::new();
    let _first = place.open();
    let refused = FileStore::open(&place.0, bounds()).unwrap_err();
    assert!(refused.to_string().contains("another process"), "{refused}");
}

#[test]
fn what_is_no_session_file_is_left_as_it_is() {
    let other = redb::TableDefinition::<u8, u8>::new("theirs");
    for what in [
        Some(&b"a diary"[..]),
        Some(b""),
        Some(b"redb, they said"),
        Some(&[0; 9000]),
        None,
    ] {
        let place = Place::new();
        match what {
            Some(bytes) => std::fs::write(&place.0, bytes).unwrap(),
            None => {
                let database = redb::Database::create(&place.0).unwrap();
                let change = database.begin_write().unwrap();
                change.open_table(other).unwrap();
                change.commit().unwrap();
            }
        }
        let before = std::fs::read(&place.0).unwrap();
        let refused = FileStore::open(&place.0, bounds()).unwrap_err();
        assert!(
            refused.to_string().contains(&*place.0.to_string_lossy()),
            "{refused}"
        );
        assert!(
            what.is_none() || std::fs::read(&place.0).unwrap() == before,
            "{what:?}"
        );
    }
    assert!(FileStore::open(Path::new("/nowhere/at/all"), bounds()).is_err());
}

#[tokio::test]
async fn damaged_records_are_left_out_and_the_others_are_there() {
    let place = Place::new();
    let records: Vec<_> = (0..7).map(suite::record).collect();
    let store = place.open();
    for (picture, record) in (0..).zip(&records) {
        store.put(Arc::clone(record), files(picture)).await.unwrap();
    }
    let [whole, torn, flipped, another, no_file, bad_file, short_file] = &records[..] else {
        panic!("seven")
    };
    let mut bits = record::write(flipped);
    bits[200] ^= 4;
    let damage = store.0.disk.change(|change| {
        change
            .records
            .insert(&torn.id.to_bytes(), &record::write(torn)[..100])?;
        change
            .records
            .insert(&flipped.id.to_bytes(), bits.as_slice())?;
        change
            .records
            .insert(&another.id.to_bytes(), record::write(whole).as_slice())?;
        change.remove_file(no_file.image)?;
        for (record, bytes) in [(bad_file, &[1; 1000][..]), (short_file, &[7; 999])] {
            change.remove_file(record.image)?;
            change.add_file(record.image, bytes)?;
        }
        Ok(())
    });
    damage.unwrap();
    drop(store);

    let store = place.open();
    assert_eq!((store.figures().damaged, store.figures().sessions), (6, 1));
    assert_eq!(store.peek(whole.id).await.unwrap().record, *whole);
    assert_eq!(store.file(whole.id, whole.image).await.unwrap(), file(0));
    for lost in &records[1..] {
        assert_eq!(
            store.peek(lost.id).await.unwrap_err(),
            StoreError::NoSuchSession
        );
    }
    // Their names and pictures may be used again.
    for (picture, record) in (0..).zip(&records) {
        store.put(Arc::clone(record), files(picture)).await.unwrap();
    }
    drop(store);
    let store = place.open();
    assert_eq!((store.figures().damaged, store.figures().sessions), (0, 7));
    assert_eq!(
        store.file(bad_file.id, bad_file.image).await.unwrap(),
        file(5)
    );
}

fn plant(store: &FileStore, records: &[(SessionId, Vec<u8>)]) {
    let planted = store.0.disk.change(|change| {
        records.iter().try_for_each(|(id, bytes)| {
            Ok(change
                .records
                .insert(&id.to_bytes(), bytes.as_slice())
                .map(drop)?)
        })
    });
    planted.unwrap();
}

#[tokio::test]
async fn what_another_version_has_stored_is_kept() {
    let place = Place::new();
    suite::what_another_version_has_stored_is_kept(
        place.open(),
        async |store: FileStore, records: &[(SessionId, Vec<u8>)]| {
            plant(&store, records);
            drop(store);
            place.open()
        },
    )
    .await;
}

/// What is not read takes its place all the same: a store that did not count it would grow with
/// every rollback.
#[tokio::test]
async fn what_another_version_has_stored_counts() {
    let place = Place::new();
    let store = place.open();
    let (a, b) = (suite::record(1), suite::record(2));
    store.put(Arc::clone(&a), files(1)).await.unwrap();
    store.put(Arc::clone(&b), files(2)).await.unwrap();
    let bytes = record::sealed(format!("{{\"version\":2,\"picture\":\"{}\"}}", a.image).as_bytes());
    plant(&store, &[(a.id, bytes.clone())]);
    let one = store.figures().bytes / 2;
    drop(store);
    let store = FileStore::open(
        &place.0,
        StoreLimits {
            sessions: 2,
            ..bounds()
        },
    )
    .unwrap();
    let expected = StoreStats {
        sessions: 2,
        bytes: one + 1000 + bytes.len() as u64,
        other_version: 1,
        ..StoreStats::default()
    };
    assert_eq!(store.figures(), expected);
    assert!(matches!(
        store.put(suite::record(3), files(3)).await,
        Err(StoreError::Full {
            what: "sessions",
            ..
        })
    ));
    // Its file is not named by anybody who is read, and may be used by a newcomer.
    store.delete(b.id).await.unwrap();
    let c = suite::record(1);
    store.put(Arc::clone(&c), files(1)).await.unwrap();
    assert_eq!(
        store.figures(),
        StoreStats {
            bytes: expected.bytes - 1000,
            ..expected
        }
    );
    store.delete(a.id).await.unwrap();
    assert_eq!(store.file(c.id, c.image).await.unwrap(), file(1));
    store.delete(c.id).await.unwrap();
    assert_eq!((store.figures().sessions, store.figures().bytes), (0, 0));
    assert!(
        store
            .0
            .disk
            .change(|change| change.files())
            .unwrap()
            .is_empty()
    );
}

/// A picture that cannot be read any more is not kept from being sent again by a session that is
/// not read.
#[tokio::test]
async fn a_damaged_picture_of_another_versions_session_may_be_sent_again() {
    let place = Place::new();
    let store = place.open();
    let (a, b) = (suite::record(1), suite::record(1));
    store.put(Arc::clone(&a), files(1)).await.unwrap();
    store.put(Arc::clone(&b), files(1)).await.unwrap();
    plant(
        &store,
        &[(
            a.id,
            record::sealed(format!("{{\"version\":2,\"picture\":\"{}\"}}", a.image).as_bytes()),
        )],
    );
    drop(store);
    let store = place.open();
    store
        .0
        .disk
        .change(|change| {
            change
                .remove_file(a.image)
                .and_then(|()| change.add_file(a.image, b"other"))
        })
        .unwrap();
    assert_eq!(
        store.file(b.id, b.image).await,
        Err(StoreError::NoSuchSession)
    );
    store.put(Arc::clone(&b), files(1)).await.unwrap();
    assert_eq!(store.file(b.id, b.image).await.unwrap(), file(1));
    assert_eq!(
        store.peek(a.id).await.unwrap_err(),
        StoreError::OtherVersion
    );
}

#[tokio::test]
async fn a_picture_that_is_damaged_later_ends_its_sessions_and_may_be_sent_again() {
    let place = Place::new();
    let store = place.open();
    let (a, b) = (suite::record(1), suite::record(2));
    store.put(Arc::clone(&a), files(1)).await.unwrap();
    store.put(Arc::clone(&b), files(2)).await.unwrap();
    store
        .0
        .disk
        .change(|change| {
            change
                .remove_file(a.image)
                .and_then(|()| change.add_file(a.image, b"other"))
        })
        .unwrap();
    assert_eq!(
        store.file(a.id, a.image).await,
        Err(StoreError::NoSuchSession)
    );
    assert_eq!(
        (store.peek(a.id).await.unwrap_err(), store.figures().damaged),
        (StoreError::NoSuchSession, 1)
    );
    assert!(store.peek(b.id).await.is_ok());
    // So does a layer's.
    let layer = named(file(3)).pop().unwrap();
    store
        .revise(
            b.revision,
            with_layer(&b, "x", Some(3)),
            Some(layer.clone()),
        )
        .await
        .unwrap()
        .unwrap();
    store
        .0
        .disk
        .change(|change| change.remove_file(layer.digest))
        .unwrap();
    assert_eq!(
        store.file(b.id, layer.digest).await,
        Err(StoreError::NoSuchSession)
    );
    assert_eq!(
        store.peek(b.id).await.unwrap_err(),
        StoreError::NoSuchSession
    );
    store.put(Arc::clone(&a), files(1)).await.unwrap();
    assert_eq!(store.file(a.id, a.image).await.unwrap(), file(1));
}

/// What a reader found missing may be there again when it gets to say so.
#[tokio::test]
async fn a_picture_that_goes_and_is_sent_again_while_it_is_read_is_not_damaged() {
    let place = Place::new();
    let store = place.open();
    let (a, b) = (suite::record(1), suite::record(1));
    store.put(Arc::clone(&a), files(1)).await.unwrap();
    let writing = store.0.written();
    store
        .0
        .disk
        .change(|change| change.remove_file(a.image))
        .unwrap();
    let reading = store.file(a.id, a.image);
    // It has read nothing and waits for the right to change.
    std::thread::sleep(Duration::from_millis(300));
    store
        .0
        .disk
        .change(|change| change.add_file(b.image, &file(1)))
        .unwrap();
    drop(writing);
    assert_eq!(reading.await, Ok(file(1)));
    assert_eq!(
        (
            store.peek(a.id).await.unwrap().record,
            store.figures().damaged
        ),
        (a, 0)
    );
}

/// Wherever a byte of the file changes, the program starts with what is whole, or says that it
/// cannot.
#[tokio::test]
async fn a_flipped_byte_anywhere_is_survived() {
    let place = Place::new();
    let store = place.open();
    let records: Vec<_> = (0..6).map(suite::record).collect();
    for (picture, record) in (0..).zip(&records) {
        store.put(Arc::clone(record), files(picture)).await.unwrap();
    }
    drop(store);
    let sound = std::fs::read(&place.0).unwrap();
    // Most of a small file is empty: places in what is not.
    let full: Vec<usize> = (0..sound.len()).filter(|&k| sound[k] != 0).collect();
    let (mut whole, mut fewer, mut refused) = (0, 0, 0);
    for k in full.iter().step_by(full.len() / 150) {
        let mut bytes = sound.clone();
        bytes[*k] ^= 0x55;
        std::fs::write(&place.0, &bytes).unwrap();
        let Ok(store) = FileStore::open(&place.0, bounds()) else {
            refused += 1;
            continue;
        };
        let figures = store.figures();
        *(if figures.sessions == 6 {
            &mut whole
        } else {
            &mut fewer
        }) += 1;
        for (picture, record) in (0..).zip(&records) {
            if let Ok(there) = store.peek(record.id).await {
                assert_eq!(there.record, *record);
                assert!(
                    store
                        .file(record.id, record.image)
                        .await
                        .is_ok_and(|bytes| bytes == file(picture))
                );
            }
        }
    }
    println!(
        "a flipped byte: {whole} times all sessions were there, {fewer} times some, {refused} \
            times the file was refused"
    );
    assert!(fewer > 0);
}

#[tokio::test]
async fn space_is_given_back_when_the_file_is_opened() {
    let place = Place::new();
    let wide = StoreLimits {
        bytes: 1 << 30,
        ..bounds()
    };
    let store = FileStore::open(&place.0, wide).unwrap();
    let mut records = Vec::new();
    for k in 0..40_u8 {
        let bytes = Bytes::from(vec![k; 1 << 20]);
        let record = Arc::new(Record {
            image: Digest::of(&bytes),
            ..(*suite::record(0)).clone()
        });
        store.put(Arc::clone(&record), named(bytes)).await.unwrap();
        records.push(record);
    }
    let full = place.size();
    println!("40 MiB in files of 1 MiB: a file of {full} bytes");
    assert!(full < 2 * store.figures().bytes);
    for record in &records[1..] {
        store.delete(record.id).await.unwrap();
    }
    drop(store);
    let store = FileStore::open(&place.0, wide).unwrap();
    println!(
        "1 MiB of it left: {} bytes before the start, {} after",
        full,
        place.size()
    );
    // The database gives much of it back by itself; what is left then may not be worth the trouble.
    assert!(
        place.size() < 2 * store.figures().bytes + disk::COMPACTION_BYTES,
        "{}",
        place.size()
    );
    assert_eq!(
        store
            .file(records[0].id, records[0].image)
            .await
            .unwrap()
            .len(),
        1 << 20
    );
    store.put(suite::record(1), files(1)).await.unwrap();
}

/// The process that makes the file may be killed at any moment: what is there is whole or not
/// there.
#[test]
fn a_half_made_file_is_never_in_the_place() {
    let place = Place::new();
    drop(place.open());
    let beside = place.0.file_name().unwrap().to_string_lossy().into_owned();
    let directory = place.0.parent().unwrap();
    let left: Vec<_> = std::fs::read_dir(directory)
        .unwrap()
        .map(|entry| entry.unwrap().file_name())
        .collect();
    let left: Vec<_> = left
        .iter()
        .filter(|name| name.to_string_lossy().starts_with(&beside))
        .collect();
    assert_eq!(left.len(), 1, "{left:?}");
    #[cfg(unix)]
    {
        use std::os::unix::fs::PermissionsExt as _;
        assert_eq!(
            std::fs::metadata(&place.0).unwrap().permissions().mode() & 0o777,
            0o600
        );
    }
}
