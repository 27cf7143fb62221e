//! The rules of `shield` and `using`: when their operand may be stopped, and when it may start.

use super::drain::is_unconfirmed;
use super::{Cells, Phase, Reaction, Seats};
use crate::algebra::event::{Command, Outcome, Value};
use crate::algebra::program::{Bound, Kind};

impl<C: Cells, S: Seats> Reaction<'_, C, S> {
    /// Start of `shield P`.
    pub(super) fn s_shield(&mut self, node: usize, value: Value) -> Option<Outcome> {
        let outcome = self.start_first(node, value)?;
        self.pass(node, outcome)
    }

    /// SHIELD: after a stop in the meantime, the operator around it gets the outcome `stopped`, regardless of the real outcome.
    pub(super) fn shield(&mut self, node: usize, outcome: Outcome) -> Outcome {
        let is_held_up = self.cell(node).phase == Phase::Second;
        if is_held_up && let Kind::Shield { bound: Some(Bound { timer, .. }) } = self.program.nodes[node].kind {
            let activation = self.state.timers[timer as usize];
            self.commands.push(Command::Cancel { timer, activation });
        }
        self.clear(node);
        if is_held_up && !is_unconfirmed(&outcome) { Outcome::Stopped } else { outcome }
    }

    /// stop(shield(C)) = shieldK(C), which does not change any more.
    pub(super) fn stop_shield(&mut self, node: usize, bound: Option<Bound>) -> Option<Outcome> {
        if self.cell(node).phase == Phase::Running {
            self.enter(node, Phase::Second);
            if let Some(Bound { timer, after }) = bound {
                self.arm(timer, after);
            }
        }
        None
    }

    /// [s-using]
    pub(super) fn s_using(&mut self, node: usize, value: Value) -> Option<Outcome> {
        if !self.is_free(node, self.state.queue.len()) {
            self.state.queue.push(node);
            let cell = self.cell(node);
            (cell.phase, cell.outcome) = (Phase::Waiting, Some(Outcome::Done(value)));
            return None;
        }
        self.hold(node, value)
    }

    /// Whether a `using` can have all its resources, before those behind the first `ahead` of the queue.
    fn is_free(&self, node: usize, ahead: usize) -> bool {
        let taken = self.program.taken(node);
        let is_wanted =
            |index| self.state.queue[..ahead].iter().any(|&other| self.program.taken(other).contains(index));
        taken.iter().all(|&index| self.state.holders[index].is_none()) && !taken.iter().any(is_wanted)
    }

    fn hold(&mut self, node: usize, value: Value) -> Option<Outcome> {
        for &index in self.program.taken(node) {
            self.state.holders[index] = Some(node);
        }
        let outcome = self.start_first(node, value)?;
        Some(self.using(node, outcome))
    }

    /// USING: the resources are free again.
    pub(super) fn using(&mut self, node: usize, outcome: Outcome) -> Outcome {
        for &index in self.program.taken(node) {
            self.state.holders[index] = None;
        }
        self.clear(node);
        outcome
    }

    pub(super) fn stop_using(&mut self, node: usize) -> Option<Outcome> {
        let outcome = self.stop_operand(node, self.program.first(node))?;
        Some(self.using(node, outcome))
    }

    /// stop(acq) = killed
    pub(super) fn stop_waiting(&mut self, node: usize) -> Option<Outcome> {
        self.state.queue.retain(|&other| other != node);
        self.kill(node)
    }

    /// [e-grant], as often as something can start; returns the outcome of the group if it has one.
    pub(super) fn e_grant(&mut self) -> Option<Outcome> {
        for _ in 0..self.program.usings {
            let place = (0..self.state.queue.len()).find(|&place| self.is_free(self.state.queue[place], place))?;
            let node = self.state.queue.remove(place);
            let Some(Outcome::Done(value)) = self.cell(node).outcome.take() else {
                unreachable!("what waits has the value that it starts with")
            };
            let ended = self.hold(node, value).and_then(|outcome| self.e_ctx(node, outcome));
            if ended.is_some() {
                return ended;
            }
        }
        None
    }
}
