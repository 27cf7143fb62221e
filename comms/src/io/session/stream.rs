//! The state of a stream of answers at each of its ends, without I/O.
//!
//! The caller asks for one piece after the other, with a limit for the size of each. The server sends nothing without a
//! request. A caller may take nothing, because it is suspended or waits for a full pipe. It blocks no other caller: the
//! bytes in transit to it fit into the buffers of its link. A piece contains bytes of the answers, as frames
//! ([`crate::logic::frame`]) that may be cut anywhere. The last piece says how the stream has ended.

use super::tally::Tally;
use crate::logic::codec::{Enveloped, Kind};
use crate::logic::frame::{self, Decoder, FrameError};
use crate::logic::proof::Proof;
use crate::logic::time::Time;
use serde::{Deserialize, Serialize};
use std::collections::VecDeque;
use std::time::Duration;

/// The largest answer, in bytes.
const ANSWER_SIZE_MAX: usize = 16 << 20;
/// How many bytes of answers may wait at the server before it has to stop adding answers.
const ROOM: usize = 256 << 10;
/// A silence is measured in this number of steps.
const SILENCE_STEPS: u32 = 8;

/// Names a stream: the session of the caller, and its number there.
#[derive(Clone, Debug, PartialEq, Eq, Hash, Serialize, Deserialize)]
pub(super) struct StreamId {
    /// The session's id.
    pub(super) session: String,
    /// Counts the streams of the session.
    pub(super) number: u64,
}

/// A request of a caller to the server of a stream. The first one carries the question and makes the stream.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub(super) enum Pull {
    /// Asks for the first piece of a new stream.
    First {
        /// The stream.
        stream: StreamId,
        /// The most bytes that the piece may have.
        size: u32,
    },
    /// Asks for the next piece of an existing stream.
    Next {
        /// The stream.
        stream: StreamId,
        /// The most bytes that the piece may have.
        size: u32,
    },
    /// The caller asks for no more.
    Leave {
        /// The stream.
        stream: StreamId,
    },
    /// Asks in a team for a single answer, without a stream.
    One {
        /// A random number, so that no two questions are equal.
        nonce: [u8; 16],
        /// The proof of the caller, if it is a node, over [`super::proof::question`].
        proof: Option<Proof>,
    },
}

impl StreamId {
    /// Returns bytes that distinguish this question from every other question.
    pub(super) fn nonce(&self) -> Vec<u8> {
        [self.session.as_bytes(), &self.number.to_le_bytes()].concat()
    }
}

impl Enveloped for Pull {
    const KIND: Kind = Kind::Pull;
    const SIZE_MAX: usize = 4 << 10;
}

/// The answer to a [`Pull`].
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub(super) struct Piece {
    /// Whether answers already waited when the request came. Then only the link determines the time until the piece
    /// arrives.
    pub(super) was_ready: bool,
    /// The next bytes. An empty piece means that the server is still there.
    pub(super) bytes: Vec<u8>,
    /// The end of the stream, if it follows these bytes.
    pub(super) end: Option<End>,
}

impl Enveloped for Piece {
    const KIND: Kind = Kind::Piece;
    const SIZE_MAX: usize = 1 << 20;
}

/// How a stream ends.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub(super) enum End {
    /// The stream is complete; the bytes are the mark of [`Tally::mark`].
    Whole(Vec<u8>),
    /// The stream is incomplete, with the reason for people.
    Broken(String),
    /// The server refuses this request, with the reason for people.
    Refused(String),
}

/// The server's end.
#[derive(Debug, Default)]
pub(super) struct Outgoing {
    bytes: VecDeque<u8>,
    tally: Tally,
    end: Option<End>,
}

impl Outgoing {
    /// Returns whether another answer may be added now.
    pub(super) fn has_room(&self) -> bool {
        self.bytes.len() < ROOM
    }

