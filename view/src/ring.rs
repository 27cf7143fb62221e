//! A list with a limit: the oldest item leaves, and is counted.

use std::collections::VecDeque;

/// An item, with the number of the input that brought it.
#[derive(Clone, Debug)]
struct Numbered<T> {
    number: u64,
    item: T,
}

/// A list with a limit.
#[derive(Clone, Debug)]
pub(crate) struct Ring<T> {
    items: VecDeque<Numbered<T>>,
    limit: usize,
    /// The total number of items that have come.
    count: u64,
    /// The number of the latest item that has left.
    dropped_last: u64,
}

impl<T> Ring<T> {
    pub(crate) fn new(limit: usize) -> Self {
        Self { items: VecDeque::new(), limit, count: 0, dropped_last: 0 }
    }

    /// Adds an item; returns the oldest one if it leaves for it.
    pub(crate) fn push(&mut self, number: u64, item: T) -> Option<T> {
        let is_full = self.items.len() >= self.limit.max(1);
        let left = if is_full { self.items.pop_front() } else { None };
        self.dropped_last = left.as_ref().map_or(self.dropped_last, |oldest| oldest.number);
        self.items.push_back(Numbered { number, item });
        self.count += 1;
        left.map(|oldest| oldest.item)
    }

    /// Takes out the items that are not wanted any more.
    pub(crate) fn retain(&mut self, is_wanted: impl Fn(&T) -> bool) {
        self.items.retain(|one| is_wanted(&one.item));
    }

    /// Returns all items, the oldest first.
    pub(crate) fn iter(&self) -> impl DoubleEndedIterator<Item = &T> + ExactSizeIterator {
        self.items.iter().map(|one| &one.item)
    }

    /// Returns the items that came after a number, the oldest first.
    pub(crate) fn since(&self, number: u64) -> impl Iterator<Item = &T> {
        let begin = self.items.partition_point(|one| one.number <= number);
        self.items.range(begin..).map(|one| &one.item)
    }

    /// Returns whether an item that came after a number has left.
    pub(crate) fn has_gap_since(&self, number: u64) -> bool {
        self.dropped_last > number
    }

    /// Returns the total number of items that have come.
    pub(crate) fn count(&self) -> u64 {
        self.count
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_oldest_leaves_and_is_counted() {
        let mut ring = Ring::new(3);
        let left: Vec<u64> = (1..=5).filter_map(|number| ring.push(number, number * 10)).collect();
        assert_eq!(left, [10, 20]);
        assert_eq!(ring.iter().copied().collect::<Vec<_>>(), [30, 40, 50]);
        assert_eq!(ring.since(3).copied().collect::<Vec<_>>(), [40, 50]);
        assert_eq!((ring.count(), ring.has_gap_since(1), ring.has_gap_since(2)), (5, true, false));
    }
}
