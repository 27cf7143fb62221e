//! The messages that were taken, so that a repeated message is taken only once.
//!
//! For each sender there is a window over its last numbers, as IPsec has it against replays (RFC 6479). A number below
//! the window is refused, because it is unknown whether it was taken. A sender is forgotten only when it has been
//! silent for longer than any sender repeats a message. While all places are taken by active senders, a new sender is
//! refused.

use super::header::MessageId;
use crate::logic::time::Time;
use std::collections::{BTreeMap, VecDeque};
use std::time::Duration;

/// The size of the window over a sender's numbers.
pub(super) const WINDOW: u64 = 1024;
/// How many senders are remembered.
pub(super) const SENDERS_MAX: usize = 1024;
/// After this silence a sender may be forgotten. It is longer than any deadline of a send.
pub(super) const SILENCE: Duration = Duration::from_secs(60);
const WORD: u64 = 64;

/// Whether a message may be taken.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Novelty {
    /// The message was not taken before.
    New,
    /// The message was taken before.
    Taken,
    /// It is unknown whether the message was taken: its number is below the window.
    TooOld,
    /// No place is free for the sender of the message.
    NoRoom,
}

/// The senders of one queue.
#[derive(Clone, Debug, Default)]
pub(super) struct Seen {
    senders: BTreeMap<u64, Sender>,
}

#[derive(Clone, Debug)]
struct Sender {
    /// The greatest number.
    newest: u64,
    /// One bit for each number, from `newest` down, in words of 64 bits. Bit 0 of word 0 is a multiple of 64.
    words: VecDeque<u64>,
    heard: Time,
}

impl Seen {
    /// Looks up a message without noting it as taken. Its sender no longer counts as silent.
    pub(super) fn look(&mut self, now: Time, id: MessageId) -> Novelty {
        if let Some(sender) = self.senders.get_mut(&id.life) {
            sender.heard = now;
            return sender.look(id.number);
        }
        if self.senders.len() < SENDERS_MAX || self.forget_one(now) { Novelty::New } else { Novelty::NoRoom }
    }

    /// Notes that a message was taken.
    pub(super) fn take(&mut self, now: Time, id: MessageId) {
        let sender = self.senders.entry(id.life).or_insert_with(|| Sender::new(id.number, now));
        sender.heard = now;
        sender.take(id.number);
    }

    /// Makes room by forgetting a silent sender. Senders are searched only for this.
    fn forget_one(&mut self, now: Time) -> bool {
        let silent = self.senders.iter().min_by_key(|(_, sender)| sender.heard);
        let silent = silent.filter(|(_, sender)| now.since(sender.heard) > SILENCE).map(|(&life, _)| life);
        silent.is_some_and(|life| self.senders.remove(&life).is_some())
    }
}

impl Sender {
    fn new(newest: u64, heard: Time) -> Self {
        let words = usize::try_from(WINDOW / WORD + 1).expect("a small number");
        Self { newest, words: std::iter::repeat_n(0, words).collect(), heard }
    }

    /// Returns the word and the bit of a number up to the newest one; none if the number is below the window.
    fn place(&self, number: u64) -> Option<(usize, u64)> {
        let back = (self.newest / WORD).checked_sub(number / WORD)?;
        let word = usize::try_from(back).ok().filter(|&word| word < self.words.len())?;
        let is_inside = self.newest - number < WINDOW;
        is_inside.then_some((word, 1 << (number % WORD)))
    }

    fn look(&self, number: u64) -> Novelty {
        if number > self.newest {
            return Novelty::New;
        }
        match self.place(number) {
            Some((word, bit)) if self.words[word] & bit == 0 => Novelty::New,
            Some(_) => Novelty::Taken,
            None => Novelty::TooOld,
        }
    }

    fn take(&mut self, number: u64) {
        if number > self.newest {
            let forward = number / WORD - self.newest / WORD;
            let count = self.words.len();
            let forward = usize::try_from(forward).unwrap_or(count).min(count);
            for _ in 0..forward {
                self.words.pop_back();
                self.words.push_front(0);
            }
            self.newest = number;
        }
        if let Some((word, bit)) = self.place(number) {
            self.words[word] |= bit;
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;
    use std::collections::BTreeSet;

    proptest! {
        /// Compared with a set of all numbers that were ever taken.
        #[test]
        fn a_number_is_new_once(
            steps in prop::collection::vec((prop_oneof![0_u64..200, 900_u64..1200, 1_u64..5000, Just(u64::MAX), Just(u64::MAX - 70)], any::<bool>()), 1..300)
        ) {
            let (mut seen, mut model) = (Seen::default(), BTreeSet::new());
            for (number, takes) in steps {
                let number = number.max(1);
                let newest = model.last().copied().unwrap_or(number);
                let expected = if newest > number && newest - number >= WINDOW {
                    Novelty::TooOld
                } else if model.contains(&number) {
                    Novelty::Taken
                } else {
                    Novelty::New
                };
                let id = MessageId { life: 7, number };
                prop_assert_eq!(seen.look(Time::ZERO, id), expected);
                if takes && expected == Novelty::New {
                    seen.take(Time::ZERO, id);
                    model.insert(number);
                }
            }
        }
    }

    #[test]
    fn a_sender_is_forgotten_when_it_was_silent_for_long() {
        let mut seen = Seen::default();
        let at = |secs| Time::ZERO + Duration::from_secs(secs);
        for life in 0..1024 {
            seen.take(at(life / 512), MessageId { life, number: 1 });
        }
        let new = MessageId { life: 5000, number: 1 };
        assert_eq!(seen.look(at(60), new), Novelty::NoRoom);
        // A sender that was looked up again stays; another one is forgotten.
        assert_eq!(seen.look(at(61), MessageId { life: 0, number: 1 }), Novelty::Taken);
        assert_eq!(seen.look(at(61), new), Novelty::New);
        seen.take(at(61), new);
        assert_eq!(seen.look(at(61), MessageId { life: 0, number: 1 }), Novelty::Taken);
        assert_eq!(seen.senders.len(), SENDERS_MAX);
    }
}
