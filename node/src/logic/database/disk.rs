//! The failure of the disk and its recovery, and the answers to callers, watchers and other replicas in that case.
//!
//! If a turn was not written, it has not happened. So none of its effects is carried out: no commit, no answer to an
//! order, and no event. Others get no version that names transactions of this turn. A caller that was promised
//! something in an earlier turn is told nothing further: a commit stays committed, and a watcher continues from its
//! position.

use super::Effect;
use super::question::{AsOf, Question, Reply};
use dbmanager::logic::replica::Replica;
use dbmanager::logic::state::State;
use std::collections::BTreeSet;

/// The state on the disk. It is used while the state in memory is newer.
#[derive(Clone, Debug)]
pub struct Durable {
    state: State,
    local: State,
}

/// The state of the disk.
#[derive(Debug, Default)]
pub(super) struct Disk {
    /// Why the database does not write.
    closed: Option<String>,
    /// The durable state, while the disk does not write.
    durable: Option<Durable>,
    /// The errors since the last write.
    failures: BTreeSet<String>,
}

impl Disk {
    /// Takes note that the disk of a robot has not taken a turn; `before` is the state before the turn. Returns the remaining effects:
    /// `rest`, the effects planned after the write, without those that have not happened.
    pub(super) fn fail(&mut self, why: &str, robot: &str, before: Durable, rest: Vec<Effect>) -> Vec<Effect> {
        self.failures.insert(why.to_owned());
        self.closed = Some(format!("the database of `{robot}` takes no writes at the moment: {why}"));
        self.durable.get_or_insert(before);
        rest.into_iter().flat_map(|effect| unwritten(effect, why)).collect()
    }

    /// Takes note that the store was opened again. Whether the disk has room shows with the next write.
    pub(super) fn reopen(&mut self) {
        (self.closed, self.durable) = (None, None);
    }

    /// Takes note that the disk has written a turn. Returns the failures that are over.
    pub(super) fn written(&mut self) -> BTreeSet<String> {
        std::mem::take(&mut self.failures)
    }

    /// Returns the readable state.
    pub(super) fn state<'a>(&'a self, replica: &'a Replica) -> &'a State {
        self.durable.as_ref().map_or_else(|| replica.state(), |durable| &durable.state)
    }

    /// Returns the readable state below `local/`.
    pub(super) fn local<'a>(&'a self, replica: &'a Replica) -> &'a State {
        self.durable.as_ref().map_or_else(|| replica.local(), |durable| &durable.local)
    }

    /// Returns the readable state before a turn that may fail to reach the disk. The maps are shared, so this costs
    /// nothing.
    pub(super) fn durable(&self, replica: &Replica) -> Durable {
        Durable { state: self.state(replica).clone(), local: self.local(replica).clone() }
    }

    /// Returns why the database does not write. None if it writes.
    pub(super) fn closed(&self) -> Option<&str> {
        self.closed.as_deref()
    }

    /// Closes a call if its answer would name transactions that may not be on the disk; returns whether the call was
    /// closed. A watcher that continues from a position gets no answer, and asks again.
    pub(super) fn holds_back(&self, call: u64, question: &Question, effects: &mut Vec<Effect>) -> bool {
        let asks = matches!(question, Question::Watch { .. } | Question::Follow { .. } | Question::Version(AsOf::Now));
        let Some(why) = self.closed.as_ref().filter(|_| asks) else { return false };
        if !matches!(question, Question::Watch { from: Some(_), .. }) {
            effects.push(Effect::AnswerCaller(call, Reply::Refused(why.clone())));
        }
        effects.push(Effect::End(call));
        true
    }
}

/// Returns the part of an effect that is left if its turn was not written.
fn unwritten(effect: Effect, why: &str) -> Vec<Effect> {
    match effect {
        Effect::AnswerCaller(call, Reply::Committed(_) | Reply::Done(_)) => {
            let unknown = Reply::Unknown(format!("the write may be missing: {why}"));
            vec![Effect::AnswerCaller(call, unknown), Effect::End(call)]
        }
        Effect::AnswerCaller(_, Reply::Notification(_) | Reply::Version(_)) => vec![],
        // The answers to other questions come from memory.
        Effect::AnswerCaller(..) | Effect::End(_) | Effect::Alarm(_) => vec![effect],
        Effect::ReplyToPeer(asked, _) => vec![Effect::ReplyToPeer(asked, None)],
        Effect::Persist(_)
        | Effect::Address(_)
        | Effect::Broadcast(_)
        | Effect::Tell(..)
        | Effect::Ask(..)
        | Effect::Settings(_) => vec![],
        Effect::Refused { .. } => vec![effect],
    }
}
