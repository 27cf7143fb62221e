//! A message queue: receives messages, and gives them out by priority. Messages of the same priority keep their order
//! of arrival.
//!
//! A queue receives messages only by [`MessageQueue::receive`], which returns the result as a [`Receipt`]. A message
//! that is sent again because its receipt was lost is taken once. Invariant: each accepted message is taken once, or
//! dropped and counted, or waits.

use super::fencing::Refusal;
use super::header::{Malformed, Message, count};
use super::seen::{Novelty, Seen};
use crate::logic::time::Time;
use serde::{Deserialize, Serialize};
use std::cmp::Reverse;
use std::collections::BTreeMap;
use std::num::NonZeroUsize;
use thiserror::Error;

/// The longest queue.
pub const CAPACITY_MAX: usize = 65_536;

/// The policy for a message that finds the queue full.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub enum Full {
    /// The new message is rejected.
    Reject,
    /// The last message in the order is dropped: the newest of the lowest priority. If that is the new message, it is
    /// rejected.
    DropLowest,
    /// The message that has waited for longest is dropped, regardless of its priority.
    DropOldest,
}

/// The declaration of a queue.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct QueueSettings {
    /// The type of the data. Messages of another type are rejected.
    pub type_name: String,
    /// How many messages wait at most.
    pub capacity: NonZeroUsize,
    /// The policy for a full queue.
    pub full: Full,
    /// The most bytes of data in a message.
    pub data_size_max: usize,
}

/// The result for a message.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub enum Receipt {
    /// The message waits in the queue, or was accepted when it came for the first time.
    Accepted,
    /// The message was rejected, and is not stored.
    Rejected(Rejected),
}

/// Why a message was turned away.
#[derive(Clone, Debug, Error, PartialEq, Eq, Serialize, Deserialize)]
pub enum Rejected {
    /// The queue is full.
    #[error("{capacity} messages are already waiting")]
    Full {
        /// The capacity of the queue.
        capacity: u64,
    },
    /// The message has another type.
    #[error("the queue takes `{expected}`, and the message is a `{found}`")]
    WrongType {
        /// The type that the queue accepts.
        expected: String,
        /// The type of the message.
        found: String,
    },
    /// The message breaks a limit.
    #[error("{0}")]
    Malformed(Malformed),
    /// The message is so old that it is unknown whether it was taken.
    #[error("the message is so old that it may already have been taken")]
    TooOld,
    /// Too many senders are active.
    #[error("the queue has too many active senders")]
    Senders,
    /// The resource behind the queue refuses the message.
    #[error("{0}")]
    Fenced(Refusal),
    /// The program accepts nothing now: it is not active.
    #[error("the program of the queue is idle")]
    Idle,
}

/// The traffic through a queue.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
pub struct QueueCounters {
    /// How many messages wait.
    pub depth: u64,
    /// The most messages that have waited at a time.
    pub depth_max: u64,
    /// Accepted, each message once.
    pub accepted: u64,
    /// Taken by the program.
    pub taken: u64,
    /// Messages that were accepted, and later dropped for others.
    pub dropped: u64,
    /// Turned away.
    pub rejected: u64,
    /// Messages that were sent again after they were accepted.
    pub repeated: u64,
}

/// A bounded queue by priority.
#[derive(Clone, Debug)]
pub struct MessageQueue {
    settings: QueueSettings,
    /// The messages by priority and arrival; the first one is the next to be taken.
    waiting: BTreeMap<(Reverse<u8>, u64), Message>,
    /// The priorities by arrival, to find the message that has waited for longest.
    arrivals: BTreeMap<u64, u8>,
    arrival: u64,
    seen: Seen,
    counters: QueueCounters,
    last_sender: String,
}

impl MessageQueue {
    /// Returns an empty queue.
    pub fn new(settings: QueueSettings) -> Self {
        let (waiting, arrivals) = (BTreeMap::new(), BTreeMap::new());
        let (seen, counters) = (Seen::default(), QueueCounters::default());
        Self { settings, waiting, arrivals, arrival: 0, seen, counters, last_sender: String::new() }
    }

    /// Receives a message.
    pub fn receive(&mut self, now: Time, message: Message) -> Receipt {
        match self.try_receive(now, message) {
            Ok(()) => Receipt::Accepted,
            Err(rejected) => self.turn_away(rejected),
        }
    }

    /// Notes that a message was rejected for a reason that the queue itself cannot know.
    pub fn turn_away(&mut self, rejected: Rejected) -> Receipt {
        self.counters.rejected += 1;
        Receipt::Rejected(rejected)
    }

