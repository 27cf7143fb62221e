//! In-order, exactly-once messages between two running nodes.
//!
//! Zenoh keeps nothing for a peer that is away. So each side keeps the unacknowledged messages and sends them again
//! (go-back-N). It repeats the oldest messages, after a longer wait each time, until some are acknowledged. Then it
//! continues with the next ones.
//!
//! A link belongs to one pair of boots. When either node restarts, both sides count from 1 again, because the state
//! that the old messages refer to is gone. The same happens when one side has discarded the link, for example because
//! newer boots of that name have displaced it. Each side reports since when its link exists. If that time has become
//! later, the other side counts from 1 again. Invariant: a message is delivered once, after all earlier ones.

use crate::logic::protocol::{Body, Message};
use comms::logic::codec::{Enveloped, Kind};
use comms::logic::time::Time;
use serde::{Deserialize, Serialize};
use std::collections::VecDeque;
use std::time::Duration;

/// How long an unacknowledged message waits at least before it is sent again. On a slow line, it waits for twice the round trip.
pub(super) const RESEND_AFTER: Duration = Duration::from_millis(200);
/// The longest wait of an unacknowledged message, even after many attempts.
pub(super) const RESEND_AFTER_MAX: Duration = Duration::from_secs(5);
/// How many messages are sent again at once.
const WINDOW: usize = 64;
/// How many unacknowledged messages are kept. If there were more, the peer is considered lost.
const BACKLOG_MAX: usize = 4096;

/// A frame of a link: one message or a bare acknowledgement.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Frame {
    /// Name of the sending node.
    pub from: String,
    /// Boot number of the sender.
    pub boot: u64,
    /// Boot number of the receiver, as the sender knows it. A frame for another boot is dropped.
    pub boot_peer: u64,
    /// The two ends of the link.
    pub ends: Ends,
    /// The sender has received all messages up to this number.
    pub acknowledged: u64,
    /// A numbered message.
    pub message: Option<(u64, Message)>,
}

/// Since when each end of a link exists, on the clock of that end's node.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub struct Ends {
    /// The time of the sender's end.
    pub own: Time,
    /// The time of the receiver's end, once the sender has received it.
    pub peer: Option<Time>,
}

/// The result of receiving a frame.
#[derive(Debug, Default, PartialEq)]
pub struct Received {
    /// The message that the frame delivers.
    pub message: Option<Message>,
    /// The acknowledgement to send.
    pub answer: Option<Frame>,
    /// Whether the peer had discarded the link, which means that the peer considers this node lost.
    pub is_anew: bool,
}

impl Enveloped for Frame {
    const KIND: Kind = Kind::Frame;
}

/// The messages to and from one boot of a peer.
#[derive(Debug, Serialize, Deserialize)]
pub struct Link {
    host: String,
    boot: u64,
    boot_peer: u64,
    ends: Ends,
    sent: u64,
    received: u64,
    backlog: VecDeque<Unacknowledged>,
    /// The measured round trip of the line, if it is known.
    round_trip: Option<Duration>,
    /// How long this node waits for the next acknowledgement.
    patience: Duration,
    resend_at: Option<Time>,
    /// The last message that had been sent when a resend became necessary, and the last message that was sent again.
    recovering: (u64, u64),
    /// Whether the peer is considered lost: then only one message at a time is sent again.
    lost: bool,
}

/// A message that the peer has not acknowledged.
#[derive(Debug, Serialize, Deserialize)]
struct Unacknowledged {
    number: u64,
    message: Message,
    /// When the message was sent for the first time. Nothing after it was sent again, since then it is unknown which
    /// copy is acknowledged.
    sent: Option<Time>,
}

impl Link {
    /// Returns a fresh link of node `host`, booted as `boot`, to a peer booted as `boot_peer`.
    pub fn new(now: Time, host: &str, boot: u64, boot_peer: u64) -> Self {
        let host = host.to_owned();
        Self {
            host,
            boot,
            boot_peer,
            ends: Ends { own: now, peer: None },
            sent: 0,
            received: 0,
            backlog: VecDeque::new(),
            round_trip: None,
            patience: RESEND_AFTER,
            resend_at: None,
            recovering: (0, 0),
            lost: false,
        }
    }

