//! Random sequences of everything that may be asked of a store, against a model that is simple
//! enough to be right. Time is real: where a session's life ends during the question, either answer
//! is right, and the model believes it.

use std::collections::{HashMap, HashSet};
use std::sync::Arc;
use std::time::{Duration, Instant};

use mlswarp::warp::Digest;

use super::suite::{file, files, made_again, record, with_layer, with_weights};
use crate::session::{Revision, SessionId};
use crate::store::{Put, Record, Session, Store, StoreError, StoreLimits};

/// What clocks that count milliseconds may differ by.
const SLACK: Duration = Duration::from_millis(5);
const IDLE: Duration = Duration::from_millis(400);
/// As many as there are graves at most.
const NAMES: usize = 5;

pub(crate) const fn bounds() -> StoreLimits {
    StoreLimits {
        idle: IDLE,
        sessions: 5,
        bytes: 5500,
    }
}

/// Enough chance for a test (splitmix64).
struct Dice(u64);

impl Dice {
    fn below(&mut self, n: usize) -> usize {
        self.0 = self.0.wrapping_add(0x9e37_79b9_7f4a_7c15);
        let z = (self.0 ^ (self.0 >> 30)).wrapping_mul(0xbf58_476d_1ce4_e5b9);
        let z = (z ^ (z >> 27)).wrapping_mul(0x94d0_49bb_1331_11eb);
        usize::try_from((z ^ (z >> 31)) % n as u64).expect("below n")
    }

    fn picture(&mut self, n: usize) -> u8 {
        u8::try_from(self.below(n)).expect("few pictures")
    }
}

/// Some moment between these two.
#[derive(Clone, Copy, Debug)]
struct Moment(Instant, Instant);

#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Truth {
    Yes,
    No,
    Either,
}

#[derive(Clone, Debug)]
struct Live {
    record: Arc<Record>,
    seq: Option<u64>,
    used: Moment,
}

/// What is known of one name.
#[derive(Clone, Debug, Default)]
struct Known {
    /// Put and not ended; it may have expired.
    live: Option<Live>,
    /// When it was deleted.
    deleted: Option<Moment>,
    /// One that has expired.
    dead: Option<Live>,
    /// It has been swept since, or there was nothing to sweep.
    swept: bool,
    /// It was opened again since: who has expired may be forgotten.
    forgets: bool,
}

fn is_within(used: Moment, span: Duration, asked: Moment) -> Truth {
    if asked.1 < used.0 + span - SLACK {
        Truth::Yes
    } else if asked.0 > used.1 + span + SLACK {
        Truth::No
    } else {
        Truth::Either
    }
}

impl Known {
    fn lives(&self, asked: Moment) -> Truth {
        self.live
            .as_ref()
            .map_or(Truth::No, |live| is_within(live.used, IDLE, asked))
    }

    fn was_deleted(&self, asked: Moment) -> Truth {
        self.deleted
            .map_or(Truth::No, |deleted| is_within(deleted, IDLE, asked))
    }

    /// The answer says that there is no such session: that must be possible, and is believed.
    fn absent(&mut self, error: &StoreError, asked: Moment, what: &str) {
        assert_ne!(
            self.lives(asked),
            Truth::Yes,
            "{what}: lost: {error:?}; {self:?}"
        );
        if let Some(live) = self.live.take() {
            (self.dead, self.swept) = (Some(live), false);
        }
        let told = self
            .dead
            .as_ref()
            .map_or(Truth::No, |dead| is_within(dead.used, 2 * IDLE, asked));
        let right = match error {
            StoreError::Expired { .. } => told != Truth::No,
            StoreError::NoSuchSession => told != Truth::Yes || self.forgets,
            _ => false,
        };
        assert!(right, "{what}: {error:?}; {self:?}");
    }

    /// The answer says that it is there.
    fn present(&mut self, asked: Moment, what: &str) -> &mut Live {
        assert_ne!(self.lives(asked), Truth::No, "{what}: came back: {self:?}");
        self.live.as_mut().expect("it lives")
    }
}

impl Live {
    fn is(&self, session: &Session, what: &str) {
        assert_eq!(
            (&session.record, session.seq),
            (&self.record, self.seq),
            "{what}"
        );
    }

    fn bytes(&self) -> u64 {
        crate::store::index::record_bytes(&self.record)
    }
}

