//! The store of the states that were found: each state once, in the order of their discovery.
//!
//! All states of a system have the same length, so they lie one after the other in one array, and a number identifies a state. The
//! tables beside the array contain only numbers: four bytes per slot, with at most two thirds of the slots in use. The hash of a
//! state selects one of several tables, so several threads can look up the states of one batch. The numbers depend only on the
//! order of the batches, not on the number of threads.

use crate::system::Label;
use crate::threads::{Alone, Threads, each};
use std::sync::atomic::{AtomicU32, Ordering};

/// The number of tables.
const SHARDS: usize = 16;
/// Marks a slot whose value is not a number yet, but an index into the new states of this table.
const PENDING: u32 = 1 << 31;
/// The most states that can have numbers.
pub(crate) const STATES_MAX: u32 = PENDING - 2;
/// Up to this many transitions, one thread is faster than several.
const SMALL: usize = 4096;
/// How many transitions ahead the memory is read.
const AHEAD: usize = 16;
/// The target of a transition that is new and has no number yet.
const NEW: u32 = u32::MAX;

/// A set of byte strings of one length, numbered from 0.
#[derive(Debug)]
pub(crate) struct Store {
    length: usize,
    bytes: Vec<u8>,
    shards: Vec<Shard>,
    count: u32,
}

/// One table.
#[derive(Debug)]
struct Shard {
    /// The number of a state plus 1; 0 marks a free slot. The number of slots is a power of two.
    slots: Vec<u32>,
    count: usize,
}

/// Transitions in order, each with its target state.
#[derive(Debug, Default)]
pub(crate) struct Batch {
    /// The states, one after the other.
    bytes: Vec<u8>,
    hashes: Vec<u64>,
    /// For each transition, its source state and its label.
    pub(crate) origins: Vec<(u32, Label)>,
    /// For each transition, the number of its target, once that is in the store.
    targets: Vec<AtomicU32>,
    /// The transitions of each table.
    shards: [Vec<u32>; SHARDS],
}

/// The new states of one table: slot, batch and transition of each. Also the transitions that lead to such a state.
#[derive(Debug, Default)]
struct Fresh {
    states: Vec<(usize, usize, usize)>,
    twins: Vec<(usize, usize, usize)>,
}

impl Batch {
    /// Adds a transition; `write` changes a copy of `source` to its target state.
    pub(crate) fn push(&mut self, origin: (u32, Label), source: &[u8], write: impl FnOnce(&mut [u8])) {
        let start = self.bytes.len();
        self.bytes.extend_from_slice(source);
        write(&mut self.bytes[start..]);
        let hash = hash(&self.bytes[start..]);
        self.shards[shard_of(hash)].push(u32::try_from(self.hashes.len()).unwrap_or(u32::MAX));
        self.hashes.push(hash);
        self.origins.push(origin);
    }

    /// Returns the number of transitions.
    pub(crate) fn count(&self) -> usize {
        self.hashes.len()
    }

    /// Returns the size of the states in bytes.
    pub(crate) fn size(&self) -> usize {
        self.bytes.len()
    }

    /// Returns the target of a transition; the batch has to be in the store.
    pub(crate) fn target(&self, transition: usize) -> u32 {
        self.targets[transition].load(Ordering::Relaxed)
    }

    fn state(&self, transition: usize, length: usize) -> &[u8] {
        &self.bytes[transition * length..(transition + 1) * length]
    }
}

impl Store {
    pub(crate) fn new(length: usize) -> Self {
        let shards = (0..SHARDS).map(|_| Shard { slots: vec![0; 16], count: 0 }).collect();
        Self { length, bytes: Vec::new(), shards, count: 0 }
    }

    pub(crate) fn count(&self) -> u32 {
        self.count
    }

    pub(crate) fn get(&self, state: u32) -> &[u8] {
        let start = state as usize * self.length;
        &self.bytes[start..start + self.length]
    }