    /// Returns the boot number of the peer.
    pub fn boot_peer(&self) -> u64 {
        self.boot_peer
    }

    /// Takes a message to deliver. The returned frame has to be sent at once. Returns nothing if too many messages are unacknowledged.
    pub fn send(&mut self, now: Time, message: Message) -> Option<Frame> {
        if self.backlog.len() >= BACKLOG_MAX {
            return None;
        }
        self.sent += 1;
        self.backlog.push_back(Unacknowledged { number: self.sent, message: message.clone(), sent: Some(now) });
        self.resend_at.get_or_insert(now + self.patience);
        Some(self.frame(Some((self.sent, message))))
    }

    /// Drops the messages that have not arrived: the peer is considered lost, and must not act on them when it returns.
    /// Final messages are kept, because a peer that has not lost this node waits for them. Until the peer is reached
    /// again, only one message at a time is sent again.
    pub fn abandon(&mut self) {
        self.lost = true;
        let others = self.backlog.iter_mut().map(|kept| &mut kept.message).filter(|message| !message.is_final());
        others.for_each(|message| message.body = Body::Tombstone);
    }

    /// Notes that the peer can be reached again: the unacknowledged messages are sent at once.
    pub fn reached(&mut self, now: Time) {
        self.lost = false;
        self.patience = self.patience_first();
        if !self.backlog.is_empty() {
            self.resend_at = Some(now);
        }
    }

    /// Takes a frame of the peer.
    pub fn receive(&mut self, now: Time, frame: Frame) -> Received {
        let is_old = self.ends.peer.is_some_and(|known| frame.ends.own < known);
        if frame.boot != self.boot_peer || frame.boot_peer != self.boot || is_old {
            return Received::default();
        }
        if frame.ends.peer.is_some_and(|own| own != self.ends.own) {
            // The frame belongs to the previous link, which had its own message numbers.
            return Received { answer: Some(self.frame(None)), ..Received::default() };
        }
        let is_anew = self.ends.peer.replace(frame.ends.own).is_some_and(|known| known < frame.ends.own);
        if is_anew {
            self.begin_anew(now);
        }
        self.acknowledged(now, frame.acknowledged);
        let Some((number, message)) = frame.message else { return Received { is_anew, ..Received::default() } };
        let message = (number == self.received + 1).then(|| {
            self.received = number;
            message
        });
        Received { message, answer: Some(self.frame(None)), is_anew }
    }

    /// Starts to count from 1 again. The peer has lost this node. So of the unacknowledged messages, it gets only the final ones.
    fn begin_anew(&mut self, now: Time) {
        self.backlog.retain(|kept| kept.message.is_final());
        (self.sent, self.received, self.recovering) = (0, 0, (0, 0));
        for kept in &mut self.backlog {
            self.sent += 1;
            (kept.number, kept.sent) = (self.sent, None);
        }
        self.resend_at = (!self.backlog.is_empty()).then_some(now);
    }

    fn acknowledged(&mut self, now: Time, acknowledged: u64) {
        let mut progress = false;
        while self.backlog.front().is_some_and(|kept| kept.number <= acknowledged)
            && let Some(kept) = self.backlog.pop_front()
        {
            progress = true;
            if let Some(sent) = kept.sent {
                let took = now - sent;
                self.round_trip = Some(self.round_trip.map_or(took, |before| (before * 7 + took) / 8));
            }
        }
        let Some(oldest) = self.backlog.front().map(|kept| kept.number) else {
            (self.patience, self.resend_at) = (self.patience_first(), None);
            return;
        };
        if progress {
            self.patience = self.patience_first();
            let (sent_before, sent_again) = self.recovering;
            // The peer has dropped all frames after a gap. These frames are sent again as soon as the gap is filled.
            let next_round = oldest <= sent_before && acknowledged >= sent_again;
            self.resend_at = Some(if next_round { now } else { now + self.patience });
        }
    }

