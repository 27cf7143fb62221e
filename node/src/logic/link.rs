//! In-order, exactly-once messages between two running nodes.
//!
//! Zenoh keeps nothing for a peer that is away, so each side keeps what the other has not acknowledged and sends it
//! again (go-back-N). A link belongs to one pair of boots: when either node restarts, both sides begin anew at 1, because
//! the state that the old messages spoke of is gone. Invariant: a message is delivered once, after all earlier ones.

use crate::logic::protocol::{Body, Message, VERSION};
use comms::logic::codec::Enveloped;
use comms::logic::time::Time;
use serde::{Deserialize, Serialize};
use std::collections::VecDeque;
use std::time::Duration;

/// How long an unacknowledged message waits before it is sent again.
const RESEND_AFTER: Duration = Duration::from_millis(200);
/// How many unacknowledged messages are kept; past that the peer counts as lost.
const BACKLOG_MAX: usize = 4096;

/// What travels: one message or a bare acknowledgement.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Frame {
    /// Name of the sending node.
    pub from: String,
    /// Boot number of the sender.
    pub boot: u64,
    /// Boot number of the receiver, as the sender knows it; a frame for another boot is dropped.
    pub boot_peer: u64,
    /// All messages up to this number have arrived at the sender.
    pub acknowledged: u64,
    /// A numbered message.
    pub message: Option<(u64, Message)>,
}

impl Enveloped for Frame {
    const KIND: u16 = 100;
    const VERSION: u16 = VERSION;
}

/// One direction-pair to one boot of a peer.
#[derive(Debug)]
pub struct Link {
    host: String,
    boot: u64,
    boot_peer: u64,
    sent: u64,
    received: u64,
    backlog: VecDeque<(u64, Message)>,
    resend_at: Option<Time>,
}

impl Link {
    /// Returns a fresh link of node `host`, booted as `boot`, to a peer booted as `boot_peer`.
    pub fn new(host: &str, boot: u64, boot_peer: u64) -> Self {
        let host = host.to_owned();
        Self { host, boot, boot_peer, sent: 0, received: 0, backlog: VecDeque::new(), resend_at: None }
    }

    /// Returns the boot number of the peer.
    pub fn boot_peer(&self) -> u64 {
        self.boot_peer
    }

    /// Takes a message to deliver; the returned frame goes out at once. None when the backlog is full.
    pub fn send(&mut self, now: Time, message: Message) -> Option<Frame> {
        if self.backlog.len() >= BACKLOG_MAX {
            return None;
        }
        self.sent += 1;
        self.backlog.push_back((self.sent, message.clone()));
        self.resend_at.get_or_insert(now + RESEND_AFTER);
        Some(self.frame(Some((self.sent, message))))
    }

    /// Empties the messages that have not arrived: the peer counts as lost, and must not act on them when it is back. What is
    /// final stays: a peer that has not lost this node waits for it.
    pub fn abandon(&mut self) {
        let others = self.backlog.iter_mut().map(|(_, message)| message).filter(|message| !message.is_final());
        others.for_each(|message| message.body = Body::Void);
    }

    /// Takes a frame of the peer. Returns the message it delivers, if any, and the acknowledgement to send, if any.
    pub fn receive(&mut self, now: Time, frame: Frame) -> (Option<Message>, Option<Frame>) {
        if frame.boot != self.boot_peer || frame.boot_peer != self.boot {
            return (None, None);
        }
        while self.backlog.front().is_some_and(|(number, _)| *number <= frame.acknowledged) {
            self.backlog.pop_front();
            self.resend_at = Some(now + RESEND_AFTER);
        }
        if self.backlog.is_empty() {
            self.resend_at = None;
        }
        let Some((number, message)) = frame.message else { return (None, None) };
        let delivered = (number == self.received + 1).then(|| {
            self.received = number;
            message
        });
        (delivered, Some(self.frame(None)))
    }

    /// Returns what has to be sent again by now.
    pub fn resend(&mut self, now: Time) -> Vec<Frame> {
        if self.resend_at.is_none_or(|at| at > now) {
            return Vec::new();
        }
        self.resend_at = Some(now + RESEND_AFTER);
        self.backlog.iter().map(|entry| self.frame(Some(entry.clone()))).collect()
    }

    /// Returns when [`Link::resend`] wants to be called.
    pub fn deadline(&self) -> Option<Time> {
        self.resend_at
    }

    fn frame(&self, message: Option<(u64, Message)>) -> Frame {
        Frame {
            from: self.host.clone(),
            boot: self.boot,
            boot_peer: self.boot_peer,
            acknowledged: self.received,
            message,
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::logic::protocol::{Deployment, ToTenant};

    fn numbered(epoch: u64) -> Message {
        Deployment { name: "d".into(), epoch }.to_tenant(ToTenant::Go)
    }

    /// A pair of links over a line that loses, repeats and swaps frames as a seeded generator says.
    #[test]
    fn delivers_in_order_and_once_over_a_bad_line() {
        for seed in 0..200_u64 {
            let mut random = seed.wrapping_mul(0x9E37_79B9_7F4A_7C15) | 1;
            let mut next = move || {
                random ^= random << 13;
                random ^= random >> 7;
                random ^= random << 17;
                random
            };
            let (mut a, mut b) = (Link::new("a", 1, 2), Link::new("b", 2, 1));
            let (mut to_a, mut to_b, mut got) = (Vec::new(), Vec::new(), Vec::new());
            let mut now = Time::ZERO;
            let mut sent = 0;
            while got.len() < 30 {
                now = now + Duration::from_millis(50);
                if sent < 30 {
                    sent += 1;
                    to_b.extend(a.send(now, numbered(sent)));
                }
                to_b.extend(a.resend(now));
                to_a.extend(b.resend(now));
                while let Some(frame) = to_b.pop() {
                    if next() % 3 == 0 {
                        continue;
                    }
                    for _ in 0..=next() % 2 {
                        let (message, answer) = b.receive(now, frame.clone());
                        got.extend(message);
                        to_a.extend(answer);
                    }
                }
                while let Some(frame) = to_a.pop() {
                    if next() % 3 != 0 {
                        a.receive(now, frame);
                    }
                }
                assert!(now < Time::ZERO + Duration::from_secs(600), "seed {seed}: stuck at {}", got.len());
            }
            let expected = (1..=30).map(numbered).collect::<Vec<_>>();
            assert_eq!(got, expected, "seed {seed}");
        }
    }

    #[test]
    fn ignores_frames_of_another_boot() {
        let (mut a, mut b) = (Link::new("a", 1, 2), Link::new("b", 3, 1));
        let frame = a.send(Time::ZERO, numbered(1)).unwrap();
        assert_eq!(b.receive(Time::ZERO, frame), (None, None));
    }
}
