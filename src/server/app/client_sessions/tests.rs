use std::collections::BTreeMap;
use std::net::IpAddr;
use std::time::SystemTime;

use super::*;
use crate::client::Client;
use crate::layer::{LayerKind, LayerName};
use crate::session::Revision;
use crate::store::StoredLayer;
use mlswarp::pixmap::Extent;
use mlswarp::warp::{Folds, OutputSpec, RestSpec};

const FILE: u64 = 1000;

/// The picture's file of a record, with that many bytes.
fn file(record: &Record, len: u64) -> [NamedFile; 1] {
    [NamedFile {
        digest: record.image,
        bytes: vec![0; usize::try_from(len).unwrap()].into(),
    }]
}

fn tenant(n: u8) -> Tenant {
    Client {
        address: IpAddr::from([192, 0, 2, n]),
        ..Client::default()
    }
    .tenant()
}

/// The session of that number, on a picture of its own.
fn record(n: u8) -> Record {
    Record {
        id: SessionId::from_bytes(&[[0; 16], [n; 16]].concat().try_into().unwrap()),
        revision: Revision::random(),
        image: Digest([n; 32]),
        layers: BTreeMap::new(),
        made_with_region: None,
        extent: Extent::new(8, 8).unwrap(),
        rest: RestSpec::default().into(),
        pose: None,
        folds: Folds::default(),
        output: OutputSpec::default(),
        created: SystemTime::UNIX_EPOCH,
    }
}

fn client_sessions(idle: Duration, sessions: usize, bytes: u64) -> ClientSessions {
    ClientSessions::new(
        StoreLimits {
            idle,
            sessions,
            bytes,
        },
        |total| (total / 2).into(),
    )
}

fn sum(client_sessions: &ClientSessions, n: u8) -> (u64, u64) {
    client_sessions
        .lock()
        .totals
        .get(&tenant(n))
        .map_or((0, 0), |sum| (sum.sessions, sum.bytes))
}

/// The session was stored, and is gone.
fn end(client_sessions: &ClientSessions, id: SessionId) {
    let stored = |kept: &mut CountedSession| {
        kept.is_pending = false;
        kept.claim
    };
    let claim = client_sessions.lock().sessions.get_mut(&id).map(stored);
    client_sessions.ended(id, claim);
}

#[test]
fn a_client_keeps_its_part_and_another_client_keeps_as_much() {
    let held = client_sessions(Duration::from_secs(60), 4, 1 << 20);
    let records: Vec<_> = (1..6).map(record).collect();
    held.claim(tenant(1), &records[0], &file(&records[0], FILE))
        .unwrap();
    held.claim(tenant(1), &records[1], &file(&records[1], FILE))
        .unwrap();
    let refused = held
        .claim(tenant(1), &records[2], &file(&records[2], FILE))
        .unwrap_err();
    assert_eq!(
        (refused.code, refused.what, refused.retry_after),
        (
            Code::RateLimited,
            Some("client_sessions"),
            Some(RETRY_SECONDS)
        )
    );
    held.claim(tenant(2), &records[3], &file(&records[3], FILE))
        .unwrap();
    // The same name again is the same session, also with another picture.
    let other = Record {
        image: records[4].image,
        ..records[0].clone()
    };
    held.claim(tenant(1), &other, &file(&other, 2 * FILE))
        .unwrap();
    let each = record_bytes(&records[0]);
    assert_eq!(
        (sum(&held, 1), sum(&held, 2)),
        ((2, 3 * FILE + 2 * each), (1, FILE + each))
    );
    end(&held, records[1].id);
    held.claim(tenant(1), &records[2], &file(&records[2], FILE))
        .unwrap();
    // Of another address now: it counts there.
    held.claim(tenant(2), &records[2], &file(&records[2], FILE))
        .unwrap();
    assert_eq!((sum(&held, 1).0, sum(&held, 2).0), (1, 2));
    records.iter().for_each(|ended| end(&held, ended.id));
    assert!(held.lock().totals.is_empty() && held.lock().sessions.is_empty());
}

