//! Transactions that cannot be read yet: of a newer format, or after one that is.
//!
//! *Rule.* Every format begins with the same [`Header`]. So a frame that is next at its origin and whose causes are here, be
//! they applied or held, is kept and passed on, although nobody here knows what it says; and so is what comes after it. None
//! of it is applied: the own cut, by which others count what is stable, stays behind it, and what is committed here has not
//! seen it. A newer program finds it on the disk and applies it in the order in which it came, which is causal.
//!
//! That way a robot with an older program still carries news from one newer robot to another, and never shows half of them.
//!
//! What retires an origin of which something is held is held too: who says to have it counts as one who has applied all of that
//! origin that anybody has.
//!
//! New formats are written only once [`Replica::team_format`] says that everybody reads them; that a frame has to be held
//! means that somebody has joined since, or that an operator was in a hurry.

use super::{Effect, Replica};
use crate::logic::cut::{Cut, Dot, Origin};
use crate::logic::log::Verdict;
use crate::logic::txn::{FORMAT, FORMAT_FIRST, Frame, Header, Link};
use comms::logic::time::Time;
use std::collections::BTreeMap;

/// How many bytes of frames are held. What does not fit is pulled again later.
const HELD_SIZE_MAX: usize = 16 << 20;

/// What is held, in the order in which it came.
#[derive(Debug, Default)]
pub(super) struct Held {
    frames: BTreeMap<u64, (Dot, Frame)>,
    heads: BTreeMap<Origin, (u64, Link)>,
    size: usize,
}

impl Held {
    pub(super) fn new(frames: impl IntoIterator<Item = (u64, (Dot, Frame))>) -> Self {
        let mut held = Self::default();
        for (index, (dot, frame)) in frames {
            held.insert(index, dot, frame);
        }
        held
    }

    /// Returns what is held and beyond `cut`, about `size_max` bytes of it, and whether there is more.
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

    /// Returns whether something of this origin is held.
    pub(super) fn has(&self, origin: Origin) -> bool {
        self.heads.contains_key(&origin)
    }

    pub(super) fn cut(&self) -> Cut {
        self.heads.iter().map(|(origin, (seq, _))| (*origin, *seq)).collect()
    }

    fn insert(&mut self, index: u64, dot: Dot, frame: Frame) {
        self.size += frame.size();
        self.heads.insert(dot.origin, (dot.seq, frame.link()));
        self.frames.insert(index, (dot, frame));
    }
}

impl Replica {
    /// Returns the newest format that every member is known to read.
    pub fn team_format(&self) -> u8 {
        let others = self.members.active().filter(|(origin, _)| *origin != self.identity.origin);
        others
            .map(|(origin, _)| self.sync.format(origin).unwrap_or(FORMAT_FIRST))
            .chain([FORMAT])
            .min()
            .unwrap_or(FORMAT)
    }

    /// Returns what is here, applied or held.
    pub(super) fn have(&self) -> Cut {
        let mut cut = self.log.cut().clone();
        cut.join(&self.held.cut());
        cut
    }

    /// Holds a frame that cannot be applied; returns whether that was possible, or it is held already.
    pub(super) fn hold(&mut self, frame: &Frame) -> bool {
        let Ok((Header { stamp, seq, prev, context, .. }, _)) = frame.split() else { return false };
        let (dot, have) = (Dot { origin: stamp.origin, seq }, self.have());
        if have.contains(dot) {
            return true;
        }
        let before = || self.log.tip(dot.origin);
        let (last, link) = self.held.heads.get(&dot.origin).copied().unwrap_or_else(before);
        let fits = self.held.size + frame.size() <= HELD_SIZE_MAX;
        if seq != last + 1 || prev != link || !have.dominates(&context) || !fits {
            return false;
        }
        let index = self.held.frames.last_key_value().map_or(0, |(index, _)| index + 1);
        self.held.insert(index, dot, frame.clone());
        self.batch.held(index, Some((dot, frame)));
        true
    }

    /// Applies what can be read by now, and forgets what has come in another way.
    pub(super) fn release(&mut self, now: Time, effects: &mut Vec<Effect>) {
        if !self.is_member() {
            return;
        }
        let mut left = Vec::new();
        for (index, (dot, frame)) in std::mem::take(&mut self.held.frames) {
            let done = matches!(self.apply(now, frame.clone(), effects), Ok(Verdict::Next | Verdict::Known));
            if done || self.log.cut().contains(dot) {
                self.batch.held(index, None);
            } else {
                left.push((index, (dot, frame)));
            }
        }
        self.held = Held::new(left);
    }
}
