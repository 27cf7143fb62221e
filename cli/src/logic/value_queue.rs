//! A queue of values that robots have sent to this command.
//!
//! Robots do not wait for a slow command. If the queue is full, the source with the most bytes loses its oldest values.
//! So a camera cannot displace the values of other sources.

use std::collections::{BTreeMap, VecDeque};

/// The usual limit of bytes in the queue: two seconds of a camera with 4 MB/s.
const SIZE_MAX: usize = 8 << 20;
/// A value counts as at least this many bytes, so that a queue of the usual size has at most 2048 values.
const VALUE_MIN: usize = 4 << 10;

/// A value that comes out of the queue.
#[derive(Clone, Debug, PartialEq, Eq)]
pub(crate) struct Queued<S, V> {
    pub(crate) source: S,
    pub(crate) value: V,
    /// How many earlier values of the same source were dropped.
    pub(crate) lost: u64,
}

/// The queue.
#[derive(Debug)]
pub(crate) struct ValueQueue<S, V> {
    sources: BTreeMap<S, Waiting<V>>,
    size: usize,
    /// The most bytes in the queue. A larger value can only be in the queue alone.
    size_max: usize,
    /// The position of the next value among all values that came.
    next: u64,
}

#[derive(Debug)]
struct Waiting<V> {
    values: VecDeque<Entry<V>>,
    size: usize,
    lost: u64,
}

#[derive(Debug)]
struct Entry<V> {
    place: u64,
    size: usize,
    value: V,
}

impl<S: Ord + Clone, V> ValueQueue<S, V> {
    /// Returns an empty queue for this many bytes.
    pub(crate) fn with_size(size_max: usize) -> Self {
        Self { sources: BTreeMap::new(), size: 0, size_max, next: 0 }
    }

    /// Adds a value of this size in bytes.
    pub(crate) fn push(&mut self, source: &S, size: usize, value: V) {
        let size = size.max(VALUE_MIN);
        while self.size > 0 && self.size.saturating_add(size) > self.size_max {
            self.drop_one();
        }
        let new = || Waiting { values: VecDeque::new(), size: 0, lost: 0 };
        let waiting = self.sources.entry(source.clone()).or_insert_with(new);
        waiting.values.push_back(Entry { place: self.next, size, value });
        waiting.size += size;
        self.size += size;
        self.next += 1;
    }

    /// Takes out the oldest value.
    pub(crate) fn pop(&mut self) -> Option<Queued<S, V>> {
        let place = |(source, waiting): (_, &Waiting<V>)| Some((waiting.values.front()?.place, source));
        let source = self.sources.iter().filter_map(place).min()?.1.clone();
        let waiting = self.sources.get_mut(&source)?;
        let Entry { size, value, .. } = waiting.values.pop_front()?;
        waiting.size -= size;
        self.size -= size;
        let lost = std::mem::take(&mut waiting.lost);
        if waiting.values.is_empty() {
            self.sources.remove(&source);
        }
        Some(Queued { source, value, lost })
    }

    /// Returns the sources that have lost values since their last value was taken out, and how many.
    pub(crate) fn lost(&mut self) -> Vec<(S, u64)> {
        let lost = self.sources.iter_mut().map(|(source, waiting)| (source.clone(), std::mem::take(&mut waiting.lost)));
        lost.filter(|(_, lost)| *lost > 0).collect()
    }

    /// Drops the oldest value of the source with the most bytes.
    fn drop_one(&mut self) {
        let Some(most) = self.sources.values_mut().max_by_key(|waiting| waiting.size) else { return };
        if let Some(oldest) = most.values.pop_front() {
            most.size -= oldest.size;
            most.lost += 1;
            self.size -= oldest.size;
        }
    }
}

impl<S: Ord + Clone, V> Default for ValueQueue<S, V> {
    fn default() -> Self {
        Self::with_size(SIZE_MAX)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use comms::logic::random::Random;

    #[test]
    fn a_source_with_large_values_displaces_no_other() {
        let mut queue = ValueQueue::default();
        for number in 0..200 {
            queue.push(&"camera", 1 << 20, number);
            queue.push(&"force", 8, number);
        }
        let rest: Vec<Queued<&str, i32>> = std::iter::from_fn(|| queue.pop()).collect();
        let of = |name: &str| rest.iter().filter(|one| one.source == name).map(|one| one.value).collect::<Vec<_>>();
        assert_eq!(of("force"), (0..200).collect::<Vec<_>>());
        assert_eq!(of("camera"), (193..200).collect::<Vec<_>>());
    }

    #[test]
    fn a_value_that_is_longer_than_the_limit_waits_alone() {
        let mut queue = ValueQueue::default();
        queue.push(&1, 10, "short");
        queue.push(&1, SIZE_MAX + 1, "long");
        assert_eq!(queue.pop(), Some(Queued { source: 1, value: "long", lost: 1 }));
        assert_eq!((queue.pop(), queue.size), (None, 0));
    }

    /// Values leave the queue in their order. Each value leaves it or is counted, and the queue never exceeds its limit.
    #[test]
    fn each_value_is_taken_in_order_or_counted() {
        for seed in 0..100 {
            let (mut random, mut queue) = (Random::new(seed), ValueQueue::default());
            let (mut put, mut last) = ([0_u64; 3], None);
            let (mut next, mut order) = ([0_u64; 3], 0_u64);
            let mut take = |Queued { source, value: (number, place), lost }: Queued<usize, (u64, u64)>| {
                assert_eq!(number, next[source] + lost, "seed {seed}");
                assert!(last.is_none_or(|last| last < place), "seed {seed}");
                (next[source], last) = (number + 1, Some(place));
            };
            for _ in 0..60 {
                for _ in 0..random.below(40) {
                    let source = usize::try_from(random.below(3)).unwrap();
                    let size = usize::try_from(random.below(1 << [8, 16, 21][source])).unwrap();
                    queue.push(&source, size, (put[source], order));
                    (put[source], order) = (put[source] + 1, order + 1);
                    let count: usize = queue.sources.values().map(|waiting| waiting.values.len()).sum();
                    assert!(queue.size <= SIZE_MAX && count <= SIZE_MAX / VALUE_MIN, "seed {seed}");
                }
                (0..random.below(20)).filter_map(|_| queue.pop()).for_each(&mut take);
            }
            while let Some(one) = queue.pop() {
                take(one);
            }
            // A large value of one source may displace the last value of another source.
            let rest = queue.lost();
            let rest = |source: usize| rest.iter().find(|(of, _)| *of == source).map_or(0, |(_, lost)| *lost);
            assert_eq!([0, 1, 2].map(|source| next[source] + rest(source)), put, "seed {seed}");
        }
    }
}
