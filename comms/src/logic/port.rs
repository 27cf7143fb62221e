//! The policies of a full queue. Every queue has a capacity and one of these policies.

use std::collections::VecDeque;
use std::num::NonZeroUsize;

/// The policy for a value that arrives when the queue is full.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Policy {
    /// A queue of one: the newest value replaces the previous one.
    Latest,
    /// The oldest value gives way.
    DropOldest(NonZeroUsize),
    /// The new value is rejected, and the sender is informed.
    Reject(NonZeroUsize),
}

/// The result of pushing a value.
#[derive(Clone, Debug, PartialEq, Eq)]
pub enum Pushed<T> {
    /// The value is in the queue.
    Stored,
    /// The value is in the queue, and has replaced this older value.
    Replaced(T),
    /// The value is not in the queue, and is returned.
    Rejected(T),
}

/// A bounded first-in first-out queue.
#[derive(Clone, Debug)]
pub struct Queue<T> {
    values: VecDeque<T>,
    policy: Policy,
    lost: u64,
}

impl Policy {
    /// Returns the largest number of values in the queue.
    pub const fn capacity(self) -> usize {
        match self {
            Self::Latest => 1,
            Self::DropOldest(capacity) | Self::Reject(capacity) => capacity.get(),
        }
    }

    /// Returns [`Policy::DropOldest`]; a capacity of zero becomes one.
    pub const fn drop_oldest(capacity: usize) -> Self {
        Self::DropOldest(at_least_one(capacity))
    }

    /// Returns [`Policy::Reject`]; a capacity of zero becomes one.
    pub const fn reject(capacity: usize) -> Self {
        Self::Reject(at_least_one(capacity))
    }
}

const fn at_least_one(capacity: usize) -> NonZeroUsize {
    match NonZeroUsize::new(capacity) {
        Some(capacity) => capacity,
        None => NonZeroUsize::MIN,
    }
}

impl<T> Queue<T> {
    /// Returns an empty queue.
    pub const fn new(policy: Policy) -> Self {
        Self { values: VecDeque::new(), policy, lost: 0 }
    }

    /// Takes a value.
    pub fn push(&mut self, value: T) -> Pushed<T> {
        if self.values.len() < self.policy.capacity() {
            self.values.push_back(value);
            return Pushed::Stored;
        }
        self.lost += 1;
        match self.policy {
            Policy::Reject(_) => Pushed::Rejected(value),
            Policy::Latest | Policy::DropOldest(_) => {
                let oldest = self.values.pop_front();
                self.values.push_back(value);
                oldest.map_or(Pushed::Stored, Pushed::Replaced)
            }
        }
    }

    /// Returns the oldest value.
    pub fn pop(&mut self) -> Option<T> {
        self.values.pop_front()
    }

    /// Returns how many values wait.
    pub fn len(&self) -> usize {
        self.values.len()
    }

    /// Returns whether the queue is empty.
    pub fn is_empty(&self) -> bool {
        self.values.is_empty()
    }

    /// Returns how many values were replaced or rejected.
    pub fn lost(&self) -> u64 {
        self.lost
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    fn policies() -> impl Strategy<Value = Policy> {
        prop_oneof![
            Just(Policy::Latest),
            (0_usize..5).prop_map(Policy::drop_oldest),
            (0_usize..5).prop_map(Policy::reject),
        ]
    }

    proptest! {
        /// Compared with the simplest model: a growing list of the values that a reader should see.
        #[test]
        fn loses_only_what_its_policy_says(policy in policies(), steps: Vec<Option<u16>>) {
            let (mut queue, mut model, mut lost) = (Queue::new(policy), Vec::new(), 0);
            for step in steps {
                match step {
                    None => {
                        let expected = (!model.is_empty()).then(|| model.remove(0));
                        prop_assert_eq!(queue.pop(), expected);
                    }
                    Some(value) if model.len() < policy.capacity() => {
                        prop_assert_eq!(queue.push(value), Pushed::Stored);
                        model.push(value);
                    }
                    Some(value) => {
                        lost += 1;
                        let expected = match policy {
                            Policy::Reject(_) => Pushed::Rejected(value),
                            Policy::Latest | Policy::DropOldest(_) => {
                                model.push(value);
                                Pushed::Replaced(model.remove(0))
                            }
                        };
                        prop_assert_eq!(queue.push(value), expected);
                    }
                }
                prop_assert_eq!((queue.len(), queue.is_empty(), queue.lost()), (model.len(), model.is_empty(), lost));
                prop_assert!(queue.len() <= policy.capacity());
            }
        }
    }

    #[test]
    fn latest_is_the_newest() {
        let mut queue = Queue::new(Policy::Latest);
        for value in 0..100 {
            queue.push(value);
        }
        assert_eq!((queue.pop(), queue.pop(), queue.lost()), (Some(99), None, 99));
    }
}
