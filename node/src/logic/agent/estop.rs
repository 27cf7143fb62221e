//! `dca estop` on a node: every program is told to stop at once, without `finally` or `shield`, and nothing begins until somebody
//! releases it. It holds over a restart of the node, since the driver writes it down.

use super::Agent;
use super::calls::answer;
use crate::logic::effect::{Effect, Out};
use crate::logic::protocol::{Answer, Estop, Estopped, FailureCause};
use comms::logic::time::Time;
use serde::{Deserialize, Serialize};

/// Whether everything is stopped.
#[derive(Debug, Default, Serialize, Deserialize)]
pub(super) struct Stopped {
    by: Option<Estop>,
    /// Those who wait until nothing runs.
    waiting: Vec<u64>,
}

impl Agent {
    /// Ends everything on this host; the call is answered when nothing of it runs.
    pub(super) fn estop(&mut self, call: u64, estop: &Estop, out: &mut Out<'_>) {
        let estop = estop.bounded();
        self.stop_gathering(|_| true, out);
        for participant in self.participants.values_mut() {
            participant.leave(out);
        }
        for coordinator in self.coordinators.values_mut() {
            coordinator.abort(FailureCause::Estop(estop.clone()), out);
        }
        self.stopped.waiting.push(call);
        // Who was first is who has stopped it.
        self.stopped.by.get_or_insert(estop);
        self.keep_estop(out);
    }

    /// Lets programs begin again.
    pub(super) fn release_estop(&mut self, call: u64, out: &mut Out<'_>) {
        let was_stopped = self.stopped.by.take().is_some();
        self.keep_estop(out);
        answer(call, Answer::Released { was_stopped }, out);
    }

    /// Has it written down how it is; a node that was killed may not have come to it.
    pub(super) fn keep_estop(&self, out: &mut Out<'_>) {
        out.effects.push(Effect::KeepEstop(self.stopped.by.clone()));
    }

    /// Answers those who wait until nothing runs, once that is so.
    pub(super) fn tell_stopped(&mut self, effects: &mut Vec<Effect>) {
        if self.stopped.waiting.is_empty() || !self.participants.is_empty() {
            return;
        }
        let mut unended = Vec::new();
        for (deployment, left) in &self.unended {
            let programs = self.past.iter().find(|(id, _)| id == deployment).map_or(&[][..], |(_, programs)| programs);
            let left = programs.iter().filter(|(leaf, _)| left.leaves.contains(leaf));
            unended.extend(left.map(|(_, path)| format!("{deployment} {path}")));
        }
        let estopped = Estopped { unended };
        for call in std::mem::take(&mut self.stopped.waiting) {
            effects.push(Effect::Answer { call, answer: Box::new(Answer::Estopped(estopped.clone())) });
            effects.push(Effect::EndAnswers { call });
        }
    }

    /// Forgets one who waits.
    pub(super) fn forget_stopped(&mut self, call: u64) {
        self.stopped.waiting.retain(|waiting| *waiting != call);
    }

    /// Returns who has stopped everything, if somebody has.
    pub(super) const fn stopped_by(&self) -> Option<&Estop> {
        self.stopped.by.as_ref()
    }

    /// Says why this node begins nothing, if it does not.
    pub(super) fn obstacle(&self, now: Time) -> Option<String> {
        let stopped = || {
            let by = self.stopped.by.as_ref()?;
            Some(format!("{by}; `dca estop --release` lets programs begin again"))
        };
        self.namesake().or_else(stopped).or_else(|| self.crash_loop(now))
    }

    /// Begins with everything stopped, if it was when the node before it ended.
    pub(super) fn stopped_before(by: Option<Estop>) -> Stopped {
        Stopped { by, waiting: Vec::new() }
    }
}