/// Runs a test for each of some random orders of steps, all at the same time: mostly they wait for
/// sessions to expire.
pub(crate) async fn with_each_seed(test: impl AsyncFn(u64)) {
    let test = &test;
    futures_util::future::join_all((0..3).map(async |seed| test(seed).await)).await;
}

/// Does `steps` random steps over stores that share their sessions. `open` opens all of them
/// (again), and `restarts_idle_time` says that their sessions live for another idle period after
/// that.
pub(crate) async fn follows<S: Store>(
    mut open: impl AsyncFnMut(Option<Vec<S>>) -> Vec<S>,
    seed: u64,
    steps: usize,
    is_bounded: bool,
    restarts_idle_time: bool,
) {
    let mut dice = Dice(seed);
    let mut stores = open(None).await;
    let ids: Vec<Arc<Record>> = (0..NAMES).map(|_| record(0)).collect();
    let mut all: Vec<Known> = vec![Known::default(); NAMES];
    let mut seen: HashMap<&str, usize> = HashMap::new();
    for step in 0..steps {
        let k = dice.below(NAMES);
        let id: SessionId = ids[k].id;
        let store = &stores[dice.below(stores.len())];
        let dice_op = dice.below(21);
        let began = Instant::now();
        let asked = || Moment(began, Instant::now());
        let what = format!("seed {seed}, step {step}, name {k}, {dice_op}");
        match dice_op {
            0..=4 => {
                let picture = dice.picture(4);
                let base = made_again(&ids[k], picture);
                let new = if dice.below(2) == 0 {
                    base
                } else {
                    with_weights(&base, 1 + dice.below(2) * 40)
                };
                let answer = store.put(Arc::clone(&new), files(picture)).await;
                let asked = asked();
                // What there would be, with those that may live and with those that do.
                let lives = |all: &[Known], least: bool| -> (usize, u64) {
                    let mut files: HashSet<Digest> = new.files().collect();
                    let (mut n, mut bytes) = (1, crate::store::index::record_bytes(&new));
                    for (j, known) in all.iter().enumerate() {
                        let truth = known.lives(asked);
                        let counts = truth == Truth::Yes || (!least && truth == Truth::Either);
                        if let Some(live) = known.live.as_ref().filter(|_| counts) {
                            if j != k {
                                (n, bytes) = (n + 1, bytes + live.bytes());
                            }
                            if j != k || !least {
                                files.extend(live.record.files());
                            }
                        }
                    }
                    (n, bytes + 1000 * files.len() as u64)
                };
                let b = bounds();
                match answer {
                    Err(StoreError::Full { .. }) => {
                        let (n, bytes) = lives(&all, false);
                        assert!(
                            is_bounded && (n > b.sessions || bytes > b.bytes),
                            "{what}: full at {n} sessions, {bytes} bytes"
                        );
                        *seen.entry("full").or_default() += 1;
                    }
                    Err(error) => panic!("{what}: {error:?}"),
                    Ok(Put::Same(session)) => {
                        let live = all[k].present(asked, &what);
                        assert!(live.record.is_made_like(&new), "{what}");
                        live.is(&session, &what);
                        live.used = asked;
                        *seen.entry("same").or_default() += 1;
                    }
                    Ok(put) => {
                        if is_bounded {
                            let (n, bytes) = lives(&all, true);
                            assert!(
                                n <= b.sessions && bytes <= b.bytes,
                                "{what}: {n} sessions, {bytes} bytes"
                            );
                        }
                        let truth = all[k].lives(asked);
                        let session = match put {
                            Put::Replaced(session, old) => {
                                let live = all[k].present(asked, &what);
                                assert_eq!(old, live.record, "{what}");
                                assert!(!live.record.is_made_like(&new), "{what}");
                                *seen.entry("replaced").or_default() += 1;
                                session
                            }
                            Put::Created(session) => {
                                assert_ne!(
                                    truth,
                                    Truth::Yes,
                                    "{what}: lost: created though it was there"
                                );
                                *seen.entry("created").or_default() += 1;
                                session
                            }
                            Put::Same(_) => unreachable!(),
                        };
                        let live = Live {
                            record: new,
                            seq: None,
                            used: asked,
                        };
                        live.is(&session, &what);
                        all[k] = Known {
                            live: Some(live),
                            ..Known::default()
                        };
                    }
                }
            }
            5 | 6 => {
                let right = dice.below(3) > 0;
                let base = all[k]
                    .live
                    .as_ref()
                    .map_or_else(|| Arc::clone(&ids[k]), |live| Arc::clone(&live.record));
                let mut new = with_weights(&base, 1 + dice.below(3));
                let mut layer = None;
                if dice.below(2) == 0 {
                    let (name, added) = (
                        ["a", "region"][dice.below(2)],
                        (dice.below(3) > 0).then(|| dice.picture(6)),
                    );
                    new = with_layer(&new, name, added);
                    layer = added.and_then(|added| files(added).pop());
                    *seen.entry("layers").or_default() += 1;
                }
                let old = if right {
                    base.revision
                } else {
                    Revision::random()
                };
                let answer = store.revise(old, Arc::clone(&new), layer).await;
                let asked = asked();
                match answer {
                    Ok(Some(session)) => {
                        assert!(right, "{what}");
                        let live = all[k].present(asked, &what);
                        live.record = new;
                        live.used = asked;
                        live.is(&session, &what);
                        *seen.entry("revised").or_default() += 1;
                    }
                    Ok(None) => {
                        assert!(!right, "{what}");
                        all[k].present(asked, &what);
                    }
                    Err(StoreError::Full { .. }) => assert!(is_bounded, "{what}"),
                    Err(error) => all[k].absent(&error, asked, &what),
                }
            }
            7..=9 => {
                let seq = Some(dice.below(50) as u64).filter(|seq| *seq > 5);
                let answer = store.touch(id, seq).await;
                let asked = asked();
                match answer {
                    Ok(session) => {
                        let live = all[k].present(asked, &what);
                        live.seq = live.seq.max(seq);
                        live.used = asked;
                        live.is(&session, &what);
                        *seen.entry("touched").or_default() += 1;
                    }
                    Err(error) => all[k].absent(&error, asked, &what),
                }
            }
            10 | 11 => {
                let answer = store.peek(id).await;
                let asked = asked();
                match answer {
                    Ok(session) => all[k].present(asked, &what).is(&session, &what),
                    Err(error) => all[k].absent(&error, asked, &what),
                }
            }
            12 => {
                let answer = store.delete(id).await;
                let asked = asked();
                match answer {
                    Ok(()) if all[k].lives(asked) == Truth::No => {
                        assert_ne!(
                            all[k].was_deleted(asked),
                            Truth::No,
                            "{what}: deleted what was not there: {:?}",
                            all[k]
                        );
                        *seen.entry("deleted again").or_default() += 1;
                    }
                    Ok(()) => {
                        all[k] = Known {
                            deleted: Some(asked),
                            ..Known::default()
                        };
                        *seen.entry("deleted").or_default() += 1;
                    }
                    Err(error) => {
                        let is_forgotten =
                            all[k].forgets || all[k].was_deleted(asked) != Truth::Yes;
                        assert!(is_forgotten, "{what}: {error:?}; {:?}", all[k]);
                        all[k].absent(&error, asked, &what);
                    }
                }
            }
            13 | 14 => {
                let Some(live) = all[k].live.clone() else {
                    continue;
                };
                let named: Vec<Digest> = live.record.files().collect();
                let digest = named[dice.below(named.len())];
                match store.file(id, digest).await {
                    Ok(bytes) => assert_eq!(Digest::of(&bytes), digest, "{what}"),
                    Err(error) => {
                        assert_eq!(error, StoreError::NoSuchSession, "{what}");
                        assert_ne!(
                            all[k].lives(asked()),
                            Truth::Yes,
                            "{what}: its picture is lost"
                        );
                    }
                }
            }
            15 => {
                store.sweep().await.unwrap();
                all.iter_mut().for_each(|known| known.swept = true);
                let asked = asked();
                let figures = store.figures();
                if is_bounded && all.iter().all(|known| known.lives(asked) != Truth::Either) {
                    let living: Vec<&Live> = all
                        .iter()
                        .filter(|known| known.lives(asked) == Truth::Yes)
                        .flat_map(|known| &known.live)
                        .collect();
                    let files: HashSet<Digest> =
                        living.iter().flat_map(|live| live.record.files()).collect();
                    let bytes = living.iter().map(|live| live.bytes()).sum::<u64>()
                        + 1000 * files.len() as u64;
                    assert_eq!(
                        (figures.sessions, figures.bytes),
                        (living.len() as u64, bytes),
                        "{what}"
                    );
                    *seen.entry("swept").or_default() += 1;
                }
            }
            16..=19 => {
                let most = if dice.below(6) == 0 { 12 } else { 3 };
                tokio::time::sleep(IDLE / 8 * u32::try_from(dice.below(most)).unwrap()).await;
            }
            _ => {
                let again = Instant::now();
                stores = open(Some(stores)).await;
                *seen.entry("opened").or_default() += 1;
                for (j, known) in all.iter_mut().enumerate() {
                    known.forgets |= restarts_idle_time;
                    let found = stores[0].peek(ids[j].id).await;
                    // After the answer: it may have ended while it was asked for.
                    let truth = known.lives(Moment(began, Instant::now()));
                    if restarts_idle_time && found.is_ok() && known.live.is_none() && !known.swept {
                        // Who had expired and was not swept has another life.
                        known.live = known.dead.take();
                        *seen.entry("risen").or_default() += 1;
                    }
                    match found {
                        Ok(session) => {
                            let live = known
                                .live
                                .as_mut()
                                .unwrap_or_else(|| panic!("{what}: came back"));
                            live.is(&session, &what);
                            if restarts_idle_time {
                                live.used = Moment(again, Instant::now());
                            }
                        }
                        Err(error) => {
                            assert_ne!(
                                truth,
                                Truth::Yes,
                                "{what}: lost after it was opened again: {error:?}"
                            );
                            known.absent(&error, Moment(again, Instant::now()), &what);
                        }
                    }
                }
            }
        }
    }
    println!("seed {seed}: {steps} steps, {seen:?}");
}