    fn try_receive(&mut self, now: Time, message: Message) -> Result<(), Rejected> {
        self.check(&message)?;
        match self.seen.look(now, message.header.id) {
            Novelty::New => {}
            Novelty::Taken => {
                self.counters.repeated += 1;
                return Ok(());
            }
            Novelty::TooOld => return Err(Rejected::TooOld),
            Novelty::NoRoom => return Err(Rejected::Senders),
        }
        if self.waiting.len() >= self.settings.capacity.get() {
            self.make_room(message.header.priority)?;
        }
        self.seen.take(now, message.header.id);
        self.last_sender.clone_from(&message.header.sender);
        self.arrival += 1;
        self.arrivals.insert(self.arrival, message.header.priority);
        self.waiting.insert((Reverse(message.header.priority), self.arrival), message);
        self.counters.accepted += 1;
        self.counters.depth = count(self.waiting.len());
        self.counters.depth_max = self.counters.depth_max.max(self.counters.depth);
        Ok(())
    }

    fn check(&self, message: &Message) -> Result<(), Rejected> {
        message.check().map_err(Rejected::Malformed)?;
        let (size, size_max) = (message.data.len(), self.settings.data_size_max);
        if size > size_max {
            return Err(Rejected::Malformed(Malformed::Data { size: count(size), size_max: count(size_max) }));
        }
        if message.type_name != self.settings.type_name {
            let (expected, found) = (self.settings.type_name.clone(), message.type_name.clone());
            return Err(Rejected::WrongType { expected, found });
        }
        Ok(())
    }

    fn make_room(&mut self, priority: u8) -> Result<(), Rejected> {
        let victim = match self.settings.full {
            Full::Reject => None,
            Full::DropLowest => {
                let last = self.waiting.last_key_value().map(|(&key, _)| key);
                last.filter(|(Reverse(lowest), _)| *lowest < priority)
            }
            Full::DropOldest => {
                self.arrivals.first_key_value().map(|(&arrival, &priority)| (Reverse(priority), arrival))
            }
        };
        let victim = victim.ok_or(Rejected::Full { capacity: count(self.settings.capacity.get()) })?;
        self.waiting.remove(&victim);
        self.arrivals.remove(&victim.1);
        self.counters.dropped += 1;
        Ok(())
    }

    /// Takes the message of the highest priority; among several, the earliest.
    pub fn take(&mut self) -> Option<Message> {
        let ((_, arrival), message) = self.waiting.pop_first()?;
        self.arrivals.remove(&arrival);
        self.counters.taken += 1;
        self.counters.depth = count(self.waiting.len());
        Some(message)
    }

    /// Keeps only the messages for which `keep` returns true.
    pub fn retain(&mut self, mut keep: impl FnMut(&Message) -> bool) {
        let before = self.waiting.len();
        self.waiting.retain(|_, message| keep(message));
        let waiting = &self.waiting;
        self.arrivals.retain(|arrival, priority| waiting.contains_key(&(Reverse(*priority), *arrival)));
        self.counters.dropped += count(before - self.waiting.len());
        self.counters.depth = count(self.waiting.len());
    }

    /// Drops all waiting messages. The queue still recognises the messages that were already taken.
    pub fn clear(&mut self) {
        self.counters.dropped += count(self.waiting.len());
        self.waiting.clear();
        self.arrivals.clear();
        self.counters.depth = 0;
    }

    /// Returns the counters of the messages.
    pub fn counters(&self) -> QueueCounters {
        self.counters
    }

    /// Returns the sender of the last accepted message; empty if there was none.
    pub fn last_sender(&self) -> &str {
        &self.last_sender
    }

    /// Returns the settings with which the queue was declared.
    pub fn settings(&self) -> &QueueSettings {
        &self.settings
    }
}

#[cfg(test)]
mod tests {
    use super::super::header::{MessageId, sample};
    use super::*;
    use proptest::prelude::*;

    fn settings(capacity: usize, full: Full) -> QueueSettings {
        let capacity = NonZeroUsize::new(capacity).unwrap();
        QueueSettings { type_name: "Speed".into(), capacity, full, data_size_max: 16 }
    }

    /// The simplest model: a list in the order of arrival, searched from end to end.
    #[derive(Default)]
    struct Model {
        waiting: Vec<Message>,
        taken_ids: Vec<MessageId>,
        counters: QueueCounters,
    }

