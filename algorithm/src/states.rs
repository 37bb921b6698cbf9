//! The distinct states among the stored transitions, each kept once, counted, and whitened once.
//!
//! In a grid world a hundred thousand transitions visit a few hundred states; in a continuous one, s' of a transition
//! is s of the next. States are told apart by their bits. A state's number is free for another state once its last
//! user has left, so numbers mean nothing beyond that, and no result may depend on their order.

use crate::similarity::metric::Metric;
use std::cmp::Ordering;
use std::collections::HashMap;
use std::hash::{BuildHasherDefault, Hasher};
use trestle_proto::NONE;

/// Mixes words into a well-spread one (finaliser of MurmurHash3).
pub(crate) fn mix(seed: u64, word: u64) -> u64 {
    let mut z = (seed ^ word).wrapping_mul(0xff51_afd7_ed55_8ccd);
    z = (z ^ (z >> 33)).wrapping_mul(0xc4ce_b9fe_1a85_ec53);
    z ^ (z >> 33)
}

/// A map from words that are already well spread ([`mix`]). Only ever asked, never iterated.
pub(crate) type MixedMap<V> = HashMap<u64, V, BuildHasherDefault<Mixed>>;

/// Hashes a `u64` to itself.
#[derive(Clone, Copy, Debug, Default)]
pub(crate) struct Mixed(u64);

impl Hasher for Mixed {
    fn finish(&self) -> u64 {
        self.0
    }

    fn write_u64(&mut self, word: u64) {
        self.0 = word;
    }

    fn write(&mut self, bytes: &[u8]) {
        bytes.iter().for_each(|&b| self.0 = mix(self.0, u64::from(b)));
    }
}

/// The states. Memory for each: two copies of its features, and about 40 bytes.
#[derive(Clone, Debug)]
pub struct States {
    dim: usize,
    raw: Vec<f32>,
    whitened: Vec<f32>,
    uses: Vec<u32>,
    /// First state of each hash, and for each state the next one with the same hash.
    heads: MixedMap<u32>,
    next: Vec<u32>,
    free: Vec<u32>,
    scratch: Vec<f64>,
}

impl States {
    /// None yet, of `dim` features.
    pub fn new(dim: usize) -> Self {
        Self {
            dim,
            raw: Vec::new(),
            whitened: Vec::new(),
            uses: Vec::new(),
            heads: MixedMap::default(),
            next: Vec::new(),
            free: Vec::new(),
            scratch: Vec::new(),
        }
    }

    /// All numbers in use are below this.
    pub fn bound(&self) -> usize {
        self.uses.len()
    }

    /// Number of distinct states.
    pub fn len(&self) -> usize {
        self.bound() - self.free.len()
    }

    /// Whether there is none.
    pub fn is_empty(&self) -> bool {
        self.len() == 0
    }

    /// The features of state `id`.
    pub fn raw(&self, id: u32) -> &[f32] {
        &self.raw[id as usize * self.dim..][..self.dim]
    }

    /// State `id`, whitened.
    pub fn whitened(&self, id: u32) -> &[f32] {
        &self.whitened[id as usize * self.dim..][..self.dim]
    }

    /// Which of two states is the smaller one, feature by feature.
    pub fn order(&self, a: u32, b: u32) -> Ordering {
        let pairs = self.raw(a).iter().zip(self.raw(b));
        pairs.map(|(a, b)| a.total_cmp(b)).find(|order| order.is_ne()).unwrap_or(Ordering::Equal)
    }

    /// The number of `state`, with one more user, and whether it was not there before.
    pub fn acquire(&mut self, state: &[f32], metric: &Metric) -> (u32, bool) {
        let hash = hash(state);
        let head = self.heads.get(&hash).copied().unwrap_or(NONE);
        let mut at = head;
        while at != NONE {
            if same(self.raw(at), state) {
                self.uses[at as usize] += 1;
                return (at, false);
            }
            at = self.next[at as usize];
        }
        let id = self.place(state, metric);
        self.next[id as usize] = head;
        self.heads.insert(hash, id);
        (id, true)
    }