    /// Adds an answer; an answer that is too large breaks the stream.
    pub(super) fn push(&mut self, answer: &[u8]) {
        match frame::encode(answer, ANSWER_SIZE_MAX) {
            Ok(frame) => {
                self.tally.add(answer);
                self.bytes.extend(frame);
            }
            Err(error) => self.end(End::Broken(error.to_string())),
        }
    }

    /// Marks the stream as complete.
    pub(super) fn finish(&mut self) {
        self.end(End::Whole(self.tally.mark().to_vec()));
    }

    /// Sets the end of the stream. Only the first end is used.
    pub(super) fn end(&mut self, end: End) {
        self.end.get_or_insert(end);
    }

    /// Notes that no more answers come. If the stream has not ended before, the caller also gets no end.
    pub(super) fn abandon(&mut self) {
        if self.tally.count() > 0 {
            self.end(End::Broken("it went away in the middle".to_owned()));
        }
    }

    /// Returns whether there is anything to send.
    pub(super) fn is_ready(&self) -> bool {
        !self.bytes.is_empty() || self.end.is_some()
    }

    /// Returns the next piece.
    pub(super) fn piece(&mut self, size: u32, was_ready: bool) -> Piece {
        let size = (size as usize).clamp(1, Piece::SIZE_MAX / 2).min(self.bytes.len());
        let bytes: Vec<u8> = self.bytes.drain(..size).collect();
        let end = if self.bytes.is_empty() { self.end.clone() } else { None };
        Piece { was_ready, bytes, end }
    }
}

/// The caller's end.
#[derive(Debug)]
pub(super) struct Incoming {
    frames: Decoder,
    tally: Tally,
    end: Option<End>,
}

impl Default for Incoming {
    fn default() -> Self {
        Self { frames: Decoder::new(ANSWER_SIZE_MAX), tally: Tally::default(), end: None }
    }
}

impl Incoming {
    /// Takes a piece.
    pub(super) fn take(&mut self, piece: Piece) {
        self.frames.push(&piece.bytes);
        self.end = piece.end;
    }

    /// Returns the next complete answer.
    ///
    /// # Errors
    /// If the server sends bytes that are not a stream.
    pub(super) fn next(&mut self) -> Result<Option<Vec<u8>>, FrameError> {
        let answer = self.frames.next_frame()?;
        if let Some(answer) = &answer {
            self.tally.add(answer);
        }
        Ok(answer)
    }

    /// Returns how many answers were taken.
    pub(super) fn count(&self) -> u64 {
        self.tally.count()
    }

    /// Returns the end of the stream, once all answers were taken.
    pub(super) fn end(&self) -> Option<End> {
        let end = self.end.clone()?;
        let is_whole = |mark: &[u8]| self.frames.is_between_frames() && *mark == self.tally.mark();
        let lacks = matches!(&end, End::Whole(mark) if !is_whole(mark));
        Some(if lacks { End::Broken("some of the answers are missing".to_owned()) } else { end })
    }
}

/// How long a peer has been silent while this program was running. Time in which this program was suspended is left
/// out.
#[derive(Debug)]
pub(super) struct Silence {
    lasted: Duration,
    until: Time,
    /// How long it may last.
    max: Duration,
}

impl Silence {
    /// Returns a silence that begins at `now` and may last for `max`.
    pub(super) const fn begin(now: Time, max: Duration) -> Self {
        Self { lasted: Duration::ZERO, until: now, max }
    }

    /// Returns how long the silence may last.
    pub(super) const fn max(&self) -> Duration {
        self.max
    }

    /// Begins again.
    pub(super) const fn restart(&mut self, now: Time) {
        *self = Self::begin(now, self.max);
    }

