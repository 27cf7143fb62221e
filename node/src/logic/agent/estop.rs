//! `dca estop` on a node: every program is told to stop at once, without `finally` or `shield`, and nothing begins
//! until a user releases it. The stop lasts over a restart of the node, since the driver writes it down.

use super::Agent;
use crate::logic::effect::{Effect, Out};
use crate::logic::protocol::{Answer, Deployment, Estop, Estopped, FailureCause};
use comms::logic::time::Time;
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
    /// The work that may go on outside of programs that have ended while callers wait.
    open: Vec<String>,
}

impl Stopped {
    /// Whether the last write that was asked for is over.
    const fn is_over(&self) -> bool {
        self.writes.0 == self.writes.1
    }

    /// Takes note of the work that may go on of a deployment that is over, for the callers that wait.
    pub(super) fn note_open(&mut self, deployment: &Deployment, may_go_on: Vec<String>) {
        if !self.waiting.is_empty() {
            self.open.extend(may_go_on.iter().map(|what| format!("{deployment} {what}")));
        }
    }
}

impl Agent {
    /// Ends everything on this host; the call is answered when nothing of it runs.
    pub(super) fn estop(&mut self, call: u64, estop: &Estop, out: &mut Out<'_>) {
        let estop = estop.bounded();
        let why = format!("it {}", FailureCause::Estop(estop.clone()));
        self.stop_gathering(|_| true, &why, out);
        for participant in self.participants.values_mut() {
            participant.stop_at_once(&estop, out);
        }
        for coordinator in self.coordinators.values_mut() {
            coordinator.abort(FailureCause::Estop(estop.clone()), out);
        }
        self.stopped.waiting.push(call);
        // The first user to stop everything is the one recorded.
        self.stopped.by.get_or_insert(estop);
        self.keep_estop(out);
    }

    /// Lets programs begin again.
    pub(super) fn release_estop(&mut self, call: u64, out: &mut Out<'_>) {
        self.stopped.releasing.push((call, self.stopped.by.take().is_some()));
        self.keep_estop(out);
    }

    /// Has the present state written to the disk: a node that was killed may not have written it.
    pub(super) fn keep_estop(&mut self, out: &mut Out<'_>) {
        self.stopped.writes.0 += 1;
        out.effects.push(Effect::KeepEstop { number: self.stopped.writes.0, estop: self.stopped.by.clone() });
    }

    /// A write is over. Each one writes what holds then, so the last one counts.
    pub(super) fn estop_kept(&mut self, number: u64, written: Result<(), String>, out: &mut Out<'_>) {
        if number <= self.stopped.writes.1 {
            return;
        }
        self.stopped.writes.1 = number;
        self.stopped.unwritten = written.err();
        if self.stopped.is_over() {
            for (call, was_stopped) in std::mem::take(&mut self.stopped.releasing) {
                let unwritten = self.stopped.unwritten.clone();
                out.answer_last(call, Answer::Released { was_stopped, unwritten });
            }
        }
    }

    /// Answers the callers that wait until nothing runs, once that is the case and the disk has answered.
    pub(super) fn tell_stopped(&mut self, effects: &mut Vec<Effect>) {
        if self.stopped.waiting.is_empty() || !self.participants.is_empty() || !self.stopped.is_over() {
            return;
        }
        let mut unended = std::mem::take(&mut self.stopped.open);
        for (deployment, left) in &self.past.unended {
            let programs =
                self.past.programs.iter().find(|(id, _)| id == deployment).map_or(&[][..], |(_, programs)| programs);
            let left = programs.iter().filter(|(leaf, _)| left.leaves.contains(leaf));
            unended.extend(left.map(|(_, path)| format!("{deployment} {path}")));
        }
        let estopped = Estopped { unended, unwritten: self.stopped.unwritten.clone() };
        for call in std::mem::take(&mut self.stopped.waiting) {
            effects.push(Effect::Answer { call, answer: Box::new(Answer::Estopped(estopped.clone())) });
            effects.push(Effect::EndAnswers { call });
        }
    }

    /// Forgets a waiting caller.
    pub(super) fn forget_stopped(&mut self, call: u64) {
        self.stopped.waiting.retain(|waiting| *waiting != call);
        self.stopped.releasing.retain(|(waiting, _)| *waiting != call);
    }

    /// Returns the user who has stopped everything, if there is one.
    pub(super) const fn stopped_by(&self) -> Option<&Estop> {
        self.stopped.by.as_ref()
    }

    /// Returns why this node begins nothing, if that is so.
    pub(super) fn obstacle(&self, now: Time) -> Option<String> {
        let stopped = || {
            let by = self.stopped.by.as_ref()?;
            Some(format!("{by}; `dca estop --release` lets programs begin again"))
        };
        self.namesake().or_else(stopped).or_else(|| self.crash_loop(now))
    }

    /// Begins with everything stopped, if everything was stopped when the previous node ended.
    pub(super) fn stopped_before(by: Option<Estop>) -> Stopped {
        Stopped { by, ..Stopped::default() }
    }
}