    impl Model {
        fn receive(&mut self, capacity: usize, full: Full, message: &Message) -> Receipt {
            if self.taken_ids.contains(&message.header.id) {
                self.counters.repeated += 1;
                return Receipt::Accepted;
            }
            if self.waiting.len() == capacity {
                let lowest = self.waiting.iter().map(|one| one.header.priority).min().unwrap();
                let victim = match full {
                    Full::Reject => None,
                    Full::DropLowest if lowest < message.header.priority => {
                        self.waiting.iter().rposition(|one| one.header.priority == lowest)
                    }
                    Full::DropLowest => None,
                    Full::DropOldest => Some(0),
                };
                let Some(victim) = victim else {
                    self.counters.rejected += 1;
                    return Receipt::Rejected(Rejected::Full { capacity: capacity as u64 });
                };
                self.waiting.remove(victim);
                self.counters.dropped += 1;
            }
            self.waiting.push(message.clone());
            self.taken_ids.push(message.header.id);
            self.counters.accepted += 1;
            self.counters.depth_max = self.counters.depth_max.max(self.waiting.len() as u64);
            Receipt::Accepted
        }

        fn take(&mut self) -> Option<Message> {
            let highest = self.waiting.iter().map(|one| one.header.priority).max()?;
            let first = self.waiting.iter().position(|one| one.header.priority == highest)?;
            self.counters.taken += 1;
            Some(self.waiting.remove(first))
        }
    }

    proptest! {
        #[test]
        fn gives_out_by_priority_and_loses_only_what_its_policy_says(
            capacity in 1_usize..6,
            full in prop_oneof![Just(Full::Reject), Just(Full::DropLowest), Just(Full::DropOldest)],
            steps in prop::collection::vec(prop::option::weighted(0.7, (0_u64..3, 1_u64..40, 0_u8..4)), 0..200),
        ) {
            let (mut queue, mut model) = (MessageQueue::new(settings(capacity, full)), Model::default());
            for step in steps {
                match step {
                    None => prop_assert_eq!(queue.take(), model.take()),
                    Some((life, number, priority)) => {
                        let message = sample(life, number, priority);
                        let expected = model.receive(capacity, full, &message);
                        prop_assert_eq!(queue.receive(Time::ZERO, message), expected);
                    }
                }
                model.counters.depth = model.waiting.len() as u64;
                let counters = queue.counters();
                prop_assert_eq!(counters, model.counters);
                prop_assert_eq!(counters.accepted, counters.taken + counters.dropped + counters.depth);
                prop_assert!(queue.arrivals.len() == queue.waiting.len() && queue.waiting.len() <= capacity);
            }
            queue.clear();
            let counters = queue.counters();
            prop_assert_eq!((counters.depth, counters.accepted), (0, counters.taken + counters.dropped));
        }
    }

    #[test]
    fn what_is_not_for_it_is_turned_away_with_the_reason() {
        let mut queue = MessageQueue::new(settings(1, Full::DropOldest));
        let mut receive = |change: fn(&mut Message)| {
            let mut message = sample(1, 1, 0);
            change(&mut message);
            queue.receive(Time::ZERO, message)
        };
        let (expected, found) = ("Speed".into(), "Wrench".into());
        let wrong = Receipt::Rejected(Rejected::WrongType { expected, found });
        assert_eq!(receive(|message| message.type_name = "Wrench".into()), wrong);
        let long = Receipt::Rejected(Rejected::Malformed(Malformed::Data { size: 17, size_max: 16 }));
        assert_eq!(receive(|message| message.data = vec![0; 17]), long);
        assert_eq!(receive(|message| message.header.id.number = 5000), Receipt::Accepted);
        assert_eq!(receive(|_| ()), Receipt::Rejected(Rejected::TooOld));
        assert_eq!(queue.turn_away(Rejected::Idle), Receipt::Rejected(Rejected::Idle));
        assert_eq!((queue.counters().rejected, queue.counters().accepted), (4, 1));
    }

    /// A message that was rejected for lack of room may be sent again with the same identifier, and is then accepted.
    #[test]
    fn a_rejected_message_is_no_duplicate() {
        let mut queue = MessageQueue::new(settings(1, Full::Reject));
        assert_eq!(queue.receive(Time::ZERO, sample(1, 1, 0)), Receipt::Accepted);
        let full = Receipt::Rejected(Rejected::Full { capacity: 1 });
        assert_eq!(queue.receive(Time::ZERO, sample(1, 2, 9)), full);
        assert_eq!(queue.take(), Some(sample(1, 1, 0)));
        assert_eq!(queue.receive(Time::ZERO, sample(1, 2, 9)), Receipt::Accepted);
        assert_eq!(queue.receive(Time::ZERO, sample(1, 1, 0)), Receipt::Accepted);
        assert_eq!((queue.take(), queue.take()), (Some(sample(1, 2, 9)), None));
        assert_eq!(queue.counters().repeated, 1);
    }
}
