//! The rules of events at leaves.

use super::{Cells, Phase, Reaction, Seats};
use crate::algebra::event::{Activation, Cause, Command, Outcome, Reason, Value};
use crate::algebra::program::Kind;

impl<C: Cells, S: Seats> Reaction<'_, C, S> {
    /// Returns the node of a member's current activation; none for a number that is not current, which drops the event.
    pub(super) fn seated(&self, member: u32, activation: Activation) -> Option<usize> {
        if member as usize >= self.program.endless.len() {
            return None;
        }
        let seat = &self.state.seats[member as usize];
        seat.node.filter(|_| seat.activation == activation)
    }

    /// Returns the node of a timer's current arm; none if it was cancelled or armed again.
    pub(super) fn armed(&self, timer: u32, activation: Activation) -> Option<usize> {
        let node = *self.program.timers.get(timer as usize)?;
        let current = self.state.timers[timer as usize] == activation;
        if let Kind::Chart = self.program.nodes[node].kind {
            return Some(node).filter(|_| current && self.is_timed(timer));
        }
        Some(node).filter(|_| current && self.state.cells[node].phase == self.program.armed_phase(node))
    }

    /// [e-done], and for a leaf that is a service L7: its end breaks its contract.
    pub(super) fn e_done(&mut self, node: usize, value: Value) -> Outcome {
        match self.leave(node) {
            (_, Phase::Stopping) => Outcome::Stopped,
            (member, _) if self.program.endless[member as usize] => aborted(member, Cause::ServiceEnded),
            (_, _) => Outcome::Done(value),
        }
    }

    /// [e-abort]
    pub(super) fn e_abort(&mut self, node: usize, report: Value) -> Outcome {
        match self.leave(node) {
            (_, Phase::Stopping) => Outcome::Stopped,
            (member, _) => aborted(member, Cause::Reported(report)),
        }
    }

    /// [e-stopped]; any report of a stopping member confirms its stop. An active member has stopped without an order:
    /// it failed.
    pub(super) fn e_stopped(&mut self, node: usize) -> Outcome {
        self.e_abort(node, Value::EMPTY)
    }

    /// [e-unconf]
    pub(super) fn e_unconfirmed(&mut self, node: usize) -> Outcome {
        let (member, _) = self.leave(node);
        aborted(member, Cause::StopUnconfirmed)
    }

    /// [e-timer], and [e-bound] of a shield, which has an outcome only if nothing below it has to confirm.
    pub(super) fn e_timer(&mut self, node: usize, timer: u32) -> Option<Outcome> {
        if let Kind::Chart = self.program.nodes[node].kind {
            return self.timed(node, timer);
        }
        if matches!(self.program.nodes[node].kind, Kind::Shield { .. }) {
            return self.stop_operand(node, self.program.first(node));
        }
        self.clear(node);
        Some(Outcome::Done(Value::EMPTY))
    }

    /// The member's activation is over: frees its seat and closes its sets. Returns its slot and the phase it was in.
    fn leave(&mut self, node: usize) -> (u32, Phase) {
        let Kind::Run { member, sets } = &self.program.nodes[node].kind else {
            unreachable!("a seat names a `Run` node")
        };
        let was = self.cell(node).phase;
        self.clear(node);
        self.state.seats[*member as usize].node = None;
        let sets = &self.program.sets[sets.clone()];
        self.commands.extend(sets.iter().map(|&set| Command::Disconnect { set }));
        (*member, was)
    }
}

fn aborted(member: u32, cause: Cause) -> Outcome {
    Outcome::Aborted(Reason { member: Some(member), cause })
}
