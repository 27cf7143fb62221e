//! The network of a simulated team: it delays, loses, repeats, reorders and slows messages, separately in each
//! direction.

use comms::logic::random::Random;
use comms::logic::time::Time;
use dbmanager::logic::message::Message;
use dbmanager::logic::version_vector::ReplicaId;
use std::collections::{BTreeMap, BTreeSet};
use std::rc::Rc;
use std::time::Duration;

/// The most bytes that wait for a slow radio. Further messages are dropped, as zenoh does under congestion.
const QUEUE_SIZE_MAX: u64 = 256 << 10;
/// The shortest and the longest delay in microseconds. They differ so much that messages overtake each other.
const LATENCY_US: [u64; 2] = [200, 80_000];

/// A message in transit.
#[derive(Debug)]
pub(crate) struct Envelope {
    pub(crate) to: usize,
    /// The sender as the receiver knows it.
    pub(crate) from: ReplicaId,
    pub(crate) message: Rc<Message>,
}

/// Radios, the links between them, and the messages in transit.
#[derive(Debug)]
pub(crate) struct Network {
    random: Random,
    /// Messages lost, in percent.
    pub(crate) drop: u64,
    /// Messages delivered twice, in percent.
    pub(crate) duplicate: u64,
    /// Messages with more bytes are always lost.
    pub(crate) size_max: usize,
    /// The number of bytes that were sent, including lost ones.
    pub(crate) sent: u64,
    /// The shortest and the longest delay, in microseconds.
    pub(crate) latency_us: [u64; 2],
    /// The longest time for which a message has occupied a slow radio, including the messages before it. All other
    /// messages wait for that long.
    pub(crate) occupied_max: Duration,
    /// The directions in which all messages are lost.
    cut: BTreeSet<(usize, usize)>,
    /// Bytes per second of slow radios.
    radios: BTreeMap<usize, u64>,
    /// Until when the line between two robots is busy.
    queues: BTreeMap<(usize, usize), Time>,
    /// How long a slow robot takes for each message, and until when it is busy.
    slow: BTreeMap<usize, (Duration, Time)>,
    mail: BTreeMap<(Time, u64), Envelope>,
    posted: u64,
}

impl Network {
    /// Returns a network in which all robots receive each other's messages.
    pub(crate) fn new(seed: u64) -> Self {
        Self {
            random: Random::new(seed),
            drop: 0,
            duplicate: 0,
            size_max: usize::MAX,
            sent: 0,
            latency_us: LATENCY_US,
            occupied_max: Duration::ZERO,
            cut: BTreeSet::new(),
            radios: BTreeMap::new(),
            queues: BTreeMap::new(),
            slow: BTreeMap::new(),
            mail: BTreeMap::new(),
            posted: 0,
        }
    }

    /// Loses all messages from `from` to `to`.
    pub(crate) fn cut_one_way(&mut self, from: usize, to: usize) {
        self.cut.insert((from, to));
    }

    /// Lets messages through again, in both directions.
    pub(crate) fn heal(&mut self, a: usize, b: usize) {
        self.cut.remove(&(a, b));
        self.cut.remove(&(b, a));
    }

    /// Mends all links of a robot.
    pub(crate) fn heal_all_of(&mut self, node: usize) {
        self.cut.retain(|(from, to)| *from != node && *to != node);
    }

    /// Repairs everything: links, radios, slow robots.
    pub(crate) fn mend(&mut self) {
        self.cut.clear();
        self.radios.clear();
        self.slow.clear();
    }

    /// Limits the radio of a robot to this rate.
    pub(crate) fn choke(&mut self, node: usize, bytes_per_second: u64) {
        self.radios.insert(node, bytes_per_second.max(1));
    }

    /// Makes a robot take this long for each received message.
    pub(crate) fn slow_down(&mut self, node: usize, each: Duration) {
        self.slow.insert(node, (each, Time::ZERO));
    }

    /// Returns when the next message arrives.
    pub(crate) fn next(&self) -> Option<Time> {
        self.mail.first_key_value().map(|((at, _), _)| *at)
    }

    /// Takes the next message.
    pub(crate) fn take(&mut self) -> Option<Envelope> {
        self.mail.pop_first().map(|(_, envelope)| envelope)
    }

    /// Sends a message.
    pub(crate) fn post(&mut self, now: Time, (sender, from): (usize, ReplicaId), to: usize, message: &Rc<Message>) {
        if self.cut.contains(&(sender, to)) {
            return;
        }
        let Some(sent) = self.transmit(now, (sender, to), message) else { return };
        let copies = if self.random.below(100) < self.duplicate { 2 } else { 1 };
        for _ in 0..copies {
            if self.random.below(100) < self.drop {
                continue;
            }
            let [shortest, longest] = self.latency_us;
            let way = shortest + self.random.below(longest - shortest);
            let mut at = sent + Duration::from_micros(way);
            if let Some((each, until)) = self.slow.get_mut(&to) {
                at = at.max(*until) + *each;
                *until = at;
            }
            self.posted += 1;
            let envelope = Envelope { to, from, message: Rc::clone(message) };
            self.mail.insert((at, self.posted), envelope);
        }
    }

    /// Returns when the last byte is sent; `None` if the message is dropped.
    fn transmit(&mut self, now: Time, link: (usize, usize), message: &Message) -> Option<Time> {
        let radios = [link.0, link.1].map(|node| self.radios.get(&node).copied());
        let rate = radios.into_iter().flatten().min();
        if rate.is_none() && self.size_max == usize::MAX {
            return Some(now);
        }
        let size = size(message);
        self.sent += size as u64;
        if size > self.size_max {
            return None;
        }
        let Some(rate) = rate else { return Some(now) };
        let free = self.queues.entry(link).or_default();
        let waiting = (*free).max(now);
        let queued = waiting.since(now).as_nanos() * u128::from(rate) / 1_000_000_000;
        if queued > u128::from(QUEUE_SIZE_MAX) {
            return None;
        }
        *free = waiting + Duration::from_nanos(size as u64 * 1_000_000_000 / rate);
        self.occupied_max = self.occupied_max.max(free.since(now));
        Some(*free)
    }
}

/// Returns the size of a message on the wire in bytes, without its envelope.
pub(crate) fn size(message: &Message) -> usize {
    postcard::experimental::serialized_size(message).expect("messages have a size")
}
