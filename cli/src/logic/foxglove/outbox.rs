//! The messages that wait for one client.
//!
//! No robot and no other client waits for a slow client. Its oldest values are left out and counted, and the client gets the count.
//! Words, which are all other messages, are never left out: a client that does not even take these is cut off.

use super::protocol::{self, Level};
use comms::logic::time::Time;
use node::logic::table::counted;
use std::collections::{BTreeMap, VecDeque};
use std::sync::Arc;
use std::time::Duration;

/// The most bytes of values that wait: two seconds of a camera with 4 MB a second.
pub(super) const VALUES_SIZE_MAX: usize = 8 << 20;
/// The most values that wait: a second of 40 topics with 100 Hz.
pub(super) const VALUES_MAX: usize = 4096;
/// The most bytes of words that wait. The channels of 2000 outputs with their schemas are about 4 MB.
pub(super) const WORDS_SIZE_MAX: usize = 16 << 20;
/// The most words that wait.
pub(super) const WORDS_MAX: usize = 4096;
/// The shortest time between two reports of losses to a client.
const TOLD_EVERY: Duration = Duration::from_secs(1);
/// How many topics the message about losses names.
const NAMED_MAX: usize = 3;

/// A message to a client.
#[derive(Clone, Debug, PartialEq, Eq)]
pub(crate) enum Frame {
    Text(String),
    Binary(Vec<u8>),
}

impl Frame {
    fn size(&self) -> usize {
        match self {
            Self::Text(text) => text.len(),
            Self::Binary(bytes) => bytes.len(),
        }
    }
}

/// A value that waits.
#[derive(Debug)]
struct Value {
    topic: Arc<str>,
    subscription: u32,
    bytes: Vec<u8>,
}

/// The messages that wait for one client.
#[derive(Debug, Default)]
pub(super) struct Outbox {
    words: VecDeque<Frame>,
    words_size: usize,
    /// Messages of which only the last is needed, by the first byte, which is their kind.
    latest: BTreeMap<u8, Vec<u8>>,
    values: VecDeque<Value>,
    values_size: usize,
    /// How many values were left out since the last report to the client, by topic.
    lost: BTreeMap<Arc<str>, u64>,
    /// The same, since the client has connected.
    lost_all: u64,
    told: Option<Time>,
    is_overrun: bool,
}

impl Outbox {
    /// Adds a word.
    pub(super) fn word(&mut self, frame: Frame) {
        if self.words.len() >= WORDS_MAX || self.words_size + frame.size() > WORDS_SIZE_MAX {
            self.is_overrun = true;
            return;
        }
        self.words_size += frame.size();
        self.words.push_back(frame);
    }

    /// Adds a binary message that takes the place of an earlier one of its kind.
    pub(super) fn latest(&mut self, bytes: Vec<u8>) {
        if let Some(kind) = bytes.first() {
            self.latest.insert(*kind, bytes);
        }
    }

    /// Adds a binary message that is not left out, and drops an earlier message of a kind of which only the last is needed.
    pub(super) fn answer(&mut self, bytes: Vec<u8>) {
        if let Some(kind) = bytes.first() {
            self.latest.remove(kind);
        }
        self.word(Frame::Binary(bytes));
    }

    /// Returns whether a word found no room: the client does not know everything any more, and has to be cut off.
    pub(super) fn is_overrun(&self) -> bool {
        self.is_overrun
    }

    /// Adds a value. The oldest values make room for it.
    pub(super) fn value(&mut self, topic: &Arc<str>, subscription: u32, bytes: Vec<u8>) {
        if bytes.len() > VALUES_SIZE_MAX {
            return self.lose(topic, 1);
        }
        while self.values.len() >= VALUES_MAX || self.values_size + bytes.len() > VALUES_SIZE_MAX {
            let Some(oldest) = self.values.pop_front() else { break };
            self.values_size -= oldest.bytes.len();
            self.lose(&oldest.topic, 1);
        }
        self.values_size += bytes.len();
        self.values.push_back(Value { topic: Arc::clone(topic), subscription, bytes });
    }