#[test]
fn bytes_are_counted_once_a_file_and_with_their_records() {
    let record = |n: u8| Record {
        image: Digest([9; 32]),
        ..record(n)
    };
    let each = record_bytes(&record(0));
    let held = client_sessions(Duration::from_secs(60), 1000, 2 * (FILE + 3 * each));
    for n in 0..3 {
        held.claim(tenant(1), &record(n), &file(&record(n), FILE))
            .unwrap();
    }
    let refused = held
        .claim(tenant(1), &record(3), &file(&record(3), FILE))
        .unwrap_err();
    assert_eq!(
        (refused.what, refused.limit, refused.actual),
        (
            Some("client_store_bytes"),
            Some((FILE + 3 * each).into()),
            Some((FILE + 4 * each).into())
        )
    );
    let mut larger = record(0);
    larger.rest = RestSpec {
        weights: Some(vec![1.0; 100]),
        ..RestSpec::default()
    }
    .into();
    assert_eq!(
        held.claim_revision(tenant(1), &larger, None)
            .unwrap_err()
            .what,
        Some("client_store_bytes")
    );
    assert_eq!(sum(&held, 1), (3, FILE + 3 * each));
    end(&held, record(1).id);
    end(&held, record(2).id);
    held.claim_revision(tenant(1), &larger, None).unwrap();
    assert_eq!(sum(&held, 1), (1, FILE + each + 800));
    // Made by another process: nobody here keeps it.
    held.claim_revision(tenant(1), &record(7), None).unwrap();
    assert_eq!(held.lock().sessions.len(), 1);
}

#[test]
fn a_visitor_stores_a_part_of_what_its_key_may() {
    let (owner, name) = (crate::client::Owner::from_bytes([1; 16]), [7; 16]);
    let (visitor, key) = (Tenant::Visitor(owner, name), Tenant::Key(owner));
    let one = record(1);
    let limit = 2 * FILE + record_bytes(&one);
    let held = client_sessions(Duration::from_secs(60), 100, 1 << 20).with_visitors(limit);
    let refused = held
        .claim(visitor, &one, &file(&one, 2 * FILE + 1))
        .unwrap_err();
    assert_eq!(
        (refused.what, refused.limit, refused.actual),
        (
            Some("visitor_store_bytes"),
            Some(limit.into()),
            Some((limit + 1).into())
        )
    );
    // The key itself may, and what a visitor stores counts for it.
    held.claim(key, &one, &file(&one, 2 * FILE + 1)).unwrap();
    held.claim(visitor, &one, &file(&one, FILE)).unwrap();
    let total = held.lock().totals[&key].bytes;
    assert_eq!(total, FILE + record_bytes(&one));
    assert!(held.claim_revision(visitor, &one, None).is_ok());
}

