//! The rules of `finally` and `as`.

use super::drain::is_unconfirmed;
use super::{Cells, Phase, Reaction, Seats};
use crate::algebra::event::{Outcome, Value};
use crate::algebra::program::Kind;

impl<C: Cells, S: Seats> Reaction<'_, C, S> {
    /// Start of `P finally Q`.
    pub(super) fn s_finally(&mut self, node: usize, value: Value) -> Option<Outcome> {
        let outcome = self.start_first(node, value)?;
        self.finally(node, outcome)
    }

    /// FIN: P has ended, perhaps because it was stopped, and Q starts; or Q has ended.
    pub(super) fn finally(&mut self, node: usize, mut outcome: Outcome) -> Option<Outcome> {
        if self.cell(node).phase != Phase::Second {
            let cell = self.cell(node);
            (cell.phase, cell.outcome) = (Phase::Second, Some(outcome));
            outcome = self.start(self.program.second(node), Value::EMPTY)?;
        }
        let decided = self.cell(node).outcome.take().unwrap_or(Outcome::Stopped);
        self.clear(node);
        let counts = match (&decided, &outcome) {
            (Outcome::Done(_), Outcome::Aborted(_)) => true,
            _ => is_unconfirmed(&outcome) && !is_unconfirmed(&decided),
        };
        Some(if counts { outcome } else { decided })
    }

    /// stop(fin1(C,F)) = fin1(stop(C),F), stop(fin2(o,C)) = fin2(killed,C)
    pub(super) fn stop_finally(&mut self, node: usize) -> Option<Outcome> {
        if self.cell(node).phase == Phase::Second {
            let decided = &mut self.cell(node).outcome;
            if !decided.as_ref().is_some_and(is_unconfirmed) {
                *decided = Some(Outcome::Stopped);
            }
            return None;
        }
        match self.stop(self.program.first(node)) {
            Some(outcome) => self.finally(node, outcome),
            None => {
                self.enter(node, Phase::Stopping);
                None
            }
        }
    }

    /// Start of `P as t`.
    pub(super) fn s_tagged(&mut self, node: usize, value: Value) -> Option<Outcome> {
        let outcome = self.start_first(node, value)?;
        Some(self.tagged(node, outcome))
    }

    /// TAG
    pub(super) fn tagged(&mut self, node: usize, outcome: Outcome) -> Outcome {
        self.clear(node);
        match (outcome, &self.program.nodes[node].kind) {
            (Outcome::Done(value), Kind::Tagged(tag)) => {
                Outcome::Done(Value::tagged(tag, value.bytes()).unwrap_or(value))
            }
            (outcome, _) => outcome,
        }
    }
}