    /// Returns the used memory in bytes.
    pub(crate) fn memory(&self) -> usize {
        self.bytes.capacity() + 4 * self.shards.iter().map(|shard| shard.slots.len()).sum::<usize>()
    }

    /// Adds the unknown states of some batches; calls `is_new` with batch and transition of each, in order.
    pub(crate) fn add(&mut self, batches: &mut [Batch], threads: &dyn Threads, mut is_new: impl FnMut(usize, usize)) {
        for batch in batches.iter_mut() {
            batch.targets.resize_with(batch.hashes.len(), || AtomicU32::new(NEW));
        }
        let batches = &*batches;
        let mut shards = std::mem::take(&mut self.shards);
        let all = self.find(&mut shards, batches, threads);
        for (number, batch) in batches.iter().enumerate() {
            for (transition, target) in batch.targets.iter().enumerate() {
                if target.load(Ordering::Relaxed) == NEW {
                    self.append(batch.state(transition, self.length));
                    target.store(self.count - 1, Ordering::Relaxed);
                    is_new(number, transition);
                }
            }
        }
        for (shard, fresh) in shards.iter_mut().zip(all) {
            let number = |index: usize| {
                let (_, batch, transition) = fresh.states[index];
                batches[batch].target(transition)
            };
            for (index, (slot, ..)) in fresh.states.iter().enumerate() {
                shard.slots[*slot] = number(index) + 1;
            }
            for &(batch, transition, index) in &fresh.twins {
                batches[batch].targets[transition].store(number(index), Ordering::Relaxed);
            }
        }
        self.shards = shards;
    }

    /// Looks up every state in its table.
    fn find(&self, shards: &mut [Shard], batches: &[Batch], threads: &dyn Threads) -> Vec<Fresh> {
        let jobs: Vec<(usize, &mut Shard)> = shards.iter_mut().enumerate().collect();
        let is_small = batches.iter().map(Batch::count).sum::<usize>() < SMALL;
        let threads = if is_small { &Alone } else { threads };
        each(threads, jobs, |_, (index, shard)| self.find_in(shard, index, batches))
    }

    fn find_in(&self, shard: &mut Shard, index: usize, batches: &[Batch]) -> Fresh {
        let wanted: usize = batches.iter().map(|batch| batch.shards[index].len()).sum();
        self.make_room(shard, wanted);
        let (mask, mut fresh) = (shard.slots.len() - 1, Fresh::default());
        for (number, batch) in batches.iter().enumerate() {
            let all = &batch.shards[index];
            for (place, &transition) in all.iter().enumerate() {
                if place % AHEAD == 0 {
                    self.touch(shard, batch, &all[place..all.len().min(place + AHEAD)]);
                }
                let transition = transition as usize;
                let state = batch.state(transition, self.length);
                let mut slot = slot_of(batch.hashes[transition]) & mask;
                loop {
                    let known = shard.slots[slot];
                    if known == 0 {
                        shard.slots[slot] = PENDING | u32::try_from(fresh.states.len()).unwrap_or(u32::MAX);
                        fresh.states.push((slot, number, transition));
                        break;
                    }
                    if known & PENDING == 0 {
                        if self.get(known - 1) == state {
                            batch.targets[transition].store(known - 1, Ordering::Relaxed);
                            break;
                        }
                    } else {
                        let index = (known & !PENDING) as usize;
                        let (_, number_of_first, first) = fresh.states[index];
                        if batches[number_of_first].state(first, self.length) == state {
                            // Any number except `NEW` is sufficient here: the right one is written once the first transition has
                            // it.
                            batch.targets[transition].store(0, Ordering::Relaxed);
                            fresh.twins.push((number, transition, index));
                            break;
                        }
                    }
                    slot = (slot + 1) & mask;
                }
            }
        }
        shard.count += fresh.states.len();
        fresh
    }

