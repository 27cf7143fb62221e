//! Taking what others have written, and noticing that a store was set back or copied.
//!
//! *Rule.* Frames are applied in the order in which they come; what does not fit is held, or pulled again.
//!
//! *Numbers used twice.* A store that was set back, and writes before it hears from others, uses numbers of its that others know
//! already. Nobody takes the one transaction for the other: a frame that does not follow, or that has seen the other one, is
//! refused, and the two who disagree say by which links they know what ([`Chunk::Known`]). So nothing that was acknowledged is
//! overwritten by somebody who never saw it, and each branch is brought in.
//!
//! *Set back.* A store that was set back without a witness shows in two ways: others know more of its own transactions than
//! itself ([`Chunk::Fork`]), or it says that it has less than it said before ([`Chunk::Behind`]). Either way it begins anew. Of the
//! second nobody knows any more if all that had heard it were started again since; nor does it help who has
//! applied something meanwhile that was written without the lost deletions. Then digests differ, and there is an alarm.

use super::{Alarm, Effect, Replica};
use crate::logic::cut::{Cut, Dot, Origin};
use crate::logic::log::Verdict;
use crate::logic::message::{Chunk, Message};
use crate::logic::mutant::Mutant;
use crate::logic::news::News;
use crate::logic::record::Past;
use crate::logic::txn::{Frame, FrameError, Link};
use comms::logic::time::Time;

/// How many links are told at a time.
const KNOWN_MAX: usize = 1024;

impl Replica {
    /// Applies frames; returns whether one could not be.
    pub(super) fn take_frames(
        &mut self,
        now: Time,
        (from, frames): (Origin, Vec<Frame>),
        effects: &mut Vec<Effect>,
    ) -> bool {
        let mut missing = false;
        let mut waiting: Vec<Origin> = Vec::new();
        for frame in frames {
            let written = frame.open().map(|txn| (txn.stamp.origin, txn.wants_ack)).ok();
            let waits = written.filter(|(_, wants_ack)| *wants_ack).map(|(origin, _)| origin);
            match self.apply(now, frame.clone(), effects) {
                Ok(Verdict::Next) => waiting.extend(waits.filter(|origin| !waiting.contains(origin))),
                Ok(Verdict::Known) => {}
                Ok(Verdict::Early) => missing |= !self.hold(&frame),
                Ok(Verdict::Fork) => {
                    let origin = written.map_or(from, |(origin, _)| origin);
                    self.tell_fork(origin, effects);
                    if origin != from {
                        self.tell_known(from, [(origin, self.log.cut().get(origin))], effects);
                    }
                    missing = true;
                }
                Ok(Verdict::Apart) => {
                    let seen = frame.open().map(|txn| txn.context).unwrap_or_default();
                    self.tell_known(from, seen.iter(), effects);
                    missing = true;
                }
                Err(FrameError::Format { format }) => {
                    effects.push(Effect::Alarm(Alarm::NeedsUpgrade(format)));
                    missing |= !self.hold(&frame);
                }
                Err(FrameError::Long { .. } | FrameError::Body { .. }) => {
                    effects.push(Effect::Alarm(Alarm::Malformed(from)));
                    missing = true;
                }
            }
        }
        if !self.batch.is_empty() {
            self.sync.changed(now);
        }
        let cut = self.log.cut();
        effects.extend(waiting.into_iter().map(|origin| Effect::Send(origin, Message::Ack(cut.clone()))));
        missing
    }

    /// Takes what a peer has written after the head that is known here; returns whether something is missing.
    pub(super) fn take_news(&mut self, now: Time, (from, news): (Origin, &News), effects: &mut Vec<Effect>) -> bool {
        let head = self.log.head(from).cloned().unwrap_or_default();
        if let Some(frames) = news.frames(from, head, |cut| self.log.seen(cut)) {
            return self.take_frames(now, (from, frames), effects);
        }
        let known = |seq| self.log.frame(Dot { origin: from, seq }).map(Frame::link);
        let forks = news.links().any(|(seq, link)| known(seq).is_some_and(|known| known != link));
        if forks && !self.config.mutant.is(Mutant::ForksUnseen) {
            self.tell_fork(from, effects);
        }
        forks || news.links().any(|(seq, _)| seq > self.log.cut().get(from))
    }

