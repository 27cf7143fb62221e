//! The failure of the disk and its recovery: what callers, watchers and other replicas are told.
//!
//! A turn that was not written has not happened, so nothing goes out that says it has: no commit, no order that is done, no
//! event and no version with names of transactions that may be given to others. Whoever was promised something in an earlier turn
//! hears no more of it: a commit stays committed, a watcher goes on from where it was.

use super::question::{AsOf, Question, Reply};
use super::{Checkpoints, Database, Effect};
use dbmanager::logic::replica::Replica;
use dbmanager::logic::state::State;

/// The durable state, while the machine is ahead of it.
#[derive(Clone, Debug)]
pub struct Durable {
    state: State,
    local: State,
}

impl Database {
    /// Returns what can be read now, before a turn that may turn out not to be on the disk. The maps are shared, so that
    /// this costs nothing.
    pub fn durable(&self) -> Durable {
        Durable { state: self.state().clone(), local: self.local().clone() }
    }

    /// The disk has not taken a turn. Returns what is left of it: `rest`, which was to come after the write, without all
    /// that has not happened. From now on only questions are answered, from `before`, what was there before the turn.
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

    /// The store was opened anew: this is what is in it.
    pub fn reopen(&mut self, replica: Replica) {
        self.replica = replica;
        (self.disk.closed, self.disk.durable) = (None, None);
        // What was wrong with the disk is over: what is listed is what is wrong now.
        let failures = std::mem::take(&mut self.disk.failures);
        self.alarms.retain(|alarm| !failures.contains(alarm));
        self.replaced();
    }

    /// Nothing of the state that was known before holds any more.
    pub(super) fn replaced(&mut self) {
        (self.resettled, self.derived.schemas, self.derived.checkpoints) = (true, None, Checkpoints::default());
    }

    /// Returns what can be read: nothing that may not be on the disk.
    pub fn state(&self) -> &State {
        self.disk.durable.as_ref().map_or_else(|| self.replica.state(), |durable| &durable.state)
    }

    /// Returns what can be read below `local/`: nothing that may not be on the disk.
    pub(super) fn local(&self) -> &State {
        self.disk.durable.as_ref().map_or_else(|| self.replica.local(), |durable| &durable.local)
    }

    /// Returns why it does not write, if it does not.
    pub fn closed(&self) -> Option<&str> {
        self.disk.closed.as_deref()
    }

    /// Ends a call that would be told up to which transactions there are, while some of them may not be on the disk; says
    /// whether it was one. A watcher that goes on from somewhere hears nothing, and comes again.
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

/// Returns what is left of an effect of a turn that was not written.
fn unwritten(effect: Effect, why: &str) -> Vec<Effect> {
    match effect {
        Effect::AnswerCaller(call, Reply::Committed(_) | Reply::Done(_)) => {
            let unknown = Reply::Unknown(format!("it may not have been written: {why}"));
            vec![Effect::AnswerCaller(call, unknown), Effect::End(call)]
        }
        Effect::AnswerCaller(_, Reply::Notification(_) | Reply::Version(_)) => vec![],
        // What else was only asked is answered from what is in memory.
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
