//! The transactions of each origin, gap-free, chained by hashes.
//!
//! *State.* For each origin: its *head* (number, link, stamp and full context of its last transaction), and the frames above
//! the cut `low`, in the order in which they were applied here.
//!
//! *Rule.* A frame is taken if it is the next of its origin, names the link of the one before it, carries a larger stamp, and
//! all that it has seen is here. What is served to others goes out in the order of application, which is causal.
//!
//! *T6, a dot names one transaction.* Two frames with one dot either have different links, or they are the same bytes. The
//! link is in the next frame, so from a common head on, chains that differ once differ for ever, and the first exchange that
//! could notice ends in [`Verdict::Fork`]. A frame also has a digest of the links of what it has seen of others: one that has seen
//! another transaction by a number that is known here is not taken ([`Verdict::Apart`]), so it cannot take away what its writer
//! never saw.
//!
//! *T7, liveness.* Among transactions that are missing here and present there, the first by causality can be applied, and it
//! is what is served first: one complete pull makes the own cut dominate the cut that the other had when it began.

use crate::logic::clock::Stamp;
use crate::logic::cut::{Cut, Dot, Origin};
use crate::logic::txn::{Frame, Link, Txn};
use serde::{Deserialize, Serialize};
use std::collections::BTreeMap;

/// The last transaction of an origin.
#[derive(Clone, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
pub struct Head {
    /// Its number.
    pub seq: u64,
    /// What the next frame calls it.
    pub link: Link,
    /// Its stamp.
    pub stamp: Stamp,
    /// Its full context.
    pub context: Cut,
}

impl Head {
    /// Returns the full context of a transaction that is next, and says that it has seen `more`.
    pub fn seen_after(&self, next: Dot, more: &Cut) -> Cut {
        let mut context = self.context.clone();
        context.go_on(next, more);
        context
    }
}

/// What to do with a frame.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Verdict {
    /// Apply it.
    Next,
    /// It is here already.
    Known,
    /// Something before it is missing.
    Early,
    /// Its origin has used a number twice, or an order of stamps that cannot be.
    Fork,
    /// It has seen another transaction by a number that means one here.
    Apart,
}

/// A frame, and when it was applied here.
#[derive(Clone, Debug)]
pub struct Logged {
    /// Its place in the order of application.
    pub index: u64,
    /// The transaction.
    pub frame: Frame,
}

/// The log of one replica.
#[derive(Clone, Debug, Default)]
pub struct Log {
    heads: BTreeMap<Origin, Head>,
    frames: BTreeMap<Dot, Logged>,
    cut: Cut,
    next: u64,
    size: usize,
}

impl Log {
    /// Returns a log that begins after `heads`.
    pub fn new(heads: BTreeMap<Origin, Head>) -> Self {
        let cut = heads.iter().map(|(origin, head)| (*origin, head.seq)).collect();
        Self { heads, cut, ..Self::default() }
    }

    /// Returns what is here.
    pub fn cut(&self) -> &Cut {
        &self.cut
    }

    /// Returns the last transaction of `origin`.
    pub fn head(&self, origin: Origin) -> Option<&Head> {
        self.heads.get(&origin)
    }

    /// Returns number and link of the last transaction of `origin`; zeros if there is none.
    pub fn tip(&self, origin: Origin) -> (u64, Link) {
        self.head(origin).map(|head| (head.seq, head.link)).unwrap_or_default()
    }

    /// Returns the last transaction of every origin.
    pub fn heads(&self) -> &BTreeMap<Origin, Head> {
        &self.heads
    }

    /// Returns eight bytes that two logs share only if they have the same transactions, and not only the same numbers.
    pub fn chains(&self) -> u64 {
        let mut hasher = blake3::Hasher::new();
        for (origin, head) in &self.heads {
            hasher.update(&origin.number().to_le_bytes()).update(&head.seq.to_le_bytes()).update(&head.link.0);
        }
        u64::from_le_bytes(Link::of(&hasher).0)
    }

    /// Returns the frame of a transaction, if it is still kept.
    pub fn frame(&self, dot: Dot) -> Option<&Frame> {
        self.frames.get(&dot).map(|logged| &logged.frame)
    }

    /// Returns how many frames there are.
    pub fn len(&self) -> usize {
        self.frames.len()
    }

    /// Returns whether there is no frame.
    pub fn is_empty(&self) -> bool {
        self.frames.is_empty()
    }

    /// Returns about how many bytes the frames take.
    pub fn size(&self) -> usize {
        self.size
    }

    /// Returns the largest stamp.
    pub fn last_stamp(&self) -> Stamp {
        self.heads.values().map(|head| head.stamp).max().unwrap_or_default()
    }

