//! Transactions that cannot be read yet: of a newer format, or after one that is.
//!
//! *Rule.* Every format begins with the same [`Header`]. So a frame that is next at its origin and whose causes are here, be
//! they applied or buffered, is kept and passed on, although nobody here knows what it says; and so is what comes after it. None
//! of it is applied: the own cut, by which others count what is stable, stays behind it, and what is committed here has not
//! seen it. A newer program finds it on the disk and applies it in the order in which it came, which is causal.
//!
//! That way a robot with an older program still carries news from one newer robot to another, and never shows half of them.
//!
//! Retirements of an origin with buffered transactions are buffered too: who says to have the retirement counts as one who has
//! applied all of that origin that anybody has.
//!
//! New formats are written only once [`Replica::team_format`](super::Replica::team_format) says that everybody reads them; that a
//! frame has to be buffered means that somebody has joined since, or that an operator was in a hurry.

use crate::logic::cut::{Cut, Dot, Origin};
use crate::logic::log::Log;
use crate::logic::record::Batch;
use crate::logic::txn::{Frame, Header, Link};
use std::collections::BTreeMap;

/// How many bytes of frames are buffered. What does not fit is pulled again later.
const PENDING_SIZE_MAX: usize = 16 << 20;

/// What is buffered, in the order in which it came.
#[derive(Debug, Default)]
pub(super) struct PendingTxns {
    frames: BTreeMap<u64, (Dot, Frame)>,
    heads: BTreeMap<Origin, (u64, Link)>,
    size: usize,
}

impl PendingTxns {
    pub(super) fn new(frames: impl IntoIterator<Item = (u64, (Dot, Frame))>) -> Self {
        let mut pending = Self::default();
        for (index, (dot, frame)) in frames {
            pending.insert(index, dot, frame);
        }
        pending
    }

    /// Returns what is buffered and beyond `cut`, about `size_max` bytes of it, and whether there is more.
    pub(super) fn beyond(&self, cut: &Cut, size_max: usize) -> (Vec<Frame>, bool) {
        let (mut frames, mut size) = (Vec::new(), 0);
        for (_, frame) in self.frames.values().filter(|(dot, _)| !cut.contains(*dot)) {
            size += frame.size();
            if size > size_max && !frames.is_empty() {
                return (frames, true);
            }
            frames.push(frame.clone());
        }
        (frames, false)
    }

    /// Returns whether something of this origin is buffered.
    pub(super) fn has(&self, origin: Origin) -> bool {
        self.heads.contains_key(&origin)
    }

    pub(super) fn cut(&self) -> Cut {
        self.heads.iter().map(|(origin, (seq, _))| (*origin, *seq)).collect()
    }

    /// Returns what is here, applied to `log` or buffered.
    pub(super) fn with(&self, log: &Log) -> Cut {
        let mut cut = log.cut().clone();
        cut.join(&self.cut());
        cut
    }

    /// Buffers a frame that cannot be applied to `log`; returns whether that was possible, or it is buffered already.
    pub(super) fn buffer(&mut self, frame: &Frame, log: &Log, batch: &mut Batch) -> bool {
        let Ok((Header { stamp, seq, prev, context, .. }, _)) = frame.split() else { return false };
        let (dot, have) = (Dot { origin: stamp.origin, seq }, self.with(log));
        if have.contains(dot) {
            return true;
        }
        let (last, link) = self.heads.get(&dot.origin).copied().unwrap_or_else(|| log.tip(dot.origin));
        let fits = self.size + frame.size() <= PENDING_SIZE_MAX;
        if seq != last + 1 || prev != link || !have.dominates(&context) || !fits {
            return false;
        }
        let index = self.frames.last_key_value().map_or(0, |(index, _)| index + 1);
        self.insert(index, dot, frame.clone());
        batch.held(index, Some((dot, frame)));
        true
    }

    /// Hands out all that is buffered, to be tried; until [`PendingTxns::keep`] is told the rest, it counts as buffered.
    pub(super) fn take(&mut self) -> BTreeMap<u64, (Dot, Frame)> {
        std::mem::take(&mut self.frames)
    }

    /// Keeps what still cannot be applied.
    pub(super) fn keep(&mut self, left: BTreeMap<u64, (Dot, Frame)>) {
        *self = Self::new(left);
    }

    fn insert(&mut self, index: u64, dot: Dot, frame: Frame) {
        self.size += frame.size();
        self.heads.insert(dot.origin, (dot.seq, frame.link()));
        self.frames.insert(index, (dot, frame));
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::logic::clock::{Stamp, Wall};

    const A: Origin = Origin::new(1);

    /// Returns a frame that nobody here can read.
    fn newer(seq: u64, prev: Link, context: &[(u64, u64)]) -> Frame {
        let context = context.iter().map(|(origin, seq)| (Origin::new(*origin), *seq)).collect();
        let stamp = Stamp { epoch: 0, hlc: seq, origin: A };
        Frame::join(9, &Header { stamp, seq, prev, wall: Wall::default(), context }, &[7; 20])
    }

    #[test]
    fn what_follows_is_buffered_and_what_lacks_a_cause_is_not() {
        let (mut pending, log, mut batch) = (PendingTxns::default(), Log::default(), Batch::default());
        let first = newer(1, Link::default(), &[]);
        let second = newer(2, first.link(), &[]);
        assert!(!pending.buffer(&second, &log, &mut batch), "the one before it is missing");
        assert!(!pending.buffer(&newer(1, Link::default(), &[(2, 1)]), &log, &mut batch), "a cause is missing");
        assert!(batch.is_empty());
        assert!(pending.buffer(&first, &log, &mut batch) && pending.buffer(&second, &log, &mut batch));
        assert!(pending.buffer(&first, &log, &mut batch), "it is buffered already");
        assert!(!pending.buffer(&newer(3, first.link(), &[]), &log, &mut batch), "it follows another one");
        assert_eq!((batch.0.len(), pending.with(&log).get(A), pending.has(A)), (2, 2, true));
        assert_eq!(pending.beyond(&Cut::default(), 1), (vec![first.clone()], true));
        let left = pending.take().into_iter().take(1).collect();
        assert!(pending.has(A), "until it is known what is left");
        pending.keep(left);
        assert_eq!((pending.cut().get(A), pending.beyond(&Cut::default(), 1 << 20).0), (1, vec![first]));
    }

    #[test]
    fn no_more_is_buffered_than_fits() {
        let (mut pending, log, mut batch) = (PendingTxns::default(), Log::default(), Batch::default());
        let first = newer(1, Link::default(), &[]);
        pending.size = PENDING_SIZE_MAX - first.size() + 1;
        assert!(!pending.buffer(&first, &log, &mut batch));
        pending.size -= 1;
        assert!(pending.buffer(&first, &log, &mut batch));
    }
}
