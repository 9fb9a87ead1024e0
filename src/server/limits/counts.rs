//! A counter per key, with a value that exists while the count is above zero.

use std::collections::HashMap;
use std::hash::Hash;

#[derive(Debug)]
pub(super) struct Counts<K, V = ()>(pub(super) HashMap<K, (usize, V)>);

impl<K, V> Default for Counts<K, V> {
    fn default() -> Self {
        Self(HashMap::new())
    }
}

impl<K: Eq + Hash, V: Default> Counts<K, V> {
    pub(super) fn get(&self, key: &K) -> usize {
        self.0.get(key).map_or(0, |(count, _)| *count)
    }

    pub(super) fn add(&mut self, key: K) -> &mut V {
        let (count, value) = self.0.entry(key).or_default();
        *count += 1;
        value
    }

    pub(super) fn remove(&mut self, key: &K) {
        match self.0.get_mut(key) {
            Some((count @ 2.., _)) => *count -= 1,
            _ => drop(self.0.remove(key)),
        }
    }
}