/// Each of some clients has sessions of its own, all of the same few pictures, and looks at
/// everybody's pictures: nobody loses anything by what the others do.
pub(crate) async fn neighbours_do_not_disturb_each_other<S: Store + 'static>(
    stores: Vec<Arc<S>>,
    span: Duration,
) {
    let mut clients = Vec::new();
    for client in 0..4 {
        let stores = stores.clone();
        clients.push(tokio::spawn(async move {
            let (mut dice, began, mut changes) = (Dice(client), Instant::now(), 0);
            let mut mine: Vec<(Arc<Record>, Option<u8>)> =
                (0..2).map(|_| (record(0), None)).collect();
            while began.elapsed() < span {
                let store = |dice: &mut Dice| &stores[dice.below(stores.len())];
                let (held, there) = &mut mine[dice.below(2)];
                match (dice.below(4), *there) {
                    (0, Some(_)) => {
                        store(&mut dice)
                            .delete(held.id)
                            .await
                            .expect("it was there");
                        *there = None;
                    }
                    (0..=1, _) => {
                        let picture = dice.picture(2);
                        let new = made_again(held, picture);
                        let (Put::Created(session)
                        | Put::Same(session)
                        | Put::Replaced(session, _)) =
                            store(&mut dice).put(new, files(picture)).await.unwrap();
                        (*held, *there) = (session.record, Some(picture));
                    }
                    (2, Some(picture)) => {
                        assert_eq!(
                            store(&mut dice)
                                .peek(held.id)
                                .await
                                .expect("it was answered")
                                .record,
                            *held
                        );
                        assert_eq!(
                            store(&mut dice).file(held.id, held.image).await,
                            Ok(file(picture))
                        );
                    }
                    _ => {
                        // Whether it is there is no matter.
                        let (id, digest) = (held.id, Digest::of(&file(dice.picture(2))));
                        let stores = stores.clone();
                        tokio::spawn(async move { stores[0].file(id, digest).await.map(drop) });
                    }
                }
                changes += 1;
            }
            for (held, there) in mine {
                assert_eq!(stores[0].peek(held.id).await.is_ok(), there.is_some());
            }
            changes
        }));
    }
    let mut all = 0;
    for client in clients {
        all += client.await.expect("a client lost something");
    }
    assert_eq!(
        stores
            .iter()
            .map(|store| store.figures().damaged)
            .sum::<u64>(),
        0
    );
    println!("{all} questions, nobody was disturbed");
}