    /// Writes `state` to a free number.
    fn place(&mut self, state: &[f32], metric: &Metric) -> u32 {
        let Some(id) = self.free.pop() else {
            let id = self.uses.len() as u32;
            self.raw.extend_from_slice(state);
            metric.whiten(state, &mut self.scratch, &mut self.whitened);
            self.uses.push(1);
            self.next.push(NONE);
            return id;
        };
        let (at, end) = (id as usize * self.dim, self.whitened.len());
        self.raw[at..at + self.dim].copy_from_slice(state);
        metric.whiten(state, &mut self.scratch, &mut self.whitened);
        self.whitened.copy_within(end.., at);
        self.whitened.truncate(end);
        self.uses[id as usize] = 1;
        id
    }

    /// Takes one user from state `id`. Whether it was the last: the state is then forgotten, though its features can
    /// be read until the next [`States::acquire`].
    pub fn release(&mut self, id: u32) -> bool {
        self.uses[id as usize] -= 1;
        if self.uses[id as usize] > 0 {
            return false;
        }
        let hash = hash(self.raw(id));
        let follower = self.next[id as usize];
        let mut at = self.heads.get(&hash).copied().unwrap_or(NONE);
        if at == id {
            if follower == NONE {
                self.heads.remove(&hash);
            } else {
                self.heads.insert(hash, follower);
            }
        }
        while at != NONE && at != id {
            let next = self.next[at as usize];
            if next == id {
                self.next[at as usize] = follower;
            }
            at = next;
        }
        self.free.push(id);
        true
    }
}

fn hash(state: &[f32]) -> u64 {
    state.iter().fold(0, |seed, x| mix(seed, u64::from(x.to_bits()) + 1))
}

fn same(a: &[f32], b: &[f32]) -> bool {
    a.iter().zip(b).all(|(x, y)| x.to_bits() == y.to_bits())
}

#[cfg(test)]
mod tests {
    #![allow(clippy::unwrap_used)]
    use super::*;
    use proptest::prelude::*;
    use std::collections::BTreeMap;

    proptest! {
        #[test]
        fn counts_like_a_multiset(steps in proptest::collection::vec((0u8..6, any::<bool>()), 1..200)) {
            let metric = Metric::diagonal(&[2.0]).unwrap();
            let mut states = States::new(1);
            let mut expected: BTreeMap<u8, (u32, u32)> = BTreeMap::new();
            for (x, add) in steps {
                let known = expected.get(&x).copied();
                if add {
                    let (id, new) = states.acquire(&[f32::from(x)], &metric);
                    prop_assert_eq!(new, known.is_none());
                    prop_assert_eq!(known.map_or(id, |k| k.0), id);
                    prop_assert_eq!(states.raw(id), [f32::from(x)]);
                    prop_assert_eq!(states.whitened(id), [f32::from(x) / 2.0]);
                    expected.insert(x, (id, known.map_or(0, |k| k.1) + 1));
                } else if let Some((id, uses)) = known {
                    prop_assert_eq!(states.release(id), uses == 1);
                    if uses == 1 { expected.remove(&x); } else { expected.insert(x, (id, uses - 1)); }
                }
                prop_assert_eq!(states.len(), expected.len());
                prop_assert!(states.bound() <= 6);
            }
        }
    }

    #[test]
    fn equal_hashes_are_told_apart() {
        let metric = Metric::diagonal(&[1.0]).unwrap();
        let mut states = States::new(1);
        let ids = [1.0, 2.0, 3.0].map(|x| states.acquire(&[x], &metric).0);
        // Chain all three behind one hash, in the order 3, 2, 1.
        let hashes = [1.0, 2.0, 3.0].map(|x: f32| hash(&[x]));
        states.heads.clear();
        states.heads.insert(hashes[1], ids[2]);
        (states.next[2], states.next[1], states.next[0]) = (ids[1], ids[0], NONE);
        assert!(states.release(ids[1]));
        assert_eq!((states.next[2], states.heads[&hashes[1]]), (ids[0], ids[2]));
        assert_ne!(hash(&[0.0]), hash(&[-0.0]));
    }
}
