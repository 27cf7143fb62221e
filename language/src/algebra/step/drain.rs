//! DRAIN and `stop`: nothing outlives its scope.

use super::{Phase, Reaction, Stop};
use crate::algebra::event::{Cause, Command, Outcome};
use crate::algebra::program::Kind;

impl Reaction<'_> {
    /// DRAIN(o, stop of all operands); values that slots hold are dropped.
    pub(super) fn drain(&mut self, node: usize, outcome: Outcome) -> Option<Outcome> {
        let mut open = 0;
        for operand in self.program.operands(node) {
            if self.stop(operand) == Stop::Waits {
                open += 1;
            }
        }
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
        if is_unconfirmed(&outcome) && !cell.outcome.as_ref().is_some_and(is_unconfirmed) {
            cell.outcome = Some(outcome);
        }
        cell.open -= 1;
        if cell.open > 0 {
            return None;
        }
        let decided = cell.outcome.take();
        self.clear(node);
        decided
    }

    /// stop(C): what has not started is forgotten, what runs is asked to stop.
    pub(super) fn stop(&mut self, node: usize) -> Stop {
        match (&self.program.nodes[node].kind, self.cell(node).phase) {
            (_, Phase::Idle) => Stop::Killed,
            (_, Phase::Done) => self.kill(node),
            (_, Phase::Stopping) => Stop::Waits,
            (_, Phase::Draining) => self.stop_drain(node),
            (Kind::Run { member, .. }, _) => self.stop_leaf(node, *member),
            (Kind::Wait { timer, .. }, _) => self.stop_wait(node, *timer),
            (Kind::Skip | Kind::Never | Kind::Fail(_), _) => self.kill(node),
            (_, Phase::Second) => self.stop_operand(node, self.program.second(node)),
            (Kind::Sequence | Kind::Conditional | Kind::Recurrent | Kind::Otherwise, Phase::Running) => {
                self.stop_operand(node, self.program.first(node))
            }
            (Kind::Concurrent { .. } | Kind::FailFast { .. } | Kind::AnyOf { .. } | Kind::Disable, Phase::Running) => {
                self.drain(node, Outcome::Stopped).map_or(Stop::Waits, |_| Stop::Killed)
            }
        }
    }

    /// stop(never) = killed, and so for what a slot holds.
    fn kill(&mut self, node: usize) -> Stop {
        self.clear(node);
        Stop::Killed
    }

    /// stop(a.i<n>) = s.i<n>
    fn stop_leaf(&mut self, node: usize, member: u32) -> Stop {
        self.enter(node, Phase::Stopping);
        let activation = self.state.seats[member as usize].activation;
        self.commands.push(Command::Stop { member, activation });
        Stop::Waits
    }

    /// stop(w(d)) = killed
    fn stop_wait(&mut self, node: usize, timer: u32) -> Stop {
        let activation = self.state.timers[timer as usize];
        self.commands.push(Command::Cancel { timer, activation });
        self.kill(node)
    }

    /// stop(C;F) = stop(C), and so for `:`, `;;`, `else`.
    fn stop_operand(&mut self, node: usize, operand: usize) -> Stop {
        let stop = self.stop(operand);
        match stop {
            Stop::Killed => self.clear(node),
            Stop::Waits => self.enter(node, Phase::Stopping),
        }
        stop
    }

    /// stop(drain(o,Cs)) = drain(killed,Cs), unless `o` is an unconfirmed stop.
    fn stop_drain(&mut self, node: usize) -> Stop {
        let cell = self.cell(node);
        if !cell.outcome.as_ref().is_some_and(is_unconfirmed) {
            cell.outcome = Some(Outcome::Stopped);
        }
        Stop::Waits
    }
}

fn is_unconfirmed(outcome: &Outcome) -> bool {
    match outcome {
        Outcome::Aborted(reason) => reason.cause == Cause::StopUnconfirmed,
        Outcome::Done(_) | Outcome::Stopped => false,
    }
}
