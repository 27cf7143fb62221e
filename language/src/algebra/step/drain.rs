//! DRAIN and `stop`: nothing outlives its scope.

use super::{Cells, Phase, Reaction, Seats};
use crate::algebra::event::{Cause, Command, Outcome};
use crate::algebra::program::Kind;

impl<C: Cells, S: Seats> Reaction<'_, C, S> {
    /// DRAIN(o, stop of all operands); values that slots hold are dropped.
    pub(super) fn drain(&mut self, node: usize, mut outcome: Outcome) -> Option<Outcome> {
        let mut open = 0;
        for operand in self.program.operands(node) {
            match self.stop(operand) {
                Some(ended) => prefer_unconfirmed(&mut outcome, ended),
                None => open += 1,
            }
        }
        self.drain_open(node, open, outcome)
    }

    /// DRAIN of `open` operands that are still active.
    pub(super) fn drain_open(&mut self, node: usize, open: u32, outcome: Outcome) -> Option<Outcome> {
        self.clear(node);
        if open == 0 {
            return Some(outcome);
        }
        let cell = self.cell(node);
        (cell.phase, cell.open, cell.outcome) = (Phase::Draining, open, Some(outcome));
        None
    }

    /// DRAIN after an operand has ended: it is done with, unless it could not confirm.
    pub(super) fn drained(&mut self, node: usize, outcome: Outcome) -> Option<Outcome> {
        let cell = self.cell(node);
        if let Some(decided) = &mut cell.outcome {
            prefer_unconfirmed(decided, outcome);
        }
        cell.open -= 1;
        if cell.open > 0 {
            return None;
        }
        let decided = cell.outcome.take();
        self.clear(node);
        decided
    }

    /// stop(C): operands that have not started are forgotten, and operands that run are asked to
    /// stop. If no operand has to confirm, the outcome is `Stopped`, or the report that an operand
    /// could not confirm.
    pub(super) fn stop(&mut self, node: usize) -> Option<Outcome> {
        match (&self.program.nodes[node].kind, self.cell(node).phase) {
            (_, Phase::Idle) => Some(Outcome::Stopped),
            (_, Phase::Done) => self.kill(node),
            (_, Phase::Waiting) => self.stop_waiting(node),
            (_, Phase::Stopping) => None,
            (Kind::Asynchronous, Phase::Draining) => self.stop_pool(node),
            (Kind::Named(_), Phase::Draining) => None,
            (_, Phase::Draining) => self.stop_drain(node),
            (Kind::Run { member, .. }, _) => self.stop_leaf(node, *member),
            (Kind::Wait { timer, .. }, _) => self.stop_wait(node, *timer),
            (Kind::Skip | Kind::Never | Kind::Fail(_), _) => self.kill(node),
            (Kind::Shield { bound }, _) => self.stop_shield(node, *bound),
            (Kind::Using { .. }, _) => self.stop_using(node),
            (Kind::Finally, _) => self.stop_finally(node),
            (Kind::Chart, _) => self.stop_chart(node),
            (Kind::Catch { .. }, Phase::Second) => self.stop_match(node),
            (Kind::Named(_), _) => self.stop_named(node),
            (_, Phase::Second) => self.stop_operand(node, self.program.second(node)),
            (Kind::Match { .. }, Phase::Running) => self.stop_match(node),
            (
                Kind::Sequence
                | Kind::Conditional
                | Kind::Recurrent
                | Kind::Otherwise
                | Kind::Tagged(_)
                | Kind::With(_)
                | Kind::Repeat { .. }
                | Kind::Catch { .. },
                Phase::Running,
            ) => self.stop_operand(node, self.program.first(node)),
            (
                Kind::Concurrent { .. }
                | Kind::FailFast { .. }
                | Kind::AnyOf { .. }
                | Kind::AtLeast { .. }
                | Kind::Disable
                | Kind::Asynchronous,
                Phase::Running,
            ) => self.drain(node, Outcome::Stopped),
        }
    }

    /// stop(never) = killed, and the same for a value in a slot.
    pub(super) fn kill(&mut self, node: usize) -> Option<Outcome> {
        self.clear(node);
        Some(Outcome::Stopped)
    }

    /// stop(a.i<n>) = s.i<n>
    fn stop_leaf(&mut self, node: usize, member: u32) -> Option<Outcome> {
        self.enter(node, Phase::Stopping);
        let activation = self.state.seats[member as usize].activation;
        self.commands.push(Command::Stop { member, activation });
        None
    }

    /// stop(w(d)) = killed
    fn stop_wait(&mut self, node: usize, timer: u32) -> Option<Outcome> {
        let activation = self.state.timers[timer as usize];
        self.commands.push(Command::Cancel { timer, activation });
        self.kill(node)
    }

    /// stop(C;F) = stop(C), and so for `:`, `;;`, `else`.
    pub(super) fn stop_operand(&mut self, node: usize, operand: usize) -> Option<Outcome> {
        let outcome = self.stop(operand);
        match outcome {
            Some(_) => self.clear(node),
            None => self.enter(node, Phase::Stopping),
        }
        outcome
    }

    /// stop(p => C) = p => stop(C). The value is kept, because a `finally` inside may still use it.
    fn stop_named(&mut self, node: usize) -> Option<Outcome> {
        let outcome = self.stop(self.program.first(node));
        match outcome {
            Some(_) => self.clear(node),
            None => {
                let cell = self.cell(node);
                (cell.phase, cell.open) = (Phase::Draining, 1);
            }
        }
        outcome
    }

    /// The arm of a `match` or an `else match` that runs is stopped.
    fn stop_match(&mut self, node: usize) -> Option<Outcome> {
        let is_active = |operand: &usize| self.state.cells[*operand].phase.is_active();
        let arm = self.program.operands(node).find(is_active);
        self.stop_operand(node, arm.expect("one arm of a `match` that runs is active"))
    }

    /// stop(drain(o,Cs)) = drain(killed,Cs), unless `o` is an unconfirmed stop.
    fn stop_drain(&mut self, node: usize) -> Option<Outcome> {
        let cell = self.cell(node);
        if !cell.outcome.as_ref().is_some_and(is_unconfirmed) {
            cell.outcome = Some(Outcome::Stopped);
        }
        None
    }

    /// stop of a `::` that lets its pool come to an end: the pool is stopped as well.
    fn stop_pool(&mut self, node: usize) -> Option<Outcome> {
        let decided = self.cell(node).outcome.take();
        self.drain(node, decided.filter(is_unconfirmed).unwrap_or(Outcome::Stopped))
    }
}

/// Keeps the first unconfirmed stop as the decided outcome.
pub(super) fn prefer_unconfirmed(decided: &mut Outcome, outcome: Outcome) {
    if is_unconfirmed(&outcome) && !is_unconfirmed(decided) {
        *decided = outcome;
    }
}

pub(super) fn is_unconfirmed(outcome: &Outcome) -> bool {
    match outcome {
        Outcome::Aborted(reason) => reason.cause == Cause::StopUnconfirmed,
        Outcome::Done(_) | Outcome::Stopped => false,
    }
}
