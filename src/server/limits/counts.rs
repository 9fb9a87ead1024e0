//! A counter per key, with a value that exists while the count is above zero.

use std::collections::HashMap;
use std::hash::Hash;

#[derive(Debug)]
pub(super) struct Counts<K, V = ()> {
    pub(super) total: usize,
    pub(super) by_key: HashMap<K, (usize, V)>,
}

impl<K, V> Default for Counts<K, V> {
    fn default() -> Self {
        Self {
            total: 0,
            by_key: HashMap::new(),
        }
    }
}

impl<K: Eq + Hash, V: Default> Counts<K, V> {
    pub(super) fn get(&self, key: &K) -> usize {
        self.by_key.get(key).map_or(0, |(count, _)| *count)
    }

    pub(super) fn add(&mut self, key: K) -> &mut V {
        let (count, value) = self.by_key.entry(key).or_default();
        *count += 1;
        self.total += 1;
        value
    }

    pub(super) fn remove(&mut self, key: &K) {
        self.total -= 1;
        match self.by_key.get_mut(key) {
            Some((count @ 2.., _)) => *count -= 1,
            _ => drop(self.by_key.remove(key)),
        }
    }
}
