//! The power goes at some moment: of what was written since the disk last said that all is there,
//! some sectors are there and some are not.

use std::io;
use std::sync::{Arc, Mutex};

use proptest::prelude::Rng as _;
use redb::StorageBackend;

use super::*;
use crate::layer::LayerName;

/// What a disk loses or keeps as a whole.
const SECTOR: usize = 512;

#[derive(Clone, Debug)]
enum Step {
    Write(usize, Vec<u8>),
    Length(usize),
    Sync,
}

/// A disk that remembers everything that was ever done to it.
#[derive(Clone, Debug, Default)]
struct Recorded(Arc<Mutex<(Vec<u8>, Vec<Step>)>>);

impl Recorded {
    fn holding(bytes: Vec<u8>) -> Self {
        Self(Arc::new(Mutex::new((bytes, Vec::new()))))
    }

    fn steps(&self) -> usize {
        self.0.lock().unwrap().1.len()
    }

    /// What may be found when the power goes after this number of steps.
    fn after_power_cut(&self, steps: usize, random: &mut impl FnMut() -> bool) -> Vec<u8> {
        let all = &self.0.lock().unwrap().1[..steps];
        let kept = all
            .iter()
            .rposition(|step| matches!(step, Step::Sync))
            .unwrap_or(0);
        let mut bytes = Vec::new();
        for (at, step) in all.iter().enumerate() {
            match step {
                Step::Write(offset, data) => {
                    for (k, sector) in data.chunks(SECTOR).enumerate() {
                        let place = offset + k * SECTOR;
                        if at < kept || random() {
                            bytes.resize(bytes.len().max(place + sector.len()), 0);
                            bytes[place..place + sector.len()].copy_from_slice(sector);
                        }
                    }
                }
                Step::Length(len) if at < kept || random() => bytes.resize(*len, 0),
                Step::Length(_) | Step::Sync => {}
            }
        }
        bytes
    }
}

impl StorageBackend for Recorded {
    fn len(&self) -> io::Result<u64> {
        Ok(self.0.lock().unwrap().0.len() as u64)
    }

    fn read(&self, offset: u64, out: &mut [u8]) -> io::Result<()> {
        let offset = usize::try_from(offset).unwrap();
        let there = &self.0.lock().unwrap().0;
        out.copy_from_slice(
            there
                .get(offset..offset + out.len())
                .ok_or(io::ErrorKind::UnexpectedEof)?,
        );
        Ok(())
    }

    fn set_len(&self, len: u64) -> io::Result<()> {
        let (bytes, steps) = &mut *self.0.lock().unwrap();
        let len = usize::try_from(len).unwrap();
        bytes.resize(len, 0);
        steps.push(Step::Length(len));
        Ok(())
    }

    fn sync_data(&self) -> io::Result<()> {
        self.0.lock().unwrap().1.push(Step::Sync);
        Ok(())
    }

    fn write(&self, offset: u64, data: &[u8]) -> io::Result<()> {
        let (bytes, steps) = &mut *self.0.lock().unwrap();
        let offset = usize::try_from(offset).unwrap();
        bytes[offset..offset + data.len()].copy_from_slice(data);
        steps.push(Step::Write(offset, data.to_vec()));
        Ok(())
    }
}

/// The sessions that are there, each with its record.
type State = HashMap<SessionId, Arc<Record>>;

fn state(store: &FileStore) -> State {
    let index = store.0.index();
    index
        .records()
        .map(|record| (record.id, Arc::clone(record)))
        .collect()
}

#[tokio::test]
async fn what_was_answered_is_there_after_a_power_cut_at_any_moment() {
    let disk = Recorded::default();
    let store = FileStore::over(disk.clone(), bounds()).unwrap();
    // How many steps had been taken when a state was answered.
    let mut answered: Vec<(usize, State)> = vec![(disk.steps(), State::new())];
    let mut random = proptest::test_runner::TestRng::deterministic_rng(
        proptest::test_runner::RngAlgorithm::ChaCha,
    );
    let mut layers = 0;
    for k in 0..80_u8 {
        let mut now = answered.last().unwrap().1.clone();
        let some = now.values().nth(usize::from(k) % now.len().max(1)).cloned();
        match (random.next_u32() % 9, some) {
            (0, Some(record)) => {
                store.delete(record.id).await.unwrap();
                now.remove(&record.id);
            }
            (1, Some(record)) => {
                let new = with_weights(&record, usize::from(k) * 20);
                store
                    .revise(record.revision, Arc::clone(&new), None)
                    .await
                    .unwrap()
                    .unwrap();
                now.insert(new.id, new);
            }
            (4..=6, Some(record)) => {
                // Of the pictures' files too.
                let added = (!record.layers.contains_key(&LayerName::region()) || k % 3 > 0)
                    .then_some(k % 25);
                let new = with_layer(&record, LayerName::REGION, added);
                let layer = added.and_then(|added| files(added).pop());
                store
                    .revise(record.revision, Arc::clone(&new), layer)
                    .await
                    .unwrap()
                    .unwrap();
                now.insert(new.id, new);
                layers += 1;
            }
            (2, Some(record)) => {
                let new = made_again(&record, k);
                store.put(Arc::clone(&new), files(k)).await.unwrap();
                now.insert(new.id, new);
            }
            (3, Some(record)) => {
                store.touch(record.id, Some(u64::from(k))).await.unwrap();
                store.sweep().await.unwrap();
            }
            _ => {
                let new = suite::record(k % 20);
                store.put(Arc::clone(&new), files(k % 20)).await.unwrap();
                now.insert(new.id, new);
            }
        }
        answered.push((disk.steps(), now));
    }
    let (first, last) = (answered[0].0, disk.steps());
    let (mut cuts, mut in_between) = (0, 0);
    for steps in (first..=last).step_by((last - first) / 300 + 1) {
        let mut coin = || random.next_u32().is_multiple_of(2);
        let found = Recorded::holding(disk.after_power_cut(steps, &mut coin));
        let store =
            FileStore::over(found, bounds()).unwrap_or_else(|e| panic!("step {steps}: {e}"));
        let before = answered.iter().rposition(|(at, _)| *at <= steps).unwrap();
        let there = state(&store);
        let next = answered.get(before + 1);
        assert!(
            there == answered[before].1 || next.is_some_and(|next| there == next.1),
            "step {steps}: {there:?} {:?}",
            answered[before].1
        );
        in_between += usize::from(there != answered[before].1);
        assert_eq!(store.figures().damaged, 0, "step {steps}");
        for record in there.values() {
            for digest in record.files() {
                assert_eq!(
                    Digest::of(&store.file(record.id, digest).await.unwrap()),
                    digest,
                    "step {steps}"
                );
            }
        }
        // It is not only readable.
        store.put(suite::record(200), files(200)).await.unwrap();
        cuts += 1;
    }
    println!(
        "{cuts} power cuts in {} changes: nothing lost; {in_between} found a change that was not \
            answered yet",
        answered.len() - 1
    );
    assert!(cuts > 100 && layers > 10, "{cuts} {layers}");
}
