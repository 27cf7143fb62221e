//! Group commit: commits that arrive while the disk is busy go to the disk together.
//!
//! A device syncs a few hundred times a second. The number of commits per second is this number times the size of a group. If
//! a group contained only the commits that already wait, groups would be too small: callers that were answered together return
//! one after another. The commit of the first caller would then get its own sync, while all others wait for it. So a group
//! waits until it is as large as the previous one, but never longer than an eighth of a sync. A single caller never waits for
//! others.

use comms::io::clock;
use comms::logic::time::Time;
use std::sync::mpsc::{Receiver, RecvTimeoutError, TryRecvError};
use std::time::Duration;

/// The longest time that a group may wait for further commits, as a part of a sync: one eighth.
const PATIENCE: u32 = 8;
/// The weight of the newest sync in the mean length of a sync: one quarter.
const NEWEST: u32 = 4;

/// A queue from which groups are taken.
#[derive(Debug)]
pub struct Groups<T> {
    queue: Receiver<T>,
    size_max: usize,
    /// How many came last time.
    expected: usize,
    /// The mean length of a sync.
    sync: Duration,
}

impl<T> Groups<T> {
    /// Returns the groups of at most `size_max` elements that are taken from `queue`.
    pub fn new(queue: Receiver<T>, size_max: usize) -> Self {
        Self { queue, size_max, expected: 1, sync: Duration::ZERO }
    }

    /// Waits for the next group, at most until `deadline`; without one, for ever. The group is empty if the deadline has come.
    /// `None` if the last sender was dropped.
    pub fn next(&mut self, deadline: Option<Time>) -> Option<Vec<T>> {
        let first = match deadline {
            Some(deadline) => match self.queue.recv_timeout(deadline.since(clock::now())) {
                Ok(first) => first,
                Err(RecvTimeoutError::Timeout) => return Some(Vec::new()),
                Err(RecvTimeoutError::Disconnected) => return None,
            },
            None => self.queue.recv().ok()?,
        };
        let mut group = vec![first];
        let until = clock::now() + self.sync / PATIENCE;
        while group.len() < self.size_max {
            let next = self.queue.try_recv();
            let comes_back = matches!(next, Err(TryRecvError::Empty)) && group.len() < self.expected;
            let next = if comes_back { self.queue.recv_timeout(until.since(clock::now())).ok() } else { next.ok() };
            let Some(next) = next else { break };
            group.push(next);
        }
        self.expected = group.len();
        Some(group)
    }

    /// Notes how long the sync of the last group took.
    pub fn synced(&mut self, took: Duration) {
        self.sync = if self.sync.is_zero() { took } else { (self.sync * (NEWEST - 1) + took) / NEWEST };
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::sync::mpsc::sync_channel;

    #[test]
    fn what_waits_comes_together_up_to_the_limit() {
        let (sender, queue) = sync_channel(8);
        let mut groups = Groups::new(queue, 3);
        for number in 0..5 {
            sender.send(number).unwrap();
        }
        assert_eq!(groups.next(None), Some(vec![0, 1, 2]));
        assert_eq!(groups.next(Some(Time::ZERO)), Some(vec![3, 4]), "nobody is waited for while syncs take no time");
        assert_eq!(groups.next(Some(Time::ZERO)), Some(vec![]));
        drop(sender);
        assert_eq!(groups.next(None), None);
    }

    #[test]
    fn who_was_there_last_time_is_waited_for() {
        let (sender, queue) = sync_channel(8);
        let mut groups = Groups::new(queue, 8);
        (0..3).for_each(|number| sender.send(number).unwrap());
        assert_eq!(groups.next(None).unwrap().len(), 3);
        groups.synced(Duration::from_secs(3600));
        let (first, others) = (sender.clone(), sender);
        first.send(0).unwrap();
        std::thread::scope(|scope| {
            let comes_back = scope.spawn(move || (1..3).for_each(|number| others.send(number).unwrap()));
            assert_eq!(groups.next(None), Some(vec![0, 1, 2]), "an eighth of an hour would have been the limit");
            comes_back.join().unwrap();
        });
    }
}