    /// An origin has used a number twice.
    fn tell_fork(&self, origin: Origin, effects: &mut Vec<Effect>) {
        let (seq, link) = self.log.tip(origin);
        effects.push(Effect::Alarm(Alarm::Fork(origin)));
        effects.push(Effect::Send(origin, Message::Chunk(Chunk::Fork { seq, link })));
    }

    /// Tells a peer by which links these transactions are known here, of which it means others.
    pub(super) fn tell_known(
        &self,
        to: Origin,
        of: impl IntoIterator<Item = (Origin, u64)>,
        effects: &mut Vec<Effect>,
    ) {
        let known = of.into_iter().filter_map(|(origin, seq)| {
            let dot = Dot { origin, seq };
            Some((dot, self.log.link(dot)?))
        });
        effects.push(Effect::Send(to, Message::Chunk(Chunk::Known(known.take(KNOWN_MAX).collect()))));
    }

    /// A member knows transactions by these links. If one is another here, somebody was set back, and both branches have spread:
    /// of two that stand on different ones, the one with the larger origin begins anew, from the other, and brings in what it has.
    /// Returns whether it does, or the other has to.
    pub(super) fn take_known(
        &mut self,
        now: Time,
        (from, known): (Origin, &[(Dot, Link)]),
        effects: &mut Vec<Effect>,
    ) -> bool {
        let other = |(dot, link): &&(Dot, Link)| self.log.link(*dot).is_some_and(|here| here != *link);
        let Some((dot, link)) = known.iter().find(other).copied() else { return false };
        let me = self.identity.origin;
        if self.identity.joining.is_some() || self.config.mutant.is(Mutant::Reuse) {
            return false;
        } else if dot.origin == me {
            self.take_fork(now, (dot.seq, link), effects);
        } else if dot.origin == from {
            self.tell_fork(from, effects);
        } else if from < me {
            effects.push(Effect::Alarm(Alarm::Fork(dot.origin)));
            self.identity.past.push(Past { origin: dot.origin, twice: true, ..Past::default() });
            self.rejoin(now, false, effects);
        } else {
            self.tell_fork(dot.origin, effects);
            self.tell_known(from, [(dot.origin, dot.seq)], effects);
        }
        true
    }

    /// A peer knows the own transaction `seq` by this link.
    pub(super) fn take_fork(&mut self, now: Time, (seq, link): (u64, Link), effects: &mut Vec<Effect>) {
        let origin = self.identity.origin;
        if self.identity.joining.is_some() || self.config.mutant.is(Mutant::Reuse) {
            return;
        }
        let known = self.log.link(Dot { origin, seq });
        if is_set_back(self.log.tip(origin), (seq, link)) || known.is_some_and(|known| known != link) {
            self.rejoin(now, true, effects);
        }
    }

    /// Returns what to answer a member who has less than it has said to have. Others may have dropped deletions because of
    /// that, so it must not go on under its name.
    pub(super) fn behind(&self, from: Origin, cut: &Cut) -> Option<Effect> {
        let said =
            self.acks.said(from).filter(|said| !cut.dominates(said) && !self.config.mutant.is(Mutant::SetBackUntold));
        said.map(|said| Effect::Send(from, Message::Chunk(Chunk::Behind(said.clone()))))
    }
}

/// Returns whether whoever ends its own chain so has less of it, or another one, than whoever knows it to end so.
pub(super) fn is_set_back(own: (u64, Link), known: (u64, Link)) -> bool {
    own.0 < known.0 || own.0 == known.0 && own.1 != known.1
}