    /// Counts values that were left out on the way to the client.
    pub(super) fn lose(&mut self, topic: &Arc<str>, count: u64) {
        *self.lost.entry(Arc::clone(topic)).or_default() += count;
        self.lost_all += count;
    }

    /// Drops the values of a subscription that has ended.
    pub(super) fn forget(&mut self, subscription: u32) {
        self.values.retain(|value| value.subscription != subscription);
        self.values_size = self.values.iter().map(|value| value.bytes.len()).sum();
    }

    /// Drops all values that wait, without counting them as lost.
    pub(super) fn drop_values(&mut self) {
        (self.values, self.values_size) = (VecDeque::new(), 0);
    }

    /// Returns the next message: words first, so that a client gets the announcement of a channel before its values.
    pub(super) fn next(&mut self, now: Time) -> Option<Frame> {
        if !self.lost.is_empty() && self.told.is_none_or(|told| now.since(told) >= TOLD_EVERY) {
            self.told = Some(now);
            let lost = std::mem::take(&mut self.lost);
            return Some(Frame::Text(protocol::status(Level::Warning, &words(&lost, self.lost_all))));
        }
        if let Some(word) = self.words.pop_front() {
            self.words_size -= word.size();
            return Some(word);
        }
        if let Some((_, bytes)) = self.latest.pop_last() {
            return Some(Frame::Binary(bytes));
        }
        let value = self.values.pop_front()?;
        self.values_size -= value.bytes.len();
        Some(Frame::Binary(value.bytes))
    }
}

/// Returns the sentence about losses. `ever` is how many there are since the client has connected.
fn words(lost: &BTreeMap<Arc<str>, u64>, ever: u64) -> String {
    let all: u64 = lost.values().sum();
    let mut most: Vec<(&Arc<str>, &u64)> = lost.iter().collect();
    most.sort_by_key(|(topic, count)| (std::cmp::Reverse(**count), Arc::clone(topic)));
    let named = most.iter().take(NAMED_MAX).map(|(topic, count)| format!("{count} of `{topic}`"));
    let more = if most.len() > NAMED_MAX { ", and others" } else { "" };
    let values = counted(usize::try_from(all).unwrap_or(usize::MAX), "value");
    let ever = if ever > all { format!("; {ever} since this client has connected") } else { String::new() };
    let named = named.collect::<Vec<_>>().join(", ");
    format!("{values} did not get here in time and were left out: {named}{more}{ever}")
}

#[cfg(test)]
mod tests {
    use super::*;
    use comms::logic::random::Random;

    fn at(millis: u64) -> Time {
        Time::ZERO + Duration::from_millis(millis)
    }

    fn topic(name: &str) -> Arc<str> {
        Arc::from(name)
    }

    #[test]
    fn words_go_before_values_and_losses_are_told_once_a_second() {
        let mut outbox = Outbox::default();
        let a = topic("/a");
        outbox.value(&a, 1, vec![1]);
        outbox.word(Frame::Text("word".to_owned()));
        outbox.lose(&a, 2);
        let Some(Frame::Text(told)) = outbox.next(at(0)) else { panic!("losses come first") };
        assert!(told.contains("2 values did not get here in time and were left out: 2 of `/a`"), "{told}");
        assert_eq!(outbox.next(at(0)), Some(Frame::Text("word".to_owned())));
        outbox.lose(&a, 1);
        assert_eq!(outbox.next(at(999)), Some(Frame::Binary(vec![1])));
        assert_eq!(outbox.next(at(999)), None);
        assert!(
            matches!(outbox.next(at(1000)), Some(Frame::Text(told)) if told.contains("1 value did") && told.contains("; 3 since this client has connected"))
        );
        assert_eq!(outbox.next(at(5000)), None);
    }

