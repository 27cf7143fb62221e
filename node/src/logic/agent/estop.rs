//! `dca estop` on a node: every program is told to stop at once, without `finally` or `shield`, and nothing begins
//! until a user releases it. The stop lasts over a restart of the node, since the driver writes it down.
//!
//! A stop and its release are answered once the disk has the last state: only the last write has
//! that state. A stop is also answered only when nothing runs any more.

use crate::logic::effect::{Effect, Out};
use crate::logic::protocol::{Answer, Deployment, Estop, Estopped};
use serde::{Deserialize, Serialize};

/// Whether everything is stopped.
#[derive(Debug, Default, Serialize, Deserialize)]
pub(super) struct Stopped {
    by: Option<Estop>,
    /// The calls that wait until nothing runs and the stop is on the disk.
    waiting: Vec<u64>,
    /// The calls that wait until the release is on the disk, and whether everything was stopped when they asked.
    releasing: Vec<(u64, bool)>,
    /// The numbers of the last write requested and of the last write that is over.
    writes: (u64, u64),
    /// Why the last write has not reached the disk.
    unwritten: Option<String>,
    /// The work that may continue outside of programs that have ended while callers wait.
    open: Vec<String>,
}

impl Stopped {
    /// Begins with everything stopped, if everything was stopped when the previous node ended.
    pub(super) fn before(by: Option<Estop>) -> Self {
        Self { by, ..Self::default() }
    }

    /// Returns the user who has stopped everything, if there is one.
    pub(super) const fn by(&self) -> Option<&Estop> {
        self.by.as_ref()
    }

    /// Returns why this node begins no deployment. None if it may begin a deployment.
    pub(super) fn obstacle(&self) -> Option<String> {
        let by = self.by.as_ref()?;
        Some(format!("{by}; `dca estop --release` lets programs begin again"))
    }

    /// Stops everything; the call is answered by [`Stopped::tell`].
    pub(super) fn stop(&mut self, call: u64, estop: Estop, out: &mut Out<'_>) {
        self.waiting.push(call);
        // The first user to stop everything is the one recorded.
        self.by.get_or_insert(estop);
        self.keep(out);
    }

    /// Lets programs begin again.
    pub(super) fn release(&mut self, call: u64, out: &mut Out<'_>) {
        self.releasing.push((call, self.by.take().is_some()));
        self.keep(out);
    }

    /// Has the present state written to the disk: a node that was killed may not have written it.
    pub(super) fn keep(&mut self, out: &mut Out<'_>) {
        self.writes.0 += 1;
        out.effects.push(Effect::KeepEstop { number: self.writes.0, estop: self.by.clone() });
    }

    /// A write is over. Each write stores the state at its time, so the last write is valid.
    pub(super) fn kept(&mut self, number: u64, written: Result<(), String>, out: &mut Out<'_>) {
        if number <= self.writes.1 {
            return;
        }
        self.writes.1 = number;
        self.unwritten = written.err();
        if self.is_written() {
            for (call, was_stopped) in std::mem::take(&mut self.releasing) {
                out.answer_last(call, Answer::Released { was_stopped, unwritten: self.unwritten.clone() });
            }
        }
    }

    /// Whether the last write that was asked for is over.
    const fn is_written(&self) -> bool {
        self.writes.0 == self.writes.1
    }

    /// Takes note of work that may continue after the end of a deployment, for the callers that wait.
    pub(super) fn note_open(&mut self, deployment: &Deployment, may_go_on: Vec<String>) {
        if !self.waiting.is_empty() {
            self.open.extend(may_go_on.iter().map(|what| format!("{deployment} {what}")));
        }
    }

    /// If nothing runs any more and the disk has answered, answers the callers that wait for this. `unended` are the
    /// programs that could not be ended.
    pub(super) fn tell(&mut self, unended: impl Iterator<Item = String>, effects: &mut Vec<Effect>) {
        if self.waiting.is_empty() || !self.is_written() {
            return;
        }
        let unended = std::mem::take(&mut self.open).into_iter().chain(unended).collect();
        let estopped = Estopped { unended, unwritten: self.unwritten.clone() };
        for call in std::mem::take(&mut self.waiting) {
            effects.push(Effect::Answer { call, answer: Box::new(Answer::Estopped(estopped.clone())) });
            effects.push(Effect::EndAnswers { call });
        }
    }

    /// Forgets a waiting caller.
    pub(super) fn forget(&mut self, call: u64) {
        self.waiting.retain(|waiting| *waiting != call);
        self.releasing.retain(|(waiting, _)| *waiting != call);
    }
}
