//! The seals on messages between programs of a team. A seal is sent as an attachment of its message. `comms::io::data`
//! makes and opens seals.
//!
//! Zenoh does not report over which link a message has come, and a program that is linked for one wire could send on
//! any other wire. So messages over a wire are sealed with a key that only its two ends have. The consumer drops
//! messages without a valid seal, messages sealed with another key, and repeated messages.

use super::codec::{Enveloped, Kind};
use super::time::Time;
use serde::{Deserialize, Serialize};
use std::collections::BTreeMap;
use std::time::Duration;
use thiserror::Error;

/// The length of a tag in bytes. Source: RFC 8439, section 2.8.
pub const TAG_SIZE: usize = 16;
/// The shortest time between two reports of the refusals on one wire.
pub const TELL_EVERY: Duration = Duration::from_secs(60);
/// How long a restart of the other program may explain a message that is sealed with another key.
/// One end may learn of the restart later than the other end. Only afterwards is the message
/// reported.
pub const OTHER_KEY_WITHIN: Duration = Duration::from_secs(10);
/// The most wires of a program whose refusals are reported.
const WIRES_MAX: usize = 256;

/// Used instead of the number of a wire for a call of a program that may not call.
pub const NO_WIRE: u32 = u32::MAX;
/// Used instead of the number of a wire for a sample of a device.
pub const DEVICE: u32 = u32::MAX - 1;
/// Used instead of the number of a wire for a link of a program that has no wire.
pub const LINK: u32 = u32::MAX - 2;

/// The kind of a sealed message.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub enum Content {
    /// A value of a wire.
    Value,
    /// A [`Boundary`](crate::logic::switch::Boundary) between values.
    Boundary,
    /// An answer to a fetch.
    Answer,
    /// A call of a program's export.
    Call,
    /// The caller of a call does not wait any longer.
    Cancel,
    /// A sample of a device, which every program can read.
    Device,
}

/// The attachment of a sealed message.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub struct Seal {
    /// The kind of message.
    pub content: Content,
    /// Names the key; no secret.
    pub key: u32,
    /// The number of the message among all messages that the program has sealed since its start. Each number is used
    /// once.
    pub number: u64,
    /// The tag, which shows that nothing was changed.
    pub tag: [u8; TAG_SIZE],
}

/// The attachment of a sample for several programs: one seal for each.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub struct Seals {
    /// The seals, in any order. Each names its key.
    pub seals: Vec<Seal>,
}

impl Enveloped for Seals {
    const KIND: Kind = Kind::Seals;
    const SIZE_MAX: usize = 64 << 10;
}

impl Enveloped for Seal {
    const KIND: Kind = Kind::Seal;
    const SIZE_MAX: usize = 64;
}

/// Why a message over a wire of a team was dropped.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Serialize, Deserialize, Error)]
pub enum Refusal {
    /// The message has no seal.
    #[error("it is not sealed")]
    Unsealed,
    /// The message is not sealed with the key of the wire.
    #[error("it is sealed with the key of another program")]
    OtherKey,
    /// The message, or a later one, has already come.
    #[error("this message, or a later message, was already received")]
    Repeated,
    /// The message was changed, or belongs to another wire.
    #[error("its seal is broken")]
    Broken,
    /// The signer is not a visitor from the team.
    #[error("no node of the team vouches for its signer")]
    Stranger,
    /// A program without a wire to this program tries to link.
    #[error("it has no wire with this program")]
    NoWire,
    /// A visitor with only the right to look calls a procedure.
    #[error("no user has signed it")]
    Unsigned,
}

/// The refusals of a program on one of its wires.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub struct Refused {
    /// Number of the wire in the plan.
    pub wire: u32,
    /// How many messages were refused since the last report.
    pub count: u64,
    /// The reason of the last refusal.
    pub why: Refusal,
    /// The session that the last refused message claims to come from, if it names a session. For a
    /// refused link, the name of its owner for people.
    pub from: Option<String>,
}

/// The refusals of a program that are not yet reported.
#[derive(Debug, Default)]
pub struct Refusals(BTreeMap<u32, OfWire>);

#[derive(Debug, Default)]
struct OfWire {
    told: Option<Time>,
    news: Option<Refused>,
    /// Refusals of messages that were sealed with another key, and when these began.
    other: Option<(Time, Refused)>,
}