#[test]
fn layers_count_with_their_session() {
    let held = client_sessions(Duration::from_secs(60), 100, 1 << 20);
    let plain = record(1);
    held.claim(tenant(1), &plain, &file(&plain, FILE)).unwrap();
    let layer = |n: u8| NamedFile {
        digest: Digest([n; 32]),
        bytes: vec![0; 300].into(),
    };
    let with = |names: &[(&str, u8)]| {
        let stored = |n: u8| StoredLayer {
            kind: LayerKind::Image,
            digest: layer(n).digest,
        };
        let layers = names
            .iter()
            .map(|(name, n)| (LayerName::parse(name).unwrap(), stored(*n)))
            .collect();
        Record {
            layers,
            ..plain.clone()
        }
    };
    let bytes = |record: &Record, files: u64| (1, record_bytes(record) + FILE + files);
    let (one, two) = (with(&[("a", 2)]), with(&[("a", 2), ("b", 2)]));
    held.claim_revision(tenant(1), &one, Some(&layer(2)))
        .unwrap();
    assert_eq!(sum(&held, 1), bytes(&one, 300));
    held.claim_revision(tenant(1), &two, Some(&layer(2)))
        .unwrap();
    assert_eq!(sum(&held, 1), bytes(&two, 300), "one file of two names");
    // The session's `PUT` again: the layers stay.
    let again = held.claim(tenant(1), &plain, &file(&plain, FILE)).unwrap();
    held.confirm_same(&again);
    assert_eq!(sum(&held, 1), bytes(&two, 300));
    let other = with(&[("a", 3), ("b", 2)]);
    held.undo(
        held.claim_revision(tenant(1), &other, Some(&layer(3)))
            .unwrap(),
    );
    assert_eq!(sum(&held, 1), bytes(&two, 300));
    held.claim_revision(tenant(1), &other, Some(&layer(3)))
        .unwrap();
    assert_eq!(sum(&held, 1), bytes(&other, 600));
    held.claim_revision(tenant(1), &plain, None).unwrap();
    assert_eq!(sum(&held, 1), bytes(&plain, 0));
}

#[test]
fn a_session_that_is_being_stored_is_ended_by_nobody() {
    let held = client_sessions(Duration::from_secs(60), 100, 1 << 20);
    let record = record(1);
    let end = |claim| held.ended(record.id, claim);
    let first = held
        .claim(tenant(1), &record, &file(&record, FILE))
        .unwrap();
    end(held.claim_of(record.id));
    assert_eq!(sum(&held, 1).0, 1, "it is pending");
    held.confirm(&first);
    let before = held.claim_of(record.id);
    // A delete is under way, and the same name is stored again before it is counted.
    let second = held
        .claim(tenant(1), &record, &file(&record, FILE))
        .unwrap();
    held.confirm(&second);
    end(before);
    assert_eq!(sum(&held, 1).0, 1, "it was stored since");
    end(held.claim_of(record.id));
    assert_eq!(sum(&held, 1), (0, 0));
}

#[test]
fn what_was_not_stored_is_not_counted() {
    let held = client_sessions(Duration::from_secs(60), 100, 1 << 20);
    let (a, b) = (record(1), record(2));
    let other = Record {
        image: b.image,
        ..a.clone()
    };
    held.undo(held.claim(tenant(1), &a, &file(&a, FILE)).unwrap());
    assert_eq!(sum(&held, 1), (0, 0));
    held.claim(tenant(1), &a, &file(&a, FILE)).unwrap();
    let before = sum(&held, 1);
    held.undo(
        held.claim(tenant(1), &other, &file(&other, 2 * FILE))
            .unwrap(),
    );
    assert_eq!(sum(&held, 1), before);
    // The first of two fails when the second is there already.
    let first = held
        .claim(tenant(1), &other, &file(&other, 2 * FILE))
        .unwrap();
    held.claim(tenant(1), &a, &file(&a, 3 * FILE)).unwrap();
    held.undo(first);
    assert_eq!(sum(&held, 1), (1, 3 * FILE + record_bytes(&a)));
}

#[test]
fn an_expired_session_makes_room_and_a_used_one_does_not() {
    let idle = Duration::from_secs(60);
    let held = client_sessions(idle, 2, 1 << 20);
    let unused = |n: u8| held.lock().sessions.get_mut(&record(n).id).unwrap().used -= idle;
    held.claim(tenant(1), &record(1), &file(&record(1), FILE))
        .unwrap();
    unused(1);
    held.used(record(1).id);
    assert!(
        held.claim(tenant(1), &record(2), &file(&record(2), FILE))
            .is_err()
    );
    unused(1);
    held.claim(tenant(1), &record(3), &file(&record(3), FILE))
        .unwrap();
    assert_eq!(sum(&held, 1).0, 1);
    unused(3);
    held.sweep();
    assert!(held.lock().totals.is_empty());
}