    /// Reads the memory for the next few comparisons in advance, so that the loads overlap.
    fn touch(&self, shard: &Shard, batch: &Batch, transitions: &[u32]) {
        let known = transitions.iter().map(|&transition| {
            let slot = slot_of(batch.hashes[transition as usize]) & (shard.slots.len() - 1);
            shard.slots[slot]
        });
        let states = known.filter(|known| *known != 0 && known & PENDING == 0);
        let sum = states.fold(0, |sum: u8, known| sum ^ self.bytes[(known - 1) as usize * self.length]);
        std::hint::black_box(sum);
    }

    /// Makes room so that after `more` further states at most two thirds of the slots are in use.
    fn make_room(&self, shard: &mut Shard, more: usize) {
        let mut length = shard.slots.len();
        while (shard.count + more) * 3 > length * 2 {
            length *= 2;
        }
        if length == shard.slots.len() {
            return;
        }
        let (mask, mut slots) = (length - 1, vec![0; length]);
        for known in shard.slots.iter().filter(|known| **known != 0) {
            let mut slot = slot_of(hash(self.get(known - 1))) & mask;
            while slots[slot] != 0 {
                slot = (slot + 1) & mask;
            }
            slots[slot] = *known;
        }
        shard.slots = slots;
    }

    /// The capacity grows by an eighth, since the memory may not suffice for twice as much.
    fn append(&mut self, state: &[u8]) {
        if self.bytes.len() + state.len() > self.bytes.capacity() {
            self.bytes.reserve_exact((self.bytes.len() / 8).max(64 * state.len()));
        }
        self.bytes.extend_from_slice(state);
        self.count += 1;
    }
}

fn shard_of(hash: u64) -> usize {
    (hash >> 60) as usize % SHARDS
}

fn slot_of(hash: u64) -> usize {
    usize::try_from(hash & u64::from(u32::MAX)).unwrap_or(0)
}

/// Mixes the bytes, eight at a time. Two rounds of multiplication spread states that differ in one bit.
fn hash(bytes: &[u8]) -> u64 {
    const FACTOR: u64 = 0x9e37_79b9_7f4a_7c15;
    let mix = |sum: u64, word: u64| {
        let sum = (sum ^ word).wrapping_mul(FACTOR);
        sum ^ sum >> 29
    };
    let (words, rest) = bytes.as_chunks::<8>();
    let sum = words.iter().fold(bytes.len() as u64, |sum, word| mix(sum, u64::from_le_bytes(*word)));
    let last = rest.iter().fold(0, |word, byte| word << 8 | u64::from(*byte));
    let sum = mix(sum, last).wrapping_mul(FACTOR);
    sum ^ sum >> 32
}

#[cfg(test)]
mod tests {
    use super::*;

    #[derive(Debug)]
    struct Crew(usize);

    impl Threads for Crew {
        fn count(&self) -> usize {
            self.0
        }

        fn run(&self, work: &(dyn Fn(usize) + Sync)) {
            std::thread::scope(|scope| (0..self.0).for_each(|thread| drop(scope.spawn(move || work(thread)))));
        }
    }

    #[test]
    fn numbers_are_in_the_order_of_the_transitions_whatever_the_threads() {
        for threads in [1, 2, 5].map(Crew) {
            let mut store = Store::new(4);
            for round in 0..2 {
                let mut batches: Vec<Batch> = (0..7).map(|_| Batch::default()).collect();
                for (number, batch) in (0..).zip(&mut batches) {
                    for state in 1000 * number..1000 * number + 1500_u32 {
                        batch.push((0, Label::Start), &[0; 4], |bytes| bytes.copy_from_slice(&state.to_le_bytes()));
                    }
                }
                let mut new = 0;
                store.add(&mut batches, &threads, |_, _| new += 1);
                assert_eq!(new, if round == 0 { 7500 } else { 0 });
                for (number, batch) in (0..).zip(&batches) {
                    (0..1500).for_each(|i| assert_eq!(batch.target(i as usize), 1000 * number + i));
                }
            }
            assert_eq!(store.count(), 7500);
            assert_eq!(store.get(77), 77_u32.to_le_bytes());
        }
    }
}