    /// Returns the cut below which frames are gone.
    pub fn low(&self) -> Cut {
        let kept = |origin: Origin| {
            self.frames.range(Dot { origin, seq: 0 }..=Dot { origin, seq: u64::MAX }).next().map(|(dot, _)| dot.seq - 1)
        };
        self.cut.iter().map(|(origin, seq)| (origin, kept(origin).unwrap_or(seq))).collect()
    }

    /// Returns what follows `cut`, each chain without a gap, in the order of application.
    fn after(&self, cut: &Cut) -> impl Iterator<Item = (Dot, &Frame)> {
        let next = |origin, after: u64| {
            let dot = Dot { origin, seq: after.saturating_add(1) };
            self.frames.get(&dot).map(|logged| (logged.index, (dot, &logged.frame)))
        };
        let firsts = self.cut.iter().filter_map(|(origin, _)| next(origin, cut.get(origin)));
        let mut waiting: BTreeMap<u64, (Dot, &Frame)> = firsts.collect();
        std::iter::from_fn(move || {
            let (_, found) = waiting.pop_first()?;
            waiting.extend(next(found.0.origin, found.0.seq));
            Some(found)
        })
    }

    /// Returns the full context of a transaction that is next at its origin.
    pub fn context(&self, txn: &Txn) -> Cut {
        let none = Head::default();
        self.head(txn.stamp.origin).unwrap_or(&none).seen_after(txn.dot(), &txn.context)
    }

    /// Returns what to do with a frame and the transaction in it.
    pub fn judge(&self, txn: &Txn, frame: &Frame) -> Verdict {
        let dot = txn.dot();
        let none = Head::default();
        let head = self.head(dot.origin).unwrap_or(&none);
        if dot.seq <= head.seq {
            let same = self.frame(dot).is_none_or(|known| known == frame);
            return if same && dot.seq > 0 { Verdict::Known } else { Verdict::Fork };
        }
        if dot.seq > head.seq + 1 {
            return Verdict::Early;
        }
        if dot.seq == head.seq + 1 && (txn.prev != head.link || txn.stamp <= head.stamp) {
            return Verdict::Fork;
        }
        let missing = self.context(txn).beyond(&self.cut);
        if !missing.is_empty() {
            return Verdict::Early;
        }
        let differs = |said| self.seen(&txn.context).is_some_and(|here| here != said);
        if frame.seen().is_some_and(differs) { Verdict::Apart } else { Verdict::Next }
    }

    /// Returns by which link a transaction is known; `None` if it is not, or too little is kept to tell.
    pub fn link(&self, dot: Dot) -> Option<Link> {
        let head = self.head(dot.origin).filter(|head| head.seq == dot.seq).map(|head| head.link);
        // If the frame is gone, the next one still says what it was.
        let next = || Some(self.frame(Dot { seq: dot.seq.checked_add(1)?, ..dot })?.open().ok()?.prev);
        head.or_else(|| self.frame(dot).map(Frame::link)).or_else(next)
    }

    /// Returns a digest of the links of the last transactions in a cut; `None` if some of them are not known.
    pub fn seen(&self, cut: &Cut) -> Option<Link> {
        let mut hasher = blake3::Hasher::new();
        for (origin, seq) in cut.iter() {
            hasher.update(&self.link(Dot { origin, seq })?.0);
        }
        Some(Link::of(&hasher))
    }

    /// Adds a transaction that is [`Verdict::Next`]; returns its place in the order of application.
    pub fn append(&mut self, txn: &Txn, frame: Frame) -> u64 {
        let (dot, context) = (txn.dot(), self.context(txn));
        let head = Head { seq: dot.seq, link: frame.link(), stamp: txn.stamp, context };
        self.heads.insert(dot.origin, head);
        let index = self.next;
        self.restore(dot, Logged { index, frame });
        index
    }

    /// Puts back a frame as it was stored; its head must be known.
    pub fn restore(&mut self, dot: Dot, logged: Logged) {
        self.cut.include(dot);
        self.next = self.next.max(logged.index.saturating_add(1));
        self.size += logged.frame.size();
        self.frames.insert(dot, logged);
    }

    /// Returns the frames beyond `cut` in the order of application, at least one and about `size_max` bytes of them, and
    /// whether there are more; `None` if some that would be needed are gone.
    pub fn beyond(&self, cut: &Cut, size_max: usize) -> Option<(Vec<Frame>, bool)> {
        if !cut.dominates(&self.low()) {
            return None;
        }
        let (mut frames, mut size) = (Vec::new(), 0);
        for (_, frame) in self.after(cut) {
            size += frame.size();
            if size > size_max && !frames.is_empty() {
                return Some((frames, true));
            }
            frames.push(frame.clone());
        }
        Some((frames, false))
    }