    fn patience_first(&self) -> Duration {
        self.round_trip.map_or(RESEND_AFTER, |took| (took * 2).clamp(RESEND_AFTER, RESEND_AFTER_MAX))
    }

    /// Returns the frames that are due to be sent again.
    pub fn resend(&mut self, now: Time) -> Vec<Frame> {
        if self.resend_at.is_none_or(|at| at > now) {
            return Vec::new();
        }
        self.resend_at = Some(now + self.patience);
        self.patience = (self.patience * 2).min(RESEND_AFTER_MAX);
        let count = if self.lost { 1 } else { WINDOW };
        let mut again = Vec::new();
        for kept in self.backlog.iter_mut().take(count) {
            kept.sent = None;
            again.push((kept.number, kept.message.clone()));
        }
        self.recovering = (self.sent, again.last().map_or(0, |(number, _)| *number));
        again.into_iter().map(|message| self.frame(Some(message))).collect()
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
            ends: self.ends,
            acknowledged: self.received,
            message,
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::logic::protocol::{Deployment, ToParticipant};

    fn numbered(epoch: u64) -> Message {
        Deployment { name: "d".into(), epoch }.to_participant(ToParticipant::Go)
    }

    fn pair() -> (Link, Link) {
        (Link::new(Time::ZERO, "a", 1, 2), Link::new(Time::ZERO, "b", 2, 1))
    }

    /// Two ends exchange messages over a line that loses, repeats and swaps frames as a seeded generator says.
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
            let (mut a, mut b) = pair();
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
                        let Received { message, answer, .. } = b.receive(now, frame.clone());
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

    /// The first resends in a minute come quickly, since the line may have lost only one frame. Later resends are rare.
    #[test]
    fn a_peer_that_does_not_answer_is_not_flooded() {
        for (lost, most) in [(false, 20 * WINDOW), (true, 20)] {
            let mut link = Link::new(Time::ZERO, "a", 1, 2);
            (1..=1000).for_each(|number| drop(link.send(Time::ZERO, numbered(number))));
            if lost {
                link.abandon();
            }
            let (mut frames, mut first) = (0, None);
            while let Some(at) = link.deadline().filter(|at| *at < Time::ZERO + Duration::from_secs(60)) {
                first.get_or_insert(at);
                frames += link.resend(at).len();
            }
            assert!(frames <= most && frames >= 10, "lost: {lost}, {frames} frames");
            assert_eq!(first, Some(Time::ZERO + RESEND_AFTER));
            let back = Time::ZERO + Duration::from_secs(60);
            link.reached(back);
            assert_eq!(link.resend(back).len(), WINDOW, "when it is there again, it is told at once");
        }
    }

    /// A line of 50 ms each way was cut. Afterwards, all messages arrive as soon as possible, and each message is sent again once.
    #[test]
    fn a_long_backlog_comes_window_by_window() {
        let (mut a, mut b) = pair();
        (1..=1000).for_each(|number| drop(a.send(Time::ZERO, numbered(number))));
        let mut now = Time::ZERO + Duration::from_secs(3);
        let (mut got, mut frames, began) = (0, 0, now);
        a.reached(now);
        while got < 1000 {
            let window = a.resend(now);
            frames += window.len();
            now = now + Duration::from_millis(50);
            let answers = window.into_iter().filter_map(|frame| {
                let Received { message, answer, .. } = b.receive(now, frame);
                got += usize::from(message.is_some());
                answer
            });
            let answers: Vec<Frame> = answers.collect();
            now = now + Duration::from_millis(50);
            answers.into_iter().for_each(|answer| drop(a.receive(now, answer)));
        }
        assert_eq!((frames, now - began), (1000, Duration::from_millis(1600)));
    }

    /// A message is sent again only after twice the round trip, so a slow line does not carry everything twice.
    #[test]
    fn a_slow_line_is_waited_for() {
        let (mut a, mut b) = pair();
        let at = |millis| Time::ZERO + Duration::from_millis(millis);
        let frame = a.send(at(0), numbered(1)).unwrap();
        let Received { answer, .. } = b.receive(at(500), frame);
        a.receive(at(1000), answer.unwrap());
        drop(a.send(at(2000), numbered(2)));
        assert_eq!(a.deadline(), Some(at(4000)));
    }

    #[test]
    fn ignores_frames_of_another_boot() {
        let (mut a, mut b) = (Link::new(Time::ZERO, "a", 1, 2), Link::new(Time::ZERO, "b", 3, 1));
        let frame = a.send(Time::ZERO, numbered(1)).unwrap();
        assert_eq!(b.receive(Time::ZERO, frame), Received::default());
    }

    /// One side discards the link once, over a line that loses, repeats and delays frames. Both sides recover:
    /// later messages arrive in order and once, and the other side loses no final message.
    #[test]
    fn a_link_that_one_side_has_forgotten_begins_anew() {
        for seed in 0..500_u64 {
            let mut random = seed.wrapping_mul(0x9E37_79B9_7F4A_7C15) | 1;
            let mut draw = move |below: u64| {
                random ^= random << 13;
                random ^= random >> 7;
                random ^= random << 17;
                random % below
            };
            let (mut a, mut b) = pair();
            let (mut lines, mut got) = ([Vec::new(), Vec::new()], Vec::new());
            let (mut now, mut sent, mut anew) = (Time::ZERO, 0, 0);
            let forgets = 20 + draw(100);
            for step in 0..1500 {
                now = now + Duration::from_millis(50);
                if step == forgets {
                    b = Link::new(now, "b", 2, 1);
                    // Earlier deliveries are not compared.
                    got.clear();
                }
                // The last message is sent when both ends have found each other again.
                if draw(3) == 0 && step < 300 || step == 400 {
                    sent += 1;
                    lines[1].extend(a.send(now, numbered(sent)));
                }
                lines[1].extend(a.resend(now));
                lines[0].extend(b.resend(now));
                if draw(4) == 0 {
                    lines[0].extend(b.send(now, numbered(1000 + step)));
                }
                for to in [0, 1] {
                    for _ in 0..lines[to].len() {
                        let at = usize::try_from(draw(u64::try_from(lines[to].len()).unwrap())).unwrap();
                        // The frame is repeated, lost, or neither.
                        let frame = if draw(4) == 0 { lines[to][at].clone() } else { lines[to].swap_remove(at) };
                        if draw(5) == 0 {
                            continue;
                        }
                        let received = if to == 0 { a.receive(now, frame) } else { b.receive(now, frame) };
                        lines[1 - to].extend(received.answer);
                        anew += u64::from(received.is_anew);
                        assert!(to == 0 || !received.is_anew, "seed {seed}: `a` has forgotten nothing");
                        got.extend(received.message.filter(|_| to == 1));
                    }
                }
            }
            let numbers: Vec<u64> = got.iter().map(|message: &Message| message.deployment.epoch).collect();
            assert!(numbers.is_sorted_by(|a, b| a < b), "seed {seed}: {numbers:?}");
            assert_eq!((anew, numbers.last()), (1, Some(&sent)), "seed {seed}: {numbers:?}");
        }
        let (mut a, mut b) = pair();
        let release = || Deployment { name: "d".into(), epoch: 7 }.to_participant(ToParticipant::Release);
        let first = b.receive(Time::ZERO, a.send(Time::ZERO, numbered(1)).unwrap());
        a.receive(Time::ZERO, first.answer.unwrap());
        drop((a.send(Time::ZERO, numbered(2)), a.send(Time::ZERO, release())));
        let later = Time::ZERO + Duration::from_secs(1);
        b = Link::new(later, "b", 2, 1);
        assert!(a.receive(later, b.send(later, numbered(3)).unwrap()).is_anew);
        let again = a.resend(later);
        assert_eq!(again.len(), 1);
        assert_eq!(b.receive(later, again[0].clone()).message, Some(release()));
    }
}
