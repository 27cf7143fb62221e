//! The failure of the disk and its recovery, and the answers to callers, watchers and other replicas in that case.
//!
//! If a turn was not written, it has not happened. So none of its effects is carried out: no commit, no answer to an
//! order, and no event. Others get no version that names transactions of this turn. A caller that was promised
//! something in an earlier turn is told nothing further: a commit stays committed, and a watcher continues from its
//! position.

use super::question::{AsOf, Question, Reply};
use super::{Checkpoints, Database, Effect};
use dbmanager::logic::replica::Replica;
use dbmanager::logic::state::State;

/// The state on the disk, used as long as the state in memory is ahead of it.
#[derive(Clone, Debug)]
pub struct Durable {
    state: State,
    local: State,
}

impl Database {
    /// Returns the readable state before a turn that may fail to reach the disk. This costs nothing, because the maps are shared.
    pub fn durable(&self) -> Durable {
        Durable { state: self.state().clone(), local: self.local().clone() }
    }

    /// Notes that the disk has not written a turn. `rest` are the effects that were planned after the write. Returns
    /// these effects without those that have not happened. From now on, the database only answers questions, from
    /// `before`, the state before the turn.
    pub fn fail(&mut self, why: &str, before: Durable, rest: Vec<Effect>) -> Vec<Effect> {
        let mut effects: Vec<Effect> = rest.into_iter().flat_map(|effect| unwritten(effect, why)).collect();
        let watchers = std::mem::take(&mut self.calls.watchers).into_keys();
        effects.extend(std::mem::take(&mut self.calls.waiting).into_iter().chain(watchers).map(Effect::End));
        self.alarm(why.to_owned(), &mut effects);
        self.disk.failures.insert(why.to_owned());
        self.disk.closed = Some(format!("the database of `{}` takes no writes at the moment: {why}", self.place.robot));
        self.disk.durable.get_or_insert(before);
        effects
    }

    /// Notes that the store was opened again with this content.
    pub fn reopen(&mut self, replica: Replica) {
        self.replica = replica;
        (self.disk.closed, self.disk.durable) = (None, None);
        // The earlier failures of the disk are over, so their alarms are removed.
        let failures = std::mem::take(&mut self.disk.failures);
        self.alarms.retain(|alarm| !failures.contains(alarm));
        self.replaced();
    }

    /// Notes that the state was replaced. Everything that was derived from the previous state is dropped.
    pub(super) fn replaced(&mut self) {
        (self.resettled, self.derived.schemas, self.derived.checkpoints) = (true, None, Checkpoints::default());
    }

    /// Returns the readable state. Everything in it is on the disk.
    pub fn state(&self) -> &State {
        self.disk.durable.as_ref().map_or_else(|| self.replica.state(), |durable| &durable.state)
    }

    /// Returns the readable state below `local/`. Everything in it is on the disk.
    pub(super) fn local(&self) -> &State {
        self.disk.durable.as_ref().map_or_else(|| self.replica.local(), |durable| &durable.local)
    }

    /// Returns why the database does not write; nothing if it writes.
    pub fn closed(&self) -> Option<&str> {
        self.disk.closed.as_deref()
    }

    /// Closes a call if its answer would name transactions that may not be on the disk; returns whether the call was
    /// closed. A watcher that continues from a position gets no answer, and asks again.
    pub(super) fn holds_back(&self, call: u64, question: &Question, effects: &mut Vec<Effect>) -> bool {
        let asks = matches!(question, Question::Watch { .. } | Question::Follow { .. } | Question::Version(AsOf::Now));
        let Some(why) = self.disk.closed.as_ref().filter(|_| asks) else { return false };
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
            let unknown = Reply::Unknown(format!("it may not have been written: {why}"));
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