    /// Adds the time since the last call, but at most two steps: a call that comes much later than planned shows that
    /// the program was not running. Returns when to call this again, or none when the silence has lasted for too long.
    pub(super) fn look(&mut self, now: Time) -> Option<Time> {
        let step = self.max / SILENCE_STEPS;
        self.lasted += (now - self.until).min(2 * step);
        self.until = now;
        let left = self.max.checked_sub(self.lasted).filter(|left| !left.is_zero())?;
        Some(now + left.min(step))
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    fn all(outgoing: &mut Outgoing, incoming: &mut Incoming, size: u32) -> Vec<Vec<u8>> {
        let mut answers = Vec::new();
        while outgoing.is_ready() && incoming.end().is_none() {
            let piece = outgoing.piece(size, true);
            assert!(piece.bytes.len() <= size as usize);
            incoming.take(piece);
            while let Some(answer) = incoming.next().unwrap() {
                answers.push(answer);
            }
        }
        answers
    }

    proptest! {
        #[test]
        fn answers_survive_any_cutting(
            answers in prop::collection::vec(prop::collection::vec(any::<u8>(), 0..50), 0..8),
            size in 1_u32..20,
        ) {
            let (mut outgoing, mut incoming) = (Outgoing::default(), Incoming::default());
            answers.iter().for_each(|answer| outgoing.push(answer));
            outgoing.finish();
            prop_assert_eq!(all(&mut outgoing, &mut incoming, size), answers);
            prop_assert!(matches!(incoming.end(), Some(End::Whole(_))));
        }

        #[test]
        fn a_piece_that_is_lost_is_noticed(lost in 0_usize..6) {
            let (mut outgoing, mut incoming) = (Outgoing::default(), Incoming::default());
            (0..6_u8).for_each(|number| outgoing.push(&[number; 8]));
            outgoing.finish();
            for number in 0..6 {
                let piece = outgoing.piece(12, true);
                if number != lost {
                    incoming.take(piece);
                } else if piece.end.is_some() {
                    prop_assert_eq!(incoming.end(), None);
                    return Ok(());
                }
                while let Ok(Some(_)) = incoming.next() {}
            }
            prop_assert!(matches!(incoming.end(), Some(End::Broken(_))));
        }
    }

    #[test]
    fn what_was_said_before_the_end_comes_before_it() {
        for end in [End::Broken("no more".into()), End::Refused("not today".into())] {
            let (mut outgoing, mut incoming) = (Outgoing::default(), Incoming::default());
            outgoing.push(b"one");
            outgoing.end(end.clone());
            outgoing.finish();
            assert_eq!(all(&mut outgoing, &mut incoming, 2), [b"one"]);
            assert_eq!(incoming.end(), Some(end));
        }
    }

    #[test]
    fn a_server_is_told_when_there_is_no_room() {
        let mut outgoing = Outgoing::default();
        let taken = (0..1000).take_while(|_| outgoing.has_room() && (outgoing.push(&[0; 10_000]), true).1).count();
        assert_eq!(taken, ROOM.div_ceil(10_004));
        outgoing.piece(u32::MAX, true);
        assert!(outgoing.has_room());
        outgoing.push(&vec![0; ANSWER_SIZE_MAX + 1]);
        assert!(matches!(outgoing.piece(u32::MAX, true).end, Some(End::Broken(_))));
    }

    #[test]
    fn a_silence_lasts_while_somebody_listens() {
        let (at, max) = (|ms| Time::from_nanos(ms * 1_000_000), Duration::from_secs(8));
        let looked = |looks: &[u64]| {
            let mut silence = Silence::begin(at(0), max);
            looks.iter().take_while(|ms| silence.look(at(**ms)).is_some()).count()
        };
        let each: Vec<u64> = (1..=20).map(|second| second * 1000).collect();
        assert_eq!(looked(&each), 7, "the eighth look is the last");
        // The result does not depend on the number of calls.
        let often: Vec<u64> = (1..=2000).map(|step| step * 10).collect();
        assert_eq!(looked(&often), 799);
        // This program was suspended for a minute.
        assert_eq!(looked(&[1000, 61_000, 62_000, 63_000, 64_000, 65_000, 66_000, 67_000]), 6);
    }
}