    /// Returns the frames in the order of application.
    pub fn in_order(&self) -> Vec<(Dot, &Frame)> {
        self.after(&self.low()).collect()
    }

    /// Drops the oldest frames within `stable` until no more than `size_max` bytes are left. Returns their names.
    pub(crate) fn truncate(&mut self, stable: &Cut, size_max: usize) -> Vec<Dot> {
        let (mut dropped, mut size) = (Vec::new(), self.size);
        for (dot, frame) in self.after(&self.low()) {
            // What is applied later may be stable earlier, but a chain is only ever cut from below.
            if size <= size_max || !stable.contains(dot) {
                break;
            }
            size -= frame.size();
            dropped.push(dot);
        }
        self.size = size;
        dropped.iter().for_each(|dot| drop(self.frames.remove(dot)));
        dropped
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::logic::clock::Wall;

    fn txn(origin: u64, seq: u64, log: &Log, context: &[(u64, u64)]) -> (Txn, Frame) {
        let me = Origin::new(origin);
        let prev = log.head(me).map(|head| head.link).unwrap_or_default();
        let context = context.iter().map(|(origin, seq)| (Origin::new(*origin), *seq)).collect();
        let stamp = Stamp { epoch: 0, hlc: seq * 10, origin: me };
        let (wall, reason) = (Wall::default(), String::new());
        let txn = Txn {
            stamp,
            seq,
            prev,
            wall,
            context,
            reason,
            requires: vec![],
            writes: vec![],
            wants_ack: false,
            rebase: None,
        };
        let frame = Frame::seal(&txn).unwrap();
        (txn, frame)
    }

    fn take(log: &mut Log, origin: u64, seq: u64) {
        let (txn, frame) = txn(origin, seq, log, &[]);
        assert_eq!(log.judge(&txn, &frame), Verdict::Next);
        log.append(&txn, frame);
    }

    #[test]
    fn what_is_taken() {
        let mut log = Log::default();
        take(&mut log, 1, 1);
        let (next, frame) = txn(1, 2, &log, &[(2, 1)]);
        assert_eq!(log.judge(&next, &frame), Verdict::Early, "what it saw is missing");
        let (far, far_frame) = txn(1, 3, &log, &[]);
        assert_eq!(log.judge(&far, &far_frame), Verdict::Early, "one before it is missing");
        take(&mut log, 2, 1);
        assert_eq!(log.judge(&next, &frame), Verdict::Next);
        log.append(&next, frame.clone());
        assert_eq!(log.judge(&next, &frame), Verdict::Known);
        let mut other = next.clone();
        other.reason = "another life".into();
        let other_frame = Frame::seal(&other).unwrap();
        assert_eq!(log.judge(&other, &other_frame), Verdict::Fork, "a number was used twice");
        let (mut third, _) = txn(1, 3, &log, &[]);
        third.prev = other_frame.link();
        assert_eq!(log.judge(&third, &Frame::seal(&third).unwrap()), Verdict::Fork, "the other branch goes on");
        assert_eq!(
            log.head(Origin::new(1)).unwrap().context.to_string(),
            format!("{}:1 {}:1", Origin::new(1), Origin::new(2))
        );
    }

    #[test]
    fn what_is_served() {
        let mut log = Log::default();
        for (origin, seq) in [(1, 1), (2, 1), (1, 2), (2, 2)] {
            take(&mut log, origin, seq);
        }
        let served = |log: &Log, cut: &[(u64, u64)], size| {
            let cut = cut.iter().map(|(origin, seq)| (Origin::new(*origin), *seq)).collect();
            let (frames, more) = log.beyond(&cut, size)?;
            let name = |frame: &Frame| frame.open().map(|txn| (txn.stamp.origin.number(), txn.seq)).unwrap();
            Some((frames.iter().map(name).collect::<Vec<_>>(), more))
        };
        assert_eq!(served(&log, &[], 1 << 20), Some((vec![(1, 1), (2, 1), (1, 2), (2, 2)], false)));
        assert_eq!(served(&log, &[(1, 1)], 1), Some((vec![(2, 1)], true)));
        assert_eq!(served(&log, &[(1, 9), (2, 9)], 1), Some((vec![], false)));
        let stable: Cut = [(Origin::new(1), 2)].into_iter().collect();
        assert_eq!(
            log.truncate(&stable, 0),
            [Dot { origin: Origin::new(1), seq: 1 }],
            "up to the first that is not stable"
        );
        assert_eq!(served(&log, &[], 1), None);
        assert_eq!(served(&log, &[(1, 1)], 1 << 20), Some((vec![(2, 1), (1, 2), (2, 2)], false)));
        assert_eq!(log.low().to_string(), format!("{}:1", Origin::new(1)));
    }
}
