//! Messages for the ports of an activity. The program with these ports keeps them until the node of the activity has taken them.
//!
//! Each port has a limit. When it is exceeded, the last message in the order is dropped: the newest of the lowest priority, as in
//! the activity's own queue. At most [`HANDED_MAX`] messages are given to the node at a time, the highest priority first. The
//! node reports the fate of each. Invariant: a message with a receipt is accepted only after the node has taken it, and the node
//! takes it once.

use super::header::{MessageId, count};
use super::queue::{Receipt, Rejected};
use super::seen::{Novelty, Seen};
use crate::logic::control::{MessageFate, PortMessage};
use crate::logic::time::Time;
use std::cmp::Reverse;
use std::collections::BTreeMap;

/// The controller type of the program with the ports of an activity. Plans name it.
pub const PORTS: &str = "ActivityPorts";
/// How many messages may be given to the node before it has reported their results.
pub const HANDED_MAX: usize = 16;

/// A message for a port.
#[derive(Debug)]
pub struct Offer<R> {
    /// The number of the port.
    pub port: usize,
    /// The value, encoded.
    pub value: Vec<u8>,
    /// Messages of greater priority go first.
    pub priority: u8,
    /// The way of the receipt; none for a value of a wire.
    pub receipt: Option<Expected<R>>,
}

/// A receipt that a sender waits for.
#[derive(Debug)]
pub struct Expected<R> {
    /// The identifier of the message. A message that is sent again keeps its identifier.
    pub id: MessageId,
    /// The way of the receipt.
    pub way: R,
}

/// A receipt to give.
#[derive(Debug, PartialEq, Eq)]
pub struct Given<R> {
    /// The way of the receipt.
    pub way: R,
    /// The receipt.
    pub receipt: Receipt,
}

#[derive(Debug)]
struct Port {
    name: String,
    limit: usize,
    /// How many lost values were not yet reported to the node.
    lost: u64,
}

/// The messages of all ports of one activity.
#[derive(Debug)]
pub struct PortInbox<R> {
    ports: Vec<Port>,
    /// By priority and arrival.
    waiting: BTreeMap<(Reverse<u8>, u64), Offer<R>>,
    /// The messages that the node has, by their numbers.
    handed: BTreeMap<u64, Offer<R>>,
    seen: Seen,
    arrivals: u64,
    numbers: u64,
}

impl<R> PortInbox<R> {
    /// Returns the inbox of these ports. Each port comes with the number of messages that may wait.
    pub fn new(ports: impl IntoIterator<Item = (String, usize)>) -> Self {
        let port = |(name, limit): (String, usize)| Port { name, limit: limit.max(1), lost: 0 };
        let ports = ports.into_iter().map(port).collect();
        let (waiting, handed, seen) = (BTreeMap::new(), BTreeMap::new(), Seen::default());
        Self { ports, waiting, handed, seen, arrivals: 0, numbers: 0 }
    }

    /// Adds a message. Returns the receipts that can be given at once.
    pub fn offer(&mut self, now: Time, mut offer: Offer<R>) -> Vec<Given<R>> {
        if offer.port >= self.ports.len() {
            return Vec::new();
        }
        if let Some(Expected { id, way }) = offer.receipt.take() {
            let known = self.waiting.values_mut().chain(self.handed.values_mut());
            let same = known.filter_map(|other| other.receipt.as_mut()).find(|other| other.id == id);
            if let Some(same) = same {
                // The sender does not wait for the previous receipt any longer.
                same.way = way;
                return Vec::new();
            }
            let receipt = match self.seen.look(now, id) {
                Novelty::New => None,
                Novelty::Taken => Some(Receipt::Accepted),
                Novelty::TooOld => Some(Receipt::Rejected(Rejected::TooOld)),
                Novelty::NoRoom => Some(Receipt::Rejected(Rejected::Senders)),
            };
            match receipt {
                Some(receipt) => return vec![Given { way, receipt }],
                None => offer.receipt = Some(Expected { id, way }),
            }
        }
        self.arrivals += 1;
        let port = offer.port;
        self.waiting.insert((Reverse(offer.priority), self.arrivals), offer);
        self.give_up_last(port).into_iter().collect()
    }

    /// Drops the last message of a port that has too many.
    fn give_up_last(&mut self, port: usize) -> Option<Given<R>> {
        let limit = self.ports[port].limit;
        let mut own = self.waiting.iter().filter(|(_, offer)| offer.port == port);
        let last = *own.next_back()?.0;
        if own.count() < limit {
            return None;
        }
        let offer = self.waiting.remove(&last)?;
        let port = &mut self.ports[port];
        let Some(Expected { way, .. }) = offer.receipt else {
            port.lost += 1;
            return None;
        };
        Some(Given { way, receipt: full(limit) })
    }

    /// Counts values of a port that were lost before they arrived here.
    pub fn lose(&mut self, port: usize, count: u64) {
        if let Some(port) = self.ports.get_mut(port) {
            port.lost += count;
        }
    }

    /// Returns the next message for the node, if the node may get one more message.
    pub fn next_for_node(&mut self) -> Option<PortMessage> {
        if self.handed.len() >= HANDED_MAX {
            return None;
        }
        let (_, offer) = self.waiting.pop_first()?;
        self.numbers += 1;
        let port = &mut self.ports[offer.port];
        let message = PortMessage {
            number: self.numbers,
            port: port.name.clone(),
            value: offer.value.clone(),
            priority: offer.priority,
            has_receipt: offer.receipt.is_some(),
            lost: std::mem::take(&mut port.lost),
        };
        self.handed.insert(self.numbers, offer);
        Some(message)
    }

    /// Processes the fate of a message. Returns its receipt.
    pub fn fate(&mut self, now: Time, number: u64, fate: MessageFate) -> Option<Given<R>> {
        let Offer { port, receipt, .. } = self.handed.remove(&number)?;
        let limit = self.ports[port].limit;
        let Expected { id, way } = receipt?;
        let receipt = match fate {
            MessageFate::Taken => {
                self.seen.take(now, id);
                Receipt::Accepted
            }
            MessageFate::Full => full(limit),
            MessageFate::Idle => Receipt::Rejected(Rejected::Idle),
        };
        Some(Given { way, receipt })
    }
}

fn full(limit: usize) -> Receipt {
    Receipt::Rejected(Rejected::Full { capacity: count(limit) })
}

#[cfg(test)]
mod tests;