impl Refusals {
    /// Notes that a message was refused.
    pub fn note(&mut self, now: Time, wire: u32, why: Refusal, from: Option<String>) {
        if self.0.len() >= WIRES_MAX && !self.0.contains_key(&wire) {
            return;
        }
        let of_wire = self.0.entry(wire).or_default();
        let new = || Refused { wire, count: 0, why, from: None };
        let refused = if why == Refusal::OtherKey {
            &mut of_wire.other.get_or_insert_with(|| (now, new())).1
        } else {
            of_wire.news.get_or_insert_with(new)
        };
        (refused.count, refused.why, refused.from) = (refused.count.saturating_add(1), why, from);
    }

    /// Notes that the other end of a wire has a new key. So the messages that were sealed with an unknown key came
    /// from it.
    pub fn changed(&mut self, wire: u32) {
        self.0.entry(wire).and_modify(|of_wire| of_wire.other = None);
    }

    /// Returns the time of the next report.
    pub fn deadline(&self) -> Option<Time> {
        self.0.values().filter_map(OfWire::deadline).min()
    }

    /// Returns the refusals to be reported now: at most once a minute for each wire.
    pub fn take(&mut self, now: Time) -> Vec<Refused> {
        let due = self.0.values_mut().filter(|of_wire| of_wire.deadline().is_some_and(|due| due <= now));
        let told = due.filter_map(|of_wire| {
            of_wire.told = Some(now);
            let other = of_wire.other.take_if(|(since, _)| *since + OTHER_KEY_WITHIN <= now).map(|(_, other)| other);
            let news = of_wire.news.take();
            let both = news.iter().chain(&other).fold(0_u64, |count, refused| count.saturating_add(refused.count));
            news.or(other).map(|refused| Refused { count: both, ..refused })
        });
        told.collect()
    }
}

impl OfWire {
    fn deadline(&self) -> Option<Time> {
        let news = self.news.is_some().then_some(Time::ZERO);
        let other = self.other.as_ref().map(|(since, _)| *since + OTHER_KEY_WITHIN);
        let due = news.into_iter().chain(other).min()?;
        Some(self.told.map_or(due, |told| due.max(told + TELL_EVERY)))
    }
}

#[cfg(test)]
mod tests {
    use super::super::codec::{decode, encode};
    use super::*;

    /// Bytes that other versions send and read.
    #[test]
    fn golden_seal() {
        let seal = Seal { content: Content::Boundary, key: 300, number: 300, tag: [7; TAG_SIZE] };
        let bytes = encode(&seal).unwrap();
        assert_eq!(bytes, [&b"DC\x01\x00\x1a\x00\x01\xac\x02\xac\x02"[..], &[7; 16]].concat());
        assert_eq!(decode::<Seal>(&bytes), Ok(seal));
        let bytes = encode(&Seals { seals: vec![seal] }).unwrap();
        assert_eq!(bytes, [&b"DC\x01\x00\x1b\x00\x01\x01\xac\x02\xac\x02"[..], &[7; 16]].concat());
    }

    fn at(seconds: u64) -> Time {
        Time::from_nanos(seconds * 1_000_000_000)
    }

    #[test]
    fn a_wire_tells_once_a_minute() {
        let mut refusals = Refusals::default();
        assert_eq!((refusals.deadline(), refusals.take(at(0))), (None, vec![]));
        refusals.note(at(1), 3, Refusal::Unsealed, None);
        refusals.note(at(1), 3, Refusal::Broken, Some("a1".to_owned()));
        let refused = |count| Refused { wire: 3, count, why: Refusal::Broken, from: Some("a1".to_owned()) };
        assert_eq!(refusals.deadline(), Some(Time::ZERO));
        assert_eq!(refusals.take(at(1)), [refused(2)]);
        for second in 2..100 {
            refusals.note(at(second), 3, Refusal::Broken, Some("a1".to_owned()));
            let told = refusals.take(at(second));
            assert_eq!(told, if second == 61 { vec![refused(60)] } else { vec![] }, "{second}");
        }
        assert_eq!(refusals.deadline(), Some(at(121)));
    }

    #[test]
    fn another_key_is_nothing_to_be_told_of_if_the_other_end_has_changed() {
        let mut refusals = Refusals::default();
        refusals.note(at(1), 3, Refusal::OtherKey, None);
        assert_eq!((refusals.deadline(), refusals.take(at(1))), (Some(at(11)), vec![]));
        refusals.changed(3);
        assert_eq!(refusals.take(at(20)), []);
        refusals.note(at(20), 3, Refusal::OtherKey, None);
        refusals.note(at(25), 3, Refusal::OtherKey, None);
        assert_eq!(refusals.take(at(29)), []);
        assert_eq!(refusals.take(at(30)), [Refused { wire: 3, count: 2, why: Refusal::OtherKey, from: None }]);
        assert_eq!(refusals.deadline(), None);
    }
}