    #[test]
    fn of_some_messages_only_the_last_one_waits() {
        let mut outbox = Outbox::default();
        outbox.value(&topic("/a"), 1, vec![1]);
        (0..2 * WORDS_MAX).for_each(|_| outbox.latest(vec![2, 0]));
        outbox.latest(vec![5]);
        outbox.latest(vec![2, 1]);
        let got: Vec<_> = std::iter::from_fn(|| outbox.next(at(0))).collect();
        assert_eq!(got, [vec![5], vec![2, 1], vec![1]].map(Frame::Binary));
        assert!(!outbox.is_overrun());
    }

    #[test]
    fn a_client_that_takes_no_words_is_cut_off() {
        let mut outbox = Outbox::default();
        (0..WORDS_MAX).for_each(|_| outbox.word(Frame::Text("word".to_owned())));
        assert!(!outbox.is_overrun());
        outbox.word(Frame::Text("word".to_owned()));
        assert!(outbox.is_overrun());
        let mut outbox = Outbox::default();
        outbox.word(Frame::Binary(vec![0; WORDS_SIZE_MAX + 1]));
        assert!(outbox.is_overrun() && outbox.next(at(0)).is_none());
    }

    #[test]
    fn a_value_that_is_too_long_is_counted_and_takes_the_place_of_no_other() {
        let mut outbox = Outbox::default();
        outbox.value(&topic("/a"), 1, vec![1]);
        outbox.value(&topic("/b"), 2, vec![0; VALUES_SIZE_MAX + 1]);
        assert!(matches!(outbox.next(at(0)), Some(Frame::Text(told)) if told.contains("1 of `/b`")));
        assert_eq!(outbox.next(at(0)), Some(Frame::Binary(vec![1])));
    }

    /// Each value is sent in order or counted, never both, whatever the client takes and when.
    #[test]
    fn what_was_not_sent_was_counted() {
        for seed in 0..100 {
            let (mut random, mut outbox) = (Random::new(seed), Outbox::default());
            let topics = [topic("/a"), topic("/b"), topic("/c")];
            let (mut put, mut got, mut told, mut now) = ([0_u64; 3], [0_u64; 3], 0_u64, 0);
            let mut last = [None::<u64>; 3];
            let mut take = |frame: Frame| match frame {
                Frame::Binary(bytes) => {
                    let (which, number) = (usize::from(bytes[0]), u64::from_le_bytes(bytes[1..9].try_into().unwrap()));
                    assert!(last[which].is_none_or(|last| last < number), "seed {seed}");
                    last[which] = Some(number);
                    got[which] += 1;
                }
                Frame::Text(text) => {
                    let message: serde_json::Value = serde_json::from_str(&text).unwrap();
                    let words = message["message"].as_str().unwrap();
                    told += words.split(' ').next().unwrap().parse::<u64>().unwrap();
                }
            };
            for _ in 0..40 {
                for _ in 0..random.below(30) {
                    let which = usize::try_from(random.below(3)).unwrap();
                    let size = usize::try_from(random.below(1 << 17)).unwrap();
                    let mut bytes = vec![0; 9 + size];
                    bytes[0] = u8::try_from(which).unwrap();
                    bytes[1..9].copy_from_slice(&put[which].to_le_bytes());
                    put[which] += 1;
                    outbox.value(&topics[which], u32::try_from(which).unwrap(), bytes);
                }
                assert!(outbox.values_size <= VALUES_SIZE_MAX && outbox.values.len() <= VALUES_MAX, "seed {seed}");
                for _ in 0..random.below(20) {
                    outbox.next(at(now)).into_iter().for_each(&mut take);
                }
                now += random.below(400);
            }
            while let Some(frame) = outbox.next(at(now)) {
                now += 1000;
                take(frame);
            }
            assert_eq!(put.iter().sum::<u64>(), got.iter().sum::<u64>() + told, "seed {seed}");
        }
    }
}
